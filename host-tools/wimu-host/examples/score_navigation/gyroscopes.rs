//! The mean of the eight gyroscopes of mimu4444: the reference of the array's angular rate.

use std::path::Path;

use wimu_host::Result;
use wimu_host::formats::{self, ReadOptions};
use wimu_host::recording::Quantity;

/// LSB per deg/s, and the counts at which a gyroscope clips.
const SENSITIVITY: f64 = 16.4;
const LIMIT: f64 = 32_760.0;
/// Samples of the first rest, whose mean is the bias.
const REST_SAMPLES: usize = 300;

/// Mean angular rate less that of the first rest, rad/s, and where one of the gyroscopes is at its limit.
///
/// # Errors
/// Those of [`formats::load`].
pub fn mean_rate(file: &Path) -> Result<(Vec<[f64; 3]>, Vec<bool>)> {
    let recording = formats::load(file, &ReadOptions::default())?;
    let tracks: Vec<_> = recording.of(Quantity::AngularRate).collect();
    let count = tracks.first().map_or(0, |track| track.len());
    let mut mean = vec![[0.0; 3]; count];
    let mut clipped = vec![false; count];
    for track in &tracks {
        for k in 0..count {
            for (axis, counts) in track.row(k).unwrap_or_default().iter().enumerate() {
                mean[k][axis] += (counts / SENSITIVITY).to_radians() / tracks.len() as f64;
                clipped[k] |= counts.abs() >= LIMIT;
            }
        }
    }
    let rest = &mean[..REST_SAMPLES.min(count)];
    let bias: [f64; 3] =
        std::array::from_fn(|axis| rest.iter().map(|m| m[axis]).sum::<f64>() / rest.len() as f64);
    for value in &mut mean {
        *value = std::array::from_fn(|axis| value[axis] - bias[axis]);
    }
    Ok((mean, clipped))
}
