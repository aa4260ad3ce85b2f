//! Whether a recording can be what it says it is: gravity, and axes that go on.

use std::ops::Range;

use nalgebra::Vector3;

use super::unit::median_step_s;
use crate::digits::significant;
use crate::imu::{Imu, Sample};
use crate::plural::counted;
use crate::stats::median;
use crate::{Code, Problem, Result};

/// What a rest shows is gravity within this share.
const NEAR: f64 = 0.1;
/// Beyond this share an accelerometer is not calibrated.
const CALIBRATED: f64 = 0.02;
/// |f| of a whole recording is, in the median, gravity within this factor.
const FAR: f64 = 3.0;
/// An axis that gives one value for so long, s, and in so many samples, ...
const STUCK_S: f64 = 1.0;
const STUCK_SAMPLES: usize = 50;
/// ... while both others change, and one by more than this, is dead: m/s², rad/s.
const MOVES_MPS2: f64 = 1.0;
const MOVES_RAD_S: f64 = 0.3;
/// A gyroscope that gives one value while gravity or the magnetic field, as large as before within this share,
/// turns by more than this, rad: 20°, is dead.
const AS_LARGE: f64 = 0.02;
const TURNED_RAD: f64 = 0.35;

/// Steps that a recording to navigate may have, s: beyond these its times are in another unit.
const STEPS_S: std::ops::Range<f64> = 2e-5..0.25;
/// Units of time and how many of them are a second.
const TIME_UNITS: [(&str, f64); 4] = [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)];
/// Steps that are usual, s.
const USUAL_S: std::ops::Range<f64> = 2e-4..0.1;
/// Of gravity, along z: face down.
const FACE_DOWN: f64 = -0.7;
/// Of the magnetic field, along gravity: it dips.
const DIPS: f64 = 0.2;

/// Full scales of accelerometers, *g*; a value this near to one, as a share of it, ...
const SCALES_G: [f64; 5] = [2.0, 4.0, 8.0, 16.0, 32.0];
const AT_SCALE: f64 = 0.03;
/// ... that is an axis's largest and comes so often is where it clips.
const CLIPS: usize = 3;

/// A slow magnetometer's reading may be held for so long, s.
const HELD_S: f64 = 3.0;
/// An axis that repeats itself is dead where the others' noise is more than so many of its steps: it would show.
const NOISY_STEPS: f64 = 2.0;

/// What a sensor gives in a sample.
type Sense = fn(&Sample) -> Option<Vector3<f64>>;

/// What was found.
#[derive(Clone, Debug, Default)]
pub(super) struct Senses {
    /// From this sample on an axis of the accelerometer is dead.
    pub force_ends: Option<usize>,
    /// The same of the angular rate.
    pub rate_ends: Option<usize>,
    /// The same of the magnetometer.
    pub field_ends: Option<usize>,
    /// Samples at which the accelerometer clips.
    pub clipped: Vec<usize>,
    /// Standard deviation of the accelerometer's bias, m/s².
    pub bias_mps2: f64,
    /// Whether |f| at rest departs from gravity by more than that of a calibrated accelerometer.
    pub uncalibrated: bool,
    pub findings: Vec<Problem>,
}

impl Senses {
    /// Looks at a recording.
    ///
    /// # Errors
    /// `data_refused` where what it shows at rest is not gravity.
    pub fn of(recording: &Imu) -> Result<Self> {
        steps(recording)?;
        let rest = gravity(recording)?;
        let standard = wimu_model::STANDARD_GRAVITY_MPS2;
        // What it shows beyond gravity along one axis it may show along any.
        let known = recording.bias_mps2();
        let mut senses = Self {
            bias_mps2: rest.map_or(known, |rest| known.hypot(rest - standard)),
            ..Self::default()
        };
        if let Some(rest) = rest
            && (rest / standard - 1.0).abs() > CALIBRATED
        {
            senses.uncalibrated = true;
            let remedy = if recording.covariance.is_some() {
                "the calibration does not fit: give that of this sensor, or calibrate it again"
            } else {
                "run `wimu calibrate FILE -o CAL.json`, then add --with CAL.json"
            };
            let percent = 100.0 * (rest / standard - 1.0);
            let text = format!("at rest it shows {rest:.2} m/s², {percent:+.1} % from gravity");
            senses.findings.push(Code::Uncalibrated.warning(text).remedy(remedy));
        }
        let face_down = face_down(recording).map(|text| Code::Axes.warning(text));
        senses.findings.extend(face_down);
        senses.clipped = clipped(&recording.samples.v);
        if let Some(first) = senses.clipped.first() {
            senses.findings.push(Code::Saturated.warning(format!(
                "the accelerometer clips in {}, first at {:.2} s: what it felt there is not \
                 known; take a larger range",
                counted(senses.clipped.len(), "sample"),
                recording.samples.t[*first].s()
            )));
        }
        let force = |k: usize| Some(recording.samples.v[k].force_mps2);
        let rate = |k: usize| recording.samples.v[k].rate_rad_s;
        if let Some((from, axis)) = stuck(recording, force, MOVES_MPS2) {
            senses.say(
                recording,
                "accelerometer",
                from,
                axis,
                "position is not valid from there on",
            );
            senses.force_ends = Some(from);
        }
        if let Some((from, axis)) = stuck(recording, rate, MOVES_RAD_S) {
            senses.say(recording, "gyroscope", from, axis, "it is left out from there on");
            senses.rate_ends = Some(from);
        }
        let shown: [Sense; 2] = [|s| Some(s.force_mps2), |s| s.field_ut];
        if let Some(from) = silent(recording, |s| s.field_ut, HELD_S, &shown[..1]) {
            senses.findings.push(Code::Frozen.warning(format!(
                "the magnetometer gives one and the same value from {:.2} s on while gravity turns: it is left out from \
                 there on",
                recording.samples.t[from].s()
            )));
            senses.field_ends = Some(from);
        }
        if let Some(from) = silent(recording, |s| s.rate_rad_s, STUCK_S, &shown) {
            senses.findings.push(Code::Frozen.warning(format!(
                "all axes of the gyroscope give one and the same value from {:.2} s on while gravity or the field \
                 turns: it is left out from there on",
                recording.samples.t[from].s()
            )));
            senses.rate_ends = Some(senses.rate_ends.map_or(from, |before| before.min(from)));
        }
        Ok(senses)
    }

    fn say(&mut self, of: &Imu, sensor: &str, from: usize, axis: usize, so: &str) {
        let (axis, at) = (["X", "Y", "Z"][axis], of.samples.t[from].s());
        self.findings.push(Code::Frozen.warning(format!(
            "{sensor} {axis} gives one and the same value from {at:.2} s on while others change: {so}"
        )));
    }
}

/// Whether times go on as those of samples do.
fn steps(recording: &Imu) -> Result<()> {
    let step_s = median_step_s(&recording.times_s());
    if recording.samples.len() < 3 || STEPS_S.contains(&step_s) || step_s <= 0.0 {
        return Ok(());
    }
    // The unit that was named is not known here: what was read as seconds may be any other.
    let fits = |(_, a_second): &&(&str, f64)| USUAL_S.contains(&(step_s / a_second));
    let remedy = if step_s < STEPS_S.start {
        "see that the unit of its times is right: `Time (s)`, `Time (ms)`, `Time (us)` or `Time (ns)`".to_owned()
    } else {
        match TIME_UNITS.iter().find(fits) {
            Some((unit, _)) => format!("are its times in {unit}? Name the column `Time ({unit})`"),
            None => "record ten samples a second and more".to_owned(),
        }
    };
    Err(Code::DataRefused
        .error(
            format!(
                "its samples are {} s apart: no position is found from those",
                significant(step_s, 3)
            ),
            remedy,
        )
        .at(&recording.name))
}

/// What to say where z points down at the start: an accelerometer that gives gravity instead of specific force shows
/// the same lying face up.
fn face_down(recording: &Imu) -> Option<String> {
    let end = recording.samples.t.first()?.after_s(1.0);
    let second = &recording.samples.v[..recording.samples.t.partition_point(|t| *t < end)];
    let force: Vector3<f64> = second.iter().map(|s| s.force_mps2).sum();
    let field: Vector3<f64> = second.iter().filter_map(|s| s.field_ut).sum();
    if force[2] > FACE_DOWN * force.norm() {
        return None;
    }
    let along = force.dot(&field) / (force.norm() * field.norm());
    let shown = if along > DIPS {
        "; the magnetic field points up then, as it does south of the equator only"
    } else if along < -DIPS {
        "; the magnetic field points down then, as it does north of the equator only"
    } else {
        ""
    };
    Some(format!(
        "its z axis points down at the start{shown}. An accelerometer shows +9.81 m/s² on z face up: if it lay so, turn the \
         signs of all three axes, or the path is mirrored"
    ))
}

/// Samples at an axis's full scale, where it comes there more than once.
pub(super) fn clipped(samples: &[Sample]) -> Vec<usize> {
    let mut found = Vec::new();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let at = |k: usize| sign * samples[k].force_mps2[axis];
            let most = (0..samples.len()).map(at).fold(0.0, f64::max);
            let scales = SCALES_G.map(|g| g * wimu_model::STANDARD_GRAVITY_MPS2);
            if !scales.iter().any(|s| (most / s - 1.0).abs() < AT_SCALE) {
                continue;
            }
            let there: Vec<usize> = (0..samples.len()).filter(|k| at(*k) == most).collect();
            if there.len() >= CLIPS && there.windows(2).any(|w| w[1] == w[0] + 1) {
                found.extend(there);
            }
        }
    }
    found.sort_unstable();
    found.dedup();
    found
}

/// |f| in the first quiet second in which it may be gravity, m/s²; `None` without such a second.
fn gravity(recording: &Imu) -> Result<Option<f64>> {
    let standard = wimu_model::STANDARD_GRAVITY_MPS2;
    let Some(median) = median(recording.samples.v.iter().map(|s| s.force_mps2.norm())) else {
        return Ok(None);
    };
    let still: Vec<f64> = recording.still_seconds().into_iter().map(|(_, mean)| mean).collect();
    let refused = |seen: f64| {
        let remedy = if (seen - 1.0).abs() < NEAR {
            "1 at rest is g: name the columns `Accelerometer X (g)`, …"
        } else {
            "see that the unit in the columns' names is right, and that the accelerometer works"
        };
        Err(Code::DataRefused
            .error(
                format!("its accelerometer shows {seen:.2} m/s² where gravity should be"),
                remedy,
            )
            .at(&recording.name))
    };
    let near = |seen: &f64| (seen / standard - 1.0).abs() < NEAR;
    if !(standard / FAR..standard * FAR).contains(&median) {
        return refused(median);
    }
    match (still.iter().find(|seen| near(seen)), still.first()) {
        (None, Some(first)) => refused(*first),
        (found, _) => Ok(found.copied()),
    }
}

/// The sample from which on all axes of a sensor stand still for so long, s, and more while one of the others shows that
/// the unit turns.
fn silent(recording: &Imu, sense: Sense, longer_s: f64, others: &[Sense]) -> Option<usize> {
    let (times_s, samples) = (&recording.times_s(), &recording.samples.v);
    let mut first = 0;
    while let Some(next) = samples[first..].iter().position(|s| sense(s).is_some()) {
        first += next;
        let here = sense(&samples[first]);
        let alike = samples[first..].iter();
        let count = alike.take_while(|s| sense(s).is_none() || sense(s) == here).count();
        let times_s = &times_s[first..first + count];
        let run = &samples[first..first + count];
        if times_s[count - 1] - times_s[0] >= longer_s
            && count >= STUCK_SAMPLES
            && others.iter().any(|other| is_turned(times_s, run, other))
        {
            return Some(first);
        }
        first += count;
    }
    None
}

/// Whether the mean of a second is turned against that of the first, and as large.
fn is_turned(
    times_s: &[f64],
    samples: &[Sample],
    vector: impl Fn(&Sample) -> Option<Vector3<f64>>,
) -> bool {
    let (mut first, mut from) = (None, 0);
    while from < samples.len() {
        let to = times_s.partition_point(|t| *t < times_s[from] + 1.0).max(from + 1);
        let vectors: Vec<Vector3<f64>> = samples[from..to].iter().filter_map(&vector).collect();
        from = to;
        if vectors.is_empty() {
            continue;
        }
        let mean = vectors.iter().sum::<Vector3<f64>>() / vectors.len() as f64;
        let before: Vector3<f64> = *first.get_or_insert(mean);
        let is_as_large = (mean.norm() / before.norm() - 1.0).abs() < AS_LARGE;
        if is_as_large && before.angle(&mean) > TURNED_RAD {
            return true;
        }
    }
    false
}

/// The sample and axis at which one stands still to the end of a long run while others change.
fn stuck(
    recording: &Imu,
    value: impl Fn(usize) -> Option<Vector3<f64>>,
    moves: f64,
) -> Option<(usize, usize)> {
    let count = recording.samples.len();
    let mut found: Option<(usize, usize)> = None;
    // Of an axis that never moves, that of the others.
    let steps = [0, 1, 2].map(|axis| least_step(count, &value, axis));
    let finest = steps.into_iter().fold(f64::INFINITY, f64::min);
    for axis in 0..3 {
        let step = if steps[axis].is_finite() { steps[axis] } else { finest };
        let mut first = 0;
        while first < count {
            let mut end = first + 1;
            let here = value(first);
            let (mut low, mut high) = (here.unwrap_or_default(), here.unwrap_or_default());
            while let (Some(here), true) = (here, end < count) {
                let Some(next) = value(end).filter(|next| next[axis] == here[axis]) else {
                    break;
                };
                for i in 0..3 {
                    low[i] = low[i].min(next[i]);
                    high[i] = high[i].max(next[i]);
                }
                end += 1;
            }
            let lasts = recording.samples.t[end - 1].since_s(recording.samples.t[first]) >= STUCK_S
                && end - first >= STUCK_SAMPLES;
            if lasts
                && (0..3).any(|i| high[i] - low[i] > moves)
                && would_show(&value, first..end, axis, step)
            {
                if found.is_none_or(|(before, _)| first < before) {
                    found = Some((first, axis));
                }
                break;
            }
            first = end;
        }
    }
    found
}

/// The least change of an axis from sample to sample; infinite where it never moves.
fn least_step(count: usize, value: impl Fn(usize) -> Option<Vector3<f64>>, axis: usize) -> f64 {
    let change = |k: usize| Some((value(k)?[axis] - value(k - 1)?[axis]).abs());
    let changes = (1..count).filter_map(change);
    changes.filter(|c| *c > 0.0).fold(f64::INFINITY, f64::min)
}

/// Whether the noise of both other axes, as second differences have it, would move this one by steps: an axis of coarse
/// steps repeats itself at rest, and where it is not moved.
fn would_show(
    value: impl Fn(usize) -> Option<Vector3<f64>>,
    run: Range<usize>,
    axis: usize,
    step: f64,
) -> bool {
    (0..3).filter(|other| *other != axis).all(|other| {
        let second = |k: usize| {
            let [a, b, c] = [value(k - 2)?, value(k - 1)?, value(k)?].map(|v| v[other]);
            Some((a - 2.0 * b + c).abs())
        };
        let middle = median((run.start + 2..run.end).filter_map(second));
        middle.is_some_and(|middle| middle > NOISY_STEPS * step)
    })
}
