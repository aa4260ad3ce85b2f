//! `wimu calibrate` of a simulated board with six axes, to a better path.

use crate::kit;

use kit::{Background, Simulator, folder, record_until, wimu};

#[test]
fn a_board_with_a_gyroscope_is_calibrated_and_then_navigates_better() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let motion = ["--sensor", "lsm6dso", "--speed", "20", "--motion"];
    let board = Simulator::start(&[&motion[..], &["twelve-poses,carry"]].concat());
    let carried = |name: &str| {
        let file = path(name);
        let recorder = Background::start(&["record", &board.cable, "-o", &file]);
        record_until(recorder, &file, |link| link["raw_samples"].as_u64() > Some(14_000));
        let report = wimu(&["navigate", &file]).succeeds();
        report["path"]["valid_share"].as_f64().unwrap()
    };
    let before = carried("before.mcap");
    let calibration = path("cal.json");
    let session = path("before.mcap");
    let report = wimu(&["calibrate", &session, "-o", &calibration]).succeeds();
    let gyroscope = &report["gyroscope"];
    assert!(gyroscope["turns"].as_u64() > Some(10), "{gyroscope}");
    let [uncalibrated, calibrated] =
        ["before_deg", "rms_deg"].map(|key| gyroscope[key].as_f64().unwrap());
    assert!(calibrated < 0.1 * uncalibrated, "{gyroscope}");
    wimu(&["params", "push", &board.cable, &calibration]).succeeds();
    let held = wimu(&["params", "get", &board.cable]).succeeds();
    assert!(held.to_string().contains("gyroscope"), "{held}");
    let after = carried("after.mcap");
    println!("valid part of the samples: {before} uncalibrated, {after} calibrated");
    assert!(after > before + 0.2, "{before} {after}");
}
