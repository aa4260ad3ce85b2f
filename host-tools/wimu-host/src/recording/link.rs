//! The raw samples of a link as a recording.

use std::collections::BTreeMap;

use wimu_link::LinkRole;
use wimu_link::batch::Stream;
use wimu_link::hello::sensor;
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::samples::ASSUMED_RATE_HZ;
use super::{Quantity, Recording, Sink, TrackId, TrackInfo, Unit};
use crate::decode::TimedSample;
use crate::history::{Boot, LinkHistory};
use crate::stream::Part;
use crate::{Code, Result};

/// Name of the format of wimu's recordings in docs/FORMATS.md.
pub(crate) const FORMAT: &str = "wimu recording";

impl Recording {
    /// The raw samples of all sensors of a link, at device time from the first sample on, continued where the device
    /// restarted; `name` is its name in errors.
    ///
    /// # Errors
    /// `no_rows` without samples, `data_refused` when the range changed.
    pub fn of_link(link: &LinkHistory, name: &str) -> Result<Self> {
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
    /// The same of one start of the device, at device time from the first sample on.
    pub(crate) fn of_boot(boot: &Boot, name: &str) -> Result<Self> {
        let mut recording = Self::new(name);
        LinkRows::new(&mut recording).part(&Part::from(boot), name)?;
        Ok(recording)
    }
}

/// Hands the raw samples of a link to a sink, one start of the device after the other.
pub(crate) struct LinkRows<'a> {
    sink: &'a mut dyn Sink,
    tracks: Option<Tracks>,
    /// Time of the first sample of this start, ns, and its device time, µs.
    begin: (i64, Option<u64>),
    /// Time of the latest sample, ns.
    latest_ns: i64,
    next_sequence: Option<u32>,
    /// Accelerometers with index 1 and up, and the number of their next sample.
    further: BTreeMap<u8, (TrackId, Option<u32>)>,
}

struct Tracks {
    range_g: Option<u8>,
    rate_hz: f64,
    force: TrackId,
    rate: Option<TrackId>,
    field: TrackId,
    temperature: TrackId,
}

impl<'a> LinkRows<'a> {
    pub(crate) fn new(sink: &'a mut dyn Sink) -> Self {
        Self {
            sink,
            tracks: None,
            begin: (0, None),
            latest_ns: 0,
            next_sequence: None,
            further: BTreeMap::new(),
        }
    }

    /// Hands the raw samples of a part on.
    ///
    /// # Errors
    /// `data_refused` when the range changes.
    pub(crate) fn part(&mut self, part: &Part, name: &str) -> Result<()> {
        let samples = part.samples(0, Stream::Raw);
        let further = |sensor: &u8| part.samples(*sensor, Stream::Raw).first();
        let without = || (self.tracks.as_ref()).and(part.boot.further.keys().find_map(further));
        if let Some(first) = samples.first().or_else(without) {
            self.rows(part, samples, first.time.0, name)?;
        }
        if let (true, Some(tracks), (_, Some(_))) = (part.is_last, &self.tracks, self.begin) {
            let period_ns = (1e9 / tracks.rate_hz) as i64;
            self.begin = (self.latest_ns.saturating_add(period_ns), None);
            self.next_sequence = None;
            self.further.values_mut().for_each(|(_, next)| *next = None);
        }
        Ok(())
    }

    /// The samples of the sensors with index 1 and up; `time_ns` is that of a device time.
    fn further(&mut self, part: &Part, time_ns: impl Fn(u64) -> i64) {
        for sensor in part.boot.further.keys() {
            let samples = part.samples(*sensor, Stream::Raw);
            if samples.is_empty() {
                continue;
            }
            let sink = &mut *self.sink;
            let track = || (sink.track(further_track(part.boot, *sensor)), None);
            let (track, next) = self.further.entry(*sensor).or_insert_with(track);
            for sample in samples {
                let is_first = next.is_none() && self.begin.0 == 0;
                if *next != Some(sample.sequence) && !is_first {
                    self.sink.gap(*track);
                }
                *next = Some(sample.sequence.wrapping_add(1));
                let value = sample.value.map(f64::from);
                self.sink.row(*track, time_ns(sample.time.0), &value);
            }
        }
    }

    fn rows(
        &mut self,
        part: &Part,
        samples: &[TimedSample],
        first_us: u64,
        name: &str,
    ) -> Result<()> {
        let boot = part.boot;
        let tracks = self.tracks.get_or_insert_with(|| Tracks::of(boot, self.sink));
        one_range(boot, tracks, name)?;
        let begin_us = *self.begin.1.get_or_insert(first_us);
        let begin_ns = self.begin.0;
        let time_ns = |us: u64| {
            let since_us = us.wrapping_sub(begin_us) as i64;
            since_us.saturating_mul(1000).saturating_add(begin_ns)
        };
        // A board that replays another sensor's counts has its own thermometer and magnetometer, which do not belong to
        // the counts.
        let is_replay = |hello: wimu_link::Hello| hello.sensor.number == sensor::REPLAY;
        let environment = match boot.hello.is_some_and(is_replay) {
            true => &[],
            false => part.environment(),
        };
        for environment in environment {
            let time = time_ns(environment.time_us);
            if let Some(nt) = environment.magnetic_field_nt {
                let tesla = nt.map(|axis| f64::from(axis) * 1e-9);
                self.sink.row(tracks.field, time, &tesla);
            }
            if let Some(centi_c) = environment.temperature_centi_c {
                let celsius = f64::from(centi_c) / 100.0;
                self.sink.row(tracks.temperature, time, &[celsius]);
            }
        }
        for sample in samples {
            // Between two starts samples are missing, too.
            let is_first = self.next_sequence.is_none() && begin_ns == 0;
            if self.next_sequence != Some(sample.sequence) && !is_first {
                self.sink.gap(tracks.force);
            }
            self.next_sequence = Some(sample.sequence.wrapping_add(1));
            let time = time_ns(sample.time.0);
            self.latest_ns = time;
            self.sink.row(tracks.force, time, &sample.value.map(f64::from));
            if let (Some(track), Some(value)) = (tracks.rate, sample.rate) {
                self.sink.row(track, time, &value.map(f64::from));
            }
        }
        self.further(part, time_ns);
        Ok(())
    }

    /// Whether there was no sample.
    pub(crate) fn is_empty(&self) -> bool {
        self.tracks.is_none()
    }

    /// # Errors
    /// `no_rows` without samples.
    pub(crate) fn finish(self, role: LinkRole, name: &str) -> Result<()> {
        let error = || {
            let message = format!("no raw samples came over the {role} link");
            let remedy = "switch the raw stream on with `wimu settings set`, or use the other link";
            Code::NoRows.error(message, remedy).at(name)
        };
        self.tracks.map(|_| ()).ok_or_else(error)
    }
}

impl Tracks {
    /// Those of a link whose first start with samples is `first`.
    fn of(first: &Boot, sink: &mut dyn Sink) -> Self {
        let epoch = first.epochs.first().map(|mark| &mark.epoch);
        let range_g = epoch.map(|epoch| epoch.range_g);
        let rate_hz = match (first.settings.first(), epoch) {
            (Some(settings), _) => f64::from(settings.rate_hz),
            (None, Some(epoch)) => 1e9 / f64::from(epoch.period_ns.max(1)),
            (None, None) => ASSUMED_RATE_HZ,
        };
        let counts = |si_per_lsb| Unit::Counts { si_per_lsb };
        let sensitivity = first.nominal_sensitivity().map(|s| s.mps2_per_lsb());
        let mut info = TrackInfo::new("raw", Quantity::SpecificForce, counts(sensitivity));
        info.rate_hz = Some(rate_hz);
        info.device = first.sensor();
        info.device_id = first.hello.map(|hello| hello.device_id);
        info.full_scale = range_g.map(|g| f64::from(g) * STANDARD_GRAVITY_MPS2);
        let force = sink.track(info);
        let nominal = epoch.and_then(|epoch| Some(epoch.gyroscope?.rad_s_per_lsb));
        let rate = TrackInfo::new("raw", Quantity::AngularRate, counts(nominal));
        let has_gyroscope = first.raw.iter().any(|sample| sample.rate.is_some());
        let rate = has_gyroscope.then(|| sink.track(rate));
        let [field, temperature] = [Quantity::MagneticField, Quantity::Temperature]
            .map(|quantity| sink.track(TrackInfo::new("environment", quantity, Unit::Si)));
        Self { range_g, rate_hz, force, rate, field, temperature }
    }
}

/// The accelerometer of a sensor with index 1 and up.
fn further_track(boot: &Boot, sensor: u8) -> TrackInfo {
    let epochs = boot.further.get(&sensor).map(|track| &track.epochs);
    let epoch = epochs.and_then(|epochs| Some(epochs.first()?.epoch));
    let si_per_lsb = epoch.map(|epoch| STANDARD_GRAVITY_MPS2 / epoch.sensitivity_lsb_per_g);
    let unit = Unit::Counts { si_per_lsb };
    let name = format!("raw {sensor}");
    let mut info = TrackInfo::new(name, Quantity::SpecificForce, unit).of_sensor(sensor);
    info.device_id = boot.hello.map(|hello| hello.device_id);
    info.rate_hz = epoch.map(|epoch| 1e9 / f64::from(epoch.period_ns.max(1)));
    info.full_scale = epoch.map(|epoch| f64::from(epoch.range_g) * STANDARD_GRAVITY_MPS2);
    info
}

/// Refuses epochs of another range than the first one.
fn one_range(boot: &Boot, tracks: &mut Tracks, name: &str) -> Result<()> {
    for mark in &boot.epochs {
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
