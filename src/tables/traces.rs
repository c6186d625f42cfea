//! Table `traces`: what the oscilloscope recorded, as raw codes with their scale and time base, or an index of these.

use std::ops::Range;

use arrow_array::{Array, ArrayRef, RecordBatch, new_null_array};

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
        /// The codes, little-endian; null in an index: there they lie in codes_file.
        codes: Option<Codes>,
        /// In an index, the raw file with the codes: `file`, or the one next to it with its samples; else null.
        codes_file: Option<Name>,
        /// BLAKE3 of that file.
        codes_file_digest: Option<Name>,
        /// Where the first code begins in that file; null where codes do not lie there as plain numbers (text, packed).
        codes_offset_bytes: Option<i64>,
        /// From one code to the next.
        codes_stride_bytes: Option<i64>,
        /// Whether the codes lie there big-endian.
        codes_big_endian: Option<bool>,
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

impl TraceColumns {
    /// Whether rows have their codes, which those of an index do not.
    ///
    /// # Errors
    /// In words, of the first row that has none.
    pub fn require_codes(&self, rows: Range<usize>) -> Result<(), String> {
        if self.codes.null_count() == 0 {
            return Ok(());
        }
        let Some(i) = rows.into_iter().find(|&i| self.codes.is_null(i)) else { return Ok(()) };
        let (campaign, file) = (self.campaign.value(i), self.file.value(i));
        Err(format!(
            "campaign {campaign}: the samples lie in {file}, and this table of traces only says where; run from the \
             raw files, or take a table that stage `ingest` made with `codes = \"zstd\"`, which archives them"
        ))
    }
}

/// Where the codes of a record lie in a file, as plain numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Where the first code that counts begins.
    pub offset_bytes: i64,
    /// From one code to the next.
    pub stride_bytes: i64,
    /// Whether the codes are big-endian.
    pub big_endian: bool,
}

/// The columns in which records of one file differ.
#[derive(Clone)]
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
    pub codes: Option<Codes>,
    /// As in [`Trace`].
    pub clipped: Option<i32>,
    /// Where an index has the codes.
    pub place: Option<Place>,
}

/// Columns that records of one file share.
#[derive(Clone, PartialEq)]
struct Shared {
    row: Trace,
    /// Raw file with the codes.
    codes_file: Name,
}

/// Rows of many records, such as the segments of a file. The columns that they have in common are stored once.
#[derive(Clone, Default)]
pub struct Records {
    shared: Vec<Shared>,
    own: Vec<OwnColumns>,
}

impl Records {
    /// Adds a shared row, and returns its number. Its [`OwnColumns`] are ignored. `codes_file` is the raw file with the
    /// codes.
    pub fn share(&mut self, row: Trace, codes_file: Name) -> usize {
        self.shared.push(Shared { row, codes_file });
        self.shared.len() - 1
    }

    /// Adds a record.
    pub fn push(&mut self, record: OwnColumns) {
        self.own.push(record);
    }

    /// Adds all records of `other`. Records of one file that come in turn share one row, as if they came at once.
    pub fn append(&mut self, other: Self) {
        let mut before = self.shared.len().saturating_sub(other.shared.len());
        if self.shared[before..] != other.shared {
            before = self.shared.len();
            self.shared.extend(other.shared);
        }
        self.own.extend(other.own.into_iter().map(|own| OwnColumns { shared: before + own.shared, ..own }));
    }

    /// The same without codes: their memory is let go.
    #[must_use]
    pub fn without_codes(mut self) -> Self {
        self.own.iter_mut().for_each(|own| own.codes = None);
        self
    }

    /// The same in runs of at most `rows` records.
    pub fn runs(&self, rows: usize) -> impl Iterator<Item = Self> {
        self.own.chunks(rows).map(|own| Self { shared: self.shared.clone(), own: own.to_vec() })
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

    /// Samples at the rails, record by record.
    pub fn clipped(&self) -> impl Iterator<Item = Option<i32>> {
        self.own.iter().map(|own| own.clipped)
    }

    /// The rows.
    #[must_use]
    pub fn to_batch(&self) -> RecordBatch {
        let rows = match self.shared.as_slice() {
            [shared] => shared.row.repeat(self.own.len()),
            shared => Trace::to_batch_of(self.own.iter().map(|own| &shared[own.shared].row)),
        };
        with(
            &rows,
            [
                ("shot", self.column(|own| own.shot)),
                ("segment", self.column(|own| own.segment)),
                ("t0_ps", self.column(|own| own.t0_ps)),
                ("codes", Cell::build(self.own.iter().map(|own| &own.codes))),
                ("clipped", self.column(|own| own.clipped)),
            ],
        )
    }

    /// The same rows in an index: without codes, with where these lie. `rows` are those of [`Records::to_batch`],
    /// `digest` is that of a raw file.
    #[must_use]
    pub fn to_index(&self, rows: &RecordBatch, digest: impl Fn(&str) -> Option<Name>) -> RecordBatch {
        let files = self.shared.iter().map(|shared| &shared.codes_file);
        let (files, digests): (Vec<_>, Vec<_>) = files.map(|file| (Some(file.clone()), digest(file))).unzip();
        with(
            rows,
            [
                ("codes", new_null_array(&Codes::data_type(), self.own.len())),
                ("codes_file", Cell::build(self.own.iter().map(|own| &files[own.shared]))),
                ("codes_file_digest", Cell::build(self.own.iter().map(|own| &digests[own.shared]))),
                ("codes_offset_bytes", self.column(|own| own.place.map(|place| place.offset_bytes))),
                ("codes_stride_bytes", self.column(|own| own.place.map(|place| place.stride_bytes))),
                ("codes_big_endian", self.column(|own| own.place.map(|place| place.big_endian))),
            ],
        )
    }

    fn column<C: Cell>(&self, cell: impl Fn(&OwnColumns) -> C) -> ArrayRef {
        C::build(self.own.iter().map(cell).collect::<Vec<_>>().iter())
    }
}

/// Rows with some columns replaced.
fn with<const N: usize>(rows: &RecordBatch, columns: [(&str, ArrayRef); N]) -> RecordBatch {
    let (schema, mut all) = (Trace::schema(), rows.columns().to_vec());
    for (name, array) in columns {
        all[schema.index_of(name).expect("a column of the table")] = array;
    }
    RecordBatch::try_new(schema, all).expect("columns are built from their own schema")
}
