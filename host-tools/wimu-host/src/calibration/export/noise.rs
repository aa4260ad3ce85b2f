//! Noise of a calibration for Kalibr.

use std::path::Path;

use serde_json::Value;

use crate::error::{ErrorCode, HostError, Result};

/// Noise of the accelerometer for Kalibr, from `wimu allan`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KalibrNoise {
    /// Velocity random walk N, m/s/√s.
    pub density: f64,
    /// Acceleration random walk K, m/s²/√s; above 0.
    pub random_walk: f64,
    /// Whether it was observed; else it is an upper bound.
    pub random_walk_seen: bool,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Whether the counts of an axis are coarser than its noise: then the density is that of the quantisation.
    pub coarse: bool,
}

impl KalibrNoise {
    /// Reads the output of `wimu allan --json`; the noisiest axis counts. For an acceleration random walk that was
    /// not observed, the upper bound is taken, because Kalibr needs a number above 0: alone it would be
    /// σ(τ) = K √(τ/3) at the lowest σ.
    ///
    /// # Errors
    /// `file_unreadable`; `bad_calibration` when it is not such a report, or was refused.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|e| HostError::file(&name, "read", &e))?;
        let bad = || {
            ErrorCode::BadCalibration
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
        let worst = |key: &str| {
            let axes = report["axes"].as_array()?;
            let of = |axis: &Value| axis[key]["value"].as_f64();
            axes.iter().filter_map(of).reduce(f64::max)
        };
        let walk = |axis: &Value| {
            let seen = axis["acceleration_random_walk_m_s2_rts"]["value"].as_f64();
            let (floor, tau) = (axis["floor_m_s2"].as_f64()?, axis["floor_tau_s"].as_f64()?);
            let most = floor * (3.0 / tau).sqrt();
            Some((seen.unwrap_or(most), seen.is_some()))
        };
        let axes = report["axes"].as_array().ok_or_else(bad)?;
        let (random_walk, random_walk_seen) = axes
            .iter()
            .filter_map(walk)
            .filter(|(walk, _)| walk.is_finite() && *walk > 0.0)
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .ok_or_else(bad)?;
        Ok(Self {
            density: worst("velocity_random_walk_m_s_rts").ok_or_else(bad)?,
            random_walk,
            random_walk_seen,
            rate_hz: report["rate_hz"].as_f64().ok_or_else(bad)?,
            coarse: report["axes"]
                .as_array()
                .is_some_and(|axes| axes.iter().any(|axis| axis["is_coarse"] == true)),
        })
    }
}
