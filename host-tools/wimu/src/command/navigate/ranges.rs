//! `wimu navigate --setup anchors=…`: ranges, alone, with wheel odometry or with an inertial sensor.

use std::path::Path;

use wimu_host::localization::{LocalizationChoice, RangePrior, RangeRecording, localize};
use wimu_host::{Code, Result};

use super::inertial;
use crate::arguments::{Navigate, Smoothing};
use crate::command::not_over_input;
use crate::output::Output;

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
    let mut recording =
        RangeRecording::read(ranges, anchors)?.delayed(arguments.aids.setup.fix_delay_s);
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
        limit_m: arguments.limit_m(),
        smooth: arguments.smooth == Smoothing::On,
        start: arguments.start,
        prior: arguments.aids.setup.range_errors.map(prior),
        survey_m: arguments.aids.setup.survey_m,
        lever_arm_m: arguments.aids.setup.lever_arm_m.unwrap_or_default(),
    };
    let path = localize(&recording, &choice)?;
    let source = wimu_host::untrusted::name(&arguments.input);
    let found = inertial::present(arguments, path, None, None, source, output)?;
    output.object(&found);
    Ok(())
}
