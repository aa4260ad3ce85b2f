//! `wimu navigate --geometry`: several accelerometers on one body, in one table or on several boards.

use std::path::{Path, PathBuf};

use serde::Serialize;
use wimu_calib::Gravity;
use wimu_host::array::{
    ArrayCalibration, ArrayGeometry, ArrayRecording, Board, BoardOptions, RefineOptions, refine,
};
use wimu_host::inertial::{Choice, InertialPath, navigate_array};
use wimu_host::{ErrorCode, HostError, Result};

use crate::arguments::Navigate;
use crate::command::not_over_input;
use crate::output::Output;

/// What the recording said about places and delays; null where they were not asked for.
#[derive(Serialize)]
pub struct Refined {
    file: String,
    samples: usize,
    residual_before_mps2: f64,
    residual_after_mps2: f64,
    sensors: Vec<RefinedSensor>,
}

/// One sensor: by how much each coordinate of each axis's place was moved, and its delay.
#[derive(Serialize)]
struct RefinedSensor {
    moved_mm: [[f64; 3]; 3],
    moved_sd_mm: [[f64; 3]; 3],
    delay_us: f64,
    delay_sd_us: f64,
}

/// Navigates an array.
pub fn path(
    arguments: &Navigate,
    geometry: &Path,
    choice: &Choice,
    output: Output,
) -> Result<(InertialPath, Option<Refined>)> {
    for written in [&arguments.refine, &arguments.output, &arguments.report] {
        for board in &arguments.boards {
            not_over_input(board, written.as_deref())?;
        }
        not_over_input(geometry, written.as_deref())?;
    }
    not_over_input(&arguments.input, arguments.refine.as_deref())?;
    let positive = |value: f64| value > 0.0 && value.is_finite();
    if !(positive(arguments.place_sd) && positive(arguments.delay_sd)) {
        return Err(HostError::new(
            ErrorCode::Usage,
            "--place-sd and --delay-sd must be positive numbers",
            "for example --place-sd 0.5 --delay-sd 300",
        ));
    }
    let mut geometry = ArrayGeometry::read(geometry)?;
    let read = read(arguments)?;
    let mut recording = read.clone().arranged(&geometry)?;
    let mut calibration = ArrayCalibration::of(&recording, &geometry, Gravity::UNKNOWN_PLACE)?;
    calibration.place_sd_m = arguments.place_sd * 1e-3;
    calibration.delay_sd_s = arguments.delay_sd * 1e-6;
    let mut refined = None;
    if let Some(file) = &arguments.refine {
        let options = RefineOptions {
            place_sd_m: arguments.place_sd * 1e-3,
            delay_sd_s: arguments.delay_sd * 1e-6,
        };
        let found = refine(&recording, &geometry, &calibration, &options)?;
        found.geometry.write(file)?;
        output.say(format!(
            "{}: places and delays from {} samples; what no motion explains falls from {:.3} to {:.3} m/s²",
            file.display(),
            found.samples,
            found.residual_mps2[0],
            found.residual_mps2[1]
        ));
        let mm = |all: &[[f64; 3]; 3]| all.map(|place| place.map(|v| v * 1e3));
        let sensors: Vec<RefinedSensor> = (0..found.delay_s.len())
            .map(|k| RefinedSensor {
                moved_mm: mm(&found.moved_m[k]),
                moved_sd_mm: mm(&found.place_sd_m[k]),
                delay_us: found.delay_s[k] * 1e6,
                delay_sd_us: found.delay_sd_s[k] * 1e6,
            })
            .collect();
        for (k, sensor) in sensors.iter().enumerate() {
            let axes = ["X", "Y", "Z"].iter().zip(&sensor.moved_mm);
            let moved: Vec<String> = axes
                .map(|(name, [x, y, z])| format!("{name} {x:+.2} {y:+.2} {z:+.2}"))
                .collect();
            let sds = sensor.moved_sd_mm.iter().flatten();
            output.say(format!(
                "sensor {k}: axes moved by {} mm (± {:.2} at most), later by {:.0} ± {:.0} µs",
                moved.join(", "),
                sds.copied().fold(0.0, f64::max),
                sensor.delay_us,
                sensor.delay_sd_us
            ));
        }
        refined = Some(Refined {
            file: file.display().to_string(),
            samples: found.samples,
            residual_before_mps2: found.residual_mps2[0],
            residual_after_mps2: found.residual_mps2[1],
            sensors,
        });
        geometry = found.geometry;
        recording = read.arranged(&geometry)?;
        calibration = ArrayCalibration::of(&recording, &geometry, Gravity::UNKNOWN_PLACE)?;
        // What was found is known as well as it was found.
        let all = found.place_sd_m.iter().flatten().flatten();
        calibration.place_sd_m = root_mean_square(all.copied());
        calibration.delay_sd_s = root_mean_square(found.delay_sd_s.iter().copied());
    }
    let path = navigate_array(&recording, &geometry, &calibration, choice)?;
    Ok((path, refined))
}

/// Root of the mean square.
fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (squares, count) = values.fold((0.0, 0.0), |(sum, n), v| (sum + v * v, n + 1.0));
    f64::sqrt(squares / f64::max(count, 1.0))
}

fn read(arguments: &Navigate) -> Result<ArrayRecording> {
    let table = |path: &Path| {
        path.extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("csv"))
    };
    if arguments.boards.is_empty() && table(&arguments.input) {
        return ArrayRecording::from_csv(&arguments.input, arguments.sensitivity);
    }
    let options = BoardOptions {
        sensitivity_lsb_per_g: arguments.sensitivity,
        link: arguments.link.map(Into::into),
    };
    let mut paths: Vec<PathBuf> = vec![arguments.input.clone()];
    paths.extend(arguments.boards.iter().cloned());
    ArrayRecording::from_boards(&Board::read_all(&paths, &options)?)
}
