//! Alignment of the clocks of two units by their motion.

use nalgebra::Rotation3;

use super::engine::{self, Model};
use super::pair::{LEAST_OVERLAP_S, Unit, steps};
use crate::lag::{Search, lag, likeliest};
use crate::{Code, Problem, Result};

/// Step of the search for the offset of greatest likelihood, s, and how far it reaches.
const STEP_S: f64 = 0.02;
const REACH_S: f64 = 0.1;
/// Motion by which the offset is found, s.
const REFINED_S: f64 = 60.0;
/// Standard deviation of the offset of clocks that the recordings have in common, s, where the motion does not show it.
const COMMON_SD_S: f64 = 0.005;
/// Least standard deviation of an offset, s: repeated samples and filters of the sensors.
const LEAST_SD_S: f64 = 0.002;
/// An offset below this number of standard deviations is not corrected.
const SIGNIFICANT: f64 = 3.0;
/// Offset that the search about the clocks as recorded reaches, s.
const NEAR_S: f64 = 0.2;
/// Least correlation of the angular rates at another offset, its lead over that at other offsets, and over that as recorded:
/// limbs of one body are not always in phase.
const CORRELATION: f64 = 0.6;
const LEAD: f64 = 0.1;
const LEAD_AS_RECORDED: f64 = 0.2;

/// The clock of the second unit.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Clock {
    /// Added to the second unit's times, s.
    pub offset_s: f64,
    /// Its standard deviation, s.
    pub sd_s: f64,
    /// What the motion shows of the offset, s, if it does.
    pub measured_s: Option<f64>,
}

/// The offset of clocks that differ by more than [`NEAR_S`], by the magnitudes of the angular rates.
pub(super) fn coarse(units: &[Unit; 2]) -> Result<(Clock, Vec<Problem>)> {
    let [[a0, a1], [b0, b1]] = [units[0].span_s(), units[1].span_s()];
    let overlap_s = a1.min(b1) - a0.max(b0);
    let as_recorded = Clock { offset_s: 0.0, sd_s: COMMON_SD_S, measured_s: None };
    let shorter_s = (a1 - a0).min(b1 - b0);
    let overlap = LEAST_OVERLAP_S.max(0.5 * shorter_s);
    let search = Search { around_s: 0.0, reach_s: f64::INFINITY, overlap_s: overlap };
    let lag = lag(&units[0].magnitudes(), &units[1].magnitudes(), &search);
    let lag = lag.filter(|lag| lag.correlation >= CORRELATION && lag.offset_s.abs() > NEAR_S);
    let common = overlap_s >= LEAST_OVERLAP_S;
    match lag {
        Some(lag)
            if lag.lead >= LEAD
                && (!common || lag.correlation - lag.best_within(NEAR_S) >= LEAD_AS_RECORDED) =>
        {
            let offset_s = lag.offset_s;
            let clock = Clock { offset_s, sd_s: STEP_S, measured_s: Some(offset_s) };
            let evidence = format!(
                "the clock of the second unit is {offset_s:+.2} s behind (correlation of the angular rates {:.2}, as recorded {:.2}): corrected",
                lag.correlation,
                lag.best_within(NEAR_S).max(-1.0)
            );
            let remedy = "where the clocks are common, the joint moved too little to tell: move both bodies together once";
            Ok((clock, vec![Code::Clock.warning(evidence).remedy(remedy)]))
        }
        _ if common => Ok((as_recorded, Vec::new())),
        _ => Err(Code::DataRefused.error(
            "the recordings have less than 5 s in common, and their motion does not align them",
            "record both at the same time, and shake both bodies together once",
        )),
    }
}

/// The offset of greatest likelihood near the coarse one, by the accelerations of the joint.
pub(super) fn refined(
    units: &[Unit; 2],
    mut clock: Clock,
    start: Rotation3<f64>,
    model: &Model,
    noticed: &mut Vec<Problem>,
) -> Clock {
    let moved = clock.offset_s != 0.0;
    let begun = |offset_s: f64| {
        let mut all = steps(units, offset_s);
        let end_s = all.first().map_or(0.0, |step| step.time_s + REFINED_S);
        all.retain(|step| step.time_s <= end_s);
        all
    };
    let count = begun(clock.offset_s).len() as f64;
    // Runs of different lengths have different numbers of updates.
    let log_likelihood = |offset_s: f64| {
        let all = begun(offset_s);
        let found = engine::run(&all, start, model).log_likelihood * count / all.len() as f64;
        found.is_finite().then_some(found)
    };
    let Some(found) = likeliest(clock.offset_s, [STEP_S; 2], REACH_S, log_likelihood) else {
        return clock;
    };
    let sd_s = found.sd_s.max(LEAST_SD_S);
    clock.measured_s = Some(found.offset_s);
    if !moved && found.offset_s.abs() <= SIGNIFICANT * sd_s {
        clock.sd_s = sd_s.min(COMMON_SD_S);
        return clock;
    }
    (clock.offset_s, clock.sd_s) = (found.offset_s, sd_s);
    if !moved {
        let [offset_ms, sd_ms] = [found.offset_s, sd_s].map(|time_s| time_s * 1e3);
        let evidence = format!(
            "the clock of the second unit is {offset_ms:+.0} ± {sd_ms:.0} ms behind: corrected"
        );
        noticed.push(Code::Clock.note(evidence));
    }
    clock
}
