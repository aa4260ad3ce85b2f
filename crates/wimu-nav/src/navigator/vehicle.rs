//! A unit in a vehicle: mounting, non-holonomic constraint, odometer, and the antenna of fixes. Equations (180) to (186).

use nalgebra::{RealField, Vector3};

use crate::filter::{Filter, Gate, Innovation};
use crate::process::RandomWalk;
use crate::rotation::real;
use crate::sensor::{Antenna, ForwardAxis, Mounting, NonHolonomic, Odometer, Position};
use crate::smoother::Recorder;
use crate::state::{ATTITUDE, Block, Layout, LayoutFull, Role, VELOCITY};

/// Errors of a vehicle and of the sensors beside the unit, all as standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct VehicleErrors<R> {
    /// Velocity of the axle across the forward axis, m/s, to the left and up, at intervals of 0.2 s: chosen on one drive of
    /// a car (score_localization).
    pub across_mps: [R; 2],
    /// Axle from the unit, m, a component: anywhere in a car.
    pub axle_m: R,
    /// Antenna from its lever arm, m, a component.
    pub antenna_m: R,
    /// Clock of the samples against that of the fixes, s.
    pub clock_s: R,
    /// Scale factor of the odometer: tyres.
    pub scale: R,
    /// Noise of a speed of the odometer, m/s, and over the speed.
    pub speed: [R; 2],
}

impl<R: RealField> Default for VehicleErrors<R> {
    fn default() -> Self {
        Self {
            across_mps: [real(0.1), real(0.2)],
            axle_m: real(1.0),
            antenna_m: real(0.5),
            clock_s: real(0.2),
            scale: real(0.05),
            speed: [real(0.05), real(0.01)],
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
pub struct Vehicle<R> {
    errors: VehicleErrors<R>,
    mounting: Mounting,
    antenna: Block<3>,
    clock: Block<1>,
    scale: Block<1>,
    /// Whether the forward axis is known.
    known: bool,
    /// Integral of the angular rate since the last constraint, and its mean before that, rad/s.
    turned: Vector3<R>,
    rate: Vector3<R>,
    /// Mean acceleration of the last samples, m/s², navigation frame.
    acceleration: Vector3<R>,
    lasts_s: R,
    failing_s: R,
    reverse: bool,
    turns: u32,
    slips: u32,
    speeds: u32,
}

impl<R: RealField + Copy> Vehicle<R> {
    pub(super) fn claim<const N: usize>(
        layout: &mut Layout<R, N>,
        errors: &VehicleErrors<R>,
    ) -> Result<Self, LayoutFull> {
        let role = Role::Estimated;
        let mounting = Mounting {
            forward: layout.claim(role, [real(UNKNOWN_AXIS); 3])?,
            axle: layout.claim(role, [errors.axle_m; 3])?,
        };
        Ok(Self {
            errors: *errors,
            mounting,
            antenna: layout.claim(role, [errors.antenna_m; 3])?,
            clock: layout.claim(role, [errors.clock_s])?,
            scale: layout.claim(role, [errors.scale])?,
            known: false,
            turned: Vector3::zeros(),
            rate: Vector3::zeros(),
            acceleration: Vector3::zeros(),
            lasts_s: R::zero(),
            failing_s: R::zero(),
            reverse: false,
            turns: 0,
            slips: 0,
            speeds: 0,
        })
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

    /// Speeds of the odometer that failed their test, and all that were tested.
    pub fn slips(&self) -> (u32, u32) {
        (self.slips, self.speeds)
    }

    /// A fix by an antenna of the vehicle.
    pub(super) fn antenna(&self, fix: Position<R>, age_s: R, rate_rad_s: Vector3<R>) -> Antenna<R> {
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
    pub(super) fn accelerate(&mut self, acceleration: Vector3<R>, step_s: R) {
        let weight = (step_s / real(MEAN_S)).min(R::one());
        self.acceleration += (acceleration - self.acceleration) * weight;
    }

    /// After a sample: the constraint, or the forward axis while it is not known.
    pub(super) fn step<const N: usize>(
        &mut self,
        filter: &mut Filter<R, N>,
        rate: &Vector3<R>,
        step_s: R,
        at_rest: bool,
        recorder: &mut impl Recorder<R, N>,
    ) {
        self.turned += rate * step_s;
        self.lasts_s += step_s;
        if self.lasts_s < real(INTERVAL_S) {
            return;
        }
        self.rate = self.turned / self.lasts_s;
        let lasts_s = core::mem::replace(&mut self.lasts_s, R::zero());
        self.turned = Vector3::zeros();
        if at_rest {
            return;
        }
        if !self.known {
            self.find_axis(filter, recorder);
            return;
        }
        let constraint = NonHolonomic {
            mounting: &self.mounting,
            rate_rad_s: self.rate,
            deviation_mps: self.errors.across_mps,
        };
        let fits = filter.update_recorded(&constraint, Gate::ChiSquare, recorder);
        self.failing_s = match fits.accepted {
            true => R::zero(),
            false => self.failing_s + lasts_s,
        };
        if self.failing_s >= real(TURNED_S) {
            let unknown = RandomWalk {
                block: self.mounting.forward,
                density: real(UNKNOWN_AXIS),
                step_s: R::one(),
            };
            filter.predict_recorded(&unknown, recorder);
            (self.known, self.failing_s) = (false, R::zero());
            self.turns += 1;
        }
    }

    /// Takes the direction of the velocity for the forward axis.
    fn find_axis<const N: usize>(
        &mut self,
        filter: &mut Filter<R, N>,
        recorder: &mut impl Recorder<R, N>,
    ) {
        let velocity = filter.state.get(VELOCITY);
        let speed = velocity.norm();
        let variance = filter.covariance(VELOCITY).diagonal().max();
        let heading = filter.covariance(ATTITUDE)[(2, 2)];
        let square = |x: f64| real::<R>(x * x);
        if speed < real(LEAST_SPEED)
            || variance > square(VELOCITY_KNOWN)
            || heading > square(HEADING_KNOWN)
        {
            return;
        }
        let sign = if self.reverse { -R::one() } else { R::one() };
        let axis = ForwardAxis {
            block: self.mounting.forward,
            direction: filter.state.attitude.inverse() * velocity * (sign / speed),
            deviation_rad: real(AXIS),
        };
        let update = filter.update_recorded(&axis, Gate::Open, recorder);
        self.known = update.accepted;
    }

    /// A speed of the wheels. Those that slip or lock fail the test.
    pub(super) fn odometer<const N: usize>(
        &mut self,
        filter: &mut Filter<R, N>,
        speed_mps: R,
        recorder: &mut impl Recorder<R, N>,
    ) -> Option<Innovation<R>> {
        self.reverse = speed_mps < R::zero();
        if !self.known {
            return None;
        }
        let [least, fraction] = self.errors.speed;
        let noise = least * least + fraction * fraction * speed_mps * speed_mps;
        let odometer = Odometer {
            mounting: &self.mounting,
            scale: self.scale,
            speed_mps,
            deviation_mps: noise.sqrt(),
            rate_rad_s: self.rate,
        };
        let innovation = filter.update_recorded(&odometer, Gate::ChiSquare, recorder);
        self.speeds += 1;
        self.slips += u32::from(!innovation.accepted);
        Some(innovation)
    }
}
