//! Exported calibrations, compiled or run, compute what the calibration itself computes.

use std::fs;
use std::path::Path;
use std::process::Command;

use wimu_host::calibration::{Calibration, CalibrationExport, ExportTarget, KalibrNoise};
use wimu_host::csv::AccelerationUnit;
use wimu_model::{
    Alignment, CentiCelsius, ErrorModel, ErrorTerms, GyroscopeModel, GyroscopeParameters,
    GyroscopeTemperatureTerms, GyroscopeTerms, ParameterSet, STANDARD_GRAVITY_MPS2, Sensitivity,
    SpecificForceMps2, TemperatureTerms,
};

use crate::common::Random;

fn set() -> ParameterSet {
    let gyroscope = GyroscopeModel::new(GyroscopeTerms {
        bias_rad_s: [0.01, -0.02, 0.03],
        matrix: [[1.01, 0.02, 0.0], [-0.03, 0.99, 0.01], [0.004, -0.005, 1.02]],
        g_sensitivity: [[1e-3, 0.0, -2e-4], [3e-4, -2e-3, 0.0], [0.0, 1e-4, 5e-4]],
        temperature: GyroscopeTemperatureTerms {
            reference_c: 22.0,
            bias_rad_s_per_k: [1e-4, -2e-4, 3e-5],
            scale_per_k: [1e-4, 0.0, -3e-4],
        },
    });
    ParameterSet {
        model: ErrorModel::new(ErrorTerms {
            bias_mps2: [0.125, -0.3, 0.51],
            matrix: [[1.01, 0.002, -0.003], [0.011, 0.985, 0.004], [-0.02, 0.005, 1.02]],
            temperature: TemperatureTerms {
                reference_c: 24.5,
                bias_mps2_per_k: [0.001, -0.002, 0.003],
                bias_mps2_per_k2: [1e-5, 0.0, -2e-5],
                scale_per_k: [1e-4, 2e-4, -1e-4],
            },
            nonlinearity: [1e-5, -2e-5, 0.0],
        })
        .unwrap(),
        alignment: Alignment::from_quaternion([0.9, 0.1, -0.2, 0.3]).unwrap(),
        gyroscope: Some(GyroscopeParameters::new(2000, 0.001, gyroscope.unwrap(), None).unwrap()),
        ..ParameterSet::uncalibrated(4, Sensitivity::from_lsb_per_g(8192.0).unwrap())
    }
}

/// The export of `set`, of counts or of output in m/s².
fn export(set: &ParameterSet, of_counts: bool, folder: &Path) -> CalibrationExport {
    let mut file = Calibration::held(set);
    if !of_counts {
        let accelerometer = &mut file.sensor_mut().accelerometer;
        accelerometer.unit = AccelerationUnit::Mps2;
        (accelerometer.range_g, accelerometer.sensitivity_lsb_per_g) = (None, None);
    }
    let path = folder.join("CAL.json");
    file.write(&path).unwrap();
    CalibrationExport::read(&path).unwrap()
}

/// Output of accelerometer and gyroscope, temperature, °C, and what they are corrected to.
struct Case {
    output: [f64; 3],
    rate: [f64; 3],
    temperature: CentiCelsius,
    expected: [f64; 6],
}

fn cases(set: &ParameterSet, of_counts: bool) -> Vec<Case> {
    let mut random = Random::new(7);
    let mut vector = |scale: f64| [0, 1, 2].map(|_| random.within(scale));
    let scale = if of_counts { STANDARD_GRAVITY_MPS2 / set.sensitivity.lsb_per_g() } else { 1.0 };
    let gyroscope = set.gyroscope.unwrap();
    let one = |k: i16| {
        let (output, rate) = (vector(40.0 / scale), vector(6000.0));
        let temperature = CentiCelsius(250 * k);
        let sensed = SpecificForceMps2(output.map(|axis| axis * scale));
        let force = set.model.correct(sensed, Some(temperature)).0;
        let sensed = rate.map(|axis| axis * gyroscope.rad_s_per_lsb);
        let turned = gyroscope.model.correct(sensed, force, Some(temperature));
        let ([x, y, z], [u, v, w]) = (set.alignment.rotate(force), set.alignment.rotate(turned));
        // Beside accelerations in m/s² the gyroscope's output is in rad/s.
        let rate = if of_counts { rate } else { sensed };
        Case { output, rate, temperature, expected: [x, y, z, u, v, w] }
    };
    (0..20).map(one).collect()
}

/// Runs a program; `None` where it is missing.
fn run(program: &str, arguments: &[&str], folder: &Path) -> Option<String> {
    let ran = Command::new(program).args(arguments).current_dir(folder).output();
    let Ok(ran) = ran else {
        println!("skipped: there is no `{program}`");
        return None;
    };
    let errors = String::from_utf8_lossy(&ran.stderr);
    if errors.contains("No module named") {
        println!("skipped: {errors}");
        return None;
    }
    assert!(ran.status.success(), "{program}: {errors}");
    Some(String::from_utf8(ran.stdout).unwrap())
}

/// Writes the exported file and a program with a call for each case, of counts and of m/s², and compares what `run` prints.
fn computes_the_same(
    target: ExportTarget,
    file: &str,
    (name, before, after): (&str, &str, &str),
    call: impl Fn(&Case) -> String,
    run: impl Fn(&Path) -> Option<String>,
) {
    for of_counts in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let text = export(&set(), of_counts, folder.path()).text(target, None);
        fs::write(folder.path().join(file), text).unwrap();
        let cases = cases(&set(), of_counts);
        let calls: String = cases.iter().map(&call).collect();
        fs::write(folder.path().join(name), format!("{before}{calls}{after}")).unwrap();
        let Some(text) = run(folder.path()) else {
            return;
        };
        assert_eq!(text.lines().count(), cases.len(), "{text}");
        for (case, line) in cases.iter().zip(text.lines()) {
            let found: Vec<f64> = line.split_whitespace().map(|n| n.parse().unwrap()).collect();
            assert_eq!(found.len(), 6);
            for (part, found) in case.expected.chunks(3).zip(found.chunks(3)) {
                let norm = part.iter().map(|v| v * v).sum::<f64>().sqrt();
                for (ours, theirs) in part.iter().zip(found) {
                    let off = (ours - theirs).abs() / norm;
                    assert!(off < 1e-9, "{target:?}: {ours} {theirs}");
                }
            }
        }
    }
}

fn list(v: [f64; 3]) -> String {
    format!("{:?}, {:?}, {:?}", v[0], v[1], v[2])
}

#[test]
fn c_computes_the_same() {
    computes_the_same(
        ExportTarget::C,
        "wimu_calibration.h",
        (
            "main.c",
            "#include <stdio.h>\n#include \"wimu_calibration.h\"\nint main(void) {\n    double f[3], w[3];\n",
            "    return 0;\n}\n",
        ),
        |case| {
            let (at, output, rate) =
                (case.temperature.to_celsius(), list(case.output), list(case.rate));
            format!(
                "    {{ const double a[3] = {{{output}}}, g[3] = {{{rate}}}; wimu_correct(a, {at:?}, f); \
                 wimu_correct_rate(g, f, {at:?}, w); \
                 printf(\"%.17g %.17g %.17g %.17g %.17g %.17g\\n\", f[0], f[1], f[2], w[0], w[1], w[2]); }}\n"
            )
        },
        |folder| {
            let warnings = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"];
            let arguments = [&warnings[..], &["-o", "main", "main.c"]].concat();
            run("cc", &arguments, folder)?;
            let binary = folder.join("main").display().to_string();
            run(&binary, &[], folder)
        },
    );
}

/// `WIMU_PYTHON` may name a Python that has NumPy.
#[test]
fn numpy_computes_the_same() {
    let python = std::env::var("WIMU_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    computes_the_same(
        ExportTarget::Numpy,
        "wimu_calibration.py",
        ("main.py", "from wimu_calibration import correct, correct_rate\n", ""),
        |case| {
            let (at, output, rate) =
                (case.temperature.to_celsius(), list(case.output), list(case.rate));
            // As a row of an array, and alone.
            format!(
                "f = correct([[{output}]], {at:?})[0]\nw = correct_rate([{rate}], f, {at:?})\nprint(*f.tolist(), *w.tolist())\n"
            )
        },
        |folder| run(&python, &["main.py"], folder),
    );
}

#[test]
fn matlab_computes_the_same() {
    computes_the_same(
        ExportTarget::Matlab,
        "wimu_correct.m",
        ("main.m", "", ""),
        |case| {
            let (at, output, rate) =
                (case.temperature.to_celsius(), list(case.output), list(case.rate));
            format!(
                "[f, w] = wimu_correct([{output}], {at:?}, [{rate}]);\nprintf('%.17g ', f, w);\nprintf('\\n');\n"
            )
        },
        |folder| run("octave-cli", &["main.m"], folder),
    );
}

#[test]
fn the_matrix_of_imu_calib_ends_in_body_axes() {
    let folder = tempfile::tempdir().unwrap();
    let mut set = set();
    set.model = ErrorModel::new(ErrorTerms {
        temperature: TemperatureTerms::default(),
        nonlinearity: [0.0; 3],
        ..*set.model.terms()
    })
    .unwrap();
    let text = export(&set, false, folder.path()).text(ExportTarget::Ros, None);
    let numbers = |key: &str| -> Vec<f64> {
        let line = text.lines().find_map(|line| line.strip_prefix(key)).unwrap();
        let inside = line.trim_matches(['[', ']']);
        inside.split(", ").map(|n| n.parse().unwrap()).collect()
    };
    let (matrix, bias) = (numbers("SM: "), numbers("bias: "));
    let output = [1.0, -2.0, 9.0];
    let force = set.model.correct(SpecificForceMps2(output), None).0;
    for (i, expected) in set.alignment.rotate(force).into_iter().enumerate() {
        let found: f64 = (0..3).map(|j| matrix[3 * i + j] * output[j]).sum();
        assert!((found - bias[i] - expected).abs() < 1e-12);
    }
}

#[test]
fn kalibr_has_its_keys_and_never_an_invented_noise() {
    let folder = tempfile::tempdir().unwrap();
    let export = export(&set(), true, folder.path());
    let kalibr = |text: Option<&str>| {
        let noise = text.map(|text| KalibrNoise::parse(text).unwrap());
        export.text(ExportTarget::Kalibr, noise.as_ref())
    };
    let axis = r#"{"random_walk": {"value": 0.002}, "bias_random_walk": {"value": 0.0001}}"#;
    let unseen = r#"{"random_walk": {"value": 0.001}, "floor": 2e-4, "floor_tau_s": 3.0}"#;
    let report = |axes: &str| {
        format!(
            r#"{{"command": "allan", "data": {{"rate_hz": 100.0, "accelerometer": {{"axes": [{axes}]}}}}}}"#
        )
    };
    let text = kalibr(Some(&report(axis)));
    for line in [
        "rostopic: /imu/data_raw",
        "update_rate: 100.0",
        "accelerometer_noise_density: 0.002",
        "accelerometer_random_walk: 0.0001",
        "accelerometers:",
        "  - [1.01, 0.002, -0.003]",
        "  b: [0.125, -0.3, 0.51]",
        "gyroscopes:",
        "  - [-0.03, 0.99, 0.01]",
        "  b: [0.01, -0.02, 0.03]",
    ] {
        assert!(text.lines().any(|found| found == line), "{line} in {text}");
    }
    // The noisiest axis counts, and the bound where a random walk was not observed.
    let both = kalibr(Some(&report(&format!("{axis}, {unseen}"))));
    assert!(both.contains("\naccelerometer_noise_density: 0.002\n"), "{both}");
    assert!(both.contains("\naccelerometer_random_walk: 0.0002\n"), "{both}");
    assert!(KalibrNoise::parse(&report("")).is_none() && KalibrNoise::parse("{}").is_none());
    for word in ["at 24.50 °C", "nonlinearity", "alignment"] {
        assert!(text.contains(word), "{word} in {text}");
    }
    let text = kalibr(None);
    let has_noise = |line: &str| line.starts_with("accelerometer_noise");
    assert!(!text.lines().any(has_noise));
}
