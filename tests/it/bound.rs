//! The Cramer-Rao bound of a simulated scene, and errors measured by it: written from the model alone, sharing no code with the estimators.

use nalgebra::{DMatrix, DVector, Matrix3, SymmetricEigen, Vector3};
use periscope::simulate::Scene;
use periscope::tables::{Calibration, Patch, PatchCovariance};

const LIGHT_M_PER_PS: f64 = 2.997_924_58e-4;

/// Standard deviation of an onset's time in one shot: amplitude, time and offset unknown, white noise, samples at random phases.
fn shot_sd_ps(shape: &dyn Fn(f64) -> f64, dt_ps: f64, snr: f64) -> f64 {
    let step = 0.5;
    let mut information = Matrix3::zeros();
    let mut t = -1200.0;
    while t < 4000.0 {
        let slope = (shape(t + 0.05) - shape(t - 0.05)) / 0.1;
        let gradient = Vector3::new(slope, shape(t), 1.0);
        information += gradient * gradient.transpose() * (step / dt_ps * snr * snr);
        t += step;
    }
    information.try_inverse().expect("a pulse has a time")[(0, 0)].sqrt()
}

/// Linear interpolation of a true response.
fn tabulated(row: &Calibration) -> impl Fn(f64) -> f64 + use<> {
    let (start, step, values) = (row.response_t0_ps, row.step_ps, row.response.to_f64());
    move |t| {
        let place = (t - start) / step;
        let i = place.floor();
        if i < 0.0 || i as usize + 1 >= values.len() {
            0.0
        } else {
            values[i as usize] + (place - i) * (values[i as usize + 1] - values[i as usize])
        }
    }
}

/// Standard deviation of every onset of a scene whose signal-to-noise ratio is set: signal, its reference pulse, and the converter's rounding.
pub fn onset_sd_ps(scene: &Scene, truth: &Calibration) -> f64 {
    let instrument = &scene.instrument;
    let height_v = 0.6 * instrument.full_scale_v;
    let rounding_v = instrument.full_scale_v / f64::from(1 << instrument.bits) / 12_f64.sqrt();
    let snr = |noise_v: f64| height_v / noise_v.hypot(rounding_v);
    let signal =
        shot_sd_ps(&tabulated(truth), instrument.dt_ps, snr(height_v / instrument.snr.expect("the ratio is set")));
    let reference = instrument.reference.expect("the scene has a reference");
    let sigma = reference.fwhm_ps / (8.0 * 2_f64.ln()).sqrt();
    let reference = shot_sd_ps(
        &|t| (-0.5 * (t / sigma).powi(2)).exp(),
        instrument.dt_ps,
        snr(height_v / reference.snr.expect("the ratio is set")),
    );
    let shots = scene.captures.shots as f64 * (1.0 - scene.captures.bad_shots);
    signal.hypot(reference) / shots.sqrt()
}

/// Covariance of all coordinates (three a patch) in the gauge without rotations about the laser: each pair in both directions, one delay with a prior.
pub fn position_covariance(scene: &Scene, onset_sd_ps: f64) -> DMatrix<f64> {
    let points: Vec<Vector3<f64>> = scene.patches.values().map(|disk| Vector3::from(disk.position_m)).collect();
    let count = points.len();
    let scale = LIGHT_M_PER_PS / scene.group_index;
    let mut information = DMatrix::zeros(3 * count + 1, 3 * count + 1);
    for i in 0..count {
        for j in 0..count {
            let mut gradient = DVector::zeros(3 * count + 1);
            let mut pull = |of: usize, arm: Vector3<f64>| {
                let unit = arm / arm.norm();
                (0..3).for_each(|k| gradient[3 * of + k] += unit[k]);
            };
            pull(i, points[i]);
            pull(j, points[j]);
            if i != j {
                pull(i, points[i] - points[j]);
                pull(j, points[j] - points[i]);
            }
            gradient[3 * count] = 1.0;
            information += &gradient * gradient.transpose() / (scale * onset_sd_ps).powi(2);
        }
    }
    information[(3 * count, 3 * count)] += 1.0 / scene.captures.path_sd_m.powi(2);
    let all = pseudo_inverse(&information, 3);
    all.view((0, 0), (3 * count, 3 * count)).into_owned()
}

/// Inverse on all but the `nulls` smallest eigenvalues.
pub fn pseudo_inverse(matrix: &DMatrix<f64>, nulls: usize) -> DMatrix<f64> {
    let eigen = SymmetricEigen::new(matrix.clone());
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let kept = &order[nulls..];
    kept.iter()
        .map(|&k| eigen.eigenvectors.column(k) * eigen.eigenvectors.column(k).transpose() / eigen.eigenvalues[k])
        .fold(DMatrix::zeros(matrix.nrows(), matrix.ncols()), |sum, term| sum + term)
}

/// What a solution missed the truth by, after the best rotation (or reflection) about the laser at the origin.
pub struct Missed {
    /// Sum of squared position errors.
    pub squares_m2: f64,
    /// Squared error in units of the covariance that the tables claim.
    pub normalised: f64,
}

/// Rotation or reflection about the origin that brings points nearest to others, by the polar decomposition of their correlation.
fn aligning(points: &[Vector3<f64>], targets: &[Vector3<f64>]) -> Matrix3<f64> {
    let correlation: Matrix3<f64> = points.iter().zip(targets).map(|(point, target)| target * point.transpose()).sum();
    let svd = correlation.svd(true, true);
    svd.u.expect("asked for") * svd.v_t.expect("asked for")
}

fn position(patch: &Patch) -> Vector3<f64> {
    Vector3::new(patch.x_m, patch.y_m, patch.z_m)
}

/// Mean squared position error of start values, which have no covariance.
pub fn squares_m2(found: &[Patch], truth: &[Patch]) -> f64 {
    let (points, targets): (Vec<_>, Vec<_>) =
        (found.iter().map(position).collect(), truth.iter().map(position).collect());
    let turn = aligning(&points, &targets);
    points.iter().zip(&targets).map(|(point, target)| (turn * point - target).norm_squared()).sum()
}

/// Errors of a refined solution.
pub fn missed(found: &[Patch], covariances: &[PatchCovariance], truth: &[Patch]) -> Missed {
    assert_eq!(
        found.iter().map(|patch| patch.patch).collect::<Vec<_>>(),
        truth.iter().map(|patch| patch.patch).collect::<Vec<_>>()
    );
    let (points, targets): (Vec<_>, Vec<_>) =
        (found.iter().map(position).collect(), truth.iter().map(position).collect());
    let turn = aligning(&points, &targets);
    let errors: Vec<Vector3<f64>> = points.iter().zip(&targets).map(|(point, target)| turn * point - target).collect();
    let place = |patch: i32| {
        found.iter().position(|row| row.patch == patch).expect("covariances are of patches that were found")
    };
    let mut covariance = DMatrix::zeros(3 * found.len(), 3 * found.len());
    let mut put = |a: usize, b: usize, block: Matrix3<f64>| {
        covariance.view_mut((3 * a, 3 * b), (3, 3)).copy_from(&(turn * block * turn.transpose()))
    };
    for (a, row) in found.iter().enumerate() {
        let [xx, xy, xz, yy, yz, zz] =
            [row.cov_xx_m2, row.cov_xy_m2, row.cov_xz_m2, row.cov_yy_m2, row.cov_yz_m2, row.cov_zz_m2]
                .map(|value| value.expect("refined"));
        put(a, a, Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz));
    }
    for row in covariances {
        let block = Matrix3::new(
            row.cov_xx_m2,
            row.cov_xy_m2,
            row.cov_xz_m2,
            row.cov_yx_m2,
            row.cov_yy_m2,
            row.cov_yz_m2,
            row.cov_zx_m2,
            row.cov_zy_m2,
            row.cov_zz_m2,
        );
        put(place(row.a), place(row.b), block);
        put(place(row.b), place(row.a), block.transpose());
    }
    let error = DVector::from_iterator(3 * errors.len(), errors.iter().flat_map(|error| [error.x, error.y, error.z]));
    let normalised = (error.transpose() * pseudo_inverse(&covariance, 3) * &error)[(0, 0)];
    Missed { squares_m2: errors.iter().map(Vector3::norm_squared).sum(), normalised }
}
