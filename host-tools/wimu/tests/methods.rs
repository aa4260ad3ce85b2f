//! The calibrations beside that from gravity, as scripts use them.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{Transcript, in_folder, snapshot, wimu};
use serde_json::Value;

/// Two accelerometers in m/s², the second 2 % and 0.3 m/s² off, X and Y moving.
fn two_accelerometers() -> String {
    let mut text = String::from("Time (s)");
    for sensor in [0, 1] {
        for axis in ["X", "Y", "Z"] {
            write!(text, ",Accelerometer {sensor} {axis} (m/s²)").unwrap();
        }
    }
    text.push('\n');
    for k in 0..2000 {
        let t = f64::from(k) * 0.01;
        let force = [3.0 * (2.0 * t).sin(), 3.0 * (3.1 * t).cos(), 9.81];
        let output = force.map(|f| 1.02 * f + 0.3);
        let [x, y, z] = force;
        let [u, v, w] = output;
        writeln!(text, "{t},{x},{y},{z},{u},{v},{w}").unwrap();
    }
    text
}

#[test]
fn a_stream_against_a_reference_has_bias_and_scale_where_it_moves() {
    let (csv, folder) = in_folder("two.csv");
    fs::write(&csv, two_accelerometers()).unwrap();
    let cal = folder.path().join("CAL.json").display().to_string();
    let reference = ["calibrate", &csv, "--method", "reference"];
    let report = wimu(&[&reference[..], &["-o", &cal]].concat()).succeeds();
    let number = |pointer: &str| report.pointer(pointer).unwrap().as_f64().unwrap();
    for axis in 0..2 {
        assert!((number(&format!("/model/bias_m_s2/{axis}")) - 0.3).abs() < 1e-9);
        assert!((number(&format!("/model/matrix/{axis}/{axis}")) - 1.02).abs() < 1e-9);
    }
    // Z saw gravity only: its offset there is 0.3 + 0.02 · 9.81.
    assert_eq!(report["axes"][2]["separated"], false);
    assert!((number("/model/bias_m_s2/2") - 0.4962).abs() < 1e-9);
    assert_eq!(number("/model/matrix/2/2"), 1.0);
    let written: Value = serde_json::from_str(&fs::read_to_string(&cal).unwrap()).unwrap();
    assert_eq!(written["schema"], "wimu.calibration/2");

    // The other way round.
    let swapped = wimu(&[&reference[..], &["--reference", "1"]].concat()).succeeds();
    let scale = swapped["model"]["matrix"][0][0].as_f64().unwrap();
    assert!((scale - 1.0 / 1.02).abs() < 1e-9);

    wimu(&[&reference[..], &["--reference", "1", "--accelerometer", "1"]].concat())
        .fails(2, "usage");
    wimu(&[&reference[..], &["--model", "9"]].concat()).fails(2, "usage");
    wimu(&["calibrate", &csv, "--accelerometer", "0", "--reference", "1"]).fails(2, "usage");
    let (one, _folder) = in_folder("one.csv");
    fs::write(&one, "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)\n0,0,1\n")
        .unwrap();
    wimu(&["calibrate", &one, "--method", "reference"]).fails(2, "usage");

    // Different motions are refused.
    let text = fs::read_to_string(&csv).unwrap().replace("Accelerometer 1 X", "Accelerometer 1 W");
    let text = text
        .replace("Accelerometer 1 Y", "Accelerometer 1 X")
        .replace("Accelerometer 1 W", "Accelerometer 1 Y");
    fs::write(&csv, text).unwrap();
    let mut texts = Transcript::default();
    texts.refuses("different motions", &wimu(&reference));
    texts.check("calibrate_reference_different_motions");
}

#[test]
fn the_noise_ratio_comes_from_the_data_or_is_given_or_widens_the_answer() {
    // The second accelerometer is twenty times as noisy; there is no rest.
    let noisy = |fast: bool| {
        let mut text = two_accelerometers().lines().next().unwrap().to_owned();
        let mut state = 7_u64;
        let mut noise = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        };
        for k in 0..4000 {
            let t = f64::from(k) * 0.01;
            let mut force =
                [3.0 * (2.0 * t).sin(), 3.0 * (3.1 * t).cos(), 9.81 + 2.0 * (4.7 * t).sin()];
            if fast {
                force = force.map(|_| 5.0 * noise());
            }
            let reference = force.map(|f| f + 0.04 * noise());
            let output = force.map(|f| 1.02 * f + 0.3 + 0.8 * noise());
            let [x, y, z] = reference;
            let [u, v, w] = output;
            write!(text, "\n{t},{x},{y},{z},{u},{v},{w}").unwrap();
        }
        text
    };
    let (csv, _folder) = in_folder("noisy.csv");
    let ask =
        |flags: &[&str]| wimu(&[&["calibrate", &csv, "--method", "reference"][..], flags].concat());
    for (fast, flags, from, most_sd) in [
        (false, &[][..], "neighbours", 0.01),
        (false, &["--noise-ratio", "20"][..], "given", 0.01),
        (true, &[][..], "bounds", 0.05),
        (true, &["--noise-ratio", "20"][..], "given", 0.01),
    ] {
        fs::write(&csv, noisy(fast)).unwrap();
        let ran = ask(flags);
        let report = ran.succeeds();
        for axis in 0..3 {
            assert_eq!(report["axes"][axis]["noise_from"], from, "{report}");
            let scale = report["model"]["matrix"][axis][axis].as_f64().unwrap();
            let sd = report["sd"]["matrix"][axis][axis].as_f64().unwrap();
            assert!((scale - 1.02).abs() < 3.0 * sd && sd < most_sd, "{from}: {scale} {sd}");
        }
    }
    assert!(ask(&["--noise-ratio", "0"]).code == 2);
    wimu(&["calibrate", &csv, "--noise-ratio", "2", "--accelerometer", "0"]).fails(2, "usage");
}

#[test]
fn rotations_of_other_steps_are_refused_and_unobserved_parameters_reported() {
    let (csv, folder) = in_folder("turn.csv");
    let cal = folder.path().join("CAL.json").display().to_string();
    let turn = |step: f64, lean: f64| {
        let mut text =
            String::from("Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)");
        for k in 0..4 {
            let (sin, cos) = (f64::from(k) * step).to_radians().sin_cos();
            let (across, along) = lean.to_radians().sin_cos();
            let g = 9.80665;
            let [x, y, z] = [g * cos * along + 0.2, g * sin - 0.1, g * cos * across + 0.05];
            write!(text, "\n{x},{y},{z}").unwrap();
        }
        fs::write(&csv, text).unwrap();
        let flags = ["--poses", "--sensitivity", "16384", "-o", &cal];
        wimu(&[&["calibrate", &csv, "--method", "four-angle"][..], &flags].concat())
    };
    let mut texts = Transcript::default();
    for (step, lean, case) in [(80.0, 0.0, "steps of 80°"), (90.0, 17.0, "17° from level")] {
        texts.refuses(case, &turn(step, lean));
    }
    let ran = turn(90.0, 0.0);
    let report = ran.succeeds();
    let unseen = report["not_observed"].as_array().unwrap();
    assert!(unseen.contains(&"bias Z".into()) && unseen.contains(&"scale factor Z".into()));
    assert!(!unseen.contains(&"bias X".into()));
    assert!(report["half_width_95"][2].is_null() && report["half_width_95"][0].is_f64());
    assert!(report["sd"]["bias_m_s2"][2].as_f64().unwrap() > 0.3, "{report}");
    texts.text("four-angle", &ran);
    let set = wimu_host::calibration::read_parameters(cal.as_ref()).unwrap();
    let lines = wimu_host::calibration::describe(&set);
    texts.list("the set of parameters", lines.iter().map(String::as_str));
    texts.check("calibrate_four_angle");
}

/// A sensor at rest, g, 100 Hz, with noise of uniform distribution, ±`peak`.
fn at_rest(seconds: u32, peak: f64) -> String {
    let mut text =
        String::from("Time (s),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)\n");
    let mut state = 1_u64;
    let mut noise = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 11) as f64 / (1_u64 << 53) as f64 * 2.0 - 1.0) * peak
    };
    for k in 0..seconds * 100 {
        let t = f64::from(k) / 100.0;
        writeln!(text, "{t},{},{},{}", noise(), noise(), 1.0 + noise()).unwrap();
    }
    text
}

#[test]
fn the_noise_of_a_sensor_at_rest_is_reported_and_motion_is_refused() {
    let mut texts = Transcript::default();
    let (csv, folder) = in_folder("rest.csv");
    fs::write(&csv, at_rest(120, 0.003)).unwrap();
    let page = folder.path().join("noise.html").display().to_string();
    let ran = wimu(&["allan", &csv, "--report", &page]);
    let report = ran.succeeds();
    texts.text("allan", &ran);
    // The peak over √3 is the standard deviation; density is that over √(rate / 2).
    let expected = 0.003 * 9.80665 / 3.0_f64.sqrt() / 50.0_f64.sqrt();
    for axis in 0..3 {
        let density = &report["axes"][axis]["noise_density_m_s2_rthz"];
        let (value, sd) = (&density["value"], &density["sd"]);
        let off = (value.as_f64().unwrap() - expected).abs();
        assert!(off < 4.0 * sd.as_f64().unwrap() && off < 0.05 * expected, "{density}");
    }
    assert!(fs::read_to_string(&page).unwrap().contains("<svg"));

    // Kalibr's file takes the noise from the report.
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (json, yaml) = (path("NOISE.json"), path("imu.yaml"));
    let envelope = serde_json::json!({ "command": "allan", "data": report });
    fs::write(&json, envelope.to_string()).unwrap();
    let cal = perfect(folder.path());
    let kalibr = ["export", &cal, "--format", "kalibr", "-o", &yaml];
    wimu(&[&kalibr[..], &["--noise", &json]].concat()).succeeds();
    let text = fs::read_to_string(&yaml).unwrap();
    let value = |key: &str| -> f64 {
        let mut values = text.lines().filter_map(|line| line.strip_prefix(key));
        values.next().unwrap().parse().unwrap()
    };
    // Kalibr divides by √rate.
    let density = value("accelerometer_noise_density: ") * 2.0_f64.sqrt();
    assert!((density - expected).abs() < 0.05 * expected, "{density}");
    // A random walk that does not show in so short a rest has a bound: Kalibr refuses 0.
    assert!(report["axes"][0]["acceleration_random_walk_m_s2_rts"].is_null());
    let walk = value("accelerometer_random_walk: ");
    let bounds = [0, 1, 2].map(|axis| {
        let axis = &report["axes"][axis];
        let figure = |key: &str| axis[key].as_f64().unwrap();
        figure("floor_m_s2") * (3.0 / figure("floor_tau_s")).sqrt()
    });
    assert!(walk > 0.0 && bounds.contains(&walk), "{walk} {bounds:?}");
    snapshot("export_kalibr_with_noise", &text, &[]);
    wimu(&[&kalibr[..], &["--noise", &cal]].concat()).fails(2, "bad_calibration");

    fs::write(&csv, two_accelerometers()).unwrap();
    let moving = wimu(&["allan", &csv, "--accelerometer", "0"]);
    texts.refuses("allan in motion", &moving);
    texts.check("allan");
    wimu(&["allan", &csv, "--sensitivity", "0"]).fails(2, "usage");
    wimu(&["allan", "tcp://127.0.0.1:1"]).fails(1, "link_refused");
}

/// A gyroscope at rest for 600 s at 50 Hz, with white noise of 0.0014 rad/s a sample about an offset; alone, or beside an
/// accelerometer.
fn gyroscope_at_rest(beside: bool) -> String {
    let mut text = String::from("Time (s)");
    if beside {
        text += ",Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)";
    }
    text += ",Gyroscope X (rad/s),Gyroscope Y (rad/s),Gyroscope Z (rad/s)\n";
    let mut noise = kit::noise();
    for k in 0..30_000 {
        write!(text, "{}", f64::from(k) * 0.02).unwrap();
        let forces = [0.0, 0.0, 9.80665].into_iter().take(if beside { 3 } else { 0 });
        forces.for_each(|mean| write!(text, ",{:.5}", mean + 0.02 * noise()).unwrap());
        for offset in [0.01, -0.02, 0.005] {
            write!(text, ",{:.6}", offset + 0.0014 * noise()).unwrap();
        }
        text.push('\n');
    }
    text
}

#[test]
fn the_noise_of_a_gyroscope_alone_and_beside_an_accelerometer_is_measured() {
    let (csv, folder) = in_folder("rest.csv");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (json, yaml, page) = (path("NOISE.json"), path("imu.yaml"), path("noise.html"));
    let cal = perfect(folder.path());
    for beside in [false, true] {
        fs::write(&csv, gyroscope_at_rest(beside)).unwrap();
        let ran = wimu(&["allan", &csv, "--report", &page]);
        let report = ran.succeeds();
        assert_eq!(report["axes"].is_array(), beside, "{report}");
        assert_eq!(report["samples"], 30_000);
        let walk = 0.0014 / 50_f64.sqrt();
        for axis in report["gyroscope"].as_array().unwrap() {
            for (key, expected) in [
                ("angle_random_walk_rad_s_rthz", walk),
                ("angle_random_walk_deg_rth", walk.to_degrees() * 60.0),
                ("noise_density_deg_s_rthz", walk.to_degrees() * 2_f64.sqrt()),
            ] {
                let figure = |name: &str| axis[key][name].as_f64().unwrap();
                let (value, sd) = (figure("value"), figure("sd"));
                let off = (value - expected).abs();
                assert!(
                    off < 4.0 * sd && sd < 0.02 * expected,
                    "{key}: {value} ± {sd}, {expected}"
                );
            }
        }
        assert!(fs::read_to_string(&page).unwrap().contains("Allan deviation of the gyroscope"));
        fs::write(&json, &ran.stdout).unwrap();
        wimu(&["export", &cal, "--format", "kalibr", "-o", &yaml, "--noise", &json]).succeeds();
        let text = fs::read_to_string(&yaml).unwrap();
        let value = |key: &str| -> Option<f64> {
            let mut values = text.lines().filter_map(|line| line.strip_prefix(key));
            values.next()?.parse().ok()
        };
        let density = value("gyroscope_noise_density: ").unwrap();
        assert!((density / walk - 1.0).abs() < 0.05, "{density} {walk}");
        assert!(value("gyroscope_random_walk: ") > Some(0.0), "{text}");
        for key in ["accelerometer_noise_density: ", "accelerometer_random_walk: "] {
            assert_eq!(value(key).is_some(), beside, "{text}");
        }
    }
    // A gyroscope that turns is not at rest, nor is one in °/s that is called rad/s.
    for (offset, factor) in [(0.5, 1.0), (0.0, 57.3)] {
        let turned = gyroscope_at_rest(false);
        let changed = |(k, row): (usize, &str)| {
            let mut fields = row.split(',').map(|field| field.parse::<f64>().unwrap());
            let mut text = fields.next().unwrap().to_string();
            let turns = if k > 15_000 { offset } else { 0.0 };
            fields.for_each(|rate| write!(text, ",{}", rate * factor + turns).unwrap());
            text + "\n"
        };
        let (header, rows) = turned.split_once('\n').unwrap();
        let rows: String = rows.lines().enumerate().map(changed).collect();
        fs::write(&csv, format!("{header}\n{rows}")).unwrap();
        wimu(&["allan", &csv]).refuses();
    }
}

/// The calibration file of a perfect sensor of 1000 LSB per m/s².
fn perfect(folder: &std::path::Path) -> String {
    let csv = folder.join("perfect.csv").display().to_string();
    let mut text = String::from("Time (s)");
    for sensor in [0, 1] {
        for axis in ["X", "Y", "Z"] {
            write!(text, ",Accelerometer {sensor} {axis} (LSB)").unwrap();
        }
    }
    text.push('\n');
    for k in 0..500 {
        let t = f64::from(k) * 0.01;
        let [x, y] = [2.0 * t, 3.1 * t].map(|phase| (3000.0 * phase.sin()).round());
        writeln!(text, "{t},{x},{y},{y},{x},{y},{y}").unwrap();
    }
    fs::write(&csv, text).unwrap();
    let cal = folder.join("CAL.json").display().to_string();
    wimu(&["calibrate", &csv, "--method", "reference", "--sensitivity", "9806.65", "-o", &cal])
        .succeeds();
    cal
}

#[test]
fn two_rests_or_a_push_align_the_sensor_with_its_body() {
    let (csv, folder) = in_folder("rests.csv");
    let cal = perfect(folder.path());
    let path = |name: &str| folder.path().join(name).display().to_string();
    let table = |force: &dyn Fn(f64) -> [f64; 3], seconds: u32| {
        let mut text = String::from(
            "Time (s),Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)\n",
        );
        for k in 0..seconds * 100 {
            let t = f64::from(k) / 100.0;
            let [x, y, z] = force(t);
            let noise = 0.01 * (f64::from(k) * 2.4).sin();
            writeln!(text, "{t},{},{},{}", x + noise, y - noise, z + noise).unwrap();
        }
        text
    };
    // Level, a turn of a second, then the sensor's y up.
    let rests = table(
        &|t| {
            let angle = (t - 5.0).clamp(0.0, 1.0) * std::f64::consts::FRAC_PI_2;
            [0.0, 9.81 * angle.sin(), 9.81 * angle.cos()]
        },
        11,
    );
    fs::write(&csv, rests).unwrap();
    let aligned = path("ALIGNED.json");
    let of = |arguments: &[&str]| {
        let ran = wimu(&[&["align", &csv, "--calibration", &cal][..], arguments].concat());
        let object = ran.succeeds();
        [0, 1, 2, 3].map(|k| object["alignment_wxyz"][k].as_f64().unwrap())
    };
    // The sensor's y is the body's x: a turn of −90° about z.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    for (found, expected) in
        of(&["--up", "z,x", "-o", &aligned]).iter().zip([half, 0.0, 0.0, -half])
    {
        assert!((found - expected).abs() < 0.01, "{found} {expected}");
    }
    let text = fs::read_to_string(&aligned).unwrap();
    assert!(text.contains("\"alignment_covariance\""), "{text}");
    // What it wrote is a calibration again.
    let ran = wimu(&["align", &csv, "--calibration", &aligned, "--up", "z,x"]);
    let again = ran.succeeds();
    let mut texts = Transcript::default();
    texts.text("align --up z,x", &ran);
    assert_eq!(again["rests"], 2);
    assert_eq!(again["found"].as_array().unwrap().len(), 2);

    // An accidental rest between: `--rests` names the ones to use.
    let thrice = table(
        &|t| {
            let step = |from: f64| (t - from).clamp(0.0, 1.0);
            let angle = (0.3 * step(5.0) + 0.7 * step(11.0)) * std::f64::consts::FRAC_PI_2;
            [0.0, 9.81 * angle.sin(), 9.81 * angle.cos()]
        },
        17,
    );
    fs::write(&csv, thrice).unwrap();
    let unclear = wimu(&["align", &csv, "--calibration", &cal, "--up", "z,x"]);
    assert_eq!(unclear.refuses()["rests"], 3);
    texts.text("three rests", &unclear);
    texts.check("align");
    for (found, expected) in
        of(&["--up", "z,x", "--rests", "0,2"]).iter().zip([half, 0.0, 0.0, -half])
    {
        assert!((found - expected).abs() < 0.01, "{found} {expected}");
    }
    for wrong in [["--rests", "0"], ["--rests", "2,0"]] {
        let of = ["align", &csv, "--calibration", &cal, "--up", "z,x"];
        wimu(&[&of[..], &wrong].concat()).fails(2, "usage");
    }

    // The same by a push of 1 m along the sensor's y.
    let push = table(
        &|t| {
            let u = ((t - 5.0) / 3.0).clamp(0.0, 1.0);
            [0.0, 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / 9.0, 9.81]
        },
        13,
    );
    fs::write(&csv, push).unwrap();
    for (found, expected) in of(&["--forward"]).iter().zip([half, 0.0, 0.0, -half]) {
        assert!((found - expected).abs() < 0.02, "{found} {expected}");
    }

    // The calibration for others.
    for (format, word) in
        [("rust", "pub fn correct"), ("c", "wimu_correct"), ("kalibr", "accelerometers:")]
    {
        let file = path(format);
        wimu(&["export", &aligned, "--format", format, "-o", &file]).succeeds();
        assert!(fs::read_to_string(&file).unwrap().contains(word));
    }
    // A table is no calibration.
    wimu(&["export", &csv, "--format", "c", "-o", &path("c")]).fails(2, "bad_calibration");
    // Without -o it is printed; a table needs a file.
    let ran = wimu(&["export", &aligned, "--format", "kalibr"]);
    let mut texts = Transcript::default();
    let printed = texts.findings("export --format kalibr", &ran);
    texts.check("export_kalibr");
    let text = printed["text"].as_str().unwrap();
    assert_eq!(text, fs::read_to_string(path("kalibr")).unwrap());
    wimu(&["export", &aligned]).fails(2, "usage");

    // One direction, a rest that is not there, no axis.
    wimu(&["align", &csv, "--calibration", &cal]).fails(2, "usage");
    wimu(&["align", &csv, "--calibration", &cal, "--up", "z,w"]).fails(2, "usage");
    wimu(&["align", &csv, "--up", "z,x"]).fails(2, "usage");
    let same = wimu(&["align", &csv, "--calibration", &cal, "--up", "z,z"]);
    same.refuses();
}
