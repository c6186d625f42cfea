//! Profiles as lengths over hidden patches: what all paths of a profile have in common is taken off.

use std::iter;

use nalgebra::Vector3;

use super::chances::Chances;
use super::paths::Graph;
use super::problem::{Arrival, SensorProfiles, View};
use super::scene::{DEEP, Scene};
use crate::hidden::{self, Path, Way};
use crate::units::PatchId;

/// Arrivals whose reading is less sure are not searched for hidden patches.
const SURE: f64 = 0.95;
/// Bounces of paths over patches in place that a search for third bounces predicts: later ones are too faint to matter.
const FOURTH: usize = 4;

/// Profiles of all sensors as third bounces over a hidden patch show them; those whose patches are in place.
pub(super) fn profiles(
    sensors: &[SensorProfiles],
    graphs: &[Graph],
    chances: &Chances,
    visible: &[PatchId],
) -> Vec<hidden::Profile> {
    each(sensors, graphs, |legs, graph, span_m| {
        let focus = |patch: PatchId| visible.binary_search(&patch).ok();
        let foci = [focus(legs.view.profile.lit)?, focus(legs.view.profile.seen)?];
        let paths = legs.paths(graph, FOURTH, chances);
        Some(hidden::Profile::new(foci, legs.arrivals(span_m), paths, span_m))
    })
}

/// Profiles as fifth bounces show them, over two of the patches `shown_by`, which are the foci, and a hidden one
/// between.
pub(super) fn deep_profiles(
    sensors: &[SensorProfiles],
    graphs: &[Graph],
    chances: &Chances,
    visible: &[PatchId],
    shown_by: &[PatchId],
) -> Vec<hidden::Profile> {
    each(sensors, graphs, |legs, graph, span_m| {
        let (lit, seen) = legs.view.profile.pair();
        let to = visible.binary_search(&lit).ok().and(visible.binary_search(&seen).ok())?;
        let paths = legs.paths(graph, DEEP, chances);
        let ways = ways(graph.scene, [lit, seen], shown_by, span_m[1]);
        Some(hidden::Profile::over(to, ways, legs.arrivals(span_m), paths, span_m))
    })
}

/// Calls `profile` for each whose lit and seen patches are in place, with the lengths that all records together span.
fn each(
    sensors: &[SensorProfiles],
    graphs: &[Graph],
    profile: impl Fn(&Legs, &Graph, [f64; 2]) -> Option<hidden::Profile>,
) -> Vec<hidden::Profile> {
    let mut all: Vec<(Legs, &Graph)> = Vec::new();
    for (sensor, graph) in sensors.iter().zip(graphs) {
        all.extend(sensor.views().filter_map(|view| Some((Legs::new(graph.scene, view)?, graph))));
    }
    let longest_m = all.iter().map(|(legs, _)| legs.longest_m()).fold(0.0, f64::max);
    let profiles = all.iter().filter_map(|(legs, graph)| {
        let ends = [legs.view.profile.lit, legs.view.profile.seen].map(|patch| graph.scene.points[&patch]);
        profile(legs, graph, [(ends[0] - ends[1]).norm(), longest_m])
    });
    profiles.collect()
}

/// The legs that all paths of a profile share: from the laser to the lit patch and from the seen patch to the sensor.
struct Legs<'a> {
    view: View<'a>,
    length_m: f64,
    /// Standard deviation that the errors of both patches and of the delay give to a path over both.
    sd_m: f64,
}

impl<'a> Legs<'a> {
    /// `None` where one of the patches is not in place.
    fn new(scene: &Scene, view: View<'a>) -> Option<Self> {
        let (lit, seen) = view.profile.pair();
        if !scene.has(&[lit, seen]) {
            return None;
        }
        let (out, back) = (scene.points[&lit] - view.sensor.source, scene.points[&seen] - view.sensor.sensor);
        // Each patch meets one of these legs and another in a direction that is not known.
        let one_m2 = scene.legs_variance_m2(lit, &out.normalize());
        let other_m2 = scene.legs_variance_m2(seen, &back.normalize());
        // The same patch twice errs twice the same way.
        let patches_m2 = if lit == seen { 4.0 * one_m2 } else { one_m2 + other_m2 };
        let delay_m = view.medium().path_m(view.profile.delay_sd_ps);
        Some(Self { length_m: out.norm() + back.norm(), sd_m: (patches_m2 + delay_m * delay_m).sqrt(), view })
    }

    /// What a time leaves for the other legs of its path.
    fn rest_m(&self, time_ps: f64) -> f64 {
        self.view.medium().path_m(time_ps - self.view.profile.delay_ps) - self.length_m
    }

    fn longest_m(&self) -> f64 {
        let arrivals = self.view.profile.arrivals.iter();
        arrivals.map(|arrival| self.rest_m(arrival.time_ps)).fold(0.0, f64::max)
    }

    /// Arrivals as lengths within a span; those of a laser that repeats in each of its periods that lies there. One
    /// whose other reading may explain its light is no sign of anything hidden.
    fn arrivals(&self, span_m: [f64; 2]) -> Vec<hidden::Arrival> {
        let certain = self.view.profile.arrivals.iter().filter(|arrival| arrival.certainty >= SURE);
        certain.flat_map(|arrival| self.readings(arrival, span_m)).collect()
    }

    fn readings(&self, arrival: &Arrival, span_m: [f64; 2]) -> impl Iterator<Item = hidden::Arrival> + use<> {
        let medium = self.view.medium();
        let sd_m = medium.path_m(arrival.sd_ps).hypot(self.sd_m);
        let length_m = self.rest_m(arrival.time_ps);
        let period_m = medium.repetition_ps.map(|period_ps| medium.path_m(period_ps));
        let turns = period_m.map_or(0..=0, |period_m| {
            let turns = span_m.map(|end_m| (end_m - length_m) / period_m);
            turns[0].ceil() as i32..=turns[1].floor() as i32
        });
        let period_m = period_m.unwrap_or(0.0);
        turns.map(move |turns| hidden::Arrival { length_m: length_m + f64::from(turns) * period_m, sd_m })
    }

    /// Paths of up to `bounces` bounces over patches in place that may have made one of the profile's arrivals.
    fn paths(&self, graph: &Graph, bounces: usize, chances: &Chances) -> Vec<Path> {
        let direct = graph.scene.predict(self.view.profile.direct(), self.view);
        let paths = graph.near(self.view, bounces, 0.0).predictions;
        let all = iter::once(direct).chain(paths).map(|path| Path {
            length_m: self.rest_m(path.time.time_ps),
            sd_m: self.view.medium().path_m(path.time.sd_ps),
            seen: chances.of(&path.path),
        });
        all.collect()
    }
}

/// Pairs of the patches `shown_by` over which a path may reach a patch that only they show.
fn ways(scene: &Scene, ends: [PatchId; 2], shown_by: &[PatchId], longest_m: f64) -> Vec<Way> {
    let way = |(a, b): (usize, usize)| {
        let (out, back) = (leg(scene, ends[0], shown_by[a]), leg(scene, ends[1], shown_by[b]));
        let across_m = (scene.points[&shown_by[a]] - scene.points[&shown_by[b]]).norm();
        // The same patch twice errs twice the same way.
        let variance_m2 = if a == b { 2.0 * (out.1 + back.1) } else { out.1 + back.1 };
        let legs_m = out.0 + back.0;
        (legs_m + across_m < longest_m).then(|| Way::new([a, b], legs_m, variance_m2.sqrt()))
    };
    let pairs = (0..shown_by.len()).flat_map(|a| (0..shown_by.len()).map(move |b| (a, b)));
    // Back to the lit patch both orders are one path.
    pairs.filter(|(a, b)| ends[0] != ends[1] || a <= b).filter_map(way).collect()
}

/// Length of the leg from a visible patch to a hidden one, and the variance that the latter gives to the legs there.
fn leg(scene: &Scene, visible: PatchId, hidden: PatchId) -> (f64, f64) {
    let arm: Vector3<f64> = scene.points[&hidden] - scene.points[&visible];
    (arm.norm(), scene.legs_variance_m2(hidden, &arm.normalize()))
}
