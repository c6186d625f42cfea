//! Squared errors of whole scenes in units of their bound against the chi-square distribution.

use periscope::geometry::{Point, procrustes};
use periscope::units::path_m;
use rayon::prelude::*;

use super::measured::{Measured, sds_m};
use super::room;

/// Prints the table.
pub fn print(scenes: u64) {
    let truth = room::rectangles();
    println!(
        "| noise (ps) | scenes | degrees of freedom | mean / dof | variance / 2 dof | Kolmogorov-Smirnov distance | p |\n|---|---|---|---|---|---|---|"
    );
    for noise_ps in [100.0, 25.0] {
        let sd_m = path_m(noise_ps, 1.0);
        let fisher = room::fisher(&truth, &room::all_pairs(truth.len()), sds_m(sd_m), 0.0);
        let one = |seed: u64| {
            let measured = Measured::new(&truth, 0.0, sd_m, 0.0, 10_000 + seed);
            let (points, _) = measured.placed();
            let fit = procrustes::rotation(&points, &truth, Point::origin(), true);
            let errors: Vec<f64> = points
                .iter()
                .zip(&truth)
                .flat_map(|(point, truth)| {
                    let error = procrustes::turn(&fit.matrix, Point::origin(), *point) - truth;
                    [error.x, error.y, error.z]
                })
                .collect();
            let row = |i: usize| (0..errors.len()).map(|j| fisher[(i, j)] * errors[j]).sum::<f64>();
            (0..errors.len()).map(|i| errors[i] * row(i)).sum::<f64>()
        };
        let mut squares: Vec<f64> = (0..scenes).into_par_iter().map(one).collect();
        squares.sort_by(f64::total_cmp);
        let (n, freedom) = (scenes as f64, 3 * truth.len() - 3);
        // For even degrees of freedom the distribution is a finite sum.
        let below = |x: f64| {
            let mut term = (-0.5 * x).exp();
            let mut above = term;
            for k in 1..freedom / 2 {
                term *= 0.5 * x / k as f64;
                above += term;
            }
            1.0 - above
        };
        let distance = squares.iter().enumerate().fold(0.0_f64, |most, (i, &x)| {
            most.max((below(x) - i as f64 / n).abs()).max((below(x) - (i + 1) as f64 / n).abs())
        });
        let lambda = (n.sqrt() + 0.12 + 0.11 / n.sqrt()) * distance;
        let p: f64 = (1..100)
            .map(|k: i32| 2.0 * (-1.0_f64).powi(k - 1) * (-2.0 * f64::from(k * k) * lambda * lambda).exp())
            .sum();
        let mean = squares.iter().sum::<f64>() / n;
        let variance = squares.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
        println!(
            "| {noise_ps} | {scenes} | {freedom} | {:.4} | {:.3} | {distance:.4} | {:.3} |",
            mean / freedom as f64,
            variance / (2 * freedom) as f64,
            p.min(1.0)
        );
    }
}
