//! When to ask a board for its time.

use std::collections::VecDeque;
use std::time::Duration;

use wimu_link::LinkRole;
use wimu_link::message::Status;

/// How often the board is asked for its time at first, at most, and from when on in the long run.
const ASK_EVERY: Duration = Duration::from_millis(50);
const SETTLED: Duration = Duration::from_secs(120);
const ASK_EVERY_SETTLED: Duration = Duration::from_secs(1);
/// The same in the last part of each stretch of so long over a link whose delays end sharply: the
/// more questions, the more come close to that end. Before, they are far enough from each other that few
/// hold up the next, and show how long the fastest takes.
const ASK_OFTEN: Duration = Duration::from_millis(6);
const STRETCH: Duration = Duration::from_millis(2000);
const SELDOM_FOR: Duration = Duration::from_millis(1000);
/// No line whose trips are all longer is asked that often: at 9600 baud through a radio they are.
const SLOW: Duration = Duration::from_millis(60);
/// The part of a line, where its rate is known or answers show it, that questions take at most: one in
/// so many.
const LINE_SHARE: u32 = 2;
/// Bits of a question on the line, about.
const QUESTION_BITS: u32 = 240;
/// A line that is full of questions and answers answers so late, or so many times the shortest trip,
/// and all of them for so long: a stall's answers come all at once.
const LATE: Duration = Duration::from_millis(250);
const LATE_TRIPS: u32 = 4;
const LATE_FOR: Duration = Duration::from_millis(300);
/// It rests until none has been late for so long, and twice as long the next time.
const REST: Duration = Duration::from_secs(2);
/// A line that carries less than it is asked lets questions wait: all answers of so long are this much
/// later than nine in ten of those that were asked for seldom, or a quarter of that. It rests so long.
const WAITED: Duration = Duration::from_millis(20);
const WAITED_FOR: Duration = Duration::from_millis(100);
const SHORT_REST: Duration = Duration::from_millis(500);
/// Trips that tell it, at least.
const FEWEST_SELDOM: usize = 8;
/// Trips that tell how delays end, at most and at least.
const TRIPS: usize = 64;
const FEWEST_TRIPS: usize = 32;
/// How much farther the latest trips are from the middle ones than these from the shortest: 0.8 for
/// two uniform delays, 1.6 for exponential ones. More than the second is no sharp end, less than the
/// first is one.
const SHARP: [f64; 2] = [0.8, 1.2];

/// How long a question and its answer took.
#[derive(Clone, Copy, Debug)]
pub struct Trip {
    /// From when it was sent until the whole answer had come.
    pub whole: Duration,
    /// From the answer's first byte to its last, where nothing held it up.
    pub on_line: Option<Duration>,
}

/// When to ask a board for its time: often at first, on a slow link less, seldom in the long run,
/// while it does not answer, and when its line is full: what the board has to say comes first. Questions need not wait for the answers
/// before them.
#[derive(Clone, Debug)]
pub struct Pace {
    first: Option<Duration>,
    latest: Option<Duration>,
    /// When it was last known to answer.
    answered: Option<Duration>,
    least_trip: Option<Duration>,
    trips: VecDeque<Duration>,
    /// Whether the delays end sharply, by the latest trips, or for all that is known.
    sharp: bool,
    often: Duration,
    /// How long the latest answers took on the line.
    takes: VecDeque<Duration>,
    /// A trip longer than this has waited for others, where they tell.
    waited: Option<Duration>,
    waited_since: Option<Duration>,
    /// Since when every answer has come late, until when the line rests, and for how long the next time.
    late_since: Option<Duration>,
    rests_until: Option<Duration>,
    rest: Duration,
    /// What the board had left out when it last said so, and whether that has become more.
    shed: Option<u32>,
    full: bool,
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
        }
    }
}

impl Pace {
    /// For a line of this rate, bits/s, as far as the host knows: it may end at a radio.
    pub fn on_line(baud: Option<u32>) -> Self {
        let least =
            baud.map(|baud| Duration::from_secs(1) * LINE_SHARE * QUESTION_BITS / baud.max(1));
        Self {
            often: least.unwrap_or_default().max(ASK_OFTEN),
            ..Self::default()
        }
    }

    /// Whether it is time to ask, at `now` by the link's clock.
    pub fn is_due(&self, now: Duration) -> bool {
        self.due_in(now).is_zero()
    }

    /// How long until then.
    pub fn due_in(&self, now: Duration) -> Duration {
        let (Some(first), Some(latest)) = (self.first, self.latest) else {
            return Duration::ZERO;
        };
        let silent = now.saturating_sub(self.answered.unwrap_or(first)) >= ASK_EVERY_SETTLED;
        let settled = now.saturating_sub(first) >= SETTLED;
        let every = match self.least_trip {
            Some(trip) if !silent && !settled && !self.full && !self.rests(now) => {
                // A question and its answer take a part of the line only.
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

    /// The board was asked, at `now`.
    pub fn asked(&mut self, now: Duration) {
        self.first.get_or_insert(now);
        // Whoever wakes up late is not to ask seldomer for it, nor so soon that one waits for the other.
        let often = self.often();
        let late = self
            .latest
            .map_or(Duration::ZERO, |latest| now.saturating_sub(latest + often));
        let made_up = match late < often {
            true => late.min(often / 2),
            false => Duration::ZERO,
        };
        self.latest = Some(now - made_up);
    }

    /// An answer has come at `now`.
    pub fn answered(&mut self, now: Duration, trip: Trip) {
        self.takes.extend(trip.on_line);
        if self.takes.len() > FEWEST_TRIPS {
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
                // Asked often, it would be full again.
                self.often = ASK_EVERY_SETTLED;
            }
        }
        // Of questions that came one upon the other, the first have held up the others.
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
        if self.trips.len() < FEWEST_SELDOM {
            return;
        }
        let mut trips: Vec<_> = self.trips.iter().copied().collect();
        trips.sort();
        let at = |share: usize| trips[share * (trips.len() - 1) / 100];
        self.waited = Some(at(90) + (at(90) / 4).max(WAITED));
        if trips.len() >= FEWEST_TRIPS {
            let late = (at(95) - at(50)).as_secs_f64();
            let early = (at(50) - at(0)).as_secs_f64();
            let [least, most] = SHARP.map(|ratio| ratio * early);
            self.sharp = late < if self.sharp { most } else { least };
        }
    }

    /// The time from one question to the next where it is asked often: it leaves the line its share, as
    /// most answers that came by themselves show.
    fn often(&self) -> Duration {
        let mut takes: Vec<_> = self.takes.iter().copied().collect();
        takes.sort();
        let takes = takes.get(takes.len() / 2).copied().unwrap_or_default();
        self.often.max(takes * LINE_SHARE)
    }

    /// Whether the line rests from questions.
    fn rests(&self, now: Duration) -> bool {
        self.rests_until.is_some_and(|until| now < until)
    }

    /// The board has said on the link of `role` how it is: whether it leaves frames out there.
    pub fn told(&mut self, role: LinkRole, status: &Status) {
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

/// Whether `now` is in the part of a stretch in which it may be asked often.
fn is_often(now: Duration) -> bool {
    now.as_millis() % STRETCH.as_millis() >= SELDOM_FOR.as_millis()
}
