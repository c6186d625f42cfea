//! Parameters from a pipeline file or from `--set`, and what is wrong with them.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::fault::{Condition, Conflict, fault, text};
use crate::campaign::suggest;

/// A stage from its parameters, which must keep its conditions and be free of conflicts.
///
/// # Errors
/// When a key is unknown or missing, or a value is refused. The text names key, value, range and default.
pub fn read<S: DeserializeOwned + Serialize>(
    params: toml::Table,
    conditions: &[Condition],
    conflict: impl Fn(&S) -> Option<Conflict>,
) -> Result<S, String> {
    let defaults = stage::<S>(toml::Table::new()).ok().map(|stage| json(&stage));
    let stage: S = stage(params.clone()).map_err(|message| refused::<S>(&params, &message, defaults.as_ref()))?;
    let Some(defaults) = defaults else {
        return Ok(stage);
    };
    let values = json(&stage);
    if let Some(broken) = conditions.iter().find_map(|condition| condition.broken(&values, &defaults)) {
        return Err(broken);
    }
    match conflict(&stage) {
        Some(Conflict(key, why)) => Err(fault(key, &text(&values[key]), &why, defaults.get(key))),
        None => Ok(stage),
    }
}

/// A stage, or serde's message.
fn stage<S: DeserializeOwned>(params: toml::Table) -> Result<S, String> {
    params.try_into().map_err(|error: toml::de::Error| error.message().to_owned())
}

fn json(stage: &impl Serialize) -> Value {
    serde_json::to_value(stage).expect("parameters have names and plain values")
}

/// Why these parameters make no stage: serde's message about the first key that is refused even alone.
fn refused<S: DeserializeOwned>(params: &toml::Table, message: &str, defaults: Option<&Value>) -> String {
    let alone = |(key, value): (&String, &toml::Value)| {
        let message = stage::<S>([(key.clone(), value.clone())].into_iter().collect()).err()?;
        let is_other = message.starts_with("missing field");
        (!is_other).then(|| fault(key, &given(value), &why(&message), defaults.and_then(|all| all.get(key))))
    };
    params.iter().find_map(alone).unwrap_or_else(|| format!("params: {}", why(message)))
}

/// A value as it was given, but a whole float without its `.0`.
fn given(value: &toml::Value) -> String {
    value.as_float().map_or_else(|| value.to_string(), |value| value.to_string())
}

/// Serde's message without the key and the value, which stand before it.
fn why(message: &str) -> String {
    let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let (first, words) = quoted.split_first().map_or(("", &[][..]), |(first, words)| (*first, words));
    if message.starts_with("unknown field") {
        return format!("unknown key; {}", suggest::hint(first, words.iter().copied()));
    }
    if message.starts_with("unknown variant") {
        let near = suggest::nearest(first, words.iter().copied());
        let near = near.map_or(String::new(), |near| format!("; did you mean `{near}`?"));
        return format!("must be one of {}{near}", words.join(", "));
    }
    match message.split_once(", expected ") {
        Some((_, range)) => format!("must be {range}"),
        None => message.trim_end().replace("missing field", "there must be a"),
    }
}
