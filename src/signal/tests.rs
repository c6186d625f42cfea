//! Cancels reach the kernels that compute longest.

use periscope_cancel::ends_soon;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::response::Response;
use crate::sparse::{Given, Open, Profile, SparseOptions, Unpiled, fit, fit_counts, matched};

const SD_V: f64 = 0.01;

fn gaussian() -> Response {
    let values: Vec<f64> = (-100..=100).map(|i| (-0.5 * (f64::from(i) / 20.0).powi(2)).exp()).collect();
    Response::new(-500.0, 5.0, &values)
}

/// Noise, and a pulse every 2,000 samples.
fn record(samples: usize) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let response = gaussian();
    let pulse = |n: usize| response.value(((n % 2000) as f64 - 1000.0) * 10.0);
    (0..samples).map(|n| pulse(n) + SD_V * rng.random_range(-1.7..1.7)).collect()
}

#[test]
fn sparse_ends_within_a_long_record() {
    let (mean_v, sd_v) = (record(1_000_000), vec![SD_V; 1_000_000]);
    for acf in [&[1.0][..], &[1.0, 0.6, 0.3, 0.1]] {
        let profile =
            Profile { mean_v: &mean_v, sd_v: &sd_v, acf, slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: 10.0 };
        ends_soon(|cancel| {
            fit(&profile, &gaussian(), &SparseOptions { cancel: cancel.clone(), ..SparseOptions::default() })
        });
    }
}

#[test]
fn counts_end_within_a_long_histogram() {
    let counts: Vec<u32> = record(300_000).iter().map(|value| (1000.0 * (1.0 + value)) as u32).collect();
    let histogram = Unpiled::new(&counts, 1 << 40, 1).expect("few counts");
    ends_soon(|cancel| {
        let options = SparseOptions { cancel: cancel.clone(), ..SparseOptions::default() };
        fit_counts(&histogram, 0.0, 10.0, &gaussian(), &options)
    });
}

#[test]
fn matched_filters_end_between_times() {
    let (mean_v, sd_v) = (record(200_000), vec![SD_V; 200_000]);
    let profile =
        Profile { mean_v: &mean_v, sd_v: &sd_v, acf: &[], slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: 10.0 };
    let given: Vec<Given> =
        (1..60).map(|n| Given { time_ps: f64::from(n) * 20_000.0, width_ps: 0.0, open: Open::Time }).collect();
    let times_ps = || (0..2_000_000).map(f64::from);
    ends_soon(|cancel| matched(&profile, &gaussian(), &given, 0.0, times_ps(), cancel));
}
