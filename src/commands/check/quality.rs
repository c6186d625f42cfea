//! Quality of the captures: shots, clipping, signal-to-noise ratio, and the verdicts of the instrument check.

use std::collections::BTreeMap;

use periscope::campaign::Role;
use periscope::pipeline::rejects::{kinds, words};
use periscope::tables::{self, Measurement, Name, Reject};

use super::super::output;
use super::report::{CheckOfSensor, Pair, Rejected, Report, Sensor, listed};

/// Share of clipped shots above which the range is wrong: the laser's fluctuations explain single ones.
const CLIPPED_SHARE: f64 = 0.05;
/// Least signal-to-noise ratio of the strongest pulse of a capture.
const SNR_MIN: f64 = 5.0;
/// Number of reasons for rejections that are listed.
const REASONS: usize = 5;
/// Number of captures listed as the faintest.
const FAINTEST: usize = 5;

/// Fills in the measurements.
pub fn fill(report: &mut Report, measurements: &[Measurement], checks: Vec<tables::Check>, rejects: &[Reject]) {
    let text = |name: &Name| name.to_string();
    let row = |row: &Reject| Rejected { file: row.file.as_ref().map(text), reason: text(&row.reason) };
    report.rejected = rejects.iter().map(row).collect();
    let kinds = kinds(rejects);
    for (count, first) in kinds.iter().take(REASONS) {
        let counted = output::count(*count, "file or capture is", "files or captures are");
        report.fix.push(format!("{counted} rejected: {}", words(first)));
    }
    if kinds.len() > REASONS {
        let more = kinds.len() - REASONS;
        report.fix.push(format!("{more} more reasons for rejections are listed above"));
    }
    let mut sensors: BTreeMap<&str, Vec<&Measurement>> = BTreeMap::new();
    for row in measurements {
        sensors.entry(&row.sensor).or_default().push(row);
    }
    for (name, rows) in sensors {
        let entry = report.sensor(name);
        let mut fix = of_shots(entry, &rows);
        fix.extend(of_light(entry, &rows));
        report.fix.extend(fix.into_iter().map(|text| format!("sensor {name}: {text}")));
    }
    for row in checks {
        if &*row.verdict == "fail" {
            report.fix.push(format!("sensor {}: {} fails: {}", row.sensor, row.check, row.cause));
        }
        report.sensor(&row.sensor).checks.push(CheckOfSensor {
            check: row.check.to_string(),
            verdict: row.verdict.to_string(),
            value: row.value,
            sd: row.sd,
            expected: row.expected,
            tolerance: row.tolerance,
            unit: row.unit.to_string(),
            cause: row.cause.to_string(),
        });
    }
}

fn of_scene<'a>(rows: &[&'a Measurement]) -> Vec<&'a Measurement> {
    rows.iter().copied().filter(|row| *row.role == *Role::Scene.name()).collect()
}

fn pair(row: &Measurement) -> Pair {
    Pair { lit: row.lit, seen: row.seen }
}

/// Clipping, and captures with missing shots.
fn of_shots(sensor: &mut Sensor, rows: &[&Measurement]) -> Vec<String> {
    let mut fix = Vec::new();
    let recorded = |row: &Measurement| row.shots + row.rejected;
    let total: i32 = rows.iter().map(|row| recorded(row)).sum();
    let clipped: i32 = rows.iter().map(|row| row.clipped).sum();
    let share = f64::from(clipped) / f64::from(total.max(1));
    sensor.clipped_share = Some(share);
    if share > CLIPPED_SHARE {
        fix.push(format!("{:.1} % of the shots are clipped: open the vertical range, or attenuate", 100.0 * share));
    }
    let scene = of_scene(rows);
    let mut shots: Vec<i32> = scene.iter().map(|row| recorded(row)).collect();
    shots.sort_unstable();
    if let (Some(&least), Some(&most)) = (shots.first(), shots.last()) {
        sensor.shots = Some([least, shots[shots.len() / 2], most]);
        sensor.fewer_shots =
            scene.iter().filter(|row| recorded(row) < most).map(|row| (pair(row), recorded(row))).collect();
    }
    if !sensor.fewer_shots.is_empty() {
        let pairs: Vec<Pair> = sensor.fewer_shots.iter().map(|(pair, _)| *pair).collect();
        let counted = output::count(
            pairs.len(),
            "capture has fewer shots than the others",
            "captures have fewer shots than the others",
        );
        fix.push(format!("{counted}: {}", listed(&pairs)));
    }
    fix
}

/// Signal-to-noise ratio of the captures of the scene; unknown without a calibration.
fn of_light(sensor: &mut Sensor, rows: &[&Measurement]) -> Vec<String> {
    let mut ratios: Vec<(Pair, f64)> =
        of_scene(rows).into_iter().map(|row| (pair(row), row.snr.unwrap_or(0.0))).collect();
    if ratios.iter().all(|(_, snr)| *snr == 0.0) && rows.iter().all(|row| row.snr.is_none()) {
        return Vec::new();
    }
    ratios.sort_by(|a, b| a.1.total_cmp(&b.1));
    sensor.snr_median = ratios.get(ratios.len() / 2).map(|(_, snr)| *snr);
    let faint: Vec<Pair> = ratios.iter().filter(|(_, snr)| *snr < SNR_MIN).map(|(pair, _)| *pair).collect();
    ratios.truncate(FAINTEST);
    sensor.faintest = ratios;
    if faint.is_empty() {
        return Vec::new();
    }
    let (count, pairs) = (faint.len(), listed(&faint));
    vec![format!("{count} captures show no light: {pairs}; average more shots, or check shutter and aim")]
}
