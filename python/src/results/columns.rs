//! Columns of tables as arrays.

use arrow_array::cast::AsArray;
use arrow_array::types::{ArrowPrimitiveType, Float32Type, Float64Type, Int32Type, Int64Type};
use arrow_array::{Array, ArrayRef};
use arrow_schema::DataType;
use numpy::{Element, PyArray1};
use pyo3::BoundObject;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::vector;

/// The parts of a column as one array: of numbers, or of objects where they are texts, lists, or flags with gaps.
pub fn array<'py>(py: Python<'py>, name: &str, kind: &DataType, parts: &[ArrayRef]) -> PyResult<Bound<'py, PyAny>> {
    match kind {
        DataType::Float64 => Ok(numbers::<Float64Type>(py, parts, |value| value)),
        DataType::Int32 => Ok(numbers::<Int32Type>(py, parts, f64::from)),
        DataType::Int64 => Ok(numbers::<Int64Type>(py, parts, |value| value as f64)),
        DataType::Boolean if parts.iter().all(|part| part.null_count() == 0) => {
            let flags = parts.iter().flat_map(|part| part.as_boolean().values().iter()).collect();
            Ok(vector::<bool>(py, flags).into_bound(py).into_any())
        }
        DataType::Boolean => objects(py, parts.iter().flat_map(|part| part.as_boolean().iter())),
        DataType::Utf8 => objects(py, parts.iter().flat_map(|part| part.as_string::<i32>().iter())),
        DataType::BinaryView => objects(py, parts.iter().flat_map(|part| part.as_binary_view().iter())),
        DataType::List(item) => {
            let lists: Vec<Option<ArrayRef>> = parts.iter().flat_map(|part| part.as_list::<i32>().iter()).collect();
            let inner =
                |list: Option<ArrayRef>| list.map(|list| array(py, name, item.data_type(), &[list])).transpose();
            objects(py, lists.into_iter().map(inner).collect::<PyResult<Vec<_>>>()?.into_iter())
        }
        DataType::Float32 => Ok(numbers::<Float32Type>(py, parts, f64::from)),
        other => Err(PyValueError::new_err(format!("column {name} holds {other}; read the table through Arrow"))),
    }
}

/// Numbers of their own type; where some are null, 64 bit floats with NaN.
fn numbers<'py, T: ArrowPrimitiveType>(
    py: Python<'py>,
    parts: &[ArrayRef],
    float: fn(T::Native) -> f64,
) -> Bound<'py, PyAny>
where
    T::Native: Element,
{
    let all = parts.iter().map(AsArray::as_primitive::<T>);
    if parts.iter().all(|part| part.null_count() == 0) {
        let values = all.flat_map(|part| part.values().iter().copied()).collect();
        return vector::<T::Native>(py, values).into_bound(py).into_any();
    }
    let values = all.flat_map(|part| part.iter().map(|value| value.map_or(f64::NAN, float)));
    vector::<f64>(py, values.collect()).into_bound(py).into_any()
}

/// Objects one by one: lists of one length would become a matrix else.
fn objects<'py>(py: Python<'py>, values: impl Iterator<Item = impl IntoPyObject<'py>>) -> PyResult<Bound<'py, PyAny>> {
    let objects = values.map(|value| Ok(value.into_pyobject(py).map_err(Into::into)?.into_any().unbind()));
    let objects: Vec<Py<PyAny>> = objects.collect::<PyResult<_>>()?;
    Ok(PyArray1::from_vec(py, objects).into_any())
}
