//! Recordings and their tracks.

use std::borrow::Cow;
use std::path::PathBuf;

use numpy::{Ix1, Ix2, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyList;
use wimu_host::formats::{self, ReadOptions};
use wimu_host::recording::{Quantity, Recording as Data, Sink, Track as Measured, TrackInfo, Unit};
use wimu_link::LinkRole;

use crate::arrays::{Array1, Numbers, column, plain};
use crate::failure::{Result, usage};

/// Largest time of an array, s: 292 years in nanoseconds are the range of 64 bits.
const LAST_S: f64 = 9e9;

type Column<'py> = Numbers<'py, Ix1>;
type Rows<'py> = Numbers<'py, Ix2>;

/// What was measured: the content of a file, or arrays.
#[pyclass(frozen, module = "wimu")]
pub struct Recording {
    pub data: Data,
    pub options: ReadOptions,
    /// The file that it was read from.
    pub path: Option<PathBuf>,
    tracks: PyOnceLock<Py<PyList>>,
}

impl Recording {
    fn new(data: Data, options: ReadOptions, path: Option<PathBuf>) -> Self {
        Self { data, options, path, tracks: PyOnceLock::new() }
    }
}

/// A track of a recording. Its arrays are read-only.
#[pyclass(frozen, get_all, module = "wimu")]
pub struct Track {
    name: String,
    quantity: &'static str,
    unit: &'static str,
    si_per_lsb: Option<f64>,
    sensor: u8,
    origin: &'static str,
    corrected: bool,
    rate_hz: Option<f64>,
    times: Array1,
    times_ns: Array1<i64>,
    values: Py<PyAny>,
    valid: Array1<bool>,
}

impl Track {
    fn new(py: Python<'_>, track: &Measured) -> Result<Self> {
        let info = &track.info;
        let (unit, si_per_lsb) = match info.unit {
            Unit::Si => (info.quantity.si(), None),
            Unit::Counts { si_per_lsb } => ("LSB", si_per_lsb),
            _ => ("unknown", None),
        };
        let by_times = || track.median_step_s().map(|step_s| 1.0 / step_s);
        let values = (0..track.len()).filter_map(|row| track.row(row));
        let values = PyArray1::from_iter(py, values.flatten().copied());
        let values = match info.quantity.width() {
            1 => fixed(values)?.into_any(),
            width => fixed(values.reshape([track.len(), width])?)?.into_any(),
        };
        Ok(Self {
            name: info.name.clone(),
            quantity: info.quantity.name(),
            unit,
            si_per_lsb,
            sensor: info.sensor,
            origin: info.origin.name(),
            corrected: info.corrected,
            rate_hz: if info.timeless { None } else { info.rate_hz.or_else(by_times) },
            times: column(py, track.times_ns().iter().map(|ns| *ns as f64 * 1e-9)),
            times_ns: column(py, track.times_ns().iter().copied()),
            values: values.unbind(),
            valid: column(py, track.mask().iter().copied()),
        })
    }
}

/// The array, which can no longer be written to.
fn fixed<'py, D: numpy::ndarray::Dimension>(
    array: Bound<'py, numpy::PyArray<f64, D>>,
) -> Result<Bound<'py, numpy::PyArray<f64, D>>> {
    let writable = array.try_readwrite().map_err(PyErr::from)?;
    drop(writable.make_nonwriteable());
    Ok(array)
}

#[pymethods]
impl Track {
    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.valid.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let rows = self.__len__(py)?;
        let (name, quantity, unit) = (&self.name, self.quantity, self.unit);
        Ok(format!("<wimu.Track {name}: {quantity}, {unit}, {rows} rows>"))
    }
}

#[pymethods]
impl Recording {
    #[new]
    #[pyo3(signature = (times, specific_force, *, angular_rate=None, magnetic_field=None, temperature=None, unit="m/s2",
                        poses=false, name="arrays"))]
    #[allow(clippy::too_many_arguments, reason = "keyword arguments")]
    fn of_arrays(
        times: Column<'_>,
        specific_force: Rows<'_>,
        angular_rate: Option<Rows<'_>>,
        magnetic_field: Option<Rows<'_>>,
        temperature: Option<Column<'_>>,
        unit: &str,
        poses: bool,
        name: &str,
    ) -> Result<Self> {
        let unit = match unit {
            "m/s2" | "m/s²" => Unit::Si,
            "LSB" => Unit::Counts { si_per_lsb: None },
            _ => {
                return Err(usage(
                    format!("unit={unit:?} is not known"),
                    "the units are m/s2 and LSB",
                ));
            }
        };
        let times_s = times.as_array();
        if let Some(row) = times_s.iter().position(|t| t.is_nan() || t.abs() > LAST_S) {
            let message = format!("times[{row}] is {}", times_s[row]);
            return Err(usage(message, "times are finite numbers, in seconds"));
        }
        let times_ns: Vec<i64> = times_s.iter().map(|t| (t * 1e9).round() as i64).collect();
        let mut data = Data::new(name);
        data.format = "arrays";
        let mut add = |name: &str, quantity: Quantity, unit, values: Vec<f64>, columns: usize| {
            if (values.len(), columns) != (times_ns.len() * quantity.width(), quantity.width()) {
                let rows = values.len() / columns.max(1);
                let message =
                    format!("{name} has {rows} rows of {columns} for {} times", times_ns.len());
                let remedy = format!("one row of {} for each time", quantity.width());
                return Err(usage(message, remedy));
            }
            let track = data.track(TrackInfo::new(name, quantity, unit));
            let rows = values.chunks_exact(columns.max(1));
            times_ns.iter().zip(rows).for_each(|(time_ns, row)| data.row(track, *time_ns, row));
            Ok(())
        };
        let flat =
            |rows: &Rows<'_>| (rows.as_array().iter().copied().collect(), rows.as_array().ncols());
        let (values, columns) = flat(&specific_force);
        add("specific_force", Quantity::SpecificForce, unit, values, columns)?;
        for (name, quantity, rows) in [
            ("angular_rate", Quantity::AngularRate, &angular_rate),
            ("magnetic_field", Quantity::MagneticField, &magnetic_field),
        ] {
            if let Some((values, columns)) = rows.as_ref().map(flat) {
                add(name, quantity, Unit::Si, values, columns)?;
            }
        }
        if let Some(celsius) = temperature {
            let values = celsius.as_array().to_vec();
            add("temperature", Quantity::Temperature, Unit::Si, values, 1)?;
        }
        let data = data.checked(!poses)?;
        let mut options = ReadOptions::default();
        options.poses = poses;
        Ok(Self::new(data, options, None))
    }

    /// Name in messages.
    #[getter]
    fn name(&self) -> &str {
        &self.data.name
    }

    /// Format, as docs/reference/formats.md names it.
    #[getter]
    fn format(&self) -> &str {
        self.data.format
    }

    /// Tracks in the order of the file.
    #[getter]
    fn tracks(&self, py: Python<'_>) -> Result<Py<PyList>> {
        let list = self.tracks.get_or_try_init(py, || {
            let tracks = self.data.tracks().iter().map(|track| Track::new(py, track));
            let tracks = tracks.collect::<Result<Vec<_>>>()?;
            Ok::<_, crate::failure::Failure>(PyList::new(py, tracks)?.unbind())
        })?;
        Ok(list.clone_ref(py))
    }

    /// What was noticed at reading, as dictionaries.
    #[getter]
    fn findings(&self, py: Python<'_>) -> Result<Py<PyAny>> {
        plain(py, &self.data.findings)
    }

    fn __repr__(&self) -> String {
        let (name, format, tracks) = (&self.data.name, self.data.format, self.data.tracks().len());
        format!("<wimu.Recording {name}: {format}, {tracks} tracks>")
    }
}

/// Reads a recording of any format that wimu knows.
#[pyfunction]
#[pyo3(signature = (path, *, topic=None, columns=None, units=None, r#where=None, format=None, zero_count=None, link=None,
                    poses=false))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments")]
pub fn read(
    py: Python<'_>,
    path: PathBuf,
    topic: Option<String>,
    columns: Option<String>,
    units: Option<String>,
    r#where: Option<&str>,
    format: Option<String>,
    zero_count: Option<f64>,
    link: Option<&str>,
    poses: bool,
) -> Result<Recording> {
    let role = |name: &str| {
        let mut roles = [LinkRole::Cable, LinkRole::Wireless].into_iter();
        let role = roles.find(|role| role.to_string() == name);
        role.ok_or_else(|| {
            usage(format!("link={name:?} is not known"), "the links are cable and wireless")
        })
    };
    let mut options = ReadOptions::default();
    options.topic = topic;
    options.columns = columns;
    options.units = units;
    options.filter = r#where.map(str::parse).transpose()?;
    options.format = format;
    options.zero_count = zero_count;
    options.role = link.map(role).transpose()?;
    options.poses = poses;
    let data = py.detach(|| formats::load(&path, &options))?;
    Ok(Recording::new(data, options, Some(path)))
}

/// What a function computes from: a recording, or the path of one.
#[derive(FromPyObject)]
pub enum Source {
    Recording(Py<Recording>),
    Path(PathBuf),
}

impl Source {
    /// The recording.
    pub fn data(&self) -> wimu_host::Result<Cow<'_, Data>> {
        match self {
            Self::Recording(recording) => Ok(Cow::Borrowed(&recording.get().data)),
            Self::Path(path) => formats::load(path, &ReadOptions::default()).map(Cow::Owned),
        }
    }

    /// The file, if there is one.
    pub fn path(&self) -> Option<&std::path::Path> {
        match self {
            Self::Recording(recording) => recording.get().path.as_deref(),
            Self::Path(path) => Some(path),
        }
    }

    /// How it is read.
    pub fn options(&self) -> ReadOptions {
        match self {
            Self::Recording(recording) => recording.get().options.clone(),
            Self::Path(_) => ReadOptions::default(),
        }
    }
}
