//! Counts of one sample: their correction and integration.

use core::ops::RangeInclusive;

use wimu_integrator::{Config, Gyroscope, Inertial, Integrator, Saturation, Transition};
use wimu_link::batch;
use wimu_link::message::{ParameterFault, WireParameters};
use wimu_model::{
    AngularRateQ20, CentiCelsius, Corrector, Counts, GyroscopeCorrector, GyroscopeError,
    GyroscopeModel, GyroscopeTerm, ParameterSet, SpecificForceQ16, WideCounts,
};

use crate::sensor::SensorPlan;

/// Allowed ratio of a parameter set's sensitivity to the sensor's nominal one: covers the tolerance of a
/// sensor, excludes another range.
pub(crate) const SENSITIVITY_RATIO: RangeInclusive<f64> = 0.8..=1.25;

/// Counts of one sample of a sensor: [`Counts`] of a three-axis accelerometer, [`WideCounts`] of one with up to
/// 20 bits, or a pair of the same type, accelerometer and gyroscope at the same instant.
///
/// Counts beyond 20 bits are clamped.
pub trait RawSample: batch::Sample + Default + sealed::Process + 'static {}

impl RawSample for Counts {}
impl RawSample for WideCounts {}
impl RawSample for (Counts, Counts) {}
impl RawSample for (WideCounts, WideCounts) {}

/// Whether the magnetometer's model and the quality of a calibration are used: the heading's uncertainty depends on both.
const HEADING: bool = cfg!(feature = "heading");

pub(crate) mod sealed {
    use super::*;

    /// What the node does with a sample.
    pub trait Process: Copy {
        /// Counts of the accelerometer.
        type Accelerometer: batch::Sample;
        /// The corrected sample.
        type Corrected: batch::Sample;
        /// The compiled corrector of the gyroscope; `()` without one.
        type Gyroscope: Copy;
        /// What the integrator keeps of the gyroscope.
        type Rotation: Gyroscope;

        /// Decodes the parts of a set that this node uses.
        ///
        /// # Errors
        /// What is invalid in them.
        fn decode(wire: &WireParameters) -> Result<ParameterSet, ParameterFault>;

        /// Compiles the gyroscope's part of `set`; without one, the nominal scale of `plan`.
        ///
        /// # Errors
        /// The part is for another scale than `plan`'s, or cannot be compiled.
        fn compile_gyroscope(
            set: &ParameterSet,
            plan: &SensorPlan,
            temperature: Option<CentiCelsius>,
        ) -> Result<Self::Gyroscope, ParameterFault>;

        /// The sample without a gyroscope's counts.
        fn accelerometer(self) -> Self::Accelerometer;

        /// Corrects the sample, body axes.
        fn correct(self, corrector: &Corrector, gyroscope: &Self::Gyroscope) -> Self::Corrected;

        /// An integrator of such samples.
        fn integrator(config: Config) -> Integrator<Self::Rotation>;

        /// Integrates the sample, of a sensor that operates as `plan` says.
        fn integrate(
            self,
            corrected: Self::Corrected,
            plan: &SensorPlan,
            integrator: &mut Integrator<Self::Rotation>,
        ) -> Transition;
    }

    /// Counts of three axes.
    pub trait Triad: batch::Sample {
        fn saturated(self, full_scale: i32) -> bool;
        fn force(self, corrector: &Corrector) -> SpecificForceQ16;
        fn rate(self, corrector: &GyroscopeCorrector, force: SpecificForceQ16) -> AngularRateQ20;
    }
}
use sealed::Triad;

impl Triad for Counts {
    fn saturated(self, full_scale: i32) -> bool {
        Counts::saturated(self, full_scale)
    }

    fn force(self, corrector: &Corrector) -> SpecificForceQ16 {
        corrector.correct(self)
    }

    fn rate(self, corrector: &GyroscopeCorrector, force: SpecificForceQ16) -> AngularRateQ20 {
        corrector.correct(self, force)
    }
}

impl Triad for WideCounts {
    fn saturated(self, full_scale: i32) -> bool {
        WideCounts::saturated(self, full_scale)
    }

    fn force(self, corrector: &Corrector) -> SpecificForceQ16 {
        corrector.correct_wide(self)
    }

    fn rate(self, corrector: &GyroscopeCorrector, force: SpecificForceQ16) -> AngularRateQ20 {
        corrector.correct_wide(self, force)
    }
}

impl<C: Triad> sealed::Process for C {
    type Accelerometer = C;
    type Corrected = SpecificForceQ16;
    type Gyroscope = ();
    type Rotation = ();

    fn decode(wire: &WireParameters) -> Result<ParameterSet, ParameterFault> {
        wire.to_set::<HEADING, HEADING, false>()
    }

    fn compile_gyroscope(
        _: &ParameterSet,
        _: &SensorPlan,
        _: Option<CentiCelsius>,
    ) -> Result<(), ParameterFault> {
        Ok(())
    }

    fn accelerometer(self) -> C {
        self
    }

    fn correct(self, corrector: &Corrector, (): &()) -> SpecificForceQ16 {
        self.force(corrector)
    }

    fn integrator(config: Config) -> Integrator<()> {
        Integrator::three_axes(config)
    }

    fn integrate(
        self,
        corrected: SpecificForceQ16,
        plan: &SensorPlan,
        integrator: &mut Integrator<Self::Rotation>,
    ) -> Transition {
        integrator.step(corrected, self.saturated(plan.full_scale))
    }
}

impl<C: Triad> sealed::Process for (C, C)
where
    (C, C): batch::Sample,
{
    type Accelerometer = C;
    type Corrected = (SpecificForceQ16, AngularRateQ20);
    type Gyroscope = GyroscopeCorrector;
    type Rotation = Option<Inertial>;

    fn decode(wire: &WireParameters) -> Result<ParameterSet, ParameterFault> {
        wire.to_set::<HEADING, HEADING, true>()
    }

    fn compile_gyroscope(
        set: &ParameterSet,
        plan: &SensorPlan,
        temperature: Option<CentiCelsius>,
    ) -> Result<GyroscopeCorrector, ParameterFault> {
        let nominal = plan.gyroscope.map_or(0.0, |nominal| nominal.rad_s_per_lsb);
        let Some(calibrated) = &set.gyroscope else {
            let ideal = GyroscopeModel::default();
            return Ok(GyroscopeCorrector::compile(&ideal, nominal, set.alignment, temperature)?);
        };
        let scale = calibrated.rad_s_per_lsb;
        let [low, high] = [SENSITIVITY_RATIO.start(), SENSITIVITY_RATIO.end()].map(|r| r * nominal);
        if !(low..=high).contains(&scale) {
            return Err(ParameterFault::from(GyroscopeError::OutOfBounds {
                term: GyroscopeTerm::Sensitivity,
                axis: 0,
                value: scale,
                low,
                high,
            }));
        }
        let compiled =
            GyroscopeCorrector::compile(&calibrated.model, scale, set.alignment, temperature);
        Ok(compiled?)
    }

    fn accelerometer(self) -> C {
        self.0
    }

    fn correct(self, corrector: &Corrector, gyroscope: &GyroscopeCorrector) -> Self::Corrected {
        let force = self.0.force(corrector);
        (force, self.1.rate(gyroscope, force))
    }

    fn integrator(config: Config) -> Integrator {
        Integrator::new(config)
    }

    fn integrate(
        self,
        (force, rate): Self::Corrected,
        plan: &SensorPlan,
        integrator: &mut Integrator<Self::Rotation>,
    ) -> Transition {
        let saturation = Saturation {
            accelerometer: self.0.saturated(plan.full_scale),
            // Angular rates of unknown scale are not valid.
            gyroscope: (plan.gyroscope).is_none_or(|plan| self.1.saturated(plan.full_scale)),
        };
        integrator.step_inertial(force, rate, saturation)
    }
}
