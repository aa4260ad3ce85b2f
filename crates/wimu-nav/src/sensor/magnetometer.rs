//! Magnetic field against a reference, with the local disturbance as a Gauss–Markov state. Equation (123).

use nalgebra::{Matrix1, Matrix3, RealField, RowVector3, Vector3};

use super::{Measurement, Prediction, SecondOrder};
use crate::filter::Filter;
use crate::process::GaussMarkov;
use crate::rotation::real;
use crate::state::{ATTITUDE, Block, HEADING, Jacobian, Layout, LayoutFull, Role};

/// A magnetometer: its noise and the field that it measures.
#[derive(Clone, Copy, Debug)]
pub struct Magnetometer<R> {
    /// Disturbance, µT, navigation frame.
    pub disturbance: Block<3>,
    /// Noise of a component of one reading, µT.
    pub noise_ut: R,
    /// Standard deviation of the disturbance, µT, a component, and its correlation time, s.
    pub disturbance_ut: R,
    /// See [`disturbance_ut`](Self::disturbance_ut).
    pub disturbance_time_s: R,
}

impl<R: RealField + Copy> Magnetometer<R> {
    /// Claims the disturbance: three states. Noise and disturbance as measured on consumer MEMS recordings indoors.
    ///
    /// # Errors
    /// [`LayoutFull`].
    pub fn claim<const N: usize>(layout: &mut Layout<R, N>) -> Result<Self, LayoutFull> {
        let disturbance_ut = real::<R>(3.0);
        Ok(Self {
            disturbance: layout.claim(Role::Estimated, [disturbance_ut; 3])?,
            noise_ut: real(1.0),
            disturbance_ut,
            disturbance_time_s: real(10.0),
        })
    }

    /// A step of the disturbance.
    pub fn step(&self, step_s: R) -> GaussMarkov<R> {
        GaussMarkov {
            block: self.disturbance,
            deviation: self.disturbance_ut,
            time_s: self.disturbance_time_s,
            step_s,
        }
    }
}

/// A reading: m = Cᵀ (reference + d).
#[derive(Clone, Copy, Debug)]
pub struct MagneticField<'a, R> {
    /// The sensor.
    pub sensor: &'a Magnetometer<R>,
    /// µT, body frame.
    pub field_ut: Vector3<R>,
    /// Field without disturbance, µT, navigation frame.
    pub reference_ut: Vector3<R>,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 3> for MagneticField<'_, R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 3> {
        let disturbance = self.sensor.disturbance;
        let field = self.reference_ut + filter.state.get(disturbance);
        let to_body = filter.state.attitude.matrix().transpose();
        let second = SecondOrder::of(filter, &field, disturbance);
        let noise = self.sensor.noise_ut * self.sensor.noise_ut;
        Prediction {
            innovation: self.field_ut - to_body * (field + second.mean),
            jacobian: Jacobian::zeros()
                .with(ATTITUDE, to_body * field.cross_matrix())
                .with(disturbance, to_body),
            covariance: Matrix3::identity() * noise
                + to_body * second.covariance * to_body.transpose(),
        }
    }
}

/// The horizontal direction of a reading, for the heading alone: iron indoors would tilt a unit whose gyroscope and rests
/// know its tilt better. Uncertainty of the tilt is noise of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FieldHeading<'a, R>(pub &'a MagneticField<'a, R>);

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 1> for FieldHeading<'_, R> {
    /// Where the reference is vertical there is no heading, and the measurement has no effect.
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 1> {
        let MagneticField { sensor, field_ut, reference_ut } = self.0;
        let expected = reference_ut + filter.state.get(sensor.disturbance);
        let found = filter.state.attitude * field_ut;
        let level = expected.x * expected.x + expected.y * expected.y;
        if level < sensor.noise_ut * sensor.noise_ut {
            return Prediction {
                innovation: Matrix1::zeros(),
                jacobian: Jacobian::zeros(),
                covariance: Matrix1::identity(),
            };
        }
        let across = expected.x * found.y - expected.y * found.x;
        let along = expected.x * found.x + expected.y * found.y;
        let tilt = expected.xy() * (expected.z / level);
        let tilt_covariance = filter.covariance(ATTITUDE.part::<2, 0>());
        let noise = sensor.noise_ut * sensor.noise_ut / level;
        let derivative = RowVector3::new(-expected.y, expected.x, R::zero()) / level;
        Prediction {
            innovation: Matrix1::new(across.atan2(along)),
            jacobian: Jacobian::zeros()
                .with(HEADING, Matrix1::new(-R::one()))
                .with(sensor.disturbance, derivative),
            covariance: Matrix1::new(noise + tilt.dot(&(tilt_covariance * tilt))),
        }
    }
}
