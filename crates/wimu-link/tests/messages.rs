//! Messages and what they carry.

use proptest::prelude::*;
use wimu_integrator::{
    Config, Flags, Integrator, Phase, RotationState, Run, Segment, State, Window,
};
use wimu_link::message::{
    ARITHMETIC_REVISION, Answer, BusFault, Command, Epoch, EpochGyroscope, EpochReason, Event,
    MessageError, Navigation, Payload, Refusal, Reply, Request, SetBytes, Settings, Signature,
    Telemetry,
};
use wimu_link::{Deframer, MAX_FRAME, batch};
use wimu_model::{
    Alignment, ErrorModel, ErrorTerms, GyroscopeModel, GyroscopeParameters, GyroscopeTerms,
    ParameterSet, PeriodNs, Sensitivity, SpecificForceQ16,
};

fn body_of(
    encode: impl FnOnce(&mut [u8]) -> Result<usize, wimu_link::frame::EncodeError>,
) -> Vec<u8> {
    let mut line = [0; MAX_FRAME];
    let length = encode(&mut line).unwrap();
    let mut deframer = Deframer::new();
    line[..length]
        .iter()
        .find_map(|&byte| Some(deframer.push(byte)?.unwrap().body.to_vec()))
        .unwrap()
}

fn calibrated() -> ParameterSet {
    ParameterSet {
        model: ErrorModel::new(ErrorTerms {
            bias_mps2: [0.1, -0.2, 0.3],
            matrix: [[1.01, 0.02, -0.0], [0.0, 0.99, 0.03], [0.01, 0.0, 1.0]],
            nonlinearity: [1e-5, 0.0, -1e-5],
            ..ErrorTerms::default()
        })
        .unwrap(),
        alignment: Alignment::from_quaternion([0.7, 0.1, -0.3, 0.2]).unwrap(),
        gyroscope: Some(gyroscope()),
        ..ParameterSet::uncalibrated(4, Sensitivity::from_lsb_per_g(8192.0).unwrap())
    }
}

fn gyroscope() -> GyroscopeParameters {
    let terms = GyroscopeTerms {
        bias_rad_s: [0.1, -0.02, 0.003],
        g_sensitivity: [[1e-4; 3]; 3],
        ..GyroscopeTerms::default()
    };
    let model = GyroscopeModel::new(terms).unwrap();
    GyroscopeParameters::new(2000, 0.00122, model, Some([0.001; 12])).unwrap()
}

/// Every number as long as it gets on the wire.
fn longest_epoch() -> Epoch {
    let far = [i64::MIN; 3];
    let wide = [i32::MIN; 3];
    let segment =
        Segment { steps: u32::MAX, velocity_sum: far, position_sum: far, previous: Some(wide) };
    Epoch {
        reason: EpochReason::Parameters,
        number: 255,
        sequence: u32::MAX,
        time_us: u64::MAX,
        period_ns: u32::MAX,
        range_g: u8::MAX,
        sensitivity_lsb_per_g: f64::MAX,
        full_scale: i32::MIN,
        parameters: u32::MAX,
        temperature_centi_c: Some(i16::MIN),
        revision: ARITHMETIC_REVISION,
        state: State {
            config: Config { period: PeriodNs(u32::MAX), zupt: true, gravity_um_s2: u32::MAX },
            phase: Phase::Moving,
            flags: Flags(u8::MAX),
            rest_mean: far,
            east: wide,
            base_position_nm: far,
            base_velocity_nmps: far,
            base_since_rest_ns: u64::MAX,
            segment,
            window: Window {
                start: segment,
                samples: u16::MAX,
                reference: wide,
                sum: wide,
                squares: u64::MAX,
            },
            run: Some(Run { windows: u16::MAX, sum: far, latest: far, start: segment }),
            heading_sd_mrad: Some(u16::MAX),
            rotation: Some(RotationState {
                quaternion: [i64::MIN; 4],
                previous: Some(wide),
                remainder: [u32::MAX; 3],
                bias: wide,
                window: far,
                sum: far,
                latest: far,
            }),
        },
        sensor: batch::MAX_SENSOR,
        gyroscope: Some(EpochGyroscope { rad_s_per_lsb: f64::MAX, full_scale: i32::MIN }),
        tag: Signature::new(&[0xff; Signature::MAX]).unwrap(),
    }
}

#[test]
fn the_longest_epoch_fits_a_frame() {
    let telemetry = Telemetry::Epoch(longest_epoch());
    let body = body_of(|line| telemetry.encode(line));
    assert_eq!(Telemetry::decode(&body), Ok(telemetry));
}

#[test]
fn the_longest_reply_fits_a_frame() {
    let reply = Reply {
        session: u32::MAX,
        id: u32::MAX,
        signature: Signature::new(&[0xff; 8]).unwrap(),
        answer: Answer::Accepted(Payload::Parameters(SetBytes::new(&[0xff; 256]).unwrap())),
    };
    let body = body_of(|line| reply.encode(line));
    assert_eq!(Reply::decode(&body), Ok(reply));
}

#[test]
fn an_integrator_goes_on_from_its_state_on_the_wire() {
    let mut device = Integrator::new(Config::new(PeriodNs(10_000_000)).unwrap());
    let force = |k: i32| SpecificForceQ16([k * 37 % 600, -k * 91 % 500, 642_688 + k * 17 % 400]);
    for k in 0..1500 {
        device.step(force(k), false);
        if k % 97 == 0 {
            let epoch = Epoch { state: device.state(), ..longest_epoch() };
            let body = body_of(|line| <Telemetry>::Epoch(epoch).encode(line));
            let Ok(Telemetry::Epoch(epoch)) = Telemetry::decode(&body) else {
                panic!("no epoch");
            };
            let mut host = Integrator::from_state(epoch.state).unwrap();
            assert_eq!(host.state(), device.state());
            let mut ahead = Integrator::from_state(device.state()).unwrap();
            for later in k..k + 300 {
                host.step(force(3 * later), false);
                ahead.step(force(3 * later), false);
            }
            assert_eq!(
                Navigation::new(9, &host.navigation()),
                Navigation::new(9, &ahead.navigation())
            );
        }
    }
}

#[test]
fn the_longest_parameter_set_fits_a_signed_request() {
    let request = Request {
        session: u32::MAX,
        id: u32::MAX,
        signature: Signature::new(&[0xff; 8]).unwrap(),
        command: Command::SetParameters(SetBytes::new(&[0xff; 256]).unwrap()),
    };
    let body = body_of(|line| request.encode(line));
    assert_eq!(Request::decode(&body), Ok(request));
    assert!(body.len() <= 278, "{}", body.len());
}

#[test]
fn unknown_missing_and_left_over_bytes_are_told_apart() {
    let event = Telemetry::Event { time_us: 5, event: Event::SensorLost(BusFault::NoAnswer) };
    let body = body_of(|line| event.encode(line));
    assert_eq!(body, [6, 5, 0, 0]);
    assert_eq!(Telemetry::decode(&body), Ok(event));
    assert_eq!(Telemetry::decode(&body[..3]), Err(MessageError::TooShort));
    assert_eq!(Telemetry::decode(&[99]), Err(MessageError::Malformed));
    assert_eq!(Telemetry::decode(&[0, 1, 99]), Err(MessageError::TooShort));
    assert_eq!(Request::decode(&[1, 1, 0, 5, 7]), Err(MessageError::TooLong { extra: 1 }));
    // A signature of nine bytes.
    let mut request = vec![1, 1, 9];
    request.extend([0; 10]);
    assert_eq!(Request::decode(&request), Err(MessageError::Malformed));
    assert_eq!(Signature::new(&[0; 9]), None);
    // A set of 257 bytes.
    let mut request = vec![1, 1, 0, 1, 0x81, 2];
    request.extend([0; 257]);
    assert_eq!(Request::decode(&request), Err(MessageError::Malformed));
}

#[test]
fn refusals_say_what_to_do() {
    let nearest = Settings::default();
    for (refusal, word) in [
        (Refusal::KeyNeeded, "run `wimu device key set` once over the cable"),
        (Refusal::Locked, "cable"),
        (Refusal::StoreFailed, "try again"),
        (Refusal::UnsupportedSettings { nearest }, "±2 g at 100 Hz"),
        (Refusal::WrongRange { parameters_g: 4, device_g: 2 }, "±4 g"),
    ] {
        assert!(refusal.to_string().contains(word), "{refusal}");
    }
}

fn segment() -> impl Strategy<Value = Segment> {
    (any::<u32>(), any::<[i64; 3]>(), any::<[i64; 3]>(), any::<Option<[i32; 3]>>()).prop_map(
        |(steps, velocity_sum, position_sum, previous)| Segment {
            steps,
            velocity_sum,
            position_sum,
            previous,
        },
    )
}

proptest! {
    #[test]
    fn any_state_travels_and_becomes_the_integrators(
        segments in [segment(), segment(), segment()],
        sums in any::<[[i64; 3]; 5]>(),
        axes in any::<[[i32; 3]; 3]>(),
        words in any::<[u32; 4]>(),
        has_run: bool,
    ) {
        let [segment, start, run] = segments;
        let state = State {
            config: Config { period: PeriodNs(words[0]), zupt: words[1] % 2 == 0, gravity_um_s2: words[2] },
            phase: [Phase::Searching, Phase::Resting, Phase::Moving][words[3] as usize % 3],
            flags: Flags(words[3] as u8),
            rest_mean: sums[0],
            east: axes[0],
            base_position_nm: sums[1],
            base_velocity_nmps: sums[2],
            base_since_rest_ns: u64::from(words[1]) << 20,
            segment,
            window: Window {
                start,
                samples: words[0] as u16,
                reference: axes[1],
                sum: axes[2],
                squares: u64::from(words[2]) << 16,
            },
            run: has_run.then_some(Run {
                windows: words[2] as u16,
                sum: sums[3],
                latest: sums[4],
                start: run,
            }),
            heading_sd_mrad: has_run.then_some(words[0] as u16),
            rotation: (!has_run).then_some(RotationState {
                quaternion: [i64::MIN, sums[0][0], sums[1][1], sums[2][2]],
                previous: has_run.then_some(axes[0]),
                remainder: [words[0], words[1], words[2]],
                bias: axes[1],
                window: sums[3],
                sum: sums[4],
                latest: sums[0],
            }),
        };
        let telemetry = Telemetry::Epoch(Epoch { state, ..longest_epoch() });
        let body = body_of(|line| telemetry.encode(line));
        prop_assert_eq!(Telemetry::decode(&body), Ok(telemetry));
    }
}

/// What every revision computes is fixed: whoever changes a bit of it needs another revision, and
/// another number here.
#[test]
fn the_arithmetic_is_that_of_its_revision() {
    let set = calibrated();
    let corrector = wimu_model::Corrector::compile(&set, None).unwrap();
    let mut integrator = Integrator::new(Config::new(wimu_model::PeriodNs(2_500_000)).unwrap());
    let mut state = 1_u32;
    let mut noise = |bits: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> (32 - bits)) as i16
    };
    let crc = crc::Crc::<u64>::new(&crc::CRC_64_XZ);
    let mut digest = crc.digest();
    for step in 0..4000_i32 {
        let push = if (1500..1700).contains(&step) { 900 } else { 0 };
        let counts = wimu_model::Counts([push + noise(4), noise(4), 8192 + noise(4)]);
        let force = corrector.correct(counts);
        integrator.step(force, false);
        for axis in force.0 {
            digest.update(&axis.to_le_bytes());
        }
        let out = integrator.navigation();
        for value in out.position.0.into_iter().chain(out.velocity.0) {
            digest.update(&value.to_le_bytes());
        }
    }
    assert!(
        integrator.navigation().position.0[0].abs() > 1_000_000,
        "{:?}",
        integrator.navigation()
    );
    let computed = (ARITHMETIC_REVISION, digest.finalize());
    assert_eq!(computed, (3, 0x9b29cf70c8afd942));
}

/// The same with a gyroscope, and of wide counts.
#[test]
fn the_arithmetic_of_six_axes_is_that_of_its_revision() {
    use wimu_model::{CompiledSet, Corrector, Counts, GyroscopeModel, ParameterId};
    let corrector = Corrector::compile(&calibrated(), None).unwrap();
    let model = GyroscopeModel::new(wimu_model::GyroscopeTerms {
        bias_rad_s: [0.02, -0.01, 0.005],
        matrix: [[1.02, 0.01, 0.0], [0.0, 0.98, -0.02], [0.01, 0.0, 1.01]],
        g_sensitivity: [[0.001, 0.0, -0.0005], [0.0, 0.002, 0.0], [0.0, 0.0, 0.001]],
        ..Default::default()
    });
    let gyroscope = GyroscopeParameters::new(2000, 0.001_22, model.unwrap(), None).unwrap();
    let uncalibrated = ParameterSet::uncalibrated(4, Sensitivity::from_lsb_per_g(8192.0).unwrap());
    let set = ParameterSet { gyroscope: Some(gyroscope), ..uncalibrated };
    let set = CompiledSet::compile(&set, ParameterId(1), 0).unwrap();
    let gyroscope = set.gyroscope(None).unwrap();
    let mut integrator = Integrator::new(Config::new(wimu_model::PeriodNs(2_500_000)).unwrap());
    let mut state = 1_u32;
    let mut noise = |bits: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> (32 - bits)) as i16
    };
    let crc = crc::Crc::<u64>::new(&crc::CRC_64_XZ);
    let mut digest = crc.digest();
    for step in 0..4000_i32 {
        let moving = (1500..1700).contains(&step);
        let (push, turn) = if moving { (900, 1000) } else { (0, 0) };
        let counts = Counts([push + noise(4), noise(4), 8192 + noise(4)]);
        let rates = Counts([noise(3), turn + noise(3), -2 * turn + noise(3)]);
        let force = corrector.correct(counts);
        let rate = gyroscope.correct(rates, force);
        integrator.step_inertial(force, rate, wimu_integrator::Saturation::default());
        let wide = wimu_model::WideCounts(rates.0.map(|c| i32::from(c) << 4));
        let wide = [corrector.correct_wide(wide).0, gyroscope.correct_wide(wide, force).0];
        let out = integrator.navigation();
        let attitude = out.attitude.unwrap_or_default();
        for axis in [force.0, rate.0].iter().chain(&wide).flatten().chain(&attitude) {
            digest.update(&axis.to_le_bytes());
        }
        for value in out.position.0.into_iter().chain(out.velocity.0) {
            digest.update(&value.to_le_bytes());
        }
    }
    let turned = integrator.navigation().attitude.unwrap();
    assert!(turned[0].abs() < 1_020_000_000, "{turned:?}");
    let computed = (ARITHMETIC_REVISION, digest.finalize());
    assert_eq!(computed, (3, 0xc7db2e3d6111a4dc));
}
