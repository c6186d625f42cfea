//! Labelled onsets as a maximum-likelihood problem, and its unknowns by their names.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;

use super::context::{Context, Fields};
use super::drift::Drift;
use super::shared;
use crate::campaign::keys::{self, LASER, PatchRole};
use crate::geometry::footprint::Footprints;
use crate::geometry::loss::Loss;
use crate::geometry::maximum_likelihood::{Anchor, Node, Observation, Problem, Ray, Solution, Station, Unsolved};
use crate::geometry::placement;
use crate::geometry::{Matrix, Point, planes};
use crate::priors::campaign_fields::{Medium, PatchPrior};
use crate::priors::sensor_range::SensorRange;
use crate::tables::{Label, Name};
use crate::units::PatchId;

/// Standard deviation of what campaign.toml gives as exact, as far as numbers go.
const EXACT_M: f64 = 1e-6;
const EXACT_RAD: f64 = 1e-6;

/// Most patches with uncertain footprints whose errors are unknowns, three for each; those of more count as errors of
/// single onsets.
const COMMON_MAX: usize = 200;

/// Number of the errors that onsets have in common through footprints.
pub fn footprint_errors(footprints: &Footprints) -> usize {
    if footprints.0.len() > COMMON_MAX { 0 } else { 3 * footprints.0.len() }
}

/// A station of a campaign: two campaigns that agree on one share it.
pub struct NamedStation {
    pub campaign: Name,
    pub name: String,
    pub station: keys::Station,
}

/// The unknowns by their names.
pub struct Model<'a> {
    pub context: &'a Context,
    pub labels: &'a [Label],
    pub patches: Vec<PatchId>,
    pub delays: Vec<SensorRange>,
    pub stations: Vec<NamedStation>,
    /// Walks of the delays, where the onsets show that these drift.
    pub drift: Option<Drift>,
    /// Patches that laser or sensor sees.
    visible: BTreeSet<PatchId>,
    /// Station of a campaign, by its position in `stations`.
    station_at: BTreeMap<(Name, String), usize>,
}

impl<'a> Model<'a> {
    pub fn new(context: &'a Context, labels: &'a [Label]) -> Self {
        let patches: BTreeSet<PatchId> = labels.iter().flat_map(|label| label.path.iter().flatten().copied()).collect();
        let delays: BTreeSet<&SensorRange> =
            labels.iter().filter_map(|label| context.latencies.delay_of(label)).collect();
        let (mut stations, mut station_at) = (Vec::<NamedStation>::new(), BTreeMap::new());
        for (campaign, fields) in context.fields.iter() {
            for (name, station) in fields.stations.laser_first() {
                let same = |other: &NamedStation| other.name == name && other.station == *station;
                let at = stations.iter().position(same).unwrap_or(stations.len());
                if at == stations.len() {
                    let campaign = Name::from(campaign);
                    stations.push(NamedStation { campaign, name: name.to_owned(), station: station.clone() });
                }
                station_at.insert((Name::from(campaign), name.to_owned()), at);
            }
        }
        Self {
            context,
            labels,
            patches: patches.into_iter().collect(),
            delays: delays.into_iter().cloned().collect(),
            stations,
            drift: None,
            visible: labels.iter().flat_map(|label| [label.lit, label.seen]).collect(),
            station_at,
        }
    }

    pub fn fields(&self, label: &Label) -> &Fields {
        self.context.fields.of(&label.campaign)
    }

    /// How light reaches a patch. An anchor has a place in campaign.toml and a role there: that no label has it as lit
    /// or seen, since its first light was gated away, makes it no hidden patch.
    pub fn kind(&self, patch: PatchId) -> &'static str {
        let priors = || self.context.fields.values().filter_map(|fields| fields.patches.get(&patch));
        let is_anchor = |prior: &PatchPrior| prior.position_m.is_some() && prior.role == PatchRole::Visible;
        if priors().any(|prior| prior.role == PatchRole::Mirror) {
            "mirror"
        } else if self.visible.contains(&patch) || priors().any(is_anchor) {
            "visible"
        } else {
            "hidden"
        }
    }

    /// How many of some patches, by their positions among the unknowns, are hidden and lie behind the wall that shows
    /// them. The wall is the plane nearest to the visible patches that they share a leg with; the laser is in front.
    pub fn behind(&self, problem: &Problem, solution: &Solution, patches: &[usize]) -> usize {
        let is_visible = |place: usize| self.kind(self.patches[place]) == "visible";
        let is_behind = |&&patch: &&usize| {
            let legs = problem.observations.iter().flat_map(|observation| observation.nodes.windows(2));
            let seen_from: BTreeSet<usize> = legs
                .filter_map(|leg| match leg {
                    [Node::Patch(a), Node::Patch(b)] if *a == patch && is_visible(*b) => Some(*b),
                    [Node::Patch(a), Node::Patch(b)] if *b == patch && is_visible(*a) => Some(*a),
                    _ => None,
                })
                .collect();
            let wall: Vec<Point> = seen_from.into_iter().map(|place| solution.points[place]).collect();
            let (laser, point) = (solution.stations[0], solution.points[patch]);
            !wall.is_empty() && planes::is_across(&wall, problem.dimensions, point, laser)
        };
        patches.iter().filter(|&&patch| self.kind(self.patches[patch]) == "hidden").filter(is_behind).count()
    }

    /// Position of a patch among the unknowns.
    pub fn place(&self, patch: PatchId) -> usize {
        self.patches.binary_search(&patch).expect("all patches of the labels are unknowns")
    }

    pub fn medium(&self, delay: &SensorRange) -> Medium {
        self.context.fields.of(&delay.campaign).medium
    }

    /// Where each patch is searched from; `None` if one has no place to start from.
    fn start(&self) -> Option<Vec<Point>> {
        let start = |patch: &PatchId| {
            let row = self.context.start.get(patch)?;
            Some(Point::new(row.x_m, row.y_m, row.z_m))
        };
        self.patches.iter().map(start).collect()
    }

    /// The problem with patches as points, from the start that is given, else placed from nothing.
    pub fn problem(&self, loss: Loss) -> Problem {
        let first = self.context.first();
        let station = |named: &NamedStation| Station {
            position: Point::from(named.station.position_m),
            sd_m: named.station.sd_m.unwrap_or(0.0),
        };
        let length_m2 = |a: &SensorRange, b: &SensorRange| {
            self.medium(a).path_m(1.0) * self.medium(b).path_m(1.0) * self.context.latencies.covariance_ps2(a, b)
        };
        let count = self.delays.len();
        let mut problem = Problem {
            start: vec![Point::origin(); self.patches.len()],
            dimensions: usize::from(first.dimensions),
            stations: self.stations.iter().map(station).collect(),
            observations: self.observations(),
            anchors: self.anchors(first),
            rays: self.rays(first),
            delay_covariance_m2: Matrix::from_fn(count, count, |i, k| length_m2(&self.delays[i], &self.delays[k])),
            period_sd_m: self.period_sd_m(),
            loss,
            cancel: self.context.cancel.clone(),
        };
        problem.start = match self.start() {
            Some(start) => start,
            None => placement::place(&problem).points,
        };
        problem
    }

    /// Patches of known position.
    fn anchors(&self, fields: &Fields) -> Vec<Anchor> {
        let anchor = |(patch, prior): (&PatchId, &PatchPrior)| {
            let patch = self.patches.binary_search(patch).ok()?;
            Some(Anchor { patch, position: Point::from(prior.position_m?), sd_m: prior.sd_m.unwrap_or(EXACT_M) })
        };
        fields.patches.iter().filter_map(anchor).collect()
    }

    /// Patches of known direction.
    fn rays(&self, fields: &Fields) -> Vec<Ray> {
        let campaign = Name::from(self.context.fields.first_name());
        let ray = |(patch, prior): (&PatchId, &PatchPrior)| {
            let (patch, ray) = (self.patches.binary_search(patch).ok()?, prior.ray.as_ref()?);
            Some(Ray {
                patch,
                from: self.station_at[&(campaign.clone(), ray.from.clone())],
                direction: Vector3::from(ray.direction).normalize(),
                sd_rad: ray.sd_rad.unwrap_or(EXACT_RAD),
            })
        };
        fields.patches.iter().filter_map(ray).collect()
    }

    /// Of all campaigns together; exact where they differ in it.
    fn period_sd_m(&self) -> f64 {
        let first = self.context.first();
        if self.context.fields.values().any(|fields| fields.repetition_ps != first.repetition_ps) {
            return 0.0;
        }
        first.period_sd_ps().map_or(0.0, |sd_ps| first.medium.path_m(sd_ps))
    }

    /// Those of all labels, with the errors that they share.
    fn observations(&self) -> Vec<Observation> {
        let both = self.labels.iter().zip(shared::shares_ps(self.labels));
        both.map(|(label, shares)| {
            let medium = &self.fields(label).medium;
            let shared = shares.into_iter().map(|(error, each_ps)| (error, medium.path_m(each_ps))).collect();
            Observation { shared, ..self.observation(label) }
        })
        .collect()
    }

    /// Whether all patches of a label's path are unknowns.
    pub fn has_patches_of(&self, label: &Label) -> bool {
        label.path.iter().flatten().all(|patch| self.patches.binary_search(patch).is_ok())
    }

    /// A label by itself.
    pub fn observation(&self, label: &Label) -> Observation {
        let Fields { medium, stations, .. } = self.fields(label);
        let path = label.path.iter().flatten().map(|patch| Node::Patch(self.place(*patch)));
        let station = |name: &str| Node::Station(self.station_at[&(label.campaign.clone(), name.to_owned())]);
        let delay = self.context.latencies.delay_of(label);
        let nodes = std::iter::once(station(LASER)).chain(path).chain([station(stations.of_sensor(&label.sensor))]);
        let mut observation = Observation {
            delay: delay.and_then(|delay| self.delays.binary_search(delay).ok()),
            turns: label.turns,
            ..Observation::new(nodes.collect(), medium.path_m(label.time_ps), medium.path_m(label.time_sd_ps))
        };
        self.drift.iter().for_each(|drift| drift.add_to(label, &mut observation));
        observation
    }

    /// The observations without the shifts of footprints, and these. Errors of sizes and directions of their patches
    /// are common to onsets; what they do not explain is an error of each by itself.
    pub fn shifted(
        &self,
        observations: &[Observation],
        footprints: &Footprints,
        solution: &Solution,
    ) -> (Vec<Observation>, Vec<f64>) {
        let both = self.labels.iter().zip(observations);
        both.map(|(label, observation)| self.shifted_one(label, observation, footprints, solution)).unzip()
    }

    /// The same for one label.
    pub fn shifted_one(
        &self,
        label: &Label,
        observation: &Observation,
        footprints: &Footprints,
        solution: &Solution,
    ) -> (Observation, f64) {
        let at = |patch: &PatchId| solution.points[self.place(*patch)];
        let station = |node: &Node| match node {
            Node::Station(station) => solution.stations[*station],
            Node::Patch(_) => unreachable!("paths end at stations"),
        };
        let path = label.path.as_deref().expect("only labels with a path are observations");
        let [source, .., sensor] = observation.nodes.as_slice() else { unreachable!("a path has two ends") };
        let shift = footprints.shift(station(source), path, at, station(sensor));
        let mut observation = observation.clone();
        observation.length_m -= shift.mean_m;
        observation.sd_m = observation.sd_m.hypot(shift.sd_m);
        for (patch, changes_m) in shift.changes {
            if footprints.0.len() > COMMON_MAX {
                observation.sd_m = changes_m.into_iter().fold(observation.sd_m, f64::hypot);
            } else {
                let before = footprints.0.range(..patch).count();
                observation.common.extend((3 * before..).zip(changes_m));
            }
        }
        (observation, shift.mean_m)
    }

    pub fn refused(&self, unsolved: &Unsolved) -> String {
        match unsolved {
            Unsolved::Undetermined(fewest) => {
                let list: Vec<String> =
                    fewest.iter().map(|(place, count)| format!("{} ({count} onsets)", self.patches[*place])).collect();
                format!(
                    "the onsets leave positions undetermined; patches with the fewest: {}; capture more pairs with them, or exclude them",
                    list.join(", ")
                )
            }
            Unsolved::NotSettled => format!(
                "{unsolved}; look at the table `residuals` of a run with fewer patches, or start from other patches"
            ),
        }
    }

    /// Whether nothing but conventions fixes how the patches are turned about the stations.
    pub fn all_rotations_free(&self, solution: &Solution) -> bool {
        let all = if self.context.first().dimensions == 2 { 1 } else { 3 };
        solution.free_rotations.first() == Some(&all)
    }
}
