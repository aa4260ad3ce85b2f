//! The path of a recorded unit or array, sample by sample, with its covariance.
//!
//! ```
//! use wimu_host::inertial::{Choice, navigate};
//! use wimu_host::imu::{Imu, Sample};
//! use wimu_host::series::Ns;
//!
//! // Two seconds at rest.
//! let mut recording = Imu::default();
//! for k in 0..200 {
//!     let force_mps2 = [0.0, 0.0, if k % 2 == 0 { 9.80 } else { 9.81 }].into();
//!     recording.push(Ns(k * 10_000_000), Sample { force_mps2, ..Sample::default() });
//! }
//! let path = navigate(&recording, &Choice::default())?;
//! assert!(path.distance_m() < 0.01 && path.points[199].valid);
//! assert!(path.horizon_s(1.0).is_none(), "σ stays below 1 m");
//! # Ok::<(), wimu_host::Problem>(())
//! ```

mod aid_link;
pub mod aids;
mod array;
mod arrival;
mod clocks;
mod frozen;
mod holes;
mod horizon;
mod lag;
mod live;
mod moves;
mod navigator;
mod path;
mod rates;
mod report;
mod rests;
mod segments;
mod sense;
mod smooth;
mod steps;
mod summary;
mod truth;
mod unit;
mod uses;
mod vehicle;

use std::ops::RangeInclusive;

pub use aid_link::{AidLink, LeastDelay};
pub use aids::{Aid, Aids};
pub use array::navigate_array;
pub use arrival::sampled_times;
pub(crate) use clocks::{one_clock, other_clock};
pub(crate) use frozen::Frozen;
pub(crate) use holes::{FULL_SCALE_MPS2, Holes};
pub(crate) use horizon::gaps;
pub use horizon::{Horizon, RestTimes};
pub use live::Live;
pub use moves::Move;
pub(crate) use navigator::{Carrier, Navigator, Step};
pub use path::{InertialPath, PathPoint, Residual, StateFound};
pub(crate) use sense::clipped;
pub use summary::{AngularRate, Figures, Horizons};
pub use truth::{Nees, consistency, nees};
pub(crate) use unit::{median_step_s, run};
pub use uses::AidUse;
pub use wimu_nav::navigator::Profile;

use wimu_nav::navigator::Rests;

use crate::imu::{Imu, Sample};
use crate::{Code, Result};
use arrival::TIME_SD_S;
use truth::{compare, moving};
use unit::{OnceEachField, Unit, noise_mps2};

/// How a path was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// With the angular rate of a gyroscope.
    Strapdown,
    /// From accelerometer and magnetometer.
    Tilt,
    /// With the angular rate of an array of accelerometers.
    Array,
    /// From ranges to anchors.
    Ranges,
    /// From ranges and wheel odometry.
    Odometry,
    /// From ranges, with the angular rate of a gyroscope.
    RangesInertial,
}

impl Method {
    /// Method for the samples of one unit.
    fn of(samples: &[Sample]) -> Self {
        if samples.iter().any(|sample| sample.rate_rad_s.is_some()) {
            Self::Strapdown
        } else {
            Self::Tilt
        }
    }
}

/// What a detected rest means. An accelerometer does not distinguish a rest from constant velocity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Zupt {
    /// The velocity is an unknown constant of 0 ± 0.1 m/s.
    #[default]
    Assumed,
    /// The velocity is zero: the caller knows that the unit was at rest.
    Stated,
    /// Nothing.
    Off,
}

impl Zupt {
    /// Whether rests are used.
    pub fn is_on(self) -> bool {
        self != Self::Off
    }

    /// Value of the option `--zupt`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Assumed => "cautious",
            Self::Stated => "on",
            Self::Off => "off",
        }
    }

    /// The same for a navigator.
    pub fn rests(self) -> Rests {
        match self {
            Self::Assumed => Rests::ConstantVelocity,
            Self::Stated => Rests::ZeroVelocity,
            Self::Off => Rests::Ignored,
        }
    }
}

/// Where and how a unit starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartPose {
    /// Position, m, east-north-up.
    pub position_m: [f64; 3],
    /// Angle of the body x axis from east towards north, rad; `None`: as the magnetometer shows, or zero.
    pub heading_rad: Option<f64>,
}

/// How to navigate.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// What rests mean.
    pub zupt: Zupt,
    /// What is assumed of the motion.
    pub profile: Profile,
    /// The position is valid as long as its standard deviation is below this, m.
    pub limit_m: f64,
    /// The unit stays within this distance of its start, m, 1 σ of a component.
    pub within_m: Option<f64>,
    /// The times at which it rested, s, as in the file; `None`: those that the detector finds.
    pub rests_s: Option<Vec<RangeInclusive<f64>>>,
    /// Pose at the start; `None`: the origin, or the first rest of a start in motion.
    pub start: Option<StartPose>,
    /// Whether a point rests on all samples, or on those up to it alone: for one unit.
    pub smooth: bool,
    /// Measurements of other systems, for one unit. The path is in the frame of their positions.
    pub aids: Aids,
    /// The path ends where it began, with this standard deviation, m, a component.
    pub loop_m: Option<f64>,
}

impl Default for Choice {
    fn default() -> Self {
        Self {
            zupt: Zupt::Stated,
            profile: Profile::Hand,
            limit_m: 1.0,
            within_m: None,
            rests_s: None,
            start: None,
            smooth: true,
            aids: Aids::default(),
            loop_m: None,
        }
    }
}

/// Navigates one unit's recording: with its gyroscope if it has one. Samples of which the accelerometer gives no number,
/// or in which it is frozen, are left out.
///
/// # Errors
/// `data_refused`: nothing to align with, accelerations that do not show gravity, or are no numbers or beyond the full
/// scale for the most part, a unit of the angular rate that cannot be, no valid position.
pub fn navigate(recording: &Imu, choice: &Choice) -> Result<InertialPath> {
    choice.rests_within(&recording.times_s()).map_err(|error| error.at(&recording.name))?;
    let mut path = match Holes::of(recording)? {
        None => followed(recording, choice)?,
        Some(holes) => {
            let mut path = followed(&holes.left_out_of(recording), choice)?;
            holes.fill(&mut path, &recording.times_s());
            path.findings.splice(0..0, holes.findings);
            path
        }
    };
    path.findings.splice(0..0, recording.findings.iter().cloned());
    let remedy = choice.aids.remedy(choice.limit_m);
    let remedy = remedy.as_deref().unwrap_or(REMEDY);
    let mut path = path.checked(&recording.name, remedy)?;
    let times = &recording.samples.t;
    let (truth, column) = (recording.reference.on(times), recording.reference.moving_on(times));
    let moving = moving(&recording.times_s(), column.as_deref(), &truth, &[]);
    compare(&mut path, &truth, &moving);
    path.source.clone_from(&recording.name);
    Ok(path.assumed(choice))
}

impl Choice {
    /// Refuses rests that a recording with these times does not have.
    fn rests_within(&self, times_s: &[f64]) -> Result<()> {
        let (Some(rests), [from, .., to]) = (&self.rests_s, times_s) else { return Ok(()) };
        let is_outside = |rest: &&RangeInclusive<f64>| rest.end() < from || rest.start() > to;
        let Some(rest) = rests.iter().find(is_outside) else { return Ok(()) };
        let text = format!("there is no rest from {} to {} s", rest.start(), rest.end());
        let remedy = format!("give times of the recording, {from:.2} to {to:.2} s");
        Err(Code::Usage.error(text, remedy))
    }
}

/// What to do where no position is valid.
const REMEDY: &str = "give a larger `limit_m` (--setup), or hold the unit still for a second first, and see that its times go on";

/// Whether an accelerometer shows gravity, and a gyroscope the rotation of gravity: the units of a recording.
///
/// # Errors
/// `data_refused`: another unit fits.
pub(crate) fn check_units(recording: &Imu) -> Result<()> {
    sense::Senses::of(recording)?;
    rates::checked(recording)?;
    Ok(())
}

/// The path of a recording of which every sample is a number.
fn followed(recording: &Imu, choice: &Choice) -> Result<InertialPath> {
    let senses = sense::Senses::of(recording)?;
    let (recorded_s, mut samples) = (recording.times_s(), recording.samples.v.clone());
    if let Some(from) = senses.field_ends {
        samples[from..].iter_mut().for_each(|s| s.field_ut = None);
    }
    senses.frozen_rates.iter().for_each(|k| samples[*k].rate_rad_s = None);
    senses.without_bias(&mut samples);
    let rates = rates::checked(recording)?;
    let from = if rates.as_ref().is_some_and(|found| found.contradicts) {
        Some(0)
    } else {
        senses.rate_ends
    };
    if let Some(from) = from {
        samples[from..].iter_mut().for_each(|s| s.rate_rad_s = None);
    }
    let mut findings = senses.findings.clone();
    let mut time_sd_s = 0.0;
    if let Some(times_s) = sampled_times(&recorded_s) {
        retime(&mut samples, &times_s);
        time_sd_s = TIME_SD_S;
        findings.push(Code::Clock.note(
            "the times are those of arrival: a constant sample period and the least delay are used",
        ));
    }
    let mut once = OnceEachField::default();
    let samples: Vec<Sample> = samples.iter().map(|sample| once.of(sample)).collect();
    let noise_mps2 = noise_mps2(&recorded_s, &samples);
    let unit = Unit::of(recording, &recorded_s, &samples, &senses, &senses.clipped, noise_mps2);
    let unit = Unit { time_sd_s, ..unit };
    let method = Method::of(&samples);
    let delay_s = (method == Method::Strapdown).then(|| unit.rate_delay_s(choice)).flatten();
    let moved = delay_s.map(|delay_s| unit.advanced(delay_s, samples.len()));
    let unit = Unit { samples: moved.as_deref().unwrap_or(&samples), ..unit };
    let mut path = unit.path(choice, method)?;
    if let Some(delay_s) = delay_s {
        let text = format!(
            "the angular rate is {:.0} ms {} against the specific force: corrected",
            1e3 * delay_s.abs(),
            if delay_s < 0.0 { "early" } else { "late" }
        );
        path.findings.push(Code::Clock.warning(text));
    }
    let placed = choice.start.is_some() || choice.aids.show_heading();
    if samples.iter().all(|s| s.field_ut.is_none()) && !placed {
        let why = recording.without_field();
        let text = format!("{why}: heading is that of the body at the start");
        path.findings.push(Code::Navigation.note(text));
    }
    path.findings.extend(rates.map(|found| found.finding));
    path.findings.splice(0..0, findings);
    Ok(path)
}

/// Gives the samples the steps between other times.
fn retime(samples: &mut [Sample], times_s: &[f64]) {
    for (sample, pair) in samples.iter_mut().skip(1).zip(times_s.windows(2)) {
        sample.step_s = pair[1] - pair[0];
    }
}
