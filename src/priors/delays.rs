//! Delays of the sensors: what calibration leaves open of them, and what an earlier solution found.

use std::collections::BTreeMap;

use super::sensor_range::{OfSensorRange, SensorRange, own_or_only};
use crate::tables::{Calibration, Delay};

/// Least share of a latency's variance that is its own and not common to its sensor. Delays that are one number need
/// no two unknowns.
const OWN: f64 = 1e-6;

/// Prior of a delay around its calibrated value, 0.
#[derive(Clone, Copy, Debug)]
pub struct Latency {
    /// Standard deviation.
    pub sd_ps: f64,
    /// Part of it that all ranges of the sensor share.
    common_sd_ps: f64,
}

/// Priors of all delays.
pub struct Latencies(BTreeMap<SensorRange, Latency>);

impl Latencies {
    /// From the rows of `calibration`.
    pub fn new(calibration: &[Calibration]) -> Self {
        let latency = |row: &Calibration| {
            let sd_ps = row.latency_sd_ps;
            let common_sd_ps = row.latency_common_sd_ps.unwrap_or(0.0).min(sd_ps * (1.0 - OWN).sqrt());
            (row.sensor_range(), Latency { sd_ps, common_sd_ps })
        };
        Self(calibration.iter().map(latency).collect())
    }

    /// The unknown delay of an onset or label, see [`own_or_only`]; `None` where its latency is exact.
    pub fn delay_of(&self, of: &impl OfSensorRange) -> Option<&SensorRange> {
        own_or_only(self.0.keys(), of).filter(|key| self.0[*key].sd_ps > 0.0)
    }

    /// Prior of a delay.
    ///
    /// # Panics
    /// When there is none of this key.
    pub fn latency(&self, key: &SensorRange) -> Latency {
        self.0[key]
    }

    /// Prior covariance of two delays.
    ///
    /// # Panics
    /// When there is none of one of these keys.
    pub fn covariance_ps2(&self, a: &SensorRange, b: &SensorRange) -> f64 {
        let (first, second) = (self.0[a], self.0[b]);
        if a == b {
            first.sd_ps * first.sd_ps
        } else if (&a.campaign, &a.sensor) == (&b.campaign, &b.sensor) {
            first.common_sd_ps * second.common_sd_ps
        } else {
            0.0
        }
    }
}

/// Delays that an earlier solution found, beyond the calibrated latencies.
#[derive(Debug)]
pub struct Delays(BTreeMap<SensorRange, (f64, f64)>);

impl Delays {
    /// From the rows of `delays`.
    pub fn new(rows: &[Delay]) -> Self {
        Self(rows.iter().map(|row| (row.sensor_range(), (row.delay_ps, row.sd_ps))).collect())
    }

    /// Which delay an onset or label has, see [`own_or_only`].
    pub fn key_of(&self, of: &impl OfSensorRange) -> Option<&SensorRange> {
        own_or_only(self.0.keys(), of)
    }

    /// A delay and its standard deviation.
    ///
    /// # Panics
    /// When there is none of this key.
    pub fn at(&self, key: &SensorRange) -> (f64, f64) {
        self.0[key]
    }

    /// Delay of an onset, label or profile, and its standard deviation; zeros where there is none.
    pub fn delay_ps(&self, of: &impl OfSensorRange) -> (f64, f64) {
        self.key_of(of).map_or((0.0, 0.0), |key| self.at(key))
    }
}
