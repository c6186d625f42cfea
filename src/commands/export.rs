//! `periscope export`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args;
use periscope::campaign::Campaign;
use periscope::exchange::{self, ply};
use periscope::store::Shelf;
use periscope::tables::{Patch, Row};

use super::output::say;
use super::whole_file;

/// Arguments of `export`.
#[derive(Args)]
#[command(after_help = "Conventions of both files: docs/interoperation.md")]
pub struct Export {
    /// Result folder
    results: PathBuf,
    /// File to write: .ply for the patches as a point cloud, .hdf5 for the profiles as a capture of y-tal
    file: PathBuf,
    /// Table of patches
    #[arg(long, value_name = "TABLE", default_value = "patches")]
    patches: String,
    /// .hdf5: the campaign that was run, which says where laser and sensor are
    #[arg(long, value_name = "DIR")]
    campaign: Option<PathBuf>,
    /// .hdf5: table of profiles
    #[arg(long, value_name = "TABLE", default_value = "profiles")]
    profiles: String,
    /// .hdf5: table of calibrations, for the latency
    #[arg(long, value_name = "TABLE", default_value = "calibration")]
    calibration: String,
}

/// The command.
pub fn export(args: &Export) -> Result<ExitCode> {
    let shelf = Shelf::look(&args.results)?;
    let ending = args.file.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    match ending.as_deref() {
        Some("ply") => {
            let patches: Vec<Patch> = rows(&shelf, &args.patches)?;
            let written = whole_file::write(&args.file, |out| ply::write(out, &patches))?;
            say!("{}: {written} patches", args.file.display())?;
        }
        Some("hdf5" | "h5") => {
            let campaign = args.campaign.as_ref();
            let campaign =
                campaign.context("a capture needs to know where laser and sensor are: add --campaign DIR")?;
            let campaign = Campaign::load(campaign)?;
            // Where no patches were solved for, the anchors of campaign.toml do.
            let has_patches = shelf.table_of(&args.patches).is_some();
            let patches = if has_patches { rows(&shelf, &args.patches)? } else { Vec::new() };
            let (profiles, calibration) = (rows(&shelf, &args.profiles)?, rows(&shelf, &args.calibration)?);
            let capture =
                exchange::capture_of(&profiles, &patches, &calibration, &campaign).map_err(anyhow::Error::msg)?;
            whole_file::write(&args.file, |out| exchange::write_y_tal(out, &capture))?;
            let (histograms, bins) = (capture.pairs.len(), capture.bins());
            say!("{}: {histograms} histograms of {bins} bins of {:.3} ps", args.file.display(), capture.dt_ps)?;
        }
        _ => bail!("{}: end the name in .ply for patches or .hdf5 for profiles", args.file.display()),
    }
    Ok(ExitCode::SUCCESS)
}

fn rows<R: Row>(shelf: &Shelf, view: &str) -> Result<Vec<R>> {
    let found = shelf.table_of(view);
    match found.as_deref() {
        Some(table) if table == R::TABLE => {}
        Some(table) => bail!("`{view}` of {} is a table `{table}`, not `{}`", shelf.out().display(), R::TABLE),
        None => bail!(
            "{} has no table `{view}`; `periscope tables` lists what it has, --{} names another",
            shelf.out().display(),
            R::TABLE
        ),
    }
    let mut rows = Vec::new();
    for batch in shelf.batches(view)? {
        rows.extend(R::rows(&batch)?);
    }
    Ok(rows)
}
