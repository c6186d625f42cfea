//! `embed`: coordinates from distances (paper section 4.2), as a start for `refine`.
//!
//! | method | |
//! |---|---|
//! | `incremental` | path lengths by maximum likelihood from many starts, grown patch by patch; for any pattern of missing pairs ([`few_pairs`]) |
//! | `classical` | double-centred classical scaling, p0 included |
//! | `smacof` | least weighted stress from there; a distance that was not measured weighs nothing |
//! | `landmark` | classical scaling of `landmarks` patches, the others by their distances to these; for thousands |
//! | `iso-embed` | the paper's Algorithm 1, to compare with: centred on the one noisy point p0, singular values in place of eigenvalues |
//! | `reestimate` | the paper's iterative re-estimation of distances, to compare with |
//! | `semidefinite` | convex, to compare with; up to 60 patches |
//!
//! All but `incremental`, `smacof` and `semidefinite` need every distance: those not measured are filled with the shortest paths over those that were. How
//! exact each is, and how slow, stands in docs/geometry.md. The frame: p0 at its station; with three or more anchors
//! (patches with `position_m`) turned onto them; else canonical, see [`crate::geometry::frame`].
//!
//! `incremental` names places that the lengths do not tell from the chosen ones (a patch with two neighbours and its mirror image) as alternatives.
//!
//! Takes `distances`; writes `patches`. Positions have no covariance here (null): it is `refine` that knows it. Not yet: patches known beforehand and
//! multilateration of hidden ones.
//!
//! ```toml
//! [start]
//! stage = "embed"
//! from = "distances"
//! params = { method = "incremental" }
//! ```

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::stage::{Apply, BesideTables, Grain, Outcome, Stage, StageError};
use crate::campaign::Campaign;
use crate::geometry::few_pairs::{self, Lengths};
use crate::geometry::t2::{self, Length};
use crate::geometry::{
    Matrix, Point, classical, completion, frame, iso_embed, landmark, procrustes, reestimate, semidefinite, smacof,
};
use crate::tables::{Distance, Patch};
use crate::units::PatchId;

/// Most patches of `semidefinite`.
const SEMIDEFINITE_MAX: usize = 60;

/// Parameters of `embed`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Embed {
    method: Method,
    /// Patches that the others are placed by, for `landmark`.
    landmarks: usize,
}

impl Default for Embed {
    fn default() -> Self {
        Self { method: Method::Classical, landmarks: 100 }
    }
}

/// How coordinates come from distances.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Method {
    Incremental,
    Classical,
    Smacof,
    Landmark,
    IsoEmbed,
    Reestimate,
    Semidefinite,
}

/// What a campaign says of the frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Frame {
    dimensions: u8,
    source_m: [f64; 3],
    anchors_m: BTreeMap<PatchId, [f64; 3]>,
}

impl Stage for Embed {
    const KIND: &'static str = "embed";
    const VERSION: u32 = 2;
    const GRAIN: Grain = Grain::All;
    type Input = Distance;
    type Output = Patch;
    type Fields = Vec<Frame>;
    type Context = Frame;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        let frame = |campaign: &Campaign| Frame {
            dimensions: campaign.dimensions,
            source_m: campaign.source().position_m,
            anchors_m: campaign.patches.iter().filter_map(|(id, patch)| Some((*id, patch.position_m?))).collect(),
        };
        campaigns.iter().map(frame).collect()
    }

    fn context(&self, fields: Self::Fields, _: &BesideTables) -> Result<Frame, StageError> {
        let mut frames = fields.into_iter();
        let first = frames.next().ok_or_else(|| StageError::Refused("no campaign is given".to_owned()))?;
        if frames.any(|frame| frame != first) {
            let text = "the campaigns differ in dimensions, in the laser's station or in anchors: campaigns of one scene must share them";
            return Err(StageError::Refused(text.to_owned()));
        }
        Ok(first)
    }
}

impl Apply for Embed {
    fn apply(&self, frame: &Frame, group: Vec<Distance>) -> Result<Outcome<Patch>, StageError> {
        let ids: BTreeSet<PatchId> =
            group.iter().filter(|distance| distance.a == 0).map(|distance| distance.b).collect();
        let ids: Vec<PatchId> = ids.into_iter().collect();
        let known: BTreeMap<(PatchId, PatchId), &Distance> =
            group.iter().map(|distance| ((distance.a, distance.b), distance)).collect();
        let dimensions = usize::from(frame.dimensions);
        if ids.len() < dimensions {
            return Err(StageError::Refused(format!(
                "{} patches have a first bounce, too few for coordinates in {dimensions} dimensions; see the table `rejects`",
                ids.len()
            )));
        }
        let measured = Measured { ids: &ids, known: &known, dimensions };
        let (points, twins) = self.points(&measured)?;
        let onsets = |patch: PatchId| {
            group
                .iter()
                .filter(|distance| distance.a == patch || distance.b == patch)
                .map(|distance| distance.onsets)
                .sum()
        };
        let row = |place: usize, point: Point, alternative: i32, log_likelihood: Option<f64>| Patch {
            patch: ids[place],
            kind: "visible".into(),
            x_m: point.x,
            y_m: point.y,
            z_m: point.z,
            cov_xx_m2: None,
            cov_xy_m2: None,
            cov_xz_m2: None,
            cov_yy_m2: None,
            cov_yz_m2: None,
            cov_zz_m2: None,
            sd_m: None,
            onsets: onsets(ids[place]),
            chi2_dof: None,
            alternative,
            log_likelihood,
        };
        let turn = frame.turn(&ids, &points);
        let mut rows: Vec<Patch> =
            points.iter().enumerate().map(|(place, point)| row(place, turn(*point), 0, None)).collect();
        for (n, (place, point, log_likelihood)) in twins.into_iter().enumerate() {
            rows.push(row(place, turn(point), n as i32 + 1, Some(log_likelihood)));
        }
        Ok(Outcome::rows(rows))
    }
}

/// Place of a patch that the lengths do not tell from the chosen one, and its log-likelihood relative to that.
type Twin = (usize, Point, f64);

/// Distances as measured, patch 0 being p0.
struct Measured<'a> {
    ids: &'a [PatchId],
    known: &'a BTreeMap<(PatchId, PatchId), &'a Distance>,
    dimensions: usize,
}

impl Measured<'_> {
    fn count(&self) -> usize {
        self.ids.len() + 1
    }

    fn distance(&self, i: usize, j: usize) -> Option<&Distance> {
        let id = |i: usize| if i == 0 { 0 } else { self.ids[i - 1] };
        self.known.get(&(id(i).min(id(j)), id(i).max(id(j)))).copied()
    }

    /// All distances, those not measured by shortest paths. Noise may push a short distance below zero.
    fn complete(&self) -> Matrix {
        let length = |i: usize, j: usize| self.distance(i, j).map(|distance| distance.distance_m.max(0.0));
        completion::complete(self.count(), length).expect("every patch here has a distance to patch 0")
    }

    /// One over the variance of each distance; 0 for one that was not measured.
    fn weights(&self) -> Matrix {
        let weight = |i: usize, j: usize| match self.distance(i, j) {
            Some(distance) if i != j => distance.sd_m.powi(-2),
            _ => 0.0,
        };
        Matrix::from_fn(self.count(), self.count(), weight)
    }

    /// Path lengths whose T2 the distances are, by the places of their patches.
    fn lengths(&self) -> (Vec<Length>, Vec<(usize, usize, Length)>) {
        let plain = |distance: &&Distance| t2::Distance {
            a: distance.a,
            b: distance.b,
            distance_m: distance.distance_m,
            variance_m2: distance.sd_m * distance.sd_m,
            bounces: distance.bounces,
            onsets: distance.onsets,
        };
        let distances: Vec<t2::Distance> = self.known.values().map(plain).collect();
        let (first, second) = t2::lengths(&distances);
        let place = |patch: PatchId| {
            first.iter().position(|(of, _)| *of == patch).expect("lengths are between patches with a first bounce")
        };
        let second = second.into_iter().map(|((a, b), length)| (place(a), place(b), length)).collect();
        (first.iter().map(|(_, length)| *length).collect(), second)
    }
}

impl Embed {
    /// Points about the origin, and twins.
    fn points(&self, measured: &Measured) -> Result<(Vec<Point>, Vec<Twin>), StageError> {
        let dimensions = measured.dimensions;
        let points = match self.method {
            Method::Incremental => {
                let (first, second) = measured.lengths();
                let placed = few_pairs::place(&Lengths { first: &first, second: &second, dimensions });
                let twins = placed.twins.iter().map(|twin| (twin.patch, twin.point, -0.5 * twin.more)).collect();
                return Ok((placed.points, twins));
            }
            Method::Classical => classical::embed(&measured.complete(), dimensions),
            Method::Smacof => {
                let distances = measured.complete();
                let start = classical::embed(&distances, dimensions);
                smacof::scale(&start, &distances, &measured.weights()).expect("every patch has a distance to p0").points
            }
            Method::Landmark => {
                let distances = measured.complete();
                let (count, distance) = (measured.count(), |i: usize, j: usize| distances[(i, j)]);
                let landmarks = landmark::spread(count, self.landmarks.clamp(dimensions + 2, count), distance);
                landmark::embed(count, &landmarks, distance, dimensions)
            }
            Method::IsoEmbed => iso_embed::embed(&measured.complete(), dimensions),
            Method::Reestimate => reestimate::embed(&measured.complete(), dimensions).0,
            Method::Semidefinite if measured.ids.len() > SEMIDEFINITE_MAX => {
                let count = measured.ids.len();
                return Err(StageError::Refused(format!(
                    "method `semidefinite` is for {SEMIDEFINITE_MAX} patches at most, not {count}; take `smacof` or `incremental`"
                )));
            }
            Method::Semidefinite => semidefinite::embed(&measured.complete(), &measured.weights(), dimensions),
        };
        Ok((points, Vec::new()))
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
