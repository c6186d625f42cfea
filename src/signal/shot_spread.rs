//! How shots of one capture differ from their mean.

use super::average::{Mean, PHASES};
use super::block_means::BlockMeans;
use super::codes::Codes;
use super::dark::Dark;
use super::median::upper_median;
use super::resample;
use super::sums::sum;

/// The first shots of a capture, from which outliers are judged and the spread is taken.
pub const HEAD_SHOTS: usize = 32;
/// Blocks whose samples are compared at once, so that what is between stays in the nearest cache.
const STRETCH_BLOCKS: usize = 32;
/// How shots of one capture differ from their mean: what one pass over each shows.
#[derive(Clone, Debug)]
pub struct Spread {
    /// Variance over shots at each place of the mean, in codes squared, each shot's own baseline removed. Places that
    /// fewer than two shots cover have NaN.
    pub variances: Vec<f64>,
    /// The differences over blocks, baselines included; each shot's from its first place of the mean on.
    pub differences: BlockMeans,
}

impl Spread {
    /// Of shots whose baselines are the means of their `dark` samples.
    ///
    /// # Panics
    /// When `dark` has no samples, or more than a shot.
    #[must_use]
    pub fn of(shots: &[(Codes<'_>, i64)], mean: &Mean, dark: &Dark) -> Self {
        let count = mean.mean.len();
        if shots.len() < 2 {
            return Self { variances: vec![f64::NAN; count], differences: BlockMeans::new(count, 0) };
        }
        let (mut variances, mut differences) = (vec![0.0; count], BlockMeans::new(count, shots.len()));
        // Where shots begin and end.
        let mut ends: Vec<(usize, i32)> = Vec::with_capacity(2 * shots.len() + 1);
        let mut room = vec![0.0; STRETCH_BLOCKS * differences.block()];
        compare(shots, mean, dark, |Compared { at, own, codes, moved, from }| {
            differences.begin(codes.len());
            let squares = &mut variances[at..];
            codes.subtract(&moved[from..], own, squares, &mut room, |first, stretch| differences.fill(first, stretch));
            ends.extend([(at, 1), (at + codes.len(), -1)]);
        });
        ends.sort_unstable();
        ends.push((count, 0));
        let (mut covering, mut from) = (0, 0);
        for (at, change) in ends {
            let freedom = if covering >= 2 { f64::from(covering - 1) } else { f64::NAN };
            variances[from..at].iter_mut().for_each(|variance| *variance /= freedom);
            (covering, from) = (covering + change, at);
        }
        Self { variances, differences }
    }

    /// Median of the variances over shots: light in less than half of a record does not change it, nor do offsets.
    #[must_use]
    pub fn usual_variance(&self) -> f64 {
        let mut known: Vec<f64> = self.variances.iter().copied().filter(|variance| variance.is_finite()).collect();
        if known.is_empty() {
            return 0.0;
        }
        upper_median(&mut known)
    }
}

/// What is each shot's own: its difference from the mean without what its phase makes of it.
///
/// Where a pulse is too fast for its sampling, no filter moves the mean to where a shot lies. What is missing is a
/// function of the phase, the same in all shots, and would pass for noise that grows with the light. So each difference
/// is compared with the straight line through its two neighbours in phase (Gasser, Sroka and Jennen-Steinmetz,
/// *Residual variance and residual pattern in nonlinear regression*, 1986). Phases are a circle: a turn is one place.
#[derive(Clone, Debug)]
pub struct OwnNoise {
    /// By shot: its place in a sample, and its noise from the mean's first place on, scaled to the variance of a shot;
    /// NaN where a neighbour has no sample.
    shots: Vec<(f64, Vec<f64>)>,
}

impl OwnNoise {
    /// Share of shots that would say as much of their variance directly: three quarters of what Gasser, Sroka and
    /// Jennen-Steinmetz find for equal distances.
    pub const SHARE: f64 = 0.75 * 18.0 / 35.0;

    /// From the `differences` of shots from their mean, offsets apart, whose positions are in 1/64 sample.
    ///
    /// # Panics
    /// When there are not as many differences as positions.
    #[must_use]
    pub fn of(differences: &[Vec<f64>], positions: &[i64]) -> Self {
        assert_eq!(differences.len(), positions.len(), "each shot has a position");
        let mut order: Vec<usize> = (0..positions.len()).collect();
        order.sort_by_key(|shot| phase(positions[*shot]));
        let mut neighbours: Vec<Neighbours> = (0..order.len()).map(|n| Neighbours::of(&order, n, positions)).collect();
        // What a line misses grows with both gaps: a few wide ones would make most of it.
        neighbours.sort_by_key(|one| one.gaps[0] * one.gaps[1]);
        neighbours.truncate((neighbours.len() * 3).div_ceil(4));
        let own = |one: &Neighbours| (phase(positions[one.shot]) as f64 / PHASES as f64, one.noise(differences));
        Self { shots: neighbours.iter().map(own).collect() }
    }

    /// Variance of a shot at each of the mean's `places`; NaN where no shot has a sample.
    #[must_use]
    pub fn variances(&self, places: usize) -> Vec<f64> {
        let of_place = |place: usize| {
            let values =
                self.shots.iter().filter_map(|(_, values)| values.get(place)).filter(|value| value.is_finite());
            let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value * value, count + 1));
            if count > 0 { sum / f64::from(count) } else { f64::NAN }
        };
        (0..places).map(of_place).collect()
    }

    /// Variance of the shots' times, in samples squared: how far each moves as a whole, by least squares with the slope
    /// of the `mean` at the places that are `clear`.
    #[must_use]
    pub fn moves(&self, mean: &[f64], clear: &[bool]) -> f64 {
        let slope = |place: usize| 0.5 * (mean[(place + 1).min(mean.len() - 1)] - mean[place.saturating_sub(1)]);
        let slopes: Vec<f64> = (0..mean.len()).map(slope).collect();
        let square = |(fraction, values): &(f64, Vec<f64>)| {
            let (mut along, mut steep) = (0.0, 0.0);
            for (place, value) in values.iter().enumerate().take(mean.len() - 1) {
                if value.is_finite() && clear[place] {
                    let slope = slopes[place] + fraction * (slopes[place + 1] - slopes[place]);
                    along += slope * value;
                    steep += slope * slope;
                }
            }
            if steep > 0.0 { (along / steep).powi(2) } else { 0.0 }
        };
        self.shots.iter().map(square).sum::<f64>() / self.shots.len() as f64
    }
}

/// A shot and its neighbours in phase.
struct Neighbours {
    shot: usize,
    before: usize,
    after: usize,
    /// Distances in phase to both, 1/64 sample.
    gaps: [i64; 2],
    /// Places by which their like lies later than the shot's: the first shot's neighbour before it lies a turn earlier.
    later: [i64; 2],
}

impl Neighbours {
    /// Of the n-th shot in the `order` of phases.
    fn of(order: &[usize], n: usize, positions: &[i64]) -> Self {
        let count = order.len();
        let [before, shot, after] = [n + count - 1, n, n + 1].map(|n| order[n % count]);
        let later = [i64::from(n == 0), -i64::from(n + 1 == count)];
        let turn = PHASES as i64;
        let [earliest, own, latest] = [before, shot, after].map(|shot| phase(positions[shot]));
        Self { shot, before, after, gaps: [own - earliest + turn * later[0], latest - own - turn * later[1]], later }
    }

    /// The shot's difference from the mean less the line through those of its neighbours, scaled to a shot's variance.
    fn noise(&self, differences: &[Vec<f64>]) -> Vec<f64> {
        let [before, after] = self.gaps.map(|gap| gap as f64);
        let share = if before + after > 0.0 { after / (before + after) } else { 0.5 };
        let scale = (1.0 + share * share + (1.0 - share) * (1.0 - share)).sqrt().recip();
        let at = |shot: usize, place: i64| differences[shot].get(usize::try_from(place).ok()?);
        let noise = |(place, value): (i64, &f64)| {
            let earlier = at(self.before, place + self.later[0])?;
            let later = at(self.after, place + self.later[1])?;
            Some(scale * (value - share * earlier - (1.0 - share) * later))
        };
        (0..).zip(&differences[self.shot]).map(|one| noise(one).unwrap_or(f64::NAN)).collect()
    }
}

/// Where between two places a shot lies, in 1/64 sample.
fn phase(position: i64) -> i64 {
    position.rem_euclid(PHASES as i64)
}

/// A shot beside the mean.
struct Compared<'a> {
    /// First place of the mean that the shot covers.
    at: usize,
    /// Its baseline over the mean's.
    own: f64,
    /// Its samples from there on, as far as the mean goes.
    codes: Codes<'a>,
    /// The mean, moved to where the shot lies, and where in it the first of these samples has its like.
    moved: &'a [f64],
    from: usize,
}

/// Lays each shot beside the mean.
///
/// A shot that lies between two places of the grid is compared with the mean moved there by the band-limited filter
/// that made it: a straight line between samples would add its error on fast edges to the spread.
fn compare(shots: &[(Codes<'_>, i64)], mean: &Mean, dark: &Dark, mut each: impl FnMut(Compared<'_>)) {
    let of_mean = &mean.mean[dark.of_mean(mean)];
    let floor: f64 = of_mean.iter().sum::<f64>() / of_mean.len() as f64;
    let (mut of_shot, mut moved, mut moved_by) = (Vec::new(), mean.mean.clone(), 0);
    for (codes, position) in shots {
        codes.slice(dark.range(codes.len(), *position)).read_into(&mut of_shot);
        let own = sum(&of_shot) / of_shot.len() as f64 - floor;
        let (whole, phase) = (position.div_euclid(PHASES as i64), position.rem_euclid(PHASES as i64));
        // The mean at a place and a fraction is that at the next place, earlier by the rest.
        let later = i64::from(phase > 0);
        let by = later * PHASES as i64 - phase;
        if by != moved_by {
            resample::delay(&mean.mean, by as f64 / PHASES as f64, &mut moved);
            moved_by = by;
        }
        let offset = whole - mean.first_position;
        let count = mean.mean.len() as i64;
        let (start, end) = ((-offset).max(0), (count - later - offset).min(codes.len() as i64));
        if start < end {
            let (at, codes) = ((offset + start) as usize, codes.slice(start as usize..end as usize));
            each(Compared { at, own, codes, moved: &moved, from: at + later as usize });
        }
    }
}

/// Smallest difference of neighbouring samples: converters of fewer bits than their codes have count in steps of
/// several codes. 0 where samples do not differ.
#[must_use]
pub fn step(shots: &[(Codes<'_>, i64)]) -> f64 {
    const STRETCH: usize = 64;
    let mut least = f64::INFINITY;
    for (codes, _) in shots {
        for start in (0..codes.len()).step_by(STRETCH) {
            // With the next stretch's first sample.
            let values = codes.slice(start..codes.len().min(start + STRETCH + 1)).to_f64();
            let changes = values.windows(2).map(|pair| (pair[1] - pair[0]).abs());
            least = changes.filter(|change| *change > 0.0).fold(least, f64::min);
            if codes.is_whole() && least <= 1.0 {
                return least; // whole numbers come no closer
            }
        }
    }
    if least.is_finite() { least } else { 0.0 }
}

/// The whole place next to a position in phases.
#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Shots of a pulse of 2.5 samples or of 0.7, which its sampling cannot follow, with noise of 1 code and jitter.
    fn pulses(width: f64, jitter: f64, rng: &mut ChaCha8Rng) -> Vec<(Vec<u8>, i64)> {
        let mut shot = || {
            let position = rng.random_range(0..PHASES as i64);
            let late: f64 = StandardNormal.sample(rng);
            let middle = 100.0 - position as f64 / PHASES as f64 + jitter * late;
            let mut code = |n: usize| -> [u8; 2] {
                let normal: f64 = StandardNormal.sample(rng);
                ((8000.0 * (-0.5 * ((n as f64 - middle) / width).powi(2)).exp() + normal).round() as i16).to_le_bytes()
            };
            ((0..200).flat_map(&mut code).collect(), position)
        };
        (0..HEAD_SHOTS).map(|_| shot()).collect()
    }

    /// One pass over the shots shows what each difference from the mean by itself does.
    #[test]
    fn the_spread_is_that_of_differences_one_by_one() {
        // Long enough for several stretches.
        let shots = pulses(2.5, 0.1, &mut ChaCha8Rng::seed_from_u64(4));
        let shots: Vec<(Vec<u8>, i64)> = shots.iter().map(|(bytes, at)| (bytes.repeat(3), *at)).collect();
        let views: Vec<(Codes<'_>, i64)> = shots.iter().map(|(bytes, at)| (Codes::I16(bytes), *at)).collect();
        let mut sums = crate::average::PhaseSums::new(600);
        views.iter().for_each(|(codes, position)| sums.add(*codes, *position));
        let mean = sums.finish().unwrap();
        let spread = Spread::of(&views, &mean, &Dark::at_start(40));
        let differences = crate::dark::differences(&views, &mean);
        let mut sorted: Vec<f64> = spread.variances.iter().copied().filter(|one| one.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        assert_eq!(spread.usual_variance(), sorted[sorted.len() / 2]);
        let block = spread.differences.block();
        for (means, difference) in spread.differences.shots().zip(&differences) {
            let naive = difference.chunks_exact(block).map(|block| block.iter().sum::<f64>() / block.len() as f64);
            assert!(means.iter().zip(naive).all(|(mean, naive)| (mean - naive).abs() < 1e-9));
        }
    }

    #[test]
    fn one_shot_has_no_spread() {
        let shots = pulses(2.5, 0.1, &mut ChaCha8Rng::seed_from_u64(4));
        let views: Vec<(Codes<'_>, i64)> = shots.iter().map(|(bytes, at)| (Codes::I16(bytes), *at)).take(2).collect();
        for count in [1, 2] {
            let mut sums = crate::average::PhaseSums::new(200);
            views[..count].iter().for_each(|(codes, position)| sums.add(*codes, *position));
            let mean = sums.finish().unwrap();
            let spread = Spread::of(&views[..count], &mean, &Dark::at_start(40));
            let known = spread.variances.iter().filter(|variance| variance.is_finite()).count();
            assert_eq!((known > 0, spread.usual_variance() > 0.0), (count > 1, count > 1));
            assert_eq!(spread.variances.len(), mean.mean.len());
        }
    }

    /// Jitter is seen in full, and noise at its size; a pulse that is too fast for its sampling adds next to nothing to
    /// either, where shots differ from the mean by many times their noise.
    #[test]
    fn a_pulse_too_fast_for_its_sampling_is_no_noise() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for (width, jitter, least, most) in [(2.5, 0.1, 0.8, 1.25), (0.7, 0.1, 0.7, 1.6), (0.7, 0.0, 0.0, 0.15)] {
            let both = |rng: &mut ChaCha8Rng| {
                let shots = pulses(width, jitter, rng);
                let views: Vec<(Codes<'_>, i64)> = shots.iter().map(|(bytes, at)| (Codes::I16(bytes), *at)).collect();
                let mut sums = crate::average::PhaseSums::new(200);
                views.iter().for_each(|(codes, at)| sums.add(*codes, *at));
                let mean = sums.finish().expect("shots overlap");
                let positions: Vec<i64> = shots.iter().map(|(_, at)| *at).collect();
                let own = OwnNoise::of(&crate::dark::differences(&views, &mean), &positions);
                let largest = |variances: &[f64]| variances[80..120].iter().copied().fold(0.0, f64::max);
                let spread = Spread::of(&views, &mean, &Dark::at_start(32));
                let ratio = largest(&spread.variances) / largest(&own.variances(mean.mean.len()));
                [own.moves(&mean.mean, &vec![true; mean.mean.len()]), ratio]
            };
            let rounds: Vec<[f64; 2]> = (0..40).map(|_| both(&mut rng)).collect();
            let mean = |of: usize| rounds.iter().map(|round| round[of]).sum::<f64>() / 40.0;
            let (seen, ratio) = (mean(0).sqrt(), mean(1));
            println!("width {width}, jitter {jitter}: {seen:.4}, variance of the mean's differences {ratio:.1} times");
            assert!((least * 0.1..most * 0.1).contains(&seen), "{width} {jitter}: {seen}");
            assert!(jitter > 0.0 || ratio > 30.0, "{ratio}");
        }
    }

    /// White noise of one code has a variance of one, whatever the phases are.
    #[test]
    fn own_noise_has_the_variance_of_a_shot() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for phases in [1, 3, PHASES as i64] {
            let mut variances = Vec::new();
            for _ in 0..40 {
                let positions: Vec<i64> = (0..HEAD_SHOTS).map(|_| rng.random_range(0..phases)).collect();
                let noise = |_: &i64| (0..100).map(|_| StandardNormal.sample(&mut rng)).collect();
                let differences: Vec<Vec<f64>> = positions.iter().map(noise).collect();
                variances.extend(OwnNoise::of(&differences, &positions).variances(100));
            }
            let mean = variances.iter().sum::<f64>() / variances.len() as f64;
            assert!((mean - 1.0).abs() < 0.02, "{phases} phases: {mean}");
        }
    }
}
