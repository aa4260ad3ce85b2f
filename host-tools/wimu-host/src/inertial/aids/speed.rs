//! Speed by the wheels of a vehicle.

use std::path::Path;

use super::{Aid, Aids, Kind, Mounting};
use crate::Result;
use crate::formats::table::{LENGTH, Measurements, SPEED as UNITS, TIME};

/// Speed over ground, positive forward, with the profile of a vehicle; it has the noise of one.
pub static SPEED: Kind = Kind {
    name: "speed",
    one: "speed",
    columns: &[&["Speed"]],
    unit: UNITS,
    // A hundred times the fraction that a test rejects: wheels that slip or lock.
    rejects: 0.1,
    remedy: "wheels slip or lock: check the unit and the sign of the speed",
    needs: "they need --profile vehicle, and a drive that shows the forward axis",
    update: |aid, to| Some(to.navigator.odometer(aid.value[0])?.into()),
    ..Kind::DEFAULT
};

impl Aids {
    /// Reads the wheel odometry of a vehicle: `Time (s)` and `Speed (m/s)`, or `Distance Increment (m)` of the interval that
    /// ends at its time.
    ///
    /// # Errors
    /// Those of [`Aids::read`].
    pub fn read_odometry(path: &Path) -> Result<Self> {
        let table = Measurements::read(path)?;
        if table.column(&["Speed"], UNITS).is_some() {
            let mut found = Self::of(&table, None, &Mounting::default())?;
            found.aids.retain(|aid| *aid.kind == SPEED);
            return Ok(found);
        }
        let time = table.needed(&["Time"], TIME)?;
        let distance = table.needed(&["Distance Increment"], LENGTH)?;
        let (mut aids, mut before) = (Vec::new(), None);
        for row in 0..table.len() {
            let (Some(time_s), Some(moved_m)) =
                (table.value(row, time)?, table.value(row, distance)?)
            else {
                continue;
            };
            if let Some(lasts_s) = before.map(|from_s| time_s - from_s).filter(|s| *s > 0.0) {
                // The mean speed of the interval is that of its middle.
                aids.push(Aid::of(&SPEED, time_s - 0.5 * lasts_s, &[moved_m / lasts_s], 0.0));
            }
            before = Some(time_s);
        }
        if aids.is_empty() {
            return Err(table.empty("there is no speed", "check the file"));
        }
        aids.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        Ok(Self { aids, ..Self::default() })
    }
}
