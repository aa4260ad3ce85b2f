//! Simulated journeys of arrays whose sensors are not what the filter takes them for, and whether the truth
//! lies within what it says.

use std::fmt;

use super::common::{Random, cross, push, push_truth};
use wimu_calib::Gravity;
use wimu_host::Problem;
use wimu_host::array::{Array, ArrayBody, ArrayCalibration, ArrayGeometry};
use wimu_host::inertial::nees;
use wimu_host::inertial::{Choice, Zupt, navigate_array};

const G: f64 = 9.80665;
/// Slower than this, rad/s, the rate is not scored: an array is taken to rest there, or knows nothing.
const SCORED_RAD_S: f64 = 0.3;

type V = [f64; 3];
type Rotation = [V; 3];

fn add(a: V, b: V, by: f64) -> V {
    std::array::from_fn(|i| a[i] + by * b[i])
}

fn norm(a: V) -> f64 {
    a.iter().map(|v| v * v).sum::<f64>().sqrt()
}

fn apply(m: &Rotation, v: V) -> V {
    m.map(|row| (0..3).map(|i| row[i] * v[i]).sum())
}

fn back(m: &Rotation, v: V) -> V {
    std::array::from_fn(|j| (0..3).map(|i| m[i][j] * v[i]).sum())
}

fn product(a: &Rotation, b: &Rotation) -> Rotation {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

/// Of a rotation vector, rad.
fn rotation(by: V) -> Rotation {
    let angle = norm(by).max(1e-300);
    let (sin, cos) = angle.sin_cos();
    let n = by.map(|v| v / angle);
    std::array::from_fn(|i| {
        let mut unit = [0.0; 3];
        unit[i] = 1.0;
        let crossed = cross(unit, n);
        std::array::from_fn(|j| {
            let one = if i == j { cos } else { 0.0 };
            one + sin * crossed[j] + (1.0 - cos) * n[i] * n[j]
        })
    })
}

fn quaternion(m: &Rotation) -> [f64; 4] {
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = *m;
    let size = |v: f64| v.max(0.0).sqrt() / 2.0;
    [
        size(1.0 + xx + yy + zz),
        size(1.0 + xx - yy - zz).copysign(zy - yz),
        size(1.0 - xx + yy - zz).copysign(xz - zx),
        size(1.0 - xx - yy + zz).copysign(yx - xy),
    ]
}

/// Least jerk from 0 to 1: integral, value and two derivatives.
fn smooth(x: f64) -> [f64; 4] {
    let y = x * x * x;
    [
        y * x * (2.5 - 3.0 * x + x * x),
        y * (10.0 - 15.0 * x + 6.0 * x * x),
        30.0 * x * x * (1.0 - x) * (1.0 - x),
        60.0 * x * (1.0 - x) * (1.0 - 2.0 * x),
    ]
}

/// Part of a journey: its length, s; a move, m; a rotation about one axis of the body, rad; at its end the velocity, m/s, and the
/// rate about the vertical, rad/s.
#[derive(Clone, Copy, Default)]
pub struct Part {
    pub seconds: f64,
    pub shift: V,
    pub turn: V,
    pub velocity: V,
    pub spin: f64,
}

/// How a body is at a time.
struct Motion {
    position: V,
    acceleration: V,
    /// Body to navigation axes.
    attitude: Rotation,
    rate: V,
    turning: V,
}

/// A journey: its parts, each with how it begins.
struct Journey {
    parts: Vec<(f64, Part, Start)>,
}

#[derive(Clone, Copy)]
struct Start {
    position: V,
    velocity: V,
    spin: f64,
    attitude: Rotation,
}

impl Journey {
    fn of(parts: &[Part], attitude: Rotation) -> Self {
        let mut start = Start { position: [0.0; 3], velocity: [0.0; 3], spin: 0.0, attitude };
        let (mut time, mut all) = (0.0, Vec::new());
        for part in parts {
            all.push((time, *part, start));
            time += part.seconds;
            let end = part.at(&start, part.seconds);
            let (velocity, spin) = (part.velocity, part.spin);
            start = Start { position: end.position, velocity, spin, attitude: end.attitude };
        }
        Self { parts: all }
    }

    fn seconds(&self) -> f64 {
        self.parts.iter().map(|(_, part, _)| part.seconds).sum()
    }

    fn at(&self, time: f64) -> Motion {
        let index = self.parts.partition_point(|(begin, ..)| *begin <= time);
        let (begin, part, start) = &self.parts[index.max(1) - 1];
        part.at(start, (time - begin).clamp(0.0, part.seconds))
    }
}

impl Part {
    fn at(&self, start: &Start, time: f64) -> Motion {
        let s = self.seconds;
        let [sum, value, slope, curve] = smooth(time / s);
        let faster = add(self.velocity, start.velocity, -1.0);
        let position =
            add(add(add(start.position, start.velocity, time), faster, sum * s), self.shift, value);
        let acceleration = add(faster.map(|v| v * slope / s), self.shift, curve / (s * s));
        let up = back(&start.attitude, [0.0, 0.0, 1.0]);
        let more = self.spin - start.spin;
        let by = add(self.turn.map(|v| v * value), up, start.spin * time + more * sum * s);
        Motion {
            position,
            acceleration,
            attitude: product(&start.attitude, &rotation(by)),
            rate: add(self.turn.map(|v| v * slope / s), up, start.spin + more * value),
            turning: add(self.turn.map(|v| v * curve / (s * s)), up, more * slope / s),
        }
    }
}

/// What a body does.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// Four moves of so many m an axis with turns of so many rad an axis, rests between.
    Moves(f64, f64),
    /// One of these moves, between two rests.
    Move(f64, f64),
    /// Pushed to so many m/s, then so many s evenly, braked.
    Cart(f64, f64),
}

/// Where the sensors are.
#[derive(Clone, Copy, Debug)]
pub enum Places {
    Octahedron(f64),
    Board,
    Four(f64),
}

/// What is simulated.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    pub kind: Kind,
    pub places: Places,
    pub rate_hz: f64,
    pub zupt: Zupt,
    /// Standard deviations: noise and bias, m/s², of sensitivity and direction, of places, m, of the time, s.
    pub noise: f64,
    pub bias: f64,
    pub scale: f64,
    pub place: f64,
    pub skew: f64,
}

impl Default for Case {
    fn default() -> Self {
        Self {
            kind: Kind::Moves(0.3, 3.0),
            places: Places::Octahedron(0.03),
            rate_hz: 200.0,
            zupt: Zupt::Stated,
            noise: 0.02,
            bias: 0.02,
            scale: 0.0,
            place: 0.0,
            skew: 0.0,
        }
    }
}

/// What came of one seed.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// NEES of the position of all samples that were valid, and of the rate of those that turned.
    pub position: Vec<f64>,
    pub rate: Vec<f64>,
    pub valid: f64,
    /// Rms of the rate's error and its mean square by its deviation, rad/s.
    pub rate_error: f64,
    pub rate_sd: f64,
}

impl Case {
    fn geometry(&self) -> ArrayGeometry {
        let places: Vec<V> = match self.places {
            Places::Octahedron(arm) => (0..6)
                .map(|k| {
                    let sign = if k % 2 == 0 { arm } else { -arm };
                    std::array::from_fn(|i| if i == k / 2 { sign } else { 0.0 })
                })
                .collect(),
            Places::Board => (0..8)
                .map(|k| {
                    let sign = |bit: usize| if k >> bit & 1 == 0 { 1.0 } else { -1.0 };
                    [0.0095 * sign(2), 0.0095 * sign(1), 0.002 * sign(0)]
                })
                .collect(),
            Places::Four(arm) => {
                let all =
                    [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
                all.iter().map(|p: &V| p.map(|v| v * arm)).collect()
            }
        };
        ArrayGeometry::at(&places)
    }

    fn journey(&self, random: &mut Random) -> Journey {
        let still = |seconds: f64| Part { seconds, ..Part::default() };
        let tilt = rotation(random.normals(0.5));
        let mut parts = vec![still(2.5)];
        match self.kind {
            Kind::Moves(metres, radians) | Kind::Move(metres, radians) => {
                let moves = if matches!(self.kind, Kind::Move(..)) { 1 } else { 4 };
                for _ in 0..moves {
                    parts.push(Part {
                        seconds: 0.6 + 0.6 * random.uniform(),
                        shift: random.normals(metres),
                        turn: random.normals(radians),
                        ..Part::default()
                    });
                    parts.push(still(1.2));
                }
            }
            Kind::Cart(speed, seconds) => {
                let direction = random.normals(1.0);
                let velocity = direction.map(|v| v * speed / norm(direction));
                let of = |seconds, velocity| Part { seconds, velocity, ..Part::default() };
                parts.extend([
                    of(1.0, velocity),
                    of(seconds, velocity),
                    of(1.0, [0.0; 3]),
                    still(2.0),
                ]);
            }
        }
        Journey::of(&parts, tilt)
    }

    /// The recording of one seed, with the truth.
    pub fn recording(&self, seed: u64) -> (Array, ArrayGeometry) {
        let random = &mut Random::new(seed);
        let geometry = self.geometry();
        let journey = self.journey(random);
        (self.record(&journey, &geometry, random), geometry)
    }

    /// The recording of these parts, which begin level.
    pub fn recording_of(&self, parts: &[Part], seed: u64) -> (Array, ArrayGeometry) {
        let geometry = self.geometry();
        let journey = Journey::of(parts, rotation([0.0; 3]));
        (self.record(&journey, &geometry, &mut Random::new(seed)), geometry)
    }

    fn record(&self, journey: &Journey, geometry: &ArrayGeometry, random: &mut Random) -> Array {
        struct Sensor {
            place: V,
            bias: V,
            scale: Rotation,
            skew: f64,
        }
        let places = geometry.sensors.iter().map(|s| s.places_m[0]);
        let sensors: Vec<Sensor> = places
            .map(|place| Sensor {
                place: add(place, random.normals(self.place), 1.0),
                bias: random.normals(self.bias),
                scale: [0; 3].map(|_| random.normals(self.scale)),
                skew: self.skew * random.normal(),
            })
            .collect();
        let mut recording = Array::default();
        let count = (journey.seconds() * self.rate_hz) as usize;
        for k in 0..count {
            let time = k as f64 / self.rate_hz;
            let row = sensors.iter().map(|sensor| {
                let motion = journey.at(time + sensor.skew);
                let force = back(&motion.attitude, add(motion.acceleration, [0.0, 0.0, G], 1.0));
                let turned = cross(motion.rate, cross(motion.rate, sensor.place));
                let force = add(add(force, cross(motion.turning, sensor.place), 1.0), turned, 1.0);
                let scaled = add(force, apply(&sensor.scale, force), 1.0);
                add(add(scaled, sensor.bias, 1.0), random.normals(self.noise), 1.0)
            });
            let row: Vec<V> = row.collect();
            push(&mut recording, time, row);
            let motion = journey.at(time);
            let truth = (motion.position, quaternion(&motion.attitude), motion.rate);
            push_truth(&mut recording, time, truth);
        }
        recording
    }

    /// Navigated as the command does it.
    ///
    /// # Errors
    /// Those of the command.
    pub fn run(&self, seed: u64) -> Result<Outcome, Problem> {
        let (recording, geometry) = self.recording(seed);
        // As the user says who knows no better.
        let place_sd_m = self.place.max(ArrayCalibration::PLACE_SD_M);
        let delay_sd_s = self.skew.max(ArrayCalibration::DELAY_SD_S);
        let choice = Choice { zupt: self.zupt, ..Choice::default() };
        let arranged = recording.judged().arranged(&geometry)?;
        let mut calibration = ArrayCalibration::of(&arranged, &geometry, Gravity::UNKNOWN_PLACE)?;
        (calibration.place_sd_m, calibration.delay_sd_s) = (place_sd_m, delay_sd_s);
        let path = navigate_array(&arranged, &geometry, &calibration, &choice)?;
        let (states, _) = ArrayBody::of(&arranged, &geometry, &calibration)
            .and_then(|body| body.navigated(G, self.zupt))?;
        let truth = arranged.beside(&arranged.reference.rate_rad_s);
        let mut outcome = Outcome {
            position: path.nees.all.clone(),
            valid: path.points.iter().filter(|p| p.valid).count() as f64 / path.points.len() as f64,
            ..Outcome::default()
        };
        for (state, truth) in states.iter().zip(truth) {
            let Some(truth) = truth else { continue };
            if norm(truth) > SCORED_RAD_S && state.certainty > 0.0 {
                let error = add(state.rate_rad_s, truth, -1.0);
                outcome.rate.push(nees(error, state.rate_covariance));
                outcome.rate_error += norm(error).powi(2);
                outcome.rate_sd += (0..3).map(|i| state.rate_covariance[i][i]).sum::<f64>();
            }
        }
        let count = outcome.rate.len().max(1) as f64;
        outcome.rate_error = (outcome.rate_error / count).sqrt();
        outcome.rate_sd = (outcome.rate_sd / count).sqrt();
        Ok(outcome)
    }

    /// Over seeds 1 to `seeds`.
    pub fn over(&self, seeds: u64) -> Coverage {
        let mut coverage = Coverage { case: *self, refused: 0, outcomes: Vec::new() };
        for seed in 1..=seeds {
            match self.run(seed) {
                Ok(outcome) => coverage.outcomes.push(outcome),
                Err(_) => coverage.refused += 1,
            }
        }
        coverage
    }
}

/// What came of all seeds.
pub struct Coverage {
    pub case: Case,
    pub refused: u64,
    pub outcomes: Vec<Outcome>,
}

fn share(all: impl Iterator<Item = f64>) -> f64 {
    let (mut below, mut count) = (0.0, 0.0);
    for nees in all {
        below += f64::from(u8::from(nees < 7.81));
        count += 1.0;
    }
    100.0 * below / f64::max(count, 1.0)
}

impl Coverage {
    /// Share of the valid positions with a NEES below 7.81, %.
    pub fn position(&self) -> f64 {
        share(self.outcomes.iter().flat_map(|o| o.position.iter().copied()))
    }

    /// The same of the rates while it turns.
    pub fn rate(&self) -> f64 {
        share(self.outcomes.iter().flat_map(|o| o.rate.iter().copied()))
    }

    /// Whether the true percentages of positions and rates with a NEES below 7.81 can be at least these: within 4 standard
    /// errors, samples of one journey being dependent.
    pub fn can_be_at_least(&self, position: f64, rate: f64) -> bool {
        let reaches = |all: &dyn Fn(&Outcome) -> &Vec<f64>, least: f64| {
            let parts = || self.outcomes.iter().map(all);
            let below = share(parts().flatten().copied());
            let count = parts().map(Vec::len).sum::<usize>().max(1) as f64;
            let departs =
                |part: &Vec<f64>| part.len() as f64 * (share(part.iter().copied()) - below);
            let se = parts().map(|part| departs(part).powi(2)).sum::<f64>().sqrt() / count;
            below + 4.0 * se >= least
        };
        reaches(&|o| &o.position, position) && reaches(&|o| &o.rate, rate)
    }

    /// Share of the samples whose position is valid, %.
    pub fn valid(&self) -> f64 {
        let sum: f64 = self.outcomes.iter().map(|o| o.valid).sum();
        100.0 * sum / f64::max(self.outcomes.len() as f64, 1.0)
    }

    /// Error of the rates while it turns, rad/s rms.
    pub fn rate_error(&self) -> f64 {
        self.mean(|o| o.rate_error)
    }

    /// What it is said to be.
    pub fn rate_sd(&self) -> f64 {
        self.mean(|o| o.rate_sd)
    }

    fn mean(&self, of: fn(&Outcome) -> f64) -> f64 {
        let sum: f64 = self.outcomes.iter().map(|o| of(o).powi(2)).sum();
        (sum / f64::max(self.outcomes.len() as f64, 1.0)).sqrt()
    }
}

impl fmt::Display for Coverage {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Case { kind, places, rate_hz, zupt, bias, scale, place, skew, .. } = self.case;
        let (about, zupt) = (format!("{kind:?} {places:?}"), format!("{zupt:?}"));
        write!(
            out,
            "{about:<40} {rate_hz:>4} Hz {} b {bias:<4} s {scale:<5} p {:<3} t {:<4} | valid {:3.0} %, NEES {:3.0} % | \
             rate {:3.0} %, {:.3} of {:.3} rad/s | refused {}",
            zupt,
            place * 1e3,
            skew * 1e6,
            self.valid(),
            self.position(),
            self.rate(),
            self.rate_error(),
            self.rate_sd(),
            self.refused,
        )
    }
}
