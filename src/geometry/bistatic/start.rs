//! Places to start from, in closed form.

use nalgebra::{DMatrix, DVector, Vector3};

use super::{Point, Problem};

/// Places of all strips for labelled onsets of as many scans as there are dimensions: every combination of the roots
/// that lie on the known side.
pub(super) fn places(problem: &Problem, labels: &[(usize, Vec<usize>)]) -> Vec<Vec<Point>> {
    let mut all = vec![Vec::new()];
    for strip in 0..problem.strips.len() {
        let roots: Vec<Point> =
            roots(problem, labels, strip).into_iter().filter(|root| problem.is_in_front(root)).collect();
        let longer =
            |places: &Vec<Point>| roots.iter().map(|root| [places.as_slice(), &[*root]].concat()).collect::<Vec<_>>();
        all = all.iter().flat_map(longer).collect();
    }
    all
}

/// Where the ellipses of a strip meet. With x from the exit, `r = |x|`, and d from the exit to a lit point, `|x - d| =
/// s - r` squared is linear in (x, r): `d x - s r = (d^2 - s^2) / 2`. The direction of (x, r) that the scans tell least
/// is left free and follows from `r = |x|`.
fn roots(problem: &Problem, labels: &[(usize, Vec<usize>)], strip: usize) -> Vec<Point> {
    let n = problem.dimensions;
    let exit = problem.anchors[problem.strips[strip].exit].at;
    let (mut normal, mut right) = (DMatrix::zeros(n + 1, n + 1), DVector::zeros(n + 1));
    for (record, onsets) in labels {
        let record = &problem.records[*record];
        let (lit, station) = (problem.anchors[record.lit].at, problem.anchors[record.station].at);
        let legs_m = (lit - problem.source).norm() + (station - exit).norm();
        let sum_m = record.lengths_m[onsets[strip]] - legs_m;
        let arm = lit - exit;
        let row = DVector::from_fn(n + 1, |k, _| if k < n { arm[k] } else { -sum_m });
        right += &row * (0.5 * (arm.norm_squared() - sum_m * sum_m));
        normal += &row * row.transpose();
    }
    let eigen = normal.symmetric_eigen();
    let mut order: Vec<usize> = (0..=n).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let free = eigen.eigenvectors.column(order[0]).into_owned();
    let mut fixed = DVector::zeros(n + 1);
    for &k in &order[1..] {
        let (value, vector) = (eigen.eigenvalues[k], eigen.eigenvectors.column(k));
        if value > 0.0 {
            fixed += vector * (vector.dot(&right) / value);
        }
    }
    // x^2 - r^2 of two vectors.
    let form = |a: &DVector<f64>, b: &DVector<f64>| a.dot(b) - 2.0 * a[n] * b[n];
    let (a, b, c) = (form(&free, &free), form(&fixed, &free), form(&fixed, &fixed));
    // Ellipses that noise keeps apart come nearest in between.
    let root = (b * b - a * c).max(0.0).sqrt();
    // The form of the smaller root that does not cancel.
    let larger = -(b + root.copysign(b));
    let both = if larger == 0.0 { [0.0, 0.0] } else { [larger / a, c / larger] };
    let place = |along: f64| {
        let at = &fixed + &free * along;
        (along.is_finite() && at[n] > 0.0).then(|| exit + Vector3::from_fn(|k, _| if k < n { at[k] } else { 0.0 }))
    };
    both.into_iter().filter_map(place).collect()
}
