//! `periscope demo`.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args;
use periscope::campaign::Campaign;
use periscope::geometry::{Point, procrustes};
use periscope::pipeline::progress::Style;
use periscope::pipeline::run::Settings;
use periscope::pipeline::spec::Spec;
use periscope::simulate::{self, Format, Scene};
use periscope::store::Shelf;
use periscope::tables::{Patch, Row};

use super::run::{execute, use_threads};

/// Demonstrations: name, scene, pipeline.
const DEMOS: [(&str, &str, &str); 1] = [(
    "all-visible",
    include_str!("../../pipelines/scenes/all-visible.toml"),
    include_str!("../../pipelines/all-visible.toml"),
)];

/// Arguments of `demo`.
#[derive(Args)]
pub struct Demo {
    /// Which: all-visible
    #[arg(default_value = "all-visible")]
    name: String,
    /// Folder for campaign and results; what an earlier demo left there is replaced
    #[arg(long, value_name = "DIR", default_value = "periscope-demo")]
    out: PathBuf,
    /// Seed of the simulation
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// The command.
pub fn demo(args: &Demo) -> Result<ExitCode> {
    let Some((name, scene, pipeline)) = DEMOS.iter().find(|(name, ..)| *name == args.name) else {
        let names: Vec<&str> = DEMOS.iter().map(|(name, ..)| *name).collect();
        bail!("there is no demo `{}`; there is {}", args.name, names.join(", "));
    };
    use_threads(None)?;
    clear(&args.out)?;
    let (campaign, results) = (args.out.join("campaign"), args.out.join("out"));
    let scene = Scene::parse(Path::new(&format!("{name}.toml")), scene)?;
    let truth = simulate::simulate(&scene, args.seed, &campaign, Format::Trc)?;
    let pipeline_file = args.out.join(format!("{name}.toml"));
    std::fs::write(&pipeline_file, pipeline).with_context(|| format!("cannot write {}", pipeline_file.display()))?;
    let spec = Spec::parse(&pipeline_file.display().to_string(), pipeline, &[])?;
    let campaigns = [Campaign::load(&campaign)?];
    let shelf = Shelf::open(&results)?;
    let outcome = execute(&spec, &campaigns, &shelf, None, &Settings::default(), Style::auto())?;

    println!(
        "Simulated {} captures of {} shots each as LeCroy .trc files, and solved for {} patches from the light that bounced between them.\n",
        truth.captures.iter().filter(|capture| &*capture.role == "scene").count(),
        scene.captures.shots,
        truth.patches.len()
    );
    print!("{}", comparison(&rows(&shelf, "patches")?, &rows(&shelf, "paper")?, &truth.patches, &scene)?);
    println!("\nTables (Parquet; read them with Polars, DuckDB or anything else):");
    for step in &spec.steps {
        let rows = outcome.tables.get(&step.heading).map_or(0, |record| record.rows(&step.node.tables()[0].name));
        println!("  {:20} {rows:>6} rows  {}", step.heading, results.join(&step.heading).display());
    }
    // As it was called, so that the line works where the program is not on the path.
    let program = std::env::args().next().unwrap_or_else(|| "periscope".to_owned());
    println!("\nThe same again, from the files:");
    println!(
        "  {program} run {} --campaign {} --out {}",
        pipeline_file.display(),
        campaign.display(),
        results.display()
    );
    Ok(ExitCode::SUCCESS)
}

/// Removes what an earlier demo left; refuses a folder that is not one.
fn clear(out: &Path) -> Result<()> {
    if !out.exists() {
        return Ok(());
    }
    let ours = out.join("campaign/truth").is_dir() || std::fs::read_dir(out)?.next().is_none();
    if !ours {
        bail!("{} is there and was not made by a demo; choose another folder with --out", out.display());
    }
    std::fs::remove_dir_all(out)
        .with_context(|| format!("cannot remove what an earlier demo left in {}", out.display()))
}

fn rows<R: Row>(shelf: &Shelf, view: &str) -> Result<Vec<R>> {
    let mut rows = Vec::new();
    for batch in shelf.batches(view)? {
        rows.extend(R::rows(&batch)?);
    }
    Ok(rows)
}

/// Found beside true positions. Path lengths say nothing of rotations about the laser, so what was found is turned onto the truth first.
fn comparison(found: &[Patch], paper: &[Patch], truth: &[Patch], scene: &Scene) -> Result<String> {
    let centre = Point::from(scene.stations["laser"].position_m);
    let (turned, rms_m) = turned_onto(found, truth, centre)?;
    let mut text =
        String::from("patch      found (x, y, z) in m                  true                          error     sd\n");
    for ((patch, point), row) in turned.iter().zip(found) {
        let truth =
            truth.iter().find(|truth| truth.patch == *patch).context("a patch was found that is not in the scene")?;
        let error_mm = 1e3 * (point - Point::new(truth.x_m, truth.y_m, truth.z_m)).norm();
        let sd_mm = 1e3 * row.sd_m.context("refined patches have a standard deviation")?;
        writeln!(
            text,
            "{patch:>5}  ({:9.5}, {:9.5}, {:9.5})  ({:7.4}, {:7.4}, {:7.4})  {error_mm:6.3} mm {sd_mm:6.3} mm",
            point.x, point.y, point.z, truth.x_m, truth.y_m, truth.z_m
        )?;
    }
    let sd_m =
        (found.iter().filter_map(|row| row.sd_m).map(|sd_m| sd_m * sd_m).sum::<f64>() / found.len() as f64).sqrt();
    let paper_m = turned_onto(paper, truth, centre)?.1;
    writeln!(
        text,
        "\nrms error {:.3} mm, expected from the standard deviations {:.3} mm; the paper's Algorithm 1 on the same onsets: {:.3} mm",
        rms_m * 1e3,
        sd_m * 1e3,
        paper_m * 1e3
    )?;
    Ok(text)
}

fn turned_onto(found: &[Patch], truth: &[Patch], centre: Point) -> Result<(Vec<(i32, Point)>, f64)> {
    let at = |patch: &Patch| Point::new(patch.x_m, patch.y_m, patch.z_m);
    let target = |patch: &Patch| truth.iter().find(|truth| truth.patch == patch.patch).map(at);
    let targets: Option<Vec<Point>> = found.iter().map(target).collect();
    let targets = targets.context("a patch was found that is not in the scene")?;
    if found.is_empty() {
        bail!("no patch was found; see the table `rejects`");
    }
    let points: Vec<Point> = found.iter().map(at).collect();
    let fit = procrustes::rotation(&points, &targets, centre, true);
    let turned = found.iter().map(|patch| (patch.patch, procrustes::turn(&fit.matrix, centre, at(patch)))).collect();
    Ok((turned, fit.rms_m))
}
