//! Two tables of one motion, aligned by it.

use tempfile::{NamedTempFile, TempPath};
use wimu_host::Code;
use wimu_host::compare::align;
use wimu_model::STANDARD_GRAVITY_MPS2;
use wimu_testkit::{Coverage, Lane, Random, coverage_figure, figure};

/// A motion that never repeats itself, m/s².
fn force(time: f64) -> [f64; 3] {
    let swing = |a: f64, b: f64| 3.0 * (a * time).sin() * (b * time * time / 40.0).sin();
    let quiet = if (2.0..5.0).contains(&(time % 11.0)) { 0.1 } else { 1.0 };
    [0.4 + quiet * swing(2.3, 1.1), quiet * swing(3.1, 1.7), 9.7 + quiet * swing(1.3, 2.1)]
}

/// A table in a file that is removed when dropped.
fn table(rows: impl Iterator<Item = (f64, [f64; 3])>, unit: &str) -> TempPath {
    let path = NamedTempFile::with_suffix(".csv").unwrap().into_temp_path();
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
    let a = table(times(100.0, 0.0, 60.0).map(|t| (t, force(t))), "m/s²");
    // Another rate and unit, 7.3 s of its own clock later, 200 ppm fast, with bias and scale.
    let b = table(
        times(143.0, 5.0, 55.0).map(|t| {
            let [x, y, z] = force(t);
            let seen = [1.01 * x + 0.2, y - 0.1, 0.99 * z];
            (7.3 + t * (1.0 + 200e-6), seen.map(|v| v / STANDARD_GRAVITY_MPS2))
        }),
        "g",
    );
    let found = align(&a, &b).unwrap();
    // At the middle, 30 s, the other shows 37.306 s.
    assert!((found.offset_s + 7.306).abs() < 0.004, "{found:?}");
    let rate_error = (found.rate_ppm.unwrap() + 200.0).abs();
    assert!(rate_error < 60.0 && rate_error < 3.0 * found.rate_sd_ppm.unwrap(), "{found:?}");
    assert!(found.correlation > 0.98 && found.overlap_s > 49.0);
    let lines = found.axes.unwrap().map(|axis| axis.line.unwrap());
    assert!((lines[0].bias_mps2 - 0.2).abs() < 0.02 && (lines[0].scale - 1.01).abs() < 0.01);
    assert!((lines[1].bias_mps2 + 0.1).abs() < 0.02, "{lines:?}");
}

#[test]
fn a_slow_table_does_not_flatten_the_motion_whichever_of_the_two_it_is() {
    // Quicker than the others, 2.9 Hz, and rows 1.7 ms off those of the fast table.
    let quick = |t: f64| {
        let [x, y, z] = force(t);
        let [x, y] = [(18.2 * t).sin() + x, (14.9 * t).cos() + y];
        (t, [x, y, z + (11.3 * t).sin()])
    };
    let fast = table(times(200.0, 0.0, 60.0).map(quick), "m/s²");
    let slow = table(times(20.0, 5.0017, 55.0).map(quick), "m/s²");
    let mut worst = 0.0_f64;
    for (reference, other) in [(&fast, &slow), (&slow, &fast)] {
        let found = align(reference, other).unwrap();
        let lines = found.axes.unwrap().map(|axis| axis.line.unwrap());
        for line in lines {
            worst = worst.max((line.scale - 1.0).abs());
            assert!((line.scale - 1.0).abs() < 0.003, "{lines:?}");
        }
    }
    figure(
        "tables of 20 and 200 Hz, motion up to 2.9 Hz: error of scale",
        format!("{:.2} %", 100.0 * worst),
        "below 0.3 %",
        worst < 0.003,
    );
}

#[test]
fn a_narrower_range_leaves_out_what_it_clips_and_an_unknown_unit_is_in_the_interval() {
    let a = table(times(100.0, 0.0, 60.0).map(|t| (t, force(t))), "m/s²");
    let seen = |t: f64| {
        let [x, y, z] = force(t);
        [1.01 * x + 0.2, 0.98 * y - 0.1, 1.02 * z]
    };
    let all: Vec<_> = times(100.0, 0.0, 60.0).map(|t| (t, seen(t))).collect();
    let most = |axis: usize| all.iter().map(|(_, v)| v[axis].abs()).fold(0.0, f64::max);
    let ends = [0, 1, 2].map(|axis| 0.8 * most(axis));
    let clip = |v: [f64; 3]| [0, 1, 2].map(|k| v[k].clamp(-ends[k], ends[k]));
    let clipped = table(all.iter().map(|(t, v)| (*t, clip(*v))), "m/s²");
    let found = align(&a, &clipped).unwrap();
    assert!(found.saturated > 50, "{found:?}");
    let lines = found.axes.unwrap().map(|axis| axis.line.unwrap());
    for (line, scale) in lines.iter().zip([1.01, 0.98, 1.02]) {
        assert!((line.scale - scale).abs() < 0.01, "{lines:?}");
    }
    // In LSB the scale is that of the magnitude in motion: told, and in the interval.
    let counts = table(all.iter().map(|(t, v)| (*t, v.map(|v| (v * 417.7).round()))), "LSB");
    let found = align(&a, &counts).unwrap();
    assert_eq!(found.saturated, 0);
    assert!(found.unit_sd[0].is_none() && found.unit_sd[1].is_some_and(|sd| sd >= 0.03));
    let lines = found.axes.unwrap().map(|axis| axis.line.unwrap());
    for (line, scale) in lines.iter().zip([1.01, 0.98, 1.02]) {
        let apart = (line.scale - scale).abs();
        assert!(apart < 2.0 * line.scale_sd && line.scale_sd >= 0.029, "{line:?}");
    }
}

fn noisy(
    seed: u64,
    sd: f64,
    rate: f64,
    of: impl Fn(f64) -> (f64, [f64; 3]),
) -> Vec<(f64, [f64; 3])> {
    let mut random = Random::new(seed);
    let rows = times(rate, 0.0, 60.0).map(|t| {
        let ((time, value), noise) = (of(t), random.normals(sd));
        (time, [0, 1, 2].map(|axis| value[axis] + noise[axis]))
    });
    rows.collect()
}

#[test]
fn offset_and_rate_of_two_tables_are_within_their_intervals() {
    let mut inside = [Coverage::default(); 2];
    for seed in 1..=Lane::current().choose([6, 20, 1000]) {
        let sd = [0.02, 0.05, 0.1][seed as usize % 3];
        let (delay, ppm) = (0.37 * seed as f64, [0.0, 150.0, -80.0][seed as usize % 3]);
        let a = table(noisy(2 * seed, sd, 100.0, |t| (t, force(t))).into_iter(), "m/s²");
        let theirs = |t: f64| (delay + 30.0 + (t - 30.0) * (1.0 - ppm * 1e-6), force(t));
        let b = table(noisy(2 * seed + 1, sd, 110.0, theirs).into_iter(), "m/s²");
        let found = align(&a, &b).unwrap();
        // At the middle of what overlaps, 30 s.
        let errors = [
            (found.offset_s + delay, found.offset_sd_s),
            (found.rate_ppm.unwrap() - ppm, found.rate_sd_ppm.unwrap()),
        ];
        for (inside, (error, sd)) in inside.iter_mut().zip(errors) {
            inside.count(error.abs() <= 1.96 * sd);
            assert!(error.abs() <= 5.0 * sd, "{seed}: {error} ± {sd}");
        }
        assert!(found.offset_sd_s < 0.002, "{found:?}");
    }
    let claim = "two tables of one motion: 95 % intervals of offset and rate";
    coverage_figure(claim, &inside, 0.93..=0.97);
    // Conservative: all of them hold.
    for (inside, name) in inside.into_iter().zip(["offset", "rate"]) {
        inside.assert_can_be(0.93..=1.0, name);
    }
}

#[test]
fn devices_turned_against_each_other_show_the_turn_and_the_scale_of_their_own_axes() {
    let (scale, bias) = ([1.01, 0.99, 1.005], [0.2, -0.1, 0.05]);
    let mut inside = Coverage::default();
    let pairs = Lane::current().choose([4, 12, 400]);
    for (seed, degrees) in (1..=pairs).zip([0.0, 3.0, 5.0, 10.0].into_iter().cycle()) {
        // About the axis (2, -2, 1) / 3.
        let axis = [2.0 / 3.0, -2.0 / 3.0, 1.0 / 3.0];
        let (sin, cos) = f64::to_radians(degrees).sin_cos();
        let turned = |v: [f64; 3]| {
            let along: f64 = (0..3).map(|k| axis[k] * v[k]).sum();
            [0, 1, 2].map(|k: usize| {
                let (i, j) = ((k + 1) % 3, (k + 2) % 3);
                let across = axis[i] * v[j] - axis[j] * v[i];
                cos * v[k] + sin * across + (1.0 - cos) * along * axis[k]
            })
        };
        let theirs = |t: f64| {
            let v = turned(force(t));
            (t, [0, 1, 2].map(|k| scale[k] * v[k] + bias[k]))
        };
        let rows = |k: u64| 2 * seed + 100 + k;
        let ours = noisy(rows(0), 0.03, 100.0, |t| (t, force(t)));
        let theirs = noisy(rows(1), 0.03, 100.0, theirs);
        let [a, b] = [ours, theirs].map(|rows| table(rows.into_iter(), "m/s²"));
        let found = align(&a, &b).unwrap();
        let turn = found.turn.unwrap();
        let apart = (turn.angle_deg - degrees).abs();
        assert!(apart < 5.0 * turn.angle_sd_deg && turn.angle_sd_deg < 0.1, "{turn:?}");
        for (k, along) in axis.iter().enumerate() {
            assert!((turn.vector_deg[k] - degrees * along).abs() < 0.2, "{turn:?}");
            let line = found.axes.unwrap()[k].line.unwrap();
            for (error, sd) in [
                (line.scale - scale[k], line.scale_sd),
                (line.bias_mps2 - bias[k], line.bias_sd_mps2),
            ] {
                inside.count(error.abs() <= 1.96 * sd);
                assert!(error.abs() <= 5.0 * sd, "{degrees}°, {k}: {error} ± {sd}");
            }
        }
    }
    let claim = "devices turned by 0 to 10°: 95 % intervals of bias and scale";
    coverage_figure(claim, &[inside], 0.93..=0.97);
    inside.assert_can_be(0.9..=0.99, claim);
}

#[test]
fn tables_of_other_rates_keep_the_scale_of_a_quick_motion() {
    let quick = |t: f64| {
        let [x, y, z] = force(t);
        let fast = |hz: f64| 2.0 * (std::f64::consts::TAU * hz * t + (0.3 * t).sin()).sin();
        (t, [x + fast(6.1), y + fast(7.3), z + fast(8.9)])
    };
    let mut inside = Coverage::default();
    let pairs = Lane::current().choose([3, 12, 400]);
    for (seed, rate) in (1..=pairs).zip([130.0, 104.0, 62.5].into_iter().cycle()) {
        let ours = noisy(2 * seed + 200, 0.03, 100.0, quick);
        let theirs = noisy(2 * seed + 201, 0.03, rate, quick);
        let [a, b] = [ours, theirs].map(|rows| table(rows.into_iter(), "m/s²"));
        for line in align(&a, &b).unwrap().axes.unwrap().map(|axis| axis.line.unwrap()) {
            inside.count((line.scale - 1.0).abs() <= 1.96 * line.scale_sd);
            assert!(line.scale_sd < 0.002, "{rate} Hz: {line:?}");
        }
    }
    // The interval includes what the curve between rows may lose.
    let claim = "tables of other rates, motion up to 9 Hz: 95 % intervals of scale";
    coverage_figure(claim, &[inside], 0.93..=1.0);
    inside.assert_can_be(0.93..=1.0, claim);
}

#[test]
fn shakes_that_are_alike_by_chance_are_refused_and_the_same_one_is_not() {
    // A shake in a minute of rest, each table's own: two seconds, as even as a hand can; or four, each axis
    // faster and faster at its own pace.
    let shake = |seed: u64, from: f64, hz: f64, faster: f64| {
        move |t: f64| {
            let seconds = if faster > 0.0 { 4.0 } else { 2.0 };
            let wave = |axis: f64| {
                let hz = hz + faster * axis + 0.5 * faster * (t - from);
                let is_on = (from..from + seconds).contains(&t);
                f64::from(u8::from(is_on)) * (std::f64::consts::TAU * hz * (t - from)).sin()
            };
            let size = Random::new(1000 + seed).normals(5.0);
            let value = |axis: usize| [0.3, 0.2, 9.8][axis] + wave(axis as f64) * size[axis];
            (t, [0, 1, 2].map(value))
        }
    };
    let pairs = Lane::current().choose([4, 12, 400]);
    let [mut refused, mut aligned] = [Coverage::default(); 2];
    for seed in 1..=pairs {
        let one = noisy(3 * seed, 0.02, 100.0, shake(seed, 10.0, 4.0, 0.0));
        let other = noisy(3 * seed + 1, 0.02, 100.0, shake(seed + 100, 30.0, 4.5, 0.0));
        let varied = shake(seed, 10.0, 2.5, 0.7);
        let [first, same] = [2, 3].map(|k| noisy(5 * seed + k, 0.02, 100.0, varied));
        let [one, other, first, same] =
            [one, other, first, same].map(|rows| table(rows.into_iter(), "m/s²"));
        let error = align(&one, &other).err();
        refused.count(error.is_some_and(|error| error.code == Code::DataRefused));
        // A shake along one axis alone is refused, too.
        let found = align(&first, &same);
        aligned.count(found.is_ok());
        if let Ok(found) = found {
            let limit_s = 5.0 * found.offset_sd_s + 1e-4;
            assert!(found.offset_s.abs() < limit_s, "{found:?}");
        }
    }
    coverage_figure("shakes that are alike by chance are refused", &[refused], 0.99..=1.0);
    refused.assert_can_be(0.99..=1.0, "refused");
    let claim = "the same varied shake in two tables is aligned";
    coverage_figure(claim, &[aligned], 0.9..=1.0);
    aligned.assert_can_be(0.9..=1.0, claim);
}
