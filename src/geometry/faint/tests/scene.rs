//! Scenes with a weak hidden patch, as scores. Shares no code with the search.

use nalgebra::{Unit, Vector3};
use periscope_cancel::Cancel;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::super::{Profile, Room};
use crate::Point;
use crate::hidden::Focus;

/// Distance of two scores, and standard deviation of a Gaussian response, as lengths: 10 ps, and 250 ps at half
/// maximum.
const STEP_M: f64 = 0.003;
const RESPONSE_M: f64 = 0.032;
/// Records end so far behind the shortest way.
const WINDOW_M: f64 = 4.6;

/// How strong the pulses of a patch are relative to one another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strengths {
    /// As light falls off over both legs, and with four cosines.
    Physical,
    /// All alike.
    Alike,
}

/// Scores of all profiles of `visible` patches on two walls, and the hidden patch, whose root-mean-square
/// signal-to-noise ratio in a profile is `snr`.
pub fn draw(visible: usize, snr: f64, strengths: Strengths, seed: u64) -> (Vec<Profile>, Room, Point) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let foci: Vec<Focus> = (0..visible)
        .map(|k| {
            let (along, z) = (rng.random_range(0.0..1.6), rng.random_range(-0.8..0.8));
            let is_first = k.is_multiple_of(2);
            let point = if is_first { Point::new(along, 0.0, z) } else { Point::new(0.0, along, z) };
            Focus { point, normal: Some(if is_first { Vector3::y() } else { Vector3::x() }) }
        })
        .collect();
    let hidden = Point::new(rng.random_range(0.8..2.0), rng.random_range(0.8..1.8), rng.random_range(-0.4..0.4));
    let mut tilt = || -> f64 { rng.random_range(-0.3..0.3) };
    let front = Unit::new_normalize(Vector3::new(-1.0 + tilt(), -1.0 + tilt(), tilt()));
    let pairs: Vec<[usize; 2]> = (0..visible).flat_map(|a| (0..visible).map(move |b| [a, b])).collect();
    let leg = |focus: &Focus| {
        let arm = hidden - focus.point;
        let cosines = focus.normal.unwrap().dot(&arm) * -front.dot(&arm) / arm.norm_squared();
        if strengths == Strengths::Alike { 1.0 } else { cosines.max(0.0) / arm.norm_squared() }
    };
    let light: Vec<f64> = pairs.iter().map(|[a, b]| leg(&foci[*a]) * leg(&foci[*b])).collect();
    let usual = (light.iter().map(|light| light * light).sum::<f64>() / light.len() as f64).sqrt();
    let profiles = pairs
        .iter()
        .zip(&light)
        .map(|([a, b], light)| {
            let (from, to) = (foci[*a].point, foci[*b].point);
            let length_m = (hidden - from).norm() + (hidden - to).norm();
            let scores = noise((WINDOW_M / STEP_M) as usize, &mut rng);
            let score = |(k, noise): (usize, f64)| {
                let off = ((from - to).norm() + k as f64 * STEP_M - length_m) / RESPONSE_M;
                noise + snr * light / usual * (-0.25 * off * off).exp()
            };
            let scores: Vec<f64> = scores.into_iter().enumerate().map(score).collect();
            Profile {
                foci: [*a, *b],
                low_m: (from - to).norm(),
                step_m: STEP_M,
                gains: vec![1.0; scores.len()],
                scores,
            }
        })
        .collect();
    (profiles, Room { foci, dimensions: 3, width_m: 2.355 * RESPONSE_M, cancel: Cancel::never() }, hidden)
}

/// White noise behind a matched filter.
fn noise(count: usize, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let reach = (5.0 * RESPONSE_M / STEP_M) as usize;
    let white: Vec<f64> = (0..count + 2 * reach).map(|_| StandardNormal.sample(rng)).collect();
    let response: Vec<f64> =
        (0..=2 * reach).map(|k| (-0.5 * ((k as f64 - reach as f64) * STEP_M / RESPONSE_M).powi(2)).exp()).collect();
    let norm = response.iter().map(|value| value * value).sum::<f64>().sqrt();
    let filtered =
        |window: &[f64]| window.iter().zip(&response).map(|(white, value)| white * value).sum::<f64>() / norm;
    white.windows(response.len()).take(count).map(filtered).collect()
}
