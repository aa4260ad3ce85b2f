//! Options of the fit to the magnitude of gravity.

use core::fmt;

use crate::terms::{Slot, Slots, Terms};
use crate::{Parameter, Parameters};

/// Which parameters are fitted; the others are those of a perfect sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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
        use Parameter::{MisalignmentXy, MisalignmentXz, MisalignmentYz};
        let below = [MisalignmentXy, MisalignmentXz, MisalignmentYz];
        let all = [Parameter::BIAS, Parameter::SCALE, below];
        let all = all.into_iter().flatten();
        all.take(self.parameters()).collect()
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
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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

    pub(crate) fn slots(self) -> Slots {
        let basic = self.model.fitted();
        let terms = self
            .terms
            .iter()
            .flat_map(|term| Slot::ALL.into_iter().skip(term.first_slot()).take(3));
        basic.iter().map(Slot::of).chain(terms).collect()
    }
}
