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
use periscope::pipeline::spec::{BuiltIn, Spec};
use periscope::simulate::{self, Format, Scene};
use periscope::store::Shelf;
use periscope::tables::{Patch, Row};

use super::interrupt::cancel_on_signals;
use super::output::{count, print_text, say};
use super::report::write_page;
use super::run::Job;

/// Demonstrations: name, scene, pipeline.
const DEMOS: [(&str, &str, &str); 6] = [
    ("around-the-corner", include_str!("../../pipelines/scenes/around-the-corner.toml"), "scene"),
    ("all-visible", include_str!("../../pipelines/scenes/all-visible.toml"), "all-visible"),
    ("rectangles", include_str!("../../pipelines/scenes/rectangles.toml"), "scene"),
    ("hidden-plane", include_str!("../../pipelines/scenes/hidden-plane.toml"), "scene"),
    ("mirror", include_str!("../../pipelines/scenes/paper-mirror.toml"), "mirror"),
    ("barcode", include_str!("../../pipelines/scenes/barcode.toml"), "barcode"),
];
/// Kind of patches that neither laser nor sensor sees.
const HIDDEN: &str = "hidden";
/// Kind of patches without a direct reflection.
const MIRROR: &str = "mirror";

/// Arguments of `demo`.
#[derive(Args)]
pub struct Demo {
    /// Which: around-the-corner (hidden patches, from third bounces), all-visible, or one of the paper's experiments:
    /// rectangles (Fig. 4; half a minute), hidden-plane (Figs. 5 and 6), mirror (Fig. 8 top), barcode (Fig. 8 bottom)
    #[arg(default_value = "around-the-corner")]
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
        bail!("there is no demo `{}`; choose one of {}", args.name, names.join(", "));
    };
    clear(&args.out)?;
    let (campaign, results) = (args.out.join("campaign"), args.out.join("out"));
    let scene = Scene::parse(Path::new(&format!("{name}.toml")), scene)?;
    // The pipeline comes first: by it the next demo knows the folder, also where this one is ended early.
    let pipeline_file = args.out.join(format!("{name}.toml"));
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot create {}", args.out.display()))?;
    let pipeline = BuiltIn::named(pipeline).expect("demos name pipelines of the program");
    std::fs::write(&pipeline_file, pipeline.text)
        .with_context(|| format!("cannot write {}", pipeline_file.display()))?;
    let truth = simulate::simulate(&scene, args.seed, &campaign, Format::Trc)?;
    let spec = Spec::load(&pipeline_file, &[])?;
    let campaigns = [Campaign::load(&campaign)?];
    let shelf = Shelf::open(&results)?;
    let job = Job {
        spec: &spec,
        pipeline: &std::path::absolute(&pipeline_file)?,
        set: &[],
        campaigns: &campaigns,
        shelf: &shelf,
        until: None,
        settings: Settings::default(),
        style: Style::auto(),
        shards: None,
    };
    cancel_on_signals(&job.settings.cancel)?;
    let outcome = job.execute(&mut job.record()?)?;

    say!(
        "Simulated {} of {} each as LeCroy .trc files, and solved for {} from the light that bounced between them.\n",
        count(truth.captures.iter().filter(|capture| &*capture.role == "scene").count(), "capture", "captures"),
        count(scene.captures.shots, "shot", "shots"),
        count(truth.patches.len(), "patch", "patches")
    )?;
    let paper = if spec.steps.iter().any(|step| step.heading == "paper") { rows(&shelf, "paper")? } else { Vec::new() };
    print_text(&comparison(&rows(&shelf, "patches")?, &paper, &truth.patches, &scene)?)?;
    say!("\nTables (Parquet files; Polars, DuckDB and others read them):")?;
    for step in &spec.steps {
        let rows = outcome.tables.get(&step.heading).map_or(0, |record| record.rows(&step.node.tables()[0].name));
        let noun = if rows == 1 { "row " } else { "rows" };
        say!("  {:20} {rows:>6} {noun}  {}", step.heading, results.join(&step.heading).display())?;
    }
    say!("\nThe report, for a browser: {}", write_page(&results)?.display())?;
    // The path by which it was called, so that the printed command works if the program is not on PATH.
    let program = std::env::args().next().unwrap_or_else(|| "periscope".to_owned());
    say!("\nTo run the pipeline again:")?;
    say!("  {program} run {} --campaign {} --out {}", pipeline_file.display(), campaign.display(), results.display())?;
    Ok(ExitCode::SUCCESS)
}

/// Removes the results of an earlier demo; refuses any other folder.
fn clear(out: &Path) -> Result<()> {
    if !out.exists() {
        return Ok(());
    }
    let is_demo = DEMOS.iter().any(|(name, ..)| out.join(format!("{name}.toml")).is_file());
    let ours = is_demo || out.join("campaign/truth").is_dir() || std::fs::read_dir(out)?.next().is_none();
    if !ours {
        bail!("{} exists, and no demo wrote it; choose another folder with --out", out.display());
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

/// An estimated patch, rotated onto the truth, with the true one.
struct Pair<'a> {
    estimate: &'a Patch,
    point: Point,
    truth: &'a Patch,
}

impl Pair<'_> {
    fn error_m(&self) -> f64 {
        (self.point - at(self.truth)).norm()
    }
}

/// A table of estimated and true positions.
fn comparison(estimates: &[Patch], paper: &[Patch], truth: &[Patch], scene: &Scene) -> Result<String> {
    let centre = Point::from(scene.stations["laser"].position_m);
    let prior = &scene.prior;
    // Anchors and rays fix the frame.
    let is_fixed = !prior.anchors.is_empty() || !prior.rays.is_empty();
    let (pairs, lost) = pairs(estimates, truth, centre, is_fixed)?;
    let mut text = String::from(
        "patch           found (x, y, z) in m                  true                          error     sd\n",
    );
    for Pair { estimate, point, truth } in &pairs {
        let error_mm = 1e3 * (point - at(truth)).norm();
        let sd_mm = 1e3 * estimate.sd_m.context("refined patches have a standard deviation")?;
        writeln!(
            text,
            "{:>3} {:8} ({:9.5}, {:9.5}, {:9.5})  ({:7.4}, {:7.4}, {:7.4})  {error_mm:6.3} mm {sd_mm:6.3} mm",
            estimate.patch, estimate.kind, point.x, point.y, point.z, truth.x_m, truth.y_m, truth.z_m
        )?;
    }
    lost.iter().try_for_each(|patch| writeln!(text, "{patch:>3} was not found"))?;
    let best = estimates.iter().filter(|patch| patch.alternative == 0);
    for patch in best.filter(|patch| pairs.iter().all(|pair| pair.estimate.patch != patch.patch)) {
        writeln!(text, "{:>3} {:8} was found where the scene has none", patch.patch, patch.kind)?;
    }
    let of_paper = if paper.is_empty() { Vec::new() } else { self::pairs(paper, truth, centre, is_fixed)?.0 };
    for kind in ["visible", HIDDEN, MIRROR] {
        let of_kind = |pair: &&Pair| &*pair.truth.kind == kind;
        let errors_m = |pairs: &[Pair]| rms(pairs.iter().filter(of_kind).map(Pair::error_m));
        let sds_m = pairs.iter().filter(of_kind).filter_map(|pair| pair.estimate.sd_m);
        let (Some(rms_m), Some(sd_m)) = (errors_m(&pairs), rms(sds_m)) else { continue };
        let (rms_mm, sd_mm) = (1e3 * rms_m, 1e3 * sd_m);
        write!(text, "\n{kind}: rms error {rms_mm:.3} mm, expected from the standard deviations {sd_mm:.3} mm")?;
        if let Some(paper_m) = errors_m(&of_paper) {
            write!(text, "; the paper's method on the same onsets: {:.3} mm", paper_m * 1e3)?;
        }
    }
    writeln!(text)?;
    Ok(text)
}

fn at(patch: &Patch) -> Point {
    Point::new(patch.x_m, patch.y_m, patch.z_m)
}

fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let squares: Vec<f64> = values.map(|value| value * value).collect();
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// Pairs of estimated and true patches, and the numbers of true patches without an estimate.
///
/// Unless the frame is fixed, path lengths do not determine rotations about the laser. The visible patches then define
/// the rotation onto the truth. Hidden patches are numbered in the order of detection, so each goes with the nearest
/// true one.
fn pairs<'a>(
    estimates: &'a [Patch],
    truth: &'a [Patch],
    centre: Point,
    is_fixed: bool,
) -> Result<(Vec<Pair<'a>>, Vec<i32>)> {
    let best = estimates.iter().filter(|patch| patch.alternative == 0);
    let (visible, hidden): (Vec<&Patch>, Vec<&Patch>) = best.partition(|patch| &*patch.kind != HIDDEN);
    let matches =
        |patch: &&'a Patch| truth.iter().find(|truth| truth.patch == patch.patch).map(|truth| (*patch, truth));
    let matches: Option<Vec<_>> = visible.iter().map(matches).collect();
    let matches = matches.context("a visible patch was found that is not in the scene")?;
    if matches.is_empty() {
        bail!("no patch was found; see the table `rejects`");
    }
    let (from, onto): (Vec<Point>, Vec<Point>) = matches.iter().map(|(patch, truth)| (at(patch), at(truth))).unzip();
    let matrix = procrustes::rotation(&from, &onto, centre, true).matrix;
    let place =
        |estimate: &Patch| if is_fixed { at(estimate) } else { procrustes::turn(&matrix, centre, at(estimate)) };
    let turned = |estimate: &'a Patch, truth: &'a Patch| Pair { estimate, point: place(estimate), truth };
    let mut pairs: Vec<Pair> = matches.into_iter().map(|(estimate, truth)| turned(estimate, truth)).collect();
    let mut open: Vec<&Patch> = truth.iter().filter(|patch| &*patch.kind == HIDDEN).collect();
    for estimate in hidden {
        let gap_m = |truth: &'a Patch| turned(estimate, truth).error_m();
        let nearest = (0..open.len()).min_by(|&a, &b| gap_m(open[a]).total_cmp(&gap_m(open[b])));
        pairs.extend(nearest.map(|nearest| turned(estimate, open.remove(nearest))));
    }
    let lost =
        truth.iter().map(|truth| truth.patch).filter(|id| pairs.iter().all(|pair| pair.truth.patch != *id)).collect();
    Ok((pairs, lost))
}
