//! Messages and what they carry.

use proptest::prelude::*;
use wimu_integrator::{Config, Integrator};
use wimu_link::frame::{self, MAX_RECORD};
use wimu_link::message::{
    ARITHMETIC_REVISION, Answer, BusFault, Command, EncodedParameters, Epoch, EpochGyroscope,
    EpochReason, Event, MessageError, Navigation, ParameterFault, ParametersPiece, Payload, Piece,
    Record, Refusal, Reply, Request, Settings, Signature, Telemetry, WireGyroscope,
    WireGyroscopeTerm, WireMagnetometer, WireMagnetometerFault, WireParameters, WirePhase,
    WireQuality, WireQualityFault, WireRotation, WireRun, WireSegment, WireState, WireTerm,
    WireWindow, parameter_id,
};
use wimu_link::{Deframer, MAX_FRAME, batch};
use wimu_model::{
    Alignment, CalibratedTemperature, CalibrationMethod, CalibrationQuality, CompileError,
    ErrorModel, ErrorTerms, GyroscopeModel, GyroscopeParameters, GyroscopeTerms, MagnetometerModel,
    MagnetometerRotation, MagnetometerTerms, ModelCovariance, ParameterId, ParameterSet, PeriodNs,
    QualityTerms, RotationCovariance, Sensitivity, SensorId, SpecificForceQ16, TermDeviations,
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

fn rotation_covariance() -> RotationCovariance {
    RotationCovariance::from_matrix(&[[4e-6, 1e-6, 0.0], [1e-6, 9e-6, 0.0], [0.0, 0.0, 1e-4]])
        .unwrap()
}

/// With everything that a set can hold, each number as long as it gets on the wire.
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
        alignment_covariance: Some(rotation_covariance()),
        quality: Some(
            CalibrationQuality::new(QualityTerms {
                method: CalibrationMethod::Updated,
                utc_s: Some(u64::MAX),
                temperature: Some(CalibratedTemperature {
                    mean_c: 25.0,
                    lowest_c: -10.0,
                    highest_c: 60.0,
                }),
                poses: u32::MAX,
                dof: u32::MAX,
                rms_mps2: 0.002,
                loo_rms_mps2: Some(0.003),
                condition: Some(2.5),
                covariance: ModelCovariance::from_matrix(&std::array::from_fn(|a| {
                    std::array::from_fn(|b| if a == b { 2e-6 } else { 1e-6 })
                }))
                .unwrap(),
                other_sd: TermDeviations { scale_per_k: [1e-5; 3], ..TermDeviations::default() },
            })
            .unwrap(),
        ),
        magnetometer: Some(
            MagnetometerModel::new(MagnetometerTerms {
                hard_iron_nt: [12_000.0, -3000.0, 800.0],
                hard_iron_sd_nt: [50.0; 3],
                soft_iron: [1.01, 0.98, 1.02, 0.01, -0.02, 0.03],
                soft_iron_sd: [0.001; 6],
                field_nt: 48_300.0,
                poses: u32::MAX,
                rms_nt: 120.0,
                loo_rms_nt: 140.0,
                condition: 3.0,
                to_accelerometer: Some(MagnetometerRotation {
                    rotation: Alignment::from_quaternion([0.9, 0.1, 0.2, -0.3]).unwrap(),
                    covariance: rotation_covariance(),
                    dip_rad: 1.15,
                    dip_rms_rad: 0.01,
                }),
            })
            .unwrap(),
        ),
        sensor: Some(SensorId(2)),
        sensor_index: 7,
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
        WireSegment { steps: u32::MAX, velocity_sum: far, position_sum: far, previous: Some(wide) };
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
        state: WireState {
            revision: ARITHMETIC_REVISION,
            period_ns: u32::MAX,
            zupt: true,
            gravity_um_s2: u32::MAX,
            phase: WirePhase::Moving,
            flags: u8::MAX,
            rest_mean: far,
            east: wide,
            base_position_nm: far,
            base_velocity_nmps: far,
            base_since_rest_ns: u64::MAX,
            segment,
            window: WireWindow {
                start: segment,
                samples: u16::MAX,
                reference: wide,
                sum: wide,
                squares: u64::MAX,
            },
            run: Some(WireRun { windows: u16::MAX, sum: far, latest: far, start: segment }),
            heading_sd_mrad: Some(u16::MAX),
            rotation: Some(WireRotation {
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
        answer: Answer::Accepted(Payload::Parameters(ParametersPiece {
            id: u32::MAX,
            offset: u16::MAX,
            total: u16::MAX,
            piece: Piece::new(&[0xff; Piece::MAX]).unwrap(),
        })),
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
            let epoch = Epoch { state: device.state().into(), ..longest_epoch() };
            let body = body_of(|line| <Telemetry>::Epoch(epoch).encode(line));
            let Ok(Telemetry::Epoch(epoch)) = Telemetry::decode(&body) else {
                panic!("no epoch");
            };
            let mut host = Integrator::from_state(epoch.state.into()).unwrap();
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
fn a_parameter_set_comes_back_bit_for_bit() {
    let set = calibrated();
    let wire = WireParameters::from(&set);
    let back = ParameterSet::try_from(&wire).unwrap();
    assert_eq!(back, set);
    assert_eq!(parameter_id(&back), parameter_id(&set));
    let bits = |set: &ParameterSet| set.alignment.quaternion().map(f64::to_bits);
    assert_eq!(bits(&back), bits(&set));
}

#[test]
fn the_longest_parameter_set_fits_a_record_and_its_pieces_fit_signed_requests() {
    let wire = WireParameters::from(&calibrated());
    let mut pieces = Vec::new();
    for command in wire.stage() {
        let request = Request {
            session: u32::MAX,
            id: u32::MAX,
            signature: Signature::new(&[0xff; 8]).unwrap(),
            command,
        };
        let body = body_of(|line| request.encode(line));
        assert_eq!(Request::decode(&body), Ok(request));
        assert!(body.len() <= 284, "{}", body.len());
        let Command::StageParameters { offset, total, piece } = command else {
            panic!("{command:?}");
        };
        assert_eq!(usize::from(offset), pieces.len());
        assert_eq!(usize::from(total), WireParameters::MAX);
        pieces.extend_from_slice(piece.as_bytes());
    }
    let mut bytes = [0; WireParameters::MAX];
    assert_eq!(wire.encode(&mut bytes), Ok(WireParameters::MAX));
    let encoded = EncodedParameters(&bytes);
    assert_eq!(encoded.decode(), Ok(wire));
    assert_eq!(encoded.id(), parameter_id(&calibrated()));
    assert_eq!(pieces, bytes);
    let mut record = [0; MAX_RECORD];
    let length = Record::encode_parameters(encoded, &mut record).unwrap();
    let opened = frame::open(&mut record[..length]).unwrap();
    assert_eq!(Record::decode(&record[..opened]), Ok(Record::Parameters(encoded)));
}

#[test]
fn a_set_may_end_before_its_later_fields() {
    let encoded = |wire: &WireParameters| {
        let mut bytes = [0; WireParameters::MAX];
        let length = wire.encode(&mut bytes).unwrap();
        bytes[..length].to_vec()
    };
    let whole = WireParameters::from(&calibrated());
    let of_version_1 = WireParameters { sensor_index: 0, gyroscope: None, ..whole };
    let unknown_sensor = WireParameters { sensor: None, ..whole };
    let oldest = WireParameters { sensor: None, ..of_version_1 };
    for set in [whole, of_version_1, unknown_sensor, oldest] {
        assert_eq!(WireParameters::decode(&encoded(&set)), Ok(set));
    }
    // Version 1 has the same bytes.
    let [bytes, of_version_1] = [whole, of_version_1].map(|set| encoded(&set));
    assert_eq!(of_version_1, bytes[..of_version_1.len()]);
    // Truncated anywhere else, or with unknown fields, it is refused.
    for length in 0..bytes.len() {
        let cut = WireParameters::decode(&bytes[..length]);
        let ends = [of_version_1.len(), of_version_1.len() - 2].contains(&length);
        assert_eq!(cut.is_ok(), ends, "{length}");
    }
    let newer = [bytes, vec![1, 2, 3]].concat();
    let fault = ParameterFault::from(WireParameters::decode(&newer).unwrap_err());
    assert_eq!(fault, ParameterFault::Unknown { bytes: 3 });
    assert!(fault.to_string().ends_with("; update the firmware"));
}

#[test]
fn an_id_tells_sets_apart_and_is_never_that_of_none() {
    let set = calibrated();
    let other = ParameterSet { range_g: 2, ..set };
    assert_ne!(parameter_id(&set), parameter_id(&other));
    assert_ne!(parameter_id(&set), ParameterId::UNCALIBRATED);
}

#[test]
fn invalid_parameters_name_the_fault() {
    let fault = |change: &dyn Fn(&mut WireParameters)| {
        let mut wire = WireParameters::from(&calibrated());
        change(&mut wire);
        ParameterSet::try_from(&wire).unwrap_err()
    };
    assert_eq!(
        fault(&|p| p.matrix[1][2] = f64::INFINITY),
        ParameterFault::NotFinite { term: WireTerm::Misalignment, axis: 1 }
    );
    assert_eq!(
        fault(&|p| p.bias_mps2[2] = -6.0).to_string(),
        "bias Z = -6 m/s² is outside -5 to 5 m/s²"
    );
    assert!(matches!(
        fault(&|p| p.matrix = [[0.5, 0.3, 0.3], [0.3, 0.5, 0.3], [0.3, 0.3, 0.5]]),
        ParameterFault::Singular(_)
    ));
    assert_eq!(fault(&|p| p.sensitivity_lsb_per_g = 0.0), ParameterFault::Sensitivity(0.0));
    assert!(matches!(fault(&|p| p.alignment_wxyz = [f64::NAN; 4]), ParameterFault::Alignment(_)));
    fn quality(wire: &mut WireParameters) -> &mut WireQuality {
        wire.quality.as_mut().unwrap()
    }
    fn gyroscope_of(wire: &mut WireParameters) -> &mut WireGyroscope {
        wire.gyroscope.as_mut().unwrap()
    }
    let beyond =
        |term, axis, value, low, high| ParameterFault::Gyroscope { term, axis, value, low, high };
    fn magnetometer(wire: &mut WireParameters) -> &mut WireMagnetometer {
        wire.magnetometer.as_mut().unwrap()
    }
    for (found, expected) in [
        (fault(&|p| p.alignment_factor = Some([f32::NAN; 6])), ParameterFault::Covariance),
        (
            fault(&|p| quality(p).covariance_factor[5][12] = f32::INFINITY),
            ParameterFault::Covariance,
        ),
        (
            fault(&|p| quality(p).temperature_c = Some([20.0, 30.0, 40.0])),
            ParameterFault::Quality(WireQualityFault::Temperature),
        ),
        (
            fault(&|p| quality(p).loo_rms_mps2 = Some(-1.0)),
            ParameterFault::Quality(WireQualityFault::Residual),
        ),
        (
            fault(&|p| quality(p).condition = Some(0.5)),
            ParameterFault::Quality(WireQualityFault::Condition),
        ),
        (
            fault(&|p| quality(p).other_sd[3][1] = f32::NAN),
            ParameterFault::Quality(WireQualityFault::Deviation),
        ),
        (
            fault(&|p| magnetometer(p).hard_iron_nt[0] = f32::NAN),
            ParameterFault::Magnetometer(WireMagnetometerFault::HardIron),
        ),
        (
            fault(&|p| magnetometer(p).soft_iron = [1.0, 1.0, 1.0, 2.0, 0.0, 0.0]),
            ParameterFault::Magnetometer(WireMagnetometerFault::SoftIron),
        ),
        (
            fault(&|p| {
                gyroscope_of(p).matrix = [[0.5, 0.3, 0.3], [0.3, 0.5, 0.3], [0.3, 0.3, 0.5]]
            }),
            ParameterFault::GyroscopeSingular(0.044),
        ),
        (
            fault(&|p| gyroscope_of(p).sd = Some([-1.0; 12])),
            beyond(WireGyroscopeTerm::Deviation, 0, -1.0, 0.0, 1.0),
        ),
        (
            fault(&|p| gyroscope_of(p).range_dps = 0),
            beyond(WireGyroscopeTerm::Range, 0, 0.0, 1.0, 65535.0),
        ),
        (
            fault(&|p| gyroscope_of(p).rad_s_per_lsb = f64::INFINITY),
            beyond(WireGyroscopeTerm::Sensitivity, 0, f64::INFINITY, 1e-8, 1e-2),
        ),
        (
            fault(&|p| gyroscope_of(p).g_sensitivity[2][0] = 0.1),
            beyond(WireGyroscopeTerm::GSensitivity, 2, 0.1, -0.02, 0.02),
        ),
        (
            fault(&|p| magnetometer(p).field_nt = 0.0),
            ParameterFault::Magnetometer(WireMagnetometerFault::Field),
        ),
        (
            fault(&|p| magnetometer(p).rms_nt = f32::NAN),
            ParameterFault::Magnetometer(WireMagnetometerFault::Quality),
        ),
        (
            fault(&|p| magnetometer(p).to_accelerometer.as_mut().unwrap().dip_rad = 2.0),
            ParameterFault::Magnetometer(WireMagnetometerFault::Dip),
        ),
        (
            fault(&|p| magnetometer(p).to_accelerometer.as_mut().unwrap().rotation_wxyz = [0.0; 4]),
            ParameterFault::Alignment(0.0),
        ),
    ] {
        assert_eq!(found, expected);
        assert!(!found.to_string().is_empty());
    }
    assert_eq!(
        ParameterFault::from(CompileError::Overflow).to_string(),
        CompileError::Overflow.to_string()
    );
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
    assert_eq!(Request::decode(&[1, 1, 0, 6, 7]), Err(MessageError::TooLong { extra: 1 }));
    // A signature of nine bytes.
    let mut request = vec![1, 1, 9];
    request.extend([0; 10]);
    assert_eq!(Request::decode(&request), Err(MessageError::Malformed));
    assert_eq!(Signature::new(&[0; 9]), None);
    // A piece of 257 bytes.
    let mut request = vec![1, 1, 0, 1, 0, 0xff, 3, 0x81, 2];
    request.extend([0; 257]);
    assert_eq!(Request::decode(&request), Err(MessageError::Malformed));
}

#[test]
fn refusals_say_what_to_do() {
    let nearest = Settings::default();
    for (refusal, word) in [
        (Refusal::KeyNeeded, "run `wimu key set` once over the cable"),
        (Refusal::Locked, "cable"),
        (Refusal::NothingStaged, "push"),
        (Refusal::UnsupportedSettings { nearest }, "±2 g at 100 Hz"),
        (Refusal::WrongRange { parameters_g: 4, device_g: 2 }, "±4 g"),
    ] {
        assert!(refusal.to_string().contains(word), "{refusal}");
    }
}

fn segment() -> impl Strategy<Value = WireSegment> {
    (any::<u32>(), any::<[i64; 3]>(), any::<[i64; 3]>(), any::<Option<[i32; 3]>>()).prop_map(
        |(steps, velocity_sum, position_sum, previous)| WireSegment {
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
        let state = WireState {
           revision: ARITHMETIC_REVISION,
            period_ns: words[0],
            zupt: words[1] % 2 == 0,
            gravity_um_s2: words[2],
            phase: [WirePhase::Searching, WirePhase::Resting, WirePhase::Moving][words[3] as usize % 3],
            flags: words[3] as u8,
            rest_mean: sums[0],
            east: axes[0],
            base_position_nm: sums[1],
            base_velocity_nmps: sums[2],
            base_since_rest_ns: u64::from(words[1]) << 20,
            segment,
            window: WireWindow {
                start,
                samples: words[0] as u16,
                reference: axes[1],
                sum: axes[2],
                squares: u64::from(words[2]) << 16,
            },
            run: has_run.then_some(WireRun {
                windows: words[2] as u16,
                sum: sums[3],
                latest: sums[4],
                start: run,
            }),
            heading_sd_mrad: has_run.then_some(words[0] as u16),
            rotation: (!has_run).then_some(WireRotation {
                quaternion: [i64::MIN, sums[0][0], sums[1][1], sums[2][2]],
                previous: has_run.then_some(axes[0]),
                remainder: [words[0], words[1], words[2]],
                bias: axes[1],
                window: sums[3],
                sum: sums[4],
                latest: sums[0],
            }),
        };
        prop_assert_eq!(WireState::from(wimu_integrator::State::from(state)), state);
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
    assert_eq!(computed, (2, 0x5459_5701_2858_47a1));
}

/// The same with a gyroscope, and of wide counts.
#[test]
fn the_arithmetic_of_six_axes_is_that_of_its_revision() {
    use wimu_model::{Alignment, Corrector, Counts, GyroscopeCorrector, GyroscopeModel};
    let corrector = Corrector::compile(&calibrated(), None).unwrap();
    let model = GyroscopeModel::new(wimu_model::GyroscopeTerms {
        bias_rad_s: [0.02, -0.01, 0.005],
        matrix: [[1.02, 0.01, 0.0], [0.0, 0.98, -0.02], [0.01, 0.0, 1.01]],
        g_sensitivity: [[0.001, 0.0, -0.0005], [0.0, 0.002, 0.0], [0.0, 0.0, 0.001]],
        ..Default::default()
    });
    let gyroscope =
        GyroscopeCorrector::compile(&model.unwrap(), 0.001_22, Alignment::IDENTITY, None).unwrap();
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
    assert_eq!(computed, (2, 0x175f_d35c_4b12_b43c));
}
