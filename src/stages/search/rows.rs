//! Patches of a search, and the place that is not sure enough, as rows and in words.

use super::record::Record;
use crate::geometry::faint::Faint;
use crate::priors::acquisition_time;
use crate::tables::{Hypothesis, Patch};
use crate::units::PatchId;

/// A place that was not sure enough, and how many times as many shots would make it so.
struct Declined {
    place: Faint,
    growth: f64,
}

/// Patches, and the place that is not sure enough.
pub(super) struct SearchRows {
    patches: Vec<(PatchId, Faint)>,
    declined: Option<Declined>,
    /// Evidence that a patch needs.
    needed: f64,
    /// Shots of a capture, and hours that all captures took.
    shots: f64,
    hours: Option<f64>,
}

impl SearchRows {
    pub(super) fn new(records: &[Record], needed: f64) -> Self {
        let mut shots: Vec<i32> = records.iter().map(|record| record.shots).collect();
        shots.sort_unstable();
        let shots = f64::from(shots.get(shots.len() / 2).copied().unwrap_or(0));
        Self { patches: Vec::new(), declined: None, needed, shots, hours: hours(records) }
    }

    /// Takes a place as a patch, if it is sure enough; otherwise as the one that is not.
    pub(super) fn add(&mut self, patch: PatchId, place: Faint, dimensions: usize) -> bool {
        let is_sure = place.evidence > self.needed;
        if is_sure {
            self.patches.push((patch, place));
        } else {
            self.declined = Some(Declined { place, growth: place.growth(self.needed, dimensions) });
        }
        is_sure
    }

    /// Rows of the patches.
    pub(super) fn patches(&self) -> impl Iterator<Item = Patch> {
        self.patches.iter().map(|(patch, place)| {
            let cov = place.covariance;
            Patch {
                patch: *patch,
                kind: "hidden".into(),
                x_m: place.point.x,
                y_m: place.point.y,
                z_m: place.point.z,
                cov_xx_m2: Some(cov[(0, 0)]),
                cov_xy_m2: Some(cov[(0, 1)]),
                cov_xz_m2: Some(cov[(0, 2)]),
                cov_yy_m2: Some(cov[(1, 1)]),
                cov_yz_m2: Some(cov[(1, 2)]),
                cov_zz_m2: Some(cov[(2, 2)]),
                sd_m: Some(cov.trace().sqrt()),
                onsets: 0,
                chi2_dof: None,
                alternative: 0,
                log_likelihood: None,
            }
        })
    }

    /// Rows of all places.
    pub(super) fn hypotheses(&self) -> Vec<Hypothesis> {
        let accepted = self.patches.iter().map(|(patch, place)| (Some(*patch), place, None));
        let declined = self.declined.iter().map(|declined| (None, &declined.place, Some(declined.growth)));
        let row = |(n, (patch, place, growth)): (usize, (Option<PatchId>, &Faint, Option<f64>))| {
            let (point, cov) = (place.point, place.covariance);
            Hypothesis {
                hypothesis: n as i32 + 1,
                kind: "patch".into(),
                layer: 1,
                patch,
                alternative: 0,
                x_m: point.x,
                y_m: point.y,
                z_m: point.z,
                cov_xx_m2: cov[(0, 0)],
                cov_xy_m2: cov[(0, 1)],
                cov_xz_m2: cov[(0, 2)],
                cov_yy_m2: cov[(1, 1)],
                cov_yz_m2: cov[(1, 2)],
                cov_zz_m2: cov[(2, 2)],
                sd_m: cov.trace().sqrt(),
                normal_x: None,
                normal_y: None,
                normal_z: None,
                evidence: place.evidence,
                evidence_needed: self.needed,
                seen: place.seen,
                onsets: 0.0,
                shots_needed: growth.map(|growth| (growth * self.shots).ceil()),
                hours_needed: growth.and_then(|growth| Some(growth * self.hours?)),
            }
        };
        accepted.chain(declined).enumerate().map(row).collect()
    }

    /// What would show the place that was not sure enough, where more speaks for it than against.
    pub(super) fn message(&self) -> Option<String> {
        let Declined { place, growth } = self.declined.as_ref().filter(|declined| declined.place.evidence > 0.0)?;
        let hours = self.hours.map_or(String::new(), |hours| format!(", {:.2} h", growth * hours));
        Some(format!(
            "hidden patch near ({:.2}, {:.2}, {:.2}) m not sure: evidence {:.1} of {:.1}; about {growth:.1} times as many shots ({:.0} a capture{hours}) would do",
            place.point.x,
            place.point.y,
            place.point.z,
            place.evidence,
            self.needed,
            growth * self.shots
        ))
    }
}

/// Hours that the captures took, from when each of them began; `None` where that is not known.
fn hours(records: &[Record]) -> Option<f64> {
    let moments: Option<Vec<f64>> =
        records.iter().map(|record| acquisition_time::seconds(record.acquired_at.as_deref()?)).collect();
    let moments = moments?;
    let first = moments.iter().copied().fold(f64::INFINITY, f64::min);
    let last = moments.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let count = moments.len() as f64;
    (last > first).then(|| (last - first) * count / (count - 1.0) / 3600.0)
}
