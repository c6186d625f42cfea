//! Onsets read another way: light over another path, or one wide pulse in place of two, or two in place of one.
//!
//! `label` keeps what it did not take as alternatives. Most change nothing, since other onsets check each; one that
//! these hardly check may be what places a patch.

use std::collections::BTreeMap;

use super::model::Model;
use crate::geometry::footprint::Footprints;
use crate::geometry::maximum_likelihood::{Observation, Solution};
use crate::tables::{Label, Name};
use crate::units::PatchId;

/// An onset is hardly checked where it makes more than this share of what is known of its length: others check less
/// than the rest.
const OWN_SHARE: f64 = 0.3;
/// Of more onsets, other readings of single ones are not compared.
const READ_MAX: usize = 2000;

/// What tells one onset from another.
type Key<'a> = (&'a Name, &'a Name, PatchId, PatchId, &'a Option<Name>, i32);

/// Another way to read an onset.
pub struct Reading {
    /// Positions among the labels of those that it replaces.
    pub replaced: Vec<usize>,
    /// What stands in their place, shifts of footprints taken off.
    pub observations: Vec<Observation>,
    /// Log-likelihood against what `label` took, where it compared the samples too: of one pulse against two.
    pub log_likelihood: Option<f64>,
}

/// What `label` and the solution say of the onsets.
pub struct Onsets<'a> {
    /// Labels that were not taken.
    pub not_taken: &'a [Label],
    /// Of each label that was taken, its position among the observations of the solution.
    pub used: &'a [Option<usize>],
    /// Of each label that was taken, what it observes.
    pub observations: &'a [Observation],
}

impl Onsets<'_> {
    /// Other readings of the onsets that others hardly check; none of a great many onsets, since each costs a solution.
    pub fn readings(&self, model: &Model, solution: &Solution, footprints: &Footprints) -> Vec<Reading> {
        let Some(predicted_m2) = solution.predicted_variance_m2.as_ref().filter(|_| model.labels.len() <= READ_MAX)
        else {
            return Vec::new();
        };
        let is_unchecked = |n: usize| {
            let sd_m = self.observations[n].sd_m;
            self.used[n].is_some_and(|at| predicted_m2[at] > OWN_SHARE * sd_m * sd_m)
        };
        let mut taken: BTreeMap<Key, Vec<usize>> = BTreeMap::new();
        model.labels.iter().enumerate().for_each(|(n, label)| taken.entry(key(label)).or_default().push(n));
        let mut others: BTreeMap<Key, Vec<&Label>> = BTreeMap::new();
        for label in self.not_taken.iter().filter(|label| label.path.is_some() && model.has_patches_of(label)) {
            others.entry(key(label)).or_default().push(label);
        }
        let observed = |label: &Label| model.shifted_one(label, &model.observation(label), footprints, solution).0;
        let mut readings = Vec::new();
        for (key, others) in others {
            let Some(taken) = taken.get(&key).filter(|taken| taken.iter().any(|n| is_unchecked(*n))) else { continue };
            let part_of = |part: i32| taken.iter().copied().find(|n| model.labels[*n].part == part);
            for other in &others {
                let Some(replaced) = part_of(other.part).filter(|n| is_unchecked(*n)) else { continue };
                let observations = vec![observed(other)];
                readings.push(Reading { replaced: vec![replaced], observations, log_likelihood: None });
            }
            let losers = || others.iter().filter(|other| part_of(other.part).is_none());
            let parts: Vec<&&Label> = (0..=2).filter_map(|part| losers().find(|loser| loser.part == part)).collect();
            let Some(loser) = parts.first() else { continue };
            let likeliest = taken.iter().map(|n| model.labels[*n].probability).fold(f64::MIN_POSITIVE, f64::max);
            readings.push(Reading {
                replaced: taken.clone(),
                observations: parts.iter().map(|label| observed(label)).collect(),
                log_likelihood: Some((loser.probability / likeliest).ln().min(0.0)),
            });
        }
        readings
    }
}

fn key(label: &Label) -> Key<'_> {
    (&label.campaign, &label.sensor, label.lit, label.seen, &label.range, label.rank)
}
