//! Calibration from a rotation about a horizontal axis in three or four equal steps [LW].

use alloc::format;
use core::f64::consts::{PI, TAU};

use wimu_model::{ErrorModel, ErrorTerms};

use crate::estimate::Residuals;

use crate::terms::{self, PERFECT, USUAL_BIAS_MPS2};
use crate::visits::Visits;
use crate::{
    Covariance, Estimate, Gravity, Method, Parameter, Parameters, Placement, Pose, Reason, Refusal,
    design, force, input, pose, student,
};

/// Component of an axis along another one, 1 σ: the cross-axis sensitivity of typical datasheets.
const CROSS_AXIS: f64 = 0.02;
/// Amplitude of the first harmonic, g: of axes in the plane of rotation, and largest of the axis of
/// rotation.
const TURNS: core::ops::Range<f64> = 0.5..1.5;
const STAYS: f64 = 0.5;
/// Largest rms deviation of the steps from equal ones, rad: 5°, which changes the scale factor by
/// 0.4 %.
const MOST_STEP_ERROR: f64 = 0.0873;
/// Largest deviation of two axes from equal sensitivity and orthogonality that is not taken for
/// unequal steps: twice 3 % of sensitivity, twice 2 % cross-axis, and a step error of 5°.
const MOST_ELLIPTIC: f64 = 0.15;
/// A step error of standard deviation σ causes a deviation of σ √(8/n) rms.
const ELLIPTIC_OF_STEPS: f64 = 8.0;
/// Largest first harmonic of the axis of rotation, g: 5.7° from orthogonal.
const MOST_LEAN: f64 = 0.1;
/// If no rotation determines the bias of the axis of rotation, its reading may be bias or tilt.
/// Above this many standard deviations of both, it counts as both.
const DOUBTFUL: f64 = 2.0;
/// Deviation of two axes of a typical sensor from equal sensitivity and orthogonality, 1 σ: 3 %
/// sensitivity and 2 % cross-axis for each; and the multiple of it that is taken for unequal steps.
const USUAL_ELLIPTIC: f64 = 0.051;
const BEYOND_USUAL: f64 = 1.4;
/// Upper bound on a standard deviation estimated from two numbers, relative to the estimate.
const BY_TWO_NUMBERS: f64 = 2.0;
/// Significance threshold, standard deviations.
const BEYOND_CHANCE: f64 = 3.3;

/// Bias and scale factor from rotations in four steps of 90° about a horizontal axis: equations
/// (45) to (47).
///
/// `poses` are in m/s² by the nominal sensitivity, sensor axes, four to a rotation, in the order in
/// which they were taken. A rotation may start anywhere and go in either direction. Each one
/// determines the two axes in its plane, which are identified by their readings; rotations about
/// two different axes determine all three. Other parameters stay those of a perfect sensor and are
/// not in [`Estimate::fitted`]. The scale factor is the in-plane norm of the row of A: S without
/// misalignment, larger by half the squared misalignment otherwise. `placement` is the error of a
/// step, and of the axis of rotation from horizontal.
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

/// [`four_angle`] with rotations in three steps of 120°.
///
/// Three readings determine bias, scale factor and initial angle: no redundancy is left for a
/// check.
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

/// Bias and scale factor of one axis with their covariance, without the error of gravity.
#[derive(Clone, Copy)]
struct Axis {
    bias: f64,
    scale: f64,
    bias_variance: f64,
    scale_variance: f64,
    both: f64,
    /// χ² of the redundant readings.
    misfit: f64,
}

impl Axis {
    /// Weighted mean of two rotations. Their difference adds to `misfit`.
    fn merge(self, other: Self) -> Self {
        let apart = |a: f64, b: f64, variance: f64| {
            if variance > 0.0 { (a - b) * (a - b) / variance } else { 0.0 }
        };
        // The in-plane norm differs between planes by half the squared cross-axis components.
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

    /// Of the readings of an axis.
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
        return Err(not_a_turn::<N>(N * whole.len()));
    }
    let g = gravity.mps2();
    let mut axes: [Option<Axis>; 3] = [None; 3];
    let mut checks = 0;
    for (number, turn) in whole.iter().enumerate() {
        let pose = N * number;
        let [a, b, still] = plane::<N>(turn, g).ok_or_else(|| not_a_turn::<N>(pose))?;
        let off_rad = step_error::<N>(turn, [a, b], g);
        if off_rad > MOST_STEP_ERROR {
            return Err(refusal::<N>(
                pose,
                &format!(
                    "the steps are at least {:.0}° rms from equal steps of {}°; turn the sensor by a square or a protractor, or \
                 use multi-position, which needs no known orientation",
                    off_rad.to_degrees(),
                    360 / N
                ),
            ));
        }
        let lean = Harmonic::along(turn, still).size() / g;
        if lean > MOST_LEAN {
            return Err(tilted::<N>(pose, lean));
        }
        // Unequal steps distort the two axes beyond a typical sensor; with three steps nothing else
        // shows them.
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
                // A tilt shortens one of the axes or both.
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

    // Tilt of each axis of rotation, with the bias from the other rotations.
    for (number, turn) in whole.iter().enumerate() {
        let Some([_, _, still]) = plane::<N>(turn, g) else {
            continue;
        };
        let reads = Harmonic::along(turn, still).mean;
        // Standard deviation of the reading if no rotation determines the bias.
        let either = libm::hypot(USUAL_BIAS_MPS2 / g, placement.sd_rad());
        let (off, most) = match axes[still] {
            Some(known) => ((reads - known.bias) / g, MOST_STEP_ERROR),
            None => (reads / g, BEYOND_CHANCE * either),
        };
        let off_rad = off.abs();
        if off_rad > most {
            return Err(tilted::<N>(N * number, off_rad));
        }
        let doubtful = match axes[still] {
            Some(_) => BEYOND_CHANCE * placement.sd_rad(),
            None => DOUBTFUL * either,
        };
        if off_rad > doubtful {
            let in_plane = axes.iter_mut().enumerate().filter(|(axis, _)| *axis != still);
            let across = off * (CROSS_AXIS * g);
            for found in in_plane.filter_map(|(_, found)| found.as_mut()) {
                found.scale_variance += 0.25 * off * off * off * off;
                found.bias_variance += across * across;
            }
        }
    }

    // The declared placement error is used unless the readings contradict it significantly.
    let misfits = axes.iter().flatten().map(|axis| axis.misfit);
    let misfit: f64 = misfits.sum();
    let contradicted = checks > 0 && misfit > student::chi_squared_half_percent(checks);
    let inflation = if contradicted { misfit / checks as f64 } else { 1.0 };
    let mut error_terms = ErrorTerms::default();
    let mut theta = PERFECT;
    let mut covariance = Covariance::ZERO;
    for (axis, found) in axes.iter().enumerate() {
        let Some(found) = found else {
            // Not estimated by this method, and not affected by gravity.
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
    let model = ErrorModel::new(error_terms)
        .map_err(|error| Refusal::out_of_bounds(error, "an accelerometer"))?;
    covariance.add_gravity(&theta, gravity);
    covariance.take_for_granted(Parameters::ALL.without(fitted));
    let residuals = Residuals::of(&terms::theta_of(&model), poses.iter(), g);
    Ok(Estimate {
        fitted,
        worst_sd_mps2: force::worst_sd(&PERFECT, &covariance, g),
        covariance,
        poses: poses.len(),
        orientations: Visits::of(poses).orientations(),
        dof: checks,
        interval_dof: contradicted.then_some(checks as f64),
        coverage: design::coverage(poses),
        temperature_c: pose::mean_temperature(poses.iter()),
        ..Estimate::orthogonal(model, method, gravity, &residuals)
    })
}

/// The refusal of the rotation that begins with pose `index`.
fn refusal<const N: usize>(index: usize, why: &str) -> Refusal {
    let text = format!("poses {index} to {} (from 0): {why}", index + N - 1);
    Refusal::new(Reason::Placement { index, steps: N }, text)
}

fn not_a_turn<const N: usize>(index: usize) -> Refusal {
    let why = format!(
        "they are not {N} steps of {}° about a horizontal axis: rotate about one axis of the sensor, in one direction, \
         and hold it still at each step",
        360 / N
    );
    refusal::<N>(index, &why)
}

fn tilted<const N: usize>(index: usize, off_rad: f64) -> Refusal {
    let why = format!(
        "according to the reading of the axis of rotation, it is {:.0}° from level or from the axis of the sensor; square \
         the sensor and level the axis, or use multi-position, which needs neither",
        off_rad.to_degrees()
    );
    refusal::<N>(index, &why)
}

/// The two axes in the plane of rotation and the axis of rotation; `None` if the rotation is not
/// about an axis of the sensor.
fn plane<const N: usize>(turn: &[Pose; N], g: f64) -> Option<[usize; 3]> {
    let harmonics: [Harmonic; 3] = core::array::from_fn(|axis| Harmonic::along(turn, axis));
    let size = |axis: usize| harmonics[axis].size() / g;
    let mut in_plane = (0..3).filter(|axis| TURNS.contains(&size(*axis)));
    let (a, b) = (in_plane.next()?, in_plane.next()?);
    let still = 3 - a - b;
    let one_stays = in_plane.next().is_none() && size(still) < STAYS;
    // The phases of the two axes differ by a quarter of a turn, in either direction.
    let quarter = quarter_off(&harmonics[a], &harmonics[b]);
    (one_stays && quarter.abs() < PI / 4.0).then_some([a, b, still])
}

/// Deviation of the phase difference of two axes from a quarter of a turn, rad.
fn quarter_off(a: &Harmonic, b: &Harmonic) -> f64 {
    let apart = (a.phase() - b.phase()).abs();
    apart.min(TAU - apart) - PI / 2.0
}

/// Lower bound on the step error, rad rms: the part of the readings that equal steps cannot cause.
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

/// Deviation of two axes from equal amplitude and quadrature.
fn elliptic<const N: usize>(turn: &[Pose; N], [a, b]: [usize; 2]) -> f64 {
    let [one, other] = [a, b].map(|axis| Harmonic::along(turn, axis));
    let longer = libm::log(one.size() / other.size());
    libm::hypot(longer, quarter_off(&one, &other))
}

/// Sum of the readings of even steps minus that of odd steps.
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
        // Variance of one reading: step error, tilt of the axis of rotation, noise.
        let variance =
            tilt * amplitude * amplitude * s * s + tilt * cross * g * g + pose.noise(axis);
        sum += variance;
        along += c * c * variance;
        across += s * s * variance;
        both += c * variance;
    }
    let odd = odd(&readings);
    let misfit = if N == 4 && sum > 0.0 { odd * odd / sum } else { 0.0 };
    // Second order: step errors and tilts reduce the amplitude, cross-axis errors increase it.
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
