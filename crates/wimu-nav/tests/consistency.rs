//! Whether the truth lies within the covariance of the one-unit filter: a few seeds of what the example
//! `consistency` prints for many.

use crate::common;

use common::motions::{Consistency, KINDS, Kind};
use wimu_testkit::trials;

#[test]
fn in_any_kind_of_motion_the_truth_lies_within_the_covariance() {
    for kind in KINDS {
        for gyroscope in [false, true] {
            let found = Consistency::over(kind, 50.0, gyroscope, trials(1000) as u64);
            println!("{found}");
            // Conservative: the simulated motions are smoother than the filter expects.
            for below in found.below {
                below.assert_can_be(0.9..=1.0, &found.to_string());
            }
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
            let found = Consistency::over(Kind::Hand, rate, gyroscope, trials(200) as u64);
            println!("{found}");
            for below in found.below {
                below.assert_can_be(0.9..=1.0, &found.to_string());
            }
        }
    }
}
