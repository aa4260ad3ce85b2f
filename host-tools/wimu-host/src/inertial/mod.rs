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

mod arrival;
mod rates;
mod report;
mod sense;
mod slide;

pub use slide::{Leg, legs};

use std::io::Write as _;
use std::ops::Range;
use std::path::Path as FilePath;

pub use wimu_nav::Zupt;
use wimu_nav::array::ArrayState;
use wimu_nav::drift::{Drift, DriftEstimator, DriftFit};
use wimu_nav::slide::Move;
use wimu_nav::unit::{UnitConfig, UnitFault, UnitFilter, UnitSample};

use crate::array::{
    Agreement, ArrayCalibration, ArrayGeometry, ArrayRecording, RefineOptions, mended, navigated,
    navigated_axes,
};
use crate::motion::{MotionRecording, Truth, gap_s, nees};
use crate::{ErrorCode, HostError, Result};

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

/// Deviations up to which something is likely.
const LIKELY: f64 = 3.0;

/// How to navigate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// The method.
    pub method: Method,
    /// Whether stillnesses are taken for zero velocity, and whether they are known to be rests.
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

/// Where the unit was at a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// Time, s, as in the file.
    pub time_s: f64,
    /// Position, m, east-north-up.
    pub position_m: [f64; 3],
    /// Velocity, m/s.
    pub velocity_mps: [f64; 3],
    /// Body to navigation axes, W X Y Z.
    pub quaternion: [f64; 4],
    /// Angular rate, rad/s, body axes.
    pub rate_rad_s: [f64; 3],
    /// Covariance of the position, m²: with [`Zupt::Assumed`] that of `unseen_m` in it.
    pub covariance_m2: [[f64; 3]; 3],
    /// Whether it is taken to rest: never with ZUPT off.
    pub resting: bool,
    /// The speed at which it might be moved evenly there and that would not show, m/s; `None` where that is not
    /// known, and elsewhere.
    pub unseen_mps: Option<f64>,
    /// How far even motion that no rest so far would have shown may have taken it, one standard deviation in space, m;
    /// 0 with ZUPT off.
    pub unseen_m: f64,
    /// Whether the position is of use: known to the limit, no gap since the last rest.
    pub valid: bool,
}

impl PathPoint {
    /// Standard deviation of each component, m.
    pub fn sigma_m(&self) -> [f64; 3] {
        std::array::from_fn(|i| self.covariance_m2[i][i].max(0.0).sqrt())
    }

    /// That of the position in space, m.
    pub fn sd_m(&self) -> f64 {
        self.sigma_m().iter().map(|s| s * s).sum::<f64>().sqrt()
    }
}

/// How long a position can be used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Horizon {
    /// Seconds that the unit moved from the origin on: rests do not count, as far as they are
    /// taken for zero velocity, nor do gaps and jumps of time.
    pub moving_s: f64,
    /// When it ends, s, as in the file.
    pub at_s: f64,
    /// Seconds since the end of the last rest before, where there is one.
    pub since_rest_s: Option<f64>,
    /// Whether it ends for another reason than the limit: after a gap, or a move that is none.
    pub lost: bool,
}

/// What is taken for rests in a path, and what that assumes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stillness {
    /// How many there are, and for how long, s.
    pub rests: usize,
    /// For how long in all, s.
    pub lasted_s: f64,
    /// The largest speed at which the unit might have been moved evenly there and that would not show, m/s.
    pub unseen_mps: f64,
    /// How far even motion may have taken it by the end, one standard deviation in space, m: with [`Zupt::Assumed`] it
    /// is in the covariance.
    pub unseen_m: f64,
}

/// A move between two rests of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlideMove {
    /// What was found.
    pub done: Move,
    /// From when to when, s, as in the file.
    pub from_s: f64,
    /// Its end.
    pub to_s: f64,
    /// How far even motion that neither rest would have shown would lengthen it, one standard deviation, m.
    pub unseen_m: f64,
    /// Whether it is one: not after a gap, a turn or a field that leave the way open.
    pub valid: bool,
}

/// A path.
#[derive(Clone, Debug)]
pub struct InertialPath {
    /// How it was found.
    pub method: Method,
    /// One point a sample.
    pub points: Vec<PathPoint>,
    /// The point from which position is measured: the last of the first rest at which it is sure to have lain still, which
    /// is 0.6 s before that shows to end. Even motion there is none, by definition;
    /// what the points before are off by is how far it may have come on the way there.
    pub origin: usize,
    /// The moves, with [`Method::Slide`].
    pub moves: Vec<SlideMove>,
    /// What was noticed on the way.
    pub remarks: Vec<String>,
    /// Points known no better than this, m, are not valid.
    pub limit_m: f64,
    /// NEES of the position at each valid sample that has truth, which is taken to be right to 1 mm; both
    /// begin at the same place and heading.
    pub nees: Vec<f64>,
    /// NEES of an array's angular rate at each valid sample, where the truth tells it.
    pub rate_nees: Vec<f64>,
    /// That of its velocity.
    pub velocity_nees: Vec<f64>,
    /// Where the unit truly was, m, in the path's axes, at each sample that has truth; empty without.
    pub truth_m: Vec<Option<[f64; 3]>>,
    /// Whether the truth has no heading, and the one was taken that fits the path best: NEES then says
    /// nothing of the heading.
    pub heading_fitted: bool,
}

/// Median NEES of three components and the share below 7.81 (95 % of a right covariance); `None` of none.
pub fn consistency(nees: &[f64]) -> Option<(f64, f64)> {
    let mut all = nees.to_vec();
    all.sort_by(f64::total_cmp);
    let below = all.iter().filter(|n| **n < 7.81).count();
    Some((*all.get(all.len() / 2)?, below as f64 / all.len() as f64))
}

impl InertialPath {
    /// Length of the path over its valid points, m.
    pub fn distance_m(&self) -> f64 {
        self.points
            .windows(2)
            .filter(|w| w[0].valid && w[1].valid)
            .map(|w| {
                (0..3)
                    .map(|i| (w[1].position_m[i] - w[0].position_m[i]).powi(2))
                    .sum::<f64>()
                    .sqrt()
            })
            .sum()
    }

    /// When the standard deviation of the position first passes `limit_m`, or the position is lost by a
    /// gap or a move that is none; `None` when it never does.
    pub fn horizon(&self, limit_m: f64) -> Option<Horizon> {
        let known = self.points.get(self.origin..)?;
        let start = known.iter().position(|p| p.valid).unwrap_or(0);
        let known = &known[start..];
        // Not valid below the limit that is set for the path: lost.
        let lost = |p: &PathPoint| !p.valid && p.sd_m() <= self.limit_m;
        // Not a number counts as passed.
        let end = known
            .iter()
            .position(|p| p.sd_m().is_nan() || p.sd_m() > limit_m || lost(p))?;
        let at_s = known[end].time_s;
        // Nobody knows whether it moved in a gap, or time jumped.
        let times_s: Vec<f64> = self.points.iter().map(|p| p.time_s).collect();
        let gap_s = gap_s(&times_s);
        let goes_on = |w: &&[PathPoint]| w[1].time_s - w[0].time_s <= gap_s;
        let moving = known[..=end].windows(2).filter(goes_on);
        let moving = moving.filter(|w| !w[1].resting);
        let rest = known[..end].iter().rfind(|p| p.resting);
        Some(Horizon {
            // The sum of none is −0.
            moving_s: moving.map(|w| w[1].time_s - w[0].time_s).sum::<f64>() + 0.0,
            at_s,
            since_rest_s: rest.map(|p| at_s - p.time_s),
            lost: lost(&known[end]),
        })
    }

    /// After how many seconds of motion that is: [`Horizon::moving_s`].
    pub fn horizon_s(&self, limit_m: f64) -> Option<f64> {
        Some(self.horizon(limit_m)?.moving_s)
    }

    /// What is taken for rests: `None` with ZUPT off, or where the method does not tell.
    pub fn stillness(&self) -> Option<Stillness> {
        let mut found = Stillness::default();
        for pair in self.points.windows(2) {
            let (before, now) = (&pair[0], &pair[1]);
            let Some(speed) = now.unseen_mps else {
                continue;
            };
            let step = now.time_s - before.time_s;
            if !before.resting || found.rests == 0 {
                found.rests += 1;
            }
            found.lasted_s += step;
            found.unseen_mps = found.unseen_mps.max(speed);
            found.unseen_m = self.points.last().map_or(0.0, |p| p.unseen_m);
        }
        (found.rests > 0).then_some(found)
    }

    /// Share of the points that are valid.
    pub fn valid_share(&self) -> f64 {
        self.points.iter().filter(|p| p.valid).count() as f64 / self.points.len().max(1) as f64
    }

    /// Median NEES and the share below 7.81 (95 % of a right covariance), where there is truth.
    pub fn consistency(&self) -> Option<(f64, f64)> {
        consistency(&self.nees)
    }

    /// Writes the points as CSV.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`.
    pub fn write_csv(&self, file: &FilePath) -> Result<()> {
        let name = file.display().to_string();
        let failed = |error: std::io::Error| HostError::file(&name, "write", &error);
        let sink = std::fs::File::create(file).map_err(failed)?;
        let mut sink = std::io::BufWriter::new(sink);
        let mut header = vec!["Time (s)".to_owned()];
        header.extend(["E", "N", "U"].map(|a| format!("Position {a} (m)")));
        header.extend(["E", "N", "U"].map(|a| format!("Velocity {a} (m/s)")));
        header.extend(["W", "X", "Y", "Z"].map(|a| format!("Quaternion {a}")));
        header.extend(["X", "Y", "Z"].map(|a| format!("Angular Rate {a} (rad/s)")));
        header.extend(["E", "N", "U"].map(|a| format!("Sigma {a} (m)")));
        header.push("Valid".to_owned());
        writeln!(sink, "{}", header.join(",")).map_err(failed)?;
        for point in &self.points {
            write!(sink, "{}", point.time_s).map_err(failed)?;
            let sigma = point.sigma_m();
            let values = point
                .position_m
                .iter()
                .chain(&point.velocity_mps)
                .chain(&point.quaternion)
                .chain(&point.rate_rad_s)
                .chain(&sigma);
            for value in values {
                write!(sink, ",{value:.6}").map_err(failed)?;
            }
            writeln!(sink, ",{}", u8::from(point.valid)).map_err(failed)?;
        }
        sink.flush().map_err(failed)
    }
}

/// Navigates one unit's recording.
///
/// # Errors
/// `data_refused`: no angular rate for [`Method::Strapdown`], fewer than two rests for
/// [`Method::Slide`], nothing to align with, accelerations that do not show gravity; `usage` for
/// [`Method::Array`], which needs [`navigate_array`], and for a slide without ZUPT.
pub fn navigate(recording: &MotionRecording, choice: &Choice) -> Result<InertialPath> {
    let refused = |message: &str, remedy: &str| {
        Err(HostError::new(ErrorCode::DataRefused, message, remedy).at(&recording.name))
    };
    let senses = sense::Senses::of(recording)?;
    let mut path = match choice.method {
        Method::Array => {
            return Err(HostError::new(
                ErrorCode::Usage,
                "the method array needs several accelerometers and their places",
                "give --geometry FILE",
            ));
        }
        Method::Slide => {
            let wrong = rates::checked(recording)?;
            let mut whole = recording.clone();
            if wrong.as_ref().is_some_and(|wrong| wrong.contradicts) {
                unrated(&mut whole.samples);
            }
            rates::filled(&whole.times_s, &mut whole.samples);
            let mut path = slide::slide(&whole, choice)?;
            path.remarks.extend(wrong.map(|wrong| wrong.said));
            path
        }
        Method::Strapdown if recording.samples.iter().all(|s| s.rate_rad_s.is_none()) => {
            return refused(
                "there is no angular rate in it, and strapdown is the method of a gyroscope",
                "use --method tilt, slide or auto; in a CSV file name a gyroscope's columns \
                 `Gyroscope X (rad/s)`, …; wimu's boards have none",
            );
        }
        method => {
            let mut samples = once_each_field(&recording.samples);
            if let Some(from) = senses.rate_ends {
                for sample in &mut samples[from..] {
                    sample.rate_rad_s = None;
                }
            }
            let mut wrong = None;
            if method == Method::Strapdown {
                wrong = rates::checked(recording)?;
            }
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
            path.remarks.extend(wrong.map(|wrong| wrong.said));
            path.remarks.extend(late);
            path
        }
    };
    if path.points.iter().all(|p| !p.valid) && path.moves.is_empty() {
        return refused(
            "no position could be found to the limit",
            "hold the unit still for a second first, and see that its times go on",
        );
    }
    if let Some(from) = senses.force_ends {
        for point in &mut path.points[from..] {
            point.valid = false;
        }
    }
    path.remarks.splice(0..0, senses.remarks);
    path.remarks.splice(0..0, recording.remarks.iter().cloned());
    compare(&mut path, &recording.truth);
    Ok(path)
}

/// Leaves the angular rate out.
fn unrated(samples: &mut [UnitSample]) {
    for sample in samples {
        sample.rate_rad_s = None;
    }
}

/// A reading of the magnetometer that is repeated within this time is one that is held, s.
const HELD_S: f64 = 0.25;

/// The samples, each reading of a magnetometer that is slower than the accelerometer once.
fn once_each_field(samples: &[UnitSample]) -> Vec<UnitSample> {
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

/// How the bias settles, from a recording at rest that begins at the switching on.
///
/// # Errors
/// `data_refused`: it moved, nothing drifts, or it had not settled at the end.
pub fn settling(recording: &MotionRecording) -> Result<DriftFit> {
    let mut estimator = DriftEstimator::new();
    for (time_s, sample) in recording.times_s.iter().zip(&recording.samples) {
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

/// What the uncalibrated mean of an array's sensors may differ from gravity by, as a part of it.
const GRAVITY_SHARE: f64 = 0.2;

/// Navigates an array; `recording` is in body axes ([`ArrayRecording::arranged`]). A sensor whose times, or places
/// whose size the motion shows to be others than given are taken as it shows them, which the remarks say.
///
/// # Errors
/// Those of [`navigated`]; `data_refused` where the sensors contradict each other, or what
/// they show at rest is not gravity.
pub fn navigate_array(
    recording: &ArrayRecording,
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
    choice: &Choice,
) -> Result<InertialPath> {
    let mended = mended(recording, geometry, calibration)?;
    let (recording, geometry, calibration) = match &mended {
        Some(m) => (&m.recording, &m.geometry, &m.calibration),
        None => (recording, geometry, calibration),
    };
    let standard = wimu_model::STANDARD_GRAVITY_MPS2;
    let gravity = if calibration.uncalibrated.is_some() || calibration.stored {
        // Where biases may explain what it differs by, gravity is what it is.
        let mean = calibration.mean_rest_mps2(recording);
        let by_bias = LIKELY * calibration.bias_mps2 / (recording.sensors() as f64).sqrt();
        if (mean - standard).abs() < by_bias {
            standard
        } else {
            mean
        }
    } else {
        standard
    };
    if (gravity / standard - 1.0).abs() > GRAVITY_SHARE {
        return Err(HostError::new(
            ErrorCode::DataRefused,
            format!("the mean output at the rests is {gravity:.2} m/s², which is not gravity"),
            "check the unit in the columns' names (g, m/s², LSB) and --sensitivity",
        )
        .at(&recording.name));
    }
    let (states, remarks) = navigated(recording, geometry, calibration, gravity, choice.zupt)?;
    let agreement = Agreement::of(recording, geometry, calibration)?;
    if let Some(agreement) = &agreement {
        agreement.check(&recording.name)?;
    }
    let mut said = remarks;
    said.extend(agreement.map(|a| a.remark()));
    said.extend(calibration.remarks());
    if let Some(mended) = &mended {
        said.extend(mended.remarks.iter().cloned());
    }
    let span = geometry.span_m();
    if span > ArrayGeometry::LARGE_M {
        said.push(format!(
            "the array is {span:.1} m wide: are its places in m?"
        ));
    }
    Ok(path_of(recording, &states, choice, said))
}

/// Navigates single axes ([`ArrayRecording::axes_from_csv`]); `known` says how well their places and times are.
///
/// # Errors
/// Those of [`navigated_axes`].
pub fn navigate_axes(
    recording: &ArrayRecording,
    geometry: &ArrayGeometry,
    known: &RefineOptions,
    choice: &Choice,
) -> Result<InertialPath> {
    let (states, remarks) = navigated_axes(recording, geometry, known, choice.zupt)?;
    Ok(path_of(recording, &states, choice, remarks))
}

/// The path of an array whose states are these, against the truth where there is any.
fn path_of(
    recording: &ArrayRecording,
    states: &[ArrayState<f64>],
    choice: &Choice,
    said: Vec<String>,
) -> InertialPath {
    let valid = |k: &usize| states[*k].valid && states[*k].position_sd_m() <= choice.limit_m;
    let mut path = InertialPath {
        method: Method::Array,
        origin: (0..states.len()).find(valid).unwrap_or(0),
        points: states
            .iter()
            .zip(&recording.times_s)
            .map(|(state, time_s)| PathPoint {
                // To the nanosecond, as the file says it.
                time_s: ((recording.start_s + time_s) * 1e9).round() * 1e-9,
                position_m: state.position_m,
                velocity_mps: state.velocity_mps,
                quaternion: state.quaternion,
                rate_rad_s: state.rate_rad_s,
                covariance_m2: state.position_covariance,
                resting: choice.zupt.is_on() && state.resting,
                unseen_mps: (choice.zupt.is_on() && state.resting).then_some(state.unseen_mps),
                unseen_m: state.unseen_m,
                valid: state.valid && state.position_sd_m() <= choice.limit_m,
            })
            .collect(),
        moves: Vec::new(),
        remarks: recording.remarks.clone(),
        limit_m: choice.limit_m,
        nees: Vec::new(),
        rate_nees: Vec::new(),
        velocity_nees: Vec::new(),
        truth_m: Vec::new(),
        heading_fitted: false,
    };
    path.remarks.extend(said);
    let ambiguous = states
        .iter()
        .filter(|s| s.certainty > 0.0 && s.certainty < 0.99)
        .count();
    if ambiguous > 0 {
        path.remarks.push(format!(
            "{ambiguous} samples fit several angular rates; rate and position are the means of all, with \
             their spread"
        ));
    }
    let measured = |(name, _): &(String, Vec<f64>)| name.starts_with("Magnetometer ");
    let field = if recording.other.iter().any(measured) {
        "the array's method does not use the magnetometer"
    } else {
        "no magnetometer"
    };
    path.remarks
        .push(format!("{field}: heading is that of the body at the start"));
    let truth = recording.truth();
    compare(&mut path, &truth);
    let valid = |k: &usize| path.points[*k].valid;
    let vector_nees = |truth: &[Option<[f64; 3]>],
                       of: &dyn Fn(usize) -> ([f64; 3], [[f64; 3]; 3])| {
        let of_sample = |k: usize| {
            let (true_value, (value, covariance)) = (truth[k]?, of(k));
            let error = std::array::from_fn(|i| value[i] - true_value[i]);
            Some(nees(error, covariance)).filter(|v| v.is_finite())
        };
        (0..truth.len())
            .filter(valid)
            .filter_map(of_sample)
            .collect::<Vec<f64>>()
    };
    let rate_nees = vector_nees(&recording.true_rate_rad_s(), &|k| {
        (states[k].rate_rad_s, states[k].rate_covariance)
    });
    // The path's heading begins at its own zero.
    let turn = truth.iter().zip(&path.points).find_map(|(truth, point)| {
        let by = heading_rad(truth.as_ref()?.quaternion) - heading_rad(point.quaternion);
        (point.valid && by.is_finite()).then(|| by.sin_cos())
    });
    let (sin, cos) = turn.unwrap_or((0.0, 1.0));
    let true_velocity: Vec<Option<[f64; 3]>> = recording
        .vectors(["E", "N", "U"].map(|a| format!("Truth Velocity {a} (m/s)")))
        .into_iter()
        .map(|v| v.map(|[e, n, u]| [cos * e + sin * n, cos * n - sin * e, u]))
        .collect();
    let velocity_nees = vector_nees(&true_velocity, &|k| {
        (states[k].velocity_mps, states[k].velocity_covariance)
    });
    path.rate_nees = rate_nees;
    path.velocity_nees = velocity_nees;
    path
}

/// Direction of body x from east to north, rad.
fn heading_rad([w, x, y, z]: [f64; 4]) -> f64 {
    (2.0 * (x * y + w * z)).atan2(1.0 - 2.0 * (y * y + z * z))
}

fn filter(
    times_s: &[f64],
    samples: &[UnitSample],
    clipped: &[usize],
    config: UnitConfig,
    choice: &Choice,
    method: Method,
) -> InertialPath {
    let mut filter = UnitFilter::new(config);
    let (mut gaps, mut bad, mut backwards) = (0, 0, 0);
    let (mut begun, mut moved) = (false, false);
    // The last rest from whose end position is measured, and the velocity's deviation there.
    let (mut origin, mut speed_mps) = (0..0, [0.0; 3]);
    let mut points = Vec::with_capacity(samples.len());
    for (k, (sample, time_s)) in samples.iter().zip(times_s).enumerate() {
        if clipped.binary_search(&k).is_ok() {
            filter.interrupt(sample.step_s);
        } else {
            match filter.push(sample) {
                Ok(()) => {}
                Err(UnitFault::Gap) => gaps += 1,
                Err(UnitFault::NoTime) => backwards += 1,
                Err(_) => bad += 1,
            }
        }
        let state = filter.state();
        // Aligned, and no rest yet.
        moved |= !begun && !state.valid && state.attitude_sd_rad[0] > 0.0;
        begun |= state.valid;
        if state.at_origin {
            let goes_on = origin.end == k && k > 0;
            origin = if goes_on { origin.start } else { k }..k + 1;
            speed_mps = state.velocity_sd_mps;
        }
        let known = state.position_sd_m() <= choice.limit_m;
        points.push(PathPoint {
            time_s: *time_s,
            position_m: state.position_m,
            velocity_mps: state.velocity_mps,
            quaternion: state.quaternion,
            rate_rad_s: state.rate_rad_s,
            covariance_m2: state.position_covariance,
            resting: choice.zupt.is_on() && state.resting,
            unseen_mps: (choice.zupt.is_on() && state.resting).then_some(state.unseen_mps),
            unseen_m: state.unseen_m,
            valid: state.valid && known,
        });
    }
    if origin.is_empty() {
        let first = points.iter().position(|p| p.valid).unwrap_or(0);
        origin = first..first + 1;
    }
    let origin = measured_from(&mut points, &origin, speed_mps, choice.limit_m);
    let mut remarks = Vec::new();
    if let (true, Some(first)) = (moved, points.iter().find(|p| p.valid)) {
        remarks.push(format!(
            "no rest at the start: position is measured from the first rest, at {:.2} s",
            first.time_s
        ));
    }
    remarks.extend(rates::remark(&rates::holes(samples), times_s));
    let mut remark = |count: u32, what: &str| {
        if count > 0 {
            remarks.push(format!("{count} {what}"));
        }
    };
    remark(
        gaps,
        "gaps longer than 0.25 s: how far it went in one is not known: position is uncertain from there on, and not valid before the next rest",
    );
    remark(
        clipped.len() as u32,
        "clipped samples left out: position is the less certain after them",
    );
    remark(backwards, "samples whose time stood still: left out");
    remark(bad, "samples that were no numbers: left out");
    remark(
        filter.state().even,
        "updates at what looked like a rest while the velocity was not zero: even motion, or a wrong velocity",
    );
    remark(
        filter.state().pushed,
        "tenths of a second it seemed to rest and was pushed evenly: no rest",
    );
    remark(
        filter.state().holes,
        "times samples were missing, or time jumped, for less than 0.25 s: doubted as the motion there is strong",
    );
    remark(
        filter.state().disturbed,
        "times the magnetic field was disturbed: left out",
    );
    if samples.iter().all(|s| s.field_ut.is_none()) {
        remarks.push("no magnetometer: heading is that of the body at the start".to_owned());
    }
    InertialPath {
        method,
        points,
        origin,
        moves: Vec::new(),
        remarks,
        limit_m: choice.limit_m,
        nees: Vec::new(),
        rate_nees: Vec::new(),
        velocity_nees: Vec::new(),
        truth_m: Vec::new(),
        heading_fitted: false,
    }
}

/// The end of a rest shows so much later, s.
const LATE_S: f64 = 0.6;

/// Measures position from where the rest ends, which shows later, and returns that point. How far even motion with these
/// deviations, m/s, may have taken it from there or brought it there is what the points of the rest are off by, those after
/// it also by what it had gained when its end showed. Where it was before the rest is not known.
fn measured_from(
    points: &mut [PathPoint],
    rest: &Range<usize>,
    speed_mps: [f64; 3],
    limit_m: f64,
) -> usize {
    let Some(last_s) = rest.clone().next_back().map(|k| points[k].time_s) else {
        return rest.start;
    };
    let ends = rest.end < points.len();
    let late_s = if ends { LATE_S } else { 0.0 };
    let before = points[rest.clone()].partition_point(|p| p.time_s <= last_s - late_s);
    let origin = rest.start + before.max(1) - 1;
    let end_s = points[origin].time_s;
    let gained_m = points.get(rest.end).map_or([0.0; 3], |p| p.position_m);
    for point in &mut points[..rest.start] {
        point.valid = false;
    }
    for (k, point) in points[rest.clone()].iter_mut().enumerate() {
        point.covariance_m2 = [[0.0; 3]; 3];
        for (i, row) in point.covariance_m2.iter_mut().enumerate() {
            let way_m = speed_mps[i] * (end_s - point.time_s);
            let late_m = if rest.start + k > origin {
                gained_m[i]
            } else {
                0.0
            };
            row[i] = way_m * way_m + late_m * late_m;
        }
        point.valid &= point.sd_m() <= limit_m;
    }
    origin
}

/// Of the rotation whose rows are given, W X Y Z.
fn quaternion([[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]]: [[f64; 3]; 3]) -> [f64; 4] {
    let size = |v: f64| (v.max(0.0)).sqrt() / 2.0;
    let w = size(1.0 + xx + yy + zz);
    [
        w,
        size(1.0 + xx - yy - zz).copysign(zy - yz),
        size(1.0 - xx + yy - zz).copysign(xz - zx),
        size(1.0 - xx - yy + zz).copysign(yx - xy),
    ]
}

/// The truth is right to this, m.
const TRUTH_M: f64 = 0.001;

/// NEES where there is truth: both paths begin at the origin, at the same heading, or at that
/// which fits best where the truth has none.
fn compare(path: &mut InertialPath, truth: &[Option<Truth>]) {
    let usable = |k: &usize| path.points[*k].valid && truth.get(*k).is_some_and(Option::is_some);
    let usable: Vec<usize> = (0..path.points.len()).filter(usable).collect();
    let of_sample = |k: &usize| Some((&path.points[*k], truth[*k]?));
    let both: Vec<(&PathPoint, Truth)> = usable.iter().filter_map(of_sample).collect();
    let begins = usable.partition_point(|k| *k < path.origin);
    let Some((first, start)) = both.get(begins).or(both.first()) else {
        return;
    };
    let ways = |(point, truth): &(&PathPoint, Truth)| {
        let found: [f64; 3] = std::array::from_fn(|i| point.position_m[i] - first.position_m[i]);
        let real: [f64; 3] = std::array::from_fn(|i| truth.position_m[i] - start.position_m[i]);
        (found, real)
    };
    let by = start.heading_rad() - heading_rad(first.quaternion);
    let fitted = !by.is_finite();
    let (sin, cos) = if fitted {
        let (mut sine, mut cosine) = (0.0, 0.0);
        for (found, real) in both.iter().map(ways) {
            sine += real[1] * found[0] - real[0] * found[1];
            cosine += real[0] * found[0] + real[1] * found[1];
        }
        f64::atan2(sine, cosine).sin_cos()
    } else {
        by.sin_cos()
    };
    let in_path = |truth: &Truth| -> [f64; 3] {
        let way: [f64; 3] = std::array::from_fn(|i| truth.position_m[i] - start.position_m[i]);
        let turned = [
            cos * way[0] + sin * way[1],
            cos * way[1] - sin * way[0],
            way[2],
        ];
        std::array::from_fn(|i| first.position_m[i] + turned[i])
    };
    let of = |(point, truth): &(&PathPoint, Truth)| {
        let expected = in_path(truth);
        let mut p = point.covariance_m2;
        for (i, row) in p.iter_mut().enumerate() {
            row[i] += TRUTH_M * TRUTH_M;
        }
        nees(
            std::array::from_fn(|i| point.position_m[i] - expected[i]),
            p,
        )
    };
    let all = both.iter().map(of).collect();
    let truth_m = truth.iter().map(|t| Some(in_path(t.as_ref()?))).collect();
    path.heading_fitted = fitted;
    path.truth_m = truth_m;
    path.nees = all;
}
