//! Position: a fix, a bound, a range, a joint. Equations (127), (161) to (164), (170), (180), (181) and (193).

use core::f64::consts::{LN_2, PI, SQRT_2};

use nalgebra::{Matrix1, Matrix3, Vector3};

use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::process::{GaussMarkov, Process, Transition};
use crate::state::{ATTITUDE, Block, Layout, POSITION, Role, State, VELOCITY};

/// Position of a point of the unit, navigation frame.
#[derive(Clone, Copy, Debug)]
pub struct Position {
    /// m.
    pub position_m: Vector3<f64>,
    /// Standard deviation of each component, m; infinite where it is not measured, as of a height alone.
    pub deviation_m: Vector3<f64>,
    /// The point from the origin of the unit, m, body frame: an antenna.
    pub lever_arm_m: Vector3<f64>,
}

impl Measurement for Position {
    fn predict(&self, filter: &Filter) -> Prediction {
        let arm = filter.state.attitude * self.lever_arm_m;
        let shown = filter.state.get(POSITION) + arm;
        let (predicted, rows) = components(self.position_m - shown, &self.deviation_m);
        predicted.by(POSITION, rows).by(ATTITUDE, rows * -arm.cross_matrix())
    }
}

impl Position {
    /// One on the diagonal for each component that is measured.
    pub fn measured(&self) -> Matrix3<f64> {
        measured(&self.deviation_m)
    }
}

/// One on the diagonal for each finite standard deviation.
fn measured(deviation: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_diagonal(&deviation.map(|sd| f64::from(u8::from(sd.is_finite()))))
}

/// The innovation of a vector, of which components may not be measured, and its rows: one on the diagonal for each that is.
pub(super) fn components(
    off: Vector3<f64>,
    deviation: &Vector3<f64>,
) -> (Prediction, Matrix3<f64>) {
    // A component without a measurement, which may be no number: no innovation, any variance.
    let finite = |value: f64, sd: f64, other| if sd.is_finite() { value } else { other };
    let off = off.zip_map(deviation, |off, sd| finite(off, sd, 0.0));
    let variance = deviation.map(|sd| finite(sd * sd, sd, 1.0));
    let dof = deviation.iter().filter(|sd| sd.is_finite()).count();
    let predicted = Prediction::new(off, Matrix3::from_diagonal(&variance));
    (Prediction { dof, ..predicted }, measured(deviation))
}

/// A position fix by an antenna. What is known of its lever arm is in the fix; the rest is a state.
#[derive(Clone, Copy, Debug)]
pub struct Antenna {
    /// The fix.
    pub fix: Position,
    /// Antenna from the given lever arm, m, body frame.
    pub offset: Block<3>,
    /// The clock of the samples is behind that of the fixes by this time, s: the time stamp of a sample is late.
    pub clock: Block<1>,
    /// Time from the fix to the state, s, by their time stamps.
    pub age_s: f64,
    /// Angular rate, rad/s, body frame.
    pub rate_rad_s: Vector3<f64>,
    /// Acceleration, m/s², navigation frame.
    pub acceleration_mps2: Vector3<f64>,
}

impl Measurement for Antenna {
    /// Constant acceleration and angular rate over the time between the state and the fix.
    fn predict(&self, filter: &Filter) -> Prediction {
        let state = &filter.state;
        let attitude = state.attitude.matrix();
        let lasts = state.get(self.clock).x - self.age_s;
        let turned = Matrix3::identity() + self.rate_rad_s.cross_matrix() * lasts;
        let arm = self.fix.lever_arm_m + state.get(self.offset);
        let gained = self.acceleration_mps2 * lasts;
        let velocity = state.get(VELOCITY) + gained + attitude * self.rate_rad_s.cross(&arm);
        let fix = Position {
            position_m: self.fix.position_m - (state.get(VELOCITY) + gained * 0.5) * lasts,
            lever_arm_m: turned * arm,
            ..self.fix
        };
        let measured = fix.measured();
        fix.predict(filter)
            .by(VELOCITY, measured * lasts)
            .by(self.offset, measured * attitude * turned)
            .by(self.clock, measured * velocity)
    }
}

/// Errors of the ranges of one anchor, all as standard deviations. The defaults are those of ultra-wideband radios that are
/// not calibrated: antenna delays of 0.3 ns are 0.1 m.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct RangeErrors {
    /// White noise of a range, m.
    pub noise_m: f64,
    /// Error that is correlated over a time, m, and that time, s: reflections, antennas, clock.
    pub correlated_m: f64,
    /// See [`correlated_m`](Self::correlated_m).
    pub time_s: f64,
    /// Constant bias, m.
    pub bias_m: f64,
    /// Scale error.
    pub scale: f64,
    /// Position of the anchor, m, a component.
    pub position_m: f64,
}

impl Default for RangeErrors {
    fn default() -> Self {
        Self {
            noise_m: 0.03,
            correlated_m: 0.06,
            time_s: 1.0,
            bias_m: 0.07,
            scale: 0.0,
            position_m: 0.0,
        }
    }
}

/// An anchor, and the states of its ranges. What has a standard deviation of zero has no state.
#[derive(Clone, Copy, Debug)]
pub struct Anchor {
    /// Position as given, m, navigation frame.
    pub position_m: Vector3<f64>,
    /// True minus given position, m.
    pub offset: Option<Block<3>>,
    /// Bias of the ranges, m.
    pub bias: Option<Block<1>>,
    /// Scale error of the ranges.
    pub scale: Option<Block<1>>,
    /// Correlated error of the ranges, m.
    pub correlated: Option<Block<1>>,
}

impl Anchor {
    /// Claims the states of an anchor: up to six.
    pub fn claim(layout: &mut Layout, position_m: Vector3<f64>, errors: &RangeErrors) -> Self {
        let mut claim = |deviation| layout.claim_unknown(Role::Estimated, [deviation]);
        let (bias, scale) = (claim(errors.bias_m), claim(errors.scale));
        let correlated = claim(errors.correlated_m);
        let offset = layout.claim_unknown(Role::Estimated, [errors.position_m; 3]);
        Self { position_m, offset, bias, scale, correlated }
    }

    /// Position, m: as given, and as estimated.
    pub fn position(&self, state: &State) -> Vector3<f64> {
        self.position_m + self.offset.map_or_else(Vector3::zeros, |block| state.get(block))
    }
}

/// A step of the correlated errors of all anchors.
#[derive(Clone, Copy, Debug)]
pub struct CorrelatedErrors<'a> {
    /// The anchors.
    pub anchors: &'a [Anchor],
    /// Their errors.
    pub errors: &'a RangeErrors,
    /// Length of the step, s.
    pub step_s: f64,
}

impl Process for CorrelatedErrors<'_> {
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        for block in self.anchors.iter().filter_map(|anchor| anchor.correlated) {
            let step = GaussMarkov {
                block,
                deviation: self.errors.correlated_m,
                time_s: self.errors.time_s,
                step_s: self.step_s,
            };
            step.propagate(state, transition);
        }
    }
}

/// A range.
#[derive(Clone, Copy, Debug)]
pub struct Range<'a> {
    /// The anchor.
    pub anchor: &'a Anchor,
    /// Measured range, m.
    pub range_m: f64,
    /// Standard deviation of its white noise, m.
    pub deviation_m: f64,
    /// Antenna of the unit from its origin, m, body frame.
    pub lever_arm_m: Vector3<f64>,
    /// The range is measured later than its time stamp by this time, s.
    pub delay: Option<Block<1>>,
    /// Time from its time stamp to the state, s.
    pub age_s: f64,
}

impl Measurement for Range<'_> {
    /// At the anchor itself the range has no direction, and the measurement no effect on the position.
    fn predict(&self, filter: &Filter) -> Prediction {
        let (anchor, state) = (self.anchor, &filter.state);
        let arm = state.attitude * self.lever_arm_m;
        let velocity = state.get(VELOCITY);
        let lasts = state.value(self.delay) - self.age_s;
        let difference = state.get(POSITION) + velocity * lasts + arm - anchor.position(state);
        let distance = difference.norm();
        let direction = difference.try_normalize(1e-6).unwrap_or_else(Vector3::zeros);
        let stretch = 1.0 + state.value(anchor.scale);
        let added = state.value(anchor.bias) + state.value(anchor.correlated);
        let slope = direction * stretch;
        let innovation = Matrix1::new(self.range_m - distance * stretch - added);
        let noise = Matrix1::new(self.deviation_m * self.deviation_m);
        Prediction::new(innovation, noise)
            .by(POSITION, slope.transpose())
            .by(VELOCITY, slope.transpose() * lasts)
            .by(ATTITUDE, arm.cross(&slope).transpose())
            .by_some(anchor.bias, Matrix1::new(1.0))
            .by_some(anchor.correlated, Matrix1::new(1.0))
            .by_some(self.delay, Matrix1::new(slope.dot(&velocity)))
            .by_some(anchor.scale, Matrix1::new(distance))
            .by_some(anchor.offset, -slope.transpose())
    }
}

impl Range<'_> {
    /// The same range with the weight that it has in a mixture with non-line of sight, for an update without a gate.
    #[must_use]
    pub fn weighted(&self, filter: &Filter, model: &NonLineOfSight) -> (Self, LineOfSight) {
        let prediction = self.predict(filter);
        let variance = filter.variance_of(&prediction)[0];
        let found = model.weigh(prediction.z[0], variance);
        // Equation (164): the correction of the state is the weight times that with line of sight.
        let excess = variance * (1.0 / found.weight - 1.0);
        let deviation_m = libm::sqrt(self.deviation_m * self.deviation_m + excess);
        let weighted = Self { deviation_m, ..*self };
        (weighted, found)
    }
}

/// Density of a range that neither model explains, such as one far too short, 1/m: it keeps the weight finite.
const OUTLIER_DENSITY: f64 = 1e-6;
/// Least weight of a range: its noise is at most a hundred times its deviation.
const LEAST_WEIGHT: f64 = 1e-4;

/// Mixture of a Gaussian error and one with an excess: without line of sight the signal takes a longer path, and the excess
/// is exponentially distributed (S. Gezici and others, "Localization via ultra-wideband radios", IEEE Signal Process. Mag.
/// 22(4), 2005).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NonLineOfSight {
    /// Probability that a range has no line of sight. Zero: every range has the same weight.
    pub probability: f64,
    /// Mean of the excess, m.
    pub mean_m: f64,
}

/// How a range fits both models.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineOfSight {
    /// Measured minus predicted range, m.
    pub innovation_m: f64,
    /// Its variance under line of sight, m².
    pub variance_m2: f64,
    /// Probability of line of sight given the range, at least 10⁻⁴: the noise of the range is divided by it.
    pub weight: f64,
    /// Logarithm of the density of the innovation.
    pub log_likelihood: f64,
}

impl NonLineOfSight {
    /// The probability of line of sight given an innovation, m, and its variance under line of sight, m².
    pub fn weigh(&self, innovation_m: f64, variance_m2: f64) -> LineOfSight {
        let found = |weight: f64, log_likelihood| LineOfSight {
            innovation_m,
            variance_m2,
            weight: weight.max(LEAST_WEIGHT),
            log_likelihood,
        };
        let deviation = libm::sqrt(variance_m2);
        let z = innovation_m / deviation;
        let log_direct = -0.5 * (z * z + libm::log(2.0 * PI * variance_m2));
        if self.probability <= 0.0 {
            return found(1.0, log_direct);
        }
        let ratio = deviation / self.mean_m;
        let log_excess = 0.5 * ratio * ratio - innovation_m / self.mean_m + log_normal(z - ratio)
            - libm::log(self.mean_m);
        let direct = (1.0 - self.probability) * libm::exp(log_direct);
        let excess = self.probability * libm::exp(log_excess) + OUTLIER_DENSITY;
        found(direct / (direct + excess), libm::log(direct + excess))
    }
}

/// Logarithm of the standard normal distribution function.
fn log_normal(z: f64) -> f64 {
    if z > -6.0 {
        return libm::log(libm::erfc(-z / SQRT_2)) - LN_2;
    }
    // Asymptotic expansion (M. Abramowitz and I. A. Stegun, "Handbook of Mathematical Functions", 26.2.12): the next term
    // is below 3e-4.
    let inverse = 1.0 / (z * z);
    let series = 1.0 - inverse * (1.0 - 3.0 * inverse);
    -0.5 * z * z - libm::log(-z) - 0.5 * libm::log(2.0 * PI) + libm::log(series)
}

/// A point that both bodies have in common: p = r₁ − C r₂.
#[derive(Clone, Copy, Debug)]
pub struct CommonPoint {
    /// Position of the joint from each unit, m, in its axes.
    pub lever_arms: [Block<3>; 2],
    /// Standard deviation of a component, m: play of the joint, and bodies that bend.
    pub deviation_m: f64,
}

impl Measurement for CommonPoint {
    fn predict(&self, filter: &Filter) -> Prediction {
        let to_first = *filter.state.attitude.matrix();
        let [first, second] = self.lever_arms.map(|arm| filter.state.get(arm));
        let second = to_first * second;
        Prediction::new(
            first - second - filter.state.get(POSITION),
            Matrix3::from_diagonal_element(self.deviation_m * self.deviation_m),
        )
        .by(POSITION, Matrix3::identity())
        .by(ATTITUDE, -second.cross_matrix())
        .by(self.lever_arms[0], -Matrix3::identity())
        .by(self.lever_arms[1], to_first)
    }
}
