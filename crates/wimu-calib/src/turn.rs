//! Calibration from a turn about a level axis in three or four equal steps [LW].

use core::f64::consts::{PI, TAU};

use wimu_model::{ErrorModel, ErrorTerms};

use crate::estimate::{Residuals, TermDeviations};

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
    turns::<4>(poses, gravity, placement, Method::FourAngle)
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
    turns::<3>(poses, gravity, placement, Method::ThreeAngle)
}

/// Bias and scale factor of one axis with their covariance, before the error of gravity.
#[derive(Clone, Copy)]
struct Axis {
    bias: f64,
    scale: f64,
    bias_variance: f64,
    scale_variance: f64,
    both: f64,
    /// What the readings say beyond three unknowns: its square over its variance.
    misfit: f64,
}

impl Axis {
    /// Of several turns: each value by its own weight. What they differ by is another check.
    fn merge(self, other: Self) -> Self {
        let apart = |a: f64, b: f64, variance: f64| {
            if variance > 0.0 {
                (a - b) * (a - b) / variance
            } else {
                0.0
            }
        };
        // In two planes the norms of one row differ by the squares of what is across, halved.
        let across = CROSS_AXIS * CROSS_AXIS;
        let of_scale = self.scale_variance + other.scale_variance + across * across;
        let of_bias = self.bias_variance + other.bias_variance;
        let differ =
            apart(self.bias, other.bias, of_bias) + apart(self.scale, other.scale, of_scale);
        let weight = |a: f64, b: f64| {
            if a + b > 0.0 { b / (a + b) } else { 0.5 }
        };
        let b = weight(self.bias_variance, other.bias_variance);
        let s = weight(self.scale_variance, other.scale_variance);
        let rest = |w: f64| 1.0 - w;
        let mix = |w: f64, x: f64, y: f64| w * x + rest(w) * y;
        let square = |w: f64, x: f64, y: f64| w * w * x + rest(w) * rest(w) * y;
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
fn step<const N: usize>(k: usize) -> f64 {
    TAU * k as f64 / N as f64
}

/// The first harmonic of N readings over a turn.
struct Harmonic {
    mean: f64,
    cos: f64,
    sin: f64,
}

impl Harmonic {
    fn of<const N: usize>(readings: [f64; N]) -> Self {
        let share = 1.0 / N as f64;
        let (mut mean, mut cos, mut sin) = (0.0, 0.0, 0.0);
        for (k, y) in readings.into_iter().enumerate() {
            let angle = step::<N>(k);
            let share_of_y = share * y;
            mean += share_of_y;
            cos += (share_of_y + share_of_y) * libm::cos(angle);
            sin += (share_of_y + share_of_y) * libm::sin(angle);
        }
        Self { mean, cos, sin }
    }

    /// Of what an axis reads.
    fn along<const N: usize>(turn: &[Pose; N], axis: usize) -> Self {
        Self::of(readings(turn, axis))
    }

    fn size(&self) -> f64 {
        libm::hypot(self.cos, self.sin)
    }

    fn phase(&self) -> f64 {
        libm::atan2(self.sin, self.cos)
    }
}

fn readings<const N: usize>(turn: &[Pose; N], axis: usize) -> [f64; N] {
    turn.each_ref().map(|pose| pose.mean_mps2[axis])
}

fn turns<const N: usize>(
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
    let mut axes: [Option<Axis>; 3] = [None; 3];
    let mut checks = 0;
    for (number, turn) in whole.iter().enumerate() {
        let pose = N * number;
        let [a, b, still] = plane::<N>(turn, g).ok_or(Refusal::NotATurn { pose, steps: N })?;
        let off_rad = step_error::<N>(turn, [a, b], g);
        if off_rad > MOST_STEP_ERROR {
            return Err(Refusal::StepsUnequal {
                pose,
                steps: N,
                off_rad,
            });
        }
        let lean = Harmonic::along(turn, still).size() / g;
        if lean > MOST_LEAN {
            return Err(Refusal::TurnTilted {
                pose,
                steps: N,
                off_rad: lean,
            });
        }
        // Unequal steps make of two axes what no usual sensor has; of three nothing else shows them.
        let unlike = elliptic::<N>(turn, [a, b]) / USUAL_ELLIPTIC;
        let seen_rad = if N == 3 && unlike > BEYOND_USUAL {
            let of_steps = USUAL_ELLIPTIC * libm::sqrt(unlike * unlike - 1.0);
            BY_TWO_NUMBERS * of_steps * libm::sqrt(N as f64 / ELLIPTIC_OF_STEPS)
        } else {
            0.0
        };
        let steps_sd_rad = libm::hypot(placement.sd_rad(), seen_rad);
        for axis in [a, b] {
            let said = one_axis(turn, axis, g, placement.sd_rad());
            let mut found = Axis {
                bias: said.bias,
                scale: said.scale,
                ..one_axis(turn, axis, g, steps_sd_rad)
            };
            if lean > BEYOND_CHANCE * libm::hypot(placement.sd_rad(), CROSS_AXIS) {
                // It shortens one of them or both.
                found.scale_variance += 0.25 * lean * lean * lean * lean;
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
        let Some([_, _, still]) = plane::<N>(turn, g) else {
            continue;
        };
        let reads = Harmonic::along(turn, still).mean;
        // What it may be off by: a bias that nothing shows is as large as usual.
        let either = libm::hypot(USUAL_BIAS_MPS2 / g, placement.sd_rad());
        let (off, most) = match axes[still] {
            Some(known) => ((reads - known.bias) / g, MOST_STEP_ERROR),
            None => (reads / g, BEYOND_CHANCE * either),
        };
        let off_rad = off.abs();
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
            let across = off * (CROSS_AXIS * g);
            for found in in_plane.filter_map(|(_, found)| found.as_mut()) {
                found.scale_variance += 0.25 * off * off * off * off;
                found.bias_variance += across * across;
            }
        }
    }

    // What was declared holds unless the readings contradict it beyond chance.
    let misfits = axes.iter().flatten().map(|axis| axis.misfit);
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
        error_terms.bias_mps2[axis] = found.bias;
        error_terms.matrix[axis][axis] = found.scale;
        theta[3 + 4 * axis] = found.scale;
        covariance.add(bias, bias, inflation * found.bias_variance);
        covariance.add(scale, scale, inflation * found.scale_variance);
        covariance.add(bias, scale, inflation * found.both);
        covariance.add(scale, bias, inflation * found.both);
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
    let residuals = Residuals::of(&terms::theta_of(&model), poses.iter(), g);
    Ok(Estimate {
        model,
        method,
        terms: Terms::NONE,
        fitted,
        worst_sd_mps2: force::worst_sd(&PERFECT, &covariance, g),
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
fn plane<const N: usize>(turn: &[Pose; N], g: f64) -> Option<[usize; 3]> {
    let harmonics: [Harmonic; 3] = core::array::from_fn(|axis| Harmonic::along(turn, axis));
    let size = |axis: usize| harmonics[axis].size() / g;
    let mut in_plane = (0..3).filter(|axis| TURNS.contains(&size(*axis)));
    let (a, b) = (in_plane.next()?, in_plane.next()?);
    let still = 3 - a - b;
    let one_stays = in_plane.next().is_none() && size(still) < STAYS;
    // Two axes of one body, a quarter of a turn apart, in either direction.
    let quarter = quarter_off(&harmonics[a], &harmonics[b]);
    (one_stays && quarter.abs() < PI / 4.0).then_some([a, b, still])
}

/// How far two axes are from a quarter of a turn apart, rad.
fn quarter_off(a: &Harmonic, b: &Harmonic) -> f64 {
    let apart = (a.phase() - b.phase()).abs();
    apart.min(TAU - apart) - PI / 2.0
}

/// How unequal the steps were, rad rms, as far as the readings tell: what two axes of one body cannot
/// read of equal steps.
fn step_error<const N: usize>(turn: &[Pose; N], [a, b]: [usize; 2], g: f64) -> f64 {
    let elliptic = elliptic::<N>(turn, [a, b]);
    let shown = if elliptic > MOST_ELLIPTIC {
        elliptic * libm::sqrt(N as f64 / ELLIPTIC_OF_STEPS)
    } else {
        0.0
    };
    if N != 4 {
        return shown;
    }
    let odd = |axis: usize| odd(&readings::<N>(turn, axis));
    shown.max(libm::hypot(odd(a), odd(b)) / (2.0 * g))
}

/// How far two axes are from alike and at right angles.
fn elliptic<const N: usize>(turn: &[Pose; N], [a, b]: [usize; 2]) -> f64 {
    let [one, other] = [a, b].map(|axis| Harmonic::along(turn, axis));
    let longer = libm::log(one.size() / other.size());
    libm::hypot(longer, quarter_off(&one, &other))
}

/// Readings of even steps less those of odd ones.
fn odd(readings: &[f64]) -> f64 {
    let signed = |(k, y): (usize, &f64)| if k % 2 == 0 { *y } else { -*y };
    readings.iter().enumerate().map(signed).sum()
}

/// Equations (45) and (46).
fn one_axis<const N: usize>(turn: &[Pose; N], axis: usize, g: f64, placement_sd_rad: f64) -> Axis {
    let n = N as f64;
    let readings = readings::<N>(turn, axis);
    let harmonic = Harmonic::of(readings);
    let amplitude = harmonic.size();
    let begin = -harmonic.phase();
    let tilt = placement_sd_rad * placement_sd_rad;
    let cross = CROSS_AXIS * CROSS_AXIS;
    let (mut sum, mut along, mut across, mut both) = (0.0, 0.0, 0.0, 0.0);
    for (k, pose) in turn.iter().enumerate() {
        let (s, c) = libm::sincos(begin + step::<N>(k));
        // Of one reading: a step that is off, an axis that is not level, noise.
        let variance =
            tilt * amplitude * amplitude * s * s + tilt * cross * g * g + pose.noise(axis);
        sum += variance;
        along += c * c * variance;
        across += s * s * variance;
        both += c * variance;
    }
    let odd = odd(&readings);
    let misfit = if N == 4 && sum > 0.0 {
        odd * odd / sum
    } else {
        0.0
    };
    // Second order: steps and tilts shorten the amplitude, what is across lengthens it.
    let four = 2.0 * 2.0 / (n * n);
    let shift = four * across / (2.0 * amplitude * amplitude) - tilt;
    let spread = (2.0 / n + 1.0 / 8.0) * tilt * tilt;
    let scale = amplitude / g / (1.0 + shift);
    Axis {
        bias: harmonic.mean,
        scale,
        bias_variance: sum / (n * n),
        scale_variance: four * along / (g * g) + spread * scale * scale,
        both: 2.0 / (n * n) * both / g,
        misfit,
    }
}
