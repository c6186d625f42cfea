//! Where a part is cut, and what keeps it whole.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use super::{Boundary, Stretch, between};
use crate::campaign::Stamp;
use crate::campaign::tree_hash::BLOCK_BYTES;
use crate::stages::ingest::files::Files;
use crate::stages::ingest::part::items;
use crate::stages::ingest::raw_file::Reading;
use crate::stages::ingest::survey::{Capture, Item, Job, Surveyed};
use crate::stages::source::Piece;
use crate::waveform::{CodeType, Payload};

/// Into how many pieces a part can be cut: none is less than a part of the campaign should be.
pub fn most_pieces(surveyed: &Surveyed<'_>, part: usize) -> Result<usize, String> {
    let captures = &surveyed.parts[part];
    let mut files = BTreeSet::new();
    for (_, _, item) in items(captures) {
        let of_item: BTreeSet<&PathBuf> = item.exposure.files().collect();
        if item.is_share() || of_item.into_iter().any(|file| !files.insert(file)) {
            let file = item.exposure.file.display();
            return Err(format!(
                "{file}, or its reference, holds more than one capture: it is hashed by who reads any of it"
            ));
        }
    }
    for capture in captures {
        let job = Job { capture, item: &capture.items[0], first_shot: 0 };
        open(surveyed, &job)?;
    }
    let bytes: u64 = captures.iter().map(Capture::bytes).sum();
    Ok((bytes / surveyed.campaigns[captures[0].campaign].part_bytes.max(1)) as usize)
}

/// Opens the files of an item, if their shots add up to the same in any order.
fn open(surveyed: &Surveyed<'_>, job: &Job<'_>) -> Result<Files, String> {
    let files = Files::open(surveyed, job, Reading::Unhashed);
    let files = files.map_err(|error| format!("{} {}", error.file.display(), error.reason))?;
    if files.records().any(|record| matches!(record.head.code_type, CodeType::F32 | CodeType::F64)) {
        let file = job.item.exposure.file.display();
        return Err(format!("{file} has codes in floating point, whose sums depend on the order of the shots"));
    }
    Ok(files)
}

/// Why an item is not cut between its exposures, if it is not.
fn kept_whole(files: &Files, item: &Item) -> Option<String> {
    let file = item.exposure.file.display();
    if files.exposures() < 2 {
        return Some(format!("{file} has one exposure"));
    }
    if !item.exposure.companions.is_empty() {
        return Some(format!("{file} has its samples in a second file, which is hashed with it"));
    }
    if files.records().any(|record| matches!(record.payload, Payload::Decoded(_))) {
        return Some(format!("{file} is text, which who opens it reads to its end"));
    }
    let is_small = |(_, bytes, _): &(_, u64, _)| *bytes < 2 * BLOCK_BYTES;
    let is_kept = files.places(0).iter().any(is_small);
    is_kept.then(|| format!("{file} or its reference is smaller than two blocks of its digest"))
}

/// A cut of a part, and where it cuts the files that it goes through.
type Cut = (Boundary, Vec<(PathBuf, u64)>);

/// Where a cut goes through a file.
fn place_of(files: &[(PathBuf, u64)], file: &Path) -> Option<u64> {
    files.iter().find(|(name, _)| name == file).map(|(_, at)| *at)
}

/// Cuts a part into `count` pieces, or fewer, of about as many bytes. It cuts within items that are larger than a
/// piece, if they can be cut, else between items.
pub fn cut(surveyed: &Surveyed<'_>, part: usize, count: usize) -> Result<Vec<Piece>, String> {
    let captures = &surveyed.parts[part];
    let total: u64 = captures.iter().map(Capture::bytes).sum();
    let wanted = |k: usize| (u128::from(total) * k as u128 / count as u128) as u64;
    let mut cuts: Vec<Cut> = vec![(Boundary::default(), Vec::new())];
    let (mut k, mut before, mut uncut) = (1, 0, None);
    for (capture, item_number, item) in items(captures) {
        let end = before + item.bytes;
        let job = Job { capture: &captures[capture], item, first_shot: 0 };
        let within = k < count && wanted(k) < end && u128::from(item.bytes) * count as u128 > u128::from(total);
        let files = if within { Some(open(surveyed, &job)?) } else { None };
        let kept = files.as_ref().and_then(|files| kept_whole(files, item));
        let files = files.filter(|_| kept.is_none());
        uncut = uncut.or(kept);
        while k < count && wanted(k) < end {
            let at = wanted(k) - before;
            let cut = match &files {
                Some(files) => {
                    let exposure = (u128::from(at) * files.exposures() as u128 / u128::from(item.bytes)) as usize;
                    let exposure = exposure.clamp(1, files.exposures() - 1);
                    let places = files.places(exposure).into_iter();
                    let block = |bytes: u64, at: u64| {
                        (at - at % BLOCK_BYTES).clamp(BLOCK_BYTES, bytes - 1 - (bytes - 1) % BLOCK_BYTES)
                    };
                    // Records may stand in another order than exposures; blocks are hashed in theirs.
                    let last = cuts.last().filter(|(place, _)| (place.capture, place.item) == (capture, item_number));
                    let least = |file| last.and_then(|(_, files)| place_of(files, file)).unwrap_or(0);
                    let places = places.map(|(file, bytes, at)| (file.clone(), block(bytes, at).max(least(file))));
                    (Boundary { capture, item: item_number, exposure }, places.collect())
                }
                // Before it or behind it, whichever is nearer.
                None => (
                    Boundary { capture, item: item_number + usize::from(2 * at > item.bytes), exposure: 0 },
                    Vec::new(),
                ),
            };
            if cut.0 > cuts.last().expect("the start").0 {
                cuts.push(cut);
            }
            k += 1;
        }
        before = end;
    }
    let end = Boundary { capture: captures.len(), ..Boundary::default() };
    // A cut behind the last item of a capture is one before the next.
    cuts.iter_mut().for_each(|(place, _)| {
        if captures.get(place.capture).is_some_and(|capture| place.item == capture.items.len()) {
            *place = Boundary { capture: place.capture + 1, ..Boundary::default() };
        }
    });
    cuts.dedup_by_key(|(place, _)| *place);
    cuts.retain(|(place, _)| *place < end);
    if let (1, Some(why)) = (cuts.len(), uncut) {
        return Err(why);
    }
    cuts.push((end, Vec::new()));
    cuts.windows(2).map(|cut| piece(surveyed, captures, &cut[0], &cut[1])).collect()
}

/// What lies between two cuts.
fn piece(surveyed: &Surveyed<'_>, captures: &[Capture], from: &Cut, to: &Cut) -> Result<Piece, String> {
    let (mut states, mut hashed, mut shots) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
    let mut bytes = 0;
    for (index, item, exposures) in between(captures, from.0, to.0) {
        let (capture, root) = (&captures[index], &surveyed.campaigns[captures[index].campaign]);
        let whole = exposures == (0..usize::MAX);
        let mut share = 0;
        for file in item.exposure.files().collect::<BTreeSet<_>>() {
            let metadata = std::fs::metadata(root.path_of(file)).map_err(|error| error.to_string())?;
            states.insert(file.clone(), Stamp::of(&metadata));
            if !whole {
                let start = if exposures.start == 0 { 0 } else { place_of(&from.1, file).unwrap_or(0) };
                let end =
                    if exposures.end == usize::MAX { metadata.len() } else { place_of(&to.1, file).unwrap_or(start) };
                hashed.insert(file.clone(), start..end.max(start));
                share += end.max(start) - start;
            }
        }
        if !whole {
            let end = if exposures.end == usize::MAX {
                open(surveyed, &Job { capture, item, first_shot: 0 })?.exposures()
            } else {
                exposures.end
            };
            shots.insert(item.exposure.file.clone(), exposures.start..end);
        }
        bytes += if whole { item.bytes } else { share };
    }
    let root = &surveyed.campaigns[captures[0].campaign];
    let end = to.0.capture + usize::from(to.0 > Boundary { capture: to.0.capture, ..Boundary::default() });
    let files = states.keys().map(|file: &PathBuf| root.path_of(file)).collect();
    let stretch = Stretch { from: from.0, to: to.0, states, hashed };
    let stretch = serde_json::to_value(stretch).expect("places and names are plain data");
    Ok(Piece { captures: from.0.capture..end, bytes, files, shots, stretch })
}
