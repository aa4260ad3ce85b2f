//! One board's batches as a receiver follows them: repetitions left out, one gateway at a time.

use std::time::Duration;

use super::Batch;

/// After this time without a batch, that of another gateway is followed, also one with an earlier session.
const SILENT: Duration = Duration::from_secs(5);
/// Rate at which the estimated difference of the clocks may grow, ns per s: two oscillators of 50 ppm.
const DRIFT_NS_PER_S: f64 = 100_000.0;

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
}

impl Follower {
    /// Takes a message that arrived at `now`; returns its pieces with times on the receiver's clock, ns. `None` for
    /// repetitions, batches of another gateway, and anything else.
    pub fn take(&mut self, now: Duration, message: &[u8]) -> Option<Vec<(u64, Vec<u8>)>> {
        let batch = Batch::decode(message).ok()?;
        match self.session {
            Some(session) if session == batch.session => {
                let ahead = batch.number.wrapping_sub(self.number) as i32;
                if ahead <= 0 {
                    return None;
                }
            }
            Some(session) if batch.session < session && now < self.latest + SILENT => return None,
            _ => self.offset = None,
        }
        self.session = Some(batch.session);
        self.number = batch.number;
        self.latest = now;
        let offset = self.offset(now, batch.end_ns);
        let local = |(at, bytes): (u64, Vec<u8>)| {
            let ns = (i128::from(at) + offset).clamp(self.last_ns.into(), now.as_nanos() as i128);
            self.last_ns = ns as u64;
            (self.last_ns, bytes)
        };
        Some(batch.pieces.into_iter().map(local).collect())
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
    fn a_batch_is_followed_once() {
        let mut follower = Follower::default();
        let mut take = |at: u64, message: &[u8]| follower.take(Duration::from_secs(at), message);
        for (at, number, taken) in
            [(1, 0, true), (2, 1, true), (3, 1, false), (4, 0, false), (5, 4, true)]
        {
            let pieces = take(at, &message(9, number, at * 1000));
            let expected = taken.then(|| vec![number as u8]);
            assert_eq!(pieces.map(|pieces| numbers(&pieces)), expected);
        }
        assert_eq!(take(6, b"retained garbage"), None);
    }

    #[test]
    fn of_two_gateways_the_later_one_is_followed_until_it_is_silent() {
        let mut follower = Follower::default();
        let mut take = |at_s: u64, session: u64, number: u32| {
            let message = message(session, number, 0);
            follower.take(Duration::from_secs(at_s), &message).is_some()
        };
        assert!(take(1, 5, 0) && take(2, 7, 0) && !take(3, 5, 1));
        assert!(!take(6, 5, 2), "4 s after the later one");
        assert!(take(8, 5, 3), "6 s after it");
    }

    #[test]
    fn times_keep_their_differences_and_are_never_in_the_future() {
        let mut follower = Follower::default();
        // Arrives 100 ms after its piece, then 20 ms later than the first, then 30 ms earlier.
        let mut at = |now_ms: u64, number, at_ms| {
            let message = message(1, number, at_ms);
            follower.take(Duration::from_millis(now_ms), &message).unwrap()[0].0
        };
        let first = at(5000, 0, 1000);
        assert_eq!(first, 4_900_000_000);
        let late = at(6020, 1, 2000);
        assert!((late - first).abs_diff(1_000_000_000) < 200_000, "{late}");
        let early = at(6970, 2, 3000);
        assert_eq!(early, 6_870_000_000);
    }
}
