//! Reasons why a session does not give the errors of a gyroscope, and advice.

use core::fmt;

use wimu_model::ModelError;

use crate::orientation::axis_name as name;

/// Why a session gives no gyroscope model.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum GyroscopeRefusal {
    /// There is no rest.
    NoRest,
    /// The samples of a rest are missing or not finite.
    NotFinite {
        /// Its index.
        rest: usize,
    },
    /// At a rest the specific force is not gravity, or the rate differs from that at other rests.
    NotAtRest {
        /// Its index.
        rest: usize,
        /// Mean output there minus the mean over the rests, rad/s.
        rate_rad_s: f64,
    },
    /// All rates are this many times too large or too small.
    Unit {
        /// Output over angular rate.
        factor: f64,
    },
    /// Axes are exchanged or negated.
    Axes {
        /// For X, Y, Z of the accelerometer, the axis of the gyroscope that measures the rate about it,
        /// and whether it is negated.
        axes: [(usize, bool); 3],
    },
    /// The rotations do not predict the direction of gravity.
    Inconsistent {
        /// Error of the prediction, rad rms.
        rms_rad: f64,
        /// The turn with the largest error: from this rest to the next.
        worst_turn: usize,
    },
    /// The result is not plausible for a gyroscope.
    OutOfBounds(ModelError),
}

impl fmt::Display for GyroscopeRefusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::NoRest => out.write_str("no rest was found: hold the sensor still for two seconds"),
            Self::NotFinite { rest } => write!(
                out,
                "samples of rest {rest} (from 0) are missing or not finite: remove it"
            ),
            Self::NotAtRest { rest, rate_rad_s } => write!(
                out,
                "the sensor was not at rest in rest {rest} (from 0), it rotated by {:.1} °/s or accelerated: put it down there",
                rate_rad_s.to_degrees()
            ),
            Self::Unit { factor } => match factor {
                50.0..65.0 => out.write_str(
                    "the angular rates are 57.3 times too large: they are probably in deg/s, name that unit in the columns",
                ),
                0.015..0.02 => out.write_str(
                    "the angular rates are 57.3 times too small: they are probably in rad/s, name that unit in the columns",
                ),
                _ => write!(
                    out,
                    "the angular rates are about {factor} times the rotation: check the sensitivity and the full-scale range of the gyroscope"
                ),
            },
            Self::Axes { axes } => {
                out.write_str("the axes of gyroscope and accelerometer differ: the rates about ")?;
                for (axis, (of, negated)) in axes.into_iter().enumerate() {
                    let sign = if negated { "−" } else { "" };
                    let comma = if axis < 2 { ", " } else { "" };
                    write!(out, "{} = {sign}{}{comma}", name(axis), name(of))?;
                }
                out.write_str(" of the gyroscope; correct order and signs in the driver or the columns")
            }
            Self::Inconsistent {
                rms_rad,
                worst_turn,
            } => write!(
                out,
                "the rotations predict gravity with an error of {:.1}° rms, the largest after rest {worst_turn} (from 0): check \
                 units and times, or repeat the turns more slowly",
                rms_rad.to_degrees()
            ),
            Self::OutOfBounds(error) => write!(out, "the result is not plausible: {error}"),
        }
    }
}

impl core::error::Error for GyroscopeRefusal {}

/// Why a turn was left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TurnFault {
    /// Samples are missing.
    Gap,
    /// An axis of the gyroscope was saturated.
    Saturated {
        /// 0 = X.
        axis: usize,
    },
    /// The other turns contradict it.
    Contradicted,
}

impl fmt::Display for TurnFault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Gap => out.write_str("samples are missing"),
            Self::Saturated { axis } => write!(out, "axis {} is saturated", name(axis)),
            Self::Contradicted => out.write_str("the other turns contradict it"),
        }
    }
}

/// The movement that improves a gyroscope calibration most.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GyroscopeAdvice {
    /// Rotate about this axis, held level.
    Turn {
        /// 0 = X.
        axis: usize,
    },
    /// Rest with this axis up, and with it down.
    Rest {
        /// 0 = X.
        axis: usize,
    },
}

impl fmt::Display for GyroscopeAdvice {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Turn { axis } => write!(
                out,
                "hold axis {} level, rotate by 90° to 180° about it within three seconds, and hold still; start with \
                 different sides up",
                name(axis)
            ),
            Self::Rest { axis } => {
                write!(out, "hold still with {0} up, and with {0} down", name(axis))
            }
        }
    }
}
