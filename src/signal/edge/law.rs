//! The law by which light of a surface begins: what share of a growing ring is lit.
//!
//! A flash reaches points of a plane at growing distances `r` from the foot of the nearest point. Their light comes
//! back `u = r^2 / (c d)` after that of the foot, with the distance `d`: equal areas in equal times, so that the rate
//! is constant where whole rings are lit. A surface that ends at two edges at right angles, at signed distances `e` of
//! the foot from them ([`Ends`]), lights the share of the ring
//!
//! ```text
//! 1 - (2 arccos(e1 / r) + 2 arccos(e2 / r) - beyond both) / 2 pi
//! ```
//!
//! A foot within, far from both edges, makes a step; one far outside of an edge a square root, of both edges a ramp.
//! With one edge the share is 1 up to `r = e`, then `1 - arccos(e / r) / pi`; outside of it, `arccos(|e| / r) / pi`.
//! The law holds for flat surfaces; a share of decline over the ring is left to the slope of the fit.

use std::f64::consts::{PI, TAU};

/// Signed distances of the foot of a histogram's point from two edges at right angles, positive within the surface.
/// Their unit is the radius of the ring whose light comes one standard deviation of the response after the foot's.
pub type Ends = [f64; 2];

/// A flat part of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// Its light next to that of other parts: the square of the cosine at which it faces the point of the wall.
    pub weight: f64,
    /// Signed distances of the foot from the edges of a rectangle, both ends of each of its directions.
    pub ends: [[f64; 2]; 2],
}

impl Face {
    /// One that ends at two edges.
    #[must_use]
    pub fn quarter([first, second]: Ends) -> Self {
        Self { weight: 1.0, ends: [[first, f64::INFINITY], [second, f64::INFINITY]] }
    }
}

/// A surface that faces the point of the wall and has no edge near.
pub const STEP: Ends = [FARTHEST, FARTHEST];
/// A straight edge, the surface's plane far from the point of the wall: a square root.
pub const EDGE: Ends = [LEAST, FARTHEST];
/// A corner: a ramp.
pub const CORNER: Ends = [LEAST, LEAST];

/// Distances of the table. Beyond them the window shows no more of an edge within; an edge outside is a square root.
const LEAST: f64 = -4.8;
const FARTHEST: f64 = 2.4;
const STEP_OF_ENDS: f64 = 0.3;
const COUNT: usize = 25;
/// Weight of a law beside it that counts for nothing.
const LEAST_WEIGHT: f64 = 1e-8;
/// Parts of a step of time in which the share of a ring is summed.
const PARTS: usize = 8;

/// All laws behind a response, averaged over a bin: of each pair of distances, the second not below the first, light
/// and light times the time since it began, by time.
#[derive(Clone, Debug)]
pub struct Rises {
    first_ps: f64,
    step_ps: f64,
    sigma_ps: f64,
    count: usize,
    columns: Vec<[f64; 2]>,
    /// Of a step, an edge and a corner.
    limits: Vec<Rise>,
}

/// One law by time.
#[derive(Clone, Debug)]
pub struct Rise {
    first_ps: f64,
    step_ps: f64,
    columns: Vec<[f64; 2]>,
}

impl Rises {
    /// From the response at `first_ps`, `first_ps + step_ps`... behind the arrival of light, on any scale; its full
    /// width at half maximum; the width of a bin; and the time behind the first return that is needed.
    ///
    /// # Panics
    /// If the response has no positive sum, or a width or step is not positive.
    #[must_use]
    pub(super) fn over(
        [first_ps, step_ps]: [f64; 2],
        response: &[f64],
        [sigma_ps, bin_ps]: [f64; 2],
        reach_ps: f64,
    ) -> Self {
        let sum: f64 = response.iter().sum();
        assert!(
            sum > 0.0 && step_ps > 0.0 && sigma_ps > 0.0 && bin_ps > 0.0,
            "a response with positive sum and widths"
        );
        let half = (0.5 * bin_ps / step_ps).round() as usize;
        let mean = |n: usize| {
            let places = n.saturating_sub(2 * half).min(response.len())..(n + 1).min(response.len());
            response[places].iter().sum::<f64>() / ((2 * half + 1) as f64 * sum)
        };
        let averaged: Vec<f64> = (0..response.len() + 2 * half).map(mean).collect();
        let first_ps = first_ps - half as f64 * step_ps;
        let count = ((reach_ps - first_ps) / step_ps).ceil().max(1.0) as usize + 2;
        let unit = step_ps / sigma_ps;
        let columns = |first: usize, second: usize| {
            let sums: Vec<[f64; 2]> = (0..count).map(|n| ring([first, second].map(distance), n, unit)).collect();
            let mut columns = vec![[0.0; 2]; count];
            for (n, value) in averaged.iter().enumerate().take(count) {
                add(&mut columns[n..], *value, &sums);
            }
            columns
        };
        let pairs = (0..COUNT).flat_map(|first| (first..COUNT).map(move |second| (first, second)));
        let columns = pairs.flat_map(|(first, second)| columns(first, second)).collect();
        let mut rises = Self { first_ps, step_ps, sigma_ps, count, columns, limits: Vec::new() };
        rises.limits = [STEP, EDGE, CORNER].map(|ends| rises.law(&[Face::quarter(ends)], reach_ps)).to_vec();
        rises
    }

    /// Laws of a step, an edge and a corner.
    pub(super) fn limits(&self) -> [&Rise; 3] {
        [0, 1, 2].map(|law| &self.limits[law])
    }

    /// That of a step.
    pub(super) fn first(&self) -> &Rise {
        &self.limits[0]
    }

    /// Standard deviation of a Gaussian as wide as the response.
    #[must_use]
    pub fn sigma_ps(&self) -> f64 {
        self.sigma_ps
    }

    /// The law of faces whose light begins at one time, as far as so long behind it.
    #[must_use]
    pub fn law(&self, faces: &[Face], reach_ps: f64) -> Rise {
        let count = ((reach_ps - self.first_ps) / self.step_ps).ceil().max(1.0) as usize;
        let mut columns = vec![[0.0; 2]; count.saturating_add(2).min(self.count)];
        let mut blended = columns.clone();
        faces.iter().for_each(|face| self.add(*face, &mut columns, &mut blended));
        Rise { first_ps: self.first_ps, step_ps: self.step_ps, columns }
    }

    /// Light of a rectangle: that of the quarter with its nearest edges, less what lies beyond the other two, whose
    /// light begins later.
    fn add(&self, Face { weight, ends }: Face, columns: &mut [[f64; 2]], blended: &mut [[f64; 2]]) {
        let ends = ends.map(|[one, other]| if one < other { [one, other] } else { [other, one] });
        let nearest = |ends: Ends| ends.iter().map(|end| end.min(0.0).powi(2)).sum::<f64>();
        let [[first, far_first], [second, far_second]] = ends;
        let begin = nearest([first, second]);
        for (sign, ends) in [
            (1.0, [first, second]),
            (-1.0, [-far_first, second]),
            (-1.0, [first, -far_second]),
            (1.0, [-far_first, -far_second]),
        ] {
            let later = nearest(ends) - begin;
            if later * self.sigma_ps < self.step_ps * columns.len() as f64 {
                self.blend(sign * weight, ends, blended);
                self.add_later(later, blended, columns);
            }
        }
    }

    /// Light of a quarter, between the four laws of the table that are next to it.
    fn blend(&self, weight: f64, ends: Ends, blended: &mut [[f64; 2]]) {
        let places = ends.map(|end| {
            let place = ((end - LEAST) / STEP_OF_ENDS).clamp(0.0, (COUNT - 1) as f64 - 1e-9);
            (place as usize, place.fract())
        });
        blended.fill([0.0; 2]);
        for (first, second) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let share = |(_, fract): (usize, f64), next: usize| if next == 1 { fract } else { 1.0 - fract };
            let weight = weight * share(places[0], first) * share(places[1], second);
            // At the ends of the table.
            if weight.abs() < LEAST_WEIGHT {
                continue;
            }
            let [a, b] = [places[0].0 + first, places[1].0 + second];
            let from = self.count * pair(a.min(b), a.max(b));
            add(blended, weight, &self.columns[from..from + self.count]);
        }
    }

    /// Adds light that begins later.
    fn add_later(&self, later: f64, light: &[[f64; 2]], columns: &mut [[f64; 2]]) {
        let shift = later * self.sigma_ps / self.step_ps;
        let (whole, part) = (shift as usize, shift.fract());
        let mut before = [0.0; 2];
        for (column, now) in columns[whole..].iter_mut().zip(light) {
            let light = [0, 1].map(|k| now[k] + part * (before[k] - now[k]));
            column[0] += light[0];
            column[1] += light[1] + later * light[0];
            before = *now;
        }
    }
}

fn add(columns: &mut [[f64; 2]], weight: f64, light: &[[f64; 2]]) {
    for (column, light) in columns.iter_mut().zip(light) {
        column[0] += weight * light[0];
        column[1] += weight * light[1];
    }
}

impl Rise {
    /// Light and light times the time since it began, at a time behind the first return, and their slopes by time.
    pub fn at(&self, time_ps: f64) -> [f64; 4] {
        let place = (time_ps - self.first_ps) / self.step_ps;
        if place < 0.0 {
            return [0.0; 4];
        }
        let left = (place as usize).min(self.columns.len() - 2);
        let ([a, b], share) = ([self.columns[left], self.columns[left + 1]], place - left as f64);
        let value = |k: usize| a[k] + share * (b[k] - a[k]);
        let slope = |k: usize| (b[k] - a[k]) / self.step_ps;
        [value(0), value(1), slope(0), slope(1)]
    }
}

/// Number of a pair whose second is not below its first.
fn pair(first: usize, second: usize) -> usize {
    first * (2 * COUNT - first - 1) / 2 + second
}

fn distance(n: usize) -> f64 {
    LEAST + STEP_OF_ENDS * n as f64
}

/// Light of a step of time, and light times the time since it began, in units of the response's width.
fn ring(ends: Ends, n: usize, unit: f64) -> [f64; 2] {
    let nearest: f64 = ends.iter().map(|end| end.min(0.0).powi(2)).sum();
    let mut sums = [0.0; 2];
    for part in 0..PARTS {
        let since = (n as f64 - 0.5 + (part as f64 + 0.5) / PARTS as f64) * unit;
        if since > 0.0 {
            let light = share(ends, (nearest + since).sqrt()) / PARTS as f64;
            sums[0] += light;
            sums[1] += light * since;
        }
    }
    sums
}

/// Share of a ring that is lit.
pub fn share(ends: Ends, radius: f64) -> f64 {
    // The ring beyond an edge spans so much to both sides of the edge's direction.
    let [first, second] = ends.map(|end| (end / radius).clamp(-1.0, 1.0).acos());
    let quarter = 0.5 * PI;
    let within = |from: f64, to: f64| (to.min(first) - from.max(-first)).max(0.0);
    let turned = |turn: f64| within(quarter - second + turn, quarter + second + turn);
    let both = turned(-TAU) + turned(0.0) + turned(TAU);
    (1.0 - (2.0 * first + 2.0 * second - both) / TAU).max(0.0)
}
