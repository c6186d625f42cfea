//! Patches with fewer distances than coordinates, and the pairs that would give more.

use std::collections::{BTreeMap, BTreeSet};

use super::Fields;
use crate::geometry::t2::Distances;
use crate::priors::campaign_fields::ByCampaign;
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
        let missing: Vec<String> = patches
            .iter()
            .filter(|other| **other != patch && !neighbours[&patch].contains(other))
            .flat_map(|&other| [(patch, other), (other, patch)])
            .map(|(lit, seen)| format!("({lit}, {seen})"))
            .collect();
        let listed = missing[..missing.len().min(LISTED)].join(" ");
        let more = if missing.len() > LISTED { " ..." } else { "" };
        lines.push(format!(
            "patch {patch} has distances to {} others (laser and patches), and a place in {dimensions} dimensions needs {dimensions}; no light was \
             found in these pairs (lit, seen): {listed}{more}; capture at least {} of them, or give the patch a `position_m`",
            neighbours[&patch].len(),
            dimensions - neighbours[&patch].len(),
        ));
    }
    lines
}
