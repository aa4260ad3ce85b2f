//! Journeys between rests, ZUPT on and off: what the data exclude is not assumed, and what they cannot exclude is
//! told. A few seeds of what the example `journeys` prints for many.

use crate::common;

use common::journeys::{Journey, Journeys, Recorded, travel};
use wimu_nav::unit::Zupt;
use wimu_testkit::{Lane, figure, trials};

fn over(journey: Journey, how: Recorded) -> Journeys {
    over_seeds(journey, how, trials(1000))
}

fn over_seeds(journey: Journey, how: Recorded, seeds: usize) -> Journeys {
    let found = Journeys::over(journey, how, seeds as u64);
    println!("{found}");
    found
}

#[test]
fn with_a_gyroscope_slow_moves_turns_and_short_pauses_lie_within_the_covariance() {
    for journey in [
        Journey::Moves(0.3),
        Journey::Moves(1.5),
        Journey::Turns,
        Journey::Steps,
        Journey::Slow(3.0),
        Journey::Slow(5.0),
    ] {
        let found = over(
            journey,
            Recorded {
                zupt: Zupt::Stated,
                ..Recorded::default()
            },
        );
        assert_consistent(&found, 0.92, 5.0);
        assert!(found.valid > 0.5 && found.rests > 0.2, "{found}");
        let found = over(journey, Recorded::default());
        assert_consistent(&found, 0.97, 4.0);
        let found = over(
            journey,
            Recorded {
                zupt: Zupt::Off,
                ..Recorded::default()
            },
        );
        assert_consistent(&found, 0.8, 6.0);
    }
}

#[test]
fn a_steady_push_is_not_taken_for_a_tilt() {
    for gyroscope in [true, false] {
        for zupt in [Zupt::Assumed, Zupt::Stated, Zupt::Off] {
            for push in [
                Journey::Push(1.0, 4.0, false),
                Journey::Push(1.0, 4.0, true),
                Journey::Push(0.3, 4.0, false),
                Journey::Push(1.0, 1.0, true),
            ] {
                let how = Recorded {
                    gyroscope,
                    zupt,
                    ..Recorded::default()
                };
                let found = over(push, how);
                assert_consistent(&found, 0.7, 7.0);
            }
        }
    }
}

/// Positions are in the 95 % ellipsoid in `below` of the samples or more (σ is conservative on smooth motion), and 99 of 100
/// journeys have no error beyond so many `deviations`.
#[track_caller]
fn assert_consistent(found: &Journeys, below: f64, deviations: f64) {
    assert!(found.below_can_be(below..=1.0), "{found}");
    let within = found.within(deviations);
    within.assert_can_be(0.99..=1.0, &found.to_string());
}

/// By default: nothing is said about rests.
#[test]
fn an_even_motion_is_never_valid_and_wrong() {
    for gyroscope in [true, false] {
        let how = Recorded {
            gyroscope,
            ..Recorded::default()
        };
        for speed in [0.02, 0.05, 0.1, 0.4, 1.0] {
            let found = over(Journey::Cart(speed), how);
            assert_consistent(&found, 0.95, 4.0);
        }
        let stairs = over(Journey::Stairs(0.05), how);
        assert_consistent(&stairs, 0.95, 4.0);
        let slow = over(Journey::Slow(8.0), how);
        assert_consistent(&slow, 0.8, 5.0);
    }
}

#[test]
fn who_states_that_it_rested_gets_the_smaller_covariance_and_the_same_path() {
    let how = |zupt| Recorded {
        zupt,
        ..Recorded::default()
    };
    for seed in 0..trials(1000) as u64 {
        let [assumed, stated] =
            [Zupt::Assumed, Zupt::Stated].map(|z| travel(Journey::Slow(3.0), how(z), seed));
        assert!((assumed.unseen_m - stated.unseen_m).abs() < 1e-9);
        assert!(assumed.worst < stated.worst, "{assumed:?} {stated:?}");
    }
    let assumed = over(Journey::Moves(0.3), how(Zupt::Assumed));
    let stated = over(Journey::Moves(0.3), how(Zupt::Stated));
    assert!(
        stated.valid > 0.9 && (0.4..0.9).contains(&assumed.valid),
        "{assumed}"
    );
}

#[test]
fn what_a_gyroscope_or_samples_leave_out_is_doubted() {
    for journey in [Journey::Moves(0.3), Journey::Moves(1.5)] {
        for missing_s in [0.05, 0.2, 1.0] {
            let failed = over(
                journey,
                Recorded {
                    fails_s: missing_s,
                    zupt: Zupt::Stated,
                    ..Recorded::default()
                },
            );
            assert_consistent(&failed, 0.92, 5.0);
            if missing_s > 0.5 {
                continue;
            }
            let hole = over(
                journey,
                Recorded {
                    hole_s: missing_s,
                    zupt: Zupt::Stated,
                    ..Recorded::default()
                },
            );
            assert_consistent(&hole, 0.92, 5.0);
            let jump = over(
                journey,
                Recorded {
                    jump_s: missing_s,
                    zupt: Zupt::Stated,
                    ..Recorded::default()
                },
            );
            assert_consistent(&jump, 0.65, 8.0);
        }
    }
}

#[test]
fn violent_moves_lie_within_the_covariance_and_what_clips_ends_it() {
    for gyroscope in [true, false] {
        for lasts in [0.3, 0.6] {
            for clips_mps2 in [f64::INFINITY, 2.0 * 9.80665] {
                let how = Recorded {
                    gyroscope,
                    clips_mps2,
                    ..Recorded::default()
                };
                let found = over(Journey::Violent(lasts), how);
                assert_consistent(&found, 0.95, 7.0);
            }
        }
    }
}

#[test]
fn large_turns_that_no_gyroscope_sees_are_doubted() {
    for zupt in [Zupt::Assumed, Zupt::Stated, Zupt::Off] {
        for journey in [Journey::Turns, Journey::Moves(1.5)] {
            let how = Recorded {
                gyroscope: false,
                zupt,
                ..Recorded::default()
            };
            let found = over(journey, how);
            assert!(found.below_can_be(0.85..=1.0), "{found}");
        }
    }
}

/// One sample of the first rest is 40 m/s² too great on each axis.
#[test]
fn one_wrong_sample_is_within_the_covariance() {
    for zupt in [Zupt::Assumed, Zupt::Stated, Zupt::Off] {
        for gyroscope in [true, false] {
            let how = Recorded {
                glitch_mps2: 40.0,
                gyroscope,
                zupt,
                ..Recorded::default()
            };
            let found = over(Journey::Carried(std::f64::consts::PI), how);
            assert_consistent(&found, 0.95, 5.0);
        }
    }
}

/// Data sheets say so: scales and axes to 1 to 3 %, and filters that delay. Turns of up to half a circle.
#[test]
fn what_scales_axes_and_a_late_gyroscope_make_of_a_turn_lies_within_the_covariance() {
    let perfect = Recorded::default();
    for how in [
        Recorded {
            rate_matrix: 0.02,
            ..perfect
        },
        Recorded {
            force_matrix: 0.01,
            ..perfect
        },
        Recorded {
            late_s: 0.02,
            ..perfect
        },
    ] {
        for zupt in [Zupt::Assumed, Zupt::Stated, Zupt::Off] {
            let journey = Journey::Carried(std::f64::consts::PI);
            let found = over(journey, Recorded { zupt, ..how });
            assert_consistent(&found, 0.9, 7.0);
            assert!(found.rests > 0.6, "{found}");
            let known = over(journey, Recorded { zupt, ..perfect });
            assert!(found.valid > 0.8 * known.valid, "{found} {known}");
        }
    }
}

/// Legs of 2 m in 4 s and of 1 m in 2 s, scales and axes of the accelerometer to 1 %: what they make of a way is no noise
/// that rests could take off again.
#[test]
fn what_an_accelerometers_matrix_makes_of_the_way_of_a_vehicle_lies_within_the_covariance() {
    for journey in [Journey::Vehicle(2.0, 4.0), Journey::Vehicle(1.0, 2.0)] {
        for zupt in [Zupt::Assumed, Zupt::Stated] {
            let how = Recorded {
                force_matrix: 0.01,
                zupt,
                ..Recorded::default()
            };
            let found = over(journey, how);
            assert_consistent(&found, 0.9, 6.0);
            assert!(found.rests > 0.6, "{found}");
        }
    }
}

/// The first rest ends at 3 s: it is too short, or none.
#[test]
fn a_recording_that_begins_in_a_move_or_just_before_starts_at_the_first_rest_of_a_second() {
    let mut least = 1.0_f64;
    let seeds = Lane::current().choose([8, 50, 500]);
    for (gyroscope, field) in [(true, true), (true, false), (false, true)] {
        for begins_s in [2.0, 2.2, 2.5, 2.8, 3.2, 4.0] {
            for zupt in [Zupt::Assumed, Zupt::Stated] {
                let how = Recorded {
                    gyroscope,
                    field,
                    begins_s,
                    zupt,
                    ..Recorded::default()
                };
                let found = over_seeds(Journey::Carried(std::f64::consts::PI), how, seeds);
                least = least.min(found.below);
                assert_consistent(&found, 0.9, 6.0);
                assert!(found.rests > 0.6 && found.valid > 0.08, "{found}");
            }
        }
    }
    figure(
        "recording begins in a move or just before: NEES < 7.81, least",
        format!("{:.0} %", 100.0 * least),
        "at least 90 %",
        least >= 0.9,
    );
}
