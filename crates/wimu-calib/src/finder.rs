//! Static poses in a continuous recording: equation (10).

mod moments;

use crate::Pose;
pub use moments::Noise;
use moments::{Block, Moments};

/// Blocks in the shortest hold.
const BLOCKS: usize = 8;
/// The shortest hold, s.
const HOLD_S: f64 = 0.75;
/// Means of blocks that scatter by more than this many times what the noise within the blocks makes of
/// them move: of a steady turn it is a hundred times.
const MOST_SCATTER_PER_NOISE: f64 = 6.0;
/// A line through the block means of a window, over what scatters about it: beyond, chance makes it once
/// in a million windows (F of 3 and 18 degrees of freedom).
const STEADY_TURN: f64 = 25.7;
/// A hold ends when a block mean departs from the mean of the hold by 0.5° of gravity, m/s².
const HOLD_DEPARTURE_MPS2: f64 = 0.085;
/// Two holds closer than 2° of gravity, m/s², without motion between are one hold, disturbed.
const SAME_POSE_MPS2: f64 = 0.34;
/// Block means farther than 10° of gravity, m/s², from the last pose are motion,
const MOVED_MPS2: f64 = 1.7;
/// when so many follow each other; a knock is shorter.
const MOVED_BLOCKS: u8 = 2;

/// Finds the static poses in a stream of samples.
///
/// Push every sample in order; a [`Pose`] comes out when the sensor is moved on, or from
/// [`finish`](Self::finish). There is no threshold to set: the finder learns the sensor's noise
/// from the stream. It counts samples and never asks for the time, so that the same samples give
/// the same poses wherever they come from. For a recording prefer [`find_poses`], which knows the
/// noise from the start.
///
/// A hold is still when, over 0.75 s, neither its variance nor the scatter of its block means is
/// far above the least seen, and its block means are not all the way on a line in time, as those of a slow turn are;
/// its first and last block are left out. A hold disturbed by a knock is
/// one pose, the longer part of it.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PoseFinder {
    rate_hz: f64,
    block_samples: u32,
    next_sample: u64,
    celsius: Option<f64>,
    last: Option<[f64; 3]>,
    /// Least change from one sample to the next.
    step: f64,
    noise: Noise,
    block: Block,
    /// The last blocks, oldest first; `filled` of them, at the end.
    window: [Moments; BLOCKS],
    filled: usize,
    /// The hold under way.
    hold: Option<Hold>,
    /// A finished pose that the next hold may still continue.
    candidate: Option<Moments>,
    /// How many of the last blocks were away from it.
    away_blocks: u8,
}

/// A hold under way.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Hold {
    inner: Moments,
    /// The last block, left out if the hold ends here: motion may have begun in it.
    edge: Moments,
    /// Whether some of it was no steady turn: of a turn, all is.
    rested: bool,
}

impl PoseFinder {
    /// A finder for samples at `rate_hz`; the shortest hold it finds is 0.75 s, 16 samples at the
    /// least. Rates that make no sense count as the nearest that does.
    pub fn new(rate_hz: f64) -> Self {
        Self::with_noise(rate_hz, Noise::NOTHING_SEEN)
    }

    /// The same, with the sensor's noise known from an earlier look at it.
    pub fn with_noise(rate_hz: f64, noise: Noise) -> Self {
        let samples = rate_hz * HOLD_S / BLOCKS as f64;
        Self {
            rate_hz: if rate_hz > 0.0 { rate_hz } else { 1.0 },
            // Not a number becomes 0 here.
            block_samples: (libm::ceil(samples) as u32).clamp(2, 1_000_000),
            next_sample: 0,
            celsius: None,
            last: None,
            step: noise.step,
            noise,
            block: Block::default(),
            window: [Moments::default(); BLOCKS],
            filled: 0,
            hold: None,
            candidate: None,
            away_blocks: 0,
        }
    }

    /// The noise at rest as far as the stream has shown it.
    pub fn noise(&self) -> Noise {
        self.noise
    }

    /// The temperature from here on, °C.
    pub fn set_temperature(&mut self, celsius: Option<f64>) {
        self.celsius = celsius.filter(|c| c.is_finite());
    }

    /// The hold under way as a pose, if it ended now; `None` while the sensor moves.
    pub fn held(&self) -> Option<Pose> {
        self.rest()
            .map(|hold| hold.inner.pose(self.rate_hz, &self.noise))
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
            self.block = Block::default();
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
        if self.block.rest.samples == 0 {
            self.block.rest.first = index;
        }
        self.block.add(output_mps2, difference, self.celsius);
        if self.block.rest.samples < self.block_samples {
            return None;
        }
        let block = core::mem::take(&mut self.block).moments();
        self.push_block(block)
    }

    /// The last pose, if the stream ends in one.
    ///
    /// Call it until it returns `None`: a pose may have waited for its hold to go on.
    pub fn finish(&mut self) -> Option<Pose> {
        self.filled = 0;
        self.block = Block::default();
        self.end_hold().or_else(|| {
            self.candidate
                .take()
                .map(|found| found.pose(self.rate_hz, &self.noise))
        })
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
                    Hold {
                        edge: block,
                        rested: hold.rested || rests,
                        ..hold
                    }
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
        self.candidate
            .take()
            .map(|found| found.pose(self.rate_hz, &self.noise))
    }

    /// Whether the last blocks are those of a sensor at rest; learns the noise from them.
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
        // Samples that repeat exactly are a stream that hangs: they tell nothing about noise.
        if self.window.iter().all(|block| block.variance() > 0.0) {
            self.noise.variance = self.noise.variance.min(variance);
            self.noise.scatter = self.noise.scatter.min(scatter);
            let new = whole.differences / (2.0 * f64::from(whole.samples));
            self.noise.new = self.noise.new.min(new);
        }
        variance <= self.noise.most_variance()
            && departure <= self.noise.most_departure(self.block_samples, explains)
    }

    /// Whether the last blocks are on a line in time as no noise is: a sensor that is turned slowly.
    fn window_turns(&self) -> bool {
        let centre = 0.5 * (BLOCKS - 1) as f64;
        let times = || (0..BLOCKS).map(|k| k as f64 - centre);
        let along: f64 = times().map(|t| t * t).sum();
        let (mut line, mut about) = (0.0, 0.0);
        for axis in 0..3 {
            let means = || self.window.iter().map(move |block| block.mean[axis]);
            let mean = means().sum::<f64>() / BLOCKS as f64;
            let slope = times()
                .zip(means())
                .map(|(t, y)| t * (y - mean))
                .sum::<f64>()
                / along;
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
        Hold {
            inner,
            edge: self.window[BLOCKS - 1],
            rested,
        }
    }

    /// Ends the hold under way. Returns the pose before it, if this one does not continue it.
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
/// Goes over the recording twice: once for the sensor's noise, once for the poses, as
/// [`PoseFinder`] finds them. Fills `poses` and returns how many it found, which may be more than
/// there is room for; the first ones are kept. In f64 only: a device that has no room for a recording
/// has a stream, and [`PoseFinder`] for that.
pub fn find_poses<I>(samples: I, rate_hz: f64, poses: &mut [Pose]) -> usize
where
    I: Iterator<Item = ([f64; 3], Option<f64>)> + Clone,
{
    let mut finder = PoseFinder::new(rate_hz);
    for (output, _) in samples.clone() {
        finder.push(output);
    }
    let mut finder = PoseFinder::with_noise(rate_hz, finder.noise());
    let mut found = 0;
    let mut keep = |pose: Pose| {
        if let Some(place) = poses.get_mut(found) {
            *place = pose;
        }
        found += 1;
    };
    for (output, celsius) in samples {
        finder.set_temperature(celsius);
        if let Some(pose) = finder.push(output) {
            keep(pose);
        }
    }
    while let Some(pose) = finder.finish() {
        keep(pose);
    }
    found
}
