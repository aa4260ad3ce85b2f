//! Samples that a damaged file lacks, and that therefore do not count as lost on a link.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use crate::decode::Samples;
use crate::walk::Start;

/// Sequence numbers that each link may have delivered in missing parts of the file.
#[derive(Default)]
pub(super) struct Holes {
    found: BTreeMap<(usize, Start), Vec<RangeInclusive<u32>>>,
    /// The last number of each link, in its start.
    latest: [Option<(Start, u32)>; 2],
    /// Whether a part of the file is missing since then.
    open: [bool; 2],
}

impl Holes {
    /// Notes that a part of the file is missing.
    pub fn open(&mut self, link: usize) {
        self.open[link] = true;
    }

    /// Takes the next samples of a link.
    pub fn take(&mut self, link: usize, start: Start, samples: &Samples) {
        let Some(last) = samples.iter().last() else {
            return;
        };
        let latest = self.latest[link].replace((start, last.sequence));
        if std::mem::take(&mut self.open[link]) {
            let mut from = 0;
            if let Some((before, latest)) = latest {
                let next = latest.saturating_add(1);
                if before == start {
                    from = next;
                } else {
                    self.add(link, before, next..=u32::MAX);
                }
            }
            if let Some(to) = samples.first_sequence.checked_sub(1) {
                self.add(link, start, from..=to);
            }
        }
    }

    /// Ends the recording.
    pub fn close(&mut self) {
        for link in 0..2 {
            if let (true, Some((start, latest))) = (self.open[link], self.latest[link]) {
                self.add(link, start, latest.saturating_add(1)..=u32::MAX);
            }
        }
    }

    fn add(&mut self, link: usize, start: Start, numbers: RangeInclusive<u32>) {
        if !numbers.is_empty() {
            self.found.entry((link, start)).or_default().push(numbers);
        }
    }

    /// The missing ranges of a link in a start of the board.
    pub fn of(&self, link: usize, start: Start) -> Vec<RangeInclusive<u32>> {
        self.found.get(&(link, start)).cloned().unwrap_or_default()
    }
}
