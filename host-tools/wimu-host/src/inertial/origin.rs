//! Where position is measured from.

use std::ops::Range;

use super::PathPoint;

/// The end of a rest shows so much later, s.
const LATE_S: f64 = 0.6;

/// Measures position from where the rest ends, which shows later, and returns that point. How far even motion with these
/// deviations, m/s, may have taken it from there or brought it there is what the points of the rest are off by, those after
/// it also by what it had gained when its end showed. Where it was before the rest is not known.
pub(super) fn measured_from(
    points: &mut [PathPoint],
    rest: &Range<usize>,
    speed_mps: [f64; 3],
    limit_m: f64,
) -> usize {
    let Some(last_s) = rest.clone().next_back().map(|k| points[k].time_s) else {
        return rest.start;
    };
    let ends = rest.end < points.len();
    let late_s = if ends { LATE_S } else { 0.0 };
    let before = points[rest.clone()].partition_point(|p| p.time_s <= last_s - late_s);
    let origin = rest.start + before.max(1) - 1;
    let end_s = points[origin].time_s;
    let gained_m = points.get(rest.end).map_or([0.0; 3], |p| p.position_m);
    for point in &mut points[..rest.start] {
        point.valid = false;
    }
    for (k, point) in points[rest.clone()].iter_mut().enumerate() {
        point.covariance_m2 = [[0.0; 3]; 3];
        for (i, row) in point.covariance_m2.iter_mut().enumerate() {
            let way_m = speed_mps[i] * (end_s - point.time_s);
            let late_m = if rest.start + k > origin {
                gained_m[i]
            } else {
                0.0
            };
            row[i] = way_m * way_m + late_m * late_m;
        }
        point.valid &= point.sd_m() <= limit_m;
    }
    origin
}
