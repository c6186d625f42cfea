//! Describes in words what changed between two recipes.

use serde_json::Value;

use super::shelf::StageId;

impl StageId {
    /// Differences of the stage itself, a line each (`threshold_sigma 5.0 -> 6.0`): kind, version, parameters, campaign
    /// fields, columns, kind of CPU. Its inputs are not compared.
    #[must_use]
    pub fn changes(&self, to: &Self) -> Vec<String> {
        let mut changes = Vec::new();
        if self.kind != to.kind {
            changes.push(format!("stage {} -> {}", self.kind, to.kind));
        } else if self.version != to.version {
            changes.push(format!("version of stage {} {} -> {}", to.kind, self.version, to.version));
        }
        differences("", &self.params, &to.params, &mut changes);
        differences("campaign: ", &self.fields, &to.fields, &mut changes);
        if self.schemas != to.schemas {
            changes.push("columns of the table".to_owned());
        }
        if self.arithmetic != to.arithmetic {
            changes.push(format!("kind of CPU: {} -> {}", self.arithmetic, to.arithmetic));
        }
        changes
    }
}

/// Differences between two JSON values, in words.
fn differences(place: &str, old: &Value, new: &Value, out: &mut Vec<String>) {
    match (old, new) {
        (Value::Object(before), Value::Object(after)) => {
            for key in before.keys().chain(after.keys().filter(|key| !before.contains_key(*key))) {
                let place = if place.is_empty() || place.ends_with(' ') {
                    format!("{place}{key}")
                } else {
                    format!("{place}.{key}")
                };
                differences(
                    &place,
                    before.get(key).unwrap_or(&Value::Null),
                    after.get(key).unwrap_or(&Value::Null),
                    out,
                );
            }
        }
        (Value::Array(before), Value::Array(after)) if before.len() == after.len() => {
            for (i, (before, after)) in before.iter().zip(after).enumerate() {
                differences(&format!("{place}[{i}]"), before, after, out);
            }
        }
        _ if old != new => out.push(format!("{place} {old} -> {new}")),
        _ => {}
    }
}
