//! Report of a path: plan, path in space, coordinates, velocity and standard deviation.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use super::{InertialPath, PathPoint};
use crate::chart::{Band, Chart, Series, Style};
use crate::digits::significant;
use crate::document::Document;

/// Least standard deviation that is drawn, m.
const LEAST_M: f64 = 1e-4;
/// Ellipses in a plan.
const ELLIPSES: usize = 12;
/// Corners of an ellipse.
const CORNERS: u32 = 40;

impl InertialPath {
    /// A page with the result of the path, its charts and `text`, that of the command.
    ///
    /// # Errors
    /// Those of [`Document`].
    pub fn page(&self, source: &str, text: &str) -> Document {
        let mut page = self.head(source, text);
        let anchors = self.ranging.iter().flat_map(|ranging| &ranging.anchors);
        let positions: Vec<_> = anchors.clone().map(|anchor| anchor.position_m).collect();
        let anchors = Series {
            labels: anchors.map(|anchor| anchor.id.clone()).collect(),
            ..Series::space("anchor", Style::Dots, &positions)
        };
        let more = if positions.is_empty() { Vec::new() } else { vec![anchors] };
        let mut charts = self.charts(&more);
        charts.extend(self.innovations());
        for chart in charts {
            page.chart(&chart);
        }
        page
    }

    /// The residuals of each aid over time.
    fn innovations(&self) -> Option<Chart> {
        let mut aids = BTreeMap::<String, Vec<(f64, f64)>>::new();
        for residual in &self.residuals {
            let anchor = self.ranging.as_ref().and_then(|found| found.anchors.get(residual.source));
            let name = match anchor {
                Some(anchor) => format!("{} {}", residual.aid, anchor.id),
                None => residual.aid.to_owned(),
            };
            aids.entry(name).or_default().push((residual.time_s, residual.value));
        }
        let series = aids.into_iter().map(|(aid, values)| Series::dots(&aid, values));
        let series: Vec<Series> = series.collect();
        let title = "Residuals of the aids: measured less predicted";
        (!series.is_empty()).then(|| Chart {
            note: "Predicted by the forward filter, with the estimated bias and scale of each anchor. Ranges without line of sight are too long."
                .to_owned(),
            ..Chart::new(title, "time, s", "SI units", series)
        })
    }

    /// The page without charts.
    fn head(&self, source: &str, text: &str) -> Document {
        let mut page = Document::new(format!("Path of {source}"));
        let (mut lines, last) = (text.lines(), self.points.iter().rfind(|point| point.valid));
        page.result(lines.next().unwrap_or_default());
        if let Some(last) = last {
            let length = significant(self.figures.distance_m, 3);
            page.key("path, while valid", &format!("{length} m"));
            let name = format!("1 σ at {:.1} s, the last valid point", last.time_s);
            page.key(&name, &format!("± {} m", significant(last.sd_m(), 2)));
        }
        let share = 100.0 * self.figures.valid_share;
        let name = format!("of the points valid: σ below {} m", self.limit_m);
        page.key(&name, &format!("{share:.0} %"));
        page.printed(text).findings(&self.findings);
        page
    }

    /// The charts; `more` is drawn in the plan and in space.
    fn charts(&self, more: &[Series]) -> Vec<Chart> {
        let mut charts = vec![self.plan(more)];
        // Ranges may be in a plane.
        let is_plane = self.points.iter().all(|point| point.position_m[2] == 0.0);
        let axes = ["East", "North", "Up: height above the origin"].into_iter();
        let axes = axes.enumerate().take(if is_plane { 2 } else { 3 });
        if !is_plane {
            charts.push(self.space(more));
        }
        charts.extend(axes.map(|(axis, name)| {
            let of = |p: &PathPoint| (p.position_m[axis], p.sigma_m()[axis]);
            let mut chart = self.over_time(&format!("{name}, ± 1 σ"), "m", &[("path", &of)]);
            let truth = |k: usize| Some((self.points[k].time_s, self.truth_at(k)?[axis]));
            let truth: Vec<_> = (0..self.points.len()).filter_map(truth).collect();
            if !truth.is_empty() {
                chart.series.push(Series::line("truth", truth));
            }
            chart
        }));
        let velocity =
            |axis: usize| move |p: &PathPoint| (p.velocity_mps[axis], p.velocity_sd_mps[axis]);
        let [east, north, up] = [0, 1, 2].map(velocity);
        let named: [(&str, Of<'_>); 3] = [("east", &east), ("north", &north), ("up", &up)];
        charts.push(self.over_time("Velocity, ± 1 σ", "m/s", &named));
        charts.push(self.deviation());
        charts
    }

    fn valid(&self) -> impl DoubleEndedIterator<Item = &PathPoint> + Clone {
        self.points.iter().filter(|point| point.valid)
    }

    fn truth_at(&self, k: usize) -> Option<[f64; 3]> {
        self.truth_m.get(k).copied().flatten()
    }

    /// A chart of values with their standard deviations over time, in which what is not valid is marked.
    fn over_time(&self, title: &str, unit: &str, of: &[(&str, Of<'_>)]) -> Chart {
        let mut chart = Chart {
            marked: self.not_valid(),
            y_range: self.range_of(&of.iter().map(|(_, of)| *of).collect::<Vec<_>>()),
            ..Chart::new(title, "time, s", unit, Vec::new())
        };
        if !chart.marked.is_empty() {
            chart.note = format!(
                "Grey: not valid (1 σ above {} m, or a gap since the last rest).",
                self.limit_m
            );
        }
        for (name, value) in of {
            let points = self.points.iter().map(|p| (p.time_s, value(p).0));
            let band = self.points.iter().map(|p| {
                let (value, sd) = value(p);
                let sd = if p.valid { sd } else { f64::NAN };
                (p.time_s, value - sd, value + sd)
            });
            chart.bands.push(Band { series: chart.series.len(), points: band.collect() });
            chart.series.push(Series::line(name, points.collect()));
        }
        chart
    }

    /// Intervals that are not valid, s.
    fn not_valid(&self) -> Vec<(f64, f64)> {
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
        marked
    }

    /// Range of values ± 1 σ where they are valid: what is not valid may be anywhere and must not hide the rest.
    fn range_of(&self, of: &[Of<'_>]) -> Option<(f64, f64)> {
        let seen = self.valid().flat_map(|point| {
            of.iter().flat_map(move |of| {
                let (value, sd) = of(point);
                [value - sd, value + sd]
            })
        });
        let (low, high) = seen
            .filter(|v| v.is_finite())
            .fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
        let room = (0.05 * (high - low)).max(0.005);
        (low <= high).then_some((low - room, high + room))
    }

    fn deviation(&self) -> Chart {
        let line = |of: &dyn Fn(&PathPoint) -> f64| {
            let points = self.points.iter().map(|p| (p.time_s, of(p)));
            points.filter(|(_, value)| value.is_finite()).collect()
        };
        Chart {
            title: "Standard deviation of the position in space".to_owned(),
            log: true,
            series: vec![
                Series::line("1 σ", line(&|p| p.sd_m().clamp(LEAST_M, 1e9))),
                Series::guide("limit of validity", line(&|_| self.limit_m)),
            ],
            bands: Vec::new(),
            y_range: None,
            ..self.over_time("", "m", &[])
        }
    }

    /// Path and truth as far as they are valid, in runs with breaks between them.
    fn lines(&self) -> Vec<Series> {
        let run = |name: &str, at: &dyn Fn(usize) -> Option<[f64; 3]>| {
            let mut points: Vec<[f64; 3]> = Vec::new();
            let mut times_s = Vec::new();
            for (k, point) in self.points.iter().enumerate() {
                let here = at(k).filter(|_| point.valid);
                let is_new = here.is_some() || points.last().is_some_and(|p| p[0].is_finite());
                if is_new {
                    points.push(here.unwrap_or([f64::NAN; 3]));
                    times_s.push(point.time_s);
                }
            }
            Series { times_s, ..Series::space(name, Style::Line, &points) }
        };
        let path = run("path", &|k| Some(self.points[k].position_m));
        let truth = run("truth", &|k| self.truth_at(k));
        let ends = [self.valid().next(), self.valid().next_back()];
        let ends: Vec<_> = ends.into_iter().flatten().collect();
        let marks = Series {
            times_s: ends.iter().map(|p| p.time_s).collect(),
            labels: ["start", "end"].map(String::from).into(),
            ..Series::space("", Style::Dots, &ends.iter().map(|p| p.position_m).collect::<Vec<_>>())
        };
        let mut lines = vec![path, truth, marks];
        lines.retain(|series| !series.points.is_empty());
        lines
    }

    fn space(&self, more: &[Series]) -> Chart {
        let series = [&self.lines(), more].concat();
        Chart {
            z: "up, m".to_owned(),
            equal: true,
            note: "Drag to rotate.".to_owned(),
            ..Chart::new("Path in space, while valid", "east, m", "north, m", series)
        }
    }

    fn plan(&self, more: &[Series]) -> Chart {
        let mut series = [&self.lines(), more].concat();
        for one in &mut series {
            one.z.clear();
        }
        series.push(Series::guide("1 σ", self.ellipses()));
        let range = |axis: usize, of: fn(&(f64, f64)) -> f64| {
            let own = self.range_of(&[&|p| (p.position_m[axis], p.sigma_m()[axis])]);
            let others = more.iter().flat_map(|series| &series.points).map(of);
            own.map(|own| others.fold(own, |(low, high), v| (low.min(v), high.max(v))))
        };
        Chart {
            equal: true,
            x_range: range(0, |point| point.0),
            y_range: range(1, |point| point.1),
            note: "Ellipses: 1 σ (39 % probability).".to_owned(),
            ..Chart::new("Plan, while valid", "east, m", "north, m", series)
        }
    }

    /// Ellipses of 1 σ at equal times, with breaks between them: x = L [cos φ, sin φ] with L Lᵀ the covariance.
    fn ellipses(&self) -> Vec<(f64, f64)> {
        let valid: Vec<&PathPoint> = self.valid().collect();
        let every = (valid.len() / ELLIPSES).max(1);
        let mut outline = Vec::new();
        for point in valid.into_iter().rev().step_by(every) {
            let (at, c) = (point.position_m, point.covariance_m2);
            let a = c[0][0].max(0.0).sqrt();
            let b = if a > 0.0 { c[0][1] / a } else { 0.0 };
            let d = (c[1][1] - b * b).max(0.0).sqrt();
            outline.extend((0..=CORNERS).map(|k| {
                let (sine, cosine) = (f64::from(k) * 2.0 * PI / f64::from(CORNERS)).sin_cos();
                (at[0] + a * cosine, at[1] + b * cosine + d * sine)
            }));
            outline.push((f64::NAN, f64::NAN));
        }
        outline
    }
}

/// A value of a point and its standard deviation.
type Of<'a> = &'a dyn Fn(&PathPoint) -> (f64, f64);
