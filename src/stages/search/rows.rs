//! Patches of a search, and the place that is not sure enough, as rows and in words.

use nalgebra::Matrix3;

use super::pair_profile::PairProfile;
use crate::geometry::faint::Faint;
use crate::priors::{acquisition_time, covariances};
use crate::tables::{Hypothesis, Patch};
use crate::units::PatchId;

/// A place that was not sure enough, and how many times as many shots would make it so.
struct Declined {
    place: Faint,
    growth: f64,
}

/// A place that is one, and what errors that profiles share add to its covariance, m^2.
struct FoundPatch {
    patch: PatchId,
    place: Faint,
    gained_m2: Matrix3<f64>,
}

/// Patches, and the place that is not sure enough.
pub(super) struct SearchRows {
    patches: Vec<FoundPatch>,
    declined: Option<Declined>,
    /// Evidence that a patch needs.
    needed: f64,
    /// Shots of a capture, and hours that all captures took.
    shots: f64,
    hours: Option<f64>,
}

impl SearchRows {
    pub(super) fn new(pairs: &[PairProfile], needed: f64) -> Self {
        let mut shots: Vec<i32> = pairs.iter().map(|pair| pair.shots).collect();
        shots.sort_unstable();
        let shots = f64::from(shots.get(shots.len() / 2).copied().unwrap_or(0));
        Self { patches: Vec::new(), declined: None, needed, shots, hours: hours(pairs) }
    }

    /// Takes a place as a patch, if it is sure enough; otherwise as the one that is not. `gained_m2` is what the place
    /// gains in covariance by errors that profiles share.
    pub(super) fn add(&mut self, patch: PatchId, place: Faint, gained_m2: Matrix3<f64>, dimensions: usize) -> bool {
        let is_sure = place.evidence > self.needed;
        if is_sure {
            self.patches.push(FoundPatch { patch, place, gained_m2 });
        } else {
            self.declined = Some(Declined { place, growth: place.growth(self.needed, dimensions) });
        }
        is_sure
    }

    /// Rows of the patches.
    pub(super) fn patches(&self) -> impl Iterator<Item = Patch> {
        let row = |FoundPatch { patch, place, gained_m2 }: &FoundPatch| {
            covariances::patch_row(*patch, "hidden", place.point, Some(&(place.covariance + gained_m2)))
        };
        self.patches.iter().map(row)
    }

    /// Rows of all places.
    pub(super) fn hypotheses(&self) -> Vec<Hypothesis> {
        let accepted = self.patches.iter().map(|found| (Some(found.patch), &found.place, None));
        let declined = self.declined.iter().map(|declined| (None, &declined.place, Some(declined.growth)));
        let row = |(n, (patch, place, growth)): (usize, (Option<PatchId>, &Faint, Option<f64>))| {
            let evidence = [place.evidence, self.needed];
            Hypothesis {
                patch,
                shots_needed: growth.map(|growth| (growth * self.shots).ceil()),
                hours_needed: growth.and_then(|growth| Some(growth * self.hours?)),
                ..covariances::hypothesis_row(n as i32 + 1, place.point, &place.covariance, evidence, place.seen)
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
fn hours(pairs: &[PairProfile]) -> Option<f64> {
    let moments: Option<Vec<f64>> =
        pairs.iter().map(|pair| acquisition_time::seconds(pair.acquired_at.as_deref()?)).collect();
    let moments = moments?;
    let first = moments.iter().copied().fold(f64::INFINITY, f64::min);
    let last = moments.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let count = moments.len() as f64;
    (last > first).then(|| (last - first) * count / (count - 1.0) / 3600.0)
}
