//! Poses of a live board: what is captured of them.

use serde::Serialize;
use wimu_calib::{Face, Orientation, Parameter, Phase, Pose, Session};
use wimu_link::Hello;
use wimu_link::batch::Stream;
use wimu_link::hello::Capabilities;
use wimu_link::message::Event as Happened;
use wimu_model::{STANDARD_GRAVITY_MPS2, Sensitivity};

use crate::calibration::{CalibrateOptions, Fitting, MethodChoice};
use crate::capture::Link;
use crate::decode::{Arrival, Event};
use crate::recording::Recording;
use crate::{Code, Result};

/// Capacity of a live calibration, poses.
pub const CAPACITY: usize = 64;
/// Default number of poses of a live calibration.
const POSES: usize = 12;
/// Default number of rotations: about two axes, so that the bias of each is observed.
const ROTATIONS: usize = 2;
/// Typical residual of a pose, m/s²: the prior of [`wimu_calib::Guide`] is relative to it.
const POSE_SD_MPS2: f64 = 0.003;

/// Which orientations a person is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Guidance {
    /// Any, the most useful one next.
    Orientations,
    /// Each of the six sides up.
    Sides,
    /// So many steps of rotations about level axes.
    Rotation(usize),
    /// Any, each with another side to the north: for a magnetometer.
    Field,
}

/// What a live calibration captures.
#[derive(Clone)]
pub struct Plan {
    /// Which orientations.
    pub guidance: Guidance,
    /// Number of poses.
    pub count: usize,
    options: CalibrateOptions,
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
        let guidance = match options.method {
            MethodChoice::MultiPosition => Guidance::Orientations,
            MethodChoice::SixPosition => Guidance::Sides,
            MethodChoice::FourAngle => Guidance::Rotation(4),
            MethodChoice::ThreeAngle => Guidance::Rotation(3),
        };
        let fewest = options.multi_position().fewest_poses();
        let count = match (guidance, count) {
            (Guidance::Sides, _) => Face::ALL.len(),
            (Guidance::Rotation(steps), None) => ROTATIONS * steps,
            (Guidance::Rotation(steps), Some(count))
                if !count.is_multiple_of(steps) || count == 0 =>
            {
                let text =
                    format!("--count {count} is not a number of whole rotations of {steps} steps");
                return Err(Code::Usage.error(text, format!("give a multiple of {steps}")));
            }
            (Guidance::Orientations, Some(count)) if count < fewest => {
                let text = format!("--count {count} is too small for this model");
                let remedy = format!("give {fewest} or more, or --model auto");
                return Err(Code::Usage.error(text, remedy));
            }
            (_, count) => count.unwrap_or(POSES),
        };
        let sides = sides(&hello.board.name.to_string());
        Ok(Self { guidance, count, options: options.clone(), sides })
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
        Ok(Self { guidance: Guidance::Field, ..plan })
    }

    /// How the poses are calibrated.
    pub fn options(&self) -> &CalibrateOptions {
        &self.options
    }

    /// What a person is asked for at the start.
    pub fn instruction(&self) -> String {
        let count = self.count;
        match self.guidance {
            Guidance::Orientations => {
                format!("hold the board still in {count} different orientations")
            }
            Guidance::Sides => {
                "hold the board still with each of its six sides up, in any order".to_owned()
            }
            Guidance::Rotation(steps) => format!(
                "rotate the board about one of its axes, which lies level, always in one direction: hold it still at each of \
                 {steps} steps of {}°, then do the same about another axis, {count} steps in all",
                360 / steps.max(1)
            ),
            Guidance::Field => format!(
                "hold the board still in {count} different orientations, each with another side to the north, away from iron"
            ),
        }
    }

    /// What comes after this many poses.
    pub fn next_instruction(&self, poses: usize, next: Option<Orientation>) -> String {
        match (self.guidance, next) {
            (Guidance::Rotation(steps), _) if poses < self.count => {
                let (rotation, step) = (poses / steps + 1, poses % steps + 1);
                match step {
                    1 => format!(
                        "rotation {rotation}: step 1 of {steps}, the axis of rotation level"
                    ),
                    _ => {
                        format!("rotation {rotation}: step {step} of {steps}, {}° on", 360 / steps)
                    }
                }
            }
            (_, Some(next)) => next.instruction_with(self.sides).to_string(),
            _ => String::new(),
        }
    }

    /// Maximum number of poses of a session: each of six sides can be captured repeatedly.
    fn wanted(&self) -> usize {
        if self.guidance == Guidance::Sides { CAPACITY } else { self.count }
    }

    /// Name of the side that is up.
    pub fn name(&self, up: Face) -> &'static str {
        self.sides[up as usize]
    }

    /// Standard deviations after these poses: of the fit, or expected where they do not support one.
    pub fn uncertainty(&self, session: &Session<CAPACITY>) -> Uncertainty {
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

/// Something that a person is told.
pub enum News {
    /// The rate of the samples is known: poses can be captured from now on.
    Ready,
    /// A pose was captured.
    Captured(Pose),
    /// The board's button skipped the suggested orientation.
    Skipped,
}

/// The poses of a live board, and everything recorded of them.
pub struct LivePoses {
    /// What is captured.
    pub plan: Plan,
    record: Link,
    session: Option<Session<CAPACITY>>,
    /// The suggested orientation.
    next: Option<Orientation>,
    sensitivity: Option<Sensitivity>,
    phase: Phase,
    /// Samples that were pushed to the session, and those of them that are kept.
    pushed: u64,
    kept: u64,
    /// Number of kept samples before each pose.
    starts: Vec<u64>,
    /// The present output, m/s², smoothed over about ten samples.
    output_mps2: Option<[f64; 3]>,
    rate_hz: f64,
}

impl LivePoses {
    /// Before any sample.
    pub fn new(plan: Plan, hello: &Hello) -> Self {
        Self {
            plan,
            record: Link::new(hello.role),
            session: None,
            next: None,
            sensitivity: None,
            phase: Phase::WaitingForRest,
            pushed: 0,
            kept: 0,
            starts: Vec::new(),
            output_mps2: None,
            rate_hz: 0.0,
        }
    }

    /// Takes an arrival and hands on what a person is told.
    pub fn take(&mut self, arrival: &Arrival, mut tell: impl FnMut(&Self, News)) {
        self.record.take(arrival);
        match &arrival.event {
            Event::Epoch { epoch, .. } if self.session.is_none() && epoch.sensor == 0 => {
                self.sensitivity = Sensitivity::from_lsb_per_g(epoch.sensitivity_lsb_per_g).ok();
                if self.sensitivity.is_some() {
                    self.rate_hz = 1e9 / f64::from(epoch.period_ns.max(1));
                    self.begin();
                    tell(self, News::Ready);
                }
            }
            Event::Samples(samples) if samples.stream == Stream::Raw && samples.sensor == 0 => {
                let ignored = self.session.as_ref().is_some_and(Session::ignores_hold);
                for sample in samples.iter() {
                    if let Some(pose) = self.push(sample.value.map(f64::from)) {
                        tell(self, News::Captured(pose));
                    }
                }
                // The rest of a hold whose pose was removed.
                if ignored {
                    self.drop_latest(samples.values.len() as u64);
                }
            }
            Event::Device { event: Happened::Marked { .. }, .. } => {
                let captured = self.session.as_mut().and_then(Session::capture);
                match captured.and_then(|index| self.captured(index)) {
                    Some(pose) => tell(self, News::Captured(pose)),
                    None => {
                        self.skip();
                        tell(self, News::Skipped);
                    }
                }
            }
            _ => {}
        }
    }

    /// Begins a session.
    fn begin(&mut self) {
        let wanted = self.plan.wanted();
        self.session = Some(Session::new(self.rate_hz, wanted));
        (self.pushed, self.kept) = (0, 0);
        self.starts.clear();
        self.suggest();
    }

    /// Plans the next orientation, after a change of the poses: it takes milliseconds.
    fn suggest(&mut self) {
        self.next = match self.plan.guidance {
            Guidance::Sides => self.sides_left().first().map(|side| Orientation::from(*side)),
            Guidance::Rotation(_) => None,
            Guidance::Orientations | Guidance::Field => {
                self.session.as_ref().and_then(Session::next)
            }
        };
    }

    /// The suggested orientation.
    pub fn next(&self) -> Option<Orientation> {
        self.next
    }

    fn push(&mut self, counts: [f64; 3]) -> Option<Pose> {
        let (session, sensitivity) = (self.session.as_mut()?, self.sensitivity?);
        let scale = sensitivity.mps2_per_lsb();
        let output = counts.map(|axis| axis * scale);
        let smooth = self.output_mps2.get_or_insert(output);
        (0..3).for_each(|axis| smooth[axis] += 0.1 * (output[axis] - smooth[axis]));
        self.pushed += 1;
        self.kept += 1;
        self.phase = session.push(output);
        match self.phase {
            Phase::Captured { pose } => self.captured(pose),
            _ => None,
        }
    }

    /// The pose with this index, which was captured now.
    fn captured(&mut self, index: usize) -> Option<Pose> {
        let pose = *self.poses().get(index)?;
        let since = self.pushed.saturating_sub(pose.first_sample);
        self.starts.push(self.kept.saturating_sub(since));
        self.suggest();
        Some(pose)
    }

    /// Captures this many more poses.
    pub fn extend(&mut self, more: usize) {
        self.plan.count = (self.plan.count + more).min(CAPACITY);
        let wanted = self.plan.wanted();
        self.session.iter_mut().for_each(|session| session.want(wanted));
    }

    /// Skips the suggested orientation.
    pub fn skip(&mut self) {
        self.session.iter_mut().for_each(Session::skip);
        self.suggest();
    }

    /// Removes the latest pose with its samples; returns whether there was one.
    pub fn undo(&mut self) -> bool {
        let removed = self.session.as_mut().and_then(Session::undo);
        let Some(start) = removed.and(self.starts.pop()) else {
            return false;
        };
        // The first block of a hold is left out of its pose: 0.1 s.
        let start = start.saturating_sub((0.1 * self.rate_hz) as u64);
        self.drop_latest(self.kept.saturating_sub(start));
        self.suggest();
        true
    }

    fn drop_latest(&mut self, count: u64) {
        self.kept = self.kept.saturating_sub(count);
        self.record.drop_latest_raw(usize::try_from(count).unwrap_or(usize::MAX));
    }

    /// All samples so far.
    ///
    /// # Errors
    /// Those of [`Recording::of_link`].
    pub fn recording(&self, name: &str) -> Result<Recording> {
        Recording::of_link(&self.record, name)
    }

    /// The captured poses, in order.
    pub fn poses(&self) -> &[Pose] {
        self.session.as_ref().map_or(&[], |session| session.poses())
    }

    /// The session; `None` before the rate is known.
    pub fn session(&self) -> Option<&Session<CAPACITY>> {
        self.session.as_ref()
    }

    /// Whether the board rests.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Sample rate, Hz; 0 before it is known.
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// The present output of the sensor, m/s².
    pub fn output_mps2(&self) -> Option<[f64; 3]> {
        self.output_mps2
    }

    /// The sides that were not captured yet, of six.
    pub fn sides_left(&self) -> Vec<Face> {
        let captured: Vec<_> = self.poses().iter().filter_map(Face::of).collect();
        let left = Face::ALL.into_iter().filter(|side| !captured.contains(side));
        left.collect()
    }

    /// Whether all poses were captured.
    pub fn is_complete(&self) -> bool {
        let has_sides = self.plan.guidance != Guidance::Sides || self.sides_left().is_empty();
        let count = self.poses().len();
        (has_sides && count >= self.plan.count) || count == CAPACITY
    }
}
