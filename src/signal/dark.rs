//! Where the records of a capture are dark: the stretch from which their baseline and noise are taken.
//!
//! It is the start of each record as long as the mean record is flat there: light varies from sample to sample, and is
//! the same in all shots, so that it stays in the mean where noise averages out. How far noise goes, the differences
//! between shots say, into which light does not enter ([`Scale`]). Where light is found at the start, the earliest flat
//! stretch takes its place whose level is the darkest, some way from the light. A record may have none.
//!
//! Not modelled: light that is flat over a whole stretch, at the start of a record; undershoot behind a pulse.

use std::ops::Range;

use super::average::{Mean, PHASES};
use super::codes::Codes;
use super::median::upper_median;
use super::noise;
use super::resample;

/// Standard deviations by which the spread of a stretch exceeds that of noise when light is claimed: three captures of
/// a million are found lit by chance.
const CLAIM_SIGMA: f64 = 4.5;
/// Levels of stretches within so many of their standard deviations are alike.
const ALIKE_SIGMA: f64 = 4.0;
/// One record alone has no differences: a stretch is lit when its variance is so many times that of the quietest
/// quarter of all stretches. Slow noise reaches half of that.
const LONE_RATIO: f64 = 9.0;
/// Variation below this share of the record's extent is arithmetic.
const ROUNDING: f64 = 1e-6;
/// Lags of the noise's autocorrelation that widen the test.
const LAGS: usize = 16;
/// So many samples tell the autocorrelation: each lag to 0.8 %.
const SPREAD_SAMPLES: usize = 1 << 14;

/// The stretch of a capture's records that is taken as dark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dark {
    /// Where it begins, as a place on the common grid; `None`: at the start of each record.
    pub place: Option<i64>,
    /// Its samples.
    pub samples: usize,
}

impl Dark {
    /// So many samples at the start of each record.
    #[must_use]
    pub fn at_start(samples: usize) -> Self {
        Self { place: None, samples }
    }

    /// Its samples in a record of `len` samples whose first one lies at `position`, in 1/64 sample.
    #[must_use]
    pub fn range(&self, len: usize, position: i64) -> Range<usize> {
        let latest = len.saturating_sub(self.samples) as i64;
        let start =
            self.place.map_or(0, |place| (place - position.div_euclid(PHASES as i64)).clamp(0, latest) as usize);
        start..(start + self.samples).min(len)
    }

    /// Its samples in a mean record.
    #[must_use]
    pub fn of_mean(&self, mean: &Mean) -> Range<usize> {
        let count = self.samples.min(mean.mean.len());
        let latest = (mean.mean.len() - count) as i64;
        let start = self.place.map_or(0, |place| (place - mean.first_position).clamp(0, latest) as usize);
        start..start + count
    }
}

/// What noise leaves in a sample of a mean record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Its variance; `None` where there is but one record.
    pub variance: Option<f64>,
    /// Sum of the squared autocorrelations over all lags: 1 for white noise.
    pub spread: f64,
}

impl Scale {
    /// From shots of a capture and their mean: their [`differences`] hold noise and no light. `variances`: of a shot at
    /// each place of the mean, as [`super::shot_spread::Spread`] has them.
    #[must_use]
    pub fn of(shots: &[(Codes<'_>, i64)], mean: &Mean, variances: &[f64]) -> Self {
        let mut known: Vec<f64> = variances.iter().copied().filter(|variance| variance.is_finite()).collect();
        if shots.len() < 2 || known.is_empty() {
            return Self { variance: None, spread: 1.0 };
        }
        let count = shots.len() as f64;
        // Light has shot noise, energy and jitter: half of the places have none.
        let own = upper_median(&mut known) / chi_square_share(count - 1.0, 0.0);
        let judges = SPREAD_SAMPLES.div_ceil(mean.mean.len()).min(shots.len());
        let acf = noise::estimate(&differences(&shots[..judges], mean), LAGS).acf;
        let spread = 1.0 + 2.0 * acf.iter().skip(1).map(|r| r * r).sum::<f64>();
        Self { variance: Some(own / count + rounding_variance(own.sqrt())), spread }
    }

    /// The same for a mean of more shots.
    #[must_use]
    pub fn of_more(self, from: usize, to: u64) -> Self {
        Self { variance: self.variance.map(|variance| variance * from as f64 / to as f64), ..self }
    }
}

/// Variance that rounding to whole codes leaves in the mean of any number of records, whose noise has the standard
/// deviation `sd`: that of a sawtooth after a Gaussian filter, harmonic by harmonic. Noise of half a code and more
/// leaves next to nothing, none a twelfth.
#[must_use]
pub fn rounding_variance(sd: f64) -> f64 {
    const HARMONICS: i32 = 50;
    let harmonic = |k: f64| (-(2.0 * std::f64::consts::PI * k * sd).powi(2)).exp() / (k * k);
    // The mean of the sine's square, of amplitude 1 / (pi k).
    (1..=HARMONICS).map(|k| harmonic(f64::from(k))).sum::<f64>() / (2.0 * std::f64::consts::PI.powi(2))
}

/// Each shot less the mean of all, moved to where the shot lies, on the places that both have. Light is the same in
/// both; the variance of the differences is that of a shot, less its share in the mean.
#[must_use]
pub fn differences(shots: &[(Codes<'_>, i64)], mean: &Mean) -> Vec<Vec<f64>> {
    let (mut values, mut moved, mut moved_by) = (Vec::new(), mean.mean.clone(), 0);
    let difference = |(codes, position): &(Codes<'_>, i64)| {
        codes.read_into(&mut values);
        let phase = position.rem_euclid(PHASES as i64);
        let later = i64::from(phase > 0);
        let by = later * PHASES as i64 - phase;
        if by != moved_by {
            resample::delay(&mean.mean, by as f64 / PHASES as f64, &mut moved);
            moved_by = by;
        }
        let offset = position.div_euclid(PHASES as i64) - mean.first_position;
        let (start, end) = ((-offset).max(0), (mean.mean.len() as i64 - later - offset).min(values.len() as i64));
        if start >= end {
            return Vec::new();
        }
        let beside = &moved[(start + offset + later) as usize..];
        values[start as usize..end as usize].iter().zip(beside).map(|(value, mean)| value - mean).collect()
    };
    shots.iter().map(difference).collect()
}

/// Where a mean record is dark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// At its start.
    AtStart,
    /// From this sample on.
    At(usize),
    /// Nowhere; from this sample on it varies least.
    Nowhere(usize),
}

/// Finds `samples` dark samples of a mean record. `clear`: samples that are not clipped, nor near to it.
///
/// # Panics
/// If `samples` is 0 or exceeds the record, or `clear` has another length.
#[must_use]
pub fn find(mean: &[f64], clear: &[bool], samples: usize, scale: &Scale) -> Place {
    assert!(samples > 0 && samples <= mean.len(), "a stretch lies within the record");
    assert_eq!(mean.len(), clear.len(), "a flag for each sample");
    let sums = Sums::new(mean, clear, samples);
    let limit = limit(&sums, scale);
    let is_flat = |start: usize| sums.is_clear(start) && sums.squares_about_mean(start) <= limit;
    if is_flat(0) {
        return Place::AtStart;
    }
    let flat: Vec<usize> = (0..=mean.len() - samples).filter(|start| is_flat(*start)).collect();
    // Light raises the level, or lowers that of a sensor whose pulses go down.
    let up = if sums.high >= -sums.low { 1.0 } else { -1.0 };
    let level = |start: usize| up * sums.mean(start);
    let Some(darkest) = flat.iter().map(|start| level(*start)).min_by(f64::total_cmp) else {
        let quietest = (0..=mean.len() - samples)
            .min_by(|a, b| sums.squares_about_mean(*a).total_cmp(&sums.squares_about_mean(*b)));
        return Place::Nowhere(quietest.unwrap_or(0));
    };
    let alike = darkest + ALIKE_SIGMA * (limit / samples as f64 * scale.spread / samples as f64).sqrt();
    let dark: Vec<usize> = flat.into_iter().filter(|start| level(*start) <= alike).collect();
    // The first of them may touch light that is too weak to be claimed.
    let run = dark.iter().enumerate().take_while(|(n, start)| **start == dark[0] + n).count();
    Place::At(dark[0] + (run / 2).min(samples))
}

/// Sum of squares about their mean that noise alone gives the samples of a stretch.
fn limit(sums: &Sums, scale: &Scale) -> f64 {
    let samples = sums.samples as f64;
    let floor = samples * (ROUNDING * (sums.high - sums.low)).powi(2);
    let of_noise = match scale.variance {
        Some(variance) => {
            let freedom = (samples - 1.0).max(1.0);
            variance * freedom * chi_square_share(freedom / scale.spread, CLAIM_SIGMA)
        }
        None => LONE_RATIO * sums.quiet_quarter(),
    };
    floor + of_noise
}

/// Chi-square over its degrees of freedom at so many standard deviations of a normal variable (Wilson and Hilferty,
/// Proc. Natl. Acad. Sci. 17, 684 (1931)).
fn chi_square_share(freedom: f64, sigma: f64) -> f64 {
    let variance = 2.0 / (9.0 * freedom);
    (1.0 - variance + sigma * variance.sqrt()).powi(3)
}

/// Running sums of a record, about its median.
struct Sums {
    samples: usize,
    totals: Vec<f64>,
    squares: Vec<f64>,
    unclear: Vec<usize>,
    middle: f64,
    /// Extremes, about the median.
    low: f64,
    high: f64,
}

impl Sums {
    fn new(mean: &[f64], clear: &[bool], samples: usize) -> Self {
        let middle = upper_median(&mut mean.to_vec());
        let (low, high) = mean.iter().fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(*v), high.max(*v)));
        let running = |value: &dyn Fn(usize) -> f64| {
            let mut sum = 0.0;
            let mut sums = vec![0.0];
            sums.extend((0..mean.len()).map(|n| {
                sum += value(n);
                sum
            }));
            sums
        };
        let mut unclear = vec![0];
        unclear.extend(clear.iter().scan(0, |count, clear| {
            *count += usize::from(!clear);
            Some(*count)
        }));
        Self {
            samples,
            totals: running(&|n| mean[n] - middle),
            squares: running(&|n| (mean[n] - middle).powi(2)),
            unclear,
            middle,
            low: low - middle,
            high: high - middle,
        }
    }

    fn is_clear(&self, start: usize) -> bool {
        self.unclear[start + self.samples] == self.unclear[start]
    }

    fn mean(&self, start: usize) -> f64 {
        self.middle + (self.totals[start + self.samples] - self.totals[start]) / self.samples as f64
    }

    fn squares_about_mean(&self, start: usize) -> f64 {
        let sum = self.totals[start + self.samples] - self.totals[start];
        (self.squares[start + self.samples] - self.squares[start] - sum * sum / self.samples as f64).max(0.0)
    }

    /// Sum of squares of the stretch that a quarter of all fall below.
    fn quiet_quarter(&self) -> f64 {
        let starts = (0..self.totals.len() - self.samples).step_by(self.samples);
        let mut squares: Vec<f64> = starts.map(|start| self.squares_about_mean(start)).collect();
        let quarter = squares.len() / 4;
        *squares.select_nth_unstable_by(quarter, f64::total_cmp).1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const LEN: usize = 320;
    const SAMPLES: usize = 32;

    fn pulse(n: usize, at: f64, height: f64) -> f64 {
        height * (-0.5 * ((n as f64 - at) / 2.0).powi(2)).exp()
    }

    /// A mean of unit noise, white or of a slow front end, and light.
    fn record(light: impl Fn(usize) -> f64, smooth: usize, rng: &mut ChaCha8Rng) -> Vec<f64> {
        let white: Vec<f64> = (0..LEN + smooth).map(|_| StandardNormal.sample(rng)).collect();
        let slow = |n: usize| white[n..n + smooth].iter().sum::<f64>() / (smooth as f64).sqrt();
        (0..LEN).map(|n| slow(n) + light(n)).collect()
    }

    /// The sum of the squared autocorrelations of a mean of `smooth` samples.
    fn scale(smooth: usize) -> Scale {
        let r = |lag: usize| (1.0 - lag as f64 / smooth as f64).max(0.0);
        Scale { variance: Some(1.0), spread: 1.0 + 2.0 * (1..smooth).map(|lag| r(lag).powi(2)).sum::<f64>() }
    }

    fn clear() -> Vec<bool> {
        vec![true; LEN]
    }

    #[test]
    fn a_dark_start_stays_the_baseline() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for smooth in [1, 4] {
            for _ in 0..2000 {
                let mean = record(|n| pulse(n, 100.0, 50.0), smooth, &mut rng);
                assert_eq!(find(&mean, &clear(), SAMPLES, &scale(smooth)), Place::AtStart, "{smooth}");
            }
        }
    }

    #[test]
    fn light_at_the_start_moves_it_to_where_it_is_dark() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for (height, smooth) in [(8.0_f64, 1), (57.0, 1), (-57.0, 1), (57.0, 4)] {
            for _ in 0..200 {
                // A tail lies above the level of the rest, flat as it is.
                let tail = |n: usize| if (40..120).contains(&n) { height.signum() * 6.0 } else { 0.0 };
                let mean = record(|n| pulse(n, 20.0, height) + tail(n), smooth, &mut rng);
                let Place::At(start) = find(&mean, &clear(), SAMPLES, &scale(smooth)) else {
                    panic!("{height} is not found");
                };
                assert!((120..160).contains(&start), "{height}: {start}");
            }
        }
    }

    #[test]
    fn a_record_that_is_lit_everywhere_says_so() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mean = record(|n| 20.0 * (n as f64 / 5.0).sin(), 1, &mut rng);
        assert!(matches!(find(&mean, &clear(), SAMPLES, &scale(1)), Place::Nowhere(_)));
        // Clipped places are no dark ones.
        let mean = record(|_| 0.0, 1, &mut rng);
        let clipped: Vec<bool> = (0..LEN).map(|n| n % 20 > 0).collect();
        assert!(matches!(find(&mean, &clipped, SAMPLES, &scale(1)), Place::Nowhere(_)));
    }

    /// One record has no differences: its quieter stretches say what noise is.
    #[test]
    fn one_record_is_judged_by_its_own_stretches() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let lone = Scale { variance: None, spread: 1.0 };
        for _ in 0..1000 {
            let dark = record(|n| pulse(n, 100.0, 50.0), 3, &mut rng);
            assert_eq!(find(&dark, &clear(), SAMPLES, &lone), Place::AtStart);
            let lit = record(|n| pulse(n, 20.0, 50.0), 3, &mut rng);
            assert!(matches!(find(&lit, &clear(), SAMPLES, &lone), Place::At(_)));
        }
        assert_eq!(find(&[3.0; LEN], &clear(), SAMPLES, &lone), Place::AtStart);
    }

    /// Against means of many rounded records, at levels anywhere between two codes.
    #[test]
    fn rounding_leaves_what_it_leaves() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for sd in [0.0, 0.1, 0.2, 0.3] {
            let error = |level: f64, rng: &mut ChaCha8Rng| {
                let code = |_| {
                    let noise: f64 = StandardNormal.sample(rng);
                    (level + sd * noise).round()
                };
                (0..2000).map(code).sum::<f64>() / 2000.0 - level
            };
            let squares: f64 = (0..200).map(|n| error(f64::from(n) / 200.0 + 0.0025, &mut rng).powi(2)).sum();
            let (seen, expected) = (squares / 200.0, rounding_variance(sd) + sd * sd / 2000.0);
            assert!((seen / expected - 1.0).abs() < 0.05, "{sd}: {seen} {expected}");
        }
    }

    #[test]
    fn stretches_of_records_lie_where_they_are_asked_for() {
        let dark = Dark { place: None, samples: 8 };
        assert_eq!((dark.range(100, 640), dark.range(5, 0)), (0..8, 0..5));
        let dark = Dark { place: Some(30), samples: 8 };
        assert_eq!((dark.range(100, 640), dark.range(100, 64 * 40), dark.range(100, -6400)), (20..28, 0..8, 92..100));
        let mean = Mean { first_position: 10, mean: vec![0.0; 50] };
        assert_eq!(dark.of_mean(&mean), 20..28);
    }
}
