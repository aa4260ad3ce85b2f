//! Samples: read, number, correct, integrate, pack.

use core::num::NonZeroU8;

use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_integrator::{Config, FieldMean, Integrator, Phase, Transition};
use wimu_link::LinkRole;
use wimu_link::batch::{self, MAX_BATCH, Sample, Stream};
use wimu_link::frame::MAX_FRAME;
use wimu_link::message::{
    BusFault, Environment, Epoch, EpochReason, Event, Navigation, Settings, Streams,
};
use wimu_model::{Counts, DeviceTimeUs, MagneticFieldNt, PeriodNs, SpecificForceQ16};

use crate::accelerometer::{Accelerometer, Batch, Plan, SensorFault, Surroundings};
use crate::shared::{Correction, Message, Order, ROLES, Shared, Trouble};
use crate::timer::Timer;

/// Samples read at once, at most.
const MAX_READ: usize = 32;
/// A batch is sent when it is this old, however short.
const OLDEST_BATCH_US: u64 = 250_000;
/// Velocity and position are sent this often.
const NAVIGATION_NS: u32 = 100_000_000;
/// From here on the next complete stillness window, when the state is small, brings an epoch …
const EPOCH_DUE_US: u64 = 800_000;
/// … and here one is sent in any case: never more than a second apart.
const EPOCH_LATEST_US: u64 = 950_000;
/// Magnetic field and temperature are read this often.
const SURROUNDINGS_US: u64 = 500_000;
/// A lost sensor is tried again this often.
const RETRY_US: u64 = 200_000;
/// The period is measured over at least this time before it is used …
const MEASURE_NS: u64 = 2_000_000_000;
/// … if it is within this part of the nominal one …
const BELIEVABLE_PER_MILLE: u64 = 200;
/// … and this far from the one in use, in parts per million.
const WORTH_CHANGING_PPM: u64 = 50;

/// Each read weighs one part in so many in the jitter.
const JITTER_WEIGHT: u32 = 16;

/// Takes every sample that the sensor gives.
pub struct Sampler<'a, A, T, M: RawMutex> {
    accelerometer: A,
    timer: T,
    shared: &'a Shared<M>,
    lanes: [Lane; 2],
    next_sequence: u32,
    /// Epochs sent on both links, modulo 256.
    epochs: u8,
    next_surroundings: DeviceTimeUs,
    /// The fault that was reported and that no sample has followed yet.
    told: Option<SensorFault>,
}

/// What the sampler works with once it has been configured.
struct Running {
    plan: Plan,
    correction: Correction,
    integrator: Integrator,
    clock: SampleClock,
    epoch_reason: Option<EpochReason>,
    last_epoch: DeviceTimeUs,
    until_navigation: u32,
    /// The magnetic field in the present rest.
    field: FieldMean,
    /// The sensor has failed and has not been started again.
    lost: bool,
}

impl<'a, A: Accelerometer, T: Timer, M: RawMutex> Sampler<'a, A, T, M> {
    pub(crate) fn new(accelerometer: A, timer: T, shared: &'a Shared<M>) -> Self {
        Self {
            accelerometer,
            timer,
            shared,
            lanes: [Lane::default(), Lane::default()],
            next_sequence: 0,
            epochs: 0,
            next_surroundings: DeviceTimeUs(0),
            told: None,
        }
    }

    /// Runs for ever. Nothing here waits for a link or for the store.
    pub async fn run(&mut self) -> ! {
        let mut running = loop {
            self.shared.orders.given.wait().await;
            if let Some(plan) = self.shared.orders.plan() {
                let outcome = self.accelerometer.configure(&plan).await;
                if let Some(running) = self.start(outcome) {
                    break running;
                }
            } else {
                // Nothing runs yet that could be corrected.
                self.shared.orders.take();
            }
        };
        let mut counts = [Counts::default(); MAX_READ];
        loop {
            if self.shared.orders.given.try_take().is_some() {
                match self.shared.orders.plan() {
                    Some(plan) => {
                        self.flush();
                        let outcome = self.accelerometer.configure(&plan).await;
                        self.configured(&mut running, outcome);
                    }
                    None => self.correct(&mut running),
                }
            }
            if running.lost {
                self.retry(&mut running).await;
                continue;
            }
            match self.accelerometer.next(&mut counts).await {
                Ok(read) => {
                    let counts = counts.get(..read.count).unwrap_or(&counts);
                    self.take(&mut running, read, counts);
                }
                Err(fault) => self.lose(&mut running, fault),
            }
            if !running.lost && self.timer.now() >= self.next_surroundings {
                self.look_around(&mut running).await;
            }
        }
    }

    /// The sensor has been configured for the first time, or not.
    #[inline(never)]
    fn start(&mut self, outcome: Result<(), SensorFault>) -> Option<Running> {
        let Some(Order::Configure(plan, correction)) = self.shared.orders.take() else {
            return None;
        };
        let mut running = Running::new(plan, correction, EpochReason::Start);
        if let Err(fault) = outcome {
            self.lose(&mut running, fault);
        }
        self.lanes = Lane::of(&plan.settings);
        self.shared.configured.signal(outcome);
        Some(running)
    }

    /// The sensor has been configured as ordered, or not.
    #[inline(never)] // What it builds is not on the stack while samples are taken.
    fn configured(&mut self, running: &mut Running, outcome: Result<(), SensorFault>) {
        match (outcome, self.shared.orders.take()) {
            (Ok(()), Some(Order::Configure(plan, correction))) => {
                *running = Running::new(plan, correction, EpochReason::Settings);
                self.lanes = Lane::of(&plan.settings);
            }
            // What the sensor does now is unknown: it is brought back under the plan before.
            (Err(fault), _) => self.lose(running, fault),
            _ => {}
        }
        self.shared.configured.signal(outcome);
    }

    #[inline(never)]
    fn correct(&mut self, running: &mut Running) {
        let Some(Order::Correct(correction)) = self.shared.orders.take() else {
            return;
        };
        let reason = if correction.parameters == running.correction.parameters {
            EpochReason::Temperature
        } else {
            running.integrator = integrator(&running.plan.settings, running.clock.period);
            EpochReason::Parameters
        };
        running.correction = correction;
        running.begin_epoch(reason);
    }

    /// Takes samples that the sensor gave, oldest first.
    fn take(&mut self, running: &mut Running, read: Batch, counts: &[Counts]) {
        if self.told.take().is_some() {
            self.shared.trouble(Trouble::Sensor, self.timer.now(), None);
            self.shared.report(self.timer.now(), Event::SensorFound);
        }
        let missed = running.clock.missed_before(&read, counts.len());
        let mut spacing_ns = u64::from(running.clock.period.0);
        if missed == 0 && running.clock.goes_on_at(read.last_time) {
            spacing_ns = running.clock.spacing_ns(&read, spacing_ns);
        } else {
            self.flush();
            running.clock.measure_anew();
            running.integrator.gap();
            self.next_sequence = self.next_sequence.wrapping_add(missed);
            running.begin_epoch(EpochReason::Gap);
        }
        let measured = running.clock.measured();
        running.clock.compare(&read, measured);
        self.shared.publish(|published| {
            let sensor = &mut published.sensor;
            sensor.samples = sensor.samples.wrapping_add(counts.len() as u32);
            sensor.missed = sensor.missed.wrapping_add(missed);
            sensor.overruns = sensor.overruns.wrapping_add(read.overrun.into());
            published.measured_period_ns = measured.map(|period| period.0);
            published.jitter_ns = running.clock.jitter_ns;
        });
        for (index, &sample) in counts.iter().enumerate() {
            let newer = (counts.len() - 1 - index) as u64;
            let time = DeviceTimeUs(
                (read.last_time.0).saturating_sub(newer.saturating_mul(spacing_ns) / 1000),
            );
            self.sample(running, sample, time);
        }
        running.clock.count(read.last_time, counts.len() as u32);
    }

    fn sample(&mut self, running: &mut Running, counts: Counts, time: DeviceTimeUs) {
        let wanted = ROLES.map(|role| self.shared.take_epoch_wanted(role));
        match running.epoch_reason.take() {
            Some(reason) => {
                running.last_epoch = time;
                self.epochs = self.epochs.wrapping_add(1);
                self.send_epoch(running, reason, time, [true; 2]);
            }
            // For a link where somebody has begun to listen; it is none of the other's business.
            None if wanted != [false; 2] => {
                self.send_epoch(running, EpochReason::Periodic, time, wanted);
            }
            None => {}
        }
        let sequence = self.next_sequence;
        let force = running.correction.corrector.correct(counts);
        let saturated = counts.saturated(running.plan.full_scale);
        let transition = running.integrator.step(force, saturated);
        for lane in &mut self.lanes {
            lane.add(self.shared, sequence, time, counts, force);
        }
        self.next_sequence = sequence.wrapping_add(1);

        running.until_navigation = running.until_navigation.saturating_sub(1);
        if running.until_navigation == 0 {
            running.until_navigation = (NAVIGATION_NS / running.clock.period.0.max(1)).max(1);
            self.send_navigation(running, sequence);
        }
        if transition == Transition::Rest {
            // The field of this rest, soon: it may be short.
            running.field = FieldMean::default();
            if running.correction.compass.is_some() {
                self.next_surroundings = time;
            }
            let mean = running.integrator.state().rest_mean;
            self.shared
                .rest
                .signal((mean, running.correction.parameters));
        }
        let since_epoch = time.0.saturating_sub(running.last_epoch.0);
        running.epoch_reason = match transition {
            Transition::Rest | Transition::Motion => Some(EpochReason::Stillness),
            Transition::Window if since_epoch >= EPOCH_DUE_US => {
                running.adopt_measured_period();
                Some(EpochReason::Periodic)
            }
            _ if since_epoch >= EPOCH_LATEST_US => Some(EpochReason::Periodic),
            _ => None,
        };
    }

    fn send_epoch(
        &self,
        running: &Running,
        reason: EpochReason,
        time: DeviceTimeUs,
        roles: [bool; 2],
    ) {
        let epoch = Message::Epoch(Epoch {
            reason,
            number: self.epochs,
            sequence: self.next_sequence,
            time_us: time.0,
            period_ns: running.clock.period.0,
            range_g: running.plan.settings.range_g,
            sensitivity_lsb_per_g: running.plan.sensitivity.lsb_per_g(),
            full_scale: running.plan.full_scale,
            parameters: running.correction.parameters.0,
            temperature_centi_c: running.correction.temperature.map(|t| t.0),
            state: running.integrator.state().into(),
        });
        self.shared.announce(&epoch, roles);
    }

    fn send_navigation(&self, running: &Running, sequence: u32) {
        let message =
            Message::Navigation(Navigation::new(sequence, &running.integrator.navigation()));
        self.shared
            .stream([true; 2], &message, |streams| streams.navigation);
    }

    async fn look_around(&mut self, running: &mut Running) {
        let now = self.timer.now();
        self.next_surroundings = DeviceTimeUs(now.0.saturating_add(SURROUNDINGS_US));
        match self.accelerometer.surroundings().await {
            // Of a sensor without: nothing is said rather than invented.
            Ok(nothing) if nothing == Surroundings::default() => {}
            Ok(surroundings) => {
                if A::MAGNETOMETER
                    && let Some(field) = surroundings.magnetic_field
                {
                    running.take_field(field);
                }
                if let Some(temperature) = surroundings.temperature {
                    self.shared.temperature.signal(temperature);
                }
                let message = Message::Environment(Environment {
                    time_us: now.0,
                    magnetic_field_nt: surroundings.magnetic_field.map(|field| field.0),
                    temperature_centi_c: surroundings.temperature.map(|t| t.0),
                });
                self.shared
                    .stream([true; 2], &message, |streams| streams.environment);
            }
            Err(fault) => self.lose(running, fault),
        }
    }

    /// The sensor has failed: what was read is sent, the leg is marked, and it is tried again.
    fn lose(&mut self, running: &mut Running, fault: SensorFault) {
        self.flush();
        running.integrator.gap();
        running.begin_epoch(EpochReason::Gap);
        running.clock.broken = true;
        running.lost = true;
        self.shared.publish(|published| {
            let errors = &mut published.sensor.bus_errors;
            *errors = errors.wrapping_add(1);
        });
        self.tell(fault);
    }

    async fn retry(&mut self, running: &mut Running) {
        self.timer.after_us(RETRY_US).await;
        match self.accelerometer.configure(&running.plan).await {
            // Whether it is found, its first sample tells.
            Ok(()) => running.lost = false,
            Err(fault) => self.tell(fault),
        }
    }

    /// Reports a fault, once until another takes its place or the sensor is found.
    fn tell(&mut self, fault: SensorFault) {
        if self.told.replace(fault) == Some(fault) {
            return;
        }
        let event = match fault {
            SensorFault::NotAnswering => Event::SensorLost(BusFault::NoAnswer),
            SensorFault::Transfer => Event::SensorLost(BusFault::Transfer),
            SensorFault::NoData => Event::SensorLost(BusFault::Timeout),
            SensorFault::WrongIdentity { expected, found } => {
                Event::WrongSensor { expected, found }
            }
        };
        let now = self.timer.now();
        self.shared.trouble(Trouble::Sensor, now, Some(event));
        self.shared.report(now, event);
    }

    fn flush(&mut self) {
        for lane in &mut self.lanes {
            lane.flush(self.shared);
        }
    }
}

fn integrator(settings: &Settings, period: PeriodNs) -> Integrator {
    let config = Config {
        period,
        zupt: settings.zupt,
        gravity_um_s2: settings.gravity_um_s2,
    };
    Integrator::new(config)
}

impl Running {
    fn new(plan: Plan, correction: Correction, reason: EpochReason) -> Self {
        Self {
            plan,
            correction,
            integrator: integrator(&plan.settings, plan.period),
            clock: SampleClock::new(plan.period),
            epoch_reason: Some(reason),
            last_epoch: DeviceTimeUs(0),
            until_navigation: 1,
            field: FieldMean::default(),
            lost: false,
        }
    }

    /// Has the next sample begin an epoch. If there are several reasons, the one that most begins
    /// anew is told: whoever replays must not take what begins anew for what goes on.
    fn begin_epoch(&mut self, reason: EpochReason) {
        let weight = |reason| match reason {
            EpochReason::Periodic | EpochReason::Other(_) => 0,
            EpochReason::Stillness => 1,
            EpochReason::Temperature => 2,
            EpochReason::Heading => 3,
            EpochReason::Gap => 4,
            EpochReason::Start | EpochReason::Settings | EpochReason::Parameters => 5,
        };
        if self
            .epoch_reason
            .is_none_or(|known| weight(known) <= weight(reason))
        {
            self.epoch_reason = Some(reason);
        }
    }

    /// Takes heading from the magnetometer, if it is calibrated and the unit at rest.
    fn take_field(&mut self, field: MagneticFieldNt) {
        let Some(compass) = &self.correction.compass else {
            return;
        };
        let state = self.integrator.state();
        if state.phase != Phase::Resting || !self.field.push(field) {
            return;
        }
        if let Some(heading) = compass.heading(&self.field, state.rest_mean)
            && self.integrator.set_heading(heading)
        {
            self.begin_epoch(EpochReason::Heading);
        }
    }

    /// Integrates with the sensor's true period once it is known; only at rest, where a change
    /// costs nothing.
    fn adopt_measured_period(&mut self) {
        if self.integrator.navigation().phase == Phase::Moving {
            return;
        }
        if let Some(measured) = self.clock.measured() {
            let used = self.clock.period;
            let change = u64::from(measured.0.abs_diff(used.0)) * 1_000_000;
            if change > WORTH_CHANGING_PPM * u64::from(used.0)
                && self.integrator.set_period(measured).is_ok()
            {
                self.clock.period = measured;
            }
        }
    }
}

/// Times of samples against the device's clock.
struct SampleClock {
    nominal: PeriodNs,
    /// In use.
    period: PeriodNs,
    first: Option<DeviceTimeUs>,
    last: Option<DeviceTimeUs>,
    /// Sample periods from first to last, none of them missed.
    periods: u32,
    /// The sensor has failed since: its queue began anew.
    broken: bool,
    /// Equation (95).
    jitter_ns: Option<u32>,
}

impl SampleClock {
    fn new(nominal: PeriodNs) -> Self {
        Self {
            nominal,
            period: nominal,
            first: None,
            last: None,
            periods: 0,
            broken: false,
            jitter_ns: None,
        }
    }

    /// Samples that the sensor took since the last one read and that nobody read, given that
    /// `count` were read now.
    fn missed_before(&self, read: &Batch, count: usize) -> u32 {
        let Some(last) = self.last else {
            return 0;
        };
        if read.queued && !read.overrun && !self.broken {
            return 0;
        }
        let period = u64::from(self.period.0.max(1));
        let elapsed_ns = read.last_time.0.saturating_sub(last.0).saturating_mul(1000);
        let taken = elapsed_ns.saturating_add(period / 2) / period;
        let missed = taken.saturating_sub(count as u64);
        // The sensor knows better than the clock that one is gone.
        u32::try_from(missed.max(read.overrun.into())).unwrap_or(u32::MAX)
    }

    /// Whether `time` follows the latest sample; not before the first, nor where time runs
    /// backwards.
    fn goes_on_at(&self, time: DeviceTimeUs) -> bool {
        self.last.is_some_and(|last| time > last)
    }

    /// Time between samples that follow the latest one without a gap: spread evenly up to `read`.
    fn spacing_ns(&self, read: &Batch, otherwise: u64) -> u64 {
        let since = self
            .last
            .map(|last| read.last_time.0.saturating_sub(last.0));
        since
            .and_then(|since| since.checked_mul(1000)?.checked_div(read.count as u64))
            .unwrap_or(otherwise)
    }

    /// How many periods a gap has is a guess: measuring begins again after it.
    fn measure_anew(&mut self) {
        self.first = None;
        self.periods = 0;
    }

    /// Takes what a read that follows the latest sample tells about the jitter, given the period
    /// that was measured before it: equation (95).
    fn compare(&mut self, read: &Batch, measured: Option<PeriodNs>) {
        let (Some(period), Some(last)) = (measured, self.last) else {
            return;
        };
        let elapsed_ns = (read.last_time.0.saturating_sub(last.0)).saturating_mul(1000);
        let expected_ns = u64::from(period.0).saturating_mul(read.count as u64);
        let off = u32::try_from(elapsed_ns.abs_diff(expected_ns)).unwrap_or(u32::MAX);
        let before = self.jitter_ns.unwrap_or(off);
        self.jitter_ns = Some(before - before / JITTER_WEIGHT + off / JITTER_WEIGHT);
    }

    fn count(&mut self, last: DeviceTimeUs, periods: u32) {
        if self.first.is_none() {
            self.first = Some(last);
        } else {
            self.periods = self.periods.saturating_add(periods);
        }
        self.last = Some(last);
        self.broken = false;
    }

    /// The sensor's true period, once it is known well enough to be used.
    fn measured(&self) -> Option<PeriodNs> {
        let elapsed_ns = self.last?.0.checked_sub(self.first?.0)?.checked_mul(1000)?;
        if elapsed_ns < MEASURE_NS {
            return None;
        }
        let period = elapsed_ns.checked_div(u64::from(self.periods))?;
        let nominal = u64::from(self.nominal.0);
        let believable = period.abs_diff(nominal) * 1000 <= nominal * BELIEVABLE_PER_MILLE;
        believable.then_some(PeriodNs(period as u32))
    }
}

/// Batches under way for one link, or for both where they are of the same length and decimation.
#[derive(Default)]
struct Lane {
    roles: [bool; 2],
    raw: Batcher<Counts>,
    corrected: Batcher<SpecificForceQ16>,
    length: usize,
    /// Samples whose number is a multiple of this are taken; 0 for a lane of no link.
    every: u8,
}

impl Lane {
    fn of(settings: &Settings) -> [Self; 2] {
        let lane = |roles, streams: Streams| Self {
            roles,
            length: usize::from(streams.batch).clamp(1, MAX_BATCH),
            every: streams.every.max(1),
            ..Self::default()
        };
        let (cable, wireless) = (settings.cable, settings.wireless);
        if (cable.batch, cable.every) == (wireless.batch, wireless.every) {
            [lane([true; 2], cable), Self::default()]
        } else {
            [lane([true, false], cable), lane([false, true], wireless)]
        }
    }

    fn add<M: RawMutex>(
        &mut self,
        shared: &Shared<M>,
        sequence: u32,
        time: DeviceTimeUs,
        counts: Counts,
        force: SpecificForceQ16,
    ) {
        if self.roles == [false; 2] {
            return;
        }
        if self.every == 1 || sequence.is_multiple_of(self.every.into()) {
            self.raw.add(sequence, time, counts);
            self.corrected.add(sequence, time, force);
        }
        let age = time.0.saturating_sub(self.raw.first_time.0);
        if self.raw.count >= self.length || age >= OLDEST_BATCH_US {
            self.flush(shared);
        }
    }

    fn flush<M: RawMutex>(&mut self, shared: &Shared<M>) {
        let every = NonZeroU8::new(self.every).unwrap_or(NonZeroU8::MIN);
        self.raw.flush(shared, self.roles, every);
        self.corrected.flush(shared, self.roles, every);
    }
}

struct Batcher<S> {
    samples: [S; MAX_BATCH],
    count: usize,
    first_sequence: u32,
    first_time: DeviceTimeUs,
}

impl<S: Copy + Default> Default for Batcher<S> {
    fn default() -> Self {
        Self {
            samples: [S::default(); MAX_BATCH],
            count: 0,
            first_sequence: 0,
            first_time: DeviceTimeUs(0),
        }
    }
}

impl<S: Sample> Batcher<S> {
    fn add(&mut self, sequence: u32, time: DeviceTimeUs, sample: S) {
        if self.count == 0 {
            self.first_sequence = sequence;
            self.first_time = time;
        }
        if let Some(free) = self.samples.get_mut(self.count) {
            *free = sample;
            self.count += 1;
        }
    }

    fn flush<M: RawMutex>(&mut self, shared: &Shared<M>, roles: [bool; 2], every: NonZeroU8) {
        let count = core::mem::take(&mut self.count);
        let samples = self.samples.get(..count).unwrap_or_default();
        let mut frame = [0; MAX_FRAME];
        let (sequence, time) = (self.first_sequence, self.first_time);
        if let Ok(length) = batch::encode_every(every, sequence, time, samples, &mut frame) {
            let frame = frame.get(..length).unwrap_or_default();
            shared.stream_frame(
                roles,
                frame,
                match S::STREAM {
                    Stream::Raw => |streams| streams.raw,
                    Stream::Corrected => |streams| streams.corrected,
                },
            );
        }
    }
}

const _: () = {
    // The two links of a lane, in the order of its roles.
    assert!(matches!(ROLES, [LinkRole::Cable, LinkRole::Wireless]));
};

#[cfg(test)]
mod tests {
    use super::*;

    /// The jitter after reads of `count` samples of 10.1 ms, each late by what `late` says, µs.
    fn jitter_ns(count: u64, late: impl Fn(u64) -> u64) -> Option<u32> {
        let mut clock = SampleClock::new(PeriodNs(10_000_000));
        for k in 1..=1000 {
            let read = Batch {
                count: count as usize,
                last_time: DeviceTimeUs(k * count * 10_100 + late(k)),
                overrun: false,
                queued: count > 1,
            };
            clock.compare(&read, clock.measured());
            clock.count(read.last_time, count as u32);
        }
        clock.jitter_ns
    }

    #[test]
    fn jitter_is_how_far_intervals_are_from_the_measured_period_and_not_from_the_nominal_one() {
        for count in [1, 4, 16] {
            let even = jitter_ns(count, |_| 0).expect("long enough");
            assert!(even <= 100, "{even} ns");
            // Every second one is late by 40 µs: each interval is off by as much.
            let uneven = jitter_ns(count, |k| k % 2 * 40).expect("long enough");
            assert!(uneven.abs_diff(40_000) <= 200, "{uneven} ns");
        }
    }
}
