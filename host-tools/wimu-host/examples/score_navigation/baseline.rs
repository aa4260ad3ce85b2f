//! Plain baseline: strapdown integration with a 15-state error-state Kalman filter and zero-velocity updates.
//!
//! Formulas: J. Solà, "Quaternion kinematics for the error-state Kalman filter" (2017), chapter 7 (error of the
//! attitude in the navigation frame); the same in P. Groves, "Principles of GNSS, inertial, and multisensor integrated
//! navigation systems" (2nd ed., 2013), sections 5.5, 14.2.4 and 15.3. Navigation frame: z up, heading arbitrary.
//!
//! Error state: position, velocity, attitude θ with R_true = exp([θ]×) R, gyroscope bias, accelerometer bias.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};
use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::settings::Settings;

pub const STATES: usize = 15;
pub type Covariance = SMatrix<f64, STATES, STATES>;

/// First state of each block of three.
pub const POSITION: usize = 0;
pub const VELOCITY: usize = 3;
pub const ATTITUDE: usize = 6;
pub const GYROSCOPE_BIAS: usize = 9;
pub const ACCELEROMETER_BIAS: usize = 12;

/// The unit starts in motion if the specific force or the angular rate of the alignment exceed this, m/s² (standard
/// deviation of a component) and rad/s. Then velocity, m/s, and tilt, rad, start with these standard deviations.
const MOTION_FORCE: f64 = 0.3;
const MOTION_RATE: f64 = 0.4;
const MOTION_VELOCITY: f64 = 1.0;
const MOTION_TILT: f64 = 15.0 * std::f64::consts::PI / 180.0;
/// Position, m, and heading, rad, at the start: both define the frame.
const START_POSITION: f64 = 1e-4;
const START_HEADING: f64 = 1e-5;
/// Uncertainty of a start that is given: velocity, m/s; position, m; heading, rad (reference/estimator).
const GIVEN_VELOCITY: f64 = 0.02;
const GIVEN_POSITION: f64 = 0.002;
const GIVEN_HEADING: f64 = 0.005;

/// Nominal state and covariance of its error.
#[derive(Clone, Debug)]
pub struct Filter {
    settings: Settings,
    /// m, m/s, navigation frame.
    pub position: Vector3<f64>,
    pub velocity: Vector3<f64>,
    /// Body to navigation frame.
    pub attitude: Rotation3<f64>,
    /// rad/s, m/s², body frame.
    pub gyroscope_bias: Vector3<f64>,
    pub accelerometer_bias: Vector3<f64>,
    pub covariance: Covariance,
}

impl Filter {
    /// Alignment with the mean specific force of the first samples. The heading is arbitrary.
    pub fn align(force: &[Vector3<f64>], rate: &[Vector3<f64>], settings: Settings) -> Self {
        let count = settings.start_samples.min(force.len());
        let mean = force[..count].iter().sum::<Vector3<f64>>() / count as f64;
        let squares = force[..count].iter().map(|f| (f - mean).map(|d| d * d));
        let variance = squares.sum::<Vector3<f64>>() / count as f64;
        let in_motion = variance.max().sqrt() > MOTION_FORCE
            || rate[..count].iter().any(|w| w.amax() > MOTION_RATE);
        let up = mean.normalize();
        let level = if up.y.abs() < 0.9 { Vector3::y() } else { Vector3::z() };
        let forward = level.cross(&up).normalize();
        let left = up.cross(&forward);
        let rows = [forward, left, up].map(|row| row.transpose());

        let tilt = if in_motion { MOTION_TILT } else { settings.tilt };
        let velocity = if in_motion { MOTION_VELOCITY } else { settings.velocity };
        let mut deviation = SVector::<f64, STATES>::zeros();
        let mut set = |block, values| deviation.fixed_rows_mut::<3>(block).copy_from(&values);
        set(POSITION, Vector3::repeat(START_POSITION));
        set(VELOCITY, Vector3::repeat(velocity));
        set(ATTITUDE, Vector3::new(tilt, tilt, START_HEADING));
        set(GYROSCOPE_BIAS, Vector3::repeat(settings.gyroscope_bias));
        set(ACCELEROMETER_BIAS, Vector3::repeat(settings.accelerometer_bias));
        Self {
            settings,
            position: Vector3::zeros(),
            velocity: Vector3::zeros(),
            attitude: Rotation3::from_matrix_unchecked(Matrix3::from_rows(&rows)),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
            covariance: Covariance::from_diagonal(&deviation.map(|d| d * d)),
        }
    }

    /// Strapdown step over `step_s` and covariance P ← F P Fᵀ + Q.
    pub fn predict(&mut self, force: Vector3<f64>, rate: Vector3<f64>, step_s: f64) {
        let rate = rate - self.gyroscope_bias;
        let middle = self.attitude * Rotation3::new(0.5 * step_s * rate);
        let force = middle * (force - self.accelerometer_bias);
        let acceleration = force - Vector3::z() * STANDARD_GRAVITY_MPS2;
        self.position += step_s * self.velocity + 0.5 * step_s * step_s * acceleration;
        self.velocity += step_s * acceleration;
        self.attitude *= Rotation3::new(step_s * rate);

        let f = transition(middle.matrix(), &force, step_s);
        self.covariance = f * self.covariance * f.transpose();
        for (block, density) in [
            (VELOCITY, self.settings.accelerometer_noise),
            (ATTITUDE, self.settings.gyroscope_noise),
            (GYROSCOPE_BIAS, self.settings.gyroscope_bias_walk),
            (ACCELEROMETER_BIAS, self.settings.accelerometer_bias_walk),
        ] {
            for i in block..block + 3 {
                self.covariance[(i, i)] += density * density * step_s;
            }
        }
    }

    /// Zero-velocity update, 0 = v + noise, in Joseph's form. Returns its normalised innovation squared, 3 degrees of
    /// freedom, or NaN where the covariance is not positive any more; then nothing is updated.
    pub fn update_zero_velocity(&mut self) -> f64 {
        let variance = self.settings.zero_velocity.powi(2);
        let cross = self.covariance.fixed_columns::<3>(VELOCITY).into_owned();
        let s = cross.fixed_rows::<3>(VELOCITY) + Matrix3::identity() * variance;
        let Some(inverse) = s.cholesky().map(|c| c.inverse()) else {
            return f64::NAN;
        };
        let gain = cross * inverse;
        let innovation = -self.velocity;
        let mut residual = Covariance::identity();
        let mut columns = residual.fixed_columns_mut::<3>(VELOCITY);
        columns -= gain;
        let p =
            residual * self.covariance * residual.transpose() + variance * gain * gain.transpose();
        self.covariance = 0.5 * (p + p.transpose());
        let error = gain * innovation;
        let part = |block| -> Vector3<f64> { error.fixed_rows::<3>(block).into_owned() };
        self.position += part(POSITION);
        self.velocity += part(VELOCITY);
        self.attitude = Rotation3::new(part(ATTITUDE)) * self.attitude;
        self.gyroscope_bias += part(GYROSCOPE_BIAS);
        self.accelerometer_bias += part(ACCELEROMETER_BIAS);
        innovation.dot(&(inverse * innovation))
    }

    /// Direction of body x, from the first axis of the navigation frame towards the second, rad.
    pub fn heading(&self) -> f64 {
        self.attitude[(1, 0)].atan2(self.attitude[(0, 0)])
    }

    /// Position, velocity and heading from outside. Roll, pitch and biases stay, with their covariance.
    pub fn set_start(&mut self, position: Vector3<f64>, velocity: Vector3<f64>, heading: f64) {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), heading - self.heading());
        self.attitude = turn * self.attitude;
        let mut change = Covariance::identity();
        for block in [POSITION, VELOCITY, ATTITUDE] {
            change.fixed_view_mut::<3, 3>(block, block).copy_from(turn.matrix());
        }
        self.covariance = change * self.covariance * change.transpose();
        self.position = position;
        self.velocity = velocity;
        let known = (0..3)
            .flat_map(|i| [(POSITION + i, GIVEN_POSITION), (VELOCITY + i, GIVEN_VELOCITY)])
            .chain([(ATTITUDE + 2, GIVEN_HEADING)]);
        for (state, deviation) in known {
            self.covariance.row_mut(state).fill(0.0);
            self.covariance.column_mut(state).fill(0.0);
            self.covariance[(state, state)] = deviation * deviation;
        }
    }
}

/// F: derivative of the error after a step by that before it. `middle` is the attitude in the middle of the step,
/// `force` the specific force in the navigation frame, m/s². The effect of the gyroscope bias on velocity and position
/// within the step, of second and third order in `step_s`, is neglected.
pub fn transition(middle: &Matrix3<f64>, force: &Vector3<f64>, step_s: f64) -> Covariance {
    let half = 0.5 * step_s * step_s;
    let cross = force.cross_matrix();
    let mut f = Covariance::identity();
    for (row, column, block) in [
        (POSITION, VELOCITY, Matrix3::identity() * step_s),
        (POSITION, ATTITUDE, -half * cross),
        (POSITION, ACCELEROMETER_BIAS, -half * middle),
        (VELOCITY, ATTITUDE, -step_s * cross),
        (VELOCITY, ACCELEROMETER_BIAS, -step_s * middle),
        (ATTITUDE, GYROSCOPE_BIAS, -step_s * middle),
    ] {
        f.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
    }
    f
}
