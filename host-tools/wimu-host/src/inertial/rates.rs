//! Whether an angular rate rotates gravity as the accelerometer shows it: from rest to rest.

use std::f64::consts::PI;
use std::ops::Range;

use nalgebra::{Rotation3, Vector3};

use crate::imu::{Imu, Sample};
use crate::rests::{self, RestLimits};
use crate::{Code, Problem, Result};

/// Nothing that is carried rotates faster, rad/s.
const FASTEST_RAD_S: f64 = 100.0;
/// The shortest rest that shows gravity, and the longest motion over which a rate is integrated, s.
const REST_S: f64 = 0.5;
const MOTION_S: f64 = 30.0;
/// A rate of the right unit and axes leaves less of gravity's rotation, rad.
const RIGHT_RAD: f64 = 0.15;
/// Another unit or sign is right if it leaves less than this fraction.
const FITS: f64 = 0.4;
/// A rate that leaves more than this fraction is not that of the unit.
const LITTLE: f64 = 0.6;

/// A disagreement of the gyroscope with the accelerometer.
pub(super) struct Disagreement {
    pub finding: Problem,
    /// Whether the rate is better not used.
    pub contradicts: bool,
}

/// Compares the rotation of gravity between rests by the gyroscope and by the accelerometer.
///
/// # Errors
/// `data_refused` where another unit fits, or the rate is faster than anything.
pub(super) fn checked(recording: &Imu) -> Result<Option<Disagreement>> {
    let rates = recording.samples.v.iter().filter_map(|s| s.rate_rad_s);
    let fastest = rates.map(|rate| rate.norm()).fold(0.0, f64::max);
    let refused = |message: String, unit: &str| {
        let remedy = format!("if it is in {unit}, name the columns `Gyroscope X ({unit})`, …");
        Err(Code::DataRefused.error(message, remedy).at(&recording.name))
    };
    if fastest > FASTEST_RAD_S {
        return refused(format!("its angular rate goes up to {fastest:.0} rad/s"), "deg/s");
    }
    // Each unit is judged at the rests that it shows.
    for (factor, unit) in [(PI / 180.0, "deg/s"), (180.0 / PI, "rad/s")] {
        let rests = rests(recording, factor);
        let open = |factor| open_rad(recording, &rests, factor);
        let (Some(now), Some(other), Some(none)) = (open(1.0), open(factor), open(0.0)) else {
            continue;
        };
        // Where nothing rotated, a smaller rate always fits better.
        if now > RIGHT_RAD && other < RIGHT_RAD && other < FITS * now.min(none) {
            let message = format!(
                "its angular rate leaves {:.0}° of gravity's rotation between rests, and would fit in {unit}",
                now.to_degrees()
            );
            return refused(message, unit);
        }
    }
    let rests = rests(recording, 1.0);
    let open = |factor| open_rad(recording, &rests, factor);
    let (Some(now), Some(reversed), Some(none)) = (open(1.0), open(-1.0), open(0.0)) else {
        return Ok(None);
    };
    if now <= RIGHT_RAD {
        return Ok(None);
    }
    let turned = reversed < FITS * now;
    let little = none > RIGHT_RAD && now > LITTLE * none;
    let remedy = if turned {
        "with its signs reversed it would fit: it is not used"
    } else if little {
        "it hardly follows the rotation: it is not used"
    } else {
        "check that its axes, signs and scale are those of the accelerometer"
    };
    Ok(Some(Disagreement {
        finding: Code::Axes
            .warning(format!(
                "the angular rate leaves {:.0}° of gravity's rotation between rests",
                now.to_degrees()
            ))
            .remedy(remedy),
        contradicts: turned || little,
    }))
}

/// Rests of a recording whose angular rate, times a factor, is right.
fn rests(recording: &Imu, factor: f64) -> Vec<Range<usize>> {
    let mut limits = RestLimits::default();
    limits.gravity_mps2 = recording.gravity_mps2();
    let samples = recording.samples.v.iter();
    let samples = samples.map(|s| (s.force_mps2, s.rate_rad_s.map(|rate| factor * rate), s.step_s));
    let mut found = rests::rests(samples, limits);
    let times = recording.times_s();
    found.retain(|rest| times[rest.end - 1] - times[rest.start] >= REST_S);
    found
}

/// Root mean square of the angle, rad, between gravity at a rest and gravity of the rest before rotated by the rate times
/// `factor`; `None` without two rests with a rate between.
fn open_rad(recording: &Imu, rests: &[Range<usize>], factor: f64) -> Option<f64> {
    let (times, samples) = (recording.times_s(), &recording.samples.v);
    let mut squares = Vec::new();
    for pair in rests.windows(2) {
        let (before, after) = (pair[0].clone(), pair[1].clone());
        if times[after.start] - times[before.end - 1] > MOTION_S {
            continue;
        }
        let Some(bias) = mean(&samples[before.clone()], |s| s.rate_rad_s) else {
            continue;
        };
        let gravity = |rest: Range<usize>| mean(&samples[rest], |s| Some(s.force_mps2));
        let (Some(first), Some(last)) = (gravity(before.clone()), gravity(after.clone())) else {
            continue;
        };
        let mut attitude = Rotation3::identity();
        for sample in &samples[before.end..after.start] {
            let rate = sample.rate_rad_s.unwrap_or(bias) - bias;
            attitude *= Rotation3::new(rate * (factor * sample.step_s));
        }
        squares.push((attitude.inverse() * first).angle(&last).powi(2));
    }
    let count = squares.len() as f64;
    (count > 0.0).then(|| (squares.iter().sum::<f64>() / count).sqrt())
}

fn mean(
    samples: &[Sample],
    value: impl Fn(&Sample) -> Option<Vector3<f64>>,
) -> Option<Vector3<f64>> {
    let values: Vec<Vector3<f64>> = samples.iter().filter_map(value).collect();
    let count = values.len() as f64;
    (count > 0.0).then(|| values.iter().sum::<Vector3<f64>>() / count)
}
