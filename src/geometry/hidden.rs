//! Hidden patches from the path lengths of third bounces, their number unknown (paper section 4.3, without its labelling by order of arrival).
//!
//! A patch q that neither laser nor sensor sees is met by light between visible patches: lit a, then q, then seen b. Each profile holds the length
//! `|q - a| + |q - b|` of every hidden patch among others, unlabelled: bounces among visible patches, later bounces, false onsets; and some are missing. With
//! clutter of density `lambda`, a patch seen with probability p, and `left` what other paths leave of an arrival (`superposition`),
//!
//! ```text
//! L(q) = sum over profiles of log(1 - p + p sum over arrivals of N(arrival; |q - a| + |q - b|, sd^2) left / lambda)
//! ```
//!
//! is the log-likelihood ratio of one more patch at q. It needs no minimal set of arrivals, no (i,i) profile, and no number of patches. Patches are found one after the other:
//! the place where L is largest in all of space ([`search`]), climbed to its top (`climb`), is a patch if the evidence
//!
//! ```text
//! log B = L + log(sqrt((2 pi)^d |Cov|) / volume)
//! ```
//!
//! says so. B is the Bayes factor of a patch somewhere in the volume over none: without a patch its mean is 1, so that it exceeds 1 / alpha with a probability of at most alpha
//! (Markov's inequality), whatever the geometry. With a patch more, all patches are climbed again and those without evidence dropped, until nothing is found and nothing dropped.
//!
//! A continuous floor or wall throws light back too, over the shortest way between each two patches ([`Surface::Plane`]). Left alone it would pass for many patches, one for each few profiles;
//! so planes are looked for in the same way (`plane_seeds`), by the same evidence.
//!
//! Not modelled: errors that profiles share (of known legs, of delays), arrivals that are two unresolved ones, amplitudes.

mod climb;
mod explanation;
mod moves;
mod plane_seeds;
mod rivals;
pub mod search;
mod seeds;
mod starts;
mod superposition;
mod surface;

use nalgebra::{Matrix3, Vector3};

use super::Point;
use explanation::Explanation;
pub use surface::Surface;

/// Share of profiles in which a patch is taken to be seen before anything is known of it.
const SEEN: f64 = 0.8;
/// Rounds of proposals at most.
const ROUNDS: usize = 12;

/// A path length that may be that over a hidden patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// Length of both legs, known legs and delays taken off.
    pub length_m: f64,
    /// Its standard deviation, that of what was taken off included.
    pub sd_m: f64,
}

/// A path among patches that are in place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// What an arrival of this path would be taken for: its length less the same known legs.
    pub length_m: f64,
    /// Standard deviation.
    pub sd_m: f64,
    /// Probability that it makes an arrival.
    pub seen: f64,
}

/// Arrivals between two visible patches.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    foci: [usize; 2],
    arrivals: Vec<Arrival>,
    known: Vec<Known>,
    span_m: [f64; 2],
    widest_m: f64,
}

impl Profile {
    /// Of the patches at two positions among the foci; `span_m` is the range of lengths that the record holds.
    #[must_use]
    pub fn new(foci: [usize; 2], mut arrivals: Vec<Arrival>, known: Vec<Known>, span_m: [f64; 2]) -> Self {
        arrivals.retain(|arrival| (span_m[0]..=span_m[1]).contains(&arrival.length_m));
        arrivals.sort_by(|a, b| a.length_m.total_cmp(&b.length_m));
        let widest_m = arrivals.iter().map(|arrival| arrival.sd_m).fold(0.0, f64::max);
        Self { foci: [foci[0].min(foci[1]), foci[0].max(foci[1])], arrivals, known, span_m, widest_m }
    }
}

/// A visible patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Focus {
    /// Position.
    pub point: Point,
    /// Normal of its wall on the side that is lit, where it is known: the patch exchanges light with nothing behind it.
    pub normal: Option<Vector3<f64>>,
}

impl Focus {
    /// Whether a point, or one nearer to it than `slack_m`, is not behind the patch's wall.
    #[must_use]
    pub fn faces(&self, point: Point, slack_m: f64) -> bool {
        self.normal.is_none_or(|normal| normal.dot(&(point - self.point)) > -slack_m)
    }
}

/// What hidden patches are searched in.
#[derive(Clone, Debug, PartialEq)]
pub struct Room {
    /// Visible patches.
    pub foci: Vec<Focus>,
    /// 3, or 2 for flatland.
    pub dimensions: usize,
    /// Probability that a patch is found where there is none.
    pub false_alarm: f64,
    /// Number of hidden patches, where it is known.
    pub count: Option<usize>,
}

/// A hidden surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hidden {
    /// A patch, or a plane.
    pub surface: Surface,
    /// Position; of a plane the foot of the perpendicular from the middle of the visible patches.
    pub point: Point,
    /// Covariance, visible patches taken as exact but for what stands in the arrivals' errors. In flatland the third row and column are 0.
    pub covariance: Matrix3<f64>,
    /// Log of the Bayes factor of this surface over none.
    pub evidence: f64,
    /// Share of the profiles in which it is seen.
    pub seen: f64,
    /// Number of arrivals that it makes, expected.
    pub arrivals: f64,
}

/// What a search found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Patches that explain arrivals which nothing else does, the surest first.
    pub patches: Vec<Hidden>,
    /// For each its mirror image in the plane nearest to the visible patches, where the arrivals do not rule it out.
    pub rivals: Vec<Option<Hidden>>,
    /// Planes that explain arrivals which nothing else does.
    pub planes: Vec<Hidden>,
    /// The likeliest place for one more patch that is not sure enough, if there is any.
    pub declined: Option<Hidden>,
}

/// Finds the hidden patches.
///
/// # Panics
/// When a profile names a focus that is not there.
#[must_use]
pub fn find(profiles: &[Profile], room: &Room) -> Found {
    let Some(mut all) = Explanation::new(profiles, room) else { return Found::default() };
    // Minimal sets find most, cheaply; a search of all space finds the others among what is left.
    for _ in 0..ROUNDS {
        let mut starts = all.seeds();
        starts.extend(all.plane_seeds());
        if !all.add(&starts) {
            break;
        }
    }
    let mut is_open = true;
    for _ in 0..ROUNDS {
        let starts = all.cubes();
        is_open = !starts.is_empty();
        if !all.add(&starts) {
            break;
        }
    }
    for _ in 0..if is_open { ROUNDS } else { 0 } {
        if !all.add_together() {
            break;
        }
    }
    let declined = if is_open { all.likeliest().filter(|hidden| !all.is_sure(hidden)) } else { None };
    let (patches, planes): (Vec<usize>, Vec<usize>) =
        (0..all.found.len()).partition(|&n| all.found[n].surface == Surface::Patch);
    let mut patches: Vec<(Hidden, Option<Hidden>)> =
        patches.into_iter().map(|n| (all.found[n], all.rival(n))).collect();
    patches.sort_by(|a, b| b.0.evidence.total_cmp(&a.0.evidence));
    patches.truncate(room.count.unwrap_or(usize::MAX));
    let (patches, rivals) = patches.into_iter().unzip();
    Found { patches, rivals, planes: planes.into_iter().map(|n| all.found[n]).collect(), declined }
}

#[cfg(test)]
mod tests;
