//! Hidden patches among the onsets that known ones do not explain.

use std::collections::BTreeSet;

use nalgebra::Vector3;

use super::facing::{foci, in_line, spans};
use super::predicted::Pairs;
use super::scene::{Scene, View};
use super::{OfSensor, sd_ps};
use crate::geometry::hidden::{self, Arrival, Found, Hidden, Known, Profile, Room, Surface};
use crate::geometry::{Point, planes};
use crate::stages::stage::Rejection;
use crate::tables::{Hypothesis, Onset};
use crate::units::{self, PatchId};

/// Chances that light over known patches makes an onset, by bounces from one on. Later bounces are weaker.
const SEEN: [f64; 4] = [0.95, 0.95, 0.7, 0.2];
/// Visible patches whose fourth bounces are predicted: beyond, they are as dense as clutter.
const FOURTH_MAX: usize = 12;
/// Standard deviations between where a path is expected and the last onset that it may have made.
const REACH: f64 = 5.0;
/// A hidden patch that was found.
struct Placed {
    patch: PatchId,
    place: Hidden,
    /// Its mirror image in the visible patches' wall, where the onsets do not rule it out.
    rival: Option<Hidden>,
}

/// What a search for hidden patches came to.
pub(super) struct Search {
    /// Numbered on from the largest patch that is known.
    found: Vec<Placed>,
    planes: Vec<Hidden>,
    declined: Option<Hidden>,
    /// Evidence that a patch needs.
    needed: f64,
    /// Why nothing was searched.
    refused: Option<Rejection>,
}

impl Search {
    /// All onsets of all sensors together.
    pub(super) fn new(scene: &Scene, sensors: &[OfSensor], closed: &[Pairs], false_alarm: f64) -> Self {
        let visible: BTreeSet<PatchId> = sensors
            .iter()
            .flat_map(|sensor| &sensor.profiles)
            .flat_map(|profile| [profile[0].lit, profile[0].seen])
            .filter(|patch| scene.knows(&[*patch]))
            .collect();
        let visible: Vec<PatchId> = visible.into_iter().collect();
        let setup = sensors[0].setup;
        let source = Point::from(setup.source_m);
        let points: Vec<Point> = visible.iter().map(|patch| scene.points[patch]).collect();
        let needed = -false_alarm.ln();
        let mut search = Self { found: Vec::new(), planes: Vec::new(), declined: None, needed, refused: None };
        if !spans(&points, setup.dimensions) {
            search.refused = Some(in_line(&sensors[0].profiles[0][0], &visible, setup.dimensions));
            return search;
        }
        let profiles = profiles(scene, sensors, closed, &visible);
        let hidden_already = scene.points.len() - visible.len();
        let room = Room {
            foci: foci(scene, &visible, source, setup.dimensions),
            dimensions: setup.dimensions,
            false_alarm,
            count: setup.hidden_count.map(|count| (count as usize).saturating_sub(hidden_already)),
        };
        let Found { patches, rivals, planes, declined } = hidden::find(&profiles, &room);
        (search.planes, search.declined) = (planes, declined);
        let largest = sensors.iter().map(|sensor| sensor.setup.largest_patch).chain(scene.points.keys().copied()).max();
        let numbers = largest.unwrap_or(0) + 1..;
        let behind = |place: &Hidden| planes::is_across(&points, setup.dimensions, place.point, source);
        let placed = |(patch, (place, rival)): (PatchId, (Hidden, Option<Hidden>))| match rival {
            // What a wall shows lies on the side that it is lit from.
            Some(rival) if behind(&place) && !behind(&rival) => Placed { patch, place: rival, rival: Some(place) },
            rival => Placed { patch, place, rival },
        };
        search.found = numbers.zip(patches.into_iter().zip(rivals)).map(placed).collect();
        search
    }

    /// Patches by their numbers.
    pub(super) fn patches(&self) -> impl Iterator<Item = (PatchId, Hidden)> {
        self.found.iter().map(|found| (found.patch, found.place))
    }

    /// What was found, each patch with its other place, then planes, and the likeliest place that was not sure enough.
    pub(super) fn hypotheses(&self) -> Vec<Hypothesis> {
        let found = self.found.iter().enumerate().flat_map(|(n, found)| {
            let rival = found.rival.as_ref().map(|rival| (n, Some(found.patch), 1, rival));
            std::iter::once((n, Some(found.patch), 0, &found.place)).chain(rival)
        });
        let others = self.planes.iter().chain(&self.declined).enumerate();
        let all = found.chain(others.map(|(n, hidden)| (self.found.len() + n, None, 0, hidden)));
        let row = |(n, patch, alternative, hidden): (usize, Option<PatchId>, i32, &Hidden)| {
            let (point, cov) = (hidden.point, hidden.covariance);
            let kind = if hidden.surface == Surface::Patch { "patch" } else { "plane" };
            let normal = hidden.surface.normal(point);
            Hypothesis {
                hypothesis: n as i32 + 1,
                kind: kind.into(),
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
                evidence_needed: self.needed,
                seen: hidden.seen,
                onsets: hidden.arrivals,
            }
        };
        all.map(row).collect()
    }

    /// What stood in the way of a search.
    pub(super) fn rejections(&self) -> Vec<Rejection> {
        self.refused.iter().cloned().collect()
    }
}

/// Profiles of all sensors as lengths over hidden patches.
fn profiles(scene: &Scene, sensors: &[OfSensor], closed: &[Pairs], visible: &[PatchId]) -> Vec<Profile> {
    let views = || {
        sensors
            .iter()
            .zip(closed)
            .flat_map(|(sensor, closed)| sensor.profiles.iter().map(move |profile| (sensor, closed, *profile)))
    };
    let legs: Vec<Option<Legs>> =
        views().map(|(sensor, _, profile)| Legs::new(scene, sensor.view(profile), profile)).collect();
    let latest = |(legs, (.., profile)): (&Option<Legs>, (_, _, &[Onset]))| {
        let legs = legs.as_ref()?;
        profile.iter().map(|onset| legs.length_m(onset)).reduce(f64::max)
    };
    let longest_m = legs.iter().zip(views()).filter_map(latest).fold(0.0, f64::max);
    let profile = |(legs, (_, closed, profile)): (&Option<Legs>, (_, &Pairs, &[Onset]))| {
        let legs = legs.as_ref()?;
        let focus = |patch: PatchId| visible.binary_search(&patch).ok();
        let foci = [focus(profile[0].lit)?, focus(profile[0].seen)?];
        let span_m = [(scene.points[&profile[0].lit] - scene.points[&profile[0].seen]).norm(), longest_m];
        let arrivals = legs.arrivals(profile, span_m);
        let known = legs.known(scene, profile, &arrivals, closed, visible.len() <= FOURTH_MAX);
        Some(Profile::new(foci, arrivals, known, span_m))
    };
    legs.iter().zip(views()).filter_map(profile).collect()
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

    /// Paths over known patches that may have made one of the arrivals.
    fn known(
        &self,
        scene: &Scene,
        profile: &[Onset],
        arrivals: &[Arrival],
        closed: &Pairs,
        fourth: bool,
    ) -> Vec<Known> {
        let (lit, seen) = (profile[0].lit, profile[0].seen);
        let paths =
            std::iter::once(super::direct(profile)).chain(scene.longer(lit, seen, if fourth { 4 } else { 3 }, closed));
        let index = self.view.setup.group_index;
        let known = |path: Vec<PatchId>| {
            let length_m = scene.length_m(&path, &self.view) - self.known_m;
            let sd_m = scene.length_sd_m(&path, &self.view).hypot(units::path_m(self.view.delay_ps.1, index));
            let is_near = |arrival: &Arrival| (arrival.length_m - length_m).abs() < REACH * arrival.sd_m.hypot(sd_m);
            arrivals.iter().any(is_near).then_some(Known { length_m, sd_m, seen: SEEN[path.len() - 1] })
        };
        paths.filter_map(known).collect()
    }
}
