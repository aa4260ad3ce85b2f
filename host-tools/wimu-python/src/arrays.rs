//! Rust values as Python objects.

use std::ops::Deref;

use numpy::ndarray::Dimension;
use numpy::{AllowTypeChange, PyArray1, PyArray2, PyArray3, PyArrayLike, PyArrayMethods};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use serde::Serialize;
use wimu_host::Code;

use crate::failure::Result;

/// An array of one dimension.
pub type Array1<T = f64> = Py<PyArray1<T>>;
/// An array of two dimensions.
pub type Array2 = Py<PyArray2<f64>>;
/// An array of three dimensions.
pub type Array3 = Py<PyArray3<f64>>;

/// Numbers that were given, as an array or as lists.
pub struct Numbers<'py, D: Dimension>(PyArrayLike<'py, f64, D, AllowTypeChange>);

impl<'py, D: Dimension> Deref for Numbers<'py, D> {
    type Target = PyArrayLike<'py, f64, D, AllowTypeChange>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl<'a, 'py, D: Dimension + 'py> FromPyObject<'a, 'py> for Numbers<'py, D> {
    type Error = PyErr;

    /// Texts and lists of unequal lengths are wrong types, too.
    fn extract(given: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let numbers = given.extract();
        numbers.map(Self).map_err(|error: PyErr| PyTypeError::new_err(error.to_string()))
    }
}

/// An array of one value a row.
pub fn column<T: numpy::Element>(py: Python<'_>, values: impl IntoIterator<Item = T>) -> Array1<T> {
    PyArray1::from_vec(py, values.into_iter().collect()).unbind()
}

/// An array of `N` columns.
pub fn table<const N: usize>(
    py: Python<'_>,
    rows: impl IntoIterator<Item = [f64; N]>,
) -> Result<Array2> {
    let values: Vec<f64> = rows.into_iter().flatten().collect();
    let shape = [values.len() / N, N];
    Ok(PyArray1::from_vec(py, values).reshape(shape)?.unbind())
}

/// An array of one `N` by `N` matrix a row.
pub fn matrices<const N: usize>(
    py: Python<'_>,
    rows: impl IntoIterator<Item = [[f64; N]; N]>,
) -> Result<Array3> {
    let values: Vec<f64> = rows.into_iter().flatten().flatten().collect();
    let shape = [values.len() / (N * N), N, N];
    Ok(PyArray1::from_vec(py, values).reshape(shape)?.unbind())
}

/// Lists and dictionaries with the content of the JSON of `value`.
pub fn plain(py: Python<'_>, value: &impl Serialize) -> Result<Py<PyAny>> {
    let text = serde_json::to_string(value)
        .map_err(|error| Code::FileFailed.error(error.to_string(), "report this fault"))?;
    let loads = py.import("json")?.getattr("loads")?;
    Ok(loads.call1((text,))?.unbind())
}
