//! The parameters of the error model by name.

use core::fmt;

/// One of the 12 parameters of y = b + A f.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Parameter {
    /// b_x, m/s².
    BiasX,
    /// b_y, m/s².
    BiasY,
    /// b_z, m/s².
    BiasZ,
    /// S_x.
    ScaleX,
    /// m_yx: what Y adds to the output of X.
    MisalignmentYx,
    /// m_zx: what Z adds to the output of X.
    MisalignmentZx,
    /// m_xy: what X adds to the output of Y.
    MisalignmentXy,
    /// S_y.
    ScaleY,
    /// m_zy: what Z adds to the output of Y.
    MisalignmentZy,
    /// m_xz: what X adds to the output of Z.
    MisalignmentXz,
    /// m_yz: what Y adds to the output of Z.
    MisalignmentYz,
    /// S_z.
    ScaleZ,
}

impl Parameter {
    /// How many there are.
    pub const COUNT: usize = 12;

    /// All of them in the order of [`Covariance`](crate::Covariance): the bias, then A row by row.
    pub const ALL: [Self; Self::COUNT] = [
        Self::BiasX,
        Self::BiasY,
        Self::BiasZ,
        Self::ScaleX,
        Self::MisalignmentYx,
        Self::MisalignmentZx,
        Self::MisalignmentXy,
        Self::ScaleY,
        Self::MisalignmentZy,
        Self::MisalignmentXz,
        Self::MisalignmentYz,
        Self::ScaleZ,
    ];

    pub(crate) const BIAS: [Self; 3] = [Self::BiasX, Self::BiasY, Self::BiasZ];
    pub(crate) const SCALE: [Self; 3] = [Self::ScaleX, Self::ScaleY, Self::ScaleZ];

    /// Its place in [`Parameter::ALL`], 0..12.
    pub const fn index(self) -> usize {
        self as usize
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::BiasX => "bias X",
            Self::BiasY => "bias Y",
            Self::BiasZ => "bias Z",
            Self::ScaleX => "scale factor X",
            Self::ScaleY => "scale factor Y",
            Self::ScaleZ => "scale factor Z",
            Self::MisalignmentYx => "misalignment m_yx",
            Self::MisalignmentZx => "misalignment m_zx",
            Self::MisalignmentXy => "misalignment m_xy",
            Self::MisalignmentZy => "misalignment m_zy",
            Self::MisalignmentXz => "misalignment m_xz",
            Self::MisalignmentYz => "misalignment m_yz",
        })
    }
}

/// A set of the 12 parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Parameters(u16);

crate::set::set!(Parameters(u16) of Parameter);

impl Parameters {
    /// All 12.
    pub const ALL: Self = Self((1 << Parameter::COUNT) - 1);

    /// The members that are not in `others`.
    #[must_use]
    pub fn without(self, others: Self) -> Self {
        Self(self.0 & !others.0)
    }
}
