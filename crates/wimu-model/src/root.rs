//! Square roots, digit by digit: correctly rounded like those of `libm`, in a sixth of the
//! flash.
//!
//! Without a hardware instruction a square root takes about a thousand instructions. Some are
//! needed at a rest and when parameters are applied, none per sample.

/// The square root of `x`, rounded down.
pub const fn isqrt(x: u64) -> u64 {
    digits(x, 32)
}

/// The square root of `x`, rounded to nearest: identical to `libm`. NaN for negative numbers.
pub fn sqrt(x: f64) -> f64 {
    const MANTISSA: u32 = 52;
    const HIDDEN: u64 = 1 << MANTISSA;
    const BIAS: i32 = 1023;
    if x < 0.0 {
        return f64::NAN;
    }
    if x == 0.0 || !x.is_finite() {
        return x;
    }
    let bits = x.to_bits();
    let (mut exponent, mut mantissa) = ((bits >> MANTISSA) as i32, bits & (HIDDEN - 1));
    if exponent == 0 {
        // A subnormal number.
        let shift = mantissa.leading_zeros() - (63 - MANTISSA);
        mantissa <<= shift;
        exponent = 1 - shift as i32;
    } else {
        mantissa |= HIDDEN;
    }
    // x = mantissa · 2^(exponent − 52), its exponent even.
    exponent -= BIAS;
    mantissa <<= exponent & 1;
    // The last of the 54 digits only rounds: no root lies halfway between two numbers of 53 digits.
    let root = digits(mantissa << 10, 54).div_ceil(2);
    // A root of 2⁵³ carries into the exponent.
    let exponent = ((exponent >> 1) + BIAS) as u64;
    f64::from_bits((exponent << MANTISSA) + (root - HIDDEN))
}

/// The first `count` binary digits of the square root of a number whose first 64 bits are
/// `radicand` and whose other bits are zero.
const fn digits(mut radicand: u64, count: u32) -> u64 {
    let (mut rest, mut root) = (0, 0);
    let mut digit = 0;
    while digit < count {
        rest = rest << 2 | radicand >> 62;
        radicand <<= 2;
        root <<= 1;
        if rest > root << 1 {
            rest -= root << 1 | 1;
            root |= 1;
        }
        digit += 1;
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_ends_of_the_numbers_have_their_roots() {
        for x in [
            0.0,
            -0.0,
            1.0,
            2.0,
            4.0,
            f64::MIN_POSITIVE,
            f64::MAX,
            f64::INFINITY,
            f64::from_bits(1),
            f64::from_bits((1 << 52) - 1),
            1.0 - f64::EPSILON / 2.0,
            4.0 - 2.0 * f64::EPSILON,
        ] {
            assert_eq!(sqrt(x).to_bits(), libm::sqrt(x).to_bits(), "{x:e}");
        }
        assert!(sqrt(-1.0).is_nan() && sqrt(f64::NAN).is_nan());
        for x in [0, 1, 2, 3, 4, 8, 9, u64::MAX, u64::MAX - 1, 1 << 62, (1 << 62) - 1] {
            assert_eq!(isqrt(x), x.isqrt(), "{x}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn a_root_is_that_of_libm_bit_for_bit(bits in 0..f64::INFINITY.to_bits()) {
            let x = f64::from_bits(bits);
            prop_assert_eq!(sqrt(x).to_bits(), libm::sqrt(x).to_bits());
        }

        #[test]
        fn the_root_of_a_square_and_of_its_neighbours_is_that_of_libm(
            y in 1.0..2.0_f64,
            away in -2_i64..=2,
        ) {
            let x = f64::from_bits((y * y).to_bits().wrapping_add_signed(away));
            prop_assert_eq!(sqrt(x).to_bits(), libm::sqrt(x).to_bits());
        }

        #[test]
        fn a_whole_root_is_that_of_the_language(x: u64, less in 0..64_u32) {
            prop_assert_eq!(isqrt(x >> less), (x >> less).isqrt());
        }
    }
}
