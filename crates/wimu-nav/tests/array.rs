//! What the array solver claims.

use crate::common;

use common::{Random, board, dot, minus, noisy, norm, outputs, triads};
use nalgebra::Vector3;
use proptest::prelude::*;
use wimu_nav::array::{Array, ArraySolver, Axis, Geometry, GeometryError, Hypothesis, Linear};
use wimu_testkit::{draws, figure, rms_ratio_can_be};

const DEG: f64 = std::f64::consts::PI / 180.0;

/// Six triads on the corners of an octahedron, 1 cm from its centre.
fn octahedron() -> Geometry {
    let places = [
        [1.0, 0.0, 0.0],
        [-1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, -1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, 0.0, -1.0],
    ];
    triads(&places, 0.01, 0.01)
}

/// The angular rates that fit a sample.
fn roots(solver: &ArraySolver, output: &[f64]) -> Vec<Hypothesis> {
    solver.roots_of(&solver.reduce(output)).to_vec()
}

/// The one nearest to a rate, rad/s.
fn nearest(roots: &[Hypothesis], rate: [f64; 3]) -> Hypothesis {
    let distance = |root: &&Hypothesis| norm(minus(root.rate_rad_s.into(), rate));
    *roots.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap()
}

/// Standard deviation of a component, rms, rad/s.
fn sd(root: &Hypothesis) -> f64 {
    let covariance = root.information.try_inverse();
    covariance.map_or(f64::INFINITY, |covariance| (covariance.trace() / 3.0).sqrt())
}

fn planar() -> Geometry {
    let places = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];
    triads(&places.map(|[x, y]| [x, y, 0.0]), 0.02, 0.01)
}

#[test]
fn the_octahedron_reaches_the_cramer_rao_bound() {
    let solver = ArraySolver::new(&octahedron()).unwrap();
    let mut random = Random::new(1);
    for (speed_deg, published_bound) in [(100.0, 14.2), (1000.0, 1.42)] {
        let rate = [speed_deg * DEG / 3f64.sqrt(); 3];
        let clean = outputs(&octahedron(), rate, [3.0, -2.0, 5.0], [1.0, 2.0, 9.0]);
        let exact = nearest(&roots(&solver, &clean), rate);
        assert!(norm(minus(exact.rate_rad_s.into(), rate)) < 1e-9);
        let bound = sd(&exact) / DEG;
        let draws = draws(20_000, 3);
        let mut squares = 0.0;
        for _ in 0..draws {
            let noisy = noisy(&clean, 0.01, &mut random);
            let found = nearest(&roots(&solver, &noisy), rate);
            let d = minus(found.rate_rad_s.into(), rate);
            squares += dot(d, d) / 3.0;
        }
        let rms = (squares / draws as f64).sqrt() / DEG;
        let ratio = rms / bound;
        println!("{speed_deg} deg/s: {rms:.2} deg/s rms an axis, bound {bound:.2}");
        let claim = format!("six triads at {speed_deg} deg/s: rate error over Cramér-Rao bound");
        let measured = format!("{ratio:.3}");
        figure(&claim, measured, "at most 1.15", ratio <= 1.15);
        assert!((bound / published_bound - 1.0).abs() < 0.01);
        // A biased estimate may be better than the bound, but not by much.
        assert!(rms_ratio_can_be(ratio, 3 * draws, 0.9..=1.15), "{ratio}");
    }
}

#[test]
fn both_roots_are_kept_and_continuity_chooses() {
    let solver = ArraySolver::new(&octahedron()).unwrap();
    assert_eq!(solver.rank(), 6);
    let rate = [3.0, -5.0, 2.0];
    let roots = roots(&solver, &outputs(&octahedron(), rate, [0.0; 3], [0.0, 0.0, 9.8]));
    assert_eq!(roots.len(), 2);
    for expected in [rate, rate.map(|w| -w)] {
        let near = expected.map(|w| w * 1.2);
        let found = nearest(&roots, near);
        assert!(norm(minus(found.rate_rad_s.into(), expected)) < 1e-9);
    }
}

#[test]
fn a_planar_array_has_four_roots() {
    let solver = ArraySolver::new(&planar()).unwrap();
    assert!((3..6).contains(&solver.rank()));
    let [x, y, z] = [3.0, -5.0, 2.0];
    let roots = roots(&solver, &outputs(&planar(), [x, y, z], [1.0, 2.0, 3.0], [0.0, 0.0, 9.8]));
    assert_eq!(roots.len(), 4);
    for expected in [[x, y, z], [x, y, -z], [-x, -y, z], [-x, -y, -z]] {
        let found = nearest(&roots, expected);
        assert!(norm(minus(found.rate_rad_s.into(), expected)) < 1e-6, "{expected:?}");
    }
}

#[test]
fn at_rest_there_is_no_information_about_the_rate() {
    let solver = ArraySolver::new(&octahedron()).unwrap();
    let still = outputs(&octahedron(), [0.0; 3], [0.0; 3], [0.0, 0.0, 9.8]);
    let found = roots(&solver, &still);
    assert!(found.len() == 1 && sd(&found[0]) > 1e3, "{found:?}");
    // The standard deviation falls as 1/|ω|.
    let sd = |speed: f64| {
        let clean = outputs(&octahedron(), [speed; 3], [0.0; 3], [0.0, 0.0, 9.8]);
        sd(&nearest(&roots(&solver, &clean), [speed; 3]))
    };
    assert!((sd(1.0) / sd(10.0) - 10.0).abs() < 1e-6);
}

#[test]
fn chens_cube_gives_angular_acceleration_and_force_but_no_rate() {
    // Single axes at the centres of the faces of a cube of 10 cm, each along a diagonal of its face.
    let faces = [
        ([0.0, 0.0, -1.0], [1.0, 1.0, 0.0]),
        ([0.0, -1.0, 0.0], [1.0, 0.0, 1.0]),
        ([-1.0, 0.0, 0.0], [0.0, 1.0, 1.0]),
        ([1.0, 0.0, 0.0], [0.0, 1.0, -1.0]),
        ([0.0, 1.0, 0.0], [1.0, 0.0, -1.0]),
        ([0.0, 0.0, 1.0], [1.0, -1.0, 0.0]),
    ];
    let axes = faces.map(|(place, direction): ([f64; 3], _)| Axis {
        position_m: place.map(|p| p * 0.05),
        direction,
        noise_mps2: 0.01,
    });
    let cube = Geometry::new(axes, 1).unwrap();
    let solver = ArraySolver::new(&cube).unwrap();
    assert_eq!(solver.rank(), 0);
    let (rate, turn, force) = ([2.0, -1.0, 3.0], [4.0, 5.0, -6.0], [0.3, 0.2, 9.8]);
    let y = outputs(&cube, rate, turn, force);
    assert!(roots(&solver, &y).is_empty());
    let theta = solver.theta(&solver.reduce(&y), &rate.into());
    for i in 0..3 {
        assert!((theta[i] - turn[i]).abs() < 1e-9);
        assert!((theta[3 + i] - force[i]).abs() < 1e-9);
    }
    // Their closed form: neither force nor centripetal acceleration is in it.
    let closed = [y[0] - y[1] - y[4] + y[5], -y[0] + y[2] + y[3] + y[5], y[1] - y[2] + y[3] - y[4]];
    let other = solver.theta(&solver.reduce(&y), &Vector3::zeros());
    for i in 0..3 {
        let chen = closed[i] / (2f64.sqrt() * 0.1);
        assert!((chen - turn[i]).abs() < 1e-9 && (other[i] - turn[i]).abs() < 1e-9);
    }
}

#[test]
fn arrays_in_space_have_two_roots() {
    let four = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
    for geometry in [triads(&four, 0.03, 0.01), board(0.002, 0.01)] {
        assert_eq!(ArraySolver::new(&geometry).unwrap().rank(), 6);
    }
}

#[test]
fn values_that_make_no_geometry_are_refused() {
    let axis = Axis { position_m: [0.0; 3], direction: [0.0, 0.0, 2.0], noise_mps2: 0.1 };
    let of = |axis: Axis| Geometry::new([axis; 5], 1);
    assert_eq!(of(axis).unwrap().axes()[4].direction, [0.0, 0.0, 1.0]);
    let error = GeometryError::BadAxis { axis: 0 };
    assert_eq!(of(Axis { position_m: [f64::NAN, 0.0, 0.0], ..axis }), Err(error));
    let error = GeometryError::BadNoise { axis: 0 };
    assert_eq!(of(Axis { noise_mps2: 0.0, ..axis }), Err(error));
    let error = GeometryError::BadGroup { have: 5, group: 3 };
    assert_eq!(Geometry::new([axis; 5], 3), Err(error));
    let many = triads(&[[0.0; 3]; 33], 1.0, 0.01);
    assert_eq!(Array::new(many).unwrap_err(), GeometryError::TooMany { have: 33, most: 32 });
}

#[test]
fn geometries_that_cannot_work_are_refused_with_what_is_missing() {
    let refused = |places: &[[f64; 3]]| ArraySolver::new(&triads(places, 1.0, 0.01)).unwrap_err();
    let one = refused(&[[0.0; 3]]);
    assert_eq!(one, GeometryError::TooFew { have: 3, need: 6 });
    assert_eq!(refused(&[[0.3, 0.1, 0.2]; 4]), GeometryError::Coincident);
    let line = refused(&[[0.0; 3], [0.01, 0.01, 0.0], [0.03, 0.03, 0.0]]);
    let GeometryError::NoTurn { about, collinear: true } = line else {
        panic!("{line:?}");
    };
    assert!((about[0].abs() - 0.5f64.sqrt()).abs() < 1e-6 && about[2].abs() < 1e-6);
    assert!(line.to_string().contains("one line; add one off it"));

    let flat: Vec<_> = [[0.0, 0.0], [0.1, 0.0], [0.0, 0.1], [0.1, 0.1]]
        .iter()
        .flat_map(|[x, y]| {
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(|direction| Axis {
                position_m: [*x, *y, 0.0],
                direction,
                noise_mps2: 0.01,
            })
        })
        .collect();
    let flat = ArraySolver::new(&Geometry::new(flat, 1).unwrap()).unwrap_err();
    assert!(
        matches!(
            flat,
            GeometryError::NoForce { .. } | GeometryError::NoTurn { collinear: false, .. }
        ),
        "{flat:?}"
    );
}

#[test]
fn triads_without_an_output_are_left_out_and_said() {
    let mut array = Array::new(octahedron()).unwrap();
    let mut random = Random::new(3);
    let rate = [6.0, -4.0, 5.0];
    let sample = |random: &mut Random| {
        noisy(&outputs(&octahedron(), rate, [1.0, 2.0, 3.0], [0.0, 0.0, 9.8]), 0.01, random)
    };
    let good = |array: &Array, linear: &Linear| {
        let roots = array.solver().roots_of(linear);
        norm(minus(nearest(&roots, rate).rate_rad_s.into(), rate)) < 1.0
    };
    let (linear, absent) = array.reduce(&sample(&mut random)).unwrap();
    assert!(absent == 0 && good(&array, &linear));

    let mut y = sample(&mut random);
    y[4] = f64::INFINITY;
    y[9] = f64::NAN;
    let (linear, absent) = array.reduce(&y).unwrap();
    assert_eq!(absent, 1 << 1 | 1 << 3);
    assert!(good(&array, &linear));

    let nothing = [f64::NAN; 18];
    assert_eq!(array.reduce(&nothing).unwrap_err(), GeometryError::TooFew { have: 0, need: 6 });
    let (linear, _) = array.reduce(&sample(&mut random)).unwrap();
    assert!(good(&array, &linear));
}

#[test]
fn what_is_not_finite_gives_no_rate() {
    let solver = ArraySolver::new(&octahedron()).unwrap();
    for bad in [f64::NAN, f64::INFINITY] {
        let mut y = [0.0; 18];
        y[7] = bad;
        assert!(roots(&solver, &y).is_empty());
    }
}

proptest! {
    #[test]
    fn any_array_in_space_finds_the_rate_of_any_motion(
        places in prop::collection::vec(prop::array::uniform3(-0.1f64..0.1), 5..8),
        rate in prop::array::uniform3(-30.0f64..30.0),
        turn in prop::array::uniform3(-500.0f64..500.0),
        force in prop::array::uniform3(-100.0f64..100.0),
    ) {
        let geometry = triads(&places, 1.0, 0.01);
        let solver = ArraySolver::new(&geometry).unwrap();
        prop_assume!(solver.rank() == 6 && norm(rate) > 1.0);
        let linear = solver.reduce(&outputs(&geometry, rate, turn, force));
        let found = nearest(&solver.roots_of(&linear), rate);
        prop_assert!(norm(minus(found.rate_rad_s.into(), rate)) < 1e-3, "{:?}", found);
        // What follows from it is right too, at the centre of the sensors.
        let centre: [f64; 3] =
            std::array::from_fn(|i| places.iter().map(|p| p[i]).sum::<f64>() / places.len() as f64);
        let theta = solver.theta(&linear, &found.rate_rad_s);
        let moved = common::cross(rate, common::cross(rate, centre));
        let turned = common::cross(turn, centre);
        for i in 0..3 {
            prop_assert!((theta[i] - turn[i]).abs() < 1e-2);
            let expected = force[i] + moved[i] + turned[i];
            prop_assert!((theta[3 + i] - expected).abs() < 1e-2);
        }
    }

    #[test]
    fn no_sample_makes_it_panic(
        values in prop::collection::vec(prop::num::f64::ANY, 0..20),
    ) {
        let mut array = Array::new(octahedron()).unwrap();
        let _ = array.reduce(&values);
        let _ = roots(&ArraySolver::new(&octahedron()).unwrap(), &values);
    }
}
