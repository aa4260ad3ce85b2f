//! Byte strings of a bounded length.

use core::fmt;

use serde::de::{self, Deserializer, Visitor};
use serde::{Deserialize, Serialize, Serializer};
use wimu_model::{CompiledSet, SetError};

/// A string of up to `$max` bytes.
macro_rules! short_bytes {
    ($(#[$attribute:meta])* $name:ident, $max:expr, $length:ident) => {
        $(#[$attribute])*
        #[derive(Clone, Copy, PartialEq, Eq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $name {
            length: $length,
            bytes: [u8; Self::MAX],
        }

        impl $name {
            /// The greatest length, bytes.
            pub const MAX: usize = $max;

            /// No bytes.
            pub const NONE: Self = Self {
                length: 0,
                bytes: [0; Self::MAX],
            };

            /// From its bytes; `None` if there are more than [`MAX`](Self::MAX).
            pub fn new(content: &[u8]) -> Option<Self> {
                let mut bytes = [0; Self::MAX];
                bytes.get_mut(..content.len())?.copy_from_slice(content);
                Some(Self {
                    length: content.len() as $length,
                    bytes,
                })
            }

            /// Its bytes.
            pub fn as_bytes(&self) -> &[u8] {
                self.bytes.get(..self.length.into()).unwrap_or_default()
            }
        }

        impl Default for $name {
            fn default() -> Self {
                Self::NONE
            }
        }

        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_bytes(self.as_bytes())
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                struct Bytes;

                impl Visitor<'_> for Bytes {
                    type Value = $name;

                    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                        write!(out, "at most {} bytes", $name::MAX)
                    }

                    fn visit_bytes<E: de::Error>(self, bytes: &[u8]) -> Result<$name, E> {
                        $name::new(bytes).ok_or_else(|| E::invalid_length(bytes.len(), &self))
                    }
                }

                deserializer.deserialize_bytes(Bytes)
            }
        }
    };
}

short_bytes!(
    /// The signature of a request or reply, 8 bytes ([`auth`](crate::auth)), or none.
    #[derive(Debug)]
    Signature, 8, u8
);

short_bytes!(
    /// The bytes of a [`CompiledSet`](wimu_model::CompiledSet); none: uncalibrated. Without the feature `parameters` it has
    /// room for none.
    SetBytes, if cfg!(feature = "parameters") { CompiledSet::MAX_BYTES } else { 0 }, u16
);

impl Signature {
    /// A signature of 8 bytes.
    #[cfg(feature = "auth")]
    pub(crate) const fn whole(bytes: [u8; Self::MAX]) -> Self {
        Self { length: Self::MAX as u8, bytes }
    }
}

impl fmt::Debug for SetBytes {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_list().entries(self.as_bytes()).finish()
    }
}

impl From<&CompiledSet> for SetBytes {
    fn from(set: &CompiledSet) -> Self {
        let mut bytes = [0; CompiledSet::MAX_BYTES];
        let length = set.to_bytes(&mut bytes);
        Self::new(bytes.get(..length).unwrap_or_default()).unwrap_or_default()
    }
}

impl SetBytes {
    /// The set; `None` without one.
    ///
    /// # Errors
    /// [`SetError`] when it is not one.
    pub fn set(&self) -> Result<Option<CompiledSet>, SetError> {
        match self.as_bytes() {
            [] => Ok(None),
            bytes => CompiledSet::from_bytes(bytes).map(Some),
        }
    }
}
