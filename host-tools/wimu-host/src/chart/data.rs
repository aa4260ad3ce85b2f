//! The data of a chart: decimated, and as JSON for the script of a report.

use serde_json::{Value, json};

use super::{Band, Chart, Series, Style};

/// Points of a chart that are drawn, at most about: two for each pixel of a broad screen.
const MOST_POINTS: usize = 8000;
/// Of this many values, one may be an outlier.
const OUTLIER_EVERY: usize = 500;
/// Least number of values of which outliers are told apart.
const LEAST_VALUES: usize = 50;
/// Distance of an outlier from all others, in widths of their range.
const OUTLIER_WIDTHS: f64 = 3.0;
/// Steps in which the range of a linear axis is written.
const STEPS: f64 = 1e6;

impl Chart {
    /// The same with at most about 8,000 points: of each interval of consecutive points those with the extremes of every
    /// coordinate, and breaks.
    pub(crate) fn decimated(&self) -> Self {
        let most = MOST_POINTS / (self.series.len() + self.bands.len()).max(1);
        let series = self.series.iter().map(|series| {
            let (x, y) = columns(series);
            let mut coordinates = vec![&x[..], &y[..]];
            if !series.z.is_empty() {
                coordinates.push(&series.z);
            }
            series.at(&extremes(&coordinates, most))
        });
        let bands = self.bands.iter().map(|band| {
            let [x, low, high] = band.columns();
            let indices = extremes(&[&x, &low, &high], most);
            Band {
                series: band.series,
                points: indices.into_iter().map(|k| band.points[k]).collect(),
            }
        });
        Self { series: series.collect(), bands: bands.collect(), ..self.clone() }
    }

    /// Range of y: what is given, or where a few values are far outside that of all others, that of the others.
    pub(super) fn shown_y(&self) -> Option<(f64, f64)> {
        if self.y_range.is_some() || self.log || self.equal {
            return self.y_range;
        }
        let data = self.series.iter().filter(|series| series.style != Style::Guide);
        let values = data.flat_map(|series| &series.points).map(|point| point.1);
        let mut values = Vec::from_iter(values.filter(|value| value.is_finite()));
        if values.len() < LEAST_VALUES {
            return None;
        }
        values.sort_by(f64::total_cmp);
        let few = values.len().div_ceil(OUTLIER_EVERY);
        let (least, most) = (values[0], values[values.len() - 1]);
        let (low, high) = (values[few], values[values.len() - 1 - few]);
        let far = OUTLIER_WIDTHS * (high - low);
        if far == 0.0 || (least >= low - far && most <= high + far) {
            return None;
        }
        // Values that are no outliers stay visible.
        let within = |value: &&f64| **value >= low - far && **value <= high + far;
        let inner = || values.iter().filter(within);
        inner().next().copied().zip(inner().next_back().copied())
    }

    /// The chart for the script. What is not finite is null.
    pub fn json(&self) -> Value {
        let linear = |log: bool, values: &[f64]| (!log).then(|| power_of_steps(values));
        let all = |of: &dyn Fn(&(f64, f64)) -> f64| -> Vec<f64> {
            let points = self.series.iter().flat_map(|series| &series.points);
            points.map(of).collect()
        };
        let x = linear(self.log_x, &all(&|point| point.0));
        let y = linear(self.log, &all(&|point| point.1));
        let series = self.series.iter().map(|series| {
            let (xs, ys) = columns(series);
            json!({
                "name": series.name,
                "style": match series.style {
                    Style::Line => "line",
                    Style::Dots => "dots",
                    Style::Guide => "guide",
                },
                "x": rounded(&xs, x),
                "y": rounded(&ys, y),
                "z": rounded(&series.z, y),
                "t": rounded(&series.times_s, Some(power_of_steps(&series.times_s))),
                "labels": series.labels,
            })
        });
        let bands = self.bands.iter().map(|band| {
            let ([xs, low, high], series) = (band.columns(), band.series);
            json!({"series": series, "x": rounded(&xs, x), "low": rounded(&low, y), "high": rounded(&high, y)})
        });
        json!({
            "title": self.title,
            "x": self.x,
            "y": self.y,
            "z": self.z,
            "space": self.series.iter().any(|series| !series.z.is_empty()),
            "logX": self.log_x,
            "logY": self.log,
            "equal": self.equal,
            "rangeX": self.x_range,
            "rangeY": self.shown_y(),
            "series": series.collect::<Vec<_>>(),
            "bands": bands.collect::<Vec<_>>(),
            "marked": self.marked,
        })
    }
}

impl Band {
    /// x, lowest y and highest.
    fn columns(&self) -> [Vec<f64>; 3] {
        let column = |of: fn(&(f64, f64, f64)) -> f64| self.points.iter().map(of).collect();
        [column(|p| p.0), column(|p| p.1), column(|p| p.2)]
    }
}

impl Series {
    /// The points with these indices.
    fn at(&self, indices: &[usize]) -> Self {
        fn picked<T: Clone>(values: &[T], indices: &[usize]) -> Vec<T> {
            let found = indices.iter().filter_map(|k| values.get(*k));
            found.cloned().collect()
        }
        Self {
            name: self.name.clone(),
            points: picked(&self.points, indices),
            z: picked(&self.z, indices),
            times_s: picked(&self.times_s, indices),
            labels: picked(&self.labels, indices),
            style: self.style,
        }
    }
}

fn columns(series: &Series) -> (Vec<f64>, Vec<f64>) {
    series.points.iter().copied().unzip()
}

/// Indices of at most about `most` points: see [`Chart::decimated`].
fn extremes(coordinates: &[&[f64]], most: usize) -> Vec<usize> {
    let count = coordinates.first().map_or(0, |values| values.len());
    if count <= most {
        return (0..count).collect();
    }
    let intervals = (most / (2 * coordinates.len())).max(1);
    let length = count.div_ceil(intervals);
    let mut kept = Vec::new();
    for start in (0..count).step_by(length) {
        let end = (start + length).min(count);
        let first = kept.len();
        for values in coordinates {
            let finite = || (start..end).filter(|k| values[*k].is_finite());
            let by = |a: &usize, b: &usize| values[*a].total_cmp(&values[*b]);
            kept.extend(finite().min_by(by));
            kept.extend(finite().max_by(by));
            kept.extend((start..end).find(|k| !values[*k].is_finite()));
        }
        kept[first..].sort_unstable();
    }
    kept.dedup();
    kept
}

/// Power of ten of which the range of these values has [`STEPS`] or more.
fn power_of_steps(values: &[f64]) -> i32 {
    let finite = || values.iter().copied().filter(|value| value.is_finite());
    let (low, high) =
        finite().fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    let span = if high > low { high - low } else { high.abs() };
    let power = (span / STEPS).log10().floor();
    if power.is_finite() { power as i32 } else { 0 }
}

/// Values to six significant digits, or to a power of ten where that is finer.
fn rounded(values: &[f64], power: Option<i32>) -> Vec<f64> {
    let one = |value: &f64| {
        if *value == 0.0 || !value.is_finite() {
            return *value;
        }
        let digits = value.abs().log10().floor() as i32 - 5;
        let factor = 10_f64.powi(-digits.min(power.unwrap_or(digits)));
        let short = (value * factor).round() / factor;
        if short.is_finite() { short } else { *value }
    };
    values.iter().map(one).collect()
}
