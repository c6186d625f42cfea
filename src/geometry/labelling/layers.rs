//! Hidden patches in two layers: those that visible patches show, and those that only hidden ones show.

use nalgebra::Vector3;
use periscope_cancel::Cancel;

use super::chances::Chances;
use super::legs;
use super::paths::Graph;
use super::problem::{Hypothesis, Options, SensorProfiles};
use super::scene::{DEEP, Scene};
use crate::hidden::facing::spans;
use crate::hidden::{self, Focus, Hidden, Room};
use crate::units::PatchId;
use crate::{Point, planes};

/// Hidden patches, numbered on from the largest patch in place, lit or seen.
pub(super) struct Layers<'a> {
    /// Patches in place before the search.
    scene: &'a Scene,
    sensors: &'a [SensorProfiles],
    visible: &'a [PatchId],
    options: &'a Options,
    cancel: &'a Cancel,
    /// Shown by visible patches, and shown by hidden ones only.
    patches: [Vec<HiddenPatch>; 2],
    planes: Vec<Hidden>,
    declined: Option<Hidden>,
    /// Places that are not told from those of visible patches, the surest first.
    pub(super) twins: Vec<(PatchId, Hidden)>,
    /// Whether visible patches lie in one line, so that nothing is searched.
    pub(super) is_in_line: bool,
}

#[derive(Clone, Copy)]
struct HiddenPatch {
    patch: PatchId,
    surface: Hidden,
    /// Its mirror image in the wall that shows it, where the arrivals do not rule it out.
    rival: Option<Hidden>,
}

/// Whether so late bounces are wanted that the room must be a bright one.
pub(super) const fn is_bright(options: &Options) -> bool {
    options.bounces >= DEEP
}

impl<'a> Layers<'a> {
    /// Searches for patches that visible ones show in third bounces, over all arrivals of all sensors together. In a
    /// bright room many of these are later bounces over patches not yet in place. There is one sensor at least.
    pub(super) fn first(
        scene: &'a Scene,
        sensors: &'a [SensorProfiles],
        visible: &'a [PatchId],
        graphs: &[Graph],
        options: &'a Options,
        cancel: &'a Cancel,
    ) -> Self {
        let patches = [Vec::new(), Vec::new()];
        let (planes, declined, twins) = (Vec::new(), None, Vec::new());
        let mut all =
            Self { scene, sensors, visible, options, cancel, patches, planes, declined, twins, is_in_line: false };
        let SensorProfiles { source, dimensions, .. } = sensors[0];
        let points = scene.points_of(visible);
        if !spans(&points, dimensions) {
            all.is_in_line = true;
            return all;
        }
        let profiles = legs::profiles(sensors, graphs, &Chances::prior(visible), visible);
        let room = all.room(scene.foci(visible, source, dimensions));
        let mut solution = if is_bright(options) {
            hidden::find_by_minimal_sets(&profiles, &room)
        } else {
            hidden::find(&profiles, &room)
        };
        all.declined = solution.declined;
        all.planes = std::mem::take(&mut solution.planes);
        all.twins = all.without_twins(&mut solution);
        all.patches[0] = all.numbered(solution, &points, source);
        all
    }

    /// Takes places out that are not told from those of visible patches.
    fn without_twins(&self, solution: &mut hidden::Solution) -> Vec<(PatchId, Hidden)> {
        let reach_m = self.sensors[0].medium.path_m(self.options.blend_ps);
        let twin_of = |surface: &Hidden| {
            let apart_m = |patch: &PatchId| (self.scene.points[patch] - surface.point).norm();
            let nearest = self.visible.iter().copied().min_by(|a, b| apart_m(a).total_cmp(&apart_m(b)))?;
            (apart_m(&nearest) < reach_m).then_some((nearest, *surface))
        };
        let found = std::mem::take(&mut solution.patches).into_iter().zip(std::mem::take(&mut solution.rivals));
        let mut twins = Vec::new();
        for (surface, rival) in found {
            if let Some(twin) = twin_of(&surface) {
                twins.push(twin);
            } else {
                solution.patches.push(surface);
                solution.rivals.push(rival);
            }
        }
        twins
    }

    /// Searches for patches that only hidden ones show, in fifth bounces, among what all paths over the latter leave.
    pub(super) fn second(&mut self, graphs: &[Graph], chances: &Chances) {
        let scene = graphs[0].scene;
        let shown_by = self.shown_by(scene);
        let points = scene.points_of(&shown_by);
        // Patches in line leave a turn about it open.
        if !spans(&points, self.sensors[0].dimensions) {
            return;
        }
        let profiles = legs::deep_profiles(self.sensors, graphs, chances, self.visible, &shown_by);
        let foci = points.iter().map(|&point| Focus { point, normal: None }).collect();
        // Every arrival is near one of the many ways: with blends, all would be hidden.
        let room = Room { blend_m: 0.0, ..self.room(foci) };
        let solution = hidden::find_by_minimal_sets(&profiles, &room);
        // A hidden patch throws light back to where it has it from: the side of the visible ones.
        let visible = scene.points_of(self.visible);
        let middle = visible.iter().map(|point| point.coords).sum::<Vector3<f64>>() / visible.len() as f64;
        self.patches[1] = self.numbered(solution, &points, Point::from(middle));
    }

    /// The scene with all hidden patches.
    pub(super) fn scene(&self) -> Scene {
        let surfaces = |layer: usize| self.patches[layer].iter().map(|hidden| (hidden.patch, hidden.surface));
        let scene = self.scene.with(surfaces(0));
        let shown_by = self.shown_by(&scene);
        scene.with_deep(&surfaces(1).collect::<Vec<_>>(), &shown_by)
    }

    /// Patches of both layers, then planes, then the likeliest place that is not sure enough.
    pub(super) fn hypotheses(&self) -> Vec<Hypothesis> {
        let layers = (1..).zip(&self.patches).flat_map(|(layer, hidden)| hidden.iter().map(move |one| (layer, one)));
        let patches = layers.map(|(layer, hidden)| Hypothesis {
            layer,
            patch: Some(hidden.patch),
            surface: hidden.surface,
            rival: hidden.rival,
        });
        let others = self.planes.iter().copied().chain(self.declined);
        patches.chain(others.map(|surface| Hypothesis { layer: 1, patch: None, surface, rival: None })).collect()
    }

    /// Patches in place that are not visible.
    fn shown_by(&self, scene: &Scene) -> Vec<PatchId> {
        scene.points.keys().filter(|patch| self.visible.binary_search(patch).is_err()).copied().collect()
    }

    fn room(&self, foci: Vec<Focus>) -> Room {
        let SensorProfiles { medium, dimensions, hidden_count, .. } = self.sensors[0];
        let in_place = self.scene.points.len() - self.visible.len() + self.patches[0].len();
        Room {
            foci,
            dimensions,
            false_alarm: self.options.false_alarm,
            blend_m: medium.path_m(self.options.blend_ps),
            count: hidden_count.map(|count| (count as usize).saturating_sub(in_place)),
            cancel: self.cancel.clone(),
        }
    }

    /// Patches with numbers. Of two places on either side of `wall` that on the side of `lit_from` comes first.
    fn numbered(&self, solution: hidden::Solution, wall: &[Point], lit_from: Point) -> Vec<HiddenPatch> {
        let dimensions = self.sensors[0].dimensions;
        let is_behind = |surface: &Hidden| planes::is_across(wall, dimensions, surface.point, lit_from);
        let surfaces = solution.patches.into_iter().zip(solution.rivals);
        let number = |(patch, (surface, rival)): (PatchId, (Hidden, Option<Hidden>))| match rival {
            Some(rival) if is_behind(&surface) && !is_behind(&rival) => {
                HiddenPatch { patch, surface: rival, rival: Some(surface) }
            }
            rival => HiddenPatch { patch, surface, rival },
        };
        (self.largest_patch() + 1..).zip(surfaces).map(number).collect()
    }

    fn largest_patch(&self) -> PatchId {
        let in_campaigns = self.sensors.iter().map(|sensor| sensor.largest_patch);
        let profiles = self.sensors.iter().flat_map(|sensor| &sensor.profiles);
        let ends = profiles.flat_map(|profile| [profile.lit, profile.seen]);
        let in_place = self.scene.points.keys().copied().chain(ends);
        let hidden = self.patches[0].iter().map(|hidden| hidden.patch);
        in_campaigns.chain(in_place).chain(hidden).max().unwrap_or(0)
    }
}
