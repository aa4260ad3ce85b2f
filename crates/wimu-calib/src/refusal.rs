//! Why there is no answer, and what to do about it.

use core::fmt;

use wimu_model::ModelError;

use crate::orientation::axis_name;
use crate::{Face, Model, Orientation, Parameters, Term, Terms};

/// Why the poses do not support an answer.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Refusal {
    /// Fewer poses than the model needs.
    TooFewPoses {
        /// How many there are.
        have: usize,
        /// How many are needed.
        need: usize,
        /// The model asked for.
        model: Model,
        /// The largest smaller model that these poses do support, if one.
        instead: Option<Model>,
    },
    /// No pose has this side up.
    PoseMissing {
        /// Which side.
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
        /// What the numbers look like.
        hint: UnitHint,
    },
    /// The poses do not determine some parameters.
    NotObservable {
        /// The model asked for.
        model: Model,
        /// The parameters that are poorly determined.
        parameters: Parameters,
        /// The terms that are.
        terms: Terms,
        /// Condition of the Jacobian, its parameters scaled to m/s² at 1 g.
        condition: f64,
        /// How much an error in the poses grows in the worst orientation.
        amplification: f64,
        /// A pose in this orientation would help most.
        add: Orientation,
        /// The largest smaller model that these poses do support, if one.
        instead: Option<Model>,
    },
    /// What the model leaves out, as large as it usually is, would pass for what it fits.
    Confounded {
        /// The model asked for.
        model: Model,
        /// The parameters that are not determined.
        parameters: Parameters,
        /// The terms that are not.
        terms: Terms,
        /// A pose in this orientation would help most.
        add: Orientation,
        /// The largest smaller model that these poses do support, if one.
        instead: Option<Model>,
    },
    /// An axis reads the same in every pose, though the others turn.
    AxisStuck {
        /// 0 = X.
        axis: usize,
    },
    /// Poses end at one and the same reading of an axis: its limit.
    Saturated {
        /// 0 = X.
        axis: usize,
    },
    /// Nothing in the poses tells of a term: they have no times or temperatures, or all the same.
    TermNotShown {
        /// The term asked for.
        term: Term,
    },
    /// Poses are not successive steps of turns about a level axis.
    NotATurn {
        /// Index of the first pose of the turn.
        pose: usize,
        /// Steps of a turn: 3 or 4.
        steps: usize,
    },
    /// The steps of a turn were not equal.
    StepsUnequal {
        /// Index of the first pose of the turn.
        pose: usize,
        /// Steps of a turn: 3 or 4.
        steps: usize,
        /// How unequal, rad rms, at the least.
        off_rad: f64,
    },
    /// A turn was not about a level axis, or not about one of the sensor's.
    TurnTilted {
        /// Index of the first pose of the turn.
        pose: usize,
        /// Steps of a turn: 3 or 4.
        steps: usize,
        /// How far, rad; where it may be the bias of the axis turned about, what that would be in g.
        off_rad: f64,
    },
    /// Left-out poses are predicted far worse than the fitted ones are fitted: some pose decides
    /// alone, and nothing would show an error in it.
    PoorPrediction {
        /// The model asked for.
        model: Model,
        /// Leave-one-out error, m/s² rms; infinite where a pose cannot be spared.
        loo_rms_mps2: f64,
        /// In-sample error, m/s² rms.
        rms_mps2: f64,
        /// The pose that the others predict worst, its index.
        pose: usize,
        /// The largest smaller model that these poses do support, if one.
        instead: Option<Model>,
    },
    /// The others contradict a pose beyond chance, and cannot spare it, or another could be the bad one
    /// as well.
    PoseContradicted {
        /// The pose that fits worst to the others, its index.
        pose: usize,
        /// Another one without which the rest would agree as well.
        or: Option<usize>,
        /// |f| − g of the pose under the model fitted without it, m/s².
        off_mps2: f64,
    },
    /// No error model makes these poses of one magnitude.
    PoorFit {
        /// In-sample error, m/s² rms.
        rms_mps2: f64,
        /// The pose that fits worst, its index.
        pose: usize,
    },
    /// The fit found no minimum.
    NotConverged,
    /// Some poses are nine to eleven times shorter than others: g among m/s².
    MixedUnits {
        /// Index of the first of them.
        pose: usize,
    },
    /// The result is no accelerometer's error model.
    OutOfBounds(ModelError),
    /// What was noted makes the sensor left-handed.
    Mirrored,
    /// Every axis that was said to be up reads down.
    Inverted,
    /// A pose reads another side up than was noted.
    AxesSwapped {
        /// The side that was said to be up.
        face: Face,
        /// The side that reads up.
        reads: Face,
    },
    /// A pose that was said to have an axis upright has none.
    NotUpright {
        /// The side that was said to be up.
        face: Face,
    },
    /// The six sides were not at right angles.
    NotSquared {
        /// The placement error that the poses show, rad rms.
        placement_rad: f64,
    },
}

/// What numbers that are not m/s² look like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum UnitHint {
    /// g.
    G,
    /// m/s² that were multiplied by 9.80665 once more.
    Mps2TakenForG,
    /// mg, or counts of a sensor with about 1000 LSB/g.
    MilliGOrCounts,
    /// Raw counts.
    Counts,
    /// Nothing that is gravity in any known unit.
    NotGravity,
}

/// What it looks like, and what to do.
impl fmt::Display for UnitHint {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::G => "which looks like g, not m/s²: multiply by 9.80665",
            Self::Mps2TakenForG => {
                "which looks like m/s² that were taken for g: say m/s² where it says g; or the \
                 sensitivity is ten times too small"
            }
            Self::MilliGOrCounts => {
                "which looks like mg or counts, not m/s²: multiply mg by 0.00980665, or divide by the \
                 sensitivity in LSB per m/s²"
            }
            Self::Counts => {
                "which looks like counts, not m/s²: divide by the sensitivity in LSB per m/s²"
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
                    "{have} static pose{}, the {model} needs {need} at the least: add poses in other \
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
                    "scale factors and misalignments as they usually are, which it leaves out, would \
                     pass for them; add a pose with {add}, and others unlike those you have"
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
                 never turned; check it, and hold it up and down",
                axis_name(axis)
            ),
            Self::Saturated { axis } => write!(
                out,
                "axis {} stops at one reading in some poses: it is saturated; choose a larger \
                 range and take the poses again",
                axis_name(axis)
            ),
            Self::TermNotShown { term } => write!(
                out,
                "nothing tells of {term}: {}",
                match term {
                    Term::Drift => "the poses have no times, or all the same",
                    _ => "a pose has no temperature, or all have the same within 1 K: warm or cool the sensor \
                          between poses",
                }
            ),
            Self::NotATurn { pose, steps } => write!(
                out,
                "poses {pose} to {} (from 0) are not {steps} steps of {}° about a level axis: turn \
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
                "poses {pose} to {} (from 0): the steps are {:.0}° from {}° each, rms, or more; turn by a \
                 square or a protractor, or use multi-position, which needs no known orientation",
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
                "poses {pose} to {} (from 0): by what the axis turned about reads, it is {:.0}° from level \
                 or from the axis of rotation; square the sensor and level the axis, or use multi-position, \
                 which needs neither",
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
                    write!(out, "predicts one left out to {:.2} only", loo_rms_mps2 * 1e3)?;
                } else {
                    out.write_str("cannot predict one left out")?;
                }
                write!(
                    out,
                    ": pose {pose} (from 0) decides alone; add poses in other orientations, unlike \
                     those you have"
                )?;
                smaller(out, instead)
            }
            Self::PoseContradicted { pose, or, off_mps2 } => {
                write!(
                    out,
                    "pose {pose} (from 0) is {:.0} mm/s² from what the others say, which is no chance",
                    off_mps2.abs() * 1e3
                )?;
                if let Some(other) = or {
                    write!(out, "; or pose {other} is the bad one, which too few poses tell apart")?;
                }
                out.write_str(
                    ": the sensor was moved, touched or at its limit then; hold it so again, or leave that \
                     pose out, and add two in other orientations",
                )
            }
            Self::PoorFit { rms_mps2, pose } => write!(
                out,
                "the best model leaves {:.0} mm/s² rms: pose {pose} (from 0) fits worst; leave it \
                 out, and check that the sensor was still and not saturated",
                rms_mps2 * 1e3
            ),
            Self::NotConverged => out.write_str(
                "no error model makes these poses of one magnitude: check that the sensor was still, \
                 not saturated, and that every axis works",
            ),
            Self::MixedUnits { pose } => write!(
                out,
                "pose {pose} (from 0) looks like g among poses in m/s²: give all in one unit"
            ),
            Self::OutOfBounds(error) => write!(
                out,
                "the result is no accelerometer's: {error}; check the unit, the sensitivity and that \
                 no pose is saturated or moving"
            ),
            Self::Mirrored => out.write_str(
                "the orientations noted make the sensor left-handed: the sides of one axis were \
                 mixed up, or the driver negates or swaps an axis",
            ),
            Self::Inverted => out.write_str(
                "every axis noted as up reads down: the output is minus the specific force; negate \
                 it, or note the side that is down",
            ),
            Self::AxesSwapped { face, reads } => write!(
                out,
                "a pose noted as {face} reads {reads}: check which side was up, and that the driver \
                 keeps the axes in order"
            ),
            Self::NotUpright { face } => write!(
                out,
                "a pose noted as {face} has no axis within 20° of upright: take it again"
            ),
            Self::NotSquared { placement_rad } => write!(
                out,
                "the six sides are {:.1}° from square: use a box with square corners, or \
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
    /// Tells which smaller model the poses support, where one might mend it: the first that `supported`
    /// answers yes to.
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
