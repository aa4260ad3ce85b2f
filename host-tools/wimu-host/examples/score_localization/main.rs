//! Scores of localization with ranges, and of the angle between two units, on recordings with truth, beside least squares, a plain filter and the float64
//! reference: `cargo run --release -p wimu-host --example score_localization -- [DATA] [--only NAME]`.
//!
//! Walks and drones: RMSE in space after one rigid transform and one time offset, both fitted (drone 1: 1.08 s). The first
//! 4 s and the last second of a walk's truth, and the first 2 s of a drone, are not scored. Vehicle: RMSE in the plane
//! without alignment, every fifth increment from the 20th on; drives with position fixes: error at the end of outages.
//! NEES: fraction of the positions below the 95 % point of χ², of
//! all, and thinned to the interval over which the autocorrelation of the error falls below 0.2.

mod protractor;
mod score;
mod vehicle;

use std::path::{Path, PathBuf};

use score::{Alignment, Score, Truth};
use wimu_host::inertial::{PathPoint, StartPose};
use wimu_host::localization::{
    Localization, LocalizationChoice, RangePrior, RangeRecording, localize,
};
use wimu_host::motion::MotionRecording;
use wimu_testkit::Random;
use wimu_testkit::figure;

/// Recordings whose half of the ranges are made longer.
const SEEDS: u64 = 20;
/// Reference and bar of a recording: RMSE of filter and smoother, m.
struct Bar {
    name: &'static str,
    reference: &'static str,
    rmse_m: [f64; 2],
}
const BARS: [Bar; 3] = [
    Bar { name: "walk1", reference: "0.162 / 0.127, NEES 0.78 / 0.32", rmse_m: [0.16, 0.125] },
    Bar { name: "drone1", reference: "0.089 / 0.075, NEES 0.83 / 0.36", rmse_m: [0.089, 0.075] },
    Bar { name: "plaza1", reference: "0.358 / 0.288, NEES 0.76 / 0.59", rmse_m: [0.34, 0.27] },
];

fn main() -> Result<(), String> {
    let (mut data, mut only) = (PathBuf::from("../shared/data"), String::new());
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--only" => only = arguments.next().ok_or("--only needs a name")?,
            _ => data = argument.into(),
        }
    }
    let wants = |name: &str| name.contains(&only);
    let mut found = 0;
    let mut pool = [[0; 2]; 2];
    for (name, anchors) in recordings(&data) {
        found += 1;
        let truth = Truth::read(&data.join(format!("uwb/{name}_truth.csv")))?;
        let recording = RangeRecording::read(
            &data.join(format!("uwb/{name}_ranges.csv")),
            &data.join("uwb").join(anchors),
        );
        let recording = recording.map_err(|e| e.to_string())?;
        let alignment = Alignment::of(&name, &truth, &recording);
        let mut alone = None;
        if wants(&name) {
            println!("\n{name}: {}", score::least_squares(&recording, &truth, &alignment));
            let plain = |noise_m| LocalizationChoice {
                prior: Some(RangePrior {
                    noise_m,
                    correlated_m: 0.0,
                    bias_m: 0.0,
                    scale: 0.0,
                    blocked: 0.0,
                    acceleration_m2s3: 0.3,
                    gate: 3.5,
                    adapts: false,
                }),
                ..LocalizationChoice::default()
            };
            let noise_m = if name.starts_with("drone") { 0.15 } else { 0.1 };
            both(
                "plain filter, white noise, gate 3.5 σ",
                &recording,
                &plain(noise_m),
                &truth,
                &alignment,
            )?;
            let scores =
                both("wimu", &recording, &LocalizationChoice::default(), &truth, &alignment)?;
            record(&name, &scores);
            alone = Some([scores[0].rmse_m, scores[1].rmse_m]);
            for (pool, score) in pool.iter_mut().zip(&scores) {
                pool[0] += score.below;
                pool[1] += score.independent;
            }
        }
        let imu = data.join(format!("uwb/{name}_imu.csv"));
        let aided = format!("{name} with gyroscope");
        if wants(&aided) && imu.exists() {
            let motion = MotionRecording::from_csv(&imu).map_err(|e| e.to_string())?;
            let recording = RangeRecording { motion: Some(motion), ..recording.clone() };
            println!("\n{aided}");
            let scores =
                both("wimu", &recording, &LocalizationChoice::default(), &truth, &alignment)?;
            for (k, kind) in ["filter", "smoother"].into_iter().enumerate() {
                if let Some(alone) = alone {
                    let ratio = scores[k].rmse_m / alone[k];
                    figure(
                        &format!("{aided}: RMSE of the {kind} over that of ranges alone"),
                        format!("{ratio:.2}"),
                        "at most 1",
                        ratio <= 1.0,
                    );
                }
            }
        }
        if name == "walk1" && wants("blocked") {
            blocked(&recording, &truth, &alignment)?;
        }
    }
    if wants("plaza1") && data.join("vehicle/plaza1_ranges.csv").exists() {
        found += 1;
        plaza(&data.join("vehicle"))?;
    }
    found += protractor::score(&data.join("protractor"), &only)?;
    for name in names(&data.join("vehicle"), "_gnss.csv") {
        if wants(&name) {
            found += 1;
            vehicle::score(&data.join("vehicle"), &name)?;
        }
    }
    for ([below, count], kind) in pool.into_iter().zip(["filter", "smoother"]) {
        let fraction = below as f64 / f64::from(u32::try_from(count).unwrap_or(u32::MAX));
        if count > 0 {
            println!();
            figure(
                &format!("ranges alone, pooled: {kind}, fraction of NEES below the 95 % point"),
                format!("{fraction:.2} of {count}"),
                "0.90–0.98",
                (0.895..0.985).contains(&fraction),
            );
        }
    }
    match found {
        0 => Err(format!("nothing to score in {}", data.display())),
        _ => Ok(()),
    }
}

/// Names of the files in a folder, without an ending that they have.
fn names(folder: &Path, ending: &str) -> Vec<String> {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let name =
        |file: std::fs::DirEntry| Some(file.file_name().to_str()?.strip_suffix(ending)?.to_owned());
    let mut names: Vec<String> = files.filter_map(name).collect();
    names.sort();
    names
}

/// Recordings of ultra-wideband ranges in the folder, with their anchors.
fn recordings(data: &Path) -> Vec<(String, &'static str)> {
    let anchors = |name: &str| {
        if name.starts_with("drone") { "drone_anchors.csv" } else { "anchors.csv" }
    };
    names(&data.join("uwb"), "_ranges.csv")
        .into_iter()
        .map(|name| (name.clone(), anchors(&name)))
        .collect()
}

/// Scores of filter and smoother.
fn both(
    what: &str,
    recording: &RangeRecording,
    choice: &LocalizationChoice,
    truth: &Truth,
    alignment: &Alignment,
) -> Result<[Score; 2], String> {
    let run = |smooth| {
        let choice = LocalizationChoice { smooth, ..choice.clone() };
        localize(recording, &choice).map_err(|e| e.to_string())
    };
    let (filter, smoother) = (run(false)?, run(true)?);
    let scores = [&filter, &smoother].map(|found| alignment.score(&found.path.points, truth));
    print(what, &scores, &smoother);
    Ok(scores)
}

fn print(what: &str, [filter, smoother]: &[Score; 2], found: &Localization) {
    println!("  {what}\n    filter   {filter}\n    smoother {smoother}");
    let biases = found.anchors.iter().filter_map(|a| a.bias_m);
    let biases: Vec<String> = biases.map(|b| format!("{:+.3} ± {:.3}", b.value, b.sigma)).collect();
    if !biases.is_empty() {
        println!("    bias of the anchors, m: {}", biases.join(", "));
    }
    let scales = found.anchors.iter().filter_map(|a| a.scale);
    let scales: Vec<String> = scales.map(|b| format!("{:+.4} ± {:.4}", b.value, b.sigma)).collect();
    if !scales.is_empty() {
        println!("    scale error of the anchors: {}", scales.join(", "));
    }
    println!("    noise {:?}", found.noise);
    if let Some(delay) = found.delay_s {
        println!("    delay {:+.3} ± {:.3} s", delay.value, delay.sigma);
    }
    for finding in &found.path.findings {
        println!("    {finding}");
    }
}

fn record(name: &str, scores: &[Score; 2]) {
    let Some(bar) = BARS.iter().find(|bar| bar.name == name) else {
        return;
    };
    println!("    reference {}; bar {:?} m, NEES 0.90 to 0.98", bar.reference, bar.rmse_m);
    for ((score, bar_m), kind) in scores.iter().zip(bar.rmse_m).zip(["filter", "smoother"]) {
        // To the digits of the bar.
        let rounded = (score.rmse_m * 1e3).round() / 1e3;
        figure(
            &format!("{name}: RMSE of the {kind}, m"),
            format!("{rounded:.3}"),
            &format!("at most {bar_m} (reference {})", bar.reference),
            rounded <= bar_m,
        );
        figure(
            &format!(
                "{name}: {kind}, fraction of NEES below the 95 % point, thinned to {:.1} s",
                score.thinned_s
            ),
            format!("{:.2} of {}", score.thinned, score.independent),
            "0.90–0.98",
            (0.895..0.985).contains(&score.thinned),
        );
    }
}

/// Half of the ranges longer by 0.3 to 3 m.
fn blocked(recording: &RangeRecording, truth: &Truth, alignment: &Alignment) -> Result<(), String> {
    let rmse = |recording: &RangeRecording| {
        let run = |smooth| {
            let choice = LocalizationChoice { smooth, ..LocalizationChoice::default() };
            let found = localize(recording, &choice).map_err(|e| e.to_string())?;
            Ok::<_, String>(alignment.score(&found.path.points, truth).rmse_m)
        };
        Ok::<_, String>([run(false)?, run(true)?])
    };
    let clean = rmse(recording)?;
    let mut growth = [Vec::new(), Vec::new()];
    for seed in 0..SEEDS {
        let mut random = Random::new(seed);
        let mut blocked = recording.clone();
        for range in &mut blocked.ranges {
            if random.uniform() < 0.5 {
                range.range_m += 0.3 + 2.7 * random.uniform();
            }
        }
        let found = rmse(&blocked)?;
        for k in 0..2 {
            growth[k].push(found[k] / clean[k]);
        }
    }
    println!("\nwalk1, half of the ranges longer by 0.3 to 3 m, {SEEDS} seeds");
    for (growth, kind) in growth.iter_mut().zip(["filter", "smoother"]) {
        growth.sort_by(f64::total_cmp);
        let (median, worst) = (growth[growth.len() / 2], growth[growth.len() - 1]);
        println!("    {kind}: RMSE over that of all ranges, median {median:.2}, worst {worst:.2}");
        figure(
            &format!(
                "walk1, half of the ranges blocked: growth of the RMSE of the {kind}, median / worst"
            ),
            format!("{median:.2} / {worst:.2}"),
            "at most 1.25 / 2",
            median <= 1.25 && worst <= 2.0,
        );
    }
    Ok(())
}

/// The vehicle: start from the truth, as the reference, and without.
fn plaza(folder: &Path) -> Result<(), String> {
    let truth = Truth::read(&folder.join("plaza1_truth.csv"))?;
    let recording =
        RangeRecording::read(&folder.join("plaza1_ranges.csv"), &folder.join("plaza1_anchors.csv"));
    let recording = recording.and_then(|r| r.with_odometry(&folder.join("plaza1_odometry.csv")));
    let recording = recording.map_err(|e| e.to_string())?;
    let times_s: Vec<f64> =
        recording.increments.iter().map(|i| i.time_s).skip(20).step_by(5).collect();
    let start =
        StartPose { position_m: truth.position_m(0).into(), heading_rad: truth.heading_rad(0) };
    for (what, start) in [("start of the truth", Some(start)), ("unknown start", None)] {
        println!("\nplaza1, odometry and ranges, {what}");
        let choice = LocalizationChoice { start, ..LocalizationChoice::default() };
        let run = |smooth| {
            let choice = LocalizationChoice { smooth, ..choice.clone() };
            localize(&recording, &choice).map_err(|e| e.to_string())
        };
        let (filter, smoother) = (run(false)?, run(true)?);
        let at = |points: &[PathPoint]| score::planar(points, &times_s, &truth);
        let scores = [at(&filter.path.points), at(&smoother.path.points)];
        print("wimu", &scores, &smoother);
        if start.is_some() {
            record("plaza1", &scores);
        }
    }
    Ok(())
}
