//! What a slide between rests claims, how long a path can be used, and what a gyroscope may lack.

use wimu_host::ErrorCode;
use wimu_host::inertial::{Choice, InertialPath, Method, navigate};
use wimu_host::motion::{MotionRecording, Truth};
use wimu_nav::unit::UnitSample;
use wimu_testkit::{Coverage, Lane, Random, coverage_figure};

const G: f64 = 9.80665;

/// Noise of mean 0 and standard deviation 1.
fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut random = Random::new(seed);
    move || random.normal()
}

/// What a recording is of: rests of 1.5 s between moves along x, with least jerk.
#[derive(Clone, Copy)]
struct Run {
    first_rest_s: f64,
    move_s: f64,
    way_m: f64,
    moves: usize,
    gyroscope: bool,
    /// Direction of the magnetic north in the body, rad from x to y.
    north: Option<f64>,
    /// From the first move's end on the unit is tilted by this, rad.
    tilt: f64,
    seed: u64,
}

const RUN: Run = Run {
    first_rest_s: 2.0,
    move_s: 1.0,
    way_m: 0.4,
    moves: 3,
    gyroscope: false,
    north: None,
    tilt: 0.0,
    seed: 1,
};

impl Run {
    fn recording(self) -> MotionRecording {
        let mut noise = noise(self.seed);
        let bias = [0; 3].map(|_| 0.025 * noise());
        let rate_hz = 200.0;
        let whole = self.first_rest_s + self.moves as f64 * (self.move_s + 1.5);
        let (mut times, mut samples, mut truth) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..(whole * rate_hz) as usize {
            let t = k as f64 / rate_hz;
            let (mut way, mut push, mut tilt) = (0.0, 0.0, 0.0);
            for m in 0..self.moves {
                let start = self.first_rest_s + m as f64 * (self.move_s + 1.5);
                let tau = ((t - start) / self.move_s).clamp(0.0, 1.0);
                let signed = if m % 2 == 0 { self.way_m } else { -self.way_m };
                let curve = tau.powi(3) * (10.0 - 15.0 * tau + 6.0 * tau * tau);
                way += signed * curve;
                push += signed * 60.0 * tau * (1.0 - tau) * (1.0 - 2.0 * tau) / self.move_s.powi(2);
                if m == 0 {
                    tilt = self.tilt * curve;
                }
            }
            let (sin, cos) = tilt.sin_cos();
            let force = [push * cos - G * sin, 0.0, G * cos + push * sin];
            times.push(t);
            samples.push(UnitSample {
                step_s: if k == 0 { 0.0 } else { 1.0 / rate_hz },
                force_mps2: std::array::from_fn(|i| force[i] + bias[i] + 0.02 * noise()),
                field_ut: self
                    .north
                    .map(|by| [20.0 * by.cos(), 20.0 * by.sin(), -44.0]),
                rate_rad_s: self
                    .gyroscope
                    .then(|| std::array::from_fn(|i| 0.01 * i as f64 + 0.002 * noise())),
            });
            truth.push(Some(Truth {
                position_m: [way, 0.0, 0.0],
                quaternion: [1.0, 0.0, 0.0, 0.0],
            }));
        }
        let mut recording = MotionRecording::new("run", times, samples);
        recording.truth = truth;
        recording
    }
}

fn slide(recording: &MotionRecording) -> InertialPath {
    let choice = Choice {
        method: Method::Slide,
        ..Choice::default()
    };
    navigate(recording, &choice).unwrap()
}

#[test]
fn soft_and_slow_moves_are_found_whole() {
    let seeds = Lane::current().choose([2, 5, 100]);
    let (mut found, mut within) = (Coverage::default(), Coverage::default());
    for (move_s, way_m) in [
        (1.6, 0.4),
        (2.0, 0.4),
        (3.0, 0.4),
        (4.0, 0.4),
        (3.0, 1.0),
        (1.0, 0.05),
    ] {
        for seed in 1..=seeds {
            for gyroscope in [false, true] {
                let run = Run {
                    move_s,
                    way_m,
                    gyroscope,
                    seed,
                    ..RUN
                };
                let path = slide(&run.recording());
                let lengths: Vec<(f64, f64)> = path
                    .moves
                    .iter()
                    .map(|m| (m.done.length_m, m.done.length_sd_m))
                    .collect();
                let case = format!("{way_m} m in {move_s} s, seed {seed}: {lengths:?}");
                let is_whole = lengths.len() == 3 && path.moves.iter().all(|m| m.valid);
                if !is_whole {
                    println!("{case}");
                }
                found.count(is_whole);
                for (length, sd) in lengths.into_iter().filter(|_| is_whole) {
                    within.count((length - way_m).abs() < 1.96 * sd);
                    assert!((length - way_m).abs() < 5.0 * sd && sd < 0.1, "{case}");
                }
            }
        }
    }
    coverage_figure(
        "slides of 0.05 to 1 m in 1 to 4 s are found whole",
        &[found],
        0.99..=1.0,
    );
    coverage_figure("95 % intervals of their lengths", &[within], 0.93..=0.97);
    found.assert_can_be(0.99..=1.0, "found whole");
    within.assert_can_be(0.93..=1.0, "lengths");
}

#[test]
fn a_slide_over_a_gap_or_a_jump_of_time_is_not_known() {
    let whole = RUN.recording();
    let end = slide(&whole);
    assert!(end.moves.iter().all(|m| m.valid) && end.horizon(1.0).is_none());
    assert!(end.points.iter().all(|p| p.valid));
    // In the second move.
    let from = whole.times_s.partition_point(|t| *t < 4.7);
    for (left_out, jump_s) in [(100, 0.0), (0, 3600.0)] {
        let mut recording = whole.clone();
        for k in from..recording.times_s.len() {
            recording.times_s[k] += jump_s;
        }
        recording.times_s.drain(from..from + left_out);
        recording.samples.drain(from..from + left_out);
        recording.truth.drain(from..from + left_out);
        let path = slide(&recording);
        let valid: Vec<bool> = path.moves.iter().map(|m| m.valid).collect();
        assert_eq!(valid, [true, false, false]);
        assert!(path.points[from + 1..].iter().all(|p| !p.valid));
        assert!(
            path.findings.iter().any(|f| f.evidence.contains("gap")),
            "{:?}",
            path.findings
        );
        let horizon = path.horizon(0.5).unwrap();
        assert!(horizon.lost && horizon.at_s < 4.8 && (1.0..2.0).contains(&horizon.moving_s));
        // The unit may have gone on for so long.
        assert!(path.points.last().unwrap().sd_m() > 0.5 + jump_s);
    }
}

#[test]
fn a_move_that_turns_the_unit_ends_the_horizon() {
    let run = Run { tilt: 0.05, ..RUN };
    let recording = run.recording();
    let choice = Choice {
        method: Method::Slide,
        ..Choice::default()
    };
    // The rests after the turn agree among each other: the path may begin there, or end before.
    let path = navigate(&recording, &choice).unwrap();
    let turned = |m: &wimu_host::inertial::SlideMove| m.from_s < 2.5;
    assert!(path.moves.iter().filter(|m| turned(m)).all(|m| !m.valid));
    let first = recording.times_s.partition_point(|t| *t < 2.5);
    let after = recording.times_s.partition_point(|t| *t < 3.0);
    assert!(path.points[first..after].iter().all(|p| !p.valid));
    assert!(
        path.findings.iter().any(|f| f.evidence.contains("turned")),
        "{:?}",
        path.findings
    );
}

#[test]
fn zero_velocity_cannot_be_switched_off_for_a_slide() {
    let choice = Choice {
        method: Method::Slide,
        zupt: wimu_nav::Zupt::Off,
        ..Choice::default()
    };
    let refused = navigate(&RUN.recording(), &choice).unwrap_err();
    assert_eq!(refused.code(), ErrorCode::Usage);
}

#[test]
fn a_slides_east_is_that_of_the_magnetic_field() {
    let end = |north| {
        let path = slide(
            &Run {
                north,
                moves: 1,
                ..RUN
            }
            .recording(),
        );
        let said = path
            .findings
            .iter()
            .any(|f| f.evidence.contains("no magnetometer"));
        let point = path.points.iter().rfind(|p| p.valid).unwrap();
        (point.position_m, said)
    };
    // Body x is north: the way of 0.4 m along it, too.
    let ([e, n, _], said) = end(Some(0.0));
    assert!(e.abs() < 0.02 && (n - 0.4).abs() < 0.02 && !said, "{e} {n}");
    let ([e, n, _], said) = end(Some(std::f64::consts::FRAC_PI_2));
    assert!((e - 0.4).abs() < 0.02 && n.abs() < 0.02 && !said, "{e} {n}");
    let ([e, n, _], said) = end(None);
    assert!((e - 0.4).abs() < 0.02 && n.abs() < 0.02 && said, "{e} {n}");
}

#[test]
fn when_the_clock_began_changes_nothing() {
    let recording = RUN.recording();
    let end = |by: f64| {
        let mut moved = recording.clone();
        for time in &mut moved.times_s {
            *time += by;
        }
        slide(&moved)
            .points
            .iter()
            .rfind(|p| p.valid)
            .unwrap()
            .position_m
    };
    let at = end(0.0);
    for by in [-5.0, 0.3, 1e5, 1.7e9] {
        let apart = end(by)
            .iter()
            .zip(at)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        assert!(apart < 1e-4, "{by} s: {apart} m");
    }
}

#[test]
fn standing_still_makes_no_horizon_longer() {
    let horizon = |first_rest_s| {
        let choice = Choice {
            limit_m: 0.5,
            zupt: wimu_nav::Zupt::Stated,
            ..Choice::default()
        };
        let run = Run {
            first_rest_s,
            move_s: 3.0,
            way_m: 1.0,
            moves: 1,
            north: Some(0.0),
            ..RUN
        };
        let path = navigate(&run.recording(), &choice).unwrap();
        path.horizon(0.02)
            .expect("a tilt that is not known moves it by 2 cm")
    };
    let (short, long) = (horizon(3.0), horizon(13.0));
    assert!(
        (long.at_s - short.at_s - 10.0).abs() < 1.0,
        "{short:?} {long:?}"
    );
    assert!(
        (long.moving_s - short.moving_s).abs() < 1.0,
        "{short:?} {long:?}"
    );
    assert!(short.since_rest_s.is_some_and(|s| s < 3.0) && !short.lost);
}

#[test]
fn a_truth_without_a_heading_is_turned_to_fit() {
    let mut recording = RUN.recording();
    for truth in recording.truth.iter_mut().flatten() {
        let [e, n, u] = truth.position_m;
        *truth = Truth {
            position_m: [-n, e, u],
            quaternion: [f64::NAN; 4],
        };
    }
    let path = slide(&recording);
    let (_, below) = path.consistency().unwrap();
    assert!(path.heading_fitted && below > 0.9, "{below}");
    assert!(!slide(&RUN.recording()).heading_fitted);
}

/// Turned about y by 0.3 rad and back, twice, with rests between.
fn turned(scale: f64, signs: [f64; 3]) -> MotionRecording {
    let mut noise = noise(7);
    let (mut times, mut samples) = (Vec::new(), Vec::new());
    for k in 0..1000 {
        let t = f64::from(k) * 0.01;
        let (mut angle, mut rate) = (0.0, 0.0);
        for m in 0..4 {
            let tau = (t - 2.0 - 2.0 * f64::from(m)).clamp(0.0, 1.0);
            let sign = if m % 2 == 0 { 0.3 } else { -0.3 };
            angle += sign * tau.powi(3) * (10.0 - 15.0 * tau + 6.0 * tau * tau);
            rate += sign * 30.0 * (tau * (1.0 - tau)).powi(2);
        }
        times.push(t);
        let force = [-G * f64::sin(angle), 0.0, G * f64::cos(angle)];
        let rates = [0.0, rate, 0.0];
        samples.push(UnitSample {
            step_s: if k == 0 { 0.0 } else { 0.01 },
            force_mps2: std::array::from_fn(|i| force[i] + 0.02 * noise()),
            rate_rad_s: Some(std::array::from_fn(|i| {
                scale * (signs[i] * rates[i] + 0.005 + 0.002 * noise())
            })),
            ..UnitSample::default()
        });
    }
    MotionRecording::new("turned", times, samples)
}

#[test]
fn an_angular_rate_in_another_unit_than_its_columns_say_is_refused() {
    let choice = |method| Choice {
        method,
        ..Choice::default()
    };
    for method in [Method::Strapdown, Method::Slide] {
        for (scale, unit) in [(57.2958, "deg/s"), (1.0 / 57.2958, "rad/s")] {
            let refused = navigate(&turned(scale, [1.0; 3]), &choice(method)).unwrap_err();
            assert_eq!(refused.code(), ErrorCode::DataRefused);
            assert!(refused.remedy().contains(unit), "{refused}");
        }
    }
    let right = navigate(&turned(1.0, [1.0; 3]), &choice(Method::Strapdown)).unwrap();
    assert!(
        !right.findings.iter().any(|f| f.evidence.contains("turn")),
        "{:?}",
        right.findings
    );
    // A wrong sign is no unit: it is said.
    let wrong = navigate(&turned(1.0, [1.0, -1.0, 1.0]), &choice(Method::Strapdown)).unwrap();
    assert!(
        wrong.findings.iter().any(|f| f.evidence.contains("signs")),
        "{:?}",
        wrong.findings
    );
    // Without the rate nothing of that matters.
    assert!(navigate(&turned(57.2958, [1.0; 3]), &choice(Method::Tilt)).is_ok());
}

#[test]
fn attitude_is_doubted_where_the_angular_rate_is_missing() {
    let choice = Choice {
        method: Method::Strapdown,
        ..Choice::default()
    };
    let without = |count: usize| {
        let mut recording = turned(1.0, [1.0; 3]);
        for sample in &mut recording.samples[240..240 + count] {
            sample.rate_rad_s = None;
        }
        recording
    };
    let whole = navigate(&without(0), &choice).unwrap();
    let filled = navigate(&without(3), &choice).unwrap();
    let lost = navigate(&without(20), &choice).unwrap();
    // Bridged, with a deviation that grows with what is missing and holds what is off.
    let at = |path: &InertialPath, k: usize| (path.points[k].position_m, path.points[k].sd_m());
    let ((p, sd), (q, more), (r, most)) = (at(&whole, 280), at(&filled, 280), at(&lost, 280));
    let apart = |a: [f64; 3]| (0..3).map(|i| (a[i] - p[i]).abs()).fold(0.0, f64::max);
    assert!(sd < more && more < most, "{sd} {more} {most}");
    assert!(
        apart(q) < 0.01 && apart(r) < 2.0 * most,
        "{} {}",
        apart(q),
        apart(r)
    );
    assert!(filled.points[300].valid);
    assert!(
        lost.findings
            .iter()
            .any(|f| f.evidence.contains("missing in 20 samples")),
        "{:?}",
        lost.findings
    );
    let choice = Choice {
        method: Method::Slide,
        ..choice
    };
    let lost = navigate(&without(20), &choice).unwrap();
    assert!(lost.points[240..300].iter().all(|p| !p.valid));
}
