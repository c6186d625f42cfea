//! Where the tables come from: runs and their times, tables and what each was made from, and what was rejected.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::history::HistoryError;
use crate::history::ancestry::Ancestry;
use crate::pipeline::rejects;
use crate::store::Shelf;
use crate::store::runs::{Ending, RunRecord};
use crate::tables::{Reject, Row};

/// Reasons of rejects that are listed at most.
const REASONS: usize = 40;

/// A table of the result folder.
pub struct Shown {
    /// Its view.
    pub view: String,
    /// The stage that made it.
    pub stage: String,
    /// That stage's parameters, as they were parsed.
    pub params: Value,
    /// Rows.
    pub rows: u64,
    /// Bytes.
    pub bytes: u64,
    /// Parts.
    pub parts: usize,
    /// Its lineage.
    pub lineage: String,
    /// What it was made from: the stage's own name for it, and its heading.
    pub inputs: Vec<(String, String)>,
}

/// Records that were rejected for one reason.
pub struct Rejected {
    /// How many.
    pub count: usize,
    /// The first of them.
    pub first: Reject,
}

/// Where everything comes from.
pub struct Provenance {
    /// The last run; `None` where a folder was made without one.
    pub last_run: Option<RunRecord>,
    /// The last run that computed anything, of those that say how long they took.
    pub last_work: Option<RunRecord>,
    /// How many runs wrote into the folder.
    pub runs: usize,
    /// Tables in the order of the dataflow.
    pub tables: Vec<Shown>,
    /// Commonest first.
    pub rejected: Vec<Rejected>,
    /// Rejected records, those of reasons not listed too.
    pub rejects: usize,
    /// Reasons.
    pub reasons: usize,
}

impl Provenance {
    /// Whether the last run came to its end.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.last_run.as_ref().is_none_or(|run| run.ending == Some(Ending::Done))
    }

    /// Reads records of runs and tables.
    ///
    /// # Errors
    /// When one cannot be read.
    pub fn of(shelf: &Shelf, ancestry: &Ancestry) -> Result<Self, HistoryError> {
        let mut runs = shelf.runs()?;
        let table = |(view, table): (String, crate::history::ancestry::Table)| {
            let record = ancestry.record(&table)?;
            let inputs = ancestry.inputs(&table).iter();
            Some(Shown {
                view,
                stage: record.stage.kind.clone(),
                params: record.stage.params.clone(),
                rows: record.rows(&table.name),
                bytes: record.bytes(&table.name),
                parts: record.parts.len(),
                lineage: record.lineage.short(),
                inputs: inputs.map(|(name, input)| (name.clone(), ancestry.label(input))).collect(),
            })
        };
        let rejects = if shelf.table_of(Reject::TABLE)?.is_some() { rejects::rows(shelf)? } else { Vec::new() };
        let kinds = rejects::kinds(&rejects);
        let shown = kinds.iter().take(REASONS);
        Ok(Self {
            runs: runs.len(),
            last_work: runs.iter().rev().find(|run| !run.passes.is_empty()).cloned(),
            last_run: runs.pop(),
            tables: ancestry.views().into_iter().filter_map(table).collect(),
            rejected: shown.map(|(count, first)| Rejected { count: *count, first: (*first).clone() }).collect(),
            reasons: kinds.len(),
            rejects: rejects.len(),
        })
    }

    /// Name and folder of each campaign of the last run.
    pub fn campaigns(&self) -> impl Iterator<Item = (&str, &Path)> {
        let folders: Option<&BTreeMap<String, PathBuf>> = self.last_run.as_ref().map(|run| &run.campaigns);
        folders.into_iter().flatten().map(|(name, folder)| (name.as_str(), folder.as_path()))
    }
}
