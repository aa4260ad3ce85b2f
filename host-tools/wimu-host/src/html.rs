//! HTML reports: one file with its charts inside, which its own script draws; without a script they are pictures.

use std::fmt::Write as _;
use std::path::Path;

use crate::chart::Chart;
use crate::plural::counted;
use crate::problem;
use crate::{Code, OutputFile, Problem, Result, Severity};

/// The script that draws charts into the `figure`s of a page; `new WimuPlot(element, chart)` draws one.
pub const PLOT_SCRIPT: &str = include_str!("html/plot.js");
/// The style that it needs.
pub const STYLE: &str = include_str!("html/style.css");
/// Rows of a table that is not folded.
const OPEN_ROWS: usize = 12;

/// A page: the result, key figures and warnings, then charts and tables, then the text of the command, folded.
#[derive(Clone, Debug, Default)]
pub struct Report {
    title: String,
    result: String,
    keys: String,
    warnings: String,
    body: String,
    details: String,
}

impl Report {
    /// An empty page.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), ..Self::default() }
    }

    /// The result as a sentence.
    pub fn result(&mut self, text: &str) -> &mut Self {
        let _ = writeln!(self.result, "<p class=\"result\">{}</p>", escape(text));
        self
    }

    /// A key figure with its unit.
    pub fn key(&mut self, name: &str, value: &str) -> &mut Self {
        let (name, value) = (escape(name), escape(value));
        let _ = writeln!(self.keys, "<div><dt>{name}</dt><dd>{value}</dd></div>");
        self
    }

    /// The text that the command prints.
    pub fn printed(&mut self, text: &str) -> &mut Self {
        let _ = writeln!(self.details, "<pre>{}</pre>", escape(text));
        self
    }

    /// All findings, if there are any: warnings with the result, and all of them with the text of the command.
    pub fn findings(&mut self, findings: &[Problem]) -> &mut Self {
        let is_warning = |finding: &&Problem| {
            finding.severity >= Severity::Warning && finding.code != Code::NoResult
        };
        for finding in findings.iter().filter(is_warning) {
            let text = escape(&finding.to_string());
            let _ = writeln!(self.warnings, "<p>{text}</p>");
        }
        match problem::text(findings, usize::MAX) {
            text if text.is_empty() => self,
            text => self.printed(text.trim_end()),
        }
    }

    /// A table with a header row; a long one is folded.
    pub fn table(&mut self, name: &str, head: &[&str], rows: &[Vec<String>]) -> &mut Self {
        let cells = |tag: &str, cells: &mut dyn Iterator<Item = &str>| {
            let cells: String =
                cells.map(|cell| format!("<{tag}>{}</{tag}>", escape(cell))).collect();
            format!("<tr>{cells}</tr>\n")
        };
        let rows_text: String =
            (rows.iter()).map(|row| cells("td", &mut row.iter().map(String::as_str))).collect();
        let _ = writeln!(
            self.body,
            "<details{}><summary>{}</summary><div class=\"table\"><table>\n{}{rows_text}</table></div></details>",
            if rows.len() > OPEN_ROWS { "" } else { " open" },
            escape(name),
            cells("th", &mut head.iter().copied())
        );
        self
    }

    /// A chart: its data for the script, and its picture where there is no script.
    pub fn chart(&mut self, chart: &Chart) -> &mut Self {
        let small = chart.decimated();
        let points = |chart: &Chart| chart.series.iter().map(|s| s.points.len()).sum::<usize>();
        let [before, after] = [points(chart), points(&small)];
        let mut notes: Vec<String> = Vec::from_iter(Some(chart.note.clone()));
        notes.retain(|note| !note.is_empty());
        if after < before {
            notes.push(format!(
                "Drawn: {after} of {} (the extremes of equal intervals).",
                counted(before, "point")
            ));
        }
        let _ = writeln!(
            self.body,
            "<figure><script type=\"application/json\">{}</script><noscript>{}</noscript><figcaption>{}</figcaption></figure>",
            // A `<` could end the script.
            small.json().to_string().replace('<', "\\u003c"),
            small.svg(),
            escape(&notes.join(" "))
        );
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
        let within = |open: &str, text: &str, close: &str| match text {
            "" => String::new(),
            text => format!("{open}\n{text}{close}\n"),
        };
        let keys = within("<dl class=\"key\">", &self.keys, "</dl>");
        let warnings = within("<div class=\"warnings\">", &self.warnings, "</div>");
        let text = "<details><summary>Text of the command</summary>";
        let details = within(text, &self.details, "</details>");
        format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"><title>{title}</title>\n\
             <style>\n{STYLE}</style></head>\n<body><h1>{title}</h1>\n{}{keys}{warnings}{}{details}\
             <script>\n{PLOT_SCRIPT}</script></body></html>\n",
            self.result, self.body
        )
    }
}

pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
