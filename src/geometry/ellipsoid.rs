//! Error ellipsoids: the principal axes of a position's covariance.

use nalgebra::Matrix3;

/// Semi-axes of the ellipsoid of one standard deviation, longest first: the eigenvectors of a covariance (m^2), each as
/// long as the root of its eigenvalue (m). Three orthogonal vectors; one of length zero where the covariance has no
/// extent.
#[must_use]
pub fn semi_axes_m(covariance_m2: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let matrix = Matrix3::from_fn(|row, column| covariance_m2[row][column]);
    let eigen = matrix.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a: &usize, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    order.map(|axis| {
        let semi_axis = eigen.eigenvectors.column(axis) * eigen.eigenvalues[axis].max(0.0).sqrt();
        [semi_axis[0], semi_axis[1], semi_axis[2]]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The outer products of the semi-axes add up to the covariance, and the axes are orthogonal.
        #[test]
        fn axes_rebuild_the_covariance(factor in prop::array::uniform9(-1.0..1.0_f64)) {
            let at = |row: usize, column: usize| -> f64 { (0..3).map(|k| factor[3 * row + k] * factor[3 * column + k]).sum() };
            let covariance: [[f64; 3]; 3] = std::array::from_fn(|row| std::array::from_fn(|column| at(row, column)));
            let axes = semi_axes_m(&covariance);
            for row in 0..3 {
                for column in 0..3 {
                    let rebuilt: f64 = axes.iter().map(|axis| axis[row] * axis[column]).sum();
                    prop_assert!((rebuilt - covariance[row][column]).abs() < 1e-12);
                }
            }
            let dot = |a: [f64; 3], b: [f64; 3]| -> f64 { (0..3).map(|k| a[k] * b[k]).sum() };
            prop_assert!(dot(axes[0], axes[1]).abs() < 1e-12 && dot(axes[1], axes[2]).abs() < 1e-12);
            prop_assert!(dot(axes[0], axes[0]) >= dot(axes[1], axes[1]) && dot(axes[1], axes[1]) >= dot(axes[2], axes[2]));
        }
    }
}
