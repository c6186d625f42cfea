//! Places whose first light is weaker than what they show alone.
//!
//! First light of neighbours is a smooth function over the wall. Where some of them show it, the light of a place and
//! of those about it is added up along planes of lengths through them: what no histogram shows alone, many do. Where
//! there is such light before that which a place shows alone, the latter comes from something behind.

use nalgebra::Vector3;
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::Point;
use crate::axes::across;
use crate::neighbours::Cells;

/// Places whose light is added up, and the fewest whose histograms reach as far.
const NEAREST: usize = 13;
const LEAST: usize = 9;
/// Three of them have a plane where their triangle is at least half of that of next neighbours.
const WIDE: f64 = 0.5;
/// Within so many standard deviations of the response first light of a place is that of a plane, and from so many on
/// there may be light before it.
const SAME: f64 = 1.5;
const EARLIER: f64 = 4.0;
/// The most that one place says for a plane, and the least that the place itself says, in standard deviations.
const MOST: f64 = 2.0;
const OWN: f64 = 0.5;
/// The least share of its neighbours' light that a place has, within two standard deviations.
const ALIKE: f64 = 0.25;

/// What the places of a wall show, each alone.
pub struct Alone<'a> {
    /// Places of the wall.
    pub places: &'a [Point],
    /// Unit normal of the wall.
    pub inwards: Vector3<f64>,
    /// The most that a length changes over the wall: 2 where light goes back where it came from, else 1.
    pub steepest: f64,
    /// Standard deviation of the response, as a length.
    pub sigma_m: f64,
    /// Lengths of first light.
    pub lengths_m: &'a [Option<f64>],
}

/// Which places have light before that which they show alone: where their neighbours' light and their own together
/// exceed a `threshold`, in standard deviations. `excess` says how much more light a place has behind a length than
/// before it, and the standard deviation of that; `None` where it does not know.
#[must_use]
pub fn has_earlier(
    alone: &Alone<'_>,
    threshold: f64,
    excess: impl Fn(usize, f64) -> Option<[f64; 2]> + Sync,
    cancel: &Cancel,
) -> Vec<bool> {
    let near = Cells::new(alone.places.to_vec()).all_nearest(NEAREST, cancel);
    let mut known = alone.lengths_m.to_vec();
    let [mut has_earlier, mut is_asked] = [false, true].map(|start| vec![start; known.len()]);
    loop {
        let of_place = |n: usize| {
            cancel.check();
            let is_open = is_asked[n] && !has_earlier[n] && near[n].len() == NEAREST;
            let own_m = known[n].filter(|_| is_open)?;
            Around::new(alone, &near[n], &known).earlier_m(own_m, threshold, &excess)
        };
        let found: Vec<Option<f64>> = (0..known.len()).into_par_iter().map(of_place).collect();
        if found.iter().all(Option::is_none) {
            return has_earlier;
        }
        // What is found helps the places next to it.
        is_asked = near.iter().map(|near| near.iter().any(|other| found[*other as usize].is_some())).collect();
        for (n, length_m) in found.into_iter().enumerate().filter(|(_, length_m)| length_m.is_some()) {
            (known[n], has_earlier[n]) = (length_m, true);
        }
    }
}

/// A length, and its slopes along the wall.
type Plane = [f64; 3];

/// A neighbour.
struct Neighbour {
    number: usize,
    /// Where it lies from the place, along the wall.
    arm: [f64; 2],
    known_m: Option<f64>,
}

impl Neighbour {
    fn length_m(&self, [length_m, right, up]: Plane) -> f64 {
        length_m + right * self.arm[0] + up * self.arm[1]
    }
}

/// A place and its neighbours, itself first.
struct Around<'a> {
    alone: &'a Alone<'a>,
    all: Vec<Neighbour>,
}

impl<'a> Around<'a> {
    fn new(alone: &'a Alone<'a>, near: &[u32], known: &[Option<f64>]) -> Self {
        let axes = across(&alone.inwards);
        let here = alone.places[near[0] as usize];
        let neighbour = |n: &u32| {
            let number = *n as usize;
            let arm = axes.map(|axis| axis.dot(&(alone.places[number] - here)));
            Neighbour { number, arm, known_m: known[number] }
        };
        Self { alone, all: near.iter().map(neighbour).collect() }
    }

    /// The length at the place of the plane that most light speaks for, of those well before its own.
    fn earlier_m(&self, own_m: f64, threshold: f64, excess: &impl Fn(usize, f64) -> Option<[f64; 2]>) -> Option<f64> {
        let before_m = own_m - EARLIER * self.alone.sigma_m;
        let planes = self.planes().filter(|plane| plane[0] < before_m);
        let scored = planes.filter_map(|plane| Some((self.score(plane, excess)?, plane[0])));
        let best = scored.reduce(|best, next| if next.0 > best.0 { next } else { best });
        best.filter(|(score, _)| *score > threshold).map(|(_, length_m)| length_m)
    }

    /// Planes through three neighbours each.
    fn planes(&self) -> impl Iterator<Item = Plane> {
        let known: Vec<([f64; 2], f64)> =
            self.all[1..].iter().filter_map(|one| Some((one.arm, one.known_m?))).collect();
        let count = known.len();
        let [x, y] = self.all[1].arm;
        let least_m2 = WIDE * (x * x + y * y);
        let of_three = move |[a, b, c]: [usize; 3]| {
            let (from, length_m) = known[a];
            let [(right, right_m), (left, left_m)] =
                [b, c].map(|n| ([known[n].0[0] - from[0], known[n].0[1] - from[1]], known[n].1 - length_m));
            let area_m2 = right[0] * left[1] - right[1] * left[0];
            let slopes = [right_m * left[1] - left_m * right[1], left_m * right[0] - right_m * left[0]];
            let [x, y] = slopes.map(|slope| slope / area_m2);
            let is_possible = area_m2.abs() > least_m2 && x.hypot(y) < self.alone.steepest;
            is_possible.then_some([length_m - x * from[0] - y * from[1], x, y])
        };
        let threes = (0..count).flat_map(move |a| (0..a).flat_map(move |b| (0..b).map(move |c| [a, b, c])));
        threes.filter_map(of_three)
    }

    /// How much light speaks for a plane, in standard deviations; `None` where that of the place itself does not.
    fn score(&self, plane: Plane, excess: &impl Fn(usize, f64) -> Option<[f64; 2]>) -> Option<f64> {
        let sigma_m = self.alone.sigma_m;
        let own = excess(self.all[0].number, plane[0])?;
        if own[0] < OWN * own[1] {
            return None;
        }
        let light = |one: &Neighbour| {
            let length_m = one.length_m(plane);
            let [light, sd] = excess(one.number, length_m)?;
            let off = one.known_m.map(|known_m| (length_m - known_m) / sigma_m);
            // First light that lies elsewhere says nothing for the plane.
            let is_other = off.is_some_and(|off| off > SAME || (off < -SAME && off > -EARLIER));
            Some([if is_other { 0.0 } else { light }, sd])
        };
        let light: Vec<[f64; 2]> = self.all.iter().filter_map(light).collect();
        if light.len() < LEAST {
            return None;
        }
        let mut heights: Vec<f64> = light.iter().map(|[light, _]| *light).collect();
        let middle = *heights.select_nth_unstable_by(light.len() / 2, f64::total_cmp).1;
        if own[0] + 2.0 * own[1] < ALIKE * middle {
            return None;
        }
        let sum: f64 = light.iter().map(|[light, sd]| (light / sd).min(MOST)).sum();
        Some(sum / (light.len() as f64).sqrt())
    }
}
