//! A gateway in a process of its own, its broker, and many replayed boards.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;

use serde_json::Value;
use wimu_host::client::{Client, ConnectOptions};
use wimu_host::transport::{self, Transport};

use super::Background;

mod boards;
mod broker;
mod tape;

pub use boards::{Boards, name};
pub use broker::{Foreign, Mosquitto, SlowLine};
pub use tape::{Found, Tape, files};

/// Resident memory of a process, bytes, and the processor time it has used, s.
pub fn usage(pid: u32) -> (f64, f64) {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap_or_default();
    let kilobytes: f64 =
        resident.split_whitespace().next().and_then(|text| text.parse().ok()).unwrap_or_default();
    (kilobytes * 1024.0, processor_time(&format!("/proc/{pid}")))
}

/// Processor time of the threads of this process that have a name, s.
pub fn threads_usage(name: &str) -> f64 {
    let threads = fs::read_dir("/proc/self/task").expect("Linux").flatten();
    let named = threads.map(|thread| thread.path()).filter(|path| {
        fs::read_to_string(path.join("comm")).is_ok_and(|found| found.trim() == name)
    });
    named.map(|path| processor_time(&path.display().to_string())).sum()
}

fn processor_time(folder: &str) -> f64 {
    let stat = fs::read_to_string(format!("{folder}/stat")).unwrap_or_default();
    let fields: Vec<f64> = stat
        .rsplit(')')
        .next()
        .unwrap_or_default()
        .split_whitespace()
        .map(|text| text.parse().unwrap_or(0.0))
        .collect();
    // utime and stime in ticks of 10 ms, the 14th and 15th field of all.
    let ticks = fields.get(11).unwrap_or(&0.0) + fields.get(12).unwrap_or(&0.0);
    ticks * 0.01
}

/// A gateway in a process of its own.
pub struct Gateway {
    process: Background,
    metrics: String,
}

impl Gateway {
    pub fn start(folder: &Path, config: &str) -> Self {
        Self::start_in(folder, config, "")
    }

    /// With variables of its environment.
    pub fn start_in(folder: &Path, config: &str, variables: &str) -> Self {
        let file = folder.join("fleet.toml");
        fs::write(&file, config).expect("written");
        // A file that may not grow is an error and not the end.
        let script = format!("trap '' XFSZ; {variables} exec \"$0\" \"$@\"");
        let program = ["sh", "-c", &script];
        let mut process = Background::start_by(
            &program,
            Path::new("/nonexistent"),
            &["fleet", "gateway", "--config", file.to_str().expect("text")],
        );
        let line = process.line();
        let Ok(started) = serde_json::from_str::<Value>(&line) else {
            panic!("{line} {:?}", process.finish());
        };
        Self {
            process,
            metrics: started["data"]["metrics"].as_str().unwrap_or_default().to_owned(),
        }
    }

    /// Sum of a metric over the boards.
    pub fn metric(&self, name: &str) -> f64 {
        let mut text = String::new();
        let mut stream = TcpStream::connect(&self.metrics).expect("metrics");
        write!(stream, "GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n").expect("a request");
        stream.read_to_string(&mut text).expect("an answer");
        assert!(text.starts_with("HTTP/1.1 200 OK"), "{text}");
        let values = text
            .lines()
            .filter(|line| !line.starts_with('#') && line.split(['{', ' ']).next() == Some(name));
        let values: Vec<f64> = values
            .map(|line| line.rsplit(' ').next().expect("a value").parse().expect("a number"))
            .collect();
        assert!(!values.is_empty(), "{name} in {text}");
        values.iter().sum()
    }

    /// A client of the metrics that never ends its request.
    pub fn slow_client(&self) -> TcpStream {
        let mut stream = TcpStream::connect(&self.metrics).expect("metrics");
        write!(stream, "GET /metrics HTTP/1.1\r\nHost:").expect("a request");
        stream
    }

    /// Stops it as Ctrl-C does; returns its sums.
    pub fn stop(self) -> Value {
        let ran = self.process.signal("-INT");
        assert_eq!(ran.code, 0, "{ran:?}");
        ran.objects().pop().expect("an object")
    }

    /// Kills it.
    pub fn kill(self) {
        self.process.signal("-KILL");
    }

    pub fn pid(&self) -> u32 {
        self.process.id()
    }
}

/// A client of the board at a LINK.
pub fn client(link: &str) -> wimu_host::Result<Client<Box<dyn Transport + Send>>> {
    let transport = transport::open(&link.parse()?)?;
    Client::connect(transport, link, ConnectOptions::default())
}
