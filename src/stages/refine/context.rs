//! What campaign.toml, a start, a calibration and planes say before any onset is looked at.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::geometry::Point;
use crate::priors::campaign_fields::{ByCampaign, Medium, PatchPrior, StationPriors};
use crate::priors::delays::Latencies;
use crate::priors::footprints::{self, Extent};
use crate::priors::sensor_range::{OfSensorRange, SensorRange, own_or_only};
use crate::stages::stage::{BesideTables, StageError};
use crate::tables::{Calibration, Label, Name, Patch, Plane, SceneOdds};
use crate::units::PatchId;

/// Share of the laser's period that is its standard deviation where campaign.toml gives none.
const PERIOD_SD: f64 = 1e-4;

/// What campaign.toml says that paths depend on.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    pub dimensions: u8,
    #[serde(flatten)]
    pub medium: Medium,
    pub repetition_ps: Option<f64>,
    repetition_sd_ps: Option<f64>,
    #[serde(flatten)]
    pub stations: StationPriors,
    pub patches: BTreeMap<PatchId, PatchPrior>,
    pub extents: BTreeMap<PatchId, Extent>,
}

impl From<&Campaign> for Fields {
    fn from(campaign: &Campaign) -> Self {
        Self {
            dimensions: campaign.dimensions,
            medium: campaign.into(),
            repetition_ps: campaign.repetition_ps,
            repetition_sd_ps: campaign.repetition_sd_ps,
            stations: campaign.into(),
            patches: PatchPrior::of_all(campaign),
            extents: footprints::extents(campaign),
        }
    }
}

impl Fields {
    /// Standard deviation of the laser's period.
    pub fn period_sd_ps(&self) -> Option<f64> {
        self.repetition_ps.map(|period_ps| self.repetition_sd_ps.unwrap_or(PERIOD_SD * period_ps))
    }
}

/// Other places of some patches, by how well all onsets fit them.
pub struct Rival {
    pub places: BTreeMap<PatchId, Point>,
    /// Less that of the places that were taken.
    pub log_likelihood: f64,
}

impl Rival {
    fn new(scene: &SceneOdds, start: &[Patch]) -> Self {
        let rows =
            start.iter().filter(|row| row.alternative == scene.alternative && scene.patches.contains(&row.patch));
        let places = rows.map(|row| (row.patch, Point::new(row.x_m, row.y_m, row.z_m))).collect();
        Self { places, log_likelihood: scene.log_likelihood }
    }
}

/// Campaigns, start, priors of the delays, and the planes of an earlier solution.
pub struct Context {
    pub fields: ByCampaign<Fields>,
    pub start: BTreeMap<PatchId, Patch>,
    /// Places that were not taken when the onsets were labelled.
    pub rivals: Vec<Rival>,
    pub latencies: Latencies,
    /// Full width at half maximum of each response.
    pub widths_ps: BTreeMap<SensorRange, f64>,
    /// When the responses were captured, by campaign and sensor: the earliest.
    pub calibrated_at: BTreeMap<(Name, Name), Name>,
    pub planes: Vec<Plane>,
    /// Ends the solution.
    pub cancel: Cancel,
}

/// By campaign and sensor, the earliest time at which a response was captured.
fn calibrated_at(calibration: &[Calibration]) -> BTreeMap<(Name, Name), Name> {
    let mut times = BTreeMap::new();
    for row in calibration {
        let Some(time) = &row.acquired_at else { continue };
        let earliest: &mut Name =
            times.entry((row.campaign.clone(), row.sensor.clone())).or_insert_with(|| time.clone());
        if time < earliest {
            earliest.clone_from(time);
        }
    }
    times
}

impl Context {
    pub fn new(fields: ByCampaign<Fields>, beside: &BesideTables) -> Result<Self, StageError> {
        let start = beside.rows::<Patch>("patches")?.unwrap_or_default();
        let scenes = beside.rows::<SceneOdds>("scenes")?.unwrap_or_default();
        let rivals = scenes.iter().map(|scene| Rival::new(scene, &start)).collect();
        let calibration: Vec<Calibration> = beside.rows("calibration")?.unwrap_or_default();
        let best = start.into_iter().filter(|patch| patch.alternative == 0);
        Ok(Self {
            fields,
            start: best.map(|patch| (patch.patch, patch)).collect(),
            rivals,
            latencies: Latencies::new(&calibration),
            widths_ps: calibration.iter().map(|row| (row.sensor_range(), row.width_ps)).collect(),
            calibrated_at: calibrated_at(&calibration),
            planes: beside.rows("planes")?.unwrap_or_default(),
            cancel: beside.cancel.clone(),
        })
    }

    /// Width of the response that an onset was measured with; `None` where no calibration has it.
    pub fn response_width_ps(&self, label: &Label) -> Option<f64> {
        let width_ps = self.widths_ps[own_or_only(self.widths_ps.keys(), label)?];
        Some(width_ps).filter(|width_ps| *width_ps > 0.0)
    }

    /// Whether there are patches to start from, and all of them have a covariance: no onset needs to place them.
    pub fn are_all_placed(&self) -> bool {
        !self.start.is_empty() && self.start.values().all(|patch| patch.sd_m.is_some())
    }

    /// The fields whose frame holds: those of the first campaign.
    pub fn first(&self) -> &Fields {
        self.fields.first().expect("a run has a campaign")
    }
}
