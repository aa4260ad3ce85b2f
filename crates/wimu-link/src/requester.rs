//! The host's side of requests: repeats a request until it is answered or times out.

use core::time::Duration;

use heapless::Vec;

use crate::auth::Session;
use crate::frame::{MAX_FRAME, fill};
use crate::message::{Answer, Command, Head, Payload, Refusal, Request, Signature};

/// Interval between attempts. With [`ATTEMPTS`] a device has 3 s to answer, which covers an erase of its
/// flash, during which it receives nothing.
const INTERVAL: Duration = Duration::from_millis(500);
const ATTEMPTS: u32 = 6;

/// Makes the requests of one session over one link, one at a time. It does no I/O: send the bytes
/// it returns, pass it the replies, and pass the time since any fixed moment.
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
    /// Id of the latest unsigned request; 0 before the first.
    id: u32,
    /// The session that signs requests, and its latest id.
    signing: Option<(Session, u32)>,
    frame: Vec<u8, MAX_FRAME>,
    interval: Duration,
    attempts: u32,
    /// The request that waits for its answer.
    waiting: Option<Waiting>,
    /// The latest answer was signed.
    is_authenticated: bool,
}

#[derive(Clone, Copy, Debug)]
struct Waiting {
    until: Duration,
    attempts_left: u32,
    session: u32,
    id: u32,
    /// The session that signed it, and the signature.
    signed: Option<(Session, Signature)>,
    /// It has been sent again.
    repeated: bool,
    /// Whether an answer to another host's equal request answers it too.
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
    /// No answer in time. The request may have been executed, or may still be: read the device's state.
    TimedOut,
}

impl Requester {
    /// A requester with six attempts, one every half second. `session` should be random: it distinguishes
    /// this host from earlier ones.
    pub const fn new(session: u32) -> Self {
        Self::with_timing(session, INTERVAL, ATTEMPTS)
    }

    /// A requester with `attempts` attempts (at least one), one every `interval`.
    pub const fn with_timing(session: u32, interval: Duration, attempts: u32) -> Self {
        Self {
            session,
            id: 0,
            signing: None,
            frame: Vec::new(),
            interval,
            attempts,
            waiting: None,
            is_authenticated: false,
        }
    }

    /// Signs requests from now on, in this session, beginning with the id `first`, which should be random.
    pub fn sign(&mut self, session: Session, first: u32) {
        self.signing = Some((session, first.wrapping_sub(1)));
    }

    /// Stops signing.
    pub fn sign_nothing(&mut self) {
        self.signing = None;
    }

    /// Whether requests are signed.
    pub fn signs(&self) -> bool {
        self.signing.is_some()
    }

    /// Uses another session for unsigned requests from now on, because another host has used ids of this
    /// one. `session` should be random.
    pub fn renew(&mut self, session: u32) {
        self.session = session;
        self.id = 0;
    }

    /// Begins a request at the time `now`; returns the frame to send. An earlier request that
    /// still waits is abandoned. `OpenSession` is not signed.
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
                Request { session: self.session, id: self.id, signature: Signature::NONE, command }
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

    /// The next action at the time `now`.
    pub fn poll(&mut self, now: Duration) -> Next<'_> {
        match &mut self.waiting {
            None => Next::Idle,
            Some(waiting) if now < waiting.until => Next::Wait { until: waiting.until },
            Some(Waiting { attempts_left: 0, .. }) => {
                self.waiting = None;
                Next::TimedOut
            }
            Some(waiting) => {
                waiting.attempts_left -= 1;
                waiting.repeated = true;
                // Relative to `now`, so that a delayed host does not send all attempts at once.
                waiting.until = now.saturating_add(self.interval);
                Next::Send(&self.frame)
            }
        }
    }

    /// Takes the body of a frame of kind [`Kind::Reply`](crate::Kind::Reply); returns its answer if it
    /// belongs to the request that is waiting.
    ///
    /// The answer to a signed request is signed. The only unsigned ones accepted are refusals
    /// of a device that cannot sign: [`Refusal::WrongSignature`], [`Refusal::SessionEnded`],
    /// [`Refusal::KeyNeeded`] and [`Refusal::Locked`]. They can be forged: they mean that the
    /// request may not have been executed, and say nothing about the device's state.
    ///
    /// A device limits the rate of answers to unsigned requests. So an unsigned `OpenSession` or
    /// `GetKeyStatus` that was repeated also accepts an answer to another host's request: a session is
    /// useless without the key, and the key's id is the same for all.
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
        let is_authenticated = waiting.signed.is_some_and(|(session, request)| {
            session.has_answered(head.id, request, bytes, head.signature)
        });
        let unsigned = head.signature == Signature::NONE && cannot_sign(&answer);
        if waiting.signed.is_some() && !is_authenticated && !unsigned {
            return None;
        }
        self.waiting = None;
        self.is_authenticated = is_authenticated;
        Some(answer)
    }

    /// Whether the latest answer was signed with the device's key.
    pub fn is_authenticated(&self) -> bool {
        self.is_authenticated
    }

    /// The number of the unsigned session.
    pub fn session(&self) -> u32 {
        self.session
    }
}

/// Whether a device that cannot sign gives this answer.
fn cannot_sign(answer: &Answer) -> bool {
    matches!(
        answer,
        Answer::Refused(
            Refusal::WrongSignature | Refusal::SessionEnded | Refusal::KeyNeeded | Refusal::Locked
        )
    )
}
