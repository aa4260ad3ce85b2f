//! Pace of time requests to a board.

use std::collections::VecDeque;
use std::time::Duration;

use wimu_link::LinkRole;
use wimu_link::message::Status;

/// Shortest interval of time requests at first; time after which they are settled, and the interval from then on.
const ASK_EVERY: Duration = Duration::from_millis(50);
const SETTLED: Duration = Duration::from_secs(120);
const ASK_EVERY_SETTLED: Duration = Duration::from_secs(1);
/// Interval in the dense part of each cycle over a link whose delays have a sharp lower edge: more requests give more
/// transfers close to it. In the sparse part before, few requests delay the next one, and show the duration of
/// the fastest.
const ASK_OFTEN: Duration = Duration::from_millis(6);
/// Length of a cycle.
const CYCLE: Duration = Duration::from_millis(2000);
/// Length of its sparse part.
const SPARSE_FOR: Duration = Duration::from_millis(1000);
/// Round-trip time above which there is no dense part: at 9600 baud over a radio link it is longer.
const SLOW: Duration = Duration::from_millis(60);
/// Inverse of the largest fraction of a line's capacity that requests may take, where it is known or observed.
const LINE_DIVISOR: u32 = 2;
/// Bits of a request on the line, about.
const QUESTION_BITS: u32 = 240;
/// Signs of a saturated line: all answers take longer than this and than this multiple of the shortest round trip, for
/// this long (after a stall they arrive all at once).
const LATE: Duration = Duration::from_millis(250);
const LATE_TRIPS: u32 = 4;
const LATE_FOR: Duration = Duration::from_millis(300);
/// Pause of the requests after the last late answer; doubled the next time.
const REST: Duration = Duration::from_secs(2);
/// Signs of queueing requests: all answers exceed the 90 % quantile of the sparse ones by this, or by a quarter of it,
/// for this long; and the pause that follows.
const WAITED: Duration = Duration::from_millis(20);
const WAITED_FOR: Duration = Duration::from_millis(100);
const SHORT_REST: Duration = Duration::from_millis(500);
/// Fewest sparse round trips for that quantile.
const MIN_SPARSE: usize = 8;
/// Largest and smallest number of round trips for the shape of the delays.
const TRIPS: usize = 64;
const MIN_TRIPS: usize = 32;
/// Ratio of the upper to the lower half of the round-trip distribution: 0.8 for two uniform delays, 1.6 for exponential
/// ones. Below the first value the lower edge is sharp, above the second it is not.
const SHARP: [f64; 2] = [0.8, 1.2];

/// Duration of a request and its answer.
#[derive(Clone, Copy, Debug)]
pub struct Trip {
    /// From sending to the last byte of the answer.
    pub whole: Duration,
    /// From the answer's first byte to its last, if it was not delayed by other data.
    pub on_line: Option<Duration>,
}

/// Schedule of time requests: dense at first, less on a slow link, sparse in the long run,
/// while the board does not answer, and when its line is saturated, because telemetry has priority. Requests do not
/// wait for earlier answers.
#[derive(Clone, Debug)]
pub struct Pace {
    first: Option<Duration>,
    latest: Option<Duration>,
    /// Time of the latest answer.
    answered: Option<Duration>,
    least_trip: Option<Duration>,
    trips: VecDeque<Duration>,
    /// Whether the delays have a sharp lower edge, by the latest round trips; assumed at first.
    sharp: bool,
    often: Duration,
    /// Durations of the latest answers on the line.
    takes: VecDeque<Duration>,
    /// Round-trip time above which a request has queued; `None` if unknown.
    waited: Option<Duration>,
    waited_since: Option<Duration>,
    /// Since when all answers are late, until when requests pause, and the next pause.
    late_since: Option<Duration>,
    rests_until: Option<Duration>,
    rest: Duration,
    /// Shed frames in the latest status, and whether they have increased.
    shed: Option<u32>,
    full: bool,
    /// Whether requests are sparse from the start.
    sparse: bool,
}

impl Default for Pace {
    fn default() -> Self {
        Self {
            first: None,
            latest: None,
            answered: None,
            least_trip: None,
            trips: VecDeque::new(),
            sharp: true,
            often: ASK_OFTEN,
            takes: VecDeque::new(),
            waited: None,
            waited_since: None,
            late_since: None,
            rests_until: None,
            rest: REST,
            shed: None,
            full: false,
            sparse: false,
        }
    }
}

impl Pace {
    /// For a line of this baud rate at the host, which may differ beyond a radio link.
    pub fn on_line(baud: Option<u32>) -> Self {
        let least =
            baud.map(|baud| Duration::from_secs(1) * LINE_DIVISOR * QUESTION_BITS / baud.max(1));
        Self { often: least.unwrap_or_default().max(ASK_OFTEN), ..Self::default() }
    }

    /// One request a second: shows the duration of transfers, at little cost.
    pub fn sparse(baud: Option<u32>) -> Self {
        Self { sparse: true, ..Self::on_line(baud) }
    }

    /// Whether a request is due at `now`, on the link's clock.
    pub fn is_due(&self, now: Duration) -> bool {
        self.due_in(now).is_zero()
    }

    /// Time until the next request.
    pub fn due_in(&self, now: Duration) -> Duration {
        let (Some(first), Some(latest)) = (self.first, self.latest) else {
            return Duration::ZERO;
        };
        let silent = now.saturating_sub(self.answered.unwrap_or(first)) >= ASK_EVERY_SETTLED;
        let settled = self.sparse || now.saturating_sub(first) >= SETTLED;
        let every = match self.least_trip {
            Some(trip) if !silent && !settled && !self.full && !self.rests(now) => {
                // A request and its answer may take only a part of the capacity.
                let seldom = (trip + trip / 2).clamp(ASK_EVERY, ASK_EVERY_SETTLED);
                if self.sharp && self.waited.is_some() && trip <= SLOW && is_often(now) {
                    self.often().min(seldom)
                } else {
                    seldom
                }
            }
            _ => ASK_EVERY_SETTLED,
        };
        every.saturating_sub(now.saturating_sub(latest))
    }

    /// A request was sent at `now`.
    pub fn asked(&mut self, now: Duration) {
        self.first.get_or_insert(now);
        // A late wake-up does not lower the rate, nor make the next request queue.
        let often = self.often();
        let late = self.latest.map_or(Duration::ZERO, |latest| now.saturating_sub(latest + often));
        let made_up = if late < often { late.min(often / 2) } else { Duration::ZERO };
        self.latest = Some(now - made_up);
    }

    /// An answer arrived at `now`.
    pub fn answered(&mut self, now: Duration, trip: Trip) {
        self.takes.extend(trip.on_line);
        if self.takes.len() > MIN_TRIPS {
            self.takes.pop_front();
        }
        let trip = trip.whole;
        self.answered = Some(now);
        self.least_trip = Some(self.least_trip.map_or(trip, |least| least.min(trip)));
        if trip < (LATE_TRIPS * self.least_trip.unwrap_or(trip)).max(LATE) {
            self.late_since = None;
        } else {
            let since = *self.late_since.get_or_insert(now);
            if self.rests(now) {
                self.rests_until = self.rests_until.max(Some(now + REST));
            } else if now.saturating_sub(since) >= LATE_FOR {
                self.rests_until = Some(now + self.rest);
                self.rest = (self.rest * 2).min(SETTLED);
                // A dense part would saturate it again.
                self.often = ASK_EVERY_SETTLED;
            }
        }
        // In the dense part earlier requests delay later ones.
        let asked = now.saturating_sub(trip);
        if !is_often(asked) {
            self.trips.push_back(trip);
        } else if self.rests(asked) || self.waited.is_none_or(|waited| trip <= waited) {
            self.waited_since = None;
        } else if now.saturating_sub(*self.waited_since.get_or_insert(now)) >= WAITED_FOR {
            self.waited_since = None;
            self.often = (self.often * 2).min(ASK_EVERY_SETTLED);
            self.rests_until = self.rests_until.max(Some(now + SHORT_REST));
        }
        if self.trips.len() > TRIPS {
            self.trips.pop_front();
        }
        if self.trips.len() < MIN_SPARSE {
            return;
        }
        let mut trips: Vec<_> = self.trips.iter().copied().collect();
        trips.sort();
        let at = |share: usize| trips[share * (trips.len() - 1) / 100];
        self.waited = Some(at(90) + (at(90) / 4).max(WAITED));
        if trips.len() >= MIN_TRIPS {
            let late = (at(95) - at(50)).as_secs_f64();
            let early = (at(50) - at(0)).as_secs_f64();
            let [least, most] = SHARP.map(|ratio| ratio * early);
            self.sharp = late < if self.sharp { most } else { least };
        }
    }

    /// Interval in the dense part: at least that which leaves the line its capacity, by the median duration of
    /// undelayed answers.
    fn often(&self) -> Duration {
        let mut takes: Vec<_> = self.takes.iter().copied().collect();
        takes.sort();
        let takes = takes.get(takes.len() / 2).copied().unwrap_or_default();
        self.often.max(takes * LINE_DIVISOR)
    }

    /// Whether requests pause.
    fn rests(&self, now: Duration) -> bool {
        self.rests_until.is_some_and(|until| now < until)
    }

    /// Takes the board's status: whether it sheds frames on the link of `role`.
    pub fn report_status(&mut self, role: LinkRole, status: &Status) {
        let link = match role {
            LinkRole::Cable => status.cable,
            _ => status.wireless,
        };
        if let Some(link) = link {
            let before = self.shed.replace(link.telemetry_shed);
            self.full |= before.is_some_and(|before| link.telemetry_shed > before);
        }
    }
}

/// Whether `now` is in the dense part of a cycle.
fn is_often(now: Duration) -> bool {
    now.as_millis() % CYCLE.as_millis() >= SPARSE_FOR.as_millis()
}
