//! The gyroscope between rests as a residual model: equations (143) to (149).
//!
//! At rest k the mean output is y_k = b_k + G f_k, and the bias b is a random walk from one rest to the next. A turn carries
//! the direction of gravity d: d_k+1 = Cᵀ d_k, with C from the rates less the mean bias of both rests. The bias is a linear
//! block and is eliminated by differences: a block of observations is y_k − y_k+1 − G (f_k − f_k+1), and Cᵀ d_k − d_k+1
//! across d_k+1. Neighbouring blocks share the noise of a rest, so their covariance is block-tridiagonal; its Cholesky
//! factor makes the residuals white.

use alloc::vec::Vec;

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, SVector, Vector3};

use super::rests::{Rest, Session};
use super::turn::Turn;
use super::{AccelerometerCalibration, G_SENSITIVITY, MATRIX, PARAMETERS, PRIOR_SD, perfect};
use crate::estimate::Residuals;
use crate::least_squares::{self, ResidualModel, Rows, Settings};

/// Parameters of the gyroscope, with the bias at the last rest; then errors of the accelerometer's 12 parameters in
/// units of the root of their covariance.
const UNKNOWNS: usize = PARAMETERS + 12;
/// Observations of a block: three differences of rates, two components of a direction.
const BLOCK: usize = 5;
/// Errors of a rest: of its rate, and of its direction.
const ERRORS: usize = 6;
/// Variance of a component of the Earth's rate at an unknown latitude, (rad/s)². Of the mean over all
/// axes, two thirds are horizontal; the vertical one is not distinguished from g-sensitivity.
pub(super) const EARTH: f64 = 7.292e-5 * 7.292e-5 / 3.0;
const EARTH_LEVEL: f64 = EARTH * 2.0 / 3.0;
/// The fit has converged when the residuals change by this many standard deviations, rms.
const SETTINGS: Settings = Settings { cauchy: None, last_step: 0.01, magnitude: 1.0 };

pub(super) type Point = SVector<f64, UNKNOWNS>;
pub(super) type Fit = least_squares::Fit<Point>;

/// Variances that the model assumes.
#[derive(Clone, Copy)]
pub(super) struct Noise {
    /// Of a sample, (rad/s)².
    pub sample: f64,
    /// Of the change of the bias in a second, (rad/s)²/s.
    pub bias: f64,
    /// Of the error of a turn over its angle.
    pub turn: f64,
}

/// Squared residuals over their variances, and their degrees of freedom.
#[derive(Clone, Copy, Default)]
pub(super) struct Squares {
    pub sum: f64,
    pub dof: f64,
}

/// The observations between a rest and the next, or of the last rest.
struct Block {
    /// Residuals, then their derivatives by the unknowns.
    rows: SMatrix<f64, BLOCK, { 1 + UNKNOWNS }>,
    /// Derivatives by the errors of the rest, and of the next.
    by_rest: SMatrix<f64, BLOCK, ERRORS>,
    by_next: SMatrix<f64, BLOCK, ERRORS>,
    /// Variances of what the observations do not share.
    own: SVector<f64, BLOCK>,
    /// Between predicted and measured direction, rad, where the turn is used.
    angle_rad: Option<f64>,
}

/// Rows of the Cholesky factor of the residuals' covariance: left of the diagonal block, and that.
type Factor = [SMatrix<f64, BLOCK, BLOCK>; 2];

pub(super) struct Rotations<'a> {
    session: &'a Session<'a>,
    rests: Vec<Rest>,
    noise: Noise,
    /// Root of the covariance of the accelerometer's parameters.
    root: SMatrix<f64, 12, 12>,
    /// From the last rest to the first.
    factors: Vec<Factor>,
}

impl ResidualModel for Rotations<'_> {
    type Point = Point;

    fn rows(&self, at: &Point) -> Option<Rows> {
        let count = BLOCK * self.rests.len();
        let mut rows = Rows {
            residual: DVector::zeros(count + UNKNOWNS),
            jacobian: DMatrix::zeros(count + UNKNOWNS, UNKNOWNS),
        };
        let mut before = SMatrix::zeros();
        for (place, [left, diagonal]) in self.factors.iter().enumerate() {
            let block = self.block(at, self.rests.len() - 1 - place)?;
            before = diagonal.solve_lower_triangular(&(block.rows - left * before))?;
            rows.residual.rows_mut(BLOCK * place, BLOCK).copy_from(&before.column(0));
            let derivatives = before.fixed_columns::<UNKNOWNS>(1);
            rows.jacobian.rows_mut(BLOCK * place, BLOCK).copy_from(&derivatives);
        }
        let perfect = perfect();
        for i in 0..UNKNOWNS {
            let (mean, sd) = if i < PARAMETERS { (perfect[i], PRIOR_SD[i]) } else { (0.0, 1.0) };
            rows.residual[count + i] = (at[i] - mean) / sd;
            rows.jacobian[(count + i, i)] = 1.0 / sd;
        }
        Some(rows)
    }

    fn moved(&self, at: &Point, step: &DVector<f64>) -> Point {
        at + Point::from_column_slice(step.as_slice())
    }
}

impl<'a> Rotations<'a> {
    /// The model with the covariance of the residuals near `about`.
    pub fn new(session: &'a Session<'a>, about: &Point, noise: Noise) -> Option<Self> {
        let known = SMatrix::<f64, 12, 12>::from(*session.given.accelerometer.covariance.matrix());
        let known = known.symmetric_eigen();
        let deviations = known.eigenvalues.map(|variance| libm::sqrt(variance.max(0.0)));
        let mut model = Self {
            session,
            rests: session.rests().collect(),
            noise,
            root: known.eigenvectors * SMatrix::from_diagonal(&deviations),
            factors: Vec::new(),
        };
        let mut next: Option<(Block, SVector<f64, ERRORS>)> = None;
        for k in (0..model.rests.len()).rev() {
            let block = model.block(about, k)?;
            let variances = model.variances(&model.rests[k]);
            let mut left = SMatrix::zeros();
            let scaled = block.by_rest * SMatrix::from_diagonal(&variances);
            let mut own = scaled * block.by_rest.transpose() + SMatrix::from_diagonal(&block.own);
            if let (Some((after, shared)), Some([_, diagonal])) = (&next, model.factors.last()) {
                let scaled = block.by_next * SMatrix::from_diagonal(shared);
                let both = scaled * after.by_rest.transpose();
                left = diagonal.solve_lower_triangular(&both.transpose())?.transpose();
                own += scaled * block.by_next.transpose() - left * left.transpose();
            }
            model.factors.push([left, own.cholesky()?.unpack()]);
            next = Some((block, variances));
        }
        Some(model)
    }

    pub fn fit(&self, start: &Point) -> Option<Fit> {
        let weights = alloc::vec![1.0; BLOCK * self.rests.len() + UNKNOWNS];
        least_squares::minimise(self, start, &weights, SETTINGS)
    }

    /// Squares of the differences of rates, and of the directions.
    pub fn squares(&self, fit: &Fit) -> Option<[Squares; 2]> {
        let rows = self.rows(&fit.at)?;
        let mut found = [Squares::default(); 2];
        for place in 0..self.rests.len() {
            let is_turn = self.block(&fit.at, self.rests.len() - 1 - place)?.angle_rad.is_some();
            for i in 0..if is_turn { BLOCK } else { 3 } {
                let row = BLOCK * place + i;
                let squares = &mut found[usize::from(i >= 3)];
                squares.sum += rows.residual[row] * rows.residual[row];
                squares.dof += 1.0 - fit.variance(&rows.jacobian.row(row).transpose());
            }
        }
        Some(found)
    }

    /// Errors of the predicted directions, rad.
    pub fn angles(&self, at: &Point) -> Residuals {
        let angle = |k| Some((k, self.block(at, k)?.angle_rad?));
        Residuals::of((0..self.rests.len().saturating_sub(1)).filter_map(angle))
    }

    /// Variances of the errors of a rest.
    fn variances(&self, rest: &Rest) -> SVector<f64, ERRORS> {
        let Noise { sample, bias, .. } = self.noise;
        let rate = sample / rest.samples + bias * rest.length_s / 12.0 + EARTH_LEVEL;
        let [x, y, z] = self.session.rounding.map(|rounding| rate + rounding).into();
        let direction = rest.force_variance / rest.force.norm_squared();
        SVector::from([x, y, z, direction, direction, direction])
    }

    /// The observations from rest `k` on.
    fn block(&self, at: &Point, k: usize) -> Option<Block> {
        let first = self.rests.get(k)?;
        let mut block = Block {
            rows: SMatrix::zeros(),
            by_rest: SMatrix::zeros(),
            by_next: SMatrix::zeros(),
            own: SVector::from([0.0, 0.0, 0.0, 1.0, 1.0]),
            angle_rad: None,
        };
        block.by_rest.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        let mut force = first.force;
        let mut rate = first.rate;
        if let Some(second) = self.rests.get(k + 1) {
            (force, rate) = (force - second.force, rate - second.rate);
            let apart_s = self.session.apart_s(k, [first, second]);
            block.by_next.fixed_view_mut::<3, 3>(0, 0).copy_from(&-Matrix3::identity());
            block.own.fixed_rows_mut::<3>(0).fill(self.noise.bias * apart_s);
            self.turn(at, k, [first, second], apart_s, &mut block)?;
        } else {
            rate -= at.fixed_rows::<3>(0);
            block.rows.fixed_view_mut::<3, 3>(0, 1).copy_from(&-Matrix3::identity());
        }
        for axis in 0..3 {
            let g = at.fixed_rows::<3>(G_SENSITIVITY + 3 * axis);
            block.rows[(axis, 0)] = rate[axis] - g.dot(&force);
            let mut row = block.rows.fixed_view_mut::<1, 3>(axis, 1 + G_SENSITIVITY + 3 * axis);
            row.copy_from(&-force.transpose());
        }
        Some(block)
    }

    /// The direction of gravity after the turn from rest `k`, relative to that measured: equations (145) and (146).
    fn turn(
        &self,
        at: &Point,
        k: usize,
        [first, second]: [&Rest; 2],
        apart_s: f64,
        block: &mut Block,
    ) -> Option<()> {
        let mut rates = self.session.rates(&at.fixed_rows::<PARAMETERS>(0).into())?;
        let middle = (first.force + second.force) * 0.5;
        rates.bias = (first.rate + second.rate) * 0.5 - rates.g_sensitivity * middle;
        let Ok(turn) = self.session.turn(k, &rates) else { return Some(()) };
        let back = turn.attitude.transpose();
        let across = across(second.up).transpose();
        // The measured directions less the errors of the accelerometer.
        let accelerometer = self.session.given.accelerometer;
        let by = [first, second].map(|rest| by_parameters(rest, accelerometer) * self.root);
        let errors = at.fixed_rows::<12>(PARAMETERS);
        let [before, after] = [first.up - by[0] * errors, second.up - by[1] * errors];
        let effect = -across * back * before.cross_matrix();
        block.angle_rad = Some((back * first.up).angle(&second.up));
        let mut rows = block.rows.fixed_rows_mut::<2>(3);
        for column in 0..3 {
            let by_rate = effect * turn.rate[column] * rates.inverse;
            let by_force = turn.force[column] - turn.time * middle[column];
            let by_force = effect * by_force * rates.inverse;
            for row in 0..3 {
                rows.set_column(1 + MATRIX + 3 * row + column, &by_rate.column(row));
                rows.set_column(1 + G_SENSITIVITY + 3 * row + column, &by_force.column(row));
            }
        }
        rows.set_column(0, &(across * (back * before - after)));
        let by_accelerometer = across * (by[1] - back * by[0]);
        rows.fixed_columns_mut::<12>(1 + PARAMETERS).copy_from(&by_accelerometer);
        let by_bias = effect * turn.time * rates.inverse * 0.5;
        let project = Matrix3::identity() - first.up * first.up.transpose();
        let mut by_rest = block.by_rest.fixed_rows_mut::<2>(3);
        by_rest.fixed_columns_mut::<3>(0).copy_from(&by_bias);
        by_rest.fixed_columns_mut::<3>(3).copy_from(&(across * back * project));
        let mut by_next = block.by_next.fixed_rows_mut::<2>(3);
        by_next.fixed_columns_mut::<3>(0).copy_from(&by_bias);
        by_next.fixed_columns_mut::<3>(3).copy_from(&-across);
        block.own.fixed_rows_mut::<2>(3).fill(self.variance(&turn, apart_s));
        Some(())
    }

    /// Variance of a component of the direction after a turn, rad². Of the bias during the turn, about the mean of its
    /// rests, a quarter of the walk between them.
    fn variance(&self, turn: &Turn, apart_s: f64) -> f64 {
        let Noise { sample, bias, turn: of_angle } = self.noise;
        let white = sample * turn.step_s() * turn.length_s;
        let walk = bias * (turn.length_s / 12.0 + 0.25 * apart_s) + EARTH_LEVEL;
        let walk = walk * turn.length_s * turn.length_s;
        white + walk + of_angle * turn.angle_rad * turn.angle_rad
    }
}

/// Two unit vectors across a direction.
fn across(up: Vector3<f64>) -> SMatrix<f64, 3, 2> {
    let first = up.cross(&Vector3::ith(up.iamin(), 1.0)).normalize();
    SMatrix::from_columns(&[first, up.cross(&first)])
}

/// Derivatives of the measured direction by the parameters of the accelerometer, negated: equation (147).
fn by_parameters(rest: &Rest, accelerometer: &AccelerometerCalibration) -> SMatrix<f64, 3, 12> {
    let project = Matrix3::identity() - rest.up * rest.up.transpose();
    let by_bias = project * accelerometer.inverse() / rest.force.norm();
    let mut by = SMatrix::<f64, 3, 12>::zeros();
    by.fixed_columns_mut::<3>(0).copy_from(&by_bias);
    for (row, column) in (0..3).flat_map(|row| (0..3).map(move |column| (row, column))) {
        by.set_column(3 + 3 * row + column, &(by_bias.column(row) * rest.force[column]));
    }
    by
}
