//! Keysight and Agilent `.bin`: `AG01`, `AG03` (64 bit sizes) and `AG10`. Rigol writes the same layout with the
//! opposite sign of the origin: see [`super::rigol_bin`].
//!
//! Samples are volts already; sample i is at X Origin + i * X Increment after the trigger. A file holds waveforms, each
//! with one buffer of samples, or two in peak detect: the maxima and the minima. All is little-endian.
//!
//! Segmented memory: each segment is a waveform of its own; all of channel 1 precede those of channel 2. A segment has
//! a rising Segment Index and a Time Tag, in seconds after the first trigger; both are zero in other files. Therefore
//! waveforms of one label with rising indices are the segments of one channel. A channel without label is named by its
//! place in the file: `wf0`, `wf1`. Histograms and points with times of their own are refused.
//!
//! Source: Keysight, InfiniiVision 2000 X-Series User's Guide and Infiniium 90000 Programmer's Reference, "Binary
//! Header Format". Tested on real files: `AG10` of one and two channels, normal and logic. Tested only on files that
//! the tests build: `AG01`, `AG03`, segments, peak detect, averages, spectra and dates in words.

mod date;
mod encode;
#[cfg(test)]
pub(crate) mod tests;
mod walk;

use std::collections::BTreeMap;
use std::sync::Arc;

pub use encode::{VoltsHead, write};
use walk::{Trace, Walk, field};

use super::reader::{FormatError, Input, Reader};
use crate::waveform::{Payload, Record};

/// The reader.
pub struct KeysightBin;

/// Keysight's files.
const KEYSIGHT: Maker = Maker { format: "keysight-bin", cookie: *b"AG", origin_sign: 1.0, segments: true };

impl Reader for KeysightBin {
    fn format(&self) -> &'static str {
        KEYSIGHT.format
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["bin"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        KEYSIGHT.recognises(head)
    }
    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        KEYSIGHT.records(input)
    }
}

/// The differences between the makers that use this layout.
pub(super) struct Maker {
    pub format: &'static str,
    /// First bytes of a file; two digits of a version follow.
    pub cookie: [u8; 2],
    /// Factor from the X Origin to the time of sample 0.
    pub origin_sign: f64,
    /// Whether waveforms have a Time Tag and a Segment Index.
    pub segments: bool,
}

impl Maker {
    pub fn recognises(&self, head: &[u8]) -> bool {
        head.starts_with(&self.cookie) && head.get(2..4).is_some_and(|version| version.iter().all(u8::is_ascii_digit))
    }

    pub fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let (walk, file_size, count) = Walk::start(self, input)?;
        let (traces, end) = walk.waveforms(input, count)?;
        let Some(end) = end else { return Ok(records(traces)) };
        let length = input.length();
        if file_size > length {
            let what = "the whole file (File Size)";
            return Err(FormatError::Truncated { what, byte_offset: 0, needed: file_size, length });
        }
        // The File Size of `RG01` may be too small, so waveforms that fill the file are accepted whatever it says.
        // Bytes after the last waveform are ignored only if the File Size excludes them.
        if end != length && end != file_size {
            let left = length - end;
            let problem = format!("Number of Waveforms = {count}, but {left} bytes follow the last of them");
            return Err(field(end, format!("{problem}; save the file again")));
        }
        Ok(records(traces))
    }
}

/// Waveforms of one channel.
struct Channel {
    waveforms: u32,
    /// Segment Index and Time Tag of the first waveform.
    first: (u32, f64),
    /// Segment Index of the last waveform.
    last: u32,
    /// Whether each index exceeds the previous one.
    rising: bool,
    /// Whether any has a Time Tag.
    tagged: bool,
}

impl Channel {
    const fn is_segmented(&self) -> bool {
        self.waveforms > 1 && self.rising
    }
}

/// Makes the records, with the segments of each channel numbered from 0.
fn records(traces: Vec<Trace>) -> Vec<Record> {
    let mut channels: BTreeMap<String, Channel> = BTreeMap::new();
    for Trace { head, segment: (index, tag_s), .. } in &traces {
        let name = head.channel.as_deref().unwrap_or_default();
        if let Some(channel) = channels.get_mut(name) {
            channel.waveforms += 1;
            channel.rising &= *index > channel.last;
            channel.last = *index;
            channel.tagged |= *tag_s != 0.0;
        } else {
            let (first, tagged) = ((*index, *tag_s), *tag_s != 0.0);
            channels.insert(name.to_owned(), Channel { waveforms: 1, first, last: *index, rising: true, tagged });
        }
    }
    let first = channels.values().filter(|channel| channel.is_segmented()).map(|channel| channel.first.0).min();
    let mut records: Vec<Record> = Vec::with_capacity(traces.len());
    for Trace { head, t0_s, byte_offset, segment: (index, tag_s) } in traces {
        let channel = channels.get(head.channel.as_deref().unwrap_or_default()).filter(|c| c.is_segmented());
        let stride = head.code_type.bytes() as u64;
        // Segments of a channel share one head, to save memory.
        let shared = records.last().map(|record| &record.head).filter(|before| ***before == head).cloned();
        records.push(Record {
            head: shared.unwrap_or_else(|| Arc::new(head)),
            segment: channel.zip(first).map(|(_, first)| index - first),
            t0_s,
            trigger_s: channel.filter(|channel| channel.tagged).map(|channel| tag_s - channel.first.1),
            payload: Payload::File { byte_offset, stride, big_endian: false },
        });
    }
    records
}
