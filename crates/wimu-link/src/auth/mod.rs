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

use serde::de::{self, Deserializer, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};

use crate::hello::{LinkRole, WriteAccess};
use crate::message::{Command, Refusal};
#[cfg(feature = "auth")]
pub use session::Session;
#[cfg(feature = "auth")]
pub(crate) use session::{Sessions, Standing, truncated};

#[cfg(feature = "auth")]
mod session;

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

/// Makes the signatures of one session differ from those of all others.
pub type Nonce = [u8; 16];

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
}
