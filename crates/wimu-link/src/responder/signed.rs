//! Signed requests.

use heapless::Vec;

use super::{Class, Decision, Executing, KEPT_FRAME, Known, Responder};
use crate::auth::{KeyState, Lock, Session, Sessions, Standing};
use crate::frame::{MAX_FRAME, fill};
use crate::message::{Answer, Command, Payload, Refusal, Reply, Signature};

/// The signed requests of a link.
#[derive(Debug)]
pub(super) struct Signed {
    sessions: Sessions,
    /// The latest request.
    latest: Option<Known>,
    /// The reply to it.
    pub(super) reply: Vec<u8, KEPT_FRAME>,
}

impl Signed {
    pub(super) const fn new() -> Self {
        Self { sessions: Sessions::new(), latest: None, reply: Vec::new() }
    }
}

impl Known {
    pub(super) fn signed_answer(
        &self,
        session: &Session,
        request: Signature,
        answer: &Answer,
    ) -> Reply {
        Reply { signature: session.sign_answer(self.id, request, answer), ..self.answer(answer) }
    }
}

impl Responder {
    pub(super) fn accept_signed(
        &mut self,
        request: Known,
        signature: Signature,
        command: &[u8],
        lock: &Lock,
    ) -> Decision<'_> {
        let repeats = self.signed.latest == Some(request);
        if repeats {
            self.repeated = self.repeated.wrapping_add(1);
            match self.executing {
                Some(Executing::Signed(..)) => return Decision::Ignore,
                _ if self.is_spent(Class::Repeated) => return Decision::Ignore,
                // The same bytes as before: they disclose nothing new.
                _ if !self.signed.reply.is_empty() => {
                    self.spend(Class::Repeated, self.signed.reply.len());
                    return Decision::Send(&self.signed.reply);
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
            return self.refuse(Class::Other, refused(refusal));
        };
        let standing = self.signed.sessions.standing(request.session, request.id);
        if let Standing::Ended = standing {
            return self.refuse(Class::Other, refused(Refusal::SessionEnded));
        }
        if !session.has_signed(request.id, command, signature) {
            return self.refuse(Class::Other, refused(Refusal::WrongSignature));
        }
        let signed = |answer: &Answer| request.signed_answer(&session, signature, answer);
        // An equal CRC may belong to another request, so the signature is verified first.
        if !repeats && matches!(standing, Standing::Used) {
            return self.refuse(Class::Other, signed(&Answer::Refused(Refusal::Stale)));
        }
        if self.executing.is_some() {
            return Decision::Ignore;
        }
        self.signed.sessions.note(request.session, request.id);
        self.signed.latest = Some(request);
        let outcome = match Command::decode(command) {
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
                if repeats {
                    // The longest answer.
                    self.spend(Class::Repeated, MAX_FRAME);
                }
                self.executing = Some(Executing::Signed(request, session, signature));
                self.signed.reply.clear();
                Decision::Execute(command)
            }
            Err(answer) => {
                fill(&mut self.signed.reply, |frame| signed(&answer).encode(frame));
                Decision::Send(&self.signed.reply)
            }
        }
    }

    pub(super) fn open_session(&mut self, lock: &Lock) -> Answer {
        let number = self.signed.sessions.open();
        match number.and_then(|number| lock.session(self.role, number)) {
            Some(session) => {
                Answer::Accepted(Payload::Session { number: session.number, nonce: session.nonce })
            }
            None => Answer::Refused(Refusal::Locked),
        }
    }
}
