//! `wimu calibrate` on eight MPU-9150 that each were recorded cold and again warm: whether it says that the bias drifts.

use std::path::Path;

use wimu_testkit::figure;

use crate::kit::wimu;

/// Number of the eight sensors of the two runs of which the command warns that the bias drifts.
fn drifting(poses: &str, runs: [u32; 2]) -> usize {
    let warned = |run: u32, sensor: usize| {
        let rows = format!("Run={run},IMU={sensor}");
        let (gravity, sensitivity) = ("9.818", "2048");
        let known = ["--gravity", gravity, "--sensitivity", sensitivity, "--where", &rows];
        let ran = wimu(&[&["calibrate", "--poses", poses][..], &known].concat());
        let problems = ran.problems();
        problems.iter().any(|found| found["code"] == "drift" && found["severity"] == "warning")
    };
    runs.map(|run| (0..8).filter(|sensor| warned(run, *sensor)).count()).iter().sum()
}

#[test]
fn most_cold_starts_are_found_and_few_warm_runs_are_taken_for_one() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let poses = data.join("calibration/mpu9150_array_pose_means.csv");
    if !poses.is_file() {
        eprintln!("skipped: {} is not there", poses.display());
        return;
    }
    let poses = poses.display().to_string();
    let [cold, warm] = [[1, 7], [2, 8]].map(|runs| drifting(&poses, runs));
    let claim = |of: &str| format!("MPU-9150, {of}: `drift` is a warning");
    figure(&claim("16 cold starts"), cold, "at least 10", cold >= 10);
    figure(&claim("16 warm runs"), warm, "at most 3", warm <= 3);
    assert!(cold >= 10 && warm <= 3, "{cold} cold, {warm} warm");
}
