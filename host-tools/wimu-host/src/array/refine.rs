//! Places and delays of an array's sensors, from what the sensors disagree by while the body turns:
//! equation (99).

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix3};
use wimu_nav::array::ArraySolver;

use super::motion::{axes, navigated, refused, sample, with_room};
use super::{ArrayCalibration, ArrayGeometry, ArrayRecording};
use crate::inertial::Zupt;
use crate::{ErrorCode, HostError, Result};

/// The fit is linearised again so often.
const PASSES: usize = 4;
/// A body that turns less than this, rad/s, or rad/s² in the place of its angular acceleration, tells
/// nothing of places.
const LEAST_TURN: f64 = 25.0;
/// Samples that are needed.
const LEAST_SAMPLES: usize = 200;
/// A refinement is fitted to every other block of the recording and judged on the others, s.
const BLOCK_S: f64 = 1.0;
/// What is gained there at least: moved places also hide what the calibration has left of scale and axes, which a right
/// angular rate does not. Chosen on simulated arrays: 0.7 % goes with a worse rate.
const LEAST_GAIN: f64 = 0.02;
/// How well the whole is tied down where rotation does not show it: shift, turn and size of all
/// places and the mean delay stay as they were given, m and s.
const TIED: f64 = 1e-7;
/// Arms are of this order, m: what makes turns and sizes of the array lengths.
const SCALE_M: f64 = 0.01;

/// What is known before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefineOptions {
    /// Standard deviation of each coordinate of each axis's place, m.
    pub place_sd_m: f64,
    /// Standard deviation of each sensor's delay, s.
    pub delay_sd_s: f64,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self {
            place_sd_m: 0.5e-3,
            delay_sd_s: 0.3e-3,
        }
    }
}

/// What a recording says about places and delays.
#[derive(Clone, Debug)]
pub struct Refinement {
    /// The geometry with what was found put in.
    pub geometry: ArrayGeometry,
    /// By how much each coordinate of each axis's place was moved, m.
    pub moved_m: Vec<[[f64; 3]; 3]>,
    /// Its standard deviation, m.
    pub place_sd_m: Vec<[[f64; 3]; 3]>,
    /// Each sensor's delay beyond the given one, s.
    pub delay_s: Vec<f64>,
    /// Its standard deviation, s.
    pub delay_sd_s: Vec<f64>,
    /// What no motion explains, m/s² rms an axis, median over the samples: before and after.
    pub residual_mps2: [f64; 2],
    /// Samples used.
    pub samples: usize,
    /// What the accelerometers differ by from the motion that the filter finds, m/s² (geometric mean), in blocks of the
    /// recording that nothing was fitted to: with the geometry as given, and refined by the other blocks.
    pub held_out_mps2: [f64; 2],
    /// Whether the refinement predicts those blocks better; otherwise the geometry is the given one.
    pub accepted: bool,
}

impl Refinement {
    /// How well a coordinate of a place is known after it, m: root mean square of the deviations.
    pub fn known_place_m(&self) -> f64 {
        root_mean_square(self.place_sd_m.iter().flatten().flatten())
    }

    /// The same of a delay, s.
    pub fn known_delay_s(&self) -> f64 {
        root_mean_square(self.delay_sd_s.iter())
    }
}

fn root_mean_square<'a>(values: impl Iterator<Item = &'a f64>) -> f64 {
    let (squares, count) = values.fold((0.0, 0.0), |(sum, n), v| (sum + v * v, n + 1.0));
    f64::sqrt(squares / f64::max(count, 1.0))
}

/// Estimates where each axis of an array is and how late each sensor samples, relative to the others;
/// `recording` is in body axes by `geometry` ([`ArrayRecording::arranged`]).
///
/// What rotation does not show stays as it was given: a shift, a turn or another size of the whole, and
/// a delay of all sensors. Places, and then delays, are changed only where what one half of the recording shows predicts
/// the other half better.
///
/// # Errors
/// `data_refused`: fewer than 200 samples of a body that turns, or an array in a plane; those of [`navigated`].
pub fn refine(
    recording: &ArrayRecording,
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
    options: &RefineOptions,
) -> Result<Refinement> {
    let fitted = |recording: &ArrayRecording, options: &RefineOptions, least: usize| {
        with_room!(
            geometry.sensors.len(),
            fit(recording, geometry, calibration, options, least)
        )
    };
    // First what is wrong with the whole.
    let mut whole = fitted(recording, options, LEAST_SAMPLES)?;
    let mut half = recording.clone();
    for (saturated, time_s) in half.saturated.iter_mut().zip(&recording.times_s) {
        if is_held_out(*time_s) {
            *saturated = u32::MAX;
        }
    }
    let places_only = RefineOptions {
        delay_sd_s: 0.0,
        ..*options
    };
    let tried = |geometry: &ArrayGeometry, delays_s: &[f64]| {
        with_room!(
            geometry.sensors.len(),
            unexplained(recording, geometry, delays_s, calibration)
        )
    };
    let mut trials = vec![tried(geometry, &[])?];
    for options in [&places_only, options] {
        let found = fitted(&half, options, LEAST_SAMPLES / 2)?;
        trials.push(tried(&found.geometry, &found.delay_s)?);
    }
    // Each over the same samples.
    let common = (0..recording.times_s.len()).filter_map(|k| {
        trials
            .iter()
            .map(|trial| trial[k])
            .collect::<Option<Vec<_>>>()
    });
    let common: Vec<Vec<f64>> = common.collect();
    let mean = |trial: usize| {
        let sum: f64 = common.iter().map(|all| all[trial]).sum();
        (0.5 * sum / common.len() as f64).exp()
    };
    let better = |new: usize, old: usize| mean(new) < (1.0 - LEAST_GAIN) * mean(old);
    let places = usize::from(better(1, 0));
    let best = if better(2, places) { 2 } else { places };
    if best == 1 {
        whole = fitted(recording, &places_only, LEAST_SAMPLES)?;
        whole.delay_sd_s.fill(options.delay_sd_s);
    }
    whole.accepted = best > 0;
    // What was rejected is reported as it would have been.
    whole.held_out_mps2 = [mean(0), mean(best.max(1))];
    if !whole.accepted {
        whole.geometry = geometry.clone();
    }
    Ok(whole)
}

fn is_held_out(time_s: f64) -> bool {
    (time_s / BLOCK_S) as i64 % 2 == 1
}

/// Logarithm of the mean square, (m/s²)², of what no motion with the filter's angular rate explains of each sample that is
/// held out; `None` where an output is missing or the body hardly turns.
fn unexplained<const M: usize>(
    recording: &ArrayRecording,
    geometry: &ArrayGeometry,
    delays_s: &[f64],
    calibration: &ArrayCalibration,
) -> Result<Vec<Option<f64>>> {
    let gravity = calibration.mean_rest_mps2(recording);
    let arranged = recording.clone().shifted(delays_s);
    let (states, _) = navigated(&arranged, geometry, calibration, gravity, Zupt::Stated)?;
    let axes = axes(geometry, calibration)?;
    let uses = |sensor: usize| calibration.uses(sensor);
    let solver = ArraySolver::<f64, M>::of(&axes, uses).map_err(refused)?;
    let freedom = (3 * recording.sensors()).saturating_sub(9).max(1) as f64;
    let length = |v: [f64; 3]| v.iter().map(|c| c * c).sum::<f64>().sqrt();
    let start = arranged.times_s.first().copied().unwrap_or_default();
    let first = recording.times_s.partition_point(|t| *t < start);
    let mut all = vec![None; recording.times_s.len()];
    for (index, (state, one)) in states.iter().zip(&mut all[first..]).enumerate() {
        let (rate, turn) = (state.rate_rad_s, state.angular_acceleration_rad_s2);
        let turns = length(rate).powi(2) > LEAST_TURN || length(turn) > LEAST_TURN;
        let whole = (0..recording.sensors()).all(|s| !uses(s) || arranged.has(index, s));
        if !(turns && whole && state.certainty > 0.0 && is_held_out(arranged.times_s[index])) {
            continue;
        }
        let output = sample::<M>(&arranged, calibration, index);
        let mut rest = solver.project(&output.map(|v| if v.is_nan() { 0.0 } else { v }));
        let (expected, _) = solver.expected_z(rate);
        for (row, z) in solver.z_rows().iter().zip(expected) {
            for (rest, value) in rest.iter_mut().zip(row) {
                *rest -= value * z;
            }
        }
        let sum = rest.iter().map(|r| (r * solver.variance_mps2()).powi(2));
        *one = Some((sum.sum::<f64>() / freedom).ln()).filter(|value| value.is_finite());
    }
    Ok(all)
}

fn fit<const M: usize>(
    recording: &ArrayRecording,
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
    options: &RefineOptions,
    least_samples: usize,
) -> Result<Refinement> {
    let has_delays = options.delay_sd_s > 0.0;
    let sensors = geometry.sensors.len();
    let moving = Moving::<M>::of(recording, calibration);
    let places = 9 * sensors;
    let unknowns = places + sensors;
    let mut found = vec![0.0; unknowns];
    let mut changed = geometry.clone();
    let mut residual = [0.0; 2];
    let mut covariance = DMatrix::zeros(unknowns, unknowns);
    let mut samples = 0;
    for pass in 0..=PASSES {
        let solver = ArraySolver::<f64, M>::of(&axes(&changed, calibration)?, |sensor| {
            calibration.uses(sensor)
        })
        .map_err(refused)?;
        if solver.rank() < 6 {
            return Err(refused(
                "an array in a plane does not show where its sensors are",
            ));
        }
        let sums = Sums::of(&solver, &moving, &found[places..]);
        samples = sums.samples;
        if samples < least_samples {
            return Err(HostError::new(
                ErrorCode::DataRefused,
                format!("the body turns fast enough in {samples} samples only"),
                "turn the array about all axes, fast, for half a minute, besides resting it in \
                 several orientations",
            )
            .at(&recording.name));
        }
        residual[1] = sums.median_residual;
        if pass == 0 {
            residual[0] = sums.median_residual;
        }
        // Prior and gauge.
        let mut normal = sums.normal.clone();
        let mut right = sums.right.clone();
        let mut before = DMatrix::zeros(unknowns, unknowns);
        for i in 0..unknowns {
            let sd = if i < places {
                options.place_sd_m
            } else {
                options.delay_sd_s.max(TIED)
            };
            before[(i, i)] += 1.0 / (sd * sd);
            right[i] -= found[i] / (sd * sd);
        }
        for tie in ties(geometry) {
            let along: f64 = tie.iter().zip(&found).map(|(t, f)| t * f).sum();
            for (i, a) in tie.iter().enumerate().filter(|(_, a)| **a != 0.0) {
                right[i] -= a * along / (TIED * TIED);
                for (j, b) in tie.iter().enumerate() {
                    before[(i, j)] += a * b / (TIED * TIED);
                }
            }
        }
        normal += &before;
        let factor = normal
            .cholesky()
            .ok_or_else(|| refused("places and delays cannot be told apart"))?;
        if pass < PASSES {
            let step = factor.solve(&right);
            for (value, step) in found.iter_mut().zip(&step) {
                *value += step;
            }
            for (sensor, (new, old)) in changed
                .sensors
                .iter_mut()
                .zip(&geometry.sensors)
                .enumerate()
            {
                for axis in 0..3 {
                    for c in 0..3 {
                        new.places_m[axis][c] =
                            old.places_m[axis][c] + found[9 * sensor + 3 * axis + c];
                    }
                }
                if has_delays {
                    new.delay_us = old.delay_us + 1e6 * found[places + sensor];
                }
            }
        } else {
            // Neighbouring samples err alike and motion is no white noise: the spread of what each
            // sample pulls counts, not its declared weight.
            covariance = sandwich(&factor, &(sums.spread + before));
        }
    }
    let sd = |i: usize| covariance[(i, i)].max(0.0).sqrt();
    let by_axis = |value: &dyn Fn(usize) -> f64| -> Vec<[[f64; 3]; 3]> {
        (0..sensors)
            .map(|s| {
                std::array::from_fn(|axis| std::array::from_fn(|c| value(9 * s + 3 * axis + c)))
            })
            .collect()
    };
    Ok(Refinement {
        moved_m: by_axis(&|i| found[i]),
        place_sd_m: by_axis(&sd),
        delay_s: (found[places..].iter())
            .map(|delay| if has_delays { *delay } else { 0.0 })
            .collect(),
        delay_sd_s: (0..sensors).map(|s| sd(places + s)).collect(),
        geometry: changed,
        residual_mps2: residual,
        samples,
        held_out_mps2: [f64::NAN; 2],
        accepted: true,
    })
}

/// Directions in which the whole would change: three shifts, three turns, size, delay of all.
fn ties(geometry: &ArrayGeometry) -> Vec<Vec<f64>> {
    let sensors = geometry.sensors.len();
    let unknowns = 10 * sensors;
    let mut all = Vec::new();
    let mut centre = [0.0; 3];
    for place in geometry.sensors.iter().flat_map(|s| s.places_m) {
        for c in 0..3 {
            centre[c] += place[c] / (3 * sensors) as f64;
        }
    }
    for kind in 0..7 {
        let mut tie = vec![0.0; unknowns];
        for (s, sensor) in geometry.sensors.iter().enumerate() {
            for (axis, place) in sensor.places_m.iter().enumerate() {
                let r: [f64; 3] = std::array::from_fn(|c| (place[c] - centre[c]) / SCALE_M);
                let moved = match kind {
                    0..=2 => std::array::from_fn(|c| f64::from(u8::from(c == kind))),
                    3 => [0.0, -r[2], r[1]],
                    4 => [r[2], 0.0, -r[0]],
                    5 => [-r[1], r[0], 0.0],
                    _ => r,
                };
                tie[9 * s + 3 * axis..][..3].copy_from_slice(&moved);
            }
        }
        all.push(tie);
    }
    let mut tie = vec![0.0; unknowns];
    tie[9 * sensors..].fill(1.0);
    all.push(tie);
    all
}

/// Samples of a moving body, and how their outputs change, m/s³.
struct Moving<const M: usize> {
    samples: Vec<([f64; M], [f64; M])>,
}

impl<const M: usize> Moving<M> {
    fn of(recording: &ArrayRecording, calibration: &ArrayCalibration) -> Self {
        let period = recording.period_s();
        let times = &recording.times_s;
        let all: Vec<[f64; M]> = (0..times.len())
            .map(|index| sample(recording, calibration, index))
            .collect();
        let used = |sensor: usize| calibration.uses(sensor);
        let samples = (2..all.len().saturating_sub(2))
            .filter_map(|k| {
                let even = times[k - 2..=k + 2]
                    .windows(2)
                    .all(|w| (w[1] - w[0] - period).abs() < 0.2 * period);
                let sound = all[k - 2..=k + 2].iter().all(|row| {
                    (0..recording.sensors())
                        .filter(|s| used(*s))
                        .all(|s| row[3 * s..3 * s + 3].iter().all(|v| v.abs() < 1e4))
                });
                if !(even && sound) {
                    return None;
                }
                let mut value = [0.0; M];
                let mut change = [0.0; M];
                for i in (0..M).filter(|i| i / 3 < recording.sensors() && used(i / 3)) {
                    value[i] = all[k][i];
                    // To the fourth order.
                    change[i] = (8.0 * (all[k + 1][i] - all[k - 1][i])
                        - (all[k + 2][i] - all[k - 2][i]))
                        / (12.0 * period);
                }
                Some((value, change))
            })
            .collect();
        Self { samples }
    }
}

/// The normal equations of a linearised fit.
struct Sums {
    normal: DMatrix<f64>,
    right: DVector<f64>,
    /// Σ of the squares of what each sample pulls.
    spread: DMatrix<f64>,
    samples: usize,
    median_residual: f64,
}

impl Sums {
    fn of<const M: usize>(
        solver: &ArraySolver<f64, M>,
        moving: &Moving<M>,
        delays_s: &[f64],
    ) -> Self {
        let sensors = delays_s.len();
        let unknowns = 10 * sensors;
        let outputs = 3 * sensors;
        // P, column by column.
        let projector: Vec<[f64; M]> = (0..outputs)
            .map(|i| {
                let mut unit = [0.0; M];
                unit[i] = 1.0;
                solver.project(&unit)
            })
            .collect();
        let z_rows = solver.z_rows();
        let mut sums = Self {
            normal: DMatrix::zeros(unknowns, unknowns),
            right: DVector::zeros(unknowns),
            spread: DMatrix::zeros(unknowns, unknowns),
            samples: 0,
            median_residual: 0.0,
        };
        let mut residuals = Vec::new();
        let freedom = (outputs.saturating_sub(9)).max(1) as f64;
        for (value, change) in &moving.samples {
            let mut y = *value;
            for i in 0..outputs {
                y[i] -= delays_s[i / 3] * change[i];
            }
            let linear = solver.reduce(&y);
            let solution = solver.roots_of(&linear);
            let Some(best) = solution.hypotheses().next() else {
                continue;
            };
            let w = best.rate_rad_s;
            let a = best.angular_acceleration_rad_s2;
            let square: f64 = w.iter().map(|v| v * v).sum();
            let turn: f64 = a.iter().map(|v| v * v).sum::<f64>().sqrt();
            if square < LEAST_TURN && turn < LEAST_TURN {
                continue;
            }
            // P (y − K q(ω)), and P without what another ω would explain.
            let (expected, slope) = solver.expected_z(w);
            let mut rest = solver.project(&y);
            for (row, z) in z_rows.iter().zip(expected) {
                for (r, v) in rest.iter_mut().zip(row) {
                    *r -= v * z;
                }
            }
            let mut information = Matrix3::<f64>::zeros();
            for row in &slope {
                for i in 0..3 {
                    for j in 0..3 {
                        information[(i, j)] += row[i] * row[j];
                    }
                }
            }
            let shown = information.determinant() > 1e-9 * information.trace().powi(3);
            let Some(inverse) = information.try_inverse().filter(|_| shown) else {
                continue;
            };
            // Zᵀ J, in the outputs.
            let mut along = vec![[0.0; 3]; outputs];
            for (row, slope) in z_rows.iter().zip(&slope) {
                for (i, sum) in along.iter_mut().enumerate() {
                    for c in 0..3 {
                        sum[c] += row[i] * slope[c];
                    }
                }
            }
            let apart = |i: usize, j: usize| {
                let mut value = projector[j][i];
                for c in 0..3 {
                    for d in 0..3 {
                        value -= along[i][c] * inverse[(c, d)] * along[j][d];
                    }
                }
                value
            };
            // In units of the declared variance, per degree of freedom: P is a projector but for the
            // weights.
            let size = rest.iter().map(|r| r * r).sum::<f64>() * solver.variance_mps2() / freedom;
            residuals.push((size * solver.variance_mps2()).sqrt());
            sums.samples += 1;
            let weight = 1.0 / size.max(1.0);
            // W r: how a place shows in the outputs.
            let tensor = rotation_tensor(w, a);
            let mut parts: Vec<(usize, usize, f64)> = Vec::with_capacity(12 * sensors);
            for i in 0..outputs {
                for c in 0..3 {
                    parts.push((3 * i + c, i, tensor[i % 3][c]));
                }
                parts.push((9 * sensors + i / 3, i, change[i]));
            }
            let mut pull = vec![0.0; unknowns];
            for (p, i, value) in &parts {
                pull[*p] += value * rest[*i] * weight;
            }
            let between: Vec<Vec<f64>> = (0..outputs)
                .map(|i| (0..outputs).map(|j| apart(i, j) * weight).collect())
                .collect();
            for (p, i, a) in &parts {
                for (q, j, b) in &parts {
                    if q <= p {
                        sums.normal[(*p, *q)] += a * b * between[*i][*j];
                    }
                }
            }
            for p in 0..unknowns {
                sums.right[p] += pull[p];
                for q in 0..=p {
                    sums.spread[(p, q)] += pull[p] * pull[q];
                }
            }
        }
        sums.normal.fill_upper_triangle_with_lower_triangle();
        sums.spread.fill_upper_triangle_with_lower_triangle();
        residuals.sort_by(f64::total_cmp);
        sums.median_residual = residuals.get(residuals.len() / 2).copied().unwrap_or(0.0);
        sums
    }
}

/// [ω̇]× + [ω]×².
fn rotation_tensor([x, y, z]: [f64; 3], [a, b, c]: [f64; 3]) -> [[f64; 3]; 3] {
    [
        [-y * y - z * z, x * y - c, x * z + b],
        [x * y + c, -x * x - z * z, y * z - a],
        [x * z - b, y * z + a, -x * x - y * y],
    ]
}

/// N⁻¹ S N⁻¹.
pub(super) fn sandwich(factor: &Cholesky<f64, Dyn>, spread: &DMatrix<f64>) -> DMatrix<f64> {
    factor.solve(&factor.solve(spread).transpose())
}
