//! `periscope export`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args;
use periscope::campaign::Campaign;
use periscope::exchange::{self, ply};
use periscope::formats::npy;
use periscope::store::Shelf;
use periscope::tables::{Image, Patch, Row, VolumeRow};

use super::output::say;
use super::whole_file;

/// Table of all patches, weak ones among them, where a pipeline searches for these.
const ALL: &str = "all_patches";

/// Arguments of `export`.
#[derive(Args)]
#[command(after_help = "Conventions of both files: docs/interoperation.md")]
pub struct Export {
    /// Result folder
    results: PathBuf,
    /// File to write: .ply for the patches as a point cloud, .hdf5 for the profiles as a capture of y-tal (--volume:
    /// the volume of an image), .npy for the volume of an image
    file: PathBuf,
    /// Table of patches [default: `all_patches` if there is one, else `patches`]
    #[arg(long, value_name = "TABLE")]
    patches: Option<String>,
    /// .hdf5: the campaign that was run, which says where laser and sensor are
    #[arg(long, value_name = "DIR")]
    campaign: Option<PathBuf>,
    /// .hdf5: table of profiles
    #[arg(long, value_name = "TABLE", default_value = "profiles")]
    profiles: String,
    /// .hdf5: table of calibrations, for the latency
    #[arg(long, value_name = "TABLE", default_value = "calibration")]
    calibration: String,
    /// .hdf5: the volume of an image with the places of its voxels, in place of the profiles
    #[arg(long)]
    volume: bool,
    /// .npy, --volume: table of the volume; made with `run --set voxels.volume=true`
    #[arg(long, value_name = "TABLE", default_value = "voxels.volumes")]
    volumes: String,
    /// --volume: table of the image
    #[arg(long, value_name = "TABLE", default_value = "voxels.images")]
    images: String,
}

/// The command.
pub fn export(args: &Export) -> Result<ExitCode> {
    let shelf = Shelf::look(&args.results)?;
    let patches_view = args.patches.as_deref().unwrap_or_else(|| shelf.table_of(ALL).map_or("patches", |_| ALL));
    let ending = args.file.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    match ending.as_deref() {
        Some("ply") => {
            let patches: Vec<Patch> = rows(&shelf, patches_view)?;
            let written = whole_file::write(&args.file, |out| ply::write(out, &patches))?;
            say!("{}: {written} patches", args.file.display())?;
        }
        Some("hdf5" | "h5") if args.volume => {
            let rows = volume(&shelf, args)?;
            let images: Vec<Image> = self::rows(&shelf, &args.images)?;
            let [image] = images.as_slice() else {
                bail!("`{}` of {} has {} rows, not one", args.images, args.results.display(), images.len());
            };
            whole_file::write(&args.file, |out| exchange::write_volume(out, image, &rows))?;
            let (columns, depths) = (rows[0].columns, rows[0].depths);
            say!("{}: {columns} columns, {} rows, {depths} depths", args.file.display(), rows.len())?;
        }
        Some("hdf5" | "h5") => {
            let campaign = args.campaign.as_ref();
            let campaign =
                campaign.context("a capture needs to know where laser and sensor are: add --campaign DIR")?;
            let campaign = Campaign::load(campaign)?;
            // Where no patches were solved for, the anchors of campaign.toml do.
            let has_patches = shelf.table_of(patches_view).is_some();
            let patches = if has_patches { rows(&shelf, patches_view)? } else { Vec::new() };
            let (profiles, calibration) = (rows(&shelf, &args.profiles)?, rows(&shelf, &args.calibration)?);
            let capture =
                exchange::capture_of(&profiles, &patches, &calibration, &campaign).map_err(anyhow::Error::msg)?;
            whole_file::write(&args.file, |out| exchange::write_y_tal(out, &capture))?;
            let (histograms, bins) = (capture.pairs.len(), capture.bins());
            say!("{}: {histograms} histograms of {bins} bins of {:.3} ps", args.file.display(), capture.dt_ps)?;
        }
        Some("npy") => {
            let rows = volume(&shelf, args)?;
            let shape = [rows.len() as u64, rows[0].columns as u64, rows[0].depths as u64];
            let values: Vec<f32> = rows.iter().flat_map(|row| row.values.iter().copied()).collect();
            whole_file::write(&args.file, |out| npy::write(out, &shape, &values))?;
            let [rows, columns, depths] = shape;
            say!("{}: {rows} rows, {columns} columns, {depths} depths", args.file.display())?;
        }
        _ => {
            bail!("{}: end the name in .ply for patches, .hdf5 for profiles or .npy for a volume", args.file.display())
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The rows of the volume in order: at least one.
fn volume(shelf: &Shelf, args: &Export) -> Result<Vec<VolumeRow>> {
    let mut rows: Vec<VolumeRow> = rows(shelf, &args.volumes)?;
    rows.sort_by_key(|row| row.grid_row);
    if rows.is_empty() {
        let (volumes, results) = (&args.volumes, args.results.display());
        bail!("`{volumes}` of {results} is empty: run again with --set voxels.volume=true");
    }
    Ok(rows)
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
