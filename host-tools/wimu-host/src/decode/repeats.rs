//! Repeated data of a previous start of the device.
//!
//! Numbers and times begin again at each start, so that repeated data of the start before may fit
//! the new one. They are recognised by their values, which differ between starts because of noise, if
//! they are recent.

use std::collections::{HashMap, VecDeque};

use wimu_link::Batch;
use wimu_link::batch::Stream;

/// Batches kept for comparison, and batches after a restart until repeats have ceased.
const KEPT: usize = 512;
/// Longest time after which a link repeats data, ns.
const REPEATED_NS: u64 = 25_000_000_000;

/// Identification of a batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Mark {
    sensor: u8,
    stream: Stream,
    sequence_low: u16,
    time_low: u32,
    first: [i32; 3],
    last: [i32; 3],
}

/// The latest batches that were handed on.
#[derive(Debug, Default)]
pub(super) struct Repeats {
    /// With their times of arrival, ns of the host.
    latest: VecDeque<(Mark, u64)>,
    /// Those before the latest restart; empty once repeats have ceased.
    before: HashMap<Mark, u64>,
    since_restart: usize,
}

impl Repeats {
    /// Stores a batch that arrived at `host_ns` and was handed on.
    pub fn add(&mut self, batch: &Batch, host_ns: u64) {
        let Some(mark) = mark(batch) else {
            return;
        };
        if self.latest.len() >= KEPT {
            self.latest.pop_front();
        }
        self.latest.push_back((mark, host_ns));
    }

    /// The device has restarted.
    pub fn restart(&mut self) {
        self.before = self.latest.iter().copied().collect();
        self.since_restart = 0;
    }

    /// Whether a batch that arrived at `host_ns` was already handed on before the restart.
    pub fn is_of_a_start_before(&mut self, batch: &Batch, host_ns: u64) -> bool {
        if self.before.is_empty() {
            return false;
        }
        self.since_restart += 1;
        if self.since_restart > KEPT {
            self.before = HashMap::new();
            return false;
        }
        let came_ns = mark(batch).and_then(|mark| self.before.get(&mark));
        came_ns.is_some_and(|came_ns| host_ns.saturating_sub(*came_ns) <= REPEATED_NS)
    }
}

/// `None` for a batch of practically constant values: a stuck or saturated sensor gives the same ones at each start.
fn mark(batch: &Batch) -> Option<Mark> {
    let samples = batch.samples();
    let (first, last) = (*samples.first()?, *samples.last()?);
    (first != last).then(|| Mark {
        sensor: batch.sensor(),
        stream: batch.stream(),
        sequence_low: batch.sequence_low(),
        time_low: batch.time_low(),
        first,
        last,
    })
}
