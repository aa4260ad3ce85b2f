//! Angle of a hinge between two units, beside accelerometers alone and a complementary filter: RMS with the constant offset
//! removed, of the whole file and of its core (5 s after the start to 4 s before the end: truth and gyroscopes disagree near
//! the ends).

use std::path::Path;

use wimu_host::formats::{self, ReadOptions};
use wimu_host::motion::MotionRecording;
use wimu_host::recording::{Origin, Quantity};
use wimu_host::relative::{RelativeChoice, RelativePath, relative};
use wimu_testkit::figure;

/// Bars, deg: whole file, core.
const BARS_DEG: [f64; 2] = [1.3, 1.1];
/// Time constant of the complementary filter, s.
const COMPLEMENTARY_S: f64 = 2.0;
/// Of VQF with magnetometers (D. Laidig and T. Seel, 2023; PyPI `vqf`) on pendulum03, deg: a Python package.
const VQF: &str = "VQF 9D (PyPI `vqf`), pendulum03: 2.2 -> 1.7 deg";

/// Angles over time, s and rad.
type Angles = Vec<(f64, f64)>;

/// Scores every pair of recordings in the folder; their number.
pub fn score(folder: &Path, only: &str) -> Result<usize, String> {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let first = files.filter_map(|file| {
        Some(file.file_name().to_str()?.strip_suffix("_segment1.csv")?.to_owned())
    });
    let mut names: Vec<String> = first.filter(|name| name.contains(only)).collect();
    names.sort();
    for name in &names {
        pair(folder, name)?;
    }
    Ok(names.len())
}

fn pair(folder: &Path, name: &str) -> Result<(), String> {
    let text = |error: wimu_host::HostError| error.to_string();
    let files = [1, 2].map(|k| folder.join(format!("{name}_segment{k}.csv")));
    let [a, b] = [
        MotionRecording::from_csv(&files[0]).map_err(text)?,
        MotionRecording::from_csv(&files[1]).map_err(text)?,
    ];
    let truth = truth(&files)?;
    println!("\n{name}: hinge angle, RMS without the constant offset, whole -> core, deg; {VQF}");
    let of = |filter: &dyn Fn(&MotionRecording) -> Angles| {
        let (a, b) = (filter(&a), filter(&b));
        a.iter().zip(&b).map(|(a, b)| (a.0, b.1 - a.1)).collect::<Angles>()
    };
    let print = |what: &str, angles: &Angles| {
        let rms = rms_deg(angles, &truth);
        println!("  {what:<44} {:.2} -> {:.2}", rms[0], rms[1]);
        rms
    };
    print("accelerometers alone", &of(&|unit| inclination(unit, 0.0)));
    let complementary =
        print("complementary filter, 2 s", &of(&|unit| inclination(unit, COMPLEMENTARY_S)));
    for (what, hinge, magnetometers) in [
        ("wimu, hinge found", None, false),
        ("wimu, hinge given", Some([0.0, 0.0, 1.0]), false),
        ("wimu, hinge found, magnetometers", None, true),
    ] {
        let choice = RelativeChoice { hinge, magnetometers };
        let found = relative([&a, &b], &choice).map_err(text)?;
        let rms = print(what, &found.points.iter().map(|p| (p.time_s, p.angle_rad)).collect());
        coverage(&found, &truth);
        if hinge.is_none() && !magnetometers {
            print!("{}", found.text());
            found.findings.iter().for_each(|finding| println!("  {finding}"));
            for (k, part) in ["whole file", "core"].into_iter().enumerate() {
                figure(
                    &format!("{name}: hinge angle, RMS of the {part}, deg"),
                    format!("{:.2}", rms[k]),
                    &format!(
                        "at most {} (complementary filter {:.2})",
                        BARS_DEG[k], complementary[k]
                    ),
                    rms[k] <= BARS_DEG[k],
                );
            }
        }
    }
    Ok(())
}

/// Angle about z between the true attitudes.
fn truth(files: &[std::path::PathBuf; 2]) -> Result<Angles, String> {
    let angle = |file: &Path| -> Result<Vec<(f64, [f64; 4])>, String> {
        let recording = formats::load(file, &ReadOptions::default()).map_err(|e| e.to_string())?;
        let mut tracks = recording.of(Quantity::Attitude);
        let track = tracks.find(|track| track.info.origin == Origin::Truth);
        let track = track.ok_or("no true attitude")?;
        let rows = track.times_ns().iter().enumerate();
        Ok(rows
            .filter_map(|(row, ns)| Some((*ns as f64 * 1e-9, track.row(row)?.try_into().ok()?)))
            .collect())
    };
    let (a, b) = (angle(&files[0])?, angle(&files[1])?);
    let mut angles = Angles::new();
    for ((time_s, p), (_, q)) in a.into_iter().zip(b) {
        // Conjugate of p times q: W and Z.
        let w = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3];
        let z = p[0] * q[3] - p[3] * q[0] - p[1] * q[2] + p[2] * q[1];
        let angle = 2.0 * z.atan2(w);
        let last = angles.last().map_or(angle, |(_, last)| *last);
        let turn = std::f64::consts::TAU;
        angles.push((time_s, angle + turn * ((last - angle) / turn).round()));
    }
    Ok(angles)
}

/// Inclination about z: of the specific force alone, or that corrects an integrated angular rate with a time constant, s.
fn inclination(unit: &MotionRecording, time_s: f64) -> Angles {
    let mut angle: Option<f64> = None;
    let mut last_rate = 0.0;
    let samples = unit.times_s.iter().zip(&unit.samples);
    samples
        .map(|(t, sample)| {
            let [x, y, _] = sample.force_mps2;
            let seen = -y.atan2(x);
            let found = match angle {
                Some(angle) if time_s > 0.0 => {
                    let predicted = angle + last_rate * sample.step_s;
                    predicted + sample.step_s / time_s * (seen - predicted)
                }
                _ => seen,
            };
            angle = Some(found);
            last_rate = sample.rate_rad_s.unwrap_or_default()[2];
            (*t, found)
        })
        .collect()
}

/// Errors at the times of the truth: time, error, without the mean, rad.
fn errors(angles: &Angles, truth: &Angles, [from_s, to_s]: [f64; 2]) -> Vec<(f64, f64)> {
    let at = |time_s: f64| {
        let next = angles.partition_point(|(t, _)| *t < time_s).clamp(1, angles.len() - 1);
        let ((t0, a0), (t1, a1)) = (angles[next - 1], angles[next]);
        a0 + (a1 - a0) * ((time_s - t0) / (t1 - t0)).clamp(0.0, 1.0)
    };
    let within = truth.iter().filter(|(t, _)| (from_s..=to_s).contains(t));
    let errors: Vec<(f64, f64)> = within.map(|(t, angle)| (*t, at(*t) - angle)).collect();
    let mean = errors.iter().map(|(_, e)| e).sum::<f64>() / errors.len() as f64;
    errors.into_iter().map(|(t, e)| (t, e - mean)).collect()
}

fn spans(truth: &Angles) -> [[f64; 2]; 2] {
    let (from_s, to_s) = (truth[0].0, truth[truth.len() - 1].0);
    [[from_s, to_s], [from_s + 5.0, to_s - 4.0]]
}

fn rms_deg(angles: &Angles, truth: &Angles) -> [f64; 2] {
    spans(truth).map(|span| {
        let errors = errors(angles, truth, span);
        let squares: f64 = errors.iter().map(|(_, e)| e * e).sum();
        (squares / errors.len() as f64).sqrt().to_degrees()
    })
}

/// Fraction of the core within 2 σ.
fn coverage(found: &RelativePath, truth: &Angles) {
    let angles = found.points.iter().map(|p| (p.time_s, p.angle_rad)).collect();
    let errors = errors(&angles, truth, spans(truth)[1]);
    let within = errors.iter().filter(|(t, error)| {
        let next = found.points.partition_point(|p| p.time_s < *t).min(found.points.len() - 1);
        error.abs() <= 2.0 * found.points[next].sigma_rad
    });
    println!(
        "    {:.0} % of the core within 2 σ",
        100.0 * within.count() as f64 / errors.len() as f64
    );
}
