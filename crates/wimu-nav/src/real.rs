//! The two floating-point types that the arithmetic is written for.

use nalgebra::RealField;

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}

/// f32 or f64. Sealed: it says which types work, it is not meant to be implemented.
pub trait Real: sealed::Sealed + RealField + Copy + Default {
    /// The same value in f64.
    fn to_f64(self) -> f64;
}

impl Real for f32 {
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    fn to_f64(self) -> f64 {
        self
    }
}
