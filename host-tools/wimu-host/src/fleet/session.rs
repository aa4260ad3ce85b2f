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
