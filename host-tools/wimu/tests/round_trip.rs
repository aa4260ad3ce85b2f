//! A calibration of every method goes to a board and back, and into other firmware, without losing a
//! digit.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Command;

use kit::{Simulator, Transcript, folder, wimu};
use wimu_host::calibration::read_parameters;
use wimu_model::{
    CentiCelsius, Counts, ErrorModel, ErrorTerms, ParameterSet, SpecificForceMps2, TemperatureTerms,
};

const G: f64 = 9.80665;
/// LSB per m/s² of the simulated board at ±2 g.
const LSB: f64 = 16384.0 / G;

fn truth() -> ErrorModel {
    ErrorModel::new(ErrorTerms {
        bias_mps2: [0.3, -0.5, 0.2],
        matrix: [[1.03, 0.0, 0.0], [0.02, 0.97, 0.0], [-0.01, 0.03, 1.01]],
        temperature: TemperatureTerms {
            bias_mps2_per_k: [0.004, -0.003, 0.002],
            ..TemperatureTerms::default()
        },
        ..ErrorTerms::default()
    })
    .unwrap()
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let norm = v.iter().map(|c| c * c).sum::<f64>().sqrt();
    v.map(|c| c / norm)
}

/// Pose means, counts with fractions, at times and temperatures; a wiggle stands for noise.
fn table(ups: &[[f64; 3]]) -> String {
    let mut text = String::from(
        "Time (s),Temperature (°C),Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)\n",
    );
    for (k, up) in ups.iter().enumerate() {
        let at = CentiCelsius(2000 + (k as i16 * 173) % 1500);
        let force = SpecificForceMps2(unit(*up).map(|c| c * G));
        let [x, y, z] = truth()
            .distort(force, Some(at))
            .0
            .map(|y| (y + 0.002 * (7.3 * k as f64 + y).sin()) * LSB);
        writeln!(text, "{},{},{x},{y},{z}", 10 * k, at.to_celsius()).unwrap();
    }
    text
}

/// Sides, edges and corners of a cube, and some between.
fn many() -> Vec<[f64; 3]> {
    let mut ups = Vec::new();
    for x in -1..=1 {
        for y in -1..=1 {
            for z in -1..=1 {
                if (x, y, z) != (0, 0, 0) {
                    let up = [x, y, z].map(f64::from);
                    ups.extend([up, [up[0] + 0.3, up[1] - 0.4, up[2] + 0.2]]);
                }
            }
        }
    }
    ups
}

fn turn(steps: usize) -> Vec<[f64; 3]> {
    let about = |to: fn(f64, f64) -> [f64; 3]| {
        (0..steps).map(move |k| {
            let (s, c) = (std::f64::consts::TAU * k as f64 / steps as f64).sin_cos();
            to(s, c)
        })
    };
    about(|s, c| [c, s, 0.0]).chain(about(|s, c| [0.0, c, s])).collect()
}

/// Two streams that move on all axes, the second off.
fn streams() -> String {
    let mut text = String::from("Time (s)");
    for sensor in [0, 1] {
        for axis in ["X", "Y", "Z"] {
            write!(text, ",Accelerometer {sensor} {axis} (LSB)").unwrap();
        }
    }
    for k in 0..2000 {
        let t = f64::from(k) * 0.01;
        let force = [3.0 * (2.0 * t).sin(), 3.0 * (3.1 * t).cos(), 8.0 + 3.0 * (2.3 * t).sin()];
        let [x, y, z] = force.map(|f| (f * LSB).round());
        let [u, v, w] = force.map(|f| ((1.02 * f + 0.3) * LSB).round());
        write!(text, "\n{t},{x},{y},{z},{u},{v},{w}").unwrap();
    }
    text + "\n"
}

#[test]
fn every_methods_calibration_is_pushed_and_exported_as_it_is() {
    let board = Simulator::start(&["--motion", "rest"]);
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let sides = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let sides: Vec<_> = sides.into_iter().flat_map(|up| [up, up.map(|c: f64| -c)]).collect();
    fs::write(path("many.csv"), table(&many())).unwrap();
    fs::write(path("sides.csv"), table(&sides)).unwrap();
    fs::write(path("four.csv"), table(&turn(4))).unwrap();
    fs::write(path("three.csv"), table(&turn(3))).unwrap();
    fs::write(path("streams.csv"), streams()).unwrap();
    let mut headers = Vec::new();
    for (k, (data, flags)) in [
        ("many.csv", &["--poses", "--model", "9"][..]),
        ("many.csv", &["--poses", "--model", "auto"]),
        ("many.csv", &["--poses", "--model", "9+drift"]),
        ("many.csv", &["--poses", "--model", "9+temperature"]),
        ("many.csv", &["--poses", "--model", "9+drift+temperature+quadratic"]),
        ("sides.csv", &["--poses", "--method", "six-position"]),
        ("four.csv", &["--poses", "--method", "four-angle"]),
        ("three.csv", &["--poses", "--method", "three-angle"]),
        ("streams.csv", &["--method", "reference"]),
    ]
    .into_iter()
    .enumerate()
    {
        let (cal, data) = (path(&format!("CAL{k}.json")), path(data));
        let base = ["calibrate", &data, "--sensitivity", "16384", "-o", &cal];
        let report = wimu(&[&base[..], flags].concat()).succeeds();
        let set = read_parameters(Path::new(&cal)).unwrap();
        // What the board holds afterwards is the set, digit by digit.
        let held = wimu(&["device", "params", "push", &board.cable, &cal]).succeeds();
        assert_eq!(held["parameters"], report["parameters"], "{flags:?}");
        assert_eq!(held["parameter_id"], report["parameter_id"], "{flags:?}");
        for format in ["c", "kalibr"] {
            let out = path(&format!("{format}{k}"));
            wimu(&["convert", &cal, "--to", format, "-o", &out]).succeeds();
            let text = fs::read_to_string(&out).unwrap();
            // Every number of the model is there with all its digits.
            let terms = set.model.terms();
            let all = terms.matrix.iter().flatten().chain(&terms.bias_mps2);
            for number in all.filter(|n| **n != 0.0) {
                assert!(text.contains(&format!("{number:?}")), "{format} {flags:?}: {number}");
            }
        }
        headers.push((path(&format!("c{k}")), set, flags));
    }
    for (header, set, flags) in &headers {
        computes_the_same(header, set, flags);
    }
}

#[test]
fn a_stored_calibration_is_checked_by_later_rests_and_brought_up_to_date() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (cal, rests) = (path("CAL.json"), path("rests.csv"));
    fs::write(path("many.csv"), table(&many())).unwrap();
    let calibrated = ["calibrate", &path("many.csv"), "--poses", "--model", "9+temperature"];
    wimu(&[&calibrated[..], &["--sensitivity", "16384", "-o", &cal]].concat()).succeeds();
    // The next run: the bias is 10 mm/s² off on X, as from one start to the next.
    let off = |by: f64, rests: &str| {
        let text = table(&many()[..30]);
        let shifted = text.lines().enumerate().map(|(k, line)| {
            let mut fields: Vec<String> = line.split(',').map(str::to_owned).collect();
            if k > 0 {
                let x: f64 = fields[2].parse().unwrap();
                fields[2] = (x + by * LSB).to_string();
            }
            fields.join(",") + "\n"
        });
        fs::write(rests, shifted.collect::<String>()).unwrap();
    };
    let update = ["calibrate", &rests, "--poses", "--method", "update", "--with", &cal];
    off(0.010, &rests);
    let newer = path("NEW.json");
    let ran = wimu(&[&update[..], &["-o", &newer]].concat());
    let report = ran.succeeds();
    let mut texts = Transcript::default();
    texts.text("calibrate --method update", &ran);
    assert_eq!(report["contradictions"], 0);
    assert_eq!(report["rests"].as_array().unwrap().len(), 30);
    let change = report["bias_change_m_s2"][0].as_f64().unwrap();
    let sd = report["sd"][0].as_f64().unwrap();
    // Ageing lets the bias move with every change of temperature.
    assert!((change - 0.010).abs() < 2.0 * sd && sd < 0.03, "{change} {sd}");
    // The newer file is a calibration like any other.
    let set = read_parameters(Path::new(&newer)).unwrap();
    let quality = set.quality.unwrap();
    assert_eq!(quality.terms().poses as usize, many().len() + 30);
    wimu(&["convert", &newer, "--to", "c", "-o", &path("c")]).succeeds();
    // A sensor that was knocked: refused.
    off(0.3, &rests);
    texts.refuses("bias changed by 0.3 m/s²", &wimu(&update));
    // One rest of six, 2 % off: it is named, and to be held again.
    let text = table(&many()[..6]);
    let knocked = text.lines().enumerate().map(|(k, line)| {
        let scaled = |(j, field): (usize, &str)| match (k, j) {
            (4, 2..5) => (field.parse::<f64>().unwrap() * 1.02).to_string(),
            _ => field.to_owned(),
        };
        let fields: Vec<String> = line.split(',').enumerate().map(scaled).collect();
        fields.join(",") + "\n"
    });
    fs::write(&rests, knocked.collect::<String>()).unwrap();
    texts.refuses("rest 3 of 6 off by 2 %", &wimu(&update));
    texts.check("calibrate_update");
    wimu(&update[..5]).fails(2, "usage");
    wimu(&[&update[..], &["--model", "9"]].concat()).fails(2, "usage");
}

fn computes_the_same(header: &str, set: &ParameterSet, flags: &[&str]) {
    let samples = [[0, 0, 16384], [-16384, 100, -100], [32767, -32768, 12345], [-1, 2, -3]];
    let mut program =
        format!("#include <stdio.h>\n#include \"{header}\"\nint main(void) {{\n    double f[3];\n");
    for [x, y, z] in samples {
        writeln!(
            program,
            "    {{ const double c[3] = {{{x}, {y}, {z}}}; wimu_correct(c, 31.0, f); \
             printf(\"%.17g %.17g %.17g\\n\", f[0], f[1], f[2]); }}"
        )
        .unwrap();
    }
    program += "    return 0;\n}\n";
    let (source, binary) = (format!("{header}.main.c"), format!("{header}.main"));
    fs::write(&source, program).unwrap();
    let built = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-o", &binary, &source])
        .output();
    let Ok(built) = built else {
        println!("skipped: there is no C compiler `cc`");
        return;
    };
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let ran = Command::new(&binary).output().unwrap();
    let text = String::from_utf8(ran.stdout).unwrap();
    for (counts, line) in samples.into_iter().zip(text.lines()) {
        let ours = set.correct(Counts(counts), Some(CentiCelsius(3100))).0;
        for (ours, theirs) in ours.into_iter().zip(line.split(' ')) {
            let theirs: f64 = theirs.parse().unwrap();
            assert!((ours - theirs).abs() < 1e-10, "{flags:?}: {ours} {theirs}");
        }
    }
}
