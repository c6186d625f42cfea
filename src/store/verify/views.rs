//! The views: what a reader sees, compared with what the last run left.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use super::{Report, entries, name, strays};
use crate::store::disk as fs;
use crate::store::failure::{At, StoreError};
use crate::store::shelf::Shelf;
use crate::store::shown::{self, SHELF};
use crate::store::views::REJECTS_RECORD;

/// What to do about a view that shows the wrong table.
const SHOW_AGAIN: &str = "delete it (`periscope verify --repair` does), and the next `run` shows its table again";

/// Checks every view, and that none is missing.
pub fn check(shelf: &Shelf, report: &mut Report) -> Result<(), StoreError> {
    // Views of the last run; `None` where nothing can be compared with them.
    let views = match shelf.runs() {
        // A library that runs stages by itself keeps no record.
        Ok(runs) if runs.is_empty() => None,
        Ok(mut runs) => runs.pop().filter(|run| run.ended.is_some()).map(|run| run.views),
        // The damaged record is a finding already.
        Err(StoreError::Record { .. }) => None,
        Err(error) => return Err(error),
    };
    if views.is_none() {
        let what = "views were not compared with the record of the last run: it is missing, damaged, or has no end";
        report.notes.push(what.to_owned());
    }
    for path in entries(shelf.out())? {
        let (view, is_link) = (name(&path), fs::is_link(&path).at("read", &path)?);
        if view == SHELF {
            if is_link {
                let fix = "put the folder in its place, or make all of the result folder a link";
                report.add(shelf, &path, "is a link: `run` refuses it", Vec::new()).fixed_by(fix);
            }
        } else if is_link {
            link(shelf, &path, &view, views.as_ref(), report)?;
        } else if fs::is_folder(&path).at("read", &path)? {
            copy(shelf, &path, &view, report)?;
        }
    }
    for (view, target) in views.iter().flatten() {
        let path = shelf.out().join(view);
        // Whoever releases a table deletes its view and then prunes the shelf.
        let is_gone = fs::if_there(fs::symlink_metadata(&path)).at("read", &path)?.is_none();
        if is_gone && fs::is_folder(&shelf.out().join(target)).at("read", &path)? {
            let fix = "the next `run` shows it again; to release its table, `periscope tables --prune`";
            report.add(shelf, &path, "is gone: the last run left a view here", Vec::new()).fixed_by(fix);
        }
    }
    Ok(())
}

/// Checks a link: where it leads, and whether the last run left it so.
fn link(
    shelf: &Shelf,
    path: &Path,
    view: &str,
    views: Option<&BTreeMap<String, PathBuf>>,
    report: &mut Report,
) -> Result<(), StoreError> {
    let target = fs::read_link(path).at("read", path)?;
    // A link on the way would lead out of the shelf.
    let mut way = shelf.out().to_owned();
    let mut leaves = false;
    for step in &target {
        way.push(step);
        leaves |= fs::is_link(&way).at("read", &way)?;
    }
    let left = views.map(|views| views.get(view));
    let what = if !shown::is_table(&target) || leaves || !fs::is_folder(path).at("read", path)? {
        format!("leads to {}, where no table of this folder is", target.display())
    } else if left == Some(None) {
        "is a view that the last run did not leave".to_owned()
    } else if left.flatten().is_some_and(|left| *left != target) {
        format!("shows {}, which is another table than the last run left there", target.display())
    } else {
        return Ok(());
    };
    report.add(shelf, path, what, vec![path.to_owned()]).fixed_by(SHOW_AGAIN).of_view(view);
    Ok(())
}

/// Checks a folder in the place of a view: in a copy of a result folder it must hold what its table holds.
fn copy(shelf: &Shelf, path: &Path, view: &str, report: &mut Report) -> Result<(), StoreError> {
    let target = match shelf.target(view) {
        Ok(target) => target,
        // A finding already, where the record lies.
        Err(StoreError::Record { .. }) => return Ok(()),
        Err(error) => return Err(error),
    };
    let Some(files) = target.map(|target| shelf.files_of(&target)).transpose()?.flatten() else {
        if entries(path)?.iter().any(|file| file.extension().is_some_and(|extension| extension == "parquet")) {
            let what = "holds tables that no run left there, and readers may take them for results";
            report.add(shelf, path, what, Vec::new()).fixed_by("move it elsewhere");
        }
        return Ok(());
    };
    for (file, record) in &files {
        let before = report.findings.len();
        report.file(shelf, &path.join(file), record, vec![path.to_owned()])?;
        for finding in &mut report.findings[before..] {
            finding.fixed_by(SHOW_AGAIN).of_view(view);
        }
    }
    let names: BTreeSet<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
    strays(shelf, path, |file| file == REJECTS_RECORD || names.contains(file), report)
}
