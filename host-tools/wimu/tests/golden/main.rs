//! Expected outputs of the command: the cases of `tests/golden/*.toml`, run in this process through [`wimu::run`].
//!
//! `cargo test -p wimu --test golden -- PART` runs the cases whose name contains PART. `tests/golden/README.md` describes
//! the files. The documents are checked as well: `-- documents`.

mod board;
mod documents;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::sync::{Arc, Mutex, OnceLock};
use std::{env, fs};

use libtest_mimic::{Arguments, Failed, Trial};
use serde::Deserialize;
use serde_json::{Value, json};
use tempfile::TempDir;
use wimu::{Output, run};

use crate::board::Board;

/// Recordings that other projects published, beside the repository.
const DATA: &str = "../shared/data";

/// Folder of the configuration, as of a user without keys.
const CONFIG: &str = concat!(env!("CARGO_TARGET_TMPDIR"), "/golden-config");

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
    /// Parts of the texts and remedies of problems, notes too.
    #[serde(default)]
    texts: Vec<String>,
    /// Expected values by their path in `data` (`axes.0.bias`), of streaming commands in the last object.
    #[serde(default)]
    values: BTreeMap<String, Expected>,
    /// Expected values of tables and other texts in `{tmp}`, by paths in what [`table`] makes of them.
    #[serde(default)]
    tables: BTreeMap<String, BTreeMap<String, Expected>>,
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
    if env::var_os("XDG_CONFIG_HOME").is_none_or(|folder| folder != CONFIG) {
        return run_as_another_user();
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    env::set_current_dir(&root).expect("the repository");
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
    let trials = trials.chain(documents::trials()).collect();
    libtest_mimic::run(&Arguments::from_args(), trials).exit_code()
}

/// Runs this program again with [`CONFIG`]: threads of a process share its environment, which must not change.
fn run_as_another_user() -> ExitCode {
    let _ = fs::remove_dir_all(CONFIG);
    let mut command = Command::new(env::current_exe().expect("this program"));
    command.args(env::args_os().skip(1)).envs([("XDG_CONFIG_HOME", CONFIG), ("APPDATA", CONFIG)]);
    let status = command.status().expect("this program");
    if status.success() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
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
        for (name, values) in &self.tables {
            let text = fs::read_to_string(folder.path().join(name)).unwrap_or_default();
            wrong += &wrong_values(values, &table(&text), &format!("{name}: "));
        }
        if wrong.is_empty() { Ok(()) } else { Err(format!("`wimu {last}`\n{wrong}{}", ran.stderr)) }
    }

    /// What differs from the expectation, one line each.
    fn differences(&self, ran: &Ran) -> String {
        let mut wrong = String::new();
        if ran.code != ExitCode::from(self.exit) {
            let _ = writeln!(wrong, "exit code {:?}, not {}", ran.code, self.exit);
        }
        let texts = serde_json::to_string(&ran.problems).unwrap_or_default();
        for part in self.texts.iter().filter(|part| !texts.contains(*part)) {
            let _ = writeln!(wrong, "no problem says {part:?}: {texts}");
        }
        if let Some(expected) = &self.problems {
            let codes = ran.problem_codes();
            if codes != *expected {
                let _ = writeln!(wrong, "problems {codes:?}, not {expected:?}");
            }
        }
        wrong + &wrong_values(&self.values, &ran.data, "")
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

/// The values that are not as expected, one line each.
fn wrong_values(values: &BTreeMap<String, Expected>, data: &Value, place: &str) -> String {
    let mut wrong = String::new();
    for (path, expected) in values {
        let found = at(data, path);
        if !expected.holds(found, data) {
            let _ = writeln!(wrong, "{place}{path} is {found}, not {expected}");
        }
    }
    wrong
}

/// A CSV table: `header`, number of `rows`, fields of the `first` and `last` row, root mean square of each column, and
/// mean magnitude (`norm`) of columns 1 to 3, which follow the time.
fn table(text: &str) -> Value {
    let header = text.lines().next().unwrap_or_default();
    let rows: Vec<Vec<f64>> = (text.lines().skip(1))
        .map(|line| line.split(',').map(|field| field.parse().unwrap_or(f64::NAN)).collect())
        .collect();
    let mean = |of: &dyn Fn(&Vec<f64>) -> f64| rows.iter().map(of).sum::<f64>() / rows.len() as f64;
    let square =
        |row: &Vec<f64>, column| row.get(column).map_or(f64::NAN, |value: &f64| value * value);
    let columns = 0..header.split(',').count();
    let rms: Vec<f64> = columns.map(|column| mean(&|row| square(row, column)).sqrt()).collect();
    let norm = mean(&|row| (1..4).map(|column| square(row, column)).sum::<f64>().sqrt());
    let (first, last) = (rows.first(), rows.last());
    json!({"header": header, "rows": rows.len(), "first": first, "last": last, "rms": rms, "norm": norm})
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
    let mut words = split(line);
    words.push("--json".to_owned());
    words
}

/// The words of a command line, separated by spaces except between double quotes.
fn split(line: &str) -> Vec<String> {
    let mut words = Vec::new();
    for (number, part) in line.split('"').enumerate() {
        if number % 2 == 1 {
            words.push(part.to_owned());
        } else {
            words.extend(part.split_whitespace().map(str::to_owned));
        }
    }
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
    const LINES: [&str; 2] =
        ["demo --report {}/accelerometer.html", "demo --chip lsm6dso --report {}/gyroscope.html"];
    static FOLDER: OnceLock<String> = OnceLock::new();
    FOLDER.get_or_init(|| made("golden-demo", &LINES))
}

/// A folder with the walks of `wimu demo --localize`, made once: ranges, anchors, a unit on a shoe, fixes.
fn walks() -> &'static str {
    const LINES: [&str; 1] = ["demo --localize {}"];
    static FOLDER: OnceLock<String> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = made("golden-walks", &LINES);
        write_faulty(Path::new(&folder));
        folder
    })
}

/// Rows of columns 0 to 6 of a walk with a fault, of the gyroscope in columns 4 to 6.
type Fault = fn(rows: &mut [Vec<f64>]);

/// Writes copies of `walk.csv` with faults.
fn write_faulty(folder: &Path) {
    const FAULTS: [(&str, Fault); 5] = [
        ("dead", |rows| rows.iter_mut().for_each(|row| row[4..].fill(0.0))),
        ("swapped", |rows| rows.iter_mut().for_each(|row| row.swap(4, 5))),
        ("negated", |rows| rows.iter_mut().for_each(|row| row[6] = -row[6])),
        ("late", |rows| {
            for k in (5..rows.len()).rev() {
                rows[k] = [&rows[k][..4], &rows[k - 5][4..]].concat();
            }
        }),
        ("lost", |rows| {
            for k in 3500..rows.len() - 50 {
                rows[k] = [&rows[k][..1], &rows[k + 50][1..]].concat();
            }
        }),
    ];
    let walk = fs::read_to_string(folder.join("walk.csv")).expect("the walk was written");
    let (header, rows) = walk.split_once('\n').expect("a header");
    let number = |field: &str| field.parse::<f64>().expect("a number");
    let rows: Vec<Vec<f64>> =
        rows.lines().map(|row| row.split(',').map(number).collect()).collect();
    for (name, inject) in FAULTS {
        let mut faulty = rows.clone();
        inject(&mut faulty);
        let line = |row: &Vec<f64>| row.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
        let lines: Vec<String> = faulty.iter().map(line).collect();
        let text = format!("{header}\n{}\n", lines.join("\n"));
        fs::write(folder.join(format!("{name}.csv")), text).expect("the folder is writable");
    }
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
