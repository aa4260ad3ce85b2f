use core::ops::RangeInclusive;

use embedded_hal_async::delay::DelayNs;

use crate::registers::*;
use crate::{AccelerationRange, AngularRateRange, Bus, Error, Lsm6dso, Rate};

const ACCELERATION: AccelerationRange = AccelerationRange::G4;
const ANGULAR_RATE: AngularRateRange = AngularRateRange::Dps2000;
const RATE: Rate = Rate::Hz52;
/// A sample period, with reserve for an oscillator that is slow by 10 %.
const PERIOD_US: u32 = RATE.period_ns() / 1000 * 11 / 10;
/// Until the outputs are stable after a change, with reserve to 100 ms.
const SETTLING_US: u32 = 120_000;
/// Samples that are averaged.
const AVERAGED: i32 = 5;

/// 50 to 1700 m*g*, LSB of 0.122 m*g*.
const ACCELERATION_LIMITS: RangeInclusive<u32> = 410..=13_934;
/// 150 to 700 °/s, LSB of 70 m°/s.
const ANGULAR_RATE_LIMITS: RangeInclusive<u32> = 2_143..=10_000;

/// Change of each axis by the actuation of the self-test: mean with it minus mean without, x, y, z.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SelfTest {
    /// Specific force, LSB at ±4 *g*: 0.122 m*g*.
    pub acceleration: [i32; 3],
    /// Angular rate, LSB at ±2000 °/s: 70 m°/s.
    pub angular_rate: [i32; 3],
}

impl SelfTest {
    /// Which axes of the accelerometer changed by 50 to 1700 m*g*, and which of the gyroscope by 150
    /// to 700 °/s (DS12140 §4.1, Table 2), in either direction.
    pub fn passed(&self) -> [[bool; 3]; 2] {
        [
            self.acceleration.map(|lsb| ACCELERATION_LIMITS.contains(&lsb.unsigned_abs())),
            self.angular_rate.map(|lsb| ANGULAR_RATE_LIMITS.contains(&lsb.unsigned_abs())),
        ]
    }
}

impl<B: Bus> Lsm6dso<B> {
    /// Measures the change of each axis by the self-test; the sensor must be at rest. The chip is
    /// reset before and after, so that [`start`](Self::start) has to follow. Takes 0.6 s.
    ///
    /// # Errors
    /// Those of [`reset`](Self::reset).
    pub async fn self_test(
        &mut self,
        delay: &mut impl DelayNs,
    ) -> Result<SelfTest, Error<B::Error>> {
        self.reset(delay).await?;
        self.start_interface().await?;
        let rate = RATE.code() << 4;
        self.registers.write(CTRL1_XL, rate | ACCELERATION.bits()).await?;
        self.registers.write(CTRL2_G, rate | ANGULAR_RATE.bits()).await?;
        let without = self.mean(delay).await?;
        let both = CTRL5_ST_XL_POSITIVE | CTRL5_ST_G_POSITIVE;
        self.registers.write(CTRL5_C, both).await?;
        let with = self.mean(delay).await?;
        self.reset(delay).await?;
        let [x, y, z, angular_rate @ ..] = [0, 1, 2, 3, 4, 5].map(|i: usize| with[i] - without[i]);
        Ok(SelfTest { acceleration: [x, y, z], angular_rate })
    }

    /// Mean counts, accelerometer and gyroscope.
    async fn mean(&mut self, delay: &mut impl DelayNs) -> Result<[i32; 6], Error<B::Error>> {
        delay.delay_us(SETTLING_US).await;
        let mut sum = [0; 6];
        for _ in 0..AVERAGED {
            delay.delay_us(PERIOD_US).await;
            let sample = self.newest().await?;
            let counts = sample.acceleration.iter().chain(&sample.angular_rate);
            for (sum, axis) in sum.iter_mut().zip(counts) {
                *sum += i32::from(*axis);
            }
        }
        Ok(sum.map(|sum| sum / AVERAGED))
    }
}
