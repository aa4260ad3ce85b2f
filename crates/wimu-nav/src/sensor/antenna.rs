//! Position of an antenna whose lever arm and clock are states: equations (180) and (181).

use nalgebra::{Matrix3, RealField, Vector3};

use super::{Measurement, Position, Prediction};
use crate::filter::Filter;
use crate::rotation::real;
use crate::state::{Block, Jacobian, POSITION, VELOCITY};

/// A position fix by an antenna. What is known of its lever arm is in the fix; the rest is a state.
#[derive(Clone, Copy, Debug)]
pub struct Antenna<R> {
    /// The fix.
    pub fix: Position<R>,
    /// Antenna from the given lever arm, m, body frame.
    pub offset: Block<3>,
    /// The clock of the samples is behind that of the fixes by this time, s: the time stamp of a sample is late.
    pub clock: Block<1>,
    /// Time from the fix to the state, s, by their time stamps.
    pub age_s: R,
    /// Angular rate, rad/s, body frame.
    pub rate_rad_s: Vector3<R>,
    /// Acceleration, m/s², navigation frame.
    pub acceleration_mps2: Vector3<R>,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 3> for Antenna<R> {
    /// Constant acceleration and angular rate over the time between the state and the fix.
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 3> {
        let state = &filter.state;
        let attitude = state.attitude.matrix();
        let lasts = state.get(self.clock).x - self.age_s;
        let turned = Matrix3::identity() + self.rate_rad_s.cross_matrix() * lasts;
        let arm = self.fix.lever_arm_m + state.get(self.offset);
        let gained = self.acceleration_mps2 * lasts;
        let velocity = state.get(VELOCITY) + gained + attitude * self.rate_rad_s.cross(&arm);
        let fix = Position {
            position_m: self.fix.position_m
                - (state.get(VELOCITY) + gained * real::<R>(0.5)) * lasts,
            lever_arm_m: turned * arm,
            ..self.fix
        };
        let mut prediction: Prediction<R, N, 3> = fix.predict(filter);
        let measured: Matrix3<R> = prediction.jacobian.get(POSITION);
        let by_fix = core::mem::replace(&mut prediction.jacobian, Jacobian::zeros());
        prediction.jacobian = by_fix
            .with(VELOCITY, measured * lasts)
            .with(self.offset, measured * attitude * turned)
            .with(self.clock, measured * velocity);
        prediction
    }
}
