//! Parameter sets in their wire form.

use embassy_sync::mutex::Mutex;
use heapless::Vec;
use wimu_link::LinkRole;
use wimu_link::message::{EncodedParameters, ParameterFault, Refusal, WireParameters};
use wimu_model::ParameterId;

use crate::slot::Slot;

/// Longest set, bytes.
const MAX: usize = if cfg!(feature = "correction") { WireParameters::MAX } else { 0 };

/// A parameter set in its wire form, or none.
pub(crate) struct Set(Vec<u8, MAX>);

impl Set {
    pub(crate) const NONE: Self = Self(Vec::new());

    pub(crate) fn get(&self) -> Option<EncodedParameters<'_>> {
        (!self.0.is_empty()).then_some(EncodedParameters(&self.0))
    }

    /// Stores the wire form of `set`; returns its id.
    pub(crate) fn encode(&mut self, set: &WireParameters) -> ParameterId {
        let _ = self.0.resize_default(MAX);
        let length = set.encode(&mut self.0).unwrap_or(0);
        self.0.truncate(length);
        id(self.get())
    }

    pub(crate) fn put(&mut self, set: Option<EncodedParameters>) {
        self.0.clear();
        if let Some(EncodedParameters(bytes)) = set {
            let _ = self.0.extend_from_slice(bytes);
        }
    }

    /// Copies the set that `lend` passes on. It is one copy of an array, because interrupts are disabled meanwhile,
    /// and needs no further set on the stack.
    pub(super) fn copy(&mut self, lend: impl FnOnce(&mut dyn FnMut(&Self))) {
        let _ = self.0.resize_default(MAX);
        let mut length = 0;
        lend(&mut |lent| {
            if let Some(bytes) = self.0.get_mut(..lent.0.len()) {
                bytes.copy_from_slice(&lent.0);
                length = bytes.len();
            }
        });
        self.0.truncate(length);
    }
}

/// The pieces of a parameter set that a host has sent, and then the staged set. A lock may be held across an await.
pub(crate) type Staging<M> = Mutex<M, Staged>;

/// A set that a host has sent, or its first pieces.
pub(crate) struct Staged {
    pub(crate) set: Set,
    /// The link that it comes on.
    from: Slot<LinkRole>,
    /// Length of the whole set, bytes.
    total: u16,
    /// Its id, once it has been checked.
    pub(crate) id: Option<ParameterId>,
}

impl Staged {
    pub(super) const NONE: Self = Self { set: Set::NONE, from: Slot::Empty, total: 0, id: None };

    /// Takes the piece at `offset` of a set of `total` bytes. The piece at 0 begins a set; others continue
    /// it, or repeat what has been received.
    pub(crate) fn take(
        &mut self,
        role: LinkRole,
        offset: u16,
        total: u16,
        piece: &[u8],
    ) -> Result<(), Refusal> {
        if usize::from(total) > MAX {
            let bytes = total - MAX as u16;
            return Err(Refusal::InvalidParameters(ParameterFault::Unknown { bytes }));
        }
        if offset == 0 {
            *self = Self { from: Slot::Full(role), total, ..Self::NONE };
        }
        let received = match self.is_from(role) && self.total == total {
            true => self.set.0.len(),
            false => 0,
        };
        let start = usize::from(offset);
        let end = start + piece.len();
        let repeats = self.set.0.get(start..end) == Some(piece) && end <= received;
        let continues = start == received && end <= total.into() && self.id.is_none();
        if piece.is_empty() || !(repeats || continues && self.is_from(role)) {
            let received = received as u16;
            return Err(Refusal::WrongPiece { received });
        }
        if continues {
            let _ = self.set.0.extend_from_slice(piece);
        }
        Ok(())
    }

    fn is_from(&self, role: LinkRole) -> bool {
        self.from.as_ref() == Some(&role)
    }

    /// Whether all pieces have come on a link.
    pub(crate) fn is_whole(&self, role: LinkRole) -> Result<bool, Refusal> {
        match self.is_from(role) {
            true => Ok(self.set.0.len() == self.total.into()),
            // A set from the other link has replaced it.
            false => Err(Refusal::NothingStaged),
        }
    }
}

/// The id of a set; that of the uncalibrated device without one.
pub(crate) fn id(set: Option<EncodedParameters>) -> ParameterId {
    set.map_or(ParameterId::UNCALIBRATED, EncodedParameters::id)
}

#[cfg(all(test, feature = "full"))]
mod tests {
    use super::*;

    #[test]
    fn pieces_from_another_link_are_refused_and_its_first_piece_begins_anew() {
        let (cable, wireless) = (LinkRole::Cable, LinkRole::Wireless);
        let wrong = |received| Err(Refusal::WrongPiece { received });
        let mut staged = Staged::NONE;
        assert_eq!(staged.take(cable, 0, 6, &[1, 2, 3]), Ok(()));
        // The rest of the set, and a repetition, on the other link.
        assert_eq!(staged.take(wireless, 3, 6, &[4, 5, 6]), wrong(0));
        assert_eq!(staged.is_whole(wireless), Err(Refusal::NothingStaged));
        assert_eq!(staged.take(cable, 3, 6, &[4, 5, 6]), Ok(()));
        assert_eq!(staged.is_whole(cable), Ok(true));
        assert_eq!(staged.take(wireless, 3, 6, &[4, 5, 6]), wrong(0));
        assert_eq!(staged.take(wireless, 0, 6, &[7, 8, 9]), Ok(()));
        assert_eq!(staged.take(cable, 3, 6, &[4, 5, 6]), wrong(0));
        assert_eq!(staged.is_whole(cable), Err(Refusal::NothingStaged));
        assert_eq!(staged.is_whole(wireless), Ok(false));
    }
}
