//! Stage `deconvolve`, method `sparse`: many profiles.

use periscope::stages::deconvolve::Deconvolve;
use periscope::stages::stage::{Apply, BesideTables};
use periscope::tables::{Calibration, Profile, Row};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::curve::Curve;
use super::{context, normal};

const SAMPLES: usize = 400;
const DT_PS: f64 = 50.0;
const NOISE_V: f64 = 0.005;
/// Standard deviation of the response.
const RESPONSE_PS: f64 = 100.0;

fn calibration() -> Calibration {
    Calibration {
        campaign: "c".into(),
        sensor: "s1".into(),
        shots: 1000,
        step_ps: 10.0,
        response_t0_ps: -400.0,
        response: (0..80).map(|i| (-0.5 * (10.0 * (f64::from(i) - 40.0) / RESPONSE_PS).powi(2)).exp()).collect(),
        width_ps: 235.0,
        ..Calibration::default()
    }
}

/// Three pulses in white noise, two of them a width of the response apart.
fn profile(n: usize) -> Profile {
    let mut rng = ChaCha8Rng::seed_from_u64(n as u64);
    let first_ps = rng.random_range(4000.0..6000.0);
    let pulses =
        [(first_ps, 1.0), (first_ps + rng.random_range(200.0..300.0), 0.5), (rng.random_range(9000.0..15_000.0), 0.1)];
    let height_v = |t_ps: f64| -> f64 {
        pulses.iter().map(|(at_ps, height_v)| height_v * (-0.5 * ((t_ps - at_ps) / RESPONSE_PS).powi(2)).exp()).sum()
    };
    Profile {
        campaign: "c".into(),
        sensor: "s1".into(),
        lit: n as i32 + 1,
        role: "scene".into(),
        shots: 1000,
        dt_ps: DT_PS,
        mean_v: Some((0..SAMPLES).map(|i| height_v(i as f64 * DT_PS) + NOISE_V * normal(&mut rng)).collect()),
        se_v: Some((0..SAMPLES).map(|_| NOISE_V).collect()),
        noise_v: NOISE_V * 1000_f64.sqrt(),
        noise_acf: vec![1.0].into(),
        gain_v: 0.001,
        ..Profile::default()
    }
}

/// Prints the table.
pub fn print(sizes: &[usize]) {
    println!(
        "\n| profiles of {SAMPLES} samples, three pulses | s (min, median, max) | impulses found |\n|---|---|---|"
    );
    let beside = BesideTables::from([("calibration".to_owned(), vec![Calibration::to_batch(&[calibration()])])]);
    let stage = Deconvolve::default();
    let context = context(&stage, &beside);
    let mut curve = Curve::default();
    for &count in sizes {
        let profiles: Vec<Profile> = (0..count).map(profile).collect();
        let mut impulses = 0;
        let seconds = curve.time(count, || {
            let rows = |profile: &Profile| stage.apply(&context, vec![profile.clone()]).expect("an explanation").rows;
            impulses = profiles.iter().flat_map(rows).map(|row| row.impulses.len()).sum();
        });
        println!("| {count} | {seconds} | {impulses} |");
    }
    curve.print(sizes[0], sizes[sizes.len() - 1]);
}
