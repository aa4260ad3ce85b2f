//! Decoded data of a board, from a recording or from live links: one structure, by link, start, sensor and stream.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;

use wimu_link::batch::Stream;
use wimu_link::hello::sensor;
use wimu_link::message::{
    Answer, Attitude, Environment, Epoch, Event as DeviceEvent, Navigation, Payload, Status,
};
use wimu_link::{Hello, LinkRole, Settings};
use wimu_model::{
    CompiledSet, DeviceTimeUs, MagneticFieldNt, ParameterId, ParameterSet, Sensitivity, SensorId,
};

use crate::authentication::Authentication;
use crate::calibration::source::ActiveParameters;
use crate::clock::{ClockEstimator, ClockModel};
use crate::decode::{Arrival, Event, LinkStatistics, Samples, TimedSample, sequence_order};
use crate::walk::Start;
use crate::{Code, Problem, Result};

mod read;

pub use read::{Capture, StartData};

/// Largest number of parameter changes, settings changes and events kept of a start, each.
const MAX_KEPT: usize = 4096;
/// Largest number of changes of the parameters that are listed of a link.
const MAX_IDS: usize = 500;

/// An epoch as it arrived.
#[derive(Clone, Debug)]
pub struct EpochMark {
    /// As sent.
    pub epoch: Epoch,
    /// Whether epochs before it were lost.
    pub after_loss: bool,
}

/// Numbers of what arrived in a start, kept or not.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Samples by sensor and stream, without late ones.
    pub samples: BTreeMap<(u8, Stream), usize>,
    /// Samples with an angular rate, by sensor.
    pub rates: BTreeMap<u8, usize>,
    /// Epochs of sensor 0.
    pub epochs: usize,
    /// Velocities and positions.
    pub navigation: usize,
    /// Attitudes.
    pub attitudes: usize,
}

impl Counts {
    /// Samples of a stream of a sensor.
    pub fn of(&self, sensor: u8, stream: Stream) -> usize {
        self.samples.get(&(sensor, stream)).copied().unwrap_or_default()
    }

    /// Samples of a sensor with an angular rate.
    pub fn rates_of(&self, sensor: u8) -> usize {
        self.rates.get(&sensor).copied().unwrap_or_default()
    }
}

/// Data of one link in one start of the device.
#[derive(Clone, Debug, Default)]
pub struct Boot {
    /// The start, common to both links of a recording; `None` for a live board.
    pub start: Option<Start>,
    /// Numbers of all that arrived.
    pub counts: Counts,
    /// Latest identification.
    pub hello: Option<Hello>,
    /// Samples by sensor and stream, by sequence number: LSB if raw, 2⁻¹⁶ m/s² and 2⁻²⁰ rad/s if corrected.
    pub samples: BTreeMap<(u8, Stream), Vec<TimedSample>>,
    /// Epochs by sensor, by sequence number; they define the unit of the sensor's raw samples.
    pub marks: BTreeMap<u8, Vec<EpochMark>>,
    /// Magnetic field and temperature, by time.
    pub environment: Vec<Environment>,
    /// Velocity and position, by sequence number of sensor 0.
    pub navigation: Vec<Navigation>,
    /// Attitude, by sequence number of sensor 0.
    pub attitude: Vec<Attitude>,
    /// Parameters in use, as reported: the latest 4096 changes.
    pub parameters: Vec<ActiveParameters>,
    /// Settings in use, as reported: the latest 4096 changes.
    pub settings: Vec<Settings>,
    /// Latest status.
    pub status: Option<Status>,
    /// Events, each once: the latest 4096.
    pub events: Vec<(DeviceTimeUs, DeviceEvent)>,
    /// Estimator of the device's clock.
    pub clock: ClockEstimator,
    /// Its model at the end of the data, once it is used: the estimate takes seconds.
    model: OnceLock<Option<ClockModel>>,
    ended: bool,
}

impl Boot {
    /// The samples of a sensor in a stream, by sequence number.
    pub fn of(&self, sensor: u8, stream: Stream) -> &[TimedSample] {
        self.samples.get(&(sensor, stream)).map_or(&[], Vec::as_slice)
    }

    /// The raw samples of sensor 0.
    pub fn raw(&self) -> &[TimedSample] {
        self.of(0, Stream::Raw)
    }

    /// The corrected samples, which are of sensor 0.
    pub fn corrected(&self) -> &[TimedSample] {
        self.of(0, Stream::Corrected)
    }

    /// The epochs of a sensor, by sequence number.
    pub fn epochs_of(&self, sensor: u8) -> &[EpochMark] {
        self.marks.get(&sensor).map_or(&[], Vec::as_slice)
    }

    /// The epochs of sensor 0.
    pub fn epochs(&self) -> &[EpochMark] {
        self.epochs_of(0)
    }

    /// Host time of a device time, ns, after the end of the data; `None` without a model.
    /// See [`ClockModel::host_ns`].
    pub fn host_ns(&self, time: DeviceTimeUs) -> Option<u64> {
        self.model().map(|model| model.host_ns(time))
    }

    fn model(&self) -> Option<&ClockModel> {
        let model = || self.model.get_or_init(|| self.clock.model()).as_ref();
        self.ended.then(model)?
    }

    /// Device time of a sample of sensor 0, if it arrived raw or corrected.
    pub fn time_of(&self, sequence: u32) -> Option<DeviceTimeUs> {
        [self.raw(), self.corrected()].into_iter().find_map(|samples| {
            let found =
                samples.binary_search_by(|sample| sequence_order(sample.sequence, sequence));
            found.ok().map(|index| samples[index].time)
        })
    }

    /// The parameters of an epoch: those sent with its id, or for id 0 those of an
    /// uncalibrated device.
    ///
    /// # Errors
    /// `bad_recording` when they were not sent or are invalid.
    pub fn parameters_of(&self, epoch: &Epoch) -> Result<ParameterSet> {
        let bad = |message: String| {
            Code::BadRecording.error(
                message,
                "record from the connection on: the device then sends its parameters",
            )
        };
        if epoch.parameters == 0 {
            return Sensitivity::from_lsb_per_g(epoch.sensitivity_lsb_per_g)
                .map(|sensitivity| ParameterSet::uncalibrated(epoch.range_g, sensitivity))
                .map_err(|error| bad(error.to_string()));
        }
        let sensitivity = Sensitivity::from_lsb_per_g(epoch.sensitivity_lsb_per_g).ok();
        let calibration = self.reported(epoch)?.calibration(sensitivity);
        let calibration = calibration.map_err(|error| bad(error.to_string()))?;
        calibration.ok_or_else(|| bad("the parameters are missing".to_owned()))
    }

    /// The compiled set of an epoch, with which the device corrects; `None` of an uncalibrated one.
    ///
    /// # Errors
    /// `bad_recording` when it was not sent.
    pub fn set_of(&self, epoch: &Epoch) -> Result<Option<CompiledSet>> {
        match epoch.parameters {
            0 => Ok(None),
            _ => Ok(self.reported(epoch)?.active),
        }
    }

    /// A note where the source of parameters that its epochs name is not known here.
    pub fn unknown_source(&self) -> Option<Problem> {
        let is_used = |set: &ActiveParameters| {
            self.epochs().iter().any(|mark| mark.epoch.parameters == set.id)
        };
        self.parameters.iter().filter(|set| is_used(set)).find_map(ActiveParameters::unknown_source)
    }

    fn reported(&self, epoch: &Epoch) -> Result<&ActiveParameters> {
        let mut reports = self.parameters.iter();
        let report =
            reports.find(|report| report.id == epoch.parameters && report.active.is_some());
        report.ok_or_else(|| {
            Code::BadRecording.error(
                format!("the recording lacks the parameters {:08x}", epoch.parameters),
                "record from the connection on: the device then sends its parameters",
            )
        })
    }

    /// The magnetic field, nT, body axes, corrected by the parameters then in use; `None` where
    /// they are unknown or have no magnetometer.
    pub fn corrected_field_nt(&self, environment: &Environment) -> Option<[f64; 3]> {
        let output = MagneticFieldNt(environment.magnetic_field_nt?);
        let epochs = self.epochs();
        let after = epochs.partition_point(|mark| mark.epoch.time_us <= environment.time_us);
        let mark = epochs.get(after.saturating_sub(1))?;
        let set = self.parameters_of(&mark.epoch).ok()?;
        set.correct_field(output)
    }

    /// Nominal sensitivity of a sensor from its epochs; `None` if the device does not know it.
    pub fn nominal_sensitivity(&self, sensor: u8) -> Option<Sensitivity> {
        let known = self.hello.is_none_or(|hello| hello.sensitivity_known);
        let epoch = &self.epochs_of(sensor).first()?.epoch;
        Sensitivity::from_lsb_per_g(epoch.sensitivity_lsb_per_g).ok().filter(|_| known)
    }

    /// The accelerometer, if the device has identified it.
    pub fn sensor(&self) -> Option<SensorId> {
        let number = self.hello?.sensor.number;
        sensor::is_one_model(number).then_some(SensorId(number))
    }

    /// Drops what came before the latest `count` of each kind.
    pub(crate) fn keep_latest(&mut self, count: usize) {
        fn keep<T>(all: &mut Vec<T>, count: usize) {
            // In few steps: each moves what is kept.
            if all.len() > 2 * count {
                all.drain(..all.len() - count);
            }
        }
        self.samples.values_mut().for_each(|samples| keep(samples, count));
        self.marks.values_mut().for_each(|marks| keep(marks, count));
        keep(&mut self.environment, count);
        keep(&mut self.attitude, count);
        keep(&mut self.navigation, count);
    }

    fn is_empty(&self) -> bool {
        self.hello.is_none() && self.samples.is_empty() && self.marks.is_empty()
    }

    /// Adds an event of this start.
    fn take(&mut self, event: &Event) {
        match event {
            Event::Hello(hello) => self.hello = Some(*hello),
            Event::Samples(samples) => {
                let key = (samples.sensor, samples.stream);
                *self.counts.samples.entry(key).or_default() += samples.values.len();
                *self.counts.rates.entry(samples.sensor).or_default() += samples.rates.len();
                self.samples.entry(key).or_default().extend(samples.iter());
            }
            Event::Late(late) => {
                insert_late(self.samples.entry((late.sensor, late.stream)).or_default(), late);
            }
            Event::Epoch { epoch, after_loss } => {
                self.counts.epochs += usize::from(epoch.sensor == 0);
                let mark = EpochMark { epoch: *epoch, after_loss: *after_loss };
                self.marks.entry(epoch.sensor).or_default().push(mark);
            }
            Event::Environment(environment) => self.environment.push(*environment),
            Event::Navigation(navigation) => {
                self.counts.navigation += 1;
                self.navigation.push(*navigation);
            }
            Event::Attitude(attitude) => {
                self.counts.attitudes += 1;
                self.attitude.push(*attitude);
            }
            Event::Parameters(parameters) => push_change(&mut self.parameters, *parameters),
            Event::Settings(settings) => push_change(&mut self.settings, *settings),
            Event::Status(status) => self.status = Some(*status),
            // Persistent faults are reported again to each new listener.
            Event::Device { time, event } if !self.events.contains(&(*time, *event)) => {
                push_change(&mut self.events, (*time, *event));
            }
            Event::Reply { reply, .. } => match reply.answer {
                Answer::Accepted(Payload::Settings(settings)) => {
                    push_change(&mut self.settings, settings);
                }
                Answer::Accepted(Payload::Status(status)) => self.status = Some(status),
                _ => {}
            },
            _ => {}
        }
    }
}

fn insert_late(known: &mut Vec<TimedSample>, samples: &Samples) {
    for late in samples.iter() {
        let at =
            known.partition_point(|sample| sequence_order(sample.sequence, late.sequence).is_lt());
        known.insert(at, late);
    }
}

/// Adds an item that differs from the latest; keeps [`MAX_KEPT`].
fn push_change<T: PartialEq>(kept: &mut Vec<T>, new: T) {
    if kept.last() == Some(&new) {
        return;
    }
    if kept.len() >= MAX_KEPT {
        kept.remove(0);
    }
    kept.push(new);
}

/// Data of one link.
#[derive(Clone, Debug)]
pub struct Link {
    /// Which link.
    pub role: LinkRole,
    /// One for each start of the device, the latest last; at least one.
    pub boots: Vec<Boot>,
    /// Its statistics.
    pub statistics: LinkStatistics,
    /// The parameters in use, in order: the first 500.
    pub parameter_ids: Vec<ParameterId>,
    /// What the device's tags show.
    pub authentication: Authentication,
}

impl Link {
    /// An empty one.
    pub fn new(role: LinkRole) -> Self {
        Self {
            role,
            boots: vec![Boot::default()],
            statistics: LinkStatistics::default(),
            parameter_ids: Vec::new(),
            authentication: Authentication::default(),
        }
    }

    /// The latest identification of the device.
    pub fn hello(&self) -> Option<&Hello> {
        self.boots.iter().rev().find_map(|boot| boot.hello.as_ref())
    }

    /// The latest status of the device.
    pub fn status(&self) -> Option<&Status> {
        (self.boots.iter().rev()).find_map(|boot| boot.status.as_ref())
    }

    /// Number of samples of a stream of a sensor in all starts.
    pub fn count(&self, sensor: u8, stream: Stream) -> usize {
        self.boots.iter().map(|boot| boot.counts.of(sensor, stream)).sum()
    }

    /// Indices of the sensors with raw samples.
    pub fn sensors(&self) -> Vec<u8> {
        let keys = self.boots.iter().flat_map(|boot| boot.counts.samples.keys());
        let raw = keys.filter(|(_, stream)| *stream == Stream::Raw);
        let sensors: BTreeSet<u8> = raw.map(|(sensor, _)| *sensor).collect();
        sensors.into_iter().collect()
    }

    /// The device's clock in the longest start, from this link alone, after the end of the data.
    pub fn clock(&self) -> Option<&ClockModel> {
        let longest = (self.boots.iter()).max_by_key(|boot| boot.clock.transfers());
        longest?.model()
    }

    /// The start of the device with the most samples.
    pub fn longest(&self) -> Option<&Boot> {
        let samples = |boot: &&Boot| boot.raw().len().max(boot.corrected().len());
        self.boots.iter().max_by_key(samples)
    }

    /// The latest start of the device.
    pub fn latest(&mut self) -> &mut Boot {
        if self.boots.is_empty() {
            self.boots.push(Boot::default());
        }
        let last = self.boots.len() - 1;
        &mut self.boots[last]
    }

    /// The parameters in use at the last raw samples; `None` without an epoch.
    ///
    /// # Errors
    /// Those of [`Boot::parameters_of`].
    pub fn last_parameters(&self) -> Result<Option<ParameterSet>> {
        self.last_with_raw()
            .and_then(|boot| Some((boot, boot.epochs().last()?)))
            .map(|(boot, mark)| boot.parameters_of(&mark.epoch))
            .transpose()
    }

    /// A note where the source of [`last_parameters`](Self::last_parameters) is not known here.
    pub fn unknown_source(&self) -> Option<Problem> {
        let boot = self.last_with_raw()?;
        boot.reported(&boot.epochs().last()?.epoch).ok()?.unknown_source()
    }

    fn last_with_raw(&self) -> Option<&Boot> {
        self.boots.iter().rev().find(|boot| !boot.raw().is_empty())
    }

    /// Removes the latest `count` raw samples of sensor 0.
    pub fn drop_latest_raw(&mut self, mut count: usize) {
        for boot in self.boots.iter_mut().rev() {
            if let Some(raw) = boot.samples.get_mut(&(0, Stream::Raw)) {
                let kept = raw.len().saturating_sub(count);
                count -= raw.len() - kept;
                raw.truncate(kept);
            }
        }
    }

    /// Adds an arrival.
    pub fn take(&mut self, arrival: &Arrival) {
        let role = self.role;
        self.latest().clock.heard(role, arrival);
        self.authentication.see(arrival);
        self.take_event(&arrival.event);
    }

    /// Adds an event, but for its time of arrival.
    pub(crate) fn take_event(&mut self, event: &Event) {
        match event {
            Event::Restart { .. } if !self.latest().is_empty() => {
                return self.boots.push(Boot::default());
            }
            Event::Epoch { epoch, .. } if epoch.sensor == 0 => {
                let id = epoch.parameter_id();
                if self.parameter_ids.last() != Some(&id) && self.parameter_ids.len() < MAX_IDS {
                    self.parameter_ids.push(id);
                }
            }
            _ => {}
        }
        self.latest().take(event);
    }
}
