//! One unit's recording: accelerometer, and magnetometer, angular rate and true path where the file
//! has them.

mod rests;

pub use rests::{RestSpan, gap_s, median_step_s, rests};

use std::path::Path;

use wimu_nav::unit::{UnitConfig, UnitSample};

use crate::csv::CsvReader;
use crate::{ErrorCode, HostError, Result};

/// Where the unit truly was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Position, m, east-north-up.
    pub position_m: [f64; 3],
    /// Body to navigation axes, W X Y Z.
    pub quaternion: [f64; 4],
}

impl Truth {
    /// Direction of body x from east to north, rad.
    pub fn heading_rad(&self) -> f64 {
        let [w, x, y, z] = self.quaternion;
        (2.0 * (x * y + w * z)).atan2(1.0 - 2.0 * (y * y + z * z))
    }
}

/// The column that says whether the magnetic field is corrected.
pub(crate) const FIELD_CALIBRATED: &str = "Field Calibrated";

/// Deviations up to which something is likely.
const LIKELY: f64 = 3.0;

const RATE_UNITS: [(&str, f64); 3] = [
    ("rad/s", 1.0),
    ("deg/s", std::f64::consts::PI / 180.0),
    ("dps", std::f64::consts::PI / 180.0),
];

/// The column called `name` and the factor of its unit; `None` where there is none.
fn unit_of(names: &[String], name: &str, units: &[(&str, f64)]) -> Result<Option<(usize, f64)>> {
    let parts = |column: &str| {
        let (start, unit) = column.split_once('(').unwrap_or((column, ")"));
        (start.trim() == name).then(|| unit.trim_end_matches(')').trim().to_owned())
    };
    let Some((k, unit)) = names
        .iter()
        .enumerate()
        .find_map(|(k, n)| Some((k, parts(n)?)))
    else {
        return Ok(None);
    };
    match units.iter().find(|(known, _)| *known == unit) {
        Some((_, factor)) => Ok(Some((k, *factor))),
        None => {
            let known: Vec<String> = units
                .iter()
                .map(|(u, _)| format!("`{name} ({u})`"))
                .collect();
            Err(HostError::new(
                ErrorCode::UnknownFormat,
                format!("the unit of `{}` is not known", names[k]),
                format!("give it as {}", known.join(" or ")),
            ))
        }
    }
}

/// Three axes or none.
fn complete(
    name: &str,
    axes: [Result<Option<(usize, f64)>>; 3],
) -> Result<Option<[(usize, f64); 3]>> {
    let [x, y, z] = axes;
    match [x?, y?, z?] {
        [Some(x), Some(y), Some(z)] => Ok(Some([x, y, z])),
        [None, None, None] => Ok(None),
        _ => Err(HostError::new(
            ErrorCode::CsvMissingColumn,
            format!("`{name}` has not all its axes"),
            "give all three, or none",
        )),
    }
}

/// Samples of one unit, corrected, in SI.
#[derive(Clone, Debug, Default)]
pub struct MotionRecording {
    /// What errors call it.
    pub name: String,
    /// Time of each sample, s.
    pub times_s: Vec<f64>,
    /// The samples.
    pub samples: Vec<UnitSample>,
    /// `Truth …` columns, where they are filled in.
    pub truth: Vec<Option<Truth>>,
    /// What was noticed at reading.
    pub remarks: Vec<String>,
    other: Vec<(String, Vec<f64>)>,
}

impl MotionRecording {
    /// Samples without truth, as many as times.
    pub fn new(name: impl Into<String>, times_s: Vec<f64>, samples: Vec<UnitSample>) -> Self {
        Self {
            name: name.into(),
            truth: vec![None; samples.len()],
            times_s,
            samples,
            remarks: Vec::new(),
            other: Vec::new(),
        }
    }

    /// Reads a CSV file with times and one accelerometer in g or m/s²; `Gyroscope X (rad/s)` or
    /// `(deg/s)`, the magnetometer and `Truth Position E (m)`, `Truth Quaternion W`, … if there are. A
    /// magnetic field whose `Field Calibrated` is 0 is left out.
    ///
    /// # Errors
    /// Those of [`CsvReader`]; `csv_missing_column` without times, with other than one accelerometer or
    /// with an axis whose neighbours are there; `unknown_format` for raw counts and units that are not
    /// known.
    pub fn from_csv(path: &Path) -> Result<Self> {
        let reader = CsvReader::open(path)?;
        let header = reader.header().clone();
        let name = reader.name().to_owned();
        if !header.time || header.accelerometers.len() != 1 {
            return Err(HostError::new(
                ErrorCode::CsvMissingColumn,
                "navigation needs times and one accelerometer",
                "name the columns `Time (s)`, `Accelerometer X (m/s²)`, …; for several accelerometers \
                 on one body give --geometry",
            )
            .at(format!("{name} line 1")));
        }
        let Some(factor) = header.acceleration_unit.mps2() else {
            return Err(HostError::new(
                ErrorCode::UnknownFormat,
                "its accelerations are raw counts",
                "give corrected samples in m/s² or g: `wimu export --stream corrected`",
            )
            .at(format!("{name} line 1")));
        };
        let mut recording = Self {
            name,
            other: header
                .other
                .iter()
                .map(|n| (n.clone(), Vec::new()))
                .collect(),
            ..Self::default()
        };
        let column = |name: String, units: &[(&str, f64)]| {
            unit_of(&header.other, &name, units)
                .map_err(|e| e.at(format!("{} line 1", recording.name)))
        };
        let rate = complete(
            "Gyroscope",
            ["X", "Y", "Z"].map(|axis| column(format!("Gyroscope {axis}"), &RATE_UNITS)),
        )
        .map_err(|e| e.at(format!("{} line 1", recording.name)))?;
        let strange = |n: &&String| {
            let name = n.to_lowercase();
            rate.is_none() && (name.starts_with("gyr") || name.starts_with("angular"))
        };
        if let Some(column) = header.other.iter().find(strange) {
            recording.remarks.push(format!(
                "`{column}` is not read: an angular rate is called `Gyroscope X (rad/s)` or `(deg/s)`"
            ));
        }
        let metres = |axis| column(format!("Truth Position {axis}"), &[("m", 1.0)]);
        let position = complete("Truth Position", ["E", "N", "U"].map(metres))
            .map_err(|e| e.at(format!("{} line 1", recording.name)))?;
        let find = |name: &str| header.other.iter().position(|n| n == name);
        let quaternion = ["W", "X", "Y", "Z"].map(|a| find(&format!("Truth Quaternion {a}")));
        let calibrated = find(FIELD_CALIBRATED);
        let mut last = None;
        for row in reader {
            let row = row?;
            for ((_, values), text) in recording.other.iter_mut().zip(&row.other) {
                values.push(text.parse().unwrap_or(f64::NAN));
            }
            let other = &recording.other;
            let value = |at: Option<usize>| {
                let (_, values) = other.get(at?)?;
                values.last().copied().filter(|v| v.is_finite())
            };
            let all = |at: Option<[(usize, f64); 3]>| {
                let [x, y, z] = at?.map(|(k, by)| value(Some(k)).map(|v| v * by));
                Some([x?, y?, z?])
            };
            // As a magnetometer put it out that is not calibrated, a field says nothing of directions.
            let uncalibrated = calibrated.is_some_and(|k| value(Some(k)) == Some(0.0));
            let time = row.time_ns.unwrap_or_default() as f64 * 1e-9;
            recording.samples.push(UnitSample {
                step_s: time - last.unwrap_or(time),
                force_mps2: row
                    .accelerations
                    .first()
                    .copied()
                    .unwrap_or_default()
                    .map(|a| a * factor),
                field_ut: row.magnetic_field_ut.filter(|_| !uncalibrated),
                rate_rad_s: all(rate),
            });
            recording.times_s.push(time);
            last = Some(time);
            recording.truth.push(all(position).map(|position_m| Truth {
                position_m,
                quaternion: quaternion.map(|q| value(q).unwrap_or(f64::NAN)),
            }));
        }
        if recording.samples.len() < 2 {
            return Err(HostError::new(
                ErrorCode::NoRows,
                "there are fewer than two samples",
                "check the file",
            )
            .at(&recording.name));
        }
        Ok(recording)
    }

    /// Another column of the file.
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        self.other
            .iter()
            .find(|(n, _)| n == name)
            .map(|(_, values)| values.as_slice())
    }

    /// Gravity to navigate with, m/s²: the standard one, unless mean |f| of the first second at rest within the first minute
    /// departs from it by more than the biases of a calibrated accelerometer explain, and less than 10 %: one that is
    /// not calibrated shows its own. A small departure is no gravity: as a bias it turns with the unit.
    pub fn gravity_mps2(&self) -> f64 {
        let standard = wimu_model::STANDARD_GRAVITY_MPS2;
        let by_bias = LIKELY * UnitConfig::default().bias_mps2;
        self.first_rest_mps2()
            .filter(|seen| (seen - standard).abs() > by_bias)
            .unwrap_or(standard)
    }

    /// Mean |f| of the first second at rest, where it may be gravity, m/s².
    pub fn first_rest_mps2(&self) -> Option<f64> {
        let standard = wimu_model::STANDARD_GRAVITY_MPS2;
        let mut from = 0;
        while from < self.samples.len() && self.times_s[from] < self.times_s[0] + 60.0 {
            let to = self
                .times_s
                .partition_point(|t| *t < self.times_s[from] + 1.0);
            let window = &self.samples[from..to];
            if window.len() < 10 {
                break;
            }
            let norm = |s: &UnitSample| s.force_mps2.iter().map(|f| f * f).sum::<f64>().sqrt();
            let mean = window.iter().map(norm).sum::<f64>() / window.len() as f64;
            let spread =
                window.iter().map(|s| (norm(s) - mean).powi(2)).sum::<f64>() / window.len() as f64;
            if spread < 0.15 * 0.15 && (mean / standard - 1.0).abs() < 0.1 {
                return Some(mean);
            }
            from = to;
        }
        None
    }
}

/// eᵀ P⁻¹ e of a position error, m, with covariance P, m².
pub fn nees(error: [f64; 3], p: [[f64; 3]; 3]) -> f64 {
    let det = |m: [[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
            - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let whole = det(p);
    if whole <= 0.0 {
        return f64::INFINITY;
    }
    (0..3)
        .map(|column| {
            let mut changed = p;
            for (row, e) in changed.iter_mut().zip(error) {
                row[column] = e;
            }
            det(changed) / whole * error[column]
        })
        .sum()
}
