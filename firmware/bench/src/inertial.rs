//! Cost of a sample of six axes.

use core::hint::black_box;

use wimu_integrator::Rotation;
use wimu_model::{
    AngularRateQ20, CompiledSet, Corrector, Counts, GyroscopeCorrector, GyroscopeModel,
    GyroscopeParameters, GyroscopeTerms, ParameterId, ParameterSet, SpecificForceQ16,
};

use crate::counter::Counter;
use crate::{PERIOD, SAMPLES, signals};

/// ±2000 °/s in 16 bits, rad/s per LSB.
const RAD_S_PER_LSB: f64 = 0.00122;

/// A sample's counts: accelerometer, gyroscope.
type Sample = (Counts, Counts);

#[repr(C)]
struct Unit {
    rotation: Rotation,
    accelerometer: Corrector,
    gyroscope: GyroscopeCorrector,
    force: SpecificForceQ16,
}

impl Unit {
    // With so few registers a call takes fewer instructions.
    #[cfg_attr(target_abi = "eabihf", inline(always))]
    #[cfg_attr(not(target_abi = "eabihf"), inline(never))]
    fn correct(&self, (force, rate): Sample) -> (SpecificForceQ16, AngularRateQ20) {
        let force = self.accelerometer.correct(force);
        (force, self.gyroscope.correct(rate, force))
    }

    #[inline(never)]
    fn corrected_attitude(&mut self, sample: Sample) {
        let (force, rate) = self.correct(sample);
        self.force = force;
        self.rotation.step(rate);
    }
}

/// Correction with g-sensitivity, and attitude.
#[inline(never)]
pub fn measure(counter: &Counter) -> Result<(), &'static str> {
    let motion = signals::motion::<SAMPLES>();
    let parameters = crate::parameters().ok_or("the parameters are refused")?;
    let model = GyroscopeModel::new(GyroscopeTerms {
        bias_rad_s: [0.01, -0.02, 0.03],
        matrix: [[1.02, 0.01, -0.02], [0.015, 0.98, 0.01], [-0.01, 0.02, 1.01]],
        g_sensitivity: [[0.001, 0.0, 0.0], [0.0, 0.002, 0.0], [0.0, 0.0, -0.001]],
        ..GyroscopeTerms::default()
    })
    .map_err(|_| "the gyroscope's terms are refused")?;
    let gyroscope = GyroscopeParameters::new(2000, RAD_S_PER_LSB, model, None).ok();
    let set = ParameterSet { gyroscope, ..parameters };
    let set = CompiledSet::compile(&set, ParameterId(1), 0).map_err(|_| "no compiled set")?;
    let accelerometer = set.corrector(None);
    let gyroscope = set.gyroscope(None).ok_or("no corrector of the gyroscope")?;
    let mut unit = black_box(Unit {
        rotation: Rotation::new([1.0, 0.0, 0.0, 0.0], PERIOD),
        accelerometer,
        gyroscope,
        force: SpecificForceQ16::default(),
    });
    let (mut sum, mut most) = (0, 0);
    for (&force, &rate) in motion.iter().zip(motion.iter().rev()) {
        let cost = counter.count(|| unit.corrected_attitude((force, rate)));
        sum += cost;
        most = most.max(cost);
    }
    crate::report("six-correction+attitude", sum, SAMPLES as u32, most);
    black_box(&unit);
    Ok(())
}
