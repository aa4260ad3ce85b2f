//! `docs/reference/validation.md` from the results of the campaigns: the headline claims, then each campaign with the targets
//! that it misses. All figures are in `docs/reference/validation`.

use std::fmt::Write as _;
use std::fs;

use serde_json::Value;
use xshell::Shell;

use crate::Result;
use crate::campaign::{self, RESULTS};

/// Widest line of the document, characters.
const WIDTH: usize = 140;

/// Writes the document: `head.md`, the headline claims, a section a campaign, `tail.md`.
pub fn write(sh: &Shell) -> Result {
    let part = |name: &str| {
        let file = format!("{RESULTS}/{name}");
        fs::read_to_string(&file).map_err(|error| format!("{file}: {error}"))
    };
    let mut headlines = String::new();
    let mut sections = String::new();
    for campaign in campaign::all()? {
        let done = campaign::results(&campaign.name)?;
        let _ = write!(sections, "\n## Campaign {}\n\n{}.\n", campaign.name, campaign.about);
        let mut claims = campaign.headlines.clone();
        for result in campaign.results(&done) {
            let date = date(result, campaign.is_fresh(sh, result));
            sections.push_str(&section(result, &date)?);
            for figure in figures(result)
                .iter()
                .filter(|figure| claims.iter().any(|c| figure["claim"] == **c))
            {
                headlines.push_str(&row(figure, Some(&date))?);
            }
            claims.retain(|claim| figures(result).iter().all(|figure| figure["claim"] != **claim));
        }
        for claim in claims {
            let _ = writeln!(headlines, "| {claim} | – | – | not measured | – |");
        }
    }
    let mut text = part("head.md")?;
    text.push_str("\n| claim | figure | bar | met | measured |\n|---|---|---|---|---|\n");
    text += &headlines;
    text.push('\n');
    text += &part("limits.md")?;
    text += &sections;
    let _ = write!(text, "\n{}", part("tail.md")?);
    Ok(fs::write("docs/reference/validation.md", text)?)
}

/// The day of a result, marked where its sources have changed since.
fn date(result: &Value, fresh: bool) -> String {
    let day = result["date"].as_str().unwrap_or("unknown");
    if fresh { day.into() } else { format!("{day} *") }
}

fn figures(result: &Value) -> &[Value] {
    result["figures"].as_array().map_or(&[], Vec::as_slice)
}

/// A row of a table: the claim, the figure, its bar, whether it is met, and the day.
fn row(figure: &Value, date: Option<&str>) -> Result<String> {
    let field = |key: &str| figure[key].as_str().unwrap_or_default().replace('|', "\\|");
    let [claim, measured, target] = ["claim", "figure", "target"].map(field);
    let met = if figure["met"] == false { "**missed**" } else { "passed" };
    let line = match date {
        Some(date) => format!("| {claim} | {measured} | {target} | {met} | {date} |\n"),
        None => format!("| {claim} | {measured} | {target} |\n"),
    };
    if line.chars().count() > WIDTH + 1 {
        return Err(format!("a row is wider than {WIDTH} characters: {line}").into());
    }
    Ok(line)
}

/// A command: when it was run, how many targets it meets, and a table of those that it misses.
fn section(result: &Value, date: &str) -> Result<String> {
    let figures = figures(result);
    let missed: Vec<&Value> = figures.iter().filter(|figure| figure["met"] == false).collect();
    let passes = if result["passed"] == false { "**fails**" } else { "passes" };
    let mut text = format!("\n    cargo {}\n\n", result["command"].as_str().unwrap_or_default());
    let _ = write!(text, "{date}, {} minutes, {passes}", result["minutes"]);
    if figures.is_empty() {
        return Ok(text + ".\n");
    }
    let _ = writeln!(
        text,
        "; {} of {} figures meet their bars.",
        figures.len() - missed.len(),
        figures.len()
    );
    if !missed.is_empty() {
        text.push_str("\n| missed | figure | bar |\n|---|---|---|\n");
    }
    for figure in missed {
        text.push_str(&row(figure, None)?);
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn every_missed_target_is_shown_and_met_ones_are_counted() {
        let result = json!({
            "command": "test", "date": "2026-11-28", "minutes": 1.5,
            "figures": [
                { "claim": "holds", "figure": "95 %", "target": "93 to 97 %", "met": true },
                { "claim": "|f|", "figure": "9 m", "target": "1 m", "met": false },
            ],
        });
        let text = section(&result, &date(&result, false)).expect("narrow");
        assert!(
            text.contains("2026-11-28 *, 1.5 minutes, passes; 1 of 2 figures meet their bars."),
            "{text}"
        );
        assert!(text.contains("| \\|f\\| | 9 m | 1 m |\n") && !text.contains("holds"), "{text}");
    }
}
