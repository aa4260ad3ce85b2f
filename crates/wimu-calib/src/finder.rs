//! Static poses in a continuous recording: equation (10).

mod moments;

use alloc::vec::Vec;

use crate::Pose;
use moments::Moments;
use moments::Noise;

/// Number of blocks in the shortest hold.
const BLOCKS: usize = 8;
/// Shortest hold, s.
const HOLD_S: f64 = 0.75;
/// Motion threshold: variance of block means over the variance that the noise within the blocks
/// explains. A steady rotation gives about 100.
const MOST_SCATTER_PER_NOISE: f64 = 6.0;
/// Rotation threshold: sum of squares of a line through the block means over the mean square about
/// it. F quantile, 3 and 18 degrees of freedom, 1 − 10⁻⁶.
const STEADY_TURN: f64 = 25.7;
/// Departure of a block mean from the mean of the hold that ends it, m/s²: 0.5° of gravity.
const HOLD_DEPARTURE_MPS2: f64 = 0.085;
/// Holds closer than this, m/s² (2° of gravity), without motion between them are one disturbed
/// hold.
const SAME_POSE_MPS2: f64 = 0.34;
/// Distance of a block mean from the last pose that counts as motion, m/s²: 10° of gravity.
const MOVED_MPS2: f64 = 1.7;
/// Number of successive such blocks that is motion; a knock is shorter.
const MOVED_BLOCKS: u8 = 2;

/// Finds the static poses in a stream of samples.
///
/// Push every sample in order. A [`Pose`] is returned when the sensor moves on, or by
/// [`finish`](Self::finish). There is no threshold to set: the finder estimates the noise of the
/// sensor from the stream. Time is counted in samples only, so the same samples give the same
/// poses. For a recording prefer [`find_poses`], which estimates the noise first.
///
/// A hold is at rest when, over 0.75 s, neither its variance nor the variance of its block means is
/// far above the smallest ones seen, and its block means do not follow a line in time, as in a slow
/// rotation. Its first and last block are left out. A hold interrupted by a knock is one pose, from
/// its longer part.
#[derive(Clone, Debug)]
pub struct PoseFinder {
    rate_hz: f64,
    block_samples: u32,
    next_sample: u64,
    celsius: Option<f64>,
    last: Option<[f64; 3]>,
    /// Smallest change from one sample to the next.
    step: f64,
    noise: Noise,
    /// The block that is being filled.
    block: Moments,
    /// The latest blocks, oldest first; the last `filled` of them are valid.
    window: [Moments; BLOCKS],
    filled: usize,
    /// The hold under way.
    hold: Option<Hold>,
    /// A finished pose that the next hold may continue.
    candidate: Option<Moments>,
    /// Number of latest blocks in motion relative to it.
    away_blocks: u8,
}

/// A hold under way.
#[derive(Clone, Copy, Debug)]
struct Hold {
    inner: Moments,
    /// The latest block, left out if the hold ends: motion may have begun in it.
    edge: Moments,
    /// Whether a part of it was not a steady rotation.
    rested: bool,
}

impl PoseFinder {
    /// A finder for samples at `rate_hz`. The shortest hold is 0.75 s, at least 16 samples. Rates
    /// that are not positive count as 1 Hz.
    pub fn new(rate_hz: f64) -> Self {
        Self::with_noise(rate_hz, Noise::NOTHING_SEEN)
    }

    /// A finder with known noise.
    fn with_noise(rate_hz: f64, noise: Noise) -> Self {
        let samples = rate_hz * HOLD_S / BLOCKS as f64;
        Self {
            rate_hz: if rate_hz > 0.0 { rate_hz } else { 1.0 },
            // NaN becomes 0.
            block_samples: (libm::ceil(samples) as u32).clamp(2, 1_000_000),
            next_sample: 0,
            celsius: None,
            last: None,
            step: noise.step,
            noise,
            block: Moments::default(),
            window: [Moments::default(); BLOCKS],
            filled: 0,
            hold: None,
            candidate: None,
            away_blocks: 0,
        }
    }

    /// Sets the temperature of the following samples, °C.
    pub fn set_temperature(&mut self, celsius: Option<f64>) {
        self.celsius = celsius.filter(|c| c.is_finite());
    }

    /// The current hold as a pose; `None` in motion.
    pub fn held(&self) -> Option<Pose> {
        self.rest().map(|hold| hold.inner.pose(self.rate_hz, &self.noise))
    }

    fn rest(&self) -> Option<&Hold> {
        self.hold.as_ref().filter(|hold| hold.rested)
    }

    /// Takes one sample y, m/s², sensor axes. A sample that is not finite counts as motion.
    pub fn push(&mut self, output_mps2: [f64; 3]) -> Option<Pose> {
        let index = self.next_sample;
        self.next_sample += 1;
        if !output_mps2.iter().all(|y| y.is_finite()) {
            self.last = None;
            self.filled = 0;
            self.block = Moments::default();
            return self.end_hold();
        }
        let mut difference = 0.0;
        if let Some(last) = self.last.replace(output_mps2) {
            for axis in 0..3 {
                let step = (output_mps2[axis] - last[axis]).abs();
                difference += step * step;
                if step > 0.0 && step < self.step {
                    self.step = step;
                    self.noise.step = step;
                }
            }
        }
        if self.block.samples == 0 {
            self.block.first = index;
        }
        self.block.add(output_mps2, difference, self.celsius);
        if self.block.samples < self.block_samples {
            return None;
        }
        let block = core::mem::take(&mut self.block);
        self.push_block(block)
    }

    /// The last pose, if the stream ends at rest. Call it until it returns `None`: an earlier pose
    /// may be pending.
    pub fn finish(&mut self) -> Option<Pose> {
        self.filled = 0;
        self.block = Moments::default();
        self.end_hold()
            .or_else(|| self.candidate.take().map(|found| found.pose(self.rate_hz, &self.noise)))
    }

    fn push_block(&mut self, block: Moments) -> Option<Pose> {
        self.window.rotate_left(1);
        if let Some(newest) = self.window.last_mut() {
            *newest = block;
        }
        self.filled = (self.filled + 1).min(BLOCKS);
        if self.window_is_still() && self.belongs_to_hold(&block) {
            let rests = !self.window_turns();
            self.hold = Some(match self.hold.take() {
                Some(mut hold) => {
                    hold.inner.merge(&hold.edge);
                    Hold { edge: block, rested: hold.rested || rests, ..hold }
                }
                None => self.begin_hold(rests),
            });
            return None;
        }
        let ended = self.end_hold();
        if ended.is_some() {
            return ended;
        }
        let away = self
            .candidate
            .is_some_and(|found| block.departure(&found.mean) > MOVED_MPS2 * MOVED_MPS2);
        self.away_blocks = if away { self.away_blocks + 1 } else { 0 };
        if self.away_blocks < MOVED_BLOCKS {
            return None;
        }
        self.away_blocks = 0;
        self.candidate.take().map(|found| found.pose(self.rate_hz, &self.noise))
    }

    /// Stationarity detector: whether the window is at rest. Updates the noise estimate.
    fn window_is_still(&mut self) -> bool {
        if self.filled < BLOCKS {
            return false;
        }
        let mut whole = Moments::default();
        for block in &self.window {
            whole.merge(block);
        }
        let variance = whole.variance();
        let (mut scatter, mut departure, mut within) = (0.0, 0.0_f64, 0.0);
        for block in &self.window {
            let apart = block.departure(&whole.mean);
            scatter += apart / (BLOCKS - 1) as f64;
            departure = departure.max(apart);
            within += block.squares.iter().sum::<f64>();
        }
        let size = f64::from(self.block_samples);
        let noise_of_a_mean = within / (BLOCKS as f64 * (size - 1.0) * size);
        let explains = scatter <= MOST_SCATTER_PER_NOISE * noise_of_a_mean;
        // Exactly repeated samples are a frozen stream and show no noise.
        if self.window.iter().all(|block| block.variance() > 0.0) {
            self.noise.variance = self.noise.variance.min(variance);
            self.noise.scatter = self.noise.scatter.min(scatter);
            let new = whole.differences / (2.0 * f64::from(whole.samples));
            self.noise.new = self.noise.new.min(new);
        }
        variance <= self.noise.most_variance()
            && departure <= self.noise.most_departure(self.block_samples, explains)
    }

    /// Whether the block means follow a line in time, as in a slow rotation.
    fn window_turns(&self) -> bool {
        let centre = 0.5 * (BLOCKS - 1) as f64;
        let times = || (0..BLOCKS).map(|k| k as f64 - centre);
        let along: f64 = times().map(|t| t * t).sum();
        let (mut line, mut about) = (0.0, 0.0);
        for axis in 0..3 {
            let means = || self.window.iter().map(move |block| block.mean[axis]);
            let mean = means().sum::<f64>() / BLOCKS as f64;
            let slope = times().zip(means()).map(|(t, y)| t * (y - mean)).sum::<f64>() / along;
            line += slope * slope * along;
            about += times()
                .zip(means())
                .map(|(t, y)| y - mean - slope * t)
                .map(|apart| apart * apart)
                .sum::<f64>();
        }
        line > STEADY_TURN * (about / (BLOCKS - 2) as f64).max(self.noise.rounding())
    }

    fn belongs_to_hold(&self, block: &Moments) -> bool {
        self.hold.is_none_or(|hold| {
            let most = HOLD_DEPARTURE_MPS2
                + libm::sqrt(self.noise.most_departure(self.block_samples, true));
            block.departure(&hold.inner.mean) <= most * most
        })
    }

    /// A hold of all blocks in the window but the first, in which motion may have ended.
    fn begin_hold(&self, rested: bool) -> Hold {
        let mut inner = Moments::default();
        for block in &self.window[1..BLOCKS - 1] {
            inner.merge(block);
        }
        Hold { inner, edge: self.window[BLOCKS - 1], rested }
    }

    /// Ends the current hold. Returns the previous pose, if this hold does not continue it.
    fn end_hold(&mut self) -> Option<Pose> {
        let hold = self.hold.take()?;
        // The next hold must not begin with blocks of this one.
        self.filled = self.filled.min(1);
        if !hold.rested {
            return None;
        }
        let found = hold.inner;
        let Some(before) = self.candidate else {
            self.candidate = Some(found);
            return None;
        };
        if found.departure(&before.mean) <= SAME_POSE_MPS2 * SAME_POSE_MPS2 {
            if found.samples > before.samples {
                self.candidate = Some(found);
            }
            return None;
        }
        self.candidate = Some(found);
        Some(before.pose(self.rate_hz, &self.noise))
    }
}

/// Finds the static poses in a recording of samples y, m/s², sensor axes, with the temperature in
/// °C where there is one, at `rate_hz`.
///
/// Reads the recording twice: for the noise, then for the poses, as [`PoseFinder`] finds them.
pub fn find_poses<I>(samples: I, rate_hz: f64) -> Vec<Pose>
where
    I: Iterator<Item = ([f64; 3], Option<f64>)> + Clone,
{
    let mut finder = PoseFinder::new(rate_hz);
    for (output, _) in samples.clone() {
        finder.push(output);
    }
    let mut finder = PoseFinder::with_noise(rate_hz, finder.noise);
    let mut poses = Vec::new();
    for (output, celsius) in samples {
        finder.set_temperature(celsius);
        poses.extend(finder.push(output));
    }
    poses.extend(core::iter::from_fn(|| finder.finish()));
    poses
}
