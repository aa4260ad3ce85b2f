//! One board's batches as a receiver follows them: repetitions left out, missing batches counted, one gateway at a time.

use std::time::Duration;

use super::Batch;

/// After this time without a batch, that of another gateway is followed, also one with an earlier session.
const SILENT: Duration = Duration::from_secs(5);
/// Rate at which the estimated difference of the clocks may grow, ns per s: two oscillators of 50 ppm.
const DRIFT_NS_PER_S: f64 = 100_000.0;

/// Figures of the batches of a board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct BatchCounts {
    /// Batches followed.
    pub received: u64,
    /// Batches between them that did not arrive.
    pub missing: u64,
    /// Repetitions; left out.
    pub repeated: u64,
    /// Batches of another gateway; left out.
    pub foreign: u64,
    /// Messages that are no batch; left out.
    pub malformed: u64,
}

/// Follows the batches of one board.
///
/// The gateway's times are converted to the receiver's clock by the smallest delay so far, so that they keep their
/// differences, and no time is in the future.
#[derive(Debug, Default)]
pub struct Follower {
    session: Option<u64>,
    number: u32,
    latest: Duration,
    /// Receiver's time less gateway's time, ns, and when it was found.
    offset: Option<(i128, Duration)>,
    last_ns: u64,
    pub counts: BatchCounts,
}

impl Follower {
    /// Takes a message that arrived at `now`; returns its pieces with times on the receiver's clock, ns.
    pub fn take(&mut self, now: Duration, message: &[u8]) -> Vec<(u64, Vec<u8>)> {
        let Ok(batch) = Batch::decode(message) else {
            self.counts.malformed += 1;
            return Vec::new();
        };
        match self.session {
            Some(session) if session == batch.session => {
                match batch.number.wrapping_sub(self.number) as i32 {
                    ..=0 => {
                        self.counts.repeated += 1;
                        return Vec::new();
                    }
                    ahead => self.counts.missing += ahead as u64 - 1,
                }
            }
            Some(session) if batch.session < session && now < self.latest + SILENT => {
                self.counts.foreign += 1;
                return Vec::new();
            }
            _ => self.offset = None,
        }
        self.session = Some(batch.session);
        self.number = batch.number;
        self.latest = now;
        self.counts.received += 1;
        let offset = self.offset(now, batch.end_ns);
        let local = |(at, bytes): (u64, Vec<u8>)| {
            let ns = (i128::from(at) + offset).clamp(self.last_ns.into(), now.as_nanos() as i128);
            self.last_ns = ns as u64;
            (self.last_ns, bytes)
        };
        batch.pieces.into_iter().map(local).collect()
    }

    fn offset(&mut self, now: Duration, end_ns: u64) -> i128 {
        let found = now.as_nanos() as i128 - i128::from(end_ns);
        let kept = self.offset.map(|(offset, at)| {
            offset + (now.saturating_sub(at).as_secs_f64() * DRIFT_NS_PER_S) as i128
        });
        let offset = kept.map_or(found, |kept| kept.min(found));
        self.offset = Some((offset, now));
        offset
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(session: u64, number: u32, at_ms: u64) -> Vec<u8> {
        let mut batch = Batch::new(session, number);
        batch.push(at_ms * 1_000_000, &[number as u8, 0]);
        batch.encode((at_ms + 100) * 1_000_000)
    }

    fn numbers(pieces: &[(u64, Vec<u8>)]) -> Vec<u8> {
        pieces.iter().map(|(_, bytes)| bytes[0]).collect()
    }

    #[test]
    fn a_batch_is_followed_once_and_missing_ones_are_counted() {
        let mut follower = Follower::default();
        let mut seen = Vec::new();
        for (at, number) in [(1, 0), (2, 1), (3, 1), (4, 0), (5, 4)] {
            seen.extend(numbers(
                &follower.take(Duration::from_secs(at), &message(9, number, at * 1000)),
            ));
        }
        follower.take(Duration::from_secs(6), b"retained garbage");
        assert_eq!(seen, [0, 1, 4]);
        let counts = follower.counts;
        assert_eq!(
            (
                counts.received,
                counts.missing,
                counts.repeated,
                counts.malformed
            ),
            (3, 2, 2, 1)
        );
    }

    #[test]
    fn of_two_gateways_the_later_one_is_followed_until_it_is_silent() {
        let mut follower = Follower::default();
        let mut take = |at_s: u64, session: u64, number: u32| {
            numbers(&follower.take(Duration::from_secs(at_s), &message(session, number, 0))).len()
        };
        assert_eq!(take(1, 5, 0), 1);
        assert_eq!(take(2, 7, 0), 1);
        assert_eq!(take(3, 5, 1), 0);
        assert_eq!(take(6, 5, 2), 0, "4 s after the later one");
        assert_eq!(take(8, 5, 3), 1, "6 s after it");
        assert_eq!(follower.counts.foreign, 2);
    }

    #[test]
    fn times_keep_their_differences_and_are_never_in_the_future() {
        let mut follower = Follower::default();
        // Arrives 100 ms after its piece, then 20 ms later than the first, then 30 ms earlier.
        let mut at = |now_ms: u64, number, at_ms| {
            follower.take(Duration::from_millis(now_ms), &message(1, number, at_ms))[0].0
        };
        let first = at(5000, 0, 1000);
        assert_eq!(first, 4_900_000_000);
        let late = at(6020, 1, 2000);
        assert!((late - first).abs_diff(1_000_000_000) < 200_000, "{late}");
        let early = at(6970, 2, 3000);
        assert_eq!(early, 6_870_000_000);
    }
}
