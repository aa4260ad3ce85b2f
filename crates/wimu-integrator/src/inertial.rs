//! Integration with a gyroscope: equation (29) of docs/reference/equations.

use wimu_model::{AngularRateQ20, PeriodNs, SpecificForceQ16};

use crate::attitude::to_direction;
use crate::integrator::{Integrator, Progress, Transition};
use crate::rotation::{Rotation, times};
use crate::state::{Flags, Phase, State, StateError};
use crate::stationarity::REST_WINDOWS;

/// Largest mean rate of a window at rest, each axis, 2⁻²⁰ rad/s: 0.1 rad/s (5.7 °/s). It bounds the bias that a rest
/// may show before calibration: typically ±1 °/s for an LSM6DSO (DS12140, table 2). An MPU-6050 may exceed it (±20 °/s:
/// PS-MPU-6000A-00, §6.1), and then no rest is found until it is calibrated.
const LARGEST_BIAS: i32 = 104_858;
/// Largest difference between the mean rates of windows of a rest, each axis, 2⁻²⁰ rad/s: 0.02 rad/s. About a
/// horizontal axis this rate changes the specific force by g · 0.02 rad/s · 0.125 s = 0.0245 m/s² from a window to the
/// next, which is the accelerometer's limit [`REST_MEAN_TOLERANCE_MPS2`](crate::REST_MEAN_TOLERANCE_MPS2).
///
/// This is no χ² test of the gyroscope's noise, because the error model does not contain the noise. An LSM6DSO
/// (3.8 m°/s/√Hz, 0.01 °/s/K: DS12140, table 2) has a standard deviation of 1.3 · 10⁻⁴ rad/s in a window's mean, and a
/// bias drift of 1.7 · 10⁻³ rad/s over 10 K. False alarms are therefore negligible.
const RATE_TOLERANCE: u64 = 20_972;

/// The sensors of a sample with an axis at full scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Saturation {
    /// An axis of the accelerometer.
    pub accelerometer: bool,
    /// An axis of the gyroscope.
    pub gyroscope: bool,
}

/// Rotation of an integrator with a gyroscope. Integration axes are the body axes of the first rest, fixed
/// to the earth from then on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RotationState {
    /// Quaternion w, x, y, z from body to integration axes, 2⁻⁵⁹.
    pub quaternion: [i64; 4],
    /// Latest angular rate minus bias, 2⁻²⁰ rad/s; `None` before the first rest and after a gap.
    pub previous: Option<[i32; 3]>,
    /// Part of the latest half angle below 2⁻²⁹ rad, 2⁻⁶¹ rad.
    pub remainder: [u32; 3],
    /// Bias of the gyroscope at the latest rest, 2⁻²⁰ rad/s, within ±0.1 rad/s.
    pub bias: [i32; 3],
    /// Sum of the rates of the current window, 2⁻²⁰ rad/s.
    pub window: [i64; 3],
    /// Sum of the rates over the windows of the run but the latest, 2⁻²⁰ rad/s.
    pub sum: [i64; 3],
    /// Sum of the rates over the latest window of the run, 2⁻²⁰ rad/s.
    pub latest: [i64; 3],
}

impl RotationState {
    /// Checks the ranges.
    pub(crate) fn checked(self) -> Result<Self, StateError> {
        // |q|² in 2⁻⁶⁰; a step keeps it within 2⁻⁸ of 1 even at the largest rate.
        let square = |q: i64| u128::from((q >> 29).unsigned_abs()).pow(2);
        let length: u128 = self.quaternion.into_iter().map(square).sum();
        let sums = [self.window, self.sum, self.latest];
        if length.abs_diff(1 << 60) > 1 << 52
            || self.bias.iter().any(|b| b.unsigned_abs() > LARGEST_BIAS as u32)
            || sums.as_flattened().iter().any(|s| s.unsigned_abs() > 1 << 48)
        {
            return Err(StateError::Rotation);
        }
        Ok(self)
    }
}

/// Outcome of the stationarity test of the angular rates of a window.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RateTest {
    /// The mean can be a bias.
    pub(crate) quiet: bool,
    /// It is that of the run.
    pub(crate) agrees: bool,
    /// It is the bias of the latest rest.
    pub(crate) as_held: bool,
}

impl RateTest {
    /// Without a gyroscope.
    pub(crate) const PASSED: Self = Self { quiet: true, agrees: true, as_held: true };
}

/// [`RotationState`] in the form in which it is advanced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Inertial {
    pub(crate) rotation: Rotation,
    bias: [i32; 3],
    window: [i64; 3],
    sum: [i64; 3],
    latest: [i64; 3],
}

impl Inertial {
    fn new(period: PeriodNs) -> Self {
        Self {
            rotation: Rotation::new([1.0, 0.0, 0.0, 0.0], period),
            bias: [0; 3],
            window: [0; 3],
            sum: [0; 3],
            latest: [0; 3],
        }
    }

    pub(crate) fn from_state(state: RotationState, period: PeriodNs) -> Self {
        Self::resumed(state, period)
    }

    fn resumed(state: RotationState, period: PeriodNs) -> Self {
        let RotationState { quaternion, previous, remainder, bias, window, sum, latest } = state;
        Self {
            rotation: Rotation::resumed(quaternion, previous, remainder, period),
            bias,
            window,
            sum,
            latest,
        }
    }

    pub(crate) fn state(&self) -> RotationState {
        let (quaternion, previous, remainder) = self.rotation.parts();
        RotationState {
            quaternion,
            previous,
            remainder,
            bias: self.bias,
            window: self.window,
            sum: self.sum,
            latest: self.latest,
        }
    }

    /// The same rotation at another sample period, at the start of a window.
    pub(crate) fn with_period(&self, period: PeriodNs) -> Self {
        let state = RotationState { window: [0; 3], ..self.state() };
        Self::resumed(state, period)
    }

    /// Tests the complete window of `steps` samples, after a run of `windows`.
    fn test(&self, steps: u16, windows: u16) -> RateTest {
        let steps = i64::from(steps.max(1));
        let windows = i64::from(windows.max(1));
        let within = |reference: [i64; 3]| {
            (0..3).all(|i| (self.window[i] / steps).abs_diff(reference[i]) <= RATE_TOLERANCE)
        };
        let mean_of_run =
            [0, 1, 2].map(|i| self.sum[i].wrapping_add(self.latest[i]) / (windows * steps));
        RateTest {
            quiet: (self.window.iter())
                .all(|sum| (sum / steps).unsigned_abs() <= LARGEST_BIAS as u64),
            agrees: within(mean_of_run),
            as_held: within(self.bias.map(i64::from)),
        }
    }

    /// Adds the complete window to the run, which had `before` windows and has `windows` now.
    fn end_window(&mut self, before: u16, windows: u16) {
        if windows <= 1 {
            self.sum = [0; 3];
        } else {
            for (sum, latest) in self.sum.iter_mut().zip(self.latest) {
                *sum = sum.saturating_add(latest);
                // As the run halves its sums.
                if windows <= before {
                    *sum /= 2;
                }
            }
        }
        self.latest = match windows {
            0 => [0; 3],
            _ => self.window,
        };
        self.window = [0; 3];
    }

    /// Zero-angular-rate update: the bias is the mean rate of a run at rest but its latest window.
    fn learn_bias(&mut self, steps: u16, windows: u16) {
        let samples = i64::from(steps) * i64::from(windows.saturating_sub(1));
        self.bias = self.sum.map(|sum| (sum / samples.max(1)) as i32);
    }
}

/// What an integrator keeps of a gyroscope: nothing, `()`, or an [`Inertial`] from the first angular rate on.
pub trait Gyroscope: sealed::Gyroscope {}

impl Gyroscope for () {}
impl Gyroscope for Option<Inertial> {}

pub(crate) mod sealed {
    use super::Inertial;

    pub trait Gyroscope {
        fn get(&self) -> Option<&Inertial>;
        fn get_mut(&mut self) -> Option<&mut Inertial>;
    }

    impl Gyroscope for () {
        fn get(&self) -> Option<&Inertial> {
            None
        }

        fn get_mut(&mut self) -> Option<&mut Inertial> {
            None
        }
    }

    impl Gyroscope for Option<Inertial> {
        fn get(&self) -> Option<&Inertial> {
            self.as_ref()
        }

        fn get_mut(&mut self) -> Option<&mut Inertial> {
            self.as_mut()
        }
    }
}

impl Integrator {
    /// Adds the next corrected sample of accelerometer and gyroscope, body axes; `saturated`: which
    /// of them had an axis at full scale.
    ///
    /// The first call starts the rotation: from then on every sample comes with an angular rate. Rates
    /// beyond 1.25 rad per axis and sample period are clamped and flagged as saturated.
    #[inline]
    pub fn step_inertial(
        &mut self,
        force: SpecificForceQ16,
        rate: AngularRateQ20,
        saturated: Saturation,
    ) -> Transition {
        let period = self.state.config.period;
        let inertial = (self.inertial).get_or_insert_with(|| Inertial::new(period));
        for (sum, rate) in inertial.window.iter_mut().zip(rate.0) {
            *sum = sum.wrapping_add(rate.into());
        }
        let mut in_range = true;
        if self.state.phase != Phase::Searching {
            let unbiased = [0, 1, 2].map(|axis| rate.0[axis].saturating_sub(inertial.bias[axis]));
            in_range = inertial.rotation.step(AngularRateQ20(unbiased));
        }
        let force = SpecificForceQ16(inertial.rotation.rotate(force.0));
        if saturated.gyroscope || !in_range {
            self.state.flags = self.state.flags.with(Flags::GYROSCOPE_SATURATED);
        }
        match self.advance(force, saturated.accelerometer) {
            Progress::Within => Transition::None,
            Progress::Restarted => {
                if let Some(inertial) = &mut self.inertial {
                    inertial.window = [0; 3];
                }
                Transition::None
            }
            Progress::Complete => self.end_inertial_window(),
        }
    }

    #[cold]
    fn end_inertial_window(&mut self) -> Transition {
        let Some(mut inertial) = self.inertial else {
            return Transition::None;
        };
        let steps = self.window_steps;
        let windows = |state: &State| state.run.map_or(0, |run| run.windows);
        let before = windows(&self.state);
        let transition = self.end_window(inertial.test(steps, before));
        let now = windows(&self.state);
        inertial.end_window(before, now);
        if self.state.phase == Phase::Resting && now >= REST_WINDOWS {
            inertial.learn_bias(steps, now);
        }
        self.inertial = Some(inertial);
        transition
    }
}

impl<G: Gyroscope> Integrator<G> {
    /// The rotation, if there is one.
    #[inline]
    pub(crate) fn inertial(&self) -> Option<&Inertial> {
        self.inertial.get()
    }

    /// Mean specific force over the latest rest, 2⁻³² m/s², in the present body axes; zero before the
    /// first rest.
    pub fn rest_force(&self) -> [i64; 3] {
        let mean = self.state.rest_mean;
        self.inertial().map_or(mean, |inertial| {
            let short = mean.map(|mean| (mean >> 8) as i32);
            inertial.rotation.rotate_back(short).map(|f| i64::from(f) << 8)
        })
    }

    /// A vector in present body axes, in integration axes.
    pub(crate) fn in_integration_axes(&self, body: [i32; 3]) -> [i32; 3] {
        (self.inertial()).map_or(body, |inertial| inertial.rotation.rotate(body))
    }

    /// Quaternion w, x, y, z from body to navigation axes, 2⁻³⁰; `None` without a gyroscope and before the
    /// first rest.
    pub(crate) fn quaternion(&self) -> Option<[i32; 4]> {
        let inertial = (self.inertial()).filter(|_| self.state.phase != Phase::Searching)?;
        let q = times(self.attitude.quaternion(), inertial.rotation.quaternion());
        Some(q.map(to_direction))
    }
}
