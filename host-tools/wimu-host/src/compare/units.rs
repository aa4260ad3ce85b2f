//! Units of a stream's values.

use std::collections::BTreeMap;

use wimu_model::SpecificForceQ16;

use crate::units::RawUnits;
use crate::walk::Start;

/// Units of a stream's values in each start, from the epochs of both links together.
pub(super) enum Units {
    Raw(BTreeMap<Start, RawUnits>),
    Corrected,
}

/// Unit of a value.
#[derive(Clone, Copy)]
pub(super) struct Unit {
    pub mps2_per_lsb: f64,
    /// Values at or beyond ± this are saturated, LSB.
    pub full_scale: u32,
}

impl Unit {
    pub fn is_saturated(&self, value: [i32; 3]) -> bool {
        value.iter().any(|v| v.unsigned_abs() >= self.full_scale)
    }

    pub fn mps2(&self, value: [i32; 3]) -> [f64; 3] {
        value.map(|v| f64::from(v) * self.mps2_per_lsb)
    }
}

impl Units {
    /// The unit of the sample of this number; `None` if unknown.
    pub fn of(&self, start: Start, sequence: u32) -> Option<Unit> {
        Some(match self {
            Self::Raw(starts) => {
                let unit = starts.get(&start)?.of(sequence)?;
                Unit {
                    mps2_per_lsb: unit.mps2_per_lsb(),
                    full_scale: unit.full_scale,
                }
            }
            Self::Corrected => Unit {
                mps2_per_lsb: 1.0 / SpecificForceQ16::LSB_PER_MPS2,
                full_scale: u32::MAX,
            },
        })
    }
}
