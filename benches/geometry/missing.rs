//! Pairs missing, the delay known.

use std::time::Instant;

use periscope::geometry::{classical, maximum_likelihood};
use periscope::units::path_m;
use rayon::prelude::*;

use super::measured::{Measured, rms_m, sds_m};
use super::room;
use super::score::{Estimate, Rate};

/// Prints the table.
pub fn print(scenes: u64) {
    let truth = room::rectangles();
    let sd_m = path_m(25.0, 1.0);
    println!(
        "| missing | scenes | open | within 2 bounds | 95 % | of the others, alternative named | rms / bound of those within | one descent only | ms a scene |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for share in [0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85] {
        let one = |seed: u64| {
            let measured = Measured::new(&truth, share, sd_m, 0.0, seed);
            let bound_m = room::bound_m(&truth, &measured.pairs, sds_m(sd_m), 0.0);
            let begin = Instant::now();
            let (points, alternatives) = measured.placed();
            let time = 1e3 * begin.elapsed().as_secs_f64();
            let start = classical::embed(&measured.distances().0, 3);
            let (descent, _) = maximum_likelihood::approach(&measured.problem(start, 0.0), 100, 1e-7);
            (bound_m, rms_m(&points, &truth), rms_m(&descent.points, &truth), !alternatives.is_empty(), time)
        };
        let all: Vec<_> = (0..scenes).into_par_iter().map(one).collect();
        let within = |rms_m: f64, bound_m: f64| bound_m.is_finite() && rms_m < 2.0 * bound_m;
        let right: Vec<f64> = all.iter().filter(|s| within(s.1, s.0)).map(|s| (s.1 / s.0).powi(2)).collect();
        let wrong: Vec<_> = all.iter().filter(|s| s.0.is_finite() && !within(s.1, s.0)).collect();
        let rate = Rate { hits: right.len(), of: all.len() };
        let [low, high] = rate.interval();
        println!(
            "| {:.0} % | {scenes} | {} | {:.3} | {low:.3} to {high:.3} | {} of {} | {:.3} | {:.3} | {:.0} |",
            100.0 * share,
            all.iter().filter(|s| s.0.is_infinite()).count(),
            rate.share(),
            wrong.iter().filter(|s| s.3).count(),
            wrong.len(),
            Estimate::rms(&right).value,
            all.iter().filter(|s| within(s.2, s.0)).count() as f64 / all.len() as f64,
            all.iter().map(|s| s.4).sum::<f64>() / all.len() as f64,
        );
    }
}
