//! Patches with fewer distances than coordinates, and the pairs that would give more.

use std::collections::{BTreeMap, BTreeSet};

use super::Fields;
use super::hidden::Places;
use crate::geometry::t2::Distances;
use crate::priors::campaign_fields::ByCampaign;
use crate::tables::Label;
use crate::units::PatchId;

/// Pairs that a message lists at most.
const LISTED: usize = 12;

/// Why patches cannot be placed by their distances, one line for each. Patches that campaign.toml places, or gives a
/// ray, are no part of it.
pub fn too_few(fields: &ByCampaign<Fields>, direct: &Distances) -> Vec<String> {
    let dimensions = fields.values().map(|fields| fields.dimensions).max().unwrap_or(3);
    let mut neighbours: BTreeMap<PatchId, BTreeSet<PatchId>> = BTreeMap::new();
    for distance in &direct.distances {
        for (patch, other) in [(distance.a, distance.b), (distance.b, distance.a)] {
            neighbours.entry(patch).or_default().insert(other);
        }
    }
    let patches: Vec<PatchId> = neighbours.keys().copied().filter(|patch| *patch != 0).collect();
    let is_fixed =
        |patch: PatchId| fields.values().any(|fields| fields.anchors.contains(&patch) || fields.rays.contains(&patch));
    let mut lines = Vec::new();
    // So few patches have no shape: `embed` refuses them.
    if patches.len() < dimensions {
        return lines;
    }
    for &patch in patches.iter().filter(|patch| !is_fixed(**patch) && neighbours[patch].len() < dimensions) {
        let listed = listed(patch, &patches, |other| neighbours[&patch].contains(&other));
        lines.push(format!(
            "patch {patch} has distances to {} others (laser and patches), and a place in {dimensions} dimensions needs {dimensions}; no light was \
             found in these pairs (lit, seen): {listed}; capture at least {} of them, or give the patch a `position_m`",
            neighbours[&patch].len(),
            dimensions - neighbours[&patch].len(),
        ));
    }
    lines
}

/// Patches that have no place among the `places` that are given, and that no later light shows: why, one line for each.
pub fn open(fields: &ByCampaign<Fields>, places: &Places, labels: &[Label]) -> Vec<String> {
    let paths = || labels.iter().filter(|label| label.alternative == 0).filter_map(|label| label.path.as_deref());
    let visible: BTreeSet<PatchId> = labels.iter().flat_map(|label| [label.lit, label.seen]).collect();
    let shown: BTreeSet<PatchId> = paths().filter(|path| path.len() > 2).flatten().copied().collect();
    let patches: Vec<PatchId> = visible.iter().copied().collect();
    let line = |&patch: &PatchId| {
        let others = paths().filter(|path| path.len() == 2 && path.contains(&patch)).flatten().copied();
        let others: BTreeSet<PatchId> = others.filter(|other| *other != patch).collect();
        format!(
            "patch {patch} stays open: its light and that of others leave it more places than one can list (pairs with light: {}), and no later \
             light over it shows where it is; no light was found in these pairs (lit, seen): {}; capture some of them, or give the patch a \
             `position_m`",
            others.len(),
            listed(patch, &patches, |other| others.contains(&other)),
        )
    };
    let is_told = |patch: &PatchId| {
        fields.values().any(|fields| fields.anchors.contains(patch) || fields.mirrors.contains(patch))
    };
    let is_open = |patch: &&PatchId| !places.has(**patch) && !shown.contains(patch) && !is_told(patch);
    visible.iter().filter(is_open).map(line).collect()
}

/// The pairs of a patch with others without light, as (lit, seen).
fn listed(patch: PatchId, patches: &[PatchId], has_light: impl Fn(PatchId) -> bool) -> String {
    let missing: Vec<String> = patches
        .iter()
        .filter(|other| **other != patch && !has_light(**other))
        .flat_map(|&other| [(patch, other), (other, patch)])
        .map(|(lit, seen)| format!("({lit}, {seen})"))
        .collect();
    let more = if missing.len() > LISTED { " ..." } else { "" };
    missing[..missing.len().min(LISTED)].join(" ") + more
}
