//! The surface between points of a hidden thing: a height over a grid, with its error bars.
//!
//! A point of a wall that is lit and seen itself has its first light from the nearest point of a surface. A surface is
//! fitted to the lengths of first light themselves: where the nearest point lies, the surface says. Points that
//! neighbouring places tell ([`super::first_return`]) err by centimetres along a surface that is concave towards the
//! wall, since the nearest point moves several times as far as the place. Their lengths do not err.
//!
//! | module | does |
//! |---|---|
//! | `grid` | heights over a grid: the point next to a place, curvatures |
//! | `fit` | the likeliest heights, and how likely the size of curvatures is |
//! | `spread` | errors of heights and normals |
//! | `shown` | which nodes first light shows |
//!
//! Curvatures have a prior of Student's: small ones, and few that are large, where the surface ends or has a ridge. It
//! bends away behind an edge, as the surface that reaches furthest and lies behind no length. Their size is set by
//! the one that the lengths make likeliest.
//!
//! Lengths are fitted as if errors of their law were independent, and error bars count them as the smooth function over
//! the wall that they are: were they fitted as one, they would take up what the surface is bent by. A node counts only
//! among points that the wall sees on all sides of it: beyond an edge, and on faces of which it sees but the edges,
//! nothing is reported.
//!
//! Source: thin plates as priors, Terzopoulos, IEEE T. Pattern Anal. 8:413, 1986; weights of Student's, Lange et al.,
//! J. Am. Stat. Assoc. 84:881, 1989; the size of curvatures by evidence, MacKay, Neural Comput. 4:415, 1992.
//!
//! Not modelled: lit points apart from the seen ones, surfaces that turn by more than a right angle.

mod fit;
mod grid;
mod shown;
mod spread;

#[cfg(test)]
mod tests;

use nalgebra::{Matrix3, Vector2, Vector3};
use periscope_cancel::Cancel;

use super::Point;
use super::axes::across;
use super::first_return::EDGES;
use super::median::median;
use super::shapes::Sighting;
use fit::{Fit, Problem};
use grid::Grid;
use spread::Spread;

/// Fewest places of a surface.
const LEAST: usize = 64;
/// Points that are nearer than this, in zones, count as one, and hang together up to that distance.
const NEAR: f64 = 0.5;
const LINK: f64 = 2.0;
/// Distance of nodes in zones, and the most of them.
const SPACING: f64 = 0.2;
const MOST_NODES: f64 = 2500.0;
/// How far the grid reaches beyond the points, in zones; of these all but a fiftieth at each end.
const MARGIN: f64 = 0.6;
const ENDS: usize = 50;
/// By how much a surface may turn over a zone, as the likeliest size of curvatures says: more is no smooth surface.
const SMOOTH_RAD: f64 = 0.25;
/// Chi-square over its number, beyond which lengths are not explained, in standard deviations.
const EXPLAINED: f64 = 3.1;

/// A surface that first light shows.
#[derive(Clone, Debug)]
pub struct HeightField {
    /// Unit vector along which heights are measured, towards the wall.
    pub axis: Vector3<f64>,
    /// Distance of nodes across it.
    pub spacing_m: f64,
    /// Nodes that first light shows, row by row.
    pub nodes: Vec<Node>,
    /// Size of curvatures that the lengths make likeliest.
    pub bend_per_m: f64,
    /// Sightings that it was fitted to, ascending.
    pub members: Vec<usize>,
    /// Chi-square of their lengths over their number.
    pub misfit: f64,
}

/// A node of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    /// Its column and its row in the grid.
    pub place: [u32; 2],
    /// Position.
    pub point: Point,
    /// Standard deviation along the normal.
    pub sd_m: f64,
    /// Unit normal, towards the wall.
    pub normal: Vector3<f64>,
    /// Root of the sum of the variances of its two angles.
    pub normal_sd_rad: f64,
}

/// Surfaces that sightings of a wall show, the one with most of them first. None where neither a smooth surface nor one
/// with few edges explains first light.
///
/// # Panics
/// If a standard deviation is not positive.
#[must_use]
pub fn height_fields(sightings: &[Sighting], cancel: &Cancel) -> Vec<HeightField> {
    assert!(sightings.iter().all(|one| one.light.sd_m > 0.0), "lengths have standard deviations");
    let mut fields: Vec<HeightField> =
        groups(sightings).into_iter().filter_map(|members| height_field(sightings, members, cancel)).collect();
    fields.sort_by_key(|field| std::cmp::Reverse(field.members.len()));
    fields
}

/// Sightings whose points hang together.
fn groups(sightings: &[Sighting]) -> Vec<Vec<usize>> {
    let is_sure = |one: &Sighting| one.edges <= EDGES && one.covariance_m2.trace().sqrt() < one.light.zone_m;
    // One of the points that are well known stands for those next to it.
    let mut centres: Vec<&Sighting> = Vec::new();
    for one in sightings.iter().filter(|one| is_sure(one)) {
        let is_near = |centre: &&Sighting| (centre.point - one.point).norm() < NEAR * one.light.zone_m;
        if !centres.iter().any(is_near) {
            centres.push(one);
        }
    }
    let mut group: Vec<usize> = (0..centres.len()).collect();
    for (n, one) in centres.iter().enumerate() {
        for other in (0..n).filter(|other| (centres[*other].point - one.point).norm() < LINK * one.light.zone_m) {
            let [a, b] = [root(&group, n), root(&group, other)];
            group[a.max(b)] = a.min(b);
        }
    }
    let mut members = vec![Vec::new(); centres.len()];
    // Between edges that lengths do not show there is no surface.
    for (n, one) in sightings.iter().enumerate().filter(|(_, one)| one.edges <= EDGES) {
        let far_m2 = |centre: usize| (centres[centre].point - one.point).norm_squared();
        let nearest = (0..centres.len()).min_by(|a, b| far_m2(*a).total_cmp(&far_m2(*b)));
        nearest.into_iter().for_each(|centre| members[root(&group, centre)].push(n));
    }
    members.retain(|group| group.len() >= LEAST);
    members
}

fn root(group: &[usize], mut n: usize) -> usize {
    while group[n] != n {
        n = group[n];
    }
    n
}

fn height_field(sightings: &[Sighting], members: Vec<usize>, cancel: &Cancel) -> Option<HeightField> {
    let all: Vec<&Sighting> = members.iter().map(|n| &sightings[*n]).collect();
    let frame = Frame::of(&all)?;
    let zone_m = median(all.iter().map(|one| one.light.zone_m).collect());
    let grid = frame.grid(&all, zone_m);
    let places: Vec<Point> = all.iter().map(|one| frame.local(&one.seen)).collect();
    let problem = Problem::new(&grid, &places, &all);
    let (bend_per_m, fit) = Fit::loose(&problem, cancel)?;
    if bend_per_m * zone_m > SMOOTH_RAD {
        return None;
    }
    let misfit = fit.square / members.len() as f64;
    if misfit > 1.0 + EXPLAINED * (2.0 / members.len() as f64).sqrt() {
        return None;
    }
    let is_shown = shown::nodes(&grid, &fit.feet, zone_m);
    let spread = Spread::new(&problem, &fit, &all, zone_m, cancel)?;
    let node = |n: usize| {
        let [along, up] = grid.slopes(&fit.heights_m, n)?;
        let normal = Vector3::new(-along, -up, 1.0).normalize();
        let [sd_m, slope_sd] = spread.at(n)?;
        Some(Node {
            place: [n % grid.columns, n / grid.columns].map(|k| k as u32),
            point: frame.point(&grid.point(n, fit.heights_m[n])),
            sd_m: sd_m * normal.z,
            normal: frame.axes * normal,
            normal_sd_rad: slope_sd * normal.z,
        })
    };
    let nodes: Vec<Node> = (0..grid.count()).filter(|n| is_shown[*n]).filter_map(node).collect();
    let axis = frame.axes.column(2).into_owned();
    let spacing_m = grid.spacing_m;
    (!nodes.is_empty()).then_some(HeightField { axis, spacing_m, nodes, bend_per_m, members, misfit })
}

/// Axes of a grid, the third towards the wall, and its origin.
struct Frame {
    axes: Matrix3<f64>,
    origin: Point,
}

impl Frame {
    /// `None` where points have no common side.
    fn of(all: &[&Sighting]) -> Option<Self> {
        let towards: Vector3<f64> = all.iter().map(|one| (one.seen - one.point).normalize()).sum();
        let axis = towards.try_normalize(0.1 * all.len() as f64)?;
        let [x, y] = across(&axis);
        let origin = all.iter().map(|one| one.point.coords).sum::<Vector3<f64>>() / all.len() as f64;
        Some(Self { axes: Matrix3::from_columns(&[x, y, axis]), origin: origin.into() })
    }

    fn local(&self, point: &Point) -> Point {
        Point::from(self.axes.transpose() * (point - self.origin))
    }

    fn point(&self, local: &Point) -> Point {
        self.origin + self.axes * local.coords
    }

    fn grid(&self, all: &[&Sighting], zone_m: f64) -> Grid {
        let ends = |axis: usize| {
            let mut places: Vec<f64> = all.iter().map(|one| self.local(&one.point)[axis]).collect();
            places.sort_by(f64::total_cmp);
            let few = places.len() / ENDS;
            [places[few] - MARGIN * zone_m, places[places.len() - 1 - few] + MARGIN * zone_m]
        };
        let [[left, right], [low, high]] = [ends(0), ends(1)];
        let spacing_m = (SPACING * zone_m).max(((right - left) * (high - low) / MOST_NODES).sqrt());
        Grid::new(Vector2::new(left, low), Vector2::new(right, high), spacing_m)
    }
}
