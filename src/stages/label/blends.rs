//! Onsets that may be the light of more than one path.
//!
//! Pulses that the response does not tell apart make one onset at the centroid of their light: off its own path's time towards the other's, by up to the time d between both times the
//! other's share of the light. Whether another path shines there at all its class tells, and how strongly: chance and median strength of paths of as many bounces over as many hidden
//! patches in the campaign. With a chance c before, an onset that is off its own path by r has the light of both with the odds
//!
//! ```text
//! c / (1 - c) * flat(r; 0 to m) / N(r; 0, sd^2),    m = d min(1, 2 s / S)
//! ```
//!
//! with the strengths s of the other path and S of the onset: an onset that lies where its own path has it is hardly a blend, nor is it far off if it is one. Its error is some m / 2, but no
//! more than it is off, where that is known. A path that has an onset of its own is none of them: what `deconvolve` told apart it gave the right errors.

use std::collections::BTreeMap;

use super::chances::Chances;
use super::predicted::Prediction;
use super::{OfSensor, Verdicts, sd_ps};
use crate::geometry::association::Candidate;
use crate::tables::Onset;
use crate::units::PatchId;

/// How strong light of each class is.
pub(super) struct Blends<'a> {
    pub(super) chances: &'a Chances,
    /// Median signal-to-noise ratio by class.
    pub(super) snrs: BTreeMap<(usize, usize), f64>,
    /// Pulses further apart make two onsets.
    pub(super) reach_ps: f64,
}

impl<'a> Blends<'a> {
    /// From labels that were given without regard to it.
    pub(super) fn learned(chances: &'a Chances, reach_ps: f64, sensors: &[OfSensor], verdicts: &[Verdicts]) -> Self {
        let mut all: BTreeMap<(usize, usize), Vec<f64>> = BTreeMap::new();
        for (sensor, verdicts) in sensors.iter().zip(verdicts) {
            for (onset, verdicts) in sensor.profiles.iter().copied().flatten().zip(verdicts.iter().flatten()) {
                if let Some(path) = verdicts.first().and_then(|best| best.path.as_ref()) {
                    all.entry(chances.class(path)).or_default().push(onset.snr);
                }
            }
        }
        let median = |(class, mut snrs): ((usize, usize), Vec<f64>)| {
            snrs.sort_by(f64::total_cmp);
            (class, snrs[snrs.len() / 2])
        };
        Self { chances, snrs: all.into_iter().map(median).collect(), reach_ps }
    }

    /// Standard deviation that the light of other paths adds to each onset of a profile, given what each was taken for.
    pub(super) fn sds_ps(&self, profile: &[Onset], predictions: &[Prediction], found: &[Vec<Candidate>]) -> Vec<f64> {
        let taken: Vec<Option<usize>> =
            found.iter().map(|candidates| candidates.first().map(|best| best.path)).collect();
        let of_onset = |(onset, own): (&Onset, &Option<usize>)| {
            let is_free = |k: usize| !taken.contains(&Some(k));
            let is_near = |k: &usize| (predictions[*k].time.time_ps - onset.time_ps).abs() < self.reach_ps;
            let others: Vec<usize> = (0..predictions.len()).filter(|&k| is_free(k)).filter(is_near).collect();
            // An onset that nothing explains may be the strongest light near it, pulled away by the rest.
            let stronger = |a: &usize, b: &usize| self.snr(*a, predictions).total_cmp(&self.snr(*b, predictions));
            let Some(own) = own.or_else(|| others.iter().copied().max_by(stronger)) else { return 0.0 };
            let off_ps = onset.time_ps - predictions[own].time.time_ps;
            let own_sd_ps = sd_ps(onset).hypot(predictions[own].time.sd_ps);
            let variance_ps2 = |&k: &usize| {
                let share = (2.0 * self.snr(k, predictions) / onset.snr).min(1.0);
                let pull_ps = share * (predictions[k].time.time_ps - predictions[own].time.time_ps);
                let error_ps = (0.5 * pull_ps.abs()).min(off_ps.hypot(own_sd_ps));
                self.probability(k, predictions, off_ps, own_sd_ps, pull_ps) * error_ps.powi(2)
            };
            others.iter().filter(|&&k| k != own).map(variance_ps2).fold(0.0, f64::max).sqrt()
        };
        profile.iter().zip(&taken).map(of_onset).collect()
    }

    /// Probability that an onset which lies off its own path has light of path k too, which would pull it by up to `pull_ps`.
    fn probability(&self, k: usize, predictions: &[Prediction], off_ps: f64, sd_ps: f64, pull_ps: f64) -> f64 {
        let root = (2.0 * std::f64::consts::PI).sqrt() * sd_ps;
        let normal = |off_ps: f64| (-0.5 * (off_ps / sd_ps).powi(2)).exp();
        let (low_ps, high_ps) = (pull_ps.min(0.0), pull_ps.max(0.0));
        let blended = normal(off_ps - off_ps.clamp(low_ps, high_ps)) / (root + pull_ps.abs());
        let chance = self.chances.of(&predictions[k].path);
        let single = (1.0 - chance) * normal(off_ps) / root;
        let both = chance * blended;
        // Neither where the onset lies on the other side.
        if both + single > 0.0 { both / (both + single) } else { 0.0 }
    }

    /// Expected strength of a path; none of a class of which nothing was seen.
    fn snr(&self, k: usize, predictions: &[Prediction]) -> f64 {
        let path: &Vec<PatchId> = &predictions[k].path;
        self.snrs.get(&self.chances.class(path)).copied().unwrap_or(0.0)
    }
}
