//! An explanation as text for a person.

use std::collections::BTreeSet;

use periscope::history::behind::{CaptureBehind, OnsetBehind, RawRecords};
use periscope::history::explanation::Explanation;
use periscope::history::sensors::SensorBehind;
use serde_json::{Map, Value};

use super::super::output::count;

/// Longest list that is shown whole, in rows.
const WHOLE: usize = 6;
/// Rows shown of a longer list of onsets.
const SHOWN: usize = 3;

/// The explanation as text: in a few lines, or with `all` with every onset and capture.
pub fn text(explanation: &Explanation, all: bool) -> String {
    let mut lines = vec![point(explanation), dataflow(explanation)];
    if !explanation.beside.is_empty() {
        lines.push(format!("side tables: {}", explanation.beside.join(", ")));
    }
    lines.extend(onsets(&explanation.onsets, all));
    lines.extend(captures(&explanation.captures, all));
    lines.extend(explanation.sensors.iter().map(sensor));
    if !explanation.remarks.is_empty() {
        lines.push(String::new());
        lines.extend(explanation.remarks.iter().map(|remark| format!("note: {remark}")));
    }
    let is_long = explanation.onsets.len().max(explanation.captures.len()) > WHOLE && !all;
    let list = if is_long { "--all lists every onset and capture; " } else { "" };
    lines.push(format!("\n{list}--format sql prints the queries that find these rows"));
    lines.join("\n") + "\n"
}

/// The row itself, on one line.
fn point(explanation: &Explanation) -> String {
    let row = &explanation.row;
    let number = |column: &str| row.get(column).and_then(Value::as_f64);
    let fixed =
        |column: &str, digits: usize| number(column).map_or("?".to_owned(), |value| format!("{value:.digits$}"));
    let mm = |column: &str| number(column).map(|sd_m| format!("{:.3} mm", sd_m * 1e3));
    let mut facts = Vec::new();
    match explanation.table_kind.as_str() {
        "patches" => {
            facts.push(row["kind"].as_str().unwrap_or_default().to_owned());
            facts.push(format!("({}, {}, {}) m", fixed("x_m", 5), fixed("y_m", 5), fixed("z_m", 5)));
            facts.extend(mm("sd_m").map(|sd| format!("sd {sd}")));
            facts.push(format!("from {}", onset_count(row)));
            facts.extend(number("chi2_dof").map(|chi2| format!("chi2/dof {chi2:.2}")));
        }
        "distances" => {
            facts.push(format!("{} m", fixed("distance_m", 5)));
            facts.extend(mm("sd_m").map(|sd| format!("sd {sd}")));
            let bounces = count(row["bounces"].as_u64().unwrap_or(0), "bounce", "bounces");
            facts.push(format!("from {} of up to {bounces}", onset_count(row)));
        }
        "echoes" => {
            facts.push(format!("({}, {}, {}) m", fixed("x_m", 3), fixed("y_m", 3), fixed("z_m", 3)));
            facts.push(format!("range {} m, sd {} m", fixed("range_m", 4), fixed("range_sd_m", 4)));
            facts.push(format!("{} ps, sd {} ps", fixed("time_ps", 1), fixed("time_sd_ps", 1)));
            facts.push(format!("height {}, width {} ps", fixed("height", 1), fixed("width_ps", 1)));
        }
        _ => {
            facts.push(format!("{} ps", fixed("time_ps", 2)));
            facts.push(format!("sd {} ps", fixed("time_sd_ps", 3)));
            facts.push(format!("amplitude {}", fixed("amplitude", 5)));
            facts.push(format!("snr {}", fixed("snr", 1)));
        }
    }
    format!("{} in `{}` ({}): {}", explanation.target, explanation.table, explanation.stage, facts.join(", "))
}

fn onset_count(row: &Map<String, Value>) -> String {
    count(row["onsets"].as_u64().unwrap_or(0), "onset", "onsets")
}

/// The chain of streamed tables that leads to it, and the whole tables that they use.
fn dataflow(explanation: &Explanation) -> String {
    let of = |name: &str| explanation.tables.iter().find(|table| table.table == name);
    let mut chain = Vec::new();
    let mut beside: Vec<&str> = Vec::new();
    let mut next = explanation.tables.last();
    while let Some(table) = next {
        let unkept = if table.lineage.is_none() { " (not kept)" } else { "" };
        chain.push(format!("{}{unkept}", table.table));
        let new: Vec<&str> = table.with.iter().map(String::as_str).filter(|name| !beside.contains(name)).collect();
        beside.extend(new);
        next = table.from.as_deref().and_then(of);
    }
    chain.reverse();
    let with = if beside.is_empty() { String::new() } else { format!("; with {}", beside.join(", ")) };
    format!("made from: {}{with}", chain.join(" -> "))
}

fn onsets(onsets: &[OnsetBehind], all: bool) -> Vec<String> {
    if onsets.is_empty() {
        return Vec::new();
    }
    let names = Names::of(onsets.iter().map(|onset| (&*onset.campaign, &*onset.sensor)));
    let is_whole = all || onsets.len() <= WHOLE;
    let which = if is_whole {
        "onsets".to_owned()
    } else {
        format!("{SHOWN} of {} onsets, with the largest residuals in standard deviations (pull)", onsets.len())
    };
    let heading = format!(
        "\n{which}\n  {}  lit seen rank  {:14} {:>12} {:>7} {:>8} {:>6} {:>6} {:>7}  flags",
        names.heading(),
        "path",
        "time_ps",
        "sd_ps",
        "resid_ps",
        "pull",
        "prob",
        "snr"
    );
    let line = |onset: &OnsetBehind| {
        let path = onset
            .path
            .as_ref()
            .map_or("-".to_owned(), |path| path.iter().map(ToString::to_string).collect::<Vec<_>>().join("-"));
        let left_out = if onset.used == Some(false) { "left out " } else { "" };
        let turns = onset.turns.filter(|turns| *turns != 0).map_or(String::new(), |turns| format!("{turns} turns "));
        let line = format!(
            "  {}  {:>3} {:>4} {:>4}  {path:14} {:>12} {:>7} {:>8} {:>6} {:>6} {:>7}  {left_out}{turns}{}",
            names.of_row(&onset.campaign, &onset.sensor),
            onset.lit,
            onset.seen,
            onset.rank,
            number(onset.time_ps, 2),
            number(onset.time_sd_ps, 3),
            number(onset.residual_ps, 2),
            number(onset.pull, 1),
            number(onset.probability, 2),
            number(onset.snr, 1),
            onset.flags.join(" ")
        );
        line.trim_end().to_owned()
    };
    let mut shown: Vec<&OnsetBehind> = onsets.iter().collect();
    if !is_whole {
        let pull = |onset: &OnsetBehind| onset.pull.map_or(0.0, f64::abs);
        shown.sort_by(|a, b| pull(b).total_cmp(&pull(a)));
        shown.truncate(SHOWN);
    }
    std::iter::once(heading).chain(shown.into_iter().map(line)).collect()
}

fn captures(captures: &[CaptureBehind], all: bool) -> Vec<String> {
    if captures.is_empty() {
        return Vec::new();
    }
    if !all && captures.len() > WHOLE {
        return vec![summary(captures)];
    }
    let names = Names::of(captures.iter().map(|capture| (&*capture.campaign, &*capture.sensor)));
    let heading = format!(
        "\ncaptures\n  {}  lit seen  {:>6} {:>8} {:>9} {:>9}  raw records",
        names.heading(),
        "shots",
        "rejected",
        "noise_mV",
        "chi2/dof"
    );
    let line = |capture: &CaptureBehind| {
        format!(
            "  {}  {:>3} {:>4}  {:>6} {:>8} {:>9} {:>9}  {}",
            names.of_row(&capture.campaign, &capture.sensor),
            capture.lit,
            capture.seen,
            capture.shots.map_or("-".to_owned(), |shots| shots.to_string()),
            capture.rejected.map_or("-".to_owned(), |rejected| rejected.to_string()),
            number(capture.noise_v.map(|noise_v| noise_v * 1e3), 3),
            number(capture.chi2_dof, 2),
            raw(&capture.raw)
        )
    };
    std::iter::once(heading).chain(captures.iter().map(line)).collect()
}

/// Many captures on one line.
fn summary(captures: &[CaptureBehind]) -> String {
    let sum = |of: fn(&CaptureBehind) -> Option<i32>| captures.iter().filter_map(of).map(i64::from).sum::<i64>();
    let files: BTreeSet<&str> =
        captures.iter().flat_map(|capture| &capture.raw).map(|records| records.file.as_str()).collect();
    let raw = match (files.first(), files.last()) {
        (Some(first), Some(last)) => format!("\n  {} files {first} .. {last}", files.len()),
        _ => String::new(),
    };
    format!(
        "\n{} captures: {} valid shots, {} rejected{raw}",
        captures.len(),
        sum(|capture| capture.shots),
        sum(|capture| capture.rejected)
    )
}

fn sensor(sensor: &SensorBehind) -> String {
    let range = sensor.range.as_ref().map_or(String::new(), |range| format!(" at range {range}"));
    let value = |value: Option<f64>, sd: Option<f64>| format!("{} +- {} ps", number(value, 2), number(sd, 2));
    let mut facts = Vec::new();
    match sensor.latency_ps {
        Some(_) => {
            facts.push(count(sensor.shots, "shot", "shots"));
            facts.push(format!("latency {}", value(sensor.latency_ps, sensor.latency_sd_ps)));
        }
        None => facts.push(count(sensor.shots, "fiducial run", "fiducial runs")),
    }
    if sensor.delay_ps.is_some() {
        facts.push(format!("further delay, fitted with the positions, {}", value(sensor.delay_ps, sensor.delay_sd_ps)));
    }
    format!("\nsensor {}{range} (`{}`): {}\n  {}", sensor.sensor, sensor.table, facts.join(", "), raw(&sensor.raw))
}

/// Raw records in short: a file with its segments, or the number of files.
fn raw(records: &[RawRecords]) -> String {
    let (references, signals): (Vec<&RawRecords>, Vec<&RawRecords>) =
        records.iter().partition(|records| records.is_reference);
    let several = |files: &[&RawRecords]| match files {
        [first, .., last] => format!("{} files {} .. {}", files.len(), first.file, last.file),
        _ => String::new(),
    };
    let reference = match (signals.as_slice(), references.as_slice()) {
        (_, []) => String::new(),
        // The same segments need not be repeated.
        ([signal], [one]) if signal.segments == one.segments => format!(", reference {}", file(one)),
        (_, [one]) => format!(", reference {}", one_file(one)),
        (_, files) => format!(", reference {}", several(files)),
    };
    match signals.as_slice() {
        [] => "not known".to_owned(),
        [one] => one_file(one) + &reference,
        files => several(files) + &reference,
    }
}

fn file(records: &RawRecords) -> String {
    let channel = records.channel.as_ref().map_or(String::new(), |channel| format!(" {channel}"));
    records.file.clone() + &channel
}

fn one_file(records: &RawRecords) -> String {
    let segments = match records.segments.as_deref() {
        None => String::new(),
        Some([one]) => format!(" segment {one}"),
        Some([first, .., last]) if (last - first) as usize + 1 == records.segments.as_ref().map_or(0, Vec::len) => {
            format!(" segments {first}-{last}")
        }
        Some(segments) => format!(" {} segments", segments.len()),
    };
    file(records) + &segments
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.digits$}"))
}

/// Columns for campaign and sensor, if there are several.
struct Names {
    campaign: Option<usize>,
    sensor: Option<usize>,
}

impl Names {
    fn of<'a>(rows: impl Iterator<Item = (&'a str, &'a str)>) -> Self {
        let (campaigns, sensors): (Vec<&str>, Vec<&str>) = rows.unzip();
        let width = |names: &[&str], heading: &str| {
            let differ = names.iter().any(|name| *name != names[0]);
            differ.then(|| names.iter().map(|name| name.len()).max().unwrap_or(0).max(heading.len()))
        };
        Self { campaign: width(&campaigns, "campaign"), sensor: width(&sensors, "sensor") }
    }

    fn heading(&self) -> String {
        self.of_row("campaign", "sensor")
    }

    fn of_row(&self, campaign: &str, sensor: &str) -> String {
        let column = |name: &str, width: Option<usize>| width.map_or(String::new(), |width| format!("{name:width$} "));
        column(campaign, self.campaign) + &column(sensor, self.sensor)
    }
}
