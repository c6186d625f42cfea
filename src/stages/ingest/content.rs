//! What a part is: all that its rows depend on, as one digest.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Serialize;
use serde_json::value::RawValue;

use super::survey::{Capture, Item};
use crate::campaign::keys::RecordKeys;
use crate::campaign::{Campaign, Role};
use crate::store::Digest;
use crate::units::PatchId;

/// Digests of raw files, by number of the campaign in the run.
pub type FileDigests = BTreeMap<(usize, PathBuf), Digest>;

/// Raw files that captures read, each once.
pub fn files<'a>(captures: impl IntoIterator<Item = &'a Capture>) -> BTreeSet<(usize, &'a Path)> {
    let of_capture = |capture: &'a Capture| {
        let files = capture.items.iter().flat_map(|item| item.exposure.files());
        files.map(|file| (capture.campaign, file.as_path()))
    };
    captures.into_iter().flat_map(of_capture).collect()
}

/// Digest of a part from the digests of its files.
pub fn digest(campaigns: &[Campaign], part: &[Capture], digests: &FileDigests) -> Digest {
    // Most exposures of a part share the keys of a rule.
    let mut keys: BTreeMap<*const RecordKeys, Box<RawValue>> = BTreeMap::new();
    for item in part.iter().flat_map(|capture| &capture.items) {
        keys.entry(Arc::as_ptr(&item.exposure.keys)).or_insert_with(|| canonical(&item.exposure.keys));
    }
    // By name: a campaign's place in the run is no part of its content.
    let name = |campaign: usize| campaigns[campaign].name.as_str();
    let content = PartContent {
        captures: part.iter().map(|capture| description(capture, name(capture.campaign), &keys)).collect(),
        files: digests.iter().map(|((campaign, file), digest)| (name(*campaign), file.as_path(), digest)).collect(),
    };
    Digest::of_bytes(serde_json::to_string(&content).expect("plain data").as_bytes())
}

/// All that the rows of a part depend on. The JSON of it is canonical, as [`Digest::of`] has it: fields stand in the
/// order of their names.
#[derive(Serialize)]
struct PartContent<'a> {
    captures: Vec<CaptureContent<'a>>,
    files: Vec<(&'a str, &'a Path, &'a Digest)>,
}

/// Campaign, role, run, sensor, lit, seen, items: all that a capture's rows depend on, the bytes of its files apart.
type CaptureContent<'a> = (&'a str, Role, Option<&'a str>, &'a str, PatchId, PatchId, Vec<ItemContent<'a>>);

#[derive(Serialize)]
struct ItemContent<'a> {
    channel: Option<&'a str>,
    file: &'a Path,
    keys: &'a RawValue,
    range: Option<&'a str>,
    records: Option<&'a [(usize, i32)]>,
    reference: Option<(&'a Path, Option<&'a str>)>,
    segment: Option<u32>,
    shot: Option<u32>,
}

fn description<'a>(
    capture: &'a Capture,
    campaign: &'a str,
    keys: &'a BTreeMap<*const RecordKeys, Box<RawValue>>,
) -> CaptureContent<'a> {
    let item = |Item { exposure, records, .. }: &'a Item| ItemContent {
        channel: exposure.channel.as_deref(),
        file: &exposure.file,
        keys: &keys[&Arc::as_ptr(&exposure.keys)],
        range: exposure.range.as_deref(),
        records: records.as_deref(),
        reference: exposure.reference.as_ref().map(|pulse| (pulse.file.as_path(), pulse.channel.as_deref())),
        segment: exposure.segment,
        shot: exposure.shot,
    };
    let Capture { role, run, sensor, lit, seen, items, .. } = capture;
    (campaign, *role, run.as_deref(), sensor, *lit, *seen, items.iter().map(item).collect())
}

/// As JSON whose keys are sorted.
fn canonical(keys: &RecordKeys) -> Box<RawValue> {
    let sorted = serde_json::to_value(keys).expect("keys are plain data");
    RawValue::from_string(sorted.to_string()).expect("a value is valid JSON")
}
