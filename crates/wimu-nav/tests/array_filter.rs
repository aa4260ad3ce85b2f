//! What navigating with an array alone claims.

use crate::common;

use common::{Random, dot, minus, noisy, norm, outputs};
use nalgebra::{Matrix3, Rotation3, Vector3};
use wimu_nav::array::{ArrayConfig, ArrayFault, ArrayFilter, ArrayState, Geometry, GeometryError};
use wimu_nav::navigator::Rests;
use wimu_testkit::{Coverage, assert_median_can_be, coverage_figure, draws, figure};

const G: f64 = 9.80665;
const DT: f64 = 0.01;
const NOISE: f64 = 0.02;
const BIAS: f64 = 0.02;

fn board() -> Geometry {
    common::board(0.005, NOISE)
}

fn config(zupt: bool) -> ArrayConfig {
    ArrayConfig {
        gravity_mps2: G,
        rests: if zupt { Rests::ZeroVelocity } else { Rests::Ignored },
        bias_mps2: BIAS,
        force_noise_mps2: 0.0,
        ..ArrayConfig::default()
    }
}

/// A body that rests for a second and is then carried and turned about.
struct Body {
    /// Amplitude, angular frequency and phase of three tones for each axis of position and rate.
    tones: [[[f64; 3]; 3]; 6],
    attitude: Rotation3<f64>,
    time: f64,
}

const REST_S: f64 = 1.0;

impl Body {
    fn new(random: &mut Random, metres: f64, rad_s: f64) -> Self {
        let tones = std::array::from_fn(|axis| {
            [0; 3].map(|_| {
                let omega = std::f64::consts::TAU * (0.3 + 1.2 * random.uniform());
                let size = if axis < 3 { metres } else { rad_s };
                let phase = random.uniform() * std::f64::consts::TAU;
                [random.normal() * size, omega, phase]
            })
        });
        Self {
            tones,
            attitude: Rotation3::from_scaled_axis(Vector3::from(random.normals(1.0))),
            time: 0.0,
        }
    }

    /// How far the motion has begun at a time, and its first two derivatives: smooth.
    fn begun(t: f64) -> [f64; 3] {
        let x = ((t - REST_S) / 0.5).clamp(0.0, 1.0);
        [
            x * x * x * (10.0 - 15.0 * x + 6.0 * x * x),
            30.0 * x * x * (1.0 - x) * (1.0 - x) / 0.5,
            60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / 0.25,
        ]
    }

    /// Value and two derivatives.
    fn axis(&self, axis: usize, t: f64) -> [f64; 3] {
        let [e, de, dde] = Self::begun(t);
        let (mut x, mut v, mut a) = (0.0, 0.0, 0.0);
        for [size, w, p] in self.tones[axis] {
            let (s, c) = (w * t + p).sin_cos();
            x += size * s;
            v += size * w * c;
            a -= size * w * w * s;
        }
        [e * x, e * v + de * x, e * a + 2.0 * de * v + dde * x]
    }

    fn three(&self, from: usize, derivative: usize) -> [f64; 3] {
        [0, 1, 2].map(|i| self.axis(from + i, self.time)[derivative])
    }

    fn rate(&self) -> [f64; 3] {
        self.three(3, 0)
    }

    fn step(&mut self) {
        const PARTS: usize = 8;
        let dt = DT / PARTS as f64;
        for _ in 0..PARTS {
            self.time += 0.5 * dt;
            let by = Vector3::from(self.rate()) * dt;
            self.attitude *= Rotation3::from_scaled_axis(by);
            self.time += 0.5 * dt;
        }
    }

    fn outputs(&self, geometry: &Geometry, random: &mut Random, bias: &[f64; 24]) -> Vec<f64> {
        let acceleration = Vector3::from(self.three(0, 2)) + Vector3::z() * G;
        let force = self.attitude.inverse() * acceleration;
        let clean = outputs(geometry, self.rate(), self.three(3, 1), force.into());
        clean.iter().zip(bias).map(|(y, bias)| y + bias + NOISE * random.normal()).collect()
    }
}

fn nees(error: [f64; 3], covariance: [[f64; 3]; 3]) -> f64 {
    let p = Matrix3::from_fn(|i, j| covariance[i][j]);
    let e = Vector3::from(error);
    e.dot(&(p.try_inverse().unwrap() * e))
}

/// NEES of position, velocity, attitude and ω at the end of a run, and the position's error.
fn run(seed: u64) -> [f64; 5] {
    let mut random = Random::new(seed);
    let mut body = Body::new(&mut random, 0.04, 2.0);
    let geometry = board();
    let bias: [f64; 24] = std::array::from_fn(|_| BIAS * random.normal());
    let mut filter = ArrayFilter::new(geometry.clone(), config(true)).unwrap();
    // Heading and the level it was aligned with: the navigation axes begin as the filter says.
    let mut turn = Rotation3::identity();
    let mut origin = [0.0; 3];
    let steps = 250;
    for k in 0..steps {
        let sample = body.outputs(&geometry, &mut random, &bias);
        filter.push(DT, &sample).unwrap();
        let state = filter.state();
        if k == 80 {
            // The filter's heading is arbitrary: bring the truth to it, about the vertical.
            let q = nalgebra::Quaternion::from(state.quaternion.map_to());
            let found = nalgebra::UnitQuaternion::from_quaternion(q).to_rotation_matrix();
            let between = found * body.attitude.inverse();
            let heading = between[(1, 0)].atan2(between[(0, 0)]);
            turn = Rotation3::from_axis_angle(&Vector3::z_axis(), heading);
            origin = body.three(0, 0);
        }
        body.step();
    }
    // The state belongs to the sample before the last step.
    let state = filter.state();
    body.time -= DT;
    let place = turn * Vector3::from(minus(body.three(0, 0), origin));
    let velocity = turn * Vector3::from(body.three(0, 1));
    let rate = body.rate();
    body.time += DT;
    let by = Vector3::from(rate) * DT + Vector3::from(body.three(3, 1)) * (0.5 * DT * DT);
    let attitude = turn * body.attitude * Rotation3::from_scaled_axis(-by);
    let q = nalgebra::Quaternion::from(state.quaternion.map_to());
    let found = nalgebra::UnitQuaternion::from_quaternion(q).to_rotation_matrix();
    let away = (attitude * found.inverse()).scaled_axis();
    let error = minus(place.into(), state.position_m);
    [
        nees(error, state.position_covariance),
        nees(minus(velocity.into(), state.velocity_mps), state.velocity_covariance),
        nees(away.into(), state.attitude_covariance),
        nees(minus(rate, state.rate_rad_s), state.rate_covariance),
        norm(error),
    ]
}

/// W X Y Z to nalgebra's order.
trait MapTo {
    fn map_to(self) -> [f64; 4];
}

impl MapTo for [f64; 4] {
    fn map_to(self) -> [f64; 4] {
        let [w, x, y, z] = self;
        [x, y, z, w]
    }
}

#[test]
fn errors_lie_within_the_covariance_of_every_part() {
    let runs = draws(1000, 3) as u64;
    let all: Vec<[f64; 5]> = (1..=runs).map(run).collect();
    let (mut kinds, mut medians) = (Vec::new(), Vec::new());
    for (part, name) in ["position", "velocity", "attitude", "angular rate"].iter().enumerate() {
        let mut sorted: Vec<f64> = all.iter().map(|a| a[part]).collect();
        sorted.sort_by(f64::total_cmp);
        let below: Coverage = sorted.iter().map(|v| *v < 7.81).collect();
        let median = sorted[sorted.len() / 2];
        println!("{name}: NEES below 7.81 in {below}, median {median:.2}");
        // Conservative: the filter expects a hand's motion to be rougher than this one.
        below.assert_can_be(0.93..=1.0, name);
        assert_median_can_be(&sorted, 0.4..=3.5, name);
        kinds.push(below);
        medians.push(median);
    }
    let claim = "eight triads carried, 1.5 s: NEES below 7.81, 4 states";
    coverage_figure(claim, &kinds, 0.9..=0.98);
    medians.sort_by(f64::total_cmp);
    figure(
        "eight triads carried, 1.5 s: median NEES, 4 states",
        format!("{:.2} to {:.2}", medians[0], medians[3]),
        "1.5 to 3.5",
        medians[0] >= 1.5 && medians[3] <= 3.5,
    );
    let mut errors: Vec<f64> = all.iter().map(|a| a[4]).collect();
    errors.sort_by(f64::total_cmp);
    println!("median error after 1.5 s: {:.3} m", errors[errors.len() / 2]);
}

/// Pushes `count` samples of a body that does not move.
fn hold(filter: &mut ArrayFilter, random: &mut Random, count: usize) {
    let still = outputs(&board(), [0.0; 3], [0.0; 3], [0.0, 0.0, G]);
    for _ in 0..count {
        let y = noisy(&still, NOISE, random);
        filter.push(DT, &y).unwrap();
    }
}

fn rate_sd(state: &ArrayState) -> f64 {
    (0..3).map(|i| state.rate_covariance[i][i]).sum::<f64>().sqrt()
}

#[test]
fn without_rests_the_rate_is_hardly_known_and_a_rotation_shows_it() {
    let mut random = Random::new(3);
    let mut filter = ArrayFilter::new(board(), config(false)).unwrap();
    hold(&mut filter, &mut random, 100);
    let early = rate_sd(&filter.state());
    assert!(early < 0.1, "the rest at the start is part of the alignment: {early}");
    // A movement ends it. What a sample shows of ω is its square alone.
    let away = outputs(&board(), [0.0; 3], [0.0; 3], [1.0, 0.0, G]);
    filter.push(DT, &away).unwrap();
    hold(&mut filter, &mut random, 900);
    let late = rate_sd(&filter.state());
    assert!(late > 0.15, "{late}");
    assert!(filter.state().position_sd_m() > 0.5);
    // A turn about x: 10 rad/s within half a second.
    for k in 0..60 {
        let x = (f64::from(k) / 50.0).min(1.0);
        let turn = if x < 1.0 { 20.0 } else { 0.0 };
        let y = outputs(&board(), [10.0 * x, 0.0, 0.0], [turn, 0.0, 0.0], [0.0, 0.0, G]);
        let y = noisy(&y, NOISE, &mut random);
        filter.push(DT, &y).unwrap();
    }
    let state = filter.state();
    assert!(rate_sd(&state) < 0.7 * late, "{:?}", state.rate_covariance);
    assert!((state.rate_rad_s[0] - 10.0).abs() < 1.0, "{state:?}");
    assert!(filter.hypotheses().all(|(_, rate)| rate[0] > 8.0));
}

#[test]
fn a_start_in_a_turn_is_ambiguous_until_the_turn_changes() {
    let mut random = Random::new(5);
    let mut filter = ArrayFilter::new(board(), config(true)).unwrap();
    let rate = [6.0, -3.0, 4.0];
    let mut push = |filter: &mut ArrayFilter, rate: [f64; 3], turn: [f64; 3]| {
        let y = outputs(&board(), rate, turn, [1.0, 2.0, G]);
        let y = noisy(&y, NOISE, &mut random);
        filter.push(DT, &y).unwrap();
    };
    // ω̇ = 0: nothing tells ω from −ω.
    for _ in 0..120 {
        push(&mut filter, rate, [0.0; 3]);
    }
    let state = filter.state();
    assert_eq!(filter.hypotheses().count(), 2);
    assert!(state.certainty < 0.9, "{}", state.certainty);
    let sum: f64 = filter.hypotheses().map(|(p, _)| p).sum();
    assert!((sum - 1.0).abs() < 1e-9);
    let mut found = [false; 2];
    for (_, ω) in filter.hypotheses() {
        found[0] |= norm(minus(ω, rate)) < 1.0;
        found[1] |= norm(minus(ω, rate.map(|w| -w))) < 1.0;
    }
    assert_eq!(found, [true; 2]);
    // It gets faster: the other one would get slower.
    let turn = rate.map(|w| 2.0 * w);
    for k in 0..40 {
        let t = f64::from(k) * DT;
        push(&mut filter, rate.map(|w| w * (1.0 + 2.0 * t)), turn);
    }
    let state = filter.state();
    assert!(state.certainty > 0.999, "{}", state.certainty);
    assert!(dot(state.rate_rad_s, rate) > 0.0);
}

#[test]
fn of_the_four_roots_of_a_planar_array_time_leaves_two() {
    let places = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];
    let flat = common::triads(&places.map(|[x, y]| [x, y, 0.0]), 0.02, NOISE);
    let mut filter = ArrayFilter::new(flat.clone(), config(true)).unwrap();
    let mut random = Random::new(7);
    let rate = [6.0, -3.0, 5.0];
    let mut most = 0;
    for _ in 0..120 {
        let y = outputs(&flat, rate, [0.0; 3], [1.0, 2.0, G]);
        filter.push(DT, &noisy(&y, NOISE, &mut random)).unwrap();
        most = most.max(filter.hypotheses().count());
    }
    // The mirror images would have another angular acceleration than their rates show.
    assert_eq!((most, filter.hypotheses().count()), (4, 2));
    assert!(filter.state().certainty < 0.9);
    for (_, found) in filter.hypotheses() {
        let sign = dot(found, rate).signum();
        assert!(norm(minus(found.map(|w| w * sign), rate)) < 1.0, "{found:?}");
    }
}

#[test]
fn bad_input_is_said_and_survived() {
    let mut random = Random::new(13);
    let mut filter = ArrayFilter::new(board(), config(true)).unwrap();
    hold(&mut filter, &mut random, 100);
    assert!(filter.state().valid && filter.state().resting);
    let still = outputs(&board(), [0.0; 3], [0.0; 3], [0.0, 0.0, G]);
    for step in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(filter.push(step, &still), Err(ArrayFault::NoTime), "{step}");
    }
    // Two sensors that fail are left out, and said.
    let mut y = still.clone();
    y[4] = f64::INFINITY;
    y[9] = f64::NAN;
    assert_eq!(filter.push(DT, &y), Ok(1 << 1 | 1 << 3));
    // The others still show a turn.
    let mut turned = filter.clone();
    for k in 0..50 {
        let x = f64::from(k + 1) / 50.0;
        let mut y = outputs(&board(), [10.0 * x, 0.0, 0.0], [20.0, 0.0, 0.0], [0.0, 0.0, G]);
        y = noisy(&y, NOISE, &mut random);
        y[9] = f64::NAN;
        turned.push(DT, &y).unwrap();
    }
    let rate = turned.state().rate_rad_s;
    assert!((rate[0] - 10.0).abs() < 1.0, "{rate:?}");
    // All of them: carried on, not valid.
    let fault = filter.push(DT, &[f64::NAN; 24]).unwrap_err();
    assert_eq!(fault, ArrayFault::Blind(GeometryError::TooFew { have: 0, need: 6 }));
    assert!(fault.to_string().contains("are needed"));
    assert!(!filter.state().valid);
    hold(&mut filter, &mut random, 100);
    assert!(filter.state().valid, "a rest brings it back");
    // A gap.
    assert_eq!(filter.push(3.0, &still), Err(ArrayFault::Gap));
    assert!(!filter.state().valid && filter.state().position_sd_m() > 1.0);
    hold(&mut filter, &mut random, 100);
    let state = filter.state();
    assert!(state.valid && state.position_m.iter().all(|p| p.is_finite()));
    assert!(state.position_sd_m() > 1.0, "a rest does not bring back where it is");
}

#[test]
fn constant_velocity_after_an_acceleration_is_not_taken_as_a_rest() {
    let mut random = Random::new(21);
    let settings = ArrayConfig { rests: Rests::ConstantVelocity, ..config(true) };
    let mut filter = ArrayFilter::new(board(), settings).unwrap();
    hold(&mut filter, &mut random, 150);
    let start = filter.state().position_m;
    // To 2 m/s within half a second, and on for one.
    let mut path = 0.0;
    for k in 0..150 {
        let force = if k < 50 { 4.0 } else { 0.0 };
        let clean = outputs(&board(), [0.0; 3], [0.0; 3], [force, 0.0, G]);
        let speed = 2.0 * (f64::from(k) / 50.0).min(1.0);
        path += speed * DT;
        filter.push(DT, &noisy(&clean, NOISE, &mut random)).unwrap();
    }
    let state = filter.state();
    let error = norm(minus(minus(state.position_m, start), [path, 0.0, 0.0]));
    assert!(!state.resting);
    assert!(error < 3.0 * state.position_sd_m(), "{error} m of {}", state.position_sd_m());
}

#[test]
fn when_a_sample_was_taken_and_how_it_fits_is_in_the_covariance() {
    let late = ArrayConfig { time_sd_s: 2e-3, ..config(true) };
    let exact = ArrayConfig { time_sd_s: 0.0, ..config(true) };
    let [mut late, mut exact] = [late, exact].map(|c| ArrayFilter::new(board(), c).unwrap());
    let mut random = Random::new(22);
    let mut push = |rate: [f64; 3], turn: [f64; 3], force: [f64; 3]| {
        let clean = outputs(&board(), rate, turn, force);
        let y = noisy(&clean, NOISE, &mut random);
        late.push(DT, &y).unwrap();
        exact.push(DT, &y).unwrap();
        (late.state(), exact.state())
    };
    for _ in 0..100 {
        push([0.0; 3], [0.0; 3], [0.0, 0.0, G]);
    }
    let mut states = push([0.0; 3], [0.0; 3], [0.0, 0.0, G]);
    for k in 0..50 {
        let t = f64::from(k) * DT;
        states = push([20.0 * t, 0.0, 0.0], [20.0, 0.0, 0.0], [0.0, 0.0, G]);
    }
    let (late, exact) = states;
    let more = late.rate_covariance[0][0] - exact.rate_covariance[0][0];
    let by = 2e-3 * late.angular_acceleration_rad_s2[0];
    assert!((more - by * by).abs() < 1e-9, "{more} {by}");
    // A turn from one sample to the next that nothing announced.
    let (_, surprised) = push([-12.0, 9.0, 0.0], [0.0; 3], [0.0, 0.0, G]);
    assert!(rate_sd(&surprised) > 2.0 * rate_sd(&exact));
}
