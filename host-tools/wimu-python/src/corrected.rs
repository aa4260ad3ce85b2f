//! `wimu.apply`.

use std::path::PathBuf;

use pyo3::prelude::*;
use wimu_host::{Problem, apply as correction};

use crate::arrays::{Array1, Array2, column, plain, table};
use crate::calibration::Correction;
use crate::failure::Result;
use crate::recording::Source;

/// Corrected samples, body axes: the valid rows of the recording. NaN where a row has no value.
#[pyclass(frozen, get_all, module = "wimu")]
pub struct Corrected {
    times: Array1,
    specific_force: Array2,
    angular_rate: Option<Array2>,
    magnetic_field: Option<Array2>,
    temperature: Option<Array1>,
    findings: Py<PyAny>,
}

/// Corrects a recording with a calibration, and writes it to `output` if that is given.
#[pyfunction]
#[pyo3(signature = (calibration, source, *, output=None))]
pub fn apply(
    py: Python<'_>,
    calibration: Correction,
    source: Source,
    output: Option<PathBuf>,
) -> Result<Corrected> {
    let (rows, fields_ut, findings) = py.detach(|| {
        let data = source.data()?;
        let sensor = calibration.sensor()?;
        let applied = correction::CorrectedRecording::new(&sensor, &data)?;
        if let Some(path) = output {
            applied.write(&path)?;
        }
        let rows: Vec<correction::Corrected> = applied.rows().collect();
        let fields_ut: Vec<_> = rows.iter().map(|row| applied.field_ut(row)).collect();
        let findings = [&applied.findings[..], &data.findings].concat();
        Ok::<_, Problem>((rows, fields_ut, findings))
    })?;
    let vectors = |all: Vec<Option<[f64; 3]>>| {
        let any = all.iter().any(Option::is_some);
        let filled = all.into_iter().map(|vector| vector.unwrap_or([f64::NAN; 3]));
        any.then(|| table(py, filled)).transpose()
    };
    let tesla = |field: &Option<[f64; 3]>| field.map(|ut| ut.map(|axis| axis * 1e-6));
    let has_temperature = rows.iter().any(|row| row.temperature_c.is_some());
    let celsius = rows.iter().map(|row| row.temperature_c.unwrap_or(f64::NAN));
    Ok(Corrected {
        times: column(py, rows.iter().map(|row| row.time_ns as f64 * 1e-9)),
        specific_force: table(py, rows.iter().map(|row| row.force_mps2))?,
        angular_rate: vectors(rows.iter().map(|row| row.rate_rad_s).collect())?,
        magnetic_field: vectors(fields_ut.iter().map(tesla).collect())?,
        temperature: has_temperature.then(|| column(py, celsius)),
        findings: plain(py, &findings)?,
    })
}
