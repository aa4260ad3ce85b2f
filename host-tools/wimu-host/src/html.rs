//! Documents: what a result says, as text and as an HTML page.
//!
//! A page is one file with its charts inside, which its own script draws; without a script they are pictures.
//!
//! ```
//! use wimu_host::html::Report;
//!
//! let mut document = Report::new("Noise of rest.csv");
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

use std::fmt::{self, Write as _};
use std::path::Path;

use serde::Serialize;

use crate::chart::Chart;
use crate::plural::counted;
use crate::problem;
use crate::{Code, OutputFile, Problem, Result, Severity};

/// The script that draws charts into the `figure`s of a page; `new WimuPlot(element, chart)` draws one.
pub const PLOT_SCRIPT: &str = include_str!("html/plot.js");
/// The style that it needs.
pub const STYLE: &str = include_str!("html/style.css");
/// Rows of a table that is not folded on a page, and that is part of the text.
const OPEN_ROWS: usize = 12;

/// A result whose JSON, text and page have the same fields.
pub trait ToDocument: Serialize {
    /// What it says.
    fn document(&self) -> Report;
}

/// A document: the result, key figures and problems, then tables and charts.
///
/// Its `Display` is the text for a terminal: results, key figures and short tables. Problems are printed by
/// [`problem::text`].
#[derive(Clone, Debug, Default)]
pub struct Report {
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

impl Report {
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

    /// The page as text.
    fn page(&self) -> String {
        let title = escape(&self.title);
        let results = each(&self.results, |text| format!("<p class=\"result\">{text}</p>\n"));
        let figures: String = (self.figures.iter())
            .map(|(name, value)| {
                format!("<div><dt>{}</dt><dd>{}</dd></div>\n", escape(name), escape(value))
            })
            .collect();
        let is_warning = |problem: &&Problem| {
            problem.severity >= Severity::Warning && problem.code != Code::NoResult
        };
        let warnings = self.problems.iter().filter(is_warning).map(ToString::to_string);
        let warnings = each(&Vec::from_iter(warnings), |text| format!("<p>{text}</p>\n"));
        let listed = problem::text(&self.problems, usize::MAX);
        let folded = self.printed.iter().map(String::as_str).chain([listed.trim_end()]);
        let folded: Vec<&str> = folded.filter(|text| !text.is_empty()).collect();
        let folded = each(&folded, |text| format!("<pre>{text}</pre>\n"));
        let body: String = self.parts.iter().map(Part::html).collect();
        format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"><title>{title}</title>\n\
             <style>\n{STYLE}</style></head>\n<body><h1>{title}</h1>\n{results}{}{}{body}{}\
             <script>\n{PLOT_SCRIPT}</script></body></html>\n",
            within("<dl class=\"key\">", &figures, "</dl>"),
            within("<div class=\"warnings\">", &warnings, "</div>"),
            within("<details><summary>Text of the command</summary>", &folded, "</details>"),
        )
    }
}

/// Escaped texts in the same element.
fn each<T: AsRef<str>>(texts: &[T], element: impl Fn(&str) -> String) -> String {
    texts.iter().map(|text| element(&escape(text.as_ref()))).collect()
}

/// A text between tags, or nothing.
fn within(open: &str, text: &str, close: &str) -> String {
    if text.is_empty() { String::new() } else { format!("{open}\n{text}{close}\n") }
}

impl Part {
    fn html(&self) -> String {
        match self {
            Self::Table { name, rows } => {
                let open = if rows.len() > OPEN_ROWS + 1 { "" } else { " open" };
                let mut table = String::new();
                for (index, row) in rows.iter().enumerate() {
                    let tag = if index == 0 { "th" } else { "td" };
                    let cells = each(row, |cell| format!("<{tag}>{cell}</{tag}>"));
                    let _ = writeln!(table, "<tr>{cells}</tr>");
                }
                let name = escape(name);
                format!(
                    "<details{open}><summary>{name}</summary><div class=\"table\"><table>\n{table}</table></div></details>\n"
                )
            }
            Self::Chart(chart) => figure(chart),
        }
    }
}

/// A chart: its data for the script, and its picture where there is no script.
fn figure(chart: &Chart) -> String {
    let small = chart.decimated();
    let points = |chart: &Chart| chart.series.iter().map(|s| s.points.len()).sum::<usize>();
    let [before, after] = [points(chart), points(&small)];
    let mut caption = chart.note.clone();
    if after < before {
        let all = counted(before, "point");
        let _ = write!(caption, " Drawn: {after} of {all} (the extremes of equal intervals).");
    }
    format!(
        "<figure><script type=\"application/json\">{}</script><noscript>{}</noscript><figcaption>{}</figcaption></figure>\n",
        // A `<` could end the script.
        small.json().to_string().replace('<', "\\u003c"),
        small.svg(),
        escape(caption.trim_start())
    )
}

impl fmt::Display for Report {
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

pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
