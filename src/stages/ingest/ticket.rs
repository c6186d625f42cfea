//! Parts that another process is to read: captures and what is on record of their files, so that it surveys nothing
//! itself.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::content;
use super::record::Record;
use super::survey::{Capture, Surveyed, chain};
use crate::campaign::{Campaign, Manifest};
use crate::stages::source::Ticket;
use crate::stages::stage::StageError;

/// A part, as the ticket has it.
#[derive(Serialize, Deserialize)]
struct Part {
    captures: Vec<Capture>,
    /// Of the files of these captures alone.
    seal: Option<Manifest>,
    noted: Manifest,
}

impl<'a> Surveyed<'a> {
    /// A part for another process.
    pub fn give(&self, part: usize) -> Ticket {
        let captures = &self.parts[part];
        let campaign = captures[0].campaign;
        let files: Vec<&Path> = content::files(captures).into_iter().map(|(_, file)| file).collect();
        let record = &self.records[campaign];
        let part = Part {
            captures: captures.clone(),
            seal: record.seal.as_ref().map(|seal| seal.of(files.iter().copied())),
            noted: record.noted_of(files.iter().copied()),
        };
        Ticket {
            captures: captures.len(),
            bytes: captures.iter().map(Capture::bytes).sum(),
            files: files.into_iter().map(|file| self.campaigns[campaign].path_of(file)).collect(),
            part: serde_json::to_value(part).expect("captures are plain data"),
        }
    }

    /// Takes up parts that another process has surveyed.
    ///
    /// # Errors
    /// When one of their files has changed since it was recorded, or a ticket is none of `ingest`.
    pub fn take_up(campaigns: &'a [Campaign], notes: &Path, tickets: &[Ticket]) -> Result<Self, StageError> {
        let read = |ticket: &Ticket| Part::deserialize(&ticket.part);
        let parts: Result<Vec<Part>, _> = tickets.iter().map(read).collect();
        let parts =
            parts.map_err(|error| StageError::Refused(format!("a part of the shard cannot be read: {error}")))?;
        let mut records = Vec::new();
        for (index, campaign) in campaigns.iter().enumerate() {
            let of_campaign = || parts.iter().filter(|part| part.captures[0].campaign == index);
            let mut noted = Manifest::default();
            of_campaign().for_each(|part| noted.take(&part.noted));
            let mut seal: Option<Manifest> = None;
            of_campaign()
                .filter_map(|part| part.seal.as_ref())
                .for_each(|of_part| seal.get_or_insert_default().take(of_part));
            let captures = of_campaign().map(|part| part.captures.as_slice());
            let record = Record::of_parts(campaign, notes, seal, noted, captures);
            records.push(record.map_err(|error| StageError::Refused(chain(&campaign.root, &error)))?);
        }
        let parts = parts.into_iter().map(|part| part.captures).collect();
        Self::of(campaigns, parts, Vec::new(), records)
    }
}
