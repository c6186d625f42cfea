//! Pairs of patches that exchange no light.

use periscope_cancel::Cancel;

use super::assignment::{Assignment, Prior};
use super::paths::{Graph, INDIRECT, Pairs};
use super::problem::{Arrival, Options, SensorProfiles, View};
use super::scene::Scene;
use crate::association::Candidate;
use crate::hidden::facing;
use crate::units::PatchId;

/// Pairs whose direct light is more likely missing than seen, both ways, and those that were not captured and whose
/// walls let none pass. Third bounces may lie where the direct light would be, so that they are predicted too. An
/// arrival near the direct light that no path explains may be a blend of it: such a pair is not shown to be dark. (Were
/// it closed, all third bounces over it would show hidden patches where visible ones are.)
pub(super) fn closed(
    scene: &Scene,
    sensor: &SensorProfiles,
    visible: &[PatchId],
    options: &Options,
    cancel: &Cancel,
) -> Pairs {
    if options.bounces < INDIRECT {
        return Pairs::new();
    }
    let mut closed = behind_walls(scene, sensor, visible);
    for profile in &sensor.profiles {
        closed.remove(&profile.sorted_pair());
    }
    let mut open = Pairs::new();
    let graph = Graph::new(scene, sensor, &Pairs::new(), INDIRECT, cancel);
    for view in sensor.views().filter(|view| view.profile.lit != view.profile.seen) {
        let assignment = Assignment::new(&graph, view, INDIRECT, options.clutter_per_ns, &Prior::Even);
        let are_placed = scene.has(&[view.profile.lit, view.profile.seen]);
        let may_be_blended = || are_placed && may_be_blended(scene, &assignment, view, options.blend_ps);
        if direct_probability(&assignment) > 0.5 || may_be_blended() {
            open.insert(view.profile.sorted_pair());
        } else if are_placed {
            closed.insert(view.profile.sorted_pair());
        }
    }
    closed.retain(|pair| !open.contains(pair));
    closed
}

/// Pairs of visible patches, one behind the other's wall.
fn behind_walls(scene: &Scene, sensor: &SensorProfiles, visible: &[PatchId]) -> Pairs {
    let foci = scene.foci(visible, sensor.source, sensor.dimensions);
    let mut pairs = Pairs::new();
    for (n, (a, focus)) in visible.iter().zip(&foci).enumerate() {
        let others = visible.iter().zip(&foci).skip(n + 1);
        pairs.extend(others.filter(|(_, other)| !facing::exchange_light(focus, other)).map(|(b, _)| (*a, *b)));
    }
    pairs
}

/// Probability that one of the arrivals is direct light.
fn direct_probability(assignment: &Assignment) -> f64 {
    let candidates = assignment.candidates.iter().flatten();
    let direct = candidates.filter(|candidate| assignment.predictions[candidate.path].path.len() == 2);
    direct.map(|candidate| candidate.probability).sum()
}

/// Whether an arrival within `blend_ps` of the direct light is more likely none of the paths than any of them.
fn may_be_blended(scene: &Scene, assignment: &Assignment, view: View, blend_ps: f64) -> bool {
    let direct_ps = scene.predict(view.profile.direct(), view).time.time_ps;
    let is_near = |arrival: &Arrival| view.off_ps(arrival.time_ps, direct_ps) < blend_ps;
    let explained = |candidates: &[Candidate]| candidates.iter().map(|candidate| candidate.probability).sum::<f64>();
    let mut arrivals = view.profile.arrivals.iter().zip(&assignment.candidates);
    arrivals.any(|(arrival, candidates)| is_near(arrival) && explained(candidates) < 0.5)
}
