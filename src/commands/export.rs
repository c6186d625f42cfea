//! `periscope export`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args;
use periscope::campaign::Campaign;
use periscope::exchange::{self, las, ply};
use periscope::formats::npy;
use periscope::store::Shelf;
use periscope::tables::{Echo, Image, Patch, Row, SurfacePoint, Vertex, VolumeRow};

use super::output::say;
use super::whole_file;

/// Table of all patches, weak ones among them, where a pipeline searches for these.
const ALL: &str = "all_patches";

/// Table of points of a surface with the shapes that they lie on, where a pipeline looks for these.
const ON_SHAPES: &str = "shapes.points";

/// Arguments of `export`.
#[derive(Args)]
#[command(after_help = "Conventions of both files: docs/interoperation.md")]
pub struct Export {
    /// Result folder
    results: PathBuf,
    /// File to write: .ply for the patches as a point cloud (--surface-points: the points of a surface; --mesh: the
    /// surface between them; where there are no patches but echoes of a lidar, or with --echoes: these), .las for
    /// echoes of a lidar, .hdf5 for the profiles as a capture of y-tal (--volume: the volume of an image), .npy for
    /// the volume of an image (--surface-points, --mesh: the points, the nodes)
    file: PathBuf,
    /// Table of patches [default: `all_patches` if there is one, else `patches`]
    #[arg(long, value_name = "TABLE")]
    patches: Option<String>,
    /// .ply, .npy: points of a surface from this table, in place of patches and volume [default: `shapes.points` if
    /// there is one, else `surface`]
    #[arg(long, value_name = "TABLE", num_args = 0..=1, default_missing_value = "")]
    surface_points: Option<String>,
    /// .ply, .npy: the nodes of hidden surfaces from this table, .ply with the faces between them [default:
    /// `meshes.vertices`]
    #[arg(long, value_name = "TABLE", num_args = 0..=1, default_missing_value = "meshes.vertices", conflicts_with = "surface_points")]
    mesh: Option<String>,
    /// .ply, .las: echoes of a lidar from this table, in place of patches [default: `echoes`]
    #[arg(long, value_name = "TABLE", num_args = 0..=1, default_missing_value = "echoes")]
    echoes: Option<String>,
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
    let found = shelf.table_of(ALL)?.map_or("patches", |_| ALL);
    let patches_view = args.patches.as_deref().unwrap_or(found);
    let echoes_view = echoes_view(&shelf, args)?;
    let ending = args.file.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    match ending.as_deref() {
        Some("ply") if args.surface_points.is_some() => {
            let points = surface(&shelf, args)?;
            whole_file::write(&args.file, |out| ply::write_surface(out, &points))?;
            say!("{}: {} points", args.file.display(), points.len())?;
        }
        Some("npy") if args.surface_points.is_some() => {
            write_numbers(args, &surface(&shelf, args)?, "points", ply::surface_numbers)?;
        }
        Some("ply") if let Some(view) = &args.mesh => {
            let vertices = vertices(&shelf, args, view)?;
            let faces = whole_file::write(&args.file, |out| ply::write_mesh(out, &vertices))?;
            say!("{}: {} nodes, {faces} faces", args.file.display(), vertices.len())?;
        }
        Some("npy") if let Some(view) = &args.mesh => {
            write_numbers(args, &vertices(&shelf, args, view)?, "nodes", ply::mesh_numbers)?;
        }
        Some(ending @ ("ply" | "las")) if let Some(view) = &echoes_view => write_echoes(&shelf, args, view, ending)?,
        Some("ply") => {
            let patches: Vec<Patch> = rows(&shelf, patches_view)?;
            let written = whole_file::write(&args.file, |out| ply::write(out, &patches))?;
            say!("{}: {written} patches", args.file.display())?;
        }
        Some("hdf5" | "h5") if args.volume => write_volume(&shelf, args)?,
        Some("hdf5" | "h5") => {
            let campaign = args.campaign.as_ref();
            let campaign =
                campaign.context("a capture needs to know where laser and sensor are: add --campaign DIR")?;
            let campaign = Campaign::load(campaign)?;
            // Where no patches were solved for, the anchors of campaign.toml do.
            let has_patches = shelf.table_of(patches_view)?.is_some();
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
            let file = args.file.display();
            bail!(
                "{file}: end the name in .ply for patches or points, .las for echoes of a lidar (--echoes names their table), \
                 .hdf5 for profiles or .npy for a volume or points"
            )
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The table of echoes: the one that is named, or that of a lidar's results, which have no patches.
fn echoes_view(shelf: &Shelf, args: &Export) -> Result<Option<String>> {
    let is_of_lidar = args.patches.is_none() && shelf.table_of("patches")?.is_none();
    Ok(match &args.echoes {
        Some(view) => Some(view.clone()),
        None if is_of_lidar => shelf.table_of("echoes")?.map(|_| "echoes".to_owned()),
        None => None,
    })
}

fn write_echoes(shelf: &Shelf, args: &Export, view: &str, ending: &str) -> Result<()> {
    let echoes: Vec<Echo> = rows(shelf, view)?;
    whole_file::write(&args.file, |out| match ending {
        "las" => las::write(out, &echoes),
        _ => ply::write_echoes(out, &echoes),
    })?;
    say!("{}: {} echoes", args.file.display(), echoes.len())
}

fn write_volume(shelf: &Shelf, args: &Export) -> Result<()> {
    let rows = volume(shelf, args)?;
    let images: Vec<Image> = self::rows(shelf, &args.images)?;
    let [image] = images.as_slice() else {
        bail!("`{}` of {} has {} rows, not one", args.images, args.results.display(), images.len());
    };
    whole_file::write(&args.file, |out| exchange::write_volume(out, image, &rows))?;
    let (columns, depths) = (rows[0].columns, rows[0].depths);
    say!("{}: {columns} columns, {} rows, {depths} depths", args.file.display(), rows.len())
}

/// Numbers of each row in a row of an array.
fn write_numbers<R, const N: usize>(args: &Export, rows: &[R], what: &str, numbers: fn(&R) -> [f64; N]) -> Result<()> {
    let values: Vec<f64> = rows.iter().flat_map(numbers).collect();
    whole_file::write(&args.file, |out| npy::write(out, &[rows.len() as u64, N as u64], &values))?;
    say!("{}: {} {what}, {N} numbers each", args.file.display(), rows.len())
}

/// Points of the surface: at least one.
fn surface(shelf: &Shelf, args: &Export) -> Result<Vec<SurfacePoint>> {
    let given = args.surface_points.as_deref().filter(|view| !view.is_empty());
    let found = shelf.table_of(ON_SHAPES)?.map_or("surface", |_| ON_SHAPES);
    let view = given.unwrap_or(found);
    let points: Vec<SurfacePoint> = rows(shelf, view)?;
    if points.is_empty() {
        let results = args.results.display();
        bail!("`{view}` of {results} has no points: `rejects` and `decisions` of the same folder say why");
    }
    Ok(points)
}

/// Nodes of hidden surfaces: at least one.
fn vertices(shelf: &Shelf, args: &Export, view: &str) -> Result<Vec<Vertex>> {
    let vertices: Vec<Vertex> = rows(shelf, view)?;
    if vertices.is_empty() {
        let results = args.results.display();
        bail!(
            "`{view}` of {results} has no nodes: no smooth surface explains first light; --surface-points has its points"
        );
    }
    Ok(vertices)
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
    let found = shelf.table_of(view)?;
    match found.as_deref() {
        Some(table) if table == R::TABLE => {}
        Some(table) => bail!("`{view}` of {} is a table `{table}`, not `{}`", shelf.out().display(), R::TABLE),
        None => bail!(
            "{} has no table `{view}`; `periscope tables` lists what it has, --{} names another",
            shelf.out().display(),
            R::TABLE.replace('_', "-")
        ),
    }
    let mut rows = Vec::new();
    for batch in shelf.batches(view)? {
        rows.extend(R::rows(&batch)?);
    }
    Ok(rows)
}
