//! What is claimed of the fit of an array: each error is found within its posterior deviation, deviations are consistent from
//! both sides, contradictions name the sensor, no input panics.

use std::f64::consts::TAU;

use proptest::prelude::*;
use wimu_calib::array::{ArrayData, ArrayEstimate, ArrayPrior, fit_array};
use wimu_calib::{Reason, find_poses};
use wimu_model::geometry::Geometry;
use wimu_testkit::{Coverage, Lane, Random, coverage_figure, draws, figure};

use crate::common::{G, config, recording};

const NOISE: f64 = 0.03;
const RATE_HZ: f64 = 100.0;
const RESTS: usize = 12;
const REST_S: f64 = 1.0;
const MOVING_S: f64 = 12.0;

type V = [f64; 3];

fn cross(a: V, b: V) -> V {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: V, b: V) -> f64 {
    (0..3).map(|i| a[i] * b[i]).sum()
}

/// Specific force at the origin, ω and ω̇ of a body that rests in twelve orientations, then is shaken by hand.
fn motion(t: f64) -> [V; 3] {
    let rest = (t / REST_S) as usize;
    if rest < RESTS {
        let z = 1.0 - 2.0 * (rest as f64 + 0.5) / RESTS as f64;
        let ((s, c), r) = ((2.4 * rest as f64).sin_cos(), (1.0 - z * z).sqrt());
        return [[r * c * G, r * s * G, z * G], [0.0; 3], [0.0; 3]];
    }
    let m = t - RESTS as f64 * REST_S;
    let tones = [[11.0, 1.9], [9.0, 2.3], [10.0, 1.4]];
    [
        [
            15.0 * (TAU * 1.3 * m).sin(),
            12.0 * (TAU * 1.7 * m + 1.0).sin(),
            G + 14.0 * (TAU * 1.1 * m + 2.0).sin(),
        ],
        tones.map(|[a, f]| a * (TAU * f * m).sin()),
        tones.map(|[a, f]| a * TAU * f * (TAU * f * m).cos()),
    ]
}

/// True errors of an array.
#[derive(Clone, Default)]
struct Truth {
    bias: Vec<f64>,
    matrix: Vec<V>,
    offset: Vec<V>,
    delay: Vec<f64>,
    size: f64,
    /// Change of the bias of each axis from rest to rest.
    repeatability: f64,
}

impl Truth {
    fn none(axes: usize) -> Self {
        Self {
            bias: vec![0.0; axes],
            matrix: vec![[0.0; 3]; axes],
            offset: vec![[0.0; 3]; axes],
            delay: vec![0.0; axes / 3],
            size: 1.0,
            repeatability: 0.0,
        }
    }

    fn drawn(axes: usize, prior: &ArrayPrior, random: &mut Random) -> Self {
        Self {
            bias: (0..axes).map(|_| prior.bias_mps2 * random.normal()).collect(),
            matrix: (0..axes).map(|_| random.normals(prior.matrix)).collect(),
            offset: (0..axes).map(|_| random.normals(prior.position_m)).collect(),
            delay: (0..axes / 3).map(|_| prior.delay_s * random.normal()).collect(),
            size: 1.0,
            repeatability: prior.repeatability_mps2,
        }
    }
}

/// A recording of the array.
struct Recording<const M: usize> {
    times: Vec<f64>,
    outputs: Vec<[f64; M]>,
    rests: Vec<(usize, usize)>,
}

impl<const M: usize> Recording<M> {
    fn of(geometry: &Geometry<M>, truth: &Truth, random: &mut Random) -> Self {
        Self::moved_for(MOVING_S, geometry, truth, random)
    }

    fn moved_for(
        moving_s: f64,
        geometry: &Geometry<M>,
        truth: &Truth,
        random: &mut Random,
    ) -> Self {
        let count = ((RESTS as f64 * REST_S + moving_s) * RATE_HZ) as usize;
        let per_rest = (REST_S * RATE_HZ) as usize;
        let mut outputs = Vec::new();
        let mut changes = [0.0; M];
        for k in 0..count {
            if k % per_rest == 0 && k / per_rest < RESTS {
                changes = std::array::from_fn(|_| truth.repeatability * random.normal());
            }
            outputs.push(std::array::from_fn(|a| {
                // The orientation changes at once: no sample of it is of use.
                let turned = k / per_rest < RESTS && !(5..per_rest - 5).contains(&(k % per_rest));
                let Some(axis) = geometry.axes().get(a).filter(|_| !turned) else {
                    return f64::NAN;
                };
                let [f0, rate, turn] = motion(k as f64 / RATE_HZ + truth.delay[a / 3]);
                let r: V =
                    std::array::from_fn(|i| truth.size * axis.position_m[i] + truth.offset[a][i]);
                let (at, ct) = (cross(turn, r), cross(rate, cross(rate, r)));
                let force: V = std::array::from_fn(|i| f0[i] + at[i] + ct[i]);
                let m: V = std::array::from_fn(|i| axis.direction[i] + truth.matrix[a][i]);
                truth.bias[a] + changes[a] + dot(m, force) + NOISE * random.normal()
            }));
        }
        // The ends of a rest, which delays put into the next, are left out.
        let rests = (0..RESTS).map(|r| (r * per_rest + 5, per_rest - 10)).collect();
        let times = (0..count).map(|k| k as f64 / RATE_HZ).collect();
        Self { times, outputs, rests }
    }

    fn data(&self) -> ArrayData<'_, M> {
        ArrayData {
            times_s: &self.times,
            outputs_mps2: &self.outputs,
            rests: &self.rests,
            period_s: 1.0 / RATE_HZ,
            stride: 2,
        }
    }
}

fn board() -> Geometry<24> {
    Geometry::eight_triads_board(0.02, 0.006, NOISE).unwrap()
}

fn fitted<const M: usize>(
    geometry: &Geometry<M>,
    recording: &Recording<M>,
    prior: &ArrayPrior,
) -> ArrayEstimate<M> {
    fit_array(geometry, |_| true, &recording.data(), prior).unwrap()
}

fn prior() -> ArrayPrior {
    ArrayPrior { gravity_sd_mps2: 0.0, ..ArrayPrior::default() }
}

#[test]
fn positions_a_millimetre_off_are_found_within_their_deviation() {
    let geometry = board();
    let mut truth = Truth::none(24);
    for axis in 6..9 {
        truth.offset[axis] = [1e-3, 0.0, 0.0];
    }
    truth.offset[14] = [0.0, -1e-3, 0.0];
    let recording = Recording::of(&geometry, &truth, &mut Random::new(1));
    let found = fitted(&geometry, &recording, &prior());
    for axis in 0..24 {
        for (i, (value, sd)) in found.offset_m(axis).into_iter().enumerate() {
            let error = value - truth.offset[axis][i];
            assert!(error.abs() < 4.0 * sd && sd < 5e-4, "{axis} {i}: {error:e} ± {sd:e}");
        }
    }
    println!("{:?}", found.agreement);
    let sd = found.position_sd_m(&|_| true);
    figure(
        "positions of an array, posterior deviation, mm",
        format!("{:.3}", sd * 1e3),
        "below 0.15",
        sd < 1.5e-4,
    );
    assert!(sd < 1.5e-4 && (0.7..1.1).contains(&found.agreement.chi_square), "{sd}");
}

#[test]
fn posterior_deviations_are_consistent_from_both_sides() {
    let geometry = Geometry::four_triads(0.03, NOISE).unwrap();
    let prior = ArrayPrior { bias_mps2: 0.2, matrix: 0.01, ..prior() };
    let mut kinds = [Coverage::default(); 4];
    let mut squares = [0.0; 4];
    let moving_s = Lane::current().choose([3.0, 3.0, MOVING_S]);
    for seed in 1..=draws(100, 12) as u64 {
        let mut random = Random::new(seed);
        let truth = Truth::drawn(12, &prior, &mut random);
        let recording = Recording::moved_for(moving_s, &geometry, &truth, &mut random);
        let found = fitted(&geometry, &recording, &prior);
        let mut count = |kind: usize, (value, sd): (f64, f64), truth: f64| {
            kinds[kind].count((value - truth).abs() < 1.96 * sd);
            squares[kind] += ((value - truth) / sd).powi(2);
        };
        for axis in 0..12 {
            count(0, found.bias_mps2(axis), truth.bias[axis]);
            for i in 0..3 {
                count(1, found.matrix(axis)[i], truth.matrix[axis][i]);
                count(2, found.offset_m(axis)[i], truth.offset[axis][i]);
            }
        }
        for sensor in 0..4 {
            // Against the mean, which no output shows.
            let mean = truth.delay.iter().sum::<f64>() / 4.0;
            count(3, found.delay_s(sensor), truth.delay[sensor] - mean);
        }
        println!("{seed}: χ² {:.3}", found.agreement.chi_square);
    }
    for (kind, square) in kinds.iter().zip(squares) {
        println!("{kind} {:.2}", square / kind.total() as f64);
    }
    coverage_figure(
        "array: 95 % intervals of bias, matrix, position and delay",
        &kinds,
        0.90..=0.99,
    );
    for kind in kinds {
        kind.assert_can_be(0.90..=0.99, "array");
    }
}

#[test]
fn the_size_of_the_array_is_within_its_bounds() {
    let geometry = Geometry::four_triads(0.03, NOISE).unwrap();
    for size in [0.8, 1.0, 1.25] {
        let truth = Truth { size, ..Truth::none(12) };
        let recording = Recording::of(&geometry, &truth, &mut Random::new(2));
        let [least, most] = fitted(&geometry, &recording, &prior()).agreement.size.unwrap();
        println!("{size}: geometry {least:.3} to {most:.3} of the array");
        assert!((least..=most).contains(&(1.0 / size)) && most / least < 1.1, "{least} {most}");
    }
}

#[test]
fn a_delay_of_2_ms_of_one_sensor_is_found() {
    let geometry = Geometry::four_triads(0.03, NOISE).unwrap();
    let mut truth = Truth::none(12);
    truth.delay[2] = 2e-3;
    let recording = Recording::of(&geometry, &truth, &mut Random::new(3));
    let wide = ArrayPrior { delay_s: 0.1, ..prior() };
    let found = fitted(&geometry, &recording, &wide);
    let others = [0, 1, 3].map(|s| found.delay_s(s).0).iter().sum::<f64>() / 3.0;
    let (delay, sd) = found.delay_s(2);
    println!("{:?}", [0, 1, 2, 3].map(|s| found.delay_s(s)));
    assert!((delay - others - 2e-3).abs() < 1e-4, "{delay} {others} ± {sd}");
}

#[test]
fn two_swapped_sensors_are_named() {
    let right = board();
    let recording = Recording::moved_for(4.0, &right, &Truth::none(24), &mut Random::new(4));
    let mut axes = right.axes().to_vec();
    for i in 0..3 {
        axes.swap(3 + i, 15 + i);
    }
    let wrong = Geometry::from_grouped_axes(&axes, 3).unwrap();
    let found = fitted(&wrong, &recording, &prior());
    let agreement = found.agreement;
    assert!(agreement.unexplained > 0.15 && [1, 5].contains(&agreement.worst()));
    assert!(agreement.fractions[1] + agreement.fractions[5] > 0.7);
}

#[test]
fn rests_alone_give_bias_and_matrix() {
    let geometry = board();
    let mut random = Random::new(5);
    let truth = Truth::drawn(24, &prior(), &mut random);
    let mut recording = Recording::of(&geometry, &truth, &mut random);
    let end = (RESTS as f64 * REST_S * RATE_HZ) as usize;
    recording.outputs.truncate(end);
    recording.times.truncate(end);
    let found = fitted(&geometry, &recording, &prior());
    for axis in 0..24 {
        let (bias, sd) = found.bias_mps2(axis);
        assert!((bias - truth.bias[axis]).abs() < 4.5 * sd && sd < 0.03, "{axis}: {bias} ± {sd}");
    }
    assert_eq!(found.agreement.samples, 0);
    let sd = found.matrix_sd(&|_| true);
    assert!(sd < 2e-3, "{sd}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: Lane::current().choose([4, 16, 100]), ..config() })]

    #[test]
    fn garbage_is_an_error_or_finite(
        values in prop::collection::vec(prop_oneof![any::<f64>(), -20.0..20.0_f64], 0..400),
        rests in prop::collection::vec((0..100_usize, any::<usize>()), 0..3),
        period in prop_oneof![any::<f64>(), Just(0.01)],
        stride in any::<usize>(),
    ) {
        let geometry = Geometry::four_triads(0.03, NOISE).unwrap();
        let outputs: Vec<[f64; 12]> = values.chunks_exact(4).map(|v| std::array::from_fn(|a| v[a % 4])).collect();
        let times: Vec<f64> = (0..outputs.len()).map(|k| 0.01 * k as f64).collect();
        let data = ArrayData { times_s: &times, outputs_mps2: &outputs, rests: &rests, period_s: period, stride };
        if let Ok(found) = fit_array(&geometry, |_| true, &data, &prior()) {
            prop_assert!((0..12).all(|a| found.bias_mps2(a).0.is_finite()));
        }
    }
}

#[test]
fn what_cannot_be_fitted_is_refused_with_its_reason() {
    let geometry = Geometry::four_triads(0.03, NOISE).unwrap();
    let recording = Recording::of(&geometry, &Truth::none(12), &mut Random::new(6));
    let refused = |data: &ArrayData<'_, 12>, prior: &ArrayPrior, usable: &dyn Fn(usize) -> bool| {
        fit_array(&geometry, usable, data, prior).unwrap_err().reason
    };
    let data = recording.data();
    let none = ArrayPrior { matrix: f64::NAN, ..prior() };
    assert_eq!(refused(&data, &none, &|_| true), Reason::Input { index: 0 });
    assert_eq!(refused(&data, &prior(), &|s| s == 0), Reason::NotObservable);
    let empty = ArrayData { outputs_mps2: &[], times_s: &[], ..data };
    assert_eq!(refused(&empty, &prior(), &|_| true), Reason::TooFew { have: 0, need: 1 });
}

#[test]
fn a_real_array_agrees_with_its_drawing_and_shows_its_proof_masses() {
    // Seconds each.
    for run in 1..=Lane::current().choose([0, 1, 2]) {
        let Some(rows) = recording(&format!("array/mimu4444_run{run}.csv")) else {
            println!("skipped: the recording is not there");
            return;
        };
        let number = |text: &String| text.trim().parse::<f64>().ok();
        let rows: Vec<Vec<f64>> =
            rows.iter().map(|row| row.iter().map_while(number).collect()).collect();
        let rows: Vec<Vec<f64>> = rows.into_iter().filter(|row| row.len() >= 49).collect();
        let times: Vec<f64> = rows.iter().map(|row| row[0]).collect();
        // Counts near the limit of 16 bits are clipped.
        let value = |v: f64| {
            if v.abs() < 32_700.0 { v * G / 2048.0 } else { f64::NAN }
        };
        let sample = |row: &Vec<f64>| std::array::from_fn(|a| value(row[1 + 6 * (a / 3) + a % 3]));
        let outputs: Vec<[f64; 24]> = rows.iter().map(sample).collect();
        let mean = outputs.iter().map(|row| {
            let of_axis = |i: usize| (0..8).map(|s| row[3 * s + i]).sum::<f64>() / 8.0;
            ([0, 1, 2].map(of_axis), None)
        });
        let poses = find_poses(mean, 62.5);
        let rests: Vec<(usize, usize)> =
            poses.iter().map(|p| (p.first_sample as usize, p.samples as usize)).collect();
        let (p, h) = (9.45e-3, 1.0e-3);
        let geometry = Geometry::eight_triads_board(p, h, 0.045).unwrap();
        let data = ArrayData {
            times_s: &times,
            outputs_mps2: &outputs,
            rests: &rests,
            period_s: 1.0 / 62.5,
            stride: Lane::current().choose([16, 16, 4]),
        };
        let found = fit_array(&geometry, |_| true, &data, &ArrayPrior::default()).unwrap();
        let z = |sensors: [usize; 4], i: usize| {
            sensors.map(|s| found.offset_m(3 * s + 2)[i].0).iter().sum::<f64>() / 4e-3
        };
        println!(
            "run {run}: {} rests, z axes of upper chips at {:+.2} {:+.2} mm, lower {:+.2} {:+.2}; matrix ± {:.4}; {:?}",
            rests.len(),
            z([0, 2, 4, 6], 0),
            z([0, 2, 4, 6], 1),
            z([1, 3, 5, 7], 0),
            z([1, 3, 5, 7], 1),
            found.matrix_sd(&|_| true),
            found.agreement
        );
        println!("delays {:?}", [0, 1, 2, 3, 4, 5, 6, 7].map(|s| found.delay_s(s)));
        assert!(found.agreement.unexplained < 0.15);
    }
}
