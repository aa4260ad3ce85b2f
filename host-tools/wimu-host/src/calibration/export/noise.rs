//! Noise of a calibration for Kalibr.

use std::path::Path;

use serde_json::Value;

use crate::{Code, Problem, Result};

/// Noise for Kalibr: the report of `wimu allan`.
#[derive(Clone, Debug)]
pub struct KalibrNoise(Value);

impl KalibrNoise {
    /// Reads the output of `wimu allan --json`.
    ///
    /// # Errors
    /// `file_unreadable`; `bad_calibration` when it is not such a report, or was refused.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|e| Problem::file(&name, "read", &e))?;
        Self::parse(&text).ok_or_else(|| {
            let remedy = "make it with `wimu allan --json rest.mcap > NOISE.json`";
            Code::BadCalibration.error("this is not a noise report", remedy).at(name)
        })
    }

    /// The report in the output of `wimu allan --json`; `None` for other text, or without a measured random walk.
    pub fn parse(text: &str) -> Option<Self> {
        let mut envelope: Value = serde_json::from_str(text).ok()?;
        let noise = Self(envelope["data"].take());
        let is_known = noise.0["rate_hz"].is_f64()
            && ["accelerometer", "gyroscope"].iter().any(|name| noise.of(name).is_some());
        (envelope["command"] == "allan" && is_known).then_some(noise)
    }

    /// Random walk of the noisiest axis of a sensor, and random walk of its bias, both above 0. For one that was not observed
    /// the upper bound is taken: alone it would be σ(τ) = K √(τ/3) at the lowest σ.
    fn of(&self, sensor: &str) -> Option<[f64; 2]> {
        let axes = self.0[sensor]["axes"].as_array()?;
        let bound = |axis: &Value| {
            let (floor, tau_s) = (axis["floor"].as_f64()?, axis["floor_tau_s"].as_f64()?);
            Some(floor * (3.0 / tau_s).sqrt())
        };
        let walk = |axis: &Value| axis["bias_random_walk"]["value"].as_f64().or(bound(axis));
        let walks = axes.iter().filter_map(walk).filter(|walk| walk.is_finite() && *walk > 0.0);
        let densities = axes.iter().filter_map(|axis| axis["random_walk"]["value"].as_f64());
        Some([densities.reduce(f64::max)?, walks.reduce(f64::max)?])
    }
}

/// The lines of Kalibr's file.
pub(super) fn text(noise: Option<&KalibrNoise>) -> String {
    let rate = match noise {
        Some(noise) => format!("update_rate: {}", noise.0["rate_hz"]),
        None => "# Give the JSON of `wimu allan --json` with --noise.\n# update_rate:".to_owned(),
    };
    let sensors = [("accelerometer", "m/s^2"), ("gyroscope", "rad/s")].map(|(sensor, unit)| {
        let Some([density, walk]) = noise.and_then(|noise| noise.of(sensor)) else {
            return format!(
                "# Not measured: add them.\n# {sensor}_noise_density:\n# {sensor}_random_walk:"
            );
        };
        format!(
            "# {unit}/sqrt(Hz), and {unit}/sqrt(s): an upper bound where it was not observed\n\
             {sensor}_noise_density: {density:?}\n{sensor}_random_walk: {walk:?}"
        )
    });
    [&[rate][..], &sensors].concat().join("\n")
}
