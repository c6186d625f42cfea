//! Every method where all pairs are measured.

use std::fmt::Write as _;
use std::process::Command;
use std::time::Instant;

use periscope::geometry::{Point, classical, iso_embed, maximum_likelihood, reestimate, smacof};
use periscope::units::path_m;
use periscope_comparison::semidefinite;
use rayon::prelude::*;

use super::measured::{Measured, rms_m, sds_m};
use super::room;
use super::score::Estimate;

/// Prints the table.
pub fn print(seeds: u64) {
    let truth = room::rectangles();
    let pairs = room::all_pairs(truth.len());
    println!(
        "| noise (ps) | delay | bound (mm) | method | rms / bound [95 %] | time (ms) |\n|---|---|---|---|---|---|"
    );
    for (noise_ps, delay_ps) in [(100.0, 0.0), (25.0, 0.0), (25.0, 10.0)] {
        let (sd_m, delay_sd_m) = (path_m(noise_ps, 1.0), path_m(delay_ps, 1.0));
        let bound_m = room::bound_m(&truth, &pairs, sds_m(sd_m), delay_sd_m);
        let ways: [(&str, &(dyn Fn(&Measured) -> Vec<Point> + Sync)); 6] = [
            ("Algorithm 1", &|m| iso_embed::embed(&m.distances().0, 3)),
            ("Algorithm 1 with re-estimation", &|m| reestimate::embed(&m.distances().0, 3).0),
            ("classical scaling", &|m| classical::embed(&m.distances().0, 3)),
            ("SMACOF from it", &|m| {
                let (distances, weights) = m.distances();
                smacof::scale(&classical::embed(&distances, 3), &distances, &weights).expect("connected").points
            }),
            ("semidefinite", &|m| {
                let (distances, weights) = m.distances();
                semidefinite::embed(&distances, &weights, 3)
            }),
            ("maximum likelihood", &|m| {
                let problem = m.problem(classical::embed(&m.distances().0, 3), delay_sd_m);
                maximum_likelihood::solve(&problem).expect("a minimum").points
            }),
        ];
        let delay = if delay_ps > 0.0 { format!("to {delay_ps} ps") } else { "known".to_owned() };
        for (name, way) in ways {
            // Where a method is slow, a tenth of the seeds is enough.
            let seeds = if name == "semidefinite" { seeds.div_ceil(10) } else { seeds };
            let one = |seed: u64| {
                let measured = Measured::new(&truth, 0.0, sd_m, delay_sd_m, seed);
                let begin = Instant::now();
                let points = way(&measured);
                ((rms_m(&points, &truth) / bound_m).powi(2), 1e3 * begin.elapsed().as_secs_f64())
            };
            let (squares, times): (Vec<f64>, Vec<f64>) = (0..seeds).into_par_iter().map(one).unzip();
            let (ratio, time) = (Estimate::rms(&squares), times.iter().copied().fold(f64::INFINITY, f64::min));
            println!("| {noise_ps} | {delay} | {:.3} | {name} | {ratio:.3} | {time:.1} |", 1e3 * bound_m);
        }
        println!(
            "| {noise_ps} | {delay} | {:.3} | scikit-learn MDS | {}",
            1e3 * bound_m,
            peer(&truth, sd_m, delay_sd_m, bound_m)
        );
    }
}

/// The row of scikit-learn's MDS, 20 seeds.
fn peer(truth: &[Point], sd_m: f64, delay_sd_m: f64, bound_m: f64) -> String {
    let Ok(python) = std::env::var("PERISCOPE_PYTHON") else {
        return "not run: PERISCOPE_PYTHON names no python | |".to_owned();
    };
    let mut text = String::new();
    for seed in 0..20 {
        let (distances, _) = Measured::new(truth, 0.0, sd_m, delay_sd_m, seed).distances();
        for i in 0..distances.nrows() {
            (0..distances.nrows()).for_each(|j| write!(text, "{} ", distances[(i, j)]).expect("text"));
            text.push('\n');
        }
        text.push('\n');
    }
    let file = std::env::temp_dir().join(format!("periscope-mds-{}.txt", std::process::id()));
    std::fs::write(&file, text).expect("a temporary file");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/mds.py");
    let begin = Instant::now();
    let output = Command::new(python).arg(script).arg(&file).output().expect("python runs");
    let time = 1e3 * begin.elapsed().as_secs_f64() / 20.0;
    std::fs::remove_file(&file).expect("the temporary file is ours");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let square = |line: &str| {
        let values: Vec<f64> = line.split_whitespace().map(|value| value.parse().expect("a number")).collect();
        let points: Vec<Point> = values.chunks(3).map(|c| Point::new(c[0], c[1], c[2])).collect();
        let estimate: Vec<Point> = points[1..].iter().map(|point| point - points[0].coords).collect();
        (rms_m(&estimate, truth) / bound_m).powi(2)
    };
    let squares: Vec<f64> = String::from_utf8_lossy(&output.stdout).lines().map(square).collect();
    format!("{:.3} | {time:.0} |", Estimate::rms(&squares))
}
