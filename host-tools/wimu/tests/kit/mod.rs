//! Runs the real `wimu`, always with `--json`, and never for ever.

#![allow(dead_code, reason = "each test file uses its own part of it")]

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use serde_json::Value;
pub use wimu_testkit::spread;

/// No command of a test takes longer, unless something hangs, however busy the machine is.
const PATIENCE: Duration = Duration::from_secs(300);

/// What a command came to.
#[derive(Debug)]
pub struct Ran {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Ran {
    /// Every line of stdout as an object.
    pub fn objects(&self) -> Vec<Value> {
        let object = |line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {self:?}"));
        self.stdout.lines().map(object).collect()
    }

    /// The one object on stdout.
    pub fn object(&self) -> Value {
        let mut objects = self.objects();
        assert_eq!(objects.len(), 1, "one object, in {self:?}");
        objects.remove(0)
    }

    /// The object of a command that has done what it should.
    pub fn succeeds(&self) -> Value {
        assert_eq!(self.code, 0, "{self:?}");
        let object = self.object();
        assert_eq!(object["status"], "ok", "{self:?}");
        object
    }

    /// The object of a command that failed so.
    pub fn fails(&self, exit: i32, code: &str) -> Value {
        assert_eq!(self.code, exit, "{self:?}");
        let object = self.object();
        assert_eq!(object["schema"], "wimu.error/1", "{self:?}");
        assert_eq!(object["status"], "error", "{self:?}");
        assert_eq!(object["code"], code, "{self:?}");
        for key in ["message", "remedy"] {
            let text = object[key].as_str();
            assert!(text.is_some_and(|text| !text.is_empty()), "{key}: {self:?}");
        }
        assert!(
            object.as_object().unwrap().contains_key("where"),
            "{self:?}"
        );
        // People read what went wrong as well.
        assert!(!self.stderr.is_empty() || code == "usage", "{self:?}");
        object
    }
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
    /// What it has said to people so far.
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
        let mut child = Command::new(env!("CARGO_BIN_EXE_wimu"))
            .env("XDG_CONFIG_HOME", config)
            .args(arguments)
            .arg("--json")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("wimu was built");
        let stdout = BufReader::new(child.stdout.take().expect("piped"));
        let mut lines = BufReader::new(child.stderr.take().expect("piped"));
        let stderr = Arc::new(Mutex::new(String::new()));
        let said = stderr.clone();
        // Pipes are emptied meanwhile, so that it never waits for us.
        let errors = thread::spawn(move || {
            let mut line = String::new();
            while lines.read_line(&mut line).is_ok_and(|read| read > 0) {
                said.lock().expect("no panic").push_str(&line);
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

    /// Waits for its next line on stdout.
    pub fn line(&mut self) -> String {
        let start = self.read.len();
        self.stdout.read_line(&mut self.read).expect("text");
        self.read[start..].trim_end().to_owned()
    }

    /// Itself, once it has said something.
    pub fn after_a_line(mut self) -> Self {
        assert!(!self.line().is_empty(), "{} says nothing", self.arguments);
        self
    }

    /// Waits until it has said `text` to people `count` times.
    pub fn says(self, text: &str, count: usize) -> Self {
        wait_until(text, || {
            let said = self.stderr.lock().expect("no panic");
            said.matches(text).count() >= count
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
        let until = Instant::now() + PATIENCE;
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
        let fixed = [
            "simulate",
            "--cable",
            "127.0.0.1:0",
            "--wireless",
            "127.0.0.1:0",
        ];
        let mut process = Background::start(&[&fixed[..], arguments].concat());
        let line = process.line();
        let Ok(listening) = serde_json::from_str::<Value>(&line) else {
            panic!("{line} {:?}", process.finish());
        };
        let link = |role: &str| listening[role].as_str().expect("a link").to_owned();
        Self {
            cable: link("cable"),
            wireless: link("wireless"),
            _process: process,
        }
    }

    /// Records `links` to `file` until it holds `samples` raw samples of each, however long this machine
    /// takes, and returns what the recorder reports.
    #[cfg(unix)]
    pub fn record_samples(&self, links: Links, file: &str, samples: u64) -> Value {
        let both = ["record", &self.wireless, "--cable", &self.cable, "-o", file];
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

/// A folder for one test, gone afterwards.
pub fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a folder")
}

/// A path in a folder of its own.
pub fn in_folder(name: &str) -> (String, tempfile::TempDir) {
    let folder = folder();
    let path = folder.path().join(name);
    (path.to_str().expect("text").to_owned(), folder)
}

/// Waits until something is so.
pub fn wait_until(what: &str, is_so: impl Fn() -> bool) {
    let until = Instant::now() + PATIENCE;
    while !is_so() {
        assert!(Instant::now() < until, "{what}: not in time");
        thread::sleep(Duration::from_millis(20));
    }
}
