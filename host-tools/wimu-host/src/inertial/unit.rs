//! The path of one unit through the navigator.

use std::ops::Range;

use nalgebra::Vector3;
use wimu_nav::navigator::{
    self as core, Motion, Profile, Rests, Sample, Settings, Start, VehicleErrors,
};
use wimu_nav::stance::stances;

use super::aids::Aid;
use super::aids::speed::SPEED;
use super::horizon::{gap_s, gaps};
use super::moves::{Move, REST_S, moves};
use super::navigator::{Carrier, FIRST_REST_S, Navigator, Step, counted_findings};
use super::rests::runs;
use super::sense::Senses;
use super::steps::{steps, turns_like_a_foot};
use super::{Choice, InertialPath, Method, Zupt};
use crate::imu::Imu;
use crate::plural::counted;
use crate::rests::RestLimits;
use crate::stats::{median, quantile};
use crate::{Code, Problem, Result};

/// A reading of the magnetometer that is repeated within this time is a held one, s.
const HELD_S: f64 = 0.25;
/// Time of the initial alignment, s: at rest, and of a start in motion.
const ALIGNMENT_S: f64 = 0.7;
const SHORT_ALIGNMENT_S: f64 = 0.1;
/// Headings at the start that are tried where fixes show the position, and time of the trial, s.
pub(super) const HEADINGS: u32 = 12;
const HEADING_TRIAL_S: f64 = 120.0;

/// The samples, each reading of a magnetometer that is slower than the accelerometer once.
#[derive(Default)]
pub(super) struct OnceEachField {
    last: Option<Vector3<f64>>,
    age_s: f64,
}

impl OnceEachField {
    /// The next sample.
    pub fn of(&mut self, sample: &Sample) -> Sample {
        self.age_s += sample.step_s;
        let held =
            sample.field_ut.is_none() || (sample.field_ut == self.last && self.age_s < HELD_S);
        if !held {
            (self.last, self.age_s) = (sample.field_ut, 0.0);
        }
        Sample { field_ut: sample.field_ut.filter(|_| !held), ..*sample }
    }
}

/// Logarithm of the ratio of two likelihoods above which another explanation of fixes that contradict the path is taken, (170):
/// half of the χ² quantile, 99.99 %, of three degrees of freedom.
const SHOWN: f64 = 10.6;

/// Scale factor and misalignment of an accelerometer that is not calibrated: MPU-9250 datasheet, initial tolerance and
/// cross-axis sensitivity.
const UNCALIBRATED: [f64; 2] = [0.03, 0.02];

/// One unit's samples, ready to navigate.
pub(super) struct Unit<'a> {
    pub name: &'a str,
    pub times_s: &'a [f64],
    pub samples: &'a [Sample],
    /// Samples at which the accelerometer clips.
    pub clipped: &'a [usize],
    pub gravity_mps2: f64,
    /// Standard deviation of the accelerometer's bias, m/s².
    pub bias_mps2: f64,
    /// Covariance of the calibration, where it is known.
    pub covariance: Option<[[f64; 12]; 12]>,
    /// Whether |f| at rest shows that the accelerometer is not calibrated.
    pub uncalibrated: bool,
    /// Standard deviation of a sample's time, s.
    pub time_sd_s: f64,
    /// Noise of the accelerometer, m/s², a component.
    pub noise_mps2: f64,
}

impl<'a> Unit<'a> {
    /// Samples of a recording whose times are exact.
    pub fn of(
        recording: &'a Imu,
        times_s: &'a [f64],
        samples: &'a [Sample],
        senses: &Senses,
        clipped: &'a [usize],
        noise_mps2: f64,
    ) -> Self {
        Self {
            name: &recording.name,
            times_s,
            samples,
            clipped,
            gravity_mps2: recording.gravity_mps2(),
            bias_mps2: senses.bias_mps2,
            covariance: recording.calibration_covariance(),
            uncalibrated: senses.uncalibrated,
            time_sd_s: 0.0,
            noise_mps2,
        }
    }

    /// The path with a gyroscope, or without.
    ///
    /// # Errors
    /// `data_refused`: nothing to align with, or a foot without a gyroscope.
    pub fn path(&self, choice: &Choice, method: Method) -> Result<InertialPath> {
        self.accepts(choice, method)?;
        let steps = self.steps(choice, method);
        let rests = rests_of(&steps);
        let mut moves = moves(self, &rests, choice, method);
        if method == Method::Tilt && choice.profile == Profile::Hand && self.slides(&rests, &moves)
        {
            return self.slide(choice, &rests);
        }
        choice.aids.within(self.times_s).map_err(|error| error.at(self.name))?;
        let at_rest_first = self.first_rest(&rests).is_some();
        // Without a gyroscope the smoother gains nothing: 0.1 % of the error (docs/reference/validation.md, accelerometer).
        let smooth = choice.smooth && method == Method::Strapdown;
        let navigate = |choice: &Choice| {
            let mut navigator = self.placed(&self.start(&rests, choice)?, &steps, choice);
            navigator.record(smooth, moves.iter().map(|one| one.span(self.times_s)).collect());
            let closed = choice
                .loop_m
                .zip(self.times_s.last())
                .map(|(sd_m, last_s)| choice.aids.closed(sd_m, choice.start.as_ref(), *last_s));
            run(&mut navigator, &choice.aids.aids, closed.as_ref(), &steps);
            Ok(navigator)
        };
        let mut navigator = navigate(choice)?;
        let least = navigator.log_likelihood + SHOWN;
        let mut without_rests = false;
        if method == Method::Strapdown && navigator.rejects_fixes() {
            for other in self.others(choice) {
                let tried = navigate(&other)?;
                if tried.log_likelihood > navigator.log_likelihood.max(least) {
                    navigator = tried;
                    without_rests = other.zupt != choice.zupt;
                }
            }
        }
        let [used, rejected] = navigator.core.fields();
        if method == Method::Strapdown && rejected > used {
            return self
                .path_without_field(choice, f64::from(rejected) / f64::from(used + rejected));
        }
        let has_origin = at_rest_first || navigator.framed;
        let (mut points, said) = navigator.finish(&mut moves);
        let from = navigator.origin.unwrap_or(0);
        for (k, point) in points.iter_mut().enumerate() {
            point.valid &= point.sd_m() <= choice.limit_m && (has_origin || k >= from);
        }
        let mut path = InertialPath::new(method, points, from, choice.limit_m);
        let rests_only = path.points[from..].iter().all(|point| point.resting);
        let is_short = self.within(FIRST_REST_S) == self.samples.len();
        if !has_origin && (is_short || rests_only) {
            return Err(self.moves_before(&path, from));
        }
        path.moves = moves;
        path.smoothed = smooth;
        path.findings = self.findings(choice, method, &navigator, said);
        if without_rests {
            let text = "the fixes contradict the rests, which were motion without a change of velocity: they are not used";
            let remedy =
                "--rests FROM-TO gives times at which it rested, --zupt off says that it did not";
            path.findings.push(Code::Navigation.warning(text).remedy(remedy));
        }
        if let (false, Some(origin)) = (at_rest_first, navigator.origin) {
            let text = format!(
                "no rest at the start: position is measured from the first rest, at {:.2} s",
                self.times_s[origin]
            );
            path.findings.insert(0, Code::Navigation.note(text));
        }
        path.states = navigator.states();
        path.aids = navigator.uses;
        path.residuals = navigator.residuals;
        Ok(path)
    }

    /// What may explain fixes that contradict the path: an antenna at a lever arm, and rests that were none.
    fn others(&self, choice: &Choice) -> Vec<Choice> {
        let antenna = choice.aids.of_antenna().filter(|_| choice.profile != Profile::Vehicle);
        let mut others = Vec::from_iter(antenna.map(|aids| Choice { aids, ..choice.clone() }));
        if choice.zupt == Zupt::Stated
            && choice.rests_s.is_none()
            && choice.profile != Profile::Foot
        {
            others.push(Choice { zupt: Zupt::Off, ..choice.clone() });
        }
        others
    }

    /// What was noticed, with what is `said` of segments.
    fn findings(
        &self,
        choice: &Choice,
        method: Method,
        navigator: &Navigator,
        said: Vec<Problem>,
    ) -> Vec<Problem> {
        let mut findings = choice.aids.findings.clone();
        findings.extend(navigator.findings());
        findings.extend(said);
        findings.extend(gaps(self.times_s, "sample", gap_s(self.times_s)));
        let clipped = [(self.clipped.len(), "not used: σ grows there")];
        findings.extend(counted_findings(Code::Navigation, "clipped sample", &clipped));
        match choice.profile {
            Profile::Hand if method == Method::Strapdown => findings.extend(self.foot()),
            Profile::Foot if !turns_like_a_foot(self.samples) => {
                let text = "no foot swings in it: velocity is taken as zero at rests alone";
                let remedy = "if it was on none, leave --profile foot out";
                findings.push(Code::Navigation.warning(text).remedy(remedy));
            }
            _ => {}
        }
        findings
    }

    /// Whether all motion, but for less than the shortest rest, is moves between rests at which gravity has one direction.
    fn slides(&self, rests: &[bool], moves: &[Move]) -> bool {
        let is_move =
            |t: f64| moves.iter().any(|one| one.valid && (one.from_s..=one.to_s).contains(&t));
        let others = (0..rests.len()).filter(|k| !rests[*k] && !is_move(self.times_s[*k]));
        let others_s: f64 = others.map(|k| self.samples[k].step_s).sum();
        !moves.is_empty() && others_s < REST_S
    }

    /// The path of a motion without rotation: an angular rate of zero takes the place of the gyroscope.
    fn slide(&self, choice: &Choice, rests: &[bool]) -> Result<InertialPath> {
        let still = |sample: &Sample| Sample { rate_rad_s: Some(Vector3::zeros()), ..*sample };
        let samples: Vec<Sample> = self.samples.iter().map(still).collect();
        let times = |rest: Range<usize>| self.times_s[rest.start]..=self.times_s[rest.end - 1];
        let rests_s = Some(runs(rests).into_iter().map(times).collect());
        let choice = Choice { profile: Profile::Slide, rests_s, ..choice.clone() };
        let mut path = Unit { samples: &samples, ..*self }.path(&choice, Method::Strapdown)?;
        path.method = Method::Tilt;
        let text = "gravity has one direction at all rests: no rotation is assumed between them (one about the vertical would \
                    not show)";
        path.findings.push(Code::Navigation.note(text));
        Ok(path)
    }

    /// The path without a magnetometer most of whose readings contradict the motion: the heading that its first ones gave is as
    /// wrong as they are.
    fn path_without_field(&self, choice: &Choice, part: f64) -> Result<InertialPath> {
        let bare = |sample: &Sample| Sample { field_ut: None, ..*sample };
        let samples: Vec<Sample> = self.samples.iter().map(bare).collect();
        let mut path = Unit { samples: &samples, ..*self }.path(choice, Method::Strapdown)?;
        let text = format!(
            "the magnetic field contradicted the motion in {:.0} % of its readings: it is not used, and heading is that of the \
             body at the start",
            100.0 * part
        );
        let remedy =
            "calibrate the magnetometer, check its axes and signs; iron or a magnet may be near";
        path.findings.insert(0, Code::Navigation.warning(text).remedy(remedy));
        Ok(path)
    }

    /// A navigator at the first sample, in the frame of the fixes where there are some: of the position, height and heading that
    /// they measure, at the heading that explains those of the first minutes best.
    fn placed(&self, start: &core::Navigator, steps: &[Step], choice: &Choice) -> Navigator {
        let at_rest = self.first_rest(&rests_of(steps)).is_some();
        let framed = choice.start.is_some();
        let begin = |at_rest| Navigator::new(start.clone(), self.times_s[0], at_rest, framed);
        let fix = choice.aids.origin();
        let shows_heading = choice.aids.show_heading();
        let is_given =
            choice.start.is_some_and(|pose| pose.heading_rad.is_some() || !shows_heading);
        if is_given || !(shows_heading || choice.aids.height().is_some()) {
            return begin(at_rest);
        }
        let is_placed = fix.is_some() || choice.start.is_some();
        let place = is_placed.then(|| choice.aids.place(choice.start.as_ref()));
        let velocity = choice.aids.velocity(self.times_s[0]).filter(|_| !at_rest);
        let placed = |heading: f64, at_rest| {
            let mut navigator = begin(at_rest);
            match place {
                Some(place) => navigator.place(place, velocity, heading),
                None => navigator.frame(choice.aids.height(), heading),
            }
            navigator
        };
        if !shows_heading {
            return placed(start.heading(), at_rest);
        }
        // The forward axis that speeds need is known at some headings only, and likelihoods of other data do not compare.
        let shown: Vec<Aid> =
            choice.aids.aids.iter().filter(|aid| *aid.kind != SPEED).copied().collect();
        let first_s = fix.or(shown.first()).map_or(self.times_s[0], |aid| aid.time_s);
        let until = steps.partition_point(|step| step.time_s < first_s + HEADING_TRIAL_S);
        let trial = |heading: f64| {
            let mut navigator = placed(heading, false);
            run(&mut navigator, &shown, None, &steps[..until]);
            (navigator.log_likelihood, heading)
        };
        let turn = |k| f64::from(k) * std::f64::consts::TAU / f64::from(HEADINGS);
        let tried = (0..HEADINGS).rev().map(turn).map(trial);
        let best = tried.max_by(|a, b| a.0.total_cmp(&b.0));
        placed(best.map_or(0.0, |(_, heading)| heading), at_rest)
    }

    /// A navigator of a stream, at its first sample.
    pub fn begin(&self, steps: &[Step], choice: &Choice) -> Result<Navigator> {
        let rests = rests_of(steps);
        let start = self.start(&rests, choice)?;
        let at_rest = self.first_rest(&rests).is_some();
        Ok(Navigator::new(start, self.times_s[0], at_rest, choice.start.is_some()))
    }

    /// Whether the sensors are those that the choice needs.
    ///
    /// # Errors
    /// `data_refused`: a foot, or ranges, without a gyroscope.
    pub fn accepts(&self, choice: &Choice, method: Method) -> Result<()> {
        let needed = match choice.profile {
            Profile::Foot => Some("--profile foot"),
            _ => choice.aids.ranging.as_ref().map(|_| "--ranges beside a board"),
        };
        if let (Some(what), true) = (needed, method != Method::Strapdown) {
            let message = format!("{what} needs a gyroscope");
            let remedy = match choice.profile {
                Profile::Foot => "record the angular rate, or use another profile",
                _ => {
                    "navigate the ranges alone: `wimu navigate RANGES.csv --setup anchors=ANCHORS.csv`"
                }
            };
            return Err(Code::DataRefused.error(message, remedy).at(self.name));
        }
        Ok(())
    }

    /// The samples with what windows about them show of the motion.
    pub fn steps(&self, choice: &Choice, method: Method) -> Vec<Step> {
        let rests = self.rests(choice, method);
        let stances = match choice.profile {
            Profile::Foot if method == Method::Strapdown => self.stances(choice),
            _ => vec![None; self.samples.len()],
        };
        // A foot's shocks are short: the largest reading is nearer to them than none.
        let is_left_out =
            |k: &usize| choice.profile != Profile::Foot && self.clipped.binary_search(k).is_ok();
        let steps = self.samples.iter().enumerate().map(|(k, sample)| Step {
            time_s: self.times_s[k],
            step_s: sample.step_s,
            carrier: if is_left_out(&k) { Carrier::Unmeasured } else { Carrier::Sample(*sample) },
            resting: rests[k],
            stance_mps: stances[k],
        });
        steps.collect()
    }

    /// The stances of a foot: the standard deviation of the velocity there, m/s. What does not turn like a foot has none.
    fn stances(&self, choice: &Choice) -> Vec<Option<f64>> {
        let are_given = choice.rests_s.is_some() || choice.zupt.rests() == Rests::Ignored;
        if are_given || !turns_like_a_foot(self.samples) {
            return vec![None; self.samples.len()];
        }
        self.found_stances()
    }

    fn found_stances(&self) -> Vec<Option<f64>> {
        let mut found = vec![None; self.samples.len()];
        let statistics = self.statistics(RestLimits::foot());
        stances(&statistics, 1.0 / median_step_s(self.times_s), &mut found);
        found
    }

    /// Whether the motion is that of a foot, which is taken for that of a hand.
    fn foot(&self) -> Option<Problem> {
        let stances = self.found_stances();
        let is_stance: Vec<bool> = stances.iter().map(Option::is_some).collect();
        let steps = steps(self.times_s, self.samples, &runs(&is_stance))?;
        let text = format!("it moves like a foot, in {}", counted(steps, "step"));
        let remedy = "if it was on one: --profile foot, which knows the velocity in each stance";
        Some(Code::Navigation.warning(text).remedy(remedy))
    }

    /// No part of a motion is known relative to a rest that only ends it.
    fn moves_before(&self, path: &InertialPath, from: usize) -> Problem {
        let message = match path.points.get(from).filter(|point| point.resting) {
            Some(point) => format!(
                "the path is measured from the first rest, and that ends it, at {:.2} s",
                point.time_s
            ),
            None => "the recording has no rest from which the path is measured".to_owned(),
        };
        let remedy =
            "hold the unit still for a second before the motion; on a foot: --profile foot";
        Code::DataRefused.error(message, remedy).at(self.name)
    }

    /// Samples within a time of the start: at least one.
    fn within(&self, length_s: f64) -> usize {
        let end = self.times_s[0] + length_s;
        self.times_s.partition_point(|t| *t < end).max(1)
    }

    /// The rest at the start: its number of samples. In a motion whose acceleration changes its sign a short window looks
    /// like a rest.
    pub fn first_rest(&self, rests: &[bool]) -> Option<usize> {
        let rest = runs(rests).into_iter().next()?;
        let lasts_s = self.times_s[rest.end - 1] - self.times_s[rest.start];
        let at_start = rest.start < self.within(SHORT_ALIGNMENT_S);
        (at_start && lasts_s >= FIRST_REST_S).then_some(rest.end)
    }

    pub fn start(&self, rests: &[bool], choice: &Choice) -> Result<core::Navigator> {
        let rest = self.first_rest(rests);
        let count = match rest {
            Some(end) => self.within(ALIGNMENT_S).min(end),
            None => self.within(SHORT_ALIGNMENT_S),
        };
        let usable: Vec<Sample> = self.samples[..count]
            .iter()
            .filter(|s| s.force_mps2.iter().all(|f| f.is_finite()))
            .copied()
            .collect();
        let refused = |message: &str| {
            let remedy = "hold the unit still for a second at the start";
            Code::DataRefused.error(message, remedy).at(self.name)
        };
        let start = Start::align(&usable, rest.is_some())
            .ok_or_else(|| refused("the first samples show no gravity to align with"))?;
        let with_rate = self.samples.iter().any(|s| s.rate_rad_s.is_some());
        let in_vehicle = choice.profile == Profile::Vehicle && with_rate;
        let mut settings = self.settings(choice.profile, choice);
        settings.vehicle = in_vehicle.then(VehicleErrors::default);
        if !with_rate {
            settings.motion = Motion::NoGyroscope;
        }
        let mut navigator = self.navigator(settings, &start);
        if let Some(pose) = &choice.start {
            if let Some(heading_rad) = pose.heading_rad {
                navigator.set_heading(heading_rad);
            }
            navigator.set_position(Vector3::from(pose.position_m));
        }
        Ok(navigator)
    }

    /// A navigator with the errors of this unit.
    pub fn navigator(&self, settings: Settings, start: &Start) -> core::Navigator {
        let mut navigator = core::Navigator::new(settings, start);
        if let Some(covariance) = &self.covariance {
            navigator.set_calibration(&(*covariance).into());
        }
        navigator
    }

    pub fn settings(&self, profile: Profile, choice: &Choice) -> Settings {
        let mut settings = Settings::of(profile);
        settings.gravity_mps2 = self.gravity_mps2;
        settings.errors.accelerometer_bias = self.bias_mps2;
        if self.uncalibrated {
            settings.errors.accelerometer_matrix = UNCALIBRATED;
        }
        settings.errors.time_s = self.time_sd_s;
        settings.within_m = choice.within_m;
        settings.rests = choice.zupt.rests();
        settings
    }
}

/// Navigates along steps with aids, and one more.
pub(crate) fn run(navigator: &mut Navigator, aids: &[Aid], last: Option<&Aid>, steps: &[Step]) {
    for aid in aids.iter().chain(last) {
        navigator.aid(aid);
    }
    for step in steps {
        navigator.step(step);
    }
}

fn rests_of(steps: &[Step]) -> Vec<bool> {
    steps.iter().map(|step| step.resting).collect()
}

/// Noise of the accelerometer, m/s², a component: that of the quietest twentieth of windows of 0.25 s.
pub(super) fn noise_mps2(times_s: &[f64], samples: &[Sample]) -> f64 {
    let step_s = median_step_s(times_s).max(f64::MIN_POSITIVE);
    let length = ((0.25 / step_s) as usize).max(5);
    let variance = |window: &[Sample]| {
        let force = || window.iter().map(|s| s.force_mps2);
        let mean = force().sum::<Vector3<f64>>() / length as f64;
        force().map(|f| (f - mean).norm_squared()).sum::<f64>() / (3.0 * length as f64)
    };
    let variances = samples.chunks_exact(length).map(variance);
    quantile(variances, 20).map_or(0.0, f64::sqrt)
}

/// Median time between two samples, s; 0 of fewer than two.
pub(crate) fn median_step_s(times_s: &[f64]) -> f64 {
    median(times_s.windows(2).map(|w| w[1] - w[0])).unwrap_or(0.0)
}
