//! Recordings one after the other, and as a table.

use std::io::BufWriter;
use std::path::Path;

use wimu_model::STANDARD_GRAVITY_MPS2;

use super::{Quantity, Recording, Track, Unit};
use crate::OutputFile;
use crate::csv::{self, CsvWriter};
use crate::error::{ErrorCode, Result};

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
                let error = ErrorCode::DataRefused.error(
                    "the earlier poses were captured at another range",
                    "set the range back with `wimu settings set`, or start again without --resume",
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
            let error = ErrorCode::CsvMissingColumn.error(
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

#[cfg(test)]
mod tests {
    use super::super::{Sink, TrackInfo};
    use super::*;
    use crate::formats::{self, ReadOptions};

    /// Rows of counts at 100 Hz from `first` on, at a scale, with angular rates and a temperature.
    fn recording(first: i32, rows: i32, si_per_lsb: f64) -> Recording {
        let mut recording = Recording::new("made");
        let unit = |scale| Unit::Counts { si_per_lsb: Some(scale) };
        let force =
            recording.track(TrackInfo::new("raw", Quantity::SpecificForce, unit(si_per_lsb)));
        let rate = recording.track(TrackInfo::new("raw", Quantity::AngularRate, unit(0.001)));
        let temperature = recording.track(TrackInfo::new("t", Quantity::Temperature, Unit::Si));
        recording.row(temperature, 0, &[21.5]);
        for k in first..first + rows {
            let time = i64::from(k) * 10_000_000;
            let value = f64::from(k);
            recording.row(force, time, &[value, -value, 16_384.0]);
            recording.row(rate, time, &[value, 0.0, 1.0]);
        }
        recording
    }

    fn counts(recording: &Recording, quantity: Quantity) -> Vec<f64> {
        let track = recording.first(quantity).expect("a track");
        track.vectors().map(|(_, [x, ..])| x).collect()
    }

    #[test]
    fn an_earlier_recording_comes_first_with_a_gap_behind_it() {
        let scale = STANDARD_GRAVITY_MPS2 / 16_384.0;
        let (earlier, mut later) = (recording(0, 50, scale), recording(7, 30, scale));
        later.prepend(&earlier).expect("the same scale");
        let expected: Vec<f64> = (0..50).chain(7..37).map(f64::from).collect();
        for quantity in [Quantity::SpecificForce, Quantity::AngularRate] {
            assert_eq!(counts(&later, quantity), expected);
        }
        let force = later.first(Quantity::SpecificForce).expect("a track");
        assert_eq!(force.gaps(), [50]);
        assert!(force.times_ns().is_sorted_by(|a, b| a < b));
        assert!(force.times_ns()[50] - force.times_ns()[49] >= BETWEEN_NS);
        // Dropped across the joint.
        later.drop_latest(31);
        assert_eq!(counts(&later, Quantity::SpecificForce), expected[..49]);
        let mut other = recording(0, 5, 2.0 * scale);
        let error = other.prepend(&earlier).expect_err("another range");
        assert_eq!(error.code(), ErrorCode::DataRefused);
    }

    #[test]
    fn a_written_table_reads_back_the_same() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("poses.csv");
        let written = recording(3, 40, STANDARD_GRAVITY_MPS2 / 16_384.0);
        written.write_table(&path).expect("writable");
        let read = formats::load(&path, &ReadOptions::default()).expect("readable");
        for quantity in [Quantity::SpecificForce, Quantity::AngularRate] {
            assert_eq!(counts(&read, quantity), counts(&written, quantity));
        }
        let scale =
            |recording: &Recording| recording.first(Quantity::SpecificForce).and_then(scale);
        let [a, b] = [scale(&read), scale(&written)].map(|scale| scale.expect("counts"));
        assert!((a / b - 1.0).abs() < 1e-12);
        let track = read.first(Quantity::Temperature).expect("a track");
        assert_eq!(track.row(0), Some(&[21.5][..]));
    }
}
