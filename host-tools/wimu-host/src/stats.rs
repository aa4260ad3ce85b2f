//! Statistics of a few numbers.

/// Median, of an even number of values the upper one of both in the middle; `None` without values.
pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    quantile(values, 2)
}

/// The value with one in `parts` of the values below it; `None` without values.
pub(crate) fn quantile(values: impl IntoIterator<Item = f64>, parts: usize) -> Option<f64> {
    let mut values = Vec::from_iter(values);
    let place = values.len() / parts;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(place, f64::total_cmp).1)
}

/// Quantile of the standard normal distribution at 1 − 10⁻⁴: what is beyond it is no chance.
pub(crate) const IMPROBABLE: f64 = 3.719;

/// Length of a vector.
pub(crate) fn norm(vector: impl AsRef<[f64]>) -> f64 {
    let squares = vector.as_ref().iter().map(|axis| axis * axis);
    squares.sum::<f64>().sqrt()
}

/// Tuning constant of Cauchy's weight at 95 % efficiency, and standard deviation over median of normal magnitudes.
const CAUCHY: f64 = 2.385;
const NORMAL_MEDIAN: f64 = 1.4826;

/// Weights of Cauchy's distribution for the magnitudes of residuals: outliers hardly count (P. Huber and E. Ronchetti, "Robust
/// Statistics", 2nd ed. 2009).
pub(crate) fn cauchy_weights(residuals: &[f64]) -> Vec<f64> {
    let scale = CAUCHY * NORMAL_MEDIAN * median(residuals.iter().copied()).unwrap_or(0.0);
    residuals.iter().map(|r| 1.0 / (1.0 + (r / scale.max(1e-9)).powi(2))).collect()
}
