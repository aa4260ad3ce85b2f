//! The chores of this repository: `cargo xtask --help`.

mod budget;
mod campaign;
mod command_line;
mod firmware;
mod image;
mod instructions;
mod miri;
mod output;
mod panics;
mod profile;
mod python;
mod setup;
mod size;
mod test;
mod validation;
mod workspace;

use std::process::ExitCode;

use workspace::Workspace;

/// What was asked for.
#[derive(Debug, PartialEq)]
enum Task {
    Help,
    Setup,
    /// Names of the steps to run; all of them when empty.
    Check(Vec<String>),
    Test(Vec<String>),
    /// The name of a campaign, and its seed.
    Campaign(String, u64),
    Validation,
    /// A folder of recordings.
    Budget(Option<String>),
    Firmware,
    /// The name of a board, and options of `wimu flash`.
    Flash(String, Vec<String>),
    Size,
    Python,
    Miri,
    /// Options of the emulated board.
    Qemu(Vec<String>),
}

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let task = match parse(&words) {
        Ok(task) => task,
        Err(problem) => {
            eprintln!("error: {problem}\n\n{}", help());
            return ExitCode::from(2);
        }
    };
    match run(task) {
        Ok(()) => ExitCode::SUCCESS,
        Err(problem) => {
            eprintln!("\nerror: {problem}");
            ExitCode::FAILURE
        }
    }
}

fn run(task: Task) -> Result<(), String> {
    let enter = Workspace::enter;
    match task {
        Task::Help => {
            println!("{}", help());
            Ok(())
        }
        Task::Setup => setup::run(),
        Task::Check(only) => test::run(&enter()?, &test::CHECK, &only),
        Task::Test(only) => test::run(&enter()?, &test::TEST, &only),
        Task::Campaign(name, seed) => enter().and_then(|_| campaign::run(&name, seed)),
        Task::Validation => enter().and_then(|_| validation::write()),
        Task::Budget(data) => budget::run(&enter()?, data.as_deref()),
        Task::Firmware => firmware::run(&enter()?),
        Task::Flash(board, options) => firmware::flash(&enter()?, &board, &options),
        Task::Size => size::run(&enter()?),
        Task::Python => enter().and_then(|_| python::run()),
        Task::Miri => enter().and_then(|_| miri::run()),
        Task::Qemu(options) => enter().and_then(|_| firmware::qemu(&options)),
    }
}

fn parse(words: &[String]) -> Result<Task, String> {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    // What follows `qemu` is for the emulated board to understand.
    if let ["qemu", options @ ..] = &words[..] {
        return Ok(Task::Qemu(options.iter().map(ToString::to_string).collect()));
    }
    if words.iter().any(|w| ["help", "-h", "--help"].contains(w)) {
        return Ok(Task::Help);
    }
    match words[..] {
        [] => Err("no task given".into()),
        ["setup"] => Ok(Task::Setup),
        ["check"] => Ok(Task::Check(Vec::new())),
        ["check", "--only", names] => steps_named(&test::CHECK, names).map(Task::Check),
        ["test"] => Ok(Task::Test(Vec::new())),
        ["test", "--only", names] => steps_named(&test::TEST, names).map(Task::Test),
        ["check" | "test", "--only"] => Err("--only needs the name of a step".into()),
        ["campaign", name] => campaign::known(name).map(|name| Task::Campaign(name.into(), 0)),
        ["campaign", name, "--seed", seed] => {
            let seed = seed.parse().map_err(|_| format!("no seed: `{seed}`"))?;
            campaign::known(name).map(|name| Task::Campaign(name.into(), seed))
        }
        ["campaign"] => Err(format!("campaign needs a name: {}", campaign::names())),
        ["validation"] => Ok(Task::Validation),
        ["budget"] => Ok(Task::Budget(None)),
        ["budget", folder] if !folder.starts_with('-') => Ok(Task::Budget(Some(folder.into()))),
        ["firmware"] => Ok(Task::Firmware),
        ["flash"] => Err("flash needs the name of a board: microbit-v2 or pico-adxl345".into()),
        ["flash", board, ref options @ ..] if !board.starts_with('-') => {
            Ok(Task::Flash(board.into(), options.iter().map(ToString::to_string).collect()))
        }
        ["size"] => Ok(Task::Size),
        ["python"] => Ok(Task::Python),
        ["miri"] => Ok(Task::Miri),
        [
            "setup" | "check" | "test" | "campaign" | "validation" | "budget" | "firmware"
            | "flash" | "size" | "python" | "miri",
            extra,
            ..,
        ] => Err(format!("`{}` does not take `{extra}`", words[0])),
        [unknown, ..] => Err(format!("there is no task `{unknown}`")),
    }
}

fn steps_named(lane: &test::Lane, names: &str) -> Result<Vec<String>, String> {
    names
        .split(',')
        .map(|name| {
            let known = lane.steps.iter().any(|step| step.name == name);
            known.then(|| name.to_owned()).ok_or_else(|| format!("there is no step `{name}`"))
        })
        .collect()
}

fn help() -> String {
    let steps = |lane: &test::Lane| -> String {
        let line = |step: &test::Step| format!("\n    {:<11} {}", step.name, step.about);
        lane.steps.iter().map(line).collect()
    };
    let (check, test) = (steps(&test::CHECK), steps(&test::TEST));
    let campaigns: String = campaign::CAMPAIGNS
        .iter()
        .map(|campaign| format!("\n    {:<11} {}", campaign.name, campaign.about))
        .collect();
    format!(
        "\
Usage: cargo xtask TASK

  setup                 find or install what the tests need
  check                 what is run before each commit: some minutes
  test                  everything that must hold before a change is kept
  … --only STEP,…       just these steps of `check` or `test`
  campaign NAME         statistics in release, to docs/validation/NAME.json; commands whose results
                        are there and not stale, and passed, are left out; --seed N draws other numbers
  validation            render docs/VALIDATION.md from docs/validation
  budget [DATA]         print the measured figures: bytes on the wire, accuracy, instructions per
                        sample in QEMU, and fail where one is past its bar;
                        recordings come from the folder DATA (default {}, if there)
  firmware              build every board; target/firmware gets microbit-v2.hex and
                        pico-adxl345.uf2, to be copied onto the boards' drives
  flash BOARD [OPTION]… build a board and write it through its debug probe, with `wimu flash` and
                        its options: --probe, --erase-all
  size                  build every board, and print the flash and RAM it takes, by crate; fail where
                        it is more than it may be
  python                build the wheel of the Python module, install it in target/python, and run all
                        its tests
  miri                  run the fast tests of the crates under Miri, if it is installed
  qemu [OPTION VALUE]…  start the board in QEMU in real time with a moving sensor, and print its
                        links; Ctrl-C stops it; `qemu --help` lists the options

Steps of `check`, in order:{check}

Steps of `test`, in order:{test}

Campaigns:{campaigns}

`setup` installs when it runs as root or with CI=true, and otherwise prints the command to run.
With CI=true cargo also gets --locked. CARGO_TARGET_DIR, CARGO_TERM_COLOR and NO_COLOR are respected.
Exit codes: 0 done, 1 failed, 2 wrong usage.

Example: cargo xtask test --only format,clippy",
        budget::DATA
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(line: &str) -> Result<Task, String> {
        let words: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
        parse(&words)
    }

    #[test]
    fn each_task_is_understood() {
        assert_eq!(parsed("setup"), Ok(Task::Setup));
        assert_eq!(parsed("test"), Ok(Task::Test(vec![])));
        assert_eq!(parsed("check"), Ok(Task::Check(vec![])));
        assert_eq!(parsed("campaign storage"), Ok(Task::Campaign("storage".into(), 0)));
        assert_eq!(parsed("campaign storage --seed 3"), Ok(Task::Campaign("storage".into(), 3)));
        assert_eq!(parsed("validation"), Ok(Task::Validation));
        assert_eq!(parsed("budget"), Ok(Task::Budget(None)));
        assert_eq!(parsed("budget data"), Ok(Task::Budget(Some("data".into()))));
        assert_eq!(parsed("firmware"), Ok(Task::Firmware));
        assert_eq!(parsed("size"), Ok(Task::Size));
        assert_eq!(parsed("python"), Ok(Task::Python));
        assert_eq!(parsed("flash microbit-v2"), Ok(Task::Flash("microbit-v2".into(), vec![])));
        assert_eq!(
            parsed("flash pico-adxl345 --erase-all"),
            Ok(Task::Flash("pico-adxl345".into(), vec!["--erase-all".into()]))
        );
        assert_eq!(parsed("qemu --seed 2"), Ok(Task::Qemu(vec!["--seed".into(), "2".into()])));
        assert_eq!(
            parsed("test --only format,clippy"),
            Ok(Task::Test(vec!["format".into(), "clippy".into()]))
        );
    }

    #[test]
    fn help_can_be_asked_for_anywhere() {
        for line in ["--help", "help", "-h", "test --help", "test --only --help"] {
            assert_eq!(parsed(line), Ok(Task::Help), "{line}");
        }
    }

    #[test]
    fn what_is_not_understood_is_named() {
        for (line, named) in [
            ("", "no task"),
            ("tset", "`tset`"),
            ("setup now", "`now`"),
            ("test clippy", "`clippy`"),
            ("campaign", "calibration"),
            ("campaign calibartion", "`calibartion`"),
            ("test --only", "--only"),
            ("test --only clipy", "`clipy`"),
            ("test --only clippy doc", "`--only`"),
            ("budget --fast", "`--fast`"),
            ("firmware qemu-mps2", "`qemu-mps2`"),
            ("flash", "microbit-v2"),
        ] {
            let problem = parsed(line).expect_err(line);
            assert!(problem.contains(named), "{line}: {problem}");
        }
    }

    #[test]
    fn help_names_every_step() {
        let help = help();
        for step in test::TEST.steps.iter().chain(test::CHECK.steps) {
            assert!(help.contains(&format!("\n    {} ", step.name)), "{}", step.name);
        }
    }
}
