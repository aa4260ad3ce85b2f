//! Reasons why a recording does not support a fit of an array.

use core::fmt;

/// Why an array cannot be fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ArrayRefusal {
    /// The workspace is too short.
    Workspace {
        /// Numbers that it must have, see [`workspace_len`](super::workspace_len).
        need: usize,
    },
    /// Prior, times or period are not positive and finite.
    BadInput,
    /// The axes do not determine angular acceleration and specific force.
    Geometry,
    /// There is neither a rest nor a sample in motion.
    NoData,
    /// The iteration left the numbers that are finite.
    NotFinite,
}

impl fmt::Display for ArrayRefusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Workspace { need } => write!(out, "the workspace has to hold {need} numbers"),
            Self::BadInput => out.write_str("prior deviations, sample period and times have to be positive and finite"),
            Self::Geometry => out.write_str(
                "the axes do not determine angular acceleration and specific force: mount the sensors apart, not on a line",
            ),
            Self::NoData => out.write_str("there is neither a rest nor a sample in motion: record both"),
            Self::NotFinite => out.write_str("the fit does not converge: check outputs, sensitivity and geometry"),
        }
    }
}

impl core::error::Error for ArrayRefusal {}
