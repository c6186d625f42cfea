//! The files of one item: which of their records are its exposures, and their rows.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use super::raw_file::{Bad, Hashed, HashedStretch, RawFile, Reading};
use super::survey::{Job, Surveyed};
use super::template::{Content, Template};
use crate::tables::traces::Records;
use crate::tables::{Codes, Trace};
use crate::waveform::{Head, Kind, Record};

/// The files of an item: signal, and reference if it has one.
pub struct Files {
    signal: RawFile,
    signal_index: Index,
    signal_records: Vec<(usize, i32)>,
    reference: Option<RawFile>,
    /// Of the reference's own file.
    reference_index: Option<Index>,
    /// Records of the reference channel, in the same order of exposures; in the signal's own file when `reference` is
    /// none.
    reference_records: Option<Vec<usize>>,
}

impl Files {
    pub fn open(surveyed: &Surveyed<'_>, job: &Job<'_>, reading: Reading<'_>) -> Result<Self, Bad> {
        let exposure = &job.item.exposure;
        let signal = RawFile::open(surveyed, job, &exposure.file, reading)?;
        let reference = exposure.reference.as_ref().filter(|reference| reference.file != exposure.file);
        let reference =
            reference.map(|reference| RawFile::open(surveyed, job, &reference.file, reading)).transpose()?;
        let mut files = Self {
            signal_index: Index::new(&signal.records),
            reference_index: reference.as_ref().map(|reference| Index::new(&reference.records)),
            signal,
            signal_records: Vec::new(),
            reference,
            reference_records: None,
        };
        files.turn_to(job)?;
        Ok(files)
    }

    /// Turns to another item of the same files.
    pub fn turn_to(&mut self, job: &Job<'_>) -> Result<(), Bad> {
        let exposure = &job.item.exposure;
        let segment = exposure.segment.map(|segment| segment as i32);
        let bad = |reason: String| Bad {
            file: exposure.file.clone(),
            segment,
            byte_offset: None,
            reason,
            is_unreadable: false,
        };
        self.signal_records = match &job.item.records {
            Some(records) => records.clone(),
            None => numbered(
                &self
                    .signal_index
                    .select(&self.signal.records, exposure.channel.as_deref(), exposure.segment)
                    .map_err(bad)?,
                exposure.shot,
            ),
        };
        let Some(reference) = &exposure.reference else {
            self.reference_records = None;
            return Ok(());
        };
        let of_file = &self.reference.as_ref().unwrap_or(&self.signal).records;
        let index = self.reference_index.as_ref().unwrap_or(&self.signal_index);
        let bad_reference = |reason: String| Bad { file: reference.file.clone(), ..bad(reason) };
        let mut records =
            index.select(of_file, reference.channel.as_deref(), exposure.segment).map_err(bad_reference)?;
        if self.signal.is_cut() || self.reference.as_ref().is_some_and(RawFile::is_cut) {
            // Exposures that only one of the two files still holds have no partner.
            let whole = records.len().min(self.signal_records.len());
            records.truncate(whole);
            self.signal_records.truncate(whole);
        }
        if records.len() != self.signal_records.len() {
            return Err(bad(format!(
                "{} exposures, but its reference has {}; capture both channels together",
                self.signal_records.len(),
                records.len()
            )));
        }
        self.reference_records = Some(records);
        Ok(())
    }

    pub fn exposures(&self) -> usize {
        self.signal_records.len()
    }

    /// Bytes of one exposure, all channels; of the samples that count.
    pub fn exposure_bytes(&self, job: &Job<'_>) -> usize {
        let counted = job.item.exposure.keys.samples.map(|[first, last]| last.saturating_sub(first) as usize);
        let bytes = |record: &Record| {
            let samples = counted.map_or(record.head.samples, |counted| counted.min(record.head.samples));
            samples * record.head.code_type.bytes()
        };
        let channels = 1 + usize::from(self.reference_records.is_some());
        self.signal.records.first().map_or(0, bytes) * channels
    }

    pub fn digests(&mut self) -> Result<Vec<Hashed>, Bad> {
        let mut digests = Vec::new();
        digests.extend(self.signal.digests()?);
        if let Some(reference) = &mut self.reference {
            digests.extend(reference.digests()?);
        }
        Ok(digests)
    }

    /// Stretches of the files, where they were read so.
    pub fn stretches(self) -> Result<Vec<HashedStretch>, Bad> {
        let stretches = [Some(self.signal), self.reference].into_iter().flatten().map(RawFile::stretch);
        Ok(stretches.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
    }

    /// What is to be said about the files. Of a file that several items share, the item with its first exposure says
    /// it.
    pub fn remarks(&self) -> Vec<Bad> {
        let mut remarks = Vec::new();
        let files = [Some(&self.signal), self.reference.as_ref()];
        let first = self.signal_records.iter().map(|(record, _)| *record).min();
        for file in files.into_iter().flatten() {
            let is_first = |first: usize| Index::is_first(&file.records, first);
            if file.has_remarks() && first.is_some_and(is_first) {
                remarks.extend(file.remarks());
            }
        }
        remarks
    }

    /// The records of all files.
    pub fn records(&self) -> impl Iterator<Item = &Record> {
        self.signal.records.iter().chain(self.reference.iter().flat_map(|reference| &reference.records))
    }

    /// For each file: its name, its bytes, and where an exposure begins.
    pub fn places(&self, exposure: usize) -> Vec<(&PathBuf, u64, u64)> {
        let (length, at) = self.signal.place(self.signal_records[exposure].0);
        let mut places = vec![(&self.signal.name, length, at)];
        if let (Some(reference), Some(records)) = (&self.reference, &self.reference_records) {
            let (length, at) = reference.place(records[exposure]);
            places.push((&reference.name, length, at));
        }
        places
    }

    /// Rows of a range of exposures: for each its reference, then its signal.
    pub fn rows(&mut self, surveyed: &Surveyed<'_>, job: &Job<'_>, exposures: Range<usize>) -> Result<Records, Bad> {
        let template = Template::new(surveyed, job);
        let samples = job.item.exposure.keys.samples;
        let signal: Vec<usize> = self.signal_records[exposures.clone()].iter().map(|(record, _)| *record).collect();
        // Refused before the codes are read, which may be many.
        signal.iter().try_for_each(|&record| template.check(&self.signal, record))?;
        let signal_codes = self.signal.codes(&signal, samples)?;
        let reference_codes = match &self.reference_records {
            None => None,
            Some(records) => {
                let file = self.reference.as_mut().unwrap_or(&mut self.signal);
                records[exposures.clone()].iter().try_for_each(|&record| template.check(file, record))?;
                Some(file.codes(&records[exposures.clone()], samples)?)
            }
        };
        let signal_codes = signal_codes.into_iter();
        let mut contents: Vec<Content> = match reference_codes {
            None => signal_codes.map(Content::Codes).collect(),
            Some(codes) => {
                codes.into_iter().zip(signal_codes).flat_map(<[Codes; 2]>::from).map(Content::Codes).collect()
            }
        };
        self.rows_of(surveyed, job, exposures, &mut contents.drain(..))
    }

    /// The same without a look at the samples; `contents` has what there is of them, row by row.
    pub fn rows_of(
        &self,
        surveyed: &Surveyed<'_>,
        job: &Job<'_>,
        exposures: Range<usize>,
        contents: &mut dyn Iterator<Item = Content>,
    ) -> Result<Records, Bad> {
        let template = Template::new(surveyed, job);
        let mut next = || contents.next().expect("as many as there are rows");
        let mut rows = Rows { template, records: Records::default(), shared: [None, None] };
        for exposure in exposures {
            let (record, shot) = self.signal_records[exposure];
            let shot = shot + job.first_shot;
            if let Some(records) = &self.reference_records {
                let file = self.reference.as_ref().unwrap_or(&self.signal);
                rows.push(file, records[exposure], shot, true, next())?;
            }
            rows.push(&self.signal, record, shot, false, next())?;
        }
        Ok(rows.records)
    }
}

/// Rows under way.
struct Rows<'a> {
    template: Template<'a>,
    records: Records,
    /// Of signal and reference: the head of the last record, and what its records share.
    shared: [Option<(Arc<Head>, usize, Trace)>; 2],
}

impl Rows<'_> {
    fn push(
        &mut self,
        file: &RawFile,
        record: usize,
        shot: i32,
        is_reference: bool,
        content: Content,
    ) -> Result<(), Bad> {
        let last = &mut self.shared[usize::from(is_reference)];
        let head = &file.records[record].head;
        if last.as_ref().is_none_or(|(last_head, ..)| !Arc::ptr_eq(last_head, head)) {
            let row = self.template.shared(file, record, is_reference)?;
            let shared = self.records.share(row.clone(), file.file_of_codes(record));
            *last = Some((Arc::clone(head), shared, row));
        }
        let (_, shared, row) = last.as_ref().expect("put there if it was not");
        self.records.push(self.template.own(file, record, shot, (*shared, row), content)?);
        Ok(())
    }
}

/// Which records of a file are of which channel and segment. Made once: a file may hold as many segments as captures.
struct Index {
    /// Names of channels, in order.
    channels: Vec<String>,
    /// Segments with their records, in order of both.
    segments: Vec<(u32, usize)>,
}

impl Index {
    fn new(records: &[Record]) -> Self {
        let mut channels: Vec<&str> = records.iter().filter_map(|record| record.head.channel.as_deref()).collect();
        channels.sort_unstable();
        channels.dedup();
        let segment = |(i, record): (usize, &Record)| record.segment.map(|segment| (segment, i));
        let mut segments: Vec<(u32, usize)> = records.iter().enumerate().filter_map(segment).collect();
        segments.sort_unstable();
        Self { channels: channels.into_iter().map(str::to_owned).collect(), segments }
    }

    /// Whether no record of the same channel comes before this one.
    fn is_first(records: &[Record], number: usize) -> bool {
        let channel = records.get(number).map(|record| &record.head.channel);
        !records[..number.min(records.len())].iter().any(|record| Some(&record.head.channel) == channel)
    }

    /// Records of one channel (the only one, where none is named), or of one segment of it.
    fn select(&self, records: &[Record], channel: Option<&str>, segment: Option<u32>) -> Result<Vec<usize>, String> {
        let has = |channel: &&str| self.channels.iter().any(|other| other == channel);
        if let Some(channel) = channel.filter(|channel| !self.channels.is_empty() && !has(channel)) {
            return Err(format!(
                "has no channel `{channel}`; it has {}: correct `channel` or `reference` in its [[captures]] rule",
                self.channels.join(", ")
            ));
        }
        if channel.is_none() && self.channels.len() > 1 {
            return Err(format!(
                "holds channels {}; say which with `channel = \"...\"` in its [[captures]] rule",
                self.channels.join(", ")
            ));
        }
        let wanted = |&i: &usize| {
            let of = records[i].head.channel.as_deref();
            channel.is_none() || of.is_none() || of == channel
        };
        let mut selection: Vec<usize> = match segment {
            Some(segment) => {
                let from = self.segments.partition_point(|(other, _)| *other < segment);
                let of_segment = self.segments[from..].iter().take_while(|(other, _)| *other == segment);
                of_segment.map(|(_, i)| *i).filter(wanted).collect()
            }
            None => (0..records.len()).filter(wanted).collect(),
        };
        // Next to exposures, an average is the instrument's own of them (a summary frame), and no exposure.
        if selection.iter().any(|&i| records[i].head.kind == Kind::Waveform) {
            selection.retain(|&i| records[i].head.kind != Kind::Average);
        }
        match segment {
            Some(segment) if selection.is_empty() => Err(format!("has no segment {segment}")),
            _ => Ok(selection),
        }
    }
}

/// Records with their shots: the segment's number, or the shot that the rule gives.
fn numbered(records: &[usize], shot: Option<u32>) -> Vec<(usize, i32)> {
    let first = shot.unwrap_or(0) as i32;
    records.iter().enumerate().map(|(i, &record)| (record, first + i as i32)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::waveform::{CodeType, Payload};

    fn record(channel: Option<&str>, kind: Kind, segment: u32) -> Record {
        let head = Head::new("tek-wfm", CodeType::I8, 4);
        Record {
            head: Arc::new(Head { kind, channel: channel.map(Into::into), ..head }),
            segment: Some(segment),
            t0_s: None,
            trigger_s: None,
            payload: Payload::Decoded([0; 4].as_slice().into()),
        }
    }

    fn select(records: &[Record], channel: Option<&str>, segment: Option<u32>) -> Result<Vec<usize>, String> {
        Index::new(records).select(records, channel, segment)
    }

    #[test]
    fn an_average_beside_its_exposures_is_none_of_them() {
        let record = |kind: Kind, segment: u32| record(None, kind, segment);
        let frames = [record(Kind::Waveform, 0), record(Kind::Waveform, 1), record(Kind::Average, 2)];
        assert_eq!(select(&frames, None, None).unwrap(), [0, 1]);
        assert_eq!(select(&frames[2..], None, None).unwrap(), [0], "alone, it is the exposure");
    }

    /// Segments in no order, two channels, one summary: as a look through all records has it.
    #[test]
    fn records_of_a_segment_are_those_that_a_look_through_all_gives() {
        let of = |n: u32| {
            let (segment, channel) = (n * 7 % 30 / 2, if n.is_multiple_of(3) { "C2" } else { "C1" });
            record(Some(channel), if n == 4 { Kind::Average } else { Kind::Waveform }, segment)
        };
        let records: Vec<Record> = (0..30).map(of).collect();
        for channel in ["C1", "C2"] {
            for segment in 0..16 {
                let is_wanted = |i: &usize| {
                    records[*i].segment == Some(segment) && records[*i].head.channel.as_deref() == Some(channel)
                };
                let mut all: Vec<usize> = (0..records.len()).filter(is_wanted).collect();
                if all.iter().any(|&i| records[i].head.kind == Kind::Waveform) {
                    all.retain(|&i| records[i].head.kind == Kind::Waveform);
                }
                let selection = select(&records, Some(channel), Some(segment));
                assert_eq!(selection.unwrap_or_default(), all, "{channel}, segment {segment}");
            }
        }
        assert!(select(&records, Some("C1"), Some(99)).unwrap_err().contains("no segment 99"));
        assert!(select(&records, Some("C3"), None).unwrap_err().contains("C1, C2"));
        assert!(select(&records, None, None).unwrap_err().contains("say which"));
    }
}
