//! Accelerometers of different full scale on one body, merged by likelihood into one with the noise of the finest and the
//! range of the widest: equations (220) to (224).

mod findings;
mod fit;

use nalgebra::Vector3;
use wimu_model::STANDARD_GRAVITY_MPS2;
use wimu_nav::sensor::Reading;

use crate::recording::{Origin, Quantity, Recording, Track, Unit};
use crate::series::{At, Flags, Interp, Ns, Series};
use crate::{Code, Problem, Result};
use findings::{judged, saturated};
use fit::{Fine, Fit};

/// Most accelerometers of a merge.
pub const MOST: usize = 3;
/// Part of the full scale from which on an axis is saturated: 8 bits of ± 128 end at 0.992.
const RAIL: f64 = 0.99;
/// Least ratio of two full scales that are different ranges.
const WIDER: f64 = 1.5;
/// Largest full scale, *g*: of shock accelerometers.
const WIDEST_G: f64 = 200_000.0;
/// Full scales that a file does not give, in the order of the accelerometers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FullScales([Option<f64>; MOST]);

impl FullScales {
    /// From values in *g*; none where there are none.
    ///
    /// # Errors
    /// `usage` for one value, more than three, or one that no accelerometer has.
    pub fn of(values_g: &[f64]) -> Result<Self> {
        let are_possible = values_g.iter().all(|g| *g > 0.0 && *g <= WIDEST_G);
        if !are_possible || values_g.len() == 1 || values_g.len() > MOST {
            return Err(Code::Usage.error(
                format!("full scales of two or three accelerometers are needed, got {values_g:?}"),
                "give them in g, in the order of the accelerometers: 2,16",
            ));
        }
        let mps2 = |k: usize| Some(values_g.get(k)? * STANDARD_GRAVITY_MPS2);
        Ok(Self(std::array::from_fn(mps2)))
    }

    fn count(&self) -> usize {
        self.0.iter().flatten().count()
    }
}

/// Accelerometers merged into one.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Merge {
    /// The recording with one accelerometer: axes, scale and errors of the finest, range of the widest. Samples in which all
    /// are saturated are not numbers.
    pub recording: Recording,
    /// What was found; the first says what was merged.
    pub findings: Vec<Problem>,
}

impl Merge {
    /// Merges the accelerometers of a recording; `None` unless it has two or three whose full scales are known and differ.
    ///
    /// # Errors
    /// `usage` where full scales of another number of accelerometers are given, or one that samples exceed; `data_refused` for
    /// accelerometers that have the same samples or do not measure one motion, or whose relative rotation is large and not
    /// observed.
    pub fn of(recording: &Recording, given: &FullScales) -> Result<Option<Self>> {
        let tracks = forces(recording);
        if given.count() > 0 && given.count() != tracks.len() {
            let error = Code::Usage.error(
                format!("{} full scales for {} accelerometers", given.count(), tracks.len()),
                "give the full scale of each accelerometer with times, in g: `wimu info FILE` lists them",
            );
            return Err(error.at(&recording.name));
        }
        let sensor = |(k, track): (usize, &&Track)| Sensor::of(track, given.0.get(k).copied()?);
        let mut sensors: Vec<Sensor> = tracks.iter().enumerate().filter_map(sensor).collect();
        sensors.sort_by(|a, b| a.full_scale.total_cmp(&b.full_scale));
        let [finest, .., widest] = &sensors[..] else {
            return Ok(None);
        };
        let differ = widest.full_scale >= WIDER * finest.full_scale;
        let are_known = sensors.len() == tracks.len();
        if given.count() > 0 && !are_known {
            let error = Code::UnknownFormat.error(
                "the unit of an accelerometer is not known",
                "name it in its columns, as `Accelerometer 0 X (m/s²)` or (g)",
            );
            return Err(error.at(&recording.name));
        }
        if given.count() > 0 {
            findings::contradicted(&sensors).map_err(|error| error.at(&recording.name))?;
        }
        let wanted = differ || given.count() > 0;
        if !(2..=MOST).contains(&sensors.len()) || !are_known || !wanted {
            return Ok(None);
        }
        let merge = Self::of_sensors(recording, &tracks, &sensors);
        merge.map(Some).map_err(|error| error.at(&recording.name))
    }

    fn of_sensors(recording: &Recording, tracks: &[&Track], sensors: &[Sensor]) -> Result<Self> {
        let (finest, coarser) = (&sensors[0], &sensors[1..]);
        let mut readings = finest.readings();
        let (mut names, mut stood_in) = (vec![finest.name()], Vec::new());
        let mut findings = Vec::new();
        let mut noise = finest.noise;
        for coarse in coarser {
            let fine = Fine { times: &finest.series.t, readings: &readings, noise };
            let fit = fine.fit(&coarse.series, coarse.noise).ok_or_else(|| {
                Code::DataRefused.error(
                    format!(
                        "accelerometers {} and {} have too few samples in common",
                        finest.sensor, coarse.sensor
                    ),
                    "record both at the same time, some seconds of it within the range of the finer one",
                )
            })?;
            findings.extend(judged(finest, coarse, &fit)?);
            let (next, samples) = combine(&fine, coarse, &fit);
            names.push(coarse.name());
            stood_in.push(format!("{} in {samples} samples", coarse.sensor));
            readings = next;
            noise = std::array::from_fn(|axis| {
                let (p, q) = (noise[axis], fit.noise[axis]);
                p * q / (p + q)
            });
        }
        let text = format!(
            "accelerometers {} merged; where finer ones are saturated: {}",
            names.join(", "),
            stood_in.join(", ")
        );
        findings.insert(0, Code::Navigation.note(text));
        findings.extend(saturated(&readings, sensors));
        let track = tracks.iter().find(|track| track.info.sensor == finest.sensor);
        let widest = sensors[sensors.len() - 1].full_scale;
        let recording = finest.replaced(recording, track, &readings, widest);
        Ok(Self { recording, findings })
    }
}

/// The accelerometers that may be merged, by index.
fn forces(recording: &Recording) -> Vec<&Track> {
    let is_output = |track: &&Track| track.info.origin == Origin::Sensor && !track.info.timeless;
    let mut tracks: Vec<&Track> = recording.of(Quantity::SpecificForce).filter(is_output).collect();
    tracks.sort_by_key(|track| track.info.sensor);
    tracks
}

/// An accelerometer.
struct Sensor {
    sensor: u8,
    full_scale: f64,
    si_per_unit: f64,
    /// Rows of its track that are in `series`.
    rows: Vec<usize>,
    series: Series<Vector3<f64>>,
    noise: [f64; 3],
}

impl Sensor {
    /// `None` where its unit or full scale is not known.
    fn of(track: &Track, given: Option<f64>) -> Option<Self> {
        let (si_per_unit, step) = match track.info.unit {
            Unit::Si => (1.0, 0.0),
            Unit::Counts { si_per_lsb } => (si_per_lsb?, si_per_lsb?),
            Unit::Unknown => return None,
        };
        let full_scale = given.or(track.info.full_scale).filter(|full| *full > 0.0)?;
        let mut rows = Vec::new();
        let mut series = Series::default();
        for (row, time_ns) in track.times_ns().iter().enumerate() {
            let value: [f64; 3] = track.row(row)?.try_into().ok()?;
            let value = Vector3::from(value) * si_per_unit;
            let is_number = value.iter().all(|axis| axis.is_finite());
            let saturated = value.amax() >= RAIL * full_scale;
            // A masked row of numbers is out of order.
            let in_order = track.mask()[row] || !is_number;
            if in_order && series.push(Ns(*time_ns), value, Flags::saturated(saturated)) {
                rows.push(row);
            }
        }
        let series = series.even();
        Some(Self {
            sensor: track.info.sensor,
            full_scale,
            si_per_unit,
            rows,
            noise: fit::noise(&series.v, step),
            series,
        })
    }

    fn readings(&self) -> Vec<[Reading; 3]> {
        let rail = RAIL * self.full_scale;
        let reading = |value: &Vector3<f64>| {
            std::array::from_fn(|axis| Reading::new(value[axis], self.noise[axis], rail))
        };
        self.series.v.iter().map(reading).collect()
    }

    /// The recording with the merged values in place of its track, and without the other accelerometers.
    fn replaced(
        &self,
        recording: &Recording,
        track: Option<&&Track>,
        readings: &[[Reading; 3]],
        widest: f64,
    ) -> Recording {
        let count = track.map_or(0, |track| track.len());
        let mut values = vec![None; count];
        for (row, readings) in self.rows.iter().zip(readings) {
            values[*row] = Some(readings.map(|reading| match reading {
                Reading::Measured(value, _) => value / self.si_per_unit,
                _ => f64::NAN,
            }));
        }
        recording.with_one_force(self.sensor, &values, widest)
    }

    fn name(&self) -> String {
        format!("{} (±{:.0} g)", self.sensor, self.full_scale / STANDARD_GRAVITY_MPS2)
    }
}

/// Merges the coarse accelerometer with the finer side: readings, and samples in which it stands in.
fn combine(fine: &Fine, coarse: &Sensor, fit: &Fit) -> (Vec<[Reading; 3]>, usize) {
    let series = fit.clock.corrected(&coarse.series);
    let mut stands_in = 0;
    let sampled = series.on(fine.times.iter().copied(), Interp::Cubic).enumerate();
    let merge = |(k, at): (usize, Option<At<Vector3<f64>>>)| {
        let known: [Reading; 3] = fine.readings[k];
        let Some(at) = at.filter(|at| !at.flags.is_saturated()) else {
            return known;
        };
        // Errors of interpolation, of which half is the difference of two parabolas, and of the time.
        let (force, calibration) = fit.model.to_fine(&at.value, 0.0);
        let timing = fit.clock.variance(fine.times[k]);
        let jerk = slope(&series, fine.times[k]).unwrap_or_else(Vector3::zeros);
        let is_measured = |reading: &Reading| matches!(reading, Reading::Measured(..));
        stands_in += usize::from(!known.iter().all(is_measured));
        std::array::from_fn(|axis| {
            let errors = calibration[axis] + (2.0 * at.error).powi(2) + timing * jerk[axis].powi(2);
            let coarse = Reading::new(force[axis], fit.noise[axis] + errors, f64::INFINITY);
            known[axis].merge(coarse)
        })
    };
    let readings = sampled.map(merge).collect();
    (readings, stands_in)
}

/// Change of the coarse accelerometer's output around a time, m/s³.
fn slope(series: &Series<Vector3<f64>>, time: Ns) -> Option<Vector3<f64>> {
    let before = series.latest(time)?;
    let change = series.v.get(before + 1)? - series.v[before];
    let slope = change / series.t[before + 1].since_s(series.t[before]);
    slope.iter().all(|axis| axis.is_finite()).then_some(slope)
}
