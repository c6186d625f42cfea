//! The baseline of a profile, which the methods here do not model: the mean of the samples that no light reaches.

use periscope_signal::response::Response;
use periscope_signal::sparse::Profile;

/// A sample this many standard deviations off the others is light.
const LOUD_SIGMA: f64 = 4.0;
/// Less than this share of a record says nothing of its baseline.
const QUIET_SHARE: f64 = 0.1;
/// Rounds in which the quiet samples are found about their own mean.
const QUIET_ROUNDS: usize = 3;

/// The profile's samples without their baseline; as they are where light reaches nearly all of them.
///
/// # Panics
/// If the profile is empty, or half of its standard deviations are not positive.
#[must_use]
pub fn remove(profile: &Profile, response: &Response) -> Vec<f64> {
    let (first_ps, last_ps) = response.support_ps();
    let peak_ps = response.peak_ps();
    let before = ((peak_ps - first_ps) / profile.dt_ps).ceil() as usize;
    let after = ((last_ps - peak_ps) / profile.dt_ps).ceil() as usize;
    let baseline_v = quiet_mean(profile.mean_v, median(profile.sd_v), before, after).unwrap_or(0.0);
    profile.mean_v.iter().map(|sample| sample - baseline_v).collect()
}

/// Mean of the samples that no light reaches, given their noise `sd`: those that lie within 4 standard deviations of
/// the median, without the `before` samples ahead of a louder one and the `after` samples behind it. `None` where less
/// than a tenth of the record is left.
///
/// # Panics
/// If `sd` is not positive.
#[must_use]
pub fn quiet_mean(samples: &[f64], sd: f64, before: usize, after: usize) -> Option<f64> {
    assert!(sd > 0.0, "the noise must be positive");
    let len = samples.len();
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    let mut centre = *sorted.get(len / 2)?;
    for _ in 0..QUIET_ROUNDS {
        let mut quiet = vec![true; len];
        for n in (0..len).filter(|n| (samples[*n] - centre).abs() > LOUD_SIGMA * sd) {
            quiet[n.saturating_sub(before)..(n + after + 1).min(len)].fill(false);
        }
        let rest = || samples.iter().zip(&quiet).filter(|(_, quiet)| **quiet).map(|(sample, _)| sample);
        let count = rest().count();
        if (count as f64) < QUIET_SHARE * len as f64 {
            return None;
        }
        centre = rest().sum::<f64>() / count as f64;
    }
    Some(centre)
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    let half = sorted.len() / 2;
    *sorted.select_nth_unstable_by(half, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn the_quiet_part_of_a_record_has_its_baseline() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let pulse = |n: usize| 3.0 * (-0.5 * ((n as f64 - 90.0) / 4.0).powi(2)).exp();
        let mean_square = (0..200).map(|_| {
            let normal = |rng: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(rng) };
            let samples: Vec<f64> = (0..200).map(|n| 0.7 + pulse(n) + 0.1 * normal(&mut rng)).collect();
            (quiet_mean(&samples, 0.1, 12, 12).expect("mostly quiet") - 0.7).powi(2)
        });
        let rms = (mean_square.sum::<f64>() / 200.0).sqrt();
        // Of 200 samples about 150 are quiet.
        assert!(rms < 1.15 * 0.1 / 150_f64.sqrt(), "{rms}");
        assert_eq!(quiet_mean(&[0.0, 9.0, 0.0, 9.0], 0.1, 4, 4), None);
        assert_eq!(quiet_mean(&[], 0.1, 4, 4), None);
    }
}
