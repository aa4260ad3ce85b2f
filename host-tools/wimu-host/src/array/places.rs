//! How well the places of an array's sensors are known by what the sensors disagree by while it turns: equation (111).

use wimu_nav::array::ArraySolver;

use super::motion::sample;
use super::{ArrayCalibration, ArrayRecording};

/// Fewer samples do not decide, more than these say no more.
const LEAST_SAMPLES: f64 = 100.0;
const MOST_SAMPLES: usize = 2000;
/// The slope is taken so many of its deviations higher than found.
const BEYOND_SD: f64 = 2.0;

/// Standard deviation of each coordinate of a place, m: as it was stated, or smaller where the sensors agree better while
/// they turn than places as wrong as that would let them.
pub(super) fn shown_place_sd_m<const M: usize>(
    recording: &ArrayRecording,
    calibration: &ArrayCalibration,
    solver: &ArraySolver<f64, M>,
) -> f64 {
    let stated = calibration.place_sd_m;
    let used: Vec<usize> = (0..recording.sensors())
        .filter(|sensor| calibration.uses(*sensor))
        .collect();
    // Of three coordinates a sensor those that no shift, turn or stretch of the whole explains.
    let shapes = (3 * used.len()).saturating_sub(12) as f64;
    let free = (3 * used.len()).saturating_sub(6 + solver.rank()) as f64;
    if shapes < 2.0 || free < 1.0 || solver.rank() < 3 {
        return stated;
    }
    let mut points = Vec::new();
    let count = recording.outputs.len();
    for index in (0..count).step_by(count.div_ceil(MOST_SAMPLES).max(1)) {
        if !used.iter().all(|sensor| recording.has(index, *sensor)) {
            continue;
        }
        let mut output = sample::<M>(recording, calibration, index);
        for (axis, value) in output.iter_mut().enumerate() {
            if !used.contains(&(axis / 3)) {
                *value = 0.0;
            }
        }
        let linear = solver.reduce(&output);
        let solution = solver.roots_of(&linear);
        if let (Some(best), Some(excess)) = (
            solution.hypotheses().next(),
            solver.excess(&output, &linear),
        ) {
            let [rate, turn] = [best.rate_rad_s, best.angular_acceleration_rad_s2]
                .map(|v| v.iter().map(|c| c * c).sum::<f64>());
            points.push(((rate * rate + turn) / 1.5, excess * solver.variance_mps2()));
        }
    }
    let count = points.len() as f64;
    let mean = |of: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (pull, left) = (mean(&|p| p.0), mean(&|p| p.1));
    let spread = mean(&|p| (p.0 - pull).powi(2));
    if count < LEAST_SAMPLES || spread <= 0.0 {
        return stated;
    }
    let slope = mean(&|p| (p.0 - pull) * (p.1 - left)) / spread;
    let slope_sd = solver.variance_mps2() * (2.0 / (free * count * spread)).sqrt();
    let found = slope.max(0.0) + BEYOND_SD * slope_sd;
    // What was stated counts as one of them; so few do not tell their spread better than that of Student's t.
    let square = (stated * stated + shapes * found) / (shapes - 1.0);
    square.sqrt().min(stated)
}
