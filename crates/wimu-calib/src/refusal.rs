//! Reasons why poses do not support an estimate, and what to do.

use core::fmt;

use wimu_model::ModelError;

use crate::orientation::axis_name;
use crate::{Face, Model, Orientation, Parameters, Term, Terms};

/// Why the poses do not support an estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Refusal {
    /// Fewer poses than the model needs.
    TooFewPoses {
        /// Number of poses.
        have: usize,
        /// Required number of poses.
        need: usize,
        /// The model asked for.
        model: Model,
        /// The largest smaller model that these poses do support, if one.
        instead: Option<Model>,
    },
    /// No pose has this side up.
    PoseMissing {
        /// The side.
        face: Face,
    },
    /// A pose has a value that is infinite or not a number.
    NotFinite {
        /// Its index.
        pose: usize,
    },
    /// The poses' mean magnitude cannot be gravity in m/s².
    UnexpectedMagnitude {
        /// The mean of |y|, m/s² if the unit were right.
        mean_mps2: f64,
        /// The probable unit.
        hint: UnitHint,
    },
    /// The poses do not determine some parameters.
    NotObservable {
        /// The model asked for.
        model: Model,
        /// The parameters that are poorly determined.
        parameters: Parameters,
        /// The terms that are poorly determined.
        terms: Terms,
        /// Condition of the Jacobian, its parameters scaled to m/s² at 1 g.
        condition: f64,
        /// Amplification of an error from the poses to the worst orientation.
        amplification: f64,
        /// A pose in this orientation would help most.
        add: Orientation,
        /// The largest smaller model that these poses do support, if one.
        instead: Option<Model>,
    },
    /// Typical values of the parameters that the model leaves out would bias those it fits.
    Confounded {
        /// The model asked for.
        model: Model,
        /// The parameters that are not determined.
        parameters: Parameters,
        /// The terms that are not determined.
        terms: Terms,
        /// A pose in this orientation would help most.
        add: Orientation,
        /// The largest smaller model that these poses do support, if one.
        instead: Option<Model>,
    },
    /// An axis has the same reading in every pose, although the others change.
    AxisStuck {
        /// 0 = X.
        axis: usize,
    },
    /// An axis is clipped in several poses.
    Saturated {
        /// 0 = X.
        axis: usize,
    },
    /// A term is not observable: the poses have no times or temperatures, or equal ones.
    TermNotObservable {
        /// The term asked for.
        term: Term,
    },
    /// Poses are not successive steps of rotations about a horizontal axis.
    NotATurn {
        /// Index of the first pose of the rotation.
        pose: usize,
        /// Steps of a rotation: 3 or 4.
        steps: usize,
    },
    /// The steps of a rotation are unequal.
    StepsUnequal {
        /// Index of the first pose of the rotation.
        pose: usize,
        /// Steps of a rotation: 3 or 4.
        steps: usize,
        /// Lower bound on the step error, rad rms.
        off_rad: f64,
    },
    /// The axis of rotation is not horizontal, or not an axis of the sensor.
    TurnTilted {
        /// Index of the first pose of the rotation.
        pose: usize,
        /// Steps of a rotation: 3 or 4.
        steps: usize,
        /// Tilt, rad; if it may be bias, the bias in g.
        off_rad: f64,
    },
    /// The leave-one-out error is much larger than the residuals: a single pose dominates the fit,
    /// and an error in it would not show.
    PoorPrediction {
        /// The model asked for.
        model: Model,
        /// Leave-one-out error, m/s² rms; infinite where a pose cannot be spared.
        loo_rms_mps2: f64,
        /// In-sample error, m/s² rms.
        rms_mps2: f64,
        /// Index of the pose with the largest leave-one-out error.
        pose: usize,
        /// The largest smaller model that these poses do support, if one.
        instead: Option<Model>,
    },
    /// A pose is an outlier, but cannot be rejected: too few remain, or another one may be the
    /// outlier.
    PoseContradicted {
        /// Index of the pose with the largest residual.
        pose: usize,
        /// Another pose that may be the outlier instead.
        or: Option<usize>,
        /// Residual of the pose under the model fitted without it, m/s².
        off_mps2: f64,
    },
    /// No error model fits the poses.
    PoorFit {
        /// In-sample error, m/s² rms.
        rms_mps2: f64,
        /// The pose that fits worst, its index.
        pose: usize,
    },
    /// The fit did not converge.
    NotConverged,
    /// Some poses are in g, the others in m/s².
    MixedUnits {
        /// Index of the first of them.
        pose: usize,
    },
    /// A parameter is outside the bounds of an accelerometer.
    OutOfBounds(ModelError),
    /// The recorded sides describe a left-handed sensor.
    Mirrored,
    /// Every axis recorded as up reads down.
    Inverted,
    /// The readings of a pose show another side up than was recorded.
    AxesSwapped {
        /// The recorded side.
        face: Face,
        /// The side that reads up.
        reads: Face,
    },
    /// A pose recorded with a vertical axis has none.
    NotUpright {
        /// The recorded side.
        face: Face,
    },
    /// The placement error of the six sides is too large.
    NotSquared {
        /// Placement error, rad rms.
        placement_rad: f64,
    },
}

/// The probable unit of values that are not m/s².
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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

/// The probable unit, and what to do.
impl fmt::Display for UnitHint {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::G => "which looks like g, not m/s²: multiply by 9.80665",
            Self::Mps2TakenForG => {
                "which looks like m/s² converted as if it were g: declare the unit as m/s²; or the \
                 sensitivity is ten times too small"
            }
            Self::MilliGOrCounts => {
                "which looks like mg or counts, not m/s²: multiply mg by 0.00980665, or divide by the \
                 sensitivity in LSB per m/s²"
            }
            Self::Counts => {
                "which looks like counts, not m/s²: divide by the sensitivity in LSB per m/s²"
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

impl fmt::Display for Refusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooFewPoses { have: 0, need, .. } => write!(
                out,
                "no static pose: hold the sensor still for two seconds in each of {need} orientations or \
                 more"
            ),
            Self::TooFewPoses {
                have,
                need,
                model,
                instead,
            } => {
                write!(
                    out,
                    "{have} static pose{}, the {model} needs at least {need}: add poses in other \
                     orientations",
                    if have == 1 { "" } else { "s" }
                )?;
                smaller(out, instead)
            }
            Self::PoseMissing { face } => write!(
                out,
                "no pose has {face}: put the sensor down with {face}, within 20°, and hold it still"
            ),
            Self::NotFinite { pose } => write!(
                out,
                "pose {pose} (from 0) has a value that is not a finite number: remove it"
            ),
            Self::UnexpectedMagnitude { mean_mps2, hint } => {
                write!(out, "the poses' mean magnitude is {mean_mps2:.4}, {hint}")
            }
            Self::Confounded {
                model,
                parameters,
                terms,
                add,
                instead,
            } => {
                undetermined(out, model, parameters, terms)?;
                write!(
                    out,
                    "typical scale factors and misalignments, which it leaves out, would bias them; \
                     add a pose with {add}, and others unlike those you have"
                )?;
                smaller(out, instead)
            }
            Self::NotObservable {
                model,
                parameters,
                terms,
                condition,
                amplification,
                add,
                instead,
            } => {
                undetermined(out, model, parameters, terms)?;
                if amplification < 1e4 {
                    write!(
                        out,
                        "condition {condition:.0}, an error in a pose grows {amplification:.0} \
                         times elsewhere"
                    )?;
                } else {
                    out.write_str("elsewhere the output could be anything")?;
                }
                write!(
                    out,
                    "; add a pose with {add}, and others unlike those you have"
                )?;
                smaller(out, instead)
            }
            Self::AxisStuck { axis } => write!(
                out,
                "axis {} reads the same in every pose: it is dead or stuck at full scale, or was \
                 never rotated; check it, and hold it up and down",
                axis_name(axis)
            ),
            Self::Saturated { axis } => write!(
                out,
                "axis {} has the same extreme reading in several poses: it is saturated; choose a \
                 larger range and repeat the poses",
                axis_name(axis)
            ),
            Self::TermNotObservable { term } => write!(
                out,
                "the term {term} is not observable: {}",
                match term {
                    Term::Drift => "the poses have no times, or all the same",
                    _ => "a pose has no temperature, or all have the same within 1 K: warm or cool the sensor \
                          between poses",
                }
            ),
            Self::NotATurn { pose, steps } => write!(
                out,
                "poses {pose} to {} (from 0) are not {steps} steps of {}° about a horizontal axis: rotate \
                 about one axis of the sensor, in one direction, and hold it still at each step",
                pose + steps - 1,
                360 / steps.max(1)
            ),
            Self::StepsUnequal {
                pose,
                steps,
                off_rad,
            } => write!(
                out,
                "poses {pose} to {} (from 0): the steps are at least {:.0}° rms from equal steps of {}°; turn \
                 the sensor by a square or a protractor, or use multi-position, which needs no known \
                 orientation",
                pose + steps - 1,
                off_rad.to_degrees(),
                360 / steps.max(1)
            ),
            Self::TurnTilted {
                pose,
                steps,
                off_rad,
            } => write!(
                out,
                "poses {pose} to {} (from 0): according to the reading of the axis of rotation, it is {:.0}° \
                 from level or from the axis of the sensor; square the sensor and level the axis, or use multi-position, which \
                 needs neither",
                pose + steps - 1,
                off_rad.to_degrees()
            ),
            Self::PoorPrediction {
                model,
                loo_rms_mps2,
                rms_mps2,
                pose,
                instead,
            } => {
                write!(
                    out,
                    "the {model} fits its own poses to {:.2} mm/s² rms but ",
                    rms_mps2 * 1e3
                )?;
                if loo_rms_mps2.is_finite() {
                    write!(out, "predicts a pose left out only to {:.2}", loo_rms_mps2 * 1e3)?;
                } else {
                    out.write_str("cannot predict a pose left out")?;
                }
                write!(
                    out,
                    ": pose {pose} (from 0) dominates the fit; add poses in other orientations, unlike \
                     those you have"
                )?;
                smaller(out, instead)
            }
            Self::PoseContradicted { pose, or, off_mps2 } => {
                write!(
                    out,
                    "pose {pose} (from 0) differs significantly, by {:.0} mm/s², from the fit of the others",
                    off_mps2.abs() * 1e3
                )?;
                if let Some(other) = or {
                    write!(out, "; or pose {other} is the outlier, too few poses distinguish them")?;
                }
                out.write_str(
                    ": the sensor was moved, touched or saturated there; repeat that pose, or leave it \
                     out, and add two in other orientations",
                )
            }
            Self::PoorFit { rms_mps2, pose } => write!(
                out,
                "the best model leaves {:.0} mm/s² rms: pose {pose} (from 0) fits worst; leave it \
                 out, and check that the sensor was still and not saturated",
                rms_mps2 * 1e3
            ),
            Self::NotConverged => out.write_str(
                "no error model gives these poses equal magnitude: check that the sensor was still, \
                 not saturated, and that every axis works",
            ),
            Self::MixedUnits { pose } => write!(
                out,
                "pose {pose} (from 0) looks like g among poses in m/s²: give all in one unit"
            ),
            Self::OutOfBounds(error) => write!(
                out,
                "the result is not plausible for an accelerometer: {error}; check the unit, the sensitivity and that \
                 no pose is saturated or moving"
            ),
            Self::Mirrored => out.write_str(
                "the recorded orientations describe a left-handed sensor: the sides of one axis were \
                 exchanged, or the driver negates or swaps an axis",
            ),
            Self::Inverted => out.write_str(
                "every axis recorded as up reads down: the output is minus the specific force; negate \
                 it, or record the opposite side",
            ),
            Self::AxesSwapped { face, reads } => write!(
                out,
                "a pose recorded as {face} reads {reads}: check which side was up, and that the driver \
                 keeps the axes in order"
            ),
            Self::NotUpright { face } => write!(
                out,
                "a pose recorded as {face} has no axis within 20° of the vertical: repeat it"
            ),
            Self::NotSquared { placement_rad } => write!(
                out,
                "the placement error of the six sides is {:.1}°: use a box with square corners, or \
                 multi-position, which needs no known orientation",
                placement_rad.to_degrees()
            ),
        }
    }
}

fn undetermined(
    out: &mut fmt::Formatter<'_>,
    model: Model,
    parameters: Parameters,
    terms: Terms,
) -> fmt::Result {
    write!(out, "the poses do not determine {parameters}")?;
    if terms != Terms::NONE {
        let comma = if parameters.is_empty() { "" } else { ", " };
        write!(out, "{comma}{terms}")?;
    }
    write!(out, " of the {model}: ")
}

fn smaller(out: &mut fmt::Formatter<'_>, instead: Option<Model>) -> fmt::Result {
    match instead {
        Some(smaller) => write!(out, ", or use the {smaller}, which these poses support"),
        None => Ok(()),
    }
}

impl Refusal {
    /// Adds the largest smaller model that `supported` accepts.
    pub(crate) fn advise(mut self, supported: impl Fn(Model) -> bool) -> Self {
        if let Self::TooFewPoses { model, instead, .. }
        | Self::NotObservable { model, instead, .. }
        | Self::Confounded { model, instead, .. }
        | Self::PoorPrediction { model, instead, .. } = &mut self
        {
            let smaller = core::iter::successors(model.smaller(), |model| model.smaller());
            *instead = smaller.into_iter().find(|model| supported(*model));
        }
        self
    }
}

impl core::error::Error for Refusal {}
