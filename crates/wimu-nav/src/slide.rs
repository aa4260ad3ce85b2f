//! A straight move between two rests, from an accelerometer alone: equations (86) and (87).

/// What is known at a rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rest {
    /// Mean specific force, m/s², body axes: gravity and bias together.
    pub force_mps2: [f64; 3],
    /// Standard deviation of that mean, m/s² an axis.
    pub sd_mps2: f64,
}

/// What a move is like, beyond what its samples show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlideConfig {
    /// How far the unit tilts to and fro during a move, rad.
    pub wobble_rad: f64,
    /// For how long such a tilt lasts, s.
    pub wobble_s: f64,
    /// Relative error of the accelerometer's scale.
    pub scale_sd: f64,
    /// Local gravity, m/s².
    pub gravity_mps2: f64,
}

impl Default for SlideConfig {
    fn default() -> Self {
        Self {
            wobble_rad: 0.005,
            wobble_s: 0.1,
            scale_sd: 0.003,
            gravity_mps2: 9.80665,
        }
    }
}

/// A move that is over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// From its start to its end, m, body axes at the start.
    pub displacement_m: [f64; 3],
    /// Its length, m.
    pub length_m: f64,
    /// Standard deviation of the length, m.
    pub length_sd_m: f64,
    /// How long it took, s.
    pub duration_s: f64,
    /// Velocity that was left at the end, m/s: error, that the correction took out.
    pub left_mps: [f64; 3],
    /// Angle between gravity before and after, rad: where it is not small the path between is that
    /// of another body.
    pub turned_rad: f64,
}

/// Integrates a move as it happens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slide {
    config: SlideConfig,
    before: Rest,
    last: [f64; 3],
    velocity: [f64; 3],
    position: [f64; 3],
    time_s: f64,
}

/// Degrees of freedom that what is known beforehand counts for.
const PRIOR_DEGREES: f64 = 1.0;

impl Slide {
    /// Begins at the end of a rest.
    pub fn new(config: SlideConfig, before: Rest) -> Self {
        Self {
            config,
            before,
            last: [0.0; 3],
            velocity: [0.0; 3],
            position: [0.0; 3],
            time_s: 0.0,
        }
    }

    /// Takes one sample, m/s², body axes, `step_s` after the one before. Samples that are not finite
    /// or go back in time are left out, and false is said.
    pub fn push(&mut self, step_s: f64, force_mps2: [f64; 3]) -> bool {
        if !(step_s >= 0.0 && step_s.is_finite() && force_mps2.iter().all(|f| f.is_finite())) {
            return false;
        }
        for axis in 0..3 {
            let acceleration = force_mps2[axis] - self.before.force_mps2[axis];
            let velocity = self.velocity[axis] + 0.5 * (self.last[axis] + acceleration) * step_s;
            self.position[axis] += 0.5 * (self.velocity[axis] + velocity) * step_s;
            self.velocity[axis] = velocity;
            self.last[axis] = acceleration;
        }
        self.time_s += step_s;
        true
    }

    /// How long the move has lasted, s.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Position (m) and velocity (m/s), body axes at the start, as they were here, corrected backwards
    /// by what is known now that the move is `done`. `change_mps2` is the rest's force after less
    /// before.
    pub fn corrected(&self, done: &Move, change_mps2: [f64; 3]) -> ([f64; 3], [f64; 3]) {
        let (t, whole) = (self.time_s, done.duration_s.max(1e-9));
        let position = core::array::from_fn(|i| {
            self.position[i]
                - change_mps2[i] * t * t * t / (6.0 * whole)
                - 0.5 * done.left_mps[i] * t * t / whole
        });
        let velocity = core::array::from_fn(|i| {
            self.velocity[i] - 0.5 * change_mps2[i] * t * t / whole - done.left_mps[i] * t / whole
        });
        (position, velocity)
    }

    /// Ends the move at a rest.
    pub fn finish(&self, after: Rest) -> Move {
        let t = self.time_s;
        let mut displacement = [0.0; 3];
        let mut left = [0.0; 3];
        for axis in 0..3 {
            // Gravity and bias change evenly from rest to rest, then the velocity's error does.
            let change = after.force_mps2[axis] - self.before.force_mps2[axis];
            left[axis] = self.velocity[axis] - 0.5 * change * t;
            displacement[axis] = self.position[axis] - change * t * t / 6.0 - 0.5 * left[axis] * t;
        }
        let square = |v: [f64; 3]| v.iter().map(|c| c * c).sum::<f64>();
        let length = libm::sqrt(square(displacement));
        // White acceleration error of density q along the move: what was left shows it (one degree of
        // freedom: errors of a move are mostly along it), with what was known.
        let config = &self.config;
        let tilt = config.wobble_rad * config.gravity_mps2;
        let known = tilt * tilt * config.wobble_s
            + (self.before.sd_mps2 * self.before.sd_mps2 + after.sd_mps2 * after.sd_mps2) * t;
        let shown = if t > 0.0 { square(left) / t } else { 0.0 };
        let density = (PRIOR_DEGREES * known + shown) / (PRIOR_DEGREES + 1.0);
        let scale = config.scale_sd * length;
        let variance = density * t * t * t / 12.0 + scale * scale;
        let dot: f64 = (0..3)
            .map(|i| self.before.force_mps2[i] * after.force_mps2[i])
            .sum();
        let norms = libm::sqrt(square(self.before.force_mps2) * square(after.force_mps2));
        let turned = if norms > 0.0 {
            libm::acos((dot / norms).clamp(-1.0, 1.0))
        } else {
            0.0
        };
        Move {
            displacement_m: displacement,
            length_m: length,
            length_sd_m: libm::sqrt(variance),
            duration_s: t,
            left_mps: left,
            turned_rad: turned,
        }
    }
}
