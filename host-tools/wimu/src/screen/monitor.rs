//! The screen of `wimu monitor`.

use std::collections::VecDeque;

use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::prelude::{Frame, Span};
use ratatui::text::{Line as Row, Text};
use wimu_host::digits::{east_north_up, significant};
use wimu_host::inertial::{Aided, PathPoint};
use wimu_host::monitor::LinkHealth;
use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::command::monitor::{Line, euler_deg};

use super::widgets::{self, BAD, GOOD, LABEL, STRONG};

/// Points of a curve: the widest screen.
const POINTS: usize = 512;
/// Smallest height of the curves: 0.1 m/s² and 0.05 rad/s, several standard deviations of the noise.
const FORCE_SPAN: f64 = 0.1;
const RATE_SPAN: f64 = 0.05;
/// Columns of a label, of a value and of the limits of a curve.
const COLUMNS: [u16; 3] = [4, 10, 21];
const NAMES: [&str; 4] = ["|f|", "x", "y", "z"];
/// Standard deviation of the position up to which it is called valid, m. Chosen.
const VALID_SD_M: f64 = 1.0;
/// Largest height of a curve, rows.
const MAX_ROWS: u16 = 6;

/// The latest means of a quantity.
#[derive(Clone, Debug, Default)]
pub struct Curve {
    points: VecDeque<f64>,
    sum: f64,
    count: u32,
}

impl Curve {
    /// Adds a value to the present mean.
    pub fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    /// Ends the present mean, and leaves a gap of `missing` points.
    pub fn step(&mut self, missing: usize) {
        if self.count > 0 {
            self.points.push_back(self.sum / f64::from(self.count));
            (self.sum, self.count) = (0.0, 0);
        }
        self.points.extend(std::iter::repeat_n(f64::NAN, missing.min(POINTS)));
        let old = self.points.len().saturating_sub(POINTS);
        self.points.drain(..old);
    }

    /// The latest means, at most `count`.
    fn latest(&self, count: u16) -> impl Iterator<Item = f64> {
        let first = self.points.len().saturating_sub(count.into());
        self.points.range(first..).copied()
    }
}

/// What the screen shows.
#[derive(Clone, Debug, Default)]
pub struct MonitorView {
    pub device: String,
    pub paused: bool,
    /// The file that is being written.
    pub recording: Option<String>,
    /// Whether quantities are in g and deg/s instead of m/s² and rad/s.
    pub other_units: bool,
    pub line: Option<Line>,
    /// Standard deviation of the specific force, m/s²; `None` for an uncalibrated device.
    pub force_sd_mps2: Option<f64>,
    /// The position of `wimu navigate`, and what happened to fixes and ranges, instead of the device's.
    pub navigated: Option<(PathPoint, [Aided; 2])>,
    /// Position that counts as zero, m.
    pub origin_m: [f64; 3],
    /// |f|, then X, Y, Z.
    pub force_curves: [Curve; 4],
    pub rate_curves: [Curve; 3],
    pub links: Vec<LinkHealth>,
    pub message: String,
}

impl MonitorView {
    /// All curves: |f|, X, Y, Z of the force, then of the rate.
    pub fn curves(&mut self) -> impl Iterator<Item = &mut Curve> {
        self.force_curves.iter_mut().chain(&mut self.rate_curves)
    }
}

/// Draws the screen.
pub fn draw(view: &MonitorView, frame: &mut Frame) {
    let line = view.line.as_ref();
    let lost = view.links.iter().find(|link| link.lost.is_some());
    let recording = view.recording.as_ref().map(|file| format!("REC {file}"));
    let paused = view.paused.then(|| "PAUSED".to_owned());
    let time = match lost {
        Some(_) => Some("LINK LOST".to_owned()),
        None => line.map(|line| format!("{:.1} s", line.time_s)),
    };
    let state: Vec<String> = [paused, recording, time].into_iter().flatten().collect();
    let message = match lost.and_then(|link| link.lost.as_ref().map(|why| (&link.name, why))) {
        Some((name, why)) => widgets::lost(name, why, "Values are the last ones received"),
        None => Span::styled(view.message.clone(), STRONG),
    };
    let record = if view.recording.is_some() { "stop recording" } else { "record" };
    let pause = if view.paused { "continue" } else { "pause" };
    let first = [("q", "quit"), ("r", record), ("z", "zero"), ("u", "units")];
    let keys = [&first[..], &[("p", pause), ("c", "calibrate")]].concat();
    let body = widgets::page(frame, [&view.device, &state.join("  ")], &message, &keys);

    let rate = line.and_then(|line| line.angular_rate_rad_s);
    let (curves, boxes) = if rate.is_some() { (7, 4) } else { (4, 2) };
    // The lower panels need 9 rows.
    let rows = (body.height.saturating_sub(9 + boxes) / curves).clamp(1, MAX_ROWS);
    let heights = [2 + 4 * rows, (boxes - 2) + (curves - 4) * rows].map(Constraint::Length);
    let parts = [heights[0], heights[1], Constraint::Fill(1)];
    let [first, second, below] = Layout::vertical(parts).areas(body);
    let [force_unit, rate_unit] = match view.other_units {
        true => [("g", STANDARD_GRAVITY_MPS2.recip()), ("deg/s", 1f64.to_degrees())],
        false => [("m/s²", 1.0), ("rad/s", 1.0)],
    };
    let state = match line.is_some_and(|line| line.corrected && line.is_calibrated()) {
        true => "corrected",
        false => "nominal sensitivity",
    };
    let force = line.map(|line| {
        let [x, y, z] = line.specific_force_m_s2;
        [(x * x + y * y + z * z).sqrt(), x, y, z]
    });
    let inner =
        widgets::panel(frame, first, &format!("specific force, {} ({state})", force_unit.0));
    for (index, curve) in view.force_curves.iter().enumerate() {
        let (value, unit) = (force.map(|force| force[index]), (force_unit.1, FORCE_SPAN));
        row(frame, slice(inner, index, rows), NAMES[index], value, curve, unit);
    }
    if let Some(rate) = rate {
        let inner = widgets::panel(frame, second, &format!("angular rate, {}", rate_unit.0));
        for (index, curve) in view.rate_curves.iter().enumerate() {
            let (value, unit) = (Some(rate[index]), (rate_unit.1, RATE_SPAN));
            row(frame, slice(inner, index, rows), NAMES[1 + index], value, curve, unit);
        }
    }
    let halves = [Constraint::Fill(3), Constraint::Fill(2)];
    let [state, links] = Layout::horizontal(halves).areas(below);
    let inner = widgets::panel(frame, state, "state");
    if let Some(line) = line {
        widgets::table(frame, inner, 11, &state_rows(view, line));
    }
    let inner = widgets::panel(frame, links, "links");
    frame.render_widget(Text::from(link_rows(view)), inner);
}

/// The part of an area for curve `index`, each `rows` high.
fn slice(area: Rect, index: usize, rows: u16) -> Rect {
    let y = area.y + index as u16 * rows;
    Rect { y, height: rows, ..area }.intersection(area)
}

/// A label, the latest value, the curve and its limits, in a unit of `factor` SI units.
fn row(
    frame: &mut Frame,
    area: Rect,
    label: &str,
    value: Option<f64>,
    curve: &Curve,
    (factor, least_span): (f64, f64),
) {
    let [label_width, value_width, limits_width] = COLUMNS.map(Constraint::Length);
    let parts = [label_width, value_width, Constraint::Fill(1), limits_width];
    let [first, second, middle, last] = Layout::horizontal(parts).areas(area);
    frame.render_widget(Span::styled(format!(" {label}"), LABEL), first);
    let shown = value.map_or("-".to_owned(), |value| format!("{:+8.3}", value * factor));
    frame.render_widget(Span::styled(shown, STRONG), second);
    let points: Vec<f64> = curve.latest(middle.width).collect();
    // A mean of 100 ms lies between samples: the latest sample widens the limits.
    let bounds = widgets::bounds(points.iter().copied().chain(value), least_span);
    widgets::curve(frame, middle, &points, bounds);
    let [low, high] = bounds.map(|limit| limit * factor * 100.0);
    let (low, high) = (low.floor() / 100.0, high.ceil() / 100.0);
    frame.render_widget(Span::raw(format!(" {low:+.2} to {high:+.2}")), last);
}

fn state_rows(view: &MonitorView, line: &Line) -> Vec<(&'static str, Span<'static>)> {
    let phase = line.phase.as_deref().unwrap_or_default();
    let since_rest_s = line.since_rest_s.unwrap_or_default();
    let motion = match phase {
        "resting" => Span::styled("at rest", GOOD),
        "moving" => Span::styled(format!("moving for {since_rest_s:.1} s"), BAD),
        "searching" => Span::styled("hold it still: no rest seen yet", BAD),
        _ => Span::raw("-"),
    };
    let parameters = match &line.parameter_id {
        Some(id) if line.is_calibrated() => Span::styled(format!("{id} in use"), GOOD),
        _ => Span::styled("none: uncalibrated, press c", BAD),
    };
    // The last rows are hidden by a message of several rows.
    let mut rows = vec![("parameters", parameters), ("motion", motion)];
    let known = phase != "searching";
    let place = line.position_m.zip(line.velocity_m_s).filter(|_| known);
    let place = place.map(|(position, velocity)| {
        let note = uncertainty(line.valid, view.force_sd_mps2, since_rest_s);
        (position, velocity, note)
    });
    let navigated = view.navigated.map(|(point, aided)| {
        let note = navigated_note(&point, aided);
        (point.position_m, point.velocity_mps, note)
    });
    if let Some((position, velocity, note)) = navigated.or(place) {
        let from_origin = [0, 1, 2].map(|axis| position[axis] - view.origin_m[axis]);
        let text = format!("{} m", east_north_up(from_origin));
        rows.push(("position", text.into()));
        rows.push(("", note));
        let text = format!("{} m/s", east_north_up(velocity));
        rows.push(("velocity", text.into()));
    }
    if let Some([roll, pitch, yaw]) = line.quaternion.map(euler_deg) {
        let text = format!("roll {roll:+.0}°  pitch {pitch:+.0}°  yaw {yaw:+.0}°");
        rows.push(("attitude", text.into()));
    }
    if let Some([x, y, z]) = line.magnetic_field_ut {
        let calibrated = line.magnetic_field_calibrated == Some(true);
        let note = if calibrated { "" } else { ", uncalibrated" };
        rows.push(("magnetic", format!("{x:+.1} {y:+.1} {z:+.1} µT{note}").into()));
    }
    // In seven rows the heading and the temperature share one.
    let heading = line.heading_deg.map(|heading| match line.heading_sd_deg {
        Some(sd) => format!("heading {heading:.0}° ± {sd:.0}°"),
        None => format!("heading {heading:.0}°, relative"),
    });
    let celsius = line.temperature_c.map(|celsius| format!("{celsius:.1} °C"));
    let both: Vec<String> = [celsius, heading].into_iter().flatten().collect();
    rows.push(("temperature", both.join(", ").into()));
    rows
}

/// Standard deviation of a position of the filter, and the use of fixes and ranges.
fn navigated_note(point: &PathPoint, aided: [Aided; 2]) -> Span<'static> {
    let mut text = format!("± {} m", significant(point.sd_m(), 2));
    for (kind, aided) in ["fixes", "ranges"].into_iter().zip(aided) {
        let left_out = aided.rejected + aided.late;
        if aided.used + left_out > 0 {
            text += &format!("; {} {kind} used, {left_out} not", aided.used);
        }
    }
    match point.valid {
        true => text.into(),
        false => Span::styled(format!("not valid, {text}"), BAD),
    }
}

/// Standard deviation of the position `t` after a rest and time until it reaches 1 m: that of a constant acceleration.
fn uncertainty(valid: Option<bool>, force_sd_mps2: Option<f64>, t: f64) -> Span<'static> {
    match (valid, force_sd_mps2) {
        (Some(false), _) => Span::styled("invalid: it rotated, or data were lost", BAD),
        (_, Some(force_sd)) => {
            let sd = significant(0.5 * force_sd * t * t, 2);
            let left = ((2.0 * VALID_SD_M / force_sd).sqrt() - t).max(0.0);
            format!("± {sd} m, below {VALID_SD_M:.0} m for {left:.1} s").into()
        }
        _ => Span::styled("± unknown: uncalibrated", BAD),
    }
}

fn link_rows(view: &MonitorView) -> Vec<Row<'static>> {
    let row = |label: &str, text: &dyn Fn(&LinkHealth) -> String| {
        let mut spans = vec![Span::styled(format!("{label:9}"), LABEL)];
        spans.extend(view.links.iter().map(|link| Span::raw(format!("{:>10}", text(link)))));
        Row::from(spans)
    };
    let latency = |link: &LinkHealth, which: usize| {
        let text = |ms: [f64; 2]| format!("{} ms", significant(ms[which], 3));
        link.latency_ms.map_or("-".to_owned(), text)
    };
    let mut rows = vec![
        row("", &|link| link.name.clone()),
        row("rate Hz", &|link| significant(link.rate_hz, 4)),
        row("loss %", &|link| significant(100.0 * link.loss, 3)),
        row("latency", &|link| latency(link, 0)),
        row("largest", &|link| latency(link, 1)),
        row("kB/s", &|link| significant(link.kilobytes_s, 3)),
    ];
    rows.push(row("damaged", &|link| match &link.lost {
        Some(_) => "lost".to_owned(),
        None => link.frames_damaged.to_string(),
    }));
    rows
}
