//! Wrong input of `wimu calibrate --sensor magnetometer`.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{Ran, Transcript, folder, wimu};
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
        ["X", "Y", "Z"].map(|axis| format!("{name} {axis} ({unit})")).join(",")
    };
    let mut text = format!("{},{}", axes("Accelerometer", "m/s²"), axes("Magnetometer", unit));
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
    let run = |poses: &[([f64; 3], [f64; 3])], unit: &str, report: &str| -> Ran {
        fs::write(&csv, table(poses, unit)).unwrap();
        let _ = fs::remove_file(&both);
        let with = ["--sensor", "magnetometer", "--with", &accelerometer];
        let to = [&both, "--report", report];
        let done = wimu(&[&of[..], &to, &with].concat());
        assert_eq!(done.code == 0, fs::exists(&both).unwrap(), "{done:?}");
        done
    };
    let mut texts = Transcript::default();
    let changed = |change: &dyn Fn(usize, &mut [f64; 3])| {
        let mut poses = poses();
        for (k, (_, field)) in poses.iter_mut().enumerate() {
            change(k, field);
        }
        poses
    };
    let hard_iron = |report: &Value| -> Vec<f64> {
        let axes = report["magnetometer"]["hard_iron_nt"].as_array().unwrap();
        axes.iter().map(|axis| axis.as_f64().unwrap() / 1e3).collect()
    };
    let near = |found: &[f64]| {
        let off = found.iter().zip([12.0, -7.0, 20.0]);
        off.map(|(f, t)| (f - t).abs()).fold(0.0, f64::max) < 0.2
    };

    // Right input in each unit, with a page.
    let page = path("page.html");
    for (unit, per_ut) in [("µT", 1.0), ("uT", 1.0), ("T", 1e-6), ("G", 0.01)] {
        let scaled = changed(&|_, field| *field = field.map(|axis| axis * per_ut));
        let report = texts.findings(unit, &run(&scaled, unit, &page));
        assert!(near(&hard_iron(&report)), "{unit}: {report}");
        assert!((report["dip_deg"].as_f64().unwrap() - 65.6).abs() < 0.5);
    }
    assert!(fs::read_to_string(&page).unwrap().contains("|B|"));

    // A phone beside two of the poses.
    let beside = changed(&|k, field| {
        if k == 4 || k == 20 {
            field[k % 3] += 9.0;
        }
    });
    let ran = run(&beside, "µT", &page);
    let report = texts.findings("disturbed in two poses", &ran);
    let rejected: Vec<u64> = report["rejected_poses"]
        .as_array()
        .unwrap()
        .iter()
        .map(|pose| pose.as_u64().unwrap())
        .collect();
    assert!(rejected.contains(&4) && rejected.contains(&20), "{report}");
    assert!(rejected.len() == 2 && near(&hard_iron(&report)), "{report}");

    type Change<'a> = &'a dyn Fn(usize, &mut [f64; 3]);
    let refused: [(&str, Change, &str); 7] = [
        (
            "disturbed in every other pose",
            &|k, field| field[k % 3] += if k % 2 == 0 { 15.0 } else { 0.0 },
            "µT",
        ),
        ("axis Y constant", &|_, field| field[1] = 3.0, "µT"),
        ("axis Z clipped at 25 µT", &|_, field| field[2] = field[2].min(25.0), "µT"),
        ("µT called T", &|_, _| {}, "T"),
        ("µT called G", &|_, _| {}, "G"),
        ("T called µT", &|_, field| *field = field.map(|axis| axis * 1e-6), "µT"),
        (
            "all in a plane, tilted against the axes",
            &|_, field| field[2] = 0.5 * field[0] - 0.3 * field[1] + 1.0,
            "µT",
        ),
    ];
    for (case, change, unit) in refused {
        let report = texts.refuses(case, &run(&changed(change), unit, &page));
        assert!(report["parameters"].is_null());
    }

    // A phone beside eleven poses of thirty: these are named; no further pose helps.
    let disturbed = changed(&|k, field| field[0] += if k < 11 { 14.0 } else { 0.0 });
    let ran = run(&disturbed, "µT", &page);
    let report = texts.refuses("disturbed in eleven poses", &ran);
    assert_eq!(report["next_poses"].as_array().unwrap().len(), 0);

    // An axis that the driver negates, and the same readings south of the magnetic equator.
    let negated = changed(&|_, field| field[1] = -field[1]);
    texts.refuses("axis Y negated", &run(&negated, "µT", &page));
    let dipping = |dip: &str| {
        let with = ["--sensor", "magnetometer", "--with", &accelerometer, "--dip", dip];
        wimu(&[&of[..], &[both.as_str()], &with].concat())
    };
    let south = dipping("-60").succeeds();
    assert_eq!(south["problems"].as_array().unwrap().len(), 0, "{south}");
    texts.findings("axis Y negated, --dip -30", &dipping("-30"));
    texts.refuses("axis Y negated, --dip 60", &dipping("60"));
    dipping("100").fails(2, "usage");

    // Too few, and which to add.
    let report = texts.refuses("eight poses", &run(&poses()[..8], "µT", &page));
    let next = &report["next_poses"][0];
    assert!(!next["instruction"].as_str().unwrap().is_empty(), "{report}");
    assert!(report["poses_worth_adding"].as_u64().unwrap() > 0);
    texts.check("calibrate_magnetometer_input");
}
