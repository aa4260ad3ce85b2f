//! The LSM6DSO and the LSM6DS3TR-C (accelerometer, gyroscope, temperature) behind [`InertialSensor`], through its FIFO.

use wimu_link::hello::{Capabilities, Part, sensor};
use wimu_link::message::{Resolution, Settings};
use wimu_lsm6dso::{
    AccelerationRange, AngularRateRange, Bus, FifoFault, Model, Power, Rate, Sample, Setup,
};
use wimu_model::{CentiCelsius, Counts, PeriodNs};

use crate::data_ready::DataReady;
use crate::fifo::{FifoState, MAX_WATERMARK, SensorFifo};
use crate::sensor::{
    AccelerometerScale, Batch, GyroscopePlan, InertialSensor, Plan, SensorFault, SensorPlan,
    Supported, Surroundings,
};
use crate::timer::{Delay, Timer};

/// Rates up to the fastest on an I²C bus of 400 kHz; the first is 12.5 Hz by its name, 13.02 Hz by the datasheet's
/// formula.
const SUPPORTED: Supported<(AccelerationRange, &AccelerometerScale), Rate> = Supported {
    ranges: &[
        (2, (AccelerationRange::G2, &scale(AccelerationRange::G2))),
        (4, (AccelerationRange::G4, &scale(AccelerationRange::G4))),
        (8, (AccelerationRange::G8, &scale(AccelerationRange::G8))),
        (16, (AccelerationRange::G16, &scale(AccelerationRange::G16))),
    ],
    rates: &[
        (13, Rate::Hz12_5),
        (26, Rate::Hz26),
        (52, Rate::Hz52),
        (104, Rate::Hz104),
        (208, Rate::Hz208),
        (416, Rate::Hz416),
        (833, Rate::Hz833),
        (1666, Rate::Hz1666),
    ],
    has_low_power: Rate::has_low_power,
};

/// Range of the gyroscope: the widest, because a hand exceeds 1000 °/s, and a saturated rate ends the attitude.
/// Its LSB, 70 m°/s, is as large as the noise at 208 Hz.
const ANGULAR_RATE: AngularRateRange = AngularRateRange::Dps2000;
static GYROSCOPE: GyroscopePlan =
    GyroscopePlan::new((ANGULAR_RATE.udps_per_lsb() as f64 * 1e-6).to_radians(), i16::MAX as i32);

const fn scale(range: AccelerationRange) -> AccelerometerScale {
    AccelerometerScale::of(1e6 / range.ug_per_lsb() as f64)
}

/// Capacity of the FIFO, pairs.
const DEPTH: u16 = 256;
/// Time to read a pair on an I²C bus of 400 kHz, µs.
const TRANSFER_US: u64 = 350;
/// Reads in succession without a gyroscope word after which the gyroscope has stopped.
const WITHOUT_GYROSCOPE: u8 = 2;

/// An LSM6DS3TR-C, as on the Seeed XIAO nRF52840 Sense; otherwise as [`Lsm6dso`]. Its FIFO has no tags, so that a
/// gyroscope that stops is not noticed.
pub type Lsm6ds3trC<B, D, T> = Lsm6dso<B, D, T, false>;

/// An LSM6DSO on an I²C or SPI bus, with its INT1 line.
///
/// Pairs of both sensors are read from the FIFO when INT1 signals the watermark: 40 ms of samples, at most 16.
/// The gyroscope's range is ±2000 °/s.
pub struct Lsm6dso<B, D, T, const TAGGED: bool = true> {
    device: wimu_lsm6dso::Lsm6dso<B>,
    data_ready: D,
    timer: T,
    fifo: SensorFifo,
}

impl<B, D, T, const TAGGED: bool> Lsm6dso<B, D, T, TAGGED> {
    const MODEL: Model = if TAGGED { Model::Lsm6dso } else { Model::Lsm6ds3trC };

    /// A sensor on `bus` (an [`I2cBus`](wimu_lsm6dso::I2cBus) or [`SpiBus`](wimu_lsm6dso::SpiBus)) whose INT1 is
    /// `data_ready`.
    pub fn new(bus: B, data_ready: D, timer: T) -> Self {
        Self {
            device: wimu_lsm6dso::Lsm6dso::of_model(bus, Self::MODEL),
            data_ready,
            timer,
            fifo: SensorFifo::new(DEPTH, PeriodNs(10_000_000), TRANSFER_US),
        }
    }

    /// The plan for `wanted`.
    ///
    /// # Errors
    /// The nearest supported settings.
    pub fn plan(wanted: &Settings) -> Result<Plan, Settings> {
        SUPPORTED.plan(wanted, |(_, scale), rate| {
            let sensor = SensorPlan::new(PeriodNs(rate.period_ns()), scale, i16::MAX as i32);
            sensor.with_gyroscope(&GYROSCOPE)
        })
    }
}

impl<B: Bus, D: DataReady, T: Timer, const TAGGED: bool> InertialSensor
    for Lsm6dso<B, D, T, TAGGED>
{
    type Sample = (Counts, Counts);
    type Planner = fn(&Settings) -> Result<Plan, Settings>;
    const MAGNETOMETER: bool = false;
    const PART: Part = match Self::MODEL {
        Model::Lsm6dso => Part::new(sensor::LSM6DSO, "LSM6DSO"),
        Model::Lsm6ds3trC => Part::new(sensor::LSM6DS3TR_C, "LSM6DS3TR-C"),
    };
    const CAPABILITIES: Capabilities =
        Capabilities::ACCELEROMETER.with(Capabilities::GYROSCOPE).with(Capabilities::TEMPERATURE);

    fn planner(&self) -> Self::Planner {
        Self::plan
    }

    async fn configure(&mut self, plan: &Plan) -> Result<(), SensorFault> {
        self.fifo = SensorFifo::new(DEPTH, plan.sensor.period, TRANSFER_US);
        let settings = &plan.settings;
        let Some((_, (acceleration, _), rate)) = SUPPORTED.nearest(settings) else {
            return Ok(()); // Not a plan of this sensor.
        };
        let setup = Setup {
            acceleration,
            angular_rate: ANGULAR_RATE,
            rate,
            power: match settings.resolution {
                Resolution::LowPower => Power::Low,
                Resolution::Normal | Resolution::High => Power::High,
            },
            watermark: self.fifo.watermark() as u8,
        };
        self.device.check_identity().await.map_err(SensorFault::of_driver)?;
        let started = self.device.start(&setup, &mut Delay(&self.timer)).await;
        started.map_err(SensorFault::of_driver)
    }

    async fn next(&mut self, samples: &mut [(Counts, Counts)]) -> Result<Batch, SensorFault> {
        let mut lost = false;
        let mut without_gyroscope = 0;
        loop {
            let edge_time = self.fifo.wait(&self.timer, &mut self.data_ready).await;
            let mut pairs = [Sample::default(); MAX_WATERMARK as usize];
            let room = samples.len().min(pairs.len());
            let pairs = pairs.get_mut(..room).unwrap_or_default();
            let read = self.device.read(pairs).await.map_err(SensorFault::of_driver)?;
            let at = self.timer.now();
            lost |= read.gap;
            if read.count > 0 {
                for (sample, pair) in samples.iter_mut().zip(&*pairs) {
                    *sample = (Counts(pair.acceleration), Counts(pair.angular_rate));
                }
                let unread = read.samples_left;
                let state = FifoState::new(edge_time, at, read.count as u16 + unread);
                return Ok(self.fifo.read(state.with_overrun(lost), read.count, unread));
            }
            match read.fault {
                Some(FifoFault::GyroscopeMissing) => without_gyroscope += 1,
                // The FIFO overran during the burst, or a bit of a tag was changed.
                _ if read.gap => without_gyroscope = 0,
                _ => return Err(SensorFault::NoData),
            }
            if without_gyroscope >= WITHOUT_GYROSCOPE {
                return Err(SensorFault::GyroscopeStopped);
            }
        }
    }

    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        let raw = self.device.temperature().await.map_err(SensorFault::of_driver)?;
        // 1/256 °C per LSB, relative to 25 °C.
        let centi = 2500 + i32::from(raw) * 100 / 256;
        Ok(Surroundings { magnetic_field: None, temperature: Some(CentiCelsius(centi as i16)) })
    }
}
