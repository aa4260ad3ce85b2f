//! Names of the parameters of the error model.

use core::fmt;

/// One of the 12 parameters of y = b + A f.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parameter {
    /// b_x, m/s².
    BiasX,
    /// b_y, m/s².
    BiasY,
    /// b_z, m/s².
    BiasZ,
    /// S_x.
    ScaleX,
    /// m_yx: cross-axis sensitivity, output of X per force along Y.
    MisalignmentYx,
    /// m_zx: cross-axis sensitivity, output of X per force along Z.
    MisalignmentZx,
    /// m_xy: cross-axis sensitivity, output of Y per force along X.
    MisalignmentXy,
    /// S_y.
    ScaleY,
    /// m_zy: cross-axis sensitivity, output of Y per force along Z.
    MisalignmentZy,
    /// m_xz: cross-axis sensitivity, output of Z per force along X.
    MisalignmentXz,
    /// m_yz: cross-axis sensitivity, output of Z per force along Y.
    MisalignmentYz,
    /// S_z.
    ScaleZ,
}

impl Parameter {
    /// Number of parameters.
    pub const COUNT: usize = 12;

    /// All parameters in the order of [`Covariance`](crate::Covariance): the bias, then A row by
    /// row.
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

    /// Index in [`Parameter::ALL`], 0..12.
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
pub struct Parameters(u16);

crate::set::set!(Parameters(u16) of Parameter);

impl Parameters {
    /// What gravity alone determines: bias, scale factors and the misalignments below the diagonal of A.
    pub(crate) const OF_GRAVITY: Self = {
        use Parameter::{BiasX, BiasY, BiasZ, ScaleX, ScaleY, ScaleZ};
        use Parameter::{MisalignmentXy, MisalignmentXz, MisalignmentYz};
        let scale =
            Self(0).with(BiasX).with(BiasY).with(BiasZ).with(ScaleX).with(ScaleY).with(ScaleZ);
        scale.with(MisalignmentXy).with(MisalignmentXz).with(MisalignmentYz)
    };

    /// All 12.
    pub const ALL: Self = Self((1 << Parameter::COUNT) - 1);

    /// The members that are not in `others`.
    #[must_use]
    pub fn without(self, others: Self) -> Self {
        Self(self.0 & !others.0)
    }
}
