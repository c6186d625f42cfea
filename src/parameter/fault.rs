//! What is wrong with a parameter, in one form: `params.KEY = VALUE: why (default DEFAULT)`.

use serde_json::Value;

/// A parameter that has an effect only while another one has one of some values: its name, the other's name, the
/// values.
#[derive(Clone, Copy, Debug)]
pub struct Condition(pub &'static str, pub &'static str, pub &'static [&'static str]);

/// A parameter that does not go together with the others: its name, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Conflict(pub &'static str, pub String);

/// The message.
pub(super) fn fault(key: &str, value: &str, why: &str, default: Option<&Value>) -> String {
    let default = default.map_or(String::new(), |default| format!(" (default {})", text(default)));
    format!("params.{key} = {value}: {why}{default}")
}

/// A value as a pipeline file has it, but a whole float without its `.0`; `absent` for none.
pub(super) fn text(value: &Value) -> String {
    match value {
        Value::Null => "absent".to_owned(),
        Value::Number(number) => match number.as_f64() {
            Some(float) if number.is_f64() => float.to_string(),
            _ => number.to_string(),
        },
        other => other.to_string(),
    }
}

impl Condition {
    /// Why the parameter has no effect among `params`, if it is not at its default.
    pub(super) fn broken(&self, params: &Value, defaults: &Value) -> Option<String> {
        let Self(key, other, values) = self;
        let (value, default) = (params.get(key), defaults.get(key));
        let there = text(params.get(other).unwrap_or(&Value::Null));
        let there = there.trim_matches('"');
        if value == default || values.contains(&there) {
            return None;
        }
        let wanted: Vec<String> = values.iter().map(|value| format!("`{value}`")).collect();
        let why = format!(
            "has no effect while `{other}` is `{there}`, only while it is {}; take it out",
            wanted.join(" or ")
        );
        Some(fault(key, &text(value.unwrap_or(&Value::Null)), &why, default))
    }
}
