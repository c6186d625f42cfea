//! `embed`: coordinates from distances (paper section 4.2), as a start for `refine`.
//!
//! | method | |
//! |---|---|
//! | `incremental` | path lengths by maximum likelihood from many starts, grown patch by patch; for any pattern of missing pairs ([`placement`]) |
//! | `classical` | double-centred classical scaling, p0 included |
//! | `iso-embed` | the paper's Algorithm 1, to compare with: centred on the one noisy point p0, singular values in place of eigenvalues |
//! | `reestimate` | the paper's iterative re-estimation of distances, to compare with |
//!
//! All but `incremental` need every distance: those not measured are filled with the shortest paths over those that
//! were. How exact each is, and how slow, stands in docs/geometry.md, next to methods that are not in the program. The
//! frame: p0 at its station; with three or more anchors (patches with `position_m`) turned onto them; else canonical,
//! see [`crate::geometry::frame`].
//!
//! `incremental` names places that the lengths do not tell from the chosen ones (a patch with two neighbours and its
//! mirror image) as alternatives.
//!
//! With `patches`, these are taken as given: their rows are passed on as they are, and no method is used. Other patches
//! are placed by [multilateration] from their distances to these: with `patches`, all that the distances name beyond
//! them; without, the hidden ones, which have no distance to p0. Several places may explain the distances about
//! equally, as both sides of a wall do. The chosen one is on the laser's side of the plane (in flatland the line)
//! through the neighbours, since a wall reflects only to there. The others are alternatives, each with its
//! log-likelihood less that of the chosen one. Patches with too few distances stand in `rejects`.
//!
//! With `scenes` of `label`, patches are passed on as it placed them: alternatives that it took are the best places.
//! A visible patch that `hypotheses` has stands where later light shows it.
//!
//! A patch that only hidden ones show has no distances: it stands where `hypotheses` of `label` has it, as do others
//! that the distances do not place.
//!
//! Takes `distances`; writes `patches`. Positions have no covariance here (null) but those passed on: it is `refine`
//! that knows it. Not modelled: errors of known patches, and covariances of distances.
//!
//! ```toml
//! [start]
//! stage = "embed"
//! from = "distances"
//! params = { method = "incremental" } # without `patches` beside
//! with = { patches = "visible", hypotheses = "labels.hypotheses" }
//! ```
//!
//! [multilateration]: crate::geometry::multilateration

mod hidden;

use std::collections::{BTreeMap, BTreeSet};
use std::iter;

use serde::{Deserialize, Deserializer, Serialize};

use super::method;
use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Stage, StageError};
use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::geometry::maximum_likelihood::{Node, Observation, Problem};
use crate::geometry::placement::{self, Alternative};
use crate::geometry::t2::{self, Length};
use crate::geometry::{Matrix, Point, classical, completion, frame, iso_embed, procrustes, reestimate};
use crate::priors::{covariances, scenes};
use crate::tables::{Distance, Hypothesis, Patch, SceneOdds};
use crate::units::PatchId;

/// Parameters of `embed`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Embed {
    #[serde(deserialize_with = "method_of")]
    method: Method,
}

impl Default for Embed {
    fn default() -> Self {
        Self { method: Method::Classical }
    }
}

/// How coordinates come from distances.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Method {
    Incremental,
    Classical,
    IsoEmbed,
    Reestimate,
}

fn method_of<'de, D: Deserializer<'de>>(name: D) -> Result<Method, D::Error> {
    let former = ["smacof", "landmark", "semidefinite"];
    method::named(name, &former, "use `incremental`; there are also `classical`, `iso-embed` and `reestimate`")
}

/// What a campaign says of the frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Frame {
    dimensions: u8,
    source_m: [f64; 3],
    anchors_m: BTreeMap<PatchId, [f64; 3]>,
}

/// Frame, patches that are known beforehand and places of others, with the campaign to name in `rejects`.
pub struct Context {
    campaign: String,
    frame: Frame,
    patches: Option<Vec<Patch>>,
    hypotheses: Vec<Hypothesis>,
    cancel: Cancel,
}

impl Stage for Embed {
    const KIND: &'static str = "embed";
    const VERSION: u32 = 6;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "patches", table: "patches", required: false },
        Beside { name: "hypotheses", table: "hypotheses", required: false },
        Beside { name: "scenes", table: "scenes", required: false },
    ];
    type Input = Distance;
    type Output = Patch;
    type Fields = Vec<(String, Frame)>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        let frame = |campaign: &Campaign| {
            let frame = Frame {
                dimensions: campaign.dimensions,
                source_m: campaign.source().position_m,
                anchors_m: campaign.patches.iter().filter_map(|(id, patch)| Some((*id, patch.position_m?))).collect(),
            };
            (campaign.name.clone(), frame)
        };
        campaigns.iter().map(frame).collect()
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        let mut frames = fields.into_iter();
        let (campaign, frame) = frames.next().ok_or_else(|| StageError::Refused("no campaign is given".to_owned()))?;
        if frames.any(|(_, other)| other != frame) {
            let text = "the campaigns differ in dimensions, in the laser's station or in anchors: campaigns of one scene must share them";
            return Err(StageError::Refused(text.to_owned()));
        }
        let scenes = beside.rows::<SceneOdds>("scenes")?.unwrap_or_default();
        let patches = beside.rows::<Patch>("patches")?.map(|rows| scenes::taken(rows, &scenes));
        let hypotheses = beside.rows::<Hypothesis>("hypotheses")?.unwrap_or_default();
        if patches.is_none() && !hypotheses.is_empty() {
            let text = "with hypotheses, but without patches: the places of hypotheses are in the frame of the patches given to `label`; give these here too";
            return Err(StageError::Refused(text.to_owned()));
        }
        Ok(Context { campaign, frame, patches, hypotheses, cancel: beside.cancel.clone() })
    }
}

impl Apply for Embed {
    fn apply(&self, context: &Context, group: Vec<Distance>) -> Result<Outcome<Patch>, StageError> {
        let mut rows = match &context.patches {
            // Where later light shows a visible patch, first light left its place open or took another.
            Some(patches) => {
                let is_found = |row: &Patch| context.hypotheses.iter().any(|one| one.patch == Some(row.patch));
                patches.iter().filter(|row| &*row.kind == "hidden" || !is_found(row)).cloned().collect()
            }
            None => self.visible(context, &group)?,
        };
        let (hidden, rejections) = hidden::place(context, &rows, &group);
        rows.extend(hidden);
        Ok(Outcome { rows, sides: Vec::new(), rejections })
    }
}

/// A position to start from.
fn start(patch: PatchId, kind: &str, point: Point, onsets: i32) -> Patch {
    Patch { onsets, ..covariances::patch_row(patch, kind, point, None) }
}

/// Distances as measured, patch 0 being p0.
struct Measured<'a> {
    ids: &'a [PatchId],
    distances: &'a BTreeMap<(PatchId, PatchId), &'a Distance>,
    dimensions: usize,
    cancel: &'a Cancel,
}

impl Measured<'_> {
    fn count(&self) -> usize {
        self.ids.len() + 1
    }

    fn distance(&self, i: usize, j: usize) -> Option<&Distance> {
        let id = |i: usize| if i == 0 { 0 } else { self.ids[i - 1] };
        self.distances.get(&(id(i).min(id(j)), id(i).max(id(j)))).copied()
    }

    /// All distances, those not measured by shortest paths. Noise may push a short distance below zero.
    fn complete(&self) -> Matrix {
        let length = |i: usize, j: usize| self.distance(i, j).map(|distance| distance.distance_m.max(0.0));
        completion::complete(self.count(), length, self.cancel).expect("every patch here has a distance to patch 0")
    }

    /// The path lengths whose T2 the distances are, p0 at the origin.
    fn problem(&self) -> Problem {
        let plain = |distance: &&Distance| t2::Distance {
            a: distance.a,
            b: distance.b,
            distance_m: distance.distance_m,
            variance_m2: distance.sd_m * distance.sd_m,
            bounces: distance.bounces,
            onsets: distance.onsets,
        };
        let distances: Vec<t2::Distance> = self.distances.values().map(plain).collect();
        let (first, second) = t2::lengths(&distances);
        let place = |patch: PatchId| {
            first.iter().position(|(of, _)| *of == patch).expect("lengths are between patches with a first bounce")
        };
        let p0 = Node::Station(0);
        let observation = |patches: &[PatchId], length: &Length| {
            Observation::new(
                iter::once(p0).chain(patches.iter().map(|&patch| Node::Patch(place(patch)))).chain([p0]).collect(),
                length.length_m,
                length.variance_m2.sqrt(),
            )
        };
        let first_bounces = first.iter().map(|(patch, length)| observation(&[*patch], length));
        let second_bounces = second.iter().map(|((a, b), length)| observation(&[*a, *b], length));
        let observations = first_bounces.chain(second_bounces).collect();
        let problem =
            Problem::new(vec![Point::origin(); first.len()], self.dimensions, &[Point::origin()], observations);
        Problem { cancel: self.cancel.clone(), ..problem }
    }
}

impl Embed {
    /// Patches with a distance to p0, by the method.
    fn visible(&self, context: &Context, group: &[Distance]) -> Result<Vec<Patch>, StageError> {
        let frame = &context.frame;
        let ids: BTreeSet<PatchId> =
            group.iter().filter(|distance| distance.a == 0).map(|distance| distance.b).collect();
        let ids: Vec<PatchId> = ids.into_iter().collect();
        let is_visible = |patch: PatchId| patch == 0 || ids.binary_search(&patch).is_ok();
        let among = group.iter().filter(|distance| is_visible(distance.a) && is_visible(distance.b));
        let distances: BTreeMap<(PatchId, PatchId), &Distance> =
            among.map(|distance| ((distance.a, distance.b), distance)).collect();
        let dimensions = usize::from(frame.dimensions);
        if ids.len() < dimensions {
            return Err(StageError::Refused(format!(
                "{} patches have a first bounce, too few for coordinates in {dimensions} dimensions; see the table `rejects`",
                ids.len()
            )));
        }
        let (points, alternatives) =
            self.points(&Measured { ids: &ids, distances: &distances, dimensions, cancel: &context.cancel });
        let row = |place: usize, point: Point| {
            let of_patch = distances.values().filter(|distance| distance.a == ids[place] || distance.b == ids[place]);
            start(ids[place], "visible", point, of_patch.map(|distance| distance.onsets).sum())
        };
        let turn = frame.turn(&ids, &points);
        let mut rows: Vec<Patch> = points.iter().enumerate().map(|(place, point)| row(place, turn(*point))).collect();
        for (n, Alternative { patches, points, more, .. }) in alternatives.into_iter().enumerate() {
            let (alternative, log_likelihood) = (n as i32 + 1, Some(-0.5 * more));
            let elsewhere = patches.into_iter().map(|place| row(place, turn(points[place])));
            rows.extend(elsewhere.map(|row| Patch { alternative, log_likelihood, ..row }));
        }
        Ok(rows)
    }

    /// Points about the origin, and others that the lengths do not distinguish from them.
    fn points(&self, measured: &Measured) -> (Vec<Point>, Vec<Alternative>) {
        let dimensions = measured.dimensions;
        let points = match self.method {
            Method::Incremental => {
                let problem = measured.problem();
                let points = placement::place(&problem).points;
                let alternatives = placement::alternatives(&problem, &points, &[]);
                return (points, alternatives);
            }
            Method::Classical => classical::embed(&measured.complete(), dimensions),
            Method::IsoEmbed => iso_embed::embed(&measured.complete(), dimensions),
            Method::Reestimate => reestimate::embed(&measured.complete(), dimensions).0,
        };
        (points, Vec::new())
    }
}

impl Frame {
    /// What brings points about the origin to p0's station, and onto the anchors or into the canonical frame.
    fn turn(&self, ids: &[PatchId], points: &[Point]) -> impl Fn(Point) -> Point {
        let centre = Point::from(self.source_m);
        let there: Vec<Point> = points.iter().map(|point| centre + point.coords).collect();
        let anchored =
            there.iter().zip(ids).filter_map(|(point, id)| Some((*point, Point::from(*self.anchors_m.get(id)?))));
        let (from, onto): (Vec<Point>, Vec<Point>) = anchored.unzip();
        let matrix = if from.len() >= usize::from(self.dimensions) {
            procrustes::rotation(&from, &onto, centre, true).matrix
        } else {
            frame::canonical(&there, centre)
        };
        move |point| procrustes::turn(&matrix, centre, centre + point.coords)
    }
}

#[cfg(test)]
mod tests;
