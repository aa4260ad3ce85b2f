//! Calibration files: what comes back from them, and what is refused.

use std::path::Path;

use wimu_calib::Orientation;
use wimu_host::calibration::parameter_id;
use wimu_host::calibration::{
    self, CalibrateOptions, Calibration, CalibrationReport, Session, read_parameters,
};
use wimu_host::capture::Link;
use wimu_host::decode::Decoder;
use wimu_host::formats::{self, ReadOptions};
use wimu_host::recording::{Quantity, Recording, Selection, Sink, TrackInfo, Unit};
use wimu_host::{Code, Result};
use wimu_link::batch::Stream;
use wimu_link::{LinkRole, Telemetry};
use wimu_model::{
    Alignment, Counts, ErrorModel, ErrorTerms, GyroscopeModel, GyroscopeParameters, GyroscopeTerms,
    ParameterSet, RotationCovariance, STANDARD_GRAVITY_MPS2, SpecificForceMps2,
};
use wimu_testkit::Random;

use crate::common::frames::{self, raw, telemetry};

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
    let selection = Selection { accelerometer: None, poses };
    calibration::calibrate(&data.samples(selection)?, options)
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
        let calibration = Calibration::read(path).unwrap();
        assert_eq!(calibration.sensor().accelerometer.model, set.model);
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
        assert_eq!(error.code, Code::BadCalibration);
        assert!(error.text.contains(part), "{part}: {error}");
        assert_eq!(error.exit_code(), 2);
    }
    let error = read_parameters(&folder.path().join("absent.json")).unwrap_err();
    assert_eq!(error.code, Code::FileUnreadable);
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
    let file = Calibration::held(&second);
    file.write(&path).unwrap();
    assert_eq!(read_parameters(&path).unwrap(), second);
    let sessions = |file: &Calibration| file.sensor().accelerometer.sessions.clone();
    let before = sessions(&Calibration::read(&path).unwrap());
    let poses = first.quality.unwrap().terms().poses;
    assert_eq!(before, [Session { utc_s: None, file: None, poses }]);
    // A board takes the set of sensor 0, wherever it stands.
    assert!(file.further().is_empty());
    let file = file.and(report.file.unwrap());
    file.write(&path).unwrap();
    assert_eq!(read_parameters(&path).unwrap(), first);
    assert_eq!(file.further(), [1]);
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
        assert!(error.text.contains(part), "{part}: {error}");
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

    let mut record = Link::new(LinkRole::Wireless);
    let mut decoder = Decoder::new();
    let mut push = |frame: &[u8]| decoder.push(0, frame, |arrival| record.take(&arrival));
    push(&frames::hello(LinkRole::Wireless, 0, 0));
    push(&telemetry(&Telemetry::Epoch(frames::epoch(500, 5_000_000))));
    for (first, samples) in (500..).step_by(16).zip(counts.chunks(16)) {
        let samples: Vec<_> = samples.iter().map(|c| Counts(*c)).collect();
        push(&raw(first, u64::from(first) * 10_000, &samples));
    }
    let from_link = Recording::of_link(&record, "link").unwrap();
    let outputs = |data: &Recording| -> Vec<_> {
        data.samples(Selection::default()).unwrap().iter().collect()
    };
    assert_eq!(outputs(&from_link), outputs(&from_csv));

    let json = |data: &Recording| {
        let report = calibrate(data, &CalibrateOptions::default()).unwrap();
        assert_eq!(report.poses.len(), 13, "{report}");
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
    let raw = boot.samples.get_mut(&(0, Stream::Raw)).unwrap();
    let cut = raw.len() - 100;
    raw.drain(cut..cut + 5);
    let data = Recording::of_link(&gap, "link").unwrap();
    assert_eq!(data.samples(Selection::default()).unwrap().gaps().0, 1);

    // Another range half-way is no calibration.
    let boot = gap.latest();
    let mut mark = boot.epochs()[0].clone();
    mark.epoch.range_g = 8;
    boot.marks.entry(0).or_default().push(mark);
    let error = Recording::of_link(&gap, "link").unwrap_err();
    assert_eq!((error.code, error.exit_code()), (Code::DataRefused, 3));
}
