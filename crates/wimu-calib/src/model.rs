//! Options of the fit to the magnitude of gravity.

use alloc::vec::Vec;
use core::fmt;

use crate::terms::{Slot, Terms};
use crate::{Parameter, Parameters};

/// Which parameters are fitted; the others are those of a perfect sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// The bias: 3.
    Bias3,
    /// Bias and scale factors: 6.
    BiasScale6,
    /// Bias, scale factors and the three misalignments below the diagonal of A: all that gravity
    /// alone determines, because a rotation of the whole sensor is not observable.
    #[default]
    Full9,
}

impl Model {
    /// All models, the smallest first.
    pub const ALL: [Self; 3] = [Self::Bias3, Self::BiasScale6, Self::Full9];

    /// The parameters that are fitted.
    pub fn fitted(self) -> Parameters {
        use Parameter::{BiasX, BiasY, BiasZ, ScaleX, ScaleY, ScaleZ};
        use Parameter::{MisalignmentXy, MisalignmentXz, MisalignmentYz};
        const BIAS: Parameters = Parameters::NONE.with(BiasX).with(BiasY).with(BiasZ);
        const SCALE: Parameters = BIAS.with(ScaleX).with(ScaleY).with(ScaleZ);
        match self {
            Self::Bias3 => BIAS,
            Self::BiasScale6 => SCALE,
            Self::Full9 => SCALE.with(MisalignmentXy).with(MisalignmentXz).with(MisalignmentYz),
        }
    }

    /// Number of fitted parameters.
    pub fn parameters(self) -> usize {
        match self {
            Self::Bias3 => 3,
            Self::BiasScale6 => 6,
            Self::Full9 => 9,
        }
    }

    /// The next smaller model, if there is one.
    pub fn smaller(self) -> Option<Self> {
        match self {
            Self::Bias3 => None,
            Self::BiasScale6 => Some(Self::Bias3),
            Self::Full9 => Some(Self::BiasScale6),
        }
    }
}

impl fmt::Display for Model {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}-parameter model", self.parameters())
    }
}

/// Options of [`multi_position_with`](crate::multi_position_with).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MultiPosition {
    /// The parameters.
    pub model: Model,
    /// Further terms.
    pub terms: Terms,
    /// Reject outliers, listed in [`Estimate::rejected`](crate::Estimate::rejected); never more
    /// than the redundancy of the data permits.
    pub reject: bool,
}

impl MultiPosition {
    /// Number of fitted parameters, including those of the terms.
    pub fn parameters(self) -> usize {
        self.model.parameters() + self.terms.parameters()
    }

    pub(crate) fn slots(self) -> Vec<Slot> {
        let fitted = self.model.fitted();
        let is_fitted = |slot: &Slot| match slot.parameter() {
            Some(parameter) => fitted.contains(parameter),
            None => slot.term().is_some_and(|term| self.terms.contains(term)),
        };
        Slot::ALL.into_iter().filter(is_fitted).collect()
    }
}
