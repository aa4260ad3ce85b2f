//! The update, its test, and considered states.

use crate::common;

use common::Random;
use common::states::{covariance, nine, states};
use common::travel::{Errors, Travel};
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Rotation3, SMatrix, SVector, Vector2, Vector3};
use wimu_nav::consistency::Consistency;
use wimu_nav::filter::{Filter, Gate, chi_square_quantile};
use wimu_nav::process::{ImuErrors, Strapdown, StrapdownBlocks, Unmeasured};
use wimu_nav::sensor::{Measurement, Position, Prediction, SpecificForce, Velocity, recover};
use wimu_nav::state::{ATTITUDE, Block, Layout, POSITION, Role, VELOCITY};
use wimu_testkit::{Coverage, assert_median_can_be, draws};

/// Two numbers that depend linearly on the states.
struct Linear(Prediction);

impl Measurement for Linear {
    fn predict(&self, _: &Filter) -> Prediction {
        self.0.clone()
    }
}

impl Linear {
    fn random(random: &mut Random, blocks: &[Block<3>]) -> Self {
        let root = Matrix2::from_fn(|_, _| random.normal());
        let innovation = Vector2::from_fn(|_, _| 0.01 * random.normal());
        let noise = root * root.transpose() + Matrix2::identity() * 0.1;
        let prediction = Prediction::new(innovation, noise);
        Self(blocks.iter().fold(prediction, |prediction, block| {
            prediction.by(*block, Matrix2x3::from_fn(|_, _| random.normal()))
        }))
    }

    fn h(&self, states: &[Block<1>]) -> SMatrix<f64, 2, N> {
        let mut h = SMatrix::<f64, 2, N>::zeros();
        for state in states {
            h.set_column(state.start(), &self.0.derivative::<2, 1>(*state));
        }
        h
    }

    fn z(&self) -> Vector2<f64> {
        Vector2::from_column_slice(self.0.z.as_slice())
    }

    fn r(&self) -> Matrix2<f64> {
        Matrix2::from_column_slice(self.0.r.as_slice())
    }
}

/// States of the filters of these tests.
const N: usize = 12;

/// A filter with correlations between all states: the last block is estimated or considered.
fn correlated(random: &mut Random, role: Role) -> (Filter, Block<3>, Vec<Block<1>>) {
    let mut layout = Layout::new([0.1, 0.2, 0.3], 1.5, 3.0);
    let block = layout.claim(Role::Estimated, [0.5; 3]);
    let mut correlations = Filter::new(&layout, Rotation3::identity());
    let blocks = [ATTITUDE, VELOCITY, POSITION, block];
    for _ in 0..3 {
        correlations.update(&Linear::random(random, &blocks), Gate::Open);
    }
    if role == Role::Estimated {
        return (correlations, block, states(&[block]));
    }
    // The same with a considered block: correlated by updates of the other states.
    let mut layout = Layout::new([0.1, 0.2, 0.3], 1.5, 3.0);
    let block = layout.claim(Role::Considered, [0.5; 3]);
    let mut filter = Filter::new(&layout, Rotation3::identity());
    for _ in 0..3 {
        filter.update(&Linear::random(random, &blocks), Gate::Open);
    }
    (filter, block, states(&[block]))
}

#[test]
fn an_update_without_considered_states_is_that_of_the_textbook() {
    let mut random = Random::new(11);
    for _ in 0..20 {
        let (mut filter, block, all) = correlated(&mut random, Role::Estimated);
        let blocks = [ATTITUDE, VELOCITY, POSITION, block];
        let linear = Linear::random(&mut random, &blocks);
        let (p, h) = (covariance::<N>(&filter, &all), linear.h(&all));
        let s = h * p * h.transpose() + linear.r();
        let inverse = s.try_inverse().unwrap();
        let gain = p * h.transpose() * inverse;
        let expected = p - gain * h * p;
        let before = filter.state.clone();
        let innovation = filter.update(&linear, Gate::Open);

        assert!((covariance::<N>(&filter, &all) - expected).norm() < 1e-12 * p.norm());
        let error = common::states::difference(&filter.state, &before);
        assert!((error - gain * linear.z()).norm() < 1e-6);
        let statistic = linear.z().dot(&(inverse * linear.z()));
        assert!((innovation.statistic - statistic).abs() < 1e-12 * (1.0 + statistic));
        let normal = s.determinant().ln() + 2.0 * std::f64::consts::TAU.ln();
        assert!((innovation.log_likelihood + 0.5 * (statistic + normal)).abs() < 1e-9);
        assert!(innovation.accepted && innovation.dof == 2);
    }
}

#[test]
fn an_update_leaves_considered_states_alone_and_keeps_the_joseph_form() {
    let mut random = Random::new(12);
    for _ in 0..20 {
        let (mut filter, block, all) = correlated(&mut random, Role::Considered);
        let blocks = [ATTITUDE, VELOCITY, POSITION, block];
        let linear = Linear::random(&mut random, &blocks);
        let (p, h) = (covariance::<N>(&filter, &all), linear.h(&all));
        let correlation = filter.cross_covariance(VELOCITY, block);
        let s = h * p * h.transpose() + linear.r();
        let mut gain = p * h.transpose() * s.try_inverse().unwrap();
        gain.fixed_rows_mut::<3>(block.start()).fill(0.0);
        let rest = SMatrix::<f64, 12, 12>::identity() - gain * h;
        let expected = rest * p * rest.transpose() + gain * linear.r() * gain.transpose();
        filter.update(&linear, Gate::Open);

        let after = covariance::<N>(&filter, &all);
        assert!((after - expected).norm() < 1e-12 * p.norm());
        assert_eq!(filter.state.get(block), Vector3::zeros());
        let own = filter.covariance(block) - Matrix3::from_diagonal_element(0.25);
        assert!(own.norm() < 1e-15, "{own}");
        assert!((filter.cross_covariance(VELOCITY, block) - correlation).norm() > 1e-4);
        assert!(after.symmetric_eigenvalues().min() > -1e-12);
    }
}

#[test]
fn a_measurement_beyond_its_gate_changes_nothing() {
    let layout = Layout::new([0.1; 3], 1.0, 1.0);
    let mut filter = Filter::new(&layout, Rotation3::identity());
    let fix = |x: f64| Position {
        position_m: Vector3::new(x, 0.0, 0.0),
        deviation_m: Vector3::repeat(1.0),
        lever_arm_m: Vector3::zeros(),
    };
    // The variance of the innovation is 2 m²: 16.27 is reached at 5.70 m.
    for (x, accepted) in [(5.6, true), (5.85, false)] {
        let mut filter = filter.clone();
        assert_eq!(filter.update(&fix(x), Gate::ChiSquare).accepted, accepted);
        assert_eq!(filter.state.get(POSITION).x != 0.0, accepted);
        assert_eq!(filter.covariance(POSITION)[(0, 0)] < 0.9, accepted);
    }
    assert!(filter.update(&fix(100.0), Gate::Open).accepted);
    assert!((filter.state.get(POSITION).x - 50.0).abs() < 1e-9);
    // A number that is not finite passes no gate.
    for gate in [Gate::Open, Gate::ChiSquare] {
        let before = filter.state.vector.clone();
        assert!(!filter.update(&fix(f64::NAN), gate).accepted);
        assert_eq!(filter.state.vector, before);
    }
}

#[test]
fn the_quantile_is_that_of_chi_square() {
    // M. Abramowitz and I. Stegun, "Handbook of Mathematical Functions", table 26.8, Q = 0.001.
    for (dof, quantile) in [
        (1, 10.828),
        (2, 13.816),
        (3, 16.266),
        (4, 18.467),
        (6, 22.458),
        (10, 29.588),
        (20, 45.315),
        (30, 59.703),
    ] {
        let ratio = chi_square_quantile(dof) / quantile;
        let limit = if dof == 1 { 0.031 } else { 0.025 };
        assert!((ratio - 1.0).abs() < limit, "{dof}: {ratio}");
    }
}

#[test]
fn a_recovery_widens_what_moves_and_keeps_the_correlations() {
    let mut random = Random::new(13);
    let (mut layout, errors) = (Layout::new([0.02; 3], 0.1, 0.1), ImuErrors::default());
    let blocks = StrapdownBlocks::claim(&mut layout, &errors);
    let all = states(&[blocks.gyroscope_bias, blocks.accelerometer_bias]);
    let mut filter = Filter::new(&layout, Rotation3::identity());
    for _ in 0..100 {
        filter.predict(&Strapdown {
            blocks: &blocks,
            errors: &errors,
            gravity_mps2: 9.8,
            force_mps2: Vector3::new(0.0, 0.0, 9.8) + Vector3::from(random.normals(1.0)),
            rate_rad_s: Vector3::from(random.normals(1.0)),
            step_s: 0.01,
        });
    }
    let zero = Velocity::zero(0.01, None);
    let mut consistent = filter.clone();
    let speed = Vector3::new(8.0, 0.0, 0.0);
    filter.state.set(VELOCITY, speed);
    assert!(!filter.test(&zero).accepted);
    let factor = filter.test(&zero).statistic / 3.0;
    let bias = filter.covariance(blocks.accelerometer_bias);

    // The recovery is that update of a filter with the wider covariance.
    let scale = |p: SMatrix<f64, 15, 15>| {
        SMatrix::<f64, 15, 15>::from_fn(|r, c| {
            let root = |k: usize| if k < 12 { factor.sqrt() } else { 1.0 };
            p[(r, c)] * root(r) * root(c)
        })
    };
    let p = scale(covariance(&filter, &all));
    recover(&mut filter, &zero, blocks.gyroscope_bias);
    let h = SMatrix::<f64, 3, 15>::from_fn(|r, c| f64::from(u8::from(c == r + 3)));
    let s = h * p * h.transpose() + Matrix3::identity() * 1e-4;
    let expected = p - p * h.transpose() * s.try_inverse().unwrap() * h * p;
    assert!((covariance(&filter, &all) - expected).norm() < 1e-9 * p.norm());
    assert!(filter.state.get(VELOCITY).norm() < 0.1, "the rest is accepted");
    assert!(filter.covariance(blocks.accelerometer_bias).norm() <= bias.norm());
    consistent.update(&zero, Gate::Open);
    assert!(filter.covariance(ATTITUDE).norm() > 10.0 * consistent.covariance(ATTITUDE).norm());
}

/// NEES of velocity and position of a strapdown filter whose unit has drawn errors, with and without considered states.
fn strapdown_nees(seed: u64, consider: bool) -> [f64; 2] {
    let mut random = Random::new(seed);
    let mut errors = ImuErrors::default();
    errors.accelerometer_bias = 0.01;
    errors.gyroscope_bias = 0.001;
    errors.accelerometer_matrix = [0.01, 0.005];
    let tilt = 0.002;
    let mut layout = Layout::new([tilt; 3], 1e-3, 1e-4);
    let mut blocks = StrapdownBlocks::claim(&mut layout, &errors);
    if consider {
        blocks = blocks.consider(&mut layout, &errors, Role::Considered);
    }
    let travel = Travel::tumbling(&mut random);
    let drawn = Errors::drawn(&errors, &mut random);
    let samples = travel.samples(50.0, 3.0, &drawn, &mut random);
    let off = Rotation3::new(Vector3::from(random.normals(tilt)));
    let mut filter = Filter::new(&layout, off * travel.attitude(0.0));
    for pair in samples.windows(2) {
        filter.predict(&Strapdown {
            blocks: &blocks,
            errors: &errors,
            gravity_mps2: wimu_nav::GRAVITY_MPS2,
            force_mps2: (pair[0].force_mps2 + pair[1].force_mps2) * 0.5,
            rate_rad_s: (pair[0].rate_rad_s.unwrap() + pair[1].rate_rad_s.unwrap()) * 0.5,
            step_s: pair[1].step_s,
        });
    }
    let nees = |block: Block<3>, truth: Vector3<f64>| {
        let error = filter.state.get(block) - truth;
        error.dot(&(filter.covariance(block).try_inverse().unwrap() * error))
    };
    [nees(VELOCITY, travel.velocity(3.0)), nees(POSITION, travel.position(3.0))]
}

#[test]
fn considered_states_make_the_filter_consistent_and_without_them_it_is_overconfident() {
    let draws = draws(2000, 3) as u64;
    for state in [0, 1] {
        let with: Vec<f64> = (0..draws).map(|k| strapdown_nees(k, true)[state]).collect();
        let without: Vec<f64> = (0..draws).map(|k| strapdown_nees(k, false)[state]).collect();
        let below = |all: &[f64]| all.iter().map(|n| *n < 7.815).collect::<Coverage>();
        let (with_below, without_below) = (below(&with), below(&without));
        println!("within 95 %: considered {with_below}, not considered {without_below}");
        with_below.assert_can_be(0.93..=0.97, "considered");
        without_below.assert_can_be(0.0..=0.6, "not considered");
        // The median of χ² with three degrees of freedom.
        assert_median_can_be(&with, 0.75 * 2.366..=1.33 * 2.366, "NEES");
    }
}

/// A filter whose attitude and one more vector are uncertain and correlated.
fn tilted(random: &mut Random) -> (Filter, Block<3>, Block<3>) {
    let mut layout = Layout::new([0.15, 0.2, 0.1], 1.0, 1.0);
    let vector = layout.claim(Role::Estimated, [1.0; 3]);
    let bias = layout.claim(Role::Estimated, [0.1; 3]);
    let attitude = Rotation3::new(Vector3::from(random.normals(1.0)));
    let mut filter = Filter::new(&layout, attitude);
    filter.state.set(vector, Vector3::from(random.normals(2.0)));
    let by_attitude = Matrix2x3::from_fn(|_, _| 5.0 * random.normal());
    let by_vector = Matrix2x3::from_fn(|_, _| random.normal());
    let prediction = Prediction::new(Vector2::zeros(), Matrix2::identity() * 0.1);
    let linear = Linear(prediction.by(ATTITUDE, by_attitude).by(vector, by_vector));
    filter.update(&linear, Gate::Open);
    (filter, vector, bias)
}

#[test]
fn the_second_order_mean_is_that_of_random_draws() {
    let mut random = Random::new(14);
    for _ in 0..4 {
        let (filter, acceleration, bias) = tilted(&mut random);
        let reading = SpecificForce {
            force_mps2: Vector3::zeros(),
            acceleration,
            bias,
            gravity_mps2: 9.8,
            deviation_mps2: 0.05,
        };
        let mut certain = filter.clone();
        common::states::certain(&mut certain, &states(&[acceleration, bias]));
        let shown =
            |filter: &Filter| -Vector3::from_column_slice(reading.predict(filter).z.as_slice());
        let first = shown(&certain);
        let second = shown(&filter) - first;

        let mut joint = SMatrix::<f64, 6, 6>::zeros();
        let blocks = [ATTITUDE, acceleration];
        for (i, row) in blocks.iter().enumerate() {
            for (j, column) in blocks.iter().enumerate() {
                let part = filter.cross_covariance(*row, *column);
                joint.fixed_view_mut::<3, 3>(3 * i, 3 * j).copy_from(&part);
            }
        }
        let root = joint.cholesky().unwrap().unpack();
        let (mut sum, mut squares) = (Vector3::zeros(), Vector3::zeros());
        let draws = 40_000;
        for _ in 0..draws {
            let draw = root * SVector::<f64, 6>::from_fn(|_, _| random.normal());
            // Both signs: the terms of first order cancel.
            let value = [1.0, -1.0].map(|sign| {
                let rotation = Rotation3::new(draw.fixed_rows::<3>(0) * -sign);
                let force = filter.state.get(acceleration) + Vector3::z() * 9.8;
                let turned = rotation * (force + draw.fixed_rows::<3>(3) * sign);
                filter.state.attitude.inverse() * turned - first
            });
            let mean = (value[0] + value[1]) * 0.5;
            sum += mean;
            squares += mean.component_mul(&mean);
        }
        let mean = sum / f64::from(draws);
        let error = ((squares / f64::from(draws)).sum() / f64::from(draws)).sqrt();
        let off = (mean - second).norm();
        // Terms of fourth order are 3 % at these tilts.
        assert!(off < 4.0 * error + 0.03 * second.norm(), "{mean} and {second}, ± {error}");
        assert!(second.norm() > 0.1, "{second}");
    }
}

#[test]
fn nine_states_of_a_sensor_matrix_are_those_of_its_rows() {
    let mut layout = Layout::new([0.1; 3], 1.0, 1.0);
    let mut errors = ImuErrors::default();
    errors.accelerometer_matrix = [0.01, 0.002];
    let blocks = StrapdownBlocks::claim(&mut layout, &errors);
    let considered = blocks.consider(&mut layout, &errors, Role::Considered);
    let filter = Filter::new(&layout, Rotation3::identity());
    for (k, state) in nine(considered.accelerometer_matrix.unwrap()).into_iter().enumerate() {
        let expected = if k / 3 == k % 3 { 0.01 } else { 0.002 };
        assert!((filter.covariance(state)[(0, 0)].sqrt() - expected).abs() < 1e-12);
    }
}

#[test]
fn steps_without_samples_are_as_uncertain_as_one_of_their_length() {
    let variances = |steps: u32| {
        let layout = Layout::new([0.0; 3], 0.0, 0.0);
        let mut filter = Filter::new(&layout, Rotation3::identity());
        let step_s = 1.0 / f64::from(steps);
        for k in 0..steps {
            filter.predict(&Unmeasured { step_s, since_s: f64::from(k) * step_s });
        }
        [ATTITUDE, VELOCITY].map(|block| filter.covariance::<3>(block)[(0, 0)])
    };
    let (one, hundred) = (variances(1), variances(100));
    assert_eq!(one, [4.0, 25.0]);
    assert!(one.iter().zip(&hundred).all(|(a, b)| (a - b).abs() < 1e-9 * a));
}

/// Squares of 3 normal numbers, times a factor.
fn innovation(random: &mut Random, factor: f64) -> f64 {
    factor * (0..3).map(|_| random.normal().powi(2)).sum::<f64>()
}

#[test]
fn the_variance_factor_is_one_by_chance_and_that_of_a_fault() {
    let mut random = Random::new(1);
    let mut false_alarms = 0;
    for _ in 0..20_000 {
        let mut found = Consistency::new();
        for _ in 0..20 {
            found.see(innovation(&mut random, 1.0), 3);
        }
        false_alarms += u32::from(found.variance_factor() > 1.0);
        // One sensor's noise is 30 times as large, or one innovation is.
        let mut noisy = found;
        (0..20).for_each(|_| noisy.see(innovation(&mut random, 900.0), 3));
        assert!((200.0..20_000.0).contains(&noisy.variance_factor()));
        found.see(900.0, 3);
        assert_eq!(found.variance_factor(), 300.0);
    }
    // Expected 2 · 10⁻⁴ · 20,000 = 4; more than 17 have a probability of 10⁻⁶.
    assert!(false_alarms <= 17, "{false_alarms}");
}
