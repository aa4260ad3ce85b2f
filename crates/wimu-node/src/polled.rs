//! A sensor that is read at intervals of the timer.

use wimu_link::hello::{Capabilities, Part};
use wimu_link::message::{Resolution, Settings};
use wimu_model::{CentiCelsius, DeviceTimeUs, PeriodNs};

use crate::sample::RawSample;
use crate::sensor::{
    AccelerometerScale, Batch, GyroscopePlan, InertialSensor, Plan, Planner, SensorFault,
    SensorPlan, Surroundings,
};
use crate::timer::Timer;

/// What [`Polled`] reads: a driver that starts a sensor and returns the counts of its newest sample.
#[allow(async_fn_in_trait)] // Nodes are polled where they are built; nothing needs `Send`.
pub trait ReadCounts {
    /// Counts of one sample: `Counts` of an accelerometer, `(Counts, Counts)` with a gyroscope.
    type Sample: RawSample;
    /// Number, 0 without one, and name of the sensor.
    const PART: Part;
    /// What it measures.
    const CAPABILITIES: Capabilities;
    /// Mean age of the counts when they are read, µs: half a sample period of the sensor, and the delay of its filter.
    const AGE_US: u32 = 0;

    /// Starts the sensor from any state, at the range of its [`PolledPlanner`].
    ///
    /// # Errors
    /// [`SensorFault`]; it is called again.
    async fn start(&mut self) -> Result<(), SensorFault>;

    /// Reads the newest sample, right-handed axes.
    ///
    /// # Errors
    /// [`SensorFault`] when the sensor does not answer.
    async fn counts(&mut self) -> Result<Self::Sample, SensorFault>;

    /// Reads the temperature; `None` without a thermometer.
    ///
    /// # Errors
    /// [`SensorFault`] when the sensor does not answer.
    async fn temperature(&mut self) -> Result<Option<CentiCelsius>, SensorFault> {
        Ok(None)
    }
}

/// The settings of a polled sensor: one range, and every rate up to the fastest.
#[derive(Clone, Copy, Debug)]
pub struct PolledPlanner {
    /// Full scale of the accelerometer, ± g.
    pub range_g: u8,
    /// Highest rate, Hz. The sensor itself runs at several times this rate: its period is the jitter of the samples.
    pub fastest_hz: u16,
    /// Scale of the accelerometer's counts.
    pub accelerometer: &'static AccelerometerScale,
    /// Positive full scale of the accelerometer, LSB.
    pub full_scale: i32,
    /// The gyroscope; `None` without one.
    pub gyroscope: Option<&'static GyroscopePlan>,
}

impl Planner for PolledPlanner {
    fn plan(&self, wanted: &Settings) -> Result<Plan, Settings> {
        let nearest = Settings {
            range_g: self.range_g,
            rate_hz: wanted.rate_hz.clamp(1, self.fastest_hz.max(1)),
            resolution: Resolution::High,
            ..*wanted
        };
        if nearest != *wanted {
            return Err(nearest);
        }
        let period = PeriodNs(1_000_000_000 / u32::from(nearest.rate_hz));
        let sensor = SensorPlan::new(period, self.accelerometer, self.full_scale);
        Ok(Plan::new(nearest, SensorPlan { gyroscope: self.gyroscope, ..sensor }))
    }
}

/// A sensor without FIFO and data-ready line, or whose driver uses neither: the timer says when it is read.
///
/// A sample's time is that of its read less [`ReadCounts::AGE_US`]. It varies by half a sample period of the sensor and by
/// the latency of the task, so Hello has [`Capabilities::POLLED`]. A read that is late by more than a period counts as
/// missed samples.
pub struct Polled<R, T> {
    reader: R,
    planner: PolledPlanner,
    timer: T,
    period_ns: u64,
    /// Time of the next read, ns.
    due_ns: u64,
}

impl<R: ReadCounts, T: Timer> Polled<R, T> {
    /// A sensor read by `reader`, with the settings of `planner`.
    pub fn new(reader: R, planner: PolledPlanner, timer: T) -> Self {
        Self { reader, planner, timer, period_ns: 10_000_000, due_ns: 0 }
    }
}

impl<R: ReadCounts, T: Timer> InertialSensor for Polled<R, T> {
    type Sample = R::Sample;
    type Planner = PolledPlanner;
    const MAGNETOMETER: bool = false;
    const PART: Part = R::PART;
    const CAPABILITIES: Capabilities = R::CAPABILITIES.with(Capabilities::POLLED);

    fn planner(&self) -> PolledPlanner {
        self.planner
    }

    async fn configure(&mut self, plan: &Plan) -> Result<(), SensorFault> {
        self.period_ns = u64::from(plan.sensor.period.0.max(1));
        self.reader.start().await?;
        self.due_ns = self.timer.now().0.saturating_mul(1000);
        Ok(())
    }

    async fn next(&mut self, samples: &mut [R::Sample]) -> Result<Batch, SensorFault> {
        let now_ns = self.timer.now().0.saturating_mul(1000);
        // Reads that are overdue are left out; the others keep their phase.
        let overdue = now_ns.saturating_sub(self.due_ns) / self.period_ns;
        self.due_ns += (overdue + 1) * self.period_ns;
        self.timer.until(DeviceTimeUs(self.due_ns / 1000)).await;
        let read_at = self.timer.now();
        let counts = self.reader.counts().await?;
        let Some(sample) = samples.first_mut() else {
            return Err(SensorFault::NoData);
        };
        *sample = counts;
        Ok(Batch::new(1, DeviceTimeUs(read_at.0.saturating_sub(R::AGE_US.into()))))
    }

    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        let temperature = self.reader.temperature().await?;
        Ok(Surroundings { magnetic_field: None, temperature })
    }
}
