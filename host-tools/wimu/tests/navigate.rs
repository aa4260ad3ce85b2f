//! `wimu navigate` as scripts use it: columns, keys, reports and refusals.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{Transcript, folder, record_motion, wimu};
use serde_json::Value;

const G: f64 = 9.80665;

/// A recording of 8 s at 100 Hz: rest, 0.5 m along x in 1.5 s, rest.
#[derive(Clone, Copy)]
struct Made {
    field: bool,
    gyroscope: bool,
    truth: bool,
    /// From here on the field is another, s.
    magnet_s: f64,
    /// Shaken from the start on.
    shaken: bool,
}

const PLAIN: Made =
    Made { field: true, gyroscope: false, truth: true, magnet_s: f64::INFINITY, shaken: false };

impl Made {
    fn header(self) -> String {
        let mut text = String::from("Time (s)");
        let mut columns = |name: &str, axes: &[&str], unit: &str| {
            for axis in axes {
                write!(text, ",{name} {axis}{unit}").unwrap();
            }
        };
        let axes = ["X", "Y", "Z"];
        columns("Accelerometer", &axes, " (m/s²)");
        if self.gyroscope {
            columns("Gyroscope", &axes, " (deg/s)");
        }
        if self.field {
            columns("Magnetometer", &axes, " (µT)");
        }
        if self.truth {
            columns("Truth Position", &["E", "N", "U"], " (m)");
            columns("Truth Quaternion", &["W", "X", "Y", "Z"], "");
        }
        text
    }

    fn row(self, k: u32) -> String {
        let t = f64::from(k) * 0.01;
        let tau = ((t - 3.0) / 1.5).clamp(0.0, 1.0);
        let push = 60.0 * tau * (1.0 - tau) * (1.0 - 2.0 * tau) * 0.5 / 2.25;
        let way = 0.5 * tau.powi(3) * (10.0 - 15.0 * tau + 6.0 * tau * tau);
        let noise = f64::from((k * 7919) % 13) * 0.004 - 0.024;
        let shake = if self.shaken { 4.0 * (9.0 * t).sin() } else { 0.0 };
        let mut text = format!("{t:.2},{},{},{}", push + noise + shake, -noise, G + noise);
        if self.gyroscope {
            write!(text, ",{},0,{}", noise, -noise).unwrap();
        }
        if self.field {
            let other = if t < self.magnet_s { 0.0 } else { 150.0 };
            write!(text, ",{},{},{}", noise + other, 20.0 + noise, -44.0 - other).unwrap();
        }
        if self.truth {
            write!(text, ",{way},0,0,1,0,0,0").unwrap();
        }
        text
    }

    fn text(self) -> String {
        let rows = (0..800).map(|k| self.row(k));
        let all: Vec<String> = std::iter::once(self.header()).chain(rows).collect();
        all.join("\n") + "\n"
    }

    fn write(self, folder: &Path, name: &str) -> String {
        let path = folder.join(name);
        fs::write(&path, self.text()).unwrap();
        path.display().to_string()
    }
}

fn number(value: &Value, pointer: &str) -> f64 {
    let found = value.pointer(pointer).and_then(Value::as_f64);
    found.unwrap_or_else(|| panic!("{pointer} of {value}"))
}

#[test]
fn with_and_without_a_gyroscope_the_promised_columns_keys_and_report_are_written() {
    let folder = folder();
    let out = folder.path().join("path.csv").display().to_string();
    let page = folder.path().join("page.html").display().to_string();
    let mut texts = Transcript::default();
    for (gyroscope, method) in [(true, "strapdown"), (false, "tilt")] {
        let csv = Made { gyroscope, ..PLAIN }.write(folder.path(), "in.csv");
        let arguments = ["navigate", &csv, "--setup", "limit_m=0.5"];
        let files = ["-o", &out, "--report", &page];
        let ran = wimu(&[&arguments[..], &files].concat());
        let report = ran.succeeds();
        assert_eq!(report["method"], method);
        assert!((number(&report, "/duration_s") - 7.99).abs() < 1e-9);
        // Over the samples that are known to the limit.
        assert!((0.1..1.5).contains(&number(&report, "/distance_m")), "{report}");
        for axis in 0..3 {
            number(&report, &format!("/final_position_m/{axis}"));
            assert!(number(&report, &format!("/final_sigma_m/{axis}")) >= 0.0);
        }
        assert!(report["final_valid"].is_boolean());
        assert!((0.0..=1.0).contains(&number(&report, "/valid_share")));
        assert_eq!(number(&report, "/horizon/limit_m"), 0.5);
        for key in ["to_0_1_m_s", "to_1_m_s", "to_limit_s"] {
            let value = &report["horizon"][key];
            assert!(value.is_null() || value.as_f64().is_some_and(|s| s > 0.0), "{report}");
        }
        assert!(number(&report, "/nees/samples") > 100.0);
        assert!(number(&report, "/nees/share_below_7_81") > 0.85, "{report}");
        number(&report, "/nees/median");
        assert!(report["problems"].is_array());
        texts.text(method, &ran);

        let text = fs::read_to_string(&out).unwrap();
        assert_eq!(
            text.lines().next().unwrap(),
            "Time (s),Position E (m),Position N (m),Position U (m),Velocity E (m/s),\
             Velocity N (m/s),Velocity U (m/s),Quaternion W,Quaternion X,Quaternion Y,\
             Quaternion Z,Angular Rate X (rad/s),Angular Rate Y (rad/s),Angular Rate Z (rad/s),\
             Sigma E (m),Sigma N (m),Sigma U (m),Valid"
        );
        let rows: Vec<Vec<f64>> = text
            .lines()
            .skip(1)
            .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
            .collect();
        assert_eq!(rows.len(), 800);
        for row in &rows {
            assert_eq!(row.len(), 18);
            let sigma = row[14..17].iter().map(|s| s * s).sum::<f64>().sqrt();
            assert!(row[17] == 0.0 || row[17] == 1.0 && sigma <= 0.5001);
            let length = row[7..11].iter().map(|q| q * q).sum::<f64>();
            assert!((length - 1.0).abs() < 1e-4);
        }
        let length = number(&report, "/moves/0/length_m");
        let sd = number(&report, "/moves/0/length_sd_m");
        assert!((length - 0.5).abs() < 2.0 * sd && sd < 0.05, "{report}");
        let page = fs::read_to_string(&page).unwrap();
        assert!(page.matches("<svg").count() >= 3, "{method}: position, its σ and the plan");
    }
    texts.check("navigate");
}

#[test]
fn a_missing_magnetometer_a_magnet_and_a_start_in_motion_are_reported() {
    let folder = folder();
    let mut texts = Transcript::default();
    let mut remark = |made: Made, case: &str| {
        let csv = made.write(folder.path(), "in.csv");
        let ran = wimu(&["navigate", &csv]);
        texts.findings(case, &ran);
    };
    let without = Made { field: false, ..PLAIN };
    remark(without, "no magnetometer");
    let magnet = Made { magnet_s: 5.5, ..PLAIN };
    remark(magnet, "magnet");
    let shaken = Made { shaken: true, ..PLAIN };
    let csv = shaken.write(folder.path(), "shaken.csv");
    let ran = wimu(&["navigate", &csv]);
    if ran.code == 0 {
        let report = ran.succeeds();
        assert!(number(&report, "/nees/share_below_7_81") > 0.9, "{report}");
    } else {
        ran.fails(3, "data_refused");
    }
    texts.check("navigate_magnets_and_motion");
}

#[test]
fn gaps_repeated_times_and_damaged_rows_are_reported() {
    let mut texts = Transcript::default();
    let folder = folder();
    let text = PLAIN.text();
    let lines: Vec<&str> = text.lines().collect();
    let write = |name: &str, lines: &[&str]| {
        let path = folder.path().join(name);
        fs::write(&path, lines.join("\n")).unwrap();
        path.display().to_string()
    };
    let gap = write("gap.csv", &[&lines[..320], &lines[370..]].concat());
    let report = texts.findings("gap of 0.5 s", &wimu(&["navigate", &gap]));
    assert!(number(&report, "/valid_share") < 0.95);
    let still = write("still.csv", &[&lines[..320], &lines[319..]].concat());
    texts.findings("a time twice", &wimu(&["navigate", &still]));

    let back = write("back.csv", &[&lines[..320], &lines[100..]].concat());
    texts.findings("back", &wimu(&["navigate", &back]));
    let broken = lines[300].replacen(",", ",NaN,", 1);
    let nan = write("nan.csv", &[&lines[..300], &[&broken[..]], &lines[301..]].concat());
    texts.findings("field", &wimu(&["navigate", &nan]));
    let mut cells: Vec<&str> = lines[300].split(',').collect();
    cells[2] = "N.N";
    let nan = write("nan2.csv", &[&lines[..300], &[&cells.join(",")[..]], &lines[301..]].concat());
    texts.findings("number", &wimu(&["navigate", &nan]));
    let short = write("short.csv", &lines[..2]);
    texts.fails("one row", &wimu(&["navigate", &short]), 2, "no_rows");
    let counts = lines[0].replace("(m/s²)", "(LSB)");
    let raw = write("raw.csv", &[&[&counts[..]], &lines[1..]].concat());
    texts.fails("counts", &wimu(&["navigate", &raw]), 2, "unknown_format");
    let unit = Made { gyroscope: true, ..PLAIN };
    let text = unit.text().replacen("(deg/s)", "(LSB)", 3);
    let unit = write("unit.csv", &[text.trim_end()]);
    let ran = wimu(&["navigate", &unit]);
    texts.fails("gyroscope in counts", &ran, 2, "unknown_format");
    texts.check("navigate_gaps_and_damaged_files");
}

#[test]
fn a_boards_recording_is_navigated() {
    let folder = folder();
    let session = folder.path().join("s.mcap").display().to_string();
    let out = folder.path().join("path.csv").display().to_string();
    let page = folder.path().join("page.html").display().to_string();
    record_motion("slide", 4, &session);
    let report = wimu(&["navigate", &session]).succeeds();
    assert!(report["starts"][0]["replay"].is_object(), "{report}");
    assert_eq!(report["path"]["method"], "tilt");
    let files = ["-o", &out, "--report", &page];
    let report = wimu(&[&["navigate", &session], &files[..]].concat()).succeeds();
    assert!(number(&report, "/path/duration_s") > 3.0);
    let text = fs::read_to_string(&out).unwrap();
    assert!(text.starts_with("Time (s),Position E (m)"), "{text}");
    assert!(fs::read_to_string(&page).unwrap().contains("<svg"));
    let limits =
        wimu(&["navigate", &session, "--setup", "limit_m=0.3", "--zupt", "off"]).succeeds();
    assert_eq!(number(&limits, "/path/horizon/limit_m"), 0.3);
    // A path in ROS messages has no inertial data.
    let bag = folder.path().join("path.mcap").display().to_string();
    wimu(&["navigate", &session, "-o", &bag]).succeeds();
    let tracks = &wimu(&["info", &bag]).succeeds()["tracks"];
    assert_eq!(tracks[0]["quantity"], "position", "{tracks}");
    wimu(&["calibrate", &bag]).fails(2, "no_rows");
    // A path holds no positions of boards on their body.
    wimu(&["navigate", &session, "--setup", kit::setup("geometry", &out)])
        .fails(2, "csv_missing_column");
}

#[allow(dead_code)]
#[path = "../../wimu-host/examples/navigate.rs"]
mod example;

#[test]
fn the_librarys_example_finds_the_same_numbers() {
    let folder = folder();
    for gyroscope in [true, false] {
        let made = Made { gyroscope, ..PLAIN };
        let csv = made.write(folder.path(), "in.csv");
        let report = wimu(&["navigate", &csv]).succeeds();
        let path = example::path_of(Path::new(&csv)).unwrap();
        let last = path.points[path.points.len() - 1];
        // JSON's decimals are read back to the last bit but one.
        let same = |key: &str, value: f64| {
            let found = number(&report, key);
            assert!((found - value).abs() <= 1e-12 * value.abs(), "{key}: {found} {value}");
        };
        same("/distance_m", path.distance_m());
        for axis in 0..3 {
            same(&format!("/final_position_m/{axis}"), last.position_m[axis]);
            same(&format!("/final_sigma_m/{axis}"), last.sigma_m()[axis]);
        }
        match path.horizon_s(0.1) {
            Some(seconds) => same("/horizon/to_0_1_m_s", seconds),
            None => assert!(report["horizon"]["to_0_1_m_s"].is_null()),
        }
        let (median, below) = path.consistency().unwrap();
        same("/nees/median", median);
        same("/nees/share_below_7_81", below);
    }
}

#[test]
fn the_sequence_in_readme_ends_with_the_length_of_the_simulated_slide() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (session, cal) = (path("session.mcap"), path("CAL.json"));
    // The poses and the slide again and again: the first slide, and what comes after it.
    record_motion("twelve-poses,slide,twelve-poses", 1, &session);
    wimu(&["calibrate", &session, "-o", &cal]).succeeds();
    let ran = wimu(&["navigate", &session, "--with", &cal]);
    let report = ran.succeeds();
    // All others rotate.
    let moves = report["path"]["moves"].as_array().unwrap();
    let known = moves.iter().filter(|one| !one["length_m"].is_null());
    let [one] = known.collect::<Vec<_>>()[..] else {
        panic!("{report}");
    };
    // The truth is 1 m.
    let [length, sd] = ["/length_m", "/length_sd_m"].map(|key| number(one, key));
    assert!((length - 1.0).abs() < 2.0 * sd && sd < 0.05, "{report}");
    let mut texts = Transcript::default();
    texts.text("navigate RECORDING", &ran);
    texts.check("navigate_recording");
}
