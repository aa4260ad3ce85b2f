//! `wimu record`.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;
use wimu_host::authentication::Authentication;
use wimu_host::clock::ClockSummary;
use wimu_host::decode::LinkStatistics;
use wimu_host::recorder::{Progress, Recorder};
use wimu_host::ros::{self, Decoded};
use wimu_host::{LinkUrl, Problem, Result};

use crate::arguments::Record;
use crate::command::{deadline, interrupted, is_over};
use crate::output::Output;

#[derive(Serialize)]
struct Recorded {
    file: String,
    /// Why the recording ended without Ctrl-C or --for.
    ended: Option<Problem>,
    links: Vec<Link>,
    /// Topics that `--decoded` added.
    decoded: Option<Decoded>,
}

#[derive(Serialize)]
struct Link {
    role: String,
    #[serde(flatten)]
    statistics: LinkStatistics,
    clock: Option<ClockSummary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    authentication: Option<Authentication>,
}

pub fn run(arguments: &Record, output: &Output) -> Result<()> {
    let end = deadline(arguments.seconds);
    let stop = interrupted()?;
    let links = arguments.links.iter().map(|link| link.parse());
    let links = links.collect::<Result<Vec<LinkUrl>>>()?;
    let recorder = Recorder::connect(&links)?.with_patience(arguments.reconnect);
    for hello in recorder.hellos() {
        output.print(format!(
            "recording the {} link of {} with {}, device {:016x}; Ctrl-C stops",
            hello.role, hello.board.name, hello.sensor.name, hello.device_id
        ));
    }
    let finished = AtomicBool::new(false);
    let began = Instant::now();
    let mut shown = began;
    let progress = std::thread::scope(|scope| {
        // The deadline holds even while no byte arrives.
        let watch = scope.spawn(|| {
            while !is_over(end, &stop) && !finished.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(20));
            }
            finished.store(true, Ordering::Relaxed);
        });
        let outcome = recorder.run(&arguments.output, &finished, |progress| {
            if shown.elapsed() >= Duration::from_millis(250) {
                shown = Instant::now();
                let time = match arguments.seconds {
                    Some(whole) => format!(
                        "{:.0} of {:.0} s",
                        began.elapsed().as_secs_f64(),
                        whole.as_secs_f64()
                    ),
                    None => format!("{:.0} s", began.elapsed().as_secs_f64()),
                };
                output.refresh(&format!("{time}: {}", summary(progress)));
            }
        });
        finished.store(true, Ordering::Relaxed);
        let _ = watch.join();
        outcome
    })?;
    output.end_refresh();
    output.print(format!("{}: {}", arguments.output.display(), summary(&progress)));
    for link in &progress.links {
        if let Some(clock) = &link.clock {
            output.print(format!("{:8} {}", link.role, clock));
        }
        if let Some(text) = link.authentication.text() {
            output.print(format!("{:8} {text}", link.role));
        }
    }
    let findings = progress.links.iter().flat_map(|link| link.authentication.findings());
    let findings = Vec::from_iter(findings);
    output.findings(&findings);
    let decode = || ros::decode(&arguments.output, &arguments.output, None);
    let decoded = arguments.decoded.then(decode).transpose()?;
    if let Some(decoded) = &decoded {
        let count: u64 = decoded.messages.values().sum();
        output.print(format!("decoded: {count} messages on {} topics", decoded.messages.len()));
        output.findings(&decoded.findings);
    }
    if let Some(error) = &progress.ended {
        output.print(format!(
            "stopped: all links were lost ({}); the file holds everything received",
            error.text
        ));
    }
    let links = progress.links.iter().map(|link| Link {
        role: link.role.to_string(),
        statistics: link.statistics,
        clock: link.clock,
        authentication: Some(link.authentication.clone()).filter(Authentication::is_known),
    });
    let recorded = Recorded {
        file: arguments.output.display().to_string(),
        links: links.collect(),
        decoded,
        ended: progress.ended,
    };
    output.object(&recorded);
    Ok(())
}

fn summary(progress: &Progress) -> String {
    let links: Vec<String> = progress
        .links
        .iter()
        .map(|link| {
            let statistics = &link.statistics;
            format!(
                "{} {} samples, {} bytes, {} missing, {} damaged frames{}{}",
                link.role,
                statistics.raw.received,
                statistics.bytes,
                statistics.raw.missing,
                statistics.frames_damaged,
                left_out_text(statistics.batches_unplaced, statistics.frames_rejected),
                if link.lost.is_some() { ", LOST, reconnecting" } else { "" }
            )
        })
        .collect();
    links.join("; ")
}

/// Text on batches without an epoch that gives their times, and on rejected frames.
pub fn left_out_text(batches: u64, rejected: u64) -> String {
    let mut text = String::new();
    if batches > 0 {
        text += &format!(", {batches} batches without a time reference");
    }
    if rejected > 0 {
        text += &format!(", {rejected} frames rejected (impossible sequence number or time)");
    }
    text
}
