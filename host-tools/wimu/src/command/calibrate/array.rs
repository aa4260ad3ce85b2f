//! `wimu calibrate --setup`: all accelerometers of an array at once.

use std::path::Path;

use serde::Serialize;
use wimu_calib::Gravity;
use wimu_host::array::{ArrayGeometry, CalibratedArray, calibrate_array};
use wimu_host::digits::{signed_with_sd, with_sd};
use wimu_host::{Code, Problem, Result};
use wimu_model::ErrorModel;

use crate::arguments::Calibrate;
use crate::command::array::{self, Refined};
use crate::command::not_over_input;
use crate::output::{Output, usage};

#[derive(Serialize)]
struct Calibrated {
    source: String,
    gravity_m_s2: f64,
    rests: usize,
    /// Difference of the corrected sensors at the rests, rms per axis.
    disagreement_m_s2: f64,
    sensors: Vec<Sensor>,
    /// Positions and delays; null where the recording does not observe them.
    refined: Option<Refined>,
}

#[derive(Serialize)]
struct Sensor {
    /// In the array's axes; null for a sensor that is left out.
    model: Option<ErrorModel>,
    rests: usize,
    /// |f| − g at the rests.
    rms_mm_s2: Option<f64>,
}

/// Calibrates an array.
pub fn run(arguments: &Calibrate, geometry: &Path, output: &Output) -> Result<()> {
    let input = Path::new(&arguments.input);
    for read in [input, geometry].into_iter().chain(arguments.more.iter().map(AsRef::as_ref)) {
        not_over_input(read, arguments.output.as_deref())?;
    }
    let geometry = ArrayGeometry::read(geometry)?;
    let options = array::prior(None, None, &geometry);
    let recording =
        array::read(input, &arguments.more, arguments.sensitivity, arguments.reading.role(), true)?;
    let gravity = match (arguments.gravity, arguments.latitude) {
        (Some(mps2), _) => Gravity::new(mps2, 0.0),
        (None, Some([latitude, height])) => Gravity::at(latitude, height),
        (None, None) => Ok(Gravity::UNKNOWN_PLACE),
    };
    let gravity = gravity.map_err(|e| usage(e.to_string(), "check --gravity"))?;
    let found = calibrate_array(&recording, &geometry, gravity, &options)?;
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
) -> Calibrated {
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
        sensors.push(Sensor {
            model: sensor.model,
            rests: fit.map_or(0, |fit| fit.rests),
            rms_mm_s2: fit.map(|fit| mm(fit.rms_mps2)),
        });
    }
    output.print(format!(
        "corrected sensors differ by {:.4} m/s² rms per axis at the rests",
        calibration.disagreement_mps2
    ));
    let remarks = calibration.remarks().into_iter().map(|text| Code::Geometry.note(text));
    let mut findings: Vec<Problem> = remarks.chain(found.findings.iter().cloned()).collect();
    let refined = match &found.refinement {
        Ok(refinement) => Some(Refined::of(refinement, output)),
        Err(why) => {
            let text = format!("positions and delays are kept as given: {}", why.text);
            findings.push(Code::Geometry.warning(text));
            None
        }
    };
    output.findings(&findings);
    Calibrated {
        source: arguments.input.clone(),
        gravity_m_s2: gravity.mps2(),
        rests: calibration.rests.len(),
        disagreement_m_s2: calibration.disagreement_mps2,
        sensors,
        refined,
    }
}
