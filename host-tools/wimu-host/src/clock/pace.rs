use std::time::Duration;

/// How often the board is asked for its time at first, at most, and from when on in the long run.
const ASK_EVERY: Duration = Duration::from_millis(50);
const SETTLED: Duration = Duration::from_secs(120);
const ASK_EVERY_SETTLED: Duration = Duration::from_secs(1);

/// When to ask a board for its time: often at first, on a slow link less, seldom in the long run and
/// while it does not answer. Questions need not wait for the answers before them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pace {
    first: Option<Duration>,
    latest: Option<Duration>,
    /// When it was last known to answer.
    answered: Option<Duration>,
    least_trip: Option<Duration>,
}

impl Pace {
    /// Whether it is time to ask, at `now` by the link's clock.
    pub fn is_due(&self, now: Duration) -> bool {
        let (Some(first), Some(latest)) = (self.first, self.latest) else {
            return true;
        };
        let silent = now.saturating_sub(self.answered.unwrap_or(first)) >= ASK_EVERY_SETTLED;
        let settled = now.saturating_sub(first) >= SETTLED;
        let every = match self.least_trip {
            Some(trip) if !silent && !settled => {
                // A question and its answer take a part of the line only.
                (trip + trip / 2).clamp(ASK_EVERY, ASK_EVERY_SETTLED)
            }
            _ => ASK_EVERY_SETTLED,
        };
        now.saturating_sub(latest) >= every
    }

    /// The board was asked, at `now`.
    pub fn asked(&mut self, now: Duration) {
        self.first.get_or_insert(now);
        self.latest = Some(now);
    }

    /// An answer has come at `now`, so long after its question.
    pub fn answered(&mut self, now: Duration, trip: Duration) {
        self.answered = Some(now);
        self.least_trip = Some(self.least_trip.map_or(trip, |least| least.min(trip)));
    }
}
