//! Samples and slow sensors put together: what a person looks at.

use std::collections::BTreeMap;

use wimu_integrator::{Integrator, State};
use wimu_link::batch::Stream;
use wimu_link::message::{Environment, Epoch, Navigation};
use wimu_model::{Counts, DeviceTimeUs, ParameterId, SpecificForceMps2, SpecificForceQ16};

use crate::decode::Event;
use crate::history::Boot;
use crate::units::RawUnits;

/// Samples kept while their corrected twin may still come.
const KEPT: usize = 256;

/// A magnetic field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Field {
    /// nT: in body axes where it is calibrated, in those of the magnetometer where it is not.
    pub nt: [f64; 3],
    /// Whether hard and soft iron are out of it.
    pub calibrated: bool,
}

/// Where body x points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heading {
    /// Clockwise from north, rad, −π..=π: from magnetic north where it is calibrated; where not,
    /// body x pointed east at the first rest.
    pub rad: f64,
    /// Its standard deviation, rad; `None`: uncalibrated.
    pub sd_rad: Option<f64>,
}

impl Heading {
    /// As the device held it at an epoch; `None` before the first rest.
    pub fn of(epoch: &Epoch) -> Option<Self> {
        let state = State::from(epoch.state);
        let integrator = Integrator::from_state(state).ok()?;
        Some(Self {
            rad: integrator.heading_rad()?,
            sd_rad: state.heading_sd_mrad.map(|mrad| f64::from(mrad) * 1e-3),
        })
    }
}

/// Everything known at one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Number of the sample.
    pub sequence: u32,
    /// When it was taken, device clock.
    pub time: DeviceTimeUs,
    /// As the sensor put it out, if the link carries that.
    pub raw: Option<Counts>,
    /// Specific force, body axes: corrected by the device, or from the counts at nominal
    /// sensitivity where [`corrected`](Self::corrected) is false.
    pub specific_force: SpecificForceMps2,
    /// Whether the device has corrected it. An uncalibrated device corrects with a perfect model.
    pub corrected: bool,
    /// The parameters that the device corrects with, if an epoch has told.
    pub parameters: Option<ParameterId>,
    /// The latest magnetic field and temperature, if any came.
    pub environment: Option<Environment>,
    /// The field in it.
    pub field: Option<Field>,
    /// The heading that the device holds, if it has been at rest.
    pub heading: Option<Heading>,
    /// The latest velocity and position, if any came.
    pub navigation: Option<Navigation>,
}

/// Makes [`Reading`]s of a link's events: one for each corrected sample, or for each raw sample of
/// a link that carries no corrected ones, but for those whose range no epoch has told yet.
#[derive(Debug, Default)]
pub struct Readings {
    raw: BTreeMap<u32, [i32; 3]>,
    units: RawUnits,
    parameters: Option<ParameterId>,
    /// Epoch and parameters.
    known: Boot,
    environment: Option<Environment>,
    field: Option<Field>,
    heading: Option<Heading>,
    navigation: Option<Navigation>,
    corrected_come: bool,
}

impl Readings {
    /// None so far.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes an event and calls `each` with the readings that it completes, in order.
    pub fn push(&mut self, event: &Event, mut each: impl FnMut(Reading)) {
        self.known.take_parameters(event);
        match event {
            Event::Environment(environment) => {
                self.environment = Some(*environment);
                let corrected = self.known.corrected_field_nt(environment);
                let put_out = environment.magnetic_field_nt.map(|nt| nt.map(f64::from));
                self.field = corrected.or(put_out).map(|nt| Field {
                    nt,
                    calibrated: corrected.is_some(),
                });
            }
            Event::Navigation(navigation) => self.navigation = Some(*navigation),
            Event::Epoch { epoch, .. } => {
                self.parameters = Some(epoch.parameter_id());
                self.heading = Heading::of(epoch);
                self.units.see(epoch);
                self.units.forget_old();
            }
            Event::Settings(settings) => {
                // Either link's choice: where both carry corrected samples, none is made twice.
                self.corrected_come = settings.cable.corrected || settings.wireless.corrected;
            }
            Event::Restart { .. } => *self = Self::new(),
            Event::Samples(samples) => match samples.stream {
                Stream::Raw => {
                    for sample in samples.iter() {
                        if self.corrected_come {
                            self.raw.insert(sample.sequence, sample.value);
                        } else if let Some(unit) = self.units.of(sample.sequence) {
                            let counts = Counts(sample.value.map(|v| v as i16));
                            each(Reading {
                                sequence: sample.sequence,
                                time: sample.time,
                                raw: Some(counts),
                                specific_force: unit.sensitivity.to_mps2(counts),
                                corrected: false,
                                parameters: self.parameters,
                                environment: self.environment,
                                field: self.field,
                                heading: self.heading,
                                navigation: self.navigation,
                            });
                        }
                    }
                    while self.raw.len() > KEPT {
                        self.raw.pop_first();
                    }
                }
                Stream::Corrected => {
                    self.corrected_come = true;
                    for sample in samples.iter() {
                        let raw = self.raw.remove(&sample.sequence);
                        each(Reading {
                            sequence: sample.sequence,
                            time: sample.time,
                            raw: raw.map(|value| Counts(value.map(|v| v as i16))),
                            specific_force: SpecificForceQ16(sample.value).to_mps2(),
                            corrected: true,
                            parameters: self.parameters,
                            environment: self.environment,
                            field: self.field,
                            heading: self.heading,
                            navigation: self.navigation,
                        });
                    }
                }
            },
            _ => {}
        }
    }
}
