//! Start points for replaying samples.

use serde::{Deserialize, Serialize};
use wimu_integrator::State;
use wimu_model::ParameterId;

use super::bytes::Signature;
use super::{MessageError, decode_beginning};

/// Revision of the results of `wimu_model::CompiledSet` and `wimu_integrator::Integrator`, bit for bit, and of
/// their state. It changes with any change of a result.
pub const ARITHMETIC_REVISION: u8 = 3;

/// Why an epoch begins. A new reason needs a new wire version.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum EpochReason {
    /// The device has started.
    #[default]
    Start,
    /// Regular interval, at most 1 s.
    Periodic,
    /// Samples were missed.
    Gap,
    /// The integrator found a rest, or the end of one.
    Stillness,
    /// The latched temperature has moved by a step.
    Temperature,
    /// The settings have changed.
    Settings,
    /// The parameters have changed.
    Parameters,
    /// The magnetometer has updated the heading.
    Heading,
}

/// The complete state that determines the device's corrected samples, velocities and positions from a sample
/// on. A host that runs the same crates over the raw samples reproduces them bit for bit, until the next
/// epoch or a missing sample. Kept: dropped only when the link has stalled.
///
/// Each sensor has its own epochs and sequence numbers. Only sensor 0 is corrected and integrated on the device;
/// the state of others is the default.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Epoch {
    /// Why it begins.
    pub reason: EpochReason,
    /// Number of the epoch, modulo 256: a missing number is a lost epoch. An epoch for a new listener only
    /// repeats the latest number.
    pub number: u8,
    /// Sequence number of its first sample.
    pub sequence: u32,
    /// Expected device time of that sample, µs.
    pub time_us: u64,
    /// Sample period, ns.
    pub period_ns: u32,
    /// Full-scale range, ± *g*.
    pub range_g: u8,
    /// Nominal sensitivity of the sensor at that range, LSB/*g*. With parameter id 0 samples are corrected with
    /// this sensitivity only.
    pub sensitivity_lsb_per_g: f64,
    /// Positive full scale of the counts, LSB: at or beyond it an axis is saturated.
    pub full_scale: i32,
    /// The parameters in use: their id, 0 if uncalibrated.
    pub parameters: u32,
    /// Temperature that the corrector is compiled at, 0.01 °C; `None` without a thermometer.
    pub temperature_centi_c: Option<i16>,
    /// Revision of the arithmetic and of the state.
    pub revision: u8,
    /// Index of the sensor, 0..=[`MAX_SENSOR`](crate::batch::MAX_SENSOR).
    pub sensor: u8,
    /// Its gyroscope; `None` without one.
    pub gyroscope: Option<EpochGyroscope>,
    /// Room for the authentication of the samples before it: empty.
    pub tag: Signature,
    /// The integrator before that sample; of another [revision](Self::is_ours) the default.
    pub state: State,
}

/// The gyroscope of an [`Epoch`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EpochGyroscope {
    /// Nominal scale at the current range, rad/s per LSB.
    pub rad_s_per_lsb: f64,
    /// Positive full scale of the counts, LSB: at or beyond it an axis is saturated.
    pub full_scale: i32,
}

/// The fields before the state.
type Head = (
    EpochReason,
    u8,
    u32,
    u64,
    u32,
    u8,
    f64,
    i32,
    u32,
    Option<i16>,
    u8,
    u8,
    Option<EpochGyroscope>,
    Signature,
);

impl Default for Epoch {
    fn default() -> Self {
        Self::without_state((
            EpochReason::Start,
            0,
            0,
            0,
            0,
            0,
            0.0,
            0,
            0,
            None,
            ARITHMETIC_REVISION,
            0,
            None,
            Signature::NONE,
        ))
    }
}

impl Epoch {
    /// The parameters in use.
    pub fn parameter_id(&self) -> ParameterId {
        ParameterId(self.parameters)
    }

    /// Whether this crate has the arithmetic of its revision, so that samples can be replayed from it.
    pub fn is_ours(&self) -> bool {
        self.revision == ARITHMETIC_REVISION
    }

    /// One of another revision, without its state.
    pub(super) fn of_another_revision(fields: &[u8]) -> Result<Self, MessageError> {
        let epoch = Self::without_state(decode_beginning(fields)?);
        if epoch.is_ours() { Err(MessageError::Malformed) } else { Ok(epoch) }
    }

    fn without_state(head: Head) -> Self {
        let (reason, number, sequence, time_us, period_ns, range_g, lsb_per_g, full_scale, ..) =
            head;
        let (.., parameters, temperature_centi_c, revision, sensor, gyroscope, tag) = head;
        Self {
            reason,
            number,
            sequence,
            time_us,
            period_ns,
            range_g,
            sensitivity_lsb_per_g: lsb_per_g,
            full_scale,
            parameters,
            temperature_centi_c,
            revision,
            sensor,
            gyroscope,
            tag,
            state: State::default(),
        }
    }
}
