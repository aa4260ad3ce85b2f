//! Charts: one description, drawn as SVG and by the script of a [report](crate::html).

mod data;
mod svg;

use std::path::{Path, PathBuf};

use crate::stats::median;
use crate::{OutputFile, Problem, Result};

/// Writes every chart as SVG under its name into a folder, created if necessary; returns the files.
///
/// # Errors
/// `file_failed`, `file_unreadable`.
pub fn write_all(folder: &Path, charts: &[(&str, Chart)]) -> Result<Vec<PathBuf>> {
    std::fs::create_dir_all(folder)
        .map_err(|error| Problem::file(&folder.display().to_string(), "create", &error))?;
    let mut files = Vec::new();
    for (name, chart) in charts {
        let file = folder.join(name).with_extension("svg");
        OutputFile::write(&file, chart.svg())?;
        files.push(file);
    }
    Ok(files)
}

/// How a [`Series`] is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Style {
    /// A line.
    #[default]
    Line,
    /// Points.
    Dots,
    /// A thin grey line that neither extends the range of the chart nor shows its values: a limit, an outline.
    Guide,
}

/// A line, or points, in a [`Chart`].
#[derive(Clone, Debug, Default)]
pub struct Series {
    /// Its name in the legend; empty: not in the legend.
    pub name: String,
    /// x and y.
    pub points: Vec<(f64, f64)>,
    /// Third coordinate of each point in a chart of space, otherwise empty.
    pub z: Vec<f64>,
    /// Time of each point, s, where neither axis is the time; empty: not shown.
    pub times_s: Vec<f64>,
    /// Text beside each point; empty: none.
    pub labels: Vec<String>,
    /// How it is drawn.
    pub style: Style,
}

impl Series {
    /// A line.
    pub fn line(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.to_owned(), points, ..Self::default() }
    }

    /// Points.
    pub fn dots(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self { style: Style::Dots, ..Self::line(name, points) }
    }

    /// A guide.
    pub fn guide(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self { style: Style::Guide, ..Self::line(name, points) }
    }

    /// The same in space: a line, or what `style` says.
    pub fn space(name: &str, style: Style, points: &[[f64; 3]]) -> Self {
        Self {
            z: points.iter().map(|point| point[2]).collect(),
            style,
            ..Self::line(name, points.iter().map(|p| (p[0], p[1])).collect())
        }
    }
}

/// A chart of some series over one x axis, in a plane, or in space.
#[derive(Clone, Debug, Default)]
pub struct Chart {
    /// Its title.
    pub title: String,
    /// The x axis with its unit.
    pub x: String,
    /// The y axis with its unit.
    pub y: String,
    /// The z axis with its unit; empty in a plane.
    pub z: String,
    /// Logarithmic x axis; values must be positive.
    pub log_x: bool,
    /// Logarithmic y axis; values must be positive.
    pub log: bool,
    /// Equal scales of all axes; always so in space.
    pub equal: bool,
    /// Range of x; `None` for that of the data without guides.
    pub x_range: Option<(f64, f64)>,
    /// Range of y; `None` for that of the data without guides.
    pub y_range: Option<(f64, f64)>,
    /// The series.
    pub series: Vec<Series>,
    /// Confidence bands.
    pub bands: Vec<Band>,
    /// Intervals of x marked in grey.
    pub marked: Vec<(f64, f64)>,
    /// Remark below the chart in a report.
    pub note: String,
}

impl Chart {
    /// A chart in a plane: its title, its axes with their units, and its series.
    pub fn new(title: impl Into<String>, x: &str, y: &str, series: Vec<Series>) -> Self {
        Self { title: title.into(), x: x.to_owned(), y: y.to_owned(), series, ..Self::default() }
    }
}

/// Confidence band of a series of a [`Chart`].
#[derive(Clone, Debug)]
pub struct Band {
    /// Index of the series.
    pub series: usize,
    /// x, lowest y and highest.
    pub points: Vec<(f64, f64, f64)>,
}

/// Points of a line with a break at each step in x of more than twice the median step.
pub fn broken(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let steps = (points.windows(2)).map(|pair| pair[1].0 - pair[0].0);
    let Some(usual) = median(steps) else {
        return points;
    };
    let mut broken = Vec::with_capacity(points.len());
    for point in points {
        if let Some((x, _)) = broken.last().copied().filter(|(x, _)| point.0 - x > 2.0 * usual) {
            broken.push((x, f64::NAN));
        }
        broken.push(point);
    }
    broken
}
