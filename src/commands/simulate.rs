//! `periscope simulate`.

use std::fmt::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::{Args, ValueEnum};
use periscope::simulate::{self, Format, Scene};

use super::output::say;

/// Arguments of `simulate`.
#[derive(Args)]
#[command(after_long_help = KEYS)]
pub struct Simulate {
    /// Scene description (TOML); `--help` lists its keys
    scene: PathBuf,
    /// Folder for the campaign; must be empty or absent
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Seed of all that is random: equal seeds give equal files
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Format of the raw files
    #[arg(long, value_enum, default_value = "trc")]
    format: FileFormat,
}

/// Format of raw files.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum FileFormat {
    /// LeCroy sequence files with sub-sample trigger times
    Trc,
    /// Tektronix FastFrame files with sub-sample trigger times
    Wfm,
    /// Keysight segmented files of volts with sub-sample trigger times
    Bin,
    /// NumPy arrays, a row a shot, without trigger times
    Npy,
    /// Comma-separated times and volts, a file a shot
    Csv,
}

const KEYS: &str = r#"Keys of a scene (optional ones in brackets):
  [campaign]      name [group_index, dimensions]
  [stations.NAME] position_m: where light leaves (`laser`) and sensors stand [one station `laser` at the origin]
  [sensors.NAME]  latency_ps [station, kind = "analog" or "counts"]
  [patches.N]     a disk: position_m, normal, size_m [reflectance 0.8, role = "visible", "hidden" or "mirror",
                  lobe = { share, width_rad }: glossy]
  [views.N]       patches: a spot and pixel that covers several
  [surfaces.NAME] furniture and walls: corner_m, edges_m (two) [reflectance, cell_m]
  [laser]         pulse_j, wavelength_nm, repetition_hz [power_per_h, power_sd]
  [optics]        lens_m [transmission, ambient_w]
  [instrument]    response = { kind = "emg", sigma_ps, tau_ps } or { kind = "gaussian", fwhm_ps }
                  responsivity_a_w, dt_ps, samples, t0_ps, full_scale_v, noise_v, jitter_ps
                  [load_ohm 50, dark_a, bits 8, noise_bandwidth_ghz, rate_hz, reference = { fwhm_ps, height_v }]
  [instrument.ranges.NAME]  full_scale_v, noise_v [latency_ps]
  [instrument.counts]       efficiency [dark_hz, dead_time_ps]: for sensors that count photons
  [instrument.flaws]        [saturation_v, slew_ps, cubic, interleave, pickup, echo, tail, recovery, delay_ps_per_h, delay_sd_ps, delay_walk_ps]
  [captures]      shots, response_shots, path_m, path_sd_m [lit, seen, bounces 2, ranges, response_od, first_bounce_od, dark_shots,
                  blocked_shots, bad_shots, lost_shots, overhead_s]
  [[captures.fiducials]]    path_m or through, shots [attenuation_od, runs, every_s]
  Shortcut for studies: snr in [instrument] in place of [laser], [optics], noise_v, responsivity_a_w; the truth says so.

What each means, with an example: the documentation of the module `simulate` (`cargo doc --open`).
Examples: pipelines/scenes/"#;

/// The command.
pub fn simulate(args: &Simulate) -> Result<ExitCode> {
    let scene = Scene::load(&args.scene)?;
    let format = match args.format {
        FileFormat::Trc => Format::Trc,
        FileFormat::Wfm => Format::Wfm,
        FileFormat::Bin => Format::Bin,
        FileFormat::Npy => Format::Npy,
        FileFormat::Csv => Format::Csv,
    };
    let truth = simulate::simulate(&scene, args.seed, &args.out, format)?;
    let of = |role: &str| truth.captures.iter().filter(|capture| &*capture.role == role).count();
    let mut what = format!(
        "{}: {} patches, {} captures of {} shots",
        args.out.display(),
        truth.patches.len(),
        of("scene"),
        scene.captures.shots
    );
    for role in ["response", "dark", "blocked", "fiducial"].into_iter().filter(|role| of(role) > 0) {
        write!(what, ", {} {role}", of(role))?;
    }
    say!("{what}; truth in truth/")?;
    if scene.instrument.snr.is_some() {
        say!("signal-to-noise ratio set to {} in one shot, not derived", scene.instrument.snr.unwrap_or(0.0))?;
    } else {
        let snrs = truth.captures.iter().filter(|capture| &*capture.role == "scene").map(|capture| capture.snr);
        let (least, most) =
            snrs.fold((f64::INFINITY, 0.0), |(least, most), snr| (f64::min(least, snr), f64::max(most, snr)));
        let last = truth.captures.iter().map(|capture| capture.start_s + capture.duration_s).fold(0.0, f64::max);
        say!("signal-to-noise ratio {least:.3e} to {most:.3e} in one shot; {:.3} hours of capture", last / 3600.0)?;
    }
    Ok(ExitCode::SUCCESS)
}
