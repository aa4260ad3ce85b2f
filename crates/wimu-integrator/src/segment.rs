//! Trapezoidal integration in integers: equations (4) to (6) of docs/reference/equations.

use core::sync::atomic::{Ordering, compiler_fence};

use wimu_model::{PeriodNs, SpecificForceQ16};

/// Specific force integrated twice in body axes over samples of constant period without a gap, from
/// zero velocity and position.
///
/// The sums are exact. With the period Δt, `velocity_sum` counts 2⁻¹⁷·Δt m/s and `position_sum`
/// 2⁻¹⁸·Δt² m, so that a step consists of additions and rounding happens only on output. The
/// integer part of gravity is subtracted from each sample, its remainder in closed form on output.
///
/// Holds ±9·10¹⁸ of these units: 35,000 km at 1 kHz, 350 km at 10 kHz. Samples must stay within
/// ±2²⁹ LSB, which [`Corrector`](wimu_model::Corrector) guarantees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Segment {
    /// Number of steps, one less than the samples.
    pub steps: u32,
    /// Σ (a_k + a_k+1), 2⁻¹⁷·Δt m/s, body axes.
    pub velocity_sum: [i64; 3],
    /// Σ (V_k + V_k+1), 2⁻¹⁸·Δt² m, body axes.
    pub position_sum: [i64; 3],
    /// The latest sample minus integer gravity, 2⁻¹⁶ m/s²; `None` before the first.
    pub previous: Option<[i32; 3]>,
}

impl Segment {
    /// Adds the next sample minus `whole_gravity`, both 2⁻¹⁶ m/s². The first sample only
    /// initialises the trapezoid. Returns whether a step was made.
    #[inline]
    pub fn step(&mut self, force: SpecificForceQ16, whole_gravity: [i32; 3]) -> bool {
        // Keeps the computations of the caller before the loads: registers are scarce.
        compiler_fence(Ordering::SeqCst);
        let a: [i32; 3] =
            core::array::from_fn(|axis| force.0[axis].wrapping_sub(whole_gravity[axis]));
        let Some(previous) = &mut self.previous else {
            self.previous = Some(a);
            return false;
        };
        for axis in 0..3 {
            let before = self.velocity_sum[axis];
            let after = before.wrapping_add(i64::from(previous[axis].wrapping_add(a[axis])));
            previous[axis] = a[axis];
            self.velocity_sum[axis] = after;
            self.position_sum[axis] =
                self.position_sum[axis].wrapping_add(before).wrapping_add(after);
            // One axis at a time: interleaved, as the compiler would do, they exceed the registers
            // and take a seventh more instructions on Cortex-M0+.
            compiler_fence(Ordering::SeqCst);
        }
        self.steps = self.steps.wrapping_add(1);
        true
    }

    /// Velocity in nm/s, body axes, with the remainder of gravity (2⁻³² m/s²) taken out.
    pub fn velocity_nmps(&self, remainder: [i32; 3], period: PeriodNs) -> [i64; 3] {
        core::array::from_fn(|axis| {
            let exact = (i128::from(self.velocity_sum[axis]) << 16)
                - product(2 * i128::from(remainder[axis]), self.steps.into());
            // 2⁻³³ Δt m/s → nm/s: Δt in ns is Δt · 10⁹.
            round_shift(product(exact, period.0.into()), 33)
        })
    }

    /// Position in nm, body axes, with the remainder of gravity (2⁻³² m/s²) taken out.
    pub fn position_nm(&self, remainder: [i32; 3], period: PeriodNs) -> [i64; 3] {
        core::array::from_fn(|axis| {
            let steps = i64::from(self.steps);
            let exact = (i128::from(self.position_sum[axis]) << 16)
                - product(product(2 * i128::from(remainder[axis]), steps), steps);
            let period = i64::from(period.0);
            // 2⁻³⁴ Δt² m → nm: Δt² in ns² is Δt² · 10¹⁸. Dividing in between keeps within 128
            // bits and costs less than 0.1 nm.
            round_shift(product(billionth(product(exact, period)), period), 34)
        })
    }

    /// The same samples integrated from a later start; `start` is the state of this segment there.
    /// Velocity and position are zero at the new start, and `change` is added to the integer
    /// gravity. Exact.
    pub fn since(&self, start: &Segment, change: [i32; 3]) -> Segment {
        let steps = self.steps.wrapping_sub(start.steps);
        let n = i64::from(steps);
        Segment {
            steps,
            velocity_sum: core::array::from_fn(|axis| {
                self.velocity_sum[axis]
                    .wrapping_sub(start.velocity_sum[axis])
                    .wrapping_sub(2 * i64::from(change[axis]).wrapping_mul(n))
            }),
            position_sum: core::array::from_fn(|axis| {
                self.position_sum[axis]
                    .wrapping_sub(start.position_sum[axis])
                    .wrapping_sub(start.velocity_sum[axis].wrapping_mul(2 * n))
                    .wrapping_sub(2 * i64::from(change[axis]).wrapping_mul(n).wrapping_mul(n))
            }),
            previous: self.previous.map(|previous| {
                core::array::from_fn(|axis| previous[axis].wrapping_sub(change[axis]))
            }),
        }
    }
}

/// `a` times `b`. Not inlined: 150 bytes of code on a microcontroller.
#[inline(never)]
pub(crate) fn product(a: i128, b: i64) -> i128 {
    a * i128::from(b)
}

/// `value` / 10⁹, rounded towards zero, in digits of 32 bits: the 128-bit division takes 1.3 KB of
/// code on a microcontroller, or 0.8 KB wherever the compiler unrolls it.
#[inline(never)]
pub(crate) fn billionth(value: i128) -> i128 {
    let magnitude = value.unsigned_abs();
    let mut quotient = 0;
    let mut rest = 0;
    for digit in [96, 64, 32, 0] {
        let part = (rest << 32) | u64::from((magnitude >> digit) as u32);
        quotient = (quotient << 32) | i128::from(part / 1_000_000_000);
        rest = part % 1_000_000_000;
    }
    if value < 0 { -quotient } else { quotient }
}

/// `value` · 2^−`bits`, rounded to nearest, saturating to 64 bits.
pub(crate) fn round_shift(value: i128, bits: u32) -> i64 {
    let rounded = (value + (1 << (bits - 1))) >> bits;
    rounded.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_billionth_is_that_of_a_division(value: i128, shift in 0..127_u32) {
            for value in [value, value >> shift] {
                prop_assert_eq!(billionth(value), value / 1_000_000_000);
            }
        }
    }
}
