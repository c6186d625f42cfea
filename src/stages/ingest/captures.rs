//! Which raw files hold which capture, as `ingest` would read them: for those who ask where a table comes from that was
//! not kept.

use std::path::{Path, PathBuf};

use super::survey::{Capture, Item, Surveyed};
use crate::campaign::{Campaign, Role};
use crate::stages::stage::StageError;
use crate::store::Digest;
use crate::units::PatchId;

/// One capture and its raw files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawCapture {
    /// Campaign.
    pub campaign: String,
    /// Sensor.
    pub sensor: String,
    /// Patch that the laser lit (0: none).
    pub lit: PatchId,
    /// Patch that the sensor saw (0: none).
    pub seen: PatchId,
    /// What was captured.
    pub role: Role,
    /// Its files, in order.
    pub files: Vec<RawShare>,
    /// Digest of the part that it belongs to, as the files are now; `None` while one was never hashed.
    pub content: Option<Digest>,
}

/// A file's share of a capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawShare {
    /// File, relative to the campaign folder.
    pub file: PathBuf,
    /// Channel, where the file holds several.
    pub channel: Option<String>,
    /// Its records that belong to the capture, counted from 0; `None`: all.
    pub records: Option<Vec<i32>>,
    /// Whether it holds reference pulses rather than signals.
    pub is_reference: bool,
}

/// The captures of these roles, in the order of the tables. `notes` is where earlier runs noted the hashes of raw
/// files.
///
/// # Errors
/// When a folder cannot be read, rules contradict each other, or a file has changed since it was sealed or first read.
pub fn raw_captures(campaigns: &[Campaign], roles: &[Role], notes: &Path) -> Result<Vec<RawCapture>, StageError> {
    let surveyed = Surveyed::new(campaigns, roles, None, notes)?;
    let mut captures = Vec::new();
    for (part, of_part) in surveyed.source_parts.iter().zip(&surveyed.parts) {
        captures.extend(of_part.iter().map(|capture| RawCapture {
            campaign: campaigns[capture.campaign].name.clone(),
            sensor: capture.sensor.clone(),
            lit: capture.lit,
            seen: capture.seen,
            role: capture.role,
            files: files(capture),
            content: part.content,
        }));
    }
    Ok(captures)
}

fn files(capture: &Capture) -> Vec<RawShare> {
    capture.items.iter().flat_map(shares).collect()
}

/// Signal, then reference if there is one.
fn shares(item: &Item) -> Vec<RawShare> {
    let exposure = &item.exposure;
    let listed = item.records.as_ref().map(|records| records.iter().map(|(record, _)| *record as i32).collect());
    let segment = exposure.segment.map(|segment| vec![segment as i32]);
    let signal = RawShare {
        file: exposure.file.clone(),
        channel: exposure.channel.clone(),
        records: listed.or_else(|| segment.clone()),
        is_reference: false,
    };
    let reference = exposure.reference.as_ref().map(|reference| RawShare {
        file: reference.file.clone(),
        channel: reference.channel.clone(),
        records: segment,
        is_reference: true,
    });
    std::iter::once(signal).chain(reference).collect()
}
