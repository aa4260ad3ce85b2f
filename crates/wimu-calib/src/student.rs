//! Quantiles of the normal, Student and χ² distributions.

use core::f64::consts::FRAC_PI_2;

/// Two-sided quantile of the standard normal distribution: x with P(|X| > x) = `p`, 0 < p < 1;
/// relative error below 2 · 10⁻⁹ [AC].
pub(crate) fn normal_two_sided(p: f64) -> f64 {
    const A: [f64; 6] = [
        -3.969_683_028_665_376e1,
        2.209_460_984_245_205e2,
        -2.759_285_104_469_687e2,
        1.383_577_518_672_69e2,
        -3.066_479_806_614_716e1,
        2.506_628_277_459_239,
    ];
    const B: [f64; 5] = [
        -5.447_609_879_822_406e1,
        1.615_858_368_580_409e2,
        -1.556_989_798_598_866e2,
        6.680_131_188_771_972e1,
        -1.328_068_155_288_572e1,
    ];
    const C: [f64; 6] = [
        -7.784_894_002_430_293e-3,
        -3.223_964_580_411_365e-1,
        -2.400_758_277_161_838,
        -2.549_732_539_343_734,
        4.374_664_141_464_968,
        2.938_163_982_698_783,
    ];
    const D: [f64; 4] = [
        7.784_695_709_041_462e-3,
        3.224_671_290_700_398e-1,
        2.445_134_137_142_996,
        3.754_408_661_907_416,
    ];
    let polynomial = |c: &[f64], x: f64| c.iter().fold(0.0, |sum, c| sum * x + c);
    let tail = p / 2.0;
    if tail < 0.024_25 {
        let q = libm::sqrt(-2.0 * libm::log(tail));
        -polynomial(&C, q) / (polynomial(&D, q) * q + 1.0)
    } else {
        let q = 0.5 - tail;
        let r = q * q;
        polynomial(&A, r) * q / (polynomial(&B, r) * r + 1.0)
    }
}

/// Two-sided quantile of Student's t with `dof` degrees of freedom: x with P(|X| > x) = `p`, 0 < p
/// < 1. Equation (43), Hill's expansion [HI]: exact for 1 and 2, relative error 10⁻³ for 3 and 10⁻⁵
/// from 6 on.
pub(crate) fn two_sided(p: f64, dof: f64) -> f64 {
    if dof < 1.5 {
        let x = p * FRAC_PI_2;
        return libm::cos(x) / libm::sin(x);
    }
    if dof < 2.5 {
        return libm::sqrt(2.0 / (p * (2.0 - p)) - 2.0);
    }
    if dof > 1e7 {
        return normal_two_sided(p);
    }
    let n = dof;
    let a = 1.0 / (n - 0.5);
    let b = 48.0 / (a * a);
    let mut c = ((20_700.0 * a / b - 98.0) * a - 16.0) * a + 96.36;
    let d = ((94.5 / (b + c) - 3.0) / b + 1.0) * libm::sqrt(a * FRAC_PI_2) * n;
    let mut x = d * p;
    let mut y = libm::pow(x, 2.0 / n);
    if y > 0.05 + a {
        x = -normal_two_sided(p);
        y = x * x;
        if n < 5.0 {
            c += 0.3 * (n - 4.5) * (x + 0.6);
        }
        c += (((0.05 * d * x - 5.0) * x - 7.0) * x - 2.0) * x + b;
        y = (((((0.4 * y + 6.3) * y + 36.0) * y + 94.5) / c - y - 3.0) / b + 1.0) * x;
        y = a * y * y;
        y = libm::exp(y) - 1.0;
    } else {
        y = ((1.0 / (((n + 6.0) / (n * y) - 0.089 * d - 0.822) * (n + 2.0) * 3.0)
            + 0.5 / (n + 4.0))
            * y
            - 1.0)
            * (n + 1.0)
            / (n + 2.0)
            + 1.0 / y;
    }
    libm::sqrt(n * y)
}

/// χ² quantile, `dof` degrees of freedom, 0.995: the Wilson-Hilferty approximation, to 3 %.
pub(crate) fn chi_squared_half_percent(dof: usize) -> f64 {
    let n = dof as f64;
    let spread = 2.0 / (9.0 * n);
    let root = 1.0 - spread + 2.575_829 * libm::sqrt(spread);
    n * root * root * root
}

#[cfg(test)]
mod tests {
    use super::*;

    /// P(|T| > t) by Simpson's rule over φ with t = √ν tan φ.
    fn tails(t: f64, dof: f64) -> f64 {
        const STEPS: i32 = 20_000;
        let integral = |from: f64, to: f64| {
            let h = (to - from) / f64::from(STEPS);
            (0..=STEPS)
                .map(|k| {
                    let weight = match k {
                        0 | STEPS => 1.0,
                        k if k % 2 == 1 => 4.0,
                        _ => 2.0,
                    };
                    let cos = libm::cos(from + f64::from(k) * h).max(0.0);
                    weight * libm::pow(cos, dof - 1.0) * h / 3.0
                })
                .sum::<f64>()
        };
        let phi = libm::atan(t / libm::sqrt(dof));
        integral(phi, FRAC_PI_2) / integral(0.0, FRAC_PI_2)
    }

    #[test]
    fn quantiles_are_those_of_the_integrated_density() {
        for dof in [1.0, 2.0, 3.0, 4.0, 5.0, 7.0, 11.0, 29.0, 200.0] {
            for p in [0.3, 0.05, 0.01, 1e-3, 1e-5] {
                let found = tails(two_sided(p, dof), dof);
                assert!((found / p - 1.0).abs() < 5e-3, "{p} {dof}: {found}");
            }
        }
        assert!((normal_two_sided(0.317_310_507_9) - 1.0).abs() < 1e-7);
        assert!((two_sided(0.05, f64::INFINITY) - 1.959_964).abs() < 1e-6);
    }
}
