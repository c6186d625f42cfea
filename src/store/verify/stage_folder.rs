//! One folder of the shelf: the results of one recipe.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::{Report, entries, left_over, name, same_file, strays};
use crate::store::disk as fs;
use crate::store::failure::{At, StoreError};
use crate::store::shelf::{PartRecord, Shelf, StageId, TableRecord};
use crate::store::{Digest, parquet, sweep};

/// The readable records of a folder.
pub struct StageFolder {
    pub path: PathBuf,
    /// Content of its recipe.
    pub id: Option<StageId>,
    pub parts: BTreeMap<Digest, PartRecord>,
    pub tables: BTreeMap<Digest, TableRecord>,
}

impl StageFolder {
    /// Reads and checks everything in it.
    pub fn read(shelf: &Shelf, path: PathBuf, report: &mut Report) -> Result<Self, StoreError> {
        let mut folder = Self { path, id: None, parts: BTreeMap::new(), tables: BTreeMap::new() };
        let stage = folder.path.join("stage.json");
        let remove = fs::is_there(&stage).at("read", &stage)?.then(|| stage.clone()).into_iter().collect();
        folder.id = report.record::<StageId>(shelf, &stage, remove)?;
        if folder.id.as_ref().is_some_and(|id| id.folder() != name(&folder.path)) {
            report.add(
                shelf,
                &stage,
                "is of another folder: its recipe is not the one that this folder is named by",
                vec![stage.clone()],
            );
            folder.id = None;
        }
        let all = entries(&folder.path)?;
        let mut parts = Vec::new();
        let mut tables = Vec::new();
        for path in &all {
            let name = name(path);
            if name == "stage.json" {
            } else if sweep::is_unfinished(name.as_ref()) {
                report.notes.push(left_over(path));
            } else if name.starts_with("table-") {
                tables.push(path);
            } else if let Some(lineage) = name.strip_prefix("part-").and_then(|name| name.strip_suffix(".json")) {
                parts.push((path, lineage.to_owned()));
            } else if name.starts_with("part-") && name.ends_with(".parquet") {
                let (part, _) = name.split_once('.').expect("it ends with .parquet");
                let record = folder.path.join(format!("{part}.json"));
                if !fs::is_there(&record).at("read", &record)? {
                    report.notes.push(format!("{} belongs to no finished part: no table shows it", path.display()));
                }
            } else {
                report.notes.push(format!("{} is none of periscope's files", path.display()));
            }
        }
        let check = |(path, lineage): &(&PathBuf, String)| folder.part(shelf, path, lineage, &all);
        // In order, whichever thread checked it.
        let checked: Vec<_> = parts.par_iter().map(check).collect::<Result<_, StoreError>>()?;
        for (record, of_part) in checked {
            report.append(of_part);
            folder.parts.extend(record.map(|record| (record.lineage, record)));
        }
        for path in tables {
            folder.table(shelf, path, report)?;
        }
        Ok(folder)
    }

    /// Checks a part: its record, and its files among all (sorted) of the folder. Gives the record, if it can be read.
    fn part(
        &self,
        shelf: &Shelf,
        path: &Path,
        lineage: &str,
        files: &[PathBuf],
    ) -> Result<(Option<PartRecord>, Report), StoreError> {
        let mut report = Report::default();
        let of_part = self.path.join(format!("part-{lineage}.")).into_os_string();
        let starts = |file: &Path| file.as_os_str().as_encoded_bytes().starts_with(of_part.as_encoded_bytes());
        let first = files.partition_point(|file| *file.as_os_str() < *of_part);
        let all: Vec<PathBuf> = files[first..].iter().take_while(|file| starts(file)).cloned().collect();
        let Some(record) = report.record::<PartRecord>(shelf, path, all.clone())? else {
            return Ok((None, report));
        };
        if record.lineage.to_string() != lineage {
            report.add(shelf, path, format!("is the record of another part, {}", record.lineage), all);
            return Ok((None, report));
        }
        report.counts.parts += 1;
        for (table, file) in &record.files {
            let path = self.path.join(format!("part-{lineage}.{table}.parquet"));
            if report.file(shelf, &path, file, all.clone())? {
                let (rows, footer) = parquet::footer(&path).at("read", &path)?;
                let stage = self.id.as_ref().and_then(|id| serde_json::to_string(id).ok());
                let says = |key: &str, value: &str| footer.iter().any(|(k, v)| k == key && v == value);
                let of_this = says("periscope.lineage", lineage)
                    && stage.is_none_or(|stage| says("periscope.stage", &stage))
                    && rows == file.rows;
                if !of_this {
                    let what = "is of another part: its footer names another lineage or stage";
                    report.add(shelf, &path, what, all.clone());
                }
            }
        }
        Ok((Some(record), report))
    }

    /// Checks a complete table: its record, and the files by which its views show its parts.
    fn table(&mut self, shelf: &Shelf, path: &Path, report: &mut Report) -> Result<(), StoreError> {
        let remove = || vec![path.to_owned()];
        let file = path.join("table.json");
        let Some(record) = report.record::<TableRecord>(shelf, &file, remove())? else {
            return Ok(());
        };
        let of_this = record.holds()
            && name(path) == format!("table-{}", record.lineage)
            && self.id.as_ref().is_none_or(|id| *id == record.stage);
        if !of_this {
            report.add(
                shelf,
                &file,
                "is the record of another table: its lineage is not that of its parts and its folder",
                remove(),
            );
            return Ok(());
        }
        report.counts.tables += 1;
        for folder in entries(path)? {
            if !fs::is_folder(&folder).at("read", &folder)? {
                continue;
            }
            let table = name(&folder);
            let is_part = |file: &str| {
                let number = file.strip_prefix("part-").and_then(|file| file.strip_suffix(".parquet"));
                let number = number.and_then(|number| number.parse::<usize>().ok());
                number.is_some_and(|i| i < record.parts.len() && file == format!("part-{i:05}.parquet"))
            };
            strays(shelf, &folder, is_part, report)?;
            for (i, part) in record.parts.iter().enumerate() {
                let view_file = folder.join(format!("part-{i:05}.parquet"));
                let stored = self.path.join(format!("part-{}.{table}.parquet", part.lineage));
                match part.files.get(&table) {
                    // A linked file was already checked as a part.
                    Some(_) if same_file(&view_file, &stored) && self.parts.contains_key(&part.lineage) => {}
                    Some(file) => _ = report.file(shelf, &view_file, file, remove())?,
                    None => {
                        _ = report.add(shelf, &folder, format!("shows no table of part {}", part.lineage), remove())
                    }
                }
            }
        }
        for part in record.parts.iter().filter(|part| self.parts.get(&part.lineage) != Some(part)) {
            let path = self.path.join(format!("part-{}.json", part.lineage));
            if fs::is_there(&path).at("read", &path)? {
                continue; // found where it lies
            }
            report.add(shelf, &path, "is gone, and a table needs it", Vec::new());
        }
        self.tables.insert(record.lineage, record);
        Ok(())
    }
}
