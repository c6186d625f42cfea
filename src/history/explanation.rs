//! Follows a patch, a distance, an onset or an echo back to the raw exposures.
//!
//! - Patch: the onsets whose paths include it, from its solver's residuals, else from `labels`. Other onsets influence
//!   it through their own patches, and are not listed. All profiles together contribute to a patch that `search` found.
//! - Distance: the onsets of its own inversion (T2, or sums of third bounces).
//! - Echo: the pulse of its lidar, in its file.
//! - Onset: its profile, and the reciprocal one if `deconvolve` explained both together.

use std::collections::BTreeSet;
use std::path::PathBuf;

use serde::Serialize;
use serde_json::{Map, Value};

use super::HistoryError;
use super::ancestry::{Ancestry, Table};
use super::behind::{self, CaptureBehind, OnsetBehind};
use super::exposures::{CaptureKey, Exposures};
use super::gather::{Evidence, Explainer};
use super::sensors::{self, SensorBehind};
use super::sql::{Query, Questions, Selection};
use super::target::Target;
use crate::store::{Digest, Shelf};
use crate::tables::{Label, Onset, Row};

/// Origin of a row. Times are in ps, voltages in V, lengths in m.
#[derive(Clone, Debug, Serialize)]
pub struct Explanation {
    /// The request, in words.
    pub target: String,
    /// The table that has the row.
    pub table: String,
    /// Its kind, as in `periscope schema`.
    pub table_kind: String,
    /// The stage that made it.
    pub stage: String,
    /// The row, by its columns.
    pub row: Map<String, Value>,
    /// The tables that its table was made from, in the order of the dataflow; the table itself is last.
    pub tables: Vec<TableBehind>,
    /// The contributing onsets.
    pub onsets: Vec<OnsetBehind>,
    /// The captures of these onsets.
    pub captures: Vec<CaptureBehind>,
    /// What the sensors' own captures determined.
    pub sensors: Vec<SensorBehind>,
    /// Other tables of the same stage.
    pub beside: Vec<String>,
    /// Remarks on the answer.
    pub remarks: Vec<String>,
    /// The same as SQL queries.
    pub queries: Vec<Query>,
}

/// A table from which the row derives.
#[derive(Clone, Debug, Serialize)]
pub struct TableBehind {
    /// Its view, or its stage's kind if it has none.
    pub table: String,
    /// The stage that made it.
    pub stage: String,
    /// Lineage; null where the table is not kept.
    pub lineage: Option<Digest>,
    /// The table that its stage streamed.
    pub from: Option<String>,
    /// The whole tables that its stage reads in addition.
    pub with: Vec<String>,
}

/// Explains a row of a result folder. `heading` chooses among several tables with such rows (default: the last of the
/// dataflow). `campaigns` gives the present campaign folders (default: those of the newest run).
///
/// # Errors
/// When there is no such row or table, or a table cannot be read.
pub fn explain(
    shelf: &Shelf,
    target: &Target,
    heading: Option<&str>,
    campaigns: &[PathBuf],
) -> Result<Explanation, HistoryError> {
    let ancestry = Ancestry::of(shelf)?;
    let explainer = Explainer { shelf, ancestry: &ancestry, campaigns };
    let mut remarks = Vec::new();
    let (table, gathered) = explainer.find(target, heading, &mut remarks)?;
    explainer.explain(target, &table, gathered, remarks)
}

impl Explainer<'_> {
    fn explain(
        &self,
        target: &Target,
        table: &Table,
        gathered: Evidence,
        mut remarks: Vec<String>,
    ) -> Result<Explanation, HistoryError> {
        let ancestry = self.ancestry;
        let Evidence { row, onsets, selection, condition, recording } = gathered;
        let is_onset = table.name == Onset::TABLE;
        let labels = if is_onset { self.last_made_from(table, Label::TABLE) } else { self.labels_of(table) };
        let detected = behind::at_or_above(ancestry, table, Onset::TABLE);
        let onsets = behind::complete(ancestry, onsets, labels.as_ref(), detected.as_ref())?;
        // Captures and raw files follow from the table in which the onsets were detected.
        let from = detected.as_ref().unwrap_or(table);
        let (captures, is_joint) = self.captures(table, from, &onsets, selection.is_some())?;
        let exposures = Exposures { shelf: self.shelf, ancestry, campaigns: self.campaigns };
        let sensors = sensors::sensors(&exposures, &captures, table, &mut remarks)?;
        let captures = behind::captures(&exposures, &captures, from, &mut remarks)?;
        self.remark_on_tables(table, &mut remarks);
        let mut queries =
            self.queries(table, &condition, selection.as_ref(), labels.as_ref(), detected.as_ref(), is_joint)?;
        if let Some((table, condition)) = recording {
            let questions = Questions { shelf: self.shelf, ancestry };
            queries.extend(questions.rows("its pulse", &table, &condition)?);
        }
        let mut unique = BTreeSet::new();
        remarks.retain(|remark| unique.insert(remark.clone()));
        Ok(Explanation {
            target: target.to_string(),
            table: ancestry.label(table),
            table_kind: table.name.clone(),
            stage: ancestry.stage(table).kind.clone(),
            row,
            tables: self.tables(table),
            onsets,
            captures,
            sensors,
            beside: self.sides(table),
            remarks,
            queries,
        })
    }

    /// Captures of the onsets, with their reciprocals if both were explained together; of the whole scene if all
    /// profiles contribute.
    fn captures(
        &self,
        table: &Table,
        from: &Table,
        onsets: &[OnsetBehind],
        has_onsets: bool,
    ) -> Result<(BTreeSet<CaptureKey>, bool), HistoryError> {
        if !has_onsets {
            let profiles = self.ancestry.nearest(table, "profiles");
            let all = profiles.map(|profiles| behind::scene_captures(self.ancestry, &profiles)).transpose()?;
            return Ok((all.unwrap_or_default(), false));
        }
        let mut captures: BTreeSet<CaptureKey> = onsets.iter().map(OnsetBehind::capture).collect();
        let stir = self.ancestry.nearest(from, "stir");
        let is_joint = stir.is_some_and(|stir| self.ancestry.stage(&stir).params["joint"] == true);
        if let Some(profiles) = self.ancestry.nearest(from, "profiles").filter(|_| is_joint) {
            let is_reciprocal = |(campaign, sensor, lit, seen): &CaptureKey| {
                captures.contains(&(campaign.clone(), sensor.clone(), *seen, *lit))
            };
            let all = behind::scene_captures(self.ancestry, &profiles)?;
            let reciprocal: Vec<CaptureKey> = all.into_iter().filter(is_reciprocal).collect();
            captures.extend(reciprocal);
        }
        Ok((captures, is_joint))
    }

    fn remark_on_tables(&self, table: &Table, remarks: &mut Vec<String>) {
        for table in std::iter::once(table.clone()).chain(self.ancestry.upstream(table)) {
            let (label, stage) = (self.ancestry.label(&table), self.ancestry.stage(&table));
            if stage.kind == "import" {
                let path = stage.params["path"].as_str().unwrap_or("a file");
                remarks.push(format!("`{label}` was imported from {path}: nothing before it is known"));
            }
            if !self.ancestry.inputs_fit(&table) {
                remarks.push(format!(
                    "the inputs of `{label}` are no longer stored; this shows the tables that are there now"
                ));
            }
        }
    }

    fn tables(&self, table: &Table) -> Vec<TableBehind> {
        let mut behind = self.ancestry.upstream(table);
        behind.sort_by_key(|table| self.ancestry.depth(table));
        behind.push(table.clone());
        let described = |table: &Table| {
            let inputs = self.ancestry.inputs(table).iter();
            let (from, with): (Vec<_>, Vec<_>) = inputs.partition(|(name, _)| name == "from");
            let label = |(_, table): &&(String, Table)| self.ancestry.label(table);
            TableBehind {
                table: self.ancestry.label(table),
                stage: self.ancestry.stage(table).kind.clone(),
                lineage: self.ancestry.record(table).map(|record| record.lineage),
                from: from.first().map(label),
                with: with.iter().map(label).collect(),
            }
        };
        behind.iter().map(described).collect()
    }

    /// Views of the other tables of the same stage.
    fn sides(&self, table: &Table) -> Vec<String> {
        let label = self.ancestry.label(table);
        let views = self.ancestry.views().into_iter();
        let is_side = |name: &str| name.strip_prefix(&label).is_some_and(|rest| rest.starts_with('.'));
        views.map(|(view, _)| view).filter(|view| is_side(view)).collect()
    }

    fn queries(
        &self,
        table: &Table,
        condition: &str,
        selection: Option<&Selection>,
        labels: Option<&Table>,
        detected: Option<&Table>,
        is_joint: bool,
    ) -> Result<Vec<Query>, HistoryError> {
        let questions = Questions { shelf: self.shelf, ancestry: self.ancestry };
        let mut queries = vec![questions.rows("the row itself", table, condition)?];
        if let Some(selection) = selection.filter(|selection| selection.table != *table) {
            queries.push(questions.onsets(selection, labels, detected)?);
        }
        let from = detected.unwrap_or(table);
        for (name, about, columns) in [
            ("profiles", "the captures", "shots, rejected, noise_v, jitter_ps"),
            (
                "traces",
                "the raw records",
                "file, segment, channel, is_reference, shot, codes_file, codes_offset_bytes, codes_stride_bytes",
            ),
        ] {
            if let Some(table) = self.ancestry.nearest(from, name) {
                queries.push(questions.captures(about, &table, columns, selection, is_joint)?);
            }
        }
        Ok(queries.into_iter().flatten().collect())
    }
}
