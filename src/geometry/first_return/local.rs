//! What fields of lengths about a place have in common: how they are fitted, and how sure they are.

use std::sync::Arc;

use nalgebra::{Const, Dyn, OMatrix, SMatrix, SVector, Vector3};

use super::way::Way;
use crate::Point;
use crate::axes::across;

/// Eight unknowns; a field that has fewer holds the last ones by their prior.
pub const UNKNOWNS: usize = 8;
pub type Unknowns = SVector<f64, UNKNOWNS>;
pub type Covariance = SMatrix<f64, UNKNOWNS, UNKNOWNS>;
/// A column a member.
type Columns<const ROWS: usize> = OMatrix<f64, Const<ROWS>, Dyn>;

/// Rounds of least squares, halvings of a step, and expected gain of a step, in chi-square, that ends them.
const ROUNDS: usize = 8;
const HALVINGS: usize = 4;
const DONE: f64 = 1e-2;
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
    pub fn none() -> Arc<Self> {
        Arc::new(Self { noise: Covariance::zeros(), law: Covariance::zeros(), square: 0.0, count: 0 })
    }

    /// Chi-square over its degrees of freedom.
    pub fn misfit(&self) -> f64 {
        self.square / (self.count as f64 - 6.0).max(1.0)
    }

    /// Cube root of the misfit, as a nearly standard normal score (Wilson and Hilferty).
    pub fn score(&self) -> f64 {
        let spread = 2.0 / (9.0 * (self.count as f64 - 6.0).max(1.0));
        (self.misfit().cbrt() - (1.0 - spread)) / spread.sqrt()
    }
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
    /// So many unknowns, the first ones, change the reading.
    const READ: usize;

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

    /// The field of least squares from this start; `None` where the members do not determine it.
    fn fit(&self, samples: &[Sample], members: &[u32], zone_m: f64) -> Option<Self> {
        let mut field = self.clone();
        let mut now = field.normal_equations(samples, members);
        for _ in 0..ROUNDS {
            let step = now.information.cholesky()?.solve(&now.gradient);
            if step.dot(&now.gradient) < DONE {
                // So small a step ends where it is thought to.
                field = field.moved(&step);
                break;
            }
            let next = (0..HALVINGS).find_map(|halving| {
                let next = field.moved(&(step * 0.5_f64.powi(halving as i32)));
                let then = next.normal_equations(samples, members);
                (then.cost() < now.cost()).then_some((next, then))
            });
            let Some((next, then)) = next else { break };
            (field, now) = (next, then);
        }
        if !field.is_possible() || !now.square.is_finite() {
            return None;
        }
        let inverse = now.information.cholesky()?.inverse();
        let [noise, law] = field.spread(samples, members, zone_m).map(|spread| inverse * spread * inverse);
        Some(field.with(Arc::new(Fitted { noise, law, square: now.square, count: members.len() })))
    }

    fn normal_equations(&self, samples: &[Sample], members: &[u32]) -> NormalEquations {
        let (off, precision) = self.prior();
        let mut equations = NormalEquations {
            square: 0.0,
            prior: off.component_mul(&off).dot(&precision),
            information: Covariance::from_diagonal(&precision),
            gradient: -precision.component_mul(&off),
        };
        let mut lines = Columns::<UNKNOWNS>::zeros(members.len());
        for (mut line, n) in lines.column_iter_mut().zip(members) {
            let sample = &samples[*n as usize];
            let (length_m, slopes) = self.length(&sample.at);
            let weight = 1.0 / sample.weighted_m;
            let off = (sample.length_m - length_m) * weight;
            equations.square += off * off;
            equations.gradient += slopes * (off * weight);
            line.copy_from(&(slopes * weight));
        }
        equations.information += &lines * lines.transpose();
        equations
    }

    /// Errors of the law at each member. A Gaussian random function over the wall, whose correlation falls as a
    /// Gaussian of `zone_m`, is a sum of these waves with random heights of variances [`WAVE_VARIANCES`].
    fn waves<'a>(
        &self,
        samples: &'a [Sample],
        members: &'a [u32],
        zone_m: f64,
    ) -> impl Iterator<Item = [f64; WAVES]> + use<'a, Self> {
        let (at, across) = (self.at(), across(&self.reading(&Way::Back).1));
        members.iter().map(move |n| {
            let from = samples[*n as usize].at - at;
            let [x, y] = across.each_ref().map(|axis| wave_heights(axis.dot(&from) / zone_m));
            std::array::from_fn(|k| x[k / 5] * y[k % 5])
        })
    }

    /// Covariance of the gradient under noise and what was thought before, and under errors of the law.
    fn spread(&self, samples: &[Sample], members: &[u32], zone_m: f64) -> [Covariance; 2] {
        let weighted = |members: &[u32], of: fn(&Sample) -> f64| {
            let mut lines = Columns::<UNKNOWNS>::zeros(members.len());
            for (mut line, n) in lines.column_iter_mut().zip(members) {
                let sample = &samples[*n as usize];
                line.copy_from(&(self.length(&sample.at).1 * (of(sample) * sample.weighted_m.powi(-2))));
            }
            lines
        };
        let by_noise = weighted(members, |sample| sample.sd_m);
        let noise = Covariance::from_diagonal(&self.prior().1) + &by_noise * by_noise.transpose();
        // The law's error is smooth: some members show what it does to all.
        let step = members.len().div_ceil(SMOOTH).max(1);
        let some: Vec<u32> = members.iter().copied().step_by(step).collect();
        let by_law = weighted(&some, |sample| sample.law_m) * (members.len() as f64 / some.len().max(1) as f64);
        let waves = Columns::<WAVES>::from_iterator(some.len(), self.waves(samples, &some, zone_m).flatten());
        let mut sums = by_law * waves.transpose();
        for (mut sum, variance) in sums.column_iter_mut().zip(WAVE_VARIANCES) {
            sum *= variance.sqrt();
        }
        [noise, sums * sums.transpose()]
    }

    /// Slopes of both parts of the reading by the unknowns.
    fn reading_slopes(&self, way: &Way) -> [SMatrix<f64, 3, UNKNOWNS>; 2] {
        let mut slopes = [SMatrix::<f64, 3, UNKNOWNS>::zeros(), SMatrix::<f64, 3, UNKNOWNS>::zeros()];
        for k in 0..Self::READ {
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

/// The waves of [`VARIANCES`] at a place along a line.
fn wave_heights(place: f64) -> [f64; 5] {
    let [(sine, cosine), (next_sine, next_cosine)] = FREQUENCIES.map(|frequency| (frequency * place).sin_cos());
    [1.0, cosine, sine, next_cosine, next_sine]
}
