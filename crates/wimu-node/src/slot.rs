//! An `Option` that is zeros while it is empty, and how a value is put into its place.

/// A value or none. With none it is zeros, of which a `static` takes no flash; an [`Option`] has some
/// other number there wherever one of `T`'s is free.
#[repr(u8)]
pub(crate) enum Slot<T> {
    Empty,
    Full(T),
}

impl<T> Slot<T> {
    pub(crate) fn as_ref(&self) -> Option<&T> {
        match self {
            Self::Empty => None,
            Self::Full(value) => Some(value),
        }
    }

    pub(crate) fn take(&mut self) -> Option<T> {
        match core::mem::replace(self, Self::Empty) {
            Self::Empty => None,
            Self::Full(value) => Some(value),
        }
    }

    /// The value; a new one if there is none. Not inlined: whoever asks would have what makes it.
    #[inline(never)]
    pub(crate) fn or_new(&mut self, new: fn() -> T) -> &mut T {
        if let Self::Empty = self {
            *self = Self::Full(new());
        }
        match self {
            Self::Full(value) => value,
            // It has just been filled.
            Self::Empty => unreachable!(),
        }
    }
}

/// Puts `value` into `place`. Here, not inlined, both are known to lie apart: nothing has a `memmove`
/// linked, which takes more flash than all of this.
#[inline(never)]
pub(crate) fn put<T: Copy>(place: &mut T, value: &T) {
    *place = *value;
}
