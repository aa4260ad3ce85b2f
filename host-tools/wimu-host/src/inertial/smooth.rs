//! The smoother over a recording: the log of its navigator, and the points that it corrects.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use wimu_nav::navigator::Navigator;
use wimu_nav::smoother::{Epoch, Log, Smoothed};
use wimu_nav::state::{ATTITUDE, Block, POSITION, VELOCITY};

use super::PathPoint;

/// Longest interval between two epochs, s. The correction between them is linear in time: with an unknown acceleration of
/// 0.5 m/s² that is right to 0.6 mm.
const INTERVAL_S: f64 = 0.1;
/// Memory of the epochs that are smoothed at once, bytes: a quarter of an hour in a hand.
const BLOCK_BYTES: usize = 800 << 20;
/// Part of a block that is smoothed once more with the next one, so that it has measurements after it.
const OVERLAP: f64 = 0.2;

/// What the smoother knows of the displacement between two samples.
#[derive(Clone, Debug)]
pub(crate) struct Change {
    /// The samples.
    pub from: usize,
    pub to: usize,
    /// m².
    pub covariance: Matrix3<f64>,
}

/// What a navigator records, or nothing.
#[derive(Clone, Debug)]
pub(crate) struct Tape {
    /// Sample of each epoch of the log.
    samples: Vec<usize>,
    /// Samples between which the covariance of the displacement is wanted.
    spans: Vec<(usize, usize)>,
    pub changes: Vec<Change>,
    pub contradictions: usize,
}

impl Tape {
    pub fn new(smooth: bool, spans: Vec<(usize, usize)>, navigator: &mut Navigator) -> Self {
        if smooth {
            navigator.record(Log::new(INTERVAL_S));
        }
        Self { samples: Vec::new(), spans, changes: Vec::new(), contradictions: 0 }
    }

    /// After the point of a sample: which epochs are its own. Smooths when there are enough of them.
    pub fn mark(&mut self, navigator: &mut Navigator, points: &mut [PathPoint]) {
        let states = navigator.filter().states();
        let Some(log) = navigator.log_mut() else {
            return;
        };
        self.samples.resize(log.epochs.len(), points.len() - 1);
        let block = BLOCK_BYTES / Epoch::bytes(states);
        if log.epochs.len() >= block {
            let cut = ((1.0 - OVERLAP) * block as f64) as usize;
            let kept = log.epochs[cut..].to_vec();
            let epochs = std::mem::replace(&mut log.epochs, kept);
            self.smooth(epochs, cut, points);
            self.samples.drain(..cut);
        }
    }

    /// After the last sample.
    pub fn finish(&mut self, navigator: &mut Navigator, points: &mut [PathPoint]) {
        if let Some(log) = navigator.log_mut() {
            let epochs = std::mem::take(&mut log.epochs);
            let end = epochs.len().saturating_sub(1);
            self.smooth(epochs, end, points);
        }
    }

    /// Smooths epochs, and corrects the points up to the sample of one of them.
    fn smooth(&mut self, mut epochs: Vec<Epoch>, end: usize, points: &mut [PathPoint]) {
        let smoothed = Smoothed::of(&mut epochs);
        self.contradictions += smoothed.contradictions();
        let spans = self.spans.iter();
        self.changes.extend(spans.filter_map(|(from, to)| {
            let first = self.samples[..=end].partition_point(|s| s <= from);
            let last = self.samples[..=end].partition_point(|s| s < to);
            let covariance = (first > 0 && last <= end)
                .then(|| smoothed.covariance_of_change(first - 1, last, POSITION))??;
            Some(Change { from: *from, to: *to, covariance })
        }));
        let epochs = (0..end).filter(|epoch| smoothed.is_linked(epoch + 1));
        for epoch in epochs {
            let (from, to) = (self.samples[epoch], self.samples[epoch + 1]);
            let begin_s = points[from].time_s;
            let lasts_s = (points[to].time_s - begin_s).max(f64::MIN_POSITIVE);
            for point in &mut points[from..to] {
                let part = (point.time_s - begin_s) / lasts_s;
                correct(point, &smoothed, epoch, part.clamp(0.0, 1.0));
            }
        }
    }
}

/// Corrects a point, and replaces its covariance, a part of the interval after an epoch.
fn correct(point: &mut PathPoint, smoothed: &Smoothed, epoch: usize, part: f64) {
    let error = |block: Block<3>| {
        let after = smoothed.corrections(epoch, block)[1];
        after + (smoothed.corrections(epoch + 1, block)[0] - after) * part
    };
    let variance = |block: Block<3>| {
        let [now, next] = [epoch, epoch + 1].map(|k| smoothed.covariance(k, block));
        now + (next - now) * part
    };
    let deviation = |block| variance(block).diagonal().map(|v: f64| v.max(0.0).sqrt()).into();
    point.position_m = (Vector3::from(point.position_m) + error(POSITION)).into();
    point.velocity_mps = (Vector3::from(point.velocity_mps) + error(VELOCITY)).into();
    let [w, x, y, z] = point.quaternion;
    let attitude = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let attitude = UnitQuaternion::from_scaled_axis(error(ATTITUDE)) * attitude;
    point.quaternion = [attitude.w, attitude.i, attitude.j, attitude.k];
    point.covariance_m2 = variance(POSITION).into();
    point.velocity_sd_mps = deviation(VELOCITY);
    point.attitude_sd_rad = deviation(ATTITUDE);
}
