//! Reasons why a magnetometer model cannot be estimated, and what to do.

use core::fmt;

use wimu_model::ModelError;

use crate::Rejected;
use crate::orientation::axis_name as name;

/// Why a magnetometer model cannot be estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum MagneticRefusal {
    /// Too few poses.
    TooFewPoses {
        /// Number of poses.
        have: usize,
        /// Required number of poses.
        need: usize,
    },
    /// A pose has a value that is zero, infinite or not a number.
    NotFinite {
        /// Its index.
        pose: usize,
    },
    /// The magnitude of the field is not that of the Earth: another unit, or not a field.
    NotEarths {
        /// Apparent magnitude, nT.
        field_nt: f64,
    },
    /// An axis has constant output.
    Dead {
        /// 0 = X.
        axis: usize,
    },
    /// An axis is clipped in several poses.
    Clipped {
        /// 0 = X.
        axis: usize,
        /// Its limit, nT.
        at_nt: f64,
    },
    /// The poses do not determine hard and soft iron, or a rotation.
    NotObservable {
        /// Condition number; infinite if singular.
        condition: f64,
    },
    /// The field was not the same in all poses.
    FieldNotConstant {
        /// Residual, fraction of the field, rms.
        share: f64,
        /// The outliers, or the pose with the largest residual.
        disturbed: Disturbed,
    },
    /// A single pose dominates the fit.
    PoorPrediction {
        /// Leave-one-out error, fraction of the field, rms.
        share: f64,
    },
    /// No rotation makes the dip the same in all poses.
    DipNotConstant {
        /// Standard deviation of the dip, rad.
        spread_rad: f64,
        /// The pose with the largest residual.
        pose: usize,
    },
    /// The dip is opposite to that of the location: the axes are left-handed.
    Mirrored {
        /// Apparent dip, rad, positive down.
        dip_rad: f64,
        /// The cause, if the axes of magnetometer and accelerometer are parallel.
        axes: MirroredAxes,
    },
    /// A parameter is out of bounds.
    OutOfBounds(ModelError),
}

/// Poses in a disturbed field, up to [`Disturbed::MOST`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Disturbed {
    poses: [u32; Self::MOST],
    count: u32,
}

impl Disturbed {
    /// Largest number of indices.
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

/// Cause of a left-handed magnetometer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MirroredAxes {
    /// This axis is negated: 0 = X.
    One(usize),
    /// All axes are negated.
    All,
    /// These two are exchanged.
    Exchanged(usize, usize),
    /// One axis is negated or two are exchanged. The magnetometer is not parallel to the
    /// accelerometer, so the cause cannot be identified.
    Unknown,
}

impl fmt::Display for MirroredAxes {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::One(axis) => write!(out, "the magnetometer's axis {} is negated", name(axis)),
            Self::All => out.write_str("all axes of the magnetometer are negated"),
            Self::Exchanged(a, b) => {
                write!(out, "the magnetometer's axes {} and {} are exchanged", name(a), name(b))
            }
            Self::Unknown => {
                out.write_str("an axis of the magnetometer is negated, or two are exchanged")
            }
        }
    }
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
                "pose {pose} (from 0) has a field or a direction that is zero or not finite: remove it"
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
                "the leave-one-out error is {:.2} % of the field rms, far above the residual: a single \
                 pose dominates the fit; add orientations",
                share * 100.0
            ),
            Self::DipNotConstant { spread_rad, pose } => write!(
                out,
                "the dip is not the same in all poses ({:.1}° rms, most in pose {pose} from 0): the \
                 field was disturbed, or field and direction are of different times; repeat the poses \
                 away from iron, currents and phones",
                spread_rad.to_degrees()
            ),
            Self::Mirrored { dip_rad, axes } => write!(
                out,
                "the field's dip seems to be {:+.0}°, opposite to that of the location: {axes}; correct \
                 the order and signs of its axes in the driver or, if they are right, give the dip of \
                 the location (negative south of the magnetic equator)",
                dip_rad.to_degrees()
            ),
            Self::OutOfBounds(error) => {
                write!(out, "the result is not plausible for a magnetometer: {error}")
            }
        }
    }
}

impl core::error::Error for MagneticRefusal {}
