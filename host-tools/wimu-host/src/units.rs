//! Unit of raw samples. The range may change during a recording: the unit is that of the epoch which covers
//! the sample's number, not of the latest one.

use wimu_link::message::{Epoch, EpochGyroscope, EpochReason};
use wimu_model::{AngularRateQ20, STANDARD_GRAVITY_MPS2, Sensitivity, SpecificForceQ16};

use crate::decode::sequence_order;

/// Longest interval between epochs, ns of samples.
const EPOCH_WITHIN_NS: u64 = 1_000_000_000;

/// Unit of the counts of a raw sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawUnit {
    /// Nominal sensitivity.
    pub sensitivity: Sensitivity,
    /// Values at or beyond ± this are saturated, LSB.
    pub full_scale: u32,
    /// The gyroscope's; `None` without one.
    pub gyroscope: Option<EpochGyroscope>,
}

impl RawUnit {
    /// That of an epoch; `None` if its sensitivity is invalid.
    pub fn of(epoch: &Epoch) -> Option<Self> {
        Some(Self {
            sensitivity: Sensitivity::from_lsb_per_g(epoch.sensitivity_lsb_per_g).ok()?,
            full_scale: epoch.full_scale.unsigned_abs(),
            gyroscope: epoch.gyroscope,
        })
    }

    /// m/s² of one LSB.
    pub fn mps2_per_lsb(&self) -> f64 {
        STANDARD_GRAVITY_MPS2 / self.sensitivity.lsb_per_g()
    }

    /// A value in m/s².
    pub fn mps2(&self, value: [i32; 3]) -> [f64; 3] {
        value.map(|v| f64::from(v) * self.mps2_per_lsb())
    }

    /// An angular rate in rad/s; `None` without a gyroscope.
    pub fn rad_s(&self, rate: Option<[i32; 3]>) -> Option<[f64; 3]> {
        let rad_s_per_lsb = self.gyroscope?.rad_s_per_lsb;
        Some(rate?.map(|lsb| f64::from(lsb) * rad_s_per_lsb))
    }

    /// The full-scale range of the gyroscope, rad/s; `None` without one.
    pub fn range_rad_s(&self) -> Option<f64> {
        let gyroscope = self.gyroscope?;
        Some(f64::from(gyroscope.full_scale) * gyroscope.rad_s_per_lsb)
    }

    /// The full-scale range, m/s².
    pub fn range_mps2(&self) -> f64 {
        f64::from(self.full_scale) * self.mps2_per_lsb()
    }
}

/// Unit of the values of a sample of either stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SampleUnit {
    /// Counts, LSB.
    Raw(RawUnit),
    /// Corrected by the device: 2⁻¹⁶ m/s² and 2⁻²⁰ rad/s.
    Corrected,
}

impl SampleUnit {
    /// m/s² of one LSB.
    pub fn mps2_per_lsb(&self) -> f64 {
        match self {
            Self::Raw(unit) => unit.mps2_per_lsb(),
            Self::Corrected => 1.0 / SpecificForceQ16::LSB_PER_MPS2,
        }
    }

    /// A value in m/s².
    pub fn mps2(&self, value: [i32; 3]) -> [f64; 3] {
        value.map(|v| f64::from(v) * self.mps2_per_lsb())
    }

    /// An angular rate in rad/s; `None` without a gyroscope.
    pub fn rad_s(&self, rate: Option<[i32; 3]>) -> Option<[f64; 3]> {
        match self {
            Self::Raw(unit) => unit.rad_s(rate),
            Self::Corrected => rate.map(|rate| AngularRateQ20(rate).to_rad_s()),
        }
    }

    /// Whether an axis is at the full scale of the sensor.
    pub fn is_saturated(&self, value: [i32; 3]) -> bool {
        match self {
            Self::Raw(unit) => value.iter().any(|v| v.unsigned_abs() >= unit.full_scale),
            Self::Corrected => false,
        }
    }
}

/// The units of a device's raw samples within one start, by their sequence numbers.
///
/// Epochs may arrive in any order, more than once, and on both links. Where an epoch is missing that may
/// have changed the range, the unit is unknown from the last epoch of the old range to
/// the first of the new one; where three or more in a row are missing, even between two of the
/// same range. Within a second before the first epoch and after the last, no epoch need be missing,
/// and their unit applies. Memory grows only with the number of changes and losses.
#[derive(Clone, Debug, Default)]
pub struct RawUnits {
    /// By sequence number, without overlap.
    runs: Vec<Run>,
}

/// Epochs of one unit without a change between them.
#[derive(Clone, Copy, Debug)]
struct Run {
    unit: RawUnit,
    first: Mark,
    last: Mark,
}

/// The properties of an epoch by which missing ones are detected.
#[derive(Clone, Copy, Debug)]
struct Mark {
    sequence: u32,
    number: u8,
    reason: EpochReason,
    /// Largest number of samples until the next one.
    most: u32,
}

impl Mark {
    fn of(epoch: &Epoch) -> Self {
        let most = EPOCH_WITHIN_NS / u64::from(epoch.period_ns.max(1)) + 1;
        Self {
            sequence: epoch.sequence,
            number: epoch.number,
            reason: epoch.reason,
            most: u32::try_from(most).unwrap_or(u32::MAX),
        }
    }

    /// Number of epochs from this one to `next`; `None` if the epoch number may have wrapped.
    fn steps_to(&self, next: &Self) -> Option<u8> {
        let steps = next.number.wrapping_sub(self.number);
        let apart = u32::try_from(next.sequence.wrapping_sub(self.sequence) as i32).ok()?;
        // The last step may be an epoch repeated for a new listener.
        let most = u64::from(self.most.max(next.most)) * (u64::from(steps) + 1);
        (u64::from(apart) <= most).then_some(steps)
    }

    /// Whether the range can have changed with this epoch.
    fn may_change_range(&self) -> bool {
        match self.reason {
            EpochReason::Periodic
            | EpochReason::Stillness
            | EpochReason::Temperature
            | EpochReason::Heading
            | EpochReason::Gap => false,
            EpochReason::Start | EpochReason::Settings | EpochReason::Parameters => true,
        }
    }

    /// Whether all samples up to `next`, which has the same range, have that range: a change and its reversal are two
    /// epochs.
    fn holds_until(&self, next: &Self) -> bool {
        match self.steps_to(next) {
            Some(0 | 1) => true,
            Some(2) => !next.may_change_range(),
            _ => false,
        }
    }

    /// Whether the range of this epoch holds until `next`, which has another one.
    fn ends_with(&self, next: &Self) -> bool {
        // An epoch repeated for a new listener is later than the change: it is periodic.
        self.steps_to(next) == Some(1) && next.may_change_range()
    }
}

impl RawUnits {
    /// Takes an epoch.
    pub fn see(&mut self, epoch: &Epoch) {
        let Some(unit) = RawUnit::of(epoch) else {
            return;
        };
        let mark = Mark::of(epoch);
        let mut run = Run { unit, first: mark, last: mark };
        let mut at = self
            .runs
            .partition_point(|run| sequence_order(run.first.sequence, mark.sequence).is_le());
        if let Some(before) = at.checked_sub(1).and_then(|index| self.runs.get(index)) {
            if sequence_order(mark.sequence, before.last.sequence).is_le() {
                return;
            }
            if before.unit == unit && before.last.holds_until(&mark) {
                run.first = before.first;
                at -= 1;
                self.runs.remove(at);
            }
        }
        if let Some(after) = self.runs.get(at)
            && after.unit == unit
            && mark.holds_until(&after.first)
        {
            run.last = after.last;
            self.runs.remove(at);
        }
        self.runs.insert(at, run);
    }

    /// The latest unit.
    pub fn latest(&self) -> Option<RawUnit> {
        self.runs.last().map(|run| run.unit)
    }

    /// Keeps the latest four runs only: for endless data of which only the newest samples are used.
    pub fn forget_old(&mut self) {
        let old = self.runs.len().saturating_sub(4);
        self.runs.drain(..old);
    }

    /// The unit of the raw sample of this number; `None` if unknown.
    pub fn of(&self, sequence: u32) -> Option<RawUnit> {
        let at =
            self.runs.partition_point(|run| sequence_order(run.first.sequence, sequence).is_le());
        let after = self.runs.get(at);
        let Some(run) = at.checked_sub(1).and_then(|index| self.runs.get(index)) else {
            // Sent before reception began: no epoch need be missing.
            return after
                .filter(|after| !after.first.may_change_range())
                .filter(|after| after.first.sequence.wrapping_sub(sequence) <= after.first.most)
                .map(|after| after.unit);
        };
        let known = match after {
            _ if sequence_order(sequence, run.last.sequence).is_le() => true,
            Some(after) if after.unit == run.unit => run.last.holds_until(&after.first),
            Some(after) => run.last.ends_with(&after.first),
            None => sequence.wrapping_sub(run.last.sequence) < run.last.most,
        };
        known.then_some(run.unit)
    }
}
