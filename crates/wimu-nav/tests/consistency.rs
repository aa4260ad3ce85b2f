//! Whether the truth lies within the covariance of the navigator: a few draws of what the example `consistency` prints
//! for many.

use crate::common;

use common::consistency::{Consistency, KINDS, Kind};
use wimu_testkit::trials;

#[test]
fn in_each_kind_of_motion_the_truth_lies_within_the_covariance() {
    for kind in KINDS {
        for gyroscope in kind.gyroscopes() {
            let found = Consistency::over(kind, gyroscope, trials(200) as u64);
            println!("{found}");
            // Simulated rests are exact, and the filter assumes 1 cm/s: conservative. Without a gyroscope a displacement
            // slower than the oscillator of the model is found in part only: overconfident.
            let slow = kind == Kind::StopAndGo && !gyroscope;
            let least = if slow { 0.7 } else { 0.93 };
            for below in found.below {
                below.assert_can_be(least..=1.0, &found.to_string());
            }
            // The median of χ² with three degrees of freedom is 2.37.
            let most = if slow { 6.0 } else { 3.3 };
            assert!(found.median.iter().all(|n| (0.2..most).contains(n)), "{found}");
            assert!(kind != Kind::Foot || found.median.iter().all(|n| *n > 1.0), "{found}");
        }
    }
}
