//! `wimu navigate` with its own estimators, on CSV files, recordings and arrays.

use std::path::Path;

use serde::Serialize;
use wimu_host::Result;
use wimu_host::calibration::read_model;
use wimu_host::finding::Finding;
use wimu_host::formats;
use wimu_host::inertial::{
    Choice, InertialPath, Method, SlideMove, Zupt, consistency, navigate, settling,
};
use wimu_host::motion::{MotionRecording, TableOptions};

use super::array;
use crate::arguments::{Navigate, NavigateMethod, ZeroVelocity};
use crate::command::array::Refined;
use crate::output::Output;

/// A path, as `--json` prints it.
#[derive(Serialize)]
pub struct Found {
    schema: &'static str,
    status: &'static str,
    source: String,
    method: Method,
    /// Value of the option `--zupt`.
    zupt: &'static str,
    duration_s: f64,
    /// End of the first rest, where position and velocity are zero by definition.
    origin_s: Option<f64>,
    /// Length of the path over the valid samples.
    distance_m: f64,
    final_position_m: [f64; 3],
    final_sigma_m: [f64; 3],
    final_valid: bool,
    valid_share: f64,
    drift: Option<Settling>,
    horizon: Horizon,
    stillness: Option<Still>,
    nees: Option<Nees>,
    /// NEES of an array's angular rate and velocity.
    rate_nees: Option<Nees>,
    velocity_nees: Option<Nees>,
    moves: Vec<MoveFound>,
    refined: Option<Refined>,
    findings: Vec<Finding>,
}

/// Motion time after which the position's standard deviation exceeds a limit or the position is lost; null if never.
#[derive(Serialize)]
struct Horizon {
    to_0_1_m_s: Option<f64>,
    to_1_m_s: Option<f64>,
    limit_m: f64,
    to_limit_s: Option<f64>,
    /// The same with the time in the recording.
    ends: Vec<End>,
}

/// Rests, the largest constant velocity that cannot be excluded there, and its effect on the final position, 1 σ.
#[derive(Serialize)]
struct Still {
    rests: usize,
    lasted_s: f64,
    unseen_m_s: f64,
    unseen_m: f64,
}

#[derive(Serialize)]
struct End {
    limit_m: f64,
    moving_s: f64,
    at_s: f64,
    since_rest_s: Option<f64>,
    lost: bool,
}

#[derive(Serialize)]
struct Nees {
    samples: usize,
    median: f64,
    share_below_7_81: f64,
    /// Heading of the truth: `truth`, or `fitted` to the path if the truth has no heading.
    heading: &'static str,
}

impl Nees {
    fn of(all: &[f64], path: &InertialPath) -> Option<Self> {
        consistency(all).map(|(median, share_below_7_81)| Self {
            samples: all.len(),
            median,
            share_below_7_81,
            heading: if path.heading_fitted {
                "fitted"
            } else {
                "truth"
            },
        })
    }
}

#[derive(Serialize)]
struct MoveFound {
    from_s: f64,
    to_s: f64,
    valid: bool,
    length_m: f64,
    /// With `--zupt cautious` this includes a constant velocity at the rests; `length_sd_if_rested_m` does not.
    length_sd_m: f64,
    length_sd_if_rested_m: f64,
    duration_s: f64,
    turned_deg: f64,
}

/// Bias drift after power-on.
#[derive(Serialize)]
struct Settling {
    rise_m_s2: [f64; 3],
    rise_sd_m_s2: [f64; 3],
    time_s: f64,
    time_sd_s: f64,
}

/// Navigates a recording of one unit, or an array.
pub fn run(arguments: &Navigate, output: Output) -> Result<()> {
    let source = arguments.input.display().to_string();
    let found = match &arguments.geometry {
        Some(geometry) => {
            let (choice, settling) = choice(arguments, Method::Array)?;
            let (path, refined) = array::path(arguments, geometry, &choice, output)?;
            let mut found = present(arguments, &path, &choice, settling, source, output)?;
            found.refined = refined;
            found
        }
        None => {
            let motion = table(arguments, &arguments.input)?;
            one_unit(arguments, &motion, source, output)?
        }
    };
    output.object(&found);
    Ok(())
}

/// Reads a recording of one unit and corrects it.
fn table(arguments: &Navigate, file: &Path) -> Result<MotionRecording> {
    let calibration = arguments.calibration.first();
    let options = TableOptions {
        calibration: calibration.map(|file| read_model(file)).transpose()?,
        sensitivity_lsb_per_g: arguments.sensitivity,
    };
    let recording = formats::load(file, &arguments.reading.options(false))?;
    MotionRecording::of(&recording, &options)
}

/// Computes, prints and writes the path of one unit; returns its object.
pub fn one_unit(
    arguments: &Navigate,
    recording: &MotionRecording,
    source: String,
    output: Output,
) -> Result<Found> {
    let method = match arguments.method {
        NavigateMethod::Strapdown => Method::Strapdown,
        NavigateMethod::Slide => Method::Slide,
        NavigateMethod::Auto => Method::of(recording),
        _ => Method::Tilt,
    };
    let (choice, settling) = choice(arguments, method)?;
    let path = navigate(recording, &choice)?;
    present(arguments, &path, &choice, settling, source, output)
}

fn choice(arguments: &Navigate, method: Method) -> Result<(Choice, Option<Settling>)> {
    let mut choice = Choice {
        method,
        zupt: ZeroVelocity::of(arguments.zupt),
        limit_m: arguments.limit,
        drift: None,
    };
    let Some(file) = &arguments.drift else {
        return Ok((choice, None));
    };
    let fit = settling(&table(arguments, file)?)?;
    choice.drift = Some(fit.drift.settling());
    let settling = Settling {
        rise_m_s2: fit.drift.rise_mps2,
        rise_sd_m_s2: fit.drift.rise_sd_mps2,
        time_s: fit.drift.time_s,
        time_sd_s: fit.time_sd_s,
    };
    Ok((choice, Some(settling)))
}

fn present(
    arguments: &Navigate,
    path: &InertialPath,
    choice: &Choice,
    settling: Option<Settling>,
    source: String,
    output: Output,
) -> Result<Found> {
    let text = text(path, choice);
    output.print(text.trim_end());
    if let Some(fit) = &settling {
        let ([x, y, z], [sx, sy, sz]) = (fit.rise_m_s2, fit.rise_sd_m_s2);
        output.print(format!(
            "bias drift {x:+.4} ± {sx:.4}, {y:+.4} ± {sy:.4}, {z:+.4} ± {sz:.4} m/s², time constant {:.0} ± {:.0} s",
            fit.time_s, fit.time_sd_s
        ));
    }
    output.findings(&path.findings);
    if let Some(file) = &arguments.output {
        path.write(file)?;
        output.print(format!(
            "wrote {} rows to {}",
            path.points.len(),
            file.display()
        ));
    }
    if let Some(file) = &arguments.report {
        path.report(&source, &text, file)?;
        output.print(format!("wrote {}", file.display()));
    }
    Ok(found(path, choice, settling, source))
}

fn found(
    path: &InertialPath,
    choice: &Choice,
    settling: Option<Settling>,
    source: String,
) -> Found {
    let last = path.points.last();
    Found {
        schema: "wimu.path/1",
        status: "ok",
        source,
        method: path.method,
        zupt: match choice.zupt {
            Zupt::Assumed => "cautious",
            Zupt::Stated => "on",
            Zupt::Off => "off",
        },
        duration_s: duration(path),
        origin_s: path.points.get(path.origin).map(|p| p.time_s),
        distance_m: path.distance_m(),
        final_position_m: last.map(|p| p.position_m).unwrap_or_default(),
        final_sigma_m: last.map(|p| p.sigma_m()).unwrap_or_default(),
        final_valid: last.is_some_and(|p| p.valid),
        valid_share: path.valid_share(),
        drift: settling,
        horizon: Horizon {
            to_0_1_m_s: path.horizon_s(0.1),
            to_1_m_s: path.horizon_s(1.0),
            limit_m: choice.limit_m,
            to_limit_s: path.horizon_s(choice.limit_m),
            ends: limits(choice)
                .into_iter()
                .filter_map(|limit_m| {
                    let end = path.horizon(limit_m)?;
                    Some(End {
                        limit_m,
                        moving_s: end.moving_s,
                        at_s: end.at_s,
                        since_rest_s: end.since_rest_s,
                        lost: end.lost,
                    })
                })
                .collect(),
        },
        stillness: path.stillness().map(|found| Still {
            rests: found.rests,
            lasted_s: found.lasted_s,
            unseen_m_s: found.unseen_mps,
            unseen_m: found.unseen_m,
        }),
        nees: Nees::of(&path.nees, path),
        rate_nees: Nees::of(&path.rate_nees, path),
        velocity_nees: Nees::of(&path.velocity_nees, path),
        moves: path
            .moves
            .iter()
            .map(|m| MoveFound {
                from_s: m.from_s,
                to_s: m.to_s,
                valid: m.valid,
                length_m: m.done.length_m,
                length_sd_m: length_sd_m(m, choice),
                length_sd_if_rested_m: m.done.length_sd_m,
                duration_s: m.done.duration_s,
                turned_deg: m.done.turned_rad.to_degrees(),
            })
            .collect(),
        refined: None,
        findings: path.findings.clone(),
    }
}

/// Standard deviation of a move's length, m, under the assumption of `--zupt`.
fn length_sd_m(one: &SlideMove, choice: &Choice) -> f64 {
    let rested = one.done.length_sd_m;
    match choice.zupt {
        Zupt::Assumed => rested.hypot(one.unseen_m),
        _ => rested,
    }
}

/// Position limits of the printed horizons, m.
fn limits(choice: &Choice) -> Vec<f64> {
    let mut limits = vec![0.1, 1.0];
    if !limits.contains(&choice.limit_m) {
        limits.push(choice.limit_m);
    }
    limits
}

fn duration(path: &InertialPath) -> f64 {
    match (path.points.first(), path.points.last()) {
        (Some(first), Some(last)) => last.time_s - first.time_s,
        _ => 0.0,
    }
}

/// The result: the length of the moves, or the last valid position.
fn headline(path: &InertialPath, choice: &Choice) -> String {
    let moves: Vec<&SlideMove> = path.moves.iter().filter(|m| m.valid).collect();
    // The scale factor error is common to all moves, so their deviations add up.
    let length_m: f64 = moves.iter().map(|m| m.done.length_m).sum();
    let sd_m: f64 = moves.iter().map(|m| length_sd_m(m, choice)).sum();
    match (&moves[..], path.points.iter().rfind(|p| p.valid)) {
        ([one], _) => format!(
            "moved {length_m:.3} ± {sd_m:.3} m, from {:.2} to {:.2} s",
            one.from_s, one.to_s
        ),
        ([_, ..], _) => format!(
            "{} moves, {length_m:.3} ± {sd_m:.3} m in total",
            moves.len()
        ),
        ([], Some(point)) if path.method != Method::Slide => {
            let ([e, n, u], sd) = (point.position_m, point.sd_m());
            let ends = path.points.last().is_some_and(|last| last.valid);
            let last = if ends { "" } else { " (the last valid one)" };
            let at = point.time_s;
            format!("position at {at:.2} s{last}: E {e:+.3} N {n:+.3} U {u:+.3} m ± {sd:.3} m")
        }
        _ => "no move of known length".to_owned(),
    }
}

fn text(path: &InertialPath, choice: &Choice) -> String {
    let mut text = String::new();
    text += &format!("{}\n", headline(path, choice));
    text += &format!(
        "{:?}, {:.1} s: path {:.3} m over the {:.0} % of samples that are valid (σ below {} m, no gap since the last rest)\n",
        path.method,
        duration(path),
        path.distance_m(),
        100.0 * path.valid_share(),
        choice.limit_m
    );
    if path.method != Method::Array
        && let Some(origin) = path.points.get(path.origin)
    {
        text += &format!(
            "origin: t = {:.2} s (end of the first rest, velocity taken as zero)\n",
            origin.time_s
        );
    }
    for limit in limits(choice) {
        let Some(end) = path.horizon(limit) else {
            text += &format!("horizon: 1 σ stays below {limit} m\n");
            continue;
        };
        let since = end
            .since_rest_s
            .map(|since| format!(", {since:.1} s after its last rest"))
            .unwrap_or_default();
        let what = if end.lost {
            format!("1 σ is below {limit} m until the position is lost,")
        } else {
            format!("1 σ passes {limit} m")
        };
        let motion = if end.moving_s > 0.0 {
            format!("after {:.1} s of motion", end.moving_s)
        } else {
            "at an apparent rest".to_owned()
        };
        text += &format!("horizon: {what} {motion}, at {:.2} s{since}\n", end.at_s);
    }
    if let Some(found) = path.stillness() {
        let so = match choice.zupt {
            Zupt::Assumed => "± includes it. If the unit was at rest, pass `--zupt on`".to_owned(),
            _ => format!(
                "± does not include it (--zupt on, the default): `--zupt cautious` adds {:.3} m",
                found.unseen_m
            ),
        };
        text += &format!(
            "rests: {} ({:.1} s in total), velocity taken as zero. Constant velocity up to {:.3} m/s cannot be excluded there; {so}\n",
            found.rests, found.lasted_s, found.unseen_mps,
        );
    }
    for (index, one) in path.moves.iter().enumerate() {
        text += &format!(
            "move {} from {:.2} to {:.2} s: {}\n",
            index + 1,
            one.from_s,
            one.to_s,
            if one.valid {
                let rested = one.done.length_sd_m;
                let known = format!(
                    "{:.3} ± {:.3} m",
                    one.done.length_m,
                    length_sd_m(one, choice)
                );
                match choice.zupt {
                    Zupt::Assumed => {
                        format!("{known} (± {rested:.3} m if at rest before and after)")
                    }
                    _ => known,
                }
            } else {
                "length unknown".to_owned()
            }
        );
    }
    let fitted = if path.heading_fitted {
        ", heading fitted"
    } else {
        ""
    };
    for (what, nees) in [
        ("", &path.nees),
        ("angular rate, ", &path.rate_nees),
        ("velocity, ", &path.velocity_nees),
    ] {
        if let Some((median, share)) = consistency(nees) {
            text += &format!(
                "against the truth{fitted}, in motion: {what}NEES median {median:.2} (expected 2.37), below 7.81 in {:.0} % (expected \
                 95 %)\n",
                100.0 * share
            );
        }
    }
    text
}
