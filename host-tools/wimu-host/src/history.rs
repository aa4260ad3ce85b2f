//! Decoded data of links, from a recording or from a live board.

use std::collections::{BTreeMap, HashSet};
use std::path::Path;

use wimu_link::batch::Stream;
use wimu_link::hello::sensor;
use wimu_link::message::{
    ActiveParameters, Answer, Attitude, Environment, Epoch, Event as DeviceEvent, Navigation,
    Payload, Status,
};
use wimu_link::{Hello, LinkRole, Settings};
use wimu_model::{DeviceTimeUs, MagneticFieldNt, ParameterSet, Sensitivity, SensorId};

use crate::clock::{ClockEstimator, ClockModel};
use crate::decode::{Arrival, Event, LinkStatistics, Samples, TimedSample, sequence_order};
use crate::error::{ErrorCode, Result};
use crate::mcap_file::{ClockAnchor, RecordingReader, Wholeness};
use crate::overview::{Listen, choose, listen};
use crate::walk::Start;

/// Largest number of parameter changes, settings changes and events kept of a start, each.
const MAX_KEPT: usize = 4096;

/// An epoch as it arrived.
#[derive(Clone, Debug)]
pub struct EpochMark {
    /// As sent.
    pub epoch: Epoch,
    /// Whether epochs before it were lost.
    pub after_loss: bool,
}

/// Data of a further sensor, index 1 to 7.
#[derive(Clone, Debug, Default)]
pub struct Track {
    /// Raw samples, LSB, by sequence number.
    pub raw: Vec<TimedSample>,
    /// Epochs, by sequence number; they define the unit of the samples.
    pub epochs: Vec<EpochMark>,
}

impl Track {
    fn take(&mut self, event: &Event) {
        match event {
            Event::Samples(samples) => self.raw.extend(samples.iter()),
            Event::Late(samples) => insert_late(&mut self.raw, samples),
            Event::Epoch { epoch, after_loss } => self.epochs.push(EpochMark {
                epoch: *epoch,
                after_loss: *after_loss,
            }),
            _ => {}
        }
    }
}

/// Data of one link in one start of the device.
#[derive(Clone, Debug, Default)]
pub struct Boot {
    /// The start, common to both links of a recording; `None` for a live board.
    pub start: Option<Start>,
    /// Latest identification.
    pub hello: Option<Hello>,
    /// Raw samples of sensor 0, LSB, by sequence number.
    pub raw: Vec<TimedSample>,
    /// Corrected samples of sensor 0, 2⁻¹⁶ m/s² and 2⁻²⁰ rad/s, by sequence number.
    pub corrected: Vec<TimedSample>,
    /// Epochs, by sequence number.
    pub epochs: Vec<EpochMark>,
    /// Further sensors, by index, 1 to 7.
    pub further: BTreeMap<u8, Track>,
    /// Magnetic field and temperature, by time.
    pub environment: Vec<Environment>,
    /// Velocity and position, by sequence number.
    pub navigation: Vec<Navigation>,
    /// Attitude, by sequence number.
    pub attitude: Vec<Attitude>,
    /// Parameters in use, as reported: the latest 4096 changes.
    pub parameters: Vec<ActiveParameters>,
    /// Settings in use, as reported: the latest 4096 changes.
    pub settings: Vec<Settings>,
    /// Latest status.
    pub status: Option<Status>,
    /// Events, each once: the latest [`MAX_KEPT`] and up to as many before them.
    pub events: Vec<(DeviceTimeUs, DeviceEvent)>,
    known_events: HashSet<String>,
    /// Estimator of the device's clock.
    pub clock: ClockEstimator,
    /// Its model at the end of the data.
    model: Option<ClockModel>,
}

impl Boot {
    /// Host time of a device time, ns, after the end of the data; `None` without a model.
    /// See [`ClockModel::host_ns`].
    pub fn host_ns(&self, time: DeviceTimeUs) -> Option<u64> {
        self.model.as_ref().map(|model| model.host_ns(time))
    }

    /// Standard deviation of [`host_ns`](Self::host_ns), ns. See [`ClockModel::sd_ns`].
    pub fn clock_sd_ns(&self, time: DeviceTimeUs) -> Option<f64> {
        self.model.as_ref().map(|model| model.sd_ns(time))
    }

    /// Device time of a sample, if it arrived raw or corrected.
    pub fn time_of(&self, sequence: u32) -> Option<DeviceTimeUs> {
        [&self.raw, &self.corrected]
            .into_iter()
            .find_map(|samples| {
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
            ErrorCode::BadRecording.error(
                message,
                "record from the connection on: the device then sends its parameters",
            )
        };
        if epoch.parameters == 0 {
            return Sensitivity::from_lsb_per_g(epoch.sensitivity_lsb_per_g)
                .map(|sensitivity| ParameterSet::uncalibrated(epoch.range_g, sensitivity))
                .map_err(|error| bad(error.to_string()));
        }
        let wire = self
            .parameters
            .iter()
            .find(|active| active.id == epoch.parameters)
            .and_then(|active| active.active)
            .ok_or_else(|| {
                bad(format!(
                    "the recording lacks the parameters {:08x}",
                    epoch.parameters
                ))
            })?;
        let set = ParameterSet::try_from(&wire).map_err(|fault| bad(fault.to_string()))?;
        if wimu_link::message::parameter_id(&set).0 != epoch.parameters {
            return Err(ErrorCode::BadRecording.error(
                format!(
                    "the parameters {:08x} have terms unknown to this version of wimu",
                    epoch.parameters
                ),
                "update wimu on this computer",
            ));
        }
        Ok(set)
    }

    /// The magnetic field, nT, body axes, corrected by the parameters then in use; `None` where
    /// they are unknown or have no magnetometer.
    pub fn corrected_field_nt(&self, environment: &Environment) -> Option<[f64; 3]> {
        let output = MagneticFieldNt(environment.magnetic_field_nt?);
        let after = self
            .epochs
            .partition_point(|mark| mark.epoch.time_us <= environment.time_us);
        let mark = self.epochs.get(after.saturating_sub(1))?;
        let set = self.parameters_of(&mark.epoch).ok()?;
        set.correct_field(output)
    }

    /// Nominal sensitivity of the sensor from the epochs; `None` if the device does not know it.
    pub fn nominal_sensitivity(&self) -> Option<Sensitivity> {
        let known = self.hello.is_none_or(|hello| hello.sensitivity_known);
        let epoch = &self.epochs.first()?.epoch;
        Sensitivity::from_lsb_per_g(epoch.sensitivity_lsb_per_g)
            .ok()
            .filter(|_| known)
    }

    /// The accelerometer, if the device has identified it.
    pub fn sensor(&self) -> Option<SensorId> {
        let number = self.hello?.sensor.number;
        sensor::is_one_model(number).then_some(SensorId(number))
    }

    /// Takes parameters and epochs, keeping the latest epoch only.
    pub(crate) fn take_parameters(&mut self, event: &Event) {
        match event {
            Event::Epoch { epoch, after_loss } => {
                self.epochs = vec![EpochMark {
                    epoch: *epoch,
                    after_loss: *after_loss,
                }];
            }
            Event::Parameters(parameters) => self.use_parameters(*parameters),
            _ => {}
        }
    }

    /// Takes an epoch, and drops those that ended before a device time, µs.
    pub(crate) fn add_epoch(&mut self, event: &Event, before_us: u64) {
        if let Event::Epoch { epoch, after_loss } = event {
            self.epochs.push(EpochMark {
                epoch: *epoch,
                after_loss: *after_loss,
            });
            let ended = self
                .epochs
                .partition_point(|mark| mark.epoch.time_us < before_us);
            self.epochs.drain(..ended.saturating_sub(1));
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.hello.is_none() && self.raw.is_empty() && self.epochs.is_empty()
    }

    fn use_settings(&mut self, settings: Settings) {
        push_change(&mut self.settings, settings);
    }

    fn use_parameters(&mut self, parameters: ActiveParameters) {
        push_change(&mut self.parameters, parameters);
    }
}

fn insert_late(known: &mut Vec<TimedSample>, samples: &Samples) {
    for late in samples.iter() {
        let at =
            known.partition_point(|sample| sequence_order(sample.sequence, late.sequence).is_lt());
        known.insert(at, late);
    }
}

/// Adds an item that is not in `known`, which has the `Debug` texts of all items: a search in `all` would take longer
/// with every item. Of twice [`MAX_KEPT`] the older half is dropped.
fn push_new<T: std::fmt::Debug>(all: &mut Vec<T>, known: &mut HashSet<String>, item: T) {
    if !known.insert(format!("{item:?}")) {
        return;
    }
    if all.len() == 2 * MAX_KEPT {
        for dropped in all.drain(..MAX_KEPT) {
            known.remove(&format!("{dropped:?}"));
        }
    }
    all.push(item);
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
pub struct LinkHistory {
    /// Which link.
    pub role: LinkRole,
    /// One for each start of the device, the latest last; at least one.
    pub boots: Vec<Boot>,
    /// Its statistics.
    pub statistics: LinkStatistics,
    /// Reasons why frames could not be decoded, the first ten.
    pub complaints: Vec<String>,
}

impl LinkHistory {
    /// An empty one.
    pub fn new(role: LinkRole) -> Self {
        Self {
            role,
            boots: vec![Boot::default()],
            statistics: LinkStatistics::default(),
            complaints: Vec::new(),
        }
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
        let boot = self.boots.iter().rev().find(|boot| !boot.raw.is_empty());
        boot.and_then(|boot| Some((boot, boot.epochs.last()?)))
            .map(|(boot, mark)| boot.parameters_of(&mark.epoch))
            .transpose()
    }

    /// Adds an arrival.
    pub fn take(&mut self, arrival: &Arrival) {
        let role = self.role;
        let boot = self.latest();
        boot.clock.heard(role, arrival);
        match &arrival.event {
            Event::Restart { .. } => {
                if !boot.is_empty() {
                    self.boots.push(Boot::default());
                }
            }
            Event::Hello(hello) => boot.hello = Some(*hello),
            Event::Samples(samples) => match samples.stream {
                Stream::Raw => boot.raw.extend(samples.iter()),
                Stream::Corrected => boot.corrected.extend(samples.iter()),
            },
            Event::Late(samples) => match samples.stream {
                Stream::Raw => insert_late(&mut boot.raw, samples),
                Stream::Corrected => insert_late(&mut boot.corrected, samples),
            },
            Event::Further(event) => {
                if let Some(sensor) = event.sensor() {
                    boot.further.entry(sensor).or_default().take(event);
                }
            }
            Event::Epoch { epoch, after_loss } => boot.epochs.push(EpochMark {
                epoch: *epoch,
                after_loss: *after_loss,
            }),
            Event::Environment(environment) => boot.environment.push(*environment),
            Event::Navigation(navigation) => boot.navigation.push(*navigation),
            Event::Parameters(parameters) => boot.use_parameters(*parameters),
            Event::Settings(settings) => boot.use_settings(*settings),
            Event::Status(status) => boot.status = Some(*status),
            Event::Device { time, event } => {
                // Persistent faults are reported again to each new listener.
                push_new(&mut boot.events, &mut boot.known_events, (*time, *event));
            }
            Event::Reply { reply, .. } => match reply.answer {
                Answer::Accepted(Payload::Settings(settings)) => boot.use_settings(settings),
                Answer::Accepted(Payload::Status(status)) => boot.status = Some(status),
                _ => {}
            },
            Event::Unreadable(why) => {
                if self.complaints.len() < 10 && !self.complaints.contains(why) {
                    self.complaints.push(why.clone());
                }
            }
            Event::Attitude(attitude) => boot.attitude.push(*attitude),
            Event::Damaged(_) => {}
        }
    }
}

impl Listen for LinkHistory {
    fn take(&mut self, start: Start, arrival: &Arrival) {
        LinkHistory::take(self, arrival);
        self.latest().start = Some(start);
    }

    fn asked(&mut self, host_ns: u64, bytes: &[u8]) {
        self.latest().clock.asked(host_ns, bytes);
    }

    fn has_epochs(&self) -> bool {
        self.boots.iter().any(|boot| !boot.epochs.is_empty())
    }

    fn finish(&mut self, statistics: LinkStatistics) {
        self.statistics = statistics;
        for boot in &mut self.boots {
            boot.model = boot.clock.model();
        }
    }
}

/// A recording, decoded and in memory.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Name of the file in errors.
    pub name: String,
    /// Its links, the cable first.
    pub links: Vec<LinkHistory>,
    /// Host's monotonic clock to UTC.
    pub anchor: Option<ClockAnchor>,
    /// Host time from the first bytes to the last, ns.
    pub duration_ns: u64,
    /// Completeness of the file.
    pub wholeness: Wholeness,
}

impl Recording {
    /// Reads and decodes a recording. One that was cut off gives its readable part.
    ///
    /// # Errors
    /// Those of [`Recording::read`].
    pub fn load(path: &Path) -> Result<Self> {
        Self::read(RecordingReader::open(path)?, &path.display().to_string())
    }

    /// The same from an open reader; `name` is its name in errors.
    ///
    /// # Errors
    /// Those of [`RecordingReader`]; `bad_recording` when all boards in it use another wire version.
    pub fn read<R: std::io::Read>(reader: RecordingReader<R>, name: &str) -> Result<Self> {
        let mut heard = listen(reader, name, LinkHistory::new)?;
        share_parameters(&mut heard.links);
        Ok(Self {
            name: name.to_owned(),
            links: heard.links,
            anchor: heard.anchor,
            duration_ns: heard.duration_ns,
            wholeness: heard.wholeness,
        })
    }

    /// The link of a role; `None` takes the cable if it has raw samples, else the link with the most.
    ///
    /// # Errors
    /// `no_rows` when there is none.
    pub fn link(&self, role: Option<LinkRole>) -> Result<&LinkHistory> {
        let raw = |link: &LinkHistory| link.boots.iter().map(|boot| boot.raw.len()).sum();
        choose(&self.links, role, |link| (link.role, raw(link)))
            .map_err(|error| error.at(&self.name))
    }
}

/// Gives each start the parameter sets that its epochs name and that only other starts or links have: a link may
/// have lost them. A set is identified by its content.
fn share_parameters(links: &mut [LinkHistory]) {
    let boots = || links.iter().flat_map(|link| &link.boots);
    let known: Vec<ActiveParameters> = boots()
        .flat_map(|boot| &boot.parameters)
        .filter(|set| set.active.is_some())
        .copied()
        .collect();
    for boot in links.iter_mut().flat_map(|link| &mut link.boots) {
        for set in &known {
            let uses = |mark: &EpochMark| mark.epoch.parameters == set.id;
            let has = |own: &ActiveParameters| own.id == set.id && own.active.is_some();
            if boot.epochs.iter().any(uses) && !boot.parameters.iter().any(has) {
                boot.parameters.insert(0, *set);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::fmt;
    use std::io::Cursor;

    use wimu_link::message::{EpochReason, WireParameters};
    use wimu_link::{MAX_FRAME, Telemetry, batch};
    use wimu_model::Counts;

    use super::*;
    use crate::mcap_file::RecordingWriter;

    const ANCHOR: ClockAnchor = ClockAnchor {
        monotonic_ns: 0,
        utc_ns: 1_795_222_920_000_000_000,
    };

    fn hello(role: LinkRole, boot_count: u32) -> Vec<u8> {
        let mut frame = [0; MAX_FRAME];
        let hello = Hello {
            boot_count,
            ..Hello::new(role)
        };
        let length = hello.encode(&mut frame).unwrap();
        frame[..length].to_vec()
    }

    /// A second of samples of a start from `first` at 100 Hz, after an epoch.
    fn second_of(boot: u32, first: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut frame = [0; MAX_FRAME];
        let epoch = <Telemetry>::Epoch(Epoch {
            reason: EpochReason::Periodic,
            number: (first / 100) as u8,
            sequence: first,
            time_us: u64::from(first) * 10_000,
            period_ns: 10_000_000,
            range_g: 4,
            sensitivity_lsb_per_g: 8192.0,
            full_scale: 32752,
            parameters: 0,
            temperature_centi_c: None,
            ..Epoch::default()
        });
        let length = epoch.encode(&mut frame).unwrap();
        bytes.extend(&frame[..length]);
        for start in (first..first + 100).step_by(20) {
            let samples: Vec<_> = (start..start + 20)
                .map(|s| Counts([s as i16, 0, boot as i16]))
                .collect();
            let time = DeviceTimeUs(u64::from(start) * 10_000);
            let length = batch::encode(start, time, &samples, &mut frame).unwrap();
            bytes.extend(&frame[..length]);
        }
        bytes
    }

    fn second(first: u32) -> Vec<u8> {
        second_of(1, first)
    }

    /// Both links for 5 s, the device started anew on the wireless one after 3 s.
    fn recording() -> Vec<u8> {
        let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), "a.mcap", ANCHOR).unwrap();
        for s in 0..5_u32 {
            let host_ns = u64::from(s + 1) * 1_000_000_000 + 7_000_000;
            writer
                .append(LinkRole::Cable, host_ns, &hello(LinkRole::Cable, 1))
                .unwrap();
            writer
                .append(LinkRole::Cable, host_ns, &second(s * 100))
                .unwrap();
            let (boot, first) = if s < 3 {
                (1, s * 100)
            } else {
                (2, (s - 3) * 100)
            };
            let mut bytes = hello(LinkRole::Wireless, boot);
            bytes.extend(second_of(boot, first));
            // Bytes arrive in pieces that know nothing of frames.
            for piece in bytes.chunks(23) {
                writer.append(LinkRole::Wireless, host_ns, piece).unwrap();
            }
        }
        writer.finish().unwrap().into_inner()
    }

    fn read(bytes: &[u8]) -> Recording {
        Recording::read(RecordingReader::new(bytes, "a.mcap").unwrap(), "a.mcap").unwrap()
    }

    #[test]
    fn links_and_starts_are_kept_apart() {
        let recording = read(&recording());
        assert_eq!(recording.anchor, Some(ANCHOR));
        assert_eq!(recording.duration_ns, 4_000_000_000);
        let cable = recording.link(None).unwrap();
        assert_eq!(cable.role, LinkRole::Cable);
        assert_eq!((cable.boots.len(), cable.boots[0].raw.len()), (1, 500));
        assert_eq!(cable.statistics.raw.missing, 0);
        let wireless = recording.link(Some(LinkRole::Wireless)).unwrap();
        let raw: Vec<_> = wireless.boots.iter().map(|boot| boot.raw.len()).collect();
        assert_eq!(raw, [300, 200]);
        let starts = |link: &LinkHistory| -> Vec<_> {
            link.boots.iter().map(|boot| boot.start.unwrap()).collect()
        };
        assert_eq!(starts(wireless)[0], starts(cable)[0]);
        assert_ne!(starts(wireless)[1], starts(cable)[0]);
        let boot = &wireless.boots[1];
        assert_eq!(boot.hello.unwrap().boot_count, 2);
        assert!(boot.raw.is_sorted_by(|a, b| a.sequence < b.sequence));
        assert_eq!(
            boot.parameters_of(&boot.epochs[0].epoch).unwrap().range_g,
            4
        );
    }

    #[test]
    fn links_and_starts_share_the_parameter_sets_that_their_epochs_name() {
        let sensitivity = Sensitivity::from_lsb_per_g(8192.0).unwrap();
        let sets = [4, 8].map(|range_g| {
            let set = ParameterSet::uncalibrated(range_g, sensitivity);
            ActiveParameters {
                id: wimu_link::message::parameter_id(&set).0,
                active: Some(WireParameters::from(&set)),
            }
        });
        let boot = |parameters: &[ActiveParameters], ids: &[u32]| Boot {
            parameters: parameters.to_vec(),
            epochs: (ids.iter())
                .map(|&parameters| EpochMark {
                    epoch: Epoch {
                        parameters,
                        ..Epoch::default()
                    },
                    after_loss: false,
                })
                .collect(),
            ..Boot::default()
        };
        let [first, second] = sets;
        let lost = ActiveParameters {
            active: None,
            ..second
        };
        let link = |role, boots| LinkHistory {
            boots,
            ..LinkHistory::new(role)
        };
        let mut links = [
            link(LinkRole::Cable, vec![boot(&[first], &[first.id])]),
            link(
                LinkRole::Wireless,
                vec![
                    // Its own set has lost its values; that of the other link is not named.
                    boot(&[lost], &[0, second.id]),
                    boot(&[second], &[first.id, second.id]),
                    boot(&[], &[0xBAD]),
                ],
            ),
        ];
        share_parameters(&mut links);
        let [cable, wireless] = &links;
        assert_eq!(cable.boots[0].parameters, [first]);
        assert_eq!(wireless.boots[0].parameters, [second, lost]);
        assert_eq!(wireless.boots[1].parameters, [first, second]);
        assert!(wireless.boots[2].parameters.is_empty());
        let named = |mark: &EpochMark| wireless.boots[1].parameters_of(&mark.epoch).unwrap();
        let ranges: Vec<_> = (wireless.boots[1].epochs.iter())
            .map(|mark| named(mark).range_g)
            .collect();
        assert_eq!(ranges, [4, 8]);
        let unknown = &wireless.boots[2].epochs[0].epoch;
        let error = wireless.boots[2].parameters_of(unknown).unwrap_err();
        assert!(error.message().contains("lacks the parameters"), "{error}");
    }

    #[test]
    fn device_times_become_host_times_by_the_fastest_transfer() {
        let recording = read(&recording());
        let boot = &recording.link(None).unwrap().boots[0];
        // Sample 99, of 0.99 s, arrived at 1.007 s.
        let host_ns = boot.host_ns(DeviceTimeUs(990_000)).unwrap();
        assert!(host_ns.abs_diff(1_007_000_000) < 1000, "{host_ns}");
        assert_eq!(ANCHOR.to_utc_ns(host_ns) - ANCHOR.utc_ns, host_ns);
    }

    #[test]
    fn a_recording_cut_off_gives_what_it_has() {
        let bytes = recording();
        let recording = read(&bytes[..bytes.len() * 3 / 4]);
        assert!(recording.wholeness.truncated);
        let raw = recording.link(None).unwrap().boots[0].raw.len();
        assert!(raw > 0 && raw < 500, "{raw}");
    }

    #[test]
    fn a_recording_of_another_version_is_named_unless_some_of_it_can_be_read() {
        // Telemetry of version 3, empty.
        let foreign = [6, 0x34, 0xFF, 0x8D, 0x04, 0xA5, 0];
        let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), "a.mcap", ANCHOR).unwrap();
        writer.append(LinkRole::Cable, 0, &foreign).unwrap();
        let bytes = writer.finish().unwrap().into_inner();
        let reader = RecordingReader::new(&bytes[..], "a.mcap").unwrap();
        let error = Recording::read(reader, "a.mcap").unwrap_err();
        assert_eq!(error.code(), ErrorCode::BadRecording);
        assert!(error.message().contains("version 3"), "{error}");

        let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), "a.mcap", ANCHOR).unwrap();
        writer.append(LinkRole::Cable, 0, &foreign).unwrap();
        writer.append(LinkRole::Cable, 1, &second(0)).unwrap();
        let recording = read(&writer.finish().unwrap().into_inner());
        assert_eq!(recording.link(None).unwrap().boots[0].raw.len(), 100);
    }

    #[test]
    fn changes_and_events_without_end_keep_the_latest_only() {
        let mut link = LinkHistory::new(LinkRole::Cable);
        let mut take = |event| {
            link.take(&Arrival {
                host_ns: 0,
                began_ns: 0,
                event,
            });
        };
        let most = MAX_KEPT as u32;
        for n in 0..2 * most + 10 {
            take(Event::Parameters(ActiveParameters {
                active: None,
                id: n,
            }));
            take(Event::Settings(Settings {
                gravity_um_s2: n,
                ..Settings::default()
            }));
            take(Event::Device {
                time: DeviceTimeUs(n.into()),
                event: DeviceEvent::SensorFound,
            });
        }
        let boot = &link.boots[0];
        let lengths = [
            boot.parameters.len(),
            boot.settings.len(),
            boot.events.len(),
        ];
        assert_eq!(lengths, [MAX_KEPT, MAX_KEPT, MAX_KEPT + 10]);
        assert_eq!(boot.parameters[0].id, most + 10);
        assert_eq!(boot.events[0].0, DeviceTimeUs(most.into()));
        assert_eq!(
            boot.settings.last().map(|last| last.gravity_um_s2),
            Some(2 * most + 9)
        );
    }

    #[test]
    fn a_link_that_was_not_recorded_is_named() {
        let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), "a.mcap", ANCHOR).unwrap();
        writer.append(LinkRole::Wireless, 0, &second(0)).unwrap();
        let recording = read(&writer.finish().unwrap().into_inner());
        assert_eq!(recording.link(None).unwrap().role, LinkRole::Wireless);
        let error = recording.link(Some(LinkRole::Cable)).unwrap_err();
        assert_eq!(error.code(), ErrorCode::NoRows);
        assert!(error.message().contains("the cable link"), "{error}");
    }

    #[test]
    fn an_event_is_kept_once_without_looking_through_those_before_it() {
        /// Counts how often it is looked at.
        struct Seen<'a>(u32, &'a Cell<u64>);
        impl fmt::Debug for Seen<'_> {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.1.set(self.1.get() + 1);
                write!(f, "{}", self.0)
            }
        }
        impl PartialEq for Seen<'_> {
            fn eq(&self, other: &Self) -> bool {
                self.1.set(self.1.get() + 1);
                self.0 == other.0
            }
        }
        let looks = Cell::new(0);
        let (mut all, mut known) = (Vec::new(), HashSet::new());
        for round in 0..2 {
            for k in 0..5000 {
                push_new(&mut all, &mut known, Seen(k, &looks));
            }
            assert!(looks.get() <= 5000 * (round + 1), "{}", looks.get());
        }
        assert!(all.iter().map(|seen| seen.0).eq(0..5000));
    }
}
