//! Navigation of a stream.

use std::collections::VecDeque;

use wimu_nav::navigator::{Profile, Sample};
use wimu_nav::stance::AHEAD_S;

use super::fixes::{Aided, Fix};
use super::headings::Headings;
use super::sense::{Senses, clipped};
use super::track::{Input, counted_findings};
use super::unit::{OnceEachField, Unit, detector, noise_mps2, sample};
use super::{Choice, InertialPath, Method, PathPoint};
use crate::motion::{MotionRecording, UnitSample, other_clock};
use crate::rests::RestLimits;
use crate::{Code, Problem, Result};

/// Samples before the first answer, s: what shows whether the sensors are calibrated, and the alignment.
const START_S: f64 = 3.0;
/// The navigator takes samples in blocks of this length, s.
const BLOCK_S: f64 = 0.1;
/// Samples that are kept before the horizon, s: those that a stance looks back to.
const KEPT_S: f64 = AHEAD_S + 1.0;
/// Position fixes that are kept to be shown.
const KEPT_FIXES: usize = 500;
/// Fixes that are all later than the newest sample by this time, s, are of another clock: a day.
const FAR_S: f64 = 86_400.0;

/// A unit that is navigated while it moves, with the filter of [`navigate`](super::navigate).
///
/// The filter is behind the newest sample by a horizon, within which fixes may arrive late and the detector of rests sees
/// samples before and after. Each answer predicts the samples since then anew (delayed fusion horizon, as PX4's EKF2).
///
/// ```
/// use wimu_host::inertial::{Choice, Live};
/// use wimu_host::motion::{MotionRecording, UnitSample};
///
/// let mut live = Live::new(Choice::default(), MotionRecording::default(), 0.5);
/// for k in 0..500 {
///     let force_mps2 = [0.0, 0.0, if k % 2 == 0 { 9.80 } else { 9.81 }];
///     live.push(f64::from(k) * 0.01, UnitSample { force_mps2, ..UnitSample::default() })?;
/// }
/// let point = live.now().expect("an answer after three seconds");
/// assert!(point.valid && point.time_s == 4.99 && point.position_m[2].abs() < 0.01);
/// # Ok::<(), wimu_host::Problem>(())
/// ```
pub struct Live {
    choice: Choice,
    /// The samples since a little before the horizon, and what is known of the sensors.
    recording: MotionRecording,
    /// How late fixes may arrive, s.
    delay_s: f64,
    /// Of the buffered samples, those before the horizon.
    taken: usize,
    once: OnceEachField,
    begun: Option<Begun>,
    findings: Vec<Problem>,
    /// Fixes and ranges that came too late.
    late: [usize; 2],
    not_finite: usize,
    clipped: usize,
    /// The latest position fixes, m, and whether each was used.
    fixes: VecDeque<([f64; 3], bool)>,
}

/// What the first seconds have shown.
struct Begun {
    method: Method,
    senses: Senses,
    noise_mps2: f64,
    gravity_mps2: f64,
    path: Headings,
}

impl Live {
    /// Before the first sample. `of` has the full scale and the calibration of the sensors; fixes may arrive `delay_s` late.
    pub fn new(choice: Choice, of: MotionRecording, delay_s: f64) -> Self {
        let window_s = match choice.profile {
            Profile::Foot => RestLimits::foot().window_s + AHEAD_S,
            profile => detector(profile).window_s,
        };
        Self {
            choice,
            recording: of,
            delay_s: delay_s.max(window_s),
            taken: 0,
            once: OnceEachField::default(),
            begun: None,
            findings: Vec::new(),
            late: [0; 2],
            not_finite: 0,
            clipped: 0,
            fixes: VecDeque::new(),
        }
    }

    /// The next sample, at a time on the device's clock, s; its `step_s` is not read. A reading of the magnetometer may be
    /// repeated.
    ///
    /// # Errors
    /// `data_refused`, three seconds after the first sample: these do not show gravity.
    pub fn push(&mut self, time_s: f64, sample: UnitSample) -> Result<()> {
        let mut values = sample.force_mps2.into_iter().chain([time_s]);
        if !values.all(f64::is_finite) {
            self.not_finite += 1;
            return Ok(());
        }
        let last_s = self.recording.times_s.last().copied().unwrap_or(time_s);
        let sample = UnitSample { step_s: time_s - last_s, ..sample };
        self.recording.times_s.push(time_s);
        self.recording.samples.push(self.once.of(&sample));
        let times_s = &self.recording.times_s;
        if self.begun.is_none() {
            if time_s - times_s[0] >= START_S {
                self.begin()?;
            }
        } else if time_s - times_s[self.taken.min(times_s.len() - 1)] >= self.delay_s + BLOCK_S {
            self.advance(time_s - self.delay_s);
        }
        Ok(())
    }

    /// A measurement of another system. A fix of the horizontal position, or ranges of a second, move the path to their frame.
    pub fn fix(&mut self, fix: Fix) {
        // Before the filter begins the horizon is at the first sample.
        let horizon_s = self.recording.times_s.get(self.taken);
        if horizon_s.is_some_and(|horizon_s| fix.time_s < *horizon_s) {
            self.late[usize::from(fix.range_m.is_some())] += 1;
            return;
        }
        let fixes = &mut self.choice.fixes.fixes;
        let at = fixes.partition_point(|other| other.time_s <= fix.time_s);
        fixes.insert(at, fix);
    }

    /// The magnetometer is not calibrated: its field is not given.
    pub fn field_is_uncalibrated(&mut self) {
        self.recording.field_uncalibrated = true;
    }

    /// The path through answers of [`now`](Self::now).
    pub fn path(&self, points: Vec<PathPoint>) -> InertialPath {
        let method = self.begun.as_ref().map_or(Method::Strapdown, |begun| begun.method);
        let moves = points.iter().position(|point| !point.resting);
        let origin = moves.unwrap_or(points.len()).saturating_sub(1);
        let mut path = InertialPath::new(method, points, origin, self.choice.limit_m);
        path.findings = self.findings();
        path.aided = self.aided();
        path
    }

    /// The latest position fixes, m, and whether each was used.
    pub fn fixes(&self) -> impl Iterator<Item = &([f64; 3], bool)> {
        self.fixes.iter()
    }

    /// What happened to the fixes and to the ranges up to now.
    pub fn aided(&self) -> [Aided; 2] {
        let begun = self.begun.as_ref();
        let mut aided = begun.map_or_else(Default::default, |begun| begun.path.aided());
        for (aided, late) in aided.iter_mut().zip(self.late) {
            aided.late = late;
        }
        aided
    }

    /// Where the unit is at the newest sample; `None` in the first three seconds.
    pub fn now(&self) -> Option<PathPoint> {
        let begun = self.begun.as_ref()?;
        let samples: Vec<_> = self.recording.samples.iter().map(sample).collect();
        let inputs = self.inputs(&samples, begun);
        let mut point = begun.path.ahead(inputs.get(self.taken..)?, &self.choice.fixes)?;
        point.valid &= point.sd_m() <= self.choice.limit_m;
        Some(point)
    }

    /// Headings that explain the fixes: the path is not valid while they have different positions.
    pub fn headings(&self) -> usize {
        self.begun.as_ref().map_or(1, |begun| begun.path.headings())
    }

    /// Time of the newest sample, s.
    pub fn newest_s(&self) -> Option<f64> {
        self.recording.times_s.last().copied()
    }

    /// What was noticed up to now.
    pub fn findings(&self) -> Vec<Problem> {
        let mut found = [&self.choice.fixes.findings[..], &self.findings].concat();
        let late = "arrived later than the filter waits: not used (--setup fix_delay_s=S)";
        let counts = [
            (self.late[0], "fix", late),
            (self.late[1], "range", late),
            (self.clipped, "clipped sample", "not used: σ grows there"),
            (self.not_finite, "sample", "that is not finite: not used"),
        ];
        for (count, one, what) in counts {
            let counts = [(count, what)];
            found.extend(counted_findings(Code::SamplesLeftOut, one, &counts));
        }
        found.extend(self.other_clock());
        if let Some(begun) = &self.begun {
            found.extend(begun.path.findings(&self.choice.fixes));
        }
        found
    }

    /// Fixes of a file whose times are not those of the device.
    fn other_clock(&self) -> Option<Problem> {
        let fixes = &self.choice.fixes.fixes;
        let (first, last) = fixes.first().zip(fixes.last())?;
        let newest_s = self.newest_s()?;
        if first.time_s < newest_s + FAR_S {
            return None;
        }
        let fixes = ("fixes or ranges", [first.time_s, last.time_s]);
        let error = other_clock([fixes, ("device", [newest_s; 2])]);
        Some(Code::Clock.warning(error.text).remedy(error.remedy))
    }

    fn begin(&mut self) -> Result<()> {
        let begun_s = self.recording.times_s[0];
        let fixes = &mut self.choice.fixes.fixes;
        let before = fixes.partition_point(|fix| fix.time_s < begun_s);
        for fix in fixes.drain(..before) {
            self.late[usize::from(fix.range_m.is_some())] += 1;
        }
        let recording = &self.recording;
        let senses = Senses::of(recording)?;
        let method = Method::of(&recording.samples);
        self.findings = senses.findings.clone();
        if recording.samples.iter().all(|s| s.field_ut.is_none()) {
            let text = format!(
                "{}: heading is that of the body at the start, until fixes show it",
                recording.without_field()
            );
            self.findings.push(Code::Navigation.note(text));
        }
        let noise_mps2 = noise_mps2(&recording.times_s, &recording.samples);
        let samples = &recording.samples;
        let unit = Unit::of(recording, samples, &senses, &senses.clipped, noise_mps2);
        let path = unit.begin(&self.choice, method)?;
        let gravity_mps2 = unit.gravity_mps2;
        self.begun = Some(Begun { method, senses, noise_mps2, gravity_mps2, path });
        Ok(())
    }

    fn inputs<'s>(&self, samples: &'s [Sample], begun: &Begun) -> Vec<Input<'s>> {
        let all = &self.recording.samples;
        let (senses, clipped) = (&begun.senses, clipped(all));
        let unit = Unit::of(&self.recording, all, senses, &clipped, begun.noise_mps2);
        // What is buffered now may have no rest.
        let unit = Unit { gravity_mps2: begun.gravity_mps2, ..unit };
        unit.inputs(samples, &self.choice, begun.method)
    }

    /// Moves the horizon up to a time, s.
    fn advance(&mut self, until_s: f64) {
        let Some(mut begun) = self.begun.take() else {
            return;
        };
        let samples: Vec<_> = self.recording.samples.iter().map(sample).collect();
        let inputs = self.inputs(&samples, &begun);
        let times_s = &self.recording.times_s;
        let end = times_s.partition_point(|t| *t <= until_s).max(self.taken);
        let block = &inputs[self.taken..end];
        self.clipped += block.iter().filter(|input| input.clipped).count();
        begun.path.advance(block, &self.choice.fixes);
        for residual in begun.path.residuals.drain(..) {
            let fix = self.choice.fixes.position_at(residual.time_s);
            if let Some(fix) = fix.filter(|_| residual.aid == "position") {
                self.fixes.push_back((fix, residual.accepted));
            }
        }
        let old = self.fixes.len().saturating_sub(KEPT_FIXES);
        self.fixes.drain(..old);
        self.begun = Some(begun);
        let old = times_s.partition_point(|t| *t < until_s - KEPT_S).min(end);
        self.recording.times_s.drain(..old);
        self.recording.samples.drain(..old);
        self.taken = end - old;
        let fixes = &mut self.choice.fixes.fixes;
        let used = fixes.partition_point(|fix| fix.time_s < until_s - KEPT_S);
        fixes.drain(..used);
    }
}
