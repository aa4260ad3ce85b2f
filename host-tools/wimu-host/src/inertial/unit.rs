//! The path of one unit through the navigator.

use nalgebra::Vector3;
use wimu_nav::navigator::{
    Gyroscope, Model, Navigator, NoGyroscope, Profile, Sample, SampleFault, Settings, Start,
};
use wimu_nav::stationarity::{Detector, Stationarity};

use super::moves::moves;
use super::{Choice, InertialPath, Method, PathPoint};
use crate::finding::{Finding, FindingCode};
use crate::motion::{UnitSample, median_step_s};
use crate::plural::counted;
use crate::{ErrorCode, Result};

/// A reading of the magnetometer that is repeated within this time is a held one, s.
const HELD_S: f64 = 0.25;
/// Time of the initial alignment, s: at rest, and of a start in motion or on a foot.
const ALIGNMENT_S: f64 = 0.7;
const SHORT_ALIGNMENT_S: f64 = 0.1;
/// A start in motion ends with the first rest of this length, s.
const FIRST_REST_S: f64 = 0.5;

/// The samples, each reading of a magnetometer that is slower than the accelerometer once.
pub(super) fn once_each_field(samples: &[UnitSample]) -> Vec<UnitSample> {
    let (mut last, mut age_s) = (None, 0.0);
    let once = |sample: &UnitSample| {
        age_s += sample.step_s;
        let held = sample.field_ut.is_none() || (sample.field_ut == last && age_s < HELD_S);
        if !held {
            last = sample.field_ut;
            age_s = 0.0;
        }
        UnitSample {
            field_ut: sample.field_ut.filter(|_| !held),
            ..*sample
        }
    };
    samples.iter().map(once).collect()
}

/// One unit's samples, ready to navigate.
pub(super) struct Unit<'a> {
    pub name: &'a str,
    pub times_s: &'a [f64],
    pub samples: &'a [UnitSample],
    /// Samples at which the accelerometer clips.
    pub clipped: &'a [usize],
    pub gravity_mps2: f64,
    /// Standard deviation of the accelerometer's bias, m/s².
    pub bias_mps2: f64,
    /// Standard deviation of a sample's time, s.
    pub time_sd_s: f64,
}

impl Unit<'_> {
    /// The path with a gyroscope, or without.
    ///
    /// # Errors
    /// `data_refused`: nothing to align with.
    pub fn path(&self, choice: &Choice, method: Method) -> Result<InertialPath> {
        match method {
            Method::Strapdown => self.follow::<Gyroscope<f64>, 40>(choice, method),
            _ => self.follow::<NoGyroscope<f64>, 24>(choice, method),
        }
    }

    fn follow<M: Model<f64, N>, const N: usize>(
        &self,
        choice: &Choice,
        method: Method,
    ) -> Result<InertialPath> {
        let samples: Vec<Sample<f64>> = self.samples.iter().map(sample).collect();
        let rests = self.rests(&samples, choice, method);
        let mut navigator = self.start::<M, N>(&samples, &rests, choice)?;
        let at_rest_first = self.starts_at_rest(&rests);
        let mut origin = at_rest_first.then_some(0);
        let (mut rest_s, mut in_first_rest) = (0.0, at_rest_first);
        let mut faults = Faults::default();
        let mut points = Vec::with_capacity(samples.len());
        for (k, sample) in samples.iter().enumerate() {
            if self.clipped.binary_search(&k).is_ok() {
                navigator.interrupt(sample.step_s);
            } else {
                faults.count(navigator.push(sample, rests[k]));
            }
            rest_s = if rests[k] {
                rest_s + sample.step_s
            } else {
                0.0
            };
            if origin.is_none() && rest_s >= FIRST_REST_S && choice.start.is_none() {
                navigator.set_origin();
                (origin, in_first_rest) = (Some(k), true);
            }
            in_first_rest &= rests[k];
            if in_first_rest {
                origin = Some(k);
            }
            points.push(self.point(k, &navigator, rests[k], choice));
        }
        let from = origin.unwrap_or(0);
        let moves = moves(self, &samples, &rests, choice, method);
        if !at_rest_first && choice.start.is_none() {
            for point in &mut points[..from] {
                point.valid = false;
            }
        }
        let mut path = InertialPath::new(method, points, from, choice.limit_m);
        path.moves = moves;
        if let (false, Some(origin)) = (at_rest_first, origin) {
            path.findings.push(FindingCode::Navigation.note(format!(
                "no rest at the start: position is measured from the first rest, at {:.2} s",
                self.times_s[origin]
            )));
        }
        path.findings.extend(faults.findings());
        for (count, one, what) in [
            (
                self.clipped.len(),
                "clipped sample",
                "not used: σ grows there",
            ),
            (
                navigator.recoveries() as usize,
                "rest",
                "contradicted the estimated velocity: σ was enlarged there",
            ),
            (
                navigator.divergences() as usize,
                "time",
                "the filter diverged and began again. Check axes, signs and units of the sensors",
            ),
        ] {
            if count > 0 {
                let text = format!("{} {what}", counted(count, one));
                path.findings.push(FindingCode::Navigation.warning(text));
            }
        }
        Ok(path)
    }

    /// Whether the unit is at rest at each sample: a window about the sample, or the times that were given.
    fn rests(&self, samples: &[Sample<f64>], choice: &Choice, method: Method) -> Vec<bool> {
        if let Some(given) = &choice.rests_s {
            let inside = |t: &f64| given.iter().any(|rest| rest.contains(t));
            return self.times_s.iter().map(inside).collect();
        }
        let mut settings = match choice.profile {
            Profile::Foot => Detector::foot(),
            _ => Detector::default(),
        };
        settings.gravity_mps2 = self.gravity_mps2;
        if method != Method::Strapdown {
            settings = settings.without_gyroscope(noise_mps2(self.times_s, self.samples));
        }
        let mut detector = Stationarity::new(settings);
        let (mut rests, mut ahead_s) = (Vec::with_capacity(samples.len()), 0.0);
        let mut filling = 0;
        for sample in samples {
            let rate = sample.rate_rad_s.as_ref();
            let rest = detector.push(&sample.force_mps2, rate, sample.step_s);
            ahead_s += sample.step_s;
            if ahead_s + 0.5 * sample.step_s >= detector.lag_s() {
                rests.push(rest);
                filling += usize::from(detector.statistic().is_none());
            }
        }
        // Windows at the start and the end are the nearest full one.
        let first = rests.get(filling).copied().unwrap_or(false);
        rests
            .iter_mut()
            .take(filling)
            .for_each(|rest| *rest = first);
        rests.resize(samples.len(), detector.is_at_rest());
        rests
    }

    /// Samples within a time of the start: at least one.
    fn within(&self, length_s: f64) -> usize {
        let end = self.times_s[0] + length_s;
        self.times_s.partition_point(|t| *t < end).max(1)
    }

    fn starts_at_rest(&self, rests: &[bool]) -> bool {
        rests[..self.within(ALIGNMENT_S)].iter().any(|rest| *rest)
    }

    fn start<M: Model<f64, N>, const N: usize>(
        &self,
        samples: &[Sample<f64>],
        rests: &[bool],
        choice: &Choice,
    ) -> Result<Navigator<f64, M, N>> {
        let rest = self.starts_at_rest(rests);
        let short = !rest || choice.profile == Profile::Foot;
        let count = self.within(if short {
            SHORT_ALIGNMENT_S
        } else {
            ALIGNMENT_S
        });
        let usable: Vec<Sample<f64>> = samples[..count]
            .iter()
            .filter(|s| s.force_mps2.iter().all(|f| f.is_finite()))
            .copied()
            .collect();
        let refused = |message: &str| {
            let remedy = "hold the unit still for a second at the start";
            ErrorCode::DataRefused.error(message, remedy).at(self.name)
        };
        let start = Start::align(&usable, rest)
            .ok_or_else(|| refused("the first samples show no gravity to align with"))?;
        let settings = self.settings(choice.profile, choice);
        let mut navigator =
            Navigator::new(settings, &start).map_err(|error| refused(&error.to_string()))?;
        if let Some(pose) = &choice.start {
            if let Some(heading_rad) = pose.heading_rad {
                navigator.set_heading(heading_rad);
            }
            navigator.set_position(Vector3::from(pose.position_m));
        }
        Ok(navigator)
    }

    /// Settings of a navigator.
    pub fn settings(&self, profile: Profile, choice: &Choice) -> Settings<f64> {
        let mut settings = Settings::of(profile);
        settings.gravity_mps2 = self.gravity_mps2;
        settings.errors.accelerometer_bias = self.bias_mps2;
        settings.errors.time_s = self.time_sd_s;
        settings.within_m = choice.within_m;
        settings.rests = choice.zupt.rests();
        settings
    }

    fn point<M: Model<f64, N>, const N: usize>(
        &self,
        k: usize,
        navigator: &Navigator<f64, M, N>,
        at_rest: bool,
        choice: &Choice,
    ) -> PathPoint {
        let found = navigator.solution();
        let deviations =
            |covariance: [[f64; 3]; 3]| std::array::from_fn(|i| covariance[i][i].sqrt());
        let mut point = PathPoint {
            time_s: self.times_s[k],
            position_m: found.position_m,
            velocity_mps: found.velocity_mps,
            velocity_sd_mps: deviations(found.velocity_covariance),
            attitude_sd_rad: deviations(found.attitude_covariance),
            quaternion: found.quaternion,
            rate_rad_s: navigator.angular_rate().into(),
            covariance_m2: found.position_covariance,
            resting: at_rest && navigator.is_at_rest(),
            valid: true,
        };
        point.valid = point.sd_m() <= choice.limit_m;
        point
    }
}

/// Noise of the accelerometer, m/s², a component: that of the quietest twentieth of windows of 0.25 s.
pub(super) fn noise_mps2(times_s: &[f64], samples: &[UnitSample]) -> f64 {
    let step_s = median_step_s(times_s).max(f64::MIN_POSITIVE);
    let length = ((0.25 / step_s) as usize).max(5);
    let variance = |window: &[UnitSample]| {
        let force = || window.iter().map(|s| Vector3::from(s.force_mps2));
        let mean = force().sum::<Vector3<f64>>() / length as f64;
        force().map(|f| (f - mean).norm_squared()).sum::<f64>() / (3.0 * length as f64)
    };
    let mut variances: Vec<f64> = samples.chunks_exact(length).map(variance).collect();
    variances.sort_by(f64::total_cmp);
    variances
        .get(variances.len() / 20)
        .map_or(0.0, |v| v.sqrt())
}

fn sample(sample: &UnitSample) -> Sample<f64> {
    Sample {
        step_s: sample.step_s,
        force_mps2: sample.force_mps2.into(),
        rate_rad_s: sample.rate_rad_s.map(Into::into),
        field_ut: sample.field_ut.map(Into::into),
    }
}

/// Samples that were not used.
#[derive(Default)]
struct Faults {
    times: usize,
    values: usize,
}

impl Faults {
    fn count(&mut self, pushed: std::result::Result<(), SampleFault>) {
        match pushed {
            Ok(()) => {}
            Err(SampleFault::NoTime) => self.times += 1,
            Err(_) => self.values += 1,
        }
    }

    fn findings(&self) -> impl Iterator<Item = Finding> {
        [
            (self.times, "whose time goes back: not used"),
            (self.values, "that is not finite: not used"),
        ]
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| {
            let text = format!("{} {what}", counted(count, "sample"));
            FindingCode::SamplesLeftOut.warning(text)
        })
    }
}
