//! `wimu.navigate`.

use std::path::PathBuf;

use pyo3::prelude::*;
use wimu_host::imu::{Imu, ImuOptions};
use wimu_host::inertial::{
    self, Choice, InertialPath, Method, PathPoint, Profile, StartPose, Zupt,
};
use wimu_host::{Code, Input, capture, navigation};

use crate::arrays::{Array1, Array2, Array3, column, matrices, plain, table};
use crate::calibration::Correction;
use crate::failure::{Result, usage};
use crate::recording::Source;

/// A path with its uncertainty: one row a sample, east-north-up axes.
#[pyclass(frozen, module = "wimu")]
pub struct Path(InertialPath);

impl Path {
    fn vectors(&self, py: Python<'_>, of: impl Fn(&PathPoint) -> [f64; 3]) -> Result<Array2> {
        table(py, self.0.points.iter().map(of))
    }
}

/// A move between two rests.
#[pyclass(frozen, get_all, module = "wimu")]
pub struct Move {
    start: f64,
    end: f64,
    length: f64,
    length_sd: f64,
    tilted: f64,
    valid: bool,
}

impl From<&inertial::Move> for Move {
    fn from(one: &inertial::Move) -> Self {
        Self {
            start: one.from_s,
            end: one.to_s,
            length: one.length_m,
            length_sd: one.length_sd_m,
            tilted: one.tilted_rad,
            valid: one.valid,
        }
    }
}

#[pymethods]
impl Path {
    /// s on the clock of the recording, shape (n,).
    #[getter]
    fn times(&self, py: Python<'_>) -> Array1 {
        column(py, self.0.points.iter().map(|point| point.time_s))
    }

    /// m, shape (n, 3).
    #[getter]
    fn position(&self, py: Python<'_>) -> Result<Array2> {
        self.vectors(py, |point| point.position_m)
    }

    /// m/s, shape (n, 3).
    #[getter]
    fn velocity(&self, py: Python<'_>) -> Result<Array2> {
        self.vectors(py, |point| point.velocity_mps)
    }

    /// Quaternion W, X, Y, Z from body to navigation axes, shape (n, 4).
    #[getter]
    fn attitude(&self, py: Python<'_>) -> Result<Array2> {
        table(py, self.0.points.iter().map(|point| point.quaternion))
    }

    /// rad/s, body axes, shape (n, 3).
    #[getter]
    fn angular_rate(&self, py: Python<'_>) -> Result<Array2> {
        self.vectors(py, |point| point.rate_rad_s)
    }

    /// Covariance of the position, m², shape (n, 3, 3).
    #[getter]
    fn position_covariance(&self, py: Python<'_>) -> Result<Array3> {
        matrices(py, self.0.points.iter().map(|point| point.covariance_m2))
    }

    /// Standard deviation of the position, m, shape (n, 3).
    #[getter]
    fn position_sd(&self, py: Python<'_>) -> Result<Array2> {
        self.vectors(py, PathPoint::sigma_m)
    }

    /// Standard deviation of the velocity, m/s, shape (n, 3); 0 where it is not estimated.
    #[getter]
    fn velocity_sd(&self, py: Python<'_>) -> Result<Array2> {
        self.vectors(py, |point| point.velocity_sd_mps)
    }

    /// Standard deviation of the attitude about east, north and up, rad, shape (n, 3); 0 where it is not estimated.
    #[getter]
    fn attitude_sd(&self, py: Python<'_>) -> Result<Array2> {
        self.vectors(py, |point| point.attitude_sd_rad)
    }

    /// Whether the position can be used, shape (n,).
    #[getter]
    fn valid(&self, py: Python<'_>) -> Array1<bool> {
        column(py, self.0.points.iter().map(|point| point.valid))
    }

    /// Whether the unit is taken to be at rest, shape (n,).
    #[getter]
    fn resting(&self, py: Python<'_>) -> Array1<bool> {
        column(py, self.0.points.iter().map(|point| point.resting))
    }

    /// Row at which position and velocity are zero by definition.
    #[getter]
    fn origin(&self) -> usize {
        self.0.origin
    }

    /// Length of the path over the valid rows, m.
    #[getter]
    fn distance(&self) -> f64 {
        self.0.distance_m()
    }

    /// Moves between rests.
    #[getter]
    fn moves(&self) -> Vec<Move> {
        self.0.moves.iter().map(Move::from).collect()
    }

    /// The method.
    #[getter]
    fn method(&self) -> &'static str {
        name(self.0.method)
    }

    /// What was noticed.
    #[getter]
    fn findings(&self, py: Python<'_>) -> Result<Py<PyAny>> {
        plain(py, &self.0.findings)
    }

    /// Writes CSV, or ROS 2 messages where the name ends in `.mcap`.
    fn save(&self, path: PathBuf) -> Result<()> {
        Ok(self.0.write(&path)?)
    }

    fn __len__(&self) -> usize {
        self.0.points.len()
    }

    fn __repr__(&self) -> String {
        let (method, rows) = (name(self.0.method), self.0.points.len());
        format!("<wimu.Path by {method}: {rows} rows>")
    }
}

fn name(method: Method) -> &'static str {
    match method {
        Method::Strapdown => "strapdown",
        Method::Tilt => "tilt",
        Method::Array => "array",
        Method::Ranges => "ranges",
        Method::Odometry => "odometry",
        Method::RangesInertial => "ranges_inertial",
    }
}

/// Computes position, velocity and attitude of one unit.
#[pyfunction]
#[pyo3(signature = (source, *, calibration=None, profile="hand", zupt="on", within=None, rests=None, start=None,
                    smooth=true, limit=1.0, sensitivity=None))]
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn navigate(
    py: Python<'_>,
    source: Source,
    calibration: Option<Correction>,
    profile: &str,
    zupt: &str,
    within: Option<f64>,
    rests: Option<Vec<(f64, f64)>>,
    start: Option<(f64, f64, f64, Option<f64>)>,
    smooth: bool,
    limit: f64,
    sensitivity: Option<f64>,
) -> Result<Path> {
    let profile = match profile {
        "hand" => Profile::Hand,
        "foot" => Profile::Foot,
        "vehicle" => Profile::Vehicle,
        "free" => Profile::Free,
        _ => {
            return Err(usage(
                format!("profile={profile:?} is not known"),
                "give hand, foot, vehicle or free",
            ));
        }
    };
    let zupt = match zupt {
        "on" => Zupt::Stated,
        "cautious" => Zupt::Assumed,
        "off" => Zupt::Off,
        _ => {
            return Err(usage(format!("zupt={zupt:?} is not known"), "give on, cautious or off"));
        }
    };
    let positive = [("limit", Some(limit)), ("within", within), ("sensitivity", sensitivity)];
    for (name, value) in positive {
        if value.is_some_and(|value| !value.is_finite() || value <= 0.0) {
            return Err(usage(format!("{name} is not above 0"), "give a number above 0"));
        }
    }
    let path = py.detach(|| {
        let motion = motion(&source, calibration.as_ref(), sensitivity)?;
        let choice = Choice {
            zupt,
            profile,
            smooth,
            limit_m: limit,
            within_m: within,
            rests_s: rests.map(|rests| rests.into_iter().map(|(from, to)| from..=to).collect()),
            start: start
                .map(|(e, n, u, heading_rad)| StartPose { position_m: [e, n, u], heading_rad }),
            ..Choice::default()
        };
        inertial::navigate(&motion, &choice)
    })?;
    Ok(Path(path))
}

/// The corrected samples of a source: of a recording of wimu, those of the longest start of the device.
fn motion(
    source: &Source,
    calibration: Option<&Correction>,
    sensitivity_lsb_per_g: Option<f64>,
) -> wimu_host::Result<Imu> {
    let calibration = calibration.map(Correction::sensor).transpose()?;
    if let Some(path) = source.path()
        && let Input::Recording(path) = Input::parse(&path.to_string_lossy())?
    {
        let recording = capture::Capture::load(&path)?;
        let longest = recording.link(source.options().role)?.longest();
        let boot = longest.ok_or_else(|| {
            let error = Code::NoRows.error("the recording has no samples", "record again");
            error.at(&recording.name)
        })?;
        return navigation::motion(&recording.name, boot, calibration.as_ref());
    }
    let options = ImuOptions { calibration, sensitivity_lsb_per_g };
    let data = source.data()?;
    Imu::of(&data, &options)
}
