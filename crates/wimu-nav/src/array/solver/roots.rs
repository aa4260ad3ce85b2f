//! The angular rates that fit a sample: equations (73) to (75).

use heapless::Vec;
use nalgebra::{Matrix3, Vector3, Vector6};

use super::{ArraySolver, Linear};

/// Damped Gauss-Newton steps; a good start takes 2 to 4.
const MOST_STEPS: usize = 20;
/// Two roots closer than this many standard deviations are one.
const SAME_ROOT_SIGMA2: f64 = 1.0;
/// Roots whose χ² is larger than the best one's by more than this are ruled out (4.3 σ).
const RULED_OUT: f64 = 18.0;

/// One angular rate that fits a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hypothesis {
    /// ω, rad/s, body axes.
    pub rate_rad_s: Vector3<f64>,
    /// Information about ω, the inverse of its covariance, (rad/s)⁻²: it vanishes at rest.
    pub information: Matrix3<f64>,
    /// Sum of the squared residuals that ω should explain, of unit variance: [`ArraySolver::rank`] less three degrees of
    /// freedom.
    pub chi_square: f64,
}

/// Fit at an angular rate.
struct Fit {
    cost: f64,
    gradient: Vector3<f64>,
    information: Matrix3<f64>,
}

impl ArraySolver {
    /// All angular rates that fit a reduced sample, each with its opposite next to it, the best fit first: more than one, but
    /// at rest. Empty where the geometry shows no angular rate, or the sample is not finite.
    pub fn roots_of(&self, linear: &Linear) -> Vec<Hypothesis, 8> {
        let mut roots = Vec::new();
        let finite = linear.z.iter().chain(&linear.theta).all(|v| v.is_finite());
        if self.rank < 3 || !finite {
            return roots;
        }
        let q = self.u_inverse * linear.z;
        let mut starts = Vec::<Vector3<f64>, 4>::new();
        if self.rank == 6 {
            let _ = starts.push(closed_form(&q));
        } else {
            let [x, y, z] = [q[0], q[1], q[2]].map(|square: f64| libm::sqrt(square.abs()));
            // The closed form tells x y from −x y; z is mirrored. All patterns are tried, since
            // noise may hide any sign.
            starts.extend([[x, y, z], [x, y, -z], [x, -y, z], [-x, y, z]].map(Vector3::from));
        }
        let found: Vec<_, 4> = starts.into_iter().filter_map(|s| self.refine(linear, s)).collect();
        let mut found: Vec<Hypothesis, 4> = found;
        found.sort_unstable_by(|a, b| {
            a.chi_square.partial_cmp(&b.chi_square).unwrap_or(core::cmp::Ordering::Equal)
        });
        let Some(best) = found.first().map(|h| h.chi_square) else {
            return roots;
        };
        for one in found.iter().filter(|h| h.chi_square <= best + RULED_OUT) {
            for hypothesis in [*one, self.complete(linear, -one.rate_rad_s)] {
                if !roots.iter().any(|other| same(other, &hypothesis)) {
                    let _ = roots.push(hypothesis);
                }
            }
        }
        roots
    }

    /// The angular rate that fits a reduced sample near a start, rad/s: damped Gauss-Newton, equation (73).
    fn refine(&self, linear: &Linear, start: Vector3<f64>) -> Option<Hypothesis> {
        let mut rate = start;
        let mut fit = self.evaluate(linear, &rate);
        let mut damping = 0.0;
        let more = |damping: f64| (damping * 10.0).max(1e-3);
        for _ in 0..MOST_STEPS {
            let mut damped = fit.information;
            let ridge = damping * damped.trace();
            damped.set_diagonal(&damped.diagonal().add_scalar(ridge));
            let Some(inverse) = inverse(&damped) else {
                if damping > 1e3 {
                    break;
                }
                damping = more(damping);
                continue;
            };
            let step = inverse * fit.gradient;
            let next = self.evaluate(linear, &(rate + step));
            // The predicted gain in χ², in parts of a standard deviation.
            let is_small = step.dot(&fit.gradient) < 1e-3;
            if next.cost <= fit.cost {
                rate += step;
                fit = next;
                damping *= 0.1;
            } else if damping > 1e3 {
                break;
            } else {
                damping = more(damping);
            }
            if is_small {
                break;
            }
        }
        fit.cost.is_finite().then(|| self.complete(linear, rate))
    }

    fn complete(&self, linear: &Linear, rate: Vector3<f64>) -> Hypothesis {
        let Fit { cost, information, .. } = self.evaluate(linear, &rate);
        Hypothesis { rate_rad_s: rate, information, chi_square: cost }
    }

    fn evaluate(&self, linear: &Linear, rate: &Vector3<f64>) -> Fit {
        let (value, slope) = self.expected_z(rate);
        let residual = linear.z - value;
        Fit {
            cost: residual.norm_squared(),
            gradient: slope.tr_mul(&residual),
            information: slope.tr_mul(&slope),
        }
    }
}

/// Whether two roots are one: at rest, or where two starts lead to one minimum.
fn same(a: &Hypothesis, b: &Hypothesis) -> bool {
    let apart = a.rate_rad_s - b.rate_rad_s;
    apart.dot(&(a.information * apart)) <= SAME_ROOT_SIGMA2
}

/// ω from the six monomials, up to its sign: equation (74).
fn closed_form(q: &Vector6<f64>) -> Vector3<f64> {
    let [xx, yy, zz, yz, xz, xy] = (*q).into();
    let largest = xx.max(yy).max(zz);
    let root = libm::sqrt(largest.max(0.0));
    if root <= 0.0 {
        return Vector3::zeros();
    }
    // The largest component decides the others' signs; near rest noise must not make them larger.
    let ratio = |product: f64| (product / root).clamp(-root, root);
    if xx == largest {
        Vector3::new(root, ratio(xy), ratio(xz))
    } else if yy == largest {
        Vector3::new(ratio(xy), root, ratio(yz))
    } else {
        Vector3::new(ratio(xz), ratio(yz), root)
    }
}

/// Inverse of a symmetric, positive definite matrix; `None` where it is singular to rounding.
fn inverse(matrix: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let (trace, determinant) = (matrix.trace(), matrix.determinant());
    if determinant > trace * trace * trace * 1e-6 { matrix.try_inverse() } else { None }
}
