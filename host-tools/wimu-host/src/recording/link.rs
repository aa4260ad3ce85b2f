//! The raw samples of a link as a recording.

use wimu_link::hello::sensor;
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::samples::ASSUMED_RATE_HZ;
use super::{Quantity, Recording, Sink, TrackId, TrackInfo, Unit};
use crate::error::{ErrorCode, Result};
use crate::history::{Boot, LinkHistory};

/// Name of the format of wimu's recordings in docs/FORMATS.md.
pub(crate) const FORMAT: &str = "wimu recording";

impl Recording {
    /// The raw samples of a link, at device time from the first sample on, continued where the device restarted;
    /// `name` is its name in errors.
    ///
    /// # Errors
    /// `no_rows` without samples, `data_refused` when the range changed.
    pub fn of_link(link: &LinkHistory, name: &str) -> Result<Self> {
        let mut recording = Self::new(name);
        recording.format = FORMAT;
        read(link, name, &mut recording)?;
        Ok(recording)
    }
}

/// Hands the raw samples of a link to `sink`: [`Recording::of_link`].
pub(crate) fn read(link: &LinkHistory, name: &str, sink: &mut dyn Sink) -> Result<()> {
    let boots: Vec<&Boot> = link
        .boots
        .iter()
        .filter(|boot| !boot.raw.is_empty())
        .collect();
    let Some(first) = boots.first() else {
        return Err(ErrorCode::NoRows
            .error(
                format!("no raw samples came over the {} link", link.role),
                "switch the raw stream on with `wimu settings set`, or use the other link",
            )
            .at(name));
    };
    let range_g = one_range(&boots, name)?;
    let rate_hz = match (first.settings.first(), first.epochs.first()) {
        (Some(settings), _) => f64::from(settings.rate_hz),
        (None, Some(mark)) => 1e9 / f64::from(mark.epoch.period_ns.max(1)),
        (None, None) => ASSUMED_RATE_HZ,
    };
    let counts = |si_per_lsb| Unit::Counts { si_per_lsb };
    let sensitivity = first.nominal_sensitivity().map(|s| s.mps2_per_lsb());
    let mut info = TrackInfo::new("raw", Quantity::SpecificForce, counts(sensitivity));
    info.rate_hz = Some(rate_hz);
    info.device = first.sensor();
    info.full_scale = range_g.map(|g| f64::from(g) * STANDARD_GRAVITY_MPS2);
    let force = sink.track(info);
    let has_gyroscope = first.raw.iter().any(|sample| sample.rate.is_some());
    let epoch = first.epochs.first();
    let nominal = epoch.and_then(|mark| Some(mark.epoch.gyroscope?.rad_s_per_lsb));
    let rate = has_gyroscope.then(|| {
        sink.track(TrackInfo::new(
            "raw",
            Quantity::AngularRate,
            counts(nominal),
        ))
    });
    let environment = [Quantity::MagneticField, Quantity::Temperature]
        .map(|quantity| sink.track(TrackInfo::new("environment", quantity, Unit::Si)));
    let (mut begin_ns, mut is_first) = (0, true);
    for boot in &boots {
        let begin_us = boot.raw.first().map_or(0, |sample| sample.time.0);
        let time_ns = |us: u64| {
            let since_us = us.wrapping_sub(begin_us) as i64;
            since_us.saturating_mul(1000).saturating_add(begin_ns)
        };
        add_environment(sink, boot, environment, time_ns);
        let mut next = None;
        for sample in &boot.raw {
            if next != Some(sample.sequence) && !is_first {
                sink.gap(force);
            }
            is_first = false;
            next = Some(sample.sequence.wrapping_add(1));
            let time = time_ns(sample.time.0);
            sink.row(force, time, &sample.value.map(f64::from));
            if let (Some(track), Some(value)) = (rate, sample.rate) {
                sink.row(track, time, &value.map(f64::from));
            }
        }
        let last_us = boot.raw.last().map_or(0, |sample| sample.time.0);
        begin_ns = time_ns(last_us).saturating_add((1e9 / rate_hz) as i64);
    }
    Ok(())
}

/// Magnetic field and temperature of a start of the device.
fn add_environment(
    sink: &mut dyn Sink,
    boot: &Boot,
    [field, temperature]: [TrackId; 2],
    time_ns: impl Fn(u64) -> i64,
) {
    // A board that replays another sensor's counts has its own thermometer and magnetometer, which do not belong to
    // the counts.
    let is_replay = |hello: wimu_link::Hello| hello.sensor.number == sensor::REPLAY;
    if boot.hello.is_some_and(is_replay) {
        return;
    }
    for environment in &boot.environment {
        let time = time_ns(environment.time_us);
        if let Some(nt) = environment.magnetic_field_nt {
            sink.row(field, time, &nt.map(|axis| f64::from(axis) * 1e-9));
        }
        if let Some(centi_c) = environment.temperature_centi_c {
            sink.row(temperature, time, &[f64::from(centi_c) / 100.0]);
        }
    }
}

/// The range of all epochs, ± *g*.
fn one_range(boots: &[&Boot], name: &str) -> Result<Option<u8>> {
    let epochs = || boots.iter().flat_map(|boot| &boot.epochs);
    let range_g = epochs().next().map(|mark| mark.epoch.range_g);
    match epochs().find(|mark| Some(mark.epoch.range_g) != range_g) {
        None => Ok(range_g),
        Some(mark) => Err(ErrorCode::DataRefused
            .error(
                format!(
                    "the range changes from ±{} g to ±{} g at sample {}",
                    range_g.unwrap_or_default(),
                    mark.epoch.range_g,
                    mark.epoch.sequence
                ),
                "record at one range: a calibration is valid at one range only",
            )
            .at(name)),
    }
}
