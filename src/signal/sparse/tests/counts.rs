//! Histograms of single photons: likelihood at its bound, pile-up.

use super::*;
use rand_distr::{Binomial, Poisson};

const BINS: usize = 120;

/// Mean counts of pulses `(time, photons)` on a background a bin.
pub(super) fn means(shape: &Shape, pulses: &[(f64, f64)], background: f64) -> Vec<f64> {
    let value = |n: usize, at: f64| shape.response.value(T0_PS + DT_PS * n as f64 - at);
    let area: f64 = (0..BINS).map(|n| value(n, 3000.0)).sum();
    let mean = |n: usize| pulses.iter().map(|(at, photons)| photons / area * value(n, *at)).sum::<f64>() + background;
    (0..BINS).map(mean).collect()
}

/// Counts of `cycles` cycles, one after another bin: each cycle that is not in its dead time counts at most one photon.
fn counted(means: &[f64], cycles: u64, dead_bins: usize, rng: &mut ChaCha8Rng) -> Vec<u32> {
    let mut counts: Vec<u32> = Vec::new();
    for (i, mean) in means.iter().enumerate() {
        let busy: u64 = counts[i.saturating_sub(dead_bins)..].iter().map(|n| u64::from(*n)).sum();
        let chance = -(-mean / cycles as f64).exp_m1();
        counts.push(Binomial::new(cycles - busy, chance).expect("a chance").sample(rng) as u32);
    }
    counts
}

/// Cramer-Rao bound of the time of one pulse: Fisher information `sum (dmu_i)(dmu_j) / mu` of time, amplitude,
/// background.
fn poisson_bound_ps(shape: &Shape, at: f64, photons: f64, background: f64) -> f64 {
    let mean = means(shape, &[(at, photons)], background);
    let (early, late) =
        (means(shape, &[(at - 0.5, photons)], background), means(shape, &[(at + 0.5, photons)], background));
    let mut m = [[0.0; 3]; 3];
    for n in 0..BINS {
        let row = [late[n] - early[n], mean[n] - background, 1.0];
        for p in 0..3 {
            for q in 0..3 {
                m[p][q] += row[p] * row[q] / mean[n];
            }
        }
    }
    let minor = m[1][1] * m[2][2] - m[1][2] * m[1][2];
    let determinant = m[0][0] * minor - m[0][1] * (m[0][1] * m[2][2] - m[1][2] * m[0][2])
        + m[0][2] * (m[0][1] * m[1][2] - m[1][1] * m[0][2]);
    (minor / determinant).sqrt()
}

#[test]
fn photons_are_timed_at_their_bound() {
    let mut rng = ChaCha8Rng::seed_from_u64(61);
    for shape in [gaussian(), exponential()] {
        for photons in [100.0, 1000.0, 100_000.0] {
            let (mut errors, mut within) = (Vec::new(), [0, 0]);
            for _ in 0..250 {
                let at = 3000.0 + rng.random_range(0.0..DT_PS);
                let counts: Vec<u32> = means(&shape, &[(at, photons)], 0.3)
                    .iter()
                    .map(|mean| Poisson::new(*mean).expect("positive").sample(&mut rng) as u32)
                    .collect();
                let histogram = Unpiled::new(&counts, 1_000_000_000, 0).unwrap();
                let solution = fit_counts(&histogram, T0_PS, DT_PS, &shape.response, &SparseOptions::default());
                assert_eq!(solution.pulses.len(), 1, "{} {photons} {:?}", shape.name, solution.pulses);
                let error = solution.pulses[0].time_ps - at;
                errors.push(error / poisson_bound_ps(&shape, at, photons, 0.3));
                let pull = error.abs() / solution.covariance_ps2[0].sqrt();
                within[0] += usize::from(pull < 0.9945);
                within[1] += usize::from(pull < 1.96);
            }
            println!("{} {photons} photons: rms / bound {:.3}, within {within:?} of 250", shape.name, rms(&errors));
            // Three sds of the rms of 250, and of binomials about 68 and 95 %.
            assert!((0.86..1.14).contains(&rms(&errors)), "{} {photons}: {}", shape.name, rms(&errors));
            assert!(within[0] > 148 && within[1] > 226, "{} {photons}: {within:?}", shape.name);
        }
    }
}

/// A third of the cycles counts: uncorrected, the pulse's later half is missing; corrected, the time is right within
/// its error.
#[test]
fn pile_up_is_taken_out() {
    let mut rng = ChaCha8Rng::seed_from_u64(62);
    let (shape, cycles) = (gaussian(), 100_000);
    let (mut biased, mut pulls) = (Vec::new(), Vec::new());
    for _ in 0..60 {
        let at = 3000.0 + rng.random_range(0.0..DT_PS);
        let counts = counted(&means(&shape, &[(at, 40_000.0)], 5.0), cycles, BINS, &mut rng);
        let time_of = |histogram: &Unpiled, options: &SparseOptions| {
            let solution = fit_counts(histogram, T0_PS, DT_PS, &shape.response, options);
            (solution.pulses.len(), solution.pulses[0].time_ps - at, solution.covariance_ps2[0].sqrt())
        };
        let one = SparseOptions { pulses_max: 1, ..SparseOptions::default() };
        biased.push(time_of(&Unpiled::new(&counts, 1_000_000_000, 0).unwrap(), &one).1);
        let (count, error, sd) = time_of(&Unpiled::new(&counts, cycles, BINS).unwrap(), &SparseOptions::default());
        assert_eq!(count, 1);
        pulls.push(error / sd);
    }
    let bias = biased.iter().sum::<f64>() / biased.len() as f64;
    println!("bias uncorrected {bias:.2} ps, corrected error / sd {:.3}", rms(&pulls));
    assert!(bias < -5.0 && (0.72..1.28).contains(&rms(&pulls)), "{bias} {}", rms(&pulls));
}

#[test]
fn background_alone_has_no_pulse() {
    let mut rng = ChaCha8Rng::seed_from_u64(63);
    let shape = exponential();
    for background in [0.02, 1.0, 50.0] {
        let poisson = Poisson::new(background).expect("positive");
        let mut pulses = 0;
        for _ in 0..300 {
            let counts: Vec<u32> = (0..400).map(|_| poisson.sample(&mut rng) as u32).collect();
            let histogram = Unpiled::new(&counts, 1_000_000, 0).unwrap();
            pulses += fit_counts(&histogram, T0_PS, DT_PS, &shape.response, &SparseOptions::default()).pulses.len();
        }
        assert!(pulses <= 1, "{background}: {pulses}");
    }
}

/// Corrected counts of the mean counts are the mean photons, whatever the dead time; without any they are the counts.
#[test]
fn pile_up_of_means_is_undone_exactly() {
    let (cycles, mean): (f64, [f64; 6]) = (1e9, [1e8, 3e8, 2e8, 4e8, 1e8, 2e8]);
    for dead_bins in [0, 1, 3, 6] {
        let mut counts: Vec<u32> = Vec::new();
        for (i, mean) in mean.iter().enumerate() {
            let busy: f64 = counts[i.saturating_sub(dead_bins)..].iter().map(|n| f64::from(*n)).sum();
            counts.push(((cycles - busy) * -(-mean / cycles).exp_m1()).round() as u32);
        }
        let histogram = Unpiled::new(&counts, 1_000_000_000, dead_bins).unwrap();
        for (corrected, mean) in histogram.counts.iter().zip(&mean) {
            assert!((corrected / mean - 1.0).abs() < 1e-7, "{dead_bins}: {corrected} {mean}");
        }
    }
}
