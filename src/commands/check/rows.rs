//! A check as rows: what to fix, what was captured, and the verdict of each check of the instrument.

use serde_json::{Value, json};

use super::super::output::Rows;
use super::report::Report;

/// The report as rows.
pub fn rows(report: &Report) -> Rows {
    let columns = ["sensor", "what", "verdict", "value", "sd", "expected", "tolerance", "unit", "text"];
    let mut rows = Rows::new(&columns);
    let null = Value::Null;
    let mut add = |sensor: Value, what: &str, [value, unit, text]: [Value; 3]| {
        let (verdict, none) = (null.clone(), [(); 3].map(|()| null.clone()));
        rows.push([sensor, json!(what), verdict, value].into_iter().chain(none).chain([unit, text]));
    };
    for fix in &report.fix {
        add(Value::Null, "fix", [Value::Null, Value::Null, json!(fix)]);
    }
    for entry in &report.captures {
        let what = format!("{} captures", entry.role);
        add(json!(entry.sensor), &what, [json!(entry.count), Value::Null, Value::Null]);
    }
    for sensor in &report.sensors {
        let missing =
            [("missing_pairs", sensor.missing_pairs.len()), ("missing_reciprocals", sensor.missing_reciprocals.len())];
        for (what, count) in missing {
            add(json!(sensor.name), what, [json!(count), Value::Null, Value::Null]);
        }
        for (what, value) in [("clipped_share", sensor.clipped_share), ("snr_median", sensor.snr_median)] {
            add(json!(sensor.name), what, [json!(value), Value::Null, Value::Null]);
        }
        let of_lidar = [
            ("echoes", json!(sensor.echoes)),
            ("pulses_with_echoes", json!(sensor.pulses_with_echoes)),
            ("range_sd_m", json!(sensor.range_sd_m)),
            ("clipped_echoes", json!(sensor.clipped_echoes)),
        ];
        for (what, value) in of_lidar.into_iter().filter(|(_, value)| !value.is_null()) {
            add(json!(sensor.name), what, [value, Value::Null, Value::Null]);
        }
    }
    for (sensor, check) in
        report.sensors.iter().flat_map(|sensor| sensor.checks.iter().map(move |check| (sensor, check)))
    {
        rows.push([
            json!(sensor.name),
            json!(check.check),
            json!(check.verdict),
            json!(check.value),
            json!(check.sd),
            json!(check.expected),
            json!(check.tolerance),
            json!(check.unit),
            json!(check.cause),
        ]);
    }
    rows
}
