//! `docs/VALIDATION.md` from the results of the campaigns.

use std::fmt::Write as _;
use std::fs;

use serde_json::Value;

use crate::campaign::{self, CAMPAIGNS, RESULTS};

/// Widest line of the document, characters.
const WIDTH: usize = 120;

/// Writes the document: `head.md`, a section a campaign, `tail.md`.
///
/// # Errors
/// Says which file cannot be read or written, or which row is too wide.
pub fn write() -> Result<(), String> {
    let part = |name: &str| {
        let file = format!("{RESULTS}/{name}");
        fs::read_to_string(&file).map_err(|error| format!("{file}: {error}"))
    };
    let mut text = part("head.md")?;
    for campaign in &CAMPAIGNS {
        let _ = write!(text, "\n## Campaign {}\n\n", campaign.name);
        match campaign::results(&campaign::file(campaign.name))? {
            None => text.push_str("Not run yet.\n"),
            Some(done) => {
                let _ = writeln!(
                    text,
                    "{}. `cargo xtask campaign {}`, seed {}.",
                    campaign.about, campaign.name, done["seed"]
                );
                for (result, fresh) in campaign.results(&done) {
                    text.push_str(&section(result, fresh)?);
                }
            }
        }
    }
    let _ = write!(text, "\n{}", part("tail.md")?);
    let document = "docs/VALIDATION.md";
    fs::write(document, text).map_err(|error| format!("{document}: {error}"))
}

/// The table of a command: one row a figure, missed targets included. Without figures, whether it passes.
fn section(result: &Value, fresh: bool) -> Result<String, String> {
    let figures = result["figures"].as_array().map_or(&[][..], Vec::as_slice);
    let mut text = format!(
        "\n    cargo {}\n\n{} minutes at commit {:.8}{}.\n",
        result["command"].as_str().unwrap_or_default(),
        result["minutes"],
        result["commit"].as_str().unwrap_or_default(),
        match (result["passed"] == false, figures.is_empty(), fresh) {
            (true, ..) => ", **fails**",
            (_, true, true) => ", passes",
            (_, true, false) => ", passes *stale*",
            _ => "",
        },
    );
    if !figures.is_empty() {
        text.push_str("\n| claim | figure | target | met |\n|---|---|---|---|\n");
    }
    for figure in figures {
        let field = |key: &str| figure[key].as_str().unwrap_or_default().replace('|', "\\|");
        let met = match figure["met"] == false {
            true => "**no**",
            false => "yes",
        };
        let [claim, figure, target] = ["claim", "figure", "target"].map(field);
        let line = format!("| {claim} | {figure} | {target} | {met}");
        // Without the mark of a stale row, which another commit adds.
        if line.chars().count() + " |".len() > WIDTH {
            return Err(format!("a row is wider than {WIDTH} characters: {line}"));
        }
        text.push_str(&line);
        text.push_str(if fresh { " |\n" } else { " *stale* |\n" });
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn result(claim: &str) -> Value {
        json!({
            "command": "test", "commit": "0123456789abcdef", "minutes": 1.5,
            "figures": [
                { "claim": "holds", "figure": "95 %", "target": "93 to 97 %", "met": true },
                { "claim": claim, "figure": "9 m", "target": "1 m", "met": false },
            ],
        })
    }

    #[test]
    fn a_missed_target_and_a_stale_row_are_marked_in_the_same_table() {
        let fresh = section(&result("|f|"), true).expect("narrow");
        for row in ["| holds | 95 % | 93 to 97 % | yes |\n", "| \\|f\\| | 9 m | 1 m | **no** |\n"] {
            assert!(fresh.contains(row), "{fresh}");
        }
        let stale = section(&result("|f|"), false).expect("narrow");
        assert!(stale.contains("| yes *stale* |"), "{stale}");
    }

    #[test]
    fn a_command_without_figures_has_no_table() {
        let result = json!({ "command": "check", "commit": "0123456789", "minutes": 1, "passed": true, "figures": [] });
        let text = section(&result, true).expect("narrow");
        assert!(text.ends_with("01234567, passes.\n"), "{text}");
    }

    #[test]
    fn a_row_that_is_too_wide_is_named_and_not_cut() {
        let widest = "x".repeat(WIDTH - "|  | 9 m | 1 m | **no** |".len());
        assert!(section(&result(&widest), false).is_ok());
        let wider = format!("{widest}x");
        assert!(section(&result(&wider), false).is_err_and(|why| why.contains(&wider)));
    }
}
