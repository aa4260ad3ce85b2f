//! Rests of a recording: those that the detector finds, without the slow motions in them. Equations (129) and (174).

use std::ops::Range;

use nalgebra::Vector3;
use wimu_nav::navigator::Profile;

use super::unit::{Unit, median_step_s};
use super::{Choice, Method};
use crate::imu::Sample;
use crate::rests::{RestDetector, RestLimits};
use crate::stats::median;

/// Means of a rest are taken over this time, s, and are compared where it has this number of them.
const BLOCK_S: f64 = 0.05;
const LEAST_BLOCKS: usize = 20;
/// Least standard deviation of a component of the mean, m/s²: what is within 4.6 times of it changes the velocity by 5 mm/s in
/// a block, half of the deviation of the velocity at a rest. Steps of a coarse sensor are below it.
const LEAST_MPS2: f64 = 0.02;
/// χ² quantile, 99.99 %, and median, 3 degrees of freedom.
const CHI_SQUARE_3: f64 = 21.11;
const MEDIAN_3: f64 = 2.366;

impl Unit<'_> {
    /// Whether the unit is at rest at each sample: a window about the sample, or the times that were given.
    pub(super) fn rests(&self, choice: &Choice, method: Method) -> Vec<bool> {
        if let Some(given) = &choice.rests_s {
            let inside = |t: &f64| given.iter().any(|rest| rest.contains(t));
            return self.times_s.iter().map(inside).collect();
        }
        let mut settings = detector(choice.profile);
        if method != Method::Strapdown {
            settings = settings.without_gyroscope(self.noise_mps2);
        }
        let statistics = self.statistics(settings);
        let at_rest = statistics.iter().map(|statistic| *statistic < settings.threshold);
        let mut rests: Vec<bool> = at_rest.collect();
        self.leave_out_slow_motions(&mut rests, &settings);
        rests
    }

    /// Leaves out the parts of rests at which the specific force is not that of most of the rest: to the variance of a window a
    /// slow motion looks like a rest. χ² test of means over [`BLOCK_S`] about their median. Equation (174).
    fn leave_out_slow_motions(&self, rests: &mut [bool], settings: &RestLimits) {
        let step_s = median_step_s(self.times_s);
        let length = ((BLOCK_S / step_s).round() as usize).max(1);
        for rest in runs(rests) {
            let mean = |block: &[Sample]| {
                block.iter().map(|s| s.force_mps2).sum::<Vector3<f64>>() / block.len() as f64
            };
            let means: Vec<Vector3<f64>> =
                self.samples[rest.clone()].chunks(length).map(mean).collect();
            let sd_mps2 = settings.force_mps2.hypot(self.noise_mps2 / (length as f64).sqrt());
            for block in unlike_most(&means, sd_mps2) {
                let from = rest.start + block * length;
                rests[from..(from + length).min(rest.end)].fill(false);
            }
            for part in runs(&rests[rest.clone()]) {
                if (part.len() as f64) * step_s < settings.window_s && part.len() < rest.len() {
                    rests[rest.start + part.start..rest.start + part.end].fill(false);
                }
            }
        }
    }

    /// Statistic of the window about each sample; the nearest full window at both ends.
    pub(super) fn statistics(&self, mut settings: RestLimits) -> Vec<f64> {
        settings.gravity_mps2 = self.gravity_mps2;
        let mut detector = RestDetector::new(settings);
        let (mut found, mut ahead_s) = (Vec::with_capacity(self.samples.len()), 0.0);
        let mut filling = 0;
        let mut last = f64::INFINITY;
        for sample in self.samples {
            let rate = sample.rate_rad_s.as_ref();
            detector.push(&sample.force_mps2, rate, sample.step_s);
            ahead_s += sample.step_s;
            last = detector.statistic().unwrap_or(f64::INFINITY);
            if ahead_s + 0.5 * sample.step_s >= detector.lag_s() {
                found.push(last);
                filling += usize::from(filling + 1 == found.len() && last.is_infinite());
            }
        }
        let first = found.get(filling).copied().unwrap_or(f64::INFINITY);
        found[..filling].fill(first);
        found.resize(self.samples.len(), last);
        found
    }
}

/// The blocks of a rest that are not like most of it, which has the standard deviation `sd_mps2` of a component at most.
fn unlike_most(blocks: &[Vector3<f64>], sd_mps2: f64) -> Vec<usize> {
    let middle = Vector3::from_fn(|axis, _| {
        median(blocks.iter().map(|block| block[axis])).unwrap_or_default()
    });
    let squares: Vec<f64> = blocks.iter().map(|block| (block - middle).norm_squared()).collect();
    let Some(usual) = median(squares.iter().copied()).filter(|_| blocks.len() >= LEAST_BLOCKS)
    else {
        return Vec::new();
    };
    let sd_mps2 = (usual / MEDIAN_3).sqrt().min(sd_mps2).max(LEAST_MPS2);
    let limit = CHI_SQUARE_3 * sd_mps2 * sd_mps2;
    (0..blocks.len()).filter(|block| squares[*block] > limit).collect()
}

/// The detector of rests for a profile.
pub(super) fn detector(profile: Profile) -> RestLimits {
    match profile {
        Profile::Vehicle => RestLimits::vehicle(),
        _ => RestLimits::default(),
    }
}

/// Runs of samples at rest.
pub(super) fn runs(rests: &[bool]) -> Vec<Range<usize>> {
    let mut found: Vec<Range<usize>> = Vec::new();
    for k in (0..rests.len()).filter(|k| rests[*k]) {
        match found.last_mut().filter(|rest| rest.end == k) {
            Some(rest) => rest.end = k + 1,
            None => found.push(k..k + 1),
        }
    }
    found
}
