//! The LSM303AGR (accelerometer, magnetometer, temperature) behind [`Accelerometer`].

use embedded_hal_async::i2c::{self, I2c};
use lsm303agr::interface::I2cInterface;
use lsm303agr::mode::{MagContinuous, MagOneShot};
use lsm303agr::{
    AccelMode, AccelOutputDataRate, AccelScale, Error, Interrupt, MagMode, MagOutputDataRate,
};
use wimu_link::message::{Resolution, Settings};
use wimu_model::{CentiCelsius, Counts, DeviceTimeUs, MagneticFieldNt, PeriodNs, Sensitivity};

use crate::accelerometer::{Accelerometer, Batch, Plan, SensorFault, Surroundings};
use crate::data_ready::DataReady;
use crate::timer::Timer;

/// WHO_AM_I_A.
const IDENTITY: u8 = 0x33;

/// Ranges, ± g, with the weight of a 16-bit count: LSB per g. A 12-bit digit is 1, 2, 4 and 12
/// times 1/1024 g; ± 16 g is really ± 24 g.
const RANGES: [(u8, AccelScale, f64); 4] = [
    (2, AccelScale::G2, 16384.0),
    (4, AccelScale::G4, 8192.0),
    (8, AccelScale::G8, 4096.0),
    (16, AccelScale::G16, 16384.0 / 12.0),
];

/// Rates, Hz, with the nominal period.
const RATES: [(u16, AccelOutputDataRate, u32); 8] = [
    (1, AccelOutputDataRate::Hz1, 1_000_000_000),
    (10, AccelOutputDataRate::Hz10, 100_000_000),
    (25, AccelOutputDataRate::Hz25, 40_000_000),
    (50, AccelOutputDataRate::Hz50, 20_000_000),
    (100, AccelOutputDataRate::Hz100, 10_000_000),
    (200, AccelOutputDataRate::Hz200, 5_000_000),
    (400, AccelOutputDataRate::Hz400, 2_500_000),
    (1344, AccelOutputDataRate::Khz1_344, 744_048),
];

/// An LSM303AGR on an I²C bus with its data-ready line (INT1 of the accelerometer).
pub struct Lsm303agr<I2C, D, T> {
    device: Device<I2C>,
    data_ready: D,
    timer: T,
    period: PeriodNs,
    /// The magnetometer has measured since it was configured; until then its registers mean nothing.
    field_measured: bool,
}

/// The driver's type changes with the magnetometer's mode.
enum Device<I2C> {
    Idle(lsm303agr::Lsm303agr<I2cInterface<I2C>, MagOneShot>),
    Running(lsm303agr::Lsm303agr<I2cInterface<I2C>, MagContinuous>),
    /// Only while the mode changes.
    Changing,
}

impl<I2C: I2c, D: DataReady, T: Timer> Lsm303agr<I2C, D, T> {
    /// A sensor on `i2c` whose `data_ready` line is high while a sample waits.
    pub fn new(i2c: I2C, data_ready: D, timer: T) -> Self {
        Self {
            device: Device::Idle(lsm303agr::Lsm303agr::new_with_i2c(i2c)),
            data_ready,
            timer,
            period: PeriodNs(10_000_000),
            field_measured: false,
        }
    }

    /// The driver with the magnetometer running.
    async fn running(
        &mut self,
    ) -> Result<&mut lsm303agr::Lsm303agr<I2cInterface<I2C>, MagContinuous>, SensorFault> {
        let mut outcome = Err(SensorFault::NotAnswering);
        self.device = match core::mem::replace(&mut self.device, Device::Changing) {
            Device::Idle(idle) => match idle.into_mag_continuous().await {
                Ok(running) => Device::Running(running),
                Err(failed) => {
                    outcome = Err(fault(failed.error));
                    Device::Idle(failed.dev)
                }
            },
            other => other,
        };
        match &mut self.device {
            Device::Running(running) => Ok(running),
            _ => outcome,
        }
    }
}

impl<I2C: I2c, D: DataReady, T: Timer> Accelerometer for Lsm303agr<I2C, D, T> {
    fn plan(wanted: &Settings) -> Result<Plan, Settings> {
        let nearest_range = RANGES
            .iter()
            .min_by_key(|(g, ..)| g.abs_diff(wanted.range_g));
        let nearest_rate = RATES
            .iter()
            .filter(|(hz, ..)| *hz < 1000 || wanted.resolution != Resolution::LowPower)
            .min_by_key(|(hz, ..)| hz.abs_diff(wanted.rate_hz));
        let (Some(&(range_g, _, lsb_per_g)), Some(&(rate_hz, _, period))) =
            (nearest_range, nearest_rate)
        else {
            return Err(*wanted);
        };
        let settings = Settings {
            range_g,
            rate_hz,
            ..*wanted
        };
        let sensitivity = Sensitivity::from_lsb_per_g(lsb_per_g);
        match sensitivity {
            Ok(sensitivity) if settings == *wanted => Ok(Plan {
                settings,
                period: PeriodNs(period),
                sensitivity,
                full_scale: match settings.resolution {
                    Resolution::LowPower => 0x7F00,
                    Resolution::Normal => 0x7FC0,
                    Resolution::High => 0x7FF0,
                },
            }),
            _ => Err(settings),
        }
    }

    async fn configure(&mut self, plan: &Plan) -> Result<(), SensorFault> {
        let scale = RANGES
            .iter()
            .find(|(g, ..)| *g == plan.settings.range_g)
            .map_or(AccelScale::G2, |(_, scale, _)| *scale);
        let rate = RATES
            .iter()
            .find(|(hz, ..)| *hz == plan.settings.rate_hz)
            .map_or(AccelOutputDataRate::Hz100, |(_, rate, _)| *rate);
        let mode = match plan.settings.resolution {
            Resolution::LowPower => AccelMode::LowPower,
            Resolution::Normal => AccelMode::Normal,
            Resolution::High => AccelMode::HighResolution,
        };
        self.period = plan.period;
        self.field_measured = false;
        let device = self.running().await?;
        let identity = device.accelerometer_id().await.map_err(fault)?;
        if !identity.is_correct() {
            return Err(SensorFault::WrongIdentity {
                expected: IDENTITY,
                found: identity.raw(),
            });
        }
        device.init().await.map_err(fault)?;
        device.set_accel_scale(scale).await.map_err(fault)?;
        device
            .acc_enable_interrupt(Interrupt::DataReady1)
            .await
            .map_err(fault)?;
        device
            .set_mag_mode_and_odr(
                &mut NoDelay,
                MagMode::HighResolution,
                MagOutputDataRate::Hz10,
            )
            .await
            .map_err(fault)?;
        device
            .set_accel_mode_and_odr(&mut NoDelay, mode, rate)
            .await
            .map_err(fault)?;
        Ok(())
    }

    async fn next(&mut self, counts: &mut [Counts]) -> Result<Batch, SensorFault> {
        let Some(first) = counts.first_mut() else {
            return Err(SensorFault::NoData);
        };
        // A sample that waits keeps the line high.
        let period_us = u64::from(self.period.0) / 1000;
        let deadline = self.timer.now().0 + period_us * 3 + 20_000;
        let (ready, woken, status) = loop {
            let ready = self
                .timer
                .before(DeviceTimeUs(deadline), self.data_ready.ready());
            let ready = ready.await;
            let woken = self.timer.now();
            let device = self.running().await?;
            let status = device.accel_status().await.map_err(fault)?;
            if status.xyz_new_data() {
                break (ready, woken, status);
            }
            if woken.0 >= deadline {
                return Err(SensorFault::NoData);
            }
            // A line that somebody else holds says nothing: the sensor is asked.
            self.timer.after_us(period_us / 8).await;
        };
        let device = self.running().await?;
        let sample = device.acceleration().await.map_err(fault)?;
        let (x, y, z) = sample.xyz_raw();
        // After a whole period or an overrun, the line tells of an older sample.
        let last_time = match ready.flatten() {
            Some(rose) if !status.xyz_overrun() && woken.0 < rose.0 + period_us => rose,
            _ => woken,
        };
        *first = Counts([x, y, z].map(|raw| raw as i16));
        Ok(Batch {
            count: 1,
            last_time,
            overrun: status.xyz_overrun(),
            queued: false,
        })
    }

    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        let measured = self.field_measured;
        let device = self.running().await?;
        let measured = measured || {
            let status = device.mag_status().await.map_err(fault)?;
            status.xyz_new_data()
        };
        let field = if measured {
            let field = device.magnetic_field().await.map_err(fault)?;
            Some(MagneticFieldNt([field.x_nt(), field.y_nt(), field.z_nt()]))
        } else {
            None
        };
        let temperature = device.temperature().await.map_err(fault)?;
        // 1/256 °C about 25 °C.
        let centi = 2500 + i32::from(temperature.unscaled()) * 100 / 256;
        self.field_measured = measured;
        Ok(Surroundings {
            magnetic_field: field,
            temperature: Some(CentiCelsius(centi as i16)),
        })
    }
}

fn fault<E: i2c::Error>(error: Error<E>) -> SensorFault {
    match error {
        Error::Comm(error) => SensorFault::of_bus(&error),
        // Of values that this module does not ask for.
        Error::InvalidInputData => SensorFault::Transfer,
    }
}

/// The driver's delays wait for the first sample after a change: the data-ready line tells.
struct NoDelay;

impl embedded_hal::delay::DelayNs for NoDelay {
    fn delay_ns(&mut self, _: u32) {}
}

impl embedded_hal_async::delay::DelayNs for NoDelay {
    async fn delay_ns(&mut self, _: u32) {}
}
