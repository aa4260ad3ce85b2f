//! Sets of the variants of an enum, a bit each.

/// Methods that all sets have. The enum has `ALL`, all its variants in the order of their
/// discriminants.
macro_rules! set {
    ($set:ident($bits:ty) of $item:ident) => {
        impl $set {
            /// Whether `item` is in the set.
            pub const fn contains(self, item: $item) -> bool {
                self.0 >> item as u8 & 1 == 1
            }

            /// The set with `item` added.
            #[must_use]
            pub const fn with(self, item: $item) -> Self {
                Self(self.0 | 1 << item as u8)
            }

            /// Whether the set is empty.
            pub const fn is_empty(self) -> bool {
                self.0 == 0
            }

            /// The members, in the order of their declaration.
            pub fn iter(self) -> impl Iterator<Item = $item> {
                $item::ALL.into_iter().filter(move |&item| self.contains(item))
            }
        }

        impl FromIterator<$item> for $set {
            fn from_iter<I: IntoIterator<Item = $item>>(items: I) -> Self {
                items.into_iter().fold(Self(0), Self::with)
            }
        }
    };
}

pub(crate) use set;
