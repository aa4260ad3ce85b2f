//! Straight moves between rests: simulated robot runs, and a robot's recording.

use std::path::Path;

use wimu_host::motion::{MotionRecording, moves, rests};
use wimu_nav::slide::{Rest, Slide, SlideConfig};
use wimu_nav::unit::UnitSample;

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
            let (times, samples) = robot_run(seed, peak);
            let found = moves(&times, &samples, SlideConfig::default());
            for (_, one) in &found {
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
        println!(
            "  without the correction at the end: {:.3}",
            plain[plain.len() / 2] * 100.0
        );
    }
    robot_arm(data);
}

/// Rest, a move of 40 cm, rest, the move back, …: the unit wobbles while it moves.
fn robot_run(seed: u64, peak: f64) -> (Vec<f64>, Vec<UnitSample>) {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) + 1;
    let mut unit = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut normal = {
        let mut u = move || unit();
        move || (-2.0 * (1.0 - u()).ln()).sqrt() * (std::f64::consts::TAU * u()).cos()
    };
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

/// The truth says when the arm stops (it hardly rests between moves), the accelerometer how far it went.
fn robot_arm(data: &Path) {
    println!(
        "\n# motion/robot_arm_linear_mpu9150.csv: straight moves; the arm's own log says when they begin and end"
    );
    let file = data.join("motion/robot_arm_linear_mpu9150.csv");
    if !file.is_file() {
        println!("skipped: {} is not there", file.display());
        return;
    }
    let recording = MotionRecording::from_csv(&file).expect("the recording is readable");
    let times = &recording.times_s;
    let place = |k: usize| recording.truth[k].expect("truth everywhere").position_m;
    let apart =
        |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
    let count = times.len();
    let moving: Vec<bool> = (0..count)
        .map(|k| {
            let (a, b) = (k.saturating_sub(5), (k + 5).min(count - 1));
            apart(place(a), place(b)) > 0.01 * (times[b] - times[a])
        })
        .collect();
    let found = rests(times, &recording.samples);
    println!(
        "{:>6}{:>9}{:>12}{:>12}{:>11}{:>10}{:>10}",
        "from", "to, s", "true, m", "found, m", "error, m", "sd, m", "error/sd"
    );
    let mut spans = Vec::new();
    let mut from = None;
    for k in 1..count {
        match (moving[k - 1], moving[k], from) {
            (false, true, _) => from = Some(k),
            (true, false, Some(start)) if apart(place(start), place(k)) > 0.1 => {
                spans.push((start, k));
                from = None;
            }
            _ => {}
        }
    }
    for (index, (start, end)) in spans.iter().enumerate() {
        let truth = apart(place(*start), place(*end));
        // From the middle of the stop before to the middle of the stop after, 0.2 s at the most.
        let before = index.checked_sub(1).map_or(0.0, |i| times[spans[i].1]);
        let after = spans
            .get(index + 1)
            .map_or(times[count - 1], |s| times[s.0]);
        let begin = times[*start] - (0.5 * (times[*start] - before)).min(0.2);
        let finish = times[*end] + (0.5 * (after - times[*end])).min(0.2);
        row(&recording, &found, begin, finish, truth);
    }
}

fn row(
    recording: &MotionRecording,
    rests: &[wimu_host::motion::RestSpan],
    from: f64,
    to: f64,
    truth: f64,
) {
    let times = &recording.times_s;
    let [from, to] =
        [from, to].map(|at| times.partition_point(|t| *t < at).clamp(1, times.len() - 1));
    let nearest = |at: usize| {
        rests.iter().min_by(|a, b| {
            let gap = |r: &wimu_host::motion::RestSpan| {
                let t = times[at];
                (times[r.first] - t)
                    .max(t - times[r.end.min(times.len()) - 1])
                    .max(0.0)
            };
            gap(a).total_cmp(&gap(b))
        })
    };
    let (Some(before), Some(after)) = (nearest(from), nearest(to)) else {
        println!(
            "{:>6.2}{:>9.2}{truth:>12.3}   no rest to take gravity from",
            times[from], times[to]
        );
        return;
    };
    // Gravity from a rest some seconds away is worse known than at the ends of the move.
    let stale = |rest: Rest, near: bool| Rest {
        sd_mps2: if near { rest.sd_mps2 } else { 0.05 },
        ..rest
    };
    let close = |r: &wimu_host::motion::RestSpan, at: usize| {
        times[r.first] - times[at] < 0.3 && times[at] - times[r.end.min(times.len()) - 1] < 0.3
    };
    let mut slide = Slide::new(
        SlideConfig::default(),
        stale(before.rest, close(before, from)),
    );
    for k in from..to {
        slide.push(times[k] - times[k - 1], recording.samples[k].force_mps2);
    }
    let found = slide.finish(stale(after.rest, close(after, to)));
    let error = found.length_m - truth;
    let turned = found.turned_rad.to_degrees();
    let said = if turned > 1.0 {
        format!("  turned by {turned:.0}°: not a slide")
    } else {
        String::new()
    };
    println!(
        "{:>6.2}{:>9.2}{truth:>12.3}{:>12.3}{error:>11.3}{:>10.3}{:>10.1}{said}",
        times[from],
        times[to],
        found.length_m,
        found.length_sd_m,
        error / found.length_sd_m
    );
}
