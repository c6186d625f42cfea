//! `conclude`: what a solution rests on: each choice that was made on the way, its evidence and its runner-up.
//!
//! No number is computed anew. The stage collects what the other stages measured, and says it in one place:
//!
//! | what | from |
//! |---|---|
//! | fit | chi-square of `fits`: whether the model explains the onsets |
//! | labels | onsets with a path, and without one |
//! | hidden patches | `hypotheses`: those accepted, and the likeliest one that was not |
//! | walls | `hypotheses` that are planes |
//! | places | `scenes`: which of the places that first light left open all onsets support, and by how much |
//! | other solutions | `ambiguities`: mirror images, flips, loose parts, with their likelihoods |
//! | frame | `fits.frame`: what fixes it |
//! | walls of the patches | `planes`: which patches lie on one |
//! | sizes of patches | `footprints`: which patches are no points, and how that is known |
//! | pulse shapes | onsets that are wider than the response, and how many blend |
//! | vertical ranges | onsets by range |
//!
//! A fit whose residuals are larger than chance makes them is `not explained`: `refine` has then made all standard
//! deviations larger (`fits.misfit`), and the first row says by how much.
//!
//! Takes `patches`; writes `decisions`. Beside it `fits` and `ambiguities` (of the same `refine`), `labels` and
//! `onsets`; optional `hypotheses` and `scenes` (of the same `label`), `planes`, and `footprints` (of the
//! same `refine`).
//!
//! ```toml
//! [decisions]
//! stage = "conclude"
//! from = "patches"
//! with.fits = "patches.fits"
//! with.ambiguities = "patches.ambiguities"
//! with.labels = "labels"
//! with.hypotheses = "labels.hypotheses"
//! with.onsets = "onsets"
//! with.planes = "planes"
//! with.footprints = "patches.footprints"
//! with.scenes = "labels.scenes"
//! ```

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Stage, StageError};
use crate::campaign::Campaign;
use crate::geometry::maximum_likelihood;
use crate::tables::{
    Ambiguity, Decision, Fit, Hypothesis, Label, Name, ONSET_KINDS, Onset, Patch, PatchFootprint, Plane, SceneOdds,
};

/// Parameters of `conclude`: none.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Conclude {}

/// The tables that the choices stand in.
pub struct Context {
    fits: Vec<Fit>,
    ambiguities: Vec<Ambiguity>,
    labels: Vec<Label>,
    hypotheses: Vec<Hypothesis>,
    onsets: Vec<Onset>,
    planes: Vec<Plane>,
    footprints: Vec<PatchFootprint>,
    scenes: Vec<SceneOdds>,
}

impl Stage for Conclude {
    const KIND: &'static str = "conclude";
    const VERSION: u32 = 3;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "fits", table: "fits", required: true },
        Beside { name: "ambiguities", table: "ambiguities", required: true },
        Beside { name: "labels", table: "labels", required: true },
        Beside { name: "onsets", table: "onsets", required: true },
        Beside { name: "hypotheses", table: "hypotheses", required: false },
        Beside { name: "planes", table: "planes", required: false },
        Beside { name: "footprints", table: "footprints", required: false },
        Beside { name: "scenes", table: "scenes", required: false },
    ];
    type Input = Patch;
    type Output = Decision;
    type Fields = ();
    type Context = Context;

    fn fields(&self, _: &[Campaign]) {}

    fn context(&self, (): (), beside: &BesideTables) -> Result<Context, StageError> {
        Ok(Context {
            fits: beside.rows("fits")?.unwrap_or_default(),
            ambiguities: beside.rows("ambiguities")?.unwrap_or_default(),
            labels: beside.rows("labels")?.unwrap_or_default(),
            hypotheses: beside.rows("hypotheses")?.unwrap_or_default(),
            onsets: beside.rows("onsets")?.unwrap_or_default(),
            planes: beside.rows("planes")?.unwrap_or_default(),
            footprints: beside.rows("footprints")?.unwrap_or_default(),
            scenes: beside.rows("scenes")?.unwrap_or_default(),
        })
    }
}

impl Apply for Conclude {
    fn apply(&self, context: &Context, patches: Vec<Patch>) -> Result<Outcome<Decision>, StageError> {
        // An empty result is reported where its rows were lost.
        if patches.is_empty() {
            return Ok(Outcome::rows(Vec::new()));
        }
        let best: Vec<&Patch> = patches.iter().filter(|patch| patch.alternative == 0).collect();
        let mut decisions = vec![context.fit(), context.labelled(), context.hidden(&best)];
        decisions.extend(context.walls());
        decisions.extend(context.scenes.iter().map(place));
        // The row of the frame says what a free rotation means.
        decisions.extend(context.ambiguities.iter().filter(|one| &*one.kind != "rotation").map(other_solution));
        decisions.extend([context.frame(), context.coplanar(&best), context.sizes(), context.pulse_shapes()]);
        decisions.extend(context.ranges());
        for (number, decision) in (1..).zip(&mut decisions) {
            decision.decision = number;
        }
        Ok(Outcome::rows(decisions))
    }
}

impl Context {
    fn best_fit(&self) -> Option<&Fit> {
        self.fits.iter().find(|fit| fit.alternative == 0)
    }

    /// Whether the model explains the onsets.
    fn fit(&self) -> Decision {
        let Some(fit) = self.best_fit() else {
            return decision(
                "fit",
                "anchors as given",
                "no onset has a path over them alone; their places are those of campaign.toml",
                "captures in which their own light is not gated away",
            );
        };
        let evidence = format!("chi-square {:.1} of {} degrees of freedom", fit.chi2, fit.degrees_of_freedom);
        if fit.degrees_of_freedom < 1 {
            let more = "one onset more than unknowns; nothing checks this fit";
            return decision("fit", "unchecked", &evidence, more);
        }
        let wider: Vec<String> = ONSET_KINDS
            .iter()
            .zip(&fit.widened)
            .filter(|(_, factor)| **factor > 1.0)
            .map(|(kind, factor)| format!("{:.1} times for {kind}", factor.sqrt()))
            .chain((fit.misfit > 1.0).then(|| format!("{:.1} times for all", fit.misfit.sqrt())))
            .collect();
        if !wider.is_empty() {
            let chosen = format!("not explained: standard deviations are larger for it, {}", wider.join(", "));
            let text =
                "right labels or a better instrument response; `suspects` lists the onsets that contradict the fit";
            return decision("fit", &chosen, &evidence, text);
        }
        let is_whole = fit.chi2 <= maximum_likelihood::by_chance(fit.degrees_of_freedom.into());
        let chosen = if is_whole { "explained" } else { "explained but for the onsets that `suspects` lists" };
        decision("fit", chosen, &evidence, "residuals larger than chance makes them in one campaign of 1,000")
    }

    /// How many pulses have a path: onsets, and the two parts of those that are read as two.
    fn labelled(&self) -> Decision {
        let best = || self.labels.iter().filter(|label| label.alternative == 0);
        let (all, open) = (best().count(), best().filter(|label| label.path.is_none()).count());
        let mut orders = BTreeMap::<i32, usize>::new();
        best().filter(|label| label.path.is_some()).for_each(|label| *orders.entry(label.bounces).or_default() += 1);
        let orders: Vec<String> = orders.iter().map(|(order, count)| format!("{count} of order {order}")).collect();
        Decision {
            runner_up: (open > 0).then(|| format!("{open} without a path").into()),
            ..decision(
                "labels",
                &format!("{} of {all} pulses have a path", all - open),
                &if orders.is_empty() {
                    "no path explains a pulse".to_owned()
                } else {
                    format!("bounces: {}", orders.join(", "))
                },
                "patches or walls that the model does not have",
            )
        }
    }

    /// Which patches lie hidden, and which place was not accepted as one.
    fn hidden(&self, patches: &[&Patch]) -> Decision {
        let places = || self.hypotheses.iter().filter(|place| &*place.kind == "patch" && place.alternative == 0);
        let accepted: Vec<&Hypothesis> = places().filter(|place| place.patch.is_some()).collect();
        let count = patches.iter().filter(|patch| &*patch.kind == "hidden").count();
        let weakest = accepted.iter().map(|place| place.evidence).reduce(f64::min);
        let needed = self.hypotheses.first().map(|place| place.evidence_needed);
        let evidence = match (weakest, needed) {
            (Some(weakest), Some(needed)) => format!("least log Bayes factor {weakest:.1}, {needed:.1} is needed"),
            _ => "no onset is left that a hidden patch would explain".to_owned(),
        };
        let chosen = if count == 0 { "none".to_owned() } else { format!("{count} accepted") };
        let declined = places().find(|place| place.patch.is_none());
        let Some(place) = declined else {
            return decision("hidden patches", &chosen, &evidence, "onsets that no path explains");
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
            ..decision("hidden patches", &chosen, &evidence, &shots.unwrap_or_else(|| "more shots".to_owned()))
        }
    }

    /// Planes that reflect light and are no patches.
    fn walls(&self) -> Option<Decision> {
        let walls: Vec<f64> =
            self.hypotheses.iter().filter(|place| &*place.kind == "plane").map(|place| place.evidence).collect();
        let weakest = walls.iter().copied().reduce(f64::min)?;
        Some(decision(
            "walls",
            &format!("{} reflect light from patch to patch", walls.len()),
            &format!("least log Bayes factor {weakest:.1}"),
            "onsets that contradict them",
        ))
    }

    /// What fixes the frame of coordinates.
    fn frame(&self) -> Decision {
        let frame = self.best_fit().map_or("fixed", |fit| &*fit.frame);
        let (chosen, evidence, would_change) = match frame {
            "canonical" => (
                "canonical, a convention",
                "no anchor, ray or second station: only distances are measured",
                "three anchors (`position_m`) in campaign.toml",
            ),
            "stations" => (
                "stations; the turn about their line is a convention",
                "laser and sensors stand apart",
                "an anchor (`position_m`) off their line in campaign.toml",
            ),
            _ => ("that of campaign.toml", "anchors, rays or stations fix it", "other places in campaign.toml"),
        };
        decision("frame", chosen, evidence, would_change)
    }

    /// Which patches lie on planes.
    fn coplanar(&self, patches: &[&Patch]) -> Decision {
        let on_planes = |patch: &&&Patch| self.planes.iter().any(|plane| plane.patches.contains(&patch.patch));
        let count = patches.iter().filter(on_planes).count();
        if count == 0 {
            return decision(
                "walls of the patches",
                "none",
                "no five patches lie on one plane within their errors",
                "patches measured more exactly",
            );
        }
        let farthest_sd = self.planes.iter().map(|plane| plane.rms_m).fold(0.0, f64::max);
        decision(
            "walls of the patches",
            &format!("{count} of {} patches lie on {} planes", patches.len(), self.planes.len()),
            &format!("largest rms distance {:.2} mm", 1e3 * farthest_sd),
            "patches measured more exactly",
        )
    }

    /// Which patches are no points, and how that is known.
    fn sizes(&self) -> Decision {
        let from = |source: &str| self.footprints.iter().filter(|one| &*one.source == source).count();
        let (campaign, widths) = (from("campaign"), from("widths"));
        if self.footprints.is_empty() {
            let text = "`size_m` of patches in campaign.toml, or pulses that are wider than the response";
            return decision("sizes of patches", "points of light", "no patch spreads its pulses", text);
        }
        let least_m = self.footprints.iter().map(|one| one.size_m).fold(f64::INFINITY, f64::min);
        let most_m = self.footprints.iter().map(|one| one.size_m).fold(0.0, f64::max);
        decision(
            "sizes of patches",
            &format!("{} disks of {:.1} to {:.1} cm", self.footprints.len(), 1e2 * least_m, 1e2 * most_m),
            &format!("{campaign} from campaign.toml, {widths} from the widths of their pulses"),
            "`size_m` and `normal` of patches in campaign.toml, in a fixed frame",
        )
    }

    /// Which pulses are wider than the response, and which blend.
    fn pulse_shapes(&self) -> Decision {
        let with =
            |flag: &str| self.onsets.iter().filter(|onset| onset.flags.iter().any(|name| &**name == flag)).count();
        let (all, wide, blended) = (self.onsets.len(), with("extended"), with("blended"));
        decision(
            "pulse shapes",
            &format!("{} points of light, {wide} spread in time", all - wide),
            &format!("{blended} of {all} onsets overlap a neighbour"),
            "more shots, or a sensor with a narrower response",
        )
    }

    /// Vertical ranges that gave onsets, where a sensor has several.
    fn ranges(&self) -> Option<Decision> {
        let mut ranges = BTreeMap::<&Name, usize>::new();
        self.onsets
            .iter()
            .filter_map(|onset| onset.range.as_ref())
            .for_each(|range| *ranges.entry(range).or_default() += 1);
        (ranges.len() > 1).then(|| {
            let list: Vec<String> = ranges.iter().map(|(range, count)| format!("{range}: {count} onsets")).collect();
            let text = "a range that does not clip";
            decision("vertical ranges", &format!("{} ranges", ranges.len()), &list.join(", "), text)
        })
    }
}

/// Which of two places, both of which first light allows, was taken.
fn place(scene: &SceneOdds) -> Decision {
    let patches: Vec<String> = scene.patches.iter().map(ToString::to_string).collect();
    let (first, other) = ("the likeliest place by first light", format!("alternative {}", scene.alternative));
    let (chosen, runner_up) = if scene.taken { (other.as_str(), first) } else { (first, other.as_str()) };
    let evidence = format!(
        "with all bounces, the other place is less likely by a factor of {:.3e}",
        (-scene.log_likelihood).exp()
    );
    Decision {
        runner_up: Some(runner_up.into()),
        log_likelihood_ratio: Some(-scene.log_likelihood),
        ..decision(
            &format!("place: patches {}", patches.join(", ")),
            chosen,
            &evidence,
            "a pair of these patches with one more neighbour",
        )
    }
}

/// What the onsets do not determine, next to the solution that was chosen.
fn other_solution(ambiguity: &Ambiguity) -> Decision {
    let patches: Vec<String> = ambiguity.patches.iter().map(ToString::to_string).collect();
    let which = if patches.is_empty() { "all patches".to_owned() } else { format!("patches {}", patches.join(", ")) };
    let (chosen, evidence) = match (ambiguity.log_likelihood, ambiguity.sd_m) {
        (Some(log_likelihood), _) => (
            "the solution of `patches`",
            format!("the other solution is less likely by a factor of {:.3e}", (-log_likelihood).exp()),
        ),
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

/// A decision without a runner-up; its number comes later.
fn decision(what: &str, chosen: &str, evidence: &str, would_change: &str) -> Decision {
    Decision {
        decision: 0,
        what: what.into(),
        chosen: chosen.into(),
        evidence: evidence.into(),
        runner_up: None,
        log_likelihood_ratio: None,
        would_change: would_change.into(),
    }
}

#[cfg(test)]
mod tests;
