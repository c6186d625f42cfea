//! Planes through groups of patches (paper Figs. 4d and 6d: surface fitting, near co-planarity).
//!
//! Total least squares: it minimises distances at right angles to the plane, each over its variance `n' C_i n`. The
//! normal itself decides these variances, hence a few rounds. Errors follow to first order from the covariances of all
//! patches, those between patches included. A tilt between two planes is known better than the normals of both: it does
//! not depend on the rotation that path lengths leave open.
//!
//! [`find`] groups patches by itself: of the planes through triples of patches the one with the most patches within
//! [`NEAR`] standard deviations, fitted and counted anew until its members stay; then the same with what remains.
//! Source: consensus as in Fischler and Bolles, Commun. ACM 24, 381 (1981), with every triple (from some 200 patches
//! on, every n-th) in place of random ones. Not modelled: edges; a plane reaches as far as there are patches on it.

use nalgebra::{Matrix3, Vector3};

use super::Point;

/// Standard deviations within which a patch counts as on a plane: 1 in 2,000 of those that are lies beyond.
pub const NEAR: f64 = 3.5;
/// Rounds of weights, and of members.
const ROUNDS: usize = 10;
/// About as many triples are tried.
const TRIPLES: usize = 1_000_000;
/// Triples nearer to a line than this (as a sine) have no plane.
const IN_LINE: f64 = 0.05;

/// A plane: all points p with `normal . p = offset_m`.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane {
    /// Unit normal, away from the origin.
    pub normal: Vector3<f64>,
    /// Distance from the origin.
    pub offset_m: f64,
    /// Covariance of the normal.
    pub normal_covariance: Matrix3<f64>,
    /// Standard deviation of the offset.
    pub offset_sd_m: f64,
    /// Patches on it, ascending.
    pub members: Vec<usize>,
    /// Root of the mean squared distance of the patches from it.
    pub rms_m: f64,
    /// The same squared distances, each over its patch's variance, summed.
    pub chi2: f64,
    /// How the normal turns as each member moves out of the plane.
    levers: Vec<Vector3<f64>>,
}

/// The plane nearest to the `members` of `points`; `covariance_m2(a, b)` is that of two patches (zero between two where
/// it is not known). `None` for fewer than three patches, or patches in line.
#[must_use]
pub fn fit(points: &[Point], members: &[usize], covariance_m2: impl Fn(usize, usize) -> Matrix3<f64>) -> Option<Plane> {
    if members.len() < 3 {
        return None;
    }
    let mut weights = vec![1.0; members.len()];
    let mut normal = Vector3::zeros();
    let mut middle = Vector3::zeros();
    let mut across = [Vector3::zeros(); 2];
    for _ in 0..ROUNDS {
        let total: f64 = weights.iter().sum();
        middle = weighted(points, members, &weights).sum::<Vector3<f64>>() / total;
        let arm = |(&member, weight): (&usize, &f64)| {
            let arm = points[member].coords - middle;
            *weight * arm * arm.transpose()
        };
        let scatter: Matrix3<f64> = members.iter().zip(&weights).map(arm).sum();
        let eigen = scatter.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        if eigen.eigenvalues[order[1]] <= 1e-12 * eigen.eigenvalues[order[2]] {
            return None;
        }
        let vector = |k: usize| -> Vector3<f64> { eigen.eigenvectors.column(order[k]).into() };
        normal = vector(0);
        across = [vector(1), vector(2)];
        weights = members.iter().map(|&member| 1.0 / normal.dot(&(covariance_m2(member, member) * normal))).collect();
        if !weights.iter().all(|weight| weight.is_finite() && *weight > 0.0) {
            return None;
        }
    }
    if normal.dot(&middle) < 0.0 {
        normal = -normal;
    }
    let out = |member: usize| normal.dot(&(points[member].coords - middle));
    // A plane tilts about two axes and moves along its normal; members move it by their distances, in proportion to
    // weight and lever.
    let rows: Vec<Vector3<f64>> = members
        .iter()
        .map(|&member| {
            let arm = points[member].coords - middle;
            Vector3::new(arm.dot(&across[0]), arm.dot(&across[1]), 1.0)
        })
        .collect();
    let fisher: Matrix3<f64> = rows.iter().zip(&weights).map(|(row, weight)| *weight * row * row.transpose()).sum();
    let inverse = fisher.try_inverse()?;
    let gains: Vec<Vector3<f64>> = rows.iter().zip(&weights).map(|(row, weight)| *weight * (inverse * row)).collect();
    // As heights over the plane rise along an axis, the normal leans the other way.
    let levers: Vec<Vector3<f64>> = gains.iter().map(|gain| -across[0] * gain.x - across[1] * gain.y).collect();
    let (mut normal_covariance, mut offset_variance_m2) = (Matrix3::zeros(), 0.0);
    for (a, (lever_a, gain_a)) in levers.iter().zip(&gains).enumerate() {
        for (b, (lever_b, gain_b)) in levers.iter().zip(&gains).enumerate() {
            let both = normal.dot(&(covariance_m2(members[a], members[b]) * normal));
            normal_covariance += both * lever_a * lever_b.transpose();
            // The offset is that of the origin's foot: it moves with the middle and as the normal leans.
            offset_variance_m2 += both * (gain_a.z + lever_a.dot(&middle)) * (gain_b.z + lever_b.dot(&middle));
        }
    }
    let squares: f64 = members.iter().map(|&member| out(member).powi(2)).sum();
    Some(Plane {
        normal,
        offset_m: normal.dot(&middle),
        normal_covariance,
        offset_sd_m: offset_variance_m2.max(0.0).sqrt(),
        members: members.to_vec(),
        rms_m: (squares / members.len() as f64).sqrt(),
        chi2: members.iter().zip(&weights).map(|(&member, weight)| weight * out(member).powi(2)).sum(),
        levers,
    })
}

fn weighted<'a>(
    points: &'a [Point],
    members: &'a [usize],
    weights: &'a [f64],
) -> impl Iterator<Item = Vector3<f64>> + 'a {
    members.iter().zip(weights).map(|(&member, weight)| points[member].coords * *weight)
}

/// The plane (in flatland the line) of least squared distances to some points, all counted alike: a point of it and its
/// unit normal. Arbitrary where points lie in line (in flatland in one place).
///
/// # Panics
/// Without points.
#[must_use]
pub fn nearest(points: &[Point], dimensions: usize) -> (Point, Vector3<f64>) {
    assert!(!points.is_empty(), "a plane through no points");
    let middle = points.iter().map(|point| point.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let mut scatter: Matrix3<f64> =
        points.iter().map(|point| (point.coords - middle) * (point.coords - middle).transpose()).sum();
    if dimensions == 2 {
        // The normal lies in the plane z = 0.
        scatter[(2, 2)] = 1.0 + scatter.trace();
    }
    let eigen = scatter.symmetric_eigen();
    (Point::from(middle), eigen.eigenvectors.column(eigen.eigenvalues.imin()).into())
}

/// Whether two points lie on different sides of the plane (in flatland the line) nearest to some points. What a wall's
/// patches see lies on the same side as the laser that lights them.
///
/// # Panics
/// Without points.
#[must_use]
pub fn is_across(points: &[Point], dimensions: usize, one: Point, other: Point) -> bool {
    let (middle, normal) = nearest(points, dimensions);
    normal.dot(&(one - middle)) * normal.dot(&(other - middle)) < 0.0
}

/// Planes with at least `least` patches, largest first; a patch belongs to one at most.
///
/// # Panics
/// When `least` is below four: any three patches have a plane.
#[must_use]
pub fn find(points: &[Point], least: usize, covariance_m2: impl Fn(usize, usize) -> Matrix3<f64>) -> Vec<Plane> {
    assert!(least >= 4, "any three patches have a plane");
    let mut left: Vec<usize> = (0..points.len()).collect();
    let mut planes = Vec::new();
    let on = |normal: &Vector3<f64>, offset_m: f64, patch: usize| {
        let variance_m2 = normal.dot(&(covariance_m2(patch, patch) * normal));
        (normal.dot(&points[patch].coords) - offset_m).powi(2) <= NEAR * NEAR * variance_m2
    };
    while left.len() >= least {
        let consensus = |normal: &Vector3<f64>, offset_m: f64| -> Vec<usize> {
            left.iter().copied().filter(|&patch| on(normal, offset_m, patch)).collect()
        };
        let count = left.len();
        let stride = (count * (count - 1) * (count - 2) / 6).div_ceil(TRIPLES);
        let triples = (0..count).flat_map(|i| (0..i).flat_map(move |j| (0..j).map(move |k| [i, j, k])));
        let mut best: Vec<usize> = Vec::new();
        for triple in triples.step_by(stride) {
            let [a, b, c] = triple.map(|n| points[left[n]]);
            let cross = (b - a).cross(&(c - a));
            if cross.norm() <= IN_LINE * (b - a).norm() * (c - a).norm() {
                continue;
            }
            let normal = cross.normalize();
            let members = consensus(&normal, normal.dot(&a.coords));
            if members.len() > best.len() {
                best = members;
            }
        }
        let mut plane = None;
        for _ in 0..ROUNDS {
            let Some(fitted) = fit(points, &best, &covariance_m2) else { break };
            let members = consensus(&fitted.normal, fitted.offset_m);
            let settled = members == best;
            best = members;
            plane = Some(fitted);
            if settled {
                break;
            }
        }
        let Some(plane) = plane.filter(|plane| plane.members.len() >= least) else { break };
        left.retain(|patch| !plane.members.contains(patch));
        planes.push(plane);
    }
    planes.sort_by_key(|plane| std::cmp::Reverse(plane.members.len()));
    planes
}

/// Angle between two planes (0 to 90 degrees) and its standard deviation, in radians.
#[must_use]
pub fn tilt(a: &Plane, b: &Plane, covariance_m2: impl Fn(usize, usize) -> Matrix3<f64>) -> (f64, f64) {
    let cosine = a.normal.dot(&b.normal);
    let sign = if cosine < 0.0 { -1.0 } else { 1.0 };
    let sine = a.normal.cross(&b.normal).norm();
    // Directions in which each normal leans away from the other; for parallel planes any.
    let away = |own: &Vector3<f64>, other: Vector3<f64>| {
        let aside = own * own.dot(&other) - other;
        aside.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(|| own.cross(&Vector3::ith(own.iamin(), 1.0)).normalize())
    };
    let (from_b, from_a) = (away(&a.normal, sign * b.normal), sign * away(&(sign * b.normal), a.normal));
    let moves = |plane: &Plane, away: Vector3<f64>| -> Vec<(usize, Vector3<f64>)> {
        let pull = |(&member, lever): (&usize, &Vector3<f64>)| (member, plane.normal * lever.dot(&away));
        plane.members.iter().zip(&plane.levers).map(pull).collect()
    };
    let all: Vec<(usize, Vector3<f64>)> = moves(a, from_b).into_iter().chain(moves(b, from_a)).collect();
    let variance: f64 = all
        .iter()
        .flat_map(|(i, u)| all.iter().map(move |(j, v)| (i, u, j, v)))
        .map(|(i, u, j, v)| u.dot(&(covariance_m2(*i, *j) * v)))
        .sum();
    (sine.atan2(cosine.abs()), variance.max(0.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::room;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Patches with independent errors that differ by patch and direction.
    fn noisy(truth: &[Point], rng: &mut ChaCha8Rng) -> Vec<Point> {
        let shaken = |(i, p): (usize, &Point)| {
            let z = Vector3::from_fn(|_, _| StandardNormal.sample(rng));
            p + covariance(i, i).cholesky().unwrap().l() * z
        };
        truth.iter().enumerate().map(shaken).collect()
    }

    fn covariance(a: usize, b: usize) -> Matrix3<f64> {
        let sd = Vector3::new(0.002, 0.001 + 0.001 * (a % 3) as f64, 0.003);
        if a == b { Matrix3::from_diagonal(&sd.component_mul(&sd)) } else { Matrix3::zeros() }
    }

    #[test]
    fn three_rectangles_are_found_and_their_angles_are_right() {
        let truth = room::rectangles();
        let planes = find(&noisy(&truth, &mut ChaCha8Rng::seed_from_u64(1)), 5, covariance);
        let sizes: Vec<usize> = planes.iter().map(|plane| plane.members.len()).collect();
        assert_eq!(sizes, [25, 16, 8]);
        assert_eq!(planes[0].members, (0..25).collect::<Vec<_>>());
        for (plane, (normal, offset_m)) in
            planes.iter().zip([(Vector3::y(), 2.6), (Vector3::x(), 1.1), (-Vector3::z(), 0.9)])
        {
            assert!((plane.normal - normal).norm() < 0.01 && (plane.offset_m - offset_m).abs() < 0.005, "{plane:?}");
            assert!(plane.rms_m < 0.005);
        }
        for (a, b) in [(0, 1), (0, 2), (1, 2)] {
            let (angle, sd) = tilt(&planes[a], &planes[b], covariance);
            assert!((angle - std::f64::consts::FRAC_PI_2).abs() < 5.0 * sd && sd < 0.01);
        }
    }

    #[test]
    fn claimed_errors_are_those_of_many_draws() {
        let truth = room::rectangles();
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (wall, floor): (Vec<usize>, Vec<usize>) = ((0..25).collect(), (41..49).collect());
        // Inclined to one another, so that the angle has a side to leave to.
        let leaning: Vec<Point> = truth.iter().map(|p| Point::new(p.x, p.y + 0.7 * p.z, p.z - 0.1 * p.x)).collect();
        let exact = fit(&leaning, &wall, covariance).unwrap();
        let exact_tilt = tilt(&exact, &fit(&leaning, &floor, covariance).unwrap(), covariance).0;
        let (mut normals, mut offset, mut angle, mut chi2) = (Matrix3::zeros(), 0.0, 0.0, 0.0);
        let draws = 2000;
        for _ in 0..draws {
            let points = noisy(&leaning, &mut rng);
            let (a, b) = (fit(&points, &wall, covariance).unwrap(), fit(&points, &floor, covariance).unwrap());
            let error = a.normal - exact.normal;
            normals += error * error.transpose() / f64::from(draws);
            offset += (a.offset_m - exact.offset_m).powi(2) / f64::from(draws);
            angle += (tilt(&a, &b, covariance).0 - exact_tilt).powi(2) / f64::from(draws);
            chi2 += a.chi2 / f64::from(draws);
        }
        let sd = tilt(&exact, &fit(&leaning, &floor, covariance).unwrap(), covariance).1;
        assert!((normals.trace() / exact.normal_covariance.trace() - 1.0).abs() < 0.1);
        assert!((normals - exact.normal_covariance).norm() < 0.1 * exact.normal_covariance.norm());
        assert!((offset.sqrt() / exact.offset_sd_m - 1.0).abs() < 0.06, "{} {}", offset.sqrt(), exact.offset_sd_m);
        assert!((angle.sqrt() / sd - 1.0).abs() < 0.06, "{} {sd}", angle.sqrt());
        assert!((chi2 / 22.0 - 1.0).abs() < 0.05, "{chi2}");
    }

    #[test]
    fn the_nearest_plane_and_line_are_those_that_points_lie_on() {
        let normal = Vector3::new(0.6, -0.8, 0.0);
        let on = |u: f64, v: f64| Point::from(0.5 * normal + Vector3::new(0.8, 0.6, 0.0) * u + Vector3::z() * v);
        let wall: Vec<Point> = (0..12).map(|n| on(0.3 * f64::from(n % 4), 0.2 * f64::from(n / 4))).collect();
        let line: Vec<Point> = (0..3).map(|n| on(0.001 * f64::from(n), 0.0)).collect();
        for (points, dimensions) in [(wall, 3), (line, 2)] {
            let (middle, nearest_normal) = nearest(&points, dimensions);
            assert!(
                (nearest_normal.dot(&normal).abs() - 1.0).abs() < 1e-9
                    && (normal.dot(&middle.coords) - 0.5).abs() < 1e-9
            );
        }
    }

    #[test]
    fn patches_in_line_have_no_plane_and_a_rotation_common_to_all_does_not_touch_a_tilt() {
        let line: Vec<Point> = (0..5).map(|i| Point::new(1.0, f64::from(i), 2.0)).collect();
        assert_eq!(fit(&line, &[0, 1, 2, 3, 4], covariance), None);
        assert_eq!(fit(&line, &[0, 1], covariance), None);
        let points = room::rectangles();
        // Errors that are a common rotation about an axis: J J' with J the motion of each patch.
        let axis = Vector3::new(0.01, 0.02, -0.01);
        let turning = |a: usize, b: usize| {
            let motion = |i: usize| axis.cross(&points[i].coords);
            motion(a) * motion(b).transpose() + if a == b { Matrix3::identity() * 1e-10 } else { Matrix3::zeros() }
        };
        let (wall, side): (Vec<usize>, Vec<usize>) = ((0..25).collect(), (25..41).collect());
        let (a, b) = (fit(&points, &wall, turning).unwrap(), fit(&points, &side, turning).unwrap());
        let (_, sd) = tilt(&a, &b, turning);
        assert!(sd < 1e-4 && a.normal_covariance.trace().sqrt() > 0.01, "{sd}");
    }
}
