//! Journeys between rests, ZUPT on and off: what the data exclude is not assumed, and what they cannot exclude is
//! told. A few seeds of what the example `journeys` prints for many.

mod common;

use common::journeys::{Journey, Journeys, Recorded, travel};

const SEEDS: u64 = 16;

fn over(journey: Journey, how: Recorded) -> Journeys {
    let found = Journeys::over(journey, how, SEEDS);
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
        let found = over(journey, Recorded::default());
        assert!(found.below > 0.92 && found.greatest < 5.0, "{found}");
        assert!(found.valid > 0.5 && found.rests > 0.2, "{found}");
        let found = over(
            journey,
            Recorded {
                zupt: false,
                ..Recorded::default()
            },
        );
        assert!(found.below > 0.8 && found.greatest < 6.0, "{found}");
    }
}

#[test]
fn a_steady_push_is_not_taken_for_a_tilt() {
    for gyroscope in [true, false] {
        for zupt in [true, false] {
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
                assert!(found.below > 0.7 && found.greatest < 7.0, "{found}");
            }
        }
    }
}

#[test]
fn even_motion_is_seen_or_the_way_that_it_may_have_gone_is_told() {
    for gyroscope in [true, false] {
        for speed in [0.02, 0.05, 0.1, 0.4, 1.0] {
            for seed in 0..SEEDS {
                let how = Recorded {
                    gyroscope,
                    ..Recorded::default()
                };
                let shown = travel(Journey::Cart(speed), how, seed);
                assert!(
                    shown.worst < 5.0 || shown.off_m < shown.unseen_m,
                    "{speed} m/s, seed {seed}, gyroscope {gyroscope}: {shown:?}"
                );
            }
        }
    }
    let slow = Journeys::over(Journey::Cart(0.1), Recorded::default(), SEEDS);
    let fast = over(Journey::Cart(1.0), Recorded::default());
    assert!(slow.unseen_m > 0.5 && fast.below > 0.95, "{slow}\n{fast}");
}

#[test]
fn what_a_gyroscope_or_samples_leave_out_is_doubted() {
    for journey in [Journey::Moves(0.3), Journey::Moves(1.5)] {
        for missing_s in [0.05, 0.2, 1.0] {
            let failed = over(
                journey,
                Recorded {
                    fails_s: missing_s,
                    ..Recorded::default()
                },
            );
            assert!(failed.below > 0.92 && failed.greatest < 5.0, "{failed}");
            if missing_s > 0.5 {
                continue;
            }
            let hole = over(
                journey,
                Recorded {
                    hole_s: missing_s,
                    ..Recorded::default()
                },
            );
            assert!(hole.below > 0.92 && hole.greatest < 5.0, "{hole}");
            let jump = over(
                journey,
                Recorded {
                    jump_s: missing_s,
                    ..Recorded::default()
                },
            );
            assert!(jump.below > 0.65 && jump.greatest < 8.0, "{jump}");
        }
    }
}
