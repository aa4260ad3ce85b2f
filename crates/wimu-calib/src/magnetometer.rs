//! A magnetometer from the magnitude of the field and its dip, in orientations that nobody knows.

mod consensus;

use core::cmp::Ordering;
use core::fmt;

use nalgebra::{Cholesky, Matrix3, Rotation3, SMatrix, SVector, Vector3};
use wimu_model::{
    Alignment, MagnetometerError, MagnetometerModel, MagnetometerRotation, MagnetometerTerms,
    RotationCovariance,
};

use crate::linear::{Real, double, real};
use crate::{Rejected, student};

/// Parameters of hard and soft iron, and of the rotation with the dip.
const IRON: u32 = 9;
const ROTATION: u32 = 4;
/// Fewest poses: nine parameters of iron, and three to tell how good they are.
const FEWEST: usize = 12;
/// Beyond, the poses do not tell the model.
const MOST_CONDITION: f64 = 30.0;
/// Beyond, as a share of the field, this is no constant field.
const MOST_RMS: f64 = 0.05;
/// Left-out error per residual's standard deviation, at most.
const MOST_LEFT_OUT: f64 = 10.0;
/// The Earth's field is 22 to 67 µT; in buildings it is bent, hardly more than this, nT.
const EARTHS_NT: core::ops::RangeInclusive<f64> = 1e4..=1.2e5;
/// An axis that moves less than this share of what all of them do says nothing.
const LEAST_SHARE: f64 = 0.02;
/// So many poses at one and the same extreme are clipped.
const CLIPPED: usize = 4;
/// Chance that a good set of poses loses one.
const SIGNIFICANCE: f64 = 1e-3;
/// At most every fifth pose is doubted.
const DOUBTED: usize = 5;
/// Spread of the dip beyond which the axes do not belong together, rad rms.
const MOST_DIP_RMS: f64 = 0.1;
/// A dip nearer to level than this has no sign to tell a mirrored axis by, rad: 5°.
const LEVEL_RAD: f64 = 0.087;
/// Axes this near to parallel are, but for the board's turning them over, rad: 20°.
const PARALLEL_RAD: f64 = 0.35;

/// What magnetometer and accelerometer said in one orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MagneticPose {
    /// Output of the magnetometer, nT.
    pub output_nt: [f64; 3],
    /// Corrected specific force at rest, accelerometer axes, of any length.
    pub up: [f64; 3],
}

/// A magnetometer's model, and the poses that it does without.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MagneticEstimate {
    /// The model.
    pub model: MagnetometerModel,
    /// Poses that the others contradict: the field was disturbed there.
    pub rejected: Rejected,
}

impl MagneticEstimate {
    /// The 95 % interval of the hard iron is its value plus and minus this, nT: Student's t over the poses
    /// beyond the nine parameters of iron, equation (43).
    pub fn hard_iron_half_width_95_nt(&self) -> [f64; 3] {
        let terms = self.model.terms();
        terms.hard_iron_sd_nt.map(|sd| self.wide(IRON, sd.into()))
    }

    /// The same of the soft iron, xx yy zz xy xz yz.
    pub fn soft_iron_half_width_95(&self) -> [f64; 6] {
        let terms = self.model.terms();
        terms.soft_iron_sd.map(|sd| self.wide(IRON, sd.into()))
    }

    /// The same of the rotation's error about the accelerometer's axes, rad.
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

/// Why there is no model of a magnetometer.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum MagneticRefusal {
    /// Too few poses.
    TooFewPoses {
        /// How many there are.
        have: usize,
        /// How many are needed.
        need: usize,
    },
    /// A pose has a value that is zero, infinite or not a number.
    NotFinite {
        /// Its index.
        pose: usize,
    },
    /// The field is not of the Earth's size: its unit is another, or it is no field.
    NotEarths {
        /// What it seems to be, nT.
        field_nt: f64,
    },
    /// An axis says the same in all poses.
    Dead {
        /// 0 = X.
        axis: usize,
    },
    /// An axis stands at its limit in several poses.
    Clipped {
        /// 0 = X.
        axis: usize,
        /// Its limit, nT.
        at_nt: f64,
    },
    /// The poses do not determine hard and soft iron, or a rotation.
    NotObservable {
        /// Condition of the fit; infinite where there is none.
        condition: f64,
    },
    /// The field was not the same in all poses.
    FieldNotConstant {
        /// What is left, as a share of the field, rms.
        share: f64,
        /// The poses that depart from what most have in common, or the one that departs most.
        disturbed: Disturbed,
    },
    /// One pose decides alone.
    PoorPrediction {
        /// Left-out error, as a share of the field, rms.
        share: f64,
    },
    /// No rotation makes the dip the same in all poses.
    DipNotConstant {
        /// Its spread, rad rms.
        spread_rad: f64,
        /// The pose that departs most.
        pose: usize,
    },
    /// The dip is opposite to that of the place: the axes are left-handed.
    Mirrored {
        /// What it seems to be, rad, positive down.
        dip_rad: f64,
        /// What makes them so, where the magnetometer's axes are parallel to the accelerometer's.
        axes: MirroredAxes,
    },
    /// The result is no magnetometer's.
    OutOfBounds(MagnetometerError),
}

/// Poses in which the field was another, the first [`Disturbed::MOST`] of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Disturbed {
    poses: [u32; Self::MOST],
    count: u32,
}

impl Disturbed {
    /// More are not named.
    pub const MOST: usize = 16;

    /// Their indices.
    pub fn as_slice(&self) -> &[u32] {
        self.poses.get(..self.count as usize).unwrap_or(&[])
    }
}

impl From<Rejected> for Disturbed {
    fn from(rejected: Rejected) -> Self {
        let mut disturbed = Self::default();
        for (place, pose) in disturbed.poses.iter_mut().zip(rejected.as_slice()) {
            *place = u32::try_from(*pose).unwrap_or(u32::MAX);
            disturbed.count += 1;
        }
        disturbed
    }
}

/// What is wrong with a left-handed magnetometer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MirroredAxes {
    /// This axis is negated: 0 = X.
    One(usize),
    /// All axes are negated.
    All,
    /// These two are exchanged.
    Exchanged(usize, usize),
    /// One is negated or two are exchanged; the magnetometer is not mounted parallel to the
    /// accelerometer, so that nothing tells which.
    Unknown,
}

impl fmt::Display for MirroredAxes {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::One(axis) => write!(out, "the magnetometer's axis {} is negated", name(axis)),
            Self::All => out.write_str("all axes of the magnetometer are negated"),
            Self::Exchanged(a, b) => write!(
                out,
                "the magnetometer's axes {} and {} are exchanged",
                name(a),
                name(b)
            ),
            Self::Unknown => {
                out.write_str("an axis of the magnetometer is negated, or two are exchanged")
            }
        }
    }
}

fn name(axis: usize) -> &'static str {
    ["X", "Y", "Z"].get(axis).copied().unwrap_or("?")
}

impl fmt::Display for MagneticRefusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooFewPoses { have, need } => write!(
                out,
                "{have} poses with a magnetic field, {need} are needed: hold it in more orientations"
            ),
            Self::NotFinite { pose } => write!(
                out,
                "pose {pose} (from 0) has a field or a direction that is none: remove it"
            ),
            Self::NotEarths { field_nt } => write!(
                out,
                "the field seems to be {:.3e} µT, the Earth's is 22 to 67: check the unit (1 G is \
                 100 µT), and that no magnet or motor is near",
                field_nt * 1e-3
            ),
            Self::Dead { axis } => write!(
                out,
                "the magnetometer's axis {} says the same in all poses: it is dead, or every pose \
                 was turned about it; hold the board on other sides",
                name(axis)
            ),
            Self::Clipped { axis, at_nt } => write!(
                out,
                "the magnetometer's axis {} stands at {:.1} µT in several poses: it is at its limit; \
                 take away the magnet that drives it there",
                name(axis),
                at_nt * 1e-3
            ),
            Self::NotObservable { condition } => write!(
                out,
                "the poses do not determine hard and soft iron (condition {condition:.0}): add \
                 orientations unlike those you have, upside down and on every side"
            ),
            Self::FieldNotConstant { share, disturbed } => {
                write!(
                    out,
                    "the field was not the same in all poses ({:.0} % rms): it was disturbed",
                    share * 100.0
                )?;
                let poses = disturbed.as_slice();
                for (k, pose) in poses.iter().enumerate() {
                    let before = match k {
                        0 if poses.len() == 1 => " in pose ",
                        0 => " in poses ",
                        _ => ", ",
                    };
                    write!(out, "{before}{pose}")?;
                }
                if !poses.is_empty() {
                    out.write_str(" (from 0)")?;
                }
                if poses.len() == Disturbed::MOST {
                    out.write_str(" and more")?;
                }
                out.write_str(
                    "; take these again away from iron, currents and phones, and turn the sensor \
                     about one place",
                )
            }
            Self::PoorPrediction { share } => write!(
                out,
                "a pose left out is missed by {:.2} % of the field rms, far more than those that are fitted: one \
                 decides alone; add orientations",
                share * 100.0
            ),
            Self::DipNotConstant { spread_rad, pose } => write!(
                out,
                "the dip is not the same in all poses ({:.1}° rms, most in pose {pose} from 0): the \
                 field was disturbed, or field and direction are not of the same time; take the poses \
                 again away from iron, currents and phones",
                spread_rad.to_degrees()
            ),
            Self::Mirrored { dip_rad, axes } => write!(
                out,
                "the field's dip seems to be {:+.0}°, opposite to that of the place: {axes}; mend the \
                 order and signs of its axes where they are read, or say the dip of the place where \
                 that is no error (negative south of the magnetic equator)",
                dip_rad.to_degrees()
            ),
            Self::OutOfBounds(error) => write!(out, "the result is no magnetometer's: {error}"),
        }
    }
}

impl core::error::Error for MagneticRefusal {}

/// The places of xx, yy, zz, xy, xz, yz.
const PLACES: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

fn symmetric<R: Real>(w: &[R]) -> Matrix3<R> {
    let mut m = Matrix3::zeros();
    for (&(r, c), value) in PLACES.iter().zip(w) {
        m[(r, c)] = *value;
        m[(c, r)] = *value;
    }
    m
}

/// Hard and soft iron from |B| being the same in all poses, and the rotation to the accelerometer
/// from its dip being so. Equations (55) to (57) of docs/EQUATIONS.md. Poses that the others
/// contradict are left out, every fifth at most and as long as twelve are left.
///
/// A magnetometer with one axis negated or two exchanged looks like a right one in a field of the
/// opposite dip, turned over: only the dip of the place, `dip_rad`, positive down, tells them apart.
/// Its sign suffices. Without it the field points down, as north of the magnetic equator.
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
/// assert_eq!(found.rejected.as_slice(), []);
/// assert!((model.terms().hard_iron_nt[0] - 10_000.0).abs() < 1.0);
/// let mounting = model.terms().to_accelerometer.ok_or("a rotation")?;
/// assert!((mounting.dip_rad.to_degrees() - 60.0).abs() < 0.01);
/// // In Australia the field points up: there, the same readings are those of a mirrored sensor.
/// assert!(magnetometer(&poses, Some(-60_f64.to_radians())).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`MagneticRefusal`].
pub fn magnetometer(
    poses: &[MagneticPose],
    dip_rad: Option<f64>,
) -> Result<MagneticEstimate, MagneticRefusal> {
    estimate::<f64>(poses, dip_rad)
}

/// [`magnetometer`] computed in f32, for a processor that has no f64: within 0.001 standard deviations
/// of f64.
///
/// # Errors
/// Those of [`magnetometer`].
pub fn magnetometer_f32(
    poses: &[MagneticPose],
    dip_rad: Option<f64>,
) -> Result<MagneticEstimate, MagneticRefusal> {
    estimate::<f32>(poses, dip_rad)
}

fn estimate<R: Real>(
    poses: &[MagneticPose],
    dip_rad: Option<f64>,
) -> Result<MagneticEstimate, MagneticRefusal> {
    let (have, need) = (poses.len(), FEWEST);
    if have < need {
        return Err(MagneticRefusal::TooFewPoses { have, need });
    }
    for (pose, entry) in poses.iter().enumerate() {
        let size = |v: [f64; 3]| Vector3::from(v).norm();
        if !(size(entry.output_nt) < 1e300 && size(entry.up) > 1e-6 && size(entry.up) < 1e9) {
            return Err(MagneticRefusal::NotFinite { pose });
        }
    }
    plausible(poses)?;
    let found = without_suspects::<R>(poses, Rejected::default()).or_else(|refusal| {
        // Several disturbed poses bend the fit so far that none of them stands out.
        let Some((share, disturbed, count)) = consensus::disturbed::<R>(poses) else {
            return Err(refusal);
        };
        let few = count <= disturbed.as_slice().len() && spares(have, count);
        let again = few.then(|| without_suspects::<R>(poses, disturbed));
        again
            .and_then(Result::ok)
            .ok_or(MagneticRefusal::FieldNotConstant {
                share,
                disturbed: disturbed.into(),
            })
    })?;
    handedness(&found.model, dip_rad)?;
    Ok(found)
}

/// Whether so many of `have` poses may be left out.
fn spares(have: usize, left_out: usize) -> bool {
    left_out <= Rejected::MOST && DOUBTED * left_out <= have && have - left_out >= FEWEST
}

/// Leaves out one pose after the other that the rest contradicts.
fn without_suspects<R: Real>(
    poses: &[MagneticPose],
    mut rejected: Rejected,
) -> Result<MagneticEstimate, MagneticRefusal> {
    loop {
        let mut suspect = None;
        let outcome = model::<R>(poses, &rejected, &mut suspect);
        match suspect {
            Some(pose) if spares(poses.len(), rejected.as_slice().len() + 1) => {
                rejected = rejected.with(pose);
            }
            _ => return outcome.map(|model| MagneticEstimate { model, rejected }),
        }
    }
}

/// Refuses a dip that is opposite to that of the place.
fn handedness(model: &MagnetometerModel, place_rad: Option<f64>) -> Result<(), MagneticRefusal> {
    let Some(mounting) = model.terms().to_accelerometer else {
        return Ok(());
    };
    let dip_rad = f64::from(mounting.dip_rad);
    let place_rad = place_rad.unwrap_or(core::f64::consts::FRAC_PI_4);
    let level = dip_rad.abs().min(place_rad.abs()) < LEVEL_RAD;
    if level || dip_rad * place_rad > 0.0 {
        return Ok(());
    }
    // A mirror image M of the axes comes out as turned by −M.
    let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        .map(|axis| Vector3::from(mounting.rotation.rotate(axis)));
    let turn = Matrix3::from_columns(&columns);
    let near = |mirror: &Matrix3<f64>| {
        let cosine = 0.5 * ((turn.transpose() * -mirror).trace() - 1.0);
        cosine > libm::cos(PARALLEL_RAD)
    };
    let one = |axis: usize| {
        let mut mirror = Matrix3::identity();
        mirror[(axis, axis)] = -1.0;
        mirror
    };
    let exchanged = |a: usize, b: usize| {
        let mut mirror = Matrix3::identity();
        mirror.swap_columns(a, b);
        mirror
    };
    let pairs = [(0, 1), (1, 2), (0, 2)];
    let axes = if near(&-Matrix3::identity()) {
        MirroredAxes::All
    } else if let Some(axis) = (0..3).find(|axis| near(&one(*axis))) {
        MirroredAxes::One(axis)
    } else if let Some((a, b)) = pairs.into_iter().find(|(a, b)| near(&exchanged(*a, *b))) {
        MirroredAxes::Exchanged(a, b)
    } else {
        MirroredAxes::Unknown
    };
    Err(MagneticRefusal::Mirrored { dip_rad, axes })
}

/// Whether the output can be that of a magnetometer turned in the Earth's field.
fn plausible(poses: &[MagneticPose]) -> Result<(), MagneticRefusal> {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for pose in poses {
        for axis in 0..3 {
            low[axis] = low[axis].min(pose.output_nt[axis]);
            high[axis] = high[axis].max(pose.output_nt[axis]);
        }
    }
    let span: [f64; 3] = core::array::from_fn(|axis| high[axis] - low[axis]);
    let widest = span.iter().fold(0.0, |most: f64, span| most.max(*span));
    let largest = low
        .iter()
        .chain(&high)
        .fold(0.0, |most: f64, v| most.max(v.abs()));
    let (fewest, most) = (EARTHS_NT.start(), EARTHS_NT.end());
    if largest < 0.1 * fewest || widest > 10.0 * most {
        return Err(MagneticRefusal::NotEarths {
            field_nt: largest.min(widest),
        });
    }
    if let Some(axis) = (0..3).find(|axis| span[*axis] < LEAST_SHARE * widest) {
        return Err(MagneticRefusal::Dead { axis });
    }
    for (axis, limit) in (0..3).flat_map(|axis| [(axis, low[axis]), (axis, high[axis])]) {
        let at = || poses.iter().filter(|pose| pose.output_nt[axis] == limit);
        // An axis that hardly moves has few values.
        if span[axis] < 0.3 * widest {
            continue;
        }
        // The same orientation over and over is no limit.
        let elsewhere = |pose: &&MagneticPose| {
            at().next().is_some_and(|first| {
                (0..3).any(|other| {
                    let apart = pose.output_nt[other] - first.output_nt[other];
                    other != axis && apart.abs() > 0.1 * widest
                })
            })
        };
        if at().count() >= CLIPPED && at().filter(elsewhere).count() + 1 >= CLIPPED {
            let at_nt = limit;
            return Err(MagneticRefusal::Clipped { axis, at_nt });
        }
    }
    Ok(())
}

/// Outputs about their centre, in units of their spread, so that all parameters are of order one.
struct Scaled<R: Real> {
    /// The first output, nT: what differs from it keeps its digits.
    origin: [f64; 3],
    centre: Vector3<R>,
    unit_nt: R,
}

impl<R: Real> Scaled<R> {
    fn of<'a>(poses: impl Iterator<Item = &'a MagneticPose> + Clone) -> Option<Self> {
        let first = poses.clone().next()?;
        let mut scaled = Self {
            origin: first.output_nt,
            centre: Vector3::zeros(),
            unit_nt: R::one(),
        };
        let (mut sum, mut count) = (Vector3::zeros(), R::zero());
        for pose in poses.clone() {
            sum += scaled.point(pose);
            count += R::one();
        }
        scaled.centre = sum / count;
        let squares = poses.fold(R::zero(), |sum, pose| {
            sum + scaled.point(pose).norm_squared()
        });
        scaled.unit_nt = (squares / count).sqrt();
        (scaled.unit_nt >= R::one()).then_some(scaled)
    }

    fn point(&self, pose: &MagneticPose) -> Vector3<R> {
        let off = Vector3::from_fn(|k, _| real::<R>(pose.output_nt[k] - self.origin[k]));
        (off - self.centre) / self.unit_nt
    }

    /// The output that a point stands for, nT.
    fn output_nt(&self, point: &Vector3<R>) -> [f32; 3] {
        let off = self.centre + point * self.unit_nt;
        core::array::from_fn(|k| (self.origin[k] + double(off[k])) as f32)
    }
}

/// Hard iron, then W, the inverse of the soft iron per the field.
type Iron<R> = SVector<R, 9>;

fn hard<R: Real>(theta: &Iron<R>) -> Vector3<R> {
    Vector3::new(theta[0], theta[1], theta[2])
}

fn inverse_soft<R: Real>(theta: &Iron<R>) -> Matrix3<R> {
    symmetric(&theta.as_slice()[3..])
}

/// |B| − 1 at a point, and its derivatives.
fn row<R: Real>(theta: &Iron<R>, point: Vector3<R>) -> (R, Iron<R>) {
    let w = inverse_soft(theta);
    let off = point - hard(theta);
    let field = w * off;
    let size = field.norm();
    let ahead = field / size;
    let back = -(w * ahead);
    let mut row = Iron::zeros();
    for k in 0..3 {
        row[k] = back[k];
    }
    for (k, (r, c)) in PLACES.into_iter().enumerate() {
        row[3 + k] = ahead[r] * off[c];
        if r != c {
            row[3 + k] += ahead[c] * off[r];
        }
    }
    (size - R::one(), row)
}

/// A step so small that the next is rounding.
fn last_step<R: Real>() -> R {
    R::default_epsilon() * real(500.0)
}

/// The model of all poses but those rejected; `suspect` is the pose that the others contradict most,
/// if one is beyond chance.
fn model<R: Real>(
    all: &[MagneticPose],
    rejected: &Rejected,
    suspect: &mut Option<usize>,
) -> Result<MagnetometerModel, MagneticRefusal> {
    let poses = || {
        let kept = all.iter().enumerate();
        kept.filter(|(place, _)| !rejected.contains(*place))
    };
    let have = poses().count();
    let n = have as f64;
    let none = MagneticRefusal::NotObservable {
        condition: f64::INFINITY,
    };
    let scaled = Scaled::<R>::of(poses().map(|(_, pose)| pose)).ok_or(none)?;
    let points = || poses().map(|(place, pose)| (place, scaled.point(pose)));
    let mut theta = start(points().map(|(_, point)| point)).ok_or(none)?;
    let mut information = SMatrix::<R, 9, 9>::zeros();
    for _ in 0..50 {
        information = SMatrix::zeros();
        let mut gradient = Iron::zeros();
        for (_, point) in points() {
            let (residual, row) = row(&theta, point);
            information.ger(R::one(), &row, &row, R::one());
            gradient.axpy(residual, &row, R::one());
        }
        let step = Cholesky::new(information).ok_or(none)?.solve(&gradient);
        theta -= step;
        if step.norm() < last_step() {
            break;
        }
    }
    let inverse = Cholesky::new(information).ok_or(none)?.inverse();
    let values = information.symmetric_eigenvalues();
    let condition = double((values.max() / values.min()).sqrt());
    if condition.is_nan() || condition > MOST_CONDITION {
        return Err(MagneticRefusal::NotObservable { condition });
    }
    let (mut squares, mut left_out) = (0.0, 0.0);
    let mut worst = Worst::default();
    for (place, point) in points() {
        let (residual, row) = row(&theta, point);
        let residual = double(residual);
        let left = 1.0 - double(row.dot(&(inverse * row)));
        squares += residual * residual;
        left_out += (residual / left) * (residual / left);
        worst.take(place, residual * residual / left);
    }
    *suspect = worst.beyond_chance(squares, have, 9);
    let (rms, loo) = (libm::sqrt(squares / n), libm::sqrt(left_out / n));
    let variance = squares / (n - 9.0);
    if rms.is_nan() || rms > MOST_RMS {
        return Err(MagneticRefusal::FieldNotConstant {
            share: rms,
            disturbed: Rejected::default().with(worst.place).into(),
        });
    }
    if loo.is_nan() || loo > (MOST_LEFT_OUT * libm::sqrt(variance)).max(1e-4) {
        return Err(MagneticRefusal::PoorPrediction { share: loo });
    }
    // The iron alone leaves the unit of the field open: S has determinant one.
    let w = inverse_soft(&theta);
    let raw = w.try_inverse().ok_or(none)?;
    let size = raw.determinant().cbrt();
    // Also where it is none.
    if !matches!(size.partial_cmp(&R::zero()), Some(Ordering::Greater)) {
        return Err(none);
    }
    let s = raw / size;
    let sd = |slope: &Iron<R>| libm::sqrt(variance * double(slope.dot(&(inverse * slope))));
    let mut soft_sd = [0.0; 6];
    for (sd_of, (r, c)) in soft_sd.iter_mut().zip(PLACES) {
        let mut slope = Iron::zeros();
        for (k, (i, j)) in PLACES.into_iter().enumerate() {
            // dS = −S dW S/det^⅓ and what keeps the determinant.
            let mut along = raw[(r, i)] * raw[(j, c)];
            let mut trace = raw[(i, j)];
            if i != j {
                along += raw[(r, j)] * raw[(i, c)];
                trace += raw[(j, i)];
            }
            slope[3 + k] = (raw[(r, c)] * trace / real(3.0) - along) / size;
        }
        *sd_of = sd(&slope);
    }
    let back = w * size;
    let hard = hard(&theta);
    let seen = |(place, pose): (usize, &MagneticPose)| {
        let field = back * (scaled.point(pose) - hard);
        let up = Vector3::from(pose.up.map(real::<R>));
        (place, field.normalize(), up.normalize())
    };
    let field_nt = double(size * scaled.unit_nt);
    if !EARTHS_NT.contains(&field_nt) {
        return Err(MagneticRefusal::NotEarths { field_nt });
    }
    let (to_accelerometer, bent) = rotation(|| poses().map(seen))?;
    *suspect = suspect.or(bent);
    let unit_nt = double(scaled.unit_nt);
    let terms = MagnetometerTerms {
        hard_iron_nt: scaled.output_nt(&hard),
        hard_iron_sd_nt: [0, 1, 2]
            .map(|k| (unit_nt * libm::sqrt(variance * double(inverse[(k, k)]))) as f32),
        soft_iron: PLACES.map(|(r, c)| double(s[(r, c)]) as f32),
        soft_iron_sd: soft_sd.map(|sd| sd as f32),
        field_nt: field_nt as f32,
        poses: u32::try_from(have).unwrap_or(u32::MAX),
        rms_nt: (rms * field_nt) as f32,
        loo_rms_nt: (loo * field_nt) as f32,
        condition: condition.max(1.0) as f32,
        to_accelerometer: Some(to_accelerometer),
    };
    MagnetometerModel::new(terms).map_err(MagneticRefusal::OutOfBounds)
}

/// The ellipsoid mᵀQm + 2pᵀm = 1 by linear least squares, as (11), with the symmetric root.
fn start<R: Real>(points: impl Iterator<Item = Vector3<R>>) -> Option<Iron<R>> {
    let mut information = SMatrix::<R, 9, 9>::zeros();
    let mut right = Iron::zeros();
    let two: R = real(2.0);
    for m in points {
        let row = Iron::from_fn(|k, _| match k {
            0..3 => two * m[k],
            k => {
                let (r, c) = PLACES[k - 3];
                let product = m[r] * m[c];
                if r == c { product } else { two * product }
            }
        });
        information.ger(R::one(), &row, &row, R::one());
        right += row;
    }
    let solution = Cholesky::new(information)?.solve(&right);
    let q = inverse_soft(&solution);
    let centre = -(q.try_inverse()? * hard(&solution));
    let size = R::one() + centre.dot(&(q * centre));
    let eigen = (q / size).symmetric_eigen();
    let positive = eigen.eigenvalues.iter().all(|value| *value > R::zero());
    let roots = Matrix3::from_diagonal(&eigen.eigenvalues.map(|v| v.max(R::zero()).sqrt()));
    let w = eigen.eigenvectors * roots * eigen.eigenvectors.transpose();
    let mut theta = Iron::zeros();
    for k in 0..3 {
        theta[k] = centre[k];
    }
    for (k, place) in PLACES.into_iter().enumerate() {
        theta[3 + k] = w[place];
    }
    (positive && theta.iter().all(|t| t.is_finite())).then_some(theta)
}

/// up · R b less the level that it is to have, and its derivatives: a small rotation δ of R b adds
/// δ × R b.
fn level_row<R: Real>(
    turn: &Rotation3<R>,
    level: R,
    b: &Vector3<R>,
    up: &Vector3<R>,
) -> (R, SVector<R, 4>) {
    let turned = turn * b;
    let slope = turned.cross(up);
    let row = SVector::from([slope.x, slope.y, slope.z, -R::one()]);
    (up.dot(&turned) - level, row)
}

/// The rotation from magnetometer to accelerometer under which up · R b is the same in all poses: their
/// places, b and up; and the pose that the others contradict most, if one is beyond chance.
fn rotation<R: Real, I: Iterator<Item = (usize, Vector3<R>, Vector3<R>)>>(
    seen: impl Fn() -> I,
) -> Result<(MagnetometerRotation, Option<usize>), MagneticRefusal> {
    let have = seen().count();
    let n = have as f64;
    let none = MagneticRefusal::NotObservable {
        condition: f64::INFINITY,
    };
    let mut best: Option<(R, Rotation3<R>, R, SMatrix<R, 4, 4>)> = None;
    // The 24 ways in which chips' axes can lie to each other are the starts.
    for turn in 0..24 {
        let quarters = |count: i32| R::frac_pi_2() * real(f64::from(count));
        let face = match turn / 4 {
            count @ 0..4 => Rotation3::from_axis_angle(&Vector3::x_axis(), quarters(count)),
            4 => Rotation3::from_axis_angle(&Vector3::y_axis(), quarters(1)),
            _ => Rotation3::from_axis_angle(&Vector3::y_axis(), quarters(-1)),
        };
        let mut r = face * Rotation3::from_axis_angle(&Vector3::z_axis(), quarters(turn % 4));
        let mut level = R::zero();
        let mut last: Option<(R, SMatrix<R, 4, 4>)> = None;
        for _ in 0..30 {
            let mut information = SMatrix::<R, 4, 4>::zeros();
            let mut gradient = SVector::<R, 4>::zeros();
            let mut cost = R::zero();
            for (_, b, up) in seen() {
                let (residual, row) = level_row(&r, level, &b, &up);
                information.ger(R::one(), &row, &row, R::one());
                gradient.axpy(residual, &row, R::one());
                cost += residual * residual;
            }
            last = Some((cost, information));
            let Some(factor) = Cholesky::new(information) else {
                break;
            };
            let step = -factor.solve(&gradient);
            r = Rotation3::new(Vector3::new(step[0], step[1], step[2])) * r;
            level += step[3];
            if step.norm() < last_step() {
                break;
            }
        }
        let Some((cost, information)) = last else {
            continue;
        };
        if best.as_ref().is_none_or(|(least, ..)| cost < *least) {
            best = Some((cost, r, level, information));
        }
    }
    let (cost, r, level, information) = best.ok_or(none)?;
    let inverse = Cholesky::new(information).ok_or(none)?.inverse();
    let cost = double(cost);
    let sine = double(level).clamp(-1.0, 1.0);
    let cosine = libm::sqrt((1.0 - sine * sine).max(0.01));
    let spread_rad = libm::sqrt(cost / n) / cosine;
    let variance = cost / (n - 4.0);
    let mut worst = Worst::default();
    for (place, b, up) in seen() {
        let (residual, row) = level_row(&r, level, &b, &up);
        let left = R::one() - row.dot(&(inverse * row));
        worst.take(place, double(residual * residual / left));
    }
    if spread_rad.is_nan() || spread_rad > MOST_DIP_RMS {
        let pose = worst.place;
        return Err(MagneticRefusal::DipNotConstant { spread_rad, pose });
    }
    let covariance: [[f64; 3]; 3] =
        core::array::from_fn(|a| core::array::from_fn(|b| variance * double(inverse[(a, b)])));
    let q = nalgebra::UnitQuaternion::from_rotation_matrix(&r);
    let found = MagnetometerRotation {
        rotation: Alignment::from_quaternion([q.w, q.i, q.j, q.k].map(double)).map_err(|_| none)?,
        covariance: RotationCovariance::from_matrix(&covariance).map_err(|_| none)?,
        // Down is minus up.
        dip_rad: -libm::asin(sine) as f32,
        dip_rms_rad: spread_rad as f32,
    };
    Ok((found, worst.beyond_chance(cost, have, 4)))
}

/// The pose that fits worst.
#[derive(Default)]
struct Worst {
    place: usize,
    /// Its r²/(1 − h).
    square: f64,
}

impl Worst {
    fn take(&mut self, place: usize, square: f64) {
        if square > self.square {
            *self = Self { place, square };
        }
    }

    /// It, where it is further from the model of the others than the worst of so many poses is by
    /// chance: equation (16), with the variance that the others show.
    fn beyond_chance(&self, squares: f64, poses: usize, parameters: usize) -> Option<usize> {
        let freedom = poses.checked_sub(parameters + 1).filter(|left| *left > 1)? as f64;
        let variance = (squares - self.square) / freedom;
        let most = student::two_sided(SIGNIFICANCE / poses as f64, freedom);
        // What is rounding is no contradiction.
        (self.square > 1e-12 && self.square > most * most * variance).then_some(self.place)
    }
}
