//! Noise that is slower than an autoregressive process of a few lags describes: hum, wander, 1/f.
//!
//! Over a record of N samples it is a sum of cosines, `sqrt(2) cos(pi k (n + 1/2) / N)`, k = 1, 2, .., whose amplitudes
//! are independent and normal: the Karhunen-Loeve expansion of a stationary process whose correlation is long, without
//! the jump at the ends that a Fourier series has. Their variances come from the differences between shots and their
//! mean, into which light does not enter, where the mean is dark. Maximum likelihood by expectation and maximisation
//! (Dempster, Laird and Rubin, J. R. Stat. Soc. B 39, 1 (1977)): the amplitudes of each shot are the hidden variables,
//! each shot has an offset of any size, and neighbouring components, in bands that widen by a quarter, have one
//! variance. Samples are taken in blocks longer than fast noise is correlated, so that it is white from block to block.
//!
//! Not modelled: noise that is the same in every shot, which no difference shows; components beyond an eighth of the
//! samples, which are not slow.

use std::f64::consts::{PI, SQRT_2};
use std::ops::Range;

use crate::block_means::BlockMeans;
use crate::regression::invert;
use crate::sums::sum_in_kernel;
use crate::widest::widest;

/// Components at most, and blocks to each.
const COMPONENTS_MAX: usize = 64;
const BLOCKS_PER_COMPONENT: usize = 4;
/// Long blocks of a record: slow noise moves their means against one another.
const LONG_BLOCKS: usize = 16;
/// Standard deviations by which these means scatter more than those of blocks close together, for slow noise to be
/// sought.
const CLAIM_SIGMA: f64 = 5.0;
/// Density of fast noise at low frequencies over the one that blocks close together show, at most.
const FAST_RISE: f64 = 1.25;
/// Power of a band over that of fast noise from which components up to there are fitted.
const POWER_MIN: f64 = 1.5;
/// Variance of a component, over the one that fast noise gives it, below which it is taken as none.
const SHARE_MIN: f64 = 0.3;
/// Components of a band over its first one's number.
const BAND: f64 = 0.25;
const ROUNDS: usize = 15;

/// Component `k` (0, 1, ..) of variance 1 at a place of a record of `len` samples.
#[must_use]
pub fn component(k: usize, place: f64, len: usize) -> f64 {
    SQRT_2 * (PI * (k + 1) as f64 * (place + 0.5) / len as f64).cos()
}

/// Slow noise of the shots of a capture.
#[derive(Clone, Debug)]
pub struct SlowNoise {
    /// Variance of each component's amplitude in one shot.
    pub variances: Vec<f64>,
    blocks: Blocks,
    /// Offset and amplitudes of each shot, given its samples.
    amplitudes: Vec<Vec<f64>>,
    /// Their covariance, the same for each shot, row-major.
    covariance: Vec<f64>,
}

impl SlowNoise {
    /// From the differences of shots from their mean over blocks of their record; `dark`: its places that count. `None`
    /// where nothing exceeds fast noise significantly.
    #[must_use]
    pub fn of(differences: &BlockMeans, dark: &[bool]) -> Option<Self> {
        let mut blocks = Blocks::of(differences, dark);
        let selection = blocks.select(differences);
        let means: Vec<&[f64]> = selection.chunks_exact(blocks.ranges.len().max(1)).collect();
        let fast = blocks.fast_variance(&means)?;
        if !blocks.is_slow(&means, fast) {
            return None;
        }
        let most = (blocks.ranges.len() / BLOCKS_PER_COMPONENT).min(COMPONENTS_MAX);
        blocks.resolve(most);
        blocks.resolve(blocks.components(&means, fast)?);
        Self::fit(blocks, &means, fast)
    }

    /// `None` where the dark blocks do not separate the components.
    fn fit(blocks: Blocks, means: &[&[f64]], fast: f64) -> Option<Self> {
        let (size, shots) = (blocks.size(), means.len() as f64);
        let gram = blocks.gram();
        let along: Vec<Vec<f64>> = means.iter().map(|means| blocks.along(means)).collect();
        let count = blocks.ranges.len() as f64;
        let total = means.iter().copied().flatten().map(|mean| mean * mean).sum::<f64>();
        let mut variances = vec![total / shots / count; size - 1];
        let (mut own, mut amplitudes, mut covariance) = (fast, Vec::new(), Vec::new());
        for _ in 0..ROUNDS {
            let posterior = posterior_of(&gram, &variances, own)?;
            amplitudes = along.iter().map(|along| product(&posterior, along)).collect::<Vec<Vec<f64>>>();
            // What is left of the samples, and what the amplitudes' own errors leave.
            let explained: f64 =
                along.iter().zip(&amplitudes).map(|(b, c)| 2.0 * dot(b, c) - quadratic(&gram, c)).sum();
            let trace: f64 = gram.iter().zip(&posterior).map(|(g, a)| g * a).sum();
            let next: Vec<f64> = (1..size)
                .map(|k| amplitudes.iter().map(|c| c[k] * c[k]).sum::<f64>() / shots + own * posterior[k * (size + 1)])
                .collect();
            covariance = posterior.iter().map(|value| own * value).collect();
            own = ((total - explained) / shots + own * trace) / count;
            variances = banded(&next);
        }
        let noise = own / count;
        variances.iter_mut().filter(|variance| **variance < SHARE_MIN * noise).for_each(|variance| *variance = 0.0);
        Some(Self { variances, blocks, amplitudes, covariance })
    }

    /// The differences of the same shots, each from the record's start on, without their offsets and slow noise.
    #[must_use]
    pub fn fast(&self, differences: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let rows: Vec<Vec<f64>> = (0..self.blocks.len).map(|n| self.row(n)).collect();
        let of_shot = |(difference, amplitudes): (&Vec<f64>, &Vec<f64>)| {
            difference.iter().zip(&rows).map(|(value, row)| value - dot(amplitudes, row)).collect()
        };
        differences.iter().zip(&self.amplitudes).map(of_shot).collect()
    }

    /// Autocovariance, at so many lags, that what [`Self::fast`] leaves at these `places` lacks of fast noise: a part
    /// of it was taken for slow noise, as much as the amplitudes are uncertain.
    #[must_use]
    pub fn lacking(&self, places: &[Range<usize>], lags: usize) -> Vec<f64> {
        let (mut sums, mut pairs) = (vec![0.0; lags], vec![0.0; lags]);
        for range in places {
            let rows: Vec<Vec<f64>> = range.clone().map(|n| self.row(n)).collect();
            let spread: Vec<Vec<f64>> = rows.iter().map(|row| product(&self.covariance, row)).collect();
            for (lag, (sum, pairs)) in sums.iter_mut().zip(&mut pairs).enumerate() {
                *sum += spread.iter().zip(rows.iter().skip(lag)).map(|(a, b)| dot(a, b)).sum::<f64>();
                *pairs += range.len().saturating_sub(lag) as f64;
            }
        }
        sums.iter().zip(pairs).map(|(sum, pairs)| sum / pairs.max(1.0)).collect()
    }

    fn row(&self, place: usize) -> Vec<f64> {
        self.blocks.row(place as f64, self.variances.len())
    }
}

/// Blocks of dark samples of a record.
#[derive(Clone, Debug)]
struct Blocks {
    ranges: Vec<Range<usize>>,
    /// Runs of them among all blocks.
    runs: Vec<Range<usize>>,
    /// Samples of the record.
    len: usize,
    /// Of each block: 1, and the components at its middle.
    basis: Vec<Vec<f64>>,
}

impl Blocks {
    fn of(means: &BlockMeans, dark: &[bool]) -> Self {
        let (block, blocks) = (means.block(), means.covered().min(dark.len()) / means.block());
        let is_dark = |b: usize| dark[b * block..(b + 1) * block].iter().all(|dark| *dark);
        let mut runs: Vec<Range<usize>> = Vec::new();
        for b in (0..blocks).filter(|b| is_dark(*b)) {
            match runs.last_mut().filter(|run| run.end == b) {
                Some(run) => run.end = b + 1,
                None => runs.push(b..b + 1),
            }
        }
        let ranges = runs.iter().cloned().flatten().map(|b| b * block..(b + 1) * block).collect();
        Self { ranges, runs, len: dark.len(), basis: Vec::new() }
    }

    /// Of so many components.
    fn resolve(&mut self, components: usize) {
        let row = |range: &Range<usize>| self.row(0.5 * (range.start + range.end - 1) as f64, components);
        self.basis = self.ranges.iter().map(row).collect();
    }

    /// 1, and so many components at a place.
    fn row(&self, place: f64, components: usize) -> Vec<f64> {
        std::iter::once(1.0).chain((0..components).map(|k| component(k, place, self.len))).collect()
    }

    fn size(&self) -> usize {
        self.basis[0].len()
    }

    /// The means of these blocks, shot by shot, from those of all.
    fn select(&self, means: &BlockMeans) -> Vec<f64> {
        let mut selection = Vec::with_capacity(means.shots().len() * self.ranges.len());
        for means in means.shots() {
            self.runs.iter().for_each(|run| selection.extend_from_slice(&means[run.clone()]));
        }
        selection
    }

    /// Variance of a block's mean by fast noise: half of the mean square of differences over two blocks. `None` where
    /// there are too few blocks to tell slow noise, or no noise.
    fn fast_variance(&self, means: &[&[f64]]) -> Option<f64> {
        let is_pair = |three: &[Range<usize>]| three[2].start == three[0].end + three[1].len();
        let pairs: Vec<f64> = self.ranges.windows(3).map(|three| f64::from(u8::from(is_pair(three)))).collect();
        let count = pairs.iter().sum::<f64>();
        if count < (2 * LONG_BLOCKS) as f64 || means.len() < 2 {
            return None;
        }
        let mut squares = vec![0.0; pairs.len()];
        widest(
            #[inline(always)]
            || {
                for means in means {
                    for ((square, early), late) in squares.iter_mut().zip(*means).zip(&means[2..]) {
                        *square += (late - early) * (late - early);
                    }
                }
            },
        );
        let variance = 0.5 * dot(&squares, &pairs) / (means.len() as f64 * count);
        (variance > 0.0).then_some(variance)
    }

    /// Whether means over long runs of blocks scatter more than `fast` noise makes them.
    fn is_slow(&self, means: &[&[f64]], fast: f64) -> bool {
        let run = self.ranges.len() / LONG_BLOCKS;
        let (mut squares, mut freedom) = (0.0, 0.0);
        let mut long = vec![0.0; self.ranges.len() / run];
        for means in means {
            widest(
                #[inline(always)]
                || {
                    for (mean, run) in long.iter_mut().zip(means.chunks_exact(run)) {
                        *mean = sum_in_kernel(run) / run.len() as f64;
                    }
                },
            );
            let middle = long.iter().sum::<f64>() / long.len() as f64;
            squares += long.iter().map(|mean| (mean - middle).powi(2)).sum::<f64>() * run as f64 / fast;
            freedom += long.len() as f64 - 1.0;
        }
        squares > FAST_RISE * (freedom + CLAIM_SIGMA * (2.0 * freedom).sqrt())
    }

    /// Components up to the last band whose power exceeds that of fast noise.
    fn components(&self, means: &[&[f64]], fast: f64) -> Option<usize> {
        let mut power = vec![0.0; self.size() - 1];
        let square = |k: usize| self.basis.iter().map(|row| row[k] * row[k]).sum::<f64>();
        let squares: Vec<f64> = (1..self.size()).map(square).collect();
        for means in means {
            // The offset is open.
            let middle = means.iter().sum::<f64>() / means.len() as f64;
            let along = self.along(&means.iter().map(|mean| mean - middle).collect::<Vec<_>>());
            for (k, power) in power.iter_mut().enumerate() {
                *power += along[k + 1].powi(2) / squares[k] / fast;
            }
        }
        let power = banded(&power.iter().map(|sum| sum / means.len() as f64).collect::<Vec<_>>());
        power.iter().rposition(|power| *power > POWER_MIN).map(|last| last + 1)
    }

    fn along(&self, means: &[f64]) -> Vec<f64> {
        let mut along = vec![0.0; self.size()];
        for (row, mean) in self.basis.iter().zip(means) {
            along.iter_mut().zip(row).for_each(|(sum, value)| *sum += value * mean);
        }
        along
    }

    fn gram(&self) -> Vec<f64> {
        let size = self.size();
        let mut gram = vec![0.0; size * size];
        for row in &self.basis {
            for (sums, value) in gram.chunks_exact_mut(size).zip(row) {
                sums.iter_mut().zip(row).for_each(|(sum, other)| *sum += value * other);
            }
        }
        gram
    }
}

/// `(G + diag(0, own / variances))^-1`; `None` where it is singular to rounding.
fn posterior_of(gram: &[f64], variances: &[f64], own: f64) -> Option<Vec<f64>> {
    let size = variances.len() + 1;
    let mut matrix = gram.to_vec();
    for (k, variance) in variances.iter().enumerate() {
        matrix[(k + 1) * (size + 1)] += own / variance;
    }
    let scale: Vec<f64> = (0..size).map(|k| matrix[k * (size + 1)].sqrt().recip()).collect();
    let scaled = |matrix: &mut [f64]| {
        matrix.iter_mut().enumerate().for_each(|(at, value)| *value *= scale[at / size] * scale[at % size]);
    };
    scaled(&mut matrix);
    let mut inverse = vec![0.0; size * size];
    invert(&mut matrix, &mut inverse)?;
    scaled(&mut inverse);
    Some(inverse)
}

/// The mean of each band in place of its values.
fn banded(values: &[f64]) -> Vec<f64> {
    let mut means = Vec::with_capacity(values.len());
    while means.len() < values.len() {
        let first = means.len();
        let width = ((BAND * (first + 1) as f64) as usize).max(1).min(values.len() - first);
        let mean = values[first..first + width].iter().sum::<f64>() / width as f64;
        means.resize(first + width, mean);
    }
    means
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn product(matrix: &[f64], vector: &[f64]) -> Vec<f64> {
    matrix.chunks_exact(vector.len()).map(|row| dot(row, vector)).collect()
}

fn quadratic(matrix: &[f64], vector: &[f64]) -> f64 {
    dot(vector, &product(matrix, vector))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::{Noise, estimate_of_rest};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const LEN: usize = 800;
    const SHOTS: usize = 32;

    fn normal(rng: &mut ChaCha8Rng) -> f64 {
        StandardNormal.sample(rng)
    }

    /// Shots of unit white noise smoothed over two samples, an offset, and a sine of so many turns a record and random
    /// phase.
    fn shots(height: f64, turns: f64, rng: &mut ChaCha8Rng) -> Vec<Vec<f64>> {
        let shot = |_| {
            let (offset, phase) = (normal(rng), rng.random_range(0.0..2.0 * PI));
            let white: Vec<f64> = (0..=LEN).map(|_| normal(rng)).collect();
            let sine = |n: usize| SQRT_2 * height * (2.0 * PI * turns * n as f64 / LEN as f64 + phase).sin();
            (0..LEN).map(|n| (white[n] + white[n + 1]) / SQRT_2 + offset + sine(n)).collect()
        };
        (0..SHOTS).map(shot).collect()
    }

    fn slow(shots: &[Vec<f64>], dark: &[bool]) -> Option<SlowNoise> {
        let mut means = BlockMeans::new(LEN, shots.len());
        for shot in shots {
            means.begin(LEN);
            means.fill(0, shot);
        }
        SlowNoise::of(&means, dark)
    }

    fn variance(values: &[Vec<f64>]) -> f64 {
        values.iter().flatten().map(|value| value * value).sum::<f64>() / (values.len() * LEN) as f64
    }

    #[test]
    fn fast_noise_is_no_slow_noise() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let claims = (0..300).filter(|_| slow(&shots(0.0, 1.0, &mut rng), &[true; LEN]).is_some()).count();
        assert!(claims <= 1, "{claims}");
        assert!(slow(&[vec![1.0; LEN], vec![1.0; LEN]], &[true; LEN]).is_none());
        assert!(slow(&shots(3.0, 2.0, &mut rng)[..1], &[true; LEN]).is_none());
    }

    /// Without noise, a lit part may hide what separates components: that is no reason to end.
    #[test]
    fn components_that_look_alike_have_no_posterior() {
        assert!(posterior_of(&[1.0; 4], &[1.0], 1.0).is_some());
        assert!(posterior_of(&[1.0; 4], &[1.0], 1e-15).is_none());
    }

    /// Wander is told in size, and what is left is the fast noise, also where a part of the record is lit.
    #[test]
    fn wander_is_distinguished_from_fast_noise() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for (height, turns) in [(4.0, 0.4), (4.0, 2.7), (1.0, 0.4), (4.0, 6.2)] {
            for lit in [0..0, 100..400] {
                let shots = shots(height, turns, &mut rng);
                let dark: Vec<bool> = (0..LEN).map(|n| !lit.contains(&n)).collect();
                let slow = slow(&shots, &dark).expect("it is plain");
                let total: f64 = slow.variances.iter().sum();
                let fast = slow.fast(&shots);
                let masked = |n: usize| if dark[n] { 1.0 } else { 0.0 };
                let fast: Vec<Vec<f64>> =
                    fast.iter().map(|shot| shot.iter().enumerate().map(|(n, v)| masked(n) * v).collect()).collect();
                let share = dark.iter().filter(|dark| **dark).count() as f64 / LEN as f64;
                let places = [0..lit.start, lit.end..LEN];
                let left = variance(&fast) / share + slow.lacking(&places, 1)[0];
                assert!((left - 1.0).abs() < 0.07, "{height} {turns} {lit:?}: {left}");
                // Less than a turn is an offset in part, and where a part is lit, a part of a turn is seen.
                let right = if lit.is_empty() && turns > 1.0 { 0.7..1.4 } else { 0.2..2.5 };
                assert!(right.contains(&(total / (height * height))), "{height} {turns} {lit:?}: {total}");
            }
        }
    }

    /// Many components take a part of the fast noise at their own frequencies: its autocovariance has it all.
    #[test]
    fn what_slow_noise_takes_of_fast_noise_is_given_back_at_every_lag() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut shots = shots(0.0, 1.0, &mut rng);
        for turns in (1..30).map(|n| f64::from(n) + 0.3) {
            for shot in &mut shots {
                let (phase, height) = (rng.random_range(0.0..2.0 * PI), 3.0 / turns);
                shot.iter_mut().enumerate().for_each(|(n, value)| {
                    *value += height * (2.0 * PI * turns * n as f64 / LEN as f64 + phase).sin();
                });
            }
        }
        let slow = slow(&shots, &[true; LEN]).expect("it is plain");
        let components = slow.variances.iter().filter(|variance| **variance > 0.0).count();
        assert!(components > 30, "{components}");
        let fast = slow.fast(&shots);
        let given_back = estimate_of_rest(&fast, &slow.lacking(std::slice::from_ref(&(0..LEN)), 16));
        let without = estimate_of_rest(&fast, &[0.0; 16]);
        let error = |noise: &Noise| {
            let of_lag = |(lag, r): (usize, &f64)| (r - if lag == 1 { 0.5 } else { 0.0 }).abs();
            noise.acf.iter().enumerate().skip(1).map(of_lag).fold(0.0, f64::max)
        };
        assert!((given_back.sd - 1.0).abs() < 0.02, "{given_back:?}");
        assert!(error(&given_back) < 0.04 && error(&without) > 0.08, "{given_back:?} {without:?}");
    }
}
