//! Hidden patches from the path lengths of third bounces, their number unknown (paper section 4.3, without its
//! labelling by order of arrival).
//!
//! A patch q that neither laser nor sensor sees is met by light between visible patches: lit a, then q, then seen b.
//! Each profile holds the length `|q - a| + |q - b|` of every hidden patch among others, unlabelled: bounces among
//! visible patches, later bounces, false onsets; and some are missing. With clutter of density `lambda`, a patch seen
//! with probability p, and `left` what other paths leave of an arrival (`superposition`),
//!
//! ```text
//! L(q) = sum over profiles of log(1 - p + p sum over arrivals of N(arrival; |q - a| + |q - b|, sd^2) left / lambda)
//! ```
//!
//! is the log-likelihood ratio of one more patch at q. A patch may also be too faint in all light that one visible
//! patch throws to the sensor, because that patch is small or turned away, or because something stands between. So the
//! sum is taken over the profiles of each seen patch, and `log(1 - v + v exp(sum))` counts, with the probability v that
//! the hidden patch shows there. It needs no minimal set of arrivals, no (i,i) profile, and no number of patches.
//! Patches are found one after the other: the place where L is largest in all of space ([`search`]),
//! climbed to its top (`climb`), is a patch if the evidence
//!
//! ```text
//! log B = L + log(sqrt((2 pi)^d |Cov|) / volume)
//! ```
//!
//! says so. B is the Bayes factor of a patch somewhere in the volume over none. Without a patch its mean is 1, so it
//! exceeds 1 / alpha with a probability of at most alpha (Markov's inequality), whatever the geometry. With a patch
//! more, all patches are climbed again and those without evidence dropped, until nothing is found and nothing dropped.
//!
//! A continuous floor or wall throws light back too, over the shortest way between each two patches
//! ([`Surface::Plane`]). Left alone it would pass for many patches, one for each few profiles; so planes are looked for
//! in the same way (`plane_seeds`), by the same evidence.
//!
//! A *way* ([`Way`]) is a pair of patches in place over which a profile shows a hidden one: its own two visible patches
//! for third bounces. A patch that light reaches only over hidden ones q and q' shows in fifth bounces a, q, x, q', b:
//! one way for each pair of these, on which the arrival is longer by the offset `|q - a| + |b - q'|`. Each way may make
//! an arrival of its own: the sum above runs over ways, and what one takes of an arrival is gone for the next. All
//! profiles repeat the same sums `|x - q| + |x - q'|`.
//!
//! Pulses of two paths nearer than `blend_m` may make one arrival between them (`blend`). Where other paths claim an
//! arrival near a way's length, one of its own is less expected there. An arrival may also stand for a second path near
//! it that has no arrival of its own: one over a patch found before, or straight from lit to seen. Such an arrival errs
//! by up to half the distance of both.
//!
//! Not modelled: errors that profiles share (of known legs, of foci, of delays), amplitudes.

mod blend;
mod climb;
mod explanation;
pub mod facing;
mod moves;
mod plane_seeds;
mod rivals;
pub mod search;
mod seeds;
mod starts;
mod superposition;
mod surface;

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;

use super::Point;
use explanation::{Claims, Explanation};
pub use surface::Surface;

/// Share of ways on which a patch is taken to be seen before anything is known of it.
const SEEN: f64 = 0.8;
/// Probability that a patch shows in the profiles of a seen patch at all.
const SHOWN: f64 = 0.8;
/// Rounds of proposals at most.
const ROUNDS: usize = 12;

/// A path length that may be that over a hidden patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// Length of both legs to the hidden patch, all other legs and delays taken off.
    pub length_m: f64,
    /// Its standard deviation, that of what was taken off included.
    pub sd_m: f64,
}

/// A path among patches that are in place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Path {
    /// What an arrival of this path would be taken for: its length less the same legs.
    pub length_m: f64,
    /// Standard deviation.
    pub sd_m: f64,
    /// Probability that it makes an arrival.
    pub seen: f64,
}

/// How the light of a profile may reach a hidden patch and come back: over two foci.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Way {
    /// Their positions among the foci, the smaller first.
    foci: [usize; 2],
    /// What arrivals over them are longer than both legs to the hidden patch.
    offset_m: f64,
    /// Its standard deviation.
    sd_m: f64,
}

impl Way {
    /// Over the patches at two positions among the foci. Arrivals are longer than the legs between these and the hidden
    /// patch by `offset_m` with standard deviation `sd_m`.
    #[must_use]
    pub fn new(foci: [usize; 2], offset_m: f64, sd_m: f64) -> Self {
        Self { foci: [foci[0].min(foci[1]), foci[0].max(foci[1])], offset_m, sd_m }
    }

    /// Standard deviation of an arrival as the sum of both legs.
    fn sd_m(&self, arrival_sd_m: f64) -> f64 {
        if self.sd_m == 0.0 { arrival_sd_m } else { arrival_sd_m.hypot(self.sd_m) }
    }
}

/// Arrivals of a lit and a seen patch, and the ways on which a hidden patch may make them.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Position of the patch that the sensor watches among those that it does.
    watched: usize,
    ways: Vec<Way>,
    arrivals: Vec<Arrival>,
    paths: Vec<Path>,
    span_m: [f64; 2],
    widest_m: f64,
}

impl Profile {
    /// Of the lit and the seen patch at two positions among the foci; `span_m` is the range of lengths that the record
    /// holds.
    #[must_use]
    pub fn new(foci: [usize; 2], arrivals: Vec<Arrival>, paths: Vec<Path>, span_m: [f64; 2]) -> Self {
        Self::over(foci[1], vec![Way::new(foci, 0.0, 0.0)], arrivals, paths, span_m)
    }

    /// Of a patch at a position among those that the sensor watches, with several ways; each may make its own arrival.
    #[must_use]
    pub fn over(
        watched: usize,
        ways: Vec<Way>,
        mut arrivals: Vec<Arrival>,
        paths: Vec<Path>,
        span_m: [f64; 2],
    ) -> Self {
        arrivals.retain(|arrival| (span_m[0]..=span_m[1]).contains(&arrival.length_m));
        arrivals.sort_by(|a, b| a.length_m.total_cmp(&b.length_m));
        let widest_m = arrivals.iter().map(|arrival| arrival.sd_m).fold(0.0, f64::max);
        Self { watched, ways, arrivals, paths, span_m, widest_m }
    }

    /// Gives its arrivals other standard deviations, in their order.
    fn set_sds(&mut self, sds_m: &[f64]) {
        self.arrivals.iter_mut().zip(sds_m).for_each(|(arrival, sd_m)| arrival.sd_m = *sd_m);
        self.widest_m = sds_m.iter().copied().fold(0.0, f64::max);
    }

    fn holds(&self, length_m: f64) -> bool {
        (self.span_m[0]..=self.span_m[1]).contains(&length_m)
    }
}

/// Number of patches that the sensor watches.
fn watched_count(profiles: &[Profile]) -> usize {
    profiles.iter().map(|profile| profile.watched + 1).max().unwrap_or(0)
}

/// A patch in place over which hidden ones are seen: a visible one, or a hidden one that shows others.
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
#[derive(Clone, Debug)]
pub struct Room {
    /// Patches in place.
    pub foci: Vec<Focus>,
    /// 3, or 2 for flatland.
    pub dimensions: usize,
    /// Probability that a patch is found where there is none.
    pub false_alarm: f64,
    /// Number of hidden patches, where it is known.
    pub count: Option<usize>,
    /// Lengths nearer than this may have one arrival together; 0: each has its own.
    pub blend_m: f64,
    /// Ends the search: polled once a chunk of cubes, once a profile, and once a step of a climb.
    pub cancel: Cancel,
}

/// A hidden surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hidden {
    /// A patch, or a plane.
    pub surface: Surface,
    /// Position; of a plane the foot of the perpendicular from the middle of the visible patches.
    pub point: Point,
    /// Covariance, visible patches taken as exact but for what stands in the arrivals' errors. In flatland the third
    /// row and column are 0.
    pub covariance: Matrix3<f64>,
    /// Log of the Bayes factor of this surface over none.
    pub evidence: f64,
    /// Share of the ways on which it is seen.
    pub seen: f64,
    /// Number of arrivals that it makes, expected.
    pub arrivals: f64,
}

/// What a search returns.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Solution {
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
/// When a way names a focus that is not there.
#[must_use]
pub fn find(profiles: &[Profile], room: &Room) -> Solution {
    let Some(mut all) = Explanation::new(profiles, room, SHOWN) else { return Solution::default() };
    // Minimal sets find most, cheaply; a search of all space finds the others among what is left. It would come to
    // whatever the former make up.
    all.add_seeds(Claims::Likely);
    let mut is_open = true;
    for _ in 0..ROUNDS {
        let starts = all.cubes();
        is_open = !starts.is_empty();
        if !all.add(&starts) {
            break;
        }
    }
    let mut next = if is_open { all.likeliest() } else { None };
    for _ in 0..ROUNDS {
        match next {
            Some(first) if all.add_together(first) => next = all.likeliest(),
            _ => break,
        }
    }
    let declined = next.filter(|hidden| !all.is_sure(hidden));
    Solution { declined, ..all.solution() }
}

/// Finds those that minimal sets of arrivals lead to. Where profiles are full of later bounces, which are no chance, a
/// search of all space would follow these without end; and lengths that many profiles repeat, as on several ways, leave
/// minimal sets nothing to overlook. A patch has to show over all seen patches alike: in a few profiles, later bounces
/// agree on places where nothing is.
///
/// # Panics
/// When a way names a focus that is not there.
#[must_use]
pub fn find_by_minimal_sets(profiles: &[Profile], room: &Room) -> Solution {
    let Some(mut all) = Explanation::new(profiles, room, 1.0) else { return Solution::default() };
    all.add_seeds(Claims::All);
    all.solution()
}

#[cfg(test)]
mod tests;
