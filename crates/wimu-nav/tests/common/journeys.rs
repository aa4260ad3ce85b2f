//! Journeys of one unit between rests, with their truth: slow moves, carts, turns, pushes.

use super::{Random, cross};
use std::ops::RangeInclusive;

use wimu_nav::unit::{UnitConfig, UnitFilter, UnitSample, Zupt};
use wimu_testkit::Coverage;

const G: f64 = 9.80665;
const FIELD: [f64; 3] = [0.0, 20.0, -44.0];

/// What a part of a journey is.
#[derive(Clone, Copy, Debug)]
enum Part {
    /// A way of least jerk, m, and a turn, rad, body axes.
    Move([f64; 3], [f64; 3]),
    /// An acceleration that goes evenly from the first to the second, m/s², and velocity goes on.
    Push([f64; 3], [f64; 3]),
}

/// Kinds of journeys.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Journey {
    /// Four moves of 0.7 m in 1 to 2.5 s, rests of 1 to 2 s, turning by so much each, rad an axis.
    Moves(f64),
    /// Three moves of 0.7 m in so long, s, each, without a turn.
    Slow(f64),
    /// Pushed within 1 s to so many m/s, then 20 s evenly.
    Cart(f64),
    /// Pushed within 1 s to so many m/s more, three times, 8 s evenly after each.
    Stairs(f64),
    /// Turns of 0.8 rad an axis on the spot.
    Turns,
    /// So many m/s² east or north, for so long, s, ramps of 1 s, then 5 s evenly.
    Push(f64, f64, bool),
    /// Four moves of 0.7 m in so long, s, rests of 1.5 s, turning by 0.3 rad each, rad an axis.
    Violent(f64),
    /// Steps of 0.7 m in 0.6 s, pauses of 0.8 s.
    Steps,
    /// Eight moves of 0.3 to 1 m in 1 to 3 s, rests of 1 to 3 s, turning by up to so much each, rad, about any axis.
    Carried(f64),
    /// A level vehicle: four legs of so many m forward in so long, s, a quarter of a turn on the spot after each.
    Vehicle(f64, f64),
}

impl Journey {
    fn parts(self, random: &mut Random) -> Vec<(f64, Part)> {
        let rest = Part::Push([0.0; 3], [0.0; 3]);
        let stop = Part::Move([0.0; 3], [0.0; 3]);
        let mut parts = vec![(3.0, stop)];
        match self {
            Self::Moves(turn) => {
                for _ in 0..4 {
                    let lasts = 1.0 + 1.5 * random.uniform();
                    parts.push((lasts, Part::Move(random.normals(0.4), random.normals(turn))));
                    parts.push((1.0 + random.uniform(), stop));
                }
            }
            Self::Slow(lasts) => {
                for _ in 0..3 {
                    parts.push((lasts, Part::Move(random.normals(0.4), [0.0; 3])));
                    parts.push((2.0, stop));
                }
            }
            Self::Cart(speed) => {
                let angle = std::f64::consts::TAU * random.uniform();
                let peak = [2.0 * speed * angle.cos(), 2.0 * speed * angle.sin(), 0.0];
                let brake = peak.map(|a| -a);
                for (lasts, from, to) in [
                    (0.5, [0.0; 3], peak),
                    (0.5, peak, [0.0; 3]),
                    (20.0, [0.0; 3], [0.0; 3]),
                    (0.5, [0.0; 3], brake),
                    (0.5, brake, [0.0; 3]),
                ] {
                    parts.push((lasts, Part::Push(from, to)));
                }
                parts.push((3.0, rest));
            }
            Self::Violent(lasts) => {
                for _ in 0..4 {
                    parts.push((lasts, Part::Move(random.normals(0.4), random.normals(0.3))));
                    parts.push((1.5, stop));
                }
            }
            Self::Stairs(speed) => {
                for _ in 0..3 {
                    let peak = [2.0 * speed, 0.0, 0.0];
                    for (lasts, from, to) in [
                        (0.5, [0.0; 3], peak),
                        (0.5, peak, [0.0; 3]),
                        (8.0, [0.0; 3], [0.0; 3]),
                    ] {
                        parts.push((lasts, Part::Push(from, to)));
                    }
                }
            }
            Self::Turns => {
                for _ in 0..4 {
                    parts.push((2.0, Part::Move([0.0; 3], random.normals(0.8))));
                    parts.push((2.0, stop));
                }
            }
            Self::Push(size, lasts, north) => {
                let push = if north {
                    [0.0, size, 0.0]
                } else {
                    [size, 0.0, 0.0]
                };
                parts.push((1.0, Part::Push([0.0; 3], push)));
                parts.push((lasts, Part::Push(push, push)));
                parts.push((1.0, Part::Push(push, [0.0; 3])));
                parts.push((5.0, rest));
            }
            Self::Steps => {
                for _ in 0..12 {
                    let ahead = [0.7 + random.normal() * 0.05, 0.0, 0.0];
                    let turn = random.normals(0.1);
                    parts.push((0.6, Part::Move(ahead, turn)));
                    parts.push((0.8, stop));
                }
            }
            Self::Vehicle(ahead, lasts) => {
                let mut heading = 0.0_f64;
                for _ in 0..4 {
                    let way = [ahead * heading.cos(), ahead * heading.sin(), 0.0];
                    parts.push((lasts, Part::Move(way, [0.0; 3])));
                    parts.push((1.0, stop));
                    let quarter = std::f64::consts::FRAC_PI_2;
                    parts.push((1.5, Part::Move([0.0; 3], [0.0, 0.0, quarter])));
                    parts.push((1.0, stop));
                    heading += quarter;
                }
            }
            Self::Carried(most) => {
                for _ in 0..8 {
                    let way = direction(random).map(|d| d * 0.5);
                    let size = (0.6 + 1.4 * random.uniform(), most * random.uniform());
                    let turn = direction(random).map(|d| d * size.1);
                    let lasts = 1.0 + 2.0 * random.uniform();
                    parts.push((lasts, Part::Move(way.map(|w| w * size.0), turn)));
                    parts.push((1.0 + 2.0 * random.uniform(), stop));
                }
            }
        }
        parts
    }
}

/// Any direction.
fn direction(random: &mut Random) -> [f64; 3] {
    let any = random.normals(1.0);
    any.map(|c| c / super::norm(any))
}

/// Rotation by a vector, columns: where the axes go.
fn turned(axes: [[f64; 3]; 3], by: [f64; 3]) -> [[f64; 3]; 3] {
    let angle = by.iter().map(|c| c * c).sum::<f64>().sqrt();
    let (s, c) = if angle < 1e-9 {
        (1.0, 0.5)
    } else {
        (angle.sin() / angle, (1.0 - angle.cos()) / (angle * angle))
    };
    // Body axes: the new columns are the old matrix times the rotation's columns.
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|e: [f64; 3]| {
        let once = cross(by, e);
        let twice = cross(by, once);
        let column: [f64; 3] = std::array::from_fn(|i| e[i] + s * once[i] + c * twice[i]);
        std::array::from_fn(|i| (0..3).map(|k| axes[k][i] * column[k]).sum())
    })
}

/// How a journey is recorded.
#[derive(Clone, Copy, Debug)]
pub struct Recorded {
    pub rate_hz: f64,
    pub gyroscope: bool,
    pub zupt: Zupt,
    pub noise_mps2: f64,
    pub bias_mps2: f64,
    /// The gyroscope gives nothing for so long from 4 s on, s.
    pub fails_s: f64,
    /// Samples are missing for so long from 3.5 s on, s, or time jumps by that.
    pub hole_s: f64,
    pub jump_s: f64,
    /// It is switched on so late, s: the first rest ends at 3 s.
    pub begins_s: f64,
    /// Scales and axes of gyroscope and accelerometer are wrong by this, standard deviation of each entry of their matrices.
    pub rate_matrix: f64,
    pub force_matrix: f64,
    /// The gyroscope's samples are so old, s.
    pub late_s: f64,
    /// One sample 2 s after the beginning, in the first rest, is this much too great on each axis, m/s².
    pub glitch_mps2: f64,
    /// There is a magnetometer.
    pub field: bool,
    /// The accelerometer clips at this, m/s², and what clips is left out.
    pub clips_mps2: f64,
}

impl Default for Recorded {
    fn default() -> Self {
        Self {
            rate_hz: 100.0,
            gyroscope: true,
            zupt: Zupt::Assumed,
            noise_mps2: 0.03,
            bias_mps2: 0.03,
            fails_s: 0.0,
            hole_s: 0.0,
            jump_s: 0.0,
            begins_s: 0.0,
            rate_matrix: 0.0,
            force_matrix: 0.0,
            late_s: 0.0,
            glitch_mps2: 0.0,
            field: true,
            clips_mps2: f64::INFINITY,
        }
    }
}

/// What a journey showed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Shown {
    /// Share of the samples that were valid, and of those at which it moved with a position NEES below 7.81.
    pub valid: f64,
    pub below: f64,
    /// Share of the samples whose NEES counts.
    pub judged: f64,
    /// Share of the samples at which it moved that were valid.
    pub moving: f64,
    /// Greatest error of a component in deviations (of at least 3 mm) while valid, and the error in space there, m.
    pub worst: f64,
    pub off_m: f64,
    /// How far even motion may have taken it, one standard deviation, m.
    pub unseen_m: f64,
    /// Error at the end, m.
    pub end_m: f64,
    /// Share of the samples at rest that were taken for rests.
    pub rests: f64,
}

/// One journey.
pub fn travel(journey: Journey, how: Recorded, seed: u64) -> Shown {
    let mut random = Random::new(seed * 7919 + 29);
    let parts = journey.parts(&mut random);
    let bias = random.normals(how.bias_mps2);
    let offset = random.normals(0.01);
    let mut errors = Random::new(seed * 104_729 + 7);
    let [rate_matrix, force_matrix] = [how.rate_matrix, how.force_matrix]
        .map(|sd| [errors.normals(sd), errors.normals(sd), errors.normals(sd)]);
    let mut filter = UnitFilter::new(UnitConfig {
        zupt: how.zupt,
        ..UnitConfig::default()
    });
    let step = 1.0 / how.rate_hz;
    let mut axes = turned(
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [0.0, 0.0, 0.0],
    );
    let (mut place, mut speed) = ([0.0; 3], [0.0; 3]);
    let mut shown = Shown::default();
    let (mut count, mut valid, mut below, mut judged) = (0.0, 0.0, 0.0, 0.0);
    let (mut still, mut found, mut moving) = (0.0, 0.0, 0.0);
    let (mut waited, mut clock_s) = (0.0, 0.0);
    let mut rates: std::collections::VecDeque<[f64; 3]> = Default::default();
    let mut origin: Option<[f64; 3]> = None;
    // Without a magnetometer heading is measured from where the first rest ends, too.
    let mut heading = [1.0, 0.0];
    let mut rested: Vec<(f64, [f64; 3])> = Vec::new();
    for (lasts, part) in &parts {
        let samples = (lasts * how.rate_hz).round();
        let lasts = samples * step;
        for k in 0..samples as usize {
            let t = k as f64 * step;
            let x = t / lasts;
            let (p, v, a, now, rate) = match part {
                Part::Move(way, turn) => {
                    let s = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x);
                    let d = 30.0 * x * x * (1.0 - x) * (1.0 - x) / lasts;
                    let dd = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (lasts * lasts);
                    (
                        way.map(|w| w * s),
                        way.map(|w| w * d),
                        way.map(|w| w * dd),
                        turned(axes, turn.map(|r| r * s)),
                        turn.map(|r| r * d),
                    )
                }
                Part::Push(from, to) => {
                    let grows: [f64; 3] = std::array::from_fn(|i| (to[i] - from[i]) / lasts);
                    (
                        std::array::from_fn(|i| {
                            t * (speed[i] + t * (from[i] / 2.0 + t * grows[i] / 6.0))
                        }),
                        std::array::from_fn(|i| speed[i] + t * (from[i] + t * grows[i] / 2.0)),
                        std::array::from_fn(|i| from[i] + t * grows[i]),
                        axes,
                        [0.0; 3],
                    )
                }
            };
            rates.push_back(rate);
            if rates.len() as f64 > (how.late_s * how.rate_hz).round() + 1.0 {
                rates.pop_front();
            }
            clock_s += step;
            if clock_s <= how.begins_s {
                continue;
            }
            let noise = random.normals(how.noise_mps2);
            let white = random.normals(0.003);
            let magnetic = random.normals(0.5);
            let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| a[i] * b[i]).sum::<f64>();
            let force = [a[0], a[1], a[2] + G];
            let age_s = count * step;
            count += 1.0;
            let fails = age_s >= 4.0 && age_s < 4.0 + how.fails_s;
            if age_s >= 3.5 && age_s < 3.5 + how.hole_s {
                waited += step;
                continue;
            }
            let jump = if (age_s - 3.5).abs() < 0.5 * step {
                how.jump_s
            } else {
                0.0
            };
            let since = if count == 1.0 {
                0.0
            } else {
                step + waited + jump
            };
            waited = 0.0;
            let glitch = if (age_s - 2.0).abs() < 0.5 * step {
                how.glitch_mps2
            } else {
                0.0
            };
            let pulled = now.map(|axis| dot(axis, force));
            let spun = rates.front().copied().unwrap_or(rate);
            let sample = UnitSample {
                step_s: since,
                force_mps2: std::array::from_fn(|i| {
                    pulled[i] + dot(force_matrix[i], pulled) + bias[i] + noise[i] + glitch
                }),
                field_ut: how
                    .field
                    .then(|| std::array::from_fn(|i| dot(now[i], FIELD) + magnetic[i])),
                rate_rad_s: (how.gyroscope && !fails).then(|| {
                    std::array::from_fn(|i| {
                        spun[i] + dot(rate_matrix[i], spun) + offset[i] + white[i]
                    })
                }),
            };
            if sample.force_mps2.iter().any(|f| f.abs() >= how.clips_mps2) {
                filter.interrupt(sample.step_s);
            } else {
                let _ = filter.push(&sample);
            }
            let state = filter.state();
            let truth: [f64; 3] = std::array::from_fn(|i| place[i] + p[i]);
            let resting = v.iter().chain(&a).chain(&rate).all(|c| *c == 0.0);
            if resting {
                still += 1.0;
                found += f64::from(u8::from(state.resting));
            }
            shown.unseen_m = state.unseen_m;
            if !(state.valid && state.position_sd_m() < 1.0) {
                continue;
            }
            // Position is measured from where the first rest ends: that shows after up to 0.6 s.
            if state.at_origin {
                if !how.field {
                    let [w, x, y, z] = state.quaternion;
                    let seen = (2.0 * (x * y + w * z)).atan2(1.0 - 2.0 * (y * y + z * z));
                    let off = seen - now[0][1].atan2(now[0][0]);
                    heading = [off.cos(), off.sin()];
                }
                rested.push((age_s, truth));
                origin = rested
                    .iter()
                    .rfind(|(at_s, _)| at_s + 0.6 < age_s)
                    .or(rested.first())
                    .map(|(_, at)| *at);
                valid += 1.0;
                moving += f64::from(u8::from(!resting));
                continue;
            }
            let from = *origin
                .get_or_insert_with(|| std::array::from_fn(|i| truth[i] - state.position_m[i]));
            let way: [f64; 3] = std::array::from_fn(|i| truth[i] - from[i]);
            let [c, s] = heading;
            let way = [c * way[0] - s * way[1], s * way[0] + c * way[1], way[2]];
            let error: [f64; 3] = std::array::from_fn(|i| state.position_m[i] - way[i]);
            // Truth is right to 1 mm.
            let p = nalgebra::Matrix3::from_fn(|r, c| {
                state.position_covariance[r][c] + if r == c { 1e-6 } else { 0.0 }
            });
            let e = nalgebra::Vector3::from(error);
            let nees = p
                .try_inverse()
                .map_or(f64::INFINITY, |inverse| e.dot(&(inverse * e)));
            valid += 1.0;
            moving += f64::from(u8::from(!resting));
            judged += f64::from(u8::from(!resting));
            below += f64::from(u8::from(!resting && nees < 7.81));
            for i in 0..3 {
                let sd = p[(i, i)].sqrt().max(0.003);
                let ratio = error[i].abs() / sd;
                if ratio > shown.worst {
                    (shown.worst, shown.off_m) = (ratio, e.norm());
                }
            }
            shown.end_m = e.norm();
        }
        match part {
            Part::Move(way, turn) => {
                axes = turned(axes, *turn);
                for i in 0..3 {
                    place[i] += way[i];
                    speed[i] = 0.0;
                }
            }
            Part::Push(from, to) => {
                for i in 0..3 {
                    place[i] +=
                        lasts * (speed[i] + lasts * (from[i] / 2.0 + (to[i] - from[i]) / 6.0));
                    speed[i] += lasts * (from[i] + to[i]) / 2.0;
                    if speed[i].abs() < 1e-12 {
                        speed[i] = 0.0;
                    }
                }
            }
        }
    }
    shown.valid = valid / count;
    shown.judged = judged / count;
    shown.below = if judged > 0.0 { below / judged } else { 1.0 };
    shown.moving = moving / f64::max(count - still, 1.0);
    shown.rests = found / f64::max(still, 1.0);
    shown
}

/// What many journeys of one kind show.
pub struct Journeys {
    name: String,
    all: Vec<Shown>,
    /// Mean share of valid samples, and of those at which it moved.
    pub valid: f64,
    pub moving: f64,
    /// Of the valid samples at which it moved, those with a NEES below 7.81; and the least of the seeds but for a tenth.
    pub below: f64,
    pub least: f64,
    /// Median of each seed's greatest error in deviations, and the greatest.
    pub worst: f64,
    pub greatest: f64,
    pub off_m: f64,
    /// Medians.
    pub unseen_m: f64,
    pub end_m: f64,
    pub rests: f64,
}

impl Journeys {
    pub fn over(journey: Journey, how: Recorded, seeds: u64) -> Self {
        let all: Vec<Shown> = (0..seeds).map(|seed| travel(journey, how, seed)).collect();
        let sorted = |value: &dyn Fn(&Shown) -> f64| {
            let mut all: Vec<f64> = all.iter().map(value).collect();
            all.sort_by(f64::total_cmp);
            all
        };
        let median = |value: &dyn Fn(&Shown) -> f64| sorted(value)[all.len() / 2];
        let weight: f64 = all.iter().map(|s| s.valid).sum();
        let judged: f64 = all.iter().map(|s| s.judged).sum();
        let below = all.iter().map(|s| s.judged * s.below).sum::<f64>();
        let greatest = all.iter().max_by(|a, b| a.worst.total_cmp(&b.worst));
        let greatest = greatest.copied().unwrap_or_default();
        Self {
            name: format!(
                "{journey:.2?}{}{}{}{}{}",
                if how.gyroscope { ", gyroscope" } else { "" },
                if how.field { "" } else { ", no magnetometer" },
                match how.zupt {
                    Zupt::Assumed => "",
                    Zupt::Stated => ", ZUPT stated",
                    Zupt::Off => ", no ZUPT",
                },
                match (how.fails_s > 0.0, how.hole_s > 0.0, how.jump_s > 0.0) {
                    (true, ..) => format!(", fails {} s", how.fails_s),
                    (_, true, _) => format!(", hole {} s", how.hole_s),
                    (.., true) => format!(", jump {} s", how.jump_s),
                    _ => String::new(),
                },
                if how.begins_s > 0.0 {
                    format!(", begins {} s", how.begins_s)
                } else if how.rate_matrix > 0.0 {
                    format!(", rate {} %", 100.0 * how.rate_matrix)
                } else if how.force_matrix > 0.0 {
                    format!(", force {} %", 100.0 * how.force_matrix)
                } else if how.late_s > 0.0 {
                    format!(", late {} s", how.late_s)
                } else if how.glitch_mps2 != 0.0 {
                    format!(", glitch {}", how.glitch_mps2)
                } else if how.clips_mps2.is_finite() {
                    format!(", clips at {:.0} m/s²", how.clips_mps2)
                } else if how.rate_hz == 100.0 {
                    String::new()
                } else {
                    format!(", {} Hz", how.rate_hz)
                }
            ),
            valid: weight / all.len() as f64,
            moving: all.iter().map(|s| s.moving).sum::<f64>() / all.len() as f64,
            below: if judged > 0.0 { below / judged } else { 1.0 },
            least: sorted(&|s| s.below)[all.len() / 10],
            worst: median(&|s| s.worst),
            greatest: greatest.worst,
            off_m: greatest.off_m,
            unseen_m: median(&|s| s.unseen_m),
            end_m: median(&|s| s.end_m),
            rests: median(&|s| s.rests),
            all,
        }
    }

    /// Journeys on which no valid component is off by more than `deviations`.
    pub fn within(&self, deviations: f64) -> Coverage {
        let all = self.all.iter();
        all.map(|shown| shown.worst <= deviations).collect()
    }

    /// Standard error of `below`: samples of one journey share their errors, journeys do not.
    fn below_se(&self) -> f64 {
        let judged: f64 = self.all.iter().map(|s| s.judged).sum();
        let departs = |s: &Shown| s.judged * (s.below - self.below);
        let squares: f64 = self.all.iter().map(|s| departs(s).powi(2)).sum();
        squares.sqrt() / judged.max(f64::MIN_POSITIVE)
    }

    /// Whether the true share of samples with a NEES below 7.81 can be in `range`: within 4 standard errors.
    pub fn below_can_be(&self, range: RangeInclusive<f64>) -> bool {
        let nearest = self.below.clamp(*range.start(), *range.end());
        (self.below - nearest).abs() <= 4.0 * self.below_se()
    }
}

impl std::fmt::Display for Journeys {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{:<38} valid {:4.0}, moving {:4.0} | below 7.81 {:4.0}, of a seed {:4.0} | {:6.1} {:6.1} sd ({:.3} m) | rests {:3.0} | end {:.3} | unseen {:.2} m",
            self.name,
            100.0 * self.valid,
            100.0 * self.moving,
            100.0 * self.below,
            100.0 * self.least,
            self.worst,
            self.greatest,
            self.off_m,
            100.0 * self.rests,
            self.end_m,
            self.unseen_m
        )
    }
}
