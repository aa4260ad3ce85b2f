//! Shared code of the commands for an array of accelerometers on one body.

use std::path::{Path, PathBuf};

use serde::Serialize;
use wimu_host::Result;
use wimu_host::array::{Array, ArrayGeometry, RefineOptions, Refinement, UnitOptions};
use wimu_link::LinkRole;

use crate::output::Output;

/// Default sensitivity of counts, LSB/g (16 bits at ± 16 g).
pub const SENSITIVITY_LSB_PER_G: f64 = 2048.0;

/// Uncertainty of positions and delays: that of the options, of the geometry, or the default.
pub fn prior(
    place_sd_mm: Option<f64>,
    delay_sd_us: Option<f64>,
    geometry: &ArrayGeometry,
) -> RefineOptions {
    let default = RefineOptions::default();
    let place = place_sd_mm.or(geometry.place_sd_mm).map(|mm| mm * 1e-3);
    let delay = delay_sd_us.or(geometry.delay_sd_us).map(|us| us * 1e-6);
    RefineOptions {
        place_sd_m: place.unwrap_or(default.place_sd_m),
        delay_sd_s: delay.unwrap_or(default.delay_sd_s),
    }
}

/// Reads the recording of an array: one table of all sensors, or one file per board.
pub fn read(
    input: &Path,
    boards: &[PathBuf],
    sensitivity_lsb_per_g: Option<f64>,
    link: Option<LinkRole>,
    raw: bool,
) -> Result<Array> {
    let sensitivity_lsb_per_g = sensitivity_lsb_per_g.unwrap_or(SENSITIVITY_LSB_PER_G);
    let options = UnitOptions { sensitivity_lsb_per_g, link, raw };
    let paths = std::iter::once(input).chain(boards.iter().map(PathBuf::as_path));
    Array::read(&paths.collect::<Vec<_>>(), &options)
}

/// Positions and delays estimated from a recording.
#[derive(Serialize)]
pub struct Refined {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
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
    pub fn of(found: &Refinement, output: &Output) -> Self {
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
            file: None,
            samples: found.samples,
            residual_before_mps2: found.residual_mps2[0],
            residual_after_mps2: found.residual_mps2[1],
            accepted: found.accepted,
            gain: found.gain,
            sensors,
        }
    }
}
