//! A unit in a vehicle: mounting, non-holonomic constraint, odometer, and the antenna of fixes. Equations (180) to (186).

use nalgebra::Vector3;

use crate::filter::{Filter, Gate, Innovation};
use crate::process::RandomWalk;
use crate::sensor::{Antenna, Known, Mounting, NonHolonomic, Odometer, Position};
use crate::state::{ATTITUDE, Block, Layout, Role, VELOCITY};

/// Errors of a vehicle and of the sensors beside the unit, all as standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct VehicleErrors {
    /// Velocity of the axle across the forward axis, m/s, to the left and up, at intervals of 0.2 s: chosen on one drive of
    /// a car (score_localization).
    pub across_mps: [f64; 2],
    /// Axle from the unit, m, a component: anywhere in a car.
    pub axle_m: f64,
    /// Antenna from its lever arm, m, a component.
    pub antenna_m: f64,
    /// Clock of the samples against that of the fixes, s.
    pub clock_s: f64,
    /// Scale factor of the odometer: tyres.
    pub scale: f64,
    /// Noise of a speed of the odometer, m/s, and over the speed.
    pub speed: [f64; 2],
}

impl Default for VehicleErrors {
    fn default() -> Self {
        Self {
            across_mps: [0.1, 0.2],
            axle_m: 1.0,
            antenna_m: 0.5,
            clock_s: 0.2,
            scale: 0.05,
            speed: [0.05, 0.01],
        }
    }
}

/// Standard deviation of a component of the forward axis before it is known, and of its measurement, rad: side-slip, tilt.
const UNKNOWN_AXIS: f64 = 1.0;
const AXIS: f64 = 0.1;
/// The forward axis is measured at this speed, m/s, where velocity and heading are known to this, m/s, rad.
const LEAST_SPEED: f64 = 3.0;
const VELOCITY_KNOWN: f64 = 0.3;
const HEADING_KNOWN: f64 = 0.1;
/// Interval of the constraint, s: it averages the vibration of the angular rate.
const INTERVAL_S: f64 = 0.2;
/// The forward axis has changed if the constraint fails its test for so long, s: longer than a skid.
const TURNED_S: f64 = 3.0;

/// Time constant of the mean acceleration, s: it averages vibration.
const MEAN_S: f64 = 0.1;

/// The vehicle and its states.
#[derive(Clone, Copy, Debug)]
pub struct Vehicle {
    errors: VehicleErrors,
    mounting: Mounting,
    antenna: Block<3>,
    clock: Block<1>,
    scale: Block<1>,
    /// Whether the forward axis is known.
    known: bool,
    /// Integral of the angular rate since the last constraint, and its mean before that, rad/s.
    turned: Vector3<f64>,
    rate: Vector3<f64>,
    /// Mean acceleration of the last samples, m/s², navigation frame.
    acceleration: Vector3<f64>,
    lasts_s: f64,
    failing_s: f64,
    reverse: bool,
    turns: u32,
}

impl Vehicle {
    pub(super) fn claim(layout: &mut Layout, errors: &VehicleErrors) -> Self {
        let role = Role::Estimated;
        let mounting = Mounting {
            forward: layout.claim(role, [UNKNOWN_AXIS; 3]),
            axle: layout.claim(role, [errors.axle_m; 3]),
        };
        Self {
            errors: *errors,
            mounting,
            antenna: layout.claim(role, [errors.antenna_m; 3]),
            clock: layout.claim(role, [errors.clock_s]),
            scale: layout.claim(role, [errors.scale]),
            known: false,
            turned: Vector3::zeros(),
            rate: Vector3::zeros(),
            acceleration: Vector3::zeros(),
            lasts_s: 0.0,
            failing_s: 0.0,
            reverse: false,
            turns: 0,
        }
    }

    /// Forward axis of the vehicle in the body frame, not of unit length, once it is known.
    pub fn forward(&self) -> Option<Block<3>> {
        self.known.then_some(self.mounting.forward)
    }

    /// The clock of the samples is behind that of the fixes by this time, s.
    pub fn clock(&self) -> Block<1> {
        self.clock
    }

    /// Antenna from its lever arm, m, body frame.
    pub fn antenna_offset(&self) -> Block<3> {
        self.antenna
    }

    /// Scale error of the odometer.
    pub fn scale(&self) -> Block<1> {
        self.scale
    }

    /// Times at which the forward axis changed: the unit was turned in its mount.
    pub fn turns(&self) -> u32 {
        self.turns
    }

    /// A fix by an antenna of the vehicle.
    pub(super) fn antenna(&self, fix: Position, age_s: f64, rate_rad_s: Vector3<f64>) -> Antenna {
        Antenna {
            fix,
            offset: self.antenna,
            clock: self.clock,
            age_s,
            rate_rad_s,
            acceleration_mps2: self.acceleration,
        }
    }

    /// The acceleration of a sample, m/s², navigation frame.
    pub(super) fn accelerate(&mut self, acceleration: Vector3<f64>, step_s: f64) {
        let weight = (step_s / MEAN_S).min(1.0);
        self.acceleration += (acceleration - self.acceleration) * weight;
    }

    /// After a sample: the constraint, or the forward axis while it is not known.
    pub(super) fn step(
        &mut self,
        filter: &mut Filter,
        rate: &Vector3<f64>,
        step_s: f64,
        at_rest: bool,
    ) {
        self.turned += rate * step_s;
        self.lasts_s += step_s;
        if self.lasts_s < INTERVAL_S {
            return;
        }
        self.rate = self.turned / self.lasts_s;
        let lasts_s = core::mem::replace(&mut self.lasts_s, 0.0);
        self.turned = Vector3::zeros();
        if at_rest {
            return;
        }
        if !self.known {
            self.find_axis(filter);
            return;
        }
        let constraint = NonHolonomic {
            mounting: &self.mounting,
            rate_rad_s: self.rate,
            deviation_mps: self.errors.across_mps,
        };
        let fits = filter.update(&constraint, Gate::ChiSquare);
        self.failing_s = if fits.accepted { 0.0 } else { self.failing_s + lasts_s };
        if self.failing_s >= TURNED_S {
            let unknown =
                RandomWalk { block: self.mounting.forward, density: UNKNOWN_AXIS, step_s: 1.0 };
            filter.predict(&unknown);
            (self.known, self.failing_s) = (false, 0.0);
            self.turns += 1;
        }
    }

    /// Takes the direction of the velocity for the forward axis.
    fn find_axis(&mut self, filter: &mut Filter) {
        let velocity = filter.state.get(VELOCITY);
        let speed = velocity.norm();
        let variance = filter.covariance(VELOCITY).diagonal().max();
        let heading = filter.covariance(ATTITUDE)[(2, 2)];
        let square = |x: f64| x * x;
        if speed < LEAST_SPEED
            || variance > square(VELOCITY_KNOWN)
            || heading > square(HEADING_KNOWN)
        {
            return;
        }
        let sign = if self.reverse { -1.0 } else { 1.0 };
        let axis = Known {
            block: self.mounting.forward,
            value: filter.state.attitude.inverse() * velocity * (sign / speed),
            deviation: [AXIS; 3],
        };
        let update = filter.update(&axis, Gate::Open);
        self.known = update.accepted;
    }

    /// A speed of the wheels. Those that slip or lock fail the test.
    pub(super) fn odometer(&mut self, filter: &mut Filter, speed_mps: f64) -> Option<Innovation> {
        self.reverse = speed_mps < 0.0;
        if !self.known {
            return None;
        }
        let [least, fraction] = self.errors.speed;
        let noise = least * least + fraction * fraction * speed_mps * speed_mps;
        let odometer = Odometer {
            mounting: &self.mounting,
            scale: self.scale,
            speed_mps,
            deviation_mps: libm::sqrt(noise),
            rate_rad_s: self.rate,
        };
        Some(filter.update(&odometer, Gate::ChiSquare))
    }
}
