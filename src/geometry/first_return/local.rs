//! What fields of lengths about a place have in common: how they are fitted, and how sure they are.

use std::f64::consts::{FRAC_2_PI, FRAC_PI_2};
use std::sync::{Arc, LazyLock};

use nalgebra::{Const, Dyn, MatrixView, OMatrix, SMatrix, SVector, Vector3};

use super::way::Way;
use crate::Point;
use crate::axes::across;

/// Eight unknowns; a field that has fewer holds the last ones by their prior.
pub const UNKNOWNS: usize = 8;
pub type Unknowns = SVector<f64, UNKNOWNS>;
pub type Covariance = SMatrix<f64, UNKNOWNS, UNKNOWNS>;
/// A column a member.
type Columns<const ROWS: usize> = OMatrix<f64, Const<ROWS>, Dyn>;

/// Rounds of least squares, and the gain of a step, in chi-square, that ends them: as expected, and as it came.
const ROUNDS: usize = 8;
const DONE: f64 = 1e-2;
const LITTLE: f64 = 0.2;
/// A Gaussian spectrum by quadrature of Hermite: frequencies, and variances of the heights of a constant and of a
/// cosine and a sine of each.
const FREQUENCIES: [f64; 2] = [1.355_626_179_974, 2.856_970_013_873];
const VARIANCES: [f64; 5] =
    [0.533_333_333_333, 0.444_151_844_012, 0.444_151_844_012, 0.022_514_822_656, 0.022_514_822_656];
/// Waves over the wall, and the variances of their heights.
pub const WAVES: usize = 25;
pub const WAVE_VARIANCES: [f64; WAVES] = {
    let mut variances = [0.0; WAVES];
    let mut k = 0;
    while k < WAVES {
        variances[k] = VARIANCES[k / 5] * VARIANCES[k % 5];
        k += 1;
    }
    variances
};
/// Members over which errors of the law are summed.
const SMOOTH: usize = 100;
/// A number of this size has no digits behind the point.
const ROUNDS_TO_WHOLE: f64 = 6_755_399_441_055_744.0;
/// Step of differences.
const STEP: f64 = 1e-6;

/// A length at a place of the wall.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    pub at: Point,
    pub length_m: f64,
    /// Standard deviation of its noise, and of the law of its light.
    pub sd_m: f64,
    pub law_m: f64,
    /// Standard deviation by which it is weighted.
    pub weighted_m: f64,
}

/// What a fit is drawn to: a length at a place, and its weight, the inverse of a standard deviation.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    at: Point,
    length_m: f64,
    weight: f64,
}

impl Target {
    pub fn of(sample: &Sample) -> Self {
        Self { at: sample.at, length_m: sample.length_m, weight: 1.0 / sample.weighted_m }
    }
}

/// What a fit says of itself.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// Covariance of the unknowns: of noise, and of the law of light.
    pub noise: Covariance,
    pub law: Covariance,
    /// Chi-square, and lengths that entered.
    pub square: f64,
    pub count: usize,
}

impl Fitted {
    /// One for all fields that need none: covariances take more memory than the fields.
    pub fn none() -> Arc<Self> {
        static NONE: LazyLock<Arc<Fitted>> = LazyLock::new(|| {
            Arc::new(Fitted { noise: Covariance::zeros(), law: Covariance::zeros(), square: 0.0, count: 0 })
        });
        Arc::clone(&NONE)
    }

    /// Chi-square over its degrees of freedom.
    pub fn misfit(&self) -> f64 {
        misfit(self.square, self.count)
    }

    /// Cube root of the misfit, as a nearly standard normal score (Wilson and Hilferty).
    pub fn score(&self) -> f64 {
        score(self.square, self.count)
    }
}

fn misfit(square: f64, count: usize) -> f64 {
    square / (count as f64 - 6.0).max(1.0)
}

fn score(square: f64, count: usize) -> f64 {
    let spread = 2.0 / (9.0 * (count as f64 - 6.0).max(1.0));
    (misfit(square, count).cbrt() - (1.0 - spread)) / spread.sqrt()
}

/// Chi-square of lengths and of what was thought before, the gradient of half of it, downwards, and the information.
pub struct NormalEquations {
    pub square: f64,
    prior: f64,
    pub information: Covariance,
    gradient: Unknowns,
}

impl NormalEquations {
    fn cost(&self) -> f64 {
        self.square + self.prior
    }
}

/// A field of lengths about a place.
pub trait Local: Clone + Send + Sync {
    /// The place.
    fn at(&self) -> Point;
    /// Length at a place.
    fn length_m(&self, place: &Point) -> f64;
    /// The same, and its slopes by the unknowns.
    fn length(&self, place: &Point) -> (f64, Unknowns);
    /// With the unknowns changed.
    fn moved(&self, step: &Unknowns) -> Self;
    /// How far the unknowns are from what was thought before there was light, and the precision of that.
    fn prior(&self) -> (Unknowns, Unknowns);
    /// Whether lengths are possible ones.
    fn is_possible(&self) -> bool;
    /// So many unknowns, the first ones, change the reading.
    fn read(&self) -> usize;
    /// The point of the surface, and the unit vector away from it.
    fn reading(&self, way: &Way) -> (Point, Vector3<f64>);
    fn fitted(&self) -> &Arc<Fitted>;
    fn with(self, fitted: Arc<Fitted>) -> Self;
    /// A field of another kind with the same unknowns, where there is one.
    fn other(&self) -> Option<Self> {
        None
    }

    /// Chi-square of the members.
    fn square(&self, samples: &[Sample], members: &[u32]) -> f64 {
        let of_one = |n: &u32| {
            let sample = &samples[*n as usize];
            ((sample.length_m - self.length_m(&sample.at)) / sample.weighted_m).powi(2)
        };
        members.iter().map(of_one).sum()
    }

    /// The field of least squares from this start, not yet with its covariances; `None` where the members do not
    /// determine it.
    fn likeliest(&self, samples: &[Sample], members: &[u32]) -> Option<Likeliest<Self>> {
        let targets: Vec<Target> = members.iter().map(|n| Target::of(&samples[*n as usize])).collect();
        let best = self.clone().descend(&targets)?;
        (best.field.is_possible() && best.square().is_finite()).then_some(best)
    }

    /// Steps of least squares, shortened where the field is not as straight as they take it to be (Levenberg, Quarterly
    /// of Applied Mathematics 2:164, 1944; Marquardt, SIAM Journal 11:431, 1963).
    fn descend(self, targets: &[Target]) -> Option<Likeliest<Self>> {
        let (mut field, mut now) = (self.clone(), self.normal_equations(targets));
        let mut damping = 0.0;
        for _ in 0..ROUNDS {
            let mut damped = now.information;
            (0..UNKNOWNS).for_each(|k| damped[(k, k)] *= 1.0 + damping);
            let step = damped.cholesky()?.solve(&now.gradient);
            let next = field.moved(&step);
            if step.dot(&now.gradient) < DONE {
                // So small a step ends where it is thought to.
                field = next;
                break;
            }
            let then = next.normal_equations(targets);
            let gain = now.cost() - then.cost();
            if gain > 0.0 {
                (field, now) = (next, then);
                damping *= 0.1;
                if gain < LITTLE {
                    break;
                }
            } else {
                damping = if damping < 0.01 { 0.1 } else { 10.0 * damping };
            }
        }
        Some(Likeliest { field, equations: now, count: targets.len() })
    }

    fn normal_equations(&self, targets: &[Target]) -> NormalEquations {
        let (off, precision) = self.prior();
        let (mut square, mut gradient) = (0.0, -precision.component_mul(&off));
        let mut information = [[0.0; UNKNOWNS]; UNKNOWNS];
        let mut weighted = |target: &Target| {
            let (length_m, slopes) = self.length(&target.at);
            let off = (target.length_m - length_m) * target.weight;
            square += off * off;
            let slopes = slopes * target.weight;
            gradient += slopes * off;
            <[f64; UNKNOWNS]>::from(slopes)
        };
        let (fours, rest) = targets.as_chunks::<4>();
        for four in fours {
            add_products(&mut information, &four.each_ref().map(&mut weighted));
        }
        for one in rest {
            add_products(&mut information, &[weighted(one)]);
        }
        let mut information = Covariance::from_fn(|row, column| information[row.min(column)][row.max(column)]);
        information += Covariance::from_diagonal(&precision);
        NormalEquations { square, prior: off.component_mul(&off).dot(&precision), information, gradient }
    }

    /// Errors of the law at each member. A Gaussian random function over the wall, whose correlation falls as a
    /// Gaussian of `zone_m`, is a sum of these waves with random heights of variances [`WAVE_VARIANCES`].
    fn waves(&self, samples: &[Sample], members: &[u32], zone_m: f64) -> Vec<[f64; WAVES]> {
        let (at, across) = (self.at(), across(&self.reading(&Way::Back).1).map(|axis| axis / zone_m));
        let of = |n: &u32| {
            let from = samples[*n as usize].at - at;
            let [x, y] = across.each_ref().map(|axis| wave_heights(axis.dot(&from)));
            let mut waves = [0.0; WAVES];
            for (waves, x) in waves.as_chunks_mut::<5>().0.iter_mut().zip(x) {
                waves.iter_mut().zip(y).for_each(|(wave, y)| *wave = x * y);
            }
            waves
        };
        members.iter().map(of).collect()
    }

    /// Covariance of the gradient under noise and what was thought before; `None` where it is the information.
    fn by_noise(&self, samples: &[Sample], members: &[u32]) -> Option<Covariance> {
        if members.iter().all(|n| samples[*n as usize].weighted_m == samples[*n as usize].sd_m) {
            return None;
        }
        let mut sums = [[0.0; UNKNOWNS]; UNKNOWNS];
        let weighted = |n: u32| {
            let sample = &samples[n as usize];
            <[f64; UNKNOWNS]>::from(self.length(&sample.at).1 * (sample.sd_m * sample.weighted_m.powi(-2)))
        };
        let (fours, rest) = members.as_chunks::<4>();
        fours.iter().for_each(|four| add_products(&mut sums, &four.map(weighted)));
        rest.iter().for_each(|one| add_products(&mut sums, &[weighted(*one)]));
        let sums = Covariance::from_fn(|row, column| sums[row.min(column)][row.max(column)]);
        Some(sums + Covariance::from_diagonal(&self.prior().1))
    }

    /// Covariance of the gradient under errors of the law.
    fn by_law(&self, samples: &[Sample], members: &[u32], zone_m: f64) -> Covariance {
        // The law's error is smooth: some members show what it does to all.
        let step = members.len().div_ceil(SMOOTH).max(1);
        let some: Vec<u32> = members.iter().copied().step_by(step).collect();
        let share = members.len() as f64 / some.len().max(1) as f64;
        let mut lines = Columns::<UNKNOWNS>::zeros(some.len());
        for (mut line, n) in lines.column_iter_mut().zip(&some) {
            let sample = &samples[*n as usize];
            line.copy_from(&(self.length(&sample.at).1 * (share * sample.law_m * sample.weighted_m.powi(-2))));
        }
        let waves = self.waves(samples, &some, zone_m);
        let waves = MatrixView::<f64, Const<WAVES>, Dyn>::from_slice(waves.as_flattened(), some.len());
        let mut sums = lines * waves.transpose();
        for (mut sum, variance) in sums.column_iter_mut().zip(WAVE_VARIANCES) {
            sum *= variance.sqrt();
        }
        sums * sums.transpose()
    }

    /// Slopes of both parts of the reading by the unknowns.
    fn reading_slopes(&self, way: &Way) -> [SMatrix<f64, 3, UNKNOWNS>; 2] {
        let mut slopes = [SMatrix::<f64, 3, UNKNOWNS>::zeros(), SMatrix::<f64, 3, UNKNOWNS>::zeros()];
        for k in 0..self.read() {
            let read = |step: f64| {
                let mut steps = Unknowns::zeros();
                steps[k] = step;
                self.moved(&steps).reading(way)
            };
            let (up, down) = (read(STEP), read(-STEP));
            slopes[0].set_column(k, &((up.0 - down.0) / (2.0 * STEP)));
            slopes[1].set_column(k, &((up.1 - down.1) / (2.0 * STEP)));
        }
        slopes
    }
}

/// A field at the least chi-square of some members, not yet with its covariances.
pub struct Likeliest<F> {
    field: F,
    equations: NormalEquations,
    count: usize,
}

impl<F: Local> Likeliest<F> {
    pub fn square(&self) -> f64 {
        self.equations.square
    }

    /// As [`Fitted::score`].
    pub fn score(&self) -> f64 {
        score(self.square(), self.count)
    }

    /// As [`Fitted::misfit`].
    pub fn misfit(&self) -> f64 {
        misfit(self.square(), self.count)
    }

    /// The field with its covariances; `None` where the members do not determine it.
    pub fn with_spread(self, samples: &[Sample], members: &[u32], zone_m: f64) -> Option<F> {
        let Self { field, equations, count } = self;
        let inverse = equations.information.cholesky()?.inverse();
        let noise = field.by_noise(samples, members).map_or(inverse, |spread| inverse * spread * inverse);
        let law = inverse * field.by_law(samples, members, zone_m) * inverse;
        Some(field.with(Arc::new(Fitted { noise, law, square: equations.square, count })))
    }
}

/// Adds products of lines to the upper half of a matrix; several at once, since sums are loaded and stored once then.
fn add_products<const LINES: usize>(sums: &mut [[f64; UNKNOWNS]; UNKNOWNS], lines: &[[f64; UNKNOWNS]; LINES]) {
    for (row, sums) in sums.iter_mut().enumerate() {
        // In pairs, as registers hold them.
        for column in (row & !1)..UNKNOWNS {
            let mut sum = sums[column];
            lines.iter().for_each(|line| sum += line[row] * line[column]);
            sums[column] = sum;
        }
    }
}

/// The waves of [`VARIANCES`] at a place along a line.
fn wave_heights(place: f64) -> [f64; 5] {
    let [[sine, cosine], [next_sine, next_cosine]] = FREQUENCIES.map(|frequency| sine_and_cosine(frequency * place));
    [1.0, cosine, sine, next_cosine, next_sine]
}

/// Both within 1e-6, by series about the nearest quarter of a turn: libraries' take a third of the time of a fit.
fn sine_and_cosine(angle: f64) -> [f64; 2] {
    let quarter = (angle * FRAC_2_PI + ROUNDS_TO_WHOLE) - ROUNDS_TO_WHOLE;
    let rest = angle - quarter * FRAC_PI_2;
    let square = rest * rest;
    let sine = rest * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0))));
    let cosine = 1.0 - square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0)));
    match quarter as i64 & 3 {
        0 => [sine, cosine],
        1 => [cosine, -sine],
        2 => [-sine, -cosine],
        _ => [-cosine, sine],
    }
}
