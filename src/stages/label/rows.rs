//! The rows of a solution: labels, hypotheses, and what was rejected.

use super::sd_ps;
use crate::geometry::hidden::{Hidden, Surface};
use crate::geometry::labelling::{self, Medium, SensorProfiles, Verdict, Verdicts};
use crate::priors::covariances;
use crate::stages::stage::Rejection;
use crate::tables::{Hypothesis, Label, Onset};

/// Labels of the onsets that the profiles of all sensors were made of, in the same order.
pub(super) fn labels(onsets: &[Onset], sensors: &[SensorProfiles], verdicts: Vec<Verdicts>) -> Vec<Label> {
    let mediums = sensors.iter().flat_map(|sensor| {
        let arrivals: usize = sensor.profiles.iter().map(|profile| profile.arrivals.len()).sum();
        std::iter::repeat_n(sensor.medium, arrivals)
    });
    let verdicts = verdicts.into_iter().flatten().flatten();
    let mut labels = Vec::new();
    for ((onset, medium), verdicts) in onsets.iter().zip(mediums).zip(verdicts) {
        labels.extend((0..).zip(verdicts).map(|(alternative, verdict)| label(onset, alternative, verdict, medium)));
    }
    labels
}

fn label(onset: &Onset, alternative: i32, verdict: Verdict, medium: Medium) -> Label {
    Label {
        campaign: onset.campaign.clone(),
        sensor: onset.sensor.clone(),
        lit: onset.lit,
        seen: onset.seen,
        range: onset.range.clone(),
        rank: onset.rank,
        time_ps: onset.time_ps + medium.turns_ps(verdict.turns),
        time_sd_ps: sd_ps(onset).hypot(verdict.blend_sd_ps),
        turns: verdict.turns,
        bounces: verdict.path.as_deref().map_or(0, crate::path::bounces),
        path: verdict.path,
        residual_ps: verdict.residual_ps,
        probability: verdict.probability,
        alternative,
    }
}

/// Each surface, and as its alternative 1 the other place where it may be.
pub(super) fn hypotheses(hypotheses: &[labelling::Hypothesis], false_alarm: f64) -> Vec<Hypothesis> {
    let needed = -false_alarm.ln();
    let mut rows = Vec::new();
    for (number, one) in (1..).zip(hypotheses) {
        let places = std::iter::once(one.surface).chain(one.rival);
        let of_place = |(alternative, place): (i32, Hidden)| Hypothesis {
            layer: one.layer,
            patch: one.patch,
            alternative,
            ..hypothesis(number, &place, needed)
        };
        rows.extend((0..).zip(places).map(of_place));
    }
    rows
}

fn hypothesis(number: i32, hidden: &Hidden, needed: f64) -> Hypothesis {
    let kind = if hidden.surface == Surface::Patch { "patch" } else { "plane" };
    let normal = hidden.surface.normal(hidden.point);
    let evidence = [hidden.evidence, needed];
    Hypothesis {
        kind: kind.into(),
        normal_x: normal.map(|normal| normal.x),
        normal_y: normal.map(|normal| normal.y),
        normal_z: normal.map(|normal| normal.z),
        onsets: hidden.arrivals,
        ..covariances::hypothesis_row(number, hidden.point, &hidden.covariance, evidence, hidden.seen)
    }
}

/// Why no hidden patch was looked for: all `visible_in_line` visible patches lie in one line.
pub(super) fn rejections(
    onsets: &[Onset],
    sensors: &[SensorProfiles],
    visible_in_line: Option<usize>,
) -> Vec<Rejection> {
    let first = onsets.first().zip(sensors.first()).zip(visible_in_line);
    let in_line = |((onset, sensor), visible): ((&Onset, &SensorProfiles), usize)| {
        Rejection::new(&onset.campaign, in_line(visible, sensor.dimensions))
    };
    first.map(in_line).into_iter().collect()
}

fn in_line(visible: usize, dimensions: usize) -> String {
    let (line, turn, place) = if dimensions == 2 {
        ("in one point", "that point", "another place")
    } else {
        ("in one line", "that line", "off that line")
    };
    format!(
        "the {visible} visible patches with known places lie {line}: hidden patches are known but for a turn about {turn}, and are not looked for;          light and see a patch in {place}"
    )
}
