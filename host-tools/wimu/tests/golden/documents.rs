//! The documents: each command line runs as it is printed, `text` blocks hold its output, links and equations exist,
//! and `docs/reference/commands.md` is the help of today.
//!
//! A page is a script in a folder that has `docs/samples`: `wimu simulate` starts a board, whose links take the place of
//! ports 7100 and 7101. A comment `exit code N` states a refusal. `WIMU_WRITE_DOCS=1` writes outputs and the reference.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::{env, fs};

use libtest_mimic::{Failed, Trial};
use serde_json::Value;
use tempfile::TempDir;

use crate::split;

/// Command lines that are not run, by their beginning.
const NOT_RUN: [(&str, &str); 10] = [
    ("git clone", "network"),
    ("cargo install", "builds for minutes"),
    ("rustup", "installs"),
    ("cargo xtask", "has tests and lanes of its own"),
    ("cargo run --release -p wimu-scores", "campaign on recordings that are not in the repository"),
    ("mosquitto", "a broker; the campaign `fleet` runs one"),
    ("wimu fleet", "needs a broker"),
    ("wimu monitor mqtt:", "needs a broker"),
    ("wimu dashboard", "ends by Ctrl-C; the tests of the dashboard start it"),
    ("wimu device flash", "needs a debug probe"),
];

/// Pages whose command lines are run.
const PAGES: [&str; 4] =
    ["docs/start", "docs/how-to", "docs/explanation", "docs/reference/setup.md"];

const REFERENCE: &str = "docs/reference/commands.md";

/// Simulated seconds a second: a minute of poses, or of `--for 60` beside a board, takes six seconds.
const SPEED: f64 = 10.0;

/// Held by the page that has a board: several at this speed would not keep up with their clocks.
static ONE_BOARD: Mutex<()> = Mutex::new(());

/// A check of all documents; the error says what is wrong.
type Check = fn() -> Result<(), String>;

pub fn trials() -> Vec<Trial> {
    let mut trials: Vec<Trial> = pages()
        .into_iter()
        .map(|page| {
            let name = format!("documents: {}", page.display());
            Trial::test(name, move || Page::read(page).check().map_err(Failed::from))
        })
        .collect();
    let checks: [(&str, Check); 3] =
        [("links", links), ("equations", equations), (REFERENCE, reference)];
    for (name, check) in checks {
        trials
            .push(Trial::test(format!("documents: {name}"), move || check().map_err(Failed::from)));
    }
    trials
}

fn pages() -> Vec<PathBuf> {
    let mut pages = vec![PathBuf::from("README.md")];
    for page in PAGES.map(Path::new) {
        if page.is_dir() { pages.extend(files(page, "md")) } else { pages.push(page.into()) }
    }
    pages
}

/// The files of a folder with this extension, without those of folders in it.
fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let entries =
        fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let paths = entries.map(|entry| entry.expect("an entry").path());
    let mut files: Vec<PathBuf> =
        paths.filter(|path| path.extension().is_some_and(|e| e == extension)).collect();
    files.sort();
    files
}

/// Whether generated parts are written.
fn writes() -> bool {
    env::var_os("WIMU_WRITE_DOCS").is_some()
}

struct Page {
    path: PathBuf,
    lines: Vec<String>,
}

/// A fenced block: its language and its lines, as indices.
struct Block {
    language: String,
    first: usize,
    end: usize,
}

impl Page {
    fn read(path: PathBuf) -> Self {
        let text = fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        Self { lines: text.lines().map(str::to_owned).collect(), path }
    }

    fn blocks(&self) -> Vec<Block> {
        let mut blocks = Vec::new();
        let mut open: Option<Block> = None;
        for (number, line) in self.lines.iter().enumerate() {
            let Some(language) = line.trim_start().strip_prefix("```") else { continue };
            match open.take() {
                Some(block) => blocks.push(Block { end: number, ..block }),
                None => {
                    let language = language.trim().to_owned();
                    open = Some(Block { language, first: number + 1, end: 0 });
                }
            }
        }
        blocks
    }

    fn check(mut self) -> Result<(), String> {
        let mut script = Script::new();
        let mut output = String::new();
        let mut outputs = Vec::new();
        for block in self.blocks() {
            let lines = &self.lines[block.first..block.end];
            match block.language.as_str() {
                "sh" => {
                    output.clear();
                    for line in commands(lines) {
                        output += &script.run(&line).map_err(|why| format!("{line}\n{why}"))?;
                    }
                }
                "text" if !holds(&output, lines, false) => outputs.push((block, output.clone())),
                "text approximate" if !holds(&output, lines, true) => {
                    outputs.push((block, output.clone()));
                }
                "" if lines.iter().any(|line| line.trim_start().starts_with("wimu ")) => {
                    return Err(format!(
                        "{}: a command line in a block without `sh`",
                        self.path.display()
                    ));
                }
                _ => (),
            }
        }
        let Some((_, output)) = outputs.first() else { return Ok(()) };
        let difference = format!("{}: the output is now\n{output}", self.path.display());
        if !writes() {
            return Err(difference + "\nWIMU_WRITE_DOCS=1 writes it");
        }
        for (block, output) in outputs.into_iter().rev() {
            let indent = self.lines[block.end].find('`').unwrap_or(0);
            let shown = shown(&output, &self.lines[block.first..block.end]);
            let shown =
                shown.iter().map(|line| format!("{:indent$}{line}", "").trim_end().to_owned());
            self.lines.splice(block.first..block.end, shown);
        }
        fs::write(&self.path, self.lines.join("\n") + "\n").map_err(|error| error.to_string())
    }
}

/// The command lines of a block, without comments except that of the exit code; `\` continues a line.
fn commands(lines: &[String]) -> Vec<String> {
    let text = lines.join("\n").replace("\\\n", " ");
    let lines =
        text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    lines.map(str::to_owned).collect()
}

/// Whether the output has all lines of a block, in their order; `…` stands for any. Digits are not compared if the block is
/// `approximate`: times and identifiers differ from run to run.
fn holds(output: &str, lines: &[String], approximate: bool) -> bool {
    let plain = |line: &str| {
        let digits = |c: char| if approximate && c.is_ascii_digit() { '0' } else { c };
        let mut text: String = line.trim().chars().map(digits).collect();
        while approximate && text.contains("00") {
            text = text.replace("00", "0");
        }
        text
    };
    let mut output = output.lines().map(plain);
    lines.iter().filter(|line| line.trim() != "…").all(|line| {
        let line = plain(line);
        output.any(|found| found == line)
    })
}

/// The lines of an output that are most like those of a block, with `…` for what it leaves out; all if it left out nothing.
fn shown(output: &str, block: &[String]) -> Vec<String> {
    let lines: Vec<&str> = output.lines().collect();
    if !block.iter().any(|line| line.trim() == "…") {
        return lines.iter().map(|&line| line.to_owned()).collect();
    }
    let words = |line: &str| line.replace(|c: char| c.is_ascii_digit(), "0");
    let common = |a: &str, b: &str| {
        words(a.trim()).chars().zip(words(b.trim()).chars()).take_while(|(a, b)| a == b).count()
    };
    let mut kept = BTreeSet::new();
    for old in block.iter().filter(|line| line.trim() != "…") {
        let likely = (0..lines.len()).max_by_key(|&k| (common(old, lines[k]), lines.len() - k));
        kept.extend(likely.filter(|&k| common(old, lines[k]) > 1));
    }
    let mut shown = Vec::new();
    for (k, &line) in lines.iter().enumerate() {
        if kept.contains(&k) {
            shown.push(line.to_owned());
        } else if shown.last().is_none_or(|last| last != "…") {
            shown.push("…".to_owned());
        }
    }
    shown
}

/// `wimu simulate`, stopped at the end of its page.
struct Board {
    program: Child,
    cable: String,
    wireless: String,
    _only: MutexGuard<'static, ()>,
}

impl Board {
    fn start(options: &str) -> Result<Self, String> {
        let only = ONE_BOARD.lock().unwrap_or_else(PoisonError::into_inner);
        let line = format!(
            "simulate {options} --speed {SPEED} --cable 127.0.0.1:0 --wireless 127.0.0.1:0 --json"
        );
        let mut command = Command::new(env!("CARGO_BIN_EXE_wimu"));
        command.args(split(&line)).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut program = command.spawn().map_err(|error| error.to_string())?;
        let mut first = String::new();
        let stdout = program.stdout.as_mut().ok_or("no output")?;
        BufReader::new(stdout).read_line(&mut first).map_err(|error| error.to_string())?;
        let envelope: Value = serde_json::from_str(&first).map_err(|error| error.to_string())?;
        let link = |name: &str| envelope["data"][name].as_str().unwrap_or_default().to_owned();
        Ok(Self { program, cable: link("cable"), wireless: link("wireless"), _only: only })
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}

/// What the command lines of a page share.
struct Script {
    folder: TempDir,
    board: Option<Board>,
}

impl Script {
    fn new() -> Self {
        let folder = TempDir::new().expect("a temporary folder");
        let samples = folder.path().join("docs/samples");
        fs::create_dir_all(&samples).expect("writable");
        for sample in files(Path::new("docs/samples"), "csv") {
            let name = sample.file_name().expect("a file");
            fs::copy(&sample, samples.join(name)).expect("writable");
        }
        Self { folder, board: None }
    }

    /// Runs a line of a block and returns its standard output.
    fn run(&mut self, line: &str) -> Result<String, String> {
        let (line, comment) = line.split_once(" #").unwrap_or((line, ""));
        let line = line.trim();
        let words =
            line.strip_prefix("cargo ").filter(|rest| rest.starts_with("wimu ")).unwrap_or(line);
        if NOT_RUN.iter().any(|(start, _)| words.starts_with(start)) {
            return Ok(String::new());
        }
        let Some(words) = words.strip_prefix("wimu ") else {
            return Err("no command of wimu: run it, or name it in NOT_RUN".to_owned());
        };
        if let Some(options) = words.strip_prefix("simulate") {
            self.board = None;
            self.board = Some(Board::start(options)?);
            return Ok(String::new());
        }
        let mut words = words.to_owned();
        if let Some(board) = &self.board {
            words = words.replace("tcp://127.0.0.1:7100", &board.cable);
            words = words.replace("tcp://127.0.0.1:7101", &board.wireless);
        }
        let mut words = split(&words);
        if let Some(at) =
            words.iter().position(|word| word == "--for").filter(|_| self.board.is_some())
        {
            let seconds: f64 = words[at + 1].parse().map_err(|_| "--for without a number")?;
            words[at + 1] = (seconds / SPEED).to_string();
        }
        let mut command = Command::new(env!("CARGO_BIN_EXE_wimu"));
        command.args(words).current_dir(self.folder.path()).stdin(Stdio::null());
        command.env("XDG_CONFIG_HOME", self.folder.path()).env("APPDATA", self.folder.path());
        let ran = command.output().map_err(|error| error.to_string())?;
        let expected: i32 = comment
            .split_once("exit code ")
            .and_then(|(_, code)| code.get(..1)?.parse().ok())
            .unwrap_or(0);
        let text = String::from_utf8_lossy(&ran.stdout).into_owned();
        let refusal = String::from_utf8_lossy(&ran.stderr);
        if ran.status.code() != Some(expected) {
            return Err(format!("{}, not exit code {expected}\n{text}{refusal}", ran.status));
        }
        // A refusal is what such a line is shown for.
        Ok(if expected == 0 { text } else { text + &refusal })
    }
}

/// Every relative link of the documents, with its heading.
fn links() -> Result<(), String> {
    let mut wrong = String::new();
    let folders = [
        "docs/reference",
        "docs/reference/boards",
        "docs/reference/equations",
        "docs/samples",
        "docs",
    ];
    let mut documents = pages();
    documents.extend(folders.iter().flat_map(|folder| files(Path::new(folder), "md")));
    documents.push("CONTRIBUTING.md".into());
    for path in documents {
        let text = fs::read_to_string(&path).map_err(|error| error.to_string())?;
        for link in text.split("](").skip(1).filter_map(|rest| rest.split([')', ' ', '\n']).next())
        {
            if link.contains("://") || link.starts_with("mailto:") {
                continue;
            }
            let (file, heading) = link.split_once('#').unwrap_or((link, ""));
            let folder = path.parent().expect("a folder");
            let target = if file.is_empty() { path.clone() } else { folder.join(file) };
            if !target.exists() || (!heading.is_empty() && !has_heading(&target, heading)) {
                let _ = writeln!(wrong, "{}: {link}", path.display());
            }
        }
    }
    if wrong.is_empty() { Ok(()) } else { Err(format!("no such file or heading:\n{wrong}")) }
}

/// Whether a document has a heading with this fragment, as GitHub makes it.
fn has_heading(path: &Path, fragment: &str) -> bool {
    let slug = |heading: &str| {
        let kept = heading.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
        kept.collect::<String>().to_lowercase().replace(' ', "-")
    };
    let text = fs::read_to_string(path).unwrap_or_default();
    text.lines()
        .filter(|line| line.starts_with('#'))
        .any(|line| slug(line.trim_start_matches('#').trim()) == fragment)
}

/// Every equation is cited by code, alone or in a range, and every `equation (N)` of code is defined.
fn equations() -> Result<(), String> {
    let mut defined = BTreeMap::new();
    for page in files(Path::new("docs/reference/equations"), "md") {
        let text = fs::read_to_string(&page).map_err(|error| error.to_string())?;
        for line in text.lines() {
            // `**(1) Name**`, `- **(70) Name**` or `- (200) Text`.
            let start =
                ["- **(", "**(", "- ("].into_iter().find_map(|start| line.strip_prefix(start));
            let number = start.and_then(|rest| rest.split_once(')')).map(|(number, _)| number);
            let Some(number) = number.filter(|number| is_number(number)) else { continue };
            if let Some(other) = defined.insert(number.to_owned(), page.clone()) {
                return Err(format!("({number}) is in {} and {}", other.display(), page.display()));
            }
        }
    }
    let mut cited = BTreeSet::new();
    let mut wrong = String::new();
    for folder in ["crates", "host-tools"] {
        for source in sources(Path::new(folder)) {
            let text = fs::read_to_string(&source).map_err(|error| error.to_string())?;
            for line in text.lines().filter(|line| line.contains("//")) {
                for number in numbers(line, &defined) {
                    let is_named = line.contains(&format!("quation ({number})"))
                        || line.contains(&format!("quations ({number})"));
                    if is_named && !defined.contains_key(&number) {
                        let _ = writeln!(wrong, "{} cites ({number})", source.display());
                    }
                    cited.insert(number);
                }
            }
        }
    }
    for (number, page) in defined.iter().filter(|(number, _)| !cited.contains(*number)) {
        let _ = writeln!(wrong, "no code cites ({number}) of {}", page.display());
    }
    if wrong.is_empty() { Ok(()) } else { Err(wrong) }
}

fn is_number(text: &str) -> bool {
    let digits = text.strip_suffix(|c: char| c.is_ascii_lowercase()).unwrap_or(text);
    !digits.is_empty() && digits.len() <= 3 && digits.chars().all(|c| c.is_ascii_digit())
}

/// The numbers in parentheses of a line; `(10) to (19)` has all defined ones between.
fn numbers(line: &str, defined: &BTreeMap<String, PathBuf>) -> Vec<String> {
    let mut numbers: Vec<String> = Vec::new();
    let mut before = "";
    for part in line.split('(').skip(1) {
        let Some((number, rest)) = part.split_once(')').filter(|(n, _)| is_number(n)) else {
            continue;
        };
        if [" to ", "–"].contains(&before)
            && let Some(Ok(first)) = numbers.last().map(|first| first.parse::<u16>())
            && let Ok(last) = number.parse::<u16>()
        {
            numbers
                .extend((first..last).map(|n| n.to_string()).filter(|n| defined.contains_key(n)));
        }
        numbers.push(number.to_owned());
        before = rest;
    }
    numbers
}

/// The Rust sources of a folder and of those in it, and the front pages of crates.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut found = files(folder, "rs");
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() && !path.ends_with("target") {
            found.extend(sources(&path));
        }
    }
    found
}

/// The help of every command, and that every option which the documents name is in it.
fn reference() -> Result<(), String> {
    let mut made = "\
# Commands

The help of every command, written by `cargo xtask reference`. `-h` shows the frequent options only.
"
    .to_owned();
    describe(&mut Vec::new(), &mut made)?;
    if writes() {
        fs::write(REFERENCE, &made).map_err(|error| error.to_string())?;
    }
    if fs::read_to_string(REFERENCE).unwrap_or_default() != made {
        return Err("it is not the help of today: `cargo xtask reference` writes it".to_owned());
    }
    let mut wrong = String::new();
    for page in pages() {
        let text = fs::read_to_string(&page).map_err(|error| error.to_string())?;
        for code in
            text.split('`').filter(|code| code.starts_with("--") || code.starts_with("wimu "))
        {
            let options = code
                .split([' ', '=', '\n'])
                .filter(|word| word.starts_with("--") && word.len() > 2);
            for option in options.filter(|option| !made.contains(*option)) {
                let _ = writeln!(wrong, "{}: {option}", page.display());
            }
        }
    }
    if wrong.is_empty() { Ok(()) } else { Err(format!("no command has these options:\n{wrong}")) }
}

/// Appends the help of a command and of those under it.
fn describe(words: &mut Vec<String>, out: &mut String) -> Result<(), String> {
    let ran = Command::new(env!("CARGO_BIN_EXE_wimu")).args(&*words).arg("--help").output();
    let help = String::from_utf8(ran.map_err(|error| error.to_string())?.stdout);
    let help = help.map_err(|error| error.to_string())?;
    let title = [&["wimu".to_owned()], &words[..]].concat().join(" ");
    let _ = write!(out, "\n## {title}\n\n```text\n{}\n```\n", help.trim_end());
    let names = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    let names = names.take_while(|line| line.starts_with("  "));
    let names: Vec<String> = names
        .filter_map(|line| line.strip_prefix("  ")?.split(' ').next().map(str::to_owned))
        .collect();
    for name in names.iter().filter(|name| !name.is_empty() && *name != "help") {
        words.push(name.clone());
        describe(words, out)?;
        words.pop();
    }
    Ok(())
}
