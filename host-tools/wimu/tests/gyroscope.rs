//! `wimu calibrate` of a simulated board with six axes, to a better path.

use crate::kit;

use kit::{folder, record_calibrated, record_motion_of, wimu};
use wimu_sim::board::SensorPart;

#[test]
fn a_board_with_a_gyroscope_is_calibrated_and_then_navigates_better() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (poses, calibration) = (path("poses.mcap"), path("CAL.json"));
    record_motion_of(SensorPart::Lsm6dso, "twelve-poses", 1, &poses);
    let report = wimu(&["calibrate", &poses, "-o", &calibration]).succeeds();
    let gyroscope = &report["gyroscope"];
    assert!(gyroscope["turns"].as_u64() > Some(10), "{gyroscope}");
    let [uncalibrated, calibrated] =
        ["before_deg", "rms_deg"].map(|key| gyroscope[key].as_f64().unwrap());
    assert!(calibrated < 0.1 * uncalibrated, "{gyroscope}");
    let (before, after) = (path("before.mcap"), path("after.mcap"));
    record_motion_of(SensorPart::Lsm6dso, "rest,carry", 1, &before);
    record_calibrated(SensorPart::Lsm6dso, &calibration, "rest,carry", 1, &after);
    let [before, after] = [before, after].map(|file| {
        let report = wimu(&["navigate", &file]).succeeds();
        report["path"]["valid_share"].as_f64().unwrap()
    });
    println!("valid part of the samples: {before} uncalibrated, {after} calibrated");
    assert!(after > before + 0.1, "{before} {after}");
}
