//! The rotation between two units while they move.

use super::engine::{Engine, Model};
use super::pair::{Steps, Unit};
use super::{Angle, Clock, RelativeChoice, RelativePath, RelativePoint, search};
use crate::imu::{Imu, Sample};
use crate::inertial::LeastDelay;
use crate::series::Ns;
use crate::{Code, Problem, Result};
use nalgebra::Rotation3;

/// Motion before the first search for clock, axis and start, s.
const START_S: f64 = 8.0;
/// Ratio of the motion at a search to that at the last one, until the result is accurate enough.
const MORE: f64 = 1.25;
/// Length of the motion that a search uses, s.
const KEPT_S: f64 = 60.0;
/// Samples that the filter keeps before its last step, s: longer than links deliver late.
const BEHIND_S: f64 = 2.0;

/// One of the two units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Body {
    /// The first.
    A,
    /// The second.
    B,
}

/// Two units whose relative rotation is estimated while they move, with the filter of [`relative`](super::relative).
///
/// Clock, axis and rotation at the start are searched in the first motion; from then on each sample moves the filter on. The
/// clocks of both units are tied to that of the host by the messages of least delay.
pub struct LiveRelative {
    choice: RelativeChoice,
    /// The latest samples, each at times of its clock.
    recordings: [Imu; 2],
    /// Both clocks on that of the host.
    clocks: [LeastDelay; 2],
    /// First time of the first unit, s.
    begun_s: Option<f64>,
    /// Motion after which the next search is due, s.
    due_s: f64,
    running: Option<Running>,
    lacks: Option<Problem>,
}

impl LiveRelative {
    /// Before the first sample. `of` has the calibrations of the units.
    pub fn new(choice: RelativeChoice, of: [Imu; 2]) -> Self {
        Self {
            choice,
            recordings: of,
            clocks: Default::default(),
            begun_s: None,
            due_s: START_S,
            running: None,
            lacks: None,
        }
    }

    /// The next sample of a unit, at a time of its clock, s, that arrived at a time of the host, s. A search takes up to a
    /// second.
    pub fn push(&mut self, body: Body, time_s: f64, arrived_s: f64, sample: Sample) {
        let k = body as usize;
        self.clocks[k].see(time_s, arrived_s);
        let (time, recording) = (Ns::from_s(time_s), &mut self.recordings[k]);
        recording.push(time, sample);
        let first = recording.samples.t.first();
        if first.is_some_and(|first| time.since_s(*first) > 2.0 * KEPT_S) {
            recording.samples.forget_before(time.after_s(-KEPT_S), 1);
        }
        let Some(behind_s) = self.behind_s() else {
            return;
        };
        if let Some(running) = &mut self.running {
            running.units[k].push(time, &sample);
            running.advance(behind_s);
            if !running.engine.is_sound() {
                self.running = None;
            }
        }
        if body == Body::A {
            let begun_s = *self.begun_s.get_or_insert(time_s);
            let is_accurate = self.is_accurate();
            if !is_accurate && time_s - begun_s >= self.due_s {
                self.due_s = MORE * (time_s - begun_s);
                self.lacks = self.begin(behind_s).err();
            }
        }
    }

    /// The rotations since the last call: none before the first search that has a result.
    pub fn take(&mut self) -> Vec<RelativePoint> {
        let running = self.running.as_mut();
        running.map_or_else(Vec::new, |running| std::mem::take(&mut running.points))
    }

    /// Whether axis and angle are accurate enough.
    pub fn is_accurate(&self) -> bool {
        self.running.as_ref().is_some_and(|running| running.accurate)
    }

    /// Why the last search had no result.
    pub fn lacks(&self) -> Option<&Problem> {
        self.lacks.as_ref()
    }

    /// What the last search noticed, or what it lacked.
    pub fn findings(&self) -> Vec<Problem> {
        let lacks = self.lacks.as_ref().map(|error| {
            let lacks = Code::NotObserved.note(&error.text);
            lacks.remedy(&error.remedy)
        });
        let running = self.running.as_ref();
        let noticed = running.map_or(&[][..], |running| &running.found.findings);
        noticed.iter().cloned().chain(lacks).collect()
    }

    /// The path through these points of [`take`](Self::take); `None` before the first search that has a result.
    pub fn path(&self, points: Vec<RelativePoint>) -> Option<RelativePath> {
        let running = self.running.as_ref()?;
        let (clock, offset_s) = (running.found.clock, running.steps.offset_s);
        let measured_s = clock.measured_s.map(|s| s + offset_s - clock.offset_s);
        Some(RelativePath {
            points,
            clock: Clock { offset_s, measured_s, ..clock },
            joint_nis: running.engine.joint_nis(),
            lever_arms_m: running.engine.lever_arms_m().map(Into::into),
            ..running.found.clone()
        })
    }

    /// How much the second clock is behind the first by the messages of least delay, s.
    fn behind_s(&self) -> Option<f64> {
        let [a, b] = self.clocks.each_ref().map(LeastDelay::offset_s);
        Some(a? - b?)
    }

    /// Searches clock, axis and start in the latest motion.
    fn begin(&mut self, behind_s: f64) -> Result<()> {
        for recording in &mut self.recordings {
            let newest = recording.samples.t.last().copied().unwrap_or_default();
            recording.samples.forget_before(newest.after_s(-KEPT_S), 1);
        }
        let [first, second] = &self.recordings;
        let mut aligned = second.clone();
        aligned.samples.t.iter_mut().for_each(|t| *t = t.after_s(behind_s));
        let (found, start, model) = search([first, &aligned], &self.choice)?;
        let units = Unit::of(first).zip(Unit::of(second));
        if let Some((first, second)) = units {
            let running = Running::new([first, second], found, start, &model, behind_s)?;
            self.running = Some(running);
        }
        Ok(())
    }
}

/// The filter after a search.
struct Running {
    units: [Unit; 2],
    steps: Steps,
    engine: Box<Engine>,
    angle: Angle,
    /// What the search found, without points.
    found: RelativePath,
    accurate: bool,
    points: Vec<RelativePoint>,
}

impl Running {
    fn new(
        units: [Unit; 2],
        mut found: RelativePath,
        start: Rotation3<f64>,
        model: &Model,
        behind_s: f64,
    ) -> Result<Self> {
        let accurate = found.is_accurate();
        found.points.clear();
        let mut running = Self {
            steps: Steps::new(&units, behind_s + found.clock.offset_s),
            engine: Box::new(Engine::new(start, model)),
            angle: Angle::new(found.hinge, &found.clock),
            units,
            found,
            accurate,
            points: Vec::new(),
        };
        running.advance(behind_s);
        let newest = running.points.pop();
        running.points = newest.into_iter().collect();
        Ok(running)
    }

    /// Takes all steps for which both units have samples.
    fn advance(&mut self, behind_s: f64) {
        let offset_s = behind_s + self.found.clock.offset_s;
        self.steps.offset_s = offset_s;
        while let Some(step) = self.steps.next(&self.units) {
            let pose = self.engine.step(&step);
            self.points.push(self.angle.point(&pose));
        }
        let old_s = self.steps.time_s() - BEHIND_S;
        self.units[0].forget(old_s);
        self.units[1].forget(old_s - offset_s);
    }
}
