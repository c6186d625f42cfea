//! Stage `refine`: many patches.

use periscope::geometry::{Point, procrustes};
use periscope::stages::refine::Refine;
use periscope::stages::stage::{Apply, BesideTables};
use periscope::tables::{Label, Patch, Row};
use periscope::units::time_ps;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::curve::Curve;
use super::{context, normal};

const SD_PS: f64 = 2.0;
/// Standard deviation of each coordinate of the start.
const START_SD_M: f64 = 0.003;
/// Partners of a patch.
const PARTNERS: usize = 12;
/// Patches up to which the normal matrix is in memory.
const DENSE_MAX: usize = periscope::geometry::maximum_likelihood::DENSE_MAX;

/// Which pairs are captured, both ways.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Pairs {
    /// Each patch with the 12 nearest.
    Near,
    /// Each patch with 12 drawn at random.
    Scattered,
    /// All.
    All,
}

/// Patches on three walls.
fn room(count: usize, rng: &mut ChaCha8Rng) -> Vec<Point> {
    let on = |n: usize, u: f64, v: f64| match n % 3 {
        0 => Point::new(-1.2 + 2.0 * u, 2.6, -0.8 + 1.6 * v),
        1 => Point::new(1.1, 1.0 + 1.4 * u, -0.8 + 1.6 * v),
        _ => Point::new(-1.0 + 1.8 * u, 1.6 + 0.7 * v, -0.9),
    };
    (0..count).map(|n| on(n, rng.random_range(0.0..1.0), rng.random_range(0.0..1.0))).collect()
}

fn partners(pairs: Pairs, points: &[Point], patch: usize, rng: &mut ChaCha8Rng) -> Vec<usize> {
    let mut others: Vec<usize> = (0..points.len()).filter(|&other| other != patch).collect();
    match pairs {
        Pairs::All => others.retain(|&other| other > patch),
        Pairs::Near => {
            let apart_m = |a: &usize| (points[*a] - points[patch]).norm();
            others.select_nth_unstable_by(PARTNERS, |a, b| apart_m(a).total_cmp(&apart_m(b)));
            others.truncate(PARTNERS);
        }
        Pairs::Scattered => others = (0..PARTNERS).map(|_| others[rng.random_range(0..others.len())]).collect(),
    }
    others
}

fn label(path: Vec<i32>, points: &[Point], rng: &mut ChaCha8Rng) -> Label {
    let at = |patch: &i32| points[*patch as usize - 1];
    let (end, way_m) =
        path.iter().fold((Point::origin(), 0.0), |(from, way_m), patch| (at(patch), way_m + (at(patch) - from).norm()));
    Label {
        campaign: "c".into(),
        sensor: "s1".into(),
        lit: path[0],
        seen: path[path.len() - 1],
        rank: 1,
        time_ps: time_ps(way_m + end.coords.norm(), 1.0) + SD_PS * normal(rng),
        time_sd_ps: SD_PS,
        width_ps: Some(0.0),
        bounces: path.len() as i32,
        path: Some(path),
        probability: 1.0,
        ..Label::default()
    }
}

fn labels(pairs: Pairs, points: &[Point], rng: &mut ChaCha8Rng) -> Vec<Label> {
    let mut labels = Vec::new();
    for patch in 0..points.len() {
        labels.push(label(vec![patch as i32 + 1], points, rng));
        for other in partners(pairs, points, patch, rng) {
            let pair = [patch as i32 + 1, other as i32 + 1];
            labels.push(label(pair.to_vec(), points, rng));
            labels.push(label(vec![pair[1], pair[0]], points, rng));
        }
    }
    labels
}

/// The start, as table `patches`.
fn start(points: &[Point], rng: &mut ChaCha8Rng) -> BesideTables {
    let mut off_m = || START_SD_M * normal(rng);
    let patch = |(n, point): (usize, &Point)| Patch {
        patch: n as i32 + 1,
        kind: "visible".into(),
        x_m: point.x + off_m(),
        y_m: point.y + off_m(),
        z_m: point.z + off_m(),
        onsets: 1,
        ..Patch::default()
    };
    let patches: Vec<Patch> = points.iter().enumerate().map(patch).collect();
    BesideTables::from([("patches".to_owned(), vec![Patch::to_batch(&patches)])])
}

/// Prints the table.
pub fn print(pairs: Pairs, sizes: &[usize]) {
    let name = match pairs {
        Pairs::Near => "each with the 12 nearest",
        Pairs::Scattered => "each with 12 others anywhere",
        Pairs::All => "all pairs",
    };
    println!("\n| patches, {name} | labels | s (min, median, max) | rms error (mm) |\n|---|---|---|---|");
    let mut curve = Curve::default();
    for &count in sizes {
        let mut rng = ChaCha8Rng::seed_from_u64(count as u64);
        let truth = room(count, &mut rng);
        let labels = labels(pairs, &truth, &mut rng);
        let stage = Refine::default();
        let context = context(&stage, &start(&truth, &mut rng));
        let mut rms_m = f64::NAN;
        let seconds = curve.time(count, || {
            let rows = stage.apply(&context, labels.clone()).expect("a solution").rows;
            let points: Vec<Point> = rows.iter().take(count).map(|row| Point::new(row.x_m, row.y_m, row.z_m)).collect();
            rms_m = procrustes::rotation(&points, &truth, Point::origin(), true).rms_m;
        });
        println!("| {count} | {} | {seconds} | {:.3} |", labels.len(), 1e3 * rms_m);
    }
    curve.print(sizes[0], DENSE_MAX);
    curve.print(DENSE_MAX + 1, sizes[sizes.len() - 1]);
}
