//! Navigation of a stream, at several headings until fixes or ranges rule out all but one.

use std::collections::{BTreeMap, VecDeque};

use nalgebra::Matrix3;
use wimu_nav::navigator::Profile;
use wimu_nav::stance::AHEAD_S;
use wimu_nav::state::{POSITION, VELOCITY};

use super::aids::{Aid, Place};
use super::navigator::{Carrier, Navigator, Step, counted_findings};
use super::rests::detector;
use super::sense::{Senses, clipped_samples};
use super::unit::{HEADINGS, OnceEachField, Unit, noise_mps2};
use super::{AidUse, Choice, InertialPath, Method, PathPoint, Residual, other_clock};
use crate::imu::{Imu, Sample};
use crate::localization::AnchorStates;
use crate::rests::RestLimits;
use crate::series::Ns;
use crate::{Code, Problem, Result};

/// Samples before the first answer, s: what shows whether the sensors are calibrated, and the alignment.
const START_S: f64 = 3.0;
/// The navigator takes samples in blocks of this length, s.
const BLOCK_S: f64 = 0.1;
/// Samples that are kept before the horizon, s: those that a stance looks back to.
const KEPT_S: f64 = AHEAD_S + 1.0;
/// Position fixes that are kept to be shown.
const KEPT_FIXES: usize = 500;
/// Aids that are all later than the newest sample by this time, s, are of another clock: a day.
const FAR_S: f64 = 86_400.0;
/// Difference of the logarithms of two likelihoods beyond which the smaller one is ruled out: odds of 1 to 2·10⁹.
const RULED_OUT: f64 = 21.4;
/// Standard deviation of a heading of which nothing is known, rad.
const ANY_HEADING: f64 = 1.81;

/// A unit that is navigated while it moves, with the steps of [`navigate`](super::navigate).
///
/// The filter is behind the newest sample by a horizon, within which aids may arrive late and the detector of rests sees
/// samples before and after. Each answer predicts the samples since then anew (delayed fusion horizon, as PX4's EKF2).
///
/// ```
/// use wimu_host::inertial::{Choice, Live};
/// use wimu_host::imu::{Imu, Sample};
///
/// let mut live = Live::new(Choice::default(), Imu::default(), 0.5);
/// for k in 0..500 {
///     let force_mps2 = [0.0, 0.0, if k % 2 == 0 { 9.80 } else { 9.81 }].into();
///     live.push(f64::from(k) * 0.01, Sample { force_mps2, ..Sample::default() })?;
/// }
/// let point = live.now().expect("an answer after three seconds");
/// assert!(point.valid && (point.time_s - 4.99).abs() < 1e-9 && point.position_m[2].abs() < 0.01);
/// # Ok::<(), wimu_host::Problem>(())
/// ```
pub struct Live {
    choice: Choice,
    /// The samples since a little before the horizon, and what is known of the sensors.
    recording: Imu,
    /// How late aids may arrive, s.
    delay_s: f64,
    /// Of the buffered samples, those before the horizon.
    taken: usize,
    once: OnceEachField,
    begun: Option<Begun>,
    findings: Vec<Problem>,
    /// Aids that came too late.
    late: BTreeMap<&'static str, AidUse>,
    not_finite: usize,
    clipped: usize,
    /// The latest position fixes, m, and whether each was used.
    fixes: VecDeque<([f64; 3], bool)>,
}

/// What the first seconds have shown, and the path since then.
struct Begun {
    method: Method,
    senses: Senses,
    noise_mps2: f64,
    gravity_mps2: f64,
    /// At several headings, until aids rule out all but one; the most probable first.
    paths: Vec<Navigator>,
    /// States of the anchors of ranges.
    anchors: Option<AnchorStates>,
    /// Whether the path is in the frame of the fixes, and when it was moved to it, s.
    placed: bool,
    jumped_s: Option<f64>,
    /// Residuals of the most probable path since they were taken.
    residuals: Vec<Residual>,
}

impl Live {
    /// Before the first sample. `of` has the full scale and the calibration of the sensors; aids may arrive `delay_s` late.
    pub fn new(choice: Choice, of: Imu, delay_s: f64) -> Self {
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
            late: BTreeMap::new(),
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
    pub fn push(&mut self, time_s: f64, sample: Sample) -> Result<()> {
        if !sample.force_mps2.iter().chain([&time_s]).all(|value| value.is_finite()) {
            self.not_finite += 1;
            return Ok(());
        }
        let newest = Ns::from_s(time_s);
        let last = self.newest().unwrap_or(newest);
        let mut sample = self.once.of(&Sample { step_s: newest.since_s(last), ..sample });
        if let Some(begun) = &self.begun {
            begun.senses.without_bias(std::slice::from_mut(&mut sample));
        }
        self.recording.push(newest, sample);
        let times = &self.recording.samples.t;
        if self.begun.is_none() {
            if newest.since_s(times[0]) >= START_S {
                self.begin()?;
            }
        } else if newest.since_s(times[self.taken.min(times.len() - 1)]) >= self.delay_s + BLOCK_S {
            self.advance(newest.after_s(-self.delay_s));
        }
        Ok(())
    }

    /// A measurement of another system. A fix of the horizontal position, or ranges of a second, move the path to their frame.
    pub fn aid(&mut self, aid: Aid) {
        // Before the filter begins the horizon is at the first sample.
        let horizon = self.recording.samples.t.get(self.taken);
        if horizon.is_some_and(|horizon| aid.time_s < horizon.s()) {
            self.is_late(&aid);
            return;
        }
        for path in self.begun.iter_mut().flat_map(|begun| &mut begun.paths) {
            path.aid(&aid);
        }
        let aids = &mut self.choice.aids.aids;
        let at = aids.partition_point(|other| other.time_s <= aid.time_s);
        aids.insert(at, aid);
    }

    fn is_late(&mut self, aid: &Aid) {
        self.late.entry(aid.kind.name).or_insert_with(|| AidUse::of(aid.kind)).late += 1;
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
        path.aids = self.aids();
        path.assumed(&self.choice)
    }

    /// The latest position fixes, m, and whether each was used.
    pub fn fixes(&self) -> impl Iterator<Item = &([f64; 3], bool)> {
        self.fixes.iter()
    }

    /// What happened to the aids up to now.
    pub fn aids(&self) -> BTreeMap<&'static str, AidUse> {
        let best = self.begun.as_ref().and_then(|begun| begun.paths.first());
        let mut aids = best.map_or_else(BTreeMap::new, |path| path.uses.clone());
        for (name, late) in &self.late {
            aids.entry(*name).or_insert(*late).late = late.late;
        }
        aids
    }

    /// Where the unit is at the newest sample; `None` in the first three seconds.
    pub fn now(&self) -> Option<PathPoint> {
        let begun = self.begun.as_ref()?;
        let steps = self.steps(begun);
        let ahead = steps.get(self.taken..)?;
        let best = begun.paths.first()?;
        let mut path = best.clone();
        if !begun.placed {
            path.without_aids();
        }
        let mut point = ahead.iter().map(|step| path.step(step)).last()?;
        path.segments.scale(&mut point);
        let ahead_s = ahead[ahead.len() - 1].time_s - ahead[0].time_s;
        let limit_m = self.choice.limit_m;
        point.valid &= path.has_origin() && begun.agree(best, ahead_s, limit_m);
        if begun.paths.len() > 1 {
            point.attitude_sd_rad[2] = ANY_HEADING;
        }
        point.valid &= point.sd_m() <= limit_m;
        Some(point)
    }

    /// Headings that explain the aids: the path is not valid while they have different positions.
    pub fn headings(&self) -> usize {
        self.begun.as_ref().map_or(1, |begun| begun.paths.len())
    }

    /// Time of the newest sample, s.
    pub fn newest_s(&self) -> Option<f64> {
        self.newest().map(Ns::s)
    }

    fn newest(&self) -> Option<Ns> {
        self.recording.samples.t.last().copied()
    }

    /// What was noticed up to now.
    pub fn findings(&self) -> Vec<Problem> {
        let mut found = [&self.choice.aids.findings[..], &self.findings].concat();
        let late = "arrived later than the filter waits: not used (--setup fix_delay_s=S)";
        for used in self.late.values() {
            found.extend(counted_findings(Code::SamplesLeftOut, used.one(), &[(used.late, late)]));
        }
        let counts = [
            (self.clipped, "clipped sample", "not used: σ grows there"),
            (self.not_finite, "sample", "that is not finite: not used"),
        ];
        for (count, one, what) in counts {
            found.extend(counted_findings(Code::SamplesLeftOut, one, &[(count, what)]));
        }
        found.extend(self.other_clock());
        if let Some(begun) = &self.begun {
            found.extend(begun.findings());
        }
        found
    }

    /// Aids of a file whose times are not those of the device.
    fn other_clock(&self) -> Option<Problem> {
        let aids = &self.choice.aids.aids;
        let (first, last) = aids.first().zip(aids.last())?;
        let newest_s = self.newest_s()?;
        if first.time_s < newest_s + FAR_S {
            return None;
        }
        let aids = ("fixes or ranges", [first.time_s, last.time_s]);
        let error = other_clock([aids, ("device", [newest_s; 2])]);
        Some(Code::Clock.warning(error.text).remedy(error.remedy))
    }

    fn begin(&mut self) -> Result<()> {
        let begun_s = self.recording.samples.t[0].s();
        let before = self.choice.aids.aids.partition_point(|aid| aid.time_s < begun_s);
        let early: Vec<Aid> = self.choice.aids.aids.drain(..before).collect();
        early.iter().for_each(|aid| self.is_late(aid));
        let (recording, choice) = (&self.recording, &self.choice);
        let senses = Senses::of(recording)?;
        senses.without_bias(&mut self.recording.samples.v);
        let recording = &self.recording;
        let (times_s, samples) = (&recording.times_s(), &recording.samples.v);
        let method = Method::of(samples);
        self.findings = senses.findings.clone();
        if samples.iter().all(|s| s.field_ut.is_none()) {
            let text = format!(
                "{}: heading is that of the body at the start, until fixes show it",
                recording.without_field()
            );
            self.findings.push(Code::Navigation.note(text));
        }
        let noise_mps2 = noise_mps2(times_s, samples);
        let unit = Unit::of(recording, times_s, samples, &senses, &senses.clipped, noise_mps2);
        unit.accepts(choice, method)?;
        let mut start = unit.begin(&unit.steps(choice, method), choice)?;
        let ranging = choice.aids.ranging.as_ref();
        let anchors = ranging.map(|ranging| ranging.claim(&mut start.core));
        let gravity_mps2 = unit.gravity_mps2;
        choice.aids.aids.iter().for_each(|aid| start.aid(aid));
        let has_heading = choice.start.is_some_and(|pose| pose.heading_rad.is_some());
        let placed = has_heading && anchors.is_none();
        let paths = vec![start];
        self.begun = Some(Begun {
            method,
            senses,
            noise_mps2,
            gravity_mps2,
            paths,
            anchors,
            placed,
            jumped_s: None,
            residuals: Vec::new(),
        });
        Ok(())
    }

    /// The buffered samples as steps.
    fn steps(&self, begun: &Begun) -> Vec<Step> {
        let (times_s, samples) = (self.recording.times_s(), &self.recording.samples.v);
        let (senses, clipped) = (&begun.senses, clipped_samples(samples));
        let unit = Unit::of(&self.recording, &times_s, samples, senses, &clipped, begun.noise_mps2);
        // What is buffered now may have no rest.
        let unit = Unit { gravity_mps2: begun.gravity_mps2, ..unit };
        unit.steps(&self.choice, begun.method)
    }

    /// Moves the horizon up to a time.
    fn advance(&mut self, until: Ns) {
        let Some(mut begun) = self.begun.take() else {
            return;
        };
        let steps = self.steps(&begun);
        let samples = &mut self.recording.samples;
        let end = samples.t.partition_point(|t| *t <= until).max(self.taken);
        let block = &steps[self.taken..end];
        let is_clipped = |step: &&Step| matches!(step.carrier, Carrier::Unmeasured);
        self.clipped += block.iter().filter(is_clipped).count();
        begun.advance(block, &self.choice);
        for residual in begun.residuals.drain(..) {
            if let Some(fix) = self.choice.aids.position_of(&residual) {
                self.fixes.push_back((fix, residual.accepted));
            }
        }
        let old = self.fixes.len().saturating_sub(KEPT_FIXES);
        self.fixes.drain(..old);
        self.begun = Some(begun);
        let kept = until.after_s(-KEPT_S);
        self.taken = end - samples.forget_before(kept, samples.len() - end);
        let aids = &mut self.choice.aids.aids;
        let used = aids.partition_point(|aid| aid.time_s < kept.s());
        aids.drain(..used);
    }
}

impl Begun {
    /// Takes steps.
    fn advance(&mut self, steps: &[Step], choice: &Choice) {
        for step in steps {
            if !self.placed {
                let places = choice.aids.places(step.time_s, choice.start.as_ref());
                self.place(&places, step.time_s, choice);
            }
            for (index, path) in self.paths.iter_mut().enumerate() {
                path.step(step);
                let residuals = std::mem::take(&mut path.residuals);
                if index == 0 {
                    self.residuals.extend(residuals);
                }
            }
        }
        if self.paths.len() > 1 {
            self.prune();
        }
    }

    /// Moves the path at a time, s, to places that fixes or ranges show, each at all headings.
    fn place(&mut self, places: &[Place], time_s: f64, choice: &Choice) {
        if places.is_empty() {
            return;
        }
        let turn = |k| f64::from(k) * std::f64::consts::TAU / f64::from(HEADINGS);
        let given = choice.start.and_then(|pose| pose.heading_rad);
        let headings: Vec<f64> =
            given.map_or_else(|| (0..HEADINGS).map(turn).collect(), |heading| vec![heading]);
        let all = places.iter().flat_map(|at| headings.iter().map(move |heading| (at, heading)));
        let placed = all.map(|(at, heading)| {
            let mut path = self.paths[0].clone();
            path.place(*at, None, *heading);
            path.anchors.clone_from(&self.anchors);
            path
        });
        self.paths = placed.collect();
        (self.placed, self.jumped_s) = (true, Some(time_s));
    }

    /// Whether all headings have the position of the best one to the limit, also after further time, s.
    fn agree(&self, best: &Navigator, ahead_s: f64, limit_m: f64) -> bool {
        let at = |path: &Navigator| {
            let state = &path.core.filter().state;
            state.get(POSITION) + state.get(VELOCITY) * ahead_s
        };
        self.paths.iter().all(|path| (at(path) - at(best)).norm() <= limit_m)
    }

    /// Drops headings that are ruled out, and those that have come to the solution of a more probable one.
    fn prune(&mut self) {
        self.paths.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
        let mut kept: Vec<Navigator> = Vec::new();
        for path in self.paths.drain(..) {
            let is_lost = |best: &Navigator| best.log_likelihood - path.log_likelihood > RULED_OUT;
            let same = |other: &Navigator| {
                let apart = path.core.heading() - other.core.heading();
                let apart = apart.sin().atan2(apart.cos()).abs();
                let covariance = other.core.solution().attitude_covariance;
                let [here, there] = [&path, other].map(|path| path.core.filter());
                let distance = here.state.get(POSITION) - there.state.get(POSITION);
                let variance =
                    there.covariance(POSITION).trace() + here.covariance(POSITION).trace();
                apart < Matrix3::from(covariance)[(2, 2)].sqrt()
                    && distance.norm_squared() < variance
            };
            if !kept.first().is_some_and(is_lost) && !kept.iter().any(same) {
                kept.push(path);
            }
        }
        self.paths = kept;
    }

    fn findings(&self) -> Vec<Problem> {
        let mut found = Vec::new();
        if let Some(jumped_s) = self.jumped_s {
            let whose = if self.anchors.is_some() { "anchors" } else { "fixes" };
            let text = format!("the path was moved to the frame of the {whose} at {jumped_s:.2} s");
            found.push(Code::Navigation.note(text));
        }
        if self.anchors.is_some() && !self.placed {
            let text = "the path is not yet in the frame of the anchors: no twelve ranges to three of them within 3 s";
            let remedy = "see whether ranges arrive, or give the start: --start";
            found.push(Code::Navigation.note(text).remedy(remedy));
        }
        found.extend(self.paths.first().map(Navigator::findings).unwrap_or_default());
        found
    }
}
