//! Reasons why two streams cannot be compared, and what to do.

use core::fmt;

use crate::UnitHint;
use crate::orientation::axis_name;

/// Why two streams cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum TransferRefusal {
    /// Fewer pairs of samples than 8.
    TooFewSamples {
        /// Number of pairs.
        have: u64,
    },
    /// The magnitude of a stream cannot be specific force in m/s².
    UnexpectedMagnitude {
        /// Whether it is the reference's.
        reference: bool,
        /// Its root mean square, m/s² if the unit were right.
        rms_mps2: f64,
        /// The probable unit.
        hint: UnitHint,
    },
    /// The motions of the two streams differ.
    NotTheSameMotion {
        /// 0 = X.
        axis: usize,
        /// Correlation coefficient.
        correlation: f64,
    },
    /// A single part of the motion determines the scale factor.
    OneMotionOnly {
        /// 0 = X.
        axis: usize,
    },
    /// A stream is clipped while the other one continues.
    Saturated {
        /// Whether it is the reference.
        reference: bool,
        /// 0 = X.
        axis: usize,
        /// The reading, m/s².
        at_mps2: f64,
        /// Number of samples at it.
        samples: u64,
    },
}

/// Correlation below which one stream is the negated other.
const NEGATED: f64 = -0.9;

impl fmt::Display for TransferRefusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooFewSamples { have } => write!(
                out,
                "{have} samples are on both streams, 8 are needed: record both at the same time"
            ),
            Self::UnexpectedMagnitude { reference, rms_mps2, hint } => {
                let which = if reference { "reference" } else { "output" };
                write!(out, "the {which} is {rms_mps2:.4} rms, {hint}")
            }
            Self::NotTheSameMotion { axis, correlation } if correlation < NEGATED => write!(
                out,
                "axis {} of one stream is that of the other negated (correlated by {correlation:.2}): turn its \
                 sign in one of them, or check how the sensors are mounted",
                axis_name(axis)
            ),
            Self::NotTheSameMotion { axis, correlation } => write!(
                out,
                "axis {} of the two streams is correlated by {correlation:.2} only: they show \
                 different motions; check that samples are paired in time, and axes and their signs",
                axis_name(axis)
            ),
            Self::OneMotionOnly { axis } => write!(
                out,
                "all motion of axis {} is in one short part of the recording, which decides alone: \
                 move it more than once, or hold it in several orientations",
                axis_name(axis)
            ),
            Self::Saturated { reference, axis, at_mps2, samples } => write!(
                out,
                "axis {} of the {} stops at {at_mps2:.3} m/s² in {samples} samples while the other goes \
                 on: it is saturated; choose a larger range, or move it less",
                axis_name(axis),
                if reference { "reference" } else { "output" }
            ),
        }
    }
}

impl core::error::Error for TransferRefusal {}
