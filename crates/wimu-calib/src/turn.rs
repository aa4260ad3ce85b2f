//! Calibration from a turn about a level axis in three or four equal steps [LW].

use core::f64::consts::{PI, TAU};

use wimu_model::{ErrorModel, ErrorTerms};

use crate::estimate::{Residuals, TermDeviations};
use crate::linear::{Real, double, real};
use crate::terms::{self, PERFECT, Terms, USUAL_BIAS_MPS2};
use crate::visits::Visits;
use crate::weights::Rejected;
use crate::{
    Covariance, Estimate, Gravity, Method, Parameter, Parameters, Placement, Pose, Refusal, design,
    force, input, pose, student,
};

/// What an axis at right angles to the plane may lean into it, 1 σ: the cross-axis sensitivity of a
/// usual datasheet.
const CROSS_AXIS: f64 = 0.02;
/// In-plane norms, in g, of axes that turn, and of the one that is turned about.
const TURNS: core::ops::Range<f64> = 0.5..1.5;
const STAYS: f64 = 0.5;
/// Steps that came out farther than this from equal, rms, are not those of a turn, rad: 5°, 0.4 % of
/// scale factor.
const MOST_STEP_ERROR: f64 = 0.0873;
/// How far two axes may be from alike and at right angles, as what unequal steps make of them: twice
/// the 3 % of a sensitivity, twice the 2 % across, and a step error of 5°.
const MOST_ELLIPTIC: f64 = 0.15;
/// A step error of σ makes it σ √(8/n) rms.
const ELLIPTIC_OF_STEPS: f64 = 8.0;
/// What the axis that is turned about may read in step with the turn, in g: 5.7° from square.
const MOST_LEAN: f64 = 0.1;
/// Where no turn shows the bias of the axis turned about, what it reads may be that or a tilt: so many standard
/// deviations of both, and it counts as either.
const DOUBTFUL: f64 = 2.0;
/// How far two axes of a usual sensor are from alike and at right angles, 1 σ: 3 % of sensitivity and 2 % across,
/// of each; and what is so many times that counts as steps that were off.
const USUAL_ELLIPTIC: f64 = 0.051;
const BEYOND_USUAL: f64 = 1.4;
/// A standard deviation that two numbers tell may be so many times as large.
const BY_TWO_NUMBERS: f64 = 2.0;
/// So many standard deviations are no chance.
const BEYOND_CHANCE: f64 = 3.3;

/// Bias and scale factor from turns of four steps of 90° about a level axis: equations (45) to (47).
///
/// `poses` are in m/s² by the nominal sensitivity, sensor axes, four to a turn and in the order in
/// which they were taken; a turn may begin anywhere and go either way. Each turn gives the two
/// axes in its plane, told by what they read; turns about two different axes give all three. What
/// no turn shows stays that of a perfect sensor and is not in [`Estimate::fitted`]. The scale factor
/// is the in-plane norm of the axis's row of A: S itself where there is no misalignment, more by
/// half its square where there is. `placement` is the error of a step, and of the axis from level.
///
/// ```
/// use wimu_calib::{Gravity, Placement, Pose, four_angle};
///
/// // Z is level; X reads 9.9, 0.1, −9.7, 0.1 and Y a quarter of a turn later.
/// let turn = [[9.9, 0.0, 0.0], [0.1, 9.8, 0.0], [-9.7, 0.0, 0.0], [0.1, -9.8, 0.0]];
/// let poses = turn.map(Pose::from_mean);
/// let estimate = four_angle(&poses, Gravity::UNKNOWN_PLACE, Placement::BY_HAND)?;
/// assert!((estimate.model.terms().bias_mps2[0] - 0.1).abs() < 1e-12);
/// # Ok::<(), wimu_calib::Refusal>(())
/// ```
///
/// # Errors
/// [`Refusal`] when the poses are not such turns or the result is no accelerometer's.
pub fn four_angle(
    poses: &[Pose],
    gravity: Gravity,
    placement: Placement,
) -> Result<Estimate, Refusal> {
    turns::<f64, 4>(poses, gravity, placement, Method::FourAngle)
}

/// [`four_angle`] computed in f32, for a processor that has no f64: within 0.002 standard deviations
/// of f64 where a pose is known to 1 mm/s² or worse.
///
/// # Errors
/// Those of [`four_angle`].
pub fn four_angle_f32(
    poses: &[Pose],
    gravity: Gravity,
    placement: Placement,
) -> Result<Estimate, Refusal> {
    turns::<f32, 4>(poses, gravity, placement, Method::FourAngle)
}

/// The same from turns of three steps of 120°.
///
/// Three readings for bias, scale factor and where the turn began: nothing is left to check them
/// by.
///
/// ```
/// use wimu_calib::{Gravity, Placement, Pose, three_angle};
///
/// let turn = [[9.9, 0.0, 0.0], [-4.8, 8.487, 0.0], [-4.8, -8.487, 0.0]];
/// let poses = turn.map(Pose::from_mean);
/// let estimate = three_angle(&poses, Gravity::UNKNOWN_PLACE, Placement::BY_HAND)?;
/// assert!((estimate.model.terms().bias_mps2[0] - 0.1).abs() < 1e-12);
/// # Ok::<(), wimu_calib::Refusal>(())
/// ```
///
/// # Errors
/// [`Refusal`] when the poses are not such turns or the result is no accelerometer's.
pub fn three_angle(
    poses: &[Pose],
    gravity: Gravity,
    placement: Placement,
) -> Result<Estimate, Refusal> {
    turns::<f64, 3>(poses, gravity, placement, Method::ThreeAngle)
}

/// [`three_angle`] computed in f32, as [`four_angle_f32`] is.
///
/// # Errors
/// Those of [`three_angle`].
pub fn three_angle_f32(
    poses: &[Pose],
    gravity: Gravity,
    placement: Placement,
) -> Result<Estimate, Refusal> {
    turns::<f32, 3>(poses, gravity, placement, Method::ThreeAngle)
}

/// Bias and scale factor of one axis with their covariance, before the error of gravity.
#[derive(Clone, Copy)]
struct Axis<R> {
    bias: R,
    scale: R,
    bias_variance: R,
    scale_variance: R,
    both: R,
    /// What the readings say beyond three unknowns: its square over its variance.
    misfit: R,
}

impl<R: Real> Axis<R> {
    /// Of several turns: each value by its own weight. What they differ by is another check.
    fn merge(self, other: Self) -> Self {
        let apart = |a: R, b: R, variance: R| {
            if variance > R::zero() {
                (a - b) * (a - b) / variance
            } else {
                R::zero()
            }
        };
        // In two planes the norms of one row differ by the squares of what is across, halved.
        let across: R = real(CROSS_AXIS * CROSS_AXIS);
        let of_scale = self.scale_variance + other.scale_variance + across * across;
        let of_bias = self.bias_variance + other.bias_variance;
        let differ =
            apart(self.bias, other.bias, of_bias) + apart(self.scale, other.scale, of_scale);
        let weight = |a: R, b: R| {
            if a + b > R::zero() {
                b / (a + b)
            } else {
                real(0.5)
            }
        };
        let b = weight(self.bias_variance, other.bias_variance);
        let s = weight(self.scale_variance, other.scale_variance);
        let rest = |w: R| R::one() - w;
        let mix = |w: R, x: R, y: R| w * x + rest(w) * y;
        let square = |w: R, x: R, y: R| w * w * x + rest(w) * rest(w) * y;
        Self {
            bias: mix(b, self.bias, other.bias),
            scale: mix(s, self.scale, other.scale),
            bias_variance: square(b, self.bias_variance, other.bias_variance),
            scale_variance: square(s, self.scale_variance, other.scale_variance),
            both: b * s * self.both + rest(b) * rest(s) * other.both,
            misfit: self.misfit + other.misfit + differ,
        }
    }
}

/// The angle of step `k` of N, rad.
fn step<R: Real, const N: usize>(k: usize) -> R {
    real(TAU * k as f64 / N as f64)
}

/// The first harmonic of N readings over a turn.
struct Harmonic<R> {
    mean: R,
    cos: R,
    sin: R,
}

impl<R: Real> Harmonic<R> {
    fn of<const N: usize>(readings: [R; N]) -> Self {
        let share: R = real(1.0 / N as f64);
        let (mut mean, mut cos, mut sin) = (R::zero(), R::zero(), R::zero());
        for (k, y) in readings.into_iter().enumerate() {
            let angle = step::<R, N>(k);
            let share_of_y = share * y;
            mean += share_of_y;
            cos += (share_of_y + share_of_y) * angle.cos();
            sin += (share_of_y + share_of_y) * angle.sin();
        }
        Self { mean, cos, sin }
    }

    /// Of what an axis reads.
    fn along<const N: usize>(turn: &[Pose; N], axis: usize) -> Self {
        Self::of(readings(turn, axis))
    }

    fn size(&self) -> R {
        self.cos.hypot(self.sin)
    }

    fn phase(&self) -> R {
        self.sin.atan2(self.cos)
    }
}

fn readings<R: Real, const N: usize>(turn: &[Pose; N], axis: usize) -> [R; N] {
    turn.each_ref().map(|pose| real(pose.mean_mps2[axis]))
}

fn turns<R: Real, const N: usize>(
    poses: &[Pose],
    gravity: Gravity,
    placement: Placement,
    method: Method,
) -> Result<Estimate, Refusal> {
    input::check(poses.iter(), gravity)?;
    let (whole, rest) = poses.as_chunks::<N>();
    if whole.is_empty() || !rest.is_empty() {
        return Err(Refusal::NotATurn {
            pose: N * whole.len(),
            steps: N,
        });
    }
    let g = gravity.mps2();
    let gravity_mps2: R = real(g);
    let quarter: R = real(0.25);
    let mut axes: [Option<Axis<R>>; 3] = [None; 3];
    let mut checks = 0;
    for (number, turn) in whole.iter().enumerate() {
        let pose = N * number;
        let [a, b, still] = plane::<R, N>(turn, g).ok_or(Refusal::NotATurn { pose, steps: N })?;
        let off_rad = step_error::<R, N>(turn, [a, b], g);
        if off_rad > MOST_STEP_ERROR {
            return Err(Refusal::StepsUnequal {
                pose,
                steps: N,
                off_rad,
            });
        }
        let lean = Harmonic::<R>::along(turn, still).size() / gravity_mps2;
        if double(lean) > MOST_LEAN {
            return Err(Refusal::TurnTilted {
                pose,
                steps: N,
                off_rad: double(lean),
            });
        }
        // Unequal steps make of two axes what no usual sensor has; of three nothing else shows them.
        let unlike = elliptic::<R, N>(turn, [a, b]) / USUAL_ELLIPTIC;
        let seen_rad = if N == 3 && unlike > BEYOND_USUAL {
            let of_steps = USUAL_ELLIPTIC * libm::sqrt(unlike * unlike - 1.0);
            BY_TWO_NUMBERS * of_steps * libm::sqrt(N as f64 / ELLIPTIC_OF_STEPS)
        } else {
            0.0
        };
        let steps_sd_rad = libm::hypot(placement.sd_rad(), seen_rad);
        for axis in [a, b] {
            let said = one_axis(turn, axis, gravity_mps2, placement.sd_rad());
            let mut found = Axis {
                bias: said.bias,
                scale: said.scale,
                ..one_axis(turn, axis, gravity_mps2, steps_sd_rad)
            };
            if double(lean) > BEYOND_CHANCE * libm::hypot(placement.sd_rad(), CROSS_AXIS) {
                // It shortens one of them or both.
                found.scale_variance += quarter * lean * lean * lean * lean;
            }
            axes[axis] = Some(match axes[axis] {
                Some(before) => {
                    checks += 2;
                    before.merge(found)
                }
                None => found,
            });
            checks += N - 3;
        }
    }

    // How far from level each turn was, going by the bias that the others tell.
    for (number, turn) in whole.iter().enumerate() {
        let Some([_, _, still]) = plane::<R, N>(turn, g) else {
            continue;
        };
        let reads = Harmonic::<R>::along(turn, still).mean;
        // What it may be off by: a bias that nothing shows is as large as usual.
        let either = libm::hypot(USUAL_BIAS_MPS2 / g, placement.sd_rad());
        let (off, most) = match axes[still] {
            Some(known) => ((reads - known.bias) / gravity_mps2, MOST_STEP_ERROR),
            None => (reads / gravity_mps2, BEYOND_CHANCE * either),
        };
        let off_rad = double(off.abs());
        if off_rad > most {
            return Err(Refusal::TurnTilted {
                pose: N * number,
                steps: N,
                off_rad,
            });
        }
        let doubtful = match axes[still] {
            Some(_) => BEYOND_CHANCE * placement.sd_rad(),
            None => DOUBTFUL * either,
        };
        if off_rad > doubtful {
            let in_plane = axes
                .iter_mut()
                .enumerate()
                .filter(|(axis, _)| *axis != still);
            let across = off * real::<R>(CROSS_AXIS * g);
            for found in in_plane.filter_map(|(_, found)| found.as_mut()) {
                found.scale_variance += quarter * off * off * off * off;
                found.bias_variance += across * across;
            }
        }
    }

    // What was declared holds unless the readings contradict it beyond chance.
    let misfits = axes.iter().flatten().map(|axis| double(axis.misfit));
    let misfit: f64 = misfits.sum();
    let contradicted = checks > 0 && misfit > student::chi_squared_half_percent(checks);
    let inflation = if contradicted {
        misfit / checks as f64
    } else {
        1.0
    };
    let mut error_terms = ErrorTerms::default();
    let mut theta = PERFECT;
    let mut covariance = Covariance::ZERO;
    for (axis, found) in axes.iter().enumerate() {
        let Some(found) = found else {
            // Its scale factor is not this method's, and gravity tells nothing of it.
            theta[3 + 4 * axis] = 0.0;
            continue;
        };
        let (bias, scale) = (Parameter::ALL[axis], Parameter::ALL[3 + 4 * axis]);
        error_terms.bias_mps2[axis] = double(found.bias);
        error_terms.matrix[axis][axis] = double(found.scale);
        theta[3 + 4 * axis] = double(found.scale);
        covariance.add(bias, bias, inflation * double(found.bias_variance));
        covariance.add(scale, scale, inflation * double(found.scale_variance));
        covariance.add(bias, scale, inflation * double(found.both));
        covariance.add(scale, bias, inflation * double(found.both));
    }
    let fitted: Parameters = axes
        .iter()
        .enumerate()
        .filter(|(_, found)| found.is_some())
        .flat_map(|(axis, _)| [Parameter::ALL[axis], Parameter::ALL[3 + 4 * axis]])
        .collect();
    let model = ErrorModel::new(error_terms).map_err(Refusal::OutOfBounds)?;
    covariance.add_gravity(&theta, gravity);
    covariance.take_for_granted(Parameters::ALL.without(fitted));
    let residuals = Residuals::of(&terms::theta_of(&model).map(real::<R>), poses.iter(), g);
    Ok(Estimate {
        model,
        method,
        terms: Terms::NONE,
        fitted,
        worst_sd_mps2: force::worst_sd(&PERFECT.map(real::<R>), &covariance, g),
        covariance,
        term_sd: TermDeviations::default(),
        gravity,
        poses: poses.len(),
        orientations: Visits::of(poses).orientations(),
        dof: checks,
        interval_dof: contradicted.then_some(checks as f64),
        rms_mps2: residuals.rms_mps2(),
        max_mps2: residuals.largest_mps2,
        worst_pose: residuals.worst_pose,
        loo_rms_mps2: None,
        loo_orientation_rms_mps2: None,
        rejected: Rejected::default(),
        // Mean and first harmonic of equal steps are orthogonal.
        condition: 1.0,
        coverage: design::coverage(poses),
        temperature_c: pose::mean_temperature(poses.iter()),
        temperature_range_c: None,
        drift: None,
    })
}

/// The two axes in the plane of a turn and the one it is about; `None` where it is none about an axis
/// of the sensor.
fn plane<R: Real, const N: usize>(turn: &[Pose; N], g: f64) -> Option<[usize; 3]> {
    let harmonics: [Harmonic<R>; 3] = core::array::from_fn(|axis| Harmonic::along(turn, axis));
    let size = |axis: usize| double(harmonics[axis].size()) / g;
    let mut in_plane = (0..3).filter(|axis| TURNS.contains(&size(*axis)));
    let (a, b) = (in_plane.next()?, in_plane.next()?);
    let still = 3 - a - b;
    let one_stays = in_plane.next().is_none() && size(still) < STAYS;
    // Two axes of one body, a quarter of a turn apart, in either direction.
    let quarter = double(quarter_off(&harmonics[a], &harmonics[b]));
    (one_stays && quarter.abs() < PI / 4.0).then_some([a, b, still])
}

/// How far two axes are from a quarter of a turn apart, rad.
fn quarter_off<R: Real>(a: &Harmonic<R>, b: &Harmonic<R>) -> R {
    let apart = (a.phase() - b.phase()).abs();
    apart.min(R::two_pi() - apart) - R::frac_pi_2()
}

/// How unequal the steps were, rad rms, as far as the readings tell: what two axes of one body cannot
/// read of equal steps.
fn step_error<R: Real, const N: usize>(turn: &[Pose; N], [a, b]: [usize; 2], g: f64) -> f64 {
    let elliptic = elliptic::<R, N>(turn, [a, b]);
    let shown = if elliptic > MOST_ELLIPTIC {
        elliptic * libm::sqrt(N as f64 / ELLIPTIC_OF_STEPS)
    } else {
        0.0
    };
    if N != 4 {
        return shown;
    }
    let odd = |axis: usize| odd(&readings::<R, N>(turn, axis));
    shown.max(double(odd(a).hypot(odd(b))) / (2.0 * g))
}

/// How far two axes are from alike and at right angles.
fn elliptic<R: Real, const N: usize>(turn: &[Pose; N], [a, b]: [usize; 2]) -> f64 {
    let [one, other] = [a, b].map(|axis| Harmonic::<R>::along(turn, axis));
    let longer = (one.size() / other.size()).ln();
    double(longer.hypot(quarter_off(&one, &other)))
}

/// Readings of even steps less those of odd ones.
fn odd<R: Real>(readings: &[R]) -> R {
    let signed = |(k, y): (usize, &R)| if k % 2 == 0 { *y } else { -*y };
    readings
        .iter()
        .enumerate()
        .map(signed)
        .fold(R::zero(), |sum, y| sum + y)
}

/// Equations (45) and (46).
fn one_axis<R: Real, const N: usize>(
    turn: &[Pose; N],
    axis: usize,
    g: R,
    placement_sd_rad: f64,
) -> Axis<R> {
    let n: R = real(N as f64);
    let two: R = real(2.0);
    let readings = readings::<R, N>(turn, axis);
    let harmonic = Harmonic::of(readings);
    let amplitude = harmonic.size();
    let begin = -harmonic.phase();
    let tilt: R = real(placement_sd_rad * placement_sd_rad);
    let cross: R = real(CROSS_AXIS * CROSS_AXIS);
    let (mut sum, mut along, mut across, mut both) = (R::zero(), R::zero(), R::zero(), R::zero());
    for (k, pose) in turn.iter().enumerate() {
        let (s, c) = (begin + step::<R, N>(k)).sin_cos();
        // Of one reading: a step that is off, an axis that is not level, noise.
        let variance =
            tilt * amplitude * amplitude * s * s + tilt * cross * g * g + real(pose.noise(axis));
        sum += variance;
        along += c * c * variance;
        across += s * s * variance;
        both += c * variance;
    }
    let odd = odd(&readings);
    let misfit = if N == 4 && sum > R::zero() {
        odd * odd / sum
    } else {
        R::zero()
    };
    // Second order: steps and tilts shorten the amplitude, what is across lengthens it.
    let four = two * two / (n * n);
    let shift = four * across / (two * amplitude * amplitude) - tilt;
    let spread = (two / n + real(1.0 / 8.0)) * tilt * tilt;
    let scale = amplitude / g / (R::one() + shift);
    Axis {
        bias: harmonic.mean,
        scale,
        bias_variance: sum / (n * n),
        scale_variance: four * along / (g * g) + spread * scale * scale,
        both: two / (n * n) * both / g,
        misfit,
    }
}
