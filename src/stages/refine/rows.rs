//! A solution as rows of tables.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector3};

use super::doubtful::Later;
use super::model::{Model, NamedStation};
use super::others::{Other, OtherKind};
use crate::geometry::companion::Pull;
use crate::geometry::footprint::{Footprint, Footprints};
use crate::geometry::maximum_likelihood::{Node, Observation, Solution};
use crate::geometry::{Point, frame, procrustes};
use crate::priors::sensor_range::SensorRange;
use crate::priors::{covariances, footprints, scenes};
use crate::tables::{
    Ambiguity, Delay, Fit, Label, Name, ONSET_KINDS, Patch, PatchCovariance, PatchFootprint, Residual, Station, Suspect,
};
use crate::units::PatchId;

/// Residuals beyond this many of their own standard deviations are doubtful.
const FAR_OFF: f64 = 4.0;
/// An onset is unchecked where the others check no more than this share of it.
const UNCHECKED: f64 = 0.01;
/// A patch is weak where its largest principal standard deviation is this many times that of the middle patch.
const WEAK: f64 = 5.0;

/// The best solution, and which onsets it rests on.
pub struct Fitted {
    pub solution: Solution,
    pub others: Vec<Other>,
    /// All onsets, shifts by footprints taken off.
    pub observations: Vec<Observation>,
    /// Of each its place among those that the solution rests on.
    pub used: Vec<Option<usize>>,
    /// Factors on the variances of onsets by their kind.
    pub widened: [f64; ONSET_KINDS.len()],
    /// Patches that all onsets, those left out among them, would place elsewhere.
    pub contested: Vec<usize>,
}

/// The best solution, as rows of the tables that the stage writes.
pub struct Tables<'a> {
    pub model: &'a Model<'a>,
    pub solution: &'a Solution,
    pub others: &'a [Other],
    /// What each onset is late by its patches' footprints.
    pub shifts_m: &'a [f64],
    /// What other light in each onset adds to it.
    pub pulls: &'a [Pull],
    /// All onsets without their shifts, and of each its place among those that the solution rests on.
    pub observations: &'a [Observation],
    pub used: &'a [Option<usize>],
    pub widened: [f64; ONSET_KINDS.len()],
    pub contested: &'a [usize],
    /// Onsets that each patch rests on.
    onsets: BTreeMap<PatchId, i32>,
    turn: Matrix3<f64>,
    frame: &'static str,
}

impl<'a> Tables<'a> {
    pub fn new(model: &'a Model<'a>, fitted: &'a Fitted, shifts_m: &'a [f64], pulls: &'a [Pull]) -> Self {
        let Fitted { solution, others, observations, used, widened, contested } = fitted;
        let (turn, frame) = if model.all_rotations_free(solution) {
            (frame::canonical(&solution.points, centre(solution)), "canonical")
        } else if solution.free_rotations.first() == Some(&1) {
            (frame::about(&solution.points, centre(solution), station_line(solution, observations)), "stations")
        } else {
            (Matrix3::identity(), "fixed")
        };
        let mut onsets = BTreeMap::new();
        for (label, _) in model.labels.iter().zip(used).filter(|(_, used)| used.is_some()) {
            let patches: BTreeSet<PatchId> = label.path.iter().flatten().copied().collect();
            patches.into_iter().for_each(|patch| *onsets.entry(patch).or_default() += 1);
        }
        Self {
            model,
            solution,
            others,
            shifts_m,
            pulls,
            observations,
            used,
            widened: *widened,
            contested,
            onsets,
            turn,
            frame,
        }
    }

    fn turned(&self, point: Point) -> Point {
        procrustes::turn(&self.turn, centre(self.solution), point)
    }

    pub fn patches(&self) -> Vec<Patch> {
        let best = (0..self.model.patches.len()).map(|place| self.patch(place, self.solution, 0));
        let mut rows: Vec<Patch> = best.collect();
        for (number, other) in (1..).zip(self.others) {
            let log_likelihood = Some(self.log_likelihood(other));
            let of_other = other.patches.iter().map(|&place| self.patch(place, &other.solution, number));
            rows.extend(of_other.map(|row| Patch { log_likelihood, ..row }));
        }
        scenes::share_likelihood(&mut rows);
        rows
    }

    fn log_likelihood(&self, other: &Other) -> f64 {
        -0.5 * self.solution.loss + other.log_likelihood
    }

    fn patch(&self, place: usize, solution: &Solution, alternative: i32) -> Patch {
        let patch = self.model.patches[place];
        let point = self.turned(solution.points[place]);
        let cov = solution.misfit * self.turn * solution.patch_covariance_m2(place, place) * self.turn.transpose();
        let determined = (!solution.unplaced().contains(&place)).then_some(cov);
        let chi2_dof = (solution.degrees_of_freedom > 0).then(|| solution.chi2 / solution.degrees_of_freedom as f64);
        Patch {
            onsets: self.onsets.get(&patch).copied().unwrap_or(0),
            chi2_dof,
            alternative,
            log_likelihood: Some(-0.5 * solution.loss),
            ..covariances::patch_row(patch, self.model.kind(patch), point, determined.as_ref())
        }
    }

    /// Of all pairs of determined patches; of another solution those that it moves.
    pub fn patch_covariances(&self) -> Vec<PatchCovariance> {
        if !self.solution.is_exact() {
            return Vec::new();
        }
        let mut rows = self.covariances_of(self.solution, 0, |_| true);
        for (number, other) in (1..).zip(self.others) {
            let is_moved = |place: usize| other.patches.contains(&place);
            rows.extend(self.covariances_of(&other.solution, number, is_moved));
        }
        rows
    }

    /// Of pairs of determined patches, one of which is moved.
    fn covariances_of(
        &self,
        solution: &Solution,
        alternative: i32,
        is_moved: impl Fn(usize) -> bool,
    ) -> Vec<PatchCovariance> {
        let misfit = solution.misfit;
        let unplaced = solution.unplaced();
        let has = |place: &usize| !unplaced.contains(place);
        let determined: Vec<usize> = (0..self.model.patches.len()).filter(has).collect();
        let pairs = determined.iter().enumerate().flat_map(|(n, &a)| determined[n + 1..].iter().map(move |&b| (a, b)));
        let row = |(a, b): (usize, usize)| {
            let cov = misfit * self.turn * solution.patch_covariance_m2(a, b) * self.turn.transpose();
            PatchCovariance { alternative, ..covariances::row(self.model.patches[a], self.model.patches[b], &cov) }
        };
        pairs.filter(|&(a, b)| is_moved(a) || is_moved(b)).map(row).collect()
    }

    /// With those of sensors that drift, but whose latency is exact.
    pub fn delays(&self) -> Vec<Delay> {
        let row = |(n, key): (usize, &SensorRange)| {
            let time = |length_m| self.model.medium(key).time_ps(length_m);
            let prior_sd_ps = self.model.context.latencies.latency(key).sd_ps;
            let sd_m = (self.solution.misfit * self.solution.delay_variance_m2(n)).sqrt();
            Delay {
                delay_ps: time(self.solution.delays_m[n]),
                // A misfit of the onsets says nothing against the calibration.
                sd_ps: time(sd_m).min(prior_sd_ps),
                prior_sd_ps,
                ..self.drift(key, Some(n))
            }
        };
        let mut rows: Vec<Delay> = self.model.delays.iter().enumerate().map(row).collect();
        let exact = self.model.drift.iter().flat_map(|drift| drift.without_delay(&self.model.delays));
        rows.extend(exact.map(|key| self.drift(&key, None)));
        rows
    }

    /// What a drift adds to a delay, by its position among those that are unknowns.
    fn drift(&self, key: &SensorRange, delay: Option<usize>) -> Delay {
        let time = |length_m| self.model.medium(key).time_ps(length_m);
        let knots = self.model.drift.as_ref().and_then(|drift| drift.knots(&key.campaign, &key.sensor));
        let value_ps = |errors: &Vec<(usize, f64)>| time(self.solution.addition_m(None, errors).0);
        let sd_ps = |errors: &Vec<(usize, f64)>| {
            time((self.solution.misfit * self.solution.addition_m(delay, errors).1).sqrt())
        };
        Delay {
            campaign: key.campaign.clone(),
            sensor: key.sensor.clone(),
            range: key.range.clone(),
            drift_from: knots.as_ref().map(|knots| knots.from.clone()),
            drift_knots_s: knots.as_ref().map(|knots| knots.times_s.clone()),
            drift_ps: knots.as_ref().map(|knots| knots.errors.iter().map(value_ps).collect()),
            drift_sd_ps: knots.as_ref().map(|knots| knots.errors.iter().map(sd_ps).collect()),
            ..Delay::default()
        }
    }

    pub fn stations(&self) -> Vec<Station> {
        let row = |(n, named): (usize, &NamedStation)| {
            let prior_sd_m = named.station.sd_m?;
            let point = self.turned(self.solution.stations[n]);
            Some(Station {
                campaign: named.campaign.clone(),
                station: named.name.as_str().into(),
                x_m: point.x,
                y_m: point.y,
                z_m: point.z,
                sd_m: (self.solution.misfit * self.solution.station_covariance_m2(n).trace()).sqrt().min(prior_sd_m),
                moved_m: (self.solution.stations[n] - Point::from(named.station.position_m)).norm(),
                prior_sd_m,
            })
        };
        self.model.stations.iter().enumerate().filter_map(row).collect()
    }

    pub fn residuals(&self) -> Vec<Residual> {
        let residuals_m = self.solution.residuals_of_m(self.observations);
        let row = |(n, label): (usize, &Label)| {
            let time = |length_m: f64| self.model.fields(label).medium.time_ps(length_m);
            let residual_ps = time(residuals_m[n]);
            let sd_ps = time(self.observations[n].sd_m);
            let standardised = residual_ps / sd_ps;
            let redundancy = self.redundancy(n);
            let studentised = redundancy.filter(|share| *share > UNCHECKED).map(|share| standardised / share.sqrt());
            Residual {
                campaign: label.campaign.clone(),
                sensor: label.sensor.clone(),
                lit: label.lit,
                seen: label.seen,
                rank: label.rank,
                part: label.part,
                path: label.path.clone().expect("only labels with a path are observations"),
                residual_ps,
                sd_ps,
                standardised,
                studentised,
                footprint_ps: time(self.shifts_m[n]),
                blend_ps: time(self.pulls[n].mean_m),
                used: self.used[n].is_some(),
                suspect: studentised.unwrap_or(standardised).abs() > FAR_OFF,
            }
        };
        self.model.labels.iter().enumerate().map(row).collect()
    }

    /// Share of an observation's information that others check: all of one that was left out.
    fn redundancy(&self, n: usize) -> Option<f64> {
        let Some(at) = self.used[n] else {
            return Some(1.0);
        };
        let predicted_m2 = self.solution.predicted_variance_m2.as_ref()?[at];
        let sd_m = self.observations[n].sd_m;
        Some((1.0 - predicted_m2 / (sd_m * sd_m)).clamp(0.0, 1.0))
    }

    pub fn suspects(&self, residuals: &[Residual]) -> Vec<Suspect> {
        let row = |(n, residual): (usize, &Residual)| {
            let redundancy = self.redundancy(n);
            let reason = if !residual.used {
                "left-out"
            } else if residual.suspect {
                "far-off"
            } else if redundancy.is_some_and(|share| share <= UNCHECKED) {
                "unchecked"
            } else {
                return None;
            };
            Some(Suspect {
                campaign: residual.campaign.clone(),
                sensor: residual.sensor.clone(),
                lit: residual.lit,
                seen: residual.seen,
                rank: residual.rank,
                part: residual.part,
                path: residual.path.clone(),
                reason: reason.into(),
                residual_ps: residual.residual_ps,
                studentised: residual.studentised.or(redundancy.is_none().then_some(residual.standardised)),
                redundancy,
            })
        };
        let mut suspects: Vec<Suspect> = residuals.iter().enumerate().filter_map(row).collect();
        let size = |suspect: &Suspect| suspect.studentised.map_or(0.0, f64::abs);
        suspects.sort_by(|a, b| size(b).total_cmp(&size(a)));
        suspects
    }

    pub fn fits(&self) -> Vec<Fit> {
        let others = self.others.iter().map(|other| (&other.solution, self.log_likelihood(other)));
        let solutions = std::iter::once((self.solution, -0.5 * self.solution.loss)).chain(others);
        let fields = self.model.context.first();
        let medium_of = |campaign: &Name| self.model.context.fields.of(campaign).medium;
        let time = |length_m: f64| fields.medium.time_ps(length_m);
        let row = |(n, (solution, log_likelihood)): (usize, (&Solution, f64))| {
            let period_sd_ps = solution.period_variance_m2().map(|variance_m2| time(variance_m2.sqrt()));
            let repetition_ps = fields.repetition_ps.filter(|_| period_sd_ps.is_some());
            Fit {
                alternative: n as i32,
                frame: self.frame.into(),
                free_rotations: solution.free_rotations.first().copied().unwrap_or(0) as i32,
                covariance: if solution.is_exact() { "exact".into() } else { "blocks".into() },
                onsets: self.model.labels.len() as i32,
                unknowns: solution.unknowns() as i32,
                chi2: solution.chi2,
                degrees_of_freedom: solution.degrees_of_freedom as i32,
                misfit: solution.misfit,
                widened: self.widened.to_vec(),
                drift_ps: self.model.drift.as_ref().map(|drift| drift.largest_ps(solution, medium_of)),
                drift_span_s: self.model.drift.as_ref().map(|drift| drift.span_s),
                drift_log_likelihood: self.model.drift.as_ref().map(|drift| drift.gain),
                log_likelihood,
                repetition_ps: repetition_ps.map(|period_ps| period_ps + time(solution.period_m)),
                repetition_sd_ps: period_sd_ps,
            }
        };
        solutions.enumerate().map(row).collect()
    }

    /// Of all patches with one; those not `given` come from widths.
    pub fn footprints(&self, moved: &Footprints, given: &Footprints) -> Vec<PatchFootprint> {
        let row = |(patch, footprint): (&PatchId, &Footprint)| {
            let (normal, errors_m) = (self.turn * footprint.normal, self.turn * footprint.errors_m);
            let source = if given.0.contains_key(patch) { "campaign" } else { "widths" };
            footprints::row(*patch, &Footprint { normal, errors_m, ..*footprint }, source)
        };
        moved.0.iter().map(row).collect()
    }

    /// With patches whose later light contradicts their places.
    pub fn ambiguities(&self, later: &Later) -> Vec<Ambiguity> {
        let plain = |kind: &str, places: &[usize], meaning: &str| Ambiguity {
            kind: kind.into(),
            patches: self.ids(places),
            alternative: None,
            log_likelihood: None,
            sd_m: None,
            meaning: meaning.into(),
        };
        let mut rows = Vec::new();
        match self.frame {
            "canonical" => rows.push(plain("rotation", &[], "the onsets do not determine a rotation of the scene about the laser, nor its mirror image: the frame is a convention; anchors, rays or a sensor in another place would determine them")),
            "stations" => rows.push(plain("rotation", &[], "the onsets do not determine a rotation of the scene about the line of the stations, nor its mirror image: the frame is a convention; an anchor, a ray or a sensor off the line would determine them")),
            _ => {}
        }
        for (part, free) in
            self.solution.parts.iter().zip(&self.solution.free_rotations).skip(1).filter(|(_, free)| **free > 0)
        {
            let meaning = format!(
                "no onset joins these patches to the others: {free} rotations of them against the rest are open; capture pairs across"
            );
            rows.push(plain("part", part, &meaning));
        }
        if !self.solution.open.is_empty() {
            rows.push(plain("open", &self.solution.open, "these patches can move without changing any path: they have too few onsets; capture more pairs with them"));
        }
        rows.extend(self.weak());
        let doubtful = later.doubtful(&self.ids(&self.solution.unplaced()));
        if !doubtful.is_empty() {
            let meaning = "no path explains most later light of these patches: they may stand in a wrong place; capture more pairs with them";
            rows.push(Ambiguity { patches: doubtful, ..plain("doubtful", &[], meaning) });
        }
        if !self.contested.is_empty() {
            let meaning = "onsets that contradict the others were left out (`suspects`); with them these patches stand elsewhere; capture more pairs with them";
            rows.push(plain("doubtful", self.contested, meaning));
        }
        for (n, other) in self.others.iter().enumerate() {
            let (kind, meaning) = match other.kind {
                OtherKind::Mirror => (
                    "mirror",
                    "the mirror image of the whole explains the onsets as well; an anchor or a ray off the mirror's plane would decide",
                ),
                OtherKind::Flip => (
                    "flip",
                    "these patches explain the onsets as well on the other side of their neighbours; a pair with one more neighbour would decide",
                ),
                OtherKind::Label => (
                    "label",
                    "an onset that places these patches may be light of another path, or one pulse in place of two; capture more pairs with them",
                ),
            };
            rows.push(Ambiguity {
                alternative: Some(n as i32 + 1),
                log_likelihood: Some(other.log_likelihood),
                ..plain(kind, &other.patches, meaning)
            });
        }
        rows
    }

    fn ids(&self, places: &[usize]) -> Vec<PatchId> {
        places.iter().map(|&place| self.model.patches[place]).collect()
    }

    /// Patches that are determined much worse than the others.
    fn weak(&self) -> Option<Ambiguity> {
        let sd_m = |place: usize| {
            let covariance = self.solution.patch_covariance_m2(place, place);
            covariance.symmetric_eigenvalues().max().max(0.0).sqrt()
        };
        let unplaced = self.solution.unplaced();
        let is_determined = |place: &usize| !unplaced.contains(place);
        let sds_m: Vec<(usize, f64)> =
            (0..self.model.patches.len()).filter(is_determined).map(|place| (place, sd_m(place))).collect();
        let mut sorted: Vec<f64> = sds_m.iter().map(|(_, sd_m)| *sd_m).collect();
        sorted.sort_by(f64::total_cmp);
        let middle = *sorted.get(sorted.len() / 2)?;
        let weak: Vec<(usize, f64)> = sds_m.into_iter().filter(|(_, sd_m)| *sd_m > WEAK * middle).collect();
        let most = weak.iter().map(|(_, sd_m)| *sd_m).fold(0.0, f64::max);
        (!weak.is_empty()).then(|| Ambiguity {
            kind: "weak".into(),
            patches: self.ids(&weak.iter().map(|(place, _)| *place).collect::<Vec<_>>()),
            alternative: None,
            log_likelihood: None,
            sd_m: Some(most),
            meaning: Name::from("these patches are known several times worse than the others, along one direction at least; capture more pairs with them"),
        })
    }
}

fn centre(solution: &Solution) -> Point {
    solution.stations[0]
}

/// Direction from the first station to the one farthest from it, of those that light was timed at.
fn station_line(solution: &Solution, observations: &[Observation]) -> Vector3<f64> {
    let sensors = observations.iter().filter_map(|observation| match observation.nodes.last() {
        Some(Node::Station(station)) => Some(solution.stations[*station]),
        _ => None,
    });
    let arms = sensors.map(|sensor| sensor - solution.stations[0]);
    arms.max_by(|a, b| a.norm().total_cmp(&b.norm())).unwrap_or_else(Vector3::x)
}
