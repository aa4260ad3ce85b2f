//! Reasons why a recording does not support a noise model, and what to do.

use core::fmt;

use crate::UnitHint;
use crate::orientation::axis_name;

/// Why a recording does not support a noise model.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum NoiseRefusal {
    /// Too few samples.
    TooShort {
        /// Samples without a gap.
        have: u64,
        /// Required samples.
        need: u64,
    },
    /// The sensor was not at rest.
    NotAtRest {
        /// Time, s from the first sample.
        at_s: f64,
        /// 0 = X.
        axis: usize,
    },
    /// An axis has constant output.
    Dead {
        /// 0 = X.
        axis: usize,
    },
    /// The mean output is not gravity in m/s².
    UnexpectedMagnitude {
        /// Its magnitude, m/s² if the unit were right.
        mean_mps2: f64,
        /// The probable unit.
        hint: UnitHint,
    },
}

impl fmt::Display for NoiseRefusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooShort { have, need } => write!(
                out,
                "{have} samples at rest without a gap, {need} are needed: record for longer; ten \
                 minutes give the noise density, an hour or more the bias instability"
            ),
            Self::NotAtRest { at_s, axis } => write!(
                out,
                "the sensor was not at rest: axis {} moved about {at_s:.0} s after the start; leave \
                 it on a firm floor, and record again or cut that part out",
                axis_name(axis)
            ),
            Self::Dead { axis } => write!(
                out,
                "axis {} has constant output: it is dead or saturated, or its noise is below \
                 one count; choose a smaller range or a higher resolution",
                axis_name(axis)
            ),
            Self::UnexpectedMagnitude { mean_mps2, hint } => {
                write!(out, "the mean output is {mean_mps2:.4}, {hint}")
            }
        }
    }
}

impl core::error::Error for NoiseRefusal {}
