//! Heights over a grid: the triangles between nodes, the point of these next to a place, and curvatures.

use std::ops::Range;

use nalgebra::{Matrix2, Vector2, Vector3};

use crate::Point;

/// Rows and columns of a tile.
const TILE: usize = 8;

/// A grid of nodes, row by row. Between four nodes lie two triangles, whose common side turns from cell to cell.
#[derive(Clone, Debug)]
pub struct Grid {
    pub columns: usize,
    pub rows: usize,
    pub spacing_m: f64,
    /// The first node.
    pub least_m: Vector2<f64>,
}

/// The point of a surface next to a place.
#[derive(Clone, Copy, Debug)]
pub struct Foot {
    pub distance_m: f64,
    /// Nodes of its triangle, and their shares in the point.
    pub nodes: [u32; 3],
    pub shares: [f64; 3],
    /// Change of the distance with the height of the point.
    pub slope: f64,
}

impl Grid {
    /// Over a rectangle. The longer side has the rows, so that nodes next to one another are near in order.
    pub fn new(least_m: Vector2<f64>, most_m: Vector2<f64>, spacing_m: f64) -> Self {
        let [columns, rows] = [0, 1].map(|k| ((most_m[k] - least_m[k]) / spacing_m).ceil() as usize + 1);
        Self { columns, rows, spacing_m, least_m }
    }

    pub fn count(&self) -> usize {
        self.columns * self.rows
    }

    /// Where a node lies.
    pub fn place(&self, node: usize) -> Vector2<f64> {
        self.least_m + Vector2::new((node % self.columns) as f64, (node / self.columns) as f64) * self.spacing_m
    }

    /// The node at a height.
    pub fn point(&self, node: usize, height_m: f64) -> Point {
        let place = self.place(node);
        Point::new(place.x, place.y, height_m)
    }

    /// All nodes at their heights.
    pub fn nodes(&self, heights_m: &[f64]) -> Nodes<'_> {
        let points: Vec<Point> = heights_m.iter().enumerate().map(|(node, height)| self.point(node, *height)).collect();
        let corners = |count: usize| (0..count).step_by(TILE);
        let tile = |row: usize, column: usize| {
            let rows = row..(row + TILE).min(self.rows);
            let columns = column..(column + TILE).min(self.columns);
            let (mut least, mut most) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
            for node in rows.clone().flat_map(|row| columns.clone().map(move |column| row * self.columns + column)) {
                (least, most) = (least.inf(&points[node].coords), most.sup(&points[node].coords));
            }
            Tile { rows, columns, least, most }
        };
        let tiles = corners(self.rows).flat_map(|row| corners(self.columns).map(move |column| (row, column)));
        Nodes { grid: self, tiles: tiles.map(|(row, column)| tile(row, column)).collect(), points }
    }

    /// Both triangles of a cell.
    fn triangles(&self, column: usize, row: usize) -> [[u32; 3]; 2] {
        let node = |right: usize, up: usize| ((row + up) * self.columns + column + right) as u32;
        let [a, b, c, d] = [node(0, 0), node(1, 0), node(0, 1), node(1, 1)];
        if (column + row).is_multiple_of(2) { [[a, b, d], [a, d, c]] } else { [[a, b, c], [b, d, c]] }
    }

    /// Steps to the next node along a row and along a column; `None` at the border.
    pub fn steps(&self, node: usize) -> Option<[usize; 2]> {
        let (column, row) = (node % self.columns, node / self.columns);
        let is_within = column > 0 && row > 0 && column + 1 < self.columns && row + 1 < self.rows;
        is_within.then_some([1, self.columns])
    }

    /// Slopes of a surface along rows and columns; `None` at the border.
    pub fn slopes(&self, heights_m: &[f64], node: usize) -> Option<[f64; 2]> {
        let slope = |step: usize| (heights_m[node + step] - heights_m[node - step]) / (2.0 * self.spacing_m);
        Some(self.steps(node)?.map(slope))
    }

    /// How far triangles about a node lie from a smooth surface through the nodes; 0 at the border.
    pub fn facet_m(&self, heights_m: &[f64], node: usize) -> f64 {
        let bend_m = |step: usize| (heights_m[node + step] - 2.0 * heights_m[node] + heights_m[node - step]).abs();
        self.steps(node).map_or(0.0, |steps| steps.map(bend_m).iter().sum::<f64>() / 8.0)
    }

    /// Second derivatives of a foot's distance by the heights of its nodes. The foot slides over its triangle, along a
    /// side or not at all, wherever it is nearest: so a distance is concave, and bends more the flatter the surface.
    pub fn bend_per_m(&self, foot: &Foot, heights_m: &[f64]) -> [[f64; 3]; 3] {
        let Foot { distance_m, nodes, shares, slope } = *foot;
        let [a, b, c] = nodes.map(|node| self.place(node as usize));
        let (ab, ac) = (b - a, c - a);
        let area = ab.perp(&ac);
        let (of_b, of_c) = (Vector2::new(ac.y, -ac.x) / area, Vector2::new(-ab.y, ab.x) / area);
        let share_slopes = [-of_b - of_c, of_b, of_c];
        let incline: Vector2<f64> = (0..3).map(|n| share_slopes[n] * heights_m[nodes[n] as usize]).sum();
        let metric = Matrix2::identity() + incline * incline.transpose();
        let along = |side: Vector2<f64>| side * side.transpose() / side.dot(&(metric * side));
        let ways = match shares.map(|share| share > 0.0) {
            [true, true, true] => metric.try_inverse().expect("a metric is positive"),
            [true, true, false] => along(ab),
            [true, false, true] => along(ac),
            [false, true, true] => along(c - b),
            _ => Matrix2::zeros(),
        };
        let pulls: [Vector2<f64>; 3] = [0, 1, 2].map(|n| incline * shares[n] + share_slopes[n] * (slope * distance_m));
        let bend = |a: usize, b: usize| {
            let still = shares[a] * shares[b] * (1.0 - slope * slope);
            (still - pulls[a].dot(&(ways * pulls[b]))) / distance_m
        };
        [0, 1, 2].map(|a| [0, 1, 2].map(|b| bend(a, b)))
    }

    /// Curvatures of a surface at a node, as sums over nodes: along columns, along rows, and the mixed one of the cell
    /// behind it, which counts twice among squares. Rows of nodes and factors (1 / spacing^2).
    pub fn bends(&self) -> Vec<Bend> {
        let mut bends = Vec::with_capacity(3 * self.count());
        let factor = self.spacing_m.powi(-2);
        let line = |first: usize, step: usize| Bend {
            nodes: [first, first + step, first + 2 * step, first],
            factors: [factor, -2.0 * factor, factor, 0.0],
        };
        let mixed = std::f64::consts::SQRT_2 * factor;
        for row in 0..self.rows {
            for column in 0..self.columns {
                let node = row * self.columns + column;
                if column + 2 < self.columns {
                    bends.push(line(node, 1));
                }
                if row + 2 < self.rows {
                    bends.push(line(node, self.columns));
                }
                if column + 1 < self.columns && row + 1 < self.rows {
                    let up = node + self.columns;
                    bends.push(Bend { nodes: [node, node + 1, up, up + 1], factors: [mixed, -mixed, -mixed, mixed] });
                }
            }
        }
        bends
    }
}

/// Nodes of a grid at their heights, in tiles: the nearest one to a place is sought in the nearest tiles alone.
pub struct Nodes<'a> {
    grid: &'a Grid,
    points: Vec<Point>,
    tiles: Vec<Tile>,
}

/// Rows and columns of nodes, and the ends of what they span.
struct Tile {
    rows: Range<usize>,
    columns: Range<usize>,
    least: Vector3<f64>,
    most: Vector3<f64>,
}

impl Tile {
    /// Square of a distance that no node of it falls below.
    fn gap_m2(&self, place: &Point) -> f64 {
        let nearest = place.coords.sup(&self.least).inf(&self.most);
        (nearest - place.coords).norm_squared()
    }
}

impl Nodes<'_> {
    /// The nearest node to a place; of some that are equally near the first. A node that is known to be near saves a
    /// look at most others.
    pub fn nearest(&self, place: &Point, near: Option<usize>) -> usize {
        let far_m2 = |node: usize| (self.points[node] - place).norm_squared();
        let mut nearest = near.map_or((f64::INFINITY, 0), |node| (far_m2(node), node));
        for tile in &self.tiles {
            // The bound is rounded otherwise than distances are.
            if tile.gap_m2(place) > nearest.0 * (1.0 + 1e-12) {
                continue;
            }
            for row in tile.rows.clone() {
                for node in tile.columns.clone().map(|column| row * self.grid.columns + column) {
                    let square = far_m2(node);
                    if (square, node) < nearest {
                        nearest = (square, node);
                    }
                }
            }
        }
        nearest.1
    }

    /// The point of the surface next to a place: of the triangles about the nearest of its nodes.
    pub fn foot(&self, place: &Point, near: Option<usize>) -> Foot {
        let nearest = self.nearest(place, near);
        let Grid { columns, rows, .. } = *self.grid;
        let (column, row) = (nearest % columns, nearest / columns);
        let mut best: Option<Foot> = None;
        for row in row.saturating_sub(1)..(row + 1).min(rows - 1) {
            for column in column.saturating_sub(1)..(column + 1).min(columns - 1) {
                for nodes in self.grid.triangles(column, row) {
                    let foot = foot(nodes.map(|node| self.points[node as usize]), nodes, place);
                    if best.is_none_or(|best| foot.distance_m < best.distance_m) {
                        best = Some(foot);
                    }
                }
            }
        }
        best.expect("a grid has cells")
    }
}

/// A curvature as a sum over up to four nodes.
#[derive(Clone, Copy, Debug)]
pub struct Bend {
    pub nodes: [usize; 4],
    pub factors: [f64; 4],
}

impl Bend {
    /// 1/m.
    pub fn of(&self, heights_m: &[f64]) -> f64 {
        self.nodes.iter().zip(self.factors).map(|(node, factor)| factor * heights_m[*node]).sum()
    }
}

/// The point of a triangle next to a place: within it, on a side or at an end, whichever is nearest.
fn foot(corners: [Point; 3], nodes: [u32; 3], place: &Point) -> Foot {
    let [a, b, c] = corners;
    let (ab, ac) = (b - a, c - a);
    let arm = place - a;
    let [bb, bc, cc] = [ab.dot(&ab), ab.dot(&ac), ac.dot(&ac)];
    let [pb, pc] = [ab.dot(&arm), ac.dot(&arm)];
    let determinant = bb * cc - bc * bc;
    let [u, v] = [(cc * pb - bc * pc) / determinant, (bb * pc - bc * pb) / determinant];
    let inside = [1.0 - u - v, u, v];
    let shares = if inside.iter().all(|share| *share >= 0.0) {
        inside
    } else {
        let on_side = |from: usize, to: usize| {
            let side = corners[to] - corners[from];
            let along = (side.dot(&(place - corners[from])) / side.norm_squared()).clamp(0.0, 1.0);
            let mut shares = [0.0; 3];
            shares[from] = 1.0 - along;
            shares[to] = along;
            shares
        };
        let square = |shares: &[f64; 3]| (mixed(&corners, shares) - place).norm_squared();
        let sides = [on_side(0, 1), on_side(1, 2), on_side(2, 0)];
        sides.into_iter().min_by(|a, b| square(a).total_cmp(&square(b))).expect("three sides")
    };
    let point = mixed(&corners, &shares);
    let distance_m = (place - point).norm();
    Foot { distance_m, nodes, shares, slope: (point.z - place.z) / distance_m }
}

fn mixed(corners: &[Point; 3], shares: &[f64; 3]) -> Point {
    Point::from(corners.iter().zip(shares).map(|(corner, share)| corner.coords * *share).sum::<Vector3<f64>>())
}
