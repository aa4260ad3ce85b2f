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

// Sources of commands.
const ARITHMETIC: [&str; 4] = [
    "crates/wimu-model/src",
    "crates/wimu-integrator/src",
    "crates/wimu-model/tests",
    "crates/wimu-integrator/tests",
];
const CALIBRATION: [&str; 3] =
    ["crates/wimu-model/src", "crates/wimu-calib/src", "crates/wimu-calib/tests"];
const NAVIGATION: [&str; 3] =
    ["crates/wimu-nav/src", "crates/wimu-nav/tests", "crates/wimu-nav/examples"];
const HOST_NAVIGATION: [&str; 11] = [
    "crates/wimu-nav/src",
    "host-tools/wimu-host/src/array",
    "host-tools/wimu-host/src/array.rs",
    "host-tools/wimu-host/src/hand_eye",
    "host-tools/wimu-host/src/inertial",
    "host-tools/wimu-host/src/localization",
    "host-tools/wimu-host/src/relative",
    "host-tools/wimu-host/src/motion",
    "host-tools/wimu-host/src/motion.rs",
    "host-tools/wimu-host/examples",
    "host-tools/wimu-host/tests",
];
const MULTI_RANGE: [&str; 5] = [
    "crates/wimu-nav/src/sensor",
    "host-tools/wimu-host/src/multi_range",
    "host-tools/wimu-host/src/multi_range.rs",
    "host-tools/wimu-sim/src/multi_range.rs",
    "host-tools/wimu-sim/examples/multi_range.rs",
];
const LINK: [&str; 6] = [
    "crates/wimu-link/src",
    "crates/wimu-node/src",
    "host-tools/wimu-sim/src",
    "tests/tests/board",
    "tests/tests/noisy_link.rs",
    "tests/tests/pushes.rs",
];
const LOOP: [&str; 7] = [
    "crates/wimu-model/src",
    "crates/wimu-calib/src",
    "crates/wimu-integrator/src",
    "crates/wimu-link/src",
    "crates/wimu-node/src",
    "host-tools/wimu-sim/src",
    "tests/tests/first_light.rs",
];
const STORAGE: [&str; 3] =
    ["crates/wimu-node/src", "host-tools/wimu-sim/src/storage.rs", "tests/tests/store"];
const FUZZ: [&str; 3] = ["crates/wimu-link/src", "host-tools/wimu-host/src/decode", "tests/src"];
const CLOCKS: [&str; 6] = [
    "host-tools/wimu-sim/src",
    "host-tools/wimu-host/src/clock",
    "host-tools/wimu-host/src/clock.rs",
    "host-tools/wimu-host/src/compare",
    "host-tools/wimu-host/src/compare.rs",
    "host-tools/wimu-sim/tests",
];
/// What a device runs.
const DEVICE: [&str; 8] = [
    "crates/wimu-registers/src",
    "crates/wimu-model/src",
    "crates/wimu-integrator/src",
    "crates/wimu-calib/src",
    "crates/wimu-link/src",
    "crates/wimu-node/src",
    "crates/wimu-adxl345/src",
    "firmware",
];

/// What `wimu` is built from.
const COMMAND: [&str; 5] = [
    "Cargo.lock",
    "crates",
    "host-tools/wimu/src",
    "host-tools/wimu-host/src",
    "host-tools/wimu-sim/src",
];
const FLEET: [&str; 6] = [
    "crates/wimu-link/src",
    "host-tools/wimu/src",
    "host-tools/wimu-host/src",
    "host-tools/wimu-sim/src",
    "host-tools/wimu/tests/fleet_campaign.rs",
    "host-tools/wimu/tests/kit",
];
const PYTHON: [&str; 2] = ["host-tools/wimu-python", "host-tools/wimu-host/src"];

/// Commands whose figures are kept together.
pub struct Campaign {
    pub name: &'static str,
    pub about: &'static str,
    runs: &'static [Runs],
}

/// Commands of a campaign in sequence.
struct Runs {
    /// Folders and files whose content the figures depend on.
    sources: &'static [&'static str],
    /// Arguments of cargo. `{data}` is the folder of recordings, `{results}` that of results.
    commands: &'static [&'static str],
}

/// One command of a campaign, with its sources.
struct Run {
    command: &'static str,
    sources: &'static [&'static str],
}

pub const CAMPAIGNS: [Campaign; 14] = [
    Campaign {
        name: "arithmetic",
        about: "corrector and integrator against f64 and exact integers",
        runs: &[Runs {
            sources: &ARITHMETIC,
            commands: &[
                "test --release -p wimu-model --test all -- --include-ignored",
                "test --release -p wimu-integrator --test all -- --include-ignored",
                "run --release -p wimu-integrator --example accuracy",
            ],
        }],
    },
    Campaign {
        name: "device",
        about: "flash and RAM of the images, instructions of a sample",
        runs: &[Runs {
            sources: &DEVICE,
            commands: &["run -p xtask -- size", "run -p xtask -- budget"],
        }],
    },
    Campaign {
        name: "calibration",
        about: "intervals, refusals and outliers over simulated sensors; public recordings",
        runs: &[
            Runs {
                sources: &CALIBRATION,
                commands: &["test --release -p wimu-calib --test all -- --include-ignored"],
            },
            Runs {
                sources: &["crates/wimu-calib/src", "host-tools/wimu-host/src/calibration"],
                commands: &["test --release -p wimu-host --lib -- calibration::advice"],
            },
            Runs {
                sources: &[
                    "crates/wimu-calib/src",
                    "host-tools/wimu-host/src/calibration",
                    "host-tools/wimu-host/tests/calibration_faults.rs",
                ],
                commands: &[
                    "test --release -p wimu-host --test all -- --include-ignored calibration_faults::",
                ],
            },
            Runs {
                sources: &CALIBRATION,
                commands: &["run --release -p wimu-calib --example speed"],
            },
        ],
    },
    Campaign {
        name: "navigation",
        about: "errors and consistency on recordings and journeys, beside plain baselines",
        runs: &[
            Runs {
                sources: &HOST_NAVIGATION,
                commands: &[
                    "test --release -p wimu-host --test all -- --include-ignored array_coverage:: array_input:: array_survey:: arrays:: violent::",
                ],
            },
            Runs {
                sources: &NAVIGATION,
                commands: &["run --release -p wimu-nav --example consistency 500"],
            },
            Runs {
                sources: &HOST_NAVIGATION,
                commands: &[
                    "run --release -p wimu-host --example array_journeys 40",
                    "run --release -p wimu-host --example bench_nav {data}",
                    "run --release -p wimu-host --example score_navigation -- {data} --json {results}/navigation-reference.json",
                    "run --release -p wimu-host --example score_localization -- {data}",
                    "run --release -p wimu-host --example score_align -- {data}",
                    "test --release -p wimu-host --test all -- --include-ignored hand_eye:: relative::",
                ],
            },
            Runs {
                sources: &MULTI_RANGE,
                commands: &["run --release -p wimu-sim --example multi_range -- 20"],
            },
            Runs {
                sources: &NAVIGATION,
                commands: &["test --release -p wimu-nav --test all -- --include-ignored"],
            },
        ],
    },
    Campaign {
        name: "link",
        about: "bytes of a sample, decoding, forged requests, bad lines, pushes, floods",
        runs: &[
            Runs {
                sources: &["crates/wimu-link/src", "crates/wimu-link/tests"],
                commands: &[
                    "test --release -p wimu-link --test all -- --include-ignored",
                    "run --release -p wimu-link --example wire_budget -- {data}",
                ],
            },
            Runs {
                sources: &LINK,
                commands: &[
                    "run --release -p wimu-sim --example link_budget",
                    "test --release -p wimu-tests --test all -- --include-ignored pushes:: noisy_link:: board::flood --skip pico::",
                    "run --release -p wimu-tests --example noisy_link",
                ],
            },
            Runs {
                sources: &["crates/wimu-link/src", "host-tools/wimu-host/src/decode"],
                commands: &["run --release -p wimu-tests --example decode_rate"],
            },
        ],
    },
    Campaign {
        name: "loop",
        about: "calibration, push, restart, slides and heading on simulated boards",
        runs: &[Runs {
            sources: &LOOP,
            commands: &[
                "test --release -p wimu-tests --test all -- --include-ignored first_light:: board::heading real_input:: --skip pico:: --skip qemu::",
            ],
        }],
    },
    Campaign {
        name: "storage",
        about: "power cuts at every byte, unstable cells, damaged pages",
        runs: &[Runs {
            sources: &STORAGE,
            commands: &[
                "test --release -p wimu-tests --test all -- --include-ignored store:: --skip pico::",
                "run --release -p wimu-tests --example fuzz 20000 7 store",
            ],
        }],
    },
    Campaign {
        name: "fuzz",
        about: "random, damaged and reordered bytes for every decoder",
        // Ten million in five runs, so that a campaign that was interrupted goes on with the next one.
        runs: &[Runs {
            sources: &FUZZ,
            commands: &[
                "run --release -p wimu-tests --example fuzz 2000000 7",
                "run --release -p wimu-tests --example fuzz 2000000 8",
                "run --release -p wimu-tests --example fuzz 2000000 9",
                "run --release -p wimu-tests --example fuzz 2000000 10",
                "run --release -p wimu-tests --example fuzz 2000000 11",
            ],
        }],
    },
    Campaign {
        name: "clocks",
        about: "clock models of links with jitter, comparison of links, recordings of a day",
        runs: &[Runs {
            sources: &CLOCKS,
            commands: &[
                "test --release -p wimu-host --lib -- --include-ignored clock:: compare::",
                "test --release -p wimu-sim --test all -- --include-ignored clocks:: compare:: long_files::",
            ],
        }],
    },
    Campaign {
        name: "dashboard",
        about: "the dashboard in Chromium: latency, load, memory, a recording of 1 GB; its pictures",
        runs: &[Runs {
            sources: &["host-tools/wimu/src/command/dashboard", "host-tools/wimu/tests/dashboard"],
            commands: &[
                "test --release -p wimu --test all -- --include-ignored --test-threads=1 --nocapture dashboard::",
            ],
        }],
    },
    Campaign {
        name: "fleet",
        about: "a thousand replayed boards through Mosquitto: faults of every part, every loss counted",
        // `WIMU_FLEET_BOARDS` and `WIMU_FLEET_SECONDS` make it smaller.
        runs: &[Runs {
            sources: &FLEET,
            commands: &[
                "test --release -p wimu --test all -- --ignored fleet_campaign:: --nocapture",
            ],
        }],
    },
    Campaign {
        name: "python",
        about: "the wheel of the Python module beside the command, on wrong and damaged input",
        runs: &[Runs { sources: &PYTHON, commands: &["run -p xtask -- python"] }],
    },
    Campaign {
        name: "miri",
        about: "the fast tests of the crates under Miri: undefined behaviour",
        runs: &[Runs { sources: &DEVICE, commands: &["run -p xtask -- miri"] }],
    },
    Campaign {
        name: "systems",
        about: "`wimu` compiles for Windows, macOS and Linux without a C library",
        // A target that is missing is named with the rustup command that adds it.
        runs: &[Runs {
            sources: &COMMAND,
            commands: &[
                "check -p wimu --target x86_64-pc-windows-gnu --target x86_64-apple-darwin --target aarch64-apple-darwin --target x86_64-unknown-linux-musl --target aarch64-unknown-linux-musl",
            ],
        }],
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

/// Runs the commands of a campaign and writes the results of each as it ends: a campaign that was
/// interrupted goes on with those commands whose results are missing or stale, or that failed. The figures of a command
/// that fails are kept, and marked.
///
/// # Errors
/// Says which commands failed, or which of their sources are not committed.
pub fn run(name: &str, seed: u64) -> Result<(), String> {
    let campaign = CAMPAIGNS.iter().find(|campaign| campaign.name == name);
    let campaign = campaign.ok_or("there is no such campaign")?;
    fs::create_dir_all(RESULTS).map_err(|error| format!("{RESULTS}: {error}"))?;
    let file = file(name);
    let mut done = results(&file)?.unwrap_or_default();
    if done["seed"] != seed {
        done = json!({});
    }
    for run in campaign.runs() {
        let is_done = |result| run.is_fresh(result) && result["passed"] == true;
        if run.result(&done).is_some_and(is_done) {
            println!("{}: already done", run.command);
            continue;
        }
        let result = run.execute(seed)?;
        let of_run = |of: Run| match of.command == run.command {
            true => Some(result.clone()),
            false => of.result(&done).cloned(),
        };
        done = json!({
            "schema": "wimu.campaign/2",
            "name": name,
            "about": campaign.about,
            "seed": seed,
            "runs": campaign.runs().filter_map(of_run).collect::<Vec<_>>(),
        });
        fs::write(&file, format!("{done:#}\n")).map_err(|e| format!("{}: {e}", file.display()))?;
    }
    println!("{}", file.display());
    let failed = campaign.results(&done).into_iter();
    let failed = failed.filter(|(result, _)| result["passed"] == false);
    let failed: Vec<_> = failed.map(|(result, _)| result["command"].to_string()).collect();
    match failed.is_empty() {
        true => Ok(()),
        false => Err(format!("failed: {}", failed.join(", "))),
    }
}

impl Campaign {
    fn runs(&self) -> impl Iterator<Item = Run> {
        let of_group = |Runs { sources, commands }: &'static Runs| {
            commands.iter().map(move |command| Run { command, sources })
        };
        self.runs.iter().flat_map(of_group)
    }

    /// Each command that has a result in `done`: the result, and whether its sources are unchanged.
    pub fn results<'a>(&self, done: &'a Value) -> Vec<(&'a Value, bool)> {
        let result = |run: Run| {
            let result = run.result(done)?;
            Some((result, run.is_fresh(result)))
        };
        self.runs().filter_map(result).collect()
    }
}

impl Run {
    /// The result of this command in a campaign's results.
    fn result<'a>(&self, done: &'a Value) -> Option<&'a Value> {
        let runs = done["runs"].as_array()?;
        runs.iter().find(|run| run["command"] == self.command)
    }

    /// Whether no source of a result has changed.
    fn is_fresh(&self, result: &Value) -> bool {
        result["sources"] == self.hashes()
    }

    fn execute(&self, seed: u64) -> Result<Value, String> {
        self.is_committed()?;
        let lines = std::env::temp_dir().join(format!("wimu-campaign-{}.jsonl", process::id()));
        let _ = fs::remove_file(&lines);
        let start = Instant::now();
        let command = self.command.replace("{data}", DATA);
        let outcome = cargo(&command.replace("{results}", RESULTS))
            .with("WIMU_LANE", "campaign")
            .with("WIMU_SEED", &seed.to_string())
            .with("WIMU_RESULTS", &lines.display().to_string())
            .run();
        let mut figures = read_lines(&fs::read_to_string(&lines).unwrap_or_default())?;
        let _ = fs::remove_file(&lines);
        // Parallel tests record in any order.
        figures.sort_by_key(|figure| [&figure["test"], &figure["claim"]].map(Value::to_string));
        Ok(json!({
            "command": self.command,
            "commit": revision("HEAD").ok_or("this is no git checkout")?,
            "sources": self.hashes(),
            "minutes": (start.elapsed().as_secs_f64() / 6.0).round() / 10.0,
            "passed": outcome.is_ok(),
            "figures": figures,
        }))
    }

    fn is_committed(&self) -> Result<(), String> {
        let status = CommandLine::new("git status --porcelain --").words(&self.sources.join(" "));
        let changed = status.output().ok_or("this is no git checkout")?;
        match changed.lines().next() {
            Some(first) => {
                Err(format!("results are kept with the commit they are of: commit first ({first})"))
            }
            None => Ok(()),
        }
    }

    /// Each source with the hash of its content as committed.
    fn hashes(&self) -> Value {
        let hash = |source: &&str| {
            let hash = revision(&format!("HEAD:{source}"));
            ((*source).to_owned(), hash.into())
        };
        Value::Object(self.sources.iter().map(hash).collect())
    }
}

/// The content of a file of results, if there is one.
///
/// # Errors
/// Says which file cannot be read.
pub fn results(file: &Path) -> Result<Option<Value>, String> {
    match fs::read_to_string(file) {
        Ok(text) => {
            let value = serde_json::from_str(&text);
            value.map_err(|error| format!("{}: {error}", file.display()))
        }
        Err(_) => Ok(None),
    }
}

/// Where the results of a campaign are.
pub fn file(name: &str) -> PathBuf {
    Path::new(RESULTS).join(format!("{name}.json"))
}

fn read_lines(text: &str) -> Result<Vec<Value>, String> {
    let value = |line: &str| serde_json::from_str(line).map_err(|e| format!("{line}: {e}"));
    text.lines().map(value).collect()
}

fn revision(of: &str) -> Option<String> {
    let text = CommandLine::new("git rev-parse").word(of).output()?;
    Some(text.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sources_of_every_campaign_exist() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        for campaign in &CAMPAIGNS {
            for source in campaign.runs.iter().flat_map(|run| run.sources) {
                assert!(root.join(source).exists(), "{}: {source}", campaign.name);
            }
        }
    }

    #[test]
    fn a_damaged_line_of_results_is_named() {
        assert_eq!(read_lines("{\"claim\":\"a\"}\n").map(|all| all.len()), Ok(1));
        assert!(read_lines("{\"claim\"\n").is_err_and(|why| why.contains("claim")));
    }
}
