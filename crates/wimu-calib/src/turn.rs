//! Calibration from a turn about a level axis in three or four equal steps [LW].

use core::f64::consts::{PI, TAU};

use wimu_model::{ErrorModel, ErrorTerms};

use crate::estimate::{Residuals, TermDeviations};
use crate::outliers::Rejected;
use crate::terms::{PERFECT, Terms};
use crate::{
    Covariance, Estimate, Gravity, Method, Parameter, Parameters, Placement, Pose, Refusal, design,
    estimate, force, input, pose, student,
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
/// What the axis that is turned about may read in step with the turn, in g: 5.7° from square.
const MOST_LEAN: f64 = 0.1;
/// What it may read on average, in g, where no turn shows its bias: 200 mg, or 11.5° from level.
const MOST_BIAS: f64 = 0.2;
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
#[derive(Clone, Copy, Default)]
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
    /// Of several turns: each value by its own weight.
    fn merge(self, other: Self) -> Self {
        let weight = |a: f64, b: f64| if a + b > 0.0 { b / (a + b) } else { 0.5 };
        let b = weight(self.bias_variance, other.bias_variance);
        let s = weight(self.scale_variance, other.scale_variance);
        let mix = |w: f64, x: f64, y: f64| w * x + (1.0 - w) * y;
        let square = |w: f64, x: f64, y: f64| w * w * x + (1.0 - w) * (1.0 - w) * y;
        Self {
            bias: mix(b, self.bias, other.bias),
            scale: mix(s, self.scale, other.scale),
            bias_variance: square(b, self.bias_variance, other.bias_variance),
            scale_variance: square(s, self.scale_variance, other.scale_variance),
            both: b * s * self.both + (1.0 - b) * (1.0 - s) * other.both,
            misfit: self.misfit + other.misfit,
        }
    }
}

/// The first harmonic of N readings over a turn.
struct Harmonic {
    mean: f64,
    cos: f64,
    sin: f64,
}

impl Harmonic {
    fn of<const N: usize>(readings: [f64; N]) -> Self {
        let n = N as f64;
        let (mut mean, mut cos, mut sin) = (0.0, 0.0, 0.0);
        for (k, y) in readings.into_iter().enumerate() {
            let angle = TAU * k as f64 / n;
            mean += y / n;
            cos += 2.0 / n * y * libm::cos(angle);
            sin += 2.0 / n * y * libm::sin(angle);
        }
        Self { mean, cos, sin }
    }

    /// Of what an axis reads.
    fn along<const N: usize>(turn: &[Pose; N], axis: usize) -> Self {
        Self::of(turn.each_ref().map(|pose| pose.mean_mps2[axis]))
    }

    fn size(&self) -> f64 {
        libm::sqrt(self.cos * self.cos + self.sin * self.sin)
    }

    fn phase(&self) -> f64 {
        libm::atan2(self.sin, self.cos)
    }
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
        let [a, b, still] = plane(turn, g).ok_or(Refusal::NotATurn { pose, steps: N })?;
        let off_rad = step_error(turn, [a, b], g);
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
        for axis in [a, b] {
            let mut found = one_axis(turn, axis, g, placement);
            if lean > BEYOND_CHANCE * libm::hypot(placement.sd_rad(), CROSS_AXIS) {
                // It shortens one of them or both.
                found.scale_variance += 0.25 * lean * lean * lean * lean;
            }
            axes[axis] = Some(match axes[axis] {
                Some(before) => before.merge(found),
                None => found,
            });
            checks += N - 3;
        }
    }

    // How far from level each turn was, going by the bias that the others tell.
    for (number, turn) in whole.iter().enumerate() {
        let Some([_, _, still]) = plane(turn, g) else {
            continue;
        };
        let reads = Harmonic::along(turn, still).mean;
        let (off, most) = match axes[still] {
            Some(known) => ((reads - known.bias) / g, MOST_STEP_ERROR),
            None => (reads / g, MOST_BIAS),
        };
        if off.abs() > most {
            return Err(Refusal::TurnTilted {
                pose: N * number,
                steps: N,
                off_rad: off.abs(),
            });
        }
        if axes[still].is_some() && off.abs() > BEYOND_CHANCE * placement.sd_rad() {
            let in_plane = axes
                .iter_mut()
                .enumerate()
                .filter(|(axis, _)| *axis != still);
            for found in in_plane.filter_map(|(_, found)| found.as_mut()) {
                found.scale_variance += 0.25 * off * off * off * off;
                found.bias_variance += off * off * CROSS_AXIS * CROSS_AXIS * g * g;
            }
        }
    }

    // What was declared holds unless the readings contradict it beyond chance.
    let misfit: f64 = axes.iter().flatten().map(|axis| axis.misfit).sum();
    let contradicted = checks > 0 && misfit > student::chi_squared_half_percent(checks);
    let inflation = if contradicted {
        misfit / checks as f64
    } else {
        1.0
    };
    let mut terms = ErrorTerms::default();
    let mut theta = PERFECT;
    let mut covariance = Covariance::ZERO;
    for (axis, found) in axes.iter().enumerate() {
        let Some(found) = found else {
            // Its scale factor is not this method's, and gravity tells nothing of it.
            theta[3 + 4 * axis] = 0.0;
            continue;
        };
        let (bias, scale) = (Parameter::ALL[axis], Parameter::ALL[3 + 4 * axis]);
        terms.bias_mps2[axis] = found.bias;
        terms.matrix[axis][axis] = found.scale;
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
    let model = ErrorModel::new(terms).map_err(Refusal::OutOfBounds)?;
    covariance.add_gravity(&theta, gravity);
    covariance.take_for_granted(Parameters::ALL.without(fitted));
    let mut residuals = Residuals::default();
    for (k, pose) in poses.iter().enumerate() {
        residuals.add(k, estimate::residual_mps2(&model, gravity, pose));
    }
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
        dof: checks,
        interval_dof: contradicted.then_some(checks as f64),
        rms_mps2: residuals.rms_mps2(),
        max_mps2: residuals.largest_mps2,
        worst_pose: residuals.worst_pose,
        loo_rms_mps2: None,
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
    let turned = |axis: &usize| TURNS.contains(&(harmonics[*axis].size() / g));
    let mut in_plane = (0..3).filter(turned);
    let (a, b) = (in_plane.next()?, in_plane.next()?);
    let still = 3 - a - b;
    let one_stays = in_plane.next().is_none() && harmonics[still].size() < STAYS * g;
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
    let [one, other] = [a, b].map(|axis| Harmonic::along(turn, axis));
    let longer = libm::log(one.size() / other.size());
    let elliptic = libm::hypot(longer, quarter_off(&one, &other));
    // A step error of σ makes it σ √(8/n) rms.
    let shown = if elliptic > MOST_ELLIPTIC {
        elliptic * libm::sqrt(N as f64 / 8.0)
    } else {
        0.0
    };
    if N != 4 {
        return shown;
    }
    let odd = |axis: usize| {
        let signs = [1.0, -1.0].into_iter().cycle();
        turn.iter()
            .zip(signs)
            .map(|(pose, sign)| sign * pose.mean_mps2[axis])
            .sum::<f64>()
    };
    shown.max(libm::hypot(odd(a), odd(b)) / (2.0 * g))
}

/// Equations (45) and (46).
fn one_axis<const N: usize>(turn: &[Pose; N], axis: usize, g: f64, placement: Placement) -> Axis {
    let n = N as f64;
    let readings = turn.each_ref().map(|pose| pose.mean_mps2[axis]);
    let harmonic = Harmonic::of(readings);
    let amplitude = harmonic.size();
    let begin = -harmonic.phase();
    let tilt = placement.sd_rad() * placement.sd_rad();
    let mut found = Axis::default();
    let (mut across, mut odd_variance, mut odd) = (0.0, 0.0, 0.0);
    for (k, pose) in turn.iter().enumerate() {
        let angle = begin + TAU * k as f64 / n;
        let (c, s) = (libm::cos(angle), libm::sin(angle));
        // Of one reading: a step that is off, an axis that is not level, noise.
        let variance = tilt * amplitude * amplitude * s * s
            + tilt * CROSS_AXIS * CROSS_AXIS * g * g
            + pose.noise(axis);
        found.bias_variance += variance / (n * n);
        found.scale_variance += 4.0 / (n * n) * c * c * variance / (g * g);
        found.both += 2.0 / (n * n) * c * variance / g;
        across += 4.0 / (n * n) * s * s * variance;
        let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
        odd += sign * readings[k];
        odd_variance += variance;
    }
    if N == 4 {
        found.misfit = if odd_variance > 0.0 {
            odd * odd / odd_variance
        } else {
            0.0
        };
    }
    // Second order: steps and tilts shorten the amplitude, what is across lengthens it.
    let shift = 0.5 * across / (amplitude * amplitude) - tilt;
    let spread = (2.0 / n + 1.0 / 8.0) * tilt * tilt;
    found.bias = harmonic.mean;
    found.scale = amplitude / g / (1.0 + shift);
    found.scale_variance += spread * found.scale * found.scale;
    found
}
