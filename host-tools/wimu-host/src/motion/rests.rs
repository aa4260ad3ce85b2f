//! What looks like a rest in a recording.

use std::ops::RangeInclusive;

use wimu_nav::slide::Rest;
use wimu_nav::unit::UnitSample;

/// A rest in a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestSpan {
    /// First sample.
    pub first: usize,
    /// One past the last sample.
    pub end: usize,
    /// Mean force and its uncertainty.
    pub rest: Rest,
}

/// Blocks that rests are made of, s, and the least samples of one.
const BLOCK_S: f64 = 0.1;
const BLOCK_SAMPLES: f64 = 5.0;
/// A block that a gap cuts off counts from so many samples on.
const LEAST_SAMPLES: usize = 4;
/// Blocks of the shortest rest.
const REST_BLOCKS: usize = 3;
/// From so many on the outermost ones are left out: a move may begin softly.
const TRIMMED_BLOCKS: usize = 5;
/// So many blocks before one are what it must agree with: a bias may drift in a long rest.
const RECENT_BLOCKS: usize = 10;
/// What a block of a rest may depart by beyond its noise, m/s², an axis.
const APART_MPS2: f64 = 0.02;
/// Standard deviations of a block's mean that it may depart by, if its noise were white: much is slower.
const APART_SD: f64 = 6.0;
/// The same of the slope of a short run.
const CREEP_SD: f64 = 4.0;
/// What the angular rate of a rest may differ by from the quietest time's, rad/s, an axis.
const REST_RATE_RAD_S: f64 = 0.03;
/// A longer pause is a gap, s, and times the usual one.
const GAP_S: f64 = 0.25;
const GAP_STEPS: f64 = 4.0;

struct Block {
    first: usize,
    end: usize,
    mean: [f64; 3],
    variance: f64,
    rate: Option<[f64; 3]>,
}

fn mean3(values: impl Iterator<Item = [f64; 3]>) -> Option<[f64; 3]> {
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for value in values {
        for (s, v) in sum.iter_mut().zip(value) {
            *s += v;
        }
        count += 1.0;
    }
    (count > 0.0).then(|| sum.map(|s| s / count))
}

/// Blocks of equally many samples, none across a gap: where they begin does not hang on how a time is
/// rounded.
fn blocks(times_s: &[f64], samples: &[UnitSample]) -> Vec<Block> {
    let step = median_step_s(times_s);
    let length = (BLOCK_S / step).round().clamp(BLOCK_SAMPLES, 1e6) as usize;
    let gap = gap_s(times_s);
    let mut blocks = Vec::new();
    let mut first = 0;
    while first < samples.len() {
        let most = samples.len().min(first + length);
        let end = (first + 1..most)
            .find(|k| times_s[*k] - times_s[k - 1] > gap)
            .unwrap_or(most);
        let part = &samples[first..end];
        let n = part.len() as f64;
        let mean = mean3(part.iter().map(|s| s.force_mps2)).unwrap_or_default();
        let square = part
            .iter()
            .flat_map(|s| (0..3).map(|i| (s.force_mps2[i] - mean[i]).powi(2)))
            .sum::<f64>();
        if part.len() >= LEAST_SAMPLES {
            blocks.push(Block {
                first,
                end,
                mean,
                variance: square / (3.0 * (n - 1.0)),
                rate: mean3(part.iter().filter_map(|s| s.rate_rad_s)),
            });
        }
        first = end;
    }
    blocks
}

/// Median time between samples, s; 0 with fewer than two.
pub fn median_step_s(times_s: &[f64]) -> f64 {
    let mut steps: Vec<f64> = times_s.windows(2).map(|w| w[1] - w[0]).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or(0.0)
}

/// What happened between two samples that are further apart than this is not known, s.
pub fn gap_s(times_s: &[f64]) -> f64 {
    GAP_S.max(GAP_STEPS * median_step_s(times_s))
}

/// What looks like a rest in a recording, 0.3 s and longer: runs of blocks of 0.1 s that are as quiet as
/// the quietest such run (up to 3 times), agree with each other within their noise, and turn no more than
/// what lies still does. Even motion without vibration looks the same, and so does an acceleration that stays.
pub fn rests(times_s: &[f64], samples: &[UnitSample]) -> Vec<RestSpan> {
    let blocks = blocks(times_s, samples);
    let quietest = blocks.windows(REST_BLOCKS).min_by(|a, b| {
        let sum = |w: &[Block]| w.iter().map(|b| b.variance).sum::<f64>();
        sum(a).total_cmp(&sum(b))
    });
    let Some(quietest) = quietest else {
        return Vec::new();
    };
    let level = (quietest.iter().map(|b| b.variance).sum::<f64>() / quietest.len() as f64).sqrt();
    let quiet_mps2 = 3.0 * level + APART_MPS2;
    let still = still_rate(&blocks, quietest, quiet_mps2);
    let gap = gap_s(times_s);
    // Where a last block may end: what comes after it is too short for one.
    let gaps = times_s.windows(2).rposition(|w| w[1] - w[0] > gap);
    let after_gap = gaps.map_or(0, |k| k + 2);
    let tail = after_gap.max((samples.len() + 1).saturating_sub(LEAST_SAMPLES))..=samples.len();
    let mut found = Vec::new();
    let mut run: Vec<&Block> = Vec::new();
    let mut was_slow = false;
    for block in &blocks {
        let turns = match (block.rate, still) {
            (Some(rate), Some(still)) => !near(rate, still, REST_RATE_RAD_S),
            _ => false,
        };
        let quiet = block.variance.sqrt() < quiet_mps2 && !turns;
        let count = (block.end - block.first) as f64;
        let most = APART_MPS2 + APART_SD * level / count.sqrt();
        let recent = run[run.len().saturating_sub(RECENT_BLOCKS)..].iter();
        let agrees = mean3(recent.map(|b| b.mean)).is_none_or(|m| near(m, block.mean, most));
        let goes_on = run.last().is_none_or(|last| {
            last.end == block.first && times_s[block.first] - times_s[last.end - 1] <= gap
        });
        if !(quiet && agrees && goes_on) {
            // Quiet and another: it changes slowly, as a move that begins softly does.
            let slow = quiet && goes_on && !run.is_empty();
            found.extend(span(&run, samples, (was_slow, slow), level, &tail));
            run.clear();
            was_slow = slow;
        }
        if quiet {
            run.push(block);
        }
    }
    found.extend(span(&run, samples, (was_slow, false), level, &tail));
    found
}

fn near(a: [f64; 3], b: [f64; 3], most: f64) -> bool {
    (0..3).all(|i| (a[i] - b[i]).abs() < most)
}

/// What a gyroscope shows that lies still: what it shows at the quietest time, or the least that it holds at
/// any quiet one where that is another. A turn on the spot, or an even circle, is as quiet as a rest and turns
/// more than a bias does.
fn still_rate(blocks: &[Block], quietest: &[Block], quiet_mps2: f64) -> Option<[f64; 3]> {
    let usual = mean3(quietest.iter().filter_map(|b| b.rate))?;
    let quiet = blocks
        .windows(REST_BLOCKS)
        .filter(|w| w.iter().all(|b| b.variance.sqrt() < quiet_mps2));
    let held = quiet.filter_map(|w| {
        let mean = mean3(w.iter().filter_map(|b| b.rate))?;
        let mut rates = w.iter().filter_map(|b| b.rate);
        rates
            .all(|rate| near(rate, mean, REST_RATE_RAD_S))
            .then_some(mean)
    });
    let square = |v: &[f64; 3]| v.iter().map(|c| c * c).sum::<f64>();
    let least = held.min_by(|a, b| square(a).total_cmp(&square(b)));
    Some(
        least
            .filter(|v| !near(*v, usual, REST_RATE_RAD_S) && square(v) < square(&usual))
            .unwrap_or(usual),
    )
}

/// Whether the force changes evenly over a short run, by more than its noise: a soft push, and no rest.
fn creeps(run: &[&Block], level: f64) -> bool {
    let count = run.len() as f64;
    if run.is_empty() || run.len() > RECENT_BLOCKS {
        return false;
    }
    let middle = (count - 1.0) / 2.0;
    let square = count * (count * count - 1.0) / 12.0;
    let samples = (run[0].end - run[0].first) as f64;
    let noise = CREEP_SD * level / (samples * square).sqrt();
    (0..3).any(|i| {
        let sum = (0_u32..)
            .zip(run)
            .map(|(k, b)| (f64::from(k) - middle) * b.mean[i]);
        (count - 1.0) * ((sum.sum::<f64>() / square).abs() - noise) > APART_MPS2
    })
}

/// The rest that a run of blocks is, less its outermost blocks where it is long, or changes slowly there.
fn span(
    run: &[&Block],
    samples: &[UnitSample],
    slow: (bool, bool),
    level: f64,
    tail: &RangeInclusive<usize>,
) -> Option<RestSpan> {
    if creeps(run, level) {
        return None;
    }
    // No move begins where the recording does, or ends with it.
    let starts = run.first()?.first == 0;
    let ends = tail.contains(&run.last()?.end);
    let long = run.len() >= TRIMMED_BLOCKS;
    let from = usize::from((long && !starts) || slow.0);
    let to = run.len() - usize::from((long && !ends) || slow.1);
    let run = run.get(from..to)?;
    if run.len() < REST_BLOCKS {
        return None;
    }
    let (first, mut end) = (run[0].first, run[run.len() - 1].end);
    if ends && !slow.1 {
        end = samples.len();
    }
    let part = &samples[first..end];
    let force_mps2 = mean3(part.iter().map(|s| s.force_mps2)).unwrap_or_default();
    // Blocks' means say how slow the noise is.
    let scatter = run
        .iter()
        .flat_map(|b| (0..3).map(move |i| (b.mean[i] - force_mps2[i]).powi(2)))
        .sum::<f64>();
    let sd_mps2 = (scatter / 3.0 / (run.len() * (run.len() - 1)) as f64).sqrt();
    Some(RestSpan {
        first,
        end,
        rest: Rest {
            force_mps2,
            sd_mps2,
            rate_rad_s: mean3(part.iter().filter_map(|s| s.rate_rad_s)),
        },
    })
}
