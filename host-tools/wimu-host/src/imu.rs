//! One unit's recording: accelerometer, and magnetometer, angular rate and true path where the file
//! has them.

mod arrival;
mod clocks;
mod table;

pub(crate) use arrival::TIME_SD_S;
pub use arrival::sampled_times;
pub(crate) use clocks::{one_clock, other_clock};
pub use table::TableOptions;

use std::ops::Range;

use nalgebra::{Matrix3, SMatrix};
use wimu_model::{Alignment, ModelCovariance};

use crate::Problem;
use crate::stats::{median, norm};

/// A sample of one unit, corrected, body frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UnitSample {
    /// Time since the sample before, s.
    pub step_s: f64,
    /// Specific force, m/s².
    pub force_mps2: [f64; 3],
    /// Magnetic field, µT.
    pub field_ut: Option<[f64; 3]>,
    /// Angular rate, rad/s.
    pub rate_rad_s: Option<[f64; 3]>,
}

/// Standard deviation of the bias of a calibrated consumer accelerometer, m/s²: what its turn-on changes (datasheets).
const BIAS_MPS2: f64 = 0.05;
/// The same of a sensor whose calibration is not known, m/s²: that of public recordings (docs/reference/validation.md, navigation).
const UNKNOWN_BIAS_MPS2: f64 = 0.1;

/// Change of scale factor and misalignment after a calibration: 0.01 %/K over 10 K (LSM6DSO, MPU-9250 datasheets).
const MATRIX_CHANGE: f64 = 0.001;

/// A longer pause between samples is a gap: 0.25 s, or four times the usual step.
pub fn gap_s(times_s: &[f64]) -> f64 {
    f64::max(0.25, 4.0 * median_step_s(times_s))
}

/// Median time between two samples, s; 0 of fewer than two.
pub fn median_step_s(times_s: &[f64]) -> f64 {
    median(times_s.windows(2).map(|w| w[1] - w[0])).unwrap_or(0.0)
}

/// Where the unit truly was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Position, m, east-north-up.
    pub position_m: [f64; 3],
    /// Body to navigation axes, W X Y Z.
    pub quaternion: [f64; 4],
}

impl Truth {
    /// Direction of body x from east to north, rad.
    pub fn heading_rad(&self) -> f64 {
        heading_rad(self.quaternion)
    }
}

/// Heading of the rotation from body to navigation axes: angle of body x from east towards north, rad.
pub(crate) fn heading_rad([w, x, y, z]: [f64; 4]) -> f64 {
    (2.0 * (x * y + w * z)).atan2(1.0 - 2.0 * (y * y + z * z))
}

/// The column that says whether the magnetic field is corrected.
pub(crate) const FIELD_CALIBRATED: &str = "Field Calibrated";

/// The column that says whether the unit moves.
pub(crate) const MOVING: &str = "Moving";

/// Deviations up to which something is likely.
pub(crate) const LIKELY: f64 = 3.0;

/// Full scale of an accelerometer that is not known, m/s²: that of the widest digital MEMS accelerometers is ± 200 g
/// (ADXL375, datasheet).
pub const FULL_SCALE_MPS2: f64 = 2000.0;
/// The same of a gyroscope, rad/s: 20,000 deg/s (ADXRS649, datasheet).
pub const FULL_SCALE_RAD_S: f64 = 350.0;
/// The same of a magnetometer, µT: ± 50 gauss (LSM303AGR, datasheet).
pub const FULL_SCALE_UT: f64 = 5000.0;

/// Samples of one unit, corrected, in SI.
#[derive(Clone, Debug, Default)]
pub struct MotionRecording {
    /// What errors call it.
    pub name: String,
    /// Time of each sample, s.
    pub times_s: Vec<f64>,
    /// The samples.
    pub samples: Vec<UnitSample>,
    /// `Truth …` columns, where they are filled in.
    pub truth: Vec<Option<Truth>>,
    /// What was noticed at reading.
    pub findings: Vec<Problem>,
    /// Covariance of the calibration of its accelerometer, body axes: bias, m/s², then the matrix by rows; `None` where it
    /// is not known.
    pub covariance: Option<[[f64; 12]; 12]>,
    /// Whether the covariance is that of a new session and includes the turn-on bias: a calibration from several
    /// sessions measured it.
    pub of_sessions: bool,
    /// Full scale of its accelerometer, m/s², where the recording gives it. A sample beyond it, or else beyond
    /// [`FULL_SCALE_MPS2`], was not measured.
    pub full_scale_mps2: Option<f64>,
    /// Whether a magnetic field was left out because its magnetometer is not calibrated.
    pub field_uncalibrated: bool,
    /// The column `Moving`, where the file has it: above 0.5 where the unit moves by its reference.
    pub moving: Option<Vec<f64>>,
}

impl MotionRecording {
    /// Samples without truth, as many as times.
    pub fn new(name: impl Into<String>, times_s: Vec<f64>, samples: Vec<UnitSample>) -> Self {
        Self {
            name: name.into(),
            truth: vec![None; samples.len()],
            times_s,
            samples,
            ..Self::default()
        }
    }

    /// Why there is no magnetic field, for a finding.
    pub(crate) fn without_field(&self) -> &'static str {
        if self.field_uncalibrated {
            "there is a magnetometer, but it is not calibrated and not used (calibrate it with `wimu calibrate FILE --method \
             magnetometer --with CAL.json -o BOTH.json`, then navigate with --with BOTH.json)"
        } else {
            "no magnetometer"
        }
    }

    /// Standard deviation of the accelerometer's bias, m/s²: of an unknown sensor, or what turn-on changes and what its
    /// calibration leaves unknown on the worst axis at 1 *g*, with the matrix.
    pub fn bias_mps2(&self) -> f64 {
        let Some(known) = self.covariance else {
            return UNKNOWN_BIAS_MPS2;
        };
        self.turn_on_mps2().hypot(crate::calibration::worst_sd(|place| known[place][place].sqrt()))
    }

    /// Standard deviation of the turn-on bias that the covariance does not include, m/s².
    fn turn_on_mps2(&self) -> f64 {
        if self.of_sessions { 0.0 } else { BIAS_MPS2 }
    }

    /// Covariance of bias and matrix with what changes after the calibration: a turn-on bias, and a scale factor and axes
    /// that depend on temperature and age.
    pub fn calibration_covariance(&self) -> Option<[[f64; 12]; 12]> {
        let mut all = self.covariance?;
        for (place, row) in all.iter_mut().enumerate() {
            let later = match place {
                0..3 => self.turn_on_mps2(),
                _ => MATRIX_CHANGE,
            };
            row[place] += later * later;
        }
        Some(all)
    }

    /// Gravity to navigate with, m/s²: the standard one, unless mean |f| of the first second at rest within the first minute
    /// departs from it by more than the biases of a calibrated accelerometer explain, and less than 10 %: one that is
    /// not calibrated shows its own. A small departure is no gravity: as a bias it turns with the unit.
    pub fn gravity_mps2(&self) -> f64 {
        let standard = wimu_model::STANDARD_GRAVITY_MPS2;
        let by_bias = LIKELY * self.bias_mps2();
        self.first_rest_mps2().filter(|seen| (seen - standard).abs() > by_bias).unwrap_or(standard)
    }

    /// Mean |f| of the first second at rest, where it may be gravity, m/s².
    pub fn first_rest_mps2(&self) -> Option<f64> {
        let standard = wimu_model::STANDARD_GRAVITY_MPS2;
        let end = self.times_s.first()? + 60.0;
        let mut seconds = self.seconds().take_while(|second| {
            self.times_s[second.samples.start] < end && second.samples.len() >= QUIET_SAMPLES
        });
        let is_rest =
            |second: &Second| second.is_quiet() && (second.mean_mps2 / standard - 1.0).abs() < 0.1;
        seconds.find(is_rest).map(|second| second.mean_mps2)
    }

    /// The samples, a second at a time.
    pub(crate) fn seconds(&self) -> impl Iterator<Item = Second> {
        let mut from = 0;
        std::iter::from_fn(move || {
            let end = self.times_s.get(from)? + 1.0;
            let to = self.times_s.partition_point(|t| *t < end).max(from + 1);
            let sizes = self.samples[from..to].iter().map(|s| norm(s.force_mps2));
            let count = (to - from) as f64;
            let mean_mps2 = sizes.clone().sum::<f64>() / count;
            let variance = sizes.map(|f| (f - mean_mps2).powi(2)).sum::<f64>() / count;
            Some(Second { samples: std::mem::replace(&mut from, to)..to, mean_mps2, variance })
        })
    }
}

/// Fewest samples of a quiet second, and the largest standard deviation of |f| in it, m/s².
const QUIET_SAMPLES: usize = 10;
const QUIET_MPS2: f64 = 0.15;

/// A second of samples.
pub(crate) struct Second {
    pub samples: Range<usize>,
    /// Mean of |f|, m/s².
    pub mean_mps2: f64,
    /// Variance of |f|, m²/s⁴.
    variance: f64,
}

impl Second {
    /// Whether the unit may be at rest.
    pub fn is_quiet(&self) -> bool {
        self.samples.len() >= QUIET_SAMPLES && self.variance < QUIET_MPS2 * QUIET_MPS2
    }
}

/// eᵀ P⁻¹ e of a position error, m, with covariance P, m².
pub fn nees(error: [f64; 3], p: [[f64; 3]; 3]) -> f64 {
    let det = |m: [[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
            - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let whole = det(p);
    if whole <= 0.0 {
        return f64::INFINITY;
    }
    (0..3)
        .map(|column| {
            let mut changed = p;
            for (row, e) in changed.iter_mut().zip(error) {
                row[column] = e;
            }
            det(changed) / whole * error[column]
        })
        .sum()
}

/// The covariance of an error model, in the axes of the body: b ← R b, M ← R M Rᵀ.
pub(crate) fn in_body_axes(known: &ModelCovariance, alignment: &Alignment) -> [[f64; 12]; 12] {
    let rotation = Matrix3::from_row_slice(alignment.matrix().as_flattened());
    let mut change = SMatrix::<f64, 12, 12>::zeros();
    change.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    change.fixed_view_mut::<9, 9>(3, 3).copy_from(&rotation.kronecker(&rotation));
    let sensor = SMatrix::from_fn(|a, b| known.get(a, b));
    (change * sensor * change.transpose()).into()
}
