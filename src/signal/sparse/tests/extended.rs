//! Light spread in time by extended patches: centroid, width, tail, and pairs of points that must stay pairs.

use super::*;

/// Samples of a pulse whose light is spread by a Gaussian of sd `width`, and a centred exponential tail: rectangle
/// rule.
pub(super) fn spread(shape: &Shape, at: f64, width: f64, tail: f64, len: usize) -> Vec<f64> {
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

/// Chi2 of pulses `(time, sd)` of the best amplitudes, and a baseline, computed from scratch: normal equations by
/// elimination.
fn chi2_of(shape: &Shape, y: &[f64], sd: f64, pulses: &[(f64, f64)]) -> f64 {
    let mut columns: Vec<Vec<f64>> =
        pulses.iter().map(|(at, width)| spread(shape, *at, *width, 0.0, y.len())).collect();
    columns.push(vec![1.0; y.len()]);
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut rest = y.to_vec();
    // Orthogonal columns one by one: what is left of the data is the residual.
    for k in 0..columns.len() {
        for j in 0..k {
            let (share, other) = (dot(&columns[j], &columns[k]) / dot(&columns[j], &columns[j]), columns[j].clone());
            columns[k].iter_mut().zip(&other).for_each(|(v, o)| *v -= share * o);
        }
        let share = dot(&columns[k], &rest) / dot(&columns[k], &columns[k]);
        rest.iter_mut().zip(&columns[k]).for_each(|(r, v)| *r -= share * v);
    }
    dot(&rest, &rest) / (sd * sd)
}

/// Two points that are taken for one wide pulse: the pair beside it is the best of a grid, its gain what chi2 says from
/// scratch, its times are where the points are, as surely as it says.
#[test]
fn the_pair_beside_a_wide_pulse_is_the_best_two_points() {
    let mut rng = ChaCha8Rng::seed_from_u64(44);
    let sd = 0.02;
    for (shape, apart) in [(gaussian(), 110.0), (exponential(), 70.0)] {
        let (mut pulls, mut sums, mut count, mut compared) = (Vec::new(), Vec::new(), 0, 0);
        for draw in 0..120 {
            let at = 3000.0 + rng.random_range(0.0..DT_PS);
            let y = with_noise(&clean(&shape, &[(at, 1.0), (at + apart, 0.8)], 0.1, 120), sd, &mut rng);
            let options = SparseOptions { baseline: Baseline::Constant, ..extended(200.0) };
            let solution = fit_white(&shape, &y, sd, &options);
            let [pulse] = solution.pulses[..] else { continue };
            let Some(pair) = pulse.pair else { continue };
            count += 1;
            let [first, both, second] = pair.covariance_ps2;
            assert!(first * second > both * both && pair.times_ps[0] < pair.times_ps[1]);
            assert!(pair.amplitudes_v.iter().all(|amplitude| *amplitude > 0.0));
            let errors = [pair.times_ps[0] - at, pair.times_ps[1] - at - apart];
            pulls.extend([errors[0] / first.sqrt(), errors[1] / second.sqrt()]);
            sums.push((errors[1] - errors[0]) / (first + second - 2.0 * both).sqrt());
            if draw < 20 && pulse.tail_ps == 0.0 && pulse.kurtosis == 0.0 {
                compared += 1;
                let points = pair.times_ps.map(|time_ps| (time_ps, 0.0));
                let own = chi2_of(&shape, &y, sd, &points);
                let gain = chi2_of(&shape, &y, sd, &[(pulse.time_ps, pulse.width_ps)]) - own;
                assert!((gain - pair.gain).abs() < 0.05 + 1e-3 * own, "{}: {gain} {}", shape.name, pair.gain);
                for (a, b) in (0..18).flat_map(|a| (0..18).map(move |b| (a, b))) {
                    let times = [pulse.time_ps - 10.0 * f64::from(a), pulse.time_ps + 10.0 * f64::from(b) + 5.0];
                    assert!(chi2_of(&shape, &y, sd, &times.map(|time_ps| (time_ps, 0.0))) > own - 0.05);
                }
            }
        }
        println!("{}: {count} wide of 120, times / sd {:.3}, distance / sd {:.3}", shape.name, rms(&pulls), rms(&sums));
        assert!(count >= 60 && compared >= 3, "{}: {count} {compared}", shape.name);
        assert!((0.7..1.3).contains(&rms(&pulls)) && rms(&sums) < 1.5, "{}", shape.name);
    }
}

/// Points have no pair beside them, nor has light of any sign.
#[test]
fn only_wide_pulses_have_a_pair() {
    let mut rng = ChaCha8Rng::seed_from_u64(45);
    let shape = gaussian();
    let y = with_noise(&spread(&shape, 3010.0, 60.0, 0.0, 120), 0.005, &mut rng);
    let points = fit_white(&shape, &y, 0.005, &SparseOptions::default());
    assert!(points.pulses.iter().all(|pulse| pulse.pair.is_none()));
    let signed = fit_white(&shape, &y, 0.005, &SparseOptions { signed: true, ..extended(200.0) });
    assert!(signed.pulses.iter().all(|pulse| pulse.pair.is_none()));
    let wide = fit_white(&shape, &y, 0.005, &extended(200.0));
    assert!(wide.pulses.len() == 1 && wide.pulses[0].pair.is_some(), "{wide:?}");
}

/// A bounce from an even disk at SNR 500, whose light is no Gaussian: one pulse with a disk's shape, at its centroid
/// and as wide as it is. The best Gaussian leaves a chi-square of 3.8 a sample.
#[test]
fn a_bright_disk_is_one_pulse() {
    let mut rng = ChaCha8Rng::seed_from_u64(46);
    let (width, sd, draws, mut kurtosis) = (40.0, 1.0 / 500.0, 20, 0.0);
    let shape = exponential();
    let chords: Vec<(f64, f64)> = (-99..=99).map(|n| f64::from(n) / 100.0).map(|x| (x, (1.0 - x * x).sqrt())).collect();
    let total: f64 = chords.iter().map(|(_, light)| light).sum();
    let (mut pulls, mut width_pulls) = (Vec::new(), Vec::new());
    for _ in 0..draws {
        let at = 3000.0 + rng.random_range(0.0..DT_PS);
        let light: Vec<(f64, f64)> = chords.iter().map(|(x, light)| (at + 2.0 * width * x, light / total)).collect();
        let y = with_noise(&clean(&shape, &light, 0.1, 120), sd, &mut rng);
        let solution = fit_white(&shape, &y, sd, &extended(200.0));
        let [pulse] = solution.pulses[..] else { panic!("{} pulses", solution.pulses.len()) };
        assert!(pulse.tail_ps == 0.0, "{pulse:?}");
        kurtosis += pulse.kurtosis / f64::from(draws);
        pulls.push((pulse.time_ps - at) / solution.time_sd_ps(0));
        width_pulls.push((pulse.width_ps - width) / pulse.width_sd_ps);
    }
    println!("disk: times / sd {:.3}, widths / sd {:.3}, kurtosis {kurtosis:.3}", rms(&pulls), rms(&width_pulls));
    assert!((-1.0..-0.85).contains(&kurtosis), "{kurtosis}");
    assert!(rms(&pulls) < 1.5 && rms(&width_pulls) < 1.5, "{} {}", rms(&pulls), rms(&width_pulls));
}

/// Pulses near a time. The end of the test's response, where that is cut off, may look like one far behind.
fn near(solution: &SparseFit, time_ps: f64) -> Vec<Pulse> {
    solution.pulses.iter().filter(|pulse| (pulse.time_ps - time_ps).abs() < 500.0).copied().collect()
}

/// A second bounce at SNR 100,000: light over two disks, whose excess kurtosis is neither a Gaussian's nor a disk's.
/// One pulse at its centroid. As a Gaussian or a disk it would need small pulses on either side.
#[test]
fn bright_light_over_two_disks_is_one_pulse() {
    let mut rng = ChaCha8Rng::seed_from_u64(47);
    let (sd, draws) = (1e-5, 20);
    let shape = exponential();
    // Gauss and Chebyshev's rule of the second kind: exact moments.
    let chords: Vec<(f64, f64)> =
        (1..16).map(|n| f64::from(n) / 16.0 * std::f64::consts::PI).map(f64::sin_cos).collect();
    let chords: Vec<(f64, f64)> = chords.iter().map(|(sine, cosine)| (*cosine, sine * sine)).collect();
    let total: f64 = chords.iter().map(|(_, light)| light).sum();
    for (first, second) in [(12.0_f64, 12.0), (16.0, 8.0)] {
        let variance = first * first + second * second;
        let expected = -(first.powi(4) + second.powi(4)) / (variance * variance);
        let (mut pulls, mut width_pulls, mut kurtosis) = (Vec::new(), Vec::new(), 0.0);
        for _ in 0..draws {
            let at = 3000.0 + rng.random_range(0.0..DT_PS);
            let over_second = |(x, light): &(f64, f64)| {
                let (middle, light) = (at + 2.0 * first * x, light / total);
                chords.iter().map(move |(y, other)| (middle + 2.0 * second * y, light * other / total))
            };
            let light: Vec<(f64, f64)> = chords.iter().flat_map(over_second).collect();
            let y = with_noise(&clean(&shape, &light, 0.1, 120), sd, &mut rng);
            let solution = fit_white(&shape, &y, sd, &extended(60.0));
            let [pulse] = near(&solution, at)[..] else { panic!("{first} {second}: {:?}", solution.pulses) };
            kurtosis += pulse.kurtosis / f64::from(draws);
            pulls.push((pulse.time_ps - at) / solution.time_sd_ps(0));
            width_pulls.push((pulse.width_ps - variance.sqrt()) / pulse.width_sd_ps);
        }
        println!("{first} {second}: times {:.3}, widths {:.3}, kurtosis {kurtosis:.3}", rms(&pulls), rms(&width_pulls));
        assert!((kurtosis - expected).abs() < 0.15, "{first} {second}: {kurtosis} {expected}");
        assert!(rms(&pulls) < 1.5 && rms(&width_pulls) < 1.5, "{} {}", rms(&pulls), rms(&width_pulls));
    }
}

/// Light over a disk that is brighter where it is nearer, as most is: by 2 % a standard deviation, at SNR 200,000.
#[test]
fn tilted_light_is_one_pulse_at_its_centroid() {
    let mut rng = ChaCha8Rng::seed_from_u64(48);
    let (width, tilt, sd, draws) = (9.0, -0.02, 5e-6, 20);
    let shape = exponential();
    let chords: Vec<(f64, f64)> =
        (1..32).map(|n| f64::from(n) / 32.0 * std::f64::consts::PI).map(f64::sin_cos).collect();
    let light = |(sine, cosine): &(f64, f64)| (2.0 * width * cosine, sine * sine * (1.0 + 2.0 * tilt * cosine));
    let light: Vec<(f64, f64)> = chords.iter().map(light).collect();
    let total: f64 = light.iter().map(|(_, light)| light).sum();
    let centroid = light.iter().map(|(after, light)| after * light).sum::<f64>() / total;
    let (mut pulls, mut seen) = (Vec::new(), 0.0);
    for _ in 0..draws {
        let at = 3000.0 + rng.random_range(0.0..DT_PS);
        let arrivals: Vec<(f64, f64)> = light.iter().map(|(after, light)| (at + after, light / total)).collect();
        let y = with_noise(&clean(&shape, &arrivals, 0.1, 120), sd, &mut rng);
        let solution = fit_white(&shape, &y, sd, &extended(60.0));
        let [pulse] = near(&solution, at)[..] else { panic!("{:?}", solution.pulses) };
        pulls.push((pulse.time_ps - at - centroid) / solution.time_sd_ps(0));
        seen += pulse.tilt / f64::from(draws);
    }
    println!("tilt {seen:.4}, times / sd {:.3}", rms(&pulls));
    assert!((seen / tilt - 1.0).abs() < 0.3 && rms(&pulls) < 1.5, "{seen} {}", rms(&pulls));
}
