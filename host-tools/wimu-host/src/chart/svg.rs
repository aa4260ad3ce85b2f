//! A chart as SVG: of one in space, its view from above.

use std::fmt::Write;
use std::ops::Range;

use super::{Chart, Series, Style};
use crate::html::escape;

/// Size of a picture, px.
const SIZE: [f64; 2] = [860.0, 380.0];
/// The area inside the axes: left, top, width, height, px.
const AREA: [f64; 4] = [80.0, 56.0, 768.0, 272.0];
/// Colours that can be distinguished without seeing red and green.
const COLOURS: [&str; 8] =
    ["#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a62c9", "#a5483f"];
const GUIDE: &str = "#969696";
const INK: &str = "#282828";
const GRID: &str = "#e1e1e1";
const MARK: &str = "#ececec";
/// Width of a character of the legend, px, about.
const CHARACTER: f64 = 7.0;
/// Furthest that a point is drawn outside the area, px.
const FAR: f64 = 1e5;

impl Chart {
    /// The picture as SVG text.
    pub fn svg(&self) -> String {
        let chart = self.decimated();
        let (x, y) = chart.ranges();
        let [left, top, width, height] = AREA;
        let x = Axis { range: x, log: self.log_x, length: width };
        let y = Axis { range: y, log: self.log, length: height };
        let mut svg = Svg(String::new());
        svg.add(format_args!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
             font-family=\"sans-serif\" font-size=\"13\" fill=\"{INK}\">\
             <rect width=\"{w}\" height=\"{h}\" fill=\"#fff\"/>",
            w = SIZE[0],
            h = SIZE[1]
        ));
        let middle = left + 0.5 * width;
        svg.text([middle, 24.0], "middle\" font-size=\"18", &self.title);
        svg.text([middle, SIZE[1] - 8.0], "middle", &self.x);
        let across = top + 0.5 * height;
        let turned = format!("middle\" transform=\"rotate(-90 16 {across})");
        svg.text([16.0, across], &turned, &self.y);
        chart.legend(&mut svg);
        svg.add(format_args!("<g transform=\"translate({left} {top})\">"));
        for &(from, to) in &self.marked {
            let [from, to] = [x.place(from), x.place(to)].map(|place| place.clamp(0.0, width));
            let wide = to - from;
            svg.add(format_args!(
                "<rect x=\"{from:.1}\" width=\"{wide:.1}\" height=\"{height}\" fill=\"{MARK}\"/>"
            ));
        }
        for (tick, label) in x.ticks(8.0) {
            svg.line(GRID, [tick, 0.0, tick, height]);
            svg.text([tick, height + 18.0], "middle", &label);
        }
        for (tick, label) in y.ticks(6.0) {
            let tick = height - tick;
            svg.line(GRID, [0.0, tick, width, tick]);
            svg.text([-8.0, tick + 4.0], "end", &label);
        }
        svg.line(INK, [0.0, height, width, height]);
        svg.line(INK, [0.0, 0.0, 0.0, height]);
        // What is outside of an inner picture is not drawn.
        svg.add(format_args!("<svg width=\"{width}\" height=\"{height}\">"));
        chart.data(&mut svg, |(a, b)| [x.place(a), height - y.place(b)]);
        svg.0 += "</svg></g></svg>\n";
        svg.0
    }

    /// Draws bands and series at the places, px, that `at` gives.
    fn data(&self, svg: &mut Svg, at: impl Fn((f64, f64)) -> [f64; 2]) {
        for band in &self.bands {
            let colour = self.colours().nth(band.series).unwrap_or(GUIDE);
            let is_break =
                |(_, low, high): &(f64, f64, f64)| !(low.is_finite() && high.is_finite());
            for run in band.points.split(is_break).filter(|run| run.len() > 1) {
                let low = run.iter().map(|&(x, low, _)| at((x, low)));
                let high = run.iter().rev().map(|&(x, _, high)| at((x, high)));
                let points = places(low.chain(high));
                svg.add(format_args!(
                    "<polygon points=\"{points}\" fill=\"{colour}\" fill-opacity=\"0.15\"/>"
                ));
            }
        }
        for (series, colour) in self.series.iter().zip(self.colours()) {
            let is_break = |(x, y): &(f64, f64)| !(x.is_finite() && y.is_finite());
            if series.style == Style::Dots {
                // Many dots are small.
                let radius = if series.points.len() > 200 { 2 } else { 5 };
                for [x, y] in series.points.iter().filter(|point| !is_break(point)).map(|p| at(*p))
                {
                    svg.add(format_args!(
                        "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{colour}\"/>"
                    ));
                }
            } else {
                for run in series.points.split(is_break).filter(|run| !run.is_empty()) {
                    let (points, wide) =
                        (places(run.iter().map(|point| at(*point))), series.width());
                    svg.add(format_args!(
                        "<polyline points=\"{points}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{wide}\"/>"
                    ));
                }
            }
            for (label, point) in series.labels.iter().zip(&series.points) {
                if !is_break(point) {
                    svg.text(at(*point), "start", label);
                }
            }
        }
    }

    /// Ranges of x and y: those of the data, with room beside them.
    fn ranges(&self) -> (Range<f64>, Range<f64>) {
        let is_data = |series: &&Series| series.style != Style::Guide;
        let no_data = !self.series.iter().any(|series| is_data(&series));
        let shown = || self.series.iter().filter(|s| no_data || is_data(s));
        let all = || shown().flat_map(|series| &series.points);
        let x = self.x_range.unwrap_or_else(|| span(all().map(|point| point.0)));
        let y = self.shown_y().unwrap_or_else(|| span(all().map(|point| point.1)));
        let roomy = |(low, high): (f64, f64), log: bool, part: f64, factor: f64| {
            if log {
                return low.max(1e-9) / factor..high.max(1e-9) * factor;
            }
            low - part * (high - low)..high + part * (high - low)
        };
        let (x, y) = (roomy(x, self.log_x, 0.03, 1.2), roomy(y, self.log, 0.05, 1.5));
        if !self.equal {
            return (x, y);
        }
        let aspect = AREA[2] / AREA[3];
        let height = (y.end - y.start).max((x.end - x.start) / aspect);
        let around = |range: Range<f64>, length: f64| {
            let middle = 0.5 * (range.start + range.end);
            middle - 0.5 * length..middle + 0.5 * length
        };
        (around(x, height * aspect), around(y, height))
    }

    /// Colour of each series: guides are grey.
    fn colours(&self) -> impl Iterator<Item = &'static str> {
        let mut next = COLOURS.into_iter().cycle();
        self.series.iter().map(move |series| match series.style {
            Style::Guide => GUIDE,
            _ => next.next().unwrap_or(GUIDE),
        })
    }

    /// Names the series in one line above the area.
    fn legend(&self, svg: &mut Svg) {
        let named = || self.series.iter().zip(self.colours()).filter(|(s, _)| !s.name.is_empty());
        let width = |series: &Series| 56.0 + CHARACTER * series.name.chars().count() as f64;
        let mut x =
            0.5 * (SIZE[0] - named().map(|(series, _)| width(series)).sum::<f64>()).max(0.0);
        for (series, colour) in named() {
            let y = 42.0;
            match series.style {
                Style::Dots => svg.add(format_args!(
                    "<circle cx=\"{}\" cy=\"{y}\" r=\"5\" fill=\"{colour}\"/>",
                    x + 12.0
                )),
                _ => svg.add(format_args!(
                    "<path d=\"M{x} {y}h24\" stroke=\"{colour}\" stroke-width=\"{}\"/>",
                    series.width()
                )),
            }
            svg.text([x + 32.0, y + 4.0], "start", &series.name);
            x += width(series);
        }
    }
}

impl Series {
    /// Width of its line, px.
    fn width(&self) -> u32 {
        if self.style == Style::Guide { 1 } else { 2 }
    }
}

/// SVG text.
struct Svg(String);

impl Svg {
    fn add(&mut self, element: std::fmt::Arguments<'_>) {
        // Writing to a text cannot fail.
        let _ = self.0.write_fmt(element);
    }

    fn line(&mut self, colour: &str, [x1, y1, x2, y2]: [f64; 4]) {
        self.add(format_args!(
            "<path d=\"M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}\" stroke=\"{colour}\"/>"
        ));
    }

    /// A text at a place, px; `anchor` is its anchor, with other attributes after it.
    fn text(&mut self, [x, y]: [f64; 2], anchor: &str, text: &str) {
        let text = escape(text);
        self.add(format_args!(
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{text}</text>"
        ));
    }
}

/// An axis of `length` px.
struct Axis {
    range: Range<f64>,
    log: bool,
    length: f64,
}

impl Axis {
    /// Distance of a value from the start of the axis, px.
    fn place(&self, value: f64) -> f64 {
        let along = |value: f64| if self.log { value.max(1e-9).log10() } else { value };
        let (start, end) = (along(self.range.start), along(self.range.end));
        ((along(value) - start) / (end - start) * self.length).clamp(-FAR, FAR)
    }

    /// Places of ticks, px, and their labels; on a linear axis at most about `most`.
    fn ticks(&self, most: f64) -> Vec<(f64, String)> {
        let Range { start, end } = self.range;
        if self.log {
            let decades = start.log10().floor() as i32..=end.log10().ceil() as i32;
            let few = end / start < 100.0;
            let within: &[f64] = if few { &[1.0, 2.0, 5.0] } else { &[1.0] };
            let values =
                decades.flat_map(|decade| within.iter().map(move |m| m * 10_f64.powi(decade)));
            return (values.filter(|value| (start..=end).contains(value)))
                .map(|value| (self.place(value), decade(value)))
                .collect();
        }
        let rough = (end - start) / most;
        let power = 10_f64.powf(rough.log10().floor());
        let step =
            power * [1.0, 2.0, 5.0, 10.0].into_iter().find(|m| m * power >= rough).unwrap_or(10.0);
        let (first, last) = ((start / step).ceil(), (end / step).floor());
        // A range that rounding makes empty has no ticks.
        let count = (last - first + 1.0).clamp(0.0, 2.0 * most) as usize;
        (0..count)
            .map(|k| (first + k as f64) * step)
            .map(|value| (self.place(value), rounded(value, step)))
            .collect()
    }
}

/// Least and greatest finite value, apart; 0 to 1 without one.
fn span(values: impl Iterator<Item = f64>) -> (f64, f64) {
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
}

/// Places as a list of points.
fn places(places: impl Iterator<Item = [f64; 2]>) -> String {
    let mut list = String::new();
    for [x, y] in places {
        let _ = write!(list, "{x:.1},{y:.1} ");
    }
    list
}

/// A tick label on a logarithmic axis.
fn decade(value: f64) -> String {
    let short = format!("{value:.2e}").parse::<f64>().unwrap_or(value);
    if (1e-3..1e4).contains(&short.abs()) { short.to_string() } else { format!("{short:e}") }
}

/// A tick label on an axis with a tick every `step`.
fn rounded(value: f64, step: f64) -> String {
    let digits = (-step.log10().floor()).clamp(0.0, 12.0) as usize;
    let text = format!("{value:.digits$}");
    if text.trim_matches(['-', '0', '.']).is_empty() { "0".to_owned() } else { text }
}
