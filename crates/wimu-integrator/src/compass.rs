//! Heading from a calibrated magnetometer at a rest: equation (58) of docs/EQUATIONS.md.

use wimu_model::{MagneticFieldNt, ParameterSet, root};

use crate::attitude::{DIRECTION_BITS, to_direction};

type Matrix = [[f32; 3]; 3];

/// Prior noise of a magnetometer, nT.
const NOISE_NT: f32 = 400.0;
/// Weight of the prior noise, readings.
const NOISE_READINGS: f32 = 4.0;
/// Outlier threshold: distance of a reading from the mean, standard deviations per axis.
const MOST_APART: f32 = 6.0;
/// Largest standard deviation of a heading, rad: 20°.
const MOST_SD_RAD: f32 = 0.35;
/// Turn-on bias repeatability of the accelerometer, m/s², which tilts the measured vertical.
const TURN_ON_MPS2: f32 = 0.015;
/// Bias of an accelerometer without a quality record, m/s².
const UNKNOWN_BIAS_MPS2: f32 = 0.1;
const GRAVITY_MPS2: f32 = 9.81;

/// Direction of magnetic east and its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MagneticHeading {
    /// Direction of magnetic east in body axes, horizontal, 2⁻³⁰ per LSB.
    pub east: [i32; 3],
    /// Its standard deviation about the vertical, mrad, rounded up.
    pub sd_mrad: u16,
}

/// Mean output of a magnetometer over a rest.
///
/// An outlier is left out; two successive ones restart the mean: the unit was rotated.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FieldMean {
    mean_nt: [f32; 3],
    /// Σ of squared departures, all axes.
    squares: f32,
    readings: u32,
    /// Whether the latest reading was an outlier.
    departed: bool,
}

impl FieldMean {
    /// Adds a magnetometer output at rest. Returns whether a new heading is due: at readings 1, 2,
    /// 4, 8, …
    pub fn push(&mut self, output: MagneticFieldNt) -> bool {
        let reading = output.0.map(|axis| axis as f32);
        let off = minus(reading, self.mean_nt);
        if self.readings > 0 && dot(off, off) > 3.0 * square(MOST_APART) * self.variance() {
            let again = core::mem::replace(&mut self.departed, true);
            if !again {
                return false;
            }
            *self = Self::default();
        }
        self.departed = false;
        self.readings = self.readings.saturating_add(1);
        let off = minus(reading, self.mean_nt);
        let share = 1.0 / self.readings as f32;
        for (mean, off) in self.mean_nt.iter_mut().zip(off) {
            *mean += off * share;
        }
        self.squares += dot(off, off) * (1.0 - share);
        self.readings.is_power_of_two()
    }

    /// Variance of one reading of an axis, nT².
    fn variance(&self) -> f32 {
        let freedom = NOISE_READINGS + self.readings.saturating_sub(1) as f32;
        (NOISE_READINGS * square(NOISE_NT) + self.squares / 3.0) / freedom
    }
}

/// Heading from the magnetic field: the magnetometer model with its rotation to the body, and their
/// uncertainties. Single precision: its rounding is 10⁻⁴ rad, below the errors of magnetometers;
/// the output is in integers.
///
/// ```
/// use wimu_integrator::{Compass, FieldMean};
/// use wimu_model::{
///     Alignment, MagneticFieldNt, MagnetometerModel, MagnetometerRotation, MagnetometerTerms,
///     ParameterSet, RotationCovariance, Sensitivity,
/// };
///
/// // 20 µT north and 44 µT down, hard iron of 10 µT on x, axes as the accelerometer's.
/// let magnetometer = MagnetometerModel::new(MagnetometerTerms {
///     hard_iron_nt: [10_000.0, 0.0, 0.0],
///     hard_iron_sd_nt: [50.0; 3],
///     soft_iron: [1.0, 1.0, 1.0, 0.0, 0.0, 0.0],
///     soft_iron_sd: [0.002; 6],
///     field_nt: 48_332.0,
///     poses: 30,
///     rms_nt: 100.0,
///     loo_rms_nt: 120.0,
///     condition: 2.0,
///     to_accelerometer: Some(MagnetometerRotation {
///         rotation: Alignment::IDENTITY,
///         covariance: RotationCovariance::from_matrix(&[[1e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 1e-6]])?,
///         dip_rad: 1.144,
///         dip_rms_rad: 0.002,
///     }),
/// })?;
/// let sensitivity = Sensitivity::from_lsb_per_g(16384.0)?;
/// let set = ParameterSet { magnetometer: Some(magnetometer), ..ParameterSet::uncalibrated(2, sensitivity) };
/// let compass = Compass::new(&set).ok_or("a calibrated magnetometer")?;
/// let mut field = FieldMean::default();
/// // Level, body x east: magnetic north is along y.
/// field.push(MagneticFieldNt([10_000, 20_000, -44_000]));
/// let heading = compass.heading(&field, [0, 0, 42_119_196_999]).ok_or("an undisturbed field")?;
/// assert!((heading.east[0] - (1 << 30)).abs() < 1 << 20 && heading.sd_mrad < 60);
///
/// // Beside a magnet nothing is said.
/// let mut magnet = FieldMean::default();
/// magnet.push(MagneticFieldNt([90_000, 20_000, -44_000]));
/// assert_eq!(compass.heading(&magnet, [0, 0, 42_119_196_999]), None);
/// // Without a calibrated magnetometer there is no compass.
/// assert!(Compass::new(&ParameterSet::uncalibrated(2, sensitivity)).is_none());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Compass {
    /// R_a R S⁻¹.
    to_body: Matrix,
    hard_iron_nt: [f32; 3],
    field_nt: f32,
    /// Vertical component of the field at the calibration, up, nT.
    up_nt: f32,
    /// Covariances of the rotation errors in body axes, rad²: magnetometer to accelerometer, and
    /// sensor to body.
    mounting: Matrix,
    alignment: Matrix,
    /// Variance of a component of the corrected field from hard iron, soft iron and residual, nT².
    model: f32,
    /// Variance of the tilt of the measured vertical, rad².
    tilt: f32,
}

impl Compass {
    /// `None` if the set has no magnetometer, or its rotation to the accelerometer is unknown.
    pub fn new(set: &ParameterSet) -> Option<Self> {
        let magnetometer = set.magnetometer.as_ref()?;
        let terms = magnetometer.terms();
        let mounting = terms.to_accelerometer.as_ref()?;
        // The correction is affine: its columns follow from outputs of 1 mT each.
        let none = set.correct_field(MagneticFieldNt([0; 3]))?;
        let mut to_body = [[0.0; 3]; 3];
        for column in 0..3 {
            let mut output = [0; 3];
            output[column] = 1_000_000;
            let some = set.correct_field(MagneticFieldNt(output))?;
            for row in 0..3 {
                to_body[row][column] = ((some[row] - none[row]) * 1e-6) as f32;
            }
        }
        let single = |matrix: [[f64; 3]; 3]| matrix.map(|row| row.map(|element| element as f32));
        let mean_square =
            |sd: &[f32]| sd.iter().map(|sd| square(*sd)).sum::<f32>() / sd.len() as f32;
        let bias_mps2 = set.quality.map_or(UNKNOWN_BIAS_MPS2, |quality| {
            let covariance = &quality.terms().covariance;
            let largest = (0..3).map(|axis| covariance.sd(axis)).fold(0.0, f64::max);
            largest as f32
        });
        let dip = mounting.dip_rad;
        Some(Self {
            to_body,
            hard_iron_nt: terms.hard_iron_nt,
            field_nt: terms.field_nt,
            up_nt: -terms.field_nt * sine(dip),
            mounting: turned(single(set.alignment.matrix()), single(mounting.covariance.matrix())),
            alignment: set
                .alignment_covariance
                .map_or([[0.0; 3]; 3], |covariance| single(covariance.matrix())),
            model: mean_square(&terms.hard_iron_sd_nt)
                + mean_square(&terms.soft_iron_sd) * square(terms.field_nt)
                + square(terms.rms_nt),
            tilt: (square(bias_mps2) + square(TURN_ON_MPS2)) / square(GRAVITY_MPS2),
        })
    }

    /// Heading of a body at rest, from the mean field and the specific force (any unit), body axes.
    /// `None` without a reading, near the magnetic poles, and if the disturbance of the field makes
    /// the standard deviation exceed 20°.
    pub fn heading(&self, field: &FieldMean, force: [i64; 3]) -> Option<MagneticHeading> {
        if field.readings == 0 {
            return None;
        }
        let up = unit(force.map(|axis| axis as f32))?;
        let b = apply(&self.to_body, minus(field.mean_nt, self.hard_iron_nt));
        let vertical = dot(b, up);
        let level = minus(b, up.map(|axis| axis * vertical));
        let level_nt = sqrt(dot(level, level));
        let north = unit(level)?;
        let east = cross(north, up);
        let known = self.model + field.variance() / field.readings as f32;
        // The deviation in magnitude and dip from the calibration indicates the disturbance of the
        // heading.
        let longer = sqrt(dot(b, b)) - self.field_nt;
        let higher = vertical - self.up_nt;
        let disturbed = (0.5 * (square(longer) + square(higher)) - known).max(0.0);
        let dip_tangent = -vertical / level_nt;
        let lever = [0, 1, 2].map(|axis| up[axis] + dip_tangent * north[axis]);
        let variance = (known + disturbed) / square(level_nt)
            + dot(lever, apply(&self.mounting, lever))
            + dot(up, apply(&self.alignment, up))
            + square(dip_tangent) * self.tilt;
        let sd_rad = sqrt(variance);
        (sd_rad <= MOST_SD_RAD).then(|| MagneticHeading {
            east: east.map(|axis| to_direction(f64::from(axis))),
            sd_mrad: (sd_rad * 1000.0) as u16 + 1,
        })
    }
}

/// Sine of an angle within ±π/2, to 10⁻⁷: a tenth of the code of a general one.
fn sine(rad: f32) -> f32 {
    let square = rad * rad;
    let series = [-2.505_210_8e-8, 2.755_731_9e-6, -1.984_127e-4, 8.333_333e-3, -0.166_666_67];
    let sum = series.into_iter().fold(0.0, |sum, term| sum * square + term);
    rad + rad * square * sum
}

/// R C Rᵀ.
fn turned(r: Matrix, c: Matrix) -> Matrix {
    let half = r.map(|row| apply(&c, row));
    r.map(|row| half.map(|column| dot(row, column)))
}

fn apply(matrix: &Matrix, v: [f32; 3]) -> [f32; 3] {
    matrix.map(|row| dot(row, v))
}

/// The square root, rounded to nearest: rounding the f64 root again is exact, because it has more
/// than twice the digits.
fn sqrt(x: f32) -> f32 {
    root::sqrt(f64::from(x)) as f32
}

fn unit(v: [f32; 3]) -> Option<[f32; 3]> {
    let norm = sqrt(dot(v, v));
    (norm > 0.0).then(|| v.map(|x| x / norm))
}

fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn square(x: f32) -> f32 {
    x * x
}

const _: () = assert!(DIRECTION_BITS == 30, "the doc of MagneticHeading says so");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sine_is_that_of_libm_over_every_dip() {
        for thousandth in -1571..=1571 {
            let rad = thousandth as f32 * 1e-3;
            assert!((sine(rad) - libm::sinf(rad)).abs() < 2e-7, "{rad}");
        }
    }
}
