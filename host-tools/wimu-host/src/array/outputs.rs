//! Outputs of the sensors of an array at rest, and their departures from each other: equation (104).

use wimu_calib::{Pose, find_poses};
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::ArrayRecording;

/// Poses that a recording may have.
const MOST_POSES: usize = 256;
/// A sensor has output all through a rest if it has some in each part of this many samples.
const PART_SAMPLES: usize = 16;

/// By how much each sensor departs from the mean of those that are used, at each rest, m/s².
pub(super) fn departures(
    forces: &[Vec<Option<[f64; 3]>>],
    rests: usize,
    used: &[usize],
) -> Vec<Vec<Option<[f64; 3]>>> {
    let of_rest = |rest: usize| {
        let mean = mean(used.iter().filter_map(|k| forces[*k][rest]));
        let from_mean = |f: [f64; 3]| std::array::from_fn(|axis| f[axis] - mean[axis]);
        forces.iter().map(|forces| forces[rest].map(from_mean)).collect()
    };
    (0..rests).map(of_rest).collect()
}

/// Departures of the sensors that are used, m/s² rms per axis.
pub(super) fn disagreement(offsets: &[Vec<Option<[f64; 3]>>], used: &[usize]) -> f64 {
    let of_used = || offsets.iter().flat_map(|all| used.iter().filter_map(|k| all[*k]));
    let squares = of_used().flatten().map(|o| o * o).sum::<f64>();
    (squares / f64::max(3.0 * of_used().count() as f64, 1.0)).sqrt()
}

/// How far a sensor departs from the mean at the rests, m/s² rms.
pub(super) fn apart_of(sensor: usize, departures: &[Vec<Option<[f64; 3]>>]) -> f64 {
    let seen = || departures.iter().filter_map(|all| all[sensor]);
    let squares = seen().flatten().map(|o| o * o).sum::<f64>();
    (squares / seen().count().max(1) as f64).sqrt()
}

/// The error of sensitivity and direction that shows as the sensors' departures from their mean change with the
/// orientation; `None` where the rests are too much alike.
pub(super) fn scale_of(
    offsets: &[Vec<Option<[f64; 3]>>],
    forces: &[Vec<Option<[f64; 3]>>],
    used: &[usize],
) -> Option<f64> {
    let square = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>();
    let (mut departures, mut changes, mut most) = (0.0, 0.0, 0.0_f64);
    for rest in 1..offsets.len() {
        for k in used {
            let now = (offsets[rest][*k], forces[*k][rest]);
            let before = (offsets[rest - 1][*k], forces[*k][rest - 1]);
            if let ((Some(o), Some(f)), (Some(p), Some(g))) = (now, before) {
                departures += square(o, p);
                changes += 3.0 * square(f, g);
                most = most.max(square(f, g));
            }
        }
    }
    let count = used.len() as f64;
    let alike = most < STANDARD_GRAVITY_MPS2.powi(2) || count < 2.0;
    (!alike).then(|| (departures / changes * count / (count - 1.0)).sqrt())
}

/// Whether no axis of a sensor ever moves, or it has no output.
pub(super) fn is_dead(recording: &ArrayRecording, sensor: usize) -> bool {
    let outputs = || recording.outputs.iter().map(|row| row[sensor]);
    let finite = |v: &[f64; 3]| v.iter().all(|axis| axis.is_finite());
    let Some(first) = outputs().find(finite) else {
        return true;
    };
    outputs().filter(finite).all(|v| v == first)
}

/// Where the mean of the sensors that are not `dead` is steady: first sample and number of samples.
pub(super) fn steady_stretches(recording: &ArrayRecording, dead: &[usize]) -> Vec<(usize, usize)> {
    let alive: Vec<usize> =
        (0..recording.sensors()).filter(|sensor| !dead.contains(sensor)).collect();
    let mean = (0..recording.outputs.len()).map(|k| {
        let seen = alive.iter().filter(|s| recording.has(k, **s));
        (mean(seen.map(|s| recording.outputs[k][*s])), None)
    });
    let mut poses = vec![Pose::default(); MOST_POSES];
    let found = find_poses(mean, 1.0 / recording.period_s(), &mut poses).min(MOST_POSES);
    poses[..found]
        .iter()
        .map(|pose| (pose.first_sample as usize, pose.samples as usize))
        .filter(|(first, count)| first + count <= recording.outputs.len())
        .collect()
}

/// 0 of none.
pub(super) fn mean(values: impl Iterator<Item = [f64; 3]>) -> [f64; 3] {
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for value in values {
        for (sum, value) in sum.iter_mut().zip(value) {
            *sum += value;
        }
        count += 1.0;
    }
    sum.map(|v| v / f64::max(count, 1.0))
}

/// A sensor at a rest; `None` where it has no output for the most part.
pub(super) fn pose(
    recording: &ArrayRecording,
    sensor: usize,
    (first, count): (usize, usize),
) -> Option<Pose> {
    let rows: Vec<[f64; 3]> = (first..first + count)
        .filter(|k| recording.has(*k, sensor))
        .map(|k| recording.outputs[k][sensor])
        .collect();
    if rows.len() < 2 || rows.len() * 4 < count {
        return None;
    }
    let n = rows.len() as f64;
    let mean = mean(rows.iter().copied());
    let mut pose = Pose::from_mean(mean);
    pose.sd_mps2 = core::array::from_fn(|axis| {
        let square: f64 = rows.iter().map(|r| (r[axis] - mean[axis]).powi(2)).sum();
        (square / n).sqrt()
    });
    pose.samples = rows.len() as u32;
    Some(pose)
}

/// Whether a sensor gives output all through a rest, and not only for a part of it.
pub(super) fn is_throughout(
    recording: &ArrayRecording,
    sensor: usize,
    (first, count): (usize, usize),
) -> bool {
    (0..count).step_by(PART_SAMPLES).all(|from| {
        let part = (first + from, PART_SAMPLES.min(count - from));
        part.1 < PART_SAMPLES || pose(recording, sensor, part).is_some()
    })
}
