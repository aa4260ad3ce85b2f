//! Motions are smooth, join, and are what their names say.

use std::rc::Rc;

use wimu_model::STANDARD_GRAVITY_MPS2;
use wimu_sim::attitude::Attitude;
use wimu_sim::motion::{Hand, Motion, NAMES, Poses, Rest, Slide, named};
use wimu_sim::scene::{Scene, World};
use wimu_sim::walk::Strides;

fn norm(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn all() -> Vec<(&'static str, Rc<dyn Motion>)> {
    let names = NAMES.iter().map(|(name, _)| *name);
    let mut all: Vec<_> = names.map(|name| (name, named(name, 6).unwrap())).collect();
    let joined = "hand,slide,tilts, hand ,rest";
    all.push((joined, named(joined, 6).unwrap()));
    // A corner each way, and one that reverses.
    let corners = [[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [7.0, 3.0], [0.0, 3.0]];
    all.push(("strides", Rc::new(Strides::along(&corners))));
    all
}

#[test]
fn velocity_and_acceleration_are_the_derivatives_of_position() {
    // Simpson's rule does not hold over the kinks of an impact.
    for (name, motion) in all().into_iter().filter(|(name, _)| *name != "impact") {
        // Simpson's rule over each step, and the change it should be.
        let h = 0.005;
        let steps = (motion.duration() / h) as usize;
        for i in 0..steps {
            let [a, m, b] = [0.0, 0.5, 1.0].map(|f| motion.pose((i as f64 + f) * h));
            for axis in 0..3 {
                let integral = |x: f64, y: f64, z: f64| (x + 4.0 * y + z) * h / 6.0;
                let moved = b.position_m[axis] - a.position_m[axis];
                let velocity =
                    integral(a.velocity_mps[axis], m.velocity_mps[axis], b.velocity_mps[axis]);
                assert!((moved - velocity).abs() < 1e-9, "{name} at {i}");
                let gained = b.velocity_mps[axis] - a.velocity_mps[axis];
                let acceleration = integral(
                    a.acceleration_mps2[axis],
                    m.acceleration_mps2[axis],
                    b.acceleration_mps2[axis],
                );
                assert!((gained - acceleration).abs() < 1e-6, "{name} at {i}");
            }
        }
    }
}

#[test]
fn angular_rate_is_the_derivative_of_attitude() {
    for (name, motion) in all() {
        let h = 1e-4;
        let steps = (motion.duration() / 0.01) as usize;
        for t in (0..steps).map(|i| i as f64 * 0.01) {
            let [before, after] = [t - h, t + h].map(|t| motion.pose(t).attitude);
            let expected = before.rotation_vector_to(after).map(|r| r / (2.0 * h));
            let found = motion.pose(t).angular_rate_radps;
            let error = norm([0, 1, 2].map(|axis| found[axis] - expected[axis]));
            assert!(error < 1e-5, "{name} at {t} s: {found:?}, {expected:?}");
        }
    }
}

#[test]
fn nothing_jumps() {
    for (name, motion) in all() {
        let h = 1e-4;
        let steps = (motion.duration() / h) as i64;
        let mut before = motion.pose(-100.0 * h);
        for i in -99..steps + 100 {
            let now = motion.pose(i as f64 * h);
            // Faster than 2000 deg/s, or a jerk beyond 2000 m/s³, would be a jump.
            assert!(before.attitude.angle_to(now.attitude) < 35.0 * h, "{name} at {i}");
            for axis in 0..3 {
                let change = now.acceleration_mps2[axis] - before.acceleration_mps2[axis];
                assert!(change.abs() < 2000.0 * h, "{name} at {i}");
                let moved = now.position_m[axis] - before.position_m[axis];
                assert!(moved.abs() < 5.0 * h, "{name} at {i}");
            }
            before = now;
        }
    }
}

#[test]
fn every_motion_begins_and_ends_at_rest() {
    for (name, motion) in all() {
        let end = motion.duration();
        for (outside, edge) in [(-5.0, 0.0), (end + 5.0, end)] {
            let (outside, edge) = (motion.pose(outside), motion.pose(edge));
            assert_eq!(outside.velocity_mps, [0.0; 3], "{name}");
            assert_eq!(outside.acceleration_mps2, [0.0; 3], "{name}");
            for axis in 0..3 {
                let apart = outside.position_m[axis] - edge.position_m[axis];
                assert!(apart.abs() < 1e-12, "{name}");
            }
            assert!(outside.attitude.angle_to(edge.attitude) < 1e-12, "{name}");
        }
    }
}

#[test]
fn a_slides_acceleration_integrated_twice_is_its_distance() {
    let scene = Scene::new(World::default());
    scene.play(0.0, Rc::new(Slide::default()));
    // Double trapezoid at 10 kHz on what an ideal accelerometer would feel.
    let h = 1e-4;
    let (mut velocity, mut position, mut before) = (0.0, 0.0, 0.0);
    for i in 0..=90_000 {
        let [forward, side, up] = scene.state(f64::from(i) * h).specific_force_mps2;
        assert_eq!((side, up), (0.0, STANDARD_GRAVITY_MPS2));
        let last = velocity;
        velocity += (before + forward) / 2.0 * h;
        position += (last + velocity) / 2.0 * h;
        before = forward;
    }
    assert!((position - 1.0).abs() < 1e-8, "{position}");
    assert!(velocity.abs() < 1e-10);
    assert!((scene.state(100.0).position_m[0] - 1.0).abs() < 1e-15);
}

#[test]
fn a_slide_goes_where_its_body_points() {
    let slide = Slide {
        attitude: Attitude::from_rotation_vector([0.0, 0.0, std::f64::consts::FRAC_PI_2]),
        distance_m: 0.5,
        ..Slide::default()
    };
    let [east, north, up] = slide.pose(100.0).position_m;
    assert!(east.abs() < 1e-15 && (north - 0.5).abs() < 1e-15 && up == 0.0);
}

#[test]
fn at_rest_specific_force_is_gravity_upward_in_every_pose() {
    for poses in
        [Poses::six_positions(2.0), Poses::twelve_by_hand(9, 2.0, 2.0), Poses::tilts(9, 2.0)]
    {
        let scene = Scene::new(World::default());
        let begin = scene.play(0.0, Rc::new(poses.clone()));
        for hold in poses.holds() {
            for time in [hold.start_s, (hold.start_s + hold.end_s) / 2.0, hold.end_s] {
                let state = scene.state(begin + time);
                let force = state.specific_force_mps2;
                assert!((norm(force) - STANDARD_GRAVITY_MPS2).abs() < 1e-12);
                let [east, north, up] = hold.attitude.to_enu(force);
                assert!(east.abs() < 1e-9 && north.abs() < 1e-9 && up > 9.8);
                assert_eq!(state.velocity_mps, [0.0; 3]);
                assert!((norm(state.magnetic_field_nt) - 48_332.0).abs() < 1.0);
            }
        }
    }
}

#[test]
fn six_positions_are_squared_and_twelve_are_spread_and_misplaced_by_2_degrees() {
    let up = |poses: Poses| -> Vec<[f64; 3]> {
        let holds = poses.holds().iter();
        holds.map(|h| h.attitude.to_body([0.0, 0.0, 1.0])).collect()
    };
    for (pose, up) in up(Poses::six_positions(1.0)).into_iter().enumerate() {
        let mut expected = [0.0; 3];
        expected[pose / 2] = if pose % 2 == 0 { 1.0 } else { -1.0 };
        for axis in 0..3 {
            assert!((up[axis] - expected[axis]).abs() < 1e-15);
        }
    }

    let exact = up(Poses::twelve_by_hand(0, 0.0, 1.0));
    let angle = |a: &[f64; 3], b: &[f64; 3]| {
        (0..3).map(|i| a[i] * b[i]).sum::<f64>().clamp(-1.0, 1.0).acos().to_degrees()
    };
    for (i, a) in exact.iter().enumerate() {
        for b in &exact[..i] {
            assert!(angle(a, b) > 63.0, "corners of an icosahedron");
        }
    }
    let slips: Vec<f64> = (0..100)
        .flat_map(|seed| {
            let placed = up(Poses::twelve_by_hand(seed, 2.0, 1.0));
            let slips = placed.iter().zip(&exact).map(|(a, b)| angle(a, b));
            slips.collect::<Vec<_>>()
        })
        .collect();
    // Two of the three axes of a slip move the vertical.
    let rms = (slips.iter().map(|s| s * s).sum::<f64>() / slips.len() as f64).sqrt();
    assert!((rms / (2.0 * 2.0_f64.sqrt()) - 1.0).abs() < 0.05, "{rms}");
}

#[test]
fn the_hand_peaks_where_it_is_told_to() {
    for seed in 0..10 {
        let scene = Scene::new(World::default());
        scene.play(0.0, Rc::new(Hand::new(seed, 8.0, 20.0)));
        let peak = (0..8000)
            .map(|i| norm(scene.state(f64::from(i) * 1e-3).specific_force_mps2))
            .fold(0.0, f64::max);
        assert!((19.9..20.1).contains(&peak), "{peak}");
    }
}

#[test]
fn what_is_played_next_continues_from_where_the_body_is() {
    let scene = Scene::new(World::default());
    assert_eq!(scene.play(2.0, Rc::new(Slide::default())), 2.0);
    assert_eq!(scene.end_s(), 11.0);
    let upside_down = Rest { attitude: Attitude::with_up([0.0, 0.0, -1.0]), seconds: 5.0 };
    // Asked for too early, and after a turn.
    assert_eq!(scene.play(5.0, Rc::new(upside_down)), 12.0);
    assert!((scene.state(14.0).position_m[0] - 1.0).abs() < 1e-12);
    assert!(scene.state(14.0).specific_force_mps2[2] < -9.8);
    assert_eq!(scene.state(1.0).position_m, [0.0; 3]);
}

#[test]
fn an_unknown_name_says_which_are_known() {
    let error = named("rest,jump", 1).unwrap_err().to_string();
    assert_eq!(
        error,
        "there is no motion `jump`; known are rest, six-positions, twelve-poses, tilts, slide, carry, hand, impact"
    );
}
