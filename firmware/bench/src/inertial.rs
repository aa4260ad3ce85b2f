//! Cost of a sample of six axes.

use core::hint::black_box;

use wimu_integrator::{Config, Integrator, Rotation, Saturation};
use wimu_model::{
    AngularRateQ20, CompiledSet, Corrector, Counts, GyroscopeCorrector, GyroscopeModel,
    GyroscopeParameters, GyroscopeTerms, ParameterId, ParameterSet, SpecificForceQ16,
};

use crate::counter::Counter;
use crate::{FULL_SCALE, GRAVITY, PERIOD, SAMPLES, signals};

/// ±2000 °/s in 16 bits, rad/s per LSB.
const RAD_S_PER_LSB: f64 = 0.00122;

/// A sample's counts: accelerometer, gyroscope.
type Sample = (Counts, Counts);

#[repr(C)]
struct Unit {
    integrator: Integrator,
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
    fn corrected(&self, sample: Sample) {
        black_box(self.correct(sample));
    }

    #[inline(never)]
    fn attitude(&mut self, rate: AngularRateQ20) {
        self.rotation.step(rate);
    }

    #[inline(never)]
    fn corrected_attitude(&mut self, sample: Sample) {
        let (force, rate) = self.correct(sample);
        self.force = force;
        self.rotation.step(rate);
    }

    #[inline(never)]
    fn navigate(&mut self, sample: Sample) {
        let (force, rate) = self.correct(sample);
        let saturated = Saturation {
            accelerometer: sample.0.saturated(FULL_SCALE),
            gyroscope: sample.1.saturated(FULL_SCALE),
        };
        self.integrator.step_inertial(force, rate, saturated);
    }
}

/// Correction with g-sensitivity, attitude, and the complete sample with position.
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
        integrator: Integrator::new(Config::new(PERIOD).map_err(|_| "no period")?),
        rotation: Rotation::new([1.0, 0.0, 0.0, 0.0], PERIOD),
        accelerometer,
        gyroscope,
        force: SpecificForceQ16::default(),
    });
    // The rotation is integrated from the first rest on.
    for _ in 0..SAMPLES {
        let (force, rate) = (SpecificForceQ16(GRAVITY), AngularRateQ20([0; 3]));
        (unit.integrator).step_inertial(force, rate, Saturation::default());
    }
    let mut each = |name: &str, code: &mut dyn FnMut(&mut Unit, Sample) -> u32| {
        let (mut sum, mut most) = (0, 0);
        for (&force, &rate) in motion.iter().zip(motion.iter().rev()) {
            let cost = code(&mut unit, (force, rate));
            sum += cost;
            most = most.max(cost);
        }
        crate::report(name, sum, SAMPLES as u32, most);
    };
    each("six-correction", &mut |unit, sample| counter.count(|| unit.corrected(sample)));
    each("six-attitude", &mut |unit, (_, rate)| {
        let rate = AngularRateQ20(rate.0.map(|axis| i32::from(axis) << 8));
        counter.count(|| unit.attitude(rate))
    });
    each("six-correction+attitude", &mut |unit, sample| {
        counter.count(|| unit.corrected_attitude(sample))
    });
    each("six-complete", &mut |unit, sample| counter.count(|| unit.navigate(sample)));
    black_box(&unit);
    Ok(())
}
