//! `average`: the shots of a capture become one mean time profile (paper section 5: exposures averaged against Gaussian noise).
//!
//! Each shot is moved by its own sub-sample trigger time and onto its reference pulse, whose time is fitted with the calibrated template. The
//! offset is rounded to 1/64 sample, codes are summed as integers by phase, and each phase is delayed once at the end: exact, and the same for
//! any order and chunking. Shots at the converter's rails, outlying shots (tested against the first 32) and shots without reference pulse are
//! set aside. The standard error comes from the spread of the first 32 accepted shots; what the alignment leaves is `jitter_ps`.
//!
//! Takes `traces`; writes `profiles`. Beside it: `calibration`, needed where captures have a reference channel.
//!
//! Not modelled yet: several vertical ranges of one capture (such captures go to `rejects`), folding at the laser's period, gain drift.
//!
//! ```toml
//! [profiles]
//! stage = "average"
//! from = "traces"
//! with = { calibration = "calibration" }
//! params = { shots_min = 16 }
//! ```

use std::collections::BTreeMap;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::stage::{Beside, BesideTables, Fold, Grain, Outcome, Rejection, Stage, StageError};
use crate::campaign::Campaign;
use crate::signal::average::{Mean, PHASES, PhaseSums};
use crate::signal::codes::Codes as Samples;
use crate::signal::noise;
use crate::signal::reference::fit_pulse;
use crate::signal::response::Response;
use crate::signal::shot_spread::{self, HEAD_SHOTS, OutlierTest};
use crate::tables::row::Cell;
use crate::tables::traces::TraceColumns;
use crate::tables::{Calibration, Codes, Name, Profile, Row, Trace};

/// Lags of the noise autocorrelation that a profile keeps.
const ACF_LAGS: usize = 16;
/// Share of a record that is its baseline where the pipeline does not say.
const BASELINE_SHARE: f64 = 0.1;

/// Parameters of `average`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Average {
    /// A capture with fewer shots left is set aside.
    shots_min: u32,
    /// Length of the stretch at the start of a record that light has not reached; absent: a tenth of the record.
    baseline_ps: Option<f64>,
    /// Whether outlying shots are set aside.
    reject_outliers: bool,
    /// A shot is outlying when a sample of it lies this many robust standard deviations off the median of the first shots.
    outlier_sigma: f64,
}

impl Default for Average {
    fn default() -> Self {
        Self { shots_min: 1, baseline_ps: None, reject_outliers: true, outlier_sigma: 6.0 }
    }
}

impl Stage for Average {
    const KIND: &'static str = "average";
    const VERSION: u32 = 3;
    const GRAIN: Grain = Grain::Capture;
    const BESIDE: &'static [Beside] = &[Beside { name: "calibration", table: "calibration", required: false }];
    type Input = Trace;
    type Output = Profile;
    type Fields = ();
    type Context = Templates;

    fn fields(&self, _: &[Campaign]) {}

    fn context(&self, (): (), beside: &BesideTables) -> Result<Templates, StageError> {
        let template = |row: Calibration| {
            let (t0_ps, values) = row.reference_t0_ps.zip(row.reference)?;
            Some(((row.campaign, row.sensor), Response::new(t0_ps, row.step_ps, &values.to_f64())))
        };
        let rows = beside.rows::<Calibration>("calibration")?.unwrap_or_default();
        Ok(Templates(rows.into_iter().filter_map(template).collect()))
    }
}

/// Template of the reference pulse of each campaign and sensor.
pub struct Templates(BTreeMap<(Name, Name), Response>);

/// A signal record that was kept until enough are there to judge outliers by.
struct Shot {
    codes: Codes,
    position: i64,
}

/// A capture under way.
pub struct State {
    /// First signal row: key, scale and time base that all others must have. Until one comes, the reference row before it.
    first: Trace,
    baseline: usize,
    head: Vec<Shot>,
    test: Option<OutlierTest>,
    /// Per-sample standard deviation over the head, once it is closed.
    spread: Option<Spread>,
    sums: PhaseSums,
    shots: i64,
    rejected: i32,
    /// Of these, clipped.
    clipped: i32,
    other_scale: i32,
    several_ranges: bool,
    /// Reference time of the shot whose signal comes next: shot, time and its sd; `None` where no pulse was found.
    reference: Option<(i32, Option<(f64, f64)>)>,
    /// Whether that reference pulse is cut off at the rails.
    reference_clipped: bool,
    /// Sum of squared standard deviations of the reference times.
    reference_variance_ps2: f64,
    missing_template: bool,
}

/// Noise, as the head shows it.
struct Spread {
    first_position: i64,
    sd: Vec<f64>,
    noise: f64,
    acf: Vec<f64>,
    /// Samples behind noise and autocorrelation.
    samples: usize,
}

impl Fold for Average {
    type State = State;

    fn begin(&self, _: &Templates, first: Trace) -> State {
        State::new(self, first)
    }

    fn step(
        &self,
        templates: &Templates,
        state: &mut State,
        columns: &TraceColumns,
        rows: Range<usize>,
    ) -> Result<(), StageError> {
        for i in rows {
            if columns.is_reference.value(i) {
                state.take_reference(templates, columns, i);
            } else {
                self.take_signal(state, columns, i);
            }
        }
        Ok(())
    }

    fn finish(&self, _: &Templates, mut state: State) -> Result<Outcome<Profile>, StageError> {
        if state.several_ranges {
            return Ok(state.rejection(
                "was taken at several vertical ranges, which are not merged yet; exclude all but one in campaign.toml"
                    .to_owned(),
            ));
        }
        if state.missing_template {
            let sensor = &state.first.sensor;
            return Err(StageError::Refused(format!(
                "captures of sensor `{sensor}` have a reference channel, but its calibration has no reference template; \
                 give `with = {{ calibration = ... }}` from response captures with the same reference channel"
            )));
        }
        if state.spread.is_none() {
            self.close_head(&mut state);
        }
        if state.shots == 0 || state.shots < i64::from(self.shots_min) {
            let (shots, rejected, other) = (state.shots, state.rejected, state.other_scale);
            let why = format!(
                "has {shots} valid shots of the {} that it needs; {rejected} were clipped, outlying or without reference pulse, {other} of another scale, length or setting",
                self.shots_min.max(1)
            );
            return Ok(state.rejection(why));
        }
        let Some(mean) = state.sums.finish() else {
            return Ok(state.rejection(
                "has shots so far apart in time that none overlaps all others; check its reference channel and trigger"
                    .to_owned(),
            ));
        };
        Ok(Outcome::rows(vec![state.profile(&mean)]))
    }
}

impl State {
    fn new(average: &Average, first: Trace) -> Self {
        let samples = first.samples as usize;
        let share = samples as f64 * BASELINE_SHARE;
        let baseline = average.baseline_ps.map_or(share, |baseline_ps| baseline_ps / first.dt_ps).round() as usize;
        Self {
            baseline: baseline.clamp(1, samples),
            first,
            head: Vec::new(),
            test: None,
            spread: None,
            sums: PhaseSums::new(samples),
            shots: 0,
            rejected: 0,
            clipped: 0,
            other_scale: 0,
            several_ranges: false,
            reference: None,
            reference_clipped: false,
            reference_variance_ps2: 0.0,
            missing_template: false,
        }
    }

    fn rejection(&self, why: String) -> Outcome<Profile> {
        let Trace { campaign, sensor, lit, seen, role, .. } = &self.first;
        Outcome::rejected(Rejection {
            campaign: campaign.clone(),
            file: Some(self.first.file.clone()),
            segment: None,
            byte_offset: None,
            reason: format!("{role} capture of sensor {sensor}, lit {lit}, seen {seen}, {why}"),
        })
    }

    fn take_reference(&mut self, templates: &Templates, columns: &TraceColumns, i: usize) {
        let key = (self.first.campaign.clone(), self.first.sensor.clone());
        let Some(template) = templates.0.get(&key) else {
            self.missing_template = true;
            return;
        };
        let (gain_v, dt_ps) = (columns.gain_v.value(i), columns.dt_ps.value(i));
        let clipped = columns.clipped.values()[i] > 0;
        let samples: Vec<f64> = codes(columns, i).to_f64().into_iter().map(|code| code * gain_v).collect();
        // A pulse that is cut off at the rails has its fitted time biased: such a shot is set aside.
        let fit = fit_pulse(&samples, dt_ps, template).filter(|_| !clipped);
        let time = fit.map(|fit| (columns.t0_ps.value(i) + fit.time_ps, fit.time_sd_ps));
        self.reference = Some((columns.shot.value(i), time));
        self.reference_clipped = clipped;
    }

    /// Adds a shot, unless it is outlying.
    fn add(&mut self, codes: Samples<'_>, position: i64) {
        if self.test.as_ref().is_some_and(|test| test.is_outlier(codes, position)) {
            self.rejected += 1;
        } else {
            self.sums.add(codes, position);
            self.shots += 1;
        }
    }

    fn profile(&self, mean: &Mean) -> Profile {
        let Trace { campaign, sensor, lit, seen, role, dt_ps, gain_v, offset_v, .. } = &self.first;
        let spread = self.spread.as_ref().expect("the head is closed before a profile is made");
        let count = mean.mean.len();
        let baseline = mean.mean[..self.baseline.min(count)].iter().sum::<f64>() / self.baseline.min(count) as f64;
        let root_shots = (self.shots as f64).sqrt();
        // The head's spread on the samples of the mean; beyond them its last value holds.
        let spread_at = |i: usize| {
            let at = mean.first_position + i as i64 - spread.first_position;
            spread.sd[at.clamp(0, spread.sd.len() as i64 - 1) as usize]
        };
        // Rounding to a phase is uniform over one step of the grid; where all shots share a phase it is the same for all of them.
        let step_ps = dt_ps / PHASES as f64;
        let alignment = self.reference_variance_ps2 / self.shots as f64;
        let rounding = if alignment > 0.0 { step_ps * step_ps / 12.0 } else { 0.0 };
        Profile {
            campaign: campaign.clone(),
            sensor: sensor.clone(),
            lit: *lit,
            seen: *seen,
            role: role.clone(),
            run: self.first.run.clone(),
            range: self.first.range.clone(),
            shots: self.shots as i32 * self.first.averaged_shots,
            rejected: self.rejected + self.other_scale,
            clipped: self.clipped,
            t0_ps: mean.first_position as f64 * dt_ps,
            dt_ps: *dt_ps,
            mean_v: mean.mean.iter().map(|code| (code - baseline) * gain_v).collect(),
            se_v: (0..count).map(|i| spread_at(i) * gain_v.abs() / root_shots).collect(),
            // The spread is that of records, each of which the oscilloscope may have averaged.
            noise_v: spread.noise * gain_v.abs() * f64::from(self.first.averaged_shots).sqrt(),
            noise_acf: spread.acf.iter().copied().collect(),
            noise_model: None,
            noise_samples: i32::try_from(spread.samples).ok(),
            baseline_v: baseline * gain_v + offset_v,
            phase_shots: Some(self.sums.phase_shots().into_iter().map(|shots| shots as i32).collect()),
            jitter_ps: (alignment + rounding).sqrt() / root_shots,
            gain_sd: 0.0,
            reference_ps: None,
            reference_sd_ps: None,
            reference_v_ps: None,
            reference_sd_v_ps: None,
            counts: None,
            cycles: None,
            gain_v: *gain_v,
            path_m: self.first.path_m,
            path_sd_m: self.first.path_sd_m,
            attenuation_od: self.first.attenuation_od,
            power_w: self.first.power_w,
            bounces: self.first.bounces,
            acquired_at: self.first.acquired_at.clone(),
        }
    }
}

impl Average {
    fn take_signal(&self, state: &mut State, columns: &TraceColumns, i: usize) {
        let (shot, dt_ps, samples) = (columns.shot.value(i), columns.dt_ps.value(i), columns.samples.value(i));
        let reference = state.reference.take();
        let reference_clipped = std::mem::take(&mut state.reference_clipped);
        if state.first.is_reference {
            let missing_template = state.missing_template;
            *state = State { missing_template, ..State::new(self, Trace::read(columns, i)) };
        }
        let first = &state.first;
        if columns.range.value(i) != first.range.as_deref().unwrap_or("") {
            state.several_ranges = true;
            return;
        }
        let scale = (columns.gain_v.value(i), columns.offset_v.value(i), dt_ps, samples, columns.code_type.value(i));
        let scale_of_first = (first.gain_v, first.offset_v, first.dt_ps, first.samples, &*first.code_type);
        let number = |column| <Option<f64> as Cell>::get(column, i);
        let setting = (number(&columns.path_m), number(&columns.attenuation_od), number(&columns.power_w));
        if scale != scale_of_first || setting != (first.path_m, first.attenuation_od, first.power_w) {
            state.other_scale += 1;
            return;
        }
        let zero_ps = match reference {
            None => Some((0.0, 0.0)),
            Some((of, time)) => time.filter(|_| of == shot),
        };
        let clipped = columns.clipped.values()[i] > 0;
        state.clipped += i32::from(clipped || reference_clipped);
        let Some((zero_ps, zero_sd_ps)) = zero_ps.filter(|_| !clipped) else {
            state.rejected += 1;
            return;
        };
        let position = ((columns.t0_ps.value(i) - zero_ps) / dt_ps * PHASES as f64).round() as i64;
        state.reference_variance_ps2 += zero_sd_ps * zero_sd_ps;
        if state.spread.is_some() {
            state.add(codes(columns, i), position);
            return;
        }
        state.head.push(Shot { codes: <Codes as Cell>::get(&columns.codes, i), position });
        if state.head.len() == HEAD_SHOTS {
            self.close_head(state);
        }
    }

    /// Judges the first shots by one another, adds those that pass, and takes the noise from them.
    fn close_head(&self, state: &mut State) {
        let head = std::mem::take(&mut state.head);
        let code_type = &state.first.code_type.clone();
        let views: Vec<(Samples<'_>, i64)> =
            head.iter().map(|shot| (view(code_type, &shot.codes), shot.position)).collect();
        if self.reject_outliers {
            state.test = OutlierTest::new(&views, state.baseline, self.outlier_sigma);
        }
        let passed: Vec<(Samples<'_>, i64)> = views
            .iter()
            .copied()
            .filter(|(codes, position)| !state.test.as_ref().is_some_and(|test| test.is_outlier(*codes, *position)))
            .collect();
        for (codes, position) in views {
            state.add(codes, position);
        }
        let Some(mean) = state.sums.finish() else {
            return;
        };
        let sd = shot_spread::spread(&passed, &mean, state.baseline);
        let stretches: Vec<Vec<f64>> =
            passed.iter().map(|(codes, _)| codes.slice(0..state.baseline).to_f64()).collect();
        let noise = noise::estimate(&stretches, ACF_LAGS);
        let samples = stretches.iter().map(Vec::len).sum();
        state.spread =
            Some(Spread { first_position: mean.first_position, sd, noise: noise.sd, acf: noise.acf, samples });
    }
}

/// Samples of row `i`.
fn codes(columns: &TraceColumns, i: usize) -> Samples<'_> {
    view(columns.code_type.value(i), columns.codes.value(i))
}

fn view<'a>(code_type: &str, bytes: &'a [u8]) -> Samples<'a> {
    Samples::of(code_type, bytes).expect("ingest writes known code types only")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_have_their_documented_defaults() {
        let parsed: Average = toml::from_str("shots_min = 16").unwrap();
        assert!(parsed.reject_outliers && parsed.shots_min == 16 && parsed.outlier_sigma == 6.0);
    }
}
