//! Magnetometer calibration from the magnitude of the field and its dip, in unknown orientations.

mod consensus;
mod fit;

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use nalgebra::{Matrix3, Vector3};
use wimu_model::MagnetometerModel;

use crate::orientation::axis_name as name;
use crate::{Reason, Refusal, UnitHint, input, student};

/// Number of parameters of hard and soft iron, and of the rotation with the dip.
const IRON: u32 = 9;
const ROTATION: u32 = 4;
/// Smallest number of poses: nine parameters and three redundant poses.
const FEWEST: usize = 12;
/// Accepted field magnitude, nT: the field of the Earth is 22 to 67 µT, and in buildings hardly
/// larger than this.
const EARTHS_NT: core::ops::RangeInclusive<f64> = 1e4..=1.2e5;
/// Smallest range of the output of an axis, relative to the largest of the three.
const LEAST_SHARE: f64 = 0.02;
/// Cosine of 30°: poses that differ by more do not have one field on all axes, unless they are turned about it.
const DIFFERENT_COS: f64 = 0.866;
/// Number of such poses with exactly one output of which the magnetometer is frozen.
const FROZEN: usize = 3;
/// Number of poses at the same extreme value that indicates clipping.
const CLIPPED: usize = 4;
/// Poses per rejected pose, at least.
const DOUBTED: usize = 5;
/// Smallest dip whose sign identifies a mirrored axis, rad: 5°.
const LEVEL_RAD: f64 = 0.087;
/// Largest angle at which axes count as parallel, rad: 20°.
const PARALLEL_RAD: f64 = 0.35;

/// Output of magnetometer and accelerometer in one orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MagneticPose {
    /// Output of the magnetometer, nT.
    pub output_nt: [f64; 3],
    /// Corrected specific force at rest, accelerometer axes, of any length.
    pub up: [f64; 3],
}

/// A magnetometer model, and the rejected poses.
#[derive(Clone, Debug, PartialEq)]
pub struct MagneticEstimate {
    /// The model.
    pub model: MagnetometerModel,
    /// Indices of outliers: the field was disturbed there.
    pub rejected: Vec<usize>,
}

impl MagneticEstimate {
    /// Half width of the 95 % confidence interval of the hard iron, nT, by Student's t with the
    /// poses minus nine parameters as degrees of freedom: equation (43).
    pub fn hard_iron_half_width_95_nt(&self) -> [f64; 3] {
        let terms = self.model.terms();
        terms.hard_iron_sd_nt.map(|sd| self.wide(IRON, sd.into()))
    }

    /// Half width of the 95 % confidence interval of the soft iron, xx yy zz xy xz yz.
    pub fn soft_iron_half_width_95(&self) -> [f64; 6] {
        let terms = self.model.terms();
        terms.soft_iron_sd.map(|sd| self.wide(IRON, sd.into()))
    }

    /// Half width of the 95 % confidence interval of the rotation error about the axes of the
    /// accelerometer, rad.
    pub fn rotation_half_width_95_rad(&self) -> Option<[f64; 3]> {
        let mounting = self.model.terms().to_accelerometer?;
        let sd = |axis| mounting.covariance.sd(axis);
        Some([0, 1, 2].map(|axis| self.wide(ROTATION, sd(axis))))
    }

    fn wide(&self, parameters: u32, sd: f64) -> f64 {
        let dof = self.model.terms().poses.saturating_sub(parameters).max(1);
        student::two_sided(0.05, f64::from(dof)) * sd
    }
}

/// Estimates hard and soft iron from the constant magnitude of the field, and the rotation to the
/// accelerometer from its constant dip. Equations (55) to (57) of docs/reference/equations. Outliers are
/// rejected: at most every fifth pose, and only while twelve remain.
///
/// A magnetometer with one axis negated, or two exchanged, is equivalent to a correct one in a
/// field of opposite dip. Only the dip of the location, `dip_rad`, positive down, resolves this;
/// its sign suffices. Without it the field is assumed to point down, as north of the magnetic
/// equator.
///
/// ```
/// use wimu_calib::{MagneticPose, magnetometer};
///
/// // A field of 50 µT, 60° down; hard iron of 10 µT on x; the chips' axes are parallel.
/// let mut poses = Vec::new();
/// for k in 0..20 {
///     // Any orientations: up and north as the sensor sees them.
///     let (a, b, c) = (0.9 * f64::from(k), 2.3 * f64::from(k), 1.7 * f64::from(k));
///     let up = [a.sin() * b.cos(), a.sin() * b.sin(), a.cos()];
///     let (e, f) = ([-b.sin(), b.cos(), 0.0], [a.cos() * b.cos(), a.cos() * b.sin(), -a.sin()]);
///     let north = [0, 1, 2].map(|i| c.cos() * e[i] + c.sin() * f[i]);
///     let field = [0, 1, 2].map(|i| 25_000.0 * north[i] - 43_301.0 * up[i]);
///     poses.push(MagneticPose { output_nt: [field[0] + 10_000.0, field[1], field[2]], up });
/// }
/// let found = magnetometer(&poses, None)?;
/// let model = found.model;
/// assert!(found.rejected.is_empty());
/// assert!((model.terms().hard_iron_nt[0] - 10_000.0).abs() < 1.0);
/// let mounting = model.terms().to_accelerometer.ok_or("a rotation")?;
/// assert!((mounting.dip_rad.to_degrees() - 60.0).abs() < 0.01);
/// // In Australia the field points up: there, the same readings are those of a mirrored sensor.
/// assert!(magnetometer(&poses, Some(-60_f64.to_radians())).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`Refusal`].
pub fn magnetometer(
    poses: &[MagneticPose],
    dip_rad: Option<f64>,
) -> Result<MagneticEstimate, Refusal> {
    let (have, need) = (poses.len(), FEWEST);
    if have < need {
        let text = format!(
            "{have} poses with a magnetic field, {need} or more are needed. Hold it in more orientations."
        );
        return Err(Refusal::new(Reason::TooFew { have, need }, text));
    }
    for (pose, entry) in poses.iter().enumerate() {
        let size = |v: [f64; 3]| Vector3::from(v).norm();
        if !(size(entry.output_nt) < 1e300 && size(entry.up) > 1e-6 && size(entry.up) < 1e9) {
            let text = format!(
                "The field or the direction of pose {pose} (from 0) is zero or not finite. Remove it."
            );
            return Err(Refusal::new(Reason::Input { index: pose }, text));
        }
    }
    plausible(poses)?;
    let found = without_suspects(poses, Vec::new()).or_else(|refusal| {
        // Several disturbed poses distort the fit so much that none is an outlier.
        let Some((share, disturbed)) = consensus::disturbed(poses) else {
            return Err(refusal);
        };
        let again =
            spares(have, disturbed.len()).then(|| without_suspects(poses, disturbed.clone()));
        again.and_then(Result::ok).ok_or_else(|| fit::not_constant(share, &disturbed))
    })?;
    handedness(&found.model, dip_rad)?;
    Ok(found)
}

/// Whether `left_out` of `have` poses may be rejected.
fn spares(have: usize, left_out: usize) -> bool {
    DOUBTED * left_out <= have && have - left_out >= FEWEST
}

/// Rejects outliers one by one.
fn without_suspects(
    poses: &[MagneticPose],
    mut rejected: Vec<usize>,
) -> Result<MagneticEstimate, Refusal> {
    loop {
        let mut suspect = None;
        let kept: Vec<usize> = (0..poses.len()).filter(|k| !rejected.contains(k)).collect();
        let outcome = fit::model(poses, &kept, &mut suspect);
        match suspect {
            Some(pose) if spares(poses.len(), rejected.len() + 1) => rejected.push(pose),
            _ => return outcome.map(|model| MagneticEstimate { model, rejected }),
        }
    }
}

/// Refuses a dip opposite to that of the location.
fn handedness(model: &MagnetometerModel, place_rad: Option<f64>) -> Result<(), Refusal> {
    let Some(mounting) = model.terms().to_accelerometer else {
        return Ok(());
    };
    let dip_rad = f64::from(mounting.dip_rad);
    let place_rad = place_rad.unwrap_or(core::f64::consts::FRAC_PI_4);
    let level = dip_rad.abs().min(place_rad.abs()) < LEVEL_RAD;
    if level || dip_rad * place_rad > 0.0 {
        return Ok(());
    }
    // Mirrored axes with the reflection M appear as a rotation by −M.
    let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        .map(|axis| Vector3::from(mounting.rotation.rotate(axis)));
    let turn = Matrix3::from_columns(&columns);
    let near = |mirror: &Matrix3<f64>| {
        let cosine = 0.5 * ((turn.transpose() * -mirror).trace() - 1.0);
        cosine > libm::cos(PARALLEL_RAD)
    };
    let negated = |axis: usize| {
        let mut mirror = Matrix3::identity();
        mirror[(axis, axis)] = -1.0;
        near(&mirror)
    };
    let exchanged = |axis: &usize| {
        let mut mirror = Matrix3::identity();
        mirror.swap_columns(*axis, (axis + 1) % 3);
        near(&mirror)
    };
    let axes = if near(&-Matrix3::identity()) {
        "all axes of the magnetometer are negated".into()
    } else if let Some(axis) = (0..3).find(|axis| negated(*axis)) {
        format!("the magnetometer's axis {} is negated", name(axis))
    } else if let Some(axis) = (0..3).find(exchanged) {
        let (first, second) = (axis.min((axis + 1) % 3), axis.max((axis + 1) % 3));
        format!("the magnetometer's axes {} and {} are exchanged", name(first), name(second))
    } else {
        String::from("an axis of the magnetometer is negated, or two are exchanged")
    };
    let text = format!(
        "The dip is {:+.0}°, opposite to that of the location: {axes}. Correct order and signs of its axes or, if they are \
         right, give the dip of the location (negative south of the magnetic equator)",
        dip_rad.to_degrees()
    );
    Err(Refusal::new(Reason::Axes, text))
}

/// Refuses an output that repeats exactly in orientations in which the field differs.
fn frozen(poses: &[MagneticPose]) -> Result<(), Refusal> {
    let up = |pose: &MagneticPose| Vector3::from(pose.up).normalize();
    for pose in poses {
        let is_equal = |other: &&MagneticPose| {
            other.output_nt == pose.output_nt && up(other).dot(&up(pose)) < DIFFERENT_COS
        };
        let count = poses.iter().filter(is_equal).count();
        if count + 1 >= FROZEN {
            let [x, y, z] = pose.output_nt.map(|nt| nt * 1e-3);
            let text = format!(
                "The magnetometer is frozen: it reads ({x:.2}, {y:.2}, {z:.2}) µT in {} poses that differ. Check its driver \
                 and its data-ready bit, and repeat them.",
                count + 1
            );
            return Err(Refusal::new(Reason::Axis { axis: 0, clipped: false }, text));
        }
    }
    Ok(())
}

/// The refusal of a field of this magnitude.
fn not_earths(field_nt: f64) -> Refusal {
    let text = format!(
        "The field is {:.3e} µT, that of the Earth 22 to 67. Check the unit (1 G is 100 µT), and that no magnet or motor is \
         near.",
        field_nt * 1e-3
    );
    Refusal::new(Reason::Unit { magnitude: field_nt, hint: UnitHint::NotGravity }, text)
}

/// Refuses outputs that cannot be those of a magnetometer rotated in the field of the Earth.
fn plausible(poses: &[MagneticPose]) -> Result<(), Refusal> {
    let limits = [0, 1, 2].map(|axis| input::extremes(poses.iter().map(|p| p.output_nt[axis])));
    let span = limits.map(|[low, high]| high - low);
    let widest = span.into_iter().fold(0.0, f64::max);
    let largest = limits.into_iter().flatten().map(f64::abs).fold(0.0, f64::max);
    let (fewest, most) = (EARTHS_NT.start(), EARTHS_NT.end());
    frozen(poses)?;
    if largest < 0.1 * fewest || widest > 10.0 * most {
        return Err(not_earths(largest.min(widest)));
    }
    if let Some(axis) = (0..3).find(|axis| span[*axis] < LEAST_SHARE * widest) {
        let text = format!(
            "Axis {} of the magnetometer reads the same in all poses: it is dead, or the rotation axis of every pose. Hold \
             the board on other sides.",
            name(axis)
        );
        return Err(Refusal::new(Reason::Axis { axis, clipped: false }, text));
    }
    // An axis with little variation has few values; repeating an orientation is not clipping.
    let clipped = (0..3).find(|axis| {
        let outputs = poses.iter().map(|pose| pose.output_nt);
        span[*axis] >= 0.3 * widest && input::is_clipped(outputs, *axis, 0.1 * widest, CLIPPED)
    });
    if let Some(axis) = clipped {
        let text = format!(
            "Axis {} of the magnetometer is saturated: it has the same extreme reading in several poses. Remove the magnet \
             nearby.",
            name(axis)
        );
        return Err(Refusal::new(Reason::Axis { axis, clipped: true }, text));
    }
    Ok(())
}
