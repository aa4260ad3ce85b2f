//! Two sensors on one board.

use wimu_link::hello::{Capabilities, Part};
use wimu_link::message::{EpochReason, Resolution, Settings};
use wimu_model::DeviceTimeUs;

use crate::secondary::Secondary;
use crate::sensor::{Batch, InertialSensor, Plan, Planner, SensorFault, Surroundings};
use crate::timer::Timer;

/// Interval between attempts to start a second sensor that has failed, µs.
const RETRY_US: u64 = 10_000_000;

/// Two sensors on one body, such as a fine accelerometer of ± 2 g and a coarse one of ± 16 g.
///
/// The first is sensor 0: the settings apply to it, and its samples are corrected and integrated. The second is sensor 1: it
/// runs at the supported rate nearest to that of the first, at a range of its own, and hosts merge both. They are read one
/// after the other, so that both may be on one bus; a FIFO must hold twice the samples of its watermark. If the second fails, the first
/// goes on after a gap of 0.2 s, and the second is tried again every 10 s.
pub struct Pair<A, B, T> {
    first: A,
    second: B,
    timer: T,
    range_g: u8,
    secondary: Option<Secondary>,
    plan: Option<Plan>,
    seen: [Seen; 2],
    /// The second has failed: why, and when it is tried again.
    lost: Option<(SensorFault, DeviceTimeUs)>,
    reported: Option<SensorFault>,
}

/// Reads of a sensor.
#[derive(Clone, Copy, Default)]
struct Seen {
    last: DeviceTimeUs,
    /// Measured sample period, µs, and the fewest samples of a read.
    period_us: u64,
    least: u64,
}

impl Seen {
    /// Predicted end of the next read, µs. A data-ready edge is not seen while the other sensor is awaited, so the one that
    /// is due first is read first.
    fn due(&self) -> u64 {
        let wait_us = self.period_us.saturating_mul(self.least);
        self.last.0.saturating_add(wait_us)
    }

    fn read(&mut self, batch: &Batch) {
        let count = (batch.count as u64).max(1);
        let since = batch.last_time.0.saturating_sub(self.last.0);
        if self.last.0 > 0 {
            self.period_us = since / count;
        }
        self.least = if self.least == 0 { count } else { self.least.min(count) };
        self.last = batch.last_time;
    }
}

impl<A, B, T> Pair<A, B, T>
where
    A: InertialSensor,
    B: InertialSensor<Sample = A::Sample>,
    T: Timer,
{
    /// Sensors 0 and 1; the second at ± `range_g`, or the supported range nearest to it.
    pub fn new(first: A, second: B, timer: T, range_g: u8) -> Self {
        Self {
            first,
            second,
            timer,
            range_g,
            secondary: None,
            plan: None,
            seen: [Seen::default(); 2],
            lost: None,
            reported: None,
        }
    }

    fn plan_second(&self, settings: &Settings) -> Option<Plan> {
        let planner = self.second.planner();
        let wanted = Settings { range_g: self.range_g, resolution: Resolution::High, ..*settings };
        let plan = planner.plan(&wanted);
        plan.or_else(|nearest| planner.plan(&nearest)).ok()
    }

    async fn start_second(&mut self) {
        let Some(plan) = self.plan else {
            return;
        };
        self.lost = match self.second.configure(&plan).await {
            Ok(()) => None,
            Err(fault) => Some(self.failed(fault)),
        };
    }

    fn failed(&self, fault: SensorFault) -> (SensorFault, DeviceTimeUs) {
        let again = self.timer.now().0.saturating_add(RETRY_US);
        (fault, DeviceTimeUs(again))
    }

    /// Samples of the second sensor, if it works.
    async fn next_second(&mut self, samples: &mut [A::Sample]) -> Option<Batch> {
        if let Some((_, again)) = self.lost {
            if self.timer.now() < again {
                return None;
            }
            self.start_second().await;
            if let Some(secondary) = &mut self.secondary {
                secondary.restart(EpochReason::Gap);
            }
            self.seen[1] = Seen::default();
            return None;
        }
        match self.second.next(samples).await {
            Ok(batch) => {
                self.reported = None;
                Some(batch.of_sensor(1))
            }
            Err(fault) => {
                self.lost = Some(self.failed(fault));
                None
            }
        }
    }
}

impl<A, B, T> InertialSensor for Pair<A, B, T>
where
    A: InertialSensor,
    B: InertialSensor<Sample = A::Sample>,
    T: Timer,
{
    type Sample = A::Sample;
    type Planner = A::Planner;
    const MAGNETOMETER: bool = A::MAGNETOMETER;
    const PART: Part = A::PART;
    const CAPABILITIES: Capabilities = A::CAPABILITIES;

    fn planner(&self) -> A::Planner {
        self.first.planner()
    }

    fn secondary(&mut self) -> &mut [Secondary] {
        self.secondary.as_mut_slice()
    }

    async fn configure(&mut self, plan: &Plan) -> Result<(), SensorFault> {
        self.first.configure(plan).await?;
        self.seen = [Seen::default(); 2];
        self.plan = self.plan_second(&plan.settings);
        match (&mut self.secondary, self.plan) {
            (Some(secondary), Some(plan)) => secondary.plan = plan.sensor,
            (none, plan) => *none = plan.map(|plan| Secondary::new(plan.sensor)),
        }
        self.start_second().await;
        Ok(())
    }

    async fn next(&mut self, samples: &mut [A::Sample]) -> Result<Batch, SensorFault> {
        let [first, second] = self.seen;
        if self.plan.is_some()
            && second.due() < first.due()
            && let Some(batch) = self.next_second(samples).await
        {
            self.seen[1].read(&batch);
            return Ok(batch);
        }
        if let Some((fault, _)) = self.lost
            && self.reported != Some(fault)
        {
            self.reported = Some(fault);
            return Err(fault);
        }
        let batch = self.first.next(samples).await?;
        self.seen[0].read(&batch);
        Ok(batch)
    }

    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        self.first.surroundings().await
    }
}
