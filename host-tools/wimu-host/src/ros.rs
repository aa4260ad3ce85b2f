//! Decoded data as ROS 2 messages beside the received bytes, in a recording that any MCAP tool reads.
//!
//! Under `/cable` and `/wireless`: `imu/data_raw` (counts at nominal sensitivity, sensor axes) and
//! `imu/data` (corrected, body axes), both `sensor_msgs/msg/Imu` in m/s²; `imu/mag`
//! (raw output of the magnetometer, its axes) and, where the parameters in use have a magnetometer,
//! `imu/mag_corrected` (body axes), both `sensor_msgs/msg/MagneticField` in tesla; `imu/temperature`
//! (`sensor_msgs/msg/Temperature`, °C).
//! Further sensors of the board are `imu_1/data_raw`, …, with the frame `imu_1_link`. With a gyroscope, messages have
//! the angular velocity in rad/s; `imu/data` has the orientation, east-north-up, at the samples for which the device
//! sent its attitude.
//! Where the device sent its position: `odom` (`nav_msgs/msg/Odometry`) while it is valid, `path`
//! (`nav_msgs/msg/Path`, at most 1000 poses) and, of one link, `/tf` from `map` to `base_link`; `/tf_static` gives
//! `imu_link` the axes of the body, which are those of `imu/data`. The device sends no covariance of the position.
//! Without a gyroscope its orientation is unknown, with the variance of a whole turn.
//! Stamps are device times through the clock model, in UTC; messages are in the order of arrival. An absent quantity
//! has −1 as the first element of its covariance; a covariance of zeros is unknown.

pub(crate) mod message;
pub(crate) mod path;

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;

use serde::Serialize;
use wimu_link::LinkRole;
use wimu_link::batch::Stream;
use wimu_link::message::{Attitude, Navigation, WirePhase};
use wimu_model::{AngularRateQ20, DeviceTimeUs, Matrix3, SpecificForceQ16};

use crate::compare::LinkModel;
use crate::decode::{Event, Samples, sequence_order};
use crate::finding::{Finding, FindingCode, without_unit};
use crate::history::Boot;
use crate::mcap_file::{RecordingReader, RecordingWriter, Wholeness};
use crate::replay::find;
use crate::units::RawUnits;
use crate::walk::{Clocks, Start, Step, Walker, walk};
use crate::{ErrorCode, OutputFile, Result};
use message::Message;
use path::{PathTopics, Pose};

/// Attitudes kept for the samples that follow them.
const MAX_ATTITUDES: usize = 256;
/// Samples whose time is kept for the positions computed from them, and positions that wait for their sample.
const MAX_TIMES: usize = 4096;

/// How many messages of each topic were written.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Decoded {
    /// By topic.
    pub messages: BTreeMap<String, u64>,
    /// Messages left out because their start has no clock model.
    pub without_time: u64,
    /// Raw samples left out because their range is unknown: no epoch covers them.
    pub without_unit: u64,
    /// Samples that arrived after later ones, and are stored after them.
    pub late: u64,
    /// Batches of samples left out because no epoch followed that defines their numbers, also at the end of the
    /// recording.
    pub unplaced: u64,
    /// Completeness of the recording.
    #[serde(flatten)]
    pub wholeness: Wholeness,
    /// What is left out, and out of order.
    pub findings: Vec<Finding>,
}

impl Decoded {
    fn lacks(&self) -> Vec<Finding> {
        let (left_out, late) = (FindingCode::SamplesLeftOut, FindingCode::TimesUnordered);
        let lacks = [
            (
                left_out,
                self.without_time,
                "messages left out: their time is unknown",
            ),
            (
                late,
                self.late,
                "samples are out of order: they arrived late",
            ),
            (
                left_out,
                self.unplaced,
                "batches left out: they have no time reference",
            ),
        ];
        let lacks = lacks.into_iter().filter(|(_, count, _)| *count > 0);
        let lacks = lacks.map(|(code, count, what)| code.warning(format!("{count} {what}")));
        let without = without_unit(self.without_unit as usize, "raw sample", "left out");
        lacks
            .chain(without)
            .chain(self.wholeness.finding())
            .collect()
    }
}

#[derive(Clone, Copy)]
enum Kind {
    Raw,
    Corrected,
    Magnetic,
    MagneticCorrected,
    Temperature,
}

impl Kind {
    fn topic(self) -> &'static str {
        match self {
            Self::Raw => "data_raw",
            Self::Corrected => "data",
            Self::Magnetic => "mag",
            Self::MagneticCorrected => "mag_corrected",
            Self::Temperature => "temperature",
        }
    }

    fn type_name(self) -> &'static str {
        match self {
            Self::Raw | Self::Corrected => "sensor_msgs/Imu",
            Self::Magnetic | Self::MagneticCorrected => "sensor_msgs/MagneticField",
            Self::Temperature => "sensor_msgs/Temperature",
        }
    }
}

/// Copies the recording at `from` to `to`, with the decoded topics added. A link model
/// is applied to the link that it names. Memory does not grow with the recording.
///
/// # Errors
/// Those of reading a recording and of [`OutputFile`]; `data_refused` when the link
/// model is of another device.
pub fn decode(from: &Path, to: &Path, link_model: Option<&LinkModel>) -> Result<Decoded> {
    let mut clocks = Clocks::default();
    let mut units: BTreeMap<(Start, u8), RawUnits> = BTreeMap::new();
    let mut positioned: Option<LinkRole> = None;
    walk(&mut RecordingReader::open(from)?, |role, start, step| {
        if let Step::Arrival(arrival) = &step {
            match (arrival.event.of_any_sensor(), link_model) {
                (Event::Hello(hello), Some(model)) => model.check_device(hello.device_id)?,
                // An epoch that one link lost may have arrived on the other.
                (Event::Epoch { epoch, .. }, _) => {
                    units.entry((start, epoch.sensor)).or_default().see(epoch);
                }
                (Event::Navigation(_), _) if role == LinkRole::Cable || positioned.is_none() => {
                    positioned = Some(role);
                }
                _ => {}
            }
        }
        clocks.see(role, start, &step);
        Ok(())
    })?;
    let clocks = clocks.models();
    let mut reader = RecordingReader::open(from)?;
    let Some(anchor) = reader.anchor()? else {
        return Err(ErrorCode::BadRecording
            .error(
                "it has no anchor from the host's clock to UTC",
                "give a file written by `wimu record`",
            )
            .at(from.display().to_string()));
    };
    let (output, file) = OutputFile::create(to)?;
    let mut decoder = Writer {
        out: RecordingWriter::new(file, output.name(), anchor)?,
        units,
        parameters: BTreeMap::new(),
        paths: BTreeMap::new(),
        positioned,
        link_model,
        decoded: Decoded::default(),
    };
    let mut walker = Walker::new();
    while let Some(entry) = reader.next_entry()? {
        decoder.out.record(&entry)?;
        walker.push(entry, &mut |role, start, step| {
            decoder.take(role, start, &step, clocks.get(&start))
        })?;
    }
    let links = walker
        .finish(&mut |role, start, step| decoder.take(role, start, &step, clocks.get(&start)))?;
    let unplaced = links.iter().map(|(_, link)| link.batches_unplaced);
    decoder.decoded.unplaced = unplaced.sum();
    for path in std::mem::take(&mut decoder.paths).into_values() {
        path.topics.finish(decoder.out.ros())?;
    }
    decoder.decoded.messages = decoder.out.ros().counts();
    decoder.out.finish()?;
    decoder.decoded.wholeness = reader.wholeness();
    decoder.decoded.findings = decoder.decoded.lacks();
    // `to` may be the same file.
    drop(reader);
    output.finish()?;
    Ok(decoder.decoded)
}

/// The numbers of a `sensor_msgs/msg/Imu`. What is absent has −1 as the first element of its covariance.
pub(crate) fn imu(
    force: [f64; 3],
    rate: Option<[f64; 3]>,
    attitude: Option<&Attitude>,
) -> [f64; 37] {
    let mut fields = [0.0; 37];
    match attitude {
        Some(attitude) => {
            let [w, x, y, z] = attitude.to_quaternion();
            fields[..4].copy_from_slice(&[x, y, z, w]);
        }
        None => {
            fields[3] = 1.0;
            fields[4] = -1.0;
        }
    }
    match rate {
        Some(rate) => fields[13..16].copy_from_slice(&rate),
        None => fields[16] = -1.0,
    }
    fields[25..28].copy_from_slice(&force);
    fields
}

/// Standard deviations of the gyroscope's terms and its rotation to the body, by the parameters in use.
fn gyroscope_of(boot: &Boot) -> Option<([f64; 12], Matrix3)> {
    let set = boot.parameters_of(&boot.epochs.last()?.epoch).ok()?;
    Some((set.gyroscope?.sd?.map(f64::from), set.alignment.matrix()))
}

/// Covariance of a corrected angular rate, rad²/s², body axes: of the bias, and of the scale factors and
/// misalignments at this rate. Noise is not known.
pub(crate) fn rate_covariance(rate: [f64; 3], sd: &[f64; 12], rotation: &Matrix3) -> Matrix3 {
    let rate = [0, 1, 2].map(|axis| (0..3).map(|k| rotation[k][axis] * rate[k]).sum::<f64>());
    let variance = [0, 1, 2].map(|axis| {
        let matrix = &sd[3 + 3 * axis..];
        let terms = (matrix.iter().zip(rate)).map(|(sd, rate)| (sd * rate).powi(2));
        sd[axis].powi(2) + terms.sum::<f64>()
    });
    let element = |i: usize, j: usize| {
        (0..3)
            .map(|k| rotation[i][k] * variance[k] * rotation[j][k])
            .sum()
    };
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| element(i, j)))
}

struct Writer<'a> {
    out: RecordingWriter<std::fs::File>,
    /// Of raw samples, by sensor.
    units: BTreeMap<(Start, u8), RawUnits>,
    /// Parameters and the latest epoch, by which the field is corrected.
    parameters: BTreeMap<(u8, Start), Boot>,
    /// Positions of each link's start.
    paths: BTreeMap<(u8, Start), DevicePath>,
    /// The link whose positions are transforms.
    positioned: Option<LinkRole>,
    link_model: Option<&'a LinkModel>,
    decoded: Decoded,
}

/// Positions that a device sent, and what is needed to place them.
struct DevicePath {
    topics: PathTopics,
    /// Number, time and angular rate of the latest samples.
    samples: VecDeque<(u32, DeviceTimeUs, Option<[f64; 3]>)>,
    waiting: VecDeque<Navigation>,
}

impl DevicePath {
    fn see(&mut self, samples: &Samples) {
        let corrected = samples.stream == Stream::Corrected;
        for sample in samples.iter() {
            let rate = sample.rate.filter(|_| corrected);
            let rate = rate.map(|rate| AngularRateQ20(rate).to_rad_s());
            match find_in(&self.samples, sample.sequence) {
                Ok(at) => self.samples[at].2 = rate.or(self.samples[at].2),
                Err(at) => self
                    .samples
                    .insert(at, (sample.sequence, sample.time, rate)),
            }
        }
        let old = self.samples.len().saturating_sub(MAX_TIMES);
        self.samples.drain(..old);
    }

    /// The next position whose sample is known; those whose sample was lost are left out.
    fn next(&mut self) -> Option<(Navigation, DeviceTimeUs, Option<[f64; 3]>)> {
        let latest = self.samples.back()?.0;
        while let Some(next) = self.waiting.front().copied() {
            if sequence_order(next.sequence, latest).is_gt() && self.waiting.len() <= MAX_TIMES {
                return None;
            }
            self.waiting.pop_front();
            if let Ok(at) = find_in(&self.samples, next.sequence) {
                let (_, time, rate) = self.samples[at];
                return Some((next, time, rate));
            }
        }
        None
    }
}

fn find_in<T>(
    samples: &VecDeque<(u32, DeviceTimeUs, T)>,
    sequence: u32,
) -> std::result::Result<usize, usize> {
    samples.binary_search_by(|sample| sequence_order(sample.0, sequence))
}

impl Writer<'_> {
    fn take(
        &mut self,
        role: LinkRole,
        start: Start,
        step: &Step,
        clock: Option<&crate::clock::ClockModel>,
    ) -> Result<()> {
        let Step::Arrival(arrival) = step else {
            return Ok(());
        };
        let arrived_ns = arrival.host_ns;
        let event = arrival.event.of_any_sensor();
        let sensor = event.sensor().unwrap_or_default();
        let write = |writer: &mut Self, kind: Kind, time: DeviceTimeUs, fields: &[f64]| {
            let Some(clock) = clock else {
                writer.decoded.without_time += 1;
                return Ok(());
            };
            writer.write(
                (role, sensor, kind),
                arrived_ns,
                clock.host_ns(time),
                fields,
            )
        };
        self.position(role, start, event, arrived_ns, clock)?;
        let held = self.parameters.entry((role.number(), start)).or_default();
        held.take_parameters(&arrival.event);
        match event {
            Event::Samples(samples) | Event::Late(samples) => {
                if matches!(event, Event::Late(_)) {
                    self.decoded.late += samples.values.len() as u64;
                }
                let kind = match samples.stream {
                    Stream::Raw => Kind::Raw,
                    Stream::Corrected => Kind::Corrected,
                };
                let model = (self.link_model).filter(|model| sensor == 0 && model.is_of(role));
                let gyroscope = gyroscope_of(held).filter(|_| samples.stream == Stream::Corrected);
                let attitudes = std::mem::take(&mut held.attitude);
                for sample in samples.iter() {
                    let units = self.units.get(&(start, sensor));
                    let unit = units.and_then(|units| units.of(sample.sequence));
                    let (force, rate) = match (samples.stream, unit) {
                        (Stream::Raw, None) => {
                            self.decoded.without_unit += 1;
                            continue;
                        }
                        (Stream::Raw, Some(unit)) => {
                            (unit.mps2(sample.value), unit.rad_s(sample.rate))
                        }
                        (Stream::Corrected, _) => (
                            SpecificForceQ16(sample.value).to_mps2().0,
                            sample.rate.map(|rate| AngularRateQ20(rate).to_rad_s()),
                        ),
                    };
                    let force = model.map_or(force, |model| model.correct(force));
                    let attitude = match samples.stream {
                        Stream::Raw => None,
                        Stream::Corrected => find(&attitudes, sample.sequence, |a| a.sequence),
                    };
                    let mut fields = imu(force, rate, attitude);
                    if let (Some(rate), Some((sd, alignment))) = (rate, &gyroscope) {
                        let covariance = rate_covariance(rate, sd, alignment);
                        fields[16..25].copy_from_slice(covariance.as_flattened());
                    }
                    write(self, kind, sample.time, &fields)?;
                }
                if let Some(held) = self.parameters.get_mut(&(role.number(), start)) {
                    held.attitude = attitudes;
                }
            }
            Event::Attitude(attitude) => {
                held.attitude.push(*attitude);
                let old = held.attitude.len().saturating_sub(MAX_ATTITUDES);
                held.attitude.drain(..old);
            }
            Event::Environment(environment) => {
                let time = DeviceTimeUs(environment.time_us);
                let corrected = held.corrected_field_nt(environment);
                let field = environment.magnetic_field_nt.map(|nt| nt.map(f64::from));
                for (kind, nt) in [
                    (Kind::Magnetic, field),
                    (Kind::MagneticCorrected, corrected),
                ] {
                    let Some(nt) = nt else { continue };
                    let mut fields = [0.0; 12];
                    for axis in 0..3 {
                        fields[axis] = nt[axis] * 1e-9;
                    }
                    write(self, kind, time, &fields)?;
                }
                if let Some(centi) = environment.temperature_centi_c {
                    write(
                        self,
                        Kind::Temperature,
                        time,
                        &[f64::from(centi) / 100.0, 0.0],
                    )?;
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Takes the positions that a device sent.
    fn position(
        &mut self,
        role: LinkRole,
        start: Start,
        event: &Event,
        arrived_ns: u64,
        clock: Option<&crate::clock::ClockModel>,
    ) -> Result<()> {
        let key = (role.number(), start);
        let transforms = self.positioned == Some(role);
        let path = self.paths.entry(key).or_insert_with(|| DevicePath {
            topics: PathTopics::new(&format!("/{role}"), transforms),
            samples: VecDeque::new(),
            waiting: VecDeque::new(),
        });
        match event {
            Event::Navigation(navigation)
                if navigation.flags == 0 && navigation.phase != WirePhase::Searching =>
            {
                path.waiting.push_back(*navigation);
            }
            Event::Samples(samples) if samples.sensor == 0 => path.see(samples),
            _ => return Ok(()),
        }
        let anchor = self.out.anchor();
        while let Some((navigation, time, rate)) = path.next() {
            let Some(clock) = clock else {
                self.decoded.without_time += 1;
                continue;
            };
            let attitudes = self
                .parameters
                .get(&key)
                .map_or(&[][..], |held| &held.attitude);
            let attitude = find(attitudes, navigation.sequence, |a| a.sequence);
            let heading = navigation.heading_sd_mrad;
            let heading_sd = heading.map_or(0.0, |mrad| f64::from(mrad) * 1e-3);
            let turn = std::f64::consts::PI;
            let pose = Pose {
                stamp_ns: anchor.to_utc_ns(clock.host_ns(time)),
                position_m: navigation.position_nm.map(|nm| nm as f64 * 1e-9),
                position_covariance: [[0.0; 3]; 3],
                quaternion: attitude.map_or([1.0, 0.0, 0.0, 0.0], Attitude::to_quaternion),
                attitude_sd_rad: attitude.map_or([turn; 3], |_| [0.0, 0.0, heading_sd]),
                velocity_mps: navigation.velocity_nmps.map(|nm| nm as f64 * 1e-9),
                velocity_sd_mps: [0.0; 3],
                rate_rad_s: rate.unwrap_or_default(),
            };
            let log_ns = anchor.to_utc_ns(arrived_ns);
            path.topics.push(self.out.ros(), log_ns, &pose)?;
        }
        Ok(())
    }

    /// One message: a header and numbers.
    fn write(
        &mut self,
        (role, sensor, kind): (LinkRole, u8, Kind),
        arrived_ns: u64,
        taken_ns: u64,
        fields: &[f64],
    ) -> Result<()> {
        let sensor_name = match sensor {
            0 => "imu".to_owned(),
            further => format!("imu_{further}"),
        };
        let topic = format!("/{role}/{sensor_name}/{}", kind.topic());
        let anchor = self.out.anchor();
        let stamp_ns = anchor.to_utc_ns(taken_ns);
        let head = Message::new().header(stamp_ns, &format!("{sensor_name}_link"));
        let log_ns = anchor.to_utc_ns(arrived_ns);
        let message = head.numbers(fields);
        let file = self.out.ros();
        file.publish(&topic, kind.type_name(), log_ns, stamp_ns, &message)
    }
}
