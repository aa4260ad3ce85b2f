//! Products of two numbers of 32 bits, in two ways with identical results.

/// `a` · `b`, exact.
///
/// Cortex-M0 and M0+ have only a 32-bit product of 32-bit factors; the call of the compiler's 64-bit
/// product takes more than twice the instructions of two short ones.
#[inline(always)]
pub fn product(a: i32, b: i32) -> i64 {
    #[cfg(all(target_arch = "arm", not(target_has_atomic = "32")))]
    return short(a, b);
    #[cfg(not(all(target_arch = "arm", not(target_has_atomic = "32"))))]
    return i64::from(a) * i64::from(b);
}

/// Four products of halves.
#[inline(always)]
#[cfg_attr(not(all(target_arch = "arm", not(target_has_atomic = "32"))), allow(dead_code))]
fn short(a: i32, b: i32) -> i64 {
    let (a_high, a_low) = (a >> 16, a & 0xffff);
    let (b_high, b_low) = (b >> 16, b & 0xffff);
    let low = (a_low as u32).wrapping_mul(b_low as u32);
    // Each sum fits: |high · low| ≤ 2¹⁵ (2¹⁶ − 1), and what is added is below 2¹⁶.
    let first = a_high.wrapping_mul(b_low).wrapping_add((low >> 16) as i32);
    let second = a_low.wrapping_mul(b_high).wrapping_add(first & 0xffff);
    let high = (a_high.wrapping_mul(b_high)).wrapping_add(first >> 16).wrapping_add(second >> 16);
    let low = ((second as u32) << 16) | (low & 0xffff);
    (i64::from(high) << 32) | i64::from(low)
}

/// Σ a b · 2⁻²⁸, to nearest, for magnitudes up to 2²⁹.
#[inline(always)]
pub fn scaled_dot(a: [i32; 3], b: [i32; 3]) -> i32 {
    #[cfg(all(target_arch = "arm", not(target_has_atomic = "32")))]
    return dot_short(a, b);
    #[cfg(not(all(target_arch = "arm", not(target_has_atomic = "32"))))]
    return dot_long(a, b);
}

#[inline(always)]
#[cfg_attr(all(target_arch = "arm", not(target_has_atomic = "32")), allow(dead_code))]
fn dot_long(a: [i32; 3], b: [i32; 3]) -> i32 {
    let sum =
        (0..3).fold(1_i64 << 27, |sum, i| sum.wrapping_add(i64::from(a[i]) * i64::from(b[i])));
    (sum >> 28) as i32
}

/// Halves of 15 bits: the sums of their products fit 32 bits.
#[inline(always)]
#[cfg_attr(not(all(target_arch = "arm", not(target_has_atomic = "32"))), allow(dead_code))]
fn dot_short(a: [i32; 3], b: [i32; 3]) -> i32 {
    let (mut high, mut middle, mut low) = (0_i32, 0_i32, 1 << 27);
    for i in 0..3 {
        let [(a_high, a_low), (b_high, b_low)] = [a[i], b[i]].map(|value| {
            let low = (value << 17) >> 17;
            (value.wrapping_sub(low) >> 15, low)
        });
        high = high.wrapping_add(a_high.wrapping_mul(b_high));
        middle = (middle.wrapping_add(a_high.wrapping_mul(b_low)))
            .wrapping_add(a_low.wrapping_mul(b_high));
        low += a_low * b_low;
    }
    (high << 2).wrapping_add(middle.wrapping_add(low >> 15) >> 13)
}

/// Product of the quaternions `a` and `b`, w x y z, exact. The sum and the difference of two components of
/// one of them must fit 32 bits, as they do where its length is at most 2³⁰·√2.
#[inline(always)]
pub fn quaternion_product(a: [i32; 4], b: [i32; 4]) -> [i64; 4] {
    #[cfg(all(target_arch = "arm", not(target_has_atomic = "32")))]
    return quaternion_short(a, b);
    #[cfg(not(all(target_arch = "arm", not(target_has_atomic = "32"))))]
    return quaternion_long(a, b);
}

/// Sixteen products.
#[inline(always)]
#[cfg_attr(all(target_arch = "arm", not(target_has_atomic = "32")), allow(dead_code))]
fn quaternion_long(a: [i32; 4], b: [i32; 4]) -> [i64; 4] {
    // Factors are negated, not products: the multiplication accumulates.
    let [p, q, r] = [b[1], b[2], b[3]].map(i32::wrapping_neg);
    let sum = |b: [i32; 4]| {
        (a.iter().zip(b)).fold(0_i64, |sum, (&a, b)| sum.wrapping_add(i64::from(a) * i64::from(b)))
    };
    [
        sum([b[0], p, q, r]),
        sum([b[1], b[0], b[3], q]),
        sum([b[2], r, b[0], b[1]]),
        sum([b[3], b[2], p, b[0]]),
    ]
}

/// Eight products [Howell and Lafon 1975].
#[inline(always)]
#[cfg_attr(not(all(target_arch = "arm", not(target_has_atomic = "32"))), allow(dead_code))]
fn quaternion_short(a: [i32; 4], b: [i32; 4]) -> [i64; 4] {
    let plus = |v: &[i32; 4], i: usize, j: usize| v[i].wrapping_add(v[j]);
    let minus = |v: &[i32; 4], i: usize, j: usize| v[i].wrapping_sub(v[j]);
    let first = short(plus(&a, 3, 1), plus(&b, 1, 2));
    let third = short(minus(&a, 0, 2), plus(&b, 0, 3));
    let fourth = short(plus(&a, 0, 2), minus(&b, 0, 3));
    let second = first.wrapping_add(third).wrapping_add(fourth);
    let last = short(minus(&a, 3, 1), minus(&b, 1, 2));
    let half = second.wrapping_add(last) >> 1;
    let sum = |less: i64, product: i64| half.wrapping_sub(less).wrapping_add(product);
    [
        sum(first, short(minus(&a, 3, 2), minus(&b, 2, 3))),
        sum(second, short(plus(&a, 1, 0), plus(&b, 1, 0))),
        sum(third, short(minus(&a, 0, 1), plus(&b, 2, 3))),
        sum(fourth, short(plus(&a, 3, 2), minus(&b, 0, 1))),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn both_ways_agree_on_every_input(a: i32, b: i32, shift in 0..31_u32) {
            for (a, b) in [(a, b), (a >> shift, b), (i32::MIN, b), (i32::MAX, b), (i32::MIN, i32::MIN)] {
                prop_assert_eq!(short(a, b), product(a, b));
            }
        }

        #[test]
        fn both_dot_products_agree(a: [i32; 3], b: [i32; 3], extremes: [bool; 6]) {
            const MOST: i32 = 1 << 29;
            let clamped = |v: [i32; 3]| v.map(|v| v >> 2);
            let edge = |v: [i32; 3], at: usize| {
                core::array::from_fn(|i| if extremes[at + i] { MOST } else if v[i] < 0 { -MOST } else { v[i] >> 2 })
            };
            for (a, b) in [(clamped(a), clamped(b)), (edge(a, 0), edge(b, 3)), (edge(a, 0), clamped(b))] {
                prop_assert_eq!(dot_short(a, b), dot_long(a, b));
            }
        }

        #[test]
        fn both_products_of_quaternions_agree(a: [i32; 4], b: [i32; 4], shift in 1..31_u32) {
            let (a, b) = (a.map(|a| a >> 1), b.map(|b| b >> shift));
            prop_assert_eq!(quaternion_short(a, b), quaternion_long(a, b));
        }
    }
}
