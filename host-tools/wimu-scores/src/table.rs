//! Tables with named columns, as CSV.

use std::error::Error;
use std::fs;
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

pub type Result<T> = std::result::Result<T, Box<dyn Error>>;
pub const ENU: [&str; 3] = ["E", "N", "U"];
pub const XYZ: [&str; 3] = ["X", "Y", "Z"];

/// A table; recordings have a column `Time (s)`.
#[derive(Clone)]
pub struct Table {
    pub header: Vec<String>,
    pub rows: Vec<Vec<String>>,
}

impl Table {
    pub fn read(file: &Path) -> Result<Self> {
        let text = fs::read_to_string(file).map_err(|e| format!("{}: {e}", file.display()))?;
        let cells = |line: &str| line.split(',').map(|cell| cell.trim().to_owned()).collect();
        let mut rows = text.lines().map(cells);
        let header: Vec<String> = rows.next().ok_or(format!("{}: empty", file.display()))?;
        let rows = rows.filter(|row: &Vec<String>| row.len() == header.len()).collect();
        Ok(Self { header, rows })
    }

    /// Numbers below a header; NaN becomes an empty cell.
    pub fn of(header: &str, rows: impl IntoIterator<Item = Vec<f64>>) -> Self {
        let cell = |value: f64| if value.is_nan() { String::new() } else { value.to_string() };
        let rows = rows.into_iter().map(|row| row.into_iter().map(cell).collect());
        Self { header: header.split(',').map(str::to_owned).collect(), rows: rows.collect() }
    }

    pub fn text(&self) -> String {
        [&self.header].into_iter().chain(&self.rows).map(|row| row.join(",") + "\n").collect()
    }

    /// Adds a column of zeros if there is none of this name.
    pub fn or_zero(mut self, name: &str) -> Self {
        if !self.header.iter().any(|column| column == name) {
            self.header.push(name.to_owned());
            self.rows.iter_mut().for_each(|row| row.push("0".to_owned()));
        }
        self
    }

    pub fn texts(&self, name: &str) -> Result<Vec<&str>> {
        let place = self.header.iter().position(|column| column == name);
        let place = place.ok_or(format!("no column `{name}`"))?;
        Ok(self.rows.iter().map(|row| row[place].as_str()).collect())
    }

    /// The numbers of a column; NaN where a cell is none.
    pub fn numbers(&self, name: &str) -> Result<Vec<f64>> {
        let texts = self.texts(name)?;
        Ok(texts.into_iter().map(|text| text.parse().unwrap_or(f64::NAN)).collect())
    }

    pub fn times(&self) -> Result<Vec<f64>> {
        self.numbers("Time (s)")
    }

    /// Three columns whose names have an axis in place of `#`.
    pub fn vectors(&self, name: &str, axes: [&str; 3]) -> Result<Vec<Vector3<f64>>> {
        let [x, y, z] = axes.map(|axis| self.numbers(&name.replace('#', axis)));
        let (x, y, z) = (x?, y?, z?);
        Ok((0..x.len()).map(|k| Vector3::new(x[k], y[k], z[k])).collect())
    }

    /// Columns `NAME W`, `X`, `Y`, `Z`.
    pub fn attitudes(&self, name: &str) -> Result<Vec<UnitQuaternion<f64>>> {
        let (w, v) =
            (self.numbers(&format!("{name} W"))?, self.vectors(&format!("{name} #"), XYZ)?);
        let one = |(w, v)| UnitQuaternion::from_quaternion(Quaternion::from_parts(w, v));
        Ok(w.into_iter().zip(v).map(one).collect())
    }

    /// Deletes the columns whose names begin with one of these words.
    pub fn delete(&mut self, words: &[String]) {
        let is_kept = |name: &String| !words.iter().any(|word| name.starts_with(word));
        let kept: Vec<bool> = self.header.iter().map(is_kept).collect();
        for row in self.rows.iter_mut().chain([&mut self.header]) {
            let mut kept = kept.iter();
            row.retain(|_| kept.next() == Some(&true));
        }
    }

    /// The rows of a span of time, s.
    pub fn cut(&self, [from_s, until_s]: [f64; 2]) -> Result<Self> {
        let rows = self.rows.iter().zip(self.times()?);
        let rows = rows.filter(|(_, t)| (from_s..until_s).contains(t)).map(|(row, _)| row.clone());
        Ok(Self { header: self.header.clone(), rows: rows.collect() })
    }
}
