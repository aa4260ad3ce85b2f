//! `wimu navigate A B --relative`: angle and rotation between two units.

mod live;

use serde_json::{Value, json};
use wimu_host::relative::{RelativeChoice, RelativePath, relative};
use wimu_host::{Input, Result};

use super::inertial;
use crate::arguments::Navigate;
use crate::output::{Output, usage};

/// Computes, prints and writes the angle.
pub fn run(arguments: &Navigate, output: &Output) -> Result<()> {
    let [other] = arguments.boards.as_slice() else {
        return Err(usage(
            "--relative takes two recordings",
            "wimu navigate A.csv B.csv --relative",
        ));
    };
    let files = [&arguments.input, other];
    let links = files.map(|file| Input::parse(&file.to_string_lossy()));
    let choice = RelativeChoice { hinge: arguments.aids.setup.hinge };
    if let [Ok(Input::Link(a)), Ok(Input::Link(b))] = links {
        return live::run(arguments, [a, b], choice, output);
    }
    let calibrations = &arguments.with;
    if calibrations.len() == 1 || calibrations.len() > 2 {
        return Err(usage(
            "--relative takes a calibration for each unit",
            "give --with A.json --with B.json, or none",
        ));
    }
    let a = inertial::unit(arguments, files[0], calibrations.first())?;
    let b = inertial::unit(arguments, files[1], calibrations.get(1))?;
    let found = relative([&a, &b], &choice)?;
    let sources = files.map(|file| wimu_host::untrusted::name(file));
    present(arguments, sources, found, output)
}

/// Prints and writes a result.
fn present(
    arguments: &Navigate,
    sources: [String; 2],
    found: RelativePath,
    output: &Output,
) -> Result<()> {
    let text = found.text();
    output.print(text.trim_end());
    output.findings(&found.findings);
    if let Some(file) = &arguments.output {
        found.write(file)?;
        output.print(format!("wrote {} rows to {}", found.points.len(), file.display()));
    }
    if let Some(file) = &arguments.report {
        found.page(&sources.join(" and "), &text).write(file)?;
        output.print(format!("wrote {}", file.display()));
    }
    output.object(&object(sources, found));
    Ok(())
}

/// The rotation, as `--json` prints it: quaternions W, X, Y, Z from the axes of B to those of A.
fn object(sources: [String; 2], found: RelativePath) -> Value {
    let last = found.valid().next_back();
    let ends = found.points.first().zip(found.points.last());
    let [least, largest] = found.range_rad().map(f64::to_degrees);
    json!({
        "sources": sources,
        "duration_s": ends.map_or(0.0, |(first, last)| last.time_s - first.time_s),
        "final_angle_deg": last.map_or(f64::NAN, |p| p.angle_rad.to_degrees()),
        "final_sigma_deg": last.map_or(f64::NAN, |p| p.sigma_rad.to_degrees()),
        "final_quaternion": last.map(|p| p.quaternion).unwrap_or_default(),
        "least_angle_deg": least,
        "largest_angle_deg": largest,
        "median_sigma_deg": found.median_sigma_rad().to_degrees(),
        "valid_share": found.valid().count() as f64 / found.points.len() as f64,
        "accurate": found.is_accurate(),
        "hinge": found.hinge,
        "lever_arms_m": found.lever_arms_m,
        "joint_nis": found.joint_nis,
        "clock": found.clock,
    })
}
