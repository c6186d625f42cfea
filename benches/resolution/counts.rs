//! h: histograms of single photons.

use periscope::signal::sparse::{SparseOptions, Unpiled, fit_counts};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Binomial, Distribution};

use super::draw::{DT_PS, Effort, LEN, clean, draws, errors_ps, middle_ps, own_sds_ps};
use super::information::time_sds_weighted_ps;
use super::score::{Estimate, Rate, heading, met, row};
use super::shape::Sensor;

/// Background counts a bin.
const BACKGROUND: f64 = 0.3;

/// A counter and its light.
#[derive(Clone, Copy, Debug)]
pub struct Counter {
    /// Photons that all cycles bring.
    pub photons: f64,
    /// Laser cycles.
    pub cycles: u64,
    /// Bins after a count that see nothing.
    pub dead_bins: usize,
}

/// How one pulse is timed.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// One pulse found.
    pub detected: Rate,
    /// Mean bound, ps.
    pub bound_ps: f64,
    /// Root of the mean squared error over the bound.
    pub ratio: Estimate,
    /// Truth within the intervals of 68 and 95 %.
    pub within: [Rate; 2],
}

impl Counter {
    /// Chance of a count in a bin whose detector is ready.
    fn chance(&self, mean: f64) -> f64 {
        -(-mean / self.cycles as f64).exp_m1()
    }

    /// Counts of each bin, one after another: each cycle that is not in its dead time counts at most one photon.
    fn histogram(&self, means: &[f64], rng: &mut ChaCha8Rng) -> Vec<u32> {
        let mut counts: Vec<u32> = Vec::with_capacity(means.len());
        for (i, mean) in means.iter().enumerate() {
            let busy: u64 = counts[i.saturating_sub(self.dead_bins)..].iter().map(|n| u64::from(*n)).sum();
            let count = Binomial::new(self.cycles - busy, self.chance(*mean)).expect("a chance").sample(rng);
            counts.push(count as u32);
        }
        counts
    }

    /// Information of each bin about its mean: of a binomial number, at the mean number of cycles that are ready.
    fn information(&self, means: &[f64]) -> Vec<f64> {
        let cycles = self.cycles as f64;
        let mut counts: Vec<f64> = Vec::with_capacity(means.len());
        let bin = |(i, mean): (usize, &f64)| {
            let ready = cycles - counts[i.saturating_sub(self.dead_bins)..].iter().sum::<f64>();
            let chance = self.chance(*mean);
            counts.push(ready * chance);
            ready * (1.0 - chance) / (chance * cycles * cycles)
        };
        means.iter().enumerate().map(bin).collect()
    }
}

/// Timing of one pulse by `counter`.
pub fn timing(sensor: &Sensor, counter: Counter, count: usize) -> Timing {
    let results = draws(&format!("counts {} {counter:?}", sensor.name), count, |rng| {
        let truth = [(middle_ps(LEN, rng), counter.photons * DT_PS / sensor.shape.area_ps())];
        let means: Vec<f64> = clean(&sensor.shape, &truth, LEN).iter().map(|mean| mean + BACKGROUND).collect();
        let bound_ps = time_sds_weighted_ps(&sensor.shape, &truth, &counter.information(&means))[0];
        let histogram = Unpiled::new(&counter.histogram(&means, rng), counter.cycles, counter.dead_bins)
            .expect("fewer photons than pulses");
        let solution = fit_counts(&histogram, 0.0, DT_PS, &sensor.response, &SparseOptions::default());
        let sds_ps = own_sds_ps(&solution);
        (bound_ps, errors_ps(&solution, &truth).map(|errors| (errors[0] / bound_ps, errors[0].abs() / sds_ps[0])))
    });
    let timed: Vec<(f64, f64)> = results.iter().filter_map(|(_, timing)| *timing).collect();
    Timing {
        detected: Rate { hits: timed.len(), of: count },
        bound_ps: results.iter().map(|(bound, _)| bound).sum::<f64>() / count as f64,
        ratio: Estimate::rms(&timed.iter().map(|(error, _)| error * error).collect::<Vec<_>>()),
        within: [0.994_458, 1.959_964].map(|z| Rate::of(timed.iter().map(|(_, pull)| *pull < z))),
    }
}

/// Prints the table.
pub fn print(effort: Effort) {
    let columns = [
        "response",
        "photons",
        "cycles",
        "dead (bins)",
        "draws",
        "one found",
        "bound (ps)",
        "rms / bound",
        "68 %",
        "95 %",
        "rms / bound <= 1.1",
    ];
    heading("### h. Histograms of single photons", &columns);
    let counters =
        [(1e3, 1_000_000, LEN), (1e4, 1_000_000, LEN), (1e5, 1_000_000, LEN), (1e5, 250_000, LEN), (1e5, 250_000, 4)];
    let count = effort.of(1000);
    for sensor in Sensor::both() {
        for (photons, cycles, dead_bins) in counters {
            let timing = timing(&sensor, Counter { photons, cycles, dead_bins }, count);
            let [within_68, within_95] = timing.within;
            row(&[
                sensor.name.to_owned(),
                photons.to_string(),
                cycles.to_string(),
                dead_bins.to_string(),
                count.to_string(),
                timing.detected.to_string(),
                format!("{:.3}", timing.bound_ps),
                timing.ratio.to_string(),
                within_68.to_string(),
                within_95.to_string(),
                met(timing.ratio.value <= 1.1).to_owned(),
            ]);
        }
    }
}
