//! The sampler in a whole node, with a sensor that follows a script: six axes, wide counts, several sensors.

// A node of all features and one of none take different tests.
#![allow(dead_code, unused_imports)]

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::f64::consts::FRAC_PI_2;
use std::future::{pending, poll_fn};
use std::rc::Rc;
use std::task::Poll;

use embassy_futures::block_on;
use embassy_futures::select::select;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_io_async::{ErrorType, Read, Write};
use wimu_integrator::Flags;
use wimu_link::auth::DeviceKey;
use wimu_link::batch::Stream;
use wimu_link::hello::Capabilities;
use wimu_link::message::{
    Answer, BusFault, Command, Epoch, EpochReason, Event, Payload, Refusal, Reply, Request,
    SetBytes, Settings, Streams, Telemetry,
};
use wimu_link::{Batch as WireBatch, Deframer, Hello, Kind, LinkRole, MAX_FRAME};
use wimu_model::{
    CompiledSet, Counts, DeviceTimeUs, GyroscopeModel, GyroscopeParameters, GyroscopeTerms,
    ParameterId, ParameterSet, PeriodNs, Sensitivity, SetError, WideCounts,
};
use wimu_node::sensor::{
    AccelerometerScale, Batch, GyroscopePlan, Plan, RawSample, SensorFault, SensorPlan,
    Surroundings,
};
use wimu_node::{Board, InertialSensor, Key, Secondary, Shared, Store, StoreFault, Timer};

/// A clock that moves while somebody waits.
#[derive(Clone, Default)]
struct Clock(Rc<Cell<u64>>);

impl Timer for Clock {
    fn now(&self) -> DeviceTimeUs {
        DeviceTimeUs(self.0.get())
    }

    async fn until(&self, moment: DeviceTimeUs) {
        poll_fn(|_| {
            if self.0.get() >= moment.0 {
                return Poll::Ready(());
            }
            self.0.set(self.0.get() + 50);
            Poll::Pending
        })
        .await;
    }
}

/// A memory that holds at most a parameter set for ±2 g.
struct Memory(Option<ParameterSet>);

impl Store for Memory {
    fn load(&mut self, key: Key, record: &mut [u8]) -> Result<Option<usize>, StoreFault> {
        let Some(set) = self.0.filter(|_| key == Key::Parameters { range_g: 2 }) else {
            return Ok(None);
        };
        let set = CompiledSet::compile(&set, ParameterId(7), 0).expect("compiled");
        let mut bytes = [0; CompiledSet::MAX_BYTES];
        let length = set.to_bytes(&mut bytes);
        record[..length].copy_from_slice(&bytes[..length]);
        Ok(Some(length))
    }

    async fn save(&mut self, _: Key, _: &[u8]) -> Result<(), StoreFault> {
        Ok(())
    }

    async fn count_start(&mut self) -> Result<u32, StoreFault> {
        Ok(1)
    }

    async fn remove(&mut self, _: fn(Key) -> bool) -> Result<(), StoreFault> {
        Ok(())
    }
}

/// A line that receives what it holds, then nothing, and keeps what is sent.
#[derive(Clone, Default)]
struct Line(Rc<RefCell<Vec<u8>>>);

impl ErrorType for Line {
    type Error = Infallible;
}

impl Read for Line {
    async fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        let count = bytes.len().min(self.0.borrow().len());
        if count == 0 {
            return pending().await;
        }
        for (place, byte) in bytes.iter_mut().zip(self.0.borrow_mut().drain(..count)) {
            *place = byte;
        }
        Ok(count)
    }
}

impl Write for Line {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.0.borrow_mut().extend(bytes);
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// What `next` returns: samples of a sensor, or a fault.
type Step<S> = Result<(u8, Vec<S>), SensorFault>;

/// A sensor at 100 Hz with a queue.
struct Scripted<S> {
    clock: Clock,
    steps: VecDeque<Step<S>>,
    plan: SensorPlan,
    secondary: Vec<Secondary>,
    /// Time of the newest sample of either.
    times: [u64; 2],
    done: Rc<Cell<bool>>,
}

struct Planner(SensorPlan);

impl wimu_node::sensor::Planner for Planner {
    fn plan(&self, wanted: &Settings) -> Result<Plan, Settings> {
        Ok(Plan::new(*wanted, self.0))
    }
}

impl<S: RawSample> InertialSensor for Scripted<S> {
    type Sample = S;
    type Planner = Planner;

    fn planner(&self) -> Planner {
        Planner(self.plan)
    }

    fn secondary(&mut self) -> &mut [Secondary] {
        &mut self.secondary
    }

    async fn configure(&mut self, _: &Plan) -> Result<(), SensorFault> {
        self.times = [self.clock.now().0; 2];
        Ok(())
    }

    async fn next(&mut self, samples: &mut [S]) -> Result<Batch, SensorFault> {
        let Some(step) = self.steps.pop_front() else {
            // The links are emptied meanwhile.
            self.clock.after_us(100_000).await;
            self.done.set(true);
            pending().await
        };
        let (sensor, new) = step?;
        samples[..new.len()].copy_from_slice(&new);
        let time = &mut self.times[usize::from(sensor)];
        *time += 10_000 * new.len() as u64;
        let last_time = DeviceTimeUs(*time);
        self.clock.until(last_time).await;
        Ok(Batch::new(new.len(), last_time).of_sensor(sensor).queued())
    }

    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        Ok(Surroundings::default())
    }
}

/// What a host received.
#[derive(Default)]
struct Received {
    batches: Vec<WireBatch>,
    epochs: Vec<Epoch>,
    events: Vec<Event>,
    flags: Flags,
    hello: Option<Hello>,
    answers: Vec<Answer>,
    /// Of the latest sample with an attitude.
    quaternion: Option<[f64; 4]>,
}

impl Received {
    /// The batches of a sensor and stream, one after the other: accelerometer and angular rates.
    fn samples(&self, sensor: u8, stream: Stream) -> (Vec<[i32; 3]>, Vec<[i32; 3]>) {
        let chosen = |batch: &&WireBatch| batch.sensor() == sensor && batch.stream() == stream;
        let batches = || self.batches.iter().filter(chosen);
        (
            batches().flat_map(WireBatch::samples).copied().collect(),
            batches().flat_map(WireBatch::angular_rates).copied().collect(),
        )
    }

    fn epochs_of(&self, sensor: u8) -> Vec<&Epoch> {
        self.epochs.iter().filter(|epoch| epoch.sensor == sensor).collect()
    }
}

/// Runs a node with sensors of `plans` that follow `steps`.
fn run<S: RawSample>(plans: &[SensorPlan], steps: impl IntoIterator<Item = Step<S>>) -> Received {
    run_with(None, plans, steps)
}

/// Runs it with stored parameters.
fn run_with<S: RawSample>(
    parameters: Option<ParameterSet>,
    plans: &[SensorPlan],
    steps: impl IntoIterator<Item = Step<S>>,
) -> Received {
    run_asked(None, parameters, plans, steps)
}

/// Runs it with a request on the cable.
fn run_asked<S: RawSample>(
    command: Option<Command>,
    parameters: Option<ParameterSet>,
    plans: &[SensorPlan],
    steps: impl IntoIterator<Item = Step<S>>,
) -> Received {
    let mut request = vec![0; MAX_FRAME];
    let length = command.map_or(0, |command| {
        let request_of = Request { session: 1, id: 1, signature: Default::default(), command };
        request_of.encode(&mut request).expect("it fits")
    });
    request.truncate(length);
    let (clock, cable, done) = (Clock::default(), Line::default(), Rc::default());
    let board = Board {
        hello: Hello::new(LinkRole::Cable),
        sensor: Scripted {
            clock: clock.clone(),
            steps: steps.into_iter().collect(),
            plan: plans[0],
            secondary: plans[1..].iter().map(|plan| Secondary::new(*plan)).collect(),
            times: [0; 2],
            done: Rc::clone(&done),
        },
        timer: clock,
        store: Memory(parameters),
        entropy: [0; 16],
        cable: (Line(Rc::new(RefCell::new(request))), cable.clone()),
        wireless: (Line::default(), Line::default()),
        nearest_rate: Some(|baud| baud),
    };
    let shared = Shared::<NoopRawMutex, S>::new();
    let ended = poll_fn(|_| if done.get() { Poll::Ready(()) } else { Poll::Pending });
    block_on(select(board.split(&shared).run(), ended));
    let mut received = Received::default();
    let mut deframer = Deframer::new();
    for &byte in cable.0.borrow().iter() {
        let Some(frame) = deframer.push(byte) else {
            continue;
        };
        let frame = frame.expect("an undamaged frame");
        if frame.kind.is_batch() {
            let batch = WireBatch::decode(frame.kind, frame.body);
            received.batches.push(batch.expect("a batch"));
            continue;
        }
        if frame.kind == Kind::Reply {
            let reply = Reply::decode(frame.body).expect("a reply");
            received.answers.push(reply.answer);
            continue;
        }
        if frame.kind == Kind::Hello {
            received.hello = Hello::decode(frame.body).ok();
            continue;
        }
        match Telemetry::decode(frame.body) {
            Ok(Telemetry::Epoch(epoch)) => received.epochs.push(epoch),
            Ok(Telemetry::Event { event, .. }) => received.events.push(event),
            Ok(Telemetry::Navigation(navigation)) => {
                received.flags = received.flags.with(Flags(navigation.flags));
            }
            Ok(Telemetry::Attitude(attitude)) => {
                let quaternion = attitude.quaternion.map(|q| f64::from(q) / f64::from(1 << 30));
                received.quaternion = Some(quaternion);
            }
            _ => {}
        }
    }
    received
}

/// 16384 LSB/g and 0.001 rad/s per LSB.
fn six_axes() -> SensorPlan {
    static GYROSCOPE: GyroscopePlan = GyroscopePlan::new(RAD_S_PER_LSB, 0x7FFF);
    three_axes().with_gyroscope(&GYROSCOPE)
}

const RAD_S_PER_LSB: f64 = 1e-3;
static ACCELEROMETER: AccelerometerScale = AccelerometerScale::of(16384.0);

fn three_axes() -> SensorPlan {
    SensorPlan::new(PeriodNs(10_000_000), &ACCELEROMETER, 0x7FFF)
}

/// `count` reads of 16 samples, a batch each: 0.16 s.
fn reads<S: RawSample>(count: usize, sample: S) -> impl Iterator<Item = Step<S>> {
    (0..count).map(move |_| Ok((0, vec![sample; 16])))
}

const LEVEL: Counts = Counts([0, 0, 16384]);

fn level(rate: [i16; 3]) -> (Counts, Counts) {
    (LEVEL, Counts(rate))
}

#[cfg(feature = "full")]
#[test]
fn six_axes_are_sent_raw_and_corrected_and_turn_the_attitude() {
    // At rest with a gyroscope bias of 5 mrad/s, then a quarter turn about z in 0.96 s.
    let turn = (FRAC_PI_2 / 0.96 / RAD_S_PER_LSB).round() as i16;
    let steps = reads(25, level([5, 0, -5])).chain(reads(6, level([5, 0, turn - 5])));
    let received = run(&[six_axes()], steps);
    let (counts, rates) = received.samples(0, Stream::Raw);
    assert_eq!((counts.len(), rates.len()), (496, 496));
    assert_eq!((counts[0], rates[0]), ([0, 0, 16384], [5, 0, -5]));
    assert_eq!(rates[495], [5, 0, i32::from(turn) - 5]);
    let (forces, rates) = received.samples(0, Stream::Corrected);
    assert_eq!(forces[0], [0, 0, (9.80665 * 65536.0_f64).round() as i32]);
    // Nominal sensitivity without parameters, 2⁻²⁰ rad/s.
    assert_eq!(rates[0], [5243, 0, -5243]);
    let gyroscope = received.epochs[0].gyroscope.expect("in every epoch");
    assert_eq!(gyroscope.rad_s_per_lsb, RAD_S_PER_LSB);
    assert_eq!(gyroscope.full_scale, 0x7FFF);
    let [w, x, y, z] = received.quaternion.expect("with each navigation message");
    // The last navigation message is up to 100 ms (9°) old; the bias is known.
    let angle = 2.0 * z.atan2(w).to_degrees();
    assert!((80.0..90.5).contains(&angle), "{angle}°");
    assert!(x.hypot(y) < 1e-3, "{x} {y}");
    assert!(!received.flags.contains(Flags::GYROSCOPE_SATURATED));
    assert!(received.epochs[0].is_ours());
}

#[cfg(feature = "full")]
#[test]
fn a_saturated_gyroscope_is_flagged_apart_from_a_saturated_accelerometer() {
    let saturated = |accelerometer, gyroscope| {
        let then = (Counts(accelerometer), Counts(gyroscope));
        let steps = reads(20, level([0; 3])).chain(reads(6, then));
        let flags = run(&[six_axes()], steps).flags;
        [Flags::SATURATED, Flags::GYROSCOPE_SATURATED].map(|flag| flags.contains(flag))
    };
    assert_eq!(saturated([0, 0, 20_000], [0, 0, i16::MAX]), [false, true]);
    assert_eq!(saturated([0, 0, 20_000], [0, -i16::MAX, 0]), [false, true]);
    assert_eq!(saturated([i16::MIN, 0, 0], [0, 500, 0]), [true, false]);
}

#[cfg(feature = "full")]
#[test]
fn a_gyroscope_that_stops_is_reported_once_and_then_its_return() {
    let stopped = || Err(SensorFault::GyroscopeStopped);
    let steps =
        reads(6, level([0; 3])).chain([stopped(), stopped()]).chain(reads(6, level([0; 3])));
    let received = run(&[six_axes()], steps);
    let lost = Event::GyroscopeLost(BusFault::Timeout);
    assert_eq!(received.events, [lost, Event::SensorFound]);
    let gap = received.epochs.iter().find(|epoch| epoch.reason == EpochReason::Gap);
    let sequence = gap.expect("samples are missing").sequence;
    assert!((126..156).contains(&sequence), "{sequence}: 0.4 s are missing");
}

#[cfg(feature = "full")]
#[test]
fn another_chip_is_named() {
    let wrong = SensorFault::WrongIdentity { expected: 0x6C, found: 0x6A };
    let steps = [Err(wrong)].into_iter().chain(reads(6, level([0; 3])));
    let named = Event::WrongSensor { expected: 0x6C, found: 0x6A };
    assert_eq!(run(&[six_axes()], steps).events, [named, Event::SensorFound]);
}

#[cfg(feature = "full")]
#[test]
fn counts_beyond_20_bits_are_clamped_and_saturated() {
    let (most, least) = (WideCounts::MAX, WideCounts::MIN);
    static FINE: AccelerometerScale = AccelerometerScale::of(256_000.0);
    static RATE: GyroscopePlan = GyroscopePlan::new(RAD_S_PER_LSB / 16.0, WideCounts::MAX);
    let plan = SensorPlan::new(PeriodNs(10_000_000), &FINE, most).with_gyroscope(&RATE);
    let wide = |force, rate| (WideCounts(force), WideCounts(rate));
    let steps = reads(20, wide([0, 0, 256_000], [0; 3]))
        .chain(reads(6, wide([i32::MAX, i32::MIN, 0], [i32::MIN, 0, i32::MAX])));
    let received = run(&[plan], steps);
    assert!(received.batches[0].is_wide());
    let (counts, rates) = received.samples(0, Stream::Raw);
    assert_eq!(counts[0], [0, 0, 256_000]);
    assert_eq!(counts.last(), Some(&[most, least, 0]));
    assert_eq!(rates.last(), Some(&[least, 0, most]));
    let (forces, _) = received.samples(0, Stream::Corrected);
    assert_eq!(forces[0][2], (9.80665 * 65536.0_f64).round() as i32);
    for flag in [Flags::SATURATED, Flags::GYROSCOPE_SATURATED] {
        assert!(received.flags.contains(flag), "{flag:?}");
    }
    assert_eq!(received.epochs[0].full_scale, most);
}

#[cfg(feature = "full")]
#[test]
fn a_second_sensor_is_sent_raw_with_its_own_numbers_and_epochs() {
    static COARSE: AccelerometerScale = AccelerometerScale::of(163.84);
    let coarse = SensorPlan::new(PeriodNs(10_000_000), &COARSE, 0x7FFF);
    let mut number = 0;
    let steps = (0..360).map(|step| match step % 3 {
        0 | 1 => Ok((0, vec![level([0; 3]); 5])),
        _ => {
            let new = (0..10).map(|k| (Counts([number + k, 0, 164]), Counts::default()));
            let new = new.collect();
            number += 10;
            Ok((1, new))
        }
    });
    // A fault after 960 samples of either sensor, of which 0.2 s are lost.
    let steps: Vec<_> = steps.collect();
    let (before, after) = steps.split_at(288);
    let fault = [Err(SensorFault::Transfer)];
    let steps = [before, &fault, after].concat();
    let received = run(&[six_axes(), coarse], steps);
    let (counts, rates) = received.samples(1, Stream::Raw);
    let expected: Vec<[i32; 3]> = (0..1200).map(|k| [k, 0, 164]).collect();
    assert_eq!(counts, expected);
    assert_eq!(rates, [[0; 3]; 0], "it has no gyroscope");
    let (corrected, _) = received.samples(1, Stream::Corrected);
    assert_eq!(corrected, [[0; 3]; 0], "it is corrected on the host");
    assert_eq!(received.samples(0, Stream::Raw).0.len(), 1200);
    let epochs = received.epochs_of(1);
    assert!((13..=16).contains(&epochs.len()), "one a second: {}", epochs.len());
    for (index, epoch) in epochs.iter().enumerate() {
        assert_eq!(usize::from(epoch.number), index + 1);
        assert_eq!(epoch.gyroscope, None);
        assert_eq!((epoch.range_g, epoch.full_scale), (200, 0x7FFF));
        assert_eq!(epoch.parameters, 0);
    }
    assert_eq!((epochs[0].reason, epochs[0].sequence), (EpochReason::Start, 0));
    for sensor in [0, 1] {
        let epochs = received.epochs_of(sensor);
        let gaps = epochs.iter().filter(|epoch| epoch.reason == EpochReason::Gap);
        let gaps: Vec<_> = gaps.map(|epoch| epoch.sequence).collect();
        let [sequence] = gaps[..] else {
            panic!("sensor {sensor}: gaps before {gaps:?}");
        };
        assert!((970..1000).contains(&sequence), "sensor {sensor}: {sequence}");
    }
}

#[cfg(feature = "full")]
#[test]
fn three_axes_stay_in_batches_of_three_axes() {
    let received = run(&[three_axes()], reads(6, LEVEL));
    assert!(received.batches.iter().all(|batch| batch.angular_rates().is_empty()));
    assert_eq!(received.samples(0, Stream::Raw).0.len(), 96);
    assert_eq!(received.quaternion, None);
    assert_eq!(received.epochs[0].gyroscope, None);
}

#[cfg(feature = "full")]
#[test]
fn a_calibrated_gyroscope_is_corrected() {
    let calibrated = |rad_s_per_lsb| {
        let terms = GyroscopeTerms { bias_rad_s: [0.0, 0.0, 0.25], ..GyroscopeTerms::default() };
        let model = GyroscopeModel::new(terms).expect("within bounds");
        let gyroscope = GyroscopeParameters::new(2000, rad_s_per_lsb, model, None);
        let set = ParameterSet::uncalibrated(2, ACCELEROMETER.sensitivity());
        let gyroscope = Some(gyroscope.expect("within bounds"));
        Some(ParameterSet { gyroscope, ..set })
    };
    let corrected = |parameters| {
        let steps = reads(6, level([0, 0, 500]));
        let received = run_with(parameters, &[six_axes()], steps);
        let (_, rates) = received.samples(0, Stream::Corrected);
        (rates[0], received.epochs[0].parameters != 0, received.events)
    };
    let rad_s = |rate: f64| [0, 0, (rate * f64::from(1 << 20)).round() as i32];
    assert_eq!(corrected(None), (rad_s(0.5), false, vec![]));
    assert_eq!(corrected(calibrated(RAD_S_PER_LSB)), (rad_s(0.25), true, vec![]));
    // Without a gyroscope's part its nominal scale applies.
    let without = calibrated(RAD_S_PER_LSB).map(|set| ParameterSet { gyroscope: None, ..set });
    assert_eq!(corrected(without), (rad_s(0.5), true, vec![]));
}

/// The answer of a node with three axes to a command, what it says of itself, and what it sends.
fn asked(command: Command) -> (Answer, Capabilities, Received) {
    let plan = SensorPlan::new(PeriodNs(10_000_000), &ACCELEROMETER, i16::MAX.into());
    let steps = (0..6).map(|_| Ok((0, vec![Counts([0, 0, 16384]); 16])));
    let received = run_asked(Some(command), None, &[plan], steps);
    let hello = received.hello.expect("a Hello");
    let [answer] = received.answers[..] else { panic!("{:?}", received.answers) };
    (answer, hello.capabilities, received)
}

const FUNCTIONS: [(Command, Capabilities); 4] = [
    (Command::GetParameters, Capabilities::CORRECTION),
    (Command::SetParameters(SetBytes::NONE), Capabilities::CORRECTION),
    (Command::SetKey(DeviceKey::new([1; 32])), Capabilities::AUTHENTICATION),
    (Command::SetLineRate { baud: 9600 }, Capabilities::LINE_RATES),
];

#[cfg(not(any(feature = "correction", feature = "store")))]
#[test]
fn a_node_without_features_streams_and_refuses_what_it_lacks() {
    for (command, function) in FUNCTIONS {
        let (answer, capabilities, received) = asked(command);
        assert_eq!(answer, Answer::Refused(Refusal::NotSupported), "{command:?}");
        assert!(!capabilities.offers(function), "{command:?}");
        assert_eq!(received.samples(0, Stream::Raw).0, [[0, 0, 16384]; 96]);
        assert!(received.samples(0, Stream::Corrected).0.is_empty());
    }
    let raw = |streams: Streams| Streams { corrected: false, navigation: false, ..streams };
    let default = Settings::default();
    let nearest =
        Settings { cable: raw(default.cable), wireless: raw(default.wireless), ..default };
    let refused = Answer::Refused(Refusal::UnsupportedSettings { nearest });
    assert_eq!(asked(Command::SetSettings(default)).0, refused);
    let accepted = Answer::Accepted(Payload::Settings(nearest));
    assert_eq!(asked(Command::SetSettings(nearest)).0, accepted);
}

#[cfg(feature = "full")]
#[test]
fn a_full_node_refuses_no_function() {
    for (command, function) in FUNCTIONS {
        let (answer, capabilities, _) = asked(command);
        assert_ne!(answer, Answer::Refused(Refusal::NotSupported), "{command:?}");
        assert!(capabilities.contains(Capabilities::LISTED) && capabilities.offers(function));
    }
}
