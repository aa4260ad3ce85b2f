//! `wimu demo --localize`: simulated walks with ranges, a unit on a shoe, and position fixes.

use std::path::Path;
use std::time::Instant;

use serde::Serialize;
use wimu_host::digits::significant;
use wimu_host::document::Document;
use wimu_host::inertial::{InertialPath, PathPoint, consistency};
use wimu_host::localization::AnchorFound;
use wimu_host::motion::nees;
use wimu_host::{Result, chart};
use wimu_sim::walk::{carried_m, distance_m};

use super::walks::{CORNERS_M, FIX_M, WALK_S, Walks};
use crate::arguments::Demo;
use crate::output::Output;

/// The first part of the walk is not scored, s: the filter begins.
const BEGIN_S: f64 = 2.0;
/// Interval of the positions of which NEES is taken, s: three times the correlation time of the errors.
const INDEPENDENT_S: f64 = 3.0;
/// Error of a path against the truth.
#[derive(Serialize)]
struct Score {
    /// RMS error of the position in space, m.
    rmse_m: f64,
    /// Median standard deviation of the position in space, m.
    sigma_m: f64,
    /// Fraction of independent positions whose NEES is below its 95 % point.
    nees_below_95: f64,
}

#[derive(Serialize)]
struct Bias {
    anchor: String,
    true_m: f64,
    value_m: f64,
    sigma_m: f64,
}

#[derive(Serialize)]
struct Demonstrated {
    seed: u64,
    ranges: usize,
    /// With the biases of the anchors taken as zero.
    before: Score,
    /// With the biases estimated from the same ranges.
    after: Score,
    biases: Vec<Bias>,
    /// Fraction of the ranges without line of sight: true, and found.
    blocked: [f64; 2],
    foot_path_m: f64,
    /// Error at the end of the closed path on foot, and its standard deviation, m.
    foot_end_m: [f64; 2],
    /// The same without stances: integration alone, m.
    foot_integrated_m: f64,
    fixes: usize,
    /// RMS error of the path on foot, m: without fixes, and with them.
    fixes_rmse_m: [f64; 2],
    report: String,
}

impl Demonstrated {
    fn of(walks: &Walks, arguments: &Demo) -> Self {
        let ranges = &walks.ranges;
        let score = |path: &InertialPath| {
            let from = path.points.partition_point(|p| p.time_s < BEGIN_S);
            Score::of(&path.points[from..], |p| carried_m(p.time_s))
        };
        let anchors = || walks.after.ranging.iter().flat_map(|ranging| &ranging.anchors);
        let biases = anchors().zip(&ranges.biases_m);
        let bias = |(anchor, true_m): (&AnchorFound, &f64)| {
            let found = anchor.bias_m?;
            Some(Bias {
                anchor: anchor.id.clone(),
                true_m: *true_m,
                value_m: found.value,
                sigma_m: found.sigma,
            })
        };
        let all = ranges.blocked.len() as f64;
        let hidden = ranges.blocked.iter().filter(|blocked| **blocked).count() as f64;
        let found: f64 = anchors().map(|a| a.blocked * a.ranges as f64).sum();
        let end = |path: &InertialPath| {
            let last = path.points.last().zip(walks.truth().last());
            last.map_or(f64::NAN, |(p, truth)| distance_m(p.position_m, truth))
        };
        let rmse = |path: &InertialPath| {
            let pairs = path.points.iter().zip(walks.truth());
            rms(pairs.map(|(p, truth)| distance_m(p.position_m, truth)))
        };
        let corners = CORNERS_M.windows(2);
        let sides = corners.map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]));
        Self {
            seed: arguments.seed,
            ranges: ranges.recording.ranges.len(),
            before: score(&walks.before),
            after: score(&walks.after),
            biases: biases.filter_map(bias).collect(),
            blocked: [hidden / all, found / all],
            foot_path_m: sides.sum(),
            foot_end_m: [
                end(&walks.foot),
                walks.foot.points.last().map_or(f64::NAN, PathPoint::sd_m),
            ],
            foot_integrated_m: end(&walks.integrated),
            fixes: walks.fixes.aids.len(),
            fixes_rmse_m: [rmse(&walks.foot), rmse(&walks.fixed)],
            report: arguments.report.display().to_string(),
        }
    }
}

impl Score {
    fn of(points: &[PathPoint], truth: impl Fn(&PathPoint) -> [f64; 3]) -> Self {
        let mut sigmas: Vec<f64> = points.iter().map(PathPoint::sd_m).collect();
        sigmas.sort_by(f64::total_cmp);
        let mut next_s = f64::NEG_INFINITY;
        let mut independent = Vec::new();
        for point in points {
            if point.time_s >= next_s {
                next_s = point.time_s + INDEPENDENT_S;
                let truth = truth(point);
                let error = [0, 1, 2].map(|axis| point.position_m[axis] - truth[axis]);
                independent.push(nees(error, point.covariance_m2));
            }
        }
        Self {
            rmse_m: rms(points.iter().map(|p| distance_m(p.position_m, truth(p)))),
            sigma_m: sigmas.get(sigmas.len() / 2).copied().unwrap_or(f64::NAN),
            nees_below_95: consistency(&independent).map_or(f64::NAN, |(_, below)| below),
        }
    }
}

/// Root mean square.
fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v * v, count + 1.0));
    f64::sqrt(sum / count)
}

pub fn run(arguments: &Demo, folder: Option<&Path>, output: &Output) -> Result<()> {
    let began = Instant::now();
    let walks = Walks::new(arguments.seed)?;
    let found = Demonstrated::of(&walks, arguments);
    let story = story(&found);
    for line in &story {
        output.print(line);
    }
    let charts = walks.charts();
    let mut page = Document::new("wimu demo --localize");
    page.result("Simulated walks with range anchors, a unit on a shoe, and position fixes");
    let three = |value: f64| format!("{} m", significant(value, 3));
    page.key("ranges before calibration, RMS", &three(found.before.rmse_m));
    page.key("ranges after calibration, RMS", &three(found.after.rmse_m));
    page.printed(&story.join("\n"));
    for (_, chart) in &charts {
        page.chart(chart);
    }
    page.write(&arguments.report)?;
    if let Some(folder) = &arguments.pictures {
        chart::write_all(folder, &charts)?;
    }
    if let Some(folder) = folder {
        walks.write(folder)?;
    }
    output.print(format!(
        "{:.1} s. Pictures: {}.",
        began.elapsed().as_secs_f64(),
        arguments.report.display()
    ));
    output.object(&found);
    Ok(())
}

/// The steps, one line each; the result first.
fn story(found: &Demonstrated) -> Vec<String> {
    let three = |value: f64| significant(value, 3);
    let percent = |part: f64| significant(100.0 * part, 3);
    let (before, after) = (&found.before, &found.after);
    let located = |score: &Score| {
        format!(
            "position error {} m, σ {} m; NEES below its 95 % point at {} % of the positions",
            three(score.rmse_m),
            three(score.sigma_m),
            percent(score.nees_below_95)
        )
    };
    let biases = &found.biases;
    let truths: Vec<String> = biases.iter().map(|b| format!("{:+.0}", 1e3 * b.true_m)).collect();
    let of = |value: fn(&Bias) -> f64| three(rms(biases.iter().map(value)));
    vec![
        format!(
            "Position error {} m after the ranges calibrated themselves, {} m before (RMS in space).",
            three(after.rmse_m),
            three(before.rmse_m)
        ),
        format!(
            "A simulated hall with six anchors (seed {}). Their ranges have errors that wimu does not know:",
            found.seed
        ),
        format!(
            "  bias {} mm, reflections, noise; {} % have no line of sight and are up to 3 m too long.",
            truths.join(" "),
            percent(found.blocked[0])
        ),
        format!("1 measure    {} ranges along a walk of {WALK_S} s", found.ranges),
        format!("2 locate     biases taken as zero: {}", located(before)),
        format!(
            "3 calibrate  {} biases from the same ranges: error {} m before, {} m after, σ {} m (RMS)",
            biases.len(),
            of(|b| b.true_m),
            of(|b| b.value_m - b.true_m),
            of(|b| b.sigma_m)
        ),
        format!("4 locate     biases estimated: {}", located(after)),
        format!(
            "5 blocked    {} % of the ranges found without line of sight, true {} %",
            percent(found.blocked[1]),
            percent(found.blocked[0])
        ),
        format!(
            "6 foot       a unit on a shoe, {} m back to the start: error at the end {} m ± {} m; integration alone {} m",
            three(found.foot_path_m),
            three(found.foot_end_m[0]),
            three(found.foot_end_m[1]),
            three(found.foot_integrated_m)
        ),
        format!(
            "7 fixes      the same with {} position fixes ± {FIX_M} m: position error {} m, without them {} m (RMS)",
            found.fixes,
            three(found.fixes_rmse_m[1]),
            three(found.fixes_rmse_m[0])
        ),
    ]
}
