//! A magnetometer from a session on a board to the corrected field in its exports.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{Transcript, folder, in_folder, record_calibrated, record_motion, wimu};
use wimu_host::calibration::read_parameters;
use wimu_sim::board::SensorPart;
use wimu_sim::truth::{Gauge, SensorTruth};

const SEED: u64 = 3;

/// Asserts that S Rᵀ of a calibration, scaled to determinant one, and its hard iron are the truth's within
/// four of their own standard deviations.
fn agrees_with_the_truth(calibration: &Path) {
    let truth = SensorTruth::random(SEED, Gauge::LowerTriangular).magnetometer;
    let model = read_parameters(calibration).unwrap().magnetometer.unwrap();
    let terms = model.terms();
    let mounting = terms.to_accelerometer.unwrap();
    for axis in 0..3 {
        let off = f64::from(terms.hard_iron_nt[axis]) - truth.hard_iron_nt[axis];
        let sd = f64::from(terms.hard_iron_sd_nt[axis]);
        println!("hard iron {axis}: off {off:.0} nT, sd {sd:.0} nT");
        assert!(sd < 200.0 && off.abs() < 4.0 * sd, "{off} {sd}");
    }
    let m = truth.soft_iron;
    let determinant = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
        - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
    let s = model.soft_iron();
    let largest = |sds: &[f64]| sds.iter().copied().fold(0.0, f64::max);
    let soft = largest(&terms.soft_iron_sd.map(f64::from));
    let sd = soft.hypot(largest(&[0, 1, 2].map(|axis| mounting.covariance.sd(axis))));
    let mut worst = 0.0_f64;
    for column in 0..3 {
        let mut unit = [0.0; 3];
        unit[column] = 1.0;
        // Rᵀ e.
        let rows = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
            .map(|axis| mounting.rotation.rotate(axis));
        let back = rows.map(|row| (0..3).map(|k| row[k] * unit[k]).sum::<f64>());
        for row in 0..3 {
            let found: f64 = (0..3).map(|k| s[row][k] * back[k]).sum();
            let off = found - m[row][column] / determinant.cbrt();
            assert!(off.abs() < 4.0 * sd, "{row} {column}: {off} {sd}");
            worst = worst.max(off.abs());
        }
    }
    println!("soft iron and rotation: off {worst:.4} at most, sd {sd:.4}");
    assert!(sd < 0.005, "{sd}");
}

#[test]
fn a_session_in_many_orientations_gives_the_iron_that_is_there_and_a_field_without_it() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (recording, accelerometer, both) = (path("s.mcap"), path("A.json"), path("BOTH.json"));
    record_motion("twelve-poses,six-positions,tilts", SEED, &recording);
    let of = ["calibrate", &recording, "--method", "magnetometer"];
    // The board's accelerometer is uncalibrated, and no other calibration is given.
    wimu(&of).fails(3, "data_refused");
    wimu(&["calibrate", &recording, "-o", &accelerometer]).succeeds();
    let with = ["--with", &accelerometer, "-o", &both];
    let ran = wimu(&[&of[..], &with].concat());
    let report = ran.succeeds();
    let mut texts = Transcript::default();
    texts.text("calibrate --method magnetometer", &ran);
    texts.check("calibrate_magnetometer");
    assert_eq!(report["sensor"], "magnetometer");
    assert!(report["poses"].as_array().unwrap().len() >= 20, "{report}");
    // 20 µT north, 44 µT down.
    let dip = report["dip_deg"].as_f64().unwrap();
    assert!((dip - 2.2_f64.atan().to_degrees()).abs() < 0.5, "{dip}");
    agrees_with_the_truth(Path::new(&both));
    // The accelerometer's calibration is still the one that went in.
    let [before, after] = [&accelerometer, &both].map(|p| read_parameters(Path::new(p)).unwrap());
    assert_eq!((before.model, before.quality), (after.model, after.quality));

    for other in [["--model", "9"], ["--method", "six-position"]] {
        wimu(&[&of[..], &other].concat()).fails(2, "usage");
    }
    wimu(&[&of[..], &["--push"]].concat()).fails(2, "usage");
    let accelerometer_with = ["calibrate", &recording, "--with", &accelerometer];
    wimu(&accelerometer_with).fails(2, "usage");

    // Pushed, exports have the field with and without its errors, and say which is which.
    let pushed = path("pushed.mcap");
    record_calibrated(SensorPart::Lsm303agr, &both, "tilts", SEED, &pushed);
    let spread = |stream: &str| {
        let table = path(&format!("{stream}.csv"));
        wimu(&["convert", &pushed, "-o", &table, "--stream", stream]).succeeds();
        let text = fs::read_to_string(&table).unwrap();
        let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
        let header = lines.next().unwrap();
        let column = |name: &str| header.iter().position(|h| h.starts_with(name));
        let field = ["X", "Y", "Z"].map(|axis| column(&format!("Magnetometer {axis}")).unwrap());
        let calibrated = column("Field Calibrated");
        assert_eq!(calibrated.is_some(), stream == "corrected");
        let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
        for line in lines.skip(100).filter(|line| !line[field[0]].is_empty()) {
            assert!(calibrated.is_none_or(|column| line[column] == "1"));
            let square = |k: usize| line[k].parse::<f64>().unwrap().powi(2);
            let length = field.map(square).iter().sum::<f64>().sqrt();
            (least, most) = (least.min(length), most.max(length));
        }
        println!("{stream}: |B| from {least:.2} to {most:.2} µT");
        most - least
    };
    let (raw, corrected) = (spread("raw"), spread("corrected"));
    assert!(corrected < 3.0 && raw > 10.0, "{raw} {corrected}");
    let topics = path("topics.mcap");
    let exported = wimu(&["convert", &pushed, "-o", &topics]).succeeds();
    let count = |topic: &str| exported["messages"][topic].as_u64().unwrap();
    assert!(count("/cable/imu/mag_corrected") > 10, "{exported}");
    assert!(count("/cable/imu/mag") >= count("/cable/imu/mag_corrected"));

    // A board reports the calibration of its accelerometer; one pose is too few.
    let still = path("still.mcap");
    record_calibrated(SensorPart::Lsm303agr, &both, "rest", SEED, &still);
    let alone = wimu(&["calibrate", &still, "--method", "magnetometer"]);
    alone.refuses();
}

#[test]
fn too_few_orientations_or_no_magnetometer_are_refused() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (recording, accelerometer, never) = (path("six.mcap"), path("A.json"), path("NO.json"));
    record_motion("six-positions", SEED, &recording);
    wimu(&["calibrate", &recording, "--method", "six-position", "-o", &accelerometer]).succeeds();
    let with = ["--method", "magnetometer", "--with", &accelerometer];
    let few = wimu(&[&["calibrate", &recording, "-o", &never][..], &with].concat());
    let mut texts = Transcript::default();
    let report = texts.refuses("six poses", &few);
    assert!(report["parameters"].is_null() && !Path::new(&never).exists());

    // Means of poses in a file: the same orientation over and over, then without a magnetometer.
    let (csv, _folder) = in_folder("means.csv");
    let axes = |name: &str, unit: &str| {
        ["X", "Y", "Z"].map(|axis| format!("{name} {axis} ({unit})")).join(",")
    };
    let mut text = format!("{},{}\n", axes("Accelerometer", "LSB"), axes("Magnetometer", "µT"));
    for _ in 0..20 {
        text += "0,0,16384,20,0,-44\n";
    }
    fs::write(&csv, &text).unwrap();
    let of = ["calibrate", &csv, "--poses"];
    let same = wimu(&[&of[..], &with].concat());
    let report = texts.refuses("one orientation", &same);
    assert_eq!(report["poses"].as_array().unwrap().len(), 20);
    // A CSV file does not contain the calibration of its accelerometer.
    let ran = wimu(&[&of[..], &["--method", "magnetometer"]].concat());
    texts.fails("accelerometer not calibrated", &ran, 3, "data_refused");

    let mut text = axes("Accelerometer", "LSB");
    for _ in 0..20 {
        write!(text, "\n0,0,16384").unwrap();
    }
    fs::write(&csv, text).unwrap();
    let ran = wimu(&[&of[..], &with].concat());
    texts.fails("no magnetometer", &ran, 2, "csv_missing_column");
    texts.check("calibrate_magnetometer_too_little");
}
