//! Planes that a few arrivals agree on, in closed form.
//!
//! The way from a over a plane to b has `s^2 = |a - b|^2 + 4 h_a h_b` with their heights over the plane. Arrivals of
//! the three pairs among i, j, k give all three heights, `h_i^2 = g_ij g_ik / g_jk` with `g = (s^2 - d^2) / 4`, and
//! these two planes at most (in flatland lines); each is held against the three foci alone and against further pairs.
//! Where no three foci are lit and seen among one another, nothing is found.

use nalgebra::Vector3;
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::Focus;
use super::search::Domain;
use super::seeds::{Lengths, Seed, follow};
use super::surface::{Surface, covariance};
use crate::Point;

/// Triples of foci whose arrivals are crossed, and sets of three arrivals at most, beyond the first triple.
const TRIPLES: usize = 12;
const SETS: usize = 300_000;
/// Pairs that a seed is held against.
const CHECKS: usize = 16;
/// How much longer than 1 a normal may come out by noise.
const TOO_LONG: f64 = 0.05;

/// Planes that arrivals of a triple and of further pairs agree on; a plane's place is the foot of the perpendicular
/// from the middle of the domain.
pub fn seeds(foci: &[Focus], pairs: &[Lengths], domain: &Domain, cancel: &Cancel) -> Vec<Seed> {
    let position = |a: usize, b: usize| pairs.iter().position(|pair| pair.foci == [a.min(b), a.max(b)]);
    let mut sets = 0;
    let is_affordable = |triple: &[usize; 3]| {
        let is_first = sets == 0;
        let side = |pair: &&Lengths| pair.foci[0] != pair.foci[1] && pair.foci.iter().all(|f| triple.contains(f));
        sets += pairs.iter().filter(side).map(|pair| pair.values_m.len()).product::<usize>();
        is_first || sets <= SETS
    };
    let triples: Vec<[usize; 3]> = triples(foci, pairs, cancel).into_iter().take_while(is_affordable).collect();
    triples.into_iter().flat_map(|triple| of_triple(foci, pairs, triple, &position, domain, cancel)).collect()
}

/// Triangles whose three sides all have arrivals, the largest first; no two share a side.
fn triples(foci: &[Focus], pairs: &[Lengths], cancel: &Cancel) -> Vec<[usize; 3]> {
    let mut sides = vec![vec![false; foci.len()]; foci.len()];
    for Lengths { foci: [a, b], values_m, .. } in pairs {
        sides[*a][*b] = a != b && !values_m.is_empty();
    }
    let mut all: Vec<(f64, [usize; 3])> = Vec::new();
    for i in 0..foci.len() {
        cancel.check();
        for j in (i + 1..foci.len()).filter(|&j| sides[i][j]) {
            for k in (j + 1..foci.len()).filter(|&k| sides[i][k] && sides[j][k]) {
                let [a, b, c] = [i, j, k].map(|focus| foci[focus].point);
                all.push(((b - a).cross(&(c - a)).norm(), [i, j, k]));
            }
        }
    }
    all.sort_by(|x, y| y.0.total_cmp(&x.0).then_with(|| x.1.cmp(&y.1)));
    let mut kept: Vec<[usize; 3]> = Vec::new();
    for (_, triple) in all {
        let common = |other: &[usize; 3]| triple.iter().filter(|focus| other.contains(focus)).count();
        if kept.len() < TRIPLES && kept.iter().all(|other| common(other) < 2) {
            kept.push(triple);
        }
    }
    kept
}

fn of_triple(
    foci: &[Focus],
    pairs: &[Lengths],
    [i, j, k]: [usize; 3],
    position: &(impl Fn(usize, usize) -> Option<usize> + Sync),
    domain: &Domain,
    cancel: &Cancel,
) -> Vec<Seed> {
    let (Some(ij), Some(ik), Some(jk)) = (position(i, j), position(i, k), position(j, k)) else { return Vec::new() };
    // The triple's own pairs test a seed best, at least cost.
    let own = [i, j, k].into_iter().filter_map(|focus| position(focus, focus));
    let others = (0..pairs.len()).filter(|pair| ![ij, ik, jk].contains(pair));
    let mut order: Vec<usize> = own.collect();
    let others: Vec<usize> = others.filter(|pair| !order.contains(pair)).collect();
    order.extend(others.iter().step_by((others.len() / CHECKS).max(1)));
    let surface = Surface::Plane { middle: domain.centre };
    let [of_ij, of_ik, of_jk] = [ij, ik, jk].map(|pair| products_m2(foci, &pairs[pair]));
    let base = [ij, ik, jk];
    let variance_m2 = base.iter().map(|&pair| pairs[pair].values_m[0].1.powi(2)).sum::<f64>() / 3.0;
    let from_first = |&ij: &f64| {
        let mut seeds = Vec::new();
        for &ik in &of_ik {
            cancel.check();
            for &jk in &of_jk {
                let heights_m = [ij * ik / jk, ij * jk / ik, ik * jk / ij].map(f64::sqrt);
                // A product that is not positive gives no height.
                if !heights_m.iter().all(|height_m| *height_m > 0.0 && *height_m < 2.0 * domain.half_m) {
                    continue;
                }
                for at in planes([i, j, k].map(|focus| foci[focus].point), heights_m, domain).into_iter().flatten() {
                    let ways = || base.iter().filter_map(|&pair| surface.way(pairs[pair].foci.map(|f| &foci[f]), at));
                    let start = covariance(ways().map(|(_, slope)| slope), variance_m2, domain.dimensions);
                    seeds.extend(start.and_then(|start| follow(&surface, foci, pairs, &order, at, start)));
                }
            }
        }
        seeds
    };
    of_ij.par_iter().flat_map_iter(from_first).collect()
}

/// Product of the heights of both foci over a plane, by each length of a pair.
fn products_m2(foci: &[Focus], pair: &Lengths) -> Vec<f64> {
    let [a, b] = pair.foci.map(|focus| foci[focus].point);
    let product_m2 = |(length_m, _): &(f64, f64)| 0.25 * (length_m * length_m - (a - b).norm_squared());
    pair.values_m.iter().map(product_m2).collect()
}

/// Feet of the planes over which three points have some heights.
fn planes(points: [Point; 3], heights_m: [f64; 3], domain: &Domain) -> [Option<Point>; 2] {
    let (one, other) = (points[1] - points[0], points[2] - points[0]);
    let (rise, other_rise) = (heights_m[1] - heights_m[0], heights_m[2] - heights_m[0]);
    // Part of the normal within the span of both (in flatland along the first), and a unit vector at right angles.
    let (within, across) = if domain.dimensions == 2 {
        (one * (rise / one.norm_squared()), Vector3::new(-one.y, one.x, 0.0) / one.norm())
    } else {
        let across = one.cross(&other);
        let area2 = across.norm_squared();
        ((rise * other.cross(&across) + other_rise * across.cross(&one)) / area2, across / area2.sqrt())
    };
    let rest = 1.0 - within.norm_squared();
    if rest < -TOO_LONG {
        return [None; 2];
    }
    let foot = |sign: f64| {
        let normal = (within + sign * rest.max(0.0).sqrt() * across).normalize();
        let depth_m = heights_m[0] - normal.dot(&(points[0] - domain.centre));
        Some(domain.centre - depth_m * normal).filter(|at| depth_m > 0.0 && domain.holds(*at, 0.0))
    };
    [foot(1.0), foot(-1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without noise and without rivals, every triple leads to the plane.
    #[test]
    fn every_triple_leads_to_the_plane() {
        for dimensions in [2, 3] {
            let z = |height_m: f64| if dimensions == 2 { 0.0 } else { height_m };
            let foci = [(0.0, 0.3, 0.2), (0.1, 1.2, -0.4), (0.7, 0.0, 0.5), (1.4, 0.1, -0.1), (0.4, 0.2, -0.6)];
            let focus = |(x, y, height_m)| Focus { point: Point::new(x, y, z(height_m)), normal: None };
            let foci: Vec<Focus> = foci.into_iter().map(focus).collect();
            let domain = Domain { centre: Point::new(0.5, 0.4, 0.0), half_m: 3.0, dimensions };
            let at = Point::new(-0.4, -0.9, z(-0.5));
            let surface = Surface::Plane { middle: domain.centre };
            let pairs = (0..foci.len()).flat_map(|b| (0..b).map(move |a| [a, b]));
            let lengths = |pair: [usize; 2]| Lengths {
                foci: pair,
                values_m: vec![(surface.way(pair.map(|f| &foci[f]), at).expect("it faces all").0, 1e-3)],
                claimed_m: Vec::new(),
                blend_m: 0.0,
                span_m: [0.0, 10.0],
                density_per_m: 0.3,
                seen: 0.9,
            };
            let pairs: Vec<Lengths> = pairs.map(lengths).collect();
            let triples = triples(&foci, &pairs, &Cancel::never());
            assert!(triples.len() > 1, "{triples:?}");
            let position = |a: usize, b: usize| pairs.iter().position(|pair| pair.foci == [a.min(b), a.max(b)]);
            for triple in triples {
                let seeds = of_triple(&foci, &pairs, triple, &position, &domain, &Cancel::never());
                assert!(seeds.iter().any(|seed| (seed.point - at).norm() < 1e-6), "{triple:?} {seeds:?}");
            }
        }
    }
}
