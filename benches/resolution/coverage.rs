//! e: how often the intervals hold the truth.

use periscope::signal::response::Response;
use periscope::signal::sparse::{SparseFit, SparseOptions};
use rand_chacha::ChaCha8Rng;

use super::draw::{DT_PS, Effort, LEN, clean, draws, errors_ps, fit, middle_ps, noisy, own_sds_ps};
use super::information::{resolution_limit_ps, time_sds_ps};
use super::pairs::LIMITS;
use super::score::{Rate, heading, row};
use super::shape::{Sensor, Shape};
use super::shots::Average;

/// Two-sided normal quantiles of 50, 68, 95 and 99 %.
const QUANTILES: [f64; 4] = [0.674_490, 0.994_458, 1.959_964, 2.575_829];

/// Coverage of one kind of record.
#[derive(Clone, Copy, Debug)]
pub struct Coverage {
    /// The right number of pulses found.
    pub detected: Rate,
    /// Truth within the intervals of 50, 68, 95, 99 %, of all pulses; the interval counts draws.
    pub within: [Rate; 4],
}

/// Coverage for pulses of height 1, each `apart_ps` after the previous one, by what `estimate` makes of their samples.
fn measure(
    label: &str,
    (pulses, apart_ps): (usize, f64),
    count: usize,
    estimate: impl Fn(&[(f64, f64)], &mut ChaCha8Rng) -> SparseFit + Sync,
) -> Coverage {
    let pulls: Vec<Option<Vec<f64>>> = draws(label, count, |rng| {
        let at_ps = middle_ps(LEN, rng);
        let truth: Vec<(f64, f64)> = (0..pulses).map(|k| (at_ps + k as f64 * apart_ps, 1.0)).collect();
        let solution = estimate(&truth, rng);
        let sds_ps = own_sds_ps(&solution);
        errors_ps(&solution, &truth).map(|errors| errors.iter().zip(sds_ps).map(|(e, sd)| (e / sd).abs()).collect())
    });
    let detected: Vec<&Vec<f64>> = pulls.iter().flatten().collect();
    let within = QUANTILES.map(|z| {
        let hits = detected.iter().map(|pulls| pulls.iter().filter(|pull| **pull < z).count()).sum::<usize>();
        Rate { hits: hits.div_ceil(pulses), of: detected.len() }
    });
    Coverage { detected: Rate { hits: detected.len(), of: count }, within }
}

/// White noise of known size.
fn white(
    sensor: &Sensor,
    light: &Shape,
    (pulses, apart_ps): (usize, f64),
    snr: f64,
    options: &SparseOptions,
    count: usize,
) -> Coverage {
    let label = format!("coverage {} {pulses} {apart_ps} {snr} {}", sensor.name, options.extent_max_ps);
    measure(&label, (pulses, apart_ps), count, |truth, rng| {
        let samples = noisy(light, truth, 1.0 / snr, LEN, rng);
        fit(&sensor.response, &samples, 1.0 / snr, options)
    })
}

/// One pulse.
pub fn single(sensor: &Sensor, snr: f64, count: usize) -> Coverage {
    white(sensor, &sensor.shape, (1, 0.0), snr, &SparseOptions::default(), count)
}

/// Two pulses `apart_ps` apart.
pub fn blended(sensor: &Sensor, apart_ps: f64, snr: f64, count: usize) -> Coverage {
    white(sensor, &sensor.shape, (2, apart_ps), snr, &SparseOptions::default(), count)
}

/// Light that a patch spreads by a Gaussian of 40 ps.
fn extended(sensor: &Sensor, count: usize) -> Coverage {
    let options = SparseOptions { extent_max_ps: 120.0, ..SparseOptions::default() };
    white(sensor, &sensor.shape.widened(40.0), (1, 0.0), 100.0, &options, count)
}

/// Averages of shots whose noise is estimated.
fn averaged(sensor: &Sensor, response: &Response, shots: usize, count: usize) -> Coverage {
    measure(&format!("coverage {} {shots} shots", sensor.name), (1, 0.0), count, |truth, rng| {
        Average::new(&clean(&sensor.shape, truth, LEN), 0.01, shots, rng).fit(response)
    })
}

/// Prints the table.
pub fn print(effort: Effort) {
    let columns = ["response", "light", "draws", "right number found", "50 %", "68 %", "95 %", "99 %"];
    heading("### e. Coverage of the intervals of times", &columns);
    let count = effort.of(2000);
    for sensor in Sensor::both() {
        let pair = |limits: f64, snr: f64| {
            let apart_ps = limits * resolution_limit_ps(&sensor.shape, snr);
            let truth = [(0.4 * LEN as f64 * DT_PS, 1.0), (0.4 * LEN as f64 * DT_PS + apart_ps, 1.0)];
            let share = time_sds_ps(&sensor.shape, &truth, 1.0 / snr, LEN)[0] / apart_ps;
            let name = format!("pair, {limits} limits ({apart_ps:.0} ps), SNR {snr}; bound {share:.2} of that");
            (name, blended(&sensor, apart_ps, snr, count))
        };
        let rows = [
            ("one pulse, SNR 100".to_owned(), single(&sensor, 100.0, count)),
            pair(LIMITS, 100.0),
            pair(LIMITS, 316.0),
            pair(LIMITS, 1000.0),
            pair(2.0, 100.0),
            pair(2.0, 1000.0),
            pair(3.0, 1000.0),
            ("spread by 40 ps, SNR 100".to_owned(), extended(&sensor, count)),
            ("one pulse, 16 shots, SNR 100".to_owned(), averaged(&sensor, &sensor.response, 16, count)),
            ("one pulse, 1000 shots, SNR 100".to_owned(), averaged(&sensor, &sensor.response, 1000, count)),
        ];
        for (name, coverage) in rows {
            let cells = [sensor.name.to_owned(), name, count.to_string(), coverage.detected.to_string()];
            row(&[cells.to_vec(), coverage.within.map(|rate| rate.to_string()).to_vec()].concat());
        }
    }
}
