//! The noise of a gyroscope from a recording at rest to the file that Kalibr reads.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{in_folder, wimu};

/// A calibration that changes nothing.
const IDENTITY: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/inputs/IDENTITY.json");

/// A gyroscope at rest for 600 s at 50 Hz, with white noise of 0.0014 rad/s a sample about an offset; alone, or beside an
/// accelerometer.
fn gyroscope_at_rest(beside: bool) -> String {
    let mut text = String::from("Time (s)");
    if beside {
        text += ",Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)";
    }
    text += ",Gyroscope X (rad/s),Gyroscope Y (rad/s),Gyroscope Z (rad/s)\n";
    let mut noise = kit::noise();
    for k in 0..30_000 {
        write!(text, "{}", f64::from(k) * 0.02).unwrap();
        let forces = [0.0, 0.0, 9.80665].into_iter().take(if beside { 3 } else { 0 });
        forces.for_each(|mean| write!(text, ",{:.5}", mean + 0.02 * noise()).unwrap());
        for offset in [0.01, -0.02, 0.005] {
            write!(text, ",{:.6}", offset + 0.0014 * noise()).unwrap();
        }
        text.push('\n');
    }
    text
}

#[test]
fn the_noise_of_a_gyroscope_alone_and_beside_an_accelerometer_is_measured() {
    let (csv, folder) = in_folder("rest.csv");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (json, yaml, page) = (path("NOISE.json"), path("imu.yaml"), path("noise.html"));
    for beside in [false, true] {
        fs::write(&csv, gyroscope_at_rest(beside)).unwrap();
        let ran = wimu(&["allan", &csv, "--report", &page]);
        let report = ran.succeeds();
        assert_eq!(report["accelerometer"].is_object(), beside, "{report}");
        assert_eq!(report["samples"], 30_000);
        let walk = 0.0014 / 50_f64.sqrt();
        for axis in report["gyroscope"]["axes"].as_array().unwrap() {
            for (key, expected) in [("random_walk", walk), ("noise_density", walk * 2_f64.sqrt())] {
                let figure = |name: &str| axis[key][name].as_f64().unwrap();
                let (value, sd) = (figure("value"), figure("sd"));
                let off = (value - expected).abs();
                assert!(
                    off < 4.0 * sd && sd < 0.02 * expected,
                    "{key}: {value} ± {sd}, {expected}"
                );
            }
        }
        assert!(fs::read_to_string(&page).unwrap().contains("Allan deviation of the gyroscope"));
        fs::write(&json, &ran.stdout).unwrap();
        wimu(&["convert", IDENTITY, "--to", "kalibr", "-o", &yaml, "--noise", &json]).succeeds();
        let text = fs::read_to_string(&yaml).unwrap();
        let value = |key: &str| -> Option<f64> {
            let mut values = text.lines().filter_map(|line| line.strip_prefix(key));
            values.next()?.parse().ok()
        };
        let density = value("gyroscope_noise_density: ").unwrap();
        assert!((density / walk - 1.0).abs() < 0.05, "{density} {walk}");
        assert!(value("gyroscope_random_walk: ") > Some(0.0), "{text}");
        for key in ["accelerometer_noise_density: ", "accelerometer_random_walk: "] {
            assert_eq!(value(key).is_some(), beside, "{text}");
        }
    }
    // A gyroscope that turns is not at rest, nor is one in °/s that is called rad/s.
    for (offset, factor) in [(0.5, 1.0), (0.0, 57.3)] {
        let turned = gyroscope_at_rest(false);
        let changed = |(k, row): (usize, &str)| {
            let mut fields = row.split(',').map(|field| field.parse::<f64>().unwrap());
            let mut text = fields.next().unwrap().to_string();
            let turns = if k > 15_000 { offset } else { 0.0 };
            fields.for_each(|rate| write!(text, ",{}", rate * factor + turns).unwrap());
            text + "\n"
        };
        let (header, rows) = turned.split_once('\n').unwrap();
        let rows: String = rows.lines().enumerate().map(changed).collect();
        fs::write(&csv, format!("{header}\n{rows}")).unwrap();
        wimu(&["allan", &csv]).refuses();
    }
}
