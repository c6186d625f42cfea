//! Means of finitely many shots that come early and late.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use crate::response::Response;
use crate::sparse::{Jitter, Profile, SparseFit, SparseOptions, fit};

const DT_PS: f64 = 50.0;
const JITTER_PS: f64 = 30.0;
const SHOTS: usize = 64;
const SNR: f64 = 200.0;
const RECORDS: u64 = 200;
/// Pulses: arrival and amplitude.
const PULSES: [(f64, f64); 2] = [(3012.0, 1.0), (6031.0, 0.6)];

/// A Gaussian of sd 75 ps, or wider.
fn pulse(after_ps: f64, sd_ps: f64) -> f64 {
    75.0 / sd_ps * (-0.5 * (after_ps / sd_ps).powi(2)).exp()
}

/// A fit of a record, and how late the mean of its shots is.
fn outcome(seed: u64, is_told: bool) -> (SparseFit, f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let late = Normal::new(0.0, JITTER_PS).expect("positive");
    let late: Vec<f64> = (0..SHOTS).map(|_| late.sample(&mut rng)).collect();
    let noise = Normal::new(0.0, 1.0 / SNR).expect("positive");
    let light = |t: f64| -> f64 {
        let shot = |late: &f64| PULSES.iter().map(|(at, a)| a * pulse(t - at - late, 75.0)).sum::<f64>();
        late.iter().map(shot).sum::<f64>() / SHOTS as f64
    };
    let mean_v: Vec<f64> = (0..200).map(|n| light(DT_PS * f64::from(n)) + noise.sample(&mut rng)).collect();
    let sd_ps = 75.0_f64.hypot(JITTER_PS);
    let values: Vec<f64> = (-70..=70).map(|n| pulse(6.0 * f64::from(n), sd_ps)).collect();
    let response = Response::new(-420.0, 6.0, &values);
    let jitter = is_told.then_some(Jitter { sd_ps: JITTER_PS, shots: SHOTS as f64 });
    let sd_v = [1.0 / SNR; 200];
    let profile = Profile { mean_v: &mean_v, sd_v: &sd_v, acf: &[], slow_v2: &[], jitter, t0_ps: 0.0, dt_ps: DT_PS };
    (fit(&profile, &response, &SparseOptions::default()), late.iter().sum::<f64>() / SHOTS as f64)
}

/// Told of the jitter, no pulse is split, and times scatter as stated about how late the mean of the shots is.
#[test]
fn what_finitely_many_shots_do_to_the_shape_is_no_pulse() {
    let split = |is_told: bool| (0..RECORDS).filter(|seed| outcome(*seed, is_told).0.pulses.len() != 2).count();
    let (told, untold) = (split(true), split(false));
    assert!(told <= 1 && untold > 10, "{told} and {untold} of {RECORDS}");
    let mut squares = Vec::new();
    for (fit, late_ps) in (0..RECORDS).map(|seed| outcome(seed, true)).filter(|(fit, _)| fit.pulses.len() == 2) {
        for (pulse, (at_ps, _)) in fit.pulses.iter().zip(PULSES) {
            squares.push(((pulse.time_ps - at_ps - late_ps) / pulse.time_sd_ps).powi(2));
        }
    }
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    assert!((0.75..1.3).contains(&mean), "{mean}");
}
