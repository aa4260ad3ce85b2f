//! Quantiles of the normal, Student and χ² distributions.

use core::f64::consts::{FRAC_PI_2, PI, SQRT_2};

/// Two-sided quantile of the standard normal distribution: x with P(|X| > x) = `p`, 10⁻¹⁵ < p < 1.
pub(crate) fn normal_two_sided(p: f64) -> f64 {
    let mut x = 0.0;
    // Newton's method from below on a convex decreasing function: it does not overshoot. A step is about 1/x.
    for _ in 0..100 {
        let density = libm::sqrt(2.0 / PI) * libm::exp(-0.5 * x * x);
        let step = (libm::erfc(x / SQRT_2) - p) / density;
        x += step;
        if step.abs() < 1e-12 {
            break;
        }
    }
    x
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
