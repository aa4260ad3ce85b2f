//! Counts of one sample: their correction and integration.

use wimu_integrator::{Config, Gyroscope, Inertial, Integrator, Saturation, Transition};
use wimu_link::batch;
use wimu_model::{
    AngularRateQ20, CentiCelsius, CompiledSet, Corrector, Counts, GyroscopeCorrector,
    SpecificForceQ16, WideCounts,
};

use crate::sensor::SensorPlan;

/// Counts of one sample of a sensor: [`Counts`] of a three-axis accelerometer, [`WideCounts`] of one with up to
/// 20 bits, or a pair of the same type, accelerometer and gyroscope at the same instant.
///
/// Counts beyond 20 bits are clamped.
pub trait RawSample: batch::Sample + Default + sealed::Process + 'static {}

impl RawSample for Counts {}
impl RawSample for WideCounts {}
impl RawSample for (Counts, Counts) {}
impl RawSample for (WideCounts, WideCounts) {}

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

        /// The gyroscope's corrector of `set` at `temperature`; without one, that of the nominal scale in `plan`.
        fn gyroscope(
            set: Option<&CompiledSet>,
            plan: &SensorPlan,
            temperature: Option<CentiCelsius>,
        ) -> Self::Gyroscope;

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

    fn gyroscope(_: Option<&CompiledSet>, _: &SensorPlan, _: Option<CentiCelsius>) {}

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

    fn gyroscope(
        set: Option<&CompiledSet>,
        plan: &SensorPlan,
        temperature: Option<CentiCelsius>,
    ) -> GyroscopeCorrector {
        let calibrated = set.and_then(|set| set.gyroscope(temperature));
        let ideal = || plan.gyroscope.map(|plan| plan.ideal());
        calibrated.or_else(ideal).unwrap_or(const { GyroscopeCorrector::ideal(0.0) })
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
            gyroscope: (plan.gyroscope).is_none_or(|plan| self.1.saturated(plan.full_scale())),
        };
        integrator.step_inertial(force, rate, saturation)
    }
}
