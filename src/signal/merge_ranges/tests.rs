//! Truth merged from clipped and noisy copies, errors of the right size.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const LEN: usize = 400;
const DT_PS: f64 = 50.0;

/// A strong bounce that clips, and weak ones behind it; V on the first range's scale.
fn light(sample: f64) -> f64 {
    let pulse = |at: f64, a: f64| a * (-0.5 * ((sample - at) / 2.2).powi(2)).exp();
    pulse(60.3, 4.0) + pulse(150.7, 0.3) + pulse(171.2, 0.12) + pulse(290.4, 0.05)
}

struct Case {
    gain: f64,
    offset_v: f64,
    delay: f64,
    se_v: [f64; 2],
    limit_v: f64,
}

const CASE: Case = Case { gain: 0.1, offset_v: 0.013, delay: 0.0, se_v: [1e-3, 4e-4], limit_v: 0.5 };

/// Means and clipped samples of both ranges. The sensitive one is wrong for ten samples after it has clipped.
fn draw(case: &Case, rng: &mut ChaCha8Rng) -> [(Vec<f64>, Vec<f64>, Vec<bool>); 2] {
    let mut noisy = |v: f64, se: f64| {
        let normal: f64 = StandardNormal.sample(rng);
        v + se * normal
    };
    let clipped: Vec<bool> = (0..LEN).map(|n| light(n as f64) > case.limit_v).collect();
    let sensitive: Vec<f64> = (0..LEN)
        .map(|n| {
            let recovering = (1..=10).any(|k| n >= k && clipped[n - k]);
            let v = noisy(light(n as f64), case.se_v[0]).min(case.limit_v);
            if recovering { v - 0.08 } else { v }
        })
        .collect();
    let coarse = (0..LEN).map(|n| noisy(case.offset_v + case.gain * light(n as f64 - case.delay), case.se_v[1]));
    [(sensitive, vec![case.se_v[0]; LEN], clipped), (coarse.collect(), vec![case.se_v[1]; LEN], vec![false; LEN])]
}

fn views(ranges: &[(Vec<f64>, Vec<f64>, Vec<bool>)]) -> Vec<RangeProfile<'_>> {
    ranges.iter().map(|(mean_v, se_v, clipped)| RangeProfile { mean_v, se_v, clipped, prior: None }).collect()
}

fn options(delay_dt_ps: Option<f64>) -> MergeOptions {
    MergeOptions { margin_before: 1, margin_after: 10, delay_dt_ps }
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn samples_count_where_no_clipped_one_is_within_the_margins() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for _ in 0..300 {
        let share = rng.random_range(0.0..1.0);
        let clipped: Vec<bool> = (0..rng.random_range(0..40)).map(|_| rng.random_range(0.0..1.0) < share).collect();
        let (before, after) = (rng.random_range(0..6), rng.random_range(0..6));
        let near =
            |n: usize| (n.saturating_sub(after)..(n + before + 1).min(clipped.len())).any(|other| clipped[other]);
        let naive: Vec<bool> = (0..clipped.len()).map(|n| !near(n)).collect();
        assert_eq!(valid(&clipped, before, after), naive, "{clipped:?}, {before}, {after}");
    }
}

#[test]
fn gain_offset_and_delay_are_recovered_with_errors_of_the_right_size() {
    for (delay, fitted) in [(0.0, None), (0.0, Some(DT_PS)), (0.37, Some(DT_PS)), (-2.6, Some(DT_PS))] {
        let case = Case { delay, ..CASE };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (mut gains, mut offsets, mut delays, mut chi2, mut dof) = (vec![], vec![], vec![], 0.0, 0.0);
        for _ in 0..300 {
            let ranges = draw(&case, &mut rng);
            let merged = merge(&views(&ranges), &options(fitted)).expect("shared samples");
            let link = &merged.links[0];
            gains.push((link.gain - case.gain) / link.gain_sd);
            offsets.push((link.offset_v - case.offset_v) / link.offset_sd_v);
            if fitted.is_some() {
                delays.push((link.delay_ps - delay * DT_PS) / link.delay_sd_ps);
            }
            chi2 += link.chi2;
            dof += link.dof as f64;
        }
        println!("{delay} {fitted:?}: pulls {:.3} {:.3} {:.3}", rms(&gains), rms(&offsets), rms(&delays));
        // 300 draws: an rms of 1 is known to 4 %.
        for pulls in [&gains, &offsets, &delays] {
            assert!(pulls.is_empty() || (0.88..1.12).contains(&rms(pulls)), "{delay}: {}", rms(pulls));
            assert!(pulls.is_empty() || (pulls.iter().sum::<f64>() / 300.0).abs() < 0.2, "{delay}: biased");
        }
        assert!((chi2 / dof - 1.0).abs() < 0.02, "{delay}: {}", chi2 / dof);
    }
}

/// Where noise is not small against the light, a regression of one range on the other finds too small a gain.
#[test]
fn noise_of_the_first_range_does_not_bias_the_gain() {
    let case = Case { se_v: [0.03, 0.003], ..CASE };
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let (mut pulls, mut plain) = (vec![], 0.0);
    for _ in 0..400 {
        let ranges = draw(&case, &mut rng);
        let merged = merge(&views(&ranges), &options(None)).expect("shared samples");
        pulls.push((merged.links[0].gain - case.gain) / merged.links[0].gain_sd);
        let shared: Vec<usize> = (80..LEN).collect();
        let mean = |v: &[f64]| shared.iter().map(|n| v[*n]).sum::<f64>() / shared.len() as f64;
        let (x, y) = (mean(&ranges[0].0), mean(&ranges[1].0));
        let product: f64 = shared.iter().map(|n| (ranges[0].0[*n] - x) * (ranges[1].0[*n] - y)).sum();
        plain += product / shared.iter().map(|n| (ranges[0].0[*n] - x).powi(2)).sum::<f64>() / 400.0;
    }
    let bias = pulls.iter().sum::<f64>() / 400.0;
    assert!(bias.abs() < 0.2 && (0.88..1.12).contains(&rms(&pulls)), "{bias} {}", rms(&pulls));
    assert!(plain < 0.9 * case.gain, "{plain}");
}

#[test]
fn the_merged_profile_is_the_truth_within_its_errors() {
    for (delay, fitted) in [(0.0, None), (0.37, Some(DT_PS))] {
        let case = Case { delay, ..CASE };
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let (mut pulls, mut worst_scale) = (vec![], 0.0_f64);
        for _ in 0..60 {
            let ranges = draw(&case, &mut rng);
            let merged = merge(&views(&ranges), &options(fitted)).expect("shared samples");
            for n in 0..LEN {
                let sd = merged.se_v[n].hypot(merged.scale_sd_v(n));
                pulls.push((merged.mean_v[n] - light(n as f64)) / sd);
            }
            assert!(merged.se_v.iter().all(|se| *se <= 4.3e-3));
            // In the weak bounces the scale's error is small against the noise.
            worst_scale = (120..LEN).map(|n| merged.scale_sd_v(n) / merged.se_v[n]).fold(worst_scale, f64::max);
        }
        assert!((rms(&pulls) - 1.0).abs() < 0.03, "{delay}: {}", rms(&pulls));
        assert!(worst_scale < 0.15, "{delay}: {worst_scale}");
    }
}

#[test]
fn three_ranges_merge_by_their_variances_and_what_no_range_has_is_said() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let [first, second] = draw(&CASE, &mut rng);
    let third: Vec<f64> = second.0.iter().map(|v| 2.0 * v + 1.0).collect();
    let mut all_clipped = (third, vec![8e-4; LEN], vec![false; LEN]);
    let mut ranges = vec![first, second, all_clipped.clone()];
    let merged = merge(&views(&ranges), &options(None)).expect("shared samples");
    assert!((merged.links[1].gain / merged.links[0].gain - 2.0).abs() < 1e-6);
    // Where all are valid, the variances' reciprocals add.
    let (g, se) = (merged.links[0].gain, &merged.se_v);
    let expected = (1e6 + 2.0 * (g / 4e-4).powi(2)).sqrt().recip();
    assert!((se[200] / expected - 1.0).abs() < 1e-6);
    assert!((merged.shares[0][200] - (g / 4e-4).powi(2) * expected.powi(2)).abs() < 1e-9);

    // Clipped in every range at sample 60: infinite error there, and only there.
    ranges[1].2[60] = true;
    all_clipped.2[60] = true;
    ranges[2] = all_clipped;
    let merged = merge(&views(&ranges), &options(None)).expect("shared samples");
    let missing: Vec<usize> = (0..LEN).filter(|n| merged.se_v[*n].is_infinite()).collect();
    assert_eq!(missing, (59..=70).collect::<Vec<_>>());
    assert!(merged.mean_v.iter().all(|v| v.is_finite()));

    ranges[1].2.fill(true);
    assert_eq!(merge(&views(&ranges), &options(None)), Err(Error::NoCommonSamples { range: 1 }));
    assert!(merge(&views(&ranges)[..1], &options(None)).expect("one range").links.is_empty());
}

/// Light that ends while the sensitive range recovers: nothing that both ranges have says how they scale. What is
/// stated of gain and delay does, and the merged profile is the truth within its errors.
#[test]
fn stated_gains_scale_what_no_light_does() {
    let strong = |sample: f64| 4.0 * (-0.5 * ((sample - 60.3) / 2.2).powi(2)).exp();
    let (dt_ps, delay, stated) =
        (Some(DT_PS), 0.37, Prior { gain: 0.1, gain_sd: 2e-3, delay_ps: 18.5, delay_sd_ps: 0.5 });
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut normal = |sd: f64| -> f64 { sd * Distribution::<f64>::sample(&StandardNormal, &mut rng) };
    let (mut pulls, mut gains) = (vec![], vec![]);
    for _ in 0..60 {
        let gain = stated.gain + normal(stated.gain_sd);
        let clipped: Vec<bool> = (0..LEN).map(|n| strong(n as f64) > 0.5).collect();
        let fine: Vec<f64> = (0..LEN).map(|n| (strong(n as f64) + normal(1e-3)).min(0.5)).collect();
        let coarse: Vec<f64> = (0..LEN).map(|n| gain * strong(n as f64 - delay) + normal(4e-4)).collect();
        let (fine_se, coarse_se) = (vec![1e-3; LEN], vec![4e-4; LEN]);
        let whole = vec![false; LEN];
        let view = |prior| {
            [
                RangeProfile { mean_v: &fine, se_v: &fine_se, clipped: &clipped, prior: None },
                RangeProfile { mean_v: &coarse, se_v: &coarse_se, clipped: &whole, prior },
            ]
        };
        let options = MergeOptions { margin_before: 8, margin_after: 20, delay_dt_ps: dt_ps };
        let merged = merge(&view(Some(stated)), &options).expect("a prior");
        let link = &merged.links[0];
        assert!(link.gain_sd <= stated.gain_sd && link.delay_sd_ps <= stated.delay_sd_ps, "{link:?}");
        gains.push((link.gain - gain) / link.gain_sd);
        // Where the delay is off by its standard deviation, an edge is off by more than the noise: it counts as jitter.
        for n in (0..LEN).filter(|n| (strong(*n as f64 + 0.5) - strong(*n as f64 - 0.5)).abs() < 0.1) {
            pulls.push((merged.mean_v[n] - strong(n as f64)) / merged.se_v[n].hypot(merged.scale_sd_v(n)));
        }
        let alone = merge(&view(None), &options);
        assert!(alone.is_err() || alone.is_ok_and(|merged| merged.links[0].gain_sd > 0.05 * stated.gain));
    }
    println!("gains {:.3}, samples {:.3}", rms(&gains), rms(&pulls));
    assert!((0.75..1.25).contains(&rms(&gains)) && (rms(&pulls) - 1.0).abs() < 0.1, "{} {}", rms(&gains), rms(&pulls));
}

/// A stated gain has no part where light says more, nor where light contradicts it.
#[test]
fn light_overrules_stated_gains() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let ranges = draw(&CASE, &mut rng);
    let alone = merge(&views(&ranges), &options(Some(DT_PS))).expect("shared samples");
    for (gain, gain_sd) in [(0.1, 0.002), (0.3, 1e-6)] {
        let mut with = views(&ranges);
        with[1].prior = Some(Prior { gain, gain_sd, delay_ps: 0.0, delay_sd_ps: 0.1 });
        assert_eq!(merge(&with, &options(Some(DT_PS))), Ok(alone.clone()), "{gain}");
    }
}
