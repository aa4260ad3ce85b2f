//! Samples combined with the latest data of slow sensors, for display.

mod traffic;

pub use traffic::{LinkHealth, Traffic};

use std::collections::VecDeque;

use wimu_integrator::Integrator;
use wimu_link::LinkRole;
use wimu_link::batch::{MAX_BATCH, Stream};
use wimu_link::message::{Attitude, Environment, Epoch, Navigation};
use wimu_model::{DeviceTimeUs, ParameterId, SpecificForceMps2};

use crate::capture::Link;
use crate::decode::{Event, TimedSample, sequence_order};
use crate::units::{RawUnits, SampleUnit};

/// Raw samples kept for the corrected sample of the same number.
const KEPT: usize = 256;
/// Raw samples without a corrected one after which a link of unknown settings is taken to carry raw
/// samples only: two of the longest batches.
const UNDECIDED: usize = 2 * MAX_BATCH;

/// A magnetic field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Field {
    /// nT: in body axes where it is calibrated, in those of the magnetometer where it is not.
    pub nt: [f64; 3],
    /// Whether hard and soft iron are corrected.
    pub calibrated: bool,
}

/// Heading of body x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heading {
    /// Clockwise from north, rad, −π..=π: from magnetic north where it is calibrated; where not,
    /// body x pointed east at the first rest.
    pub rad: f64,
    /// Its standard deviation, rad; `None`: uncalibrated.
    pub sd_rad: Option<f64>,
}

impl Heading {
    /// The device's heading at an epoch; `None` before the first rest.
    pub fn of(epoch: &Epoch) -> Option<Self> {
        let state = epoch.state;
        let integrator = Integrator::from_state(state).ok()?;
        Some(Self {
            rad: integrator.heading_rad()?,
            sd_rad: state.heading_sd_mrad.map(|mrad| f64::from(mrad) * 1e-3),
        })
    }
}

/// All data at one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Number of the sample.
    pub sequence: u32,
    /// Its time, device clock.
    pub time: DeviceTimeUs,
    /// Raw sample, LSB, if the link carries it.
    pub raw: Option<TimedSample>,
    /// Specific force, body axes: corrected by the device, or from the counts at nominal
    /// sensitivity where [`corrected`](Self::corrected) is false.
    pub specific_force: SpecificForceMps2,
    /// Angular rate, rad/s, body axes: as the specific force; `None` without a gyroscope.
    pub angular_rate: Option<[f64; 3]>,
    /// Whether the device has corrected it. An uncalibrated device corrects with an ideal model.
    pub corrected: bool,
    /// The device's parameters; `None` before the first epoch.
    pub parameters: Option<ParameterId>,
    /// The latest magnetic field and temperature.
    pub environment: Option<Environment>,
    /// The field in it.
    pub field: Option<Field>,
    /// The device's heading; `None` before the first rest.
    pub heading: Option<Heading>,
    /// The latest velocity and position.
    pub navigation: Option<Navigation>,
    /// The latest attitude; `None` without a gyroscope, and before the first rest.
    pub attitude: Option<Attitude>,
}

/// Combines a link's events to [`Reading`]s: one for each corrected sample, or for each raw sample of
/// a link without corrected ones; raw samples of unknown range are left out.
#[derive(Debug)]
pub struct Readings {
    /// Raw samples whose corrected ones may still arrive, in order.
    raw: VecDeque<TimedSample>,
    units: RawUnits,
    /// The latest data.
    link: Link,
    field: Option<Field>,
    heading: Option<Heading>,
    /// Whether the link carries corrected samples; `None` if unknown.
    corrected_come: Option<bool>,
}

impl Default for Readings {
    fn default() -> Self {
        Self {
            raw: VecDeque::new(),
            units: RawUnits::default(),
            link: Link::new(LinkRole::Cable),
            field: None,
            heading: None,
            corrected_come: None,
        }
    }
}

impl Readings {
    /// Before any event.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes an event and calls `each` with the completed readings, in order.
    pub fn push(&mut self, event: &Event, mut each: impl FnMut(Reading)) {
        if let Event::Restart { .. } = event {
            *self = Self::new();
        }
        self.link.take_event(event);
        self.link.latest().keep_latest(KEPT);
        match event {
            Event::Environment(environment) => {
                let corrected = self.link.latest().corrected_field_nt(environment);
                let put_out = environment.magnetic_field_nt.map(|nt| nt.map(f64::from));
                self.field =
                    corrected.or(put_out).map(|nt| Field { nt, calibrated: corrected.is_some() });
            }
            Event::Epoch { epoch, .. } if epoch.sensor == 0 => {
                self.heading = Heading::of(epoch);
                self.units.see(epoch);
                self.units.forget_old();
            }
            Event::Settings(settings) => {
                // The other link's setting counts too: then raw samples need not be converted here.
                let either = settings.cable.corrected || settings.wireless.corrected;
                self.corrected_come = Some(either);
            }
            Event::Samples(samples) if samples.sensor == 0 => match samples.stream {
                Stream::Raw => {
                    self.raw.extend(samples.iter());
                    if self.raw.len() >= UNDECIDED {
                        self.corrected_come.get_or_insert(false);
                    }
                }
                Stream::Corrected => {
                    self.corrected_come = Some(true);
                    for sample in samples.iter() {
                        let raw = self.twin_of(&sample);
                        each(self.reading(&sample, raw, SampleUnit::Corrected));
                    }
                }
            },
            _ => {}
        }
        while self.corrected_come == Some(false)
            && let Some(sample) = self.raw.pop_front()
        {
            if let Some(unit) = self.units.of(sample.sequence) {
                each(self.reading(&sample, Some(sample), SampleUnit::Raw(unit)));
            }
        }
        let old = self.raw.len().saturating_sub(KEPT);
        self.raw.drain(..old);
    }

    /// Removes the raw samples up to that of a corrected one's number, and returns it.
    fn twin_of(&mut self, corrected: &TimedSample) -> Option<TimedSample> {
        let is_before =
            |raw: &TimedSample| sequence_order(raw.sequence, corrected.sequence).is_lt();
        let before = self.raw.partition_point(is_before);
        self.raw.drain(..before);
        let twin = self.raw.front()?.sequence == corrected.sequence;
        twin.then(|| self.raw.pop_front())?
    }

    fn reading(
        &mut self,
        sample: &TimedSample,
        raw: Option<TimedSample>,
        unit: SampleUnit,
    ) -> Reading {
        let boot = self.link.latest();
        Reading {
            sequence: sample.sequence,
            time: sample.time,
            raw,
            specific_force: SpecificForceMps2(unit.mps2(sample.value)),
            angular_rate: unit.rad_s(sample.rate),
            corrected: unit == SampleUnit::Corrected,
            parameters: boot.epochs().last().map(|mark| mark.epoch.parameter_id()),
            environment: boot.environment.last().copied(),
            field: self.field,
            heading: self.heading,
            navigation: boot.navigation.last().copied(),
            attitude: boot.attitude.last().copied(),
        }
    }
}
