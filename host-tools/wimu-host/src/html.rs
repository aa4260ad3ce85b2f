//! HTML reports: one file with its charts inside.

use std::fmt::Write as _;
use std::path::Path;

use crate::chart::Chart;
use crate::finding::{self, Finding};
use crate::{OutputFile, Result};

/// A page that is written from top to bottom.
#[derive(Clone, Debug)]
pub struct Report {
    title: String,
    body: String,
}

impl Report {
    /// An empty page.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            body: String::new(),
        }
    }

    /// A paragraph of text.
    pub fn text(&mut self, text: &str) -> &mut Self {
        let _ = writeln!(self.body, "<p>{}</p>", escape(text));
        self
    }

    /// Preformatted text.
    pub fn printed(&mut self, text: &str) -> &mut Self {
        let _ = writeln!(self.body, "<pre>{}</pre>", escape(text));
        self
    }

    /// All findings, if there are any.
    pub fn findings(&mut self, findings: &[Finding]) -> &mut Self {
        match finding::text(findings, usize::MAX) {
            text if text.is_empty() => self,
            text => self.printed(text.trim_end()),
        }
    }

    /// A table with a header row.
    pub fn table(&mut self, head: &[&str], rows: &[Vec<String>]) -> &mut Self {
        let cells = |tag: &str, cells: &mut dyn Iterator<Item = &str>| {
            let cells: String = cells
                .map(|cell| format!("<{tag}>{}</{tag}>", escape(cell)))
                .collect();
            format!("<tr>{cells}</tr>")
        };
        self.body.push_str("<table>");
        self.body.push_str(&cells("th", &mut head.iter().copied()));
        for row in rows {
            self.body
                .push_str(&cells("td", &mut row.iter().map(String::as_str)));
        }
        self.body.push_str("</table>\n");
        self
    }

    /// A chart.
    ///
    /// # Errors
    /// `file_failed` when it cannot be drawn.
    pub fn chart(&mut self, chart: &Chart) -> Result<&mut Self> {
        let _ = writeln!(self.body, "<figure>{}</figure>", chart.svg()?);
        Ok(self)
    }

    /// Writes the page, replacing an existing file.
    ///
    /// # Errors
    /// `file_failed`, `file_unreadable`.
    pub fn write(&self, path: &Path) -> Result<()> {
        let title = escape(&self.title);
        let page = format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title>\n\
             <style>{STYLE}</style></head>\n<body><h1>{title}</h1>\n{}</body></html>\n",
            self.body
        );
        OutputFile::write(path, page)
    }
}

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:900px;margin:2em auto;\
    padding:0 1em;color:#222}pre{background:#f4f4f4;padding:1em;white-space:pre-wrap;font-size:14px}h1{overflow-wrap:anywhere}\
    table{border-collapse:collapse}td,th{padding:.2em 1em;border-bottom:1px solid #ddd;\
    text-align:right}figure{margin:1.5em 0}svg{max-width:100%;height:auto}";

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_cannot_break_the_page() {
        let mut report = Report::new("<x>");
        report
            .text("1 < 2 & 3")
            .table(&["<h>"], &[vec!["<td>".to_owned()]]);
        assert!(!report.body.contains("<h>") && report.body.contains("1 &lt; 2 &amp; 3"));
    }
}
