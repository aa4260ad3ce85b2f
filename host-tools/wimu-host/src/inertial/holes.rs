//! Samples of which the accelerometer gives no number, more than its full scale, or goes on giving the last one, and outliers:
//! they are left out, as if they were missing.

use nalgebra::Vector3;

use super::frozen::Frozen;
use super::{InertialPath, PathPoint};
use crate::imu::{Imu, Sample};
use crate::plural::counted;
use crate::series::{Flags, Series};
use crate::stats::median;
use crate::{Code, Problem, Result};

/// Full scale of an accelerometer that is not known, m/s²: that of the widest digital MEMS accelerometers is ± 200 g
/// (ADXL375, datasheet).
pub(crate) const FULL_SCALE_MPS2: f64 = 2000.0;
/// The same of a gyroscope, rad/s: 20,000 deg/s (ADXRS649, datasheet).
const FULL_SCALE_RAD_S: f64 = 350.0;
/// The same of a magnetometer, µT: ± 50 gauss (LSM303AGR, datasheet).
const FULL_SCALE_UT: f64 = 5000.0;

/// Fewest samples beside frozen ones.
const FEWEST: usize = 10;

/// Half width of the window that shows an outlier, samples: that of a Hampel identifier (R. K. Pearson, "Outliers in process
/// modeling and identification", IEEE Trans. Control Syst. Technol. 10, 2002).
const HALF_WIDTH: usize = 3;
/// Least distance of an outlier from the mean of its neighbours, in units of each of: the range of the window's other samples,
/// the axis's median distance, and its resolution. No motion within the bandwidth is that far: the cause is the bus or the
/// logger. Chosen on the recordings of hands, robot arms and feet in shared/data.
const OUTLIER: f64 = 10.0;

/// Samples that are left out, from a recording's first to its last, and what to say of them.
pub(crate) struct Holes {
    left_out: Vec<bool>,
    pub findings: Vec<Problem>,
}

impl Holes {
    /// Of a recording; `None` where every sample is one.
    ///
    /// # Errors
    /// `data_refused` where most samples are no numbers, or beyond the full scale.
    pub fn of(recording: &Imu) -> Result<Option<Self>> {
        let is_number = |sample: &Sample| sample.force_mps2.iter().all(|f| f.is_finite());
        let mut left_out: Vec<bool> = recording.samples.v.iter().map(|s| !is_number(s)).collect();
        let none = left_out.contains(&true).then(|| no_number(recording, &left_out));
        let most = recording.full_scale_mps2.unwrap_or(FULL_SCALE_MPS2);
        let force = |s: &Sample| is_number(s).then_some(s.force_mps2);
        let too_much = beyond(recording, "accelerometer", most, "m/s²", force);
        for k in too_much.iter().flat_map(|(samples, _)| samples) {
            left_out[*k] = true;
        }
        let count = left_out.iter().filter(|hole| **hole).count();
        let mut findings = Vec::new();
        for said in none.into_iter().chain(too_much.map(|(_, said)| said)) {
            if 2 * count > recording.samples.len() {
                return Err(Code::DataRefused.error(said,
                    "see why the sensor fails, and that its unit is right; leave the part out in which it does",
                )
                .at(&recording.name));
            }
            let text = format!("{said}: left out, as if they were missing");
            findings.push(Code::SamplesLeftOut.warning(text));
        }
        let rate = beyond(recording, "gyroscope", FULL_SCALE_RAD_S, "rad/s", |s| s.rate_rad_s);
        let field = beyond(recording, "magnetometer", FULL_SCALE_UT, "µT", |s| s.field_ut);
        let others = rate.into_iter().chain(field);
        let text = |said| format!("{said}: left out there");
        findings.extend(others.map(|(_, said)| Code::SamplesLeftOut.warning(text(said))));
        let mut outliers = outliers(recording);
        outliers.retain(|k| !left_out[*k]);
        if let Some(first) = outliers.first() {
            findings.push(Code::SamplesLeftOut.warning(format!(
                "{}, first at {:.2} s: an axis departs from its neighbours by more than {OUTLIER} times their range; left \
                 out, as if they were missing",
                counted(outliers.len(), "outlier"),
                recording.samples.t[*first].s()
            )));
        }
        for k in outliers {
            left_out[k] = true;
        }
        let frozen = Frozen::of(recording, "accelerometer", |s| Some(s.force_mps2));
        if let Some(Frozen { samples, text }) = frozen {
            if samples.len() + FEWEST > recording.samples.len() {
                let error = Code::DataRefused.error(text, "check the sensor and its wiring");
                return Err(error.at(&recording.name));
            }
            let text = format!("{text}: left out, as if they were missing");
            findings.push(Code::SamplesLeftOut.warning(text));
            samples.iter().for_each(|k| left_out[*k] = true);
        }
        let some = !findings.is_empty();
        Ok(some.then_some(Self { left_out, findings }))
    }

    /// The other samples.
    pub fn left_out_of(&self, recording: &Imu) -> Imu {
        let mut samples = Series::default();
        let mut waited_s = 0.0;
        for (k, sample) in recording.samples.v.iter().enumerate() {
            waited_s += sample.step_s;
            if self.left_out[k] {
                continue;
            }
            let sample = Sample {
                step_s: waited_s,
                rate_rad_s: sample.rate_rad_s.filter(|v| is_within(v, FULL_SCALE_RAD_S)),
                field_ut: sample.field_ut.filter(|v| is_within(v, FULL_SCALE_UT)),
                ..*sample
            };
            samples.push(recording.samples.t[k], sample, Flags::NONE);
            waited_s = 0.0;
        }
        Imu { samples, ..recording.without_samples() }
    }

    /// Puts a point at each of them: between its neighbours, as uncertain as the later one, and valid where both are.
    pub fn fill(&self, path: &mut InertialPath, times_s: &[f64]) {
        let known = std::mem::take(&mut path.points);
        let origin = path.origin;
        let mut at = 0;
        for (time_s, hole) in times_s.iter().zip(&self.left_out) {
            let next = known.get(at);
            if !*hole {
                if at == origin {
                    path.origin = path.points.len();
                }
                path.points.extend(next);
                at += 1;
                continue;
            }
            let before = at.checked_sub(1).and_then(|k| known.get(k));
            path.points.extend(between(before, next, *time_s));
        }
    }
}

fn is_within(vector: &Vector3<f64>, most: f64) -> bool {
    vector.iter().all(|v| v.abs() <= most)
}

/// Samples in which a sensor gives more than its full scale, or no number, and what to say of them; `None` where there
/// are none.
fn beyond(
    recording: &Imu,
    sensor: &str,
    most: f64,
    unit: &str,
    sense: impl Fn(&Sample) -> Option<Vector3<f64>>,
) -> Option<(Vec<usize>, String)> {
    let is_beyond =
        |k: &usize| sense(&recording.samples.v[*k]).is_some_and(|v| !is_within(&v, most));
    let found: Vec<usize> = (0..recording.samples.len()).filter(is_beyond).collect();
    let said = format!(
        "the {sensor} gives more than its full scale, {most:.0} {unit}, in {}, first at {:.2} s",
        counted(found.len(), "sample"),
        recording.samples.t[*found.first()?].s()
    );
    Some((found, said))
}

/// Samples in which an axis of the accelerometer or of the gyroscope is an outlier.
fn outliers(recording: &Imu) -> Vec<usize> {
    let samples = &recording.samples.v;
    let mut found = Vec::new();
    for axis in 0..6 {
        let value = |k: usize| match axis {
            0..3 => samples[k].force_mps2[axis],
            _ => {
                let rate = samples[k].rate_rad_s.filter(|rate| is_within(rate, FULL_SCALE_RAD_S));
                rate.map_or(f64::NAN, |rate| rate[axis - 3])
            }
        };
        let distance = |k: usize| (value(k) - 0.5 * (value(k - 1) + value(k + 1))).abs();
        let Some(median_distance) = median((1..samples.len().saturating_sub(1)).map(distance))
        else {
            continue;
        };
        let change = |k: usize| (value(k) - value(k - 1)).abs();
        let resolution =
            (1..samples.len()).map(change).filter(|c| *c > 0.0).fold(f64::INFINITY, f64::min);
        let is_outlier = |k: &usize| {
            let others = (k - HALF_WIDTH..=k + HALF_WIDTH).filter(|other| other != k).map(value);
            let [low, high] = others.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| {
                [low.min(v), high.max(v)]
            });
            distance(*k) > OUTLIER * (high - low).max(median_distance).max(resolution)
        };
        found.extend((HALF_WIDTH..samples.len().saturating_sub(HALF_WIDTH)).filter(is_outlier));
    }
    found.sort_unstable();
    found.dedup();
    found
}

fn no_number(recording: &Imu, holes: &[bool]) -> String {
    let axes = (0..3).filter(|i| {
        let mut all = recording.samples.v.iter();
        all.any(|sample| !sample.force_mps2[*i].is_finite())
    });
    let axes: Vec<&str> = axes.map(|i| ["X", "Y", "Z"][i]).collect();
    let first = holes.iter().position(|hole| *hole).unwrap_or_default();
    format!(
        "the accelerometer ({}) gives no number in {} of {} samples, first at {:.2} s",
        axes.join(", "),
        holes.iter().filter(|hole| **hole).count(),
        holes.len(),
        recording.samples.t[first].s()
    )
}

fn between(before: Option<&PathPoint>, next: Option<&PathPoint>, time_s: f64) -> Option<PathPoint> {
    let (Some(before), Some(next)) = (before, next) else {
        return before.or(next).map(|point| PathPoint {
            time_s,
            resting: false,
            valid: false,
            ..*point
        });
    };
    let share = (time_s - before.time_s) / (next.time_s - before.time_s).max(f64::MIN_POSITIVE);
    let mixed = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|i| a[i] + share * (b[i] - a[i]));
    Some(PathPoint {
        time_s,
        position_m: mixed(before.position_m, next.position_m),
        velocity_mps: mixed(before.velocity_mps, next.velocity_mps),
        quaternion: before.quaternion,
        resting: before.resting && next.resting,
        valid: before.valid && next.valid,
        ..*next
    })
}
