//! The raw samples of a link as a recording.

use std::collections::BTreeMap;

use wimu_link::LinkRole;
use wimu_link::batch::Stream;
use wimu_link::hello::sensor;
use wimu_link::message::Environment;
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::samples::ASSUMED_RATE_HZ;
use super::{Quantity, Recording, Sink, TrackId, TrackInfo, Unit};
use crate::capture::{Boot, EpochMark, Link};
use crate::decode::TimedSample;
use crate::stream::Part;
use crate::{Code, Result};

/// Name of the format of wimu's recordings in docs/reference/formats.md.
pub(crate) const FORMAT: &str = "wimu recording";

impl Recording {
    /// The raw samples of all sensors of a link, at device time from the first sample on, continued where the device
    /// restarted; `name` is its name in errors.
    ///
    /// # Errors
    /// `no_rows` without samples, `data_refused` when the range changed.
    pub fn of_link(link: &Link, name: &str) -> Result<Self> {
        let mut recording = Self::new(name);
        recording.format = FORMAT;
        let mut rows = LinkRows::new(&mut recording);
        for boot in &link.boots {
            rows.part(&Part::from(boot), name)?;
        }
        rows.finish(link.role, name)?;
        Ok(recording)
    }
}

impl Recording {
    /// The same of one start of the device, at its time.
    pub(crate) fn of_boot(boot: &Boot, name: &str) -> Result<Self> {
        let mut recording = Self::new(name);
        let mut rows = LinkRows::new(&mut recording);
        rows.begin.1 = Some(0);
        rows.part(&Part::from(boot), name)?;
        Ok(recording)
    }
}

/// Hands the raw samples of a link to a sink, one start of the device after the other.
pub(crate) struct LinkRows<'a> {
    sink: &'a mut dyn Sink,
    /// By sensor.
    tracks: BTreeMap<u8, Tracks>,
    /// Time of the first sample of this start, ns, and its device time, µs.
    begin: (i64, Option<u64>),
    /// Time of the latest sample, ns.
    latest_ns: i64,
}

/// The tracks of a sensor.
struct Tracks {
    range_g: Option<u8>,
    rate_hz: Option<f64>,
    force: TrackId,
    /// Angular rate, magnetic field and temperature, of sensor 0.
    rate: Option<TrackId>,
    environment: Option<[TrackId; 2]>,
    next_sequence: Option<u32>,
}

impl<'a> LinkRows<'a> {
    pub(crate) fn new(sink: &'a mut dyn Sink) -> Self {
        Self { sink, tracks: BTreeMap::new(), begin: (0, None), latest_ns: 0 }
    }

    /// Hands the raw samples of a part on.
    ///
    /// # Errors
    /// `data_refused` when the range changes.
    pub(crate) fn part(&mut self, part: &Part, name: &str) -> Result<()> {
        for (sensor, stream) in part.boot.samples.keys() {
            let samples = part.samples(*sensor, *stream);
            if let (Stream::Raw, Some(first)) = (stream, samples.first()) {
                self.begin.1.get_or_insert(first.time.0);
                self.sensor(part, *sensor, samples, name)?;
            }
        }
        if let (true, (_, Some(_))) = (part.is_last, self.begin) {
            let rate_hz = self.tracks.values().find_map(|tracks| tracks.rate_hz);
            let period_ns = (1e9 / rate_hz.unwrap_or(ASSUMED_RATE_HZ)) as i64;
            self.begin = (self.latest_ns.saturating_add(period_ns), None);
            self.tracks.values_mut().for_each(|tracks| tracks.next_sequence = None);
        }
        Ok(())
    }

    /// The samples of a sensor.
    fn sensor(
        &mut self,
        part: &Part,
        sensor: u8,
        samples: &[TimedSample],
        name: &str,
    ) -> Result<()> {
        let boot = part.boot;
        let (begin_ns, begin_us) = (self.begin.0, self.begin.1.unwrap_or_default());
        let time_ns = |us: u64| {
            let since_us = us.wrapping_sub(begin_us) as i64;
            since_us.saturating_mul(1000).saturating_add(begin_ns)
        };
        let sink = &mut *self.sink;
        let tracks = self.tracks.entry(sensor).or_insert_with(|| Tracks::of(boot, sensor, sink));
        one_range(boot.epochs_of(sensor), tracks, name)?;
        if let Some([field, temperature]) = tracks.environment {
            for environment in environment(part) {
                let time = time_ns(environment.time_us);
                if let Some(nt) = environment.magnetic_field_nt {
                    sink.row(field, time, &nt.map(|axis| f64::from(axis) * 1e-9));
                }
                if let Some(centi_c) = environment.temperature_centi_c {
                    sink.row(temperature, time, &[f64::from(centi_c) / 100.0]);
                }
            }
        }
        for sample in samples {
            // Between two starts samples are missing, too.
            let is_first = tracks.next_sequence.is_none() && begin_ns == 0;
            if tracks.next_sequence != Some(sample.sequence) && !is_first {
                sink.gap(tracks.force);
            }
            tracks.next_sequence = Some(sample.sequence.wrapping_add(1));
            let time = time_ns(sample.time.0);
            self.latest_ns = self.latest_ns.max(time);
            sink.row(tracks.force, time, &sample.value.map(f64::from));
            if let (Some(track), Some(value)) = (tracks.rate, sample.rate) {
                sink.row(track, time, &value.map(f64::from));
            }
        }
        Ok(())
    }

    /// Whether there was no sample.
    pub(crate) fn is_empty(&self) -> bool {
        self.tracks.is_empty()
    }

    /// # Errors
    /// `no_rows` without samples.
    pub(crate) fn finish(self, role: LinkRole, name: &str) -> Result<()> {
        if !self.is_empty() {
            return Ok(());
        }
        let message = format!("no raw samples came over the {role} link");
        let remedy =
            "switch the raw stream on with `wimu device settings set`, or use the other link";
        Err(Code::NoRows.error(message, remedy).at(name))
    }
}

/// Magnetic fields and temperatures of a part. A board that replays another sensor's counts has its own thermometer and
/// magnetometer, which do not belong to the counts.
fn environment<'a>(part: &'a Part) -> &'a [Environment] {
    match part.boot.hello.map(|hello| hello.sensor.number) {
        Some(sensor::REPLAY) => &[],
        _ => part.environment(),
    }
}

impl Tracks {
    /// Those of a sensor whose first start with samples is `first`.
    fn of(first: &Boot, sensor: u8, sink: &mut dyn Sink) -> Self {
        let epoch = first.epochs_of(sensor).first().map(|mark| &mark.epoch);
        let range_g = epoch.map(|epoch| epoch.range_g);
        let set_hz = first.settings.first().filter(|_| sensor == 0);
        let set_hz = set_hz.map(|settings| f64::from(settings.rate_hz));
        let rate_hz = set_hz.or(epoch.map(|epoch| 1e9 / f64::from(epoch.period_ns.max(1))));
        let counts = |si_per_lsb| Unit::Counts { si_per_lsb };
        let name = if sensor == 0 { "raw".to_owned() } else { format!("raw {sensor}") };
        let sensitivity = first.nominal_sensitivity(sensor).map(|s| s.mps2_per_lsb());
        let mut info = TrackInfo::new(name, Quantity::SpecificForce, counts(sensitivity));
        info.sensor = sensor;
        info.rate_hz = rate_hz;
        info.device = first.sensor().filter(|_| sensor == 0);
        info.device_id = first.hello.map(|hello| hello.device_id);
        info.full_scale = range_g.map(|g| f64::from(g) * STANDARD_GRAVITY_MPS2);
        let mut tracks = Self {
            range_g,
            rate_hz,
            force: sink.track(info),
            rate: None,
            environment: None,
            next_sequence: None,
        };
        if sensor == 0 {
            let nominal = epoch.and_then(|epoch| Some(epoch.gyroscope?.rad_s_per_lsb));
            let rate = TrackInfo::new("raw", Quantity::AngularRate, counts(nominal));
            let has_gyroscope = first.raw().iter().any(|sample| sample.rate.is_some());
            tracks.rate = has_gyroscope.then(|| sink.track(rate));
            let environment = [Quantity::MagneticField, Quantity::Temperature];
            tracks.environment = Some(
                environment
                    .map(|quantity| sink.track(TrackInfo::new("environment", quantity, Unit::Si))),
            );
        }
        tracks
    }
}

/// Refuses epochs of another range than the first one.
fn one_range(epochs: &[EpochMark], tracks: &mut Tracks, name: &str) -> Result<()> {
    for mark in epochs {
        let before = *tracks.range_g.get_or_insert(mark.epoch.range_g);
        if before != mark.epoch.range_g {
            let message = format!(
                "the range changes from ±{before} g to ±{} g at sample {}",
                mark.epoch.range_g, mark.epoch.sequence
            );
            let remedy = "record at one range: a calibration is valid at one range only";
            return Err(Code::DataRefused.error(message, remedy).at(name));
        }
    }
    Ok(())
}
