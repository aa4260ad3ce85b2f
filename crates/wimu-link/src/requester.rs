//! The host's side of requests: asks again until there is an answer, or none is to be had.

use core::time::Duration;

use heapless::Vec;

use crate::auth::Session;
use crate::frame::{MAX_FRAME, fill};
use crate::message::{Answer, Command, Head, Payload, Refusal, Request, Signature};

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
/// let mut line = [0; wimu_link::MAX_FRAME];
/// let length = reply.encode(&mut line)?;
/// let mut deframer = wimu_link::Deframer::new();
/// for &byte in &line[..length] {
///     if let Some(frame) = deframer.push(byte) {
///         assert_eq!(requester.on_reply(frame?.body), Some(reply.answer));
///     }
/// }
/// assert!(matches!(requester.poll(now), Next::Idle));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Requester {
    session: u32,
    /// Of the latest unsigned request; 0 before the first.
    id: u32,
    /// What requests are signed in, and the latest id there.
    signing: Option<(Session, u32)>,
    frame: Vec<u8, MAX_FRAME>,
    interval: Duration,
    attempts: u32,
    /// What the request that is waiting for its answer has left.
    waiting: Option<Waiting>,
    /// The latest answer was signed.
    vouched: bool,
}

#[derive(Clone, Copy, Debug)]
struct Waiting {
    until: Duration,
    attempts_left: u32,
    session: u32,
    id: u32,
    /// In what it was signed, and how.
    signed: Option<(Session, Signature)>,
    /// It has been sent again.
    repeated: bool,
    /// Whether an answer to whoever asks the same answers it too.
    is_anyones: fn(&Answer) -> bool,
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
            signing: None,
            frame: Vec::new(),
            interval,
            attempts,
            waiting: None,
            vouched: false,
        }
    }

    /// Signs the requests from now on: in this session, from the id `first` on, which should be
    /// random.
    pub fn sign(&mut self, session: Session, first: u32) {
        self.signing = Some((session, first.wrapping_sub(1)));
    }

    /// Signs no more.
    pub fn sign_nothing(&mut self) {
        self.signing = None;
    }

    /// Whether requests are signed.
    pub fn signs(&self) -> bool {
        self.signing.is_some()
    }

    /// Numbers unsigned requests in another session from now on: somebody else has used this one's
    /// numbers. `session` should be random.
    pub fn renew(&mut self, session: u32) {
        self.session = session;
        self.id = 0;
    }

    /// Begins a request at the time `now`; returns the frame to send. A request before it that
    /// still waits is given up. What opens a session is not signed.
    pub fn start(&mut self, command: Command, now: Duration) -> &[u8] {
        let signing = match &mut self.signing {
            Some((session, id)) if command != Command::OpenSession => {
                *id = id.wrapping_add(1);
                Some((*session, *id))
            }
            _ => None,
        };
        let request = match signing {
            Some((session, id)) => Request {
                session: session.number,
                id,
                signature: session.sign(id, &command),
                command,
            },
            None => {
                self.id = self.id.wrapping_add(1);
                Request {
                    session: self.session,
                    id: self.id,
                    signature: Signature::NONE,
                    command,
                }
            }
        };
        fill(&mut self.frame, |frame| request.encode(frame));
        self.waiting = Some(Waiting {
            until: now.saturating_add(self.interval),
            attempts_left: self.attempts.saturating_sub(1),
            session: request.session,
            id: request.id,
            signed: signing.map(|(session, _)| (session, request.signature)),
            repeated: false,
            is_anyones: match command {
                Command::OpenSession => {
                    |answer| matches!(answer, Answer::Accepted(Payload::Session { .. }))
                }
                Command::GetKeyStatus => {
                    |answer| matches!(answer, Answer::Accepted(Payload::KeyStatus { .. }))
                }
                _ => |_| false,
            },
        });
        &self.frame
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
                waiting.repeated = true;
                // From now, so that a host that slept does not send all at once.
                waiting.until = now.saturating_add(self.interval);
                Next::Send(&self.frame)
            }
        }
    }

    /// Takes the body of a frame of kind [`Kind::Reply`](crate::Kind::Reply); returns its answer if it
    /// belongs to the request that is waiting.
    ///
    /// The answer to a signed request is signed. The only unsigned ones that are taken are refusals
    /// of a device that cannot sign: [`Refusal::WrongSignature`], [`Refusal::SessionEnded`],
    /// [`Refusal::KeyNeeded`] and [`Refusal::Locked`]. Anyone can forge those: they say that the
    /// request may not have been obeyed, nothing about the device's state.
    ///
    /// A device that is asked too often leaves unsigned requests unanswered. So an unsigned
    /// `OpenSession` or `GetKeyStatus` that had to be repeated takes the answer to anybody's: a session
    /// is of use to none but those who have the key, and the key's name is the same for all.
    pub fn on_reply(&mut self, body: &[u8]) -> Option<Answer> {
        let (head, bytes) = Head::split(body).ok()?;
        let answer = Answer::decode(bytes).ok()?;
        let waiting = self.waiting?;
        let ours = head.session == waiting.session && head.id == waiting.id;
        let overheard = waiting.repeated
            && waiting.signed.is_none()
            && head.signature == Signature::NONE
            && (waiting.is_anyones)(&answer);
        if !ours && !overheard {
            return None;
        }
        let vouched = waiting.signed.is_some_and(|(session, request)| {
            session.has_answered(head.id, request, bytes, head.signature)
        });
        let unsigned = head.signature == Signature::NONE && cannot_sign(&answer);
        if waiting.signed.is_some() && !vouched && !unsigned {
            return None;
        }
        self.waiting = None;
        self.vouched = vouched;
        Some(answer)
    }

    /// Whether the device has signed the answer that was returned last: nobody else can have given
    /// it.
    pub fn vouched(&self) -> bool {
        self.vouched
    }

    /// The number of the unsigned session.
    pub fn session(&self) -> u32 {
        self.session
    }
}

/// Whether a device says this that cannot sign.
fn cannot_sign(answer: &Answer) -> bool {
    matches!(
        answer,
        Answer::Refused(
            Refusal::WrongSignature | Refusal::SessionEnded | Refusal::KeyNeeded | Refusal::Locked
        )
    )
}
