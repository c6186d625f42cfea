//! c: pulses that are none.

use periscope::signal::sparse::SparseOptions;

use super::draw::{Effort, LEN, clean, draws, fit, middle_ps, noisy};
use super::score::{Rate, heading, met, row};
use super::shape::Sensor;
use super::shots::Average;

/// Records with more pulses than the one of height 1, or than none, in noise of `1 / snr`.
pub fn split(sensor: &Sensor, pulses: usize, snr: f64, len: usize, count: usize) -> Rate {
    Rate::of(draws(&format!("false {} {pulses} {snr} {len}", sensor.name), count, |rng| {
        let truth = vec![(middle_ps(len, rng), 1.0); pulses];
        let samples = noisy(&sensor.shape, &truth, 1.0 / snr, len, rng);
        fit(&sensor.response, &samples, 1.0 / snr, &SparseOptions::default()).pulses.len() > pulses
    }))
}

/// The same of averages of shots whose noise is correlated and estimated.
fn split_of_shots(sensor: &Sensor, pulses: usize, shots: usize, count: usize) -> Rate {
    Rate::of(draws(&format!("false {} {pulses} {shots} shots", sensor.name), count, |rng| {
        let truth = vec![(middle_ps(LEN, rng), 1.0); pulses];
        let average = Average::new(&clean(&sensor.shape, &truth, LEN), 0.01, shots, rng);
        average.fit(&sensor.response).pulses.len() > pulses
    }))
}

/// Prints the table.
pub fn print(effort: Effort) {
    let columns = ["response", "record", "noise", "samples", "draws", "records with a false pulse", "at most 0.001"];
    heading("### c. False pulses", &columns);
    for sensor in Sensor::both() {
        let print = |record: &str, noise: &str, len: usize, rate: Rate| {
            let cells = [sensor.name.to_owned(), record.to_owned(), noise.to_owned(), len.to_string()];
            let result =
                [rate.of.to_string(), format!("{} / {rate:.5}", rate.hits), met(rate.share() <= 1e-3).to_owned()];
            row(&[&cells[..], &result[..]].concat());
        };
        for len in [LEN, 10 * LEN] {
            print("noise", "white", len, split(&sensor, 0, 1.0, len, effort.of(10_000)));
            print("one pulse, SNR 100", "white", len, split(&sensor, 1, 100.0, len, effort.of(10_000)));
            print("one pulse, SNR 1000", "white", len, split(&sensor, 1, 1000.0, len, effort.of(10_000)));
        }
        for (shots, full) in [(16, 10_000), (1000, 2000)] {
            let noise = format!("of {shots} shots, estimated");
            print("noise", &noise, LEN, split_of_shots(&sensor, 0, shots, effort.of(full)));
            print("one pulse, SNR 100", &noise, LEN, split_of_shots(&sensor, 1, shots, effort.of(full)));
        }
    }
}
