//! Pieces of a part: stretches of its exposures, cut within files where these are large, and read by different processes.
//!
//! Each byte of a file is hashed by the piece that has it, so that the pieces together know the digest of all of it ([`tree_hash`]). What is odd about a piece (a file or record
//! that is to be set aside, first shots that tell nothing) ends it with [`StageError::Indivisible`]: the part is then read whole, as it would have been without pieces.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::Metadata;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::files::Files;
use super::part::{Reader, Share, content, items, unread};
use super::raw_file::{HashedStretch, Reading};
use super::survey::{Capture, Item, Job, Surveyed};
use crate::campaign::modified_ns;
use crate::campaign::tree_hash::{self, BLOCK_BYTES, Subtree};
use crate::signal::shot_spread::HEAD_SHOTS;
use crate::stages::source::{Piece, PieceFeed};
use crate::stages::stage::StageError;
use crate::store::Digest;
use crate::waveform::{CodeType, Payload};

/// A place between two exposures of a part: number of the capture, of its item, and of the exposure in that.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Place {
    capture: usize,
    item: usize,
    exposure: usize,
}

/// A piece, as the runtime passes it on.
#[derive(Serialize, Deserialize)]
struct Stretch {
    from: Place,
    to: Place,
    /// Its files as they were when it was cut.
    states: BTreeMap<PathBuf, State>,
    /// Of files of which it has a share: the bytes that it hashes.
    hashed: BTreeMap<PathBuf, Range<u64>>,
}

/// Size of a file, and time of its last change.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct State {
    bytes: u64,
    modified_ns: i64,
}

impl State {
    fn of(metadata: &Metadata) -> Self {
        Self { bytes: metadata.len(), modified_ns: modified_ns(metadata) }
    }
}

/// What a piece has learnt of its files.
#[derive(Serialize, Deserialize)]
struct Learnt {
    states: BTreeMap<PathBuf, State>,
    /// Of files that it has read to their end.
    digests: BTreeMap<PathBuf, Digest>,
    /// Of files of which it has read a share.
    subtrees: BTreeMap<PathBuf, Vec<Subtree>>,
}

/// Into how many pieces a part can be cut: none is less than a part of the campaign should be.
pub fn most_pieces(surveyed: &Surveyed<'_>, part: usize) -> Result<usize, String> {
    let captures = &surveyed.parts[part];
    if let Some((_, _, item)) = items(captures).find(|(_, _, item)| item.is_share()) {
        let file = item.exposure.file.display();
        return Err(format!(
            "{file} holds more than one capture, and who reads a share of it reads all of it for its digest"
        ));
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
    let files = Files::open(surveyed, job, Reading::Head);
    let files = files.map_err(|error| format!("{} {}", error.file.display(), error.reason))?;
    if files.records().any(|record| matches!(record.head.code_type, CodeType::F32 | CodeType::F64)) {
        let file = job.item.exposure.file.display();
        return Err(format!("{file} has codes in floating point, whose sums depend on the order of the shots"));
    }
    Ok(files)
}

/// The files of an item, if it can be cut between its exposures.
fn divisible(surveyed: &Surveyed<'_>, job: &Job<'_>) -> Result<Option<Files>, String> {
    let files = open(surveyed, job)?;
    if files.records().any(|record| matches!(record.payload, Payload::Decoded(_))) {
        return Err(format!("{} is text, which who opens it reads to its end", job.item.exposure.file.display()));
    }
    let is_large = |(_, bytes, _): &(_, u64, _)| *bytes >= 2 * BLOCK_BYTES;
    let is_one = !job.item.exposure.companions.is_empty() || files.exposures() < 2;
    Ok((!is_one && files.places(0).iter().all(is_large)).then_some(files))
}

/// A cut of a part, and where it cuts the files that it goes through.
type Cut = (Place, Vec<(PathBuf, u64)>);

/// Where a cut goes through a file.
fn place_of(files: &[(PathBuf, u64)], file: &Path) -> Option<u64> {
    files.iter().find(|(name, _)| name == file).map(|(_, at)| *at)
}

/// Cuts a part into so many pieces, or fewer, of about as many bytes.
pub fn cut(surveyed: &Surveyed<'_>, part: usize, count: usize) -> Result<Vec<Piece>, String> {
    let captures = &surveyed.parts[part];
    let total: u64 = captures.iter().map(Capture::bytes).sum();
    let wanted = |k: usize| (u128::from(total) * k as u128 / count as u128) as u64;
    let mut cuts: Vec<Cut> = vec![(Place::default(), Vec::new())];
    let (mut k, mut before) = (1, 0);
    for (capture, item_number, item) in items(captures) {
        let end = before + item.bytes;
        let job = Job { capture: &captures[capture], item, first_shot: 0 };
        let within = k < count && wanted(k) < end && item.bytes as u128 * count as u128 > u128::from(total);
        let files = if within { divisible(surveyed, &job)? } else { None };
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
                    (Place { capture, item: item_number, exposure }, places.collect())
                }
                // Before it or behind it, whichever is nearer.
                None => {
                    (Place { capture, item: item_number + usize::from(2 * at > item.bytes), exposure: 0 }, Vec::new())
                }
            };
            if cut.0 > cuts.last().expect("the start").0 {
                cuts.push(cut);
            }
            k += 1;
        }
        before = end;
    }
    let end = Place { capture: captures.len(), ..Place::default() };
    // A cut behind the last item of a capture is one before the next.
    cuts.iter_mut().for_each(|(place, _)| {
        if captures.get(place.capture).is_some_and(|capture| place.item == capture.items.len()) {
            *place = Place { capture: place.capture + 1, ..Place::default() };
        }
    });
    cuts.dedup_by_key(|(place, _)| *place);
    cuts.retain(|(place, _)| *place < end);
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
            let found = std::fs::metadata(root.path_of(file)).map_err(|error| error.to_string())?;
            states.insert(file.clone(), State::of(&found));
            if !whole {
                let start = if exposures.start == 0 { 0 } else { place_of(&from.1, file).unwrap_or(0) };
                let end =
                    if exposures.end == usize::MAX { found.len() } else { place_of(&to.1, file).unwrap_or(start) };
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
    let end = to.0.capture + usize::from(to.0 > Place { capture: to.0.capture, ..Place::default() });
    let files = states.keys().map(|file: &PathBuf| root.path_of(file)).collect();
    let stretch = Stretch { from: from.0, to: to.0, states, hashed };
    let stretch = serde_json::to_value(stretch).expect("places and names are plain data");
    Ok(Piece { captures: from.0.capture..end, bytes, files, shots, stretch })
}

/// The items between two places with their exposures, all of which are `0..usize::MAX`.
fn between(captures: &[Capture], from: Place, to: Place) -> impl Iterator<Item = (usize, &Item, Range<usize>)> {
    items(captures).filter_map(move |(capture, item_number, item)| {
        let at = |exposure| Place { capture, item: item_number, exposure };
        let start = if from >= at(0) { from.max(at(0)) } else { at(0) };
        let is_here = |place: Place| (place.capture, place.item) == (capture, item_number);
        let first = if is_here(start) { start.exposure } else { return None };
        let end = if is_here(to) {
            to.exposure
        } else if to > at(0) {
            usize::MAX
        } else {
            0
        };
        (first < end).then_some((capture, item, first..end))
    })
}

/// Reads a piece.
pub fn read_piece(
    surveyed: &Surveyed<'_>,
    part: usize,
    piece: &Piece,
    batch_bytes: usize,
    feed: &dyn PieceFeed,
) -> Result<Value, StageError> {
    let captures = &surveyed.parts[part];
    let campaign = &surveyed.campaigns[captures[0].campaign];
    let stretch = Stretch::deserialize(&piece.stretch)
        .map_err(|error| StageError::Refused(format!("a piece of the shard cannot be read: {error}")))?;
    check(surveyed, captures, &stretch.states, "it was planned; plan anew")?;
    let Stretch { from, to, states, hashed } = stretch;
    if from > (Place { capture: from.capture, ..Place::default() }) {
        read_head(surveyed, &captures[from.capture], Some(from), batch_bytes, feed)?;
    }
    let mut reader = Reader::new(surveyed, batch_bytes, feed);
    let share = |(index, item, exposures): (usize, _, Range<usize>)| {
        let is_whole = exposures == (0..usize::MAX);
        Share { index, item, of_file: (!is_whole).then_some((exposures, &hashed)) }
    };
    reader.read(captures, between(captures, from, to).map(share))?;
    if let Some(rejection) = reader.rejections.first() {
        let file = rejection.file.as_deref().unwrap_or_default();
        return Err(StageError::Indivisible(format!("{file}: {}", rejection.reason)));
    }
    let digests = reader.digests.into_iter().map(|((_, file), digest)| (file, digest));
    let mut learnt = Learnt { digests: digests.collect(), subtrees: BTreeMap::new(), states };
    for HashedStretch { file, subtrees, metadata } in reader.stretches {
        let now = std::fs::metadata(campaign.path_of(&file));
        if now.is_ok_and(|now| State::of(&now) == State::of(&metadata)) {
            learnt.subtrees.insert(file, subtrees);
        }
    }
    let is_read = |file: &&PathBuf| learnt.digests.contains_key(*file) || learnt.subtrees.contains_key(*file);
    match learnt.states.keys().find(|file| !is_read(file)) {
        Some(file) => Err(unread(campaign, file)),
        None => Ok(serde_json::to_value(learnt).expect("names and digests are plain data")),
    }
}

/// Reads the first shots of each vertical range of a capture, as many as later ones are judged by; up to a place in it, behind which its last range may go on.
pub fn read_head(
    surveyed: &Surveyed<'_>,
    capture: &Capture,
    to: Option<Place>,
    batch_bytes: usize,
    feed: &dyn PieceFeed,
) -> Result<(), StageError> {
    let before = |number: usize| match to {
        Some(to) if number > to.item => 0,
        Some(to) if number == to.item => to.exposure,
        _ => usize::MAX,
    };
    let items: Vec<(usize, &Item)> = capture.items.iter().enumerate().collect();
    for range in items.chunk_by(|a, b| a.1.exposure.range == b.1.exposure.range) {
        let mut is_begun = false;
        let is_primed = |is_begun| if is_begun { feed.is_primed() } else { Ok(false) };
        for &(number, item) in range.iter().filter(|(number, _)| before(*number) > 0) {
            if is_primed(is_begun)? {
                break;
            }
            let job = Job { capture, item, first_shot: 0 };
            let odd = |error: super::raw_file::Bad| {
                StageError::Indivisible(format!("{}: {}", error.file.display(), error.reason))
            };
            let mut files = Files::open(surveyed, &job, Reading::Head).map_err(odd)?;
            let (end, bytes) = (files.exposures().min(before(number)), files.exposure_bytes(&job));
            let per_batch = (batch_bytes / bytes.max(1)).clamp(1, HEAD_SHOTS);
            for start in (0..end).step_by(per_batch) {
                if is_primed(is_begun)? {
                    break;
                }
                let exposures = start..end.min(start + per_batch);
                let credit = feed.reserve(bytes * exposures.len())?;
                feed.send(files.rows(surveyed, &job, exposures).map_err(odd)?.to_batch(), credit)?;
                is_begun = true;
            }
        }
        let goes_on = to.is_some_and(|to| range.iter().any(|(number, _)| *number == to.item));
        if goes_on && is_begun && !is_primed(is_begun)? {
            let file = range[0].1.exposure.file.display();
            return Err(StageError::Indivisible(format!(
                "{file}: its first shots do not tell by what to judge others"
            )));
        }
        if is_begun {
            feed.forget()?;
        }
    }
    Ok(())
}

/// Refuses files that are not as they were.
fn check(
    surveyed: &Surveyed<'_>,
    captures: &[Capture],
    states: &BTreeMap<PathBuf, State>,
    since: &str,
) -> Result<(), StageError> {
    let campaign = &surveyed.campaigns[captures[0].campaign];
    for (file, state) in states {
        let path = campaign.path_of(file);
        match std::fs::metadata(&path) {
            Ok(found) if State::of(&found) == *state => {}
            Ok(_) => {
                let path = path.display();
                return Err(StageError::Refused(format!(
                    "{path} has changed since {since}, or restore the file with its time"
                )));
            }
            Err(error) => return Err(StageError::Refused(format!("{}: {error}", path.display()))),
        }
    }
    Ok(())
}

/// The content of a part, from what its pieces have learnt.
pub fn join(surveyed: &Surveyed<'_>, part: usize, learnt: &[Value]) -> Result<Digest, StageError> {
    let captures = &surveyed.parts[part];
    let index = captures[0].campaign;
    let mut digests: BTreeMap<PathBuf, Digest> = BTreeMap::new();
    let mut states: BTreeMap<PathBuf, State> = BTreeMap::new();
    let mut subtrees: BTreeMap<PathBuf, Vec<Subtree>> = BTreeMap::new();
    for piece in learnt {
        let piece = Learnt::deserialize(piece)
            .map_err(|error| StageError::Refused(format!("a piece of the part cannot be read: {error}")))?;
        check(surveyed, captures, &piece.states, "a piece of it was read; plan anew")?;
        states.extend(piece.states);
        digests.extend(piece.digests);
        piece.subtrees.into_iter().for_each(|(file, some)| subtrees.entry(file).or_default().extend(some));
    }
    for (file, subtrees) in subtrees {
        let joined = tree_hash::join(subtrees, states[&file].bytes);
        let path = surveyed.campaigns[index].path_of(&file);
        let joined = joined.ok_or_else(|| {
            StageError::Refused(format!("{}: its pieces do not make up the file; plan anew", path.display()))
        })?;
        digests.insert(file, joined.into());
    }
    for (file, digest) in &digests {
        surveyed.hold(index, file, (*digest).into())?;
        let found = std::fs::metadata(surveyed.campaigns[index].path_of(file));
        let found = found.map_err(|_| unread(&surveyed.campaigns[index], file))?;
        // As it was when the last piece was looked at, or it goes down in no notes.
        if states.get(file as &Path) == Some(&State::of(&found)) {
            surveyed.record(index, file, (*digest).into(), &found);
        }
    }
    content(surveyed, captures, digests.into_iter().map(|(file, digest)| ((index, file), digest)).collect())
}
