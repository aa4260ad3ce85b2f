//! The device's side of requests: every request has one effect, however often it is repeated.

use crate::frame::{FrameBuffer, MAX_FRAME, crc_32c};
use crate::hello::{LinkRole, WriteAccess};
use crate::message::{Answer, Command, Refusal, Reply, RequestHead, Signature};

/// Sessions whose latest request is remembered.
const SESSIONS: usize = 4;

/// What a device does about a request.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(clippy::large_enum_variant, reason = "there is no heap to box on")]
pub enum Decision<'a> {
    /// Carry this out, then send what [`Responder::reply`] returns.
    Execute(Command),
    /// Send this frame: the request was answered before, or is refused.
    Send(&'a [u8]),
    /// Do nothing: the bytes are no request, or one is still being carried out; the host asks
    /// again.
    Ignore,
}

/// Takes the requests of one link. It does no I/O: give it bodies, send the frames it returns.
///
/// Requests are known by session and id. The latest one is answered again with the same bytes when
/// it is repeated; one that is older, of this session or of the three before, is refused as stale.
/// Writes pass on a cable as long as its access is open; elsewhere they take the device's key,
/// which this version cannot check yet, so they are refused.
///
/// ```
/// use wimu_link::hello::{LinkRole, WriteAccess};
/// use wimu_link::message::{Answer, Command, Payload, Settings};
/// use wimu_link::responder::{Decision, Responder};
/// use wimu_link::{Deframer, Kind};
///
/// fn on_byte(byte: u8, deframer: &mut Deframer, responder: &mut Responder, settings: &mut Settings) {
///     let Some(Ok(frame)) = deframer.push(byte) else { return };
///     if frame.kind != Kind::Request {
///         return;
///     }
///     match responder.accept(frame.body, WriteAccess::Open) {
///         Decision::Execute(Command::SetSettings(new)) => {
///             *settings = new;
///             let answer = Answer::Accepted(Payload::Settings(*settings));
///             send(responder.reply(&answer));
///         }
///         Decision::Execute(_) => send(responder.reply(&Answer::Unknown)),
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
    /// The latest request of each session, the latest session first.
    latest: [Option<Known>; SESSIONS],
    /// Whether the first of them is being carried out.
    executing: bool,
    /// The reply to the first of them.
    reply: FrameBuffer<MAX_FRAME>,
    /// Requests that came again.
    repeated: u32,
    /// The refusal of a stale request, which must not replace that reply.
    stale: FrameBuffer<STALE_FRAME>,
}

/// Session and id at their longest, signature, answer, refusal, kind, CRC, stuffing, zero.
const STALE_FRAME: usize = 5 + 5 + 1 + 2 + 1 + 4 + 1 + 1;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Known {
    session: u32,
    id: u32,
    /// CRC-32C of the request: tells it from another that took its id.
    content: u32,
}

impl Known {
    fn answer(&self, answer: &Answer) -> Reply {
        Reply {
            session: self.session,
            id: self.id,
            signature: Signature::NONE,
            answer: *answer,
        }
    }
}

impl Responder {
    /// A responder for a link of this role, before any request.
    pub const fn new(role: LinkRole) -> Self {
        Self {
            role,
            latest: [None; SESSIONS],
            executing: false,
            reply: FrameBuffer::new(),
            repeated: 0,
            stale: FrameBuffer::new(),
        }
    }

    /// Takes the body of a frame of kind [`Request`](crate::Kind::Request), and the link's write
    /// access at the moment.
    pub fn accept(&mut self, body: &[u8], access: WriteAccess) -> Decision<'_> {
        let Ok((head, command)) = RequestHead::split(body) else {
            return Decision::Ignore;
        };
        let request = Known {
            session: head.session,
            id: head.id,
            content: crc_32c(body),
        };
        let known = self
            .latest
            .iter()
            .position(|known| known.is_some_and(|known| known.session == request.session));
        let latest = known
            .and_then(|place| self.latest.get(place).copied())
            .flatten();
        if let Some(latest) = latest {
            if latest == request && known == Some(0) {
                self.repeated = self.repeated.wrapping_add(1);
                return if self.executing {
                    Decision::Ignore
                } else {
                    Decision::Send(self.reply.frame())
                };
            }
            // Ids wrap: the nearer half of them is later.
            if (request.id.wrapping_sub(latest.id) as i32) <= 0 {
                let stale = request.answer(&Answer::Refused(Refusal::Stale));
                self.stale.fill(|frame| stale.encode(frame));
                return Decision::Send(self.stale.frame());
            }
        }
        if self.executing {
            return Decision::Ignore;
        }

        // This session moves to the front; what was before it moves back by one.
        let moved = known.unwrap_or(SESSIONS - 1);
        if let Some(moving) = self.latest.get_mut(..=moved) {
            moving.rotate_right(1);
        }
        if let Some(front) = self.latest.first_mut() {
            *front = Some(request);
        }

        let outcome = match Command::decode(command) {
            Err(_) => Err(Answer::Unknown),
            Ok(command) => match self.refusal(&command, access) {
                Some(refusal) => Err(Answer::Refused(refusal)),
                None => Ok(command),
            },
        };
        match outcome {
            Ok(command) => {
                self.executing = true;
                Decision::Execute(command)
            }
            Err(answer) => {
                self.reply
                    .fill(|frame| request.answer(&answer).encode(frame));
                Decision::Send(self.reply.frame())
            }
        }
    }

    /// Why `command` is refused on this link, if it is.
    fn refusal(&self, command: &Command, access: WriteAccess) -> Option<Refusal> {
        match (self.role, access) {
            _ if !command.is_write() => None,
            (LinkRole::Cable, WriteAccess::Open) => None,
            (_, WriteAccess::Locked) => Some(Refusal::Locked),
            _ => Some(Refusal::KeyNeeded),
        }
    }

    /// How often the latest request of a session came again, since the start; wraps.
    pub fn repeated(&self) -> u32 {
        self.repeated
    }

    /// The frame that answers the request that was to be executed; the same bytes will answer its
    /// repeats. Empty when none was.
    pub fn reply(&mut self, answer: &Answer) -> &[u8] {
        match self.latest.first() {
            Some(Some(request)) if self.executing => {
                self.executing = false;
                self.reply
                    .fill(|frame| request.answer(answer).encode(frame));
                self.reply.frame()
            }
            _ => &[],
        }
    }
}
