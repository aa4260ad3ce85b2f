//! `docs/VALIDATION.md` from the results of the campaigns.

use std::fmt::Write as _;
use std::fs;

use serde_json::Value;

use crate::campaign::{self, CAMPAIGNS, Campaign, RESULTS};

/// Widest line of the document, characters.
const WIDTH: usize = 120;

/// Writes the document.
///
/// # Errors
/// Says which file cannot be read or written.
pub fn write() -> Result<(), String> {
    let head = format!("{RESULTS}/head.md");
    let mut text = fs::read_to_string(&head).map_err(|error| format!("{head}: {error}"))?;
    for campaign in &CAMPAIGNS {
        let file = campaign::file(campaign.name);
        let _ = match fs::read_to_string(&file) {
            Ok(result) => {
                let result = serde_json::from_str(&result)
                    .map_err(|error| format!("{}: {error}", file.display()))?;
                write!(
                    text,
                    "\n{}",
                    section(campaign, &result, &campaign::sources(campaign))
                )
            }
            Err(_) => write!(text, "\n## {}\n\nNot run yet.\n", campaign.name),
        };
    }
    let document = "docs/VALIDATION.md";
    fs::write(document, text).map_err(|error| format!("{document}: {error}"))
}

/// The section of a campaign: one row a figure, failures included.
fn section(campaign: &Campaign, result: &Value, sources: &Value) -> String {
    let stale = if result["sources"] == *sources {
        ""
    } else {
        ", *stale*"
    };
    let commit = result["commit"].as_str().unwrap_or_default();
    let mut text = format!(
        "## {name}\n\n{about}. `cargo xtask campaign {name}`, {minutes} minutes, commit {commit:.8}{stale}.\n\n\
         | claim | figure | target |\n|---|---|---|\n",
        name = campaign.name,
        about = campaign.about,
        minutes = result["minutes"],
    );
    for figure in result["figures"].as_array().into_iter().flatten() {
        let field = |key: &str| figure[key].as_str().unwrap_or_default().replace('|', "\\|");
        let missed = if figure["met"] == false {
            " **missed**"
        } else {
            ""
        };
        let (figure, target) = (field("figure"), field("target"));
        let room = WIDTH.saturating_sub(figure.chars().count() + target.chars().count() + 22);
        let claim: String = field("claim").chars().take(room).collect();
        let _ = writeln!(text, "| {claim} | {figure}{missed} | {target} |");
    }
    text
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_missed_target_and_a_stale_source_are_marked_in_the_same_table() {
        let result = json!({
            "commit": "0123456789abcdef", "minutes": 1.5, "sources": { "crates": "a" },
            "figures": [
                { "claim": "holds", "figure": "95 %", "target": "93 to 97 %", "met": true },
                { "claim": "|f|", "figure": "9 m", "target": "1 m", "met": false },
            ],
        });
        let fresh = section(&CAMPAIGNS[0], &result, &json!({ "crates": "a" }));
        assert!(fresh.contains("| holds | 95 % | 93 to 97 % |\n"), "{fresh}");
        assert!(
            fresh.contains("| \\|f\\| | 9 m **missed** | 1 m |\n"),
            "{fresh}"
        );
        assert!(!fresh.contains("stale"), "{fresh}");
        assert!(section(&CAMPAIGNS[0], &result, &json!({ "crates": "b" })).contains("*stale*"));
    }
}
