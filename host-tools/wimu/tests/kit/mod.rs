//! Runs the real `wimu`, always with `--json` and with a time limit, and compares its text with snapshots.

#![allow(dead_code, reason = "each test file uses its own part of it")]

#[cfg(target_os = "linux")]
pub mod fleet;

use std::cell::RefCell;
use std::fmt::{Display, Write};
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use serde_json::Value;
use wimu_host::calibration::read_parameters;
use wimu_model::ParameterSet;
use wimu_sim::board::{Board, BoardConfig, SensorPart};
use wimu_sim::motion;
use wimu_sim::scenario::Host;
use wimu_sim::scene::{Scene, World};
use wimu_sim::source::Physics;
use wimu_sim::truth::Gauge;
pub use wimu_testkit::spread;

/// Time limit of a command: far beyond what a busy machine needs, so that only a hang reaches it.
const TIME_LIMIT: Duration = Duration::from_secs(300);

/// Result of a command.
#[derive(Debug)]
pub struct Ran {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Ran {
    /// Every line of stdout: `{schema, command, data, problems}`.
    fn envelopes(&self) -> Vec<Value> {
        let envelope = |line| {
            let value: Value =
                serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {self:?}"));
            assert_eq!(value["schema"], "wimu/1", "{self:?}");
            value
        };
        self.stdout.lines().map(envelope).collect()
    }

    /// The data of every object on stdout that has some.
    pub fn objects(&self) -> Vec<Value> {
        let data = self.envelopes().into_iter().map(|mut envelope| envelope["data"].take());
        data.filter(|data| !data.is_null()).collect()
    }

    /// The problems of all objects on stdout.
    pub fn problems(&self) -> Vec<Value> {
        let all = self.envelopes().into_iter().map(|mut envelope| envelope["problems"].take());
        all.flat_map(|problems| problems.as_array().cloned().unwrap_or_default()).collect()
    }

    /// The data of the one object on stdout, with its `problems`.
    pub fn object(&self) -> Value {
        let mut envelopes = self.envelopes();
        assert_eq!(envelopes.len(), 1, "one object, in {self:?}");
        let mut envelope = envelopes.remove(0);
        let mut data = envelope["data"].take();
        if data.is_object() {
            data["problems"] = envelope["problems"].take();
        }
        data
    }

    /// Asserts success; returns the object.
    pub fn succeeds(&self) -> Value {
        assert_eq!(self.code, 0, "{self:?}");
        self.object()
    }

    /// Asserts a report that the data support no answer: exit code 3, a problem `no_result` with its text.
    pub fn refuses(&self) -> Value {
        assert_eq!(self.code, 3, "{self:?}");
        let object = self.object();
        assert!(!reason(&object).is_empty(), "{self:?}");
        assert!(!self.stderr.is_empty(), "{self:?}");
        object
    }

    /// The error at the end of a command.
    pub fn error(&self) -> Value {
        let last = self.envelopes().pop().unwrap_or_else(|| panic!("no object: {self:?}"));
        assert!(last["data"].is_null(), "{self:?}");
        let problems = last["problems"].as_array().cloned().unwrap_or_default();
        problems.last().cloned().unwrap_or_else(|| panic!("no error: {self:?}"))
    }

    /// Asserts a failure with this exit code and error code; returns the problem.
    pub fn fails(&self, exit: i32, code: &str) -> Value {
        assert_eq!(self.code, exit, "{self:?}");
        let error = self.error();
        assert_eq!(
            (&error["code"], &error["severity"]),
            (&code.into(), &"error".into()),
            "{self:?}"
        );
        for key in ["text", "remedy"] {
            let text = error[key].as_str();
            assert!(text.is_some_and(|text| !text.is_empty()), "{key}: {self:?}");
        }
        // The text for people is not missing either.
        assert!(!self.stderr.is_empty() || code == "usage", "{self:?}");
        error
    }
}

/// Text of a family of commands. Exit codes and JSON are asserted when a case is added; the wording is
/// compared with `snapshots/NAME.snap`.
#[derive(Default)]
pub struct Transcript(String);

impl Transcript {
    fn case(&mut self, case: impl Display, outcome: impl Display, text: &str) {
        writeln!(self.0, "## {case}: {outcome}\n{}\n", text.trim_end()).expect("memory");
    }

    /// Adds all that a command printed for people.
    pub fn text(&mut self, case: impl Display, ran: &Ran) {
        self.case(case, format_args!("exit {}", ran.code), &ran.stderr);
    }

    /// Adds a command that fails with this exit code and error code; returns the object.
    pub fn fails(&mut self, case: impl Display, ran: &Ran, exit: i32, code: &str) -> Value {
        let object = ran.fails(exit, code);
        self.case(case, format_args!("exit {exit}, {code}"), &ran.stderr);
        object
    }

    /// Adds the reason of a command that refuses the data; returns the report.
    pub fn refuses(&mut self, case: impl Display, ran: &Ran) -> Value {
        let report = ran.refuses();
        self.case(case, "exit 3, refused", &reason(&report));
        report
    }

    /// Adds the findings of a command that succeeds; returns the object.
    pub fn findings(&mut self, case: impl Display, ran: &Ran) -> Value {
        let object = ran.succeeds();
        self.list(case, findings(&object));
        object
    }

    /// Adds a list of texts.
    pub fn list(&mut self, case: impl Display, texts: impl IntoIterator<Item = impl Display>) {
        let lines: String = texts.into_iter().map(|text| format!("- {text}\n")).collect();
        let none = if lines.is_empty() { "none" } else { "listed" };
        self.case(case, none, &lines);
    }

    /// The text so far.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Compares with the snapshot of this name.
    pub fn check(&self, name: &str) {
        snapshot(name, &self.0, &[]);
    }

    /// Compares with the snapshot of this name, numbers and column widths left out: they differ from run to
    /// run where a command talks to a running board.
    pub fn check_live(&self, name: &str) {
        const NUMBERS: &[(&str, &str)] =
            &[(r"[-+−]?\d+(\.\d+)?(e[-+]?\d+)?", "#"), (" {2,}", "  ")];
        snapshot(name, &self.0, NUMBERS);
    }
}

/// The findings of a report or, of a recording, of the path in it, as texts; without a refusal, which is its reason.
pub fn findings(object: &Value) -> Vec<String> {
    let all = object["problems"].as_array().unwrap_or_else(|| panic!("no problems in {object}"));
    let text = |finding: &Value| {
        let part = |key: &str| finding[key].as_str().unwrap_or_default().to_owned();
        assert!(!part("code").is_empty(), "{object}");
        let [severity, evidence, remedy] = ["severity", "text", "remedy"].map(part);
        match remedy.as_str() {
            "" => format!("{severity}: {evidence}"),
            _ => format!("{severity}: {evidence}; {remedy}"),
        }
    };
    let remarks = all.iter().filter(|finding| finding["code"] != "no_result");
    remarks.map(text).collect()
}

/// The reason of a refusal; empty without one.
pub fn reason(object: &Value) -> String {
    let mut problems = object["problems"].as_array().into_iter().flatten();
    let refusal = problems.rfind(|problem| problem["code"] == "no_result");
    refusal.and_then(|refusal| refusal["text"].as_str()).unwrap_or_default().to_owned()
}

/// Compares text with `snapshots/NAME.snap`. What differs between machines and runs is replaced, by
/// [`FILTERS`] and then by `more`.
pub fn snapshot(name: &str, text: &str, more: &[(&str, &str)]) {
    compare(name, text, FILTERS.iter().chain(more));
}

/// Folders, ports, numbers of full precision, the sign of zero, ids, times and numbers of system errors.
const FILTERS: &[(&str, &str)] = &[
    (r"[^\s`'\x22=:,]*/\.tmp\w{6}/", ""),
    (r"127\.0\.0\.1:\d{5}\b", "ADDRESS"),
    (r"\d+\.\d{10,}(e[-+]?\d+)?", "#"),
    (r"[-+](0\.0+)\b", "$1"),
    (r"\b[0-9a-f]{16}\b", "DEVICE"),
    (r"\b[0-9a-f]{8}\b", "ID"),
    (r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d(\.\d+)?)?( UTC|Z)?", "TIME"),
    (r"[A-Z][a-z]{2}, \d\d [A-Z][a-z]{2} \d{4} \d\d:\d\d:\d\d GMT", "TIME"),
    (r"\(os error \d+\)", "(os error N)"),
];

fn compare<'a>(name: &str, text: &str, filters: impl IntoIterator<Item = &'a (&'a str, &'a str)>) {
    let mut settings = insta::Settings::new();
    settings.set_snapshot_path("../snapshots");
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    for (pattern, replacement) in filters {
        settings.add_filter(pattern, *replacement);
    }
    settings.bind(|| insta::assert_snapshot!(name, text));
}

/// Runs `wimu --json` with these arguments to its end.
pub fn wimu(arguments: &[&str]) -> Ran {
    Background::start(arguments).finish()
}

/// A `wimu --json` that runs beside the test; it is killed when dropped.
pub struct Background {
    child: Child,
    stdout: BufReader<ChildStdout>,
    read: String,
    /// What it has printed for people so far.
    stderr: Arc<Mutex<String>>,
    errors: Option<JoinHandle<()>>,
    arguments: String,
}

impl Background {
    /// As a user who has no keys.
    pub fn start(arguments: &[&str]) -> Self {
        Self::start_as(Path::new("/nonexistent"), arguments)
    }

    /// As a user whose configuration is in `config`.
    pub fn start_as(config: &Path, arguments: &[&str]) -> Self {
        Self::start_by(&[], config, arguments)
    }

    /// The same through a program that executes its last arguments.
    pub fn start_by(program: &[&str], config: &Path, arguments: &[&str]) -> Self {
        let words = [program, &[env!("CARGO_BIN_EXE_wimu")], arguments].concat();
        let mut child = Command::new(words[0])
            .env("XDG_CONFIG_HOME", config)
            .args(&words[1..])
            .arg("--json")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("wimu was built");
        let stdout = BufReader::new(child.stdout.take().expect("piped"));
        let mut lines = BufReader::new(child.stderr.take().expect("piped"));
        let stderr = Arc::new(Mutex::new(String::new()));
        let printed = stderr.clone();
        // Both pipes are emptied while it runs: a full one would block it.
        let errors = thread::spawn(move || {
            let mut line = String::new();
            while lines.read_line(&mut line).is_ok_and(|read| read > 0) {
                printed.lock().expect("no panic").push_str(&line);
                line.clear();
            }
        });
        Self {
            child,
            stdout,
            read: String::new(),
            stderr,
            errors: Some(errors),
            arguments: arguments.join(" "),
        }
    }

    /// Number of its process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Waits for its next line on stdout.
    pub fn line(&mut self) -> String {
        let start = self.read.len();
        self.stdout.read_line(&mut self.read).expect("text");
        self.read[start..].trim_end().to_owned()
    }

    /// Waits for its first line on stdout.
    pub fn after_a_line(mut self) -> Self {
        assert!(!self.line().is_empty(), "{} prints nothing", self.arguments);
        self
    }

    /// Waits until what it has printed for people contains `text` `count` times.
    pub fn prints(self, text: &str, count: usize) -> Self {
        wait_until(text, || {
            let printed = self.stderr.lock().expect("no panic");
            printed.matches(text).count() >= count
        });
        self
    }

    /// Sends it a signal by its name and waits for its end.
    #[cfg(unix)]
    pub fn signal(self, signal: &str) -> Ran {
        let id = self.child.id().to_string();
        let sent = Command::new("kill").args([signal, &id]).status();
        assert!(sent.is_ok_and(|status| status.success()));
        self.finish()
    }

    /// Waits for its end.
    pub fn finish(mut self) -> Ran {
        let until = Instant::now() + TIME_LIMIT;
        let child = &mut self.child;
        let (stdout, read) = (&mut self.stdout, &mut self.read);
        let status = thread::scope(|scope| {
            let output = scope.spawn(move || stdout.read_to_string(read));
            let status = loop {
                match child.try_wait().expect("a child") {
                    Some(status) => break status,
                    None if Instant::now() > until => {
                        child.kill().expect("a child");
                        child.wait().expect("a child");
                        panic!("wimu {} does not end", self.arguments);
                    }
                    None => thread::sleep(Duration::from_millis(5)),
                }
            };
            output.join().expect("no panic").expect("text");
            status
        });
        self.errors.take().map(JoinHandle::join);
        Ran {
            code: status.code().unwrap_or(-1),
            stdout: std::mem::take(&mut self.read),
            stderr: std::mem::take(&mut self.stderr.lock().expect("no panic")),
        }
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A `wimu simulate` on free ports.
pub struct Simulator {
    pub cable: String,
    pub wireless: String,
    _process: Background,
}

impl Simulator {
    pub fn start(arguments: &[&str]) -> Self {
        let fixed = ["simulate", "--cable", "127.0.0.1:0", "--wireless", "127.0.0.1:0"];
        let mut process = Background::start(&[&fixed[..], arguments].concat());
        let line = process.line();
        let Ok(listening) = serde_json::from_str::<Value>(&line) else {
            panic!("{line} {:?}", process.finish());
        };
        let link = |role: &str| listening["data"][role].as_str().expect("a link").to_owned();
        Self { cable: link("cable"), wireless: link("wireless"), _process: process }
    }

    /// Records `links` to `file` until it holds `samples` raw samples of each, however long this machine
    /// takes, and returns what the recorder reports.
    #[cfg(unix)]
    pub fn record_samples(&self, links: Links, file: &str, samples: u64) -> Value {
        let both = ["record", &self.wireless, &self.cable, "-o", file];
        let arguments = match links {
            Links::Both => &both[..],
            Links::Cable => &["record", &self.cable, "-o", file],
            Links::Wireless => &["record", &self.wireless, "-o", file],
        };
        record_until(Background::start(arguments), file, |link| {
            link["raw_samples"].as_u64() >= Some(samples)
        })
    }

    /// Records its cable to `file` until it is gone, as one with `--exit-when-done` is.
    pub fn record_to_the_end(&self, file: &str) {
        let record = ["record", &self.cable, "-o", file, "--reconnect", "0.5"];
        Background::start(&record).finish().succeeds();
    }
}

/// Records both links of a simulated board through these motions to their end, in virtual time: the same
/// file in every run. The recorder itself is tested in `recording` and `session`.
pub fn record_motion(motion: &str, seed: u64, file: &str) {
    record_motion_of(SensorPart::Lsm303agr, motion, seed, file);
}

/// The same with this sensor on the board.
pub fn record_motion_of(sensor: SensorPart, motion: &str, seed: u64, file: &str) {
    record_board(sensor, motion, seed, file, None);
}

/// The same after a push of the calibration in `pushed`.
pub fn record_calibrated(sensor: SensorPart, pushed: &str, motion: &str, seed: u64, file: &str) {
    let set = read_parameters(pushed.as_ref()).expect("a calibration");
    record_board(sensor, motion, seed, file, Some(&set));
}

fn record_board(
    sensor: SensorPart,
    motion: &str,
    seed: u64,
    file: &str,
    pushed: Option<&ParameterSet>,
) {
    let scene = Scene::new(World::default());
    let truth = sensor.random_truth(seed, Gauge::LowerTriangular);
    let source = Physics::new(truth, scene.clone(), seed);
    let device_id = 0x5157_0000 + seed; // as that of `wimu simulate --seed`
    let config = BoardConfig { sensor, device_id, ..BoardConfig::default() };
    let board = RefCell::new(Board::start(config, source));
    let mut host = Host::connect(&board, scene.clone()).expect("a board");
    if let Some(set) = pushed {
        host.cable.push_parameters(set).expect("a push");
    }
    let motion = motion::named(motion, seed).expect("a known motion");
    let duration_s = motion.duration();
    let begin_s = scene.play(host.now_s(), motion);
    host.run_until(begin_s + duration_s).expect("a board");
    fs::write(file, host.file().expect("a recording")).expect("written");
}

/// Which links of a board are recorded.
#[derive(Clone, Copy)]
pub enum Links {
    Both,
    Cable,
    Wireless,
}

/// Ends a recording once `is_enough` holds of every link in its `file`, as `info` describes it.
#[cfg(unix)]
pub fn record_until(
    recording: Background,
    file: &str,
    is_enough: impl Fn(&Value) -> bool,
) -> Value {
    wait_until("enough in the file", || {
        thread::sleep(Duration::from_millis(200));
        let info = wimu(&["info", file]);
        info.code == 0
            && info.object()["links"]
                .as_array()
                .is_some_and(|links| !links.is_empty() && links.iter().all(&is_enough))
    });
    recording.signal("-INT").succeeds()
}

/// Noise of variance 1, the same in every run.
pub fn noise() -> impl FnMut() -> f64 {
    let mut state = 1_u64;
    move || {
        let mut sum = -6.0;
        for _ in 0..12 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            sum += (state >> 11) as f64 / (1_u64 << 53) as f64;
        }
        sum
    }
}

/// A value of `--setup`.
pub fn setup(key: &str, value: impl Display) -> &'static str {
    format!("{key}={value}").leak()
}

/// A folder for one test, gone afterwards.
pub fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a folder")
}

/// A new folder in the target folder, for what several tests of one run share.
pub fn kept_folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("the target folder is writable");
    folder
}

/// A path in a folder of its own.
pub fn in_folder(name: &str) -> (String, tempfile::TempDir) {
    let folder = folder();
    let path = folder.path().join(name);
    (path.to_str().expect("text").to_owned(), folder)
}

/// Waits until a condition holds.
pub fn wait_until(what: &str, mut holds: impl FnMut() -> bool) {
    let until = Instant::now() + TIME_LIMIT;
    while !holds() {
        assert!(Instant::now() < until, "{what}: not in time");
        thread::sleep(Duration::from_millis(20));
    }
}

/// A Python with `rosbags` in it, kept for the next run; `None`, with the reason printed, without one.
pub fn python_with_rosbags() -> Option<std::path::PathBuf> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("rosbags");
    let python = folder.join("bin/python");
    let works = |command: &mut std::process::Command| {
        let ran = command.output();
        ran.is_ok_and(|ran| ran.status.success())
    };
    let mut import = std::process::Command::new(&python);
    if works(import.args(["-c", "import rosbags"])) {
        return Some(python);
    }
    let mut make = std::process::Command::new("python3");
    let mut install = std::process::Command::new(&python);
    let made = works(make.args(["-m", "venv"]).arg(&folder))
        && works(install.args(["-m", "pip", "install", "--quiet", "rosbags"]));
    if !made {
        println!("skipped: python3 with venv, pip and a network is needed for `rosbags`");
    }
    made.then_some(python)
}
