//! `embed`: coordinates from distances (paper section 4.2), as a start for `refine`.
//!
//! | method | |
//! |---|---|
//! | `classical` | double-centred classical scaling, p0 included |
//! | `iso-embed` | the paper's Algorithm 1, to compare with: centred on the one noisy point p0, singular values in place of eigenvalues |
//!
//! Distances that were not measured are filled with shortest paths over those that were. The frame: p0 at its station; with three or more anchors
//! (patches with `position_m`) turned onto them; else canonical, see [`crate::geometry::frame`].
//!
//! Takes `distances`; writes `patches`. Positions have no covariance here (null): it is `refine` that knows it. Not yet: patches known beforehand and
//! multilateration of hidden ones.
//!
//! ```toml
//! [start]
//! stage = "embed"
//! from = "distances"
//! params = { method = "classical" }
//! ```

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, BesideTables, Grain, Outcome, Stage, StageError};
use crate::campaign::Campaign;
use crate::geometry::{Point, classical, completion, frame, iso_embed, procrustes};
use crate::tables::{Distance, Patch};
use crate::units::PatchId;

/// Parameters of `embed`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Embed {
    method: Method,
}

/// How coordinates come from distances.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Method {
    #[default]
    Classical,
    IsoEmbed,
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
    const VERSION: u32 = 1;
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
        let ids: Vec<PatchId> = group.iter().filter(|distance| distance.a == 0).map(|distance| distance.b).collect();
        let known: BTreeMap<(PatchId, PatchId), &Distance> =
            group.iter().map(|distance| ((distance.a, distance.b), distance)).collect();
        let id = |i: usize| if i == 0 { 0 } else { ids[i - 1] };
        // Noise may push a short distance below zero.
        let length = |i: usize, j: usize| {
            known.get(&(id(i).min(id(j)), id(i).max(id(j)))).map(|distance| distance.distance_m.max(0.0))
        };
        let dimensions = usize::from(frame.dimensions);
        if ids.len() < dimensions {
            return Err(StageError::Refused(format!(
                "{} patches have a first bounce, too few for coordinates in {dimensions} dimensions; see the table `rejects`",
                ids.len()
            )));
        }
        let distances =
            completion::complete(ids.len() + 1, length).expect("every patch here has a distance to patch 0");
        let points = match self.method {
            Method::Classical => classical::embed(&distances, dimensions),
            Method::IsoEmbed => iso_embed::embed(&distances, dimensions),
        };
        let onsets = |patch: PatchId| {
            group
                .iter()
                .filter(|distance| distance.a == patch || distance.b == patch)
                .map(|distance| distance.onsets)
                .sum()
        };
        let rows = frame.turned(&ids, &points).into_iter().zip(&ids).map(|(point, &patch)| Patch {
            patch,
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
            onsets: onsets(patch),
            chi2_dof: None,
            alternative: 0,
            log_likelihood: None,
        });
        Ok(Outcome::rows(rows.collect()))
    }
}

impl Frame {
    /// Points about the origin, brought to p0's station and onto the anchors, or into the canonical frame.
    fn turned(&self, ids: &[PatchId], points: &[Point]) -> Vec<Point> {
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
        there.iter().map(|point| procrustes::turn(&matrix, centre, *point)).collect()
    }
}
