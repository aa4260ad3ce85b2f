//! Calibration of the gyroscope from one full rotation about each axis.

use std::f64::consts::TAU;
use std::rc::Rc;

use wimu_host::Result;
use wimu_host::capture::Capture;
use wimu_host::decode::TimedSample;
use wimu_model::{GyroscopeModel, GyroscopeParameters, GyroscopeTerms};

use super::host::Host;
use super::{MARGIN_S, Played, lacks};
use crate::board::VirtualBoard;
use crate::motion::{Rest, Sequence, Slide};

/// Rest before and after a rotation, and duration of a rotation, s.
const REST_S: f64 = 2.0;
const ROTATION_S: f64 = 4.0;
const ONE_S: f64 = 2.0 * REST_S + ROTATION_S;
/// Full-scale range of the gyroscope, °/s.
const RANGE_DPS: u16 = 2000;

impl<R: VirtualBoard> Host<'_, R> {
    /// Rotates the level board by 360° about x, y and z.
    pub(super) fn rotate(&mut self) -> Result<Played> {
        self.play(Rc::new(Rest::level(0.5)))?;
        let rotation = |axis: usize| -> Rc<dyn crate::motion::Motion> {
            let mut rotation_rad = [0.0; 3];
            rotation_rad[axis] = TAU;
            Rc::new(Slide {
                distance_m: 0.0,
                rotation_rad,
                move_s: ROTATION_S,
                rest_before_s: REST_S,
                rest_after_s: REST_S,
                ..Slide::default()
            })
        };
        self.play(Rc::new(Sequence::new([0, 1, 2].map(rotation))))
    }
}

/// The parameters found in these `rotations`: y − b, integrated over a rotation about axis j, is 2π times column
/// j of the matrix. The bias b is the mean at rest; g-sensitivity is not separated from it.
pub(super) fn calibrate(rotations: Played, recording: &Capture) -> Result<GyroscopeParameters> {
    let boot = rotations.boot(recording)?;
    let scale = boot.epochs().last().and_then(|mark| mark.epoch.gyroscope);
    let rad_s_per_lsb = scale.ok_or_else(|| lacks("a gyroscope"))?.rad_s_per_lsb;
    let within = |from_s: f64, to_s: f64| -> Vec<&TimedSample> {
        let times = from_s..to_s;
        let is_within =
            |sample: &&TimedSample| times.contains(&rotations.since_begin_s(sample.time));
        boot.raw().iter().filter(is_within).collect()
    };
    let rate = |sample: &TimedSample| sample.rate.unwrap_or_default().map(f64::from);
    let mut matrix = [[0.0; 3]; 3];
    let mut bias_rad_s = [0.0; 3];
    for axis in 0..3 {
        let begin_s = axis as f64 * ONE_S;
        let rest = within(begin_s + MARGIN_S, begin_s + REST_S - MARGIN_S);
        let mean = |row: usize| {
            rest.iter().map(|sample| rate(sample)[row]).sum::<f64>() / rest.len() as f64
        };
        let bias = [0, 1, 2].map(mean);
        let moving = within(begin_s + REST_S - MARGIN_S, begin_s + REST_S + ROTATION_S + MARGIN_S);
        for row in 0..3 {
            // The trapezoidal rule.
            let angle: f64 = moving
                .windows(2)
                .map(|pair| {
                    let dt = pair[1].time.to_seconds() - pair[0].time.to_seconds();
                    (rate(pair[0])[row] + rate(pair[1])[row] - 2.0 * bias[row]) / 2.0 * dt
                })
                .sum();
            matrix[row][axis] = angle * rad_s_per_lsb / TAU;
            bias_rad_s[row] += bias[row] * rad_s_per_lsb / 3.0;
        }
    }
    let model =
        GyroscopeModel::new(GyroscopeTerms { bias_rad_s, matrix, ..GyroscopeTerms::default() });
    let bad = || lacks("usable rotations of the gyroscope");
    GyroscopeParameters::new(RANGE_DPS, rad_s_per_lsb, model.map_err(|_| bad())?, None)
        .map_err(|_| bad())
}
