//! Noise of a calibration for Kalibr.

use std::path::Path;

use serde_json::Value;

use crate::{Code, Problem, Result};

/// Noise for Kalibr, from `wimu allan`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KalibrNoise {
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Of the accelerometer, and of the gyroscope, where they were measured.
    pub sensors: [Option<KalibrTerms>; 2],
}

/// Noise of the noisiest axis of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KalibrTerms {
    /// Velocity or angle random walk N, m/s/√s or rad/√s.
    pub density: f64,
    /// Acceleration or rate random walk K, m/s²/√s or rad/s/√s; above 0.
    pub random_walk: f64,
    /// Whether it was observed; else it is an upper bound.
    pub random_walk_seen: bool,
    /// Whether the counts of an axis are coarser than its noise: then the density is that of the quantisation.
    pub coarse: bool,
}

impl KalibrTerms {
    /// The noisiest of the axes of a sensor. For a random walk that was not observed, the upper bound is taken, because Kalibr
    /// needs a number above 0: alone it would be σ(τ) = K √(τ/3) at the lowest σ.
    fn of(sensor: &Value) -> Option<Self> {
        let axes = sensor["axes"].as_array()?;
        let walk = |axis: &Value| {
            let seen = axis["bias_random_walk"]["value"].as_f64();
            let (floor, tau) = (axis["floor"].as_f64()?, axis["floor_tau_s"].as_f64()?);
            let most = floor * (3.0 / tau).sqrt();
            Some((seen.unwrap_or(most), seen.is_some()))
        };
        let (random_walk, random_walk_seen) = axes
            .iter()
            .filter_map(walk)
            .filter(|(walk, _)| walk.is_finite() && *walk > 0.0)
            .max_by(|a, b| a.0.total_cmp(&b.0))?;
        let densities = axes.iter().filter_map(|axis| axis["random_walk"]["value"].as_f64());
        Some(Self {
            density: densities.reduce(f64::max)?,
            random_walk,
            random_walk_seen,
            coarse: axes.iter().any(|axis| axis["is_coarse"] == true),
        })
    }
}

impl KalibrNoise {
    /// Reads the output of `wimu allan --json`.
    ///
    /// # Errors
    /// `file_unreadable`; `bad_calibration` when it is not such a report, or was refused.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|e| Problem::file(&name, "read", &e))?;
        let bad = || {
            Code::BadCalibration
                .error(
                    "this is not a noise report",
                    "make it with `wimu allan --json rest.mcap > NOISE.json`",
                )
                .at(&name)
        };
        let envelope: Value = serde_json::from_str(&text).map_err(|_| bad())?;
        if envelope["command"] != "allan" {
            return Err(bad());
        }
        let report = &envelope["data"];
        let sensors = [&report["accelerometer"], &report["gyroscope"]].map(KalibrTerms::of);
        if sensors == [None; 2] {
            return Err(bad());
        }
        Ok(Self { rate_hz: report["rate_hz"].as_f64().ok_or_else(bad)?, sensors })
    }
}

/// The lines of Kalibr's file.
pub(super) fn text(noise: Option<KalibrNoise>) -> String {
    let mut lines = match noise {
        Some(noise) => vec![format!("update_rate: {:?}", noise.rate_hz)],
        None => vec![
            "# Give the JSON of `wimu allan --json` with --noise.".to_owned(),
            "# update_rate:".to_owned(),
        ],
    };
    let sensors = noise.map_or([None; 2], |noise| noise.sensors);
    let names = [("accelerometer", "m/s^2", "velocity"), ("gyroscope", "rad/s", "angle")];
    for ((sensor, unit, walk), terms) in names.into_iter().zip(sensors) {
        let Some(KalibrTerms { density, random_walk, random_walk_seen, coarse }) = terms else {
            lines.push(format!(
                "# Not measured: add them.\n# {sensor}_noise_density:\n# {sensor}_random_walk:"
            ));
            continue;
        };
        if coarse {
            let text = "# Counts are coarser than the noise: this is the noise of the quantisation, not of the sensor.";
            lines.push(text.to_owned());
        }
        lines.push(format!(
            "# {unit}/sqrt(Hz) in Kalibr's convention: the {walk} random walk\n{sensor}_noise_density: {density:?}"
        ));
        if !random_walk_seen {
            lines.push(format!("# Not observed in the recording: upper bound, {unit}/sqrt(s)."));
        }
        lines.push(format!("{sensor}_random_walk: {random_walk:?}"));
    }
    lines.join("\n")
}
