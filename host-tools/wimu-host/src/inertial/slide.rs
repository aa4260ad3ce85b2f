//! Moves between rests, corrected backwards from the rest at the end of each.

use wimu_nav::slide::{Move, Rest, Slide, SlideConfig};

use super::origin::measured_from;
use super::{Choice, InertialPath, Method, PathPoint, SlideMove, Zupt};
use crate::finding::{Finding, FindingCode};
use crate::motion::{MotionRecording, RestSpan, gap_s, median_step_s, rests};
use crate::plural::counted;
use crate::{ErrorCode, HostError, Result};

/// Without an angular rate a move that ends at another tilt is no slide, rad.
const TURNED_RAD: f64 = 0.02;
/// With one, gravity may be left unexplained by this angle, rad.
const OPEN_RAD: f64 = 0.1;
/// Without an angular rate a field that turns by this shows a turn about the vertical, rad.
const FIELD_RAD: f64 = 0.15;
/// What looks like rests is looked at this far ahead.
const AHEAD: usize = 20;
/// Speed that a unit may have where it seems to rest and does not, m/s.
const EVEN_MPS: f64 = 1.0;
/// Odds that what looks like a rest is one.
const REST_ODDS: f64 = 20.0;
/// Degrees of freedom of what a velocity left could be.
const FREEDOM: f64 = 10.0;
/// Least uncertainty of a velocity, m/s.
const FLOOR_MPS: f64 = 0.005;
/// A velocity left of so many deviations may not show beside what was left.
const UNSEEN: f64 = 5.0;
/// What a push at a rest that would not show gives, m/s² beside what is not known of its force, and for how long, s.
const PUSH_MPS2: f64 = 0.005;
const PUSH_S: f64 = 2.0;
/// Gravity at two rests of a slide differs by this in the body, m/s², ...
const LEVEL_MPS2: f64 = 0.03;
/// ... and with an angular rate by this share of the angle turned more.
const RATE_SCALE: f64 = 0.02;
/// Minus the logarithm of the odds that a slide ends at another tilt.
const TILTED: f64 = 25.0;
/// From this on a tilt may be an acceleration that rose softly.
const SOFT: f64 = 2.0;
/// What looks like a rest before the first one or after the last lasts so long, s.
const OUTSIDE_S: f64 = 0.3;

/// A move between two rests.
#[derive(Clone, Debug)]
pub struct Leg {
    /// The rest that it begins at.
    pub before: RestSpan,
    /// The rest that it ends at.
    pub after: RestSpan,
    /// The move.
    pub done: Move,
    /// The integration at each sample from `before.end` to `after.first`.
    pub states: Vec<Slide>,
}

impl Leg {
    /// The way between two samples of it, m, axes of the body at its start, and its covariance, m². `None`
    /// for a leg without samples.
    pub fn way(&self, from: usize, to: usize) -> Option<([f64; 3], [[f64; 3]; 3])> {
        let at = |k: usize| {
            let k = k.saturating_sub(self.before.end);
            self.states.get(k).or(self.states.last())
        };
        let (a, b) = (at(from)?, at(to)?);
        let (p, q) = (a.corrected(&self.done).0, b.corrected(&self.done).0);
        let way = std::array::from_fn(|i| q[i] - p[i]);
        Some((way, self.done.covariance(a, b, way)))
    }
}

/// The moves of a recording. Of what looks like rests those are taken that agree: between two rests
/// velocity must come back to zero within its uncertainty.
pub fn legs(recording: &MotionRecording, config: SlideConfig) -> Vec<Leg> {
    let found = rests(&recording.times_s, &recording.samples);
    let chain = agreeing(recording, config, &found);
    chain
        .windows(2)
        .map(|pair| leg(recording, config, found[pair[0]], found[pair[1]]))
        .collect()
}

/// The likeliest chain of true rests: each velocity left at one and each change of gravity costs, and so
/// does each that is passed over: the unit moves evenly there, or is accelerated evenly.
fn agreeing(recording: &MotionRecording, config: SlideConfig, found: &[RestSpan]) -> Vec<usize> {
    let count = found.len();
    let lasts = |i: usize| {
        let (first, last) = (found[i].first, found[i].end.max(1) - 1);
        recording.times_s[last] - recording.times_s[first]
    };
    // What lies before or after the chain is not known, and says nothing of velocities.
    let outside = |i: usize| REST_ODDS.ln() + lasts(i) / OUTSIDE_S;
    let mut after: f64 = (0..count).map(outside).sum();
    let mut before = 0.0;
    // Least cost of a chain that ends at each, and the one before.
    let mut best = Vec::with_capacity(count);
    for i in 0..count {
        best.push((before, None));
        before += outside(i);
    }
    let (mut least, mut end) = (f64::INFINITY, 0);
    for i in 0..count {
        let mut passed = 0.0;
        let last = count.min(i + 1 + AHEAD);
        for j in i + 1..last {
            let (rest, next) = (found[i], found[j]);
            // What happened in a gap is not known: it says nothing for or against a rest after it.
            if gap(recording, rest.end, next.first).is_some() {
                if best[i].0 + passed < best[j].0 {
                    best[j] = (best[i].0 + passed, Some(i));
                }
                break;
            }
            let Leg { states, done, .. } = leg(recording, config, rest, next);
            let left = length(done.left_mps);
            let sd = done.left_sd_mps.max(FLOOR_MPS);
            let tilt = tilted(config, rest, next, &done);
            let whole = best[i].0 + passed + student(left, sd) + tilt;
            if whole < best[j].0 {
                best[j] = (whole, Some(i));
            }
            let speeds = states.iter().map(|s| length(s.velocity_mps()));
            let speed = speeds.fold(0.0, f64::max);
            passed += passing(&done, speed, tilt) + gained(&done, lasts(j));
        }
        after -= outside(i);
        if best[i].0 + after <= least {
            (least, end) = (best[i].0 + after, i);
        }
    }
    let mut chain = vec![end];
    while let Some(before) = best.get(end).and_then(|b| b.1) {
        chain.push(before);
        end = before;
    }
    chain.reverse();
    chain
}

/// Minus the logarithm of the density of the velocity left where what looks like a rest is none, after a way
/// with speeds up to `speed`: even motion that fast, or an acceleration that rose softly to what looks like a
/// tilt.
fn passing(done: &Move, speed: f64, tilt: f64) -> f64 {
    let left = length(done.left_mps);
    let even = student(left, speed.clamp(FLOOR_MPS, EVEN_MPS)) + REST_ODDS.ln();
    let rise = length(done.change_mps2) * done.duration_s;
    let soft = tilt > SOFT && speed < rise + FLOOR_MPS;
    if soft {
        even.min(student(left, rise / 3.0 + FLOOR_MPS))
    } else {
        even
    }
}

/// The same of the velocity that it then gains while it looks like a rest for so long, s.
fn gained(done: &Move, lasts_s: f64) -> f64 {
    let gained = length(done.change_mps2) * lasts_s / EVEN_MPS;
    3.0 * (gained * gained / 3.0).ln_1p()
}

/// Minus the logarithm of the odds of the change of gravity between two rests: what the unit turned by and
/// its bias explain, or else it ended at another tilt, which a slide hardly does.
fn tilted(config: SlideConfig, before: RestSpan, after: RestSpan, done: &Move) -> f64 {
    let turned = if before.rest.rate_rad_s.is_some() {
        done.turned_rad
    } else {
        0.0
    };
    let sd = [
        LEVEL_MPS2,
        before.rest.sd_mps2,
        after.rest.sd_mps2,
        RATE_SCALE * turned * config.gravity_mps2,
        2.0 * config.bias_mps2 * (0.5 * turned.min(std::f64::consts::PI)).sin(),
    ];
    let variance = sd.iter().map(|s| s * s).sum::<f64>();
    let change = length(done.change_mps2);
    (0.5 * change * change / variance).min(TILTED)
}

/// The longest gap between a rest's end and the first sample of the next, s.
fn gap(recording: &MotionRecording, end: usize, next: usize) -> Option<f64> {
    let times = &recording.times_s;
    let steps = (end.max(1)..=next.min(times.len().max(1) - 1)).map(|k| times[k] - times[k - 1]);
    let longest = steps.fold(0.0, f64::max);
    (longest > gap_s(times)).then_some(longest)
}

/// Minus the logarithm of Student's density in space, but for a constant: deviations are known that well.
fn student(size: f64, sd: f64) -> f64 {
    let ratio = size * size / (FREEDOM * sd * sd);
    3.0 * sd.ln() + 0.5 * (FREEDOM + 3.0) * ratio.ln_1p()
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|c| c * c).sum::<f64>().sqrt()
}

fn integrate(
    recording: &MotionRecording,
    config: SlideConfig,
    before: RestSpan,
    to: usize,
    after: Rest,
) -> (Vec<Slide>, Move) {
    // Nobody knows what happened in a gap: nothing is made up for it.
    let most = gap_s(&recording.times_s);
    let step = |k: usize| {
        let step = recording.times_s[k] - recording.times_s[k - 1];
        if step > most { 0.0 } else { step }
    };
    run(recording, config, before, to, after, &step)
}

fn run(
    recording: &MotionRecording,
    config: SlideConfig,
    before: RestSpan,
    to: usize,
    after: Rest,
    step: &dyn Fn(usize) -> f64,
) -> (Vec<Slide>, Move) {
    let mut slide = Slide::new(config, before.rest);
    let mut states = Vec::new();
    for k in before.end..to.max(before.end) {
        let sample = &recording.samples[k];
        slide.push(step(k), sample.force_mps2, sample.rate_rad_s);
        states.push(slide);
    }
    (states, slide.finish(after))
}

/// Times may be those of arrival: where they are uneven, samples at even times are the other reading.
/// The one whose velocity comes back better is taken, the other is doubt.
fn leg(recording: &MotionRecording, config: SlideConfig, before: RestSpan, after: RestSpan) -> Leg {
    let (states, done) = integrate(recording, config, before, after.first, after.rest);
    let period = median_step_s(&recording.times_s);
    let from = before.end.max(1);
    let uneven = (from..after.first)
        .any(|k| (recording.times_s[k] - recording.times_s[k - 1] - period).abs() > 0.3 * period);
    let (mut states, mut done) = (states, done);
    if uneven {
        let even = |_: usize| period;
        let (others, other) = run(recording, config, before, after.first, after.rest, &even);
        let cost = |m: &Move| student(length(m.left_mps), m.left_sd_mps.max(FLOOR_MPS));
        let share = 1.0 / (1.0 + (cost(&other) - cost(&done)).clamp(-50.0, 50.0).exp());
        let apart = std::array::from_fn(|i| other.displacement_m[i] - done.displacement_m[i]);
        if share > 0.5 {
            (states, done) = (others, other);
        }
        done = done.doubted(apart, share * (1.0 - share));
    }
    Leg {
        before,
        after,
        done,
        states,
    }
}

/// Rows are the navigation axes in the body: up from a rest, east as near to `east` as it goes.
fn level(force_mps2: [f64; 3], east: [f64; 3]) -> [[f64; 3]; 3] {
    let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| a[i] * b[i]).sum::<f64>();
    let up = force_mps2.map(|f| f / length(force_mps2));
    let part = |v: [f64; 3]| -> [f64; 3] { std::array::from_fn(|i| v[i] - dot(v, up) * up[i]) };
    let mut east = part(east);
    if length(east) < 0.1 {
        east = part([0.0, 1.0, 0.0]);
    }
    let east = east.map(|e| e / length(east));
    [east, cross(up, east), up]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        a[j] * b[k] - a[k] * b[j]
    })
}

fn times(m: [[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    m.map(|row| (0..3).map(|i| row[i] * v[i]).sum())
}

fn product(a: [[f64; 3]; 3], b: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    a.map(|row| std::array::from_fn(|j| (0..3).map(|k| row[k] * b[k][j]).sum()))
}

/// A P Aᵀ.
fn turned(a: [[f64; 3]; 3], p: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let transposed = std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]));
    product(product(a, p), transposed)
}

fn plus(a: [[f64; 3]; 3], b: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| a[i][j] + b[i][j]))
}

/// Why the path is not known from within a leg on.
fn broken(recording: &MotionRecording, leg: &Leg) -> Option<String> {
    let at = recording.times_s[leg.after.first.min(recording.times_s.len() - 1)];
    if let Some(gap) = gap(recording, leg.before.end, leg.after.first) {
        return Some(format!(
            "a gap of {gap:.2} s before the rest at {at:.2} s: position is not valid from there on"
        ));
    }
    if leg.before.rest.rate_rad_s.is_some() {
        let samples = &recording.samples[leg.before.end..leg.after.first.max(leg.before.end)];
        if samples.iter().any(|s| s.rate_rad_s.is_none()) {
            return Some(format!(
                "the angular rate is missing in the move that ends at {at:.2} s: position is not valid from there on"
            ));
        }
        return (leg.done.open_rad > OPEN_RAD).then(|| {
            format!(
                "the angular rate leaves {:.1}° of the turn in the move that ends at {at:.2} s unexplained: position is not valid from there on",
                leg.done.open_rad.to_degrees()
            )
        });
    }
    if leg.done.turned_rad > TURNED_RAD {
        return Some(format!(
            "the unit turned by {:.1}° in the move that ends at {at:.2} s: no slide, position is not valid from there on",
            leg.done.turned_rad.to_degrees()
        ));
    }
    let a = field_at(recording, &leg.before)?;
    let b = field_at(recording, &leg.after)?;
    let cosine = (0..3).map(|i| a[i] * b[i]).sum::<f64>() / (length(a) * length(b));
    let angle = cosine.clamp(-1.0, 1.0).acos();
    (angle > FIELD_RAD).then(|| {
        format!(
            "the magnetic field turned by {:.1}° in the move that ends at {at:.2} s: the unit did, or the field is disturbed; position is not valid from there on",
            angle.to_degrees()
        )
    })
}

/// Of the rotation whose rows are given, W X Y Z.
fn quaternion([[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]]: [[f64; 3]; 3]) -> [f64; 4] {
    let size = |v: f64| (v.max(0.0)).sqrt() / 2.0;
    let w = size(1.0 + xx + yy + zz);
    [
        w,
        size(1.0 + xx - yy - zz).copysign(zy - yz),
        size(1.0 - xx + yy - zz).copysign(xz - zx),
        size(1.0 - xx - yy + zz).copysign(yx - xy),
    ]
}

/// A magnetic field shorter than this says nothing of north, µT.
const WEAK_UT: f64 = 1.0;

/// Mean magnetic field at a rest, µT, body axes, where there is one.
pub(super) fn field_at(recording: &MotionRecording, rest: &RestSpan) -> Option<[f64; 3]> {
    let fields = recording.samples[rest.first..rest.end]
        .iter()
        .filter_map(|s| s.field_ut);
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for field in fields {
        sum = std::array::from_fn(|i| sum[i] + field[i]);
        count += 1.0;
    }
    let mean = sum.map(|b| b / f64::max(count, 1.0));
    (length(mean) > WEAK_UT).then_some(mean)
}

/// East in the body at the first rest: that of the magnetic field, or x.
fn east(recording: &MotionRecording, rest: &RestSpan, findings: &mut Vec<Finding>) -> [f64; 3] {
    let up = rest.rest.force_mps2;
    if let Some(field) = field_at(recording, rest) {
        let east = cross(field, up);
        if length(east) > 0.05 * length(field) * length(up) {
            return east.map(|e| e / length(east));
        }
        let text = "the magnetic field is upright: east is body x, levelled, at the first rest";
        findings.push(FindingCode::MagneticField.warning(text));
    } else {
        let why = recording.without_field();
        let text = format!("{why}: east is body x, levelled, at the first rest");
        findings.push(FindingCode::Navigation.note(text));
    }
    [1.0, 0.0, 0.0]
}

/// Covariance of a unit that may have moved evenly for so long, m².
fn astray(covariance: [[f64; 3]; 3], for_s: f64) -> [[f64; 3]; 3] {
    let way = EVEN_MPS * for_s;
    let mut more = covariance;
    for (i, row) in more.iter_mut().enumerate() {
        row[i] += way * way;
    }
    more
}

/// Second moments of the velocity of an axis that was taken for zero, and of the way that it went: equation (103).
#[derive(Clone, Copy, Debug, Default)]
struct Even {
    speed2: f64,
    both: f64,
    way2: f64,
}

impl Even {
    fn goes_on(&mut self, step_s: f64) {
        self.way2 += step_s * (2.0 * self.both + step_s * self.speed2);
        self.both += step_s * self.speed2;
    }

    /// At a rest a weak push would not have shown.
    fn pushed(&mut self, rest: &Rest) {
        let speed = PUSH_S * PUSH_MPS2.hypot(rest.sd_mps2);
        self.speed2 = self.speed2.max(speed * speed);
    }

    /// What a move has left was taken for an error of its own.
    fn arrived(&mut self, done: &Move) {
        let left = length(done.left_mps);
        self.speed2 += left * left / 3.0 + done.left_sd_mps * done.left_sd_mps;
    }

    /// Of a move that begins with it: its own way, and what is left, which came in on the way.
    fn of(&self, done: &Move) -> f64 {
        let left = length(done.left_mps).hypot(done.left_sd_mps);
        done.duration_s * (self.speed2 + left * left / 3.0).sqrt()
    }
}

/// The path of a recording, move by move.
pub(super) fn slide(recording: &MotionRecording, choice: &Choice) -> Result<InertialPath> {
    if !choice.zupt.is_on() {
        return Err(HostError::new(
            ErrorCode::Usage,
            "a slide lies between two rests: without zero velocity there it is not corrected",
            "leave --zupt off out, or use --method tilt or strapdown",
        ));
    }
    let config = SlideConfig {
        gravity_mps2: recording.gravity_mps2(),
        bias_mps2: recording.bias_mps2(),
        ..SlideConfig::default()
    };
    let legs = legs(recording, config);
    let Some(first) = legs.first() else {
        return Err(HostError::new(
            ErrorCode::DataRefused,
            "a slide lies between two rests of 0.3 s and more, and there are fewer that agree",
            "hold the unit still before and after each move; without an angular rate it must not turn",
        )
        .at(&recording.name));
    };
    let mut findings = Vec::new();
    let candidates = rests(&recording.times_s, &recording.samples).len();
    if candidates > legs.len() + 1 {
        findings.push(FindingCode::Navigation.warning(format!(
            "{} it seemed to rest, but its velocity was not zero, or gravity was another: even motion, \
             an even acceleration, or it turned",
            counted(candidates - legs.len() - 1, "time")
        )));
    }
    let east = east(recording, &first.before, &mut findings);
    let mut track = Track {
        recording,
        limit_m: choice.limit_m,
        assumed: choice.zupt == Zupt::Assumed,
        even: Even::default(),
        points: Vec::with_capacity(recording.times_s.len()),
        at: [0.0; 3],
        covariance: [[0.0; 3]; 3],
        sound: false,
        lost_s: 0.0,
        unseen_mps: 0.0,
        axes: level(first.before.rest.force_mps2, east),
    };
    track.rest(first.before.first);
    track.sound = true;
    track.rest(first.before.end);
    track.even = Even::default();
    track.even.pushed(&first.before.rest);
    let origin = first.before.first..first.before.end;
    let speed = match choice.zupt {
        Zupt::Assumed => track.even.speed2.sqrt(),
        _ => 0.0,
    };
    let origin = measured_from(&mut track.points, &origin, [speed; 3], choice.limit_m);
    let mut moves = Vec::new();
    for leg in &legs {
        if let Some(why) = broken(recording, leg) {
            track.sound = false;
            findings.push(FindingCode::Navigation.warning(why));
        }
        moves.push(SlideMove {
            done: leg.done,
            from_s: recording.times_s[leg.before.end.max(1) - 1],
            to_s: recording.times_s[leg.after.first],
            unseen_m: track.even.of(&leg.done),
            valid: track.sound,
        });
        track.go(config, leg);
        track.rest(leg.after.end);
    }
    // What comes after the last rest is not known.
    track.sound = false;
    track.stray();
    Ok(InertialPath {
        moves,
        findings,
        ..InertialPath::new(Method::Slide, track.points, origin, choice.limit_m)
    })
}

/// The path as it grows.
struct Track<'a> {
    recording: &'a MotionRecording,
    limit_m: f64,
    /// Whether the covariance holds what even motion could have hidden.
    assumed: bool,
    even: Even,
    points: Vec<PathPoint>,
    at: [f64; 3],
    covariance: [[f64; 3]; 3],
    sound: bool,
    /// For how long it has moved so that its way is not known, s.
    lost_s: f64,
    /// The speed that would not have shown at the rest, m/s.
    unseen_mps: f64,
    /// Navigation axes in the body, rows.
    axes: [[f64; 3]; 3],
}

impl Track<'_> {
    fn put(
        &mut self,
        position_m: [f64; 3],
        velocity_mps: [f64; 3],
        axes: [[f64; 3]; 3],
        rate_rad_s: [f64; 3],
        covariance_m2: [[f64; 3]; 3],
        resting: bool,
    ) {
        let (k, times_s) = (self.points.len(), &self.recording.times_s);
        if k > 0 {
            self.even.goes_on(times_s[k] - times_s[k - 1]);
        }
        let mut covariance_m2 = astray(covariance_m2, self.lost_s);
        if self.assumed {
            for (i, row) in covariance_m2.iter_mut().enumerate() {
                row[i] += self.even.way2;
            }
        }
        let mut point = PathPoint {
            time_s: times_s[k],
            position_m,
            velocity_mps,
            quaternion: quaternion(axes),
            rate_rad_s,
            velocity_sd_mps: [0.0; 3],
            attitude_sd_rad: [0.0; 3],
            covariance_m2,
            resting,
            unseen_mps: resting.then_some(self.unseen_mps),
            unseen_m: (3.0 * self.even.way2).sqrt(),
            valid: false,
        };
        point.valid = self.sound && point.sd_m() <= self.limit_m;
        self.points.push(point);
    }

    /// At rest up to this sample.
    fn rest(&mut self, to: usize) {
        while self.points.len() < to {
            let (at, axes, covariance) = (self.at, self.axes, self.covariance);
            self.put(at, [0.0; 3], axes, [0.0; 3], covariance, true);
        }
    }

    /// To the recording's end, without knowing where.
    fn stray(&mut self) {
        let times = &self.recording.times_s;
        while self.points.len() < times.len() {
            let k = self.points.len();
            self.lost_s += times[k] - times[k.max(1) - 1];
            let (at, axes, covariance) = (self.at, self.axes, self.covariance);
            self.put(at, [0.0; 3], axes, [0.0; 3], covariance, false);
        }
    }

    /// Through a move.
    fn go(&mut self, config: SlideConfig, leg: &Leg) {
        let times_s = &self.recording.times_s;
        let start = Slide::new(config, leg.before.rest);
        let axes = self.axes;
        for (offset, state) in leg.states.iter().enumerate() {
            let k = leg.before.end + offset;
            if !self.sound {
                self.lost_s += times_s[k] - times_s[k.max(1) - 1];
            }
            let (position, velocity) = state.corrected(&leg.done);
            let way = times(axes, position);
            let own = leg.done.covariance(&start, state, position);
            let rate = match (
                self.recording.samples[k].rate_rad_s,
                leg.before.rest.rate_rad_s,
            ) {
                (Some(rate), Some(bias)) => std::array::from_fn(|i| rate[i] - bias[i]),
                _ => [0.0; 3],
            };
            self.put(
                std::array::from_fn(|i| self.at[i] + way[i]),
                times(axes, velocity),
                product(axes, state.attitude()),
                rate,
                plus(self.covariance, turned(axes, own)),
                false,
            );
        }
        if !self.sound {
            let k = leg.after.first;
            self.lost_s += times_s[k] - times_s[k.max(1) - 1];
        }
        self.even.arrived(&leg.done);
        self.even.pushed(&leg.after.rest);
        let left = length(leg.done.left_mps);
        self.unseen_mps = UNSEEN * leg.done.left_sd_mps.max(FLOOR_MPS) + left;
        let moved = times(axes, leg.done.displacement_m);
        self.at = std::array::from_fn(|i| self.at[i] + moved[i]);
        self.covariance = plus(self.covariance, turned(axes, leg.done.covariance_at_end()));
        if let Some(last) = leg.states.last() {
            // Level again by the rest, heading as it was carried there.
            self.axes = level(leg.after.rest.force_mps2, product(axes, last.attitude())[0]);
        }
    }
}
