//! The device's side of requests: every request has one effect, however often it is repeated.

use heapless::{Vec, VecView};

#[cfg(feature = "auth")]
use crate::auth::Session;
use crate::auth::{KeyState, Lock};
use crate::frame::fill;
use crate::hello::LinkRole;
use crate::message::{Answer, Command, Head, Refusal, Reply, Signature};
use wimu_model::checksum::crc_32c;

#[cfg(feature = "auth")]
mod signed;

/// Unsigned sessions whose latest request is remembered.
const SESSIONS: usize = 4;

/// Size of a token bucket for answers, given as the time to fill it, µs.
const BURST_US: u64 = 1_000_000;
/// Time in which the bucket of each [`Class`] gains a byte, µs: 500, 500, 2000 and 1000 bytes/s,
/// together a third of 115,200 baud. The first two allow 12 answers a second.
const BYTE_US: [u64; 4] = [2000, 2000, 500, 1000];

/// Classes of answers to requests without the key. Each has its own token bucket, so that a flood of one
/// class does not block the others.
#[derive(Clone, Copy, Debug)]
enum Class {
    /// To unsigned `OpenSession`.
    Session,
    /// To unsigned `GetKeyStatus`.
    KeyStatus,
    /// To all other unsigned requests, and refusals of signed ones.
    Other,
    /// To a repetition of the latest signed request.
    #[cfg(feature = "auth")]
    Repeated,
}

/// What the device has to do about a request.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(clippy::large_enum_variant, reason = "there is no heap to box on")]
pub enum Decision<'a> {
    /// Execute this command, then send the frame that [`Responder::reply`] returns.
    Execute(Command),
    /// Send this frame: the request was answered before, or is refused.
    Send(&'a [u8]),
    /// Do nothing: the bytes are not a request, another one is being executed, or the rate limit is reached
    /// ([`Responder::accept_at`]). The host repeats its request.
    Ignore,
}

/// Processes the requests of one link. It does no I/O: pass it bodies, send the frames it returns.
///
/// Requests are identified by session and id. A repetition of the latest one gets the same reply, or,
/// if it is a read with a long answer, is executed again. An older write of the same session, or of the
/// three sessions before, is refused as stale. The [`Lock`] decides who may write; signatures are verified
/// here ([`auth`](crate::auth)). Unsigned requests and wrong signatures have no effect on signed ones.
///
/// ```
/// use wimu_link::auth::{KeyState, Lock};
/// use wimu_link::hello::LinkRole;
/// use wimu_link::message::{Answer, Command, Payload, Settings};
/// use wimu_link::responder::{Decision, Responder};
/// use wimu_link::{Deframer, Kind, MAX_FRAME};
///
/// fn on_byte(byte: u8, deframer: &mut Deframer, responder: &mut Responder, settings: &mut Settings) {
///     let Some(Ok(frame)) = deframer.push(byte) else { return };
///     if frame.kind != Kind::Request {
///         return;
///     }
///     // No key yet: the cable writes.
///     let lock = Lock { key: KeyState::None, boot_count: Some(1), ..Lock::default() };
///     match responder.accept(frame.body, &lock) {
///         Decision::Execute(Command::SetSettings(new)) => {
///             *settings = new;
///             let answer: Answer = Answer::Accepted(Payload::Settings(*settings));
///             send(responder.reply(&answer, &mut [0; MAX_FRAME]));
///         }
///         Decision::Execute(_) => {
///             let answer: Answer = Answer::Unknown;
///             send(responder.reply(&answer, &mut [0; MAX_FRAME]));
///         }
///         Decision::Send(frame) => send(frame),
///         Decision::Ignore => {}
///     }
/// }
/// # fn send(_: &[u8]) {}
/// # let mut responder = Responder::new(LinkRole::Cable);
/// # let mut line = [0; wimu_link::MAX_FRAME];
/// # let request = wimu_link::Request {
/// #     session: 1, id: 1, signature: Default::default(),
/// #     command: Command::SetSettings(Settings { rate_hz: 400, ..Settings::default() }),
/// # };
/// # let length = request.encode(&mut line).unwrap();
/// # let (mut deframer, mut settings) = (Deframer::new(), Settings::default());
/// # for byte in &line[..length] {
/// #     on_byte(*byte, &mut deframer, &mut responder, &mut settings);
/// # }
/// # assert_eq!(settings.rate_hz, 400);
/// ```
#[derive(Debug)]
pub struct Responder {
    role: LinkRole,
    /// The latest unsigned request of each session, the latest session first.
    latest: Vec<Known, SESSIONS>,
    /// The reply to the first of them.
    reply: Vec<u8, KEPT_FRAME>,
    #[cfg(feature = "auth")]
    signed: signed::Signed,
    executing: Option<Executing>,
    /// When the token bucket of each [`Class`] is full, µs on the device's clock.
    full_at_us: [u64; 4],
    /// Time of the latest request, µs on the device's clock, while answers are limited.
    limited_at_us: Option<u64>,
    /// Repeated requests.
    repeated: u32,
    /// A refusal, which must not replace a remembered reply.
    refusal: Vec<u8, REFUSAL_FRAME>,
}

/// Longest refusal or session reply, bytes: session, id, signature or session number, nonce, answer,
/// refusal, kind, CRC, COBS overhead, zero.
const REFUSAL_FRAME: usize = 5 + 5 + 9 + 16 + 2 + 1 + 4 + 1 + 1;

/// Longest frame of an answer to a write, bytes.
const KEPT_FRAME: usize = 80;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Known {
    session: u32,
    id: u32,
    /// CRC-32C of the request: distinguishes it from another request with the same id.
    content: u32,
}

/// The request being executed.
#[derive(Clone, Copy, Debug)]
enum Executing {
    /// With the class of its answer, and whether it is out of order: then its reply is not remembered.
    Unsigned(Known, Class, bool),
    /// With the session and the request's signature, which sign the answer.
    #[cfg(feature = "auth")]
    Signed(Known, Session, Signature),
}

impl Known {
    fn answer(&self, answer: &Answer) -> Reply {
        Reply { session: self.session, id: self.id, signature: Signature::NONE, answer: *answer }
    }
}

impl Responder {
    /// A responder for a link of this role, before any request.
    pub const fn new(role: LinkRole) -> Self {
        Self {
            role,
            latest: Vec::new(),
            reply: Vec::new(),
            #[cfg(feature = "auth")]
            signed: signed::Signed::new(),
            executing: None,
            full_at_us: [0; 4],
            limited_at_us: None,
            repeated: 0,
            refusal: Vec::new(),
        }
    }

    /// As [`accept`](Self::accept), at `now_us`, µs on the device's clock. While a key is set, answers to
    /// requests without it are limited to about 4 kB/s in total after a burst of 1 s; requests beyond the
    /// limit are ignored and have no effect. New signed requests are always processed, so a flood of
    /// unsigned requests leaves most of the link to telemetry and to the owner.
    pub fn accept_at(&mut self, body: &[u8], lock: &Lock, now_us: u64) -> Decision<'_> {
        self.limited_at_us = matches!(lock.key, KeyState::Set(_)).then_some(now_us);
        self.accept(body, lock)
    }

    /// Processes the body of a frame of kind [`Request`](crate::Kind::Request) under the present `lock`.
    pub fn accept(&mut self, body: &[u8], lock: &Lock) -> Decision<'_> {
        let Ok((head, command)) = Head::split(body) else {
            return Decision::Ignore;
        };
        let request = Known { session: head.session, id: head.id, content: crc_32c(body) };
        if head.signature != Signature::NONE {
            #[cfg(feature = "auth")]
            return self.accept_signed(request, head.signature, command, lock);
            #[cfg(not(feature = "auth"))]
            return self
                .refuse(Class::Other, request.answer(&Answer::Refused(Refusal::NotSupported)));
        }
        // The variant's number is the whole command.
        let class = match command {
            [7] => Class::Session,
            [8] => Class::KeyStatus,
            _ => Class::Other,
        };
        if self.is_spent(class) {
            return Decision::Ignore;
        }
        self.accept_unsigned(request, class, command, lock)
    }

    /// Whether the bucket of a class is empty.
    fn is_spent(&self, class: Class) -> bool {
        if !cfg!(feature = "auth") {
            return false;
        }
        let full_at_us = self.full_at_us.get(class as usize);
        (self.limited_at_us.zip(full_at_us))
            .is_some_and(|(now, full)| *full > now.saturating_add(BURST_US))
    }

    /// Takes the `bytes` of an answer from the bucket of its class.
    fn spend(&mut self, class: Class, bytes: usize) {
        if !cfg!(feature = "auth") {
            return;
        }
        let (class, bytes) = (class as usize, bytes as u64);
        let bucket = self.full_at_us.get_mut(class).zip(BYTE_US.get(class));
        if let (Some(now), Some((full, byte_us))) = (self.limited_at_us, bucket) {
            *full = now.max(*full).saturating_add(bytes * byte_us);
        }
    }

    fn accept_unsigned(
        &mut self,
        request: Known,
        class: Class,
        command: &[u8],
        lock: &Lock,
    ) -> Decision<'_> {
        let mut sessions = self.latest.iter();
        let known = sessions.position(|latest| latest.session == request.session);
        let latest = known.and_then(|place| self.latest.get(place).copied());
        let repeats = latest == Some(request) && known == Some(0);
        if repeats {
            self.repeated = self.repeated.wrapping_add(1);
            match self.executing {
                Some(Executing::Unsigned(..)) => return Decision::Ignore,
                _ if !self.reply.is_empty() => {
                    self.spend(class, self.reply.len());
                    return Decision::Send(&self.reply);
                }
                _ => {}
            }
        }
        // Ids wrap: the nearer half of them is later.
        let is_old = !repeats
            && latest.is_some_and(|latest| (request.id.wrapping_sub(latest.id) as i32) <= 0);
        let command = Command::decode(command);
        // An old read is answered: another host may have used ids of this session.
        if is_old && !command.as_ref().is_ok_and(|command| !command.is_write()) {
            return self.refuse(class, request.answer(&Answer::Refused(Refusal::Stale)));
        }
        if self.executing.is_some() {
            return Decision::Ignore;
        }

        if !is_old {
            put_first(&mut self.latest, known, request);
            self.reply.clear();
        }

        let outcome = match command {
            Err(_) => Err(Answer::Unknown),
            // It has been executed.
            Ok(command) if repeats && command.is_write() => return Decision::Ignore,
            Ok(command) => match lock.refusal(&command, self.role) {
                Some(refusal) => Err(Answer::Refused(refusal)),
                #[cfg(feature = "auth")]
                None if matches!(command, Command::OpenSession) => Err(self.open_session(lock)),
                None => Ok(command),
            },
        };
        match outcome {
            Ok(command) => {
                self.executing = Some(Executing::Unsigned(request, class, is_old));
                Decision::Execute(command)
            }
            Err(answer) if is_old => self.refuse(class, request.answer(&answer)),
            Err(answer) => {
                fill(&mut self.reply, |frame| request.answer(&answer).encode(frame));
                self.spend(class, self.reply.len());
                Decision::Send(&self.reply)
            }
        }
    }

    fn refuse(&mut self, class: Class, reply: Reply) -> Decision<'_> {
        if self.is_spent(class) {
            return Decision::Ignore;
        }
        fill(&mut self.refusal, |frame| reply.encode(frame));
        self.spend(class, self.refusal.len());
        Decision::Send(&self.refusal)
    }

    /// Repetitions of the latest request of a session since the start; wraps.
    pub fn repeated(&self) -> u32 {
        self.repeated
    }

    /// Whether the request being executed is signed.
    pub fn is_signed(&self) -> bool {
        self.executing.is_some_and(|executing| !matches!(executing, Executing::Unsigned(..)))
    }

    /// Encodes the answer to the request being executed into `frame`, of which [`MAX_FRAME`](crate::MAX_FRAME) bytes are
    /// enough, and returns it. Empty if no request is being executed.
    pub fn reply<'f>(&mut self, answer: &Answer, frame: &'f mut [u8]) -> &'f [u8] {
        let Some(executing) = self.executing.take() else { return &[] };
        let reply = match executing {
            Executing::Unsigned(request, ..) => request.answer(answer),
            #[cfg(feature = "auth")]
            Executing::Signed(request, session, signature) => {
                request.signed_answer(&session, signature, answer)
            }
        };
        let length = reply.encode(frame).unwrap_or(0);
        let frame = frame.get(..length).unwrap_or_default();
        let kept = match executing {
            Executing::Unsigned(_, class, is_old) => {
                self.spend(class, length);
                if is_old {
                    return frame;
                }
                &mut self.reply
            }
            #[cfg(feature = "auth")]
            Executing::Signed(..) => &mut self.signed.reply,
        };
        kept.clear();
        // A reply that does not fit is made again when the request is repeated.
        let _ = kept.extend_from_slice(frame);
        frame
    }
}

/// Puts `first` at the front in place of the item at `known`, or of the last one if the list is full.
pub(crate) fn put_first<T: Copy>(list: &mut VecView<T>, known: Option<usize>, first: T) {
    if known.is_none() {
        let _ = list.push(first);
    }
    let mut next = first;
    for item in list.iter_mut().take(known.map_or(usize::MAX, |known| known + 1)) {
        next = core::mem::replace(item, next);
    }
}
