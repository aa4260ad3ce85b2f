//! Reports: one HTML file with its pictures inside.

use std::fmt::Write as _;
use std::path::Path;

use plotters::coord::Shift;
use plotters::prelude::*;

use crate::{ErrorCode, HostError, Result};

/// Size of a picture, px.
const SIZE: (u32, u32) = (860, 380);
/// Colours that are told apart also without seeing red and green.
const COLOURS: [RGBColor; 4] = [
    RGBColor(213, 94, 0),
    RGBColor(0, 114, 178),
    RGBColor(0, 158, 115),
    RGBColor(90, 90, 90),
];

/// A page that is written from top to bottom.
#[derive(Clone, Debug)]
pub struct Report {
    title: String,
    body: String,
}

/// A line, or points, in a [`Chart`].
#[derive(Clone, Debug)]
pub struct Series {
    /// Its name in the legend.
    pub name: String,
    /// x and y.
    pub points: Vec<(f64, f64)>,
    /// Points instead of a line.
    pub dots: bool,
}

/// A picture of some series over one x axis.
#[derive(Clone, Debug)]
pub struct Chart {
    /// What it shows.
    pub title: String,
    /// The x axis with its unit.
    pub x: String,
    /// The y axis with its unit.
    pub y: String,
    /// Logarithmic y axis; values must be positive.
    pub log: bool,
    /// y from and to, where the data's own range hides what matters.
    pub y_range: Option<(f64, f64)>,
    /// The series.
    pub series: Vec<Series>,
}

/// Where a series of a [`Chart`] may lie.
#[derive(Clone, Debug)]
pub struct Band {
    /// Index of the series.
    pub series: usize,
    /// x, lowest y and highest.
    pub points: Vec<(f64, f64, f64)>,
}

impl Report {
    /// An empty page.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            body: String::new(),
        }
    }

    /// A paragraph.
    pub fn text(&mut self, text: &str) -> &mut Self {
        let _ = writeln!(self.body, "<p>{}</p>", escape(text));
        self
    }

    /// Lines as they were printed.
    pub fn printed(&mut self, text: &str) -> &mut Self {
        let _ = writeln!(self.body, "<pre>{}</pre>", escape(text));
        self
    }

    /// A table with a head.
    pub fn table(&mut self, head: &[&str], rows: &[Vec<String>]) -> &mut Self {
        let cells = |tag: &str, cells: &mut dyn Iterator<Item = &str>| {
            let cells: String = cells
                .map(|cell| format!("<{tag}>{}</{tag}>", escape(cell)))
                .collect();
            format!("<tr>{cells}</tr>")
        };
        self.body.push_str("<table>");
        self.body.push_str(&cells("th", &mut head.iter().copied()));
        for row in rows {
            self.body
                .push_str(&cells("td", &mut row.iter().map(String::as_str)));
        }
        self.body.push_str("</table>\n");
        self
    }

    /// A picture.
    ///
    /// # Errors
    /// `file_failed` when it cannot be drawn.
    pub fn chart(&mut self, chart: &Chart) -> Result<&mut Self> {
        let _ = writeln!(self.body, "<figure>{}</figure>", chart.svg()?);
        Ok(self)
    }

    /// A picture with bands behind its series.
    ///
    /// # Errors
    /// `file_failed` when it cannot be drawn.
    pub fn chart_with_bands(&mut self, chart: &Chart, bands: &[Band]) -> Result<&mut Self> {
        let svg = chart.svg_with_bands(bands)?;
        let _ = writeln!(self.body, "<figure>{svg}</figure>");
        Ok(self)
    }

    /// Writes the page, in place of one that is there.
    ///
    /// # Errors
    /// `file_failed`, `file_unreadable`.
    pub fn write(&self, path: &Path) -> Result<()> {
        let title = escape(&self.title);
        let page = format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title>\n\
             <style>{STYLE}</style></head>\n<body><h1>{title}</h1>\n{}</body></html>\n",
            self.body
        );
        std::fs::write(path, page)
            .map_err(|error| HostError::file(&path.display().to_string(), "write", &error))
    }
}

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:900px;margin:2em auto;\
    padding:0 1em;color:#222}pre{background:#f4f4f4;padding:1em;overflow:auto;font-size:14px}\
    table{border-collapse:collapse}td,th{padding:.2em 1em;border-bottom:1px solid #ddd;\
    text-align:right}figure{margin:1.5em 0}svg{max-width:100%;height:auto}";

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

impl Chart {
    /// The picture as SVG text.
    ///
    /// # Errors
    /// `file_failed` when it cannot be drawn.
    pub fn svg(&self) -> Result<String> {
        self.svg_with_bands(&[])
    }

    fn svg_with_bands(&self, bands: &[Band]) -> Result<String> {
        let mut svg = String::new();
        {
            let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
            let (x, y) = self.ranges();
            let drawn = if self.log {
                self.draw(&area, x, (y.start.max(1e-9)..y.end).log_scale(), bands)
            } else {
                self.draw(&area, x, y, bands)
            };
            drawn.map_err(|reason| {
                HostError::new(
                    ErrorCode::FileFailed,
                    format!("a picture cannot be drawn: {reason}"),
                    "report this as a fault of wimu",
                )
            })?;
        }
        Ok(svg)
    }

    fn ranges(&self) -> (std::ops::Range<f64>, std::ops::Range<f64>) {
        let all = || self.series.iter().flat_map(|series| &series.points);
        let span = |values: &mut dyn Iterator<Item = f64>| {
            let (low, high) = values
                .filter(|value| value.is_finite())
                .fold((f64::MAX, f64::MIN), |(low, high), value| {
                    (low.min(value), high.max(value))
                });
            if low < high {
                (low, high)
            } else if low == high {
                (low - 0.5, high + 0.5)
            } else {
                (0.0, 1.0)
            }
        };
        let (left, right) = span(&mut all().map(|point| point.0));
        let side = 0.03 * (right - left);
        let (low, high) = self
            .y_range
            .unwrap_or_else(|| span(&mut all().map(|point| point.1)));
        let room = if self.log { 0.0 } else { 0.05 * (high - low) };
        let stretch = if self.log { 1.5 } else { 1.0 };
        (
            left - side..right + side,
            low / stretch - room..high * stretch + room,
        )
    }

    fn draw<Y>(
        &self,
        area: &DrawingArea<SVGBackend, Shift>,
        x: std::ops::Range<f64>,
        y: Y,
        bands: &[Band],
    ) -> std::result::Result<(), String>
    where
        Y: plotters::coord::ranged1d::AsRangedCoord<Value = f64>,
        Y::CoordDescType: plotters::coord::ranged1d::ValueFormatter<f64>,
    {
        let say = |error: &dyn std::fmt::Display| error.to_string();
        area.fill(&WHITE).map_err(|e| say(&e))?;
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, ("sans-serif", 18))
            .margin(12)
            .x_label_area_size(42)
            .y_label_area_size(68)
            .build_cartesian_2d(x, y)
            .map_err(|e| say(&e))?;
        chart
            .configure_mesh()
            .x_desc(&self.x)
            .y_desc(&self.y)
            .light_line_style(WHITE)
            .label_style(("sans-serif", 13))
            .draw()
            .map_err(|e| say(&e))?;
        for band in bands {
            let colour = COLOURS[band.series % COLOURS.len()].mix(0.15);
            let finite = || {
                band.points
                    .iter()
                    .filter(|(_, low, high)| low.is_finite() && high.is_finite())
            };
            let outline: Vec<_> = finite()
                .map(|&(x, low, _)| (x, low))
                .chain(finite().rev().map(|&(x, _, high)| (x, high)))
                .collect();
            chart
                .draw_series([Polygon::new(outline, colour.filled())])
                .map_err(|e| say(&e))?;
        }
        for (series, colour) in self.series.iter().zip(COLOURS.iter().cycle()) {
            let style = colour.stroke_width(2);
            let annotation = if series.dots {
                chart.draw_series(
                    series
                        .points
                        .iter()
                        .map(|&point| Circle::new(point, 5, colour.filled())),
                )
            } else {
                chart.draw_series(LineSeries::new(series.points.iter().copied(), style))
            };
            annotation
                .map_err(|e| say(&e))?
                .label(&series.name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerRight)
            .background_style(WHITE.mix(0.85))
            .border_style(BLACK.mix(0.3))
            .label_font(("sans-serif", 13))
            .draw()
            .map_err(|e| say(&e))?;
        area.present().map_err(|e| say(&e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<(f64, f64)>, log: bool) -> Chart {
        Chart {
            title: "a < b".to_owned(),
            x: "t (s)".to_owned(),
            y: "p (m)".to_owned(),
            log,
            y_range: None,
            series: vec![Series {
                name: "one".to_owned(),
                points,
                dots: log,
            }],
        }
    }

    #[test]
    fn any_points_can_be_drawn() {
        for points in [
            vec![],
            vec![(1.0, 2.0)],
            vec![(0.0, 1.0), (1.0, 1.0)],
            vec![(0.0, f64::NAN), (1.0, f64::INFINITY)],
            vec![(0.0, 1e-3), (1.0, 1e3)],
        ] {
            for log in [false, true] {
                let svg = chart(points.clone(), log).svg().unwrap();
                assert!(svg.contains("</svg>") && svg.contains("t (s)"));
            }
        }
    }

    #[test]
    fn text_cannot_break_the_page() {
        let mut report = Report::new("<x>");
        report
            .text("1 < 2 & 3")
            .table(&["<h>"], &[vec!["<td>".to_owned()]]);
        assert!(!report.body.contains("<h>") && report.body.contains("1 &lt; 2 &amp; 3"));
    }
}
