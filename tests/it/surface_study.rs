//! From files of a scan to points of a hidden surface, and what came of them. `benches/surfaces.rs` runs it over many
//! seeds.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use periscope::store::Shelf;
use periscope::tables::{Patch, Row, Shape, SurfacePoint, Vertex};

use crate::hidden_things::{PITCH_M, Point, Thing};
use crate::relay_scene::{Capture, FWHM_PS, periscope};

/// Chi-square of three coordinates that holds 95 %.
pub const HOLDS: f64 = 7.815;

/// What came of the points of one kind.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    pub points: usize,
    /// Of several things, points of one that is not the nearest.
    pub farther: usize,
    /// Points within their ellipsoid of 95 %.
    pub held: usize,
    /// Distances from the true point, stated standard deviations, and angles between the normal and the true direction.
    pub errors_m: Vec<f64>,
    pub sds_m: Vec<f64>,
    pub angles_rad: Vec<f64>,
}

/// What came of a campaign, by the true kinds of points: smooth, edge, corner.
pub struct Results {
    /// Points of `first_returns` that first light shows.
    pub points: [Tally; 3],
    /// Those that later returns show, of any kind: next to the thing, since their light may come from any part of it.
    pub later: Tally,
    /// Points that lie on a shape.
    pub on_shapes: usize,
    pub shapes: Vec<Shape>,
    /// Nodes of the surfaces between points.
    pub nodes: Nodes,
}

/// What came of the nodes of surfaces.
#[derive(Clone, Debug, Default)]
pub struct Nodes {
    /// Distances from the thing, stated standard deviations, and the least angles between the normal and one of the
    /// thing.
    pub errors_m: Vec<f64>,
    pub sds_m: Vec<f64>,
    pub angles_rad: Vec<f64>,
}

impl Nodes {
    fn new(thing: &Thing, vertices: &[Vertex]) -> Self {
        let mut nodes = Self::default();
        for vertex in vertices {
            let place = Point::new(vertex.x_m, vertex.y_m, vertex.z_m);
            let far_m2 = |facet: &&(Point, Vector3<f64>, f64)| (facet.0 - place).norm_squared();
            let (facet, normal, _) =
                thing.facets.iter().min_by(|a, b| far_m2(a).total_cmp(&far_m2(b))).expect("a thing");
            let angle_rad = normal.angle(&Vector3::new(vertex.normal_x, vertex.normal_y, vertex.normal_z));
            // From the facet's plane, and from its border.
            let (off, above_m) = (place - facet, normal.dot(&(place - facet)));
            let beside_m = (off.norm_squared() - above_m * above_m).max(0.0).sqrt();
            nodes.errors_m.push(above_m.hypot((beside_m - PITCH_M).max(0.0)));
            nodes.sds_m.push(vertex.sd_m);
            nodes.angles_rad.push(angle_rad.min(std::f64::consts::PI - angle_rad));
        }
        nodes
    }

    /// How many lie within 1.96 standard deviations of the thing.
    pub fn held(&self) -> usize {
        self.errors_m.iter().zip(&self.sds_m).filter(|(error_m, sd_m)| **error_m < 1.96 * **sd_m).count()
    }
}

/// A campaign from its files to its points.
pub fn results(thing: &Thing, capture: &Capture, photons: f64) -> Results {
    let folder = tempfile::tempdir().unwrap();
    convert(folder.path(), thing, capture, photons);
    periscope(folder.path(), &["run", "first-returns", "--campaign", "campaign", "--out", "out", "--threads", "2"]);
    let anchors: Vec<Patch> = rows(folder.path(), "out", "anchors");
    let points: Vec<SurfacePoint> = rows(folder.path(), "out", "shapes.points");
    Results {
        points: tallies(thing, &anchors, points.iter().filter(|point| point.rank == 1)),
        later: later(thing, points.iter().filter(|point| point.rank > 1)),
        on_shapes: points.iter().filter(|point| point.shape.is_some()).count(),
        shapes: rows(folder.path(), "out", "shapes"),
        nodes: Nodes::new(thing, &rows::<Vertex>(folder.path(), "out", "meshes.vertices")),
    }
}

pub fn tallies<'a>(thing: &Thing, anchors: &[Patch], points: impl Iterator<Item = &'a SurfacePoint>) -> [Tally; 3] {
    let mut tallies: [Tally; 3] = Default::default();
    for point in points {
        let anchor = anchors.iter().find(|anchor| anchor.patch == point.seen).unwrap();
        let seen = Point::new(anchor.x_m, anchor.y_m, anchor.z_m);
        let place = Point::new(point.x_m, point.y_m, point.z_m);
        // Light of the nearest thing may be too weak to be seen: then the point is that of another.
        let candidates = (thing.nearest)(&seen);
        let nearest = |to: Point| {
            let gap_m = |one: &&(Point, usize)| (one.0 - to).norm();
            candidates.iter().min_by(|a, b| gap_m(a).total_cmp(&gap_m(b))).copied().expect("there is a thing")
        };
        let (truth, kind) = nearest(place);
        let off = place - truth;
        let root = covariance_m2(point).cholesky().expect("a covariance");
        let tally = &mut tallies[kind];
        tally.points += 1;
        tally.farther += usize::from(truth != nearest(seen).0);
        tally.held += usize::from(off.dot(&root.solve(&off)) < HOLDS);
        tally.errors_m.push(off.norm());
        tally.sds_m.push(point.sd_m);
        let normal = Vector3::new(point.normal_x, point.normal_y, point.normal_z);
        tally.angles_rad.push(normal.angle(&(seen - truth)));
    }
    tallies
}

/// A point holds where a facet lies within its ellipsoid; its error is the distance from the nearest one.
fn later<'a>(thing: &Thing, points: impl Iterator<Item = &'a SurfacePoint>) -> Tally {
    let mut tally = Tally::default();
    for point in points {
        let place = Point::new(point.x_m, point.y_m, point.z_m);
        let root = (covariance_m2(point) + Matrix3::identity() * PITCH_M.powi(2)).cholesky().expect("a covariance");
        let mut least = [f64::INFINITY; 2];
        for (facet, ..) in &thing.facets {
            let off = facet - place;
            least = [least[0].min(off.norm()), least[1].min(off.dot(&root.solve(&off)))];
        }
        tally.points += 1;
        tally.held += usize::from(least[1] < HOLDS);
        tally.errors_m.push(least[0]);
        tally.sds_m.push(point.sd_m);
    }
    tally
}

fn covariance_m2(point: &SurfacePoint) -> Matrix3<f64> {
    let [xx, xy, xz, yy, yz, zz] =
        [point.cov_xx_m2, point.cov_xy_m2, point.cov_xz_m2, point.cov_yy_m2, point.cov_yz_m2, point.cov_zz_m2];
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

/// Makes a campaign of a scan.
pub fn convert(folder: &Path, thing: &Thing, capture: &Capture, photons: f64) {
    thing.write(&folder.join("scan.mat"), capture, photons);
    let (fwhm, dt) = (FWHM_PS.to_string(), capture.dt_ps.to_string());
    periscope(folder, &["convert", "scan.mat", "--out", "campaign", "--fwhm-ps", &fwhm, "--dt-ps", &dt]);
}

pub fn rows<R: Row>(folder: &Path, out: &str, table: &str) -> Vec<R> {
    let shelf = Shelf::look(&folder.join(out)).unwrap();
    shelf.batches(table).unwrap().iter().flat_map(|batch| R::rows(batch).unwrap()).collect()
}

/// A scan of a square metre.
pub fn capture(side: usize, seed: u64) -> Capture {
    Capture { side, half_m: 0.5, bins: 1100, seed, ..Capture::default() }
}

/// The middle one.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}
