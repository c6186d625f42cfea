//! PicoQuant's unified tagged files: .phu (histograms of photons over the time after the sync pulse) and .ptu (every
//! photon; this reader builds the histograms).
//!
//! A file is a list of tags (name, index, type, value), then data. Bin i is at `t0_s` + i * dt. .phu: one record for
//! each curve; dt is HistResDscr_MDescResolution, `t0_s` HistResDscr_MDescOffset (ns). .ptu in T3 mode: one record for
//! each input channel with photons; dt is MeasDesc_Resolution, `t0_s` MeasDesc_Offset (ns). All have as many bins as
//! the latest photon of the file needs; markers are not counted. The instrument subtracts the offset (0 by default)
//! from each time after the sync. Channel numbers are those of the file: PicoHarps count from 1, others from 0. Several
//! curves of one channel are its segments.
//!
//! Pile-up corrections need the number of sync cycles, which a record cannot hold: the campaign gives it. T2 mode is
//! refused, since it has no sync period to make a histogram over. Older formats (.pt3, .ht3, .phd, .thd) are not read.
//! Source: PicoQuant's description of the tagged file format with its demonstration programs. Tested on files that the
//! tests build, for which `ptufile` reads the same counts.

mod tags;

use std::collections::BTreeMap;
use std::io::{self, SeekFrom};
use std::ops::ControlFlow;
use std::sync::Arc;

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
        let dt_s = tags.required_bin_s("MeasDesc_Resolution", WHOLE)?;
        let t0_s = Some(tags.offset_s("MeasDesc_Offset", WHOLE)?);
        let (mut bins, mut channels) = (0, [false; 64]);
        events.photons(input.file(), &mut |channel, bin| {
            channels[channel] = true;
            bins = bins.max(bin + 1);
            Ok(())
        })?;
        let record = |channel: usize| {
            let head = Head { channel: Some(channel.to_string()), ..tags.head(self.format(), bins, dt_s) };
            let payload = Payload::Packed(Arc::new(Histogram { events, channel, bins }));
            Record { head: Arc::new(head), segment: None, t0_s, trigger_s: None, payload }
        };
        let records: Vec<Record> = (0..channels.len()).filter(|channel| channels[*channel]).map(record).collect();
        if records.is_empty() {
            return Err(tags.refuse("TTResult_NumberOfRecords", WHOLE, ": none of the events is a photon"));
        }
        Ok(records)
    }
}

/// How an event is laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Layout {
    /// 4 bits channel, 12 bits time, 16 bits sync counter.
    PicoHarp,
    /// Special, 6 bits channel, 15 bits time, 10 bits sync counter.
    HydraHarp,
}

/// Where the events are.
#[derive(Clone, Copy, Debug)]
struct Events {
    byte_offset: u64,
    count: u64,
    layout: Layout,
}

impl Events {
    fn of(input: &dyn Input, tags: &Tags) -> Result<Self, FormatError> {
        const TYPE: &str = "TTResultFormat_TTTRRecType";
        let record_type = tags.count(TYPE, WHOLE)?;
        let layout = match record_type {
            0x0001_0303 => Layout::PicoHarp,
            // HydraHarp, its version 2, TimeHarp 260 N and P, MultiHarp and PicoHarp 330.
            0x0001_0304..=0x0001_0307 | 0x0101_0304..=0x0101_0307 => Layout::HydraHarp,
            _ if record_type & 0xFF00 == 0x0200 => {
                let problem = "is of T2 mode, which has no sync period to make a histogram over; record in T3 mode, or \
                    export a histogram as .phu";
                return Err(tags.refuse(TYPE, WHOLE, problem));
            }
            _ => return Err(tags.refuse(TYPE, WHOLE, format!("= {record_type:#010x} is not known"))),
        };
        if let Some(bits) = tags.integer("TTResultFormat_BitsPerRecord", WHOLE)?.filter(|bits| ![0, 32].contains(bits))
        {
            return Err(tags.refuse("TTResultFormat_BitsPerRecord", WHOLE, format!("= {bits}: only 32 are read")));
        }
        let (byte_offset, count) = (tags.end, tags.count("TTResult_NumberOfRecords", WHOLE)?);
        let needed = count.saturating_mul(WORD_BYTES);
        if byte_offset.checked_add(needed).is_none_or(|end| end > input.length()) {
            return Err(FormatError::Truncated { what: "the events", byte_offset, needed, length: input.length() });
        }
        Ok(Self { byte_offset, count, layout })
    }

    /// Passes on the channel and time, in bins, of each photon.
    fn photons(&self, file: &mut dyn ReadSeek, take: &mut dyn FnMut(usize, usize) -> io::Result<()>) -> io::Result<()> {
        let length = self.count * WORD_BYTES;
        let mut piece = vec![0; PIECE_BYTES.min(length) as usize];
        file.seek(SeekFrom::Start(self.byte_offset))?;
        let mut done = 0;
        while done < length {
            let piece = &mut piece[..PIECE_BYTES.min(length - done) as usize];
            file.read_exact(piece)?;
            for event in piece.chunks_exact(WORD_BYTES as usize) {
                let event = u32::from_le_bytes(event.try_into().expect("chunks of four"));
                if let Some((channel, bin)) = self.layout.photon(event)? {
                    take(channel, bin)?;
                }
            }
            done += piece.len() as u64;
        }
        Ok(())
    }
}

impl Layout {
    /// Channel and time, in bins, of an event, if it is a photon.
    fn photon(self, event: u32) -> io::Result<Option<(usize, usize)>> {
        match self {
            Self::PicoHarp => match (event >> 28, (event >> 16) & 0xFFF) {
                (15, _) => Ok(None),
                (channel @ 1..=4, bin) => Ok(Some((channel as usize, bin as usize))),
                (channel, _) => {
                    let problem =
                        format!("an event on channel {channel}, but a PicoHarp has 1 to 4: the file is damaged");
                    Err(io::Error::new(io::ErrorKind::InvalidData, problem))
                }
            },
            Self::HydraHarp if event >> 31 == 1 => Ok(None),
            Self::HydraHarp => Ok(Some((((event >> 25) & 0x3F) as usize, ((event >> 10) & 0x7FFF) as usize))),
        }
    }
}

/// Photons of one channel. Each read counts them anew, since the histograms of all channels may be larger than the
/// file.
#[derive(Debug)]
struct Histogram {
    events: Events,
    channel: usize,
    bins: usize,
}

impl Unpack for Histogram {
    fn unpack(
        &self,
        file: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()> {
        let mut counts = vec![0_u32; self.bins];
        self.events.photons(file, &mut |channel, bin| {
            if channel != self.channel {
                return Ok(());
            }
            let count = counts.get_mut(bin).and_then(|count| Some((count.checked_add(1)?, count)));
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
