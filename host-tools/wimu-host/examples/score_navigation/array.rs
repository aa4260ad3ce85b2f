//! Angular rate from eight accelerometers against the mean of eight gyroscopes, which only the scoring reads.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use wimu_calib::Gravity;
use wimu_host::Result;
use wimu_host::array::{ArrayBody, ArrayCalibration, ArrayGeometry, ArrayRecording};
use wimu_host::inertial::Zupt;
use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::gyroscopes::mean_rate;
use crate::score::{Consistency, median, rms};

/// LSB per g of the accelerometers.
const ACCELEROMETER: f64 = 2048.0;
/// The array moves above this, rad/s.
const MOVING_RAD_S: f64 = 1.0;
/// A position is of use up to this standard deviation, m, as in the library.
const LIMIT_M: f64 = 1.0;

/// Score of one method on one recording of an array.
#[derive(Debug, Default)]
pub struct RateScore {
    pub name: &'static str,
    /// Errors of each component, rad/s.
    pub errors: Vec<f64>,
    /// Fraction of samples with the opposite direction.
    pub wrong_sign: f64,
    pub rate: Consistency,
    pub non_finite: usize,
    /// Fraction of the samples at which the position is valid; `None`: no position.
    pub valid: Option<f64>,
}

impl RateScore {
    pub fn rms_and_median_deg_s(&self) -> [f64; 2] {
        [rms(&self.errors), median(&self.errors)].map(f64::to_degrees)
    }
}

/// Scores of one recording.
#[derive(Debug)]
pub struct ArrayScores {
    pub name: String,
    /// Samples above 1 rad/s, and those of them next to a clipped one: left out, as the reference is wrong there.
    pub moving: usize,
    pub clipped: usize,
    pub methods: Vec<RateScore>,
}

/// Rate, its covariance, and whether the position is valid.
type Rated = (Vector3<f64>, Option<Matrix3<f64>>, Option<bool>);

/// Scores one of the recordings in `array/`.
///
/// # Errors
/// Those of reading, calibrating and navigating it.
pub fn score(data: &Path, name: &str) -> Result<ArrayScores> {
    let file = data.join("array").join(format!("{name}.csv"));
    let recording = ArrayRecording::from_csv(&file, ACCELEROMETER)?;
    let geometry = ArrayGeometry::read(&data.join("array/mimu4444_positions.csv"))?;
    let calibration = ArrayCalibration::of(&recording, &geometry, Gravity::UNKNOWN_PLACE)?;
    let (truth, clipped) = mean_rate(&file)?;
    let truth: Vec<Vector3<f64>> = truth.into_iter().map(Vector3::from).collect();
    let count = truth.len();
    let moving: Vec<usize> = (0..count).filter(|k| truth[*k].norm() > MOVING_RAD_S).collect();
    let near = |k: usize| {
        (k.saturating_sub(1)..(k + 2).min(count)).any(|j| clipped[j] || recording.saturated[j] != 0)
    };
    let scored: Vec<usize> = moving.iter().copied().filter(|k| !near(*k)).collect();

    let mut methods = Vec::new();
    for (name, zupt) in [("wimu_array", Zupt::Assumed), ("wimu_array_zupt_on", Zupt::Stated)] {
        let (states, _) = ArrayBody::of(&recording, &geometry, &calibration)
            .and_then(|body| body.navigated(STANDARD_GRAVITY_MPS2, zupt))?;
        methods.push(scored_rates(name, &scored, &truth, |k| {
            let state = &states[k];
            let p = Matrix3::from_fn(|r, c| state.rate_covariance[r][c]);
            let valid = state.valid && state.position_sd_m() <= LIMIT_M;
            (state.rate_rad_s.into(), Some(p), Some(valid))
        }));
    }
    let smoothed =
        ArrayBody::of(&recording, &geometry, &calibration).and_then(|body| body.angular_rate())?;
    methods.push(scored_rates("wimu_array_smoother", &scored, &truth, |k| {
        let covariance = smoothed.rate_covariance[k];
        let variance = Vector3::from_fn(|i, _| covariance[i][i]);
        (smoothed.rate_rad_s[k].into(), Some(Matrix3::from_diagonal(&variance)), None)
    }));
    methods.push(scored_rates("zero_rate", &scored, &truth, |_| (Vector3::zeros(), None, None)));
    Ok(ArrayScores {
        name: name.to_owned(),
        moving: moving.len(),
        clipped: moving.len() - scored.len(),
        methods,
    })
}

fn scored_rates(
    name: &'static str,
    scored: &[usize],
    truth: &[Vector3<f64>],
    rated: impl Fn(usize) -> Rated,
) -> RateScore {
    let mut score = RateScore { name, ..RateScore::default() };
    let (mut wrong, mut valid) = (0, None);
    for k in scored {
        let (rate, covariance, is_valid) = rated(*k);
        let error = rate - truth[*k];
        if !error.norm().is_finite() {
            score.non_finite += 1;
            continue;
        }
        score.errors.extend(error.iter().map(|e| e.abs()));
        wrong += usize::from(rate.dot(&truth[*k]) < 0.0);
        if let Some(p) = covariance {
            score.non_finite += usize::from(!score.rate.push(&error, &p));
        }
        if let Some(is_valid) = is_valid {
            *valid.get_or_insert(0) += usize::from(is_valid);
        }
    }
    score.wrong_sign = wrong as f64 / scored.len() as f64;
    score.valid = valid.map(|v| v as f64 / scored.len() as f64);
    score
}
