//! Where the sensors of an array are, which way they point, how late they sample, and how wrong they are.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use wimu_model::ErrorModel;

use crate::calibration::{Calibration, Correction};
use crate::formats::table::{LENGTH, MeasuredColumn, Measurements};
use crate::navigation::distance_m;
use crate::{Code, OutputFile, Problem, Result};

/// One triad of an array.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArraySensor {
    /// Place of each sensing axis, m, body axes: the proof masses of one chip are not at one place.
    pub places_m: [[f64; 3]; 3],
    /// Direction of its X, Y and Z axis, body axes: unit vectors at right angles.
    #[serde(default = "aligned")]
    pub axes: [[f64; 3]; 3],
    /// Delay of its samples against their time stamps, µs.
    #[serde(default)]
    pub delay_us: f64,
    /// Error model of its output, in its own axes; `None` where it is uncalibrated, and the rests of a
    /// recording must tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<ErrorModel>,
    /// The sensitivity by which counts become the output of `model`; `None` where that is a recording's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensitivity_lsb_per_g: Option<f64>,
}

fn aligned() -> [[f64; 3]; 3] {
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
}

impl ArraySensor {
    /// One whose axes are the body's and lie at one place, m.
    pub fn at(place_m: [f64; 3]) -> Self {
        Self {
            places_m: [place_m; 3],
            axes: aligned(),
            delay_us: 0.0,
            model: None,
            sensitivity_lsb_per_g: None,
        }
    }

    /// What corrects its output in m/s²; `lsb_per_g` is the sensitivity by which that was scaled, where it comes from counts.
    pub fn correction(&self, lsb_per_g: Option<f64>) -> Correction {
        let factor = match (&self.model, lsb_per_g, self.sensitivity_lsb_per_g) {
            (Some(_), Some(scaled_by), Some(own)) => scaled_by / own,
            _ => 1.0,
        };
        let rotation = std::array::from_fn(|i| self.axes.map(|axis| axis[i]));
        Correction::of_model(self.model.unwrap_or_default(), factor, rotation)
    }

    /// Its output in body axes.
    pub fn in_body_axes(&self, output: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| (0..3).map(|axis| self.axes[axis][i] * output[axis]).sum())
    }
}

/// The sensors of an array, in the order of a recording's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArrayGeometry {
    schema: String,
    /// How well each coordinate of a place is known, mm, one standard deviation, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place_sd_mm: Option<f64>,
    /// How well each delay is known, µs, one standard deviation, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay_sd_us: Option<f64>,
    /// The sensors, of three axes each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<ArraySensor>,
}

impl ArrayGeometry {
    /// Name of the JSON object.
    pub const SCHEMA: &'static str = "wimu.array/1";

    /// Of these sensors.
    pub fn new(sensors: Vec<ArraySensor>) -> Self {
        Self { schema: Self::SCHEMA.to_owned(), place_sd_mm: None, delay_sd_us: None, sensors }
    }

    /// The same with the error models that `wimu calibrate` stored for each sensor, in their order. What
    /// `wimu align` found besides turns the sensor's axes.
    ///
    /// # Errors
    /// `usage` for another number of files than of sensors; those of [`Calibration::read`].
    pub fn with_models(mut self, files: &[PathBuf]) -> Result<Self> {
        if files.len() != self.sensors.len() {
            return Err(Code::Usage.error(
                format!(
                    "there are {} calibrations for {} sensors of three axes",
                    files.len(),
                    self.sensors.len()
                ),
                "give --with once for each sensor, in the order of the geometry",
            ));
        }
        for (sensor, file) in self.sensors.iter_mut().zip(files) {
            let calibration = Calibration::read(file)?;
            let stored = calibration.sensor();
            sensor.model = Some(stored.accelerometer.model);
            sensor.sensitivity_lsb_per_g = stored.accelerometer.sensitivity_lsb_per_g;
            let turn = stored.alignment.matrix();
            let axes = sensor.axes;
            sensor.axes = std::array::from_fn(|axis| {
                std::array::from_fn(|i| (0..3).map(|j| turn[j][axis] * axes[j][i]).sum())
            });
        }
        Ok(self)
    }

    /// Of triads in body axes at these places, m.
    pub fn at(places_m: &[[f64; 3]]) -> Self {
        Self::new(places_m.iter().copied().map(ArraySensor::at).collect())
    }

    /// Farther apart than this, m, the sensors of an array are hardly on one body.
    pub const LARGE_M: f64 = 1.0;

    /// The largest distance between two places, m.
    pub fn span_m(&self) -> f64 {
        let places = self.places_m();
        let from = |a: &[f64; 3]| {
            let distances = places.iter().map(|b| distance_m(*a, *b));
            distances.fold(0.0, f64::max)
        };
        places.iter().map(from).fold(0.0, f64::max)
    }

    /// Positions of all axes, m.
    fn places_m(&self) -> Vec<[f64; 3]> {
        self.sensors.iter().flat_map(|sensor| sensor.places_m).collect()
    }

    /// The point that paths are those of: the mean of the places, m, body axes.
    pub fn centre_m(&self) -> [f64; 3] {
        let places = self.places_m();
        let count = places.len().max(1) as f64;
        std::array::from_fn(|i| places.iter().map(|p| p[i]).sum::<f64>() / count)
    }

    /// Reads a JSON object as [`write`](Self::write) writes it, or places as a CSV table: three rows `x`,
    /// `y`, `z` in m with one column a sensor, or one row a sensor with columns `X (m)`, `Y (m)`, `Z (m)`,
    /// or `X (mm)`, …. A table whose places are more than 1 m apart is refused: an array as large as that is
    /// given as JSON. A name such as
    /// `four:30mm` is an arrangement, where there is no such file.
    ///
    /// # Errors
    /// `file_unreadable`, `csv_bad_number`, `csv_missing_column`, `bad_calibration`.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        if !path.exists()
            && let Some(preset) = preset(&name)
        {
            return preset;
        }
        let text = std::fs::read_to_string(path).map_err(|e| Problem::file(&name, "read", &e))?;
        if !text.trim_start().starts_with('{') {
            let geometry = Self::at(&places(&Measurements::of(&name, &text)?)?);
            let span = geometry.span_m();
            if span > Self::LARGE_M {
                return Err(Code::BadCalibration.error(format!("its places are up to {span:.1} m apart: are they in mm?"),
                    "write the columns `X (mm),Y (mm),Z (mm)`; give an array as large as this as JSON",
                )
                .at(&name));
            }
            return Ok(geometry);
        }
        let bad = |message: String| {
            Code::BadCalibration.error(message,
                "give a file that `wimu calibrate --setup geometry=FILE` wrote, or a table of places in m",
            )
            .at(&name)
        };
        let geometry: Self = serde_json::from_str(&text).map_err(|e| bad(e.to_string()))?;
        if geometry.schema != Self::SCHEMA {
            return Err(bad(format!(
                "its schema is `{}`, not `{}`",
                geometry.schema,
                Self::SCHEMA
            )));
        }
        if geometry.sensors.is_empty() {
            return Err(bad("it has no `sensors`".to_owned()));
        }
        let known = [geometry.place_sd_mm, geometry.delay_sd_us];
        if known.into_iter().flatten().any(|sd| !(sd > 0.0 && sd.is_finite())) {
            return Err(bad("its place_sd_mm or delay_sd_us is not a positive number".to_owned()));
        }
        for (index, sensor) in geometry.sensors.iter().enumerate() {
            let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| a[i] * b[i]).sum::<f64>();
            let [x, y, z] = sensor.axes;
            let square = [dot(x, x) - 1.0, dot(y, y) - 1.0, dot(z, z) - 1.0];
            let crossed = [dot(x, y), dot(y, z), dot(z, x)];
            let sound = square.iter().chain(&crossed).all(|v| v.abs() < 1e-3);
            let finite = sensor.places_m.iter().flatten().all(|v| v.is_finite());
            if !(sound && finite && sensor.delay_us.is_finite()) {
                return Err(bad(format!(
                    "sensor {index} (from 0) has a place or delay that is no number, or axes that are \
                     not of length 1 and at right angles"
                )));
            }
            let positive = |v: &f64| *v > 0.0 && v.is_finite();
            if sensor.sensitivity_lsb_per_g.is_some_and(|v| !positive(&v)) {
                return Err(bad(format!(
                    "the sensitivity of sensor {index} (from 0) is not a positive number"
                )));
            }
            let [[a, b, c], [d, e, f], [g, h, i]] = sensor.axes;
            if a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g) < 0.0 {
                return Err(bad(format!(
                    "the axes of sensor {index} (from 0) are left-handed: one of them has the wrong sign"
                )));
            }
        }
        Ok(geometry)
    }

    /// Writes it as JSON.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut text = serde_json::to_string_pretty(self).unwrap_or_default();
        text.push('\n');
        OutputFile::write(path, text)
    }
}

/// Places of a table: three rows `x`, `y`, `z` with a column for each sensor, in m, or a row for each sensor.
fn places(table: &Measurements) -> Result<Vec<[f64; 3]>> {
    let place = |at: [(usize, MeasuredColumn); 3]| -> Result<[f64; 3]> {
        let [x, y, z] = at.map(|(row, column)| {
            let value = table.value(row, column)?;
            value.ok_or_else(|| table.empty("a place is incomplete", "give places in m"))
        });
        Ok([x?, y?, z?])
    };
    let row_of =
        |axis: &str| (0..table.len()).find(|row| table.text(*row, 0).eq_ignore_ascii_case(axis));
    if let [Some(x), Some(y), Some(z)] = ["x", "y", "z"].map(row_of) {
        let columns = (1..table.header.len()).map(MeasuredColumn::of_si);
        return columns.map(|column| place([x, y, z].map(|row| (row, column)))).collect();
    }
    let [Some(x), Some(y), Some(z)] = ["X", "Y", "Z"].map(|axis| table.column(&[axis], LENGTH))
    else {
        let remedy =
            "write a line `X (m),Y (m),Z (m)` and a line with three numbers for each sensor";
        let error = Code::CsvMissingColumn.error("it does not say where the sensors are", remedy);
        return Err(error.at(&table.name));
    };
    (0..table.len()).map(|row| place([x, y, z].map(|column| (row, column)))).collect()
}

/// Four triads at alternate corners of a cube: the smallest set whose angular rate has two roots only.
const FOUR: [[f64; 3]; 4] =
    [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
/// Six triads on the axes.
const OCTAHEDRON: [[f64; 3]; 6] = [
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, 0.0, -1.0],
];
/// Eight triads on both sides of a square board, as on a MIMU4444: pairs at its corners, above and below in turn.
const BOARD: [[f64; 3]; 8] = [
    [-1.0, 1.0, 1.0],
    [-1.0, 1.0, -1.0],
    [-1.0, -1.0, 1.0],
    [-1.0, -1.0, -1.0],
    [1.0, 1.0, 1.0],
    [1.0, 1.0, -1.0],
    [1.0, -1.0, 1.0],
    [1.0, -1.0, -1.0],
];

/// The geometry of a name such as `four:30mm`, `octahedron:0.03m` or `board:9.5mm,2mm`; `None` where it is no name of one.
fn preset(text: &str) -> Option<Result<ArrayGeometry>> {
    let (name, lengths) = text.split_once(':')?;
    let lengths: Option<Vec<f64>> = lengths.split(',').map(metres).collect();
    let triads = |places: &[[f64; 3]], [x, y, z]: [f64; 3]| -> Vec<[f64; 3]> {
        places.iter().map(|place| [place[0] * x, place[1] * y, place[2] * z]).collect()
    };
    let places = match (name, lengths.as_deref()) {
        ("four", Some([arm])) => triads(&FOUR, [arm / 3_f64.sqrt(); 3]),
        ("octahedron", Some([arm])) => triads(&OCTAHEDRON, [*arm; 3]),
        ("board", Some([side, thickness])) => triads(&BOARD, [*side, *side, *thickness]),
        // A name of a file.
        (name, None) if !["four", "octahedron", "board"].contains(&name) => return None,
        _ => {
            let message = format!("`{text}` is no arrangement with its lengths");
            let remedy = "give four:ARM (four triads at alternate corners of a cube), octahedron:ARM or \
                          board:HALF_SIDE,HALF_THICKNESS (eight triads), lengths in mm or m, for example four:30mm";
            return Some(Err(Code::Usage.error(message, remedy)));
        }
    };
    Some(Ok(ArrayGeometry::at(&places)))
}

/// `100mm` or `0.1m`, positive.
fn metres(text: &str) -> Option<f64> {
    let text = text.trim();
    let (number, unit) = match text.strip_suffix("mm") {
        Some(number) => (number, 1e-3),
        None => (text.strip_suffix('m')?, 1.0),
    };
    let value = number.trim().parse::<f64>().ok()? * unit;
    (value > 0.0 && value.is_finite()).then_some(value)
}
