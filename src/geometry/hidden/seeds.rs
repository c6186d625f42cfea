//! Places that a few arrivals agree on, from minimal sets.
//!
//! Three lengths over paths that share a focus meet in two points at most, in closed form; in flatland two do. Every
//! such set of arrivals of three pairs of foci, the *base*, is a seed. It is tested against further pairs one by one,
//! in the order in which the base predicts them best. First come those among the foci of the base itself. For a base
//! (i,i), (i,j), (i,k) these test `s_ij = (s_ii + s_jj) / 2` of one patch in (i,i), (i,j), (j,j); for disjoint sets of
//! lit and seen they test `s_ij + s_kl = s_il + s_kj`. An arrival near enough, by the seed's own covariance, moves the
//! seed as in a Kalman filter. Seeds whose log-likelihood ratio falls behind are given up.
//!
//! The cost grows with the third power of the arrivals of a profile and is independent of noise; a patch is missed
//! where its base misses an arrival, which another base or `search` makes good.

use nalgebra::{Matrix3, Vector3, Vector4};
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::search::Domain;
use super::surface::{Surface, covariance};
use super::{Focus, blend};
use crate::Point;
use crate::multilateration::meet;

/// Arrivals further than this many standard deviations from where a seed has them are others.
const GATE: f64 = 3.5;
/// Log-likelihood ratio below which a seed is given up, and which it needs in the end.
const GIVEN_UP: f64 = -4.0;
const KEPT: f64 = 3.0;
/// Pairs of foci that seeds are held against, and at most how many foci take part in bases.
const CHECKS: usize = 16;
const BASE_FOCI: usize = 16;

/// Arrivals between two foci, in order of length.
#[derive(Clone, Debug, PartialEq)]
pub struct Lengths {
    /// Positions of both among the foci, the smaller first.
    pub foci: [usize; 2],
    /// Each with its standard deviation.
    pub values_m: Vec<(f64, f64)>,
    /// Lengths of arrivals that other paths claim, and how near these may hide one, as in [`super::Room`].
    pub claimed_m: Vec<f64>,
    /// See there.
    pub blend_m: f64,
    /// Lengths that the records hold.
    pub span_m: [f64; 2],
    /// Arrivals per metre.
    pub density_per_m: f64,
    /// Probability that a patch makes an arrival.
    pub seen: f64,
}

/// Sets of pairs of foci whose arrivals are crossed, the best determined first.
#[must_use]
pub fn bases(foci: &[Focus], pairs: &[Lengths], domain: &Domain, most: usize) -> Vec<Vec<usize>> {
    let arity = domain.dimensions;
    let typical = typical_points(foci, domain);
    let step = pairs.iter().map(|pair| pair.foci[1] + 1).max().unwrap_or(0).div_ceil(BASE_FOCI).max(1);
    let mut scored: Vec<(f64, Vec<usize>)> = Vec::new();
    for focus in (0..foci.len()).step_by(step) {
        let about: Vec<usize> = (0..pairs.len())
            .filter(|&pair| pairs[pair].foci.contains(&focus) && !pairs[pair].values_m.is_empty())
            .filter(|&pair| pairs[pair].foci.iter().all(|other| other % step == 0))
            .collect();
        for (i, &a) in about.iter().enumerate() {
            for (k, &b) in about[..i].iter().enumerate() {
                if arity == 2 {
                    scored.push((spread(foci, pairs, &[a, b], &typical, arity), vec![a, b]));
                    continue;
                }
                for &c in &about[..k] {
                    scored.push((spread(foci, pairs, &[a, b, c], &typical, arity), vec![a, b, c]));
                }
            }
        }
    }
    scored.sort_by(|x, y| x.0.total_cmp(&y.0).then_with(|| x.1.cmp(&y.1)));
    // Bases that share no pair miss arrivals independently.
    let mut kept: Vec<Vec<usize>> = Vec::new();
    for (spread, base) in scored {
        if kept.len() < most && spread.is_finite() && kept.iter().flatten().all(|pair| !base.contains(pair)) {
            kept.push(base);
        }
    }
    kept
}

/// Points that stand for where patches may be.
fn typical_points(foci: &[Focus], domain: &Domain) -> Vec<Point> {
    let reach_m = foci.iter().map(|focus| (focus.point - domain.centre).norm()).fold(0.0, f64::max);
    let z = if domain.dimensions == 2 { [0.0].as_slice() } else { [-1.0, 0.0, 1.0].as_slice() };
    let corners = [-1.0, 0.0, 1.0]
        .into_iter()
        .flat_map(|x| [-1.0, 0.0, 1.0].into_iter().flat_map(move |y| z.iter().map(move |z| (x, y, *z))));
    let all: Vec<Point> = corners.map(|(x, y, z)| domain.centre + Vector3::new(x, y, z) * reach_m).collect();
    let is_seen = |point: &Point| 2 * foci.iter().filter(|focus| focus.faces(*point, 0.0)).count() > foci.len();
    let inside: Vec<Point> = all.iter().copied().filter(is_seen).collect();
    if inside.is_empty() { all } else { inside }
}

fn slope(foci: &[Focus], pair: &Lengths, at: Point) -> Vector3<f64> {
    pair.foci.iter().map(|focus| (at - foci[*focus].point).try_normalize(1e-9).unwrap_or_else(Vector3::zeros)).sum()
}

/// Median over typical points of the error that a base leaves, per error of a length.
fn spread(foci: &[Focus], pairs: &[Lengths], base: &[usize], typical: &[Point], dimensions: usize) -> f64 {
    let mut errors: Vec<f64> = typical
        .iter()
        .map(|at| {
            covariance(base.iter().map(|&pair| slope(foci, &pairs[pair], *at)), 1.0, dimensions)
                .map_or(f64::INFINITY, |c| c.trace())
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

/// A place and what speaks for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seed {
    /// Position.
    pub point: Point,
    /// Log-likelihood ratio of the pairs that it was held against.
    pub likelihood: f64,
}

/// Places that the arrivals of a base and those of further pairs agree on, in no order of merit.
#[must_use]
pub fn seeds(foci: &[Focus], pairs: &[Lengths], base: &[usize], domain: &Domain, cancel: &Cancel) -> Vec<Seed> {
    let order = checks(foci, pairs, base, domain);
    let shared = |focus: &usize| base.iter().all(|&pair| pairs[pair].foci.contains(focus));
    let Some(focus) = pairs[base[0]].foci.into_iter().find(shared) else { return Vec::new() };
    let rows: Vec<Vec<(Vector4<f64>, f64)>> = base.iter().map(|&pair| conditions(foci, &pairs[pair], focus)).collect();
    let is_in_front =
        |at: Point| base.iter().flat_map(|&pair| pairs[pair].foci).all(|focus| foci[focus].faces(at, 0.0));
    let flat = vec![(Vector4::z(), 0.0)];
    let (first, second, third) = (&rows[0], &rows[1], rows.get(2).unwrap_or(&flat));
    let variance_m2 = base.iter().map(|&pair| pairs[pair].values_m[0].1.powi(2)).sum::<f64>() / base.len() as f64;
    let from_first = |a: &(Vector4<f64>, f64)| {
        let mut seeds = Vec::new();
        for b in second {
            cancel.check();
            for c in third {
                for arm in meet([*a, *b, *c]).into_iter().flatten() {
                    let at = foci[focus].point + arm;
                    if domain.holds(at, 0.0) && is_in_front(at) {
                        let slopes = base.iter().map(|&pair| slope(foci, &pairs[pair], at));
                        let covariance = covariance(slopes, variance_m2, domain.dimensions);
                        seeds.extend(
                            covariance
                                .and_then(|covariance| follow(&Surface::Patch, foci, pairs, &order, at, covariance)),
                        );
                    }
                }
            }
        }
        seeds
    };
    first.par_iter().flat_map_iter(from_first).collect()
}

/// Conditions of a pair's lengths in (x, |x|), x from `focus`, one of the pair's.
fn conditions(foci: &[Focus], pair: &Lengths, focus: usize) -> Vec<(Vector4<f64>, f64)> {
    let [a, b] = pair.foci;
    let to_other = foci[if a == focus { b } else { a }].point - foci[focus].point;
    pair.values_m.iter().map(|(length_m, _)| ellipsoid(to_other, *length_m)).collect()
}

/// The condition in (x, |x|) that puts x = q - a on an ellipsoid with foci a and a + `to_other`.
fn ellipsoid(to_other: Vector3<f64>, length_m: f64) -> (Vector4<f64>, f64) {
    let (row, right) = if to_other.norm_squared() == 0.0 {
        (Vector4::w(), 0.5 * length_m)
    } else {
        let row = Vector4::new(to_other.x, to_other.y, to_other.z, -length_m);
        (row, 0.5 * (to_other.norm_squared() - length_m * length_m))
    };
    (row / row.norm(), right / row.norm())
}

/// Pairs outside of a base, the best predicted first.
fn checks(foci: &[Focus], pairs: &[Lengths], base: &[usize], domain: &Domain) -> Vec<usize> {
    let typical = typical_points(foci, domain);
    let mut sampled: Vec<(Point, Matrix3<f64>)> = typical
        .into_iter()
        .filter_map(|at| {
            Some((at, covariance(base.iter().map(|&pair| slope(foci, &pairs[pair], at)), 1.0, domain.dimensions)?))
        })
        .collect();
    let mut rest: Vec<usize> = (0..pairs.len()).filter(|pair| !base.contains(pair)).collect();
    let mut order = Vec::new();
    while order.len() < CHECKS && !rest.is_empty() {
        let error = |&pair: &usize| {
            let mut errors: Vec<f64> = sampled
                .iter()
                .map(|(at, c)| {
                    let g = slope(foci, &pairs[pair], *at);
                    g.dot(&(c * g))
                })
                .collect();
            errors.sort_by(f64::total_cmp);
            errors.get(errors.len() / 2).copied().unwrap_or(0.0)
        };
        let errors: Vec<f64> = rest.iter().map(error).collect();
        let best = (0..rest.len()).min_by(|&a, &b| errors[a].total_cmp(&errors[b])).expect("there are some left");
        let pair = rest.swap_remove(best);
        for (at, covariance) in &mut sampled {
            let g = slope(foci, &pairs[pair], *at);
            let gain = *covariance * g / (1.0 + g.dot(&(*covariance * g)));
            *covariance -= gain * (g.transpose() * *covariance);
        }
        order.push(pair);
    }
    order
}

/// Holds a seed against further pairs.
pub(super) fn follow(
    surface: &Surface,
    foci: &[Focus],
    pairs: &[Lengths],
    order: &[usize],
    at: Point,
    covariance: Matrix3<f64>,
) -> Option<Seed> {
    let (mut point, mut covariance, mut likelihood) = (at, covariance, 0.0);
    for &pair in order {
        let Lengths { foci: ends, values_m, claimed_m, blend_m, span_m, density_per_m, seen } = &pairs[pair];
        let way = surface.way(ends.map(|focus| &foci[focus]), point);
        let is_recorded = |way: &(f64, Vector3<f64>)| (span_m[0]..=span_m[1]).contains(&way.0);
        let Some((length_m, slope)) = way.filter(is_recorded) else { continue };
        let seen = seen * (1.0 - blend::hidden_by(claimed_m, length_m, *blend_m));
        let spread = covariance * slope;
        let own_m2 = slope.dot(&spread);
        let next = values_m.partition_point(|(other, _)| *other < length_m);
        let nearest = values_m[next.saturating_sub(1)..(next + 1).min(values_m.len())]
            .iter()
            .min_by(|x, y| (x.0 - length_m).abs().total_cmp(&(y.0 - length_m).abs()));
        let hit = nearest
            .map(|(other, sd_m)| (other - length_m, own_m2 + sd_m * sd_m))
            .filter(|(off_m, m2)| off_m * off_m < GATE * GATE * m2);
        if let Some((off_m, variance_m2)) = hit {
            let density =
                (-0.5 * off_m * off_m / variance_m2).exp() / (2.0 * std::f64::consts::PI * variance_m2).sqrt();
            likelihood += (1.0 - seen + seen * density / density_per_m).ln();
            point += spread * (off_m / variance_m2);
            covariance -= spread * spread.transpose() / variance_m2;
        } else {
            likelihood += (1.0 - seen).ln();
        }
        if likelihood < GIVEN_UP {
            return None;
        }
    }
    (likelihood > KEPT).then_some(Seed { point, likelihood })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without noise and without rivals, some seed of every base is the patch.
    #[test]
    fn every_base_leads_to_the_patch() {
        for dimensions in [2, 3] {
            let z = |height_m: f64| if dimensions == 2 { 0.0 } else { height_m };
            let foci = [(0.0, 0.3, 0.2), (0.1, 1.2, -0.4), (0.7, 0.0, 0.5), (1.4, 0.1, -0.1), (0.4, 0.2, -0.6)];
            let focus = |(x, y, height_m)| Focus { point: Point::new(x, y, z(height_m)), normal: None };
            let foci: Vec<Focus> = foci.into_iter().map(focus).collect();
            let patch = Point::new(1.3, 1.1, z(0.2));
            let domain = Domain { centre: Point::new(0.7, 0.7, 0.0), half_m: 2.0, dimensions };
            // No pair of a focus with itself.
            let pairs = (0..foci.len()).flat_map(|b| (0..b).map(move |a| [a, b]));
            let lengths = |[a, b]: [usize; 2]| Lengths {
                foci: [a, b],
                claimed_m: Vec::new(),
                blend_m: 0.0,
                values_m: vec![((patch - foci[a].point).norm() + (patch - foci[b].point).norm(), 1e-3)],
                span_m: [0.0, 10.0],
                density_per_m: 0.3,
                seen: 0.9,
            };
            let pairs: Vec<Lengths> = pairs.map(lengths).collect();
            let bases = bases(&foci, &pairs, &domain, 3);
            assert!(bases.len() > 1 && bases.iter().all(|base| base.len() == dimensions), "{bases:?}");
            for base in &bases {
                let seeds = seeds(&foci, &pairs, base, &domain, &Cancel::never());
                assert!(seeds.iter().any(|seed| (seed.point - patch).norm() < 1e-6), "{base:?} {seeds:?}");
            }
        }
    }
}
