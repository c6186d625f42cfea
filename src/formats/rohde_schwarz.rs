//! Rohde & Schwarz RTO, RTE, RTP: settings in XML (`NAME.bin`), samples in a companion file (`NAME.Wfm.bin`).
//!
//! The companion begins with the type of the samples and the samples of one acquisition and channel (two u32).
//! Acquisitions follow, oldest first: a time stamp (f64, where TimestampState is on), then rows of
//! LeadingSettlingSamples, RecordLength and trailing samples. A row is x (f64, in the XY form only) and one value of
//! each channel. Everything is little-endian: ByteOrder gives MSB first even for files that are not. Source: user
//! manual ("Raw data", "Export of history"), the vendor's RTxReadBin 2.3, and real files of an RTP.
//!
//! Raw codes: volts = VerticalScale * VerticalDivisionCount / NofQuantisationLevels * code + VerticalOffset -
//! VerticalPosition * VerticalScale; floats are volts. Sample i is at XStart + i * (XStop - XStart) / RecordLength
//! after the trigger. In the XY form it counts from the record's own first x, which includes the sub-sample part of the
//! trigger time. The other forms give no usable sub-sample part (TOADone and ISO_TRG are not documented): export XY for
//! picoseconds.
//!
//! An envelope has two records for each channel, minima before maxima. Not read: logic channels (the packing of their
//! bits is not documented), 24 and 32 bit codes, firmware before 2.0. Tested only on files that the tests build: raw
//! codes, histories, envelopes, spectra.

use std::ops::Range;
use std::sync::Arc;

use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Kind, Payload, Record, Scale};

mod settings;
#[cfg(test)]
mod tests;

use settings::{Settings, field};

/// The reader.
pub struct RohdeSchwarz;

/// Bytes before the samples: two u32.
const PAYLOAD_HEAD: u64 = 8;
/// Longest end of a line, with spaces, behind the XML.
const LINE_END: u64 = 4;

/// Largest deviation of a sample's x from the even grid, in steps.
const UNEVEN: f64 = 0.25;

/// Upper limit of the memory that a record takes without its samples, in bytes.
const RECORD_BYTES: u64 = 192;

impl Reader for RohdeSchwarz {
    fn format(&self) -> &'static str {
        "rs-bin"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["bin"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        let head = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head).trim_ascii_start();
        head.starts_with(b"<") && head.windows(9).any(|window| window == b"<Database")
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let count = input.length().min(2048);
        if !self.recognises(&input.peek("the head", 0, count)?) {
            let problem = "is no binary recording that is read; if it holds the samples of a Rohde & Schwarz recording (NAME.Wfm.bin), \
                 give NAME.bin, the XML head beside it";
            return Err(field(0, problem));
        }
        let settings = Settings::read(input)?;
        let left = input.length().saturating_sub(settings.end);
        let is_line_end = left <= LINE_END && input.peek("the end", settings.end, left)?.trim_ascii().is_empty();
        input.uses(0..if is_line_end { input.length() } else { settings.end });
        let Some(companion) = input.companion() else {
            let problem =
                "the samples lie in a second file of the same name that ends in .Wfm.bin; copy it next to this one";
            return Err(field(0, problem));
        };
        let layout = Layout::new(&settings, input, companion)?;
        let axis = Axis::new(&settings, layout.samples)?;
        let heads = heads(&settings, &layout, &axis)?;
        let acquisitions = layout.acquisitions(input, &axis)?;
        let record = |index: usize, head: &Arc<Head>, number: usize, acquisition: &Acquisition| Record {
            head: Arc::clone(head),
            segment: (acquisitions.len() > 1).then_some(number as u32),
            t0_s: Some(acquisition.t0),
            trigger_s: acquisition.trigger_s,
            payload: Payload::File {
                byte_offset: acquisition.first_row + layout.x_bytes + (index * layout.code_type.bytes()) as u64,
                stride: layout.row_bytes,
                big_endian: false,
            },
        };
        let mut records = Vec::with_capacity(heads.len() * acquisitions.len());
        for (index, head) in heads.iter().enumerate() {
            records.extend(acquisitions.iter().enumerate().map(|(i, acquisition)| record(index, head, i, acquisition)));
        }
        Ok(records)
    }
}

/// The heads of the records, in the order of the values in a row.
fn heads(settings: &Settings, layout: &Layout, axis: &Axis) -> Result<Vec<Arc<Head>>, FormatError> {
    let raw = layout.code_type != CodeType::F32;
    let mut heads = Vec::new();
    for channel in settings.channels()? {
        let scale = if raw { settings.raw_scale(&channel)? } else { Scale { gain: 1.0, offset: 0.0 } };
        for trace in ["minima", "maxima"].iter().take(layout.traces) {
            let name = if layout.traces == 1 { channel.name.clone() } else { format!("{} {trace}", channel.name) };
            heads.push(Arc::new(Head {
                kind: axis.kind.unwrap_or(layout.kind),
                channel: Some(name),
                unit: channel.unit.clone(),
                dt_s: Some(axis.dt),
                scale: Some(scale),
                header_gain: raw.then_some(channel.scale),
                header_offset: raw.then_some(channel.offset),
                acquired_at: settings.acquired_at(),
                ..Head::new("rs-bin", layout.code_type, layout.samples)
            }));
        }
    }
    Ok(heads)
}

/// The x axis.
struct Axis {
    /// Kind of the records, if the axis changes it: a spectrum.
    kind: Option<Kind>,
    /// First x: seconds, or hertz.
    start: f64,
    /// Step of x.
    dt: f64,
}

impl Axis {
    fn new(settings: &Settings, samples: usize) -> Result<Self, FormatError> {
        let (start, stop) = (settings.number("XStart")?, settings.number("XStop")?);
        let dt = (stop - start) / samples as f64;
        let at = settings.position("XStop");
        if !(dt > 0.0 && dt.is_finite()) {
            return Err(field(
                at,
                format!("XStart = {start} and XStop = {stop} give no step; export the record again"),
            ));
        }
        if let Some(resolution) = settings.optional("SignalResolution")?
            && (resolution * samples as f64 - (stop - start)).abs() > UNEVEN * dt
        {
            return Err(field(
                at,
                format!(
                    "SignalResolution = {resolution} contradicts (XStop - XStart) / RecordLength = {dt}; export the record again"
                ),
            ));
        }
        if settings.text("XAxisMode").is_some_and(|mode| mode != "eRS_LINLOG_LINEAR") {
            return Err(field(settings.position("XAxisMode"), "XAxisMode is not linear: its x are no even steps"));
        }
        let kind = match settings.unit("XStart") {
            Some("s") | None => None,
            Some("Hz") => Some(Kind::Spectrum),
            Some(unit) => {
                return Err(field(at, format!("is over {unit}, neither over s nor over Hz; export it over time")));
            }
        };
        Ok(Self { kind, start, dt })
    }
}

/// Where each acquisition, row and value is in the companion.
struct Layout {
    code_type: CodeType,
    kind: Kind,
    /// Records of each channel: 2 for minima and maxima.
    traces: usize,
    /// Bytes of x in a row.
    x_bytes: u64,
    row_bytes: u64,
    /// Bytes of a time stamp before the rows of an acquisition.
    stamp_bytes: u64,
    /// Bytes of an acquisition with its stamp.
    acquisition_bytes: u64,
    acquisition_count: u64,
    /// Rows before the first sample.
    leading: u64,
    samples: usize,
    start: u64,
}

impl Layout {
    fn new(settings: &Settings, input: &mut dyn Input, companion: Range<u64>) -> Result<Self, FormatError> {
        let length = companion.end.saturating_sub(companion.start);
        if length < PAYLOAD_HEAD {
            return Err(field(
                companion.start,
                "the .Wfm.bin has no head of 8 bytes; copy it from the instrument again",
            ));
        }
        let head = input.bytes("the head of .Wfm.bin", companion.start, PAYLOAD_HEAD)?;
        let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
        let (code_type, x_bytes) = settings.code_type(word(0), companion.start)?;
        let (samples, rows) = settings.rows()?;
        if u64::from(word(4)) != rows {
            return Err(field(
                companion.start + 4,
                format!(
                    "the .Wfm.bin says {} samples, SignalHardwareRecordLength = {rows}; the two files are not of one recording",
                    word(4)
                ),
            ));
        }
        let (kind, traces) = settings.kind()?;
        let values = (settings.channels()?.len() * traces) as u64;
        let row_bytes = x_bytes + values * code_type.bytes() as u64;
        let stamp_bytes = if settings.is_on("TimestampState") { 8 } else { 0 };
        let count = settings.count("NumberOfAcquisitions")?.max(1);
        let acquisition_bytes = rows.checked_mul(row_bytes).and_then(|bytes| bytes.checked_add(stamp_bytes));
        let needed =
            acquisition_bytes.and_then(|bytes| bytes.checked_mul(count)).and_then(|all| all.checked_add(PAYLOAD_HEAD));
        let (Some(acquisition_bytes), true) = (acquisition_bytes, needed == Some(length)) else {
            let needed =
                needed.map_or("more bytes than a file can have".to_owned(), |needed| format!("{needed} bytes"));
            return Err(field(
                companion.start,
                format!(
                    "the .Wfm.bin has {length} bytes, but {count} acquisitions of {rows} rows of {row_bytes} bytes need {needed}; \
                     copy it from the instrument again"
                ),
            ));
        };
        input.uses(companion.clone());
        if count * values * RECORD_BYTES > 4 * companion.end + (1 << 19) {
            return Err(field(
                settings.position("RecordLength"),
                format!("{count} acquisitions of {samples} samples each are too short for records; export one by one"),
            ));
        }
        let leading = settings.count("LeadingSettlingSamples")?;
        let start = companion.start + PAYLOAD_HEAD;
        Ok(Self {
            code_type,
            kind,
            traces,
            x_bytes,
            row_bytes,
            stamp_bytes,
            acquisition_bytes,
            acquisition_count: count,
            leading,
            samples,
            start,
        })
    }

    /// Where the samples of each acquisition begin, and when it was triggered.
    fn acquisitions(&self, input: &mut dyn Input, axis: &Axis) -> Result<Vec<Acquisition>, FormatError> {
        let mut acquisitions = Vec::with_capacity(self.acquisition_count as usize);
        let mut first_stamp = None;
        for number in 0..self.acquisition_count {
            let start = self.start + number * self.acquisition_bytes;
            let first_row = start + self.stamp_bytes + self.leading * self.row_bytes;
            let mut trigger_s = None;
            if self.stamp_bytes > 0 {
                let stamp = f64_at(input, "the time stamp", start)?;
                if !stamp.is_finite() {
                    return Err(field(start, format!("the time stamp of acquisition {number} is {stamp}")));
                }
                let first = *first_stamp.get_or_insert(stamp);
                trigger_s = (self.acquisition_count > 1).then_some(stamp - first);
            }
            let t0 = if self.x_bytes > 0 { self.first_x(input, axis, first_row)? } else { axis.start };
            acquisitions.push(Acquisition { first_row, t0, trigger_s });
        }
        Ok(acquisitions)
    }

    /// The first x of an acquisition in the XY form. Refuses an uneven axis.
    fn first_x(&self, input: &mut dyn Input, axis: &Axis, first_row: u64) -> Result<f64, FormatError> {
        let first = f64_at(input, "the x of the first sample", first_row)?;
        if !first.is_finite() || (first - axis.start).abs() > axis.dt {
            return Err(field(
                first_row,
                format!(
                    "the x of the first sample is {first}, but XStart = {}; the two files are not of one recording",
                    axis.start
                ),
            ));
        }
        let column = Record {
            head: Arc::new(Head::new("rs-bin", CodeType::F64, self.samples)),
            segment: None,
            t0_s: None,
            trigger_s: None,
            payload: Payload::File { byte_offset: first_row, stride: self.row_bytes, big_endian: false },
        };
        let (mut index, mut uneven) = (0_usize, None);
        let mut check = |codes: &[u8]| {
            for x in CodeType::F64.decode(codes) {
                let off = (x - (first + index as f64 * axis.dt)).abs();
                if uneven.is_none() && (off.is_nan() || off > UNEVEN * axis.dt) {
                    uneven = Some((index, x));
                }
                index += 1;
            }
        };
        column.visit(input.file(), 0..self.samples, &mut check)?;
        match uneven {
            Some((index, x)) => Err(field(
                first_row + index as u64 * self.row_bytes,
                format!("x = {x} is off the even step of {}; export the record again without interpolation", axis.dt),
            )),
            None => Ok(first),
        }
    }
}

/// One acquisition of a history.
struct Acquisition {
    first_row: u64,
    t0: f64,
    trigger_s: Option<f64>,
}

fn f64_at(input: &mut dyn Input, what: &'static str, at: u64) -> Result<f64, FormatError> {
    let bytes = input.bytes(what, at, 8)?;
    Ok(f64::from_le_bytes(bytes.try_into().expect("eight bytes were asked for")))
}
