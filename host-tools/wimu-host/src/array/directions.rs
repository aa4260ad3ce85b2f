//! Whether the axes of each sensor of an array point as those of the others: signs and order.

use nalgebra::{Matrix3, Vector3};

use super::outputs::AtRests;
use crate::stats::median;

/// Fewest orientations, and least rms change of each axis over them, m/s², for the test: rotations about a few axes, in which
/// sensors apart have opposite outputs, change one or two axes only.
const MIN_ORIENTATIONS: usize = 4;
const MIN_CHANGE_MPS2: f64 = 4.0;
/// Correlation over the orientations of two axes that point along each other; between axes of one sensor chance rarely
/// exceeds half of it.
const ALONG: f64 = 0.95;

/// The sensors, of those that are `alive`, with an axis that points otherwise than that of the others, and how.
pub(super) fn wrong(outputs: &AtRests, alive: &[usize]) -> Vec<(usize, String)> {
    let of = |sensor: &usize| {
        let others: Vec<usize> = alive.iter().copied().filter(|other| other != sensor).collect();
        let pairs =
            outputs.iter().filter_map(|rest| Some([rest[*sensor]?, middle(rest, &others)?]));
        let pairs: Vec<[Vector3<f64>; 2]> = pairs.collect();
        Some((*sensor, description(&correlations(&pairs)?)?))
    };
    alive.iter().filter_map(of).collect()
}

/// Median of each axis.
fn middle(rest: &[Option<Vector3<f64>>], sensors: &[usize]) -> Option<Vector3<f64>> {
    let axis = |i: usize| median(sensors.iter().filter_map(|k| rest[*k]).map(|value| value[i]));
    Some(Vector3::new(axis(0)?, axis(1)?, axis(2)?))
}

/// Correlation of each axis of the first with each of the second; `None` where an axis hardly changes.
fn correlations(pairs: &[[Vector3<f64>; 2]]) -> Option<Matrix3<f64>> {
    if pairs.len() < MIN_ORIENTATIONS {
        return None;
    }
    let count = pairs.len() as f64;
    let mean = |k: usize| pairs.iter().map(|pair| pair[k]).sum::<Vector3<f64>>() / count;
    let means = [mean(0), mean(1)];
    let (mut products, mut squares) = (Matrix3::zeros(), [Vector3::zeros(); 2]);
    for pair in pairs {
        let [own, other] = [pair[0] - means[0], pair[1] - means[1]];
        products += own * other.transpose();
        squares[0] += own.component_mul(&own);
        squares[1] += other.component_mul(&other);
    }
    let least = count * MIN_CHANGE_MPS2 * MIN_CHANGE_MPS2;
    let changes = squares.iter().all(|squares| squares.min() > least);
    let [own, other] = squares.map(|squares| squares.map(|square: f64| 1.0 / square.sqrt()));
    changes.then(|| products.component_mul(&(own * other.transpose())))
}

fn description(correlations: &Matrix3<f64>) -> Option<String> {
    let wrong = (0..9).map(|k| (k / 3, k % 3)).find_map(|(own, other)| {
        let correlation = correlations[(own, other)];
        // Over few orientations several axes of the others may change alike.
        let is_right = correlations[(own, own)] > ALONG;
        let is_along = correlation.abs() > ALONG && !is_right;
        is_along.then_some((own, other, if correlation < 0.0 { "−" } else { "+" }))
    });
    let (own, other, sign) = wrong?;
    let [own, other] = [own, other].map(|axis| ["X", "Y", "Z"][axis]);
    Some(format!("its {own} axis points along {sign}{other} of the other sensors"))
}
