use std::path::{Path, PathBuf};

use wimu_calib::Orientation;
use wimu_link::message::{Epoch, EpochReason};
use wimu_link::{Hello, LinkRole, MAX_FRAME, Telemetry, batch};
use wimu_model::{
    Alignment, Counts, DeviceTimeUs, ErrorModel, ErrorTerms, GyroscopeModel, GyroscopeParameters,
    GyroscopeTerms, RotationCovariance, SpecificForceMps2,
};
use wimu_testkit::Random;

use super::range::likely_range_g;
use super::*;
use crate::decode::Decoder;
use crate::formats::{self, ReadOptions};
use crate::history::LinkHistory;
use crate::recording::{Quantity, Recording, Selection, Sink, TrackInfo, Unit};

fn truth() -> ErrorModel {
    ErrorModel::new(ErrorTerms {
        bias_mps2: [0.5, -0.3, 0.2],
        matrix: [[1.03, 0.0, 0.0], [0.02, 0.98, 0.0], [-0.01, 0.015, 1.01]],
        ..ErrorTerms::default()
    })
    .unwrap()
}

/// Force and temperature of pose means.
fn recording_of(unit: Unit, values: impl IntoIterator<Item = [f64; 3]>) -> Recording {
    let mut recording = Recording::new("poses");
    let mut info = TrackInfo::new("poses", Quantity::SpecificForce, unit);
    info.timeless = true;
    let force = recording.track(info);
    let temperature = TrackInfo::new("poses", Quantity::Temperature, Unit::Si);
    let temperature = recording.track(temperature);
    for (time, value) in (0..).zip(values) {
        recording.row(force, time, &value);
        recording.row(temperature, time, &[21.5]);
    }
    recording
}

/// Pose means of a sensor with these errors, 26 orientations.
fn pose_means(unit: Unit, per_mps2: f64) -> Recording {
    let value = |orientation: Orientation| {
        let force = SpecificForceMps2(orientation.up().map(|axis| axis * STANDARD_GRAVITY_MPS2));
        truth().distort(force, None).0.map(|axis| axis * per_mps2)
    };
    recording_of(unit, Orientation::ALL.into_iter().map(value))
}

const UNKNOWN_COUNTS: Unit = Unit::Counts { si_per_lsb: None };

/// Calibrates with all rows, which are means over poses if they have no times.
fn calibrate(data: &Recording, options: &CalibrateOptions) -> Result<CalibrationReport> {
    let poses = data.tracks().iter().any(|track| track.info.timeless);
    calibrate_rows(data, poses, options)
}

fn calibrate_rows(
    data: &Recording,
    poses: bool,
    options: &CalibrateOptions,
) -> Result<CalibrationReport> {
    let selection = Selection { accelerometer: None, poses };
    super::calibrate(&data.samples(selection)?, options)
}

#[test]
fn the_error_model_comes_back() {
    let report = calibrate(&pose_means(Unit::Si, 1.0), &CalibrateOptions::default()).unwrap();
    assert_eq!((report.outcome.status, report.outcome.exit_code()), ("ok", 0));
    let fit = report.fit.as_ref().unwrap();
    assert!(fit.rms_mm_s2 < 1e-6);
    for axis in 0..3 {
        let terms = truth();
        assert!((fit.model.bias_mps2[axis] - terms.terms().bias_mps2[axis]).abs() < 1e-9);
        for column in 0..3 {
            let error = fit.model.matrix[axis][column] - terms.terms().matrix[axis][column];
            assert!(error.abs() < 1e-9);
        }
    }
    assert!(report.uncalibrated_rms_mm_s2.unwrap() > 300.0);
    assert_eq!(fit.temperature_c, Some(21.5));
    // Without a sensitivity there is nothing for a board.
    assert_eq!(report.parameters, None);
    let text = report.to_string();
    assert!(text.contains("bias +0.5000") && text.contains("leave-one-out"), "{text}");
}

#[test]
fn counts_of_unknown_worth_are_scaled_so_that_the_mean_scale_factor_is_1() {
    for lsb_per_g in [2048.0, 16384.0, 333.0] {
        let data = pose_means(UNKNOWN_COUNTS, lsb_per_g / STANDARD_GRAVITY_MPS2);
        let report = calibrate(&data, &CalibrateOptions::default()).unwrap();
        let fit = report.fit.as_ref().unwrap();
        let matrix = fit.model.matrix;
        assert!((matrix[0][0] + matrix[1][1] + matrix[2][2] - 3.0).abs() < 1e-9);
        let found = report.sensitivity_lsb_per_g.unwrap();
        let mean = (1.03 + 0.98 + 1.01) / 3.0;
        assert!((found / (lsb_per_g * mean) - 1.0).abs() < 1e-9, "{found}");
        assert_eq!(report.sensitivity_source, Some(Source::Fit));
        // The set corrects the counts that it was made from.
        let set = report.parameters.unwrap();
        let (_, first) = data.tracks()[0].vectors().next().unwrap();
        let up = set.correct(Counts(first.map(|v| v.round() as i16)), None);
        assert!((up.norm() - STANDARD_GRAVITY_MPS2).abs() < 0.03);
    }
}

#[test]
fn a_sensitivity_is_the_given_one_or_the_boards_before_the_fits() {
    let board = Unit::Counts { si_per_lsb: Some(STANDARD_GRAVITY_MPS2 / 16384.0) };
    let mut data = pose_means(board, 16384.0 / STANDARD_GRAVITY_MPS2);
    data.tracks_mut()[0].info.full_scale = Some(2.0 * STANDARD_GRAVITY_MPS2);
    let report = calibrate(&data, &CalibrateOptions::default()).unwrap();
    assert_eq!(report.sensitivity_source, Some(Source::Board));
    assert_eq!(report.parameters.unwrap().range_g, 2);
    assert!((report.fit.unwrap().model.matrix[0][0] - 1.03).abs() < 1e-9);

    let options =
        CalibrateOptions { sensitivity_lsb_per_g: Some(16000.0), ..CalibrateOptions::default() };
    let report = calibrate(&data, &options).unwrap();
    assert_eq!(report.sensitivity_source, Some(Source::Given));
    assert_eq!(report.sensitivity_lsb_per_g, Some(16000.0));
}

#[test]
fn the_range_follows_from_the_sensitivity_as_usual() {
    for (lsb_per_g, range_g) in [
        (16384.0, 2),
        (15_900.0, 2),
        (17_400.0, 2),
        (8192.0, 4),
        (2048.0, 16),
        (2027.0, 16),
        (2110.0, 16),
        (1365.33, 16),
        (160.0, 128),
        (65_536.0, 1),
    ] {
        let sensitivity = Sensitivity::from_lsb_per_g(lsb_per_g).unwrap();
        assert_eq!(likely_range_g(sensitivity), range_g, "{lsb_per_g}");
    }
}

#[test]
fn options_out_of_bounds_are_wrong_usage() {
    let data = pose_means(Unit::Si, 1.0);
    for options in [
        CalibrateOptions { gravity_mps2: Some(1.0), ..CalibrateOptions::default() },
        CalibrateOptions { sensitivity_lsb_per_g: Some(f64::NAN), ..CalibrateOptions::default() },
        CalibrateOptions { placement_sd_deg: Some(-1.0), ..CalibrateOptions::default() },
    ] {
        let error = calibrate(&data, &options).unwrap_err();
        assert_eq!((error.code(), error.exit_code()), (ErrorCode::Usage, 2));
    }
}

#[test]
fn a_refusal_says_why_and_which_poses_would_help() {
    let all = pose_means(Unit::Si, 1.0);
    let values: Vec<[f64; 3]> = all.tracks()[0].vectors().map(|(_, value)| value).collect();
    let data = recording_of(Unit::Si, values[..7].iter().copied());
    let report = calibrate(&data, &CalibrateOptions::default()).unwrap();
    assert_eq!((report.outcome.status, report.outcome.exit_code()), ("refused", 3));
    assert!(report.outcome.reason.as_ref().unwrap().contains("7 static poses"));
    assert!(report.next_poses.len() >= 3);
    let json = serde_json::to_value(&report).unwrap();
    assert!(json["next_poses"][0]["text"].is_string());
    assert!(report.to_string().contains("refused: 7 static poses"));

    let options =
        CalibrateOptions { method: MethodChoice::SixPosition, ..CalibrateOptions::default() };
    let faces: Vec<_> = Face::ALL.into_iter().map(|face| Orientation::from(face).up()).collect();
    let up = faces[..5].iter().map(|up| up.map(|axis| axis * STANDARD_GRAVITY_MPS2));
    let data = recording_of(Unit::Si, up);
    let report = calibrate(&data, &options).unwrap();
    assert_eq!(report.next_poses.len(), 1);
    assert_eq!(report.next_poses[0].text, "Z down");
}

#[test]
fn the_json_has_every_field_of_the_interface() {
    let data = pose_means(UNKNOWN_COUNTS, 200.0);
    let json =
        serde_json::to_value(calibrate(&data, &CalibrateOptions::default()).unwrap()).unwrap();
    for field in [
        "method",
        "terms",
        "poses",
        "dof",
        "gravity_m_s2",
        "gravity_source",
        "rms_mm_s2",
        "max_mm_s2",
        "loo_rms_mm_s2",
        "condition",
        "temperature_c",
        "model",
        "sd",
        "rejected_poses",
        "next_poses",
    ] {
        assert!(json.get(field).is_some(), "{field}");
    }
    for shape in ["model", "sd"] {
        assert_eq!(json[shape]["bias_m_s2"].as_array().unwrap().len(), 3);
        assert_eq!(json[shape]["matrix"][2].as_array().unwrap().len(), 3);
        assert!(json[shape].get("temperature").is_some());
        assert!(json[shape].get("nonlinearity").is_some());
    }
}

#[test]
fn a_calibration_file_comes_back_bit_for_bit_and_others_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("CAL.json");
    let data = pose_means(UNKNOWN_COUNTS, 208.937_123);
    let report = calibrate(&data, &CalibrateOptions::default()).unwrap();
    let same = |path: &Path| {
        let set = read_parameters(path).unwrap();
        assert_eq!(Some(set), report.parameters);
        assert_eq!(report.parameter_id, Some(parameter_id(&set).to_string()));
        let model = read_model(path).unwrap();
        assert_eq!((model.model, model.of_counts), (set.model, true));
    };
    report.file.as_ref().unwrap().write(&path).unwrap();
    same(&path);
    let good = std::fs::read_to_string(&path).unwrap();
    for (text, part) in [
        ("{".to_owned(), "not a calibration"),
        ("{\"status\": \"ok\"}".to_owned(), "schema is missing"),
        (good.replace("calibration/2", "calibration/9"), "calibration/9"),
        (good.replace("\"range_g\"", "\"range\""), "no parameters for a board"),
        (good.replace("lsb_per_g\":", "lsb_per_g\": 1e9, \"x\":"), "1000000000"),
        (good.replace("\"bias X\"", "\"bias Y\""), "a covariance"),
        (good.replace("\"condition\":", "\"condition\": -1, \"x\":"), "condition"),
        (good.replace("\"sensors\":", "\"sensors\": [], \"x\":"), "no sensor"),
        (good.replace("\"accelerometer\":", "\"x\":"), "accelerometer"),
    ] {
        std::fs::write(&path, &text).unwrap();
        let error = read_parameters(&path).unwrap_err();
        assert_eq!(error.code(), ErrorCode::BadCalibration);
        assert!(error.message().contains(part), "{part}: {error}");
        assert_eq!(error.exit_code(), 2);
    }
    let error = read_parameters(&folder.path().join("absent.json")).unwrap_err();
    assert_eq!(error.code(), ErrorCode::FileUnreadable);
}

/// A set with everything, of the second sensor of a board.
fn six_axes(set: &ParameterSet) -> ParameterSet {
    let gyroscope = GyroscopeTerms { bias_rad_s: [0.01, -0.02, 0.03], ..GyroscopeTerms::default() };
    let gyroscope = GyroscopeModel::new(gyroscope).unwrap();
    let covariance = [[4e-6, 1e-6, 0.0], [1e-6, 9e-6, 0.0], [0.0, 0.0, 1e-4]];
    ParameterSet {
        sensor_index: 1,
        gyroscope: GyroscopeParameters::new(500, 0.0003, gyroscope, Some([0.001; 12])).ok(),
        alignment: Alignment::from_quaternion([0.9, 0.1, -0.2, 0.3]).unwrap(),
        alignment_covariance: RotationCovariance::from_matrix(&covariance).ok(),
        ..*set
    }
}

#[test]
fn a_file_holds_several_sensors_and_the_sessions_of_each() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("CAL.json");
    let data = pose_means(UNKNOWN_COUNTS, 208.937_123);
    let report = calibrate(&data, &CalibrateOptions::default()).unwrap();
    let first = report.parameters.unwrap();
    let second = six_axes(&first);
    let mut file = CalibrationFile::new(&second, &[], "second.csv");
    file.write(&path).unwrap();
    assert_eq!(read_parameters(&path).unwrap(), second);
    let before = sessions(Some(&path), &second);
    let poses = first.quality.unwrap().terms().poses;
    let session = Session { utc_s: None, file: Some("second.csv".to_owned()), poses };
    assert_eq!(before, [session]);
    // Without new poses the sessions stay; with some there is another.
    let again = CalibrationFile::new(&second, &before, "third.csv");
    assert_eq!(again.sensors[0].accelerometer.sessions, before);
    let more = [Session { poses: 3, ..before[0].clone() }];
    let updated = &CalibrationFile::new(&second, &more, "third.csv").sensors[0];
    assert_eq!(updated.accelerometer.sessions.len(), 2);
    assert_eq!(updated.accelerometer.sessions[1].poses, poses - 3);
    // A board takes the set of sensor 0, wherever it stands.
    file.sensors.extend(report.file.unwrap().sensors);
    assert!(further_sensors(&path).is_empty());
    file.write(&path).unwrap();
    assert_eq!(read_parameters(&path).unwrap(), first);
    assert_eq!(further_sensors(&path), [1]);
    let good = std::fs::read_to_string(&path).unwrap();
    for (value, bad, part) in [
        ("\"range_dps\": 500", "\"range_dps\": 0", "gyroscope range"),
        ("\"rad_s_per_lsb\": 0.0003", "\"rad_s_per_lsb\": 3", "gyroscope sensitivity"),
        ("\"range_dps\": 500", "\"range_dps\": 250", "was edited"),
    ] {
        assert!(good.contains(value), "{good}");
        // Then the second sensor is the first of those in the file.
        let bad = good.replace(value, bad);
        std::fs::write(&path, bad.replace("\"index\": 0", "\"index\": 2")).unwrap();
        let error = read_parameters(&path).unwrap_err();
        assert!(error.message().contains(part), "{part}: {error}");
    }
}

/// Counts of a sensor turned through 12 orientations and held in each, with some noise.
fn turned_counts() -> Vec<[i16; 3]> {
    let mut random = Random::new(1);
    let mut counts = Vec::new();
    for orientation in Orientation::ALL.into_iter().step_by(2) {
        for step in 0..200 {
            let turning = if step < 40 { 400.0 * f64::from(step % 7) } else { 0.0 };
            let up = orientation.up();
            counts.push(up.map(|axis| (axis * 2050.0 + turning) as i16 + random.below(4) as i16));
        }
    }
    counts
}

#[test]
fn a_recording_and_a_csv_file_of_the_same_counts_give_the_same_calibration() {
    let counts = turned_counts();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("counts.csv");
    let mut text =
        "Time (ms),Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)\n".to_owned();
    for (k, [x, y, z]) in counts.iter().enumerate() {
        text.push_str(&format!("{},{x},{y},{z}\n", 10 * k));
    }
    std::fs::write(&path, text).unwrap();
    let from_csv = formats::load(&path, &ReadOptions::default()).unwrap();

    let mut record = LinkHistory::new(LinkRole::Wireless);
    let mut decoder = Decoder::new();
    let mut frame = [0; MAX_FRAME];
    let mut push = |frame: &[u8]| decoder.push(0, frame, |arrival| record.take(&arrival));
    let length = Hello::new(LinkRole::Wireless).encode(&mut frame).unwrap();
    push(&frame[..length]);
    let epoch = <Telemetry>::Epoch(Epoch {
        reason: EpochReason::Start,
        number: 0,
        sequence: 500,
        time_us: 5_000_000,
        period_ns: 10_000_000,
        range_g: 2,
        sensitivity_lsb_per_g: 16384.0,
        full_scale: 32752,
        parameters: 0,
        temperature_centi_c: None,
        ..Epoch::default()
    });
    let length = epoch.encode(&mut frame).unwrap();
    push(&frame[..length]);
    for (index, samples) in counts.chunks(16).enumerate() {
        let samples: Vec<_> = samples.iter().map(|c| Counts(*c)).collect();
        let first = 500 + 16 * index as u32;
        let time = DeviceTimeUs(u64::from(first) * 10_000);
        let length = batch::encode(first, time, &samples, &mut frame).unwrap();
        push(&frame[..length]);
    }
    let from_link = Recording::of_link(&record, "link").unwrap();
    let outputs = |data: &Recording| -> Vec<_> {
        data.samples(Selection::default()).unwrap().iter().collect()
    };
    assert_eq!(outputs(&from_link), outputs(&from_csv));

    let json = |data: &Recording| {
        let report = calibrate(data, &CalibrateOptions::default()).unwrap();
        assert_eq!(report.poses, 13, "{report}");
        let mut json = serde_json::to_value(&report).unwrap();
        let object = json.as_object_mut().unwrap();
        // Only a board knows its full scale and its rate.
        for field in [
            "source",
            "rate_source",
            "range_g",
            "range_source",
            "parameters",
            "parameter_id",
            "units",
        ] {
            object.remove(field);
        }
        json
    };
    assert_eq!(json(&from_link), json(&from_csv));

    // Missing samples end a hold instead of passing for a step.
    let mut gap = record.clone();
    let boot = gap.latest();
    let cut = boot.raw.len() - 100;
    boot.raw.drain(cut..cut + 5);
    let data = Recording::of_link(&gap, "link").unwrap();
    assert_eq!(data.samples(Selection::default()).unwrap().gaps().0, 1);

    // Another range half-way is no calibration.
    let boot = gap.latest();
    let mut mark = boot.epochs[0].clone();
    mark.epoch.range_g = 8;
    boot.epochs.push(mark);
    let error = Recording::of_link(&gap, "link").unwrap_err();
    assert_eq!((error.code(), error.exit_code()), (ErrorCode::DataRefused, 3));
}

/// A file of the folder of public recordings beside the checkout, if it is there.
fn recording(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(name);
    if path.is_file() {
        Some(path)
    } else {
        println!("skipped: {name} of the public recordings, ../shared/data, is absent");
        None
    }
}

fn load(path: &std::path::Path, filter: Option<&str>, poses: bool) -> Recording {
    let options =
        ReadOptions { filter: filter.map(|f| f.parse().unwrap()), poses, ..ReadOptions::default() };
    formats::load(path, &options).unwrap()
}

#[test]
fn eight_real_sensors_reach_the_floor_of_a_float64_reference() {
    let Some(path) = recording("calibration/mpu9150_array_pose_means.csv") else {
        return;
    };
    let options = CalibrateOptions { gravity_mps2: Some(9.818), ..CalibrateOptions::default() };
    // Mean over the sensors of rms and leave-one-out rms, mm/s².
    for (run, rms_floor, loo_floor) in
        [(1, 2.08, 3.79), (2, 1.29, 2.27), (7, 2.05, 3.73), (8, 1.28, 2.33)]
    {
        let (mut rms, mut loo) = (0.0, 0.0);
        for imu in 0..8 {
            let data = load(&path, Some(&format!("Run={run},IMU={imu}")), true);
            let report = calibrate_rows(&data, true, &options).unwrap();
            let fit = report.fit.as_ref().unwrap_or_else(|| panic!("{report}"));
            rms += fit.rms_mm_s2 / 8.0;
            loo += fit.loo_rms_mm_s2.unwrap() / 8.0;
            let sensitivity = report.sensitivity_lsb_per_g.unwrap();
            assert!((sensitivity / 2048.0 - 1.0).abs() < 0.02, "{sensitivity}");
        }
        assert!((rms / rms_floor - 1.0).abs() < 0.01, "run {run}: {rms}");
        assert!((loo / loo_floor - 1.0).abs() < 0.02, "run {run}: {loo}");
    }
}

#[test]
fn the_drift_of_real_sensors_after_a_cold_start_is_found() {
    let Some(path) = recording("calibration/mpu9150_array_pose_means.csv") else {
        return;
    };
    let options = CalibrateOptions { gravity_mps2: Some(9.818), ..CalibrateOptions::default() };
    let with_drift = CalibrateOptions { terms: Terms::NONE.with(Term::Drift), ..options.clone() };
    let drifted = |run: usize, imu: usize, options: &CalibrateOptions| {
        let data = load(&path, Some(&format!("Run={run},IMU={imu}")), true);
        let report = calibrate_rows(&data, true, options).unwrap();
        let mut findings = report.outcome.findings.iter();
        findings.any(|finding| finding.code == FindingCode::Drift)
    };
    let count = |runs: [usize; 2], options| {
        let sensors = (0..16).filter(|k| drifted(runs[k / 8], k % 8, options));
        sensors.count()
    };
    let (cold, warm) = (count([1, 7], &options), count([2, 8], &options));
    println!("drift found: {cold} of 16 sensors after a cold start, {warm} of 16 when warm");
    assert!(cold >= 8 && warm <= 4, "{cold}, {warm}");
    assert_eq!(count([1, 7], &with_drift), 0);
}

#[test]
fn a_navigation_grade_sensor_needs_nine_parameters() {
    let Some(path) = recording("calibration/innalabs_49_pose_means.csv") else {
        return;
    };
    let data = load(&path, None, true);
    let fit = |model| {
        let options = CalibrateOptions { model, ..CalibrateOptions::default() };
        calibrate_rows(&data, true, &options).unwrap()
    };
    let nine = fit(ModelChoice::default());
    assert!(nine.to_string().contains("largest 26.1 at pose 28 (from 0)"), "{nine}");
    let [nine, six, auto] =
        [nine, fit(ModelChoice::Fixed(Model::BiasScale6)), fit(ModelChoice::Auto)]
            .map(|report| report.fit.unwrap());
    assert!((nine.rms_mm_s2 - 8.195).abs() < 0.01);
    assert!((six.rms_mm_s2 - 110.0).abs() < 2.0);
    assert!(auto.loo_rms_mm_s2 <= nine.loo_rms_mm_s2);
}

#[test]
fn ten_real_poses_do_not_support_nine_parameters() {
    let Some(path) = recording("calibration/mpu6050_ten_poses.csv") else {
        return;
    };
    let data = load(&path, None, false);
    let report = calibrate(&data, &CalibrateOptions::default()).unwrap();
    assert_eq!(report.outcome.exit_code(), 3, "{report}");
    assert!(!report.next_poses.is_empty(), "{report}");
}

#[test]
fn six_real_positions_in_counts_and_in_si_are_calibrated() {
    let options = CalibrateOptions {
        method: MethodChoice::SixPosition,
        placement_sd_deg: Some(1.0),
        ..CalibrateOptions::default()
    };
    for name in ["six_position_sections.csv", "six_position.csv"] {
        let Some(path) = recording(&format!("calibration/{name}")) else {
            return;
        };
        let report = calibrate_rows(&load(&path, None, false), false, &options).unwrap();
        let fit = report.fit.as_ref().unwrap_or_else(|| panic!("{report}"));
        println!("{report}");
        assert!(fit.rms_mm_s2 < report.uncalibrated_rms_mm_s2.unwrap() / 5.0, "{report}");
    }
}

#[test]
fn data_that_the_device_corrected_are_reported() {
    let mut data = pose_means(Unit::Si, 1.0);
    let corrected = |data: &Recording| {
        let report = calibrate(data, &CalibrateOptions::default()).unwrap();
        let findings = report.outcome.findings.iter();
        findings.filter(|f| f.code == FindingCode::AlreadyCorrected).count()
    };
    assert_eq!(corrected(&data), 0);
    data.tracks_mut()[0].info.corrected = true;
    assert_eq!(corrected(&data), 1);
}
