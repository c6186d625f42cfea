//! Hidden patches from the path lengths of third bounces, their number unknown (paper section 4.3, without its labelling by order of arrival).
//!
//! A patch q that neither laser nor sensor sees is met by light between visible patches: lit a, then q, then seen b. Each profile holds the length
//! `|q - a| + |q - b|` of every hidden patch among others, unlabelled: bounces among visible patches, later bounces, false onsets; and some are missing. With
//! clutter of density `lambda`, a patch seen with probability p, and `left` what other paths leave of an arrival ([`superposition`]),
//!
//! ```text
//! L(q) = sum over profiles of log(1 - p + p sum over arrivals of N(arrival; |q - a| + |q - b|, sd^2) left / lambda)
//! ```
//!
//! is the log-likelihood ratio of one more patch at q. It needs no minimal set of arrivals, no (i,i) profile, and no number of patches. Patches are found one after the other:
//! the place where L is largest in all of space ([`search`]), climbed to its top ([`climb`]), is a patch if the evidence
//!
//! ```text
//! log B = L + log(sqrt((2 pi)^d |Cov|) / volume)
//! ```
//!
//! says so. B is the Bayes factor of a patch somewhere in the volume over none: without a patch its mean is 1, so that it exceeds 1 / alpha with a probability of at most alpha
//! (Markov's inequality), whatever the geometry. With a patch more, all patches are climbed again and those without evidence dropped, until nothing is found and nothing dropped.
//!
//! Not modelled: errors that profiles share (of known legs, of delays), arrivals that are two unresolved ones, amplitudes.

mod climb;
#[cfg(test)]
mod scene;
pub mod search;
mod seeds;
mod superposition;

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::Point;
use climb::{GATE, Place, View};
use search::{Curve, Domain, Legs};
use seeds::{Lengths, Seed};
use superposition::Pair;

/// Share of profiles in which a patch is taken to be seen before anything is known of it, and the least and largest share.
const SEEN: f64 = 0.8;
const SEEN_RANGE: [f64; 2] = [0.3, 0.98];
/// Values of curves per standard deviation.
const PER_SD: f64 = 3.0;
/// Cubes are cut until a path over them varies by this many standard deviations to either side.
const FINE: f64 = 2.0;
/// Share of what a sure patch needs that a cube must promise to be cut, and most climbs of a search.
const PROMISING: f64 = 0.6;
const CLIMBS: usize = 400;
/// Bases whose arrivals are crossed at a time.
const BASES: usize = 4;
/// An arrival of which paths leave more than this is unexplained.
const UNEXPLAINED: f64 = 0.5;
/// Reciprocal arrivals nearer than this many standard deviations are one.
const TOGETHER_SD: f64 = 2.5;
/// Places nearer than this many standard deviations of a length are one.
const APART: f64 = 1.0;
/// A patch that moves by more standard deviations explains other arrivals than before.
const FAR: f64 = 0.5;
/// Rounds of climbing all patches, beside one for each that is dropped.
const POLISH: usize = 12;
/// Searches at most.
const SEARCHES: usize = 12;
/// Patches that are tried together.
const TOGETHER: usize = 4;
/// Points along each axis that the volume is counted by.
const VOLUME_POINTS: i32 = 24;

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

/// What hidden patches are searched in.
#[derive(Clone, Debug, PartialEq)]
pub struct Room {
    /// Visible patches.
    pub foci: Vec<Point>,
    /// 3, or 2 for flatland.
    pub dimensions: usize,
    /// Points of walls and their normals: hidden patches lie in front of all of them.
    pub fronts: Vec<(Point, Vector3<f64>)>,
    /// Probability that a patch is found where there is none.
    pub false_alarm: f64,
    /// Number of hidden patches, where it is known.
    pub count: Option<usize>,
}

/// A hidden patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hidden {
    /// Position.
    pub point: Point,
    /// Covariance, visible patches taken as exact but for what stands in the arrivals' errors. In flatland the third row and column are 0.
    pub covariance: Matrix3<f64>,
    /// Log of the Bayes factor of this patch over none.
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
    /// The likeliest place for one more that is not sure enough, if there is any.
    pub declined: Option<Hidden>,
}

/// Finds the hidden patches.
///
/// # Panics
/// When a profile names a focus that is not there.
#[must_use]
pub fn find(profiles: &[Profile], room: &Room) -> Found {
    let Some(mut scene) = Scene::new(profiles, room) else { return Found::default() };
    // Minimal sets find most, cheaply; a search of all space finds the others among what is left.
    for _ in 0..SEARCHES {
        let starts = scene.seeds();
        if !scene.add(&starts) {
            break;
        }
    }
    for _ in 0..SEARCHES {
        let starts = scene.cubes();
        if !scene.add(&starts) {
            break;
        }
    }
    for _ in 0..SEARCHES {
        if !scene.try_more() {
            break;
        }
    }
    let declined = scene.likeliest().filter(|hidden| !scene.is_sure(hidden));
    let mut patches = scene.patches;
    patches.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    patches.truncate(room.count.unwrap_or(usize::MAX));
    Found { patches, declined }
}

struct Scene<'a> {
    profiles: &'a [Profile],
    room: &'a Room,
    domain: Domain,
    /// Log of the domain's volume (in flatland its area).
    log_volume: f64,
    /// Usual standard deviation of an arrival.
    sd_m: f64,
    clutter_per_m: f64,
    patches: Vec<Hidden>,
    /// For each profile its paths and arrivals that may belong together; paths are the known ones, then the patches.
    pairs: Vec<Vec<Pair>>,
}

impl<'a> Scene<'a> {
    /// Without any patch; `None` without arrivals.
    fn new(profiles: &'a [Profile], room: &'a Room) -> Option<Self> {
        let mut sds: Vec<f64> =
            profiles.iter().flat_map(|profile| &profile.arrivals).map(|arrival| arrival.sd_m).collect();
        sds.sort_by(f64::total_cmp);
        let sd_m = *sds.get(sds.len() / 2)?;
        let middle = room.foci.iter().map(|focus| focus.coords).sum::<Vector3<f64>>() / room.foci.len() as f64;
        // Of a patch further out than that every path would be longer than any record.
        let longest_m = profiles.iter().map(|profile| profile.span_m[1]).fold(0.0, f64::max);
        let domain = Domain {
            centre: Point::from(middle),
            half_m: 0.5 * longest_m,
            dimensions: room.dimensions,
            fronts: room.fronts.clone(),
        };
        let mut scene = Self {
            profiles,
            room,
            log_volume: 0.0,
            domain,
            sd_m,
            clutter_per_m: 0.0,
            patches: Vec::new(),
            pairs: Vec::new(),
        };
        scene.log_volume = scene.volume().ln();
        scene.settle();
        Some(scene)
    }

    /// Volume of the places that more than half of the profiles could have recorded.
    fn volume(&self) -> f64 {
        let n = VOLUME_POINTS;
        let (step_m, flat) = (2.0 * self.domain.half_m / f64::from(n), self.domain.dimensions == 2);
        let at = |k: i32| (f64::from(k) + 0.5) * step_m - self.domain.half_m;
        let is_recorded = |point: &Point| {
            let is_in = |profile: &&Profile| {
                let length_m: f64 = profile.foci.iter().map(|focus| (point - self.room.foci[*focus]).norm()).sum();
                length_m <= profile.span_m[1]
            };
            self.domain.holds(*point, 0.0) && 2 * self.profiles.iter().filter(is_in).count() > self.profiles.len()
        };
        let depth = if flat { 1 } else { n };
        let grid = (0..n).flat_map(|i| (0..n).flat_map(move |j| (0..depth).map(move |k| (i, j, k))));
        let points =
            grid.map(|(i, j, k)| self.domain.centre + Vector3::new(at(i), at(j), if flat { 0.0 } else { at(k) }));
        let count = points.filter(is_recorded).count().max(1);
        count as f64 * step_m.powi(self.domain.dimensions as i32)
    }

    /// Which path made which arrival, and how much clutter that leaves.
    fn settle(&mut self) {
        let span_m: f64 = self.profiles.iter().map(|profile| profile.span_m[1] - profile.span_m[0]).sum();
        let count: usize = self.profiles.iter().map(|profile| profile.arrivals.len()).sum();
        if self.clutter_per_m == 0.0 {
            self.clutter_per_m = (count + 1) as f64 / span_m;
        }
        for _ in 0..2 {
            self.pairs = self.profiles.iter().map(|profile| self.pairs_of(profile)).collect();
            let unexplained: f64 = self.left().iter().flatten().sum();
            self.clutter_per_m = (unexplained + 1.0) / span_m;
        }
    }

    fn pairs_of(&self, profile: &Profile) -> Vec<Pair> {
        let [a, b] = profile.foci.map(|focus| self.room.foci[focus]);
        let hidden = self.patches.iter().map(|patch| Known {
            length_m: (patch.point - a).norm() + (patch.point - b).norm(),
            sd_m: 0.0,
            seen: patch.seen,
        });
        let mut pairs = Vec::new();
        for (path, known) in profile.known.iter().copied().chain(hidden).enumerate() {
            let reach_m = GATE * profile.widest_m.hypot(known.sd_m);
            let from = profile.arrivals.partition_point(|arrival| arrival.length_m < known.length_m - reach_m);
            for (arrival, at) in profile.arrivals.iter().enumerate().skip(from) {
                let off_m = at.length_m - known.length_m;
                if off_m > reach_m {
                    break;
                }
                let sd_m = at.sd_m.hypot(known.sd_m);
                let density = (-0.5 * (off_m / sd_m).powi(2)).exp() / ((2.0 * std::f64::consts::PI).sqrt() * sd_m);
                let odds = known.seen / (1.0 - known.seen) * density / self.clutter_per_m;
                pairs.push(Pair::new(path, arrival, odds));
            }
        }
        superposition::settle(&mut pairs, profile.known.len() + self.patches.len(), profile.arrivals.len());
        pairs
    }

    /// What all paths leave of each arrival.
    fn left(&self) -> Vec<Vec<f64>> {
        let of_profile =
            |(profile, pairs): (&Profile, &Vec<Pair>)| superposition::left_over(pairs, profile.arrivals.len(), None);
        self.profiles.iter().zip(&self.pairs).map(of_profile).collect()
    }

    /// What all paths but those of one patch leave of each arrival.
    fn left_for(&self, patch: usize) -> Vec<Vec<f64>> {
        let of_profile = |(profile, pairs): (&Profile, &Vec<Pair>)| {
            superposition::left_over(pairs, profile.arrivals.len(), Some(profile.known.len() + patch))
        };
        self.profiles.iter().zip(&self.pairs).map(of_profile).collect()
    }

    fn view<'b>(&'b self, left: &'b [Vec<f64>], seen: f64) -> View<'b> {
        View {
            foci: &self.room.foci,
            profiles: self.profiles,
            left,
            clutter_per_m: self.clutter_per_m,
            seen,
            dimensions: self.room.dimensions,
        }
    }

    /// Bayes factor of a place over none, as its log.
    fn hidden(&self, place: Place, seen: f64) -> Option<Hidden> {
        let mut information = place.information;
        if self.room.dimensions == 2 {
            for k in 0..2 {
                information[(2, k)] = 0.0;
                information[(k, 2)] = 0.0;
            }
            information[(2, 2)] = 1.0;
        }
        let mut covariance = information.try_inverse()?;
        let determinant = covariance.determinant();
        if !(determinant > 0.0) {
            return None;
        }
        if self.room.dimensions == 2 {
            covariance[(2, 2)] = 0.0;
        }
        let width = 0.5 * (determinant.ln() + self.room.dimensions as f64 * (2.0 * std::f64::consts::PI).ln());
        let evidence = place.likelihood + width - self.log_volume;
        Some(Hidden { point: place.point, covariance, evidence, seen, arrivals: place.arrivals })
    }

    /// No patch is sure below this likelihood, however well its arrivals determine it.
    fn least_likelihood(&self) -> f64 {
        let stiffest = 4.0 * self.profiles.len() as f64 / (self.sd_m * self.sd_m);
        let width = 0.5 * self.room.dimensions as f64 * (2.0 * std::f64::consts::PI / stiffest).ln();
        self.log_volume - width - self.room.false_alarm.ln()
    }

    fn is_sure(&self, hidden: &Hidden) -> bool {
        hidden.evidence > -self.room.false_alarm.ln() && self.domain.holds(hidden.point, 0.0)
    }

    /// Adds the sure patches among the tops near some starts, and says whether there are more then.
    fn add(&mut self, starts: &[Point]) -> bool {
        let before = self.patches.len();
        let mut places = self.tops(starts);
        while let Some(next) =
            places.iter().position(|place| self.hidden(*place, SEEN).is_some_and(|hidden| self.is_sure(&hidden)))
        {
            // What came before it was not sure and will not become so by more patches.
            let place = places.swap_remove(next);
            places.drain(..next.min(places.len()));
            let left = self.left();
            let place = self.view(&left, SEEN).climb(place.point);
            if let Some(hidden) = self.hidden(place, SEEN).filter(|hidden| self.is_sure(hidden)) {
                self.patches.push(hidden);
                self.settle();
            }
        }
        self.polish();
        self.patches.len() > before
    }

    /// Adds patches that are not sure alone, but may be together: what one explains is no longer clutter to the others.
    fn try_more(&mut self) -> bool {
        let before = (self.patches.clone(), self.total());
        for _ in 0..TOGETHER {
            let Some(hidden) = self.likeliest() else { break };
            self.patches.push(hidden);
            self.settle();
            for _ in 0..3 {
                self.climb_all();
            }
        }
        self.polish();
        if self.total() > before.1 + 1e-3 {
            return true;
        }
        self.patches = before.0;
        self.settle();
        false
    }

    /// The likeliest place for one more patch, sure or not.
    fn likeliest(&self) -> Option<Hidden> {
        self.hidden(*self.tops(&self.cubes()).first()?, SEEN)
    }

    /// Evidence of all patches.
    fn total(&self) -> f64 {
        self.patches.iter().map(|patch| patch.evidence).sum()
    }

    /// Middles of cubes where the likelihood may be high enough, those of one top thinned out.
    fn cubes(&self) -> Vec<Point> {
        let legs = self.legs(&self.left());
        let least = PROMISING * self.least_likelihood();
        let cubes = search::search(&self.room.foci, &legs, &self.domain, 0.5 * FINE * self.sd_m, least as f32);
        self.thinned(cubes.into_iter().map(|(centre, _)| centre))
    }

    /// Places that minimal sets of arrivals agree on.
    fn seeds(&self) -> Vec<Point> {
        let pairs = self.unexplained();
        let bases = seeds::bases(&self.room.foci, &pairs, &self.domain, BASES);
        let mut found: Vec<Seed> =
            bases.iter().flat_map(|base| seeds::seeds(&self.room.foci, &pairs, base, &self.domain)).collect();
        found.sort_by(|a, b| b.likelihood.total_cmp(&a.likelihood));
        self.thinned(found.into_iter().map(|seed| seed.point))
    }

    /// Arrivals that paths leave, profiles of the same two patches together: two within their errors are one.
    fn unexplained(&self) -> Vec<Lengths> {
        let mut pairs: BTreeMap<[usize; 2], (usize, Vec<(f64, f64)>)> = BTreeMap::new();
        for (profile, left) in self.profiles.iter().zip(self.left()) {
            let (profiles, lengths_m) = pairs.entry(profile.foci).or_default();
            *profiles += 1;
            let free = profile.arrivals.iter().zip(left).filter(|(_, left)| *left > UNEXPLAINED);
            lengths_m.extend(free.map(|(arrival, _)| (arrival.length_m, arrival.sd_m)));
        }
        let of_pair = |(foci, (profiles, mut lengths_m)): ([usize; 2], (usize, Vec<(f64, f64)>))| {
            lengths_m.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut merged: Vec<(f64, f64)> = Vec::new();
            let mut is_single = false;
            for next in lengths_m {
                match merged.last_mut().filter(|last| is_single && next.0 - last.0 < TOGETHER_SD * last.1.hypot(next.1))
                {
                    Some(last) => {
                        let weights = (last.1.powi(-2), next.1.powi(-2));
                        *last = (
                            (last.0 * weights.0 + next.0 * weights.1) / (weights.0 + weights.1),
                            (weights.0 + weights.1).sqrt().recip(),
                        );
                        is_single = false;
                    }
                    None => {
                        merged.push(next);
                        is_single = true;
                    }
                }
            }
            let seen = 1.0 - (1.0 - SEEN).powi(profiles as i32);
            let density_per_m = (merged.len() + 1) as f64 / (2.0 * self.domain.half_m);
            Lengths { foci, lengths_m: merged, density_per_m, seen }
        };
        pairs.into_iter().map(of_pair).collect()
    }

    /// At most so many places, none near another that comes before it.
    fn thinned(&self, places: impl Iterator<Item = Point>) -> Vec<Point> {
        let mut kept: Vec<Point> = Vec::new();
        for place in places {
            if kept.len() < CLIMBS && kept.iter().all(|other| (other - place).norm() > FINE * self.sd_m) {
                kept.push(place);
            }
        }
        kept
    }

    /// Tops of the likelihood near some starts, the highest first.
    fn tops(&self, starts: &[Point]) -> Vec<Place> {
        let left = self.left();
        let view = self.view(&left, SEEN);
        let mut places: Vec<Place> = Vec::new();
        let mut climbed: Vec<Place> = starts.par_iter().map(|start| view.climb(*start)).collect();
        climbed.sort_by(|a, b| b.likelihood.total_cmp(&a.likelihood));
        for place in climbed {
            if places.iter().all(|other| (other.point - place.point).norm() > APART * self.sd_m) {
                places.push(place);
            }
        }
        places
    }

    /// What each length is worth to one more patch, profiles of the same two patches together.
    fn legs(&self, left: &[Vec<f64>]) -> Vec<Legs> {
        let step_m = self.sd_m / PER_SD;
        let longest_m = 2.0 * self.domain.half_m;
        let count = (longest_m / step_m).ceil() as usize + 1;
        let mut legs: Vec<Legs> = Vec::new();
        let mut order: Vec<usize> = (0..self.profiles.len()).collect();
        order.sort_by_key(|profile| self.profiles[*profile].foci);
        let mut sums = vec![0.0_f64; count];
        for profile in order {
            let (of, left) = (&self.profiles[profile], &left[profile]);
            if legs.last().is_none_or(|legs| legs.foci != of.foci) {
                legs.push(Legs { foci: of.foci, curve: Curve { low_m: 0.0, step_m, values: vec![0.0; count] } });
            }
            let bin = |length_m: f64| ((length_m / step_m).max(0.0) as usize).min(count - 1);
            let (first, last) = (bin(of.span_m[0]), bin(of.span_m[1]));
            sums[first..=last].fill(1.0 - SEEN);
            for (arrival, left) in of.arrivals.iter().zip(left) {
                let scale = SEEN * left / ((2.0 * std::f64::consts::PI).sqrt() * arrival.sd_m * self.clutter_per_m);
                let reach_m = GATE * arrival.sd_m;
                for k in bin(arrival.length_m - reach_m).max(first)..=bin(arrival.length_m + reach_m).min(last) {
                    let off = (k as f64 * step_m - arrival.length_m) / arrival.sd_m;
                    sums[k] += scale * (-0.5 * off * off).exp();
                }
            }
            let values = &mut legs.last_mut().expect("just pushed").curve.values;
            for (value, sum) in values[first..=last].iter_mut().zip(&sums[first..=last]) {
                *value += sum.ln() as f32;
            }
        }
        legs
    }

    /// Climbs all patches again, each with what the others leave; the longest move in standard deviations.
    fn climb_all(&mut self) -> f64 {
        let mut moved = 0.0_f64;
        for n in 0..self.patches.len() {
            let left = self.left_for(n);
            let seen = self.patches[n].seen;
            let place = self.view(&left, seen).climb(self.patches[n].point);
            let share = (place.arrivals + 2.0 * SEEN) / (self.profiles.len() as f64 + 2.0);
            let seen = share.clamp(SEEN_RANGE[0], SEEN_RANGE[1]);
            let step = (place.point - self.patches[n].point).norm() / self.sd_m;
            moved = moved.max(step);
            match self.hidden(place, seen) {
                Some(hidden) => self.patches[n] = hidden,
                None => self.patches[n].evidence = f64::NEG_INFINITY,
            }
            if step > FAR {
                // Else others that compete for the same arrivals would all follow.
                self.settle();
            }
        }
        self.settle();
        moved
    }

    /// Climbs all patches again, each with what the others leave, and drops those without evidence, the least first.
    fn polish(&mut self) {
        for _ in 0..POLISH + self.patches.len() {
            let moved = self.climb_all();
            let worst =
                (0..self.patches.len()).min_by(|&a, &b| self.patches[a].evidence.total_cmp(&self.patches[b].evidence));
            if let Some(worst) = worst.filter(|&worst| !self.is_sure(&self.patches[worst])) {
                self.patches.remove(worst);
                self.settle();
            } else if moved < 1e-3 {
                break;
            }
        }
    }
}

#[cfg(test)]
mod tests;
