//! Start points for replaying samples.

use core::fmt;

use serde::de::{Error as _, SeqAccess, Visitor};
use serde::ser::SerializeTuple;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use wimu_model::ParameterId;

use super::bytes::Signature;
use super::state::WireState;

/// Why an epoch begins. Append only.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
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
    /// A number that is unknown to this version.
    Other(u32),
}

impl EpochReason {
    const KNOWN: [Self; 8] = [
        Self::Start,
        Self::Periodic,
        Self::Gap,
        Self::Stillness,
        Self::Temperature,
        Self::Settings,
        Self::Parameters,
        Self::Heading,
    ];
}

impl Serialize for EpochReason {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let index = Self::KNOWN.iter().position(|known| known == self);
        serializer.serialize_u32(match (index, self) {
            (None, Self::Other(number)) => *number,
            (index, _) => index.unwrap_or(0) as u32,
        })
    }
}

impl<'de> Deserialize<'de> for EpochReason {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let number = u32::deserialize(deserializer)?;
        let known = Self::KNOWN.get(number as usize);
        Ok(known.copied().unwrap_or(Self::Other(number)))
    }
}

/// The complete state that determines the device's corrected samples, velocities and positions from a sample
/// on. A host that runs the same crates over the raw samples reproduces them bit for bit, until the next
/// epoch or a missing sample. Kept: dropped only when the link has stalled.
///
/// Each sensor has its own epochs and sequence numbers. Only sensor 0 is corrected and integrated on the device;
/// the state of others is the default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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
    /// The integrator before that sample.
    pub state: WireState,
    /// Index of the sensor, 0..=[`MAX_SENSOR`](crate::batch::MAX_SENSOR); 0 in a state of revision 1.
    pub sensor: u8,
    /// Its gyroscope; `None` without one, and in a state of revision 1.
    pub gyroscope: Option<EpochGyroscope>,
    /// Room for the authentication of the samples before it: empty, and in a state of revision 1 always so.
    pub tag: Signature,
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

/// The fields up to the state's revision. Those that are new in revision 2, [`Added`], follow, then the state.
type Beginning = ((EpochReason, u8, u32, u64, u32, u8, f64, i32), (u32, Option<i16>, u8));
type Added = (u8, Option<EpochGyroscope>, Signature);

/// The first revision with [`Added`].
const ADDED_SINCE: u8 = 2;

impl Serialize for Epoch {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let beginning: Beginning = (
            (
                self.reason,
                self.number,
                self.sequence,
                self.time_us,
                self.period_ns,
                self.range_g,
                self.sensitivity_lsb_per_g,
                self.full_scale,
            ),
            (self.parameters, self.temperature_centi_c, self.state.revision),
        );
        let mut fields = serializer.serialize_tuple(MOST_ELEMENTS)?;
        fields.serialize_element(&beginning)?;
        if self.state.revision >= ADDED_SINCE {
            let added: Added = (self.sensor, self.gyroscope, self.tag);
            fields.serialize_element(&added)?;
        }
        self.state.write(&mut fields)?;
        fields.end()
    }
}

/// At least as many elements as any revision has; postcard does not write the number.
const MOST_ELEMENTS: usize = 8;

impl<'de> Deserialize<'de> for Epoch {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fields;

        impl<'de> Visitor<'de> for Fields {
            type Value = Epoch;

            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                out.write_str("an epoch")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut fields: A) -> Result<Epoch, A::Error> {
                let missing = || A::Error::missing_field("epoch");
                let (first, second) = fields.next_element::<Beginning>()?.ok_or_else(missing)?;
                let (reason, number, sequence, time_us, period_ns, range_g, lsb_per_g, full_scale) =
                    first;
                let (parameters, temperature_centi_c, revision) = second;
                let (sensor, gyroscope, tag) = match revision {
                    0..ADDED_SINCE => Added::default(),
                    _ => fields.next_element()?.ok_or_else(missing)?,
                };
                Ok(Epoch {
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
                    state: WireState::read(revision, &mut fields)?,
                    sensor,
                    gyroscope,
                    tag,
                })
            }
        }

        deserializer.deserialize_tuple(MOST_ELEMENTS, Fields)
    }
}

impl Epoch {
    /// The parameters in use.
    pub fn parameter_id(&self) -> ParameterId {
        ParameterId(self.parameters)
    }
}
