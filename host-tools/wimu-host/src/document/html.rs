//! A document as an HTML page: one file with its charts inside, which its own script draws; without a script they are pictures.

use std::fmt::Write as _;

use super::{Document, OPEN_ROWS, Part};
use crate::chart::Chart;
use crate::plural::counted;
use crate::{Code, Problem, Severity, problem};

/// The script that draws charts into the `figure`s of a page; `new WimuPlot(element, chart)` draws one.
pub const PLOT_SCRIPT: &str = include_str!("plot.js");
/// The style that it needs.
pub const STYLE: &str = include_str!("style.css");

impl Document {
    /// The page as text.
    pub(super) fn page(&self) -> String {
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
    pub(super) fn html(&self) -> String {
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

pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
