//! Error model of a link, as a file: the wireless values against the cable's.

use std::path::Path;

use serde::{Deserialize, Serialize};
use wimu_link::LinkRole;

use super::Axis;
use crate::{Code, OutputFile, Problem, Result};

/// Bias and scale factor of a link's values against the reference link's, equation (65). It
/// corrects received values on the host; it is not the sensor's error model and is never pushed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinkModel {
    pub(super) schema: String,
    /// The link that it corrects.
    pub link: String,
    /// The device of the link, 16 hex digits.
    pub device_id: String,
    /// m/s², X, Y, Z.
    pub bias_mps2: [f64; 3],
    /// X, Y, Z.
    pub scale: [f64; 3],
    /// Standard deviations of the bias, m/s².
    pub bias_sd_mps2: [f64; 3],
    /// Standard deviations of the scale; `None` for an axis that did not move, whose bias is the
    /// offset at its only value.
    pub scale_sd: [Option<f64>; 3],
    /// Number of pairs of samples.
    pub pairs: u64,
}

const SCHEMA: &str = "wimu.link_model/1";

impl LinkModel {
    /// The result of a comparison of `pairs` pairs.
    pub fn new(role: LinkRole, device_id: &str, axes: &[Axis; 3], pairs: u64) -> Self {
        Self {
            schema: SCHEMA.to_owned(),
            link: role.to_string(),
            device_id: device_id.to_owned(),
            bias_mps2: axes.map(|a| a.line.map_or(a.offset_mps2, |line| line.bias_mps2)),
            scale: axes.map(|a| a.line.map_or(1.0, |line| line.scale)),
            bias_sd_mps2: axes.map(|a| a.line.map_or(a.offset_sd_mps2, |line| line.bias_sd_mps2)),
            scale_sd: axes.map(|a| a.line.map(|line| line.scale_sd)),
            pairs,
        }
    }

    /// Whether it is of this link.
    pub fn is_of(&self, role: LinkRole) -> bool {
        self.link == role.to_string()
    }

    /// Checks that it is of this device.
    ///
    /// # Errors
    /// `data_refused` when it is of another one.
    pub fn check_device(&self, device_id: u64) -> Result<()> {
        let id = format!("{device_id:016x}");
        if id == self.device_id {
            return Ok(());
        }
        Err(Code::DataRefused.error(
            format!("the link model is of device {}, the data of {id}", self.device_id),
            "compare the links of this device: `wimu compare FILE -o LINK.json`",
        ))
    }

    /// Checks that it is of this link.
    ///
    /// # Errors
    /// `data_refused` when it is of another one.
    pub fn check_role(&self, role: LinkRole) -> Result<()> {
        if self.is_of(role) {
            return Ok(());
        }
        Err(Code::DataRefused.error(
            format!("the link model is of the {} link", self.link),
            format!("choose it with --topic {}", self.link),
        ))
    }

    /// The value of the reference link for `value`, m/s².
    pub fn correct(&self, value_mps2: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|axis| (value_mps2[axis] - self.bias_mps2[axis]) / self.scale[axis])
    }

    /// The same in LSB of `mps2_per_lsb`.
    pub fn correct_lsb(&self, value: [i32; 3], mps2_per_lsb: f64) -> [i32; 3] {
        self.correct(value.map(|v| f64::from(v) * mps2_per_lsb))
            .map(|v| (v / mps2_per_lsb).round() as i32)
    }

    /// Writes it to a file, replacing an existing one.
    ///
    /// # Errors
    /// `file_failed`, `file_unreadable`.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).unwrap_or_default() + "\n";
        OutputFile::write(path, text)
    }

    /// Reads it from a file.
    ///
    /// # Errors
    /// `file_unreadable`, `bad_calibration`.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let bad = |message: String| {
            Code::BadCalibration
                .error(message, "give a file written by `wimu compare -o`")
                .at(&name)
        };
        let text =
            std::fs::read_to_string(path).map_err(|error| Problem::file(&name, "read", &error))?;
        let model: Self = serde_json::from_str(&text)
            .map_err(|error| bad(format!("this is not a link error model: {error}")))?;
        let finite = model.bias_mps2.iter().all(|b| b.is_finite());
        let scales = model.scale.iter().all(|s| (0.1..10.0).contains(s));
        match (model.schema.as_str(), finite && scales) {
            (SCHEMA, true) => Ok(model),
            (SCHEMA, false) => Err(bad("its numbers are out of bounds".to_owned())),
            (other, _) => Err(bad(format!("it is a `{other}`, not a link error model"))),
        }
    }
}
