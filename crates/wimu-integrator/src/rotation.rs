//! Attitude from measured angular rate in whole numbers: equations (27) and (28) of docs/reference/equations.

use wimu_model::fixed::{self, product};
use wimu_model::{AngularRateQ20, PeriodNs};

/// A unit quaternion from body to navigation axes that follows measured angular rates.
///
/// A step turns it by the rotation vector of two neighbouring samples,
/// φ = (ω₀ + ω₁) T/2 + (ω₀ × ω₁) T²/12: the trapezoid and the coning term of a rate that is linear
/// in between (Bortz 1971, Savage 1998). Sums are kept in 64 bits and what a step leaves below
/// 2⁻²⁹ rad is carried to the next, so that the arithmetic error does not grow with a constant rate.
///
/// ```
/// use wimu_integrator::Rotation;
/// use wimu_model::{AngularRateQ20, PeriodNs};
///
/// let mut rotation = Rotation::new([1.0, 0.0, 0.0, 0.0], PeriodNs(1_000_000));
/// let quarter_turn_a_second = AngularRateQ20::from_rad_s([0.0, 0.0, core::f64::consts::FRAC_PI_2]);
/// for _ in 0..=1000 {
///     rotation.step(quarter_turn_a_second);
/// }
/// let [w, _, _, z] = rotation.quaternion();
/// assert!((w - z).abs() < 1e-6 && (w * w + z * z - 1.0).abs() < 1e-8);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Rotation {
    /// w, x, y, z; 2⁻⁵⁹.
    quaternion: [i64; 4],
    /// Latest angular rate, 2^−(20 + shift) rad/s; `None` before the first.
    previous: Option<[i32; 3]>,
    /// What the latest half angle left below 2⁻²⁹ rad, 2⁻⁶¹ rad.
    remainder: [u32; 3],
    factor: Factor,
}

/// Factors of a sample period T.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Factor {
    /// The largest rate, LSB: 1.25 rad per axis in a period, and below 256 rad/s.
    limit: i32,
    /// Shifts the largest rate to 30 bits.
    shift: u32,
    /// T/4, 2⁻⁶¹ rad per LSB of a shifted rate.
    quarter: i32,
    /// T²/24, 2⁻⁶¹ rad per 2³⁰ of the product of two shifted rates.
    coning: i32,
}

impl Factor {
    fn of(period: PeriodNs) -> Self {
        let period = u64::from(period.0.max(1));
        let limit = (1_310_720_000_000_000 / period).min((1 << 28) - 1) as u32;
        let shift = limit.leading_zeros() - 2;
        let quarter = (u128::from(period) << (40 - shift)) / 1_000_000_000;
        let square = u128::from(period) * u128::from(period);
        let coning = (square << (51 - 2 * shift)) / 24_000_000_000_000_000_000;
        Self {
            // Below 2³⁰, so that a cross product of upper halves fits 32 bits.
            limit: limit.min(((1 << 30) - (1 << 20)) >> shift) as i32,
            shift,
            quarter: ((quarter + 1) >> 1) as i32,
            coning: coning as i32,
        }
    }
}

impl Rotation {
    /// Starts at a quaternion w, x, y, z from body to navigation axes, which is normalised; (1, 0, 0, 0)
    /// where its length is zero or not finite.
    pub fn new(quaternion: [f64; 4], period: PeriodNs) -> Self {
        let norm = wimu_model::root::sqrt(quaternion.iter().map(|q| q * q).sum());
        let unit = if norm > 0.0 && norm.is_finite() {
            quaternion.map(|q| q / norm)
        } else {
            [1.0, 0.0, 0.0, 0.0]
        };
        let quaternion = unit.map(|q| (q * (1_u64 << 59) as f64) as i64);
        Self::resumed(quaternion, None, [0; 3], period)
    }

    /// Continues from the parts of another one.
    pub(crate) fn resumed(
        quaternion: [i64; 4],
        previous: Option<[i32; 3]>,
        remainder: [u32; 3],
        period: PeriodNs,
    ) -> Self {
        let factor = Factor::of(period);
        Self {
            quaternion,
            previous: previous
                .map(|rate| clamped(rate, factor.limit).map(|axis| axis << factor.shift)),
            remainder,
            factor,
        }
    }

    /// Quaternion, latest angular rate and remainder.
    pub(crate) fn parts(&self) -> ([i64; 4], Option<[i32; 3]>, [u32; 3]) {
        let rate = |shifted: i32| shifted >> self.factor.shift;
        let previous = self.previous.map(|previous| previous.map(rate));
        (self.quaternion, previous, self.remainder)
    }

    /// w, x, y, z from body to navigation axes.
    pub fn quaternion(&self) -> [f64; 4] {
        self.quaternion.map(|q| q as f64 / (1_u64 << 59) as f64)
    }

    /// Takes the next sample, body axes. The first one only sets where the trapezoid starts. Returns
    /// whether the rate was in range: at most 1.25 rad an axis in a period, and below 256 rad/s; beyond it
    /// is clamped.
    #[inline]
    pub fn step(&mut self, rate: AngularRateQ20) -> bool {
        let Factor { limit, shift, .. } = self.factor;
        let in_range =
            (rate.0.iter()).all(|axis| axis.wrapping_add(limit) as u32 <= 2 * limit as u32);
        let rate = if in_range { rate.0 } else { clamped(rate.0, limit) };
        let next = rate.map(|axis| axis << shift);
        if let Some(previous) = self.previous.replace(next) {
            let half_angle = self.half_angle(previous, next);
            self.turn(half_angle);
        }
        in_range
    }

    /// Samples are missing: the next one starts a new trapezoid, and the attitude is held until then.
    pub fn gap(&mut self) {
        self.previous = None;
    }

    /// A vector in body axes, in navigation axes: v + 2 w (u × v) + 2 u × (u × v). Within 2 LSB.
    #[inline]
    pub fn rotate(&self, body: [i32; 3]) -> [i32; 3] {
        turned(body, self.short())
    }

    /// A vector in navigation axes, in body axes. Within 2 LSB.
    pub(crate) fn rotate_back(&self, vector: [i32; 3]) -> [i32; 3] {
        let [w, x, y, z] = self.short();
        turned(vector, [w, -x, -y, -z])
    }

    /// The quaternion in 2⁻³⁰.
    #[inline]
    fn short(&self) -> [i32; 4] {
        self.quaternion.map(|q| (q >> 29) as i32)
    }

    /// sin(|φ|/2) φ/|φ| and 1 − cos(|φ|/2), in 2⁻²⁹.
    ///
    /// The terms that are small beside the angle are computed from upper halves, in 32 bits.
    #[inline]
    fn half_angle(&mut self, previous: [i32; 3], next: [i32; 3]) -> ([i32; 3], i32) {
        let Factor { quarter, coning, .. } = self.factor;
        let upper = |rates: [i32; 3]| rates.map(|rate| (rate + (1 << 14)) >> 15);
        let (p, n) = (upper(previous), upper(next));
        let cross =
            [p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0]];
        let mut angle: [i64; 3] = core::array::from_fn(|i| {
            let trapezoid = product(previous[i].wrapping_add(next[i]), quarter);
            (trapezoid.wrapping_add(product(cross[i], coning)))
                .wrapping_add(self.remainder[i].into())
        });
        let half = angle.map(|angle| (angle >> 32) as i32);
        // h² in 2⁻³⁰; for the smaller terms of the series h² and h⁶ in 2⁻¹⁵ and h⁴ in 2⁻³⁰.
        let square = (half.iter()).fold(0_i64, |sum, &h| sum.wrapping_add(product(h, h)));
        let x = (square >> 28) as i32;
        let x1 = (x as u32 + (1 << 14)) >> 15;
        let x2 = x1.wrapping_mul(x1);
        let x3 = x1.wrapping_mul(x2 >> 15) >> 15;
        // 1/6 − h²/120 + h⁴/5040 in 2⁻³².
        let sine = 715_827_883 + (x2 >> 15) * 26 - (x1.wrapping_mul(8738) >> 3);
        let shortened = (product(x, sine as i32) >> 30) as i32;
        // h²/2 − h⁴/24 + h⁶/720. An error changes the length, which the next step restores.
        let fourth = (x2 >> 10).wrapping_mul(1365) >> 6;
        let versine = (x >> 2) - (fourth as i32) + (x3.wrapping_mul(23)) as i32;
        for axis in 0..3 {
            angle[axis] = angle[axis].wrapping_sub(product(half[axis], shortened));
            self.remainder[axis] = angle[axis] as u32;
        }
        (angle.map(|angle| (angle >> 32) as i32), versine)
    }

    /// q ← q ⊗ (1 − versine, d), drawn towards length 1.
    #[inline]
    fn turn(&mut self, ([a, b, c], versine): ([i32; 3], i32)) {
        let q = self.short();
        let length = q.iter().fold(0_i64, |sum, &q| sum.wrapping_add(product(q, q)));
        let s = (((1_i64 << 60).wrapping_sub(length) >> 32) as i32).wrapping_sub(versine);
        let change = fixed::quaternion_product(q, [s, a, b, c]);
        for (q, change) in self.quaternion.iter_mut().zip(change) {
            *q = q.wrapping_add(change);
        }
    }
}

/// v + 2 w (u × v) + 2 u × (u × v) for the quaternion w, u in 2⁻³⁰.
#[inline]
fn turned(v: [i32; 3], [w, x, y, z]: [i32; 4]) -> [i32; 3] {
    let u = [x, y, z];
    let t = cross(u, v).map(|t| rounded(t, 29));
    let along = cross(u, t).map(|a| rounded(a, 30));
    core::array::from_fn(|i| {
        v[i].wrapping_add(rounded(product(w, t[i]), 30)).wrapping_add(along[i])
    })
}

/// Product of quaternions w, x, y, z.
pub(crate) fn times(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] + a[2] * b[0] + a[3] * b[1] - a[1] * b[3],
        a[0] * b[3] + a[3] * b[0] + a[1] * b[2] - a[2] * b[1],
    ]
}

#[cold]
fn clamped(rate: [i32; 3], limit: i32) -> [i32; 3] {
    rate.map(|axis| axis.min(limit).max(-limit))
}

#[inline]
fn cross(a: [i32; 3], b: [i32; 3]) -> [i64; 3] {
    [
        product(a[1], b[2]) - product(a[2], b[1]),
        product(a[2], b[0]) - product(a[0], b[2]),
        product(a[0], b[1]) - product(a[1], b[0]),
    ]
}

/// `value` · 2^−`bits`, to nearest.
#[inline]
fn rounded(value: i64, bits: u32) -> i32 {
    (value.wrapping_add(1 << (bits - 1)) >> bits) as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// The same rule in f64.
    struct Oracle {
        q: [f64; 4],
        previous: Option<[f64; 3]>,
    }

    fn cross64(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    }

    fn turned_by(phi: [f64; 3]) -> [f64; 4] {
        let angle = phi.iter().map(|x| x * x).sum::<f64>().sqrt();
        let k = if angle > 1e-9 { (angle / 2.0).sin() / angle } else { 0.5 };
        [(angle / 2.0).cos(), phi[0] * k, phi[1] * k, phi[2] * k]
    }

    impl Oracle {
        fn step(&mut self, rate: [f64; 3], dt: f64) {
            if let Some(before) = self.previous.replace(rate) {
                let c = cross64(before, rate);
                let phi =
                    [0, 1, 2].map(|i| (before[i] + rate[i]) * dt / 2.0 + c[i] * dt * dt / 12.0);
                self.q = times(self.q, turned_by(phi));
                let norm = self.q.iter().map(|q| q * q).sum::<f64>().sqrt();
                self.q = self.q.map(|q| q / norm);
            }
        }
    }

    fn angle_between(a: [f64; 4], b: [f64; 4]) -> f64 {
        let c = [a[0], -a[1], -a[2], -a[3]];
        let d = times(c, b);
        2.0 * (d[1] * d[1] + d[2] * d[2] + d[3] * d[3]).sqrt().atan2(d[0].abs())
    }

    fn hand(t: f64) -> [f64; 3] {
        let wave = |f: f64, p: f64| (std::f64::consts::TAU * f * t + p).sin();
        [
            2.0 * wave(0.7, 0.3) + 1.1 * wave(2.3, 1.0),
            1.7 * wave(0.9, 1.9) + 0.8 * wave(3.1, 0.1),
            1.2 * wave(0.5, 2.7) + 1.5 * wave(1.7, 0.8),
        ]
    }

    #[test]
    fn ten_minutes_of_hand_motion_at_1_khz_stay_within_a_thousandth_of_a_degree_of_f64() {
        let mut fixed = Rotation::new([1.0, 0.0, 0.0, 0.0], PeriodNs(1_000_000));
        let mut exact = Oracle { q: [1.0, 0.0, 0.0, 0.0], previous: None };
        for k in 0..=600_000 {
            let rate = AngularRateQ20::from_rad_s(hand(f64::from(k) * 1e-3));
            assert!(fixed.step(rate));
            exact.step(rate.to_rad_s(), 1e-3);
        }
        let error = angle_between(fixed.quaternion(), exact.q).to_degrees();
        std::println!("attitude, 10 min at 1 kHz, against f64: {error:.2e}°");
        assert!(error <= 1e-3, "{error}°");
    }

    #[test]
    fn a_constant_rate_of_any_size_is_summed_to_a_part_in_10_to_the_7() {
        for rate in [1, 7, 333, 10_485, 1_048_576, 36_500_000] {
            for axis in 0..3 {
                let mut fixed = Rotation::new([0.5, 0.5, -0.5, 0.5], PeriodNs(1_000_003));
                let mut exact = Oracle { q: [0.5, 0.5, -0.5, 0.5], previous: None };
                let mut sample = AngularRateQ20([0; 3]);
                sample.0[axis] = rate;
                for _ in 0..=100_000 {
                    fixed.step(sample);
                    exact.step(sample.to_rad_s(), 1.000_003e-3);
                }
                let error = angle_between(fixed.quaternion(), exact.q);
                let total = f64::from(rate) / AngularRateQ20::LSB_PER_RAD_S * 100.0;
                let bound = 1e-6 + 1e-7 * total;
                assert!(error < bound, "{rate}, axis {axis}: {error} rad");
            }
        }
    }

    #[test]
    fn the_coning_term_holds_a_cone_that_the_trapezoid_alone_loses() {
        // Classical coning: the z axis drifts by ω a²/2 where the term is missing.
        let (amplitude, omega, dt) = (0.02_f64, 60.0_f64, 0.005_f64);
        let truth =
            |t: f64| turned_by([amplitude * (omega * t).cos(), amplitude * (omega * t).sin(), 0.0]);
        let rate = |t: f64| {
            let (h, s) = (1e-6, t);
            let (a, b) = (truth(s - h), truth(s + h));
            let d = times([a[0], -a[1], -a[2], -a[3]], b);
            [d[1] / h, d[2] / h, d[3] / h]
        };
        let mut rotation = Rotation::new(truth(0.0), PeriodNs(5_000_000));
        let mut plain = Oracle { q: truth(0.0), previous: None };
        let steps = 2000;
        for k in 0..=steps {
            let sample = AngularRateQ20::from_rad_s(rate(f64::from(k) * dt));
            rotation.step(sample);
            // Without the term.
            let now = sample.to_rad_s();
            if let Some(before) = plain.previous.replace(now) {
                plain.q =
                    times(plain.q, turned_by([0, 1, 2].map(|i| (before[i] + now[i]) * dt / 2.0)));
            }
        }
        let end = truth(f64::from(steps) * dt);
        let (with, without) =
            (angle_between(rotation.quaternion(), end), angle_between(plain.q, end));
        // What is left is the chord: samples of a rate that is not linear in between.
        std::println!("coning, 10 s: {with:.2e} rad with the term, {without:.2e} rad without");
        assert!(with < 0.6 * without, "{with} {without}");
    }

    #[test]
    fn a_rate_beyond_its_range_is_reported_and_clamped() {
        let mut rotation = Rotation::new([1.0, 0.0, 0.0, 0.0], PeriodNs(40_000_000));
        assert!(rotation.step(AngularRateQ20::from_rad_s([24.0, 0.0, 0.0])));
        assert!(!rotation.step(AngularRateQ20([i32::MAX, i32::MIN, 0])));
        assert!(rotation.quaternion().iter().all(|q| q.abs() <= 1.001));
    }

    proptest! {
        #[test]
        fn any_rates_at_any_period_keep_the_length_and_follow_f64(
            rates in prop::collection::vec(prop::array::uniform3(-30.0..30.0_f64), 2..200),
            period_us in 100..=20_000_u32,
            force: [i16; 3],
        ) {
            let mut fixed = Rotation::new([0.1, 0.7, -0.3, 0.6], PeriodNs(period_us * 1000));
            let mut exact = Oracle { q: fixed.quaternion(), previous: None };
            for rate in &rates {
                let rate = AngularRateQ20::from_rad_s(*rate);
                prop_assert!(fixed.step(rate));
                exact.step(rate.to_rad_s(), f64::from(period_us) * 1e-6);
            }
            let q = fixed.quaternion();
            let length: f64 = q.iter().map(|q| q * q).sum();
            prop_assert!((length - 1.0).abs() < 5e-6, "{length}");
            let error = angle_between(q, exact.q);
            prop_assert!(error < 2e-6 * rates.len() as f64, "{error}");
            let body = force.map(|f| i32::from(f) * 300);
            let rotated = fixed.rotate(body);
            let pure = |v: [i32; 3]| [0.0, f64::from(v[0]), f64::from(v[1]), f64::from(v[2])];
            let expected = times(times(q, pure(body)), [q[0], -q[1], -q[2], -q[3]]);
            let errors: Vec<f64> = (0..3).map(|i| f64::from(rotated[i]) - expected[i + 1]).collect();
            prop_assert!(errors.iter().all(|e| e.abs() < 80.0), "{errors:?}");
        }

        #[test]
        fn no_rates_and_no_state_make_it_panic(rates: Vec<[i32; 3]>, period: u32) {
            let mut rotation = Rotation::new([0.0; 4], PeriodNs(period));
            for rate in rates {
                rotation.step(AngularRateQ20(rate));
                rotation.rotate(rate);
            }
        }
    }
}
