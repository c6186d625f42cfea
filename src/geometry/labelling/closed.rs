//! Pairs of patches that exchange no light.

use periscope_cancel::Cancel;

use super::assignment::{Assignment, Prior};
use super::paths::{Graph, INDIRECT, Pairs};
use super::problem::{Options, SensorProfiles};
use super::scene::Scene;
use crate::hidden::facing;
use crate::units::PatchId;

/// Pairs whose direct light is more likely missing than seen, both ways, and those that were not captured and whose
/// walls let none pass. Third bounces may lie where the direct light would be, so that they are predicted too.
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
        if direct_probability(&assignment) > 0.5 {
            open.insert(view.profile.sorted_pair());
        } else if scene.has(&[view.profile.lit, view.profile.seen]) {
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
