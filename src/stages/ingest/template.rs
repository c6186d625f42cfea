//! A row of traces: what the file says of a record, and what the campaign says instead.

use super::raw_file::{Bad, RawFile};
use super::survey::{Job, Surveyed};
use crate::campaign::keys::SensorKind;
use crate::signal::codes::Codes as Samples;
use crate::tables::traces::OwnColumns;
use crate::tables::{Codes, Name, Trace};
use crate::waveform::Kind;

/// A nominal rate may differ by this part from the step that a file rounded: a step printed with six digits is off by
/// 5e-6 at most.
const ROUNDED: f64 = 1e-5;

/// What is at hand of a record's samples that count.
pub enum Content {
    /// Their codes.
    Codes(Codes),
    /// How many of them lie at the rails, from a time when they were read.
    Clipped(Option<i32>),
}

/// What all rows of an item share.
pub struct Template<'a> {
    job: &'a Job<'a>,
    /// Whether the sensor counts photons.
    counts: bool,
    campaign: Name,
    sensor: Name,
    role: Name,
    run: Option<Name>,
    range: Option<Name>,
}

impl<'a> Template<'a> {
    pub fn new(surveyed: &Surveyed<'_>, job: &'a Job<'a>) -> Self {
        let sensor = surveyed.campaigns[job.capture.campaign].sensors.get(&job.capture.sensor);
        Self {
            job,
            counts: sensor.is_some_and(|sensor| sensor.kind == SensorKind::Counts),
            campaign: surveyed.campaigns[job.capture.campaign].name.as_str().into(),
            sensor: job.capture.sensor.as_str().into(),
            role: job.capture.role.name().into(),
            run: job.capture.run.as_deref().map(Into::into),
            range: job.item.exposure.range.as_deref().map(Into::into),
        }
    }

    /// Whether a record holds what its sensor measures.
    pub fn check(&self, file: &RawFile, record: usize) -> Result<(), Bad> {
        let head = &file.records[record].head;
        let problem = match head.kind {
            Kind::Waveform | Kind::Average => match head.unit.as_deref() {
                None | Some("V") => return Ok(()),
                Some(_) if self.job.item.exposure.keys.gain_v.is_some() => return Ok(()),
                Some(unit) => {
                    format!(
                        "is in {unit}, not in volts; if volts follow from its codes, give gain_v in its [[captures]] rule"
                    )
                }
            },
            Kind::Counts if self.counts => return Ok(()),
            Kind::Counts => {
                format!("holds photon counts; say kind = \"counts\" in [sensors.{}]", self.job.capture.sensor)
            }
            Kind::Envelope => "is an envelope or peak-detect record: extremes, not one voltage after the other; \
                acquire in sample, high-resolution or average mode"
                .to_owned(),
            Kind::Digital => "is a digital record: logic levels have no onset; name an analog channel".to_owned(),
            Kind::Spectrum => "is a spectrum: it has no times; save the trace over time".to_owned(),
            Kind::Iq => "is an IQ record of a carrier, not a voltage over time; save the analog channel".to_owned(),
        };
        Err(file.bad_record(record, problem))
    }

    /// Time between samples in ps; the same as the file has it, where the campaign says another.
    fn step(&self, file: &RawFile, record: usize) -> Result<(f64, Option<f64>), Bad> {
        let keys = &self.job.item.exposure.keys;
        let of_file = file.records[record].head.dt_s.map(|dt_s| dt_s * 1e12);
        match (keys.dt_ps, keys.nominal_rate_hz, of_file) {
            (Some(dt_ps), _, of_file) => Ok((dt_ps, of_file.filter(|of_file| *of_file != dt_ps))),
            (None, None, Some(of_file)) => Ok((of_file, None)),
            (None, _, None) if file.records[record].head.format == "csv" => {
                let keys = "time_unit, such as \"ns\", or dt_ps and t0_ps,";
                Err(missing(file, record, "column of times with a unit", keys))
            }
            (None, _, None) => Err(missing(file, record, "time base", "dt_ps")),
            (None, Some(rate_hz), Some(of_file)) => {
                let dt_ps = 1e12 / rate_hz;
                if (dt_ps - of_file).abs() > ROUNDED * of_file {
                    return Err(file.bad_record(record, format!(
                        "has {of_file} ps between samples, which is no rounded {dt_ps} ps; nominal_rate_hz = {rate_hz} in its \
                         [[captures]] rule is another rate (dt_ps would overrule the file)"
                    )));
                }
                Ok((dt_ps, Some(of_file)))
            }
        }
    }

    /// The row that all records of the head of this one share.
    pub fn shared(&self, file: &RawFile, record: usize, is_reference: bool) -> Result<Trace, Bad> {
        let (head, keys) = (&file.records[record].head, &self.job.item.exposure.keys);
        let (dt_ps, file_dt_ps) = self.step(file, record)?;
        let gain_v = keys.gain_v.or(head.scale.map(|scale| scale.gain));
        let gain_v = gain_v.ok_or_else(|| match head.format {
            "csv" => missing(file, record, "unit in its heading", "`unit`, such as \"mV\" or \"counts\","),
            _ => missing(file, record, "scale", "gain_v"),
        })?;
        // An offset belongs to its gain: where the campaign gives volts per code, the file's own scale is out.
        let of_file = head.scale.filter(|_| keys.gain_v.is_none()).map(|scale| scale.offset);
        let offset_v = keys.offset_v.or(of_file).unwrap_or(0.0);
        let samples = keys.samples.map_or(head.samples as u64, |[first, last]| last - first);
        let samples = i32::try_from(samples).map_err(|_| {
            file.bad_record(
                record,
                format!("has {samples} samples in one record; name the part that counts by samples = [first, last]"),
            )
        })?;
        Ok(Trace {
            campaign: self.campaign.clone(),
            sensor: self.sensor.clone(),
            lit: self.job.capture.lit,
            seen: self.job.capture.seen,
            role: self.role.clone(),
            run: self.run.clone(),
            range: self.range.clone(),
            shot: 0,
            channel: head.channel.as_deref().map(Into::into),
            is_reference,
            file: file.text.clone(),
            segment: None,
            t0_ps: 0.0,
            dt_ps,
            file_dt_ps,
            samples,
            code_type: head.code_type.name().into(),
            gain_v,
            offset_v,
            codes: None,
            codes_file: None,
            codes_file_digest: None,
            codes_offset_bytes: None,
            codes_stride_bytes: None,
            codes_big_endian: None,
            acquired_at: head.acquired_at.as_deref().map(Into::into),
            clipped: None,
            averaged_shots: keys.averaged_shots.unwrap_or(1) as i32,
            path_m: keys.path_m,
            path_sd_m: keys.path_sd_m,
            attenuation_od: keys.attenuation_od,
            power_w: keys.power_w,
            bounces: keys.bounces.map(|bounces| bounces as i32),
        })
    }

    /// What a record has of its own, in addition to the row `shared`.
    pub fn own(
        &self,
        file: &RawFile,
        number: usize,
        shot: i32,
        (shared, row): (usize, &Trace),
        content: Content,
    ) -> Result<OwnColumns, Bad> {
        let record = &file.records[number];
        let (head, keys) = (&record.head, &self.job.item.exposure.keys);
        let t0_ps = keys.t0_ps.or(record.t0_s.map(|t0_s| t0_s * 1e12).filter(|_| !head.t0_nominal));
        let what = if head.t0_nominal { "time of sample 0 to better than some samples" } else { "time of sample 0" };
        let t0_ps = t0_ps.ok_or_else(|| missing(file, number, what, "t0_ps"))?;
        let first = keys.samples.map_or(0, |[first, _]| first);
        let (codes, clipped) = match content {
            Content::Clipped(clipped) => (None, clipped),
            Content::Codes(codes) => {
                let values = Samples::of(head.code_type.name(), &codes).expect("code types have one name everywhere");
                let clipped = head.rails.map(|(low, high)| values.count_at_or_beyond(low, high) as i32);
                (Some(codes), clipped)
            }
        };
        Ok(OwnColumns {
            shared,
            shot,
            segment: record.segment.map(|segment| segment as i32),
            t0_ps: t0_ps + first as f64 * row.dt_ps,
            codes,
            clipped,
            place: file.place_of_codes(number, first),
        })
    }
}

fn missing(file: &RawFile, record: usize, what: &str, key: &str) -> Bad {
    file.bad_record(record, format!("has no {what}; give {key} in its [[captures]] rule"))
}
