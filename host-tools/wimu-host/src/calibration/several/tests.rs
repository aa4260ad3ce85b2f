use wimu_model::{CentiCelsius, STANDARD_GRAVITY_MPS2};
use wimu_testkit::{Random, spread};

use super::*;
use crate::calibration::{ModelChoice, read_model, read_parameters};
use crate::motion::MotionRecording;
use crate::recording::{Quantity, Recording, Selection, Sink, TrackInfo, Unit};

const LSB_PER_G: f64 = 16384.0;
const COUNTS: Unit = Unit::Counts { si_per_lsb: None };

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

/// Pose means of a session with this bias of X.
fn session(name: &str, unit: Unit, celsius: f64, bias_x_mps2: f64, poses: u32) -> Recording {
    let mut recording = Recording::new(name);
    let mut info = TrackInfo::new("poses", Quantity::SpecificForce, unit);
    info.timeless = true;
    let force = recording.track(info);
    let temperature = TrackInfo::new("poses", Quantity::Temperature, Unit::Si);
    let temperature = recording.track(temperature);
    let per_mps2 = match unit {
        Unit::Si => 1.0,
        _ => LSB_PER_G / STANDARD_GRAVITY_MPS2,
    };
    let mut random = Random::new(celsius.to_bits() ^ bias_x_mps2.to_bits());
    let at = Some(CentiCelsius::from_celsius(celsius));
    for (time, up) in (0..).zip(spread(poses)) {
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
        session(&format!("{k}.csv"), COUNTS, celsius, *bias, 20)
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
    assert!(fit.within_sd.bias_m_s2 < 0.001 && fit.rms_mm_s2.unwrap() < 30.0);
    let text = report.to_string();
    assert!(text.starts_with("5 sessions: bias repeats within ± "), "{text}");
    assert!(text.contains("\nper K from 30.0 °C, valid from 10.0 to 50.0 °C: bias +"), "{text}");
    assert!(text.contains("\n2.csv: 20 poses, 30.0 °C, "), "{text}");
}

#[test]
fn the_file_holds_all_sessions_and_its_parameters_are_those_of_the_report() {
    let report = run(&sessions(&[0.5, 0.52, 0.48]), &options()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("CAL.json");
    report.file.clone().unwrap().write(&path).unwrap();
    let set = read_parameters(&path).unwrap();
    let own = report.parameters.unwrap();
    assert_eq!(set, own);
    assert_eq!(Some(parameter_id(&set).to_string()), report.parameter_id);
    assert!(read_model(&path).unwrap().of_sessions);
    let listed = crate::calibration::sessions(Some(&path), &set);
    let names: Vec<_> = listed.iter().filter_map(|s| s.file.as_deref()).collect();
    assert_eq!(names, ["0.csv", "1.csv", "2.csv"]);
    assert_eq!(listed.iter().map(|session| session.poses).sum::<u32>(), 60);

    // Later rests update one session: the turn-on bias is not included any more.
    let mut terms = *own.quality.unwrap().terms();
    (terms.method, terms.poses) = (CalibrationMethod::Updated, 61);
    let updated = ParameterSet { quality: CalibrationQuality::new(terms).ok(), ..own };
    let file = CalibrationFile::after(Some(&path), &own, &updated, "later.csv");
    file.write(&path).unwrap();
    assert!(!read_model(&path).unwrap().of_sessions);
}

#[test]
fn navigation_takes_the_change_between_sessions_instead_of_a_constant() {
    let recording = |changes: &[f64]| {
        let biases: Vec<f64> = changes.iter().map(|off| 0.5 + off).collect();
        let several = run(&sessions(&biases), &options()).unwrap();
        let mut motion = MotionRecording::default();
        motion.covariance = several.fit.map(|fit| fit.covariance);
        motion.of_sessions = true;
        motion
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
fn a_session_that_departs_and_a_refused_one_are_named() {
    let departs = |report: &SeveralReport| {
        let mut findings = report.outcome.findings.iter();
        findings.any(|finding| finding.evidence.starts_with("3.csv departs"))
    };
    let biases = [0.501, 0.499, 0.5, 0.502, 0.5, 0.498];
    assert!(!departs(&run(&sessions(&biases), &options()).unwrap()));
    let mut other = biases;
    other[3] = 0.9;
    let report = run(&sessions(&other), &options()).unwrap();
    assert!(departs(&report), "{:?}", report.outcome.findings);

    let few =
        [session("whole.csv", COUNTS, 20.0, 0.5, 20), session("few.csv", COUNTS, 30.0, 0.5, 5)];
    let report = run(&few, &options()).unwrap();
    let reason = report.outcome.reason.clone().unwrap();
    assert!(reason.starts_with("few.csv: ") && report.file.is_none(), "{reason}");
    assert_eq!(report.outcome.exit_code(), 3);

    let twice =
        [session("one.csv", COUNTS, 20.0, 0.5, 20), session("copy.csv", COUNTS, 20.0, 0.5, 20)];
    let reason = run(&twice, &options()).unwrap().outcome.reason.unwrap();
    assert!(reason.starts_with("one.csv and copy.csv hold the same data"), "{reason}");
    let one = run(&twice[..1], &options()).unwrap().outcome.reason;
    assert!(one.is_some_and(|reason| reason.starts_with("1 of at least 2 sessions")));
}

#[test]
fn sessions_of_other_units_and_methods_are_usage_errors() {
    let mixed =
        [session("counts.csv", COUNTS, 20.0, 0.5, 20), session("si.csv", Unit::Si, 30.0, 0.5, 20)];
    let error = run(&mixed, &options()).unwrap_err();
    assert_eq!(error.code(), ErrorCode::Usage);
    for method in [MethodChoice::FourAngle, MethodChoice::ThreeAngle] {
        let turned = CalibrateOptions { method, ..options() };
        let error = run(&sessions(&[0.5, 0.5]), &turned).unwrap_err();
        assert_eq!(error.code(), ErrorCode::Usage);
    }
    // Counts of unknown sensitivity: that of the first session's fit is taken for all.
    let unknown = CalibrateOptions {
        sensitivity_lsb_per_g: None,
        model: ModelChoice::default(),
        ..options()
    };
    let report = run(&sessions(&[0.5, 0.5]), &unknown).unwrap();
    let found = report.sensitivity_lsb_per_g.unwrap();
    assert!((found / LSB_PER_G - 1.0067).abs() < 0.002, "{found}");
}

#[test]
fn gravity_is_named_only_where_the_default_dominates() {
    let assumed = |report: &SeveralReport| {
        let findings = report.outcome.findings.iter();
        findings.filter(|f| f.code == FindingCode::GravityAssumed).count()
    };
    let recordings = sessions(&[0.5, 0.5, 0.5, 0.5]);
    let with = |gravity_mps2, place| {
        let options = CalibrateOptions { gravity_mps2, place, ..options() };
        run(&recordings, &options)
    };
    let default = with(None, None).unwrap();
    assert_eq!((assumed(&default), default.gravity_source), (1, Source::Default));
    let by_place = with(None, Some([45.0, 0.0])).unwrap();
    assert_eq!((assumed(&by_place), by_place.gravity_source), (0, Source::Latitude));
    assert!((by_place.gravity_m_s2 - 9.80620).abs() < 1e-5);
    assert_eq!(by_place.gravity_sd_m_s2, 0.0005);
    let scale_sd = |report: &SeveralReport| report.fit.as_ref().unwrap().sd.matrix[0][0];
    assert!(scale_sd(&by_place) < 0.3 * scale_sd(&default));
    let json = serde_json::to_value(&by_place).unwrap();
    assert_eq!(json["gravity_source"], "latitude");
    assert_eq!(assumed(&with(Some(9.81), None).unwrap()), 0);
    for wrong in [
        with(Some(9.81), Some([45.0, 0.0])),
        with(None, Some([91.0, 0.0])),
        with(None, Some([0.0, 9999.0])),
    ] {
        assert_eq!(wrong.unwrap_err().code(), ErrorCode::Usage);
    }
}
