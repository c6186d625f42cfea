//! The response as many records show it, held against the shape that made them.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use crate::response::Response;
use crate::sparse::{OwnResponse, Profile, ResponseErrors, SparseOptions};

const DT_PS: f64 = 50.0;
const SAMPLES: usize = 400;

/// A fast diode's pulse, its maximum at 0.
fn diode(t: f64) -> f64 {
    if t < 0.0 { (-0.5 * (t / 40.0).powi(2)).exp() } else { (1.0 + t / 45.0) * (-t / 45.0).exp() }
}

fn calibrated() -> Response {
    let values: Vec<f64> = (-50..=150).map(|n| diode(6.25 * f64::from(n))).collect();
    Response::new(-50.0 * 6.25, 6.25, &values)
}

/// Records of one or two pulses each, as a sensor of the shape `own(time, record)` sees them, in white noise.
fn records(own: impl Fn(f64, usize) -> f64, snr: f64, count: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let noise = Normal::new(0.0, 1.0 / snr).expect("positive");
    let record = |k: usize| {
        let first = rng.random_range(2000.0..3000.0);
        let second = first + rng.random_range(800.0..9000.0);
        let share = rng.random_range(0.02..1.0);
        let light = |n: usize| own(n as f64 * DT_PS - first, k) + share * own(n as f64 * DT_PS - second, k);
        (0..SAMPLES).map(|n| light(n) + noise.sample(&mut rng)).collect()
    };
    (0..count).map(record).collect()
}

/// What they say of the calibration's response.
fn own_response(records: &[Vec<f64>], snr: f64, options: &SparseOptions) -> Option<OwnResponse> {
    let sd_v = [1.0 / snr; SAMPLES];
    let errors = ResponseErrors::new(&calibrated(), options.extent_max_ps > 0.0).expect("it is a pulse");
    errors.own_response(|coefficients, least_share| {
        let score = |mean_v: &Vec<f64>| {
            let profile =
                Profile { mean_v, sd_v: &sd_v, acf: &[], slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: DT_PS };
            errors.score(&profile, coefficients, Response::clone, least_share, options)
        };
        records.iter().filter_map(score).collect()
    })
}

#[test]
fn another_width_is_found_within_its_error() {
    let options = SparseOptions::default();
    for (snr, factor) in [(50.0, 0.95), (50.0, 1.05), (200.0, 0.98), (200.0, 1.02), (200.0, 1.05)] {
        for seed in 0..3 {
            let own = own_response(&records(|t, _| diode(t / factor), snr, 60, seed), snr, &options).expect("it shows");
            let [width, sd] = own.width.expect("it is another");
            let of_calibration = calibrated().width_ps();
            let shown = ResponseErrors::new(&calibrated(), false).unwrap().response(&own.coefficients).width_ps();
            assert!((width - factor).abs() < 3.0 * sd && sd < 0.6 / snr, "{snr}, {factor}: {own:?}");
            assert!((shown / of_calibration - factor).abs() < 3.0 * sd && own.is_common(), "{snr}, {factor}: {own:?}");
        }
    }
}

/// Shots that come early and late widen the response to either side: nothing moves.
#[test]
fn a_blur_is_told_from_another_width() {
    for (snr, sd_ps) in [(50.0, 20.0), (200.0, 20.0), (200.0, 30.0)] {
        let blurred = |t: f64| {
            let nodes = (-40..=40).map(|n| 0.1 * f64::from(n));
            let weighed = nodes.map(|x| ((-0.5 * x * x).exp(), diode(t - sd_ps * x)));
            let (weights, sum) = weighed.fold((0.0, 0.0), |(w, s), (weight, value)| (w + weight, s + weight * value));
            sum / weights
        };
        let own = own_response(&records(|t, _| blurred(t), snr, 60, 7), snr, &SparseOptions::default());
        let own = own.expect("it shows");
        let errors = ResponseErrors::new(&calibrated(), false).unwrap();
        let shown = errors.response(&own.coefficients);
        assert!(own.coefficients[0] == 0.0 && own.coefficients[1] > 0.0 && own.is_common(), "{snr}, {sd_ps}: {own:?}");
        // As little as `recalibrate` says.
        let (moved_ps, wider_ps) = (errors.delay_ps(&shown), shown.width_ps() - calibrated().width_ps());
        assert!(moved_ps.abs() < 0.5 * wider_ps, "{snr}, {sd_ps}: {moved_ps} of {wider_ps}");
        let peak_ps = shown.peak_ps() - moved_ps;
        let off = |t: f64| (shown.value(t + moved_ps) / shown.height() - blurred(t) / blurred(peak_ps)).abs();
        let off = (-4..20).map(|n| off(f64::from(n) * DT_PS)).fold(0.0, f64::max);
        assert!(off < 0.02, "{snr}, {sd_ps}: {off}");
    }
}

/// Ripple that is the same in every shot of a record, under weak pulses, is no tail of the response.
#[test]
fn ripple_is_no_tail() {
    let snr = 10.0;
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut records = records(|t, _| diode(t), snr, 24, 5);
    for record in &mut records {
        // Four times the noise.
        let [cos, sin] = [0, 1].map(|_| Normal::new(0.0, 4.0 / snr).expect("positive").sample(&mut rng));
        for (n, value) in record.iter_mut().enumerate() {
            let turn = std::f64::consts::TAU * 0.025e-3 * n as f64 * DT_PS;
            *value += cos * turn.cos() + sin * turn.sin();
        }
    }
    let own = own_response(&records, snr, &SparseOptions::default());
    assert!(own.is_none(), "{own:?}");
}

#[test]
fn an_echo_and_a_tail_are_found() {
    let points = SparseOptions::default();
    let spread = SparseOptions { extent_max_ps: 100.0, ..points.clone() };
    let echoing = |t: f64| diode(t) + 0.01 * diode(t - 600.0);
    let tailed = |t: f64| diode(t) + 0.01 * (-t.max(0.0) / 1000.0).exp() * (1.0 - (-t.max(0.0) / 40.0).exp());
    for seed in 0..3 {
        // Whether light comes from points or may be spread.
        let cases =
            [(&echoing as &dyn Fn(f64) -> f64, &points), (&tailed, &points), (&echoing, &spread), (&tailed, &spread)];
        for (shape, options) in cases {
            let own = own_response(&records(|t, _| shape(t), 200.0, 60, seed), 200.0, options).expect("it shows");
            let errors = ResponseErrors::new(&calibrated(), options.extent_max_ps > 0.0).unwrap();
            let shown = errors.response(&own.coefficients);
            // How high a response is, its pulses' amplitudes say; when it arrives, nothing does.
            let off_at = |t: f64, late: f64| (shown.value(t + late) / shown.height() - shape(t) / shape(0.0)).abs();
            let most = |late: f64| (0..40).map(|n| off_at(f64::from(n) * DT_PS, late)).fold(0.0, f64::max);
            let off = (-20..=20).map(|n| most(0.1 * f64::from(n))).fold(f64::INFINITY, f64::min);
            assert!(own.is_common() && off < 0.003, "{off}: {own:?}");
        }
    }
}

/// A right response stays as it is, and so does one beside patches that spread light each in their own way.
#[test]
fn what_is_not_the_sensors_is_left_alone() {
    let options = SparseOptions::default();
    for seed in 0..3 {
        for snr in [20.0, 200.0] {
            let own = own_response(&records(|t, _| diode(t), snr, 60, seed), snr, &options);
            assert!(own.is_none(), "{snr}: {own:?}");
        }
        let spread = records(|t, k| diode(t / (1.0 + 0.02 * (k % 6) as f64)), 200.0, 60, seed);
        let as_points = own_response(&spread, 200.0, &options);
        assert!(as_points.as_ref().is_none_or(|own| !own.is_common()), "{as_points:?}");
        let as_spread = own_response(&spread, 200.0, &SparseOptions { extent_max_ps: 100.0, ..options.clone() });
        assert!(as_spread.as_ref().is_none_or(|own| !own.is_common()), "{as_spread:?}");
        // A sensor that has become wider looks like patches that spread light, and is no narrower one with a tail.
        let wider = records(|t, _| diode(t / 1.03), 200.0, 60, seed);
        let as_spread = own_response(&wider, 200.0, &SparseOptions { extent_max_ps: 100.0, ..options.clone() });
        assert!(as_spread.as_ref().is_none_or(|own| own.width.is_none()), "{as_spread:?}");
    }
    let few = records(|t, _| diode(t / 1.05), 200.0, 5, 0);
    assert!(own_response(&few, 200.0, &options).is_none());
}
