//! Delays and the size of an array as its own motion shows them: equation (106).

use wimu_calib::Gravity;
use wimu_model::STANDARD_GRAVITY_MPS2;
use wimu_nav::array::ArraySolver;

use super::calibration::BIAS_MPS2;
use super::motion::{axes, refused, sample, with_room};
use nalgebra::{DMatrix, DVector};

use super::refine::sandwich;
use super::{ArrayCalibration, ArrayGeometry, ArrayRecording};
use crate::{ErrorCode, HostError, Result};

/// Delays are looked for by outputs that change over so much, s, in so many passes at most.
const CHANGE_S: f64 = 0.01;
const PASSES: usize = 10;
const SETTLED_S: f64 = 2e-6;
/// An output changes where that is beyond so many of its variances.
const CHANGES: f64 = 9.0;
/// Before anything is known a delay is below this, s.
const LONGEST_S: f64 = 0.1;
/// The mean delay is tied to this, s.
const TIED_S: f64 = 1e-7;
/// The part of errors that last which goes as the outputs' changes do, as a delay does.
const LIKE_DELAYS: f64 = 0.5;
/// Neighbouring samples err alike for so long, s.
const ALIKE_S: f64 = 0.25;
/// Fewer samples or changes of the rate do not decide.
const LEAST_SAMPLES: usize = 100;
const LEAST_WINDOWS: usize = 12;
/// Over so much, s, the rate changes by ω̇ as much as by itself; by so much at least, rad/s.
const WINDOW_S: f64 = 0.1;
const LEAST_CHANGE_RAD_S: f64 = 0.4;
/// A rate shows beyond so many deviations, and where it pushes outward by so much, m/s².
const SHOWS_SD: f64 = 5.0;
const SHOWS_MPS2: f64 = 0.5;
/// A delay is another than given where it is off by so many of its deviations, a size by so many (errors of
/// sensitivities that last are in them); both by so many of what they are known to, sizes by this part at least.
const LATE_SD: f64 = 5.0;
const SIZE_SD: f64 = 3.0;
const KNOWN_SD: f64 = 3.0;
const LEAST_SIZE: f64 = 0.05;

/// What an array's motion says of its sensors' times and of its size.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Survey {
    /// By how much each sensor is later than the median of all, s, with its standard deviation; empty where too
    /// little moves, or the outputs leave nothing over.
    pub delays_s: Vec<(f64, f64)>,
    /// How many times too large the places are, with its standard deviation; `None` where the rate changes too
    /// little, or does not show without its history.
    pub size: Option<(f64, f64)>,
}

/// What a recording in body axes says of the delays and of the size of its array.
///
/// # Errors
/// `usage` when the numbers of sensors differ or are more than 16; `data_refused` when the geometry does not
/// show ω̇ and s.
pub fn surveyed(
    recording: &ArrayRecording,
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
) -> Result<Survey> {
    super::motion::check(recording, geometry)?;
    with_room!(
        geometry.sensors.len(),
        survey(recording, geometry, calibration)
    )
}

fn survey<const M: usize>(
    recording: &ArrayRecording,
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
) -> Result<Survey> {
    let axes = axes::<M>(geometry, calibration)?;
    let solver =
        ArraySolver::<f64, M>::of(&axes, |sensor| calibration.uses(sensor)).map_err(refused)?;
    let delays_s = delays(recording, calibration, &solver);
    let found: Vec<f64> = delays_s.iter().map(|(delay, _)| *delay).collect();
    let size = if found.is_empty() {
        size(recording, calibration, &solver)
    } else {
        size(&recording.clone().delayed(&found), calibration, &solver)
    };
    Ok(Survey { delays_s, size })
}

/// An array as its motion shows it where that is not what was given.
pub(crate) struct Repaired {
    pub recording: ArrayRecording,
    pub geometry: ArrayGeometry,
    pub calibration: ArrayCalibration,
    /// By how much each sensor was found to be later.
    pub delays_s: Vec<f64>,
    pub remarks: Vec<String>,
}

/// Takes sensors that are later or earlier, and places that are larger or smaller than anybody said as the motion
/// shows them; `None` where all is as given.
pub(crate) fn repaired(
    recording: &ArrayRecording,
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
) -> Result<Option<Repaired>> {
    let survey = surveyed(recording, geometry, calibration)?;
    let mut remarks = Vec::new();
    let late: Vec<f64> = (survey.delays_s.iter())
        .map(|(delay, sd)| {
            let least = (LATE_SD * sd).max(KNOWN_SD * calibration.delay_sd_s);
            let found = delay.abs() > least && delay.abs() < LONGEST_S;
            if found { *delay } else { 0.0 }
        })
        .collect();
    for (sensor, (delay, sd)) in survey.delays_s.iter().enumerate() {
        if late[sensor] != 0.0 {
            remarks.push(format!(
                "sensor {sensor} (from 0): its samples are taken {:.2} ± {:.2} ms {} than their times say, by those of \
                 most; they are put there",
                delay.abs() * 1e3,
                sd * 1e3,
                if *delay > 0.0 { "later" } else { "earlier" }
            ));
        }
    }
    let sensors = geometry.sensors.len() as f64;
    let known = KNOWN_SD * calibration.place_sd_m / (arm_m(geometry) * sensors.sqrt());
    let size = survey.size.filter(|(size, sd)| {
        let off = size.ln().abs();
        off > SIZE_SD * sd / size && off > known.max(LEAST_SIZE)
    });
    if remarks.is_empty() && size.is_none() {
        return Ok(None);
    }
    let mut repaired = Repaired {
        recording: recording.clone(),
        geometry: geometry.clone(),
        calibration: calibration.clone(),
        delays_s: late,
        remarks,
    };
    let late = &repaired.delays_s;
    if late.iter().any(|delay| *delay != 0.0) {
        repaired.recording = repaired.recording.shifted(late);
        let mut again =
            ArrayCalibration::of(&repaired.recording, geometry, Gravity::UNKNOWN_PLACE)?;
        again.place_sd_m = calibration.place_sd_m;
        again.delay_sd_s = calibration.delay_sd_s;
        repaired.calibration = again;
    }
    if let Some((size, sd)) = size {
        for sensor in &mut repaired.geometry.sensors {
            for place in &mut sensor.places_m {
                *place = place.map(|c| c / size);
            }
        }
        repaired.calibration.size_sd_m = arm_m(&repaired.geometry) * sd / size;
        repaired.remarks.push(format!(
            "the places are {size:.3} ± {sd:.3} times as far apart as the sensors: the rate's changes are not what ω̇ \
             adds up to; they are taken divided by that. Check the unit of the places"
        ));
    }
    Ok(Some(repaired))
}

/// Root mean square distance of the sensors from their centre, m.
fn arm_m(geometry: &ArrayGeometry) -> f64 {
    let places = || geometry.sensors.iter().flat_map(|s| s.places_m);
    let count = f64::max(places().count() as f64, 1.0);
    let squares: f64 = (0..3)
        .map(|c| {
            let mean = places().map(|p| p[c]).sum::<f64>() / count;
            places().map(|p| (p[c] - mean).powi(2)).sum::<f64>()
        })
        .sum();
    (squares / count).sqrt().max(1e-9)
}

/// Each sensor's delay against the median of all, and its standard deviation.
fn delays<const M: usize>(
    recording: &ArrayRecording,
    calibration: &ArrayCalibration,
    solver: &ArraySolver<f64, M>,
) -> Vec<(f64, f64)> {
    let sensors = recording.sensors();
    let used: Vec<usize> = (0..sensors).filter(|s| calibration.uses(*s)).collect();
    let free = (3 * used.len()).saturating_sub(6 + solver.rank().min(3));
    if used.len() < 3 || free == 0 {
        return Vec::new();
    }
    let count = used.len();
    let mut found = vec![0.0; sensors];
    let mut covariance = DMatrix::zeros(count, count);
    let mut lasting = 0.0;
    for pass in 0..=PASSES {
        let moved = recording.clone().delayed(&found);
        let sums = DelaySums::of(&moved, calibration, solver, &used, free);
        if sums.samples < LEAST_SAMPLES {
            return Vec::new();
        }
        let mut before = DMatrix::zeros(count, count);
        for i in 0..count {
            before[(i, i)] += 1.0 / (LONGEST_S * LONGEST_S);
            for j in 0..count {
                before[(i, j)] += 1.0 / (TIED_S * TIED_S);
            }
        }
        let Some(factor) = (&sums.normal + &before).cholesky() else {
            return Vec::new();
        };
        let step = factor.solve(&sums.pull);
        let most = step.iter().fold(0.0, |most: f64, s| most.max(s.abs()));
        if most < SETTLED_S || pass == PASSES {
            covariance = sandwich(&factor, &(sums.spread() + before));
            lasting = LIKE_DELAYS * sums.wrong_mps2(calibration) / sums.change_mps3();
            break;
        }
        for (sensor, step) in used.iter().zip(&step) {
            found[*sensor] = (found[*sensor] + step).clamp(-LONGEST_S, LONGEST_S);
        }
        // The sensors' common time is that of most of them.
        let mut all: Vec<f64> = used.iter().map(|s| found[*s]).collect();
        all.sort_by(f64::total_cmp);
        let median = 0.5 * (all[(count - 1) / 2] + all[count / 2]);
        for sensor in &used {
            found[*sensor] -= median;
        }
    }
    let mut out = vec![(0.0, f64::INFINITY); sensors];
    for (i, sensor) in used.iter().enumerate() {
        let chance = covariance[(i, i)].max(0.0).sqrt();
        out[*sensor] = (found[*sensor], chance.hypot(lasting));
    }
    out
}

/// Normal equations of the delays.
struct DelaySums {
    normal: DMatrix<f64>,
    pull: DVector<f64>,
    /// What each stretch of samples pulls.
    blocks: Vec<Vec<f64>>,
    samples: usize,
    /// Sums over the samples: force, its square, of an output's change, and of what an error of a place, m, adds.
    force: [f64; 3],
    squares: [f64; 3],
}

impl DelaySums {
    fn of<const M: usize>(
        recording: &ArrayRecording,
        calibration: &ArrayCalibration,
        solver: &ArraySolver<f64, M>,
        used: &[usize],
        free: usize,
    ) -> Self {
        let period = recording.period_s();
        let times = &recording.times_s;
        let apart = ((CHANGE_S / period).round() as usize).max(1);
        let span = apart as f64 * period;
        let noise = solver.variance_mps2();
        // Of a difference of the fourth order.
        let least = CHANGES * 0.9 * noise / (span * span);
        let all: Vec<Option<[f64; M]>> = (0..times.len())
            .map(|k| {
                let sound = used.iter().all(|sensor| recording.has(k, *sensor));
                sound.then(|| only(used, sample::<M>(recording, calibration, k)))
            })
            .collect();
        let mut sums = Self {
            normal: DMatrix::zeros(used.len(), used.len()),
            pull: DVector::zeros(used.len()),
            blocks: Vec::new(),
            samples: 0,
            force: [0.0; 3],
            squares: [0.0; 3],
        };
        let mut block = usize::MAX;
        for k in 2 * apart..all.len().saturating_sub(2 * apart) {
            let at = |back: usize, on: usize| all[k + on - back].as_ref();
            let (Some(y), Some(a), Some(b), Some(c), Some(d)) = (
                at(0, 0),
                at(2 * apart, 0),
                at(apart, 0),
                at(0, apart),
                at(0, 2 * apart),
            ) else {
                continue;
            };
            let lasted = times[k + 2 * apart] - times[k - 2 * apart];
            if (lasted / (4.0 * span) - 1.0).abs() > 0.1 {
                continue;
            }
            let change: [f64; M] =
                std::array::from_fn(|i| (8.0 * (c[i] - b[i]) - (d[i] - a[i])) / (12.0 * span));
            let square = change.iter().map(|v| v * v).sum::<f64>() / (3 * used.len()) as f64;
            if square < least {
                continue;
            }
            let linear = solver.reduce(y);
            let solution = solver.roots_of(&linear);
            let Some(best) = solution.hypotheses().next() else {
                continue;
            };
            let (expected, slope) = solver.expected_z(best.rate_rad_s);
            let mut rest = solver.project(y);
            for (row, z) in solver.z_rows().iter().zip(expected) {
                for (rest, value) in rest.iter_mut().zip(row) {
                    *rest -= value * z;
                }
            }
            let weight =
                1.0 / (rest.iter().map(|r| r * r).sum::<f64>() * noise / free as f64).max(1.0);
            // What another rate would explain of a change of one sensor's outputs.
            let along = orthonormal(&slope);
            let columns: Vec<([f64; M], [f64; M], [f64; 3])> = used
                .iter()
                .map(|sensor| {
                    let own = only(&[*sensor], change);
                    let z = solver.reduce(&own).z;
                    let explained = along.map(|axis| (0..6).map(|i| axis[i] * z[i]).sum());
                    (own, solver.project(&own), explained)
                })
                .collect();
            let now = (times[k] / ALIKE_S) as usize;
            if now != block {
                block = now;
                sums.blocks.push(vec![0.0; used.len()]);
            }
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            for (i, (own, _, explained)) in columns.iter().enumerate() {
                let pull = weight * dot(own, &rest);
                sums.pull[i] += pull;
                if let Some(last) = sums.blocks.last_mut() {
                    last[i] += pull;
                }
                for (j, (_, projected, other)) in columns.iter().enumerate() {
                    let value = dot(own, projected) - dot(explained, other);
                    sums.normal[(i, j)] += weight * value;
                }
            }
            sums.samples += 1;
            let [rate, turn] = [best.rate_rad_s, best.angular_acceleration_rad_s2]
                .map(|v| v.iter().map(|c| c * c).sum::<f64>());
            for (sum, force) in sums.force.iter_mut().zip(best.specific_force_mps2) {
                *sum += force;
                sums.squares[0] += force * force;
            }
            sums.squares[1] += square;
            sums.squares[2] += (rate * rate + turn) / 1.5;
        }
        sums
    }

    /// What errors of sensitivity, direction and place that last put an output wrong by, m/s² rms.
    fn wrong_mps2(&self, calibration: &ArrayCalibration) -> f64 {
        let count = self.samples.max(1) as f64;
        let mean = self.force.iter().map(|f| (f / count).powi(2)).sum::<f64>();
        let force = (self.squares[0] / count - mean).max(0.0).sqrt();
        let place = (self.squares[2] / count).sqrt();
        (calibration.scale * force).hypot(calibration.place_sd_m * place)
    }

    /// What an output changes by, m/s³ rms.
    fn change_mps3(&self) -> f64 {
        (self.squares[1] / self.samples.max(1) as f64)
            .sqrt()
            .max(1e-9)
    }

    fn spread(&self) -> DMatrix<f64> {
        let count = self.pull.len();
        let blocks = self.blocks.iter();
        blocks.fold(DMatrix::zeros(count, count), |spread, block| {
            let block = DVector::from_column_slice(block);
            spread + &block * block.transpose()
        })
    }
}

/// The outputs of these sensors, 0 elsewhere.
fn only<const M: usize>(sensors: &[usize], output: [f64; M]) -> [f64; M] {
    std::array::from_fn(|axis| {
        if sensors.contains(&(axis / 3)) {
            output[axis]
        } else {
            0.0
        }
    })
}

/// Directions that span those of the derivatives, of length 1 and at right angles; 0 where there are fewer.
fn orthonormal(slope: &[[f64; 3]; 6]) -> [[f64; 6]; 3] {
    let mut out = [[0.0; 6]; 3];
    for c in 0..3 {
        let mut v: [f64; 6] = std::array::from_fn(|row| slope[row][c]);
        let size = v.iter().map(|v| v * v).sum::<f64>();
        for before in out.iter().take(c) {
            let along: f64 = (0..6).map(|i| before[i] * v[i]).sum();
            for (v, b) in v.iter_mut().zip(before) {
                *v -= along * b;
            }
        }
        let left = v.iter().map(|v| v * v).sum::<f64>();
        if left > 1e-9 * size && left > 0.0 {
            out[c] = v.map(|v| v / left.sqrt());
        }
    }
    out
}

/// A sample in which the rate shows.
#[derive(Clone, Copy)]
struct Point {
    time_s: f64,
    /// ω up to its sign, rad/s.
    rate: [f64; 3],
    /// ω̇, rad/s².
    turn: [f64; 3],
    /// By how much an error of the outputs puts the rate wrong, rad/s per m/s².
    per_mps2: f64,
}

/// How many times too large the places are: ω by the root of what pushes outward goes as 1/√size, ω̇ as 1/size.
fn size<const M: usize>(
    recording: &ArrayRecording,
    calibration: &ArrayCalibration,
    solver: &ArraySolver<f64, M>,
) -> Option<(f64, f64)> {
    if solver.rank() < 6 {
        return None;
    }
    let sensors = recording.sensors();
    let used: Vec<usize> = (0..sensors).filter(|s| calibration.uses(*s)).collect();
    let period = recording.period_s();
    let times = &recording.times_s;
    let length = ((WINDOW_S / period).round() as usize).max(1);
    let least = SHOWS_MPS2 / solver.arm_m();
    let sigma = solver.variance_mps2().sqrt();
    let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| a[i] * b[i]).sum::<f64>();
    let minus = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] { std::array::from_fn(|i| a[i] - b[i]) };
    let mut stretches: Vec<Vec<Point>> = vec![Vec::new()];
    for k in 0..times.len() {
        let sound = used.iter().all(|sensor| recording.has(k, *sensor));
        let shown = sound.then(|| {
            let output = only(&used, sample::<M>(recording, calibration, k));
            let solution = solver.roots_of(&solver.reduce(&output));
            let last = stretches.last().and_then(|s| s.last()).copied();
            let expected = last.map(|last: Point| {
                let dt = times[k] - last.time_s;
                std::array::from_fn(|i| last.rate[i] + last.turn[i] * dt)
            });
            let root = match expected {
                Some(expected) => solution.nearest(expected),
                None => solution.hypotheses().next(),
            }?;
            let rate = root.rate_rad_s;
            let square = dot(rate, rate);
            let covariance = root.covariance()?;
            let variances = [0, 1, 2].map(|i| covariance[i][i]);
            let spread = variances.into_iter().fold(0.0, f64::max);
            let shows = square > SHOWS_SD * SHOWS_SD * spread && square > least;
            let goes_on = expected
                .is_none_or(|e| dot(minus(rate, e), minus(rate, e)) < 0.1 * square)
                && last.is_none_or(|last| times[k] - last.time_s < 2.5 * period);
            let point = Point {
                time_s: times[k],
                rate,
                turn: root.angular_acceleration_rad_s2,
                per_mps2: (variances.iter().sum::<f64>() / 3.0).sqrt() / sigma,
            };
            shows.then_some((goes_on, point))
        });
        match shown.flatten() {
            Some((true, point)) => stretches.last_mut()?.push(point),
            Some((false, point)) => stretches.push(vec![point]),
            None if stretches.last().is_some_and(|s| !s.is_empty()) => stretches.push(Vec::new()),
            None => {}
        }
    }
    let noise = solver.covariance();
    let spread = (0..3).map(|i| noise[i][i]).sum::<f64>() * period * period * length as f64;
    // Of each stretch: what the changes of both have in common, and the square of what ω̇ adds up to.
    let mut blocks: Vec<(f64, f64)> = Vec::new();
    let (mut windows, mut lasting) = (0, 0.0);
    for stretch in &stretches {
        let (mut common, mut square) = (0.0, 0.0);
        for window in stretch.windows(length + 1).step_by(length) {
            let mut sum = [0.0; 3];
            for pair in window.windows(2) {
                let dt = pair[1].time_s - pair[0].time_s;
                for (i, sum) in sum.iter_mut().enumerate() {
                    *sum += 0.5 * (pair[0].turn[i] + pair[1].turn[i]) * dt;
                }
            }
            let by = dot(sum, sum);
            if by < LEAST_CHANGE_RAD_S * LEAST_CHANGE_RAD_S || by < CHANGES * spread {
                continue;
            }
            let (Some(first), Some(last)) = (window.first(), window.last()) else {
                continue;
            };
            common += dot(minus(last.rate, first.rate), sum);
            square += by;
            // A bias is the same at both ends, an error of sensitivity is not where the force has turned.
            let bias = BIAS_MPS2 * (last.per_mps2 - first.per_mps2);
            let scale = calibration.scale * STANDARD_GRAVITY_MPS2;
            let scale = scale * (0.5 * (last.per_mps2.powi(2) + first.per_mps2.powi(2))).sqrt();
            lasting += by.sqrt() * bias.hypot(scale);
            windows += 1;
        }
        if square > 0.0 {
            // The root's sign is that in which ω follows ω̇.
            blocks.push((common.abs(), square));
        }
    }
    if windows < LEAST_WINDOWS || blocks.len() < 3 {
        return None;
    }
    let (common, square) = blocks.iter().fold((0.0, 0.0), |(c, s), (common, square)| {
        (c + common, s + square)
    });
    let ratio = common / square;
    let left: f64 = blocks.iter().map(|(c, s)| (c - ratio * s).powi(2)).sum();
    let chance = (left * blocks.len() as f64 / (blocks.len() - 1) as f64).sqrt();
    let sd = chance.hypot(lasting) / square;
    (ratio.is_finite() && ratio > 0.0).then_some((ratio * ratio, 2.0 * ratio * sd))
}
