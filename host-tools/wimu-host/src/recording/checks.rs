//! Checks that hold for recordings of every format: order of time, rows that are no measurement, sensors that have stopped.

use super::{Origin, Quantity, TrackInfo, Unit};
use crate::plural::counted;
use crate::stats::norm;
use crate::{Code, Problem};

/// Ratios of the magnitude of three equal components to the usual one, below and above which they are no measurement: drivers
/// write 0, −1 or −999 where the bus failed. Chosen: −1 LSB of 2048 LSB/g is below, shocks are not above in three equal axes.
const NO_MEASUREMENT: [f64; 2] = [1e-3, 5.0];
/// Largest output of any sensor: an integer of 32 bits, and in SI units 100,000 g or 10⁶ rad/s.
const LARGEST_COUNT: f64 = 4_294_967_296.0;
const LARGEST_SI: f64 = 1e6;
/// Fraction of rows without numbers that are reported of a gyroscope: one that is slower than the accelerometer of its table
/// has at least a third of empty rows.
const FEW: f64 = 0.25;
/// Weight of a row in the usual magnitude.
const WEIGHT: f64 = 1.0 / 16.0;
/// Rows by which an axis is known to have stopped, at least.
const MIN_ROWS: u64 = 100;
/// Rows that repeat the one before, in mean runs of such rows, by which a sensor is known to have stopped: a row of a noisy
/// sensor repeats once in three at most, and 3⁻¹⁶ is one in forty million.
const FROZEN_RUNS: f64 = 16.0;
/// Mean length of a run of equal rows above which the sensor is too coarse for that.
const COARSE_RUN: f64 = 3.0;

/// Rows, and the time of the first, ns.
#[derive(Clone, Copy, Default)]
struct Rows {
    count: u64,
    first_ns: i64,
}

impl Rows {
    fn add(&mut self, time_ns: i64) {
        if self.count == 0 {
            self.first_ns = time_ns;
        }
        self.count += 1;
    }
}

/// What the rows of a track were.
pub(super) struct Checks {
    pub(super) info: TrackInfo,
    factor: f64,
    rows: u64,
    latest_ns: Option<i64>,
    /// Rows that have a wrong stamp, are earlier than a row before, not finite, larger than any output, and no measurement.
    wrong: u64,
    early: Rows,
    not_finite: Rows,
    too_large: Rows,
    /// The first of these values.
    large: f64,
    replaced: Rows,
    /// Usual magnitude.
    usual: f64,
    last: Option<[f64; 4]>,
    /// Rows that are equal to the last one and follow each other, the most of them, and the number of such runs.
    run: Rows,
    longest: Rows,
    runs: u64,
    /// Whether each axis has had one value.
    is_constant: [bool; 3],
}

impl Checks {
    pub(super) fn new(info: TrackInfo, factor: f64) -> Self {
        Self {
            info,
            factor,
            rows: 0,
            latest_ns: None,
            wrong: 0,
            early: Rows::default(),
            not_finite: Rows::default(),
            too_large: Rows::default(),
            large: 0.0,
            replaced: Rows::default(),
            usual: 0.0,
            last: None,
            run: Rows::default(),
            longest: Rows::default(),
            runs: 0,
            is_constant: [true; 3],
        }
    }

    pub(super) fn has_rows(&self) -> bool {
        self.rows > 0
    }

    fn is_force(&self) -> bool {
        self.info.quantity == Quantity::SpecificForce
    }

    /// Whether it is a sensor of specific force or angular rate.
    fn is_inertial(&self) -> bool {
        let is_rate = self.info.quantity == Quantity::AngularRate;
        (self.is_force() || is_rate) && self.info.origin == Origin::Sensor
    }

    /// Whether all rows of an inertial sensor are 0.
    pub(super) fn is_zero(&self) -> bool {
        self.runs == 1 && self.last == Some([0.0; 4])
    }

    /// The time and the values of a row, which are not numbers if it cannot be used.
    pub(super) fn see(&mut self, time_ns: i64, values: &[f64], in_order: bool) -> (i64, [f64; 4]) {
        let mut row = [0.0; 4];
        row.iter_mut().zip(values).for_each(|(to, value)| *to = value * self.factor);
        self.rows += 1;
        if values.is_empty() {
            self.wrong += 1;
            return (time_ns, [f64::NAN; 4]);
        }
        if let Some(latest_ns) = self.latest_ns.filter(|latest| in_order && time_ns < *latest) {
            self.early.add(latest_ns);
            return (latest_ns, [f64::NAN; 4]);
        }
        self.latest_ns = Some(time_ns);
        if !row.iter().all(|value| value.is_finite()) {
            self.not_finite.add(time_ns);
        } else if self.is_inertial() {
            if let Some(large) = row.into_iter().find(|value| value.abs() > self.largest()) {
                if self.too_large.count == 0 {
                    self.large = large;
                }
                self.too_large.add(time_ns);
                return (time_ns, [f64::NAN; 4]);
            }
            if self.is_no_measurement(row) {
                self.replaced.add(time_ns);
                return (time_ns, [f64::NAN; 4]);
            }
            self.follow(time_ns, row);
        }
        (time_ns, row)
    }

    fn largest(&self) -> f64 {
        if self.info.unit == Unit::Si { LARGEST_SI } else { LARGEST_COUNT }
    }

    /// Whether an accelerometer has three equal components that are far from its usual magnitude.
    fn is_no_measurement(&self, row: [f64; 4]) -> bool {
        let [x, y, z, _] = row;
        let [least, most] = NO_MEASUREMENT;
        let magnitude = norm(row);
        let is_far = magnitude < least * self.usual || magnitude > most * self.usual;
        self.is_force() && x == y && y == z && self.usual > 0.0 && is_far
    }

    /// Counts runs of equal rows, and axes with one value.
    fn follow(&mut self, time_ns: i64, row: [f64; 4]) {
        let weight = if self.usual > 0.0 { WEIGHT } else { 1.0 };
        self.usual += weight * (norm(row) - self.usual);
        if self.last != Some(row) {
            self.run = Rows::default();
            self.runs += 1;
        }
        self.run.add(time_ns);
        if self.run.count > self.longest.count {
            self.longest = self.run;
        }
        if let Some(last) = self.last.replace(row) {
            let axes = self.is_constant.iter_mut().enumerate();
            axes.for_each(|(axis, is_constant)| *is_constant &= last[axis] == row[axis]);
        }
    }

    /// What was found; `start_ns` is the first time of the recording.
    pub(super) fn problems(&self, start_ns: i64) -> Vec<Problem> {
        let (rows, track) = (self.rows, &self.info.name);
        let at = |rows: Rows| {
            let first_s = rows.first_ns.saturating_sub(start_ns) as f64 * 1e-9;
            (counted(rows.count as usize, "row"), format!("the first at {first_s:.2} s"))
        };
        let mut problems = Vec::new();
        let few = self.is_inertial() && (self.not_finite.count as f64) < FEW * rows as f64;
        if self.not_finite.count > 0 && (self.is_force() || few) {
            let (rows_text, first) = at(self.not_finite);
            let text = format!("{rows_text} of {rows} of {track} not finite numbers, {first}");
            problems.push(Code::RowsMasked.warning(text).remedy("they are left out"));
        }
        if self.too_large.count > 0 {
            let (rows_text, first) = at(self.too_large);
            let text = format!(
                "{rows_text} of {rows} of {track} exceed the range of any sensor, {first}: {:.3e}",
                self.large
            );
            let remedy = "they are left out; check the driver and the number format of the file";
            problems.push(Code::RowsMasked.warning(text).remedy(remedy));
        }
        if self.replaced.count > 0 {
            let (rows_text, first) = at(self.replaced);
            let text = format!(
                "{rows_text} of {rows} of {track} have three equal values, as drivers write without a measurement, {first}"
            );
            problems.push(Code::RowsMasked.warning(text).remedy("they are left out"));
        }
        if self.is_force() && self.early.count > 0 {
            let (rows_text, first) = at(self.early);
            let text = format!(
                "time goes back: {rows_text} of {track} earlier than a row before, {first}"
            );
            let remedy =
                "they are left out; sort the rows, or select one of several runs with --where";
            problems.push(Code::TimesUnordered.warning(text).remedy(remedy));
        }
        if let Some(text) = self.stopped() {
            let text = format!("the {} of {track} {text}", self.info.quantity.name());
            problems.push(Code::Frozen.warning(text).remedy("check the sensor and its wiring"));
        }
        problems.into_iter().map(|problem| problem.of_sensor(self.info.sensor)).collect()
    }

    /// Axes with one value while others are noisy, or a run of equal rows that noise does not explain.
    fn stopped(&self) -> Option<String> {
        if self.runs == 0 || self.rows < MIN_ROWS {
            return None;
        }
        let longest = self.longest.count as f64;
        let others = self.rows as f64 - longest;
        // Of a sensor that never changes there are no other runs.
        let run = others / self.runs.saturating_sub(1) as f64;
        if self.runs > 1 && run >= COARSE_RUN {
            return None;
        }
        let axes = ["X", "Y", "Z"].into_iter().zip(self.is_constant);
        let axes: Vec<&str> = axes.filter(|(_, is)| *is).map(|(axis, _)| axis).collect();
        if !axes.is_empty() {
            return Some(format!("has one value throughout on {}", axes.join(", ")));
        }
        (longest > FROZEN_RUNS * run && longest < others)
            .then(|| format!("does not change in {longest} rows"))
    }

    /// An accelerometer most of whose rows cannot be used.
    pub(super) fn refusal(&self) -> Option<Problem> {
        let (rows, track) = (self.rows, &self.info.name);
        let unusable = self.not_finite.count + self.replaced.count + self.too_large.count;
        let early = self.early.count + self.wrong;
        let message = format!(
            "most rows of {track} cannot be used: {unusable} of {rows} are not usable numbers, {early} are earlier than a row before"
        );
        let remedy = "check the file; if it contains several runs, select one with --where; if its rows are means over static \
                      poses, add --poses";
        (self.is_force() && 2 * (unusable + early) > rows)
            .then(|| Code::DataRefused.error(message, remedy))
    }
}
