//! Two or three accelerometers of different full scale on one body, which is waved by hand and then stopped by an impact.

use wimu_host::recording::{Quantity, Recording, Sink, TrackInfo, Unit};
use wimu_model::{ErrorModel, STANDARD_GRAVITY_MPS2, SpecificForceMps2};

use crate::attitude::Attitude;
use crate::motion::{Hand, Impact, Motion, Rest, Sequence};
use crate::random::Random;
use crate::scene::{Scene, World};
use crate::source::quantise;
use crate::truth::{Gauge, SensorTruth};
use std::rc::Rc;

/// An accelerometer.
#[derive(Clone, Copy, Debug)]
pub struct Accelerometer {
    /// Full scale, ± *g*.
    pub full_scale_g: f64,
    /// Bits of a sample.
    pub bits: u32,
    /// Standard deviation of the noise of a sample, m/s².
    pub noise_mps2: f64,
    /// Its errors.
    pub model: ErrorModel,
    /// Samples a second, by its own clock.
    pub rate_hz: f64,
    /// How late its time stamps are, s.
    pub delay_s: f64,
    /// How fast the clock of its time stamps is, ppm.
    pub clock_ppm: f64,
    /// Body axes against its own.
    pub mount: Attitude,
}

/// The accelerometers and their motion: 3 s of rest, a hand for 10 s with up to 2.2 g, an impact.
#[derive(Clone, Debug)]
pub struct MultiRange {
    /// Seed of errors, noise and motion.
    pub seed: u64,
    /// The accelerometers.
    pub sensors: Vec<Accelerometer>,
    /// Whether a hand waves them before the impact.
    pub waved: bool,
    /// The impact.
    pub impact: Impact,
}

impl MultiRange {
    /// An LSM303AGR of ± 2 g and an ADXL345 of ± 16 g at 400 Hz with errors of `seed`, and an impact of ± 10 g in 30 ms; with
    /// `widest` also an ADXL375 of ± 200 g (13 bits, 5 mg/√Hz), and an impact of 100 g.
    pub fn new(seed: u64, widest: bool) -> Self {
        let rate_hz = 400.0;
        let fine = SensorTruth::random(seed, Gauge::Full);
        let coarse = SensorTruth::random_adxl345(seed ^ 0xADE1, Gauge::Full);
        let unit = |truth: &SensorTruth, full_scale_g, bits, density: f64| Accelerometer {
            full_scale_g,
            bits,
            noise_mps2: density * libm::sqrt(rate_hz / 2.0),
            model: truth.model,
            rate_hz: rate_hz / (1.0 + truth.period_error_ppm * 1e-6),
            delay_s: 0.0,
            clock_ppm: 0.0,
            mount: Attitude::LEVEL,
        };
        let mut random = Random::new(seed, 20);
        let mut sensors = vec![
            unit(&fine, 2.0, 12, fine.noise_mps2_per_rthz),
            Accelerometer {
                delay_s: random.uniform(0.0, 3e-3),
                ..unit(&coarse, 16.0, 13, coarse.noise_mps2_per_rthz)
            },
        ];
        if widest {
            let truth = SensorTruth::random_adxl345(seed ^ 0x375, Gauge::Full);
            let density = 5e-3 * STANDARD_GRAVITY_MPS2;
            sensors.push(unit(&truth, 200.0, 13, density));
        }
        let peak_mps2 = if widest { 1000.0 } else { 100.0 };
        let impact = Impact { peak_mps2, pulse_s: 0.03, ..Impact::default() };
        Self { seed, sensors, waved: true, impact }
    }

    fn scene(&self) -> Scene {
        let hand: Rc<dyn Motion> = if self.waved {
            Rc::new(Hand::new(self.seed, 10.0, 2.2 * STANDARD_GRAVITY_MPS2))
        } else {
            Rc::new(Rest::level(10.0))
        };
        let scene = Scene::new(World::default());
        let parts: [Rc<dyn Motion>; 3] = [Rc::new(Rest::level(3.0)), hand, Rc::new(self.impact)];
        scene.play(0.0, Rc::new(Sequence::new(parts)));
        scene
    }

    /// A recording of their counts, with the time stamps of each.
    pub fn record(&self) -> Recording {
        let scene = self.scene();
        let mut recording = Recording::new("simulated accelerometers");
        for (index, sensor) in (0_u8..).zip(&self.sensors) {
            // 16-bit registers, left-justified.
            let si_per_lsb = sensor.full_scale_g * STANDARD_GRAVITY_MPS2 / 32768.0;
            let unit = Unit::Counts { si_per_lsb: Some(si_per_lsb) };
            let name = format!("accelerometer {index}");
            let mut info = TrackInfo::new(name, Quantity::SpecificForce, unit).of_sensor(index);
            info.full_scale = Some(sensor.full_scale_g * STANDARD_GRAVITY_MPS2);
            let track = recording.track(info);
            let noise = Random::new(self.seed, 21 + u64::from(index));
            let count = (scene.end_s() * sensor.rate_hz) as u64;
            for k in 0..count {
                // Not in phase with the others.
                let time_s = (k as f64 + 0.3 * f64::from(index)) / sensor.rate_hz;
                let output = sensor.output(&scene, time_s);
                let value: [f64; 3] = std::array::from_fn(|axis| {
                    let noise = noise.gaussian_at(3 * k + axis as u64) * sensor.noise_mps2;
                    f64::from(quantise((output[axis] + noise) / si_per_lsb, sensor.bits))
                });
                let stamp_s = time_s * (1.0 + sensor.clock_ppm * 1e-6) + sensor.delay_s;
                recording.row(track, (stamp_s * 1e9) as i64, &value);
            }
        }
        recording
    }

    /// The output of the first accelerometer without noise, steps and limits, m/s², at a time.
    pub fn truth(&self) -> impl Fn(f64) -> [f64; 3] + use<> {
        let (scene, first) = (self.scene(), self.sensors.first().copied());
        move |time_s| first.map_or([f64::NAN; 3], |sensor| sensor.output(&scene, time_s))
    }

    /// Beginning and end of the pulse, s.
    pub fn pulse_s(&self) -> [f64; 2] {
        let end_s = self.scene().end_s() - self.impact.duration();
        let begin_s = end_s + self.impact.begin_s();
        [begin_s, begin_s + self.impact.pulse_s]
    }
}

impl Accelerometer {
    /// m/s², its own axes.
    fn output(&self, scene: &Scene, time_s: f64) -> [f64; 3] {
        let force = scene.state(time_s).specific_force_mps2;
        let force = SpecificForceMps2(self.mount.to_body(force));
        self.model.distort(force, None).0
    }
}
