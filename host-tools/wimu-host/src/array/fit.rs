//! The fit of an array ([`wimu_calib::array`]) for recordings: conversion, and whether the sensors agree.

use wimu_calib::array::{ArrayData, ArrayEstimate, ArrayPrior, fit_array};
use wimu_model::geometry::Geometry;
use wimu_model::{ErrorModel, ErrorTerms};
use wimu_nav::array::ArraySolver;

use super::motion::{axes, check, refused, with_room};
use super::{Array, ArrayCalibration, ArrayGeometry};
use crate::{Code, Problem, Result};

/// Samples in motion that are used, about.
const MOST_SAMPLES: usize = 2000;
/// Fraction of the variance among the sensors that no motion explains, from which on the geometry is not this array's.
const CONTRADICTION: f64 = 0.15;
/// Error of the size of a geometry that is reported: it makes the angular rate wrong by half of it.
const SIZE: f64 = 0.1;

/// Agreement of the outputs of a moving array with the motion of one rigid body, equation (101).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// Samples in which the sensors differ by far more than their noise.
    pub samples: usize,
    /// Fraction of the variance among the sensors that no motion explains.
    pub unexplained: f64,
    /// That part, m/s² rms per axis.
    pub unexplained_mps2: f64,
    /// The sensor with the largest residual (from 0).
    pub worst: usize,
    /// A sensor whose estimated bias and matrix are beyond the bounds of an error model.
    pub beyond: Option<usize>,
    /// Bounds of the size of the geometry over that of the array, from ω and ω̇; `None` with too few samples in motion.
    pub size: Option<[f64; 2]>,
}

impl Agreement {
    /// Refuses sensors that contradict each other.
    ///
    /// # Errors
    /// `data_refused`, with what to check.
    pub fn check(&self, name: &str) -> Result<()> {
        let what = match self.beyond {
            Some(sensor) => format!(
                "only with scale factors or misalignments beyond the bounds of a model does sensor {sensor} (from 0) measure the motion \
                 of the others"
            ),
            None if self.unexplained > CONTRADICTION => format!(
                "{:.0} % of the variance among them in motion fits no motion of one rigid body; sensor {} (from 0) \
                 fits worst",
                100.0 * self.unexplained,
                self.worst
            ),
            None => return Ok(()),
        };
        Err(contradiction(name, &what))
    }

    /// The agreement, and the size of the array where it is not that of the geometry.
    pub fn findings(&self) -> Vec<Problem> {
        let mut findings = vec![Code::Geometry.note(format!(
            "{:.1} % of the variance among the sensors in motion, {:.3} m/s² rms, fits no motion of one rigid body",
            100.0 * self.unexplained,
            self.unexplained_mps2
        ))];
        let other = self.size.filter(|[least, most]| *least > 1.0 + SIZE || *most < 1.0 - SIZE);
        if let Some([least, most]) = other {
            let text = format!(
                "the positions are {least:.2} to {most:.2} times as far apart as the sensors: the changes of the angular rate \
                 are not the integral of the angular acceleration"
            );
            let remedy = "check the unit of the positions and the distances between the sensors";
            findings.push(Code::Geometry.warning(text).remedy(remedy));
        }
        findings
    }
}

/// Refusal of sensors whose outputs are not those of one rigid body.
pub(super) fn contradiction(name: &str, what: &str) -> Problem {
    Code::DataRefused.error(format!("the sensors contradict each other: {what}"),
        "check the geometry: the order of the sensors, the signs of their positions, and the directions of their \
         axes. If they are right, calibrate the sensors: hold the array still in a dozen orientations, \
         `wimu calibrate RESTS.csv --setup geometry=PLACES.csv -o ARRAY.json`, and navigate with --setup geometry=ARRAY.json",
    )
    .at(name)
}

/// Values of a fit with their standard deviations.
#[derive(Clone, Debug)]
pub(super) struct Fitted {
    /// Model of each sensor, in body axes; `None` beyond the bounds of a model.
    pub models: Vec<Option<ErrorModel>>,
    /// Standard deviations of its bias, m/s², and of its matrix.
    pub model_sd: Vec<([f64; 3], [[f64; 3]; 3])>,
    /// Standard deviation of an entry of a matrix against those of the other sensors.
    pub matrix_sd: f64,
    /// Correction of each coordinate of the position of each axis, m.
    moved_m: Vec<[[(f64, f64); 3]; 3]>,
    pub agreement: Option<Agreement>,
}

impl Fitted {
    /// Fits rests and motion of a recording in body axes.
    pub fn of(
        recording: &Array,
        geometry: &ArrayGeometry,
        calibration: &ArrayCalibration,
        prior: &ArrayPrior,
    ) -> Result<Self> {
        check(recording, geometry)?;
        with_room!(geometry.sensors.len(), in_motion(recording, geometry, calibration, prior))
    }

    fn new<const M: usize>(
        found: &ArrayEstimate<M>,
        sensors: usize,
        used: &dyn Fn(usize) -> bool,
    ) -> Self {
        let axes = |sensor: usize| [0, 1, 2].map(|i| 3 * sensor + i);
        let model = |sensor: usize| {
            let matrix = axes(sensor).map(|a| found.matrix(a).map(|(value, _)| value));
            let mut terms = ErrorTerms {
                bias_mps2: axes(sensor).map(|a| found.bias_mps2(a).0),
                ..ErrorTerms::default()
            };
            for (row, more) in terms.matrix.iter_mut().zip(matrix) {
                for (value, more) in row.iter_mut().zip(more) {
                    *value += more;
                }
            }
            ErrorModel::new(terms).ok()
        };
        let all = || 0..sensors;
        let agreement = &found.agreement;
        let models: Vec<_> = all().map(model).collect();
        Self {
            model_sd: all()
                .map(|s| {
                    (
                        axes(s).map(|a| found.bias_mps2(a).1),
                        axes(s).map(|a| found.matrix(a).map(|(_, sd)| sd)),
                    )
                })
                .collect(),
            matrix_sd: found.matrix_sd(used),
            moved_m: all().map(|s| axes(s).map(|a| found.offset_m(a))).collect(),
            agreement: (agreement.samples > 0).then(|| Agreement {
                samples: agreement.samples,
                unexplained: agreement.unexplained,
                unexplained_mps2: agreement.residual_mps2,
                worst: agreement.worst(),
                beyond: all().find(|s| used(*s) && models[*s].is_none()),
                size: agreement.size,
            }),
            models,
        }
    }

    /// Standard deviation of a coordinate of the positions as given, m, at most that stated: the estimate that maximises the
    /// evidence (MacKay, "Bayesian Interpolation", Neural Computation 4, 1992), the stated value as one more coordinate.
    pub fn shown_position_sd_m(&self, calibration: &ArrayCalibration, stated: f64) -> f64 {
        let used = (0..self.moved_m.len()).filter(|s| calibration.uses(*s));
        let (mut squares, mut determined) = (stated * stated, 1.0);
        for (value, sd) in used.flat_map(|s| self.moved_m[s].as_flattened()) {
            squares += value * value;
            determined += (1.0 - (sd / stated).powi(2)).max(0.0);
        }
        (squares / determined).sqrt().min(stated)
    }
}

fn solved<const M: usize>(
    geometry: &Geometry<M>,
    sensors: usize,
    used: &dyn Fn(usize) -> bool,
    data: &ArrayData<'_, M>,
    prior: &ArrayPrior,
) -> Result<Fitted> {
    let found = fit_array(geometry, used, data, prior).map_err(refused)?;
    Ok(Fitted::new(&found, sensors, used))
}

fn row<const M: usize>(recording: &Array, index: usize) -> [f64; M] {
    let mut row = [f64::NAN; M];
    for sensor in (0..recording.sensors()).filter(|sensor| recording.has(index, *sensor)) {
        row[3 * sensor..3 * sensor + 3].copy_from_slice(recording.output(index, sensor).as_slice());
    }
    row
}

fn in_motion<const M: usize>(
    recording: &Array,
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
    prior: &ArrayPrior,
) -> Result<Fitted> {
    let used = |sensor: usize| calibration.uses(sensor);
    let axes = axes::<M>(geometry, calibration)?;
    // Says of positions that show no rotation why.
    ArraySolver::<M>::of(&axes, used).map_err(refused)?;
    let (times_s, count) = (recording.times_s(), recording.len());
    let rests: usize = calibration.rests.iter().map(|(_, count)| count).sum();
    let outputs: Vec<[f64; M]> = (0..count).map(|index| row(recording, index)).collect();
    let data = ArrayData {
        times_s: &times_s,
        outputs_mps2: &outputs,
        rests: &calibration.rests,
        period_s: recording.period_s(),
        stride: count.saturating_sub(rests).div_ceil(MOST_SAMPLES),
    };
    solved(&axes, recording.sensors(), &used, &data, prior)
}

/// Fits biases and matrices to the rests alone.
pub(super) fn at_rests<const M: usize>(
    recording: &Array,
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
    prior: &ArrayPrior,
) -> Result<Fitted> {
    let used = |sensor: usize| calibration.uses(sensor);
    let axes = axes::<M>(geometry, calibration)?;
    let all_s = recording.times_s();
    let (mut times_s, mut outputs, mut rests) = (Vec::new(), Vec::new(), Vec::new());
    for (first, count) in &calibration.rests {
        rests.push((outputs.len(), *count));
        outputs.extend((*first..first + count).map(|index| row::<M>(recording, index)));
        times_s.extend_from_slice(&all_s[*first..first + count]);
    }
    let data = ArrayData {
        times_s: &times_s,
        outputs_mps2: &outputs,
        rests: &rests,
        period_s: recording.period_s(),
        stride: 1,
    };
    solved(&axes, recording.sensors(), &used, &data, prior)
}
