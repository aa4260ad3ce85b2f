//! The path of one unit through its filter.

use wimu_nav::unit::{UnitConfig, UnitFault, UnitFilter, UnitSample};

use super::origin::measured_from;
use super::{Choice, InertialPath, Method, PathPoint, rates};
use crate::finding::FindingCode;
use crate::plural::counted;

/// A reading of the magnetometer that is repeated within this time is one that is held, s.
const HELD_S: f64 = 0.25;

/// The samples, each reading of a magnetometer that is slower than the accelerometer once.
pub(super) fn once_each_field(samples: &[UnitSample]) -> Vec<UnitSample> {
    let (mut last, mut age_s) = (None, 0.0);
    let once = |sample: &UnitSample| {
        age_s += sample.step_s;
        let held = sample.field_ut.is_none() || (sample.field_ut == last && age_s < HELD_S);
        if !held {
            last = sample.field_ut;
            age_s = 0.0;
        }
        UnitSample {
            field_ut: sample.field_ut.filter(|_| !held),
            ..*sample
        }
    };
    samples.iter().map(once).collect()
}

pub(super) fn filter(
    times_s: &[f64],
    samples: &[UnitSample],
    clipped: &[usize],
    config: UnitConfig,
    choice: &Choice,
    method: Method,
) -> InertialPath {
    let mut filter = UnitFilter::new(config);
    let (mut gaps, mut bad, mut backwards) = (0, 0, 0_usize);
    let (mut begun, mut moved) = (false, false);
    // The last rest from whose end position is measured, and the velocity's deviation there.
    let (mut origin, mut speed_mps) = (0..0, [0.0; 3]);
    let mut points = Vec::with_capacity(samples.len());
    for (k, (sample, time_s)) in samples.iter().zip(times_s).enumerate() {
        if clipped.binary_search(&k).is_ok() {
            filter.interrupt(sample.step_s);
        } else {
            match filter.push(sample) {
                Ok(()) => {}
                Err(UnitFault::Gap) => gaps += 1,
                Err(UnitFault::NoTime) => backwards += 1,
                Err(_) => bad += 1,
            }
        }
        let state = filter.state();
        // Aligned, and no rest yet.
        moved |= !begun && !state.valid && state.attitude_sd_rad[0] > 0.0;
        begun |= state.valid;
        if state.at_origin {
            let goes_on = origin.end == k && k > 0;
            origin = if goes_on { origin.start } else { k }..k + 1;
            speed_mps = state.velocity_sd_mps;
        }
        let known = state.position_sd_m() <= choice.limit_m;
        points.push(PathPoint {
            time_s: *time_s,
            position_m: state.position_m,
            velocity_mps: state.velocity_mps,
            velocity_sd_mps: state.velocity_sd_mps,
            attitude_sd_rad: state.attitude_sd_rad,
            quaternion: state.quaternion,
            rate_rad_s: state.rate_rad_s,
            covariance_m2: state.position_covariance,
            resting: choice.zupt.is_on() && state.resting,
            unseen_mps: (choice.zupt.is_on() && state.resting).then_some(state.unseen_mps),
            unseen_m: state.unseen_m,
            valid: state.valid && known,
        });
    }
    if origin.is_empty() {
        let first = points.iter().position(|p| p.valid).unwrap_or(0);
        origin = first..first + 1;
    }
    let origin = measured_from(&mut points, &origin, speed_mps, choice.limit_m);
    let mut findings = Vec::new();
    if let (true, Some(first)) = (moved, points.iter().find(|p| p.valid)) {
        findings.push(FindingCode::Navigation.note(format!(
            "no rest at the start: position is measured from the first rest, at {:.2} s",
            first.time_s
        )));
    }
    findings.extend(rates::finding(&rates::holes(samples), times_s));
    let mut report = |count: usize, one: &str, what: &str| {
        if count > 0 {
            let text = format!("{} {what}", counted(count, one));
            findings.push(FindingCode::Navigation.warning(text));
        }
    };
    report(
        gaps,
        "gap",
        "longer than 0.25 s: how far it went in one is not known: position is uncertain from there on, and not valid before the next rest",
    );
    report(
        clipped.len(),
        "clipped sample",
        "left out: position is the less certain after them",
    );
    report(backwards, "sample", "whose time stood still: left out");
    report(bad, "sample", "that was no number: left out");
    report(
        filter.state().even as usize,
        "update",
        "at what looked like a rest while the velocity was not zero: even motion, or a wrong velocity",
    );
    report(
        filter.state().pushed as usize,
        "time",
        "for a tenth of a second it seemed to rest and was pushed evenly: no rest",
    );
    report(
        filter.state().holes as usize,
        "time",
        "samples were missing, or time jumped, for less than 0.25 s: doubted as the motion there is strong",
    );
    report(
        filter.state().disturbed as usize,
        "time",
        "the magnetic field was disturbed: left out",
    );
    InertialPath {
        findings,
        ..InertialPath::new(method, points, origin, choice.limit_m)
    }
}
