//! The comparison in pictures.

use std::path::{Path, PathBuf};

use super::link::Slice;
use super::{Comparison, History, Values};
use crate::Result;
use crate::chart::{self, Band, Chart, Series};
use crate::html::Report;

const AXES: [&str; 3] = ["X", "Y", "Z"];
/// The clock is not known better than this, ms: what is faster is shown as this.
const LEAST_SHOWN_MS: f64 = 0.1;
/// Points of a line: more are not seen.
const MAX_POINTS: usize = 1000;

impl Comparison {
    /// A page with the pictures; `printed` is what the command has said.
    ///
    /// # Errors
    /// `file_failed` when one cannot be drawn.
    pub fn page(&self, printed: &str) -> Result<Report> {
        let mut report = Report::new(format!("Wireless against cable: {}", self.source));
        report.printed(printed);
        self.pictures(&mut report)?;
        Ok(report)
    }

    /// Adds the pictures to a page.
    ///
    /// # Errors
    /// `file_failed` when one cannot be drawn.
    pub fn pictures(&self, report: &mut Report) -> Result<()> {
        for (_, chart) in self.charts() {
            report.chart(&chart)?;
        }
        Ok(())
    }

    /// Writes every picture into a folder, which is made if it is not there, as SVG and as PNG;
    /// returns the files.
    ///
    /// # Errors
    /// `file_failed`, `file_unreadable`.
    pub fn write_pictures(&self, folder: &Path) -> Result<Vec<PathBuf>> {
        chart::write_all(folder, &self.charts())
    }

    /// The pictures, with what their files are called.
    fn charts(&self) -> Vec<(&'static str, Chart)> {
        let history = &self.history;
        let axis = self.shown_axis();
        let sides = |pairs: &[(f64, [[f64; 3]; 2])], wireless: &str| {
            let side = |which: usize, name: &str| Series {
                name: name.to_owned(),
                points: chart::broken(thin(
                    pairs.iter().map(|(time, pair)| (*time, pair[which][axis])),
                )),
                dots: false,
            };
            vec![side(1, wireless), side(0, "cable")]
        };
        let name = AXES[axis];
        let mut charts = vec![(
            "both",
            chart(
                format!("{name} as both links brought it ({})", self.stream),
                "m/s²",
                sides(&history.excerpt, "wireless"),
            ),
        )];
        if let Some(values) = &self.values {
            let corrected: Vec<_> = history
                .excerpt
                .iter()
                .map(|(time, [c, w])| (*time, [*c, values.model.correct(*w)]))
                .collect();
            charts.push((
                "both-corrected",
                chart(
                    format!("{name} with the link's error model taken off"),
                    "m/s²",
                    sides(&corrected, "wireless, corrected"),
                ),
            ));
            charts.extend(gap(history, values));
        }
        charts.push(("error", evolution(history)));
        charts.extend(over_time(history));
        charts
    }

    /// The axis whose links are furthest apart.
    fn shown_axis(&self) -> usize {
        let apart = |axis: &usize| {
            self.values
                .as_ref()
                .map_or(0.0, |values| values.axes[*axis].rms_before_mps2)
        };
        (0..3)
            .max_by(|a, b| apart(a).total_cmp(&apart(b)))
            .unwrap_or(0)
    }
}

fn chart(title: String, y: &str, series: Vec<Series>) -> Chart {
    Chart {
        title,
        x: "time (s)".to_owned(),
        y: y.to_owned(),
        series,
        ..Chart::default()
    }
}

/// At most [`MAX_POINTS`] of them, evenly.
fn thin(points: impl ExactSizeIterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    let step = points.len().div_ceil(MAX_POINTS).max(1);
    points.step_by(step).collect()
}

/// Wireless less cable, before and under the model.
fn gap(history: &History, values: &Values) -> [(&'static str, Chart); 2] {
    [
        ("gap", "Gap between the links: wireless less cable", false),
        ("gap-corrected", "The same under the model", true),
    ]
    .map(|(name, title, corrected)| {
        let series = (0..3)
            .map(|axis| Series {
                name: AXES[axis].to_owned(),
                points: chart::broken(thin(history.excerpt.iter().map(|(time, [c, w])| {
                    let w = if corrected {
                        values.model.correct(*w)
                    } else {
                        *w
                    };
                    (*time, (w[axis] - c[axis]) * 1e3)
                }))),
                dots: false,
            })
            .collect();
        (name, chart(title.to_owned(), "mm/s²", series))
    })
}

/// The estimated offset as the recording grows, with two standard deviations.
fn evolution(history: &History) -> Chart {
    let line = |axis: usize| Series {
        name: AXES[axis].to_owned(),
        points: history
            .evolution
            .iter()
            .map(|(time, axes)| (*time, axes[axis].0 * 1e3))
            .collect(),
        dots: false,
    };
    let band = |axis: usize| Band {
        series: axis,
        points: history
            .evolution
            .iter()
            .map(|(time, axes)| {
                let (offset, sd) = axes[axis];
                (*time, (offset - 2.0 * sd) * 1e3, (offset + 2.0 * sd) * 1e3)
            })
            .collect(),
    };
    Chart {
        bands: (0..3).map(band).collect(),
        ..chart(
            "Estimated error of the wireless link as the recording grows, ± 2 σ".to_owned(),
            "mm/s²",
            (0..3).map(line).collect(),
        )
    }
}

/// Latency and loss over time.
fn over_time(history: &History) -> [(&'static str, Chart); 2] {
    let links = ["cable", "wireless"];
    let time = |slice: usize| (slice as f64 + 0.5) * history.slice_s;
    let mut series = Vec::new();
    for (slices, link) in history.slices.iter().zip(links).rev() {
        for (share, what) in [(1.0, "longest"), (0.5, "median")] {
            series.push(Series {
                name: format!("{link}, {what}"),
                points: slices
                    .iter()
                    .enumerate()
                    .filter(|(_, slice)| slice.latency.count() > 0)
                    .map(|(k, slice)| {
                        let latency_ms = slice.latency.quantile_ns(share) * 1e-6;
                        (time(k), latency_ms.max(LEAST_SHOWN_MS))
                    })
                    .collect(),
                dots: false,
            });
        }
    }
    let latency = Chart {
        log: true,
        ..chart(
            "Latency from the newest sample of a batch to its arrival".to_owned(),
            "ms",
            series,
        )
    };
    let lost = |slices: &[Slice], other: &[Slice], link: &str| Series {
        name: link.to_owned(),
        points: (slices.iter().zip(other).enumerate())
            .map(|(k, (slice, other))| {
                let all = slice.delivered + slice.missing;
                // A link that is not there shows no gap of its own.
                let share = match all {
                    0 if other.delivered > 0 => 1.0,
                    _ => slice.missing as f64 / all.max(1) as f64,
                };
                (time(k), 100.0 * share)
            })
            .collect(),
        dots: false,
    };
    let [cable, wireless] = &history.slices;
    let loss = chart(
        "Samples that did not arrive".to_owned(),
        "%",
        vec![
            lost(wireless, cable, "wireless"),
            lost(cable, wireless, "cable"),
        ],
    );
    [("latency", latency), ("loss", loss)]
}
