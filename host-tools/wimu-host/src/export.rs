//! Export of a recording as a table.

use std::collections::VecDeque;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use wimu_link::LinkRole;
use wimu_link::batch::Stream;
use wimu_link::message::{Attitude, Environment, Navigation};
use wimu_model::{AngularRateQ20, DeviceTimeUs, SpecificForceQ16};

use crate::clock::ClockModel;
use crate::compare::LinkModel;
use crate::csv::{self, CsvWriter};
use crate::decode::{Arrival, Decoder, Event, TimedSample, sequence_order};
use crate::history::Boot;
use crate::mcap_file::{ClockAnchor, Recorded, RecordingReader, Wholeness};
use crate::motion::FIELD_CALIBRATED;
use crate::overview::{BootOverview, Overview};
use crate::units::RawUnits;
use crate::{ErrorCode, OutputFile, Result};

/// Time that samples wait for data that belong to them and arrive later, µs of device time.
const WAIT_US: u64 = 3_000_000;
/// Times of samples kept for the positions computed from them, at most; positions that wait for their sample, at most.
const MAX_TIMES: usize = 16_384;
const MAX_WAITING: usize = 4096;

/// Content of a table. With a gyroscope, samples have its axes, too, and positions an attitude.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportStream {
    /// Counts, LSB, with the raw output of the magnetometer, temperature, and the sensor's nominal
    /// sensitivity, empty where it is unknown because no epoch covers the sample.
    Raw,
    /// Specific force, m/s², body axes, as corrected by the device. Where `Field Calibrated` is 1,
    /// the magnetic field is corrected by the parameters then in use, body axes; where it is 0 it is
    /// the raw output of the magnetometer.
    Corrected,
    /// Velocity and position, as integrated by the device. North is magnetic where `Heading SD` has a value.
    Navigation,
}

/// Source of a table.
#[derive(Clone, Copy, Debug, Default)]
pub struct ExportSource<'a> {
    /// The link; `None` takes the cable if it has raw samples, else the link with the most.
    pub role: Option<LinkRole>,
    /// Index of the sensor. Those above 0 have raw samples only, in columns with this number.
    pub sensor: u8,
    /// Corrects the accelerometer.
    pub link_model: Option<&'a LinkModel>,
}

/// Result of an export.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Exported {
    /// The link.
    pub role: LinkRole,
    /// Number of rows without the header.
    pub rows: usize,
    /// Raw samples of unknown range because no epoch covers them: without a sensitivity, or left out if a link model was
    /// to be applied.
    pub without_unit: usize,
    /// Whether the range changes between rows.
    pub ranges_differ: bool,
    /// Indices of the sensors with raw samples.
    pub sensors: Vec<u8>,
    /// Completeness of the recording.
    pub wholeness: Wholeness,
}

/// Writes a stream of a recording as a CSV file. Times are UTC where the recording has an anchor, else device
/// time. The link model is applied. Reads the recording twice, in memory that does not grow with its length.
///
/// # Errors
/// Those of [`Overview::read`]; `no_rows` when the link or the sensor has no such stream; `usage` for a link model and
/// a sensor above 0; `data_refused` when
/// the link model is of another device or link; `file_failed`, `file_unreadable`.
pub fn to_csv(
    recording: &Path,
    source: &ExportSource,
    stream: ExportStream,
    path: &Path,
) -> Result<Exported> {
    let overview = Overview::read(recording)?;
    let link = overview
        .link(source.role)
        .map_err(|error| error.at(recording.display().to_string()))?;
    let role = link.role;
    let sensors = link.sensors();
    let count = |boot: &BootOverview| match (stream, source.sensor) {
        (ExportStream::Raw, sensor) => boot.tracks.get(&sensor).map_or(0, |track| track.raw),
        (_, 1..) => 0,
        (ExportStream::Corrected, 0) => boot.corrected,
        (ExportStream::Navigation, 0) => boot.navigation,
    };
    if link.boots.iter().map(count).sum::<usize>() == 0 {
        let message = format!("the {role} link carried no such samples");
        return Err(match source.sensor {
            0 => ErrorCode::NoRows.error(
                message,
                "export another stream or the other link, or switch the stream on with `wimu settings set`",
            ),
            sensor => ErrorCode::NoRows.error(
                format!("{message} of sensor {sensor}"),
                format!("export the raw stream of one of the sensors {sensors:?}"),
            ),
        });
    }
    if let Some(model) = source.link_model {
        if source.sensor > 0 {
            return Err(ErrorCode::Usage.error(
                format!(
                    "a link's error model does not apply to sensor {}",
                    source.sensor
                ),
                "leave out --link-model, or --sensor",
            ));
        }
        model.check_role(role)?;
        if let Some(hello) = &link.hello {
            model.check_device(hello.device_id)?;
        }
    }
    let (output, file) = OutputFile::create(path)?;
    let rates = |boot: &BootOverview| boot.tracks.get(&source.sensor).map_or(0, |t| t.rates);
    let has_gyroscope = link.boots.iter().any(|boot| rates(boot) > 0);
    let has_attitude = link.boots.iter().any(|boot| boot.attitudes > 0);
    let columns = columns(stream, source.sensor, has_gyroscope, has_attitude);
    let mut boots = link.boots.iter();
    let mut table = Table {
        stream,
        anchor: overview.anchor,
        source,
        has_gyroscope,
        has_attitude,
        clock: None,
        writer: CsvWriter::new(BufWriter::new(file), output.name(), &columns)?,
        rows: 0,
        sensitivity: None,
        ranges_differ: false,
        without_unit: 0,
        units: None,
        start: Start::default(),
    };
    table.begin(boots.next());
    let mut reader = RecordingReader::open(recording)?;
    let mut decoder = Decoder::new();
    while let Some(entry) = reader.next_entry()? {
        match entry {
            Recorded::Received(received) if received.role == role => {
                let mut outcome = Ok(());
                decoder.push(received.host_ns, &received.bytes, |arrival| {
                    if outcome.is_ok() {
                        outcome = table.take(&arrival, &mut boots);
                    }
                });
                outcome?;
            }
            Recorded::Lost { role: lost, .. } if lost == role => decoder.interrupt(),
            Recorded::Damaged { role: damaged, .. } if damaged == role => decoder.skip(),
            _ => {}
        }
    }
    table.write_until(u64::MAX)?;
    table.writer.finish()?;
    output.finish()?;
    Ok(Exported {
        role,
        rows: table.rows,
        without_unit: table.without_unit,
        ranges_differ: table.ranges_differ,
        sensors,
        wholeness: overview.wholeness,
    })
}

impl From<Stream> for ExportStream {
    fn from(stream: Stream) -> Self {
        match stream {
            Stream::Raw => Self::Raw,
            Stream::Corrected => Self::Corrected,
        }
    }
}

/// Data of one start of the device that are still needed.
#[derive(Default)]
struct Start {
    samples: VecDeque<TimedSample>,
    navigation: VecDeque<Navigation>,
    attitude: VecDeque<Attitude>,
    environment: VecDeque<Environment>,
    /// Times of samples, by number.
    times: VecDeque<(u32, DeviceTimeUs)>,
    /// Parameters and latest epochs: they define the units of samples and field.
    boot: Boot,
    /// The latest device time, µs.
    latest_us: u64,
    /// Number of the latest sample that was written.
    written: Option<u32>,
    /// Latest temperature and field.
    temperature_c: Option<f64>,
    field_ut: Option<[f64; 3]>,
    field_calibrated: bool,
}

impl Start {
    /// Index of the time of a sample, or where it belongs.
    fn find_time(&self, sequence: u32) -> std::result::Result<usize, usize> {
        self.times
            .binary_search_by(|(number, _)| sequence_order(*number, sequence))
    }
}

struct Table<'a> {
    stream: ExportStream,
    anchor: Option<ClockAnchor>,
    source: &'a ExportSource<'a>,
    has_gyroscope: bool,
    has_attitude: bool,
    clock: Option<&'a ClockModel>,
    writer: CsvWriter<BufWriter<File>>,
    rows: usize,
    /// Sensitivity of the latest raw sample, LSB/g.
    sensitivity: Option<f64>,
    ranges_differ: bool,
    without_unit: usize,
    units: Option<&'a RawUnits>,
    start: Start,
}

impl<'a> Table<'a> {
    /// Begins a start of the device.
    fn begin(&mut self, boot: Option<&'a BootOverview>) {
        self.start = Start::default();
        self.clock = boot.and_then(|boot| boot.clock.as_ref());
        let track = boot.and_then(|boot| boot.tracks.get(&self.source.sensor));
        self.units = track.map(|track| &track.units);
        self.start.boot.parameters = boot.map_or_else(Vec::new, |boot| boot.parameters.clone());
    }

    /// Takes an arrival; `boots` are the starts that follow.
    fn take(
        &mut self,
        arrival: &Arrival,
        boots: &mut impl Iterator<Item = &'a BootOverview>,
    ) -> Result<()> {
        let sensor = self.source.sensor;
        let start = &mut self.start;
        let event = match &arrival.event {
            Event::Further(event) if event.sensor() == Some(sensor) => event,
            event => event,
        };
        match event {
            // The same condition as in the overview.
            Event::Restart { .. } if !start.boot.is_empty() => {
                self.write_until(u64::MAX)?;
                self.begin(boots.next());
            }
            Event::Hello(hello) => start.boot.hello = Some(*hello),
            Event::Epoch { epoch, .. } => {
                start.latest_us = start.latest_us.max(epoch.time_us);
                let before = start.latest_us.saturating_sub(2 * WAIT_US);
                if epoch.sensor == 0 {
                    start.boot.add_epoch(event, before);
                }
            }
            Event::Environment(environment) => push(&mut start.environment, *environment),
            Event::Attitude(attitude) if self.has_attitude => push(&mut start.attitude, *attitude),
            Event::Navigation(navigation) if self.stream == ExportStream::Navigation => {
                start.navigation.push_back(*navigation);
            }
            Event::Late(samples)
                if self.stream == samples.stream.into() && samples.sensor == sensor =>
            {
                for late in samples.iter() {
                    let is_behind = |number| sequence_order(late.sequence, number).is_gt();
                    if start.written.is_none_or(is_behind) {
                        let at = start
                            .samples
                            .partition_point(|sample| is_behind(sample.sequence));
                        start.samples.insert(at, late);
                    }
                }
            }
            Event::Samples(samples) => {
                let wanted = ExportStream::from(samples.stream);
                if wanted == ExportStream::Raw && samples.sensor == 0 {
                    // One sample marks the start as begun.
                    start.boot.raw.clear();
                    start.boot.raw.extend(samples.iter().next());
                }
                if self.stream == wanted && samples.sensor == sensor {
                    start.samples.extend(samples.iter());
                } else if self.stream == ExportStream::Navigation {
                    for sample in samples.iter() {
                        // Either stream has the time.
                        if let Err(at) = start.find_time(sample.sequence) {
                            start.times.insert(at, (sample.sequence, sample.time));
                        }
                    }
                }
                if let Some(last) = samples.iter().last() {
                    start.latest_us = start.latest_us.max(last.time.0);
                }
                let until_us = start.latest_us.saturating_sub(WAIT_US);
                self.write_until(until_us)?;
            }
            _ => {}
        }
        Ok(())
    }

    /// Writes the samples before a device time, µs, and the positions of known time; with the maximum, all.
    fn write_until(&mut self, until_us: u64) -> Result<()> {
        let all = until_us == u64::MAX;
        let due = |sample: &TimedSample| all || sample.time.0 < until_us;
        while let Some(sample) = pop_if(&mut self.start.samples, due) {
            self.sample(sample)?;
        }
        while let Some(navigation) = self.start.navigation.front().copied() {
            let start = &mut self.start;
            let found = start.find_time(navigation.sequence);
            let time = found.ok().map(|at| start.times[at].1);
            if time.is_none() && !all && start.navigation.len() <= MAX_WAITING {
                // Its sample may still arrive; those after it wait, too.
                let passed = navigation.sequence.wrapping_add(MAX_WAITING as u32);
                let has_passed = |(last, _): &_| sequence_order(*last, passed).is_ge();
                if !start.times.back().is_some_and(has_passed) {
                    break;
                }
            }
            start.navigation.pop_front();
            self.position(&navigation, time)?;
        }
        while self.start.times.len() > MAX_TIMES {
            self.start.times.pop_front();
        }
        Ok(())
    }

    fn sample(&mut self, sample: TimedSample) -> Result<()> {
        let start = &mut self.start;
        start.written = Some(sample.sequence);
        let passed = |next: &Environment| next.time_us <= sample.time.0;
        while let Some(next) = pop_if(&mut start.environment, passed) {
            start.temperature_c = next
                .temperature_centi_c
                .map(|centi| f64::from(centi) / 100.0);
            let corrected = match self.stream {
                ExportStream::Corrected => start.boot.corrected_field_nt(&next),
                _ => None,
            };
            start.field_calibrated = corrected.is_some();
            start.field_ut = corrected
                .or_else(|| Some(next.magnetic_field_nt?.map(f64::from)))
                .map(|nt| nt.map(|axis| axis / 1000.0));
        }
        let time_ns = self.time_ns(sample.time);
        let is_corrected = self.stream == ExportStream::Corrected;
        let unit = self.units.and_then(|units| units.of(sample.sequence));
        let value = match (is_corrected, self.source.link_model, unit) {
            (true, Some(model), _) => {
                model.correct_lsb(sample.value, 1.0 / SpecificForceQ16::LSB_PER_MPS2)
            }
            (false, Some(model), Some(unit)) => {
                model.correct_lsb(sample.value, unit.mps2_per_lsb())
            }
            (false, Some(_), None) => {
                self.without_unit += 1;
                return Ok(());
            }
            (_, None, _) => sample.value,
        };
        let value = match is_corrected {
            true => SpecificForceQ16(value).to_mps2().0,
            false => value.map(f64::from),
        };
        let row = (self.writer.time(time_ns).vector(Some(value)))
            .vector(self.start.field_ut)
            .number(self.start.temperature_c)
            .field(sample.sequence);
        if is_corrected {
            row.field(u8::from(self.start.field_calibrated));
            if self.has_gyroscope {
                row.vector(sample.rate.map(|rate| AngularRateQ20(rate).to_rad_s()));
            }
        } else {
            let sensitivity = unit.map(|unit| unit.sensitivity.lsb_per_g());
            row.number(sensitivity);
            if self.has_gyroscope {
                let scale = unit.and_then(|unit| unit.gyroscope);
                row.vector(sample.rate.map(|rate| rate.map(f64::from)));
                row.field(scale.map_or(String::new(), |scale| scale.rad_s_per_lsb.to_string()));
            }
            self.without_unit += usize::from(unit.is_none());
            let before = sensitivity.and_then(|sensitivity| self.sensitivity.replace(sensitivity));
            self.ranges_differ |= before.is_some_and(|before| Some(before) != sensitivity);
        }
        self.rows += 1;
        self.writer.end_row()
    }

    fn position(&mut self, navigation: &Navigation, time: Option<DeviceTimeUs>) -> Result<()> {
        let metres = |nm: [i64; 3]| Some(nm.map(|nm| nm as f64 * 1e-9));
        let heading_sd = navigation.heading_sd_mrad;
        let heading_sd = heading_sd.map(|mrad| (f64::from(mrad) * 1e-3).to_degrees());
        let time_ns = time.and_then(|time| self.time_ns(time));
        let row = (self.writer.time(time_ns))
            .vector(metres(navigation.position_nm))
            .vector(metres(navigation.velocity_nmps))
            .field(f64::from(navigation.since_rest_ms) / 1000.0)
            .field(u8::from(navigation.flags == 0))
            .field(heading_sd.map_or(String::new(), |degrees| format!("{degrees:.2}")))
            .field(navigation.sequence);
        let attitude = &mut self.start.attitude;
        let is_before =
            |next: &Attitude| sequence_order(next.sequence, navigation.sequence).is_lt();
        while pop_if(attitude, is_before).is_some() {}
        if let Some(attitude) = pop_if(attitude, |next| next.sequence == navigation.sequence) {
            row.vector(Some(attitude.to_quaternion()));
        }
        self.rows += 1;
        self.writer.end_row()
    }

    fn time_ns(&self, time: DeviceTimeUs) -> Option<i64> {
        let utc = self
            .anchor
            .zip(self.clock)
            .map(|(anchor, clock)| anchor.to_utc_ns(clock.host_ns(time)));
        i64::try_from(utc.unwrap_or(time.0.saturating_mul(1000))).ok()
    }
}

/// The columns of a table.
fn columns(
    stream: ExportStream,
    sensor: u8,
    has_gyroscope: bool,
    has_attitude: bool,
) -> Vec<String> {
    let mut columns = vec![csv::TIME.to_owned()];
    let mut add = |names: &[&str]| columns.extend(names.iter().map(|name| (*name).to_owned()));
    if stream == ExportStream::Navigation {
        add(&["Position E (m)", "Position N (m)", "Position U (m)"]);
        add(&["Velocity E (m/s)", "Velocity N (m/s)", "Velocity U (m/s)"]);
        add(&["Since Rest (s)", "Valid", "Heading SD (deg)", "Sequence"]);
        if has_attitude {
            add(&[
                "Quaternion W",
                "Quaternion X",
                "Quaternion Y",
                "Quaternion Z",
            ]);
        }
        return columns;
    }
    let is_raw = stream == ExportStream::Raw;
    let (force, rate) = if is_raw {
        ("LSB", "LSB")
    } else {
        ("m/s²", "rad/s")
    };
    let accelerometer = match sensor {
        0 => "Accelerometer".to_owned(),
        _ => format!("Accelerometer {sensor}"),
    };
    columns.extend(csv::axes(&accelerometer, force));
    columns.extend(csv::axes("Magnetometer", "µT"));
    let last = if is_raw {
        csv::SENSITIVITY
    } else {
        FIELD_CALIBRATED
    };
    columns.extend([csv::TEMPERATURE, "Sequence", last].map(str::to_owned));
    if has_gyroscope {
        columns.extend(csv::axes("Gyroscope", rate));
        let scale = is_raw.then(|| "Gyroscope Scale (rad/s/LSB)".to_owned());
        columns.extend(scale);
    }
    columns
}

/// Adds an item; drops the first one where too many wait.
fn push<T>(queue: &mut VecDeque<T>, item: T) {
    queue.push_back(item);
    if queue.len() > MAX_WAITING {
        queue.pop_front();
    }
}

fn pop_if<T>(queue: &mut VecDeque<T>, wanted: impl Fn(&T) -> bool) -> Option<T> {
    queue
        .front()
        .is_some_and(wanted)
        .then(|| queue.pop_front())?
}

#[cfg(test)]
mod tests;
