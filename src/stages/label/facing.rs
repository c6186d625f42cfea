//! Which way the walls of visible patches face, and whether these tell where a hidden patch is.

use super::scene::Scene;
use crate::geometry::Point;
use crate::geometry::hidden::{Focus, facing};
use crate::stages::stage::Rejection;
use crate::tables::Onset;
use crate::units::PatchId;

pub(super) fn in_line(onset: &Onset, visible: &[PatchId], dimensions: usize) -> Rejection {
    let (line, turn, wanted) = if dimensions == 2 {
        ("in one point", "that point", "another place")
    } else {
        ("in one line", "that line", "off that line")
    };
    let reason = format!(
        "the {} visible patches with known places lie {line}: hidden patches are known but for a turn about {turn}, and are not looked for;          light and see a patch in {wanted}",
        visible.len()
    );
    Rejection { campaign: onset.campaign.clone(), file: None, segment: None, byte_offset: None, reason }
}

/// Visible patches with the sides of their walls that are lit.
pub(super) fn foci(scene: &Scene, visible: &[PatchId], source: Point, dimensions: usize) -> Vec<Focus> {
    let points: Vec<Point> = visible.iter().map(|patch| scene.points[patch]).collect();
    let normals: Vec<_> = visible.iter().map(|patch| scene.normals.get(patch).copied()).collect();
    facing::fronts(&points, &normals, source, dimensions)
}
