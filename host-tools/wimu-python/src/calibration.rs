//! `wimu.calibrate`.

use std::path::PathBuf;
use std::time::SystemTime;

use pyo3::prelude::*;
use wimu_calib::{Estimate, Face};
use wimu_host::calibration::{
    self, CalibrateOptions, CalibrationReport, METHODS, SensorCalibration,
};
use wimu_host::recording::Selection;

use crate::arrays::{Array1, Array2, column, plain, table};
use crate::failure::{Result, refused, usage};
use crate::recording::Source;

/// Sides in the order of [`Face::ALL`].
const SIDES: [&str; 6] = ["x", "-x", "y", "-y", "z", "-z"];

/// An error model with its uncertainty: output = matrix · specific force + bias.
#[pyclass(frozen, module = "wimu")]
pub struct Calibration {
    report: CalibrationReport,
    estimate: Estimate,
    file: calibration::Calibration,
}

#[pymethods]
impl Calibration {
    /// m/s², shape (3,).
    #[getter]
    fn bias(&self, py: Python<'_>) -> Array1 {
        column(py, self.estimate.model.terms().bias_mps2)
    }

    /// Scale factors and misalignments, shape (3, 3).
    #[getter]
    fn matrix(&self, py: Python<'_>) -> Result<Array2> {
        table(py, self.estimate.model.terms().matrix)
    }

    /// Standard deviation of `bias`, m/s².
    #[getter]
    fn bias_sd(&self, py: Python<'_>) -> Array1 {
        column(py, self.estimate.sd().bias_mps2)
    }

    /// Standard deviations of `matrix`.
    #[getter]
    fn matrix_sd(&self, py: Python<'_>) -> Result<Array2> {
        table(py, self.estimate.sd().matrix)
    }

    /// Covariance of `bias`, then of `matrix` row by row, shape (12, 12).
    #[getter]
    fn covariance(&self, py: Python<'_>) -> Result<Array2> {
        table(py, *self.estimate.covariance.matrix())
    }

    /// |f| − g over the poses after correction, m/s² rms.
    #[getter]
    fn rms(&self) -> f64 {
        self.estimate.rms_mps2
    }

    /// Number of static poses.
    #[getter]
    fn poses(&self) -> usize {
        self.report.poses.len()
    }

    /// Nominal sensitivity, LSB/g; None for data in m/s² without a given one.
    #[getter]
    fn sensitivity(&self) -> Option<f64> {
        self.report.sensitivity_lsb_per_g()
    }

    /// What a user should know beside the numbers.
    #[getter]
    fn findings(&self, py: Python<'_>) -> Result<Py<PyAny>> {
        plain(py, &self.report.outcome.findings)
    }

    /// Writes CAL.json.
    fn save(&self, path: PathBuf) -> Result<()> {
        Ok(self.file.write(&path)?)
    }

    /// The object that `wimu calibrate --json` prints.
    fn to_dict(&self, py: Python<'_>) -> Result<Py<PyAny>> {
        plain(py, &self.report)
    }

    fn __str__(&self) -> String {
        self.report.to_string()
    }

    fn __repr__(&self) -> String {
        let (source, poses) = (&self.report.source, self.report.poses.len());
        format!("<wimu.Calibration of {source}: {poses} poses>")
    }
}

/// Estimates the error model of an accelerometer from rests.
#[pyfunction]
#[pyo3(signature = (source, *, method="multi-position", model="", sides=None, gravity=None, sensitivity=None, range_g=None,
                    placement_sd=None, sensor_model=None, accelerometer=None))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments")]
pub fn calibrate(
    py: Python<'_>,
    source: Source,
    method: &str,
    model: &str,
    sides: Option<Vec<String>>,
    gravity: Option<f64>,
    sensitivity: Option<f64>,
    range_g: Option<u8>,
    placement_sd: Option<f64>,
    sensor_model: Option<&str>,
    accelerometer: Option<u8>,
) -> Result<Calibration> {
    let named = METHODS.into_iter().find(|known| known.to_string() == method);
    let method = named.ok_or_else(|| {
        let names = METHODS.map(|known| known.to_string()).join(", ");
        usage(format!("method={method:?} is not known"), format!("the methods are {names}"))
    })?;
    let side = |name: String| {
        let index = SIDES.iter().position(|side| *side == name);
        let remedy = format!("the sides are {}", SIDES.join(", "));
        index
            .map(|index| Face::ALL[index])
            .ok_or_else(|| usage(format!("there is no side {name:?}"), remedy))
    };
    let sides = sides.map(|sides| sides.into_iter().map(side).collect::<Result<Vec<_>>>());
    let model = calibration::parse_model(model, method)?;
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    let options = CalibrateOptions {
        method,
        model,
        sides: sides.transpose()?,
        gravity_mps2: gravity,
        place: None,
        sensitivity_lsb_per_g: sensitivity,
        range_g,
        placement_sd_deg: placement_sd,
        datasheet: sensor_model.map(calibration::datasheet).transpose()?,
        target_mps2: None,
        utc_s: now.ok().map(|since| since.as_secs()),
    };
    let selection = Selection { accelerometer, poses: source.options().poses };
    let report =
        py.detach(|| calibration::calibrate(&source.data()?.samples(selection)?, &options))?;
    let (Some(estimate), Some(file)) = (report.estimate.clone(), report.file.clone()) else {
        let poses = Vec::from_iter(report.next_poses.iter().map(ToString::to_string));
        let remedy = if poses.is_empty() {
            "check the recording".to_owned()
        } else {
            format!("add rests with these directions up: {}", poses.join("; "))
        };
        return Err(refused(&report.source, report.outcome.reason.as_deref(), remedy));
    };
    Ok(Calibration { report, estimate, file })
}

/// A calibration, or the path of a CAL.json.
#[derive(FromPyObject)]
pub enum Correction {
    Calibration(Py<Calibration>),
    Path(PathBuf),
}

impl Correction {
    /// The calibration of the sensor.
    pub fn sensor(&self) -> wimu_host::Result<SensorCalibration> {
        Ok(match self {
            Self::Calibration(held) => held.get().file.sensor().clone(),
            Self::Path(path) => calibration::Calibration::read(path)?.sensor().clone(),
        })
    }
}
