//! Positions of a wrong size are reported; arrays that are as given are left alone.

use crate::array_journeys;

use array_journeys::{Case, Kind, Places};
use wimu_calib::Gravity;
use wimu_host::array::{Array, ArrayCalibration, ArrayGeometry};
use wimu_host::inertial::{Choice, InertialPath, Zupt, consistency, navigate_array};
use wimu_testkit::Lane;

/// Arrays of each kind. One takes a second.
fn seeds() -> u64 {
    Lane::current().choose([1, 1, 30])
}

/// Moves with turns of 3 rad an axis, 100 Hz.
fn case() -> Case {
    Case { rate_hz: 100.0, ..Case::default() }
}

fn navigated(recording: Array, geometry: &ArrayGeometry) -> InertialPath {
    let arranged = recording.judged().arranged(geometry).unwrap();
    let calibration = ArrayCalibration::of(&arranged, geometry, Gravity::UNKNOWN_PLACE).unwrap();
    let choice = Choice { zupt: Zupt::Stated, ..Choice::default() };
    navigate_array(&arranged, geometry, &calibration, &choice).unwrap()
}

/// Shares of position's and rate's NEES below 7.81, and what is said.
fn honest(path: &InertialPath) -> (f64, f64, String) {
    let share = |nees: &[f64]| consistency(nees).map_or(0.0, |(_, share)| share);
    let said = path.findings.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
    (share(&path.nees.all), share(&path.rate_nees.all), said)
}

#[test]
fn positions_of_a_wrong_size_are_reported_and_kept() {
    for (places, factor) in [
        (Places::Octahedron(0.03), 1.3),
        (Places::Octahedron(0.03), 0.7),
        (Places::Four(0.03), 1.3),
    ] {
        for seed in 1..=seeds() {
            let (recording, mut geometry) = Case { places, ..case() }.recording(seed);
            for place in geometry.sensors.iter_mut().flat_map(|s| &mut s.places_m) {
                *place = place.map(|c| c * factor);
            }
            let (_, _, said) = honest(&navigated(recording, &geometry));
            println!("{places:?} times {factor}, seed {seed}: {said}");
            let (_, found) = said.split_once("the positions are ").expect(&said);
            let number = |k| found.split(' ').nth(k).unwrap().parse::<f64>().unwrap();
            let (least, most) = (number(0), number(2));
            assert!((least..=most).contains(&factor) && most - least < 0.3, "{said}");
        }
    }
}

#[test]
fn arrays_that_are_as_given_are_left_as_they_are() {
    let wrong = Case { bias: 0.1, scale: 0.015, place: 1e-3, ..case() };
    for case in [
        case(),
        wrong,
        Case { kind: Kind::Moves(0.3, 1.0), bias: 0.1, ..case() },
        Case { places: Places::Board, ..case() },
        Case { kind: Kind::Cart(1.0, 5.0), ..case() },
    ] {
        for seed in 1..=seeds() {
            let (recording, geometry) = case.recording(seed);
            let (.., said) = honest(&navigated(recording, &geometry));
            assert!(
                !said.contains("times as far apart") && !said.contains("full scale"),
                "{case:?} {seed}: {said}"
            );
        }
    }
}
