//! Results on the shelf that no view shows: from earlier parameters, or of parts of a campaign that has changed since.
//!
//! Needed are: what the views show, and what unfinished runs made since the last one that succeeded. Needed too are the
//! lists of rejects of tables that are not kept: without these, a run would make the tables below them again. To
//! release a table that a view shows, remove the view first (`rm OUT/stir`).

use std::collections::{BTreeMap, BTreeSet};
use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::disk as fs;
use super::failure::{At, StoreError};
use super::runs::{Ending, utc};
use super::shards::SHARDS;
use super::shelf::{PartRecord, Shelf, StageId};
use super::{Digest, TableRecord, lineage, record};
use crate::tables::{self, Reject, Row};

/// Unneeded files among the tables of one recipe.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unneeded {
    /// Folder on the shelf.
    pub folder: String,
    /// Whether the whole folder is unneeded: no view shows any table of this recipe.
    pub is_whole: bool,
    /// Parts of tables in it.
    pub parts: usize,
    /// Bytes that its removal frees.
    pub bytes: u64,
    /// What is removed, in this order: a record before the files that it names.
    paths: Vec<PathBuf>,
}

/// What the views show of one recipe.
#[derive(Default)]
struct Visible {
    parts: BTreeSet<Digest>,
    /// Folders of whole tables.
    tables: BTreeSet<String>,
}

impl Shelf {
    /// Finds what no view shows, by folder.
    ///
    /// # Errors
    /// When the shelf cannot be read.
    pub fn unneeded(&self) -> Result<Vec<Unneeded>, StoreError> {
        self.unneeded_now(&BTreeMap::new())
    }

    /// The same, if the present parts of some stages are known, by folder: then their other lists of rejects are
    /// unneeded too.
    fn unneeded_now(&self, present: &BTreeMap<String, BTreeSet<Digest>>) -> Result<Vec<Unneeded>, StoreError> {
        let since = self.unfinished_since()?;
        let is_unfinished = |metadata: &Metadata| {
            since.as_ref().is_some_and(|since| metadata.modified().is_ok_and(|modified| utc(modified) >= *since))
        };
        let (visible, origins) = (self.visible()?, self.origins()?);
        let mut unneeded = Vec::new();
        for (folder, metadata) in folders(&self.root())? {
            let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if is_list_of_rejects(&name) {
                let is_visible = self.target(Reject::TABLE)?.is_some_and(|list| list.ends_with(&name));
                if !is_visible && !is_unfinished(&metadata) {
                    // Its files are links to those of parts, so they free no bytes.
                    unneeded.push(Unneeded { folder: name, is_whole: true, parts: 0, bytes: 0, paths: vec![folder] });
                }
                continue;
            }
            if name == SHARDS {
                unneeded.extend(self.unneeded_pieces(name, &is_unfinished)?);
                continue;
            }
            if !folder.join("stage.json").is_file() {
                continue;
            }
            let nothing = Visible::default();
            let is_list = |part: &PartRecord| {
                let is_present = || present.get(&name).is_none_or(|parts| parts.contains(&part.lineage));
                origins.contains(&name) && part.files.keys().all(|table| table == Reject::TABLE) && is_present()
            };
            let contents = Contents::of(&folder, visible.get(&name).unwrap_or(&nothing), is_list, &is_unfinished)?;
            unneeded.extend(contents.unneeded(folder, name));
        }
        Ok(unneeded)
    }

    /// Finds subtotals of pieces whose run is no longer awaited.
    fn unneeded_pieces(
        &self,
        folder: String,
        is_unfinished: &impl Fn(&Metadata) -> bool,
    ) -> Result<Option<Unneeded>, StoreError> {
        let mut unneeded = Unneeded { folder, is_whole: false, parts: 0, bytes: 0, paths: Vec::new() };
        for (record, subtotals) in self.pieces()? {
            if is_unfinished(&fs::metadata(&record).at("read", &record)?) {
                continue;
            }
            unneeded.parts += 1;
            unneeded.paths.push(record);
            if let Ok(metadata) = fs::metadata(&subtotals) {
                unneeded.bytes += metadata.size();
                unneeded.paths.push(subtotals);
            }
        }
        Ok((unneeded.parts > 0).then_some(unneeded))
    }

    /// Of that, what the tables of a run have replaced: parts, tables and lists of rejects. `present` are the stages
    /// behind these tables, with the lineages of their parts. Results of other parameters stay.
    ///
    /// # Errors
    /// When the shelf cannot be read.
    pub fn replaced(&self, present: &[(StageId, Vec<Digest>)]) -> Result<Vec<Unneeded>, StoreError> {
        let present = present.iter().map(|(stage, parts)| (stage.folder(), parts.iter().copied().collect()));
        let mut unneeded = self.unneeded_now(&present.collect())?;
        unneeded.retain(|unneeded| !unneeded.is_whole || is_list_of_rejects(&unneeded.folder));
        Ok(unneeded)
    }

    /// Removes unneeded files. The folder must be open for writing.
    ///
    /// # Errors
    /// When something cannot be removed.
    pub fn remove(&self, unneeded: &[Unneeded]) -> Result<(), StoreError> {
        for path in unneeded.iter().flat_map(|unneeded| &unneeded.paths) {
            if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.at("remove", path)?;
        }
        Ok(())
    }

    /// Start of the first run after the last one that succeeded, if there is one: a later run will continue its work.
    fn unfinished_since(&self) -> Result<Option<String>, StoreError> {
        let runs = self.runs()?;
        let done = runs.iter().rposition(|run| run.ending == Some(Ending::Done)).map_or(0, |last| last + 1);
        Ok(runs.into_iter().nth(done).map(|run| run.started))
    }

    fn visible(&self) -> Result<BTreeMap<String, Visible>, StoreError> {
        let mut visible: BTreeMap<String, Visible> = BTreeMap::new();
        for (_, TableRecord { lineage, stage, parts }) in self.tables()? {
            let of_stage = visible.entry(stage.folder()).or_default();
            of_stage.parts.extend(parts.iter().map(|part| part.lineage));
            of_stage.tables.insert(format!("table-{lineage}"));
        }
        Ok(visible)
    }

    /// Folders of everything that visible tables are made from, themselves included.
    fn origins(&self) -> Result<BTreeSet<String>, StoreError> {
        let mut stages: BTreeMap<String, StageId> = BTreeMap::new();
        // A stage identifies its inputs by recipe and table name.
        let mut makers: BTreeMap<Digest, String> = BTreeMap::new();
        for (folder, _) in folders(&self.root())? {
            let Some(stage) = record::read::<StageId>(&folder.join("stage.json"))? else {
                continue;
            };
            let recipe = stage.recipe();
            makers
                .extend(tables::all().iter().map(|(table, _)| (lineage::table_recipe(table, &recipe), stage.folder())));
            stages.insert(stage.folder(), stage);
        }
        let mut origins = BTreeSet::new();
        let mut open: Vec<String> = self.visible()?.into_keys().collect();
        while let Some(folder) = open.pop() {
            if let Some(stage) = stages.get(&folder) {
                open.extend(
                    stage
                        .inputs
                        .values()
                        .filter_map(|input| makers.get(input))
                        .filter(|maker| !origins.contains(*maker))
                        .cloned(),
                );
            }
            origins.insert(folder);
        }
        Ok(origins)
    }
}

/// The folders in a folder, sorted.
fn folders(folder: &Path) -> Result<Vec<(PathBuf, Metadata)>, StoreError> {
    Ok(entries(folder)?.into_iter().filter(|(_, metadata)| metadata.is_dir()).collect())
}

fn entries(folder: &Path) -> Result<Vec<(PathBuf, Metadata)>, StoreError> {
    let mut entries = Vec::new();
    for entry in fs::read_dir(folder).at("read", folder)? {
        let path = entry.at("read", folder)?.path();
        let metadata = fs::symlink_metadata(&path).at("read", &path)?;
        entries.push((path, metadata));
    }
    entries.sort_by(|a, b| a.0.cmp(&b.0));
    Ok(entries)
}

/// The contents of a recipe's folder, sorted by kind.
#[derive(Default)]
struct Contents {
    records: Vec<PathBuf>,
    files: Vec<(PathBuf, Metadata)>,
    tables: Vec<PathBuf>,
    is_any_needed: bool,
}

impl Contents {
    fn of(
        folder: &Path,
        visible: &Visible,
        is_list: impl Fn(&PartRecord) -> bool,
        is_unfinished: &impl Fn(&Metadata) -> bool,
    ) -> Result<Self, StoreError> {
        let mut contents = Self::default();
        let entries = entries(folder)?;
        let mut needed: BTreeSet<String> = visible.parts.iter().map(ToString::to_string).collect();
        for (path, metadata) in &entries {
            if let Some(lineage) = part_of(path).filter(|_| is_record(path))
                && (is_unfinished(metadata) || record::read::<PartRecord>(path)?.as_ref().is_some_and(&is_list))
            {
                needed.insert(lineage.to_owned());
            }
        }
        for (path, metadata) in entries {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let is_needed = match part_of(&path) {
                Some(lineage) => needed.contains(lineage),
                None => visible.tables.contains(&name) || (name.starts_with("table-") && is_unfinished(&metadata)),
            };
            contents.is_any_needed |= is_needed;
            match (is_needed, metadata.is_dir(), name.as_str()) {
                (true, ..) | (_, _, "stage.json") => {}
                (_, true, _) => contents.tables.push(path),
                _ if is_record(&path) => contents.records.push(path),
                _ => contents.files.push((path, metadata)),
            }
        }
        Ok(contents)
    }

    fn unneeded(self, folder: PathBuf, name: String) -> Option<Unneeded> {
        let Self { records, files, tables, is_any_needed } = self;
        if is_any_needed && records.is_empty() && files.is_empty() && tables.is_empty() {
            return None;
        }
        let (parts, bytes) = (records.len(), files.iter().map(|(_, metadata)| metadata.size()).sum());
        let paths = if is_any_needed {
            tables.into_iter().chain(records).chain(files.into_iter().map(|(path, _)| path)).collect()
        } else {
            // The record of the stage goes last: a folder without it counts as nothing.
            tables.into_iter().chain(records).chain([folder]).collect()
        };
        Some(Unneeded { folder: name, is_whole: !is_any_needed, parts, bytes, paths })
    }
}

fn is_list_of_rejects(folder: &str) -> bool {
    folder.strip_prefix(Reject::TABLE).is_some_and(|rest| rest.starts_with('-'))
}

fn is_record(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "json")
}

/// Lineage of a file's part, from the file's name.
fn part_of(path: &Path) -> Option<&str> {
    path.file_name()?.to_str()?.strip_prefix("part-")?.split('.').next()
}
