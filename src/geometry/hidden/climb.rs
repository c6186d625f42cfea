//! A hidden surface's likelihood at a place, and the nearest place where it is largest.

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;

use super::surface::Surface;
use super::{Focus, Profile, blend, watched_count};
use crate::Point;

/// Arrivals further off than this many standard deviations were not made by the patch.
pub const GATE: f64 = 5.0;
/// Steps at most, and how little they move in the end, in standard deviations.
const STEPS: usize = 25;
const SETTLED: f64 = 1e-3;
/// First steps see all errors this much larger, so that a start some standard deviations off is no worse.
const WIDENED: [f64; 3] = [2.5, 1.8, 1.3];

/// What one surface is held against.
#[derive(Clone, Copy)]
pub struct View<'a> {
    pub foci: &'a [Focus],
    pub profiles: &'a [Profile],
    /// For each arrival of each profile what other paths leave of it.
    pub left: &'a [Vec<f64>],
    /// Clutter per metre.
    pub clutter_per_m: f64,
    /// Share of ways on which the surface makes an arrival.
    pub seen: f64,
    /// Probability that it shows in the profiles of a seen patch at all.
    pub shown: f64,
    pub dimensions: usize,
    pub surface: Surface,
    /// Lengths nearer than this may have one arrival together.
    pub blend_m: f64,
    pub cancel: &'a Cancel,
}

/// A surface at a point, and what the arrivals say of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    pub surface: Surface,
    pub point: Point,
    /// Log-likelihood ratio: the surface here over none.
    pub likelihood: f64,
    /// Inverse of its covariance.
    pub information: Matrix3<f64>,
    /// Arrivals that it makes, expected.
    pub arrivals: f64,
    /// Ways that could have recorded it.
    pub ways: usize,
    /// The same of the seen patches over which it shows, less those on which arrivals of other paths hide its own,
    /// expected.
    pub clear: f64,
}

/// What the profiles of one seen patch say.
#[derive(Clone, Copy)]
struct OfSeen {
    likelihood: f64,
    information: Matrix3<f64>,
    right: Vector3<f64>,
    arrivals: f64,
    clear: f64,
}

impl OfSeen {
    const NOTHING: Self = Self {
        likelihood: 0.0,
        information: Matrix3::from_array_storage(nalgebra::ArrayStorage([[0.0; 3]; 3])),
        right: Vector3::new(0.0, 0.0, 0.0),
        arrivals: 0.0,
        clear: 0.0,
    };

    /// Log-likelihood ratio where it may also not show at all, and the probability that it shows.
    fn shown(&self, probability: f64) -> (f64, f64) {
        // The larger term first, so that nothing overflows.
        let (shows, not) = (probability.ln() + self.likelihood, (1.0 - probability).ln());
        let sum = shows.max(not) + (-(shows - not).abs()).exp().ln_1p();
        (sum, (shows - sum).exp())
    }
}

impl View<'_> {
    /// The surface at `point`, and where its arrivals would rather have it.
    fn at(&self, point: Point, widened: f64) -> (Estimate, Vector3<f64>) {
        // Length and direction from each focus to a patch; none to what lies behind it.
        let arms: Vec<Option<(f64, Vector3<f64>)>> = self
            .foci
            .iter()
            .map(|focus| {
                let arm = point - focus.point;
                let length_m = arm.norm().max(f64::MIN_POSITIVE);
                focus.faces(point, 0.0).then(|| (length_m, arm / length_m))
            })
            .collect();
        let surface = self.surface;
        let mut place = Estimate {
            surface,
            point,
            likelihood: 0.0,
            information: Matrix3::zeros(),
            arrivals: 0.0,
            ways: 0,
            clear: 0.0,
        };
        let mut of_seen = vec![OfSeen::NOTHING; watched_count(self.profiles)];
        let root = (2.0 * std::f64::consts::PI).sqrt() * self.clutter_per_m;
        let mut near: Vec<(usize, f64, f64, f64)> = Vec::new();
        // Arrivals with the share of each that the profile's ways so far do not take.
        let mut taken: Vec<(usize, f64)> = Vec::new();
        for (profile, left) in self.profiles.iter().zip(self.left) {
            taken.clear();
            let of_seen = &mut of_seen[profile.watched];
            for way in &profile.ways {
                let legs = match surface {
                    Surface::Patch => {
                        let [a, b] = way.foci.map(|focus| arms[focus]);
                        a.zip(b).map(|(a, b)| (a.0 + b.0, a.1 + b.1))
                    }
                    Surface::Plane { .. } => surface.way(way.foci.map(|focus| &self.foci[focus]), point),
                };
                let Some((legs_m, slope)) = legs else { continue };
                let length_m = way.offset_m + legs_m;
                if !profile.holds(length_m) {
                    continue;
                }
                place.ways += 1;
                let clear = 1.0 - blend::hidden(&profile.arrivals, left, length_m, self.blend_m);
                of_seen.clear += clear;
                let (seen, scale) = (self.seen * clear, self.seen * clear / root);
                near.clear();
                let reach_m = GATE * widened * way.sd_m(profile.widest_m);
                let from = profile.arrivals.partition_point(|arrival| arrival.length_m < length_m - reach_m);
                let mut sum = 1.0 - seen;
                for (n, (arrival, left)) in profile.arrivals.iter().zip(left).enumerate().skip(from) {
                    let off_m = arrival.length_m - length_m;
                    if off_m > reach_m {
                        break;
                    }
                    let sd_m = widened * way.sd_m(arrival.sd_m);
                    let free: f64 = taken.iter().filter(|(other, _)| *other == n).map(|(_, free)| free).product();
                    let weight = scale * left * free / sd_m * (-0.5 * (off_m / sd_m).powi(2)).exp();
                    sum += weight;
                    near.push((n, weight, off_m, sd_m));
                }
                of_seen.likelihood += sum.ln();
                for &(n, weight, off_m, sd_m) in &near {
                    let share = weight / sum;
                    of_seen.arrivals += share;
                    of_seen.information += slope * slope.transpose() * (share / (sd_m * sd_m));
                    of_seen.right += slope * (share * off_m / (sd_m * sd_m));
                    if profile.ways.len() > 1 {
                        taken.push((n, 1.0 - share));
                    }
                }
            }
        }
        let mut right = Vector3::zeros();
        for of_seen in of_seen.iter().filter(|of_seen| of_seen.clear > 0.0) {
            let (likelihood, shown) = of_seen.shown(self.shown);
            place.likelihood += likelihood;
            place.information += of_seen.information * shown;
            right += of_seen.right * shown;
            place.arrivals += of_seen.arrivals * shown;
            place.clear += of_seen.clear * shown;
        }
        (place, right)
    }

    /// The surface at `point`.
    #[must_use]
    pub fn place(&self, point: Point) -> Estimate {
        self.at(point, 1.0).0
    }

    /// The likeliest place near `start`, by expectation and maximization with a Gauss-Newton step as the latter.
    #[must_use]
    pub fn climb(&self, start: Point) -> Estimate {
        let mut point = start;
        for widened in WIDENED {
            point = self.step(point, widened).map_or(point, |(_, step)| point + step);
        }
        let mut best = self.place(point);
        for _ in 0..STEPS {
            self.cancel.check();
            let Some((place, step)) = self.step(point, 1.0) else { break };
            if place.likelihood >= best.likelihood {
                best = place;
            }
            point += step;
            if step.dot(&(place.information * step)) < SETTLED * SETTLED {
                break;
            }
        }
        let last = self.place(point);
        if last.likelihood >= best.likelihood { last } else { best }
    }

    /// The place at a point, and the step from there.
    fn step(&self, point: Point, widened: f64) -> Option<(Estimate, Vector3<f64>)> {
        let (place, mut right) = self.at(point, widened);
        let mut information = place.information;
        let stiffness = information.trace();
        if self.dimensions == 2 {
            // Nothing moves along z.
            information[(2, 2)] += 1e6 * stiffness;
            right.z = 0.0;
        }
        information += Matrix3::identity() * (1e-6 * stiffness);
        let step = information.try_inverse()? * right;
        // Where few arrivals are near the step may go far: no further than what is seen of them.
        let longest_m = 3.0 * widened * self.profiles.iter().map(|profile| profile.widest_m).fold(0.0, f64::max);
        let length_m = step.norm();
        Some((place, if length_m > longest_m { step * (longest_m / length_m) } else { step }))
    }
}
