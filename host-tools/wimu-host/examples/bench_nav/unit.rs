//! One unit carried about, against the plain baseline in the same run.

use std::path::Path;
use std::time::Instant;

use wimu_host::motion::{MotionRecording, Truth};
use wimu_nav::unit::{UnitConfig, UnitFilter, UnitSample};
use wimu_testkit::figure;

use crate::low_pass::LowPass;

const HORIZONS_S: [f64; 3] = [1.0, 2.0, 5.0];

pub fn bench(data: &Path) {
    println!("\n# motion/broad_slow_translation_A.csv: one unit against optical truth");
    let file = data.join("motion/broad_slow_translation_A.csv");
    if !file.is_file() {
        println!("skipped: {} is not there", file.display());
        return;
    }
    let recording = MotionRecording::from_csv(&file).expect("the recording is readable");
    let gravity = recording.gravity_mps2();
    let shown = recording.first_rest_mps2().unwrap_or(gravity);
    println!(
        "gravity: {gravity:.4} m/s²; what the first rest shows, for the baseline: {shown:.4} m/s²"
    );
    let starts = starts(&recording);
    println!(
        "{} windows in which the next 2 s move; median 3-D error, m, after 1 / 2 / 5 s",
        starts.len()
    );
    let plain = baseline(&recording, shown, &starts, [0.0; 3]);
    let table = |name: &str, errors: &Errors, bar: Option<f64>| {
        let m = errors.medians();
        let ratios: Vec<String> = m
            .iter()
            .zip(plain.medians())
            .map(|(a, b)| format!("{:.2}", a / b))
            .collect();
        let bar = bar.map_or(String::new(), |b| format!("  (bar {b})"));
        println!(
            "{name:<34}{:>8.3}{:>8.3}{:>8.3}   ratio {}{bar}",
            m[0],
            m[1],
            m[2],
            ratios.join(" / ")
        );
        m.iter()
            .zip(plain.medians())
            .map(|(a, b)| a / b)
            .collect::<Vec<f64>>()
    };
    table("baseline, τ = 1 s", &plain, None);
    for (name, short, gyroscope, bar) in [
        ("accelerometer + magnetometer", "no gyroscope", false, 0.8),
        ("with the gyroscope", "gyroscope", true, 0.3),
    ] {
        let still = filtered(&recording, gravity, &starts, [0.0; 3], gyroscope);
        let moved = filtered(&recording, gravity, &starts, [3.0, 0.0, 0.0], gyroscope);
        let ratios = table(name, &still, Some(bar));
        let joined = |values: &[f64], digits: usize| {
            let all: Vec<String> = values.iter().map(|v| format!("{v:.digits$}")).collect();
            all.join(" / ")
        };
        figure(
            &format!("BROAD slow A, {short}: median error over low-pass, 1 / 2 / 5 s"),
            joined(&ratios, 2),
            &format!("at most {bar}"),
            ratios.iter().all(|ratio| *ratio <= bar),
        );
        let apart = still.greatest_difference(&moved);
        if gyroscope {
            figure(
                "BROAD slow A: change of errors where 3 m/s is added, m",
                format!("{apart:.0e}"),
                "below 1e-9",
                apart < 1e-9,
            );
        }
        let (mut shares, mut medians) = (Vec::new(), Vec::new());
        for (h, horizon) in HORIZONS_S.iter().enumerate() {
            let mut nees: Vec<f64> = still.nees.iter().map(|n| n[h]).collect();
            nees.sort_by(f64::total_cmp);
            let below = nees.iter().filter(|n| **n < 7.81).count();
            let below = 100.0 * below as f64 / nees.len() as f64;
            let median = nees[nees.len() / 2];
            println!(
                "  position NEES after {horizon} s: below 7.81 in {below:.0} %, median {median:.2}"
            );
            shares.push(below);
            medians.push(median);
        }
        figure(
            &format!("BROAD slow A, {short}: NEES < 7.81 after 1 / 2 / 5 s"),
            joined(&shares, 0) + " %",
            "90–98 %",
            shares.iter().all(|share| (90.0..=98.0).contains(share)),
        );
        figure(
            &format!("BROAD slow A, {short}: median NEES after 1 / 2 / 5 s"),
            joined(&medians, 2),
            "1.5–3.5",
            medians.iter().all(|median| (1.5..=3.5).contains(median)),
        );
    }
    speed(&recording, gravity);
}

#[derive(Default)]
struct Errors {
    distance: Vec<[f64; 3]>,
    nees: Vec<[f64; 3]>,
}

impl Errors {
    fn medians(&self) -> [f64; 3] {
        std::array::from_fn(|h| {
            let mut all: Vec<f64> = self.distance.iter().map(|d| d[h]).collect();
            all.sort_by(f64::total_cmp);
            all[all.len() / 2]
        })
    }

    fn greatest_difference(&self, other: &Self) -> f64 {
        let pairs = self
            .distance
            .iter()
            .flatten()
            .zip(other.distance.iter().flatten());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }
}

/// Every second in which the next 2 s move, and 5 s of truth follow.
fn starts(recording: &MotionRecording) -> Vec<usize> {
    let times = &recording.times_s;
    let moving = recording
        .column("Moving")
        .expect("the recording says when it moves");
    let last = times[times.len() - 1];
    let mut found = Vec::new();
    let mut second = times[0].ceil();
    while second + 5.1 < last {
        let from = times.partition_point(|t| *t < second);
        let to = times.partition_point(|t| *t < second + 2.0);
        let known = |k: usize| recording.truth[k].is_some();
        let all = moving[from..to].iter().all(|m| *m > 0.5);
        let ends = HORIZONS_S.map(|h| times.partition_point(|t| *t < second + h));
        if all
            && known(from)
            && from > 0
            && known(from - 1)
            && known(from + 1)
            && ends.iter().all(|k| known(*k))
        {
            found.push(from);
        }
        second += 1.0;
    }
    found
}

/// Position, velocity and heading of the truth, moved by a constant velocity.
fn start(recording: &MotionRecording, at: usize, added: [f64; 3]) -> ([f64; 3], [f64; 3], f64) {
    let truth = |k: usize| recording.truth[k].expect("starts have truth");
    let (before, now, after) = (truth(at - 1), truth(at), truth(at + 1));
    let dt = recording.times_s[at + 1] - recording.times_s[at - 1];
    let velocity =
        std::array::from_fn(|i| (after.position_m[i] - before.position_m[i]) / dt + added[i]);
    (now.position_m, velocity, now.heading_rad())
}

fn moved(truth: Truth, added: [f64; 3], seconds: f64) -> [f64; 3] {
    std::array::from_fn(|i| truth.position_m[i] + added[i] * seconds)
}

fn sample(recording: &MotionRecording, k: usize, gyroscope: bool) -> UnitSample {
    let mut sample = recording.samples[k];
    if !gyroscope {
        sample.rate_rad_s = None;
    }
    sample
}

fn filtered(
    recording: &MotionRecording,
    gravity: f64,
    starts: &[usize],
    added: [f64; 3],
    gyroscope: bool,
) -> Errors {
    // No zero velocity: it would be a prior on speed.
    let mut filter = UnitFilter::new(UnitConfig {
        gravity_mps2: gravity,
        zupt: wimu_nav::Zupt::Off,
        ..UnitConfig::default()
    });
    let mut errors = Errors::default();
    let mut next = starts.iter().peekable();
    for k in 0..recording.samples.len() {
        let _ = filter.push(&sample(recording, k, gyroscope));
        if next.next_if(|s| **s == k).is_none() {
            continue;
        }
        let mut window = filter.clone();
        let (position, velocity, heading) = start(recording, k, added);
        window.set_start(position, velocity, heading);
        let mut distance = [0.0; 3];
        let mut nees = [0.0; 3];
        let mut at = k;
        for (h, horizon) in HORIZONS_S.iter().enumerate() {
            let end = recording
                .times_s
                .partition_point(|t| *t < recording.times_s[k] + horizon);
            while at < end {
                at += 1;
                let _ = window.push(&sample(recording, at, gyroscope));
            }
            let state = window.state();
            let seconds = recording.times_s[at] - recording.times_s[k];
            let truth = moved(
                recording.truth[at].expect("ends have truth"),
                added,
                seconds,
            );
            let error: [f64; 3] = std::array::from_fn(|i| state.position_m[i] - truth[i]);
            distance[h] = error.iter().map(|e| e * e).sum::<f64>().sqrt();
            nees[h] = wimu_host::motion::nees(error, state.position_covariance);
        }
        errors.distance.push(distance);
        errors.nees.push(nees);
    }
    errors
}

/// Low-passed accelerometer and magnetometer give the attitude, the trapezoid the rest.
fn baseline(
    recording: &MotionRecording,
    gravity: f64,
    starts: &[usize],
    added: [f64; 3],
) -> Errors {
    let low_pass = LowPass::of(recording, gravity);
    let mut errors = Errors::default();
    for k in starts {
        let (p, v, heading) = start(recording, *k, added);
        let (mut state, yaw) = ((p, v), heading - low_pass.headings[*k]);
        let mut at = *k;
        let mut distance = [0.0; 3];
        for (h, horizon) in HORIZONS_S.iter().enumerate() {
            let end = recording
                .times_s
                .partition_point(|t| *t < recording.times_s[*k] + horizon);
            state = low_pass.integrate(&recording.times_s, at, end, yaw, state);
            at = end;
            let seconds = recording.times_s[at] - recording.times_s[*k];
            let truth = moved(
                recording.truth[at].expect("ends have truth"),
                added,
                seconds,
            );
            distance[h] = (0..3)
                .map(|i| (state.0[i] - truth[i]).powi(2))
                .sum::<f64>()
                .sqrt();
        }
        errors.distance.push(distance);
        errors.nees.push([0.0; 3]);
    }
    errors
}

fn speed(recording: &MotionRecording, gravity: f64) {
    let mut slowest = f64::INFINITY;
    for gyroscope in [false, true] {
        let samples: Vec<UnitSample> = (0..recording.samples.len())
            .map(|k| sample(recording, k, gyroscope))
            .collect();
        let start = Instant::now();
        let mut count = 0;
        let mut sum = 0.0;
        for _ in 0..20 {
            let config = UnitConfig {
                gravity_mps2: gravity,
                ..UnitConfig::default()
            };
            let mut filter = UnitFilter::new(config);
            for sample in &samples {
                let _ = filter.push(sample);
                count += 1;
            }
            sum += filter.state().position_m[0];
        }
        let rate = f64::from(count) / start.elapsed().as_secs_f64();
        println!(
            "the filter{}: {:.2} million samples a second (bar 1) at 143 Hz{}",
            if gyroscope { " with gyroscope" } else { "" },
            rate * 1e-6,
            if sum.is_nan() { "!" } else { "" }
        );
        slowest = slowest.min(rate * 1e-6);
    }
    figure(
        "one-unit filter on a host core, million samples a second",
        format!("{slowest:.2}"),
        "at least 1",
        slowest >= 1.0,
    );
}
