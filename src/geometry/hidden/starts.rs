//! Where one more hidden patch may be.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::SEEN;
use super::climb::{GATE, Place};
use super::explanation::Explanation;
use super::plane_seeds;
use super::search::{self, Curve, Legs};
use super::seeds::{self, Lengths, Seed};
use super::surface::Surface;
use crate::geometry::Point;

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

impl Explanation<'_> {
    /// Middles of cubes where the likelihood may be high enough, those of one top thinned out.
    pub(super) fn cubes(&self) -> Vec<(Surface, Point)> {
        let legs = self.legs(&self.left());
        let least = PROMISING * self.least_likelihood();
        let cubes = search::search(&self.room.foci, &legs, &self.domain, 0.5 * FINE * self.sd_m, least as f32);
        self.thinned(Surface::Patch, cubes.into_iter().map(|(centre, _)| centre))
    }

    /// Patches that minimal sets of arrivals agree on.
    pub(super) fn seeds(&self) -> Vec<(Surface, Point)> {
        let (foci, pairs) = (&self.room.foci, self.unexplained());
        let bases = seeds::bases(foci, &pairs, &self.domain, BASES);
        let seeds = bases.iter().flat_map(|base| seeds::seeds(foci, &pairs, base, &self.domain));
        self.best(Surface::Patch, seeds.collect())
    }

    /// Planes that minimal sets of arrivals agree on.
    pub(super) fn plane_seeds(&self) -> Vec<(Surface, Point)> {
        self.best(self.plane(), plane_seeds::seeds(&self.room.foci, &self.unexplained(), &self.domain))
    }

    fn best(&self, surface: Surface, mut seeds: Vec<Seed>) -> Vec<(Surface, Point)> {
        seeds.sort_by(|a, b| b.likelihood.total_cmp(&a.likelihood));
        self.thinned(surface, seeds.into_iter().map(|seed| seed.point))
    }

    /// Arrivals that paths leave, profiles of the same two patches together: two within their errors are one.
    fn unexplained(&self) -> Vec<Lengths> {
        type OfPair = (usize, [f64; 2], Vec<(f64, f64)>);
        let mut pairs: BTreeMap<[usize; 2], OfPair> = BTreeMap::new();
        for (profile, left) in self.profiles.iter().zip(self.left()) {
            let (profiles, span_m, lengths_m) =
                pairs.entry(profile.foci).or_insert_with(|| (0, profile.span_m, Vec::new()));
            *profiles += 1;
            *span_m = [span_m[0].max(profile.span_m[0]), span_m[1].min(profile.span_m[1])];
            let free = profile.arrivals.iter().zip(left).filter(|(_, left)| *left > UNEXPLAINED);
            lengths_m.extend(free.map(|(arrival, _)| (arrival.length_m, arrival.sd_m)));
        }
        let of_pair = |(foci, (profiles, span_m, mut lengths_m)): ([usize; 2], OfPair)| {
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
            Lengths { foci, values_m: merged, span_m, density_per_m, seen }
        };
        pairs.into_iter().map(of_pair).collect()
    }

    /// At most so many places, none near another that comes before it.
    fn thinned(&self, surface: Surface, places: impl Iterator<Item = Point>) -> Vec<(Surface, Point)> {
        let mut kept: Vec<Point> = Vec::new();
        for place in places {
            if kept.len() < CLIMBS && kept.iter().all(|other| (other - place).norm() > FINE * self.sd_m) {
                kept.push(place);
            }
        }
        kept.into_iter().map(|point| (surface, point)).collect()
    }

    /// Tops of the likelihood near some starts, the highest first.
    pub(super) fn tops(&self, starts: &[(Surface, Point)]) -> Vec<Place> {
        let left = self.left();
        let climb = |(surface, point): &(Surface, Point)| self.view(*surface, &left, SEEN).climb(*point);
        let mut climbed: Vec<Place> = starts.par_iter().map(climb).collect();
        climbed.sort_by(|a, b| b.likelihood.total_cmp(&a.likelihood));
        let mut places: Vec<Place> = Vec::new();
        for place in climbed {
            let is_one = |other: &Place| {
                other.surface == place.surface && (other.point - place.point).norm() <= APART * self.sd_m
            };
            if !places.iter().any(is_one) {
                places.push(place);
            }
        }
        places
    }

    /// What each length is worth to one more patch, profiles of the same two patches together.
    pub(super) fn legs(&self, left: &[Vec<f64>]) -> Vec<Legs> {
        let mut of_foci: BTreeMap<[usize; 2], Vec<usize>> = BTreeMap::new();
        for (n, profile) in self.profiles.iter().enumerate() {
            of_foci.entry(profile.foci).or_default().push(n);
        }
        let of_foci: Vec<_> = of_foci.into_iter().collect();
        of_foci
            .into_par_iter()
            .map(|(foci, profiles)| Legs { foci, profiles: profiles.len(), curve: self.curve(&profiles, left) })
            .collect()
    }

    /// What a length is worth in some profiles together.
    fn curve(&self, profiles: &[usize], left: &[Vec<f64>]) -> Curve {
        let step_m = self.sd_m / PER_SD;
        let count = (2.0 * self.domain.half_m / step_m).ceil() as usize + 1;
        let mut values = vec![0.0_f32; count];
        let mut sums = vec![0.0_f64; count];
        let bin = |length_m: f64| ((length_m / step_m).max(0.0) as usize).min(count - 1);
        for &profile in profiles {
            let (of, left) = (&self.profiles[profile], &left[profile]);
            let (first, last) = (bin(of.span_m[0]), bin(of.span_m[1]));
            let missed = (1.0 - SEEN).ln() as f32;
            values[first..=last].iter_mut().for_each(|value| *value += missed);
            let mut near = Vec::new();
            for (arrival, left) in of.arrivals.iter().zip(left) {
                let scale = SEEN / (1.0 - SEEN) * left
                    / ((2.0 * std::f64::consts::PI).sqrt() * arrival.sd_m * self.clutter_per_m);
                let reach_m = GATE * arrival.sd_m;
                let bins = bin(arrival.length_m - reach_m).max(first)..=bin(arrival.length_m + reach_m).min(last);
                for k in bins.clone() {
                    let off = (k as f64 * step_m - arrival.length_m) / arrival.sd_m;
                    sums[k] += scale * (-0.5 * off * off).exp();
                }
                near.push(bins);
            }
            // Each bin once, however many arrivals are near.
            for k in near.into_iter().flatten() {
                values[k] += std::mem::take(&mut sums[k]).ln_1p() as f32;
            }
        }
        Curve { low_m: 0.0, step_m, values }
    }
}
