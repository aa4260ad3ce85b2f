//! A knee that swings, with a unit on the thigh and one on the shank: writes both recordings, and compares the angle with the
//! truth. `cargo run --release -p wimu-host --example protractor -- FOLDER [--pictures PICTURES]`

mod rig;

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use rig::Rig;
use wimu_host::chart::{Series, write_all};
use wimu_host::csv::CsvWriter;
use wimu_host::motion::MotionRecording;
use wimu_host::relative::{RelativeChoice, relative};
use wimu_host::{OutputFile, Result};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = PathBuf::from(arguments.first().map_or("knee", String::as_str));
    let rig = Rig {
        rates_hz: [100.0, 50.0],
        // Boards that were switched on one after the other, and shaken together once.
        behind_s: 3.7,
        shake_rad: 0.6,
        ..Rig::knee(1)
    };
    let units = rig.record();
    std::fs::create_dir_all(&folder).expect("a folder that can be created");
    for unit in &units {
        write(unit, &folder)?;
    }
    let found = relative([&units[0], &units[1]], &RelativeChoice::default())?;
    print!("{}", found.text());
    let axis: Vector3<f64> = rig.axes()[0];
    let off = Vector3::from(found.hinge.axes[0]).dot(&axis).abs().min(1.0).acos();
    // The constant part depends on the zero of the angle. In the first seconds heading and tilt are still being found.
    let truth: Vec<f64> = found.points.iter().map(|p| angle(&rig, p.time_s)).collect();
    let sign = Vector3::from(found.hinge.axes[0]).dot(&axis).signum();
    let pairs = found.points.iter().zip(&truth).filter(|(p, _)| p.time_s >= 5.0);
    let errors: Vec<f64> = pairs.map(|(p, t)| p.angle_rad - sign * t).collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let squares: f64 = errors.iter().map(|e| (e - mean).powi(2)).sum();
    println!(
        "truth: axis off by {:.2}°, angle off by {:.2}° (RMS from 5 s on, without the constant part)",
        off.to_degrees(),
        (squares / errors.len() as f64).sqrt().to_degrees()
    );
    if let Some(pictures) = arguments.iter().position(|a| a == "--pictures") {
        let pictures = arguments.get(pictures + 1).map_or("pictures", String::as_str);
        let mut chart = found.angle();
        let points = found.points.iter().zip(&truth);
        let points = points.map(|(p, t)| (p.time_s, (sign * t + mean).to_degrees())).collect();
        chart.series.push(Series::line("truth", points));
        write_all(Path::new(pictures), &[("protractor", chart)])?;
    }
    Ok(())
}

/// True angle of the knee, rad.
fn angle(rig: &Rig, time_s: f64) -> f64 {
    let knee = rig.mounts[0] * rig.truth(time_s) * rig.mounts[1].inverse();
    knee.scaled_axis().z
}

fn write(unit: &MotionRecording, folder: &Path) -> Result<()> {
    let (output, sink) = OutputFile::create(&folder.join(&unit.name).with_extension("csv"))?;
    let mut columns = vec!["Time (s)".to_owned()];
    columns.extend(wimu_host::csv::axes("Accelerometer", "m/s²"));
    columns.extend(wimu_host::csv::axes("Gyroscope", "rad/s"));
    let mut out = CsvWriter::new(sink, output.name(), &columns)?;
    for (time_s, sample) in unit.times_s.iter().zip(&unit.samples) {
        out.number(Some(*time_s)).vector(Some(sample.force_mps2)).vector(sample.rate_rad_s);
        out.end_row()?;
    }
    out.finish()?;
    output.finish()
}
