//! From path lengths to distances, and from distances to a first embedding.

use std::collections::BTreeSet;

use numpy::{PyArray1, PyArray2};
use periscope::geometry::t2::{self, Length};
use periscope::geometry::{Matrix, Point, classical, completion, iso_embed as algorithm_1, smacof as stress, t3};
use periscope::units::{PatchId, path_m};
use pyo3::prelude::*;

use crate::arrays::{
    Each, Integers, Rows, Vector, dimensions, finite, identifiers, matrix, points, positive, require, rows_of_matrix,
    rows_of_points, square, vector,
};
use crate::failure::{UndeterminedError, of_geometry};
use crate::interrupt::interruptible;

/// Lengths of times, with variances.
fn lengths(name: &str, time_ps: &Vector<'_>, sd_ps: &Each<'_>, group_index: f64) -> PyResult<Vec<Length>> {
    let times_ps = finite(name, time_ps)?;
    let sds_ps = sd_ps.standard_deviations(&format!("standard deviation of {name}"), times_ps.len())?;
    require(sds_ps.iter().all(|sd_ps| sd_ps.is_finite()), || {
        format!("a standard deviation of {name} is not finite; leave out times of unknown error")
    })?;
    let index = positive("group_index", group_index)?;
    let length = |(time_ps, sd_ps): (&f64, &f64)| Length {
        length_m: path_m(*time_ps, index),
        variance_m2: path_m(*sd_ps, index).powi(2),
    };
    Ok(times_ps.iter().zip(&sds_ps).map(length).collect())
}

/// A pair of patches for each length.
fn pairs(lit: &Integers<'_>, seen: &Integers<'_>, count: usize) -> PyResult<Vec<(PatchId, PatchId)>> {
    let (lit, seen) = (identifiers("lit", lit)?, identifiers("seen", seen)?);
    require(lit.len() == count && seen.len() == count, || {
        format!("lit has {} values and seen {}, for {count} times", lit.len(), seen.len())
    })?;
    Ok(lit.into_iter().zip(seen).collect())
}

/// Distances between patches. Patch 0 is laser and sensor.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct Distances {
    /// Smaller patch of each pair; shape (distances,).
    a: Py<PyArray1<i32>>,
    /// Larger patch of each pair; shape (distances,).
    b: Py<PyArray1<i32>>,
    /// Distance, m; shape (distances,).
    distance_m: Py<PyArray1<f64>>,
    /// Covariance of the distances, m^2: distances that share a first bounce are correlated; shape (distances,
    /// distances).
    covariance_m2: Py<PyArray2<f64>>,
    /// Pairs whose second bounce has no first bounces to go with it.
    skipped: Vec<(PatchId, PatchId)>,
    /// Pairs whose two directions disagree, with the difference in standard deviations.
    disagreeing: Vec<(PatchId, PatchId, f64)>,
}

/// Distances from first and second bounces: inverts T2.
///
/// Light that bounces off patch i alone covers 2 d_0i. Light over patches i and j covers d_0i + d_ij + d_0j.
///
/// Parameters
/// ----------
/// patch : array_like of int, shape (n,)
///     Patches of the first bounces, from 1.
/// first_ps : array_like, shape (n,)
///     Times of flight of the first bounces.
/// first_sd_ps : float or array_like, shape (n,)
///     Their standard deviations.
/// lit, seen : array_like of int, shape (m,)
///     Patches of the second bounces.
/// second_ps : array_like, shape (m,)
///     Times of flight of the second bounces. Several measurements of one pair are averaged.
/// second_sd_ps : float or array_like, shape (m,)
///     Their standard deviations.
/// group_index : float
///     Group index of the medium.
///
/// Returns
/// -------
/// Distances
///
/// Notes
/// -----
/// Source: Kirmani et al., ICCV 2009, section 4.1.
#[pyfunction]
#[pyo3(signature = (patch, first_ps, first_sd_ps, lit, seen, second_ps, second_sd_ps, group_index=1.0))]
pub fn t2_distances(
    py: Python<'_>,
    patch: Integers<'_>,
    first_ps: Vector<'_>,
    first_sd_ps: Each<'_>,
    lit: Integers<'_>,
    seen: Integers<'_>,
    second_ps: Vector<'_>,
    second_sd_ps: Each<'_>,
    group_index: f64,
) -> PyResult<Distances> {
    let patches = identifiers("patch", &patch)?;
    let first = lengths("first_ps", &first_ps, &first_sd_ps, group_index)?;
    let second = lengths("second_ps", &second_ps, &second_sd_ps, group_index)?;
    require(patches.len() == first.len(), || format!("patch has {} values for {} times", patches.len(), first.len()))?;
    let pairs = pairs(&lit, &seen, second.len())?;
    let first: Vec<_> = patches.into_iter().zip(first).collect();
    let second: Vec<_> = pairs.into_iter().zip(second).collect();
    let result = py.detach(|| t2::invert(&first, &second));
    let count = result.distances.len();
    let mut covariance: Vec<f64> = vec![0.0; count * count];
    for (n, distance) in result.distances.iter().enumerate() {
        covariance[n * count + n] = distance.variance_m2;
    }
    for (n, m, value) in result.covariances {
        covariance[n * count + m] = value;
        covariance[m * count + n] = value;
    }
    Ok(Distances {
        a: vector(py, result.distances.iter().map(|distance| distance.a).collect()),
        b: vector(py, result.distances.iter().map(|distance| distance.b).collect()),
        distance_m: vector(py, result.distances.iter().map(|distance| distance.distance_m).collect()),
        covariance_m2: matrix(py, covariance, count, count)?,
        skipped: result.skipped,
        disagreeing: result.disagreeing,
    })
}

/// Ranges from one hidden patch to visible ones.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct Ranges {
    /// Visible patches that have a range, ascending; shape (ranges,).
    patch: Py<PyArray1<i32>>,
    /// Range from the hidden patch to each, m; shape (ranges,).
    range_m: Py<PyArray1<f64>>,
    /// Covariance of the ranges, m^2; shape (ranges, ranges).
    covariance_m2: Py<PyArray2<f64>>,
    /// Visible patches whose ranges the sums do not determine, by connected parts.
    open: Vec<Vec<PatchId>>,
    /// Squared residuals of the sums, by their covariance.
    chi2: f64,
    /// Sums less what they determine.
    degrees_of_freedom: usize,
}

/// Ranges to one hidden patch from third bounces: inverts T3.
///
/// Light over visible patch i, the hidden patch and visible patch j covers, between the two visible ones, the sum of
/// two ranges. Generalised least squares over all sums gives the ranges, where sums form an odd cycle.
///
/// Parameters
/// ----------
/// lit, seen : array_like of int, shape (n,)
///     Visible patches before and after the hidden one; may be the same.
/// sum_ps : array_like, shape (n,)
///     Time of flight from the lit patch over the hidden one to the seen patch: without the way from the laser to the
///     lit patch, and without that from the seen patch to the sensor.
/// sum_sd_ps : float or array_like, shape (n,)
///     Standard deviations, independent of one another.
/// group_index : float
///     Group index of the medium.
///
/// Returns
/// -------
/// Ranges
///
/// Notes
/// -----
/// Source: Kirmani et al., ICCV 2009, section 4.3.
#[pyfunction]
#[pyo3(signature = (lit, seen, sum_ps, sum_sd_ps, group_index=1.0))]
pub fn t3_ranges(
    py: Python<'_>,
    lit: Integers<'_>,
    seen: Integers<'_>,
    sum_ps: Vector<'_>,
    sum_sd_ps: Each<'_>,
    group_index: f64,
) -> PyResult<Ranges> {
    let lengths = lengths("sum_ps", &sum_ps, &sum_sd_ps, group_index)?;
    let pairs = pairs(&lit, &seen, lengths.len())?;
    let sum = |((lit, seen), length)| t3::Sum { lit, seen, length, common_m: Vec::new() };
    let sums: Vec<t3::Sum> = pairs.into_iter().zip(lengths).map(sum).collect();
    let ranges = py.detach(|| t3::invert(&sums));
    Ok(Ranges {
        patch: vector(py, ranges.patches),
        range_m: vector(py, ranges.ranges_m),
        covariance_m2: rows_of_matrix(py, &ranges.covariance_m2)?,
        open: ranges.open,
        chi2: ranges.chi2,
        degrees_of_freedom: ranges.degrees_of_freedom,
    })
}

/// Completes a matrix of distances: a distance that was not measured becomes the length of the shortest path over
/// measured ones.
///
/// Parameters
/// ----------
/// distances_m : array_like, shape (n, n)
///     Distances; NaN or infinite where there is none. The diagonal is not used.
///
/// Returns
/// -------
/// numpy.ndarray, shape (n, n)
///
/// Raises
/// ------
/// UndeterminedError
///     If no chain of distances joins a point to point 0.
#[pyfunction]
pub fn complete_distances(py: Python<'_>, distances_m: Rows<'_>) -> PyResult<Py<PyArray2<f64>>> {
    let given = square("distances_m", &distances_m)?;
    let count = given.nrows();
    let measured = |i: usize, j: usize| Some(given[(i, j)]).filter(|distance| distance.is_finite());
    let is_negative = |i: usize, j: usize| i != j && measured(i, j).is_some_and(|distance| distance < 0.0);
    let negative = (0..count).any(|i| (0..count).any(|j| is_negative(i, j)));
    require(!negative, || "distances_m has negative distances".to_owned())?;
    let complete = interruptible(py, |cancel| completion::complete(count, measured, cancel))?;
    rows_of_matrix(py, &complete.map_err(of_geometry)?)
}

/// A symmetric matrix of numbers that are finite and not negative.
fn symmetric(name: &str, rows: &Rows<'_>) -> PyResult<Matrix> {
    let matrix = square(name, rows)?;
    let count = matrix.nrows();
    let is_whole = |i: usize, j: usize| {
        let value = matrix[(i, j)];
        value.is_finite() && value >= 0.0 && (value - matrix[(j, i)]).abs() <= 1e-9 * value.max(1.0)
    };
    let holds = (0..count).all(|i| (0..count).all(|j| is_whole(i, j)));
    require(holds, || format!("{name} must be symmetric, finite and not negative; complete_distances fills gaps"))?;
    Ok(matrix)
}

/// A whole matrix of distances.
fn whole(rows: &Rows<'_>) -> PyResult<Matrix> {
    let distances_m = symmetric("distances_m", rows)?;
    let is_zero = (0..distances_m.nrows()).all(|i| distances_m[(i, i)] == 0.0);
    require(is_zero, || "distances_m must be 0 on the diagonal".to_owned())?;
    Ok(distances_m)
}

/// Positions from a whole matrix of distances, by classical scaling (double centring).
///
/// Parameters
/// ----------
/// distances_m : array_like, shape (n + 1, n + 1)
///     Distances between laser (row 0) and patches 1 to n.
/// dimensions : {3, 2}
///     Dimensions of space.
///
/// Returns
/// -------
/// numpy.ndarray, shape (n, 3)
///     Patches 1 to n; point 0 is the origin. Rotation and mirror image are arbitrary.
///
/// Notes
/// -----
/// Source: Torgerson, Psychometrika 17, 401 (1952).
#[pyfunction]
#[pyo3(signature = (distances_m, dimensions=3))]
pub fn classical_scaling(
    py: Python<'_>,
    distances_m: Rows<'_>,
    #[pyo3(from_py_with = space)] dimensions: usize,
) -> PyResult<Py<PyArray2<f64>>> {
    let distances_m = whole(&distances_m)?;
    rows_of_points(py, &py.detach(|| classical::embed(&distances_m, dimensions)))
}

/// Positions from a whole matrix of distances, by IsoEmbed, the paper's Algorithm 1. To compare with:
/// `classical_scaling` bears more noise.
///
/// Parameters
/// ----------
/// distances_m : array_like, shape (n + 1, n + 1)
///     Distances between laser (row 0) and patches 1 to n.
/// dimensions : {3, 2}
///     Dimensions of space.
///
/// Returns
/// -------
/// numpy.ndarray, shape (n, 3)
///     Patches 1 to n; point 0 is the origin. Rotation and mirror image are arbitrary.
///
/// Notes
/// -----
/// Source: Kirmani et al., ICCV 2009, section 4.2.
#[pyfunction]
#[pyo3(signature = (distances_m, dimensions=3))]
pub fn iso_embed(
    py: Python<'_>,
    distances_m: Rows<'_>,
    #[pyo3(from_py_with = space)] dimensions: usize,
) -> PyResult<Py<PyArray2<f64>>> {
    let distances_m = whole(&distances_m)?;
    rows_of_points(py, &py.detach(|| algorithm_1::embed(&distances_m, dimensions)))
}

/// An argument that says how many dimensions space has.
fn space(count: &Bound<'_, PyAny>) -> PyResult<usize> {
    dimensions(count.extract()?)
}

/// Moves positions to a minimum of the weighted squared misfits of distances (SMACOF).
///
/// Parameters
/// ----------
/// start_m : array_like, shape (n, 3)
///     Patches 1 to n, where the search begins; point 0 is the origin.
/// distances_m : array_like, shape (n + 1, n + 1)
///     Distances between laser (row 0) and patches 1 to n.
/// weights : array_like, shape (n + 1, n + 1)
///     Weight of each distance, such as 1 over its variance; 0 for one that was not measured.
///
/// Returns
/// -------
/// points_m : numpy.ndarray, shape (n, 3)
/// stress : float
///     Weighted sum of squared misfits.
///
/// Raises
/// ------
/// UndeterminedError
///     If the weights do not connect every patch with point 0.
///
/// Notes
/// -----
/// Source: de Leeuw, in *Recent Developments in Statistics*, 133 (1977).
#[pyfunction]
pub fn smacof(
    py: Python<'_>,
    start_m: Rows<'_>,
    distances_m: Rows<'_>,
    weights: Rows<'_>,
) -> PyResult<(Py<PyArray2<f64>>, f64)> {
    let start: Vec<Point> = points("start_m", &start_m)?;
    let (distances_m, weights) = (whole(&distances_m)?, symmetric("weights", &weights)?);
    let sizes: BTreeSet<usize> = [start.len() + 1, distances_m.nrows(), weights.nrows()].into();
    require(sizes.len() == 1, || "distances_m and weights need a row for point 0 and for each patch".to_owned())?;
    let scaled = interruptible(py, |_| stress::scale(&start, &distances_m, &weights))?;
    let scaled =
        scaled.ok_or_else(|| UndeterminedError::new_err("the weights do not connect every patch with point 0"))?;
    Ok((rows_of_points(py, &scaled.points)?, scaled.stress))
}
