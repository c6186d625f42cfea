//! The 1-0-1 barcode around the corner: strips out of the sum of their pulses, compared with the paper's protocol and
//! the bound.

use periscope::campaign::Role;

use super::barcode_bound::{bound_m, share_bound};
use super::{barcode_figure, draws, quantile};
use crate::barcode::{Barcode, FAST, PIPELINE, SLOW, STRIPS, paper, run};
use crate::score::{Estimate, Rate};

/// The paper prints this as its largest error of a coordinate.
const PRINTED_CM: f64 = 0.9574;
/// For this many seeds of free gaps there is one of an occupied gap.
const OCCUPIED: u64 = 3;
/// And for this many seeds of two scans, one of an object next to the strips.
const BESIDE: u64 = 10;
/// A signal three times as strong.
const STRONG: f64 = 300.0;
/// Seeds whose median bound is printed next to that of all.
const BOUNDS: u64 = 20;
/// A strip counts as placed within this.
const PLACED_M: f64 = 0.02;

/// All parts, or one of: errors, moved, gap, figure; of both responses or one.
pub fn study(part: Option<&str>, response: Option<&str>, seeds: u64) {
    let is_selected = |name: &str| part.is_none_or(|part| part == name);
    let has_rows = |of: &str| response.is_none_or(|response| response == name(of));
    if is_selected("errors") {
        errors(seeds, has_rows);
    }
    if is_selected("moved") {
        moved(seeds, has_rows);
    }
    if is_selected("gap") {
        gap(seeds, has_rows);
    }
    if is_selected("figure") {
        barcode_figure::write();
    }
}

/// One run.
#[derive(Clone, Copy)]
struct Drawn {
    /// Largest error of a coordinate; `None` where a strip is missing.
    error_m: Option<f64>,
    /// Squared distances of both strips over the bound of their mean.
    over_bound: f64,
    /// Squared error over covariance, a coordinate.
    normalised: f64,
    alternatives: bool,
    /// The same of the paper's protocol, which has two scans.
    paper_m: Option<f64>,
}

fn drawn(barcode: &Barcode, seed: u64) -> Drawn {
    let seen = run(barcode, seed, PIPELINE);
    let errors_m = barcode.errors_m(&seen.patches, 0);
    let squares_m2: f64 = errors_m.iter().map(|error_m| error_m * error_m).sum();
    let normalised = seen.patches.iter().filter(|row| row.alternative == 0).filter_map(|row| {
        let s = STRIPS.iter().position(|strip| *strip == row.patch)?;
        let off = nalgebra::Vector2::new(row.x_m, row.y_m) - barcode.strips[s];
        let cov = nalgebra::Matrix2::new(row.cov_xx_m2?, row.cov_xy_m2?, row.cov_xy_m2?, row.cov_yy_m2?);
        Some(0.25 * off.dot(&(cov.try_inverse()? * off)))
    });
    Drawn {
        error_m: barcode.largest_m(&seen.patches),
        over_bound: squares_m2 / bound_m(barcode).iter().map(|sd_m| sd_m * sd_m).sum::<f64>(),
        normalised: normalised.sum(),
        alternatives: seen.patches.iter().any(|row| row.alternative > 0),
        paper_m: if barcode.lit.len() == 2 { barcode.largest_m(&paper(barcode, seed)) } else { None },
    }
}

fn print_head() {
    println!(
        "| room | response | scans | diffuser sd (mm) | seeds | both strips placed [95 %] | other places told | error median (cm) | 90 % (cm) | paper's protocol median (cm) | 90 % (cm) | ratio of medians | rms error / bound [95 %] | squared error / covariance [95 %] |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
}

fn print_row(room: &str, barcode: &Barcode, runs: &[Drawn]) {
    let placed: Vec<&Drawn> = runs.iter().filter(|run| run.error_m.is_some()).collect();
    let in_cm = |errors_m: Vec<f64>| -> Vec<f64> { errors_m.iter().map(|error_m| 1e2 * error_m).collect() };
    let errors_cm = in_cm(placed.iter().filter_map(|run| run.error_m).collect());
    let paper_cm = in_cm(runs.iter().filter_map(|run| run.paper_m).collect());
    let of_paper = if paper_cm.is_empty() {
        "- | - | -".to_owned()
    } else {
        let (median_cm, most_cm) = (quantile(&paper_cm, 0.5), quantile(&paper_cm, 0.9));
        format!("{median_cm:.2} | {most_cm:.2} | {:.1}", median_cm / quantile(&errors_cm, 0.5))
    };
    let over_bound = Estimate::rms(&placed.iter().map(|run| run.over_bound).collect::<Vec<_>>());
    println!(
        "| {room} | {} | {} | {} | {} | {} | {} | {:.3} | {:.3} | {of_paper} | {over_bound} | {} |",
        name(barcode.response),
        barcode.lit.len(),
        1e3 * barcode.anchor_sd_m,
        runs.len(),
        Rate::of(runs.iter().map(|run| run.error_m.is_some())),
        runs.iter().filter(|run| run.alternatives).count(),
        quantile(&errors_cm, 0.5),
        quantile(&errors_cm, 0.9),
        Estimate::mean(&placed.iter().map(|run| run.normalised).collect::<Vec<_>>()),
    );
}

fn name(response: &str) -> &'static str {
    if response == SLOW { "G250" } else { "E" }
}

/// The demo's room, mirrors turned by hand anew for each seed.
fn errors(seeds: u64, has_rows: impl Fn(&str) -> bool) {
    println!("Largest error of a coordinate; the paper prints {PRINTED_CM} cm for its own scene.\n");
    let shots: Vec<f64> = draws(seeds, |seed| {
        let barcode = Barcode::new(2).turned(seed);
        let scene = barcode.parsed();
        let of_scene = barcode.laboratory(&scene, seed).shootings;
        of_scene
            .iter()
            .filter(|shooting| shooting.role == Role::Scene)
            .map(|shooting| shooting.shots as f64)
            .fold(0.0, f64::max)
    });
    println!("Records a scan: median {}, 90 % {}.\n", quantile(&shots, 0.5), quantile(&shots, 0.9));
    print_head();
    let rows = [(2, SLOW), (2, FAST), (5, SLOW), (5, FAST)];
    for (scans, response) in rows.into_iter().filter(|(_, response)| has_rows(response)) {
        for anchor_sd_m in [0.0, 5e-4, 1e-3] {
            let room = |seed: u64| Barcode { anchor_sd_m, response, ..Barcode::new(scans).turned(seed) };
            print_row("demo", &room(1), &draws(seeds, |seed| drawn(&room(seed), seed)));
        }
    }
}

/// Rooms with everything moved.
fn moved(seeds: u64, has_rows: impl Fn(&str) -> bool) {
    println!();
    print_head();
    let rows = [(2, SLOW), (2, FAST), (5, SLOW)];
    for (scans, response) in rows.into_iter().filter(|(_, response)| has_rows(response)) {
        let room = |seed: u64| Barcode { anchor_sd_m: 5e-4, response, ..Barcode::moved(scans, seed) };
        print_row("moved", &room(1), &draws(seeds, |seed| drawn(&room(seed), seed)));
    }
}

/// What the stage reports of the gap, where it is free and where it is occupied.
fn gap(seeds: u64, has_rows: impl Fn(&str) -> bool) {
    println!(
        "\n| gap | response | scans | SNR | seeds | both strips placed [95 %] | free [95 %] | occupied [95 %] | open | sd of the share, median | its bound |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let rows = [(2, SLOW, 100.0), (2, FAST, 100.0), (5, SLOW, 100.0), (5, FAST, 100.0), (2, SLOW, STRONG)];
    for (scans, response, snr) in rows.into_iter().filter(|(_, response, _)| has_rows(response)) {
        for occupied in [false, true] {
            let room = |seed: u64| {
                let turned = Barcode::new(scans).turned(seed);
                Barcode { anchor_sd_m: 5e-4, response, occupied, snr, ..turned }
            };
            let is_beside = scans > 2 || snr > 100.0;
            let seeds = if is_beside { seeds.div_ceil(BESIDE) } else { seeds };
            let runs = draws(if occupied && !is_beside { seeds.div_ceil(OCCUPIED) } else { seeds }, |seed| {
                let seen = run(&room(seed), seed, PIPELINE);
                let errors_m = room(seed).errors_m(&seen.patches, 0);
                let is_placed = errors_m.iter().filter(|error_m| **error_m < PLACED_M).count() == 2;
                let gap = seen.gaps.first();
                (
                    is_placed,
                    gap.map(|gap| gap.verdict.to_string()),
                    gap.and_then(|gap| gap.share_sd).unwrap_or(f64::NAN),
                )
            });
            let is = |wanted: &str| Rate::of(runs.iter().map(|(_, verdict, _)| verdict.as_deref() == Some(wanted)));
            println!(
                "| {} | {} | {scans} | {snr} | {} | {} | {} | {} | {} | {:.3} | {:.3} |",
                if occupied { "a third strip" } else { "free" },
                name(response),
                runs.len(),
                Rate::of(runs.iter().map(|(placed, ..)| *placed)),
                is("free"),
                is("occupied"),
                is("open").hits,
                quantile(&runs.iter().map(|(.., sd)| *sd).collect::<Vec<_>>(), 0.5),
                quantile(&draws(BOUNDS, |seed| share_bound(&Barcode { occupied: false, ..room(seed) })), 0.5),
            );
        }
    }
}
