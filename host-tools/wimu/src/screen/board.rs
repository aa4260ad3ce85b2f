//! Drawings of a board as it is held, and of poses on a sphere.

use ratatui::layout::Rect;
use ratatui::prelude::Frame;
use ratatui::style::Color;
use ratatui::symbols::Marker;
use ratatui::widgets::canvas::{Canvas, Circle, Context, Line, Points};

/// Half the length of a board along its axes, of the drawing's unit.
const HALF: [f64; 3] = [0.75, 0.5, 0.06];
/// Length of an axis from the centre.
const AXIS: f64 = 1.0;
/// Elevation of the viewer, rad: 25°.
const ELEVATION: f64 = 0.436;
/// Azimuth of the viewer, rad: −35°.
const AZIMUTH: f64 = -0.611;
/// Width of a terminal's cell over its height.
const CELL: f64 = 0.5;

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3])
}

/// Angle between two unit vectors, degrees.
pub fn angle_deg(a: [f64; 3], b: [f64; 3]) -> f64 {
    let c = cross(a, b);
    dot(c, c).sqrt().atan2(dot(a, b)).to_degrees()
}

/// The side of the board to raise so that `up` becomes `wanted`: index in the order X up, X down, Y up, ….
pub fn side_to_raise(up: [f64; 3], wanted: [f64; 3]) -> usize {
    let along = dot(up, wanted);
    let missing = [0, 1, 2].map(|k| wanted[k] - along * up[k]);
    let largest = (0..3).max_by(|a, b| missing[*a].abs().total_cmp(&missing[*b].abs()));
    let axis = largest.unwrap_or(0);
    2 * axis + usize::from(missing[axis] < 0.0)
}

/// Rotates `v` from body axes to axes with z up, by the shortest rotation that raises `up`.
fn raised(v: [f64; 3], up: [f64; 3]) -> [f64; 3] {
    let vertical = [0.0, 0.0, 1.0];
    let cosine = dot(up, vertical);
    // Upside down: half a turn about x.
    if cosine < -0.999_999 {
        return [v[0], -v[1], -v[2]];
    }
    let axis = cross(up, vertical);
    let [a, b] = [cross(axis, v), cross(axis, cross(axis, v))];
    [0, 1, 2].map(|k| v[k] + a[k] + b[k] / (1.0 + cosine))
}

/// Where the viewer sees a point, and how near it is.
fn seen([x, y, z]: [f64; 3]) -> (f64, f64, f64) {
    let (sin, cos) = AZIMUTH.sin_cos();
    let (right, away) = (x * cos - y * sin, x * sin + y * cos);
    let (sin, cos) = ELEVATION.sin_cos();
    (right, z * cos + away * sin, z * sin - away * cos)
}

/// The canvas of a drawing within ±`half` vertically, with equal scales.
fn canvas<F: Fn(&mut Context)>(frame: &mut Frame, area: Rect, half: f64, paint: F) {
    let wide = half * CELL * f64::from(area.width) / f64::from(area.height.max(1));
    let canvas = Canvas::default().marker(Marker::Braille).paint(paint);
    frame.render_widget(canvas.x_bounds([-wide, wide]).y_bounds([-half, half]), area);
}

/// Draws a board with its axes as it is held with the unit vector `up` upward, and the names of the sides that the
/// axes point to. It is turned by the shortest rotation from the drawing with `like` upward, so that both look alike
/// when it is held alike.
pub fn board(frame: &mut Frame, area: Rect, up: [f64; 3], like: [f64; 3], sides: &[&str; 6]) {
    let vertical = raised(up, like);
    canvas(frame, area, 1.25, |context| {
        let at = |v: [f64; 3]| seen(raised(raised(v, like), vertical));
        let line = |from: [f64; 3], to: [f64; 3], color| {
            let ((x1, y1, _), (x2, y2, _)) = (at(from), at(to));
            Line { x1, y1, x2, y2, color }
        };
        let corner =
            |signs: usize| [0, 1, 2].map(|k| if signs >> k & 1 == 1 { HALF[k] } else { -HALF[k] });
        for from in 0..8_usize {
            for axis in (0..3).filter(|axis| from >> axis & 1 == 0) {
                context.draw(&line(corner(from), corner(from | 1 << axis), Color::Reset));
            }
        }
        context.layer();
        for (axis, color) in [Color::Red, Color::Green, Color::Blue].into_iter().enumerate() {
            let mut tip = [0.0; 3];
            tip[axis] = AXIS;
            context.draw(&line([0.0; 3], tip, color));
            let (x, y, _) = at(tip.map(|c| 1.12 * c));
            let name = sides[2 * axis].trim_end_matches(" up");
            let name = if name.len() > 1 {
                format!("{}:{name}", ["X", "Y", "Z"][axis])
            } else {
                name.to_owned()
            };
            // Left of the tip where it points to the left.
            let shift = if x < 0.0 { 0.07 * (name.len() - 1) as f64 } else { 0.0 };
            context.print(x - shift, y, name);
        }
    });
}

/// Draws a sphere with the directions of captured poses, of the present one and of the next. Poses behind it are
/// small.
pub fn sphere(
    frame: &mut Frame,
    area: Rect,
    poses: &[[f64; 3]],
    present: Option<[f64; 3]>,
    next: Option<[f64; 3]>,
) {
    canvas(frame, area, 1.15, |context| {
        context.draw(&Circle { x: 0.0, y: 0.0, radius: 1.0, color: Color::DarkGray });
        let round = |k: u32| f64::from(k) / 60.0 * std::f64::consts::TAU;
        let equator: Vec<(f64, f64)> = (0..60)
            .map(|k| seen([round(k).cos(), round(k).sin(), 0.0]))
            .filter(|(.., near)| *near > 0.0)
            .map(|(x, y, _)| (x, y))
            .collect();
        context.draw(&Points { coords: &equator, color: Color::DarkGray });
        context.layer();
        let mut mark = |v: [f64; 3], front: &'static str, behind: &'static str| {
            let (x, y, near) = seen(v);
            context.print(x, y, if near >= 0.0 { front } else { behind });
        };
        for pose in poses {
            mark(*pose, "●", "·");
        }
        if let Some(next) = next {
            mark(next, "N", "n");
        }
        if let Some(present) = present {
            mark(present, "+", "+");
        }
    });
}
