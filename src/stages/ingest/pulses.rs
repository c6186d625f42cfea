//! `ingest_pulses`: lidar files to `pulses`, one row a laser pulse and channel.
//!
//! Takes the campaign folder: PulseWaves and LAS files that its rules of role `scene` match; writes `pulses`. A row has
//! the beam of its pulse, all stretches of returning light, and the outgoing pulse where the file has it. Files are
//! hashed and held against records as `ingest` does. A file that cannot be decoded is a row in `rejects`.
//!
//! ```toml
//! [pulses]
//! stage = "ingest_pulses"
//! ```

use std::path::Path;

use arrow_buffer::Buffer;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::part::{Reader, content, digests_of_bad};
use super::raw_file::{Bad, RawFile, Reading};
use super::survey::{Job, Surveyed, chain};
use crate::campaign::{Campaign, LeftOut, Role};
use crate::formats::{self, lidar};
use crate::stages::operator::WrittenTable;
use crate::stages::source::{Feed, OpenSource, PartRead, Source, SourcePart, Ticket};
use crate::stages::stage::StageError;
use crate::store::finite::{self, NotJson};
use crate::tables::{Codes, Name, Pulse, Row};
use crate::waveform::Record;

/// Bytes of a row next to its codes, for batches within the memory budget.
const ROW_BYTES: usize = 256;
const PS: f64 = 1e12;

/// Parameters of `ingest_pulses`: none.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IngestPulses {}

impl Source for IngestPulses {
    fn kind(&self) -> &'static str {
        "ingest_pulses"
    }
    fn version(&self) -> u32 {
        1
    }
    fn params(&self) -> Result<Value, NotJson> {
        finite::to_json(self)
    }
    fn fields(&self, _: &[Campaign]) -> Result<Value, NotJson> {
        // As for `ingest`: each part's content names its campaign and files.
        Ok(Value::Null)
    }
    fn table(&self) -> WrittenTable {
        WrittenTable { name: Pulse::TABLE.to_owned(), schema: Pulse::schema() }
    }
    fn open<'a>(&'a self, campaigns: &'a [Campaign], notes: &Path) -> Result<Box<dyn OpenSource + 'a>, StageError> {
        Ok(Box::new(Flights(Surveyed::new(campaigns, &[Role::Scene], None, notes)?)))
    }
    fn take_up<'a>(
        &'a self,
        campaigns: &'a [Campaign],
        notes: &Path,
        tickets: &[Ticket],
    ) -> Result<Box<dyn OpenSource + 'a>, StageError> {
        Ok(Box::new(Flights(Surveyed::take_up(campaigns, notes, tickets)?)))
    }
}

/// The campaigns, surveyed, whose files are read pulse by pulse.
struct Flights<'a>(Surveyed<'a>);

impl OpenSource for Flights<'_> {
    fn parts(&self) -> &[SourcePart] {
        &self.0.source_parts
    }
    fn left_out(&self) -> &[LeftOut] {
        &self.0.left_out
    }
    fn ticket(&self, part: usize) -> Option<Ticket> {
        Some(self.0.give(part))
    }

    fn read(&self, part: usize, batch_bytes: usize, feed: &dyn Feed) -> Result<PartRead, StageError> {
        let captures = &self.0.parts[part];
        let mut reader = Reader::new(&self.0, batch_bytes, feed);
        for capture in captures {
            for item in &capture.items {
                let job = Job { capture, item, first_shot: 0 };
                let read = Run::open(&self.0, &job, batch_bytes)
                    .map(|mut run| run.send(batch_bytes, feed).map(|sent| (run, sent)));
                let (digests, rejection) = match read {
                    Ok(read) => {
                        let (mut run, sent) = read?;
                        for remark in run.file.remarks() {
                            reader.rejections.push(remark.rejection(&self.0, &job)?);
                        }
                        match run.file.digests() {
                            Ok(digests) => (digests, sent.err()),
                            Err(bad) => (digests_of_bad(&self.0, &job), Some(bad)),
                        }
                    }
                    Err(bad) => (digests_of_bad(&self.0, &job), Some(bad)),
                };
                reader.note(capture.campaign, digests)?;
                if let Some(bad) = rejection {
                    reader.rejections.push(bad.rejection(&self.0, &job)?);
                }
                feed.read_bytes(item.bytes);
            }
        }
        Ok(PartRead { content: content(&self.0, captures, reader.digests)?, rejections: reader.rejections })
    }

    fn close(&self) -> Result<(), StageError> {
        self.0.campaigns.iter().zip(&self.0.records).try_for_each(|(campaign, record)| {
            record.save().map_err(|error| StageError::Refused(chain(&campaign.root, &error)))
        })
    }
}

/// A file and its pulses.
struct Run {
    file: RawFile,
    pulses: Vec<lidar::Pulse>,
    campaign: Name,
    sensor: Name,
}

impl Run {
    fn open(surveyed: &Surveyed<'_>, job: &Job<'_>, batch_bytes: usize) -> Result<Self, Bad> {
        let name = &job.item.exposure.file;
        let campaign = &surveyed.campaigns[job.capture.campaign];
        let reading = if job.item.bytes as usize > batch_bytes { Reading::Long } else { Reading::Whole };
        let file = RawFile::open(surveyed, job, name, reading)?;
        let flight = formats::Source::open(&campaign.path_of(name)).and_then(|mut source| lidar::flight(&mut source));
        let pulses = flight.map_err(|error| match error {
            formats::FormatError::Unknown => file.bad(
                "has no beams: `ingest_pulses` reads PulseWaves and LAS files; run another pipeline, or take the file \
                 out of the [[captures]] rule",
            ),
            error => file.bad(error.to_string()),
        })?;
        let (campaign, sensor) = (campaign.name.as_str().into(), job.capture.sensor.as_str().into());
        Ok(Self { file, pulses: pulses.pulses, campaign, sensor })
    }

    /// Hands the rows on, in batches of about `batch_bytes`. The inner error is about the file.
    fn send(&mut self, batch_bytes: usize, feed: &dyn Feed) -> Result<Result<(), Bad>, StageError> {
        let mut first = 0;
        while first < self.pulses.len() {
            let bytes_of = |pulse: &lidar::Pulse| {
                let of_record = |record: &usize| self.file.records[*record].code_bytes();
                ROW_BYTES + pulse.returning.iter().chain(&pulse.outgoing).map(of_record).sum::<usize>()
            };
            let (mut end, mut bytes) = (first, 0);
            while end < self.pulses.len() && (end == first || bytes + bytes_of(&self.pulses[end]) <= batch_bytes) {
                bytes += bytes_of(&self.pulses[end]);
                end += 1;
            }
            let credit = feed.reserve(bytes)?;
            let rows: Result<Vec<Vec<Pulse>>, Bad> = (first..end).map(|number| self.rows(number)).collect();
            match rows {
                Ok(rows) => feed.send(Pulse::to_batch(&rows.concat()), credit)?,
                Err(bad) => return Ok(Err(bad)),
            }
            first = end;
        }
        Ok(Ok(()))
    }

    /// Rows of a pulse: one for each channel.
    fn rows(&mut self, number: usize) -> Result<Vec<Pulse>, Bad> {
        let pulse = self.pulses[number].clone();
        let mut channels: Vec<Option<String>> = Vec::new();
        for record in &pulse.returning {
            let channel = &self.file.records[*record].head.channel;
            if !channels.contains(channel) {
                channels.push(channel.clone());
            }
        }
        channels.iter().map(|channel| self.row(number, &pulse, channel.as_deref())).collect()
    }

    fn row(&mut self, number: usize, pulse: &lidar::Pulse, channel: Option<&str>) -> Result<Pulse, Bad> {
        let of_channel = |record: &usize| self.file.records[*record].head.channel.as_deref() == channel;
        let returning: Vec<usize> = pulse.returning.iter().copied().filter(of_channel).collect();
        let head = self.file.records[returning[0]].head.clone();
        let mut starts_ps = Vec::with_capacity(returning.len());
        for &record in &returning {
            let Record { head: other, t0_s, .. } = &self.file.records[record];
            if other.dt_s != head.dt_s || other.code_type != head.code_type || other.scale != head.scale {
                return Err(self.file.bad_record(record, "differs from other stretches of its pulse in step or codes"));
            }
            let missing = || self.file.bad_record(record, "has no time; write the file with times from the anchor");
            starts_ps.push(t0_s.ok_or_else(missing)? * PS);
        }
        let dt_ps = head.dt_s.ok_or_else(|| self.file.bad_record(returning[0], "has no step of time"))? * PS;
        let lengths = returning.iter().map(|record| self.file.records[*record].head.samples as i32).collect();
        let codes = self.file.codes(&returning, None)?;
        let outgoing = pulse.outgoing.map(|record| self.file.codes(&[record], None)).transpose()?;
        let of_outgoing = pulse.outgoing.map(|record| &self.file.records[record]);
        let [anchor_x_m, anchor_y_m, anchor_z_m] = pulse.anchor;
        let [velocity_x_m_per_ps, velocity_y_m_per_ps, velocity_z_m_per_ps] = pulse.velocity_per_s.map(|v| v / PS);
        Ok(Pulse {
            campaign: self.campaign.clone(),
            sensor: self.sensor.clone(),
            run: self.file.text.clone(),
            pulse: number as i64,
            channel: channel.unwrap_or_default().into(),
            gps_time_s: pulse.gps_time_s,
            anchor_x_m,
            anchor_y_m,
            anchor_z_m,
            velocity_x_m_per_ps,
            velocity_y_m_per_ps,
            velocity_z_m_per_ps,
            dt_ps,
            unit: head.unit.as_deref().unwrap_or("adc").into(),
            gain: head.scale.map_or(1.0, |scale| scale.gain),
            offset: head.scale.map_or(0.0, |scale| scale.offset),
            code_type: head.code_type.name().into(),
            starts_ps,
            lengths,
            codes: joined(codes),
            outgoing_type: of_outgoing.map(|record| record.head.code_type.name().into()),
            outgoing_dt_ps: of_outgoing.and_then(|record| record.head.dt_s).map(|dt_s| dt_s * PS),
            outgoing_t0_ps: of_outgoing.and_then(|record| record.t0_s).map(|t0_s| t0_s * PS),
            outgoing: outgoing.map(joined).unwrap_or_default(),
        })
    }
}

/// Codes one behind the other.
fn joined(mut codes: Vec<Codes>) -> Codes {
    if codes.len() == 1 {
        return codes.remove(0);
    }
    let bytes: Vec<u8> = codes.iter().flat_map(|codes| codes.iter().copied()).collect();
    let length = bytes.len();
    Codes::new(&Buffer::from_vec(bytes), 0, length)
}
