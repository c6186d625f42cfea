//! Keysight Infiniium: group `Waveforms`, with a group for each waveform. Source: "HDF5 Schema for Infiniium
//! Oscilloscope Data" in the vendor's help.
//!
//! Floating samples are volts; integers are codes with volts = YInc * code + YOrg. Sample i is at XOrg + i * XInc after
//! the trigger.
//!
//! Segmented memory has a data set `<name> Seg<k>Data` for each segment, with k from 1, sorted as text. Its attributes
//! are SegmentedTimeTag (seconds after the first trigger) and SegmentedXOrg: the XOrg of this segment, with the
//! sub-sample part of its own trigger. The XOrg of the group is that of the first segment. If SegmentedXOrg is missing,
//! or two samples of the converter or more from XOrg, `t0_s` is `None`: one XOrg for all would be wrong by up to a
//! sample.
//!
//! Peak detect becomes kind envelope, `Digital` groups and LOGIC become digital, x in hertz becomes spectrum.
//! Histograms are refused. `acquired_at` is the Date of `TheFrame`: when the file was saved. A single waveform of
//! floats was tested on a real file; integers, segments and the rest on files that the tests build after public
//! descriptions.

use std::sync::Arc;

use super::super::reader::FormatError;
use super::dataset::{self, Dataset};
use super::field;
use super::file::{Entries, Entry, File, Header, message};
use super::value::text_members;
use crate::waveform::{CodeType, Head, Kind, Record, Scale};

const FORMAT: &str = "keysight-h5";
const MONTHS: [&str; 12] = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"];

/// Returns the records of all waveforms, in the order of their names.
pub(super) fn records(file: &mut File, root: &Entries, waveforms: u64) -> Result<Vec<Record>, FormatError> {
    let frame = match root.find("Frame") {
        Some(at) => frame(file, at)?,
        None => Frame::default(),
    };
    let groups = file.group(waveforms)?;
    let mut records = Vec::new();
    for group in groups.iter() {
        let header = file.header(group.at)?;
        Waveform::read(group, &header)?.records(file, &header, &frame, &mut records)?;
    }
    if records.is_empty() {
        return Err(field(
            waveforms,
            "has no waveform in its group \"Waveforms\"; save it again with the sources that are wanted",
        ));
    }
    Ok(records)
}

/// The attributes of `TheFrame`, which describes the instrument.
#[derive(Default)]
struct Frame {
    model: Option<String>,
    saved_at: Option<String>,
}

fn frame(file: &mut File, at: u64) -> Result<Frame, FormatError> {
    let Some(at) = file.group(at)?.find("TheFrame") else {
        return Ok(Frame::default());
    };
    let header = file.header(at)?;
    let value = dataset::value(file, &header)?;
    let mut frame = Frame::default();
    for (name, text) in text_members(header.need(message::DATATYPE, "data type")?, &value) {
        match name.as_str() {
            "Model" => frame.model = Some(text),
            "Date" => frame.saved_at = iso(&text),
            _ => {}
        }
    }
    Ok(frame)
}

/// Converts `2-May-2017 14:38:42` to ISO 8601.
fn iso(date: &str) -> Option<String> {
    let mut parts = date.split(['-', ' ']).filter(|part| !part.is_empty());
    let (day, month, year) = (parts.next()?, parts.next()?.to_lowercase(), parts.next()?);
    let month = MONTHS.iter().position(|name| *name == month)? + 1;
    let time: Vec<u32> = parts.next()?.split(':').map_while(|part| part.parse().ok()).collect();
    let (day, year): (u32, u32) = (day.parse().ok()?, year.parse().ok()?);
    match time[..] {
        [hour @ 0..24, minute @ 0..60, second @ 0..61] if (1..=31).contains(&day) && (1980..=9999).contains(&year) => {
            Some(format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}"))
        }
        _ => None,
    }
}

/// The attributes of a waveform's group.
struct Waveform<'a> {
    name: &'a str,
    at: u64,
    kind: Kind,
    unit: Option<String>,
    /// XInc and XOrg; only logic levels have none.
    dt_s: Option<f64>,
    x_origin: Option<f64>,
    /// YInc and YOrg.
    scale: Option<Scale>,
    points: Option<f64>,
    segments: Option<f64>,
    /// SavedInterpFactor: samples in the file per sample of the converter.
    interpolation: f64,
}

/// A number of the header, for an error text.
fn display(number: Option<f64>) -> String {
    number.map_or_else(|| "(missing)".to_owned(), |number| number.to_string())
}

/// A data set: number of its segment from 1, or 0 for a whole waveform; and where its header is.
type Part = (u32, u64);

impl<'a> Waveform<'a> {
    fn read(group: &'a Entry, header: &Header) -> Result<Self, FormatError> {
        let name = group.name.as_str();
        let mut waveform = Self {
            name,
            at: group.at,
            kind: Kind::Waveform,
            unit: header.text("YUnits")?.map(|unit| if unit == "Volt" { "V".to_owned() } else { unit }),
            dt_s: header.number("XInc")?,
            x_origin: header.number("XOrg")?,
            scale: header.number("YInc")?.zip(header.number("YOrg")?).map(|(gain, offset)| Scale { gain, offset }),
            points: header.number("NumPoints")?,
            segments: header.number("NumSegments")?,
            interpolation: header.number("SavedInterpFactor")?.unwrap_or(1.0).max(1.0),
        };
        waveform.kind = waveform.kind(header)?;
        let timeless = waveform.dt_s.is_none() || waveform.x_origin.is_none();
        if timeless && waveform.kind != Kind::Digital || waveform.dt_s.is_some_and(|dt_s| dt_s <= 0.0) {
            let (dt_s, x_origin) = (display(waveform.dt_s), display(waveform.x_origin));
            return Err(waveform.refuse(format!("XInc = {dt_s} and XOrg = {x_origin} are no time base; save it again")));
        }
        Ok(waveform)
    }

    fn refuse(&self, problem: impl std::fmt::Display) -> FormatError {
        field(self.at, format!("waveform {:?}: {problem}", self.name))
    }

    fn kind(&self, header: &Header) -> Result<Kind, FormatError> {
        let over = header.text("XUnits")?.unwrap_or_else(|| "Second".to_owned());
        let waveform_type = header.number("WaveformType")?.map_or(0, |number| number as i64);
        let kind = match waveform_type {
            6 => Kind::Digital,
            _ if self.name.starts_with("Digital") => Kind::Digital,
            0 | 1 => Kind::Waveform,
            2 => Kind::Envelope,
            3 => Kind::Average,
            _ => {
                let problem =
                    format!("WaveformType = {waveform_type} is a histogram or unknown; save the file without it");
                return Err(self.refuse(problem));
            }
        };
        match over.to_lowercase().as_str() {
            _ if kind == Kind::Digital => Ok(kind),
            "second" | "s" => Ok(kind),
            "hertz" | "hz" => Ok(Kind::Spectrum),
            _ => Err(self.refuse(format!("XUnits = {over:?} is neither Second nor Hertz; save the file without it"))),
        }
    }

    /// The data sets of the waveform, in the order of their segments.
    fn parts(&self, entries: &Entries) -> Result<Vec<Part>, FormatError> {
        let part = |entry: &Entry| {
            let part = entry.name.strip_prefix(self.name)?.strip_suffix("Data")?.trim();
            let number = if part.is_empty() { 0 } else { part.strip_prefix("Seg")?.parse().ok().filter(|&k| k > 0)? };
            Some((number, entry.at))
        };
        let mut parts: Vec<Part> = entries.iter().filter_map(part).collect();
        parts.sort_unstable();
        let first = parts.first().map_or(0, |part| part.0);
        let in_order = parts.iter().enumerate().all(|(i, part)| u64::from(part.0) == u64::from(first) + i as u64);
        let segments = self.segments.unwrap_or(0.0);
        let complete =
            if first == 0 { parts.len() == 1 && segments <= 1.0 } else { first == 1 && segments == parts.len() as f64 };
        if !in_order || !complete {
            let problem = format!(
                "NumSegments = {segments}, and {} data sets from number {first} on; save it again",
                parts.len()
            );
            return Err(self.refuse(problem));
        }
        Ok(parts)
    }

    fn records(
        &self,
        file: &mut File,
        header: &Header,
        frame: &Frame,
        records: &mut Vec<Record>,
    ) -> Result<(), FormatError> {
        let entries = file.entries(header)?;
        let parts = self.parts(&entries)?;
        let mut shared: Option<(Arc<Head>, f64)> = None;
        for (number, at) in &parts {
            let header = file.header(*at)?;
            let data = Dataset::read(file, &header)?;
            let tag_s = header.number("SegmentedTimeTag")?;
            let (head, first_s) = match &shared {
                Some(shared) => shared.clone(),
                None => (Arc::new(self.head(frame, data.code_type, data.samples)?), tag_s.unwrap_or(0.0)),
            };
            if (head.samples, head.code_type) != (data.samples, data.code_type) {
                return Err(
                    self.refuse(format!("segment {number} has {} samples, the first {}", data.samples, head.samples))
                );
            }
            records.push(Record {
                segment: (parts.len() > 1).then_some(number.saturating_sub(1)),
                t0_s: if *number == 0 { self.x_origin } else { self.segment_origin(&header)? },
                trigger_s: tag_s.filter(|_| *number > 0).map(|tag_s| tag_s - first_s).filter(|tag_s| tag_s.is_finite()),
                payload: data.payload,
                head: Arc::clone(&head),
            });
            shared = Some((head, first_s));
        }
        Ok(())
    }

    /// SegmentedXOrg, if it differs from the XOrg of the group only by the sub-sample part of a trigger.
    fn segment_origin(&self, header: &Header) -> Result<Option<f64>, FormatError> {
        let (Some(own), Some(group), Some(dt_s)) = (header.number("SegmentedXOrg")?, self.x_origin, self.dt_s) else {
            return Ok(None);
        };
        Ok(((own - group).abs() < 2.0 * self.interpolation * dt_s).then_some(own))
    }

    fn head(&self, frame: &Frame, code_type: CodeType, samples: usize) -> Result<Head, FormatError> {
        let digital = self.kind == Kind::Digital;
        if !digital && self.points.is_some_and(|points| points != samples as f64) {
            let problem =
                format!("NumPoints = {}, its data set has {samples} samples; save it again", display(self.points));
            return Err(self.refuse(problem));
        }
        let integers = !matches!(code_type, CodeType::F32 | CodeType::F64) && !digital;
        if integers && self.scale.is_none_or(|scale| scale.gain == 0.0) {
            return Err(self.refuse("its samples are integers without YInc and YOrg; save it again"));
        }
        Ok(Head {
            kind: self.kind,
            instrument: frame.model.clone(),
            channel: Some(self.name.to_owned()),
            unit: self.unit.clone(),
            dt_s: self.dt_s,
            scale: self.scale.filter(|_| integers),
            header_gain: self.scale.map(|scale| scale.gain),
            header_offset: self.scale.map(|scale| scale.offset),
            acquired_at: frame.saved_at.clone(),
            ..Head::new(FORMAT, code_type, samples)
        })
    }
}
