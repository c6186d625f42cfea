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
//! to be seen, it is weaker than the weakest onset. The width of the pulse tells the rest: the pull is the mean of its
//! posterior distribution over the strength of the companion that matters most, others at their mean strengths.

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

/// How often companions have light, and how strong it is beside that of the onset's own path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strengths {
    chance: f64,
    ln_mean: f64,
    ln_sd: f64,
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
        Self { chance, ln_mean, ln_sd: ln_variance.sqrt().max(LN_SD_MIN) }
    }

    /// Strengths with their probabilities; light that makes no onset is weaker than `least`.
    fn grid(&self, least: f64) -> impl Iterator<Item = (f64, f64)> {
        let Self { chance, ln_mean, ln_sd } = *self;
        let at = |n: usize| (n as f64 + 0.5) / GRID as f64;
        let total: f64 = (0..GRID).map(|n| gauss(REACH_SD * (2.0 * at(n) - 1.0))).sum();
        let seen = move |n: usize| {
            let sds = REACH_SD * (2.0 * at(n) - 1.0);
            ((ln_mean + sds * ln_sd).exp(), chance * gauss(sds) / total)
        };
        (0..GRID).map(seen).chain((0..GRID).map(move |n| (least * at(n), (1.0 - chance) / GRID as f64)))
    }

    /// Mean and variance of the strength.
    fn moments(&self, least: f64) -> [f64; 2] {
        let sum = |power: i32| self.grid(least).map(|(strength, chance)| chance * strength.powi(power)).sum::<f64>();
        let mean = sum(1);
        [mean, f64::max(0.0, sum(2) - mean * mean)]
    }
}

/// A companion by how much longer its path is, and how strong it is.
struct Light {
    longer_m: f64,
    strength: f64,
}

/// What companions add to the length of an onset: each longer than its own path by so many metres, with the strengths
/// of its kind. `least` is the strength of the weakest light that makes an onset of its own.
#[must_use]
pub fn pull(companions: &[(f64, Strengths)], least: f64, excess: Excess) -> Pull {
    let moments: Vec<[f64; 2]> = companions.iter().map(|(_, strengths)| strengths.moments(least)).collect();
    let matters = |n: &usize| companions[*n].0 * moments[*n][0];
    let by_pull = |a: &usize, b: &usize| matters(a).total_cmp(&matters(b));
    let Some(main) = (0..companions.len()).max_by(by_pull) else { return Pull::default() };
    let mut lights: Vec<Light> = companions
        .iter()
        .zip(&moments)
        .map(|((longer_m, _), [strength, _])| Light { longer_m: *longer_m, strength: *strength })
        .collect();
    let [mut total, mut first_m, mut second_m2, mut variance_m2] = [0.0; 4];
    for (strength, chance) in companions[main].1.grid(least) {
        lights[main].strength = strength;
        let [pull_m, wider_m2] = centroid(&lights);
        let weight = chance * (gauss((excess.variance_m2 - wider_m2) / excess.sd_m2) + TAIL);
        total += weight;
        first_m += weight * pull_m;
        second_m2 += weight * pull_m * pull_m;
        variance_m2 += weight * wider_m2;
    }
    let mean_m = first_m / total;
    // Of the others nothing but their chances is known.
    let others = (0..companions.len()).filter(|n| *n != main);
    let others_m2: f64 = others.map(|n| companions[n].0.powi(2) * moments[n][1]).sum();
    let main_m2 = f64::max(0.0, second_m2 / total - mean_m * mean_m);
    Pull { mean_m, sd_m: (main_m2 + others_m2).sqrt(), variance_m2: variance_m2 / total }
}

/// How much later the centroid of all light is than that of strength 1 at 0, and the variance about it.
fn centroid(lights: &[Light]) -> [f64; 2] {
    let light = 1.0 + lights.iter().map(|light| light.strength).sum::<f64>();
    let moment = |power: i32| lights.iter().map(|one| one.strength * one.longer_m.powi(power)).sum::<f64>() / light;
    let pull_m = moment(1);
    [pull_m, moment(2) - pull_m * pull_m]
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
        let Strengths { chance, ln_mean, ln_sd } = strengths(&mut Draws(1));
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
            let (mut squares, mut off, count) = (0.0, 0.0, 4000);
            for _ in 0..count {
                let longer_m = [0.004 + 0.02 * draws.next(), 0.002];
                let lights = longer_m.map(|longer_m| {
                    let shines = draws.next() < 0.7;
                    let strength =
                        if shines { (0.3_f64.ln() + 0.4 * draws.normal()).exp() } else { 0.01 * draws.next() };
                    Light { longer_m, strength }
                });
                let [true_m, wider_m2] = centroid(&lights);
                let excess = Excess { variance_m2: wider_m2 + sd_m2 * draws.normal(), sd_m2 };
                let Pull { mean_m, sd_m, .. } = pull(&longer_m.map(|longer_m| (longer_m, strengths)), 0.01, excess);
                off += (true_m - mean_m) / sd_m;
                squares += ((true_m - mean_m) / sd_m).powi(2);
            }
            let (off, spread) = (off / f64::from(count), (squares / f64::from(count)).sqrt());
            assert!(off.abs() < 0.15 && (0.75..1.1).contains(&spread), "widths to {sd_m2} m^2: {off}, {spread}");
        }
    }

    #[test]
    fn nothing_pulls_an_onset_without_companions() {
        let excess = Excess { variance_m2: 1e-4, sd_m2: 1e-6 };
        assert_eq!(pull(&[], 0.1, excess), Pull::default());
    }
}
