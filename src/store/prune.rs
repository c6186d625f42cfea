//! Results on the shelf that no view shows: of earlier parameters, or of parts of a campaign that has changed since.
//!
//! Needed is what the views show, what a run left unfinished since the last one that ended well, and the lists of rejects of tables that are not kept:
//! without these the tables below them would be made again. To let a table go that a view shows, remove the view first (`rm OUT/stir`).

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, Metadata};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::failure::{At, StoreError};
use super::runs::{Ending, utc};
use super::shards::SHARDS;
use super::shelf::{PartRecord, Shelf, StageId};
use super::{Digest, TableRecord, lineage, record};
use crate::tables::{self, Reject, Row};

/// What nobody needs of the tables of one recipe.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unneeded {
    /// Folder on the shelf.
    pub folder: String,
    /// Whether all of it goes: no view shows any table of this recipe.
    pub is_whole: bool,
    /// Parts of tables in it.
    pub parts: usize,
    /// Bytes that its removal frees.
    pub bytes: u64,
    /// What is removed, in this order: a record goes before the files that it names.
    paths: Vec<PathBuf>,
}

/// What the views show of one recipe.
#[derive(Default)]
struct Shown {
    parts: BTreeSet<Digest>,
    /// Folders of whole tables.
    tables: BTreeSet<String>,
}

impl Shelf {
    /// What no view shows, by folder.
    ///
    /// # Errors
    /// When the shelf cannot be read.
    pub fn unneeded(&self) -> Result<Vec<Unneeded>, StoreError> {
        let since = self.unfinished_since()?;
        let is_unfinished = |found: &Metadata| {
            since.as_ref().is_some_and(|since| found.modified().is_ok_and(|made| utc(made) >= *since))
        };
        let (shown, behind) = (self.shown()?, self.behind()?);
        let mut unneeded = Vec::new();
        for (folder, found) in folders(&self.root())? {
            let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if is_list_of_rejects(&name) {
                let is_shown = fs::read_link(self.out().join(Reject::TABLE)).is_ok_and(|link| link.ends_with(&name));
                if !is_shown && !is_unfinished(&found) {
                    // Its files are links to those of parts.
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
            let nothing = Shown::default();
            let contents =
                Contents::of(&folder, shown.get(&name).unwrap_or(&nothing), behind.contains(&name), &is_unfinished)?;
            unneeded.extend(contents.unneeded(folder, name));
        }
        Ok(unneeded)
    }

    /// What pieces of parts add up to, where the run that they were made for is not waited for any more.
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
            if let Ok(found) = fs::metadata(&subtotals) {
                unneeded.bytes += found.size();
                unneeded.paths.push(subtotals);
            }
        }
        Ok((unneeded.parts > 0).then_some(unneeded))
    }

    /// Of that, what shown tables have replaced: parts, tables and lists of rejects. Results of other parameters are left.
    ///
    /// # Errors
    /// When the shelf cannot be read.
    pub fn replaced(&self) -> Result<Vec<Unneeded>, StoreError> {
        let mut unneeded = self.unneeded()?;
        unneeded.retain(|unneeded| !unneeded.is_whole || is_list_of_rejects(&unneeded.folder));
        Ok(unneeded)
    }

    /// Removes what nobody needs. The folder must be open for writing.
    ///
    /// # Errors
    /// When something cannot be removed.
    pub fn remove(&self, unneeded: &[Unneeded]) -> Result<(), StoreError> {
        for path in unneeded.iter().flat_map(|unneeded| &unneeded.paths) {
            if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.at("remove", path)?;
        }
        Ok(())
    }

    /// Start of the first run after the last one that ended well, if there is one: what it made waits for its continuation.
    fn unfinished_since(&self) -> Result<Option<String>, StoreError> {
        let runs = self.runs()?;
        let done = runs.iter().rposition(|run| run.ending == Some(Ending::Done)).map_or(0, |last| last + 1);
        Ok(runs.into_iter().nth(done).map(|run| run.started))
    }

    fn shown(&self) -> Result<BTreeMap<String, Shown>, StoreError> {
        let mut shown: BTreeMap<String, Shown> = BTreeMap::new();
        for (_, TableRecord { lineage, stage, parts }) in self.tables()? {
            let of_stage = shown.entry(stage.folder()).or_default();
            of_stage.parts.extend(parts.iter().map(|part| part.lineage));
            of_stage.tables.insert(format!("table-{lineage}"));
        }
        Ok(shown)
    }

    /// Folders of all that shown tables are made from, themselves included.
    fn behind(&self) -> Result<BTreeSet<String>, StoreError> {
        let mut stages: BTreeMap<String, StageId> = BTreeMap::new();
        // A stage knows its inputs by recipe and name of table.
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
        let mut behind = BTreeSet::new();
        let mut open: Vec<String> = self.shown()?.into_keys().collect();
        while let Some(folder) = open.pop() {
            if let Some(stage) = stages.get(&folder) {
                open.extend(
                    stage
                        .inputs
                        .values()
                        .filter_map(|input| makers.get(input))
                        .filter(|maker| !behind.contains(*maker))
                        .cloned(),
                );
            }
            behind.insert(folder);
        }
        Ok(behind)
    }
}

/// The folders in a folder, sorted.
fn folders(folder: &Path) -> Result<Vec<(PathBuf, Metadata)>, StoreError> {
    Ok(entries(folder)?.into_iter().filter(|(_, found)| found.is_dir()).collect())
}

fn entries(folder: &Path) -> Result<Vec<(PathBuf, Metadata)>, StoreError> {
    let mut entries = Vec::new();
    for entry in fs::read_dir(folder).at("read", folder)? {
        let path = entry.at("read", folder)?.path();
        let found = fs::symlink_metadata(&path).at("read", &path)?;
        entries.push((path, found));
    }
    entries.sort_by(|a, b| a.0.cmp(&b.0));
    Ok(entries)
}

/// The contents of a recipe's folder, sorted out.
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
        shown: &Shown,
        is_behind: bool,
        is_unfinished: &impl Fn(&Metadata) -> bool,
    ) -> Result<Self, StoreError> {
        let mut contents = Self::default();
        let entries = entries(folder)?;
        let mut needed: BTreeSet<String> = shown.parts.iter().map(ToString::to_string).collect();
        for (path, found) in &entries {
            if let Some(lineage) = part_of(path).filter(|_| is_record(path)) {
                let is_list = |part: &PartRecord| is_behind && part.files.keys().all(|table| table == Reject::TABLE);
                if is_unfinished(found) || record::read::<PartRecord>(path)?.as_ref().is_some_and(is_list) {
                    needed.insert(lineage.to_owned());
                }
            }
        }
        for (path, found) in entries {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let is_needed = match part_of(&path) {
                Some(lineage) => needed.contains(lineage),
                None => shown.tables.contains(&name) || (name.starts_with("table-") && is_unfinished(&found)),
            };
            contents.is_any_needed |= is_needed;
            match (is_needed, found.is_dir(), name.as_str()) {
                (true, ..) | (_, _, "stage.json") => {}
                (_, true, _) => contents.tables.push(path),
                _ if is_record(&path) => contents.records.push(path),
                _ => contents.files.push((path, found)),
            }
        }
        Ok(contents)
    }

    fn unneeded(self, folder: PathBuf, name: String) -> Option<Unneeded> {
        let Self { records, files, tables, is_any_needed } = self;
        if is_any_needed && records.is_empty() && files.is_empty() && tables.is_empty() {
            return None;
        }
        let (parts, bytes) = (records.len(), files.iter().map(|(_, found)| found.size()).sum());
        let paths = if is_any_needed {
            tables.into_iter().chain(records).chain(files.into_iter().map(|(path, _)| path)).collect()
        } else {
            // What made it goes last: a folder without it is nothing.
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

/// Lineage of the part that a file belongs to, by its name.
fn part_of(path: &Path) -> Option<&str> {
    path.file_name()?.to_str()?.strip_prefix("part-")?.split('.').next()
}
