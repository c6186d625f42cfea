//! Patches from their distances to patches in known places.

use std::collections::{BTreeMap, BTreeSet};

use super::{Context, start};
use crate::geometry::loss::Loss;
use crate::geometry::multilateration::{self, Candidate, Tie};
use crate::geometry::{Point, planes};
use crate::stages::stage::Rejection;
use crate::tables::{Distance, Hypothesis, Patch};
use crate::units::PatchId;

/// Places nearer than this many standard deviations of a distance are one.
const APART: f64 = 4.0;
/// A place whose loss is higher than the best by less than this (a log-likelihood ratio of 9) cannot be ruled out.
const LIKELY: f64 = 18.0;

/// Places for all patches that distances or hypotheses name beyond those `given`, as rows, and those that have none.
pub fn place(context: &Context, given: &[Patch], distances: &[Distance]) -> (Vec<Patch>, Vec<Rejection>) {
    let best = given.iter().filter(|patch| patch.alternative == 0);
    let mut points: BTreeMap<PatchId, Point> =
        best.map(|patch| (patch.patch, Point::new(patch.x_m, patch.y_m, patch.z_m))).collect();
    points.insert(0, Point::from(context.frame.source_m));
    let of_label = context.hypotheses.iter().filter_map(|hypothesis| hypothesis.patch);
    let named = distances.iter().flat_map(|distance| [distance.a, distance.b]).chain(of_label);
    let unknown: BTreeSet<PatchId> = named.filter(|patch| !points.contains_key(patch)).collect();
    let mut next_alternative = 1 + given.iter().map(|patch| patch.alternative).max().unwrap_or(0);
    let (mut rows, mut rejections) = (Vec::new(), Vec::new());
    for patch in unknown {
        let seen_from = |distance: &Distance| {
            let other = if distance.a == patch { distance.b } else { distance.a };
            let point = (distance.a == patch || distance.b == patch).then(|| points.get(&other))??;
            Some((distance.clone(), *point))
        };
        let neighbours: Vec<(Distance, Point)> = distances.iter().filter_map(seen_from).collect();
        let was_visible = |row: &Patch| row.patch == patch && &*row.kind == "visible";
        let is_visible = context.patches.iter().flatten().any(was_visible);
        // Of a visible patch, later light tells more than the few distances that left its place open.
        let mut places = if is_visible { Vec::new() } else { places(&neighbours, context) };
        let mut onsets: i32 = neighbours.iter().map(|(distance, _)| distance.onsets).sum();
        if places.is_empty() {
            let of_patch = context.hypotheses.iter().filter(|hypothesis| hypothesis.patch == Some(patch));
            let hypotheses: Vec<&Hypothesis> = of_patch.collect();
            onsets = hypotheses.first().map_or(0, |best| best.onsets.round() as i32);
            places = hypotheses.into_iter().map(of_label_at).collect();
        }
        let Some(first) = places.first() else {
            rejections.push(left_out(context, patch, &neighbours));
            continue;
        };
        let is_hidden = !is_visible && neighbours.iter().all(|(distance, _)| distance.bounces >= 3);
        let kind = if is_hidden { "hidden" } else { "visible" };
        rows.push(start(patch, kind, first.point, onsets));
        for other in &places[1..] {
            let (alternative, log_likelihood) = (next_alternative, Some(0.5 * (first.cost - other.cost)));
            rows.push(Patch { alternative, log_likelihood, ..start(patch, kind, other.point, onsets) });
            next_alternative += 1;
        }
    }
    (rows, rejections)
}

/// Where `label` has a patch; costs are twice its log-likelihood, as of distances.
fn of_label_at(hypothesis: &Hypothesis) -> Candidate {
    let point = Point::new(hypothesis.x_m, hypothesis.y_m, hypothesis.z_m);
    Candidate { point, cost: -2.0 * hypothesis.evidence }
}

/// Places that the distances to neighbours do not rule out, the chosen one first. Patches reflect to the side from
/// which they are lit. So of several places, the chosen one lies on the laser's side of the plane through its
/// neighbours.
fn places(neighbours: &[(Distance, Point)], context: &Context) -> Vec<Candidate> {
    context.cancel.check();
    let dimensions = usize::from(context.frame.dimensions);
    let mut sds_m: Vec<f64> = neighbours.iter().map(|(distance, _)| distance.sd_m).collect();
    sds_m.sort_by(f64::total_cmp);
    let Some(middle_m) = sds_m.get(sds_m.len() / 2) else { return Vec::new() };
    // A distance is half the way there and back.
    let there_and_back = |(distance, point): &(Distance, Point)| Tie::Path {
        from: *point,
        to: *point,
        length_m: 2.0 * distance.distance_m,
        sd_m: 2.0 * distance.sd_m,
    };
    let ties: Vec<Tie> = neighbours.iter().map(there_and_back).collect();
    let mut likely = multilateration::candidates(&ties, dimensions, APART * middle_m, Loss::Huber);
    let most = likely.first().map_or(0.0, |best| best.cost + LIKELY);
    likely.retain(|place| place.cost < most);
    let points: Vec<Point> = neighbours.iter().map(|(_, point)| *point).collect();
    let laser = Point::from(context.frame.source_m);
    if let Some(lit) = likely.iter().position(|place| !planes::is_across(&points, dimensions, place.point, laser)) {
        likely[..=lit].rotate_right(1);
    }
    likely
}

fn left_out(context: &Context, patch: PatchId, neighbours: &[(Distance, Point)]) -> Rejection {
    let dimensions = context.frame.dimensions;
    let to: Vec<String> = neighbours
        .iter()
        .map(|(distance, _)| if distance.a == patch { distance.b } else { distance.a }.to_string())
        .collect();
    let reason = if to.len() < usize::from(dimensions) {
        format!(
            "patch {patch} has distances to {} patches in known places ({}), too few for a place in {dimensions} dimensions, and is left out \
             here: capture more pairs over which its third bounces come",
            to.len(),
            to.join(", ")
        )
    } else {
        format!(
            "the distances of patch {patch} to patches {} leave its place open, since these lie in line, and it is left out here: capture pairs \
             with patches off that line",
            to.join(", ")
        )
    };
    Rejection::new(&context.campaign, reason)
}
