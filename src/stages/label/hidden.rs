//! Hidden patches among the onsets that known ones do not explain.

use nalgebra::Vector3;

use super::chances::Chances;
use super::facing::{foci, in_line};
use super::legs;
use super::paths::Graph;
use super::scene::Scene;
use super::{LabelOnsets, OfSensor};
use crate::cancel::Cancel;
use crate::geometry::hidden::facing::spans;
use crate::geometry::hidden::{self, Focus, Found, Hidden, Room, Surface};
use crate::geometry::{Point, planes};
use crate::stages::stage::Rejection;
use crate::tables::Hypothesis;
use crate::units::{self, PatchId};

/// A hidden patch that was found.
#[derive(Clone, Copy)]
struct Placed {
    patch: PatchId,
    place: Hidden,
    /// Its mirror image in the wall that shows it, where the onsets do not rule it out.
    rival: Option<Hidden>,
}

/// What a search for hidden patches came to.
pub(super) struct Search<'a> {
    scene: &'a Scene,
    sensors: &'a [OfSensor<'a>],
    visible: &'a [PatchId],
    false_alarm: f64,
    /// Lengths of paths nearer than this may be one onset.
    blend_m: f64,
    /// Shown by visible patches, and shown by hidden ones only; numbered on from the largest patch that is known.
    layers: [Vec<Placed>; 2],
    planes: Vec<Hidden>,
    declined: Option<Hidden>,
    /// Why nothing was searched.
    refused: Option<Rejection>,
}

impl<'a> Search<'a> {
    /// Of patches that visible ones show in third bounces, over all onsets of all sensors together. In a bright room many of these are later bounces over patches not yet found.
    pub(super) fn new(
        scene: &'a Scene,
        sensors: &'a [OfSensor<'a>],
        visible: &'a [PatchId],
        graphs: &[Graph],
        chances: &Chances,
        asked: &LabelOnsets,
    ) -> Self {
        let setup = sensors[0].setup;
        let mut search = Self {
            scene,
            sensors,
            visible,
            false_alarm: asked.false_alarm,
            blend_m: units::path_m(asked.blend_ps, setup.group_index),
            layers: [Vec::new(), Vec::new()],
            planes: Vec::new(),
            declined: None,
            refused: None,
        };
        let source = Point::from(setup.source_m);
        let points: Vec<Point> = visible.iter().map(|patch| scene.points[patch]).collect();
        if !spans(&points, setup.dimensions) {
            search.refused = Some(in_line(&sensors[0].profiles[0][0], visible, setup.dimensions));
            return search;
        }
        let profiles = legs::profiles(sensors, graphs, chances, visible);
        let room = search.room(foci(scene, visible, source, setup.dimensions));
        let mut found = if asked.is_bright() {
            hidden::find_by_minimal_sets(&profiles, &room)
        } else {
            hidden::find(&profiles, &room)
        };
        search.declined = found.declined;
        search.planes = std::mem::take(&mut found.planes);
        search.layers[0] = search.placed(found, &points, source);
        search
    }

    /// Of patches that only hidden ones show, in fifth bounces, among what all paths over the latter leave unexplained.
    pub(super) fn deeper(&mut self, graphs: &[Graph], chances: &Chances) {
        let dimensions = self.sensors[0].setup.dimensions;
        let scene = graphs[0].scene;
        let shown_by = self.shown_by(scene);
        let points: Vec<Point> = shown_by.iter().map(|patch| scene.points[patch]).collect();
        // Patches in line leave a turn about it open.
        if !spans(&points, dimensions) {
            return;
        }
        let profiles = legs::layered_profiles(self.sensors, graphs, chances, self.visible, &shown_by);
        let foci = points.iter().map(|&point| Focus { point, normal: None }).collect();
        // So many ways are there that each arrival is near some.
        let room = Room { blend_m: 0.0, ..self.room(foci) };
        let found = hidden::find_by_minimal_sets(&profiles, &room);
        // A hidden patch throws light back to where it has it from: the side of the visible ones.
        let visible: Vec<Vector3<f64>> = self.visible.iter().map(|patch| scene.points[patch].coords).collect();
        let middle = Point::from(visible.iter().sum::<Vector3<f64>>() / visible.len() as f64);
        self.layers[1] = self.placed(found, &points, middle);
    }

    /// Hidden patches that visible ones show.
    fn shown_by(&self, scene: &Scene) -> Vec<PatchId> {
        scene.points.keys().filter(|patch| self.visible.binary_search(patch).is_err()).copied().collect()
    }

    fn room(&self, foci: Vec<Focus>) -> Room {
        let setup = self.sensors[0].setup;
        let already = self.scene.points.len() - self.visible.len() + self.layers[0].len();
        Room {
            foci,
            dimensions: setup.dimensions,
            false_alarm: self.false_alarm,
            blend_m: self.blend_m,
            cancel: Cancel::never(),
            count: setup.hidden_count.map(|count| (count as usize).saturating_sub(already)),
        }
    }

    /// Numbers for what was found. Of two places on either side of `wall` that on the side of `lit_from` comes first.
    fn placed(&self, found: Found, wall: &[Point], lit_from: Point) -> Vec<Placed> {
        let (dimensions, of_campaigns) =
            (self.sensors[0].setup.dimensions, |sensor: &OfSensor| sensor.setup.largest_patch);
        let known = self.scene.points.keys().copied().chain(self.layers[0].iter().map(|placed| placed.patch));
        let largest = self.sensors.iter().map(of_campaigns).chain(known).max().unwrap_or(0);
        let behind = |place: &Hidden| planes::is_across(wall, dimensions, place.point, lit_from);
        let placed = |(patch, (place, rival)): (PatchId, (Hidden, Option<Hidden>))| match rival {
            Some(rival) if behind(&place) && !behind(&rival) => Placed { patch, place: rival, rival: Some(place) },
            rival => Placed { patch, place, rival },
        };
        (largest + 1..).zip(found.patches.into_iter().zip(found.rivals)).map(placed).collect()
    }

    /// The scene with what was found.
    pub(super) fn scene(&self) -> Scene {
        let places = |layer: usize| self.layers[layer].iter().map(|found| (found.patch, found.place));
        let scene = self.scene.with(places(0));
        let shown_by = self.shown_by(&scene);
        scene.with_deep(places(1), &shown_by)
    }

    /// What was found, each patch with its other place, then planes, and the likeliest place that was not sure enough.
    pub(super) fn hypotheses(&self) -> Vec<Hypothesis> {
        let layers = (1..).zip(&self.layers).flat_map(|(layer, found)| found.iter().map(move |found| (layer, *found)));
        let found: Vec<(i32, Placed)> = layers.collect();
        let count = found.len();
        let found = found.into_iter().enumerate().flat_map(|(n, (layer, Placed { patch, place, rival }))| {
            let row = move |alternative: i32, place: Hidden| (n, layer, Some(patch), alternative, place);
            std::iter::once(row(0, place)).chain(rival.map(|rival| row(1, rival)))
        });
        let others = self.planes.iter().copied().chain(self.declined).zip(count..);
        let all = found.chain(others.map(|(hidden, n)| (n, 1, None, 0, hidden)));
        let row = |(n, layer, patch, alternative, hidden): (usize, i32, Option<PatchId>, i32, Hidden)| {
            let (point, cov) = (hidden.point, hidden.covariance);
            let kind = if hidden.surface == Surface::Patch { "patch" } else { "plane" };
            let normal = hidden.surface.normal(point);
            Hypothesis {
                hypothesis: n as i32 + 1,
                kind: kind.into(),
                layer,
                patch,
                alternative,
                x_m: point.x,
                y_m: point.y,
                z_m: point.z,
                cov_xx_m2: cov[(0, 0)],
                cov_xy_m2: cov[(0, 1)],
                cov_xz_m2: cov[(0, 2)],
                cov_yy_m2: cov[(1, 1)],
                cov_yz_m2: cov[(1, 2)],
                cov_zz_m2: cov[(2, 2)],
                sd_m: cov.trace().sqrt(),
                normal_x: normal.map(|normal| normal.x),
                normal_y: normal.map(|normal| normal.y),
                normal_z: normal.map(|normal| normal.z),
                evidence: hidden.evidence,
                evidence_needed: -self.false_alarm.ln(),
                seen: hidden.seen,
                onsets: hidden.arrivals,
                shots_needed: None,
                hours_needed: None,
            }
        };
        all.map(row).collect()
    }

    /// What stood in the way of a search.
    pub(super) fn rejections(&self) -> Vec<Rejection> {
        self.refused.iter().cloned().collect()
    }
}
