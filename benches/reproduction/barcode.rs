//! The 1-0-1 barcode around the corner: strips out of the sum of their pulses, beside the paper's protocol and the bound.

use super::{barcode_bound::bound_m, barcode_figure};
use crate::barcode::{Barcode, FAST, PIPELINE, SLOW, STRIPS, paper, run};
use crate::score::{Estimate, Rate};

/// The paper prints this as its largest error of a coordinate.
const PRINTED_CM: f64 = 0.9574;
/// Seeds whose bounds stand for those of all.
const BOUNDS: u64 = 8;
/// Seeds of the gap's rates for each of those of the errors.
const GAP_SEEDS: u64 = 15;

/// All parts, or one of: errors, moved, gap, figure.
pub fn study(part: Option<&str>, seeds: u64) {
    let asked = |name: &str| part.is_none_or(|part| part == name);
    if asked("errors") {
        errors(seeds);
    }
    if asked("moved") {
        moved(seeds.max(10));
    }
    if asked("gap") {
        gap(seeds * if part.is_some() { 1 } else { GAP_SEEDS });
    }
    if asked("figure") {
        barcode_figure::write();
    }
}

/// A run of each seed, on all cores. Not in rayon's own threads, which the runs need.
fn draws<T: Send>(seeds: u64, draw: impl Fn(u64) -> T + Sync) -> Vec<T> {
    let threads = std::thread::available_parallelism().map_or(1, |count| count.get() as u64);
    let share = |thread: u64| -> Vec<T> {
        (0..seeds).filter(|seed| seed % threads == thread).map(|seed| draw(1000 + seed)).collect()
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|thread| scope.spawn(move || share(thread))).collect();
        workers.into_iter().flat_map(|worker| worker.join().expect("a draw does not panic")).collect()
    })
}

/// One run.
#[derive(Clone, Copy)]
struct Drawn {
    /// Larger of both strips' errors, and the squares' sum; `None` where a strip is missing.
    error_m: Option<f64>,
    squares_m2: f64,
    /// Squared error over covariance, a coordinate.
    normalised: f64,
    alternatives: bool,
    /// The same of the paper's protocol, which has two scans.
    paper_m: Option<f64>,
}

fn drawn(barcode: &Barcode, seed: u64) -> Drawn {
    let seen = run(barcode, seed, PIPELINE);
    let errors_m = barcode.errors_m(&seen.patches, 0);
    let larger = |errors_m: &[f64]| (errors_m.len() == 2).then(|| errors_m[0].max(errors_m[1]));
    let normalised = seen.patches.iter().filter(|row| row.alternative == 0).filter_map(|row| {
        let s = STRIPS.iter().position(|strip| *strip == row.patch)?;
        let off = nalgebra::Vector2::new(row.x_m, row.y_m) - barcode.strips[s];
        let cov = nalgebra::Matrix2::new(row.cov_xx_m2?, row.cov_xy_m2?, row.cov_xy_m2?, row.cov_yy_m2?);
        Some(0.25 * off.dot(&(cov.try_inverse()? * off)))
    });
    Drawn {
        error_m: larger(&errors_m),
        squares_m2: errors_m.iter().map(|error_m| error_m * error_m).sum(),
        normalised: normalised.sum(),
        alternatives: seen.patches.iter().any(|row| row.alternative > 0),
        paper_m: if barcode.lit.len() == 2 { larger(&barcode.errors_m(&paper(barcode, seed), 0)) } else { None },
    }
}

/// Bound of the summed variances of both strips.
fn square_bound_m2(barcode: &Barcode) -> f64 {
    bound_m(barcode).iter().map(|sd_m| sd_m * sd_m).sum()
}

/// Value below which so large a share lies.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(((values.len() as f64 - 1.0) * share).round() as usize).copied().unwrap_or(f64::NAN)
}

/// A number of a table, where there is one.
fn number(value: f64) -> String {
    if value.is_finite() { format!("{value:.2}") } else { "-".to_owned() }
}

fn print_head() {
    println!(
        "| room | response | scans | diffuser sd (mm) | seeds | both strips placed [95 %] | other places told | error median (cm) | 90 % (cm) | paper's protocol median (cm) | 90 % (cm) | ratio of medians | rms error / bound | squared error / covariance |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
}

/// `bounds_m2`: of each run, or one for all.
fn print_row(room: &str, barcode: &Barcode, runs: &[Drawn], bounds_m2: &[f64]) {
    let found: Vec<&Drawn> = runs.iter().filter(|run| run.error_m.is_some()).collect();
    let mut errors_cm: Vec<f64> = found.iter().filter_map(|run| run.error_m).map(|error_m| 1e2 * error_m).collect();
    let mut paper_cm: Vec<f64> = runs.iter().filter_map(|run| run.paper_m).map(|error_m| 1e2 * error_m).collect();
    let squares_m2: f64 = found.iter().map(|run| run.squares_m2).sum();
    let mean_m2 = |sum_m2: f64, count: usize| sum_m2 / count as f64;
    let over_bound = (mean_m2(squares_m2, found.len()) / mean_m2(bounds_m2.iter().sum(), bounds_m2.len())).sqrt();
    let (median_cm, paper_median_cm) = (quantile(&mut errors_cm, 0.5), quantile(&mut paper_cm, 0.5));
    println!(
        "| {room} | {} | {} | {} | {} | {} | {} | {median_cm:.3} | {:.3} | {} | {} | {} | {:.2} | {} |",
        if barcode.response == SLOW { "G250" } else { "E" },
        barcode.lit.len(),
        1e3 * barcode.anchor_sd_m,
        runs.len(),
        Rate::of(runs.iter().map(|run| run.error_m.is_some())),
        runs.iter().filter(|run| run.alternatives).count(),
        quantile(&mut errors_cm, 0.9),
        number(paper_median_cm),
        number(quantile(&mut paper_cm, 0.9)),
        number(paper_median_cm / median_cm),
        over_bound,
        Estimate::mean(&found.iter().map(|run| run.normalised).collect::<Vec<_>>()),
    );
}

/// The demo's room, mirrors turned by hand anew for each seed.
fn errors(seeds: u64) {
    println!("Larger of both strips' errors; the paper prints {PRINTED_CM} cm for its own scene.\n");
    print_head();
    for scans in [2, 5] {
        for response in [SLOW, FAST] {
            for anchor_sd_m in [0.0, 5e-4, 1e-3] {
                let room = |seed: u64| Barcode { anchor_sd_m, response, ..Barcode::new(scans).turned(seed) };
                let bounds_m2 = draws(BOUNDS, |seed| square_bound_m2(&room(seed)));
                print_row("demo", &room(0), &draws(seeds, |seed| drawn(&room(seed), seed)), &bounds_m2);
            }
        }
    }
}

/// Rooms with everything moved.
fn moved(seeds: u64) {
    println!();
    print_head();
    for scans in [2, 5] {
        let room = |seed: u64| Barcode { anchor_sd_m: 5e-4, ..Barcode::moved(scans, seed) };
        let bounds_m2 = draws(seeds, |seed| square_bound_m2(&room(seed)));
        print_row("moved", &room(1000), &draws(seeds, |seed| drawn(&room(seed), seed)), &bounds_m2);
    }
}

/// What is said of the gap, where nothing is there and where something is.
fn gap(seeds: u64) {
    println!("\n| gap | response | scans | seeds | both strips placed | free [95 %] | occupied [95 %] | open |");
    println!("|---|---|---|---|---|---|---|---|");
    for (scans, response) in [(2, SLOW), (2, FAST), (5, SLOW), (5, FAST)] {
        for occupied in [false, true] {
            let runs = draws(seeds, |seed| {
                let barcode = Barcode { anchor_sd_m: 5e-4, response, occupied, ..Barcode::new(scans).turned(seed) };
                let seen = run(&barcode, seed, PIPELINE);
                let verdict = seen.gaps.first().map_or("none", |gap| match &*gap.verdict {
                    "free" => "free",
                    "occupied" => "occupied",
                    _ => "open",
                });
                (barcode.errors_m(&seen.patches, 0).iter().filter(|error_m| **error_m < 0.02).count() == 2, verdict)
            });
            let is = |wanted: &str| Rate::of(runs.iter().map(|(_, verdict)| *verdict == wanted));
            println!(
                "| {} | {} | {scans} | {seeds} | {} | {} | {} | {} |",
                if occupied { "a third strip" } else { "free" },
                if response == SLOW { "G250" } else { "E" },
                Rate::of(runs.iter().map(|(placed, _)| *placed)),
                is("free"),
                is("occupied"),
                runs.iter().filter(|(_, verdict)| *verdict == "open").count(),
            );
        }
    }
}
