//! Pulses that other records predict: where they start, and what their prior says.
//!
//! Blended pulses are told apart by where their light should come and how wide it should be: what one record cannot say
//! of two pulses, others can. A predicted pulse starts where it is predicted, with a normal prior on its time and one
//! on the variance of its light. It stays in the fit even where it shows no light: others beside it are that unsure.
//!
//! The prior of a time rests on the same records as the time, or on solutions of them, so that it must not count again.
//! It is made soft, and only finds the optimum; [`OwnTimes`] takes it out of the result: with the information `H` of
//! all times, priors `D` in it,
//!
//! ```text
//! C = (H - D)^-1,   t_own = t + C D (t - t_predicted),
//! ```
//!
//! one Newton step of the likelihood alone from the optimum of both. Times that the record alone does not tell apart
//! have large variances there and covariances that say so; what sums of them are, stays exact.
//!
//! The prior of a width rests on the widths of the same patch in all records. It is not made soft, since without it a
//! blend does not determine widths and times; [`own_variance_ps2`] takes each pulse's own out. With it in, what is
//! predicted wrong would stay wrong, as sure as all records together make it.

use super::linear::Cholesky;
use super::place::Place;

/// The prior of a time is no tighter than this share of the width of the response.
const SOFT_WIDTHS: f64 = 0.05;
/// Without its prior a time is held to this many widths of the response, so that its variance stays finite.
const LOOSE_WIDTHS: f64 = 1.0;
/// A record whose share of what is known of a width is less than the first hardly speaks of it; it counts as the other.
const SAYS_LITTLE: f64 = 0.1;
const NOTHING: f64 = 1e-3;

/// A pulse that other records predict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// Arrival of the centroid of its light, ps.
    pub time_ps: f64,
    /// Standard deviation of that.
    pub time_sd_ps: f64,
    /// Standard deviation of the spread of its light, ps; 0 for a point.
    pub width_ps: f64,
    /// Standard deviation of `width_ps`.
    pub width_sd_ps: f64,
}

/// Normal priors of a place: mean and standard deviation of its time, and of its variance where light is spread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Prior {
    time_ps: [f64; 2],
    variance_ps2: Option<[f64; 2]>,
}

impl Prediction {
    /// Where it starts, for a response of this width and where light is spread by so much at most.
    pub(super) fn place(&self, response_width_ps: f64, extent_max_ps: f64) -> Place {
        let time_sd_ps = self.time_sd_ps.max(SOFT_WIDTHS * response_width_ps);
        let variance_ps2 = self.width_ps.min(extent_max_ps).powi(2);
        let start =
            if variance_ps2 > 0.0 { Place::widened(self.time_ps, variance_ps2) } else { Place::point(self.time_ps) };
        let of_variance = (variance_ps2 > 0.0).then_some([variance_ps2, 2.0 * self.width_ps * self.width_sd_ps]);
        let prior = Prior { time_ps: [self.time_ps, time_sd_ps], variance_ps2: of_variance };
        Place { prior: Some(prior), ..start }
    }
}

impl Prior {
    /// How far parameter `p` is off, and the information of its prior; `None` where it has none.
    pub(super) fn pull(&self, place: &Place, p: usize) -> Option<[f64; 2]> {
        let (value, [mean, sd]) = match p {
            0 => (place.time_ps, self.time_ps),
            1 => (place.variance_ps2, self.variance_ps2?),
            _ => return None,
        };
        Some([value - mean, (sd * sd).recip()])
    }
}

/// Variance of a pulse's light, ps^2, and its standard deviation, without what was predicted of it; the variance with
/// that has the standard deviation `sd_ps2`. Priors of its time and of other pulses stay.
///
/// Where the record hardly speaks of the width, first order would take it far off: there it stays, as unsure as can be.
pub(super) fn own_variance_ps2(place: &Place, sd_ps2: f64) -> [f64; 2] {
    let Some([off_ps2, prior]) = place.pull(1) else { return [place.variance_ps2, sd_ps2] };
    let information = (sd_ps2 * sd_ps2).recip();
    let own = information - prior;
    if own < SAYS_LITTLE * information {
        return [place.variance_ps2, (NOTHING * information).sqrt().recip()];
    }
    [place.variance_ps2 + off_ps2 * prior / own, own.sqrt().recip()]
}

/// Times without what was predicted of them.
pub(super) struct OwnTimes {
    /// What it adds to each time, ps.
    pub(super) moves_ps: Vec<f64>,
    /// Their covariance, ps^2, row-major.
    pub(super) covariance_ps2: Vec<f64>,
}

impl OwnTimes {
    /// From the covariance of all times with their priors in it, and `pulls` of these (`None` for a time without).
    pub(super) fn new(covariance_ps2: Vec<f64>, pulls: &[Option<[f64; 2]>], response_width_ps: f64) -> Self {
        let count = pulls.len();
        let as_they_are = |covariance_ps2| Self { moves_ps: vec![0.0; count], covariance_ps2 };
        if pulls.iter().all(Option::is_none) {
            return as_they_are(covariance_ps2);
        }
        let Some(with_priors) = Cholesky::new(covariance_ps2.clone(), count) else {
            return as_they_are(covariance_ps2);
        };
        let mut information = with_priors.inverse();
        let loose = (LOOSE_WIDTHS * response_width_ps).powi(-2);
        for (k, [_, prior]) in pulls.iter().enumerate().filter_map(|(k, pull)| Some((k, (*pull)?))) {
            information[k * (count + 1)] += loose - prior;
        }
        let Some(own) = Cholesky::new(information, count) else { return as_they_are(covariance_ps2) };
        let mut moves_ps: Vec<f64> =
            pulls.iter().map(|pull| pull.map_or(0.0, |[off_ps, prior]| prior * off_ps)).collect();
        own.solve(&mut moves_ps);
        Self { moves_ps, covariance_ps2: own.inverse() }
    }
}
