//! The smoother: against least squares, and its covariance against the truth.

use crate::common;

use common::Random;
use common::navigated::ALIGNMENT;
use common::states::states;
use common::travel::{Errors, Travel};
use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};
use wimu_nav::filter::{Filter, Gate};
use wimu_nav::navigator::{Motion, Navigator, Settings, Start};
use wimu_nav::process::{Process, Transition};
use wimu_nav::sensor::{Measurement, Prediction};
use wimu_nav::smoother::{Epoch, Log, Smoothed};
use wimu_nav::state::{Block, Layout, POSITION, Role, State, VELOCITY};
use wimu_testkit::{Coverage, Lane, assert_median_can_be, draws};

/// Velocity and position of a body that is pushed by white noise, and a bias of the velocity sensor.
const STATES: usize = 12;
const STEP_S: f64 = 0.1;

struct Pushed;
impl Process for Pushed {
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        state.set(POSITION, state.get(POSITION) + state.get(VELOCITY) * STEP_S);
        transition.add(POSITION, VELOCITY, Matrix3::identity() * STEP_S);
        transition.add_noise(VELOCITY, 0.2 * STEP_S);
    }
}

/// The velocity plus a bias, or the position.
struct Shown {
    value: Vector3<f64>,
    blocks: [Option<Block<3>>; 2],
    deviation: f64,
}
impl Measurement for Shown {
    fn predict(&self, filter: &Filter) -> Prediction {
        let blocks = || self.blocks.iter().flatten();
        let one = Matrix3::identity();
        let shown: Vector3<f64> = blocks().map(|block| filter.state.get(*block)).sum();
        let prediction = Prediction::new(self.value - shown, one * self.deviation.powi(2));
        blocks().fold(prediction, |prediction, block| prediction.by(*block, one))
    }
}

/// A journey of the body: the truth at each step, and what the filter and the log make of it.
struct Journey {
    truth: Vec<SVector<f64, STATES>>,
    filtered: Vec<(SVector<f64, STATES>, SMatrix<f64, STATES, STATES>)>,
    measurements: Vec<Shown>,
    epochs: Vec<Epoch>,
    bias: Block<3>,
}

impl Journey {
    fn new(random: &mut Random, role: Role, steps: usize) -> Self {
        let mut layout = Layout::new([0.1; 3], 0.5, 1.0);
        let bias = layout.claim(role, [0.3; 3]);
        let mut filter = Filter::new(&layout, Rotation3::identity());
        filter.record(Log::new(10.0));
        let mut truth = SVector::<f64, STATES>::zeros();
        for (block, deviation) in [(VELOCITY, 0.5), (POSITION, 1.0), (bias, 0.3)] {
            let drawn = Vector3::from(random.normals(deviation));
            truth.fixed_rows_mut::<3>(block.start()).copy_from(&drawn);
        }
        let all = states(&[bias]);
        let mut journey = Self {
            truth: Vec::new(),
            filtered: Vec::new(),
            measurements: Vec::new(),
            epochs: Vec::new(),
            bias,
        };
        for k in 0..steps {
            let v = truth.fixed_rows::<3>(VELOCITY.start()).into_owned();
            let mut position = truth.fixed_rows_mut::<3>(POSITION.start());
            position += v * STEP_S;
            let mut velocity = truth.fixed_rows_mut::<3>(VELOCITY.start());
            velocity += Vector3::from(random.normals((0.2 * STEP_S).sqrt()));
            filter.predict(&Pushed);
            let (blocks, deviation) = if k % 7 == 3 {
                ([Some(POSITION), None], 0.2)
            } else {
                ([Some(VELOCITY), Some(bias)], 0.1)
            };
            let shown: Vector3<f64> = blocks
                .iter()
                .flatten()
                .map(|block| truth.fixed_rows::<3>(block.start()).into_owned())
                .sum();
            let value = shown + Vector3::from(random.normals(deviation));
            let shown = Shown { value, blocks, deviation };
            filter.update(&shown, Gate::Open);
            filter.end_step(STEP_S);
            let covariance = common::states::covariance(&filter, &all);
            journey.truth.push(truth);
            let state = SVector::from_column_slice(filter.state.vector.as_slice());
            journey.filtered.push((state, covariance));
            journey.measurements.push(shown);
        }
        journey.epochs = std::mem::take(&mut filter.log_mut().unwrap().epochs);
        journey
    }
}

/// State of the journey by least squares over all steps, with its covariance.
fn least_squares(journey: &Journey) -> (Vec<f64>, Vec<Vec<f64>>) {
    let steps = journey.measurements.len();
    let size = STATES * (steps + 1);
    let mut information = vec![vec![0.0; size]; size];
    let mut vector = vec![0.0; size];
    let mut add = |row: &[(usize, f64)], value: f64, variance: f64| {
        for (i, a) in row {
            vector[*i] += a * value / variance;
            for (j, b) in row {
                information[*i][*j] += a * b / variance;
            }
        }
    };
    for axis in 0..3 {
        let prior = [(0, 0.01), (VELOCITY.start(), 0.25), (POSITION.start(), 1.0)];
        for (start, variance) in prior.into_iter().chain([(journey.bias.start(), 0.09)]) {
            add(&[(start + axis, 1.0)], 0.0, variance);
        }
    }
    for (k, shown) in journey.measurements.iter().enumerate() {
        let (before, now) = (STATES * k, STATES * (k + 1));
        for state in 0..STATES {
            let velocity = VELOCITY.start()..POSITION.start();
            let position = POSITION.start()..POSITION.start() + 3;
            let mut row = vec![(now + state, 1.0), (before + state, -1.0)];
            if position.contains(&state) {
                row.push((before + state - 3, -STEP_S));
            }
            let variance = if velocity.contains(&state) { 0.2 * STEP_S } else { 1e-10 };
            add(&row, 0.0, variance);
        }
        for axis in 0..3 {
            let row: Vec<(usize, f64)> = shown
                .blocks
                .iter()
                .flatten()
                .map(|block| (now + block.start() + axis, 1.0))
                .collect();
            add(&row, shown.value[axis], shown.deviation.powi(2));
        }
    }
    let covariance = inverse(information);
    let dot = |row: &Vec<f64>| row.iter().zip(&vector).map(|(a, b)| a * b).sum();
    (covariance.iter().map(dot).collect(), covariance)
}

/// Gauss–Jordan elimination of a matrix that is positive definite.
fn inverse(mut matrix: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    for pivot in 0..matrix.len() {
        let factor = 1.0 / matrix[pivot][pivot];
        matrix[pivot][pivot] = 1.0;
        matrix[pivot].iter_mut().for_each(|x| *x *= factor);
        let row = matrix[pivot].clone();
        for (_, other) in matrix.iter_mut().enumerate().filter(|(k, _)| *k != pivot) {
            let factor = std::mem::take(&mut other[pivot]);
            for (x, y) in other.iter_mut().zip(&row) {
                *x -= factor * y;
            }
        }
    }
    matrix
}

#[test]
fn without_considered_states_it_is_least_squares_over_the_whole_journey() {
    let mut random = Random::new(5);
    let mut journey = Journey::new(&mut random, Role::Estimated, 20);
    let (expected, covariance) = least_squares(&journey);
    let exact = |i: usize, j: usize| Matrix3::from_fn(|r, c| covariance[i + r][j + c]);
    let smoothed = Smoothed::of(&mut journey.epochs);
    assert_eq!(smoothed.contradictions(), 0);
    for k in 0..20 {
        for block in [VELOCITY, POSITION, journey.bias] {
            let at = STATES * (k + 1) + block.start();
            let exact = exact(at, at);
            let found = smoothed.covariance(k + 1, block);
            assert!((found - exact).norm() < 2e-3 * exact.norm(), "{k}: {found} {exact}");
            let filtered = journey.filtered[k].0.fixed_rows::<3>(block.start()).into_owned();
            let error = filtered + smoothed.corrections(k + 1, block)[1]
                - Vector3::from_column_slice(&expected[at..at + 3]);
            assert!(error.norm() < 0.01 * exact.norm().sqrt(), "{k}: {error}");
        }
    }
    // Of a change, with the covariance between two times.
    let at = |k: usize| STATES * k + POSITION.start();
    let of = |i: usize, j: usize| exact(at(i), at(j));
    let exact = of(4, 4) + of(15, 15) - of(4, 15) - of(15, 4);
    let found = smoothed.covariance_of_change(4, 15, POSITION).unwrap();
    assert!((found - exact).norm() < 2e-3 * exact.norm(), "{found} {exact}");
    assert!(found.norm() < 0.7 * of(15, 15).norm() + of(4, 4).norm());
}

#[test]
fn a_considered_state_stays_and_the_covariance_is_right_and_never_larger_than_that_of_the_filter() {
    let mut random = Random::new(6);
    let count = draws(2000, 9);
    let [mut inside, mut change, mut filtered] = [Coverage::default(); 3];
    let (mut smaller, mut sum) = (0.0, 0.0);
    for _ in 0..count {
        let mut journey = Journey::new(&mut random, Role::Considered, 20);
        let smoothed = Smoothed::of(&mut journey.epochs);
        let error = |k: usize| -> Vector3<f64> {
            let filtered = journey.filtered[k].0 - journey.truth[k];
            let filtered = filtered.fixed_rows::<3>(POSITION.start()).into_owned();
            filtered + smoothed.corrections(k + 1, POSITION)[1]
        };
        let nees = |e: Vector3<f64>, p: Matrix3<f64>| e.dot(&(p.try_inverse().unwrap() * e));
        for k in [0, 6, 12] {
            inside.count(nees(error(k), smoothed.covariance(k + 1, POSITION)) < 7.815);
            let p = journey.filtered[k].1.fixed_view::<3, 3>(6, 6).into_owned();
            let e = (journey.filtered[k].0 - journey.truth[k]).fixed_rows::<3>(6).into_owned();
            filtered.count(nees(e, p) < 7.815);
            let found = smoothed.covariance(k + 1, POSITION);
            assert!(found.trace() <= p.trace() * (1.0 + 1e-9), "{k}: {found} {p}");
            smaller += found.trace();
            sum += p.trace();
            assert_eq!(smoothed.covariance(k + 1, journey.bias), Matrix3::identity() * 0.09);
            assert_eq!(smoothed.corrections(k + 1, journey.bias)[1].norm(), 0.0);
        }
        let moved = smoothed.covariance_of_change(2, 11, POSITION).unwrap();
        change.count(nees(error(10) - error(1), moved) < 7.815);
    }
    assert!(smaller < 0.8 * sum, "{smaller} {sum}");
    for coverage in [inside, change, filtered] {
        coverage.assert_can_be(0.94..=0.96, "NEES below its 95 % point");
    }
}

/// A navigator's error of the position and its covariance at times, s: filtered, and smoothed.
struct Found {
    filtered: Vec<(Vector3<f64>, Matrix3<f64>)>,
    smoothed: Vec<(Vector3<f64>, Matrix3<f64>)>,
    contradictions: usize,
}

fn journey(
    motion: Motion,
    travel: &Travel,
    times_s: [f64; 3],
    kick_s: [f64; 2],
    seed: u64,
) -> Found {
    let mut random = Random::new(seed * 7919 + 23);
    let mut settings = Settings::default();
    settings.motion = motion;
    let errors = Errors::drawn(&settings.errors, &mut random);
    let mut samples = travel.samples(100.0, 12.0, &errors, &mut random);
    let start = Start::align(&samples[..ALIGNMENT], true).unwrap();
    let mut navigator = Navigator::new(settings, &start);
    let x = travel.attitude(0.0) * Vector3::x();
    navigator.set_heading(x.y.atan2(x.x));
    navigator.record(Log::new(0.1));
    let mut found = Found { filtered: Vec::new(), smoothed: Vec::new(), contradictions: 0 };
    let mut epochs_at = Vec::new();
    for (k, sample) in samples.iter_mut().enumerate() {
        let t = k as f64 * 0.01;
        if t > kick_s[0] && t < kick_s[1] {
            sample.rate_rad_s = sample.rate_rad_s.map(|rate| rate + Vector3::x());
        }
        navigator.push(sample, travel.at_rest(t)).unwrap();
        let due = times_s.iter().any(|time| (t - time).abs() < 1e-6);
        if due {
            let error = navigator.filter().state.get(POSITION) - travel.position(t);
            found.filtered.push((error, navigator.filter().covariance(POSITION)));
            epochs_at.push(navigator.log_mut().unwrap().epochs.len() - 1);
        }
    }
    let mut epochs = std::mem::take(&mut navigator.log_mut().unwrap().epochs);
    let smoothed = Smoothed::of(&mut epochs);
    for ((error, _), epoch) in found.filtered.iter().zip(epochs_at) {
        // The correction is that of an epoch of up to 0.1 s before.
        let correction = smoothed.corrections(epoch, POSITION)[1];
        found.smoothed.push((error + correction, smoothed.covariance(epoch, POSITION)));
    }
    found.contradictions = smoothed.contradictions();
    found
}

fn nees((error, covariance): &(Vector3<f64>, Matrix3<f64>)) -> f64 {
    error.dot(&(covariance.try_inverse().unwrap() * error))
}

#[test]
fn with_a_gyroscope_a_smoothed_journey_is_better_and_consistent_from_both_sides() {
    let mut below = Coverage::default();
    let mut all: Vec<f64> = Vec::new();
    let (mut filtered, mut smoothed) = (0.0, 0.0);
    let no_kick = [0.0, 0.0];
    for seed in 0..draws(200, 9) as u64 {
        let travel = Travel::oscillation(&mut Random::new(seed), [4.0, 10.0], 0.06, 0.3);
        let found = journey(Motion::Gyroscope, &travel, [5.0, 7.0, 9.0], no_kick, seed);
        for (k, point) in found.smoothed.iter().enumerate() {
            below.count(nees(point) < 7.815);
            all.push(nees(point));
            filtered += found.filtered[k].0.norm_squared();
            smoothed += point.0.norm_squared();
            assert!(point.1.trace() <= found.filtered[k].1.trace() * 1.001);
        }
        assert_eq!(found.contradictions, 0, "{seed}");
    }
    assert!(smoothed < 0.25 * filtered, "{smoothed} {filtered}");
    // The filter assumes rests of 1 cm/s, and those here are exact.
    below.assert_can_be(0.93..=1.0, "NEES below 7.815");
    assert_median_can_be(&all, 0.6..=3.3, "NEES");
}

#[test]
fn without_a_gyroscope_a_smoothed_journey_is_no_worse_and_no_less_consistent() {
    let [mut before, mut after] = [Coverage::default(); 2];
    let (mut filtered, mut smoothed) = (0.0, 0.0);
    for seed in 0..draws(200, 9) as u64 {
        let travel = Travel::oscillation(&mut Random::new(seed), [4.0, 10.0], 0.06, 0.3);
        let found = journey(Motion::NoGyroscope, &travel, [5.0, 7.0, 9.0], [0.0; 2], seed);
        for (filter, smoother) in found.filtered.iter().zip(&found.smoothed) {
            before.count(nees(filter) < 7.815);
            after.count(nees(smoother) < 7.815);
            filtered += filter.0.norm_squared();
            smoothed += smoother.0.norm_squared();
        }
    }
    // The difference of both is smaller than what few draws tell.
    let most = Lane::current().choose([1.4, 1.2, 1.0]);
    assert!(smoothed < most * filtered, "{smoothed} {filtered}");
    after.assert_can_be(before.fraction() - 0.03..=1.0, "NEES below 7.815");
}

#[test]
fn an_error_that_the_model_excludes_does_not_reach_the_time_before_it() {
    // A pulse of the angular rate of 60° before a rest that contradicts it: the second move ends 8.25 s.
    let travel = Travel::stop_and_go(&mut Random::new(3), 2, 0.7, 0.7);
    let found = journey(Motion::Gyroscope, &travel, [4.8, 6.5, 11.9], [7.6, 8.6], 3);
    for (filter, smoother) in found.filtered.iter().zip(&found.smoothed).take(2) {
        assert!(smoother.0.norm() < 2.0 * filter.0.norm() + 0.02, "{filter:?} {smoother:?}");
        assert!(nees(smoother) < 16.3, "{}", nees(smoother));
    }
}

#[test]
fn garbage_stays_finite_and_is_counted() {
    let mut random = Random::new(8);
    let mut filter = Filter::new(&Layout::new([0.1; 3], 0.5, 1.0), Rotation3::identity());
    filter.record(Log::new(0.05));
    for k in 0..60 {
        filter.predict(&Pushed);
        let size = match k {
            20 => 1e6,
            40 => f64::NAN,
            _ => 0.1,
        };
        let value = Vector3::from(random.normals(1.0)) * size;
        let shown = Shown { value, blocks: [Some(VELOCITY), None], deviation: 0.1 };
        filter.update(&shown, Gate::Open);
        filter.end_step(STEP_S);
    }
    let mut epochs = std::mem::take(&mut filter.log_mut().unwrap().epochs);
    let count = epochs.len();
    let smoothed = Smoothed::of(&mut epochs);
    assert!(smoothed.contradictions() > 0);
    for epoch in 0..count {
        let [before, after] = smoothed.corrections(epoch, VELOCITY);
        assert!(before.iter().chain(&after).all(|x| x.is_finite()), "{epoch}");
        let p = smoothed.covariance(epoch, POSITION);
        assert!(p.iter().all(|x| x.is_finite()) && p.diagonal().min() >= 0.0, "{epoch}");
    }
    // Without epochs, and with one, there is nothing to do.
    assert_eq!(Smoothed::of(&mut epochs[..0]).contradictions(), 0);
    assert_eq!(Smoothed::of(&mut epochs[..1]).contradictions(), 0);
}
