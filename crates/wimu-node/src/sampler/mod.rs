//! Samples: read, number, correct, integrate, pack.

pub(crate) mod batches;
pub(crate) mod clock;

use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_integrator::{Config, FieldMean, Integrator, Phase, State, Transition};
use wimu_link::batch;
use wimu_link::message::{
    Attitude, BusFault, Environment, Epoch, EpochGyroscope, EpochReason, Event, Navigation,
    Settings,
};
use wimu_model::{DeviceTimeUs, MagneticFieldNt, PeriodNs};

use self::batches::Lane;
use self::clock::SampleClock;
use crate::sample::RawSample;
use crate::sample::sealed::Process as _;
use crate::sensor::{Batch, InertialSensor, Plan, SensorFault, SensorPlan, Surroundings};
use crate::shared::{
    ALL, Common, Correction, Message, NONE, Order, Orders, PersistentFault, ROLES, Roles, Shared,
    Worker,
};
use crate::timer::Timer;

/// Most samples in one read.
const MAX_READ: usize = 32;
/// One, or none without the feature `navigation`.
const INTEGRATORS: usize = cfg!(feature = "navigation") as usize;
/// Interval between navigation messages, ns.
const NAVIGATION_NS: u32 = 100_000_000;
/// Minimum age of an epoch, µs, after which the next end of a detector window begins a new one. The state is
/// shortest there.
pub(crate) const EPOCH_DUE_US: u64 = 800_000;
/// Age of an epoch, µs, from which any sample begins a new one: less than the 1 s that hosts expect.
const EPOCH_LATEST_US: u64 = 950_000;
/// Interval between reads of magnetic field and temperature, µs.
const SURROUNDINGS_US: u64 = 500_000;
/// Interval between attempts to restart a failed sensor, µs.
const RETRY_US: u64 = 200_000;
/// Smallest change of the sample period that the integrator takes over, ppm.
const PERIOD_CHANGE_PPM: u64 = 50;

/// Reads the sensor, corrects and integrates the samples, and sends them.
pub struct Sampler<'a, A: InertialSensor, T, M: RawMutex> {
    sensor: A,
    timer: T,
    shared: &'a Common<M>,
    orders: &'a Orders<M, A::Sample>,
    lanes: Roles<Lane<A::Sample>>,
    next_sequence: u32,
    /// Epochs sent on both links, modulo 256.
    epochs: u8,
    next_surroundings: DeviceTimeUs,
    /// The reported fault, until the next sample.
    reported: Option<SensorFault>,
}

/// The state of a configured sampler.
struct Running<S: RawSample> {
    plan: Plan,
    correction: Correction<S>,
    integrator: [Integrator<S::Rotation>; INTEGRATORS],
    clock: SampleClock,
    epoch_reason: Option<EpochReason>,
    last_epoch: DeviceTimeUs,
    until_navigation: u32,
    /// The magnetic field in the present rest.
    field: FieldMean,
    /// The sensor has failed and has not been started again.
    lost: bool,
}

impl<'a, A: InertialSensor, T: Timer, M: RawMutex> Sampler<'a, A, T, M> {
    pub(crate) fn new(sensor: A, timer: T, shared: &'a Shared<M, A::Sample>) -> Self {
        Self {
            sensor,
            timer,
            shared: &shared.common,
            orders: &shared.orders,
            lanes: ROLES.map(|_| Lane::default()),
            next_sequence: 0,
            epochs: 0,
            next_surroundings: DeviceTimeUs(0),
            reported: None,
        }
    }

    /// Runs for ever. Never waits for a link or for the store.
    pub async fn run(&mut self) -> ! {
        let mut running = loop {
            self.orders.given.wait().await;
            if let Some(plan) = self.orders.plan() {
                let outcome = self.sensor.configure(&plan).await;
                if let Some(running) = self.start(outcome) {
                    break running;
                }
            } else {
                // A correction before the first configuration has no effect.
                self.orders.take();
            }
        };
        let mut samples = [A::Sample::default(); MAX_READ];
        loop {
            self.shared.progressed(Worker::Sampler);
            if self.orders.given.try_take().is_some() {
                match self.orders.plan() {
                    Some(plan) => {
                        self.flush();
                        let outcome = self.sensor.configure(&plan).await;
                        self.configured(&mut running, outcome);
                    }
                    #[cfg(feature = "correction")]
                    None => self.correct(&mut running),
                    #[cfg(not(feature = "correction"))]
                    None => {}
                }
            }
            if running.lost {
                self.retry(&mut running).await;
                continue;
            }
            match self.sensor.next(&mut samples).await {
                Ok(read) => {
                    let samples = samples.get(..read.count).unwrap_or(&samples);
                    match read.sensor {
                        0 => self.process(&mut running, read, samples),
                        _ => self.process_secondary(&running, read, samples),
                    }
                }
                Err(fault) => self.fail(&mut running, fault),
            }
            if !running.lost && self.timer.now() >= self.next_surroundings {
                self.read_surroundings(&mut running).await;
            }
        }
    }

    /// After the first attempt to configure the sensor.
    #[inline(never)]
    fn start(&mut self, outcome: Result<(), SensorFault>) -> Option<Running<A::Sample>> {
        let Some(Order::Configure(plan, correction)) = self.orders.take() else {
            return None;
        };
        let mut running = Running::new(plan, correction, EpochReason::Start);
        if let Err(fault) = outcome {
            self.fail(&mut running, fault);
        }
        self.lanes = Lane::of(&plan.settings);
        self.shared.configured.signal(outcome);
        Some(running)
    }

    /// After a later attempt to configure the sensor.
    #[inline(never)] // Keeps the new state off the stack while samples are taken.
    fn configured(&mut self, running: &mut Running<A::Sample>, outcome: Result<(), SensorFault>) {
        match (outcome, self.orders.take()) {
            (Ok(()), Some(Order::Configure(plan, correction))) => {
                *running = Running::new(plan, correction, EpochReason::Settings);
                self.lanes = Lane::of(&plan.settings);
                self.restart_secondary(EpochReason::Settings);
            }
            // The state of the sensor is unknown: `retry` configures it under the previous plan.
            (Err(fault), _) => self.fail(running, fault),
            _ => {}
        }
        self.shared.configured.signal(outcome);
    }

    #[cfg(feature = "correction")]
    #[inline(never)]
    fn correct(&mut self, running: &mut Running<A::Sample>) {
        let Some(Order::Correct(correction)) = self.orders.take() else {
            return;
        };
        let reason = if correction.parameters == running.correction.parameters {
            EpochReason::Temperature
        } else {
            running.integrator =
                integrator::<A::Sample>(&running.plan.settings, running.clock.period);
            EpochReason::Parameters
        };
        running.correction = correction;
        running.begin_epoch(reason);
    }

    /// Processes samples, oldest first.
    fn process(&mut self, running: &mut Running<A::Sample>, read: Batch, samples: &[A::Sample]) {
        if self.reported.take().is_some() {
            self.shared.set_fault(PersistentFault::Sensor, self.timer.now(), None);
            self.shared.report(self.timer.now(), Event::SensorFound);
        }
        let (reads, period) = (&running.clock.reads, running.clock.period);
        let missed = reads.missed_before(&read, samples.len(), period);
        let mut spacing_ns = u64::from(period.0);
        if missed == 0
            && let Some(measured_ns) = reads.spacing_ns(&read)
        {
            spacing_ns = measured_ns;
        } else {
            self.flush();
            running.clock.restart_measurement();
            running.gap();
            self.next_sequence = self.next_sequence.wrapping_add(missed);
            running.begin_epoch(EpochReason::Gap);
        }
        let measured = running.clock.measured();
        running.clock.update_jitter(&read, measured);
        self.shared.publish(|published| {
            let sensor = &mut published.sensor;
            sensor.samples = sensor.samples.wrapping_add(samples.len() as u32);
            sensor.missed = sensor.missed.wrapping_add(missed);
            sensor.overruns = sensor.overruns.wrapping_add(read.overrun.into());
            published.measured_period_ns = measured.map(|period| period.0);
            published.jitter_ns = running.clock.jitter_ns;
        });
        for (index, &sample) in samples.iter().enumerate() {
            let newer = samples.len() - 1 - index;
            let time = clock::sample_time(&read, newer, spacing_ns);
            self.sample(running, sample, time);
        }
        running.clock.count(read.last_time, samples.len() as u32);
    }

    /// Sends samples of another sensor than the first.
    fn process_secondary(
        &mut self,
        running: &Running<A::Sample>,
        read: Batch,
        samples: &[A::Sample],
    ) {
        let index = usize::from(read.sensor).wrapping_sub(1);
        if let Some(secondary) = self.sensor.secondary().get_mut(index) {
            let temperature = running.correction.temperature.map(|t| t.0);
            secondary.process(&read, samples, &self.lanes, self.shared, temperature);
        }
    }

    fn sample(&mut self, running: &mut Running<A::Sample>, sample: A::Sample, time: DeviceTimeUs) {
        let wanted = ROLES.map(|role| self.shared.take_epoch_wanted(role));
        match running.epoch_reason.take() {
            Some(reason) => {
                running.last_epoch = time;
                self.epochs = self.epochs.wrapping_add(1);
                self.send_epoch(running, reason, time, ALL);
            }
            // Only for the link with a new listener.
            None if wanted != NONE => {
                self.send_epoch(running, EpochReason::Periodic, time, wanted);
            }
            None => {}
        }
        let sequence = self.next_sequence;
        let correction = &running.correction;
        let correctors = correction.correctors.as_ref();
        let corrected = correctors
            .filter(|_| cfg!(feature = "correction"))
            .map(|(corrector, gyroscope)| sample.correct(corrector, gyroscope));
        let sensor = &running.plan.sensor;
        let transition = match (running.integrator.first_mut(), corrected) {
            (Some(integrator), Some(corrected)) => sample.integrate(corrected, sensor, integrator),
            // An epoch may begin at any sample.
            _ => Transition::Window,
        };
        for lane in &mut self.lanes {
            lane.add(self.shared, sequence, time, sample, corrected);
        }
        self.next_sequence = sequence.wrapping_add(1);

        running.until_navigation = running.until_navigation.saturating_sub(1);
        if running.until_navigation == 0 {
            running.until_navigation = (NAVIGATION_NS / running.clock.period.0.max(1)).max(1);
            self.send_navigation(running, sequence);
        }
        if transition == Transition::Rest {
            // Read the field soon: the rest may be short.
            running.field = FieldMean::default();
            if running.correction.compass.is_some() {
                self.next_surroundings = time;
            }
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
        running: &Running<A::Sample>,
        reason: EpochReason,
        time: DeviceTimeUs,
        roles: Roles,
    ) {
        let epoch = Message::Epoch(Epoch {
            reason,
            number: self.epochs,
            sequence: self.next_sequence,
            time_us: time.0,
            period_ns: running.clock.period.0,
            range_g: running.plan.settings.range_g,
            sensitivity_lsb_per_g: running.plan.sensor.accelerometer.sensitivity().lsb_per_g(),
            full_scale: running.plan.sensor.full_scale,
            parameters: running.correction.parameters.0,
            temperature_centi_c: running.correction.temperature.map(|t| t.0),
            state: match running.integrator.first() {
                Some(integrator) => integrator.state(),
                None => State::default(),
            },
            gyroscope: epoch_gyroscope(&running.plan.sensor),
            ..Epoch::default()
        });
        self.shared.announce(&epoch, roles);
    }

    fn send_navigation(&self, running: &Running<A::Sample>, sequence: u32) {
        let Some(integrator) = running.integrator.first() else {
            return;
        };
        let navigation = integrator.navigation();
        let message = Message::Navigation(Navigation::new(sequence, &navigation));
        self.shared.stream(ALL, &message, |streams| streams.navigation);
        if let Some(quaternion) =
            navigation.attitude.filter(|_| <A::Sample as batch::Sample>::AXES == 6)
        {
            let message = Message::Attitude(Attitude { sequence, quaternion });
            self.shared.stream(ALL, &message, |streams| streams.navigation);
        }
    }

    async fn read_surroundings(&mut self, running: &mut Running<A::Sample>) {
        let now = self.timer.now();
        self.next_surroundings = DeviceTimeUs(now.0.saturating_add(SURROUNDINGS_US));
        match self.sensor.surroundings().await {
            // The sensor measures neither: no message.
            Ok(nothing) if nothing == Surroundings::default() => {}
            Ok(surroundings) => {
                if A::MAGNETOMETER
                    && cfg!(feature = "heading")
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
                self.shared.stream(ALL, &message, |streams| streams.environment);
            }
            Err(fault) => self.fail(running, fault),
        }
    }

    fn restart_secondary(&mut self, reason: EpochReason) {
        for secondary in self.sensor.secondary() {
            secondary.restart(reason);
        }
    }

    /// The sensor has failed: sends the samples read so far, marks a gap and schedules a restart.
    fn fail(&mut self, running: &mut Running<A::Sample>, fault: SensorFault) {
        self.flush();
        running.gap();
        running.begin_epoch(EpochReason::Gap);
        running.clock.reads.broken = true;
        self.restart_secondary(EpochReason::Gap);
        running.lost = true;
        self.shared.publish(|published| {
            let errors = &mut published.sensor.bus_errors;
            *errors = errors.wrapping_add(1);
        });
        self.report(fault);
    }

    async fn retry(&mut self, running: &mut Running<A::Sample>) {
        self.timer.after_us(RETRY_US).await;
        match self.sensor.configure(&running.plan).await {
            // The first sample confirms that it works.
            Ok(()) => running.lost = false,
            Err(fault) => self.report(fault),
        }
    }

    /// Reports a fault, once until another one occurs or samples arrive again.
    fn report(&mut self, fault: SensorFault) {
        if self.reported.replace(fault) == Some(fault) {
            return;
        }
        let event = match fault {
            SensorFault::NotAnswering => Event::SensorLost(BusFault::NoAnswer),
            SensorFault::Transfer => Event::SensorLost(BusFault::Transfer),
            SensorFault::NoData => Event::SensorLost(BusFault::Timeout),
            SensorFault::GyroscopeStopped => Event::GyroscopeLost(BusFault::Timeout),
            SensorFault::WrongIdentity { expected, found } => {
                Event::WrongSensor { expected, found }
            }
        };
        let now = self.timer.now();
        self.shared.set_fault(PersistentFault::Sensor, now, Some(event));
        self.shared.report(now, event);
    }

    fn flush(&mut self) {
        for lane in &mut self.lanes {
            lane.flush(self.shared);
        }
    }
}

pub(crate) fn epoch_gyroscope(plan: &SensorPlan) -> Option<EpochGyroscope> {
    plan.gyroscope.map(|gyroscope| EpochGyroscope {
        rad_s_per_lsb: gyroscope.rad_s_per_lsb(),
        full_scale: gyroscope.full_scale(),
    })
}

fn integrator<S: RawSample>(
    settings: &Settings,
    period: PeriodNs,
) -> [Integrator<S::Rotation>; INTEGRATORS] {
    let config = Config { period, zupt: settings.zupt, gravity_um_s2: settings.gravity_um_s2 };
    [(); INTEGRATORS].map(|()| S::integrator(config))
}

impl<S: RawSample> Running<S> {
    fn new(plan: Plan, correction: Correction<S>, reason: EpochReason) -> Self {
        Self {
            plan,
            correction,
            integrator: integrator::<S>(&plan.settings, plan.sensor.period),
            clock: SampleClock::new(plan.sensor.period),
            epoch_reason: Some(reason),
            last_epoch: DeviceTimeUs(0),
            until_navigation: 1,
            field: FieldMean::default(),
            lost: false,
        }
    }

    fn gap(&mut self) {
        for integrator in &mut self.integrator {
            integrator.gap();
        }
    }

    /// Makes the next sample begin an epoch. Of several reasons the one that resets most is reported,
    /// because a replay must not continue across a reset.
    fn begin_epoch(&mut self, reason: EpochReason) {
        let severity = |reason| match reason {
            EpochReason::Periodic => 0,
            EpochReason::Stillness => 1,
            EpochReason::Temperature => 2,
            EpochReason::Heading => 3,
            EpochReason::Gap => 4,
            EpochReason::Start | EpochReason::Settings | EpochReason::Parameters => 5,
        };
        if self.epoch_reason.is_none_or(|known| severity(known) <= severity(reason)) {
            self.epoch_reason = Some(reason);
        }
    }

    /// Sets the heading from the magnetometer, if it is calibrated and the unit is at rest.
    fn take_field(&mut self, field: MagneticFieldNt) {
        let (Some(compass), Some(integrator)) =
            (&self.correction.compass, self.integrator.first_mut())
        else {
            return;
        };
        let state = integrator.state();
        if state.phase != Phase::Resting || !self.field.push(field) {
            return;
        }
        if let Some(heading) = self.field.heading(compass, integrator.rest_force())
            && integrator.set_heading(heading)
        {
            self.begin_epoch(EpochReason::Heading);
        }
    }

    /// Integrates with the measured sample period from now on. Not in motion, where a change of the period
    /// would add an error.
    fn adopt_measured_period(&mut self) {
        let moving =
            |integrator: &Integrator<S::Rotation>| integrator.navigation().phase == Phase::Moving;
        if self.integrator.iter().any(moving) {
            return;
        }
        if let Some(measured) = self.clock.measured() {
            let used = self.clock.period;
            let change = u64::from(measured.0.abs_diff(used.0)) * 1_000_000;
            if change > PERIOD_CHANGE_PPM * u64::from(used.0)
                && (self.integrator.iter_mut())
                    .all(|integrator| integrator.set_period(measured).is_ok())
            {
                self.clock.period = measured;
            }
        }
    }
}
