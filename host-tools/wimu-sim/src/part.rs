//! The sensors that a board can have.

use wimu_link::hello::{Capabilities, Part, sensor};

use crate::clock::VirtualClock;
use crate::sensor::Sensor;
use crate::source::Source;
use crate::truth::{Gauge, SensorTruth};

/// Sensor of a simulated board, on its I²C bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SensorPart {
    /// Accelerometer, magnetometer and thermometer, read by data-ready.
    #[default]
    Lsm303agr,
    /// Accelerometer only, read through its FIFO.
    Adxl345,
    /// Accelerometer, gyroscope and thermometer, read through its FIFO.
    Lsm6dso,
}

impl SensorPart {
    /// The sensor after power-on, with samples from `source`.
    pub fn power_on(self, clock: &VirtualClock, source: impl Source + 'static) -> Sensor {
        match self {
            Self::Lsm303agr => Sensor::lsm303agr(clock, source),
            Self::Adxl345 => Sensor::adxl345(clock, source),
            Self::Lsm6dso => Sensor::lsm6dso(clock, 0x6A, source),
        }
    }

    /// The errors of a typical uncalibrated one; the same for the same `seed` and `gauge`.
    pub fn random_truth(self, seed: u64, gauge: Gauge) -> SensorTruth {
        match self {
            Self::Lsm303agr => SensorTruth::random(seed, gauge),
            Self::Adxl345 => SensorTruth::random_adxl345(seed, gauge),
            Self::Lsm6dso => SensorTruth::random_lsm6dso(seed, gauge),
        }
    }

    /// Content of its identification register; the accelerometer's of an LSM303AGR.
    pub fn who_am_i(self) -> u8 {
        match self {
            Self::Lsm303agr => 0x33,
            Self::Adxl345 => 0xE5,
            Self::Lsm6dso => 0x6C,
        }
    }

    /// Number and name, and the quantities that it measures.
    pub fn identity(self) -> (Part, Capabilities) {
        use Capabilities as C;
        let (number, name, quantities) = match self {
            Self::Lsm303agr => {
                (sensor::LSM303AGR, "LSM303AGR", C::MAGNETOMETER.with(C::TEMPERATURE))
            }
            Self::Adxl345 => (sensor::ADXL345, "ADXL345", Capabilities(0)),
            Self::Lsm6dso => (sensor::LSM6DSO, "LSM6DSO", C::GYROSCOPE.with(C::TEMPERATURE)),
        };
        (Part::new(number, name), quantities.with(C::ACCELEROMETER))
    }
}
