//! Faults of a sensor during intervals of time.

use std::str::FromStr;
use std::time::Duration;

use super::Outage;
use super::spec::outage;
use crate::part::SensorPart;
use crate::sensor::{GyroscopeFault, Sensor};

/// A sensor's fault and when it is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorFault {
    kind: Kind,
    outage: Outage,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Absent,
    /// WHO_AM_I of another chip; a driver reads it when it starts the sensor.
    Identity,
    Gyroscope(GyroscopeFault),
}

/// WHO_AM_I of no sensor that a driver here knows.
const ANOTHER_CHIP: u8 = 0x5A;

const KINDS: [(&str, Kind); 5] = [
    ("absent", Kind::Absent),
    ("identity", Kind::Identity),
    ("gyroscope-stops", Kind::Gyroscope(GyroscopeFault::Stops)),
    ("gyroscope-stuck", Kind::Gyroscope(GyroscopeFault::Stuck)),
    ("gyroscope-saturates", Kind::Gyroscope(GyroscopeFault::Saturates)),
];

/// Why a text is not a sensor's fault.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}`: expected {list}, with its duration and start, such as gyroscope-stops=3s@30s", list = KINDS.map(|(name, _)| name).join(", "))]
pub struct SensorFaultError(String);

impl FromStr for SensorFault {
    type Err = SensorFaultError;

    fn from_str(text: &str) -> Result<Self, SensorFaultError> {
        let read = || {
            let (name, when) = text.split_once('=')?;
            let (_, kind) = KINDS.into_iter().find(|(known, _)| *known == name)?;
            let outage = outage(when)?;
            Some(Self { kind, outage })
        };
        read().ok_or_else(|| SensorFaultError(text.to_owned()))
    }
}

impl SensorFault {
    /// Breaks or repairs `sensor`, which is a `part`, if the fault begins or ends between the times `before`
    /// (`None` at the start) and `now`, µs.
    pub fn apply(&self, part: SensorPart, sensor: &Sensor, before: Option<u64>, now: u64) {
        let is_broken = self.is_at(now);
        if before.is_some_and(|before| self.is_at(before)) == is_broken {
            return;
        }
        match (self.kind, is_broken) {
            (Kind::Absent, _) => sensor.set_present(!is_broken),
            (Kind::Identity, true) => sensor.set_who_am_i(ANOTHER_CHIP),
            (Kind::Identity, false) => sensor.set_who_am_i(part.who_am_i()),
            (Kind::Gyroscope(fault), true) => sensor.set_gyroscope_fault(fault),
            (Kind::Gyroscope(_), false) => sensor.set_gyroscope_fault(GyroscopeFault::None),
        }
    }

    fn is_at(&self, time_us: u64) -> bool {
        let Some(since) = Duration::from_micros(time_us).checked_sub(self.outage.start) else {
            return false;
        };
        let in_period = match self.outage.every {
            Some(every) => since.as_nanos() % every.as_nanos(),
            None => since.as_nanos(),
        };
        in_period < self.outage.length.as_nanos()
    }
}
