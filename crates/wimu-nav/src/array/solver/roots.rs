//! The angular rates that fit a sample: equations (73) to (75).

use super::{ArraySolver, HYPOTHESES, Hypothesis, Linear, Solution, inner};
use crate::Real;
use crate::rotation::real;

/// Damped Gauss-Newton steps; a good start takes 2 to 4.
const MOST_STEPS: usize = 20;
/// Two roots closer than this many standard deviations are one.
const SAME_ROOT_SIGMA2: f64 = 1.0;
/// Roots whose χ² is larger than the best one's by more than this are ruled out (4.3 σ).
const RULED_OUT: f64 = 18.0;

impl<R: Real, const M: usize> ArraySolver<R, M> {
    /// All angular rates that fit a sample, by [`ArraySolver::reduce`] and [`ArraySolver::roots_of`].
    pub fn solve(&self, output_mps2: &[R; M]) -> Solution<R> {
        self.roots_of(&self.reduce(output_mps2))
    }

    /// All angular rates that fit a reduced sample. Empty where the geometry shows no angular rate,
    /// or the sample is not finite.
    pub fn roots_of(&self, linear: &Linear<R>) -> Solution<R> {
        let mut solution = Solution { hypotheses: [None; HYPOTHESES] };
        let finite = linear.z.iter().chain(&linear.theta).all(|v| v.is_finite());
        if self.rank < 3 || !finite {
            return solution;
        }
        let mut q = [R::default(); 6];
        for row in 0..6 {
            q[row] = inner(&self.u_inverse[row], &linear.z);
        }
        let mut found: [Option<Hypothesis<R>>; 4] = [None; 4];
        if self.rank == 6 {
            found[0] = self.refine(linear, closed_form(&q));
        } else {
            let zero = R::default();
            let size = |v: R| if v > zero { v } else { -v }.sqrt();
            let [x, y, z] = [size(q[0]), size(q[1]), size(q[2])];
            // The closed form tells x y from −x y; z is mirrored. All patterns are tried, since
            // noise may hide any sign.
            let starts = [[x, y, z], [x, y, -z], [x, -y, z], [-x, y, z]];
            for (slot, start) in found.iter_mut().zip(starts) {
                *slot = self.refine(linear, start);
            }
        }
        let best =
            found.iter().flatten().map(|h| h.chi_square).fold(None, |least: Option<R>, v| {
                match least {
                    Some(l) if l <= v => Some(l),
                    _ => Some(v),
                }
            });
        let Some(best) = best else { return solution };
        let mut count = 0;
        for candidate in found.into_iter().flatten() {
            let late = candidate.chi_square > best + real(RULED_OUT);
            let opposite = self.complete(linear, candidate.rate_rad_s.map(|w| -w));
            for hypothesis in [candidate, opposite] {
                let known = solution.hypotheses().any(|other| same(other, &hypothesis));
                if late || known {
                    continue;
                }
                if let Some(slot) = solution.hypotheses.get_mut(count) {
                    *slot = Some(hypothesis);
                    count += 1;
                }
            }
        }
        // A handful: insertion sort, pairs stay together because their χ² are equal.
        for i in 1..count {
            let mut j = i;
            while j > 0 && chi(&solution.hypotheses, j - 1) > chi(&solution.hypotheses, j) {
                solution.hypotheses.swap(j - 1, j);
                j -= 1;
            }
        }
        solution
    }

    /// The angular rate that fits a reduced sample near `start_rad_s`: damped Gauss-Newton,
    /// equation (73).
    pub fn refine(&self, linear: &Linear<R>, start_rad_s: [R; 3]) -> Option<Hypothesis<R>> {
        let mut rate = start_rad_s;
        let mut state = self.evaluate(linear, rate);
        let mut damping = R::default();
        let tiny = real(1e-3);
        for _ in 0..MOST_STEPS {
            let mut damped = state.information;
            let trace = damped[0][0] + damped[1][1] + damped[2][2];
            for (i, row) in damped.iter_mut().enumerate() {
                row[i] += damping * trace;
            }
            let step = inverse3(&damped).map(|inverse| times(&inverse, state.gradient));
            let Some(step) = step else {
                if damping > real(1e3) {
                    break;
                }
                damping = more(damping);
                continue;
            };
            let trial = [rate[0] + step[0], rate[1] + step[1], rate[2] + step[2]];
            let next = self.evaluate(linear, trial);
            // The predicted gain in χ², in parts of a standard deviation.
            let gain = dot(step, state.gradient);
            if next.cost <= state.cost {
                rate = trial;
                state = next;
                damping *= real(0.1);
                if gain < tiny {
                    break;
                }
            } else if gain < tiny || damping > real(1e3) {
                break;
            } else {
                damping = more(damping);
            }
        }
        state.cost.is_finite().then(|| self.complete(linear, rate))
    }

    fn complete(&self, linear: &Linear<R>, rate_rad_s: [R; 3]) -> Hypothesis<R> {
        let state = self.evaluate(linear, rate_rad_s);
        let [ax, ay, az, sx, sy, sz] = self.theta(linear, rate_rad_s);
        Hypothesis {
            rate_rad_s,
            angular_acceleration_rad_s2: [ax, ay, az],
            specific_force_mps2: [sx, sy, sz],
            information: state.information,
            chi_square: state.cost,
        }
    }

    fn evaluate(&self, linear: &Linear<R>, rate: [R; 3]) -> State<R> {
        let (value, slope) = self.expected_z(rate);
        let mut state = State {
            cost: R::default(),
            gradient: [R::default(); 3],
            information: [[R::default(); 3]; 3],
        };
        for row in 0..self.rank.min(6) {
            let residual = linear.z[row] - value[row];
            let s = slope[row];
            state.cost += residual * residual;
            for i in 0..3 {
                state.gradient[i] += s[i] * residual;
                for j in 0..=i {
                    state.information[i][j] += s[i] * s[j];
                }
            }
        }
        for i in 0..3 {
            for j in 0..i {
                state.information[j][i] = state.information[i][j];
            }
        }
        state
    }
}

struct State<R> {
    cost: R,
    gradient: [R; 3],
    information: [[R; 3]; 3],
}

fn chi<R: Real>(hypotheses: &[Option<Hypothesis<R>>; HYPOTHESES], index: usize) -> R {
    match hypotheses.get(index) {
        Some(Some(hypothesis)) => hypothesis.chi_square,
        _ => R::default(),
    }
}

/// Whether two roots are one: at rest, or where two starts lead to one minimum.
fn same<R: Real>(a: &Hypothesis<R>, b: &Hypothesis<R>) -> bool {
    let d = sub(a.rate_rad_s, b.rate_rad_s);
    let apart = dot(d, times(&a.information, d));
    apart <= real(SAME_ROOT_SIGMA2)
}

/// ω from the six monomials, up to its sign: equation (74).
fn closed_form<R: Real>(q: &[R; 6]) -> [R; 3] {
    let zero = R::default();
    let [xx, yy, zz, yz, xz, xy] = *q;
    // The largest component decides the others' signs; near rest noise must not make them larger.
    let ratio = |product: R, largest: R| {
        let value = product / largest;
        if value > largest {
            largest
        } else if value < -largest {
            -largest
        } else {
            value
        }
    };
    if xx >= yy && xx >= zz && xx > zero {
        let x = xx.sqrt();
        [x, ratio(xy, x), ratio(xz, x)]
    } else if yy >= zz && yy > zero {
        let y = yy.sqrt();
        [ratio(xy, y), y, ratio(yz, y)]
    } else if zz > zero {
        let z = zz.sqrt();
        [ratio(xz, z), ratio(yz, z), z]
    } else {
        [zero; 3]
    }
}

fn more<R: Real>(damping: R) -> R {
    let least = real(1e-3);
    let ten = damping * real(10.0);
    if ten > least { ten } else { least }
}

pub(super) fn dot<R: Real>(a: [R; 3], b: [R; 3]) -> R {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn sub<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn times<R: Real>(m: &[[R; 3]; 3], v: [R; 3]) -> [R; 3] {
    [dot(m[0], v), dot(m[1], v), dot(m[2], v)]
}

/// Inverse of a symmetric, positive definite matrix; `None` where it is singular to rounding.
pub(super) fn inverse3<R: Real>(m: &[[R; 3]; 3]) -> Option<[[R; 3]; 3]> {
    let [[a, b, c], [_, d, e], [_, _, f]] = *m;
    let xx = d * f - e * e;
    let xy = c * e - b * f;
    let xz = b * e - c * d;
    let determinant = a * xx + b * xy + c * xz;
    let trace = a + d + f;
    let least = trace * trace * trace * real(1e-6);
    if !(determinant > least && determinant > R::default()) {
        return None;
    }
    let k = R::one() / determinant;
    let yy = (a * f - c * c) * k;
    let yz = (b * c - a * e) * k;
    let zz = (a * d - b * b) * k;
    let (xx, xy, xz) = (xx * k, xy * k, xz * k);
    Some([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
}
