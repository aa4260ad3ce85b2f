//! The device's side of requests: every request has one effect, however often it is repeated.

use serde::Serialize;

use crate::auth::{KeyState, Lock, Session, Sessions, Standing, put_first};
use crate::checksum::crc_32c;
use crate::frame::FrameBuffer;
use crate::hello::LinkRole;
use crate::message::{
    Answer, Command, EncodedParameters, Head, Payload, Refusal, Reply, Signature,
};

/// Unsigned sessions whose latest request is remembered.
const SESSIONS: usize = 4;

/// What a device does about a request.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Decision<'a, 'b> {
    /// Carry this out, then send what [`Responder::reply`] returns. Parameters are in the request's
    /// body.
    Execute(Command<EncodedParameters<'b>>),
    /// Send this frame: the request was answered before, or is refused.
    Send(&'a [u8]),
    /// Do nothing: the bytes are no request, or one is still being carried out; the host asks
    /// again.
    Ignore,
}

/// Takes the requests of one link. It does no I/O: give it bodies, send the frames it returns.
///
/// Requests are known by session and id. The latest one is answered again when it is repeated, with
/// the same bytes, or, if it changes nothing and its answer is long, by carrying it out again; one
/// that is older, of this session or of the three before, is refused as stale.
/// Who may write, the [`Lock`] says; signatures are checked here ([`auth`](crate::auth)). Unsigned
/// requests and wrong signatures have no effect on signed ones, however many they are.
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
    latest: [Option<Known>; SESSIONS],
    /// The reply to the first of them.
    reply: FrameBuffer<KEPT_FRAME>,
    sessions: Sessions,
    /// The latest signed request.
    latest_signed: Option<Known>,
    /// The reply to it.
    signed_reply: FrameBuffer<KEPT_FRAME>,
    executing: Option<Executing>,
    /// Requests that came again.
    repeated: u32,
    /// A refusal that must replace neither reply.
    refusal: FrameBuffer<REFUSAL_FRAME>,
}

/// Session and id at their longest, signature, answer, refusal, kind, CRC, stuffing, zero.
const REFUSAL_FRAME: usize = 5 + 5 + 9 + 2 + 1 + 4 + 1 + 1;

/// An answer without parameters.
type ShortAnswer = Answer<EncodedParameters<'static>>;

/// The longest answer to a request that changes anything, with what is around it.
const KEPT_FRAME: usize = 80;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Known {
    session: u32,
    id: u32,
    /// CRC-32C of the request: tells it from another that took its id.
    content: u32,
}

/// What is being carried out.
#[derive(Clone, Copy, Debug)]
enum Executing {
    Unsigned(Known),
    /// With what its answer is signed.
    Signed(Known, Session, Signature),
}

impl Known {
    fn answer<P: Copy>(&self, answer: &Answer<P>) -> Reply<P> {
        Reply {
            session: self.session,
            id: self.id,
            signature: Signature::NONE,
            answer: *answer,
        }
    }

    fn signed_answer<P: Copy + Serialize>(
        &self,
        session: &Session,
        request: Signature,
        answer: &Answer<P>,
    ) -> Reply<P> {
        Reply {
            signature: session.sign_answer(self.id, request, answer),
            ..self.answer(answer)
        }
    }
}

impl Responder {
    /// A responder for a link of this role, before any request.
    pub const fn new(role: LinkRole) -> Self {
        Self {
            role,
            latest: [None; SESSIONS],
            reply: FrameBuffer::new(),
            sessions: Sessions::new(),
            latest_signed: None,
            signed_reply: FrameBuffer::new(),
            executing: None,
            repeated: 0,
            refusal: FrameBuffer::new(),
        }
    }

    /// Takes the body of a frame of kind [`Request`](crate::Kind::Request), and who may write at
    /// the moment.
    pub fn accept<'b>(&mut self, body: &'b [u8], lock: &Lock) -> Decision<'_, 'b> {
        let Ok((head, command)) = Head::split(body) else {
            return Decision::Ignore;
        };
        let request = Known {
            session: head.session,
            id: head.id,
            content: crc_32c(body),
        };
        if head.signature == Signature::NONE {
            self.accept_unsigned(request, command, lock)
        } else {
            self.accept_signed(request, head.signature, command, lock)
        }
    }

    fn accept_unsigned<'b>(
        &mut self,
        request: Known,
        command: &'b [u8],
        lock: &Lock,
    ) -> Decision<'_, 'b> {
        let known = self
            .latest
            .iter()
            .position(|known| known.is_some_and(|known| known.session == request.session));
        let latest = known
            .and_then(|place| self.latest.get(place).copied())
            .flatten();
        let repeats = latest == Some(request) && known == Some(0);
        if repeats {
            self.repeated = self.repeated.wrapping_add(1);
            match self.executing {
                Some(Executing::Unsigned(_)) => return Decision::Ignore,
                _ if !self.reply.frame().is_empty() => return Decision::Send(self.reply.frame()),
                _ => {}
            }
        } else if let Some(latest) = latest {
            // Ids wrap: the nearer half of them is later.
            if (request.id.wrapping_sub(latest.id) as i32) <= 0 {
                return self.refuse(request.answer(&Answer::Refused(Refusal::Stale)));
            }
        }
        if self.executing.is_some() {
            return Decision::Ignore;
        }

        // This session moves to the front; what was before it moves back by one.
        let moved = known.unwrap_or(SESSIONS - 1);
        put_first(&mut self.latest, moved, Some(request));

        let outcome = match Command::take(command) {
            Err(_) => Err(Answer::Unknown),
            // It has had its effect.
            Ok(command) if repeats && command.is_write() => return Decision::Ignore,
            Ok(command) => match lock.refusal(&command, self.role) {
                Some(refusal) => Err(Answer::Refused(refusal)),
                None if matches!(command, Command::OpenSession) => Err(self.open_session(lock)),
                None => Ok(command),
            },
        };
        match outcome {
            Ok(command) => {
                self.executing = Some(Executing::Unsigned(request));
                self.reply.clear();
                Decision::Execute(command)
            }
            Err(answer) => {
                self.reply
                    .fill(|frame| request.answer(&answer).encode(frame));
                Decision::Send(self.reply.frame())
            }
        }
    }

    fn accept_signed<'b>(
        &mut self,
        request: Known,
        signature: Signature,
        command: &'b [u8],
        lock: &Lock,
    ) -> Decision<'_, 'b> {
        let repeats = self.latest_signed == Some(request);
        if repeats {
            self.repeated = self.repeated.wrapping_add(1);
            match self.executing {
                Some(Executing::Signed(..)) => return Decision::Ignore,
                // What was sent before: nobody learns anything from it.
                _ if !self.signed_reply.frame().is_empty() => {
                    return Decision::Send(self.signed_reply.frame());
                }
                _ => {}
            }
        }
        let refused = |refusal| request.answer(&Answer::Refused(refusal));
        let Some(session) = lock.session(self.role, request.session) else {
            let refusal = match lock.key {
                KeyState::None => Refusal::KeyNeeded,
                _ => Refusal::Locked,
            };
            return self.refuse(refused(refusal));
        };
        let standing = self.sessions.standing(request.session, request.id);
        if let Standing::Ended = standing {
            return self.refuse(refused(Refusal::SessionEnded));
        }
        if !session.has_signed(request.id, command, signature) {
            return self.refuse(refused(Refusal::WrongSignature));
        }
        let signed = |answer: &ShortAnswer| request.signed_answer(&session, signature, answer);
        // What is like the latest request up to its CRC may be another: its signature counts.
        if !repeats && matches!(standing, Standing::Used) {
            return self.refuse(signed(&Answer::Refused(Refusal::Stale)));
        }
        if self.executing.is_some() {
            return Decision::Ignore;
        }
        self.sessions.note(request.session, request.id);
        self.latest_signed = Some(request);
        let outcome = match Command::take(command) {
            Err(_) => Err(Answer::Unknown),
            Ok(command) if repeats && command.is_write() => return Decision::Ignore,
            Ok(Command::OpenSession) => Err(self.open_session(lock)),
            Ok(command) => match lock.signed_refusal(&command, self.role) {
                Some(refusal) => Err(Answer::Refused(refusal)),
                None => Ok(command),
            },
        };
        match outcome {
            Ok(command) => {
                self.executing = Some(Executing::Signed(request, session, signature));
                self.signed_reply.clear();
                Decision::Execute(command)
            }
            Err(answer) => {
                self.signed_reply
                    .fill(|frame| signed(&answer).encode(frame));
                Decision::Send(self.signed_reply.frame())
            }
        }
    }

    fn refuse<'b>(&mut self, reply: Reply<EncodedParameters<'static>>) -> Decision<'_, 'b> {
        self.refusal.fill(|frame| reply.encode(frame));
        Decision::Send(self.refusal.frame())
    }

    fn open_session(&mut self, lock: &Lock) -> ShortAnswer {
        let number = self.sessions.open();
        match number.and_then(|number| lock.session(self.role, number)) {
            Some(session) => Answer::Accepted(Payload::Session {
                number: session.number,
                nonce: session.nonce,
            }),
            None => Answer::Refused(Refusal::Locked),
        }
    }

    /// How often the latest request of a session came again, since the start; wraps.
    pub fn repeated(&self) -> u32 {
        self.repeated
    }

    /// Puts the frame that answers the request that was to be executed into `frame`, of which
    /// [`MAX_FRAME`](crate::MAX_FRAME) bytes are enough, and returns it. Empty when none was.
    pub fn reply<'f, P: Copy + Serialize>(
        &mut self,
        answer: &Answer<P>,
        frame: &'f mut [u8],
    ) -> &'f [u8] {
        let (reply, kept) = match self.executing.take() {
            Some(Executing::Unsigned(request)) => (request.answer(answer), &mut self.reply),
            Some(Executing::Signed(request, session, signature)) => (
                request.signed_answer(&session, signature, answer),
                &mut self.signed_reply,
            ),
            None => return &[],
        };
        let length = reply.encode(frame).unwrap_or(0);
        let frame = frame.get(..length).unwrap_or_default();
        kept.keep(frame);
        frame
    }
}
