use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Poisson};

use super::super::tests::{DT_PS, FAR_PS, SIGMA_PS, means, rises};
use super::super::{EDGE, STEP, rises as rises_of};
use super::*;

/// What the fit climbs is what it compares: slopes are those of the logarithm, also where the rate is low or negative.
#[test]
fn slopes_of_the_likelihood_are_differences_of_its_logarithm() {
    let rises = rises();
    let mut random = ChaCha8Rng::seed_from_u64(17);
    let means = means(0.0, 500.0, [0.1, 6.0]);
    let counts: Vec<f64> = means.iter().map(|mean| Poisson::new(*mean).unwrap().sample(&mut random)).collect();
    for noise in [Noise::Counts, Noise::Gauss { sd: 0.7 }] {
        let bins = Bins { first_ps: FAR_PS, dt_ps: DT_PS, values: &counts, noise };
        let first = Window::about(&bins, &rises, Background::CONSTANT, FAR_PS + 500.0).unwrap();
        let later = Window::later(&bins, &rises, FAR_PS + 500.0).unwrap();
        let law = rises.law(&[Face::quarter(EDGE)], f64::INFINITY);
        for (window, count) in [(&first, 4), (&later, 5)] {
            let start_ps = window.start_ps;
            for unknowns in [
                [start_ps + 0.2, 0.1, 6.0, -0.3, 0.0],
                [start_ps + 7.3, 1e-3, 9.0, 2.0, 0.01],
                [start_ps - 9.4, 0.02, 4.0, -3.0, -0.01],
            ] {
                let at = |unknowns: Unknowns| window.likelihood(&window.law_at(&law, unknowns[0]), unknowns);
                let Likelihood { gradient, information, .. } = at(unknowns);
                for k in 0..count {
                    let moved = |step: f64| {
                        let mut moved = unknowns;
                        moved[k] += step;
                        at(moved).logarithm
                    };
                    // The table of laws has corners every 1.5 ps: steps of time are small next to that.
                    let step = 1e-4 * information[k][k].powf(-0.5);
                    let difference = (moved(step) - moved(-step)) / (2.0 * step);
                    let scale = information[k][k].sqrt();
                    let off = (difference - gradient[k]).abs() / scale;
                    assert!(off < 1e-4, "{k}: {difference}, {}", gradient[k]);
                }
            }
        }
    }
}

/// Counts of a thing from 100 ps on, whose light declines as this power of time, and of one behind it from 500 ps on.
fn behind(decline: f64, [near, far]: [f64; 2]) -> Vec<f64> {
    let density = |t: f64| (-0.5 * (t / SIGMA_PS).powi(2)).exp() / (SIGMA_PS * std::f64::consts::TAU.sqrt());
    let light = |at_ps: f64, tau_ps: f64, power: f64| -> f64 {
        let since = (0..900).map(|u| f64::from(u) + 0.5);
        since.map(|u| density(at_ps - tau_ps - u) * (1.0 + u / (FAR_PS + tau_ps)).powf(-power)).sum()
    };
    let of_bin = |n: i32| {
        let at_ps = f64::from(n) * DT_PS;
        0.5 + near * light(at_ps, 100.0, decline) + far * light(at_ps, 500.0, DECLINE)
    };
    (0..110).map(of_bin).collect()
}

/// The light of what is nearer declines as thought, not at all, and three times as fast.
#[test]
fn later_returns_err_as_stated() {
    let rises = rises();
    let mut random = ChaCha8Rng::seed_from_u64(19);
    for decline in [DECLINE, 0.0, 3.0 * DECLINE] {
        let means = behind(decline, [60.0, 40.0]);
        let (mut held, mut count, mut sum) = (0, 0, 0.0);
        for _ in 0..400 {
            let counts: Vec<f64> = means.iter().map(|mean| Poisson::new(*mean).unwrap().sample(&mut random)).collect();
            let bins = Bins { first_ps: FAR_PS, dt_ps: DT_PS, values: &counts, noise: Noise::Counts };
            let [first_ps, rise_ps] = rises_of(&bins, SIGMA_PS, 5.0)[..] else { continue };
            let bins = bins.about_later([first_ps, rise_ps], SIGMA_PS);
            let one = Window::later(&bins, &rises, rise_ps).unwrap().first_return(&[Face::quarter(STEP)]).unwrap();
            let off = (one.time_ps - FAR_PS - 500.0) / one.sd_ps.hypot(one.common_ps);
            count += 1;
            sum += off;
            held += usize::from(off.abs() < 1.96);
        }
        let mean = sum / f64::from(count);
        println!("decline {decline}: {held} of {count} hold, mean {mean:.2}");
        assert!(count > 330 && held * 100 > 92 * count as usize && mean.abs() < 0.3, "{held} of {count}, {mean}");
    }
}

/// A thing whose light only declines, one whose light grows as that of a corner, and one with the tail of a small
/// thing.
#[test]
fn light_of_one_thing_rises_once() {
    let mut random = ChaCha8Rng::seed_from_u64(20);
    let small = |n: usize| match n as f64 * DT_PS - 100.0 {
        since_ps if since_ps < 0.0 => 0.0,
        since_ps => 400.0 * (-since_ps / 60.0).exp(),
    };
    let corner = means(1.0, 100.0, [2.0, 20.0]);
    for (name, means) in [
        ("declines", behind(DECLINE, [600.0, 0.0])),
        ("grows", corner),
        ("small", (0..120).map(|n| small(n) + 2.0).collect()),
    ] {
        let mut rises = |means: &Vec<f64>| {
            let counts: Vec<f64> = means.iter().map(|mean| Poisson::new(*mean).unwrap().sample(&mut random)).collect();
            let bins = Bins { first_ps: 0.0, dt_ps: DT_PS, values: &counts, noise: Noise::Counts };
            rises_of(&bins, SIGMA_PS, 5.0).len()
        };
        let rises: usize = (0..400).map(|_| rises(&means)).sum();
        assert_eq!(rises, 400, "{name}");
    }
}
