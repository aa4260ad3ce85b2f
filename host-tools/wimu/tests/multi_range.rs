//! Two accelerometers of different full scale on one board, from the simulator to the path.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{Simulator, folder, wimu};

#[test]
fn a_simulated_pair_is_recorded_listed_exported_and_navigated() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let session = path("impact.mcap");
    let arguments = ["--chip", "lsm303agr,adxl345", "--motion", "twelve-poses,impact,rest"];
    let arguments = [&arguments[..], &["--exit-when-done", "--speed", "20"]].concat();
    Simulator::start(&arguments).record_to_the_end(&session);

    let info = wimu(&["info", &session]).succeeds();
    let sensors = info["links"][0]["sensors"].as_array().unwrap().clone();
    assert_eq!(sensors.len(), 2);
    let ranges: Vec<f64> = sensors.iter().map(|s| s["range_m_s2"].as_f64().unwrap()).collect();
    assert!((ranges[0] - 19.6).abs() < 0.1 && (ranges[1] - 156.9).abs() < 0.5, "{ranges:?}");

    let raw = wimu(&["convert", &session, "--sensor", "1", "-o", &path("coarse.csv")]).succeeds();
    assert!(raw["rows"].as_u64().unwrap() > 6000);
    let topics = wimu(&["convert", &session, "-o", &path("topics.mcap")]).succeeds();
    assert_eq!(topics["messages"]["/cable/imu_1/data_raw"], raw["rows"]);
    let model = serde_json::json!({
        "schema": "wimu.link_model/1", "link": "cable", "device_id": "", "pairs": 9,
        "bias_mps2": ([0.0; 3]), "scale": ([1.0; 3]), "bias_sd_mps2": ([0.1; 3]), "scale_sd": ([0.1; 3]),
    });
    fs::write(path("link.json"), model.to_string()).unwrap();
    let with = ["--sensor", "1", "--with", &path("link.json"), "-o", &path("none.csv")];
    wimu(&[&["convert", &session], &with[..]].concat()).fails(2, "usage");
    wimu(&["calibrate", &session, "-o", &path("CAL.json")]).succeeds();

    let navigated = wimu(&["navigate", &session, "--with", &path("CAL.json")]).succeeds();
    let findings = navigated["problems"].to_string();
    assert!(findings.contains("accelerometers 0 (±2 g), 1 (±16 g) merged"), "{findings}");
    let moves = navigated["path"]["moves"].as_array().unwrap().clone();
    let length_m = moves.iter().filter_map(|m| m["length_m"].as_f64());
    assert!(length_m.fold(0.0, f64::max) > 1.5, "{moves:?}");
}

/// Accelerometers of ± 2 g and ± 16 g; the second has these errors.
fn table(coarse: impl Fn([f64; 3]) -> [f64; 3]) -> String {
    let mut text = String::from("Time (s)");
    for sensor in [0, 1] {
        for axis in ["X", "Y", "Z"] {
            write!(text, ",Accelerometer {sensor} {axis} (m/s²)").unwrap();
        }
    }
    let mut normal = kit::noise();
    for k in 0..3000 {
        let t = 0.01 * f64::from(k);
        // Half of it at rest, then motion; beyond ± 2 g along x at 25 s.
        let sway = if t < 15.0 { 0.0 } else { 1.0 };
        let hit = if (25.0..25.1).contains(&t) { 60.0 * ((t - 25.0) * 31.4).sin() } else { 0.0 };
        let force = [
            sway * 4.0 * (5.0 * (t - 15.0)).sin() + hit,
            sway * 4.0 * (7.0 * (t - 15.0)).sin(),
            9.8 + sway * 3.0 * (6.0 * (t - 15.0)).sin(),
        ];
        let fine = force.map(|f| (f + 0.02 * normal()).clamp(-19.6, 19.6));
        let [x, y, z] = coarse(force).map(|f| f + 0.06 * normal());
        write!(text, "\n{t:.2},{},{},{},{x},{y},{z}", fine[0], fine[1], fine[2]).unwrap();
    }
    text
}

#[test]
fn tables_need_the_full_scales_and_bad_input_is_explained() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (good, turned) = (path("good.csv"), path("turned.csv"));
    fs::write(&good, table(|[x, y, z]| [1.02 * x + 0.4, y, z])).unwrap();
    fs::write(&turned, table(|[x, y, z]| [z, y, -x])).unwrap();

    let without = wimu(&["navigate", &good]);
    assert_eq!(without.code, 2);
    assert!(without.stderr.contains("full_scales_g"), "{without:?}");
    let found = wimu(&["navigate", &good, "--setup", "full_scales_g=[2,16]"]).succeeds();
    assert!(found["problems"].to_string().contains("merged; where finer ones are saturated: 1 in"));
    let found = wimu(&["navigate", &turned, "--setup", "full_scales_g=[2,16]"]).succeeds();
    assert!(found["problems"].to_string().contains("rotated by 90°"), "{found}");

    for wrong in ["2", "2,16,200", "2,-16", "2,x"] {
        let refused = wimu(&["navigate", &good, "--setup", kit::setup("full_scales_g", wrong)]);
        assert_ne!(refused.code, 0, "{wrong}: {refused:?}");
    }
    for sensors in ["lsm6dso,adxl345", "adxl345,adxl345", "lsm303agr,adxl345,adxl345"] {
        let refused = wimu(&["simulate", "--chip", sensors]);
        assert_ne!(refused.code, 0, "{sensors}: {refused:?}");
    }
}
