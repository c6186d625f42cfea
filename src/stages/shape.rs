//! `shape`: planes, spheres and cylinders that points of hidden surfaces lie on.
//!
//! Fitted are the lengths of first light ([`crate::geometry::shapes`]), with the errors that neighbours have in common.
//! A shape is told only where it is sure: its kind is likelier than any other by a factor of 20, chi-square is one that
//! errors allow, the surface does not go on smoothly beyond it, and no smooth departure is much likelier. Slightly bent
//! surfaces have no shape.
//!
//! Takes `surface_points` (of `first_returns`) and, beside them, `patches`: the points of the wall. Writes `shapes`,
//! and `points`: all points again, with the shape that they lie on. Captures whose lit and seen points differ have
//! none.
//!
//! Later returns lie on no shape: their law is less well known, and they would blur shapes that first light shows.
//!
//! Not modelled: edges and corners, concave spheres and cylinders, where planes end, errors of the wall's places.
//!
//! ```toml
//! [shapes]
//! stage = "shape"
//! from = "surface"
//! with = { patches = "anchors" }
//! ```

#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::geometry::shapes::{self, Kind, Sighting};
use crate::priors::covariances::upper;
use crate::priors::sightings::Walls;
use crate::tables::{Patch, Row, Shape, SurfacePoint};

/// `shape` has no parameters: what is not sure is not reported.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitShapes {}

/// Points of the wall.
pub struct Context {
    walls: Walls,
    cancel: Cancel,
}

impl Stage for FitShapes {
    const KIND: &'static str = "shape";
    const VERSION: u32 = 4;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[Beside { name: "patches", table: "patches", required: true }];
    const SIDES: &'static [Side] = &[Side { name: "points", schema: SurfacePoint::schema }];
    type Input = SurfacePoint;
    type Output = Shape;
    type Fields = ();
    type Context = Context;

    fn fields(&self, _: &[Campaign]) {}

    fn context(&self, (): (), beside: &BesideTables) -> Result<Context, StageError> {
        let patches: Vec<Patch> = beside.rows("patches")?.unwrap_or_default();
        Ok(Context { walls: Walls::new(&patches), cancel: beside.cancel.clone() })
    }
}

impl Apply for FitShapes {
    fn apply(&self, context: &Context, mut group: Vec<SurfacePoint>) -> Result<Outcome<Shape>, StageError> {
        let sighted = context.walls.sightings(&group);
        let sightings: Vec<Sighting> = sighted.iter().map(|(_, sighting)| *sighting).collect();
        let shapes = shapes::shapes(&sightings, &context.cancel);
        for (number, shape) in shapes.iter().enumerate() {
            shape.members.iter().for_each(|member| group[sighted[*member].0].shape = Some(number as i32 + 1));
        }
        let rows = shapes.iter().enumerate().map(|(number, shape)| row(number as i32 + 1, shape)).collect();
        Ok(Outcome { rows, sides: vec![SurfacePoint::to_batch(&group)], rejections: Vec::new() })
    }
}

fn row(number: i32, shape: &shapes::Shape) -> Shape {
    let [at_m2, axis] = shape.covariances();
    let [cov_xx_m2, cov_xy_m2, cov_xz_m2, cov_yy_m2, cov_yz_m2, cov_zz_m2] = upper(&at_m2);
    let kind = match shape.kind() {
        Kind::Plane => "plane",
        Kind::Sphere => "sphere",
        Kind::Cylinder => "cylinder",
    };
    let [x, y, z] = [0, 1, 2].map(|k| shape.axis().map(|axis| axis[k]));
    Shape {
        shape: number,
        kind: kind.into(),
        x_m: shape.at().x,
        y_m: shape.at().y,
        z_m: shape.at().z,
        cov_xx_m2,
        cov_xy_m2,
        cov_xz_m2,
        cov_yy_m2,
        cov_yz_m2,
        cov_zz_m2,
        sd_m: at_m2.trace().sqrt(),
        axis_x: x,
        axis_y: y,
        axis_z: z,
        axis_sd_rad: shape.axis().map(|_| axis.symmetric_eigenvalues().max().max(0.0).sqrt()),
        radius_m: shape.radius_m().map(|[radius_m, _]| radius_m),
        radius_sd_m: shape.radius_m().map(|[_, sd_m]| sd_m),
        wall_points: shape.members.len() as i32,
        evidence: shape.evidence,
        misfit: shape.misfit,
        rms_m: shape.rms_m,
    }
}
