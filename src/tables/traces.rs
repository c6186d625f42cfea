//! Table `traces`: what the oscilloscope recorded, as raw codes with their scale and time base.

use arrow_array::{ArrayRef, RecordBatch};

use super::cell::{Cell, Codes, Name};
use super::row::Row;
use crate::table;

table! {
    /// One channel of one exposure, as recorded: volts = gain_v * code + offset_v, sample i at t0_ps + i * dt_ps after
    /// the trigger.
    "traces": Trace, TraceColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch that the laser lit (0: none).
        lit: i32,
        /// Patch that the sensor saw (0: none).
        seen: i32,
        /// What was captured: scene, response, dark, blocked or fiducial.
        role: Name,
        /// Run of shots, for roles other than scene: its file; null for captures of the scene.
        run: Option<Name>,
        /// Vertical range, where captures were recorded at several.
        range: Option<Name>,
        /// Number of the exposure within its capture, from 0.
        shot: i32,
        /// Channel of the oscilloscope.
        channel: Option<Name>,
        /// Whether this is the reference pulse of the exposure, not the signal.
        is_reference: bool,
        /// Raw file, relative to the campaign folder.
        file: Name,
        /// Segment of the file, where it holds several.
        segment: Option<i32>,
        /// Time of sample 0 relative to the trigger, sub-sample part included.
        t0_ps: f64,
        /// Time between samples.
        dt_ps: f64,
        /// Time between samples from the file, where the campaign replaces it (dt_ps, nominal_rate_hz); else null.
        file_dt_ps: Option<f64>,
        /// Number of samples.
        samples: i32,
        /// Type of a code: i8, u8, i16, u16, i32, u32, f32 or f64.
        code_type: Name,
        /// Volts per code.
        gain_v: f64,
        /// Volts at code 0.
        offset_v: f64,
        /// The codes, little-endian.
        codes: Codes,
        /// Wall-clock time of the acquisition, from the file (ISO 8601, time zone of the instrument).
        acquired_at: Option<Name>,
        /// Samples at or beyond the converter's rails; null where the rails are unknown.
        clipped: Option<i32>,
        /// Shots that the oscilloscope averaged into this record.
        averaged_shots: i32,
        /// Known path from source to sensor, for roles response and fiducial.
        path_m: Option<f64>,
        /// Standard deviation of the known path.
        path_sd_m: Option<f64>,
        /// Optical density of the attenuator in the beam.
        attenuation_od: Option<f64>,
        /// Mean power of the laser, in watts.
        power_w: Option<f64>,
        /// Bounces of the known path, for roles response and fiducial.
        bounces: Option<i32>,
    }
}

/// A step of campaign.toml that differs from the file's by more than this part is a mistake rather than a better value:
/// clocks of oscilloscopes agree to 1e-4.
const STEP_DOUBT: f64 = 0.01;

impl Trace {
    /// What is wrong with the time between samples, if the campaign replaces that of the file by another one.
    #[must_use]
    pub fn time_base_doubt(&self) -> Option<String> {
        let (dt_ps, file_ps) = (self.dt_ps, self.file_dt_ps?);
        ((dt_ps - file_ps).abs() > STEP_DOUBT * file_ps).then(|| {
            // Files round their steps: the digits behind are no information.
            let file_ps = (file_ps * 1e3).round() / 1e3;
            format!(
                "`dt_ps` = {dt_ps} in the [[captures]] rule, but the file says {file_ps} ps: remove `dt_ps`, or give it in picoseconds"
            )
        })
    }
}

/// The columns in which records of one file differ.
pub struct OwnColumns {
    /// Number of the shared row that has the other columns.
    pub shared: usize,
    /// As in [`Trace`].
    pub shot: i32,
    /// As in [`Trace`].
    pub segment: Option<i32>,
    /// As in [`Trace`].
    pub t0_ps: f64,
    /// As in [`Trace`].
    pub codes: Codes,
    /// As in [`Trace`].
    pub clipped: Option<i32>,
}

/// Rows of many records, such as the segments of a file. The columns that they have in common are stored once.
#[derive(Default)]
pub struct Records {
    shared: Vec<Trace>,
    own: Vec<OwnColumns>,
}

impl Records {
    /// Adds a shared row, and returns its number. Its [`OwnColumns`] are ignored.
    pub fn share(&mut self, row: Trace) -> usize {
        self.shared.push(row);
        self.shared.len() - 1
    }

    /// Adds a record.
    pub fn push(&mut self, record: OwnColumns) {
        self.own.push(record);
    }

    /// Adds all records of `other`.
    pub fn append(&mut self, other: Self) {
        let before = self.shared.len();
        self.shared.extend(other.shared);
        self.own.extend(other.own.into_iter().map(|own| OwnColumns { shared: before + own.shared, ..own }));
    }

    /// Numbers the shots from `first` on.
    pub fn number_from(&mut self, first: i32) {
        self.own.iter_mut().for_each(|own| own.shot += first);
    }

    /// Whether there are no records.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.own.is_empty()
    }

    /// The rows.
    #[must_use]
    pub fn to_batch(&self) -> RecordBatch {
        fn column<'a, C: Cell + 'a>(own: &'a [OwnColumns], cell: impl Fn(&'a OwnColumns) -> &'a C) -> ArrayRef {
            C::build(own.iter().map(cell))
        }
        let (schema, own) = (Trace::schema(), self.own.as_slice());
        let mut columns = Trace::to_batch_of(own.iter().map(|own| &self.shared[own.shared])).columns().to_vec();
        for (name, array) in [
            ("shot", column(own, |own| &own.shot)),
            ("segment", column(own, |own| &own.segment)),
            ("t0_ps", column(own, |own| &own.t0_ps)),
            ("codes", column(own, |own| &own.codes)),
            ("clipped", column(own, |own| &own.clipped)),
        ] {
            columns[schema.index_of(name).expect("a column of the table")] = array;
        }
        RecordBatch::try_new(schema, columns).expect("columns are built from their own schema")
    }
}
