//! `refine`: all patches and delays at once, by maximum likelihood on onset times (beyond the paper, whose Algorithm 1
//! embeds distances).
//!
//! Every labelled onset is the length of a path, of first, second and later bounces alike, weighted by its own standard
//! deviation. Unknown, in addition to the patches, are:
//! - a delay for each sensor and vertical range, with what calibration leaves open as prior; ranges of one sensor share
//!   the error of the known path;
//! - stations with an `sd_m` in campaign.toml;
//! - the laser's period, where onsets lie in several (`repetition_sd_ps`; else a ten-thousandth).
//!
//! Patches that no label has as lit or seen are `hidden`: third bounces over them place them. The column `kind` has
//! this, or `mirror` where campaign.toml does.
//!
//! Patches with `position_m` are anchors, those with a `ray` lie on it, each to its standard deviation. Anchors, rays
//! and stations apart fix the frame. Without them, the frame of `patches` is a convention (table `fits`). What else is
//! open stands in `ambiguities`: parts that share no path, patches that can move, mirror images, flips, onsets that may
//! be read another way (`label`), and patches whose later light has no path, or that onsets which were left out would
//! place elsewhere (`doubtful`). Mirror images and flips explain the onsets about as well, other readings of an onset
//! that others hardly check too; each has its likelihood, and is an alternative in `patches`. Its
//! `probability` there is its share of the likelihood among all places of its patch. Onsets may leave a hidden patch
//! two places, on either side of the wall that shows it: the one on the laser's side is chosen.
//!
//! The light of a large patch does not come from its centre. Where a patch has a size and a normal, the shift is
//! predicted and taken off ([`crate::geometry::footprint`]), again after each solution, until it stays. They are those
//! of campaign.toml (`size_m`, with a normal from `planes` (of `surface`) or, in a fixed frame, from campaign.toml);
//! else what the widths of the patch's onsets tell, if these are more than noise, with their errors as unknowns. The
//! table `footprints` has them as the times of all onsets moved them, so that who predicts more onsets from it predicts
//! what this solution does. An onset that is wider than its patches make it has other light in it, which pulls its
//! time. Behind first and second bounces, which no other light precedes, that is light over one more patch
//! ([`crate::geometry::companion`]): where the patches are says when it comes, such light in onsets of its own how
//! strong it is. The pull is taken off, and its error is part of that of the onset (`residuals.blend_ps`, `sd_ps`). An
//! onset that was fitted as a point, where its patches spread light, is off by what that moves it: so its error is
//! larger.
//!
//! Delays may drift while the captures are taken, and no fiducial be there to follow them. Where residuals are larger
//! than chance allows, and the onsets have the times of their captures (`acquired_at`), each sensor's delay is a random
//! walk ([`crate::geometry::drift`]), if that is likelier by `e^7` than larger errors of all onsets. How far it walks
//! follows from the likelihood. `delays` has it at knots, with standard deviations, so that later stages take it off
//! too.
//!
//! Where residuals are larger than chance allows (the 99.9 % point of chi-square, each residual cut at three standard
//! deviations), the model does not explain the onsets. Onsets of a kind that scatters more than it should (first,
//! second, later bounces, onsets read as two) get larger variances (`fits.widened`). What is left makes all variances
//! larger by the factor of an M-estimator (`fits.misfit`), and likelihoods of alternatives count less by that.
//!
//! Without a labelled onset, `patches` that all have a covariance are passed on: anchors whose own light was not
//! recorded.
//!
//! Onsets of one profile share errors: jitter, what their pulses take from one another, both parts of a pair. Their
//! covariance (`labels.covariance`) weighs them together; residuals and standard deviations in the tables are of each
//! alone.
//!
//! Residuals beyond three standard deviations count linearly, so that a wrong label does little harm. Where more labels
//! are wrong, onsets that contradict the others are left out ([`maximum_likelihood::outliers`]). The table `suspects`
//! lists these, residuals beyond four of their own standard deviations, and onsets that no other checks. Beyond 1,000
//! patches covariances are of each patch alone (`fits.covariance`), and alternatives are not searched for.
//!
//! Takes `labels`; writes `patches`, `patch_covariances`, `delays`, `stations`, `residuals`, `suspects`, `fits`,
//! `ambiguities`, `footprints`. Optional tables:
//! - `patches` to start from; those that are missing are placed from nothing ([`crate::geometry::placement`]);
//! - `calibration`, without which latencies are taken as exact;
//! - `planes`;
//! - `scenes` of the `label` that wrote the labels: places that it did not take are alternatives too, if all onsets are
//!   about as likely under them. Each is solved for without later bounces over its patches, whose labels hold for the
//!   places that were taken alone.
//!
//! ```toml
//! [patches]
//! stage = "refine"
//! from = "labels"
//! with = { patches = "first", calibration = "calibration", planes = "first_planes" }
//! ```

mod companions;
mod context;
mod doubtful;
mod drift;
mod extents;
mod model;
mod others;
mod readings;
mod rows;
mod shared;
mod weights;

use arrow_array::RecordBatch;
use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Rejection, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::geometry::Point;
use crate::geometry::drift::Evidence;
use crate::geometry::footprint::Footprints;
use crate::geometry::loss::Loss;
use crate::geometry::maximum_likelihood::{self, Observation, Problem, Solution, Unsolved};
use crate::geometry::repeats::Repeats;
use crate::priors::campaign_fields::ByCampaign;
use crate::priors::footprints::{self, Extent};
use crate::tables::{
    Ambiguity, Delay, Fit, Label, ONSET_KINDS, Patch, PatchCovariance, PatchFootprint, Residual, Row, Station, Suspect,
};
use context::{Context, Fields};
use doubtful::Later;
use drift::Drift;
use extents::Extents;
use model::{Model, footprint_errors};
use readings::Onsets;
use rows::{Fitted, Tables};

/// Footprints are predicted anew until no path changes by more than `SHIFTED_M`, and weights until none changes, for at
/// most `ROUNDS` rounds.
const SHIFTED_M: f64 = 1e-6;
const ROUNDS: usize = 6;
/// Delays drift where the onsets make it likelier by this factor: `e^7`, about 1 in 10,000 campaigns without a drift.
const DRIFT_GAIN: f64 = 7.0;
/// The size of a drift is computed anew until it changes by less than this share.
const SAME_SIZE: f64 = 0.02;

/// Parameters of `refine`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Refine {
    /// Whether large residuals count linearly instead of squared, and onsets that contradict the others are left out.
    robust: bool,
}

impl Default for Refine {
    fn default() -> Self {
        Self { robust: true }
    }
}

impl Stage for Refine {
    const KIND: &'static str = "refine";
    const VERSION: u32 = 21;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "patches", table: "patches", required: false },
        Beside { name: "calibration", table: "calibration", required: false },
        Beside { name: "planes", table: "planes", required: false },
        Beside { name: "scenes", table: "scenes", required: false },
    ];
    const SIDES: &'static [Side] = &[
        Side { name: PatchCovariance::TABLE, schema: PatchCovariance::schema },
        Side { name: Delay::TABLE, schema: Delay::schema },
        Side { name: Station::TABLE, schema: Station::schema },
        Side { name: Residual::TABLE, schema: Residual::schema },
        Side { name: Suspect::TABLE, schema: Suspect::schema },
        Side { name: Fit::TABLE, schema: Fit::schema },
        Side { name: Ambiguity::TABLE, schema: Ambiguity::schema },
        Side { name: PatchFootprint::TABLE, schema: PatchFootprint::schema },
    ];
    type Input = Label;
    type Output = Patch;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| campaign.into())
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        Context::new(fields, beside)
    }
}

impl Apply for Refine {
    fn apply(&self, context: &Context, group: Vec<Label>) -> Result<Outcome<Patch>, StageError> {
        let later = Later::new(&group);
        let (taken, not_taken): (Vec<Label>, Vec<Label>) = group.into_iter().partition(|label| label.alternative == 0);
        let labels: Vec<Label> = taken.into_iter().filter(|label| label.path.is_some()).collect();
        if labels.is_empty() {
            return unlabelled(context);
        }
        let mut model = Model::new(context, &labels);
        let mut problem = model.problem(self.loss());
        let start = problem.start.clone();
        let (mut solution, refusal) = self.solve_first(&model, &mut problem)?;
        let is_fixed = solution.free_rotations.first() == Some(&0);
        let extents = &context.first().extents;
        let given = footprints::of(extents, &footprints::normals(extents, &context.planes, is_fixed));
        let Extents { footprints, pulls } = Extents::new(&model, &problem, &solution, &given);
        for (observation, pull) in problem.observations.iter_mut().zip(&pulls) {
            observation.length_m -= pull.mean_m;
            observation.sd_m = observation.sd_m.hypot(pull.sd_m);
        }
        let mut shifts_m = vec![0.0; labels.len()];
        let measured = problem.observations.clone();
        if !footprints.is_empty() || pulls.iter().any(|pull| pull.sd_m > 0.0) {
            shifts_m = self.solve_shifted(&model, &mut problem, &mut solution, &footprints)?;
        }
        let larger = self.larger_errors(&mut model, &problem, &solution, footprint_errors(&footprints), measured);
        let scatter = larger.as_ref().map_or(1.0, |(_, scatter)| *scatter);
        if let Some((observations, _)) = larger {
            (problem.observations, problem.loss) = (observations, self.loss());
            shifts_m = self.solve_shifted(&model, &mut problem, &mut solution, &footprints)?;
        } else if let Some(refusal) = refusal {
            return Err(refusal);
        }
        let mut observations = problem.observations.clone();
        let (used, with_all) = self.leave_out(&model, &mut problem, &mut solution, &start)?;
        let mut widened = [scatter; ONSET_KINDS.len()];
        if self.robust {
            let more = self.weigh(&model, &used, &mut problem, &mut solution)?;
            for (observation, label) in observations.iter_mut().zip(&labels) {
                observation.sd_m *= more[weights::kind(label)].sqrt();
            }
            widened = more.map(|more| scatter * more);
        }
        let contested = with_all.map(|points| doubtful::contested(&solution, &points, &context.cancel));
        let contested = contested.unwrap_or_default();
        let (solution, mut others) = others::alternatives(&model, &problem, solution);
        let onsets = Onsets { not_taken: &not_taken, used: &used, observations: &observations };
        others::add_readings(
            &problem,
            &solution,
            (onsets.readings(&model, &solution, &footprints), &used),
            &mut others,
        );
        let fitted = Fitted { solution, others, observations, used, widened, contested };
        let tables = Tables::new(&model, &fitted, &shifts_m, &pulls);
        // As they explain the onsets best: whoever predicts more needs the same.
        let moved = footprints.moved(&fitted.solution.common);
        Ok(Outcome {
            rows: tables.patches(),
            sides: sides(&tables, &later, (&moved, &given)),
            rejections: unused_normals(context, is_fixed, &labels),
        })
    }
}

impl Refine {
    const fn loss(&self) -> Loss {
        if self.robust { Loss::Huber } else { Loss::Squared }
    }

    /// Where most lengths contradict one another since delays drift, no robust loss may settle. The squared one does:
    /// it is where to look for a drift from. With it comes the refusal that holds if there is none.
    fn solve_first(&self, model: &Model, problem: &mut Problem) -> Result<(Solution, Option<StageError>), StageError> {
        let refusal = match self.solve(model, problem) {
            Ok(solution) => return Ok((solution, None)),
            Err(refusal) => refusal,
        };
        problem.loss = Loss::Squared;
        match maximum_likelihood::solve(problem) {
            Ok(solution) => Ok((solution, Some(refusal))),
            Err(_) => Err(refusal),
        }
    }

    /// Huber's loss settles slowly where many lengths contradict one another; the redescending one takes its place.
    fn solve(&self, model: &Model, problem: &mut Problem) -> Result<Solution, StageError> {
        let solution = match maximum_likelihood::solve(problem) {
            Err(Unsolved::NotSettled) if self.robust => {
                problem.loss = Loss::Redescending;
                maximum_likelihood::solve(problem)
            }
            solution => solution,
        };
        solution.map_err(|unsolved| StageError::Refused(model.refused(&unsolved)))
    }

    /// The onsets with larger errors, where residuals are larger than chance makes them and a drift explains them, or
    /// onsets of one path in both directions differ that much; with the factor on all variances. Their errors in common
    /// have the numbers from `first` on.
    fn larger_errors(
        &self,
        model: &mut Model,
        problem: &Problem,
        solution: &Solution,
        first: usize,
        measured: Vec<Observation>,
    ) -> Option<(Vec<Observation>, f64)> {
        if !solution.exceeds_chance() {
            return None;
        }
        if let Some(drift) = self.drift(model, problem, solution, first) {
            let observations = drifting(&drift, model.labels, measured);
            model.drift = Some(drift);
            return Some((observations, 1.0));
        }
        let factor = Repeats::of(&problem.observations).scatter().filter(|_| self.robust)?;
        Some((scattered(measured, factor, first), factor))
    }

    /// Walks of the delays, where residuals are larger than chance makes them and the onsets make these likelier; their
    /// errors in common have the numbers from `first` on.
    fn drift(&self, model: &Model, problem: &Problem, solution: &Solution, first: usize) -> Option<Drift> {
        let mut drift = Drift::new(model, solution, problem, first)?;
        for _ in 0..ROUNDS {
            let observations = drifting(&drift, model.labels, problem.observations.clone());
            let (start, loss) = (solution.points.clone(), self.loss());
            let mut walked = Problem { start, observations, loss, ..problem.clone() };
            let solution = self.solve(model, &mut walked).ok()?;
            let (scale, gain) = Evidence::new(&solution, drift.errors())?.size();
            if gain < DRIFT_GAIN {
                return None;
            }
            drift = drift.scaled(scale, gain);
            if (scale - 1.0).abs() < SAME_SIZE {
                break;
            }
        }
        Some(drift)
    }

    /// Solves again without onsets that contradict the others. Of all onsets their place among those that are left, and
    /// where all of them would place the patches.
    fn leave_out(
        &self,
        model: &Model,
        problem: &mut Problem,
        solution: &mut Solution,
        start: &[Point],
    ) -> Result<(Vec<Option<usize>>, Option<Vec<Point>>), StageError> {
        let all = (0..problem.observations.len()).map(Some).collect();
        if !self.robust || !solution.exceeds_chance() {
            return Ok((all, None));
        }
        let places = [solution.points.as_slice(), start];
        let Some((out, points)) = maximum_likelihood::outliers(problem, &solution.points, &places) else {
            return Ok((all, None));
        };
        let mut is_out = out.iter();
        problem.observations.retain(|_| is_out.next() == Some(&false));
        (problem.start, problem.loss) = (points, Loss::Huber);
        let with_all = std::mem::take(&mut solution.points);
        *solution = self.solve(model, problem)?;
        let mut next = 0..;
        Ok((out.iter().map(|out| if *out { None } else { next.next() }).collect(), Some(with_all)))
    }

    /// Solves again with larger variances for onsets of kinds that scatter more, until none does; gives the factors.
    fn weigh(
        &self,
        model: &Model,
        used: &[Option<usize>],
        problem: &mut Problem,
        solution: &mut Solution,
    ) -> Result<[f64; ONSET_KINDS.len()], StageError> {
        let of_used = model.labels.iter().zip(used).filter(|(_, used)| used.is_some());
        let kinds: Vec<usize> = of_used.map(|(label, _)| weights::kind(label)).collect();
        let mut widened = [1.0; ONSET_KINDS.len()];
        for _ in 0..ROUNDS {
            let factors = weights::factors(problem, solution, &kinds);
            if factors == [1.0; ONSET_KINDS.len()] {
                break;
            }
            for (observation, kind) in problem.observations.iter_mut().zip(&kinds) {
                observation.sd_m *= factors[*kind].sqrt();
            }
            widened.iter_mut().zip(factors).for_each(|(all, factor)| *all *= factor);
            problem.start.clone_from(&solution.points);
            *solution = self.solve(model, problem)?;
        }
        Ok(widened)
    }

    /// Solves again with the shifts of footprints taken off, until these stay; gives the shifts.
    fn solve_shifted(
        &self,
        model: &Model,
        problem: &mut Problem,
        solution: &mut Solution,
        footprints: &Footprints,
    ) -> Result<Vec<f64>, StageError> {
        let measured = std::mem::take(&mut problem.observations);
        let mut shifts_m = vec![0.0; measured.len()];
        for _ in 0..ROUNDS {
            let next_m;
            (problem.observations, next_m) = model.shifted(&measured, footprints, solution);
            let changes_m = next_m.iter().zip(&shifts_m).map(|(next, last)| (next - last).abs());
            let changed_m = changes_m.fold(0.0, f64::max);
            shifts_m = next_m;
            problem.start.clone_from(&solution.points);
            *solution = self.solve(model, problem)?;
            if changed_m < SHIFTED_M {
                break;
            }
        }
        // Errors with larger numbers are those of a drift.
        let of_footprints = &solution.common[..footprint_errors(footprints).min(solution.common.len())];
        let of_errors_m = problem.observations.iter().map(|observation| observation.common_m(of_footprints));
        Ok(shifts_m.iter().zip(of_errors_m).map(|(shift_m, more_m)| shift_m + more_m).collect())
    }
}

/// Onsets with the walks of their sensors' delays.
fn drifting(drift: &Drift, labels: &[Label], mut observations: Vec<Observation>) -> Vec<Observation> {
    labels.iter().zip(&mut observations).for_each(|(label, observation)| drift.add_to(label, observation));
    observations
}

/// Onsets whose variances are larger by a factor. What makes captures scatter made those of the calibration scatter
/// too, so that all share one more error of this size, with the number `error`.
fn scattered(mut observations: Vec<Observation>, factor: f64, error: usize) -> Vec<Observation> {
    let mut variances_m2: Vec<f64> = observations.iter().map(|observation| observation.sd_m.powi(2)).collect();
    variances_m2.sort_by(f64::total_cmp);
    let shared_m = ((factor - 1.0) * variances_m2[variances_m2.len() / 2]).sqrt();
    for observation in &mut observations {
        observation.sd_m *= factor.sqrt();
        observation.common.push((error, shared_m));
    }
    observations
}

/// The tables beside `patches`, in the order of [`Refine::SIDES`]; of footprints those that were `moved` and `given`.
fn sides(tables: &Tables, later: &Later, (moved, given): (&Footprints, &Footprints)) -> Vec<RecordBatch> {
    let residuals = tables.residuals();
    vec![
        PatchCovariance::to_batch(&tables.patch_covariances()),
        Delay::to_batch(&tables.delays()),
        Station::to_batch(&tables.stations()),
        Residual::to_batch(&residuals),
        Suspect::to_batch(&tables.suspects(&residuals)),
        Fit::to_batch(&tables.fits()),
        Ambiguity::to_batch(&tables.ambiguities(later)),
        PatchFootprint::to_batch(&tables.footprints(moved, given)),
    ]
}

/// Without a labelled onset: patches that need none, passed on.
fn unlabelled(context: &Context) -> Result<Outcome<Patch>, StageError> {
    if context.are_all_placed() {
        return Ok(Outcome::rows(context.start.values().cloned().collect()));
    }
    Err(StageError::Refused("no onset has a path; look at the tables `labels` and `onsets`".to_owned()))
}

/// A message where campaign.toml has normals, but nothing ties its frame to that of the patches.
fn unused_normals(context: &Context, is_fixed: bool, labels: &[Label]) -> Vec<Rejection> {
    let has_normal = context.first().extents.values().any(Extent::is_whole);
    if is_fixed || !context.planes.is_empty() || !has_normal {
        return Vec::new();
    }
    let reason = "normals in campaign.toml are not used: no anchor, ray or station fixes the orientation of the scene. Sizes and directions of patches come from the widths of their onsets; give anchors, \
                 or `planes` from a stage `surface`";
    vec![Rejection::new(&labels[0].campaign, reason.to_owned())]
}

#[cfg(test)]
mod tests;
