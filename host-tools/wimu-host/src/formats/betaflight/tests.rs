use super::super::tests::{assert_figures, assert_robust, file, read_bytes};
use crate::error::ErrorCode;
use crate::finding::FindingCode;
use crate::recording::{Quantity, Unit};

const FILE: &str = "betaflight_omnibus.BFL";
const DAMAGED: &str = "betaflight_damaged.bbl";

fn bytes(name: &str) -> Option<Vec<u8>> {
    Some(std::fs::read(file(name)?).expect("the file"))
}

#[test]
fn figures_agree_with_orangebox() {
    let Some(bytes) = bytes(FILE) else { return };
    let recording = read_bytes(&bytes, None).unwrap();
    assert_figures(&recording, FILE, "accelerometer", 0);
    let force = recording.first(Quantity::SpecificForce).unwrap();
    let si_per_lsb = Some(9.80665 / 2048.0);
    assert_eq!(force.info.unit, Unit::Counts { si_per_lsb });
    let rate = recording.first(Quantity::AngularRate).unwrap();
    assert_eq!(rate.info.unit, Unit::Si);
    // orangebox: gyroADC[0] of row 14 is the first that is not 0, −1 °/s.
    let row = rate.row(14).unwrap()[0];
    assert!((row + 1_f64.to_radians()).abs() < 1e-12, "{row}");
    assert_eq!(recording.findings.len(), 1, "{:?}", recording.findings);

    let text = String::from_utf8_lossy(&bytes[..2800]);
    let text = text.replace("debug_mode:0", "blackbox_high_resolution:1");
    let fine = read_bytes(&[text.as_bytes(), &bytes[2800..]].concat(), None).unwrap();
    let fine = fine.first(Quantity::AngularRate).unwrap().row(14).unwrap()[0];
    assert!((fine - row / 10.0).abs() < 1e-12, "{fine}");
}

#[test]
fn the_damaged_file_is_read_as_far_as_possible() {
    let Some(bytes) = bytes(DAMAGED) else { return };
    let recording = read_bytes(&bytes, None).unwrap();
    assert_figures(&recording, DAMAGED, "accelerometer", 0);
    let found = recording.findings.iter().find(|found| found.code == FindingCode::Truncated);
    let found = found.unwrap().to_string();
    assert!(found.contains("4 of 3830 bytes") && found.contains("in 2 places"), "{found}");
}

#[test]
fn damaged_files_are_read_or_refused() {
    assert_robust(FILE);
    assert_robust(DAMAGED);
}

/// A gap that may hide a frame: frames are left out up to the next I frame.
#[test]
fn frames_that_refer_to_a_lost_one_are_left_out() {
    let Some(bytes) = bytes(FILE) else { return };
    let whole = read_bytes(&bytes, None).unwrap();
    let whole: Vec<_> = whole.first(Quantity::SpecificForce).unwrap().vectors().collect();
    let mut damaged = bytes.clone();
    damaged[6000..6040].fill(0xAA);
    let recording = read_bytes(&damaged, None).unwrap();
    let rows: Vec<_> = recording.first(Quantity::SpecificForce).unwrap().vectors().collect();
    assert!((760..797).contains(&rows.len()), "{}", rows.len());
    assert!(rows.iter().all(|row| whole.contains(row)));
    let lost = recording.findings.iter().filter(|found| found.code == FindingCode::Truncated);
    assert_eq!(lost.count(), 2, "{:?}", recording.findings);
}

#[test]
fn the_longest_log_is_read_unless_another_is_asked_for() {
    let (Some(long), Some(short)) = (bytes(FILE), bytes(DAMAGED)) else {
        return;
    };
    let file = [&short[..], &long, &short].concat();
    let rows = |topic| {
        let recording = read_bytes(&file, topic).unwrap();
        let rows = recording.first(Quantity::SpecificForce).unwrap().len();
        (rows, recording.findings[0].to_string())
    };
    let found = "read: log 2 (798 rows, 0.8 s); not read: log 1 (7 rows, 0.0 s), log 3 (7 rows, 0.0 s); \
                 `--topic \"log N\"` reads another";
    assert_eq!(rows(None), (798, found.to_owned()));
    assert_eq!(rows(Some("log 3")).0, 7);
    assert_eq!(rows(Some("1")).0, 7);
    let error = read_bytes(&file, Some("log 4")).unwrap_err();
    assert_eq!(error.code(), ErrorCode::Usage);
}

/// A download of the whole memory ends with erased bytes.
#[test]
fn erased_memory_behind_a_log_is_left_out() {
    let Some(bytes) = bytes(FILE) else { return };
    let unfinished = [&bytes[..bytes.len() - 20], &[0xFF; 50_000]].concat();
    let recording = read_bytes(&unfinished, None).unwrap();
    let rows = recording.first(Quantity::SpecificForce).unwrap().len();
    assert_eq!(rows, 797, "{:?}", recording.findings);
}

#[test]
fn a_log_without_inertial_fields_names_those_that_it_has() {
    let Some(bytes) = bytes(FILE) else { return };
    let text = String::from_utf8_lossy(&bytes[..2800]);
    let text = text.replace("accSmooth", "accOthers").replace("gyroADC", "gyroOth");
    let error = read_bytes(&[text.as_bytes(), &bytes[2800..]].concat(), None).unwrap_err();
    assert_eq!(error.code(), ErrorCode::NoRows);
    assert!(error.message().contains("loopIteration, time"), "{error}");
}
