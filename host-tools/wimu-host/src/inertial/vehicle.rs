//! A unit in a vehicle: wheel speeds from a file, positions by the clock of the fixes, and findings. Equations (187)
//! and (188).

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use wimu_nav::navigator::Navigator;
use wimu_nav::state::{POSITION, VELOCITY};

use super::{Fixes, PathPoint};
use crate::formats::table::{LENGTH, Measurements, SPEED, TIME};
use crate::{Code, Problem, Result};

/// A clock offset that is reported, s: 0.2 m at 10 m/s. Standard deviations that it must exceed.
const CLOCK_S: f64 = 0.02;
const CLOCK_SIGMAS: f64 = 3.0;
/// Fraction of the wheel speeds that fail their test without a finding: a hundred times that of a test.
const SLIPS: f64 = 0.1;

impl Fixes {
    /// Adds the speeds of a table of wheel odometry: `Time (s)` and `Speed (m/s)`, or `Distance Increment (m)` of the
    /// interval that ends at its time.
    ///
    /// # Errors
    /// `file_unreadable`, `csv_missing_column`, `csv_bad_number`, `no_rows` without a speed.
    pub fn with_odometry(mut self, path: &Path) -> Result<Self> {
        let table = Measurements::read(path)?;
        let time = table.needed(&["Time"], TIME)?;
        let speed = table.column(&["Speed"], SPEED);
        let distance = match speed {
            Some(speed) => speed,
            None => table.needed(&["Distance Increment"], LENGTH)?,
        };
        let mut before: Option<f64> = None;
        for row in 0..table.len() {
            let (Some(time_s), Some(value)) =
                (table.value(row, time)?, table.value(row, distance)?)
            else {
                continue;
            };
            match (speed, before) {
                (Some(_), _) => self.speeds.push([time_s, value]),
                // The mean speed of the interval is that of its middle.
                (None, Some(from_s)) if time_s > from_s => {
                    let lasts_s = time_s - from_s;
                    self.speeds.push([time_s - 0.5 * lasts_s, value / lasts_s]);
                }
                _ => {}
            }
            before = Some(time_s);
        }
        if self.speeds.is_empty() {
            return Err(table.empty("there is no speed", "check the file"));
        }
        self.speeds.sort_by(|a, b| a[0].total_cmp(&b[0]));
        Ok(self)
    }
}

/// The position at the time stamp of a point by the clock of the fixes. Equation (188).
pub(super) fn by_clock_of_fixes(point: &mut PathPoint, navigator: &Navigator) {
    let Some(vehicle) = navigator.vehicle() else {
        return;
    };
    let (filter, clock) = (navigator.filter(), vehicle.clock());
    let offset_s = filter.state.get(clock).x;
    let velocity = filter.state.get(VELOCITY);
    let cross = filter.cross_covariance(POSITION, VELOCITY) * offset_s
        + (filter.cross_covariance(POSITION, clock)
            + filter.cross_covariance(VELOCITY, clock) * offset_s)
            * velocity.transpose();
    let covariance = filter.covariance(POSITION)
        + cross
        + cross.transpose()
        + filter.covariance(VELOCITY) * (offset_s * offset_s)
        + velocity * filter.covariance(clock) * velocity.transpose();
    let covariance: Matrix3<f64> = (covariance + covariance.transpose()) * 0.5;
    point.position_m = (Vector3::from(point.position_m) + velocity * offset_s).into();
    point.covariance_m2 = covariance.into();
    point.filtered_sd_m = point.sd_m();
}

/// What the vehicle has shown: slip of the wheels, a unit that was turned, a clock that is off.
pub(super) fn findings(navigator: &Navigator) -> Vec<Problem> {
    let mut found = Vec::new();
    let Some(vehicle) = navigator.vehicle() else {
        return found;
    };
    let filter = navigator.filter();
    let clock = vehicle.clock();
    let (offset_s, sd_s) = (filter.state.get(clock).x, filter.covariance(clock).x.sqrt());
    if offset_s.abs() > CLOCK_S && offset_s.abs() > CLOCK_SIGMAS * sd_s {
        let order = if offset_s > 0.0 { "late" } else { "early" };
        let text = format!(
            "the time stamps of the samples are {:.3} ± {sd_s:.3} s {order} against those of the fixes: corrected",
            offset_s.abs()
        );
        found.push(Code::Clock.note(text));
    }
    let (slips, speeds) = vehicle.slips();
    if f64::from(slips) > SLIPS * f64::from(speeds) {
        let text = format!(
            "wheels slip or lock: {slips} of {speeds} speeds contradict the path and are not used"
        );
        found.push(Code::Navigation.warning(text));
    }
    if vehicle.turns() > 0 {
        let text = format!(
            "the unit was turned in its mount, or the vehicle skidded ({}×): the forward axis was found anew",
            vehicle.turns()
        );
        let remedy = "fix the unit to the body of the vehicle";
        found.push(Code::Navigation.warning(text).remedy(remedy));
    }
    found
}
