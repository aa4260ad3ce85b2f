//! Position or height by another system, and the end of a path that closes.

use nalgebra::Vector3;
use wimu_nav::filter::{Filter, Gate};
use wimu_nav::sensor::{Measurement, Position, Prediction};
use wimu_nav::state::Block;

use super::{Aid, Kind, Outcome, State, Update};
use crate::formats::table::LENGTH;

/// Position of an antenna. Usual σ: GNSS without corrections.
const FIX: Kind = Kind {
    name: "position",
    one: "fix",
    columns: &[&["Position E"], &["Position N"], &["Position U", "Height"]],
    unit: LENGTH,
    usual_sd: Some(3.0),
    update,
    ..Kind::DEFAULT
};

/// Position of an antenna whose lever arm is given, or zero.
pub static POSITION: Kind = FIX;

/// The same of an antenna whose lever arm is not known: 0 ± 1 m. Assumed: it is in reach of the unit.
pub static ANTENNA: Kind = Kind {
    states: &[
        State { name: "lever arm x", unit: "m", sd: 1.0, walk: 0.0 },
        State { name: "lever arm y", unit: "m", sd: 1.0, walk: 0.0 },
        State { name: "lever arm z", unit: "m", sd: 1.0, walk: 0.0 },
    ],
    ..FIX
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
    if let [x, y, z] = *to.states {
        return to.with(Antenna { fix: position, offset: [x, y, z] });
    }
    Some(to.navigator.fix(position, [to.age_s, to.time_sd_s], Gate::ChiSquare).into())
}

/// A fix, and its lever arm beyond the given one, body axes: (170) and ∂z/∂a = C.
struct Antenna {
    fix: Position,
    offset: [Block<1>; 3],
}

impl Measurement for Antenna {
    fn predict(&self, filter: &Filter) -> Prediction {
        let state = &filter.state;
        let offset = Vector3::from(self.offset.map(|block| state.get(block).x));
        let lever_arm_m = self.fix.lever_arm_m + offset;
        let turned = self.fix.measured() * state.attitude.matrix();
        let by_axis = self.offset.into_iter().zip(turned.column_iter());
        let predicted = Position { lever_arm_m, ..self.fix }.predict(filter);
        by_axis.fold(predicted, |found, (block, column)| found.by(block, column.into_owned()))
    }
}
