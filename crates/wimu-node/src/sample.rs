//! Counts of one sample, and what the sampler does with them.

use wimu_integrator::{Integrator, Transition};
use wimu_link::batch;
use wimu_model::{CentiCelsius, CompileError, Corrector, Counts, ParameterSet, SpecificForceQ16};

use crate::sensor::SensorPlan;

/// Counts of one sample of a sensor: [`Counts`] for a three-axis accelerometer.
pub trait RawSample: batch::Sample + Default + sealed::Process + 'static {}

impl RawSample for Counts {}

pub(crate) mod sealed {
    use super::*;

    /// Correction and integration of a sample.
    pub trait Process: Copy {
        /// The corrected sample.
        type Corrected: batch::Sample;
        /// The compiled corrector of the gyroscope; `()` without one.
        type Gyroscope: Copy;

        /// Compiles the gyroscope's part of `set`.
        fn compile_gyroscope(
            set: &ParameterSet,
            temperature: Option<CentiCelsius>,
        ) -> Result<Self::Gyroscope, CompileError>;

        /// Corrects the sample, body axes.
        fn correct(self, corrector: &Corrector, gyroscope: &Self::Gyroscope) -> Self::Corrected;

        /// Integrates the sample, of a sensor that operates as `plan` says.
        fn integrate(
            self,
            corrected: Self::Corrected,
            plan: &SensorPlan,
            integrator: &mut Integrator,
        ) -> Transition;
    }
}

impl sealed::Process for Counts {
    type Corrected = SpecificForceQ16;
    type Gyroscope = ();

    fn compile_gyroscope(_: &ParameterSet, _: Option<CentiCelsius>) -> Result<(), CompileError> {
        Ok(())
    }

    fn correct(self, corrector: &Corrector, (): &()) -> SpecificForceQ16 {
        corrector.correct(self)
    }

    fn integrate(
        self,
        corrected: SpecificForceQ16,
        plan: &SensorPlan,
        integrator: &mut Integrator,
    ) -> Transition {
        integrator.step(corrected, self.saturated(plan.full_scale))
    }
}
