//! A check of a lidar's campaign: the echoes of all its pulses.

use std::collections::{BTreeMap, BTreeSet};

use periscope::campaign::Role;
use periscope::tables::Echo;

use super::report::Report;

/// The built-in pipeline. Pulses are not kept: they are as large as the campaign. Echoes are found by the parameters of
/// the pipeline that will run.
pub const PIPELINE: &str = r#"
[pulses]
stage = "ingest_pulses"
keep = false
[echoes]
stage = "decompose"
from = "pulses"
"#;

/// Fills in the echoes.
pub fn fill(report: &mut Report, echoes: &[Echo]) {
    let mut sensors: BTreeMap<&str, Vec<&Echo>> = BTreeMap::new();
    echoes.iter().for_each(|echo| sensors.entry(&echo.sensor).or_default().push(echo));
    for captures in report.captures.iter().filter(|captures| captures.role == Role::Scene.name()) {
        if !sensors.contains_key(captures.sensor.as_str()) {
            report.fix.push(format!("sensor {}: no pulse has an echo", captures.sensor));
        }
    }
    for (name, echoes) in sensors {
        let pulses: BTreeSet<_> = echoes.iter().map(|echo| (&echo.run, &echo.channel, echo.pulse)).collect();
        let mut sds_m: Vec<f64> = echoes.iter().map(|echo| echo.range_sd_m).collect();
        let half = sds_m.len() / 2;
        let (_, median_m, _) = sds_m.select_nth_unstable_by(half, f64::total_cmp);
        let clipped = echoes.iter().filter(|echo| echo.clipped > 0).count();
        let entry = report.sensor(name);
        (entry.echoes, entry.pulses_with_echoes) = (Some(echoes.len()), Some(pulses.len()));
        (entry.range_sd_m, entry.clipped_echoes) = (Some(*median_m), Some(clipped as f64 / echoes.len() as f64));
    }
}
