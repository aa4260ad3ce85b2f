//! The raw samples of a recording's link as a dataset.

use std::path::Path;

use wimu_calib::Datasheet;
use wimu_link::hello::sensor;
use wimu_link::message::Environment;
use wimu_model::DeviceTimeUs;

use super::{ASSUMED_RATE_HZ, Dataset, LoadOptions, Output, OutputUnit, RateSource};
use crate::error::{ErrorCode, Result};
use crate::history::{Boot, LinkHistory, Recording};

impl Dataset {
    /// Reads a recording's raw samples.
    ///
    /// # Errors
    /// Those of [`Recording::load`] and [`Dataset::from_link`].
    pub fn from_recording(path: &Path, options: &LoadOptions) -> Result<Self> {
        let recording = Recording::load(path)?;
        Self::from_link(recording.link(options.role)?, &recording.name)
    }

    /// The raw samples of a link; `name` is its name in errors.
    ///
    /// # Errors
    /// `no_rows` without samples, `data_refused` when the range changed.
    pub fn from_link(link: &LinkHistory, name: &str) -> Result<Self> {
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
        let range_g = first.epochs.first().map(|mark| mark.epoch.range_g);
        let changed = boots
            .iter()
            .flat_map(|boot| &boot.epochs)
            .find(|mark| Some(mark.epoch.range_g) != range_g);
        if let Some(mark) = changed {
            return Err(ErrorCode::DataRefused
                .error(
                    format!(
                        "the range changes from ±{} g to ±{} g at sample {}",
                        range_g.unwrap_or_default(),
                        mark.epoch.range_g,
                        mark.epoch.sequence
                    ),
                    "record at one range: a calibration is valid at one range only",
                )
                .at(name));
        }
        let rate_hz = match (first.settings.first(), first.epochs.first()) {
            (Some(settings), _) => f64::from(settings.rate_hz),
            (None, Some(mark)) => 1e9 / f64::from(mark.epoch.period_ns.max(1)),
            (None, None) => ASSUMED_RATE_HZ,
        };
        let mut outputs: Vec<Output> = Vec::new();
        for boot in &boots {
            let mut next = None;
            let before_s = outputs.last().and_then(|output| output.time_s);
            let begin_us = boot.raw.first().map_or(0, |sample| sample.time.0);
            let mut surroundings = Surroundings::new(boot);
            for sample in &boot.raw {
                outputs.push(Output {
                    value: sample.value.map(f64::from),
                    magnetic_field_nt: surroundings.field_until(sample.time),
                    temperature_c: surroundings.temperature,
                    samples: 1,
                    after_gap: next != Some(sample.sequence) && !outputs.is_empty(),
                    time_s: Some(
                        before_s.map_or(0.0, |before| before + 1.0 / rate_hz)
                            + sample.time.0.saturating_sub(begin_us).saturating_mul(1000) as f64
                                * 1e-9,
                    ),
                });
                next = Some(sample.sequence.wrapping_add(1));
            }
        }
        Ok(Self {
            name: name.to_owned(),
            unit: OutputUnit::Counts {
                nominal: first.nominal_sensitivity(),
                range_g,
            },
            poses: false,
            rate_hz,
            rate_source: RateSource::Device,
            datasheet: first.hello.and_then(|hello| match hello.sensor.number {
                sensor::LSM303AGR => Datasheet::of("LSM303AGR"),
                sensor::ADXL345 => Datasheet::of("ADXL345"),
                _ => None,
            }),
            outputs,
            sensor: first.sensor(),
            has_gyroscope: first.raw.iter().any(|sample| sample.rate.is_some()),
        })
    }
}

/// Magnetic field and temperature at increasing times.
struct Surroundings<'a> {
    rest: &'a [Environment],
    /// The latest, °C.
    temperature: Option<f64>,
}

impl<'a> Surroundings<'a> {
    fn new(boot: &'a Boot) -> Self {
        // A board that replays another sensor's counts has its own thermometer and magnetometer, which do not belong to
        // the counts.
        let replays = boot
            .hello
            .is_some_and(|hello| hello.sensor.number == sensor::REPLAY);
        let rest: &[_] = if replays { &[] } else { &boot.environment };
        Self {
            rest,
            temperature: rest.iter().find_map(|e| e.temperature_centi_c).map(celsius),
        }
    }

    /// The last field, nT, since the previous call.
    fn field_until(&mut self, time: DeviceTimeUs) -> Option<[f64; 3]> {
        let mut field = None;
        while let [first, rest @ ..] = self.rest
            && first.time_us <= time.0
        {
            self.temperature = first.temperature_centi_c.map(celsius).or(self.temperature);
            field = first
                .magnetic_field_nt
                .map(|nt| nt.map(f64::from))
                .or(field);
            self.rest = rest;
        }
        field
    }
}

fn celsius(centi_c: i16) -> f64 {
    f64::from(centi_c) / 100.0
}
