//! A straight move between two rests, or any between two rests where there is an angular rate:
//! equations (86) and (87).

use crate::Real;
use crate::vector::{
    Matrix, Vector, add, cross, diagonal, dot, norm, product, scale, sub, times, turn, zero,
};

/// What is known at a rest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rest<R = f64> {
    /// Mean specific force, m/s², body axes: gravity and bias together.
    pub force_mps2: [R; 3],
    /// Standard deviation of that mean, m/s² an axis.
    pub sd_mps2: R,
    /// Mean angular rate, rad/s, body axes, where there is one: its bias.
    pub rate_rad_s: Option<[R; 3]>,
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
    /// Bias of the accelerometer, m/s²: it turns with the unit.
    pub bias_mps2: f64,
    /// Local gravity, m/s².
    pub gravity_mps2: f64,
}

impl Default for SlideConfig {
    fn default() -> Self {
        Self {
            wobble_rad: 0.005,
            wobble_s: 0.1,
            scale_sd: 0.003,
            bias_mps2: 0.05,
            gravity_mps2: 9.80665,
        }
    }
}

/// A move that is over.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Move<R = f64> {
    /// From its start to its end, m, body axes at the start.
    pub displacement_m: [R; 3],
    /// Its length, m.
    pub length_m: R,
    /// Standard deviation of the length, m.
    pub length_sd_m: R,
    /// How long it took, s.
    pub duration_s: R,
    /// Velocity that was left at the end, m/s: error, that the correction took out.
    pub left_mps: [R; 3],
    /// What the velocity left could have been, m/s an axis, one standard deviation: a move that leaves
    /// many times more did not end at rest.
    pub left_sd_mps: R,
    /// Gravity after less before, m/s², axes at the start: what the correction spreads evenly.
    pub change_mps2: [R; 3],
    /// Variance that the velocity's error of each axis grows to without a rest at the end, (m/s)².
    pub variance: [R; 3],
    /// How far the unit turned: without an angular rate the angle between gravity before and after,
    /// rad; the path between is that of another body where it is not small.
    pub turned_rad: R,
    /// Angle that gravity before and after leaves unexplained, rad.
    pub open_rad: R,
    doubt: Doubt<R>,
    way: Way<R>,
    scale_sd: f64,
}

impl<R: Real> Move<R> {
    /// Covariance of the way from one state of the move to a later one, m², axes at the start, where the
    /// way was `displacement_m`.
    pub fn covariance(
        &self,
        from: &Slide<R>,
        to: &Slide<R>,
        displacement_m: [R; 3],
    ) -> [[R; 3]; 3] {
        self.spread(
            bridge(from.doubt, to.doubt, to.time_s, self.doubt),
            displacement_m,
        )
    }

    /// That of the whole move.
    pub fn covariance_at_end(&self) -> [[R; 3]; 3] {
        let start = Doubt::default();
        let part = bridge(start, self.doubt, self.duration_s, self.doubt);
        self.spread(part, self.displacement_m)
    }

    fn spread(&self, part: R, displacement_m: [R; 3]) -> [[R; 3]; 3] {
        let scaling = R::from_f64(self.scale_sd * self.scale_sd);
        core::array::from_fn(|i| {
            core::array::from_fn(|j| {
                let own = if i == j {
                    self.variance[i] * part
                } else {
                    R::default()
                };
                own + scaling * displacement_m[i] * displacement_m[j]
            })
        })
    }

    /// The same move where it may have ended `apart_m` from here, with variance `share` of that squared:
    /// another reading of the same samples.
    #[must_use]
    pub fn doubted(mut self, apart_m: [R; 3], share: R) -> Self {
        let part = bridge(Doubt::default(), self.doubt, self.duration_s, self.doubt);
        if part > R::default() {
            for (variance, apart) in self.variance.iter_mut().zip(apart_m) {
                *variance += share * apart * apart / part;
            }
            self.length_sd_m = self.sd_of_length();
        }
        self
    }

    fn sd_of_length(&self) -> R {
        let p = self.covariance_at_end();
        let variance = if self.length_m > R::default() {
            let along = scale(self.displacement_m, R::from_f64(1.0) / self.length_m);
            dot(along, times(&p, along))
        } else {
            (p[0][0] + p[1][1] + p[2][2]) * R::from_f64(1.0 / 3.0)
        };
        variance.sqrt()
    }
}

/// How the velocity's variance grows: Q, and ∫ Q dt and ∫ t Q dt.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Doubt<R> {
    now: R,
    area: R,
    moment: R,
}

/// Variance of the integral between two times of a velocity whose variance grows as Q and is zero at the
/// `whole`'s end, in units of Q there.
fn bridge<R: Real>(a: Doubt<R>, b: Doubt<R>, b_s: R, whole: Doubt<R>) -> R {
    if whole.now <= R::default() {
        return R::default();
    }
    let (area, moment) = (b.area - a.area, b.moment - a.moment);
    let value = (R::from_f64(2.0) * (b_s * area - moment) - area * area / whole.now) / whole.now;
    if value > R::default() {
        value
    } else {
        R::default()
    }
}

/// Integrates a move as it happens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slide<R = f64> {
    config: SlideConfig,
    before: Rest<R>,
    /// Body axes now to those at the start.
    attitude: Matrix<R>,
    turned: R,
    last: Option<Vector<R>>,
    last_rate: Option<Vector<R>>,
    velocity: Vector<R>,
    position: Vector<R>,
    /// The scatter's share of the velocity's variance, (m/s)².
    rough: R,
    /// Bias times how far the unit is turned, integrated, m/s.
    biased: R,
    doubt: Doubt<R>,
    way: Way<R>,
    time_s: R,
}

/// What gravity's change is spread over, and its first and second integral: the angle turned, and a little
/// of the time; and the integral of its rate's square, which says how long the turning took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Way<R> {
    now: R,
    first: R,
    second: R,
    square: R,
}

/// A unit that is taken not to turn drifts by this, rad/s.
const CREEP_RAD_S: f64 = 0.01;
/// Degrees of freedom that what is known beforehand counts for.
const PRIOR_DEGREES: f64 = 1.0;

impl<R: Real> Slide<R> {
    /// Begins at the end of a rest.
    pub fn new(config: SlideConfig, before: Rest<R>) -> Self {
        Self {
            config,
            before,
            attitude: diagonal(R::from_f64(1.0)),
            turned: R::default(),
            last: None,
            last_rate: None,
            velocity: zero(),
            position: zero(),
            rough: R::default(),
            biased: R::default(),
            doubt: Doubt::default(),
            way: Way::default(),
            time_s: R::default(),
        }
    }

    /// Takes one sample, m/s² and where there is one rad/s, body axes, `step_s` after the one before; both
    /// as they are at its time.
    /// Samples that are not finite or go back in time are left out, and false is said.
    pub fn push(&mut self, step_s: R, force_mps2: [R; 3], rate_rad_s: Option<[R; 3]>) -> bool {
        let most = R::from_f64(1e6);
        let values = force_mps2.iter().chain(rate_rad_s.iter().flatten());
        if !(step_s >= R::default() && step_s < most && values.clone().all(|v| v.abs() < most)) {
            return false;
        }
        let half = R::from_f64(0.5);
        let mut way = self.way;
        way.now += R::from_f64(CREEP_RAD_S) * step_s;
        if let (Some(rate), Some(bias)) = (rate_rad_s, self.before.rate_rad_s) {
            // A rate is that at its time stamp: between two it changes evenly.
            let last = sub(self.last_rate.unwrap_or(bias), bias);
            let now = sub(rate, bias);
            let by = scale(add(last, now), half * step_s);
            let cone = scale(cross(last, now), step_s * step_s * R::from_f64(1.0 / 12.0));
            self.turned += norm(by);
            way.now += norm(by);
            self.attitude = product(&self.attitude, &turn(add(by, cone)));
        }
        if step_s > R::default() {
            let gone = way.now - self.way.now;
            way.square += gone * gone / step_s;
        }
        let first = (way.now + self.way.now) * half * step_s;
        way.second += (self.way.first + first * half) * step_s;
        way.first += first;
        self.way = way;
        let acceleration = sub(times(&self.attitude, force_mps2), self.before.force_mps2);
        let last = self.last.unwrap_or_default();
        let gained = scale(add(last, acceleration), half * step_s);
        let way = scale(add(self.velocity, scale(gained, half)), step_s);
        self.position = add(self.position, way);
        self.velocity = add(self.velocity, gained);
        if self.last.is_some() {
            let jump = sub(acceleration, last);
            self.rough += dot(jump, jump) * R::from_f64(1.0 / 6.0) * step_s * step_s;
        }
        self.last = Some(acceleration);
        self.last_rate = rate_rad_s;
        self.time_s += step_s;
        self.grow(step_s);
        true
    }

    /// Variance of the velocity by now: a tilt to and fro, the rest's own error, scatter, and a bias that
    /// turned with the unit.
    fn grow(&mut self, step_s: R) {
        let square = |v: R| v * v;
        let one = diagonal(R::from_f64(1.0));
        let mut apart = R::default();
        for i in 0..3 {
            let row = sub(self.attitude[i], one[i]);
            apart += dot(row, row);
        }
        let apart = (apart * R::from_f64(0.5)).sqrt();
        self.biased += R::from_f64(self.config.bias_mps2) * apart * step_s;
        let tilt = square(R::from_f64(
            self.config.wobble_rad * self.config.gravity_mps2,
        )) * R::from_f64(self.config.wobble_s);
        let t = self.time_s;
        let before = self.doubt.now;
        self.doubt.now =
            (tilt + square(self.before.sd_mps2) * t) * t + self.rough + square(self.biased);
        let half = R::from_f64(0.5);
        let area = (before + self.doubt.now) * half * step_s;
        self.doubt.area += area;
        self.doubt.moment += area * (t - step_s * half);
    }

    /// How long the move has lasted, s.
    pub fn time_s(&self) -> R {
        self.time_s
    }

    /// Velocity as it was integrated, m/s, axes at the start.
    pub fn velocity_mps(&self) -> [R; 3] {
        self.velocity
    }

    /// Body axes now to those at the start, rows.
    pub fn attitude(&self) -> [[R; 3]; 3] {
        self.attitude
    }

    /// Position (m) and velocity (m/s), body axes at the start, as they were here, corrected backwards
    /// by what is known now that the move is `done`.
    pub fn corrected(&self, done: &Move<R>) -> ([R; 3], [R; 3]) {
        let ratio = |a: R, b: R| {
            if b > R::default() {
                a / b
            } else {
                R::default()
            }
        };
        let change = ratio(R::from_f64(1.0), done.way.now);
        let left = ratio(R::from_f64(1.0), done.doubt.now);
        let position = core::array::from_fn(|i| {
            self.position[i]
                - done.change_mps2[i] * self.way.second * change
                - done.left_mps[i] * self.doubt.area * left
        });
        let velocity = core::array::from_fn(|i| {
            self.velocity[i]
                - done.change_mps2[i] * self.way.first * change
                - done.left_mps[i] * self.doubt.now * left
        });
        (position, velocity)
    }

    /// Ends the move at a rest.
    pub fn finish(&self, after: Rest<R>) -> Move<R> {
        let t = self.time_s;
        let ended = times(&self.attitude, after.force_mps2);
        // Gravity's change is spread over the angle turned, what is then left of the velocity over its
        // variance.
        let change_mps2 = sub(ended, self.before.force_mps2);
        let spread = if self.way.now > R::default() {
            self.way.first / self.way.now
        } else {
            R::default()
        };
        let left_mps = sub(self.velocity, scale(change_mps2, spread));
        let open_rad = angle(self.before.force_mps2, ended);
        let rated = self.before.rate_rad_s.is_some() && after.rate_rad_s.is_some();
        // Beyond what grew on the way: the rest at the end, and what of gravity's change was not spread so.
        let config = &self.config;
        let turning_s = if self.way.square > R::default() {
            self.way.now * self.way.now / self.way.square
        } else {
            R::default()
        };
        let uneven = dot(change_mps2, change_mps2) * turning_s * turning_s;
        let known = self.doubt.now
            + after.sd_mps2 * after.sd_mps2 * t * t
            + uneven * R::from_f64(1.0 / 36.0);
        // What was left shows it, too: one degree of freedom an axis.
        let prior = R::from_f64(PRIOR_DEGREES);
        let all = R::from_f64(PRIOR_DEGREES + 1.0);
        let variance = left_mps.map(|left| (prior * known + left * left) / all);
        let mut done = Move {
            displacement_m: zero(),
            length_m: R::default(),
            length_sd_m: R::default(),
            duration_s: t,
            left_mps,
            left_sd_mps: known.sqrt(),
            change_mps2,
            variance,
            turned_rad: if rated { self.turned } else { open_rad },
            open_rad,
            doubt: self.doubt,
            way: self.way,
            scale_sd: config.scale_sd,
        };
        done.displacement_m = self.corrected(&done).0;
        done.length_m = norm(done.displacement_m);
        done.length_sd_m = done.sd_of_length();
        done
    }
}

fn angle<R: Real>(a: Vector<R>, b: Vector<R>) -> R {
    let sine = norm(cross(a, b)).to_f64();
    R::from_f64(libm::atan2(sine, dot(a, b).to_f64()))
}
