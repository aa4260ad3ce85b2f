//! Zero-velocity updates of an array: an assumption.

/// What a detected rest means. An accelerometer does not distinguish a rest from constant velocity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Zupt {
    /// The velocity is taken as zero. The covariance includes what an undetected constant velocity may have caused.
    #[default]
    Assumed,
    /// The velocity is zero: the caller knows that the unit was at rest. The covariance depends on it.
    Stated,
    /// Nothing. Only the rest at the start is used, for the alignment.
    Off,
}

impl Zupt {
    /// Whether the velocity at a rest is taken as zero.
    pub fn is_on(self) -> bool {
        self != Self::Off
    }
}
