//! Scores of a method: errors, and consistency tested from both sides.

use nalgebra::{Matrix3, Rotation3, Vector3};

use crate::recording::{Recording, Window};

/// 95 % quantile and median of χ² with 3 degrees of freedom.
pub const CHI_SQUARE_95: f64 = 7.815;
pub const CHI_SQUARE_MEDIAN: f64 = 2.366;

/// What a method says at one time. Covariances are `None` where it has none.
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    /// m, m/s.
    pub position: Vector3<f64>,
    pub velocity: Vector3<f64>,
    /// Direction of body x, rad, in the frame of the estimate.
    pub heading: f64,
    /// m², (m/s)².
    pub position_covariance: Option<Matrix3<f64>>,
    pub velocity_covariance: Option<Matrix3<f64>>,
    pub valid: bool,
}

/// Estimates of a whole recording, one a sample, in a frame of their own.
#[derive(Clone, Debug, Default)]
pub struct Track {
    /// Sample from which position is measured.
    pub origin: usize,
    pub estimates: Vec<Estimate>,
}

/// Errors against their covariance.
#[derive(Clone, Debug, Default)]
pub struct Consistency {
    /// Normalised estimation error squared, 3 degrees of freedom.
    pub nees: Vec<f64>,
    /// Logarithm of the Gaussian density of the truth.
    pub log_density: Vec<f64>,
    /// Largest error of a component over its standard deviation.
    pub worst: f64,
}

impl Consistency {
    /// Adds an error with its covariance, including that of the truth. False if a value is not finite or the covariance
    /// not positive.
    pub fn push(&mut self, error: &Vector3<f64>, covariance: &Matrix3<f64>) -> bool {
        let factor = covariance.cholesky().filter(|_| error.iter().all(|e| e.is_finite()));
        let Some(factor) = factor else {
            return false;
        };
        let nees = error.dot(&factor.solve(error));
        let log_determinant = 2.0 * factor.l().diagonal().map(f64::ln).sum();
        if !nees.is_finite() || !log_determinant.is_finite() {
            return false;
        }
        self.nees.push(nees);
        let constant = 3.0 * std::f64::consts::TAU.ln();
        self.log_density.push(-0.5 * (nees + log_determinant + constant));
        for i in 0..3 {
            self.worst = self.worst.max(error[i].abs() / covariance[(i, i)].sqrt());
        }
        true
    }

    pub fn merge(&mut self, other: &Self) {
        self.nees.extend(&other.nees);
        self.log_density.extend(&other.log_density);
        self.worst = self.worst.max(other.worst);
    }

    pub fn below_95(&self) -> f64 {
        fraction_below(&self.nees, CHI_SQUARE_95)
    }
}

/// Score of a whole run.
#[derive(Clone, Debug, Default)]
pub struct Whole {
    /// Moving samples with truth, and those of them that are valid.
    pub moving: usize,
    pub valid: usize,
    /// Scored values that are not finite.
    pub non_finite: usize,
    /// Position errors at the moving samples, valid or not, m.
    pub errors: Vec<f64>,
    /// Of the valid moving samples.
    pub position: Consistency,
    pub velocity: Consistency,
    /// Error and standard deviation in space, m, at the last sample with truth and at the last rest.
    pub last: Vec<[f64; 2]>,
    pub last_rest: Vec<[f64; 2]>,
    /// Normalised innovations squared, 3 degrees of freedom.
    pub nis: Vec<f64>,
}

impl Whole {
    /// Of a recording that was refused: no sample is valid.
    pub fn refused(recording: &Recording) -> Self {
        let scored = |k: &usize| recording.moving[*k] && recording.position(*k).is_some();
        let moving = (0..recording.moving.len()).filter(scored).count();
        Self { moving, ..Self::default() }
    }

    /// Scores the position of one track and the velocity of another, which may be the same.
    pub fn of(recording: &Recording, position: &Track, velocity: &Track) -> Self {
        let mut whole = Self::default();
        let Some(frame) = Frame::of(recording, position) else {
            return whole;
        };
        let truth = recording.truth;
        let space = |e: &Estimate| match e.position_covariance {
            Some(p) => p.trace().sqrt(),
            None => f64::NAN,
        };
        let error = |k: usize| Some(position.estimates[k].position - frame.position(recording, k)?);
        for k in (0..recording.moving.len()).filter(|k| recording.moving[*k]) {
            let (Some(e), estimate) = (error(k), &position.estimates[k]) else {
                continue;
            };
            whole.moving += 1;
            if e.norm().is_finite() {
                whole.errors.push(e.norm());
            } else {
                whole.non_finite += 1;
            }
            if !estimate.valid {
                continue;
            }
            whole.valid += 1;
            if let Some(p) = estimate.position_covariance {
                let p = p + Matrix3::identity() * truth.position.powi(2);
                whole.non_finite += usize::from(!whole.position.push(&e, &p));
            }
        }
        if let Some(frame) = Frame::of(recording, velocity) {
            for k in (0..recording.moving.len()).filter(|k| recording.moving[*k]) {
                let estimate = &velocity.estimates[k];
                let (Some(p), Some(v)) = (estimate.velocity_covariance, recording.velocity(k))
                else {
                    continue;
                };
                if estimate.valid {
                    let e = estimate.velocity - frame.rotation * v;
                    let p = p + Matrix3::identity() * truth.velocity.powi(2);
                    whole.non_finite += usize::from(!whole.velocity.push(&e, &p));
                }
            }
        }
        let at = |k: usize| Some([error(k)?.norm(), space(&position.estimates[k])]);
        let end = (0..recording.moving.len()).rev().find(|k| recording.position(*k).is_some());
        whole.last.extend(end.and_then(at));
        whole.last_rest.extend(recording.last_rest().and_then(at));
        whole
    }

    pub fn merge(&mut self, other: &Self) {
        self.moving += other.moving;
        self.valid += other.valid;
        self.non_finite += other.non_finite;
        self.errors.extend(&other.errors);
        self.position.merge(&other.position);
        self.velocity.merge(&other.velocity);
        self.last.extend(&other.last);
        self.last_rest.extend(&other.last_rest);
        self.nis.extend(&other.nis);
    }
}

/// The truth in the frame of a track: both have the same position at the track's origin and the same heading there, or
/// that which fits the whole run best where the truth has no heading.
pub struct Frame {
    rotation: Rotation3<f64>,
    offset: Vector3<f64>,
}

impl Frame {
    pub fn of(recording: &Recording, track: &Track) -> Option<Self> {
        let count = track.estimates.len();
        let known = |k: &usize| recording.position(*k).is_some();
        let angle = if recording.has_heading() {
            let seen = |k: usize| Some((k, recording.heading(k)?));
            let (at, heading) = (track.origin..count).find_map(seen)?;
            track.estimates[at].heading - heading
        } else {
            fitted_angle(recording, track)?
        };
        let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
        let at = (track.origin..count).find(known)?;
        let offset = track.estimates[at].position - rotation * recording.position(at)?;
        Some(Self { rotation, offset })
    }

    pub fn position(&self, recording: &Recording, k: usize) -> Option<Vector3<f64>> {
        Some(self.rotation * recording.position(k)? + self.offset)
    }
}

/// Rotation about the vertical, truth to track, rad, that minimises the squared horizontal errors of the valid samples,
/// or of all if none is valid.
fn fitted_angle(recording: &Recording, track: &Track) -> Option<f64> {
    let count = track.estimates.len();
    let origin = (track.origin..count).find(|k| recording.position(*k).is_some())?;
    let (from, start) = (track.estimates[origin].position, recording.position(origin)?);
    let any_valid = track.estimates.iter().any(|e| e.valid);
    let (mut sine, mut cosine) = (0.0, 0.0);
    for (k, estimate) in track.estimates.iter().enumerate() {
        let Some(truth) = recording.position(k).filter(|_| estimate.valid || !any_valid) else {
            continue;
        };
        let (found, real) = (estimate.position - from, truth - start);
        if found.iter().all(|f| f.is_finite()) {
            sine += real.x * found.y - real.y * found.x;
            cosine += real.x * found.x + real.y * found.y;
        }
    }
    Some(sine.atan2(cosine))
}

/// Score of the windows that begin at the true state, at each horizon.
#[derive(Clone, Debug, Default)]
pub struct Windows {
    pub count: usize,
    /// Position errors, m.
    pub errors: [Vec<f64>; 3],
    pub position: [Consistency; 3],
    pub velocity: [Consistency; 3],
    pub non_finite: usize,
}

impl Windows {
    /// `ends`: estimates at the horizons of each window, in the frame of the truth.
    pub fn of(recording: &Recording, windows: &[Window], ends: &[[Estimate; 3]]) -> Self {
        let mut found = Self { count: windows.len(), ..Self::default() };
        for (window, ends) in windows.iter().zip(ends) {
            for (h, estimate) in ends.iter().enumerate() {
                let at = window.ends[h];
                let Some(truth) = recording.position(at) else {
                    continue;
                };
                let e = estimate.position - truth;
                if e.norm().is_finite() {
                    found.errors[h].push(e.norm());
                } else {
                    found.non_finite += 1;
                }
                let widened = |p: Matrix3<f64>, sd: f64| p + Matrix3::identity() * (sd * sd);
                if let Some(p) = estimate.position_covariance {
                    let p = widened(p, recording.truth.position);
                    found.non_finite += usize::from(!found.position[h].push(&e, &p));
                }
                if let (Some(p), Some(v)) = (estimate.velocity_covariance, recording.velocity(at)) {
                    let p = widened(p, recording.truth.velocity);
                    let e = estimate.velocity - v;
                    found.non_finite += usize::from(!found.velocity[h].push(&e, &p));
                }
            }
        }
        found
    }

    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.non_finite += other.non_finite;
        for h in 0..3 {
            self.errors[h].extend(&other.errors[h]);
            self.position[h].merge(&other.position[h]);
            self.velocity[h].merge(&other.velocity[h]);
        }
    }
}

/// Median; NaN of none.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => sorted[n / 2],
        n => 0.5 * (sorted[n / 2 - 1] + sorted[n / 2]),
    }
}

/// Mean; NaN of none.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Root mean square; NaN of none.
pub fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// Fraction of values below a limit; NaN of none.
pub fn fraction_below(values: &[f64], limit: f64) -> f64 {
    values.iter().filter(|v| **v < limit).count() as f64 / values.len() as f64
}
