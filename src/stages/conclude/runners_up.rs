//! Choices between places and between solutions: what was chosen, and what comes next to it.

use super::decision;
use crate::tables::{Ambiguity, Decision, Hypothesis, SceneOdds};
use crate::units::PatchId;

/// Log-likelihoods that differ by less are the same to a reader.
const ALIKE: f64 = 0.05;

/// Whether two choices are as likely, by the difference of their log-likelihoods.
#[must_use]
pub fn are_alike(log_likelihood: f64) -> bool {
    log_likelihood.abs() < ALIKE
}

/// How many patches a search accepted, and the likeliest place that it did not. The last texts: the evidence without
/// any place, and what would change the choice without a declined one.
pub(super) fn places(what: &str, count: usize, hypotheses: &[Hypothesis], [none, would_change]: [&str; 2]) -> Decision {
    let places = || hypotheses.iter().filter(|place| &*place.kind == "patch" && place.alternative == 0);
    let weakest = places().filter(|place| place.patch.is_some()).map(|place| place.evidence).reduce(f64::min);
    let needed = hypotheses.first().map(|place| place.evidence_needed);
    let evidence = match (weakest, needed) {
        (Some(weakest), Some(needed)) => format!("least log Bayes factor {weakest:.1}, {needed:.1} is needed"),
        _ => none.to_owned(),
    };
    let chosen = if count == 0 { "none".to_owned() } else { format!("{count} accepted") };
    // Less than even odds make no runner-up.
    let Some(place) = places().find(|place| place.patch.is_none() && place.evidence > 0.0) else {
        return decision(what, &chosen, &evidence, would_change);
    };
    let needed = place.evidence_needed;
    let evidence = if weakest.is_none() {
        format!("log Bayes factor {:.1} at the likeliest place, {needed:.1} is needed", place.evidence)
    } else {
        evidence
    };
    let shots = place.shots_needed.map(|shots| format!("about {shots:.0} shots per capture would show it"));
    Decision {
        runner_up: Some(
            format!(
                "one more at ({:.3}, {:.3}, {:.3}) m, log Bayes factor {:.1}",
                place.x_m, place.y_m, place.z_m, place.evidence
            )
            .into(),
        ),
        ..decision(what, &chosen, &evidence, &shots.unwrap_or_else(|| "more shots".to_owned()))
    }
}

/// Which of two places, both of which first light allows, was taken.
pub(super) fn place(scene: &SceneOdds) -> Decision {
    let (first, other) = ("the likeliest place by first light", format!("alternative {}", scene.alternative));
    let (chosen, runner_up) = if scene.taken { (other.as_str(), first) } else { (first, other.as_str()) };
    let evidence = format!("with all bounces, the other place is {}", how_likely(scene.log_likelihood));
    Decision {
        runner_up: Some(runner_up.into()),
        log_likelihood_ratio: Some(-scene.log_likelihood),
        ..decision(
            &format!("place: {}", of_patches(&scene.patches)),
            chosen,
            &evidence,
            "a pair of these patches with one more neighbour",
        )
    }
}

/// What the onsets do not determine, next to the solution that was chosen.
pub(super) fn other_solution(ambiguity: &Ambiguity) -> Decision {
    let which = if ambiguity.patches.is_empty() { "all patches".to_owned() } else { of_patches(&ambiguity.patches) };
    let (chosen, evidence) = match (ambiguity.log_likelihood, ambiguity.sd_m) {
        (Some(log_likelihood), _) => {
            ("the solution of `patches`", format!("the other solution is {}", how_likely(log_likelihood)))
        }
        (None, Some(sd_m)) => {
            ("kept, with their errors", format!("in one direction known to {:.2} mm alone", 1e3 * sd_m))
        }
        (None, None) => ("the solution of `patches`", "no onset decides".to_owned()),
    };
    Decision {
        runner_up: ambiguity.alternative.map(|number| format!("alternative {number} of `patches`").into()),
        log_likelihood_ratio: ambiguity.log_likelihood.map(|log_likelihood| -log_likelihood),
        ..decision(&format!("{}: {which}", ambiguity.kind), chosen, &evidence, &ambiguity.meaning)
    }
}

fn of_patches(patches: &[PatchId]) -> String {
    let numbers: Vec<String> = patches.iter().map(ToString::to_string).collect();
    let noun = if patches.len() == 1 { "patch" } else { "patches" };
    format!("{noun} {}", numbers.join(", "))
}

/// How likely another choice is, by its log-likelihood less that of the chosen one.
fn how_likely(log_likelihood: f64) -> String {
    if are_alike(log_likelihood) {
        return "as likely".to_owned();
    }
    let word = if log_likelihood < 0.0 { "less likely" } else { "likelier" };
    let factor = log_likelihood.abs().exp();
    if factor < 1e3 {
        format!("{word} by a factor of {factor:.1}")
    } else {
        format!("{word} by a factor of {factor:.1e}")
    }
}
