//! Arrays that come in and go out.

use numpy::{AllowTypeChange, Element, PyArray1, PyArray2, PyArray3, PyArrayLike1, PyArrayLike2, PyArrayMethods};
use periscope::geometry::{Matrix, Point};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A vector of numbers: an array, or whatever NumPy makes one of.
pub type Vector<'py> = PyArrayLike1<'py, f64, AllowTypeChange>;
/// A vector of whole numbers.
pub type Integers<'py> = PyArrayLike1<'py, i64, AllowTypeChange>;
/// A matrix of numbers.
pub type Rows<'py> = PyArrayLike2<'py, f64, AllowTypeChange>;

/// Fails with a `ValueError` unless a condition holds.
pub fn require(holds: bool, problem: impl FnOnce() -> String) -> PyResult<()> {
    if holds { Ok(()) } else { Err(PyValueError::new_err(problem())) }
}

/// The numbers, each of which must be finite.
pub fn finite(name: &str, array: &Vector<'_>) -> PyResult<Vec<f64>> {
    let values: Vec<f64> = array.as_array().iter().copied().collect();
    let wrong = values.iter().position(|value| !value.is_finite());
    require(wrong.is_none(), || {
        let at = wrong.unwrap_or_default();
        format!("{name}[{at}] is {}; replace or remove values that are not finite", values[at])
    })?;
    Ok(values)
}

/// A number that must be finite and above 0.
pub fn positive(name: &str, value: f64) -> PyResult<f64> {
    require(value > 0.0 && value.is_finite(), || format!("{name} is {value}; it must be above 0"))?;
    Ok(value)
}

/// A finite number.
pub fn number(name: &str, value: f64) -> PyResult<f64> {
    require(value.is_finite(), || format!("{name} is {value}; it must be finite"))?;
    Ok(value)
}

/// One number for all, or a number for each.
#[derive(FromPyObject)]
pub enum Each<'py> {
    All(f64),
    Every(Vector<'py>),
}

impl Each<'_> {
    /// A number for each of `count`, all above 0. Infinite ones pass: they mark what is to be ignored.
    pub fn standard_deviations(&self, name: &str, count: usize) -> PyResult<Vec<f64>> {
        let values = self.values(name, count)?;
        let wrong = values.iter().position(|value| value.is_nan() || *value <= 0.0);
        require(wrong.is_none(), || {
            let at = wrong.unwrap_or_default();
            format!("{name}[{at}] is {}; standard deviations must be above 0", values[at])
        })?;
        Ok(values)
    }

    /// A number for each of `count`.
    pub fn values(&self, name: &str, count: usize) -> PyResult<Vec<f64>> {
        let values = match self {
            Self::All(value) => vec![*value; count],
            Self::Every(array) => array.as_array().iter().copied().collect(),
        };
        require(values.len() == count, || format!("{name} has {} values; {count} are needed", values.len()))?;
        Ok(values)
    }
}

/// Numbers of patches and stations, as the crates count them.
pub fn identifiers(name: &str, array: &Integers<'_>) -> PyResult<Vec<i32>> {
    let number = |value: &i64| {
        i32::try_from(*value).map_err(|_| PyValueError::new_err(format!("{name}: {value} is no number of a patch")))
    };
    array.as_array().iter().map(number).collect()
}

/// A square matrix.
pub fn square(name: &str, rows: &Rows<'_>) -> PyResult<Matrix> {
    let array = rows.as_array();
    let (height, width) = array.dim();
    require(height == width && height > 0, || format!("{name} has shape ({height}, {width}); it must be square"))?;
    Ok(Matrix::from_fn(height, height, |i, j| array[[i, j]]))
}

/// Points, a row each: x, y, z, or x and y alone.
pub fn points(name: &str, rows: &Rows<'_>) -> PyResult<Vec<Point>> {
    let array = rows.as_array();
    let width = array.dim().1;
    require(width == 2 || width == 3, || format!("{name} has {width} columns; a point has 2 or 3"))?;
    require(array.iter().all(|value| value.is_finite()), || format!("{name} has values that are not finite"))?;
    let z = |row: usize| if width == 3 { array[[row, 2]] } else { 0.0 };
    Ok((0..array.dim().0).map(|row| Point::new(array[[row, 0]], array[[row, 1]], z(row))).collect())
}

/// One place.
pub fn place(name: &str, [x, y, z]: [f64; 3]) -> PyResult<Point> {
    Ok(Point::new(number(name, x)?, number(name, y)?, number(name, z)?))
}

/// 2 or 3.
pub fn dimensions(count: usize) -> PyResult<usize> {
    require(count == 2 || count == 3, || format!("dimensions is {count}; space has 2 or 3"))?;
    Ok(count)
}

/// An array that takes the vector over.
pub fn vector<T: Element>(py: Python<'_>, values: Vec<T>) -> Py<PyArray1<T>> {
    PyArray1::from_vec(py, values).unbind()
}

/// An array of rows that lie one after another in a vector; it takes the vector over.
pub fn matrix<T: Element>(py: Python<'_>, values: Vec<T>, height: usize, width: usize) -> PyResult<Py<PyArray2<T>>> {
    Ok(PyArray1::from_vec(py, values).reshape([height, width])?.unbind())
}

/// Points as rows.
pub fn rows_of_points(py: Python<'_>, points: &[Point]) -> PyResult<Py<PyArray2<f64>>> {
    matrix(py, points.iter().flat_map(|point| [point.x, point.y, point.z]).collect(), points.len(), 3)
}

/// A matrix of the crates.
pub fn rows_of_matrix(py: Python<'_>, values: &Matrix) -> PyResult<Py<PyArray2<f64>>> {
    let (height, width) = (values.nrows(), values.ncols());
    let rows = (0..height).flat_map(|i| (0..width).map(move |j| values[(i, j)])).collect();
    matrix(py, rows, height, width)
}

/// Matrices of three rows and columns, one after another; those of covariances, whose order does not matter.
pub fn blocks(py: Python<'_>, values: Vec<f64>) -> PyResult<Py<PyArray3<f64>>> {
    let count = values.len() / 9;
    Ok(PyArray1::from_vec(py, values).reshape([count, 3, 3])?.unbind())
}
