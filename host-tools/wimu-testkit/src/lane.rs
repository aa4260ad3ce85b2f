//! The lane that a test runs in.

/// How much a statistical test may cost. Set by `cargo xtask` in the environment variable `WIMU_LANE`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// Before each commit: about 20 draws.
    Check,
    /// The default: a tenth of a campaign's draws.
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

    fn trials(self, full: usize) -> usize {
        let few = full.min(20);
        self.choose([few, (full / 10).clamp(few, full), full])
    }
}

/// Draws that a statistical test takes in this lane; `full` of them in a campaign.
pub fn trials(full: usize) -> usize {
    Lane::current().trials(full)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lane_takes_no_more_draws_than_a_campaign_and_no_fewer_than_twenty() {
        let all = |full| [Lane::Check, Lane::Test, Lane::Campaign].map(|lane| lane.trials(full));
        assert_eq!(all(1000), [20, 100, 1000]);
        assert_eq!(all(100), [20, 20, 100]);
        assert_eq!(all(6), [6, 6, 6]);
    }
}
