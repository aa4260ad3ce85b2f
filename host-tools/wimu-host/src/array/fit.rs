//! The fit of an array ([`wimu_calib::array`]) for recordings: conversion, and what its estimates mean for a geometry.

use wimu_calib::array::{ArrayData, ArrayEstimate, ArrayPrior, fit_array};
use wimu_model::geometry::Geometry;
use wimu_model::{ErrorModel, ErrorTerms};
use wimu_nav::array::ArraySolver;

use super::motion::{axes, check, refused, with_room};
use super::{Array, ArrayCalibration, ArrayGeometry};
use crate::{Code, Problem, Result};

/// Samples in motion that are used, about.
const MOST_SAMPLES: usize = 2000;
/// Samples in motion that an estimate of positions needs.
const LEAST_SAMPLES: usize = 200;
/// Fraction of the variance among the sensors that no motion explains, from which on the geometry is not this array's.
const CONTRADICTION: f64 = 0.15;
/// Error of the size of a geometry that is reported: it makes the angular rate wrong by half of it.
const SIZE: f64 = 0.1;

/// Uncertainty of the geometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefineOptions {
    /// Standard deviation of each coordinate of the position of each axis, m.
    pub place_sd_m: f64,
    /// Standard deviation of each delay, s.
    pub delay_sd_s: f64,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self { place_sd_m: ArrayCalibration::PLACE_SD_M, delay_sd_s: ArrayCalibration::DELAY_SD_S }
    }
}

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
    pub moved_m: Vec<[[(f64, f64); 3]; 3]>,
    /// Deviation of a coordinate of a position against those of the other sensors, m.
    pub position_sd_m: f64,
    pub delays_s: Vec<(f64, f64)>,
    pub cost: f64,
    pub inflation: f64,
    pub log_determinant: f64,
    /// Quantities of ω that a sample shows, 6 unless the array is in a plane.
    pub rank: usize,
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
            position_sd_m: found.position_sd_m(used),
            delays_s: all().map(|s| found.delay_s(s)).collect(),
            cost: found.cost,
            inflation: found.inflation,
            log_determinant: found.log_determinant,
            rank: 0,
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
    let rank = ArraySolver::<M>::of(&axes, used).map_err(refused)?.rank();
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
    let found = solved(&axes, recording.sensors(), &used, &data, prior)?;
    Ok(Fitted { rank, ..found })
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

/// Positions and delays that a recording shows.
#[derive(Clone, Debug)]
pub struct Refinement {
    /// The geometry with them, or the given one where they are not accepted.
    pub geometry: ArrayGeometry,
    /// Correction of the position of each axis, m, body axes.
    pub moved_m: Vec<[[f64; 3]; 3]>,
    /// Its standard deviation, m.
    pub place_sd_m: Vec<[[f64; 3]; 3]>,
    /// Delay of each sensor beyond the given one, s.
    pub delay_s: Vec<f64>,
    /// Its standard deviation, s.
    pub delay_sd_s: Vec<f64>,
    /// Deviation of a coordinate against those of the other sensors, m.
    known_place_m: f64,
    /// Part that no motion explains, m/s² rms per axis: with the geometry as given, and with the estimates.
    pub residual_mps2: [f64; 2],
    /// Samples in motion.
    pub samples: usize,
    /// Reduction of the cost, χ², over the logarithm of the Occam factor: above 1 the evidence is for the estimates.
    pub gain: f64,
    /// Whether they are: `gain` is above 1.
    pub accepted: bool,
}

impl Refinement {
    /// Standard deviation of a coordinate of a position, m, rms.
    pub fn known_place_m(&self) -> f64 {
        self.known_place_m
    }

    /// The same of a delay, s.
    pub fn known_delay_s(&self) -> f64 {
        let squares = self.delay_sd_s.iter().map(|sd| sd * sd).sum::<f64>();
        (squares / self.delay_sd_s.len().max(1) as f64).sqrt()
    }
}

/// Estimates the positions of the axes of an array and the delays of its sensors, with their biases and matrices;
/// `recording` is in body axes by `geometry` ([`Array::arranged`]). Shift, rotation and size of the whole keep
/// their prior. The estimates are accepted where they reduce the residual by more than their number explains.
///
/// # Errors
/// `data_refused`: fewer than 200 samples in motion, or an array in a plane; those of the angular rate of the array.
pub fn refine(
    recording: &Array,
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
    options: &RefineOptions,
) -> Result<Refinement> {
    let prior = ArrayPrior {
        position_m: options.place_sd_m,
        delay_s: options.delay_sd_s,
        ..calibration.prior()
    };
    let exact = ArrayPrior { position_m: 1e-8, ..prior };
    let given = ArrayPrior { delay_s: 1e-9, ..exact };
    let fitted = |prior| Fitted::of(recording, geometry, calibration, prior);
    let (given, timed, mut found) = (fitted(&given)?, fitted(&exact)?, fitted(&prior)?);
    if found.rank < 6 {
        return Err(refused("an array in a plane does not show where its sensors are"));
    }
    let (before, after) = match (&given.agreement, &found.agreement) {
        (Some(before), Some(after)) if after.samples >= LEAST_SAMPLES => (before, after),
        (_, after) => {
            return Err(Code::DataRefused.error(format!("the body rotates fast enough in {} samples only", after.map_or(0, |a| a.samples)),
                "rotate the array about all axes, fast, for half a minute, besides resting it in several orientations",
            )
            .at(&recording.name));
        }
    };
    // Laplace's approximation of the evidence of a model (Kass & Raftery, "Bayes Factors", JASA 90, 1995).
    let inflation = found.inflation;
    let misfit = |of: &Fitted| of.cost / inflation + of.log_determinant;
    let residual_mps2 = [before.unexplained_mps2, after.unexplained_mps2];
    let (samples, mut known_place_m) = (after.samples, found.position_sd_m);
    if misfit(&timed) < misfit(&given).min(misfit(&found)) {
        // The recording shows delays; the positions are as given, as well as it shows them to be.
        known_place_m = found.shown_position_sd_m(calibration, options.place_sd_m);
        found = timed;
        let moved = found.moved_m.as_flattened_mut().as_flattened_mut();
        moved.fill((0.0, known_place_m));
    }
    let needed = found.log_determinant - given.log_determinant;
    let gain = (given.cost - found.cost) / (inflation * needed);
    let accepted = gain > 1.0;
    let mut refined = geometry.clone();
    let sensors = refined.sensors.iter_mut().enumerate();
    for (sensor, new) in sensors.filter(|_| accepted) {
        for (place, moved) in new.places_m.iter_mut().zip(&found.moved_m[sensor]) {
            *place = std::array::from_fn(|i| place[i] + moved[i].0);
        }
        new.delay_us += 1e6 * found.delays_s[sensor].0;
    }
    let split = |which: fn((f64, f64)) -> f64| -> Vec<[[f64; 3]; 3]> {
        let moved = found.moved_m.iter();
        moved.map(|axes| axes.map(|axis| axis.map(which))).collect()
    };
    Ok(Refinement {
        geometry: refined,
        moved_m: split(|(value, _)| value),
        place_sd_m: split(|(_, sd)| sd),
        delay_s: found.delays_s.iter().map(|(value, _)| *value).collect(),
        delay_sd_s: found.delays_s.iter().map(|(_, sd)| *sd).collect(),
        known_place_m,
        residual_mps2,
        samples,
        gain,
        accepted,
    })
}
