//! `wimu calibrate --setup`: all accelerometers of an array at once.

use std::path::Path;

use serde_json::{Value, json};
use wimu_calib::Gravity;
use wimu_host::array::{Array, ArrayGeometry, CalibratedArray, calibrate_array};
use wimu_host::calibration::CalibrateOptions;
use wimu_host::digits::{signed_with_sd, with_sd};
use wimu_host::{Code, Problem, Result};

use crate::arguments::Calibrate;
use crate::output::{Output, usage};

/// Calibrates an array.
pub fn run(arguments: &Calibrate, geometry: &Path, output: &Output) -> Result<()> {
    if !arguments.more.is_empty() {
        let message = "several recordings are given for one array";
        return Err(usage(message, "give one with all its accelerometers"));
    }
    let input = Path::new(&arguments.input);
    let geometry = ArrayGeometry::read(geometry)?;
    let recording = Array::read(input, &arguments.reading.options(false), arguments.sensitivity)?;
    let given = CalibrateOptions {
        gravity_mps2: arguments.gravity,
        place: arguments.latitude,
        ..CalibrateOptions::default()
    };
    let (gravity, _) = given.gravity()?;
    let found = calibrate_array(&recording, &geometry, gravity)?;
    let calibrated = present(&found, arguments, gravity, output);
    if let Some(file) = &arguments.output {
        found.geometry.write(file)?;
        output.print(format!(
            "wrote {}, for `wimu navigate … --setup geometry={}`",
            file.display(),
            file.display()
        ));
    }
    output.object(&calibrated);
    Ok(())
}

/// Prints the result; returns its object.
fn present(
    found: &CalibratedArray,
    arguments: &Calibrate,
    gravity: Gravity,
    output: &Output,
) -> Value {
    let calibration = &found.calibration;
    output.print(format!(
        "{}: {} sensors, {} rests, g = {:.5} m/s²",
        arguments.input,
        found.geometry.sensors.len(),
        calibration.rests.len(),
        gravity.mps2()
    ));
    let mut sensors = Vec::new();
    for (k, sensor) in found.geometry.sensors.iter().enumerate() {
        let fit = calibration.fits[k].as_ref();
        let mm = |mps2: f64| mps2 * 1e3;
        if let (Some(model), Some(fit)) = (&sensor.model, fit) {
            let terms = model.terms();
            let [x, y, z] =
                [0, 1, 2].map(|i| signed_with_sd(terms.bias_mps2[i], fit.bias_sd_mps2[i]));
            let [a, b, c] = [0, 1, 2].map(|i| with_sd(terms.matrix[i][i], fit.matrix_sd[i][i]));
            output.print(format!(
                "sensor {k}: bias {x}, {y}, {z} m/s², scale factors {a}, {b}, {c} (1 σ); |f| − g {:.2} mm/s² \
                 rms",
                mm(fit.rms_mps2)
            ));
        }
        // A sensor that is left out has no model; the models are in the array's axes.
        sensors.push(json!({
            "model": sensor.model,
            "rests": fit.map_or(0, |fit| fit.rests),
            "rms_mm_s2": fit.map(|fit| mm(fit.rms_mps2)),
        }));
    }
    output.print(format!(
        "corrected sensors differ by {:.4} m/s² rms per axis at the rests",
        calibration.disagreement_mps2
    ));
    let remarks = calibration.remarks().into_iter().map(|text| Code::Geometry.note(text));
    let findings: Vec<Problem> = remarks.chain(found.findings.iter().cloned()).collect();
    output.findings(&findings);
    json!({
        "source": arguments.input,
        "gravity_m_s2": gravity.mps2(),
        "rests": calibration.rests.len(),
        "disagreement_m_s2": calibration.disagreement_mps2,
        "sensors": sensors,
    })
}
