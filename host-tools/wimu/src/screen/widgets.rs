//! Parts that screens are made of.

use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::prelude::{Frame, Line, Modifier, Span, Style};
use ratatui::style::Color;
use ratatui::text::Text;
use ratatui::widgets::{Block, Gauge, Paragraph, Sparkline, Wrap};

use crate::output::wrapped;

/// Style of what counts most.
pub const STRONG: Style = Style::new().add_modifier(Modifier::BOLD);
/// Styles of a good state, of one that needs attention, and of labels.
pub const GOOD: Style = Style::new().fg(Color::Green).add_modifier(Modifier::BOLD);
pub const BAD: Style = Style::new().fg(Color::Yellow).add_modifier(Modifier::BOLD);
pub const LABEL: Style = Style::new().fg(Color::Cyan);

/// Most rows of a message.
const MESSAGE_ROWS: usize = 3;

/// Draws the header (title and state), the message, which wraps, and the keys; returns the area between them.
pub fn page(
    frame: &mut Frame,
    [title, state]: [&str; 2],
    message: &Span,
    keys: &[(&str, &str)],
) -> Rect {
    let width = usize::from(frame.area().width).saturating_sub(2);
    let text = wrapped(&message.content, Some(width));
    let lines: Vec<Line> = text
        .lines()
        .take(MESSAGE_ROWS)
        .map(|line| Line::from(format!(" {}", line.trim_start())))
        .collect();
    let [first, body, middle, last] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Fill(1),
        Constraint::Length(lines.len().max(1) as u16),
        Constraint::Length(1),
    ])
    .areas(frame.area());
    let bar = Style::new().add_modifier(Modifier::REVERSED);
    let parts = [Constraint::Fill(1), Constraint::Length(state.chars().count() as u16 + 2)];
    let [left, right] = Layout::horizontal(parts).areas(first);
    frame.render_widget(Paragraph::new(format!(" {title}")).style(bar), left);
    frame.render_widget(Paragraph::new(format!(" {state} ")).style(bar), right);
    frame.render_widget(Paragraph::new(lines).style(message.style), middle);
    let keys = keys.iter().flat_map(|(key, does)| {
        let key = Span::styled(format!(" {key} "), bar);
        [key, Span::raw(format!(" {does}  "))]
    });
    frame.render_widget(Line::from_iter(keys), last);
    body
}

/// A message that a link is lost, what that means for what is `shown`, and what to do.
pub fn lost(link: &str, why: &str, shown: &str) -> Span<'static> {
    let text = format!(
        "LINK LOST: {link} ({why}). {shown}. Check power, cable and range: wimu reconnects by itself. q quits"
    );
    Span::styled(text, BAD.add_modifier(Modifier::REVERSED))
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
        Line::from(vec![Span::styled(format!("{label:width$} "), LABEL), text.clone()])
    };
    let lines: Vec<Line> = rows.iter().map(line).collect();
    frame.render_widget(Text::from(lines), area);
}

/// A bar of `fraction`, 0 to 1, with a text in it.
pub fn bar(frame: &mut Frame, area: Rect, fraction: f64, text: &str, style: Style) {
    let gauge = Gauge::default().ratio(if fraction > 0.0 { fraction.min(1.0) } else { 0.0 });
    frame.render_widget(gauge.label(text).gauge_style(style).use_unicode(true), area);
}

/// Values as a curve within `bounds`, as far right as they reach, with a gap where they are no numbers.
pub fn curve(frame: &mut Frame, area: Rect, values: &[f64], [low, high]: [f64; 2]) {
    const STEPS: f64 = 1000.0;
    let step = |value: &f64| {
        value.is_finite().then_some(((value - low) / (high - low) * STEPS) as u64 + 1)
    };
    let data: Vec<Option<u64>> = values.iter().map(step).collect();
    let width = data.len() as u16;
    let area = Rect { x: area.right().saturating_sub(width), width, ..area };
    let area = area.intersection(frame.area());
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
