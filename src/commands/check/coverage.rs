//! What was captured, by the rules of campaign.toml, and what is missing.

use std::collections::{BTreeMap, BTreeSet};

use periscope::campaign::{Campaign, LeftOut, Role, Survey};
use periscope::tables::{Calibration, Measurement};

use super::super::output::count;
use super::report::{Captures, Pair, Report, listed};

/// Sensors that record a reference pulse but have no template of it: their shots cannot be aligned.
pub fn without_template(survey: &Survey, calibrated: &[Calibration]) -> BTreeSet<String> {
    let with_template = |sensor: &str| calibrated.iter().any(|row| &*row.sensor == sensor && row.reference.is_some());
    let with_reference = survey.exposures.iter().filter(|exposure| exposure.reference.is_some());
    let sensors = with_reference.filter_map(|exposure| exposure.sensor.clone());
    sensors.filter(|sensor| !with_template(sensor)).collect()
}

/// Fills in the results of the survey.
pub fn fill(
    report: &mut Report,
    campaign: &Campaign,
    survey: &Survey,
    measurements: &[Measurement],
    left_out: &[LeftOut],
    uncalibrated: &BTreeSet<String>,
) {
    captures(report, survey);
    report.unmatched = survey.unmatched.iter().map(|file| file.display().to_string()).collect();
    report.empty.clone_from(&survey.empty);
    let missing = survey.missing_references.iter();
    report.missing_references =
        missing.map(|missing| format!("{} (wanted {})", missing.file.display(), missing.wanted)).collect();
    for LeftOut { cause, items, .. } in left_out {
        report.fix.push(format!("{}. {}", cause.words(items.len()), cause.fix()));
    }
    for sensor in uncalibrated {
        report.fix.push(format!(
            "sensor {sensor} is not calibrated, so that its shots are not measured: capture its response (role response) with the same reference channel"
        ));
    }
    // A flight has no patches that it should have lit and seen too.
    if !campaign.is_of_lidar() {
        for (sensor, present) in pairs(survey, measurements) {
            missing_pairs(report, campaign, &sensor, &present);
        }
    }
}

fn captures(report: &mut Report, survey: &Survey) {
    type Count<'a> = (BTreeSet<(Option<i32>, Option<i32>, Option<&'a str>)>, usize);
    let mut counts: BTreeMap<(Role, String), Count<'_>> = BTreeMap::new();
    for exposure in &survey.exposures {
        let key = (exposure.role, exposure.sensor.clone().unwrap_or_default());
        let (captures, files) = counts.entry(key).or_default();
        captures.insert((exposure.lit, exposure.seen, exposure.run.as_deref()));
        *files += 1;
    }
    report.captures = counts
        .into_iter()
        .map(|((role, sensor), (captures, files))| Captures {
            role: role.name().to_owned(),
            sensor,
            count: captures.len(),
            files,
        })
        .collect();
}

/// Existing pairs of the scene, by sensor: those that the rules name, and those in arrays.
fn pairs(survey: &Survey, measurements: &[Measurement]) -> BTreeMap<String, BTreeSet<Pair>> {
    let mut pairs: BTreeMap<String, BTreeSet<Pair>> = BTreeMap::new();
    for exposure in survey.exposures.iter().filter(|exposure| exposure.role == Role::Scene) {
        if let (Some(sensor), Some(lit), Some(seen)) = (&exposure.sensor, exposure.lit, exposure.seen) {
            pairs.entry(sensor.clone()).or_default().insert(Pair { lit, seen });
        }
    }
    for row in measurements.iter().filter(|row| *row.role == *Role::Scene.name()) {
        pairs.entry(row.sensor.to_string()).or_default().insert(Pair { lit: row.lit, seen: row.seen });
    }
    pairs
}

fn missing_pairs(report: &mut Report, campaign: &Campaign, sensor: &str, present: &BTreeSet<Pair>) {
    let lit: BTreeSet<i32> = present.iter().map(|pair| pair.lit).collect();
    let seen: BTreeSet<i32> = present.iter().map(|pair| pair.seen).collect();
    // If no patch was both lit and seen at once, such pairs are not expected.
    let diagonal = present.iter().any(|pair| pair.lit == pair.seen);
    let wanted = |pair: &Pair| {
        !present.contains(pair) && (diagonal || pair.lit != pair.seen) && !excluded(campaign, sensor, *pair)
    };
    let rectangle = lit.iter().flat_map(|&lit| seen.iter().map(move |&seen| Pair { lit, seen }));
    let missing: Vec<Pair> = rectangle.filter(wanted).collect();
    let overlap = lit.intersection(&seen).next().is_some();
    let reciprocals = present.iter().map(|pair| Pair { lit: pair.seen, seen: pair.lit });
    let reciprocals: Vec<Pair> =
        reciprocals.filter(|pair| overlap && wanted(pair) && !missing.contains(pair)).collect();
    for (pairs, one, many) in [
        (&missing, "pair (lit, seen) is missing", "pairs (lit, seen) are missing"),
        (&reciprocals, "reciprocal pair (lit, seen) is missing", "reciprocal pairs (lit, seen) are missing"),
    ] {
        if !pairs.is_empty() {
            let counted = count(pairs.len(), one, many);
            report.fix.push(format!("sensor {sensor}: {counted}: capture {}", listed(pairs)));
        }
    }
    let entry = report.sensor(sensor);
    (entry.missing_pairs, entry.missing_reciprocals) = (missing, reciprocals);
}

/// Whether an exclusion covers this pair.
fn excluded(campaign: &Campaign, sensor: &str, pair: Pair) -> bool {
    campaign.exclude.iter().any(|exclude| {
        let matches = &exclude.matches;
        let whole =
            matches.shot.is_none() && matches.range.is_none() && matches.channel.is_none() && matches.file.is_none();
        whole
            && matches.role.is_none_or(|role| role == Role::Scene)
            && matches.sensor.as_deref().is_none_or(|of| of == sensor)
            && matches.lit.is_none_or(|lit| lit == pair.lit)
            && matches.seen.is_none_or(|seen| seen == pair.seen)
    })
}
