//! What a campaign, a start and a calibration say before any onset is looked at.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::campaign::Campaign;
use crate::campaign::keys::{self, LASER};
use crate::stages::footprints::{self, Told};
use crate::tables::{Calibration, Name, Patch};
use crate::units::PatchId;

/// Share of the laser's period that is its standard deviation where campaign.toml gives none.
const PERIOD_SD: f64 = 1e-4;
/// Least part of a latency's variance that is its own and not common to its sensor: delays that are one number need no two unknowns.
const OWN: f64 = 1e-6;

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

/// Campaign, sensor and vertical range whose delay is unknown.
pub type DelayKey = (Name, Name, Option<Name>);

/// Standard deviation of a latency, and the part of it that all ranges of its sensor share.
#[derive(Clone, Copy, Debug)]
pub struct Latency {
    pub sd_ps: f64,
    common_sd_ps: f64,
}

/// Setups, start, and priors of the delays.
pub struct Known {
    pub setups: BTreeMap<String, Setup>,
    pub start: BTreeMap<PatchId, Patch>,
    latencies: BTreeMap<DelayKey, Latency>,
}

impl Known {
    pub fn new(setups: BTreeMap<String, Setup>, start: Vec<Patch>, calibration: Vec<Calibration>) -> Self {
        let latency = |row: Calibration| {
            let sd_ps = row.latency_sd_ps;
            let common_sd_ps = row.latency_common_sd_ps.unwrap_or(0.0).min(sd_ps * (1.0 - OWN).sqrt());
            ((row.campaign, row.sensor, row.range), Latency { sd_ps, common_sd_ps })
        };
        Self {
            setups,
            start: start.into_iter().filter(|patch| patch.alternative == 0).map(|patch| (patch.patch, patch)).collect(),
            latencies: calibration.into_iter().map(latency).filter(|(_, latency)| latency.sd_ps > 0.0).collect(),
        }
    }

    /// The setup whose frame holds: that of the first campaign.
    pub fn first(&self) -> &Setup {
        self.setups.values().next().expect("a run has a campaign")
    }

    /// The calibrated delay of a sensor at a range: that of the range, or the only one of the sensor. `None` where latencies are exact.
    pub fn delay_of(&self, campaign: &Name, sensor: &Name, range: Option<&Name>) -> Option<DelayKey> {
        let key = (campaign.clone(), sensor.clone(), range.cloned());
        if self.latencies.contains_key(&key) {
            return Some(key);
        }
        let mut of_sensor = self.latencies.keys().filter(|(c, s, _)| c == campaign && s == sensor);
        of_sensor.next().filter(|_| of_sensor.next().is_none()).cloned()
    }

    /// Prior of a delay.
    pub fn latency(&self, key: &DelayKey) -> Latency {
        self.latencies[key]
    }

    /// Prior covariance of two delays.
    pub fn covariance_ps2(&self, a: &DelayKey, b: &DelayKey) -> f64 {
        let (first, second) = (self.latencies[a], self.latencies[b]);
        if a == b {
            first.sd_ps * first.sd_ps
        } else if (&a.0, &a.1) == (&b.0, &b.1) {
            first.common_sd_ps * second.common_sd_ps
        } else {
            0.0
        }
    }
}
