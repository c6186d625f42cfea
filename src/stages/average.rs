//! `average`: the shots of a capture become one mean time profile (paper section 5: exposures averaged against Gaussian
//! noise).
//!
//! Each shot is moved by its own sub-sample trigger time and onto its reference pulse, whose time is fitted with the
//! calibrated template. The offset is rounded to 1/64 sample, codes are summed as integers by phase, and each phase is
//! delayed once at the end: exact, and the same for any order and chunking. Four kinds of shots are rejected: those at
//! the converter's rails, outliers against the first 32, those without reference pulse, and those with a sample that is
//! no number.
//!
//! Baseline and noise come from the first tenth of the record. Where the mean of the first shots varies there by more
//! than the differences between shots explain, there is light; then the earliest dark stretch takes its place
//! ([`crate::signal::dark`]). A record without one stands in `rejects`, and its noise comes from these differences.
//!
//! The spread of the first 32 shots gives a model of a shot's variance over level and slope
//! ([`crate::signal::noise_model`]). Where they differ by more than fast noise along the record, as by hum, wander or
//! 1/f noise, `slow_noise` has the variances of its components ([`crate::signal::slow_noise`]), and noise model,
//! `noise_acf` and `se_v` are those of the rest. A sample's own error is its standard error, and what rounding to whole
//! codes leaves where noise is less than half a code. The laser's energy and jitter move all
//! samples together, and are reported where they are significant. Otherwise the jitter is what the fits of the
//! reference pulses leave; without reference channel, it is the trigger's, from the calibration's noise model.
//!
//! A capture taken at several vertical ranges is averaged range by range. Then each sample is the weighted mean of the
//! ranges that do not clip there ([`crate::signal::merge_ranges`]), on scale and time of the most sensitive range. The
//! profile has `shots`, `noise_v` and `noise_model` of that range, and the `phase_shots` of all. There, shots with
//! clipped samples count. Left out are these samples, those that the aligning filter makes of them, and those of the
//! amplifier's recovery. The error of the delay between ranges is in `jitter_ps`, that of their factor in `gain_sd`.
//! Where both see too little light to fit these, the stated gains (to 2 %) and the calibrated latencies of the ranges
//! stand in, on scale and time of the most sensitive range that does not clip. Where these are missing too, that range
//! stands alone, and `rejects` says why.
//!
//! Light may repeat with the laser (`repetition_ps` of the campaign). If a record then holds a period, the profile is
//! that one period, cut open in the middle of its longest dark part: its times hold modulo the period. Of a train of
//! reference pulses, the one next to the trigger counts.
//!
//! Photon histograms (sensors of kind counts) are added up as they are. Errors follow Poisson's law, and `shots_min`
//! does not count.
//!
//! Takes `traces`, and `calibration` where captures have a reference channel; writes `profiles`.
//!
//! Not modelled: gain drift within a capture; ranges that differ in bandwidth; correlation between the repetitions of a
//! folded record; histograms longer than a period, which stay as they are. Shot noise of a flash that is faster than
//! the response passes for energy of the laser.
//!
//! ```toml
//! [profiles]
//! stage = "average"
//! from = "traces"
//! with = { calibration = "calibration" }
//! params = { shots_min = 16 }
//! ```

mod capture;
mod clipping;
mod histogram;
mod noise;
mod piece;
mod record;
mod reference;
mod rejected;
mod shots;

use std::collections::BTreeMap;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::stage::{Beside, BesideTables, Fold, Grain, InPieces, Outcome, Rejection, Stage, StageError};
use crate::campaign::Campaign;
use crate::campaign::keys::SensorKind;
use crate::parameter::{Condition, Count, NonNegative, Positive};
use crate::priors::campaign_fields::ByCampaign;
use crate::priors::sensor_range::{OfSensorRange, SensorRange};
use crate::signal::response::Response;
use crate::tables::cell::Cell;
use crate::tables::traces::TraceColumns;
use crate::tables::{Calibration, Name, Profile, Trace};
use capture::Capture;
use histogram::Histogram;
use piece::Extent;
use record::Latency;

/// Share of a record that is its baseline where the pipeline does not say.
const BASELINE_SHARE: f64 = 0.1;

/// Parameters of `average`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Average {
    /// A capture with fewer valid shots is rejected.
    shots_min: Count,
    /// Length of the stretch at the start of a record that light has not reached; absent: a tenth of the record, at its
    /// start unless light is found there.
    baseline_ps: Option<Positive>,
    /// Whether outlying shots are rejected.
    reject_outliers: bool,
    /// A shot is outlying when a sample of it lies this many robust standard deviations off the median of the first
    /// shots.
    outlier_sigma: Positive,
    /// Time that the amplifier needs after clipping, in captures with several vertical ranges: as long, samples of that
    /// range are left out.
    recovery_ps: NonNegative,
}

impl Default for Average {
    fn default() -> Self {
        Self {
            shots_min: Count::new(1),
            baseline_ps: None,
            reject_outliers: true,
            outlier_sigma: Positive::new(6.0),
            recovery_ps: NonNegative::new(1000.0),
        }
    }
}

/// What campaign.toml says of the records.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    repetition_ps: Option<f64>,
    /// Laser pulses behind each histogram, of the sensors that count photons.
    cycles: BTreeMap<String, Option<u64>>,
}

/// Campaigns and calibrated sensors.
pub struct Context {
    campaigns: ByCampaign<Fields>,
    sensors: BTreeMap<(Name, Name), Sensor>,
    latencies: BTreeMap<SensorRange, Latency>,
}

/// What the calibration says of a sensor.
struct Sensor {
    /// Template of the reference pulse.
    template: Option<Response>,
    /// Variance of the time of a shot, ps^2; 0 where it is not known.
    jitter_ps2: f64,
}

impl Context {
    fn sensor(&self, row: &Trace) -> Option<&Sensor> {
        self.sensors.get(&(row.campaign.clone(), row.sensor.clone()))
    }

    fn template(&self, row: &Trace) -> Option<&Response> {
        self.sensor(row)?.template.as_ref()
    }

    /// Why reference pulses cannot be timed, and what to do.
    fn without_template(&self, row: &Trace) -> String {
        let sensor = &row.sensor;
        if self.sensor(row).is_some() {
            return format!(
                "the response captures of sensor `{sensor}` have no reference channel, but its {} captures have; \
                 give the [[captures]] rule of the response the `reference` too",
                row.role
            );
        }
        format!(
            "sensor `{sensor}` is not calibrated, so that its reference pulses cannot be timed; \
             give `with = {{ calibration = ... }}` from response captures (role = \"response\" in campaign.toml) with the same reference channel"
        )
    }

    /// Latency of a profile's own vertical range; `None` where that is not calibrated by itself.
    fn latency(&self, profile: &Profile) -> Option<Latency> {
        self.latencies.get(&profile.sensor_range()).copied()
    }

    fn trigger_ps2(&self, row: &Trace) -> f64 {
        self.sensor(row).map_or(0.0, |sensor| sensor.jitter_ps2)
    }

    fn period_ps(&self, row: &Trace) -> Option<f64> {
        self.campaigns.get(&row.campaign)?.repetition_ps
    }

    /// Laser pulses behind each histogram of a sensor that counts.
    fn cycles(&self, row: &Trace) -> Option<u64> {
        *self.campaigns.get(&row.campaign)?.cycles.get(&*row.sensor)?
    }
}

impl Stage for Average {
    const KIND: &'static str = "average";
    const VERSION: u32 = 17; // no mean_v and se_v of photon counters
    const GRAIN: Grain = Grain::Capture;
    const BESIDE: &'static [Beside] = &[Beside { name: "calibration", table: "calibration", required: false }];
    const CONDITIONS: &'static [Condition] = &[Condition("outlier_sigma", "reject_outliers", &["true"])];
    type Input = Trace;
    type Output = Profile;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| {
            let counters = campaign.sensors.iter().filter(|(_, sensor)| sensor.kind == SensorKind::Counts);
            let cycles = counters.map(|(name, sensor)| (name.clone(), sensor.cycles)).collect();
            Fields { repetition_ps: campaign.repetition_ps, cycles }
        })
    }

    fn context(&self, campaigns: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        for (campaign, fields) in campaigns.iter() {
            if let Some((sensor, _)) = fields.cycles.iter().find(|(_, cycles)| cycles.is_none()) {
                return Err(StageError::Refused(format!(
                    "sensor `{sensor}` of campaign `{campaign}` counts photons, but of how many laser pulses is not said; \
                     give `cycles` in [sensors.{sensor}] of campaign.toml"
                )));
            }
        }
        let rows = beside.rows::<Calibration>("calibration")?.unwrap_or_default();
        let latency = |row: &Calibration| {
            let own_ps2 = row.latency_sd_ps.powi(2) - row.latency_common_sd_ps.unwrap_or(0.0).powi(2);
            (row.sensor_range(), Latency { latency_ps: row.latency_ps, own_sd_ps: own_ps2.max(0.0).sqrt() })
        };
        let latencies = rows.iter().map(latency).collect();
        let sensor = |row: Calibration| {
            let template = row.reference_t0_ps.zip(row.reference);
            let template = template.map(|(t0_ps, values)| Response::new(t0_ps, row.step_ps, &values.to_f64()));
            let jitter_ps2 = row.noise_model.and_then(|model| model.last().copied()).unwrap_or(0.0);
            ((row.campaign, row.sensor), Sensor { template, jitter_ps2 })
        };
        Ok(Context { campaigns, latencies, sensors: rows.into_iter().map(sensor).collect() })
    }
}

/// A capture under way.
pub enum State {
    /// Of voltages.
    Analog(Box<Capture>),
    /// Of photons.
    Counts(Box<Histogram>),
}

impl Fold for Average {
    type State = State;

    fn begin(&self, context: &Context, first: Trace) -> State {
        match context.cycles(&first) {
            Some(cycles) => State::Counts(Box::new(Histogram::new(first, cycles))),
            None => State::Analog(Box::new(Capture::new(first, Extent::Whole))),
        }
    }

    fn step(
        &self,
        context: &Context,
        state: &mut State,
        columns: &TraceColumns,
        rows: Range<usize>,
    ) -> Result<(), StageError> {
        columns.require_codes(rows.clone()).map_err(StageError::Refused)?;
        for i in rows {
            match state {
                State::Counts(histogram) => histogram.take(columns, i),
                State::Analog(capture) if columns.is_reference.value(i) => capture.take_reference(context, columns, i),
                State::Analog(capture) => capture.take_signal(self, context, columns, i),
            }
        }
        Ok(())
    }

    fn finish(&self, context: &Context, state: State) -> Result<Outcome<Profile>, StageError> {
        match state {
            State::Analog(capture) => capture.finish(self, context),
            State::Counts(histogram) => Ok(histogram.finish(self)),
        }
    }

    fn in_pieces(&self) -> Option<&dyn InPieces<Self>> {
        Some(self)
    }
}

impl Average {
    fn shots_needed(&self) -> u32 {
        self.shots_min.get()
    }

    /// Samples of the stretch without light.
    fn baseline_samples(&self, first: &Trace) -> usize {
        let share = f64::from(first.samples) * BASELINE_SHARE;
        let samples = self.baseline_ps.map_or(share, |baseline_ps| baseline_ps.get() / first.dt_ps).round();
        (samples as usize).clamp(1, first.samples as usize)
    }
}

fn rejection(first: &Trace, why: &str) -> Rejection {
    let Trace { campaign, sensor, lit, seen, role, file, .. } = first;
    Rejection {
        campaign: campaign.clone(),
        file: Some(file.clone()),
        segment: None,
        byte_offset: None,
        reason: format!("{role} capture of sensor {sensor}, lit {lit}, seen {seen}, {why}"),
    }
}

/// Whether a row has scale, time base and setting of the first.
fn is_alike(first: &Trace, columns: &TraceColumns, i: usize) -> bool {
    let number = |column| <Option<f64> as Cell>::get(column, i);
    let scale = (columns.gain_v.value(i), columns.offset_v.value(i), columns.code_type.value(i));
    let time_base = (columns.dt_ps.value(i), columns.samples.value(i));
    let setting = (number(&columns.path_m), number(&columns.attenuation_od), number(&columns.power_w));
    scale == (first.gain_v, first.offset_v, &*first.code_type)
        && time_base == (first.dt_ps, first.samples)
        && setting == (first.path_m, first.attenuation_od, first.power_w)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_have_their_documented_defaults() {
        let parsed: Average = toml::from_str("shots_min = 16").unwrap();
        assert!(parsed.reject_outliers && parsed.shots_min.get() == 16 && parsed.outlier_sigma.get() == 6.0);
    }
}
