//! What light that an onset does not resolve adds to its length: companions, the light of longer paths.
//!
//! Companions come so close behind an onset's own light that all make one pulse. Those of `r_k` times its strength, by
//! `D_k` longer, move the centroid and add to its variance by
//!
//! ```text
//! pull = sum r_k D_k / (1 + R),    excess = sum r_k D_k^2 / (1 + R) - pull^2,    R = sum r_k
//! ```
//!
//! The lengths `D_k` follow from the places of patches. The strengths do not, but companions that came far enough
//! behind made onsets of their own: they tell how often there is such light, and how strong it is. Where there is none
//! to be seen, it is weaker than the weakest onset. Widths of pulses tell the rest. The pull is the mean of its
//! posterior distribution over the strength of the companion that matters most, over the strengths of the others (to
//! first order about their means), and over one level of all light that makes no onset, which the widths of all onsets
//! tell together. What was learned from onsets follows that level the less, the more of them there were. Without a
//! level dozens of companions at mean strengths would add up to light that no width shows.

/// Strengths at which a distribution is evaluated.
const GRID: usize = 48;
/// Standard deviations that the grid reaches to either side.
const REACH_SD: f64 = 3.0;
/// Before anything is learned: chance that there is light, mean and standard deviation of the logarithm of its
/// strength; and as how many companions that counts.
const CHANCE: f64 = 0.5;
const LN_MEAN: f64 = -1.5;
const LN_SD: f64 = 1.0;
const PRIOR_COUNT: f64 = 4.0;
/// Strengths may differ as much as this at least.
const LN_SD_MIN: f64 = 0.2;
/// Chance that an onset is wider for another reason, in units of the density's peak: an excess that no strength
/// explains rules none of them out.
const TAIL: f64 = 1e-6;
/// Levels at which the light of companions is evaluated, 1 among them: least and largest logarithm, and the scale of
/// its Cauchy distribution.
const LEVELS: usize = 18;
const LN_LEVEL_MIN: f64 = -8.0;
const LN_LEVEL_MAX: f64 = 0.5;
const LN_LEVEL: f64 = 0.5;

/// How often companions have light, and how strong it is beside that of the onset's own path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strengths {
    chance: f64,
    ln_mean: f64,
    ln_sd: f64,
    /// By what power of a common level the strengths of this light follow it: 1 where nothing was learned.
    follows: f64,
}

/// What other light in an onset adds to its length, and the standard deviation of that.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pull {
    /// Mean.
    pub mean_m: f64,
    /// Standard deviation.
    pub sd_m: f64,
    /// What it adds to the variance of the length, on average.
    pub variance_m2: f64,
}

/// How much wider an onset is than its own light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excess {
    /// Variance of the length; noise makes it negative too.
    pub variance_m2: f64,
    /// Standard deviation of that variance, positive.
    pub sd_m2: f64,
}

impl Strengths {
    /// From companions that came far enough behind to make an onset of their own: its strength over that of the direct
    /// light of its profile, or `None` where there is no onset.
    #[must_use]
    pub fn learned(ratios: &[Option<f64>]) -> Self {
        let logarithms: Vec<f64> = ratios.iter().flatten().map(|ratio| ratio.max(f64::MIN_POSITIVE).ln()).collect();
        let count = logarithms.len() as f64;
        let chance = (count + PRIOR_COUNT * CHANCE) / (ratios.len() as f64 + PRIOR_COUNT);
        let ln_mean = (logarithms.iter().sum::<f64>() + PRIOR_COUNT * LN_MEAN) / (count + PRIOR_COUNT);
        let squares: f64 = logarithms.iter().map(|logarithm| (logarithm - ln_mean).powi(2)).sum();
        let ln_variance = (squares + PRIOR_COUNT * LN_SD.powi(2)) / (count + PRIOR_COUNT);
        let follows = PRIOR_COUNT / (ratios.len() as f64 + PRIOR_COUNT);
        Self { chance, ln_mean, ln_sd: ln_variance.sqrt().max(LN_SD_MIN), follows }
    }

    /// Strengths with their probabilities at a level; light that makes no onset is weaker than `least`.
    fn grid(&self, least: f64, ln_level: f64) -> impl Iterator<Item = (f64, f64)> {
        let Self { chance, ln_sd, .. } = *self;
        let ln_mean = self.ln_mean + self.follows * ln_level;
        let unseen_most = least * ln_level.min(0.0).exp();
        let at = |n: usize| (n as f64 + 0.5) / GRID as f64;
        let total: f64 = (0..GRID).map(|n| gauss(REACH_SD * (2.0 * at(n) - 1.0))).sum();
        let seen = move |n: usize| {
            let sds = REACH_SD * (2.0 * at(n) - 1.0);
            ((ln_mean + sds * ln_sd).exp(), chance * gauss(sds) / total)
        };
        // Closer to one another where they are weak: an onset without a width rules out all but little light.
        let unseen = move |n: usize| (unseen_most * at(n).powi(2), (1.0 - chance) * 2.0 * at(n) / GRID as f64);
        (0..GRID).map(seen).chain((0..GRID).map(unseen))
    }

    /// Mean and variance of the strength.
    fn moments(&self, least: f64, ln_level: f64) -> [f64; 2] {
        let unseen_most = least * ln_level.min(0.0).exp();
        let moment = |power: f64| {
            let unseen = unseen_most.powf(power) / (power + 1.0);
            let ln_seen = power * (self.ln_mean + self.follows * ln_level + 0.5 * power * self.ln_sd * self.ln_sd);
            self.chance * ln_seen.exp() + (1.0 - self.chance) * unseen
        };
        let mean = moment(1.0);
        [mean, f64::max(0.0, moment(2.0) - mean * mean)]
    }
}

/// An onset with companions that make no onsets of their own.
#[derive(Clone, Debug, PartialEq)]
pub struct Onset {
    /// By how much longer their paths are than the onset's own, m, and the strengths of their kind.
    pub companions: Vec<(f64, Strengths)>,
    /// Strength of the weakest light that makes an onset of its own.
    pub least: f64,
    /// How much wider it is than its own light.
    pub excess: Excess,
}

/// What companions add to the lengths of onsets.
#[must_use]
pub fn pulls(onsets: &[Onset]) -> Vec<Pull> {
    let at_levels = |onset: &Onset| {
        let light = Light::new(onset)?;
        Some((0..LEVELS).map(|n| light.pulled(onset, n)).collect())
    };
    let pulled: Vec<Option<Vec<Moments>>> = onsets.iter().map(at_levels).collect();
    let ln_weight = |n: usize| {
        let widths: f64 = pulled.iter().flatten().map(|at_levels| at_levels[n].weight.ln()).sum();
        widths - (ln_level(n) / LN_LEVEL).powi(2).ln_1p()
    };
    let ln_weights: Vec<f64> = (0..LEVELS).map(ln_weight).collect();
    let largest = ln_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let pull = |at_levels: &Option<Vec<Moments>>| {
        let Some(at_levels) = at_levels else { return Pull::default() };
        let mut all = Moments::default();
        for (ln_weight, at_level) in ln_weights.iter().zip(at_levels) {
            all.add((ln_weight - largest).exp() / at_level.weight, at_level);
        }
        all.pull()
    };
    pulled.iter().map(pull).collect()
}

/// Level `n` of the light of companions, as a logarithm.
fn ln_level(n: usize) -> f64 {
    LN_LEVEL_MIN + (LN_LEVEL_MAX - LN_LEVEL_MIN) * n as f64 / (LEVELS - 1) as f64
}

/// Sums over weighted possibilities.
#[derive(Default)]
struct Moments {
    weight: f64,
    first_m: f64,
    second_m2: f64,
    variance_m2: f64,
}

impl Moments {
    fn add(&mut self, factor: f64, other: &Self) {
        self.weight += factor * other.weight;
        self.first_m += factor * other.first_m;
        self.second_m2 += factor * other.second_m2;
        self.variance_m2 += factor * other.variance_m2;
    }

    fn pull(&self) -> Pull {
        let mean_m = self.first_m / self.weight;
        let sd_m = f64::max(0.0, self.second_m2 / self.weight - mean_m * mean_m).sqrt();
        Pull { mean_m, sd_m, variance_m2: self.variance_m2 / self.weight }
    }
}

/// Light of the companions of an onset: the main one, and all others at each level.
struct Light {
    main_m: f64,
    strengths: Strengths,
    others: Vec<Others>,
}

/// Sums over the strengths of all companions but the main one.
#[derive(Default)]
struct Others {
    /// Of means times powers of the distance, 0 to 2.
    means: [f64; 3],
    /// Of variances times powers of the distance, 0 to 4.
    variances: [f64; 5],
}

impl Light {
    /// `None` without companions.
    fn new(onset: &Onset) -> Option<Self> {
        let Onset { companions, least, .. } = onset;
        let matters = |n: &usize| companions[*n].0 * companions[*n].1.moments(*least, 0.0)[0];
        let main = (0..companions.len()).max_by(|a, b| matters(a).total_cmp(&matters(b)))?;
        let others = |n: usize| {
            let mut sums = Others::default();
            let others = companions.iter().enumerate().filter(|(other, _)| *other != main);
            for (longer_m, strengths) in others.map(|(_, companion)| companion) {
                let [mean, variance] = strengths.moments(*least, ln_level(n));
                (0..3).for_each(|power| sums.means[power] += mean * longer_m.powi(power as i32));
                (0..5).for_each(|power| sums.variances[power] += variance * longer_m.powi(power as i32));
            }
            sums
        };
        let (main_m, strengths) = companions[main];
        Some(Self { main_m, strengths, others: (0..LEVELS).map(others).collect() })
    }

    /// The pull at level `n`, summed over the strengths of the main companion.
    fn pulled(&self, onset: &Onset, n: usize) -> Moments {
        let (excess, others) = (onset.excess, &self.others[n]);
        let mut sum = Moments::default();
        for (strength, chance) in self.strengths.grid(onset.least, ln_level(n)) {
            let moment = |power: usize| strength * self.main_m.powi(power as i32) + others.means[power];
            let light = 1.0 + moment(0);
            let pull_m = moment(1) / light;
            let wider_m2 = moment(2) / light - pull_m * pull_m;
            let [pull_m2, both_m3, wider_m4] = others.spread(pull_m, wider_m2).map(|one| one / (light * light));
            let sd_m2 = excess.sd_m2.hypot(wider_m4.sqrt());
            let (off_m2, told) = (excess.variance_m2 - wider_m2, both_m3 / (sd_m2 * sd_m2));
            let weight = chance * (gauss(off_m2 / sd_m2) * excess.sd_m2 / sd_m2 + TAIL);
            let mean_m = pull_m + told * off_m2.clamp(-sd_m2, sd_m2);
            sum.weight += weight;
            sum.first_m += weight * mean_m;
            sum.second_m2 += weight * (mean_m * mean_m + pull_m2 - told * both_m3);
            sum.variance_m2 += weight * wider_m2;
        }
        sum
    }
}

impl Others {
    /// Variance of the centroid, its covariance with the variance about it, and the variance of that, as the strengths
    /// make them for all light of strength 1: a little more light moves the centroid by its distance from
    /// it, and the variance by the square of that less what it is.
    fn spread(&self, pull_m: f64, wider_m2: f64) -> [f64; 3] {
        let [v0, v1, v2, v3, v4] = self.variances;
        // Sums of variances times powers of the distance from the centroid.
        let second = v2 - 2.0 * pull_m * v1 + pull_m.powi(2) * v0;
        let first = v1 - pull_m * v0;
        let third = v3 - 3.0 * pull_m * v2 + 3.0 * pull_m.powi(2) * v1 - pull_m.powi(3) * v0;
        let fourth =
            v4 - 4.0 * pull_m * v3 + 6.0 * pull_m.powi(2) * v2 - 4.0 * pull_m.powi(3) * v1 + pull_m.powi(4) * v0;
        let both = third - wider_m2 * first;
        let wider = fourth - 2.0 * wider_m2 * second + wider_m2 * wider_m2 * v0;
        [second.max(0.0), both, wider.max(0.0)]
    }
}

fn gauss(sds: f64) -> f64 {
    (-0.5 * sds * sds).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers from 0 to 1 that look random.
    struct Draws(u64);

    impl Draws {
        fn next(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 53) as f64
        }

        fn normal(&mut self) -> f64 {
            (0..12).map(|_| self.next()).sum::<f64>() - 6.0
        }
    }

    /// Seven in ten companions shine, with 0.3 times the direct light, give or take 40 %.
    fn strengths(draws: &mut Draws) -> Strengths {
        let mut strength = || (draws.next() < 0.7).then(|| (0.3_f64.ln() + 0.4 * draws.normal()).exp());
        Strengths::learned(&(0..4000).map(|_| strength()).collect::<Vec<_>>())
    }

    #[test]
    fn strengths_are_learned() {
        let Strengths { chance, ln_mean, ln_sd, .. } = strengths(&mut Draws(1));
        assert!((chance - 0.7).abs() < 0.03 && (ln_mean - 0.3_f64.ln()).abs() < 0.03 && (ln_sd - 0.4).abs() < 0.03);
        let Strengths { chance, .. } = Strengths::learned(&[None; 400]);
        assert!(chance < 0.01, "light that shows nowhere is nowhere: {chance}");
    }

    /// Pulls of onsets that are drawn: mean and standard deviation are right, whether widths tell much or nothing.
    #[test]
    fn pulls_have_the_errors_that_they_state() {
        let mut draws = Draws(2);
        let strengths = strengths(&mut draws);
        for sd_m2 in [1e-6, 1e-5, 1.0] {
            let mut true_m = Vec::new();
            let mut onsets = Vec::new();
            for _ in 0..4000 {
                let longer_m = [0.004 + 0.02 * draws.next(), 0.002];
                let lights = longer_m.map(|longer_m| {
                    let shines = draws.next() < 0.7;
                    let seen = (0.3_f64.ln() + 0.4 * draws.normal()).exp();
                    (longer_m, if shines { seen } else { 0.01 * draws.next() })
                });
                let [pull_m, wider_m2] = centroid(&lights);
                true_m.push(pull_m);
                let companions = longer_m.map(|longer_m| (longer_m, strengths)).to_vec();
                let excess = Excess { variance_m2: wider_m2 + sd_m2 * draws.normal(), sd_m2 };
                onsets.push(Onset { companions, least: 0.01, excess });
            }
            let off = |(true_m, pull): (&f64, Pull)| (true_m - pull.mean_m) / pull.sd_m;
            let off: Vec<f64> = true_m.iter().zip(pulls(&onsets)).map(off).collect();
            let mean = off.iter().sum::<f64>() / off.len() as f64;
            let spread = (off.iter().map(|off| off * off).sum::<f64>() / off.len() as f64).sqrt();
            assert!(mean.abs() < 0.15 && (0.75..1.1).contains(&spread), "widths to {sd_m2} m^2: {mean}, {spread}");
        }
    }

    /// How much later the centroid of all light is than that of strength 1 at 0, and the variance about it.
    fn centroid(lights: &[(f64, f64)]) -> [f64; 2] {
        let light = 1.0 + lights.iter().map(|(_, strength)| strength).sum::<f64>();
        let moment =
            |power: i32| lights.iter().map(|(at_m, strength)| strength * at_m.powi(power)).sum::<f64>() / light;
        let pull_m = moment(1);
        [pull_m, moment(2) - pull_m * pull_m]
    }

    /// Eighteen companions of which nothing is known, and onsets that are no wider than their own light: there is next
    /// to no other light in them, whatever strengths are usual. One onset says so to a third, many to a twentieth.
    #[test]
    fn narrow_onsets_rule_out_the_light_of_many_companions() {
        let companions: Vec<_> = (1..=18).map(|n| (0.002 * f64::from(n), Strengths::learned(&[]))).collect();
        let onset = Onset { companions, least: 0.3, excess: Excess { variance_m2: 0.0, sd_m2: 1e-5 } };
        for (count, most_m) in [(1, 5e-3), (100, 1e-3)] {
            let Pull { mean_m, sd_m, .. } = pulls(&vec![onset.clone(); count])[0];
            assert!(mean_m.abs() < most_m && sd_m < most_m, "{count}: pulled by {mean_m} m, to {sd_m} m");
        }
    }

    #[test]
    fn nothing_pulls_an_onset_without_companions() {
        let excess = Excess { variance_m2: 1e-4, sd_m2: 1e-6 };
        assert_eq!(pulls(&[Onset { companions: Vec::new(), least: 0.1, excess }]), [Pull::default()]);
    }
}
