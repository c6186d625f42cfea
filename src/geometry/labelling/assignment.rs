//! Which predicted path made which arrival of a profile, by [`crate::association`].

use rayon::prelude::*;

use super::blends::Blends;
use super::chances::Chances;
use super::paths::{Graph, INDIRECT, Paths};
use super::problem::{Arrival, Options, SensorProfiles, Verdict, Verdicts, View};
use super::scene::{Prediction, Scene};
use crate::association::{Candidate, Expected, GATE, Time, associate, log_total};
use crate::units::PatchId;

/// Alternatives listed for an arrival that is left open.
const ALTERNATIVES: usize = 4;
/// Chance of light that may as well be missing.
const EVEN: f64 = 0.5;

/// Chances that paths make arrivals, before these are looked at.
pub(super) enum Prior<'a> {
    /// Each path as probably as not.
    Even,
    /// As learned from the campaign; with `blends`, light of other paths may pull an arrival.
    Learned { chances: &'a Chances, blends: Option<&'a Blends<'a>> },
}

impl<'a> Prior<'a> {
    pub(super) fn of(&self, scene: &Scene, path: &[PatchId]) -> f64 {
        match self {
            Self::Learned { chances, .. } if path.len() >= INDIRECT => {
                scene.deep_chance(path).unwrap_or_else(|| chances.of(path))
            }
            // Whether a pair exchanges light is open beforehand.
            Self::Even | Self::Learned { .. } => EVEN,
        }
    }

    fn of_dense(&self, bounces: usize) -> f64 {
        match self {
            Self::Even => EVEN,
            Self::Learned { chances, .. } => chances.of_dense(bounces),
        }
    }

    const fn blends(&self) -> Option<&'a Blends<'a>> {
        match self {
            Self::Even => None,
            Self::Learned { blends, .. } => *blends,
        }
    }
}

/// What may have made the arrivals of a profile.
pub(super) struct Assignment {
    pub(super) predictions: Vec<Prediction>,
    /// For each arrival, the most probable first.
    pub(super) candidates: Vec<Vec<Candidate>>,
    /// Standard deviation that the light of other paths adds to each arrival.
    blend_sds_ps: Vec<f64>,
}

impl Assignment {
    /// Paths over open pairs, the direct one in any case, with the arrivals that they may have made. Orders that are
    /// too dense are clutter.
    pub(super) fn new(graph: &Graph, view: View, bounces: usize, clutter_per_ns: f64, prior: &Prior) -> Self {
        let blends = prior.blends();
        let reach_ps = blends.map_or(0.0, |blends| blends.reach_ps);
        let mut arrivals: Vec<Time> = view.profile.arrivals.iter().map(Arrival::time).collect();
        let paths = paths(graph, view, bounces, reach_ps);
        let clutter_per_ps: Vec<f64> =
            arrivals.iter().map(|arrival| clutter_per_ps(arrival, &paths, view, clutter_per_ns, prior)).collect();
        let predictions = readings(paths.predictions, view, reach_ps);
        let expected =
            |prediction: &Prediction| Expected { time: prediction.time, seen: prior.of(graph.scene, &prediction.path) };
        let expected: Vec<Expected> = predictions.iter().map(expected).collect();
        let mut candidates = associate(&arrivals, &expected, &clutter_per_ps);
        let mut blend_sds_ps = vec![0.0; arrivals.len()];
        if let Some(blends) = blends {
            // How far light may be pulled depends on its path, and the path then on the larger error.
            blend_sds_ps = blends.sds_ps(view.profile, &predictions, &candidates);
            for (arrival, blend_sd_ps) in arrivals.iter_mut().zip(&blend_sds_ps) {
                arrival.sd_ps = arrival.sd_ps.hypot(*blend_sd_ps);
            }
            candidates = associate(&arrivals, &expected, &clutter_per_ps);
        }
        Self { predictions, candidates, blend_sds_ps }
    }

    /// For each arrival its label if that is sure enough; else none, with alternatives.
    fn verdicts(&self, arrivals: &[Arrival], probability_min: f64) -> Vec<Vec<Verdict>> {
        let candidates = self.candidates.iter().zip(&self.blend_sds_ps).zip(arrivals);
        let of_arrival = |((candidates, sd_ps), arrival): ((&Vec<Candidate>, &f64), &Arrival)| {
            // A path is no surer than the reading of the onset that it belongs to.
            let scaled = |candidate: &Candidate| Candidate {
                probability: candidate.probability * arrival.certainty,
                ..*candidate
            };
            let candidates: Vec<Candidate> = candidates.iter().map(scaled).collect();
            self.verdicts_of(&candidates, *sd_ps, probability_min)
        };
        candidates.map(of_arrival).collect()
    }

    fn verdicts_of(&self, candidates: &[Candidate], blend_sd_ps: f64, probability_min: f64) -> Vec<Verdict> {
        if let Some(best) = candidates.first().filter(|best| best.probability >= probability_min) {
            return vec![self.verdict(best, blend_sd_ps)];
        }
        let unexplained = 1.0 - candidates.iter().map(|candidate| candidate.probability).sum::<f64>();
        let mut verdicts = vec![Verdict { probability: unexplained.max(0.0), ..Verdict::open() }];
        let alternatives = candidates.iter().take(ALTERNATIVES);
        verdicts.extend(alternatives.map(|candidate| self.verdict(candidate, blend_sd_ps)));
        verdicts
    }

    fn verdict(&self, candidate: &Candidate, blend_sd_ps: f64) -> Verdict {
        let Prediction { path, turns, .. } = &self.predictions[candidate.path];
        Verdict {
            turns: *turns,
            path: Some(path.clone()),
            residual_ps: Some(candidate.residual_ps),
            blend_sd_ps,
            probability: candidate.probability,
        }
    }
}

/// For each profile of one sensor, for each arrival, its label and alternatives.
pub(super) fn verdicts(
    graph: &Graph,
    sensor: &SensorProfiles,
    chances: &Chances,
    blends: Option<&Blends>,
    options: &Options,
) -> Verdicts {
    let prior = Prior::Learned { chances, blends };
    let verdicts = |profile| {
        let view = View { sensor, profile };
        let assignment = Assignment::new(graph, view, options.bounces, options.clutter_per_ns, &prior);
        assignment.verdicts(&view.profile.arrivals, options.probability_min)
    };
    sensor.profiles.par_iter().map(verdicts).collect()
}

/// Log-likelihood of the profiles of one sensor against clutter alone, every arrival taken for single.
pub(super) fn log_likelihood(graph: &Graph, sensor: &SensorProfiles, prior: &Prior, options: &Options) -> f64 {
    let of_profile = |profile| {
        let view = View { sensor, profile };
        let arrivals: Vec<Time> = view.profile.arrivals.iter().map(Arrival::time).collect();
        let paths = paths(graph, view, options.bounces, 0.0);
        let clutter_per_ps: Vec<f64> = arrivals
            .iter()
            .map(|arrival| clutter_per_ps(arrival, &paths, view, options.clutter_per_ns, prior))
            .collect();
        // Against the same clutter in every scene, whether or not an order is too dense to be labelled.
        let extra: f64 = clutter_per_ps.iter().map(|density| (density / (options.clutter_per_ns * 1e-3)).ln()).sum();
        let expected =
            |prediction: &Prediction| Expected { time: prediction.time, seen: prior.of(graph.scene, &prediction.path) };
        let expected: Vec<Expected> = readings(paths.predictions, view, 0.0).iter().map(expected).collect();
        extra + log_total(&arrivals, &expected, &clutter_per_ps)
    };
    // Summed in order, so that the last digits do not depend on the number of threads.
    let of_profiles: Vec<f64> = sensor.profiles.par_iter().map(of_profile).collect();
    of_profiles.iter().sum()
}

/// Paths near a profile's arrivals, the direct one first.
pub(super) fn paths(graph: &Graph, view: View, bounces: usize, reach_ps: f64) -> Paths {
    let mut paths = graph.near(view, bounces, reach_ps);
    let direct = view.profile.direct();
    if direct.len() <= bounces && graph.scene.has(&direct) {
        paths.predictions.insert(0, graph.scene.predict(direct, view));
    }
    paths
}

/// Density of arrivals that no predicted path makes, about one arrival.
fn clutter_per_ps(arrival: &Time, paths: &Paths, view: View, clutter_per_ns: f64, prior: &Prior) -> f64 {
    let dense = paths.dense.filter(|dense| dense.may_come_at(arrival.time_ps, view));
    clutter_per_ns * 1e-3 + dense.map_or(0.0, |dense| prior.of_dense(dense.bounces) * dense.per_ps)
}

/// Predictions near any of the arrivals or within `reach_ps`, with the laser periods taken off that bring them there.
pub(super) fn readings(predictions: Vec<Prediction>, view: View, reach_ps: f64) -> Vec<Prediction> {
    let medium = view.medium();
    let mut readings = Vec::new();
    for Prediction { path, time, .. } in predictions {
        for turns in turns(&time, view, reach_ps) {
            let time = Time { time_ps: time.time_ps - medium.turns_ps(turns), ..time };
            readings.push(Prediction { path: path.clone(), turns, time });
        }
    }
    readings
}

/// Laser periods that bring a time near an arrival, ascending.
fn turns(time: &Time, view: View, reach_ps: f64) -> Vec<i32> {
    let medium = view.medium();
    let near = view.profile.arrivals.iter().filter_map(|arrival| {
        let late_ps = time.time_ps - arrival.time_ps;
        let turns = medium.nearest_turns(late_ps);
        let off_ps = late_ps - medium.turns_ps(turns);
        (off_ps.abs() <= (GATE * arrival.sd_ps.hypot(time.sd_ps)).max(reach_ps)).then_some(turns)
    });
    let mut turns: Vec<i32> = near.collect();
    turns.sort_unstable();
    turns.dedup();
    turns
}
