//! Moves between rests, corrected backwards from the rest at the end of each.

use wimu_nav::slide::{Move, Rest, Slide, SlideConfig};

use super::{Choice, InertialPath, Method, PathPoint, quaternion};
use crate::motion::{MotionRecording, RestSpan, median_step_s, rests};
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
/// Least uncertainty of a velocity, m/s.
const FLOOR_MPS: f64 = 0.005;

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

/// The likeliest chain of true rests: each velocity left at one costs its Student density, each that is
/// passed over that of a unit that moves evenly there.
fn agreeing(recording: &MotionRecording, config: SlideConfig, found: &[RestSpan]) -> Vec<usize> {
    let count = found.len();
    // Least cost of a chain that ends at each, and the one before.
    let mut best = vec![(f64::INFINITY, None); count];
    if let Some(first) = best.first_mut() {
        first.0 = 0.0;
    }
    // The chain that ends here, all that looks like rests after it passed over.
    let (mut least, mut end) = (f64::INFINITY, 0);
    for i in 0..count {
        let mut passed = 0.0;
        let last = count.min(i + 1 + AHEAD);
        for j in i + 1..last {
            let (_, done) = integrate(recording, config, found[i], found[j].first, found[j].rest);
            let left = length(done.left_mps);
            let cost = student(left, done.left_sd_mps.max(FLOOR_MPS));
            let whole = best[i].0 + passed + cost;
            if whole < best[j].0 {
                best[j] = (whole, Some(i));
            }
            passed += student(left, EVEN_MPS) + REST_ODDS.ln();
        }
        // Beyond that nobody looks: as many rests would have been found either way.
        if best[i].0 + passed <= least {
            (least, end) = (best[i].0 + passed, i);
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

/// Minus the logarithm of Student's density in space with three degrees of freedom, but for a constant.
fn student(size: f64, sd: f64) -> f64 {
    3.0 * sd.ln() + 3.0 * (size * size / (3.0 * sd * sd)).ln_1p()
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
    let step = |k: usize| recording.times_s[k] - recording.times_s[k - 1];
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
    let north = [
        up[1] * east[2] - up[2] * east[1],
        up[2] * east[0] - up[0] * east[2],
        up[0] * east[1] - up[1] * east[0],
    ];
    [east, north, up]
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

/// Why the path is not known from a leg's end on.
fn broken(recording: &MotionRecording, leg: &Leg) -> Option<String> {
    let at = recording.times_s[leg.after.first.min(recording.times_s.len() - 1)];
    if leg.before.rest.rate_rad_s.is_some() {
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
    let field = |span: &RestSpan| {
        let samples = &recording.samples[span.first..span.end];
        let mut sum = [0.0; 3];
        for value in samples.iter().filter_map(|s| s.field_ut) {
            sum = std::array::from_fn(|i| sum[i] + value[i]);
        }
        sum
    };
    let (a, b) = (field(&leg.before), field(&leg.after));
    let cosine = (0..3).map(|i| a[i] * b[i]).sum::<f64>() / (length(a) * length(b));
    let angle = cosine.clamp(-1.0, 1.0).acos();
    (angle > FIELD_RAD).then(|| {
        format!(
            "the magnetic field turned by {:.1}° in the move that ends at {at:.2} s: the unit did, or the field is disturbed; position is not valid from there on",
            angle.to_degrees()
        )
    })
}

/// The path of a recording, move by move.
pub(super) fn slide(recording: &MotionRecording, choice: &Choice) -> Result<InertialPath> {
    let samples = recording.times_s.len();
    let config = SlideConfig {
        gravity_mps2: recording.gravity_at_first_rest(),
        ..SlideConfig::default()
    };
    let legs = legs(recording, config);
    let Some(first) = legs.first() else {
        return Err(HostError::new(
            ErrorCode::DataRefused,
            "a slide lies between two rests of 0.3 s and more, and there are fewer that agree",
            "hold the unit still before and after each move",
        )
        .at(&recording.name));
    };
    let mut remarks = Vec::new();
    let candidates = rests(&recording.times_s, &recording.samples).len();
    if candidates > legs.len() + 1 {
        remarks.push(format!(
            "{} times it seemed to rest, but the velocity was not zero: even motion",
            candidates - legs.len() - 1
        ));
    }
    let mut points: Vec<PathPoint> = Vec::with_capacity(samples);
    let mut at = [0.0; 3];
    let mut covariance = [[0.0; 3]; 3];
    let mut sound = true;
    let mut axes = level(first.before.rest.force_mps2, [1.0, 0.0, 0.0]);
    let put = |k: usize,
               position_m: [f64; 3],
               velocity_mps: [f64; 3],
               axes: [[f64; 3]; 3],
               rate_rad_s: [f64; 3],
               covariance_m2: [[f64; 3]; 3],
               sound: bool| {
        let mut point = PathPoint {
            time_s: recording.times_s[k],
            position_m,
            velocity_mps,
            quaternion: quaternion(axes),
            rate_rad_s,
            covariance_m2,
            valid: false,
        };
        point.valid = sound && point.sd_m() <= choice.limit_m;
        point
    };
    let still = [0.0; 3];
    for k in 0..first.before.end {
        let begun = k >= first.before.first;
        points.push(put(k, at, still, axes, still, covariance, begun));
    }
    for leg in &legs {
        if let Some(why) = broken(recording, leg) {
            sound = false;
            remarks.push(why);
        }
        let start = Slide::new(config, leg.before.rest);
        for (offset, state) in leg.states.iter().enumerate() {
            let k = leg.before.end + offset;
            let (position, velocity) = state.corrected(&leg.done);
            let way = times(axes, position);
            let own = leg.done.covariance(&start, state, position);
            let rate = match (recording.samples[k].rate_rad_s, leg.before.rest.rate_rad_s) {
                (Some(rate), Some(bias)) => std::array::from_fn(|i| rate[i] - bias[i]),
                _ => still,
            };
            points.push(put(
                k,
                std::array::from_fn(|i| at[i] + way[i]),
                times(axes, velocity),
                product(axes, state.attitude()),
                rate,
                plus(covariance, turned(axes, own)),
                sound,
            ));
        }
        let moved = times(axes, leg.done.displacement_m);
        at = std::array::from_fn(|i| at[i] + moved[i]);
        covariance = plus(covariance, turned(axes, leg.done.covariance_at_end()));
        if let Some(last) = leg.states.last() {
            // Level again by the rest, heading as it was carried there.
            axes = level(leg.after.rest.force_mps2, product(axes, last.attitude())[0]);
        }
        for k in points.len()..leg.after.end {
            points.push(put(k, at, still, axes, still, covariance, sound));
        }
    }
    for k in points.len()..samples {
        points.push(put(k, at, still, axes, still, covariance, false));
    }
    Ok(InertialPath {
        method: Method::Slide,
        points,
        moves: legs.iter().map(|leg| leg.done).collect(),
        remarks,
        nees: Vec::new(),
        rate_nees: Vec::new(),
        velocity_nees: Vec::new(),
    })
}
