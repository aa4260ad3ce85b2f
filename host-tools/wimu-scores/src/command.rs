//! The command, in this process, and the points that it writes.

use std::path::Path;
use std::process::ExitCode;
use std::{fs, io};

use nalgebra::{UnitQuaternion, Vector3};
use serde_json::Value;
use wimu::Output;

use crate::table::{ENU, Result, Table, XYZ};

/// What an estimator put out.
#[derive(Default)]
pub struct Ran {
    pub exit: u8,
    pub data: Value,
    pub points: Vec<Point>,
}

/// Runs `wimu ARGUMENTS --json`; its output goes through a file in the folder.
pub fn run(arguments: &[String], folder: &Path) -> Result<Ran> {
    let file = folder.join("output.json");
    let mut output = Output::to(fs::File::create(&file)?, io::sink());
    let code = wimu::run(arguments.iter().cloned().chain(["--json".to_owned()]), &mut output);
    let exit = (0..u8::MAX).find(|exit| ExitCode::from(*exit) == code).unwrap_or(u8::MAX);
    let envelope: Value = serde_json::from_str(&fs::read_to_string(&file)?)?;
    if exit == 1 || exit == 2 {
        return Err(format!("wimu {}: {}", arguments.join(" "), envelope["problems"]).into());
    }
    Ok(Ran { exit, data: envelope["data"].clone(), points: Vec::new() })
}

/// Position or another vector at a time, with standard deviations, NaN where there are none.
#[derive(Clone, Copy)]
pub struct Point {
    pub time_s: f64,
    pub value: Vector3<f64>,
    pub sigma: Vector3<f64>,
    pub attitude: Option<UnitQuaternion<f64>>,
    pub valid: bool,
}

impl Point {
    pub fn new(time_s: f64, value: Vector3<f64>) -> Self {
        Self { time_s, value, sigma: Vector3::repeat(f64::NAN), attitude: None, valid: true }
    }
}

/// Reads what `wimu navigate -o` wrote: an angle, or the angular rate of an array, or positions.
pub fn points(file: &Path, name: &str) -> Result<Vec<Point>> {
    let table = Table::read(file)?;
    let (value, axes, sigma) = match name {
        "Angle" => ("Angle (deg)", XYZ, "Angle Sigma (deg)"),
        "Angular Rate" => ("Angular Rate # (rad/s)", XYZ, "Angular Rate Sigma # (rad/s)"),
        _ => ("Position # (m)", ENU, "Sigma # (m)"),
    };
    let (values, sigmas) = (table.vectors(value, axes)?, table.vectors(sigma, axes)?);
    let (attitudes, valid) = (table.attitudes("Quaternion")?, table.numbers("Valid")?);
    let point = |(k, time_s): (usize, f64)| Point {
        sigma: sigmas[k],
        attitude: Some(attitudes[k]),
        valid: valid[k] == 1.0,
        ..Point::new(time_s, values[k])
    };
    Ok(table.times()?.into_iter().enumerate().map(point).collect())
}

/// The value at a time, linear between points; none outside. Attitude and σ are those of the next point.
pub fn at(points: &[Point], time_s: f64) -> Option<Point> {
    let next = points.partition_point(|point| point.time_s < time_s);
    let b = points.get(next)?;
    if b.time_s == time_s {
        return Some(*b);
    }
    let a = points.get(next.checked_sub(1)?)?;
    let part = (time_s - a.time_s) / (b.time_s - a.time_s);
    let value = a.value + (b.value - a.value) * part;
    Some(Point { time_s, value, valid: a.valid && b.valid, ..*b })
}

/// The error at a time, as a point.
pub fn error_at(points: &[Point], time_s: f64, truth: Vector3<f64>) -> Option<Point> {
    at(points, time_s).map(|point| Point { value: point.value - truth, ..point })
}
