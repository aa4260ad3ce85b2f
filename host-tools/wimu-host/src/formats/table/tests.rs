//! Tables of known programs, and damaged ones.

mod damaged;
mod phones;
mod samples;

use std::path::Path;

use super::*;
use crate::formats::load;
use crate::recording::{Origin, Recording, Track};

/// Real files, which are not part of the project; `None` where they are missing.
pub(super) fn data(name: &str) -> Option<std::path::PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(name);
    if !path.exists() {
        eprintln!("skipped: {} is not there", path.display());
    }
    path.exists().then_some(path)
}

pub(super) fn loaded(name: &str, options: &ReadOptions) -> Option<Recording> {
    Some(load(&data(name)?, options).unwrap_or_else(|error| panic!("{name}: {error}")))
}

pub(super) fn text(text: &str) -> Result<Recording> {
    named("table.csv", text, &ReadOptions::default())
}

pub(super) fn named(name: &str, text: &str, options: &ReadOptions) -> Result<Recording> {
    let source = Source::of_bytes(name, text.as_bytes());
    let mut recording = Recording::new(name);
    recording.format = crate::formats::read(&source, options, &mut recording)?;
    Ok(recording)
}

pub(super) fn has(recording: &Recording, code: FindingCode) -> bool {
    recording.findings.iter().any(|finding| finding.code == code)
}

/// Compares with a row of checks.csv.
pub(super) fn check(file: &str, channel: &str, track: &Track) {
    let checks = std::fs::read_to_string(data("formats/checks.csv").unwrap()).unwrap();
    let line = checks.lines().find(|line| line.starts_with(&format!("{file},{channel},"))).unwrap();
    let expected: Vec<f64> =
        line.split(',').skip(3).take(10).map(|text| text.parse().unwrap()).collect();
    let rows: Vec<(i64, [f64; 3])> = track.vectors().collect();
    let (first, last) = (rows[0], rows[rows.len() - 1]);
    let mean = rows.iter().map(|(_, v)| v.iter().map(|c| c * c).sum::<f64>().sqrt()).sum::<f64>()
        / rows.len() as f64;
    let found = [
        rows.len() as f64,
        first.0 as f64 * 1e-9,
        (last.0 - first.0) as f64 * 1e-9,
        first.1[0],
        first.1[1],
        first.1[2],
        last.1[0],
        last.1[1],
        last.1[2],
        mean,
    ];
    for (found, expected) in found.iter().zip(&expected) {
        assert!(
            (found - expected).abs() <= 1e-6 * expected.abs().max(1e-3),
            "{file}: {found} {expected}"
        );
    }
}

#[test]
fn files_of_other_programs_have_their_check_figures() {
    for (file, channel, quantity) in [
        ("euroc_imu0.csv", "accelerometer", Quantity::SpecificForce),
        ("euroc_imu0_excel.csv", "accelerometer", Quantity::SpecificForce),
        ("phyphox_raw_data.csv", "accelerometer", Quantity::LinearAcceleration),
        ("sensor_logger/Accelerometer.csv", "accelerometer", Quantity::LinearAcceleration),
        ("sensor_logger/Gyroscope.csv", "gyroscope", Quantity::AngularRate),
        ("sensor_logger/Gravity.csv", "gravity", Quantity::Gravity),
        ("xsens_mt_manager_old.txt", "accelerometer", Quantity::SpecificForce),
        ("xsens_mt_manager_2022.txt", "accelerometer", Quantity::SpecificForce),
    ] {
        let Some(recording) = loaded(&format!("formats/{file}"), &ReadOptions::default()) else {
            return;
        };
        let track = recording
            .of(quantity)
            .next()
            .unwrap_or_else(|| panic!("{file}: {:?}", recording.findings));
        assert_eq!(track.info.unit, Unit::Si, "{file}");
        check(file, channel, track);
        assert_eq!(has(&recording, FindingCode::Clock), file.contains("excel"), "{file}");
        let without_gravity = quantity == Quantity::LinearAcceleration;
        assert_eq!(has(&recording, FindingCode::GravityMissing), without_gravity, "{file}");
    }
}

#[test]
fn own_tables_keep_every_column() {
    let recording = text(
        "Time (ms),Accelerometer 0 X (LSB),Accelerometer 0 Y (LSB),Accelerometer 0 Z (LSB),Accelerometer 1 X (LSB),\
         Accelerometer 1 Y (LSB),Accelerometer 1 Z (LSB),Sensitivity (LSB/g),Magnetometer X (µT),Magnetometer Y (µT),\
         Magnetometer Z (µT),Temperature (C),Field Calibrated,Truth Position E (m),Truth Position N (m),Truth Position U (m),\
         Truth Quaternion W,Truth Quaternion X,Truth Quaternion Y,Truth Quaternion Z,Note\n\
         0,1,2,256,3,4,255,256,10,0,0,20.5,1,0,0,1,1,0,0,0,start\n\
         10,1,2,256,3,,255,256,,,,,0,,,,,,,,\n\
         20,1,2,512,3,4,511,512,,,,,0,,,,,,,,\n\
         30,1,2,512,3,4,511,,,,,,0,,,,,,,,\n",
    )
    .unwrap();
    let unit = |lsb: f64| Unit::Counts { si_per_lsb: Some(G / lsb) };
    let force: Vec<&Track> = recording.of(Quantity::SpecificForce).collect();
    let of = |k: usize| (force[k].info.sensor, force[k].info.unit, force[k].len());
    assert_eq!(
        [0, 1, 2, 3].map(of),
        [(0, unit(256.0), 2), (1, unit(256.0), 2), (0, unit(512.0), 1), (1, unit(512.0), 1)]
    );
    assert_eq!(force[1].mask(), [true, false]);
    assert_eq!(force[0].info.name, "Accelerometer 0");
    let field = recording.first(Quantity::MagneticField).unwrap();
    assert!((field.row(0).unwrap()[0] - 1e-5).abs() < 1e-18);
    assert_eq!(field.len(), 1);
    assert_eq!(recording.first(Quantity::Temperature).unwrap().row(0), Some(&[20.5][..]));
    let attitude = recording.of(Quantity::Attitude).next().unwrap();
    assert_eq!(
        (attitude.info.origin, attitude.row(0)),
        (Origin::Truth, Some(&[1.0, 0.0, 0.0, 0.0][..]))
    );
    assert_eq!(recording.of(Quantity::Position).next().unwrap().row(0), Some(&[0.0, 0.0, 1.0][..]));
    let scalars: Vec<_> =
        recording.of(Quantity::Scalar).map(|t| (t.info.name.as_str(), t.len())).collect();
    assert_eq!(scalars, [("Sensitivity (LSB/g)", 3), ("Field Calibrated", 4)]);
    let axes =
        text("Time (s),Accelerometer 0 (m/s²),Accelerometer 1 (m/s²)\n0,1,2\n1,1,2\n").unwrap();
    let names: Vec<_> = axes.tracks().iter().map(|t| t.info.name.as_str()).collect();
    assert_eq!(names, ["Accelerometer 0 (m/s²)", "Accelerometer 1 (m/s²)"]);
}

/// Rows of six poses of an accelerometer with this magnitude and output at zero, as text.
fn six_poses(header: &str, magnitude: f64, zero: f64, write: impl Fn(f64) -> String) -> String {
    let mut text = format!("{header}\n");
    let mut time = 0;
    for pose in 0..6 {
        for sample in 0..64 {
            let mut axes = [0.01, -0.02, 0.015].map(|f: f64| f * magnitude);
            axes[pose / 2] = if pose % 2 == 0 { magnitude } else { -magnitude };
            axes[0] += 0.002 * magnitude * f64::from(sample % 5 - 2);
            let fields = axes.map(|value| write(value + zero)).join(",");
            text += &format!("{time},{fields}\n");
            time += 10;
        }
    }
    text
}

fn whole(value: f64) -> String {
    format!("{value:.0}")
}

#[test]
fn units_that_are_not_named_are_inferred_or_asked_for() {
    let decimal = |value: f64| format!("{value:.4}");
    let force = |text: &str, options: &ReadOptions| {
        let recording = named("arduino.csv", text, options)?;
        assert!(has(&recording, FindingCode::UnitInferred), "{:?}", recording.findings);
        let track = recording.first(Quantity::SpecificForce).expect("a force");
        Ok::<_, crate::HostError>((track.info.unit, track.row(0).unwrap()[0], track.times_ns()[1]))
    };
    let (unit, x, step) =
        force(&six_poses("time,ax,ay,az", 9.9, 0.0, decimal), &ReadOptions::default()).unwrap();
    assert_eq!((unit, step), (Unit::Si, 10_000_000));
    assert!((x - 9.9).abs() < 0.1);
    let (unit, x, _) =
        force(&six_poses("millis,ax,ay,az", 1.01, 0.0, decimal), &ReadOptions::default()).unwrap();
    assert_eq!(unit, Unit::Si);
    assert!((x - 9.9).abs() < 0.1);
    let (unit, x, _) =
        force(&six_poses("time,ax,ay,az", 16384.0, 0.0, whole), &ReadOptions::default()).unwrap();
    let Unit::Counts { si_per_lsb: Some(size) } = unit else {
        panic!("{unit:?}");
    };
    assert!((size * 16384.0 / G - 1.0).abs() < 0.01 && x > 16_000.0);
    for (magnitude, write) in
        [(5.0, &decimal as &dyn Fn(f64) -> String), (10.0, &whole), (1000.5, &decimal)]
    {
        let text = six_poses("time,ax,ay,az", magnitude, 0.0, write);
        let error = force(&text, &ReadOptions::default()).unwrap_err();
        assert_eq!(error.code(), ErrorCode::CsvUnknownUnit, "{error}");
        assert!(error.to_string().contains("--units"), "{error}");
    }
    let options = ReadOptions { units: Some("mg".into()), ..ReadOptions::default() };
    let recording =
        named("a.csv", &six_poses("time,ax,ay,az", 1000.5, 0.0, decimal), &options).unwrap();
    assert!((recording.first(Quantity::SpecificForce).unwrap().row(0).unwrap()[0] - G).abs() < 0.1);
    // An angular rate without a unit is left out.
    let text = "time_ms,ax_g,ay_g,az_g,gx,gy,gz\n0,0,0,1.0,1.5,2.5,3.5\n10,0,0,1.0,1.5,2.5,3.5\n";
    let recording = named("a.csv", text, &ReadOptions::default()).unwrap();
    assert!(
        has(&recording, FindingCode::UnitInferred)
            && recording.first(Quantity::AngularRate).is_none()
    );
}

#[test]
fn columns_are_chosen_by_name_or_number() {
    let text =
        "When,Up,Left,Front,Turn a,Turn b,Turn c\n1000,1000,0,0,1,2,3\n1010,1000,0,0,1,2,3\n";
    let columns = "t=When:ms,x=Front:mg,y=3:mg,z=Up:mg,gx=5:deg/s,gy=6:deg/s,gz=Turn c:deg/s";
    let options = ReadOptions { columns: Some(columns.into()), ..ReadOptions::default() };
    let recording = named("a.csv", text, &options).unwrap();
    let force = recording.first(Quantity::SpecificForce).unwrap();
    assert_eq!(
        (force.times_ns()[1], force.row(0)),
        (1_010_000_000, Some(&[0.0, 0.0, 1.0 * 1e-3 * G * 1000.0][..]))
    );
    let rate = recording.first(Quantity::AngularRate).unwrap();
    assert!((rate.row(0).unwrap()[2] - 3.0_f64.to_radians()).abs() < 1e-12);
    for wrong in ["t", "q=1", "x=Back:g", "x=Up:kg"] {
        let options = ReadOptions { columns: Some(wrong.into()), ..ReadOptions::default() };
        let error = named("a.csv", text, &options).unwrap_err();
        assert!(matches!(error.code(), ErrorCode::Usage | ErrorCode::CsvMissingColumn), "{error}");
    }
}

#[test]
fn counts_around_mid_scale_are_those_around_zero() {
    let Some(path) = data("calibration/six_position_sections.csv") else {
        return;
    };
    let original = std::fs::read_to_string(path).unwrap();
    let with = |change: &dyn Fn(i64) -> i64| {
        let line = |line: &str| {
            let fields = line.split(',').enumerate().map(|(k, field)| match field.parse::<i64>() {
                Ok(count) if k > 1 => change(count).to_string(),
                _ => field.to_owned(),
            });
            fields.collect::<Vec<_>>().join(",")
        };
        original.lines().map(line).collect::<Vec<_>>().join("\n")
    };
    let vectors = |recording: &Recording, quantity| {
        recording.first(quantity).unwrap().vectors().map(|row| row.1).collect::<Vec<_>>()
    };
    let expected = text(&original).unwrap();
    assert!(!has(&expected, FindingCode::ZeroCount));
    let shifted = text(&with(&|count| count + 32768)).unwrap();
    let wrapped = text(&with(&|count| count.rem_euclid(65536))).unwrap();
    for found in [shifted, wrapped] {
        assert!(has(&found, FindingCode::ZeroCount));
        for quantity in [Quantity::SpecificForce, Quantity::AngularRate] {
            assert_eq!(
                vectors(&found, quantity),
                vectors(&expected, quantity),
                "{quantity:?} {:?}",
                found.findings
            );
        }
    }
    let options = ReadOptions { zero_count: Some(30_000.0), ..ReadOptions::default() };
    let found = named("a.csv", &with(&|count| count + 30_000), &options).unwrap();
    assert_eq!(
        vectors(&found, Quantity::SpecificForce),
        vectors(&expected, Quantity::SpecificForce)
    );
}

#[test]
fn unsigned_counts_of_all_widths_are_recognised() {
    for (lsb, zero) in
        [(68.0, 512.0), (400.0, 2048.0), (2048.0, 8192.0), (4096.0, 32768.0), (16384.0, 32768.0)]
    {
        let recording = text(&six_poses("time,ax,ay,az", lsb, zero, whole)).unwrap();
        assert!(has(&recording, FindingCode::ZeroCount), "{lsb} {zero}");
        let first = recording.first(Quantity::SpecificForce).unwrap().row(0).unwrap()[0];
        assert!((first / lsb - 1.0).abs() < 0.02, "{lsb} {zero}: {first}");
    }
    // A signed sensor flat on a table, whose small axes happen to be positive.
    for lsb in [68.0, 256.0, 1000.0, 4096.0, 16384.0] {
        let rows: String = (0..100)
            .map(|k| format!("{},{:.0},{:.0},{:.0}\n", 10 * k, 0.02 * lsb, 0.03 * lsb, lsb))
            .collect();
        let recording = text(&format!("time,ax,ay,az\n{rows}")).unwrap();
        assert!(!has(&recording, FindingCode::ZeroCount), "{lsb}: {:?}", recording.findings);
    }
}

#[test]
fn rows_of_several_sensors_are_selected() {
    let Some(path) = data("calibration/mpu9150_array_pose_means.csv") else {
        return;
    };
    let error = load(&path, &ReadOptions::default()).unwrap_err();
    assert!(
        error.code() == ErrorCode::Usage && error.remedy().contains("--where \"Run=1,IMU=0\""),
        "{error}"
    );
    let filter = Some("Run=1,IMU=0".parse().unwrap());
    let recording = load(&path, &ReadOptions { filter, ..ReadOptions::default() }).unwrap();
    let force = recording.first(Quantity::SpecificForce).unwrap();
    assert_eq!(force.row(0), Some(&[-42.40795, -1961.232915, 596.84728][..]));
    let samples = recording.tracks().iter().find(|track| track.info.name == "Samples").unwrap();
    assert_eq!((samples.len(), samples.row(0)), (force.len(), Some(&[1434.0][..])));
}

/// Rows of a time and an acceleration of 1 g along z, in g.
fn timed(header: &str, times: [&str; 3]) -> Recording {
    let rows = times.map(|time| format!("{time},0,0.5,1.0\n")).concat();
    text(&format!("{header},ax (g),ay (g),az (g)\n{rows}")).unwrap()
}

#[test]
fn time_columns_are_recognised_by_unit_or_word() {
    for (header, times, step) in [
        ("Time (min)", ["0", "0.5", "1"], 30_000_000_000),
        ("t (minutes)", ["0.00016666667", "0.0003333333", "1"], 10_000_002),
        ("Time (h)", ["0", "0.001", "0.002"], 3_600_000_000),
        ("time_hours", ["100", "100.001", "100.002"], 3_600_000_000),
        ("seconds", ["1", "2", "3"], 1_000_000_000),
        ("sec", ["1.01", "1.02", "1.03"], 10_000_000),
        ("ms", ["10", "20", "30"], 10_000_000),
        ("us", ["10", "20", "30"], 10_000),
        ("unix_timestamp", ["1700000000.5", "1700000000.6", "1700000000.7"], 100_000_000),
        ("unix time", ["1700000000500", "1700000000600", "1700000000700"], 100_000_000),
        ("Accelerometer Timestamp (s)", ["5", "5.01", "5.02"], 10_000_000),
        ("time of sample ms", ["10", "20", "30"], 10_000_000),
        ("hh:mm:ss.fff", ["12:00:01.250", "12:00:01.260", "12:00:01.270"], 10_000_000),
        ("hh:mm:ss(.fff)", ["12:00:01.250", "12:00:01.260", "12:00:01.270"], 10_000_000),
        ("Recording time", ["12:00:01.250", "12:00:01.260", "12:00:01.270"], 10_000_000),
    ] {
        let recording = timed(header, times);
        let found = recording.first(Quantity::SpecificForce).unwrap().times_ns();
        assert!((found[1] - found[0] - step).abs() < 10, "{header}: {found:?}");
        assert!(!has(&recording, FindingCode::Rate), "{header}");
    }
    // A better time counts, as do none of several parts of a time or a column that does not increase.
    let table =
        |header: &str, rows: &str| text(&format!("{header},ax_g,ay_g,az_g\n{rows}")).unwrap();
    let better = table("ms,t", "1,5.0,0,0,1\n2,5.5,0,0,1\n");
    let force = better.first(Quantity::SpecificForce).unwrap();
    assert_eq!(force.times_ns()[1], 5_500_000_000);
    let parts = table("sec,usec", "1,999000,0,0,1\n2,4000,0,0,1\n");
    assert!(has(&parts, FindingCode::Rate));
    assert!(has(&timed("run time", ["3", "2", "1"]), FindingCode::Rate));
}

#[test]
fn unknown_units_of_times_are_reported() {
    let recording = timed("Time (days)", ["0", "0.1", "0.2"]);
    let finding = recording.findings.iter().find(|finding| finding.evidence.contains("`days`"));
    let finding = finding.unwrap();
    assert_eq!(finding.severity, Severity::Warning);
    assert!(finding.remedy.contains("t=COLUMN:s"), "{finding}");
}

#[test]
fn short_file_names_name_no_quantity() {
    let of = |name| named(name, "t,x,y,z\n0,0.1,0.2,9.8\n1,0.1,0.2,9.8\n", &ReadOptions::default());
    for name in ["h.csv", "a.csv", "gy.csv"] {
        assert_eq!(of(name).unwrap_err().code(), ErrorCode::CsvMissingColumn, "{name}");
    }
    assert!(of("acc.csv").unwrap().first(Quantity::SpecificForce).is_some());
}

#[test]
fn tables_of_metawear_and_sensorlog_are_read() {
    for text in [
        "epoch (ms),time (13:00),elapsed (s),x-axis (g),y-axis (g),z-axis (g)\n\
         1700000000000,2023-11-14T22:13:20.000,0,0,0.5,1\n1700000000010,2023-11-14T22:13:20.010,0.01,0,0.5,1\n",
        "loggingTime(txt),loggingSample(N),accelerometerTimestamp_sinceReboot(s),accelerometerAccelerationX(G),\
         accelerometerAccelerationY(G),accelerometerAccelerationZ(G)\n\
         2023-11-14 23:13:20.000 +0100,1,51.2,0,0.5,1\n2023-11-14 23:13:20.010 +0100,2,51.21,0,0.5,1\n",
    ] {
        let recording = named("export.csv", text, &ReadOptions::default()).unwrap();
        let force = recording.first(Quantity::SpecificForce).unwrap();
        assert_eq!(force.times_ns(), [1_700_000_000_000_000_000, 1_700_000_000_010_000_000]);
        assert_eq!(force.row(0), Some(&[0.0, 0.5 * G, G][..]));
    }
}

#[test]
fn decimal_commas_between_commas_are_refused_with_the_cause() {
    let table = |header: &str, row: &str, rows| text(&format!("{header}\n{}", row.repeat(rows)));
    for rows in [20, 5500] {
        let header = "Time (s),ax (g),ay (g),az (g)";
        let error = table(header, "0,01,0,02,0,03,0,98\n", rows).unwrap_err();
        let message = error.to_string();
        assert_eq!(error.code(), ErrorCode::BadRecording, "{message}");
        assert!(message.contains("decimal commas"), "{message}");
        assert!(error.remedy().contains("semicolons"), "{message}");
        assert_eq!(message.contains("1000 of the first 1000 rows"), rows > 1000, "{message}");
    }
    // The halves of numbers are not read as columns without a header.
    let error = table("x,y,z", "0,02,0,03,0,98\n", 20).unwrap_err();
    assert_eq!(error.code(), ErrorCode::CsvMissingColumn, "{error}");
}

#[test]
fn mixed_units_of_a_vector_are_reported() {
    let with = |columns: &str| {
        let options = ReadOptions { columns: Some(columns.into()), ..ReadOptions::default() };
        named("a.csv", "a,b,c,d\n0,0,0,1\n1,0,0,1\n", &options).unwrap().findings
    };
    let is_mixed = |finding: &Finding| {
        finding.severity == Severity::Warning && finding.evidence.contains("different units")
    };
    assert!(with("t=1:s,x=2:m/s2,y=3:g,z=4:g").iter().any(is_mixed));
    assert!(!with("t=1:s,x=2:g,y=3:g,z=4:g").iter().any(is_mixed));
}
