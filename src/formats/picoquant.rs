//! PicoQuant's unified tagged files: .phu (histograms of photons over the time after the sync pulse) and .ptu (every
//! photon; this reader builds the histograms).
//!
//! A file is a list of tags (name, index, type, value), then data. Bin i is at `t0_s` + i * dt. .phu: one record for
//! each curve; dt is HistResDscr_MDescResolution, `t0_s` HistResDscr_MDescOffset (ns). .ptu in T3 mode: one record for
//! each input channel with photons; dt is MeasDesc_Resolution, `t0_s` MeasDesc_Offset (ns). All have as many bins as
//! the latest photon of the file needs; markers are not counted, and photons of all pixels of an image are one
//! histogram. The instrument subtracts the offset (0 by default) from each time after the sync. Channel numbers are
//! those of the file: PicoHarps count from 1, others from 0. Several curves of one channel are its segments.
//!
//! .ptu in T2 mode: times count from the last event of the sync channel (channel 0 of a PicoHarp); photons before the
//! first one are left out, and a file without such events is refused. dt is the resolution times the smallest power of
//! two by which the longest time takes at most 65,536 bins. A file whose head claims no events was not ended properly:
//! all events up to its end are read, with a remark.
//!
//! Pile-up corrections need the number of sync cycles, which a record cannot hold: the campaign gives it. Older formats
//! (.pt3, .ht3, .phd, .thd) are refused by name. Source: PicoQuant's description of the tagged file format with its
//! demonstration programs. Tested on a real image of a PicoHarp in T3 mode, whose histogram equals that of `ptufile`;
//! the rest on files that the tests build, for which it reads the same counts.

mod events;
mod tags;

use std::collections::BTreeMap;
use std::io::{self, SeekFrom};
use std::ops::ControlFlow;
use std::sync::Arc;

use self::events::{Clock, Layout};
pub(crate) use self::tags::iso;
use self::tags::{Tags, WHOLE};
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{Head, Payload, ReadSeek, Record, Unpack};

/// Reader of histograms.
pub struct PicoquantPhu;
/// Reader of events.
pub struct PicoquantPtu;

/// First bytes of a file of histograms.
const HISTOGRAMS: &[u8] = b"PQHISTO\0";
const EVENTS: &[u8] = b"PQTTTR\0\0";
/// Bytes of an event, and of a count.
const WORD_BYTES: u64 = 4;
/// Bytes of events that are in memory at a time.
const PIECE_BYTES: u64 = 1 << 16;
/// Tag of the number of events.
const RECORDS: &str = "TTResult_NumberOfRecords";
/// Most bins of a histogram that is made of absolute times.
const MOST_BINS: u64 = 1 << 16;
/// Most curves of a file; instruments have up to 512.
const MAX_CURVES: i32 = 1024;

impl Reader for PicoquantPhu {
    fn format(&self) -> &'static str {
        "picoquant-phu"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["phu"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        head.starts_with(HISTOGRAMS)
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let tags = Tags::read(input, HISTOGRAMS)?;
        let curves = tags.count("HistoResult_NumberOfCurves", WHOLE)?;
        let index = i32::try_from(curves).ok().filter(|curves| (1..=MAX_CURVES).contains(curves));
        let curves = index.ok_or_else(|| {
            tags.refuse("HistoResult_NumberOfCurves", WHOLE, format!("= {curves}: 1 to {MAX_CURVES} are possible"))
        })?;
        if let Some(bits) = tags.integer("HistoResult_BitsPerBin", WHOLE)?.filter(|bits| *bits != 32) {
            return Err(tags.refuse("HistoResult_BitsPerBin", WHOLE, format!("= {bits}: only 32 are read")));
        }
        let mut records: Vec<Record> = Vec::new();
        for index in 0..curves {
            records.push(self.curve(input, &tags, index)?);
        }
        number_segments(&mut records);
        Ok(records)
    }
}

impl PicoquantPhu {
    fn curve(&self, input: &dyn Input, tags: &Tags, index: i32) -> Result<Record, FormatError> {
        let (bins, byte_offset) =
            (tags.count("HistResDscr_HistogramBins", index)?, tags.count("HistResDscr_DataOffset", index)?);
        let end = bins.checked_mul(WORD_BYTES).and_then(|needed| byte_offset.checked_add(needed));
        if bins == 0 || end.is_none_or(|end| end > input.length()) {
            let (needed, length) = (bins.saturating_mul(WORD_BYTES), input.length());
            return Err(match bins {
                0 => tags.refuse("HistResDscr_HistogramBins", index, "= 0: the curve is empty"),
                _ => FormatError::Truncated { what: "a curve", byte_offset, needed, length },
            });
        }
        let channel = tags.integer("HistResDscr_HWInpChanIdx", index)?;
        let dt_s = match tags.bin_s("HistResDscr_MDescResolution", index)? {
            Some(dt_s) => dt_s,
            None => tags.required_bin_s("MeasDesc_Resolution", WHOLE)?,
        };
        let head = Head {
            channel: channel.map(|channel| channel.to_string()),
            acquired_at: tags
                .date("HistResDscr_TimeOfRecording", index)
                .or_else(|| tags.date("File_CreatingTime", WHOLE)),
            ..tags.head(self.format(), bins as usize, dt_s)
        };
        let payload = Payload::File { byte_offset, stride: WORD_BYTES, big_endian: false };
        let t0_s = Some(tags.offset_s("HistResDscr_MDescOffset", index)?);
        Ok(Record { head: Arc::new(head), segment: None, t0_s, trigger_s: None, payload })
    }
}

/// Numbers several records of one channel as its segments.
fn number_segments(records: &mut [Record]) {
    let mut seen: BTreeMap<Option<String>, u32> = BTreeMap::new();
    for record in &mut *records {
        let count = seen.entry(record.head.channel.clone()).or_insert(0);
        record.segment = Some(*count);
        *count += 1;
    }
    for record in records {
        if seen.get(&record.head.channel) == Some(&1) {
            record.segment = None;
        }
    }
}

impl Reader for PicoquantPtu {
    fn format(&self) -> &'static str {
        "picoquant-ptu"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["ptu"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        head.starts_with(EVENTS)
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let tags = Tags::read(input, EVENTS)?;
        let events = Events::of(input, &tags)?;
        let is_t2 = events.layout.is_t2();
        let unit_s = match tags.bin_s("MeasDesc_GlobalResolution", WHOLE)?.filter(|_| is_t2) {
            Some(unit_s) => unit_s,
            None => tags.required_bin_s("MeasDesc_Resolution", WHOLE)?,
        };
        let t0_s = if is_t2 { Some(0.0) } else { Some(tags.offset_s("MeasDesc_Offset", WHOLE)?) };
        let (mut times, mut channels) = (0, [false; 64]);
        events.photons(input.file(), &mut |channel, time| {
            channels[channel] = true;
            times = times.max(time + 1);
            Ok(())
        })?;
        let shift = (0..u64::BITS).find(|shift| times.div_ceil(1 << shift) <= MOST_BINS).unwrap_or_default();
        let (bins, dt_s) = (times.div_ceil(1 << shift) as usize, unit_s * (1_u64 << shift) as f64);
        let record = |channel: usize| {
            let head = Head { channel: Some(channel.to_string()), ..tags.head(self.format(), bins, dt_s) };
            let payload = Payload::Packed(Arc::new(Histogram { events, channel, bins, shift }));
            Record { head: Arc::new(head), segment: None, t0_s, trigger_s: None, payload }
        };
        let records: Vec<Record> = (0..channels.len()).filter(|channel| channels[*channel]).map(record).collect();
        if records.is_empty() {
            let problem = if is_t2 {
                ": no photon follows an event of the sync channel, from which T2 mode would count; record in T3 mode, or \
                 with the laser's trigger on the sync input"
            } else {
                ": none of the events is a photon"
            };
            return Err(tags.refuse(RECORDS, WHOLE, problem));
        }
        Ok(records)
    }
}

/// Where the events are.
#[derive(Clone, Copy, Debug)]
struct Events {
    byte_offset: u64,
    count: u64,
    layout: Layout,
}

impl Events {
    fn of(input: &mut dyn Input, tags: &Tags) -> Result<Self, FormatError> {
        const TYPE: &str = "TTResultFormat_TTTRRecType";
        let record_type = tags.count(TYPE, WHOLE)?;
        let unknown = || tags.refuse(TYPE, WHOLE, format!("= {record_type:#010x} is not known"));
        let layout = Layout::of(record_type).ok_or_else(unknown)?;
        if let Some(bits) = tags.integer("TTResultFormat_BitsPerRecord", WHOLE)?.filter(|bits| ![0, 32].contains(bits))
        {
            return Err(tags.refuse("TTResultFormat_BitsPerRecord", WHOLE, format!("= {bits}: only 32 are read")));
        }
        let (byte_offset, mut count) = (tags.end, tags.count(RECORDS, WHOLE)?);
        if count == 0 {
            count = input.length().saturating_sub(byte_offset) / WORD_BYTES;
            let problem = format!(
                "{RECORDS} = 0: the measurement was not ended in its software, and all {count} events up to the end of \
                 the file are read; take its duration from another source"
            );
            input.remark(byte_offset, problem);
        }
        let needed = count.saturating_mul(WORD_BYTES);
        if byte_offset.checked_add(needed).is_none_or(|end| end > input.length()) {
            return Err(FormatError::Truncated { what: "the events", byte_offset, needed, length: input.length() });
        }
        input.uses(byte_offset..byte_offset + needed);
        Ok(Self { byte_offset, count, layout })
    }

    /// Passes on the channel and time, in units of the time base, of each photon.
    fn photons(&self, file: &mut dyn ReadSeek, take: &mut dyn FnMut(usize, u64) -> io::Result<()>) -> io::Result<()> {
        let length = self.count * WORD_BYTES;
        let mut piece = vec![0; PIECE_BYTES.min(length) as usize];
        file.seek(SeekFrom::Start(self.byte_offset))?;
        let mut clock = Clock::new(self.layout);
        let mut done = 0;
        while done < length {
            let piece = &mut piece[..PIECE_BYTES.min(length - done) as usize];
            file.read_exact(piece)?;
            for event in piece.chunks_exact(WORD_BYTES as usize) {
                let event = u32::from_le_bytes(event.try_into().expect("chunks of four"));
                if let Some((channel, time)) = clock.photon(event)? {
                    take(channel, time)?;
                }
            }
            done += piece.len() as u64;
        }
        Ok(())
    }
}

/// Photons of one channel. Each read counts them anew, since the histograms of all channels may be larger than the
/// file.
#[derive(Debug)]
struct Histogram {
    events: Events,
    channel: usize,
    bins: usize,
    /// A bin is two to this power of the time base's units.
    shift: u32,
}

impl Unpack for Histogram {
    fn unpack(
        &self,
        file: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()> {
        let mut counts = vec![0_u32; self.bins];
        self.events.photons(file, &mut |channel, time| {
            if channel != self.channel {
                return Ok(());
            }
            let count =
                counts.get_mut((time >> self.shift) as usize).and_then(|count| Some((count.checked_add(1)?, count)));
            let (next, count) = count.ok_or_else(|| io::Error::other("more photons, or later ones, than at first"))?;
            *count = next;
            Ok(())
        })?;
        let bytes: Vec<u8> = counts.iter().flat_map(|count| count.to_le_bytes()).collect();
        take(&bytes).map(|_| ())
    }
}

#[cfg(test)]
mod tests;
