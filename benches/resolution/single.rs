//! a: one pulse.

use periscope::signal::sparse::SparseOptions;
use rand::RngExt;

use super::draw::{Effort, LEN, draws, errors_ps, fit, middle_ps, noisy};
use super::information::time_sds_ps;
use super::score::{Estimate, Rate, heading, met, row};
use super::shape::Sensor;

/// Amplitudes of a walk reach this factor.
const WALK: f64 = 10.0;

/// How one pulse of height 1 is timed.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// One pulse found.
    pub detected: Rate,
    /// Mean bound, ps.
    pub bound_ps: f64,
    /// Root of the mean squared error over the bound.
    pub ratio: Estimate,
}

/// Timing at one signal-to-noise ratio.
pub fn timing(sensor: &Sensor, snr: f64, count: usize) -> Timing {
    let sd = 1.0 / snr;
    let results = draws(&format!("single {} {snr}", sensor.name), count, |rng| {
        let truth = [(middle_ps(LEN, rng), 1.0)];
        let bound_ps = time_sds_ps(&sensor.shape, &truth, sd, LEN)[0];
        let samples = noisy(&sensor.shape, &truth, sd, LEN, rng);
        let errors = errors_ps(&fit(&sensor.response, &samples, sd, &SparseOptions::default()), &truth);
        (bound_ps, errors.map(|e| (e[0] / bound_ps).powi(2)))
    });
    let squares: Vec<f64> = results.iter().filter_map(|(_, square)| *square).collect();
    Timing {
        detected: Rate::of(results.iter().map(|(_, square)| square.is_some())),
        bound_ps: results.iter().map(|(bound, _)| bound).sum::<f64>() / count as f64,
        ratio: Estimate::rms(&squares),
    }
}

/// Error per e-fold of the amplitude, ps, of amplitudes from 1 to [`WALK`] at noise of `1 / snr`.
fn walk_ps(sensor: &Sensor, snr: f64, count: usize) -> Estimate {
    let results = draws(&format!("walk {} {snr}", sensor.name), count, |rng| {
        let log = rng.random_range(0.0..WALK.ln());
        let truth = [(middle_ps(LEN, rng), log.exp())];
        let samples = noisy(&sensor.shape, &truth, 1.0 / snr, LEN, rng);
        let solution = fit(&sensor.response, &samples, 1.0 / snr, &SparseOptions::default());
        errors_ps(&solution, &truth).map(|errors| (log, errors[0]))
    });
    Estimate::slope(&results.into_iter().flatten().collect::<Vec<_>>())
}

/// Prints the table.
pub fn print(effort: Effort) {
    let columns =
        ["response", "SNR", "draws", "one found", "bound (ps)", "rms / bound", "walk (ps per e-fold)", "targets"];
    heading("### a. One pulse", &columns);
    for sensor in Sensor::both() {
        for snr in [10.0, 30.0, 100.0, 1000.0] {
            let count = effort.of(1000);
            let timing = timing(&sensor, snr, count);
            let walk = walk_ps(&sensor, snr, count);
            row(&[
                sensor.name.to_owned(),
                snr.to_string(),
                count.to_string(),
                timing.detected.to_string(),
                format!("{:.3}", timing.bound_ps),
                timing.ratio.to_string(),
                format!("{walk:.3}"),
                met(timing.ratio.value <= 1.1 && walk.value.abs() < 0.5).to_owned(),
            ]);
        }
    }
}
