//! `characterize`: is the instrument what the method takes it for? The checks of paper figure 7, and those that its
//! figure leaves out.
//!
//! | check | from | a good instrument |
//! |---|---|---|
//! | `linearity`, `signal_dependent_delay` | runs that differ in attenuation or power alone | 0 |
//! | `inverse_square`, `shift_per_path`; `latency_ps` | runs that differ in the length of the path alone | -2, 1 |
//! | `bounces_N` | runs of N bounces | signal-to-noise ratio of 5 |
//! | `delay_drift`, `delay_scatter`, `power_drift`, `width_drift` | runs that differ in nothing but their time | 0 (scatter: 1) |
//! | `echo` | all runs with a pulse | 0 |
//! | `pickup` | runs of role blocked | 0 |
//! | `noise_codes` | dark runs, else what precedes the pulse | 0.5 at least |
//! | `noise`, `noise_correlation`, `noise_slope`, `width`, `dynamic_range_db` | | for information |
//!
//! Runs of roles response and fiducial make series, each role its own. All other settings are the same in a series, so
//! that signal, path and time are not confused; of several series the longest is checked. `calibrate` uses responses of
//! one path alone, so a path series is best captured as fiducial. Time is `acquired_at`, or the order of the runs'
//! names where files do not state it.
//!
//! A check fails where chance would hardly take a good instrument as far beyond the tolerance. The limit is the
//! probability `level`, shared among all tested checks of the sensor (Bonferroni), and within a check among its trials.
//! At tolerance 0 `level` is the chance that a good instrument fails any check; a tolerance makes it smaller. Standard
//! deviations are those of the runs (normal), but for `power_drift`, where they come from the scatter (Student's t).
//!
//! Takes `measurements`; writes `checks`.
//!
//! ```toml
//! [checks]
//! stage = "characterize"
//! from = "measurements"
//! params = { level = 0.05 }
//! ```

mod across;
mod finding;
mod series;
mod within;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, BesideTables, Grain, Outcome, Stage, StageError};
use crate::campaign::{Campaign, Role};
use crate::parameter::{NonNegative, Share};
use crate::tables::{Check, Measurement, Name};
use finding::Finding;
use series::Run;

/// Parameters of `characterize`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Characterize {
    /// Chance that a good instrument fails any check.
    level: Share,
    /// Compression at the largest amplitude: optical densities are known to about 0.01.
    linearity_tolerance: NonNegative,
    /// Delay over the range of amplitudes: two millimetres of an attenuator's glass.
    delay_tolerance_ps: NonNegative,
    /// Deviation of the exponent from -2: real diffusers are not quite Lambertian.
    exponent_tolerance: NonNegative,
    /// Deviation of the shift per path from 1.
    shift_tolerance: NonNegative,
    /// Change of the delay from the first to the last run of a time series.
    drift_tolerance_ps: NonNegative,
    /// Relative change of the amplitude over a time series.
    power_tolerance: NonNegative,
    /// Relative change of the width over a time series.
    width_tolerance: NonNegative,
    /// Amplitude of an echo over that of its pulse: -40 dB, a good cable.
    echo_tolerance: NonNegative,
    /// Pick-up; 0: none that as many shots can show.
    pickup_tolerance_v: NonNegative,
}

impl Default for Characterize {
    fn default() -> Self {
        Self {
            level: Share::new(0.05),
            linearity_tolerance: NonNegative::new(0.02),
            delay_tolerance_ps: NonNegative::new(3.0),
            exponent_tolerance: NonNegative::new(0.05),
            shift_tolerance: NonNegative::new(0.001),
            drift_tolerance_ps: NonNegative::new(1.0),
            power_tolerance: NonNegative::new(0.02),
            width_tolerance: NonNegative::new(0.01),
            echo_tolerance: NonNegative::new(0.01),
            pickup_tolerance_v: NonNegative::new(0.0),
        }
    }
}

impl Stage for Characterize {
    const KIND: &'static str = "characterize";
    const VERSION: u32 = 1;
    const GRAIN: Grain = Grain::All;
    type Input = Measurement;
    type Output = Check;
    type Fields = BTreeMap<String, f64>;
    /// Group index of each campaign.
    type Context = Self::Fields;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        campaigns.iter().map(|campaign| (campaign.name.clone(), campaign.group_index)).collect()
    }

    fn context(&self, fields: Self::Fields, _: &BesideTables) -> Result<Self::Context, StageError> {
        Ok(fields)
    }
}

impl Apply for Characterize {
    fn apply(&self, indices: &Self::Context, group: Vec<Measurement>) -> Result<Outcome<Check>, StageError> {
        let mut sensors: BTreeMap<(Name, Name), Vec<&Measurement>> = BTreeMap::new();
        for row in group.iter().filter(|row| *row.role != *Role::Scene.name()) {
            sensors.entry((row.campaign.clone(), row.sensor.clone())).or_default().push(row);
        }
        let mut checks = Vec::new();
        for ((campaign, sensor), rows) in sensors {
            let findings = self.findings(&rows, indices[&*campaign]);
            let tested = findings.iter().filter(|finding| finding.chance().is_some()).count();
            let least = self.level.get() / tested.max(1) as f64;
            checks.extend(findings.into_iter().map(|finding| finding.row(&campaign, &sensor, least)));
        }
        Ok(Outcome::rows(checks))
    }
}

impl Characterize {
    /// All checks of one sensor.
    fn findings(&self, rows: &[&Measurement], group_index: f64) -> Vec<Finding> {
        let lit = |row: &&&Measurement| [Role::Response, Role::Fiducial].iter().any(|role| *row.role == *role.name());
        let lit: Vec<&Measurement> = rows.iter().filter(lit).copied().collect();
        let runs: Vec<Run<'_>> = lit.iter().copied().filter_map(Run::of).collect();
        let mut findings = self.of_light(&runs);
        findings.extend(self.of_path(&runs, group_index));
        findings.extend(within::bounces(&lit));
        findings.extend(self.of_time(&runs));
        findings.push(within::echo(self, &runs));
        findings.push(within::pickup(self, rows));
        findings.extend(within::noise(rows));
        findings.extend(within::told_of_pulses(&runs));
        findings
    }

    fn of_light(&self, runs: &[Run<'_>]) -> Vec<Finding> {
        const MISSING: &str = "no series of attenuations: capture one path at three attenuation_od or power_w at least, nothing else changed";
        let series = series::attenuation(runs).unwrap_or_default();
        vec![
            across::linearity(self, &series).unwrap_or_else(|| Finding::missing("linearity", MISSING)),
            across::signal_dependent_delay(self, &series)
                .unwrap_or_else(|| Finding::missing("signal_dependent_delay", MISSING)),
        ]
    }

    fn of_path(&self, runs: &[Run<'_>], group_index: f64) -> Vec<Finding> {
        const MISSING: &str =
            "no series of paths: capture a diffuser at three path_m at least, nothing else changed (role fiducial)";
        let series = series::path(runs).unwrap_or_default();
        let mut findings =
            vec![across::inverse_square(self, &series).unwrap_or_else(|| Finding::missing("inverse_square", MISSING))];
        match across::shift_per_path(self, &series, group_index) {
            Some(more) => findings.extend(more),
            None => findings.push(Finding::missing("shift_per_path", MISSING)),
        }
        findings
    }

    fn of_time(&self, runs: &[Run<'_>]) -> Vec<Finding> {
        const MISSING: &str =
            "no series in time: capture one setting three times at least, spread over the session (role fiducial)";
        match series::time(runs) {
            Some(series) => across::drifts(self, &series),
            None => ["delay_drift", "power_drift", "width_drift"]
                .map(|check| Finding::missing(check, MISSING))
                .into_iter()
                .collect(),
        }
    }
}
