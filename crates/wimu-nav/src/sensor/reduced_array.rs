//! Sample of several accelerometers on a rigid body, in the closed form of equations (71) and (72):
//!
//! ```text
//! (B y)_ω̇ = ω̇ + B K q(ω + |ω| e) + b_ω̇ + n,    z = U q(ω + |ω| e) + b_z + n
//! ```
//!
//! It is quadratic in ω, so it is linearised at an angular rate of the caller's choice: one of the maxima of the posterior
//! density, equation (97).

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::{Measurement, Prediction};
use crate::array::{ArraySolver, Linear};
use crate::filter::Filter;
use crate::process::RigidArrayBlocks;

/// Angular acceleration (3) and z (6).
const MEASURED: usize = 9;
/// Most steps to a maximum; a good start takes 2 to 4.
const MOST_STEPS: usize = 12;

type Measured = SVector<f64, MEASURED>;
type Slope = SMatrix<f64, MEASURED, 3>;
type Square = SMatrix<f64, MEASURED, MEASURED>;

/// Noise of a sample.
#[derive(Clone, Copy, Debug)]
pub struct ArrayNoise {
    /// Variance of the sensors in units of what the geometry declares.
    pub factor: f64,
    /// Variance of the angular acceleration that lasts for one sample only, (rad/s²)².
    pub fast: f64,
}

/// A sample, linearised at an angular rate.
#[derive(Clone, Copy, Debug)]
pub struct ReducedArray<'a> {
    /// Its states.
    pub blocks: &'a RigidArrayBlocks,
    /// Closed form of a sample.
    pub solver: &'a ArraySolver,
    /// The sample.
    pub linear: &'a Linear,
    /// Its noise.
    pub noise: ArrayNoise,
    /// Angular rate at which it is linearised, rad/s, body frame.
    pub at_rad_s: Vector3<f64>,
}

impl ReducedArray<'_> {
    /// What an angular rate adds to the measured values, and its derivative.
    fn centripetal(&self, rate: &Vector3<f64>) -> (Measured, Slope) {
        let (theta, theta_slope) = self.solver.expected_theta(rate);
        let (z, z_slope) = self.solver.expected_z(rate);
        let value = Linear { theta, z }.rotation();
        let mut slope = Slope::zeros();
        slope.fixed_rows_mut::<3>(0).copy_from(&theta_slope.fixed_rows::<3>(0));
        slope.fixed_rows_mut::<6>(3).copy_from(&z_slope);
        (value, slope)
    }

    fn covariance(&self) -> Square {
        let mut noise = Square::identity() * self.noise.factor;
        let own = self.solver.covariance().fixed_view::<3, 3>(0, 0) * self.noise.factor;
        let fast = Matrix3::from_diagonal_element(self.noise.fast);
        noise.fixed_view_mut::<3, 3>(0, 0).copy_from(&(own + fast));
        noise
    }
}

impl Measurement for ReducedArray<'_> {
    fn predict(&self, filter: &Filter) -> Prediction {
        let RigidArrayBlocks { rotation, bias, z_bias, lever } = *self.blocks;
        let (value, slope) = self.centripetal(&self.at_rad_s);
        let rate = filter.state.get(self.blocks.rate());
        let turn = filter.state.get(self.blocks.acceleration());
        let (b, b_z) = (filter.state.get(bias), filter.state.get(z_bias));
        let other = Measured::from_fn(|k, _| match k {
            0..3 => turn[k] + b[k],
            _ => b_z[k - 3],
        });
        let mut by_rotation = SMatrix::<f64, MEASURED, 6>::zeros();
        let mut by_z_bias = SMatrix::<f64, MEASURED, 6>::zeros();
        let mut by_bias = SMatrix::<f64, MEASURED, 3>::zeros();
        by_rotation.fixed_view_mut::<9, 3>(0, 0).copy_from(&slope);
        by_rotation.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
        by_z_bias.fixed_view_mut::<6, 6>(3, 0).fill_with_identity();
        by_bias.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        let by_lever = slope * self.at_rad_s.norm();
        Prediction::new(
            self.linear.rotation() - value - slope * (rate - self.at_rad_s) - other,
            self.covariance(),
        )
        .by(rotation, by_rotation)
        .by(bias.part::<3, 0>(), by_bias)
        .by(z_bias, by_z_bias)
        .by(lever, by_lever)
    }
}

/// Density of the angular rate before a sample, and of the sample at a known angular rate.
#[derive(Clone, Debug)]
pub struct Prior {
    /// Mean angular rate, rad/s, and inverse of its covariance.
    pub rate_rad_s: Vector3<f64>,
    information: Matrix3<f64>,
    /// Mean of angular acceleration and biases, and how it changes with the angular rate.
    offset: Measured,
    regression: Slope,
    /// Inverse covariance of the sample at a known angular rate.
    precision: Square,
}

impl Prior {
    /// Of a sample; where it is linearised does not matter. `None` where a covariance is not positive definite.
    pub fn of(filter: &Filter, sample: &ReducedArray<'_>) -> Option<Self> {
        let blocks = sample.blocks;
        let (rate, turn) = (blocks.rate(), blocks.acceleration());
        let (b, z) = (blocks.bias.part::<3, 0>(), blocks.z_bias);
        let information = filter.covariance(rate).cholesky()?.inverse();
        let mut cross = Slope::zeros();
        let with_rate = filter.cross_covariance(turn, rate) + filter.cross_covariance(b, rate);
        cross.fixed_view_mut::<3, 3>(0, 0).copy_from(&with_rate);
        let z_rate = filter.cross_covariance(z, rate);
        cross.fixed_view_mut::<6, 3>(3, 0).copy_from(&z_rate);
        let regression = cross * information;
        let turn_bias = filter.cross_covariance(turn, b);
        let both =
            filter.covariance(turn) + turn_bias + turn_bias.transpose() + filter.covariance(b);
        let both_z = filter.cross_covariance(turn, z) + filter.cross_covariance(b, z);
        let mut total = sample.covariance() - regression * cross.transpose();
        let mut add = total.fixed_view_mut::<3, 3>(0, 0);
        add += both;
        let mut add = total.fixed_view_mut::<3, 6>(0, 3);
        add += both_z;
        let mut add = total.fixed_view_mut::<6, 3>(3, 0);
        add += both_z.transpose();
        let mut add = total.fixed_view_mut::<6, 6>(3, 3);
        add += filter.covariance(z);
        let state = &filter.state;
        let (mean, mean_z) = (state.get(turn) + state.get(b), state.get(z));
        Some(Self {
            rate_rad_s: state.get(rate),
            information,
            offset: Measured::from_fn(|k, _| if k < 3 { mean[k] } else { mean_z[k - 3] }),
            regression,
            precision: total.cholesky()?.inverse(),
        })
    }

    /// Squared difference of two angular rates over the covariance before the sample.
    pub fn distance(&self, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
        let d = a - b;
        d.dot(&(self.information * d))
    }

    /// The maximum of the posterior density near a start: damped Gauss-Newton, equation (97). `None` where it is not finite.
    pub fn maximum(&self, sample: &ReducedArray<'_>, start: Vector3<f64>) -> Option<Vector3<f64>> {
        let measured = sample.linear.rotation() - self.offset;
        let residual = |rate: &Vector3<f64>| {
            let (value, slope) = sample.centripetal(rate);
            let away = rate - self.rate_rad_s;
            let residual = measured - value - self.regression * away;
            let weighted = self.precision * residual;
            let cost = residual.dot(&weighted) + away.dot(&(self.information * away));
            (cost, weighted, slope + self.regression)
        };
        let mut rate = start;
        let (mut cost, mut weighted, mut slope) = residual(&rate);
        let mut damping = 0.0;
        for _ in 0..MOST_STEPS {
            let mut normal = self.information + slope.transpose() * (self.precision * slope);
            for k in 0..3 {
                normal[(k, k)] *= 1.0 + damping;
            }
            let gradient =
                slope.transpose() * weighted + self.information * (self.rate_rad_s - rate);
            let step = normal.cholesky()?.solve(&gradient);
            let next = residual(&(rate + step));
            if next.0 <= cost {
                rate += step;
                (cost, weighted, slope) = next;
                damping *= 0.1;
                // A thousandth of a squared standard deviation.
                if step.dot(&gradient) < (1e-3) {
                    break;
                }
            } else if damping > 1e3 || !next.0.is_finite() {
                break;
            } else {
                damping = (damping * 10.0).max(1e-3);
            }
        }
        (cost.is_finite() && rate.iter().all(|w| w.is_finite())).then_some(rate)
    }
}
