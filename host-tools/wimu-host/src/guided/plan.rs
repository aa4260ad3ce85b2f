//! What a live calibration captures, and what a person is asked for.

use serde::Serialize;
use wimu_calib::{Face, Orientation, Parameter, Session};
use wimu_link::Hello;
use wimu_link::hello::Capabilities;
use wimu_model::{CalibrationMethod, STANDARD_GRAVITY_MPS2};

use crate::calibration::{CalibrateOptions, Fitting, steps};
use crate::{Code, Result};

/// Default number of poses of a live calibration.
const POSES: usize = 12;
/// Default number of rotations: about two axes, so that the bias of each is observed.
const ROTATIONS: usize = 2;
/// Typical residual of a pose, m/s²: the prior of [`wimu_calib::Guide`] is relative to it.
const POSE_SD_MPS2: f64 = 0.003;

/// What a live calibration captures.
#[derive(Clone)]
pub struct Plan {
    /// How the poses are calibrated.
    pub options: CalibrateOptions,
    /// Whether they are for the magnetometer.
    pub of_field: bool,
    /// Number of poses.
    pub count: usize,
    /// Names of the sides that +X, −X, +Y, … point out of.
    pub sides: &'static [&'static str; 6],
}

impl Plan {
    /// Of `count` poses of a board that identified itself so: by default 12, the six sides, or two rotations.
    ///
    /// # Errors
    /// `usage` for a number of poses that does not suit the method; those of [`CalibrateOptions::gravity`].
    pub fn new(options: &CalibrateOptions, count: Option<usize>, hello: &Hello) -> Result<Self> {
        options.gravity()?;
        let usage = |text: String, remedy: String| Err(Code::Usage.error(text, remedy));
        let fewest = options.multi_position().fewest_poses();
        let count = match (steps(options.method), count) {
            _ if options.method == CalibrationMethod::SixPosition => Face::ALL.len(),
            (Some(steps), None) => ROTATIONS * steps,
            (Some(steps), Some(count)) if !count.is_multiple_of(steps) || count == 0 => {
                let text =
                    format!("--count {count} is not a number of whole rotations of {steps} steps");
                return usage(text, format!("give a multiple of {steps}"));
            }
            (None, Some(count)) if count < fewest => {
                let text = format!("--count {count} is too small for this model");
                return usage(text, format!("give {fewest} or more, or --model auto"));
            }
            (_, count) => count.unwrap_or(POSES),
        };
        let sides = sides(&hello.board.name.to_string());
        Ok(Self { options: options.clone(), of_field: false, count, sides })
    }

    /// The same for the magnetometer of a board.
    ///
    /// # Errors
    /// `data_refused` for a board without one; those of [`new`](Self::new).
    pub fn of_field(count: Option<usize>, hello: &Hello) -> Result<Self> {
        if !hello.capabilities.offers(Capabilities::MAGNETOMETER) {
            return Err(Code::DataRefused.error(
                "the board has no magnetometer",
                "use a board that has one, or calibrate a recording with columns of a magnetometer",
            ));
        }
        let plan = Self::new(&CalibrateOptions::default(), count, hello)?;
        Ok(Self { of_field: true, ..plan })
    }

    /// Whether each of the six sides is to be up.
    pub fn is_of_sides(&self) -> bool {
        self.options.method == CalibrationMethod::SixPosition
    }

    /// What a person is asked for at the start.
    pub fn instruction(&self) -> String {
        let count = self.count;
        if self.of_field {
            return format!(
                "hold the board still in {count} different orientations, each with another side to the north, away from iron"
            );
        }
        if self.is_of_sides() {
            return "hold the board still with each of its six sides up, in any order".to_owned();
        }
        match steps(self.options.method) {
            None => "hold the board as suggested, or in any other orientation".to_owned(),
            Some(steps) => format!(
                "rotate the board about one of its axes, which lies level, always in one direction: hold it still at each of \
                 {steps} steps of {}°, then do the same about another axis, {count} steps in all",
                360 / steps
            ),
        }
    }

    /// What comes after this many poses.
    pub fn next_instruction(&self, poses: usize, next: Option<Orientation>) -> String {
        let Some(steps) = steps(self.options.method) else {
            return next.map(|next| next.instruction_with(self.sides)).unwrap_or_default();
        };
        match (poses / steps + 1, poses % steps + 1) {
            _ if poses >= self.count => String::new(),
            (rotation, 1) => {
                format!("rotation {rotation}: step 1 of {steps}, the axis of rotation level")
            }
            (rotation, step) => {
                format!("rotation {rotation}: step {step} of {steps}, {}° on", 360 / steps)
            }
        }
    }

    /// Maximum number of poses of a session: each of six sides can be captured repeatedly.
    pub fn wanted(&self) -> usize {
        if self.is_of_sides() { usize::MAX } else { self.count }
    }

    /// Standard deviations after these poses: of the fit, or expected where they do not support one.
    pub fn uncertainty(&self, session: &Session) -> Uncertainty {
        let estimate = Fitting::new(&self.options).map(|fitting| fitting.of(session.poses()));
        let refusal = match estimate {
            Ok(Ok(estimate)) => {
                let sd = estimate.sd();
                return Uncertainty {
                    bias_mps2: sd.bias_mps2,
                    scale: [0, 1, 2].map(|axis| sd.matrix[axis][axis]),
                    no_fit: None,
                };
            }
            Ok(Err(refusal)) => refusal.to_string(),
            Err(problem) => problem.text,
        };
        let expected = |parameter| session.guide().sd(parameter) * POSE_SD_MPS2;
        use Parameter::{BiasX, BiasY, BiasZ, ScaleX, ScaleY, ScaleZ};
        Uncertainty {
            bias_mps2: [BiasX, BiasY, BiasZ].map(expected),
            scale: [ScaleX, ScaleY, ScaleZ].map(|scale| expected(scale) / STANDARD_GRAVITY_MPS2),
            // The remedy behind the colon is what the screen shows anyway.
            no_fit: refusal.split(':').next().map(str::to_owned),
        }
    }
}

/// Names of the sides that +X, −X, +Y, … of a board point out of, where its layout is known.
fn sides(board: &str) -> &'static [&'static str; 6] {
    /// Part of the name in the Hello, and the sides by the board's page in the documents.
    const PROFILES: [(&str, [&str; 6]); 2] = [
        (
            "micro:bit",
            [
                "logo edge",
                "edge connector",
                "button A edge",
                "button B edge",
                "display side",
                "back",
            ],
        ),
        // The sensor is on a breakout.
        (
            "Pico",
            [
                "edge at arrow X",
                "edge opposite arrow X",
                "edge at arrow Y",
                "edge opposite arrow Y",
                "chip side",
                "underside",
            ],
        ),
    ];
    let known = PROFILES.iter().find(|(name, _)| board.contains(name));
    known.map_or(&Face::SIDES, |(_, sides)| sides)
}

/// Standard deviations of the parameters.
#[derive(Clone, Debug, Serialize)]
pub struct Uncertainty {
    /// Of the bias of each axis, m/s².
    pub bias_mps2: [f64; 3],
    /// Of the scale factor of each axis, of 1.
    pub scale: [f64; 3],
    /// Why there is no fit: they are then expected of these poses.
    pub no_fit: Option<String>,
}
