//! Turns left out of a gyroscope calibration, and the movement that would improve it.

use core::fmt;

use crate::orientation::axis_name as name;

/// Why a turn was left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
