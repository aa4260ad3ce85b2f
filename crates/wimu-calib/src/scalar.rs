//! Scalar types of what a device holds for as long as it runs.

use crate::linear::Real;

/// f32 or f64.
pub trait Scalar: Real {}

impl Scalar for f32 {}
impl Scalar for f64 {}
