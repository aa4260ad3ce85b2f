//! `wimu record`.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;
use wimu_host::clock::ClockSummary;
use wimu_host::decode::LinkStatistics;
use wimu_host::recorder::{Progress, Recorder};
use wimu_host::ros::{self, Decoded};
use wimu_host::{ErrorCode, HostError, LinkUrl, Result};

use crate::arguments::Record;
use crate::command::export::say_left_out;
use crate::command::{deadline, interrupted, is_over};
use crate::output::Output;

#[derive(Serialize)]
struct Recorded {
    schema: &'static str,
    status: &'static str,
    file: String,
    /// Why it ended by itself.
    ended: Option<HostError>,
    links: Vec<Link>,
    /// What `--decoded` added.
    decoded: Option<Decoded>,
}

#[derive(Serialize)]
struct Link {
    role: String,
    #[serde(flatten)]
    statistics: LinkStatistics,
    clock: Option<ClockSummary>,
}

pub fn run(arguments: &Record, output: Output) -> Result<()> {
    let end = deadline(arguments.seconds)?;
    let stop = interrupted()?;
    let links = [Some(&arguments.link), arguments.cable.as_ref()]
        .into_iter()
        .flatten()
        .map(|link| link.parse::<LinkUrl>())
        .collect::<Result<Vec<_>>>()?;
    let patience = Duration::try_from_secs_f64(arguments.reconnect).map_err(|_| {
        HostError::new(
            ErrorCode::Usage,
            format!("--reconnect {} is no time", arguments.reconnect),
            "give seconds, 0 or more",
        )
    })?;
    let recorder = Recorder::connect(&links)?.with_patience(patience);
    for hello in recorder.hellos() {
        output.say(format!(
            "recording the {} link of {} with {}, device {:016x}; Ctrl-C ends it",
            hello.role, hello.board.name, hello.sensor.name, hello.device_id
        ));
    }
    let finished = AtomicBool::new(false);
    let mut shown = Instant::now();
    let progress = std::thread::scope(|scope| {
        // The clock must be watched even while no byte comes.
        let watch = scope.spawn(|| {
            while !is_over(end, &stop) && !finished.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(20));
            }
            finished.store(true, Ordering::Relaxed);
        });
        let outcome = recorder.run(&arguments.output, &finished, |progress| {
            if shown.elapsed() >= Duration::from_millis(250) {
                shown = Instant::now();
                output.refresh(&summary(progress));
            }
        });
        finished.store(true, Ordering::Relaxed);
        let _ = watch.join();
        outcome
    })?;
    output.end_refresh();
    output.say(format!(
        "{}: {}",
        arguments.output.display(),
        summary(&progress)
    ));
    for link in &progress.links {
        if let Some(clock) = &link.clock {
            output.say(format!("{:8} {}", link.role, clock_text(clock)));
        }
    }
    let decoded = match arguments.decoded {
        true => Some(ros::decode(&arguments.output, &arguments.output, None)?),
        false => None,
    };
    if let Some(decoded) = &decoded {
        let count: u64 = decoded.messages.values().sum();
        output.say(format!(
            "decoded: {count} messages on {} topics",
            decoded.messages.len()
        ));
        say_left_out(decoded, output);
    }
    if let Some(error) = &progress.ended {
        output.say(format!(
            "ended: no link has come back ({}); what they brought is in the file",
            error.message()
        ));
    }
    output.object(&Recorded {
        schema: "wimu.record/1",
        status: "ok",
        file: arguments.output.display().to_string(),
        links: progress
            .links
            .iter()
            .map(|link| Link {
                role: link.role.to_string(),
                statistics: link.statistics,
                clock: link.clock,
            })
            .collect(),
        decoded,
        ended: progress.ended,
    });
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
                if link.lost.is_some() {
                    ", LOST: trying again"
                } else {
                    ""
                }
            )
        })
        .collect();
    links.join("; ")
}

/// What is said of batches whose place no epoch tells, at the end of a recording too, and of frames
/// that were rejected.
pub fn left_out_text(batches: u64, rejected: u64) -> String {
    let mut text = String::new();
    if batches > 0 {
        text += &format!(", {batches} batches whose place no epoch tells");
    }
    if rejected > 0 {
        text += &format!(", {rejected} frames rejected: their number or time is impossible");
    }
    text
}

/// A clock in a line, two standard deviations.
pub fn clock_text(clock: &ClockSummary) -> String {
    let rate = format!(
        "device clock {:.1} ± {:.1} ppm {}",
        clock.rate_ppm.abs(),
        2.0 * clock.rate_sd_ppm,
        if clock.rate_ppm > 0.0 { "slow" } else { "fast" }
    );
    match clock.offset_bound_ms {
        Some(bound) => {
            let sd = 2.0 * clock.offset_sd_ms;
            format!(
                "{rate}; its times in host time to {sd:.2} ms if both directions take equally long, to {:.2} ms in any case",
                bound.max(sd)
            )
        }
        None => format!("{rate}; its times are late by what the fastest transfer took"),
    }
}
