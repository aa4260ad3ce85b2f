//! Test of the size of an array: the change of ω against the integral of ω̇, equation (101).

use nalgebra::Vector3;

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
    /// Time, ω and ω̇ of the sample before.
    last: Option<(f64, [Vector3<f64>; 2])>,
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
    /// Adds the next sample in motion with its ω, known up to its sign, and ω̇.
    pub fn push(&mut self, time_s: f64, period_s: f64, rate: Option<[Vector3<f64>; 2]>) {
        let last = self.last.take().filter(|(last_s, _)| time_s - last_s < 1.5 * period_s);
        let Some([mut omega, omega_dot]) = rate else {
            return;
        };
        let mut ends = last.is_none();
        if let Some((last_s, [last_omega, last_dot])) = last {
            let step = (last_dot + omega_dot) * (0.5 * (time_s - last_s));
            if (last_omega + step).dot(&omega) < 0.0 {
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
            self.product += std::mem::take(&mut self.run).abs();
        }
        if ends {
            (self.begin_s, self.begin, self.integral) = (time_s, omega, Vector3::zeros());
        }
        self.last = Some((time_s, [omega, omega_dot]));
    }

    /// Bounds of the size of the geometry over that of the array: the square of the slope of Δω over ∫ω̇ dt.
    pub fn bounds(&self) -> Option<[f64; 2]> {
        let product = self.product + self.run.abs();
        let [change, integral] = self.squares;
        // Slope of the regression on the variable with the sum of squares `x`, less its deviations.
        let slope = |x: f64, y: f64| {
            let slope = product / x;
            let variance = (y / x - slope * slope).max(0.0) / (3.0 * self.windows);
            slope - BOUND_SD * variance.sqrt()
        };
        let [least, inverse] = [slope(integral, change), slope(change, integral)];
        let known = self.windows >= LEAST_WINDOWS && least > 0.0 && inverse > 0.0;
        known.then(|| [least * least, 1.0 / (inverse * inverse)])
    }
}
