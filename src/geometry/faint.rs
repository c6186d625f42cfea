//! A hidden patch too weak for an onset in any single profile, from its light in all profiles together.
//!
//! For each profile a matched filter gives the score z of one more pulse: its amplitude in standard deviations. It
//! depends on the length s of a way over a hidden point. A patch at q makes a pulse at `s = |q - a| + |q - b|` in the
//! profile of visible patches a and b. Its score is normal about its signal-to-noise ratio u with variance 1. The
//! log-likelihood ratio of one more patch is then
//!
//! ```text
//! L(q, g) = sum over profiles of log(1 - p + p sum_f w_f exp(u_f z - u_f^2 / 2)),
//! u_f = f g gain(s) / (|q - a|^2 |q - b|^2)
//! ```
//!
//! Amplitudes are unknown, but alike: one strength g, the fall of light over both legs, and a factor f in each profile,
//! spread by [`SPREAD`], for the cosines. Against known amplitudes that costs a few hundredths of the information; free
//! ones in each profile would cost half. With a probability of 1 - p something stands between.
//!
//! A patch is sure if its evidence, the log of the Bayes factor of a patch anywhere over none, exceeds -log(alpha):
//!
//! ```text
//! B = mean over the volume and the strengths of exp(L)
//! ```
//!
//! Without a patch B is 1 on average. Chance therefore makes it exceed 1 / alpha with a probability of at most alpha
//! (Markov's inequality), whatever the geometry. Strengths are equally probable on a logarithmic scale, from a
//! root-mean-square signal-to-noise ratio of 0.16 in a profile to 16. Of the integral over places only the part about
//! the best one is taken, by importance sampling at fixed points of low discrepancy. The sampling density is fitted to
//! the integrand in a few rounds (Cappé et al., J. Comput. Graph. Stat. 13, 907 (2004)). The omitted part would only
//! make B larger. Candidates come from a grid as fine as the response is short.
//!
//! One patch at a time: light of known places is to be projected out of the scores before, that of a patch just found
//! included.
//!
//! Errors of the foci and of delays are small against the response's width. They change no evidence, but all profiles
//! share them: [`gained_m2`] is what they add to the covariance of a place.
//!
//! Not modelled: unknown light in few profiles that is weaker than an onset.

mod grid;
mod likelihood;
mod sampling;
mod shared;

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;

use super::Point;
use super::hidden::Focus;
use super::hidden::search::Domain;
use likelihood::Likelihood;
pub use likelihood::{Profile, SPREAD};
pub use shared::{Ends, Shared, gained_m2};

/// Candidates that are judged by the likelihood at a point, by few samples, and by many.
const CANDIDATES: [usize; 3] = [400, 12, 3];
/// Standard deviation of the first samples about a candidate, as a share of the response's length.
const NEAR: f64 = 0.25;
/// Points of the grid from the middle of the foci to its end, at most: what lies farther off is not searched.
const SIDE_MAX: f64 = 160.0;
/// Evidence by few samples below which many change nothing.
const HOPELESS: f64 = -3.0;

/// What a patch is searched in.
#[derive(Clone, Debug)]
pub struct Room {
    /// Visible patches.
    pub foci: Vec<Focus>,
    /// 3, or 2 for flatland.
    pub dimensions: usize,
    /// Length that light goes in the time that the response is wide.
    pub width_m: f64,
    /// Ends the search: polled once a point and once a profile.
    pub cancel: Cancel,
}

/// A place where there may be a patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Faint {
    /// Position.
    pub point: Point,
    /// Covariance, m^2, given foci and delays. In flatland the third row and column are 0.
    pub covariance: Matrix3<f64>,
    /// Log of the Bayes factor of this patch over none.
    pub evidence: f64,
    /// Log-likelihood ratio where it is largest.
    pub likelihood: f64,
    /// Signal-to-noise ratio in all profiles together: the root of the sum of their squares.
    pub snr: f64,
    /// Share of the profiles that could have recorded it.
    pub seen: f64,
}

/// Chance with which the shots that [`Faint::growth`] calls for show the patch, as standard deviations.
const CHANCE_SD: f64 = 1.28;

impl Faint {
    /// How many times as many shots would show this patch, if it is one, in nine of ten campaigns.
    ///
    /// Its log-likelihood ratio G grows with the shots n, and its standard deviation as `sqrt(2 G n)`. The share of the
    /// volume that it is known to shrinks: `evidence + (n - 1) G - (d + 1) / 2 log n`, for d coordinates and the
    /// strength. Each of these adds half a unit to the largest log-likelihood ratio by chance.
    #[must_use]
    pub fn growth(&self, needed: f64, dimensions: usize) -> f64 {
        let unknowns = (dimensions + 1) as f64;
        let gain = (self.likelihood - 0.5 * unknowns).max(1.0);
        let least = |n: f64| {
            let expected = self.evidence + (n - 1.0) * gain - 0.5 * unknowns * n.ln();
            expected - CHANCE_SD * (2.0 * gain * n).sqrt()
        };
        let mut high = 1.0;
        while least(high) < needed {
            high *= 2.0;
        }
        let mut low = 0.5 * high;
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if least(middle) < needed { low = middle } else { high = middle }
        }
        high.max(1.0)
    }
}

/// The likeliest place of one more patch; `None` where the profiles speak for none. Places farther from the middle of
/// the foci than 160 half lengths of the response are not searched.
///
/// # Panics
/// When a profile names a focus that is not there.
#[must_use]
pub fn likeliest(profiles: &[Profile], room: &Room) -> Option<Faint> {
    let longest_m = profiles.iter().map(Profile::end_m).fold(0.0, f64::max);
    let middle = room.foci.iter().map(|focus| focus.point.coords).sum::<Vector3<f64>>();
    let centre = Point::from(middle / room.foci.len() as f64);
    // Of a patch further out than that every way would be longer than any record.
    let half_m = (0.5 * longest_m).min(SIDE_MAX * grid::STEP * room.width_m);
    let domain = Domain { centre, half_m, dimensions: room.dimensions };
    let all = Likelihood::new(profiles, room, &domain);
    let near_m = NEAR * room.width_m;
    let points = all.best(&grid::candidates(profiles, room, &domain, CANDIDATES[0]), CANDIDATES[1], near_m);
    let mut places = all.sampled(&points, near_m, false);
    places.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    if places.first().is_none_or(|place| place.evidence < HOPELESS) {
        return places.into_iter().next();
    }
    let starts: Vec<Point> = places.iter().take(CANDIDATES[2]).map(|place| place.point).collect();
    let places = all.sampled(&starts, near_m, true);
    places.into_iter().max_by(|a, b| a.evidence.total_cmp(&b.evidence))
}

#[cfg(test)]
mod tests;
