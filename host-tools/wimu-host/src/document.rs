//! Documents: what a result says, as text and as an HTML page.
//!
//! ```
//! use wimu_host::document::Document;
//!
//! let mut document = Document::new("Noise of rest.csv");
//! document.result("rest.csv: 449 s at 100 Hz").table(
//!     "Noise",
//!     &["axis", "density, µg/√Hz"],
//!     &[vec!["X".into(), "401 ± 2".into()]],
//! );
//! assert_eq!(
//!     document.to_string(),
//!     "rest.csv: 449 s at 100 Hz\n  axis  density, µg/√Hz\n  X     401 ± 2"
//! );
//! ```

pub mod html;

use std::fmt;
use std::path::Path;

use serde::Serialize;

use crate::chart::Chart;
use crate::{OutputFile, Problem, Result};

/// Rows of a table that is not folded on a page, and that is part of the text.
const OPEN_ROWS: usize = 12;

/// A result whose JSON, text and page have the same fields.
pub trait ToDocument: Serialize {
    /// What it says.
    fn document(&self) -> Document;
}

/// A document: the result, key figures and problems, then tables and charts.
///
/// Its `Display` is the text for a terminal: results, key figures and short tables. Problems are printed by
/// [`problem::text`](crate::problem::text).
#[derive(Clone, Debug, Default)]
pub struct Document {
    title: String,
    results: Vec<String>,
    figures: Vec<(String, String)>,
    parts: Vec<Part>,
    problems: Vec<Problem>,
    printed: Vec<String>,
}

#[derive(Clone, Debug)]
enum Part {
    Table { name: String, rows: Vec<Vec<String>> },
    Chart(Box<Chart>),
}

impl Document {
    /// An empty document.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), ..Self::default() }
    }

    /// A result as a sentence.
    pub fn result(&mut self, text: &str) -> &mut Self {
        self.results.push(text.to_owned());
        self
    }

    /// A key figure with its unit.
    pub fn key(&mut self, name: &str, value: &str) -> &mut Self {
        self.figures.push((name.to_owned(), value.to_owned()));
        self
    }

    /// Text that the command prints beside the document.
    pub fn printed(&mut self, text: &str) -> &mut Self {
        self.printed.push(text.to_owned());
        self
    }

    /// All findings, if there are any: on a page warnings with the result, and all of them folded.
    pub fn findings(&mut self, findings: &[Problem]) -> &mut Self {
        self.problems.extend_from_slice(findings);
        self
    }

    /// A table with a header row; a long one is folded.
    pub fn table(&mut self, name: &str, head: &[&str], rows: &[Vec<String>]) -> &mut Self {
        let head = head.iter().map(|cell| (*cell).to_owned()).collect();
        let rows = [head].into_iter().chain(rows.iter().cloned()).collect();
        self.parts.push(Part::Table { name: name.to_owned(), rows });
        self
    }

    /// A chart.
    pub fn chart(&mut self, chart: &Chart) -> &mut Self {
        self.parts.push(Part::Chart(Box::new(chart.clone())));
        self
    }

    /// Writes the page, replacing an existing file.
    ///
    /// # Errors
    /// `file_failed`, `file_unreadable`.
    pub fn write(&self, path: &Path) -> Result<()> {
        OutputFile::write(path, self.page())
    }
}

impl fmt::Display for Document {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut lines = self.results.clone();
        lines.extend(self.figures.iter().map(|(name, value)| format!("  {name}: {value}")));
        for part in &self.parts {
            if let Part::Table { rows, .. } = part
                && rows.len() <= OPEN_ROWS + 1
            {
                lines.extend(aligned(rows));
            }
        }
        out.write_str(&lines.join("\n"))
    }
}

/// Rows with their columns below each other.
fn aligned(rows: &[Vec<String>]) -> impl Iterator<Item = String> {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    rows.iter().map(move |row| {
        let cells = row.iter().enumerate().map(|(k, cell)| format!("  {cell:0$}", width(k)));
        cells.collect::<String>().trim_end().to_owned()
    })
}
