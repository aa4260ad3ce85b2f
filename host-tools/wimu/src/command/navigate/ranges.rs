//! `wimu navigate --anchors`: ranges, alone, with wheel odometry or with an inertial sensor.

use std::path::Path;

use serde::Serialize;
use wimu_host::digits::{east_north_up, significant};
use wimu_host::inertial::Method;
use wimu_host::localization::{
    AnchorFound, Localization, LocalizationChoice, Noise, Parameter, RangePrior, RangeRecording,
    localize,
};
use wimu_host::{Code, Result};

use super::inertial;
use crate::arguments::{Navigate, Smoothing};
use crate::command::not_over_input;
use crate::output::Output;

/// A path from ranges, as `--json` prints it.
#[derive(Serialize)]
struct Found {
    source: String,
    method: Method,
    smoothed: bool,
    duration_s: f64,
    distance_m: f64,
    final_position_m: [f64; 3],
    final_sigma_m: [f64; 3],
    /// Median standard deviation of the position in space, m.
    median_sigma_m: f64,
    valid_share: f64,
    noise: Noise,
    anchors: Vec<AnchorFound>,
    odometer_scale: Option<Parameter>,
    /// Ranges are measured so much later than their times say.
    delay_s: Option<Parameter>,
}

/// Localizes, prints and writes.
pub fn run(arguments: &Navigate, anchors: &Path, output: &Output) -> Result<()> {
    let others = [&arguments.aids.ranges, &arguments.odometry];
    for written in [&arguments.output, &arguments.report] {
        let others = others.into_iter().flatten().map(|file| file.as_path());
        for read in others.chain([anchors]) {
            not_over_input(read, written.as_deref())?;
        }
    }
    let ranges = arguments.aids.ranges.as_ref().unwrap_or(&arguments.input);
    let mut recording = RangeRecording::read(ranges, anchors)?.delayed(arguments.aids.fix_delay);
    if recording.planar {
        let text = "the anchors have no Position U (m): all heights are zero";
        recording.findings.push(Code::Navigation.note(text));
    }
    if arguments.aids.ranges.is_some() {
        let calibration = arguments.with.first();
        let motion = inertial::unit(arguments, &arguments.input, calibration)?;
        recording.findings.extend(motion.findings.iter().cloned());
        recording.motion = Some(motion);
    }
    if let Some(odometry) = &arguments.odometry {
        recording = recording.with_odometry(odometry)?;
    }
    let prior = |errors| RangePrior::of(&recording).with_errors(errors);
    let choice = LocalizationChoice {
        limit_m: arguments.limit,
        smooth: arguments.smooth == Smoothing::On,
        start: arguments.start,
        prior: arguments.aids.range_errors.map(prior),
        survey_m: arguments.survey,
        lever_arm_m: arguments.aids.lever_arm.unwrap_or_default(),
    };
    let found = localize(&recording, &choice)?;
    let source = wimu_host::untrusted::name(&arguments.input);
    let text = text(&found);
    output.print(text.trim_end());
    output.findings(&found.path.findings);
    if let Some(file) = &arguments.output {
        found.path.write(file)?;
        output.print(format!("wrote {}", file.display()));
    }
    if let Some(file) = &arguments.report {
        found.page(&source, &text).write(file)?;
        output.print(format!("wrote {}", file.display()));
    }
    output.object(&object(source, found));
    Ok(())
}

fn object(source: String, found: Localization) -> Found {
    let path = &found.path;
    let last = path.points.last();
    Found {
        source,
        method: path.method,
        smoothed: path.smoothed,
        duration_s: path.duration_s(),
        distance_m: path.distance_m(),
        final_position_m: last.map(|p| p.position_m).unwrap_or_default(),
        final_sigma_m: last.map(|p| p.sigma_m()).unwrap_or_default(),
        median_sigma_m: median_sigma_m(&found),
        valid_share: path.valid_share(),
        noise: found.noise,
        odometer_scale: found.odometer_scale,
        delay_s: found.delay_s,
        anchors: found.anchors,
    }
}

fn median_sigma_m(found: &Localization) -> f64 {
    let mut sigmas: Vec<f64> = found.path.points.iter().map(|p| p.sd_m()).collect();
    sigmas.sort_by(f64::total_cmp);
    sigmas.get(sigmas.len() / 2).copied().unwrap_or(f64::NAN)
}

/// The result first, then the calibration.
fn text(found: &Localization) -> String {
    let path = &found.path;
    let mut text = format!("position: ± {:.3} m (1 σ in space, median)", median_sigma_m(found));
    if let Some(point) = path.points.iter().rfind(|p| p.valid) {
        let (at, sd) = (east_north_up(point.position_m), point.sd_m());
        text += &format!("; last: {at} m ± {sd:.3} m at {:.2} s", point.time_s);
    }
    let kind = match path.method {
        Method::Odometry => "ranges and wheel odometry",
        Method::RangesInertial => "ranges and a gyroscope",
        _ => "ranges",
    };
    text += &format!(
        "\npath: {:.2} m in {:.1} s, from {kind}{}; {:.0} % of the points are valid (σ below {} m)\n",
        path.distance_m(),
        path.duration_s(),
        if path.smoothed { ", smoothed" } else { "" },
        100.0 * path.valid_share(),
        path.limit_m
    );
    let noise = &found.noise;
    text += &format!(
        "ranges: noise {} m, correlated error {} m over 1 s, {} % without line of sight (estimated)\n",
        significant(noise.white_m, 2),
        significant(noise.correlated_m, 2),
        significant(100.0 * noise.blocked, 2)
    );
    text += "anchor  ranges  bias, m           scale error, %    blocked, %\n";
    for anchor in &found.anchors {
        text += &format!(
            "{:<7} {:<7} {:<17} {:<17} {:.0}\n",
            anchor.id,
            anchor.ranges,
            shown(anchor.bias_m, 1.0),
            shown(anchor.scale, 100.0),
            100.0 * anchor.blocked
        );
        if let Some(sd) = anchor.position_sd_m {
            let axis = |k: usize| format!("{:+.3} ± {:.3}", anchor.position_m[k], sd[k]);
            text += &format!("        at E {} N {} U {} m\n", axis(0), axis(1), axis(2));
        }
    }
    if let Some(scale) = found.odometer_scale {
        text += &format!("scale error of the odometer: {} %\n", shown(Some(scale), 100.0));
    }
    if let Some(delay) = found.delay_s {
        let other = match path.method {
            Method::Odometry => "odometry",
            _ => "inertial samples",
        };
        text += &format!("ranges after the {other}: {} ms\n", shown(Some(delay), 1e3));
    }
    text
}

/// Value and standard deviation, marked where the data do not show it.
fn shown(parameter: Option<Parameter>, factor: f64) -> String {
    match parameter {
        None => "-".to_owned(),
        Some(p) => {
            let mark = if p.is_observed() { "" } else { " (prior)" };
            format!("{:+.3} ± {:.3}{mark}", p.value * factor, p.sigma * factor)
        }
    }
}
