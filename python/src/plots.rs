//! Pictures: Python draws them, with matplotlib where it is installed.

use pyo3::PyClass;
use pyo3::prelude::*;

/// Has `periscope.plots` draw an object.
pub fn plot<'py, T: PyClass>(
    object: &Bound<'py, T>,
    kind: &str,
    ax: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    object.py().import("periscope.plots")?.call_method1(kind, (object, ax))
}
