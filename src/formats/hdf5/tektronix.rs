//! Tektronix DPO5000: `Data` is one waveform. Values are volts; sample i is at StartTime + i * Spacing after the
//! trigger.
//!
//! The file names neither the channel (it is called `Data`) nor the instrument, nor the unit, which is volts. Source: a
//! file of a DPO5000, on which this was tested; types other than 32 bit floats were tested on files that the tests
//! build.

use std::sync::Arc;

use super::super::reader::FormatError;
use super::dataset::{Dataset, single};
use super::field;
use super::file::File;
use crate::waveform::{Head, Record};

/// The record.
pub(super) fn records(file: &mut File, data: u64, spacing: u64, start: u64) -> Result<Vec<Record>, FormatError> {
    let (dt_s, t0_s) = (single(file, spacing, "Spacing")?, single(file, start, "StartTime")?);
    if dt_s <= 0.0 {
        return Err(field(spacing, format!("Spacing = {dt_s} is not positive: the record has no time base")));
    }
    let header = file.header(data)?;
    let data = Dataset::read(file, &header)?;
    let head = Head {
        channel: Some("Data".to_owned()),
        unit: Some("V".to_owned()),
        dt_s: Some(dt_s),
        ..Head::new("tek-h5", data.code_type, data.samples)
    };
    Ok(vec![Record { head: Arc::new(head), segment: None, t0_s: Some(t0_s), trigger_s: None, payload: data.payload }])
}
