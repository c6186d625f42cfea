//! Which path of light made which arrival (paper sections 4.1 and 4.3).
//!
//! Without patches in place, the first light decides (`blind`):
//!
//! - With patch i lit and seen it is the first bounce 0-i-0.
//! - With i lit and j seen it is the second bounce 0-i-j-0. Where the two exchange no light (coplanar, occluded and
//!   specular pairs) it is a third bounce over some k: [`crate::detours`] decides, from path lengths alone. Such a pair
//!   is left open, unless k is certain and three bounces are labelled. So is a second bounce that passes another patch
//!   too closely to be distinguished from a detour over it.
//! - No second bounce is shorter than both first bounces nor longer than their sum. Where laser and sensor stand
//!   together, (j, i) has the same first light as (i, j). Both rule out false arrivals.
//!
//! With a [`Scene`], every path of up to [`Options::bounces`] bounces is predicted (`paths`). Excepted are paths over a
//! pair whose direct light is missing, or was not captured where both lie on one wall (`closed`). All arrivals of a
//! profile are associated with the predictions at once (`assignment`, [`crate::association`]). How often paths of an
//! order are seen, with and without hidden patches among theirs, is learned from the campaign, once (`chances`).
//!
//! With three bounces or more, patches that neither laser nor sensor sees are searched for over all profiles (`layers`,
//! [`crate::hidden`]). Or they are taken in order of arrival as in the paper (`rank`). Later bounces
//! count only if they are seen over the patches so found (`later`). In such a bright room, and with five bounces, the
//! search is made again: places come from minimal sets of arrivals alone, since a search of all space would follow the
//! many later bounces. Then patches that only hidden ones show are searched for, in fifth bounces (lit, hidden, such a
//! patch, hidden, seen), among the arrivals that no path over patches in place explains.
//!
//! Two patches whose light comes within [`Options::blend_ps`] over any path are not told apart. So a hidden patch that
//! shows so near to a visible one is that patch: third bounces over it contradict the place that its own second bounces
//! gave, as blended ones do. For prediction the patch is moved there, with an error that covers both places, and all is
//! labelled again. Where that was done and light shows it beside itself still, that light stays without a path.
//!
//! Pulses that the response does not resolve make one arrival between their times; its error is then larger (`blends`).
//! A wide arrival may be two pulses: the paths of the scene, and the widths of first bounces, decide (`readings`).
//!
//! The onsets may leave several scenes: a patch on either side of its neighbours. A [`Comparison`] weighs these by how
//! well their paths explain all arrivals.
//!
//! A laser that repeats leaves times modulo its period. Without a scene, periods are added such that first bounces lie
//! within one period beyond [`Options::near_m`]. The first bounce is then the strongest arrival, since later light may
//! come before it. Second bounces get periods where their first bounces leave one choice. With a scene periods are
//! added as predicted.
//!
//! Not modelled: amplitudes, which could distinguish paths of equal length; arrivals of one profile whose errors are
//! correlated; a density of later bounces that grows with time. Hence a bright room may show a false patch if more than
//! a tenth of all fourth bounces are seen before hidden patches are in place.
//!
//! The files are a stack, each imports only those before it: problem, scene, paths, chances, later, legs, blends,
//! assignment, readings, closed, comparison, layers, rank, blind.

mod assignment;
mod blends;
mod blind;
mod chances;
mod closed;
mod comparison;
mod later;
mod layers;
mod legs;
mod paths;
mod problem;
mod rank;
mod readings;
mod scene;

use std::collections::{BTreeMap, BTreeSet};

use periscope_cancel::Cancel;

use crate::association::GATE;
use crate::hidden::Hidden;
use crate::units::PatchId;
use assignment::Prior;
use blends::Blends;
use chances::Chances;
pub use comparison::Comparison;
use layers::{Layers, is_bright};
use paths::{Graph, INDIRECT, Pairs};
pub use problem::Verdicts;
use problem::View;
pub use problem::{
    Arrival, HiddenPatches, Hypothesis, Loser, Medium, Options, Origin, Pair, Profile, SensorProfiles, Solution,
    Verdict,
};
use readings::{Readings, Widths};
pub use scene::Scene;

/// Hidden patches, the surest first, over which fourth bounces are looked for: over more there are too many paths.
const SUREST: usize = 4;

/// Labels all arrivals of all sensors; with a `scene` by prediction, else by first light. A cancel ends it within
/// milliseconds.
///
/// # Panics
/// When a profile has no arrival, or [`Options::clutter_per_ns`] is not positive.
#[must_use]
pub fn label(sensors: &[SensorProfiles], scene: Option<&Scene>, options: &Options, cancel: &Cancel) -> Solution {
    let Some(scene) = scene else {
        let readings = Readings::blind(sensors, options.blend_ps);
        let verdicts = readings.sensors.iter().map(|sensor| blind::label(sensor, options, cancel)).collect();
        return Solution { verdicts, ..Solution::default() }.of(readings);
    };
    if options.bounces <= INDIRECT || options.hidden != HiddenPatches::Search {
        return predicted(sensors, scene, options, cancel);
    }
    if shows_fourths(&[], scene, sensors, options, cancel) {
        return predicted(sensors, scene, options, cancel);
    }
    let thirds = predicted(sensors, scene, &Options { bounces: INDIRECT, ..*options }, cancel);
    if shows_fourths(&thirds.hypotheses, scene, sensors, options, cancel) {
        predicted(sensors, scene, options, cancel)
    } else {
        thirds
    }
}

/// Whether fourth bounces are seen over visible patches and the surest hidden ones.
fn shows_fourths(
    hypotheses: &[Hypothesis],
    scene: &Scene,
    sensors: &[SensorProfiles],
    options: &Options,
    cancel: &Cancel,
) -> bool {
    let hidden = hypotheses.iter().filter_map(|one| Some((one.patch?, one.surface)));
    let scene = scene.with(hidden.take(SUREST));
    let whole = Readings::whole(sensors, Some(&scene), options.blend_ps);
    let options = Options { bounces: later::FOURTH, ..*options };
    let labelling = Labelling::new(&scene, &whole.sensors, &options, cancel);
    later::are_seen(&labelling.graphs(&scene), &whole.sensors)
}

/// Labels by prediction, patches moved to where light over them shows them.
fn predicted(sensors: &[SensorProfiles], scene: &Scene, options: &Options, cancel: &Cancel) -> Solution {
    let mut scene = scene.clone();
    let mut found: BTreeMap<PatchId, Hidden> = BTreeMap::new();
    let solution = loop {
        let solution = label_in(sensors, &scene, options, cancel);
        if let Some((patch, place)) = shown(&solution, &scene, sensors, &found) {
            scene = scene.moved(patch, &place);
            found.insert(patch, place);
        } else if let Some((patch, place)) = solution.twins.iter().find(|(patch, _)| !found.contains_key(patch)) {
            scene = scene.stretched(*patch, place);
            found.insert(*patch, *place);
        } else {
            break solution;
        }
    };
    first_light(Solution { places: found.into_iter().collect(), ..solution }, &scene, sensors, options, cancel)
}

/// The surest hidden patch that is a visible one, and where it is: all direct light of the visible one comes when it
/// should from there. (First light left its place open, or two places of which the wrong one was taken.)
fn shown(
    solution: &Solution,
    scene: &Scene,
    sensors: &[SensorProfiles],
    found: &BTreeMap<PatchId, Hidden>,
) -> Option<(PatchId, Hidden)> {
    let profiles = || sensors.iter().flat_map(SensorProfiles::views);
    let visible: BTreeSet<PatchId> = profiles().flat_map(|view| [view.profile.lit, view.profile.seen]).collect();
    let explains = |patch: PatchId, place: &Hidden| {
        let moved = scene.moved(patch, place);
        let direct = profiles().map(|view| (view, view.profile.direct()));
        let mut direct = direct.filter(|(_, path)| path.contains(&patch) && moved.has(path)).peekable();
        let has_own = profiles().any(|view| view.profile.pair() == (patch, patch));
        let comes = |(view, path): (View, Vec<PatchId>)| {
            let expected = moved.predict(path, view).time;
            let mut arrivals = view.profile.arrivals.iter();
            arrivals.any(|one| view.off_ps(one.time_ps, expected.time_ps) < GATE * one.sd_ps.hypot(expected.sd_ps))
        };
        has_own && direct.peek().is_some() && direct.all(comes)
    };
    let hidden = solution.hypotheses.iter().filter(|one| one.layer == 1 && one.patch.is_some());
    let places = hidden.map(|one| one.surface).chain(solution.twins.iter().map(|(_, surface)| *surface));
    let mut pairs = places.flat_map(|place| visible.iter().map(move |patch| (*patch, place)));
    pairs.find(|(patch, place)| !found.contains_key(patch) && explains(*patch, place))
}

/// With direct light of patches that have no place, as first light tells it.
fn first_light(
    mut solution: Solution,
    scene: &Scene,
    sensors: &[SensorProfiles],
    options: &Options,
    cancel: &Cancel,
) -> Solution {
    for (n, sensor) in sensors.iter().enumerate() {
        if sensor.profiles.iter().all(|profile| scene.has(&profile.direct())) {
            continue;
        }
        let mut read = sensor.clone();
        for (profile, arrivals) in read.profiles.iter_mut().zip(&solution.arrivals[n]) {
            profile.arrivals = arrivals.iter().map(|(_, arrival)| *arrival).collect();
        }
        let blind = blind::label(&read, options, cancel);
        for (profile, (verdicts, blind)) in read.profiles.iter().zip(solution.verdicts[n].iter_mut().zip(blind)) {
            let direct = profile.direct();
            if scene.has(&direct) {
                continue;
            }
            for (verdicts, blind) in verdicts.iter_mut().zip(blind) {
                if blind[0].path.as_ref() == Some(&direct) && verdicts[0].path.is_none() {
                    *verdicts = blind;
                }
            }
        }
    }
    solution
}

/// Labels by prediction.
fn label_in(sensors: &[SensorProfiles], scene: &Scene, options: &Options, cancel: &Cancel) -> Solution {
    let whole = Readings::whole(sensors, Some(scene), options.blend_ps);
    let has_pair = |profile: &Profile| profile.arrivals.iter().any(|arrival| arrival.pair.is_some());
    if !sensors.iter().flat_map(|sensor| &sensor.profiles).any(has_pair) {
        let solution = Labelling::new(scene, &whole.sensors, options, cancel).solution(scene);
        return solution.of(whole);
    }
    // First as all paths may be, then as those that the campaign shows.
    let reader = Reader { sensors, widths: Widths::of(&whole.sensors, Some(scene), options.blend_ps), options };
    let labelling = Labelling::open(scene, sensors, options, cancel);
    let first = reader.readings(&labelling.graphs(scene), &Chances::prior(&labelling.visible));
    let labelling = Labelling::new(scene, &first.sensors, options, cancel);
    let graphs = labelling.graphs(scene);
    let second = reader.readings(&graphs, &labelling.chances(&graphs));
    let labelling = Labelling::new(scene, &second.sensors, options, cancel);
    let (solution, whole) = labelling.solution_and_scene(scene);
    if solution.hypotheses.iter().all(|hypothesis| hypothesis.patch.is_none()) {
        return solution.of(second);
    }
    // Light over hidden patches comes behind other light too.
    let graphs = labelling.graphs(&whole);
    let chances = labelling.chances(&graphs);
    let third = reader.readings(&graphs, &chances);
    let labelling = Labelling { sensors: &third.sensors, ..labelling };
    let verdicts = labelling.verdicts(&labelling.graphs(&whole), &chances);
    Solution { verdicts, ..solution }.of(third)
}

/// What onsets are read by.
struct Reader<'a> {
    sensors: &'a [SensorProfiles],
    widths: Widths,
    options: &'a Options,
}

impl Reader<'_> {
    fn readings(&self, graphs: &[Graph], chances: &Chances) -> Readings {
        let prior = Prior::Learned { chances, blends: None };
        Readings::by_scene(self.sensors, graphs, &self.widths, &prior, self.options)
    }
}

impl Solution {
    /// With the readings that it labels.
    fn of(mut self, readings: Readings) -> Self {
        let Readings { sensors, origins, losers } = readings;
        let of_profile =
            |(profile, origins): (Profile, Vec<Origin>)| origins.into_iter().zip(profile.arrivals).collect();
        let of_sensor = |(sensor, origins): (SensorProfiles, Vec<Vec<Origin>>)| {
            sensor.profiles.into_iter().zip(origins).map(of_profile).collect()
        };
        self.arrivals = sensors.into_iter().zip(origins).map(of_sensor).collect();
        self.losers = losers;
        self
    }
}

/// Labelling by prediction.
struct Labelling<'a> {
    sensors: &'a [SensorProfiles],
    options: &'a Options,
    cancel: &'a Cancel,
    /// Patches in place that are lit or seen, ascending.
    visible: Vec<PatchId>,
    /// For each sensor.
    closed: Vec<Pairs>,
}

impl<'a> Labelling<'a> {
    fn new(scene: &Scene, sensors: &'a [SensorProfiles], options: &'a Options, cancel: &'a Cancel) -> Self {
        let open = Self::open(scene, sensors, options, cancel);
        let of_sensor = |sensor| closed::closed(scene, sensor, &open.visible, options, cancel);
        Self { closed: sensors.iter().map(of_sensor).collect(), ..open }
    }

    /// As if all pairs exchanged light.
    fn open(scene: &Scene, sensors: &'a [SensorProfiles], options: &'a Options, cancel: &'a Cancel) -> Self {
        let visible = scene.visible(sensors);
        let closed = vec![Pairs::new(); sensors.len()];
        Self { sensors, options, cancel, visible, closed }
    }

    fn solution(&self, scene: &Scene) -> Solution {
        self.solution_and_scene(scene).0
    }

    /// The solution, and the scene with the hidden patches of it.
    fn solution_and_scene(&self, scene: &Scene) -> (Solution, Scene) {
        let graphs = self.graphs(scene);
        let may_be_hidden = self.options.bounces >= INDIRECT && !self.sensors.is_empty();
        if may_be_hidden && self.options.hidden == HiddenPatches::Search {
            return self.searched(scene, &graphs);
        }
        let mut verdicts = self.verdicts(&graphs, &self.chances(&graphs));
        if may_be_hidden && self.options.hidden == HiddenPatches::Rank {
            self.sensors.iter().zip(&mut verdicts).for_each(|(sensor, verdicts)| rank::label(sensor, verdicts));
        }
        (Solution { verdicts, ..Solution::default() }, scene.clone())
    }

    /// With hidden patches that a search finds.
    fn searched(&self, scene: &Scene, graphs: &[Graph]) -> (Solution, Scene) {
        let mut layers = Layers::first(scene, self.sensors, &self.visible, graphs, self.options, self.cancel);
        // The first layer shows how often later bounces are seen, and what these leave for a second layer.
        let first = layers.scene();
        let graphs = self.graphs(&first);
        let chances = self.chances(&graphs);
        if is_bright(self.options) {
            layers.second(&graphs, &chances);
        }
        let all = layers.scene();
        let solution = Solution {
            verdicts: self.verdicts(&self.graphs(&all), &chances),
            hypotheses: layers.hypotheses(),
            twins: std::mem::take(&mut layers.twins),
            visible_in_line: layers.is_in_line.then_some(self.visible.len()),
            ..Solution::default()
        };
        (solution, all)
    }

    fn graphs<'b>(&'b self, scene: &'b Scene) -> Vec<Graph<'b>> {
        let sensors = self.sensors.iter().zip(&self.closed);
        sensors.map(|(sensor, closed)| Graph::new(scene, sensor, closed, self.options.bounces, self.cancel)).collect()
    }

    fn chances(&self, graphs: &[Graph]) -> Chances {
        Chances::prior(&self.visible).learned(graphs, self.sensors, self.options.bounces)
    }

    /// Once without regard to blends; strengths of light that this shows say how other paths may pull an arrival.
    fn verdicts(&self, graphs: &[Graph], chances: &Chances) -> Vec<Verdicts> {
        let verdicts = self.verdicts_with(graphs, chances, None);
        if self.options.blend_ps == 0.0 {
            return verdicts;
        }
        let blends = Blends::learned(chances, self.options.blend_ps, self.sensors, &verdicts);
        self.verdicts_with(graphs, chances, Some(&blends))
    }

    fn verdicts_with(&self, graphs: &[Graph], chances: &Chances, blends: Option<&Blends>) -> Vec<Verdicts> {
        let sensors = self.sensors.iter().zip(graphs);
        sensors.map(|(sensor, graph)| assignment::verdicts(graph, sensor, chances, blends, self.options)).collect()
    }
}

#[cfg(test)]
mod tests;
