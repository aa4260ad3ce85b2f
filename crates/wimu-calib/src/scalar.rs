//! Scalar types of structures that a device keeps in memory.

use crate::linear::Real;

/// f32 or f64.
pub trait Scalar: Real {}

impl Scalar for f32 {}
impl Scalar for f64 {}
