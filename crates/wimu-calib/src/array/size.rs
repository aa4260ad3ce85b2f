//! Test of the size of an array: the change of ω against the integral of ω̇, equation (101).

use nalgebra::Vector3;

use super::motion::Rate;

/// Length of a window over which ω̇ is integrated, s.
const WINDOW_S: f64 = 0.1;
/// Fewer windows do not decide.
const LEAST_WINDOWS: f64 = 10.0;
/// Standard deviations by which the bounds are widened: 99.7 % of a normal distribution.
const BOUND_SD: f64 = 3.0;

/// Sums over windows of Δω and ∫ω̇ dt. Both have errors, so that their regressions on each other are bounds of the slope
/// [KL].
#[derive(Default)]
pub(super) struct SizeTest {
    last: Option<(f64, Rate)>,
    /// Time and ω at which the window begins, and ∫ω̇ dt since.
    begin_s: f64,
    begin: Vector3<f64>,
    integral: Vector3<f64>,
    windows: f64,
    /// Σ |Δω|² and Σ |∫ω̇ dt|².
    squares: [f64; 2],
    /// Σ Δω · ∫ω̇ dt, and its part since ω was last unknown: the sign of ω is that with which it follows ω̇.
    product: f64,
    run: f64,
}

impl SizeTest {
    /// Adds the next sample in motion; its ω is known up to its sign.
    pub fn push(&mut self, time_s: f64, period_s: f64, rate: Option<&Rate>) {
        let last = self.last.take().filter(|(last_s, _)| time_s - last_s < 1.5 * period_s);
        let Some(Rate { mut omega, omega_dot }) = rate.cloned() else {
            return;
        };
        let mut ends = last.is_none();
        if let Some((last_s, last)) = last {
            let step = (last.omega_dot + omega_dot) * (0.5 * (time_s - last_s));
            if (last.omega + step).dot(&omega) < 0.0 {
                omega = -omega;
            }
            self.integral += step;
            ends = time_s - self.begin_s > WINDOW_S - 0.5 * period_s;
            if ends {
                let change = omega - self.begin;
                self.squares[0] += change.norm_squared();
                self.squares[1] += self.integral.norm_squared();
                self.run += change.dot(&self.integral);
                self.windows += 1.0;
            }
        } else {
            self.product += libm::fabs(core::mem::take(&mut self.run));
        }
        if ends {
            (self.begin_s, self.begin, self.integral) = (time_s, omega, Vector3::zeros());
        }
        self.last = Some((time_s, Rate { omega, omega_dot }));
    }

    /// Bounds of the size of the geometry over that of the array: the square of the slope of Δω over ∫ω̇ dt.
    pub fn bounds(&self) -> Option<[f64; 2]> {
        let product = self.product + libm::fabs(self.run);
        let [change, integral] = self.squares;
        // Slope of the regression on the variable with the sum of squares `x`, less its deviations.
        let slope = |x: f64, y: f64| {
            let slope = product / x;
            let variance = (y / x - slope * slope).max(0.0) / (3.0 * self.windows);
            slope - BOUND_SD * libm::sqrt(variance)
        };
        let [least, inverse] = [slope(integral, change), slope(change, integral)];
        let known = self.windows >= LEAST_WINDOWS && least > 0.0 && inverse > 0.0;
        known.then(|| [least * least, 1.0 / (inverse * inverse)])
    }
}
