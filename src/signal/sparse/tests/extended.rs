//! Light spread in time by extended patches: centroid, width, tail, and pairs of points that must stay pairs.

use super::*;

/// Samples of a pulse whose light is spread by a Gaussian of sd `width`, and a centred exponential tail: rectangle
/// rule.
fn spread(shape: &Shape, at: f64, width: f64, tail: f64, len: usize) -> Vec<f64> {
    let gaussian: Vec<(f64, f64)> = (-40..=40)
        .map(|i| 0.125 * f64::from(i))
        .map(|x| (width * x, 0.125 * (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt()))
        .collect();
    let steps = if tail > 0.0 { 240 } else { 1 };
    let exponential: Vec<(f64, f64)> = (0..steps)
        .map(|i| 0.05 * (f64::from(i) + 0.5))
        .map(|u| if tail > 0.0 { ((u - 1.0) * tail, 0.05 * (-u).exp()) } else { (0.0, 1.0) })
        .collect();
    let sample = |n: usize| {
        let t = T0_PS + DT_PS * n as f64 - at;
        let inner = |later: f64| gaussian.iter().map(|(x, p)| p * shape.response.value(t - x - later)).sum::<f64>();
        exponential.iter().map(|(later, q)| q * inner(*later)).sum()
    };
    (0..len).map(sample).collect()
}

fn extended(extent_max_ps: f64) -> SparseOptions {
    SparseOptions { extent_max_ps, ..SparseOptions::default() }
}

/// A bounce 14 ps wide at SNR 800: two pulses as points, one at the bound as what it is.
#[test]
fn a_widened_bounce_is_one_pulse_at_its_centroid() {
    let mut rng = ChaCha8Rng::seed_from_u64(41);
    let (sd, len, draws) = (1.0 / 800.0, 120, 150);
    for shape in [gaussian(), exponential()] {
        let (mut pulls, mut width_pulls, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..draws {
            let at = 3000.0 + rng.random_range(0.0..DT_PS);
            let y = with_noise(&spread(&shape, at, 14.0, 0.0, len), sd, &mut rng);
            assert!(fit_white(&shape, &y, sd, &SparseOptions::default()).pulses.len() > 1, "{}", shape.name);
            let solution = fit_white(&shape, &y, sd, &extended(50.0));
            assert_eq!(solution.pulses.len(), 1, "{}", shape.name);
            let pulse = solution.pulses[0];
            let own_sd = solution.covariance_ps2[0].sqrt();
            if pulse.tail_ps == 0.0 {
                ratios.push(own_sd / bound_ps(&shape, &[(at, 1.0)], sd, len)[0]);
                width_pulls.push((pulse.width_ps - 14.0) / pulse.width_sd_ps);
            }
            pulls.push((pulse.time_ps - at) / own_sd);
        }
        println!("{}: time / sd {:.3}, width / sd {:.3}", shape.name, rms(&pulls), rms(&width_pulls));
        assert!((0.8..1.2).contains(&rms(&pulls)), "{}: {}", shape.name, rms(&pulls));
        assert!((0.8..1.25).contains(&rms(&width_pulls)), "{}: {}", shape.name, rms(&width_pulls));
        // The unknown width costs the time a few per cent over the bound of a point; a tail, or chi2, widens the
        // interval in a few cases.
        let near = ratios.iter().filter(|r| (1.0..1.09).contains(*r)).count();
        assert!(near > draws * 9 / 10, "{}: {near}", shape.name);
    }
}

#[test]
fn a_point_stays_a_point_and_a_pair_stays_a_pair() {
    let mut rng = ChaCha8Rng::seed_from_u64(42);
    let sd = 0.01;
    for shape in [gaussian(), exponential()] {
        let (mut errors, mut widened) = (Vec::new(), 0);
        for _ in 0..200 {
            let truth = [(3000.0 + rng.random_range(0.0..DT_PS), 1.0)];
            let y = with_noise(&clean(&shape, &truth, 0.0, 120), sd, &mut rng);
            let solution = fit_white(&shape, &y, sd, &extended(30.0));
            assert_eq!(solution.pulses.len(), 1);
            widened += usize::from(solution.pulses[0].width_ps > 0.0);
            errors.push((solution.pulses[0].time_ps - truth[0].0) / bound_ps(&shape, &truth, sd, 120)[0]);
        }
        println!("{}: rms / bound {:.3}, {widened} widened", shape.name, rms(&errors));
        assert!((0.85..1.15).contains(&rms(&errors)) && widened < 16, "{widened} {}", rms(&errors));
        let mut pairs = 0;
        for _ in 0..100 {
            let at = 3000.0 + rng.random_range(0.0..DT_PS);
            let y = with_noise(&clean(&shape, &[(at, 1.0), (at + 80.0, 1.0)], 0.0, 120), sd, &mut rng);
            pairs += usize::from(fit_white(&shape, &y, sd, &extended(30.0)).pulses.len() == 2);
        }
        assert!(pairs >= 98, "{}: {pairs}", shape.name);
    }
}

#[test]
fn a_tail_does_not_move_the_centroid() {
    let mut rng = ChaCha8Rng::seed_from_u64(43);
    let (shape, sd) = (exponential(), 1.0 / 800.0);
    let mut pulls = Vec::new();
    for _ in 0..25 {
        let y = with_noise(&spread(&shape, 3010.0, 10.0, 30.0, 120), sd, &mut rng);
        let solution = fit_white(&shape, &y, sd, &extended(50.0));
        assert_eq!(solution.pulses.len(), 1);
        let pulse = solution.pulses[0];
        pulls.push((pulse.time_ps - 3010.0) / solution.covariance_ps2[0].sqrt());
        assert!((pulse.tail_ps - 30.0).abs() < 4.5 * pulse.tail_sd_ps, "{pulse:?}");
    }
    assert!((0.65..1.4).contains(&rms(&pulls)), "{}", rms(&pulls));
}
