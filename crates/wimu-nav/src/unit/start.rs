//! The first attitude, and what is given from outside.

use super::model::{DISTURBANCE_UT, UNKNOWN_MPS};
use super::{
    ACCELERATION, BIAS, BIAS_RAD_S, Covariance, FIELD, Group, OMEGA, PHI, POSITION, RISE, STATES,
    SWING, UnitFilter, UnitSample, Unseen, VELOCITY,
};
use crate::Real;
use crate::vector::{Vector, add, cross, dot, norm, product, scale, skew, sub, times, turn};

impl<R: Real> UnitFilter<R> {
    pub(super) fn gather(&mut self, force: Vector<R>, sample: &UnitSample<R>, step: R) {
        let group = &mut self.group;
        group.force = add(group.force, force);
        group.square += dot(force, force);
        group.count += R::from_f64(1.0);
        group.time_s += step;
        if let Some(field) = sample.field_ut {
            group.field = add(group.field, field);
            group.fields += R::from_f64(1.0);
        }
    }

    /// A start in motion ends with a rest, from which all begins as at one that was there before.
    pub(super) fn start_anew(&mut self) {
        let Some(shown) = self.quiet.shown() else {
            return;
        };
        let mean = add(
            self.quiet.about(),
            scale(shown.force, R::from_f64(1.0) / shown.count),
        );
        let square = dot(mean, mean) + R::from_f64(3.0) * shown.spread();
        self.group = Group {
            count: shown.count,
            force: scale(mean, shown.count),
            square: square * shown.count,
            field: shown.field,
            fields: shown.fields,
            ..Group::default()
        };
        self.gyroscope.on = false;
        self.align();
    }

    /// Static alignment from the mean force and field: equation (81). Where it was not at rest, the
    /// covariance says so.
    pub(super) fn align(&mut self) {
        let one = R::from_f64(1.0);
        let group = core::mem::take(&mut self.group);
        let mean = scale(group.force, one / group.count);
        let length = norm(mean);
        if length <= one {
            return;
        }
        let spread = group.square / group.count - length * length;
        let spread = if spread > R::default() {
            spread
        } else {
            R::default()
        };
        let g = R::from_f64(self.config.gravity_mps2);
        let up = scale(mean, one / length);
        // The field's east, or body x, or body y where x is upright.
        let mut east = None;
        let mut yaw_sd = R::from_f64(1e-3);
        if group.fields > R::default() {
            let field = scale(group.field, one / group.fields);
            let level = cross(field, up);
            let size = norm(level);
            if size > R::from_f64(0.1) * norm(field) && size > R::default() {
                east = Some(level);
                let size = if size > one { size } else { one };
                yaw_sd = R::from_f64(DISTURBANCE_UT) / size;
            }
        }
        let body = |axis: usize| {
            let mut v = [R::default(); 3];
            v[axis] = one;
            sub(v, scale(up, up[axis]))
        };
        let east = east.unwrap_or_else(|| {
            let x = body(0);
            if norm(x) > R::from_f64(0.1) {
                x
            } else {
                body(1)
            }
        });
        let east = scale(east, one / norm(east));
        self.attitude = [east, cross(up, east), up];
        self.field = (group.fields > R::default())
            .then(|| times(&self.attitude, scale(group.field, one / group.fields)));
        let departure = (length - g) * (length - g);
        let bias = R::from_f64(self.config.bias_mps2 * self.config.bias_mps2);
        let still = self.quiet.is_steady(spread * R::from_f64(1.0 / 3.0));
        // What is pushed to and fro has a mean less than its spread; what is pushed once may not.
        let share = R::from_f64(if still { 0.25 } else { 1.0 });
        let tilt = ((spread + departure) * share + bias) / (g * g) + R::from_f64(1e-6);
        self.cov = Covariance::zero();
        for i in 0..3 {
            let small = R::from_f64(BIAS_RAD_S * BIAS_RAD_S);
            self.cov
                .add(PHI, i, if i == 2 { yaw_sd * yaw_sd } else { tilt });
            self.cov.add(OMEGA, i, small);
            self.cov.add(ACCELERATION, i, spread + small);
            self.cov.add(BIAS, i, bias);
            self.cov
                .add(FIELD, i, R::from_f64(DISTURBANCE_UT * DISTURBANCE_UT));
        }
        self.mean = [R::default(); STATES];
        if let Some(drift) = self.config.drift {
            for (i, sd) in drift.rise_sd_mps2.into_iter().enumerate() {
                self.cov.add(RISE, i, R::from_f64(sd * sd));
            }
        }
        self.manner
            .begin(spread * R::from_f64(1.0 / 3.0) + departure);
        let mut acceleration = times(&self.attitude, mean);
        acceleration[2] -= g;
        self.last_force = acceleration;
        self.since_rest_s = R::default();
        self.aligned = true;
        self.valid = still;
        self.begun = self.valid;
        self.moved = false;
        self.held = false;
        self.unseen = Unseen::default();
        if let Some(rate) = self.quiet.still()
            && self.config.zupt.is_on()
        {
            self.quiet.follow();
            self.gyroscope.bias = rate;
            self.gyroscope.bias2 = still.then(|| self.quiet.still_variance());
        }
        if !self.valid {
            // It moves, nobody knows how fast.
            for i in 0..3 {
                self.cov
                    .add(VELOCITY, i, R::from_f64(UNKNOWN_MPS * UNKNOWN_MPS));
            }
        }
    }

    /// Measures position from here: it is zero, exactly, and from here on its covariance is that of the
    /// way since.
    pub fn set_origin(&mut self) {
        self.put(POSITION, [R::default(); 3]);
        self.unseen.restart();
        self.turned.depart();
        for i in 0..3 {
            self.cov.know(POSITION.0 + i);
        }
    }

    /// Sets position (m), velocity (m/s) and heading to what is known exactly, from outside: the
    /// attitude is turned about the vertical so that body x points `heading_rad` from east to north.
    pub fn set_start(&mut self, position_m: [R; 3], velocity_mps: [R; 3], heading_rad: R) {
        let now = libm::atan2(self.attitude[1][0].to_f64(), self.attitude[0][0].to_f64());
        let nothing = R::default();
        if let Some(field) = self.field {
            // The field's direction is known no better than the heading was: what was not known of
            // that is a disturbance from here on, and still goes with the tilt.
            let mut m = skew(field);
            for row in &mut m {
                row[0] = nothing;
                row[1] = nothing;
            }
            self.cov.couple(FIELD, PHI, &m);
        }
        let by = turn([nothing, nothing, heading_rad - R::from_f64(now)]);
        self.attitude = product(&by, &self.attitude);
        self.field = self.field.map(|field| times(&by, field));
        self.last_force = times(&by, self.last_force);
        self.group.force = times(&by, self.group.force);
        self.group.field = times(&by, self.group.field);
        for block in [ACCELERATION, SWING, FIELD] {
            self.put(block, times(&by, self.part(block)));
        }
        for block in [PHI, ACCELERATION, SWING, FIELD] {
            self.cov.rotate(block, &by);
        }
        self.put(POSITION, position_m);
        self.put(VELOCITY, velocity_mps);
        self.cov.know(PHI.0 + 2);
        for i in 0..3 {
            self.cov.know(VELOCITY.0 + i);
            self.cov.know(POSITION.0 + i);
        }
        self.turned.head();
        self.turned.depart();
        self.unseen = Unseen::default();
        self.since_rest_s = nothing;
        self.valid = self.aligned;
        self.begun = self.aligned;
    }
}
