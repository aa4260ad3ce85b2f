//! The lane that a test runs in.

use std::sync::LazyLock;

use crate::coverage::fewest_draws;

/// How much a statistical test may cost. Set by `cargo xtask` in the environment variable `WIMU_LANE`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// Before each commit: about 20 counts.
    Check,
    /// The default: the fewest draws that show a fault.
    Test,
    /// All draws, in release.
    Campaign,
}

impl Lane {
    /// The lane of this process.
    ///
    /// # Panics
    /// When `WIMU_LANE` is something else than `check`, `test` or `campaign`.
    pub fn current() -> Self {
        match std::env::var("WIMU_LANE").as_deref() {
            Err(_) | Ok("test") => Self::Test,
            Ok("check") => Self::Check,
            Ok("campaign") => Self::Campaign,
            Ok(other) => panic!("WIMU_LANE is `{other}`: check, test or campaign"),
        }
    }

    /// Which of a check's, a test's and a campaign's value applies.
    pub fn choose<T>(self, [check, test, campaign]: [T; 3]) -> T {
        match self {
            Self::Check => check,
            Self::Test => test,
            Self::Campaign => campaign,
        }
    }

    fn draws(self, full: usize, counts: usize) -> usize {
        let few = |of: usize| of.div_ceil(counts).min(full);
        self.choose([few(20), few(*FEWEST), full])
    }

    fn cases(self, full: u32) -> u32 {
        self.choose([20, 256, full]).min(full)
    }
}

/// Counts of a test: the fewest of which a deviation that is stated too small by a factor of two fails. Its 95 % interval
/// holds the truth in Φ(0.98) − Φ(−0.98) = 67.3 % of draws, where a test expects at least 93 %.
static FEWEST: LazyLock<usize> = LazyLock::new(|| fewest_draws(0.93, 0.673));

/// Draws that a statistical test takes in this lane; `full` of them in a campaign.
pub fn trials(full: usize) -> usize {
    draws(full, 1)
}

/// The same where each draw adds `counts` independent counts, such as one for each axis.
pub fn draws(full: usize, counts: usize) -> usize {
    Lane::current().draws(full, counts)
}

/// Cases of a property in this lane; `full` of them in a campaign.
pub fn cases(full: u32) -> u32 {
    Lane::current().cases(full)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lane_takes_no_more_draws_than_a_campaign_and_no_fewer_than_show_a_fault() {
        let lanes = [Lane::Check, Lane::Test, Lane::Campaign];
        let all = |full, counts| lanes.map(|lane| lane.draws(full, counts));
        assert_eq!(all(1000, 1), [20, 98, 1000]);
        assert_eq!(all(1000, 3), [7, 33, 1000]);
        assert_eq!(all(6, 1), [6, 6, 6]);
        assert_eq!(lanes.map(|lane| lane.cases(1000)), [20, 256, 1000]);
    }
}
