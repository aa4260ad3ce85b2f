//! The ADXL345 (accelerometer) behind [`InertialSensor`], through its FIFO.

use wimu_adxl345::{
    Bus, DataFormat, Error, Fifo, Interrupts, Justify, Range, Rate, Resolution as Step, Setup,
};
use wimu_link::hello::{Part, sensor};
use wimu_link::message::{Resolution, Settings};
use wimu_model::{Counts, PeriodNs};

use crate::data_ready::DataReady;
use crate::fifo::{FifoState, SensorFifo};
use crate::sensor::{
    AccelerometerScale, Batch, InertialSensor, Plan, SensorFault, SensorPlan, Supported,
    Surroundings,
};
use crate::timer::Timer;

/// Rates are whole numbers of Hz, up to the fastest on a bus of 400 kHz.
const SUPPORTED: Supported<(Range, &AccelerometerScale), Rate> = Supported {
    ranges: &[
        (2, (Range::G2, &scale(Range::G2))),
        (4, (Range::G4, &scale(Range::G4))),
        (8, (Range::G8, &scale(Range::G8))),
        (16, (Range::G16, &scale(Range::G16))),
    ],
    rates: &[
        (25, Rate::Hz25),
        (50, Rate::Hz50),
        (100, Rate::Hz100),
        (200, Rate::Hz200),
        (400, Rate::Hz400),
        (800, Rate::Hz800),
    ],
    has_low_power: Rate::has_low_power,
};

/// Left-justified counts have this scale in both resolutions.
const fn scale(range: Range) -> AccelerometerScale {
    let format = DataFormat { range, resolution: Step::Full, justify: Justify::Left };
    AccelerometerScale::of(format.lsb_per_g() as f64)
}

/// Capacity of the FIFO, samples.
const DEPTH: u8 = 32;
/// Time to read a sample, µs, on an I²C bus of 400 kHz, and on an SPI bus of 1 MHz.
const fn transfer_us<B: Bus>() -> u64 {
    if B::I2C { 240 } else { 65 }
}

/// An ADXL345 on an I²C or SPI bus, with its INT1 line.
///
/// Samples are read from the sensor's FIFO when INT1 signals the watermark: 40 ms of samples, at most 16. The
/// other half of the FIFO covers delays.
pub struct Adxl345<B, D, T> {
    device: wimu_adxl345::Adxl345<B>,
    data_ready: D,
    timer: T,
    fifo: SensorFifo,
}

impl<B: Bus, D: DataReady, T: Timer> Adxl345<B, D, T> {
    /// A sensor on `bus` (an [`I2cBus`](wimu_adxl345::I2cBus) or [`SpiBus`](wimu_adxl345::SpiBus)) whose INT1 is
    /// `data_ready`.
    pub fn new(bus: B, data_ready: D, timer: T) -> Self {
        Self {
            device: wimu_adxl345::Adxl345::new(bus),
            data_ready,
            timer,
            fifo: SensorFifo::new(DEPTH.into(), PeriodNs(10_000_000), transfer_us::<B>()),
        }
    }

    async fn start(&mut self, plan: &Plan) -> Result<(), Error<B::Error>> {
        let Some((_, (range, _), rate)) = SUPPORTED.nearest(&plan.settings) else {
            return Ok(()); // Not a plan of this sensor.
        };
        let setup = Setup {
            format: format(range, plan.settings.resolution),
            rate,
            low_power: plan.settings.resolution == Resolution::LowPower,
            fifo: Fifo::Stream { watermark: self.fifo.watermark() as u8 },
            interrupts: Interrupts::WATERMARK,
            on_int2: Interrupts::NONE,
        };
        self.device.check_identity().await?;
        self.device.start(&setup).await
    }

    /// Waits for the watermark or a timeout, and reads the state of the FIFO.
    async fn read_state(&mut self) -> Result<FifoState, Error<B::Error>> {
        let edge_time = self.fifo.wait(&self.timer, &mut self.data_ready).await;
        let level = self.device.fifo_level().await?.samples;
        let at = self.timer.now();
        let overrun =
            level >= DEPTH && (self.device.interrupts().await?).contains(Interrupts::OVERRUN);
        Ok(FifoState::new(edge_time, at, level.into()).with_overrun(overrun))
    }
}

fn format(range: Range, resolution: Resolution) -> DataFormat {
    DataFormat {
        range,
        resolution: match resolution {
            Resolution::Normal => Step::TenBits,
            Resolution::LowPower | Resolution::High => Step::Full,
        },
        justify: Justify::Left,
    }
}

impl<B, D, T> Adxl345<B, D, T> {
    /// The plan for `wanted`.
    ///
    /// # Errors
    /// The nearest supported settings.
    pub fn plan(wanted: &Settings) -> Result<Plan, Settings> {
        SUPPORTED.plan(wanted, |(range, scale), rate| {
            let format = format(range, wanted.resolution);
            let period = PeriodNs(rate.period_ns());
            // The largest digit, left-justified.
            let full_scale = i16::MAX >> (16 - format.bits()) << (16 - format.bits());
            SensorPlan::new(period, scale, full_scale.into())
        })
    }
}

impl<B: Bus, D: DataReady, T: Timer> InertialSensor for Adxl345<B, D, T> {
    type Sample = Counts;
    type Planner = fn(&Settings) -> Result<Plan, Settings>;
    const MAGNETOMETER: bool = false;
    const PART: Part = Part::new(sensor::ADXL345, "ADXL345");

    fn planner(&self) -> Self::Planner {
        Self::plan
    }

    async fn configure(&mut self, plan: &Plan) -> Result<(), SensorFault> {
        self.fifo = SensorFifo::new(DEPTH.into(), plan.sensor.period, transfer_us::<B>());
        self.start(plan).await.map_err(SensorFault::of_driver)
    }

    async fn next(&mut self, counts: &mut [Counts]) -> Result<Batch, SensorFault> {
        let mut lost = false;
        loop {
            let state = self.read_state().await.map_err(SensorFault::of_driver)?;
            lost |= state.overrun;
            let count = counts.len().min(state.level.into());
            if count == 0 {
                return Err(SensorFault::NoData);
            }
            for sample in counts.iter_mut().take(count) {
                *sample = Counts(self.device.sample().await.map_err(SensorFault::of_driver)?);
            }
            if self.fifo.kept_up(&state, self.timer.now()) {
                let unread = state.level - count as u16;
                return Ok(self.fifo.read(state.with_overrun(lost), count, unread));
            }
            lost = true;
        }
    }

    /// None.
    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        Ok(Surroundings::default())
    }
}
