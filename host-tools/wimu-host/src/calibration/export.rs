//! Export of a calibration to other firmware and tools.

mod noise;

use std::fmt::Write;
use std::path::Path;

use super::{Calibration, SensorCalibration, Source, parameter_id};
use crate::csv::AccelerationUnit;
use wimu_model::{Alignment, Matrix3};

pub use noise::{KalibrNoise, KalibrTerms};

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
/// let export = CalibrationExport::new(&Calibration::new(&set, &[], "poses.csv"));
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
    pub fn text(&self, target: ExportTarget, noise: Option<KalibrNoise>) -> String {
        match target {
            ExportTarget::C => {
                self.fill(include_str!("export/wimu_calibration.h"), " * ", ["{", ", ", "}"])
            }
            ExportTarget::Numpy => {
                self.fill(include_str!("export/wimu_calibration.py"), "", ["[", ", ", "]"])
            }
            ExportTarget::Matlab => {
                self.fill(include_str!("export/wimu_correct.m"), "% ", ["[", "; ", "]"])
            }
            ExportTarget::Kalibr => self.kalibr(noise),
            ExportTarget::Ros => self.ros(),
        }
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
        let (unit, scale) = match self.stored.accelerometer.sensitivity_lsb_per_g {
            Some(lsb_per_g) => {
                ("LSB", format!("9.80665 / ({lsb_per_g} LSB/g), the nominal sensitivity"))
            }
            None => ("m/s^2", "1; set it to 9.80665 for output in g".to_owned()),
        };
        let mut text = format!(
            "Input: output of the accelerometer, sensor axes, {unit}. INPUT_TO_MPS2 is {scale}.\n\
             Specific force f, m/s^2, body axes (at rest +g along the axis that points up):\n\
             y = INPUT_TO_MPS2 input, z = A(T)^-1 (y - b(T)), u = z - q z z, f = R u,\n\
             b(T) = b0 + b1 dT + b2 dT^2, A(T) = A with its diagonal times 1 + s1 dT, dT = T - T0 in degrees Celsius.\n\
             The bias is subtracted before the inverse of A is applied; R rotates from sensor to body axes."
        );
        if self.stored.gyroscope.is_some() {
            let (unit, _) = self.of_rate(1.0);
            text += &format!(
                "\nAngular rate w, rad/s, body axes, of the gyroscope's output in {unit}, y = output times the nominal scale:\n\
                     w = R A(T)^-1 (y - b(T) - G u), with the gyroscope's own A, b, T0 and its g-sensitivity G."
            );
        }
        text
    }

    /// A template with its comment and numbers; `list` opens, separates the rows of a matrix in, and closes a list.
    fn fill(&self, template: &str, comment: &str, list: [&str; 3]) -> String {
        let vector = |v: [f64; 3]| {
            let [open, _, close] = list;
            format!("{open}{:?}, {:?}, {:?}{close}", v[0], v[1], v[2])
        };
        let matrix = |m: Matrix3| {
            let [open, row, close] = list;
            format!("{open}{}{close}", m.map(vector).join(row))
        };
        let terms = self.stored.accelerometer.model.terms();
        let t = &terms.temperature;
        let convention = self.convention();
        let convention: Vec<String> =
            convention.lines().map(|line| format!("{comment}{line}")).collect();
        let signature = match self.stored.gyroscope {
            Some(_) => "[force, rate] = wimu_correct(output, temperature_c, rate_output)",
            None => "force = wimu_correct(output, temperature_c)",
        };
        let mut values = vec![
            ("title", self.title.clone()),
            ("convention", convention.join("\n")),
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
            ]);
        }
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
            text = text.replace(&format!("@{name}@"), &value);
        }
        text
    }

    /// The title, a format's convention and what it leaves out, as comments.
    fn comments(&self, target: ExportTarget, convention: &str) -> String {
        let mut text = String::new();
        let left_out = self.left_out(target);
        let lines = convention.lines().map(str::to_owned);
        let left_out = left_out.into_iter().map(|line| format!("{line}."));
        for line in [self.title.clone()].into_iter().chain(lines).chain(left_out) {
            let _ = writeln!(text, "# {line}");
        }
        text
    }

    /// Kalibr's IMU file, whose convention is ours: y = M f + b, M is A.
    fn kalibr(&self, noise: Option<KalibrNoise>) -> String {
        let terms = self.stored.accelerometer.model.terms();
        let mut out = self
            .comments(ExportTarget::Kalibr, "Output = M * specific force + b, sensor axes, m/s^2.");
        out += "rostopic: /imu/data_raw\n";
        match noise {
            Some(noise) => out += &format!("update_rate: {:?}\n", noise.rate_hz),
            None => out += "# Give the JSON of `wimu allan --json` with --noise.\n# update_rate:\n",
        }
        let sensors = noise.map_or([None; 2], |noise| noise.sensors);
        let names = [("accelerometer", "m/s^2", "velocity"), ("gyroscope", "rad/s", "angle")];
        for ((sensor, unit, walk), terms) in names.into_iter().zip(sensors) {
            let Some(terms) = terms else {
                out += &format!(
                    "# Not measured: add them.\n# {sensor}_noise_density:\n# {sensor}_random_walk:\n"
                );
                continue;
            };
            if terms.coarse {
                out += "# Counts are coarser than the noise: this is the noise of the quantisation, not of the sensor.\n";
            }
            out += &format!(
                "# {unit}/sqrt(Hz) in Kalibr's convention: the {walk} random walk\n{sensor}_noise_density: {:?}\n",
                terms.density
            );
            if !terms.random_walk_seen {
                out += &format!("# Not observed in the recording: upper bound, {unit}/sqrt(s).\n");
            }
            out += &format!("{sensor}_random_walk: {:?}\n", terms.random_walk);
        }
        let rows = |m: Matrix3| m.map(|row| format!("  - {row:?}\n")).concat();
        let _ = write!(
            out,
            "accelerometers:\n  M:\n{}  b: {:?}\n",
            rows(terms.matrix),
            terms.bias_mps2
        );
        if let Some(gyroscope) = &self.stored.gyroscope {
            let terms = gyroscope.model.terms();
            let _ = write!(
                out,
                "# Output = M * angular rate + A * specific force + b, sensor axes, rad/s.\n\
                 gyroscopes:\n  M:\n{}  A:\n{}  b: {:?}\n",
                rows(terms.matrix),
                rows(terms.g_sensitivity),
                terms.bias_rad_s
            );
        }
        out
    }

    /// The file of `imu_calib`: corrected = SM raw − bias.
    fn ros(&self) -> String {
        let terms = self.stored.accelerometer.model.terms();
        let product =
            |a: &Matrix3, v: [f64; 3]| a.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
        let (rotation, inverse) = (self.stored.alignment.matrix(), inverse(&terms.matrix));
        let column = |j: usize| product(&rotation, [0, 1, 2].map(|i| inverse[i][j]));
        let columns = [column(0), column(1), column(2)];
        let matrix = [0, 1, 2].map(|i| [0, 1, 2].map(|j| columns[j][i]));
        format!(
            "{}SM: {:?}\nbias: {:?}\n",
            self.comments(
                ExportTarget::Ros,
                "For the ROS package imu_calib: corrected = SM * raw - bias, m/s^2, SM row by row.\n\
                 raw: linear_acceleration of sensor_msgs/Imu in sensor axes, at nominal sensitivity; corrected: body axes.\n\
                 SM = R A^-1, bias = R A^-1 b: the bias is subtracted after the matrix."
            ),
            matrix.as_flattened(),
            product(&matrix, terms.bias_mps2)
        )
    }
}

/// Inverse of the matrix of an error model, which has one.
fn inverse(matrix: &Matrix3) -> Matrix3 {
    let matrix = nalgebra::Matrix3::from_fn(|i, j| matrix[i][j]);
    let inverse = matrix.try_inverse().unwrap_or_else(nalgebra::Matrix3::identity);
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| inverse[(i, j)]))
}
