//! A check as text for a person.

use std::fmt::Write;

use super::super::output::count;
use super::report::{Pair, Report, Sensor, listed};

/// Most files of a kind that are named; the JSON names all.
const NAMED: usize = 10;

/// The report as text.
pub fn text(report: &Report) -> String {
    let mut text = format!("campaign {}\n", report.campaign);
    let mut line = |line: String| writeln!(text, "{line}").expect("a String takes all text");
    for entry in &report.captures {
        let captures = if entry.count == 1 { "capture" } else { "captures" };
        let files = count(entry.files, "file", "files");
        line(format!("  {:9} {:8} {:>6} {captures} in {files}", entry.role, entry.sensor, entry.count));
    }
    if report.captures.is_empty() {
        line("  no rule matches any file".to_owned());
    }
    let rejected: Vec<String> = report
        .rejected
        .iter()
        .map(|row| row.file.as_ref().map_or(row.reason.clone(), |file| format!("{file}: {}", row.reason)))
        .collect();
    for (one, many, items) in [
        ("file that no rule matches", "files that no rule matches", &report.unmatched),
        ("pattern or row that matches nothing", "patterns and rows that match nothing", &report.empty),
        ("file without its reference", "files without their reference", &report.missing_references),
        ("rejected file or capture", "rejected files and captures", &rejected),
    ] {
        if !items.is_empty() {
            line(format!("\n{}", count(items.len(), one, many)));
            items.iter().take(NAMED).for_each(|item| line(format!("  {item}")));
        }
        if items.len() > NAMED {
            line(format!("  and {} more", items.len() - NAMED));
        }
    }
    for entry in &report.sensors {
        sensor(entry).into_iter().for_each(&mut line);
    }
    if report.fix.is_empty() {
        line("\nall is well".to_owned());
    } else {
        line("\nto fix".to_owned());
        report.fix.iter().for_each(|fix| line(format!("  {fix}")));
    }
    text
}

fn sensor(entry: &Sensor) -> Vec<String> {
    let mut lines = vec![format!("\nsensor {}", entry.name)];
    for (what, pairs) in
        [("missing pairs", &entry.missing_pairs), ("missing reciprocal pairs", &entry.missing_reciprocals)]
    {
        if !pairs.is_empty() {
            lines.push(format!("  {what:24} {}: {}", pairs.len(), listed(pairs)));
        }
    }
    if let Some([least, middle, most]) = entry.shots {
        lines.push(format!("  {:24} {least} / {middle} / {most} (least, median, most)", "shots a capture"));
    }
    if !entry.fewer_shots.is_empty() {
        let pairs: Vec<Pair> = entry.fewer_shots.iter().map(|(pair, _)| *pair).collect();
        lines.push(format!("  {:24} {}: {}", "fewer shots than others", pairs.len(), listed(&pairs)));
    }
    if let Some(share) = entry.clipped_share {
        lines.push(format!("  {:24} {:.2} % of shots", "clipped", 100.0 * share));
    }
    if let Some(median) = entry.snr_median {
        let faintest: Vec<String> =
            entry.faintest.iter().map(|(Pair { lit, seen }, snr)| format!("({lit}, {seen}) {snr:.1}")).collect();
        lines.push(format!("  {:24} {median:.1} in the median; faintest {}", "signal to noise", faintest.join(", ")));
    }
    lines.extend(echoes(entry));
    checks(entry, &mut lines);
    lines
}

/// Of a lidar.
fn echoes(entry: &Sensor) -> Vec<String> {
    let mut lines = Vec::new();
    if let (Some(echoes), Some(pulses)) = (entry.echoes, entry.pulses_with_echoes) {
        lines.push(format!("  {:24} {echoes} of {}", "echoes", count(pulses, "pulse", "pulses")));
    }
    if let Some(sd_m) = entry.range_sd_m {
        lines.push(format!("  {:24} {} m in the median", "sd of ranges", short(sd_m)));
    }
    if let Some(share) = entry.clipped_echoes {
        lines.push(format!("  {:24} {:.2} % of echoes", "clipped", 100.0 * share));
    }
    lines
}

fn checks(entry: &Sensor, lines: &mut Vec<String>) {
    for row in entry.checks.iter().filter(|row| row.verdict != "missing") {
        let value = row.value.map_or("-".to_owned(), short);
        let sd = row.sd.map_or(String::new(), |sd| format!(" +- {}", short(sd)));
        let good = row.expected.map_or(String::new(), |expected| {
            let tolerance = row.tolerance.map_or(String::new(), |tolerance| format!(" +- {}", short(tolerance)));
            let word = if row.tolerance.is_some() { "good" } else { "at least" };
            format!("  ({word}: {}{tolerance})", short(expected))
        });
        lines.push(format!("  {:24} {:5} {value}{sd} {}{good}", row.check, row.verdict, row.unit));
    }
    let missing: Vec<&str> =
        entry.checks.iter().filter(|row| row.verdict == "missing").map(|row| row.check.as_str()).collect();
    if !missing.is_empty() {
        lines.push(format!(
            "  {:24} {}; `periscope pipelines characterize` says what to capture",
            "not checked",
            missing.join(", ")
        ));
    }
}

/// A number with four digits.
fn short(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let digits = (3 - value.abs().log10().floor() as i32).clamp(0, 12) as usize;
    let text = if value.abs() < 1e-6 { format!("{value:.3e}") } else { format!("{value:.digits$}") };
    if text.contains('.') && !text.contains('e') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}
