//! The screen of a guided calibration.

use ratatui::layout::{Alignment, Constraint, Layout, Rect};
use ratatui::prelude::{Frame, Span};
use ratatui::text::Line;
use ratatui::widgets::Paragraph;
use wimu_host::digits::significant;
use wimu_host::guided::{GuidedView, Hold, Uncertainty};
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::board;
use super::widgets::{self, BAD, GOOD, STRONG};
use crate::output::wrapped;

/// Largest tilt from the next orientation that counts as reached, degrees. Chosen: any orientation is accepted.
const REACHED_DEG: f64 = 10.0;
/// Smallest height of the curve of uncertainties, powers of ten.
const UNCERTAINTY_SPAN: f64 = 0.5;

/// Draws the screen; the result from `first_line` on.
pub fn draw(view: &GuidedView, first_line: u16, frame: &mut Frame) {
    let title = format!("wimu calibrate  {}", view.device);
    let count = format!("pose {} of {}", view.poses.len(), view.wanted);
    let message = match &view.lost {
        Some(why) => widgets::lost("the board", why, "Poses are kept"),
        None => Span::styled(view.message.clone(), STRONG),
    };
    let push = if view.pushed { "push again" } else { "push to the board" };
    let of_result =
        [("p", push), ("w", "write a file"), ("m", "more poses"), ("↑↓", "scroll"), ("q", "quit")];
    let of_poses = [
        ("r", "resume the interrupted session"),
        ("u", "undo"),
        ("s", "skip"),
        ("Enter", "finish now"),
        ("q", "quit, poses are kept"),
    ];
    let keys = match &view.result {
        Some(_) => &of_result[if view.usable { 0 } else { 2 }..],
        None => &of_poses[usize::from(!view.resumable)..],
    };
    let body = widgets::page(frame, [&title, &count], &message, keys);
    if let Some(text) = &view.result {
        return result(view, frame, body, text, first_line);
    }
    let pictures = body.height.saturating_sub(10);
    let rows = [pictures, 4, 6].map(Constraint::Length);
    let [above, guide, below] = Layout::vertical(rows).areas(body);
    three_pictures(view, frame, above);
    guidance(view, frame, guide);
    uncertainties(view, frame, below);
}

fn result(view: &GuidedView, frame: &mut Frame, area: Rect, text: &str, first: u16) {
    let title = match (view.usable, view.pushed) {
        (false, _) => "no calibration yet: capture more poses",
        (_, false) => "calibrated: p pushes it to the board",
        (_, true) => "calibrated and pushed: the board corrects its samples now",
    };
    let inner = widgets::panel(frame, area, title);
    frame.render_widget(
        Paragraph::new(wrapped(text, Some(inner.width.into()))).scroll((first, 0)),
        inner,
    );
}

fn three_pictures(view: &GuidedView, frame: &mut Frame, area: Rect) {
    let [next, now, done] = Layout::horizontal([Constraint::Fill(1); 3]).areas(area);
    let inner = widgets::panel(frame, next, "next: hold it like this");
    if let Some(up) = view.next {
        board::board(frame, inner, up, up, &view.sides);
    }
    let inner = widgets::panel(frame, now, "now");
    if let Some(up) = view.up {
        board::board(frame, inner, up, view.next.unwrap_or(up), &view.sides);
    }
    let inner = widgets::panel(frame, done, "poses ●, next N, now +");
    let legend = Line::from(" behind the sphere: · n ").alignment(Alignment::Right);
    let bottom = Rect {
        y: done.bottom().saturating_sub(1),
        x: done.x + 1,
        height: 1,
        width: done.width.saturating_sub(2),
    };
    frame.render_widget(legend, bottom.intersection(done));
    board::sphere(frame, inner, &view.poses, view.up, view.next);
}

/// The instruction, the tilt from the next orientation and the countdown.
fn guidance(view: &GuidedView, frame: &mut Frame, area: Rect) {
    let [words, more, tilt, hold] = Layout::vertical([Constraint::Length(1); 4]).areas(area);
    frame.render_widget(Line::from(Span::styled(format!(" {}", view.instruction), STRONG)), words);
    let any = " Any other orientation serves as well: hold the board still until the bell.";
    frame.render_widget(Line::from(any), more);
    if let (Some(up), Some(next)) = (view.up, view.next) {
        let angle = board::angle_deg(up, next);
        let (text, style) = match angle <= REACHED_DEG {
            true => (format!("{angle:.0}° from it: reached"), GOOD),
            false => {
                let side = view.sides[board::side_to_raise(up, next)];
                (format!("{angle:.0}° from it: tilt it towards {side}"), BAD)
            }
        };
        widgets::bar(frame, inset(tilt), 1.0 - angle / 180.0, &text, style);
    }
    let (fraction, text, style) = match view.hold {
        Hold::Waiting => (0.0, "waiting for samples".to_owned(), BAD),
        Hold::Moving => (0.0, "moving: hold it still".to_owned(), BAD),
        Hold::Holding(so_far, whole) => {
            let left = (whole - so_far).max(0.0);
            (so_far / whole, format!("still: {left:.1} s more"), GOOD)
        }
        Hold::Captured => (1.0, "captured: turn it to the next orientation".to_owned(), GOOD),
    };
    widgets::bar(frame, inset(hold), fraction, &text, style);
}

fn inset(area: Rect) -> Rect {
    Rect { x: area.x + 1, width: area.width.saturating_sub(2), ..area }
}

/// Uncertainty of bias and scale factor, and its course from pose to pose.
fn uncertainties(view: &GuidedView, frame: &mut Frame, area: Rect) {
    let latest = view.uncertainty.last();
    let title = match latest.is_some_and(|latest| latest.no_fit.is_none()) {
        true => "standard deviation of the fit",
        false => "expected standard deviation: not a result yet",
    };
    let inner = widgets::panel(frame, area, title);
    let Some(latest) = latest else { return };
    let line = |y: u16| Rect { y: inner.y + y, height: 1, ..inner }.intersection(inner);
    let milli_g = |mps2: f64| mps2 * 1e3 / STANDARD_GRAVITY_MPS2;
    let percent = |of_1: f64| of_1 * 100.0;
    let bias = |of: &Uncertainty| of.bias_mps2.map(milli_g);
    let scale = |of: &Uncertainty| of.scale.map(percent);
    type Axes<'a> = &'a dyn Fn(&Uncertainty) -> [f64; 3];
    let rows: [(&str, &str, Axes); 2] = [("bias", "mg", &bias), ("scale factor", "%", &scale)];
    for (y, (name, unit, axes)) in [0, 2].into_iter().zip(rows) {
        let parts = [Constraint::Length(52), Constraint::Fill(1)];
        let [text, curve] = Layout::horizontal(parts).areas(line(y));
        let [x, y, z] = axes(latest).map(|axis| significant(axis, 2));
        let text_of = Line::from(format!(" {name:13} ± {x} X, {y} Y, {z} Z {unit}"));
        frame.render_widget(text_of, text);
        let width = usize::from(curve.width) / view.uncertainty.len();
        let worst = |of: &Uncertainty| axes(of).into_iter().fold(0.0, f64::max).log10();
        let wide: Vec<f64> = (view.uncertainty.iter().map(worst))
            .flat_map(|value| std::iter::repeat_n(value, width.clamp(1, 3)))
            .collect();
        let first = wide.len().saturating_sub(curve.width.into());
        let shown = &wide[first..];
        let bounds = widgets::bounds(shown.iter().copied(), UNCERTAINTY_SPAN);
        let curve = Rect { width: shown.len() as u16, ..curve };
        widgets::curve(frame, curve, shown, bounds);
    }
    if let Some(why) = &latest.no_fit {
        let text = format!(" no fit yet: {why}");
        frame.render_widget(Line::from(Span::styled(text, BAD)), line(3));
    }
}
