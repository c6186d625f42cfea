//! Onsets and campaign as a problem of ellipses.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, Vector3};

use super::Context;
use crate::campaign::keys::PatchRole;
use crate::geometry::Point;
use crate::geometry::bistatic::{Anchor, Bounce, Problem, ProfileOnsets, Strip, Surface};
use crate::priors::campaign_fields::Medium;
use crate::priors::sensor_range::{OfSensorRange, SensorRange};
use crate::tables::{Name, Onset};
use crate::units::PatchId;

/// The problem, and what its numbers stand for.
pub(super) struct Model {
    pub(super) problem: Problem,
    /// Numbers of the strips.
    pub(super) strips: Vec<PatchId>,
    /// Numbers of the anchors; the stations behind them have none.
    pub(super) points: Vec<PatchId>,
    /// Onsets of each record, and laser periods added to each.
    pub(super) onsets: Vec<Vec<(Onset, i32)>>,
    pub(super) medium: Medium,
}

/// Onsets of one profile: sensor, lit, seen, range.
type ProfileKey = (Name, PatchId, PatchId, Option<Name>);

impl Model {
    /// The model, and which profiles it leaves out and why; or why there is none. `exact`: differences of arrival, with
    /// all else exact.
    pub(super) fn new(context: &Context, onsets: Vec<Onset>, exact: bool) -> Result<(Self, Vec<String>), String> {
        let mut profiles: BTreeMap<ProfileKey, Vec<Onset>> = BTreeMap::new();
        for onset in onsets {
            let key = (onset.sensor.clone(), onset.lit, onset.seen, onset.range.clone());
            profiles.entry(key).or_default().push(onset);
        }
        let strips = strips(context, &profiles)?;
        let mut lit: Vec<PatchId> = profiles.keys().map(|(_, lit, ..)| *lit).collect();
        lit.extend(strips.values());
        lit.sort_unstable();
        lit.dedup();
        let points = lit;
        let mut anchors: Vec<Anchor> =
            points.iter().map(|patch| anchor(context, *patch, exact)).collect::<Result<_, _>>()?;
        let stations: Vec<&String> = context.fields.sensors.keys().collect();
        anchors.extend(context.fields.sensors.values().map(|station| Anchor {
            at: Point::from(station.position_m),
            sd_m: station.sd_m.filter(|_| !exact).unwrap_or(0.0),
            normal: None,
        }));
        let mut delays: Vec<SensorRange> = profiles.values().map(|onsets| onsets[0].sensor_range()).collect();
        delays.dedup();
        let place = |patch: PatchId| points.binary_search(&patch).expect("all points were listed");
        let surfaces = strips.iter().map(|(strip, exit)| Strip {
            exit: place(*exit),
            surface: surface(context, *strip),
            is_central: false,
        });
        let mut model = Self {
            problem: Problem {
                dimensions: context.fields.dimensions,
                source: Point::from(context.fields.source_m),
                delays_sd_m: delays.iter().map(|delay| if exact { 0.0 } else { delay_sd_m(context, delay) }).collect(),
                strips: surfaces.collect(),
                records: Vec::new(),
                apart_max_m: context.fields.hidden.apart_max_m,
                along: context.fields.hidden.along.map(Vector3::from),
                anchors,
                cancel: context.cancel.clone(),
            },
            strips: strips.keys().copied().collect(),
            points: points.clone(),
            onsets: Vec::new(),
            medium: context.fields.medium,
        };
        let mut reasons = Vec::new();
        for ((sensor, lit, seen, _), onsets) in profiles {
            let covered = context.covers(seen);
            let bounce = if covered.contains(&lit) { Bounce::First } else { Bounce::Third };
            let station = stations.iter().position(|name| ***name == *sensor);
            let reject = |why: &str| format!("profile of sensor {sensor}, lit {lit}, seen {seen}, {why}");
            let Some(station) = station else {
                return Err(format!("sensor `{sensor}` is not in campaign.toml; add [sensors.{sensor}]"));
            };
            if bounce == Bounce::Third && !strips.values().all(|exit| covered.contains(exit)) {
                reasons.push(reject(
                    "is left out: it does not cover the exits of all strips; see [views] in campaign.toml",
                ));
                continue;
            }
            if bounce == Bounce::Third && onsets.len() < model.strips.len() {
                let (count, needed) = (onsets.len(), model.strips.len());
                reasons.push(reject(&format!(
                    "is left out: {count} onsets for {needed} strips; average more shots, or light a point from where their pulses are farther apart"
                )));
                continue;
            }
            let delay = delays.iter().position(|key| *key == onsets[0].sensor_range()).expect("all were listed");
            let station = points.len() + station;
            model.add(context, Course { lit: place(lit), station, delay, bounce }, onsets);
        }
        if exact {
            model.take_differences()?;
        }
        Ok((model, reasons))
    }

    /// Adds a record; of first bounces the earliest onset.
    fn add(&mut self, context: &Context, course: Course, mut onsets: Vec<Onset>) {
        onsets.sort_by_key(|onset| onset.rank);
        let all = onsets.len();
        if course.bounce == Bounce::First {
            onsets.truncate(1);
        }
        let per_ps = self.medium.path_m(1.0);
        let covariance_m2 = DMatrix::from_fn(onsets.len(), onsets.len(), |r, c| {
            let own = if onsets[r].covariance.len() == all { onsets[r].covariance[c] } else { 0.0 };
            let own = if r == c { onsets[r].time_sd_ps.powi(2) } else { own };
            (own + onsets[r].jitter_ps.powi(2)) * per_ps * per_ps
        });
        let earliest_ps = self.medium.time_ps(self.earliest_m(&course));
        let turned = |onset: Onset| {
            let late_ps = earliest_ps - onset.time_ps;
            let turns = context.fields.repetition_ps.map_or(0.0, |period_ps| match course.bounce {
                Bounce::First => (late_ps / period_ps).round(),
                Bounce::Third => (late_ps / period_ps).ceil().max(0.0),
            });
            (onset, turns as i32)
        };
        let onsets: Vec<(Onset, i32)> = onsets.into_iter().map(turned).collect();
        let period_ps = context.fields.repetition_ps.unwrap_or(0.0);
        let length_m =
            |(onset, turns): &(Onset, i32)| self.medium.path_m(onset.time_ps + f64::from(*turns) * period_ps);
        let lengths_m = onsets.iter().map(length_m).collect();
        let heights = onsets.iter().map(|(onset, _)| onset.amplitude.abs()).collect();
        let Course { lit, station, delay, bounce } = course;
        self.problem.records.push(ProfileOnsets { lit, station, delay, bounce, lengths_m, covariance_m2, heights });
        self.onsets.push(onsets);
    }

    /// The first bounce's way, or the shortest way of a third bounce: straight to the nearest exit.
    fn earliest_m(&self, course: &Course) -> f64 {
        let problem = &self.problem;
        let (lit, station) = (problem.anchors[course.lit].at, problem.anchors[course.station].at);
        let in_m = (lit - problem.source).norm();
        let out_m = |from: Point| (station - from).norm();
        match course.bounce {
            Bounce::First => in_m + out_m(lit),
            Bounce::Third => {
                let exits = problem.strips.iter().map(|strip| problem.anchors[strip.exit].at);
                in_m + exits.map(|exit| (exit - lit).norm() + out_m(exit)).fold(f64::INFINITY, f64::min)
            }
        }
    }

    /// Counts third bounces from the first bounce off the same point, which then has done its work.
    fn take_differences(&mut self) -> Result<(), String> {
        let problem = &mut self.problem;
        let early_m = |lit: usize, records: &[ProfileOnsets], anchors: &[Anchor], source: Point| {
            let first = records.iter().find(|record| record.bounce == Bounce::First && record.lit == lit)?;
            let way_m = (anchors[lit].at - source).norm() + (anchors[first.station].at - anchors[lit].at).norm();
            Some(first.lengths_m[0] - way_m)
        };
        for n in 0..problem.records.len() {
            if problem.records[n].bounce == Bounce::Third {
                let lit = problem.records[n].lit;
                let early_m = early_m(lit, &problem.records, &problem.anchors, problem.source).ok_or_else(|| {
                    let patch = self.points[lit];
                    format!(
                        "no profile has the first bounce off patch {patch}, from which `ellipses` counts; capture it"
                    )
                })?;
                problem.records[n].lengths_m.iter_mut().for_each(|length_m| *length_m -= early_m);
            }
        }
        let is_third: Vec<bool> = problem.records.iter().map(|record| record.bounce == Bounce::Third).collect();
        let mut kept = is_third.iter();
        problem.records.retain(|_| *kept.next().expect("as many"));
        let mut kept = is_third.iter();
        self.onsets.retain(|_| *kept.next().expect("as many"));
        Ok(())
    }
}

/// Which way the light of a record goes: numbers of its anchors and of its delay.
struct Course {
    lit: usize,
    station: usize,
    delay: usize,
    bounce: Bounce,
}

/// Strips and their exits: as campaign.toml lists them, or one for each patch of the views that do not cover what is
/// lit.
fn strips(
    context: &Context,
    profiles: &BTreeMap<ProfileKey, Vec<Onset>>,
) -> Result<BTreeMap<PatchId, PatchId>, String> {
    let listed = context.fields.patches.iter().filter(|(_, patch)| patch.role == PatchRole::Hidden);
    let through: BTreeMap<PatchId, PatchId> =
        listed.clone().filter_map(|(strip, patch)| Some((*strip, patch.through?))).collect();
    if let Some((strip, _)) = listed.clone().find(|(strip, _)| !through.is_empty() && !through.contains_key(*strip)) {
        return Err(format!(
            "hidden patch {strip} has no exit; add `through` under [patches.{strip}] in campaign.toml"
        ));
    }
    let strips = if through.is_empty() {
        let thirds = profiles.keys().map(|(_, lit, seen, _)| (lit, context.covers(*seen)));
        let mut exits: Vec<PatchId> =
            thirds.filter(|(lit, covered)| !covered.contains(lit)).flat_map(|(_, covered)| covered).collect();
        exits.sort_unstable();
        exits.dedup();
        let largest = context.fields.patches.keys().chain(context.fields.views.keys()).chain(&exits).max().copied();
        (largest.unwrap_or(0) + 1..).zip(exits).collect()
    } else {
        through
    };
    if strips.is_empty() {
        return Err("no profile has third bounces: light a diffuser point, and let a sensor see others".to_owned());
    }
    match context.fields.hidden.count {
        Some(count) if count as usize != strips.len() => Err(format!(
            "[hidden] count = {count}, but there are {} exits, each of one strip; list the strips with `through` in campaign.toml",
            strips.len()
        )),
        _ => Ok(strips),
    }
}

fn anchor(context: &Context, patch: PatchId, exact: bool) -> Result<Anchor, String> {
    let prior = context.fields.patches.get(&patch);
    let position_m = prior.and_then(|prior| prior.position_m).ok_or_else(|| {
        format!("diffuser point {patch} has no position; add `position_m` (and `sd_m`) under [patches.{patch}] in campaign.toml")
    })?;
    let prior = prior.expect("it has a position");
    Ok(Anchor {
        at: Point::from(position_m),
        sd_m: prior.sd_m.filter(|_| !exact).unwrap_or(0.0),
        normal: prior.normal.map(Vector3::from),
    })
}

fn surface(context: &Context, strip: PatchId) -> Surface {
    let Some((prior, size_m)) = context.fields.patches.get(&strip).and_then(|prior| Some((prior, prior.size_m?)))
    else {
        return Surface::Diffuse;
    };
    prior.lobe_rad.map_or(Surface::Unknown { size_m }, |lobe_rad| Surface::Glossy {
        size_m,
        lobe_rad,
        normal: prior.normal.map(Vector3::from),
    })
}

/// What calibration leaves open of a sensor's delay, as a length.
fn delay_sd_m(context: &Context, delay: &SensorRange) -> f64 {
    let delay = context.latencies.delay_of(delay);
    delay.map_or(0.0, |delay| context.fields.medium.path_m(context.latencies.latency(delay).sd_ps))
}
