//! Places of a patch that some of its ties agree on.

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

use super::Tie;
use crate::Point;

/// Foci whose paths propose.
const FOCI: usize = 2;
/// A path whose ends are less than this share of its length apart is nearly a sphere, and gives the range from its
/// focus.
const ROUND: f64 = 0.3;
/// Paths about a focus that propose by threes, and by twos together with one that is nearly a sphere.
const BY_THREES: usize = 8;
const BY_TWOS: usize = 12;
/// Paths that cross rays.
const CROSSINGS: usize = 12;
/// Three paths with less independence than this propose nothing.
const DEPENDENT: f64 = 1e-3;
/// Directions in which a place is searched where paths share no focus.
const DIRECTIONS: usize = 24;
/// Newton's steps along a ray.
const STEPS: usize = 8;

/// One path: its ends and length.
#[derive(Clone, Copy)]
struct Path {
    from: Point,
    to: Point,
    length_m: f64,
}

fn paths(ties: &[Tie]) -> Vec<Path> {
    let path = |tie: &Tie| match *tie {
        Tie::Path { from, to, length_m, .. } => Some(Path { from, to, length_m }),
        Tie::Anchor { .. } | Tie::Ray { .. } => None,
    };
    ties.iter().filter_map(path).collect()
}

/// At most `most` of some items, evenly spread.
fn spread<T: Copy>(items: &[T], most: usize) -> Vec<T> {
    let count = items.len().min(most);
    (0..count).map(|k| items[k * items.len() / count]).collect()
}

/// Anchors, crossings of rays with paths, and points where paths about one focus or spheres about several meet.
pub fn crossings(ties: &[Tie], dimensions: usize) -> Vec<Point> {
    let paths = paths(ties);
    let mut proposals = Vec::new();
    for tie in ties {
        match *tie {
            Tie::Anchor { position, .. } => proposals.push(position),
            Tie::Ray { from, direction, .. } => {
                proposals.extend(
                    spread(&paths, CROSSINGS).iter().map(|path| from + along(path, from, &direction) * direction),
                );
            }
            Tie::Path { .. } => {}
        }
    }
    let mut foci: Vec<(Point, Vec<Path>)> = Vec::new();
    for path in &paths {
        let turned = Path { from: path.to, to: path.from, ..*path };
        let ways = if path.from == path.to { vec![*path] } else { vec![*path, turned] };
        for way in ways {
            match foci.iter_mut().find(|(focus, _)| *focus == way.from) {
                Some((_, about)) => about.push(way),
                None => foci.push((way.from, vec![way])),
            }
        }
    }
    foci.sort_by_key(|(_, about)| std::cmp::Reverse(about.len()));
    foci.iter().take(FOCI).for_each(|(focus, about)| proposals.extend(meetings(*focus, about, dimensions)));
    let spheres: Vec<Path> = paths.into_iter().filter(|path| path.from == path.to).collect();
    proposals.extend(trilaterations(&spheres, dimensions));
    if dimensions == 2 {
        proposals.iter_mut().for_each(|point| point.z = 0.0);
    }
    proposals
}

/// Points where paths that begin at a focus meet.
fn meetings(focus: Point, about: &[Path], dimensions: usize) -> Vec<Point> {
    let row = |path: &Path| -> (Vector4<f64>, f64) {
        let c = path.to - focus;
        // The ends of a sphere are one.
        let (row, right) = if path.from == path.to {
            (Vector4::w(), 0.5 * path.length_m)
        } else {
            (Vector4::new(c.x, c.y, c.z, -path.length_m), 0.5 * (c.norm_squared() - path.length_m * path.length_m))
        };
        (row / row.norm(), right / row.norm())
    };
    let spread_of = |path: &Path| (path.to - focus).norm() / path.length_m;
    let roundest = (0..about.len()).min_by(|&a, &b| spread_of(&about[a]).total_cmp(&spread_of(&about[b])));
    let round = roundest.filter(|&best| spread_of(&about[best]) < ROUND);
    let others: Vec<Path> = (0..about.len()).filter(|&k| Some(k) != round).map(|k| about[k]).collect();
    let rows: Vec<_> = spread(&others, if round.is_some() { BY_TWOS } else { BY_THREES }).iter().map(row).collect();
    // What all sets of three have in common.
    let flat = (dimensions == 2).then_some((Vector4::z(), 0.0));
    let common: Vec<_> = round.map(|k| row(&about[k])).into_iter().chain(flat).collect();
    let mut points = Vec::new();
    let mut add = |rows: [(Vector4<f64>, f64); 3]| points.extend(meet(rows).into_iter().flatten().map(|x| focus + x));
    for i in 0..rows.len() {
        match common[..] {
            [a, b] => add([a, b, rows[i]]),
            [a] => (0..i).for_each(|k| add([a, rows[k], rows[i]])),
            _ => (0..i).for_each(|k| (0..k).for_each(|j| add([rows[j], rows[k], rows[i]]))),
        }
    }
    points
}

/// Points where spheres meet: with the range from one of them, each of the others leaves a plane.
fn trilaterations(spheres: &[Path], dimensions: usize) -> Vec<Point> {
    let mut points = Vec::new();
    for first in spread(spheres, FOCI) {
        let range_m = 0.5 * first.length_m;
        let row = |sphere: &Path| {
            let c = sphere.from - first.from;
            let right = 0.5 * (range_m * range_m + c.norm_squared() - 0.25 * sphere.length_m * sphere.length_m);
            (Vector4::new(c.x, c.y, c.z, 0.0) / c.norm(), right / c.norm())
        };
        let others: Vec<Path> = spheres.iter().filter(|sphere| sphere.from != first.from).copied().collect();
        let rows: Vec<_> = spread(&others, BY_TWOS).iter().map(row).collect();
        let range = (Vector4::w(), range_m);
        let mut add = |second, third| {
            points.extend(meet([range, second, third]).into_iter().flatten().map(|x| first.from + x));
        };
        for i in 0..rows.len() {
            match dimensions {
                2 => add((Vector4::z(), 0.0), rows[i]),
                _ => (0..i).for_each(|k| add(rows[k], rows[i])),
            }
        }
    }
    points
}

/// The points `x` with `|x| = r` on the line in `(x, r)` that three linear conditions leave, each with a row of norm 1;
/// where the line passes the cone, the nearest.
#[must_use]
pub fn meet(rows: [(Vector4<f64>, f64); 3]) -> [Option<Vector3<f64>>; 2] {
    let minor = |skip: usize| {
        let column = |k: usize| if k < skip { k } else { k + 1 };
        Matrix3::from_fn(|i, k| rows[i].0[column(k)]).determinant()
    };
    let null = Vector4::new(minor(0), -minor(1), minor(2), -minor(3));
    let Some(null) = null.try_normalize(DEPENDENT) else { return [None, None] };
    let matrix = Matrix4::from_fn(|i, k| if i < 3 { rows[i].0[k] } else { null[k] });
    let Some(inverse) = matrix.try_inverse() else { return [None, None] };
    let foot = inverse * Vector4::new(rows[0].1, rows[1].1, rows[2].1, 0.0);
    // Product in which the cone |x| = r is null.
    let product = |a: &Vector4<f64>, b: &Vector4<f64>| a.xyz().dot(&b.xyz()) - a.w * b.w;
    let (a, b, c) = (product(&null, &null), product(&null, &foot), product(&foot, &foot));
    let steps = if a.abs() < 1e-12 {
        [-0.5 * c / b, f64::NAN]
    } else {
        let root = (b * b - a * c).max(0.0).sqrt();
        [(root - b) / a, (-root - b) / a]
    };
    steps.map(|step| {
        let end = foot + null * step;
        (end.w > 0.0).then(|| end.xyz())
    })
}

/// How far along a ray a path's length is reached.
fn along(path: &Path, from: Point, direction: &Vector3<f64>) -> f64 {
    let (near, far) = (from - path.from, from - path.to);
    // Beyond the ellipsoid; from there Newton's steps on a convex function do not overshoot.
    let mut range_m = 0.5 * (path.length_m + near.norm() + far.norm());
    for _ in 0..STEPS {
        let (a, b) = (near + range_m * direction, far + range_m * direction);
        let (a_m, b_m) = (a.norm(), b.norm());
        let slope = a.dot(direction) / a_m + b.dot(direction) / b_m;
        if slope <= 0.0 {
            break;
        }
        range_m -= (a_m + b_m - path.length_m) / slope;
    }
    range_m.max(0.0)
}

/// Points in all directions about the first path, on its ellipsoid.
pub fn around(ties: &[Tie], dimensions: usize) -> Vec<Point> {
    let Some(path) = paths(ties).into_iter().next() else { return Vec::new() };
    (0..DIRECTIONS)
        .map(|k| {
            let direction = direction(k, DIRECTIONS, dimensions);
            path.from + along(&path, path.from, &direction) * direction
        })
        .collect()
}

/// Direction `k` of `count` evenly spread ones, on Fibonacci's lattice.
fn direction(k: usize, count: usize, dimensions: usize) -> Vector3<f64> {
    let golden = std::f64::consts::PI * (3.0 - 5_f64.sqrt());
    let turn = golden * k as f64;
    let height = if dimensions == 3 { 1.0 - (2 * k + 1) as f64 / count as f64 } else { 0.0 };
    let across = (1.0 - height * height).sqrt();
    Vector3::new(across * turn.cos(), across * turn.sin(), height)
}
