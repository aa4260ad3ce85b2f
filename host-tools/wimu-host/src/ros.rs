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

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use wimu_integrator::Phase;
use wimu_link::LinkRole;
use wimu_link::batch::Stream;
use wimu_link::message::{Attitude, Environment, Navigation};
use wimu_model::{DeviceTimeUs, Matrix3};

use crate::capture::{Boot, Capture, Link, StartData};
use crate::clock::ClockModel;
use crate::compare::LinkModel;
use crate::decode::{Event, Samples, sequence_order};
use crate::mcap_file::{RecordingReader, RecordingWriter, Wholeness};
use crate::problem::without_unit;
use crate::replay::find;
use crate::units::SampleUnit;
use crate::walk::{Start, Step, Walker};
use crate::{Code, OutputFile, Problem, Result};
use message::Message;
use path::{PathTopics, Pose};

/// Samples, attitudes and positions kept for those that belong to them.
const KEPT: usize = 4096;

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
    #[serde(skip)]
    pub findings: Vec<Problem>,
}

impl Decoded {
    fn lacks(&self) -> Vec<Problem> {
        let (left_out, late) = (Code::SamplesLeftOut, Code::TimesUnordered);
        let lacks = [
            (left_out, self.without_time, "messages left out: their time is unknown"),
            (late, self.late, "samples are out of order: they arrived late"),
            (left_out, self.unplaced, "batches left out: they have no time reference"),
        ];
        let lacks = lacks.into_iter().filter(|(_, count, _)| *count > 0);
        let lacks = lacks.map(|(code, count, what)| code.warning(format!("{count} {what}")));
        let without = without_unit(self.without_unit as usize, "raw sample", "left out");
        lacks.chain(without).chain(self.wholeness.finding()).collect()
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
    let name = from.display().to_string();
    let survey = Capture::survey_of(RecordingReader::open(from)?, &name, |_, _, _| {})?;
    if let Some(model) = link_model {
        (survey.devices.iter()).try_for_each(|device| model.check_device(*device))?;
    }
    let has_positions = |link: &&Link| link.boots.iter().any(|boot| boot.counts.navigation > 0);
    let mut reader = RecordingReader::open(from)?;
    let Some(anchor) = reader.anchor()? else {
        return Err(Code::BadRecording
            .error(
                "it has no anchor from the host's clock to UTC",
                "give a file written by `wimu record`",
            )
            .at(from.display().to_string()));
    };
    let (output, file) = OutputFile::create(to)?;
    let mut decoder = Writer {
        out: RecordingWriter::new(file, output.name(), anchor)?,
        starts: &survey.starts,
        links: BTreeMap::new(),
        paths: BTreeMap::new(),
        // The cable is the first link.
        positioned: survey.links.values().find(has_positions).map(|link| link.role),
        link_model,
        decoded: Decoded::default(),
    };
    let mut walker = Walker::new();
    while let Some(entry) = reader.next_entry()? {
        decoder.out.record(&entry)?;
        walker.push(entry, &mut |role, start, step| decoder.take(role, start, &step))?;
    }
    let links = walker.finish(&mut |role, start, step| decoder.take(role, start, &step))?;
    let unplaced = links.iter().map(|(_, link)| link.batches_unplaced);
    decoder.decoded.unplaced = unplaced.sum();
    for path in std::mem::take(&mut decoder.paths).into_values() {
        path.finish(decoder.out.ros())?;
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
    let set = boot.parameters_of(&boot.epochs().last()?.epoch).ok()?;
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
    let element =
        |i: usize, j: usize| (0..3).map(|k| rotation[i][k] * variance[k] * rotation[j][k]).sum();
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| element(i, j)))
}

/// Number of the latest sample of either stream.
fn latest_sequence(boot: &Boot) -> Option<u32> {
    let last = [boot.raw(), boot.corrected()].map(|samples| Some(samples.last()?.sequence));
    let later = |a: u32, b: u32| if sequence_order(a, b).is_gt() { a } else { b };
    last.into_iter().flatten().reduce(later)
}

/// The next position whose sample is known, with the sample's time and angular rate; those whose sample was lost are left
/// out.
fn next_position(boot: &mut Boot) -> Option<(Navigation, DeviceTimeUs, [f64; 3])> {
    let latest = latest_sequence(boot)?;
    while let Some(next) = boot.navigation.first().copied() {
        if sequence_order(next.sequence, latest).is_gt() && boot.navigation.len() <= KEPT {
            return None;
        }
        boot.navigation.remove(0);
        if let Some(time) = boot.time_of(next.sequence) {
            let corrected = find(boot.corrected(), next.sequence, |sample| sample.sequence);
            let rate = corrected.and_then(|sample| SampleUnit::Corrected.rad_s(sample.rate));
            return Some((next, time, rate.unwrap_or_default()));
        }
    }
    None
}

struct Writer<'a> {
    out: RecordingWriter<std::fs::File>,
    starts: &'a BTreeMap<Start, StartData>,
    /// The latest data of each link.
    links: BTreeMap<LinkRole, Link>,
    /// Positions of each link's start.
    paths: BTreeMap<(LinkRole, Start), PathTopics>,
    /// The link whose positions are transforms.
    positioned: Option<LinkRole>,
    link_model: Option<&'a LinkModel>,
    decoded: Decoded,
}

/// Where a message belongs.
#[derive(Clone, Copy)]
struct Source<'a> {
    role: LinkRole,
    start: Start,
    /// What is known of the start.
    known: Option<&'a StartData>,
    /// When it arrived, ns on the host's monotonic clock.
    arrived_ns: u64,
}

impl<'a> Source<'a> {
    fn clock(&self) -> Option<&'a ClockModel> {
        self.known?.clock()
    }
}

impl Writer<'_> {
    fn take(&mut self, role: LinkRole, start: Start, step: &Step) -> Result<()> {
        let Step::Arrival(arrival) = step else {
            return Ok(());
        };
        let source =
            Source { role, start, known: self.starts.get(&start), arrived_ns: arrival.host_ns };
        let mut link = (self.links.remove(&role)).unwrap_or_else(|| Link::new(role));
        link.take_event(&arrival.event);
        link.boots.drain(..link.boots.len() - 1);
        let boot = link.latest();
        boot.keep_latest(KEPT);
        match &arrival.event {
            Event::Samples(samples) => {
                self.positions(source, boot)?;
                self.samples(source, boot, samples)?;
            }
            Event::Late(samples) => {
                self.decoded.late += samples.values.len() as u64;
                self.samples(source, boot, samples)?;
            }
            Event::Navigation(sent) if sent.flags == 0 && sent.phase != Phase::Searching => {
                self.positions(source, boot)?;
            }
            Event::Navigation(_) => {
                boot.navigation.pop();
            }
            Event::Environment(environment) => self.environment(source, boot, environment)?,
            _ => {}
        }
        self.links.insert(role, link);
        Ok(())
    }

    fn samples(&mut self, source: Source, boot: &Boot, samples: &Samples) -> Result<()> {
        let (stream, sensor) = (samples.stream, samples.sensor);
        let kind = match stream {
            Stream::Raw => Kind::Raw,
            Stream::Corrected => Kind::Corrected,
        };
        let model = (self.link_model).filter(|model| sensor == 0 && model.is_of(source.role));
        let gyroscope = gyroscope_of(boot).filter(|_| stream == Stream::Corrected);
        for sample in samples.iter() {
            let unit = (source.known).and_then(|start| start.unit(stream, sensor, sample.sequence));
            let Some(unit) = unit else {
                self.decoded.without_unit += 1;
                continue;
            };
            let (force, rate) = (unit.mps2(sample.value), unit.rad_s(sample.rate));
            let force = model.map_or(force, |model| model.correct(force));
            let attitude = match stream {
                Stream::Raw => None,
                Stream::Corrected => find(&boot.attitude, sample.sequence, |a| a.sequence),
            };
            let mut fields = imu(force, rate, attitude);
            if let (Some(rate), Some((sd, alignment))) = (rate, &gyroscope) {
                let covariance = rate_covariance(rate, sd, alignment);
                fields[16..25].copy_from_slice(covariance.as_flattened());
            }
            self.write(source, (sensor, kind), sample.time, &fields)?;
        }
        Ok(())
    }

    fn environment(&mut self, source: Source, boot: &Boot, sent: &Environment) -> Result<()> {
        let time = DeviceTimeUs(sent.time_us);
        let field = sent.magnetic_field_nt.map(|nt| nt.map(f64::from));
        for (kind, nt) in
            [(Kind::Magnetic, field), (Kind::MagneticCorrected, boot.corrected_field_nt(sent))]
        {
            let Some(nt) = nt else { continue };
            let mut fields = [0.0; 12];
            fields[..3].copy_from_slice(&nt.map(|axis| axis * 1e-9));
            self.write(source, (0, kind), time, &fields)?;
        }
        match sent.temperature_centi_c {
            Some(centi) => {
                let fields = [f64::from(centi) / 100.0, 0.0];
                self.write(source, (0, Kind::Temperature), time, &fields)
            }
            None => Ok(()),
        }
    }

    /// Writes the positions whose samples have arrived.
    fn positions(&mut self, source: Source, boot: &mut Boot) -> Result<()> {
        let anchor = self.out.anchor();
        while let Some((navigation, time, rate_rad_s)) = next_position(boot) {
            let Some(clock) = source.clock() else {
                self.decoded.without_time += 1;
                continue;
            };
            let attitude = find(&boot.attitude, navigation.sequence, |a| a.sequence);
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
                rate_rad_s,
            };
            let key = (source.role, source.start);
            let transforms = self.positioned == Some(source.role);
            let new = || PathTopics::new(&format!("/{}", source.role), transforms);
            let path = self.paths.entry(key).or_insert_with(new);
            path.push(self.out.ros(), anchor.to_utc_ns(source.arrived_ns), &pose)?;
        }
        Ok(())
    }

    /// One message: a header and numbers.
    fn write(
        &mut self,
        source: Source,
        (sensor, kind): (u8, Kind),
        time: DeviceTimeUs,
        fields: &[f64],
    ) -> Result<()> {
        let Some(clock) = source.clock() else {
            self.decoded.without_time += 1;
            return Ok(());
        };
        let sensor_name = match sensor {
            0 => "imu".to_owned(),
            further => format!("imu_{further}"),
        };
        let topic = format!("/{}/{sensor_name}/{}", source.role, kind.topic());
        let anchor = self.out.anchor();
        let stamp_ns = anchor.to_utc_ns(clock.host_ns(time));
        let head = Message::new().header(stamp_ns, &format!("{sensor_name}_link"));
        let log_ns = anchor.to_utc_ns(source.arrived_ns);
        let message = head.numbers(fields);
        let file = self.out.ros();
        file.publish(&topic, kind.type_name(), log_ns, stamp_ns, &message)
    }
}
