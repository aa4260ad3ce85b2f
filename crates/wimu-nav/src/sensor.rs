//! Sensors: each is one file with the prediction of its measurement.

mod accelerometer;
mod anchor;
mod angular_rate;
mod antenna;
mod common_field;
mod gravity;
mod heading;
mod joint;
mod line_of_sight;
mod magnetometer;
mod multi_range;
mod non_holonomic;
mod odometer;
mod position;
mod range;
mod reading;
mod reduced_array;
mod second_order;
mod velocity;
mod zero;

pub use accelerometer::SpecificForce;
pub use anchor::{Anchor, CorrelatedErrors, RangeErrors};
pub use angular_rate::ZeroAngularRate;
pub use antenna::Antenna;
pub use common_field::CommonField;
pub use gravity::Gravity;
pub use heading::Heading;
pub use joint::{CommonAxis, CommonPoint};
pub use line_of_sight::{LineOfSight, NonLineOfSight};
pub(crate) use magnetometer::FieldHeading;
pub use magnetometer::{MagneticField, Magnetometer};
pub use multi_range::{Transfer, TransferModel};
pub use non_holonomic::{ForwardAxis, Mounting, NonHolonomic};
pub use odometer::Odometer;
pub use range::Range;
pub use reading::Reading;
pub use velocity::{Velocity, recover};
pub use zero::{VerticalRate, Zero};

pub use position::Position;
pub use reduced_array::{ArrayNoise, Prior, ReducedArray};
pub(crate) use second_order::SecondOrder;

use nalgebra::{SMatrix, SVector};

use crate::filter::Filter;
use crate::state::Jacobian;

/// Measured minus predicted value, derivative of the predicted value, and covariance of the noise.
#[derive(Clone, Debug)]
pub struct Prediction<R, const N: usize, const M: usize> {
    /// Measured minus predicted value.
    pub innovation: SVector<R, M>,
    /// Derivative of the predicted value with respect to the error of the state (true minus estimated): H of (118).
    pub jacobian: Jacobian<R, M, N>,
    /// Covariance of the noise.
    pub covariance: SMatrix<R, M, M>,
}

/// A measurement of `M` values by a filter with `N` states.
pub trait Measurement<R, const N: usize, const M: usize> {
    /// Prediction from the state and covariance before the update.
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, M>;
}
