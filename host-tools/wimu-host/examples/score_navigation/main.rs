//! Scores of navigation on recordings with truth and on simulated journeys, against plain baselines in the same run:
//! `cargo run --release -p wimu-host --example score_navigation -- [DATA] [--json OUT.json] [--only NAME]
//! [--journeys COUNT] [--seed SEED]`. `--only` takes part of a recording's name, or `journeys`.

mod array;
mod baseline;
mod detector;
mod gyroscopes;
mod journeys;
mod low_pass;
mod methods;
mod output;
mod record;
mod recording;
mod report;
mod score;
mod settings;
#[cfg(test)]
mod tests;
mod walks;

use std::path::{Path, PathBuf};

use journeys::{Kind, SensorErrors};
use methods::Scored;
use report::{ArrayReport, JourneysReport, RecordingReport, Report};

const ARRAYS: [&str; 2] = ["mimu4444_run1", "mimu4444_run2"];
const JOURNEYS: u64 = 120;

struct Options {
    data: PathBuf,
    json: Option<PathBuf>,
    only: Option<String>,
    journeys: u64,
    seed: u64,
}

impl Options {
    fn parse(mut arguments: impl Iterator<Item = String>) -> Result<Self, String> {
        let mut options = Self {
            data: PathBuf::from("../shared/data"),
            json: None,
            only: None,
            journeys: JOURNEYS,
            seed: 1,
        };
        while let Some(argument) = arguments.next() {
            if !argument.starts_with("--") {
                options.data = argument.into();
                continue;
            }
            let value = arguments.next().ok_or(format!("{argument} needs a value"))?;
            let number = || value.parse::<u64>().map_err(|e| format!("{argument} {value}: {e}"));
            match argument.as_str() {
                "--json" => options.json = Some(value.into()),
                "--only" => options.only = Some(value),
                "--journeys" => options.journeys = number()?,
                "--seed" => options.seed = number()?,
                _ => return Err(format!("{argument} is not an option")),
            }
        }
        Ok(options)
    }

    fn wants(&self, name: &str) -> bool {
        self.only.as_deref().is_none_or(|only| name.contains(only))
    }
}

fn main() -> Result<(), String> {
    let options = Options::parse(std::env::args().skip(1))?;
    let mut report = Report::new(options.data.display().to_string(), options.seed);
    for note in report.notes {
        println!("{note}");
    }
    score_recordings(&options, &mut report);
    score_arrays(&options.data, &options, &mut report);
    if options.wants("journeys") && options.journeys > 0 {
        report.journeys = Some(score_journeys(&options));
    }
    report.count();
    record::record(&report);
    println!("\nvalues that are not finite, in all: {}", report.non_finite);
    if report.recordings.is_empty() && report.arrays.is_empty() && report.journeys.is_none() {
        return Err(format!("nothing to score in {}", options.data.display()));
    }
    if let Some(file) = &options.json {
        let text = output::json(&report).map_err(|e| e.to_string())?;
        std::fs::write(file, text).map_err(|e| format!("{}: {e}", file.display()))?;
    }
    Ok(())
}

fn score_recordings(options: &Options, report: &mut Report) {
    let (recordings, messages) = recording::load(&options.data, |name| options.wants(name));
    for message in messages {
        println!("{message}");
    }
    let (mut hand, mut foot) = (Vec::new(), Vec::new());
    for recording in &recordings {
        let scored = methods::score(recording);
        let pool = if recording.name.starts_with("pyshoe_") { &mut foot } else { &mut hand };
        add(pool, &scored);
        let found = RecordingReport::of(&recording.name, &scored);
        output::print(&found);
        report.recordings.push(found);
    }
    walks::print(&foot);
    for (name, pool) in [("hand and robot, pooled", hand), ("walks, pooled", foot)] {
        if recordings.len() > 1 && !pool.is_empty() {
            let found = RecordingReport::of(name, &pool);
            output::print(&found);
            report.pooled.push(found);
        }
    }
}

fn score_arrays(data: &Path, options: &Options, report: &mut Report) {
    for name in ARRAYS.into_iter().filter(|name| options.wants(name)) {
        match array::score(data, name) {
            Ok(scores) => {
                let found = ArrayReport::of(&scores);
                output::print_array(&found);
                report.arrays.push(found);
            }
            Err(error) => println!("{name}: not scored: {error}"),
        }
    }
}

fn score_journeys(options: &Options) -> JourneysReport {
    let mut all = Vec::new();
    let mut by_kind: Vec<(Kind, Vec<Scored>)> =
        journeys::KINDS.iter().map(|kind| (*kind, Vec::new())).collect();
    for number in 0..options.journeys {
        let kind = journeys::kind(number);
        let recording = journeys::journey(kind, options.seed, number, &SensorErrors::TABLE);
        let scored = methods::score(&recording);
        add(&mut all, &scored);
        for (_, pool) in by_kind.iter_mut().filter(|(k, _)| *k == kind) {
            add(pool, &scored);
        }
    }
    let count = options.journeys;
    let all = RecordingReport::of(&format!("{count} simulated journeys"), &all);
    output::print(&all);
    let kinds = by_kind.iter().filter(|(_, pool)| !pool.is_empty()).map(|(kind, pool)| {
        let found = RecordingReport::of(&format!("simulated {kind:?}"), pool);
        output::print(&found);
        found
    });
    JourneysReport { count, all, kinds: kinds.collect() }
}

/// Adds the scores of a recording to those of others, method by method.
fn add(pool: &mut Vec<Scored>, scored: &[Scored]) {
    for one in scored {
        match pool.iter_mut().find(|p| p.name == one.name) {
            Some(known) => known.merge(one),
            None => {
                let mut known = one.clone();
                known.refused = None;
                known.closure = None;
                pool.push(known);
            }
        }
    }
}
