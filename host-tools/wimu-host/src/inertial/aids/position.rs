//! Position or height by another system, and the end of a path that closes.

use wimu_nav::filter::Gate;
use wimu_nav::sensor::Position;

use super::{Aid, Kind, Outcome, Update};
use crate::formats::table::LENGTH;

/// Position of an antenna. Usual σ: GNSS without corrections.
pub static POSITION: Kind = Kind {
    name: "position",
    one: "fix",
    columns: &[&["Position E"], &["Position N"], &["Position U", "Height"]],
    unit: LENGTH,
    usual_sd: Some(3.0),
    update,
    ..Kind::DEFAULT
};

/// The path ends where it began.
pub static LOOP: Kind = Kind {
    name: "loop",
    one: "loop closure",
    remedy: "leave out --loop if the path does not close, or give its distance: --loop M",
    update,
    ..Kind::DEFAULT
};

fn update(aid: &Aid, to: &mut Update<'_>) -> Option<Outcome> {
    let position = Position {
        position_m: aid.value.into(),
        deviation_m: aid.sd.into(),
        lever_arm_m: aid.lever_arm_m.into(),
    };
    Some(to.navigator.fix(position, [to.age_s, to.time_sd_s], Gate::ChiSquare).into())
}
