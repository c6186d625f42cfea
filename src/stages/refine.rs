//! `refine`: all patches and delays at once, by maximum likelihood on onset times (beyond the paper, whose Algorithm 1 embeds distances).
//!
//! Every labelled onset is the length of a path; positions and the sensors' left-over delays are what explains all of them best. Each delay has as prior
//! the standard deviation that calibration gives its latency. Anchors (patches with `position_m`) enter with their `sd_m`. Residuals beyond three
//! standard deviations count linearly, so that a wrong label does little harm; those beyond four are marked.
//!
//! Takes `labels`; writes `patches` and, beside it, `patch_covariances`, `delays`, `residuals`. Beside it: `patches` to start from (required), and
//! `calibration`; without it the sensors' latencies are taken as exact. Not modelled: uncertain stations, onsets of one profile that share an
//! error (each profile gives one onset up to second bounces), mirror images as alternatives.
//!
//! ```toml
//! [patches]
//! stage = "refine"
//! from = "labels"
//! with = { patches = "start", calibration = "calibration" }
//! ```

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Rejection, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::geometry::maximum_likelihood::{self, Anchor, Node, Observation, Problem, Solution, Unsolved};
use crate::geometry::{Point, frame, procrustes};
use crate::tables::{Calibration, Delay, Label, Name, Patch, PatchCovariance, Residual, Row};
use crate::units::{self, PatchId};

/// Residuals beyond this many standard deviations are marked.
const SUSPECT: f64 = 4.0;
/// Standard deviation of an anchor that gives none: exact, as far as numbers go.
const EXACT_M: f64 = 1e-6;

/// Parameters of `refine`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Refine {
    /// Whether large residuals count linearly instead of squared.
    robust: bool,
}

impl Default for Refine {
    fn default() -> Self {
        Self { robust: true }
    }
}

/// What a campaign says that paths depend on.
#[derive(Clone, Debug, Serialize)]
pub struct Setup {
    dimensions: u8,
    group_index: f64,
    source_m: [f64; 3],
    sensors_m: BTreeMap<String, [f64; 3]>,
    /// Position and standard deviation of each anchor.
    anchors_m: BTreeMap<PatchId, ([f64; 3], Option<f64>)>,
}

/// Setups, start, and priors of the delays.
pub struct Known {
    setups: BTreeMap<String, Setup>,
    start: BTreeMap<PatchId, Patch>,
    /// Standard deviation of each sensor's latency.
    latency_sd_ps: BTreeMap<(Name, Name), f64>,
}

impl Stage for Refine {
    const KIND: &'static str = "refine";
    const VERSION: u32 = 1;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "patches", table: "patches", required: true },
        Beside { name: "calibration", table: "calibration", required: false },
    ];
    const SIDES: &'static [Side] = &[
        Side { name: PatchCovariance::TABLE, schema: PatchCovariance::schema },
        Side { name: Delay::TABLE, schema: Delay::schema },
        Side { name: Residual::TABLE, schema: Residual::schema },
    ];
    type Input = Label;
    type Output = Patch;
    type Fields = BTreeMap<String, Setup>;
    type Context = Known;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        let station =
            |campaign: &Campaign, sensor: &String| Some((sensor.clone(), campaign.station_of(sensor)?.position_m));
        let setup = |campaign: &Campaign| Setup {
            dimensions: campaign.dimensions,
            group_index: campaign.group_index,
            source_m: campaign.source().position_m,
            sensors_m: campaign.sensors.keys().filter_map(|sensor| station(campaign, sensor)).collect(),
            anchors_m: campaign
                .patches
                .iter()
                .filter_map(|(id, patch)| Some((*id, (patch.position_m?, patch.sd_m))))
                .collect(),
        };
        campaigns.iter().map(|campaign| (campaign.name.clone(), setup(campaign))).collect()
    }

    fn context(&self, setups: Self::Fields, beside: &BesideTables) -> Result<Known, StageError> {
        let start = beside.rows::<Patch>("patches")?.unwrap_or_default();
        let calibration = beside.rows::<Calibration>("calibration")?.unwrap_or_default();
        Ok(Known {
            setups,
            start: start.into_iter().filter(|patch| patch.alternative == 0).map(|patch| (patch.patch, patch)).collect(),
            latency_sd_ps: calibration
                .into_iter()
                .map(|row| ((row.campaign, row.sensor), row.latency_sd_ps))
                .filter(|(_, sd)| *sd > 0.0)
                .collect(),
        })
    }
}

impl Apply for Refine {
    fn apply(&self, known: &Known, group: Vec<Label>) -> Result<Outcome<Patch>, StageError> {
        let (labels, lost): (Vec<Label>, Vec<Label>) = group
            .into_iter()
            .filter(|label| label.alternative == 0 && label.path.is_some())
            .partition(|label| label.path.iter().flatten().all(|patch| known.start.contains_key(patch)));
        let model = Model::new(known, &labels);
        let problem = model.problem(self.robust);
        let solution = maximum_likelihood::solve(&problem).map_err(|unsolved| model.refused(&unsolved))?;
        let turn = model.frame(&solution);
        Ok(Outcome {
            rows: model.patches(&solution, &turn),
            sides: vec![
                PatchCovariance::to_batch(&model.patch_covariances(&solution, &turn)),
                Delay::to_batch(&model.delays(&solution)),
                Residual::to_batch(&model.residuals(&solution)),
            ],
            rejections: lost_patches(known, &lost),
        })
    }
}

/// Patches that onsets speak of, but that have no place to start from.
fn lost_patches(known: &Known, lost: &[Label]) -> Vec<Rejection> {
    let mut patches: BTreeMap<PatchId, (usize, Name)> = BTreeMap::new();
    for label in lost {
        for patch in label.path.iter().flatten().filter(|patch| !known.start.contains_key(patch)) {
            patches.entry(*patch).or_insert_with(|| (0, label.campaign.clone())).0 += 1;
        }
    }
    let reject = |(patch, (onsets, campaign)): (PatchId, (usize, Name))| Rejection {
        campaign,
        file: None,
        segment: None,
        byte_offset: None,
        reason: format!(
            "patch {patch} has {onsets} labelled onsets but no place to start from, so they are left out: its first bounce is missing"
        ),
    };
    patches.into_iter().map(reject).collect()
}

/// The labelled onsets as a problem, and its unknowns by their names.
struct Model<'a> {
    known: &'a Known,
    labels: &'a [Label],
    patches: Vec<PatchId>,
    sensors: Vec<(Name, Name)>,
}

impl<'a> Model<'a> {
    fn new(known: &'a Known, labels: &'a [Label]) -> Self {
        let patches: BTreeSet<PatchId> = labels.iter().flat_map(|label| label.path.iter().flatten().copied()).collect();
        let sensors: BTreeSet<(Name, Name)> =
            labels.iter().map(|label| (label.campaign.clone(), label.sensor.clone())).collect();
        let sensors = sensors.into_iter().filter(|sensor| known.latency_sd_ps.contains_key(sensor)).collect();
        Self { known, labels, patches: patches.into_iter().collect(), sensors }
    }

    fn setup(&self, label: &Label) -> &Setup {
        &self.known.setups[&*label.campaign]
    }

    /// The setup whose frame holds: that of the first campaign.
    fn first(&self) -> &Setup {
        self.known.setups.values().next().expect("a run has a campaign")
    }

    fn place(&self, patch: PatchId) -> usize {
        self.patches.binary_search(&patch).expect("all patches of the labels are unknowns")
    }

    fn problem(&self, robust: bool) -> Problem {
        let start = |patch: &PatchId| {
            let row = &self.known.start[patch];
            Point::new(row.x_m, row.y_m, row.z_m)
        };
        let anchor = |(patch, (position_m, sd_m)): (&PatchId, &([f64; 3], Option<f64>))| {
            let patch = self.patches.binary_search(patch).ok()?;
            Some(Anchor { patch, position: Point::from(*position_m), sd_m: sd_m.unwrap_or(EXACT_M) })
        };
        Problem {
            start: self.patches.iter().map(start).collect(),
            dimensions: usize::from(self.first().dimensions),
            observations: self.labels.iter().map(|label| self.observation(label)).collect(),
            anchors: self.first().anchors_m.iter().filter_map(anchor).collect(),
            delay_sd_m: self
                .sensors
                .iter()
                .map(|sensor| units::path_m(self.known.latency_sd_ps[sensor], self.index(sensor)))
                .collect(),
            robust,
        }
    }

    fn index(&self, sensor: &(Name, Name)) -> f64 {
        self.known.setups[&*sensor.0].group_index
    }

    fn observation(&self, label: &Label) -> Observation {
        let setup = self.setup(label);
        let path = label.path.iter().flatten().map(|patch| Node::Patch(self.place(*patch)));
        let source = Node::Station(Point::from(setup.source_m));
        let sensor = Node::Station(Point::from(setup.sensors_m[&*label.sensor]));
        Observation {
            nodes: std::iter::once(source).chain(path).chain([sensor]).collect(),
            length_m: units::path_m(label.time_ps, setup.group_index),
            sd_m: units::path_m(label.time_sd_ps, setup.group_index),
            delay: self.sensors.binary_search(&(label.campaign.clone(), label.sensor.clone())).ok(),
        }
    }

    fn refused(&self, unsolved: &Unsolved) -> StageError {
        StageError::Refused(match unsolved {
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
        })
    }

    /// The canonical frame where all rotations are free; the solution's own otherwise.
    fn frame(&self, solution: &Solution) -> Matrix3<f64> {
        let all = if self.first().dimensions == 2 { 1 } else { 3 };
        if solution.free_rotations == all {
            frame::canonical(&solution.points, self.centre())
        } else {
            Matrix3::identity()
        }
    }

    fn centre(&self) -> Point {
        Point::from(self.first().source_m)
    }

    fn patches(&self, solution: &Solution, turn: &Matrix3<f64>) -> Vec<Patch> {
        let chi2_dof = (solution.degrees_of_freedom > 0).then(|| solution.chi2 / solution.degrees_of_freedom as f64);
        let row = |(place, &patch): (usize, &PatchId)| {
            let point = procrustes::turn(turn, self.centre(), solution.points[place]);
            let cov = turn * solution.patch_covariance_m2(place, place) * turn.transpose();
            Patch {
                patch,
                kind: self.known.start[&patch].kind.clone(),
                x_m: point.x,
                y_m: point.y,
                z_m: point.z,
                cov_xx_m2: Some(cov[(0, 0)]),
                cov_xy_m2: Some(cov[(0, 1)]),
                cov_xz_m2: Some(cov[(0, 2)]),
                cov_yy_m2: Some(cov[(1, 1)]),
                cov_yz_m2: Some(cov[(1, 2)]),
                cov_zz_m2: Some(cov[(2, 2)]),
                sd_m: Some(cov.trace().sqrt()),
                onsets: self.labels.iter().filter(|label| label.path.iter().flatten().any(|of| *of == patch)).count()
                    as i32,
                chi2_dof,
                alternative: 0,
                log_likelihood: Some(-0.5 * solution.chi2),
            }
        };
        self.patches.iter().enumerate().map(row).collect()
    }

    fn patch_covariances(&self, solution: &Solution, turn: &Matrix3<f64>) -> Vec<PatchCovariance> {
        let count = self.patches.len();
        let pairs = (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b)));
        let row = |(a, b): (usize, usize)| {
            let cov = turn * solution.patch_covariance_m2(a, b) * turn.transpose();
            PatchCovariance {
                a: self.patches[a],
                b: self.patches[b],
                cov_xx_m2: cov[(0, 0)],
                cov_xy_m2: cov[(0, 1)],
                cov_xz_m2: cov[(0, 2)],
                cov_yx_m2: cov[(1, 0)],
                cov_yy_m2: cov[(1, 1)],
                cov_yz_m2: cov[(1, 2)],
                cov_zx_m2: cov[(2, 0)],
                cov_zy_m2: cov[(2, 1)],
                cov_zz_m2: cov[(2, 2)],
            }
        };
        pairs.map(row).collect()
    }

    fn delays(&self, solution: &Solution) -> Vec<Delay> {
        let row = |(n, sensor): (usize, &(Name, Name))| {
            let time = |length_m| units::time_ps(length_m, self.index(sensor));
            Delay {
                campaign: sensor.0.clone(),
                sensor: sensor.1.clone(),
                delay_ps: time(solution.delays_m[n]),
                sd_ps: time(solution.delay_variance_m2(n).sqrt()),
                prior_sd_ps: self.known.latency_sd_ps[sensor],
            }
        };
        self.sensors.iter().enumerate().map(row).collect()
    }

    fn residuals(&self, solution: &Solution) -> Vec<Residual> {
        let row = |(label, residual_m): (&Label, &f64)| {
            let residual_ps = units::time_ps(*residual_m, self.setup(label).group_index);
            let standardised = residual_ps / label.time_sd_ps;
            Residual {
                campaign: label.campaign.clone(),
                sensor: label.sensor.clone(),
                lit: label.lit,
                seen: label.seen,
                rank: label.rank,
                path: label.path.clone().expect("only labels with a path are observations"),
                residual_ps,
                sd_ps: label.time_sd_ps,
                standardised,
                suspect: standardised.abs() > SUSPECT,
            }
        };
        self.labels.iter().zip(&solution.residuals_m).map(row).collect()
    }
}
