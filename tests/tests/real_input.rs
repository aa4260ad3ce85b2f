//! A real sensor's counts through the driver, the node, the wire and a recording: nothing is lost
//! on the way, and a calibration of the recording is one of the file.

use serde_json::Value;
use wimu_calib::MultiPosition;
use wimu_host::calibration::{CalibrateOptions, CalibrationReport, calibrate};
use wimu_host::capture;
use wimu_host::csv::Filter;
use wimu_host::formats::{self, ReadOptions};
use wimu_host::recording::{Recording, Selection};
use wimu_link::LinkRole;
use wimu_model::{CalibrationMethod, Counts};
use wimu_sim::board::BoardConfig;
use wimu_sim::source::Replay;
use wimu_testkit::figure;
use wimu_tests::{ROLES, Rig, assert_replays, data};

/// Replays counts on a board until the last has arrived.
fn replayed(counts: &[Counts]) -> capture::Capture {
    let config = BoardConfig { replay: true, ..BoardConfig::default() };
    let source = Replay::new(counts.iter().copied()).waiting_for_reader();
    let mut rig = Rig::new(config, source);
    while !rig.board.sensor().finished() {
        rig.run(1.0);
    }
    rig.run(2.0);
    for role in ROLES {
        rig.link(role).assert_perfect();
    }
    rig.recording()
}

/// The report, without what must differ: where the data are, how the rate is known, and what only
/// a board can know.
fn essence(report: &CalibrationReport) -> Value {
    let mut json = serde_json::to_value(report).unwrap();
    let object = json.as_object_mut().unwrap();
    for key in ["source", "rate_source", "parameter_id"] {
        object.remove(key).unwrap();
    }
    // A board that replays the counts of an accelerometer has no gyroscope.
    for key in ["range_g", "range_source", "gyroscope"] {
        object.remove(key);
    }
    if let Some(parameters) = object.get_mut("parameters").and_then(Value::as_object_mut) {
        parameters.remove("gyroscope");
    }
    let poses = object.get_mut("static_poses");
    for pose in poses.and_then(Value::as_array_mut).into_iter().flatten() {
        // By the device's clock, and by the file's.
        let micros = pose["time_s"].as_f64().unwrap() * 1e6;
        pose["time_s"] = (micros.round() as i64).into();
    }
    object.remove("units");
    if let Some(parameters) = object["parameters"].as_object_mut() {
        parameters.remove("range_g").unwrap();
    }
    json
}

fn options() -> [(&'static str, CalibrateOptions); 4] {
    let multi = |priors| CalibrateOptions {
        model: MultiPosition { priors, ..MultiPosition::default() },
        ..CalibrateOptions::default()
    };
    let six_positions =
        CalibrateOptions { method: CalibrationMethod::SixPosition, ..CalibrateOptions::default() };
    let more_known = CalibrateOptions {
        sensitivity_lsb_per_g: Some(2048.0),
        gravity_mps2: Some(9.81),
        ..multi(true)
    };
    [
        ("12", six_positions),
        ("9", multi(false)),
        ("auto", multi(true)),
        ("auto at 2048 LSB/g and 9.81 m/s²", more_known),
    ]
}

/// Calibrates from the file and from a recording of its replay; returns what was answered, the
/// rest being refused, or `None` without the file.
fn alike(file: &str) -> Option<Vec<&'static str>> {
    let path = data(file)?;
    let from_file = formats::load(&path, &ReadOptions::default()).unwrap();
    let from_file = from_file.samples(Selection::default()).unwrap();
    let counts = from_file.counts().unwrap();
    let recording = replayed(&counts);
    let mut answered = Vec::new();
    for role in ROLES {
        let link = recording.link(Some(role)).unwrap();
        let [boot] = &link.boots[..] else {
            panic!("one start, not {}", link.boots.len());
        };
        let arrived: Vec<Counts> = boot
            .raw()
            .iter()
            .map(|sample| Counts(sample.value.map(|axis| axis.try_into().unwrap())))
            .collect();
        figure(
            &format!("{file}: counts through board and {role}, arrived"),
            format!("{} of {}", arrived.len(), counts.len()),
            "all",
            arrived == counts,
        );
        assert_eq!(arrived.len(), counts.len());
        assert!(arrived == counts, "every count, bit for bit");
        assert_replays(boot);

        let from_recording = Recording::of_link(link, "the recording").unwrap();
        let from_recording = from_recording.samples(Selection::default()).unwrap();
        answered.clear();
        for (name, options) in options() {
            let [ours, theirs] = [&from_recording, &from_file].map(|data| {
                let report = calibrate(data, &options).unwrap();
                println!("{file}, {name}: {}", report.outcome.reason.as_deref().unwrap_or("ok"));
                (report.outcome.exit_code(), essence(&report))
            });
            assert_eq!(ours.0, theirs.0, "{role}, {name}");
            assert!(alike_in(&ours.1, &theirs.1), "{role}, {name}: {} {}", ours.1, theirs.1);
            if ours.0 == 0 {
                answered.push(name);
            }
        }
    }
    Some(answered)
}

/// Whether two reports are the same to 1e-6. The times of the board are whole microseconds, which with a drift changes last digits.
fn alike_in(ours: &Value, theirs: &Value) -> bool {
    match (ours, theirs) {
        (Value::Object(ours), Value::Object(theirs)) => {
            ours.len() == theirs.len()
                && ours
                    .iter()
                    .all(|(key, value)| theirs.get(key).is_some_and(|other| alike_in(value, other)))
        }
        (Value::Array(ours), Value::Array(theirs)) => {
            let pairs = ours.iter().zip(theirs);
            ours.len() == theirs.len() && pairs.into_iter().all(|(a, b)| alike_in(a, b))
        }
        (Value::Number(ours), Value::Number(theirs)) => {
            let [a, b] = [ours, theirs].map(|number| number.as_f64().unwrap());
            (a - b).abs() <= 1e-6 * a.abs().max(b.abs())
        }
        _ => ours == theirs,
    }
}

#[test]
fn six_positions_of_a_real_sensor_calibrate_alike_from_the_file_and_through_the_board() {
    if let Some(answered) = alike("calibration/six_position_sections.csv") {
        assert_eq!(answered, ["12", "auto", "auto at 2048 LSB/g and 9.81 m/s²"]);
    }
}

#[test]
fn ten_poses_of_a_real_sensor_calibrate_or_are_refused_alike() {
    if let Some(answered) = alike("calibration/mpu6050_ten_poses.csv") {
        assert_eq!(answered, ["12", "auto"]);
    }
}

/// Means over the eight sensors of the array: in-sample and leave-one-out rms, mm/s².
fn array(run: u32) -> Option<[f64; 2]> {
    let path = data("calibration/mpu9150_array_pose_means.csv")?;
    let options = CalibrateOptions { gravity_mps2: Some(9.818), ..CalibrateOptions::default() };
    let mut sums = [0.0; 2];
    for imu in 0..8 {
        let filter: Filter = format!("Run={run},IMU={imu}").parse().unwrap();
        let mut load = ReadOptions::default();
        (load.filter, load.poses) = (Some(filter), true);
        let data = formats::load(&path, &load).unwrap();
        let selection = Selection { accelerometer: None, poses: true };
        let data = data.samples(selection).unwrap();
        let report = calibrate(&data, &options).unwrap();
        let fit = report.estimate.as_ref().unwrap_or_else(|| panic!("{:?}", report.outcome.reason));
        assert!((1.5..4.0).contains(&fit.condition()), "{}", fit.condition());
        let sensitivity = report.sensitivity_lsb_per_g().unwrap();
        assert!((sensitivity / 2048.0 - 1.0).abs() < 0.03, "{sensitivity}");
        sums[0] += fit.rms_mps2 * 1e3 / 8.0;
        sums[1] += fit.loo_rms_mps2.unwrap() * 1e3 / 8.0;
    }
    Some(sums)
}

#[test]
fn an_array_of_real_sensors_is_calibrated_as_well_as_by_the_reference() {
    // Floor figures of a float64 reference for these recordings.
    for (run, reference) in
        [(1, [2.08, 3.79]), (2, [1.29, 2.27]), (7, [2.05, 3.73]), (8, [1.28, 2.33])]
    {
        let Some(found) = array(run) else { return };
        println!("run {run}: {found:.3?} mm/s², reference {reference:?}");
        for (found, reference) in found.into_iter().zip(reference) {
            assert!(
                (found - reference).abs() <= 0.02 * reference,
                "run {run}: {found} against {reference}"
            );
        }
    }
}

#[test]
fn only_raw_counts_are_replayed() {
    let Some(path) = data("calibration/six_position.csv") else {
        return;
    };
    let in_si = formats::load(&path, &ReadOptions::default()).unwrap();
    let error = in_si.samples(Selection::default()).unwrap().counts().unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.remedy.contains("LSB"), "{error}");
}

#[test]
fn a_recording_of_real_counts_is_perfect_on_both_links_at_once() {
    let Some(path) = data("array/mimu4444_run1.csv") else {
        return;
    };
    let selection = Selection { accelerometer: Some(0), poses: false };
    let data = formats::load(&path, &ReadOptions::default()).unwrap();
    let counts = data.samples(selection).unwrap().counts().unwrap();
    let tail = &counts[counts.len() - 7500..];
    let recording = replayed(tail);
    for role in [LinkRole::Cable, LinkRole::Wireless] {
        let link = recording.link(Some(role)).unwrap();
        assert_eq!(link.statistics.raw.received, 7500);
    }
}
