//! Profiles as lengths over hidden patches: what all paths of a profile have in common taken off.

use std::iter;

use nalgebra::Vector3;

use super::chances::Chances;
use super::paths::{DEEP, Graph};
use super::scene::{Scene, View};
use super::{OfSensor, sd_ps};
use crate::geometry::association::Time;
use crate::geometry::hidden::{Arrival, Known, Profile, Way};
use crate::tables::Onset;
use crate::units::{self, PatchId};

/// Bounces of paths over known patches that are predicted in a search for third bounces: later ones are too faint to matter.
const FOURTH: usize = 4;

/// Profiles of all sensors as third bounces over a hidden patch show them; those whose patches are in place.
pub(super) fn profiles(sensors: &[OfSensor], graphs: &[Graph], chances: &Chances, visible: &[PatchId]) -> Vec<Profile> {
    each(sensors, graphs, |legs, graph, profile, span_m| {
        let focus = |patch: PatchId| visible.binary_search(&patch).ok();
        let foci = [focus(profile[0].lit)?, focus(profile[0].seen)?];
        let known = legs.known(graph, profile, FOURTH, chances);
        Some(Profile::new(foci, legs.arrivals(profile, span_m), known, span_m))
    })
}

/// Profiles as fifth bounces show them, over two of the patches `shown_by`, which are the foci, and a hidden one between.
pub(super) fn layered_profiles(
    sensors: &[OfSensor],
    graphs: &[Graph],
    chances: &Chances,
    visible: &[PatchId],
    shown_by: &[PatchId],
) -> Vec<Profile> {
    each(sensors, graphs, |legs, graph, profile, span_m| {
        let (lit, seen) = (profile[0].lit, profile[0].seen);
        visible.binary_search(&lit).ok().and(visible.binary_search(&seen).ok())?;
        let known = legs.known(graph, profile, DEEP, chances);
        let ways = ways(graph.scene, [lit, seen], shown_by, span_m[1]);
        Some(Profile::over(ways, legs.arrivals(profile, span_m), known, span_m))
    })
}

/// Calls `profile` for each whose lit and seen patches are in place, with the lengths that all records together span there.
fn each(
    sensors: &[OfSensor],
    graphs: &[Graph],
    profile: impl Fn(&Legs, &Graph, &[Onset], [f64; 2]) -> Option<Profile>,
) -> Vec<Profile> {
    let mut all: Vec<(Legs, &Graph, &[Onset])> = Vec::new();
    for (sensor, graph) in sensors.iter().zip(graphs) {
        for onsets in &sensor.profiles {
            all.extend(Legs::new(graph.scene, sensor.view(onsets), onsets).map(|legs| (legs, graph, *onsets)));
        }
    }
    let lengths_m = all.iter().flat_map(|(legs, _, onsets)| onsets.iter().map(|onset| legs.length_m(onset)));
    let longest_m = lengths_m.fold(0.0, f64::max);
    let one = |(legs, graph, onsets): &(Legs, &Graph, &[Onset])| {
        let ends = [onsets[0].lit, onsets[0].seen].map(|patch| graph.scene.points[&patch]);
        profile(legs, graph, onsets, [(ends[0] - ends[1]).norm(), longest_m])
    };
    all.iter().filter_map(one).collect()
}

/// What a profile's paths have in common: the way to the lit patch and from the one that is seen.
struct Legs<'a> {
    view: View<'a>,
    known_m: f64,
    /// Standard deviation that the errors of both patches and of the delay give to a path over both, its other legs in any direction.
    sd_m: f64,
}

impl<'a> Legs<'a> {
    /// `None` where one of the patches is not in place.
    fn new(scene: &Scene, view: View<'a>, profile: &[Onset]) -> Option<Self> {
        let (lit, seen) = (profile[0].lit, profile[0].seen);
        if !scene.knows(&[lit, seen]) {
            return None;
        }
        let (out, back) = (scene.points[&lit] - view.source, scene.points[&seen] - view.sensor);
        let of = |patch: PatchId, along: &Vector3<f64>| {
            let (along_m, any_m2) = scene.spread(patch, along);
            along_m * along_m + any_m2
        };
        let (one, other) = (of(lit, &out.normalize()), of(seen, &back.normalize()));
        // The same patch twice errs twice the same way.
        let patches_m2 = if lit == seen { 4.0 * one } else { one + other };
        let delay_m = units::path_m(view.delay_ps.1, view.setup.group_index);
        Some(Self { known_m: out.norm() + back.norm(), sd_m: (patches_m2 + delay_m * delay_m).sqrt(), view })
    }

    fn length_m(&self, onset: &Onset) -> f64 {
        units::path_m(onset.time_ps - self.view.delay_ps.0, self.view.setup.group_index) - self.known_m
    }

    /// Onsets as lengths within a span; with a laser that repeats, each read in all of its periods that lie there.
    fn arrivals(&self, profile: &[Onset], span_m: [f64; 2]) -> Vec<Arrival> {
        let setup = self.view.setup;
        let of_onset = |onset: &Onset| {
            let sd_m = units::path_m(sd_ps(onset), setup.group_index).hypot(self.sd_m);
            let length_m = self.length_m(onset);
            let turns = match setup.repetition_ps.map(|period_ps| units::path_m(period_ps, setup.group_index)) {
                None => 0..=0,
                Some(period_m) => {
                    let turns = |end_m: f64| (end_m - length_m) / period_m;
                    turns(span_m[0]).ceil() as i32..=turns(span_m[1]).floor() as i32
                }
            };
            let period_m = units::path_m(setup.repetition_ps.unwrap_or(0.0), setup.group_index);
            turns.map(move |turns| Arrival { length_m: length_m + f64::from(turns) * period_m, sd_m })
        };
        profile.iter().flat_map(of_onset).collect()
    }

    /// Paths of up to `bounces` bounces over known patches that may have made one of the profile's onsets.
    fn known(&self, graph: &Graph, profile: &[Onset], bounces: usize, chances: &Chances) -> Vec<Known> {
        let (direct, index) = (super::direct(profile), self.view.setup.group_index);
        let paths = graph.near(&self.view, profile, bounces, 0.0).paths;
        let known = |(path, time): (Vec<PatchId>, Time)| Known {
            length_m: units::path_m(time.time_ps - self.view.delay_ps.0, index) - self.known_m,
            sd_m: units::path_m(time.sd_ps, index),
            seen: chances.of(&path),
        };
        iter::once(graph.scene.predict(direct, &self.view)).chain(paths).map(known).collect()
    }
}

/// Pairs of patches that may show one which only they do.
fn ways(scene: &Scene, [lit, seen]: [PatchId; 2], shown_by: &[PatchId], longest_m: f64) -> Vec<Way> {
    let leg = |visible: PatchId, hidden: PatchId| {
        let arm = scene.points[&hidden] - scene.points[&visible];
        let (along_m, any_m2) = scene.spread(hidden, &arm.normalize());
        (arm.norm(), along_m * along_m + any_m2)
    };
    let way = |(a, b): (usize, usize)| {
        let (out, back) = (leg(lit, shown_by[a]), leg(seen, shown_by[b]));
        let across_m = (scene.points[&shown_by[a]] - scene.points[&shown_by[b]]).norm();
        // The same patch twice errs twice the same way.
        let variance_m2 = if a == b { 2.0 * (out.1 + back.1) } else { out.1 + back.1 };
        let known_m = out.0 + back.0;
        (known_m + across_m < longest_m).then(|| Way::new([a, b], known_m, variance_m2.sqrt()))
    };
    let pairs = (0..shown_by.len()).flat_map(|a| (0..shown_by.len()).map(move |b| (a, b)));
    // Back to the lit patch both orders are one path.
    pairs.filter(|(a, b)| lit != seen || a <= b).filter_map(way).collect()
}
