//! Calibration against a reference: two streams of the same motion.

mod ends;
mod row;
mod sums;

use alloc::format;

use wimu_model::{ErrorModel, ErrorTerms, ModelError, STANDARD_GRAVITY_MPS2};

use crate::blocks::Blocks;
use crate::orientation::axis_name;
use crate::{Reason, Refusal, UnitHint, input, student};
use ends::Ends;
use nalgebra::Vector3;
use row::{Fitting, How};
use sums::{Pair, Recent, Sums};

/// Largest number of blocks; full blocks are then merged in pairs.
const BLOCKS: usize = 32;
/// Smallest number of samples.
const FEWEST: u64 = 8;
/// Smallest motion for a scale factor, m/s² rms: the drifts of two sensors during warm-up would
/// look like one.
const LEAST_MOTION_MPS2: f64 = 0.5;
/// Smallest correlation of two streams of the same motion.
const LEAST_CORRELATION: f64 = 0.9;

/// Significance threshold of a cross-axis sensitivity, standard deviations.
const SEEN_DEVIATIONS: f64 = 4.0;

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
/// Memory is fixed (45 KB): sums over blocks whose length grows with the recording.
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
#[derive(Clone, Debug)]
pub struct ReferenceTransfer {
    /// Whether cross-axis sensitivity is excluded.
    parallel: bool,
    /// The first pair: sums are of differences from it.
    origin: Option<Pair>,
    recent: Recent,
    blocks: Blocks<Sums, BLOCKS>,
    ends: [Ends; 3],
    samples: u64,
    not_finite: u64,
}

impl Default for ReferenceTransfer {
    fn default() -> Self {
        Self::new()
    }
}

impl ReferenceTransfer {
    /// An empty comparison. The noise of both streams is estimated from lagged products, which requires motion that is
    /// slow for the sample rate. [`Line::noise_from`] says whether it was.
    pub fn new() -> Self {
        Self {
            parallel: false,
            origin: None,
            recent: Recent::new(),
            blocks: Blocks::new(),
            ends: [Ends::none(); 3],
            samples: 0,
            not_finite: 0,
        }
    }

    /// Declares that both streams come from one sensor over two links: their axes are identical.
    #[must_use]
    pub fn of_one_sensor(self) -> Self {
        Self { parallel: true, ..self }
    }

    /// Adds a sample of both streams, m/s², taken at the same time.
    pub fn push(&mut self, reference_mps2: [f64; 3], output_mps2: [f64; 3]) {
        let finite = |v: [f64; 3]| v.iter().all(|c| c.abs() < 1e6);
        if !finite(reference_mps2) || !finite(output_mps2) {
            self.not_finite += 1;
            self.recent.clear();
            return;
        }
        let pair = [reference_mps2, output_mps2].map(Vector3::from);
        let origin = *self.origin.get_or_insert(pair);
        let [x, y] = [pair[0] - origin[0], pair[1] - origin[1]];
        for (axis, ends) in self.ends.iter_mut().enumerate() {
            ends.take([x[axis], y[axis]]);
        }
        if let Some(block) = self.blocks.next(|a, b| a.plus(b, 1.0)) {
            block.take([x, y], &mut self.recent);
        }
        self.samples += 1;
    }

    /// The result for the pairs so far.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn result(&self) -> Result<Transfer, Refusal> {
        let (Some(origin), FEWEST..) = (self.origin, self.samples) else {
            let (have, need) = (self.samples as usize, FEWEST as usize);
            let text = format!(
                "{have} samples are on both streams, {need} are needed: record both at the same time"
            );
            return Err(Refusal::new(Reason::TooFew { have, need }, text));
        };
        let all = self.all();
        let central = all.central();
        let sides = [(central.x, central.xx.diagonal()), (central.y, central.yy)];
        for (side, (mean, variance)) in sides.into_iter().enumerate() {
            let rms_mps2 = libm::sqrt((origin[side] + mean).norm_squared() + variance.sum());
            // Motion increases it by any factor that does not indicate another unit.
            let hint = input::unit(rms_mps2, STANDARD_GRAVITY_MPS2);
            if let Some(hint) = hint.filter(|hint| *hint != UnitHint::NotGravity) {
                return Err(Refusal::unit(
                    ["rms of the reference", "rms of the output"][side],
                    rms_mps2,
                    hint,
                ));
            }
        }
        let axis = |axis| self.axis(axis, origin, &all);
        Ok(Transfer {
            axes: [axis(0)?, axis(1)?, axis(2)?],
            samples: self.samples,
            not_finite: self.not_finite,
            dof: self.blocks.all().len() - 1,
        })
    }

    fn axis(&self, axis: usize, origins: Pair, all: &Sums) -> Result<AxisTransfer, Refusal> {
        let origin = origins.map(|origin| origin[axis]);
        let moments = all.axis(axis).moments();
        // Jackknife over the blocks: equation (51).
        let (mut count, mut mean, mut squares) = (0.0, 0.0, 0.0);
        for block in self.blocks.all() {
            let rest = all.plus(block, -1.0).axis(axis).moments();
            let step = rest.y - rest.x - mean;
            count += 1.0;
            mean += step / count;
            squares += step * (rest.y - rest.x - mean);
        }
        let slope = moments.slope();
        let transfer = AxisTransfer {
            at_mps2: origin[0] + moments.x,
            offset_mps2: origin[1] - origin[0] + moments.y - moments.x,
            offset_sd_mps2: libm::sqrt((count - 1.0) / count * squares),
            motion_mps2: slope.map_or(0.0, |slope| libm::sqrt((moments.xy / slope).max(0.0))),
            rms_mps2: libm::sqrt(moments.left(1.0).max(0.0)),
            line: None,
            cross_axis: [0.0; 3],
        };
        // Without motion the streams cannot be compared.
        let moves = libm::sqrt(moments.xx.max(moments.yy)) >= LEAST_MOTION_MPS2;
        if !moves {
            return Ok(transfer);
        }
        if let Some(end) = self.ends[axis].stopped(&all.axis(axis)) {
            let text = format!(
                "axis {} of the {} stops at {:.3} m/s² in {} samples while the other goes on: it is saturated; choose a \
                 larger range, or move it less",
                axis_name(axis),
                ["reference", "output"][end.side],
                origin[end.side] + end.at,
                end.samples
            );
            return Err(Refusal::new(Reason::Axis { axis, clipped: true }, text));
        }
        let correlation = moments.xy / libm::sqrt(moments.xx * moments.yy);
        if slope.is_none() || correlation.is_nan() || correlation < LEAST_CORRELATION {
            return Err(another_motion(axis, correlation));
        }
        self.line(transfer, axis, origins, all).ok_or_else(|| one_motion_only(axis))
    }

    /// `transfer` with its regression; `None` if a short part of the motion decides.
    fn line(
        &self,
        mut transfer: AxisTransfer,
        axis: usize,
        origins: Pair,
        all: &Sums,
    ) -> Option<AxisTransfer> {
        let spread = all.central();
        let fitting = Fitting::new(axis, origins, &spread, LEAST_MOTION_MPS2, self.parallel);
        let how = fitting.how(all);
        let row = fitting.find(all, how)?;
        let blocks = self.blocks.all().iter().map(|block| {
            let left = all.plus(block, -1.0);
            let moves = left.axis(axis).moments().xx > spread.xx[(axis, axis)] * 0.1;
            (*block, fitting.find(&left, how).filter(|_| moves))
        });
        let (scatter, dof) = fitting.scatter(&row, all, blocks)?;
        let mut covariance = scatter;
        fitting.add_unseen(&mut covariance, all, how, self.parallel)?;
        let sees = [1, 2, 3].map(|i: usize| row[i]);
        for other in (0..3).filter(|&other| other != axis && fitting.with[other]) {
            let variance = scatter[(1 + other, 1 + other)];
            if sees[other].abs() > SEEN_DEVIATIONS * libm::sqrt(variance) + 1e-6 {
                transfer.cross_axis[other] = sees[other];
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
                How::Neighbours(_) => NoiseFrom::Neighbours,
                How::Bounds => NoiseFrom::Bounds,
            },
        });
        Some(transfer)
    }

    /// Sums over all blocks.
    fn all(&self) -> Sums {
        let blocks = self.blocks.all().iter();
        blocks.fold(Sums::default(), |sums, block| sums.plus(block, 1.0))
    }
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
