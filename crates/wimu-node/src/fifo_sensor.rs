//! A sensor that is read through its FIFO.

use wimu_link::hello::{Capabilities, Part};
use wimu_link::message::{Resolution, Settings};
use wimu_model::PeriodNs;

use crate::data_ready::DataReady;
use crate::fifo::{FifoState, SensorFifo};
use crate::sample::RawSample;
use crate::sensor::{
    AccelerometerScale, Batch, GyroscopePlan, InertialSensor, Plan, SensorFault, SensorPlan,
    Surroundings,
};
use crate::timer::Timer;

/// A full-scale range of an accelerometer.
#[derive(Debug)]
pub struct Range {
    /// Full scale, ± *g*.
    pub g: u8,
    /// Its code in the chip's registers.
    pub code: u8,
    /// Scale of the counts.
    pub scale: AccelerometerScale,
}

impl Range {
    /// ±2, ±4, ±8 and ±16 *g* with these codes and sensitivities, LSB/*g*.
    pub const fn four(codes: [u8; 4], lsb_per_g: [f64; 4]) -> [Self; 4] {
        let [a, b, c, d] = codes;
        let [e, f, g, h] = lsb_per_g;
        [
            Self { g: 2, code: a, scale: AccelerometerScale::of(e) },
            Self { g: 4, code: b, scale: AccelerometerScale::of(f) },
            Self { g: 8, code: c, scale: AccelerometerScale::of(g) },
            Self { g: 16, code: d, scale: AccelerometerScale::of(h) },
        ]
    }
}

/// An output data rate.
#[derive(Clone, Copy, Debug)]
pub struct Rate {
    /// Its name, Hz.
    pub hz: u16,
    /// Its code in the chip's registers.
    pub code: u8,
    /// Nominal time between samples, ns.
    pub period_ns: u32,
    /// Whether the chip has it with low power.
    pub has_low_power: bool,
}

impl Rate {
    /// A rate of the chip.
    pub const fn new(hz: u16, code: u8, period_ns: u32, has_low_power: bool) -> Self {
        Self { hz, code, period_ns, has_low_power }
    }
}

/// How a [`FifoChip`] is started.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    /// Code of the [`Range`].
    pub range: u8,
    /// The rate.
    pub rate: Rate,
    /// Trade-off between power and noise.
    pub resolution: Resolution,
    /// Level of the FIFO at which the data-ready line rises, samples.
    pub watermark: u16,
}

/// The level of a FIFO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FifoLevel {
    /// Samples that it holds.
    pub samples: u16,
    /// Whether it was full and has lost samples.
    pub overrun: bool,
}

/// Samples read from a FIFO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FifoRead {
    /// How many were written to the slice. They follow each other without a gap.
    pub count: usize,
    /// Whether samples before them were lost.
    pub lost: bool,
}

/// A chip that queues its samples: what [`FifoSensor`] reads. A line is high while its FIFO holds at least the watermark.
#[allow(async_fn_in_trait)] // Nodes are polled where they are built; nothing needs `Send`.
pub trait FifoChip {
    /// Counts of one sample, right-handed axes: `Counts` of an accelerometer, `(Counts, Counts)` with a gyroscope.
    type Sample: RawSample;
    /// Its number, 0 without one, and its name.
    const PART: Part;
    /// What it measures.
    const CAPABILITIES: Capabilities;
    /// Whether it can measure the magnetic field.
    const MAGNETOMETER: bool = false;
    /// Its ranges.
    const RANGES: &'static [Range];
    /// Its rates.
    const RATES: &'static [Rate];
    /// Its only mode; `None` if it has all.
    const RESOLUTION: Option<Resolution> = None;
    /// Its gyroscope.
    const GYROSCOPE: Option<&'static GyroscopePlan> = None;
    /// Capacity of the FIFO, samples.
    const DEPTH: u16;
    /// Time to read a sample, µs.
    const TRANSFER_US: u64;
    /// Most samples of one [`read`](Self::read).
    const MOST: usize = 32;

    /// Positive full scale of the accelerometer under `settings`, for a range with this code, LSB.
    fn full_scale(_settings: &Settings, _range: u8) -> i32 {
        i16::MAX.into()
    }

    /// Starts it from any state, with an empty FIFO.
    ///
    /// # Errors
    /// [`SensorFault`]; it is called again.
    async fn start(&mut self, setup: &Setup, timer: &impl Timer) -> Result<(), SensorFault>;

    /// Reads the level of the FIFO.
    ///
    /// # Errors
    /// [`SensorFault`] when the sensor does not answer.
    async fn level(&mut self) -> Result<FifoLevel, SensorFault>;

    /// Reads as many samples as `samples` has, oldest first; the FIFO holds them.
    ///
    /// # Errors
    /// [`SensorFault`] when the sensor does not answer.
    async fn read(&mut self, samples: &mut [Self::Sample]) -> Result<FifoRead, SensorFault>;

    /// Removes what an overrun has damaged. Returns whether the level must be read again.
    ///
    /// # Errors
    /// [`SensorFault`] when the sensor does not answer.
    async fn repair(&mut self) -> Result<bool, SensorFault> {
        Ok(false)
    }

    /// Waits for the watermark, or until the line must have risen; reads the state of the FIFO.
    ///
    /// # Errors
    /// [`SensorFault`] when the sensor does not answer.
    async fn state(
        &mut self,
        fifo: &SensorFifo,
        line: &mut impl DataReady,
        timer: &impl Timer,
    ) -> Result<FifoState, SensorFault> {
        let deadline = fifo.deadline(timer.now());
        loop {
            let edge = timer.before(deadline, line.ready()).await;
            let woken = timer.now();
            let level = self.level().await?;
            let at = timer.now();
            let missing = fifo.watermark().saturating_sub(level.samples);
            if missing == 0 || at >= deadline {
                let edge_time = edge.flatten().unwrap_or(woken);
                let state = FifoState::new(edge_time, at, level.samples);
                return Ok(state.with_overrun(level.overrun));
            }
            // Another chip drives the shared line: poll the sensor.
            timer.after_us(fifo.micros(missing)).await;
        }
    }

    /// Reads magnetic field and temperature.
    ///
    /// # Errors
    /// [`SensorFault`] when the sensor does not answer.
    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        Ok(Surroundings::default())
    }
}

/// A chip with a FIFO and its data-ready line.
///
/// Samples are read when the line signals the watermark: 40 ms of samples, at most 16, and at most half of the FIFO, whose
/// other half covers delays.
pub struct FifoSensor<C, D, T> {
    chip: C,
    data_ready: D,
    timer: T,
    fifo: SensorFifo,
}

impl<C: FifoChip, D, T> FifoSensor<C, D, T> {
    /// A chip whose line is `data_ready`; other chips may share it.
    pub fn new(chip: C, data_ready: D, timer: T) -> Self {
        let fifo = SensorFifo::new(C::DEPTH, PeriodNs(10_000_000), C::TRANSFER_US);
        Self { chip, data_ready, timer, fifo }
    }

    /// The plan for `wanted`.
    ///
    /// # Errors
    /// The nearest supported settings.
    pub fn plan(wanted: &Settings) -> Result<Plan, Settings> {
        let (settings, range, rate) = nearest::<C>(wanted).ok_or(*wanted)?;
        if settings != *wanted {
            return Err(settings);
        }
        let full_scale = C::full_scale(&settings, range.code);
        let sensor = SensorPlan::new(PeriodNs(rate.period_ns), &range.scale, full_scale);
        Ok(Plan::new(settings, SensorPlan { gyroscope: C::GYROSCOPE, ..sensor }))
    }
}

/// The supported settings nearest to `wanted`.
fn nearest<C: FifoChip>(wanted: &Settings) -> Option<(Settings, &'static Range, Rate)> {
    let resolution = C::RESOLUTION.unwrap_or(wanted.resolution);
    let low_power = resolution == Resolution::LowPower;
    let rates = C::RATES.iter().filter(|rate| !low_power || rate.has_low_power);
    let rate = *rates.min_by_key(|rate| rate.hz.abs_diff(wanted.rate_hz))?;
    let range = C::RANGES.iter().min_by_key(|range| range.g.abs_diff(wanted.range_g))?;
    let settings = Settings { range_g: range.g, rate_hz: rate.hz, resolution, ..*wanted };
    Some((settings, range, rate))
}

impl<C: FifoChip, D: DataReady, T: Timer> InertialSensor for FifoSensor<C, D, T> {
    type Sample = C::Sample;
    type Planner = fn(&Settings) -> Result<Plan, Settings>;
    const MAGNETOMETER: bool = C::MAGNETOMETER;
    const PART: Part = C::PART;
    const CAPABILITIES: Capabilities = C::CAPABILITIES;

    fn planner(&self) -> Self::Planner {
        Self::plan
    }

    async fn configure(&mut self, plan: &Plan) -> Result<(), SensorFault> {
        self.fifo = SensorFifo::new(C::DEPTH, plan.sensor.period, C::TRANSFER_US);
        let Some((settings, range, rate)) = nearest::<C>(&plan.settings) else {
            return Ok(()); // Not a plan of this sensor.
        };
        let (resolution, watermark) = (settings.resolution, self.fifo.watermark());
        let setup = Setup { range: range.code, rate, resolution, watermark };
        self.chip.start(&setup, &self.timer).await
    }

    async fn next(&mut self, samples: &mut [C::Sample]) -> Result<Batch, SensorFault> {
        let mut lost = false;
        loop {
            let state = self.chip.state(&self.fifo, &mut self.data_ready, &self.timer).await?;
            lost |= state.overrun;
            if state.overrun && self.chip.repair().await? {
                continue;
            }
            let count = samples.len().min(C::MOST).min(state.level.into());
            if count == 0 {
                return Err(SensorFault::NoData);
            }
            let read = self.chip.read(samples.get_mut(..count).unwrap_or_default()).await?;
            lost |= read.lost;
            if !self.fifo.kept_up(&state, self.timer.now()) {
                lost = true;
                self.chip.repair().await?;
            } else if read.count > 0 {
                let unread = state.level - count as u16;
                return Ok(self.fifo.read(state.with_overrun(lost), read.count, unread));
            }
        }
    }

    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        self.chip.surroundings().await
    }
}
