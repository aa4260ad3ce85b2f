//! What comes again after the device has started anew is not the new start's.
//!
//! Numbers and times begin anew at each start, so that what is repeated from the start before may be
//! at the new one's place. Its values tell, as noise makes those of two starts differ, and that it is
//! not long ago that they came.

use std::collections::{HashMap, VecDeque};

use wimu_link::Batch;
use wimu_link::batch::Stream;

/// Batches kept to know them again, and after how many more a start's repeats are at an end.
const KEPT: usize = 512;
/// How long after it came something may come again, ns: what is as old is not a link's repeat.
const REPEATED_NS: u64 = 25_000_000_000;

/// What a batch is known by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Mark {
    stream: Stream,
    sequence_low: u16,
    time_low: u32,
    first: [i32; 3],
    last: [i32; 3],
}

/// The latest batches that were handed on.
#[derive(Debug, Default)]
pub(super) struct Repeats {
    /// With when they came, ns of the host.
    latest: VecDeque<(Mark, u64)>,
    /// Those of before the latest restart; empty once nothing of them comes any more.
    before: HashMap<Mark, u64>,
    since_restart: usize,
}

impl Repeats {
    /// A batch that came at `host_ns` has been handed on.
    pub fn add(&mut self, batch: &Batch, host_ns: u64) {
        let Some(mark) = mark(batch) else {
            return;
        };
        if self.latest.len() >= KEPT {
            self.latest.pop_front();
        }
        self.latest.push_back((mark, host_ns));
    }

    /// The device has started anew.
    pub fn restart(&mut self) {
        self.before = self.latest.iter().copied().collect();
        self.since_restart = 0;
    }

    /// Whether a batch that came at `host_ns` was handed on before the device started anew.
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

/// `None` of a batch whose values are as good as constant: a sensor that is stuck or saturated gives
/// the same at each start.
fn mark(batch: &Batch) -> Option<Mark> {
    let samples = batch.samples();
    let (first, last) = (*samples.first()?, *samples.last()?);
    (first != last).then(|| Mark {
        stream: batch.stream(),
        sequence_low: batch.sequence_low(),
        time_low: batch.time_low(),
        first,
        last,
    })
}
