//! `conclude`: what a solution rests on: each choice that was made on the way, its evidence and its runner-up.
//!
//! No number is computed anew. The stage collects what the other stages measured, and says it in one place:
//!
//! | what | from |
//! |---|---|
//! | fit | chi-square of `fits`: whether the model explains the onsets |
//! | drift of the delays | `fits`: how far delays drift between captures, where onsets show it without fiducials |
//! | labels | onsets with a path, and without one |
//! | later bounces | onsets whose paths have four bounces or five, which only a bright room shows |
//! | hidden patches | `hypotheses`: those accepted, and the likeliest one that was not |
//! | weak patches | `weak`: the same of `search`, in all profiles together |
//! | walls | `hypotheses` that are planes |
//! | places | `scenes`: which of the places that first light left open all onsets support, and by how much |
//! | other solutions | `ambiguities`: mirror images, flips, loose parts, with their likelihoods |
//! | frame | `fits.frame`: what fixes it |
//! | walls of the patches | `planes`: which patches lie on one |
//! | sizes of patches | `footprints`: which patches are no points, and how that is known |
//! | pulse shapes | onsets that are wider than the response, and how many blend |
//! | waveforms | onsets: in how many profiles pulses, noise and baseline explain the samples |
//! | response of a sensor | onsets: the width that its pulses have, against the calibration's |
//! | echoes of a sensor | `calibration` of `recalibrate`: light behind the response that the response captures lack |
//! | vertical ranges | onsets by range |
//! | hidden things, response, gate | `searches`: the verdict of `locate` |
//! | image | `images`: how far the brightest voxel exceeds noise |
//! | surface | `surface`: the points of `first_returns`, where light is that of an extended object |
//! | shapes, meshes | `shapes`, `meshes`: what these points lie on, and the surface between them |
//!
//! A fit whose residuals are larger than chance makes them is `not explained`: `refine` has then made all standard
//! deviations larger (`fits.misfit`), and the first row says by how much.
//!
//! Takes `patches`; writes `decisions`. Beside it, of a solution from onsets: `fits`, `ambiguities` and `footprints`
//! (of the same `refine`), `labels` and `onsets`, `hypotheses` and `scenes` (of the same `label`), `weak` (of `search`)
//! and `planes`. Of a relay wall: `searches` (of `locate`), `images` (of `image`), `surface` (of
//! `first_returns`), `shapes` and `meshes`. One of `fits`, `searches` and `surface` is needed.
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
//! with.calibration = "scene_calibration"
//! ```

mod relay_wall;
mod runners_up;
mod waveforms;

pub use runners_up::are_alike;
pub use waveforms::is_by_chance;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use self::runners_up::{other_solution, place, places};
use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Stage, StageError};
use crate::campaign::{Campaign, count};
use crate::geometry::maximum_likelihood;
use crate::tables::{
    Ambiguity, Calibration, Decision, Fit, Hypothesis, Image, JointSearch, Label, Mesh, Name, ONSET_KINDS, Omission,
    Onset, Patch, PatchFootprint, Plane, SceneOdds, Shape, SurfacePoint,
};

/// Bounces of the last light that all rooms show.
const THIRD: i32 = 3;

/// Parameters of `conclude`: none.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Conclude {}

/// The tables that the choices stand in.
#[derive(Default)]
pub struct Context {
    /// Whether onsets were solved for positions.
    is_from_onsets: bool,
    fits: Vec<Fit>,
    ambiguities: Vec<Ambiguity>,
    labels: Vec<Label>,
    hypotheses: Vec<Hypothesis>,
    onsets: Vec<Onset>,
    planes: Vec<Plane>,
    footprints: Vec<PatchFootprint>,
    scenes: Vec<SceneOdds>,
    calibration: Vec<Calibration>,
    /// Of `search`; `None` where it did not run.
    weak: Option<Vec<Hypothesis>>,
    searches: Vec<JointSearch>,
    images: Vec<Image>,
    /// Of `first_returns`; `None` where it did not run.
    surface: Option<Vec<SurfacePoint>>,
    omissions: Vec<Omission>,
    /// Of `shape`; `None` where it did not run.
    shapes: Option<Vec<Shape>>,
    /// Of `mesh`; `None` where it did not run.
    meshes: Option<Vec<Mesh>>,
}

impl Stage for Conclude {
    const KIND: &'static str = "conclude";
    const VERSION: u32 = 15;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "fits", table: "fits", required: false },
        Beside { name: "ambiguities", table: "ambiguities", required: false },
        Beside { name: "labels", table: "labels", required: false },
        Beside { name: "onsets", table: "onsets", required: false },
        Beside { name: "hypotheses", table: "hypotheses", required: false },
        Beside { name: "planes", table: "planes", required: false },
        Beside { name: "footprints", table: "footprints", required: false },
        Beside { name: "scenes", table: "scenes", required: false },
        Beside { name: "calibration", table: "calibration", required: false },
        Beside { name: "weak", table: "hypotheses", required: false },
        Beside { name: "searches", table: "searches", required: false },
        Beside { name: "images", table: "images", required: false },
        Beside { name: "surface", table: "surface_points", required: false },
        Beside { name: "omissions", table: "omissions", required: false },
        Beside { name: "shapes", table: "shapes", required: false },
        Beside { name: "meshes", table: "meshes", required: false },
    ];
    type Input = Patch;
    type Output = Decision;
    type Fields = ();
    type Context = Context;

    fn fields(&self, _: &[Campaign]) {}

    fn context(&self, (): (), beside: &BesideTables) -> Result<Context, StageError> {
        let fits = beside.rows("fits")?;
        let searches = beside.rows("searches")?;
        let surface = beside.rows("surface")?;
        if fits.is_none() && searches.is_none() && surface.is_none() {
            let text =
                "needs `fits` of `refine`, `searches` of `locate` or `surface` of `first_returns`: give one in `with`";
            return Err(StageError::Refused(text.to_owned()));
        }
        Ok(Context {
            is_from_onsets: fits.is_some(),
            fits: fits.unwrap_or_default(),
            ambiguities: beside.rows("ambiguities")?.unwrap_or_default(),
            labels: beside.rows("labels")?.unwrap_or_default(),
            hypotheses: beside.rows("hypotheses")?.unwrap_or_default(),
            onsets: beside.rows("onsets")?.unwrap_or_default(),
            planes: beside.rows("planes")?.unwrap_or_default(),
            footprints: beside.rows("footprints")?.unwrap_or_default(),
            scenes: beside.rows("scenes")?.unwrap_or_default(),
            calibration: beside.rows("calibration")?.unwrap_or_default(),
            weak: beside.rows("weak")?,
            searches: searches.unwrap_or_default(),
            images: beside.rows("images")?.unwrap_or_default(),
            surface,
            omissions: beside.rows("omissions")?.unwrap_or_default(),
            shapes: beside.rows("shapes")?,
            meshes: beside.rows("meshes")?,
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
        let surface = context.surface.as_deref().map(|points| {
            let (shapes, meshes) = (context.shapes.as_deref(), context.meshes.as_deref());
            relay_wall::Surface { points, omissions: &context.omissions, shapes, meshes }
        });
        let mut decisions = relay_wall::decisions(&context.searches, &context.images, surface);
        if context.is_from_onsets {
            decisions.extend(context.onset_decisions(&best));
        }
        for (number, decision) in (1..).zip(&mut decisions) {
            decision.decision = number;
        }
        Ok(Outcome::rows(decisions))
    }
}

impl Context {
    /// What a solution from onsets rests on.
    fn onset_decisions(&self, best: &[&Patch]) -> Vec<Decision> {
        let mut decisions = vec![self.fit()];
        decisions.extend(self.drift());
        decisions.extend([self.labelled(), self.later_bounces(), self.hidden(best)]);
        decisions.extend(self.weak());
        decisions.extend(self.walls());
        decisions.extend(self.scenes.iter().map(place));
        // The row of the frame says what a free rotation means.
        decisions.extend(self.ambiguities.iter().filter(|one| &*one.kind != "rotation").map(other_solution));
        decisions.extend([self.frame(), self.coplanar(best), self.sizes(), self.pulse_shapes()]);
        decisions.extend(waveforms::decisions(&self.onsets));
        decisions.extend(self.calibration.iter().filter_map(waveforms::tail));
        decisions.extend(self.ranges());
        decisions
    }

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
            let chosen = format!("not explained: the program widened standard deviations, {}", wider.join(", "));
            let text =
                "right labels or a better instrument response; `suspects` lists the onsets that contradict the fit";
            return decision("fit", &chosen, &evidence, text);
        }
        let is_whole = fit.chi2 <= maximum_likelihood::by_chance(fit.degrees_of_freedom.into());
        let chosen = if is_whole { "explained" } else { "explained but for the onsets that `suspects` lists" };
        decision("fit", chosen, &evidence, "residuals larger than chance makes them in one campaign of 1,000")
    }

    /// Whether delays drift while the captures are taken.
    fn drift(&self) -> Option<Decision> {
        let fit = self.best_fit()?;
        let (drift_ps, hours) = (fit.drift_ps?, fit.drift_span_s? / 3600.0);
        let evidence = fit.drift_log_likelihood?;
        Some(Decision {
            log_likelihood_ratio: Some(evidence),
            runner_up: Some("larger errors of all onsets".into()),
            ..decision(
                "drift of the delays",
                &format!("times drift by {drift_ps:.1} ps within {hours:.1} h"),
                &format!("onsets check one another: log-likelihood ratio {evidence:.1} against larger errors of all"),
                "fiducial captures through the session, which measure the drift",
            )
        })
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

    /// Whether bounces after the third make onsets.
    fn later_bounces(&self) -> Decision {
        let is_later = |label: &&Label| label.alternative == 0 && label.bounces > THIRD;
        let later = self.labels.iter().filter(is_later).count();
        let (chosen, evidence) = if later > 0 {
            let pulses = count(later, "pulse has a path", "pulses have paths");
            ("taken: a bright room", format!("{pulses} of four or five bounces"))
        } else {
            ("left out", "no pulse has a path of four or five bounces".to_owned())
        };
        let would_change = "more onsets at the times of fourth bounces than at other times";
        decision("later bounces", chosen, &evidence, would_change)
    }

    /// Which patches lie hidden and show onsets, and which place was not accepted as one.
    fn hidden(&self, patches: &[&Patch]) -> Decision {
        let is_weak = |patch: &Patch| self.weak.iter().flatten().any(|place| place.patch == Some(patch.patch));
        let count = patches.iter().filter(|patch| &*patch.kind == "hidden" && !is_weak(patch)).count();
        let none = "no onset is left that a hidden patch would explain";
        places("hidden patches", count, &self.hypotheses, [none, "onsets that no path explains"])
    }

    /// Which hidden patches are too weak for an onset in any single profile.
    fn weak(&self) -> Option<Decision> {
        let weak = self.weak.as_ref()?;
        let count = weak.iter().filter(|place| place.patch.is_some()).count();
        let none = "no place in the profiles that are searched has more light than noise makes";
        let would_change = "more shots; photon counts, wrapped records, patches in one line and more than 2,500 profiles are not searched";
        Some(places("weak patches", count, weak, [none, would_change]))
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
        let on_plane = patches.iter().filter(on_planes).count();
        if on_plane == 0 {
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
            &format!(
                "{on_plane} of {} on {}",
                count(patches.len(), "patch", "patches"),
                count(self.planes.len(), "plane", "planes")
            ),
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
            &format!(
                "{} of {:.1} to {:.1} cm",
                count(self.footprints.len(), "disk", "disks"),
                1e2 * least_m,
                1e2 * most_m
            ),
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
            &format!("{} from points of light, {wide} spread in time", count(all - wide, "onset", "onsets")),
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
            let list: Vec<String> = ranges
                .iter()
                .map(|(range, onsets)| format!("{range}: {}", count(*onsets, "onset", "onsets")))
                .collect();
            let text = "a range that does not clip";
            decision("vertical ranges", &format!("{} ranges", ranges.len()), &list.join(", "), text)
        })
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
