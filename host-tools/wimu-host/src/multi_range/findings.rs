//! Findings on merged accelerometers.

use nalgebra::Matrix3;
use wimu_model::STANDARD_GRAVITY_MPS2;
use wimu_nav::sensor::Reading;

use super::fit::{BIAS_MPS2, Fit, MATRIX, rotation_deg};
use super::{Sensor, WIDER};
use crate::{Code, Problem, Result};

/// Standard deviation of an element of the matrix up to which a recording shows it.
const OBSERVED: f64 = 0.02;
/// Squared deviations from the prior, of a bias and a row of the matrix, that no calibration error explains: χ² with four
/// degrees of freedom, probability 10⁻⁵.
const DEPARTS: f64 = 28.5;
/// A rotation beyond this, deg, is no misalignment of a chip on a board.
const TURNED_DEG: f64 = 10.0;
/// Fraction of the motion's variance that two accelerometers on one body do not leave unexplained.
const UNEXPLAINED: f64 = 0.1;
/// Standard deviations from which on a delay or a clock error is reported, and the least delay, s, and clock error.
const SEEN: f64 = 4.0;
const LATE_S: f64 = 5e-4;
const FAST: f64 = 50e-6;

/// Largest sample of an accelerometer over its nominal full scale. Chosen: MEMS datasheets allow a scale factor error of 10 %,
/// and a bias of some percent of the range.
const EXCEEDS: f64 = 1.25;

/// Whether the samples contradict the full scales that were given, in ascending order.
pub(super) fn contradicted(sensors: &[Sensor]) -> Result<()> {
    let is_same = |pair: &&[Sensor]| pair[0].series.v == pair[1].series.v;
    if let Some([a, b]) = sensors.windows(2).find(is_same) {
        return Err(Code::DataRefused.error(
            format!("accelerometers {} and {} have the same samples", a.sensor, b.sensor),
            "name the files of different accelerometers",
        ));
    }
    for sensor in sensors {
        let most = sensor.series.v.iter().fold(0.0, |most: f64, force| most.max(force.amax()));
        if most > EXCEEDS * sensor.full_scale {
            return Err(Code::Usage.error(
                format!(
                    "accelerometer {} has samples of {:.3} g",
                    sensor.name(),
                    most / STANDARD_GRAVITY_MPS2
                ),
                "give `--setup full_scales_g=[…]` in g, in the order of the accelerometers",
            ));
        }
    }
    Ok(())
}

/// Findings on the calibration of `coarse`.
pub(super) fn judged(finest: &Sensor, coarse: &Sensor, fit: &Fit) -> Result<Vec<Problem>> {
    let mut findings = Vec::new();
    let [fine_name, fit_name] = [finest, coarse].map(Sensor::name);
    if fit.unexplained > UNEXPLAINED && fit.misfit > 25.0 {
        return Err(Code::DataRefused.error(
            format!(
                "accelerometers {} and {} do not measure one motion: {:.0} % of it differ",
                fine_name,
                fit_name,
                100.0 * fit.unexplained
            ),
            "check that both are on one body, and that their clocks differ by less than 2 s",
        ));
    }
    let model = &fit.model;
    let matrix_sd = model.covariance.diagonal().rows(1, 3).max().sqrt();
    let observed = matrix_sd < OBSERVED;
    let off = (model.matrix - Matrix3::identity()) / MATRIX;
    let departs = (0..3).any(|axis| {
        (model.bias_mps2[axis] / BIAS_MPS2).powi(2) + off.row(axis).norm_squared() > DEPARTS
    });
    let rotation = rotation_deg(&fit.model.matrix);
    match (observed, departs, rotation) {
        (false, true, _) => {
            return Err(Code::DataRefused.error(
                format!(
                    "accelerometer {fit_name} is rotated against {}, and the recording does not determine the rotation",
                    fine_name
                ),
                "begin with a rest on each of three sides, or record units that are mounted alike",
            ));
        }
        (true, _, None) => findings.push(Code::Axes.warning(format!(
            "the axes of accelerometer {fit_name} are mirrored against those of {}: corrected",
            fine_name
        ))),
        (true, _, Some(deg)) if deg > TURNED_DEG => {
            let text = format!(
                "accelerometer {fit_name} is rotated by {deg:.0}° against {}: corrected",
                fine_name
            );
            findings.push(Code::Axes.warning(text));
        }
        (false, ..) => findings.push(
            Code::NotObserved
                .warning(format!(
                    "scale factors of accelerometer {fit_name} are known to ± {:.1} % only",
                    100.0 * matrix_sd
                ))
                .remedy("begin with a rest on each of three sides, or with motion within the finer range"),
        ),
        _ => {}
    }
    let [fine_hz, coarse_hz] = [finest, coarse].map(|sensor| 1.0 / sensor.series.period_s());
    if coarse_hz * WIDER < fine_hz {
        findings.push(Code::Rate.warning(format!(
            "accelerometer {fit_name} has {coarse_hz:.0} Hz and {} {fine_hz:.0} Hz: impacts shorter than {:.0} ms are not \
             resolved",
            fine_name,
            4e3 / coarse_hz
        )));
    }
    let clock = &fit.clock;
    if clock.drift.abs() > (SEEN * clock.drift_sd).max(FAST) {
        let (ppm, side) = (1e6 * clock.drift, if clock.drift > 0.0 { "fast" } else { "slow" });
        findings.push(Code::Clock.warning(format!(
            "the clock of accelerometer {fit_name} is {:.0} ppm {side}: corrected",
            ppm.abs()
        )));
    }
    if clock.delay_s.abs() > (SEEN * clock.delay_sd_s).max(LATE_S) {
        let side = if clock.delay_s > 0.0 { "late" } else { "early" };
        findings.push(Code::Clock.note(format!(
            "accelerometer {fit_name} is {:.2} ± {:.2} ms {side}: corrected",
            1e3 * clock.delay_s.abs(),
            1e3 * clock.delay_sd_s
        )));
    }
    Ok(findings)
}

/// A warning on samples in which no accelerometer measures an axis.
pub(super) fn saturated(readings: &[[Reading; 3]], sensors: &[Sensor]) -> Option<Problem> {
    let limited = |reading: &Reading| matches!(reading, Reading::AtLeast(_) | Reading::AtMost(_));
    let is_lost = |readings: &&[Reading; 3]| readings.iter().any(limited);
    let times = sensors.first()?.series.t.iter();
    let mut lost = readings.iter().zip(times).filter(|(r, _)| is_lost(r));
    let first_s = lost.next()?.1.s();
    Some(Code::Saturated.warning(format!(
        "all accelerometers are saturated in {}, first at {first_s:.2} s: left out",
        crate::plural::counted(1 + lost.count(), "sample")
    )))
}
