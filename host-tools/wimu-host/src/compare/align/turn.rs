//! How the axes of two devices stand to each other.

use serde::Serialize;
use wimu_calib::{Line, Transfer};

type Matrix = [[f64; 3]; 3];

/// Steps of the polar decomposition: it doubles its digits with each.
const STEPS: usize = 12;
/// An element is moved by this to see what moves with it.
const SMALL: f64 = 1e-6;

/// The rotation that leads from the reference's axes to those of the other: the nearest, where these are
/// not quite at right angles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Turn {
    /// Its angle, degrees.
    pub angle_deg: f64,
    /// Standard deviation of the angle.
    pub angle_sd_deg: f64,
    /// Rotation vector, degrees: what the reference shows, turned by it, is what the other shows.
    pub vector_deg: [f64; 3],
}

impl Turn {
    /// `None` where not all axes moved so that each shows what it sees of the others.
    pub(super) fn of(found: &Transfer) -> Option<Self> {
        let mut rows = [[0.0; 3]; 3];
        let mut variance = 0.0;
        for (row, axis) in rows.iter_mut().zip(&found.axes) {
            let line = axis.line.filter(|line| line.fitted == [true; 3])?;
            *row = line.row;
        }
        let vector = rotation_vector(&rows)?;
        let angle = size(&vector);
        for (index, axis) in found.axes.iter().enumerate() {
            let mut gradient = [0.0; 3];
            for (column, gradient) in gradient.iter_mut().enumerate() {
                let mut moved = rows;
                moved[index][column] += SMALL;
                *gradient = (size(&rotation_vector(&moved)?) - angle) / SMALL;
            }
            variance += axis.line.map_or(0.0, |line| of_row(&line, gradient));
        }
        Some(Self {
            angle_deg: angle.to_degrees(),
            angle_sd_deg: variance.max(0.0).sqrt().to_degrees(),
            vector_deg: vector.map(f64::to_degrees),
        })
    }
}

/// What the other's axis shows per m/s² along itself, whichever way it points, and its standard deviation:
/// the length of what it sees of the reference's axes.
pub(super) fn scale_along_itself(line: &Line) -> [f64; 2] {
    let scale = size(&line.row);
    let variance = of_row(line, line.row.map(|seen| seen / scale));
    // A length is made longer by noise across it.
    let longer = (1..4).map(|k| line.covariance[k][k]).sum::<f64>() / (2.0 * scale);
    [scale, variance.max(0.0).sqrt().hypot(longer)]
}

/// Variance of what changes by this much with each element of the row.
fn of_row(line: &Line, gradient: [f64; 3]) -> f64 {
    let terms = (0..9).map(|k| (k / 3, k % 3));
    terms
        .map(|(i, j)| gradient[i] * line.covariance[1 + i][1 + j] * gradient[j])
        .sum()
}

fn size(v: &[f64; 3]) -> f64 {
    super::signal::norm(v)
}

fn cross(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [1, 2, 0].map(|i: usize| {
        let j = (i + 1) % 3;
        a[i] * b[j] - a[j] * b[i]
    })
}

/// Of the rotation nearest to the rows, each brought to length 1; `None` where they make none.
fn rotation_vector(rows: &Matrix) -> Option<[f64; 3]> {
    let mut turn = rows.map(|row| row.map(|seen| seen / size(&row)));
    for _ in 0..STEPS {
        // Newton's: the mean of the matrix and the transpose of its inverse.
        let [x, y, z] = &turn;
        let cofactors = [cross(y, z), cross(z, x), cross(x, y)];
        let volume: f64 = (0..3).map(|k| x[k] * cofactors[0][k]).sum();
        if volume.is_nan() || volume < 0.1 {
            return None;
        }
        turn = [0, 1, 2].map(|i| [0, 1, 2].map(|j| 0.5 * (turn[i][j] + cofactors[i][j] / volume)));
    }
    let sine = [(2, 1), (0, 2), (1, 0)].map(|(i, j)| 0.5 * (turn[i][j] - turn[j][i]));
    let cosine = 0.5 * (turn[0][0] + turn[1][1] + turn[2][2] - 1.0);
    let of_axis = size(&sine);
    let angle = of_axis.atan2(cosine);
    Some(sine.map(|v| v * angle / of_axis.max(f64::MIN_POSITIVE)))
}
