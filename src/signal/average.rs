//! Averaging of shots that are moved onto a common time grid, exactly.
//!
//! The time of a shot's sample 0 is rounded to 1/64 sample. Codes are summed as integers, a sum for each of the 64 phases that occurs; at the end
//! each phase is delayed once onto the grid, by a band-limited filter ([`super::resample`]), and the phases are added. So the sums are the same for any order of
//! shots, a shot costs one addition a sample, and a capture without jitter has one phase and no filter at all.
//! Source: averaging of exposures, paper section 5.

use super::codes::Codes;
use super::resample;
use super::response::Response;

/// Phases of a sample: the grid to which a shot's time is rounded, so an error of at most 1/128 sample.
pub const PHASES: usize = 64;
/// The first shots of a capture, from which outliers are judged and the spread is taken.
pub const HEAD_SHOTS: usize = 32;
/// Sums of so many 16 bit codes stay within 32 bits.
const SPILL_SHOTS: u32 = 1 << 15;
/// Fine steps in a sample of an averaged response.
const RESPONSE_STEPS: usize = 8;
/// Share of the maximum below which an averaged response is cut off at its ends.
const NEGLIGIBLE: f64 = 1e-4;
/// Fewer shots say nothing about outliers.
const JUDGES_MIN: usize = 8;

/// Sums of the shots of one capture.
#[derive(Clone, Debug)]
pub struct PhaseSums {
    samples: usize,
    bins: Vec<Option<Bin>>,
    shots: u64,
}

/// Sums of the shots of one phase. Shots of one phase may still lie whole samples apart.
#[derive(Clone, Debug)]
struct Bin {
    /// Place on the grid of the first sum.
    first: i64,
    /// Sums since the last spill, and those before (whole numbers below 2^53 are exact in `f64`).
    sums: Vec<i32>,
    spilled: Vec<f64>,
    since_spill: u32,
    shots: u64,
    /// Places that all shots of the phase cover.
    covered: (i64, i64),
}

impl Bin {
    fn new(whole: i64, samples: usize) -> Self {
        Self {
            first: whole,
            sums: vec![0; samples],
            spilled: vec![0.0; samples],
            since_spill: 0,
            shots: 0,
            covered: (whole, whole + samples as i64),
        }
    }

    /// Makes room for a shot whose first sample lies at `whole`.
    fn reach(&mut self, whole: i64, samples: usize) {
        let before = (self.first - whole).max(0) as usize;
        if before > 0 {
            self.sums.splice(0..0, std::iter::repeat_n(0, before));
            self.spilled.splice(0..0, std::iter::repeat_n(0.0, before));
            self.first = whole;
        }
        let needed = (whole - self.first) as usize + samples;
        if needed > self.sums.len() {
            self.sums.resize(needed, 0);
            self.spilled.resize(needed, 0.0);
        }
    }

    fn add(&mut self, codes: Codes<'_>, whole: i64, samples: usize) {
        if whole < self.first || (whole - self.first) as usize + samples > self.sums.len() {
            self.reach(whole, samples);
        }
        let at = (whole - self.first) as usize;
        match codes {
            Codes::F32(_) | Codes::F64(_) | Codes::I32(_) => codes.add_to_f64(&mut self.spilled[at..]),
            _ => {
                codes.add_to(&mut self.sums[at..]);
                self.since_spill += 1;
                if self.since_spill == SPILL_SHOTS {
                    self.spill();
                }
            }
        }
        self.shots += 1;
        self.covered = (self.covered.0.max(whole), self.covered.1.min(whole + samples as i64));
    }

    fn spill(&mut self) {
        for (total, sum) in self.spilled.iter_mut().zip(&mut self.sums) {
            *total += f64::from(std::mem::take(sum));
        }
        self.since_spill = 0;
    }

    /// Sums on the places that all shots cover.
    fn totals(&self) -> Vec<f64> {
        let (start, end) = ((self.covered.0 - self.first) as usize, (self.covered.1 - self.first) as usize);
        self.spilled[start..end]
            .iter()
            .zip(&self.sums[start..end])
            .map(|(total, sum)| total + f64::from(*sum))
            .collect()
    }
}

/// Mean of the shots, in codes, on the places that all of them cover.
#[derive(Clone, Debug, PartialEq)]
pub struct Mean {
    /// Place on the grid of the first value: its time in samples.
    pub first_position: i64,
    /// Mean codes.
    pub mean: Vec<f64>,
}

impl PhaseSums {
    /// No shots yet, of `samples` samples each.
    ///
    /// # Panics
    /// When there are no samples.
    #[must_use]
    pub fn new(samples: usize) -> Self {
        assert!(samples > 0, "a shot has samples");
        Self { samples, bins: vec![None; PHASES], shots: 0 }
    }

    /// Adds a shot whose sample 0 lies at `position` / 64 samples on the grid.
    ///
    /// # Panics
    /// When the shot has another number of samples.
    pub fn add(&mut self, codes: Codes<'_>, position: i64) {
        assert_eq!(codes.len(), self.samples, "samples of a shot");
        let (whole, phase) = (position.div_euclid(PHASES as i64), position.rem_euclid(PHASES as i64));
        let samples = self.samples;
        let bin = self.bins[phase as usize].get_or_insert_with(|| Bin::new(whole, samples));
        bin.add(codes, whole, samples);
        self.shots += 1;
    }

    /// Shots added.
    #[must_use]
    pub fn shots(&self) -> u64 {
        self.shots
    }

    /// Shots of each of the [`PHASES`] phases.
    #[must_use]
    pub fn phase_shots(&self) -> Vec<u64> {
        self.bins.iter().map(|bin| bin.as_ref().map_or(0, |bin| bin.shots)).collect()
    }

    /// The mean; `None` without shots, or when no place is covered by all of them.
    #[must_use]
    pub fn finish(&self) -> Option<Mean> {
        let bins = || self.bins.iter().enumerate().filter_map(|(phase, bin)| Some((phase, bin.as_ref()?)));
        // A shot of phase > 0 begins between two places: the later one is the first that it covers.
        let start = bins().map(|(phase, bin)| bin.covered.0 + i64::from(phase > 0)).max()?;
        let end = bins().map(|(_, bin)| bin.covered.1).min()?;
        if start >= end || bins().any(|(_, bin)| bin.covered.0 >= bin.covered.1) {
            return None;
        }
        let mut mean = vec![0.0; (end - start) as usize];
        for (phase, bin) in bins() {
            let totals = bin.totals();
            let mut delayed = vec![0.0; totals.len()];
            resample::delay(&totals, phase as f64 / PHASES as f64, &mut delayed);
            let skip = (start - bin.covered.0) as usize;
            mean.iter_mut().zip(&delayed[skip..]).for_each(|(sum, value)| *sum += value);
        }
        let shots = self.shots as f64;
        mean.iter_mut().for_each(|sum| *sum /= shots);
        Some(Mean { first_position: start, mean })
    }
}

/// What averaging leaves of an impulse response: `sum_p n_p / N sum_u w(u) h(t + u dt)`, over the phases p with their shots `n_p` and the taps u of the
/// filter that delays each phase.
///
/// One phase that lies on the grid leaves it as it is. Shots spread over all phases leave what lies below half the sample rate: what a fast edge has
/// above rings, in the mean as in this.
///
/// # Panics
/// When there are not [`PHASES`] counts, no shots, or `dt_ps` is not positive.
#[must_use]
pub fn averaged_response(response: &Response, dt_ps: f64, phase_shots: &[i32]) -> Response {
    assert_eq!(phase_shots.len(), PHASES, "a count for each phase");
    let shots: f64 = phase_shots.iter().copied().map(f64::from).sum();
    assert!(shots > 0.0 && dt_ps > 0.0, "an average has shots and a step");
    if f64::from(phase_shots[0]) == shots {
        return response.clone();
    }
    // The response on the grid of phases, and room for the taps on either side.
    let step_ps = dt_ps / PHASES as f64;
    let (first_ps, last_ps) = response.support_ps();
    let (first, last) = ((first_ps / step_ps).floor() as i64, (last_ps / step_ps).ceil() as i64);
    let table: Vec<f64> = (first..=last).map(|n| response.value(n as f64 * step_ps)).collect();
    let reach = (resample::TAPS / 2 * PHASES) as i64;
    let coarse = PHASES / RESPONSE_STEPS;
    let start = (first - reach).div_euclid(coarse as i64) * coarse as i64;
    let mut values = vec![0.0; ((last + reach - start) as usize).div_ceil(coarse) + 1];
    for (phase, &count) in phase_shots.iter().enumerate().filter(|(_, count)| **count > 0) {
        let fraction = phase as f64 / PHASES as f64;
        for (k, tap) in resample::taps(fraction).into_iter().enumerate() {
            let ahead = (k as i64 - (resample::TAPS / 2) as i64) * PHASES as i64 + phase as i64;
            let weight = tap * f64::from(count) / shots;
            // Value i looks at the response at start + i * coarse + ahead.
            let skip = usize::try_from((first - start - ahead).max(0)).expect("not negative").div_ceil(coarse);
            for (i, value) in values.iter_mut().enumerate().skip(skip) {
                let at = start + (i * coarse) as i64 + ahead - first;
                match table.get(at as usize) {
                    Some(response) => *value += weight * response,
                    None => break,
                }
            }
        }
    }
    let most = values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let counts = |value: &f64| value.abs() > NEGLIGIBLE * most;
    let (from, to) = (values.iter().position(counts).unwrap_or(0), values.iter().rposition(counts).unwrap_or(1));
    let (from, to) = (from.saturating_sub(1), (to + 2).min(values.len()));
    Response::new((start + (from * coarse) as i64) as f64 * step_ps, step_ps * coarse as f64, &values[from..to])
}

/// Standard deviation over shots at each place of their mean, each shot's own baseline (mean of its first `baseline` samples) removed.
///
/// A shot that lies between two places of the grid is compared with the mean interpolated there. Places that fewer than two shots cover get the
/// mean of all others.
///
/// # Panics
/// When `baseline` is 0 or exceeds a shot.
#[must_use]
pub fn spread(shots: &[(Codes<'_>, i64)], mean: &Mean, baseline: usize) -> Vec<f64> {
    let count = mean.mean.len();
    let mut squares = vec![0.0; count];
    // Where the number of shots that cover a place changes, and by how much.
    let mut changes = vec![0_i32; count + 1];
    let floor: f64 = mean.mean[..baseline.min(count)].iter().sum::<f64>() / baseline.min(count) as f64;
    let mut values = Vec::new();
    for (codes, position) in shots {
        codes.read_into(&mut values);
        let own = values[..baseline].iter().sum::<f64>() / baseline as f64 - floor;
        let (whole, phase) = (position.div_euclid(PHASES as i64), position.rem_euclid(PHASES as i64));
        let offset = whole - mean.first_position;
        let last = count as i64 - 1 - i64::from(phase > 0);
        let (start, end) = ((-offset).max(0), (last - offset + 1).min(values.len() as i64));
        if start >= end {
            continue;
        }
        let (at, length) = ((offset + start) as usize, (end - start) as usize);
        let values = &values[start as usize..end as usize];
        let (squares, here) = (&mut squares[at..at + length], &mean.mean[at..at + length]);
        if phase == 0 {
            for ((square, value), here) in squares.iter_mut().zip(values).zip(here) {
                let residual = value - own - here;
                *square += residual * residual;
            }
        } else {
            let (fraction, there) = (phase as f64 / PHASES as f64, &mean.mean[at + 1..=at + length]);
            for (((square, value), here), there) in squares.iter_mut().zip(values).zip(here).zip(there) {
                let residual = value - own - (here + fraction * (there - here));
                *square += residual * residual;
            }
        }
        changes[at] += 1;
        changes[at + length] -= 1;
    }
    let mut covering = Vec::with_capacity(count);
    changes[..count].iter().fold(0, |now, change| {
        covering.push((now + change) as u32);
        now + change
    });
    let sd = |(square, covering): (&f64, &u32)| (*covering >= 2).then(|| (square / f64::from(covering - 1)).sqrt());
    let known: Vec<f64> = squares.iter().zip(&covering).filter_map(sd).collect();
    let usual = if known.is_empty() { 0.0 } else { known.iter().sum::<f64>() / known.len() as f64 };
    squares.iter().zip(&covering).map(|pair| sd(pair).unwrap_or(usual)).collect()
}

/// Tells outlying shots: those with a sample further from the median of the first shots than noise and the rounding to whole samples explain.
#[derive(Clone, Debug)]
pub struct OutlierTest {
    first: i64,
    baseline: usize,
    low: Vec<f64>,
    high: Vec<f64>,
}

impl OutlierTest {
    /// From the first shots; `sigma` robust standard deviations are allowed. `None` with fewer than eight shots, or none that overlap.
    #[must_use]
    pub fn new(shots: &[(Codes<'_>, i64)], baseline: usize, sigma: f64) -> Option<Self> {
        if shots.len() < JUDGES_MIN {
            return None;
        }
        let shifted: Vec<(i64, Vec<f64>)> =
            shots.iter().map(|(codes, position)| (nearest(*position), without_baseline(*codes, baseline))).collect();
        // Where most shots begin and end: single shots far off do not shrink the test.
        let first = middle(&mut shifted.iter().map(|(whole, _)| *whole as f64).collect::<Vec<_>>()) as i64;
        let count = shots[0].0.len();
        let mut median = vec![0.0; count];
        let mut deviations = Vec::with_capacity(count);
        let mut column = Vec::with_capacity(shots.len());
        for (n, median) in median.iter_mut().enumerate() {
            column.clear();
            column.extend(
                shifted
                    .iter()
                    .filter_map(|(whole, values)| values.get(usize::try_from(first + n as i64 - whole).ok()?)),
            );
            if column.len() < JUDGES_MIN {
                return None;
            }
            *median = middle(&mut column);
            column.iter_mut().for_each(|value| *value = (*value - *median).abs());
            deviations.push(middle(&mut column));
        }
        // The floor of half a code keeps a record that is quieter than its converter's step from rejecting everything.
        let scale = (1.4826 * middle(&mut deviations)).max(0.5);
        let slope = |n: usize| {
            let neighbour = |m: usize| (median[m.min(count - 1)] - median[n]).abs();
            neighbour(n + 1).max(neighbour(n.saturating_sub(1)))
        };
        let margin: Vec<f64> = (0..count).map(|n| sigma * scale + slope(n)).collect();
        let low = median.iter().zip(&margin).map(|(median, margin)| median - margin).collect();
        let high = median.iter().zip(&margin).map(|(median, margin)| median + margin).collect();
        Some(Self { first, baseline, low, high })
    }

    /// Whether a shot lies outside, at any sample.
    #[must_use]
    pub fn is_outlier(&self, codes: Codes<'_>, position: i64) -> bool {
        let values = without_baseline(codes, self.baseline);
        let offset = nearest(position) - self.first;
        let (from, at) = ((-offset).max(0) as usize, offset.max(0) as usize);
        if from >= values.len() || at >= self.low.len() {
            return true;
        }
        let bounds = self.low[at..].iter().zip(&self.high[at..]);
        values[from..].iter().zip(bounds).any(|(value, (low, high))| value < low || value > high)
    }
}

/// The whole place next to a position in phases.
fn nearest(position: i64) -> i64 {
    (position + PHASES as i64 / 2).div_euclid(PHASES as i64)
}

fn without_baseline(codes: Codes<'_>, baseline: usize) -> Vec<f64> {
    let mut values = codes.to_f64();
    let baseline = baseline.clamp(1, values.len());
    let own = values[..baseline].iter().sum::<f64>() / baseline as f64;
    values.iter_mut().for_each(|value| *value -= own);
    values
}

/// The upper median; reorders the values.
fn middle(values: &mut [f64]) -> f64 {
    let half = values.len() / 2;
    *values.select_nth_unstable_by(half, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
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
            let averaged = averaged_response(&response, 1.0, &phases);
            let (mut worst, mut raw) = (0.0_f64, 0.0_f64);
            for (i, value) in mean.mean.iter().enumerate().skip(20).take(80) {
                let t = (mean.first_position + i as i64) as f64 - 60.3;
                worst = worst.max((value / 20_000.0 - averaged.value(t)).abs());
                raw = raw.max((value / 20_000.0 - fast(t)).abs());
            }
            assert!(worst < 1e-3 && raw > 5.0 * worst, "{shots} shots over {spread} phases: {worst}, without {raw}");
        }
        let on_grid: Vec<i32> = (0..64).map(|phase| if phase == 0 { 7 } else { 0 }).collect();
        assert_eq!(averaged_response(&response, 1.0, &on_grid).value(0.3), response.value(0.3));
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
            let sd = spread(&views, &sum(&views).finish().unwrap(), 32);
            let mean = sd.iter().sum::<f64>() / sd.len() as f64;
            assert!((mean / 40.0 - 1.0).abs() < 0.06, "{jitter}: {mean}");
        }
    }

    #[test]
    fn outliers_are_told_and_others_are_not() {
        let good = shots(64, 1.0, 40.0, 5);
        let test = OutlierTest::new(&views(&good), 32, 6.0).unwrap();
        let more = shots(2000, 1.0, 40.0, 6);
        let wrong = views(&more).iter().filter(|(codes, position)| test.is_outlier(*codes, *position)).count();
        assert!(wrong <= 2, "{wrong} of 2000 good shots rejected");
        for (bytes, position) in shots(200, 1.0, 40.0, 7) {
            let mut codes: Vec<i16> =
                bytes.chunks_exact(2).map(|code| i16::from_le_bytes([code[0], code[1]])).collect();
            codes[90] += 900;
            assert!(test.is_outlier(Codes::I16(&self::bytes(&codes)), position));
        }
        assert!(OutlierTest::new(&views(&good)[..5], 32, 6.0).is_none());
    }
}
