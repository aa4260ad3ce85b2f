//! Statistics that take long, in release. What they measure goes to `docs/validation/NAME.json`.

use std::path::{Path, PathBuf};
use std::time::Instant;
use std::{fs, process};

use serde_json::{Value, json};

use crate::budget::DATA;
use crate::command_line::CommandLine;
use crate::setup::cargo;

/// Where results are kept.
pub const RESULTS: &str = "docs/validation";

/// Commands whose figures are kept together.
pub struct Campaign {
    pub name: &'static str,
    pub about: &'static str,
    /// Arguments of cargo. `{data}` is the folder of recordings.
    commands: &'static [&'static str],
    /// Folders whose content the figures depend on.
    sources: &'static [&'static str],
}

pub const CAMPAIGNS: [Campaign; 6] = [
    Campaign {
        name: "calibration",
        about: "intervals, refusals and outliers over simulated sensors; public recordings",
        commands: &["test --release -p wimu-calib --test all -- --include-ignored"],
        sources: &["crates/wimu-model", "crates/wimu-calib"],
    },
    Campaign {
        name: "navigation",
        about: "errors and consistency on recordings and journeys, beside plain baselines",
        commands: &[
            "test --release -p wimu-nav --test all -- --include-ignored",
            "run --release -p wimu-host --example score_navigation -- {data}",
        ],
        sources: &[
            "crates/wimu-model",
            "crates/wimu-nav",
            "host-tools/wimu-host",
        ],
    },
    Campaign {
        name: "link",
        about: "forged requests, bad lines, pushes, unsigned floods",
        commands: &[
            "test --release -p wimu-link --test all -- --include-ignored",
            "test --release -p wimu-tests --test all -- --include-ignored pushes:: noisy_link:: board::",
        ],
        sources: &[
            "crates/wimu-link",
            "crates/wimu-node",
            "host-tools/wimu-sim",
        ],
    },
    Campaign {
        name: "storage",
        about: "power cuts at every byte, unstable cells, damaged pages",
        commands: &["test --release -p wimu-tests --test all -- --include-ignored store::"],
        sources: &["crates/wimu-node"],
    },
    Campaign {
        name: "fuzz",
        about: "random and damaged bytes for every decoder",
        commands: &["run --release -p wimu-tests --example fuzz 10000000 7"],
        sources: &["crates", "host-tools/wimu-host"],
    },
    Campaign {
        name: "clocks",
        about: "clock models of links with jitter; recordings of a day",
        commands: &["test --release -p wimu-sim --test all -- --include-ignored"],
        sources: &["host-tools/wimu-sim", "host-tools/wimu-host"],
    },
];

/// The name, if there is such a campaign.
///
/// # Errors
/// Names those that there are.
pub fn known(name: &str) -> Result<&'static str, String> {
    let found = CAMPAIGNS.iter().find(|campaign| campaign.name == name);
    found
        .map(|campaign| campaign.name)
        .ok_or_else(|| format!("there is no campaign `{name}`: {}", names()))
}

/// The names of all campaigns.
pub fn names() -> String {
    CAMPAIGNS.map(|campaign| campaign.name).join(", ")
}

/// Runs a campaign and writes its results.
///
/// # Errors
/// Says which command failed; the results of the others are not written then.
pub fn run(name: &str) -> Result<(), String> {
    let campaign = CAMPAIGNS.iter().find(|campaign| campaign.name == name);
    let campaign = campaign.ok_or("there is no such campaign")?;
    let problem = |error: std::io::Error| format!("{name}: {error}");
    let lines = std::env::temp_dir().join(format!("wimu-{name}-{}.jsonl", process::id()));
    let _ = fs::remove_file(&lines);
    let start = Instant::now();
    for command in campaign.commands {
        cargo(&command.replace("{data}", DATA))
            .with("WIMU_LANE", "campaign")
            .with("WIMU_RESULTS", &lines.display().to_string())
            .run()?;
    }
    let mut figures = read_lines(&fs::read_to_string(&lines).unwrap_or_default())?;
    // Parallel tests record in any order.
    figures.sort_by_key(|figure| [&figure["test"], &figure["claim"]].map(Value::to_string));
    let _ = fs::remove_file(&lines);
    let result = json!({
        "schema": "wimu.campaign/1",
        "name": name,
        "about": campaign.about,
        "commit": revision("HEAD").ok_or("this is no git checkout")?,
        "sources": sources(campaign),
        "minutes": (start.elapsed().as_secs_f64() / 6.0).round() / 10.0,
        "figures": figures,
    });
    fs::create_dir_all(RESULTS).map_err(problem)?;
    let file = file(name);
    fs::write(&file, format!("{result:#}\n")).map_err(problem)?;
    println!("{}: {} figures", file.display(), figures.len());
    Ok(())
}

/// Where the results of a campaign are.
pub fn file(name: &str) -> PathBuf {
    Path::new(RESULTS).join(format!("{name}.json"))
}

fn read_lines(text: &str) -> Result<Vec<Value>, String> {
    let value = |line: &str| serde_json::from_str(line).map_err(|e| format!("{line}: {e}"));
    text.lines().map(value).collect()
}

/// The folders that a campaign depends on, each with the hash of its content as committed.
pub fn sources(campaign: &Campaign) -> Value {
    let hash = |folder: &&str| {
        (
            (*folder).to_owned(),
            revision(&format!("HEAD:{folder}")).into(),
        )
    };
    Value::Object(campaign.sources.iter().map(hash).collect())
}

fn revision(of: &str) -> Option<String> {
    let text = CommandLine::new("git rev-parse").word(of).output()?;
    Some(text.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_campaign_depends_on_folders_that_there_are() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        for campaign in &CAMPAIGNS {
            for folder in campaign.sources {
                assert!(root.join(folder).is_dir(), "{}: {folder}", campaign.name);
            }
        }
    }

    #[test]
    fn a_damaged_line_of_results_is_named() {
        assert_eq!(
            read_lines("{\"claim\":\"a\"}\n").map(|all| all.len()),
            Ok(1)
        );
        assert!(read_lines("{\"claim\"\n").is_err_and(|why| why.contains("claim")));
    }
}
