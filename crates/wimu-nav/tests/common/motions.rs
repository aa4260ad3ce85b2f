//! Simulated motions of one unit, with their truth.

use super::{Random, cross};
use wimu_nav::unit::{UnitConfig, UnitFilter, UnitSample, Zupt};
use wimu_testkit::Coverage;

pub const G: f64 = 9.80665;
const FIELD: [f64; 3] = [0.0, 20.0, -44.0];
/// At rest before the motion begins, s.
const REST_S: f64 = 3.0;

/// What the body does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Carried about by hand: tones of 0.4 to 1 Hz, turning with them.
    Hand,
    /// A person walks: steps at 1.6 to 2 Hz, with a start and a mean speed.
    Walk,
    /// Moves of 0.4 m with rests between them, on a table.
    Slides,
    /// Moves at even speed with short ramps, a motor's vibration, slow turns.
    Robot,
    /// As by hand, with 5 m/s² at 40 Hz.
    Vibration,
}

pub const KINDS: [Kind; 5] = [
    Kind::Hand,
    Kind::Walk,
    Kind::Slides,
    Kind::Robot,
    Kind::Vibration,
];

struct Tone {
    size: f64,
    omega: f64,
    phase: f64,
}

impl Tone {
    fn at(&self, t: f64) -> f64 {
        self.size * (self.omega * t + self.phase).sin()
    }
}

/// One body's motion: place and attitude at any time.
pub struct Motion {
    kind: Kind,
    place: [Vec<Tone>; 3],
    turn: [Vec<Tone>; 3],
    /// Start, duration and way of each move.
    moves: Vec<(f64, f64, [f64; 3])>,
    /// Start, duration and angle about an axis.
    turns: Vec<(f64, f64, [f64; 3])>,
}

/// From 0 to 1 with bounded jerk.
fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
}

/// From 0 to 1 with even speed, ramps over a share of the time at each end.
fn ramped(x: f64, share: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    let speed = 1.0 / (1.0 - share);
    // The ramp's integral is that of a smooth step.
    let ramp = |x: f64| {
        let y = (x / share).clamp(0.0, 1.0);
        speed * share * y.powi(4) * (2.5 - 3.0 * y + y * y) + speed * (x - share).max(0.0)
    };
    if x < 0.5 {
        ramp(x)
    } else {
        1.0 - ramp(1.0 - x)
    }
}

impl Motion {
    pub fn new(kind: Kind, random: &mut Random) -> Self {
        let tau = std::f64::consts::TAU;
        let none = || [Vec::new(), Vec::new(), Vec::new()];
        let mut motion = Self {
            kind,
            place: none(),
            turn: none(),
            moves: Vec::new(),
            turns: Vec::new(),
        };
        match kind {
            Kind::Hand | Kind::Vibration => {
                for axis in 0..3 {
                    for _ in 0..3 {
                        let size = 0.06 * random.normal();
                        let hertz = 0.4 + 0.6 * random.uniform();
                        let phase = tau * random.uniform();
                        motion.place[axis].push(Tone {
                            size,
                            omega: tau * hertz,
                            phase,
                        });
                        let size = 0.04 * random.normal();
                        let hertz = 0.2 + 0.8 * random.uniform();
                        let phase = tau * random.uniform();
                        motion.turn[axis].push(Tone {
                            size,
                            omega: tau * hertz,
                            phase,
                        });
                    }
                    if kind == Kind::Vibration {
                        let omega = tau * (38.0 + 4.0 * random.uniform());
                        let phase = tau * random.uniform();
                        motion.place[axis].push(Tone {
                            size: 5.0 / (omega * omega),
                            omega,
                            phase,
                        });
                    }
                }
            }
            Kind::Walk => {
                let step = 1.6 + 0.4 * random.uniform();
                let direction = tau * random.uniform();
                let speed = 1.0 + 0.6 * random.uniform();
                let along = [direction.cos(), direction.sin()];
                motion.moves.push((
                    REST_S,
                    40.0,
                    [along[0] * speed * 39.0, along[1] * speed * 39.0, 0.0],
                ));
                let mut tone = |size: f64, hertz: f64| Tone {
                    size: size * (0.7 + 0.6 * random.uniform()),
                    omega: tau * hertz,
                    phase: tau * random.uniform(),
                };
                motion.place[2].push(tone(0.02, step));
                motion.place[2].push(tone(0.003, 2.0 * step));
                let (surge, sway) = (tone(0.012, step), tone(0.02, 0.5 * step));
                for axis in 0..2 {
                    let across = [-along[1], along[0]][axis];
                    motion.place[axis].push(Tone {
                        size: surge.size * along[axis],
                        ..surge
                    });
                    motion.place[axis].push(Tone {
                        size: sway.size * across,
                        ..sway
                    });
                }
                motion.turn[0].push(tone(0.04, 0.5 * step));
                motion.turn[1].push(tone(0.04, step));
                motion.turn[2].push(tone(0.06, 0.5 * step));
                motion.turn[0].push(tone(0.02, 0.2));
                motion.turn[1].push(tone(0.02, 0.15));
            }
            Kind::Slides => {
                let mut start = REST_S;
                while start < 40.0 {
                    let way = 0.3 + 0.2 * random.uniform();
                    let direction = tau * random.uniform();
                    let duration = 0.8 + 0.4 * random.uniform();
                    motion.moves.push((
                        start,
                        duration,
                        [way * direction.cos(), way * direction.sin(), 0.0],
                    ));
                    // The table is not even: the tilt changes with the move and stays.
                    let tilt = random.normals(0.005);
                    motion
                        .turns
                        .push((start, duration, [tilt[0], tilt[1], 4.0 * tilt[2]]));
                    start += duration + 0.7;
                }
            }
            Kind::Robot => {
                let mut start = REST_S;
                while start < 40.0 {
                    let way = random.normals(0.4);
                    let length = way.iter().map(|w| w * w).sum::<f64>().sqrt();
                    let duration = length / 0.25 + 0.3;
                    motion.moves.push((start, duration, way));
                    if random.uniform() < 0.5 {
                        motion.turns.push((start, duration, random.normals(0.3)));
                    }
                    start += duration + 0.5;
                }
                for axis in 0..3 {
                    let omega = tau * (18.0 + 8.0 * random.uniform());
                    let phase = tau * random.uniform();
                    motion.place[axis].push(Tone {
                        size: 0.3 / (omega * omega),
                        omega,
                        phase,
                    });
                }
            }
        }
        motion
    }

    fn sum(&self, t: f64, tones: &[Vec<Tone>; 3], moves: &[(f64, f64, [f64; 3])]) -> [f64; 3] {
        // The tones set in over a second.
        let begun = smooth(t - REST_S);
        std::array::from_fn(|i| {
            let swing: f64 = tones[i].iter().map(|tone| tone.at(t)).sum();
            let moved: f64 = moves
                .iter()
                .map(|(start, duration, way)| {
                    let x = (t - start) / duration;
                    way[i]
                        * if self.kind == Kind::Slides {
                            smooth(x)
                        } else {
                            ramped(x, (0.4 / duration).min(0.4))
                        }
                })
                .sum();
            begun * swing + moved
        })
    }

    /// Place, m.
    pub fn place(&self, t: f64) -> [f64; 3] {
        self.sum(t, &self.place, &self.moves)
    }

    pub fn velocity(&self, t: f64) -> [f64; 3] {
        let h = 1e-4;
        let (a, b) = (self.place(t - h), self.place(t + h));
        std::array::from_fn(|i| (b[i] - a[i]) / (2.0 * h))
    }

    fn acceleration(&self, t: f64) -> [f64; 3] {
        let h = 3e-4;
        let (a, b, c) = (self.place(t - h), self.place(t), self.place(t + h));
        std::array::from_fn(|i| (a[i] - 2.0 * b[i] + c[i]) / (h * h))
    }

    /// Columns: the body's axes in navigation axes.
    fn axes(&self, t: f64) -> [[f64; 3]; 3] {
        let v = self.sum(t, &self.turn, &self.turns);
        let angle = v.iter().map(|c| c * c).sum::<f64>().sqrt();
        let (s, c) = if angle < 1e-6 {
            (1.0, 0.5)
        } else {
            (angle.sin() / angle, (1.0 - angle.cos()) / (angle * angle))
        };
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|e| {
            let once = cross(v, e);
            let twice = cross(v, once);
            std::array::from_fn(|i| e[i] + s * once[i] + c * twice[i])
        })
    }

    /// Direction of body x from east to north, rad.
    pub fn heading(&self, t: f64) -> f64 {
        let [x, _, _] = self.axes(t);
        x[1].atan2(x[0])
    }

    fn rate(&self, t: f64) -> [f64; 3] {
        let h = 1e-4;
        let (a, b, now) = (self.axes(t - h), self.axes(t + h), self.axes(t));
        let change =
            |k: usize| -> [f64; 3] { std::array::from_fn(|i| (b[k][i] - a[k][i]) / (2.0 * h)) };
        let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| a[i] * b[i]).sum::<f64>();
        [
            dot(change(1), now[2]),
            dot(change(2), now[0]),
            dot(change(0), now[1]),
        ]
    }

    /// True force, field and rate, body axes.
    fn seen(&self, t: f64) -> [[f64; 3]; 3] {
        let axes = self.axes(t);
        let mut force = self.acceleration(t);
        force[2] += G;
        let p = self.place(t);
        // Iron about: a few µT, over half a metre and more.
        let field: [f64; 3] = std::array::from_fn(|i| {
            FIELD[i] + 2.0 * (2.0 * p[i] + 1.3 * p[(i + 1) % 3] + i as f64).sin()
        });
        let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| a[i] * b[i]).sum::<f64>();
        [
            axes.map(|e| dot(e, force)),
            axes.map(|e| dot(e, field)),
            self.rate(t),
        ]
    }
}

/// What a run showed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Run {
    /// Position's NEES after 1, 2 and 5 s.
    pub nees: [f64; 3],
    /// Position's error, m.
    pub error: [f64; 3],
    /// Squared innovations of gravity by their expectation, at the end.
    pub innovation: f64,
}

/// Motion of one seed at `rate` Hz: start known at a time in the motion, errors after 1, 2 and 5 s.
pub fn run(kind: Kind, rate: f64, gyroscope: bool, seed: u64) -> Run {
    let mut random = Random::new(seed * 7919 + 17);
    let motion = Motion::new(kind, &mut random);
    let bias = random.normals(0.03);
    let offset = random.normals(0.005);
    let begin = 8.0 + 4.0 * random.uniform();
    // No zero velocity: it would be a prior on speed.
    let mut filter = UnitFilter::new(UnitConfig {
        zupt: Zupt::Off,
        ..UnitConfig::default()
    });
    let step = 1.0 / rate;
    // The sensor's own filter: a mean over the step.
    let parts = (400.0 / rate).clamp(1.0, 20.0).round() as usize;
    let count = ((begin + 5.0) * rate) as usize + 2;
    let mut started = None;
    let mut out = Run::default();
    let mut next = 0;
    for k in 0..count {
        let t = k as f64 * step;
        let mut seen = [[0.0; 3]; 3];
        for part in 0..parts {
            let at = t + step * ((part as f64 + 0.5) / parts as f64 - 0.5);
            for (sum, value) in seen
                .iter_mut()
                .flatten()
                .zip(motion.seen(at).iter().flatten())
            {
                *sum += value / parts as f64;
            }
        }
        let [mut force, mut field, mut turn] = seen;
        let noise = random.normals(0.0015 * rate.sqrt());
        let white = random.normals(3e-4 * rate.sqrt());
        let magnetic = random.normals(0.5);
        for i in 0..3 {
            force[i] += bias[i] + noise[i];
            turn[i] += offset[i] + white[i];
            field[i] += magnetic[i];
        }
        let sample = UnitSample {
            step_s: if k == 0 { 0.0 } else { step },
            force_mps2: force,
            field_ut: Some(field),
            rate_rad_s: gyroscope.then_some(turn),
        };
        let _ = filter.push(&sample);
        match started {
            None if t >= begin => {
                let p = motion.place(t);
                filter.set_start(p, motion.velocity(t), motion.heading(t));
                started = Some(t);
            }
            Some(from) => {
                let horizons = [1.0, 2.0, 5.0];
                if next < 3 && t - from >= horizons[next] - 1e-9 {
                    let state = filter.state();
                    let truth = motion.place(t);
                    let e: [f64; 3] = std::array::from_fn(|i| state.position_m[i] - truth[i]);
                    let p = nalgebra::Matrix3::from_fn(|r, c| state.position_covariance[r][c]);
                    let e = nalgebra::Vector3::from(e);
                    out.error[next] = e.norm();
                    out.nees[next] = p
                        .try_inverse()
                        .map_or(f64::INFINITY, |inverse| e.dot(&(inverse * e)));
                    out.innovation = state.innovation;
                    next += 1;
                }
            }
            None => {}
        }
    }
    out
}

/// What runs of one kind say about the filter's covariance.
pub struct Consistency {
    name: String,
    /// After 1, 2 and 5 s: median error, m, share of NEES below 7.81 and median NEES.
    pub error: [f64; 3],
    pub below: [Coverage; 3],
    pub nees: [f64; 3],
    /// Mean NIS of gravity.
    pub nis: f64,
}

impl Consistency {
    pub fn over(kind: Kind, rate: f64, gyroscope: bool, seeds: u64) -> Self {
        let runs: Vec<Run> = (0..seeds)
            .map(|seed| run(kind, rate, gyroscope, seed))
            .collect();
        let median = |value: &dyn Fn(&Run) -> f64| {
            let mut all: Vec<f64> = runs.iter().map(value).collect();
            all.sort_by(f64::total_cmp);
            all[all.len() / 2]
        };
        let share = |h: usize| runs.iter().map(|r| r.nees[h] < 7.81).collect();
        Self {
            name: format!(
                "{kind:?} {rate} Hz{}",
                if gyroscope { ", gyroscope" } else { "" }
            ),
            error: std::array::from_fn(|h| median(&|r| r.error[h])),
            below: std::array::from_fn(share),
            nees: std::array::from_fn(|h| median(&|r| r.nees[h])),
            nis: runs.iter().map(|r| r.innovation).sum::<f64>() / runs.len() as f64,
        }
    }
}

impl std::fmt::Display for Consistency {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            name,
            error: e,
            below: b,
            nees: n,
            nis,
        } = self;
        let b = b.map(|b| 100.0 * b.fraction());
        write!(
            f,
            "{name:<28} {:.3} {:.3} {:.3} | {:4.0} {:4.0} {:4.0} | {:.2} {:.2} {:.2} | {nis:.2}",
            e[0], e[1], e[2], b[0], b[1], b[2], n[0], n[1], n[2]
        )
    }
}
