//! `periscope convert`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Result, bail};
use clap::Args;
use periscope::exchange::{self, CampaignOptions, Defaults, Summary};

use super::machine::size;
use super::output::{note, say};

/// Arguments of `convert`.
#[derive(Args)]
#[command(after_help = AFTER_HELP)]
pub struct Convert {
    /// Capture: y-tal or Z-NLOS (.hdf5), a confocal scan (.mat with `rect_data` or `meas`), or `counts` with a list
    /// `lit_m` of points (.hdf5, .mat)
    capture: PathBuf,
    /// Folder for the campaign; must be empty or absent
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Full width at half maximum of the system's response: laser pulse and sensor together. No capture contains it
    #[arg(long, value_name = "PS")]
    fwhm_ps: f64,
    /// Keep only every N-th point of each axis of the grid
    #[arg(long, value_name = "N", default_value_t = 1)]
    every: usize,
    /// Standard deviation of each coordinate of the wall's points; else they count as exact
    #[arg(long, value_name = "M")]
    wall_sd_m: Option<f64>,
    /// Laser pulses per histogram, to correct for photons that hide others; default: no correction
    #[arg(long)]
    cycles: Option<u64>,
    /// Dead time of the sensor after a photon
    #[arg(long, value_name = "PS", requires = "cycles")]
    dead_time_ps: Option<f64>,
    /// Time behind the wall's own light from which on light counts; default: found in the histograms
    #[arg(long, alias = "gate", value_name = "PS")]
    gate_ps: Option<f64>,
    /// Scans and lists of points: width of a bin
    #[arg(long, value_name = "PS")]
    dt_ps: Option<f64>,
    /// MAT-files: side of the scanned square, instead of `width`
    #[arg(long, value_name = "M")]
    wall_m: Option<f64>,
    /// Scans and lists of points: start time of the first bin; of scans after the light's arrival at the wall
    #[arg(long, value_name = "PS", allow_negative_numbers = true)]
    start_ps: Option<f64>,
    /// MAT-files: the file with `tofgrid`, the delay of each point
    #[arg(long, value_name = "FILE")]
    tof: Option<PathBuf>,
    /// Memory for the capture's histograms; a capture that needs more is refused before it is read
    #[arg(long, value_name = "SIZE", value_parser = size, default_value = "4GiB")]
    memory: usize,
}

/// How often the histograms are in memory at once: as read, and while they are brought into order.
const COPIES: u64 = 2;

/// Bins across the response's width: with fewer than the first, nothing can be timed; from the second on, error bars
/// are right.
const COARSE_BINS: f64 = 2.0;
const FINE_BINS: f64 = 3.0;

const AFTER_HELP: &str = "Then:  periscope run --campaign DIR\nWhat is taken from each format: docs/interoperation.md";

/// The command.
pub fn convert(args: &Convert) -> Result<ExitCode> {
    positive("--fwhm-ps", Some(args.fwhm_ps))?;
    positive("--wall-sd-m", args.wall_sd_m)?;
    positive("--dead-time-ps", args.dead_time_ps)?;
    positive("--gate-ps", args.gate_ps)?;
    positive("--dt-ps", args.dt_ps)?;
    positive("--wall-m", args.wall_m)?;
    if args.every == 0 {
        bail!("--every 0: give 1 for all points, 2 for every other");
    }
    let defaults = Defaults {
        dt_ps: args.dt_ps,
        wall_m: args.wall_m,
        start_ps: args.start_ps,
        delays: args.tof.as_deref(),
        most_bytes: Some(args.memory as u64 / COPIES),
    };
    let capture = exchange::read(&args.capture, &defaults)?;
    if args.fwhm_ps < COARSE_BINS * capture.dt_ps {
        bail!(
            "{}: bins of {:.1} ps are too wide for a response of {} ps: times would be off by parts of a bin, far beyond their error bars; two bins \
             across the response are the least: fold the histograms with a wider pulse",
            args.capture.display(),
            capture.dt_ps,
            args.fwhm_ps
        );
    }
    let options = CampaignOptions {
        name: name(&args.capture),
        fwhm_ps: args.fwhm_ps,
        every: args.every,
        sd_m: args.wall_sd_m,
        cycles: args.cycles,
        dead_time_ps: args.dead_time_ps,
        gate_ps: args.gate_ps,
    };
    let Summary { patches, histograms, counts } = exchange::write_campaign(&capture, &options, &args.out)?;
    let what =
        if counts { "of photon counts" } else { "not of whole counts, so that noise is taken from their first bins" };
    say!(
        "{}: {} capture, {histograms} histograms of {} bins of {:.3} ps over {patches} points of the wall, {what}",
        args.out.display(),
        capture.format,
        capture.bins(),
        capture.dt_ps
    )?;
    if args.fwhm_ps < FINE_BINS * capture.dt_ps {
        note!(
            "warning: a response of {} ps in bins of {:.1} ps: error bars will be too small; bins no wider than a third of it keep them right",
            args.fwhm_ps,
            capture.dt_ps
        );
    }
    Ok(ExitCode::SUCCESS)
}

fn positive(key: &str, value: Option<f64>) -> Result<()> {
    match value {
        Some(value) if !(value > 0.0 && value.is_finite()) => bail!("{key} {value}: it must be positive"),
        _ => Ok(()),
    }
}

/// Name of the campaign, from its file.
fn name(capture: &Path) -> String {
    let stem = capture.file_stem().map_or_else(|| "capture".into(), |stem| stem.to_string_lossy());
    let name: String = stem.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '-' }).collect();
    // A name begins with a letter or a digit, and is no longer than a file system takes.
    let name: String = name.trim_start_matches('-').chars().take(80).collect();
    if name.is_empty() { "capture".to_owned() } else { name }
}
