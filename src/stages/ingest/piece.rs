//! Pieces of a part: stretches of its exposures, cut within files where these are large, and read by different
//! processes.
//!
//! Each byte of a file is hashed by the piece that has it, so that the pieces together give the digest of the whole
//! ([`tree_hash`]). An exception in a piece (a rejected file or record, first shots without information) ends it
//! with [`StageError::Indivisible`]: the part is then read whole, as it would have been without pieces.

mod cut;

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::files::Files;
use super::part::{INDEX_ROWS, Reader, Share, content, items, unread};
use super::raw_file::{Bad, HashedStretch, Reading};
use super::runs::Runs;
use super::survey::{Capture, Item, Job, Surveyed};
use super::template::Content;
use crate::campaign::Stamp;
use crate::campaign::tree_hash::{self, Subtree};
use crate::signal::shot_spread::HEAD_SHOTS;
use crate::stages::source::{Feed, Piece, PieceFeed};
use crate::stages::stage::{Rejection, StageError};
use crate::store::Digest;
use crate::store::disk;
pub use cut::{cut, most_pieces};

/// A place between two exposures of a part: number of the capture, of its item, and of the exposure in that.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Boundary {
    capture: usize,
    item: usize,
    exposure: usize,
}

/// A piece, as the runtime passes it on.
#[derive(Serialize, Deserialize)]
struct Stretch {
    from: Boundary,
    to: Boundary,
    /// Its files as they were when it was cut.
    states: BTreeMap<PathBuf, Stamp>,
    /// Of files that it shares with other pieces: the bytes that it hashes.
    hashed: BTreeMap<PathBuf, Range<u64>>,
}

/// What a piece has learnt of its files.
#[derive(Serialize, Deserialize)]
struct Learnt {
    states: BTreeMap<PathBuf, Stamp>,
    /// Of files that it has read to their end.
    digests: BTreeMap<PathBuf, Digest>,
    /// Of files that it has read in part.
    subtrees: BTreeMap<PathBuf, Vec<Subtree>>,
    /// Samples at the rails of each of its rows, in order: an index has them, and its other columns follow from heads.
    clipped: Runs,
}

/// The items between two places with their exposures; `0..usize::MAX` stands for all.
fn between(captures: &[Capture], from: Boundary, to: Boundary) -> impl Iterator<Item = (usize, &Item, Range<usize>)> {
    items(captures).filter_map(move |(capture, item_number, item)| {
        let at = |exposure| Boundary { capture, item: item_number, exposure };
        let start = from.max(at(0));
        let is_here = |place: Boundary| (place.capture, place.item) == (capture, item_number);
        let end = match to {
            to if is_here(to) => to.exposure,
            to if to > at(0) => usize::MAX,
            _ => 0,
        };
        (is_here(start) && start.exposure < end).then_some((capture, item, start.exposure..end))
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
    if from > (Boundary { capture: from.capture, ..Boundary::default() }) {
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
    let clipped = reader.clipped;
    let mut learnt = Learnt { digests: digests.collect(), subtrees: BTreeMap::new(), states, clipped };
    for HashedStretch { file, subtrees, metadata } in reader.stretches {
        let now = disk::metadata(campaign.path_of(&file));
        if now.is_ok_and(|now| Stamp::of(&now) == Stamp::of(&metadata)) {
            learnt.subtrees.insert(file, subtrees);
        }
    }
    let is_read = |file: &&PathBuf| learnt.digests.contains_key(*file) || learnt.subtrees.contains_key(*file);
    match learnt.states.keys().find(|file| !is_read(file)) {
        Some(file) => Err(unread(campaign, file)),
        None => Ok(serde_json::to_value(learnt).expect("names and digests are plain data")),
    }
}

/// Reads the first shots of each vertical range of a capture, as many as later ones are judged by; up to a place in it,
/// behind which its last range may go on.
pub fn read_head(
    surveyed: &Surveyed<'_>,
    capture: &Capture,
    to: Option<Boundary>,
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
            let odd = |error: Bad| match error.rejection(surveyed, &job) {
                Ok(Rejection { file, reason, .. }) => {
                    StageError::Indivisible(format!("{}: {reason}", file.as_deref().unwrap_or_default()))
                }
                Err(refused) => refused,
            };
            let mut files = Files::open(surveyed, &job, Reading::Unhashed).map_err(odd)?;
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
                "{file}: its first shots do not determine the levels that later shots are judged by"
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
    states: &BTreeMap<PathBuf, Stamp>,
    since: &str,
) -> Result<(), StageError> {
    let campaign = &surveyed.campaigns[captures[0].campaign];
    for (file, state) in states {
        let path = campaign.path_of(file);
        match disk::metadata(&path) {
            Ok(metadata) if Stamp::of(&metadata) == *state => {}
            Ok(_) => {
                return Err(StageError::Refused(format!("{} has changed since {since}", path.display())));
            }
            Err(error) => return Err(StageError::Refused(format!("{}: {error}", path.display()))),
        }
    }
    Ok(())
}

/// The content of a part, from what its pieces have learnt; stores its index, if that is wanted.
pub fn join(surveyed: &Surveyed<'_>, part: usize, learnt: &[Value], feed: &dyn Feed) -> Result<Digest, StageError> {
    let captures = &surveyed.parts[part];
    let index = captures[0].campaign;
    let mut digests: BTreeMap<PathBuf, Digest> = BTreeMap::new();
    let mut states: BTreeMap<PathBuf, Stamp> = BTreeMap::new();
    let mut subtrees: BTreeMap<PathBuf, Vec<Subtree>> = BTreeMap::new();
    let mut clipped: Vec<Runs> = Vec::new();
    for piece in learnt {
        let piece = Learnt::deserialize(piece)
            .map_err(|error| StageError::Refused(format!("a piece of the part cannot be read: {error}")))?;
        check(surveyed, captures, &piece.states, "a piece of it was read; plan anew")?;
        states.extend(piece.states);
        digests.extend(piece.digests);
        clipped.push(piece.clipped);
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
        let metadata = disk::metadata(surveyed.campaigns[index].path_of(file));
        let metadata = metadata.map_err(|_| unread(&surveyed.campaigns[index], file))?;
        // As it was when the last piece was looked at, or it goes down in no notes.
        if states.get(file as &Path) == Some(&Stamp::of(&metadata)) {
            surveyed.record(index, file, (*digest).into(), &metadata);
        }
    }
    if feed.stores() {
        let mut clipped = clipped.iter().flat_map(Runs::cells);
        store(surveyed, captures, &digests, &mut clipped, feed)?;
        check(surveyed, captures, &states, "a piece of it was read; plan anew")?;
    }
    content(surveyed, captures, digests.into_iter().map(|(file, digest)| ((index, file), digest)).collect())
}

/// Stores the index of a part from the heads of its files, and from what its pieces saw of the samples.
fn store(
    surveyed: &Surveyed<'_>,
    captures: &[Capture],
    digests: &BTreeMap<PathBuf, Digest>,
    clipped: &mut dyn Iterator<Item = Option<i32>>,
    feed: &dyn Feed,
) -> Result<(), StageError> {
    let digest = |file: &str| digests.get(Path::new(file)).map(|digest| digest.to_string().into());
    let mut shots: BTreeMap<usize, i32> = BTreeMap::new();
    for (number, _, item) in items(captures) {
        let first_shot = if item.is_numbered() { 0 } else { shots.get(&number).copied().unwrap_or(0) };
        let job = Job { capture: &captures[number], item, first_shot };
        let refused = |error: Bad| StageError::Refused(format!("{}: {}", error.file.display(), error.reason));
        let files = Files::open(surveyed, &job, Reading::Unhashed).map_err(refused)?;
        for start in (0..files.exposures()).step_by(INDEX_ROWS) {
            let exposures = start..files.exposures().min(start + INDEX_ROWS);
            let rows = files
                .rows_of(surveyed, &job, exposures, &mut (&mut *clipped).map(Content::Clipped))
                .map_err(refused)?;
            feed.store(rows.to_index(&rows.to_batch(), digest))?;
        }
        *shots.entry(number).or_insert(0) += files.exposures() as i32;
    }
    Ok(())
}
