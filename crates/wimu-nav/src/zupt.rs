//! Zero-velocity updates: an assumption.

/// What is made of a stillness. No accelerometer tells a rest from even motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Zupt {
    /// It is taken for a rest, and the covariance holds what even motion could have hidden there: the truth lies
    /// within it either way.
    #[default]
    Assumed,
    /// It is a rest: who says so knows that it was. The covariance depends on it.
    Stated,
    /// It says nothing of the velocity. That at the start is one nevertheless.
    Off,
}

impl Zupt {
    /// Whether velocity is taken for zero at a stillness.
    pub fn is_on(self) -> bool {
        self != Self::Off
    }
}
