//! No value of a recording, however wild, makes a position valid that is not one.

use std::fmt::Write as _;
use std::path::Path;

use crate::common::read;
use proptest::prelude::*;
use tempfile::{NamedTempFile, TempPath};
use wimu_calib::Gravity;
use wimu_host::array::{Array, ArrayCalibration, ArrayGeometry, ArrayUnit};
use wimu_host::formats::ReadOptions;
use wimu_host::inertial::{Choice, InertialPath, Profile, Zupt, navigate, navigate_array};
use wimu_host::{Code, Problem};
use wimu_testkit::{Lane, Random};

const G: f64 = 9.80665;
/// Rows of a table.
const ROWS: usize = 600;
const PROFILES: [Profile; 3] = [Profile::Hand, Profile::Foot, Profile::Free];

/// A file that is removed when dropped.
fn file(text: &str) -> TempPath {
    let path = NamedTempFile::with_suffix(".csv").unwrap().into_temp_path();
    std::fs::write(&path, text).unwrap();
    path
}

fn says(path: &InertialPath, what: &str) -> bool {
    path.findings.iter().any(|f| f.text.contains(what))
}

/// What is valid is a number, and something is.
fn check(found: Result<InertialPath, Problem>) -> Result<(), TestCaseError> {
    let path = match found {
        Ok(path) => path,
        Err(error) => {
            prop_assert_eq!(error.code, Code::DataRefused);
            return Ok(());
        }
    };
    for point in path.points.iter().filter(|p| p.valid) {
        let numbers = point.position_m.iter().chain(&point.velocity_mps);
        let mut numbers = numbers.chain(&point.quaternion).chain(&point.rate_rad_s);
        prop_assert!(numbers.all(|v| v.is_finite()), "{point:?}");
        prop_assert!(point.sd_m() <= path.limit_m, "{point:?}");
    }
    for one in path.moves.iter().filter(|m| m.valid) {
        prop_assert!(one.length_m.is_finite() && one.length_sd_m.is_finite());
    }
    prop_assert!(path.distance_m().is_finite());
    let some = path.points.iter().any(|p| p.valid) || path.moves.iter().any(|m| m.valid);
    prop_assert!(some, "nothing is valid, and nobody says so");
    Ok(())
}

fn choices() -> impl Iterator<Item = Choice> {
    let zupts = [Zupt::Assumed, Zupt::Stated, Zupt::Off].into_iter();
    zupts.flat_map(|zupt| {
        PROFILES.into_iter().map(move |profile| Choice { profile, zupt, ..Choice::default() })
    })
}

/// 6 s at 100 Hz: rest, 2 s of shaking by `shake` m/s² (a gyroscope: a hundredth, rad/s), rest; `wild` replaces single
/// values: row, column, value.
fn table(shake: f64, wild: &[(usize, usize, f64)], columns: &[&str], seed: u64) -> String {
    let mut random = Random::new(seed);
    let mut text = format!("Time (s),{}\n", columns.join(","));
    for k in 0..ROWS {
        let moves = (ROWS / 3..2 * ROWS / 3).contains(&k);
        write!(text, "{:.2}", k as f64 * 0.01).unwrap();
        for (column, name) in columns.iter().enumerate() {
            let gravity = if name.starts_with("Acc") && name.contains('Z') { G } else { 0.0 };
            let (noise, shake) =
                if name.starts_with("Gyr") { (0.002, 0.01 * shake) } else { (0.02, shake) };
            let size = if moves { shake } else { noise };
            let own = wild.iter().find(|(row, at, _)| *row == k && at % columns.len() == column);
            let value = own.map_or(gravity + size * random.normal(), |(_, _, value)| *value);
            write!(text, ",{value:e}").unwrap();
        }
        text.push('\n');
    }
    text
}

const ALL: [&str; 9] = [
    "Accelerometer X (m/s²)",
    "Accelerometer Y (m/s²)",
    "Accelerometer Z (m/s²)",
    "Gyroscope X (rad/s)",
    "Gyroscope Y (rad/s)",
    "Gyroscope Z (rad/s)",
    "Magnetometer X (µT)",
    "Magnetometer Y (µT)",
    "Magnetometer Z (µT)",
];

fn wild() -> impl Strategy<Value = Vec<(usize, usize, f64)>> {
    let value = prop_oneof![
        (0.0..308.0).prop_map(|exponent: f64| 10_f64.powf(exponent)),
        (0.0..4.0).prop_map(|exponent: f64| -(10_f64.powf(exponent))),
    ];
    prop::collection::vec((0..ROWS, 0..99_usize, value), 0..12)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: Lane::current().choose([2, 4, 100]), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn what_a_unit_says_is_valid_is_a_number(
        seed in any::<u64>(),
        shake in (-2.0..3.0).prop_map(|e: f64| 10_f64.powf(e)),
        wild in wild(),
        columns in prop::sample::select(vec![3_usize, 6, 9]),
    ) {
        let csv = file(&table(shake, &wild, &ALL[..columns], seed));
        let recording = read(&csv).unwrap();
        for choice in choices() {
            check(navigate(&recording, &choice))?;
        }
    }

    #[test]
    fn what_an_array_says_is_valid_is_a_number(
        seed in any::<u64>(),
        shake in (-2.0..3.0).prop_map(|e: f64| 10_f64.powf(e)),
        wild in wild(),
    ) {
        let names: Vec<String> = (0..4)
            .flat_map(|k| ["X", "Y", "Z"].map(|axis| format!("Accelerometer {k} {axis} (m/s²)")))
            .collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let csv = file(&table(shake, &wild, &names, seed));
        let geometry = ArrayGeometry::read(Path::new("four:30mm")).unwrap();
        let zupt = [Zupt::Assumed, Zupt::Stated, Zupt::Off][seed as usize % 3];
        let choice = Choice { zupt, ..Choice::default() };
        let recording = Array::read(&csv, &ReadOptions::default(), None).unwrap();
        let found = recording.arranged(&geometry).and_then(|recording| {
            let calibration = ArrayCalibration::of(&recording, &geometry, Gravity::UNKNOWN_PLACE)?;
            navigate_array(&recording, &geometry, &calibration, &choice)
        });
        check(found)?;
    }
}

#[test]
fn a_recording_on_which_a_filter_diverged_has_finite_estimates_throughout() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/motion");
    let csv = folder.join("robot_arm_v500_mpu9150.csv");
    if !csv.exists() {
        return;
    }
    let recording = read(&csv).unwrap();
    // Each profile, and each treatment of rests.
    for choice in choices().step_by(4) {
        let path = navigate(&recording, &choice).unwrap();
        let all = path.points.iter().flat_map(|p| p.position_m);
        assert!(all.into_iter().all(f64::is_finite), "{choice:?}");
        check(Ok(path)).unwrap();
    }
}

#[test]
fn a_value_beyond_the_full_scale_is_left_out_as_if_it_were_missing_and_said() {
    let columns = &ALL[..6];
    let with = |wild: &[(usize, usize, f64)], choice: &Choice| {
        let csv = file(&table(0.3, wild, columns, 7));
        navigate(&read(&csv).unwrap(), choice).unwrap()
    };
    let apart = |a: &InertialPath, b: &InertialPath| {
        let pairs = a.points.iter().zip(&b.points);
        let apart =
            pairs.map(|(a, b)| (0..3).map(|i| (a.position_m[i] - b.position_m[i]).abs()).sum());
        apart.fold(0.0, f64::max)
    };
    for (choice, value) in choices().step_by(4).zip([65_536.0, -2001.0, 9e5]) {
        let (clean, missing) = (with(&[], &choice), with(&[(300, 0, f64::NAN)], &choice));
        let found = with(&[(300, 0, value)], &choice);
        let said = "the accelerometer gives more than its full scale, 2000 m/s², in 1 sample, first at 3.00 s";
        assert!(says(&found, said), "{choice:?}: {:?}", found.findings);
        assert_eq!(apart(&found, &missing), 0.0, "{choice:?}: {value} m/s²");
        // The path differs by no more than is known of it.
        let both = found.points.iter().zip(&clean.points);
        for (found, clean) in both.filter(|(a, b)| a.valid && b.valid) {
            let off = (0..3).map(|i| (found.position_m[i] - clean.position_m[i]).powi(2));
            let off = off.sum::<f64>().sqrt();
            assert!(off < 3.0 * found.sd_m().max(0.01), "{choice:?}: {value}: {found:?}");
        }
        // Within the full scale it is a shock, which the rest after it contradicts.
        let csv = file(&table(0.3, &[(300, 0, 1999.0)], columns, 7));
        match navigate(&read(&csv).unwrap(), &choice) {
            Ok(path) => assert!(!says(&path, "full scale")),
            Err(error) => assert!(error.text.contains("rests or fixes contradict the path")),
        }
        let missing = with(&[(300, 4, f64::NAN)], &choice);
        let turned = with(&[(300, 4, -360.0)], &choice);
        assert!(says(
            &turned,
            "the gyroscope gives more than its full scale, 350 rad/s, in 1 sample"
        ));
        assert_eq!(apart(&turned, &missing), 0.0, "{choice:?}");
    }
    // Whose accelerometer gives nothing else is refused.
    let all: Vec<_> = (0..350).map(|k| (k, 1, 3000.0)).collect();
    let csv = file(&table(0.3, &all, columns, 7));
    let refused = navigate(&read(&csv).unwrap(), &Choice::default());
    assert!(refused.unwrap_err().text.contains("full scale, 2000 m/s², in 350 samples"));
}

#[test]
fn an_output_of_an_array_beyond_any_full_scale_is_left_out_and_said() {
    let names: Vec<String> = (0..2)
        .flat_map(|k| ["X", "Y", "Z"].map(|axis| format!("Accelerometer {k} {axis} (m/s²)")))
        .collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    for (value, left_out) in [(65_536.0, true), (9e5, true), (1999.0, false)] {
        let csv = file(&table(0.3, &[(300, 4, value)], &names, 3));
        let recording = Array::read(&csv, &ReadOptions::default(), None).unwrap();
        let said = "2000 m/s², in 1 output, first at 3.00 s";
        let says = recording.remarks.iter().any(|remark| remark.contains(said));
        assert_eq!(says, left_out, "{:?}", recording.remarks);
        let is_kept = |unit: &ArrayUnit| {
            unit.force.v.iter().all(|v| v.iter().all(|v| v.is_nan() || v.abs() < 2000.0))
        };
        let finite = recording.units.iter().all(is_kept);
        assert!(finite);
    }
}
