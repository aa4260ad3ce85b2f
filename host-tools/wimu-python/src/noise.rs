//! `wimu.allan`.

use std::sync::Arc;

use pyo3::prelude::*;
use wimu_host::allan::{AxisNoise, NoiseReport, SensorNoise, noise_of};
use wimu_host::document::ToDocument;
use wimu_model::Sensitivity;

use crate::arrays::{Array1, Array2, column, plain, table};
use crate::failure::{Result, refused, usage};
use crate::recording::Source;

/// Noise of an accelerometer at rest, or of a gyroscope: rad/s wherever m/s² is written here. Arrays of shape (3,) hold X, Y,
/// Z; NaN where a term is not observed.
#[pyclass(frozen, module = "wimu")]
pub struct Noise {
    report: Arc<NoiseReport>,
    sensor: SensorNoise,
}

impl Noise {
    fn term(&self, py: Python<'_>, term: impl Fn(&AxisNoise) -> Option<f64>) -> Array1 {
        column(py, self.sensor.axes.iter().map(|axis| term(axis).unwrap_or(f64::NAN)))
    }
}

#[pymethods]
impl Noise {
    /// Averaging times, s, shape (k,).
    #[getter]
    fn tau(&self, py: Python<'_>) -> Array1 {
        column(py, self.sensor.points.iter().map(|point| point.tau_s))
    }

    /// Allan deviation, m/s², shape (k, 3).
    #[getter]
    fn deviation(&self, py: Python<'_>) -> Result<Array2> {
        table(py, self.sensor.points.iter().map(|point| point.deviation))
    }

    /// Standard deviation of `deviation`, m/s².
    #[getter]
    fn deviation_sd(&self, py: Python<'_>) -> Result<Array2> {
        let points = self.sensor.points.iter();
        table(py, points.map(|point| point.deviation.map(|axis| axis * point.relative_sd)))
    }

    /// One-sided noise density, m/s²/√Hz.
    #[getter]
    fn noise_density(&self, py: Python<'_>) -> Array1 {
        self.term(py, |axis| Some(axis.noise_density.value))
    }

    /// Standard deviation of `noise_density`.
    #[getter]
    fn noise_density_sd(&self, py: Python<'_>) -> Array1 {
        self.term(py, |axis| Some(axis.noise_density.sd))
    }

    /// Velocity random walk, m/s/√s.
    #[getter]
    fn velocity_random_walk(&self, py: Python<'_>) -> Array1 {
        self.term(py, |axis| Some(axis.random_walk.value))
    }

    /// Angle random walk of a gyroscope, rad/s/√Hz.
    #[getter]
    fn angle_random_walk(&self, py: Python<'_>) -> Array1 {
        self.velocity_random_walk(py)
    }

    /// Standard deviation of `angle_random_walk`.
    #[getter]
    fn angle_random_walk_sd(&self, py: Python<'_>) -> Array1 {
        self.term(py, |axis| Some(axis.random_walk.sd))
    }

    /// The noise of the gyroscope beside the accelerometer, or of the gyroscope alone; `None` without one.
    #[getter]
    fn gyroscope(&self) -> Option<Self> {
        let sensor = self.report.gyroscope.clone()?;
        Some(Self { report: self.report.clone(), sensor })
    }

    /// Bias instability, m/s².
    #[getter]
    fn bias_instability(&self, py: Python<'_>) -> Array1 {
        self.term(py, |axis| axis.bias_instability.map(|figure| figure.value))
    }

    /// Standard deviation of `bias_instability`.
    #[getter]
    fn bias_instability_sd(&self, py: Python<'_>) -> Array1 {
        self.term(py, |axis| axis.bias_instability.map(|figure| figure.sd))
    }

    /// Sample rate, Hz.
    #[getter]
    fn rate_hz(&self) -> f64 {
        self.report.rate_hz
    }

    /// What a user should know beside the numbers.
    #[getter]
    fn findings(&self, py: Python<'_>) -> Result<Py<PyAny>> {
        plain(py, &self.report.outcome.findings)
    }

    /// The object that `wimu allan --json` prints.
    fn to_dict(&self, py: Python<'_>) -> Result<Py<PyAny>> {
        plain(py, &*self.report)
    }

    fn __str__(&self) -> String {
        self.report.document().to_string()
    }
}

/// Computes the Allan deviation of an accelerometer at rest, of the gyroscope beside it, or of a gyroscope alone.
#[pyfunction]
#[pyo3(signature = (source, *, sensitivity=None, accelerometer=None))]
pub fn allan(
    py: Python<'_>,
    source: Source,
    sensitivity: Option<f64>,
    accelerometer: Option<u8>,
) -> Result<Noise> {
    let sensitivity = sensitivity.map(Sensitivity::from_lsb_per_g).transpose();
    let sensitivity = sensitivity.map_err(|error| usage(error.to_string(), "check sensitivity"))?;
    let report = py.detach(|| noise_of(&*source.data()?, accelerometer, sensitivity))?;
    let first = report.measured().next().cloned();
    match first {
        Some(sensor) => Ok(Noise { report: Arc::new(report), sensor }),
        None => {
            let remedy = "record longer, with the sensor at rest".to_owned();
            Err(refused(&report.source, report.outcome.reason.as_deref(), remedy))
        }
    }
}
