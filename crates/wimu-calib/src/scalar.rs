//! f32 and f64 in one text, without any library in its signature.

use core::ops::{AddAssign, Mul, Sub, SubAssign};

use crate::force;
use crate::parameter::Parameter;
use crate::terms::Theta;

/// f32 or f64: what is held for as long as a device runs comes in both.
pub trait Scalar:
    sealed::Sealed
    + Copy
    + Default
    + Into<f64>
    + Mul<Output = Self>
    + Sub<Output = Self>
    + AddAssign
    + SubAssign
{
}

impl Scalar for f32 {}
impl Scalar for f64 {}

pub(crate) mod sealed {
    use super::{Parameter, Theta};

    pub trait Sealed: Sized {
        /// The nearest to `x`.
        fn of(x: f64) -> Self;

        /// As [`crate::force::magnitude`] has it.
        fn magnitude(
            theta: &Theta<Self>,
            output: [Self; 3],
            warmer: Self,
        ) -> Option<(Self, [Self; Parameter::COUNT])>;
    }
}

macro_rules! scalar {
    ($float:ty) => {
        impl sealed::Sealed for $float {
            fn of(x: f64) -> Self {
                x as Self
            }

            fn magnitude(
                theta: &Theta<Self>,
                output: [Self; 3],
                warmer: Self,
            ) -> Option<(Self, [Self; Parameter::COUNT])> {
                force::magnitude(theta, output, warmer)
            }
        }
    };
}

scalar!(f32);
scalar!(f64);
