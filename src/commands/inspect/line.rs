//! Facts in words.

use periscope::waveform::{Kind, Record};
use serde_json::Value;

/// The most important facts, for people.
pub fn line(facts: &Value) -> String {
    let text = |key: &str| match &facts[key] {
        Value::Null => "-".to_owned(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    let with =
        |key: &str, units: &[(&str, f64)]| facts[key].as_f64().map_or("-".to_owned(), |value| with_unit(value, units));
    let step = if facts["kind"] == Kind::Spectrum.name() { &FREQUENCY[..] } else { &TIME };
    let value = |key: &str| match facts["unit"].as_str() {
        Some("V") => with(key, &VOLTAGE),
        unit => format!("{} {}", text(key), unit.unwrap_or_default()).trim_end().to_owned(),
    };
    format!(
        "{} channel {:4} segment {:4} {:>8} samples  dt {}  t0 {}  {} to {}  clipped {}",
        text("kind"),
        text("channel"),
        text("segment"),
        text("samples"),
        with("dt_s", step),
        with("t0_s", &TIME) + if facts["t0_nominal"] == true { " (nominal)" } else { "" },
        value("min"),
        value("max"),
        text("clipped"),
    )
}

/// Which keys of campaign.toml give the units that the heading of a text lacks.
pub fn missing_units(records: &[Record]) -> Option<String> {
    let heads = || records.iter().map(|record| &record.head).filter(|head| head.format == "csv");
    let values = heads().any(|head| head.kind == Kind::Waveform && head.unit.is_none());
    let times = heads().any(|head| head.dt_s.is_none());
    let of_values = values.then_some("no unit of values: give `unit`, such as \"mV\" or \"counts\"");
    let of_times = times.then_some("no unit of times: give `time_unit`, such as \"ns\", or dt_ps and t0_ps");
    let keys: Vec<&str> = [of_values, of_times].into_iter().flatten().collect();
    (!keys.is_empty()).then(|| format!("{}; in its [[captures]] rule", keys.join("; ")))
}

pub const TIME: [(&str, f64); 5] = [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9), ("ps", 1e-12)];
const FREQUENCY: [(&str, f64); 4] = [("GHz", 1e9), ("MHz", 1e6), ("kHz", 1e3), ("Hz", 1.0)];
const VOLTAGE: [(&str, f64); 3] = [("V", 1.0), ("mV", 1e-3), ("uV", 1e-6)];

/// A value in the largest unit in which it is at least one, else in the smallest, with up to seven digits. JSON and CSV
/// have all digits.
pub fn with_unit(value: f64, units: &[(&str, f64)]) -> String {
    let is_enough = |(_, one): &&(&str, f64)| value == 0.0 || value.abs() >= (1.0 - 1e-7) * one;
    let (unit, one) = units.iter().find(is_enough).or(units.last()).expect("there are units");
    let seven: f64 = format!("{:.6e}", value / one).parse().expect("a number as it is printed");
    format!("{seven} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_shown_in_the_unit_that_fits() {
        let time = |value| with_unit(value, &TIME);
        assert_eq!(time(50e-12), "50 ps");
        assert_eq!(time(1e-9 * (1.0 + 2e-8)), "1 ns");
        assert_eq!(time(1e-12 * (1.0 - 4e-9)), "1 ps");
        assert_eq!(time(-2.007_329_1e-6), "-2.007329 us");
        assert_eq!(time(0.0), "0 s");
        assert_eq!(time(1.5e-14), "0.015 ps");
        assert_eq!(with_unit(2.5e6, &FREQUENCY), "2.5 MHz");
        assert_eq!(with_unit(-0.0125, &VOLTAGE), "-12.5 mV");
    }
}
