//! Whether the truth lies within the covariance of the one-unit filter: a few seeds of what the example
//! `consistency` prints for many.

use crate::common;

use common::motions::{Consistency, KINDS, Kind};

#[test]
fn in_any_manner_of_motion_the_truth_lies_within_the_covariance() {
    for kind in KINDS {
        for gyroscope in [false, true] {
            let found = Consistency::over(kind, 50.0, gyroscope, 40);
            println!("{found}");
            assert!(found.below.iter().all(|b| *b >= 0.9), "{found}");
            assert!(
                found.nees.iter().all(|n| (0.05..3.5).contains(n)),
                "{found}"
            );
            // Vibration between the samples is more than its level at rest says.
            let most = if kind == Kind::Vibration { 3.0 } else { 1.3 };
            assert!((0.1..most).contains(&found.nis), "{found}");
        }
    }
}

#[test]
fn at_any_rate_a_hand_s_motion_is_known_as_well_as_said() {
    for rate in [10.0, 200.0, 1000.0] {
        for gyroscope in [false, true] {
            let found = Consistency::over(Kind::Hand, rate, gyroscope, 20);
            println!("{found}");
            assert!(found.below.iter().all(|b| *b >= 0.85), "{found}");
        }
    }
}
