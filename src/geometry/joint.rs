//! Small hidden things from all histograms of a wall together, on the counts themselves.
//!
//! Light that leaves a lit point `l`, meets a small thing at `x` and comes back over a seen point `s` covers
//! `|l - x| + |x - s|`. In one histogram the returns of several things blend; in all of them together each has its own
//! place. The rate of bin `t` of histogram `p` is modelled as
//!
//! ```text
//! alpha_p w(t) + beta_p + sum over k of a_k law(p, x_k) h(t - |l - x_k| - |x_k - s|)
//! ```
//!
//! with the wall's own light `w` (smooth, `background`), the response `h` ([`Pulse`]) and a law that all points
//! share: a power of the distance and a quadratic over the wall. The power is free, since retroreflective things follow
//! others than diffuse ones. Where arrivals show that histograms are late or early each by itself, a shift of all light
//! of a histogram is unknown too, with a prior as wide as they show. Likelihoods are those of Poisson counts, or of
//! Gaussian noise.
//!
//! | module | does |
//! |---|---|
//! | `background` | shape of the wall's own light; its scale in each histogram |
//! | `first_bounce` | the response as the wall's own light shows it |
//! | `model` | points, their shared law, and their light in a histogram |
//! | `normal` | likelihood, gradient and Fisher information over all unknowns |
//! | `extent` | how large the points are |
//! | `fit` | the likeliest points from a start, and backward elimination |
//! | `scores` | what a model leaves of each histogram, filtered so that smooth light vanishes |
//! | `volume` | scores summed at places: where one more point may be |
//! | `rounds` | seeds, fits, and seeds again on what remains |
//! | `split` | points that are two, closer together than the response resolves |
//! | `misfit` | how far arrivals lie off the model, beyond noise; how wide the shifts of histograms vary |
//! | `verdict` | whether points are what the histograms show |
//!
//! A model of points also fits a surface, with many points and error bars that mean nothing. Residuals do not show
//! that. So two disjoint halves of the histograms are searched by themselves: points of small things reappear in both,
//! points on a surface do not. [`Verdict`] has what comes of it.
//!
//! Not modelled: occlusion, size and shape of a thing beyond one common width of pulses, normals, pile-up, more than
//! three bounces. All lengths are metres, those of histograms path lengths.

mod background;
mod extent;
mod first_bounce;
mod fit;
mod misfit;
mod model;
mod normal;
mod pulse;
mod rounds;
mod scores;
mod split;
#[cfg(test)]
mod tests;
mod verdict;
mod volume;

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;

use super::Point;
pub use first_bounce::WallSum;
pub use pulse::Pulse;
pub use verdict::joint_search;

/// A histogram behind the gate.
#[derive(Clone, Debug)]
pub struct Histogram {
    /// Point that is lit.
    pub lit: Point,
    /// Point that is seen.
    pub seen: Point,
    /// Path length between both at which the first bin begins.
    pub first_m: f64,
    /// Counts, or levels.
    pub values: Vec<f32>,
    /// The lit and the seen point over the wall, in units of half its width; [`Problem::new`] fills it.
    pub ends: [[f64; 2]; 2],
}

/// How values vary about their means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Noise {
    /// Photon counts.
    Counts,
    /// Independent Gaussian noise.
    Gauss {
        /// Standard deviation of a value.
        sd: f64,
    },
}

impl Noise {
    /// One over the variance at a rate.
    #[inline]
    fn weight(self, rate: f64) -> f64 {
        match self {
            Self::Counts => 1.0 / rate.max(1e-9),
            Self::Gauss { sd } => 1.0 / (sd * sd),
        }
    }

    /// Variance of a value at a rate.
    #[inline]
    fn variance(self, rate: f64) -> f64 {
        match self {
            Self::Counts => rate.max(1.0),
            Self::Gauss { sd } => sd * sd,
        }
    }

    /// That of the sum of so many histograms.
    fn of_sum(self, count: usize) -> Self {
        match self {
            Self::Counts => Self::Counts,
            Self::Gauss { sd } => Self::Gauss { sd: sd * (count as f64).sqrt() },
        }
    }

    /// Logarithm of the probability of a value at a rate, less what does not depend on the rate.
    #[inline]
    fn log_likelihood(self, value: f64, rate: f64) -> f64 {
        match self {
            Self::Counts => value * rate.max(1e-9).ln() - rate,
            Self::Gauss { sd } => -0.5 * ((value - rate) / sd).powi(2),
        }
    }
}

/// The plane of the wall.
#[derive(Clone, Debug)]
struct Wall {
    middle: Point,
    /// Two directions in it, at right angles.
    across: [Vector3<f64>; 2],
    /// Unit normal towards what is hidden.
    normal: Vector3<f64>,
    /// Half of its width along both directions.
    half_m: [f64; 2],
}

/// What is searched, and how.
#[derive(Clone, Debug)]
pub struct Problem {
    /// The histograms.
    histograms: Vec<Histogram>,
    /// Width of a bin.
    step_m: f64,
    /// Their response.
    pulse: Pulse,
    /// Their noise.
    noise: Noise,
    /// Probability that noise makes a point.
    false_alarm: f64,
    wall: Wall,
    /// Largest depth.
    depth_m: f64,
    /// Ends the search.
    cancel: Cancel,
}

impl Problem {
    /// A problem whose histograms have bins of `step_m`; what is hidden lies on the side of `front`, within `depth_m`
    /// of the wall. `None` where the histograms are fewer than 16 or their points span no plane.
    ///
    /// # Panics
    /// If `false_alarm` is not above 0 and below 1.
    #[must_use]
    pub fn new(
        mut histograms: Vec<Histogram>,
        (step_m, pulse, noise): (f64, Pulse, Noise),
        (front, depth_m): (Point, f64),
        false_alarm: f64,
        cancel: Cancel,
    ) -> Option<Self> {
        assert!(false_alarm > 0.0 && false_alarm < 1.0, "a probability of false alarm between 0 and 1");
        let wall = Wall::new(&histograms, front)?;
        for histogram in &mut histograms {
            histogram.ends = [histogram.lit, histogram.seen].map(|point| wall.across_of(&point));
        }
        Some(Self { histograms, step_m, pulse, noise, false_alarm, wall, depth_m, cancel })
    }

    /// One of two halves of the histograms.
    fn half(&self, half: u64) -> Self {
        self.only(|n| scatter(n) >> 63 == half)
    }

    /// About `count` of the histograms.
    fn part(&self, count: usize) -> Self {
        let share = count as f64 / self.histograms.len() as f64;
        // Other digits than those that make halves.
        self.only(|n| share > ((scatter(n) << 1) >> 11) as f64 / (1_u64 << 53) as f64)
    }

    fn only(&self, is_in: impl Fn(usize) -> bool) -> Self {
        let histograms = self.histograms.iter().enumerate().filter(|(n, _)| is_in(*n)).map(|(_, one)| one.clone());
        Self {
            histograms: histograms.collect(),
            wall: self.wall.clone(),
            pulse: self.pulse.clone(),
            cancel: self.cancel.clone(),
            ..*self
        }
    }
}

/// Digits of a number mixed, so that regular grids give irregular parts (splitmix64, Steele et al., OOPSLA 2014).
fn scatter(n: usize) -> u64 {
    let mut mixed = (n as u64).wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    mixed ^ (mixed >> 31)
}

/// Least number of histograms.
const LEAST: usize = 16;
/// Points closer than this share of the wall's size to a line span no plane.
const IN_LINE: f64 = 1e-3;

impl Wall {
    fn new(histograms: &[Histogram], front: Point) -> Option<Self> {
        if histograms.len() < LEAST {
            return None;
        }
        let points = || histograms.iter().flat_map(|one| [one.lit, one.seen]);
        let count = 2.0 * histograms.len() as f64;
        let middle = Point::from(points().map(|point| point.coords).sum::<Vector3<f64>>() / count);
        let arms = || points().map(|point| point - middle);
        let eigen = arms().map(|arm| arm * arm.transpose()).sum::<Matrix3<f64>>().symmetric_eigen();
        let normal: Vector3<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into();
        let normal = if normal.dot(&(front - middle)) < 0.0 { -normal } else { normal };
        // The axis of the frame that lies best in the plane: the directions do not turn with noise.
        let across = crate::axes::across(&normal);
        let half_m = across.map(|across| arms().map(|arm| across.dot(&arm).abs()).fold(0.0, f64::max));
        let spans = half_m[0].min(half_m[1]) > IN_LINE * half_m[0].max(half_m[1]);
        spans.then_some(Self { middle, across, normal, half_m })
    }

    fn across_of(&self, point: &Point) -> [f64; 2] {
        [0, 1].map(|axis| self.across[axis].dot(&(point - self.middle)) / self.half_m[axis])
    }
}

/// A small hidden thing.
#[derive(Clone, Debug, PartialEq)]
pub struct HiddenPoint {
    /// Position.
    pub place: Point,
    /// Covariance with all else free, widened by the misfit.
    pub covariance_m2: Matrix3<f64>,
    /// Photons in all histograms; for levels their sum.
    pub photons: f64,
    /// One over the relative standard deviation of its photons, with all else free.
    pub z: f64,
    /// Whether both halves of the histograms show it.
    pub reappears: bool,
}

/// What the histograms show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Small things, with error bars that hold.
    Points,
    /// Light that points do not explain: a surface, or a thing larger than the response resolves.
    ExtendedObject,
    /// Nothing above the threshold.
    Nothing,
    /// Neither is shown.
    CannotTell,
}

/// What was found, and on which evidence.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// What the histograms show.
    pub verdict: Verdict,
    /// Why, in words.
    pub reason: String,
    /// Points of the fit. With [`Verdict::Points`] only those that reappear, and only then do their error bars hold.
    pub points: Vec<HiddenPoint>,
    /// Share of the points that reappear in halves of the histograms; `None` where halves were not searched.
    pub reappear: Option<f64>,
    /// Places among which points were sought.
    pub cells: usize,
    /// Least root of twice the gain in log-likelihood of a point.
    pub threshold: f64,
    /// Largest filtered score before any point was fitted.
    pub largest: f64,
    /// Factor on variances for arrivals that lie off the model.
    pub misfit: f64,
    /// Standard deviation of arrivals beyond noise, as path length.
    pub scatter_m: f64,
    /// Mean square of what no shift common to all points of a histogram explains in their arrivals, in units of noise.
    pub own_misfit: f64,
    /// Power of the distance.
    pub power: f64,
    /// Width of pulses over that of the response.
    pub stretch: f64,
}
