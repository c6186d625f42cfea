//! Sensors whose response no file of the campaign shows, although a stage needs it: known before a record is read.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::plan::Plan;
use crate::campaign::{Campaign, Role};
use crate::stages::Node;
use crate::stages::stage::Beside;

/// A table that cannot be made, since the campaign has no response captures of some sensors.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}: {}", Path::join(campaign, "campaign.toml").display(), self.words())]
pub struct MissingResponse {
    /// Folder of the campaign.
    pub campaign: PathBuf,
    /// The sensors, by name.
    pub sensors: Vec<String>,
    /// Heading of the table.
    pub heading: String,
    /// Stage that makes it.
    pub stage: &'static str,
    /// Whether campaign.toml has rules for responses.
    pub has_rule: bool,
}

impl MissingResponse {
    /// What is missing, and what to do, behind the name of campaign.toml.
    #[must_use]
    pub fn words(&self) -> String {
        let Self { sensors, heading, stage, has_rule, .. } = self;
        let noun = if sensors.len() == 1 { "sensor" } else { "sensors" };
        let names = sensors.join("`, `");
        let fix = if *has_rule {
            "Rules of role \"response\" are there, but match no file of it: copy the files, or correct `files` and `sensor`"
                .to_owned()
        } else {
            let rule = format!("{{ role = \"response\", sensor = \"{}\", files = \"...\", path_m = ... }}", sensors[0]);
            format!("Capture it and add {rule} to `captures`, or take a pipeline that imports a calibration")
        };
        format!("no file shows the impulse response of {noun} `{names}`, which [{heading}] (`{stage}`) needs. {fix}")
    }
}

/// Refuses a plan with a table that is to be made and cannot be. A campaign that is still being captured may get its
/// response later, and is not judged.
///
/// # Errors
/// The first such table.
pub fn require(plan: &Plan<'_>) -> Result<(), MissingResponse> {
    let to_make = (0..plan.tables.len()).filter(|&i| plan.tables[i].wanted && !plan.tables[i].complete());
    to_make.flat_map(|i| missing_for(plan, i)).next().map_or(Ok(()), Err)
}

/// What a step lacks, campaign by campaign.
fn missing_for(plan: &Plan<'_>, step: usize) -> Vec<MissingResponse> {
    let Node::Operator(operator) = &plan.spec.steps[step].node else { return Vec::new() };
    let given = operator.response_of_each().and_then(|beside| calibrating_source(plan, step, beside));
    let Some((shown, used)) =
        given.zip(source(plan, step)).map(|(from, of)| (&plan.sources[&from], &plan.sources[&of]))
    else {
        return Vec::new();
    };
    let Some((shown, used)) = shown.sensors().zip(used.sensors()) else { return Vec::new() };
    let has_response = |campaign: usize, sensor: &str| shown.contains(&(campaign, sensor.to_owned(), Role::Response));
    let of_campaign = |(number, campaign): (usize, &Campaign)| {
        let captured = used.iter().filter(|(of, sensor, _)| *of == number && !has_response(number, sensor));
        let sensors: BTreeSet<&String> = captured.map(|(_, sensor, _)| sensor).collect();
        (campaign.settled.is_none() && !sensors.is_empty()).then(|| MissingResponse {
            campaign: campaign.root.clone(),
            sensors: sensors.into_iter().cloned().collect(),
            heading: plan.spec.steps[step].heading.clone(),
            stage: operator.kind(),
            has_rule: campaign.captures.iter().any(|rule| rule.role == Some(Role::Response)),
        })
    };
    plan.campaigns.iter().enumerate().filter_map(of_campaign).collect()
}

/// The source that a step's rows come from.
fn source(plan: &Plan<'_>, mut step: usize) -> Option<usize> {
    while let Some(from) = plan.from(step) {
        step = from;
    }
    plan.sources.contains_key(&step).then_some(step)
}

/// The source of the captures that a step's table of responses is made from: through the stages that correct it.
fn calibrating_source(plan: &Plan<'_>, mut step: usize, beside: &Beside) -> Option<usize> {
    while let Some(heading) = plan.spec.steps[step].with.get(beside.name) {
        step = plan.spec.table(heading)?.0;
    }
    source(plan, step)
}
