//! Arrivals that may be the light of more than one path.
//!
//! Pulses that the response does not resolve make one arrival at the centroid of their light. It is off its own path's
//! time towards the other's, by up to the time d between both times the other's share of the light. The class of
//! another path gives its chance to shine there and its strength: the chance and the median strength of paths of as
//! many bounces over as many hidden patches in the campaign. With a chance c before, an arrival that is off its own
//! path by r has the light of both with the odds
//!
//! ```text
//! c / (1 - c) * flat(r; 0 to m) / N(r; 0, sd^2),    m = d min(1, 2 s / S)
//! ```
//!
//! with the strengths s of the other path and S of the arrival. So an arrival that lies where its own path has it is
//! hardly a blend, nor is it far off if it is one. Its error is some m / 2, but no more than it is off, where that is
//! known. A path with an arrival of its own is none of them: `deconvolve` gave pulses that it resolved the right
//! errors.

use std::collections::BTreeMap;

use super::chances::{Chances, Class};
use super::problem::{Arrival, Profile, SensorProfiles, Verdicts};
use super::scene::Prediction;
use crate::association::Candidate;
use crate::median::median;

/// How strong light of each class is.
pub(super) struct Blends<'a> {
    pub(super) chances: &'a Chances,
    /// Median signal-to-noise ratio by class.
    pub(super) snrs: BTreeMap<Class, f64>,
    /// Pulses further apart make two arrivals.
    pub(super) reach_ps: f64,
}

impl<'a> Blends<'a> {
    /// From labels that take each arrival for single.
    pub(super) fn learned(
        chances: &'a Chances,
        reach_ps: f64,
        sensors: &[SensorProfiles],
        verdicts: &[Verdicts],
    ) -> Self {
        let mut all: BTreeMap<Class, Vec<f64>> = BTreeMap::new();
        for (sensor, verdicts) in sensors.iter().zip(verdicts) {
            let arrivals = sensor.profiles.iter().flat_map(|profile| &profile.arrivals);
            for (arrival, verdicts) in arrivals.zip(verdicts.iter().flatten()) {
                if let Some(path) = verdicts.first().and_then(|best| best.path.as_ref()) {
                    all.entry(chances.class(path)).or_default().push(arrival.snr);
                }
            }
        }
        Self { chances, snrs: all.into_iter().map(|(class, snrs)| (class, median(snrs))).collect(), reach_ps }
    }

    /// Standard deviation that the light of other paths adds to each arrival of a profile, the first of its candidates
    /// taken for its own path.
    pub(super) fn sds_ps(
        &self,
        profile: &Profile,
        predictions: &[Prediction],
        candidates: &[Vec<Candidate>],
    ) -> Vec<f64> {
        let own: Vec<Option<usize>> =
            candidates.iter().map(|candidates| candidates.first().map(|best| best.path)).collect();
        let free: Vec<usize> = (0..predictions.len()).filter(|&path| !own.contains(&Some(path))).collect();
        let arrivals = profile.arrivals.iter().zip(&own);
        arrivals.map(|(arrival, own)| self.sd_ps(arrival, *own, &free, predictions)).collect()
    }

    /// The same of one arrival; `free` are the paths without an arrival of their own.
    fn sd_ps(&self, arrival: &Arrival, own: Option<usize>, free: &[usize], predictions: &[Prediction]) -> f64 {
        let is_near = |k: &usize| (predictions[*k].time.time_ps - arrival.time_ps).abs() < self.reach_ps;
        let others: Vec<usize> = free.iter().copied().filter(is_near).collect();
        // An arrival that nothing explains may be the strongest light near it, pulled away by the rest.
        let stronger = |a: &usize, b: &usize| self.snr(&predictions[*a]).total_cmp(&self.snr(&predictions[*b]));
        let Some(own) = own.or_else(|| others.iter().copied().max_by(stronger)) else { return 0.0 };
        let others = others.into_iter().filter(|&k| k != own);
        others.map(|k| self.variance_ps2(arrival, &predictions[own], &predictions[k])).fold(0.0, f64::max).sqrt()
    }

    /// Variance that the light of one other path adds to an arrival of its own path.
    fn variance_ps2(&self, arrival: &Arrival, own: &Prediction, other: &Prediction) -> f64 {
        let off_ps = arrival.time_ps - own.time.time_ps;
        let sd_ps = arrival.sd_ps.hypot(own.time.sd_ps);
        let share = (2.0 * self.snr(other) / arrival.snr).min(1.0);
        let pull_ps = share * (other.time.time_ps - own.time.time_ps);
        let error_ps = (0.5 * pull_ps.abs()).min(off_ps.hypot(sd_ps));
        blend_probability(self.chances.of(&other.path), off_ps, sd_ps, pull_ps) * error_ps.powi(2)
    }

    /// Expected strength of a path; 0 in a class that shows nowhere.
    fn snr(&self, prediction: &Prediction) -> f64 {
        self.snrs.get(&self.chances.class(&prediction.path)).copied().unwrap_or(0.0)
    }
}

/// Probability that an arrival `off_ps` off its own path also has light of another path. That path shines with
/// probability `chance` and would pull the arrival by up to `pull_ps`.
fn blend_probability(chance: f64, off_ps: f64, sd_ps: f64, pull_ps: f64) -> f64 {
    let root = (2.0 * std::f64::consts::PI).sqrt() * sd_ps;
    let normal = |off_ps: f64| (-0.5 * (off_ps / sd_ps).powi(2)).exp();
    let (low_ps, high_ps) = (pull_ps.min(0.0), pull_ps.max(0.0));
    let both = chance * (normal(off_ps - off_ps.clamp(low_ps, high_ps)) / (root + pull_ps.abs()));
    let single = (1.0 - chance) * normal(off_ps) / root;
    // Neither where the arrival lies on the other side.
    if both + single > 0.0 { both / (both + single) } else { 0.0 }
}
