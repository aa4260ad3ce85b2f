//! The gyroscope that is calibrated by the turns between poses.

use wimu_host::calibration::{CalibrateOptions, CalibrationReport, calibrate};
use wimu_host::recording::{Quantity, Recording, Selection, Sink, TrackInfo, Unit};
use wimu_model::{GyroscopeModel, GyroscopeTerms, STANDARD_GRAVITY_MPS2};
use wimu_testkit::Random;

/// Rotations of 1 rad/s about X, Y, Z in turn, of 90°, between rests of 3 s at 100 Hz.
fn session(rate_unit: Unit, change: impl Fn([f64; 3]) -> [f64; 3]) -> Recording {
    let mut random = Random::new(5);
    let model = GyroscopeModel::new(GyroscopeTerms {
        bias_rad_s: [0.02, -0.01, 0.005],
        matrix: [[1.01, 0.0, 0.01], [0.0, 0.99, 0.0], [-0.005, 0.0, 1.0]],
        ..GyroscopeTerms::default()
    })
    .unwrap();
    let mut recording = Recording::new("session");
    let force = recording.track(TrackInfo::new("a", Quantity::SpecificForce, Unit::Si));
    let rate = recording.track(TrackInfo::new("w", Quantity::AngularRate, rate_unit));
    let (mut up, mut time_ns) = ([0.36, 0.48, 0.8], 0);
    for k in 0..30 {
        for i in 0..500 {
            let angle = std::f64::consts::FRAC_PI_2 / 160.0;
            let mut omega = [0.0; 3];
            if (320..480).contains(&i) {
                omega[k % 3] = 100.0 * angle;
                let (b, c) = ((k + 1) % 3, (k + 2) % 3);
                let (sin, cos) = angle.sin_cos();
                (up[b], up[c]) = (cos * up[b] + sin * up[c], cos * up[c] - sin * up[b]);
            }
            let f = up.map(|u| u * STANDARD_GRAVITY_MPS2);
            let w = model.distort(omega, f, None).map(|w| w + 0.001 * random.normal());
            recording.row(force, time_ns, &f.map(|f| f + 0.02 * random.normal()));
            recording.row(rate, time_ns, &change(w));
            time_ns += 10_000_000;
        }
        // Another corner up: the rotations alone would come back.
        if k % 4 == 3 {
            up = [up[1], -up[0], up[2]].map(|u| 0.8 * u + 0.6 * random.within(1.0));
            let norm = up.iter().map(|u| u * u).sum::<f64>().sqrt();
            up = up.map(|u| u / norm);
            time_ns += 1_000_000_000;
        }
    }
    recording
}

fn calibrated(recording: &Recording) -> CalibrationReport {
    let samples = recording.samples(Selection::default()).unwrap();
    calibrate(&samples, &CalibrateOptions::default()).unwrap()
}

#[test]
fn the_gyroscope_of_a_session_is_in_the_report_and_the_file() {
    let report = calibrated(&session(Unit::Si, |w| w));
    let found = report.gyroscope.as_ref().expect("a gyroscope");
    assert!(
        found.turns >= 15
            && found.rms_rad.to_degrees() < 0.5
            && found.before_rad.to_degrees() > 1.0,
        "{found:?}"
    );
    for (axis, truth) in [0.02, -0.01, 0.005].into_iter().enumerate() {
        let error = (found.model.terms().bias_rad_s[axis] - truth).abs();
        assert!(error < 5.0 * found.sd(axis), "{axis}: {error} {found:?}");
    }
    for (axis, truth) in [1.01, 0.99, 1.0].into_iter().enumerate() {
        let error = (found.model.terms().matrix[axis][axis] - truth).abs();
        assert!(error < 5.0 * found.sd(3 + 4 * axis) && error < 0.005, "{axis}: {error} {found:?}");
    }
    let stored = report.file.unwrap().sensor().gyroscope.unwrap();
    assert_eq!(stored.model, found.model);
}

#[test]
fn counts_of_unknown_unit_are_those_of_a_usual_sensitivity() {
    let unit = Unit::Counts { si_per_lsb: None };
    let report = calibrated(&session(unit, |w| w.map(|w| (w.to_degrees() * 65.5).round())));
    let found = report.gyroscope.as_ref().expect("a gyroscope");
    assert!((found.model.terms().matrix[0][0] - 1.01).abs() < 0.01, "{found:?}");
    let texts = report.outcome.findings.iter().map(|problem| problem.text.as_str());
    assert!(texts.clone().any(|text| text.contains("65.5 LSB per °/s")), "{report:?}");
    // It shows swapped axes.
    assert!(!texts.clone().any(|text| text.contains("cannot be detected")), "{report:?}");
}

#[test]
fn swapped_axes_of_counts_of_unknown_unit_are_found() {
    let unit = Unit::Counts { si_per_lsb: None };
    let swapped = |[x, y, z]: [f64; 3]| [y, x, z].map(|w| (w.to_degrees() * 65.5).round());
    let report = calibrated(&session(unit, swapped));
    let texts = report.outcome.findings.iter().map(|problem| problem.text.as_str());
    assert!(texts.clone().any(|text| text.contains("X = Y, Y = X, Z = Z")), "{report:?}");
    assert!(!texts.clone().any(|text| text.contains("cannot be detected")), "{report:?}");
}

#[test]
fn scale_factors_ten_percent_off_are_found() {
    let report = calibrated(&session(Unit::Si, |w| w.map(|w| 1.1 * w)));
    let found = report.gyroscope.as_ref().expect("a gyroscope");
    for (axis, truth) in [1.111, 1.089, 1.1].into_iter().enumerate() {
        let error = (found.model.terms().matrix[axis][axis] - truth).abs();
        assert!(error < 0.005, "{axis}: {error} {found:?}");
    }
}

#[test]
fn a_refused_gyroscope_leaves_the_accelerometer() {
    let evidence = |recording: &Recording| {
        let report = calibrated(recording);
        assert!(report.estimate.is_some() && report.gyroscope.is_none());
        let mut findings = report.outcome.findings.iter();
        let found = findings.find(|f| f.text.contains("gyroscope is not calibrated"));
        found.expect("a finding").text.clone()
    };
    let degrees = evidence(&session(Unit::Si, |w| w.map(f64::to_degrees)));
    assert!(degrees.contains("probably in deg/s"), "{degrees}");
    let negated = evidence(&session(Unit::Si, |[x, y, z]| [x, -y, z]));
    assert!(negated.contains("Y = −Y"), "{negated}");
    let unknown = evidence(&session(Unit::Unknown, |w| w));
    assert!(unknown.contains("unit is not known"), "{unknown}");
}
