//! Rests that another system knows: a brake, a switch under a foot, a dock.

use wimu_nav::sensor::Velocity;

use super::Kind;
use crate::formats::table::NUMBER;

/// 1 while the velocity is zero, 0 while it is not known. Usual σ, m/s: that of a detected rest.
pub static REST: Kind = Kind {
    name: "rest",
    one: "known rest",
    columns: &[&["Rest"]],
    unit: NUMBER,
    usual_sd: Some(0.01),
    update: |aid, to| {
        let is_rest = aid.value[0] > 0.5;
        if is_rest { to.with(Velocity::zero(aid.sd[0], None)) } else { None }
    },
    ..Kind::DEFAULT
};
