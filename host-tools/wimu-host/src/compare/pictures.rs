//! Charts of a comparison.

use super::link::Slice;
use super::{Axis, Comparison, History, Values};
use crate::chart::{self, Band, Chart, Series};

const AXES: [&str; 3] = ["X", "Y", "Z"];
/// Smallest latency shown, ms: the uncertainty of the clock.
const LEAST_SHOWN_MS: f64 = 0.1;

impl Comparison {
    /// The charts of its page.
    pub fn charts(&self) -> Vec<Chart> {
        let mut charts = over_time(&self.history).to_vec();
        charts.extend(self.values.iter().flat_map(|values| gap(&self.history, values)));
        charts.extend(evolution(&self.history));
        charts
    }
}

fn chart(title: impl Into<String>, y: &str, series: Vec<Series>) -> Chart {
    Chart::new(title, "time, s", y, series)
}

/// Wireless less cable, before and after correction.
fn gap(history: &History, values: &Values) -> [Chart; 2] {
    [
        ("Figure 5 of Yu & Chaczko: wireless less cable, as received", false),
        ("Figure 6 of Yu & Chaczko: wireless less cable, corrected by the link's model", true),
    ]
    .map(|(title, corrected)| {
        let series = (0..3)
            .map(|axis| {
                let points = history.excerpt.iter().map(|(time, [c, w])| {
                    let w = if corrected { values.model.correct(*w) } else { *w };
                    (*time, (w[axis] - c[axis]) * 1e3)
                });
                Series::line(AXES[axis], chart::broken(points.collect()))
            })
            .collect();
        chart(title, "mm/s²", series)
    })
}

/// A value of an axis, by its index, with its standard deviation.
type Estimate<'a> = dyn Fn(usize, &Axis) -> Option<(f64, f64)> + 'a;

/// Estimated bias and scale factor as functions of time, with two standard deviations: for an axis
/// that hardly moves the offset, for others since both are separable.
fn evolution(history: &History) -> Vec<Chart> {
    let last = history.evolution.last().map(|(_, axes)| *axes);
    let has_line = |axis: usize| last.is_some_and(|axes| axes[axis].line.is_some());
    let picture = |title: &str, y: &str, of: &Estimate<'_>| {
        let mut picture = chart(title, y, Vec::new());
        for (axis, name) in AXES.into_iter().enumerate() {
            let points: Vec<(f64, f64, f64)> = history
                .evolution
                .iter()
                .filter_map(|(time, axes)| {
                    let (value, sd) = of(axis, &axes[axis])?;
                    Some((*time, value, sd))
                })
                .collect();
            if points.is_empty() {
                continue;
            }
            // The range shows the bands of the second half completely: the first ones are too wide.
            for (_, value, sd) in &points[points.len() / 2..] {
                let (low, high) = picture.y_range.unwrap_or((*value, *value));
                picture.y_range = Some((low.min(value - 3.0 * sd), high.max(value + 3.0 * sd)));
            }
            let band =
                |(time, value, sd): &(f64, f64, f64)| (*time, value - 2.0 * sd, value + 2.0 * sd);
            picture.bands.push(Band {
                series: picture.series.len(),
                points: points.iter().map(band).collect(),
            });
            picture.series.push(Series::line(
                name,
                points.iter().map(|(time, value, _)| (*time, *value)).collect(),
            ));
        }
        picture
    };
    let bias = |axis: usize, found: &Axis| match (has_line(axis), found.line) {
        (true, line) => line.map(|line| (line.bias_mps2 * 1e3, line.bias_sd_mps2 * 1e3)),
        (false, _) => Some((found.offset_mps2 * 1e3, found.offset_sd_mps2 * 1e3)),
    };
    let scale = |_: usize, found: &Axis| {
        let line = found.line?;
        Some(((line.scale - 1.0) * 100.0, line.scale_sd * 100.0))
    };
    let bias = picture(
        "Figure 7 of Yu & Chaczko: estimated bias of the wireless link, ± 2 σ",
        "mm/s²",
        &bias,
    );
    let scale =
        picture("Figure 7, continued: estimated error of its scale factor, ± 2 σ", "%", &scale);
    let mut charts = vec![bias];
    if !scale.series.is_empty() {
        charts.push(scale);
    }
    charts
}

/// Latency and loss over time.
fn over_time(history: &History) -> [Chart; 2] {
    let links = ["cable", "wireless"];
    let time = |slice: usize| (slice as f64 + 0.5) * history.slice_s;
    let mut series = Vec::new();
    for (slices, link) in history.slices.iter().zip(links).rev() {
        for (share, what) in [(1.0, "longest"), (0.5, "median")] {
            let shown =
                slices.iter().enumerate().filter(|(_, slice)| slice.latency.count() > 0).map(
                    |(k, slice)| {
                        let latency_ms = slice.latency.quantile_ns(share) * 1e-6;
                        (time(k), latency_ms.max(LEAST_SHOWN_MS))
                    },
                );
            series.push(Series::line(&format!("{link}, {what}"), shown.collect()));
        }
    }
    let latency = Chart {
        log: true,
        ..chart("Latency from the newest sample of a batch to its arrival", "ms", series)
    };
    let lost = |slices: &[Slice], link: &str| {
        let points = slices.iter().enumerate().filter_map(|(k, slice)| {
            let share = slice.lost_share()?;
            Some((time(k), 100.0 * share))
        });
        Series::line(link, points.collect())
    };
    let [cable, wireless] = &history.slices;
    let loss = chart(
        "Samples that did not arrive, by the time at which they were taken".to_owned(),
        "%",
        vec![lost(wireless, "wireless"), lost(cable, "cable")],
    );
    [latency, loss]
}
