//! Direction: gravity, magnetic field and heading, with the second-order terms of a vector that is measured in the body frame.
//! Equations (123), (124), (131), (171) and (194).
//!
//! With the attitude error θ and the error e of the vector u, both in the navigation frame, exp(−θ) (u + e) has the
//! second-order part ½ θ × (θ × u) − θ × e. With P = cov(θ) and c = cov(θ, e), its mean is
//!
//! ```text
//! ½ (P − tr(P) 1) u − [c₂₃ − c₃₂, c₃₁ − c₁₃, c₁₂ − c₂₁]
//! ```
//!
//! With 11° of tilt the mean of g (1 − cos θ) is 0.18 m/s², and a first-order filter takes it for an acceleration.

use nalgebra::{Matrix1, Matrix2, Matrix3, RowVector3, SMatrix, Vector3};

use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::process::{GaussMarkov, StrapdownBlocks, by_elements};
use crate::rotation::yaw;
use crate::state::{ATTITUDE, Block, HEADING, Layout, Role};

/// Mean and covariance of the second-order part, navigation frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SecondOrder {
    pub mean: Vector3<f64>,
    pub covariance: Matrix3<f64>,
}

impl SecondOrder {
    /// Of a vector whose error is that of a block.
    ///
    /// The covariance is the outer product of the first mean plus tr(P) cov(e): wider than that of Gaussian errors, and
    /// better in fast motion (score_navigation).
    pub fn of(filter: &Filter, vector: &Vector3<f64>, error: Block<3>) -> Self {
        let attitude = filter.covariance(ATTITUDE);
        let cross = filter.cross_covariance(ATTITUDE, error);
        let trace = attitude.trace();
        let rotation = (attitude - Matrix3::identity() * trace) * vector * 0.5;
        let c = |i: usize, j: usize| cross[(i, j)] - cross[(j, i)];
        Self {
            mean: rotation - Vector3::new(c(1, 2), c(2, 0), c(0, 1)),
            covariance: rotation * rotation.transpose() + filter.covariance(error) * trace,
        }
    }
}

/// A reading.
#[derive(Clone, Copy, Debug)]
pub struct SpecificForce {
    /// m/s², body frame.
    pub force_mps2: Vector3<f64>,
    /// Acceleration, m/s², navigation frame.
    pub acceleration: Block<3>,
    /// Bias, m/s², body frame.
    pub bias: Block<3>,
    /// Gravity, m/s².
    pub gravity_mps2: f64,
    /// Standard deviation of a component, m/s².
    pub deviation_mps2: f64,
}

impl Measurement for SpecificForce {
    fn predict(&self, filter: &Filter) -> Prediction {
        let force = filter.state.get(self.acceleration) + Vector3::z() * self.gravity_mps2;
        let to_body = filter.state.attitude.matrix().transpose();
        let second = SecondOrder::of(filter, &force, self.acceleration);
        let predicted = to_body * (force + second.mean) + filter.state.get(self.bias);
        let noise = self.deviation_mps2 * self.deviation_mps2;
        Prediction::new(
            self.force_mps2 - predicted,
            Matrix3::identity() * noise + to_body * second.covariance * to_body.transpose(),
        )
        .by(ATTITUDE, to_body * force.cross_matrix())
        .by(self.acceleration, to_body)
        .by(self.bias, Matrix3::identity())
    }
}

/// Mean specific force at a rest.
#[derive(Clone, Copy, Debug)]
pub struct Gravity<'a> {
    /// m/s², body frame.
    pub force_mps2: Vector3<f64>,
    /// States of the strapdown model.
    pub blocks: &'a StrapdownBlocks,
    /// Gravity, m/s².
    pub gravity_mps2: f64,
    /// Standard deviation of a component, m/s²: acceleration of a rest.
    pub deviation_mps2: f64,
}

impl Measurement for Gravity<'_> {
    fn predict(&self, filter: &Filter) -> Prediction {
        let to_navigation = *filter.state.attitude.matrix();
        let force = self.force_mps2 - filter.state.get(self.blocks.accelerometer_bias);
        let up = to_navigation * force;
        let noise = Matrix3::from_diagonal_element(self.deviation_mps2 * self.deviation_mps2);
        Prediction::new(Vector3::z() * self.gravity_mps2 - up, noise)
            .by(ATTITUDE, -up.cross_matrix())
            .by(self.blocks.accelerometer_bias, -to_navigation)
            .by_some(self.blocks.accelerometer_matrix, -by_elements(&to_navigation, &force))
    }
}

/// A magnetometer: its noise and the field that it measures.
#[derive(Clone, Copy, Debug)]
pub struct Magnetometer {
    /// Disturbance, µT, navigation frame.
    pub disturbance: Block<3>,
    /// Noise of a component of one reading, µT.
    pub noise_ut: f64,
    /// Standard deviation of the disturbance, µT, a component, and its correlation time, s.
    pub disturbance_ut: f64,
    /// See [`disturbance_ut`](Self::disturbance_ut).
    pub disturbance_time_s: f64,
}

impl Magnetometer {
    /// Claims the disturbance: three states. Noise and disturbance as measured on consumer MEMS recordings indoors.
    pub fn claim(layout: &mut Layout) -> Self {
        let disturbance_ut = 3.0;
        Self {
            disturbance: layout.claim(Role::Estimated, [disturbance_ut; 3]),
            noise_ut: 1.0,
            disturbance_ut,
            disturbance_time_s: 10.0,
        }
    }

    /// A step of the disturbance.
    pub fn step(&self, step_s: f64) -> GaussMarkov {
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
pub struct MagneticField<'a> {
    /// The sensor.
    pub sensor: &'a Magnetometer,
    /// µT, body frame.
    pub field_ut: Vector3<f64>,
    /// Field without disturbance, µT, navigation frame.
    pub reference_ut: Vector3<f64>,
}

impl Measurement for MagneticField<'_> {
    fn predict(&self, filter: &Filter) -> Prediction {
        let disturbance = self.sensor.disturbance;
        let field = self.reference_ut + filter.state.get(disturbance);
        let to_body = filter.state.attitude.matrix().transpose();
        let second = SecondOrder::of(filter, &field, disturbance);
        let noise = self.sensor.noise_ut * self.sensor.noise_ut;
        Prediction::new(
            self.field_ut - to_body * (field + second.mean),
            Matrix3::identity() * noise + to_body * second.covariance * to_body.transpose(),
        )
        .by(ATTITUDE, to_body * field.cross_matrix())
        .by(disturbance, to_body)
    }
}

/// The horizontal direction of a reading, for the heading alone: iron indoors would tilt a unit whose gyroscope and rests
/// know its tilt better. Uncertainty of the tilt is noise of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FieldHeading<'a>(pub &'a MagneticField<'a>);

impl Measurement for FieldHeading<'_> {
    /// Where the reference is vertical there is no heading, and the measurement has no effect.
    fn predict(&self, filter: &Filter) -> Prediction {
        let MagneticField { sensor, field_ut, reference_ut } = self.0;
        let expected = reference_ut + filter.state.get(sensor.disturbance);
        let found = filter.state.attitude * field_ut;
        let level = expected.x * expected.x + expected.y * expected.y;
        if level < sensor.noise_ut * sensor.noise_ut {
            return Prediction::new(Matrix1::zeros(), Matrix1::identity());
        }
        let across = expected.x * found.y - expected.y * found.x;
        let along = expected.x * found.x + expected.y * found.y;
        let tilt = expected.xy() * (expected.z / level);
        let tilt_covariance = filter.covariance(ATTITUDE.part::<2, 0>());
        let noise = sensor.noise_ut * sensor.noise_ut / level;
        let derivative = RowVector3::new(-expected.y, expected.x, 0.0) / level;
        Prediction::new(
            Matrix1::new(libm::atan2(across, along)),
            Matrix1::new(noise + tilt.dot(&(tilt_covariance * tilt))),
        )
        .by(HEADING, Matrix1::new(-1.0))
        .by(sensor.disturbance, derivative)
    }
}

/// Angle of the body x axis from east towards north.
#[derive(Clone, Copy, Debug)]
pub struct Heading {
    /// rad.
    pub heading_rad: f64,
    /// Its standard deviation, rad.
    pub deviation_rad: f64,
}

impl Measurement for Heading {
    /// Where body x is vertical there is no heading, and the measurement has no effect.
    fn predict(&self, filter: &Filter) -> Prediction {
        let attitude = &filter.state.attitude;
        let forward = attitude * Vector3::x();
        let level = forward.x * forward.x + forward.y * forward.y;
        let off = self.heading_rad - yaw(attitude);
        let derivative = if level > 1e-6 {
            RowVector3::new(-forward.x * forward.z / level, -forward.y * forward.z / level, 1.0)
        } else {
            RowVector3::zeros()
        };
        Prediction::new(
            Matrix1::new(libm::atan2(libm::sin(off), libm::cos(off))),
            Matrix1::new(self.deviation_rad * self.deviation_rad),
        )
        .by(ATTITUDE, derivative)
    }
}

/// An axis that both bodies have in common: C j₂ = j₁, by the two components across j₁.
#[derive(Clone, Copy, Debug)]
pub struct CommonAxis {
    /// Unit vector of the hinge axis in the axes of each unit.
    pub axes: [Block<3>; 2],
    /// Standard deviation of a component, rad: play of the hinge.
    pub deviation_rad: f64,
}

impl Measurement for CommonAxis {
    fn predict(&self, filter: &Filter) -> Prediction {
        let to_first = *filter.state.attitude.matrix();
        let [first, second] = self.axes.map(|axis| filter.state.get(axis));
        let second = to_first * second;
        let across = across(&first);
        Prediction::new(
            across * (first - second),
            Matrix2::from_diagonal_element(self.deviation_rad * self.deviation_rad),
        )
        .by(ATTITUDE, across * -second.cross_matrix())
        .by(self.axes[0], -across)
        .by(self.axes[1], across * to_first)
    }
}

/// Rows: two unit vectors at right angles to each other and to `axis`.
fn across(axis: &Vector3<f64>) -> SMatrix<f64, 2, 3> {
    let is_far = axis.x.abs() < axis.y.abs().max(axis.z.abs());
    let other = if is_far { Vector3::x() } else { Vector3::y() };
    let first = axis.cross(&other).normalize();
    let second = axis.cross(&first).normalize();
    SMatrix::from_rows(&[first.transpose(), second.transpose()])
}
