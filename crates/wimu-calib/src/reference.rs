//! Calibration against a reference: two streams of the same motion.

mod regression;

use alloc::format;
use alloc::vec::Vec;

use wimu_model::{ErrorModel, ErrorTerms, ModelError, STANDARD_GRAVITY_MPS2};

use crate::orientation::axis_name;
use crate::{Reason, Refusal, UnitHint, input, student};
use nalgebra::Vector3;
use regression::{How, Pair, Regression, block_length};

/// Smallest number of samples.
const FEWEST: usize = 8;
/// Smallest motion for a scale factor, m/s² rms: the drifts of two sensors during warm-up would
/// look like one.
const LEAST_MOTION_MPS2: f64 = 0.5;
/// Smallest correlation of two streams of the same motion.
const LEAST_CORRELATION: f64 = 0.9;

/// Significance threshold of a cross-axis sensitivity, standard deviations.
const SEEN_DEVIATIONS: f64 = 4.0;
/// Smallest number of samples at an extreme value that may be a limit.
const PILE: usize = 10;
/// Significance threshold for the excess of the other stream there, standard deviations; and the excess that
/// quantisation can hide, in quantisation steps of both streams.
const CLIPPED_DEVIATIONS: f64 = 4.0;
const HIDDEN_STEPS: f64 = 0.5;

/// Source of the ratio of the noises of an axis of output and reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoiseFrom {
    /// Lagged products: successive samples have the motion in common, but not the noise.
    Neighbours,
    /// Unknown: the motion is too fast for the sample rate, or the noise is not white. The scale
    /// factor is the mean of its bounds (all noise in the reference, all in the output), and its
    /// standard deviation includes them.
    Bounds,
}

/// Regression of an axis of the output on the axes of the reference: y = b + A x, where A is the
/// row of this axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// b, m/s².
    pub bias_mps2: f64,
    /// Scale factor S, sensitivity to its own axis.
    pub scale: f64,
    /// Sensitivity to X, Y, Z; 0 for an axis that is not fitted.
    pub row: [f64; 3],
    /// Fitted axes: its own, and those with independent motion.
    pub fitted: [bool; 3],
    /// Covariance of b and the row. For two sensors it includes the effect of axes that are not
    /// fitted, with a cross-axis sensitivity of 2 % (1 σ).
    pub covariance: [[f64; 4]; 4],
    /// Degrees of freedom of the standard deviations of b and S: few if short parts of the motion
    /// dominate.
    pub dof: [f64; 2],
    /// Source of the noise ratio.
    pub noise_from: NoiseFrom,
}

impl Line {
    /// Half widths of the 95 % confidence intervals of b, m/s², and S, by Student's t.
    pub fn half_widths_95(&self) -> [f64; 2] {
        // The largest element is S.
        let own = (0..3).max_by(|&a, &b| self.row[a].abs().total_cmp(&self.row[b].abs()));
        let variances = [0, own.map_or(0, |own| 1 + own)].map(|i| self.covariance[i][i]);
        [0, 1].map(|i: usize| student::two_sided(0.05, self.dof[i]) * libm::sqrt(variances[i]))
    }
}

/// One axis of a stream against that of the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisTransfer {
    /// Mean of the reference, m/s², at which the offset holds.
    pub at_mps2: f64,
    /// Mean of output minus reference, m/s².
    pub offset_mps2: f64,
    /// Its standard deviation, m/s².
    pub offset_sd_mps2: f64,
    /// Motion of the axis, m/s² rms about its mean, noise removed.
    pub motion_mps2: f64,
    /// Residual of output minus reference, m/s² rms.
    pub rms_mps2: f64,
    /// Significant sensitivity to the other axes of the reference: the axes of the streams are not
    /// parallel.
    pub cross_axis: [f64; 3],
    /// Bias and scale factor; `None` if the axis moved less than 0.5 m/s² rms, so that only the
    /// offset is observable.
    pub line: Option<Line>,
}

/// Largest number of pairs that are kept, 1.5 MiB: of 100 Hz, five minutes with every sample.
const MOST_PAIRS: usize = 1 << 15;

/// Result of a comparison with the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transfer {
    /// X, Y, Z.
    pub axes: [AxisTransfer; 3],
    /// Number of sample pairs.
    pub samples: u64,
    /// Number of pairs with a value that is not finite.
    pub not_finite: u64,
    /// Degrees of freedom of the standard deviations, for Student's intervals.
    pub dof: usize,
}

impl Transfer {
    /// The error model of the output with respect to the reference. An axis without
    /// [`AxisTransfer::line`] has scale factor 1 and the offset as bias.
    ///
    /// # Errors
    /// [`ModelError`] when the values are outside the bounds of an accelerometer.
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

/// Compares two noisy streams of the same motion: bias, scale factor and cross-axis sensitivity of
/// every axis that moves. Equations (50) and (51) of docs/reference/equations.
///
/// ```
/// use wimu_calib::ReferenceTransfer;
///
/// let mut transfer = ReferenceTransfer::new();
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
#[derive(Clone, Debug, Default)]
pub struct ReferenceTransfer {
    /// Whether cross-axis sensitivity is excluded.
    parallel: bool,
    /// Every `1 << halvings`-th pair.
    samples: Vec<Pair>,
    halvings: u32,
    /// Number of all pairs.
    count: u64,
    not_finite: u64,
}

impl ReferenceTransfer {
    /// An empty comparison. The noise of both streams is estimated from neighbouring samples, which requires motion that
    /// is slow for the sample rate. [`Line::noise_from`] says whether it was.
    pub fn new() -> Self {
        Self::default()
    }

    /// Declares that both streams come from one sensor over two links: their axes are identical.
    #[must_use]
    pub fn of_one_sensor(self) -> Self {
        Self { parallel: true, ..self }
    }

    /// Adds a sample of both streams, m/s², taken at the same time. Of more than 32,768 every second is used, then every
    /// fourth, and so on: memory is bounded.
    pub fn push(&mut self, reference_mps2: [f64; 3], output_mps2: [f64; 3]) {
        let pair = [reference_mps2, output_mps2];
        if !pair.as_flattened().iter().all(|c| c.abs() < 1e6) {
            self.not_finite += 1;
            return;
        }
        if self.samples.len() == MOST_PAIRS {
            let mut index = 0;
            self.samples.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.halvings += 1;
        }
        if self.count.trailing_zeros() >= self.halvings {
            self.samples.push(pair.map(Vector3::from));
        }
        self.count += 1;
    }

    /// The result for the pairs so far.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn result(&self) -> Result<Transfer, Refusal> {
        let (have, need) = (self.samples.len(), FEWEST);
        if have < need {
            let text = format!(
                "{have} samples are on both streams, {need} are needed: record both at the same time"
            );
            return Err(Refusal::new(Reason::TooFew { have, need }, text));
        }
        for (side, name) in ["rms of the reference", "rms of the output"].into_iter().enumerate() {
            let squares: f64 = self.samples.iter().map(|pair| pair[side].norm_squared()).sum();
            let rms_mps2 = libm::sqrt(squares / have as f64);
            // Motion increases it by any factor that does not indicate another unit.
            let hint = UnitHint::of(rms_mps2, STANDARD_GRAVITY_MPS2);
            if let Some(hint) = hint.filter(|hint| *hint != UnitHint::NotGravity) {
                return Err(Refusal::unit(name, rms_mps2, hint));
            }
        }
        Ok(Transfer {
            axes: [self.axis(0)?, self.axis(1)?, self.axis(2)?],
            samples: self.count,
            not_finite: self.not_finite,
            dof: have.div_ceil(block_length(have)) - 1,
        })
    }

    fn axis(&self, axis: usize) -> Result<AxisTransfer, Refusal> {
        let pairs = || self.samples.iter().map(|[x, y]| [x[axis], y[axis]]);
        let moments = Moments::of(pairs());
        let offset = Regression::new(&self.samples, axis, [false; 3]);
        let slope = moments.slope();
        let transfer = AxisTransfer {
            at_mps2: moments.x,
            offset_mps2: moments.y - moments.x,
            offset_sd_mps2: offset
                .ordinary()
                .map_or(0.0, |found| libm::sqrt(found.scatter()[(0, 0)])),
            motion_mps2: slope.map_or(0.0, |slope| libm::sqrt((moments.xy / slope).max(0.0))),
            rms_mps2: libm::sqrt(moments.left(1.0).max(0.0)),
            line: None,
            cross_axis: [0.0; 3],
        };
        // Without motion the streams cannot be compared.
        if libm::sqrt(moments.xx.max(moments.yy)) < LEAST_MOTION_MPS2 {
            return Ok(transfer);
        }
        // The output first.
        if let Some((side, at, count)) = [1, 0].into_iter().find_map(|side| stopped(pairs(), side))
        {
            let text = format!(
                "axis {} of the {} stops at {at:.3} m/s² in {count} samples while the other goes on: it is saturated; choose \
                 a larger range, or move it less",
                axis_name(axis),
                ["reference", "output"][side],
            );
            return Err(Refusal::new(Reason::Axis { axis, clipped: true }, text));
        }
        let correlation = moments.xy / libm::sqrt(moments.xx * moments.yy);
        if slope.is_none() || correlation.is_nan() || correlation < LEAST_CORRELATION {
            return Err(another_motion(axis, correlation));
        }
        self.line(transfer, axis).ok_or_else(|| one_motion_only(axis))
    }

    /// `transfer` with its regression; `None` if a short part of the motion decides.
    fn line(&self, mut transfer: AxisTransfer, axis: usize) -> Option<AxisTransfer> {
        let least = LEAST_MOTION_MPS2 * LEAST_MOTION_MPS2;
        let fitting = Regression::with_motion(&self.samples, axis, least, self.parallel);
        let (found, how) = fitting.find()?;
        let dof = fitting.dof()?;
        let scatter = found.scatter();
        let covariance = scatter + fitting.unseen(&found, how, self.parallel)?;
        let sees = [1, 2, 3].map(|i: usize| found.row[i]);
        for other in (0..3).filter(|&other| other != axis && fitting.with[other]) {
            let variance = scatter[(1 + other, 1 + other)];
            if sees[other].abs() > SEEN_DEVIATIONS * libm::sqrt(variance) + 1e-6 {
                transfer.cross_axis[other] = sees[other];
            }
        }
        transfer.rms_mps2 = libm::sqrt(found.residual_variance());
        let own = |other: usize| f64::from(u8::from(other == axis));
        transfer.line = Some(Line {
            bias_mps2: found.row[0],
            scale: 1.0 + sees[axis],
            row: [0, 1, 2].map(|other| own(other) + sees[other]),
            fitted: fitting.with,
            covariance: covariance.transpose().into(),
            dof,
            noise_from: match how {
                How::Neighbours(_) => NoiseFrom::Neighbours,
                _ => NoiseFrom::Bounds,
            },
        });
        Some(transfer)
    }
}

/// Means and central second moments of an axis of both streams.
struct Moments {
    n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
}

impl Moments {
    fn of(pairs: impl Iterator<Item = [f64; 2]> + Clone) -> Self {
        let n = pairs.clone().count() as f64;
        let (x, y) = pairs.clone().fold((0.0, 0.0), |(x, y), pair| (x + pair[0], y + pair[1]));
        let mut found = Self { n, x: x / n, y: y / n, xx: 0.0, xy: 0.0, yy: 0.0 };
        for [x, y] in pairs {
            let [x, y] = [x - found.x, y - found.y];
            found.xx += x * x / n;
            found.xy += x * y / n;
            found.yy += y * y / n;
        }
        found
    }

    /// Deming's slope for equal noise.
    fn slope(&self) -> Option<f64> {
        let apart = self.yy - self.xx;
        let root = libm::hypot(apart, 2.0 * self.xy);
        // Two forms of the same root; each keeps its digits on its side.
        let slope = if apart >= 0.0 {
            (apart + root) / (2.0 * self.xy)
        } else {
            2.0 * self.xy / (root - apart)
        };
        (slope.is_finite() && slope != 0.0).then_some(slope)
    }

    /// What is left of y less `slope` times x, squared.
    fn left(&self, slope: f64) -> f64 {
        self.yy - 2.0 * slope * self.xy + slope * slope * self.xx
    }
}

/// The extreme reading at which `side` (0 the reference, 1 the output) is clipped, and its number of samples: on average
/// the other stream exceeds there the regression line through the remaining samples. Noise, which is selected by the
/// extreme value, has the opposite effect.
fn stopped(
    pairs: impl Iterator<Item = [f64; 2]> + Clone,
    side: usize,
) -> Option<(usize, f64, usize)> {
    let limits = input::extremes(pairs.clone().map(|pair| pair[side]));
    let at_limit = |limit: f64| pairs.clone().filter(move |pair| pair[side] == limit);
    let piles = limits.map(|limit| Some(limit).filter(|limit| at_limit(*limit).count() >= PILE));
    let free = Moments::of(pairs.clone().filter(|pair| !piles.contains(&Some(pair[side]))));
    let slope = free.slope().filter(|_| free.n >= PILE as f64)?;
    let noise = libm::sqrt(free.left(slope).max(0.0));
    let step = |side: usize| {
        let steps =
            pairs.clone().zip(pairs.clone().skip(1)).map(|(a, b)| (b[side] - a[side]).abs());
        let least = steps.filter(|step| *step > 0.0).fold(f64::INFINITY, f64::min);
        if least.is_finite() { least } else { 0.0 }
    };
    for (high, limit) in piles.into_iter().enumerate() {
        let Some(limit) = limit else { continue };
        let pile = Moments::of(at_limit(limit));
        let off = pile.y - free.y - slope * (pile.x - free.x);
        // A clipped output is too small; a clipped reference is exceeded.
        let off = if side == 0 && slope < 0.0 { -off } else { off };
        let short = if high == side { -off } else { off };
        let hidden = HIDDEN_STEPS * (step(1) + slope.abs() * step(0));
        if short > CLIPPED_DEVIATIONS * noise / libm::sqrt(pile.n) + hidden {
            return Some((side, limit, pile.n as usize));
        }
    }
    None
}

fn one_motion_only(axis: usize) -> Refusal {
    let text = format!(
        "all motion of axis {} is in one short part of the recording, which decides alone: move it more than once, or hold \
         it in several orientations",
        axis_name(axis)
    );
    Refusal::new(Reason::NotObservable, text)
}

/// The refusal of streams with this correlation coefficient.
fn another_motion(axis: usize, correlation: f64) -> Refusal {
    let name = axis_name(axis);
    if correlation < -LEAST_CORRELATION {
        let text = format!(
            "axis {name} of one stream is that of the other negated (correlated by {correlation:.2}): turn its sign in one \
             of them, or check how the sensors are mounted"
        );
        return Refusal::new(Reason::Axes, text);
    }
    let text = format!(
        "axis {name} of the two streams is correlated by {correlation:.2} only: they show different motions; check that \
         samples are paired in time, and axes and their signs"
    );
    Refusal::new(Reason::PoorFit { rms: correlation, index: axis }, text)
}
