//! Which way the walls of visible patches face, and whether these tell where a hidden patch is.

use nalgebra::{Matrix3, Vector3};

use super::scene::Scene;
use crate::geometry::hidden::Focus;
use crate::geometry::{Point, planes};
use crate::stages::stage::Rejection;
use crate::tables::Onset;
use crate::units::PatchId;

/// A plane through points that are off it by less than this share of its extent has two sides, and so has a line.
const FLAT: f64 = 1e-3;

/// Standard deviations of points along three axes at right angles, least first, with the first of the axes; in flatland nothing lies across it.
fn extents_m(points: &[Point]) -> ([f64; 3], Vector3<f64>) {
    let middle = points.iter().map(|point| point.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let spread = |point: &Point| (point.coords - middle) * (point.coords - middle).transpose();
    let axes = points.iter().map(spread).sum::<Matrix3<f64>>().symmetric_eigen();
    let mut extents_m: [f64; 3] = axes.eigenvalues.map(|value| (value.max(0.0) / points.len() as f64).sqrt()).into();
    extents_m.sort_by(f64::total_cmp);
    (extents_m, axes.eigenvectors.column(axes.eigenvalues.imin()).into())
}

/// Whether points lie in no line (in flatland in no point): else a hidden patch may turn about it.
pub(super) fn spans(points: &[Point], dimensions: usize) -> bool {
    if points.is_empty() {
        return false;
    }
    let ([_, middle_m, most_m], _) = extents_m(points);
    if dimensions == 2 { most_m > 0.0 } else { middle_m > FLAT * most_m }
}

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

/// Visible patches with the sides of their walls that are lit: of known normals, or of the one plane that all lie on (in flatland one line).
pub(super) fn foci(scene: &Scene, visible: &[PatchId], source: Point, dimensions: usize) -> Vec<Focus> {
    let points: Vec<Point> = visible.iter().map(|patch| scene.points[patch]).collect();
    let wall = one_wall(&points, dimensions);
    let focus = |(patch, point): (&PatchId, &Point)| {
        let to_source = (source - point).try_normalize(f64::MIN_POSITIVE)?;
        let normal = scene.normals.get(patch).copied().or(wall)?;
        let side = normal.dot(&to_source);
        (side.abs() > FLAT).then(|| normal * side.signum())
    };
    visible.iter().zip(&points).map(|at| Focus { point: *at.1, normal: focus(at) }).collect()
}

/// Normal of the plane (in flatland the line) on which all points lie.
fn one_wall(points: &[Point], dimensions: usize) -> Option<Vector3<f64>> {
    let ([least_m, middle_m, most_m], across) = extents_m(points);
    if dimensions == 2 {
        // Nothing lies across flatland: of its two axes the middle one.
        let (_, normal) = planes::nearest(points, dimensions);
        return (middle_m <= FLAT * most_m).then_some(normal);
    }
    (least_m <= FLAT * most_m).then_some(across)
}
