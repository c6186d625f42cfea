//! Which captures there are, in which files, and how they are cut into parts: known before any sample is read.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::Metadata;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use super::blocks::Blocks;
use super::content::{self, FileDigests};
use super::record::Record;
use crate::campaign::{Axis, Campaign, Exposure, FileState, LeftOut, Role, closes_part, hash_file, left_out};
use crate::formats;
use crate::stages::source::SourcePart;
use crate::stages::stage::StageError;
use crate::store::Digest;
use crate::store::disk;
use crate::units::PatchId;
use crate::waveform;

/// One file's share of a capture.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Item {
    /// The exposure (or exposures) as the campaign's rules see them.
    pub exposure: Exposure,
    /// Records of the file that belong here with their shots, where the file's axes hold more than shots; else all.
    pub records: Option<Vec<(usize, i32)>>,
    /// Bytes to read, the reference's file included.
    pub bytes: u64,
}

impl Item {
    /// Whether other items may hold the rest of its file.
    pub fn is_share(&self) -> bool {
        self.records.is_some() || self.exposure.segment.is_some()
    }

    /// Whether its files, or the rules, say which shots its exposures are; else they are counted as they come.
    pub fn is_numbered(&self) -> bool {
        self.exposure.shot.is_some() || self.records.is_some()
    }
}

/// One capture: a patch lit, a patch seen, by one sensor; for other roles than scene, one run of shots.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Capture {
    /// Position of the campaign in the run.
    pub campaign: usize,
    /// What was captured.
    pub role: Role,
    /// Which run of shots, for other roles than scene.
    pub run: Option<String>,
    /// Sensor.
    pub sensor: String,
    /// Patch lit.
    pub lit: PatchId,
    /// Patch seen.
    pub seen: PatchId,
    /// Its files, in order.
    pub items: Vec<Item>,
}

/// An item of a capture that is to be read.
pub struct Job<'a> {
    pub capture: &'a Capture,
    pub item: &'a Item,
    /// Number of the item's first exposure within its capture, where the files do not say.
    pub first_shot: i32,
}

/// What identifies a capture, in the order of the tables: campaign, sensor, smaller and larger patch, role, run, lit.
/// So reciprocal captures stand side by side.
type Order = (usize, String, PatchId, PatchId, Role, Option<String>, PatchId);

impl Capture {
    /// Raw bytes.
    pub fn bytes(&self) -> u64 {
        self.items.iter().map(|item| item.bytes).sum()
    }

    /// Name of the capture and its reciprocal together: parts are cut only between such pairs.
    fn pair_key(&self, campaigns: &[Campaign]) -> String {
        let (low, high) = (self.lit.min(self.seen), self.lit.max(self.seen));
        let run = self.run.as_ref().map_or(String::new(), |run| format!("/{run}"));
        format!("{}/{}/{low}/{high}/{}{run}", campaigns[self.campaign].name, self.sensor, self.role.name())
    }
}

/// The campaigns, surveyed.
pub struct Surveyed<'a> {
    /// The campaigns.
    pub campaigns: &'a [Campaign],
    /// Captures of each part.
    pub parts: Vec<Vec<Capture>>,
    /// The same as the runtime sees them.
    pub source_parts: Vec<SourcePart>,
    /// What the campaigns leave out.
    pub left_out: Vec<LeftOut>,
    /// What is on record of the files of each campaign.
    pub records: Vec<Record>,
    /// Files that this run has read to their end, and hashed: reading another share of one need not read all of it.
    read: Mutex<BTreeSet<(usize, PathBuf)>>,
    /// What files are read into.
    pub blocks: Arc<Blocks>,
}

impl<'a> Surveyed<'a> {
    /// Matches files against rules, and cuts the captures of these roles into parts: of each sensor all, or the first
    /// ones.
    ///
    /// # Errors
    /// When a folder cannot be read, rules contradict each other, or a sealed file has changed.
    pub fn new(
        campaigns: &'a [Campaign],
        roles: &[Role],
        captures_max: Option<u32>,
        notes: &Path,
    ) -> Result<Self, StageError> {
        let mut captures: BTreeMap<Order, Capture> = BTreeMap::new();
        let mut left_out = Vec::new();
        let mut records = Vec::new();
        for (index, campaign) in campaigns.iter().enumerate() {
            let refused = |error: &dyn std::error::Error| StageError::Refused(chain(&campaign.root, error));
            let survey = campaign.survey().map_err(|error| refused(&error))?;
            let record = Record::load(campaign, notes).map_err(|error| refused(&error))?;
            left_out.extend(left_out::left_out(&campaign.root, &survey, record.seal.as_ref()));
            let sealed =
                |exposure: &Exposure| record.seal.as_ref().is_none_or(|seal| seal.get(&exposure.file).is_some());
            let mut exposures = survey.exposures;
            if exposures.is_empty() {
                not_gone(campaign, &record)?;
            }
            let segments = segments(&exposures);
            exposures.retain(|exposure| roles.contains(&exposure.role) && sealed(exposure));
            records.push(record);
            for exposure in exposures {
                for (key, item) in items(campaign, exposure, &segments)? {
                    let (sensor, lit, seen) = key;
                    let (role, run) = (item.exposure.role, item.exposure.run.clone());
                    let order = (index, sensor.clone(), lit.min(seen), lit.max(seen), role, run.clone(), lit);
                    // Room for one: many captures of one item are what takes memory.
                    let none =
                        || Capture { campaign: index, role, run, sensor, lit, seen, items: Vec::with_capacity(1) };
                    captures.entry(order).or_insert_with(none).items.push(item);
                }
            }
        }
        let mut taken: BTreeMap<(usize, String), u32> = BTreeMap::new();
        let captures = captures.into_values().filter(|capture| {
            let taken = taken.entry((capture.campaign, capture.sensor.clone())).or_default();
            *taken = taken.saturating_add(1);
            captures_max.is_none_or(|most| *taken <= most)
        });
        Self::of(campaigns, cut(campaigns, captures), left_out, records)
    }

    /// Of parts that were cut already.
    ///
    /// # Errors
    /// When a file has changed since it was recorded.
    pub fn of(
        campaigns: &'a [Campaign],
        parts: Vec<Vec<Capture>>,
        left_out: Vec<LeftOut>,
        records: Vec<Record>,
    ) -> Result<Self, StageError> {
        let mut surveyed = Self {
            campaigns,
            parts,
            source_parts: Vec::new(),
            left_out,
            records,
            read: Mutex::default(),
            blocks: Arc::default(),
        };
        surveyed.check_files()?;
        surveyed.source_parts =
            surveyed.parts.iter().map(|part| surveyed.source_part(part)).collect::<Result<_, StageError>>()?;
        Ok(surveyed)
    }

    /// Files that changed since they were recorded are refused; those whose time stamp alone changed are hashed again
    /// here.
    fn check_files(&self) -> Result<(), StageError> {
        let mut changed = BTreeSet::new();
        for (campaign, file) in content::files(self.parts.iter().flatten()) {
            let root = &self.campaigns[campaign].root;
            let refused = |error: &dyn std::error::Error| StageError::Refused(chain(root, error));
            let state = self.records[campaign].check(root, file).map_err(|error| refused(&error))?;
            let FileState::Touched { recorded } = state else {
                continue;
            };
            let metadata = disk::metadata(root.join(file)).map_err(|error| refused(&error))?;
            if hash_file(&root.join(file)).map_err(|error| refused(&error))? == recorded {
                self.record(campaign, file, recorded, &metadata);
            } else {
                changed.insert(root.join(file).display().to_string());
            }
        }
        if changed.is_empty() {
            return Ok(());
        }
        let changed: Vec<String> = changed.into_iter().collect();
        Err(refused_as_changed(&changed.join(", ")))
    }

    /// Refuses a file that was read with another content than is on record.
    ///
    /// # Errors
    /// When it was.
    pub fn hold(&self, campaign: usize, file: &Path, digest: blake3::Hash) -> Result<(), StageError> {
        match self.records[campaign].content(file) {
            Some(recorded) if recorded != digest => {
                Err(refused_as_changed(&self.campaigns[campaign].path_of(file).display().to_string()))
            }
            _ => Ok(()),
        }
    }

    /// The digest of a file, if it is on record and the file still has the stamp that it had then.
    ///
    /// # Errors
    /// When its metadata cannot be read.
    pub fn digest_of(&self, campaign: usize, file: &Path) -> Result<Option<Digest>, StageError> {
        let root = &self.campaigns[campaign].root;
        match self.records[campaign].check(root, file) {
            Ok(FileState::Same(digest)) => Ok(Some(digest.into())),
            Ok(_) => Ok(None),
            Err(error) => Err(StageError::Refused(chain(root, &error))),
        }
    }

    /// Notes the digest of a file that was read; `metadata` was taken before.
    pub fn record(&self, campaign: usize, file: &Path, digest: blake3::Hash, metadata: &Metadata) {
        self.records[campaign].note(file, digest, metadata);
        self.read.lock().unwrap_or_else(PoisonError::into_inner).insert((campaign, file.to_owned()));
    }

    /// Whether this run has read a file to its end before, and it is as it was then.
    pub fn was_read(&self, campaign: usize, file: &Path) -> bool {
        let read = self.read.lock().unwrap_or_else(PoisonError::into_inner).contains(&(campaign, file.to_owned()));
        read && matches!(self.digest_of(campaign, file), Ok(Some(_)))
    }

    fn source_part(&self, part: &[Capture]) -> Result<SourcePart, StageError> {
        let entry = |(campaign, file): (usize, &Path)| -> Result<_, StageError> {
            Ok(self.digest_of(campaign, file)?.map(|digest| ((campaign, file.to_owned()), digest)))
        };
        let digests = content::files(part).into_iter().map(entry).collect::<Result<Vec<_>, _>>()?;
        // Without one of them the content is not known.
        let digests: Option<FileDigests> = digests.into_iter().collect();
        let content = digests.map(|digests| content::digest(self.campaigns, part, &digests));
        let records = part.iter().map(|capture| capture.items.len() as u64).sum();
        Ok(SourcePart { content, bytes: part.iter().map(Capture::bytes).sum(), records })
    }
}

/// Refuses a campaign whose raw files were read before and have all gone: tables without a row would take the place of
/// those that stand.
fn not_gone(campaign: &Campaign, record: &Record) -> Result<(), StageError> {
    let root = campaign.root.display();
    let gone = record.first_gone(&campaign.root).map_err(|error| StageError::Refused(format!("{root}: {error}")))?;
    let Some((file, count)) = gone else { return Ok(()) };
    let file = campaign.path_of(&file);
    Err(StageError::Refused(format!(
        "the samples lie in {}, and it is gone with all {count} raw files that were read of the campaign; put them back, \
         or `import` tables of this result folder. `codes = \"zstd\"` of stage `ingest` archives samples before raw \
         files go",
        file.display()
    )))
}

/// Cuts captures into parts, in order.
fn cut(campaigns: &[Campaign], captures: impl Iterator<Item = Capture>) -> Vec<Vec<Capture>> {
    let mut captures = captures.peekable();
    let (mut parts, mut part, mut pair_bytes) = (Vec::new(), Vec::new(), 0);
    while let Some(mut capture) = captures.next() {
        capture.items.sort_by(|a, b| {
            let (a, b) = (&a.exposure, &b.exposure);
            (&a.range, a.shot, &a.file).cmp(&(&b.range, b.shot, &b.file))
        });
        pair_bytes += capture.bytes();
        let (key, campaign) = (capture.pair_key(campaigns), capture.campaign);
        part.push(capture);
        let next = captures.peek();
        if next.is_none_or(|next| next.pair_key(campaigns) != key) {
            // No part holds two campaigns: one more in a run leaves those of the others as they are.
            let campaign_ends = next.is_none_or(|next| next.campaign != campaign);
            if campaign_ends || closes_part(&key, pair_bytes, campaigns[campaign].part_bytes) {
                parts.push(std::mem::take(&mut part));
            }
            pair_bytes = 0;
        }
    }
    parts
}

fn refused_as_changed(files: &str) -> StageError {
    StageError::Refused(format!(
        "changed since they were first read: {files}; restore what was captured, or, if the change is meant, seal the campaign anew and choose a new --out"
    ))
}

/// An error with its causes, and the folder that it is about.
pub fn chain(root: &Path, error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    let texts: Vec<String> = causes.map(ToString::to_string).collect();
    format!("campaign {}: {}", root.display(), texts.join(": "))
}

/// Sensor, lit, seen.
type Key = (String, PatchId, PatchId);

/// Number of exposures that are single segments of each file, of whatever role.
fn segments(exposures: &[Exposure]) -> BTreeMap<PathBuf, u64> {
    let mut segments = BTreeMap::new();
    for exposure in exposures.iter().filter(|exposure| exposure.segment.is_some()) {
        for file in exposure.files().collect::<BTreeSet<_>>() {
            match segments.get_mut(file) {
                Some(count) => *count += 1,
                None => drop(segments.insert(file.clone(), 1)),
            }
        }
    }
    segments
}

/// The captures that an exposure's file holds a share of. `segments`: the number of exposures that share each file.
fn items(
    campaign: &Campaign,
    exposure: Exposure,
    segments: &BTreeMap<PathBuf, u64>,
) -> Result<Vec<(Key, Item)>, StageError> {
    let path = campaign.path_of(&exposure.file);
    let size = |file: &PathBuf| {
        let path = campaign.path_of(file);
        let shared_by = if exposure.segment.is_some() { segments.get(file).copied().unwrap_or(1) } else { 1 };
        disk::metadata(&path)
            .map(|file| file.len() / shared_by)
            .map_err(|error| StageError::Refused(format!("{}: {error}", path.display())))
    };
    let files: BTreeSet<&PathBuf> = exposure.files().collect();
    let bytes = files.into_iter().map(size).sum::<Result<u64, StageError>>()?;
    if exposure.keys.segments == [Axis::Shot] {
        let key = (exposure.sensor.clone().unwrap_or_default(), exposure.lit.unwrap_or(0), exposure.seen.unwrap_or(0));
        return Ok(vec![(key, Item { exposure, records: None, bytes })]);
    }
    along_axes(&path, exposure, bytes)
}

/// Splits a file whose segments or leading axes count more than shots. Patches are numbered from 1 along their axis,
/// ranges and channels too.
fn along_axes(path: &Path, exposure: Exposure, bytes: u64) -> Result<Vec<(Key, Item)>, StageError> {
    let refused = |message: String| StageError::Refused(format!("{}: {message}", path.display()));
    let open = || formats::records(&mut formats::Source::open(path)?.described(exposure.keys.description()));
    let Ok(records) = open() else {
        // A file that does not decode, perhaps since it is still being written, is rejected with the reason when it is
        // read.
        let key = (exposure.sensor.clone().unwrap_or_default(), exposure.lit.unwrap_or(0), exposure.seen.unwrap_or(0));
        return Ok(vec![(key, Item { exposure, records: Some(Vec::new()), bytes })]);
    };
    let axes = &exposure.keys.segments;
    let is_of_channel = |record: &waveform::Record| {
        let (wanted, channel) = (&exposure.channel, &record.head.channel);
        wanted.is_none() || channel.is_none() || wanted == channel
    };
    let of_channel: Vec<usize> = (0..records.len()).filter(|index| is_of_channel(&records[*index])).collect();
    let first = of_channel.first().map(|index| &records[*index]);
    let shape = match first.map(|record| record.head.shape.as_slice()) {
        Some(shape) if shape.len() == axes.len() => shape.to_vec(),
        Some([]) if axes.len() == 1 => vec![of_channel.len()],
        shape => {
            let names: Vec<&str> = axes.iter().map(|axis| axis.name()).collect();
            return Err(refused(format!(
                "segments = {names:?} names {} axes, but the file has leading axes {:?}; name one for each, such as segments = \"shot\", or all with `axes`",
                axes.len(),
                shape.unwrap_or(&[])
            )));
        }
    };
    if let Some(axis) = axes.iter().find(|axis| matches!(axis, Axis::Sensor | Axis::Channel)) {
        let name = axis.name();
        return Err(refused(format!(
            "segments along `{name}` have no names; give each {name} a rule and a file of its own"
        )));
    }
    let mut items: BTreeMap<(Key, Option<usize>), Vec<(usize, i32)>> = BTreeMap::new();
    for (place, index) in of_channel.into_iter().enumerate() {
        let (mut rest, mut lit, mut seen, mut shot, mut range) =
            (place, exposure.lit, exposure.seen, exposure.shot.map_or(0, |shot| shot as i32), None);
        for (axis, length) in axes.iter().zip(&shape).rev() {
            let (place, number) = (rest % length, (rest % length) as i32 + 1);
            rest /= length;
            match axis {
                Axis::Lit => lit = Some(number),
                Axis::Seen => seen = Some(number),
                Axis::Range => range = Some(place),
                _ => shot = place as i32,
            }
        }
        let key = (exposure.sensor.clone().unwrap_or_default(), lit.unwrap_or(0), seen.unwrap_or(0));
        items.entry((key, range)).or_default().push((index, shot));
    }
    let share = bytes / items.len().max(1) as u64;
    let item = |((key, range), records): ((Key, Option<usize>), Vec<(usize, i32)>)| {
        let range = range.map(|place| (place + 1).to_string()).or_else(|| exposure.range.clone());
        (key, Item { exposure: Exposure { range, ..exposure.clone() }, records: Some(records), bytes: share })
    };
    Ok(items.into_iter().map(item).collect())
}
