//! Averages against the plain mean, and what is judged by them.

use super::*;
use crate::averaged_response::averaged_response;
use crate::dark::Dark;
use crate::outlying::OutlierTest;
use crate::response::Response;
use crate::shot_spread::Spread;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

fn bytes(codes: &[i16]) -> Vec<u8> {
    codes.iter().flat_map(|code| code.to_le_bytes()).collect()
}

fn pulse(at: f64, samples: usize) -> impl Iterator<Item = f64> {
    (0..samples).map(move |i| 3000.0 * (-0.5 * ((i as f64 - at) / 2.5).powi(2)).exp())
}

fn shots(count: usize, jitter: f64, noise: f64, seed: u64) -> Vec<(Vec<u8>, i64)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| {
            // Sample 0 lies at position / 64; the pulse always at 60 on the grid.
            let position = (jitter * 64.0 * rng.random_range(-1.0..1.0)).round() as i64;
            let codes: Vec<i16> = pulse(60.0 - position as f64 / 64.0, 128)
                .map(|value| {
                    let normal: f64 = StandardNormal.sample(&mut rng);
                    (value - 500.0 + noise * normal).round() as i16
                })
                .collect();
            (bytes(&codes), position)
        })
        .collect()
}

fn views(shots: &[(Vec<u8>, i64)]) -> Vec<(Codes<'_>, i64)> {
    shots.iter().map(|(bytes, position)| (Codes::I16(bytes), *position)).collect()
}

fn sum(views: &[(Codes<'_>, i64)]) -> PhaseSums {
    let mut sums = PhaseSums::new(128);
    views.iter().for_each(|(codes, position)| sums.add(*codes, *position));
    sums
}

#[test]
fn without_jitter_it_is_the_plain_mean() {
    let shots = shots(37, 0.0, 30.0, 1);
    let mean = sum(&views(&shots)).finish().unwrap();
    let naive: Vec<f64> =
        (0..128).map(|i| views(&shots).iter().map(|(codes, _)| codes.to_f64()[i]).sum::<f64>() / 37.0).collect();
    assert_eq!(mean, Mean { first_position: 0, mean: naive });
}

#[test]
fn jittered_shots_lose_nothing_of_the_pulse() {
    let shots = shots(400, 2.0, 2.0, 2);
    let mean = sum(&views(&shots)).finish().unwrap();
    assert!(mean.mean.len() >= 123 && mean.first_position >= 1);
    let truth: Vec<f64> =
        pulse(60.0 - mean.first_position as f64, mean.mean.len()).map(|value| value - 500.0).collect();
    let worst = mean.mean.iter().zip(&truth).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst < 1.0, "{worst} codes of 3000");
}

/// A pulse too fast for its sampling: its mean is not its samples, but what `averaged_response` says.
#[test]
fn the_mean_of_an_undersampled_pulse_is_the_averaged_response() {
    let fast = |t: f64| (-0.5 * (t / 0.55_f64).powi(2)).exp();
    let response =
        Response::new(-5.0, 1.0 / 16.0, &(0..=160).map(|i| fast(f64::from(i) / 16.0 - 5.0)).collect::<Vec<_>>());
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for (shots, spread) in [(2000, 64), (300, 5), (50, 1)] {
        let mut sums = PhaseSums::new(128);
        let mut kept = Vec::new();
        for _ in 0..shots {
            let position = rng.random_range(0..spread) + 13;
            let codes: Vec<i16> = (0..128)
                .map(|i| (20_000.0 * fast(f64::from(i) + position as f64 / 64.0 - 60.3)).round() as i16)
                .collect();
            kept.push((bytes(&codes), position));
        }
        kept.iter().for_each(|(bytes, position)| sums.add(Codes::I16(bytes), *position));
        let mean = sums.finish().unwrap();
        let phases: Vec<i32> = sums.phase_shots().into_iter().map(|shots| shots as i32).collect();
        let averaged = averaged_response(&response, 1.0, &phases, 1e-4);
        let (mut worst, mut raw) = (0.0_f64, 0.0_f64);
        for (i, value) in mean.mean.iter().enumerate().skip(20).take(80) {
            let t = (mean.first_position + i as i64) as f64 - 60.3;
            worst = worst.max((value / 20_000.0 - averaged.value(t)).abs());
            raw = raw.max((value / 20_000.0 - fast(t)).abs());
        }
        assert!(worst < 1e-3 && raw > 5.0 * worst, "{shots} shots over {spread} phases: {worst}, without {raw}");
    }
    // Of a strong pulse the ends of it show too.
    let all = vec![1; 64];
    let support_ps = |negligible: f64| averaged_response(&response, 1.0, &all, negligible).support_ps();
    let (short, long) = (support_ps(1e-4), support_ps(1e-6));
    assert!(long.0 < short.0 - 2.0 && long.1 > short.1 + 2.0, "{short:?} {long:?}");
    let on_grid: Vec<i32> = (0..64).map(|phase| if phase == 0 { 7 } else { 0 }).collect();
    assert_eq!(averaged_response(&response, 1.0, &on_grid, 1e-4).value(0.3), response.value(0.3));
}

#[test]
fn order_does_not_matter_to_a_bit() {
    let shots = shots(100, 3.0, 20.0, 3);
    let forward = views(&shots);
    let mut backward = forward.clone();
    backward.reverse();
    let mut mixed = forward.clone();
    mixed.rotate_left(41);
    let mean = sum(&forward).finish();
    assert_eq!(sum(&backward).finish(), mean);
    assert_eq!(sum(&mixed).finish(), mean);
}

/// Shots dealt out at random places and handed over phase by phase: the same sums, to a bit, in any order.
#[test]
fn sums_of_pieces_handed_over_are_those_of_one_pass() {
    let shots = shots(300, 3.0, 20.0, 8);
    let views = views(&shots);
    let whole = sum(&views);
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for pieces in [1, 2, 7, 40] {
        let mut cuts: Vec<usize> =
            (1..pieces).map(|_| rng.random_range(0..=views.len())).chain([0, views.len()]).collect();
        cuts.sort_unstable();
        let mut handed: Vec<Vec<PhaseSum>> =
            cuts.windows(2).map(|cut| sum(&views[cut[0]..cut[1]]).phases().collect()).collect();
        handed.rotate_left(pieces / 2);
        let mut joined = PhaseSums::new(128);
        handed.into_iter().flatten().for_each(|phase| joined.absorb_phase(phase));
        assert_eq!(joined.finish(), whole.finish(), "{pieces} pieces");
        assert_eq!((joined.shots(), joined.phase_shots()), (whole.shots(), whole.phase_shots()));
    }
}

#[test]
fn sums_beyond_32_bits_are_exact() {
    let codes = bytes(&[i16::MIN, i16::MAX, -1, 0]);
    let mut sums = PhaseSums::new(4);
    for _ in 0..70_000 {
        sums.add(Codes::I16(&codes), 0);
    }
    assert_eq!(sums.finish().unwrap().mean, vec![-32768.0, 32767.0, -1.0, 0.0]);
}

#[test]
fn shots_that_do_not_overlap_have_no_mean() {
    let codes = bytes(&[1, 2, 3, 4]);
    let mut sums = PhaseSums::new(4);
    assert_eq!(sums.finish(), None);
    sums.add(Codes::I16(&codes), 0);
    sums.add(Codes::I16(&codes), 64 * 10);
    assert_eq!(sums.finish(), None);
}

#[test]
fn the_spread_is_the_noise_with_and_without_jitter() {
    for jitter in [0.0, 2.0] {
        let shots = shots(64, jitter, 40.0, 4);
        let views = views(&shots);
        let mean = sum(&views).finish().unwrap();
        let variances = Spread::of(&views, &mean, &Dark::at_start(32)).variances;
        let sd_of = |range: Range<usize>| {
            let (count, expected) = (range.len() as f64, &variances[range]);
            (expected.iter().sum::<f64>() / count).sqrt()
        };
        let all = sd_of(0..variances.len() - 1);
        assert!((all / 40.0 - 1.0).abs() < 0.03, "{jitter}: {all}");
        // On the edges of the pulse, which are 3000 codes high, too.
        let edge = 54 - mean.first_position as usize;
        let edges = sd_of(edge..edge + 12);
        assert!((edges / 40.0 - 1.0).abs() < 0.1, "{jitter}: {edges} on the edges");
    }
}

#[test]
fn outliers_are_rejected_and_others_are_not() {
    let good = shots(64, 1.0, 40.0, 5);
    let test = OutlierTest::new(&views(&good), Dark::at_start(32), 6.0).unwrap();
    let more = shots(2000, 1.0, 40.0, 6);
    let wrong = views(&more).iter().filter(|(codes, position)| test.is_outlier(*codes, *position)).count();
    assert!(wrong <= 2, "{wrong} of 2000 good shots rejected");
    for (bytes, position) in shots(200, 1.0, 40.0, 7) {
        let mut codes: Vec<i16> = bytes.chunks_exact(2).map(|code| i16::from_le_bytes([code[0], code[1]])).collect();
        codes[90] += 900;
        assert!(test.is_outlier(Codes::I16(&self::bytes(&codes)), position));
    }
    assert!(OutlierTest::new(&views(&good)[..5], Dark::at_start(32), 6.0).is_none());
}
