//! Sources of a simulated sensor's samples: physics, or a recording.

use std::collections::VecDeque;
use std::fmt;

use wimu_model::{CentiCelsius, Counts, STANDARD_GRAVITY_MPS2, SpecificForceMps2};

use crate::random::Random;
use crate::scene::Scene;
use crate::truth::SensorTruth;

/// One analog-to-digital conversion of an accelerometer, with the settings of its registers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conversion {
    /// Index of the sample, from 0.
    pub index: u64,
    /// Time, s on the simulation's clock.
    pub time_s: f64,
    /// Nominal samples a second.
    pub rate_hz: f64,
    /// Nominal sensitivity of the 16-bit register, LSB/g.
    pub lsb_per_g: f64,
    /// Bits that carry data, at the register's upper end: 1..=16.
    pub bits: u32,
}

/// Provides a sensor's samples.
///
/// Samples are requested in the order of their time, each index once.
pub trait Source: fmt::Debug {
    /// The register content of one accelerometer sample; `None` when there are no more.
    fn acceleration(&mut self, conversion: &Conversion) -> Option<Counts>;

    /// The register content of the gyroscope's sample `index`, at nominally `rate_hz` samples a second.
    /// 0 without a gyroscope.
    fn angular_rate(&mut self, index: u64, time_s: f64, rate_hz: f64, lsb_per_dps: f64) -> Counts {
        let _ = (index, time_s, rate_hz, lsb_per_dps);
        Counts([0; 3])
    }

    /// Magnetic flux density that the magnetometer sees at its sample `index`, nT.
    fn magnetic_field_nt(&mut self, index: u64, time_s: f64) -> [f64; 3];

    /// Temperature at the sensor's thermometer, °C.
    fn temperature_c(&mut self, time_s: f64) -> f64;

    /// How much longer than nominal the sensor's sample period is, ppm.
    fn period_error_ppm(&self) -> f64 {
        0.0
    }

    /// Whether the next sample waits until the last one was read.
    fn waits_for_reader(&self) -> bool {
        false
    }

    /// Whether there are no more accelerometer samples.
    fn exhausted(&self) -> bool {
        false
    }
}

/// A sensor with errors and noise, moved in a scene.
#[derive(Clone, Debug)]
pub struct Physics {
    /// The sensor's errors.
    pub truth: SensorTruth,
    /// Where it is.
    pub scene: Scene,
    acceleration_noise: Random,
    magnetic_noise: Random,
    rate_noise: Random,
}

impl Physics {
    /// A sensor with the errors `truth` in `scene`, with the noise of `seed`.
    pub fn new(truth: SensorTruth, scene: Scene, seed: u64) -> Self {
        Self {
            truth,
            scene,
            acceleration_noise: Random::new(seed, 4),
            magnetic_noise: Random::new(seed, 5),
            rate_noise: Random::new(seed, 9),
        }
    }
}

impl Source for Physics {
    /// Equations (34) and (35).
    fn acceleration(&mut self, conversion: &Conversion) -> Option<Counts> {
        let state = self.scene.state(conversion.time_s);
        let force = SpecificForceMps2(state.specific_force_mps2);
        let temperature = CentiCelsius::from_celsius(state.temperature_c);
        let output = self.truth.model.distort(force, Some(temperature)).0;
        let sigma = self.truth.noise_mps2_per_rthz * libm::sqrt(conversion.rate_hz / 2.0);
        let lsb_per_mps2 = conversion.lsb_per_g / STANDARD_GRAVITY_MPS2;
        Some(Counts(std::array::from_fn(|axis| {
            let draw = 3 * conversion.index + axis as u64;
            let noise = sigma * self.acceleration_noise.gaussian_at(draw);
            quantise((output[axis] + noise) * lsb_per_mps2, conversion.bits)
        })))
    }

    /// Equations (25) and (35).
    fn angular_rate(&mut self, index: u64, time_s: f64, rate_hz: f64, lsb_per_dps: f64) -> Counts {
        let state = self.scene.state(time_s);
        let truth = &self.truth.gyroscope;
        let temperature = Some(CentiCelsius::from_celsius(state.temperature_c));
        let (rate, force) = (state.angular_rate_radps, state.specific_force_mps2);
        let output = truth.model.distort(rate, force, temperature);
        let sigma = truth.noise_radps_per_rthz * libm::sqrt(rate_hz / 2.0);
        Counts(std::array::from_fn(|axis| {
            let noise = sigma * self.rate_noise.gaussian_at(3 * index + axis as u64);
            quantise((output[axis] + noise).to_degrees() * lsb_per_dps, 16)
        }))
    }

    /// Equation (37).
    fn magnetic_field_nt(&mut self, index: u64, time_s: f64) -> [f64; 3] {
        let field = self.scene.state(time_s).magnetic_field_nt;
        let truth = &self.truth.magnetometer;
        std::array::from_fn(|axis| {
            let row = truth.soft_iron[axis];
            let bent = row[0] * field[0] + row[1] * field[1] + row[2] * field[2];
            let noise = self.magnetic_noise.gaussian_at(3 * index + axis as u64);
            bent + truth.hard_iron_nt[axis] + truth.noise_nt * noise
        })
    }

    fn temperature_c(&mut self, time_s: f64) -> f64 {
        self.scene.state(time_s).temperature_c + self.truth.thermometer_error_k
    }

    fn period_error_ppm(&self) -> f64 {
        self.truth.period_error_ppm
    }
}

/// The register content for an analog value, in LSB of 16 bits: rounded to the nearest step of
/// `bits` bits (halves away from 0), limited to the range, left-justified. Equation (35).
pub fn quantise(lsb: f64, bits: u32) -> i16 {
    let step = f64::from(1_u32 << (16 - bits));
    let half_range = f64::from(1_u32 << (bits - 1));
    let digit = libm::round(lsb / step).clamp(-half_range, half_range - 1.0);
    (digit * step) as i16
}

/// A recording: its counts appear in the output registers bit for bit, one per sample period,
/// whatever range, resolution and rate are set. The field is 0, the temperature 25 °C.
#[derive(Clone, Debug)]
pub struct Replay {
    samples: VecDeque<Counts>,
    waits: bool,
}

impl Replay {
    /// Replays `samples` as a sensor would: samples that are not read before the next one are lost.
    pub fn new(samples: impl IntoIterator<Item = Counts>) -> Self {
        Self { samples: samples.into_iter().collect(), waits: false }
    }

    /// Holds each sample until it was read: a slow reader, or the set-up of the sensor,
    /// delays the recording instead of losing parts of it.
    pub fn waiting_for_reader(mut self) -> Self {
        self.waits = true;
        self
    }
}

impl Source for Replay {
    fn acceleration(&mut self, _conversion: &Conversion) -> Option<Counts> {
        self.samples.pop_front()
    }

    fn magnetic_field_nt(&mut self, _index: u64, _time_s: f64) -> [f64; 3] {
        [0.0; 3]
    }

    fn temperature_c(&mut self, _time_s: f64) -> f64 {
        25.0
    }

    fn waits_for_reader(&self) -> bool {
        self.waits
    }

    fn exhausted(&self) -> bool {
        self.samples.is_empty()
    }
}
