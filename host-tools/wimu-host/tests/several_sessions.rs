//! Calibrations of several sessions: temperature, and the change between them.

use wimu_host::calibration::{CalibrateOptions, SeveralReport, calibrate_several};
use wimu_host::imu::Imu;
use wimu_host::recording::{Quantity, Recording, Selection, Sink, TrackInfo, Unit};
use wimu_host::{Code, Result};
use wimu_model::{
    CentiCelsius, ErrorModel, ErrorTerms, STANDARD_GRAVITY_MPS2, SpecificForceMps2,
    TemperatureTerms,
};
use wimu_testkit::{Random, spread};

const LSB_PER_G: f64 = 16384.0;

/// A sensor with temperature coefficients at 25 °C.
fn sensor(bias_x_mps2: f64) -> ErrorModel {
    ErrorModel::new(ErrorTerms {
        bias_mps2: [bias_x_mps2, -0.3, 0.2],
        matrix: [[1.03, 0.0, 0.0], [0.02, 0.98, 0.0], [-0.01, 0.015, 1.01]],
        temperature: TemperatureTerms {
            bias_mps2_per_k: [0.004, -0.002, 0.001],
            scale_per_k: [1e-4, -5e-5, 2e-5],
            ..TemperatureTerms::default()
        },
        ..ErrorTerms::default()
    })
    .unwrap()
}

/// Counts of the 20 pose means of a session with this bias of X.
fn session(name: &str, celsius: f64, bias_x_mps2: f64) -> Recording {
    let mut recording = Recording::new(name);
    let counts = Unit::Counts { si_per_lsb: None };
    let mut info = TrackInfo::new("poses", Quantity::SpecificForce, counts);
    info.timeless = true;
    let force = recording.track(info);
    let temperature = TrackInfo::new("poses", Quantity::Temperature, Unit::Si);
    let temperature = recording.track(temperature);
    let per_mps2 = LSB_PER_G / STANDARD_GRAVITY_MPS2;
    let mut random = Random::new(celsius.to_bits() ^ bias_x_mps2.to_bits());
    let at = Some(CentiCelsius::from_celsius(celsius));
    for (time, up) in (0..).zip(spread(20)) {
        let up = SpecificForceMps2(up.map(|axis| axis * STANDARD_GRAVITY_MPS2));
        let mut seen = sensor(bias_x_mps2).distort(up, at).0;
        seen = seen.map(|axis| (axis + 0.001 * random.normal()) * per_mps2);
        recording.row(force, time, &seen);
        recording.row(temperature, time, &[celsius]);
    }
    recording
}

/// Sessions at 10, 20, … °C with these biases.
fn sessions(biases_mps2: &[f64]) -> Vec<Recording> {
    let one = |(k, bias): (usize, &f64)| {
        let celsius = 10.0 * (k + 1) as f64;
        session(&format!("{k}.csv"), celsius, *bias)
    };
    biases_mps2.iter().enumerate().map(one).collect()
}

fn options() -> CalibrateOptions {
    CalibrateOptions {
        gravity_mps2: Some(STANDARD_GRAVITY_MPS2),
        sensitivity_lsb_per_g: Some(LSB_PER_G),
        utc_s: Some(1_795_222_920),
        ..CalibrateOptions::default()
    }
}

fn run(recordings: &[Recording], options: &CalibrateOptions) -> Result<SeveralReport> {
    let selection = Selection { accelerometer: None, poses: true };
    let data: Result<Vec<_>> = recordings.iter().map(|r| r.samples(selection)).collect();
    calibrate_several(&data?, options)
}

#[test]
fn temperature_coefficients_and_the_change_between_sessions_come_back() {
    let turn_on = [0.02, -0.01, -0.02, 0.01, 0.0];
    let report = run(&sessions(&turn_on.map(|off| 0.5 + off)), &options()).unwrap();
    let fit = report.fit.as_ref().unwrap();
    let truth = *sensor(0.5).terms();
    for axis in 0..3 {
        let slope = fit.model.temperature.bias_mps2_per_k[axis];
        let sd = fit.sd.temperature.bias_mps2_per_k[axis];
        assert!((slope - truth.temperature.bias_mps2_per_k[axis]).abs() < 3.0 * sd + 1e-9);
        let expected = truth.bias_mps2[axis] + 5.0 * truth.temperature.bias_mps2_per_k[axis];
        assert!((fit.model.bias_mps2[axis] - expected).abs() < 3.0 * fit.sd.bias_mps2[axis]);
    }
    let range = fit.temperature.unwrap();
    assert_eq!([range.lowest_c, range.mean_c, range.highest_c], [10.0, 30.0, 50.0]);
    // X alone changes, by 16 mm/s² rms: 9 over the three axes.
    let between = fit.between_sd.bias_m_s2;
    assert!((0.004..0.02).contains(&between), "{between}");
    assert!(fit.rms_mm_s2.unwrap() < 30.0);
}

#[test]
fn navigation_takes_the_change_between_sessions_instead_of_a_constant() {
    let recording = |changes: &[f64]| {
        let biases: Vec<f64> = changes.iter().map(|off| 0.5 + off).collect();
        let several = run(&sessions(&biases), &options()).unwrap();
        let covariance = several.fit.map(|fit| fit.covariance);
        Imu { covariance, of_sessions: true, ..Imu::default() }
    };
    let equal = recording(&[0.0; 4]);
    assert!(equal.bias_mps2() < 0.02, "{}", equal.bias_mps2());
    let [single, several] = [false, true].map(|of_sessions| {
        let mut motion = equal.clone();
        motion.of_sessions = of_sessions;
        motion.calibration_covariance().unwrap()[0][0].sqrt()
    });
    assert!(single > 0.05 && several < 0.02, "{single} {several}");
    let changing = recording(&[0.3, -0.2, -0.3, 0.2]);
    assert!(changing.bias_mps2() > 0.1, "{}", changing.bias_mps2());
}

#[test]
fn gravity_is_named_only_where_the_default_dominates() {
    let assumed = |report: &SeveralReport| {
        let findings = report.outcome.findings.iter();
        findings.filter(|f| f.code == Code::GravityAssumed).count()
    };
    let recordings = sessions(&[0.5, 0.5, 0.5, 0.5]);
    let with = |gravity_mps2, place| {
        let options = CalibrateOptions { gravity_mps2, place, ..options() };
        run(&recordings, &options)
    };
    let default = with(None, None).unwrap();
    assert_eq!(assumed(&default), 1);
    let by_place = with(None, Some([45.0, 0.0])).unwrap();
    assert_eq!(assumed(&by_place), 0);
    assert!((by_place.gravity_m_s2 - 9.80620).abs() < 1e-5);
    assert_eq!(by_place.gravity_sd_m_s2, 0.0005);
    let scale_sd = |report: &SeveralReport| report.fit.as_ref().unwrap().sd.matrix[0][0];
    assert!(scale_sd(&by_place) < 0.3 * scale_sd(&default));
    assert_eq!(assumed(&with(Some(9.81), None).unwrap()), 0);
}
