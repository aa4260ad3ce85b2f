//! f32 and f64 in one text, without any library in its signature.

use core::ops::{Add, AddAssign, Mul, Sub, SubAssign};

use crate::force;
use crate::parameter::Parameter;
use crate::terms::Theta;

/// f32 or f64: what is computed for every sample, or held for as long as a device runs, comes in both.
pub trait Scalar:
    sealed::Sealed
    + Copy
    + Default
    + PartialOrd
    + Into<f64>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + AddAssign
    + SubAssign
{
}

impl Scalar for f32 {}
impl Scalar for f64 {}

pub(crate) mod sealed {
    use super::{Parameter, Theta};

    pub trait Sealed: Sized {
        /// A sum of many.
        type Total: Total<Self>;

        /// The nearest to `x`.
        fn of(x: f64) -> Self;

        fn finite(self) -> bool;

        fn size(self) -> Self;

        /// As [`crate::force::magnitude`] has it.
        fn magnitude(
            theta: &Theta<Self>,
            output: [Self; 3],
            warmer: Self,
        ) -> Option<(Self, [Self; Parameter::COUNT])>;
    }

    /// A sum of so many numbers that its length must not cost it digits.
    pub trait Total<R>: Copy + core::fmt::Debug {
        const ZERO: Self;

        fn add(&mut self, x: R);

        /// With another sum.
        fn joined(self, other: Self) -> Self;

        /// This less another, near to it.
        fn less(self, other: Self) -> R;

        fn value(self) -> f64;
    }

    impl Total<f64> for f64 {
        const ZERO: Self = 0.0;

        fn add(&mut self, x: f64) {
            *self += x;
        }

        fn joined(self, other: Self) -> Self {
            self + other
        }

        fn less(self, other: Self) -> f64 {
            self - other
        }

        fn value(self) -> f64 {
            self
        }
    }

    /// A sum of f32 with what rounding took from it kept beside (Knuth's two-sum): 48 bits without f64.
    #[derive(Clone, Copy, Debug)]
    pub struct Long {
        sum: f32,
        rest: f32,
    }

    impl Total<f32> for Long {
        const ZERO: Self = Self {
            sum: 0.0,
            rest: 0.0,
        };

        fn add(&mut self, x: f32) {
            let sum = self.sum + x;
            let of_x = sum - self.sum;
            let rest = self.rest + ((self.sum - (sum - of_x)) + (x - of_x));
            // So that `rest` stays below the last digit of `sum`.
            self.sum = sum + rest;
            self.rest = rest - (self.sum - sum);
        }

        fn joined(mut self, other: Self) -> Self {
            self.add(other.rest);
            self.add(other.sum);
            self
        }

        fn less(self, other: Self) -> f32 {
            (self.sum - other.sum) + (self.rest - other.rest)
        }

        fn value(self) -> f64 {
            f64::from(self.sum) + f64::from(self.rest)
        }
    }
}

macro_rules! scalar {
    ($float:ty, $total:ty) => {
        impl sealed::Sealed for $float {
            type Total = $total;

            fn of(x: f64) -> Self {
                x as Self
            }

            fn finite(self) -> bool {
                self.is_finite()
            }

            fn size(self) -> Self {
                self.abs()
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

scalar!(f32, sealed::Long);
scalar!(f64, f64);
