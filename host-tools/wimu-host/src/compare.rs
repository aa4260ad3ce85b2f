//! Comparison of two links of one board, sample by sample: losses, latency and differences of the values. Also of
//! two tables of any two devices.
//!
//! A recording is read twice and never held in memory: for the clocks, then for the counts and fits.

use std::io::Read;

use serde::Serialize;
use wimu_calib::Transfer;
use wimu_link::LinkRole;
use wimu_link::batch::Stream;

use crate::capture::Link;
use crate::clock::{ClockModel, ClockSummary};
use crate::mcap_file::{RecordingReader, Wholeness};
use crate::problem::without_unit;
use crate::{Code, Problem, Result};

pub(crate) mod align;
mod arrival;
mod counted;
mod delivery;
mod document;
mod link;
mod model;
mod overview;
mod pictures;
mod quantiles;

pub use align::{Alignment, Turn, align};
pub use arrival::ByArrival;
pub use link::{Burst, LinkReport};
pub use model::LinkModel;
pub use quantiles::Quantiles;

use counted::Counted;
use overview::Overview;

/// The reference first.
const ROLES: [LinkRole; 2] = [LinkRole::Cable, LinkRole::Wireless];
/// Number of slices of a recording in the charts over time.
const SLICES: usize = 200;
/// Length of the part of the recording whose samples are shown, ns.
const EXCERPT_NS: u64 = 10_000_000_000;

/// Longest time that data can be under way, ns.
const UNDER_WAY_NS: u64 = 5_000_000_000;

/// Result of the comparison of two links.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// Name of the recording in errors and charts.
    pub source: String,
    /// The board, 16 hex digits, if it was identified.
    pub device_id: Option<String>,
    /// Host time from the first arrival to the last, s.
    pub duration_s: f64,
    /// Completeness of the recording.
    #[serde(flatten)]
    pub wholeness: Wholeness,
    /// Number of starts of the device.
    pub starts: usize,
    /// The stream that both links carry: `raw` or `corrected`.
    pub stream: &'static str,
    /// Samples delivered by both.
    pub pairs: u64,
    /// Of these, those with equal values.
    pub identical: u64,
    /// Pairs with an angular rate on both links.
    pub with_rates: u64,
    /// Pairs with different angular rates.
    pub rates_differ: u64,
    /// Of these, those with a saturated axis on either; excluded from the values.
    pub saturated: u64,
    /// Of these, raw ones of unknown range; excluded from the values.
    pub without_unit: u64,
    /// The cable and the wireless link.
    pub links: [LinkReport; 2],
    /// The device's clock, from both links.
    pub clock: Option<ClockSummary>,
    /// The wireless values against the cable's; `None` where they are not comparable.
    pub values: Option<Values>,
    /// Why they are not.
    pub values_reason: Option<String>,
    /// What was noticed.
    #[serde(skip)]
    pub findings: Vec<Problem>,
    /// Data of the charts.
    #[serde(skip)]
    history: History,
}

/// Values of one stream against another's, m/s², X, Y, Z.
#[derive(Clone, Debug, Serialize)]
pub struct Values {
    /// Axes.
    pub axes: [Axis; 3],
    /// The link's error model.
    #[serde(skip)]
    pub model: LinkModel,
}

/// One axis of a stream against the reference's, m/s².
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Axis {
    /// Mean difference.
    pub offset_mps2: f64,
    /// Its standard deviation.
    pub offset_sd_mps2: f64,
    /// Bias and scale factor with their standard deviations; `None` for an axis that hardly moved,
    /// for which only the offset is known.
    pub line: Option<AxisLine>,
    /// RMS difference before correction.
    pub rms_before_mps2: f64,
    /// RMS difference after correction by the model.
    pub rms_after_mps2: f64,
    /// Largest difference before correction, LSB of the stream; `None` for tables.
    pub max_before_lsb: Option<u32>,
}

/// y = b + S x; of two tables whose axes are not parallel, x is along the other's axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AxisLine {
    /// b, m/s².
    pub bias_mps2: f64,
    /// Standard deviation of b.
    pub bias_sd_mps2: f64,
    /// S.
    pub scale: f64,
    /// Standard deviation of S.
    pub scale_sd: f64,
}

impl Axis {
    /// `lsb_mps2` is the quantisation step: equal values are always rounded equally, so
    /// that the scatter does not contain the rounding error. In the worst case it is correlated with the motion and
    /// acts as a scale factor.
    fn new(found: &Transfer, axis: usize, lsb_mps2: f64) -> Self {
        let (index, axis) = (axis, &found.axes[axis]);
        let rounding_sd = lsb_mps2 / 12.0_f64.sqrt();
        let rounding_scale_sd = rounding_sd / axis.motion_mps2.max(f64::MIN_POSITIVE);
        // The bias is the line's value at 0, extrapolated from the motion.
        let rounding_bias_sd = rounding_sd.hypot(rounding_scale_sd * axis.at_mps2);
        let sd = |variance: f64| variance.max(0.0).sqrt();
        Self {
            offset_mps2: axis.offset_mps2,
            offset_sd_mps2: axis.offset_sd_mps2.hypot(rounding_sd),
            line: axis.line.map(|line| AxisLine {
                bias_mps2: line.bias_mps2,
                bias_sd_mps2: sd(line.covariance[0][0]).hypot(rounding_bias_sd),
                scale: line.scale,
                scale_sd: sd(line.covariance[1 + index][1 + index]).hypot(rounding_scale_sd),
            }),
            rms_before_mps2: 0.0,
            rms_after_mps2: axis.rms_mps2,
            max_before_lsb: None,
        }
    }
}

/// Data over time, for the charts.
#[derive(Clone, Debug, Default)]
struct History {
    /// Length of a slice, s.
    slice_s: f64,
    /// Slices of both links.
    slices: [Vec<link::Slice>; 2],
    /// Times, and the estimates up to each.
    evolution: Vec<(f64, [Axis; 3])>,
    /// Times and both values of the part in the middle, m/s².
    excerpt: Vec<(f64, [[f64; 3]; 2])>,
}

/// Compares the links of a recording; `open` opens it, twice, and `name` is its name in
/// errors.
///
/// # Errors
/// Those of [`walk`](crate::walk::walk); `data_refused` when a link is missing, when the links are of different boards,
/// or when they have no stream or sample in common.
pub fn compare<R: Read>(
    open: impl Fn() -> Result<RecordingReader<R>>,
    name: &str,
) -> Result<Comparison> {
    let overview = Overview::read(open()?, name)?;
    let mut counted = Counted::read(open()?, &overview)?;
    if counted.pairs == 0 {
        return Err(refused(
            name,
            "the two links have no sample in common",
            "record both at the same time: `wimu record LINK LINK`",
        ));
    }
    let device_id = overview.recording.devices.first().map(|id| format!("{id:016x}"));
    let found = counted.transfer.result();
    let named = device_id.clone().unwrap_or_default();
    let lines = |found: &Transfer| [0, 1, 2].map(|axis| Axis::new(found, axis, counted.lsb_mps2));
    let model = found
        .as_ref()
        .ok()
        .map(|found| LinkModel::new(LinkRole::Wireless, &named, &lines(found), found.samples));
    let links = [0, 1].map(|index| {
        let role = ROLES[index];
        let statistics = overview.statistics(role);
        let stream = match overview.stream {
            Stream::Raw => statistics.raw,
            Stream::Corrected => statistics.corrected,
        };
        let clock = overview.link(role).and_then(Link::clock);
        LinkReport {
            by_arrival: Some(counted.arrival_error(index)),
            ..counted.meters[index].report(role, &statistics, &stream, clock)
        }
    });
    let values = match (&found, model) {
        (Ok(found), Some(model)) => Some(Values {
            axes: [0, 1, 2].map(|axis| Axis {
                rms_before_mps2: counted.before.rms(axis),
                max_before_lsb: Some(counted.before.max_lsb[axis]),
                ..lines(found)[axis]
            }),
            model,
        }),
        _ => None,
    };
    let values_reason = found.err().map(|refusal| refusal.to_string());
    let left_out = without_unit(counted.without_unit as usize, "sample", "left out of the values");
    let findings = (overview.recording.wholeness.finding().into_iter())
        .chain(incomparable(values_reason.as_deref()))
        .chain(left_out)
        .collect();
    let slices = [0, 1].map(|index| std::mem::take(&mut counted.meters[index].slices));
    Ok(Comparison {
        source: name.to_owned(),
        device_id,
        duration_s: overview.span_ns() as f64 * 1e-9,
        wholeness: overview.recording.wholeness,
        starts: overview.starts.len(),
        stream: match overview.stream {
            Stream::Raw => "raw",
            Stream::Corrected => "corrected",
        },
        pairs: counted.pairs,
        identical: counted.identical,
        with_rates: counted.with_rates,
        rates_differ: counted.rates_differ,
        saturated: counted.saturated,
        without_unit: counted.without_unit,
        links,
        clock: overview.longest().and_then(|start| overview.clock(start)).map(ClockModel::summary),
        values,
        values_reason,
        findings,
        history: History {
            slice_s: overview.span_ns() as f64 * 1e-9 / SLICES as f64,
            slices,
            evolution: counted.evolution,
            excerpt: counted.excerpt,
        },
    })
}

/// Why the values of two streams cannot be compared.
fn incomparable(reason: Option<&str>) -> Option<Problem> {
    reason.map(|reason| Code::Incomparable.warning(format!("values: {reason}")))
}

fn refused(name: &str, message: impl Into<String>, remedy: &str) -> Problem {
    Code::DataRefused.error(message, remedy).at(name)
}

/// Orders the values of a link and of the other one: cable first, wireless link second.
fn in_order<T>(link: usize, own: T, other: T) -> [T; 2] {
    if link == 0 { [own, other] } else { [other, own] }
}

fn index_of(role: LinkRole) -> usize {
    usize::from(role != LinkRole::Cable)
}
