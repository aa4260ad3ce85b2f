//! Two links of one board against each other, sample by sample: what each lost, how late it was,
//! and what, if anything, differs in the values. Also two tables of any two devices.
//!
//! A recording is read three times and never held: first for the clocks, then for everything that
//! is counted and fitted, then for what is left once the fit is taken off.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;

use serde::Serialize;
use wimu_calib::{NoiseRatio, ReferenceTransfer, Transfer};
use wimu_link::LinkRole;
use wimu_link::batch::Stream;
use wimu_link::message::{Answer, Payload, Status};
use wimu_model::SpecificForceQ16;

use crate::clock::{ClockModel, ClockSummary};
use crate::decode::{Event, TimedSample};
use crate::mcap_file::{RecordingReader, Wholeness};
use crate::units::RawUnits;
use crate::walk::{Clocks, Start, Step, walk};
use crate::{ErrorCode, HostError, Result};

mod align;
mod holes;
mod link;
mod model;
mod pairing;
mod pictures;
mod quantiles;

pub use align::{Alignment, align};
pub use link::{Burst, ByArrival, LinkReport};
pub use model::LinkModel;
pub use quantiles::Quantiles;

use holes::Holes;
use link::{ArrivalUser, LinkMeter, Slicing};
use pairing::{Heard, Pairing};

/// The reference first.
const ROLES: [LinkRole; 2] = [LinkRole::Cable, LinkRole::Wireless];
/// Parts of a recording in the pictures over time.
const SLICES: usize = 200;
/// How much of the recording is shown sample by sample, ns.
const EXCERPT_NS: u64 = 10_000_000_000;

/// Nothing is under way for longer, ns.
const UNDER_WAY_NS: u64 = 5_000_000_000;

/// What the comparison of two links found.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// What errors and pictures call it.
    pub source: String,
    /// The board, 16 hex digits, if it said so.
    pub device_id: Option<String>,
    /// Host time from the first arrival to the last, s.
    pub duration_s: f64,
    /// How whole the recording is.
    #[serde(flatten)]
    pub wholeness: Wholeness,
    /// Starts of the device in it.
    pub starts: usize,
    /// The stream that both links carry: `raw` or `corrected`.
    pub stream: &'static str,
    /// Samples that both delivered.
    pub pairs: u64,
    /// Of these, with the same value on both.
    pub identical: u64,
    /// With a saturated axis on either: left out of the values.
    pub saturated: u64,
    /// Raw, from where the range may have changed and no epoch tells: left out of the values.
    pub without_unit: u64,
    /// The cable and the wireless link.
    pub links: [LinkReport; 2],
    /// The device's clock by both links together.
    pub clock: Option<ClockSummary>,
    /// The wireless values against the cable's; `None` where they say nothing about each other.
    pub values: Option<Values>,
    /// Why there are no values.
    pub values_reason: Option<String>,
    /// What the pictures show.
    #[serde(skip)]
    history: History,
}

/// Values of one stream against another's, m/s², X, Y, Z.
#[derive(Clone, Debug, Serialize)]
pub struct Values {
    /// Axes.
    pub axes: [Axis; 3],
    /// The error model of the link that the axes make.
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
    /// of which only the offset is known.
    pub line: Option<AxisLine>,
    /// Difference before the model, rms.
    pub rms_before_mps2: f64,
    /// Under the model.
    pub rms_after_mps2: f64,
    /// Largest difference before, LSB of the stream; `None` for tables.
    pub max_before_lsb: Option<u32>,
    /// Under the model, rounded to whole LSB.
    pub max_after_lsb: Option<u32>,
}

/// y = b + S x.
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
    /// `lsb_mps2` is what values are rounded to: the same value is always rounded the same way, so
    /// that no scatter shows it. At worst it goes with the motion all the way, and passes for a scale
    /// factor.
    fn new(found: &Transfer, axis: usize, lsb_mps2: f64) -> Self {
        let (index, axis) = (axis, &found.axes[axis]);
        let rounding_sd = lsb_mps2 / 12.0_f64.sqrt();
        let rounding_scale_sd = rounding_sd / axis.motion_mps2.max(f64::MIN_POSITIVE);
        // The bias is the line's value at 0, away from where the motion was.
        let rounding_bias_sd = rounding_sd.hypot(rounding_scale_sd * axis.at_mps2);
        Self {
            offset_mps2: axis.offset_mps2,
            offset_sd_mps2: axis.offset_sd_mps2.hypot(rounding_sd),
            line: axis.line.map(|line| AxisLine {
                bias_mps2: line.bias_mps2,
                bias_sd_mps2: line.covariance[0][0]
                    .max(0.0)
                    .sqrt()
                    .hypot(rounding_bias_sd),
                scale: line.scale,
                scale_sd: line.covariance[1 + index][1 + index]
                    .max(0.0)
                    .sqrt()
                    .hypot(rounding_scale_sd),
            }),
            rms_before_mps2: 0.0,
            rms_after_mps2: axis.rms_mps2,
            max_before_lsb: None,
            max_after_lsb: None,
        }
    }
}

/// What changed over time.
#[derive(Clone, Debug, Default)]
struct History {
    /// Length of a slice, s.
    slice_s: f64,
    /// The meters' slices, by link.
    slices: [Vec<link::Slice>; 2],
    /// When, and what was estimated by then.
    evolution: Vec<(f64, [Axis; 3])>,
    /// When, and both values of a stretch in the middle, m/s².
    excerpt: Vec<(f64, [[f64; 3]; 2])>,
}

/// Compares the links of a recording; `open` opens it, three times, and `name` is what errors
/// call it.
///
/// # Errors
/// Those of [`walk`]; `data_refused` when a link is missing, when the links are of different boards,
/// when they carry no stream in common, or no sample.
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
            "record both at the same time: `wimu record LINK --cable LINK`",
        ));
    }
    let device_id = overview.devices.first().map(|id| format!("{id:016x}"));
    let found = counted.transfer.result();
    let named = device_id.clone().unwrap_or_default();
    let lines = |found: &Transfer| [0, 1, 2].map(|axis| Axis::new(found, axis, counted.lsb_mps2));
    let model = found
        .as_ref()
        .ok()
        .map(|found| LinkModel::new(LinkRole::Wireless, &named, &lines(found), found.samples));
    let residual = Residual::read(open()?, &overview, &counted, model.as_ref())?;
    let links = [0, 1].map(|index| {
        let role = ROLES[index];
        let statistics = overview.statistics(role);
        let stream = match overview.stream {
            Stream::Raw => statistics.raw,
            Stream::Corrected => statistics.corrected,
        };
        let clock = overview.single.get(index).and_then(Option::as_ref);
        LinkReport {
            by_arrival: Some(residual.by_arrival(index)),
            ..counted.meters[index].report(role, &statistics, &stream, clock)
        }
    });
    let values = match (&found, model) {
        (Ok(found), Some(model)) => Some(Values {
            axes: [0, 1, 2].map(|axis| Axis {
                rms_before_mps2: counted.before.rms(axis),
                rms_after_mps2: residual.after.rms(axis),
                max_before_lsb: Some(counted.before.max_lsb[axis]),
                max_after_lsb: Some(residual.after.max_lsb[axis]),
                ..lines(found)[axis]
            }),
            model,
        }),
        _ => None,
    };
    let slices = [0, 1].map(|index| std::mem::take(&mut counted.meters[index].slices));
    Ok(Comparison {
        source: name.to_owned(),
        device_id,
        duration_s: overview.span_ns() as f64 * 1e-9,
        wholeness: overview.wholeness,
        starts: overview.starts.len(),
        stream: match overview.stream {
            Stream::Raw => "raw",
            Stream::Corrected => "corrected",
        },
        pairs: counted.pairs,
        identical: counted.identical,
        saturated: counted.saturated,
        without_unit: counted.without_unit,
        links,
        clock: overview
            .longest()
            .and_then(|start| overview.clocks.get(&start))
            .map(ClockModel::summary),
        values,
        values_reason: found.err().map(|refusal| refusal.to_string()),
        history: History {
            slice_s: overview.span_ns() as f64 * 1e-9 / SLICES as f64,
            slices,
            evolution: counted.evolution,
            excerpt: counted.excerpt,
        },
    })
}

fn refused(name: &str, message: impl Into<String>, remedy: &str) -> HostError {
    HostError::new(ErrorCode::DataRefused, message, remedy).at(name)
}

fn index_of(role: LinkRole) -> usize {
    usize::from(role != LinkRole::Cable)
}

/// What the first reading tells.
struct Overview {
    stream: Stream,
    devices: Vec<u64>,
    /// Samples of the stream in each start.
    starts: BTreeMap<Start, u64>,
    span: (u64, u64),
    heard: [Heard; 2],
    wholeness: Wholeness,
    holes: Holes,
    units: Units,
    clocks: BTreeMap<Start, ClockModel>,
    single: [Option<ClockModel>; 2],
    statistics: Vec<(LinkRole, crate::decode::LinkStatistics)>,
}

impl Overview {
    fn read<R: Read>(mut reader: RecordingReader<R>, name: &str) -> Result<Self> {
        let mut clocks = Clocks::default();
        let mut devices = BTreeSet::new();
        // By stream and link.
        let mut samples = [[0_u64; 2]; 2];
        let mut starts: BTreeMap<Start, [u64; 2]> = BTreeMap::new();
        let mut span: Option<(u64, u64)> = None;
        // When each link was opened and when it was first heard, host time, and its first decimation.
        let (mut opened_ns, mut heard_ns, mut every) = ([None; 2], [None; 2], [None; 2]);
        // By stream.
        let mut holes: [Holes; 2] = Default::default();
        let mut raw_units: BTreeMap<Start, RawUnits> = BTreeMap::new();
        let statistics = walk(&mut reader, |role, start, step| {
            clocks.see(role, start, &step);
            if let Step::Sent { host_ns, .. } = step {
                opened_ns[index_of(role)].get_or_insert(host_ns);
            }
            if let Step::Damaged = step {
                holes
                    .iter_mut()
                    .for_each(|holes| holes.open(index_of(role)));
            }
            if let Step::Arrival(arrival) = &step {
                let (first, last) = span.unwrap_or((arrival.host_ns, arrival.host_ns));
                span = Some((first.min(arrival.host_ns), last.max(arrival.host_ns)));
                heard_ns[index_of(role)].get_or_insert(arrival.host_ns);
                match &arrival.event {
                    Event::Hello(hello) => {
                        devices.insert(hello.device_id);
                    }
                    Event::Epoch { epoch, .. } => raw_units.entry(start).or_default().see(epoch),
                    Event::Samples(heard) => {
                        let count = heard.values.len() as u64;
                        every[index_of(role)].get_or_insert(heard.every);
                        holes[heard.stream as usize].take(index_of(role), start, heard);
                        samples[heard.stream as usize][index_of(role)] += count;
                        starts.entry(start).or_default()[heard.stream as usize] += count;
                    }
                    _ => {}
                }
            }
            Ok(())
        })?;
        for (index, role) in ROLES.into_iter().enumerate() {
            if samples[0][index] + samples[1][index] == 0 {
                return Err(refused(
                    name,
                    format!("the {role} link is missing: it brought no samples"),
                    "record both links of the board: `wimu record LINK --cable LINK`",
                ));
            }
        }
        if devices.len() > 1 {
            let named: Vec<_> = devices.iter().map(|id| format!("{id:016x}")).collect();
            return Err(refused(
                name,
                format!("it holds different boards: {}", named.join(", ")),
                "record both links of one board; two devices are compared by their tables: `wimu compare A.csv B.csv`",
            ));
        }
        let stream = [Stream::Raw, Stream::Corrected]
            .into_iter()
            .find(|stream| samples[*stream as usize].iter().all(|count| *count > 0))
            .ok_or_else(|| {
                refused(
                    name,
                    "one link carries raw samples only, the other corrected ones only",
                    "let both carry the same: `wimu settings set LINK --cable raw --wireless raw`",
                )
            })?;
        let mut holes = std::mem::take(&mut holes[stream as usize]);
        holes.close();
        Ok(Self {
            stream,
            devices: devices.into_iter().collect(),
            starts: starts
                .into_iter()
                .map(|(start, counts)| (start, counts[stream as usize]))
                .collect(),
            span: span.unwrap_or_default(),
            heard: [0, 1].map(|link| {
                let heard: u64 = heard_ns[link].unwrap_or_default();
                let opened = opened_ns[link].unwrap_or(heard);
                let was_silent = heard.saturating_sub(opened) > UNDER_WAY_NS;
                Heard {
                    from_ns: if was_silent { opened } else { heard } as i64,
                    every: every[link].unwrap_or(1),
                }
            }),
            wholeness: reader.wholeness(),
            holes,
            units: match stream {
                Stream::Raw => Units::Raw(raw_units),
                Stream::Corrected => Units::Corrected,
            },
            clocks: clocks.models(),
            single: ROLES.map(|role| clocks.of_link(role)),
            statistics,
        })
    }

    fn span_ns(&self) -> u64 {
        self.span.1 - self.span.0
    }

    fn slicing(&self) -> Slicing {
        Slicing {
            start_ns: self.span.0 as i64,
            span_ns: self.span_ns(),
            count: SLICES,
        }
    }

    fn seconds(&self, host_ns: u64) -> f64 {
        host_ns.saturating_sub(self.span.0) as f64 * 1e-9
    }

    /// The start with most samples.
    fn longest(&self) -> Option<Start> {
        let most = self.starts.iter().max_by_key(|(_, samples)| **samples);
        most.map(|(start, _)| *start)
    }

    fn statistics(&self, role: LinkRole) -> crate::decode::LinkStatistics {
        let found = self.statistics.iter().find(|(known, _)| *known == role);
        found.map(|(_, statistics)| *statistics).unwrap_or_default()
    }
}

/// What a stream's values are, in each start: by the epochs of both links together.
enum Units {
    Raw(BTreeMap<Start, RawUnits>),
    Corrected,
}

#[derive(Clone, Copy)]
struct Unit {
    mps2_per_lsb: f64,
    /// Values at or beyond ± this are saturated, LSB.
    full_scale: u32,
}

impl Unit {
    fn is_saturated(&self, value: [i32; 3]) -> bool {
        value.iter().any(|v| v.unsigned_abs() >= self.full_scale)
    }

    fn mps2(&self, value: [i32; 3]) -> [f64; 3] {
        value.map(|v| f64::from(v) * self.mps2_per_lsb)
    }
}

impl Units {
    /// That of the sample of this number; `None` where no epoch tells.
    fn of(&self, start: Start, sequence: u32) -> Option<Unit> {
        Some(match self {
            Self::Raw(starts) => {
                let unit = starts.get(&start)?.of(sequence)?;
                Unit {
                    mps2_per_lsb: unit.mps2_per_lsb(),
                    full_scale: unit.full_scale.into(),
                }
            }
            Self::Corrected => Unit {
                mps2_per_lsb: 1.0 / SpecificForceQ16::LSB_PER_MPS2,
                full_scale: u32::MAX,
            },
        })
    }
}

/// How far values are apart.
#[derive(Clone, Copy, Debug, Default)]
struct Apart {
    squares: [f64; 3],
    max_lsb: [u32; 3],
    count: u64,
}

impl Apart {
    fn take(&mut self, reference: [i32; 3], value: [i32; 3], mps2_per_lsb: f64) {
        self.count += 1;
        for axis in 0..3 {
            let apart = value[axis].abs_diff(reference[axis]);
            self.squares[axis] += (f64::from(apart) * mps2_per_lsb).powi(2);
            self.max_lsb[axis] = self.max_lsb[axis].max(apart);
        }
    }

    fn rms(&self, axis: usize) -> f64 {
        (self.squares[axis] / self.count.max(1) as f64).sqrt()
    }
}

/// What an event says of how the device is.
fn status_of(event: &Event) -> Option<Status> {
    match event {
        Event::Status(status) => Some(*status),
        Event::Reply { reply, .. } => match reply.answer {
            Answer::Accepted(Payload::Status(status)) => Some(status),
            _ => None,
        },
        _ => None,
    }
}

/// What the second reading counts.
struct Counted {
    meters: [LinkMeter; 2],
    pairs: u64,
    identical: u64,
    saturated: u64,
    without_unit: u64,
    transfer: ReferenceTransfer,
    before: Apart,
    /// The coarsest LSB, m/s².
    lsb_mps2: f64,
    evolution: Vec<(f64, [Axis; 3])>,
    excerpt: Vec<(f64, [[f64; 3]; 2])>,
}

impl Counted {
    fn read<R: Read>(mut reader: RecordingReader<R>, overview: &Overview) -> Result<Self> {
        // The same samples with the same noise: what differs is the wireless link's alone.
        let ratio = NoiseRatio::new(1.0, 1e-3).unwrap_or_default();
        let mut counted = Self {
            meters: [(); 2].map(|()| LinkMeter::new(overview.slicing())),
            pairs: 0,
            identical: 0,
            saturated: 0,
            without_unit: 0,
            transfer: ReferenceTransfer::new(ratio).of_one_sensor(),
            before: Apart::default(),
            lsb_mps2: 0.0,
            evolution: Vec::new(),
            excerpt: Vec::new(),
        };
        let middle = overview.span.0 + overview.span_ns() / 2;
        let excerpt = middle.saturating_sub(EXCERPT_NS / 2)..=middle + EXCERPT_NS / 2;
        let mut pairing = Pairing::new(overview.heard, &overview.holes);
        let mut current = [None; 2];
        let (slicing, mut slice) = (overview.slicing(), 0);
        walk(&mut reader, |role, start, step| {
            let link = index_of(role);
            let meter = &mut counted.meters[link];
            let arrival = match step {
                Step::Arrival(arrival) => arrival,
                Step::Sent { host_ns, .. } | Step::Connected { host_ns } => {
                    meter.is_open(host_ns);
                    return Ok(());
                }
                Step::Lost { host_ns } => {
                    meter.close(host_ns);
                    return Ok(());
                }
                Step::Damaged => {
                    meter.skip();
                    return Ok(());
                }
            };
            meter.is_open(arrival.host_ns);
            if current[link].replace(start).is_some_and(|s| s != start) {
                meter.skip();
            }
            let (samples, is_late) = match &arrival.event {
                Event::Samples(samples) if samples.stream == overview.stream => (samples, false),
                Event::Late(samples) if samples.stream == overview.stream => (samples, true),
                event => {
                    // The device tells of both links on each.
                    if let Some(status) = status_of(event) {
                        let links = [status.cable, status.wireless];
                        for (meter, status) in counted.meters.iter_mut().zip(links) {
                            meter.told(start, status);
                        }
                    }
                    return Ok(());
                }
            };
            let host_ns = arrival.host_ns;
            let Some(clock) = overview.clocks.get(&start) else {
                return Ok(());
            };
            if is_late {
                meter.take_late(samples, host_ns, clock);
            } else {
                meter.take(samples, host_ns, clock);
            }
            for sample in samples.iter() {
                let twin = pairing.pair(link, start, &sample, samples.every, is_late, clock);
                let Some(twin) = twin else {
                    continue;
                };
                let (cable, wireless) = if link == 0 {
                    (sample.value, twin)
                } else {
                    (twin, sample.value)
                };
                counted.pairs += 1;
                counted.identical += u64::from(cable == wireless);
                let Some(unit) = overview.units.of(start, sample.sequence) else {
                    counted.without_unit += 1;
                    continue;
                };
                counted.lsb_mps2 = counted.lsb_mps2.max(unit.mps2_per_lsb);
                let [c, w] = [cable, wireless].map(|value| unit.mps2(value));
                if unit.is_saturated(cable) || unit.is_saturated(wireless) {
                    counted.saturated += 1;
                } else {
                    counted.before.take(cable, wireless, unit.mps2_per_lsb);
                    counted.transfer.push(c, w);
                }
                let true_ns = clock.host_ns(sample.time);
                if excerpt.contains(&true_ns) {
                    counted.excerpt.push((overview.seconds(true_ns), [c, w]));
                }
            }
            if slicing.at(host_ns as i64) > slice {
                slice = slicing.at(host_ns as i64);
                if let Ok(found) = counted.transfer.result() {
                    let axes = [0, 1, 2].map(|axis| Axis::new(&found, axis, counted.lsb_mps2));
                    counted.evolution.push((overview.seconds(host_ns), axes));
                }
            }
            Ok(())
        })?;
        let under_way_ns = [0, 1].map(|link| {
            let longest_ns = counted.meters[link].longest_age_ns();
            (overview.span.1 as i64).saturating_sub(longest_ns.min(UNDER_WAY_NS) as i64)
        });
        let (lost, at_ends) = pairing.finish(under_way_ns);
        let found = lost.into_iter().zip(at_ends);
        for (meter, (lost, at_ends)) in counted.meters.iter_mut().zip(found) {
            meter.lost = lost;
            meter.before = at_ends.before;
            meter.under_way = at_ends.under_way;
            at_ends.lost.iter().for_each(|run| meter.lack(run));
            meter.finish(overview.span.1);
        }
        counted.excerpt.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(counted)
    }
}

/// What the third reading finds left.
struct Residual {
    after: Apart,
    /// By link: by the time of arrival, and without its median latency.
    users: [[ArrivalUser; 2]; 2],
}

impl Residual {
    fn read<R: Read>(
        mut reader: RecordingReader<R>,
        overview: &Overview,
        counted: &Counted,
        model: Option<&LinkModel>,
    ) -> Result<Self> {
        let users = |link: usize| {
            let latency_ns: f64 = counted.meters[link].median_latency_ns();
            [ArrivalUser::new(0.0), ArrivalUser::new(latency_ns)]
        };
        let mut residual = Self {
            after: Apart::default(),
            users: [users(0), users(1)],
        };
        let mut pairing = Pairing::new(overview.heard, &overview.holes);
        let mut current = [None; 2];
        walk(&mut reader, |role, start, step| {
            let link = index_of(role);
            let arrival = match step {
                Step::Arrival(arrival) => arrival,
                Step::Damaged => {
                    current[link] = None;
                    return Ok(());
                }
                _ => return Ok(()),
            };
            let (samples, is_late) = match &arrival.event {
                Event::Samples(samples) if samples.stream == overview.stream => (samples, false),
                Event::Late(samples) if samples.stream == overview.stream => (samples, true),
                _ => return Ok(()),
            };
            let Some(clock) = overview.clocks.get(&start) else {
                return Ok(());
            };
            let unit = |sample: &TimedSample| overview.units.of(start, sample.sequence);
            let new = current[link].replace(start) != Some(start);
            let count = samples.values.len();
            // Who goes by the time of arrival has no use for what is late.
            for user in residual.users[link].iter_mut().filter(|_| !is_late) {
                if new {
                    user.restart();
                }
                for (index, sample) in samples.iter().enumerate() {
                    let Some(unit) = unit(&sample) else {
                        user.restart();
                        continue;
                    };
                    // A batch arrives at once; its samples are spread out behind its end.
                    let apart_ns = u64::from(samples.period.0) * u64::from(samples.every);
                    let before_ns = (count - 1 - index) as u64 * apart_ns;
                    let arrived_ns = arrival.host_ns.wrapping_sub(before_ns);
                    let value = unit.mps2(sample.value);
                    user.take(clock.host_ns(sample.time), arrived_ns, value);
                }
            }
            let Some(model) = model else {
                return Ok(());
            };
            for sample in samples.iter() {
                let twin = pairing.pair(link, start, &sample, samples.every, is_late, clock);
                if let Some(twin) = twin {
                    let (cable, wireless) = if link == 0 {
                        (sample.value, twin)
                    } else {
                        (twin, sample.value)
                    };
                    let Some(unit) = unit(&sample) else {
                        continue;
                    };
                    if unit.is_saturated(cable) || unit.is_saturated(wireless) {
                        continue;
                    }
                    let corrected = model.correct_lsb(wireless, unit.mps2_per_lsb);
                    residual.after.take(cable, corrected, unit.mps2_per_lsb);
                }
            }
            Ok(())
        })?;
        Ok(residual)
    }

    fn by_arrival(&self, link: usize) -> ByArrival {
        let [as_it_arrives, without_latency] = &self.users[link];
        ByArrival {
            rms_mps2: as_it_arrives.rms_mps2(),
            rms_without_latency_mps2: without_latency.rms_mps2(),
        }
    }
}

#[cfg(test)]
mod tests;
