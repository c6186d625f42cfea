//! The law under which light begins at each place: of a surface that faces it, an edge or a corner.
//!
//! One histogram seldom tells. Neighbours together do, by their likelihoods, and so does the curvature of the lengths:
//! on edges and corners it is one over the distance. Both give shares, not choices, so that lengths do not jump from
//! one law to the next; what the laws differ by, weighted with the shares, is the error of the law.

use rayon::prelude::*;

use super::choice::Choice;
use super::field::Field;
use super::flat::Flat;
use super::local::{Local, Sample};
use super::odds;
use super::windows::Chosen;
use super::{Face, Place, Return, Scan};

/// Places whose likelihoods count together, and whose curvatures do.
const POOL: usize = 150;
const CURVED: usize = 21;
/// Power of a likelihood that counts: laws are first orders, and their misfits are common to neighbours.
const TEMPER: f64 = 0.1;
/// Power of the shares by likelihood beside those by curvature.
const BESIDE: f64 = 0.3;
/// Share of a law that nothing speaks for, in places.
const NONE: f64 = 0.3;
/// Standard deviation of the law's error over that of the response: of a step, with more for an edge and a corner.
const ERROR: [f64; 3] = [0.12, 0.24, 0.36];
/// The same of the law of flat faces.
const FACES_ERROR: f64 = 0.05;
/// The most of the error of the law of flat faces that noise may hide, as [`ERROR`].
pub const MOST_ERROR: f64 = 0.36;
/// An edge that lies so far behind the nearest point, in radii of the zone, takes nothing from first light.
const UNSEEN: f64 = 3.0;
/// Power of the likelihood by which a sheet and a block are distinguished, and the most by which one place counts:
/// where both laws are off, a few places with much light would decide.
const FACES_TEMPER: f64 = 0.3;
const MOST_OF_ONE: f64 = 3.0;
/// Neighbours whose light shows whether the surface faces the wall, and the logarithm of the odds for it before.
const RISES: usize = 55;
const TRUST: f64 = 3.0;
/// Standard deviation of a first return, over that of the response, up to which its rise speaks for a face. Where light
/// is weaker, histograms whose light happens to rise fast pass the threshold and the others do not, so that steps look
/// like faces.
const SHARP: f64 = 0.25;
/// Least standard deviation of a curvature times distance, and likelihood of one that no surface has.
const LEAST_SD: f64 = 0.05;
const BEYOND: f64 = 1e-3;

/// Shares of the laws.
pub type Shares = [f64; 3];

/// Of each place, by the likelihoods of its neighbours.
pub fn by_likelihood(scan: &Scan, near: &[Vec<u32>]) -> Vec<Shares> {
    let share = scan.share();
    let of_place = |(place, near): (&Place, &Vec<u32>)| {
        let own = place.returns[0];
        let zone_m2 = 2.0 * scan.zone_m(own.length_m * 0.5).powi(2);
        let mut sums = [0.0; 3];
        for other in near.iter().take(POOL).map(|n| &scan.places[*n as usize]) {
            let apart_m2 = (other.seen - place.seen).norm_squared();
            let [step, ..] = other.returns;
            // Lengths of one surface differ by no more than their places do.
            let most_m = apart_m2.sqrt() + 4.0 * share * step.sd_m.hypot(own.sd_m);
            if share * (step.length_m - own.length_m).abs() > most_m {
                continue;
            }
            let weight = TEMPER * (-0.5 * apart_m2 / zone_m2).exp();
            sums.iter_mut().zip(&other.returns).for_each(|(sum, one)| *sum += weight * one.log_likelihood);
        }
        let most = sums.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        normalised(sums.map(|sum| (sum - most).exp()))
    };
    scan.places.par_iter().zip(near).map(of_place).collect()
}

/// Of each place, by the curvatures of the fields about it that were asked for, and these shares.
pub fn by_curvature(
    near: &[Vec<u32>],
    likely: &[Shares],
    fields: &[Option<Chosen<Field>>],
    is_asked: &[bool],
) -> Vec<Shares> {
    let of_field = |chosen: &Option<Chosen<Field>>| {
        let Some(chosen) = chosen else { return [0.0; 3] };
        let [first, second] = chosen.field.bends(&chosen.way).map(|[bend, sd]| {
            let sd = sd.hypot(LEAST_SD);
            let z = (1.0 - bend) / sd;
            let ends = (-0.5 * z * z).exp() / (sd * std::f64::consts::TAU.sqrt());
            // A surface that faces the wall has any curvature below that of an edge.
            let faces = if z < 0.0 { BEYOND.max(0.02 * ends) } else { 1.0 };
            ends / (ends + faces)
        });
        [(1.0 - first) * (1.0 - second), first * (1.0 - second) + second * (1.0 - first), first * second]
    };
    let own: Vec<Shares> = fields.iter().map(of_field).collect();
    let of_place = |(near, likely): (&Vec<u32>, &Shares)| {
        let near = &near[..CURVED.min(near.len())];
        let all = near.len() as f64 / near.iter().filter(|n| is_asked[**n as usize]).count().max(1) as f64;
        let sum = |k: usize| all * near.iter().map(|n| own[*n as usize][k]).sum::<f64>() + NONE;
        normalised(std::array::from_fn(|k| sum(k) * (likely[k] + BEYOND).powf(BESIDE)))
    };
    near.iter().zip(likely).map(of_place).collect()
}

fn normalised(shares: Shares) -> Shares {
    let sum: f64 = shares.iter().sum();
    shares.map(|share| share / sum)
}

/// Lengths under these shares, where each place has an error of its own beside its noise.
pub fn samples(scan: &Scan, shares: &[Shares], own_m: f64) -> Vec<Sample> {
    let of_place = |(place, shares): (&Place, &Shares)| {
        let mean = |of: &dyn Fn(usize) -> f64| shares.iter().enumerate().map(|(k, share)| share * of(k)).sum::<f64>();
        let length_m = mean(&|k| place.returns[k].length_m);
        let apart_m2 = mean(&|k| (place.returns[k].length_m - length_m).powi(2));
        let error_m = mean(&|k| (scan.sigma_m * ERROR[k]).hypot(place.returns[k].common_m));
        let sd_m = (scan.share() * mean(&|k| place.returns[k].sd_m.powi(2)).sqrt()).hypot(own_m);
        Sample {
            at: place.seen,
            length_m: scan.share() * length_m,
            sd_m,
            law_m: scan.share() * apart_m2.sqrt().hypot(error_m),
            weighted_m: sd_m,
        }
    };
    scan.places.iter().zip(shares).map(of_place).collect()
}

/// First returns of a place whose flat faces are those of a sheet and of a block, and how sure their law is.
#[derive(Clone, Copy, Debug)]
pub struct Again {
    returns: [Return; 2],
    law_m2: f64,
}

/// The first return of a place under the law that its faces set, with an error of the law that lengths of neighbours
/// have in common; `None` where it has none.
pub fn again(
    scan: &Scan,
    place: usize,
    choice: &Choice<'_>,
    common_m: f64,
    timed: impl Fn(usize, &[Vec<Face>], &Flat) -> Vec<Option<Return>>,
) -> Option<Again> {
    let flat = &choice.flat?.field;
    let length_m = flat.length_m(&scan.places[place].seen);
    let zone_m = scan.zone_m(length_m);
    let ends = flat.beyond(zone_m);
    let beyond = ends.map(|end| end.likeliest());
    // Laws that differ in nothing are timed once.
    let mut laws = vec![flat.faces(beyond)];
    let mut number = |faces: Vec<Face>| {
        laws.iter().position(|law| *law == faces).unwrap_or_else(|| {
            laws.push(faces);
            laws.len() - 1
        })
    };
    let other = flat.other().map_or(0, |other| number(other.faces(beyond)));
    let moved: [Vec<usize>; 5] = std::array::from_fn(|k| {
        let is_seen = |place: &f64| place.max(beyond[k]) >= -UNSEEN;
        let with = |place: f64| std::array::from_fn(|end| if end == k { place } else { beyond[end] });
        ends[k].otherwise().filter(is_seen).map(|place| number(flat.faces(with(place)))).collect()
    });
    let returns = timed(place, &laws, flat);
    let own = returns[0]?;
    let other = returns[other].unwrap_or(own);
    let error_m = (common_m / scan.share()).max(scan.sigma_m * FACES_ERROR);
    let off_m2 = |law: &usize| returns[*law].map_or(0.0, |moved| (moved.length_m - own.length_m).powi(2));
    let by_ends_m2: f64 = moved.iter().map(|of_end| of_end.iter().map(off_m2).fold(0.0, f64::max)).sum();
    let law_m2 = error_m.powi(2) + own.common_m.powi(2) + by_ends_m2;
    Some(Again { returns: if flat.is_block { [other, own] } else { [own, other] }, law_m2 })
}

/// Logarithm of the odds of one law against another, by how much likelier it is at each place. Both are first orders:
/// odds are no larger than the spread over places allows, as of a mean whose standard deviation is not known.
fn evidence(places: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut squares) = (0.0, 0.0);
    for more in places.map(|more| more.clamp(-MOST_OF_ONE, MOST_OF_ONE)) {
        sum += more;
        squares += more * more;
    }
    let most = odds::OF_SD * f64::abs(sum) / f64::max(squares, f64::MIN_POSITIVE).sqrt();
    (FACES_TEMPER * sum).clamp(-most, most)
}

/// Of each place, the probability that first light of neighbours comes from edges or corners, where models say that the
/// surface faces the wall: `is_facing` are the places of which they say so, `members` those of the model of a place.
/// Lengths do not tell a plane from steps whose edges lie in it; how light rises does. Where it says nothing, the
/// probability is that before.
pub fn by_rise<'a>(
    scan: &Scan,
    near: &[Vec<u32>],
    is_facing: &[bool],
    members: impl Fn(usize) -> Option<&'a [u32]> + Sync,
) -> Vec<f64> {
    let of_place = |n: usize| {
        let Some(members) = members(n) else { return 0.0 };
        let is_like = |other: &&u32| is_facing[**other as usize] && members.binary_search(other).is_ok();
        let all = || near[n].iter().filter(is_like).map(|other| &scan.places[*other as usize]);
        if all().next().is_none() {
            return 0.0;
        }
        let is_sharp = |place: &&Place| place.returns[0].sd_m < SHARP * scan.sigma_m;
        let more = |place: &Place| {
            let [step, edge, corner] = place.returns.map(|one| one.log_likelihood);
            edge.max(corner) - step
        };
        let for_edges = evidence(all().take(RISES).map(more));
        let against = || evidence(all().filter(is_sharp).take(RISES).map(more)).min(0.0);
        odds::probability(if for_edges > 0.0 { for_edges } else { against() } - TRUST)
    };
    (0..near.len()).into_par_iter().map(of_place).collect()
}

/// Lengths under the laws of flat faces, mixed with those without them by their shares. Whether faces are those of a
/// sheet or of a block is seen by the likelihoods of neighbours that see the same faces, unless lengths show it.
pub fn mixed(
    scan: &Scan,
    near: &[Vec<u32>],
    without: &[Sample],
    choices: &[Choice<'_>],
    again: &[Option<Again>],
    own_m: f64,
) -> Vec<Sample> {
    let half = scan.share();
    let of_place = |n: usize| {
        let without = Sample { weighted_m: without[n].sd_m.hypot(without[n].law_m), ..without[n] };
        let Some((own, flat)) = again[n].zip(choices[n].flat) else { return without };
        let about = near[n].iter().take(POOL).filter(|other| flat.members.binary_search(other).is_ok());
        let more = evidence(about.filter_map(|other| {
            let [sheet, block] = again[*other as usize]?.returns;
            Some(block.log_likelihood - sheet.log_likelihood)
        }));
        let block = if flat.field.is_block { 1.0 } else { odds::probability(more) };
        let rest = 1.0 - choices[n].share;
        let of_faces = |share: f64, one: &Return| {
            (choices[n].share * share, half * one.length_m, own_m.hypot(half * one.sd_m), half * half * own.law_m2)
        };
        let parts = [
            of_faces(1.0 - block, &own.returns[0]),
            of_faces(block, &own.returns[1]),
            (rest, without.length_m, without.sd_m, without.law_m.powi(2)),
        ];
        let length_m: f64 = parts.iter().map(|(share, length_m, ..)| share * length_m).sum();
        let sd_m2: f64 = parts.iter().map(|(share, _, sd_m, _)| share * sd_m * sd_m).sum();
        let law_m2: f64 =
            parts.iter().map(|(share, other_m, _, law_m2)| share * (law_m2 + (other_m - length_m).powi(2))).sum();
        Sample { length_m, sd_m: sd_m2.sqrt(), law_m: law_m2.sqrt(), weighted_m: (sd_m2 + law_m2).sqrt(), ..without }
    };
    (0..without.len()).into_par_iter().map(of_place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sixty places that are said to face the wall, in the neighbourhood of all: their light rises as from an edge, or
    /// as from a face, or nothing is said.
    #[test]
    fn light_that_rises_as_from_edges_refutes_faces() {
        let edges_of = |more: f64, faces: bool, sd_m: f64| {
            let of = |log_likelihood: f64| Return { length_m: 1.0, sd_m, common_m: 0.0, log_likelihood };
            let place = Place { seen: crate::Point::origin(), returns: [of(0.0), of(more), of(-5.0)] };
            let scan = Scan {
                lit: super::super::Lit::Same,
                inwards: nalgebra::Vector3::z(),
                sigma_m: 0.01,
                places: vec![place; 60],
                least: 0,
            };
            let near: Vec<Vec<u32>> = vec![(0..60).collect(); 60];
            let members: Vec<u32> = (0..60).collect();
            by_rise(&scan, &near, &[faces; 60], |_| Some(&members[..]))[0]
        };
        let edges = |more: f64, faces: bool| edges_of(more, faces, 1e-3);
        let before = odds::probability(-TRUST);
        assert!(edges(0.7, true) > 0.9);
        assert!(edges(-0.1, true) < 0.01);
        assert!((edges(0.0, true) - before).abs() < 1e-9 && edges(0.7, false) < 1e-9);
        // Of weak light those that rise fast are seen, steps or not.
        assert!((edges_of(-0.5, true, 4e-3) - before).abs() < 1e-9 && edges_of(0.7, true, 4e-3) > 0.9);
    }

    #[test]
    fn a_few_places_do_not_decide_between_laws() {
        // A hundred places say no, three with much light say yes.
        let places = std::iter::repeat_n(-0.5, 100).chain([400.0; 3]);
        assert!(evidence(places) < -3.0);
        // Places that contradict one another say nothing sure, however many they are.
        let odd = (0..1000).map(|n| if n % 2 == 0 { 3.0 } else { -2.9 });
        assert!(evidence(odd).abs() < 1.0);
        assert!(evidence(std::iter::empty()).abs() < 1e-9);
        assert!(evidence(std::iter::repeat_n(0.2, 150)) > 5.0);
    }
}
