//! Errors of a path against the truth, and statistics of them.

use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::Serialize;

use crate::command::Point;
use crate::truth::{Truth, heading};

/// 95 % points of χ² with 1 to 3 degrees of freedom.
pub const CHI_SQUARE_95: [f64; 3] = [3.841, 5.991, 7.815];
/// Samples whose errors correlate less are independent; of so many samples the correlation is computed.
const INDEPENDENT: f64 = 0.2;
const CORRELATED: usize = 2000;
/// Step of the fitted shift of the clocks, s.
const SHIFT_STEP_S: f64 = 0.02;

/// What an estimator reached.
#[derive(Clone, Default, Serialize)]
pub struct Score {
    pub figures: Vec<f64>,
    /// Scored moving samples, windows, outages or journeys.
    pub samples: usize,
    /// Independent samples whose NEES is below the 95 % point of χ², and valid samples, both of all.
    pub consistent: [usize; 2],
    pub valid: [usize; 2],
    /// Largest error of a component at a valid moving sample, in standard deviations.
    pub worst_sigma: f64,
    /// Error of the final position over its standard deviation in space, as the command says it.
    pub headline_sigma: Option<f64>,
    pub exit: u8,
}

impl Score {
    /// Takes consistency and validity of errors, whose truth has a standard deviation.
    pub fn take(&mut self, errors: &[Point], truth_sd: f64) {
        let valid: Vec<Point> = errors.iter().filter(|e| e.valid).copied().collect();
        let ratios = |e: &Point| {
            let known = (0..3).filter(|k| e.sigma[*k] > 0.0);
            known.map(|k| e.value[k].abs() / e.sigma[k].hypot(truth_sd)).collect::<Vec<f64>>()
        };
        self.worst_sigma = valid.iter().flat_map(ratios).fold(self.worst_sigma, f64::max);
        // The CSV has no correlations of the components.
        let thinned = valid.iter().step_by(independent(&valid)).map(ratios);
        for ratios in thinned.filter(|ratios| !ratios.is_empty()) {
            let nees: f64 = ratios.iter().map(|r| r * r).sum();
            self.consistent[0] += usize::from(nees < CHI_SQUARE_95[ratios.len() - 1]);
            self.consistent[1] += 1;
        }
        self.samples += errors.len();
        self.valid = [self.valid[0] + valid.len(), self.valid[1] + errors.len()];
    }
}

/// Number of samples from one to the next that is independent.
fn independent(errors: &[Point]) -> usize {
    let step = errors.len().div_ceil(CORRELATED).max(1);
    let few: Vec<Vector3<f64>> = errors.iter().step_by(step).map(|e| e.value).collect();
    let mean = few.iter().sum::<Vector3<f64>>() / few.len().max(1) as f64;
    let product = |lag: usize| {
        let pairs = few.iter().zip(&few[lag..]).map(|(a, b)| (a - mean).dot(&(b - mean)));
        pairs.sum::<f64>() / (few.len() - lag) as f64
    };
    let half = few.len() / 2;
    let lag = (1..half).find(|lag| product(*lag) < INDEPENDENT * product(0));
    lag.unwrap_or(half).max(1) * step
}

/// How the frame of a path is found in that of the truth: it is the same; start and heading there are; start, and yaw that
/// fits the whole path; rotation and translation of least squares, with a shift of the clocks, s.
#[derive(Clone, Copy)]
pub enum Alignment {
    Given,
    Heading,
    Yaw,
    Rigid(f64),
}

/// Truth to path, and shift of the clock, s.
type Transform = (Rotation3<f64>, Vector3<f64>, f64);

/// Errors at all points with truth, and whether each is a moving sample.
pub fn errors(points: &[Point], truth: &Truth, alignment: Alignment) -> Vec<(bool, Point)> {
    let fits: Vec<Transform> = match alignment {
        Alignment::Given => vec![(Rotation3::identity(), Vector3::zeros(), 0.0)],
        Alignment::Heading => at_start(points, truth, false).into_iter().collect(),
        Alignment::Yaw => at_start(points, truth, true).into_iter().collect(),
        Alignment::Rigid(most_s) => {
            let steps = (most_s / SHIFT_STEP_S) as i32;
            let shifts = (-steps..=steps).map(|k| f64::from(k) * SHIFT_STEP_S);
            shifts.filter_map(|shift_s| rigid(points, truth, shift_s)).collect()
        }
    };
    let of = |(rotation, offset, shift_s): Transform| {
        let one = |p: &Point| {
            let time_s = p.time_s + shift_s;
            let value = p.value - (rotation * truth.position(time_s)? + offset);
            Some((truth.is_moving(time_s), Point { value, ..*p }))
        };
        points.iter().filter_map(one).collect::<Vec<_>>()
    };
    let size = |all: &Vec<(bool, Point)>| rms(all.iter().filter(|e| e.0).map(|e| e.1.value.norm()));
    let best = fits.into_iter().map(of).min_by(|a, b| size(a).total_cmp(&size(b)));
    best.unwrap_or_default()
}

fn at_start(points: &[Point], truth: &Truth, is_fitted: bool) -> Option<Transform> {
    let any_valid = points.iter().any(|p| p.valid);
    let known = |p: &&Point| (p.valid || !any_valid) && truth.position(p.time_s).is_some();
    let origin = points.iter().find(known)?;
    let from = truth.position(origin.time_s)?;
    let both = |p: &Point| Some(heading(p.attitude)? - truth.heading(p.time_s)?);
    let angle = points.iter().filter(known).find_map(both).filter(|_| !is_fitted);
    let angle = angle.unwrap_or_else(|| {
        let (mut sine, mut cosine) = (0.0, 0.0);
        for p in points.iter().filter(known) {
            let path = (p.value - origin.value).xy();
            let truth = truth.position(p.time_s).map_or(path, |t| (t - from).xy());
            sine += truth.perp(&path);
            cosine += truth.dot(&path);
        }
        f64::atan2(sine, cosine)
    });
    let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
    Some((rotation, origin.value - rotation * from, 0.0))
}

/// Least squares (Kabsch 1976).
fn rigid(points: &[Point], truth: &Truth, shift_s: f64) -> Option<Transform> {
    let moving = points.iter().filter(|p| truth.is_moving(p.time_s + shift_s));
    let pair = |p: &Point| Some((truth.position(p.time_s + shift_s)?, p.value));
    let (truth, path): (Vec<_>, Vec<_>) = moving.filter_map(pair).unzip();
    let mean = |all: &[Vector3<f64>]| all.iter().sum::<Vector3<f64>>() / all.len() as f64;
    let (from, to) = (mean(&truth), mean(&path));
    let pairs = truth.iter().zip(&path);
    let cross: Matrix3<f64> = pairs.map(|(t, p)| (p - to) * (t - from).transpose()).sum();
    let svd = cross.svd(true, true);
    let (u, vt) = (svd.u?, svd.v_t?);
    let sign = (u * vt).determinant().signum();
    let matrix = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * vt;
    Some((Rotation3::from_matrix_unchecked(matrix), to - matrix * from, shift_s))
}

/// Quantile by linear interpolation; NaN of none.
pub fn quantile(values: impl IntoIterator<Item = f64>, part: f64) -> f64 {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_by(f64::total_cmp);
    let place = part * sorted.len().saturating_sub(1) as f64;
    let value = |k: f64| sorted.get(k as usize).copied().unwrap_or(f64::NAN);
    let [low, high] = [value(place.floor()), value(place.ceil())];
    low + (high - low) * place.fract()
}

/// Root mean square; NaN of none.
pub fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let squares: Vec<f64> = values.into_iter().map(|v| v * v).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}
