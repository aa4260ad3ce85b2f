//! Pictures of a path.

use std::path::Path as FilePath;

use super::{InertialPath, PathPoint};
use crate::Result;
use crate::chart::{Band, Chart, Series};
use crate::html::Report;

/// Points of a line, at most about.
const SHOWN: usize = 2000;
/// Least standard deviation that is drawn, m.
const LEAST_M: f64 = 1e-4;

impl InertialPath {
    /// Pictures of the path with its standard deviation, what is not valid in grey, and the truth where
    /// there is one: each coordinate, the deviation, and the plan.
    ///
    /// # Errors
    /// Those of [`Report`].
    pub fn report(&self, source: &str, text: &str, file: &FilePath) -> Result<()> {
        let mut report = Report::new(format!("Path of {source}"));
        report.printed(text).findings(&self.findings);
        for (axis, name) in ["East", "North", "Up"].into_iter().enumerate() {
            report.chart(&self.coordinate(axis, name))?;
        }
        report.chart(&self.deviation())?;
        let plan = self.plan();
        if plan.series[0].points.len() > 1 {
            report.chart(&plan)?;
        }
        report.write(file)
    }

    /// Indices of the points that are drawn.
    fn shown(&self) -> impl Iterator<Item = usize> + Clone {
        let thin = (self.points.len() / SHOWN).max(1);
        (0..self.points.len()).step_by(thin)
    }

    fn truth_at(&self, k: usize) -> Option<[f64; 3]> {
        self.truth_m.get(k).copied().flatten()
    }

    /// A chart over time in which what is not valid is marked.
    fn over_time(&self, title: String, y: &str) -> Chart {
        let mut marked: Vec<(f64, f64)> = Vec::new();
        let mut open = false;
        for pair in self.points.windows(2) {
            let bad = !pair[0].valid || !pair[1].valid;
            match marked.last_mut().filter(|_| open && bad) {
                Some(last) => last.1 = pair[1].time_s,
                None if bad => marked.push((pair[0].time_s, pair[1].time_s)),
                None => {}
            }
            open = bad;
        }
        Chart {
            title,
            x: "time, s".to_owned(),
            y: y.to_owned(),
            marked,
            ..Chart::default()
        }
    }

    fn line(&self, name: &str, value: impl Fn(usize, &PathPoint) -> Option<f64>) -> Series {
        let points = self.shown().filter_map(|k| {
            let point = &self.points[k];
            Some((point.time_s, value(k, point)?))
        });
        Series {
            name: name.to_owned(),
            points: points.collect(),
            dots: false,
        }
    }

    fn coordinate(&self, axis: usize, name: &str) -> Chart {
        let title = format!("{name} (grey: not valid)");
        let mut chart = self.over_time(title, "m");
        chart
            .series
            .push(self.line("path ± 1 σ", |_, p| Some(p.position_m[axis])));
        let truth = self.line("truth", |k, _| Some(self.truth_at(k)?[axis]));
        if !truth.points.is_empty() {
            chart.series.push(truth);
        }
        let band = self.shown().map(|k| {
            let (p, sigma) = (self.points[k], self.points[k].sigma_m()[axis]);
            (
                p.time_s,
                p.position_m[axis] - sigma,
                p.position_m[axis] + sigma,
            )
        });
        chart.bands.push(Band {
            series: 0,
            points: band.collect(),
        });
        // What is not valid may be anywhere: it must not hide the rest.
        let valid = self.shown().filter(|k| self.points[*k].valid);
        let seen = valid.flat_map(|k| {
            let (p, sigma) = (self.points[k], self.points[k].sigma_m()[axis]);
            let truth = self.truth_at(k).map_or(p.position_m[axis], |t| t[axis]);
            [
                p.position_m[axis] - sigma,
                p.position_m[axis] + sigma,
                truth,
            ]
        });
        let (low, high) = seen
            .filter(|v| v.is_finite())
            .fold((f64::MAX, f64::MIN), |(low, high), v| {
                (low.min(v), high.max(v))
            });
        if low <= high {
            let room = (0.1 * (high - low)).max(0.005);
            chart.y_range = Some((low - room, high + room));
        }
        chart
    }

    fn deviation(&self) -> Chart {
        let title = "How well it is known: 1 σ in space (grey: not valid)".to_owned();
        let mut chart = self.over_time(title, "m");
        chart.log = true;
        chart.series.push(self.line("1 σ", |_, p| {
            Some(p.sd_m().clamp(LEAST_M, 1e9)).filter(|sd| sd.is_finite())
        }));
        chart
            .series
            .push(self.line("limit", |_, _| Some(self.limit_m)));
        chart
    }

    fn plan(&self) -> Chart {
        let valid = || self.shown().filter(|k| self.points[*k].valid);
        let place = |p: [f64; 3]| (p[0], p[1]);
        let series = |name: &str, points: Vec<(f64, f64)>| Series {
            name: name.to_owned(),
            points,
            dots: false,
        };
        let path = valid().map(|k| place(self.points[k].position_m)).collect();
        let truth: Vec<_> = valid()
            .filter_map(|k| self.truth_at(k).map(place))
            .collect();
        let mut all = vec![series("path", path)];
        if !truth.is_empty() {
            all.push(series("truth", truth));
        }
        Chart {
            title: "Plan, as far as it is valid".to_owned(),
            equal: true,
            x: "east, m".to_owned(),
            y: "north, m".to_owned(),
            series: all,
            ..Chart::default()
        }
    }
}
