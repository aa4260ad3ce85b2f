//! Calibration against a reference: one stream against another of the same motion.

mod ends;
mod row;
mod sums;

use core::fmt;

use wimu_model::{ErrorModel, ErrorTerms, ModelError, STANDARD_GRAVITY_MPS2};

use crate::{UnitHint, input, student};
use ends::Ends;
use row::{Fitting, How};
use sums::{Jackknife, Recent, Sums};

/// Most blocks that sums are kept for; two become one when they are full.
const BLOCKS: usize = 32;
/// Fewest samples for a standard deviation that means something.
const FEWEST: u64 = 8;
/// An axis that moves less than this, m/s² rms, could be two sensors that warm up together: their
/// drifts would pass for a scale factor.
const LEAST_MOTION_MPS2: f64 = 0.5;
/// Streams of one motion are correlated at least this much where there is motion.
const LEAST_CORRELATION: f64 = 0.9;

/// What an axis sees of another is no chance beyond so many standard deviations.
const SEEN_DEVIATIONS: f64 = 4.0;

/// Noise of the output per noise of the reference (standard deviations), within 10⁻³..=10³.
///
/// A wrong ratio moves the scale factor by at most the share of noise in the variance of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NoiseRatio(f64);

impl NoiseRatio {
    /// Both are as noisy: two sensors of a kind.
    pub const EQUAL: Self = Self(1.0);

    /// From the two standard deviations of one sample, m/s²; `None` when either is not positive and
    /// finite. A ratio beyond 10³ is taken as 10³.
    pub fn new(output_sd_mps2: f64, reference_sd_mps2: f64) -> Option<Self> {
        let ratio = output_sd_mps2 / reference_sd_mps2;
        let sound = output_sd_mps2 > 0.0 && reference_sd_mps2 > 0.0 && ratio.is_finite();
        sound.then(|| Self(ratio.clamp(1e-3, 1e3)))
    }

    /// The ratio.
    pub fn get(self) -> f64 {
        self.0
    }
}

impl Default for NoiseRatio {
    fn default() -> Self {
        Self::EQUAL
    }
}

/// What tells how much of an axis's noise is whose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NoiseFrom {
    /// The ratio that was given.
    Ratio,
    /// Neighbouring samples, which share the motion and not the noise.
    Neighbours,
    /// Nothing: the motion is too fast for the sample rate, or the noise not white. The scale factor
    /// is somewhere between what it is if all noise is the reference's and if all is the output's; its
    /// standard deviation includes that.
    Bounds,
}

/// An axis of the output by those of the reference, y = b + A x, A being this axis's row.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Line {
    /// b, m/s².
    pub bias_mps2: f64,
    /// Scale factor S, what it sees of its own axis.
    pub scale: f64,
    /// What it sees of X, Y, Z; 0 of an axis that is not fitted.
    pub row: [f64; 3],
    /// Which of them are fitted: its own, and those that move on their own.
    pub fitted: [bool; 3],
    /// Covariance of b and the row. Of an axis that is not fitted, two sensors are taken to see 2 %
    /// (1 σ), and what that makes of the others is in theirs; of one sensor, nothing.
    pub covariance: [[f64; 4]; 4],
    /// Degrees of freedom of the standard deviations of b and of S: fewer where few parts of the motion
    /// decide.
    pub dof: [f64; 2],
    /// What parted the noises.
    pub noise_from: NoiseFrom,
}

impl Line {
    /// Half widths of the 95 % intervals of b, m/s², and of S, Student's.
    pub fn half_widths_95(&self) -> [f64; 2] {
        // S is what an axis sees most of.
        let own = (0..3).max_by(|&a, &b| self.row[a].abs().total_cmp(&self.row[b].abs()));
        let variances = [0, own.map_or(0, |own| 1 + own)].map(|i| self.covariance[i][i]);
        [0, 1].map(|i: usize| student::two_sided(0.05, self.dof[i]) * libm::sqrt(variances[i]))
    }
}

/// One axis of a stream against that of the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AxisTransfer {
    /// Mean of the reference, m/s²: where the offset holds.
    pub at_mps2: f64,
    /// Mean of output less reference, m/s².
    pub offset_mps2: f64,
    /// Its standard deviation, m/s².
    pub offset_sd_mps2: f64,
    /// Motion of the axis, m/s² rms about its mean, without noise.
    pub motion_mps2: f64,
    /// What the answer leaves of output less reference, m/s² rms.
    pub rms_mps2: f64,
    /// What the axis sees of the other two of the reference, as a share, where that is beyond chance: the
    /// streams' axes are not parallel.
    pub seen_of: [f64; 3],
    /// Bias and scale factor; `None` where the axis moved less than 0.5 m/s² rms, so that only
    /// their sum, the offset, is known.
    pub line: Option<Line>,
}

/// What a stream is against the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Transfer {
    /// X, Y, Z.
    pub axes: [AxisTransfer; 3],
    /// Pairs of samples.
    pub samples: u64,
    /// Pairs left out because a value was not finite.
    pub not_finite: u64,
    /// Degrees of freedom of the standard deviations, for Student's intervals.
    pub dof: usize,
}

impl Transfer {
    /// The error model that makes the reference of the output; an axis of which only the offset is
    /// known has scale factor 1 and the offset as bias.
    ///
    /// # Errors
    /// [`ModelError`] when that is no accelerometer's.
    pub fn model(&self) -> Result<ErrorModel, ModelError> {
        let mut terms = ErrorTerms::default();
        for (axis, transfer) in self.axes.iter().enumerate() {
            match transfer.line {
                Some(line) => {
                    terms.bias_mps2[axis] = line.bias_mps2;
                    terms.matrix[axis] = line.row;
                }
                None => terms.bias_mps2[axis] = transfer.offset_mps2,
            }
        }
        ErrorModel::new(terms)
    }
}

/// Why two streams say nothing about each other.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum TransferRefusal {
    /// Fewer pairs of samples than 8.
    TooFewSamples {
        /// How many there are.
        have: u64,
    },
    /// The size of a stream cannot be that of specific force in m/s².
    UnexpectedMagnitude {
        /// Whether it is the reference's.
        reference: bool,
        /// Its root mean square, m/s² if the unit were right.
        rms_mps2: f64,
        /// What the numbers look like.
        hint: UnitHint,
    },
    /// The axes move, but not together.
    NotTheSameMotion {
        /// 0 = X.
        axis: usize,
        /// Their correlation.
        correlation: f64,
    },
    /// One part of the motion alone decides the scale factor.
    OneMotionOnly {
        /// 0 = X.
        axis: usize,
    },
    /// A stream stops at one reading where the other goes on.
    Saturated {
        /// Whether it is the reference.
        reference: bool,
        /// 0 = X.
        axis: usize,
        /// The reading, m/s².
        at_mps2: f64,
        /// How many samples are at it.
        samples: u64,
    },
}

/// Streams correlated by less than this show the same motion with the other sign.
const NEGATED: f64 = -0.9;

impl fmt::Display for TransferRefusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |axis: usize| ["X", "Y", "Z"].get(axis).copied().unwrap_or("?");
        match *self {
            Self::TooFewSamples { have } => write!(
                out,
                "{have} samples are on both streams, 8 are needed: record both at the same time"
            ),
            Self::UnexpectedMagnitude {
                reference,
                rms_mps2,
                hint,
            } => {
                let which = if reference { "reference" } else { "output" };
                write!(out, "the {which} is {rms_mps2:.4} rms, {hint}")
            }
            Self::NotTheSameMotion { axis, correlation } if correlation < NEGATED => write!(
                out,
                "axis {} of one stream is that of the other negated (correlated by {correlation:.2}): turn its \
                 sign in one of them, or check how the sensors are mounted",
                name(axis)
            ),
            Self::NotTheSameMotion { axis, correlation } => write!(
                out,
                "axis {} of the two streams is correlated by {correlation:.2} only: they show \
                 different motions; check that samples are paired in time, and axes and their signs",
                name(axis)
            ),
            Self::OneMotionOnly { axis } => write!(
                out,
                "all motion of axis {} is in one short part of the recording, which decides alone: \
                 move it more than once, or hold it in several orientations",
                name(axis)
            ),
            Self::Saturated {
                reference,
                axis,
                at_mps2,
                samples,
            } => write!(
                out,
                "axis {} of the {} stops at {at_mps2:.3} m/s² in {samples} samples while the other goes \
                 on: it is saturated; choose a larger range, or move it less",
                name(axis),
                if reference { "reference" } else { "output" }
            ),
        }
    }
}

impl core::error::Error for TransferRefusal {}

/// Takes pairs of samples and says what one stream is against the other, both noisy: of every axis
/// that moves bias, scale factor and what it sees of the other two.
/// Equations (50) and (51) of docs/EQUATIONS.md.
///
/// Memory is fixed, 40 KB: sums over blocks whose length grows with the data.
///
/// ```
/// use wimu_calib::{NoiseRatio, ReferenceTransfer};
///
/// let mut transfer = ReferenceTransfer::new(NoiseRatio::EQUAL);
/// for k in 0..1000 {
///     let swing = f64::from(k) * 0.05;
///     let reference = [3.0 * swing.sin(), 3.0 * swing.cos(), 9.81];
///     // The noise of both is left out here.
///     let output = [1.02 * reference[0] + 0.3, reference[1] - 0.1, 9.91];
///     transfer.push(reference, output);
/// }
/// let found = transfer.result()?;
/// let x = found.axes[0].line.ok_or("X moved")?;
/// assert!((x.scale - 1.02).abs() < 1e-9 && (x.bias_mps2 - 0.3).abs() < 1e-9);
/// // Z saw gravity only: bias and scale factor cannot be told apart there.
/// assert!(found.axes[2].line.is_none());
/// assert!((found.axes[2].offset_mps2 - 0.1).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct ReferenceTransfer {
    ratio: Option<NoiseRatio>,
    /// Whether no axis sees another.
    parallel: bool,
    /// The first pair: sums are of what differs from it.
    origin: Option<[[f64; 2]; 3]>,
    recent: Recent,
    blocks: [Sums; BLOCKS],
    ends: [Ends; 3],
    /// Full blocks.
    full: usize,
    /// Samples of a full block, and of the one that is filled.
    length: u64,
    filled: u64,
    samples: u64,
    not_finite: u64,
}

impl ReferenceTransfer {
    /// Nothing taken yet; the ratio of the noises is known.
    pub fn new(ratio: NoiseRatio) -> Self {
        Self::with(Some(ratio))
    }

    /// Nothing taken yet; whose noise it is has to show: where motion is slow for the sample rate,
    /// neighbouring samples share it and not the noise. [`Line::noise_from`] says whether they did.
    pub fn of_unknown_noise() -> Self {
        Self::with(None)
    }

    fn with(ratio: Option<NoiseRatio>) -> Self {
        Self {
            ratio,
            parallel: false,
            origin: None,
            recent: Recent::none(),
            blocks: [Sums::NONE; BLOCKS],
            ends: [Ends::none(); 3],
            full: 0,
            length: 1,
            filled: 0,
            samples: 0,
            not_finite: 0,
        }
    }

    /// Both streams are of one sensor, over two links: their axes are the same.
    #[must_use]
    pub fn of_one_sensor(self) -> Self {
        Self {
            parallel: true,
            ..self
        }
    }

    /// Takes the next sample of both streams, m/s², taken at the same time.
    pub fn push(&mut self, reference_mps2: [f64; 3], output_mps2: [f64; 3]) {
        let finite = |v: [f64; 3]| v.iter().all(|c| c.abs() < 1e6);
        if !finite(reference_mps2) || !finite(output_mps2) {
            self.not_finite += 1;
            self.recent = Recent::none();
            return;
        }
        let [x, y, z] = reference_mps2;
        let [u, v, w] = output_mps2;
        let pairs = [[x, u], [y, v], [z, w]];
        let origin = *self.origin.get_or_insert(pairs);
        if self.full == BLOCKS {
            for k in 0..BLOCKS / 2 {
                self.blocks[k] = self.blocks[2 * k].plus(&self.blocks[2 * k + 1], 1.0);
            }
            for block in self.blocks.iter_mut().skip(BLOCKS / 2) {
                *block = Sums::NONE;
            }
            self.full = BLOCKS / 2;
            self.length *= 2;
        }
        let about = |axis: usize| [0, 1].map(|side: usize| pairs[axis][side] - origin[axis][side]);
        let about = [0, 1, 2].map(about);
        for (ends, pair) in self.ends.iter_mut().zip(about) {
            ends.take(pair);
        }
        if let Some(block) = self.blocks.get_mut(self.full) {
            block.take(about, &mut self.recent);
            self.filled += 1;
            if self.filled >= self.length {
                self.full += 1;
                self.filled = 0;
            }
        }
        self.samples += 1;
    }

    /// What the pairs taken so far say.
    ///
    /// # Errors
    /// [`TransferRefusal`].
    pub fn result(&self) -> Result<Transfer, TransferRefusal> {
        let (Some(origin), FEWEST..) = (self.origin, self.samples) else {
            return Err(TransferRefusal::TooFewSamples { have: self.samples });
        };
        let origin = origin.map(|pair| pair.map(Into::into));
        let used = self.full + usize::from(self.filled > 0);
        for (side, rms_mps2) in self.sizes(&origin, used).into_iter().enumerate() {
            // Motion makes it larger than gravity by any factor that is not another unit's.
            let hint = input::unit(rms_mps2, STANDARD_GRAVITY_MPS2);
            if let Some(hint) = hint.filter(|hint| *hint != UnitHint::NotGravity) {
                return Err(TransferRefusal::UnexpectedMagnitude {
                    reference: side == 0,
                    rms_mps2,
                    hint,
                });
            }
        }
        let mut axes = [None; 3];
        for (axis, found) in axes.iter_mut().enumerate() {
            *found = Some(self.axis(axis, origin, used)?);
        }
        let [Some(x), Some(y), Some(z)] = axes else {
            return Err(TransferRefusal::TooFewSamples { have: self.samples });
        };
        Ok(Transfer {
            axes: [x, y, z],
            samples: self.samples,
            not_finite: self.not_finite,
            dof: used - 1,
        })
    }

    fn axis(
        &self,
        axis: usize,
        origins: [[f64; 2]; 3],
        used: usize,
    ) -> Result<AxisTransfer, TransferRefusal> {
        let origin = origins[axis];
        let all = self.all(used);
        let without = || {
            let blocks = self.blocks.iter().take(used);
            blocks.map(|block| all.plus(block, -1.0))
        };
        let ratio = self.ratio.unwrap_or(NoiseRatio::EQUAL).0;
        let delta = ratio * ratio;
        let spread = all.spread();
        let moments = spread.axis(axis);
        let offset = origin[1] - origin[0] + moments.y - moments.x;
        let mut offset_sd = Jackknife::<1>::default();
        for sums in without() {
            let left = sums.axis(axis).moments();
            offset_sd.take([left.y - left.x]);
        }
        let slope = moments.slope(delta);
        let motion = slope.map_or(0.0, |slope| libm::sqrt((moments.xy / slope).max(0.0)));
        let mut transfer = AxisTransfer {
            at_mps2: origin[0] + moments.x,
            offset_mps2: offset,
            offset_sd_mps2: libm::sqrt(offset_sd.covariance()[0][0]),
            motion_mps2: motion,
            rms_mps2: libm::sqrt(moments.left(1.0).max(0.0)),
            line: None,
            seen_of: [0.0; 3],
        };
        // What moves at all decides whether the streams can be compared.
        let moves = libm::sqrt(moments.xx.max(moments.yy / delta.max(1.0))) >= LEAST_MOTION_MPS2;
        if !moves {
            return Ok(transfer);
        }
        if let Some(end) = self.ends[axis].stopped(&all.axis(axis), delta) {
            return Err(TransferRefusal::Saturated {
                reference: end.side == 0,
                axis,
                at_mps2: origin[end.side] + end.at,
                samples: end.samples as u64,
            });
        }
        let correlation = moments.xy / libm::sqrt(moments.xx * moments.yy);
        if slope.is_none() || correlation.is_nan() || correlation < LEAST_CORRELATION {
            return Err(TransferRefusal::NotTheSameMotion { axis, correlation });
        }
        let fitting = Fitting::new(axis, origins, &spread, LEAST_MOTION_MPS2, self.parallel);
        let how = match self.ratio {
            Some(_) => How::Deming(delta),
            None => fitting.how(&all),
        };
        let refusal = TransferRefusal::OneMotionOnly { axis };
        let row = fitting.find(&all, how).ok_or(refusal)?;
        let blocks = self.blocks.iter().take(used).map(|block| {
            let left = all.plus(block, -1.0);
            let moves = left.axis(axis).moments().xx > moments.xx * 0.1;
            (*block, fitting.find(&left, how).filter(|_| moves))
        });
        let (scatter, dof) = fitting.scatter(&row, &all, blocks).ok_or(refusal)?;
        let mut covariance = scatter;
        fitting
            .add_unseen(&mut covariance, &all, how, self.parallel)
            .ok_or(refusal)?;
        let sees = [1, 2, 3].map(|i: usize| row[i]);
        for other in (0..3).filter(|&other| other != axis && fitting.with[other]) {
            let variance = scatter[(1 + other, 1 + other)];
            if sees[other].abs() > SEEN_DEVIATIONS * libm::sqrt(variance) + 1e-6 {
                transfer.seen_of[other] = sees[other];
            }
        }
        transfer.rms_mps2 = libm::sqrt(fitting.left(&spread, &sees.into()).max(0.0));
        let own = |other: usize| f64::from(u8::from(other == axis));
        transfer.line = Some(Line {
            bias_mps2: row[0],
            scale: 1.0 + sees[axis],
            row: [0, 1, 2].map(|other| own(other) + sees[other]),
            fitted: fitting.with,
            covariance: [0, 1, 2, 3].map(|i| [0, 1, 2, 3].map(|j| covariance[(i, j)])),
            dof: [dof[0], dof[1 + axis]],
            noise_from: match how {
                How::Deming(_) => NoiseFrom::Ratio,
                How::Neighbours(_) => NoiseFrom::Neighbours,
                How::Bounds => NoiseFrom::Bounds,
            },
        });
        Ok(transfer)
    }

    /// Sums over all blocks.
    fn all(&self, used: usize) -> Sums {
        let blocks = self.blocks.iter().take(used);
        blocks.fold(Sums::NONE, |sums, block| sums.plus(block, 1.0))
    }

    /// Root mean square of the reference and of the output, m/s².
    fn sizes(&self, origins: &[[f64; 2]; 3], used: usize) -> [f64; 2] {
        let spread = self.all(used).spread();
        let mut squares = [0.0; 2];
        for (axis, origin) in origins.iter().enumerate() {
            let m = spread.axis(axis);
            for (square, (mean, spread)) in squares
                .iter_mut()
                .zip([(origin[0] + m.x, m.xx), (origin[1] + m.y, m.yy)])
            {
                *square += mean * mean + spread;
            }
        }
        squares.map(libm::sqrt)
    }
}
