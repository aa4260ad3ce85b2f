//! Straight moves between rests: simulated robot runs, and a robot's recording.

use std::path::Path;

use wimu_host::inertial::{Choice, Leg, Method, legs, navigate};
use wimu_host::motion::MotionRecording;
use wimu_nav::slide::SlideConfig;
use wimu_nav::unit::{UnitConfig, UnitFilter, UnitSample};
use wimu_testkit::{Random, figure};

const G: f64 = 9.80665;

pub fn bench(data: &Path) {
    println!(
        "\n# robot runs after Liu & Pang: six moves of 40 cm to and fro, 200 Hz, 50 Hz bandwidth, bias 2.5 mg, wobble 0.3°"
    );
    println!(
        "{:<22}{:>14}{:>14}{:>12}{:>10}",
        "", "median, cm", "bar, cm", "they, cm", "in 2 sd"
    );
    for (peak, they) in [(8.0, 1.08), (10.0, 1.55)] {
        let (mut errors, mut inside, mut plain) = (Vec::new(), 0, Vec::new());
        for seed in 0..200 {
            let (times_s, samples) = robot_run(seed, peak);
            let recording = MotionRecording::new("robot run", times_s, samples);
            let found = legs(&recording, SlideConfig::default());
            for one in found.iter().map(|leg| &leg.done) {
                let error = one.length_m - 0.4;
                errors.push(error.abs());
                inside += usize::from(error.abs() < 2.0 * one.length_sd_m);
                plain.push(
                    (one.displacement_m[0].abs() + 0.5 * one.left_mps[0] * one.duration_s - 0.4)
                        .abs(),
                );
            }
            assert_eq!(found.len(), 6, "each move lies between rests (seed {seed})");
        }
        errors.sort_by(f64::total_cmp);
        plain.sort_by(f64::total_cmp);
        println!(
            "up to {peak:>2} m/s²         {:>14.3}{:>14}{they:>12}{:>8.0} %",
            errors[errors.len() / 2] * 100.0,
            "0.4",
            100.0 * inside as f64 / errors.len() as f64
        );
        let median = errors[errors.len() / 2] * 100.0;
        figure(
            &format!("robot runs of 40 cm, {peak} m/s²: median error, cm (Liu & Pang {they})"),
            format!("{median:.3}"),
            "at most 0.4",
            median <= 0.4,
        );
        println!(
            "  without the correction at the end: {:.3}",
            plain[plain.len() / 2] * 100.0
        );
    }
    robot_arm(data);
}

/// Rest, a move of 40 cm, rest, the move back, …: the unit wobbles while it moves.
fn robot_run(seed: u64, peak: f64) -> (Vec<f64>, Vec<UnitSample>) {
    let mut random = Random::new(seed);
    let mut normal = move || random.normal();
    // Path of least jerk: its largest acceleration is 10/√3 d/T².
    let duration = (10.0 / 3f64.sqrt() * 0.4 / peak).sqrt();
    let fine = 2000.0;
    let mut filtered = [0.0, 0.0, G];
    let bias = [0; 3].map(|_| 2.5e-3 * G * normal().signum());
    let (mut times, mut samples) = (Vec::new(), Vec::new());
    let share = 1.0 - (-std::f64::consts::TAU * 50.0 / fine).exp();
    let mut clock = 0u64;
    let mut put = |acceleration: f64,
                   tilt: f64,
                   noise: [f64; 3],
                   times: &mut Vec<f64>,
                   samples: &mut Vec<UnitSample>| {
        let force = [
            acceleration * tilt.cos() + G * tilt.sin(),
            0.0,
            G * tilt.cos() - acceleration * tilt.sin(),
        ];
        for i in 0..3 {
            filtered[i] += share * (force[i] - filtered[i]);
        }
        clock += 1;
        if clock.is_multiple_of(10) {
            times.push(clock as f64 / fine);
            samples.push(UnitSample {
                step_s: 0.005,
                force_mps2: std::array::from_fn(|i| filtered[i] + bias[i] + 0.02 * noise[i]),
                ..UnitSample::default()
            });
        }
    };
    for run in 0..7 {
        for _ in 0..(0.8 * fine) as usize {
            let noise = [normal(), normal(), normal()];
            put(0.0, 0.0, noise, &mut times, &mut samples);
        }
        if run == 6 {
            break;
        }
        let direction = if run % 2 == 0 { 1.0 } else { -1.0 };
        let frequency = 4.0 + 2.0 * normal().clamp(-1.0, 1.0);
        let phase = normal();
        let steps = (duration * fine) as usize;
        for k in 0..steps {
            let tau = k as f64 / steps as f64;
            let curve = 60.0 * tau * (1.0 - tau) * (1.0 - 2.0 * tau);
            let acceleration = direction * 0.4 / (duration * duration) * curve;
            let window = (std::f64::consts::PI * tau).sin();
            let tilt = 0.3f64.to_radians()
                * window
                * (std::f64::consts::TAU * frequency * tau * duration + phase).sin();
            let noise = [normal(), normal(), normal()];
            put(acceleration, tilt, noise, &mut times, &mut samples);
        }
    }
    (times, samples)
}

/// Where the arm stops and where it turns a corner without stopping its own log says; what lies between
/// rests is one leg of the path, which the accelerometer and the gyroscope give.
fn robot_arm(data: &Path) {
    for name in ["robot_arm_linear_mpu9150", "robot_arm_v300_mpu9150"] {
        for gyroscope in [true, false] {
            let file = data.join(format!("motion/{name}.csv"));
            println!(
                "\n# motion/{name}.csv, {}",
                if gyroscope {
                    "with the gyroscope"
                } else {
                    "accelerometer and magnetometer"
                }
            );
            if !file.is_file() {
                println!("skipped: {} is not there", file.display());
                continue;
            }
            let mut recording =
                MotionRecording::from_csv(&file).expect("the recording is readable");
            if !gyroscope {
                for sample in &mut recording.samples {
                    sample.rate_rad_s = None;
                }
            }
            if name.contains("linear") {
                straight_moves(&recording);
                forward(&recording);
            }
            let choice = Choice {
                method: Method::Slide,
                zupt: wimu_nav::Zupt::Assumed,
                ..Choice::default()
            };
            match navigate(&recording, &choice) {
                Ok(path) => {
                    if let Some((median, below)) = path.consistency() {
                        let below = 100.0 * below;
                        println!("{:.0} % of the samples valid", 100.0 * path.valid_share());
                        let short = name.trim_end_matches("_mpu9150");
                        let with = if gyroscope {
                            "gyroscope"
                        } else {
                            "no gyroscope"
                        };
                        figure(
                            &format!("{short}, slide, {with}: NEES < 7.81, median"),
                            format!("{below:.0} %, {median:.2}"),
                            "90–98 %, 1.5–3.5",
                            (90.0..=98.0).contains(&below) && (1.5..=3.5).contains(&median),
                        );
                    }
                    for finding in &path.findings {
                        println!("  {finding}");
                    }
                }
                Err(error) => println!("the path: refused: {error}"),
            }
        }
    }
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

/// First and last sample of each straight way of the log: it moves by more than 10 mm/s and not by more than 15°
/// from the direction at its start.
fn straight(recording: &MotionRecording) -> Vec<(usize, usize)> {
    let times = &recording.times_s;
    let place = |k: usize| recording.truth[k].expect("truth everywhere").position_m;
    let count = times.len();
    let velocity = |k: usize| -> [f64; 3] {
        let a = times.partition_point(|t| *t < times[k] - 0.1);
        let b = times
            .partition_point(|t| *t < times[k] + 0.1)
            .min(count - 1);
        let dt = (times[b] - times[a]).max(1e-3);
        std::array::from_fn(|i| (place(b)[i] - place(a)[i]) / dt)
    };
    let size = |v: [f64; 3]| v.iter().map(|c| c * c).sum::<f64>().sqrt();
    let mut found = Vec::new();
    let mut from: Option<(usize, [f64; 3])> = None;
    for k in 0..count {
        let now = velocity(k);
        let moving = size(now) > 0.01;
        let goes_on = from.is_some_and(|(_, start)| {
            let dot: f64 = (0..3).map(|i| start[i] * now[i]).sum();
            moving && dot > 0.966 * size(start) * size(now)
        });
        if let Some((start, _)) = from.filter(|_| !goes_on) {
            if apart(place(start), place(k)) > 0.1 {
                found.push((start, k));
            }
            from = None;
        }
        if from.is_none() && moving {
            from = Some((k, now));
        }
    }
    found
}

/// The length of each straight way from the samples up to its end alone: the one-unit filter, zero velocity at
/// what looks like a rest.
fn forward(recording: &MotionRecording) {
    println!("from the samples up to each way's end alone:");
    for (from, to) in straight(recording) {
        let mut filter = UnitFilter::new(UnitConfig {
            gravity_mps2: recording.gravity_mps2(),
            ..UnitConfig::default()
        });
        for (k, sample) in recording.samples.iter().enumerate().take(to + 1) {
            let _ = filter.push(sample);
            if k == from {
                filter.set_origin();
            }
        }
        let state = filter.state();
        let truth = |k: usize| recording.truth[k].expect("truth everywhere").position_m;
        let found = state.position_m.iter().map(|p| p * p).sum::<f64>().sqrt();
        let (sd, true_m) = (state.position_sd_m(), apart(truth(from), truth(to)));
        println!(
            "{:>6.2}{:>9.2}{true_m:>12.3}{found:>12.3}{:>11.3}{sd:>10.3}{:>10.1}{}",
            recording.times_s[from],
            recording.times_s[to],
            found - true_m,
            (found - true_m) / sd,
            if state.valid {
                ""
            } else {
                "   said to be invalid"
            }
        );
    }
}

fn straight_moves(recording: &MotionRecording) {
    let times = &recording.times_s;
    let place = |k: usize| recording.truth[k].expect("truth everywhere").position_m;
    let config = SlideConfig {
        gravity_mps2: recording.gravity_mps2(),
        ..SlideConfig::default()
    };
    let found = legs(recording, config);
    for leg in &found {
        println!(
            "between the rests at {:.2} and {:.2} s: {:.3} ± {:.3} m, truth {:.3}; turned by {:.0}°, {:.1}° of it open; velocity left {:.3} m/s (1 σ {:.3})",
            times[leg.before.end - 1],
            times[leg.after.first],
            leg.done.length_m,
            leg.done.length_sd_m,
            apart(place(leg.before.end - 1), place(leg.after.first)),
            leg.done.turned_rad.to_degrees(),
            leg.done.open_rad.to_degrees(),
            leg.done.left_mps.iter().map(|v| v * v).sum::<f64>().sqrt(),
            leg.done.left_sd_mps,
        );
    }
    println!(
        "{:>6}{:>9}{:>12}{:>12}{:>11}{:>10}{:>10}",
        "from", "to, s", "true, m", "found, m", "error, m", "sd, m", "error/sd"
    );
    // How much of a way lies in a leg, in samples.
    let shared = |leg: &Leg, from: usize, to: usize| {
        (to.min(leg.after.first)).saturating_sub(from.max(leg.before.end))
    };
    let mut worst = 0.0_f64;
    for (from, to) in straight(recording) {
        let truth = apart(place(from), place(to));
        let leg = found
            .iter()
            .max_by_key(|leg| shared(leg, from, to))
            .filter(|leg| 2 * shared(leg, from, to) > to - from);
        let Some(leg) = leg else {
            println!(
                "{:>6.2}{:>9.2}{truth:>12.3}   no rest that agrees on both sides",
                times[from], times[to]
            );
            continue;
        };
        let Some((way, p)) = leg.way(from, to) else {
            continue;
        };
        let length = way.iter().map(|w| w * w).sum::<f64>().sqrt();
        let along = way.map(|w| w / length.max(1e-9));
        let variance: f64 = (0..3)
            .flat_map(|i| (0..3).map(move |j| (i, j)))
            .map(|(i, j)| along[i] * p[i][j] * along[j])
            .sum();
        let sd = variance.max(0.0).sqrt();
        let error = length - truth;
        worst = worst.max(error.abs() / sd);
        println!(
            "{:>6.2}{:>9.2}{truth:>12.3}{length:>12.3}{error:>11.3}{sd:>10.3}{:>10.1}",
            times[from],
            times[to],
            error / sd
        );
    }
    let with = match recording.samples.iter().any(|s| s.rate_rad_s.is_some()) {
        true => "gyroscope",
        false => "no gyroscope",
    };
    figure(
        &format!("robot_arm_linear, slide, {with}: largest error of a straight move"),
        format!("{worst:.1} σ"),
        "at most 2 σ",
        worst <= 2.0,
    );
}
