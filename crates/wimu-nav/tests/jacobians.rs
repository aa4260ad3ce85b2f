//! Transitions and Jacobians equal numerical derivatives.

use crate::common;

use common::Random;
use common::states::{certain, covariance, difference, nine, shifted, states, three};
use nalgebra::{DVector, Matrix1, Rotation3, SMatrix, Vector3};
use wimu_nav::array::{ArraySolver, Linear};
use wimu_nav::filter::Filter;
use wimu_nav::process::{
    AccelerationOffset, ArrayForce, Carried, CarriedBlocks, ConstantVelocity, GaussMarkov,
    ImuErrors, Odometry, OdometryBlocks, OdometryErrors, Process, RandomWalk, Relative,
    RelativeBlocks, RigidArray, RigidArrayBlocks, Strapdown, StrapdownBlocks, Unmeasured,
};
use wimu_nav::sensor::{
    Anchor, Antenna, ArrayNoise, CommonAxis, CommonPoint, CorrelatedErrors, Heading, Known,
    MagneticField, Magnetometer, Measurement, Mounting, NonHolonomic, Odometer, Position, Range,
    RangeErrors, ReducedArray, SpecificForce, Velocity, VerticalRate,
};
use wimu_nav::state::{ATTITUDE, Block, Layout, POSITION, Role, State, VELOCITY};

const N: usize = 40;
/// Size of the errors for central differences.
const SMALL: f64 = 1e-5;

type Matrix = SMatrix<f64, N, N>;

fn layout() -> Layout {
    Layout::new([1.0; 3], 1.0, 1.0)
}

/// A state away from zero and with any attitude; considered states are zero.
fn anywhere(random: &mut Random, layout: &Layout, states: &[Block<1>]) -> Filter {
    let attitude = Rotation3::new(Vector3::from(random.normals(1.0)));
    let mut filter = Filter::new(layout, attitude);
    for state in states.iter().filter(|s| s.start() >= 3) {
        filter.state.set(*state, Matrix1::new(random.normal() * 0.3));
    }
    filter
}

/// F of a process, from its effect on the covariance of one state at a time: F e eᵀ Fᵀ. A diagonal element of F is
/// positive.
fn transition(start: &Filter, states: &[Block<1>], process: &impl Process) -> Matrix {
    let mut without = start.clone();
    certain(&mut without, states);
    let mut noise = without.clone();
    noise.predict(process);
    let noise: Matrix = covariance(&noise, states);
    let mut f = Matrix::zeros();
    for state in states {
        let k = state.start();
        let mut filter = without.clone();
        filter.set_covariance(*state, &Matrix1::new(1.0));
        filter.predict(process);
        let product = covariance::<N>(&filter, states) - noise;
        f.set_column(k, &(product.column(k) / product[(k, k)].sqrt()));
    }
    f
}

/// Small errors of one state, with both signs.
fn errors_of(filter: &Filter, state: Block<1>) -> [DVector<f64>; 2] {
    [SMALL, -SMALL].map(|size| {
        let mut error = DVector::zeros(filter.states());
        error[state.start()] = size;
        error
    })
}

/// F by central differences of a step.
fn numerical(start: &Filter, states: &[Block<1>], step: impl Fn(&DVector<f64>) -> State) -> Matrix {
    let mut f = Matrix::zeros();
    for state in states {
        let [more, less] = errors_of(start, *state).map(|error| step(&error));
        let change = difference(&more, &less) / (2.0 * SMALL);
        f.view_mut((0, state.start()), (change.len(), 1)).copy_from(&change);
    }
    f
}

/// F of a process by central differences of its own step of the state.
fn numerical_of(start: &Filter, states: &[Block<1>], process: &impl Process) -> Matrix {
    numerical(start, states, |error| {
        let mut filter = start.clone();
        filter.state = shifted(&start.state, error);
        filter.predict(process);
        filter.state
    })
}

/// Asserts that rows of a transition agree to a tolerance.
#[track_caller]
fn assert_rows(
    a: &Matrix,
    b: &Matrix,
    rows: std::ops::Range<usize>,
    columns: &[Block<1>],
    tolerance: f64,
) {
    for row in rows {
        for column in columns {
            let at = (row, column.start());
            let off = (a[at] - b[at]).abs();
            assert!(off < tolerance, "{at:?}: {} and {}, {off:e}", a[at], b[at]);
        }
    }
}

/// A strapdown step, and the same step of a true unit whose states and delay differ by an error.
struct StrapdownCase {
    filter: Filter,
    blocks: StrapdownBlocks,
    errors: ImuErrors,
    force: Vector3<f64>,
    rate: Vector3<f64>,
    step_s: f64,
}

impl StrapdownCase {
    fn process(&self, force_mps2: Vector3<f64>, rate_rad_s: Vector3<f64>) -> Strapdown<'_> {
        Strapdown {
            blocks: &self.blocks,
            errors: &self.errors,
            gravity_mps2: 9.8,
            force_mps2,
            rate_rad_s,
            step_s: self.step_s,
        }
    }

    fn true_step(&self, error: &DVector<f64>) -> State {
        let mut filter = self.filter.clone();
        filter.state = shifted(&self.filter.state, error);
        let rate = self.rate - filter.state.get(self.blocks.gyroscope_bias);
        let lead = Rotation3::new(rate * filter.state.value(self.blocks.delay));
        filter.state.attitude *= lead;
        filter.predict(&self.process(self.force, self.rate));
        filter.state.attitude *= lead.inverse();
        filter.state
    }
}

#[test]
fn the_strapdown_transition_is_the_derivative_to_first_order_in_the_step() {
    let mut random = Random::new(1);
    for step_s in [0.002, 0.01] {
        let (mut layout, errors) = (layout(), ImuErrors::default());
        let blocks = StrapdownBlocks::claim(&mut layout, &errors);
        let blocks = blocks.consider(&mut layout, &errors, Role::Considered);
        let matrices = [blocks.accelerometer_matrix, blocks.gyroscope_matrix].map(Option::unwrap);
        let delay = blocks.delay.unwrap();
        let estimated = states(&[blocks.gyroscope_bias, blocks.accelerometer_bias]);
        let mut all = estimated.clone();
        all.extend(matrices.into_iter().flat_map(nine));
        all.push(delay);
        let case = StrapdownCase {
            filter: anywhere(&mut random, &layout, &estimated),
            blocks,
            errors,
            force: Vector3::new(2.0, -1.0, 9.0),
            rate: Vector3::new(0.5, -0.8, 1.2),
            step_s,
        };
        let analytic = transition(&case.filter, &all, &case.process(case.force, case.rate));
        let numeric = numerical(&case.filter, &all, |error| case.true_step(error));
        // What is left out is of second order in the step, for the position of third order.
        let square = step_s * step_s;
        assert_rows(&analytic, &numeric, 0..N, &all, 20.0 * square);
        assert_rows(&analytic, &numeric, 6..9, &estimated, 20.0 * square * step_s);
        // And is not zero by accident.
        let size = |block: &[Block<1>]| {
            block.iter().map(|b| analytic.column(b.start()).norm()).sum::<f64>()
        };
        assert!(size(&nine(matrices[0])) > 20.0 * step_s);
        assert!(size(&[delay]) > 5.0 * step_s);
    }
}

#[test]
fn the_carried_transition_is_the_derivative_to_first_order_in_the_step() {
    let mut random = Random::new(2);
    for step_s in [0.002, 0.02] {
        let mut layout = layout();
        let blocks = CarriedBlocks::claim(&mut layout, 1.0, 1.0);
        let all = states(&[blocks.angular_rate, blocks.acceleration]);
        let start = anywhere(&mut random, &layout, &all);
        for at_rest in [false, true] {
            let process = Carried {
                blocks: &blocks,
                acceleration_mps2: 3.0,
                rate_rad_s: 2.0,
                at_rest,
                step_s,
            };
            let analytic = transition(&start, &all, &process);
            let numeric = numerical_of(&start, &all, &process);
            assert_rows(&analytic, &numeric, 0..3, &all, step_s * step_s);
            // All but the attitude is linear.
            assert_rows(&analytic, &numeric, 3..N, &all, 1e-8);
        }
    }
}

#[test]
fn gauss_markov_and_gaps_have_their_derivative() {
    let mut random = Random::new(3);
    let mut layout = layout();
    let block = layout.claim(Role::Estimated, [1.0; 3]);
    let all = states(&[block]);
    let start = anywhere(&mut random, &layout, &all);
    let offset = AccelerationOffset { block, step_s: 0.7 };
    let markov = GaussMarkov { block, deviation: 3.0, time_s: 10.0, step_s: 0.7 };
    let walk = RandomWalk { block: POSITION, density: 0.2, step_s: 0.7 };
    let gap = Unmeasured { step_s: 0.7, since_s: 0.0 };
    let check =
        |analytic: Matrix, numeric: Matrix| assert_rows(&analytic, &numeric, 0..N, &all, 1e-8);
    check(transition(&start, &all, &markov), numerical_of(&start, &all, &markov));
    check(transition(&start, &all, &gap), numerical_of(&start, &all, &gap));
    check(transition(&start, &all, &offset), numerical_of(&start, &all, &offset));
    let both = (gap, (markov, walk));
    check(transition(&start, &all, &both), numerical_of(&start, &all, &both));
}

/// Asserts that a measurement has the derivative −∂(innovation)/∂x where the covariance is zero.
#[track_caller]
fn assert_jacobian<const M: usize>(
    start: &Filter,
    states: &[Block<1>],
    measurement: &impl Measurement,
) {
    let mut filter = start.clone();
    certain(&mut filter, states);
    let prediction = measurement.predict(&filter);
    for state in states {
        let [more, less] = errors_of(&filter, *state).map(|error| {
            let mut moved = filter.clone();
            moved.state = shifted(&filter.state, &error);
            measurement.predict(&moved).z
        });
        let numeric = (less - more) / (2.0 * SMALL);
        let derivative = prediction.derivative::<M, 1>(*state);
        let off = numeric.iter().zip(&derivative).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(numeric.len() == M && off < 1e-6, "{}: {numeric} {derivative}", state.start());
    }
}

#[test]
fn the_jacobian_of_each_sensor_is_its_derivative() {
    let mut random = Random::new(4);
    for _ in 0..5 {
        let mut layout = layout();
        let magnetometer = Magnetometer::claim(&mut layout);
        let acceleration = layout.claim(Role::Estimated, [1.0; 3]);
        let bias = layout.claim(Role::Estimated, [1.0; 3]);
        let offset = layout.claim(Role::Considered, [0.1; 3]);
        let all = states(&[magnetometer.disturbance, acceleration, bias, offset]);
        let start = anywhere(&mut random, &layout, &all);
        let mut vector = |size: f64| Vector3::from(random.normals(size));
        assert_jacobian::<3>(
            &start,
            &all,
            &MagneticField {
                sensor: &magnetometer,
                field_ut: vector(40.0),
                reference_ut: vector(40.0),
            },
        );
        assert_jacobian::<3>(
            &start,
            &all,
            &SpecificForce {
                force_mps2: vector(10.0),
                acceleration,
                bias,
                gravity_mps2: 9.8,
                deviation_mps2: 0.05,
            },
        );
        let position_m = vector(3.0);
        assert_jacobian::<3>(
            &start,
            &all,
            &Position { position_m, deviation_m: Vector3::repeat(0.1), lever_arm_m: vector(0.5) },
        );
        assert_jacobian::<1>(&start, &all, &Heading { heading_rad: 0.3, deviation_rad: 0.1 });
        let (block, deviation) = (acceleration, 0.1);
        assert_jacobian::<2>(&start, &all, &VerticalRate { block, deviation });
        for offset in [None, Some(offset)] {
            let (velocity_mps, turning_mps) = (vector(1.0), vector(0.5));
            let deviation_mps = Vector3::repeat(0.1);
            let velocity = Velocity { velocity_mps, deviation_mps, turning_mps, offset };
            assert_jacobian::<3>(&start, &all, &velocity);
        }
    }
}

#[test]
fn a_range_has_its_derivative_with_every_state_of_its_anchor() {
    let mut random = Random::new(5);
    for _ in 0..20 {
        let mut layout = layout();
        let mut errors = RangeErrors::default();
        (errors.scale, errors.position_m) = (0.1, 0.5);
        let position_m = Vector3::from(random.normals(5.0));
        let anchor = Anchor::claim(&mut layout, position_m, &errors);
        let delay = layout.claim(Role::Estimated, [0.1]);
        let mut all = states(&[anchor.offset.unwrap()]);
        let own = [anchor.bias, anchor.scale, anchor.correlated, Some(delay)];
        all.extend(own.into_iter().flatten());
        let range = Range {
            anchor: &anchor,
            range_m: 4.0,
            deviation_m: 0.1,
            lever_arm_m: Vector3::from(random.normals(0.3)),
            delay: Some(delay),
            age_s: 0.02,
        };
        assert_jacobian::<1>(&anywhere(&mut random, &layout, &all), &all, &range);
    }
}

#[test]
fn a_vehicle_has_its_derivatives_while_it_moves_along_its_forward_axis() {
    let mut random = Random::new(15);
    for _ in 0..20 {
        let mut layout = layout();
        let blocks = [(); 3].map(|()| layout.claim(Role::Estimated, [1.0; 3]));
        let ones = [(); 2].map(|()| layout.claim(Role::Estimated, [1.0]));
        let [forward, axle, offset] = blocks;
        let [clock, scale] = ones;
        let mut all = states(&blocks);
        all.extend(ones);
        let mut start = anywhere(&mut random, &layout, &all);
        let mounting = Mounting { forward, axle };
        let rate_rad_s = Vector3::from(random.normals(0.5));
        let fix = Position {
            position_m: Vector3::from(random.normals(3.0)),
            deviation_m: Vector3::new(0.1, f64::INFINITY, 0.1),
            lever_arm_m: Vector3::from(random.normals(0.5)),
        };
        let antenna = Antenna {
            fix,
            offset,
            clock,
            age_s: 0.03,
            rate_rad_s,
            acceleration_mps2: Vector3::from(random.normals(2.0)),
        };
        assert_jacobian::<3>(&start, &all, &antenna);
        let velocity = start.state.get(forward) * 20.0 - rate_rad_s.cross(&start.state.get(axle));
        start.state.set(VELOCITY, start.state.attitude * velocity);
        let constraint =
            NonHolonomic { mounting: &mounting, rate_rad_s, deviation_mps: [0.1, 0.2] };
        assert_jacobian::<2>(&start, &all, &constraint);
        let odometer =
            Odometer { mounting: &mounting, scale, speed_mps: 4.0, deviation_mps: 0.1, rate_rad_s };
        assert_jacobian::<1>(&start, &all, &odometer);
        let direction = Vector3::from(random.normals(1.0));
        let axis = Known { block: forward, value: direction, deviation: [0.1; 3] };
        assert_jacobian::<3>(&start, &all, &axis);
    }
}

#[test]
fn constant_velocity_and_odometry_have_their_derivative() {
    let mut random = Random::new(6);
    let mut layout = layout();
    let errors = OdometryErrors::default();
    let blocks = OdometryBlocks::claim(&mut layout, &errors);
    let ranges = RangeErrors::default();
    let anchors = [Anchor::claim(&mut layout, Vector3::zeros(), &ranges)];
    let mut all = states(&[]);
    all.extend([blocks.scale, blocks.drift, anchors[0].correlated.unwrap()]);
    let mut start = anywhere(&mut random, &layout, &all);
    let free = ConstantVelocity { density: Vector3::new(0.1, 0.2, 0.3), step_s: 0.7 };
    let correlated = CorrelatedErrors { anchors: &anchors, errors: &ranges, step_s: 0.7 };
    let free = (free, correlated);
    let (analytic, numeric) = (transition(&start, &all, &free), numerical_of(&start, &all, &free));
    assert_rows(&analytic, &numeric, 0..N, &all, 1e-8);

    // In the plane.
    start.state.attitude = Rotation3::new(Vector3::z() * 2.0);
    all.retain(|block| block.start() > 1);
    let odometry = Odometry {
        blocks: &blocks,
        errors: &errors,
        distance_m: 0.8,
        rotation_rad: 0.3,
        interval_s: 0.5,
        step_s: 0.2,
    };
    let analytic = transition(&start, &all, &odometry);
    let numeric = numerical_of(&start, &all, &odometry);
    assert_rows(&analytic, &numeric, 0..3, &all, 1e-8);
    // The noise input of half a rotation is of second order. The velocity has no error of its own.
    assert_rows(&analytic, &numeric, 6..N, &all, 1e-3);
}

#[test]
fn without_measurements_the_driven_states_keep_their_variance() {
    let mut layout = layout();
    let blocks = CarriedBlocks::claim(&mut layout, 2.0, 3.0);
    let magnetometer = Magnetometer::claim(&mut layout);
    let mut filter = Filter::new(&layout, Rotation3::identity());
    for _ in 0..1000 {
        let step_s = 0.02;
        let carried = Carried {
            blocks: &blocks,
            acceleration_mps2: 3.0,
            rate_rad_s: 2.0,
            at_rest: false,
            step_s,
        };
        filter.predict(&(carried, magnetometer.step(step_s)));
    }
    let deviation = |block: Block<3>| filter.covariance(block)[(0, 0)].sqrt();
    assert!((deviation(blocks.angular_rate) / 2.0 - 1.0).abs() < 1e-6);
    assert!((deviation(magnetometer.disturbance) / 3.0 - 1.0).abs() < 1e-6);
    // The oscillator is integrated to first order: 20 ms are a sixth of its period over 2π.
    let acceleration = deviation(blocks.acceleration) / 3.0;
    println!("acceleration {acceleration:.3}, velocity {:.3}", deviation(VELOCITY));
    assert!((0.95..1.2).contains(&acceleration), "{acceleration}");
    // Its velocity has the deviation σ/ω₀.
    let velocity = deviation(VELOCITY) * 8.0 / 3.0;
    assert!((0.95..1.2).contains(&velocity), "{velocity}");
    // The random walk of the position adds to the noise of the oscillator: 0.15 m/√s over 20 s.
    let position = filter.covariance(POSITION)[(0, 0)].sqrt();
    assert!((0.6..2.5).contains(&position), "{position}");
    assert!(filter.covariance(ATTITUDE)[(0, 0)].sqrt() > 1.0);
}

#[test]
fn the_noise_of_a_strapdown_step_is_that_of_its_sensors_and_times() {
    let mut layout = layout();
    let mut errors = ImuErrors::default();
    errors.time_s = 0.001;
    let blocks = StrapdownBlocks::claim(&mut layout, &errors);
    let all = states(&[blocks.gyroscope_bias, blocks.accelerometer_bias]);
    let mut filter = Filter::new(&layout, Rotation3::identity());
    certain(&mut filter, &all);
    // An acceleration of 5 m/s².
    filter.predict(&Strapdown {
        blocks: &blocks,
        errors: &errors,
        gravity_mps2: 9.8,
        force_mps2: Vector3::new(3.0, 4.0, 9.8),
        rate_rad_s: Vector3::zeros(),
        step_s: 0.01,
    });
    let variance = |block: Block<3>| filter.covariance(block)[(0, 0)];
    for (found, expected) in [
        (variance(ATTITUDE), 2.5e-4_f64.powi(2) * 0.01),
        (variance(VELOCITY), 0.005_f64.powi(2) * 0.01 + (5.0 * 0.001_f64).powi(2)),
        (variance(POSITION), 0.0),
        (variance(blocks.gyroscope_bias), 2e-4_f64.powi(2) * 0.01),
        (variance(blocks.accelerometer_bias), 3e-4_f64.powi(2) * 0.01),
    ] {
        assert!((found - expected).abs() <= 1e-9 * expected, "{found} and {expected}");
    }
}

/// Eight triads off the plane and the centre, so that centripetal acceleration is in every measured value.
fn array() -> ArraySolver {
    let axes = crate::common::board(0.005, 0.02);
    ArraySolver::of(&axes, |sensor| sensor != 2).unwrap()
}

fn array_states(blocks: &RigidArrayBlocks) -> Vec<Block<1>> {
    let RigidArrayBlocks { bias, z_bias, .. } = *blocks;
    states(&[
        blocks.rate(),
        blocks.acceleration(),
        bias.part::<3, 0>(),
        bias.part::<3, 3>(),
        z_bias.part::<3, 0>(),
        z_bias.part::<3, 3>(),
    ])
}

#[test]
fn transitions_of_an_array_are_those_of_its_steps() {
    let mut random = Random::new(31);
    let solver = array();
    for _ in 0..20 {
        let mut layout = layout();
        let blocks = RigidArrayBlocks::claim(&mut layout, [1.0, 1.0], 0.01);
        let all = array_states(&blocks);
        let filter = anywhere(&mut random, &layout, &all);
        let rotation = RigidArray {
            blocks: &blocks,
            solver: &solver,
            acceleration_walk: 3.0,
            rate_walk: 0.1,
            bias_decay: 0.9,
            bias_variance: 0.01,
            common_variance: 0.0,
            step_s: 1e-3,
        };
        let f = transition(&filter, &all, &rotation);
        assert_rows(&f, &numerical_of(&filter, &all, &rotation), 0..30, &all, 2e-6);
        let linear = Linear {
            theta: nalgebra::Vector6::from_fn(|_, _| 3.0 * random.normal()),
            ..Linear::default()
        };
        let force = ArrayForce {
            blocks: &blocks,
            solver: &solver,
            linear: &linear,
            gravity_mps2: 9.8,
            noise_factor: 1.0,
            force_variance: 0.1,
            step_s: 1e-3,
            attitude_covariance: nalgebra::Matrix3::zeros(),
        };
        let f = transition(&filter, &all, &force);
        // The position is of second order in the step.
        assert_rows(&f, &numerical_of(&filter, &all, &force), 0..30, &all, 2e-5);
    }
}

#[test]
fn the_jacobian_of_a_reduced_sample_is_its_derivative() {
    let mut random = Random::new(32);
    let solver = array();
    for _ in 0..20 {
        let mut layout = layout();
        let blocks = RigidArrayBlocks::claim(&mut layout, [1.0, 1.0], 0.01);
        let all = array_states(&blocks);
        let filter = anywhere(&mut random, &layout, &all);
        let linear = Linear::default();
        let at = |state: &State| {
            let mut filter = filter.clone();
            filter.state = state.clone();
            let sample = ReducedArray {
                blocks: &blocks,
                solver: &solver,
                linear: &linear,
                noise: ArrayNoise { factor: 1.0, fast: 1.0 },
                at_rad_s: state.get(blocks.rate()),
            };
            sample.predict(&filter)
        };
        let prediction = at(&filter.state);
        for state in &all {
            let [more, less] =
                errors_of(&filter, *state).map(|error| at(&shifted(&filter.state, &error)).z);
            let change = (less - more) / (2.0 * SMALL);
            let derivative = prediction.derivative::<9, 1>(*state);
            let off = (change - derivative).abs().max();
            assert!(off < 1e-4, "{state:?}: {off:e}");
        }
        // Errors of the lever arms: the sensors show ω + |ω| e.
        let rate = filter.state.get(blocks.rate());
        for axis in 0..3 {
            let shown = |by: f64| {
                let mut shown = rate;
                shown[axis] += by * rate.norm();
                solver.expected_z(&shown).0
            };
            let (more, less) = (shown(SMALL), shown(-SMALL));
            for k in 0..6 {
                let slope = (more[k] - less[k]) / (2.0 * SMALL);
                let off =
                    (slope - prediction.derivative::<9, 3>(blocks.lever)[(3 + k, axis)]).abs();
                assert!(off < 1e-4, "{k} {axis}: {off:e}");
            }
        }
        let zero = Known::zero(blocks.rotation, [0.1; 6]);
        assert_eq!(zero.predict(&filter).z, -filter.state.get(blocks.rotation));
    }
}

#[test]
fn relative_motion_and_its_joint_have_their_derivative() {
    let mut random = Random::new(11);
    for _ in 0..5 {
        let mut layout = layout();
        let errors = ImuErrors::default();
        let blocks = RelativeBlocks::claim(&mut layout, &errors);
        let mut claim = || layout.claim(Role::Estimated, [1.0; 3]);
        let lever_arms = [claim(), claim()];
        let estimated = [blocks.gyroscope_bias, blocks.accelerometer_bias, lever_arms].concat();
        let all = states(&estimated);
        let start = anywhere(&mut random, &layout, &all);
        let mut vector = |size: f64| Vector3::from(random.normals(size));
        // The derivative is to first order in the step.
        let step_s = 1e-4;
        let process = Relative {
            step_s,
            force_mps2: [vector(10.0), vector(10.0)],
            rate_rad_s: [vector(2.0), vector(2.0)],
            blocks: &blocks,
            errors: &errors,
        };
        let f = transition(&start, &all, &process);
        let numeric = numerical_of(&start, &all, &process);
        assert_rows(&f, &numeric, 0..21, &all, 30.0 * step_s * step_s * 10.0);
        // A scale error is a bias that is proportional to the rate.
        let scales = blocks.gyroscope_scale.map(three).concat();
        let both = [all.clone(), scales].concat();
        let f = transition(&start, &both, &process);
        for (unit, scale) in blocks.gyroscope_scale.into_iter().enumerate() {
            let bias = blocks.gyroscope_bias[unit];
            let rate = process.rate_rad_s[unit] - start.state.get(bias);
            for axis in 0..3 {
                let by = |block: Block<3>| {
                    f.column(block.start() + axis).fixed_rows::<9>(0).into_owned()
                };
                let off = by(scale) - by(bias) * rate[axis];
                assert!(off.norm() < 1e-12, "{off}");
            }
        }
        let deviation_m = 0.01;
        assert_jacobian::<3>(&start, &all, &CommonPoint { lever_arms, deviation_m });
        // The axis of the first unit also chooses the components: only the second's is free here.
        let mut start = start;
        let axis = vector(1.0).normalize();
        start.state.set(lever_arms[0], axis);
        start.state.set(lever_arms[1], start.state.attitude.inverse() * axis);
        let hinge = CommonAxis { axes: lever_arms, deviation_rad: 0.01 };
        assert_jacobian::<2>(&start, &all, &hinge);
    }
}
