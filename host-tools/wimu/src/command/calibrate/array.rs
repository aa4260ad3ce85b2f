//! `wimu calibrate --setup`: all accelerometers of an array at once.

use std::path::Path;

use serde::Serialize;
use serde_json::{Value, json};
use wimu_calib::Gravity;
use wimu_host::array::{Array, ArrayGeometry, CalibratedArray, Refinement, calibrate_array};
use wimu_host::calibration::CalibrateOptions;
use wimu_host::digits::{signed_with_sd, with_sd};
use wimu_host::{Code, Problem, Result};

use crate::arguments::Calibrate;
use crate::command::array;
use crate::output::{Output, usage};

/// Calibrates an array.
pub fn run(arguments: &Calibrate, geometry: &Path, output: &Output) -> Result<()> {
    if !arguments.more.is_empty() {
        let message = "several recordings are given for one array";
        return Err(usage(message, "give one with all its accelerometers"));
    }
    let input = Path::new(&arguments.input);
    let geometry = ArrayGeometry::read(geometry)?;
    let options = array::prior(None, None, &geometry);
    let recording = Array::read(input, &arguments.reading.options(false), arguments.sensitivity)?;
    let given = CalibrateOptions {
        gravity_mps2: arguments.gravity,
        place: arguments.latitude,
        ..CalibrateOptions::default()
    };
    let (gravity, _) = given.gravity()?;
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
    // `refined` is null where the recording does not observe positions and delays.
    json!({
        "source": arguments.input,
        "gravity_m_s2": gravity.mps2(),
        "rests": calibration.rests.len(),
        "disagreement_m_s2": calibration.disagreement_mps2,
        "sensors": sensors,
        "refined": refined,
    })
}

/// Positions and delays estimated from a recording.
#[derive(Serialize)]
struct Refined {
    samples: usize,
    residual_before_mps2: f64,
    residual_after_mps2: f64,
    /// Whether the reduction of χ² is more than the number of parameters and errors of the models explain.
    accepted: bool,
    /// That reduction over the least one that is accepted.
    gain: f64,
    sensors: Vec<RefinedSensor>,
}

/// One sensor: correction of the position of each axis, and its delay.
#[derive(Serialize)]
struct RefinedSensor {
    moved_mm: [[f64; 3]; 3],
    moved_sd_mm: [[f64; 3]; 3],
    delay_us: f64,
    delay_sd_us: f64,
}

impl Refined {
    /// Prints the result; returns its object.
    fn of(found: &Refinement, output: &Output) -> Self {
        output.print(format!(
            "positions and delays from {} samples: residual {:.3} → {:.3} m/s² rms",
            found.samples, found.residual_mps2[0], found.residual_mps2[1]
        ));
        output.print(format!(
            "{}: χ² falls by {:.1} times the least reduction that is accepted",
            if found.accepted { "accepted" } else { "rejected (the given geometry is kept)" },
            found.gain
        ));
        let mm = |all: &[[f64; 3]; 3]| all.map(|position| position.map(|v| v * 1e3));
        let sensors: Vec<RefinedSensor> = (0..found.delay_s.len())
            .map(|k| RefinedSensor {
                moved_mm: mm(&found.moved_m[k]),
                moved_sd_mm: mm(&found.place_sd_m[k]),
                delay_us: found.delay_s[k] * 1e6,
                delay_sd_us: found.delay_sd_s[k] * 1e6,
            })
            .collect();
        for (k, sensor) in sensors.iter().enumerate().filter(|_| found.accepted) {
            let axes = ["X", "Y", "Z"].iter().zip(&sensor.moved_mm);
            let moved: Vec<String> =
                axes.map(|(name, [x, y, z])| format!("{name} {x:+.2} {y:+.2} {z:+.2}")).collect();
            let sds = sensor.moved_sd_mm.iter().flatten();
            output.print(format!(
                "sensor {k}: axes moved by {} mm (± {:.2} at most), delay {:.0} ± {:.0} µs",
                moved.join(", "),
                sds.copied().fold(0.0, f64::max),
                sensor.delay_us,
                sensor.delay_sd_us
            ));
        }
        Self {
            samples: found.samples,
            residual_before_mps2: found.residual_mps2[0],
            residual_after_mps2: found.residual_mps2[1],
            accepted: found.accepted,
            gain: found.gain,
            sensors,
        }
    }
}
