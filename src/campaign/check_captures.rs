//! Checks of `[[captures]]` and `[[exclude]]`: exclusive keys, one source for each coordinate of a record, declared
//! sensors.

use std::collections::{BTreeMap, BTreeSet};

use super::fault::{At, Fault};
use super::keys::{Axis, CaptureRule, Exclude, Match, Reference, Role, Sensor};
use super::pattern::check_path;
use super::suggest::hint;
use crate::formats::csv;
use crate::formats::description::TIME;

/// Checks a rule, or a row of its table combined with it.
///
/// # Errors
/// The first fault.
pub fn rule(rule: &CaptureRule, place: &str, sensors: &BTreeMap<String, Sensor>) -> Result<(), Fault> {
    let at = &At(place);
    at.check(rule.files.is_some() != rule.table.is_some(), || {
        "a rule has either `files` (a pattern) or `table` (a CSV file); give one of them".into()
    })?;
    at.check(rule.role.is_some() || rule.table.is_some(), || {
        "key `role` is missing; add role = \"scene\", \"response\", \"dark\", \"blocked\" or \"fiducial\"".into()
    })?;
    if let Some(table) = &rule.table {
        check_path(&table.to_string_lossy())
            .map_err(|problem| at.fault(format!("table = \"{}\" {problem}", table.display())))?;
    }
    at.label("channel", rule.channel.as_deref())?;
    at.label("range", rule.range.as_deref())?;
    for (key, patch) in [("lit", rule.lit), ("seen", rule.seen)] {
        at.check(patch.is_none_or(|patch| patch >= 0), || {
            format!("{key} is negative; patches are numbered from 1 (0: none)")
        })?;
    }
    if let Some(sensor) = &rule.sensor {
        sensor_exists(sensor, sensors).map_err(|problem| at.fault(problem))?;
    }
    record_values(at, rule)?;
    description(at, rule)?;
    rule_axes(at, rule)
}

/// Checks that a sensor is declared.
///
/// # Errors
/// If it is not: the problem and how to fix it.
pub fn sensor_exists(name: &str, sensors: &BTreeMap<String, Sensor>) -> Result<(), String> {
    if sensors.contains_key(name) {
        return Ok(());
    }
    Err(format!(
        "sensor `{name}` is not declared; add [sensors.{name}] to campaign.toml ({})",
        hint(name, sensors.keys().map(String::as_str))
    ))
}

fn record_values(at: &At, rule: &CaptureRule) -> Result<(), Fault> {
    at.positive("dt_ps", rule.dt_ps)?;
    at.positive("nominal_rate_hz", rule.nominal_rate_hz)?;
    at.check(rule.dt_ps.is_none() || rule.nominal_rate_hz.is_none(), || {
        "dt_ps gives the time between samples, nominal_rate_hz corrects that of the file; give one of them".into()
    })?;
    at.finite("gain_v", rule.gain_v)?;
    at.check(rule.gain_v != Some(0.0), || "gain_v = 0 makes all samples equal; give volts per code".into())?;
    at.finite("offset_v", rule.offset_v)?;
    at.finite("t0_ps", rule.t0_ps)?;
    at.positive("power_w", rule.power_w)?;
    at.positive("path_m", rule.path_m)?;
    at.positive("path_sd_m", rule.path_sd_m)?;
    at.needs("path_sd_m", rule.path_sd_m.is_some(), "path_m", rule.path_m.is_some())?;
    at.check(rule.attenuation_od.is_none_or(|od| od.is_finite() && od >= 0.0), || {
        "attenuation_od is below 0; give the optical density of the attenuator".into()
    })?;
    at.check(rule.averaged_shots != Some(0), || "averaged_shots = 0; a record that was not averaged has 1".into())?;
    at.check(rule.samples.is_none_or(|[a, b]| a < b), || {
        "samples = [a, b] runs from sample a up to but without b; a must be below b".into()
    })
}

/// Checks what the rule says to the reader of its files.
fn description(at: &At, rule: &CaptureRule) -> Result<(), Fault> {
    csv::check_units(&rule.record_keys().description()).map_err(|error| at.fault(error.to_string()))?;
    at.positive("bin_ps", rule.bin_ps)?;
    at.check(rule.marker.is_none_or(|marker| (1..=4).contains(&marker)), || {
        "marker is none of the instruments' inputs 1 to 4; correct it".into()
    })?;
    at.check(rule.pixels.is_none_or(|pixels| pixels > 0), || "pixels = 0; a line has one or more".into())?;
    at.check(rule.pixels.is_none() || rule.marker.is_some(), || {
        "pixels cuts the lines of an image; give the marker at which they begin too".into()
    })?;
    at.check(rule.unit.is_none() || rule.gain_v.is_none(), || {
        "unit says what the numbers of a text are, gain_v converts codes to volts; give one of them".into()
    })?;
    at.check(rule.variable.is_none() || rule.channel.is_none(), || {
        "variable names an array, channel a channel; give one of them".into()
    })?;
    let has_channel = rule.reference.as_ref().is_some_and(|reference| reference.channel.is_some());
    at.check(rule.variable.is_none() || !has_channel, || {
        "variable reads one array of a file, so that reference.channel finds no other; \
         in an .npz file name both as channels, else save the reference in a file of its own"
            .into()
    })?;
    let Some(names) = &rule.axes else { return Ok(()) };
    at.check(rule.segments == [Axis::Shot], || {
        "axes names what every axis counts, segments the leading ones; give one of them".into()
    })?;
    let allowed = || Axis::ALL.into_iter().map(Axis::name).chain([TIME]);
    for (index, name) in names.iter().enumerate() {
        at.check(allowed().any(|other| other == name), || format!("axes has \"{name}\"; {}", hint(name, allowed())))?;
        at.check(!names[..index].contains(name), || format!("\"{name}\" stands twice in axes; take one out"))?;
    }
    at.check(names.iter().any(|name| name == TIME), || {
        format!("axes = {names:?} has no \"{TIME}\"; name the axis that counts samples so")
    })
}

/// Checks that each coordinate of a record has one source: the pattern, a key, or an axis of the segments.
fn rule_axes(at: &At, rule: &CaptureRule) -> Result<(), Fault> {
    let in_pattern: BTreeSet<Axis> = match &rule.files {
        Some(files) => at.pattern(files)?.axes().collect(),
        None => BTreeSet::new(),
    };
    let counted = rule.counted();
    for (axis, is_key) in key_axes(rule) {
        let name = axis.name();
        at.check(!(is_key && in_pattern.contains(&axis)), || {
            format!("`{name}` stands in the pattern and as a key; take one out")
        })?;
        // Shots may continue within the files of a numbered series, so they may have two sources.
        let in_segments = axis != Axis::Shot && counted.contains(&axis);
        at.check(!(in_segments && (is_key || in_pattern.contains(&axis))), || {
            format!("`{name}` stands in segments or axes and elsewhere; take one out")
        })?;
        at.check(rule.segments.iter().filter(|a| **a == axis).count() < 2, || {
            format!("`{name}` stands twice in segments; take one out")
        })?;
        let has_source = is_key || in_pattern.contains(&axis) || counted.contains(&axis);
        let needed = matches!(axis, Axis::Lit | Axis::Seen) && rule.role == Some(Role::Scene) && rule.table.is_none();
        at.check(has_source || !needed, || {
            format!("nothing says which patch is `{name}`; put {{{name}}} into the pattern, add the key {name} = N, or list \"{name}\" in segments")
        })?;
    }
    if let Some(reference) = &rule.reference {
        reference_keys(at, rule, reference, &in_pattern)?;
    }
    Ok(())
}

fn key_axes(rule: &CaptureRule) -> [(Axis, bool); 6] {
    [
        (Axis::Lit, rule.lit.is_some()),
        (Axis::Seen, rule.seen.is_some()),
        (Axis::Sensor, rule.sensor.is_some()),
        (Axis::Shot, rule.shot.is_some()),
        (Axis::Range, rule.range.is_some()),
        (Axis::Channel, rule.channel.is_some()),
    ]
}

fn reference_keys(
    at: &At,
    rule: &CaptureRule,
    reference: &Reference,
    in_pattern: &BTreeSet<Axis>,
) -> Result<(), Fault> {
    at.check(reference.channel.is_some() != reference.files.is_some(), || {
        "reference has either `channel` (of the same file) or `files` (a pattern); give one of them".into()
    })?;
    at.label("reference.channel", reference.channel.as_deref())?;
    let same = reference.channel.is_some() && reference.channel == rule.channel;
    at.check(!same, || "reference.channel is the channel of the signal; name the other one".into())?;
    let Some(files) = &reference.files else {
        return Ok(());
    };
    for axis in at.pattern(files)?.axes() {
        let is_key = key_axes(rule).contains(&(axis, true));
        let has_axis = is_key || in_pattern.contains(&axis) || rule.table.is_some();
        at.check(has_axis, || {
            let name = axis.name();
            format!("reference.files has {{{name}}}, which `files` has not; take it out, or put it into both")
        })?;
    }
    Ok(())
}

/// Checks an exclusion.
///
/// # Errors
/// The first fault.
pub fn exclude(exclude: &Exclude, place: &str, sensors: &BTreeMap<String, Sensor>) -> Result<(), Fault> {
    let at = &At(place);
    at.check(exclude.matches != Match::default(), || {
        "match is empty and would exclude everything; name role, sensor, lit, seen, shot, range, channel or file".into()
    })?;
    at.check(!exclude.reason.trim().is_empty(), || "reason is empty; say why, for those who come later".into())?;
    if let Some(sensor) = &exclude.matches.sensor {
        sensor_exists(sensor, sensors).map_err(|problem| at.fault(problem))?;
    }
    let Some(file) = &exclude.matches.file else {
        return Ok(());
    };
    at.check(at.pattern(file)?.axes().next().is_none(), || {
        "match.file has a placeholder; use `*`, and keys such as lit = 12 next to it".into()
    })
}
