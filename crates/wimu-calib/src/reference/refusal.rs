//! Reasons why two streams cannot be compared, and what to do.

use core::fmt;

use crate::UnitHint;
use crate::orientation::axis_name;

/// Why two streams say nothing about each other.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum TransferRefusal {
    /// Fewer pairs of samples than 8.
    TooFewSamples {
        /// How many there are.
        have: u64,
    },
    /// The size of a stream cannot be that of specific force in m/s².
    UnexpectedMagnitude {
        /// Whether it is the reference's.
        reference: bool,
        /// Its root mean square, m/s² if the unit were right.
        rms_mps2: f64,
        /// What the numbers look like.
        hint: UnitHint,
    },
    /// The axes move, but not together.
    NotTheSameMotion {
        /// 0 = X.
        axis: usize,
        /// Their correlation.
        correlation: f64,
    },
    /// One part of the motion alone decides the scale factor.
    OneMotionOnly {
        /// 0 = X.
        axis: usize,
    },
    /// A stream stops at one reading where the other goes on.
    Saturated {
        /// Whether it is the reference.
        reference: bool,
        /// 0 = X.
        axis: usize,
        /// The reading, m/s².
        at_mps2: f64,
        /// How many samples are at it.
        samples: u64,
    },
}

/// Streams correlated by less than this show the same motion with the other sign.
const NEGATED: f64 = -0.9;

impl fmt::Display for TransferRefusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooFewSamples { have } => write!(
                out,
                "{have} samples are on both streams, 8 are needed: record both at the same time"
            ),
            Self::UnexpectedMagnitude {
                reference,
                rms_mps2,
                hint,
            } => {
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
            Self::Saturated {
                reference,
                axis,
                at_mps2,
                samples,
            } => write!(
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
