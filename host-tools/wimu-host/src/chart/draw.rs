//! A chart as SVG and PNG: of one in space, its view from above.

use std::ops::Range;
use std::path::Path;
use std::sync::OnceLock;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;
use plotters::style::register_font;

use super::{Chart, Series, Style};
use crate::{ErrorCode, OutputFile, Result};

/// Size of a picture, px.
const SIZE: (u32, u32) = (860, 380);
/// Pixels of a PNG per pixel of [`SIZE`]: for print and high-resolution screens.
const FINER: u32 = 2;
/// Width over height of the area inside the axes.
const ASPECT: f64 = 3.1;
const FONT: &str = "sans-serif";
/// Colours that can be distinguished without seeing red and green.
const COLOURS: [RGBColor; 8] = [
    RGBColor(213, 94, 0),
    RGBColor(0, 114, 178),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(122, 98, 201),
    RGBColor(165, 72, 63),
];
/// Colour of guides.
const GUIDE: RGBColor = RGBColor(150, 150, 150);
const INK: RGBColor = RGBColor(40, 40, 40);
const GRID: RGBColor = RGBColor(225, 225, 225);
const MARK: RGBColor = RGBColor(236, 236, 236);

/// Result of drawing.
type Drawn = std::result::Result<(), Box<dyn std::error::Error>>;

impl Chart {
    /// The picture as SVG text.
    ///
    /// # Errors
    /// `file_failed` when it cannot be drawn.
    pub fn svg(&self) -> Result<String> {
        let mut svg = String::new();
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        self.decimated().draw(&area, 1)?;
        drop(area);
        Ok(svg)
    }

    /// Writes the chart to a file, replacing an existing one: as SVG or PNG, by its extension.
    ///
    /// # Errors
    /// `usage` for another extension; `file_failed`, `file_unreadable`.
    pub fn write(&self, path: &Path) -> Result<()> {
        let name = path.display().to_string();
        let extension = path.extension().and_then(|extension| extension.to_str());
        match extension {
            Some("svg") => OutputFile::write(path, self.svg()?),
            Some("png") => {
                let size = (FINER * SIZE.0, FINER * SIZE.1);
                let (output, _) = OutputFile::create(path)?;
                let area = BitMapBackend::new(output.path(), size).into_drawing_area();
                let chart = self.decimated();
                chart.draw(&area, FINER).map_err(|error| error.at(name))?;
                drop(area);
                output.finish()
            }
            _ => Err(ErrorCode::Usage
                .error("a chart is written as SVG or PNG", "give a name that ends in .svg or .png")
                .at(name)),
        }
    }

    fn ranges(&self) -> (Range<f64>, Range<f64>) {
        let is_data = |series: &&Series| series.style != Style::Guide;
        let no_data = !self.series.iter().any(|series| is_data(&series));
        let shown = || self.series.iter().filter(|s| no_data || is_data(s));
        let all = || shown().flat_map(|series| &series.points);
        let span = |values: &mut dyn Iterator<Item = f64>| {
            let (low, high) = values
                .filter(|value| value.is_finite())
                .fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
            if low < high {
                (low, high)
            } else if low == high {
                (low - 0.5, high + 0.5)
            } else {
                (0.0, 1.0)
            }
        };
        let (left, right) = self.x_range.unwrap_or_else(|| span(&mut all().map(|point| point.0)));
        let side = if self.log_x { 0.0 } else { 0.03 * (right - left) };
        let widen = if self.log_x { 1.2 } else { 1.0 };
        let (low, high) = self.y_range.unwrap_or_else(|| span(&mut all().map(|point| point.1)));
        let room = if self.log { 0.0 } else { 0.05 * (high - low) };
        let stretch = if self.log { 1.5 } else { 1.0 };
        let x = left / widen - side..right * widen + side;
        let y = low / stretch - room..high * stretch + room;
        if !self.equal {
            return (x, y);
        }
        let height = (y.end - y.start).max((x.end - x.start) / ASPECT);
        let around = |range: Range<f64>, length: f64| {
            let middle = 0.5 * (range.start + range.end);
            middle - 0.5 * length..middle + 0.5 * length
        };
        (around(x, height * ASPECT), around(y, height))
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, fine: u32) -> Result<()>
    where
        B::ErrorType: 'static,
    {
        let (x, y) = self.ranges();
        let drawn = have_font().and_then(|()| {
            let range = (x.clone(), y.clone());
            let log = |range: Range<f64>| (range.start.max(1e-9)..range.end).log_scale();
            match (self.log_x, self.log) {
                (false, false) => self.draw_on(area, fine, x, y, &range),
                (false, true) => self.draw_on(area, fine, x, log(y), &range),
                (true, false) => self.draw_on(area, fine, log(x), y, &range),
                (true, true) => self.draw_on(area, fine, log(x), log(y), &range),
            }
        });
        drawn.map_err(|reason| {
            ErrorCode::FileFailed.error(
                format!("the chart cannot be drawn: {reason}"),
                "check the file's folder; if it exists, report this as a fault of wimu",
            )
        })
    }

    fn draw_on<B: DrawingBackend, X, Y>(
        &self,
        area: &DrawingArea<B, Shift>,
        fine: u32,
        x: X,
        y: Y,
        (wide, shown): &(Range<f64>, Range<f64>),
    ) -> Drawn
    where
        B::ErrorType: 'static,
        X: AsRangedCoord<Value = f64>,
        X::CoordDescType: ValueFormatter<f64>,
        Y: AsRangedCoord<Value = f64>,
        Y::CoordDescType: ValueFormatter<f64>,
    {
        let font = |size: u32| (FONT, size * fine).into_font().color(&INK);
        area.fill(&WHITE)?;
        let area = area.margin(12 * fine, 0, 0, 0);
        let area = area.titled(&self.title, font(18))?;
        // Above the chart, where it covers nothing.
        let (legend, below) = area.split_vertically(24 * fine);
        let mut chart = ChartBuilder::on(&below)
            .margin(12 * fine)
            .x_label_area_size(42 * fine)
            .y_label_area_size(68 * fine)
            .build_cartesian_2d(x, y)?;
        for &(from, to) in &self.marked {
            let corners = [(from, shown.start), (to, shown.end)];
            chart.draw_series([Rectangle::new(corners, MARK.filled())])?;
        }
        let tick = |value: f64, log: bool, range: &Range<f64>| match log {
            true => decade(value),
            false => rounded(value, (range.end - range.start) / 10.0),
        };
        chart
            .configure_mesh()
            .x_desc(&self.x)
            .y_desc(&self.y)
            .x_label_formatter(&|x| tick(*x, self.log_x, wide))
            .y_label_formatter(&|y| tick(*y, self.log, shown))
            .light_line_style(WHITE)
            .bold_line_style(GRID.stroke_width(fine))
            .axis_style(INK.stroke_width(fine))
            .set_all_tick_mark_size(4 * fine)
            .label_style(font(13))
            .draw()?;
        for band in &self.bands {
            let colour = self.colours().nth(band.series).unwrap_or(GUIDE).mix(0.15);
            let inside = |y: f64| y.clamp(shown.start, shown.end);
            let is_break =
                |(_, low, high): &(f64, f64, f64)| !(low.is_finite() && high.is_finite());
            for run in band.points.split(is_break).filter(|run| run.len() > 1) {
                let low = run.iter().map(|&(x, low, _)| (x, inside(low)));
                let high = run.iter().rev().map(|&(x, _, high)| (x, inside(high)));
                let outline: Vec<_> = low.chain(high).collect();
                chart.draw_series([Polygon::new(outline, colour.filled())])?;
            }
        }
        for (series, colour) in self.series.iter().zip(self.colours()) {
            let style = colour.stroke_width(series.width() * fine);
            let labels = series.labels.iter().zip(&series.points);
            for (label, point) in labels.filter(|(_, point)| point.0.is_finite()) {
                chart.draw_series([Text::new(label.clone(), *point, font(13))])?;
            }
            if series.style == Style::Dots {
                // Many dots are small.
                let radius = if series.points.len() > 200 { 2 } else { 5 };
                let dots = series.points.iter();
                let dot = |&dot| Circle::new(dot, radius * fine, colour.filled());
                chart.draw_series(dots.map(dot))?;
            } else {
                for piece in within(&series.points, shown) {
                    if fine > 1 {
                        // Step by step: the corners of a broad line of pixels would stick out.
                        let steps = piece.windows(2);
                        chart.draw_series(
                            steps.map(|step| PathElement::new(step.to_vec(), style)),
                        )?;
                    } else {
                        chart.draw_series([PathElement::new(piece, style)])?;
                    }
                }
            }
        }
        self.name_series(&legend, fine)?;
        area.present()?;
        Ok(())
    }

    /// Colour of each series: guides are grey.
    fn colours(&self) -> impl Iterator<Item = RGBColor> {
        let mut next = COLOURS.into_iter().cycle();
        self.series.iter().map(move |series| match series.style {
            Style::Guide => GUIDE,
            _ => next.next().unwrap_or(GUIDE),
        })
    }

    /// Draws the legend in one line in the middle of `area`.
    fn name_series<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, fine: u32) -> Drawn
    where
        B::ErrorType: 'static,
    {
        let font = (FONT, 13 * fine).into_font().color(&INK);
        let (line, gap) = (24 * fine as i32, 8 * fine as i32);
        let mut widths = Vec::new();
        let named = || {
            let all = self.series.iter().zip(self.colours());
            all.filter(|(series, _)| !series.name.is_empty())
        };
        for (series, _) in named() {
            let (width, _) = area.estimate_text_size(&series.name, &font)?;
            widths.push(line + gap + width as i32 + 3 * gap);
        }
        let (width, height) = area.dim_in_pixel();
        let mut x = (width as i32 - widths.iter().sum::<i32>()).max(0) / 2;
        let y = height as i32 / 2;
        for ((series, colour), width) in named().zip(widths) {
            let style = colour.stroke_width(series.width() * fine);
            if series.style == Style::Dots {
                let dot = (x + line / 2, y);
                area.draw(&Circle::new(dot, 5 * fine, colour.filled()))?;
            } else {
                area.draw(&PathElement::new([(x, y), (x + line, y)], style))?;
            }
            let place = (x + line + gap, y - 7 * fine as i32);
            area.draw(&Text::new(series.name.clone(), place, font.clone()))?;
            x += width;
        }
        Ok(())
    }
}

impl Series {
    /// Width of its line, px.
    fn width(&self) -> u32 {
        if self.style == Style::Guide { 1 } else { 2 }
    }
}

/// A tick label on a logarithmic axis.
fn decade(value: f64) -> String {
    let short = format!("{value:.2e}").parse::<f64>().unwrap_or(value);
    if (1e-3..1e4).contains(&short.abs()) { short.to_string() } else { format!("{short:e}") }
}

/// A tick label on an axis whose ticks are about `step` apart, without digits from rounding errors.
fn rounded(value: f64, step: f64) -> String {
    let digits = (2.0 - step.abs().max(1e-12).log10().floor()).clamp(0.0, 12.0) as usize;
    let text = format!("{value:.digits$}");
    let short = match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.'),
        false => &text,
    };
    if short == "-0" { "0" } else { short }.to_owned()
}

/// The pieces of a line within this range of y, cut at its edges.
fn within(points: &[(f64, f64)], range: &Range<f64>) -> Vec<Vec<(f64, f64)>> {
    let inside = |point: (f64, f64)| (range.start..=range.end).contains(&point.1);
    // Intersection of the edge and the line from a point inside to one outside.
    let edge = |from: (f64, f64), to: (f64, f64)| {
        let y = to.1.clamp(range.start, range.end);
        (from.0 + (y - from.1) / (to.1 - from.1) * (to.0 - from.0), y)
    };
    let (mut pieces, mut piece) = (Vec::new(), Vec::new());
    let mut last: Option<(f64, f64)> = None;
    for &point in points {
        let before = last.replace(point);
        if inside(point) {
            let from = before.filter(|&before| !inside(before) && before.1.is_finite());
            piece.extend(from.map(|from| edge(point, from)));
            piece.push(point);
        } else if !piece.is_empty() {
            let to = before.filter(|_| point.1.is_finite());
            piece.extend(to.map(|before| edge(before, point)));
            pieces.push(std::mem::take(&mut piece));
        }
    }
    pieces.push(piece);
    pieces
}

/// Registers the embedded font: searching for those of the system needs a C library.
fn have_font() -> Drawn {
    static DONE: OnceLock<bool> = OnceLock::new();
    let done = DONE
        .get_or_init(|| register_font(FONT, FontStyle::Normal, dejavu::sans::regular()).is_ok());
    let known = done.then_some(());
    Ok(known.ok_or("the font cannot be read")?)
}
