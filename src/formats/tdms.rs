//! National Instruments TDMS (`.tdms`): channels of LabVIEW, SignalExpress, DIAdem and of other programs.
//!
//! A file is a list of segments. Each has a lead-in of 28 bytes, objects that are new or changed (the file, its groups,
//! its channels) with their properties, and raw data in chunks. A chunk holds some values of each channel, one channel
//! after the other or interleaved. A segment may repeat the objects of the segment before it without a word.
//!
//! # Records
//!
//! A channel with `wf_samples` of 2 or more, of which its values are a whole multiple, holds that many waveforms: each
//! is a record, and segments count them. Without `wf_samples`, chunks of equal length are taken for waveforms, and a
//! remark says so. Any other channel is one record of all its values, wherever the file has them. Channels are named
//! by `channel`, or by `group/channel` where the file has several groups.
//!
//! # Time and scale
//!
//! `wf_increment` is the time between samples, and `wf_start_offset` the time of sample 0 after `wf_start_time`, which
//! is that of the first waveform; both in seconds. With `wf_xunit_string` Hz, the channel is a spectrum. Scales
//! (`NI_Scale[0]` and so on) are applied if all of them are linear: type Linear, or Polynomial without higher powers.
//! With a scale of another type, values are codes, and a remark names the type.
//!
//! # Not read
//!
//! DAQmx raw data, which the driver's own logging writes, are refused by name. Channels of text, times, logic values,
//! complex numbers and 64 bit integers are skipped with a remark.
//!
//! A file that ends within a segment, or whose writer was stopped there, gives the whole chunks. A segment that equals
//! the first one byte for byte is remarked on, since TDMS files may be joined end to end.
//!
//! Source: National Instruments, *TDMS File Format Internal Structure*; properties as the files of LabVIEW have them.

mod joined;
mod metadata;
mod properties;

use std::collections::BTreeSet;
use std::sync::Arc;

use super::beam;
use super::numbers::Numbers;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Kind, Payload, Record};
use joined::{Extent, Joined};
use metadata::{Objects, Text};
use properties::Properties;

/// The reader.
pub struct Tdms;

const TAG: &[u8] = b"TDSm";
/// Bytes of a lead-in.
const LEAD_IN: u64 = 28;
/// Versions of the format.
const VERSIONS: [u32; 2] = [4712, 4713];
/// Flags of a lead-in: what the segment has.
const META: u32 = 1 << 1;
const NEW_LIST: u32 = 1 << 2;
const RAW: u32 = 1 << 3;
const INTERLEAVED: u32 = 1 << 5;
const BIG_ENDIAN: u32 = 1 << 6;
const DAQMX: u32 = 1 << 7;
/// Offset to the next segment where the writer was stopped within this one.
const UNFINISHED: u64 = u64::MAX;
/// Bytes of a segment that are compared with the first one.
const COMPARED: u64 = 1 << 12;

impl Reader for Tdms {
    fn format(&self) -> &'static str {
        "tdms"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &[]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        head.starts_with(TAG)
    }
    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let mut objects = Objects::default();
        segments(input, &mut objects)?;
        let channels = objects.into_channels();
        let count = channels.iter().map(Channel::waveforms).sum();
        if beam::are_too_many(count, input.length()) {
            let problem = format!("{count} waveforms in {} bytes; give wf_samples, and save again", input.length());
            return Err(FormatError::Field { byte_offset: 0, problem });
        }
        let mut records = Vec::with_capacity(count as usize);
        for (channel, name) in channels.iter().zip(names(&channels)) {
            channel.records(&name, &mut records)?;
        }
        remarks(input, &channels);
        if records.is_empty() {
            return Err(nothing(&channels));
        }
        Ok(records)
    }
}

/// What is to be said of the channels, once for all of them.
fn remarks(input: &mut dyn Input, channels: &[Channel]) {
    let first = |holds: &dyn Fn(&Channel) -> Option<String>| {
        let mut of = channels.iter().filter_map(|channel| Some((channel, holds(channel)?)));
        of.next().map(|(channel, text)| (channel, text, of.count()))
    };
    let notes = [
        first(&|channel| {
            let kind = channel.skipped?;
            Some(format!("is skipped, since its values are {kind}; save it as numbers of 32 bits or floats"))
        }),
        first(&|channel| {
            let kind = channel.properties.unread_scale()?;
            (!channel.pieces.is_empty()).then(|| {
                format!("has a scale of type {kind}, which is not read: values are codes; give gain_v and offset_v")
            })
        }),
        first(&|channel| {
            let values = channel.waveform_values();
            let is_guess = channel.properties.samples.is_none() && values < channel.values();
            is_guess.then(|| {
                format!(
                    "was written in pieces of {values} values without wf_samples: each piece is read as a waveform; \
                     write waveforms, so that the file says where each begins"
                )
            })
        }),
        first(&|channel| {
            let samples = channel.properties.samples.filter(|samples| *samples > 1)?;
            let values = channel.values();
            (!values.is_multiple_of(samples)).then(|| {
                format!("has {values} values, not a multiple of its wf_samples, {samples}: it is read as one record")
            })
        }),
    ];
    for (Channel { place, name, .. }, text, others) in notes.into_iter().flatten() {
        let others = if others > 0 { format!(" (the same holds for {others} more)") } else { String::new() };
        input.remark(*place, format!("channel {name:.60} {text}{others}"));
    }
}

/// Why a file has no records.
fn nothing(channels: &[Channel]) -> FormatError {
    if channels.iter().any(|channel| channel.skipped.is_some()) {
        let fix = "save the channels as numbers of 32 bits or floats";
        return FormatError::NotRead { what: "a TDMS file of text, times, logic values or 64 bit integers", fix };
    }
    let problem = "no channel has values: the recording may have been interrupted";
    FormatError::Field { byte_offset: 0, problem: problem.to_owned() }
}

/// A segment's lead-in.
struct LeadIn {
    at: u64,
    flags: u32,
    /// Where its raw data begin.
    raw: u64,
    /// Where it ends, as far as the file has it.
    end: u64,
    /// Whether the file ends before it does.
    is_cut: bool,
    /// Whether its writer was stopped within it.
    is_unfinished: bool,
}

impl LeadIn {
    fn read(input: &mut dyn Input, at: u64) -> Result<Self, FormatError> {
        let mut head = Numbers::little(input.peek("a lead-in", at, LEAD_IN)?, at);
        if !head.bytes.starts_with(TAG) {
            let problem = "a segment should begin here, but there is no `TDSm`; copy the file again";
            return Err(head.refuse(0, problem));
        }
        let flags = head.u32(4);
        head.big_endian = flags & BIG_ENDIAN != 0;
        let (version, next, raw) = (head.u32(8), head.u64(12), head.u64(20));
        if !VERSIONS.contains(&version) {
            return Err(head.refuse(8, format!("version {version} of TDMS is none; copy the file again")));
        }
        if raw > next {
            let problem = format!("raw data at {raw} behind the end of the segment at {next}; copy the file again");
            return Err(head.refuse(20, problem));
        }
        let data = at + LEAD_IN;
        let end = data.checked_add(next).filter(|end| next != UNFINISHED && *end <= input.length());
        input.uses(at..data);
        Ok(Self {
            at,
            flags,
            raw: data.saturating_add(raw),
            end: end.unwrap_or(input.length()),
            is_cut: end.is_none() && next != UNFINISHED,
            is_unfinished: next == UNFINISHED,
        })
    }

    fn has(&self, flag: u32) -> bool {
        self.flags & flag != 0
    }
}

/// Reads all segments into the objects that they describe.
fn segments(input: &mut dyn Input, objects: &mut Objects) -> Result<(), FormatError> {
    let (mut at, mut first) = (0, None);
    let mut chunks = 0;
    while at < input.length() {
        let rest = input.length() - at;
        let start = input.peek("a lead-in", at, rest.min(TAG.len() as u64))?;
        if at > 0 && !TAG.starts_with(&start) {
            break; // what follows is reported as surplus
        }
        if at > 0 && rest < LEAD_IN {
            input.cut_short(at, "chunk", chunks);
            break;
        }
        let lead_in = LeadIn::read(input, at)?;
        if lead_in.raw > lead_in.end {
            if chunks == 0 {
                let needed = lead_in.raw - at;
                return Err(FormatError::Truncated { what: "a segment", byte_offset: at, needed, length: lead_in.end });
            }
            input.cut_short(at, "chunk", chunks);
            break;
        }
        if lead_in.has(DAQMX) {
            return Err(daqmx());
        }
        repeated(input, &lead_in, &mut first)?;
        if lead_in.has(META) {
            let what = "the objects of a segment";
            let bytes = input.peek(what, at + LEAD_IN, lead_in.raw - at - LEAD_IN)?;
            let mut text = Text::new(bytes, at + LEAD_IN, lead_in.has(BIG_ENDIAN));
            let room = input.length();
            objects.update(&mut text, lead_in.has(NEW_LIST), room)?;
            input.uses(at + LEAD_IN..text.place());
        }
        if lead_in.has(RAW) {
            chunks += raw_data(input, objects, &lead_in, chunks)?;
        }
        at = lead_in.end;
    }
    Ok(())
}

fn daqmx() -> FormatError {
    let fix = "log scaled data, or convert the file to floats in LabVIEW or DIAdem";
    FormatError::NotRead { what: "a TDMS file of DAQmx raw data", fix }
}

/// Remarks on a segment that equals the first one, as far as is compared: the file may hold a recording twice.
fn repeated(input: &mut dyn Input, lead_in: &LeadIn, first: &mut Option<Vec<u8>>) -> Result<(), FormatError> {
    let length = (lead_in.end - lead_in.at).min(COMPARED);
    let Some(compared) = first else {
        *first = Some(input.peek("a segment", lead_in.at, length)?);
        return Ok(());
    };
    let start = input.peek("a segment", lead_in.at, LEAD_IN)?;
    if compared.starts_with(&start) && input.peek("a segment", lead_in.at, length)? == *compared {
        let problem = "the segment here begins as the first one does: is the file put together of two copies?";
        input.remark(lead_in.at, problem.to_owned());
        compared.clear();
    }
    Ok(())
}

/// Where the channels' values are in the raw data of a segment. Returns the number of whole chunks.
fn raw_data(input: &mut dyn Input, objects: &mut Objects, lead_in: &LeadIn, before: u64) -> Result<u64, FormatError> {
    let refuse =
        |problem: String| FormatError::Field { byte_offset: lead_in.raw, problem: problem + "; copy the file again" };
    let live = objects.live();
    let available = lead_in.end - lead_in.raw;
    let mut chunk_bytes = 0_u64;
    for (_, layout) in &live {
        let sum = chunk_bytes.checked_add(layout.bytes);
        chunk_bytes = sum.ok_or_else(|| refuse("a chunk is longer than any file".to_owned()))?;
    }
    if chunk_bytes == 0 {
        return Ok(0); // what follows is reported as a gap
    }
    let is_interleaved = lead_in.has(INTERLEAVED) && live.len() > 1;
    let row_bytes: u64 = live.iter().map(|(_, layout)| layout.width).sum();
    if is_interleaved && live.iter().any(|(_, layout)| layout.values != live[0].1.values || layout.width == 0) {
        return Err(refuse("interleaved channels of unequal length, or of text".to_owned()));
    }
    let chunks = available / chunk_bytes;
    let mut start = lead_in.raw;
    // Of no whole chunk, lengths may be larger than any file.
    for (object, layout) in live.into_iter().filter(|_| chunks > 0) {
        let at = start;
        start += if is_interleaved { layout.width } else { layout.bytes };
        let stride = if is_interleaved { row_bytes } else { layout.width };
        let big_endian = lead_in.has(BIG_ENDIAN);
        let extent = Extent { at, values: layout.values, chunks, chunk_bytes, stride, big_endian };
        objects.push(object, extent, input.length()).map_err(|problem| refuse(problem.to_owned()))?;
    }
    let end = lead_in.raw + chunks * chunk_bytes;
    input.uses(lead_in.raw..end);
    if lead_in.is_cut && before + chunks == 0 {
        let (needed, length) = (chunk_bytes, lead_in.end);
        return Err(FormatError::Truncated { what: "a chunk", byte_offset: lead_in.raw, needed, length });
    }
    if lead_in.is_cut || lead_in.is_unfinished && end < lead_in.end {
        input.cut_short(end, "chunk", before + chunks);
    }
    Ok(chunks)
}

/// A channel, and where its values are.
#[derive(Debug, Default)]
struct Channel {
    /// Where the file first names it.
    place: u64,
    group: String,
    name: String,
    properties: Properties,
    /// Type of its values, if they can be read; what they are otherwise.
    code_type: Option<CodeType>,
    skipped: Option<&'static str>,
    pieces: Vec<Extent>,
}

impl Channel {
    fn values(&self) -> u64 {
        self.pieces.iter().map(Extent::total).sum()
    }

    /// Values of one waveform.
    fn waveform_values(&self) -> u64 {
        let total = self.values();
        match self.properties.samples {
            Some(samples) if samples > 1 && total.is_multiple_of(samples) => samples,
            Some(_) => total,
            None => {
                let values = self.pieces.first().map_or(0, |piece| piece.values);
                let is_even = values > 1 && self.pieces.iter().all(|piece| piece.values == values);
                if is_even { values } else { total }
            }
        }
    }

    fn waveforms(&self) -> u64 {
        self.values().checked_div(self.waveform_values()).unwrap_or_default()
    }

    fn records(&self, name: &str, records: &mut Vec<Record>) -> Result<(), FormatError> {
        let (total, waveform) = (self.values(), self.waveform_values());
        let Some(code_type) = self.code_type.filter(|_| waveform > 0) else { return Ok(()) };
        let refuse = |problem: String| FormatError::Field { byte_offset: self.place, problem };
        let samples = usize::try_from(waveform).map_err(|_| refuse("is too large for this machine".to_owned()))?;
        let properties = &self.properties;
        let time = properties.time().map_err(refuse)?;
        let head = Arc::new(Head {
            kind: properties.kind(),
            channel: Some(name.to_owned()),
            unit: properties.unit.clone(),
            dt_s: time.step_s,
            scale: properties.scale().map_err(refuse)?,
            rails: code_type.limits().filter(|_| properties.kind() == Kind::Waveform),
            acquired_at: properties.acquired_at.clone(),
            ..Head::new(Tdms.format(), code_type, samples)
        });
        let pieces: Arc<[Extent]> = self.pieces.clone().into();
        let (mut piece, mut skip) = (0, 0);
        for number in 0..total / waveform {
            let payload = match pieces[piece].run(skip) {
                Some((byte_offset, run)) if run >= waveform => {
                    Payload::File { byte_offset, stride: pieces[piece].stride, big_endian: pieces[piece].big_endian }
                }
                _ => Payload::Packed(Arc::new(Joined {
                    pieces: Arc::clone(&pieces),
                    first: piece,
                    skip,
                    values: waveform,
                    code_type,
                })),
            };
            let segment = (total > waveform).then_some(number as u32);
            records.push(Record { head: Arc::clone(&head), segment, t0_s: time.start_s, trigger_s: None, payload });
            skip += waveform;
            while piece < pieces.len() && skip >= pieces[piece].total() {
                skip -= pieces[piece].total();
                piece += 1;
            }
        }
        Ok(())
    }
}

/// Names of channels, with their group where there are several.
fn names(channels: &[Channel]) -> Vec<String> {
    let groups: BTreeSet<&str> = channels.iter().map(|channel| &channel.group[..]).collect();
    let name = |channel: &Channel| match groups.len() {
        1 => channel.name.clone(),
        _ => format!("{}/{}", channel.group, channel.name),
    };
    channels.iter().map(name).collect()
}

#[cfg(test)]
mod tests;
