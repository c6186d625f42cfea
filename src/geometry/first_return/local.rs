//! What fields of lengths about a place have in common: how they are fitted, and how sure they are.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::Point;
use crate::axes::across;

/// Eight unknowns; a field that has fewer holds the last ones by their prior.
pub const UNKNOWNS: usize = 8;
pub type Unknowns = SVector<f64, UNKNOWNS>;
pub type Covariance = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Rounds of least squares, halvings of a step, and change of chi-square that ends them.
const ROUNDS: usize = 8;
const HALVINGS: usize = 4;
const DONE: f64 = 1e-2;
/// A Gaussian spectrum by quadrature of Hermite: frequencies, and variances of the heights of a constant and of a
/// cosine and a sine of each.
const FREQUENCIES: [f64; 2] = [1.355_626_179_974, 2.856_970_013_873];
const VARIANCES: [f64; 5] =
    [0.533_333_333_333, 0.444_151_844_012, 0.444_151_844_012, 0.022_514_822_656, 0.022_514_822_656];
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
    pub fn none() -> Self {
        Self { noise: Covariance::zeros(), law: Covariance::zeros(), square: 0.0, count: 0 }
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
    /// The point of the surface, and the unit vector away from it.
    fn reading(&self, lit: Option<&Point>) -> (Point, Vector3<f64>);
    fn fitted(&self) -> &Fitted;
    fn with(self, fitted: Fitted) -> Self;
    /// A field of another kind with the same unknowns, where there is one.
    fn other(&self) -> Option<Self> {
        None
    }

    /// Chi-square of the members, and what the prior adds.
    fn square(&self, samples: &[Sample], members: &[u32]) -> (f64, f64) {
        let of_one = |n: &u32| {
            let sample = &samples[*n as usize];
            ((sample.length_m - self.length_m(&sample.at)) / sample.weighted_m).powi(2)
        };
        let (off, precision) = self.prior();
        (members.iter().map(of_one).sum(), off.component_mul(&off).dot(&precision))
    }

    /// The field of least squares from this start; `None` where the members do not determine it.
    fn fit(&self, samples: &[Sample], members: &[u32], zone_m: f64) -> Option<Self> {
        let mut field = self.clone();
        let mut now = field.square(samples, members);
        for _ in 0..ROUNDS {
            let (information, gradient) = field.information(samples, members);
            let step = information.cholesky()?.solve(&gradient);
            let next = (0..HALVINGS).find_map(|halving| {
                let next = field.moved(&(step * 0.5_f64.powi(halving as i32)));
                let then = next.square(samples, members);
                (then.0 + then.1 < now.0 + now.1).then_some((next, then))
            });
            let Some((next, then)) = next else { break };
            let gain = now.0 + now.1 - then.0 - then.1;
            (field, now) = (next, then);
            if gain < DONE {
                break;
            }
        }
        if !field.is_possible() || !now.0.is_finite() {
            return None;
        }
        let inverse = field.information(samples, members).0.cholesky()?.inverse();
        let [noise, law] = field.spread(samples, members, zone_m).map(|spread| inverse * spread * inverse);
        Some(field.with(Fitted { noise, law, square: now.0, count: members.len() }))
    }

    fn information(&self, samples: &[Sample], members: &[u32]) -> (Covariance, Unknowns) {
        let (mut information, mut gradient) = (Covariance::zeros(), Unknowns::zeros());
        for sample in members.iter().map(|n| &samples[*n as usize]) {
            let (length_m, slopes) = self.length(&sample.at);
            let weight = sample.weighted_m.powi(-2);
            information += slopes * slopes.transpose() * weight;
            gradient += slopes * ((sample.length_m - length_m) * weight);
        }
        let (off, precision) = self.prior();
        information += Covariance::from_diagonal(&precision);
        (information, gradient - precision.component_mul(&off))
    }

    /// Errors of the law over the members: a Gaussian random function over the wall, whose correlation falls as a
    /// Gaussian of `zone_m`, as a sum of waves with random heights; the variance of each height, and its wave.
    fn waves(&self, samples: &[Sample], members: &[u32], zone_m: f64) -> Vec<(f64, Vec<f64>)> {
        let across = across(&self.reading(None).1);
        let of_line = |axis: &Vector3<f64>| -> Vec<[f64; 5]> {
            let along = |n: &u32| axis.dot(&(samples[*n as usize].at - self.at())) / zone_m;
            members.iter().map(|n| wave_heights(along(n))).collect()
        };
        let lines = across.each_ref().map(of_line);
        let mut waves = Vec::with_capacity(25);
        for first in 0..5 {
            for second in 0..5 {
                let product = |(x, y): (&[f64; 5], &[f64; 5])| x[first] * y[second];
                let wave = lines[0].iter().zip(&lines[1]).map(product).collect();
                waves.push((VARIANCES[first] * VARIANCES[second], wave));
            }
        }
        waves
    }

    /// Covariance of the gradient under noise and what was thought before, and under errors of the law.
    fn spread(&self, samples: &[Sample], members: &[u32], zone_m: f64) -> [Covariance; 2] {
        let mut noise = Covariance::from_diagonal(&self.prior().1);
        let mut rows = Vec::with_capacity(members.len());
        for sample in members.iter().map(|n| &samples[*n as usize]) {
            let (_, slopes) = self.length(&sample.at);
            noise += slopes * slopes.transpose() * (sample.sd_m.powi(2) / sample.weighted_m.powi(4));
            rows.push(slopes * (sample.law_m / sample.weighted_m.powi(2)));
        }
        let mut law = Covariance::zeros();
        for (variance, wave) in self.waves(samples, members, zone_m) {
            let sum: Unknowns = rows.iter().zip(&wave).map(|(row, wave)| row * *wave).sum();
            law += sum * sum.transpose() * variance;
        }
        [noise, law]
    }

    /// Covariances of both parts of the reading, from that of the unknowns.
    fn covariances(&self, lit: Option<&Point>, covariance: &Covariance) -> [Matrix3<f64>; 2] {
        let mut slopes = [SMatrix::<f64, 3, UNKNOWNS>::zeros(), SMatrix::<f64, 3, UNKNOWNS>::zeros()];
        for k in 0..UNKNOWNS {
            let read = |step: f64| {
                let mut steps = Unknowns::zeros();
                steps[k] = step;
                self.moved(&steps).reading(lit)
            };
            let (up, down) = (read(STEP), read(-STEP));
            slopes[0].set_column(k, &((up.0 - down.0) / (2.0 * STEP)));
            slopes[1].set_column(k, &((up.1 - down.1) / (2.0 * STEP)));
        }
        slopes.map(|slopes| slopes * covariance * slopes.transpose())
    }
}

/// The waves of [`VARIANCES`] at a place along a line.
fn wave_heights(place: f64) -> [f64; 5] {
    let [(sine, cosine), (next_sine, next_cosine)] = FREQUENCIES.map(|frequency| (frequency * place).sin_cos());
    [1.0, cosine, sine, next_cosine, next_sine]
}
