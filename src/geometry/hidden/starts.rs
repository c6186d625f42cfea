//! Where one more hidden patch may be.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::climb::{Estimate, GATE};
use super::explanation::{Claims, Explanation};
use super::plane_seeds;
use super::search::{self, Curve, Legs};
use super::seeds::{self, Lengths, Seed};
use super::surface::Surface;
use super::{Profile, SEEN, Way, blend, watched_count};
use crate::Point;

/// Values of curves per standard deviation.
const PER_SD: f64 = 3.0;
/// Cubes are cut until a path over them varies by this many standard deviations to either side.
const FINE: f64 = 2.0;
/// Share of what a sure patch needs that a cube must promise to be cut, and most climbs of a search.
const PROMISING: f64 = 0.6;
const CLIMBS: usize = 400;
/// Bases whose arrivals are crossed at a time.
const BASES: usize = 4;
/// Starts are sought over seen patches whose profiles have this share of the unexplained arrivals of the richest ones.
const SHOWS: f64 = 0.5;
/// An arrival is unexplained if the probabilities of paths leave more than this of it.
const UNEXPLAINED: f64 = 0.5;
/// Reciprocal arrivals nearer than this many standard deviations are one.
const TOGETHER_SD: f64 = 2.5;
/// Lengths over two foci that most profiles repeat, at most.
const TOPS: usize = 16;
/// Places nearer than this many standard deviations of a length are one.
const APART: f64 = 1.0;

impl Explanation<'_> {
    /// Middles of cubes where the likelihood may be high enough, those of one top thinned out.
    pub(super) fn cubes(&self) -> Vec<(Surface, Point)> {
        let legs = self.legs(self.left());
        let cancel = &self.room.cancel;
        let least = PROMISING * self.least_likelihood();
        let cubes = search::search(&self.room.foci, &legs, &self.domain, 0.5 * FINE * self.sd_m, least as f32, cancel);
        self.thinned(Surface::Patch, cubes.into_iter().map(|(centre, _)| centre))
    }

    /// Patches that minimal sets of arrivals agree on.
    pub(super) fn seeds(&self, claims: Claims) -> Vec<(Surface, Point)> {
        let foci = &self.room.foci;
        let pairs = if self.is_layered() { self.repeated() } else { self.unexplained(claims) };
        let bases = seeds::bases(foci, &pairs, &self.domain, BASES);
        let seeds = bases.iter().flat_map(|base| seeds::seeds(foci, &pairs, base, &self.domain, &self.room.cancel));
        self.best(Surface::Patch, seeds.collect())
    }

    /// Planes that minimal sets of arrivals agree on; none between hidden patches.
    pub(super) fn plane_seeds(&self, claims: Claims) -> Vec<(Surface, Point)> {
        if self.is_layered() {
            return Vec::new();
        }
        let seeds = plane_seeds::seeds(&self.room.foci, &self.unexplained(claims), &self.domain, &self.room.cancel);
        self.best(self.plane(), seeds)
    }

    fn best(&self, surface: Surface, mut seeds: Vec<Seed>) -> Vec<(Surface, Point)> {
        seeds.sort_by(|a, b| b.likelihood.total_cmp(&a.likelihood));
        self.thinned(surface, seeds.into_iter().map(|seed| seed.point))
    }

    /// Arrivals that paths leave, profiles of the same two patches together: two within their errors are one.
    fn unexplained(&self, claims: Claims) -> Vec<Lengths> {
        type OfPair = (usize, [f64; 2], Vec<(f64, f64)>, Vec<f64>);
        let mut pairs: BTreeMap<[usize; 2], OfPair> = BTreeMap::new();
        let left = self.left_of(claims);
        let shows = self.shows(&left);
        for (profile, left) in self.profiles.iter().zip(left).filter(|(profile, _)| shows[profile.watched]) {
            let (profiles, span_m, lengths_m, claimed_m) =
                pairs.entry(profile.ways[0].foci).or_insert_with(|| (0, profile.span_m, Vec::new(), Vec::new()));
            *profiles += 1;
            *span_m = [span_m[0].max(profile.span_m[0]), span_m[1].min(profile.span_m[1])];
            let (free, claimed): (Vec<_>, Vec<_>) =
                profile.arrivals.iter().zip(left).partition(|(_, left)| *left > UNEXPLAINED);
            lengths_m.extend(free.iter().map(|(arrival, _)| (arrival.length_m, arrival.sd_m)));
            claimed_m.extend(claimed.iter().map(|(arrival, _)| arrival.length_m));
        }
        let of_pair = |(foci, (profiles, span_m, mut lengths_m, mut claimed_m)): ([usize; 2], OfPair)| {
            claimed_m.sort_by(f64::total_cmp);
            lengths_m.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut merged: Vec<(f64, f64)> = Vec::new();
            let mut is_single = false;
            for next in lengths_m {
                let near = |last: &&mut (f64, f64)| is_single && next.0 - last.0 < TOGETHER_SD * last.1.hypot(next.1);
                if let Some(last) = merged.last_mut().filter(near) {
                    let weights = (last.1.powi(-2), next.1.powi(-2));
                    let sum = weights.0 + weights.1;
                    *last = ((last.0 * weights.0 + next.0 * weights.1) / sum, sum.sqrt().recip());
                    is_single = false;
                } else {
                    merged.push(next);
                    is_single = true;
                }
            }
            let seen = 1.0 - (1.0 - SEEN).powi(profiles as i32);
            let density_per_m = (merged.len() + 1) as f64 / (2.0 * self.domain.half_m);
            Lengths { foci, values_m: merged, claimed_m, blend_m: self.room.blend_m, span_m, density_per_m, seen }
        };
        pairs.into_iter().map(of_pair).collect()
    }

    /// Seen patches over which starts are sought. Those over which little is unexplained say nothing of where a patch
    /// is, and many of them would only say that there is none. What shows over them alone is sought when the others are
    /// explained.
    fn shows(&self, left: &[Vec<f64>]) -> Vec<bool> {
        let mut of_seen = vec![[0.0, f64::MIN_POSITIVE]; watched_count(&self.profiles)];
        for (profile, left) in self.profiles.iter().zip(left) {
            let [unexplained, profiles] = &mut of_seen[profile.watched];
            *unexplained += left.iter().filter(|left| **left > UNEXPLAINED).count() as f64;
            *profiles += 1.0;
        }
        let shares: Vec<f64> = of_seen.iter().map(|[unexplained, profiles]| unexplained / profiles).collect();
        let most = shares.iter().copied().fold(0.0, f64::max);
        // Where a patch shows over all alike, those without it count too.
        shares.into_iter().map(|share| self.shown >= 1.0 || share >= SHOWS * most).collect()
    }

    /// Lengths over the same two foci that most profiles repeat.
    fn repeated(&self) -> Vec<Lengths> {
        let left = self.left();
        let of_foci = |(foci, ways): ([usize; 2], Vec<(usize, Way)>)| {
            let Curve { low_m, step_m, values } = self.curve(&ways, left, 0.0);
            let apart = (TOGETHER_SD * PER_SD) as usize;
            let is_top = |&k: &usize| {
                let near = &values[k.saturating_sub(apart)..(k + apart + 1).min(values.len())];
                values[k] > 0.0 && near.iter().all(|other| *other <= values[k])
            };
            let mut tops: Vec<usize> = (0..values.len()).filter(is_top).collect();
            tops.sort_by(|&a, &b| values[b].total_cmp(&values[a]));
            tops.truncate(TOPS);
            tops.sort_unstable();
            let way_m2 = ways.iter().map(|(_, way)| way.sd_m * way.sd_m).sum::<f64>() / ways.len() as f64;
            let sd_m = (self.sd_m * self.sd_m + way_m2).sqrt();
            Lengths {
                foci,
                values_m: tops.iter().map(|&k| (low_m + k as f64 * step_m, sd_m)).collect(),
                claimed_m: Vec::new(),
                blend_m: 0.0,
                span_m: [0.0, 2.0 * self.domain.half_m],
                density_per_m: (tops.len() + 1) as f64 / (2.0 * self.domain.half_m),
                seen: SEEN,
            }
        };
        self.of_foci(|_| true).into_par_iter().map(of_foci).collect()
    }

    /// The first [`CLIMBS`] places, none near an earlier one.
    fn thinned(&self, surface: Surface, places: impl Iterator<Item = Point>) -> Vec<(Surface, Point)> {
        let mut kept: Vec<Point> = Vec::new();
        for place in places {
            self.room.cancel.check();
            if kept.len() < CLIMBS && kept.iter().all(|other| (other - place).norm() > FINE * self.sd_m) {
                kept.push(place);
            }
        }
        kept.into_iter().map(|point| (surface, point)).collect()
    }

    /// Tops of the likelihood near some starts, the highest first.
    pub(super) fn tops(&self, starts: &[(Surface, Point)]) -> Vec<Estimate> {
        let left = self.left();
        let climb = |(surface, point): &(Surface, Point)| self.view(*surface, left, SEEN).climb(*point);
        let mut climbed: Vec<Estimate> = starts.par_iter().map(climb).collect();
        climbed.sort_by(|a, b| b.likelihood.total_cmp(&a.likelihood));
        let mut places: Vec<Estimate> = Vec::new();
        for place in climbed {
            let is_one = |other: &Estimate| {
                other.surface == place.surface && (other.point - place.point).norm() <= APART * self.sd_m
            };
            if !places.iter().any(is_one) {
                places.push(place);
            }
        }
        places
    }

    /// What each length is worth to one more patch, ways over the same two foci together.
    pub(super) fn legs(&self, left: &[Vec<f64>]) -> Vec<Legs> {
        let missed = (1.0 - SEEN).ln() as f32;
        let shows = self.shows(left);
        let legs = |(foci, ways): ([usize; 2], Vec<(usize, Way)>)| Legs {
            foci,
            profiles: ways.len(),
            curve: self.curve(&ways, left, missed),
        };
        self.of_foci(|profile| shows[profile.watched]).into_par_iter().map(legs).collect()
    }

    /// Ways of some profiles over the same two foci, each with its profile.
    fn of_foci(&self, counts: impl Fn(&Profile) -> bool) -> Vec<([usize; 2], Vec<(usize, Way)>)> {
        let mut of_foci: BTreeMap<[usize; 2], Vec<(usize, Way)>> = BTreeMap::new();
        for (n, profile) in self.profiles.iter().enumerate().filter(|(_, profile)| counts(profile)) {
            profile.ways.iter().for_each(|way| of_foci.entry(way.foci).or_default().push((n, *way)));
        }
        of_foci.into_iter().collect()
    }

    /// What the length of both legs is worth on some ways of profiles together, `missed` on each that makes no arrival.
    fn curve(&self, ways: &[(usize, Way)], left: &[Vec<f64>], missed: f32) -> Curve {
        let step_m = self.sd_m / PER_SD;
        let count = (2.0 * self.domain.half_m / step_m).ceil() as usize + 1;
        let mut values = vec![0.0_f32; count];
        let (mut sums, mut odds) = (vec![0.0_f64; count], vec![0.0_f64; count]);
        let bin = |length_m: f64| ((length_m / step_m).max(0.0) as usize).min(count - 1);
        for &(profile, way) in ways {
            self.room.cancel.check();
            let (of, left) = (&self.profiles[profile], &left[profile]);
            let [low_m, high_m] = of.span_m.map(|end_m| end_m - way.offset_m);
            if high_m < 0.0 {
                continue;
            }
            let (first, last) = (bin(low_m), bin(high_m));
            odds[first..=last].fill(SEEN / (1.0 - SEEN));
            if missed != 0.0 && self.room.blend_m > 0.0 {
                let hidden =
                    blend::hidden_along(&of.arrivals, left, way.offset_m, step_m, first..=last, self.room.blend_m);
                for (k, hidden) in (first..=last).zip(hidden) {
                    let seen = SEEN * (1.0 - hidden);
                    values[k] += (1.0 - seen).ln() as f32;
                    // What others may hide is as little expected where an arrival is.
                    odds[k] = seen / (1.0 - seen);
                }
            } else {
                values[first..=last].iter_mut().for_each(|value| *value += missed);
            }
            let mut near = Vec::new();
            for (arrival, left) in of.arrivals.iter().zip(left) {
                let (length_m, sd_m) = (arrival.length_m - way.offset_m, way.sd_m(arrival.sd_m));
                let scale = left / ((2.0 * std::f64::consts::PI).sqrt() * sd_m * self.clutter_per_m);
                let reach_m = GATE * sd_m;
                let bins = bin(length_m - reach_m).max(first)..=bin(length_m + reach_m).min(last);
                for k in bins.clone() {
                    let off = (k as f64 * step_m - length_m) / sd_m;
                    sums[k] += scale * (-0.5 * off * off).exp();
                }
                near.push(bins);
            }
            // Each bin once, however many arrivals are near.
            for k in near.into_iter().flatten() {
                values[k] += (odds[k] * std::mem::take(&mut sums[k])).ln_1p() as f32;
            }
        }
        Curve { low_m: 0.0, step_m, values }
    }
}
