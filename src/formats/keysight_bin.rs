//! Keysight and Agilent `.bin`: `AG01`, `AG03` (64 bit sizes) and `AG10`. Rigol writes the same layout with another sign: see [`super::rigol_bin`].
//!
//! Samples are volts already, sample i at X Origin + i * X Increment after the trigger. A file holds waveforms, each with one buffer of samples, or
//! two in peak detect: the maxima and the minima. All is little-endian.
//!
//! Segmented memory: each segment is a waveform of its own, all of channel 1 before those of channel 2, with its Segment Index, which rises, and
//! its Time Tag, seconds since the first trigger; both are zero in other files. So waveforms of one label whose indices rise are the segments of a
//! channel. A channel without label is named by its place in the file, `wf0` and so on. Histograms and points with times of their own are refused.
//!
//! Source: Keysight, InfiniiVision 2000 X-Series User's Guide and Infiniium 90000 Programmer's Reference, "Binary Header Format". On real files:
//! `AG10` of one and two channels, normal and logic. `AG01`, `AG03`, segments, peak detect, averages, spectra and dates in words could only be
//! tested on files built for it.

mod date;
mod encode;
#[cfg(test)]
pub(crate) mod tests;
mod walk;

use std::collections::BTreeMap;
use std::sync::Arc;

pub use encode::{VoltsHead, write};
use walk::{Found, Walk, field};

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

/// In what the files of the makers that share this layout differ.
pub(super) struct Maker {
    pub format: &'static str,
    /// First bytes of a file; two digits of a version follow.
    pub cookie: [u8; 2],
    /// What makes the time of sample 0 of the X Origin.
    pub origin_sign: f64,
    /// Whether waveforms have a Time Tag and a Segment Index.
    pub segments: bool,
}

impl Maker {
    pub fn recognises(&self, head: &[u8]) -> bool {
        head.starts_with(&self.cookie) && head.get(2..4).is_some_and(|version| version.iter().all(u8::is_ascii_digit))
    }

    pub fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let (walk, said, count) = Walk::start(self, input)?;
        let (found, end) = walk.waveforms(input, count)?;
        // The File Size of `RG01` may be too small, so what fills the file is right; what follows may be left out only where the size leaves it out.
        if end != input.length() && end != said {
            let left = input.length() - end;
            let problem = format!("Number of Waveforms = {count}, but {left} bytes follow the last of them");
            return Err(field(end, format!("{problem}; save the file again")));
        }
        Ok(records(found))
    }
}

/// Waveforms of one channel.
struct Channel {
    waveforms: u32,
    /// Index and Time Tag of the first.
    first: (u32, f64),
    /// Index of the last.
    last: u32,
    /// Whether indices rise from each to the next.
    rising: bool,
    /// Whether any has a Time Tag.
    tagged: bool,
}

impl Channel {
    const fn is_segmented(&self) -> bool {
        self.waveforms > 1 && self.rising
    }
}

/// The records, with the segments of a channel numbered from 0.
fn records(found: Vec<Found>) -> Vec<Record> {
    let mut channels: BTreeMap<String, Channel> = BTreeMap::new();
    for Found { head, segment: (index, tag_s), .. } in &found {
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
    let mut records: Vec<Record> = Vec::with_capacity(found.len());
    for Found { head, t0_s, byte_offset, segment: (index, tag_s) } in found {
        let channel = channels.get(head.channel.as_deref().unwrap_or_default()).filter(|c| c.is_segmented());
        let stride = head.code_type.bytes() as u64;
        // Segments of a channel share one head.
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
