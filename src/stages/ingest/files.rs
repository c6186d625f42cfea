//! The files of one item: sequential reads, hashed on the way, codes handed on as they lie in the file.

use std::fs::{File, Metadata};
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

use arrow::buffer::Buffer;

use super::survey::{Capture, Item, Surveyed};
use crate::formats::{self, FormatError};
use crate::signal::codes::Codes as Samples;
use crate::stages::stage::Rejection;
use crate::tables::{Codes, Name, Trace};
use crate::waveform::{CodeType, Payload, Record};

/// An item of a capture that is to be read.
pub struct Job<'a> {
    pub capture: &'a Capture,
    pub item: &'a Item,
    /// Number of the item's first exposure within its capture, where the files do not say.
    pub first_shot: i32,
}

/// A file that was hashed: its name, its digest, and its size and times from before it was read.
pub struct Hashed {
    pub file: PathBuf,
    pub digest: blake3::Hash,
    pub metadata: Metadata,
}

/// Why an item is set aside.
pub struct Bad {
    file: PathBuf,
    byte_offset: Option<i64>,
    reason: String,
}

impl Bad {
    pub fn rejection(self, surveyed: &Surveyed<'_>, job: &Job<'_>) -> Rejection {
        Rejection {
            campaign: surveyed.campaigns[job.capture.campaign].name.as_str().into(),
            file: Some(text(&self.file)),
            segment: None,
            byte_offset: self.byte_offset,
            reason: self.reason,
        }
    }
}

fn text(file: &Path) -> Name {
    file.to_string_lossy().as_ref().into()
}

/// A raw file: whole in memory, or read in pieces; hashed as it is read in order.
struct RawFile {
    name: PathBuf,
    /// The same, as the rows have it.
    text: Name,
    memory: Option<Buffer>,
    file: Option<File>,
    metadata: Metadata,
    hasher: Option<blake3::Hasher>,
    hashed: u64,
    records: Vec<Record>,
}

impl RawFile {
    fn open(surveyed: &Surveyed<'_>, campaign: usize, name: &Path, whole: bool) -> Result<Self, Bad> {
        let path = surveyed.campaigns[campaign].path_of(name);
        let io = |error: io::Error| Bad { file: name.to_owned(), byte_offset: None, reason: error.to_string() };
        let format = |error: FormatError| Bad {
            file: name.to_owned(),
            byte_offset: error.byte_offset().map(|at| at as i64),
            reason: error.to_string(),
        };
        let known = surveyed.known(campaign, name).is_some();
        let hasher = (!known).then(blake3::Hasher::new);
        let metadata = std::fs::metadata(&path).map_err(io)?;
        if whole {
            let bytes = std::fs::read(&path).map_err(io)?;
            let length = bytes.len() as u64;
            let mut source = formats::Source::new(Cursor::new(bytes), &path).map_err(format)?;
            let records = formats::records(&mut source);
            let memory = Buffer::from_vec(source.into_inner().into_inner());
            let hasher = hasher.map(|mut hasher| {
                hasher.update(&memory);
                hasher
            });
            let records = records.map_err(format)?;
            return Ok(Self {
                name: name.to_owned(),
                text: text(name),
                memory: Some(memory),
                file: None,
                metadata,
                hasher,
                hashed: length,
                records,
            });
        }
        let mut source = formats::open(&path).map_err(format)?;
        let records = formats::records(&mut source).map_err(format)?;
        let file = File::open(&path).map_err(io)?;
        Ok(Self {
            name: name.to_owned(),
            text: text(name),
            memory: None,
            file: Some(file),
            metadata,
            hasher,
            hashed: 0,
            records,
        })
    }

    /// The bytes of a stretch of the file.
    fn span(&mut self, range: Range<u64>) -> Result<Buffer, Bad> {
        if let Some(memory) = &self.memory {
            return Ok(memory.slice_with_length(range.start as usize, (range.end - range.start) as usize));
        }
        if self.hasher.is_some() && range.start > self.hashed {
            self.hash_to(range.start)?;
        }
        let mut bytes = vec![0; (range.end - range.start) as usize];
        let file = self.file.as_mut().expect("a file that is not in memory is open");
        let read = file.seek(SeekFrom::Start(range.start)).and_then(|_| file.read_exact(&mut bytes));
        read.map_err(|error| Bad {
            file: self.name.clone(),
            byte_offset: Some(range.start as i64),
            reason: error.to_string(),
        })?;
        if let Some(hasher) = self.hasher.as_mut().filter(|_| range.start <= self.hashed && range.end > self.hashed) {
            hasher.update(&bytes[(self.hashed - range.start) as usize..]);
            self.hashed = range.end;
        }
        Ok(Buffer::from_vec(bytes))
    }

    /// Hashes on to a place in the file.
    fn hash_to(&mut self, end: u64) -> Result<(), Bad> {
        while self.hashed < end {
            let next = end.min(self.hashed + (1 << 20));
            self.span(self.hashed..next)?;
        }
        Ok(())
    }

    fn digest(&mut self) -> Result<Option<Hashed>, Bad> {
        if self.hasher.is_some() {
            self.hash_to(self.metadata.len())?;
        }
        let hashed = |hasher: &blake3::Hasher| Hashed {
            file: self.name.clone(),
            digest: hasher.finalize(),
            metadata: self.metadata.clone(),
        };
        Ok(self.hasher.as_ref().map(hashed))
    }
}

/// The files of an item: signal, and reference if it has one.
pub struct Files {
    signal: RawFile,
    signal_records: Vec<(usize, i32)>,
    reference: Option<RawFile>,
    /// Records of the reference channel, in the same order of exposures; in the signal's own file when `reference` is none.
    reference_records: Option<Vec<usize>>,
}

impl Files {
    pub fn open(surveyed: &Surveyed<'_>, job: &Job<'_>, whole: bool) -> Result<Self, Bad> {
        let exposure = &job.item.exposure;
        let campaign = job.capture.campaign;
        let signal = RawFile::open(surveyed, campaign, &exposure.file, whole)?;
        let bad = |reason: String| Bad { file: exposure.file.clone(), byte_offset: None, reason };
        let signal_records = match &job.item.records {
            Some(records) => records.clone(),
            None => numbered(
                &select(&signal.records, exposure.channel.as_deref(), exposure.segment).map_err(bad)?,
                exposure.shot,
            ),
        };
        let mut files = Self { signal, signal_records, reference: None, reference_records: None };
        let Some(reference) = &exposure.reference else {
            return Ok(files);
        };
        let records = if reference.file == exposure.file {
            select(&files.signal.records, reference.channel.as_deref(), exposure.segment).map_err(bad)?
        } else {
            let file = RawFile::open(surveyed, campaign, &reference.file, whole)?;
            let bad = |reason: String| Bad { file: reference.file.clone(), byte_offset: None, reason };
            let records = select(&file.records, reference.channel.as_deref(), exposure.segment).map_err(bad)?;
            files.reference = Some(file);
            records
        };
        if records.len() != files.signal_records.len() {
            return Err(bad(format!(
                "{} exposures, but its reference has {}; capture both channels together",
                files.signal_records.len(),
                records.len()
            )));
        }
        files.reference_records = Some(records);
        Ok(files)
    }

    pub fn exposures(&self) -> usize {
        self.signal_records.len()
    }

    /// Bytes of one exposure, all channels.
    pub fn exposure_bytes(&self) -> usize {
        let bytes = |record: &Record| record.head.samples * record.head.code_type.bytes();
        let channels = 1 + usize::from(self.reference_records.is_some());
        self.signal.records.first().map_or(0, bytes) * channels
    }

    pub fn digests(&mut self) -> Result<Vec<Hashed>, Bad> {
        let mut digests = Vec::new();
        digests.extend(self.signal.digest()?);
        if let Some(reference) = &mut self.reference {
            digests.extend(reference.digest()?);
        }
        Ok(digests)
    }

    /// Rows of a range of exposures: for each its reference, then its signal.
    pub fn rows(&mut self, surveyed: &Surveyed<'_>, job: &Job<'_>, exposures: Range<usize>) -> Result<Vec<Trace>, Bad> {
        let template = Template::new(surveyed, job);
        let signal: Vec<usize> = self.signal_records[exposures.clone()].iter().map(|(record, _)| *record).collect();
        let signal_codes = codes(&mut self.signal, &signal)?;
        let reference_codes = match &self.reference_records {
            None => None,
            Some(records) => {
                Some(codes(self.reference.as_mut().unwrap_or(&mut self.signal), &records[exposures.clone()])?)
            }
        };
        let mut rows = Vec::with_capacity(2 * exposures.len());
        for (i, exposure) in exposures.enumerate() {
            let (record, shot) = self.signal_records[exposure];
            if let (Some(codes), Some(records)) = (&reference_codes, &self.reference_records) {
                let file = self.reference.as_ref().unwrap_or(&self.signal);
                rows.push(template.row(file, records[exposure], shot + job.first_shot, true, &codes[i])?);
            }
            rows.push(template.row(&self.signal, record, shot + job.first_shot, false, &signal_codes[i])?);
        }
        Ok(rows)
    }
}

/// Records of one channel (the only one, where none is named), or of one segment of it.
fn select(records: &[Record], channel: Option<&str>, segment: Option<u32>) -> Result<Vec<usize>, String> {
    let mut channels: Vec<&str> = records.iter().filter_map(|record| record.head.channel.as_deref()).collect();
    channels.sort_unstable();
    channels.dedup();
    if let Some(channel) = channel.filter(|channel| !channels.is_empty() && !channels.contains(channel)) {
        return Err(format!("has no channel `{channel}`; it has {}", channels.join(", ")));
    }
    if channel.is_none() && channels.len() > 1 {
        return Err(format!(
            "holds channels {}; say which with `channel = \"...\"` in its [[captures]] rule",
            channels.join(", ")
        ));
    }
    let wanted = |record: &Record| {
        let named = channel.is_none() || record.head.channel.is_none() || record.head.channel.as_deref() == channel;
        named && (segment.is_none() || record.segment == segment)
    };
    let found: Vec<usize> = (0..records.len()).filter(|&i| wanted(&records[i])).collect();
    match segment {
        Some(segment) if found.is_empty() => Err(format!("has no segment {segment}")),
        _ => Ok(found),
    }
}

/// Records with their shots: the segment's number, or the shot that the rule gives.
fn numbered(records: &[usize], shot: Option<u32>) -> Vec<(usize, i32)> {
    let first = shot.unwrap_or(0) as i32;
    records.iter().enumerate().map(|(i, &record)| (record, first + i as i32)).collect()
}

/// Codes of records, little-endian. Records that lie one behind the other share one read and one block.
fn codes(file: &mut RawFile, records: &[usize]) -> Result<Vec<Codes>, Bad> {
    let mut codes = Vec::with_capacity(records.len());
    let mut start = 0;
    while start < records.len() {
        let record = &file.records[records[start]];
        let length = (record.head.samples * record.head.code_type.bytes()) as u64;
        let Payload::File { byte_offset, big_endian } = record.payload else {
            let Payload::Decoded(bytes) = &record.payload else {
                unreachable!("a payload lies in the file or is decoded")
            };
            let block = Buffer::from(&**bytes);
            codes.push(Codes::new(&block, 0, block.len()));
            start += 1;
            continue;
        };
        let code_type = record.head.code_type;
        let mut end = start + 1;
        while end < records.len()
            && matches!(file.records[records[end]].payload, Payload::File { byte_offset: next, .. } if next == byte_offset + (end - start) as u64 * length)
        {
            end += 1;
        }
        let count = (end - start) as u64;
        let mut block = file.span(byte_offset..byte_offset + count * length)?;
        if big_endian {
            let mut bytes = block.to_vec();
            code_type.swap_bytes(&mut bytes);
            block = Buffer::from_vec(bytes);
        }
        codes.extend((0..count).map(|i| Codes::new(&block, (i * length) as usize, length as usize)));
        start = end;
    }
    Ok(codes)
}

/// What all rows of an item share.
struct Template<'a> {
    job: &'a Job<'a>,
    campaign: Name,
    sensor: Name,
    role: Name,
    run: Option<Name>,
    range: Option<Name>,
    /// Names of code types, in their order.
    code_types: [Name; CodeType::ALL.len()],
}

impl<'a> Template<'a> {
    fn new(surveyed: &Surveyed<'_>, job: &'a Job<'a>) -> Self {
        Self {
            job,
            campaign: surveyed.campaigns[job.capture.campaign].name.as_str().into(),
            sensor: job.capture.sensor.as_str().into(),
            role: job.capture.role.name().into(),
            run: job.capture.run.as_deref().map(Into::into),
            range: job.item.exposure.range.as_deref().map(Into::into),
            code_types: CodeType::ALL.map(|code_type| code_type.name().into()),
        }
    }

    fn row(&self, file: &RawFile, record: usize, shot: i32, is_reference: bool, codes: &Codes) -> Result<Trace, Bad> {
        let (name, record) = (&file.name, &file.records[record]);
        let (head, keys) = (&record.head, &self.job.item.exposure.keys);
        let missing = |what: &str, key: &str| Bad {
            file: name.to_owned(),
            byte_offset: None,
            reason: format!("has no {what}; give {key} in its [[captures]] rule"),
        };
        if head.unit.as_deref().is_some_and(|unit| unit != "V") {
            let unit = head.unit.as_deref().unwrap_or_default();
            return Err(Bad {
                file: name.to_owned(),
                byte_offset: None,
                reason: format!("is in {unit}, not volts over time"),
            });
        }
        let dt_ps = keys.dt_ps.or(head.dt_s.map(|dt_s| dt_s * 1e12)).ok_or_else(|| missing("time base", "dt_ps"))?;
        let t0_ps =
            keys.t0_ps.or(record.t0_s.map(|t0_s| t0_s * 1e12)).ok_or_else(|| missing("time of sample 0", "t0_ps"))?;
        let gain_v = keys.gain_v.or(head.scale.map(|scale| scale.gain)).ok_or_else(|| missing("scale", "gain_v"))?;
        let offset_v = keys.offset_v.or(head.scale.map(|scale| scale.offset)).unwrap_or(0.0);
        let [first, last] = keys.samples.unwrap_or([0, head.samples as u64]);
        if first >= last || last > head.samples as u64 {
            let reason = format!(
                "has {} samples; samples = [{first}, {last}] in its [[captures]] rule is not among them",
                head.samples
            );
            return Err(Bad { file: name.to_owned(), byte_offset: None, reason });
        }
        let width = head.code_type.bytes();
        let codes = codes.slice(first as usize * width, (last - first) as usize * width);
        let samples = Samples::of(head.code_type.name(), &codes).expect("code types have one name everywhere");
        let clipped = head.rails.map(|(low, high)| samples.count_at_or_beyond(low, high) as i32);
        Ok(Trace {
            campaign: self.campaign.clone(),
            sensor: self.sensor.clone(),
            lit: self.job.capture.lit,
            seen: self.job.capture.seen,
            role: self.role.clone(),
            run: self.run.clone(),
            range: self.range.clone(),
            shot,
            channel: head.channel.as_deref().map(Into::into),
            is_reference,
            file: file.text.clone(),
            segment: record.segment.map(|segment| segment as i32),
            t0_ps: t0_ps + first as f64 * dt_ps,
            dt_ps,
            samples: (last - first) as i32,
            code_type: self.code_types[head.code_type as usize].clone(),
            gain_v,
            offset_v,
            codes,
            acquired_at: head.acquired_at.as_deref().map(Into::into),
            clipped,
            averaged_shots: keys.averaged_shots.unwrap_or(1) as i32,
            path_m: keys.path_m,
            path_sd_m: keys.path_sd_m,
            attenuation_od: keys.attenuation_od,
            power_w: keys.power_w,
            bounces: keys.bounces.map(|bounces| bounces as i32),
        })
    }
}
