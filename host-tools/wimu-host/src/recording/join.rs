//! Recordings one after the other, and as a table.

use std::io::BufWriter;
use std::path::Path;

use wimu_model::STANDARD_GRAVITY_MPS2;

use super::{Quantity, Recording, Track, Unit};
use crate::OutputFile;
use crate::csv::{self, CsvWriter};
use crate::{Code, Result};

/// Time between two recordings that are joined, ns.
const BETWEEN_NS: i64 = 1_000_000_000;

impl Recording {
    /// Puts an earlier recording of the same sensor before this one, with a gap between them. Tracks that only one of
    /// them has stay as they are.
    ///
    /// # Errors
    /// `data_refused` when the nominal sensitivity differs.
    pub fn prepend(&mut self, earlier: &Self) -> Result<()> {
        let ends = earlier.tracks.iter().filter_map(|t| t.times_ns.iter().max());
        let (Some(begin), Some(end)) = (self.start_ns(), ends.max()) else {
            return Ok(());
        };
        let shift = end + BETWEEN_NS - begin;
        for track in &mut self.tracks {
            track.times_ns.iter_mut().for_each(|time| *time += shift);
            let same = |other: &&Track| other.info.quantity == track.info.quantity;
            let Some(before) = earlier.tracks.iter().find(same) else {
                continue;
            };
            if scale(before).zip(scale(track)).is_some_and(|(a, b)| (a / b - 1.0).abs() > 1e-6) {
                let error = Code::DataRefused.error(
                    "the earlier poses were captured at another range",
                    "set the range back with `wimu device settings set`, or start again without --resume",
                );
                return Err(error.at(&earlier.name));
            }
            let rows = before.len();
            let gaps = track.gaps.iter().map(|gap| gap + rows);
            track.gaps = before.gaps.iter().copied().chain([rows]).chain(gaps).collect();
            track.times_ns.splice(0..0, before.times_ns.iter().copied());
            track.values.splice(0..0, before.values.iter().copied());
            track.valid.splice(0..0, before.valid.iter().copied());
        }
        Ok(())
    }

    /// Adds the accelerometer of another recording on the same body as the next one: its times are those of its file.
    ///
    /// # Errors
    /// `csv_missing_column` where it has not one accelerometer with times.
    pub fn add_accelerometer(&mut self, other: &Self) -> Result<()> {
        let mut tracks = other.of(Quantity::SpecificForce);
        let (Some(track), None) = (tracks.next(), tracks.next()) else {
            let error = Code::CsvMissingColumn.error(
                "a recording beside another one has one accelerometer",
                "give one file of each accelerometer, or one file of all",
            );
            return Err(error.at(&other.name));
        };
        let mut track = track.clone();
        let last = self.of(Quantity::SpecificForce).map(|track| track.info.sensor);
        track.info.sensor = last.max().map_or(0, |last| last.saturating_add(1));
        self.tracks.push(track);
        Ok(())
    }

    /// Removes the latest `count` rows of the accelerometer and of the gyroscope beside it.
    pub fn drop_latest(&mut self, count: usize) {
        let sampled = [Quantity::SpecificForce, Quantity::AngularRate];
        let is_sampled = |track: &&mut Track| sampled.contains(&track.info.quantity);
        for track in self.tracks.iter_mut().filter(is_sampled) {
            let rows = track.len().saturating_sub(count);
            track.times_ns.truncate(rows);
            track.values.truncate(rows * track.info.quantity.width());
            track.valid.truncate(rows);
            track.gaps.retain(|gap| *gap <= rows);
        }
    }

    /// Writes the counts of the accelerometer, of the gyroscope beside it and the temperature as a table, which
    /// [`formats::load`](crate::formats::load) reads back.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn write_table(&self, path: &Path) -> Result<()> {
        let of = |quantity| self.of(quantity).find(|track| !track.is_empty());
        let Some(force) = of(Quantity::SpecificForce) else {
            return Ok(());
        };
        let (rate, temperature) = (of(Quantity::AngularRate), of(Quantity::Temperature));
        let mut columns = vec![csv::TIME.to_owned()];
        columns.extend(csv::axes("Accelerometer", "LSB"));
        columns.extend([csv::TEMPERATURE, csv::SENSITIVITY].map(str::to_owned));
        if rate.is_some() {
            columns.extend(csv::axes("Gyroscope", "LSB"));
            columns.push(csv::GYROSCOPE_SCALE.to_owned());
        }
        let sensitivity = scale(force).map(|scale| STANDARD_GRAVITY_MPS2 / scale);
        let (output, file) = OutputFile::create(path)?;
        let mut writer = CsvWriter::new(BufWriter::new(file), output.name(), &columns)?;
        for (index, &time) in force.times_ns.iter().enumerate() {
            let vector = |track: &Track| <[f64; 3]>::try_from(track.row(index)?).ok();
            let celsius = temperature.and_then(|track| {
                let after = track.times_ns.partition_point(|at| *at <= time);
                track.values.get(after.saturating_sub(1)).copied()
            });
            writer.time(Some(time)).vector(vector(force));
            writer.number(celsius).number(sensitivity);
            if let Some(rate) = rate {
                writer.vector(vector(rate)).number(scale(rate));
            }
            writer.end_row()?;
        }
        writer.finish()?;
        output.finish()
    }
}

/// SI units of one LSB.
fn scale(track: &Track) -> Option<f64> {
    match track.info.unit {
        Unit::Counts { si_per_lsb } => si_per_lsb,
        _ => None,
    }
}
