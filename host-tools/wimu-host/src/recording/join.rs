//! Recordings one after the other, and as a table.

use std::io::BufWriter;
use std::path::Path;

use wimu_model::STANDARD_GRAVITY_MPS2;

use super::{Quantity, Recording, Track, Unit};
use crate::OutputFile;
use crate::csv::{self, CsvWriter};
use crate::{Code, Result};

impl Recording {
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
