//! Companions of onsets: light over one more patch than their own path leads over, which comes so soon behind that both
//! make one onset.

use std::collections::{BTreeMap, BTreeSet};

use super::model::Model;
use crate::geometry::Point;
use crate::geometry::companion::Strengths;
use crate::tables::{Label, Name};
use crate::units::PatchId;

/// Light further behind than so many times what the response resolves makes an onset of its own.
const REACH: f64 = 2.0;
/// Light of this signal-to-noise ratio is seen as an onset, also where all that have one are stronger.
const SEEN_SNR: f64 = 10.0;

/// What tells one profile from another.
pub type Key<'a> = (&'a Name, &'a Name, PatchId, PatchId, &'a Option<Name>);

/// Light that may come behind the direct light of profiles.
pub struct Companions<'a> {
    model: &'a Model<'a>,
    points: &'a [Point],
    profiles: BTreeMap<Key<'a>, Vec<&'a Label>>,
    /// Pairs whose profiles have light, but none of the pair's own path: what lies between shadows the leg.
    dark: BTreeSet<[PatchId; 2]>,
    /// What the response resolves.
    resolved_ps: f64,
    /// Over visible and over hidden patches.
    strengths: [Strengths; 2],
    /// Signal-to-noise ratio of the weakest light that makes an onset.
    least_snr: f64,
}

impl<'a> Companions<'a> {
    /// Of all labels, with patches at `points`; pulses `resolved_ps` apart make two onsets.
    pub fn new(model: &'a Model<'a>, points: &'a [Point], resolved_ps: f64) -> Self {
        let profiles = profiles(model.labels);
        let is_dark = |labels: &&Vec<&Label>| !labels.iter().any(|label| is_direct(label));
        let pair = |labels: &Vec<&Label>| [labels[0].lit, labels[0].seen];
        let dark = profiles.values().filter(is_dark).map(pair).flat_map(|[a, b]| [[a, b], [b, a]]).collect();
        let least_snr = model.labels.iter().map(|label| label.snr).fold(SEEN_SNR, f64::min);
        let strengths = [Strengths::learned(&[]); 2];
        let mut all = Self { model, points, profiles, dark, resolved_ps, strengths, least_snr };
        all.strengths = [false, true].map(|hidden| Strengths::learned(&all.ratios(hidden)));
        all
    }

    /// Companions of an onset of direct light: by how much longer their paths are, and how strong such light is. Those
    /// with an onset of their own are none.
    pub fn of(&self, direct: &Label) -> Vec<(f64, Strengths)> {
        let reach_m = self.model.fields(direct).medium.path_m(REACH * self.resolved_ps);
        let is_near = |(_, longer_m): &(PatchId, f64)| *longer_m < reach_m;
        let has_none = |(over, _): &(PatchId, f64)| self.own(direct, *over).is_none();
        let light = |(over, longer_m): (PatchId, f64)| (longer_m, self.strengths[usize::from(self.is_hidden(over))]);
        self.longer(direct).filter(is_near).filter(has_none).map(light).collect()
    }

    /// Strength of the weakest light that makes an onset of its own, beside that of an onset.
    pub fn least(&self, direct: &Label) -> f64 {
        (self.least_snr / direct.snr).min(1.0)
    }

    /// Patches that light of a direct path may go over, and by how much longer that is, m.
    fn longer(&self, direct: &'a Label) -> impl Iterator<Item = (PatchId, f64)> {
        let Label { lit, seen, .. } = *direct;
        let ends = [lit, seen].map(|end| self.point(end));
        let patches = self.model.patches.iter().zip(self.points);
        let is_open = move |end: PatchId, over: PatchId| !self.dark.contains(&[end, over]);
        let others = patches.filter(move |(over, _)| **over != lit && **over != seen);
        let open = others.filter(move |(over, _)| is_open(lit, **over) && is_open(seen, **over));
        open.map(move |(over, point)| {
            let [first, last] = ends;
            (*over, (point - first).norm() + (last - point).norm() - (last - first).norm())
        })
    }

    /// Strengths of the light over hidden or over visible patches that comes late enough to make onsets of its own,
    /// beside that of the direct light.
    fn ratios(&self, hidden: bool) -> Vec<Option<f64>> {
        let end_ps = self.model.labels.iter().map(|label| label.time_ps).fold(0.0, f64::max);
        let mut ratios = Vec::new();
        for labels in self.profiles.values() {
            self.model.context.cancel.check();
            for direct in labels.iter().filter(|label| is_direct(label)) {
                let medium = self.model.fields(direct).medium;
                for (over, longer_m) in self.longer(direct).filter(|(over, _)| self.is_hidden(*over) == hidden) {
                    let (later_ps, own) = (medium.time_ps(longer_m), self.own(direct, over));
                    let due_ps = direct.time_ps + later_ps;
                    // Light of another path in its place says nothing of it.
                    let is_near = |label: &&&Label| (label.time_ps - due_ps).abs() < self.resolved_ps;
                    let is_alone = own.is_some() || !labels.iter().any(|label| is_near(&label));
                    if later_ps > REACH * self.resolved_ps && due_ps < end_ps && is_alone {
                        ratios.push(own.map(|own| own.snr / direct.snr));
                    }
                }
            }
        }
        ratios
    }

    /// The onset of the light over a patch in the same profile.
    fn own(&self, direct: &Label, over: PatchId) -> Option<&Label> {
        let path = [direct.lit, over, direct.seen];
        self.profiles[&key(direct)].iter().copied().find(|label| label.path.as_deref() == Some(&path))
    }

    fn point(&self, patch: PatchId) -> Point {
        self.points[self.model.place(patch)]
    }

    fn is_hidden(&self, patch: PatchId) -> bool {
        self.model.kind(patch) == "hidden"
    }
}

/// Labels of each profile.
pub fn profiles(labels: &[Label]) -> BTreeMap<Key<'_>, Vec<&Label>> {
    let mut profiles: BTreeMap<Key, Vec<&Label>> = BTreeMap::new();
    labels.iter().for_each(|label| profiles.entry(key(label)).or_default().push(label));
    profiles
}

pub fn key(label: &Label) -> Key<'_> {
    (&label.campaign, &label.sensor, label.lit, label.seen, &label.range)
}

/// Whether an onset is light straight from the lit patch to the seen one.
fn is_direct(label: &Label) -> bool {
    let Label { lit, seen, .. } = *label;
    label.path.as_deref().is_some_and(|path| if lit == seen { path == [lit] } else { path == [lit, seen] })
}
