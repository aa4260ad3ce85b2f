//! Authentication of what a device sends: one [`Tag`] after each [`Epoch`](crate::message::Epoch), over every frame
//! that left on the link since the previous tag, the epoch included.
//!
//! The codes of the frames are added, so that their order does not matter, and a receiver can tell a frame that it lacks
//! from one that was forged. This is the keyed incremental multiset hash MSet-Add-Hash (D. Clarke, S. Devadas, M. van
//! Dijk, B. Gassend, G. E. Suh, "Incremental Multiset Hash Functions and Their Application to Memory Integrity
//! Checking", *ASIACRYPT* 2003) with HMAC-SHA-256, truncated to 8 bytes, as its function:
//!
//! | value | HMAC with the key | computed over, in this order | bytes |
//! |---|---|---|---|
//! | telemetry key | of the device | `t`, link role (1), device id (8), boot count (4) | 32 |
//! | code of a frame | telemetry key | `f`, the frame as on the line without its closing zero | 8 |
//! | code of an interval | telemetry key | `s`, its number (4), its number of frames (4) | 8 |
//! | tag | – | code of the interval plus the codes of its frames, modulo 2⁶⁴ | 8 |
//!
//! Numbers are little-endian. A number is used once in a start of the device, and a boot count once with a key. So the
//! code of the interval hides the sum: a tag shows nothing about another one.
//!
//! ```
//! use wimu_link::auth::{DeviceKey, KeyState, Lock};
//! use wimu_link::message::{Epoch, Telemetry};
//! use wimu_link::tag::{TagKey, Tagger};
//! use wimu_link::{LinkRole, MAX_FRAME};
//!
//! let mut frame = [0; MAX_FRAME];
//! let epoch: Telemetry = Telemetry::Epoch(Epoch::default());
//! let length = epoch.encode(&mut frame)?;
//!
//! // On the device, with the bytes that it sends.
//! let (key, device_id, boot_count) = (DeviceKey::new([7; 32]), 0x1234, 5);
//! let lock = Lock { key: KeyState::Set(key), device_id, boot_count: Some(boot_count), ..Lock::default() };
//! let mut tagger = Tagger::new(LinkRole::Wireless);
//! let tag = tagger.sent(&frame[..length], true, || lock).expect("an epoch was sent");
//!
//! // On the host.
//! let key = TagKey::new(&key, LinkRole::Wireless, device_id, boot_count);
//! let code = key.of_frame(&frame[..length]);
//! assert_eq!(tag.sum(&key), code);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use core::fmt;

use hmac::{Hmac, Mac};
use serde::{Deserialize, Serialize};
use sha2::Sha256;

use crate::auth::{DeviceKey, KeyId, KeyState, Lock, truncated};
use crate::frame::{Kind, WIRE_VERSION};
use crate::hello::LinkRole;

/// The authentication of an interval: of the frames sent on a link since the previous tag. It follows an epoch
/// immediately and is not part of any interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Tag {
    /// The device's key.
    pub key: KeyId,
    /// The device's start.
    pub boot_count: u32,
    /// Number of the interval on this link: 1 is the first since the start, without one in between.
    pub number: u32,
    /// Number of frames in it.
    pub frames: u32,
    /// The tag.
    pub code: [u8; 8],
}

impl Tag {
    /// The longest frame of a tag, bytes, with its closing zero.
    pub const MAX_FRAME: usize = 1 + (1 + 1 + 4 + 3 * 5 + 8 + 4) + 1;

    /// The sum of the codes of the interval's frames, modulo 2⁶⁴, if the tag is authentic.
    pub fn sum(&self, key: &TagKey) -> u64 {
        u64::from_le_bytes(self.code).wrapping_sub(key.of_interval(self.number, self.frames))
    }
}

/// The key of the tags on one link in one start of a device. `Debug` does not print it.
#[derive(Clone)]
pub struct TagKey(Hmac<Sha256>);

impl TagKey {
    /// The key for this link and start.
    pub fn new(key: &DeviceKey, role: LinkRole, device_id: u64, boot_count: u32) -> Self {
        let derived = key
            .mac(b"t")
            .chain_update([role.number()])
            .chain_update(device_id.to_le_bytes())
            .chain_update(boot_count.to_le_bytes());
        Self(DeviceKey::new(truncated(derived)).keyed())
    }

    /// The code of a frame, with or without its closing zero.
    pub fn of_frame(&self, frame: &[u8]) -> u64 {
        let frame = frame.strip_suffix(&[0]).unwrap_or(frame);
        code(self.mac(b"f").chain_update(frame))
    }

    fn of_interval(&self, number: u32, frames: u32) -> u64 {
        let mac = self.mac(b"s").chain_update(number.to_le_bytes());
        code(mac.chain_update(frames.to_le_bytes()))
    }

    fn mac(&self, label: &[u8; 1]) -> Hmac<Sha256> {
        self.0.clone().chain_update(label)
    }
}

impl fmt::Debug for TagKey {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("TagKey(…)")
    }
}

fn code(mac: Hmac<Sha256>) -> u64 {
    u64::from_le_bytes(truncated(mac))
}

/// The first bytes of an epoch's frame on the line: the distance to its first zero, which is the number of the variant,
/// and the frame's first byte.
const EPOCH: [u8; 2] = [2, WIRE_VERSION << 4 | Kind::Telemetry as u8];

/// Computes the tags of one link on the device, from the bytes as they are sent. Without a key, or without a boot count,
/// there are none. A new key is used from the next interval on.
#[derive(Debug)]
pub struct Tagger {
    role: LinkRole,
    /// The latest interval.
    number: u32,
    interval: Option<Interval>,
    /// The mac of the frame being sent, if it is of an interval.
    frame: Option<Hmac<Sha256>>,
    /// Whether a frame is being sent, and whether it is an epoch.
    is_within: bool,
    is_epoch: bool,
}

#[derive(Debug)]
struct Interval {
    key: TagKey,
    id: KeyId,
    boot_count: u32,
    frames: u32,
    sum: u64,
}

impl Interval {
    fn begin(role: LinkRole, lock: &Lock) -> Option<Self> {
        let (KeyState::Set(key), Some(boot_count)) = (lock.key, lock.boot_count) else {
            return None;
        };
        Some(Self {
            key: TagKey::new(&key, role, lock.device_id, boot_count),
            id: key.id(),
            boot_count,
            frames: 0,
            sum: 0,
        })
    }
}

impl Tagger {
    /// For a link on which nothing has been sent since the start.
    pub const fn new(role: LinkRole) -> Self {
        Self { role, number: 0, interval: None, frame: None, is_within: false, is_epoch: false }
    }

    /// Takes the next bytes that are sent, at most to the closing zero of their frame; `ends` if they include it. Returns
    /// the tag to send next, before any other frame. `lock` is asked at the start of an interval.
    pub fn sent(&mut self, bytes: &[u8], ends: bool, lock: impl FnOnce() -> Lock) -> Option<Tag> {
        if !self.is_within {
            if self.interval.is_none() {
                self.interval = Interval::begin(self.role, &lock());
            }
            self.frame = self.interval.as_ref().map(|of| of.key.mac(b"f"));
            self.is_epoch = bytes.starts_with(&EPOCH);
        }
        self.is_within = !ends;
        let content = if ends { bytes.strip_suffix(&[0]).unwrap_or(bytes) } else { bytes };
        if let Some(mac) = &mut self.frame {
            mac.update(content);
        }
        if !ends {
            return None;
        }
        if let (Some(mac), Some(interval)) = (self.frame.take(), &mut self.interval) {
            interval.frames = interval.frames.wrapping_add(1);
            interval.sum = interval.sum.wrapping_add(code(mac));
        }
        if self.is_epoch { self.end() } else { None }
    }

    /// Ends the interval. One without a tag has a number too, so that the next one does not seem to follow the latest tag.
    fn end(&mut self) -> Option<Tag> {
        self.number = self.number.wrapping_add(1);
        let Interval { key, id, boot_count, frames, sum } = self.interval.take()?;
        let code = key.of_interval(self.number, frames).wrapping_add(sum);
        Some(Tag { key: id, boot_count, number: self.number, frames, code: code.to_le_bytes() })
    }
}
