//! The MPU-6050 family (accelerometer, gyroscope, temperature) behind [`InertialSensor`], through its FIFO.

use wimu_link::hello::{Capabilities, Part, sensor};
use wimu_link::message::{Resolution, Settings};
use wimu_model::{CentiCelsius, Counts, DeviceTimeUs, PeriodNs};
use wimu_mpu6050::{AccelerationRange, AngularRateRange, Bus, Sample, Setup};

use crate::data_ready::DataReady;
use crate::fifo::{FifoState, MAX_WATERMARK, SensorFifo};
use crate::sensor::{
    AccelerometerScale, Batch, GyroscopePlan, InertialSensor, Plan, SensorFault, SensorPlan,
    Supported, Surroundings,
};
use crate::timer::{Delay, Timer};

/// The rates are 1 kHz over 1 + the divider.
const SUPPORTED: Supported<(AccelerationRange, &AccelerometerScale), u8> = Supported {
    ranges: &[
        (2, (AccelerationRange::G2, &scale(AccelerationRange::G2))),
        (4, (AccelerationRange::G4, &scale(AccelerationRange::G4))),
        (8, (AccelerationRange::G8, &scale(AccelerationRange::G8))),
        (16, (AccelerationRange::G16, &scale(AccelerationRange::G16))),
    ],
    rates: &[(25, 39), (50, 19), (100, 9), (125, 7), (200, 4), (250, 3), (500, 1), (1000, 0)],
    has_low_power: |_| false,
};

/// Range of the gyroscope: the widest, because a hand exceeds 1000 °/s, and a saturated rate ends the attitude.
const ANGULAR_RATE: AngularRateRange = AngularRateRange::Dps2000;
static GYROSCOPE: GyroscopePlan =
    GyroscopePlan::new((ANGULAR_RATE.dps() as f64 / 32768.0).to_radians(), i16::MAX as i32);

const fn scale(range: AccelerationRange) -> AccelerometerScale {
    AccelerometerScale::of(range.lsb_per_g() as f64)
}

/// Capacity of the smallest FIFO of the family, samples.
const DEPTH: u16 = 512 / 12;
/// Time to read a sample on an I²C bus of 400 kHz, µs.
const TRANSFER_US: u64 = 290;
/// Delay of the data-ready edge after which the FIFO is read without it, µs, beside two sample periods: the latency of
/// interrupts and tasks. The FIFO holds 42 ms at the highest rate.
const LATE_US: u64 = 10_000;

/// An MPU-6050, MPU-6500, MPU-9250 or a part sold as one, on an I²C or SPI bus, with its INT line.
///
/// The chip has no watermark: the driver sleeps until a sample of the next batch is due and takes that sample's data-ready
/// edge as its time. Without the line (a [`DataReady`] that never completes) times follow the FIFO's level, up to a
/// sample period late. The gyroscope's range is ±2000 °/s.
pub struct Mpu6050<B, D, T> {
    device: wimu_mpu6050::Mpu6050<B>,
    data_ready: D,
    timer: T,
    fifo: SensorFifo,
    /// Time of the newest sample read.
    last: DeviceTimeUs,
}

impl<B, D, T: Timer> Mpu6050<B, D, T> {
    /// A sensor on `bus` (an [`I2cBus`](wimu_mpu6050::I2cBus) or [`SpiBus`](wimu_mpu6050::SpiBus)) whose INT is
    /// `data_ready`.
    pub fn new(bus: B, data_ready: D, timer: T) -> Self {
        Self {
            device: wimu_mpu6050::Mpu6050::new(bus),
            data_ready,
            timer,
            fifo: SensorFifo::new(DEPTH, PeriodNs(10_000_000), TRANSFER_US),
            last: DeviceTimeUs(0),
        }
    }

    /// The plan for `wanted`.
    ///
    /// # Errors
    /// The nearest supported settings.
    pub fn plan(wanted: &Settings) -> Result<Plan, Settings> {
        let high = Settings { resolution: Resolution::High, ..*wanted };
        let planned = SUPPORTED.plan(&high, |(_, scale), divider| {
            let period = PeriodNs(1_000_000 * (u32::from(divider) + 1));
            let sensor = SensorPlan::new(period, scale, i16::MAX as i32);
            sensor.with_gyroscope(&GYROSCOPE)
        })?;
        if high == *wanted { Ok(planned) } else { Err(high) }
    }
}

impl<B: Bus, D: DataReady, T: Timer> Mpu6050<B, D, T> {
    /// Waits for the last sample of the next batch; reads the state of the FIFO.
    async fn read_state(&mut self) -> Result<FifoState, wimu_mpu6050::Error<B::Error>> {
        // Half a period before that sample.
        let before_us = self.fifo.micros(self.fifo.watermark()) - self.fifo.micros(1) / 2;
        self.timer.until(DeviceTimeUs(self.last.0.saturating_add(before_us))).await;
        let overflowed = self.device.clear_interrupt().await?;
        let latest = self.timer.now().0.saturating_add(self.fifo.micros(2) + LATE_US);
        let line = self.timer.before(DeviceTimeUs(latest), self.data_ready.ready()).await;
        let woken = self.timer.now();
        let level = self.device.level().await?;
        let at = self.timer.now();
        let state = match line {
            Some(edge) => {
                let edge_time = edge.unwrap_or(woken);
                let since_us = at.0.saturating_sub(edge_time.0);
                let newer = since_us / self.fifo.micros(1).max(1);
                let newer = u16::try_from(newer).unwrap_or(u16::MAX);
                FifoState::new(edge_time, at, level.samples)
                    .with_edge_at(level.samples.saturating_sub(newer))
            }
            // No time is believed.
            None => FifoState::new(DeviceTimeUs(0), at, level.samples),
        };
        Ok(state.with_overrun(overflowed || level.full))
    }
}

impl<B: Bus, D: DataReady, T: Timer> InertialSensor for Mpu6050<B, D, T> {
    type Sample = (Counts, Counts);
    type Planner = fn(&Settings) -> Result<Plan, Settings>;
    const MAGNETOMETER: bool = false;
    const PART: Part = Part::new(sensor::MPU6050, "MPU-6050");
    const CAPABILITIES: Capabilities =
        Capabilities::ACCELEROMETER.with(Capabilities::GYROSCOPE).with(Capabilities::TEMPERATURE);

    fn planner(&self) -> Self::Planner {
        Self::plan
    }

    async fn configure(&mut self, plan: &Plan) -> Result<(), SensorFault> {
        self.fifo = SensorFifo::new(DEPTH, plan.sensor.period, TRANSFER_US);
        let Some((_, (acceleration, _), divider)) = SUPPORTED.nearest(&plan.settings) else {
            return Ok(()); // Not a plan of this sensor.
        };
        let setup = Setup { acceleration, angular_rate: ANGULAR_RATE, divider };
        let started = self.device.start(&setup, &mut Delay(&self.timer)).await;
        self.last = self.timer.now();
        started.map_err(SensorFault::of_driver)
    }

    async fn next(&mut self, samples: &mut [(Counts, Counts)]) -> Result<Batch, SensorFault> {
        let mut lost = false;
        loop {
            let state = self.read_state().await.map_err(SensorFault::of_driver)?;
            let mut read = [Sample::default(); MAX_WATERMARK as usize];
            let count = samples.len().min(read.len()).min(state.level.into());
            let read = read.get_mut(..count).unwrap_or_default();
            if !state.overrun {
                if count == 0 {
                    return Err(SensorFault::NoData);
                }
                self.device.read(read).await.map_err(SensorFault::of_driver)?;
            }
            if state.overrun || !self.fifo.kept_up(&state, self.timer.now()) {
                // The axes are no longer aligned.
                self.device.reset_fifo().await.map_err(SensorFault::of_driver)?;
                self.last = self.timer.now();
                lost = true;
                continue;
            }
            for (sample, read) in samples.iter_mut().zip(&*read) {
                *sample = (Counts(read.acceleration), Counts(read.angular_rate));
            }
            let unread = state.level - count as u16;
            let batch = self.fifo.read(state.with_overrun(lost), count, unread);
            self.last = batch.last_time;
            return Ok(batch);
        }
    }

    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        let centi = self.device.temperature().await.map_err(SensorFault::of_driver)?;
        Ok(Surroundings { magnetic_field: None, temperature: Some(CentiCelsius(centi)) })
    }
}
