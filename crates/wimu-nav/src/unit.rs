//! One unit: position, velocity and attitude from an accelerometer and a magnetometer, or from an
//! angular rate where there is one. Equations (81) to (85).
//!
//! An accelerometer cannot tell tilt from acceleration. What separates them is that a body that is
//! carried about is not accelerated one way for long, and that the magnetic field turns with the tilt
//! but not with the acceleration. [`UnitFilter`] holds both as states of a Kalman filter, so that its
//! covariance says how well they were told apart. It assumes nothing about position or speed.

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};

/// Attitude, angular rate (or the bias of what measures it), acceleration, its integral, bias,
/// magnetic disturbance, velocity, position.
const STATES: usize = 24;
const PHI: usize = 0;
const OMEGA: usize = 3;
const ACCELERATION: usize = 6;
const SWING: usize = 9;
const BIAS: usize = 12;
const FIELD: usize = 15;
const VELOCITY: usize = 18;
const POSITION: usize = 21;

/// Samples are brought together over so long before the filter looks at them, s: it follows what a
/// hand does, and costs a few operations a sample.
const UPDATE_S: f64 = 0.035;
/// The first attitude is from so much, s.
const ALIGN_S: f64 = 1.0;
/// A pause longer than this is a gap: what happened in it is not known.
const GAP_S: f64 = 0.25;
/// How long |f| − g is remembered as a measure of the motion, s.
const MOTION_S: f64 = 3.0;
/// A body's acceleration along all axes against what |f| − g shows of it.
const MOTION_SHARE: f64 = 1.8;
/// Angular rate of a body that is accelerated, rad/s per m/s².
const TURN_PER_ACCELERATION: f64 = 0.3;
/// A hand's motion comes back at about this frequency, 0.6 Hz, rad/s squared, ...
const SWING_RAD2_S2: f64 = 14.0;
/// ... and is forgotten in this time, s.
const ACCELERATION_TIME_S: f64 = 0.5;
/// As long does an angular rate last, s.
const TURN_TIME_S: f64 = 0.2;
/// Magnetic disturbances indoors, µT, and how long they last for a body carried about, s.
const DISTURBANCE_UT: f64 = 4.0;
const DISTURBANCE_TIME_S: f64 = 30.0;
/// A magnetometer's noise after averaging, µT.
const FIELD_NOISE_UT: f64 = 1.0;
/// An innovation of the field beyond this many variances is a disturbance of another kind.
const FIELD_GATE: f64 = 25.0;
/// Bias of a calibrated accelerometer, m/s², and its random walk, m/s² per √s.
const BIAS_MPS2: f64 = 0.05;
const BIAS_WALK: f64 = 1e-4;
/// Speed that a rest may have, m/s.
const ZUPT_MPS: f64 = 0.005;
/// A rest shows less than this, m/s² rms, for this long, s.
const REST_MPS2: f64 = 0.12;
const REST_S: f64 = 0.5;

/// How a unit is used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitConfig {
    /// Local gravity, m/s².
    pub gravity_mps2: f64,
    /// Whether a rest is taken for zero velocity: an accelerometer cannot tell it from uniform
    /// motion.
    pub zupt: bool,
    /// Error of the accelerometer's samples that its noise does not show (scale, vibration), m/s².
    pub force_noise_mps2: f64,
    /// Random walk of the angle from the angular rate, where there is one, rad/√s.
    pub angle_walk: f64,
    /// How the bias settles after switching on, where that is known.
    pub drift: Option<Drift>,
}

impl Default for UnitConfig {
    fn default() -> Self {
        Self {
            gravity_mps2: 9.80665,
            zupt: true,
            force_noise_mps2: 0.05,
            angle_walk: 0.005,
            drift: None,
        }
    }
}

/// A bias that settles after switching on (Barshan & Durrant-Whyte): ε(t) = C1 (1 − e^(−t/T)) + C2, equation (85).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// C1 of each axis, m/s².
    pub rise_mps2: [f64; 3],
    /// C2 of each axis, m/s².
    pub start_mps2: [f64; 3],
    /// T, s.
    pub time_s: f64,
}

impl Drift {
    /// ε at `time_s` after switching on, m/s².
    pub fn at(&self, time_s: f64) -> [f64; 3] {
        let share = 1.0 - libm::exp(-time_s / self.time_s);
        core::array::from_fn(|i| self.rise_mps2[i] * share + self.start_mps2[i])
    }

    /// Fits T and, for each axis, C1 and C2 to a static recording's output less its mean: least
    /// squares over a grid of T from a hundredth of the recording to its whole length. `None` with
    /// fewer than 10 samples or values that are not finite.
    pub fn fit(samples: impl Iterator<Item = (f64, [f64; 3])> + Clone) -> Option<Self> {
        let last = samples.clone().map(|(t, _)| t).fold(0.0, f64::max);
        let mut best: Option<(f64, Self)> = None;
        for step in 0..=40 {
            let time_s = last * libm::pow(10.0, f64::from(step) / 20.0 - 2.0);
            let (mut n, mut x, mut xx) = (0.0, 0.0, 0.0);
            let (mut y, mut xy, mut yy) = ([0.0; 3], [0.0; 3], 0.0);
            for (t, value) in samples.clone() {
                let share = 1.0 - libm::exp(-t / time_s);
                n += 1.0;
                x += share;
                xx += share * share;
                for i in 0..3 {
                    y[i] += value[i];
                    xy[i] += share * value[i];
                    yy += value[i] * value[i];
                }
            }
            let determinant = n * xx - x * x;
            if n < 10.0 || determinant.is_nan() || determinant <= 1e-9 * n * n {
                continue;
            }
            let rise: [f64; 3] = core::array::from_fn(|i| (n * xy[i] - x * y[i]) / determinant);
            let start: [f64; 3] = core::array::from_fn(|i| (y[i] - rise[i] * x) / n);
            let rest: f64 = yy
                - (0..3)
                    .map(|i| rise[i] * xy[i] + start[i] * y[i])
                    .sum::<f64>();
            if rest.is_finite() && best.as_ref().is_none_or(|(least, _)| rest < *least) {
                let drift = Self {
                    rise_mps2: rise,
                    start_mps2: start,
                    time_s,
                };
                best = Some((rest, drift));
            }
        }
        best.map(|(_, drift)| drift)
    }
}

/// One sample of a unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UnitSample {
    /// Time since the sample before, s.
    pub step_s: f64,
    /// Specific force, m/s², body axes.
    pub force_mps2: [f64; 3],
    /// Magnetic field, µT, body axes.
    pub field_ut: Option<[f64; 3]>,
    /// Angular rate, rad/s, body axes, from a gyroscope or an array.
    pub rate_rad_s: Option<[f64; 3]>,
}

/// What was wrong with a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum UnitFault {
    /// A value is not finite: the sample was left out.
    NotFinite,
    /// Time went back or stood still: the sample was left out.
    NoTime,
    /// Longer than 0.25 s since the sample before: position is not valid from here on.
    Gap,
}

/// Where the unit is, and how well that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitState {
    /// Position, m, east-north-up (east is that of the magnetic field, or body x at the start).
    pub position_m: [f64; 3],
    /// Velocity, m/s, east-north-up.
    pub velocity_mps: [f64; 3],
    /// Body to navigation axes, W X Y Z.
    pub quaternion: [f64; 4],
    /// Angular rate, rad/s, body axes: measured, or estimated.
    pub rate_rad_s: [f64; 3],
    /// Covariance of the position, m².
    pub position_covariance: [[f64; 3]; 3],
    /// Standard deviation of the velocity, m/s.
    pub velocity_sd_mps: [f64; 3],
    /// Standard deviation of the attitude about east, north and up, rad.
    pub attitude_sd_rad: [f64; 3],
    /// Seconds since velocity was last known to be zero (or given).
    pub since_rest_s: f64,
    /// Whether it is at rest now.
    pub resting: bool,
    /// False before the first alignment, and after a gap until the next rest.
    pub valid: bool,
    /// Updates of the magnetic field that were left out as disturbed.
    pub disturbed: u32,
}

impl UnitState {
    /// Standard deviation of the position, m, the largest over all directions at most.
    pub fn position_sd_m(&self) -> f64 {
        let p = &self.position_covariance;
        libm::sqrt((p[0][0] + p[1][1] + p[2][2]).max(0.0))
    }
}

type Cov = SMatrix<f64, STATES, STATES>;

/// The filter of one unit.
#[derive(Clone, Debug)]
pub struct UnitFilter {
    config: UnitConfig,
    attitude: Matrix3<f64>,
    mean: SVector<f64, STATES>,
    cov: Cov,
    field: Option<Vector3<f64>>,
    /// Mean square of |f| − g.
    motion: f64,
    rate: Vector3<f64>,
    last_force: Vector3<f64>,
    group: Group,
    quiet_s: f64,
    age_s: f64,
    since_rest_s: f64,
    aligned: bool,
    valid: bool,
    disturbed: u32,
    quiet: Quiet,
}

/// What is brought together before an update.
#[derive(Clone, Copy, Debug, Default)]
struct Group {
    time_s: f64,
    count: f64,
    force: Vector3<f64>,
    square: f64,
    field: Vector3<f64>,
    fields: f64,
    rated: f64,
}

/// Slow mean and variance of the force, to see rests.
#[derive(Clone, Copy, Debug, Default)]
struct Quiet {
    mean: Vector3<f64>,
    variance: f64,
}

fn cross_matrix(v: Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

impl UnitFilter {
    /// A filter that has seen nothing.
    pub fn new(config: UnitConfig) -> Self {
        Self {
            config,
            attitude: Matrix3::identity(),
            mean: SVector::zeros(),
            cov: Cov::zeros(),
            field: None,
            motion: 0.0,
            rate: Vector3::zeros(),
            last_force: Vector3::zeros(),
            group: Group::default(),
            quiet_s: 0.0,
            age_s: 0.0,
            since_rest_s: 0.0,
            aligned: false,
            valid: false,
            disturbed: 0,
            quiet: Quiet::default(),
        }
    }

    /// Takes one sample. A fault is reported, and the filter goes on.
    ///
    /// # Errors
    /// [`UnitFault`].
    pub fn push(&mut self, sample: &UnitSample) -> Result<(), UnitFault> {
        let values = sample
            .force_mps2
            .iter()
            .chain(sample.rate_rad_s.iter().flatten())
            .chain(sample.field_ut.iter().flatten());
        // Beyond 10⁶ of any unit nothing is a measurement, and squares would overflow.
        if !values.clone().all(|v| v.abs() < 1e6) || !sample.step_s.is_finite() {
            return Err(UnitFault::NotFinite);
        }
        if sample.step_s < 0.0 || (sample.step_s == 0.0 && self.age_s > 0.0) {
            return Err(UnitFault::NoTime);
        }
        let gap = sample.step_s > GAP_S;
        let step = if gap { GAP_S } else { sample.step_s };
        self.age_s += sample.step_s;
        self.since_rest_s += sample.step_s;
        if gap {
            self.valid = false;
            self.group = Group::default();
            for i in 0..3 {
                self.cov[(PHI + i, PHI + i)] += 0.25 * sample.step_s.min(10.0);
                self.cov[(VELOCITY + i, VELOCITY + i)] += 4.0 * sample.step_s.min(1e3);
                self.cov[(POSITION + i, POSITION + i)] += 4.0 * sample.step_s.min(1e3);
            }
        }
        let drift = self.config.drift.map_or([0.0; 3], |d| d.at(self.age_s));
        let force = Vector3::from(sample.force_mps2) - Vector3::from(drift);
        self.judge_rest(force, step);
        if self.aligned {
            self.strapdown(force, sample, step);
        } else {
            self.group.force += force;
            self.group.square += force.norm_squared();
            self.group.count += 1.0;
            self.group.time_s += step;
            if let Some(field) = sample.field_ut {
                self.group.field += Vector3::from(field);
                self.group.fields += 1.0;
            }
            if self.group.time_s >= ALIGN_S {
                self.align();
            }
        }
        if self.aligned && self.group.time_s >= UPDATE_S {
            self.update();
        }
        if gap { Err(UnitFault::Gap) } else { Ok(()) }
    }

    fn judge_rest(&mut self, force: Vector3<f64>, step: f64) {
        if self.age_s <= step {
            self.quiet.mean = force;
        }
        let share = (step / 0.2).min(1.0);
        let away = force - self.quiet.mean;
        self.quiet.mean += away * share;
        self.quiet.variance += (away.norm_squared() / 3.0 - self.quiet.variance) * share;
        let departure = force.norm() - self.config.gravity_mps2;
        self.motion += (departure * departure - self.motion) * (step / MOTION_S).min(1.0);
        let slow = (self.quiet.mean.norm() - self.config.gravity_mps2).abs() < 0.3;
        if slow && self.quiet.variance < REST_MPS2 * REST_MPS2 {
            self.quiet_s += step;
        } else {
            self.quiet_s = 0.0;
        }
    }

    /// Static alignment from the mean force and field: equation (81). Where it was not at rest, the
    /// covariance says so.
    fn align(&mut self) {
        let n = self.group.count.max(1.0);
        let mean = self.group.force / n;
        let norm = mean.norm();
        if norm < 1.0 {
            self.group = Group::default();
            return;
        }
        let spread = (self.group.square / n - norm * norm).max(0.0);
        let g = self.config.gravity_mps2;
        let up = mean / norm;
        let mut east = Vector3::x();
        let mut yaw_sd = 1e-3;
        if self.group.fields > 0.0 {
            let field = self.group.field / self.group.fields;
            if field.cross(&up).norm() > 0.1 * field.norm() {
                east = field.cross(&up);
                yaw_sd = DISTURBANCE_UT / field.cross(&up).norm().max(1.0);
            }
        }
        let mut level = east - up * east.dot(&up);
        if level.norm() < 0.1 {
            level = Vector3::y() - up * up.y;
        }
        let east = level.normalize();
        let north = up.cross(&east);
        self.attitude = Matrix3::from_rows(&[east.transpose(), north.transpose(), up.transpose()]);
        if self.group.fields > 0.0 {
            self.field = Some(self.attitude * (self.group.field / self.group.fields));
        }
        let tilt = (spread + (norm - g) * (norm - g)) / (g * g) * 0.25
            + (BIAS_MPS2 / g) * (BIAS_MPS2 / g)
            + 1e-6;
        self.cov = Cov::zeros();
        for i in 0..3 {
            self.cov[(PHI + i, PHI + i)] = if i == 2 { yaw_sd * yaw_sd } else { tilt };
            self.cov[(OMEGA + i, OMEGA + i)] = 1e-4;
            self.cov[(ACCELERATION + i, ACCELERATION + i)] = spread + 1e-4;
            self.cov[(BIAS + i, BIAS + i)] = BIAS_MPS2 * BIAS_MPS2;
            self.cov[(FIELD + i, FIELD + i)] = DISTURBANCE_UT * DISTURBANCE_UT;
        }
        self.mean = SVector::zeros();
        self.motion = spread / 3.0 + (norm - g) * (norm - g);
        self.last_force = self.attitude * mean - Vector3::z() * g;
        self.group = Group::default();
        self.since_rest_s = 0.0;
        self.aligned = true;
        self.valid = true;
    }

    fn part(&self, at: usize) -> Vector3<f64> {
        self.mean.fixed_rows::<3>(at).into_owned()
    }

    /// Attitude, velocity and position over one sample: equation (82).
    fn strapdown(&mut self, force: Vector3<f64>, sample: &UnitSample, step: f64) {
        let state = self.part(OMEGA);
        self.rate = match sample.rate_rad_s {
            Some(rate) => Vector3::from(rate) - state,
            None => state,
        };
        if sample.rate_rad_s.is_some() {
            self.group.rated += step;
        }
        self.attitude *= turn(self.rate * step);
        let corrected = force - self.part(BIAS);
        let turned = self.attitude * corrected;
        let acceleration = turned - Vector3::z() * self.config.gravity_mps2;
        let mid = (acceleration + self.last_force) * 0.5;
        for i in 0..3 {
            let v = self.mean[VELOCITY + i];
            self.mean[POSITION + i] += v * step + 0.5 * mid[i] * step * step;
            self.mean[VELOCITY + i] = v + mid[i] * step;
        }
        self.last_force = acceleration;
        self.group.force += turned;
        self.group.count += 1.0;
        self.group.time_s += step;
        if let Some(field) = sample.field_ut {
            self.group.field += self.attitude * Vector3::from(field);
            self.group.fields += 1.0;
        }
    }

    /// P ← F P Fᵀ for F that adds `m` times block `from` to block `to`.
    fn couple(&mut self, to: usize, from: usize, m: &Matrix3<f64>) {
        let rows = m * self.cov.fixed_view::<3, STATES>(from, 0);
        let mut target = self.cov.fixed_view_mut::<3, STATES>(to, 0);
        target += rows;
        let columns = self.cov.fixed_view::<STATES, 3>(0, from) * m.transpose();
        let mut target = self.cov.fixed_view_mut::<STATES, 3>(0, to);
        target += columns;
    }

    fn shrink(&mut self, block: usize, factor: f64, noise: f64) {
        let mut rows = self.cov.fixed_view_mut::<3, STATES>(block, 0);
        rows *= factor;
        let mut columns = self.cov.fixed_view_mut::<STATES, 3>(0, block);
        columns *= factor;
        for i in 0..3 {
            self.cov[(block + i, block + i)] += noise;
            self.mean[block + i] *= factor;
        }
    }

    /// Equations (83) and (84).
    fn update(&mut self) {
        let group = core::mem::take(&mut self.group);
        let dt = group.time_s;
        let mean_force = group.force / group.count.max(1.0);
        let g = Vector3::z() * self.config.gravity_mps2;
        let rated = group.rated > 0.5 * dt;
        let resting = self.quiet_s >= REST_S;
        let motion = if resting {
            0.02
        } else {
            MOTION_SHARE * libm::sqrt(self.motion) + 0.02
        };

        let identity = Matrix3::identity();
        self.couple(POSITION, VELOCITY, &(identity * dt));
        self.couple(VELOCITY, PHI, &(cross_matrix(mean_force) * -dt));
        self.couple(VELOCITY, BIAS, &(self.attitude * -dt));
        let turned = self.attitude * if rated { -dt } else { dt };
        for block in [ACCELERATION, SWING, FIELD] {
            let m = cross_matrix(self.part(block)) * turned;
            self.couple(block, OMEGA, &m);
        }
        self.couple(PHI, OMEGA, &turned);
        // The acceleration swings: a half step, a whole one, in this order.
        self.couple(ACCELERATION, SWING, &(identity * (-SWING_RAD2_S2 * dt)));
        self.couple(SWING, ACCELERATION, &(identity * dt));
        for i in 0..3 {
            let swing = self.mean[SWING + i];
            self.mean[ACCELERATION + i] -= SWING_RAD2_S2 * dt * swing;
            let acceleration = self.mean[ACCELERATION + i];
            self.mean[SWING + i] += dt * acceleration;
        }
        let kept = libm::exp(-dt / ACCELERATION_TIME_S);
        self.shrink(ACCELERATION, kept, motion * motion * (1.0 - kept * kept));
        if rated {
            for i in 0..3 {
                self.cov[(OMEGA + i, OMEGA + i)] += 1e-10 * dt;
                self.cov[(PHI + i, PHI + i)] +=
                    self.config.angle_walk * self.config.angle_walk * dt;
            }
        } else {
            let turning = if resting {
                1e-3
            } else {
                TURN_PER_ACCELERATION * motion
            };
            let kept = libm::exp(-dt / TURN_TIME_S);
            self.shrink(OMEGA, kept, turning * turning * (1.0 - kept * kept));
        }
        let kept = libm::exp(-dt / DISTURBANCE_TIME_S);
        let disturbance = if resting { 0.1 } else { 1.0 } * DISTURBANCE_UT;
        self.shrink(FIELD, kept, disturbance * disturbance * (1.0 - kept * kept));
        let noise = self.config.force_noise_mps2;
        for i in 0..3 {
            self.cov[(BIAS + i, BIAS + i)] += BIAS_WALK * BIAS_WALK * dt;
            self.cov[(VELOCITY + i, VELOCITY + i)] += noise * noise * dt * dt;
        }

        // Gravity: in navigation axes its derivatives do not depend on the state.
        let innovation = mean_force - g - self.part(ACCELERATION);
        let lever = cross_matrix(g);
        let attitude = self.attitude;
        let blocks = [(PHI, lever), (ACCELERATION, identity), (BIAS, attitude)];
        self.measure(&blocks, innovation, noise * noise, f64::INFINITY);
        if let (Some(field), true) = (self.field, group.fields > 0.0) {
            let seen = group.field / group.fields;
            let innovation = seen - field - self.part(FIELD);
            let blocks = [
                (PHI, cross_matrix(field)),
                (FIELD, identity),
                (FIELD, Matrix3::zeros()),
            ];
            let variance = FIELD_NOISE_UT * FIELD_NOISE_UT;
            if !self.measure(&blocks, innovation, variance, FIELD_GATE) {
                self.disturbed = self.disturbed.saturating_add(1);
            }
        }
        if resting && self.config.zupt {
            let nothing = Matrix3::zeros();
            let blocks = [
                (VELOCITY, identity),
                (VELOCITY, nothing),
                (VELOCITY, nothing),
            ];
            let innovation = -self.part(VELOCITY);
            self.measure(&blocks, innovation, ZUPT_MPS * ZUPT_MPS, f64::INFINITY);
            self.since_rest_s = 0.0;
            self.valid = true;
        }
        self.fold();
    }

    /// One three-component measurement with H made of blocks, component by component. False where its
    /// innovation is beyond `gate` variances, and nothing is done.
    fn measure(
        &mut self,
        blocks: &[(usize, Matrix3<f64>); 3],
        innovation: Vector3<f64>,
        variance: f64,
        gate: f64,
    ) -> bool {
        let mut correction = SVector::<f64, STATES>::zeros();
        let before = if gate.is_finite() {
            Some(self.cov)
        } else {
            None
        };
        for row in 0..3 {
            let mut ph = SVector::<f64, STATES>::zeros();
            for (at, block) in blocks {
                for i in 0..3 {
                    let h = block[(row, i)];
                    if h != 0.0 {
                        ph.axpy(h, &self.cov.column(at + i), 1.0);
                    }
                }
            }
            let project = |v: &SVector<f64, STATES>| -> f64 {
                blocks
                    .iter()
                    .map(|(at, block)| (0..3).map(|i| block[(row, i)] * v[at + i]).sum::<f64>())
                    .sum()
            };
            let s = project(&ph) + variance;
            let rest = innovation[row] - project(&correction);
            if rest * rest > gate * s {
                if let Some(before) = before {
                    self.cov = before;
                }
                return false;
            }
            correction.axpy(rest / s, &ph, 1.0);
            self.cov.ger(-1.0 / s, &ph, &ph, 1.0);
        }
        self.mean += correction;
        true
    }

    /// Moves the attitude's error into the attitude; what is held in navigation axes turns with it.
    fn fold(&mut self) {
        let phi = self.part(PHI);
        let by = turn(phi);
        self.attitude = by * self.attitude;
        for block in [ACCELERATION, SWING, FIELD] {
            let turned = by * self.part(block);
            self.mean.fixed_rows_mut::<3>(block).copy_from(&turned);
        }
        self.mean.fixed_rows_mut::<3>(PHI).fill(0.0);
        // Rounding: rows at right angles and of length 1 again, by one step of Newton's.
        let rest = self.attitude * self.attitude.transpose();
        self.attitude = (Matrix3::identity() * 1.5 - rest * 0.5) * self.attitude;
    }

    /// Sets position (m), velocity (m/s) and heading to what is known exactly, from outside: the
    /// attitude is turned about the vertical so that body x points `heading_rad` from east to north.
    pub fn set_start(&mut self, position_m: [f64; 3], velocity_mps: [f64; 3], heading_rad: f64) {
        let now = libm::atan2(self.attitude[(1, 0)], self.attitude[(0, 0)]);
        let by = turn(Vector3::z() * (heading_rad - now));
        self.attitude = by * self.attitude;
        self.field = self.field.map(|field| by * field);
        self.last_force = by * self.last_force;
        self.group.force = by * self.group.force;
        self.group.field = by * self.group.field;
        for block in [ACCELERATION, SWING, FIELD] {
            let turned = by * self.part(block);
            self.mean.fixed_rows_mut::<3>(block).copy_from(&turned);
        }
        let mut rotation = Cov::identity();
        for block in [PHI, ACCELERATION, SWING, FIELD] {
            rotation.fixed_view_mut::<3, 3>(block, block).copy_from(&by);
        }
        self.cov = rotation * self.cov * rotation.transpose();
        self.mean
            .fixed_rows_mut::<3>(POSITION)
            .copy_from(&Vector3::from(position_m));
        self.mean
            .fixed_rows_mut::<3>(VELOCITY)
            .copy_from(&Vector3::from(velocity_mps));
        let known = [
            PHI + 2,
            VELOCITY,
            VELOCITY + 1,
            VELOCITY + 2,
            POSITION,
            POSITION + 1,
            POSITION + 2,
        ];
        for index in known {
            self.cov.row_mut(index).fill(0.0);
            self.cov.column_mut(index).fill(0.0);
        }
        self.since_rest_s = 0.0;
        self.valid = self.aligned;
    }

    /// Where the unit is now.
    pub fn state(&self) -> UnitState {
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(self.attitude);
        let q = UnitQuaternion::from_rotation_matrix(&rotation);
        // Position moves on every sample, its covariance with the group that is under way.
        let ahead = self.group.time_s;
        let sd = |at: usize| -> [f64; 3] {
            core::array::from_fn(|i| libm::sqrt(self.cov[(at + i, at + i)].max(0.0)))
        };
        let position_covariance = core::array::from_fn(|i| {
            core::array::from_fn(|j| {
                self.cov[(POSITION + i, POSITION + j)]
                    + ahead
                        * (self.cov[(POSITION + i, VELOCITY + j)]
                            + self.cov[(VELOCITY + i, POSITION + j)])
                    + ahead * ahead * self.cov[(VELOCITY + i, VELOCITY + j)]
            })
        });
        UnitState {
            position_m: self.part(POSITION).into(),
            velocity_mps: self.part(VELOCITY).into(),
            quaternion: [q.w, q.i, q.j, q.k],
            rate_rad_s: self.rate.into(),
            position_covariance,
            velocity_sd_mps: sd(VELOCITY),
            attitude_sd_rad: sd(PHI),
            since_rest_s: self.since_rest_s,
            resting: self.quiet_s >= REST_S,
            valid: self.valid,
            disturbed: self.disturbed,
        }
    }
}

/// The rotation by a rotation vector, rad.
fn turn(by: Vector3<f64>) -> Matrix3<f64> {
    let square = by.norm_squared();
    let k = cross_matrix(by);
    if square < 1e-4 {
        // To the fourth order: 10⁻¹⁰ at 0.01 rad.
        let sine = 1.0 - square / 6.0;
        let cosine = 0.5 - square / 24.0;
        return Matrix3::identity() + k * sine + k * k * cosine;
    }
    let angle = libm::sqrt(square);
    Matrix3::identity()
        + k * (libm::sin(angle) / angle)
        + k * k * ((1.0 - libm::cos(angle)) / square)
}
