//! Light that repeats, folded and timed.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const DT_PS: f64 = 50.0;
/// 93.68 MHz: 213.49 samples.
const PERIOD_PS: f64 = 10_674.64;

/// Three pulses a period, one of them across its end.
fn light(t_ps: f64) -> f64 {
    let pulse = |at_ps: f64, a: f64| {
        let distance_ps = (t_ps - at_ps + PERIOD_PS / 2.0).rem_euclid(PERIOD_PS) - PERIOD_PS / 2.0;
        a * (-0.5 * (distance_ps / 106.0).powi(2)).exp()
    };
    pulse(2000.0, 1.0) + pulse(5555.0, 0.3) + pulse(10_660.0, 0.6)
}

fn record(len: usize, sd: f64, rng: &mut ChaCha8Rng) -> (Vec<f64>, Vec<f64>) {
    let sample = |n: usize| {
        let normal: f64 = StandardNormal.sample(rng);
        light(DT_PS * n as f64) + sd * normal
    };
    ((0..len).map(sample).collect(), vec![sd.max(1e-9); len])
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v * v, count + 1.0));
    f64::sqrt(sum / count)
}

#[test]
fn a_folded_record_is_the_light_of_one_period() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mean_v, sd_v) = record(2000, 0.0, &mut rng);
    let folded = fold(&PulseTrain { mean_v: &mean_v, sd_v: &sd_v, dt_ps: DT_PS }, PERIOD_PS);
    assert_eq!(folded.mean_v.len(), 213);
    for (b, v) in folded.mean_v.iter().enumerate() {
        let expected = light(b as f64 * folded.step_ps);
        assert!((v - expected).abs() < 2e-4, "sample {b}: {v} {expected}");
    }
    // A record of hardly more than a period: lines at its ends, where the filter does not reach.
    let short = PulseTrain { mean_v: &mean_v[..216], sd_v: &sd_v[..216], dt_ps: DT_PS };
    let folded = fold(&short, PERIOD_PS);
    for (b, v) in folded.mean_v.iter().enumerate() {
        let expected = light(b as f64 * folded.step_ps);
        let inside = (20..190).contains(&b);
        assert!((v - expected).abs() < if inside { 2e-4 } else { 0.02 }, "sample {b}: {v} {expected}");
    }
}

#[test]
fn a_period_of_whole_samples_is_the_plain_mean_and_ignored_samples_do_not_count() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mean_v: Vec<f64> = (0..70).map(|_| rng.random_range(-1.0..1.0)).collect();
    let mut sd_v: Vec<f64> = (0..70).map(|_| rng.random_range(0.5..2.0)).collect();
    sd_v[13] = f64::INFINITY;
    let folded = fold(&PulseTrain { mean_v: &mean_v, sd_v: &sd_v, dt_ps: 1.0 }, 10.0);
    for b in 0..10 {
        let weight = |r: usize| sd_v[b + 10 * r].powi(-2);
        let total: f64 = (0..7).map(weight).sum();
        let mean = (0..7).map(|r| weight(r) * mean_v[b + 10 * r]).sum::<f64>() / total;
        assert!((folded.mean_v[b] - mean).abs() < 1e-12 && (folded.se_v[b] - total.sqrt().recip()).abs() < 1e-12);
    }
    let ignored = [f64::INFINITY; 70];
    let nothing = fold(&PulseTrain { mean_v: &mean_v, sd_v: &ignored, dt_ps: 1.0 }, 10.0);
    assert!(nothing.se_v.iter().all(|se| se.is_infinite()));
}

#[test]
fn errors_of_folded_samples_have_the_right_size() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut pulls, mut ses) = (Vec::new(), 0.0);
    for _ in 0..100 {
        let (mean_v, sd_v) = record(2000, 0.02, &mut rng);
        let folded = fold(&PulseTrain { mean_v: &mean_v, sd_v: &sd_v, dt_ps: DT_PS }, PERIOD_PS);
        let place = |b: usize| b as f64 * folded.step_ps;
        pulls.extend((0..213).map(|b| (folded.mean_v[b] - light(place(b))) / folded.se_v[b]));
        ses += folded.se_v.iter().sum::<f64>() / 213.0 / 100.0;
    }
    let pull = rms(pulls.iter().copied());
    // Nine repetitions and a part of a tenth.
    let gain = ses / 0.02 * (2000.0_f64 / 213.5).sqrt();
    println!("pull {pull:.3}, error over sd / sqrt(repetitions) {gain:.3}");
    assert!((pull - 1.0).abs() < 0.02 && (0.9..1.05).contains(&gain), "{pull} {gain}");
}

#[test]
fn the_period_is_found_at_its_bound() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for (sd, len) in [(0.02, 2000), (0.1, 2000), (0.02, 650)] {
        let (mut errors, mut pulls) = (Vec::new(), Vec::new());
        for _ in 0..200 {
            let (mean_v, sd_v) = record(len, sd, &mut rng);
            let record = PulseTrain { mean_v: &mean_v, sd_v: &sd_v, dt_ps: DT_PS };
            let period = refine_period(&record, PERIOD_PS + rng.random_range(-30.0..30.0), 40.0).expect("light");
            errors.push(period.period_ps - PERIOD_PS);
            pulls.push((period.period_ps - PERIOD_PS) / period.sd_ps);
        }
        // Bound: the shape is unknown, so each place informs about the period only by how its repetitions differ.
        let slope = |t_ps: f64| (light(t_ps + 0.5) - light(t_ps - 0.5)) / sd;
        let information: f64 = (0..213)
            .map(|b| {
                let repetitions: Vec<f64> =
                    (0..10).filter(|r| (f64::from(b) + f64::from(*r) * 213.49) < len as f64).map(f64::from).collect();
                let mean = repetitions.iter().sum::<f64>() / repetitions.len() as f64;
                slope(DT_PS * f64::from(b)).powi(2) * repetitions.iter().map(|r| (r - mean).powi(2)).sum::<f64>()
            })
            .sum();
        let ratio = rms(errors.iter().copied()) * information.sqrt();
        let pull = rms(pulls.iter().copied());
        println!("{sd} {len}: rms {:.3} ps, over bound {ratio:.3}, over own sd {pull:.3}", rms(errors.iter().copied()));
        assert!((0.85..1.2).contains(&ratio) && (0.88..1.12).contains(&pull), "{sd} {len}: {ratio} {pull}");
    }
}

#[test]
fn noise_has_no_period_and_a_single_period_shows_none() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut false_alarms = 0;
    for _ in 0..20 {
        let mean_v: Vec<f64> = (0..2000).map(|_| StandardNormal.sample(&mut rng)).collect();
        let record = PulseTrain { mean_v: &mean_v, sd_v: &[1.0; 2000], dt_ps: DT_PS };
        false_alarms += usize::from(refine_period(&record, PERIOD_PS, 5.0).is_some_and(|period| period.sd_ps < 1.0));
    }
    assert!(false_alarms <= 2, "{false_alarms}");
    let (mean_v, sd_v) = record(300, 0.01, &mut rng);
    assert_eq!(refine_period(&PulseTrain { mean_v: &mean_v, sd_v: &sd_v, dt_ps: DT_PS }, PERIOD_PS, 5.0), None);
}

#[test]
fn a_circle_is_cut_open_in_the_middle_of_its_darkest_part() {
    let dark = |light: &[usize]| (0..20).map(|n| !light.contains(&n)).collect::<Vec<bool>>();
    assert_eq!(opening(&dark(&[4, 5, 12])), 18);
    assert_eq!(opening(&dark(&[0, 19])), 10);
    assert_eq!(opening(&dark(&[])), 0);
    assert_eq!(opening(&[false; 5]), 0);
}
