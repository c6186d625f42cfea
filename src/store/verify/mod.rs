//! Checks that a result folder is what runs wrote into it: every byte of its tables and records, and every lineage.
//!
//! Nothing is written here. Each damaged file is named with its place and its fix: delete what [`Finding::remove`]
//! lists, and run again.

mod chain;
mod stage_folder;
mod views;

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::damage::{self, Place};
use super::failure::{At, StoreError};
use super::parquet::FileRecord;
use super::record;
use super::runs::RunRecord;
use super::shelf::{Shelf, StageId};
use super::views::{REJECTS_RECORD, RejectsRecord};
use super::{Digest, TableRecord, sweep};
use crate::store::disk as fs;
use stage_folder::StageFolder;

/// Something wrong, and how to fix it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// File, relative to the result folder.
    pub file: PathBuf,
    /// Tables that contain it, by their views.
    pub tables: Vec<String>,
    /// What is wrong, in words.
    pub what: String,
    /// Where in the file, if it is a table.
    pub damage: Option<Place>,
    /// What to do.
    pub fix: String,
    /// Files to delete, so that the next run makes the damaged ones again.
    #[serde(skip)]
    pub remove: Vec<PathBuf>,
}

impl Finding {
    /// With another fix.
    fn fixed_by(&mut self, fix: &str) -> &mut Self {
        fix.clone_into(&mut self.fix);
        self
    }

    /// Of this view.
    fn of_view(&mut self, view: &str) -> &mut Self {
        self.tables = vec![view.to_owned()];
        self
    }
}

/// Numbers of checked objects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Whole tables.
    pub tables: usize,
    /// Parts.
    pub parts: usize,
    /// Files of tables.
    pub files: usize,
    /// Their bytes.
    pub bytes: u64,
    /// Run records.
    pub runs: usize,
    /// Parts whose lineage follows from those of their inputs on the shelf.
    pub followed: usize,
}

/// Outcome of a verification.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// What is wrong.
    pub findings: Vec<Finding>,
    /// What a user should know although it is no fault.
    pub notes: Vec<String>,
    /// Numbers of checked objects.
    pub counts: Counts,
    /// Stages without inputs, with the lineages of their parts: they derive from files outside the folder.
    pub sources: Vec<(StageId, Vec<Digest>)>,
    /// The newest run that can be read.
    pub run: Option<RunRecord>,
}

/// Fix for what the next run makes again.
const FIX: &str = "delete it (`periscope verify --repair` does), and the next `run` makes it again";

impl Report {
    /// Adds what another found after this one, of files alone.
    fn append(&mut self, mut other: Self) {
        self.findings.append(&mut other.findings);
        self.notes.append(&mut other.notes);
        self.counts.parts += other.counts.parts;
        self.counts.files += other.counts.files;
        self.counts.bytes += other.counts.bytes;
    }

    /// Adds a finding; `file` is absolute.
    fn add(&mut self, shelf: &Shelf, file: &Path, what: impl ToString, remove: Vec<PathBuf>) -> &mut Finding {
        let file = file.strip_prefix(shelf.out()).unwrap_or(file).to_owned();
        let fix = if remove.is_empty() { "the next `run` makes it again" } else { FIX };
        let what = what.to_string();
        self.findings.push(Finding { file, tables: Vec::new(), what, damage: None, fix: fix.to_owned(), remove });
        self.findings.last_mut().expect("pushed above")
    }

    /// Compares a table file with its record.
    fn file(
        &mut self,
        shelf: &Shelf,
        path: &Path,
        file: &FileRecord,
        remove: Vec<PathBuf>,
    ) -> Result<bool, StoreError> {
        self.counts.files += 1;
        self.counts.bytes += file.bytes;
        let Some(damage) = damage::find(path, file)? else {
            return Ok(true);
        };
        let what = format!("is damaged: {}", damage.place);
        self.add(shelf, path, what, remove).damage = Some(damage.place);
        Ok(false)
    }

    /// Reads a record; on failure, adds a finding and returns `None`.
    fn record<T: serde::de::DeserializeOwned>(
        &mut self,
        shelf: &Shelf,
        path: &Path,
        remove: Vec<PathBuf>,
    ) -> Result<Option<T>, StoreError> {
        match record::read(path) {
            Ok(Some(record)) => return Ok(Some(record)),
            Ok(None) => self.add(shelf, path, "is gone", remove),
            Err(StoreError::Record { source, .. }) => self.add(shelf, path, format!("is damaged: {source}"), remove),
            Err(error) => return Err(error),
        };
        Ok(None)
    }
}

/// Checks everything on a shelf and in its views.
///
/// # Errors
/// When something cannot be read. Damage is a finding, not an error.
pub fn verify(shelf: &Shelf) -> Result<Report, StoreError> {
    let mut report = Report::default();
    let mut stages = Vec::new();
    for path in entries(&shelf.root())? {
        let name = name(&path);
        match name.as_str() {
            // Not checked: a source reads its own notes, a shard's worker reads the shard, and a lock has no content to
            // check.
            "lock" | "notes" | "shards" => {}
            "runs" => runs(shelf, &path, &mut report)?,
            _ if sweep::is_unfinished(name.as_ref()) => report.notes.push(left_over(&path)),
            _ if is_there(&path.join(REJECTS_RECORD))? || name.starts_with("rejects-") => {
                rejects(shelf, &path, &mut report)?
            }
            _ if fs::is_folder(&path).at("read", &path)? => stages.push(StageFolder::read(shelf, path, &mut report)?),
            _ => report.notes.push(format!("{} is none of periscope's files", path.display())),
        }
    }
    views::check(shelf, &mut report)?;
    chain::follow(shelf, &stages, &mut report);
    report.sources = stages
        .iter()
        .filter_map(|stage| {
            Some((stage.id.clone().filter(|id| id.inputs.is_empty())?, stage.parts.keys().copied().collect()))
        })
        .collect();
    name_tables(shelf, &mut report);
    Ok(report)
}

fn is_there(path: &Path) -> Result<bool, StoreError> {
    fs::is_there(path).at("read", path)
}

/// Deletes damaged files.
///
/// # Errors
/// When one cannot be deleted.
pub fn repair(findings: &[Finding]) -> Result<(), StoreError> {
    for path in findings.iter().flat_map(|finding| &finding.remove) {
        let Some(metadata) = fs::if_there(fs::symlink_metadata(path)).at("read", path)? else {
            continue; // went with another finding
        };
        if metadata.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.at("remove", path)?;
    }
    Ok(())
}

/// Entries of a folder, sorted by name; none if it does not exist.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let entries = fs::read_dir(folder).at("read", folder)?.map(|entry| Ok(entry.at("read", folder)?.path()));
    let mut entries = entries.collect::<Result<Vec<PathBuf>, StoreError>>()?;
    // Paths of one folder stand in the order of their bytes, which takes a fraction of the time.
    entries.sort_unstable_by(|a, b| a.as_os_str().cmp(b.as_os_str()));
    Ok(entries)
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn left_over(path: &Path) -> String {
    format!("{} was left by a run that was killed, or is under way; the next one clears it away", path.display())
}

fn runs(shelf: &Shelf, folder: &Path, report: &mut Report) -> Result<(), StoreError> {
    for path in entries(folder)? {
        report.counts.runs += 1;
        let run = report.record::<RunRecord>(shelf, &path, vec![path.clone()])?;
        if run.is_none() {
            "delete it: the tables do not depend on it"
                .clone_into(&mut report.findings.last_mut().expect("added above").fix);
        }
        report.run = run.or(report.run.take());
    }
    Ok(())
}

fn rejects(shelf: &Shelf, folder: &Path, report: &mut Report) -> Result<(), StoreError> {
    let remove = || vec![folder.to_owned()];
    let record = folder.join(REJECTS_RECORD);
    let Some(rejects) = report.record::<RejectsRecord>(shelf, &record, remove())? else {
        return Ok(());
    };
    for (file, recorded) in &rejects.files {
        report.file(shelf, &folder.join(file), recorded, remove())?;
    }
    strays(shelf, folder, |file| file == REJECTS_RECORD || rejects.files.contains_key(file), report)?;
    Ok(())
}

/// Adds to each finding the tables that show it.
fn name_tables(shelf: &Shelf, report: &mut Report) {
    let views = entries(shelf.out()).into_iter().flatten().map(|view| name(&view));
    // A view whose record cannot be read shows nothing; the record is a finding itself.
    let targets: Vec<(String, PathBuf)> = views
        .filter_map(|view| Some((shelf.target(&view).ok()??, view)))
        .map(|(target, view)| (view, target))
        .collect();
    for finding in &mut report.findings {
        let (folder, file) = (finding.file.parent(), name(&finding.file));
        let shows = |target: &PathBuf| {
            // `.shelf/<stage>/table-<lineage>/<table>`, or `.shelf/rejects-<digest>`.
            let stage = target.iter().take(2).collect::<PathBuf>();
            let table = name(target);
            let of_table = file.ends_with(&format!(".{table}.parquet")) || !file.ends_with(".parquet");
            finding.file.starts_with(target) || (folder == Some(stage.as_path()) && of_table)
        };
        if !finding.tables.is_empty() {
            continue;
        }
        finding.tables = targets.iter().filter(|(_, target)| shows(target)).map(|(view, _)| view.clone()).collect();
    }
}

/// Reports what stands in the folder of a table and is none of its files: readers take all of them for its rows.
fn strays(
    shelf: &Shelf,
    folder: &Path,
    is_known: impl Fn(&str) -> bool,
    report: &mut Report,
) -> Result<(), StoreError> {
    for path in entries(folder)?.into_iter().filter(|path| !is_known(&name(path))) {
        let what = "is no file of this table, and readers of the folder may take it for one";
        report.add(shelf, &path, what, Vec::new()).fixed_by("move it elsewhere");
    }
    Ok(())
}

/// Whether two paths are links to one file.
fn same_file(a: &Path, b: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let id = |path: &Path| fs::metadata(path).ok().map(|file| (file.dev(), file.ino()));
    id(a).is_some() && id(a) == id(b)
}

impl TableRecord {
    /// Whether its lineage is that of its parts.
    fn holds(&self) -> bool {
        self.lineage == Self::lineage_of(self.parts.iter().map(|part| &part.lineage))
    }
}
