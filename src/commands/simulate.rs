//! `periscope simulate`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::{Args, ValueEnum};
use periscope::simulate::{self, Format, Scene};

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
    /// NumPy arrays, a row a shot, without trigger times
    Npy,
}

const KEYS: &str = r#"Keys of a scene:
  [campaign]      name; group_index, dimensions (optional)
  [stations.NAME] position_m, as in campaign.toml (optional: one station `laser` at the origin)
  [sensors.NAME]  station (optional), latency_ps: true delay from arrival to the response's maximum
  [patches.N]     a disk: position_m, normal, size_m (diameter), reflectance (optional, 0.8)
  [instrument]    response = { kind = "emg", sigma_ps, tau_ps } or { kind = "gaussian", fwhm_ps }
                  dt_ps, samples, t0_ps (of sample 0), bits (8 to 16), full_scale_v, jitter_ps (of the trigger)
                  snr (of one shot: all captures are amplified to one height), or noise_v and volts (height of a
                  first bounce from a white patch at 1 m) for heights as geometry gives them
                  reference = { fwhm_ps, snr } (optional): a second channel with the pulse that marks time zero
  [captures]      shots, response_shots, path_m and path_sd_m of the response, bad_shots (optional share)

First and second bounces of visible patches are simulated; scenes that ask for more are refused.
Examples: pipelines/scenes/"#;

/// The command.
pub fn simulate(args: &Simulate) -> Result<ExitCode> {
    let scene = Scene::load(&args.scene)?;
    let format = match args.format {
        FileFormat::Trc => Format::Trc,
        FileFormat::Npy => Format::Npy,
    };
    let truth = simulate::simulate(&scene, args.seed, &args.out, format)?;
    let captures = truth.onsets.len();
    println!(
        "{}: {} patches, {captures} captures of {} shots; truth in truth/",
        args.out.display(),
        truth.patches.len(),
        scene.captures.shots
    );
    Ok(ExitCode::SUCCESS)
}
