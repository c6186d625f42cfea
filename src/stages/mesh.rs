//! `mesh`: hidden surfaces between the points that first light shows, with error bars.
//!
//! A height over a grid is fitted to the lengths of first light ([`crate::geometry::height_field`]). It knows what no
//! point knows alone: a surface is smooth but at few edges, and lies behind every length. Where points of a concave
//! surface err by centimetres along it, heights err by a millimetre.
//!
//! A mesh is told only where the lengths are explained, by a surface that is smooth over the part of it that a point of
//! the wall sees first, and where points lie on all sides. Boxes have none: their edges and corners are seen, not their
//! faces.
//!
//! Takes `surface_points` (of `first_returns`) and, beside them, `patches`: the points of the wall. Writes `meshes`,
//! and `vertices`: their nodes. Points whose lit and seen points of the wall differ are left out,
//! and so are those of later returns and those whose light comes from `edges` that lengths do not show.
//!
//! Not modelled: where surfaces end, surfaces that turn by more than a right angle, errors of the wall's places.
//!
//! ```toml
//! [meshes]
//! stage = "mesh"
//! from = "surface"
//! with = { patches = "anchors" }
//! ```

#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::geometry::height_field::{HeightField, Node, height_fields};
use crate::geometry::shapes::Sighting;
use crate::priors::sightings::Walls;
use crate::tables::{Mesh, Patch, Row, SurfacePoint, Vertex};

/// `mesh` has no parameters: what is not sure is not reported.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitMeshes {}

/// Points of the wall.
pub struct Context {
    walls: Walls,
    cancel: Cancel,
}

impl Stage for FitMeshes {
    const KIND: &'static str = "mesh";
    const VERSION: u32 = 6;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[Beside { name: "patches", table: "patches", required: true }];
    const SIDES: &'static [Side] = &[Side { name: "vertices", schema: Vertex::schema }];
    type Input = SurfacePoint;
    type Output = Mesh;
    type Fields = ();
    type Context = Context;

    fn fields(&self, _: &[Campaign]) {}

    fn context(&self, (): (), beside: &BesideTables) -> Result<Context, StageError> {
        let patches: Vec<Patch> = beside.rows("patches")?.unwrap_or_default();
        Ok(Context { walls: Walls::new(&patches), cancel: beside.cancel.clone() })
    }
}

impl Apply for FitMeshes {
    fn apply(&self, context: &Context, group: Vec<SurfacePoint>) -> Result<Outcome<Mesh>, StageError> {
        let sighted = context.walls.sightings(&group);
        let sightings: Vec<Sighting> = sighted.into_iter().map(|(_, sighting)| sighting).collect();
        let fields = height_fields(&sightings, &context.cancel);
        let numbered = || (1..).zip(&fields);
        let vertices: Vec<Vertex> =
            numbered().flat_map(|(mesh, field)| field.nodes.iter().map(move |node| vertex(mesh, node))).collect();
        let rows = numbered().map(|(mesh, field)| row(mesh, field)).collect();
        Ok(Outcome { rows, sides: vec![Vertex::to_batch(&vertices)], rejections: Vec::new() })
    }
}

fn row(mesh: i32, field: &HeightField) -> Mesh {
    let mut sds_m: Vec<f64> = field.nodes.iter().map(|node| node.sd_m).collect();
    sds_m.sort_by(f64::total_cmp);
    Mesh {
        mesh,
        axis_x: field.axis.x,
        axis_y: field.axis.y,
        axis_z: field.axis.z,
        spacing_m: field.spacing_m,
        nodes: field.nodes.len() as i32,
        median_sd_m: sds_m[sds_m.len() / 2],
        bend_per_m: field.bend_per_m,
        wall_points: field.members.len() as i32,
        misfit: field.misfit,
    }
}

fn vertex(mesh: i32, node: &Node) -> Vertex {
    let [grid_column, grid_row] = node.place.map(|place| place as i32);
    Vertex {
        mesh,
        grid_row,
        grid_column,
        x_m: node.point.x,
        y_m: node.point.y,
        z_m: node.point.z,
        sd_m: node.sd_m,
        normal_x: node.normal.x,
        normal_y: node.normal.y,
        normal_z: node.normal.z,
        normal_sd_rad: node.normal_sd_rad,
    }
}
