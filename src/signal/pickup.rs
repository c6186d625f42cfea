//! Pick-up that is synchronous with the laser, from captures with the light blocked, and its subtraction.
//!
//! Averaging does not remove what repeats with the trigger (the laser's driver, the modulator). A blocked capture holds
//! it without the light: it is the mean of all blocked profiles, weighted by their variances. Subtracted from a
//! profile, it adds its own error, which is common to all profiles that it is taken from: it is kept apart, and the two
//! errors add in quadrature for a single profile only. Where the pick-up's error is larger than the pick-up,
//! subtracting makes things worse: [`Pickup::power`] says how much pick-up there is.
//!
//! Not modelled: pick-up that changes over a session (chi2 of the blocked captures about their mean shows it), or with
//! the range.

/// A blocked profile: means and their standard errors.
#[derive(Clone, Copy, Debug)]
pub struct Blocked<'a> {
    /// Mean of each sample, V.
    pub mean_v: &'a [f64],
    /// Standard error of each, V; infinite for a sample to be ignored.
    pub se_v: &'a [f64],
}

/// Pick-up at each sample.
#[derive(Clone, Debug, PartialEq)]
pub struct Pickup {
    /// Mean of the blocked profiles, V; 0 where none has the sample.
    pub mean_v: Vec<f64>,
    /// Its standard error, V; 0 where none has the sample, since nothing is subtracted there.
    pub se_v: Vec<f64>,
    /// Squared differences of the profiles from their mean, over their variances.
    pub chi2: f64,
    /// Number of these differences less that of the means.
    pub dof: usize,
}

/// A profile less pick-up.
#[derive(Clone, Debug, PartialEq)]
pub struct Corrected {
    /// Mean of each sample, V.
    pub mean_v: Vec<f64>,
    /// Standard error of each, V, with the pick-up's.
    pub se_v: Vec<f64>,
}

/// Mean of blocked profiles on the same samples, the level of each removed: a profile's mean over its samples that
/// count is no pick-up but baseline.
///
/// # Panics
/// If there is no profile, lengths differ, or a standard error is not positive.
#[must_use]
pub fn mean(blocked: &[Blocked]) -> Pickup {
    let len = blocked.first().expect("there is a blocked profile").mean_v.len();
    for profile in blocked {
        assert!(profile.mean_v.len() == len && profile.se_v.len() == len, "blocked profiles have the same samples");
        assert!(profile.se_v.iter().all(|se| *se > 0.0), "the standard errors must be positive");
    }
    let levels: Vec<f64> = blocked.iter().map(level).collect();
    let weight = |profile: &Blocked, n: usize| profile.se_v[n].powi(-2);
    let (mut mean_v, mut se_v) = (vec![0.0; len], vec![0.0; len]);
    let (mut chi2, mut dof) = (0.0, 0);
    for n in 0..len {
        let total: f64 = blocked.iter().map(|profile| weight(profile, n)).sum();
        if total == 0.0 {
            continue;
        }
        let own = |(profile, level): (&Blocked, &f64)| weight(profile, n) * (profile.mean_v[n] - level);
        mean_v[n] = blocked.iter().zip(&levels).map(own).sum::<f64>() / total;
        se_v[n] = total.sqrt().recip();
        let square =
            |(profile, level): (&Blocked, &f64)| weight(profile, n) * (profile.mean_v[n] - level - mean_v[n]).powi(2);
        chi2 += blocked.iter().zip(&levels).map(square).sum::<f64>();
        dof += blocked.iter().filter(|profile| profile.se_v[n].is_finite()).count() - 1;
    }
    // Each level but one takes a degree of freedom from the differences between profiles.
    Pickup { mean_v, se_v, chi2, dof: dof.saturating_sub(blocked.len() - 1) }
}

/// Mean over the samples that count, each with the same weight, so that profiles with other errors have the same level.
fn level(profile: &Blocked) -> f64 {
    let (sum, count) = profile
        .mean_v
        .iter()
        .zip(profile.se_v)
        .filter(|(_, se)| se.is_finite())
        .fold((0.0, 0.0), |(sum, count), (v, _)| (sum + v, count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}

impl Pickup {
    /// Mean square of the pick-up without that of its errors, V^2, and its standard deviation. Within three of these of
    /// zero there is none to subtract.
    #[must_use]
    pub fn power(&self) -> (f64, f64) {
        let count = self.se_v.iter().filter(|se| **se > 0.0).count().max(1) as f64;
        let square = self.mean_v.iter().zip(&self.se_v).map(|(v, se)| v * v - se * se).sum::<f64>();
        // Var(v^2) = 2 se^4 + 4 se^2 m^2 for a normal v of mean m; m^2 is known as v^2 - se^2.
        let terms = self.mean_v.iter().zip(&self.se_v);
        let (variance, least) = terms.fold((0.0, 0.0), |(variance, least), (v, se)| {
            (variance + 4.0 * (v * se).powi(2) - 2.0 * se.powi(4), least + 2.0 * se.powi(4))
        });
        let variance: f64 = f64::max(variance, least);
        (square / count, variance.sqrt() / count)
    }

    /// `mean_v` less the pick-up, taken with a known `factor` (1 for the same range; the ratio of gains for another).
    ///
    /// # Panics
    /// If lengths differ.
    #[must_use]
    pub fn subtract(&self, mean_v: &[f64], se_v: &[f64], factor: f64) -> Corrected {
        assert!(mean_v.len() == self.mean_v.len() && se_v.len() == mean_v.len(), "lengths are the pick-up's");
        Corrected {
            mean_v: mean_v.iter().zip(&self.mean_v).map(|(v, pickup)| v - factor * pickup).collect(),
            se_v: se_v.iter().zip(&self.se_v).map(|(se, pickup)| se.hypot(factor * pickup)).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const LEN: usize = 300;

    fn ringing(n: usize) -> f64 {
        1e-3 * (0.3 * n as f64).sin() * (-(n as f64) / 80.0).exp()
    }

    fn noisy(level: f64, scale: f64, se: f64, rng: &mut ChaCha8Rng) -> (Vec<f64>, Vec<f64>) {
        let mut normal = || -> f64 { StandardNormal.sample(rng) };
        ((0..LEN).map(|n| level + scale * ringing(n) + se * normal()).collect(), vec![se; LEN])
    }

    fn views(profiles: &[(Vec<f64>, Vec<f64>)]) -> Vec<Blocked<'_>> {
        profiles.iter().map(|(mean_v, se_v)| Blocked { mean_v, se_v }).collect()
    }

    #[test]
    fn what_is_left_of_a_profile_is_noise_of_the_stated_size() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let ring_mean = (0..LEN).map(ringing).sum::<f64>() / LEN as f64;
        let (mut squares, mut chi2, mut dof) = (0.0, 0.0, 0.0);
        for _ in 0..200 {
            let blocked: Vec<_> =
                [2e-4, 1e-4, 3e-4].iter().map(|se| noisy(0.02 + 100.0 * se, 1.0, *se, &mut rng)).collect();
            let pickup = mean(&views(&blocked));
            let (profile, se_v) = noisy(0.5, 1.0, 1e-4, &mut rng);
            let corrected = pickup.subtract(&profile, &se_v, 1.0);
            let left = corrected.mean_v.iter().map(|v| v - 0.5 - ring_mean);
            squares += left.zip(&corrected.se_v).map(|(v, se)| (v / se).powi(2)).sum::<f64>() / (200 * LEN) as f64;
            chi2 += pickup.chi2;
            dof += pickup.dof as f64;
        }
        assert!((squares - 1.0).abs() < 0.03, "{squares}");
        assert!((chi2 / dof - 1.0).abs() < 0.02, "{}", chi2 / dof);
    }

    #[test]
    fn the_mean_is_weighted_and_ignores_what_is_to_be_ignored() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut blocked = vec![noisy(0.0, 1.0, 1e-4, &mut rng), noisy(0.0, 1.0, 2e-4, &mut rng)];
        (blocked[1].0[7], blocked[1].1[7]) = (1e6, f64::INFINITY);
        (blocked[0].1[9], blocked[1].1[9]) = (f64::INFINITY, f64::INFINITY);
        let pickup = mean(&views(&blocked));
        let levels: Vec<f64> = blocked
            .iter()
            .map(|(v, se)| {
                let used: Vec<f64> = (0..LEN).filter(|n| se[*n].is_finite()).map(|n| v[n]).collect();
                used.iter().sum::<f64>() / used.len() as f64
            })
            .collect();
        let own = |p: usize, n: usize| blocked[p].0[n] - levels[p];
        assert!((pickup.mean_v[3] - (4.0 * own(0, 3) + own(1, 3)) / 5.0).abs() < 1e-12);
        assert!((pickup.se_v[3] - 1e-4 / 1.25_f64.sqrt()).abs() < 1e-12);
        assert!((pickup.mean_v[7] - own(0, 7)).abs() < 1e-12 && pickup.se_v[7] == 1e-4);
        assert_eq!((pickup.mean_v[9], pickup.se_v[9]), (0.0, 0.0));
        // Pick-up of another range, at half the gain.
        let corrected = pickup.subtract(&[1.0; LEN], &[3e-4; LEN], 0.5);
        assert!((corrected.mean_v[3] - 1.0 + 0.5 * pickup.mean_v[3]).abs() < 1e-15);
        assert!((corrected.se_v[3] - 3e-4_f64.hypot(0.5 * pickup.se_v[3])).abs() < 1e-18);
        assert_eq!(corrected.se_v[9], 3e-4);
    }

    #[test]
    fn the_power_of_pickup_is_separated_from_that_of_noise() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let variance = {
            let mean = (0..LEN).map(ringing).sum::<f64>() / LEN as f64;
            (0..LEN).map(|n| (ringing(n) - mean).powi(2)).sum::<f64>() / LEN as f64
        };
        for (scale, expected) in [(0.0, 0.0), (1.0, variance)] {
            let (mut sum, mut pulls) = (0.0, 0.0);
            for _ in 0..400 {
                let (power, sd) = mean(&views(&[noisy(0.1, scale, 2e-4, &mut rng)])).power();
                sum += (power - expected) / sd / 400.0;
                pulls += ((power - expected) / sd).powi(2) / 400.0;
            }
            // The level that is removed takes one of 300 parts of the noise with it: 0.04 of a standard deviation.
            assert!(sum.abs() < 0.25 && (pulls.sqrt() - 1.0).abs() < 0.12, "{scale}: {sum} {}", pulls.sqrt());
        }
    }
}
