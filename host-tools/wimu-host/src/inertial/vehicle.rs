//! A unit in a vehicle: positions by the clock of the fixes, and findings. Equations (187) and (188).

use nalgebra::{Matrix3, Vector3};
use wimu_nav::navigator::Navigator;
use wimu_nav::state::{POSITION, VELOCITY};

use super::PathPoint;
use crate::{Code, Problem};

/// A clock offset that is reported, s: 0.2 m at 10 m/s. Standard deviations that it must exceed.
const CLOCK_S: f64 = 0.02;
const CLOCK_SIGMAS: f64 = 3.0;

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
