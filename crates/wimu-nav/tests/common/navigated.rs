//! Runs of a navigator over a simulated motion.

use super::Random;
use super::travel::{Errors, Travel};
use nalgebra::{Matrix3, Rotation3, Vector3};
use wimu_nav::navigator::{Motion, Navigator, Profile, Settings, Solution, Start};
use wimu_nav::stationarity::{RestDetector, RestLimits};

/// How a motion is recorded and navigated.
#[derive(Clone)]
pub struct Navigated {
    pub settings: Settings,
    pub rate_hz: f64,
    pub until_s: f64,
    pub gyroscope: bool,
    /// Whether rests are those that the detector finds, or the true ones.
    pub detector: bool,
    /// Whether the start is known to be a rest.
    pub starts_at_rest: bool,
    /// Magnetometer.
    pub field: bool,
    /// A pulse of the angular rate: begin and end, s, and size, rad/s.
    pub kick: (f64, f64, Vector3<f64>),
    /// Samples are missing between these times, s.
    pub gap_s: [f64; 2],
}

impl Default for Navigated {
    fn default() -> Self {
        Self {
            settings: Settings::default(),
            rate_hz: 100.0,
            until_s: 10.0,
            gyroscope: true,
            detector: true,
            starts_at_rest: true,
            field: true,
            kick: (0.0, 0.0, Vector3::zeros()),
            gap_s: [0.0; 2],
        }
    }
}

/// One instant of a run.
#[derive(Clone, Debug)]
pub struct Point {
    pub time_s: f64,
    pub solution: Solution,
    /// Estimated minus true position, m, and velocity, m/s.
    pub position_error: Vector3<f64>,
    pub velocity_error: Vector3<f64>,
    /// Angle between the estimated and the true vertical, rad.
    pub tilt_error: f64,
    pub recoveries: u32,
    pub divergences: u32,
}

impl Point {
    pub fn row(&self) -> String {
        format!(
            "error {:.4} m, σ {:.4} m; {:.4} m/s, σ {:.4} m/s; tilt {:.3} deg",
            self.position_error.norm(),
            self.position_sd(),
            self.velocity_error.norm(),
            deviation(&self.solution.velocity_covariance),
            self.tilt_error.to_degrees()
        )
    }

    /// σ of the position in space, m.
    pub fn position_sd(&self) -> f64 {
        deviation(&self.solution.position_covariance)
    }

    /// Squared error of the position over its covariance.
    pub fn nees(&self) -> f64 {
        let p = matrix(&self.solution.position_covariance);
        let e = self.position_error;
        p.try_inverse().map_or(f64::INFINITY, |inverse| e.dot(&(inverse * e)))
    }
}

pub fn matrix(rows: &[[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|r, c| rows[r][c])
}

/// Root of the trace.
pub fn deviation(rows: &[[f64; 3]; 3]) -> f64 {
    (0..3).map(|i| rows[i][i]).sum::<f64>().sqrt()
}

fn attitude(solution: &Solution) -> Rotation3<f64> {
    let [w, x, y, z] = solution.quaternion;
    nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z))
        .to_rotation_matrix()
}

/// Samples at the start that are averaged for the alignment.
pub const ALIGNMENT: usize = 50;

/// A run with the settings, from the samples of a motion.
pub fn navigate(travel: &Travel, errors: &Errors, how: Navigated, seed: u64) -> Vec<Point> {
    let mut random = Random::new(seed.wrapping_mul(7919) + 31);
    let mut samples = travel.samples(how.rate_hz, how.until_s, errors, &mut random);
    for (k, sample) in samples.iter_mut().enumerate() {
        let t = k as f64 / how.rate_hz;
        let (begin, end, size) = how.kick;
        if let Some(rate) = &mut sample.rate_rad_s
            && t >= begin
            && t < end
        {
            *rate += size;
        }
        if !how.gyroscope {
            sample.rate_rad_s = None;
        }
        // A magnetometer of 50 Hz.
        if !how.field || (k % 2 == 1 && how.rate_hz > 50.0) {
            sample.field_ut = None;
        }
    }
    let start = Start::align(&samples[..ALIGNMENT], how.starts_at_rest).unwrap();
    let mut settings = how.settings;
    settings.motion = if how.gyroscope { Motion::Gyroscope } else { Motion::NoGyroscope };
    let mut navigator = Navigator::new(settings, &start);
    // The frame of the truth.
    let x = travel.attitude(0.0) * Vector3::x();
    navigator.set_heading(x.y.atan2(x.x));
    let origin = travel.position(0.0);
    let detector = if how.gyroscope {
        RestLimits::default()
    } else {
        RestLimits::default().without_gyroscope(errors.force_noise * how.rate_hz.sqrt())
    };
    let mut detector = RestDetector::new(detector);
    let rests: Vec<bool> = samples
        .iter()
        .map(|s| detector.push(&s.force_mps2, s.rate_rad_s.as_ref(), s.step_s))
        .collect();
    let mut points = Vec::new();
    let (mut missing_s, mut walked) = (0.0, false);
    for (k, sample) in samples.iter().enumerate() {
        let t = k as f64 / how.rate_hz;
        if t > how.gap_s[0] && t < how.gap_s[1] {
            missing_s += sample.step_s;
            continue;
        }
        if missing_s > 0.0 {
            navigator.interrupt(std::mem::take(&mut missing_s));
        }
        let rest = if how.detector { rests[k] } else { travel.at_rest(t) };
        let foot = how.gyroscope && how.settings.profile == Profile::Foot;
        // A foot stands before its first step.
        walked |= !rest;
        navigator.push(sample, rest && !(foot && walked)).unwrap();
        if rest && foot {
            navigator.stance(0.01);
        }
        let solution = navigator.solution();
        let up = attitude(&solution) * travel.attitude(t).inverse() * Vector3::z();
        points.push(Point {
            time_s: t,
            position_error: Vector3::from(solution.position_m) - (travel.position(t) - origin),
            velocity_error: Vector3::from(solution.velocity_mps) - travel.velocity(t),
            tilt_error: up.z.clamp(-1.0, 1.0).acos(),
            recoveries: navigator.recoveries(),
            divergences: navigator.divergences(),
            solution,
        });
    }
    points
}

/// Settings of a unit without a gyroscope.
pub fn without_gyroscope() -> Settings {
    let mut settings = Settings::default();
    settings.motion = Motion::NoGyroscope;
    settings
}
