//! Labels with known patches: hidden ones searched for, every path predicted, every onset associated.

use std::collections::BTreeSet;

use rayon::prelude::*;

use super::blends::Blends;
use super::chances::Chances;
use super::facing::foci;
use super::hidden::Search;
use super::paths::{DEEP, Dense, Graph, Paths};
use super::scene::{Scene, View};
use super::{HiddenPatches, LabelOnsets, OfSensor, Verdict, Verdicts, direct, rank, sd_ps};
use crate::geometry::association::{Candidate, Expected, GATE, Time, associate};
use crate::geometry::hidden::facing;
use crate::stages::stage::Rejection;
use crate::tables::{Hypothesis, Onset};
use crate::units::PatchId;

/// Alternatives told of an onset that is left open.
const ALTERNATIVES: usize = 4;
/// Chance of light of which it is not known whether it is there at all.
const EVEN: f64 = 0.5;

/// Pairs of patches, the smaller first.
pub(super) type Pairs = BTreeSet<(PatchId, PatchId)>;

/// A predicted path, read some laser periods earlier.
pub(super) struct Prediction {
    pub(super) path: Vec<PatchId>,
    pub(super) turns: i32,
    pub(super) time: Time,
}

/// What is expected of paths.
struct Expectation<'a> {
    /// Chance that a path makes an onset.
    chance: &'a dyn Fn(&[PatchId]) -> f64,
    /// The same of an order that is too dense.
    dense_chance: &'a dyn Fn(usize) -> f64,
    /// How other paths pull an onset; `None`: not at all.
    blends: Option<&'a Blends<'a>>,
}

/// What may have made the onsets of a profile.
struct Associated {
    predictions: Vec<Prediction>,
    /// For each onset.
    found: Vec<Vec<Candidate>>,
    /// Standard deviation that the light of other paths adds to each onset.
    blend_sds_ps: Vec<f64>,
}

impl LabelOnsets {
    fn bounces(&self) -> usize {
        self.bounces as usize
    }

    /// With known patches, and hidden ones that are found on the way.
    pub(super) fn with_known(
        &self,
        scene: &Scene,
        sensors: &[OfSensor],
    ) -> (Vec<Verdicts>, Vec<Hypothesis>, Vec<Rejection>) {
        let is_visible = |patch: &PatchId| scene.knows(&[*patch]);
        let ends =
            sensors.iter().flat_map(|sensor| &sensor.profiles).flat_map(|onsets| [onsets[0].lit, onsets[0].seen]);
        let visible: Vec<PatchId> = ends.filter(is_visible).collect::<BTreeSet<_>>().into_iter().collect();
        let closed: Vec<Pairs> = sensors.iter().map(|sensor| self.closed(scene, sensor, &visible)).collect();
        let learned = |graphs: &[Graph]| Chances::prior(&visible).learned(graphs, sensors, self.bounces());
        let predicted = |graphs: &[Graph], chances: &Chances| -> Vec<Verdicts> {
            let all = |blends: Option<&Blends>| -> Vec<Verdicts> {
                sensors
                    .iter()
                    .zip(graphs)
                    .map(|(sensor, graph)| self.predicted(graph, sensor, chances, blends))
                    .collect()
            };
            let first = all(None);
            if self.blend_ps == 0.0 {
                return first;
            }
            all(Some(&Blends::learned(chances, self.blend_ps, sensors, &first)))
        };
        let known = self.graphs(scene, sensors, &closed);
        if self.hidden != HiddenPatches::Search || self.bounces < 3 {
            let mut verdicts = predicted(&known, &learned(&known));
            if self.hidden == HiddenPatches::Rank && self.bounces >= 3 {
                sensors.iter().zip(&mut verdicts).for_each(|(sensor, verdicts)| rank::label(sensor, verdicts));
            }
            return (verdicts, Vec::new(), Vec::new());
        }
        let prior = Chances::prior(&visible);
        let mut search = Search::new(scene, sensors, &visible, &known, &prior, self);
        // What was found first tells once how often later bounces are seen, and what these leave for a second layer.
        let first = search.scene();
        let graphs = self.graphs(&first, sensors, &closed);
        let chances = learned(&graphs);
        if self.is_bright() {
            search.deeper(&graphs, &chances);
        }
        let all = search.scene();
        let verdicts = predicted(&self.graphs(&all, sensors, &closed), &chances);
        (verdicts, search.hypotheses(), search.rejections())
    }

    /// Whether so late bounces are asked for that the room must be a bright one.
    pub(super) const fn is_bright(&self) -> bool {
        self.bounces as usize >= DEEP
    }

    fn graphs<'a>(&self, scene: &'a Scene, sensors: &[OfSensor], closed: &[Pairs]) -> Vec<Graph<'a>> {
        let graph = |(sensor, closed)| Graph::new(scene, sensor, closed, self.bounces());
        sensors.iter().zip(closed).map(graph).collect()
    }

    /// For each profile of one sensor, for each onset, its labels.
    fn predicted(&self, graph: &Graph, sensor: &OfSensor, chances: &Chances, blends: Option<&Blends>) -> Verdicts {
        let labels = |profile: &&[Onset]| -> Vec<Vec<Verdict>> {
            let chance = |path: &[PatchId]| graph.scene.deep_chance(path).unwrap_or_else(|| chances.of(path));
            let expectation =
                Expectation { chance: &chance, dense_chance: &|bounces| chances.of_dense(bounces), blends };
            let Associated { predictions, found, blend_sds_ps } =
                self.associated(graph, &sensor.view(profile), profile, self.bounces(), &expectation);
            let of_onset = |(candidates, blend_sd_ps): (Vec<Candidate>, f64)| {
                self.verdicts(&candidates, &predictions, blend_sd_ps)
            };
            found.into_iter().zip(blend_sds_ps).map(of_onset).collect()
        };
        sensor.profiles.par_iter().map(labels).collect()
    }

    /// Pairs whose direct light is more likely missing than seen, both ways, and those that were not captured and whose walls let none pass. Third bounces may
    /// lie where it would be: they are predicted too.
    fn closed(&self, scene: &Scene, sensor: &OfSensor, visible: &[PatchId]) -> Pairs {
        let (mut closed, mut open) = (BTreeSet::new(), BTreeSet::new());
        if self.bounces < 3 {
            return closed;
        }
        let foci = foci(scene, visible, sensor.source, sensor.setup.dimensions);
        for (n, (a, focus)) in visible.iter().zip(&foci).enumerate() {
            let others = visible.iter().zip(&foci).skip(n + 1);
            closed.extend(others.filter(|(_, other)| !facing::exchange_light(focus, other)).map(|(b, _)| (*a, *b)));
        }
        for profile in &sensor.profiles {
            closed.remove(&(profile[0].lit.min(profile[0].seen), profile[0].lit.max(profile[0].seen)));
        }
        let graph = Graph::new(scene, sensor, &BTreeSet::new(), 3);
        for profile in sensor.profiles.iter().filter(|profile| profile[0].lit != profile[0].seen) {
            let (lit, seen) = (profile[0].lit, profile[0].seen);
            let expectation = Expectation { chance: &|_| EVEN, dense_chance: &|_| EVEN, blends: None };
            let Associated { predictions, found, .. } =
                self.associated(&graph, &sensor.view(profile), profile, 3, &expectation);
            let is_direct = |candidate: &&Candidate| predictions[candidate.path].path.len() == 2;
            let direct: f64 = found.iter().flatten().filter(is_direct).map(|candidate| candidate.probability).sum();
            if direct > 0.5 {
                open.insert((lit.min(seen), lit.max(seen)));
            } else if scene.knows(&[lit, seen]) {
                closed.insert((lit.min(seen), lit.max(seen)));
            }
        }
        closed.retain(|pair| !open.contains(pair));
        closed
    }

    /// Predicted paths of a profile that lead over no closed pair, the direct one in any case, and for each onset those that may have made it. Orders that are too dense are clutter.
    fn associated(
        &self,
        graph: &Graph,
        view: &View,
        profile: &[Onset],
        bounces: usize,
        expectation: &Expectation,
    ) -> Associated {
        let reach_ps = expectation.blends.map_or(0.0, |blends| blends.reach_ps);
        let Paths { mut paths, dense } = graph.near(view, profile, bounces, reach_ps);
        let direct = direct(profile);
        if direct.len() <= bounces && graph.scene.knows(&direct) {
            paths.insert(0, graph.scene.predict(direct, view));
        }
        let mut arrivals: Vec<Time> =
            profile.iter().map(|onset| Time { time_ps: onset.time_ps, sd_ps: sd_ps(onset) }).collect();
        let predictions = readings(paths, view.setup.repetition_ps, &arrivals, reach_ps);
        let expected = |prediction: &Prediction| Expected {
            time: prediction.time,
            seen: if prediction.path.len() <= 2 { EVEN } else { (expectation.chance)(&prediction.path) },
        };
        let expected: Vec<Expected> = predictions.iter().map(expected).collect();
        let dense_per_ps = |arrival: &Time| match dense {
            Some(Dense { bounces, per_ps, from_ps, .. })
                if view.setup.repetition_ps.is_some() || arrival.time_ps > from_ps =>
            {
                (expectation.dense_chance)(bounces) * per_ps
            }
            _ => 0.0,
        };
        let clutter_per_ps: Vec<f64> =
            arrivals.iter().map(|arrival| self.clutter_per_ns * 1e-3 + dense_per_ps(arrival)).collect();
        let mut found = associate(&arrivals, &expected, &clutter_per_ps);
        let mut blend_sds_ps = vec![0.0; profile.len()];
        if let Some(blends) = expectation.blends {
            blend_sds_ps = blends.sds_ps(profile, &predictions, &found);
            arrivals
                .iter_mut()
                .zip(&blend_sds_ps)
                .for_each(|(arrival, sd_ps)| arrival.sd_ps = arrival.sd_ps.hypot(*sd_ps));
            found = associate(&arrivals, &expected, &clutter_per_ps);
        }
        Associated { predictions, found, blend_sds_ps }
    }

    fn verdicts(&self, candidates: &[Candidate], predictions: &[Prediction], blend_sd_ps: f64) -> Vec<Verdict> {
        let verdict = |(n, candidate): (usize, &Candidate)| {
            let Prediction { path, turns, .. } = &predictions[candidate.path];
            Verdict {
                turns: *turns,
                path: Some(path.clone()),
                residual_ps: Some(candidate.residual_ps),
                blend_sd_ps,
                probability: candidate.probability,
                alternative: n as i32,
            }
        };
        let is_sure = candidates.first().is_some_and(|best| best.probability >= self.probability_min);
        if is_sure {
            return candidates[..1].iter().enumerate().map(verdict).collect();
        }
        let unexplained = 1.0 - candidates.iter().map(|candidate| candidate.probability).sum::<f64>();
        let open = Verdict { probability: unexplained.max(0.0), ..Verdict::open() };
        let others = candidates.iter().take(ALTERNATIVES).enumerate().map(|(n, candidate)| verdict((n + 1, candidate)));
        std::iter::once(open).chain(others).collect()
    }
}

/// Predictions near any of the arrivals or within `reach_ps`, read with the laser periods that bring them there.
fn readings(
    paths: Vec<(Vec<PatchId>, Time)>,
    period_ps: Option<f64>,
    arrivals: &[Time],
    reach_ps: f64,
) -> Vec<Prediction> {
    let reach = |arrival: &Time, time: &Time| (GATE * arrival.sd_ps.hypot(time.sd_ps)).max(reach_ps);
    let mut predictions = Vec::new();
    for (path, time) in paths {
        let mut turns: Vec<i32> = arrivals
            .iter()
            .filter_map(|arrival| {
                let late_ps = time.time_ps - arrival.time_ps;
                let turns = period_ps.map_or(0.0, |period_ps| (late_ps / period_ps).round());
                let off_ps = late_ps - turns * period_ps.unwrap_or(0.0);
                (off_ps.abs() <= reach(arrival, &time)).then_some(turns as i32)
            })
            .collect();
        turns.sort_unstable();
        turns.dedup();
        predictions.extend(turns.into_iter().map(|turns| Prediction {
            path: path.clone(),
            turns,
            time: Time { time_ps: time.time_ps - f64::from(turns) * period_ps.unwrap_or(0.0), ..time },
        }));
    }
    predictions
}
