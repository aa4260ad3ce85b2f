//! What a batch can hold.

use wimu_model::{AngularRateQ20, Counts, SpecificForceQ16, WideCounts};

use super::{ESCAPE, MAX_BATCH};

/// The type of the samples of a batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Stream {
    /// [`Counts`] or [`WideCounts`]: LSB, sensor axes.
    Raw,
    /// [`SpecificForceQ16`], 2⁻¹⁶ m/s², and [`AngularRateQ20`], 2⁻²⁰ rad/s: body axes.
    Corrected,
}

/// W: bits of values and residuals.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Width {
    W16,
    W20,
    W32,
}

impl Width {
    pub(super) const fn bits(self) -> usize {
        match self {
            Self::W16 => 16,
            Self::W20 => 20,
            Self::W32 => 32,
        }
    }

    /// F: bits of a number below W.
    pub(super) const fn field(self) -> u32 {
        match self {
            Self::W16 => 4,
            Self::W20 | Self::W32 => 5,
        }
    }

    /// The largest Rice parameter that the encoder uses: below W, and short enough that a code with the
    /// longest prefix has at most 32 bits.
    pub(super) const fn largest_k(self) -> u32 {
        match self {
            Self::W16 => 15,
            Self::W20 => 19,
            Self::W32 => 32 - ESCAPE,
        }
    }

    /// Whether a folded residual of a batch with this sum may exceed W bits.
    pub(super) const fn can_be_exceeded_in(self, sum: u32) -> bool {
        match self {
            Self::W16 | Self::W20 => sum >> self.bits() != 0,
            Self::W32 => false,
        }
    }

    /// `value` modulo 2^W, −2^(W−1) to 2^(W−1) − 1.
    #[inline]
    pub(super) const fn wrap(self, value: i32) -> i32 {
        let spare = 32 - self.bits() as u32;
        (value << spare) >> spare
    }
}

mod sealed {
    use super::Width;

    /// Three axes.
    pub trait Axes: Copy {
        const WIDTH: Width;

        /// X, Y or Z by its index; indices above 2 give Z, which avoids a bounds check.
        fn value(&self, axis: usize) -> i32;
    }

    pub trait Sealed {
        const WIDTH: Width;
    }
}
use sealed::Axes;
pub(super) use sealed::Sealed;

/// A sample of a batch: [`Counts`], [`WideCounts`] or [`SpecificForceQ16`] of an accelerometer, or a pair
/// with the same of a gyroscope, whose corrected samples are [`AngularRateQ20`].
pub trait Sample: Copy + Sealed {
    /// The stream that such samples make.
    const STREAM: Stream;

    /// Number of axes: 3, or 6 with a gyroscope.
    const AXES: usize;

    /// Whether these are counts of 20 bits.
    const WIDE: bool;

    /// Most samples in a batch.
    const MOST: usize = MAX_BATCH * 3 / Self::AXES;

    /// X, Y, Z of the accelerometer, then of the gyroscope, by index; greater indices give the last. Counts
    /// outside 20 bits are clamped.
    fn axis(&self, axis: usize) -> i32;
}

macro_rules! three_axes {
    ($($axes:ty: $width:ident, $value:expr;)+) => {$(
        impl Axes for $axes {
            const WIDTH: Width = Width::$width;

            #[inline]
            fn value(&self, axis: usize) -> i32 {
                $value(self.0[axis.min(2)])
            }
        }
    )+};
}

three_axes! {
    Counts: W16, i32::from;
    WideCounts: W20, |count: i32| count.clamp(WideCounts::MIN, WideCounts::MAX);
    SpecificForceQ16: W32, core::convert::identity;
    AngularRateQ20: W32, core::convert::identity;
}

macro_rules! samples {
    ($($force:ty, $rate:ty: $stream:ident;)+) => {$(
        impl Sealed for $force {
            const WIDTH: Width = <$force as Axes>::WIDTH;
        }

        impl Sample for $force {
            const STREAM: Stream = Stream::$stream;
            const AXES: usize = 3;
            const WIDE: bool = matches!(<$force as Axes>::WIDTH, Width::W20);

            #[inline]
            fn axis(&self, axis: usize) -> i32 {
                self.value(axis)
            }
        }

        impl Sealed for ($force, $rate) {
            const WIDTH: Width = <$force as Axes>::WIDTH;
        }

        impl Sample for ($force, $rate) {
            const STREAM: Stream = Stream::$stream;
            const AXES: usize = 6;
            const WIDE: bool = <$force as Sample>::WIDE;

            #[inline]
            fn axis(&self, axis: usize) -> i32 {
                match axis {
                    0..3 => self.0.value(axis),
                    _ => self.1.value(axis - 3),
                }
            }
        }
    )+};
}

samples! {
    Counts, Counts: Raw;
    WideCounts, WideCounts: Raw;
    SpecificForceQ16, AngularRateQ20: Corrected;
}
