//! What a gyroscope gives: samples without it, and whether its unit can be the one that is named.

use std::f64::consts::PI;
use std::ops::Range;

use wimu_nav::slide::{Move, Slide, SlideConfig};
use wimu_nav::unit::UnitSample;

use crate::motion::{MotionRecording, rests};
use crate::{ErrorCode, HostError, Result};

/// A shorter hole is filled in evenly, s: a hand's rate changes by little in it.
const FILLED_S: f64 = 0.05;
/// Nothing that is carried turns faster, rad/s.
const FASTEST_RAD_S: f64 = 100.0;
/// Rests that show gravity, and moves between them, s.
const REST_S: f64 = 0.5;
const MOVE_S: f64 = 30.0;
/// The turn of gravity that a rate of the right unit and axes leaves open is smaller, rad.
const OPEN_RAD: f64 = 0.15;
/// Another unit is the right one where it leaves this share of that.
const FITS: f64 = 0.25;

/// Where the angular rate is missing: nothing where there is no rate at all.
pub(super) fn holes(samples: &[UnitSample]) -> Vec<Range<usize>> {
    let mut holes = Vec::new();
    if samples.iter().all(|s| s.rate_rad_s.is_none()) {
        return holes;
    }
    let mut from = 0;
    while let Some(first) = samples[from..].iter().position(|s| s.rate_rad_s.is_none()) {
        let first = from + first;
        let goes_on = samples[first..].iter().position(|s| s.rate_rad_s.is_some());
        from = goes_on.map_or(samples.len(), |k| first + k);
        holes.push(first..from);
    }
    holes
}

/// Fills short holes in the angular rate of a slide, which has no covariance for them.
pub(super) fn filled(times_s: &[f64], samples: &mut [UnitSample]) {
    for hole in holes(samples) {
        let (Some(before), end) = (hole.start.checked_sub(1), hole.end) else {
            continue;
        };
        let sides = (
            samples[before].rate_rad_s,
            samples.get(end).and_then(|s| s.rate_rad_s),
        );
        let (Some(low), Some(high)) = sides else {
            continue;
        };
        let whole = times_s[end] - times_s[before];
        if whole > FILLED_S {
            continue;
        }
        for k in hole {
            let share = (times_s[k] - times_s[before]) / whole.max(f64::MIN_POSITIVE);
            let rate = std::array::from_fn(|i| low[i] + share * (high[i] - low[i]));
            samples[k].rate_rad_s = Some(rate);
        }
    }
}

/// What to say of the holes.
pub(super) fn remark(holes: &[Range<usize>], times_s: &[f64]) -> Option<String> {
    let first = holes.first()?;
    let count: usize = holes.iter().map(|hole| hole.len()).sum();
    Some(format!(
        "the angular rate is missing in {count} samples, {} times, first at {:.2} s: the last one is held for 0.25 s, \
         from then on it is estimated, and the attitude is doubted as much",
        holes.len(),
        times_s[first.start]
    ))
}

/// Looks whether the angular rate turns gravity from rest to rest as the accelerometer sees it turn, and
/// returns what to say where it does not.
///
/// # Errors
/// `data_refused` where another unit would, or the rate is faster than anything.
pub(super) fn checked(recording: &MotionRecording) -> Result<Option<String>> {
    let length = |v: &[f64; 3]| v.iter().map(|c| c * c).sum::<f64>().sqrt();
    let rates = recording.samples.iter().filter_map(|s| s.rate_rad_s);
    let fastest = rates.map(|rate| length(&rate)).fold(0.0, f64::max);
    let refused = |message: String, unit: &str| {
        Err(HostError::new(
            ErrorCode::DataRefused,
            message,
            format!("is it in {unit}? Name the columns `Gyroscope X ({unit})`, …"),
        )
        .at(&recording.name))
    };
    if fastest > FASTEST_RAD_S {
        let message = format!("its angular rate goes up to {fastest:.0} rad/s");
        return refused(message, "deg/s");
    }
    let open = |factor: f64| open_rad(recording, factor);
    let Some(now) = open(1.0).filter(|open| *open > OPEN_RAD) else {
        return Ok(None);
    };
    // Where gravity did not turn, a smaller rate always fits better.
    let turned = open(0.0).unwrap_or_default();
    for (factor, unit) in [(PI / 180.0, "deg/s"), (180.0 / PI, "rad/s")] {
        let other = open(factor).unwrap_or(f64::INFINITY);
        if other < FITS * now.min(turned) && other < OPEN_RAD {
            let message = format!(
                "its angular rate leaves {:.0}° of gravity's turn between rests open, in {unit} it would not",
                now.to_degrees()
            );
            return refused(message, unit);
        }
    }
    Ok(Some(format!(
        "the angular rate leaves {:.0}° of gravity's turn between rests open: see that its axes, their signs and its \
         scale are those of the accelerometer",
        now.to_degrees()
    )))
}

/// Root mean square of the angle of gravity between rests that the angular rate, times `factor`, leaves open,
/// rad; `None` where there are no two rests with a rate between.
fn open_rad(recording: &MotionRecording, factor: f64) -> Option<f64> {
    let times = &recording.times_s;
    let unrated: Vec<UnitSample> = recording
        .samples
        .iter()
        .map(|s| UnitSample {
            rate_rad_s: None,
            ..*s
        })
        .collect();
    let mut found = rests(times, &unrated);
    found.retain(|rest| times[rest.end - 1] - times[rest.first] >= REST_S);
    let (mut square, mut count) = (0.0, 0.0);
    for pair in found.windows(2) {
        let (before, after) = (pair[0], pair[1]);
        if times[after.first] - times[before.end - 1] > MOVE_S {
            continue;
        }
        let rates = recording.samples[before.first..before.end].iter();
        let rates: Vec<[f64; 3]> = rates.filter_map(|s| s.rate_rad_s).collect();
        if rates.is_empty() {
            continue;
        }
        let mean = |i: usize| factor * rates.iter().map(|r| r[i]).sum::<f64>() / rates.len() as f64;
        let mut start = before.rest;
        start.rate_rad_s = Some(std::array::from_fn(mean));
        let mut slide = Slide::new(SlideConfig::default(), start);
        for k in before.end..after.first {
            let sample = &recording.samples[k];
            let rate = sample.rate_rad_s.map(|r| r.map(|w| factor * w));
            slide.push(times[k] - times[k - 1], sample.force_mps2, rate);
        }
        let done: Move = slide.finish(after.rest);
        square += done.open_rad * done.open_rad;
        count += 1.0;
    }
    (count > 0.0).then(|| (square / count).sqrt())
}
