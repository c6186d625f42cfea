//! Where a patch may be: the best points of a grid.
//!
//! Noise makes every profile's best score within the reach of a large cube as good as that of a patch. So bounds over
//! cubes rule out nothing before the cubes are as small as the response is short. A grid of points as dense is as good,
//! and needs no bounds.

use nalgebra::Vector3;
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::likelihood::searched;
use super::{Profile, Room};
use crate::Point;
use crate::hidden::search::{Curve, Domain};

/// Distance of two points, as a share of the response's length: no place is further from one than scores remember.
const STEP: f64 = 0.5;
/// Signal-to-noise ratio of the pulses that are looked for. Factors spread over a decade, so that it stands for weaker
/// and stronger ones.
const SEARCHED: f64 = 1.2;
/// No sum below this is a patch.
const LEAST: f32 = 5.0;

/// Profiles between the same two foci, together.
struct Pair {
    foci: [usize; 2],
    curves: Vec<Curve>,
}

/// The `most` points with the largest sums of log-likelihood ratios, best first, among those that more than half of the
/// profiles could have recorded.
pub(super) fn candidates(profiles: &[Profile], room: &Room, domain: &Domain, most: usize) -> Vec<Point> {
    let pairs = pairs(profiles, &room.cancel);
    let step_m = STEP * room.width_m;
    let side = (domain.half_m / step_m) as i32;
    let depth = if room.dimensions == 2 { 0 } else { side };
    let plane = |i: i32| {
        let mut legs_m = vec![None; room.foci.len()];
        let points =
            (-side..=side).flat_map(|j| (-depth..=depth).map(move |k| Vector3::from([i, j, k].map(f64::from))));
        let points = points.map(|steps| domain.centre + steps * step_m);
        let sum = |point: Point| {
            room.cancel.check();
            for (leg, focus) in legs_m.iter_mut().zip(&room.foci) {
                *leg = focus.faces(point, 0.0).then(|| (point - focus.point).norm());
            }
            let (sum, recorded) = sum(&pairs, &legs_m);
            (2 * recorded > profiles.len() && sum > LEAST).then_some((point, sum))
        };
        points.filter_map(sum).collect::<Vec<_>>()
    };
    let mut points: Vec<(Point, f32)> = (-side..=side).into_par_iter().flat_map_iter(plane).collect();
    points.sort_by(|a, b| b.1.total_cmp(&a.1));
    points.into_iter().take(most).map(|(point, _)| point).collect()
}

/// The sum at a point, and how many profiles could have recorded a patch there.
fn sum(pairs: &[Pair], legs_m: &[Option<f64>]) -> (f32, usize) {
    let (mut sum, mut recorded) = (0.0, 0);
    for pair in pairs {
        let [Some(a), Some(b)] = pair.foci.map(|focus| legs_m[focus]) else { continue };
        for curve in &pair.curves {
            let place = (a + b - curve.low_m) / curve.step_m + 0.5;
            if let Some(value) = curve.values.get(place as usize).filter(|_| place >= 0.0) {
                sum += value;
                recorded += 1;
            }
        }
    }
    (sum, recorded)
}

fn pairs(profiles: &[Profile], cancel: &Cancel) -> Vec<Pair> {
    let mut pairs: Vec<Pair> = Vec::new();
    for (profile, curve) in profiles.iter().zip(searched(profiles, SEARCHED, cancel)) {
        let foci = [profile.foci[0].min(profile.foci[1]), profile.foci[0].max(profile.foci[1])];
        match pairs.iter_mut().find(|pair| pair.foci == foci) {
            Some(pair) => pair.curves.push(curve),
            None => pairs.push(Pair { foci, curves: vec![curve] }),
        }
    }
    pairs
}
