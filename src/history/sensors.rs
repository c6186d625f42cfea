//! What the sensors' own captures determined: calibration, drift and pick-up.

use std::collections::BTreeSet;

use serde::Serialize;

use super::HistoryError;
use super::ancestry::Table;
use super::exposures::{CaptureKey, Exposures, RawRecords};
use crate::table;
use crate::tables::{Delay, Name};

/// What a sensor's own captures determined: calibration, drift and pick-up.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SensorBehind {
    /// Table: the view of a `calibration` or `session`.
    pub table: String,
    /// Campaign.
    pub campaign: Name,
    /// Sensor.
    pub sensor: Name,
    /// Vertical range, where captures were recorded at several.
    pub range: Option<Name>,
    /// Shots, or fiducial runs, that it uses.
    pub shots: i32,
    /// Latency; null for a session.
    pub latency_ps: Option<f64>,
    /// Its standard deviation.
    pub latency_sd_ps: Option<f64>,
    /// Delay beyond the latency, as the solver estimated it.
    pub delay_ps: Option<f64>,
    /// Its standard deviation.
    pub delay_sd_ps: Option<f64>,
    /// Its raw records.
    pub raw: Vec<RawRecords>,
}

table! {
    /// Columns of a calibration.
    "calibration": CalibrationRow, CalibrationRowColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Vertical range.
        range: Option<Name>,
        /// Shots.
        shots: i32,
        /// Latency.
        latency_ps: f64,
        /// Its standard deviation.
        latency_sd_ps: f64,
    }
}

table! {
    /// Columns of a session.
    "session": SessionRow, SessionRowColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Vertical range.
        range: Option<Name>,
        /// Fiducial runs.
        fiducials: i32,
    }
}

impl SensorBehind {
    fn new(table: String, campaign: Name, sensor: Name, range: Option<Name>, shots: i32) -> Self {
        Self {
            table,
            campaign,
            sensor,
            range,
            shots,
            latency_ps: None,
            latency_sd_ps: None,
            delay_ps: None,
            delay_sd_ps: None,
            raw: Vec::new(),
        }
    }
}

/// Describes the sensors of these captures. `from` is the table whose ancestors have the information.
pub(super) fn sensors(
    exposures: &Exposures<'_>,
    keys: &BTreeSet<CaptureKey>,
    from: &Table,
    remarks: &mut Vec<String>,
) -> Result<Vec<SensorBehind>, HistoryError> {
    let ancestry = exposures.ancestry;
    let wanted: BTreeSet<(&Name, &Name)> = keys.iter().map(|(campaign, sensor, ..)| (campaign, sensor)).collect();
    let mut sensors = Vec::new();
    if let Some(table) = ancestry.nearest(from, "calibration") {
        let delays = ancestry.beside(from, "delays");
        for row in ancestry.rows(&table, |row: &CalibrationRow| wanted.contains(&(&row.campaign, &row.sensor)))? {
            let is_its = |delay: &Delay| {
                (&delay.campaign, &delay.sensor, &delay.range) == (&row.campaign, &row.sensor, &row.range)
            };
            let delay = delays.as_ref().map(|delays| ancestry.rows(delays, is_its)).transpose()?;
            let delay = delay.and_then(|mut rows| rows.pop());
            let sensor = SensorBehind {
                latency_ps: Some(row.latency_ps),
                latency_sd_ps: Some(row.latency_sd_ps),
                delay_ps: delay.as_ref().map(|delay| delay.delay_ps),
                delay_sd_ps: delay.as_ref().map(|delay| delay.sd_ps),
                ..SensorBehind::new(ancestry.label(&table), row.campaign, row.sensor, row.range, row.shots)
            };
            sensors.push((table.clone(), sensor));
        }
    }
    if let Some(table) = ancestry.nearest(from, "session") {
        for row in ancestry.rows(&table, |row: &SessionRow| wanted.contains(&(&row.campaign, &row.sensor)))? {
            let sensor = SensorBehind::new(ancestry.label(&table), row.campaign, row.sensor, row.range, row.fiducials);
            sensors.push((table.clone(), sensor));
        }
    }
    for (table, sensor) in &mut sensors {
        if let Some(traces) = ancestry.nearest(table, "traces") {
            sensor.raw = exposures.of_sensor(&traces, &sensor.campaign, &sensor.sensor, remarks)?;
        }
    }
    Ok(sensors.into_iter().map(|(_, sensor)| sensor).collect())
}
