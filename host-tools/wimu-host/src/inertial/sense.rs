//! Whether a recording can be what it says it is: gravity, and axes that go on.

use std::ops::Range;

use nalgebra::Vector3;

use super::frozen::{Frozen, Sense};
use super::unit::median_step_s;
use crate::digits::significant;
use crate::imu::{Imu, Sample};
use crate::plural::counted;
use crate::rests::RestLimits;
use crate::stats::median;
use crate::{Code, Problem, Result};

/// What a rest shows is gravity within this share.
const NEAR: f64 = 0.1;
/// Beyond this share an accelerometer is not calibrated.
const CALIBRATED: f64 = 0.02;
/// |f| of a whole recording is, in the median, gravity within this factor.
const FAR: f64 = 3.0;
/// A dead sensor gives one value for at least this time, s, and in at least this number of samples, while gravity or the
/// magnetic field turns.
const STUCK_S: f64 = 1.0;
const STUCK_SAMPLES: usize = 50;
/// The vector that turns keeps its norm within this share, and turns by more than this angle, rad: 20°.
const AS_LARGE: f64 = 0.02;
const TURNED_RAD: f64 = 0.35;

/// Steps that a recording to navigate may have, s: beyond these its times are in another unit.
const STEPS_S: std::ops::Range<f64> = 2e-5..0.25;
/// Of gravity, along z: face down.
const FACE_DOWN: f64 = -0.7;
/// Of the magnetic field, along gravity: it dips.
const DIPS: f64 = 0.2;

/// Full scales of accelerometers, *g*, and the largest relative distance of a clipped value from one.
const SCALES_G: [f64; 5] = [2.0, 4.0, 8.0, 16.0, 32.0];
const AT_SCALE: f64 = 0.03;
/// Fewest occurrences of an axis's largest value where it clips.
const CLIPS: usize = 3;

/// Longest time for which a slow magnetometer's reading is held, s.
const HELD_S: f64 = 3.0;
/// What was found.
#[derive(Clone, Debug, Default)]
pub(super) struct Senses {
    /// Bias of the gyroscope that is taken off, rad/s: one that would hide every rest.
    pub rate_bias_rad_s: Vector3<f64>,
    /// Samples in which an axis of the gyroscope repeats its last value.
    pub frozen_rates: Vec<usize>,
    /// From this sample on the gyroscope is dead.
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
        let (samples, first) = (&recording.samples.v, recording.samples.v.first());
        if samples.len() >= STUCK_SAMPLES
            && samples.iter().all(|s| Some(s.force_mps2) == first.map(|first| first.force_mps2))
        {
            let text = "the accelerometer gives one and the same value throughout";
            let remedy = "check the sensor and its wiring: a sensor that works has noise";
            senses.findings.push(Code::Frozen.warning(text).remedy(remedy));
        }
        if let Some(bias) = rate_bias(recording) {
            let [x, y, z]: [f64; 3] = bias.map(f64::to_degrees).into();
            senses.findings.push(Code::Navigation.warning(format!(
                "the gyroscope shows {x:.1} {y:.1} {z:.1} °/s while the accelerometer is still: taken off as its bias"
            )));
            senses.rate_bias_rad_s = bias;
        }
        senses.clipped = clipped_samples(&recording.samples.v);
        if let Some(first) = senses.clipped.first() {
            senses.findings.push(Code::Saturated.warning(format!(
                "the accelerometer clips in {}, first at {:.2} s: what it felt there is not \
                 known; take a larger range",
                counted(senses.clipped.len(), "sample"),
                recording.samples.t[*first].s()
            )));
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
        if let Some(Frozen { samples, text }) = Frozen::of(recording, "gyroscope", |s| s.rate_rad_s)
        {
            senses.findings.push(Code::Frozen.warning(format!("{text}: it is left out there")));
            senses.frozen_rates = samples;
        } else if let Some(from) = silent(recording, |s| s.rate_rad_s, STUCK_S, &shown) {
            senses.findings.push(Code::Frozen.warning(format!(
                "all axes of the gyroscope give one and the same value from {:.2} s on while gravity or the field \
                 turns: it is left out from there on",
                recording.samples.t[from].s()
            )));
            senses.rate_ends = Some(from);
        }
        Ok(senses)
    }

    /// Takes the bias of the gyroscope off samples.
    pub fn without_bias(&self, samples: &mut [Sample]) {
        for rate in samples.iter_mut().filter_map(|sample| sample.rate_rad_s.as_mut()) {
            *rate -= self.rate_bias_rad_s;
        }
    }
}

/// Mean angular rate at the rests that the accelerometer alone shows, rad/s, where the detector of rests would take it for a
/// motion. A rotation about the vertical does not show in the accelerometer, and lasts at every rest if it is a bias: at two
/// or more.
fn rate_bias(recording: &Imu) -> Option<Vector3<f64>> {
    let limits = RestLimits::default();
    let [steady, hidden] =
        [limits.rate_rad_s, limits.rate_offset_rad_s].map(|sd| sd * limits.threshold.sqrt());
    let at_rest = |(second, _): (Range<usize>, f64)| {
        let samples = &recording.samples.v[second];
        let rates: Vec<Vector3<f64>> = samples.iter().filter_map(|s| s.rate_rad_s).collect();
        let mean = rates.iter().sum::<Vector3<f64>>() / rates.len() as f64;
        let scatter = rates.iter().map(|rate| (rate - mean).norm_squared()).sum::<f64>();
        ((scatter / rates.len() as f64).sqrt() < steady).then_some(mean)
    };
    let rests: Vec<_> = recording.still_seconds().into_iter().filter_map(at_rest).collect();
    let bias =
        Vector3::from_fn(|axis, _| median(rests.iter().map(|mean| mean[axis])).unwrap_or_default());
    let is_constant = rests.iter().all(|mean| (mean - bias).norm() < hidden);
    (rests.len() > 1 && bias.norm() > hidden && is_constant).then_some(bias)
}

/// Whether times go on as those of samples do.
fn steps(recording: &Imu) -> Result<()> {
    let step_s = median_step_s(&recording.times_s());
    if recording.samples.len() < 3 || STEPS_S.contains(&step_s) || step_s <= 0.0 {
        return Ok(());
    }
    let remedy = "see that the unit of its times is right: `Time (s)`, `Time (ms)`, `Time (us)` or `Time (ns)`";
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

/// Samples in which the accelerometer is at its full scale.
pub(super) fn clipped_samples(samples: &[Sample]) -> Vec<usize> {
    clipped(&samples.iter().map(|sample| sample.force_mps2).collect::<Vec<_>>())
}

/// Outputs of an accelerometer, m/s², at an axis's full scale, where it comes there more than once.
pub(crate) fn clipped(outputs: &[Vector3<f64>]) -> Vec<usize> {
    let mut found = Vec::new();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let at = |k: usize| sign * outputs[k][axis];
            let most = (0..outputs.len()).map(at).fold(0.0, f64::max);
            let scales = SCALES_G.map(|g| g * wimu_model::STANDARD_GRAVITY_MPS2);
            if !scales.iter().any(|s| (most / s - 1.0).abs() < AT_SCALE) {
                continue;
            }
            let there: Vec<usize> = (0..outputs.len()).filter(|k| at(*k) == most).collect();
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
            "1 at rest is g: give --units g (with a gyroscope in degrees g,deg/s)"
        } else {
            "see that the unit is right (--units), and that the accelerometer works"
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

/// The sample from which on no axis of a sensor changes for `longer_s`, s, or more, while one of the others shows that the
/// unit turns.
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
