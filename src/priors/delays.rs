//! Delays of the sensors: what calibration leaves open of them, and what an earlier solution found.

use std::collections::BTreeMap;

use super::acquisition_time;
use super::corrections;
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
pub struct Delays(BTreeMap<SensorRange, SolvedDelay>);

#[derive(Debug)]
struct SolvedDelay {
    delay_ps: f64,
    sd_ps: f64,
    drift: Option<Drift>,
}

/// What a delay changes by through the captures, at knots.
#[derive(Debug)]
struct Drift {
    from_s: f64,
    /// Since then, ascending.
    knots_s: Vec<f64>,
    values_ps: Vec<f64>,
    /// Of delay and drift together.
    sds_ps: Vec<f64>,
}

impl Drift {
    fn new(row: &Delay) -> Option<Self> {
        let drift = Self {
            from_s: acquisition_time::seconds(row.drift_from.as_deref()?)?,
            knots_s: row.drift_knots_s.clone()?,
            values_ps: row.drift_ps.clone()?,
            sds_ps: row.drift_sd_ps.clone()?,
        };
        let lengths = [drift.values_ps.len(), drift.sds_ps.len()];
        (drift.knots_s.len() > 1 && lengths == [drift.knots_s.len(); 2]).then_some(drift)
    }

    /// At a time; at one that is not known, the middle of all, which is off by as much as the drift goes.
    fn at(&self, time_s: Option<f64>) -> (f64, f64) {
        if let Some(time_s) = time_s {
            let since_s = time_s - self.from_s;
            let knot = self.knots_s.partition_point(|knot_s| *knot_s < since_s).clamp(1, self.knots_s.len() - 1) - 1;
            let step_s = self.knots_s[knot + 1] - self.knots_s[knot];
            let position = knot as f64 + (since_s - self.knots_s[knot]) / step_s;
            return corrections::at(&self.values_ps, &self.sds_ps, position);
        }
        let most = |values: &[f64]| values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let least_ps = self.values_ps.iter().copied().fold(f64::INFINITY, f64::min);
        let most_ps = most(&self.values_ps);
        (0.5 * (least_ps + most_ps), most(&self.sds_ps).hypot(0.5 * (most_ps - least_ps)))
    }
}

impl Delays {
    /// From the rows of `delays`.
    pub fn new(rows: &[Delay]) -> Self {
        let solved = |row: &Delay| SolvedDelay { delay_ps: row.delay_ps, sd_ps: row.sd_ps, drift: Drift::new(row) };
        Self(rows.iter().map(|row| (row.sensor_range(), solved(row))).collect())
    }

    /// Which delay an onset or label has, see [`own_or_only`].
    pub fn key_of(&self, of: &impl OfSensorRange) -> Option<&SensorRange> {
        own_or_only(self.0.keys(), of)
    }

    /// Standard deviation of a delay, which all its captures share; without its drift.
    ///
    /// # Panics
    /// When there is none of this key.
    pub fn sd_ps(&self, key: &SensorRange) -> f64 {
        self.0[key].sd_ps
    }

    /// Delay of an onset, label or profile that was captured at a time, and its standard deviation; zeros where there
    /// is none.
    pub fn delay_ps(&self, of: &impl OfSensorRange, acquired_at: Option<&str>) -> (f64, f64) {
        let Some(SolvedDelay { delay_ps, sd_ps, drift }) = self.key_of(of).map(|key| &self.0[key]) else {
            return (0.0, 0.0);
        };
        let Some(drift) = drift else { return (*delay_ps, *sd_ps) };
        let (drift_ps, sd_ps) = drift.at(acquired_at.and_then(acquisition_time::seconds));
        (delay_ps + drift_ps, sd_ps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drift_is_taken_at_the_time_of_a_capture() {
        let row = Delay {
            campaign: "c".into(),
            sensor: "a".into(),
            delay_ps: 3.0,
            sd_ps: 0.5,
            drift_from: Some("2026-05-12T09:00:00".into()),
            drift_knots_s: Some(vec![0.0, 3600.0, 7200.0]),
            drift_ps: Some(vec![0.0, 4.0, 2.0]),
            drift_sd_ps: Some(vec![1.0, 2.0, 3.0]),
            ..Delay::default()
        };
        let key = row.sensor_range();
        let delays = Delays::new(std::slice::from_ref(&row));
        assert_eq!(delays.delay_ps(&key, Some("2026-05-12T09:30:00")), (5.0, 1.5));
        assert_eq!(delays.delay_ps(&key, Some("2026-05-12T11:00:00")), (5.0, 3.0));
        assert_eq!(delays.delay_ps(&key, None), (5.0, 13.0_f64.sqrt()));
        let steady = Delays::new(&[Delay { drift_from: None, ..row }]);
        assert_eq!(steady.delay_ps(&key, Some("2026-05-12T09:30:00")), (3.0, 0.5));
    }
}
