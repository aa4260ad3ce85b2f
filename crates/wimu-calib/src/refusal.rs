//! Why data do not support a result: one type for all sensors and methods.

use alloc::format;
use alloc::string::String;
use core::fmt;

use wimu_model::ModelError;

/// Why the data do not support a result, and what to do.
#[derive(Clone, Debug, PartialEq)]
pub struct Refusal {
    /// The reason.
    pub reason: Reason,
    /// What is wrong, where, and what to do: one sentence in the words of the sensor.
    pub text: String,
}

/// Kinds of reasons. An index counts poses, rests, sessions or directions from 0; an axis is 0 = X.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Reason {
    /// Fewer observations than are needed.
    TooFew {
        /// Number of observations.
        have: usize,
        /// Required number.
        need: usize,
    },
    /// An observation has a value that cannot be used: not finite, or obtained in another way than the others.
    Input {
        /// Its index.
        index: usize,
    },
    /// The magnitude is not that of the quantity in the unit assumed.
    Unit {
        /// The magnitude, in the unit assumed.
        magnitude: f64,
        /// The probable unit.
        hint: UnitHint,
    },
    /// An axis is constant, or clipped at an end of its range.
    Axis {
        /// The axis.
        axis: usize,
        /// Whether it is clipped.
        clipped: bool,
    },
    /// Axes are exchanged or negated.
    Axes,
    /// The observations do not determine the unknowns.
    NotObservable,
    /// No values of the unknowns explain the observations.
    PoorFit {
        /// Residual, rms, in the unit of the observations.
        rms: f64,
        /// Index of the observation that fits worst.
        index: usize,
    },
    /// The leave-one-out error is much larger than the residuals: a single observation dominates the fit.
    PoorPrediction {
        /// Its index.
        index: usize,
    },
    /// An observation is an outlier that cannot be rejected: too few remain, or another one may be the outlier.
    Contradicted {
        /// Its index.
        index: usize,
        /// Another one that may be the outlier instead.
        or: Option<usize>,
    },
    /// The sensor was not at rest.
    Moved {
        /// Index of the rest, or the time in s.
        index: usize,
    },
    /// The poses are not in the orientations that the method needs.
    Placement {
        /// Index of the first of them.
        index: usize,
        /// Poses that belong together: 3 or 4 steps of a rotation, 6 sides.
        steps: usize,
    },
    /// A parameter is outside the bounds of the sensor.
    OutOfBounds(ModelError),
}

impl Refusal {
    pub(crate) fn new(reason: Reason, text: impl Into<String>) -> Self {
        Self { reason, text: text.into() }
    }

    /// A parameter that is not plausible for `sensor`.
    pub(crate) fn out_of_bounds(error: ModelError, sensor: &str) -> Self {
        let text = format!(
            "The result is not plausible for {sensor}: {error}. Check the unit, the sensitivity, and that no pose is \
             saturated or moving."
        );
        Self::new(Reason::OutOfBounds(error), text)
    }

    /// A magnitude in the wrong unit.
    pub(crate) fn unit(what: &str, magnitude: f64, hint: UnitHint) -> Self {
        Self::new(
            Reason::Unit { magnitude, hint },
            format!("The {what} is {magnitude:.4}, {hint}."),
        )
    }

    /// Poses whose mean magnitude cannot be gravity in m/s².
    pub fn unexpected_magnitude(mean_mps2: f64, hint: UnitHint) -> Self {
        Self::unit("poses' mean magnitude", mean_mps2, hint)
    }

    /// An axis with the same extreme reading in several poses.
    pub(crate) fn saturated(axis: usize) -> Self {
        let text = format!(
            "Axis {} is saturated: it has the same extreme reading in several poses. Choose a larger range and repeat the \
             poses.",
            crate::orientation::axis_name(axis)
        );
        Self::new(Reason::Axis { axis, clipped: true }, text)
    }

    /// An axis with the same reading in every pose, although the others change.
    pub(crate) fn stuck(axis: usize) -> Self {
        let text = format!(
            "Axis {} reads the same in every pose: it is dead, stuck at full scale, or was never rotated. Hold it up and \
             down, and check it.",
            crate::orientation::axis_name(axis)
        );
        Self::new(Reason::Axis { axis, clipped: false }, text)
    }

    /// Whether more poses, or priors, would help.
    pub fn needs_poses(&self) -> bool {
        let Self { reason, .. } = self;
        matches!(
            reason,
            Reason::TooFew { .. } | Reason::NotObservable | Reason::PoorPrediction { .. }
        )
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.text)
    }
}

impl core::error::Error for Refusal {}

/// The probable unit of values that are not m/s².
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnitHint {
    /// g.
    G,
    /// m/s² multiplied by 9.80665 again.
    Mps2TakenForG,
    /// mg, or counts of a sensor with about 1000 LSB/g.
    MilliGOrCounts,
    /// Raw counts.
    Counts,
    /// m/s² by a wrong sensitivity.
    Sensitivity,
    /// Normalised to unit length.
    Normalised,
    /// Not gravity in any known unit.
    NotGravity,
}

impl UnitHint {
    /// The probable unit of a mean magnitude that cannot be gravity in m/s².
    pub fn of(mean_mps2: f64, gravity_mps2: f64) -> Option<Self> {
        // Bias and scale factor within the bounds of the error model change |y| by less than this.
        if (0.4..=2.1).contains(&(mean_mps2 / gravity_mps2)) {
            return None;
        }
        Some(match mean_mps2 {
            m if (0.7..1.4).contains(&m) => Self::G,
            m if (85.0..108.0).contains(&m) => Self::Mps2TakenForG,
            m if (700.0..1400.0).contains(&m) => Self::MilliGOrCounts,
            m if m > 100.0 && m < 1e6 => Self::Counts,
            _ => Self::NotGravity,
        })
    }
}

/// The probable unit, and what to do.
impl fmt::Display for UnitHint {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::G => "which looks like g, not m/s²: name it in the columns, `(g)`, or by `--units g`",
            Self::Mps2TakenForG => {
                "which looks like m/s² converted as if it were g: `--units m/s2`; or the \
                 sensitivity is ten times too small"
            }
            Self::MilliGOrCounts => {
                "which looks like mg or counts, not m/s²: name the unit mg or LSB (`--units mg`)"
            }
            Self::Counts => {
                "which looks like counts, not m/s²: name the unit LSB (`--units LSB`)"
            }
            Self::Sensitivity => {
                "which is too far from gravity for a scale factor: the sensitivity is wrong"
            }
            Self::Normalised => {
                "equal in every pose: the data were normalised, which removes the errors of the \
                 sensor; give its raw output"
            }
            Self::NotGravity => {
                "not gravity in m/s²: check the unit, the sensitivity, and that the sensor measures \
                 on all axes"
            }
        })
    }
}
