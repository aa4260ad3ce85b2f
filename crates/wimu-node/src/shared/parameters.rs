//! Parameter sets in their wire form.

use embassy_sync::mutex::Mutex;
use heapless::Vec;
use wimu_link::LinkRole;
use wimu_link::message::{ActiveParameters, EncodedParameters, WireParameters};
use wimu_model::ParameterId;

use crate::slot::Slot;

/// A parameter set in its wire form, or none.
pub(crate) struct Set(Vec<u8, { WireParameters::MAX }>);

impl Set {
    pub(super) const NONE: Self = Self(Vec::new());

    pub(crate) fn get(&self) -> Option<EncodedParameters<'_>> {
        (!self.0.is_empty()).then_some(EncodedParameters(&self.0))
    }

    /// Stores the wire form of `set`; returns its id.
    pub(crate) fn encode(&mut self, set: &WireParameters) -> ParameterId {
        let _ = self.0.resize_default(WireParameters::MAX);
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

    /// A copy, as fast as one of an array: it is made with interrupts disabled.
    pub(super) fn copy(&self) -> Self {
        Self(Vec::from_slice(&self.0).unwrap_or_default())
    }
}

/// The parameter set that a host has sent, and then the staged one. A lock may be held across an await.
pub(crate) type Staging<M> = Mutex<M, Staged>;

/// A set that a host has sent.
pub(crate) struct Staged {
    pub(crate) set: Set,
    /// The link that it came on, until its request is answered.
    pub(crate) from: Slot<LinkRole>,
    /// Its id, once it has been checked.
    pub(crate) id: Option<ParameterId>,
}

/// The id of a set; that of the uncalibrated device without one.
pub(crate) fn id(set: Option<EncodedParameters>) -> ParameterId {
    set.map_or(ParameterId::UNCALIBRATED, EncodedParameters::id)
}

/// The message that reports the parameters in use.
pub(crate) fn active_parameters(set: &Set) -> ActiveParameters<EncodedParameters<'_>> {
    let active = set.get();
    ActiveParameters {
        active,
        id: id(active).0,
    }
}
