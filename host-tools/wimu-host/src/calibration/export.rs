//! Export of a calibration to other firmware and tools.

mod noise;

use std::path::Path;

use super::{Calibration, SensorCalibration, Source, parameter_id};
use crate::csv::AccelerationUnit;
use wimu_model::{Alignment, Matrix3};

pub use noise::KalibrNoise;

use super::poses::range_note;
use crate::{Code, Problem, Result};

/// What reads an exported calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportTarget {
    /// YAML of the ROS package `imu_calib`.
    Ros,
    /// IMU file of Kalibr.
    Kalibr,
    /// Python module with NumPy.
    Numpy,
    /// MATLAB or Octave function.
    Matlab,
    /// C header without dependencies.
    C,
}

/// A calibration to export: of counts, or of output in m/s².
///
/// ```
/// use wimu_host::calibration::{Calibration, CalibrationExport, ExportTarget};
/// use wimu_model::{ParameterSet, Sensitivity};
///
/// let set = ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0).unwrap());
/// let export = CalibrationExport::new(&Calibration::held(&set));
/// assert!(export.text(ExportTarget::C, None).contains("void wimu_correct("));
/// assert!(export.findings(ExportTarget::Ros).is_empty());
/// ```
#[derive(Clone, Debug)]
pub struct CalibrationExport {
    stored: SensorCalibration,
    title: String,
    /// A range that was assumed.
    range: Option<Problem>,
}

impl CalibrationExport {
    /// Reads a calibration file.
    ///
    /// # Errors
    /// `file_unreadable`; `bad_calibration` when it is not a calibration, was refused or edited, or contains numbers
    /// that are out of bounds.
    pub fn read(path: &Path) -> Result<Self> {
        Ok(Self::new(&Calibration::read(path)?))
    }

    /// Of [`Calibration::sensor`].
    pub fn new(calibration: &Calibration) -> Self {
        let stored = calibration.sensor().clone();
        let source = stored.accelerometer.range_source;
        let mut range = None;
        let mut title = "Calibration of an accelerometer".to_owned();
        if let Ok(set) = calibration.parameters() {
            let (id, range_g) = (parameter_id(&set), set.range_g);
            title = format!("Calibration {id} of a +/-{range_g} g accelerometer");
            if source == Some(Source::SixteenBits) {
                range = range_note((range_g, Source::SixteenBits), set.sensitivity);
                let lsb_per_g = set.sensitivity.lsb_per_g();
                title = format!(
                    "Calibration {id} of an accelerometer of {lsb_per_g:.0} LSB/g; its range is unknown (+/-{range_g} g if it \
                     has 16 bits)"
                );
            }
        }
        Self { stored, title: format!("{title}, exported by wimu."), range }
    }

    /// The calibration as a text for `target`. Only Kalibr's has the noise.
    pub fn text(&self, target: ExportTarget, noise: Option<&KalibrNoise>) -> String {
        // The beginning of a comment; what opens a list, separates the rows of a matrix, and closes a list.
        let (template, comment, list) = match target {
            ExportTarget::C => (include_str!("export/wimu_calibration.h"), " * ", ["{", ", ", "}"]),
            ExportTarget::Numpy => {
                (include_str!("export/wimu_calibration.py"), "", ["[", ", ", "]"])
            }
            ExportTarget::Matlab => (include_str!("export/wimu_correct.m"), "% ", ["[", "; ", "]"]),
            ExportTarget::Kalibr => (include_str!("export/kalibr.yaml"), "# ", ["[", ", ", "]"]),
            ExportTarget::Ros => (include_str!("export/imu_calib.yaml"), "# ", ["[", ", ", "]"]),
        };
        let commented = |text: String| {
            Vec::from_iter(text.lines().map(|line| format!("{comment}{line}"))).join("\n")
        };
        let left_out = self.left_out(target).into_iter().map(|line| format!("{line}.\n"));
        let mut values = self.values(list);
        values.extend([
            ("convention", commented(self.convention())),
            ("left_out", commented(left_out.collect())),
            ("noise", noise::text(noise)),
        ]);
        self.fill(template, &values)
    }

    /// An assumed range, and terms of the calibration that a target cannot express.
    pub fn findings(&self, target: ExportTarget) -> Vec<Problem> {
        let left_out = self.left_out(target).into_iter();
        let left_out = left_out.map(|text| Code::NotExpressible.warning(text));
        self.range.iter().cloned().chain(left_out).collect()
    }

    fn left_out(&self, target: ExportTarget) -> Vec<String> {
        use ExportTarget::{Kalibr, Ros};
        if !matches!(target, Kalibr | Ros) {
            return Vec::new();
        }
        let terms = self.stored.accelerometer.model.terms();
        let t = &terms.temperature;
        let mut left_out = Vec::new();
        if [t.bias_mps2_per_k, t.bias_mps2_per_k2, t.scale_per_k] != [[0.0; 3]; 3] {
            left_out.push(format!(
                "the values are those at {:.2} °C: the temperature coefficients are left out",
                t.reference_c
            ));
        }
        if terms.nonlinearity != [0.0; 3] {
            left_out.push("the nonlinearity is left out".to_owned());
        }
        if target != Ros && self.stored.alignment != Alignment::IDENTITY {
            left_out.push(
                "the alignment is left out: axes are the sensor's, not the body's".to_owned(),
            );
        }
        if target == Ros && self.stored.gyroscope.is_some() {
            left_out.push("the gyroscope is left out".to_owned());
        }
        left_out
    }

    /// Unit of the gyroscope's output and its rad/s, from those of a count: beside accelerations in m/s² it is SI, too.
    fn of_rate(&self, rad_s_per_lsb: f64) -> (&'static str, f64) {
        match self.stored.accelerometer.unit {
            AccelerationUnit::Lsb => ("LSB", rad_s_per_lsb),
            AccelerationUnit::Mps2 => ("rad/s", 1.0),
        }
    }

    /// The equations of the calibration, as lines of text.
    fn convention(&self) -> String {
        let (unit, input) = match self.stored.accelerometer.sensitivity_lsb_per_g {
            Some(lsb_per_g) => {
                ("LSB", format!("9.80665 / ({lsb_per_g} LSB/g), the nominal sensitivity"))
            }
            None => ("m/s^2", "1; set it to 9.80665 for output in g".to_owned()),
        };
        let (wunit, _) = self.of_rate(1.0);
        let values = [("unit", unit.to_owned()), ("input", input), ("wunit", wunit.to_owned())];
        self.fill(include_str!("export/convention.txt"), &values)
    }

    /// The numbers of the calibration by name.
    fn values(&self, [open, row, close]: [&str; 3]) -> Vec<(&'static str, String)> {
        let vector = |v: [f64; 3]| format!("{open}{:?}, {:?}, {:?}{close}", v[0], v[1], v[2]);
        let matrix = |m: Matrix3| format!("{open}{}{close}", m.map(vector).join(row));
        let rows = |m: Matrix3| m.map(|row| format!("  - {row:?}")).join("\n");
        let terms = self.stored.accelerometer.model.terms();
        let t = &terms.temperature;
        let (sm, bias) = self.ros();
        let signature = match self.stored.gyroscope {
            Some(_) => "[force, rate] = wimu_correct(output, temperature_c, rate_output)",
            None => "force = wimu_correct(output, temperature_c)",
        };
        let mut values = vec![
            ("title", self.title.clone()),
            ("signature", signature.to_owned()),
            ("t0", format!("{:?}", t.reference_c)),
            ("scale", format!("{:?}", self.stored.accelerometer.mps2_per_unit())),
            ("b0", vector(terms.bias_mps2)),
            ("b1", vector(t.bias_mps2_per_k)),
            ("b2", vector(t.bias_mps2_per_k2)),
            ("s1", vector(t.scale_per_k)),
            ("q", vector(terms.nonlinearity)),
            ("a", matrix(terms.matrix)),
            ("r", matrix(self.stored.alignment.matrix())),
            ("rows_a", rows(terms.matrix)),
            ("sm", format!("{sm:?}")),
            ("smb", format!("{bias:?}")),
        ];
        if let Some(gyroscope) = &self.stored.gyroscope {
            let (unit, rad_s_per_unit) = self.of_rate(gyroscope.rad_s_per_lsb);
            let terms = gyroscope.model.terms();
            let t = &terms.temperature;
            values.extend([
                ("wunit", unit.to_owned()),
                ("wscale", format!("{rad_s_per_unit:?}")),
                ("wt0", format!("{:?}", t.reference_c)),
                ("wb0", vector(terms.bias_rad_s)),
                ("wb1", vector(t.bias_rad_s_per_k)),
                ("ws1", vector(t.scale_per_k)),
                ("wa", matrix(terms.matrix)),
                ("wg", matrix(terms.g_sensitivity)),
                ("rows_wa", rows(terms.matrix)),
                ("rows_wg", rows(terms.g_sensitivity)),
            ]);
        }
        values
    }

    /// A template with its values: a line of an empty one is left out, and so are those of a gyroscope without one.
    fn fill(&self, template: &str, values: &[(&'static str, String)]) -> String {
        let mut keep = true;
        let mut text = String::new();
        for line in template.lines() {
            match line {
                "@gyroscope{" => keep = self.stored.gyroscope.is_some(),
                "@}" => keep = true,
                _ if keep => text += &format!("{line}\n"),
                _ => {}
            }
        }
        for (name, value) in values {
            if value.is_empty() {
                text = text.replace(&format!("@{name}@\n"), "");
            }
            text = text.replace(&format!("@{name}@"), value);
        }
        text
    }

    /// SM, row by row, and the bias of `imu_calib`: corrected = SM raw − bias.
    fn ros(&self) -> ([f64; 9], [f64; 3]) {
        let terms = self.stored.accelerometer.model.terms();
        let of = |m: Matrix3| nalgebra::Matrix3::from_fn(|row, column| m[row][column]);
        // The matrix of an error model has an inverse.
        let inverse = of(terms.matrix).try_inverse().unwrap_or_else(nalgebra::Matrix3::identity);
        let matrix = of(self.stored.alignment.matrix()) * inverse;
        let bias = matrix * nalgebra::Vector3::from(terms.bias_mps2);
        (std::array::from_fn(|k| matrix[(k / 3, k % 3)]), bias.into())
    }
}
