//! Whether pulses, noise and baseline explain the profiles, and whether pulses have the width of the calibration.

use std::collections::{BTreeMap, BTreeSet};

use super::decision;
use crate::tables::{Calibration, Decision, Name, Onset};

/// Share of profiles that noise alone makes a misfit, at most; and as many are none of their own.
const BY_CHANCE: f64 = 0.02;
const FEW: usize = 1;
/// Standard deviations, and share of itself, by which a width contradicts the calibration: a response changes its shape
/// a little with everything.
const CLAIM_SIGMA: f64 = 3.0;
const CLAIM_SHARE: f64 = 0.005;

/// Largest share of the light that cables and their ends put into echoes and a tail: more is another response.
const TAIL_MAX: f64 = 0.05;

/// A profile: sensor, lit and seen patch.
type Key<'a> = (&'a Name, i32, i32);

/// One row for all waveforms, and one a sensor for its response.
pub(super) fn decisions(onsets: &[Onset]) -> Vec<Decision> {
    let key = |onset: &Onset| (onset.sensor.clone(), onset.lit, onset.seen);
    let profiles: BTreeSet<_> = onsets.iter().map(key).collect();
    if profiles.is_empty() {
        return Vec::new();
    }
    let with = |flag: &str| {
        let is_flagged = |onset: &&Onset| onset.flags.iter().any(|name| &**name == flag);
        onsets.iter().filter(is_flagged).map(key).collect::<BTreeSet<_>>().len()
    };
    let (all, misfits, moving) = (profiles.len(), with("misfit"), with("moving-baseline"));
    let chosen = if is_by_chance(misfits, all) {
        "explained by pulses, noise and baseline".to_owned()
    } else {
        format!(
            "not explained in {misfits} of {all} profiles: the program widened their standard deviations (flag `misfit`)"
        )
    };
    let evidence = match moving {
        0 => format!("chi-square of {misfits} of {all} profiles exceeds noise"),
        _ => format!("chi-square of {misfits} of {all} profiles exceeds noise; the baseline moves in {moving}"),
    };
    let text = "a response captured with the same setting and on the same day, or its echoes and tail";
    let mut rows = vec![decision("waveforms", &chosen, &evidence, text)];
    rows.extend(widths(onsets).into_iter().map(|(sensor, width)| width.decision(sensor)));
    rows
}

/// Echoes or a tail that `recalibrate` added to a response.
pub(super) fn tail(row: &Calibration) -> Option<Decision> {
    let (share, evidence) = row.scene_tail.zip(row.scene_evidence)?;
    let more = if share > 0.0 { "more" } else { "less" };
    let is_far = share.abs() > TAIL_MAX;
    let verdict = if is_far { "the calibration contradicts the scene, and was corrected" } else { "corrected" };
    Some(Decision {
        log_likelihood_ratio: Some(evidence),
        runner_up: Some("the response of the response captures".into()),
        ..decision(
            &format!("echoes of {}", row.sensor),
            &format!("{verdict}: {:.2} % {more} light in echoes or a tail than calibrated", 1e2 * share.abs()),
            &format!("as much in all profiles, whatever lies where: log-likelihood ratio {evidence:.1}"),
            "response captures with the same cables and on the same day",
        )
    })
}

/// Whether noise makes so many of all profiles contradict their pulses.
#[must_use]
pub fn is_by_chance(misfits: usize, all: usize) -> bool {
    misfits <= FEW.max((BY_CHANCE * all as f64) as usize)
}

/// Width of a sensor's response over the calibration's.
struct Width {
    factor: f64,
    sd: f64,
    profiles: usize,
}

/// The widths that the profiles of each sensor show, together.
fn widths(onsets: &[Onset]) -> BTreeMap<&Name, Width> {
    let shown = |onset: &'_ Onset| onset.response_width.zip(onset.response_width_sd);
    let profiles: BTreeMap<Key<'_>, (f64, f64)> =
        onsets.iter().filter_map(|onset| Some(((&onset.sensor, onset.lit, onset.seen), shown(onset)?))).collect();
    let mut sums = BTreeMap::<&Name, (f64, f64, usize)>::new();
    for ((sensor, ..), (factor, sd)) in profiles {
        let (weighted, weights, count) = sums.entry(sensor).or_default();
        *weighted += factor / (sd * sd);
        *weights += 1.0 / (sd * sd);
        *count += 1;
    }
    let width = |(weighted, weights, profiles): (f64, f64, usize)| Width {
        factor: weighted / weights,
        sd: weights.sqrt().recip(),
        profiles,
    };
    sums.into_iter().map(|(sensor, sum)| (sensor, width(sum))).collect()
}

impl Width {
    fn decision(&self, sensor: &Name) -> Decision {
        let off = self.factor - 1.0;
        let percent = 1e2 * off.abs();
        let chosen = if off.abs() < CLAIM_SHARE + CLAIM_SIGMA * self.sd {
            "as wide as calibrated".to_owned()
        } else if off < 0.0 {
            format!("the calibration contradicts the scene: pulses are {percent:.1} % narrower")
        } else {
            format!("pulses are {percent:.1} % wider: the calibration is of another state, or patches spread the light")
        };
        decision(
            &format!("response of {sensor}"),
            &chosen,
            &format!(
                "width over the calibration's {:.4} with sd {:.4}, of {} profiles",
                self.factor, self.sd, self.profiles
            ),
            "response captures with the same setting and on the same day",
        )
    }
}
