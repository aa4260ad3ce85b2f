//! One pass over the rests and turns, linear about given parameters.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::rests::{Rest, Session};
use super::turn::Turn;
use super::{AccelerometerCalibration, PARAMETERS, PRIOR_SD, Theta, perfect};

/// Parameters of the gyroscope, direction of gravity, parameters of the accelerometer.
const N: usize = PARAMETERS + 15;
const A: usize = 3;
const G: usize = 12;
const UP: usize = PARAMETERS;
const ACCELEROMETER: usize = PARAMETERS + 3;
/// Variance of a component of the Earth's rate at an unknown latitude, (rad/s)². Of the mean over all
/// axes, two thirds are horizontal; the vertical one is not distinguished from g-sensitivity.
pub(super) const EARTH: f64 = 7.292e-5 * 7.292e-5 / 3.0;
const EARTH_LEVEL: f64 = EARTH * 2.0 / 3.0;

/// Variances that the filter assumes.
#[derive(Clone, Copy)]
pub(super) struct Noise {
    /// Of a sample, (rad/s)².
    pub sample: f64,
    /// Of the change of the bias in a second, (rad/s)²/s.
    pub bias: f64,
    /// Of the error of a turn over its angle.
    pub turn: f64,
}

/// Squares of innovations over their variances.
#[derive(Clone, Copy, Default)]
pub(super) struct Squares {
    pub sum: f64,
    pub count: f64,
}

impl Squares {
    fn add(&mut self, square: f64) {
        self.sum += square;
        self.count += 1.0;
    }
}

/// Angles between predicted and measured directions of gravity.
#[derive(Clone, Copy, Default)]
pub(super) struct Angles {
    squares: f64,
    pub worst_rad: f64,
    pub worst_turn: usize,
    pub count: usize,
}

impl Angles {
    pub fn add(&mut self, turn: usize, angle_rad: f64) {
        self.squares += angle_rad * angle_rad;
        self.count += 1;
        if angle_rad > self.worst_rad {
            (self.worst_rad, self.worst_turn) = (angle_rad, turn);
        }
    }

    pub fn rms_rad(&self) -> f64 {
        libm::sqrt(self.squares / self.count.max(1) as f64)
    }

    /// The rms without the worst turn.
    pub fn others_rad(&self) -> f64 {
        let rest = self.squares - self.worst_rad * self.worst_rad;
        libm::sqrt(rest.max(0.0) / self.count.saturating_sub(1).max(1) as f64)
    }
}

/// The result of a pass.
pub(super) struct Pass {
    /// Correction of the parameters; of the bias, at the last rest.
    pub change: Theta,
    pub covariance: SMatrix<f64, PARAMETERS, PARAMETERS>,
    /// Of mean rates at rests.
    pub rests: Squares,
    /// Of directions after turns.
    pub turns: Squares,
    pub angles: Angles,
}

/// Deviation of the state from the point of linearisation, and its covariance.
struct Filter {
    x: SVector<f64, N>,
    p: SMatrix<f64, N, N>,
}

/// Filters the session: equations (145) to (148).
pub(super) fn pass(session: &Session<'_>, at: &Theta, noise: &Noise) -> Option<Pass> {
    let rates = session.rates(at)?;
    let mut filter = Filter::new(at, session.given.accelerometer);
    let (mut rests, mut turns, mut angles) =
        (Squares::default(), Squares::default(), Angles::default());
    let accelerometer = session.given.accelerometer;
    let mut before: Option<(usize, Rest)> = None;
    for (k, rest) in session.rests().enumerate() {
        let mut turned = false;
        if let Some((from, before)) = &before {
            let walk = 0.5 * noise.bias * session.apart_s(*from, [before, &rest]);
            filter.drift(walk);
            if let Ok(turn) = session.turn(*from, &rates) {
                let angle = filter.rotate(&turn, &rates.inverse, [before.up, rest.up], noise);
                angles.add(*from, angle);
                turned = true;
            }
            filter.drift(walk);
        }
        if !turned {
            filter.forget_direction(rest.up);
        }
        for square in filter.direction(&rest, accelerometer) {
            if turned {
                turns.add(square);
            }
        }
        let variance =
            noise.sample / rest.samples + noise.bias * rest.length_s / 12.0 + EARTH_LEVEL;
        for axis in 0..3 {
            let mut h = SVector::<f64, N>::zeros();
            h[axis] = 1.0;
            h.fixed_rows_mut::<3>(G + 3 * axis).copy_from(&rest.force);
            let expected = h.fixed_rows::<PARAMETERS>(0).dot(at);
            rests.add(filter.update(&h, rest.rate[axis] - expected, variance));
        }
        before = Some((k, rest));
    }
    Some(Pass {
        change: filter.x.fixed_rows::<PARAMETERS>(0).into(),
        covariance: filter.p.fixed_view::<PARAMETERS, PARAMETERS>(0, 0).into(),
        rests,
        turns,
        angles,
    })
}

impl Filter {
    fn new(at: &Theta, accelerometer: &AccelerometerCalibration) -> Self {
        let mut x = SVector::<f64, N>::zeros();
        let mut p = SMatrix::<f64, N, N>::zeros();
        x.fixed_rows_mut::<PARAMETERS>(0).copy_from(&(perfect() - at));
        for (i, sd) in PRIOR_SD.iter().enumerate() {
            p[(i, i)] = sd * sd;
        }
        let known = SMatrix::<f64, 12, 12>::from(*accelerometer.covariance.matrix());
        p.fixed_view_mut::<12, 12>(ACCELEROMETER, ACCELEROMETER).copy_from(&known);
        Self { x, p }
    }

    /// The bias changes by a random walk of this variance.
    fn drift(&mut self, variance: f64) {
        for axis in 0..3 {
            self.p[(axis, axis)] += variance;
        }
    }

    /// The direction of gravity is unknown, near `up`.
    fn forget_direction(&mut self, up: Vector3<f64>) {
        self.x.fixed_rows_mut::<3>(UP).fill(0.0);
        self.p.fixed_rows_mut::<3>(UP).fill(0.0);
        self.p.fixed_columns_mut::<3>(UP).fill(0.0);
        (self.p.fixed_view_mut::<3, 3>(UP, UP)).copy_from(&across(up));
    }

    /// The direction of gravity after a turn, relative to `to`; before it was relative to `from`.
    /// Returns the angle between `from`, rotated, and `to`. Equations (145) and (146).
    fn rotate(
        &mut self,
        turn: &Turn,
        inverse: &Matrix3<f64>,
        [from, to]: [Vector3<f64>; 2],
        noise: &Noise,
    ) -> f64 {
        let back = turn.attitude.transpose();
        let effect = -back * from.cross_matrix();
        let mut f = SMatrix::<f64, 3, N>::zeros();
        f.fixed_columns_mut::<3>(UP).copy_from(&back);
        (f.fixed_columns_mut::<3>(0)).copy_from(&(effect * turn.time * inverse));
        for column in 0..3 {
            let rate = effect * turn.rate[column] * inverse;
            let force = effect * turn.force[column] * inverse;
            for row in 0..3 {
                f.set_column(A + 3 * row + column, &rate.column(row));
                f.set_column(G + 3 * row + column, &force.column(row));
            }
        }
        let predicted = back * from;
        let white = noise.sample * turn.step_s() * turn.length_s;
        let walk = noise.bias * turn.length_s / 12.0 + EARTH_LEVEL;
        let walk = walk * turn.length_s * turn.length_s;
        let own = noise.turn * turn.angle_rad * turn.angle_rad;
        let rows = f * self.p;
        let new = rows * f.transpose() + across(to) * (white + walk + own);
        let x = f * self.x + predicted - to;
        self.x.fixed_rows_mut::<3>(UP).copy_from(&x);
        self.p.fixed_rows_mut::<3>(UP).copy_from(&rows);
        self.p.fixed_columns_mut::<3>(UP).copy_from(&rows.transpose());
        self.p.fixed_view_mut::<3, 3>(UP, UP).copy_from(&new);
        predicted.angle(&to)
    }

    /// Updates with the measured direction of gravity: equation (147).
    fn direction(&mut self, rest: &Rest, accelerometer: &AccelerometerCalibration) -> [f64; 2] {
        let inverse = accelerometer.inverse();
        let first = rest.up.cross(&Vector3::ith(rest.up.iamin(), 1.0)).normalize();
        let size = rest.force.norm();
        [first, rest.up.cross(&first)].map(|across| {
            let sensor = inverse.tr_mul(&across) / size;
            let mut h = SVector::<f64, N>::zeros();
            h.fixed_rows_mut::<3>(UP).copy_from(&across);
            h.fixed_rows_mut::<3>(ACCELEROMETER).copy_from(&sensor);
            for row in 0..3 {
                let of_matrix = rest.force * sensor[row];
                h.fixed_rows_mut::<3>(ACCELEROMETER + 3 + 3 * row).copy_from(&of_matrix);
            }
            self.update(&h, 0.0, rest.force_variance / (size * size))
        })
    }

    /// Updates with the measurement `z` = hᵀ x + noise. Returns the squared innovation over its
    /// variance.
    fn update(&mut self, h: &SVector<f64, N>, z: f64, variance: f64) -> f64 {
        let ph = self.p * h;
        let total = h.dot(&ph) + variance;
        let innovation = z - h.dot(&self.x);
        self.x += ph * (innovation / total);
        self.p.ger(-1.0 / total, &ph, &ph, 1.0);
        innovation * innovation / total
    }
}

/// Projection on the plane across a direction.
fn across(up: Vector3<f64>) -> Matrix3<f64> {
    Matrix3::identity() - up * up.transpose()
}
