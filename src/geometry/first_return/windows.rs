//! Which neighbours a field is fitted to.

use std::f64::consts::FRAC_PI_4;

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::field::{Field, Sample, frame};
use super::{Scan, SurfacePoint};
use crate::Point;

/// Places of a window, and the most that are neighbours: half of a window lies on one side.
const SIZES: [usize; 7] = [13, 21, 34, 55, 88, 140, 225];
pub const MOST: usize = 2 * SIZES[SIZES.len() - 1];
/// Windows on one side.
const SIDES: usize = 8;
/// Cube-root score of chi-square (nearly a standard normal): beyond it a window has no field, sides are tried, it
/// grows no more.
const NO_FIELD: f64 = 3.0;
const TRY_SIDES: f64 = 1.5;
const NO_GROWTH: f64 = 2.0;
/// By how much a side must be better.
const BETTER: f64 = 0.5;
/// Standard deviations, squared, within which a place follows the field, and a point that of a smaller window.
const FOLLOWS: f64 = 9.0;
const AGREES: f64 = 20.0;
/// Places next to so many that do not follow are left out too, next being within this many distances of neighbours.
const LOST: usize = 3;
const NEXT: f64 = 1.6;
/// Least share of a window that follows.
const ENOUGH: f64 = 0.6;
/// Share of differences between windows that is bias.
const BIAS: f64 = 1.5;

/// The nearest points of each, itself first.
pub fn neighbours(points: &[Point], most: usize, cancel: &Cancel) -> Vec<Vec<u32>> {
    // Along the longest axis, neighbours lie within a run.
    let axis = (0..3).max_by(|a, b| extent(points, *a).total_cmp(&extent(points, *b))).unwrap_or(0);
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.sort_by(|a, b| points[*a as usize][axis].total_cmp(&points[*b as usize][axis]).then(a.cmp(b)));
    let nearer = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    let of_run = |run: usize| {
        let here = points[order[run] as usize];
        let mut list: Vec<(f64, u32)> = Vec::with_capacity(2 * most + 2);
        let mut reach_m2 = f64::INFINITY;
        let [mut before, mut after] = [run.checked_sub(1), Some(run)];
        while before.is_some() || after.is_some() {
            for (next, step) in [(&mut before, usize::MAX), (&mut after, 1)] {
                let Some(other) = next.and_then(|n| order.get(n)) else {
                    *next = None;
                    continue;
                };
                let apart = points[*other as usize] - here;
                let is_within = apart[axis] * apart[axis] <= reach_m2;
                if apart.norm_squared() <= reach_m2 {
                    list.push((apart.norm_squared(), *other));
                }
                // The end of the order ends a side too: `usize::MAX` more is one less.
                *next = next.filter(|n| is_within && (*n > 0 || step == 1)).map(|n| n.wrapping_add(step));
            }
            if list.len() > 2 * most {
                list.select_nth_unstable_by(most - 1, nearer);
                list.truncate(most);
                reach_m2 = list[most - 1].0;
            }
        }
        list.sort_unstable_by(nearer);
        list.truncate(most);
        list.into_iter().map(|one| one.1).collect::<Vec<u32>>()
    };
    let mut all = vec![Vec::new(); points.len()];
    let runs = (0..points.len()).into_par_iter().map(|run| {
        cancel.check();
        of_run(run)
    });
    for (run, list) in runs.collect::<Vec<_>>().into_iter().enumerate() {
        all[order[run] as usize] = list;
    }
    all
}

fn extent(points: &[Point], axis: usize) -> f64 {
    let ends = points
        .iter()
        .map(|point| point[axis])
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], x| [least.min(x), most.max(x)]);
    ends[1] - ends[0]
}

/// A field, and what other windows say otherwise of its point and its normal.
pub struct Chosen {
    pub field: Field,
    lit: Option<Point>,
    bias: [Matrix3<f64>; 2],
}

/// The field of each place; `None` where its neighbours do not follow one.
pub fn fields(scan: &Scan, samples: &[Sample], near: &[Vec<u32>], cancel: &Cancel) -> Vec<Option<Chosen>> {
    let of_place = |n: usize| {
        cancel.check();
        let zone_m = scan.zone_m(samples[n].length_m * if scan.lit.is_some() { 0.5 } else { 1.0 });
        Growth { scan, samples, near: &near[n], zone_m }.chosen()
    };
    (0..samples.len()).into_par_iter().map(of_place).collect()
}

/// Windows about one place, the first of its neighbours.
struct Growth<'a> {
    scan: &'a Scan,
    samples: &'a [Sample],
    near: &'a [u32],
    zone_m: f64,
}

impl Growth<'_> {
    fn at(&self, n: u32) -> &Sample {
        &self.samples[n as usize]
    }

    /// The nearest on a side; side 0 is all around.
    fn nearest(&self, side: usize, size: usize) -> Vec<u32> {
        let here = self.at(self.near[0]).at;
        let [x, y] = frame(&self.scan.inwards);
        let angle = (side as f64 - 1.0) * FRAC_PI_4;
        let towards = x * angle.cos() + y * angle.sin();
        let is_there = |n: &u32| side == 0 || towards.dot(&(self.at(*n).at - here)) > -1e-9;
        self.near.iter().copied().filter(is_there).take(size).collect()
    }

    fn start(&self, side: usize) -> Option<Field> {
        let members = self.nearest(side, SIZES[0]);
        if members.len() < SIZES[0] {
            return None;
        }
        Field::new(self.at(self.near[0]), -self.scan.inwards).fit(self.samples, &members, self.zone_m)
    }

    /// The smallest window, all around or on the side where one field explains it best.
    fn smallest(&self) -> Option<(usize, Field)> {
        let mut best = self.start(0).map(|field| (0, field));
        if best.as_ref().is_none_or(|(_, field)| score(field) > TRY_SIDES) {
            for side in 1..=SIDES {
                let Some(field) = self.start(side) else { continue };
                if best.as_ref().is_none_or(|(_, best)| score(&field) < score(best) - BETTER) {
                    best = Some((side, field));
                }
            }
        }
        best.filter(|(_, field)| score(field) <= NO_FIELD)
    }

    /// Those of a larger window that follow the field, and do not lie among others that do not.
    fn followers(&self, field: &Field, window: &[u32]) -> Vec<u32> {
        let covariance = field.noise + field.law;
        let follows = |n: &u32| {
            let sample = self.at(*n);
            let (length_m, slopes) = field.length(&sample.at);
            let variance = slopes.dot(&(covariance * slopes)) + sample.sd_m.powi(2) + sample.law_m.powi(2);
            (sample.length_m - length_m).powi(2) < FOLLOWS * variance
        };
        let (followers, lost): (Vec<u32>, Vec<u32>) = window.iter().partition(|n| follows(n));
        let next_m2 = NEXT * NEXT * (self.at(self.near[1]).at - self.at(self.near[0]).at).norm_squared();
        let is_inside = |n: &u32| {
            let is_next = |other: &&u32| (self.at(**other).at - self.at(*n).at).norm_squared() < next_m2;
            lost.iter().filter(is_next).take(LOST).count() < LOST
        };
        followers.into_iter().filter(is_inside).collect()
    }

    /// Whether a larger window says what the smaller ones said.
    fn agrees(&self, smaller: &[Field], field: &Field) -> bool {
        let lit = self.scan.lit.as_ref();
        let (point, _) = field.reading(lit);
        let [own, _] = field.covariances(lit, &field.noise);
        smaller.iter().all(|other| {
            let [noise, _] = other.covariances(lit, &other.noise);
            let [law, _] = other.covariances(lit, &other.law);
            // Windows share places: the smaller one is off the larger one by what it has more of noise.
            let covariance = noise * 1.1 - own + law * 1.1;
            let off = point - other.reading(lit).0;
            covariance.cholesky().is_none_or(|root| off.dot(&root.solve(&off)) < AGREES)
        })
    }

    fn chosen(&self) -> Option<Chosen> {
        let (side, smallest) = self.smallest()?;
        let mut windows = vec![smallest];
        let mut refused = None;
        for size in &SIZES[1..] {
            let last = &windows[windows.len() - 1];
            let window = self.nearest(side, *size);
            if window.len() < *size {
                break;
            }
            let members = self.followers(last, &window);
            if (members.len() as f64) < ENOUGH * *size as f64 {
                break;
            }
            if members.len() < last.count + 3 {
                continue;
            }
            let Some(field) = last.fit(self.samples, &members, self.zone_m) else { break };
            if score(&field) > NO_GROWTH || !self.agrees(&windows, &field) {
                refused = Some(field);
                break;
            }
            windows.push(field);
        }
        // One window less than would do: its bias is a fraction of its noise.
        let at = windows.len().saturating_sub(2);
        let larger = windows.get(at + 1).or(refused.as_ref());
        let others = at.checked_sub(1).map(|smaller| &windows[smaller]).into_iter().chain(larger);
        let lit = self.scan.lit;
        let (point, normal) = windows[at].reading(lit.as_ref());
        let mut bias = [Matrix3::zeros(); 2];
        for other in others {
            let (other_point, other_normal) = other.reading(lit.as_ref());
            let offs = [other_point - point, other_normal - normal];
            bias.iter_mut().zip(offs).for_each(|(bias, off): (_, Vector3<f64>)| *bias += off * off.transpose() * BIAS);
        }
        Some(Chosen { field: windows.swap_remove(at), lit, bias })
    }
}

impl Chosen {
    pub fn surface_point(&self, place: usize) -> SurfacePoint {
        let (field, lit) = (&self.field, self.lit.as_ref());
        let (point, normal) = field.reading(lit);
        let [own, own_normal] = field.covariances(lit, &(field.noise + field.law));
        let kind = field.kind(lit);
        let distance_m = field.distance_m(lit);
        let curvatures = field.bends(lit).map(|[bend, _]| bend / distance_m / (1.0 - bend));
        SurfacePoint {
            place,
            point,
            covariance_m2: own + self.bias[0],
            normal,
            normal_covariance: own_normal + self.bias[1],
            kind,
            curvatures_per_m: (kind == super::Kind::Smooth && lit.is_none()).then_some(curvatures),
            places: field.count,
            misfit: field.square / (field.count as f64 - 6.0).max(1.0),
        }
    }
}

/// Cube root of chi-square over its degrees of freedom, as a nearly standard normal score (Wilson and Hilferty).
fn score(field: &Field) -> f64 {
    let freedom = field.count as f64 - 6.0;
    let spread = 2.0 / (9.0 * freedom);
    ((field.square / freedom).cbrt() - (1.0 - spread)) / spread.sqrt()
}
