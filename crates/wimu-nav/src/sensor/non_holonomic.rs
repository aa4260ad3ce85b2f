//! Motion of a vehicle along its forward axis: equations (182) to (185).

use nalgebra::{Matrix2, Matrix3, RealField, SMatrix, Vector3};

use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::rotation::real;
use crate::state::{ATTITUDE, Block, Jacobian, State, VELOCITY};

/// How the unit is mounted in a vehicle.
#[derive(Clone, Copy, Debug)]
pub struct Mounting {
    /// Forward axis of the vehicle in the body frame. Its length is not observed.
    pub forward: Block<3>,
    /// Centre of the axle that does not steer, from the unit, m, body frame.
    pub axle: Block<3>,
}

/// Velocity of the axle in the body frame, and what it depends on.
pub(super) struct AxleVelocity<R> {
    /// Unit vector along the forward axis, body frame.
    pub forward: Vector3<R>,
    /// Length of the forward axis.
    pub length: R,
    /// m/s.
    pub velocity: Vector3<R>,
    by_attitude: Matrix3<R>,
    by_velocity: Matrix3<R>,
    by_axle: Matrix3<R>,
}

impl<R: RealField + Copy> AxleVelocity<R> {
    pub fn of<const N: usize>(state: &State<R, N>, mounting: &Mounting, rate: &Vector3<R>) -> Self {
        let to_body = state.attitude.matrix().transpose();
        let velocity = state.get(VELOCITY);
        let axis = state.get(mounting.forward);
        let length = axis.norm().max(real(1e-3));
        Self {
            forward: axis / length,
            length,
            velocity: to_body * velocity + rate.cross(&state.get(mounting.axle)),
            by_attitude: to_body * velocity.cross_matrix(),
            by_velocity: to_body,
            by_axle: rate.cross_matrix(),
        }
    }

    /// Derivative of components along `rows` that do not depend on the forward axis.
    pub fn jacobian<const M: usize, const N: usize>(
        &self,
        rows: &SMatrix<R, M, 3>,
        mounting: &Mounting,
    ) -> Jacobian<R, M, N> {
        Jacobian::zeros()
            .with(ATTITUDE, rows * self.by_attitude)
            .with(VELOCITY, rows * self.by_velocity)
            .with(mounting.axle, rows * self.by_axle)
    }
}

/// The axle moves along the forward axis alone: its velocity across is zero, to the left and up.
#[derive(Clone, Copy, Debug)]
pub struct NonHolonomic<'a, R> {
    /// The mounting.
    pub mounting: &'a Mounting,
    /// Angular rate, rad/s, body frame.
    pub rate_rad_s: Vector3<R>,
    /// Standard deviations of the velocity to the left and up, m/s.
    pub deviation_mps: [R; 2],
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 2> for NonHolonomic<'_, R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 2> {
        let state = &filter.state;
        let axle = AxleVelocity::of(state, self.mounting, &self.rate_rad_s);
        let up = state.attitude.inverse() * Vector3::z();
        let left = up.cross(&axle.forward).try_normalize(real(1e-3));
        // Without a left, of a forward axis that is vertical: any two axes across.
        let left = left.unwrap_or_else(|| {
            let far = axle.forward.x.abs() < real(0.7);
            let other = if far { Vector3::x() } else { Vector3::y() };
            axle.forward.cross(&other).normalize()
        });
        let up = axle.forward.cross(&left);
        let rows = SMatrix::<R, 2, 3>::from_rows(&[left.transpose(), up.transpose()]);
        // Along the axes themselves, which turn with the forward axis.
        let along = axle.forward.dot(&axle.velocity) / axle.length;
        let [left_sd, up_sd] = self.deviation_mps;
        Prediction {
            innovation: -(rows * axle.velocity),
            jacobian: axle
                .jacobian(&rows, self.mounting)
                .with(self.mounting.forward, rows * -along),
            covariance: Matrix2::new(left_sd * left_sd, R::zero(), R::zero(), up_sd * up_sd),
        }
    }
}

/// The forward axis is the direction of the velocity: of a vehicle that moves, where both are known well enough.
#[derive(Clone, Copy, Debug)]
pub struct ForwardAxis<R> {
    /// The forward axis.
    pub block: Block<3>,
    /// Measured direction, body frame.
    pub direction: Vector3<R>,
    /// Standard deviation, rad.
    pub deviation_rad: R,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 3> for ForwardAxis<R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 3> {
        Prediction {
            innovation: self.direction - filter.state.get(self.block),
            jacobian: Jacobian::zeros().with(self.block, Matrix3::identity()),
            covariance: Matrix3::identity() * (self.deviation_rad * self.deviation_rad),
        }
    }
}
