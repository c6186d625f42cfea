//! An exposure: a record of a raw file, and what the campaign says about it.

use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::check_captures::sensor_exists;
use super::keys::{Axis, Campaign, CaptureRule, RecordKeys, Role};
use super::pattern::{Bound, Pattern};
use crate::units::PatchId;

/// One record, or all records of a file whose segments are exposures of their own.
///
/// Coordinates that are `None` come from the segments of the file (`keys.segments`), or do not matter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exposure {
    /// The rule that matched the file: index into `Campaign::captures`.
    pub rule: usize,
    /// The file, relative to the campaign folder.
    pub file: PathBuf,
    /// What was captured.
    pub role: Role,
    /// The run of shots that it belongs to, for roles other than scene: the file, with `*` for the shot number if the
    /// pattern has one. It depends on the file alone, so that it stays the same when a campaign grows.
    pub run: Option<String>,
    /// Sensor; `None` only where the segments count sensors.
    pub sensor: Option<String>,
    /// Lit patch (0: none); `None` only where the segments count lit patches.
    pub lit: Option<PatchId>,
    /// Seen patch (0: none); `None` only where the segments count seen patches.
    pub seen: Option<PatchId>,
    /// Number of the shot; `None`: files and segments count the shots.
    pub shot: Option<u32>,
    /// Vertical range.
    pub range: Option<String>,
    /// Channel; `None`: the only one of the file.
    pub channel: Option<String>,
    /// Segment of the file; `None`: all.
    pub segment: Option<u32>,
    /// The record of the pulse that marks time zero; `None`: the trigger marks it.
    pub reference: Option<ReferenceSource>,
    /// Companion files with the samples of its file, or of its reference's file.
    pub companions: Vec<PathBuf>,
    /// Scale, time base and circumstances.
    pub keys: Arc<RecordKeys>,
}

impl Exposure {
    /// All raw files that it needs: its own, that of its reference (which may be the same), companions.
    pub fn files(&self) -> impl Iterator<Item = &PathBuf> {
        let reference = self.reference.as_ref().map(|reference| &reference.file);
        std::iter::once(&self.file).chain(reference).chain(&self.companions)
    }

    /// Of a file of the scene, by a rule that says nothing more.
    #[cfg(test)]
    pub(crate) fn of_file(file: &str) -> Self {
        Self {
            rule: 0,
            file: file.into(),
            role: Role::Scene,
            run: None,
            sensor: None,
            lit: None,
            seen: None,
            shot: None,
            range: None,
            channel: None,
            segment: None,
            reference: None,
            companions: Vec::new(),
            keys: CaptureRule::default().record_keys().into(),
        }
    }
}

/// Where the reference pulse of an exposure is recorded.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ReferenceSource {
    /// The file, relative to the campaign folder; may be the exposure's own.
    pub file: PathBuf,
    /// The channel, where the file holds several.
    pub channel: Option<String>,
}

/// Combines a rule and the values of its placeholders into the exposure of a file.
pub(super) fn exposure(
    campaign: &Campaign,
    rule_number: usize,
    rule: &CaptureRule,
    keys: &Arc<RecordKeys>,
    file: &str,
    bound: &Bound,
) -> Result<Exposure, String> {
    let role = rule.role.ok_or("nothing says its role; fill the column `role`, or add the key to the rule")?;
    let patch = |axis: Axis, key: Option<PatchId>| {
        let patch = number(axis, bound)?.or(key);
        let name = axis.name();
        match patch {
            Some(0) if role == Role::Scene => Err(format!("{name} = 0 in a scene; patches are numbered from 1")),
            None if rule.counted().contains(&axis) => Ok(None),
            None if role == Role::Scene => Err(format!(
                "nothing says which patch is `{name}`; fill the column `{name}`, or list \"{name}\" in segments"
            )),
            patch => Ok(Some(patch.unwrap_or(0))),
        }
    };
    let name = |axis: Axis, key: &Option<String>| bound.get(axis).map(str::to_owned).or_else(|| key.clone());
    let sensor = match name(Axis::Sensor, &rule.sensor) {
        None if rule.counted().contains(&Axis::Sensor) => None,
        None => Some(only_sensor(campaign)?),
        Some(sensor) => {
            sensor_exists(&sensor, &campaign.sensors)?;
            Some(sensor)
        }
    };
    Ok(Exposure {
        rule: rule_number,
        file: file.into(),
        role,
        run: (role != Role::Scene).then(|| run(rule, file)),
        sensor,
        lit: patch(Axis::Lit, rule.lit)?,
        seen: patch(Axis::Seen, rule.seen)?,
        shot: number(Axis::Shot, bound)?.or(rule.shot),
        range: name(Axis::Range, &rule.range),
        // An array is a channel of its file.
        channel: name(Axis::Channel, &rule.channel).or_else(|| rule.variable.clone()),
        segment: None,
        reference: None,
        companions: Vec::new(),
        keys: Arc::clone(keys),
    })
}

/// The run of a file: files whose paths differ only in the shot belong to one run.
fn run(rule: &CaptureRule, file: &str) -> String {
    match rule.files.as_deref().map(Pattern::parse) {
        Some(Ok(pattern)) => pattern.starred(file, Axis::Shot),
        _ => file.to_owned(),
    }
}

fn number<T: FromStr>(axis: Axis, bound: &Bound) -> Result<Option<T>, String> {
    let parse = |text: &str| {
        text.parse()
            .map_err(|_| format!("{} = {text} is too large a number; is it a date? Take it up by `*`", axis.name()))
    };
    bound.get(axis).map(parse).transpose()
}

fn only_sensor(campaign: &Campaign) -> Result<String, String> {
    let mut names = campaign.sensors.keys();
    match (names.next(), names.next()) {
        (Some(only), None) => Ok(only.clone()),
        (None, _) => Err("no sensor is declared; add [sensors.NAME] to campaign.toml".into()),
        _ => Err(
            "nothing says which sensor recorded it; put {sensor} into the pattern, or add the key sensor = \"NAME\""
                .into(),
        ),
    }
}
