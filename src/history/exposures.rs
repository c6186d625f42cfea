//! The raw files of captures: from `traces` if that table is kept, else from the campaign folder.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::HistoryError;
use super::ancestry::{Ancestry, Table};
use crate::campaign::{Campaign, Role};
use crate::stages::ingest::captures::{RawCapture, raw_captures};
use crate::store::{Shelf, lineage};
use crate::table;
use crate::tables::Name;
use crate::units::PatchId;

/// Campaign, sensor, lit, seen.
pub type CaptureKey = (Name, Name, PatchId, PatchId);

/// Records of one channel of a raw file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RawRecords {
    /// Campaign.
    pub campaign: String,
    /// File, relative to the campaign folder.
    pub file: String,
    /// Channel, where the file holds several.
    pub channel: Option<String>,
    /// Segments of the file, from 0; null: it has none, or all of them belong here.
    pub segments: Option<Vec<i32>>,
    /// Number of exposures; null if only the file itself has it.
    pub exposures: Option<usize>,
    /// Whether they are the reference pulses, not the signals.
    pub is_reference: bool,
}

table! {
    /// Origin of a record of `traces`.
    "traces": Origin, OriginColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch lit.
        lit: i32,
        /// Patch seen.
        seen: i32,
        /// Role.
        role: Name,
        /// Channel.
        channel: Option<Name>,
        /// Reference pulse or signal.
        is_reference: bool,
        /// File.
        file: Name,
        /// Segment.
        segment: Option<i32>,
    }
}

/// Finds raw files.
pub struct Exposures<'a> {
    pub shelf: &'a Shelf,
    pub ancestry: &'a Ancestry,
    /// Campaign folders; empty: those of the newest run.
    pub campaigns: &'a [PathBuf],
}

impl Exposures<'_> {
    /// Raw records of these captures, in the order of a table `traces`. Further information is added to `remarks`.
    pub fn of_captures(
        &self,
        traces: &Table,
        captures: &BTreeSet<CaptureKey>,
        remarks: &mut Vec<String>,
    ) -> Result<Vec<(CaptureKey, RawRecords)>, HistoryError> {
        let lit: BTreeSet<PatchId> = captures.iter().map(|(_, _, lit, _)| *lit).collect();
        let seen: BTreeSet<PatchId> = captures.iter().map(|(_, _, _, seen)| *seen).collect();
        let campaigns = captures.iter().map(|(campaign, ..)| campaign).collect();
        let numbers = [("lit", &lit), ("seen", &seen)];
        self.of(traces, &campaigns, &numbers, |capture| captures.contains(capture), remarks)
    }

    /// Raw records of all captures of a sensor.
    pub fn of_sensor(
        &self,
        traces: &Table,
        campaign: &Name,
        sensor: &Name,
        remarks: &mut Vec<String>,
    ) -> Result<Vec<RawRecords>, HistoryError> {
        let is_its = |capture: &CaptureKey| (&capture.0, &capture.1) == (campaign, sensor);
        let records = self.of(traces, &BTreeSet::from([campaign]), &[], is_its, remarks)?;
        Ok(records.into_iter().map(|(_, records)| records).collect())
    }

    fn of(
        &self,
        traces: &Table,
        campaigns: &BTreeSet<&Name>,
        numbers: &[(&str, &BTreeSet<PatchId>)],
        wanted: impl Fn(&CaptureKey) -> bool,
        remarks: &mut Vec<String>,
    ) -> Result<Vec<(CaptureKey, RawRecords)>, HistoryError> {
        if self.ancestry.record(traces).is_some() {
            return self.read_traces(traces, numbers, wanted);
        }
        match self.survey(traces, campaigns) {
            Ok(captures) => {
                let parts = self.ancestry.parts(traces);
                let recipe = self.ancestry.stage(traces).recipe();
                let is_same = |capture: &RawCapture| {
                    capture.content.is_some_and(|content| parts.contains(&lineage::part(&recipe, &content, &[])))
                };
                let mine: Vec<&RawCapture> = captures.iter().filter(|capture| wanted(&key(capture))).collect();
                if !mine.iter().all(|capture| is_same(capture)) {
                    remarks.push(
                        "raw files are not those that these tables were made from: some are new, changed or never read"
                            .to_owned(),
                    );
                }
                Ok(mine.into_iter().flat_map(shares).collect())
            }
            Err(error) => {
                remarks.push(format!("raw files are not known: the table of traces is not kept, and {error}"));
                Ok(Vec::new())
            }
        }
    }

    fn read_traces(
        &self,
        traces: &Table,
        numbers: &[(&str, &BTreeSet<PatchId>)],
        wanted: impl Fn(&CaptureKey) -> bool,
    ) -> Result<Vec<(CaptureKey, RawRecords)>, HistoryError> {
        let key = |row: &Origin| (row.campaign.clone(), row.sensor.clone(), row.lit, row.seen);
        let mut by_capture: Vec<(CaptureKey, RawRecords)> = Vec::new();
        let mut places: BTreeMap<(CaptureKey, Name, Option<Name>, bool), usize> = BTreeMap::new();
        for row in self.ancestry.rows_near::<Origin>(traces, numbers, |row| wanted(&key(row)))? {
            let of_file = (key(&row), row.file.clone(), row.channel.clone(), row.is_reference);
            let place = *places.entry(of_file).or_insert_with(|| {
                let records = RawRecords {
                    campaign: row.campaign.to_string(),
                    file: row.file.to_string(),
                    channel: row.channel.as_deref().map(str::to_owned),
                    segments: None,
                    exposures: Some(0),
                    is_reference: row.is_reference,
                };
                by_capture.push((key(&row), records));
                by_capture.len() - 1
            });
            let records = &mut by_capture[place].1;
            records.exposures = records.exposures.map(|count| count + 1);
            if let Some(segment) = row.segment {
                records.segments.get_or_insert_default().push(segment);
            }
        }
        Ok(by_capture)
    }

    /// Captures of these campaigns in the present campaign folders, with the roles that a table `traces` contains.
    fn survey(&self, traces: &Table, campaigns: &BTreeSet<&Name>) -> Result<Vec<RawCapture>, HistoryError> {
        let roles = self.ancestry.stage(traces).params["roles"].clone();
        let unknown = |_| HistoryError::Refused("its record names no roles; run the pipeline again".to_owned());
        let roles: Vec<Role> = serde_json::from_value(roles).map_err(unknown)?;
        let campaigns = campaigns.iter().map(|name| self.campaign(name)).collect::<Result<Vec<_>, _>>()?;
        Ok(raw_captures(&campaigns, &roles, &self.shelf.notes())?)
    }

    fn campaign(&self, name: &str) -> Result<Campaign, HistoryError> {
        let advice = "say where it is with --campaign DIR";
        if !self.campaigns.is_empty() {
            for folder in self.campaigns {
                let campaign = Campaign::load(folder)?;
                if campaign.name == name {
                    return Ok(campaign);
                }
            }
            return Err(HistoryError::Refused(format!("none of the campaigns given is named `{name}`; {advice}")));
        }
        let runs = self.shelf.runs()?;
        let folder = runs.iter().rev().find_map(|run| run.campaigns.get(name));
        let folder: &Path = folder
            .ok_or_else(|| HistoryError::Refused(format!("no run record says where campaign `{name}` is; {advice}")))?;
        if !folder.is_dir() {
            let folder = folder.display();
            return Err(HistoryError::Refused(format!(
                "the folder of campaign `{name}`, {folder}, is not there; {advice}"
            )));
        }
        Ok(Campaign::load(folder)?)
    }
}

fn key(capture: &RawCapture) -> CaptureKey {
    (capture.campaign.as_str().into(), capture.sensor.as_str().into(), capture.lit, capture.seen)
}

fn shares(capture: &RawCapture) -> impl Iterator<Item = (CaptureKey, RawRecords)> {
    capture.files.iter().map(|share| {
        let records = RawRecords {
            campaign: capture.campaign.clone(),
            file: share.file.to_string_lossy().into_owned(),
            channel: share.channel.clone(),
            segments: share.records.clone(),
            exposures: share.records.as_ref().map(Vec::len),
            is_reference: share.is_reference,
        };
        (key(capture), records)
    })
}
