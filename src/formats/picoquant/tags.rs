//! The tags at the start of PicoQuant's unified files: each has a name, an index, a type and a value; bytes follow
//! some.

use std::collections::BTreeMap;

use crate::reader::{FormatError, Input};
use crate::waveform::{CodeType, Head, Kind, Scale};

/// Magic and version.
const PREAMBLE_BYTES: u64 = 16;
/// Name, index, type, value.
pub(super) const TAG_BYTES: u64 = 48;
/// Longest name of an instrument that is read.
const NAME_BYTES: u64 = 256;
/// Widest bin that is accepted, in seconds: a wider one is in another unit.
const WIDEST_BIN_S: f64 = 0.01;

/// Index of a tag that occurs once in a file.
pub(super) const WHOLE: i32 = -1;
/// Names of the tags that are read.
const NAMES: [&str; 19] = [
    "File_CreatingTime",
    "HW_Type",
    "ImgHdr_BiDirect",
    "ImgHdr_LineStop",
    "HistoResult_NumberOfCurves",
    "HistoResult_BitsPerBin",
    "HistResDscr_HistogramBins",
    "HistResDscr_DataOffset",
    "HistResDscr_HWInpChanIdx",
    "HistResDscr_MDescResolution",
    "HistResDscr_MDescOffset",
    "HistResDscr_TimeOfRecording",
    "MeasDesc_Resolution",
    "MeasDesc_GlobalResolution",
    "MeasDesc_Offset",
    "TTResultFormat_TTTRRecType",
    "TTResultFormat_BitsPerRecord",
    "TTResult_NumberOfRecords",
    "Header_End",
];
/// Types of tags' values.
pub(super) const BOOLEAN: u32 = 0x0000_0008;
pub(super) const INTEGER: u32 = 0x1000_0008;
pub(super) const FLOAT: u32 = 0x2000_0008;
pub(super) const DATE: u32 = 0x2100_0008;
pub(super) const TEXT: u32 = 0x4001_FFFF;
/// Ending of the types whose value is a number of bytes that follow the tag: arrays, texts, blobs.
const FOLLOWED: u32 = 0xFFFF;

/// Where a tag is, the type of its value, and the bits of its value.
#[derive(Clone, Copy)]
struct Tag {
    at: u64,
    kind: u32,
    value: u64,
}

/// The tags that are read, by name and index.
pub(super) struct Tags {
    by_name: BTreeMap<(&'static str, i32), Tag>,
    instrument: Option<String>,
    /// Where the tags end and events begin.
    pub(super) end: u64,
}

impl Tags {
    pub(super) fn read(input: &mut dyn Input, magic: &[u8]) -> Result<Self, FormatError> {
        if !input.bytes("the preamble", 0, PREAMBLE_BYTES)?.starts_with(magic) {
            let problem = format!("does not begin with {}; was it renamed?", String::from_utf8_lossy(&magic[..6]));
            return Err(FormatError::Field { byte_offset: 0, problem });
        }
        let mut all = Self { by_name: BTreeMap::new(), instrument: None, end: PREAMBLE_BYTES };
        loop {
            let (name, index, tag) = tag(&input.bytes("a tag of the header", all.end, TAG_BYTES)?, all.end);
            let content = all.end + TAG_BYTES;
            all.end = content;
            if tag.kind & 0xFFFF == FOLLOWED {
                let end = content.checked_add(tag.value).filter(|end| *end <= input.length());
                let (what, length) = ("what a tag announces", input.length());
                let cut = FormatError::Truncated { what, byte_offset: content, needed: tag.value, length };
                all.end = end.ok_or(cut)?;
                input.uses(content..all.end);
            }
            match name {
                Some("Header_End") => return Ok(all),
                Some("HW_Type") if tag.kind == TEXT => {
                    let bytes = input.bytes("HW_Type", content, tag.value.min(NAME_BYTES))?;
                    let text = String::from_utf8_lossy(&bytes);
                    all.instrument = Some(text.trim_matches(['\0', ' ']).to_owned()).filter(|name| !name.is_empty());
                }
                Some(name) => drop(all.by_name.insert((name, index), tag)),
                None => {}
            }
        }
    }

    pub(super) fn refuse(&self, name: &'static str, index: i32, problem: impl AsRef<str>) -> FormatError {
        let byte_offset = self.by_name.get(&(name, index)).map_or(0, |tag| tag.at);
        let which = if index == WHOLE { String::new() } else { format!("({index})") };
        FormatError::Field { byte_offset, problem: format!("{name}{which} {}", problem.as_ref()) }
    }

    pub(super) fn integer(&self, name: &'static str, index: i32) -> Result<Option<i64>, FormatError> {
        match self.by_name.get(&(name, index)) {
            None => Ok(None),
            Some(tag) if tag.kind == INTEGER => Ok(Some(tag.value.cast_signed())),
            Some(tag) => Err(self.refuse(name, index, format!("has type {:#010x}, not Int8", tag.kind))),
        }
    }

    /// Whether a tag that is true or false is there, and true.
    pub(super) fn is_true(&self, name: &'static str) -> bool {
        self.by_name.get(&(name, WHOLE)).is_some_and(|tag| tag.kind == BOOLEAN && tag.value != 0)
    }

    pub(super) fn count(&self, name: &'static str, index: i32) -> Result<u64, FormatError> {
        let missing = || self.refuse(name, index, "is missing: the header is incomplete; save the file again");
        let count = self.integer(name, index)?.ok_or_else(missing)?;
        u64::try_from(count).map_err(|_| self.refuse(name, index, format!("= {count} is negative")))
    }

    /// Width of a bin in seconds. (The vendor's tag dictionary says picoseconds for histograms; its programs and the
    /// files use seconds.)
    pub(super) fn bin_s(&self, name: &'static str, index: i32) -> Result<Option<f64>, FormatError> {
        let Some(tag) = self.by_name.get(&(name, index)) else { return Ok(None) };
        let width_s = f64::from_bits(tag.value);
        if tag.kind == FLOAT && width_s > 0.0 && width_s < WIDEST_BIN_S {
            return Ok(Some(width_s));
        }
        Err(self.refuse(name, index, format!("= {width_s} is no width of a bin in seconds")))
    }

    pub(super) fn required_bin_s(&self, name: &'static str, index: i32) -> Result<f64, FormatError> {
        self.bin_s(name, index)?.ok_or_else(|| self.refuse(name, index, "is missing: there is no time base"))
    }

    /// Time of the first bin, from an offset in nanoseconds.
    pub(super) fn offset_s(&self, name: &'static str, index: i32) -> Result<f64, FormatError> {
        Ok(self.integer(name, index)?.unwrap_or(0) as f64 * 1e-9)
    }

    /// What all records of a file have in common.
    pub(super) fn head(&self, format: &'static str, bins: usize, dt_s: f64) -> Head {
        Head {
            kind: Kind::Counts,
            instrument: self.instrument.clone(),
            unit: Some("counts".to_owned()),
            dt_s: Some(dt_s),
            scale: Some(Scale { gain: 1.0, offset: 0.0 }),
            acquired_at: self.date("File_CreatingTime", WHOLE),
            ..Head::new(format, CodeType::U32, bins)
        }
    }

    pub(super) fn date(&self, name: &'static str, index: i32) -> Option<String> {
        let tag = self.by_name.get(&(name, index)).filter(|tag| tag.kind == DATE)?;
        iso(f64::from_bits(tag.value))
    }
}

fn tag(bytes: &[u8], at: u64) -> (Option<&'static str>, i32, Tag) {
    let (name, rest) = bytes.split_at(32);
    let name = name.split(|byte| *byte == 0).next().unwrap_or_default();
    let word = |at: usize| u32::from_le_bytes(rest[at..at + 4].try_into().expect("four bytes"));
    let value = u64::from_le_bytes(rest[8..16].try_into().expect("eight bytes"));
    let entry = NAMES.into_iter().find(|entry| entry.as_bytes() == name);
    (entry, word(0).cast_signed(), Tag { at, kind: word(4), value })
}

/// Converts days since 1899-12-30 to ISO 8601, to the millisecond; `None` for days that cannot be a date of a
/// measurement.
pub(crate) fn iso(days: f64) -> Option<String> {
    // 1982 to 2173.
    let total_ms = (30_000.0..100_000.0).contains(&days).then(|| (days * 86_400_000.0).round() as u64)?;
    let (mut day, ms) = (total_ms / 86_400_000, total_ms % 86_400_000);
    day -= 29_221; // of 1980-01-01
    let mut year = 1980;
    let is_leap = |year: u64| year.is_multiple_of(4) && !year.is_multiple_of(100) || year.is_multiple_of(400);
    while day >= 365 + u64::from(is_leap(year)) {
        day -= 365 + u64::from(is_leap(year));
        year += 1;
    }
    let mut month = 0;
    let lengths = [31, 28 + u64::from(is_leap(year)), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    while day >= lengths[month] {
        day -= lengths[month];
        month += 1;
    }
    let (hour, minute, second) = (ms / 3_600_000, ms / 60_000 % 60, ms as f64 % 60_000.0 / 1000.0);
    Some(format!("{year:04}-{:02}-{:02}T{hour:02}:{minute:02}:{second:06.3}", month + 1, day + 1))
}
