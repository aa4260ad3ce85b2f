//! Turns left out of a gyroscope calibration.

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
