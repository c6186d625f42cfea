//! Pairs of patches that exchange no light: the first light between them took a detour over a third patch.
//!
//! Coplanar, occluded and specular pairs have no second bounce; the first light from patch i to patch j is then a third
//! bounce over some k that sees both. With `O_ij` the length of the path source, i, j, sensor,
//!
//! ```text
//! O_ikj = O_ik + O_kj - O_kk
//! ```
//!
//! exactly, for any places of source and sensor, with no coordinate known. By the triangle inequality a second bounce
//! is never longer than such a detour. It is as long only if the patch lies on the straight line between the two. So a
//! first arrival that comes no earlier than some detour is rejected. Some second bounces are rejected with it: those
//! past a patch so near to the straight line that noise exceeds the difference.
//!
//! With source and sensor in one point, path lengths also give the angle between two patches as seen from there:
//!
//! ```text
//! sin^2(angle_ij / 2) = (O_ij - O_i) (O_ij - O_j) / (O_i O_j)
//! ```
//!
//! and the angle from i to j is no larger than that from i to k and on to j. A first arrival that asks for a larger one
//! is a detour for certain, also one over a patch whose arrivals are missing. If it is certain, and the length of one
//! patch's detour alone agrees, that patch is named.
//!
//! First arrivals on the right-hand sides that are themselves detours are too long, which can hide a detour but never
//! make one up. Not found: most detours over patches whose own arrivals are missing; those show as residuals once
//! coordinates are known.

use std::collections::{BTreeMap, BTreeSet};

use periscope_cancel::Cancel;

use super::t2::Length;
use crate::units::PatchId;

/// Lengths within this many standard deviations are equal; angles beyond it are larger.
const GATE: f64 = 5.0;

/// First arrivals, or what they tell, by (lit, seen).
type Pairs<T> = BTreeMap<(PatchId, PatchId), T>;

/// Which first arrivals between patches i and j, by (lit, seen), are rejected, and over which patch the light came if
/// that is certain. `arrivals` holds all first arrivals of one sensor, those of (i, i) among them; `is_one_station`
/// says whether that sensor stands where the source is.
#[must_use]
pub fn detours(arrivals: &Pairs<Length>, is_one_station: bool, cancel: &Cancel) -> Pairs<Option<PatchId>> {
    let patches: BTreeSet<PatchId> = arrivals.keys().flat_map(|(lit, seen)| [*lit, *seen]).collect();
    let angles = if is_one_station { angles(arrivals) } else { Pairs::new() };
    let mut detours = Pairs::new();
    for (&(lit, seen), first) in arrivals.iter().filter(|((lit, seen), _)| lit != seen) {
        cancel.check();
        let others = patches.iter().filter(|via| **via != lit && **via != seen);
        let late: Vec<(PatchId, Option<f64>)> =
            others.clone().map(|&via| (via, late(arrivals, (lit, seen), via, *first))).collect();
        let is_larger = |via: &PatchId| {
            let angle = |a: PatchId, b: PatchId| angles.get(&(a, b));
            let (Some(across), Some(there), Some(back)) = (angle(lit, seen), angle(lit, *via), angle(*via, seen))
            else {
                return false;
            };
            // Errors of the first bounces that two of the angles share mostly cancel: on the whole they are counted too
            // large.
            let error_rad = (across[1] - across[0]).hypot(there[2] - there[1]).hypot(back[2] - back[1]);
            across[1] - there[1] - back[1] > error_rad
        };
        let is_certain = others.clone().any(is_larger);
        if is_certain || late.iter().any(|(_, late)| late.is_some_and(|late| late >= -GATE)) {
            let mut possible = late.iter().filter(|(_, late)| late.is_none_or(|late| late.abs() <= GATE));
            let via = match (possible.next(), possible.next()) {
                (Some((via, Some(_))), None) if is_certain => Some(*via),
                _ => None,
            };
            detours.insert((lit, seen), via);
        }
    }
    detours
}

/// By how many standard deviations an arrival comes after the detour over `via`; `None` where an arrival over that
/// patch is missing.
fn late(arrivals: &Pairs<Length>, (lit, seen): (PatchId, PatchId), via: PatchId, first: Length) -> Option<f64> {
    let (there, back, own) = (arrivals.get(&(lit, via))?, arrivals.get(&(via, seen))?, arrivals.get(&(via, via))?);
    let variance_m2 = [&first, there, back, own].iter().map(|length| length.variance_m2).sum::<f64>();
    Some((first.length_m - (there.length_m + back.length_m - own.length_m)) / variance_m2.sqrt())
}

/// Angles between all pairs that have both first bounces, as seen from the station, in radians: the least that [`GATE`]
/// standard deviations allow, the angle itself, and the most.
fn angles(arrivals: &Pairs<Length>) -> Pairs<[f64; 3]> {
    let angle = |(&(lit, seen), both): (&(PatchId, PatchId), &Length)| {
        let (i, j) = (arrivals.get(&(lit, lit))?, arrivals.get(&(seen, seen))?);
        let (a, b, across) = (i.length_m, j.length_m, both.length_m);
        let square = (across - a) * (across - b) / (a * b);
        let slopes = [
            (2.0 * across - a - b) / (a * b),
            -(across - b) / (a * b) - square / a,
            -(across - a) / (a * b) - square / b,
        ];
        let variance: f64 =
            slopes.iter().zip([both, i, j]).map(|(slope, length)| slope * slope * length.variance_m2).sum();
        let angle_rad = |sigmas: f64| 2.0 * (square + sigmas * variance.sqrt()).clamp(0.0, 1.0).sqrt().asin();
        Some(((lit, seen), [-GATE, 0.0, GATE].map(angle_rad)))
    };
    arrivals.iter().filter(|((lit, seen), _)| lit != seen).filter_map(angle).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Point;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const SD_M: f64 = 2e-4;

    /// Patches on three walls; those of one wall exchange no light. First arrivals with noise, and for each pair the
    /// patch that its light came over.
    fn scene(rng: &mut ChaCha8Rng, sensor: Point) -> (Pairs<Length>, Pairs<Option<PatchId>>) {
        let wall = |patch: PatchId| patch % 3;
        let mut place = |patch: PatchId| {
            let (u, v) = (rng.random_range(0.2..2.0), rng.random_range(-0.8..0.8));
            match wall(patch) {
                0 => Point::new(-1.0, v, 1.0 + u),
                1 => Point::new(1.2, v, 1.0 + u),
                _ => Point::new(u - 1.0, v, 3.2),
            }
        };
        let points: Vec<Point> = (0..18).map(&mut place).collect();
        let source = Point::origin();
        let leg = |a: PatchId, b: PatchId| (points[a as usize] - points[b as usize]).norm();
        let ends = |i: PatchId, j: PatchId| (points[i as usize] - source).norm() + (points[j as usize] - sensor).norm();
        let (mut arrivals, mut truth) = (Pairs::new(), Pairs::new());
        for i in 0..18 {
            for j in 0..18 {
                let closed = i != j && wall(i) == wall(j);
                let detour = |k: PatchId| leg(i, k) + leg(k, j);
                let via = (0..18).filter(|k| wall(*k) != wall(i)).min_by(|a, b| detour(*a).total_cmp(&detour(*b)));
                let between = if closed { detour(via.unwrap()) } else { leg(i, j) };
                let noise: f64 = StandardNormal.sample(rng);
                let length_m = ends(i, j) + if i == j { 0.0 } else { between } + SD_M * noise;
                arrivals.insert((i, j), Length { length_m, variance_m2: SD_M * SD_M });
                if i != j {
                    truth.insert((i, j), via.filter(|_| closed));
                }
            }
        }
        (arrivals, truth)
    }

    /// Rejected and kept arrivals of some scenes, by what they truly are.
    #[derive(Debug, Default)]
    struct Count {
        closed: usize,
        missed: usize,
        named: usize,
        misnamed: usize,
        open: usize,
        made_up: usize,
    }

    /// In 20 scenes, each arrival of two patches there with the chance `captured`.
    fn count(sensor: Point, captured: f64) -> Count {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut count = Count::default();
        for _ in 0..20 {
            let (mut arrivals, truth) = scene(&mut rng, sensor);
            arrivals.retain(|(i, j), _| i == j || rng.random_bool(captured));
            let rejections = detours(&arrivals, sensor == Point::origin(), &Cancel::never());
            for pair in arrivals.keys().filter(|(i, j)| i != j) {
                let (rejection, via) = (rejections.get(pair), truth[pair]);
                count.closed += usize::from(via.is_some());
                count.missed += usize::from(via.is_some() && rejection.is_none());
                count.open += usize::from(via.is_none());
                count.made_up += usize::from(via.is_none() && rejection.is_some());
                if let Some(Some(named)) = rejection {
                    count.named += 1;
                    count.misnamed += usize::from(via != Some(*named));
                }
            }
        }
        eprintln!("sensor {sensor}, {captured} captured: {count:?}");
        count
    }

    const ASIDE: Point = Point::new(0.15, 0.0, 0.05);

    #[test]
    fn closed_pairs_are_found_and_open_ones_left() {
        let (together, aside) = (count(Point::origin(), 1.0), count(ASIDE, 1.0));
        for count in [&together, &aside] {
            assert!(count.missed == 0 && count.made_up <= count.open / 500, "{count:?}");
        }
        assert!(together.named > together.closed / 2 && together.misnamed == 0, "{together:?}");
        assert_eq!(aside.named, 0);
    }

    /// A third of all arrivals missing: what is found is right, and from one station angles find more.
    #[test]
    fn gaps_hide_detours_but_make_none_up() {
        let (together, aside) = (count(Point::origin(), 0.67), count(ASIDE, 0.67));
        for count in [&together, &aside] {
            assert!(count.made_up <= count.open / 500 && count.misnamed == 0, "{count:?}");
        }
        assert!(
            aside.missed < aside.closed * 7 / 10 && together.missed < aside.missed * 9 / 10,
            "{together:?} {aside:?}"
        );
    }

    #[test]
    fn light_later_than_every_detour_is_no_second_bounce_either() {
        let length = |length_m| Length { length_m, variance_m2: 1e-8 };
        let mut arrivals: Pairs<Length> = [((1, 1), 2.0), ((2, 2), 2.4), ((3, 3), 2.2), ((1, 3), 2.9), ((3, 2), 3.1)]
            .map(|(pair, l)| (pair, length(l)))
            .into();
        arrivals.insert((1, 2), length(4.5));
        assert_eq!(detours(&arrivals, true, &Cancel::never())[&(1, 2)], None);
        // As long as over patch 3, and an angle of 93 degrees, where it is 44 + 40 over patch 3.
        arrivals.insert((1, 2), length(3.8));
        assert_eq!(detours(&arrivals, true, &Cancel::never())[&(1, 2)], Some(3));
        assert_eq!(detours(&arrivals, false, &Cancel::never())[&(1, 2)], None);
        arrivals.insert((1, 2), length(3.5));
        assert!(!detours(&arrivals, true, &Cancel::never()).contains_key(&(1, 2)));
        // One more patch whose arrivals are missing may be what the light came over.
        arrivals.extend([((1, 2), length(3.8)), ((4, 4), length(2.0))]);
        assert_eq!(detours(&arrivals, true, &Cancel::never())[&(1, 2)], None);
    }

    #[test]
    fn angles_are_those_between_the_directions() {
        let (a, b) = (Point::new(0.3, 1.0, 0.4), Point::new(-0.8, 0.6, 1.1));
        let length = |length_m| Length { length_m, variance_m2: 1e-8 };
        let (first, second) = (a.coords.norm(), b.coords.norm());
        let arrivals = [((1, 1), 2.0 * first), ((2, 2), 2.0 * second), ((1, 2), first + (a - b).norm() + second)];
        let ranges = angles(&arrivals.map(|(pair, l)| (pair, length(l))).into());
        let [least, angle, most] = ranges[&(1, 2)];
        assert!((angle - a.coords.angle(&b.coords)).abs() < 1e-12);
        assert!(least < angle && angle < most && most - least < 0.01, "{least} {angle} {most}");
    }
}
