//! Who may write: keys, sessions, signatures.
//!
//! A device with a key accepts only writes that are signed with it. The key is not transmitted after it
//! was set. Signatures are truncated HMAC-SHA-256 (RFC 2104, FIPS 180-4):
//!
//! | value | computed over, in this order | bytes |
//! |---|---|---|
//! | key id | `i` | 4 |
//! | nonce | `n`, link role (1), boot count (4), session (4), entropy of this start (16) | 16 |
//! | signature of a request | `q`, link role (1), device id (8), session (4), nonce (16), id (4), command | 8 |
//! | signature of a reply | `a`, the same, the request's signature (8), answer | 8 |
//!
//! Numbers are little-endian; command and answer are encoded as in the frame. A host opens a session
//! with an unsigned request and receives its number and nonce; every signed request has the next id. The
//! first id should be random, so that no reply of an earlier session is accepted as an answer.
//!
//! The device stores nothing of a session before the first valid signature, so opening any number of
//! sessions without the key ends no other session. The boot count makes the nonces of two starts
//! differ even without entropy.

use core::fmt;

use heapless::{Vec, VecView};
use hmac::{Hmac, KeyInit, Mac};
use serde::de::{self, Deserializer, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};
use sha2::Sha256;

use crate::hello::{LinkRole, WriteAccess};
use crate::message::{self, Answer, Command, Refusal, Signature};

/// A device's key: 256 secret bits. `Debug` does not print it.
#[derive(Clone, Copy, PartialEq, Serialize)]
pub struct DeviceKey([u8; Self::LENGTH]);

impl DeviceKey {
    /// Its length, bytes.
    pub const LENGTH: usize = 32;

    /// A key of these bytes, which must come from a cryptographic random source.
    pub const fn new(bytes: [u8; Self::LENGTH]) -> Self {
        Self(bytes)
    }

    /// The secret bytes, for storage.
    pub const fn expose(&self) -> &[u8; Self::LENGTH] {
        &self.0
    }

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

impl<'de> Deserialize<'de> for DeviceKey {
    /// As an array, in a loop: serde's code for arrays is unrolled and larger.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Bytes;

        impl<'de> Visitor<'de> for Bytes {
            type Value = DeviceKey;

            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                out.write_str("a key")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<DeviceKey, A::Error> {
                let mut bytes = [0; DeviceKey::LENGTH];
                for (index, byte) in bytes.iter_mut().enumerate() {
                    let next = elements.next_element()?;
                    *byte = next.ok_or_else(|| de::Error::invalid_length(index, &self))?;
                }
                Ok(DeviceKey(bytes))
            }
        }

        deserializer.deserialize_tuple(Self::LENGTH, Bytes)
    }
}

impl fmt::Debug for DeviceKey {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("DeviceKey(…)")
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for DeviceKey {
    fn format(&self, out: defmt::Formatter<'_>) {
        defmt::write!(out, "DeviceKey(…)");
    }
}

/// Identifies a [`DeviceKey`]; two keys have the same id with probability 2⁻³².
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct KeyId(pub [u8; 4]);

impl fmt::Display for KeyId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{:08x}", u32::from_be_bytes(self.0))
    }
}

/// The state of a device's key.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum KeyState {
    /// No key has been set.
    None,
    /// This key is set.
    Set(DeviceKey),
    /// The stored key cannot be read: all writes are refused.
    #[default]
    Unreadable,
}

/// The state that decides who may write to a device, common to all its links.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Lock {
    /// The device's key.
    pub key: KeyState,
    /// The device's id, as in [`Hello`](crate::Hello).
    pub device_id: u64,
    /// Number of starts; `None` if it cannot be read or stored. A device with a key then accepts only a new
    /// key, over the cable; one without a key still accepts all writes over the cable.
    pub boot_count: Option<u32>,
    /// Unpredictable bits, new at each start; zeros without an entropy source.
    pub entropy: [u8; 16],
}

impl Lock {
    /// Who may write on a link.
    pub fn access(&self, role: LinkRole) -> WriteAccess {
        match (self.key, role) {
            (KeyState::Unreadable, _) => WriteAccess::Locked,
            (KeyState::None, LinkRole::Cable) => WriteAccess::Open,
            // Sessions of two starts could have the same nonce.
            _ if self.boot_count.is_none() => WriteAccess::Locked,
            _ => WriteAccess::Key,
        }
    }

    /// Whether sessions can be opened on a link. Without a boot count only on the cable, where they serve
    /// to set a new key, which restarts the boot count.
    fn has_sessions(&self, role: LinkRole) -> bool {
        matches!(self.key, KeyState::Set(_))
            && (role == LinkRole::Cable || self.boot_count.is_some())
    }

    /// Why a signed `command` is refused on a link, if it is.
    pub(crate) fn signed_refusal(&self, command: &Command, role: LinkRole) -> Option<Refusal> {
        if command.is_key_change() && role != LinkRole::Cable {
            return Some(Refusal::CableOnly);
        }
        let locked = self.access(role) == WriteAccess::Locked;
        let restores = matches!(command, Command::SetKey(_));
        (locked && command.is_write() && !restores).then_some(Refusal::Locked)
    }

    /// Why an unsigned `command` is refused on a link, if it is.
    pub(crate) fn refusal(&self, command: &Command, role: LinkRole) -> Option<Refusal> {
        let access = self.access(role);
        match (command, access) {
            _ if command.is_key_change() && role != LinkRole::Cable => Some(Refusal::CableOnly),
            (Command::OpenSession, WriteAccess::Open) => Some(Refusal::KeyNeeded),
            (Command::OpenSession, _) if self.has_sessions(role) => None,
            _ if !command.is_write() && !matches!(command, Command::OpenSession) => None,
            (_, WriteAccess::Open) => None,
            (_, WriteAccess::Locked | WriteAccess::Other(_)) => Some(Refusal::Locked),
            (_, WriteAccess::Key) => match self.key {
                KeyState::Set(_) => Some(Refusal::SignatureNeeded),
                _ => Some(Refusal::KeyNeeded),
            },
        }
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

/// Makes the signatures of one session differ from those of all others.
pub type Nonce = [u8; 16];

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
