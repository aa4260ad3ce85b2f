//! The host's side of requests: asks again until there is an answer, or none is to be had.

use core::time::Duration;

use crate::frame::{FrameBuffer, MAX_FRAME};
use crate::message::{Answer, Command, Reply, Request, Signature};

/// Asked once and again every half second, a device has three seconds to answer: enough for it to
/// erase its flash, during which it hears nothing.
const INTERVAL: Duration = Duration::from_millis(500);
const ATTEMPTS: u32 = 6;

/// Makes the requests of one session over one link, one at a time. It does no I/O: send the bytes
/// it returns, give it the replies, and tell it the time, counted from any moment that stays.
///
/// ```
/// use core::time::Duration;
/// use wimu_link::message::{Answer, Command, Payload, Reply};
/// use wimu_link::requester::{Next, Requester};
///
/// let mut requester = Requester::new(0x5eed);
/// let now = Duration::from_secs(10);
/// let frame = requester.start(Command::FactoryReset, now);
/// assert!(!frame.is_empty());
///
/// // Half a second without an answer: the same bytes again.
/// assert!(matches!(requester.poll(now), Next::Wait { until } if until == now + Duration::from_millis(500)));
/// assert!(matches!(requester.poll(now + Duration::from_millis(500)), Next::Send(_)));
///
/// let reply = Reply {
///     session: 0x5eed,
///     id: 1,
///     signature: Default::default(),
///     answer: Answer::Accepted(Payload::None),
/// };
/// assert_eq!(requester.on_reply(&reply), Some(reply.answer));
/// assert!(matches!(requester.poll(now), Next::Idle));
/// ```
#[derive(Debug)]
pub struct Requester {
    session: u32,
    /// Of the latest request; 0 before the first.
    id: u32,
    frame: FrameBuffer<MAX_FRAME>,
    interval: Duration,
    attempts: u32,
    /// What the request that is waiting for its answer has left.
    waiting: Option<Waiting>,
}

#[derive(Clone, Copy, Debug)]
struct Waiting {
    until: Duration,
    attempts_left: u32,
}

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Next<'a> {
    /// Nothing: no request is waiting for an answer.
    Idle,
    /// Wait for an answer, and poll again at this time at the latest.
    Wait {
        /// That time.
        until: Duration,
    },
    /// Send this frame again.
    Send(&'a [u8]),
    /// Give up: there was no answer. The request may have had its effect all the same, or have it
    /// yet: ask for the device's state.
    TimedOut,
}

impl Requester {
    /// A requester that asks six times, every half second. `session` should be random: it tells
    /// this host from the ones before.
    pub const fn new(session: u32) -> Self {
        Self::with_timing(session, INTERVAL, ATTEMPTS)
    }

    /// A requester that asks `attempts` times (at least once), every `interval`.
    pub const fn with_timing(session: u32, interval: Duration, attempts: u32) -> Self {
        Self {
            session,
            id: 0,
            frame: FrameBuffer::new(),
            interval,
            attempts,
            waiting: None,
        }
    }

    /// Begins a request at the time `now`; returns the frame to send. A request before it that
    /// still waits is given up.
    pub fn start(&mut self, command: Command, now: Duration) -> &[u8] {
        self.id = self.id.wrapping_add(1);
        let request = Request {
            session: self.session,
            id: self.id,
            signature: Signature::NONE,
            command,
        };
        self.frame.fill(|frame| request.encode(frame));
        self.waiting = Some(Waiting {
            until: now.saturating_add(self.interval),
            attempts_left: self.attempts.saturating_sub(1),
        });
        self.frame.frame()
    }

    /// What to do at the time `now`.
    pub fn poll(&mut self, now: Duration) -> Next<'_> {
        match &mut self.waiting {
            None => Next::Idle,
            Some(waiting) if now < waiting.until => Next::Wait {
                until: waiting.until,
            },
            Some(Waiting {
                attempts_left: 0, ..
            }) => {
                self.waiting = None;
                Next::TimedOut
            }
            Some(waiting) => {
                waiting.attempts_left -= 1;
                // From now, so that a host that slept does not send all at once.
                waiting.until = now.saturating_add(self.interval);
                Next::Send(self.frame.frame())
            }
        }
    }

    /// Takes a reply; returns its answer if it belongs to the request that is waiting.
    pub fn on_reply(&mut self, reply: &Reply) -> Option<Answer> {
        let ours = reply.session == self.session && reply.id == self.id;
        self.waiting.take_if(|_| ours).map(|_| reply.answer)
    }

    /// The session's number.
    pub fn session(&self) -> u32 {
        self.session
    }
}
