//! What a campaign, a start and a calibration say before any onset is looked at.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::campaign::Campaign;
use crate::campaign::keys::{self, LASER};
use crate::cancel::Cancel;
use crate::priors::delays::Latencies;
use crate::priors::footprints::{self, Told};
use crate::tables::{Calibration, Patch};
use crate::units::PatchId;

/// Share of the laser's period that is its standard deviation where campaign.toml gives none.
const PERIOD_SD: f64 = 1e-4;

/// What a campaign says that paths depend on.
#[derive(Clone, Debug, Serialize)]
pub struct Setup {
    pub dimensions: u8,
    pub group_index: f64,
    pub repetition_ps: Option<f64>,
    pub repetition_sd_ps: Option<f64>,
    pub stations: BTreeMap<String, keys::Station>,
    /// Station of each sensor.
    pub sensors: BTreeMap<String, String>,
    pub patches: BTreeMap<PatchId, keys::Patch>,
    pub footprints: BTreeMap<PatchId, Told>,
}

impl Setup {
    pub fn new(campaign: &Campaign) -> Self {
        // What is written for people changes no position; footprints stand apart.
        let silent = |(id, patch): (&PatchId, &keys::Patch)| {
            (
                *id,
                keys::Patch { label: None, size_m: None, normal: None, lobe_rad: None, through: None, ..patch.clone() },
            )
        };
        let station = |sensor: &keys::Sensor| sensor.station.clone().unwrap_or_else(|| LASER.to_owned());
        Self {
            dimensions: campaign.dimensions,
            group_index: campaign.group_index,
            repetition_ps: campaign.repetition_ps,
            repetition_sd_ps: campaign.repetition_sd_ps,
            stations: campaign.stations.clone(),
            sensors: campaign.sensors.iter().map(|(name, sensor)| (name.clone(), station(sensor))).collect(),
            patches: campaign.patches.iter().map(silent).collect(),
            footprints: footprints::told(campaign),
        }
    }

    /// Standard deviation of the laser's period.
    pub fn period_sd_ps(&self) -> Option<f64> {
        self.repetition_ps.map(|period_ps| self.repetition_sd_ps.unwrap_or(PERIOD_SD * period_ps))
    }
}

/// Setups, start, and priors of the delays.
pub struct Known {
    pub setups: BTreeMap<String, Setup>,
    pub start: BTreeMap<PatchId, Patch>,
    pub latencies: Latencies,
    /// Ends the solution.
    pub cancel: Cancel,
}

impl Known {
    pub fn new(
        setups: BTreeMap<String, Setup>,
        start: Vec<Patch>,
        calibration: Vec<Calibration>,
        cancel: Cancel,
    ) -> Self {
        Self {
            setups,
            start: start.into_iter().filter(|patch| patch.alternative == 0).map(|patch| (patch.patch, patch)).collect(),
            latencies: Latencies::new(calibration),
            cancel,
        }
    }

    /// The setup whose frame holds: that of the first campaign.
    pub fn first(&self) -> &Setup {
        self.setups.values().next().expect("a run has a campaign")
    }
}
