//! Boards with clocks and axes of their own that make one array.

use crate::common;

use std::f64::consts::TAU;

use common::{Random, cross};
use wimu_calib::Gravity;
use wimu_host::array::{
    Array, ArrayBody, ArrayCalibration, ArrayGeometry, ArraySensor, ArrayUnit, RefineOptions,
    refine,
};
use wimu_host::inertial::Zupt;
use wimu_host::series::{Ns, Series};
use wimu_testkit::figure;

const G: f64 = 9.80665;

/// Rests in twelve orientations of 1.5 s, then 12 s of violent turning by hand.
const POSES: usize = 12;
const POSE_S: f64 = 1.5;
const MOVING_S: f64 = 12.0;

/// Direction of gravity's reaction at a rest, and at a time while moving some force.
fn force(t: f64) -> [f64; 3] {
    let pose = (t / POSE_S) as usize;
    if pose < POSES {
        // Spread over a sphere; each pose is reached within 0.6 s.
        let at = |pose: usize| {
            let z = 1.0 - 2.0 * (pose as f64 + 0.5) / POSES as f64;
            let (s, c) = (2.4 * pose as f64).sin_cos();
            let r = (1.0 - z * z).sqrt();
            [r * c * G, r * s * G, z * G]
        };
        let share = ((t / POSE_S - pose as f64) * POSE_S / 0.6).min(1.0);
        let before = at(pose.saturating_sub(1));
        let v: [f64; 3] = std::array::from_fn(|i| before[i] + share * (at(pose)[i] - before[i]));
        let norm = v.iter().map(|c| c * c).sum::<f64>().sqrt();
        return v.map(|c| c * G / norm.max(1e-9));
    }
    let m = t - POSES as f64 * POSE_S;
    [
        15.0 * (TAU * 1.3 * m).sin(),
        12.0 * (TAU * 1.7 * m + 1.0).sin(),
        G + 14.0 * (TAU * 1.1 * m + 2.0).sin(),
    ]
}

/// ω and ω̇: none while it rests.
fn turning(t: f64) -> ([f64; 3], [f64; 3]) {
    let m = t - POSES as f64 * POSE_S;
    if m <= 0.0 {
        return ([0.0; 3], [0.0; 3]);
    }
    let tones = [[11.0, 1.9, 0.0], [9.0, 2.3, 0.0], [10.0, 1.4, 0.0]];
    let begun = (m / 0.5).min(1.0);
    let begins = if m < 0.5 { 2.0 } else { 0.0 };
    let value = |[a, f, p]: [f64; 3]| a * (TAU * f * m + p).sin();
    let slope = |[a, f, p]: [f64; 3]| a * TAU * f * (TAU * f * m + p).cos();
    (
        tones.map(|tone| begun * value(tone)),
        tones.map(|tone| begun * slope(tone) + begins * value(tone)),
    )
}

/// What a sensor puts out at a time, in its own axes.
fn output(sensor: &ArraySensor, t: f64) -> [f64; 3] {
    let (rate, turn) = turning(t);
    let s = force(t);
    let body: [[f64; 3]; 3] = sensor.places_m.map(|place| {
        let (a, b) = (cross(turn, place), cross(rate, cross(rate, place)));
        std::array::from_fn(|i| s[i] + a[i] + b[i])
    });
    std::array::from_fn(|axis| (0..3).map(|i| sensor.axes[axis][i] * body[axis][i]).sum())
}

fn duration() -> f64 {
    POSES as f64 * POSE_S + MOVING_S
}

fn rms_error(states: &[[f64; 3]], times: &[f64]) -> f64 {
    let (mut squares, mut count) = (0.0, 0.0);
    for (rate, t) in states.iter().zip(times) {
        if *t > POSES as f64 * POSE_S + 1.0 {
            let (truth, _) = turning(*t);
            squares += (0..3).map(|i| (rate[i] - truth[i]).powi(2)).sum::<f64>();
            count += 3.0;
        }
    }
    f64::sqrt(squares / count)
}

#[test]
fn boards_with_clocks_and_axes_of_their_own_make_one_array() {
    let mut random = Random::new(11);
    // Four boards on a body of 20 cm, each turned its own way.
    let places = [[0.1, 0.1, 0.1], [0.1, -0.1, -0.1], [-0.1, 0.1, -0.1], [-0.1, -0.1, 0.1]];
    let turned = [
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]],
    ];
    let mut geometry = ArrayGeometry::at(&places);
    for (sensor, axes) in geometry.sensors.iter_mut().zip(turned) {
        sensor.axes = axes;
    }
    let clock_error_us = [0.0, 300.0, -200.0, 150.0];
    let boards: Vec<ArrayUnit> = geometry
        .sensors
        .iter()
        .enumerate()
        .map(|(k, sensor)| {
            // Rates that differ by a thousandth, starts that differ by a tenth of a second.
            let rate_hz = 200.0 * (1.0 + 1e-3 * k as f64);
            let start = 0.037 * k as f64;
            let times_s: Vec<f64> = (0..((duration() - start) * rate_hz) as usize)
                .map(|n| n as f64 / rate_hz)
                .collect();
            let silent = ((POSES as f64 * POSE_S + 4.0 - start) * rate_hz) as usize;
            let lost = |n: usize| k == 1 && (silent..silent + 40).contains(&n);
            let kept: Vec<usize> = (0..times_s.len()).filter(|n| !lost(*n)).collect();
            ArrayUnit {
                name: format!("board {k}"),
                force: Series::of(kept.into_iter().map(|n| {
                    let value = output(sensor, start + times_s[n]);
                    let noisy = value.map(|v| v + 0.02 * random.normal());
                    (
                        Ns(1_000_000_000).after_s(start + clock_error_us[k] * 1e-6 + times_s[n]),
                        noisy.into(),
                    )
                })),
                clock_sd_s: Some(300e-6),
                without_unit: 0,
                sensitivity_lsb_per_g: None,
            }
        })
        .collect();
    let together = Array::of(boards.clone()).unwrap();
    assert!(together.remarks.iter().any(|r| r.contains("clock known to 300 µs")));
    assert!(together.remarks.iter().any(|r| r.contains("values missing")));
    let origin =
        together.times()[0].since_s(Ns(1_000_000_000)) - 0.037 * 3.0 - clock_error_us[3] * 1e-6;
    assert!(origin.abs() < 0.02, "the grid begins when all are there: {origin}");
    let arranged = together.clone().arranged(&geometry).unwrap();
    let calibration = ArrayCalibration::of(&arranged, &geometry, Gravity::UNKNOWN_PLACE).unwrap();
    let options = RefineOptions { place_sd_m: 1e-3, delay_sd_s: 1e-3 };
    let found = refine(&arranged, &geometry, &calibration, &options).unwrap();
    println!("gain {:.2}, residual {:?}", found.gain, found.residual_mps2);
    let mean = clock_error_us.iter().sum::<f64>() / 4.0;
    for (k, error_us) in clock_error_us.iter().enumerate() {
        // A clock that is ahead stamps later: its samples are older than they say.
        let off = found.delay_s[k] * 1e6 + (error_us - mean);
        println!("board {k}: delay off by {off:.2} ± {:.2} µs", found.delay_sd_s[k] * 1e6);
        assert!(off.abs() < 4.0 * found.delay_sd_s[k] * 1e6 + 2.0);
    }
    let rates = |geometry: &ArrayGeometry| {
        let arranged = together.clone().arranged(geometry).unwrap();
        let calibration =
            ArrayCalibration::of(&arranged, geometry, Gravity::UNKNOWN_PLACE).unwrap();
        let (states, remarks) = ArrayBody::of(&arranged, geometry, &calibration)
            .and_then(|body| body.navigated(G, Zupt::Stated))
            .unwrap();
        let times = arranged.times().iter();
        let times_s: Vec<f64> = times.map(|t| t.since_s(Ns(1_000_000_000))).collect();
        let rates: Vec<[f64; 3]> = states.iter().map(|s| s.rate_rad_s).collect();
        (rms_error(&rates, &times_s), remarks)
    };
    println!("{:?}", together.remarks);
    let ((before, remarks), (after, _)) = (rates(&geometry), rates(&found.geometry));
    figure(
        "four boards on a body: rate, with delays found, rad/s rms",
        format!("{before:.3} / {after:.3}"),
        "below 0.3",
        after < 0.3,
    );
    assert!(after < 0.3 && after < before, "{before} {after}");
    // While board 1 was silent there were three, which lie in a plane and still give ω̇ and s.
    assert!(
        remarks.iter().any(|r| r.contains("did not give") && r.contains("of sensor 1")),
        "{remarks:?}"
    );

    let mut late = boards[1].clone();
    late.force = late.force.retimed(|time| time.after_s(3600.0));
    let error = Array::of(vec![boards[0].clone(), late]).unwrap_err();
    assert!(error.to_string().contains("no time in common"), "{error}");
    let error = Array::of(boards[..1].to_vec()).unwrap_err();
    assert!(error.to_string().contains("2 to 32 accelerometers, and there are 1"), "{error}");
}
