//! The second reading: counts, pairs, fits, and the error of resampling by the time of arrival.

use std::collections::BTreeSet;
use std::io::Read;
use std::ops::RangeInclusive;

use wimu_calib::ReferenceTransfer;
use wimu_link::message::{Answer, Payload, Status};

use super::arrival::{ArrivalUser, ByArrival};
use super::delivery::{Delivered, Pairing};
use super::link::LinkMeter;
use super::overview::Overview;
use super::{Axis, EXCERPT_NS, UNDER_WAY_NS, in_order, index_of};
use crate::Result;
use crate::clock::ClockModel;
use crate::decode::{Event, Samples};
use crate::mcap_file::{Recorded, RecordingReader};
use crate::series::Ns;
use crate::units::SampleUnit;
use crate::walk::{Start, Step, walk};

/// Differences of pairs.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Differences {
    squares: [f64; 3],
    pub max_lsb: [u32; 3],
    count: u64,
}

impl Differences {
    pub fn take(&mut self, reference: [i32; 3], value: [i32; 3], mps2_per_lsb: f64) {
        self.count += 1;
        for axis in 0..3 {
            let difference = value[axis].abs_diff(reference[axis]);
            self.squares[axis] += (f64::from(difference) * mps2_per_lsb).powi(2);
            self.max_lsb[axis] = self.max_lsb[axis].max(difference);
        }
    }

    pub fn rms(&self, axis: usize) -> f64 {
        (self.squares[axis] / self.count.max(1) as f64).sqrt()
    }
}

/// The device's status in an event.
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

/// Result of the second reading.
pub(super) struct Counted {
    pub meters: [LinkMeter; 2],
    pub pairs: u64,
    pub identical: u64,
    pub with_rates: u64,
    pub rates_differ: u64,
    pub saturated: u64,
    pub without_unit: u64,
    pub transfer: ReferenceTransfer,
    pub before: Differences,
    /// The coarsest LSB, m/s².
    pub lsb_mps2: f64,
    pub evolution: Vec<(f64, [Axis; 3])>,
    pub excerpt: Vec<(f64, [[f64; 3]; 2])>,
    /// By link: by time of arrival, and with the median latency subtracted.
    users: [[ArrivalUser; 2]; 2],
}

/// The second reading under way.
struct Reading<'o> {
    overview: &'o Overview,
    excerpt_ns: RangeInclusive<u64>,
    counted: Counted,
    pairing: Pairing,
    /// By link.
    current: [Option<Start>; 2],
    /// The slice of the recording that it is in.
    slice: usize,
}

impl Reading<'_> {
    /// Takes a step of a link.
    fn take(&mut self, link: usize, start: Start, step: Step) {
        let arrival = match step {
            Step::Arrival(arrival) => arrival,
            Step::Other(entry) => return self.take_entry(link, entry),
        };
        self.counted.meters[link].is_open(arrival.host_ns);
        if self.current[link].replace(start).is_some_and(|before| before != start) {
            self.counted.users[link].iter_mut().for_each(ArrivalUser::restart);
        }
        match &arrival.event {
            Event::Samples(samples) if self.overview.is_compared(samples) => {
                self.take_samples(link, start, samples, arrival.host_ns, false);
            }
            Event::Late(samples) if self.overview.is_compared(samples) => {
                self.take_samples(link, start, samples, arrival.host_ns, true);
            }
            event => {
                // The device reports both links' status on each link.
                let Some(status) = status_of(event) else { return };
                let links = [status.cable, status.wireless];
                for (meter, status) in self.counted.meters.iter_mut().zip(links) {
                    meter.report_status(start, status);
                }
            }
        }
    }

    fn take_entry(&mut self, link: usize, entry: Recorded) {
        let meter = &mut self.counted.meters[link];
        match entry {
            Recorded::Lost { host_ns, .. } => meter.close(host_ns),
            Recorded::Damaged { .. } => {
                meter.interrupt();
                self.counted.users[link].iter_mut().for_each(ArrivalUser::restart);
            }
            entry => meter.is_open(entry.host_ns()),
        }
    }

    fn take_samples(
        &mut self,
        link: usize,
        start: Start,
        samples: &Samples,
        host_ns: u64,
        is_late: bool,
    ) {
        let overview = self.overview;
        let Some(clock) = overview.clock(start) else { return };
        self.counted.meters[link].take(start, samples, is_late, host_ns, clock);
        if !is_late {
            self.counted.by_arrival(link, start, samples, host_ns, overview, clock);
        }
        for sample in samples.iter() {
            let Some((twin, twin_rate)) = self.pairing.pair(link, start, &sample) else {
                continue;
            };
            let both = in_order(link, sample.value, twin);
            self.counted.count_pair(both, sample.rate, twin_rate);
            let Some(unit) = overview.unit(start, sample.sequence) else {
                self.counted.without_unit += 1;
                continue;
            };
            self.counted.compare(both, &unit);
            let true_ns = clock.host_ns(sample.time);
            if self.excerpt_ns.contains(&true_ns) {
                let forces = both.map(|value| unit.mps2(value));
                self.counted.excerpt.push((overview.seconds(true_ns), forces));
            }
        }
        self.end_slice(host_ns);
    }

    /// Keeps the fit so far at the end of a slice.
    fn end_slice(&mut self, host_ns: u64) {
        let slice = self.overview.slicing().at(host_ns as i64);
        if slice <= self.slice {
            return;
        }
        self.slice = slice;
        if let Ok(found) = self.counted.transfer.result() {
            let axes = [0, 1, 2].map(|axis| Axis::new(&found, axis, self.counted.lsb_mps2));
            self.counted.evolution.push((self.overview.seconds(host_ns), axes));
        }
    }
}

impl Counted {
    pub fn read<R: Read>(mut reader: RecordingReader<R>, overview: &Overview) -> Result<Self> {
        let counted = Self {
            meters: [(); 2].map(|()| LinkMeter::new(overview.slicing())),
            pairs: 0,
            identical: 0,
            with_rates: 0,
            rates_differ: 0,
            saturated: 0,
            without_unit: 0,
            transfer: ReferenceTransfer::new().of_one_sensor(),
            before: Differences::default(),
            lsb_mps2: 0.0,
            evolution: Vec::new(),
            excerpt: Vec::new(),
            users: Default::default(),
        };
        let middle = overview.span.0 + overview.span_ns() / 2;
        let mut reading = Reading {
            overview,
            excerpt_ns: middle.saturating_sub(EXCERPT_NS / 2)..=middle + EXCERPT_NS / 2,
            counted,
            pairing: Pairing::default(),
            current: [None; 2],
            slice: 0,
        };
        walk(&mut reader, |role, start, step| {
            reading.take(index_of(role), start, step);
            Ok(())
        })?;
        let mut counted = reading.counted;
        counted.count_losses(overview);
        counted.excerpt.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(counted)
    }

    fn count_pair<T: PartialEq>(
        &mut self,
        [cable, wireless]: [[i32; 3]; 2],
        rate: Option<T>,
        twin_rate: Option<T>,
    ) {
        let rates_differ = rate != twin_rate;
        self.pairs += 1;
        self.with_rates += u64::from(rate.is_some() && twin_rate.is_some());
        self.rates_differ += u64::from(rates_differ);
        self.identical += u64::from(cable == wireless && !rates_differ);
    }

    fn compare(&mut self, [cable, wireless]: [[i32; 3]; 2], unit: &SampleUnit) {
        self.lsb_mps2 = self.lsb_mps2.max(unit.mps2_per_lsb());
        if unit.is_saturated(cable) || unit.is_saturated(wireless) {
            self.saturated += 1;
            return;
        }
        self.before.take(cable, wireless, unit.mps2_per_lsb());
        self.transfer.push(unit.mps2(cable), unit.mps2(wireless));
    }

    /// What each link lacks of the samples that it or the other one delivered.
    fn count_losses(&mut self, overview: &Overview) {
        let starts = self.meters.each_mut().map(|meter| meter.finish(overview.span.1));
        let last = starts.iter().filter_map(|starts| Some(*starts.last_key_value()?.0)).max();
        let all: BTreeSet<Start> =
            starts.iter().flat_map(|starts| starts.keys()).copied().collect();
        let nothing = Delivered::default();
        for (link, meter) in self.meters.iter_mut().enumerate() {
            let longest_ns = meter.longest_age_ns().min(UNDER_WAY_NS) as i64;
            let under_way_ns = (overview.span.1 as i64).saturating_sub(longest_ns);
            for start in &all {
                let [own, other] =
                    [link, 1 - link].map(|k| starts[k].get(start).unwrap_or(&nothing));
                let until_ns = if Some(*start) == last { under_way_ns } else { i64::MAX };
                meter.lack(own.lack(other, overview.heard[link], until_ns));
            }
        }
    }

    /// Resamples a batch by its time of arrival.
    fn by_arrival(
        &mut self,
        link: usize,
        start: Start,
        samples: &Samples,
        host_ns: u64,
        overview: &Overview,
        clock: &ClockModel,
    ) {
        let latencies_ns = [0, self.meters[link].median_latency_ns() as i64];
        let count = samples.values.len();
        for (user, latency_ns) in self.users[link].iter_mut().zip(latencies_ns) {
            for (index, sample) in samples.iter().enumerate() {
                let Some(unit) = overview.unit(start, sample.sequence) else {
                    user.restart();
                    continue;
                };
                // A batch arrives at once; its samples are spaced by their period before its end.
                let apart_ns = i64::from(samples.period.0) * i64::from(samples.every);
                let before_ns = (count - 1 - index) as i64 * apart_ns + latency_ns;
                let arrived = Ns((host_ns as i64).wrapping_sub(before_ns));
                let taken = Ns(clock.host_ns(sample.time) as i64);
                user.take(taken, arrived, unit.mps2(sample.value));
            }
        }
    }

    /// The error of resampling a link by the time of arrival.
    pub fn arrival_error(&self, link: usize) -> ByArrival {
        let [as_it_arrives, without_latency] = &self.users[link];
        ByArrival {
            rms_mps2: as_it_arrives.rms_mps2(),
            rms_without_latency_mps2: without_latency.rms_mps2(),
        }
    }
}
