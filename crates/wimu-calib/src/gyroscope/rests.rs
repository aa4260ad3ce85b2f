//! Rests and turns of a session.

use alloc::vec::Vec;
use core::ops::Range;

use nalgebra::{Matrix3, Vector3};
use wimu_model::SpecificForceMps2;

use super::turn::Turn;
use super::{AccelerometerCalibration, GyroscopeSession, SixAxisSample, Theta, TurnFault};
use crate::Pose;
use crate::estimate::Residuals;

/// Full-scale ranges of gyroscopes, rad/s: 125, 245, 250, 500, 1000, 2000, 4000 °/s; how near to one the
/// largest output of a clipped axis is, relative; and how many samples in a row are equal to it.
const RANGES_RAD_S: [f64; 7] = [2.182, 4.276, 4.363, 8.727, 17.453, 34.907, 69.813];
const NEAR: f64 = 0.03;
const IN_A_ROW: u32 = 3;
/// No gyroscope has a step of its output beyond this, rad/s: whole °/s are the coarsest.
const COARSEST_RAD_S: f64 = 0.02;
/// Part of the full-scale range from which on an output counts as saturated.
const SATURATED: f64 = 0.998;

/// A rest without this part of it at either end is without rotation: turns of up to four seconds that begin and end smoothly
/// lose 0.4 % of their angle in the rests beside them.
const EDGE: usize = 4;

/// What is measured at a rest.
#[derive(Clone, Copy)]
pub(super) struct Rest {
    /// Direction of the specific force, a unit vector.
    pub up: Vector3<f64>,
    /// Corrected specific force, m/s², and the variance of an axis.
    pub force: Vector3<f64>,
    pub force_variance: f64,
    /// Mean output of the gyroscope, rad/s, and variance of a sample of an axis.
    pub rate: Vector3<f64>,
    pub rate_variance: f64,
    pub samples: f64,
    pub length_s: f64,
}

/// A session, with the outputs from which on each axis is saturated and the turns left out.
pub(super) struct Session<'a> {
    pub given: &'a GyroscopeSession<'a>,
    pub limits_rad_s: [f64; 3],
    /// Variance of the mean of an axis at a rest that quantisation leaves, (rad/s)².
    pub rounding: Vector3<f64>,
    pub contradicted: Vec<usize>,
}

/// From the output of the gyroscope to the angular rate.
pub(super) struct Rates<'a> {
    pub inverse: Matrix3<f64>,
    pub bias: Vector3<f64>,
    pub g_sensitivity: Matrix3<f64>,
    limits_rad_s: [f64; 3],
    accelerometer: &'a AccelerometerCalibration,
}

impl Rates<'_> {
    /// Angular rate, rad/s, and corrected specific force, m/s².
    pub fn of(&self, sample: &SixAxisSample) -> [Vector3<f64>; 2] {
        let force = self.accelerometer.force(sample.output_mps2, None);
        let output = Vector3::from(sample.rate_rad_s);
        [self.inverse * (output - self.bias - self.g_sensitivity * force), force]
    }

    /// A saturated axis of a sample.
    pub fn saturated(&self, sample: &SixAxisSample) -> Option<usize> {
        let axes = sample.rate_rad_s.iter().zip(self.limits_rad_s);
        axes.into_iter().position(|(rate, limit)| rate.abs() >= limit)
    }
}

impl<'a> Session<'a> {
    pub fn new(given: &'a GyroscopeSession<'a>) -> Self {
        let limits_rad_s = match given.full_scale_rad_s {
            Some(range) => [SATURATED * range; 3],
            None => [0, 1, 2].map(|axis| limit(given.samples, axis)),
        };
        let mut session =
            Self { given, limits_rad_s, rounding: Vector3::zeros(), contradicted: Vec::new() };
        let changes = given.samples.windows(2).flat_map(|pair| {
            let [before, after] = [pair[0], pair[1]].map(|sample| sample.rate_rad_s);
            [0, 1, 2].map(|axis| (after[axis] - before[axis]).abs())
        });
        let step = changes.filter(|change| *change > 0.0).fold(f64::INFINITY, f64::min);
        if step < COARSEST_RAD_S {
            session.rounding = Vector3::from_fn(|axis, _| session.rounding(step, axis));
        }
        session
    }

    /// Quantisation error of the mean at a rest, which more samples do not reduce: equation (59) with the smallest step of all
    /// axes.
    fn rounding(&self, step: f64, axis: usize) -> f64 {
        let (mut squares, mut freedom) = (0.0, 0.0);
        for samples in self.given.poses.iter().filter_map(|pose| self.samples(pose)) {
            let rates = || samples.iter().map(|sample| sample.rate_rad_s[axis]);
            let mean = rates().sum::<f64>() / samples.len() as f64;
            squares += rates().map(|rate| (rate - mean) * (rate - mean)).sum::<f64>();
            freedom += samples.len() as f64 - 1.0;
        }
        let left = (step * step - 4.0 * squares / freedom) / 12.0;
        if left.is_finite() { left.max(0.0) } else { 0.0 }
    }

    /// `None` if its samples are not there, or not finite.
    pub fn rest(&self, pose: &Pose) -> Option<Rest> {
        let samples = self.samples(pose)?;
        let count = samples.len() as f64;
        let vectors = || samples.iter().map(|s| Vector3::from(s.rate_rad_s));
        let rate = vectors().sum::<Vector3<f64>>() / count;
        let squares: f64 = vectors().map(|y| (y - rate).norm_squared()).sum();
        let accelerometer = self.given.accelerometer;
        let force = accelerometer.force(pose.mean_mps2, pose.temperature_c);
        let rest = Rest {
            up: force.try_normalize(1e-3)?,
            force,
            force_variance: (accelerometer.rms_mps2 * accelerometer.rms_mps2)
                .max(pose.mean_noise()),
            rate,
            rate_variance: squares / (3.0 * (count - 1.0).max(1.0)),
            samples: count,
            length_s: length_s(samples),
        };
        (rate.norm() < 1e9 && force.norm() < 1e9).then_some(rest)
    }

    pub fn rests(&self) -> impl Iterator<Item = Rest> {
        self.given.poses.iter().filter_map(|pose| self.rest(pose))
    }

    fn samples(&self, pose: &Pose) -> Option<&'a [SixAxisSample]> {
        self.given.samples.get(inner(pose)?)
    }

    /// From the last sample of rest `k` to the first of the next.
    fn between(&self, k: usize) -> &'a [SixAxisSample] {
        let rest = |k: usize| self.given.poses.get(k).and_then(inner);
        let ends = rest(k).zip(rest(k + 1));
        let samples = ends.and_then(|(before, after)| {
            self.given.samples.get(before.end.checked_sub(1)?..after.start.checked_add(1)?)
        });
        samples.unwrap_or_default()
    }

    /// Time between the middles of rest `k` and the next.
    pub fn apart_s(&self, k: usize, rests: [&Rest; 2]) -> f64 {
        let [before, after] = rests.map(|rest| 0.5 * rest.length_s);
        before + length_s(self.between(k)) + after
    }

    /// The turn after rest `k`.
    pub fn turn(&self, k: usize, rates: &Rates<'_>) -> Result<Turn, TurnFault> {
        if self.contradicted.contains(&k) {
            Err(TurnFault::Contradicted)
        } else {
            Turn::integrate(self.between(k), rates)
        }
    }

    /// The turns that are not used.
    pub fn left_out(&self, theta: &Theta) -> Vec<(usize, TurnFault)> {
        let turns = 0..self.given.poses.len().saturating_sub(1);
        let rates = self.rates(theta);
        turns.filter_map(|k| Some((k, self.turn(k, rates.as_ref()?).err()?))).collect()
    }

    /// `None` if A cannot be inverted.
    pub fn rates(&self, theta: &Theta) -> Option<Rates<'a>> {
        let matrix = |at| Matrix3::from_row_slice(theta.fixed_rows::<9>(at).as_slice());
        Some(Rates {
            inverse: matrix(3).try_inverse()?,
            bias: theta.fixed_rows::<3>(0).into(),
            g_sensitivity: matrix(12),
            limits_rad_s: self.limits_rad_s,
            accelerometer: self.given.accelerometer,
        })
    }

    /// Errors of the predicted directions if the rate is `matrix` times the output, without its mean at
    /// the rest before if `centred`.
    pub fn angles(&self, matrix: Matrix3<f64>, centred: bool) -> Residuals {
        let mut rates = Rates {
            inverse: matrix,
            bias: Vector3::zeros(),
            g_sensitivity: Matrix3::zeros(),
            limits_rad_s: self.limits_rad_s,
            accelerometer: self.given.accelerometer,
        };
        let pairs = self.rests().zip(self.rests().skip(1)).enumerate();
        Residuals::of(pairs.filter_map(|(k, (before, after))| {
            if centred {
                rates.bias = before.rate;
            }
            let turn = self.turn(k, &rates).ok()?;
            Some((k, turn.attitude.tr_mul(&before.up).angle(&after.up)))
        }))
    }
}

/// The samples of a rest without its first and last part: an accelerometer sees the slow beginning of a turn late, and the
/// rotation there is part of the turn.
fn inner(pose: &Pose) -> Option<Range<usize>> {
    let (first, count) = (usize::try_from(pose.first_sample).ok()?, pose.samples as usize);
    let cut = count / EDGE;
    let end = first.checked_add(count)?;
    (count > 0).then_some(first + cut..end - cut)
}

fn length_s(samples: &[SixAxisSample]) -> f64 {
    let steps = samples.iter().map(|sample| sample.step_s).skip(1);
    steps.filter(|step| *step > 0.0 && *step < 1e6).sum()
}

/// The output from which on an axis of unknown range is saturated; infinite if it is not seen to clip.
fn limit(samples: &[SixAxisSample], axis: usize) -> f64 {
    let sizes = || samples.iter().map(|sample| sample.rate_rad_s[axis].abs());
    let most = sizes().filter(|size| size.is_finite()).fold(0.0, f64::max);
    let (mut run, mut longest) = (0, 0);
    for size in sizes() {
        run = if size == most { run + 1 } else { 0 };
        longest = run.max(longest);
    }
    let is_range = |range: &f64| (most / range - 1.0).abs() < NEAR;
    if longest >= IN_A_ROW && RANGES_RAD_S.iter().any(is_range) { most } else { f64::INFINITY }
}

impl AccelerometerCalibration {
    /// Corrected specific force, m/s², from the output.
    pub(super) fn force(&self, output_mps2: [f64; 3], celsius: Option<f64>) -> Vector3<f64> {
        let temperature = celsius.map(wimu_model::CentiCelsius::from_celsius);
        let output = SpecificForceMps2(output_mps2);
        self.model.correct(output, temperature).0.into()
    }

    /// A⁻¹.
    pub(super) fn inverse(&self) -> Matrix3<f64> {
        let rows = self.model.terms().matrix;
        let matrix = Matrix3::from_row_slice(rows.as_flattened());
        matrix.try_inverse().unwrap_or_else(Matrix3::identity)
    }
}
