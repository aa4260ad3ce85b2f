use std::path::PathBuf;

use wimu_model::STANDARD_GRAVITY_MPS2;

use super::*;

/// A motion that never repeats itself, m/s².
fn force(time: f64) -> [f64; 3] {
    let swing = |a: f64, b: f64| 3.0 * (a * time).sin() * (b * time * time / 40.0).sin();
    let quiet = if (2.0..5.0).contains(&(time % 11.0)) {
        0.1
    } else {
        1.0
    };
    [
        0.4 + quiet * swing(2.3, 1.1),
        quiet * swing(3.1, 1.7),
        9.7 + quiet * swing(1.3, 2.1),
    ]
}

/// A table of its own for each test.
fn table(name: &str, rows: impl Iterator<Item = (f64, [f64; 3])>, unit: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("wimu-align-{}-{name}.csv", std::process::id()));
    let mut text = format!(
        "Time (s),Accelerometer X ({unit}),Accelerometer Y ({unit}),Accelerometer Z ({unit})\n"
    );
    for (time, [x, y, z]) in rows {
        text += &format!("{time:.6},{x},{y},{z}\n");
    }
    std::fs::write(&path, text).unwrap();
    path
}

fn times(rate: f64, from: f64, to: f64) -> impl Iterator<Item = f64> {
    (0..((to - from) * rate) as u32).map(move |k| from + f64::from(k) / rate)
}

#[test]
fn two_tables_of_different_rates_and_clocks_are_aligned_by_their_motion() {
    let a = table("a", times(100.0, 0.0, 60.0).map(|t| (t, force(t))), "m/s²");
    // Another rate and unit, 7.3 s of its own clock later, 200 ppm fast, with bias and scale.
    let b = table(
        "b",
        times(143.0, 5.0, 55.0).map(|t| {
            let [x, y, z] = force(t);
            let seen = [1.01 * x + 0.2, y - 0.1, 0.99 * z];
            (
                7.3 + t * (1.0 + 200e-6),
                seen.map(|v| v / STANDARD_GRAVITY_MPS2),
            )
        }),
        "g",
    );
    let found = align(&a, &b).unwrap();
    // At the middle, 30 s, the other shows 37.306 s.
    assert!((found.offset_s + 7.306).abs() < 0.004, "{found:?}");
    assert!((found.rate_ppm.unwrap() + 200.0).abs() < 60.0, "{found:?}");
    assert!(found.correlation > 0.98 && found.overlap_s > 49.0);
    let lines = found.axes.unwrap().map(|axis| axis.line.unwrap());
    assert!((lines[0].bias_mps2 - 0.2).abs() < 0.02 && (lines[0].scale - 1.01).abs() < 0.01);
    assert!((lines[1].bias_mps2 + 0.1).abs() < 0.02, "{lines:?}");
    for path in [a, b] {
        std::fs::remove_file(path).unwrap();
    }
}

#[test]
fn a_narrower_range_leaves_out_what_it_clips_and_an_unknown_unit_is_in_the_interval() {
    let a = table("f", times(100.0, 0.0, 60.0).map(|t| (t, force(t))), "m/s²");
    let seen = |t: f64| {
        let [x, y, z] = force(t);
        [1.01 * x + 0.2, 0.98 * y - 0.1, 1.02 * z]
    };
    let all: Vec<_> = times(100.0, 0.0, 60.0).map(|t| (t, seen(t))).collect();
    let most = |axis: usize| all.iter().map(|(_, v)| v[axis].abs()).fold(0.0, f64::max);
    let ends = [0, 1, 2].map(|axis| 0.8 * most(axis));
    let clip = |v: [f64; 3]| [0, 1, 2].map(|k| v[k].clamp(-ends[k], ends[k]));
    let clipped = table("g", all.iter().map(|(t, v)| (*t, clip(*v))), "m/s²");
    let found = align(&a, &clipped).unwrap();
    assert!(found.saturated > 50, "{found:?}");
    let lines = found.axes.unwrap().map(|axis| axis.line.unwrap());
    for (line, scale) in lines.iter().zip([1.01, 0.98, 1.02]) {
        assert!((line.scale - scale).abs() < 0.01, "{lines:?}");
    }
    // In LSB the scale is that of the magnitude in motion: told, and in the interval.
    let counts = table(
        "h",
        all.iter()
            .map(|(t, v)| (*t, v.map(|v| (v * 417.7).round()))),
        "LSB",
    );
    let found = align(&a, &counts).unwrap();
    assert_eq!(found.saturated, 0);
    assert!(found.unit_sd[0].is_none() && found.unit_sd[1].is_some_and(|sd| sd >= 0.03));
    let lines = found.axes.unwrap().map(|axis| axis.line.unwrap());
    for (line, scale) in lines.iter().zip([1.01, 0.98, 1.02]) {
        let apart = (line.scale - scale).abs();
        assert!(
            apart < 2.0 * line.scale_sd && line.scale_sd >= 0.029,
            "{line:?}"
        );
    }
    for path in [a, clipped, counts] {
        std::fs::remove_file(path).unwrap();
    }
}

#[test]
fn tables_that_do_not_fit_or_fit_twice_are_refused() {
    let a = table("c", times(100.0, 0.0, 30.0).map(|t| (t, force(t))), "m/s²");
    let stranger = table(
        "d",
        times(100.0, 0.0, 30.0).map(|t| (t, force(500.0 + 1.37 * t))),
        "m/s²",
    );
    let periodic = |t: f64| {
        [
            (5.0 * t).sin(),
            (5.0 * t).cos(),
            9.8 + 2.0 * (5.0 * t).sin(),
        ]
    };
    let swing = table(
        "e",
        times(100.0, 0.0, 30.0).map(|t| (t, periodic(t))),
        "m/s²",
    );
    for (other, says) in [(&stranger, "no part"), (&swing, "")] {
        let error = align(&a, other).unwrap_err();
        assert_eq!(error.code(), ErrorCode::DataRefused, "{error}");
        assert!(error.message().contains(says), "{error}");
    }
    let error = align(&swing, &swing).unwrap_err();
    assert!(error.message().contains("more than one place"), "{error}");
    for path in [a, stranger, swing] {
        std::fs::remove_file(path).unwrap();
    }
}

#[test]
fn a_link_model_is_read_back_and_undoes_what_it_says() {
    let model = LinkModel {
        schema: "wimu.link_model/1".to_owned(),
        link: "wireless".to_owned(),
        device_id: "0000000000000001".to_owned(),
        bias_mps2: [0.1, -0.2, 0.3],
        scale: [1.01, 0.99, 1.0],
        bias_sd_mps2: [0.0; 3],
        scale_sd: [Some(0.0), Some(0.0), None],
        pairs: 10,
    };
    let path = std::env::temp_dir().join(format!("wimu-link-model-{}.json", std::process::id()));
    model.write(&path).unwrap();
    assert_eq!(LinkModel::read(&path).unwrap(), model);
    let seen = [1.01 * 2.0 + 0.1, 0.99 * 3.0 - 0.2, 4.0 + 0.3];
    for (found, truth) in model.correct(seen).iter().zip([2.0, 3.0, 4.0]) {
        assert!((found - truth).abs() < 1e-12);
    }
    for text in ["{}", "[]", "nothing", r#"{"schema":"wimu.calibration/1"}"#] {
        std::fs::write(&path, text).unwrap();
        assert_eq!(LinkModel::read(&path).unwrap_err().exit_code(), 2);
    }
    let wild = LinkModel {
        scale: [0.0, 1.0, 1.0],
        ..model
    };
    wild.write(&path).unwrap();
    assert_eq!(LinkModel::read(&path).unwrap_err().exit_code(), 2);
    std::fs::remove_file(&path).unwrap();
}
