//! Corrected samples of a recording.

use wimu_host::apply::{Corrected, Correction};
use wimu_host::calibration::StoredModel;
use wimu_host::recording::{Quantity, Recording, Sink, TrackInfo, Unit};
use wimu_model::{
    Alignment, ErrorModel, ErrorTerms, GyroscopeModel, GyroscopeParameters, GyroscopeTerms,
    STANDARD_GRAVITY_MPS2, SpecificForceMps2,
};

const LSB_PER_G: f64 = 1000.0;

fn calibration(of_counts: bool) -> StoredModel {
    let rotated = GyroscopeModel::new(GyroscopeTerms {
        bias_rad_s: [0.1, 0.0, 0.0],
        g_sensitivity: [[0.0, 0.0, 0.001], [0.0; 3], [0.0; 3]],
        ..GyroscopeTerms::default()
    });
    StoredModel {
        model: ErrorModel::new(ErrorTerms {
            bias_mps2: [0.5, -0.25, 0.0],
            matrix: [[1.0, 0.0, 0.0], [0.0, 1.25, 0.0], [0.0, 0.0, 1.0]],
            ..ErrorTerms::default()
        })
        .unwrap(),
        sensitivity_lsb_per_g: of_counts.then_some(LSB_PER_G),
        of_counts,
        covariance: None,
        of_sessions: false,
        // Body X is the sensor's Y.
        alignment: Alignment::from_quaternion([0.5_f64.sqrt(), 0.0, 0.0, -(0.5_f64.sqrt())])
            .unwrap(),
        magnetometer: None,
        gyroscope: Some(GyroscopeParameters::new(250, 0.01, rotated.unwrap(), None).unwrap()),
    }
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
    let correction = Correction::new(&stored, &recording).unwrap();
    let rows: Vec<Corrected> = correction.rows().collect();
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
    assert_eq!(correction.findings, []);
}

#[test]
fn counts_take_the_sensitivity_of_the_calibration_else_of_the_file() {
    let counts = |si_per_lsb| Unit::Counts { si_per_lsb };
    let own = STANDARD_GRAVITY_MPS2 / LSB_PER_G;
    for (of_counts, said, scale) in
        [(true, None, own), (true, Some(1.1 * own), own), (false, Some(0.5), 0.5)]
    {
        let (stored, recording) = (calibration(of_counts), recording(counts(said), counts(None)));
        let correction = Correction::new(&stored, &recording).unwrap();
        let row = correction.rows().next().unwrap();
        let output = [0.5, 1.0, 10.0].map(|axis| axis * scale);
        let force = stored.model.correct(SpecificForceMps2(output), None).0;
        assert!(near(row.force_mps2, stored.alignment.rotate(force)));
        let rate = stored.gyroscope.unwrap().model;
        let rate = rate.correct([0.01, 0.02, 0.03], force, None);
        assert!(near(row.rate_rad_s.unwrap(), stored.alignment.rotate(rate)));
    }
}
