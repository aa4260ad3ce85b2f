//! Detection of saturated axes.

use wimu_calib::{Pose, is_clipped};

use super::median;

/// The axis whose noise is cut off at the limit of its output in some poses.
pub(super) fn at_rest(samples: impl Iterator<Item = [f64; 3]>, poses: &[Pose]) -> Option<usize> {
    let mut values = [const { Vec::new() }; 3];
    let mut holds = poses.iter().peekable();
    for (index, sample) in (0..).zip(samples) {
        while holds.next_if(|pose| index >= pose.first_sample + u64::from(pose.samples)).is_some() {
        }
        if holds.peek().is_some_and(|pose| index >= pose.first_sample) {
            for (values, value) in values.iter_mut().zip(sample) {
                values.push(value);
            }
        }
    }
    (0..3).find(|&axis| {
        let values = &mut values[axis];
        values.sort_by(f64::total_cmp);
        let steps = values.windows(2).map(|pair| pair[1] - pair[0]);
        let step = steps.filter(|step| *step > 0.0).fold(f64::INFINITY, f64::min);
        let usual = median(poses.iter().map(|pose| pose.sd_mps2[axis])).unwrap_or(0.0);
        // Occurrences of the two outermost values at one end.
        let at_limit = |from_end: &mut dyn Iterator<Item = f64>| {
            let mut counts = [0; 2];
            let (mut place, mut last) = (0, None);
            for value in from_end {
                place += usize::from(last.is_some_and(|last: f64| last != value));
                last = Some(value);
                match counts.get_mut(place) {
                    Some(count) => *count += 1,
                    None => break,
                }
            }
            is_clipped(counts[0], counts[1], usual / step)
        };
        at_limit(&mut values.iter().copied()) || at_limit(&mut values.iter().rev().copied())
    })
}

/// Smallest full scale that is searched, counts: below, 1 g may read a power of two.
const MIN_FULL_SCALE: f64 = 255.0;
/// Fewest of the six ends of the axes that are at the limit: fewer may be a coincidence.
const MIN_ENDS: usize = 3;
/// Largest difference of a pose's mean from full scale, counts.
const AT_FULL_SCALE: f64 = 0.25;

/// The axis at full scale, where poses of several ends are: the counts range from −2ᵏ to 2ᵏ − 1, as those of a sensor
/// with that number of bits. Also detects saturation of outputs that are coarser than their noise.
pub(super) fn full_scale(
    samples: &[[f64; 3]],
    poses: &[Pose],
    lsb_mps2: Option<f64>,
) -> Option<usize> {
    let lsb_mps2 = lsb_mps2.filter(|lsb| *lsb > 0.0)?;
    let all = || samples.iter().flatten().map(|y| (y / lsb_mps2).round());
    let (low, high) = (all().fold(0.0, f64::min), all().fold(0.0, f64::max));
    let power = (high + 1.0).log2();
    if high < MIN_FULL_SCALE || low != -high - 1.0 || power.fract() != 0.0 {
        return None;
    }
    let reaches = |axis: usize, limit: f64| {
        let mut means = poses.iter().map(|pose| pose.mean_mps2[axis] / lsb_mps2);
        means.any(|mean| (mean - limit).abs() < AT_FULL_SCALE)
    };
    let ends = || (0..3).flat_map(|axis| [(axis, low), (axis, high)]);
    let at = || ends().filter(|&(axis, limit)| reaches(axis, limit));
    at().next().filter(|_| at().count() >= MIN_ENDS).map(|(axis, _)| axis)
}

/// A limit within this fraction of gravity may be the reading of an ideal sensor.
const GRAVITY_ITSELF: f64 = 0.003;

/// An axis whose extreme reading equals that of other ends exactly: an undeclared limit. Not decidable where other
/// readings are equal too, because they have few digits.
pub(super) fn equal_ends(poses: &[Pose], gravity_mps2: f64) -> Option<usize> {
    let mut sizes: Vec<f64> = poses.iter().flat_map(|pose| pose.mean_mps2.map(f64::abs)).collect();
    sizes.sort_by(f64::total_cmp);
    let limit = *sizes.last()?;
    let below = sizes.partition_point(|size| *size < limit);
    let coarse = sizes[..below].windows(2).any(|pair| pair[0] == pair[1]);
    if below == 0 || coarse || (limit / gravity_mps2 - 1.0).abs() < GRAVITY_ITSELF {
        return None;
    }
    let reaches = |&(axis, end): &(usize, f64)| poses.iter().any(|p| p.mean_mps2[axis] == end);
    let ends = (0..3).flat_map(|axis| [(axis, limit), (axis, -limit)]);
    let at: Vec<(usize, f64)> = ends.filter(reaches).collect();
    at.first().filter(|_| at.len() >= MIN_ENDS).map(|(axis, _)| *axis)
}
