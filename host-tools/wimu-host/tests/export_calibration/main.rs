//! Exported calibrations compute what the calibration itself computes.

use std::fs;
use std::process::Command;

use wimu_host::calibration::{KalibrNoise, not_in_kalibr, to_c, to_kalibr, to_rust};
use wimu_model::{
    Alignment, CentiCelsius, Counts, ErrorModel, ErrorTerms, GyroscopeModel, GyroscopeParameters,
    GyroscopeTemperatureTerms, GyroscopeTerms, ParameterSet, Sensitivity, TemperatureTerms,
};

/// Compiled from the file that `to_rust` writes.
#[rustfmt::skip]
mod exported_calibration;

fn set() -> ParameterSet {
    ParameterSet {
        model: ErrorModel::new(ErrorTerms {
            bias_mps2: [0.125, -0.3, 0.51],
            matrix: [
                [1.01, 0.002, -0.003],
                [0.011, 0.985, 0.004],
                [-0.02, 0.005, 1.02],
            ],
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
        gyroscope: GyroscopeParameters::new(500, 0.000_305, gyroscope(), Some([0.001; 12])).ok(),
        ..ParameterSet::uncalibrated(4, Sensitivity::from_lsb_per_g(8192.0).unwrap())
    }
}

fn gyroscope() -> GyroscopeModel {
    GyroscopeModel::new(GyroscopeTerms {
        bias_rad_s: [0.01, -0.02, 0.03],
        matrix: [
            [0.99, 0.003, -0.001],
            [-0.004, 1.02, 0.002],
            [0.005, -0.006, 1.01],
        ],
        g_sensitivity: [[1e-4, 2e-4, 0.0], [0.0, -1e-4, 3e-4], [1e-5, 0.0, 2e-4]],
        temperature: GyroscopeTemperatureTerms {
            reference_c: 22.0,
            bias_rad_s_per_k: [1e-4, -2e-4, 3e-4],
            scale_per_k: [1e-4, 0.0, -1e-4],
        },
    })
    .unwrap()
}

const SAMPLES: [[i16; 3]; 5] = [
    [0, 0, 8192],
    [-8192, 100, -100],
    [32767, -32768, 12345],
    [-1, 2, -3],
    [5000, 6000, -7000],
];

#[test]
fn rust_is_the_set_again_as_compiled() {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/export_calibration/exported_calibration.rs"
    );
    if std::env::var_os("WRITE_VECTORS").is_some() {
        fs::write(path, to_rust(&set(), true)).unwrap();
    }
    assert_eq!(fs::read_to_string(path).unwrap(), to_rust(&set(), true));
    assert_eq!(exported_calibration::parameters(), Some(set()));
}

#[test]
fn c_computes_the_same() {
    let folder = std::env::temp_dir().join(format!("wimu-export-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("wimu_calibration.h"), to_c(&set(), true)).unwrap();
    let mut program = String::from(
        "#include <stdio.h>\n#include \"wimu_calibration.h\"\nint main(void) {\n    double f[3], w[3];\n",
    );
    for (k, [x, y, z]) in SAMPLES.into_iter().enumerate() {
        program += &format!(
            "    {{ const int16_t c[3] = {{{x}, {y}, {z}}}; wimu_correct(c, {t}, f); \
             wimu_correct_rate(c, f, {t}, w); \
             printf(\"%.17g %.17g %.17g %.17g %.17g %.17g\\n\", f[0], f[1], f[2], w[0], w[1], w[2]); }}\n",
            t = 10 + 10 * k
        );
    }
    program += "    return 0;\n}\n";
    let (source, binary) = (folder.join("main.c"), folder.join("main"));
    fs::write(&source, program).unwrap();
    let built = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-o"])
        .args([&binary, &source])
        .output();
    let Ok(built) = built else {
        println!("skipped: there is no C compiler `cc`");
        return;
    };
    assert!(
        built.status.success(),
        "{}",
        String::from_utf8_lossy(&built.stderr)
    );
    let ran = Command::new(&binary).output().unwrap();
    let text = String::from_utf8(ran.stdout).unwrap();
    assert_eq!(text.lines().count(), SAMPLES.len());
    for ((k, counts), line) in SAMPLES.into_iter().enumerate().zip(text.lines()) {
        let at = CentiCelsius(1000 + 1000 * k as i16);
        let force = set().correct(Counts(counts), Some(at)).0;
        let [x, y, z] = set().alignment.matrix();
        let in_sensor_axes =
            [0, 1, 2].map(|axis| x[axis] * force[0] + y[axis] * force[1] + z[axis] * force[2]);
        let output = counts.map(|count| f64::from(count) * 0.000_305);
        let rate = gyroscope().correct(output, in_sensor_axes, Some(at));
        let ours = force.into_iter().chain(set().alignment.rotate(rate));
        for (ours, theirs) in ours.zip(line.split(' ')) {
            let theirs: f64 = theirs.parse().unwrap();
            assert!((ours - theirs).abs() < 1e-10, "{ours} {theirs}");
        }
    }
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn kalibr_has_its_keys_and_never_an_invented_noise() {
    let noise = KalibrNoise {
        density: 0.002,
        random_walk: 1e-4,
        random_walk_seen: true,
        rate_hz: 100.0,
        coarse: false,
    };
    let text = to_kalibr(&set(), Some(noise));
    for line in [
        "rostopic: /imu/data_raw",
        "update_rate: 100.0",
        "accelerometer_noise_density: 0.002",
        "accelerometer_random_walk: 0.0001",
        "accelerometers:",
        "  - [1.01, 0.002, -0.003]",
        "  b: [0.125, -0.3, 0.51]",
        "gyroscopes:",
        "  - [0.99, 0.003, -0.001]",
        "  - [0.0001, 0.0002, 0.0]",
        "  b: [0.01, -0.02, 0.03]",
    ] {
        assert!(text.lines().any(|found| found == line), "{line} in {text}");
    }
    assert!(!text.contains("rounding"));
    assert!(!text.contains("Not observed"));
    let unseen = KalibrNoise {
        random_walk_seen: false,
        ..noise
    };
    let unseen = to_kalibr(&set(), Some(unseen));
    assert!(unseen.contains("# Not observed in the recording: upper bound"));
    assert!(unseen.contains("\naccelerometer_random_walk: 0.0001\n"));
    // What Kalibr has no place for is said.
    for word in ["at 24.50 °C", "at 22.00 °C", "nonlinearity", "alignment"] {
        assert!(text.contains(word), "{word} in {text}");
        assert!(not_in_kalibr(&set()).iter().any(|line| line.contains(word)));
    }
    let plain = ParameterSet::uncalibrated(4, set().sensitivity);
    assert!(not_in_kalibr(&plain).is_empty());
    let coarse = KalibrNoise {
        coarse: true,
        ..noise
    };
    assert!(to_kalibr(&set(), Some(coarse)).contains("# Counts are coarser"));
    let text = to_kalibr(&set(), None);
    assert!(
        !text
            .lines()
            .any(|line| line.starts_with("accelerometer_noise"))
    );
}
