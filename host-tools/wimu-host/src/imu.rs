//! One unit's samples, corrected, with the truth where the file has it: what navigates.

mod read;

pub use read::ImuOptions;
pub use wimu_nav::navigator::Sample;

use std::ops::Range;

use nalgebra::{Matrix3, SMatrix, Vector3, Vector4};
use wimu_model::{Alignment, ModelCovariance};

use crate::Problem;
use crate::recording::{Origin, Quantity, Recording, Track};
use crate::rests::{RestLimits, rests};
use crate::series::{Flags, Interp, Ns, Series};

/// Standard deviation of the bias of a calibrated consumer accelerometer, m/s²: what its turn-on changes (datasheets).
const BIAS_MPS2: f64 = 0.05;
/// The same of a sensor whose calibration is not known, m/s²: that of public recordings (docs/reference/validation.md, navigation).
const UNKNOWN_BIAS_MPS2: f64 = 0.1;

/// Largest specific force after correction over the full scale of the accelerometer.
pub(crate) const BEYOND_RANGE: f64 = 1.5;

/// Change of scale factor and misalignment after a calibration: 0.01 %/K over 10 K (LSM6DSO, MPU-9250 datasheets).
const MATRIX_CHANGE: f64 = 0.001;

/// The column that says whether the magnetic field is corrected.
pub(crate) const FIELD_CALIBRATED: &str = "Field Calibrated";

/// The column that says whether the unit moves.
pub(crate) const MOVING: &str = "Moving";

/// Standard deviations up to which a departure from gravity is explained by the bias.
pub(crate) const LIKELY: f64 = 3.0;

/// Where a body truly was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Position, m, east-north-up.
    pub position_m: [f64; 3],
    /// Body to navigation axes, W X Y Z; NaN where it is not known.
    pub quaternion: [f64; 4],
}

/// What a reference system says of a body; empty where the file does not have it.
#[derive(Clone, Debug, Default)]
pub struct Reference {
    /// Position, m, east-north-up.
    pub position_m: Series<Vector3<f64>>,
    /// Body to navigation axes, W X Y Z.
    pub quaternion: Series<Vector4<f64>>,
    /// Angular rate, rad/s, body axes.
    pub rate_rad_s: Series<Vector3<f64>>,
    /// Above 0.5 where the body moves.
    pub moving: Series<f64>,
}

impl Reference {
    /// That of the tracks of a file.
    pub(crate) fn of(file: &Recording) -> Self {
        let truth = |quantity| {
            let mut tracks = file.of(quantity);
            tracks.find(|track: &&Track| track.info.origin == Origin::Truth)
        };
        let vectors = |quantity| truth(quantity).map_or_else(Series::default, Track::series);
        let moving = file.of(Quantity::Scalar).find(|track| track.info.name == MOVING);
        Self {
            position_m: vectors(Quantity::Position),
            quaternion: truth(Quantity::Attitude).map_or_else(Series::default, Track::series),
            rate_rad_s: vectors(Quantity::AngularRate),
            moving: moving.map_or_else(Series::default, |track| track.series::<1>().map(|v| v[0])),
        }
    }

    /// Position and attitude at times.
    pub(crate) fn on(&self, times: &[Ns]) -> Vec<Option<Truth>> {
        let at = |time: &Ns| {
            let quaternion = self.quaternion.at(*time, Interp::Linear);
            Some(Truth {
                position_m: self.position_m.at(*time, Interp::Linear)?.value.into(),
                quaternion: quaternion.map_or([f64::NAN; 4], |at| at.value.into()),
            })
        };
        times.iter().map(at).collect()
    }

    /// The column `Moving` at times, where the file has it.
    pub(crate) fn moving_on(&self, times: &[Ns]) -> Option<Vec<f64>> {
        let values = self.moving.on(times.iter().copied(), Interp::Linear);
        let values = values.map(|at| at.map_or(f64::NAN, |at| at.value));
        (!self.moving.is_empty()).then(|| values.collect())
    }
}

/// Samples of one unit, corrected, in SI, body axes.
#[derive(Clone, Debug, Default)]
pub struct Imu {
    /// What errors call it.
    pub name: String,
    /// The samples. What the accelerometer did not measure is not a number.
    pub samples: Series<Sample>,
    /// Where the unit truly was, where the file has it.
    pub reference: Reference,
    /// What was noticed at reading.
    pub findings: Vec<Problem>,
    /// Covariance of the calibration of its accelerometer, body axes: bias, m/s², then the matrix by rows; `None` where it
    /// is not known.
    pub covariance: Option<[[f64; 12]; 12]>,
    /// Whether the covariance is that of a new session and includes the turn-on bias: a calibration from several
    /// sessions measured it.
    pub of_sessions: bool,
    /// Largest specific force that its accelerometer measures, m/s², where the recording gives its full scale. A sample beyond
    /// it, or else beyond that of any accelerometer, was not measured.
    pub full_scale_mps2: Option<f64>,
    /// Whether a magnetic field was left out because its magnetometer is not calibrated.
    pub field_uncalibrated: bool,
}

impl Imu {
    /// Without samples.
    pub fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), ..Self::default() }
    }

    /// Adds a sample, with the step from the last one; returns whether it is later than that.
    pub fn push(&mut self, time: Ns, sample: Sample) -> bool {
        let last = self.samples.t.last().copied().unwrap_or(time);
        let sample = Sample { step_s: time.s() - last.s(), ..sample };
        self.samples.push(time, sample, Flags::NONE)
    }

    /// The same without samples.
    pub(crate) fn without_samples(&self) -> Self {
        Self {
            name: self.name.clone(),
            samples: Series::default(),
            reference: self.reference.clone(),
            findings: self.findings.clone(),
            ..*self
        }
    }

    /// Times of the samples, s.
    pub(crate) fn times_s(&self) -> Vec<f64> {
        self.samples.t.iter().map(|time| time.s()).collect()
    }

    /// Why there is no magnetic field, for a finding.
    pub(crate) fn without_field(&self) -> &'static str {
        if self.field_uncalibrated {
            "there is a magnetometer, but it is not calibrated and not used (calibrate it with `wimu calibrate FILE --method \
             magnetometer --with CAL.json -o BOTH.json`, then navigate with --with BOTH.json)"
        } else {
            "no magnetometer"
        }
    }

    /// Standard deviation of the accelerometer's bias, m/s²: of an unknown sensor, or what turn-on changes and what its
    /// calibration leaves unknown on the worst axis at 1 *g*, with the matrix.
    pub fn bias_mps2(&self) -> f64 {
        let Some(known) = self.covariance else {
            return UNKNOWN_BIAS_MPS2;
        };
        self.turn_on_mps2().hypot(crate::calibration::worst_sd(|place| known[place][place].sqrt()))
    }

    /// Standard deviation of the turn-on bias that the covariance does not include, m/s².
    fn turn_on_mps2(&self) -> f64 {
        if self.of_sessions { 0.0 } else { BIAS_MPS2 }
    }

    /// Covariance of bias and matrix with what changes after the calibration: a turn-on bias, and a scale factor and axes
    /// that depend on temperature and age.
    pub fn calibration_covariance(&self) -> Option<[[f64; 12]; 12]> {
        let mut all = self.covariance?;
        for (place, row) in all.iter_mut().enumerate() {
            let later = match place {
                0..3 => self.turn_on_mps2(),
                _ => MATRIX_CHANGE,
            };
            row[place] += later * later;
        }
        Some(all)
    }

    /// Gravity to navigate with, m/s²: the standard one, unless mean |f| of the first second at rest within the first minute
    /// departs from it by more than the biases of a calibrated accelerometer explain, and less than 10 %: one that is
    /// not calibrated shows its own. A small departure is no gravity: as a bias it turns with the unit.
    pub fn gravity_mps2(&self) -> f64 {
        let standard = wimu_model::STANDARD_GRAVITY_MPS2;
        let by_bias = LIKELY * self.bias_mps2();
        self.first_rest_mps2().filter(|seen| (seen - standard).abs() > by_bias).unwrap_or(standard)
    }

    /// Mean |f| of the first second at rest, where it may be gravity, m/s².
    fn first_rest_mps2(&self) -> Option<f64> {
        let standard = wimu_model::STANDARD_GRAVITY_MPS2;
        let end = self.samples.t.first()?.after_s(FIRST_S);
        let mut rests = self.still_seconds().into_iter();
        rests.find_map(|(second, mean_mps2)| {
            let is_early = self.samples.t[second.start] < end;
            (is_early && (mean_mps2 / standard - 1.0).abs() < NEAR).then_some(mean_mps2)
        })
    }

    /// The first second of each rest, as the accelerometer alone shows rests whatever it gives for gravity, and mean |f|
    /// there, m/s².
    pub(crate) fn still_seconds(&self) -> Vec<(Range<usize>, f64)> {
        let mut limits = RestLimits::default();
        (limits.window_s, limits.force_mps2, limits.threshold) = (STILL_S, STILL_MPS2, 3.0);
        limits.force_offset_mps2 = f64::INFINITY;
        let samples = self.samples.v.iter().map(|s| (s.force_mps2, None, s.step_s));
        let second = |rest: Range<usize>| {
            let begin = self.samples.t[rest.start].after_s(-STILL_S);
            let second = self.samples.t.partition_point(|t| *t <= begin)..rest.start + 1;
            let sizes = self.samples.v[second.clone()].iter().map(|s| s.force_mps2.norm());
            let mean_mps2 = sizes.sum::<f64>() / second.len() as f64;
            (second.len() >= STILL_SAMPLES).then_some((second, mean_mps2))
        };
        rests(samples, limits).into_iter().filter_map(second).collect()
    }
}

/// Time in which gravity is looked for, s, and its largest departure from the standard one, relative.
const FIRST_S: f64 = 60.0;
const NEAR: f64 = 0.1;
/// Length of a rest that shows gravity, s, its fewest samples, and the noise there, m/s², a component.
const STILL_S: f64 = 1.0;
const STILL_SAMPLES: usize = 10;
const STILL_MPS2: f64 = 0.15;

/// The covariance of an error model, in the axes of the body: b ← R b, M ← R M Rᵀ.
fn in_body_axes(known: &ModelCovariance, alignment: &Alignment) -> [[f64; 12]; 12] {
    let rotation = Matrix3::from_row_slice(alignment.matrix().as_flattened());
    let mut change = SMatrix::<f64, 12, 12>::zeros();
    change.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    change.fixed_view_mut::<9, 9>(3, 3).copy_from(&rotation.kronecker(&rotation));
    let sensor = SMatrix::from_fn(|a, b| known.get(a, b));
    (change * sensor * change.transpose()).into()
}
