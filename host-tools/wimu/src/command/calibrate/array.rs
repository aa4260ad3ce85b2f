//! `wimu calibrate --geometry`: all accelerometers of an array at once.

use std::path::Path;

use serde::Serialize;
use wimu_calib::Gravity;
use wimu_host::array::{ArrayGeometry, CalibratedArray, calibrate_array};
use wimu_host::{ErrorCode, HostError, Result};
use wimu_model::ErrorModel;

use crate::arguments::{Calibrate, Calibrated, Method};
use crate::command::array::{self, Refined, SENSITIVITY};
use crate::command::not_over_input;
use crate::output::Output;

#[derive(Serialize)]
struct Object {
    schema: &'static str,
    status: &'static str,
    source: String,
    gravity_m_s2: f64,
    rests: usize,
    /// What the sensors differ by at the rests after all, rms an axis.
    disagreement_m_s2: f64,
    sensors: Vec<Sensor>,
    /// Places and delays; null where the recording does not tell them.
    refined: Option<Refined>,
    remarks: Vec<String>,
}

#[derive(Serialize)]
struct Sensor {
    /// In its own axes, its turn against the others included; null where it is left out.
    model: Option<ErrorModel>,
    poses: usize,
    rms_mm_s2: Option<f64>,
    loo_rms_mm_s2: Option<f64>,
}

/// Refuses what goes with one sensor only.
fn only_of_arrays(arguments: &Calibrate) -> Result<()> {
    let others = [
        ("--method", arguments.method != Method::MultiPosition),
        ("--sensor", arguments.sensor != Calibrated::Accelerometer),
        ("--model", arguments.model.is_some()),
        ("--with", arguments.with.is_some()),
        ("--sensor-model", arguments.sensor_model.is_some()),
        ("--range", arguments.range.is_some()),
        ("--poses", arguments.poses),
        ("--where", arguments.filter.is_some()),
        ("--accelerometer", arguments.accelerometer.is_some()),
        ("--reference", arguments.reference.is_some()),
        ("--noise-ratio", arguments.noise_ratio.is_some()),
        ("--placement-sd", arguments.placement_sd.is_some()),
        ("--sides", arguments.sides.is_some()),
        ("--report", arguments.report.is_some()),
        ("--count", arguments.count.is_some()),
        ("--dip", arguments.dip.is_some()),
        ("--push", arguments.push),
    ];
    let numbers = [
        ("--place-sd", arguments.place_sd),
        ("--delay-sd", arguments.delay_sd),
        ("--sensitivity", arguments.sensitivity),
    ];
    if let Some((flag, _)) = others.into_iter().find(|(_, given)| *given) {
        return Err(HostError::new(
            ErrorCode::Usage,
            format!("{flag} does not go with --geometry"),
            "leave it out, or calibrate one sensor by itself with --accelerometer N",
        ));
    }
    let wrong = |value: Option<f64>| value.is_some_and(|v| !(v > 0.0 && v.is_finite()));
    match numbers.into_iter().find(|(_, value)| wrong(*value)) {
        Some((flag, _)) => Err(HostError::new(
            ErrorCode::Usage,
            format!("{flag} must be a positive number"),
            "for example --place-sd 0.5 --delay-sd 300 --sensitivity 2048",
        )),
        None => Ok(()),
    }
}

/// Calibrates an array.
pub fn run(arguments: &Calibrate, geometry: &Path, output: Output) -> Result<()> {
    only_of_arrays(arguments)?;
    let input = Path::new(&arguments.input);
    for read in [input, geometry]
        .into_iter()
        .chain(arguments.boards.iter().map(AsRef::as_ref))
    {
        not_over_input(read, arguments.output.as_deref())?;
    }
    let geometry = ArrayGeometry::read(geometry)?;
    let options = array::known(arguments.place_sd, arguments.delay_sd, &geometry);
    let sensitivity = arguments.sensitivity.unwrap_or(SENSITIVITY);
    let recording = array::read(input, &arguments.boards, sensitivity, arguments.link, true)?;
    let gravity = match arguments.gravity {
        Some(mps2) => Gravity::new(mps2, 0.0).map_err(|error| {
            HostError::new(ErrorCode::Usage, error.to_string(), "check --gravity")
        })?,
        None => Gravity::UNKNOWN_PLACE,
    };
    let found = calibrate_array(&recording, &geometry, gravity, &options)?;
    let object = said(&found, arguments, gravity, output);
    if let Some(file) = &arguments.output {
        found.geometry.write(file)?;
        output.say(format!(
            "{}: written; `wimu navigate … --geometry {}` takes it",
            file.display(),
            file.display()
        ));
    }
    output.object(&object);
    Ok(())
}

fn said(
    found: &CalibratedArray,
    arguments: &Calibrate,
    gravity: Gravity,
    output: Output,
) -> Object {
    let calibration = &found.calibration;
    output.say(format!(
        "{}: {} sensors, {} rests, g = {:.5} m/s²",
        arguments.input,
        found.geometry.sensors.len(),
        calibration.rests.len(),
        gravity.mps2()
    ));
    let mut sensors = Vec::new();
    for (k, sensor) in found.geometry.sensors.iter().enumerate() {
        let estimate = calibration.estimates[k].as_ref();
        let mm = |mps2: f64| mps2 * 1e3;
        if let (Some(model), Some(estimate)) = (&sensor.model, estimate) {
            let terms = model.terms();
            let [x, y, z] = terms.bias_mps2;
            let [a, b, c] = [0, 1, 2].map(|i| terms.matrix[i][i]);
            let left_out = match estimate.loo_rms_mps2 {
                Some(loo) => format!(", {:.2} left out one at a time", mm(loo)),
                None => String::new(),
            };
            output.say(format!(
                "sensor {k}: bias {x:+.4} {y:+.4} {z:+.4} m/s², scale factors {a:.5} {b:.5} {c:.5}; |f| − g {:.2} mm/s² \
                 rms{left_out}",
                mm(estimate.rms_mps2)
            ));
        }
        sensors.push(Sensor {
            model: sensor.model,
            poses: estimate.map_or(0, |e| e.poses),
            rms_mm_s2: estimate.map(|e| mm(e.rms_mps2)),
            loo_rms_mm_s2: estimate.and_then(|e| e.loo_rms_mps2).map(mm),
        });
    }
    output.say(format!(
        "turned to agree, they differ by {:.4} m/s² rms at the rests",
        calibration.disagreement_mps2
    ));
    let mut remarks = calibration.remarks();
    remarks.extend(found.remarks.iter().cloned());
    let refined = match &found.refinement {
        Ok(refinement) => Some(Refined::of(refinement, output)),
        Err(why) => {
            remarks.push(format!(
                "places and delays stay as given: {}",
                why.message()
            ));
            None
        }
    };
    for remark in &remarks {
        output.say(format!("note: {remark}"));
    }
    Object {
        schema: "wimu.array-calibration/1",
        status: "ok",
        source: arguments.input.clone(),
        gravity_m_s2: gravity.mps2(),
        rests: calibration.rests.len(),
        disagreement_m_s2: calibration.disagreement_mps2,
        sensors,
        refined,
        remarks,
    }
}
