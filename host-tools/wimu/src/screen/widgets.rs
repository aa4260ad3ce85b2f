//! Parts that screens are made of.

use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::prelude::{Frame, Line, Modifier, Span, Style};
use ratatui::style::Color;
use ratatui::text::Text;
use ratatui::widgets::{Block, Gauge, Paragraph, Sparkline, Wrap};

/// Style of what counts most.
pub const STRONG: Style = Style::new().add_modifier(Modifier::BOLD);
/// Styles of a good state, of one that needs attention, and of labels.
pub const GOOD: Style = Style::new().fg(Color::Green).add_modifier(Modifier::BOLD);
pub const BAD: Style = Style::new().fg(Color::Yellow).add_modifier(Modifier::BOLD);
pub const LABEL: Style = Style::new().fg(Color::Cyan);

/// The frame's header, body, message line and keys.
pub fn page(frame: &Frame) -> [Rect; 4] {
    let rows = [1, 0, 1, 1].map(|rows| match rows {
        0 => Constraint::Fill(1),
        rows => Constraint::Length(rows),
    });
    Layout::vertical(rows).areas(frame.area())
}

/// A line across the screen in reverse.
pub fn header(frame: &mut Frame, area: Rect, left: &str, right: &str) {
    let bar = Style::new().add_modifier(Modifier::REVERSED);
    let parts = [
        Constraint::Fill(1),
        Constraint::Length(right.chars().count() as u16 + 2),
    ];
    let [first, last] = Layout::horizontal(parts).areas(area);
    frame.render_widget(Paragraph::new(format!(" {left}")).style(bar), first);
    frame.render_widget(Paragraph::new(format!(" {right} ")).style(bar), last);
}

/// Keys with what they do; those that do not fit are left out.
pub fn keys(frame: &mut Frame, area: Rect, keys: &[(&str, &str)]) {
    let mut spans = Vec::new();
    for (key, does) in keys {
        spans.push(Span::styled(
            format!(" {key} "),
            Style::new().add_modifier(Modifier::REVERSED),
        ));
        spans.push(Span::raw(format!(" {does}  ")));
    }
    frame.render_widget(Line::from(spans), area);
}

/// A box with a title; returns its inner area.
pub fn panel(frame: &mut Frame, area: Rect, title: &str) -> Rect {
    let block = Block::bordered().title(Span::styled(format!(" {title} "), STRONG));
    let inner = block.inner(area);
    frame.render_widget(block, area);
    inner
}

/// Labels of this width, each with its text.
pub fn table(frame: &mut Frame, area: Rect, width: usize, rows: &[(&str, Span<'static>)]) {
    let line = |(label, text): &(&str, Span<'static>)| {
        Line::from(vec![
            Span::styled(format!("{label:width$} "), LABEL),
            text.clone(),
        ])
    };
    let lines: Vec<Line> = rows.iter().map(line).collect();
    frame.render_widget(Text::from(lines), area);
}

/// A bar of `fraction`, 0 to 1, with a text in it.
pub fn bar(frame: &mut Frame, area: Rect, fraction: f64, text: &str, style: Style) {
    let gauge = Gauge::default().ratio(if fraction > 0.0 {
        fraction.min(1.0)
    } else {
        0.0
    });
    frame.render_widget(gauge.label(text).gauge_style(style).use_unicode(true), area);
}

/// The latest values as a curve from their smallest to their largest; `least_span` is the smallest height of it.
pub fn curve(
    frame: &mut Frame,
    area: Rect,
    values: impl DoubleEndedIterator<Item = f64>,
    least_span: f64,
) {
    const STEPS: f64 = 1000.0;
    let mut values: Vec<f64> = values.rev().take(area.width.into()).collect();
    values.reverse();
    let [low, high] = bounds(values.iter().copied(), least_span);
    let step = |value: &f64| ((value - low) / (high - low) * STEPS) as u64 + 1;
    let data: Vec<u64> = values.iter().map(step).collect();
    let width = data.len() as u16;
    let area = Rect {
        x: area.right() - width,
        width,
        ..area
    };
    frame.render_widget(Sparkline::default().data(data).max(STEPS as u64 + 1), area);
}

/// The smallest and the largest value, at least `least_span` apart.
pub fn bounds(values: impl Iterator<Item = f64>, least_span: f64) -> [f64; 2] {
    let within = |[low, high]: [f64; 2], value: f64| [low.min(value), high.max(value)];
    let [low, high] = values.fold([f64::INFINITY, f64::NEG_INFINITY], within);
    if low > high {
        return [-0.5 * least_span, 0.5 * least_span];
    }
    let wider = (0.5 * (least_span - (high - low))).max(0.0);
    [low - wider, high + wider]
}

/// Says that the terminal is too small for a screen of `least` columns and rows.
pub fn too_small(frame: &mut Frame, least: (u16, u16)) {
    let area = frame.area();
    let (have, need) = ((area.width, area.height), least);
    let text = format!(
        "terminal too small: {}x{}, need {}x{}. Enlarge it; q quits",
        have.0, have.1, need.0, need.1
    );
    frame.render_widget(Paragraph::new(text).wrap(Wrap { trim: true }), area);
}
