//! Scores of the command `wimu` on recordings with truth, beside plain baselines in the same run:
//! `cargo run --release -p wimu-scores -- --help`.
//!
//! The command runs in this process and writes the CSV and JSON that users get. Path and truth are paired by time. A NEES is
//! computed from the standard deviations of the components: the CSV does not have their correlations. Its share is that of
//! independent samples below the 95 % point of χ². Exit code 1: something could not be scored, or no sample was.

mod baseline;
mod case;
mod command;
mod manifest;
mod metric;
mod report;
mod score;
mod table;
mod truth;

use std::fs;
use std::path::{Path, PathBuf};

use case::Case;
use clap::Parser;
use manifest::{Manifest, Source};
use report::{Row, pools, print};
use table::Result;

/// Scores of the command `wimu` on recordings with truth, beside plain baselines.
#[derive(Parser)]
struct Options {
    /// Folder of the recordings
    #[arg(default_value = "../shared/data")]
    data: PathBuf,
    /// What is scored
    #[arg(long, default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/scores.toml"))]
    manifest: PathBuf,
    /// Recordings whose system, name or metric contain this
    #[arg(long, default_value = "")]
    only: String,
    /// Recordings for choosing a configuration, or for showing its results
    #[arg(long, default_value = "", value_parser = ["", "choose", "show"])]
    half: String,
    /// Number of simulated journeys with each fault
    #[arg(long, default_value_t = 63)]
    journeys: u64,
    /// Write the table to this file
    #[arg(long)]
    json: Option<PathBuf>,
}

fn main() -> Result<()> {
    let options = Options::parse();
    let manifest: Manifest = toml::from_str(&fs::read_to_string(&options.manifest)?)?;
    let folder = tempfile::tempdir()?;
    let (mut rows, mut failures) = (Vec::new(), Vec::new());
    for entry in &manifest.score {
        for recording in &entry.recordings {
            let stem = Path::new(recording).file_stem().unwrap_or_default().to_string_lossy();
            let name = format!("{} {stem} {:?} {:?}", entry.system, entry.metric, entry.half);
            let name = name.to_lowercase();
            if !name.contains(&options.only) || !name.ends_with(&options.half) {
                continue;
            }
            let (data, folder) = (options.data.as_path(), folder.path());
            let case = Case { entry, recording, data, folder, journeys: options.journeys };
            match score(&case, &stem) {
                Ok(found) => rows.extend(found),
                Err(error) => failures.push(format!("{name}: not scored: {error}")),
            }
            eprintln!("{name}");
        }
    }
    let pools = pools(&rows);
    rows.iter().chain(&pools).for_each(Row::record);
    print(&rows);
    print(&pools);
    if let Some(file) = &options.json {
        let table = serde_json::json!({ "schema": "wimu.scores/1", "rows": rows, "pools": pools });
        fs::write(file, format!("{table:#}\n"))?;
    }
    if rows.is_empty() || !failures.is_empty() {
        return Err(format!("{} rows\n{}", rows.len(), failures.join("\n")).into());
    }
    Ok(())
}

/// A row for each baseline.
fn score(case: &Case, name: &str) -> Result<Vec<Row>> {
    let found = metric::score(case, Source::Command)?;
    if found.samples == 0 {
        return Err(format!("no sample to score; exit code {}", found.exit).into());
    }
    let row = |baseline: Option<Source>| -> Result<Row> {
        let plain = baseline.map(|source| metric::score(case, source)).transpose()?;
        let baseline_figures = plain.map(|plain| plain.figures).unwrap_or_default();
        Ok(Row {
            system: case.entry.system.clone(),
            recording: name.to_owned(),
            metric: case.entry.metric,
            half: Some(case.entry.half),
            bar: case.entry.bar.clone(),
            ratios: found.figures.iter().zip(&baseline_figures).map(|(a, b)| a / b).collect(),
            score: found.clone(),
            baseline,
            baseline_figures,
            note: String::new(),
        })
    };
    let baselines = case.entry.baselines.iter().copied().map(Some);
    if case.entry.baselines.is_empty() {
        Ok(vec![row(None)?])
    } else {
        baselines.map(row).collect()
    }
}
