//! Sessions and signatures.

use heapless::Vec;
use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;

use super::{DeviceKey, KeyId, KeyState, Lock, Nonce};
use crate::hello::{LinkRole, WriteAccess};
use crate::message::{self, Answer, Command, Refusal, Signature};
use crate::responder::put_first;

impl DeviceKey {
    /// An identifier that does not reveal the key.
    pub fn id(&self) -> KeyId {
        KeyId(truncated(self.mac(b"i")))
    }

    pub(crate) fn mac(&self, label: &[u8; 1]) -> Hmac<Sha256> {
        self.keyed().chain_update(label)
    }

    /// A HMAC of nothing yet.
    pub(crate) fn keyed(&self) -> Hmac<Sha256> {
        // A key shorter than a block of SHA-256 is padded with zeros.
        let mut block = [0; 64];
        if let Some(start) = block.first_chunk_mut() {
            *start = self.0;
        }
        Hmac::new(&block.into())
    }
}

/// The first `N` bytes of a HMAC.
pub(crate) fn truncated<const N: usize>(mac: Hmac<Sha256>) -> [u8; N] {
    let bytes: [u8; 32] = mac.finalize().into_bytes().into();
    bytes.first_chunk().copied().unwrap_or([0; N])
}

impl Lock {
    /// Why a signed `command` is refused on a link, if it is.
    pub(crate) fn signed_refusal(&self, command: &Command, role: LinkRole) -> Option<Refusal> {
        if command.is_key_change() && role != LinkRole::Cable {
            return Some(Refusal::CableOnly);
        }
        let locked = self.access(role) == WriteAccess::Locked;
        let restores = matches!(command, Command::SetKey(_));
        (locked && command.is_write() && !restores).then_some(Refusal::Locked)
    }

    /// The session of this number, on a link that has sessions.
    pub(crate) fn session(&self, role: LinkRole, number: u32) -> Option<Session> {
        let KeyState::Set(key) = self.key else {
            return None;
        };
        if !self.has_sessions(role) {
            return None;
        }
        let nonce = key
            .mac(b"n")
            .chain_update([role.number()])
            .chain_update(self.boot_count.unwrap_or(0).to_le_bytes())
            .chain_update(number.to_le_bytes())
            .chain_update(self.entropy);
        let nonce = truncated(nonce);
        Some(Session { key, role, device_id: self.device_id, number, nonce })
    }
}

/// A session between a host and a device: signs and verifies at both ends.
///
/// ```
/// use wimu_link::auth::{DeviceKey, Session};
/// use wimu_link::{Answer, Command, LinkRole, Requester};
///
/// // On the host, when the device has answered `OpenSession` with this number and nonce:
/// let session = Session {
///     key: DeviceKey::new([7; 32]),
///     role: LinkRole::Wireless,
///     device_id: 0x1234,
///     number: 3,
///     nonce: [9; 16],
/// };
/// let mut requester = Requester::new(0x5eed);
/// requester.sign(session, 0x4d2); // the first id: random
/// let frame = requester.start(Command::FactoryReset, Default::default());
/// assert!(!frame.is_empty());
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Session {
    /// The device's key.
    pub key: DeviceKey,
    /// The link that it is on.
    pub role: LinkRole,
    /// The device's id.
    pub device_id: u64,
    /// Its number.
    pub number: u32,
    /// The nonce that the device has returned.
    pub nonce: Nonce,
}

impl Session {
    fn mac(&self, label: &[u8; 1], id: u32) -> Hmac<Sha256> {
        self.key
            .mac(label)
            .chain_update([self.role.number()])
            .chain_update(self.device_id.to_le_bytes())
            .chain_update(self.number.to_le_bytes())
            .chain_update(self.nonce)
            .chain_update(id.to_le_bytes())
    }

    fn of_answer(&self, id: u32, request: Signature) -> Hmac<Sha256> {
        self.mac(b"a", id).chain_update(request.as_bytes())
    }

    /// Signs a request.
    pub fn sign(&self, id: u32, command: &Command) -> Signature {
        let mut mac = self.mac(b"q", id);
        message::feed(command, &mut mac);
        Signature::whole(truncated(mac))
    }

    /// Verifies the signature of a command's bytes in constant time.
    pub(crate) fn has_signed(&self, id: u32, command: &[u8], signature: Signature) -> bool {
        is_right(self.mac(b"q", id).chain_update(command), signature)
    }

    /// Signs the answer to a request that was signed with `request`.
    pub(crate) fn sign_answer(&self, id: u32, request: Signature, answer: &Answer) -> Signature {
        let mut mac = self.of_answer(id, request);
        message::feed(answer, &mut mac);
        Signature::whole(truncated(mac))
    }

    /// Verifies, in constant time, the signature of an answer's bytes to a request signed with `request`.
    pub(crate) fn has_answered(
        &self,
        id: u32,
        request: Signature,
        answer: &[u8],
        signature: Signature,
    ) -> bool {
        is_right(self.of_answer(id, request).chain_update(answer), signature)
    }
}

/// Whether a signature has its full length and matches `mac`.
fn is_right(mac: Hmac<Sha256>, signature: Signature) -> bool {
    let bytes = signature.as_bytes();
    bytes.len() == Signature::MAX && mac.verify_truncated_left(bytes).is_ok()
}

/// Authenticated sessions whose latest request is remembered.
const SESSIONS: usize = 4;

/// The sessions of one link, as the device keeps them.
#[derive(Debug)]
pub(crate) struct Sessions {
    /// Sessions opened since the device started.
    opened: u32,
    /// Sessions up to this number have ended, except those in `proved`.
    ended: u32,
    /// Number and latest id of the authenticated sessions, most recent first.
    proved: Vec<(u32, u32), SESSIONS>,
}

/// The state of a request's session.
pub(crate) enum Standing {
    /// The id is later than the latest one of the session, or the session has no authenticated request yet.
    New,
    /// The id has been used.
    Used,
    /// There is no such session.
    Ended,
}

impl Sessions {
    pub(crate) const fn new() -> Self {
        Self { opened: 0, ended: 0, proved: Vec::new() }
    }

    /// The number of a new session; `None` when the numbers are used up until the next start.
    pub(crate) fn open(&mut self) -> Option<u32> {
        self.opened = self.opened.checked_add(1)?;
        Some(self.opened)
    }

    pub(crate) fn standing(&self, number: u32, id: u32) -> Standing {
        match self.proved.iter().find(|(known, _)| *known == number) {
            // Ids wrap: the nearer half of them is later.
            Some((_, latest)) if (id.wrapping_sub(*latest) as i32) > 0 => Standing::New,
            Some(_) => Standing::Used,
            None if number > self.ended && number <= self.opened => Standing::New,
            None => Standing::Ended,
        }
    }

    /// Notes a request with a valid signature: its session moves to the front. Unused sessions opened
    /// before it end, and so does the least recently used one if there are too many.
    pub(crate) fn note(&mut self, number: u32, id: u32) {
        let known = self.proved.iter().position(|(known, _)| *known == number);
        put_first(&mut self.proved, known, (number, id));
        self.ended = self.ended.max(number);
    }
}
