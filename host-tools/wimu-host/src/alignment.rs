//! Alignment: the rotation from the sensor's axes to the body's, from rests and a straight move.

use serde_json::json;
use wimu_calib::{KnownDirection, Pose, align, straight_move};
use wimu_model::ParameterSet;

use crate::calibration::{Calibration, CalibrationReport, describe};
use crate::problem::Outcome;
use crate::recording::Samples;
use crate::{Code, Problem, Result};

/// Largest number of rests that are listed.
const MAX_RESTS: usize = 64;
/// Smallest mean acceleration of an eighth of a second that counts as a move, m/s². Chosen.
const LEAST_MOVE_MPS2: f64 = 0.15;
/// Eighths of a second by which a move may begin before and end after that threshold.
const GENTLE_BLOCKS: usize = 2;
/// Eighths of a second of rest before and after a move, at least.
const STAND_BLOCKS: usize = 8;
/// Largest difference of gravity between rests of one attitude, m/s²: 3°.
const SAME_ATTITUDE_MPS2: f64 = 0.5;

/// A body axis that points up at a rest: `z`, `-x`, ….
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyAxis([f64; 3]);

impl std::str::FromStr for BodyAxis {
    type Err = Problem;

    fn from_str(text: &str) -> Result<Self> {
        let (sign, axis) = match text.trim().strip_prefix('-') {
            Some(rest) => (-1.0, rest),
            None => (1.0, text.trim().trim_start_matches('+')),
        };
        let place = ["x", "y", "z"]
            .iter()
            .position(|name| name.eq_ignore_ascii_case(axis))
            .ok_or_else(|| {
                Code::Usage.error(
                    format!("`{text}` is not an axis of the body"),
                    "name the body axis that points up at each rest: x, -x, y, -y, z or -z",
                )
            })?;
        let mut up = [0.0; 3];
        up[place] = sign;
        Ok(Self(up))
    }
}

/// How to align.
#[derive(Clone, Debug)]
pub struct AlignOptions {
    /// The body axis that points up at each rest, in order.
    pub up: Vec<BodyAxis>,
    /// Indices of these rests, from 0, in order; `None` if there are no others.
    pub rests: Option<Vec<usize>>,
    /// Whether the body was moved straight along its x axis after the first of them.
    pub forward: bool,
    /// Accuracy of the placement and of the direction of the move, rad, 1 σ.
    pub placement_sd_rad: f64,
}

/// Aligns a sensor that is corrected by `calibration` with its body; the result replaces the alignment in its parameters.
///
/// Data that do not support an answer give a report with status `refused`.
///
/// # Errors
/// Those of [`Calibration::models`] and [`SensorCalibration::compile`](crate::calibration::SensorCalibration::compile).
pub fn alignment(
    data: &Samples<'_>,
    calibration: &Calibration,
    options: &AlignOptions,
) -> Result<CalibrationReport> {
    let set = &calibration.models()?;
    let forces = data.corrected(calibration.sensor())?;
    let rests = data.rests(&forces);
    let mut outcome = Outcome { findings: data.findings(), ..Outcome::default() };
    outcome.findings.extend(data.temperature_finding(set));
    let found = directions(data, &forces, &rests, options)
        .and_then(|known| align(&known).map_err(|refusal| refusal.to_string()));
    let listed = &rests[..rests.len().min(MAX_RESTS)];
    let span_s = |rest: &Pose| {
        let last = rest.first_sample + u64::from(rest.samples).saturating_sub(1);
        [rest.first_sample, last].map(|index| data.since_start_s(index as usize))
    };
    let mut numbers = json!({
        "source": data.name,
        "rests": rests.len(),
        "found": Vec::from_iter(listed.iter().map(|rest| {
            let [from_s, to_s] = span_s(rest);
            json!({ "from_s": from_s, "to_s": to_s, "up_m_s2": rest.mean_mps2 })
        })),
    });
    let mut head = format!("{}: {} rests", data.name, rests.len());
    let (mut lines, mut file) = (Vec::new(), None);
    match found {
        Err(reason) => {
            outcome.refuse(reason);
            lines.extend(listed.iter().enumerate().map(|(k, rest)| {
                let ([x, y, z], [from_s, to_s]) = (rest.mean_mps2, span_s(rest));
                format!(
                    "rest {k}: {from_s:.1} to {to_s:.1} s, up is {x:+.2} {y:+.2} {z:+.2} m/s² in sensor axes"
                )
            }));
        }
        Ok(found) => {
            let (alignment, alignment_covariance) = (found.alignment, Some(found.covariance));
            let aligned = ParameterSet { alignment, alignment_covariance, ..*set };
            let (sd, residual) = (found.covariance, found.residual_rad.to_degrees());
            numbers["alignment_wxyz"] = json!(alignment.quaternion());
            numbers["sd_deg"] = json!([0, 1, 2].map(|axis| sd.sd(axis).to_degrees()));
            numbers["residual_deg"] = json!(residual);
            head += &format!(", the directions agree to {residual:.2}°");
            lines = describe(&aligned);
            let mut after = calibration.clone().of_device(data.info().device_id);
            let sensor = after.sensor_mut();
            (sensor.alignment, sensor.alignment_covariance) = (alignment, alignment_covariance);
            file = Some(after);
        }
    }
    let title = format!("Alignment of {}", data.name);
    let mut report = CalibrationReport::new(title, outcome, head, lines, numbers, file);
    report.poses = rests;
    Ok(report)
}

/// The known directions at the rests and between them.
fn directions(
    data: &Samples<'_>,
    forces: &[[f64; 3]],
    rests: &[Pose],
    options: &AlignOptions,
) -> Result<Vec<KnownDirection>, String> {
    let needed = options.up.len().max(1);
    if rests.len() < needed {
        return Err(format!(
            "{} rests found, {needed} are needed: hold the body still for two seconds at each",
            rests.len()
        ));
    }
    // The rest after the move is the one before it, repeated.
    let moved = options.forward && rests.len() > needed && again(rests, 0).is_some();
    let chosen: Vec<usize> = match &options.rests {
        Some(chosen) => chosen.clone(),
        None if rests.len() > needed + usize::from(moved) => {
            return Err(format!(
                "{} rests found, --up names {needed}: name all in order{}, or select those \
                     with --rests, counted from 0",
                rests.len(),
                if options.forward {
                    " (except the one after the move, within 3° of the one before it)"
                } else {
                    ""
                }
            ));
        }
        None => (0..needed + usize::from(moved)).filter(|rest| !(moved && *rest == 1)).collect(),
    };
    let mut known = Vec::new();
    for (up, chosen) in options.up.iter().zip(&chosen) {
        let rest = rests.get(*chosen).ok_or_else(|| {
            let last = rests.len() - 1;
            format!("there is no rest {chosen}: the rests are 0 to {last}")
        })?;
        known.push(KnownDirection {
            sensor: rest.mean_mps2,
            body: up.0,
            sd_rad: options.placement_sd_rad,
        });
    }
    if options.forward {
        let first = chosen.first().copied().unwrap_or(0);
        let (sensor, sd) = forward(data, forces, rests, first)?;
        known.push(KnownDirection {
            sensor,
            body: [1.0, 0.0, 0.0],
            sd_rad: sd.hypot(options.placement_sd_rad),
        });
    }
    Ok(known)
}

/// The rest after `first`, if it has the same attitude: that after a move with a large acceleration.
fn again(rests: &[Pose], first: usize) -> Option<&Pose> {
    let (rest, next) = (rests.get(first)?, rests.get(first + 1)?);
    let difference = |k: usize| next.mean_mps2[k] - rest.mean_mps2[k];
    let squares: f64 = (0..3).map(|k| difference(k).powi(2)).sum();
    (squares.sqrt() < SAME_ATTITUDE_MPS2).then_some(next)
}

/// The direction of the move after rest `first`, in sensor axes, and its standard deviation, rad.
///
/// A straight move does not change the attitude. The stationarity detector finds the rests before and after it as one
/// after a move with a small acceleration, and as two otherwise.
fn forward(
    data: &Samples<'_>,
    forces: &[[f64; 3]],
    rests: &[Pose],
    first: usize,
) -> Result<([f64; 3], f64), String> {
    let Some(rest) = rests.get(first) else {
        return Err("no rest was found before the move: hold it still for two seconds".to_owned());
    };
    let next = again(rests, first);
    let block = ((data.rate_hz as usize) / 8).max(1);
    let past = |rest: &Pose| rest.first_sample as usize + rest.samples as usize;
    let begins = |rest: &Pose| rest.first_sample as usize;
    let earlier = first.checked_sub(1).and_then(|earlier| rests.get(earlier));
    let start = earlier.map_or(0, past);
    let later = rests.get(first + 1 + usize::from(next.is_some()));
    let end = later.map_or(forces.len(), begins);
    let part = forces.get(start..end).unwrap_or(&[]);
    let still: Vec<bool> = part
        .chunks(block)
        .map(|block| {
            let mean = mean(block);
            [Some(rest), next].into_iter().flatten().any(|rest| {
                let off: f64 = (0..3).map(|k| (mean[k] - rest.mean_mps2[k]).powi(2)).sum();
                off.sqrt() <= LEAST_MOVE_MPS2
            })
        })
        .collect();
    if still.iter().all(|still| *still) {
        return Err("no move was found: push the body straight ahead, briskly".to_owned());
    }
    // The ends below the threshold belong to the move.
    let mut stands = Vec::new();
    let mut at = 0;
    for run in still.chunk_by(|a, b| a == b) {
        let (from, to) = (at + GENTLE_BLOCKS, at + run.len().saturating_sub(GENTLE_BLOCKS));
        at += run.len();
        if run.first() == Some(&true) && run.len() >= GENTLE_BLOCKS + STAND_BLOCKS {
            stands.push((from * block, to * block, run.len()));
        }
    }
    // A slow move may look still for less than two seconds.
    let mut following = stands.iter().skip(1);
    let after = following
        .clone()
        .find(|(_, _, blocks)| *blocks >= 2 * STAND_BLOCKS)
        .or(following.next_back());
    let (Some((_, from, before)), Some((to, _, blocks))) = (stands.first(), after) else {
        return Err(
            "no rest of two seconds before and after the move, at one attitude: record it again"
                .to_owned(),
        );
    };
    let second = STAND_BLOCKS * block;
    let before = from - (before - GENTLE_BLOCKS).min(2 * STAND_BLOCKS) * block;
    let after = (to + ((blocks - GENTLE_BLOCKS) * block).min(2 * second)).min(part.len());
    if data.has_gap(start + before + 1..start + after) {
        return Err("samples are missing during the move: record it again".to_owned());
    }
    straight_move(
        mean(&part[before..*from]),
        mean(&part[*to..after]),
        part[*from..*to].iter().copied(),
        data.rate_hz,
    )
    .map_err(|refusal| refusal.to_string())
}

fn mean(values: &[[f64; 3]]) -> [f64; 3] {
    let count = values.len().max(1) as f64;
    [0, 1, 2].map(|axis| values.iter().map(|v| v[axis]).sum::<f64>() / count)
}
