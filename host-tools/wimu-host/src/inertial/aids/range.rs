//! Range to an anchor whose bias, scale and correlated error are states: see [`localization`](crate::localization).

use super::{Aid, Kind, Mounting};

/// Range to the anchor of its source. It is never rejected: its weight is the probability of a line of sight.
pub static RANGE: Kind = Kind {
    name: "range",
    one: "range",
    update: |aid, to| {
        let states = to.anchors.as_mut()?;
        Some(states.update(aid, to.age_s, to.navigator))
    },
    ..Kind::DEFAULT
};

impl Aid {
    /// A range to an anchor by its index, m.
    pub fn range(time_s: f64, anchor: usize, range_m: f64) -> Self {
        Self { source: anchor, ..Self::of(&RANGE, time_s, &[range_m], 0.0) }
    }

    /// The same, of an antenna with a lever arm.
    pub fn mounted(&self, mounting: &Mounting) -> Self {
        Self { lever_arm_m: mounting.lever_arm_m, ..*self }
    }
}
