//! The rows of a solution: labels, hypotheses, and what was rejected.

use crate::geometry::hidden::{Hidden, Surface};
use crate::geometry::labelling::{self, Loser, Medium, Origin, SensorProfiles, Solution, Verdict};
use crate::priors::covariances;
use crate::stages::stage::Rejection;
use crate::tables::{Hypothesis, Label, Onset};

/// Labels of the onsets that the profiles of all sensors were made of, in the same order.
pub(super) fn labels(onsets: &[Onset], sensors: &[SensorProfiles], solution: Solution) -> Vec<Label> {
    let Solution { verdicts, arrivals, losers, .. } = solution;
    let profiles = sensors.iter().flat_map(|sensor| sensor.profiles.iter().map(|profile| (sensor.medium, profile)));
    let solved = verdicts.into_iter().flatten().zip(arrivals.into_iter().flatten()).zip(losers.into_iter().flatten());
    let (mut labels, mut first) = (Vec::new(), 0);
    for ((medium, profile), ((verdicts, arrivals), losers)) in profiles.zip(solved) {
        let of_profile = &onsets[first..first + profile.arrivals.len()];
        first += of_profile.len();
        let mut of_onsets = vec![Vec::new(); of_profile.len()];
        for ((origin, arrival), verdicts) in arrivals.into_iter().zip(verdicts) {
            let place = Place { origin, time_ps: arrival.time_ps, sd_ps: arrival.sd_ps };
            let of_arrival = (0..).zip(verdicts).map(|(alternative, verdict)| (place, alternative, verdict));
            of_onsets[origin.onset].extend(of_arrival);
        }
        for Loser { origin, time_ps, sd_ps, verdict } in losers {
            let of_onset = &mut of_onsets[origin.onset];
            let alternative = of_onset.iter().map(|(_, alternative, _)| alternative + 1).max().unwrap_or(0);
            of_onset.push((Place { origin, time_ps, sd_ps }, alternative, verdict));
        }
        for (onset, rows) in of_profile.iter().zip(of_onsets) {
            let row = |(place, alternative, verdict)| label(onset, place, alternative, verdict, medium);
            labels.extend(rows.into_iter().map(row));
        }
    }
    labels
}

/// An onset or a part of it, and when its light comes.
#[derive(Clone, Copy)]
struct Place {
    origin: Origin,
    time_ps: f64,
    sd_ps: f64,
}

fn label(onset: &Onset, place: Place, alternative: i32, verdict: Verdict, medium: Medium) -> Label {
    let part = place.origin.part;
    let own = if part == 0 { own(onset) } else { None };
    let Place { time_ps, sd_ps, .. } = own.map_or(place, |[time_ps, sd_ps]| Place { time_ps, sd_ps, ..place });
    Label {
        campaign: onset.campaign.clone(),
        sensor: onset.sensor.clone(),
        lit: onset.lit,
        seen: onset.seen,
        range: onset.range.clone(),
        acquired_at: onset.acquired_at.clone(),
        rank: onset.rank,
        part,
        time_ps: time_ps + medium.turns_ps(verdict.turns),
        time_sd_ps: sd_ps.hypot(verdict.blend_sd_ps),
        covariance: if alternative == 0 { covariance_ps2(onset, place.origin) } else { Vec::new() },
        width_ps: (part == 0).then_some(onset.width_ps),
        width_sd_ps: onset.width_sd_ps.filter(|_| part == 0),
        own_variance_ps2: onset.own_variance_ps2.filter(|_| part == 0),
        width_kurtosis: onset.width_kurtosis.filter(|_| part == 0),
        snr: snr(onset, part),
        turns: verdict.turns,
        bounces: verdict.path.as_deref().map_or(0, crate::path::bounces),
        path: verdict.path,
        residual_ps: verdict.residual_ps,
        probability: verdict.probability,
        alternative,
    }
}

/// Time and standard deviation of an onset as its profile alone has them; `None` where they rest on nothing else.
fn own(onset: &Onset) -> Option<[f64; 2]> {
    let variance_ps2 = *covariances::of_onset_ps2(onset).get(onset.rank as usize - 1)?;
    Some([onset.own_time_ps?, variance_ps2.sqrt()])
}

/// Of an onset or a part of it with all onsets of its profile; that of a part with others is its onset's.
pub(super) fn covariance_ps2(onset: &Onset, origin: Origin) -> Vec<f64> {
    let mut all = covariances::of_onset_ps2(onset);
    if let (1.., Some(own)) = (origin.part, all.get_mut(onset.rank as usize - 1)) {
        *own = origin.with_other_ps2;
    }
    all
}

/// Signal-to-noise ratio of an onset, or of one of the two pulses that it is read as.
fn snr(onset: &Onset, part: i32) -> f64 {
    let of_part = match part {
        1 => onset.pair_first_amplitude,
        2 => onset.pair_second_amplitude,
        _ => None,
    };
    of_part.map_or(onset.snr, |amplitude| onset.snr * (amplitude / onset.amplitude).abs())
}

/// Each surface, and as its alternative 1 the other place where it may be. Visible patches that their light shows come
/// first.
pub(super) fn hypotheses(solution: &Solution, false_alarm: f64) -> Vec<Hypothesis> {
    let needed = -false_alarm.ln();
    let found = solution.places.iter().map(|(patch, surface)| labelling::Hypothesis {
        layer: 1,
        patch: Some(*patch),
        surface: *surface,
        rival: None,
    });
    let mut rows = Vec::new();
    for (number, one) in (1..).zip(found.chain(solution.hypotheses.iter().copied())) {
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
        ("in one point", "that point", "in another place")
    } else {
        ("in one line", "that line", "off that line")
    };
    format!(
        "the {visible} visible patches with known places lie {line}: hidden patches are known but for a turn about {turn}, and are not looked for; light and see a patch {place}"
    )
}
