//! Streams of poses: read from tables, interpolated, and the clock offset of two of them.

use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::formats::table::{LENGTH, Measurements, NUMBER, TIME};
use crate::imu::Imu;
use crate::lag::{Lag, Search, lag};
use crate::plural::counted;
use crate::series::{Interp, Ns, Series, Value};
use crate::{Code, Problem, Result};

/// Interval over which the angular rate of a stream is taken, s: longer than the period of a camera, shorter than a motion
/// of a hand.
const RATE_OVER_S: f64 = 0.1;
/// Step of the search for the clock offset, s.
const OFFSET_STEP_S: f64 = 0.02;
/// Shortest overlap in which two streams can be compared, s.
const OVERLAP_S: f64 = 5.0;

/// Longest median step of a stream, s: a slower one does not show the motion of a hand.
const MOST_STEP_S: f64 = 1.0;

/// A pose: position and rotation of a body in its tracker's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamPose {
    /// Time, s, of the stream's own clock.
    pub time_s: f64,
    /// Position of the body in the tracker's frame, m.
    pub position_m: Vector3<f64>,
    /// Rotation from body axes to the tracker's.
    pub rotation: UnitQuaternion<f64>,
}

/// Poses in the order of time.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseStream {
    /// What findings call it.
    pub name: String,
    /// Whether it has rotations of a gyroscope only, which drift.
    pub inertial: bool,
    /// What was noticed at reading.
    pub findings: Vec<Problem>,
    poses: Series<Pose>,
}

/// Position, m, and rotation of a body in its tracker's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pose {
    position_m: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
}

impl Value for Pose {
    /// Of two poses: constant velocity and angular rate.
    fn combined(mut terms: impl Iterator<Item = (f64, Self)>) -> Self {
        let (mut position_m, mut turned) = (Vector3::zeros(), Vector3::zeros());
        let (weight, first) = terms.next().unwrap_or((1.0, Self::default()));
        position_m += first.position_m * weight;
        for (weight, pose) in terms {
            position_m += pose.position_m * weight;
            turned += (first.rotation.inverse() * pose.rotation).scaled_axis() * weight;
        }
        let rotation = first.rotation * UnitQuaternion::from_scaled_axis(turned);
        Self { position_m, rotation }
    }

    fn distance(&self, other: &Self) -> f64 {
        let apart = self.position_m.distance(&other.position_m);
        apart.max(self.rotation.angle_to(&other.rotation))
    }

    fn is_finite(&self) -> bool {
        Value::is_finite(&self.position_m) && Value::is_finite(&self.rotation.coords)
    }
}

impl Default for Pose {
    fn default() -> Self {
        Self { position_m: Vector3::zeros(), rotation: UnitQuaternion::identity() }
    }
}

/// Pose and velocity between two poses.
#[derive(Clone, Copy, Debug)]
pub(super) struct Interpolated {
    pub position_m: Vector3<f64>,
    pub rotation: UnitQuaternion<f64>,
    /// m/s, the tracker's axes.
    pub velocity_mps: Vector3<f64>,
    /// rad/s, body axes.
    pub rate_rad_s: Vector3<f64>,
}

impl PoseStream {
    /// Poses in any order; times that repeat are left out with a finding.
    ///
    /// # Errors
    /// `no_rows` for fewer than two poses; `data_refused` where they are seconds apart, as with times in ms.
    pub fn new(name: impl Into<String>, mut poses: Vec<StreamPose>) -> Result<Self> {
        let name = name.into();
        let given = poses.len();
        poses.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        let rows = poses.into_iter().map(|StreamPose { time_s, position_m, rotation }| {
            (Ns::from_s(time_s), Pose { position_m, rotation })
        });
        let poses = Series::of(rows);
        if poses.len() < 2 {
            let message = format!("{name} has fewer than two poses");
            return Err(Code::NoRows.error(message, "record the motion for a minute"));
        }
        let mut findings = Vec::new();
        if poses.len() < given {
            let lost = counted(given - poses.len(), "pose");
            let text = format!("{name}: {lost} left out: the time repeats");
            findings.push(Code::TimesUnordered.warning(text));
        }
        let step_s = poses.period_s();
        if step_s > MOST_STEP_S {
            let message = format!("{name}: the poses are {step_s:.3} s apart");
            let remedy =
                "check the unit of the times: name the column `Time (ms)` if they are in ms";
            return Err(Code::DataRefused.error(message, remedy));
        }
        let poses = poses.with_gap(f64::max(0.15, 3.0 * step_s));
        Ok(Self { name, inertial: false, findings, poses })
    }

    /// Reads a table with `Time (s)`, `Position X (m)` (or `E`), …, `Quaternion W`, … (body to frame), or a trajectory in the
    /// TUM format: lines of `time x y z qx qy qz qw`.
    ///
    /// # Errors
    /// `file_unreadable`, `csv_missing_column`, `csv_bad_number`, `no_rows`.
    pub fn read(path: &Path) -> Result<Self> {
        let mut table = Measurements::read_or(path, &TUM)?;
        table.name = crate::untrusted::name(path);
        let time = table.needed(&["Time"], TIME)?;
        let mut columns = Vec::new();
        for [first, second] in [["X", "E"], ["Y", "N"], ["Z", "U"]] {
            let names = [format!("Position {first}"), format!("Position {second}")];
            columns.push(table.needed(&[&names[0], &names[1]], LENGTH)?);
        }
        for axis in ["W", "X", "Y", "Z"] {
            columns.push(table.needed(&[&format!("Quaternion {axis}")], NUMBER)?);
        }
        let (mut poses, mut left_out) = (Vec::new(), 0);
        for row in 0..table.len() {
            let values = columns.iter().map(|column| table.value(row, *column));
            let values: Option<Vec<f64>> =
                values.collect::<Result<Vec<_>>>()?.into_iter().collect();
            let (Some(time_s), Some(v)) = (table.value(row, time)?, values) else {
                left_out += 1;
                continue;
            };
            let quaternion = Quaternion::new(v[3], v[4], v[5], v[6]);
            let Some(rotation) = UnitQuaternion::try_new(quaternion, 0.5) else {
                left_out += 1;
                continue;
            };
            poses.push(StreamPose { time_s, position_m: Vector3::new(v[0], v[1], v[2]), rotation });
        }
        let mut stream = Self::new(table.name, poses)?;
        if left_out > 0 {
            let text = format!(
                "{}: {} left out: a field is empty or the quaternion is not one",
                stream.name,
                counted(left_out, "row")
            );
            stream.findings.push(Code::RowsMasked.warning(text));
        }
        Ok(stream)
    }

    /// Rotations of a recording with a gyroscope: equation (201). Positions are zero; they are not used.
    ///
    /// # Errors
    /// `no_rows` without angular rates.
    pub fn of_inertial(recording: &Imu) -> Result<Self> {
        let mut rotation = UnitQuaternion::identity();
        let samples = recording.samples.t.iter().zip(&recording.samples.v);
        let poses = samples.filter_map(|(time, sample)| {
            let angle = sample.rate_rad_s? * sample.step_s;
            rotation *= UnitQuaternion::from_scaled_axis(angle);
            Some(StreamPose { time_s: time.s(), position_m: Vector3::zeros(), rotation })
        });
        let poses: Vec<StreamPose> = poses.collect();
        if poses.is_empty() {
            let message = format!("{} has no angular rates", recording.name);
            let remedy = "the rotation to a camera needs a gyroscope, or poses of the body";
            return Err(Code::NoRows.error(message, remedy));
        }
        let mut stream = Self::new(&*recording.name, poses)?;
        stream.inertial = true;
        stream.findings.extend(recording.findings.iter().cloned());
        Ok(stream)
    }

    /// The poses.
    pub fn poses(&self) -> impl Iterator<Item = StreamPose> {
        let rows = self.poses.t.iter().zip(&self.poses.v);
        rows.map(|(t, pose)| StreamPose {
            time_s: t.s(),
            position_m: pose.position_m,
            rotation: pose.rotation,
        })
    }

    /// First and last time, s.
    pub fn span_s(&self) -> [f64; 2] {
        self.poses.span().unwrap_or_default().map(Ns::s)
    }

    /// The pose at a time; `None` outside the stream and in its gaps.
    pub(super) fn at(&self, time_s: f64) -> Option<Interpolated> {
        let time = Ns::from_s(time_s);
        let before = self.poses.interval(time)?;
        let Pose { position_m, rotation } = self.poses.at(time, Interp::Linear)?.value;
        let [a, b] = [before, before + 1].map(|row| self.poses.v[row]);
        let step_s = self.poses.t[before + 1].since_s(self.poses.t[before]);
        Some(Interpolated {
            position_m,
            rotation,
            velocity_mps: (b.position_m - a.position_m) / step_s,
            rate_rad_s: (a.rotation.inverse() * b.rotation).scaled_axis() / step_s,
        })
    }

    /// Magnitudes of the angular rate at equal steps from the first pose on, rad/s, without gaps.
    fn rates(&self) -> Series<f64> {
        let [from, to] = self.span_s();
        let count = ((to - from - RATE_OVER_S) / OFFSET_STEP_S).max(0.0) as usize;
        let rate = |step: usize| {
            let time_s = from + step as f64 * OFFSET_STEP_S;
            let (a, b) = (self.at(time_s)?, self.at(time_s + RATE_OVER_S)?);
            Some((Ns::from_s(time_s), a.rotation.angle_to(&b.rotation) / RATE_OVER_S))
        };
        Series::of((0..count).filter_map(rate))
    }
}

/// Columns of a trajectory in the TUM format.
const TUM: [&str; 8] = [
    "Time (s)",
    "Position X (m)",
    "Position Y (m)",
    "Position Z (m)",
    "Quaternion X",
    "Quaternion Y",
    "Quaternion Z",
    "Quaternion W",
];

/// Time of the body's clock less that of the camera's, within ± `limit_s` or any without a limit, by the magnitudes of both angular
/// rates; `None` if the streams overlap nowhere for [`OVERLAP_S`].
pub(super) fn clock_offset(
    camera: &PoseStream,
    body: &PoseStream,
    limit_s: Option<f64>,
) -> Option<Lag> {
    let reach_s = limit_s.unwrap_or(f64::INFINITY);
    let search = Search { around_s: 0.0, reach_s, overlap_s: OVERLAP_S };
    lag(&body.rates(), &camera.rates(), &search)
}
