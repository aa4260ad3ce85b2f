//! Outputs of the sensors of an array at rest, and their departures from each other: equation (104).

use nalgebra::Vector3;
use wimu_calib::{Pose, find_poses};
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::Array;

/// Poses that a recording may have.
const MOST_POSES: usize = 256;
/// A sensor has output all through a rest if it has some in each part of this many samples.
const PART_SAMPLES: usize = 16;

/// First sample and number of samples.
pub(super) type Span = (usize, usize);
/// Values at each rest, of each sensor, m/s²; none where a sensor has no output.
pub(super) type AtRests = Vec<Vec<Option<Vector3<f64>>>>;

/// 0 of none.
pub(super) fn mean(values: impl Iterator<Item = Vector3<f64>>) -> Vector3<f64> {
    let (sum, count) = values.fold((Vector3::zeros(), 0.0), |(sum, n), v| (sum + v, n + 1.0));
    sum / f64::max(count, 1.0)
}

/// Mean of the sensors that are used at a rest.
pub(super) fn common(values: &[Option<Vector3<f64>>], used: &[usize]) -> Vector3<f64> {
    mean(used.iter().filter_map(|sensor| values[*sensor]))
}

/// By how much each sensor departs from the mean of those that are used.
pub(super) fn departures(forces: &AtRests, used: &[usize]) -> AtRests {
    let of_rest = |values: &Vec<Option<Vector3<f64>>>| {
        let mean = common(values, used);
        values.iter().map(|value| value.map(|value| value - mean)).collect()
    };
    forces.iter().map(of_rest).collect()
}

/// Departures of some sensors, rms length.
pub(super) fn rms(departures: &AtRests, sensors: &[usize]) -> f64 {
    let seen = || departures.iter().flat_map(|all| sensors.iter().filter_map(|k| all[*k]));
    let squares = seen().map(|departure| departure.norm_squared()).sum::<f64>();
    (squares / seen().count().max(1) as f64).sqrt()
}

/// The error of sensitivity and direction that shows as the sensors' departures from their mean change with the
/// orientation; `None` where the rests are too much alike.
pub(super) fn scale_of(departures: &AtRests, forces: &AtRests, used: &[usize]) -> Option<f64> {
    let (mut departed, mut changed, mut most) = (0.0, 0.0, 0.0_f64);
    for (rest, sensor) in (1..forces.len()).flat_map(|rest| used.iter().map(move |k| (rest, *k))) {
        let change = |values: &AtRests| Some(values[rest][sensor]? - values[rest - 1][sensor]?);
        if let Some((departure, force)) = change(departures).zip(change(forces)) {
            departed += departure.norm_squared();
            changed += 3.0 * force.norm_squared();
            most = most.max(force.norm_squared());
        }
    }
    let count = used.len() as f64;
    let alike = most < STANDARD_GRAVITY_MPS2.powi(2) || count < 2.0;
    (!alike).then(|| (departed / changed * count / (count - 1.0)).sqrt())
}

/// Whether no axis of a sensor ever moves, or it has no output.
pub(super) fn is_dead(recording: &Array, sensor: usize) -> bool {
    let outputs = recording.units[sensor].force.v.iter();
    let mut finite = outputs.filter(|v| v.iter().all(|axis| axis.is_finite()));
    let first = finite.next();
    finite.all(|v| Some(v) == first)
}

/// Where the mean of the sensors that are not `dead` is steady.
pub(super) fn steady_stretches(recording: &Array, dead: &[usize]) -> Vec<Span> {
    let alive: Vec<usize> = (0..recording.sensors()).filter(|s| !dead.contains(s)).collect();
    let mean = (0..recording.len()).map(|k| {
        let seen = alive.iter().filter(|sensor| recording.has(k, **sensor));
        (mean(seen.map(|sensor| recording.output(k, *sensor))).into(), None)
    });
    find_poses(mean, 1.0 / recording.period_s())
        .iter()
        .take(MOST_POSES)
        .map(|pose| (pose.first_sample as usize, pose.samples as usize))
        .filter(|(first, count)| first + count <= recording.len())
        .collect()
}

/// Mean of a sensor over a span, and its deviation about it, the same for all axes; `None` where it has no output for the
/// most part.
pub(super) fn pose(recording: &Array, sensor: usize, (first, count): Span) -> Option<Pose> {
    let rows = (first..first + count).filter(|k| recording.has(*k, sensor));
    let rows: Vec<Vector3<f64>> = rows.map(|k| recording.output(k, sensor)).collect();
    if rows.len() < 2 || rows.len() * 4 < count {
        return None;
    }
    let mean = mean(rows.iter().copied());
    let squares = rows.iter().map(|row| (row - mean).norm_squared()).sum::<f64>();
    let sd = (squares / (3 * rows.len()) as f64).sqrt();
    Some(Pose { sd_mps2: [sd; 3], samples: rows.len() as u32, ..Pose::from_mean(mean.into()) })
}

/// Whether a sensor gives output all through a span, and not only for a part of it.
pub(super) fn is_throughout(recording: &Array, sensor: usize, (first, count): Span) -> bool {
    let mut whole =
        (0..count / PART_SAMPLES).map(|part| (first + part * PART_SAMPLES, PART_SAMPLES));
    whole.all(|part| pose(recording, sensor, part).is_some())
}
