//! Why a table differs between two result folders: changed recipes of its ancestors, and changed raw files.

use serde::Serialize;

use super::HistoryError;
use super::ancestry::{Ancestry, Table};
use crate::campaign::Manifest;
use crate::store::Shelf;

/// Most raw files of each kind that are named.
const MOST_FILES: usize = 3;

/// Something that differs in B.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Cause {
    /// The table whose stage or input differs, by its name in A; a campaign's name for raw files.
    pub at: String,
    /// The difference, such as `threshold_sigma 5.0 -> 6.0`.
    pub change: String,
}

/// All differences between the origins of two tables, in the order of the dataflow.
pub fn causes(a: (&(Shelf, Ancestry), &Table), b: (&(Shelf, Ancestry), &Table)) -> Result<Vec<Cause>, HistoryError> {
    let ((shelf_a, history_a), (shelf_b, history_b)) = (a.0, b.0);
    let mut pairs = vec![(a.1.clone(), b.1.clone())];
    let mut next = 0;
    while let Some((of_a, of_b)) = pairs.get(next).cloned() {
        for (name, input) in history_a.inputs(&of_a) {
            let same_name = history_b.inputs(&of_b).iter().find(|(other, _)| other == name);
            if let Some(pair) =
                same_name.map(|(_, other)| (input.clone(), other.clone())).filter(|pair| !pairs.contains(pair))
            {
                pairs.push(pair);
            }
        }
        next += 1;
    }
    pairs.sort_by_key(|(of_a, _)| history_a.depth(of_a));
    let mut causes = Vec::new();
    let mut has_other_files = false;
    for (of_a, of_b) in &pairs {
        let at = history_a.label(of_a);
        let (stage_a, stage_b) = (history_a.stage(of_a), history_b.stage(of_b));
        let mut changes = stage_a.changes(stage_b);
        let has = |inputs: &[(String, Table)], name: &str| inputs.iter().any(|(other, _)| other == name);
        let (inputs_a, inputs_b) = (history_a.inputs(of_a), history_b.inputs(of_b));
        changes.extend(
            inputs_a
                .iter()
                .filter(|(name, _)| !has(inputs_b, name))
                .map(|(name, _)| format!("input {name}: only in A")),
        );
        changes.extend(
            inputs_b
                .iter()
                .filter(|(name, _)| !has(inputs_a, name))
                .map(|(name, _)| format!("input {name}: only in B")),
        );
        causes.extend(changes.into_iter().map(|change| Cause { at: at.clone(), change }));
        let is_source = stage_a.inputs.is_empty();
        has_other_files |= is_source && history_a.parts(of_a) != history_b.parts(of_b);
    }
    if has_other_files {
        causes.extend(raw_files(shelf_a, shelf_b)?);
    }
    causes.dedup();
    Ok(causes)
}

/// Raw files that differ, by the hashes that the runs recorded when they read them.
fn raw_files(a: &Shelf, b: &Shelf) -> Result<Vec<Cause>, HistoryError> {
    let mut causes = Vec::new();
    let (notes_a, notes_b) = (notes(a)?, notes(b)?);
    let mut names: Vec<&String> = notes_a.iter().chain(&notes_b).map(|(name, _)| name).collect();
    names.sort();
    names.dedup();
    let of = |notes: &[(String, Manifest)], name: &str| {
        notes.iter().find(|(other, _)| other == name).map(|(_, manifest)| manifest.clone()).unwrap_or_default()
    };
    for name in names {
        let (in_a, in_b) = (of(&notes_a, name), of(&notes_b, name));
        let only = |one: &Manifest, other: &Manifest| {
            let lacking = one.iter().filter(|(file, _)| other.get(file).is_none());
            lacking.map(|(file, _)| file.display().to_string()).collect::<Vec<_>>()
        };
        let is_other =
            |file: &std::path::Path, hash: blake3::Hash| in_b.get(file).is_some_and(|other| other.blake3 != hash);
        let other = in_a.iter().filter(|(file, record)| is_other(file, record.blake3));
        let other: Vec<String> = other.map(|(file, _)| file.display().to_string()).collect();
        for (what, files) in
            [("only in A", only(&in_a, &in_b)), ("only in B", only(&in_b, &in_a)), ("with other content", other)]
        {
            if !files.is_empty() {
                let more = if files.len() > MOST_FILES { ", ..." } else { "" };
                let listed = files[..files.len().min(MOST_FILES)].join(", ");
                let change = format!("raw files {what}: {} ({listed}{more})", files.len());
                causes.push(Cause { at: name.clone(), change });
            }
        }
    }
    Ok(causes)
}

/// The hashes of raw files that runs into a folder recorded, by campaign.
fn notes(shelf: &Shelf) -> Result<Vec<(String, Manifest)>, HistoryError> {
    let Ok(folders) = std::fs::read_dir(shelf.notes()) else { return Ok(Vec::new()) };
    let mut notes = Vec::new();
    for folder in folders.flatten() {
        if let Some(manifest) = Manifest::load(&folder.path())? {
            notes.push((folder.file_name().to_string_lossy().into_owned(), manifest));
        }
    }
    notes.sort_by(|a, b| a.0.cmp(&b.0));
    Ok(notes)
}
