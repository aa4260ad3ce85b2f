//! Corrected samples of a recording.

use wimu_host::Code;
use wimu_host::apply::{Corrected, CorrectedRecording};
use wimu_host::calibration::{AccelerometerCalibration, Correction, SensorCalibration};
use wimu_host::csv::AccelerationUnit;
use wimu_host::recording::{Quantity, Recording, Sink, TrackInfo, Unit};
use wimu_model::{
    Alignment, Corrector, Counts, ErrorModel, ErrorTerms, GyroscopeModel, GyroscopeParameters,
    GyroscopeTerms, ParameterSet, STANDARD_GRAVITY_MPS2, Sensitivity, SpecificForceMps2,
};
use wimu_testkit::Random;

const LSB_PER_G: f64 = 1000.0;

fn calibration(of_counts: bool) -> SensorCalibration {
    let rotated = GyroscopeModel::new(GyroscopeTerms {
        bias_rad_s: [0.1, 0.0, 0.0],
        g_sensitivity: [[0.0, 0.0, 0.001], [0.0; 3], [0.0; 3]],
        ..GyroscopeTerms::default()
    });
    let accelerometer = AccelerometerCalibration {
        unit: if of_counts { AccelerationUnit::Lsb } else { AccelerationUnit::Mps2 },
        range_g: None,
        range_source: None,
        sensitivity_lsb_per_g: of_counts.then_some(LSB_PER_G),
        zero_count: None,
        model: ErrorModel::new(ErrorTerms {
            bias_mps2: [0.5, -0.25, 0.0],
            matrix: [[1.0, 0.0, 0.0], [0.0, 1.25, 0.0], [0.0, 0.0, 1.0]],
            ..ErrorTerms::default()
        })
        .unwrap(),
        quality: None,
        sessions: Vec::new(),
    };
    let mut sensor = SensorCalibration::new(None, accelerometer);
    // Body X is the sensor's Y.
    let body_x = [0.5_f64.sqrt(), 0.0, 0.0, -(0.5_f64.sqrt())];
    sensor.alignment = Alignment::from_quaternion(body_x).unwrap();
    sensor.gyroscope = GyroscopeParameters::new(250, 0.01, rotated.unwrap(), None).ok();
    sensor
}

/// Samples of 100 Hz, every tenth of them not a number, a gyroscope of half the rate and a temperature.
fn recording(force: Unit, rate: Unit) -> Recording {
    let mut recording = Recording::new("a.bin");
    let force = recording.track(TrackInfo::new("acc", Quantity::SpecificForce, force));
    let rate = recording.track(TrackInfo::new("gyr", Quantity::AngularRate, rate));
    let celsius = recording.track(TrackInfo::new("temp", Quantity::Temperature, Unit::Si));
    recording.row(celsius, 0, &[30.0]);
    for k in 0..100 {
        let time_ns = 5_000_000_000 + k * 10_000_000;
        let bad = if k % 10 == 9 { f64::NAN } else { 0.0 };
        recording.row(force, time_ns, &[0.5, 1.0, 10.0 + bad]);
        if k % 2 == 0 && !(40..60).contains(&k) {
            recording.row(rate, time_ns, &[1.0, 2.0, 3.0]);
        }
    }
    recording
}

fn near(found: [f64; 3], expected: [f64; 3]) -> bool {
    found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9)
}

#[test]
fn samples_in_si_are_corrected_and_rotated_with_the_gyroscope_beside_them() {
    let (stored, recording) = (calibration(false), recording(Unit::Si, Unit::Si));
    let corrected = CorrectedRecording::new(&stored, &recording).unwrap();
    let rows: Vec<Corrected> = corrected.rows().collect();
    assert_eq!(rows.len(), 90);
    for row in &rows {
        // (0, 1, 10) in sensor axes.
        assert!(near(row.force_mps2, [1.0, 0.0, 10.0]), "{row:?}");
        assert_eq!(row.temperature_c, Some(30.0));
        // Interpolated, but not in the gap.
        let is_near = !(5_390_000_000..5_600_000_000).contains(&row.time_ns);
        assert_eq!(row.rate_rad_s.is_some(), is_near, "{row:?}");
        if let Some(rate) = row.rate_rad_s {
            assert!(near(rate, [2.0, -0.89, 3.0]), "{rate:?}");
        }
    }
    assert_eq!(corrected.findings, []);
}

#[test]
fn counts_take_the_sensitivity_of_the_calibration_else_of_the_file() {
    let counts = |si_per_lsb| Unit::Counts { si_per_lsb };
    let own = STANDARD_GRAVITY_MPS2 / LSB_PER_G;
    for (of_counts, said, scale) in
        [(true, None, own), (true, Some(1.1 * own), own), (false, Some(0.5), 0.5)]
    {
        let (stored, recording) = (calibration(of_counts), recording(counts(said), counts(None)));
        let corrected = CorrectedRecording::new(&stored, &recording).unwrap();
        let row = corrected.rows().next().unwrap();
        let output = [0.5, 1.0, 10.0].map(|axis| axis * scale);
        let force = stored.accelerometer.model.correct(SpecificForceMps2(output), None).0;
        assert!(near(row.force_mps2, stored.alignment.rotate(force)));
        let rate = stored.gyroscope.unwrap().model;
        let rate = rate.correct([0.01, 0.02, 0.03], force, None);
        assert!(near(row.rate_rad_s.unwrap(), stored.alignment.rotate(rate)));
    }
}

#[test]
fn outputs_that_a_calibration_is_not_of_are_refused() {
    let mut stored = calibration(true);
    (stored.accelerometer.range_g, stored.accelerometer.zero_count) = (Some(2), Some(512.0));
    let own = STANDARD_GRAVITY_MPS2 / LSB_PER_G;
    let counts = Unit::Counts { si_per_lsb: Some(own) };
    let mut track = TrackInfo::new("acc", Quantity::SpecificForce, counts);
    let code = |track: &TrackInfo| stored.compile(track).err().map(|problem| problem.code);
    track.zero_count = Some(512.0);
    track.full_scale = Some(2.0 * STANDARD_GRAVITY_MPS2);
    assert_eq!(code(&track), None);
    let mut other = track.clone();
    other.corrected = true;
    assert_eq!(code(&other), Some(Code::AlreadyCorrected));
    (other.corrected, other.full_scale) = (false, Some(4.0 * STANDARD_GRAVITY_MPS2));
    assert_eq!(code(&other), Some(Code::UnknownFormat));
    (other.full_scale, other.zero_count) = (track.full_scale, Some(500.0));
    assert_eq!(code(&other), Some(Code::UnknownFormat));
    other.zero_count = track.zero_count;
    other.unit = Unit::Counts { si_per_lsb: Some(2.0 * own) };
    assert_eq!(code(&other), Some(Code::UnknownFormat));
    other.unit = Unit::Si;
    assert_eq!(code(&other), Some(Code::UnknownFormat));
}

/// The device's integers and f64 differ by rounding alone.
#[test]
fn a_correction_is_that_of_the_device_within_one_lsb() {
    let mut random = Random::new(3);
    for _ in 0..50 {
        let mut triple = |most: f64| [0, 1, 2].map(|_| random.within(most));
        let [bias_mps2, x, y, z] = [triple(1.0), triple(0.05), triple(0.05), triple(0.05)];
        let mut matrix = [x, y, z];
        (0..3).for_each(|axis| matrix[axis][axis] += 1.0);
        let [i, j, k] = triple(1.0);
        let terms = ErrorTerms { bias_mps2, matrix, ..ErrorTerms::default() };
        let set = ParameterSet {
            model: ErrorModel::new(terms).unwrap(),
            alignment: Alignment::from_quaternion([1.0, i, j, k].map(|q| q * 0.7)).unwrap(),
            ..ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0).unwrap())
        };
        let (device, host) = (Corrector::compile(&set, None).unwrap(), Correction::from(&set));
        for _ in 0..20 {
            let counts = [0, 1, 2].map(|_| random.within(30_000.0) as i16);
            let integers = device.correct(Counts(counts)).0;
            let exact = host.sample(counts.map(f64::from), None);
            for (integer, exact) in integers.into_iter().zip(exact) {
                let off = f64::from(integer) - exact * 65536.0;
                assert!(off.abs() <= 1.0, "{off} LSB at {counts:?} of {set:?}");
            }
        }
    }
}
