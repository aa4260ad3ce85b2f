//! Expected outputs of the command: the cases of `tests/golden/*.toml`, run in this process through [`wimu::run`].
//!
//! `cargo test -p wimu --test golden -- PART` runs the cases whose name contains PART. `tests/golden/README.md` describes
//! the files.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Arc, Mutex, OnceLock, mpsc};
use std::{fs, thread};

use libtest_mimic::{Arguments, Failed, Trial};
use serde::Deserialize;
use serde_json::Value;
use tempfile::TempDir;
use wimu::{Output, run};

/// Recordings that other projects published, beside the repository.
const DATA: &str = "../shared/data";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Group {
    case: Vec<Case>,
}

/// A command line and what it must put out.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    name: String,
    /// Command lines, without `wimu` and `--json`. The last is checked; those before it must end with exit code 0.
    run: Vec<String>,
    /// Input files by name, written to `{tmp}`.
    #[serde(default)]
    files: BTreeMap<String, String>,
    /// Arguments of `simulate`; its links are `{cable}` and `{wireless}`.
    board: Option<String>,
    #[serde(default)]
    exit: u8,
    /// Codes of all warnings and errors, in any order; not compared if absent.
    problems: Option<BTreeSet<String>>,
    /// Expected values by their path in `data` (`axes.0.bias`), of streaming commands in the last object.
    #[serde(default)]
    values: BTreeMap<String, Expected>,
    /// First lines of text files in `{tmp}`.
    #[serde(default)]
    headers: BTreeMap<String, String>,
    /// What is wrong, of a case that must fail until it is repaired.
    known_failure: Option<String>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Expected {
    /// A number and its tolerance.
    Near(f64, f64),
    /// A number and the path of its standard deviation: equal within 1 % of that.
    WithSd(f64, String),
    /// At least, at most.
    Range {
        min: Option<f64>,
        max: Option<f64>,
    },
    Exact(Value),
}

fn main() -> ExitCode {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    std::env::set_current_dir(&root).expect("the repository");
    let mut files: Vec<PathBuf> = fs::read_dir("tests/golden")
        .expect("tests/golden")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "toml"))
        .collect();
    files.sort();
    let trials = files.iter().flat_map(|path| {
        let text = fs::read_to_string(path).expect("a readable file");
        let group: Group =
            toml::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let trial = |case: Case| Trial::test(format!("{name}: {}", case.name), || check(case));
        group.case.into_iter().map(trial).collect::<Vec<_>>()
    });
    let trials = trials.collect();
    libtest_mimic::run(&Arguments::from_args(), trials).exit_code()
}

fn check(case: Case) -> Result<(), Failed> {
    if case.needs_data() && !Path::new(DATA).is_dir() {
        println!("skipped, there is no {DATA}: {}", case.name);
        return Ok(());
    }
    match (&case.known_failure, case.outcome()) {
        (None, outcome) => outcome.map_err(Failed::from),
        (Some(_), Err(_)) => Ok(()),
        (Some(reason), Ok(())) => {
            Err(format!("passes now: remove known_failure = \"{reason}\"").into())
        }
    }
}

impl Case {
    fn needs_data(&self) -> bool {
        self.run.iter().any(|line| line.contains("{data}"))
    }

    fn outcome(&self) -> Result<(), String> {
        let folder = TempDir::new().map_err(|error| error.to_string())?;
        for (name, text) in &self.files {
            fs::write(folder.path().join(name), text).map_err(|error| error.to_string())?;
        }
        let board = self.board.as_deref().map(Board::start);
        let fill = |line: &String| filled(line, folder.path(), board.as_ref());
        let lines: Vec<String> = self.run.iter().map(fill).collect();
        let (last, before) = lines.split_last().ok_or("no command line")?;
        for line in before {
            let ran = Ran::of(line);
            if ran.code != ExitCode::SUCCESS {
                return Err(format!("`wimu {line}`: {ran:?}"));
            }
        }
        let ran = Ran::of(last);
        let mut wrong = self.differences(&ran);
        for (name, header) in &self.headers {
            let text = fs::read_to_string(folder.path().join(name)).unwrap_or_default();
            let first = text.lines().next().unwrap_or_default();
            if first != header {
                let _ = writeln!(wrong, "{name} begins with `{first}`, not `{header}`");
            }
        }
        if wrong.is_empty() { Ok(()) } else { Err(format!("`wimu {last}`\n{wrong}{}", ran.stderr)) }
    }

    /// What differs from the expectation, one line each.
    fn differences(&self, ran: &Ran) -> String {
        let mut wrong = String::new();
        if ran.code != ExitCode::from(self.exit) {
            let _ = writeln!(wrong, "exit code {:?}, not {}", ran.code, self.exit);
        }
        if let Some(expected) = &self.problems {
            let codes = ran.problem_codes();
            if codes != *expected {
                let _ = writeln!(wrong, "problems {codes:?}, not {expected:?}");
            }
        }
        for (path, expected) in &self.values {
            let found = at(&ran.data, path);
            if !expected.holds(found, &ran.data) {
                let _ = writeln!(wrong, "{path} is {found}, not {expected}");
            }
        }
        wrong
    }
}

impl Expected {
    fn holds(&self, found: &Value, data: &Value) -> bool {
        let near = |value: f64, tolerance: f64| {
            found.as_f64().is_some_and(|found| (found - value).abs() <= tolerance)
        };
        match self {
            Self::Near(value, tolerance) => near(*value, *tolerance),
            Self::WithSd(value, sd) => {
                at(data, sd).as_f64().is_some_and(|sd| near(*value, 0.01 * sd))
            }
            Self::Range { min, max } => found.as_f64().is_some_and(|found| {
                min.is_none_or(|min| found >= min) && max.is_none_or(|max| found <= max)
            }),
            Self::Exact(value) => value == found,
        }
    }
}

impl std::fmt::Display for Expected {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Near(value, tolerance) => write!(out, "{value} ± {tolerance}"),
            Self::WithSd(value, sd) => write!(out, "{value} ± 1 % of {sd}"),
            Self::Range { min, max } => write!(out, "from {min:?} to {max:?}"),
            Self::Exact(value) => write!(out, "{value}"),
        }
    }
}

/// The value at a path such as `axes.0.bias`; `null` where there is none.
fn at<'a>(data: &'a Value, path: &str) -> &'a Value {
    data.pointer(&format!("/{}", path.replace('.', "/"))).unwrap_or(&Value::Null)
}

/// What a command put out.
#[derive(Debug)]
struct Ran {
    code: ExitCode,
    /// Of the last object with data.
    data: Value,
    problems: Vec<Value>,
    stderr: String,
}

impl Ran {
    /// Runs a command line; spaces separate its words, except between double quotes.
    fn of(line: &str) -> Self {
        let (stdout, stderr) = (Memory::default(), Memory::default());
        let code = run(words(line), &mut Output::to(stdout.clone(), stderr.clone()));
        let mut ran = Self { code, data: Value::Null, problems: Vec::new(), stderr: stderr.text() };
        for line in stdout.text().lines() {
            let envelope: Value = serde_json::from_str(line)
                .unwrap_or_else(|error| panic!("{error} in the output `{line}`"));
            assert_eq!(envelope["schema"], "wimu/1");
            ran.problems.extend(envelope["problems"].as_array().into_iter().flatten().cloned());
            if !envelope["data"].is_null() {
                ran.data = envelope["data"].clone();
            }
        }
        ran
    }

    /// Codes of warnings and errors.
    fn problem_codes(&self) -> BTreeSet<String> {
        let severe = self.problems.iter().filter(|problem| problem["severity"] != "note");
        severe.filter_map(|problem| Some(problem["code"].as_str()?.to_owned())).collect()
    }
}

fn words(line: &str) -> Vec<String> {
    let mut words = Vec::new();
    for (number, part) in line.split('"').enumerate() {
        if number % 2 == 1 {
            words.push(part.to_owned());
        } else {
            words.extend(part.split_whitespace().map(str::to_owned));
        }
    }
    words.push("--json".to_owned());
    words
}

/// Output kept in memory.
#[derive(Clone, Default)]
struct Memory(Arc<Mutex<Vec<u8>>>);

impl Memory {
    fn text(&self) -> String {
        String::from_utf8_lossy(&self.0.lock().expect("no panic")).into_owned()
    }
}

impl Write for Memory {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().expect("no panic").extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A simulated board that runs until this process ends.
struct Board {
    cable: String,
    wireless: String,
}

impl Board {
    fn start(options: &str) -> Self {
        /// Passes each line on.
        struct Lines(mpsc::Sender<String>);

        impl Write for Lines {
            fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
                let _ = self.0.send(String::from_utf8_lossy(bytes).into_owned());
                Ok(bytes.len())
            }

            fn flush(&mut self) -> std::io::Result<()> {
                Ok(())
            }
        }

        let line = format!("simulate --cable 127.0.0.1:0 --wireless 127.0.0.1:0 {options}");
        let (sender, receiver) = mpsc::channel();
        thread::spawn(move || run(words(&line), &mut Output::to(Lines(sender), std::io::sink())));
        let first = receiver.recv().expect("the links");
        let envelope: Value = serde_json::from_str(&first).expect("an object");
        let link = |name: &str| envelope["data"][name].as_str().expect("a LINK").to_owned();
        Self { cable: link("cable"), wireless: link("wireless") }
    }
}

/// A command line with its placeholders replaced.
fn filled(line: &str, tmp: &Path, board: Option<&Board>) -> String {
    let mut line = line.replace("{tmp}", &tmp.display().to_string()).replace("{data}", DATA);
    if let Some(Board { cable, wireless }) = board {
        line = line.replace("{cable}", cable).replace("{wireless}", wireless);
    }
    if line.contains("{demo}") {
        line = line.replace("{demo}", demo());
    }
    if line.contains("{walks}") {
        line = line.replace("{walks}", walks());
    }
    line
}

/// A folder with `accelerometer.mcap` and `gyroscope.mcap` of `wimu demo`, made once.
fn demo() -> &'static str {
    static FOLDER: OnceLock<String> = OnceLock::new();
    FOLDER.get_or_init(|| {
        made(
            "golden-demo",
            &[
                "demo --report {}/accelerometer.html",
                "demo --sensor lsm6dso --report {}/gyroscope.html",
            ],
        )
    })
}

/// A folder with the walks of `wimu demo --localize`, made once: ranges, anchors, a unit on a shoe, fixes.
fn walks() -> &'static str {
    static FOLDER: OnceLock<String> = OnceLock::new();
    FOLDER.get_or_init(|| {
        made("golden-walks", &["demo --localize --files {} --report {}/localize.html"])
    })
}

/// A new folder in the target folder, with what these commands write to it.
fn made(name: &str, lines: &[&str]) -> String {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("the target folder is writable");
    let folder = folder.display().to_string();
    for line in lines {
        let line = line.replace("{}", &folder);
        let ran = Ran::of(&line);
        assert_eq!(ran.code, ExitCode::SUCCESS, "`wimu {line}`: {ran:?}");
    }
    folder
}
