//! Calibration from a rotation about a horizontal axis in three or four equal steps [LW].

use alloc::format;
use alloc::vec::Vec;
use core::f64::consts::{PI, TAU};

use wimu_model::{CalibrationMethod, ErrorModel, ErrorTerms};

use crate::estimate::Residuals;
use crate::terms::{self, PERFECT, USUAL_BIAS_MPS2};
use crate::visits::Visits;
use crate::{
    Covariance, Estimate, Gravity, Parameter, Parameters, Placement, Pose, Reason, Refusal, force,
    input, pose, student,
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
    turns(poses, 4, gravity, placement)
}

/// [`four_angle`] with rotations in three steps of 120°.
///
/// Three readings determine bias, scale factor and initial angle: no redundancy is left for a
/// check.
///
/// # Errors
/// [`Refusal`] when the poses are not such turns or the result is no accelerometer's.
pub fn three_angle(
    poses: &[Pose],
    gravity: Gravity,
    placement: Placement,
) -> Result<Estimate, Refusal> {
    turns(poses, 3, gravity, placement)
}

/// Bias, m/s², and scale factor of one axis with their covariance, without the error of gravity.
#[derive(Clone, Copy)]
struct Axis {
    value: [f64; 2],
    variance: [f64; 2],
    both: f64,
    /// χ² of the redundant readings.
    misfit: f64,
}

impl Axis {
    /// Weighted mean of two rotations. Their difference adds to `misfit`.
    fn merge(mut self, other: Self) -> Self {
        self.misfit += other.misfit;
        let mut weight = [0.5; 2];
        // The in-plane norm differs between planes by half the squared cross-axis components.
        for (i, across) in [0.0, CROSS_AXIS * CROSS_AXIS].into_iter().enumerate() {
            let sum = self.variance[i] + other.variance[i];
            let apart = other.value[i] - self.value[i];
            if sum > 0.0 {
                weight[i] = self.variance[i] / sum;
            }
            if sum + across > 0.0 {
                self.misfit += apart * apart / (sum + across * across);
            }
            let (w, v) = (weight[i], 1.0 - weight[i]);
            self.value[i] += w * apart;
            self.variance[i] = v * v * self.variance[i] + w * w * other.variance[i];
        }
        let [b, s] = weight;
        self.both = (1.0 - b) * (1.0 - s) * self.both + b * s * other.both;
        self
    }
}

/// The first harmonic of the readings over a rotation in equal steps.
struct Harmonic {
    mean: f64,
    cos: f64,
    sin: f64,
}

impl Harmonic {
    fn of(readings: &[f64]) -> Self {
        let share = 1.0 / readings.len() as f64;
        let (mut mean, mut cos, mut sin) = (0.0, 0.0, 0.0);
        for (k, y) in readings.iter().enumerate() {
            let angle = TAU * k as f64 * share;
            mean += share * y;
            cos += 2.0 * share * y * libm::cos(angle);
            sin += 2.0 * share * y * libm::sin(angle);
        }
        Self { mean, cos, sin }
    }

    fn size(&self) -> f64 {
        libm::hypot(self.cos, self.sin)
    }

    fn phase(&self) -> f64 {
        libm::atan2(self.sin, self.cos)
    }
}

/// A rotation about an axis of the sensor.
struct Turn<'a> {
    /// Index of its first pose.
    first: usize,
    poses: &'a [Pose],
    /// The two axes in the plane of rotation, and the axis of rotation.
    plane: [usize; 2],
    still: usize,
}

fn turns(
    poses: &[Pose],
    steps: usize,
    gravity: Gravity,
    placement: Placement,
) -> Result<Estimate, Refusal> {
    input::check(poses.iter(), gravity)?;
    let g = gravity.mps2();
    let whole = poses.chunks_exact(steps);
    if poses.len() < steps || !whole.remainder().is_empty() {
        return Err(incomplete(poses.len(), steps));
    }
    let turns = whole.enumerate().map(|(number, poses)| Turn::new(number * steps, poses, g));
    let turns = turns.collect::<Result<Vec<Turn<'_>>, Refusal>>()?;
    let mut axes: [Option<Axis>; 3] = [None; 3];
    // Redundant readings: of four steps one, of a repeated axis two.
    let mut checks = 0;
    for turn in &turns {
        for axis in turn.plane {
            let found = turn.axis(axis, g, placement.sd_rad());
            checks += steps - 3 + if axes[axis].is_some() { 2 } else { 0 };
            axes[axis] = Some(axes[axis].map_or(found, |before| before.merge(found)));
        }
    }
    for turn in &turns {
        turn.level(&mut axes, g, placement.sd_rad())?;
    }
    // The declared placement error is used unless the readings contradict it significantly.
    let misfit: f64 = axes.iter().flatten().map(|axis| axis.misfit).sum();
    let contradicted = checks > 0 && misfit > student::chi_squared_half_percent(checks);
    let inflation = if contradicted { misfit / checks as f64 } else { 1.0 };
    let mut error_terms = ErrorTerms::default();
    let mut theta = PERFECT;
    let mut covariance = Covariance::ZERO;
    let mut fitted = Parameters::default();
    for (axis, found) in axes.iter().enumerate() {
        let Some(found) = found else {
            // Not estimated by this method, and not affected by gravity.
            theta[3 + 4 * axis] = 0.0;
            continue;
        };
        let (bias, scale) = (Parameter::BIAS[axis], Parameter::SCALE[axis]);
        fitted = fitted.with(bias).with(scale);
        error_terms.bias_mps2[axis] = found.value[0];
        error_terms.matrix[axis][axis] = found.value[1];
        theta[3 + 4 * axis] = found.value[1];
        for (k, parameter) in [bias, scale].into_iter().enumerate() {
            covariance.add(parameter, parameter, inflation * found.variance[k]);
        }
        covariance.add(bias, scale, inflation * found.both);
        covariance.add(scale, bias, inflation * found.both);
    }
    let model = ErrorModel::new(error_terms)
        .map_err(|error| Refusal::out_of_bounds(error, "an accelerometer"))?;
    covariance.add_gravity(&theta, gravity);
    covariance.take_for_granted(Parameters::ALL.without(fitted));
    let residuals = Residuals::of(force::residuals(&terms::theta_of(&model), poses, g));
    let method = match steps {
        4 => CalibrationMethod::FourAngle,
        _ => CalibrationMethod::ThreeAngle,
    };
    Ok(Estimate {
        fitted,
        worst_sd_mps2: force::worst_sd(&PERFECT, &covariance, g),
        covariance,
        poses: poses.len(),
        orientations: Visits::of(poses).orientations(),
        dof: checks,
        interval_dof: contradicted.then_some(checks as f64),
        temperature_c: pose::mean_temperature(poses.iter()),
        ..Estimate::orthogonal(model, method, gravity, &residuals)
    })
}

/// The refusal of the rotation of `steps` that begins with pose `index`.
fn refusal(index: usize, steps: usize, why: &str) -> Refusal {
    let text = format!("poses {index} to {} (from 0): {why}", index + steps - 1);
    Refusal::new(Reason::Placement { index, steps }, text)
}

fn incomplete(poses: usize, steps: usize) -> Refusal {
    let (index, left, degrees) = (poses - poses % steps, poses % steps, 360 / steps);
    let text = format!(
        "The last rotation has {left} of {steps} steps of {degrees}° about a level axis. Give {steps} poses for each rotation, \
         in order, and no others; hold the sensor still for two seconds at each step."
    );
    Refusal::new(Reason::Placement { index, steps }, text)
}

fn not_a_turn(index: usize, steps: usize) -> Refusal {
    let why = format!(
        "they are not {steps} steps of {}° about a horizontal axis: rotate about one axis of the sensor, in one direction, \
         and hold it still at each step",
        360 / steps
    );
    refusal(index, steps, &why)
}

/// Deviation of the phase difference of two axes from a quarter of a turn, rad.
fn quarter_off(a: &Harmonic, b: &Harmonic) -> f64 {
    let apart = (a.phase() - b.phase()).abs();
    apart.min(TAU - apart) - PI / 2.0
}

/// Sum of the readings of even steps minus that of odd steps.
fn odd(readings: &[f64]) -> f64 {
    let signed = |(k, y): (usize, &f64)| if k % 2 == 0 { *y } else { -*y };
    readings.iter().enumerate().map(signed).sum()
}

impl<'a> Turn<'a> {
    fn new(first: usize, poses: &'a [Pose], g: f64) -> Result<Self, Refusal> {
        let steps = poses.len();
        let mut turn = Self { first, poses, plane: [0, 1], still: 2 };
        let harmonics = [0, 1, 2].map(|axis| turn.harmonic(axis));
        let size = |axis: &usize| harmonics[*axis].size() / g;
        let in_plane: Vec<usize> = (0..3).filter(|axis| TURNS.contains(&size(axis))).collect();
        let &[a, b] = in_plane.as_slice() else { return Err(not_a_turn(first, steps)) };
        (turn.plane, turn.still) = ([a, b], 3 - a - b);
        // The phases of the two axes differ by a quarter of a turn, in either direction.
        let quarter = quarter_off(&harmonics[a], &harmonics[b]);
        let lean = size(&turn.still);
        if lean >= STAYS || quarter.abs() >= PI / 4.0 {
            return Err(not_a_turn(first, steps));
        }
        let off_rad = turn.step_error(g);
        if off_rad > MOST_STEP_ERROR {
            let why = format!(
                "the steps are at least {:.0}° rms from equal steps of {}°; turn the sensor by a square or a protractor, or \
                 use multi-position, which needs no known orientation",
                off_rad.to_degrees(),
                360 / steps
            );
            return Err(refusal(first, steps, &why));
        }
        if lean > MOST_LEAN { Err(turn.tilted(lean)) } else { Ok(turn) }
    }

    fn tilted(&self, off_rad: f64) -> Refusal {
        let why = format!(
            "according to the reading of the axis of rotation, it is {:.0}° from level or from the axis of the sensor; \
             square the sensor and level the axis, or use multi-position, which needs neither",
            off_rad.to_degrees()
        );
        refusal(self.first, self.poses.len(), &why)
    }

    fn readings(&self, axis: usize) -> Vec<f64> {
        self.poses.iter().map(|pose| pose.mean_mps2[axis]).collect()
    }

    fn harmonic(&self, axis: usize) -> Harmonic {
        Harmonic::of(&self.readings(axis))
    }

    /// Lower bound on the step error, rad rms: the part of the readings that equal steps cannot cause.
    fn step_error(&self, g: f64) -> f64 {
        let steps = self.poses.len();
        let [one, other] = self.plane.map(|axis| self.harmonic(axis));
        // Deviation of the two axes from equal amplitude and quadrature.
        let longer = libm::log(one.size() / other.size());
        let elliptic = libm::hypot(longer, quarter_off(&one, &other));
        let shown = if elliptic > MOST_ELLIPTIC {
            elliptic * libm::sqrt(steps as f64 / ELLIPTIC_OF_STEPS)
        } else {
            0.0
        };
        if steps != 4 {
            return shown;
        }
        let [a, b] = self.plane.map(|axis| odd(&self.readings(axis)));
        shown.max(libm::hypot(a, b) / (2.0 * g))
    }

    /// Bias and scale factor of an axis in the plane: equations (45) and (46).
    fn axis(&self, axis: usize, g: f64, placement_sd_rad: f64) -> Axis {
        let n = self.poses.len() as f64;
        let readings = self.readings(axis);
        let harmonic = Harmonic::of(&readings);
        let amplitude = harmonic.size();
        let tilt = placement_sd_rad * placement_sd_rad;
        let cross = CROSS_AXIS * CROSS_AXIS;
        let (mut sum, mut along, mut across, mut both) = (0.0, 0.0, 0.0, 0.0);
        for (k, pose) in self.poses.iter().enumerate() {
            let (s, c) = libm::sincos(TAU * k as f64 / n - harmonic.phase());
            // Variance of one reading: step error, tilt of the axis of rotation, noise.
            let variance =
                tilt * amplitude * amplitude * s * s + tilt * cross * g * g + pose.noise(axis);
            sum += variance;
            along += c * c * variance;
            across += s * s * variance;
            both += c * variance;
        }
        let odd = odd(&readings);
        let misfit = if readings.len() == 4 && sum > 0.0 { odd * odd / sum } else { 0.0 };
        // Second order: step errors and tilts reduce the amplitude, cross-axis errors increase it.
        let four = 4.0 / (n * n);
        let shift = four * across / (2.0 * amplitude * amplitude) - tilt;
        let scale = amplitude / g / (1.0 + shift);
        let spread = (2.0 / n + 1.0 / 8.0) * tilt * tilt;
        let mut scale_variance = four * along / (g * g) + spread * scale * scale;
        let lean = self.harmonic(self.still).size() / g;
        if lean > BEYOND_CHANCE * libm::hypot(placement_sd_rad, CROSS_AXIS) {
            // A tilt shortens one of the axes or both.
            scale_variance += 0.25 * lean * lean * lean * lean;
        }
        Axis {
            value: [harmonic.mean, scale],
            variance: [sum / (n * n), scale_variance],
            both: 2.0 / (n * n) * both / g,
            misfit,
        }
    }

    /// Refuses a tilt of the axis of rotation, by its reading less its bias from other rotations, and adds that of a
    /// doubtful one to the other axes.
    fn level(
        &self,
        axes: &mut [Option<Axis>; 3],
        g: f64,
        placement_sd_rad: f64,
    ) -> Result<(), Refusal> {
        let reads = self.harmonic(self.still).mean;
        // Standard deviation of the reading if no rotation determines the bias.
        let either = libm::hypot(USUAL_BIAS_MPS2 / g, placement_sd_rad);
        let known = axes[self.still].map(|known| known.value[0]);
        let (most, doubtful) = match known {
            Some(_) => (MOST_STEP_ERROR, BEYOND_CHANCE * placement_sd_rad),
            None => (BEYOND_CHANCE * either, DOUBTFUL * either),
        };
        let off = (reads - known.unwrap_or_default()) / g;
        if off.abs() > most {
            return Err(self.tilted(off.abs()));
        }
        if off.abs() > doubtful {
            let across = off * (CROSS_AXIS * g);
            for axis in self.plane {
                if let Some(found) = &mut axes[axis] {
                    found.variance[1] += 0.25 * off * off * off * off;
                    found.variance[0] += across * across;
                }
            }
        }
        Ok(())
    }
}
