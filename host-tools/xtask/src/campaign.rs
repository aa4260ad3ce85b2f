//! Statistics that take long, in release. What they measure goes to `docs/reference/validation/NAME.json`.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Deserialize;
use serde_json::{Value, json};
use xshell::{Shell, cmd};

use crate::Result;
use crate::budget::DATA;

/// Where results are kept.
pub const RESULTS: &str = "docs/reference/validation";

/// Commands whose figures are kept together; `docs/reference/validation/campaigns.json` lists them.
#[derive(Deserialize)]
pub struct Campaign {
    pub name: String,
    pub about: String,
    /// Folders and files whose content the figures depend on.
    sources: Vec<String>,
    /// Arguments of cargo. `{data}` is the folder of recordings, `{results}` that of results.
    commands: Vec<String>,
    /// The claims of it that docs/reference/validation.md begins with.
    pub headlines: Vec<String>,
}

/// All campaigns.
pub fn all() -> Result<Vec<Campaign>> {
    Ok(serde_json::from_str(&fs::read_to_string(file("campaigns"))?)?)
}

/// Runs the commands of a campaign and writes the results of each as it ends: a campaign that was interrupted goes on
/// with those commands whose results are missing or stale, or that failed. The figures of a command that fails are
/// kept, and marked.
pub fn run(sh: &Shell, name: &str, seed: u64) -> Result {
    let campaigns = all()?;
    let Some(campaign) = campaigns.iter().find(|campaign| campaign.name == name) else {
        let names: Vec<_> = campaigns.iter().map(|campaign| campaign.name.as_str()).collect();
        return Err(format!("there is no campaign `{name}`: {}", names.join(", ")).into());
    };
    let mut done = results(name)?;
    if done["seed"] != seed {
        done = json!({});
    }
    for command in &campaign.commands {
        let of_before = campaign.result(&done, command).filter(|result| result["passed"] == true);
        if of_before.is_some_and(|result| campaign.is_fresh(sh, result)) {
            println!("{command}: already done");
            continue;
        }
        let result = campaign.execute(sh, command, seed)?;
        let mut runs: Vec<Value> = campaign.results(&done).cloned().collect();
        runs.retain(|run| run["command"] != **command);
        runs.push(result);
        done = json!({ "schema": "wimu.campaign/2", "name": name, "seed": seed, "runs": runs });
        fs::write(file(name), format!("{done:#}\n"))?;
    }
    println!("{}", file(name).display());
    let failed = campaign.results(&done).filter(|result| result["passed"] == false);
    let failed: Vec<_> = failed.map(|result| result["command"].to_string()).collect();
    if failed.is_empty() { Ok(()) } else { Err(format!("failed: {}", failed.join(", ")).into()) }
}

impl Campaign {
    /// The result of each command that has one in `done`.
    pub fn results<'a>(&self, done: &'a Value) -> impl Iterator<Item = &'a Value> {
        self.commands.iter().filter_map(|command| self.result(done, command))
    }

    fn result<'a>(&self, done: &'a Value, command: &str) -> Option<&'a Value> {
        done["runs"].as_array()?.iter().find(|run| run["command"] == command)
    }

    /// Whether no source of a result has changed.
    pub fn is_fresh(&self, sh: &Shell, result: &Value) -> bool {
        result["sources"] == self.hashes(sh)
    }

    fn execute(&self, sh: &Shell, command: &str, seed: u64) -> Result<Value> {
        let sources = &self.sources;
        let changed = cmd!(sh, "git status --porcelain -- {sources...}").quiet().read()?;
        if let Some(first) = changed.lines().next() {
            return Err(format!("commit first: results are of a commit ({first})").into());
        }
        let folder = tempfile::tempdir()?;
        let lines = folder.path().join("figures");
        let start = Instant::now();
        let line = command.replace("{data}", DATA).replace("{results}", RESULTS);
        let cargo = cmd!(sh, "cargo").args(line.split(' ')).env("WIMU_LANE", "campaign");
        let outcome = cargo.env("WIMU_SEED", seed.to_string()).env("WIMU_RESULTS", &lines).run();
        let figures = fs::read_to_string(&lines).unwrap_or_default();
        let figures: std::result::Result<_, _> =
            figures.lines().map(serde_json::from_str).collect();
        let mut figures: Vec<Value> = figures?;
        // Parallel tests record in any order.
        figures.sort_by_key(|figure| [&figure["test"], &figure["claim"]].map(Value::to_string));
        Ok(json!({
            "command": command,
            "commit": cmd!(sh, "git rev-parse HEAD").quiet().read()?,
            "date": cmd!(sh, "date -u +%F").quiet().read()?,
            "sources": self.hashes(sh),
            "minutes": (start.elapsed().as_secs_f64() / 6.0).round() / 10.0,
            "passed": outcome.is_ok(),
            "figures": figures,
        }))
    }

    /// Each source with the hash of its content as committed.
    fn hashes(&self, sh: &Shell) -> Value {
        let hash = |source: &String| {
            let hash = cmd!(sh, "git rev-parse HEAD:{source}").quiet().ignore_stderr().read().ok();
            (source.clone(), hash.into())
        };
        Value::Object(self.sources.iter().map(hash).collect())
    }
}

/// The results of a campaign, null if it has none.
pub fn results(name: &str) -> Result<Value> {
    let Ok(text) = fs::read_to_string(file(name)) else { return Ok(Value::Null) };
    Ok(serde_json::from_str(&text).map_err(|error| format!("{}: {error}", file(name).display()))?)
}

fn file(name: &str) -> PathBuf {
    Path::new(RESULTS).join(format!("{name}.json"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sources_of_every_campaign_exist() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let list = std::fs::read_to_string(root.join(file("campaigns"))).expect("a list");
        let campaigns: Vec<Campaign> = serde_json::from_str(&list).expect("campaigns");
        for campaign in &campaigns {
            for source in &campaign.sources {
                assert!(root.join(source).exists(), "{}: {source}", campaign.name);
            }
        }
    }
}
