//! The gyroscope's errors from simulated sessions whose truth is known.

use std::f64::consts::{PI, TAU};

use crate::common;

use common::{DrawModel as _, G, NINE, Random, cross, exact, norm};
use wimu_calib::{
    AccelerometerCalibration, GyroscopeEstimate, GyroscopeSession, Pose, Reason, Refusal,
    SixAxisSample, TurnFault, multi_position,
};
use wimu_model::{ErrorModel, GyroscopeModel, GyroscopeTerms, SpecificForceMps2};
use wimu_testkit::{Coverage, coverage_figure, draws};

const STEP_S: f64 = 0.01;
/// Of a sample: 0.01 °/s/√Hz; m/s².
const RATE_NOISE: f64 = 0.1 * PI / 180.0;
const FORCE_NOISE: f64 = 0.03;
/// 0.01 °/s in 100 s, (rad/s)²/s.
const BIAS_WALK: f64 = 3e-10;
const REST: usize = 200;
const RESTS: usize = 18;

/// A session and its truth.
struct Simulated {
    poses: Vec<Pose>,
    samples: Vec<SixAxisSample>,
    force: ErrorModel,
    rate: GyroscopeTerms,
    /// In the middle of the last rest, rad/s.
    bias: [f64; 3],
}

/// A rotation of the body: axis, sensor axes, angle, rad, and number of samples.
type Rotation = ([f64; 3], f64, usize);

fn turns(random: &mut Random) -> Vec<Rotation> {
    let mut one = || {
        let angle = PI / 2.0 * (1.0 + random.uniform());
        (random.direction(), angle, 150 + random.below(150))
    };
    (1..RESTS).map(|_| one()).collect()
}

fn gyroscope(random: &mut Random) -> GyroscopeTerms {
    let mut matrix = [[0.0; 3]; 3];
    for (r, row) in matrix.iter_mut().enumerate() {
        for (c, entry) in row.iter_mut().enumerate() {
            *entry = if r == c { 1.0 + 0.02 * random.normal() } else { 0.02 * random.normal() };
        }
    }
    GyroscopeTerms {
        bias_rad_s: random.normals(0.03),
        matrix,
        g_sensitivity: [0; 3].map(|_| random.normals(1e-4)),
        ..GyroscopeTerms::default()
    }
}

fn rotated(v: [f64; 3], axis: [f64; 3], angle: f64) -> [f64; 3] {
    let (sin, cos) = angle.sin_cos();
    let along: f64 = v.iter().zip(axis).map(|(v, a)| v * a).sum();
    let side = cross(axis, v);
    [0, 1, 2].map(|i| cos * v[i] + sin * side[i] + (1.0 - cos) * along * axis[i])
}

fn earth(pole: [f64; 3]) -> [f64; 3] {
    pole.map(|p| 7.292e-5 * p)
}

impl Simulated {
    fn new(random: &mut Random, turns: &[Rotation], noise: f64) -> Self {
        let mut rate = gyroscope(random);
        let force = random.model(true);
        let mut simulated =
            Self { poses: Vec::new(), samples: Vec::new(), force, rate, bias: [0.0; 3] };
        let mut up = random.direction();
        // The Earth's axis in sensor axes.
        let mut pole = random.direction();
        for k in 0..=turns.len() {
            let first = simulated.samples.len();
            for i in 0..REST {
                if i == REST / 2 {
                    simulated.bias = rate.bias_rad_s;
                }
                simulated.push(random, &mut rate, up, earth(pole), noise);
            }
            simulated.rest(first, noise);
            let Some((axis, angle, count)) = turns.get(k) else {
                break;
            };
            let length_s = (*count as f64 + 1.0) * STEP_S;
            for i in 1..=*count {
                let t = i as f64 * STEP_S / length_s;
                let turned = angle * (t - (TAU * t).sin() / TAU);
                let omega = angle / length_s * (1.0 - (TAU * t).cos());
                let now = rotated(up, *axis, -turned);
                let earth = earth(rotated(pole, *axis, -turned));
                let omega = [0, 1, 2].map(|j| axis[j] * omega + earth[j]);
                simulated.push(random, &mut rate, now, omega, noise);
            }
            pole = rotated(pole, *axis, -angle);
            up = rotated(up, *axis, -angle);
        }
        simulated
    }

    fn push(
        &mut self,
        random: &mut Random,
        rate: &mut GyroscopeTerms,
        up: [f64; 3],
        omega: [f64; 3],
        noise: f64,
    ) {
        let model = GyroscopeModel::new(*rate).unwrap();
        let force = up.map(|u| G * u);
        let ideal = model.distort(omega, force, None);
        let output = self.force.distort(SpecificForceMps2(force), None).0;
        self.samples.push(SixAxisSample {
            step_s: STEP_S,
            rate_rad_s: ideal.map(|y| y + noise * RATE_NOISE * random.normal()),
            output_mps2: output.map(|y| y + noise * FORCE_NOISE * random.normal()),
        });
        let walk = noise * (BIAS_WALK * STEP_S).sqrt();
        rate.bias_rad_s = rate.bias_rad_s.map(|b| b + walk * random.normal());
    }

    fn rest(&mut self, first: usize, noise: f64) {
        let rest = &self.samples[first..];
        let mean =
            |axis: usize| rest.iter().map(|s| s.output_mps2[axis]).sum::<f64>() / rest.len() as f64;
        self.poses.push(Pose {
            samples: rest.len() as u32,
            first_sample: first as u64,
            sd_mps2: [noise * FORCE_NOISE; 3],
            ..Pose::from_mean([0, 1, 2].map(mean))
        });
    }

    /// The accelerometer, calibrated with the same rests.
    fn accelerometer(&self) -> Option<AccelerometerCalibration> {
        let estimate = multi_position(&self.poses, exact(), NINE).ok()?;
        Some(AccelerometerCalibration::from(&estimate))
    }

    fn estimate(
        &self,
        accelerometer: &AccelerometerCalibration,
    ) -> Result<GyroscopeEstimate, Refusal> {
        let session = GyroscopeSession {
            poses: &self.poses,
            samples: &self.samples,
            accelerometer,
            full_scale_rad_s: None,
        };
        session.estimate()
    }

    fn truth(&self) -> [f64; 21] {
        all(self.bias, &self.rate)
    }
}

fn all(bias: [f64; 3], terms: &GyroscopeTerms) -> [f64; 21] {
    let mut all = [0.0; 21];
    all[..3].copy_from_slice(&bias);
    all[3..12].copy_from_slice(terms.matrix.as_flattened());
    all[12..].copy_from_slice(terms.g_sensitivity.as_flattened());
    all
}

fn found(estimate: &GyroscopeEstimate) -> [f64; 21] {
    let terms = estimate.model.terms();
    all(terms.bias_rad_s, terms)
}

fn session(seed: u64) -> (Simulated, Option<AccelerometerCalibration>) {
    let mut random = Random::new(seed);
    let turns = turns(&mut random);
    let simulated = Simulated::new(&mut random, &turns, 1.0);
    let accelerometer = simulated.accelerometer();
    (simulated, accelerometer)
}

#[test]
fn intervals_of_every_parameter_hold_the_truth() {
    let mut held = [Coverage::default(); 21];
    let mut squares = [[0.0; 2]; 21];
    let mut used = 0;
    for seed in 0..draws(2000, 3) as u64 {
        let (simulated, Some(accelerometer)) = session(seed) else {
            continue;
        };
        let estimate = simulated.estimate(&accelerometer).expect("an estimate");
        used += 1;
        let (found, truth) = (found(&estimate), simulated.truth());
        for i in 0..21 {
            let error = found[i] - truth[i];
            held[i].count(error.abs() <= estimate.half_width_95(i));
            squares[i][0] += error * error;
            squares[i][1] += estimate.sd(i).powi(2);
        }
    }
    for i in 0..21 {
        let [rms, sd] = squares[i].map(|s| (s / f64::from(used)).sqrt());
        println!("{i} {} rms {rms:.2e} sd {sd:.2e} ratio {:.3}", held[i], rms / sd);
    }
    coverage_figure("coverage of the gyroscope's 21 parameters", &held, 0.93..=0.97);
    for (i, held) in held.iter().enumerate() {
        held.assert_can_be(0.93..=0.97, &format!("parameter {i}"));
    }
    for (kind, name) in [(0..3, "bias"), (3..12, "matrix"), (12..21, "g-sensitivity")] {
        let mut all = Coverage::default();
        held[kind].iter().for_each(|held| all += *held);
        all.assert_can_be(0.93..=0.97, name);
    }
}

/// A session without noise whose samples are changed.
fn refused(change: impl Fn(&mut SixAxisSample)) -> Refusal {
    let (mut simulated, _) = session(7);
    simulated.samples.iter_mut().for_each(change);
    let accelerometer = simulated.accelerometer().unwrap();
    simulated.estimate(&accelerometer).expect_err("a refusal")
}

#[test]
fn wrong_units_and_axes_are_named() {
    for factor in [57.2958, 1.0 / 57.2958, 2.0, 0.25] {
        let refusal = refused(|s| s.rate_rad_s = s.rate_rad_s.map(|y| y * factor));
        assert!(matches!(refusal.reason, Reason::Unit { .. }), "{factor}: {refusal}");
        let named = match factor {
            50.0.. => "57.3 times too large",
            ..0.1 => "57.3 times too small",
            2.0 => "about 2 times",
            _ => "about 0.25 times",
        };
        assert!(refusal.text.contains(named), "{factor}: {refusal}");
    }
    let swapped = refused(|s| s.rate_rad_s.swap(0, 1));
    assert!(swapped.text.contains("X = Y, Y = X, Z = Z"), "{swapped}");
    let negated = refused(|s| s.rate_rad_s[2] *= -1.0);
    assert_eq!(negated.reason, Reason::Axes);
    let text = negated.to_string();
    assert!(text.contains("Z = −Z of the gyroscope"), "{text}");
    let turned = refused(|s| s.rate_rad_s = [s.rate_rad_s[1], s.rate_rad_s[2], -s.rate_rad_s[0]]);
    assert!(turned.text.contains("X = −Z, Y = X, Z = Y"), "{turned}");
    let dead = refused(|s| s.rate_rad_s[1] = 0.01);
    assert!(matches!(dead, Refusal { reason: Reason::PoorFit { .. }, .. }), "{dead}");
}

#[test]
fn turns_that_are_saturated_interrupted_or_contradicted_are_left_out() {
    let (clean, _) = session(3);
    let accelerometer = clean.accelerometer().unwrap();
    let spoilt = |change: &dyn Fn(&mut [SixAxisSample])| {
        let mut simulated =
            Simulated { samples: clean.samples.clone(), poses: clean.poses.clone(), ..clean };
        let start = simulated.poses[5].first_sample as usize + REST;
        let end = simulated.poses[6].first_sample as usize;
        change(&mut simulated.samples[start..end]);
        let estimate = simulated.estimate(&accelerometer).expect("an estimate");
        assert!((estimate.turns, estimate.rms_rad < 0.01) == (RESTS - 2, true), "{estimate:?}");
        assert!((0..21).all(|i| estimate.observed(i)));
        estimate.left_out.clone()
    };
    let saturated = spoilt(&|turn| {
        turn.iter_mut().for_each(|s| s.rate_rad_s[0] = s.rate_rad_s[0].clamp(-4.4, 4.4) + 0.0);
        let middle = turn.len() / 2;
        turn[middle..middle + 5].iter_mut().for_each(|s| s.rate_rad_s[0] = 4.36);
    });
    assert_eq!(saturated, [(5, TurnFault::Saturated { axis: 0 })]);
    let gap = spoilt(&|turn| turn[20].step_s = 0.6);
    assert_eq!(gap, [(5, TurnFault::Gap)]);
    let struck = spoilt(&|turn| turn.iter_mut().for_each(|s| s.rate_rad_s[1] += 0.15));
    assert_eq!(struck, [(5, TurnFault::Contradicted)]);
}

#[test]
fn rotations_about_one_axis_leave_the_others_at_the_prior_and_advise_them() {
    let mut random = Random::new(11);
    let turns: Vec<Rotation> = (1..RESTS).map(|_| ([1.0, 0.0, 0.0], 1.8, 200)).collect();
    let simulated = Simulated::new(&mut random, &turns, 1.0);
    let estimate =
        simulated.estimate(&AccelerometerCalibration::uncalibrated()).expect("an estimate");
    assert!(estimate.observed(3) && !estimate.observed(7) && !estimate.observed(11));
    assert!((estimate.model.terms().matrix[1][1] - 1.0).abs() < 0.01);
    let advice = estimate.advice().expect("advice");
    assert!(advice.contains("rotate") && !advice.contains("axis X"), "{advice}");
    // One rest gives the bias, as far as g-sensitivity allows.
    let alone = Simulated::new(&mut random, &[], 1.0);
    let estimate = alone.estimate(&AccelerometerCalibration::uncalibrated()).expect("an estimate");
    assert!((0..21).all(|i| estimate.observed(i) == (i < 3)));
    let error = norm([0, 1, 2].map(|i| estimate.model.terms().bias_rad_s[i] - alone.bias[i]));
    assert!(error < 4.0 * estimate.sd(0), "{error}");
}

#[test]
fn a_rest_that_moves_and_data_without_rests_are_refused() {
    let (mut simulated, _) = session(5);
    let accelerometer = simulated.accelerometer().unwrap();
    let start = simulated.poses[4].first_sample as usize;
    for sample in &mut simulated.samples[start..start + REST] {
        sample.rate_rad_s[2] += 0.3;
    }
    let refused = simulated.estimate(&accelerometer).expect_err("it rotates");
    assert!(matches!(refused, Refusal { reason: Reason::Moved { index: 4 }, .. }), "{refused}");
    simulated.samples[start + REST / 2].rate_rad_s[0] = f64::NAN;
    let refused = simulated.estimate(&accelerometer);
    assert!(matches!(refused, Err(Refusal { reason: Reason::Input { index: 4 }, .. })));
    simulated.poses.clear();
    assert!(matches!(
        simulated.estimate(&accelerometer),
        Err(Refusal { reason: Reason::TooFew { .. }, .. })
    ));
}
