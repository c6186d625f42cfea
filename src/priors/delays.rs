//! What calibration leaves open of the sensors' delays.

use std::collections::BTreeMap;

use crate::tables::{Calibration, Name};

/// Least part of a latency's variance that is its own and not common to its sensor: delays that are one number need no two unknowns.
const OWN: f64 = 1e-6;

/// Campaign, sensor and vertical range whose delay is unknown.
pub type DelayKey = (Name, Name, Option<Name>);

/// Prior of a latency around its calibrated value.
#[derive(Clone, Copy, Debug)]
pub struct Latency {
    /// Standard deviation.
    pub sd_ps: f64,
    /// Part of it that all ranges of the sensor share.
    common_sd_ps: f64,
}

/// Of all sensors and ranges whose latency is not exact.
pub struct Latencies(BTreeMap<DelayKey, Latency>);

impl Latencies {
    /// From the rows of `calibration`; a latency without standard deviation is exact and has no entry.
    pub fn new(calibration: Vec<Calibration>) -> Self {
        let latency = |row: Calibration| {
            let sd_ps = row.latency_sd_ps;
            let common_sd_ps = row.latency_common_sd_ps.unwrap_or(0.0).min(sd_ps * (1.0 - OWN).sqrt());
            ((row.campaign, row.sensor, row.range), Latency { sd_ps, common_sd_ps })
        };
        Self(calibration.into_iter().map(latency).filter(|(_, latency)| latency.sd_ps > 0.0).collect())
    }

    /// The calibrated delay of a sensor at a range: that of the range, or the only one of the sensor. `None` where latencies are exact.
    pub fn delay_of(&self, campaign: &Name, sensor: &Name, range: Option<&Name>) -> Option<DelayKey> {
        let key = (campaign.clone(), sensor.clone(), range.cloned());
        if self.0.contains_key(&key) {
            return Some(key);
        }
        let mut of_sensor = self.0.keys().filter(|(c, s, _)| c == campaign && s == sensor);
        of_sensor.next().filter(|_| of_sensor.next().is_none()).cloned()
    }

    /// Prior of a delay.
    pub fn latency(&self, key: &DelayKey) -> Latency {
        self.0[key]
    }

    /// Prior covariance of two delays.
    pub fn covariance_ps2(&self, a: &DelayKey, b: &DelayKey) -> f64 {
        let (first, second) = (self.0[a], self.0[b]);
        if a == b {
            first.sd_ps * first.sd_ps
        } else if (&a.0, &a.1) == (&b.0, &b.1) {
            first.common_sd_ps * second.common_sd_ps
        } else {
            0.0
        }
    }
}
