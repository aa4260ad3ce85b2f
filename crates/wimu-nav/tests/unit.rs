//! What the filter of one unit and the slide claim.

use crate::common;

use common::Random;
use wimu_nav::slide::{Rest, Slide, SlideConfig};
use wimu_nav::unit::{UnitConfig, UnitFault, UnitFilter, UnitSample, UnitState, Zupt};

const G: f64 = 9.80665;
const RATE: f64 = 100.0;
const FIELD: [f64; 3] = [0.0, 20.0, -44.0];

fn at_rest(random: &mut Random) -> UnitSample {
    let noise = random.normals(0.02);
    let field = random.normals(0.5);
    UnitSample {
        step_s: 1.0 / RATE,
        force_mps2: [noise[0], noise[1], G + noise[2]],
        field_ut: Some([0, 1, 2].map(|i| FIELD[i] + field[i])),
        rate_rad_s: None,
    }
}

fn config() -> UnitConfig {
    UnitConfig {
        gravity_mps2: G,
        ..UnitConfig::default()
    }
}

fn sane(state: &UnitState) -> bool {
    let q: f64 = state.quaternion.iter().map(|c| c * c).sum();
    let numbers = state.position_m.iter().chain(&state.velocity_mps);
    numbers
        .chain(state.position_covariance.iter().flatten())
        .all(|v| v.is_finite())
        && (q - 1.0).abs() < 1e-6
}

/// The same sample in f32.
fn single(sample: &UnitSample) -> UnitSample<f32> {
    let narrow = |v: [f64; 3]| v.map(|c| c as f32);
    UnitSample {
        step_s: sample.step_s as f32,
        force_mps2: narrow(sample.force_mps2),
        field_ut: sample.field_ut.map(narrow),
        rate_rad_s: sample.rate_rad_s.map(narrow),
    }
}

#[test]
fn in_f32_the_answer_is_that_of_f64_within_a_third_of_its_uncertainty() {
    for (zupt, gyroscope) in [(Zupt::Stated, false), (Zupt::Off, false), (Zupt::Off, true)] {
        let mut random = Random::new(11);
        let config = UnitConfig { zupt, ..config() };
        let (mut wide, mut narrow) = (UnitFilter::new(config), UnitFilter::<f32>::new(config));
        for k in 0..12_000 {
            let mut sample = at_rest(&mut random);
            let t = f64::from(k) / RATE;
            if (300..3000).contains(&k) {
                sample.force_mps2[0] += 0.8 * (3.0 * t).sin();
                sample.force_mps2[2] += 0.5 * (4.0 * t).cos();
            }
            if gyroscope {
                sample.rate_rad_s = Some(random.normals(0.005));
            }
            wide.push(&sample).unwrap();
            narrow.push(&single(&sample)).unwrap();
            if k % 1000 == 999 {
                let (w, n) = (wide.state(), narrow.state());
                for i in 0..3 {
                    let apart = (w.position_m[i] - f64::from(n.position_m[i])).abs();
                    let sd = w.position_covariance[i][i].sqrt();
                    assert!(apart < 0.3 * sd + 1e-3, "{k} {i}: {apart} of {sd}");
                }
                let ratio = f64::from(n.position_sd_m()) / w.position_sd_m();
                // What is at a threshold may fall to the other side for a tenth of a second.
                assert!((0.8..1.25).contains(&ratio), "{k}: {ratio}");
            }
        }
        // A gap takes the covariance far up, and a rest down again.
        let gap = UnitSample {
            step_s: 900.0,
            ..at_rest(&mut random)
        };
        assert_eq!(narrow.push(&single(&gap)), Err(UnitFault::Gap));
        for _ in 0..500 {
            narrow.push(&single(&at_rest(&mut random))).unwrap();
        }
        let state = narrow.state();
        let sum: f32 = state.quaternion.iter().map(|c| c * c).sum();
        assert!(state.position_sd_m().is_finite() && (sum - 1.0).abs() < 1e-4);
        assert_eq!(state.valid, zupt.is_on());
    }
}

#[test]
fn a_first_rest_too_short_to_align_at_keeps_no_later_rest_from_being_believed() {
    // Carried off and tilted by 0.3 rad before the first second is over, with nothing that tells a tilt
    // from a push but the rate, or not even that.
    for (rests, gyroscope) in (5..10).flat_map(|n| [(n * 10, true), (n * 10, false)]) {
        let mut random = Random::new(12);
        let mut filter = UnitFilter::new(config());
        for k in 0..500 {
            let share = f64::from((k - rests).clamp(0, 100)) / 100.0;
            let tilt: f64 = 0.3 * share;
            let mut sample = at_rest(&mut random);
            sample.field_ut = None;
            let moves = k >= rests && k < rests + 100;
            let push = if moves {
                2.0 * (core::f64::consts::TAU * share).sin()
            } else {
                0.0
            };
            let (noise, up) = (sample.force_mps2, sample.force_mps2[2]);
            sample.force_mps2 = [noise[0] + push, noise[1] + up * tilt.sin(), up * tilt.cos()];
            sample.rate_rad_s = gyroscope.then(|| {
                let mut rate = random.normals(1e-3);
                rate[0] += if moves { 0.3 } else { 0.0 };
                rate
            });
            filter.push(&sample).unwrap();
        }
        let state = filter.state();
        let off: f64 = state.position_m.iter().map(|p| p * p).sum();
        assert!(
            state.valid && off.sqrt() < 3.0 * state.position_sd_m() + 0.01,
            "{rests}, gyroscope {gyroscope}: {state:?}"
        );
    }
}

#[test]
fn even_motion_after_a_push_is_not_taken_for_rest() {
    // With a gyroscope the push is known well: 1 m/s, then quiet for 8.5 s.
    let mut random = Random::new(8);
    let mut filter = UnitFilter::new(config());
    let mut worst = 0.0_f64;
    for k in 0..1100 {
        let mut sample = at_rest(&mut random);
        sample.rate_rad_s = Some(random.normals(1e-3));
        if (200..250).contains(&k) {
            sample.force_mps2[0] += 2.0;
        }
        filter.push(&sample).unwrap();
        let truth = if k < 200 {
            0.0
        } else if k < 250 {
            (f64::from(k - 200) / RATE).powi(2)
        } else {
            0.25 + f64::from(k - 250) / RATE
        };
        let state = filter.state();
        if state.valid {
            let error = ((state.position_m[0] - truth).powi(2)).sqrt();
            worst = worst.max(error / state.position_sd_m().max(0.01));
        }
    }
    assert!(filter.state().even > 20, "{:?}", filter.state());
    assert!(worst < 4.0, "{worst} standard deviations");
    let speed = filter.state().velocity_mps[0];
    assert!((speed - 1.0).abs() < 0.1, "{speed} m/s");
}

#[test]
fn a_pause_of_a_second_is_a_rest_at_any_rate_and_the_motion_before_it_is_not() {
    for rate in [50, 100, 400] {
        let mut random = Random::new(21);
        let mut filter = UnitFilter::new(config());
        for k in 0..5 * rate {
            let mut sample = at_rest(&mut random);
            sample.step_s = 1.0 / f64::from(rate);
            let t = f64::from(k) / f64::from(rate);
            let moves = (2.0..4.0).contains(&t);
            if moves {
                sample.force_mps2[0] += 1.5 * (std::f64::consts::PI * t).sin();
            }
            filter.push(&sample).unwrap();
            if (2.3..4.0).contains(&t) {
                assert!(!filter.state().resting, "{rate} Hz, {t} s");
            }
        }
        let state = filter.state();
        let speed = state.velocity_mps.map(|v| v * v).iter().sum::<f64>().sqrt();
        assert!(state.resting && speed < 0.01, "{rate} Hz: {speed} m/s");
    }
}

#[test]
fn a_start_in_motion_is_not_valid_before_the_first_rest_and_position_begins_there() {
    let mut random = Random::new(22);
    let mut filter = UnitFilter::new(UnitConfig {
        zupt: Zupt::Stated,
        ..config()
    });
    for k in 0..600 {
        let mut sample = at_rest(&mut random);
        if k < 300 {
            sample.force_mps2[1] += 1.5 * (f64::from(k) * 0.03).cos();
        }
        filter.push(&sample).unwrap();
        assert!(k >= 300 || !filter.state().valid, "{k}");
    }
    let state = filter.state();
    assert!(state.valid && state.position_sd_m() < 0.02, "{state:?}");
}

#[test]
fn what_a_gyroscope_leaves_out_is_doubted_and_its_bias_is_not_taken_for_a_rate() {
    // A quarter turn to and fro about x every 4 s; the gyroscope fails for so long, s, at its fastest.
    for fails_s in [0.0, 0.1, 0.2, 1.0] {
        let mut random = Random::new(24);
        let mut filter = UnitFilter::new(config());
        for k in 0..900 {
            let t = f64::from(k) / RATE - 2.0;
            let phase = std::f64::consts::FRAC_PI_2 * t.max(0.0);
            let (angle, rate) = if t > 0.0 {
                (
                    0.4 * (1.0 - phase.cos()),
                    0.4 * std::f64::consts::FRAC_PI_2 * phase.sin(),
                )
            } else {
                (0.0, 0.0)
            };
            let noise = random.normals(0.01);
            let body = |v: [f64; 3]| {
                let (sin, cos) = angle.sin_cos();
                [v[0], cos * v[1] + sin * v[2], cos * v[2] - sin * v[1]]
            };
            let force = body([0.0, 0.0, G]);
            let fails = t > 1.0 && t < 1.0 + fails_s;
            let sample = UnitSample {
                step_s: 1.0 / RATE,
                force_mps2: std::array::from_fn(|i| force[i] + noise[i]),
                field_ut: Some(body(FIELD)),
                rate_rad_s: (!fails).then_some([0.1 + rate, -0.1, 0.05]),
            };
            filter.push(&sample).unwrap();
            let state = filter.state();
            let [w, x, ..] = state.quaternion;
            let apart = (2.0 * x.atan2(w) - angle).abs();
            let sd = state.attitude_sd_rad[0];
            assert!(apart < 5.0 * sd + 0.01, "{fails_s} s, {t}: {apart} of {sd}");
        }
    }
}

#[test]
fn a_gyroscopes_offset_is_found_at_the_first_rest() {
    let mut random = Random::new(23);
    let mut filter = UnitFilter::new(config());
    for _ in 0..500 {
        let mut sample = at_rest(&mut random);
        let noise = random.normals(3e-3);
        sample.rate_rad_s = Some([0.2 + noise[0], -0.3 + noise[1], noise[2]]);
        filter.push(&sample).unwrap();
    }
    let state = filter.state();
    assert!(state.valid && state.resting, "{state:?}");
    let rate = state.rate_rad_s.map(f64::abs);
    assert!(rate.iter().all(|r| *r < 0.02), "{rate:?}");
    assert!(state.quaternion[0].abs() > 0.9999, "{state:?}");
}

/// At rest for so long, s, with a gap of 1 s before the last two where one is asked for; then 0.5 m east in 2 s.
fn move_after(rest_s: f64, gap: bool, zupt: Zupt) -> [UnitState; 2] {
    let mut random = Random::new(17);
    let mut filter = UnitFilter::new(UnitConfig { zupt, ..config() });
    let (rest, last) = ((rest_s * RATE) as u32, 2.0);
    let mut before = filter.state();
    for k in 0..rest + 200 {
        let tau = (f64::from(k) - f64::from(rest)) / RATE / last;
        let push = if tau > 0.0 {
            0.5 * 60.0 * tau * (1.0 - tau) * (1.0 - 2.0 * tau) / (last * last)
        } else {
            before = filter.state();
            0.0
        };
        let mut sample = at_rest(&mut random);
        sample.force_mps2[0] += push;
        sample.rate_rad_s = Some(random.normals(0.002));
        if gap && k + 200 == rest {
            sample.step_s = 1.0;
            assert_eq!(filter.push(&sample), Err(UnitFault::Gap));
            assert!(!filter.state().valid);
        } else {
            filter.push(&sample).unwrap();
        }
    }
    [before, filter.state()]
}

#[test]
fn a_long_rest_before_the_first_move_costs_little_and_so_does_a_gap_in_it() {
    for zupt in [Zupt::Assumed, Zupt::Stated, Zupt::Off] {
        let [_, usual] = move_after(4.0, false, zupt);
        for (rest_s, gap) in [(120.0, false), (10.0, true)] {
            let [before, moved] = move_after(rest_s, gap, zupt);
            assert!(before.at_origin && before.valid, "{before:?}");
            assert!(before.position_m == [0.0; 3], "{before:?}");
            assert!(before.position_sd_m() < 0.25, "{before:?}");
            assert!(moved.valid && !moved.at_origin, "{moved:?}");
            let sd = moved.position_sd_m();
            assert!(sd < 2.5 * usual.position_sd_m(), "{zupt:?} {sd}: {usual:?}");
            let [e, n, u] = moved.position_m;
            let off = ((e - 0.5).powi(2) + n * n + u * u).sqrt();
            assert!(off < 3.0 * sd && sd < 0.4, "{zupt:?}: {off} of {sd}");
        }
    }
}

#[test]
fn a_unit_at_rest_stays_where_it_is_with_zupt_and_gets_lost_without() {
    for (zupt, least, most) in [(Zupt::Stated, 0.0, 0.15), (Zupt::Off, 0.5, 1e4)] {
        let mut random = Random::new(1);
        let mut filter = UnitFilter::new(UnitConfig { zupt, ..config() });
        for k in 0..6000 {
            let mut sample = at_rest(&mut random);
            if (300..340).contains(&k) {
                // Shaken: from here on position is not that of the start.
                sample.force_mps2[0] +=
                    2.0 * (f64::from(k - 300) * std::f64::consts::PI / 20.0).sin();
            }
            filter.push(&sample).unwrap();
        }
        let state = filter.state();
        assert!(state.valid && state.resting && sane(&state));
        assert!(
            (least..most).contains(&state.position_sd_m()),
            "{zupt:?}: {}",
            state.position_sd_m()
        );
    }
}

#[test]
fn alignment_finds_level_and_north() {
    let mut random = Random::new(2);
    let mut filter = UnitFilter::new(config());
    // Body x points north, y west.
    for _ in 0..200 {
        let level = at_rest(&mut random);
        let body = |v: [f64; 3]| [v[1], -v[0], v[2]];
        let sample = UnitSample {
            force_mps2: body(level.force_mps2),
            field_ut: level.field_ut.map(body),
            ..level
        };
        filter.push(&sample).unwrap();
    }
    let [w, x, y, z] = filter.state().quaternion;
    let heading = (2.0 * (x * y + w * z)).atan2(1.0 - 2.0 * (y * y + z * z));
    assert!(
        (heading - std::f64::consts::FRAC_PI_2).abs() < 0.02,
        "{heading}"
    );
}

#[test]
fn without_a_rest_at_the_start_the_attitude_is_known_worse() {
    let run = |size: f64| {
        let mut random = Random::new(3);
        let mut filter = UnitFilter::new(config());
        for k in 0..150 {
            let mut sample = at_rest(&mut random);
            sample.force_mps2[0] += size * (f64::from(k) * 0.05).sin();
            filter.push(&sample).unwrap();
        }
        filter.state().attitude_sd_rad[1]
    };
    assert!(run(3.0) > 3.0 * run(0.0));
}

#[test]
fn without_a_magnetometer_it_navigates_by_its_first_heading() {
    let mut random = Random::new(4);
    let mut filter = UnitFilter::new(config());
    for _ in 0..500 {
        let sample = UnitSample {
            field_ut: None,
            ..at_rest(&mut random)
        };
        filter.push(&sample).unwrap();
    }
    let state = filter.state();
    assert!(state.valid && sane(&state) && state.disturbed == 0);
}

#[test]
fn a_magnetic_disturbance_is_left_out_and_counted() {
    let mut random = Random::new(5);
    let mut filter = UnitFilter::new(config());
    for k in 0..1000 {
        let mut sample = at_rest(&mut random);
        if (500..600).contains(&k) {
            sample.field_ut = Some([150.0, 80.0, 10.0]);
        }
        filter.push(&sample).unwrap();
    }
    let state = filter.state();
    assert!(state.disturbed > 10, "{}", state.disturbed);
    assert!(state.quaternion[0].abs() > 0.99 && sane(&state));
}

#[test]
fn gaps_jumps_and_what_is_no_number_are_said_and_survived() {
    let mut random = Random::new(6);
    let mut filter = UnitFilter::new(UnitConfig {
        zupt: Zupt::Off,
        ..config()
    });
    for _ in 0..300 {
        filter.push(&at_rest(&mut random)).unwrap();
    }
    assert!(filter.state().valid);
    let good = at_rest(&mut random);
    let nan = UnitSample {
        force_mps2: [f64::NAN, 0.0, G],
        ..good
    };
    assert_eq!(filter.push(&nan), Err(UnitFault::NotFinite));
    let infinite = UnitSample {
        rate_rad_s: Some([f64::INFINITY; 3]),
        ..good
    };
    assert_eq!(filter.push(&infinite), Err(UnitFault::NotFinite));
    let huge = UnitSample {
        force_mps2: [1e300, 0.0, G],
        ..good
    };
    assert_eq!(filter.push(&huge), Err(UnitFault::NotFinite));
    for step_s in [-1.0, 0.0] {
        assert_eq!(
            filter.push(&UnitSample { step_s, ..good }),
            Err(UnitFault::NoTime)
        );
    }
    assert!(filter.state().valid && sane(&filter.state()));
    assert_eq!(
        filter.push(&UnitSample {
            step_s: 2.0,
            ..good
        }),
        Err(UnitFault::Gap)
    );
    assert!(!filter.state().valid);
    for _ in 0..300 {
        filter.push(&at_rest(&mut random)).unwrap();
    }
    // It had not moved: the way begins after the gap.
    let state = filter.state();
    assert!(sane(&state) && state.valid && state.at_origin, "{state:?}");
    // Now it has.
    for k in 0..50 {
        let mut sample = at_rest(&mut random);
        sample.force_mps2[0] += 2.0 * (f64::from(k) * std::f64::consts::PI / 25.0).sin();
        filter.push(&sample).unwrap();
    }
    let _ = filter.push(&UnitSample {
        step_s: 2.0,
        ..good
    });
    for _ in 0..300 {
        filter.push(&at_rest(&mut random)).unwrap();
    }
    assert!(sane(&filter.state()) && !filter.state().valid);
}

#[test]
fn a_slide_with_bias_and_a_changed_tilt_is_as_long_as_it_was() {
    let before = Rest {
        force_mps2: [0.05, -0.03, G],
        sd_mps2: 0.001,
        rate_rad_s: None,
    };
    let after = Rest {
        force_mps2: [0.09, -0.03, G],
        sd_mps2: 0.001,
        rate_rad_s: None,
    };
    let mut slide = Slide::new(SlideConfig::default(), before);
    let steps = 1000;
    let duration = 2.0;
    for k in 0..=steps {
        let tau = f64::from(k) / f64::from(steps);
        let curve = 60.0 * tau * (1.0 - tau) * (1.0 - 2.0 * tau) / (duration * duration);
        let gravity = 0.05 + 0.04 * tau;
        let step = if k == 0 {
            0.0
        } else {
            duration / f64::from(steps)
        };
        assert!(slide.push(step, [gravity + curve, -0.03, G], None));
    }
    assert!(!slide.push(f64::NAN, [0.0; 3], None) && !slide.push(0.01, [f64::NAN; 3], None));
    let done = slide.finish(after);
    assert!((done.length_m - 1.0).abs() < 1e-4, "{done:?}");
    assert!(done.length_sd_m > 1e-3 && done.length_sd_m < 0.05);
    assert!((done.turned_rad - 0.04 / G).abs() < 1e-4);
}

#[test]
fn a_rate_is_that_at_its_time_stamp() {
    // To 1.5 rad and back in 1 s each, 50 samples a second: half a sample's time would be 28 mrad.
    let mut random = Random::new(26);
    let mut filter = UnitFilter::new(config());
    let (step, mut worst) = (0.02, 0.0_f64);
    for k in 0..250 {
        let phase = std::f64::consts::PI * (f64::from(k) * step - 2.0).clamp(0.0, 2.0);
        let (angle, rate) = (
            0.75 * (1.0 - phase.cos()),
            0.75 * std::f64::consts::PI * phase.sin(),
        );
        let (sin, cos) = angle.sin_cos();
        let body = |v: [f64; 3]| [v[0], cos * v[1] + sin * v[2], cos * v[2] - sin * v[1]];
        let force = body([0.0, 0.0, G]);
        let noise = random.normals(0.003);
        filter
            .push(&UnitSample {
                step_s: step,
                force_mps2: std::array::from_fn(|i| force[i] + noise[i]),
                field_ut: None,
                rate_rad_s: Some([rate, 0.0, 0.0]),
            })
            .unwrap();
        let [w, x, ..] = filter.state().quaternion;
        worst = worst.max((2.0 * x.atan2(w) - angle).abs());
    }
    assert!(worst < 0.004, "{worst}");
    let state = filter.state();
    let length = state.position_m.iter().map(|p| p * p).sum::<f64>().sqrt();
    assert!(
        length < 3.0 * state.position_sd_m() && length < 0.02,
        "{state:?}"
    );
}

/// It begins in a move, and the next one begins as soon as it has aligned at the first rest.
#[test]
fn the_turn_that_ends_the_first_rest_is_no_bias_of_the_gyroscope() {
    const BIAS: [f64; 3] = [0.03, 0.03, -0.02];
    let mut random = Random::new(5);
    let mut wrong = 0;
    for hundredths in 100..180 {
        let mut filter = UnitFilter::new(UnitConfig {
            zupt: Zupt::Stated,
            ..config()
        });
        let rest = 1.0 + f64::from(hundredths) / 100.0;
        for k in 0..((rest + 3.0) * RATE) as usize {
            let t = k as f64 / RATE;
            let mut sample = at_rest(&mut random);
            let turning = t - rest;
            let mut rate = random.normals(0.003);
            if t < 1.0 {
                sample.force_mps2[0] += 3.0 * (12.0 * t).sin();
            } else if (0.0..1.0).contains(&turning) {
                rate[2] += 6.0 * turning * (1.0 - turning);
                sample.force_mps2[0] += 2.0 * (std::f64::consts::TAU * turning).sin();
            }
            sample.rate_rad_s = Some([0, 1, 2].map(|i| rate[i] + BIAS[i]));
            filter.push(&sample).unwrap();
        }
        let state = filter.state();
        // Of the noise of its reading, 4 deviations.
        let known = state.rate_rad_s.iter().all(|off| off.abs() < 0.012);
        wrong += u32::from(!known);
    }
    assert!(wrong < 4, "{wrong} of 80");
}
