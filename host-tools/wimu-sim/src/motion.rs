//! Motions of a body: position and attitude as functions of time.

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::rc::Rc;

use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::attitude::{Attitude, angular_rate, norm};
use crate::random::Random;

/// Position and attitude against east-north-up with their derivatives, at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// m, from where the motion began.
    pub position_m: [f64; 3],
    /// m/s.
    pub velocity_mps: [f64; 3],
    /// m/s².
    pub acceleration_mps2: [f64; 3],
    /// Body axes against east-north-up.
    pub attitude: Attitude,
    /// Angular rate against east-north-up, rad/s, body axes.
    pub angular_rate_radps: [f64; 3],
}

impl Pose {
    /// At rest at the origin.
    pub fn resting(attitude: Attitude) -> Self {
        Self {
            position_m: [0.0; 3],
            velocity_mps: [0.0; 3],
            acceleration_mps2: [0.0; 3],
            attitude,
            angular_rate_radps: [0.0; 3],
        }
    }
}

/// A motion that begins and ends at rest. The sensor is at the body's origin: a rotation alone causes
/// no acceleration.
pub trait Motion: fmt::Debug {
    /// The pose at `t` seconds from the motion's start; before it and after
    /// [`duration`](Self::duration) the body rests where it began or ended.
    fn pose(&self, t: f64) -> Pose;

    /// How long it lasts, s, 0 or more.
    fn duration(&self) -> f64;
}

/// The names accepted by [`named`], with descriptions.
pub const NAMES: [(&str, &str); 8] = [
    ("rest", "level, for 10 s"),
    ("six-positions", "x, y, z up and down in turn, squared, 4 s each"),
    ("twelve-poses", "twelve spread poses, placed by hand, 4 s each"),
    ("tilts", "ten other poses, 4 s each"),
    ("slide", "1.000 m along body x in 3 s, 3 s of rest at both ends"),
    (
        "carry",
        "1.000 m in 3 s, rotated by 90° about a tilted axis meanwhile, 3 s of rest at both ends",
    ),
    ("hand", "waved about by hand for 10 s, up to 20 m/s²"),
    (
        "impact",
        "a run of 1.9 m at up to 2.5 m/s, stopped in 0.1 s at up to 50 m/s²; 3 s of rest at both ends",
    ),
];

/// The motion of a name in [`NAMES`], or several separated by commas. Random
/// motions depend on `seed`.
///
/// # Errors
/// [`UnknownMotion`] for any other name.
pub fn named(names: &str, seed: u64) -> Result<Rc<dyn Motion>, UnknownMotion> {
    let mut sequence = Sequence::default();
    for name in names.split(',').map(str::trim) {
        let motion: Rc<dyn Motion> = match name {
            "rest" => Rc::new(Rest::level(10.0)),
            "six-positions" => Rc::new(Poses::six_positions(4.0)),
            "twelve-poses" => Rc::new(Poses::twelve_by_hand(seed, 2.0, 4.0)),
            "tilts" => Rc::new(Poses::tilts(seed, 4.0)),
            "slide" => Rc::new(Slide::default()),
            "carry" => Rc::new(Slide::carry()),
            "hand" => Rc::new(Hand::new(seed, 10.0, 20.0)),
            "impact" => Rc::new(Impact::default()),
            _ => return Err(UnknownMotion(name.into())),
        };
        sequence.push_at(0.0, motion);
    }
    Ok(Rc::new(sequence))
}

/// An unknown name of a motion.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no motion `{0}`; known are {list}", list = NAMES.map(|(name, _)| name).join(", "))]
pub struct UnknownMotion(pub String);

/// Rest.
#[derive(Clone, Copy, Debug)]
pub struct Rest {
    /// Attitude of the body.
    pub attitude: Attitude,
    /// Duration, s.
    pub seconds: f64,
}

impl Rest {
    /// Level, for `seconds`.
    pub fn level(seconds: f64) -> Self {
        Self { attitude: Attitude::LEVEL, seconds }
    }
}

impl Motion for Rest {
    fn pose(&self, _t: f64) -> Pose {
        Pose::resting(self.attitude)
    }

    fn duration(&self) -> f64 {
        self.seconds
    }
}

/// A rotation on the spot, smooth at both ends: equation (32).
#[derive(Clone, Copy, Debug)]
struct Turn {
    from: Attitude,
    to: Attitude,
    seconds: f64,
}

impl Motion for Turn {
    fn pose(&self, t: f64) -> Pose {
        let [fraction, per_duration, _] = smooth_step(t / self.seconds);
        let rotation = self.from.rotation_vector_to(self.to);
        Pose {
            angular_rate_radps: rotation.map(|angle| angle * per_duration / self.seconds),
            ..Pose::resting(self.from.toward(self.to, fraction))
        }
    }

    fn duration(&self) -> f64 {
        self.seconds
    }
}

/// Motions in sequence: positions continue, and where attitudes differ the body rotates in
/// between.
#[derive(Clone, Debug, Default)]
pub struct Sequence {
    parts: Vec<Part>,
}

#[derive(Clone, Debug)]
struct Part {
    start_s: f64,
    origin_m: [f64; 3],
    motion: Rc<dyn Motion>,
}

/// Duration of such a rotation, s.
const TURN_SECONDS: f64 = 1.0;

impl Sequence {
    /// `motions` in sequence.
    pub fn new(motions: impl IntoIterator<Item = Rc<dyn Motion>>) -> Self {
        let mut sequence = Self::default();
        for motion in motions {
            sequence.push_at(0.0, motion);
        }
        sequence
    }

    /// Appends `motion`, to begin at `start_s` or at the end of the sequence if that is later,
    /// after a rotation of 1 s if its first attitude differs. Returns when it begins, s.
    pub fn push_at(&mut self, start_s: f64, motion: Rc<dyn Motion>) -> f64 {
        let mut start_s = start_s.max(self.duration());
        let mut origin_m = [0.0; 3];
        if !self.parts.is_empty() {
            let before = self.pose(start_s);
            let after = motion.pose(0.0);
            origin_m = before.position_m;
            if before.attitude.angle_to(after.attitude) > 1e-9 {
                self.parts.push(Part {
                    start_s,
                    origin_m,
                    motion: Rc::new(Turn {
                        from: before.attitude,
                        to: after.attitude,
                        seconds: TURN_SECONDS,
                    }),
                });
                start_s += TURN_SECONDS;
            }
        }
        self.parts.push(Part { start_s, origin_m, motion });
        start_s
    }
}

impl Motion for Sequence {
    fn pose(&self, t: f64) -> Pose {
        let begun = self.parts.partition_point(|part| part.start_s <= t);
        let Some(part) = self.parts.get(begun.saturating_sub(1)) else {
            return Pose::resting(Attitude::LEVEL);
        };
        let mut pose = part.motion.pose(t - part.start_s);
        for axis in 0..3 {
            pose.position_m[axis] += part.origin_m[axis];
        }
        pose
    }

    fn duration(&self) -> f64 {
        let last = self.parts.last();
        last.map_or(0.0, |part| part.start_s + part.motion.duration())
    }
}

/// Static poses in sequence.
#[derive(Clone, Debug)]
pub struct Poses {
    sequence: Sequence,
    holds: Vec<Hold>,
}

/// One static pose of [`Poses`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hold {
    /// Time from which the body is at rest in it, s from the motion's start.
    pub start_s: f64,
    /// Time at which the body leaves it, s from the motion's start.
    pub end_s: f64,
    /// Attitude of the body.
    pub attitude: Attitude,
}

impl Poses {
    /// `attitudes` in sequence, each held for `hold_s` seconds.
    pub fn new(attitudes: impl IntoIterator<Item = Attitude>, hold_s: f64) -> Self {
        let mut sequence = Sequence::default();
        let mut holds = Vec::new();
        for attitude in attitudes {
            let seconds = hold_s;
            let start_s = sequence.push_at(0.0, Rc::new(Rest { attitude, seconds }));
            let end_s = start_s + hold_s;
            holds.push(Hold { start_s, end_s, attitude });
        }
        Self { sequence, holds }
    }

    /// +x, −x, +y, −y, +z, −z up, exactly.
    pub fn six_positions(hold_s: f64) -> Self {
        let up = [0, 1, 2].into_iter().flat_map(|axis| {
            [1.0, -1.0].map(|sign| {
                let mut up = [0.0; 3];
                up[axis] = sign;
                up
            })
        });
        Self::new(up.map(Attitude::with_up), hold_s)
    }

    /// The twelve corners of an icosahedron up in sequence, each with placement errors of σ =
    /// `placement_sd_deg` about each body axis.
    pub fn twelve_by_hand(seed: u64, placement_sd_deg: f64, hold_s: f64) -> Self {
        let mut random = Random::new(seed, 1);
        let golden = (1.0 + libm::sqrt(5.0)) / 2.0;
        let attitudes = (0..12).map(|corner: usize| {
            // (0, ±1, ±φ) and its cyclic permutations.
            let sign = |bit: usize| if corner >> bit & 1 == 0 { 1.0 } else { -1.0 };
            let mut up = [0.0, sign(0), golden * sign(1)];
            up.rotate_right(corner / 4);
            let slip = [(); 3].map(|()| random.gaussian() * placement_sd_deg.to_radians());
            Attitude::with_up(up).turned(Attitude::from_rotation_vector(slip))
        });
        Self::new(attitudes, hold_s)
    }

    /// Ten poses evenly spread over the sphere, in a random rotation.
    pub fn tilts(seed: u64, hold_s: f64) -> Self {
        let mut random = Random::new(seed, 2);
        let turn = [(); 3].map(|()| random.uniform(-PI, PI));
        let turn = Attitude::from_rotation_vector(turn);
        let up = sphere(10).into_iter().map(|up| turn.to_enu(up));
        Self::new(up.map(Attitude::with_up), hold_s)
    }

    /// The poses with their times.
    pub fn holds(&self) -> &[Hold] {
        &self.holds
    }
}

impl Motion for Poses {
    fn pose(&self, t: f64) -> Pose {
        self.sequence.pose(t)
    }

    fn duration(&self) -> f64 {
        self.sequence.duration()
    }
}

/// `count` unit vectors spread evenly over the sphere (Fibonacci spiral).
pub fn sphere(count: usize) -> Vec<[f64; 3]> {
    let golden_angle = PI * (3.0 - libm::sqrt(5.0));
    let point = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f64 / count as f64;
        let radius = libm::sqrt(1.0 - z * z);
        let angle = golden_angle * i as f64;
        [radius * libm::cos(angle), radius * libm::sin(angle), z]
    };
    (0..count).map(point).collect()
}

/// A minimum-jerk straight move along the first direction of body x, between two rests: equation (31).
#[derive(Clone, Copy, Debug)]
pub struct Slide {
    /// Distance, m; negative is backward.
    pub distance_m: f64,
    /// Duration of the move, s, more than 0.
    pub move_s: f64,
    /// Rest before it, s.
    pub rest_before_s: f64,
    /// Rest after it, s.
    pub rest_after_s: f64,
    /// Attitude of the body before the move.
    pub attitude: Attitude,
    /// Rotation vector of the body during the move, rad, body axes.
    pub rotation_rad: [f64; 3],
}

impl Slide {
    /// The default slide, while the body rotates by 90° about an axis 53° from the vertical.
    pub fn carry() -> Self {
        Self { rotation_rad: [0.64, -0.48, 0.6].map(|axis| axis * PI / 2.0), ..Self::default() }
    }
}

impl Default for Slide {
    /// 1.000 m in 3 s, level, to the east, without a rotation, 3 s of rest at both ends.
    fn default() -> Self {
        Self {
            distance_m: 1.0,
            move_s: 3.0,
            rest_before_s: 3.0,
            rest_after_s: 3.0,
            attitude: Attitude::LEVEL,
            rotation_rad: [0.0; 3],
        }
    }
}

impl Motion for Slide {
    fn pose(&self, t: f64) -> Pose {
        let [s, rate, acceleration] = smooth_step((t - self.rest_before_s) / self.move_s);
        let along = |x: f64| self.attitude.to_enu([x * self.distance_m, 0.0, 0.0]);
        Pose {
            position_m: along(s),
            velocity_mps: along(rate / self.move_s),
            acceleration_mps2: along(acceleration / (self.move_s * self.move_s)),
            attitude: match self.rotation_rad {
                [0.0, 0.0, 0.0] => self.attitude,
                rotation => {
                    let rotated = Attitude::from_rotation_vector(rotation.map(|angle| angle * s));
                    self.attitude.turned(rotated)
                }
            },
            angular_rate_radps: self.rotation_rad.map(|angle| angle * rate / self.move_s),
        }
    }

    fn duration(&self) -> f64 {
        self.rest_before_s + self.move_s + self.rest_after_s
    }
}

/// A run that an impact stops: smooth up to a speed, a half-sine pulse of acceleration against it, a rebound, and rests at
/// both ends. Level, without rotation: equation (225).
#[derive(Clone, Copy, Debug)]
pub struct Impact {
    /// Speed before the impact, m/s.
    pub speed_mps: f64,
    /// Largest acceleration of the pulse, m/s².
    pub peak_mps2: f64,
    /// Duration of the pulse, s, more than 0.
    pub pulse_s: f64,
    /// Direction of the run, a unit vector.
    pub direction: [f64; 3],
}

impl Impact {
    /// Rest at each end, run-up, and the end of the rebound, s.
    const REST_S: f64 = 3.0;
    const RUN_UP_S: f64 = 1.5;
    const SLOW_DOWN_S: f64 = 1.0;

    /// Beginning of the pulse, s from the motion's start.
    pub fn begin_s(&self) -> f64 {
        Self::REST_S + Self::RUN_UP_S
    }

    /// Distance, speed and acceleration along the direction.
    fn along(&self, t: f64) -> [f64; 3] {
        // Of a speed that rises from 0 to 1 between τ = 0 and 1.
        let rise = |tau: f64| {
            let t = tau.clamp(0.0, 1.0);
            let distance = t * t * t * t * (2.5 + t * (t - 3.0)) + (tau - 1.0).max(0.0);
            let [speed, acceleration, _] = smooth_step(tau);
            [distance, speed, acceleration]
        };
        let run_up = (t - Self::REST_S).min(Self::RUN_UP_S) / Self::RUN_UP_S;
        let [x, v, a] = rise(run_up);
        let (speed, pulse) = (self.speed_mps, self.pulse_s);
        let mut moved = [speed * Self::RUN_UP_S * x, speed * v, speed / Self::RUN_UP_S * a];
        let since = t - self.begin_s();
        if since <= 0.0 {
            return moved;
        }
        let within = since.min(pulse);
        let (sin, cos) = libm::sincos(PI * within / pulse);
        let change = self.peak_mps2 * pulse / PI;
        moved[0] += speed * within - change * (within - pulse / PI * sin);
        moved[1] = speed - change * (1.0 - cos);
        moved[2] = -self.peak_mps2 * sin;
        let after = (since - pulse).min(Self::SLOW_DOWN_S);
        if after > 0.0 {
            let [x, v, a] = rise(after / Self::SLOW_DOWN_S);
            let rebound = speed - 2.0 * change;
            moved[0] += rebound * (after - Self::SLOW_DOWN_S * x);
            moved[1] = rebound * (1.0 - v);
            moved[2] = -rebound / Self::SLOW_DOWN_S * a;
        }
        moved
    }
}

impl Default for Impact {
    /// At 2.5 m/s along body x, with some y, stopped within 0.1 s at up to 50 m/s².
    fn default() -> Self {
        Self { speed_mps: 2.5, peak_mps2: 50.0, pulse_s: 0.1, direction: [0.8, -0.6, 0.0] }
    }
}

impl Motion for Impact {
    fn pose(&self, t: f64) -> Pose {
        let [x, v, a] = self.along(t);
        let along = |size: f64| self.direction.map(|axis| axis * size);
        Pose {
            position_m: along(x),
            velocity_mps: along(v),
            acceleration_mps2: along(a),
            ..Pose::resting(Attitude::LEVEL)
        }
    }

    fn duration(&self) -> f64 {
        self.begin_s() + self.pulse_s + Self::SLOW_DOWN_S + Self::REST_S
    }
}

/// Hand motion: translation and rotation of random tones within 0.3 to 2.5 Hz, with a smooth
/// begin and end at rest: equation (33).
#[derive(Clone, Debug)]
pub struct Hand {
    seconds: f64,
    translation: [Tones; 3],
    rotation: [Tones; 3],
}

impl Hand {
    /// For `seconds` (more than 0), with specific force up to `peak_mps2`, more than gravity's
    /// 9.80665 m/s².
    pub fn new(seed: u64, seconds: f64, peak_mps2: f64) -> Self {
        let mut random = Random::new(seed, 3);
        let mut hand = Self {
            seconds,
            translation: [(); 3].map(|()| Tones::random(&mut random, 0.5, 2.5, 0.05)),
            rotation: [(); 3].map(|()| Tones::random(&mut random, 0.3, 1.2, 0.3)),
        };
        let times: Vec<f64> = (0..(seconds * 200.0) as usize).map(|i| i as f64 / 200.0).collect();
        let accelerations: Vec<_> = times.iter().map(|&t| hand.pose(t).acceleration_mps2).collect();
        let peak = |gain: f64| {
            accelerations.iter().fold(0.0_f64, |peak, a| {
                let up = gain * a[2] + STANDARD_GRAVITY_MPS2;
                peak.max(norm([gain * a[0], gain * a[1], up]))
            })
        };
        // The peak is convex in the gain and starts at gravity: one gain fits, by bisection.
        let (mut low, mut high) = (0.0, 1000.0);
        for _ in 0..60 {
            let middle = (low + high) / 2.0;
            if peak(middle) < peak_mps2 {
                low = middle;
            } else {
                high = middle;
            }
        }
        for tones in &mut hand.translation {
            tones.scale(low);
        }
        hand
    }
}

impl Motion for Hand {
    fn pose(&self, t: f64) -> Pose {
        let t = t.clamp(0.0, self.seconds);
        let swell = self.seconds.min(4.0) / 4.0;
        let rising = t < self.seconds / 2.0;
        let edge = if rising { t } else { self.seconds - t };
        let [w, w1, w2] = smooth_step(edge / swell);
        let w1 = if rising { w1 } else { -w1 } / swell;
        let w2 = w2 / (swell * swell);

        // The product rule, per axis.
        let translation = self.translation.each_ref().map(|tones| {
            let [s, s1, s2] = tones.at(t);
            [w * s, w * s1 + w1 * s, w * s2 + 2.0 * w1 * s1 + w2 * s]
        });
        let derivative = |order: usize| translation.map(|axis| axis[order]);
        let rotation = self.rotation.each_ref().map(|tones| {
            let [s, s1, _] = tones.at(t);
            [w * s, w * s1 + w1 * s]
        });
        let [angles, rates] = [0, 1].map(|order| rotation.map(|axis| axis[order]));
        Pose {
            position_m: derivative(0),
            velocity_mps: derivative(1),
            acceleration_mps2: derivative(2),
            attitude: Attitude::from_rotation_vector(angles),
            angular_rate_radps: angular_rate(angles, rates),
        }
    }

    fn duration(&self) -> f64 {
        self.seconds
    }
}

/// A sum of sines.
#[derive(Clone, Debug)]
struct Tones([Tone; 5]);

#[derive(Clone, Copy, Debug)]
struct Tone {
    amplitude: f64,
    rad_per_s: f64,
    phase: f64,
}

impl Tones {
    fn random(random: &mut Random, low_hz: f64, high_hz: f64, amplitude: f64) -> Self {
        Self([(); 5].map(|()| {
            let hz = random.uniform(low_hz, high_hz);
            Tone {
                // Slow motions have larger amplitudes.
                amplitude: amplitude * low_hz / hz * random.uniform(0.5, 1.0),
                rad_per_s: TAU * hz,
                phase: random.uniform(0.0, TAU),
            }
        }))
    }

    fn scale(&mut self, gain: f64) {
        for tone in &mut self.0 {
            tone.amplitude *= gain;
        }
    }

    /// The sum and its first two derivatives.
    fn at(&self, t: f64) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for tone in &self.0 {
            let (omega, angle) = (tone.rad_per_s, tone.rad_per_s * t + tone.phase);
            let (sin, cos) = libm::sincos(angle);
            sum[0] += tone.amplitude * sin;
            sum[1] += tone.amplitude * omega * cos;
            sum[2] -= tone.amplitude * omega * omega * sin;
        }
        sum
    }
}

/// 10 τ³ − 15 τ⁴ + 6 τ⁵, from 0 at τ ≤ 0 to 1 at τ ≥ 1, and its first two derivatives in τ, which
/// are 0 at both ends: the path of least jerk, equation (31).
pub(crate) fn smooth_step(tau: f64) -> [f64; 3] {
    let t = tau.clamp(0.0, 1.0);
    let rest = 1.0 - t;
    [
        t * t * t * (10.0 + t * (-15.0 + 6.0 * t)),
        30.0 * t * t * rest * rest,
        60.0 * t * rest * (1.0 - 2.0 * t),
    ]
}
