//! The path of a recorded unit or array, sample by sample, with what is known about it: gyro-free
//! inertial navigation of a file.
//!
//! ```
//! use wimu_host::inertial::{Choice, Method, navigate};
//! use wimu_host::motion::MotionRecording;
//! use wimu_nav::unit::UnitSample;
//!
//! // Two seconds at rest.
//! let mut recording = MotionRecording::default();
//! for k in 0..200 {
//!     let force_mps2 = [0.0, 0.0, if k % 2 == 0 { 9.80 } else { 9.81 }];
//!     recording.times_s.push(f64::from(k) * 0.01);
//!     recording.samples.push(UnitSample { step_s: 0.01, force_mps2, ..UnitSample::default() });
//!     recording.truth.push(None);
//! }
//! let path = navigate(&recording, &Choice { method: Method::Tilt, ..Choice::default() })?;
//! assert!(path.distance_m() < 0.01 && path.points[199].valid);
//! assert!(path.horizon_s(1.0).is_none(), "at rest, with ZUPT, it never gets lost");
//! # Ok::<(), wimu_host::HostError>(())
//! ```

mod array;
mod arrival;
mod frozen;
mod holes;
mod horizon;
mod origin;
mod path;
mod rates;
mod report;
mod sense;
mod slide;
mod truth;
mod unit;
mod warming;

pub use array::{navigate_array, navigate_axes};
pub use horizon::{Horizon, Stillness};
pub use path::{InertialPath, PathPoint, SlideMove};
pub use slide::{Leg, legs};
pub use truth::consistency;

pub use wimu_nav::Zupt;
use wimu_nav::drift::{Drift, DriftEstimator, DriftFit};
use wimu_nav::unit::{UnitConfig, UnitSample};

use crate::finding::FindingCode;
use crate::motion::MotionRecording;
use crate::{ErrorCode, HostError, Result};
use holes::Holes;
use truth::{compare, moving};
use unit::{filter, once_each_field};

/// How the path is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// With the angular rate, from a gyroscope.
    Strapdown,
    /// From accelerometer and magnetometer alone.
    #[default]
    Tilt,
    /// With the angular rate of an array of accelerometers.
    Array,
    /// Straight moves between rests.
    Slide,
}

impl Method {
    /// The method for a recording of one unit where none is chosen: with the angular rate if it has one.
    pub fn of(recording: &MotionRecording) -> Self {
        let has_rate = recording.samples.iter().any(|s| s.rate_rad_s.is_some());
        if has_rate {
            Self::Strapdown
        } else {
            Self::Tilt
        }
    }
}

/// Deviations up to which something is likely.
const LIKELY: f64 = 3.0;

/// How to navigate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// The method.
    pub method: Method,
    /// Whether stillnesses are taken for zero velocity, and whether they are known to be rests: [`Zupt::Stated`] is what
    /// `wimu navigate` does unless it is told otherwise.
    pub zupt: Zupt,
    /// Position is of use as long as its standard deviation is below this, m.
    pub limit_m: f64,
    /// How the bias settles after switching on: the recording's start. Not for [`Method::Slide`].
    pub drift: Option<Drift>,
}

impl Default for Choice {
    fn default() -> Self {
        Self {
            method: Method::Tilt,
            zupt: Zupt::Assumed,
            limit_m: 1.0,
            drift: None,
        }
    }
}

/// Navigates one unit's recording. Samples of which the accelerometer gives no number, or in which it is frozen, are left
/// out.
///
/// # Errors
/// `data_refused`: no angular rate for [`Method::Strapdown`], fewer than two rests for
/// [`Method::Slide`], nothing to align with, accelerations that do not show gravity, or are no numbers or beyond the full
/// scale for the most part, no valid position;
/// `usage` for [`Method::Array`], which needs [`navigate_array`], and for a slide without ZUPT.
pub fn navigate(recording: &MotionRecording, choice: &Choice) -> Result<InertialPath> {
    let mut path = match Holes::of(recording)? {
        None => followed(recording, choice)?,
        Some(holes) => {
            let mut path = followed(&holes.left_out_of(recording), choice)?;
            holes.fill(&mut path, &recording.times_s);
            path.findings.splice(0..0, holes.findings);
            path
        }
    };
    path.findings
        .splice(0..0, recording.findings.iter().cloned());
    let mut path = path.checked(&recording.name)?;
    let column = recording.column("Moving");
    let moving = moving(&recording.times_s, column, &recording.truth, &[]);
    compare(&mut path, &recording.truth, &moving);
    Ok(path)
}

/// The path of a recording of which every sample is a number.
fn followed(recording: &MotionRecording, choice: &Choice) -> Result<InertialPath> {
    let refused = |message: &str, remedy: &str| {
        Err(HostError::new(ErrorCode::DataRefused, message, remedy).at(&recording.name))
    };
    let senses = sense::Senses::of(recording)?;
    let mut sound = recording.clone();
    if let Some(from) = senses.field_ends {
        for sample in &mut sound.samples[from..] {
            sample.field_ut = None;
        }
    }
    if let Some(from) = senses.rate_ends {
        for sample in &mut sound.samples[from..] {
            sample.rate_rad_s = None;
        }
    }
    let mut wrong = None;
    let mut warming = None;
    if matches!(choice.method, Method::Strapdown | Method::Slide) {
        wrong = rates::checked(&sound)?;
        if wrong.as_ref().is_some_and(|wrong| wrong.contradicts) {
            unrated(&mut sound.samples);
        } else if choice.zupt.is_on() {
            warming = warming::taken_off(&sound.times_s, &mut sound.samples);
        }
    }
    let mut path = match choice.method {
        Method::Array => {
            return Err(HostError::new(
                ErrorCode::Usage,
                "the method array needs several accelerometers and their places",
                "give --geometry FILE",
            ));
        }
        Method::Slide => {
            rates::filled(&sound.times_s, &mut sound.samples);
            slide::slide(&sound, choice)?
        }
        Method::Strapdown if recording.samples.iter().all(|s| s.rate_rad_s.is_none()) => {
            return refused(
                "there is no angular rate in it, and strapdown is the method of a gyroscope",
                "use --method tilt, slide or auto; in a CSV file name a gyroscope's columns \
                 `Gyroscope X (rad/s)`, …; wimu's boards have none",
            );
        }
        method => {
            let mut samples = once_each_field(&sound.samples);
            let contradicts = wrong.as_ref().is_some_and(|wrong| wrong.contradicts);
            let method = if contradicts { Method::Tilt } else { method };
            if method != Method::Strapdown {
                unrated(&mut samples);
            }
            let late = arrival::spread(&recording.times_s, &mut samples);
            let config = UnitConfig {
                gravity_mps2: recording.gravity_mps2(),
                bias_mps2: senses.bias_mps2,
                zupt: choice.zupt,
                drift: choice.drift,
                ..UnitConfig::default()
            };
            let mut path = filter(
                &recording.times_s,
                &samples,
                &senses.clipped,
                config,
                choice,
                method,
            );
            if samples.iter().all(|s| s.field_ut.is_none()) {
                let why = recording.without_field();
                let text = format!("{why}: heading is that of the body at the start");
                path.findings.push(FindingCode::Navigation.note(text));
            }
            path.findings
                .extend(late.map(|text| FindingCode::Clock.note(text)));
            path
        }
    };
    let wrong = wrong.map(|wrong| FindingCode::Navigation.warning(wrong.said));
    let warming = warming.map(|text| FindingCode::Navigation.note(text));
    path.findings.extend(wrong.into_iter().chain(warming));
    if let Some(from) = senses.force_ends {
        for point in &mut path.points[from..] {
            point.valid = false;
        }
    }
    path.findings.splice(0..0, senses.findings);
    Ok(path)
}

/// Leaves the angular rate out.
fn unrated(samples: &mut [UnitSample]) {
    for sample in samples {
        sample.rate_rad_s = None;
    }
}

/// How the bias settles, from a recording at rest that begins at the switching on.
///
/// # Errors
/// `data_refused`: it moved, nothing drifts, or it had not settled at the end.
pub fn settling(recording: &MotionRecording) -> Result<DriftFit> {
    let mut estimator = DriftEstimator::new();
    let numbers = |sample: &UnitSample| sample.force_mps2.iter().all(|f| f.is_finite());
    let samples = recording.times_s.iter().zip(&recording.samples);
    for (time_s, sample) in samples.filter(|(_, sample)| numbers(sample)) {
        estimator.push(*time_s, sample.force_mps2);
    }
    estimator.fit().map_err(|error| {
        HostError::new(
            ErrorCode::DataRefused,
            error.to_string(),
            "record the unit at rest from the moment it is switched on, or leave --drift out",
        )
        .at(&recording.name)
    })
}
