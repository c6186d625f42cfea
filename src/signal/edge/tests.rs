use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Poisson};

use super::*;

const SIGMA_PS: f64 = 25.0;
const DT_PS: f64 = 8.0;
const DRAWS: usize = 600;

fn rises() -> Rises {
    let response: Vec<f64> = (-150..=150).map(|n| (-0.5 * (f64::from(n) / SIGMA_PS).powi(2)).exp()).collect();
    Rises::new([-150.0, 1.0], &response, [FWHM * SIGMA_PS, DT_PS])
}

/// Mean counts of a power that begins at `tau_ps`, by sums over femtosecond steps: no code is shared with the table.
fn means(power: f64, tau_ps: f64, [background, height]: [f64; 2]) -> Vec<f64> {
    let density = |t: f64| (-0.5 * (t / SIGMA_PS).powi(2)).exp() / (SIGMA_PS * std::f64::consts::TAU.sqrt());
    let bin = |n: i32| {
        let at = f64::from(n) * DT_PS - tau_ps;
        let parts =
            (0..1600).map(|k| 0.25 * (f64::from(k) + 0.5)).map(|u| (u / SIGMA_PS).powf(power) * density(at - u));
        background + height * 0.25 * parts.sum::<f64>()
    };
    (0..120).map(bin).collect()
}

#[test]
fn the_law_of_the_light_is_the_likeliest_and_has_its_time() {
    let rises = rises();
    for (k, power) in [0.0, 0.5, 1.0].into_iter().enumerate() {
        let values = means(power, 500.0, [20.0, 1e5]);
        let bins = Bins { first_ps: 0.0, dt_ps: DT_PS, values: &values, noise: Noise::Counts };
        let start_ps = first_rise(&bins, SIGMA_PS, 5.0).unwrap();
        let laws = fit(&bins, &rises, start_ps).unwrap();
        assert!((laws[k].time_ps - 500.0).abs() < 0.5, "{power}: {laws:?}");
        for other in (0..3).filter(|other| *other != k) {
            assert!(laws[k].log_likelihood > laws[other].log_likelihood, "{power}: {laws:?}");
        }
    }
}

#[test]
fn errors_scatter_as_stated() {
    let rises = rises();
    let means = means(0.0, 500.0, [2.0, 40.0]);
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let (mut square, mut held) = (0.0, 0);
    for _ in 0..DRAWS {
        let values: Vec<f64> = means.iter().map(|mean| Poisson::new(*mean).unwrap().sample(&mut random)).collect();
        let bins = Bins { first_ps: 0.0, dt_ps: DT_PS, values: &values, noise: Noise::Counts };
        let start_ps = first_rise(&bins, SIGMA_PS, 5.0).unwrap();
        let [step, ..] = fit(&bins, &rises, start_ps).unwrap();
        let z = (step.time_ps - 500.0) / step.sd_ps;
        square += z * z / DRAWS as f64;
        held += usize::from(z.abs() < 1.96);
    }
    // Of 600 draws a share of .95 has a standard deviation of .009; the prior of the slope takes a little.
    assert!((0.92..0.98).contains(&(held as f64 / DRAWS as f64)), "{held} of {DRAWS}");
    assert!((0.8..1.25).contains(&square), "{square}");
}

#[test]
fn background_alone_has_no_first_return() {
    let mut random = ChaCha8Rng::seed_from_u64(12);
    let background = Poisson::new(5.0).unwrap();
    let rises = (0..200).filter(|_| {
        let values: Vec<f64> = (0..500).map(|_| background.sample(&mut random)).collect();
        let bins = Bins { first_ps: 0.0, dt_ps: DT_PS, values: &values, noise: Noise::Counts };
        first_rise(&bins, SIGMA_PS, 5.0).is_some()
    });
    assert_eq!(rises.count(), 0);
}

#[test]
fn levels_have_first_returns_too() {
    let rises = rises();
    let values: Vec<f64> =
        means(0.0, 500.0, [0.0, 1.0]).iter().enumerate().map(|(n, v)| v + 1e-3 * f64::from(n as i32 % 3 - 1)).collect();
    let bins = Bins { first_ps: 0.0, dt_ps: DT_PS, values: &values, noise: Noise::Gauss { sd: 1e-3 } };
    let [step, ..] = fit(&bins, &rises, first_rise(&bins, SIGMA_PS, 6.0).unwrap()).unwrap();
    assert!((step.time_ps - 500.0).abs() < 4.0 * step.sd_ps.max(0.1), "{step:?}");
}
