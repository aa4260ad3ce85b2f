//! A recording: tracks of measured quantities over time, from any format.
//!
//! A loader (see [`formats`](crate::formats)) hands tracks and rows to a [`Sink`]; [`Recording`] is the sink that
//! keeps them. Values are in SI where the file names or implies the unit.
//!
//! ```
//! use wimu_host::recording::{Quantity, Recording, Sink, TrackInfo, Unit};
//!
//! let mut recording = Recording::new("example");
//! let track = recording.track(TrackInfo::new("/imu/data", Quantity::SpecificForce, Unit::Si));
//! recording.row(track, 0, &[0.0, 0.0, 9.81]);
//! recording.row(track, 10_000_000, &[0.0, f64::NAN, 9.81]);
//! recording.row(track, 20_000_000, &[0.0, 0.1, 9.80]);
//! let force = recording.first(Quantity::SpecificForce).expect("a track");
//! assert_eq!((force.len(), force.valid().count()), (3, 2));
//! ```

mod beside;
mod checks;
mod gravity;
mod intake;
mod join;
mod link;
mod samples;
mod stamps;
mod times;

use wimu_model::SensorId;

use crate::problem::Severity;
use crate::stats::median;
use crate::untrusted::printable;
use crate::{Code, Problem};
pub(crate) use intake::{How, Intake};
pub(crate) use link::{FORMAT as OF_WIMU, LinkRows};
pub(crate) use samples::{ASSUMED_RATE_HZ, gaps_finding, no_usable_row, unit_of};
pub use samples::{Output, OutputUnit, RateSource, Samples, Selection};
pub use stamps::Stamped;
pub(crate) use times::{REACH, rate_and_gaps};

/// What a track measures, with the SI unit of its values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Quantity {
    /// Specific force, m/s², sensor axes.
    SpecificForce,
    /// Acceleration without gravity, m/s², sensor axes.
    LinearAcceleration,
    /// Gravity as a device estimated it, m/s², sensor axes, +g upwards.
    Gravity,
    /// Angular rate, rad/s, sensor axes.
    AngularRate,
    /// Magnetic flux density, T, sensor axes.
    MagneticField,
    /// Temperature, °C.
    Temperature,
    /// Attitude, quaternion W, X, Y, Z, body to navigation axes.
    Attitude,
    /// Position, m, navigation axes.
    Position,
    /// Velocity, m/s, navigation axes.
    Velocity,
    /// One number of any other column, in the unit that its name says.
    Scalar,
}

impl Quantity {
    /// Number of values in a row.
    pub fn width(self) -> usize {
        match self {
            Self::Temperature | Self::Scalar => 1,
            Self::Attitude => 4,
            _ => 3,
        }
    }

    /// Symbol of the unit.
    pub fn si(self) -> &'static str {
        self.words().1
    }

    /// The standard term.
    pub fn name(self) -> &'static str {
        self.words().0
    }

    fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::SpecificForce => ("specific force", "m/s²"),
            Self::LinearAcceleration => ("linear acceleration", "m/s²"),
            Self::Gravity => ("gravity", "m/s²"),
            Self::AngularRate => ("angular rate", "rad/s"),
            Self::MagneticField => ("magnetic field", "T"),
            Self::Temperature => ("temperature", "°C"),
            Self::Attitude => ("attitude", "1"),
            Self::Position => ("position", "m"),
            Self::Velocity => ("velocity", "m/s"),
            Self::Scalar => ("scalar", "1"),
        }
    }
}

/// Unit of a track's values.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Unit {
    /// That of its [`Quantity`].
    Si,
    /// LSB.
    Counts {
        /// SI units of one LSB, where the file gives it.
        si_per_lsb: Option<f64>,
    },
    /// The file does not say.
    Unknown,
}

/// Who or what made the values of a track.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Origin {
    /// A sensor.
    Sensor,
    /// A filter on the device.
    Estimate,
    /// A reference system.
    Truth,
}

impl Origin {
    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sensor => "sensor",
            Self::Estimate => "estimate",
            Self::Truth => "truth",
        }
    }
}

/// Description of a track.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct TrackInfo {
    /// Topic, message or columns in the file.
    pub name: String,
    /// What it measures.
    pub quantity: Quantity,
    /// Unit of its values.
    pub unit: Unit,
    /// Index of the sensor, from 0.
    pub sensor: u8,
    /// Who made it.
    pub origin: Origin,
    /// Whether the device corrected the values by a calibration.
    pub corrected: bool,
    /// Nominal sample rate, Hz, where the file gives it.
    pub rate_hz: Option<f64>,
    /// Whether the file has no times, and those of the rows follow from an assumed rate.
    pub timeless: bool,
    /// The stamps of the rows where they may be wrong: see [`Stamped`].
    pub stamps: Option<Stamped>,
    /// The sensor, where a device identified it.
    pub device: Option<SensorId>,
    /// Id of the device that the sensor is of, where it identified itself.
    pub device_id: Option<u64>,
    /// Full scale of an axis, SI, where the file gives it.
    pub full_scale: Option<f64>,
    /// Output at zero that was subtracted from the counts of the file, LSB.
    pub zero_count: Option<f64>,
}

impl TrackInfo {
    /// A track of sensor 0, not corrected.
    pub fn new(name: impl Into<String>, quantity: Quantity, unit: Unit) -> Self {
        Self {
            name: printable(&name.into()).into_owned(),
            quantity,
            unit,
            sensor: 0,
            origin: Origin::Sensor,
            corrected: false,
            rate_hz: None,
            timeless: false,
            stamps: None,
            device: None,
            device_id: None,
            full_scale: None,
            zero_count: None,
        }
    }

    /// The same of another sensor.
    #[must_use]
    pub fn of_sensor(mut self, sensor: u8) -> Self {
        self.sensor = sensor;
        self
    }

    /// The same of another origin.
    #[must_use]
    pub fn made_by(mut self, origin: Origin) -> Self {
        self.origin = origin;
        self
    }
}

/// Number of a track of a [`Sink`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TrackId(pub usize);

/// Receives the content of a file in its order.
pub trait Sink {
    /// A new track.
    fn track(&mut self, info: TrackInfo) -> TrackId;
    /// A row of a track: time, ns on the clock of the file, and values (as many as
    /// [`Quantity::width`]).
    fn row(&mut self, track: TrackId, time_ns: i64, values: &[f64]);
    /// Samples of a track are missing before its next row.
    fn gap(&mut self, _track: TrackId) {}
    /// Something noticed.
    fn finding(&mut self, finding: Problem);
    /// A track has nothing: it is left out. Called once all rows were handed on, for the last of several tracks first.
    fn leave_out(&mut self, _track: TrackId) {}
    /// Whether a file without inertial data serves.
    fn takes_any(&self) -> bool {
        false
    }
}

/// Values of one quantity over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// What it is.
    pub info: TrackInfo,
    times_ns: Vec<i64>,
    values: Vec<f64>,
    valid: Vec<bool>,
    gaps: Vec<usize>,
}

impl Track {
    /// Number of rows, valid or not.
    pub fn len(&self) -> usize {
        self.times_ns.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.times_ns.is_empty()
    }

    /// Time of each row, ns on the clock of the file.
    pub fn times_ns(&self) -> &[i64] {
        &self.times_ns
    }

    /// The values of a row.
    pub fn row(&self, index: usize) -> Option<&[f64]> {
        let width = self.info.quantity.width();
        self.values.get(index * width..(index + 1) * width)
    }

    /// Rows before which the file says that samples are missing, ascending.
    pub fn gaps(&self) -> &[usize] {
        &self.gaps
    }

    /// Whether each row may be used.
    pub fn mask(&self) -> &[bool] {
        &self.valid
    }

    /// Time, ns, and values of the valid rows.
    pub fn valid(&self) -> impl Iterator<Item = (i64, &[f64])> + Clone {
        let rows = self.values.chunks_exact(self.info.quantity.width());
        let rows = self.times_ns.iter().zip(rows).zip(&self.valid);
        rows.filter(|(_, valid)| **valid).map(|((time, row), _)| (*time, row))
    }

    /// [`valid`](Self::valid) rows of three values.
    pub fn vectors(&self) -> impl Iterator<Item = (i64, [f64; 3])> + Clone {
        self.valid().filter_map(|(time, row)| Some((time, row.try_into().ok()?)))
    }

    /// Median time between rows, s; `None` with fewer than two.
    pub fn median_step_s(&self) -> Option<f64> {
        let steps = self.times_ns.windows(2).map(|pair| pair[1].saturating_sub(pair[0]));
        let steps = steps.filter(|step| *step > 0).map(|step| step as f64);
        median(steps).map(|step_ns| step_ns * 1e-9)
    }
}

/// Everything in a file that wimu reads.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// What messages call it.
    pub name: String,
    /// Its format, as docs/reference/formats.md names it.
    pub format: &'static str,
    tracks: Vec<Track>,
    /// What was noticed at reading.
    pub findings: Vec<Problem>,
}

impl Recording {
    /// One without tracks.
    pub fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), ..Self::default() }
    }

    /// Its tracks, in the order in which the file brings them.
    pub fn tracks(&self) -> &[Track] {
        &self.tracks
    }

    /// Tracks of a quantity.
    pub fn of(&self, quantity: Quantity) -> impl Iterator<Item = &Track> {
        self.tracks.iter().filter(move |track| track.info.quantity == quantity)
    }

    /// The track of a quantity with the lowest sensor index, which is not an estimate or truth.
    pub fn first(&self, quantity: Quantity) -> Option<&Track> {
        self.of(quantity)
            .filter(|track| track.info.origin == Origin::Sensor)
            .min_by_key(|track| track.info.sensor)
    }

    /// Warnings and assumptions of reading, but for those that the caller reports itself.
    pub(crate) fn relevant(&self, of_caller: &[Code]) -> Vec<Problem> {
        use Code::{GravityAdded, UnitInferred, ZeroCount};
        let is_news = |finding: &&Problem| {
            let assumed = matches!(finding.code, UnitInferred | ZeroCount | GravityAdded);
            let counts = assumed || finding.severity > Severity::Note;
            counts && !of_caller.contains(&finding.code)
        };
        self.findings.iter().filter(is_news).cloned().collect()
    }

    /// The same with the accelerometer `sensor` only, and other values in its rows where they are given; its full scale is
    /// `full_scale`, m/s².
    pub(crate) fn with_one_force(
        &self,
        sensor: u8,
        values: &[Option<[f64; 3]>],
        full_scale: f64,
    ) -> Self {
        let mut recording = self.clone();
        let is_force = |track: &Track| {
            track.info.quantity == Quantity::SpecificForce && track.info.origin == Origin::Sensor
        };
        (recording.tracks).retain(|track| !is_force(track) || track.info.sensor == sensor);
        for track in recording.tracks.iter_mut().filter(|track| is_force(track)) {
            track.info.full_scale = Some(full_scale);
            let rows = track.values.as_chunks_mut().0.iter_mut();
            for ((row, valid), value) in rows.zip(&mut track.valid).zip(values) {
                if let Some(value) = value {
                    *row = *value;
                    *valid = value.iter().all(|axis| axis.is_finite());
                }
            }
        }
        recording
    }

    /// Hands its tracks and rows on, those that are masked as not a number.
    pub(crate) fn hand_on(&self, sink: &mut dyn Sink) {
        for track in &self.tracks {
            let id = sink.track(track.info.clone());
            let masked = &[f64::NAN; 4][..track.info.quantity.width()];
            for (index, (time_ns, is_valid)) in track.times_ns.iter().zip(&track.valid).enumerate()
            {
                if track.gaps.binary_search(&index).is_ok() {
                    sink.gap(id);
                }
                let row = track.row(index).filter(|_| *is_valid);
                sink.row(id, *time_ns, row.unwrap_or(masked));
            }
        }
    }

    /// Time of the first row of any track, ns on the clock of the file.
    pub fn start_ns(&self) -> Option<i64> {
        let first = |track: &Track| track.times_ns.iter().min().copied();
        self.tracks.iter().filter_map(first).min()
    }
}

impl Sink for Recording {
    fn track(&mut self, info: TrackInfo) -> TrackId {
        self.tracks.push(Track {
            info,
            times_ns: Vec::new(),
            values: Vec::new(),
            valid: Vec::new(),
            gaps: Vec::new(),
        });
        TrackId(self.tracks.len() - 1)
    }

    /// Rows that are not finite or have another number of values are kept as invalid.
    fn row(&mut self, track: TrackId, time_ns: i64, values: &[f64]) {
        let Some(track) = self.tracks.get_mut(track.0) else {
            return;
        };
        let width = track.info.quantity.width();
        let fits = values.len() == width;
        track.times_ns.push(time_ns);
        track.values.extend((0..width).map(|k| values.get(k).copied().unwrap_or(f64::NAN)));
        track.valid.push(fits && values.iter().all(|value| value.is_finite()));
    }

    fn gap(&mut self, track: TrackId) {
        if let Some(track) = self.tracks.get_mut(track.0) {
            track.gaps.push(track.times_ns.len());
        }
    }

    fn leave_out(&mut self, track: TrackId) {
        self.tracks.remove(track.0);
    }

    /// Each finding is kept once.
    fn finding(&mut self, finding: Problem) {
        if !self.findings.contains(&finding) {
            self.findings.push(finding);
        }
    }
}
