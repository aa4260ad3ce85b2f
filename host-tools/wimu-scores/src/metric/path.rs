//! Positions of one unit, and from ranges.

use serde_json::Value;

use crate::case::{Case, WINDOW_S};
use crate::command::{Point, Ran, error_at};
use crate::manifest::Source;
use crate::score::{Alignment, Score, errors, quantile, rms};
use crate::table::Result;
use crate::truth::Truth;

/// Windows are scored at these times after their start, s.
const HORIZONS_S: [f64; 3] = [1.0, 2.0, WINDOW_S];
/// Windows in one run of an estimator begin at this interval, s.
const PHASES: i64 = 7;

pub fn windows(case: &Case, source: Source) -> Result<Score> {
    let truth = case.truth()?;
    let all = truth.windows(WINDOW_S);
    let mut score = Score::default();
    let mut errors = HORIZONS_S.map(|_| Vec::new());
    for phase in 0..PHASES {
        let is_of_phase = |start_s: &&f64| (**start_s as i64).rem_euclid(PHASES) == phase;
        let starts: Vec<f64> = all.iter().filter(is_of_phase).copied().collect();
        if starts.is_empty() {
            continue;
        }
        let ran = case.path(source, &truth, &starts)?;
        score.exit = score.exit.max(ran.exit);
        for (errors, after_s) in errors.iter_mut().zip(HORIZONS_S) {
            let ends = starts.iter().map(|start_s| start_s + after_s);
            let error = |t: f64| error_at(&ran.points, t, truth.position(t)?);
            errors.extend(ends.filter_map(error));
        }
    }
    for errors in &errors {
        score.take(errors, truth.sd_m);
        score.figures.push(quantile(errors.iter().map(|e: &Point| e.value.norm()), 0.5));
    }
    score.samples = all.len();
    Ok(score)
}

/// Consistency and RMS of the valid moving samples, and the headline.
fn scored(case: &Case, truth: &Truth, ran: &Ran, all: &[(bool, Point)]) -> Result<Score> {
    let mut score = Score { exit: ran.exit, ..Score::default() };
    let moving: Vec<Point> = all.iter().filter(|e| e.0).map(|e| e.1).collect();
    score.take(&moving, truth.sd_m);
    if ran.exit != 0 {
        // A refused recording has samples, none of them valid.
        let times = case.table(case.recording, Source::Command)?.times()?;
        score.samples = times.into_iter().filter(|t| truth.is_moving(*t)).count();
        score.valid[1] = score.samples;
    }
    score.figures.push(rms(moving.iter().filter(|e| e.valid).map(|e| e.value.norm())));
    let sigma = ran.data["final_sigma_m"].as_array().into_iter().flatten();
    let sigma_m = sigma.filter_map(Value::as_f64).fold(0.0, f64::hypot);
    let last = all.last().filter(|e| sigma_m > 0.0 && e.1.valid);
    score.headline_sigma = last.map(|e| e.1.value.norm() / sigma_m);
    Ok(score)
}

pub fn track(case: &Case, source: Source) -> Result<Score> {
    let truth = case.truth()?;
    let ran = case.path(source, &truth, &[])?;
    let mut score = scored(case, &truth, &ran, &errors(&ran.points, &truth, Alignment::Heading))?;
    let length_error = |found: &Value| {
        let end = |key: &str| truth.position(found[key].as_f64()?);
        Some((found["length_m"].as_f64()? - (end("to_s")? - end("from_s")?).norm()).abs())
    };
    if let Some(moves) = ran.data["moves"].as_array() {
        score.figures.push(quantile(moves.iter().filter_map(length_error), 0.5));
    }
    Ok(score)
}

pub fn walk(case: &Case, source: Source) -> Result<Score> {
    let truth = case.truth()?;
    let ran = case.path(source, &truth, &[])?;
    let all = errors(&ran.points, &truth, Alignment::Yaw);
    let mut score = scored(case, &truth, &ran, &all)?;
    score.figures = all
        .last()
        .map_or(vec![f64::NAN; 2], |end| vec![end.1.value.norm(), end.1.value.xy().norm()]);
    Ok(score)
}

pub fn ranges(case: &Case, source: Source) -> Result<Score> {
    let truth = case.truth()?;
    let mut ran = case.path(source, &truth, &[])?;
    if case.entry.planar {
        ran.points.iter_mut().for_each(|p| (p.value.z, p.sigma.z) = (0.0, 0.0));
    }
    let is_given = case.entry.planar || case.entry.bias_m.is_some();
    let rigid = Alignment::Rigid(case.entry.shift_s.unwrap_or(0.0));
    let all = errors(&ran.points, &truth, if is_given { Alignment::Given } else { rigid });
    let mut score = scored(case, &truth, &ran, &all)?;
    if let (Some(bias_m), Some(anchors)) = (case.entry.bias_m, ran.data["anchors"].as_array()) {
        let ratios = all.iter().flat_map(|e| e.1.value.component_div(&e.1.sigma).data.0[0]);
        let off = |anchor: &Value| {
            let bias = &anchor["bias_m"];
            Some((bias["value"].as_f64()? - bias_m).abs() / bias["sigma"].as_f64()?)
        };
        let worst = anchors.iter().filter_map(off).fold(0.0, f64::max);
        score.figures.extend([rms(ratios), worst]);
    }
    Ok(score)
}
