//! Velocity: zero at a rest, bounded in motion, along the axle of a vehicle, or by its wheels; and states with known values.
//! Equations (121), (122) and (182) to (186).

use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector1, Vector2, Vector3};

use super::position::components;
use super::{Measurement, Prediction};
use crate::filter::{Filter, Gate};
use crate::state::{ATTITUDE, Block, POSITION, State, VELOCITY};

/// Velocity of the unit or of a point of it, navigation frame.
#[derive(Clone, Copy, Debug)]
pub struct Velocity {
    /// m/s.
    pub velocity_mps: Vector3<f64>,
    /// Standard deviation of each component, m/s; infinite where it is not measured.
    pub deviation_mps: Vector3<f64>,
    /// Velocity of the point relative to the unit, ω × r, m/s, body frame.
    pub turning_mps: Vector3<f64>,
    /// A velocity that is added to it, m/s: of a platform, or one that a rest does not show.
    pub offset: Option<Block<3>>,
}

impl Velocity {
    /// Zero with a standard deviation of a component, m/s.
    pub fn zero(deviation_mps: f64, offset: Option<Block<3>>) -> Self {
        let zero = Vector3::zeros();
        let deviation_mps = Vector3::repeat(deviation_mps);
        Self { velocity_mps: zero, deviation_mps, turning_mps: zero, offset }
    }
}

impl Measurement for Velocity {
    fn predict(&self, filter: &Filter) -> Prediction {
        let state = &filter.state;
        let offset = self.offset.map_or_else(Vector3::zeros, |block| state.get(block));
        let turning = state.attitude * self.turning_mps;
        let shown = state.get(VELOCITY) + turning;
        let (predicted, rows) = components(self.velocity_mps + offset - shown, &self.deviation_mps);
        predicted
            .by(VELOCITY, rows)
            .by(ATTITUDE, rows * -turning.cross_matrix())
            .by_some(self.offset, -rows)
    }
}

/// Zero velocity at a rest that is certain, whatever the test: if it fails, the covariance is too small, and that of
/// attitude, velocity, position and `bias` is first multiplied by the statistic over its degrees of freedom, with all
/// correlations. The bias of the accelerometer keeps its covariance: it would otherwise absorb the tilt error.
pub fn recover(filter: &mut Filter, measurement: &Velocity, bias: Block<3>) {
    let test = filter.test(measurement);
    let factor = test.statistic / (test.dof as f64);
    let scaled = bias.start()..bias.start() + 3;
    filter.scale_covariance(|k| k < POSITION.start() + 3 || scaled.contains(&k), factor);
    filter.update(measurement, Gate::Open);
}

/// States have known values, such as the bias of a gyroscope at a rest, or a rotation of zero.
#[derive(Clone, Copy, Debug)]
pub struct Known<const W: usize> {
    /// The states.
    pub block: Block<W>,
    /// Their values.
    pub value: SVector<f64, W>,
    /// Standard deviation of each value.
    pub deviation: [f64; W],
}

impl<const W: usize> Known<W> {
    /// All are zero.
    pub fn zero(block: Block<W>, deviation: [f64; W]) -> Self {
        Self { block, value: SVector::zeros(), deviation }
    }
}

impl<const W: usize> Measurement for Known<W> {
    fn predict(&self, filter: &Filter) -> Prediction {
        let variance = SVector::from(self.deviation.map(|d| d * d));
        let innovation = self.value - filter.state.get(self.block);
        Prediction::new(innovation, SMatrix::from_diagonal(&variance))
            .by(self.block, SMatrix::<f64, W, W>::identity())
    }
}

/// The angular rate is about the vertical: otherwise the specific force of constant velocity would turn in the body.
#[derive(Clone, Copy, Debug)]
pub struct VerticalRate {
    /// Angular rate, body frame.
    pub block: Block<3>,
    /// Standard deviation of each horizontal component, rad/s.
    pub deviation: f64,
}

impl Measurement for VerticalRate {
    fn predict(&self, filter: &Filter) -> Prediction {
        let attitude = filter.state.attitude.matrix();
        let rate: Vector3<f64> = attitude * filter.state.get(self.block);
        let turned = -rate.cross_matrix();
        Prediction::new(-rate.xy(), Matrix2::from_diagonal_element(self.deviation * self.deviation))
            .by(ATTITUDE, turned.fixed_rows::<2>(0).into_owned())
            .by(self.block, attitude.fixed_rows::<2>(0).into_owned())
    }
}

/// How the unit is mounted in a vehicle.
#[derive(Clone, Copy, Debug)]
pub struct Mounting {
    /// Forward axis of the vehicle in the body frame. Its length is not observed.
    pub forward: Block<3>,
    /// Centre of the axle that does not steer, from the unit, m, body frame.
    pub axle: Block<3>,
}

/// Velocity of the axle in the body frame, and what it depends on.
struct AxleVelocity {
    /// Unit vector along the forward axis, body frame.
    pub forward: Vector3<f64>,
    /// Length of the forward axis.
    pub length: f64,
    /// m/s.
    pub velocity: Vector3<f64>,
    by_attitude: Matrix3<f64>,
    by_velocity: Matrix3<f64>,
    by_axle: Matrix3<f64>,
}

impl AxleVelocity {
    fn of(state: &State, mounting: &Mounting, rate: &Vector3<f64>) -> Self {
        let to_body = state.attitude.matrix().transpose();
        let velocity = state.get(VELOCITY);
        let axis = state.get(mounting.forward);
        let length = axis.norm().max(1e-3);
        Self {
            forward: axis / length,
            length,
            velocity: to_body * velocity + rate.cross(&state.get(mounting.axle)),
            by_attitude: to_body * velocity.cross_matrix(),
            by_velocity: to_body,
            by_axle: rate.cross_matrix(),
        }
    }

    /// Prediction of components along `rows`, without the derivative by the forward axis.
    fn along<const M: usize>(
        &self,
        rows: &SMatrix<f64, M, 3>,
        mounting: &Mounting,
        measured: SVector<f64, M>,
        deviation: [f64; M],
    ) -> Prediction {
        let variance = SVector::from(deviation.map(|d| d * d));
        Prediction::new(measured - rows * self.velocity, SMatrix::from_diagonal(&variance))
            .by(ATTITUDE, rows * self.by_attitude)
            .by(VELOCITY, rows * self.by_velocity)
            .by(mounting.axle, rows * self.by_axle)
    }
}

/// The axle moves along the forward axis alone: its velocity across is zero, to the left and up.
#[derive(Clone, Copy, Debug)]
pub struct NonHolonomic<'a> {
    /// The mounting.
    pub mounting: &'a Mounting,
    /// Angular rate, rad/s, body frame.
    pub rate_rad_s: Vector3<f64>,
    /// Standard deviations of the velocity to the left and up, m/s.
    pub deviation_mps: [f64; 2],
}

impl Measurement for NonHolonomic<'_> {
    fn predict(&self, filter: &Filter) -> Prediction {
        let state = &filter.state;
        let axle = AxleVelocity::of(state, self.mounting, &self.rate_rad_s);
        let up = state.attitude.inverse() * Vector3::z();
        let left = up.cross(&axle.forward).try_normalize(1e-3);
        // Without a left, of a forward axis that is vertical: any two axes across.
        let left = left.unwrap_or_else(|| {
            let far = axle.forward.x.abs() < 0.7;
            let other = if far { Vector3::x() } else { Vector3::y() };
            axle.forward.cross(&other).normalize()
        });
        let up = axle.forward.cross(&left);
        let rows = SMatrix::<f64, 2, 3>::from_rows(&[left.transpose(), up.transpose()]);
        // Along the axes themselves, which turn with the forward axis.
        let along = axle.forward.dot(&axle.velocity) / axle.length;
        axle.along(&rows, self.mounting, Vector2::zeros(), self.deviation_mps)
            .by(self.mounting.forward, rows * -along)
    }
}

/// A reading of an odometer.
#[derive(Clone, Copy, Debug)]
pub struct Odometer<'a> {
    /// The mounting of the unit.
    pub mounting: &'a Mounting,
    /// Scale error s: true speed = (1 + s) × measured speed.
    pub scale: Block<1>,
    /// Measured speed, m/s, positive forward.
    pub speed_mps: f64,
    /// Standard deviation of its noise, m/s.
    pub deviation_mps: f64,
    /// Angular rate, rad/s, body frame.
    pub rate_rad_s: Vector3<f64>,
}

impl Measurement for Odometer<'_> {
    fn predict(&self, filter: &Filter) -> Prediction {
        let axle = AxleVelocity::of(&filter.state, self.mounting, &self.rate_rad_s);
        let scale = filter.state.get(self.scale).x;
        let row = axle.forward.transpose();
        let across = axle.velocity - axle.forward * axle.forward.dot(&axle.velocity);
        let measured = Vector1::new(self.speed_mps * (scale + 1.0));
        axle.along(&row, self.mounting, measured, [self.deviation_mps])
            .by(self.mounting.forward, across.transpose() / axle.length)
            .by(self.scale, Vector1::new(-self.speed_mps))
    }
}
