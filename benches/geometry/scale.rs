//! Many patches, all pairs measured.

use std::time::Instant;

use periscope::geometry::Point;
use periscope::units::path_m;
use periscope_comparison::landmark;
use periscope_comparison::many_pairs::{self, Sds};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::measured::{normal, rms_m};
use super::room;

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

/// Prints the table.
pub fn print() {
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
            let solution = many_pairs::solve(&lengths).expect("a minimum");
            let time = begin.elapsed().as_secs_f64();
            let processor = processor_s().zip(processor).map_or(f64::NAN, |(now, then)| now - then);
            let variance_m2 = solution.covariances_m2.iter().map(nalgebra::Matrix3::trace).sum::<f64>() / count as f64;
            if delay_ps == 0.0 && count > 1000 {
                logs.push(((count as f64).ln(), processor.ln()));
            }
            println!(
                "| {count} | {} | {} | {} | {time:.2} | {processor:.2} | {:.0} | {:.1} | {:.3} |",
                second_m.len(),
                if delay_ps > 0.0 { "to 10 ps" } else { "known" },
                solution.passes,
                peak_mib().unwrap_or(f64::NAN),
                start_m / variance_m2.sqrt(),
                rms_m(&solution.points, &truth) / variance_m2.sqrt(),
            );
        }
    }
    let n = logs.len() as f64;
    let (x, y) = (logs.iter().map(|l| l.0).sum::<f64>() / n, logs.iter().map(|l| l.1).sum::<f64>() / n);
    let slope =
        logs.iter().map(|l| (l.0 - x) * (l.1 - y)).sum::<f64>() / logs.iter().map(|l| (l.0 - x).powi(2)).sum::<f64>();
    println!("\nProcessor time grows as patches to the power {slope:.2} (3,000 to 20,000).");
}
