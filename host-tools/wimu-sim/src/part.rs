//! The sensors that a board can have.

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
    /// The same, with a FIFO without tags.
    Lsm6ds3trC,
    /// Accelerometer, gyroscope and thermometer, read through a FIFO without watermark.
    Mpu6050,
    /// Accelerometer, gyroscope and thermometer on SPI, read at intervals of the board's timer.
    Icm42688,
}

impl SensorPart {
    /// The sensor after power-on, with samples from `source`.
    pub fn power_on(self, clock: &VirtualClock, source: impl Source + 'static) -> Sensor {
        match self {
            Self::Lsm303agr => Sensor::lsm303agr(clock, source),
            Self::Adxl345 => Sensor::adxl345(clock, source),
            Self::Lsm6dso => Sensor::lsm6dso(clock, 0x6A, source),
            Self::Lsm6ds3trC => Sensor::lsm6ds3tr_c(clock, 0x6A, source),
            Self::Mpu6050 => Sensor::mpu6050(clock, 0x68, source),
            Self::Icm42688 => Sensor::icm42688(clock, source),
        }
    }

    /// The errors of a typical uncalibrated one; the same for the same `seed` and `gauge`.
    pub fn random_truth(self, seed: u64, gauge: Gauge) -> SensorTruth {
        match self {
            Self::Lsm303agr => SensorTruth::random(seed, gauge),
            Self::Adxl345 => SensorTruth::random_adxl345(seed, gauge),
            Self::Lsm6dso | Self::Lsm6ds3trC | Self::Icm42688 => {
                SensorTruth::random_lsm6dso(seed, gauge)
            }
            Self::Mpu6050 => SensorTruth::random_mpu6050(seed, gauge),
        }
    }

    /// Content of its identification register; the accelerometer's of an LSM303AGR.
    pub fn who_am_i(self) -> u8 {
        match self {
            Self::Lsm303agr => 0x33,
            Self::Adxl345 => 0xE5,
            Self::Lsm6dso => 0x6C,
            Self::Lsm6ds3trC => 0x6A,
            Self::Mpu6050 => 0x68,
            Self::Icm42688 => 0x47,
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lsm303agr => "LSM303AGR",
            Self::Adxl345 => "ADXL345",
            Self::Lsm6dso => "LSM6DSO",
            Self::Lsm6ds3trC => "LSM6DS3TR-C",
            Self::Mpu6050 => "MPU-6050",
            Self::Icm42688 => "ICM-42688",
        }
    }
}
