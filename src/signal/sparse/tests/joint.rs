//! Several records of the same pulses.

use super::*;

/// A second record of the same pulses: other noise, sampling offset, response and amplitudes.
pub(super) fn two_records(shape: &Shape, pulses: &[(f64, f64)], sd: f64, rng: &mut ChaCha8Rng) -> [(Vec<f64>, f64); 2] {
    let mut record = |t0_ps: f64, factor: f64| {
        let sample = |n: usize| {
            let t = t0_ps + DT_PS * n as f64;
            pulses.iter().map(|(at, a)| factor * a * (shape.formula)(t - at)).sum::<f64>()
        };
        let clean: Vec<f64> = (0..120).map(sample).collect();
        (with_noise(&clean, sd, rng), t0_ps)
    };
    [record(T0_PS, 1.0), record(T0_PS - 61.0, 1.0)]
}

pub(super) fn profile<'a>(record: &'a (Vec<f64>, f64), sd_v: &'a [f64]) -> Profile<'a> {
    Profile { mean_v: &record.0, sd_v, acf: &[], slow_v2: &[], jitter: None, t0_ps: record.1, dt_ps: DT_PS }
}

/// Times are better by the root of two, with amplitudes shared or not, and their sds say so.
#[test]
fn two_records_are_better_by_the_root_of_two() {
    let mut rng = ChaCha8Rng::seed_from_u64(51);
    let (sd, options) = (0.02, SparseOptions::default());
    let sd_v = vec![sd; 120];
    for shape in [gaussian(), exponential()] {
        let (mut single, mut joint, mut pulls) = (Vec::new(), Vec::new(), Vec::new());
        for draw in 0..400 {
            let at = 3000.0 + rng.random_range(0.0..DT_PS);
            let records = two_records(&shape, &[(at, 1.0)], sd, &mut rng);
            let [first, second] = records.each_ref().map(|record| (profile(record, &sd_v), &shape.response));
            single.push(fit(&first.0, first.1, &options).pulses[0].time_ps - at);
            let both = fit_joint(&[first, second], &options, draw % 2 == 0);
            assert_eq!([both[0].pulses.len(), both[1].pulses.len()], [1, 1]);
            assert_eq!(both[0].pulses[0].time_ps, both[1].pulses[0].time_ps);
            let error = both[0].pulses[0].time_ps - at;
            joint.push(error);
            pulls.push(error / both[0].covariance_ps2[0].sqrt());
        }
        let gain = rms(&single) / rms(&joint);
        println!("{}: gain {gain:.3}, rms / own sd {:.3}", shape.name, rms(&pulls));
        assert!((1.28..1.56).contains(&gain) && (0.9..1.1).contains(&rms(&pulls)), "{gain} {}", rms(&pulls));
    }
}

/// One record twice, amplitudes shared, is that record with noise less by the root of two.
#[test]
fn a_record_twice_is_one_of_half_the_variance() {
    let mut rng = ChaCha8Rng::seed_from_u64(52);
    let shape = exponential();
    let y = with_noise(&clean(&shape, &[(2500.0, 1.0), (2620.0, 0.6)], 0.2, 120), 0.01, &mut rng);
    let options = SparseOptions { evidence_min: Some(25.0), ..SparseOptions::default() };
    let sd_v = [vec![0.01; 120], vec![0.01 / 2.0_f64.sqrt(); 120]];
    let of = |sd_v| Profile { mean_v: &y, sd_v, acf: &[], slow_v2: &[], jitter: None, t0_ps: T0_PS, dt_ps: DT_PS };
    let twice = fit_joint(&[(of(&sd_v[0]), &shape.response), (of(&sd_v[0]), &shape.response)], &options, true);
    let once = fit(&of(&sd_v[1]), &shape.response, &options);
    assert_eq!((twice[0].pulses.len(), once.pulses.len()), (2, 2));
    for (a, b) in twice[0].pulses.iter().zip(&once.pulses) {
        assert!((a.time_ps - b.time_ps).abs() < 1e-4 && (a.amplitude_v - b.amplitude_v).abs() < 1e-6);
        assert!((a.evidence / b.evidence - 1.0).abs() < 1e-5);
    }
    for (a, b) in twice[0].covariance_ps2.iter().zip(&once.covariance_ps2) {
        assert!((a / b - 1.0).abs() < 1e-4);
    }
}

/// A pulse that is dark in one record is found by the other, and amplitudes are each record's own.
#[test]
fn amplitudes_may_differ() {
    let mut rng = ChaCha8Rng::seed_from_u64(53);
    let shape = gaussian();
    let first = with_noise(&clean(&shape, &[(2000.0, 1.0), (3500.0, 0.5)], 0.0, 120), 0.01, &mut rng);
    let second = with_noise(&clean(&shape, &[(3500.0, 2.0)], 0.4, 120), 0.01, &mut rng);
    let sd_v = vec![0.01; 120];
    let of = |mean_v| {
        (
            Profile { mean_v, sd_v: &sd_v, acf: &[], slow_v2: &[], jitter: None, t0_ps: T0_PS, dt_ps: DT_PS },
            &shape.response,
        )
    };
    let solutions = fit_joint(&[of(&first), of(&second)], &SparseOptions::default(), false);
    let amplitudes: Vec<Vec<f64>> =
        solutions.iter().map(|f| f.pulses.iter().map(|p| p.amplitude_v).collect()).collect();
    assert_eq!(amplitudes[0].len(), 2);
    for (amplitude, expected) in amplitudes.concat().iter().zip([1.0, 0.5, 0.0, 2.0]) {
        assert!((amplitude - expected).abs() < 0.02, "{amplitudes:?}");
    }
    assert!((solutions[1].baseline_v - 0.4).abs() < 0.01);
}

/// Noise alone: at a threshold for one record in ten, that many have a false pulse, also with two amplitudes a pulse.
#[test]
fn false_pulses_of_pairs_of_records_are_as_rare_as_promised() {
    let mut rng = ChaCha8Rng::seed_from_u64(54);
    let shape = exponential();
    let sd_v = vec![1.0; 500];
    let draws = 600;
    for shared in [true, false] {
        let mut pulses = 0;
        for _ in 0..draws {
            let records = [0, 1].map(|_| with_noise(&vec![0.0; 500], 1.0, &mut rng));
            let of = |mean_v| {
                (
                    Profile { mean_v, sd_v: &sd_v, acf: &[], slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: DT_PS },
                    &shape.response,
                )
            };
            let both = [of(&records[0]), of(&records[1])];
            let strict = fit_joint(&both, &SparseOptions { pulses_max: 0, ..SparseOptions::default() }, shared);
            let threshold = strict[0].evidence_min - 2.0 * 1000_f64.ln();
            let options = SparseOptions { evidence_min: Some(threshold), pulses_max: 1, ..SparseOptions::default() };
            pulses += fit_joint(&both, &options, shared)[0].pulses.len();
        }
        println!("shared {shared}: {pulses} of {draws}");
        assert!((30..95).contains(&pulses), "{shared}: {pulses}");
    }
}
