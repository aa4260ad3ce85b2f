//! `wimu device report-bug`: one file for those who look for the fault.

use std::fmt::Write as _;
use std::thread;
use std::time::{Duration, Instant};

use serde::Serialize;
use wimu_host::transport::{self, Port};
use wimu_host::{LinkUrl, OutputFile, Problem, Result};

use crate::arguments::ReportBug;
use crate::command::connect;
use crate::command::info::Live;
use crate::output::{Output, usage};

/// Time between two entries of received bytes.
const ENTRY: Duration = Duration::from_millis(100);

/// The file. It has no key: keys are never sent.
#[derive(Serialize)]
struct BugReport {
    schema: &'static str,
    wimu: &'static str,
    os: &'static str,
    processor: &'static str,
    /// Serial ports of this computer.
    ports: Vec<Port>,
    links: Vec<Link>,
}

#[derive(Default, Serialize)]
struct Link {
    link: String,
    /// What the board answers; null with the error if it does not.
    device: Option<Live>,
    error: Option<Problem>,
    /// Why bytes ended before their time.
    lost: Option<Problem>,
    bytes: usize,
    received: Vec<Received>,
}

/// Bytes of about 100 ms.
#[derive(Serialize)]
struct Received {
    time_ms: u128,
    hex: String,
}

#[derive(Serialize)]
struct Written {
    file: String,
    bytes: Vec<usize>,
}

pub fn run(arguments: &ReportBug, output: &Output) -> Result<()> {
    let links = arguments.links.iter().map(|link| link.parse());
    let links = links.collect::<Result<Vec<LinkUrl>>>()?;
    output.print(format!(
        "listening for {:.0} s; do what shows the fault",
        arguments.seconds.as_secs_f64()
    ));
    let links: Vec<Link> = thread::scope(|scope| {
        let listen = |link| scope.spawn(move || Link::of(link, arguments.seconds));
        let threads: Vec<_> = links.iter().map(listen).collect();
        let joined = threads.into_iter().map(thread::ScopedJoinHandle::join);
        joined.filter_map(std::result::Result::ok).collect()
    });
    for link in &links {
        match (&link.device, &link.error) {
            (Some(device), _) => output.print(device.text()),
            (None, Some(error)) => output.print(format!("no answer: {error}")),
            (None, None) => {}
        }
        output.print(format!("{} bytes from {}", link.bytes, link.link));
    }
    let report = BugReport {
        schema: "wimu.bug_report/1",
        wimu: env!("CARGO_PKG_VERSION"),
        os: std::env::consts::OS,
        processor: std::env::consts::ARCH,
        ports: transport::ports().unwrap_or_default(),
        links,
    };
    let text = serde_json::to_string_pretty(&report)
        .map_err(|error| usage(error.to_string(), "report this as a fault of wimu"))?;
    OutputFile::write(&arguments.output, text)?;
    output.print(format!(
        "wrote {}: attach it to an issue, with what you expected and what happened. It has no key",
        arguments.output.display()
    ));
    let written = Written {
        file: arguments.output.display().to_string(),
        bytes: report.links.iter().map(|link| link.bytes).collect(),
    };
    output.object(&written);
    Ok(())
}

impl Link {
    fn of(link: &LinkUrl, length: Duration) -> Self {
        let name = link.to_string();
        let (device, error) = match connect(&name).and_then(|mut client| Live::of(&mut client)) {
            Ok(device) => (Some(device), None),
            Err(error) => (None, Some(error)),
        };
        let mut found = Self { link: name, device, error, ..Self::default() };
        found.lost = found.listen(link, length).err();
        found
    }

    fn listen(&mut self, link: &LinkUrl, length: Duration) -> Result<()> {
        let mut transport = transport::open(link)?;
        let begun = Instant::now();
        let mut buffer = [0; 4096];
        while begun.elapsed() < length {
            let count = transport.read(&mut buffer, ENTRY)?;
            if count == 0 {
                continue;
            }
            self.bytes += count;
            let time_ms = begun.elapsed().as_millis();
            let is_new = |last: &Received| time_ms - last.time_ms >= ENTRY.as_millis();
            if self.received.last().is_none_or(is_new) {
                let hex = String::new();
                self.received.push(Received { time_ms, hex });
            }
            if let Some(entry) = self.received.last_mut() {
                for byte in &buffer[..count] {
                    let _ = write!(entry.hex, "{byte:02x}");
                }
            }
        }
        Ok(())
    }
}
