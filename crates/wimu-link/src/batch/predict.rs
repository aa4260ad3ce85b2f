//! Predictors and residuals: equations (21) and (22).

use super::MAX_BATCH;

/// Fraction bits of the mean's predictor.
const MEAN_BITS: u32 = 4;

/// How an axis is coded.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Coding {
    Fixed = 0,
    Mean = 1,
    Linear = 3,
}

impl Coding {
    /// `None` for an unused number.
    pub(super) fn from_bits(bits: u32) -> Option<Self> {
        match bits {
            0 => Some(Self::Fixed),
            1 => Some(Self::Mean),
            3 => Some(Self::Linear),
            _ => None,
        }
    }
}

/// A predictor of an axis: equation (21).
pub(super) trait Predictor: Copy {
    fn of(first: i32) -> Self;

    fn predict(&self) -> i32;

    /// Takes the next value; `weight` is one of [`MEAN_WEIGHTS`].
    fn add(&mut self, value: i32, weight: i32);

    /// The same for the predicted value plus `residual`, without that sum.
    fn advance(&mut self, residual: i32, weight: i32);
}

impl Predictor for Mean {
    #[inline]
    fn of(first: i32) -> Self {
        Mean::of(first)
    }

    #[inline]
    fn predict(&self) -> i32 {
        self.rounded()
    }

    #[inline]
    fn add(&mut self, value: i32, weight: i32) {
        let residual = value.wrapping_sub(self.rounded());
        self.advance(residual, weight);
    }

    #[inline]
    fn advance(&mut self, residual: i32, weight: i32) {
        self.0 = self.0.wrapping_add(residual.wrapping_mul(weight));
    }
}

/// Linear extrapolation from the two previous values.
#[derive(Clone, Copy)]
pub(super) struct Linear {
    previous: i32,
    slope: i32,
}

impl Predictor for Linear {
    #[inline]
    fn of(first: i32) -> Self {
        Self { previous: first, slope: 0 }
    }

    #[inline]
    fn predict(&self) -> i32 {
        self.previous.wrapping_add(self.slope)
    }

    #[inline]
    fn add(&mut self, value: i32, _weight: i32) {
        self.slope = value.wrapping_sub(self.previous);
        self.previous = value;
    }

    #[inline]
    fn advance(&mut self, residual: i32, _weight: i32) {
        self.slope = self.slope.wrapping_add(residual);
        self.previous = self.previous.wrapping_add(self.slope);
    }
}

/// Running mean, 2^−4 of a value's LSB, plus half a value's LSB, so that truncation rounds.
#[derive(Clone, Copy)]
pub(super) struct Mean(i32);

impl Mean {
    #[inline]
    pub(super) fn of(first: i32) -> Self {
        Self((first << MEAN_BITS).wrapping_add(1 << (MEAN_BITS - 1)))
    }

    #[inline]
    pub(super) fn rounded(self) -> i32 {
        self.0 >> MEAN_BITS
    }

    /// Corrects the mean by 2^(`gain` − 4) of a residual.
    #[inline]
    pub(super) fn correct(&mut self, residual: i32, gain: u8) {
        self.0 = self.0.wrapping_add(residual.wrapping_shl(u32::from(gain)));
    }
}

/// The gain of a mean of `count` samples, including the new one: 4 − ⌊log2 `count`⌋, at least 0. The mean of
/// 32 samples is the last and not used for a prediction.
const fn mean_gain(count: u32) -> u8 {
    MEAN_BITS.saturating_sub(count.ilog2()) as u8
}

/// A residual, mapped to an unsigned number: equation (22).
#[inline]
pub(super) fn fold(residual: i32) -> u32 {
    ((residual << 1) ^ (residual >> 31)) as u32
}

/// The inverse of [`fold`].
#[inline]
pub(super) fn unfold(folded: u32) -> i32 {
    (folded >> 1) as i32 ^ -((folded & 1) as i32)
}

/// The mean's gains for the samples after the first.
pub(super) const MEAN_GAINS: [u8; MAX_BATCH - 1] = {
    let mut gains = [0; MAX_BATCH - 1];
    let mut index = 0;
    while index < gains.len() {
        gains[index] = mean_gain(index as u32 + 2);
        index += 1;
    }
    gains
};

/// The gains as factors, for the decoder: 2 to the power of the gain.
pub(super) static MEAN_WEIGHTS: [i32; MAX_BATCH - 1] = {
    let mut weights = [0; MAX_BATCH - 1];
    let mut index = 0;
    while index < weights.len() {
        weights[index] = 1 << MEAN_GAINS[index];
        index += 1;
    }
    weights
};
