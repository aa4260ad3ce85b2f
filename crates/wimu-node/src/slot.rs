//! An `Option` whose empty value is all zeros.

/// A value or none. The empty slot is all zeros, so that a `static` takes no flash; an [`Option`] may
/// encode `None` as an unused value of `T`, which is not zero.
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

    /// The value, made by `new` if the slot is empty. Not inlined, so that the code of `new` exists once.
    #[inline(never)]
    pub(crate) fn or_new(&mut self, new: fn() -> T) -> &mut T {
        if let Self::Empty = self {
            *self = Self::Full(new());
        }
        match self {
            Self::Full(value) => value,
            // Filled above.
            Self::Empty => unreachable!(),
        }
    }
}

/// Copies `value` to `place`. Not inlined: as references of this function they do not overlap, so that
/// no `memmove` is linked.
#[inline(never)]
pub(crate) fn put<T: Copy>(place: &mut T, value: &T) {
    *place = *value;
}
