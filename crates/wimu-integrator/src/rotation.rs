//! Attitude from measured angular rate in whole numbers: equations (27) and (28) of docs/EQUATIONS.md.

use wimu_model::{AngularRateQ20, PeriodNs};

/// A unit quaternion from body to navigation axes that follows measured angular rates.
///
/// A step turns it by the rotation vector of two neighbouring samples,
/// φ = (ω₀ + ω₁) T/2 + (ω₀ × ω₁) T²/12: the trapezoid and the coning term of a rate that is linear
/// in between (Bortz 1971, Savage 1998). Sums are kept in 64 bits and what a step leaves below
/// 2⁻³¹ rad is carried to the next, so that the arithmetic error does not grow with a constant rate.
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
    /// w, x, y, z; 2⁻⁶¹.
    quaternion: [i64; 4],
    /// ω T/4 of the latest sample, 2⁻⁶³ rad; `None` before the first.
    previous: Option<[i64; 3]>,
    /// What the latest half angle left below 2⁻³¹ rad, 2⁻⁶³ rad.
    remainder: [u32; 3],
    factor: Factor,
}

/// T/4 as mantissa · 2^shift, 2⁻⁶³ rad per LSB of an angular rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Factor {
    mantissa: i32,
    shift: u32,
    /// The largest rate that turns an axis by at most 1.5 rad in a period, LSB.
    limit: i32,
}

impl Factor {
    fn of(period: PeriodNs) -> Self {
        // 2⁻²⁰ rad/s · T/4 in 2⁻⁶³ rad is T · 2⁴¹ / 10⁹ with T in ns.
        let exact = (u128::from(period.0) << 41) / 500_000_000;
        let twice = exact as u64;
        let shift = (64 - twice.leading_zeros()).saturating_sub(32);
        let mantissa = ((twice >> shift) + 1) >> 1;
        let whole = (mantissa << shift).max(1);
        Self {
            mantissa: mantissa.min(i32::MAX as u64) as i32,
            shift,
            limit: ((3_u64 << 60) / whole).min(i32::MAX as u64) as i32,
        }
    }

    /// Half of the angle that `rate` turns in half a period, 2⁻⁶³ rad, and whether it is in range.
    #[inline]
    fn apply(self, rate: AngularRateQ20) -> ([i64; 3], bool) {
        let clamped = rate.0.map(|axis| axis.clamp(-self.limit, self.limit));
        (
            clamped.map(|axis| long(axis, self.mantissa) << self.shift),
            clamped == rate.0,
        )
    }
}

impl Factor {
    /// The rate of which [`apply`](Self::apply) is the result.
    fn invert(self, half: [i64; 3]) -> [i32; 3] {
        half.map(|axis| {
            let product = axis >> self.shift;
            product.checked_div(self.mantissa.into()).unwrap_or(0) as i32
        })
    }
}

impl Rotation {
    /// Starts at a quaternion w, x, y, z from body to navigation axes, which is normalised; (1, 0, 0, 0)
    /// where its length is zero or not finite.
    pub fn new(quaternion: [f64; 4], period: PeriodNs) -> Self {
        let norm = wimu_model::root::sqrt(quaternion.iter().map(|q| q * q).sum());
        let unit = match norm > 0.0 && norm.is_finite() {
            true => quaternion.map(|q| q / norm),
            false => [1.0, 0.0, 0.0, 0.0],
        };
        Self {
            quaternion: unit.map(|q| (q * (1_u64 << 61) as f64) as i64),
            previous: None,
            remainder: [0; 3],
            factor: Factor::of(period),
        }
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
            previous: previous.map(|rate| factor.apply(AngularRateQ20(rate)).0),
            remainder,
            factor,
        }
    }

    /// Quaternion, latest angular rate and remainder.
    pub(crate) fn parts(&self) -> ([i64; 4], Option<[i32; 3]>, [u32; 3]) {
        let previous = self.previous.map(|half| self.factor.invert(half));
        (self.quaternion, previous, self.remainder)
    }

    /// w, x, y, z from body to navigation axes.
    pub fn quaternion(&self) -> [f64; 4] {
        self.quaternion.map(|q| q as f64 / (1_u64 << 61) as f64)
    }

    /// Takes the next sample, body axes. The first one only sets where the trapezoid starts. Returns
    /// whether the rate was in range: at most 1.5 rad an axis in a period; beyond it is clamped.
    #[inline]
    pub fn step(&mut self, rate: AngularRateQ20) -> bool {
        let (next, in_range) = self.factor.apply(rate);
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
    pub(crate) fn to_body(&self, vector: [i32; 3]) -> [i32; 3] {
        let [w, x, y, z] = self.short();
        turned(vector, [w, -x, -y, -z])
    }

    /// The quaternion in 2⁻³⁰.
    #[inline]
    fn short(&self) -> [i32; 4] {
        self.quaternion.map(|q| (q >> 31) as i32)
    }

    /// sin(|φ|/2) φ/|φ| in 2⁻³¹, and cos(|φ|/2) − 1 in 2⁻³¹.
    #[inline]
    fn half_angle(&mut self, previous: [i64; 3], next: [i64; 3]) -> ([i32; 3], i32) {
        // (ω₀ × ω₁) T²/24 = 2/3 (ω₀ T/4) × (ω₁ T/4); the cross product is in 2⁻⁶².
        let upper = |v: [i64; 3]| v.map(|x| (x >> 32) as i32);
        let coning = cross(upper(previous), upper(next)).map(|c| ((c >> 16) * TWO_THIRDS) << 1);
        let exact: [i64; 3] = core::array::from_fn(|i| {
            let sum = previous[i].wrapping_add(next[i]).wrapping_add(coning[i]);
            sum.wrapping_add(self.remainder[i].into())
        });
        let half = upper(exact);
        let square = half
            .iter()
            .fold(0_u64, |sum, &h| sum.wrapping_add(long(h, h) as u64));
        let x = (square >> 32) as i32;
        // sin h / h − 1 and cos h − 1 as series in h², 2⁻³⁰.
        let product = |a: i32, b: i32| (long(a, b) >> 30) as i32;
        const ONE: i32 = 1 << 30;
        let sine = -product(x, ONE / 6 - product(x, ONE / 120 - x / 5040));
        let cosine = -product(x, ONE / 2 - product(x, ONE / 24 - x / 720));
        let mut sines = [0; 3];
        for axis in 0..3 {
            let whole = exact[axis].wrapping_add(long(half[axis], sine) << 2);
            sines[axis] = (whole >> 32) as i32;
            self.remainder[axis] = whole as u32;
        }
        (sines, cosine << 1)
    }

    /// q ← q ⊗ (1 + cosine, sines), drawn towards length 1.
    #[inline]
    fn turn(&mut self, (d, cosine): ([i32; 3], i32)) {
        let q = self.short();
        let length = q.iter().fold(0_i64, |sum, &q| sum.wrapping_add(long(q, q)));
        let shrink = (((1_i64 << 60) - length) >> 30) as i32;
        let s = cosine.wrapping_add(shrink);
        let [w, x, y, z] = q;
        let [a, b, c] = d;
        let [qw, qx, qy, qz] = &mut self.quaternion;
        *qw += long(w, s) - long(x, a) - long(y, b) - long(z, c);
        *qx += long(x, s) + long(w, a) + long(y, c) - long(z, b);
        *qy += long(y, s) + long(w, b) + long(z, a) - long(x, c);
        *qz += long(z, s) + long(w, c) + long(x, b) - long(y, a);
    }
}

/// v + 2 w (u × v) + 2 u × (u × v) for the quaternion w, u in 2⁻³⁰.
#[inline]
fn turned(v: [i32; 3], [w, x, y, z]: [i32; 4]) -> [i32; 3] {
    let u = [x, y, z];
    let t = cross(u, v).map(|t| rounded(t, 29));
    let along = cross(u, t).map(|a| rounded(a, 30));
    core::array::from_fn(|i| {
        v[i].wrapping_add(rounded(long(w, t[i]), 30))
            .wrapping_add(along[i])
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

/// 2/3 · 2¹⁶.
const TWO_THIRDS: i64 = 43_691;

#[inline]
fn long(a: i32, b: i32) -> i64 {
    i64::from(a) * i64::from(b)
}

#[inline]
fn cross(a: [i32; 3], b: [i32; 3]) -> [i64; 3] {
    [
        long(a[1], b[2]) - long(a[2], b[1]),
        long(a[2], b[0]) - long(a[0], b[2]),
        long(a[0], b[1]) - long(a[1], b[0]),
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
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    }

    fn turned_by(phi: [f64; 3]) -> [f64; 4] {
        let angle = phi.iter().map(|x| x * x).sum::<f64>().sqrt();
        let k = if angle > 1e-9 {
            (angle / 2.0).sin() / angle
        } else {
            0.5
        };
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
        2.0 * (d[1] * d[1] + d[2] * d[2] + d[3] * d[3])
            .sqrt()
            .atan2(d[0].abs())
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
        let mut exact = Oracle {
            q: [1.0, 0.0, 0.0, 0.0],
            previous: None,
        };
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
    fn a_constant_rate_of_any_size_is_summed_exactly() {
        for rate in [1, 7, 333, 10_485, 1_048_576, 36_500_000] {
            for axis in 0..3 {
                let mut fixed = Rotation::new([0.5, 0.5, -0.5, 0.5], PeriodNs(1_000_003));
                let mut exact = Oracle {
                    q: [0.5, 0.5, -0.5, 0.5],
                    previous: None,
                };
                let mut sample = AngularRateQ20([0; 3]);
                sample.0[axis] = rate;
                for _ in 0..=100_000 {
                    fixed.step(sample);
                    exact.step(sample.to_rad_s(), 1.000_003e-3);
                }
                let error = angle_between(fixed.quaternion(), exact.q);
                assert!(error < 3e-6, "{rate}, axis {axis}: {error} rad");
            }
        }
    }

    #[test]
    fn the_coning_term_holds_a_cone_that_the_trapezoid_alone_loses() {
        // Classical coning: the z axis drifts by ω a²/2 where the term is missing.
        let (amplitude, omega, dt) = (0.02_f64, 60.0_f64, 0.005_f64);
        let truth = |t: f64| {
            turned_by([
                amplitude * (omega * t).cos(),
                amplitude * (omega * t).sin(),
                0.0,
            ])
        };
        let rate = |t: f64| {
            let (h, s) = (1e-6, t);
            let (a, b) = (truth(s - h), truth(s + h));
            let d = times([a[0], -a[1], -a[2], -a[3]], b);
            [d[1] / h, d[2] / h, d[3] / h]
        };
        let mut rotation = Rotation::new(truth(0.0), PeriodNs(5_000_000));
        let mut plain = Oracle {
            q: truth(0.0),
            previous: None,
        };
        let steps = 2000;
        for k in 0..=steps {
            let sample = AngularRateQ20::from_rad_s(rate(f64::from(k) * dt));
            rotation.step(sample);
            // Without the term.
            let now = sample.to_rad_s();
            if let Some(before) = plain.previous.replace(now) {
                plain.q = times(
                    plain.q,
                    turned_by([0, 1, 2].map(|i| (before[i] + now[i]) * dt / 2.0)),
                );
            }
        }
        let end = truth(f64::from(steps) * dt);
        let (with, without) = (
            angle_between(rotation.quaternion(), end),
            angle_between(plain.q, end),
        );
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
            prop_assert!((length - 1.0).abs() < 3e-6, "{length}");
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
