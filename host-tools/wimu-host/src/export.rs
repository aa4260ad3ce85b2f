//! Export of a recording as a table.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use wimu_link::LinkRole;
use wimu_link::batch::Stream;
use wimu_link::message::{Environment, Navigation};
use wimu_model::{DeviceTimeUs, SpecificForceQ16};

use crate::capture::{Boot, Capture};
use crate::compare::LinkModel;
use crate::csv::{self, CsvWriter};
use crate::decode::TimedSample;
use crate::imu::FIELD_CALIBRATED;
use crate::mcap_file::{RecordingReader, Wholeness};
use crate::replay::find;
use crate::stream::{self, Part};
use crate::units::SampleUnit;
use crate::{Code, OutputFile, Result};

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
/// Those of [`Capture::survey`]; `no_rows` when the link or the sensor has no such stream; `usage` for a link model and
/// a sensor above 0; `data_refused` when
/// the link model is of another device or link; `file_failed`, `file_unreadable`.
pub fn to_csv(
    recording: &Path,
    source: &ExportSource,
    stream: ExportStream,
    path: &Path,
) -> Result<Exported> {
    let survey = Capture::survey(recording, Vec::new())?;
    let link = survey.link(source.role)?;
    let role = link.role;
    let sensors = link.sensors();
    let count = |boot: &Boot| match (stream, source.sensor) {
        (ExportStream::Raw, sensor) => boot.counts.of(sensor, Stream::Raw),
        (_, 1..) => 0,
        (ExportStream::Corrected, 0) => boot.counts.of(0, Stream::Corrected),
        (ExportStream::Navigation, 0) => boot.counts.navigation,
    };
    if link.boots.iter().map(count).sum::<usize>() == 0 {
        let message = format!("the {role} link carried no such samples");
        return Err(match source.sensor {
            0 => Code::NoRows.error(
                message,
                "export another stream or the other link, or switch the stream on with `wimu device settings set`",
            ),
            sensor => Code::NoRows.error(
                format!("{message} of sensor {sensor}"),
                format!("export the raw stream of one of the sensors {sensors:?}"),
            ),
        });
    }
    if let Some(model) = source.link_model {
        if source.sensor > 0 {
            return Err(Code::Usage.error(
                format!("a link's error model does not apply to sensor {}", source.sensor),
                "leave out --with, or --sensor",
            ));
        }
        model.check_role(role)?;
        if let Some(hello) = link.hello() {
            model.check_device(hello.device_id)?;
        }
    }
    let (output, file) = OutputFile::create(path)?;
    let has_gyroscope = link.boots.iter().any(|boot| boot.counts.rates_of(source.sensor) > 0);
    let has_attitude = link.boots.iter().any(|boot| boot.counts.attitudes > 0);
    let columns = columns(stream, source.sensor, has_gyroscope, has_attitude);
    let mut table = Table {
        stream,
        source,
        has_gyroscope,
        has_attitude,
        survey: &survey,
        boots: &link.boots,
        writer: CsvWriter::new(BufWriter::new(file), output.name(), &columns)?,
        rows: 0,
        sensitivity: None,
        ranges_differ: false,
        without_unit: 0,
    };
    stream::read(&mut RecordingReader::open(recording)?, role, |part| table.part(part))?;
    table.writer.finish()?;
    output.finish()?;
    Ok(Exported {
        role,
        rows: table.rows,
        without_unit: table.without_unit,
        ranges_differ: table.ranges_differ,
        sensors,
        wholeness: survey.wholeness,
    })
}

struct Table<'a> {
    stream: ExportStream,
    source: &'a ExportSource<'a>,
    has_gyroscope: bool,
    has_attitude: bool,
    survey: &'a Capture,
    /// Those of the link.
    boots: &'a [Boot],
    writer: CsvWriter<BufWriter<File>>,
    rows: usize,
    /// Sensitivity of the latest raw sample, LSB/g.
    sensitivity: Option<f64>,
    ranges_differ: bool,
    without_unit: usize,
}

/// Temperature and field of a row.
#[derive(Clone, Copy, Default)]
struct Surroundings {
    temperature_c: Option<f64>,
    field_ut: Option<[f64; 3]>,
    field_calibrated: bool,
}

impl Table<'_> {
    /// Writes a part of the link.
    fn part(&mut self, part: &Part) -> Result<()> {
        let stream = match self.stream {
            ExportStream::Raw => Stream::Raw,
            ExportStream::Corrected => Stream::Corrected,
            ExportStream::Navigation => {
                return (part.navigation().iter()).try_for_each(|sent| self.position(part, sent));
            }
        };
        let mut latest: Option<(&Environment, Surroundings)> = None;
        for sample in part.samples(self.source.sensor, stream) {
            let sent = part.environment_at(sample.time);
            if sent != latest.map(|(sent, _)| sent) {
                latest = sent.map(|sent| (sent, self.surroundings(part, sent)));
            }
            let surroundings = latest.map(|(_, surroundings)| surroundings);
            self.sample(part, sample, surroundings.unwrap_or_default())?;
        }
        Ok(())
    }

    fn surroundings(&self, part: &Part, sent: &Environment) -> Surroundings {
        let corrected = match self.stream {
            ExportStream::Corrected => part.boot.corrected_field_nt(sent),
            _ => None,
        };
        let field_nt = corrected.or_else(|| Some(sent.magnetic_field_nt?.map(f64::from)));
        let temperature_c = sent.temperature_centi_c.map(|centi| f64::from(centi) / 100.0);
        Surroundings {
            temperature_c,
            field_ut: field_nt.map(|nt| nt.map(|axis| axis / 1000.0)),
            field_calibrated: corrected.is_some(),
        }
    }

    fn sample(&mut self, part: &Part, sample: &TimedSample, at: Surroundings) -> Result<()> {
        let is_corrected = self.stream == ExportStream::Corrected;
        let unit = self.unit(part, sample.sequence);
        let value = match (self.source.link_model, unit) {
            (Some(model), Some(unit)) => model.correct_lsb(sample.value, unit.mps2_per_lsb()),
            (Some(_), None) => {
                self.without_unit += 1;
                return Ok(());
            }
            (None, _) => sample.value,
        };
        let value =
            if is_corrected { SpecificForceQ16(value).to_mps2().0 } else { value.map(f64::from) };
        let time_ns = self.time_ns(part, sample.time);
        let row = (self.writer.time(time_ns).vector(Some(value)))
            .vector(at.field_ut)
            .number(at.temperature_c)
            .field(sample.sequence);
        if let Some(SampleUnit::Corrected) = unit {
            row.field(u8::from(at.field_calibrated));
            if self.has_gyroscope {
                row.vector(SampleUnit::Corrected.rad_s(sample.rate));
            }
        } else {
            let unit = match unit {
                Some(SampleUnit::Raw(unit)) => Some(unit),
                _ => None,
            };
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

    fn position(&mut self, part: &Part, sent: &Navigation) -> Result<()> {
        let metres = |nm: [i64; 3]| Some(nm.map(|nm| nm as f64 * 1e-9));
        let heading_sd = sent.heading_sd_mrad;
        let heading_sd = heading_sd.map(|mrad| (f64::from(mrad) * 1e-3).to_degrees());
        let time = part.boot.time_of(sent.sequence);
        let time_ns = time.and_then(|time| self.time_ns(part, time));
        let row = (self.writer.time(time_ns))
            .vector(metres(sent.position_nm))
            .vector(metres(sent.velocity_nmps))
            .field(f64::from(sent.since_rest_ms) / 1000.0)
            .field(u8::from(sent.flags == 0))
            .field(heading_sd.map_or(String::new(), |degrees| format!("{degrees:.2}")))
            .field(sent.sequence);
        let attitude = find(&part.boot.attitude, sent.sequence, |sent| sent.sequence);
        if let Some(attitude) = attitude.filter(|_| self.has_attitude) {
            row.vector(Some(attitude.to_quaternion()));
        }
        self.rows += 1;
        self.writer.end_row()
    }

    fn unit(&self, part: &Part, sequence: u32) -> Option<SampleUnit> {
        if self.stream == ExportStream::Corrected {
            return Some(SampleUnit::Corrected);
        }
        let start = self.boots.get(part.index)?.start?;
        let start = self.survey.starts.get(&start)?;
        start.unit(Stream::Raw, self.source.sensor, sequence)
    }

    fn time_ns(&self, part: &Part, time: DeviceTimeUs) -> Option<i64> {
        let boot = self.boots.get(part.index);
        let host_ns = boot.and_then(|boot| boot.host_ns(time));
        let utc = (self.survey.anchor.zip(host_ns)).map(|(anchor, ns)| anchor.to_utc_ns(ns));
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
            add(&["Quaternion W", "Quaternion X", "Quaternion Y", "Quaternion Z"]);
        }
        return columns;
    }
    let is_raw = stream == ExportStream::Raw;
    let (force, rate) = if is_raw { ("LSB", "LSB") } else { ("m/s²", "rad/s") };
    let accelerometer = match sensor {
        0 => "Accelerometer".to_owned(),
        _ => format!("Accelerometer {sensor}"),
    };
    columns.extend(csv::axes(&accelerometer, force));
    columns.extend(csv::axes("Magnetometer", "µT"));
    let last = if is_raw { csv::SENSITIVITY } else { FIELD_CALIBRATED };
    columns.extend([csv::TEMPERATURE, "Sequence", last].map(str::to_owned));
    if has_gyroscope {
        columns.extend(csv::axes("Gyroscope", rate));
        let scale = is_raw.then(|| csv::GYROSCOPE_SCALE.to_owned());
        columns.extend(scale);
    }
    columns
}
