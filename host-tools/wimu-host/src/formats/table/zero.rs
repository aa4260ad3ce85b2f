//! Counts that are not around 0: of unsigned converters, and of two's complement read as unsigned.

use super::layout::Group;
use super::values::median_norm;
use crate::recording::Quantity;
use crate::stats::{median, norm};
use crate::{Code, Problem};

/// Middle of the range of 10, 12, 14 and 16 bits.
const MIDDLES: [f64; 4] = [512.0, 2048.0, 8192.0, 32768.0];
/// Samples of a block by whose standard deviation rest is judged.
const BLOCK: usize = 16;
/// Relative tolerance of the magnitude over orientations.
const TOLERANCE: f64 = 0.15;
/// Cosine of the angle between two orientations that differ.
const OTHER_ORIENTATION: f64 = 0.5;
/// Fraction of samples that may be outside the range that a hypothesis predicts.
const OUTLIERS: f64 = 0.02;

/// What is done to counts before they are scaled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Zero {
    None,
    /// Subtracted.
    At(f64),
    /// 16-bit two's complement written as unsigned.
    Wrapped,
}

impl Zero {
    /// The count that is subtracted.
    pub fn count(self) -> Option<f64> {
        match self {
            Self::At(zero) => Some(zero),
            Self::None | Self::Wrapped => None,
        }
    }

    pub fn apply(self, count: f64) -> f64 {
        match self {
            Self::None => count,
            Self::At(zero) => count - zero,
            Self::Wrapped if count >= 32768.0 => count - 65536.0,
            Self::Wrapped => count,
        }
    }
}

/// Where zero is in the counts of a track: where the user says, LSB, or by its samples.
pub fn find(
    group: &Group,
    samples: &[[f64; 3]],
    given: Option<f64>,
    findings: &mut Vec<Problem>,
) -> Zero {
    let zero = match given {
        // A gyroscope of the same converter, or one that has its zero at 0.
        Some(zero) if group.quantity == Quantity::AngularRate => {
            let is_near = fraction(samples, |v| (v - zero).abs() < 0.5 * zero.abs()) > 0.5;
            if is_near { Zero::At(zero) } else { Zero::None }
        }
        Some(zero) => Zero::At(zero),
        None if samples.is_empty() => Zero::None,
        None if is_wrapped(samples) => Zero::Wrapped,
        None => middle(group, samples).map_or(Zero::None, Zero::At),
    };
    let (text, remedy) = match zero {
        Zero::None => return zero,
        Zero::At(zero) => (
            format!("the counts of `{}` are around {zero}", group.name),
            "it is subtracted; if it is not zero, give --units LSB@N",
        ),
        Zero::Wrapped => (
            format!(
                "the counts of `{}` are two's complement of 16 bits written without sign",
                group.name
            ),
            "65536 is subtracted from those above 32767",
        ),
    };
    findings.push(Code::ZeroCount.note(text).remedy(remedy).of_sensor(group.sensor));
    zero
}

/// Fraction of values for which `holds`.
fn fraction(samples: &[[f64; 3]], holds: impl Fn(f64) -> bool) -> f64 {
    let count = (samples.iter().flatten()).filter(|value| holds(**value)).count();
    count as f64 / (3 * samples.len()).max(1) as f64
}

/// Whether there are values near both ends of 16 bits and hardly any in the middle.
fn is_wrapped(samples: &[[f64; 3]]) -> bool {
    let is_16_bit = samples.iter().flatten().all(|v| (0.0..65536.0).contains(v));
    let middle = fraction(samples, |v| (20_000.0..45_536.0).contains(&v));
    let high = fraction(samples, |v| v >= 45_536.0);
    is_16_bit && middle < OUTLIERS && high > OUTLIERS
}

/// The middle of an unsigned range around which the values are.
fn middle(group: &Group, samples: &[[f64; 3]]) -> Option<f64> {
    let largest = samples.iter().flatten().fold(0.0, |a: f64, b| a.max(*b));
    if samples.iter().flatten().any(|value| *value < 0.0) {
        return None;
    }
    let zero = MIDDLES.into_iter().find(|middle| largest < 2.0 * middle)?;
    let means = axis_means(samples);
    let is_near = |value: f64| (value - zero).abs() < 0.1 * zero;
    if group.quantity == Quantity::AngularRate {
        return means.iter().all(|mean| is_near(*mean)).then_some(zero);
    }
    // 1 g is at most half of the range on either side.
    let inside = fraction(samples, |v| (0.4 * zero..=1.6 * zero).contains(&v));
    if inside < 1.0 - OUTLIERS {
        return None;
    }
    let shifted: Vec<[f64; 3]> = samples.iter().map(|row| row.map(|v| v - zero)).collect();
    let constant = sensitivity(&shifted).is_some();
    // In one orientation: two axes have next to nothing, as on a table.
    let flat = means.iter().filter(|mean| is_near(**mean)).count() >= 2;
    (constant || flat).then_some(zero)
}

fn axis_means(samples: &[[f64; 3]]) -> [f64; 3] {
    [0, 1, 2]
        .map(|axis| samples.iter().map(|row| row[axis]).sum::<f64>() / samples.len().max(1) as f64)
}

/// Samples at rest or near it: a block, the standard deviation in it, and its mean.
type Block<'a> = (&'a [[f64; 3]], f64, [f64; 3]);

/// Blocks of consecutive samples, the calmest first.
fn blocks(samples: &[[f64; 3]]) -> Vec<Block<'_>> {
    let block = |block| {
        let mean = axis_means(block);
        let square = |row: &[f64; 3]| (0..3).map(|k| (row[k] - mean[k]).powi(2)).sum::<f64>();
        let variance = block.iter().map(square).sum::<f64>() / BLOCK as f64;
        (block, variance.sqrt(), mean)
    };
    let mut blocks: Vec<Block> = samples.chunks_exact(BLOCK).map(block).collect();
    blocks.sort_by(|a, b| a.1.total_cmp(&b.1));
    blocks
}

/// Median magnitude in the calmest quarter of the blocks, and the median standard deviation of those.
pub fn at_rest(samples: &[[f64; 3]]) -> Option<(f64, f64)> {
    let blocks = blocks(samples);
    let calm = &blocks[..blocks.len().div_ceil(4)];
    let sd = median(calm.iter().map(|block| block.1)).unwrap_or(f64::INFINITY);
    let calm: Vec<[f64; 3]> = calm.iter().flat_map(|block| block.0).copied().collect();
    Some((median_norm(if calm.is_empty() { samples } else { &calm })?, sd))
}

/// Magnitude at rest, if it is the same in several orientations.
pub fn sensitivity(samples: &[[f64; 3]]) -> Option<f64> {
    let blocks = blocks(samples);
    // Blocks at rest: about as calm as the calmest quarter.
    let limit = 3.0 * blocks.get(blocks.len() / 4)?.1 + 1.0;
    let rests = blocks.iter().filter(|block| block.1 <= limit);
    let rests: Vec<[f64; 3]> = rests.map(|block| block.2).collect();
    let first = rests.first()?;
    let differs = |v: &&[f64; 3]| {
        let dot: f64 = (0..3).map(|k| v[k] * first[k]).sum();
        dot < OTHER_ORIENTATION * norm(**v) * norm(*first)
    };
    let others = rests.iter().filter(differs).count();
    let usual = median_norm(&rests)?;
    let is_alike = |v: &&[f64; 3]| (norm(**v) / usual - 1.0).abs() <= TOLERANCE;
    let alike = rests.iter().filter(is_alike).count();
    (others > 0 && 10 * alike >= 9 * rests.len()).then_some(usual)
}
