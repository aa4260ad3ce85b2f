//! The matrix product per sample in integers, implemented in two ways with identical results:
//! equation (3) of docs/reference/equations. They differ only in speed.

// A target uses one of the two.
#![cfg_attr(not(test), allow(dead_code))]

use crate::{CorrectorParts, WideCounts};

/// Cortex-M0 and M0+ have only a 32-bit product of 32-bit factors. They are also the ARM cores
/// without atomic read-modify-write, which is the property that a target declares.
#[cfg(all(target_arch = "arm", not(target_has_atomic = "32")))]
pub(crate) use self::Short as Kernel;

#[cfg(not(all(target_arch = "arm", not(target_has_atomic = "32"))))]
pub(crate) use self::Long as Kernel;

/// Bits of a coefficient's low part.
pub(crate) const LOW_BITS: u32 = 15;

/// Coefficients and offset of a kernel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Fixed {
    /// Fraction bits of the high parts, 3 to 14.
    pub(crate) shift: u32,
    /// Coefficients, rows, 2^−(shift + 15) output LSB per count.
    pub(crate) coefficients: [[i32; 3]; 3],
    /// Offset and rounding in the unit of the high parts.
    pub(crate) offset: [i32; 3],
}

impl From<CorrectorParts> for Fixed {
    fn from(parts: CorrectorParts) -> Self {
        let CorrectorParts { shift, coefficients, offset } = parts;
        Self { shift: shift.into(), coefficients, offset }
    }
}

/// Largest magnitude of an output from wide counts, LSB: the integrator adds two samples in 32 bits.
const WIDE_LIMIT: i64 = 1 << 29;

/// An output axis for counts of 20 bits: whole coefficients and `offset` in 2^−`bits` LSB. Counts and the
/// result are clamped.
#[inline]
fn wide(coefficients: [i32; 3], offset: i64, bits: u32, counts: WideCounts) -> i32 {
    let counts = counts.clamped().0;
    let mut sum = offset;
    for axis in 0..3 {
        sum += i64::from(coefficients[axis]) * i64::from(counts[axis]);
    }
    (sum >> bits).clamp(-WIDE_LIMIT, WIDE_LIMIT) as i32
}

/// high · 2¹⁵ + low.
#[inline]
pub(crate) const fn whole(high: i32, low: i32) -> i32 {
    (high << LOW_BITS) + low
}

/// A coefficient as high · 2¹⁵ + low: the high part of 16 bits, to nearest, and the low part.
const fn split(whole: i32) -> (i32, i32) {
    let high = (whole + (1 << (LOW_BITS - 1))) >> LOW_BITS;
    (high, whole - (high << LOW_BITS))
}

/// Kernel with nine multiplications of 32 by 32 to 64 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Long {
    /// 2⁻³² output LSB.
    offset: [i64; 3],
    /// Whole coefficients, 2^−(shift + 15) output LSB per count, by column: the three sums are
    /// independent, so that successive multiplications do not wait for each other.
    columns: [[i32; 3]; 3],
    /// 2^(17 − shift): scales counts so that products are in 2⁻³² output LSB and the result is the
    /// upper word of the sum.
    scale: i32,
}

impl Long {
    pub(crate) const fn new(fixed: &Fixed) -> Self {
        let mut kernel = Self {
            offset: [0; 3],
            columns: [[0; 3]; 3],
            scale: 1 << (32 - LOW_BITS - fixed.shift),
        };
        let mut axis = 0;
        while axis < 3 {
            kernel.offset[axis] = (fixed.offset[axis] as i64) << (32 - fixed.shift);
            let [x, y, z] = fixed.coefficients[axis];
            kernel.columns[0][axis] = x;
            kernel.columns[1][axis] = y;
            kernel.columns[2][axis] = z;
            axis += 1;
        }
        kernel
    }

    pub(crate) fn fixed(&self) -> Fixed {
        let shift = 32 - LOW_BITS - self.scale.trailing_zeros();
        Fixed {
            shift,
            coefficients: [0, 1, 2].map(|axis| self.columns.map(|column| column[axis])),
            offset: self.offset.map(|o| (o >> (32 - shift)) as i32),
        }
    }

    #[inline]
    pub(crate) fn apply(&self, counts: [i16; 3]) -> [i32; 3] {
        let mut sums = self.offset;
        for (column, count) in self.columns.iter().zip(counts) {
            let count = i64::from(i32::from(count) * self.scale);
            for axis in 0..3 {
                sums[axis] += i64::from(column[axis]) * count;
            }
        }
        sums.map(|sum| (sum >> 32) as i32)
    }

    pub(crate) fn apply_wide(&self, counts: WideCounts) -> [i32; 3] {
        // Without the scale the products are in 2^−(shift + 15) output LSB.
        let excess = self.scale.trailing_zeros();
        core::array::from_fn(|axis| {
            let row = self.columns.map(|column| column[axis]);
            wide(row, self.offset[axis] >> excess, 32 - excess, counts)
        })
    }
}

/// Kernel with eighteen multiplications of 32 by 32 to 32 bits, each of a count and half a
/// coefficient.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Short {
    rows: [Row; 3],
    shift: u32,
}

/// One output axis. Parts have 32 bits although 16 suffice: loading half words takes longer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Row {
    low: [i32; 3],
    high: [i32; 3],
    offset: i32,
}

impl Short {
    pub(crate) const fn new(fixed: &Fixed) -> Self {
        const ROW: Row = Row { low: [0; 3], high: [0; 3], offset: 0 };
        let mut kernel = Self { rows: [ROW; 3], shift: fixed.shift };
        let mut axis = 0;
        while axis < 3 {
            let row = &mut kernel.rows[axis];
            row.offset = fixed.offset[axis];
            let mut i = 0;
            while i < 3 {
                (row.high[i], row.low[i]) = split(fixed.coefficients[axis][i]);
                i += 1;
            }
            axis += 1;
        }
        kernel
    }

    pub(crate) fn fixed(&self) -> Fixed {
        let whole = |row: &Row| [0, 1, 2].map(|i| whole(row.high[i], row.low[i]));
        Fixed {
            shift: self.shift,
            coefficients: [0, 1, 2].map(|axis| whole(&self.rows[axis])),
            offset: [0, 1, 2].map(|axis| self.rows[axis].offset),
        }
    }

    #[inline]
    pub(crate) fn apply(&self, counts: [i16; 3]) -> [i32; 3] {
        let c = counts.map(i32::from);
        let product = |k: &[i32; 3]| k[0] * c[0] + k[1] * c[1] + k[2] * c[2];
        let output = |row: &Row| {
            let low = product(&row.low) >> LOW_BITS;
            (low + row.offset + product(&row.high)) >> self.shift
        };
        [output(&self.rows[0]), output(&self.rows[1]), output(&self.rows[2])]
    }

    pub(crate) fn apply_wide(&self, counts: WideCounts) -> [i32; 3] {
        [0, 1, 2].map(|axis| {
            let row = &self.rows[axis];
            let coefficients = [0, 1, 2].map(|i| whole(row.high[i], row.low[i]));
            let offset = i64::from(row.offset) << LOW_BITS;
            wide(coefficients, offset, self.shift + LOW_BITS, counts)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    prop_compose! {
        /// Of all sizes whose sums fit 32 bits.
        fn fixed()(
            shift in 3..=14_u32,
            parts in prop::array::uniform9((-21_500..=21_500, -16_384..=16_384)),
            offset in prop::array::uniform3(-30_000_000..=30_000_000),
        ) -> Fixed {
            let coefficient = |(high, low)| whole(high, low);
            Fixed {
                shift,
                coefficients: [0, 3, 6].map(|i| [parts[i], parts[i + 1], parts[i + 2]].map(coefficient)),
                offset,
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn both_ways_agree_on_every_input(fixed in fixed(), counts: [i16; 3], wide: [i32; 3]) {
            let (long, short) = (Long::new(&fixed), Short::new(&fixed));
            prop_assert_eq!((long.fixed(), short.fixed()), (fixed, fixed));
            let extreme = counts.map(|c| if c < 0 { i16::MIN } else { i16::MAX });
            for counts in [counts, extreme] {
                let narrow = long.apply(counts);
                prop_assert_eq!(narrow, short.apply(counts));
                prop_assert_eq!(narrow, long.apply_wide(WideCounts(counts.map(i32::from))));
            }
            for counts in [wide, wide.map(|c| c >> 12), wide.map(|c| c | i32::MAX)] {
                let counts = WideCounts(counts);
                prop_assert_eq!(long.apply_wide(counts), short.apply_wide(counts));
            }
        }
    }
}
