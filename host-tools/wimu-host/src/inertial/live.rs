//! Navigation of a stream.

use nalgebra::{Matrix3, Vector3};
use wimu_nav::navigator::{Gyroscope, Model, NoGyroscope, Profile, Sample};
use wimu_nav::stance::AHEAD_S;
use wimu_nav::state::{POSITION, VELOCITY};
use wimu_nav::stationarity::Detector;

use super::fixes::{Aided, Fix, Fixes};
use super::sense::{Senses, clipped};
use super::track::{Input, Track, counted_findings};
use super::unit::{HEADINGS, OnceEachField, Unit, noise_mps2, sample};
use super::{Choice, InertialPath, Method, PathPoint, StartPose};
use crate::finding::{Finding, FindingCode};
use crate::localization::AnchorStates;
use crate::motion::{MotionRecording, UnitSample, other_clock};
use crate::{ErrorCode, Result};

/// Samples before the first answer, s: what shows whether the sensors are calibrated, and the alignment.
const START_S: f64 = 3.0;
/// The navigator takes samples in blocks of this length, s.
const BLOCK_S: f64 = 0.1;
/// Samples that are kept before the horizon, s: those that a stance looks back to.
const KEPT_S: f64 = AHEAD_S + 1.0;
/// Difference of the logarithms of two likelihoods beyond which the smaller one is ruled out: odds of 1 to 2·10⁹.
const RULED_OUT: f64 = 21.4;
/// Fixes that are all later than the newest sample by this time, s, are of another clock: a day.
const FAR_S: f64 = 86_400.0;
/// Standard deviation of a heading of which nothing is known, rad.
const ANY_HEADING: f64 = 1.81;

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
/// # Ok::<(), wimu_host::HostError>(())
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
    findings: Vec<Finding>,
    /// Fixes and ranges that came too late.
    late: [usize; 2],
    not_finite: usize,
    clipped: usize,
}

/// What the first seconds have shown.
struct Begun {
    method: Method,
    senses: Senses,
    noise_mps2: f64,
    path: Box<dyn Follow + Send>,
}

impl Live {
    /// Before the first sample. `of` has the full scale and the calibration of the sensors; fixes may arrive `delay_s` late.
    pub fn new(choice: Choice, of: MotionRecording, delay_s: f64) -> Self {
        let window_s = match choice.profile {
            Profile::Foot => Detector::<f64>::foot().window_s + AHEAD_S,
            _ => Detector::<f64>::default().window_s,
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
        }
    }

    /// The next sample, at a time on the device's clock, s; its `step_s` is not read. A reading of the magnetometer may be
    /// repeated.
    ///
    /// # Errors
    /// `data_refused`, three seconds after the first sample: these do not show gravity, or there are too many anchors.
    pub fn push(&mut self, time_s: f64, sample: UnitSample) -> Result<()> {
        let mut values = sample.force_mps2.into_iter().chain([time_s]);
        if !values.all(f64::is_finite) {
            self.not_finite += 1;
            return Ok(());
        }
        let last_s = self.recording.times_s.last().copied().unwrap_or(time_s);
        let sample = UnitSample {
            step_s: time_s - last_s,
            ..sample
        };
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
        let method = self
            .begun
            .as_ref()
            .map_or(Method::Strapdown, |begun| begun.method);
        let mut path = InertialPath::new(method, points, 0, self.choice.limit_m);
        path.findings = self.findings();
        path.aided = self.aided();
        path
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
        let mut point = begun
            .path
            .ahead(inputs.get(self.taken..)?, &self.choice.fixes)?;
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
    pub fn findings(&self) -> Vec<Finding> {
        let mut found = self.findings.clone();
        let late = "arrived later than the filter waits: not used (--fix-delay)";
        let counts = [
            (self.late[0], "fix", late),
            (self.late[1], "range", late),
            (self.clipped, "clipped sample", "not used: σ grows there"),
            (self.not_finite, "sample", "that is not finite: not used"),
        ];
        for (count, one, what) in counts {
            let counts = [(count, what)];
            found.extend(counted_findings(FindingCode::SamplesLeftOut, one, &counts));
        }
        found.extend(self.other_clock());
        if let Some(begun) = &self.begun {
            found.extend(begun.path.findings(&self.choice.fixes));
        }
        found
    }

    /// Fixes of a file whose times are not those of the device.
    fn other_clock(&self) -> Option<Finding> {
        let fixes = &self.choice.fixes.fixes;
        let (first, last) = fixes.first().zip(fixes.last())?;
        let newest_s = self.newest_s()?;
        if first.time_s < newest_s + FAR_S {
            return None;
        }
        let fixes = ("fixes or ranges", [first.time_s, last.time_s]);
        let error = other_clock([fixes, ("device", [newest_s; 2])]);
        Some(
            FindingCode::Clock
                .warning(error.message())
                .remedy(error.remedy()),
        )
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
        let method = match recording.samples.iter().any(|s| s.rate_rad_s.is_some()) {
            true => Method::Strapdown,
            false => Method::Tilt,
        };
        self.findings = senses.findings.clone();
        if recording.samples.iter().all(|s| s.field_ut.is_none()) {
            let text = format!(
                "{}: heading is that of the body at the start, until fixes show it",
                recording.without_field()
            );
            self.findings.push(FindingCode::Navigation.note(text));
        }
        let noise_mps2 = noise_mps2(&recording.times_s, &recording.samples);
        let unit = unit(recording, &senses, &senses.clipped, noise_mps2);
        let (choice, ranges) = (&self.choice, self.choice.fixes.ranging.is_some());
        let path: Box<dyn Follow + Send> = match (method, ranges) {
            (Method::Strapdown, false) => unit.begin::<Gyroscope<f64>, 40>(choice, method)?,
            (Method::Strapdown, true) => unit.begin::<Gyroscope<f64>, 64>(choice, method)?,
            (_, false) => unit.begin::<NoGyroscope<f64>, 24>(choice, method)?,
            (_, true) => unit.begin::<NoGyroscope<f64>, 48>(choice, method)?,
        };
        self.begun = Some(Begun {
            method,
            senses,
            noise_mps2,
            path,
        });
        Ok(())
    }

    fn inputs<'s>(&self, samples: &'s [Sample<f64>], begun: &Begun) -> Vec<Input<'s>> {
        let clipped = clipped(&self.recording.samples);
        let unit = unit(&self.recording, &begun.senses, &clipped, begun.noise_mps2);
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

fn unit<'a>(
    recording: &'a MotionRecording,
    senses: &Senses,
    clipped: &'a [usize],
    noise_mps2: f64,
) -> Unit<'a> {
    Unit {
        name: &recording.name,
        times_s: &recording.times_s,
        samples: &recording.samples,
        clipped,
        gravity_mps2: recording.gravity_mps2(),
        bias_mps2: senses.bias_mps2,
        covariance: recording.calibration_covariance(),
        uncalibrated: senses.uncalibrated,
        time_sd_s: 0.0,
        noise_mps2,
    }
}

impl Unit<'_> {
    /// The path from the first sample on.
    fn begin<M, const N: usize>(
        &self,
        choice: &Choice,
        method: Method,
    ) -> Result<Box<Headings<M, N>>>
    where
        M: Model<f64, N> + Clone,
    {
        self.accepts(choice, method)?;
        let samples: Vec<_> = self.samples.iter().map(sample).collect();
        let inputs = self.inputs(&samples, choice, method);
        let rests: Vec<bool> = inputs.iter().map(|input| input.resting).collect();
        let mut start = self.start::<M, N>(&samples, &rests, choice)?;
        let at_rest = self.first_rest(&rests).is_some();
        let ranging = choice.fixes.ranging.as_ref();
        let anchors = ranging.map(|ranging| AnchorStates::claim(ranging, &mut start));
        let anchors = anchors.transpose().map_err(|error| {
            let remedy = "give at most 12 anchors beside a board";
            ErrorCode::DataRefused.error(format!("too many anchors: {error}"), remedy)
        })?;
        Ok(Box::new(Headings {
            tracks: vec![Track::new(start, choice, self.times_s[0], at_rest)],
            placed: choice.start.is_some() && anchors.is_none(),
            anchors,
            given: choice.start,
            limit_m: choice.limit_m,
            jumped_s: None,
        }))
    }
}

/// A path whose samples and fixes arrive.
trait Follow {
    /// Takes samples.
    fn advance(&mut self, inputs: &[Input], fixes: &Fixes);

    /// The point after further samples, which are not taken.
    fn ahead(&self, inputs: &[Input], fixes: &Fixes) -> Option<PathPoint>;

    fn findings(&self, fixes: &Fixes) -> Vec<Finding>;

    fn headings(&self) -> usize;

    /// What happened to fixes and ranges.
    fn aided(&self) -> [Aided; 2];
}

/// A path at several headings, until fixes rule out all but one.
struct Headings<M, const N: usize> {
    tracks: Vec<Track<M, N>>,
    /// States of the anchors of ranges.
    anchors: Option<AnchorStates>,
    /// Pose at the start in the frame of the anchors.
    given: Option<StartPose>,
    limit_m: f64,
    /// Whether the path is in the frame of the fixes.
    placed: bool,
    /// When it was moved to it, s.
    jumped_s: Option<f64>,
}

impl<M: Model<f64, N> + Clone, const N: usize> Headings<M, N> {
    fn best(&self) -> Option<&Track<M, N>> {
        let likelihood = |track: &&Track<M, N>| track.aiding.log_likelihood;
        let ordered = |a: &&_, b: &&_| likelihood(a).total_cmp(&likelihood(b));
        self.tracks.iter().max_by(ordered)
    }

    /// Moves the path at a time, s, to positions that fixes or ranges show, each at all headings.
    fn place(&mut self, positions: &[(Vector3<f64>, f64)], time_s: f64) {
        let track = &self.tracks[0];
        let turn = |k| f64::from(k) * std::f64::consts::TAU / f64::from(HEADINGS);
        let given = self.given.and_then(|pose| pose.heading_rad);
        let headings: Vec<f64> = given.map_or_else(
            || (0..HEADINGS).map(turn).collect(),
            |heading| vec![heading],
        );
        let pairs = positions
            .iter()
            .flat_map(|position| headings.iter().map(move |heading| (position, heading)));
        let all = pairs.map(|(position, heading)| {
            let mut track = track.clone();
            track.place(*position, *heading);
            track.aiding.anchors = self.anchors.clone();
            track
        });
        self.tracks = all.collect();
        (self.placed, self.jumped_s) = (true, Some(time_s));
    }

    /// Whether all headings have the position of the best one to the limit, also after the time of further samples.
    fn agree(&self, best: &Track<M, N>, inputs: &[Input]) -> bool {
        let ends = inputs.first().zip(inputs.last());
        let ahead_s = ends.map_or(0.0, |(first, last)| last.time_s - first.time_s);
        let at = |track: &Track<M, N>| {
            let state = &track.navigator.filter().state;
            state.get(POSITION) + state.get(VELOCITY) * ahead_s
        };
        let apart = |track: &Track<M, N>| (at(track) - at(best)).norm();
        self.tracks.iter().all(|track| apart(track) <= self.limit_m)
    }

    /// Drops headings that are ruled out, and those that have come to the solution of a more probable one.
    fn prune(&mut self) {
        self.tracks
            .sort_by(|a, b| b.aiding.log_likelihood.total_cmp(&a.aiding.log_likelihood));
        let mut kept: Vec<Track<M, N>> = Vec::new();
        for track in self.tracks.drain(..) {
            let same = |other: &Track<M, N>| {
                let apart = track.navigator.heading() - other.navigator.heading();
                let apart = apart.sin().atan2(apart.cos()).abs();
                let covariance = other.navigator.solution().attitude_covariance;
                let [here, there] = [&track, other].map(|track| track.navigator.filter());
                let distance = here.state.get(POSITION) - there.state.get(POSITION);
                let variance =
                    there.covariance(POSITION).trace() + here.covariance(POSITION).trace();
                apart < Matrix3::from(covariance)[(2, 2)].sqrt()
                    && distance.norm_squared() < variance
            };
            let is_lost = kept.first().is_some_and(|best| {
                best.aiding.log_likelihood - track.aiding.log_likelihood > RULED_OUT
            });
            if !is_lost && !kept.iter().any(same) {
                kept.push(track);
            }
        }
        self.tracks = kept;
    }
}

impl<M: Model<f64, N> + Clone, const N: usize> Follow for Headings<M, N> {
    fn advance(&mut self, inputs: &[Input], fixes: &Fixes) {
        for input in inputs {
            if !self.placed {
                let positions = fixes.positions(input.time_s, self.given.as_ref());
                if !positions.is_empty() {
                    self.place(&positions, input.time_s);
                }
            }
            for track in &mut self.tracks {
                track.step(input, fixes);
            }
        }
        if self.tracks.len() > 1 {
            self.prune();
        }
    }

    fn ahead(&self, inputs: &[Input], fixes: &Fixes) -> Option<PathPoint> {
        let mut track = self.best()?.clone();
        let unplaced = Fixes::default();
        let fixes = if self.placed { fixes } else { &unplaced };
        let mut last = None;
        for input in inputs {
            last = Some(track.step(input, fixes));
        }
        let mut point = last?;
        point.valid = track.has_origin() && self.agree(self.best()?, inputs);
        if self.tracks.len() > 1 {
            point.attitude_sd_rad[2] = ANY_HEADING;
        }
        Some(point)
    }

    fn headings(&self) -> usize {
        self.tracks.len()
    }

    fn aided(&self) -> [Aided; 2] {
        let of = |track: &Track<M, N>| [track.aiding.fixes, track.aiding.ranges];
        self.best().map_or_else(Default::default, of)
    }

    fn findings(&self, fixes: &Fixes) -> Vec<Finding> {
        let mut found = Vec::new();
        if let Some(jumped_s) = self.jumped_s {
            let whose = fixes.ranging.as_ref().map_or("fixes", |_| "anchors");
            let text = format!("the path was moved to the frame of the {whose} at {jumped_s:.2} s");
            found.push(FindingCode::Navigation.note(text));
        }
        if let Some(best) = self.best() {
            found.extend(best.findings(fixes.ranging.as_ref()));
        }
        found
    }
}
