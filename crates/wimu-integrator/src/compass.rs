//! Heading from a calibrated magnetometer at a rest: equation (58) of docs/reference/equations.

use wimu_model::{CompassTerms, MagneticFieldNt};

use crate::attitude::DIRECTION_BITS;

/// Prior noise of a magnetometer, nT.
const NOISE_NT: f32 = 400.0;
/// Weight of the prior noise, readings.
const NOISE_READINGS: f32 = 4.0;
/// Outlier threshold: distance of a reading from the mean, standard deviations per axis.
const MOST_APART: f32 = 6.0;
/// Largest standard deviation of a heading, rad: 20°.
const MOST_SD_RAD: f32 = 0.35;

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

/// Mean output of a magnetometer over a rest, and the heading that it shows.
///
/// An outlier is left out; two successive ones restart the mean: the unit was rotated.
///
/// ```
/// use wimu_integrator::FieldMean;
/// use wimu_model::{
///     Alignment, CompassTerms, MagneticFieldNt, MagnetometerModel, MagnetometerRotation,
///     MagnetometerTerms, ParameterSet, RotationCovariance, Sensitivity,
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
/// let uncalibrated = ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0)?);
/// assert!(CompassTerms::new(&uncalibrated).is_none());
/// let set = ParameterSet { magnetometer: Some(magnetometer), ..uncalibrated };
/// let terms = CompassTerms::new(&set).ok_or("a calibrated magnetometer")?;
///
/// // Level, body x east: magnetic north is along y.
/// let mut field = FieldMean::default();
/// field.push(MagneticFieldNt([10_000, 20_000, -44_000]));
/// let heading = field.heading(&terms, [0, 0, 42_119_196_999]).ok_or("an undisturbed field")?;
/// assert!((heading.east[0] - (1 << 30)).abs() < 1 << 20 && heading.sd_mrad < 60);
///
/// // Beside a magnet nothing is said.
/// let mut magnet = FieldMean::default();
/// magnet.push(MagneticFieldNt([90_000, 20_000, -44_000]));
/// assert_eq!(magnet.heading(&terms, [0, 0, 42_119_196_999]), None);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
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

    /// Heading of a body at rest, from the mean field and the specific force (any unit), body axes.
    /// `None` without a reading, near the magnetic poles, and if the disturbance of the field makes
    /// the standard deviation exceed 20°.
    pub fn heading(&self, of: &CompassTerms, force: [i64; 3]) -> Option<MagneticHeading> {
        if self.readings == 0 {
            return None;
        }
        let up = unit(force.map(|axis| axis as f32))?;
        let off = minus(self.mean_nt, of.hard_iron_nt);
        let b = of.to_body.map(|row| dot(row, off));
        let vertical = dot(b, up);
        let level = minus(b, up.map(|axis| axis * vertical));
        let level_nt = libm::sqrtf(dot(level, level));
        let north = unit(level)?;
        let east = cross(north, up);
        let known = of.model_nt2 + self.variance() / self.readings as f32;
        // The deviation in magnitude and dip from the calibration indicates the disturbance of the
        // heading.
        let longer = libm::sqrtf(dot(b, b)) - of.field_nt;
        let higher = vertical - of.up_nt;
        let disturbed = (0.5 * (square(longer) + square(higher)) - known).max(0.0);
        let dip_tangent = -vertical / level_nt;
        let lever = [0, 1, 2].map(|axis| up[axis] + dip_tangent * north[axis]);
        let variance = (known + disturbed) / square(level_nt)
            + quadratic(of.mounting_rad2, lever)
            + quadratic(of.alignment_rad2, up)
            + square(dip_tangent) * of.tilt_rad2;
        let sd_rad = libm::sqrtf(variance);
        (sd_rad <= MOST_SD_RAD).then(|| MagneticHeading {
            east: east.map(|axis| (axis * (1_u32 << DIRECTION_BITS) as f32) as i32),
            sd_mrad: (sd_rad * 1000.0) as u16 + 1,
        })
    }
}

/// x C x of a symmetric C: xx, yy, zz, xy, xz, yz.
fn quadratic([xx, yy, zz, xy, xz, yz]: [f32; 6], [x, y, z]: [f32; 3]) -> f32 {
    xx * x * x + yy * y * y + zz * z * z + 2.0 * (xy * x * y + xz * x * z + yz * y * z)
}

fn unit(v: [f32; 3]) -> Option<[f32; 3]> {
    let norm = libm::sqrtf(dot(v, v));
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
