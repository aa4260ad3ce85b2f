//! What an array says of rate and position holds the truth, whatever its uncalibrated sensors are.

use crate::array_journeys;

use array_journeys::{Case, Kind, Places};
use wimu_host::inertial::Zupt;
use wimu_testkit::Lane;

/// Journeys of each case. A journey takes half a second.
fn seeds() -> u64 {
    Lane::current().choose([1, 2, 100])
}

/// Cases that are run: all in a campaign, else the first alone.
fn chosen<const N: usize, T>(cases: [T; N]) -> impl Iterator<Item = T> {
    let count = Lane::current().choose([1, 1, N]);
    cases.into_iter().take(count)
}

/// An ordinary sensor off the reel at places measured with a ruler.
fn uncalibrated() -> Case {
    Case { rate_hz: 100.0, bias: 0.1, scale: 0.015, place: 1e-3, ..Case::default() }
}

#[test]
fn an_array_that_nobody_calibrated_is_within_its_covariance() {
    let cases = [
        uncalibrated(),
        Case { scale: 0.0, place: 0.0, bias: 0.2, ..uncalibrated() },
        Case { places: Places::Board, scale: 0.005, kind: Kind::Moves(0.3, 1.0), ..uncalibrated() },
    ];
    for case in chosen(cases) {
        let coverage = case.over(seeds());
        println!("{coverage}");
        assert!(coverage.can_be_at_least(90.0, 88.0), "{coverage}");
        assert!(coverage.valid() > 15.0);
    }
}

#[test]
fn what_the_rests_tell_of_sensors_that_nobody_calibrated_is_taken_off_them() {
    let cases = [
        (Places::Board, Kind::Moves(0.3, 3.0), 0.65),
        (Places::Four(0.03), Kind::Moves(0.3, 3.0), 0.24),
        // Two rests tell little: what is left is allowed for.
        (Places::Octahedron(0.03), Kind::Move(0.3, 1.0), 0.8),
    ];
    for (places, kind, rad_s) in chosen(cases) {
        let case = Case { places, kind, rate_hz: 200.0, ..uncalibrated() };
        let coverage = case.over(seeds());
        println!("{coverage}");
        assert!(coverage.can_be_at_least(90.0, 90.0), "{coverage}");
        assert!(coverage.refused == 0 && coverage.rate_error() < rad_s);
    }
}

#[test]
fn the_deviation_of_a_calibrated_array_is_of_the_order_of_its_error() {
    let calibrated = Case { rate_hz: 100.0, ..Case::default() };
    // Four triads leave nothing over that would show it.
    let four = Case { places: Places::Four(0.03), ..calibrated };
    for case in chosen([calibrated, four]) {
        let coverage = case.over(seeds());
        println!("{coverage}");
        assert!(coverage.can_be_at_least(90.0, 90.0), "{coverage}");
        assert!(coverage.rate_sd() < 4.5 * coverage.rate_error());
    }
}

#[test]
fn even_motion_is_doubted_unless_a_rest_is_stated() {
    let case =
        Case { kind: Kind::Cart(0.3, 6.0), zupt: Zupt::Assumed, rate_hz: 100.0, ..Case::default() };
    let count = Lane::current().choose([2, 2, 100]);
    let zupt = Zupt::Stated;
    let [doubted, stated] = [case, Case { zupt, ..case }].map(|case| case.over(count));
    println!("{doubted}\n{stated}");
    assert!(doubted.can_be_at_least(90.0, 0.0), "{doubted}");
    assert!(!stated.can_be_at_least(90.0, 0.0), "{stated}");
}

#[test]
fn half_and_a_quarter_of_the_sample_rate_are_as_consistent() {
    for rate_hz in chosen([50.0, 25.0]) {
        let coverage = Case { rate_hz, ..Case::default() }.over(seeds());
        println!("{coverage}");
        // Of moving samples alone 88 % at 25 Hz: σ is a little too small there.
        assert!(coverage.can_be_at_least(85.0, 90.0), "{coverage}");
    }
}
