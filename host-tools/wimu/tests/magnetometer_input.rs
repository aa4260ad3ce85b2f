//! What people give `wimu calibrate --sensor magnetometer`.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{Links, Simulator, folder, wimu};
use serde_json::Value;

/// A sensor held in 30 orientations: accelerometer with a bias of 0.1 m/s² on X, field of 48.3 µT, 65.6°
/// down, hard iron of 12, −7 and 20 µT.
fn poses() -> Vec<([f64; 3], [f64; 3])> {
    (0..30)
        .map(|k| {
            // Evenly over the sphere, and about it.
            let z = 1.0 - (2.0 * f64::from(k) + 1.0) / 30.0;
            let (sin, cos) = (2.399_963 * f64::from(k)).sin_cos();
            let flat = (1.0 - z * z).sqrt();
            let up = [flat * cos, flat * sin, z];
            let (a, b) = ([-sin, cos, 0.0], [-z * cos, -z * sin, flat]);
            let (s, c) = (1.7 * f64::from(k)).sin_cos();
            let north = [0, 1, 2].map(|i| c * a[i] + s * b[i]);
            // A tenth of a percent of disorder, the same in every run.
            let rough = |i: usize| 0.03 * (f64::from(k) * 7.3 + 2.1 * i as f64).sin();
            let field: [f64; 3] = std::array::from_fn(|i| {
                20.0 * north[i] - 44.0 * up[i] + [12.0, -7.0, 20.0][i] + rough(i)
            });
            let force = std::array::from_fn(|i| 9.81 * up[i] + [0.1, 0.0, 0.0][i] + 0.1 * rough(i));
            (force, field)
        })
        .collect()
}

fn table(poses: &[([f64; 3], [f64; 3])], unit: &str) -> String {
    let axes = |name: &str, unit: &str| {
        ["X", "Y", "Z"]
            .map(|axis| format!("{name} {axis} ({unit})"))
            .join(",")
    };
    let mut text = format!(
        "{},{}",
        axes("Accelerometer", "m/s²"),
        axes("Magnetometer", unit)
    );
    for (force, field) in poses {
        let [a, b, c] = force;
        let [x, y, z] = field;
        write!(text, "\n{a},{b},{c},{x},{y},{z}").unwrap();
    }
    text
}

#[test]
fn every_bad_input_is_named_and_none_becomes_a_calibration() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (csv, accelerometer, both) = (path("poses.csv"), path("A.json"), path("BOTH.json"));
    fs::write(&csv, table(&poses(), "µT")).unwrap();
    let sensitivity = ["--sensitivity", "16384"];
    let of = ["calibrate", &csv, "--poses", "-o"];
    wimu(&[&of[..], &[&accelerometer], &sensitivity].concat()).succeeds();
    let run = |poses: &[([f64; 3], [f64; 3])], unit: &str, report: &str| {
        fs::write(&csv, table(poses, unit)).unwrap();
        let _ = fs::remove_file(&both);
        let with = ["--sensor", "magnetometer", "--with", &accelerometer];
        let to = [&both, "--report", report];
        let done = wimu(&[&of[..], &to, &with].concat());
        assert_eq!(done.code == 0, fs::exists(&both).unwrap(), "{done:?}");
        (done.code, done.object())
    };
    let changed = |change: &dyn Fn(usize, &mut [f64; 3])| {
        let mut poses = poses();
        for (k, (_, field)) in poses.iter_mut().enumerate() {
            change(k, field);
        }
        poses
    };
    let hard_iron = |report: &Value| -> Vec<f64> {
        let axes = report["magnetometer"]["hard_iron_nt"].as_array().unwrap();
        axes.iter()
            .map(|axis| axis.as_f64().unwrap() / 1e3)
            .collect()
    };
    let near = |found: &[f64]| {
        let off = found.iter().zip([12.0, -7.0, 20.0]);
        off.map(|(f, t)| (f - t).abs()).fold(0.0, f64::max) < 0.2
    };

    // As it should be, in each unit, with a page.
    let page = path("page.html");
    for (unit, per_ut) in [("µT", 1.0), ("uT", 1.0), ("T", 1e-6), ("G", 0.01)] {
        let scaled = changed(&|_, field| *field = field.map(|axis| axis * per_ut));
        let (code, report) = run(&scaled, unit, &page);
        assert_eq!(code, 0, "{unit}: {report}");
        assert!(near(&hard_iron(&report)), "{unit}: {report}");
        assert!((report["dip_deg"].as_f64().unwrap() - 65.6).abs() < 0.5);
        let remark = report["remarks"][0].as_str().unwrap();
        assert!(remark.contains("--dip"), "{report}");
    }
    assert!(fs::read_to_string(&page).unwrap().contains("|B|"));

    // A phone beside two of the poses.
    let beside = changed(&|k, field| {
        if k == 4 || k == 20 {
            field[k % 3] += 9.0;
        }
    });
    let (code, report) = run(&beside, "µT", &page);
    assert_eq!(code, 0, "{report}");
    let rejected: Vec<u64> = report["rejected_poses"]
        .as_array()
        .unwrap()
        .iter()
        .map(|pose| pose.as_u64().unwrap())
        .collect();
    assert!(rejected.contains(&4) && rejected.contains(&20), "{report}");
    assert!(rejected.len() == 2 && near(&hard_iron(&report)), "{report}");

    type Change<'a> = &'a dyn Fn(usize, &mut [f64; 3]);
    let refused: [(Change, &str, &str); 7] = [
        (
            &|k, field| field[k % 3] += if k % 2 == 0 { 15.0 } else { 0.0 },
            "µT",
            "the same in all poses",
        ),
        (&|_, field| field[1] = 3.0, "µT", "axis Y says the same"),
        (
            &|_, field| field[2] = field[2].min(25.0),
            "µT",
            "axis Z stands at 25.0",
        ),
        // µT in a column that says T or G, and T in one that says µT.
        (&|_, _| {}, "T", "check the unit"),
        (&|_, _| {}, "G", "check the unit"),
        (
            &|_, field| *field = field.map(|axis| axis * 1e-6),
            "µT",
            "check the unit",
        ),
        // All fields in a plane, tilted against the axes.
        (
            &|_, field| field[2] = 0.5 * field[0] - 0.3 * field[1] + 1.0,
            "µT",
            "do not determine",
        ),
    ];
    for (change, unit, reason) in refused {
        let (code, report) = run(&changed(change), unit, &page);
        let told = report["reason"].as_str().unwrap();
        assert!(code == 3 && told.contains(reason), "{reason}: {report}");
        assert!(report["parameters"].is_null());
    }

    // A phone beside eleven poses of thirty: these are named, and no pose is advised that mends nothing.
    let (code, report) = run(
        &changed(&|k, field| field[0] += if k < 11 { 14.0 } else { 0.0 }),
        "µT",
        &page,
    );
    let told = report["reason"].as_str().unwrap();
    assert!(
        code == 3 && told.contains("disturbed in poses") && told.contains(", 8, 9, 10 (from 0)"),
        "{report}"
    );
    assert_eq!(report["next_poses"].as_array().unwrap().len(), 0);

    // An axis that the driver negates, and the same readings south of the magnetic equator.
    let negated = changed(&|_, field| field[1] = -field[1]);
    let (code, report) = run(&negated, "µT", &page);
    let told = report["reason"].as_str().unwrap();
    assert!(
        code == 3 && told.contains("axis Y is negated") && told.contains("--dip -66"),
        "{report}"
    );
    let dipping = |place: &str| {
        let with = [
            "--sensor",
            "magnetometer",
            "--with",
            &accelerometer,
            "--dip",
            place,
        ];
        wimu(&[&of[..], &[both.as_str()], &with].concat())
    };
    let south = dipping("-60").succeeds();
    assert_eq!(south["remarks"].as_array().unwrap().len(), 0, "{south}");
    let bent = dipping("-30").succeeds();
    assert!(bent["remarks"][0].as_str().unwrap().contains("distorts"));
    assert_eq!(dipping("60").code, 3);
    dipping("100").fails(2, "usage");

    // Too few, and which to add.
    let (code, report) = run(&poses()[..8], "µT", &page);
    assert_eq!(code, 3);
    let next = &report["next_poses"][0];
    assert!(
        !next["instruction"].as_str().unwrap().is_empty(),
        "{report}"
    );
    assert!(report["poses_worth_adding"].as_u64().unwrap() > 0);
}

#[test]
fn a_board_without_a_magnetometer_is_told_so() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (recording, accelerometer) = (path("s.mcap"), path("A.json"));
    let (csv, motion) = (path("p.csv"), ["--sensor", "adxl345", "--speed", "10"]);
    fs::write(&csv, table(&poses(), "µT")).unwrap();
    let of = ["calibrate", &csv, "--poses", "--sensitivity", "256"];
    wimu(&[&of[..], &["-o", &accelerometer]].concat()).succeeds();
    let board = Simulator::start(&motion);
    board.record_samples(Links::Cable, &recording, 1500);
    let of = ["calibrate", &recording, "--sensor", "magnetometer"];
    let told = wimu(&[&of[..], &["--with", &accelerometer]].concat()).fails(3, "data_refused");
    assert!(
        told["message"]
            .as_str()
            .unwrap()
            .contains("no magnetometer")
    );
}
