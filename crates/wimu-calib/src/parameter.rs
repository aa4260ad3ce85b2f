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

/// Some of the 12 parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Parameters(u16);

impl Parameters {
    /// Whether `parameter` is one of them.
    pub fn contains(self, parameter: Parameter) -> bool {
        self.0 >> parameter.index() & 1 == 1
    }

    /// Whether there is none.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Those that are not in `others`.
    #[must_use]
    pub fn without(self, others: Self) -> Self {
        Self(self.0 & !others.0)
    }

    /// All 12.
    pub const ALL: Self = Self((1 << Parameter::COUNT) - 1);

    /// Those of them that are in the set, in the order of [`Parameter::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Parameter> {
        Parameter::ALL
            .into_iter()
            .filter(move |&parameter| self.contains(parameter))
    }
}

impl FromIterator<Parameter> for Parameters {
    fn from_iter<I: IntoIterator<Item = Parameter>>(parameters: I) -> Self {
        Self(
            parameters
                .into_iter()
                .fold(0, |bits, parameter| bits | 1 << parameter.index()),
        )
    }
}

impl fmt::Display for Parameters {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, parameter) in self.iter().enumerate() {
            if place > 0 {
                out.write_str(", ")?;
            }
            parameter.fmt(out)?;
        }
        Ok(())
    }
}
