//! A time by size, and the power of the size that it grows with.

use std::fs;
use std::sync::LazyLock;
use std::time::Instant;

/// A round goes on for so long; the time of a call is its mean.
const ROUND_S: f64 = 0.3;
/// Rounds of a call; their median counts. Calls longer than `LONG_S` are made once.
const ROUNDS: usize = 3;
const LONG_S: f64 = 20.0;

/// Processor time of this thread, which excludes other work on the machine; elapsed time if the system does not give
/// it.
fn processor_s() -> f64 {
    static BEGIN: LazyLock<Instant> = LazyLock::new(Instant::now);
    let text = fs::read_to_string("/proc/thread-self/schedstat").ok();
    let ns = text.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    ns.map_or_else(|| BEGIN.elapsed().as_secs_f64(), |ns| 1e-9 * ns)
}

/// Times by size.
#[derive(Default)]
pub struct Curve {
    points: Vec<[f64; 2]>,
}

impl Curve {
    /// Times a job of a size, and says so: least, median and largest second of its rounds.
    pub fn time<T>(&mut self, size: usize, mut job: impl FnMut() -> T) -> String {
        let mut rounds_s: Vec<f64> = Vec::new();
        while rounds_s.len() < ROUNDS && rounds_s.iter().all(|s| *s < LONG_S) {
            let (begin, mut calls) = (processor_s(), 0);
            while calls == 0 || processor_s() - begin < ROUND_S {
                std::hint::black_box(job());
                calls += 1;
            }
            rounds_s.push((processor_s() - begin) / f64::from(calls));
        }
        rounds_s.sort_by(f64::total_cmp);
        let median_s = rounds_s[rounds_s.len() / 2];
        self.points.push([(size as f64).ln(), median_s.ln()]);
        format!("{:.4}, {median_s:.4}, {:.4}", rounds_s[0], rounds_s[rounds_s.len() - 1])
    }

    /// Prints the exponent, for sizes from `least` to `most`: least squares on logarithms, with the standard error from
    /// the scatter about the line.
    pub fn print(&self, least: usize, most: usize) {
        let among = (least as f64).ln() - 1e-9..(most as f64).ln() + 1e-9;
        let points: Vec<[f64; 2]> = self.points.iter().copied().filter(|[x, _]| among.contains(x)).collect();
        let count = points.len() as f64;
        if points.len() < 2 {
            return;
        }
        let mean = |k: usize| points.iter().map(|point| point[k]).sum::<f64>() / count;
        let (x, y) = (mean(0), mean(1));
        let spread = points.iter().map(|point| (point[0] - x).powi(2)).sum::<f64>();
        let power = points.iter().map(|point| (point[0] - x) * (point[1] - y)).sum::<f64>() / spread;
        let off = points.iter().map(|point| (point[1] - y - power * (point[0] - x)).powi(2)).sum::<f64>();
        let se =
            if points.len() > 2 { format!(" +- {:.2}", (off / (count - 2.0) / spread).sqrt()) } else { String::new() };
        println!("\nfrom {least} to {most}: time grows as the power {power:.2}{se}");
    }
}
