//! What a gyroscope gives: samples without it, and whether its unit can be the one that is named.

use std::f64::consts::PI;
use std::ops::Range;

use wimu_nav::slide::{Slide, SlideConfig};
use wimu_nav::unit::UnitSample;

use super::slide::field_at;
use crate::finding::{Finding, FindingCode};
use crate::motion::{MotionRecording, RestSpan, rests};
use crate::plural::counted;
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
/// That of the magnetic field, which is disturbed indoors.
const OPEN_FIELD_RAD: f64 = 0.4;
/// Another unit, or sign, is the right one where it leaves this share of that.
const FITS: f64 = 0.4;
/// A rate that leaves more than this share of what turned is none of this unit.
const LITTLE: f64 = 0.6;

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

/// A finding of the holes.
pub(super) fn finding(holes: &[Range<usize>], times_s: &[f64]) -> Option<Finding> {
    let first = holes.first()?;
    let count: usize = holes.iter().map(|hole| hole.len()).sum();
    Some(FindingCode::SamplesLeftOut.warning(format!(
        "the angular rate is missing in {}, {}, first at {:.2} s: the last one is held for 0.25 s, \
         from then on it is estimated, and the attitude is doubted as much",
        counted(count, "sample"),
        counted(holes.len(), "time"),
        times_s[first.start]
    )))
}

/// What a gyroscope shows that does not agree with what else turns.
pub(super) struct Disagreement {
    /// What to say of it.
    pub said: String,
    /// Whether it is better left out.
    pub contradicts: bool,
}

/// Looks whether the angular rate turns gravity and the magnetic field from rest to rest as accelerometer and
/// magnetometer see them turn, and returns how it does not.
///
/// # Errors
/// `data_refused` where another unit would, or the rate is faster than anything.
pub(super) fn checked(recording: &MotionRecording) -> Result<Option<Disagreement>> {
    let rates = recording.samples.iter().filter_map(|s| s.rate_rad_s);
    let fastest = rates.map(length).fold(0.0, f64::max);
    let refused = |message: String, is: &str, unit: &str| {
        Err(HostError::new(
            ErrorCode::DataRefused,
            message,
            format!("is it in {is}? Name the columns `Gyroscope X ({unit})`, …"),
        )
        .at(&recording.name))
    };
    if fastest > FASTEST_RAD_S {
        let message = format!("its angular rate goes up to {fastest:.0} rad/s");
        return refused(message, "deg/s", "deg/s");
    }
    // Each unit is judged by what it says rests: an even turn is as quiet as one.
    for (factor, times, unit, named) in [
        (PI / 180.0, "a 57th of it", "deg/s", "rad/s"),
        (180.0 / PI, "57 times as much", "rad/s", "deg/s"),
    ] {
        let found = resting(recording, factor);
        let open = |factor| Open::over(recording, &found, factor);
        let (Some(now), Some(other), Some(still)) = (open(1.0), open(factor), open(0.0)) else {
            continue;
        };
        // Where nothing turned, a smaller rate always fits better.
        if other.gravity_rad <= OPEN_RAD && other.fits(&now) && other.fits(&still) {
            let message =
                format!("its angular rate leaves {now} between rests open, {times} would not");
            return refused(
                message,
                &format!("{unit}, in columns that name {named}"),
                unit,
            );
        }
    }
    let found = resting(recording, 1.0);
    let open = |factor| Open::over(recording, &found, factor);
    let (Some(now), Some(other), Some(still)) = (open(1.0), open(-1.0), open(0.0)) else {
        return Ok(None);
    };
    let turned = other.fits(&now);
    let little = now.gravity_rad > OPEN_RAD
        && still.gravity_rad > OPEN_RAD
        && now.gravity_rad > LITTLE * still.gravity_rad;
    let so = if turned {
        "with its signs turned round it would not: it is left out".to_owned()
    } else if little {
        format!("of {still}: it is left out")
    } else if now.gravity_rad > OPEN_RAD {
        "see that its axes, their signs and its scale are those of the accelerometer".to_owned()
    } else if now.field_rad.is_some_and(|field| field > OPEN_FIELD_RAD) {
        "the field is disturbed there, as it is indoors, or the rate about the vertical is not that of its \
         unit and sign"
            .to_owned()
    } else {
        return Ok(None);
    };
    Ok(Some(Disagreement {
        said: format!("the angular rate leaves {now} between rests open, {so}"),
        contradicts: turned || little,
    }))
}

/// The rests of a recording whose angular rate, times `factor`, is right.
fn resting(recording: &MotionRecording, factor: f64) -> Vec<RestSpan> {
    let times = &recording.times_s;
    let scaled: Vec<UnitSample> = recording
        .samples
        .iter()
        .map(|s| UnitSample {
            rate_rad_s: s.rate_rad_s.map(|r| r.map(|w| factor * w)),
            ..*s
        })
        .collect();
    let mut found = rests(times, &scaled);
    found.retain(|rest| times[rest.end - 1] - times[rest.first] >= REST_S);
    found
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|c| c * c).sum::<f64>().sqrt()
}

/// Root mean square of the turn of gravity and of the magnetic field between rests that a rate leaves open, rad.
#[derive(Clone, Copy, Debug, Default)]
struct Open {
    gravity_rad: f64,
    field_rad: Option<f64>,
}

impl std::fmt::Display for Open {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.0}° of gravity's turn", self.gravity_rad.to_degrees())?;
        match self.field_rad {
            Some(field) => write!(f, " and {:.0}° of the magnetic field's", field.to_degrees()),
            None => Ok(()),
        }
    }
}

impl Open {
    /// Whether this leaves so much less of gravity's turn, of which the other leaves more than a right rate does,
    /// that it must be the right one. The magnetic field is no witness: indoors it turns by itself.
    fn fits(&self, other: &Self) -> bool {
        other.gravity_rad > OPEN_RAD && self.gravity_rad < FITS * other.gravity_rad
    }

    /// What the angular rate, times `factor`, leaves; `None` where there are no two rests with a rate between.
    fn over(recording: &MotionRecording, found: &[RestSpan], factor: f64) -> Option<Self> {
        let times = &recording.times_s;
        let (mut gravity, mut field) = (Mean::default(), Mean::default());
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
            let mean =
                |i: usize| factor * rates.iter().map(|r| r[i]).sum::<f64>() / rates.len() as f64;
            let mut start = before.rest;
            start.rate_rad_s = Some(std::array::from_fn(mean));
            let mut slide = Slide::new(SlideConfig::default(), start);
            for k in before.end..after.first {
                let sample = &recording.samples[k];
                let rate = sample.rate_rad_s.map(|r| r.map(|w| factor * w));
                slide.push(times[k] - times[k - 1], sample.force_mps2, rate);
            }
            gravity.take(slide.finish(after.rest).open_rad);
            let fields = [before, after].map(|rest| field_at(recording, &rest));
            if let [Some(at), Some(then)] = fields {
                let then = slide
                    .attitude()
                    .map(|row| (0..3).map(|i| row[i] * then[i]).sum::<f64>());
                let cosine = (0..3).map(|i| at[i] * then[i]).sum::<f64>();
                let cosine = cosine / (length(at) * length(then));
                field.take(cosine.clamp(-1.0, 1.0).acos());
            }
        }
        Some(Self {
            gravity_rad: gravity.root()?,
            field_rad: field.root(),
        })
    }
}

/// Of squares.
#[derive(Default)]
struct Mean {
    square: f64,
    count: f64,
}

impl Mean {
    fn take(&mut self, value: f64) {
        self.square += value * value;
        self.count += 1.0;
    }

    fn root(&self) -> Option<f64> {
        (self.count > 0.0).then(|| (self.square / self.count).sqrt())
    }
}
