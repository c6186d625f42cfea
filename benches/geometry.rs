//! Study: coordinates from path lengths, every method against the Cramer-Rao bound. Prints the tables of docs/geometry.md.
//!
//! `cargo bench --bench geometry` for all, `cargo bench --bench geometry -- methods` for one of methods, missing, scale, chi-square; a number sets the seeds.
//! PERISCOPE_PYTHON names a python with scikit-learn for its row.

use std::fmt::Write as _;
use std::process::Command;
use std::time::Instant;

use faer::Mat;
use periscope::geometry::many_pairs::{self, Sds};
use periscope::geometry::maximum_likelihood::{self, Node, Observation, Problem};
use periscope::geometry::placement::{self, Alternative};
use periscope::geometry::t2::Length;
use periscope::geometry::{
    Point, classical, completion, dense, iso_embed, landmark, procrustes, reestimate, semidefinite, smacof,
};
use periscope::units::path_m;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../src/geometry/room.rs"]
mod room;

/// Path lengths of a scene with noise, a delay, and pairs missing. A second bounce is the mean of both ways around, the lit and the seen patch swapped.
struct Measured {
    pairs: Vec<(usize, usize)>,
    first: Vec<Length>,
    second: Vec<(usize, usize, Length)>,
}

/// Standard deviations of first and second bounces, of that of an onset.
fn sds_m(onset_sd_m: f64) -> [f64; 2] {
    [onset_sd_m, onset_sd_m / 2_f64.sqrt()]
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

impl Measured {
    fn new(truth: &[Point], missing: f64, sd_m: f64, delay_sd_m: f64, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut pairs = room::all_pairs(truth.len());
        pairs.retain(|_| !rng.random_bool(missing));
        let delay_m = delay_sd_m * normal(&mut rng);
        let mut noisy = |length_m: f64, sd_m: f64| {
            let error_m = delay_m + sd_m * normal(&mut rng);
            Length { length_m: length_m + error_m, variance_m2: sd_m * sd_m }
        };
        let [first_sd_m, second_sd_m] = sds_m(sd_m);
        let first = (0..truth.len()).map(|patch| noisy(room::first_m(truth, patch), first_sd_m)).collect();
        let second = pairs.iter().map(|&(a, b)| (a, b, noisy(room::second_m(truth, a, b), second_sd_m))).collect();
        Self { pairs, first, second }
    }

    /// Distances over p0 and all patches, missing ones by shortest paths, and weights.
    fn distances(&self) -> (Mat<f64>, Mat<f64>) {
        let size = self.first.len() + 1;
        let (mut distances, mut weights) = (Mat::full(size, size, f64::NAN), Mat::zeros(size, size));
        let mut set = |i: usize, j: usize, distance_m: f64, weight: f64| {
            (distances[(i, j)], distances[(j, i)]) = (distance_m, distance_m);
            (weights[(i, j)], weights[(j, i)]) = (weight, weight);
        };
        // The range of a patch is half its first bounce, with half the error that a pair's distance has.
        (0..size - 1).for_each(|i| set(0, i + 1, 0.5 * self.first[i].length_m, 4.0));
        for (a, b, length) in &self.second {
            let across = length.length_m - 0.5 * (self.first[*a].length_m + self.first[*b].length_m);
            set(a + 1, b + 1, across.max(0.0), 1.0);
        }
        let known = |i: usize, j: usize| Some(distances[(i, j)]).filter(|distance: &f64| !distance.is_nan());
        (completion::complete(size, known).expect("all patches have a range"), weights)
    }

    fn problem(&self, start: Vec<Point>, delay_sd_m: f64) -> Problem {
        let origin = Node::Station(0);
        let observation = |patches: &[usize], length: &Length| Observation {
            nodes: std::iter::once(origin).chain(patches.iter().map(|&p| Node::Patch(p))).chain([origin]).collect(),
            length_m: length.length_m,
            sd_m: length.variance_m2.sqrt(),
            delay: None,
            turns: 0,
        };
        let first = self.first.iter().enumerate().map(|(i, length)| observation(&[i], length));
        let second = self.second.iter().map(|(a, b, length)| observation(&[*a, *b], length));
        let problem = Problem::new(start, 3, &[Point::origin()], first.chain(second).collect());
        if delay_sd_m > 0.0 { problem.with_common_delay(delay_sd_m) } else { problem }
    }

    /// Positions from nothing, and others that the lengths do not tell from them.
    fn placed(&self) -> (Vec<Point>, Vec<Alternative>) {
        let problem = self.problem(vec![Point::origin(); self.first.len()], 0.0);
        let points = placement::place(&problem).points;
        let alternatives = placement::alternatives(&problem, &points);
        (points, alternatives)
    }
}

fn rms_m(found: &[Point], truth: &[Point]) -> f64 {
    procrustes::rotation(found, truth, Point::origin(), true).rms_m
}

/// Root mean square over seeds and its 95 % interval, from the squares' spread.
fn over_seeds(rms: &[f64]) -> (f64, f64) {
    let squares: Vec<f64> = rms.iter().map(|rms| rms * rms).collect();
    let n = squares.len() as f64;
    let mean = squares.iter().sum::<f64>() / n;
    let variance = squares.iter().map(|square| (square - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean.sqrt(), 0.5 * 1.96 * (variance / n).sqrt() / mean.sqrt())
}

/// Wilson's interval of a rate, 95 %.
fn interval(hits: usize, draws: usize) -> (f64, f64) {
    let (hits, n, z) = (hits as f64, draws as f64, 1.959_964_f64);
    let centre = (hits + 0.5 * z * z) / (n + z * z);
    let half = z / (n + z * z) * (hits * (n - hits) / n + 0.25 * z * z).sqrt();
    (centre - half, centre + half)
}

fn methods(seeds: u64) {
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
            // Where a method is slow, a tenth of the seeds tells enough.
            let seeds = if name == "semidefinite" { seeds.div_ceil(10) } else { seeds };
            let one = |seed: u64| {
                let measured = Measured::new(&truth, 0.0, sd_m, delay_sd_m, seed);
                let begin = Instant::now();
                let points = way(&measured);
                (rms_m(&points, &truth) / bound_m, 1e3 * begin.elapsed().as_secs_f64())
            };
            let (ratios, times): (Vec<f64>, Vec<f64>) = (0..seeds).into_par_iter().map(one).unzip();
            let ((ratio, half), time) = (over_seeds(&ratios), times.iter().copied().fold(f64::INFINITY, f64::min));
            println!(
                "| {noise_ps} | {delay} | {:.3} | {name} | {ratio:.3} [{:.3}, {:.3}] | {time:.1} |",
                1e3 * bound_m,
                ratio - half,
                ratio + half
            );
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
    let ratio = |line: &str| {
        let values: Vec<f64> = line.split_whitespace().map(|value| value.parse().expect("a number")).collect();
        let points: Vec<Point> = values.chunks(3).map(|c| Point::new(c[0], c[1], c[2])).collect();
        let found: Vec<Point> = points[1..].iter().map(|point| point - points[0].coords).collect();
        rms_m(&found, truth) / bound_m
    };
    let ratios: Vec<f64> = String::from_utf8_lossy(&output.stdout).lines().map(ratio).collect();
    let (ratio, half) = over_seeds(&ratios);
    format!("{ratio:.3} [{:.3}, {:.3}] | {time:.0} |", ratio - half, ratio + half)
}

fn missing(scenes: u64) {
    let truth = room::rectangles();
    let sd_m = path_m(25.0, 1.0);
    println!(
        "| missing | scenes | open | within 2 bounds | 95 % | of the others, twin named | rms / bound of those within | one descent only | ms a scene |"
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
        let right: Vec<f64> = all.iter().filter(|s| within(s.1, s.0)).map(|s| s.1 / s.0).collect();
        let wrong: Vec<_> = all.iter().filter(|s| s.0.is_finite() && !within(s.1, s.0)).collect();
        let (low, high) = interval(right.len(), all.len());
        println!(
            "| {:.0} % | {scenes} | {} | {:.3} | {low:.3} to {high:.3} | {} of {} | {:.3} | {:.3} | {:.0} |",
            100.0 * share,
            all.iter().filter(|s| s.0.is_infinite()).count(),
            right.len() as f64 / all.len() as f64,
            wrong.iter().filter(|s| s.3).count(),
            wrong.len(),
            over_seeds(&right).0,
            all.iter().filter(|s| within(s.2, s.0)).count() as f64 / all.len() as f64,
            all.iter().map(|s| s.4).sum::<f64>() / all.len() as f64,
        );
    }
}

/// Processor time of this process, all threads, in seconds; none where /proc is not.
fn processor_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    let fields: Vec<&str> = text.rsplit(')').next()?.split_whitespace().collect();
    let ticks: f64 = fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?;
    Some(ticks / 100.0)
}

fn peak_mib() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find(|line| line.starts_with("VmHWM"))?;
    Some(line.split_whitespace().nth(1)?.parse::<f64>().ok()? / 1024.0)
}

fn scale() {
    let sd_m = path_m(25.0, 1.0);
    println!(
        "| patches | pairs | delay | passes | time (s) | processor time (s) | peak memory, data included (MiB) | landmarks alone / bound | rms / bound |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let mut logs = Vec::new();
    for count in [1000_usize, 3000, 10_000, 20_000] {
        let mut rng = ChaCha8Rng::seed_from_u64(count as u64);
        let on = |n: usize, u: f64, v: f64| match n % 3 {
            0 => Point::new(-1.2 + 2.0 * u, 2.6, -0.8 + 1.6 * v),
            1 => Point::new(1.1, 1.0 + 1.4 * u, -0.8 + 1.6 * v),
            _ => Point::new(-1.0 + 1.8 * u, 1.6 + 0.7 * v, -0.9),
        };
        let truth: Vec<Point> =
            (0..count).map(|n| on(n, rng.random_range(0.0..1.0), rng.random_range(0.0..1.0))).collect();
        let first_m: Vec<f64> = (0..count).map(|i| room::first_m(&truth, i) + sd_m * normal(&mut rng)).collect();
        let mut second_m: Vec<f32> = Vec::with_capacity(count * (count - 1) / 2);
        for i in 0..count {
            second_m.extend((0..i).map(|j| (room::second_m(&truth, i, j) + sd_m * normal(&mut rng)) as f32));
        }
        let distance_m = |a: usize, b: usize| match (a.max(b), a.min(b)) {
            (i, j) if i == j => 0.0,
            (i, 0) => 0.5 * first_m[i - 1],
            (i, j) => f64::from(second_m[(i - 1) * (i - 2) / 2 + j - 1]) - 0.5 * (first_m[i - 1] + first_m[j - 1]),
        };
        let landmarks = landmark::spread(count + 1, 120, distance_m);
        let start_m = rms_m(&landmark::embed(count + 1, &landmarks, distance_m, 3), &truth);
        for delay_ps in [0.0, 10.0] {
            let lengths = many_pairs::Lengths {
                first_m: &first_m,
                first_sd_m: sd_m,
                second_m: &second_m,
                second_sd_m: Sds::Common(sd_m as f32),
                delay_sd_m: path_m(delay_ps, 1.0),
                dimensions: 3,
            };
            let (begin, processor) = (Instant::now(), processor_s());
            let found = many_pairs::solve(&lengths).expect("a minimum");
            let time = begin.elapsed().as_secs_f64();
            let processor = processor_s().zip(processor).map_or(f64::NAN, |(now, then)| now - then);
            let variance_m2 = found.covariances_m2.iter().map(nalgebra::Matrix3::trace).sum::<f64>() / count as f64;
            if delay_ps == 0.0 && count > 1000 {
                logs.push(((count as f64).ln(), processor.ln()));
            }
            println!(
                "| {count} | {} | {} | {} | {time:.2} | {processor:.2} | {:.0} | {:.1} | {:.3} |",
                second_m.len(),
                if delay_ps > 0.0 { "to 10 ps" } else { "known" },
                found.passes,
                peak_mib().unwrap_or(f64::NAN),
                start_m / variance_m2.sqrt(),
                rms_m(&found.points, &truth) / variance_m2.sqrt(),
            );
        }
    }
    let n = logs.len() as f64;
    let (x, y) = (logs.iter().map(|l| l.0).sum::<f64>() / n, logs.iter().map(|l| l.1).sum::<f64>() / n);
    let slope =
        logs.iter().map(|l| (l.0 - x) * (l.1 - y)).sum::<f64>() / logs.iter().map(|l| (l.0 - x).powi(2)).sum::<f64>();
    println!("\nProcessor time grows as patches to the power {slope:.2} (3,000 to 20,000).");
}

/// Squared errors of whole scenes in units of their bound against the chi-square distribution.
fn chi_square(scenes: u64) {
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

/// Runs the studies that the arguments name; all without any.
pub fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let seeds = arguments.iter().find_map(|argument| argument.parse().ok());
    let names: Vec<&String> = arguments.iter().filter(|argument| argument.parse::<u64>().is_err()).collect();
    let asked = |name: &str| names.is_empty() || names.iter().any(|asked| *asked == name);
    if asked("methods") {
        methods(seeds.unwrap_or(200));
    }
    if asked("missing") {
        missing(seeds.unwrap_or(300));
    }
    if asked("scale") {
        scale();
    }
    if asked("chi-square") {
        chi_square(seeds.unwrap_or(300));
    }
}
