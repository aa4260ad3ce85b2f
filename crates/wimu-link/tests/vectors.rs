//! Golden vectors: whole frames in `tests/vectors/v3`, one a line in hex, each under a comment that
//! says what it is. They keep the wire from changing unnoticed, and other hosts can be tested on
//! them.
//!
//! Frozen ones never change: `WRITE_VECTORS=1 cargo test -p wimu-link --test all vectors` adds frames that
//! are new, and changes none.

use std::fmt::Write as _;
use std::num::NonZeroU8;
use std::path::PathBuf;

use wimu_integrator::{Config, Flags, Phase, RotationState, Run, Segment, State, Window};
use wimu_link::auth::{DeviceKey, KeyId, KeyState, Lock};
use wimu_link::batch::Layout;
use wimu_link::frame::{Deframer, EncodeError};
use wimu_link::hello::{
    Capabilities, Fault, LinkRole, Part, ResetReason, WriteAccess, board, sensor,
};
use wimu_link::message::{
    Answer, Attitude, BusFault, Command, Environment, Epoch, EpochGyroscope, EpochReason, Event,
    LinkStatus, Navigation, Payload, Refusal, Reply, Request, Resolution, SensorStatus, SetBytes,
    Settings, Signature, StackStatus, Status, Streams, Telemetry,
};
use wimu_link::tag::{Tag, Tagger};
use wimu_link::{Batch, Hello, Kind, MAX_FRAME, WIRE_VERSION, WhoAreYou, batch};
use wimu_model::checksum::crc_32c;
use wimu_model::{
    CompiledSet, Counts, DeviceTimeUs, ErrorModel, ErrorTerms, GyroscopeModel, GyroscopeParameters,
    GyroscopeTemperatureTerms, GyroscopeTerms, ParameterId, ParameterSet, PeriodNs, Sensitivity,
    SetError, SpecificForceQ16, TemperatureTerms,
};

/// A file of frames, each with what it is.
pub struct Vectors {
    name: &'static str,
    kind: Kind,
    frames: Vec<(String, Vec<u8>)>,
}

impl Vectors {
    pub fn new(name: &'static str, kind: Kind) -> Self {
        Self { name, kind, frames: Vec::new() }
    }

    pub fn add(
        &mut self,
        what: impl Into<String>,
        encode: impl FnOnce(&mut [u8]) -> Result<usize, EncodeError>,
    ) {
        let mut line = [0; MAX_FRAME];
        let length = encode(&mut line).unwrap();
        self.frames.push((what.into(), line[..length].to_vec()));
    }

    /// Makes sure that the file has each frame, and none that is not made any more; returns their
    /// bodies.
    pub fn check(self) -> Vec<Vec<u8>> {
        let path = folder().join(self.name).with_extension("hex");
        let mut golden = std::fs::read_to_string(&path).unwrap_or_default();
        let made: Vec<String> = self.frames.iter().map(|(_, frame)| hex(frame)).collect();
        for ((what, _), digits) in self.frames.iter().zip(&made) {
            let is_new = !frames_of(&golden).any(|kept| kept == digits);
            if is_new && std::env::var_os("WRITE_VECTORS").is_some() {
                writeln!(golden, "# {what}\n{digits}").unwrap();
                std::fs::write(&path, &golden).unwrap();
            } else {
                assert!(!is_new, "{} has no {what}: {digits}", path.display());
            }
        }
        for kept in frames_of(&golden) {
            assert!(made.iter().any(|digits| digits == kept), "no more: {kept}");
        }
        let body = |(_, frame): &(String, Vec<u8>)| {
            let (kind, body) = opened(frame);
            assert_eq!(kind, self.kind);
            body
        };
        self.frames.iter().map(body).collect()
    }
}

fn hex(frame: &[u8]) -> String {
    frame.iter().fold(String::new(), |mut hex, byte| {
        write!(hex, "{byte:02x}").unwrap();
        hex
    })
}

fn frames_of(text: &str) -> impl Iterator<Item = &str> {
    text.lines().filter(|line| !line.starts_with('#'))
}

/// Kind and body of a frame.
fn opened(frame: &[u8]) -> (Kind, Vec<u8>) {
    let mut deframer = Deframer::new();
    let mut bytes = frame;
    let frame = deframer.next(&mut bytes).unwrap().unwrap();
    assert_eq!(frame.version, WIRE_VERSION);
    (frame.kind, frame.body.to_vec())
}

/// The frozen frames: file, number of its first frames, and the CRC-32C of their hex digits.
const FROZEN: [(&str, usize, u32); 7] = [
    ("batch", 9, 0x8599_d8e6),
    ("hello", 3, 0xb447_7e94),
    ("inertial", 10, 0x72dc_3eb1),
    ("reply", 29, 0xdb86_2345),
    ("request", 12, 0x4dbe_c52e),
    ("telemetry", 35, 0x1dd9_d5c3),
    ("who_are_you", 1, 0x0d6e_92fb),
];

#[test]
fn what_was_frozen_is_what_it_was_and_is_read() {
    for (name, count, crc) in FROZEN {
        let path = folder().join(name).with_extension("hex");
        let text = std::fs::read_to_string(&path).unwrap();
        let frozen: Vec<&str> = frames_of(&text).take(count).collect();
        assert_eq!(frozen.len(), count, "{name}: frames are gone");
        let found = crc_32c(frozen.concat().as_bytes());
        assert_eq!(found, crc, "{name}: {found:#x}");
        for digits in frozen {
            is_read(digits);
        }
    }
}

/// Reads a frozen frame. Encoded again, it may have gained fields at its end.
fn is_read(digits: &str) {
    let (kind, body) = opened(&bytes_of(digits));
    let mut line = [0; MAX_FRAME];
    let length = match kind {
        Kind::Hello => Hello::decode(&body).unwrap().encode(&mut line),
        Kind::WhoAreYou => WhoAreYou::decode(&body).unwrap().encode(&mut line),
        Kind::Telemetry => Telemetry::decode(&body).unwrap().encode(&mut line),
        Kind::Request => Request::decode(&body).unwrap().encode(&mut line),
        Kind::Reply => Reply::decode(&body).unwrap().encode(&mut line),
        // Others may pack the same samples in another way.
        _ => {
            Batch::decode(kind, &body).unwrap();
            return;
        }
    };
    let (_, again) = opened(&line[..length.unwrap()]);
    assert!(again.starts_with(&body), "{digits}");
}

fn bytes_of(digits: &str) -> Vec<u8> {
    (0..digits.len() / 2)
        .map(|at| u8::from_str_radix(&digits[2 * at..2 * at + 2], 16).unwrap())
        .collect()
}

fn folder() -> PathBuf {
    let vectors = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/vectors");
    vectors.join(format!("v{WIRE_VERSION}"))
}

#[test]
fn every_file_is_checked() {
    let mut names: Vec<_> = std::fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(
        names,
        [
            "batch.hex",
            "hello.hex",
            "inertial.hex",
            "reply.hex",
            "request.hex",
            "telemetry.hex",
            "who_are_you.hex"
        ]
    );
}

#[test]
fn hello_is_as_it_was() {
    let hellos = [
        Hello::new(LinkRole::Cable),
        Hello {
            access: WriteAccess::Open,
            device_id: 0x0123_4567_89ab_cdef,
            boot_count: 7,
            capabilities: Capabilities::ACCELEROMETER
                .with(Capabilities::MAGNETOMETER)
                .with(Capabilities::TEMPERATURE),
            parameter_id: ParameterId(0xdead_beef),
            uptime_us: 0x0102_0304_0506,
            firmware: [1, 256, 3],
            reset_reason: ResetReason::Watchdog,
            sensitivity_known: true,
            board: Part::new(board::MICROBIT_V2, "micro:bit v2"),
            sensor: Part::new(sensor::LSM303AGR, "LSM303AGR"),
            ..Hello::new(LinkRole::Wireless)
        },
        Hello {
            reset_reason: ResetReason::Fault,
            fault: Some(Fault::processor("sampler/mod.rs", 300)),
            safe_mode: true,
            ..Hello::new(LinkRole::Cable)
        },
    ];
    let mut vectors = Vectors::new("hello", Kind::Hello);
    for hello in &hellos {
        vectors.add(format!("{hello:?}"), |line| hello.encode(line));
    }
    for (body, hello) in vectors.check().iter().zip(hellos) {
        assert_eq!(Hello::decode(body), Ok(hello));
    }
}

#[test]
fn who_are_you_is_as_it_was() {
    let mut vectors = Vectors::new("who_are_you", Kind::WhoAreYou);
    vectors.add(format!("WhoAreYou {{ wire_version: {WIRE_VERSION} }}"), |line| {
        WhoAreYou::default().encode(line)
    });
    for body in vectors.check() {
        assert_eq!(WhoAreYou::decode(&body), Ok(WhoAreYou::default()));
    }
}

#[test]
fn batches_are_as_they_were() {
    let rest: Vec<_> = (0..16_i16)
        .map(|k| Counts([16 * (k * 7 % 5), 16 * (k * 5 % 3 - 60), 16384 + 16 * (k * 11 % 4)]))
        .collect();
    let slope: Vec<_> = (0..8_i16).map(|k| Counts([300 * k, -41 * k * k, 9 - k % 2])).collect();
    let mut shock = rest.clone();
    shock[9] = Counts([32767, -32768, 1]);
    let wild = [[-32768, 32767, 1], [32767, -32768, -1]].map(Counts);
    let one = [Counts([0, -1, 16384])];
    let still = [Counts([0, 0, 16384]); 4];
    let mut vectors = Vectors::new("batch", Kind::Batch);
    let mut raw = Vec::new();
    for (what, samples) in [
        ("at rest, 12 bits left-justified", &rest[..]),
        ("X straight, Y bent, Z flat", &slope),
        ("at rest with a shock", &shock),
        ("nothing to predict", &wild),
        ("one sample", &one),
        ("no noise", &still),
    ] {
        let axes: Vec<_> = samples.iter().map(|sample| sample.0).collect();
        vectors.add(
            format!("raw, sequence 0x12345678, time 0x9abcdef012 µs, {what}: {axes:?}"),
            |line| batch::encode(0x1234_5678, DeviceTimeUs(0x9a_bcde_f012), samples, line),
        );
        raw.push(samples);
    }
    let forces: Vec<_> = (0..5_i32)
        .map(|k| SpecificForceQ16([k * k * 4001, -70_000 + k * 13, 642_688 - k]))
        .collect();
    let extremes = [[i32::MIN, i32::MAX, 0], [i32::MAX, i32::MIN, -1]].map(SpecificForceQ16);
    let mut corrected = Vec::new();
    for samples in [&forces[..], &extremes] {
        let axes: Vec<_> = samples.iter().map(|sample| sample.0).collect();
        vectors.add(format!("corrected, sequence 1, time 2 µs: {axes:?}"), |line| {
            batch::encode(1, DeviceTimeUs(2), samples, line)
        });
        corrected.push(samples);
    }
    let fourth = [Counts([16, -32, 16384]), Counts([32, -16, 16400])];
    let axes: Vec<_> = fourth.iter().map(|sample| sample.0).collect();
    vectors.add(format!("raw, every fourth, sequence 8, time 80000 µs: {axes:?}"), |line| {
        let every = NonZeroU8::new(4).unwrap();
        batch::encode_with(Layout { sensor: 0, every }, 8, DeviceTimeUs(80_000), &fourth, line)
    });
    let mut bodies = vectors.check();
    let decimated = Batch::decode(Kind::Batch, &bodies.pop().unwrap()).unwrap();
    assert_eq!((decimated.every(), decimated.sequence_low()), (4, 8));
    assert!(decimated.counts().eq(fourth));
    let (raw_bodies, corrected_bodies) = bodies.split_at(raw.len());
    for (body, samples) in raw_bodies.iter().zip(raw) {
        let batch = Batch::decode(Kind::Batch, body).unwrap();
        assert_eq!((batch.sequence_low(), batch.time_low()), (0x5678, 0xde_f012));
        assert!(batch.counts().eq(samples.iter().copied()));
        assert_eq!(batch.every(), 1);
    }
    for (body, samples) in corrected_bodies.iter().zip(corrected) {
        let batch = Batch::decode(Kind::Batch, body).unwrap();
        assert!(batch.specific_forces().eq(samples.iter().copied()));
    }
}

/// With every part of a device with a gyroscope.
fn set() -> SetBytes {
    let model = ErrorModel::new(ErrorTerms {
        bias_mps2: [0.125, -0.25, 0.5],
        matrix: [[1.0, 0.01, 0.0], [0.0, 0.99, 0.0], [0.02, 0.0, 1.01]],
        temperature: TemperatureTerms {
            reference_c: 25.0,
            bias_mps2_per_k: [0.001, 0.002, 0.003],
            bias_mps2_per_k2: [1e-5, 2e-5, 3e-5],
            scale_per_k: [1e-4, 2e-4, 3e-4],
        },
        nonlinearity: [1e-6, 2e-6, 3e-6],
    });
    let gyroscope = GyroscopeModel::new(GyroscopeTerms {
        bias_rad_s: [0.01, -0.02, 0.03],
        matrix: [[1.0, 0.01, 0.0], [0.0, 0.99, 0.0], [0.02, 0.0, 1.01]],
        g_sensitivity: [[1e-5, 0.0, 0.0], [0.0, 2e-5, 0.0], [0.0, 0.0, 3e-5]],
        temperature: GyroscopeTemperatureTerms {
            reference_c: 30.0,
            bias_rad_s_per_k: [1e-4, 2e-4, 3e-4],
            scale_per_k: [1e-5, 2e-5, 3e-5],
        },
    });
    let gyroscope = GyroscopeParameters::new(500, 0.000_305, gyroscope.unwrap(), None);
    let source = ParameterSet {
        model: model.unwrap(),
        gyroscope: Some(gyroscope.unwrap()),
        ..ParameterSet::uncalibrated(4, Sensitivity::from_lsb_per_g(8192.0).unwrap())
    };
    let set = CompiledSet::compile(&source, ParameterId(0x1234_5678), 0x0123_4567_89ab_cdef);
    SetBytes::from(&set.unwrap())
}

fn settings() -> Settings {
    Settings {
        range_g: 8,
        rate_hz: 400,
        resolution: Resolution::Normal,
        zupt: false,
        gravity_um_s2: 9_818_000,
        cable: Streams::default(),
        wireless: Streams {
            raw: false,
            corrected: true,
            navigation: true,
            environment: false,
            batch: 32,
            every: 4,
        },
    }
}

fn status() -> Status {
    Status {
        uptime_us: 3_600_000_000,
        cable: Some(LinkStatus {
            frames_sent: 1,
            bytes_sent: 1 << 33,
            telemetry_shed: 2,
            frames_damaged: 3,
            requests_repeated: 4,
        }),
        wireless: None,
        sensor: SensorStatus { samples: 360_000, missed: 4, overruns: 5, bus_errors: 6 },
        measured_period_ns: Some(10_012_345),
        jitter_ns: Some(1_250),
        stack: None,
    }
}

fn status_with_stack() -> Status {
    Status { stack: Some(StackStatus { size: 100_000, used: 2_345 }), ..status() }
}

fn epoch(reason: EpochReason) -> Epoch {
    let segment = Segment {
        steps: 12,
        velocity_sum: [-100, 200, -300],
        position_sum: [1 << 40, -(1 << 41), 0],
        previous: Some([-5, 6, -7]),
    };
    Epoch {
        reason,
        number: 200,
        sequence: 360_000,
        time_us: 3_600_000_000,
        period_ns: 10_012_345,
        range_g: 2,
        sensitivity_lsb_per_g: 16384.0,
        full_scale: 32752,
        parameters: 0xdead_beef,
        temperature_centi_c: Some(-512),
        state: State {
            config: Config { period: PeriodNs(10_012_345), zupt: true, gravity_um_s2: 9_806_650 },
            phase: Phase::Moving,
            flags: Flags(2),
            rest_mean: [1, -2, 42_119_196_999],
            east: [1 << 30, 0, -1],
            base_position_nm: [1_000_000_000, -2, 3],
            base_velocity_nmps: [4, -5, 6],
            base_since_rest_ns: 7_000_000_000,
            segment,
            window: Window {
                start: Segment { previous: None, ..segment },
                samples: 300,
                reference: [1, 2, -3],
                sum: [4, -5, 6],
                squares: 7,
            },
            run: Some(Run { windows: 2, sum: [8, 9, -10], latest: [11, -12, 13], start: segment }),
            heading_sd_mrad: Some(37),
            rotation: None,
        },
        ..Epoch::default()
    }
}

/// The tag of an interval of two frames.
fn tag() -> Tag {
    let lock = Lock {
        key: KeyState::Set(DeviceKey::new(core::array::from_fn(|at| at as u8))),
        device_id: 0x0123_4567_89ab_cdef,
        boot_count: Some(300),
        ..Lock::default()
    };
    let mut tagger = Tagger::new(LinkRole::Wireless);
    let environment = [3, 0x34, 1, 1, 1, 5, 0xb9, 0xb6, 0xf8, 0xec, 0];
    assert_eq!(tagger.sent(&environment[..3], false, || lock), None);
    assert_eq!(tagger.sent(&environment[3..], true, || lock), None);
    // As an epoch begins.
    tagger.sent(&[2, 0x34, 9, 9, 9, 0], true, || lock).unwrap()
}

/// Against Python's `hmac` and `hashlib`.
#[test]
fn tags_are_those_of_an_independent_implementation() {
    let tag = tag();
    assert_eq!((tag.boot_count, tag.number, tag.frames), (300, 1, 2));
    let code = [0x64, 0x68, 0x80, 0x53, 0x2d, 0xff, 0x46, 0x29];
    assert_eq!((tag.key.to_string(), tag.code), ("2661c013".to_owned(), code));
}

#[test]
fn telemetry_is_as_it_was() {
    let mut messages: Vec<_> = [
        EpochReason::Start,
        EpochReason::Periodic,
        EpochReason::Gap,
        EpochReason::Stillness,
        EpochReason::Temperature,
        EpochReason::Settings,
        EpochReason::Parameters,
        EpochReason::Heading,
    ]
    .map(|reason| Telemetry::Epoch(epoch(reason)))
    .into();
    messages.extend([
        Telemetry::Epoch(Epoch {
            temperature_centi_c: None,
            state: State::default(),
            ..epoch(EpochReason::Start)
        }),
        Telemetry::Environment(Environment {
            time_us: 300,
            magnetic_field_nt: Some([-20_000, 3, 45_000]),
            temperature_centi_c: Some(2512),
        }),
        Telemetry::Environment(Environment::default()),
        Telemetry::Parameters(set()),
        Telemetry::Parameters(SetBytes::NONE),
        Telemetry::Settings(settings()),
        Telemetry::Status(status()),
        Telemetry::Status(status_with_stack()),
    ]);
    messages.extend([Phase::Searching, Phase::Resting, Phase::Moving].map(|phase| {
        Telemetry::Navigation(Navigation {
            sequence: 360_001,
            position_nm: [1_000_000_000, -1, 0],
            velocity_nmps: [-300_000_000, 64, -64],
            since_rest_ms: 1500,
            phase,
            flags: 20,
            heading_sd_mrad: (phase == Phase::Moving).then_some(300),
        })
    }));
    messages.extend(
        [
            Event::SensorLost(BusFault::NoAnswer),
            Event::SensorLost(BusFault::Transfer),
            Event::SensorLost(BusFault::Timeout),
            Event::SensorFound,
            Event::WrongSensor { expected: 0x33, found: 0x44 },
            Event::StoreUnreadable,
            Event::ParametersRejected(SetError::Checksum),
            Event::SettingsAdjusted,
            Event::Pause { longest_ms: 400 },
            Event::Marked { count: 300 },
            Event::CalibrationContradicted { residual_um_s2: -56_000, expected_um_s2: 9_000 },
            Event::GyroscopeLost(BusFault::Timeout),
        ]
        .map(|event| Telemetry::Event { time_us: 1_000_000, event }),
    );
    messages.extend([
        Telemetry::Epoch(Epoch {
            sensor: 3,
            gyroscope: Some(EpochGyroscope { rad_s_per_lsb: 0.001_25, full_scale: 524_287 }),
            tag: Signature::new(&[1, 2, 3, 4, 5, 6, 7, 8]).unwrap(),
            full_scale: 524_287,
            ..epoch(EpochReason::Periodic)
        }),
        Telemetry::Epoch(Epoch {
            gyroscope: Some(EpochGyroscope { rad_s_per_lsb: 0.001_25, full_scale: 32_767 }),
            state: State {
                rotation: Some(RotationState {
                    quaternion: [1 << 59, -1, 0, -(1 << 58)],
                    previous: Some([1_048_576, -2, 3]),
                    remainder: [u32::MAX, 0, 1],
                    bias: [91_506, -5, 6],
                    window: [7 << 40, -8, 9],
                    sum: [-10, 11 << 40, 12],
                    latest: [13, 14, -15],
                }),
                ..epoch(EpochReason::Periodic).state
            },
            ..epoch(EpochReason::Periodic)
        }),
        Telemetry::Attitude(Attitude {
            sequence: 360_001,
            quaternion: [1 << 30, -1, 0, -(1 << 29)],
        }),
    ]);
    messages.push(Telemetry::Tag(tag()));
    let mut vectors = Vectors::new("telemetry", Kind::Telemetry);
    for message in &messages {
        vectors.add(format!("{message:?}"), |line| message.encode(line));
    }
    for (body, message) in vectors.check().iter().zip(messages) {
        assert_eq!(Telemetry::decode(body), Ok(message));
    }
}

#[test]
fn requests_are_as_they_were() {
    let commands = [
        Command::GetParameters,
        Command::SetParameters(set()),
        Command::FactoryReset,
        Command::GetSettings,
        Command::SetSettings(settings()),
        Command::GetStatus,
        Command::SetLineRate { baud: 230_400 },
        Command::OpenSession,
        Command::GetKeyStatus,
        Command::SetKey(DeviceKey::new(core::array::from_fn(|at| at as u8))),
        Command::ForgetKey,
        Command::GetTime,
    ];
    let mut requests: Vec<_> = commands
        .into_iter()
        .map(|command| Request {
            session: 0x1234_5678,
            id: 200,
            signature: Signature::NONE,
            command,
        })
        .collect();
    requests[6].signature = Signature::new(&[1, 2, 3, 4, 5, 6, 7, 8]).unwrap();
    let mut vectors = Vectors::new("request", Kind::Request);
    for request in &requests {
        vectors.add(format!("{request:?}"), |line| request.encode(line));
    }
    for (body, request) in vectors.check().iter().zip(requests) {
        assert_eq!(Request::decode(body), Ok(request));
    }
}

#[test]
fn replies_are_as_they_were() {
    let mut answers: Vec<_> = [
        Payload::None,
        Payload::Parameters(set()),
        Payload::Settings(settings()),
        Payload::Status(status()),
        Payload::Status(status_with_stack()),
        Payload::Session { number: 300, nonce: core::array::from_fn(|at| at as u8) },
        Payload::KeyStatus { key: None },
        Payload::KeyStatus { key: Some(KeyId([0xde, 0xad, 0xbe, 0xef])) },
        Payload::Time { uptime_us: 90_000_000_000 },
    ]
    .map(Answer::Accepted)
    .into();
    answers.extend(
        [
            Refusal::KeyNeeded,
            Refusal::Locked,
            Refusal::WrongRange { parameters_g: 4, device_g: 2 },
            Refusal::UnsupportedSettings { nearest: settings() },
            Refusal::StoreFailed,
            Refusal::SensorFailed,
            Refusal::Stale,
            Refusal::FixedLineRate,
            Refusal::UnsupportedLineRate { nearest: 38_400 },
            Refusal::SignatureNeeded,
            Refusal::WrongSignature,
            Refusal::SessionEnded,
            Refusal::CableOnly,
            Refusal::NotSupported,
        ]
        .map(Answer::Refused),
    );
    answers.extend(
        [
            SetError::Length,
            SetError::Checksum,
            SetError::Format,
            SetError::Integers,
            SetError::Device,
        ]
        .map(|fault| Answer::Refused(Refusal::InvalidParameters(fault))),
    );
    answers.push(Answer::Unknown);
    let mut vectors = Vectors::new("reply", Kind::Reply);
    let replies: Vec<_> = answers
        .into_iter()
        .map(|answer| Reply { session: 0x1234_5678, id: 200, signature: Signature::NONE, answer })
        .collect();
    for reply in &replies {
        vectors.add(format!("{reply:?}"), |line| reply.encode(line));
    }
    for (body, reply) in vectors.check().iter().zip(replies) {
        assert_eq!(Reply::decode(body), Ok(reply));
    }
}
