//! PicoQuant's unified tagged files: .phu (histograms of photons over the time after the sync pulse) and .ptu (every
//! photon; this reader builds the histograms).
//!
//! A file is a list of tags (name, index, type, value), then data. Bin i is at `t0_s` + i * dt. .phu: one record for
//! each curve; dt is HistResDscr_MDescResolution, `t0_s` HistResDscr_MDescOffset (ns). .ptu in T3 mode: one record for
//! each input channel with photons; dt is MeasDesc_Resolution, `t0_s` MeasDesc_Offset (ns). All have as many bins as
//! the latest photon of the file needs; photons of all pixels of an image are one histogram, unless the caller names a
//! `marker`: then each of its events begins a new one, a segment of its channel, and photons before the first are left
//! out with a remark. Where markers tell lines alone, `pixels` cuts each line into so many equal times, and segments
//! count the pixels, line by line. `bin_ps` makes bins of several units of the time base. The instrument subtracts the
//! offset (0 by default) from each time after the sync. Channel numbers are those of the file: PicoHarps count from 1,
//! others from 0. Several curves of one channel are its segments.
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
mod pixels;
mod table;
mod tags;

use std::collections::BTreeMap;
use std::io::{self, SeekFrom};
use std::ops::ControlFlow;
use std::sync::Arc;

use self::events::{Clock, Event, Layout, MARKERS};
use self::pixels::Pixels;
use self::table::Table;
pub(crate) use self::tags::iso;
use self::tags::{Tags, WHOLE};
use super::description::{Description, Key};
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
/// Largest deviation of a bin from a whole number of units of the time base, relative.
const WHOLE_UNITS: f64 = 1e-6;
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
    fn keys(&self) -> &'static [Key] {
        &[Key::Bin, Key::Marker, Key::Pixels]
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
        let description = input.description().clone();
        let is_cut = description.marker.is_some() || description.pixels.is_some();
        let table = if is_cut { None } else { Table::of(&events, input.file())? };
        let survey = match &table {
            Some(table) => table.survey(&events),
            None => events.survey(input, &description, Pixels::of(&description, &tags)?)?,
        };
        let Survey { times, channels, stretches, left_out, .. } = survey;
        let per_bin = per_bin(times, unit_s, is_t2, &description)?;
        let (bins, dt_s) = (times.div_ceil(per_bin) as usize, unit_s * per_bin as f64);
        let mut records = Vec::new();
        for channel in (0..channels.len()).filter(|channel| channels[*channel]) {
            let head = Arc::new(Head { channel: Some(channel.to_string()), ..tags.head(self.format(), bins, dt_s) });
            for (number, stretch) in stretches.iter().enumerate() {
                let unpack: Arc<dyn Unpack> = match &table {
                    Some(table) => Arc::new(Counted(table.histogram(channel, bins, per_bin as usize))),
                    None => Arc::new(Histogram { stretch: *stretch, channel, bins, per_bin }),
                };
                let payload = Payload::Packed(unpack);
                let segment = description.marker.map(|_| number as u32);
                records.push(Record { head: Arc::clone(&head), segment, t0_s, trigger_s: None, payload });
            }
        }
        if left_out > 0 {
            let place =
                if description.pixels.is_some() { "lie outside of all lines" } else { "come before the first marker" };
            let problem = format!("{left_out} photons {place}, and are left out");
            input.remark(events.byte_offset, problem);
        }
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

    /// All of them.
    fn start(&self) -> Stretch {
        Stretch { events: *self, clock: Clock::new(self.layout) }
    }

    /// What the events are together, cut at those of a marker, or into pixels.
    fn survey(
        &self,
        input: &mut dyn Input,
        description: &Description,
        pixels: Option<Pixels>,
    ) -> Result<Survey, FormatError> {
        // A record takes far more memory than the event at which it begins.
        let each = size_of::<Record>() + size_of::<Histogram>() + size_of::<Stretch>();
        let most = (2 * input.length() + (1 << 18)) as usize / each;
        let Some(marker) = description.marker else {
            let mut survey = Survey::whole(self);
            self.start().each(input.file(), |_, _, event| {
                survey.take(event);
                Ok(())
            })?;
            return Ok(survey);
        };
        let survey = match pixels {
            Some(pixels) => pixels.survey(self, input, most)?,
            None => self.cut_at(marker, input, most)?,
        };
        let parts = survey.stretches.len();
        if parts == 0 {
            return Err(Key::Marker.refuse(format!("= {marker}: no such marker is in the file; take it out")).into());
        }
        let channels = survey.channels.iter().filter(|is_there| **is_there).count();
        if parts.saturating_mul(channels.max(1)) > most {
            let problem = format!("= {marker} gives {parts} histograms on {channels} channels, too many for the file");
            return Err(Key::Marker.refuse(format!("{problem}; cut the measurement into files")).into());
        }
        Ok(survey)
    }

    /// The events cut at those of a marker, of which there may be `most`.
    fn cut_at(&self, marker: u32, input: &mut dyn Input, most: usize) -> Result<Survey, FormatError> {
        let (mut survey, mut markers) = (Survey::cut_up(), 0);
        let bit = 1 << (marker.clamp(1, MARKERS) - 1);
        self.start().each(input.file(), |number, clock, event| {
            match event {
                Event::Markers(bits) if bits & bit != 0 => {
                    markers += 1;
                    if markers <= most {
                        survey.cut(self, number + 1, *clock);
                    }
                }
                event => survey.take(event),
            }
            Ok(())
        })?;
        if markers > most {
            let problem = format!("= {marker} gives {markers} histograms, too many for the file");
            return Err(Key::Marker.refuse(format!("{problem}; cut the measurement into files")).into());
        }
        Ok(survey)
    }
}

/// What the events of a file are together.
struct Survey {
    /// One more than the latest time after the sync pulse.
    times: u64,
    /// Which channels have photons.
    channels: [bool; 64],
    /// The events of each histogram.
    stretches: Vec<Stretch>,
    /// Whether events belong to the last of them.
    is_open: bool,
    /// Photons that belong to none.
    left_out: u64,
}

impl Survey {
    /// Nothing yet of events that are one histogram.
    fn whole(events: &Events) -> Self {
        Self { stretches: vec![events.start()], is_open: true, ..Self::cut_up() }
    }

    /// Nothing yet of events that are cut.
    fn cut_up() -> Self {
        Self { times: 0, channels: [false; 64], stretches: Vec::new(), is_open: false, left_out: 0 }
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::Photon(channel, time) if self.is_open => {
                self.channels[channel] = true;
                self.times = self.times.max(time + 1);
            }
            Event::Photon(..) => self.left_out += 1,
            Event::Markers(_) | Event::Other => {}
        }
    }

    /// Ends the last histogram before the event `next`.
    fn end(&mut self, all: &Events, next: u64) {
        if let Some(last) = self.stretches.last_mut().filter(|_| self.is_open) {
            last.events.count = next - (last.events.byte_offset - all.byte_offset) / WORD_BYTES;
        }
        self.is_open = false;
    }

    /// Ends the last histogram before the event `next`, and begins another, the time being what `clock` says.
    fn cut(&mut self, all: &Events, next: u64, clock: Clock) {
        self.end(all, next);
        let events = Events { byte_offset: all.byte_offset + next * WORD_BYTES, count: all.count - next, ..*all };
        self.stretches.push(Stretch { events, clock });
        self.is_open = true;
    }
}

/// Units of the time base in a bin.
fn per_bin(times: u64, unit_s: f64, is_t2: bool, description: &Description) -> Result<u64, FormatError> {
    let least = times.div_ceil(MOST_BINS).max(1);
    let Some(bin_ps) = description.bin_ps else {
        return Ok(if is_t2 { least.next_power_of_two() } else { 1 });
    };
    let unit_ps = unit_s * 1e12;
    let units = (bin_ps / unit_ps).round();
    if units < 1.0 || (bin_ps / unit_ps - units).abs() > WHOLE_UNITS * units {
        let (below, above) = ((bin_ps / unit_ps).floor().max(1.0) * unit_ps, (bin_ps / unit_ps).ceil() * unit_ps);
        let problem = format!("= {bin_ps} is no whole number of the file's {unit_ps} ps; give {below} or {above}");
        return Err(Key::Bin.refuse(problem).into());
    }
    if (units as u64) < least {
        let (bins, wider) = (times.div_ceil(units as u64), least as f64 * unit_ps);
        let problem = format!("= {bin_ps} makes {bins} bins, more than {MOST_BINS}; give {wider} or more");
        return Err(Key::Bin.refuse(problem).into());
    }
    Ok(units as u64)
}

/// Events from one marker to the next, with the time as it is at the first.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    events: Events,
    clock: Clock,
}

impl Stretch {
    /// Passes on each event, with its number and the time after it.
    fn each(
        &self,
        file: &mut dyn ReadSeek,
        mut take: impl FnMut(u64, &Clock, Event) -> io::Result<()>,
    ) -> io::Result<()> {
        let length = self.events.count * WORD_BYTES;
        let mut piece = vec![0; PIECE_BYTES.min(length) as usize];
        file.seek(SeekFrom::Start(self.events.byte_offset))?;
        let (mut clock, mut number, mut done) = (self.clock, 0, 0);
        while done < length {
            let piece = &mut piece[..PIECE_BYTES.min(length - done) as usize];
            file.read_exact(piece)?;
            for word in piece.chunks_exact(WORD_BYTES as usize) {
                let event = clock.event(u32::from_le_bytes(word.try_into().expect("chunks of four")))?;
                take(number, &clock, event)?;
                number += 1;
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
    stretch: Stretch,
    channel: usize,
    bins: usize,
    /// Units of the time base in a bin.
    per_bin: u64,
}

impl Unpack for Histogram {
    fn unpack(
        &self,
        file: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()> {
        let mut counts = vec![0_u32; self.bins];
        self.stretch.each(file, |_, _, event| {
            let Event::Photon(channel, time) = event else { return Ok(()) };
            if channel != self.channel {
                return Ok(());
            }
            let count =
                counts.get_mut((time / self.per_bin) as usize).and_then(|count| Some((count.checked_add(1)?, count)));
            let (next, count) = count.ok_or_else(|| io::Error::other("more photons, or later ones, than at first"))?;
            *count = next;
            Ok(())
        })?;
        let bytes: Vec<u8> = counts.iter().flat_map(|count| count.to_le_bytes()).collect();
        take(&bytes).map(|_| ())
    }
}

/// Photons of one channel that were counted when the file was opened: a few bytes, next to all the events.
#[derive(Debug)]
struct Counted(Vec<u8>);

impl Unpack for Counted {
    fn unpack(
        &self,
        _: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()> {
        take(&self.0).map(|_| ())
    }
}

#[cfg(test)]
mod tests;
