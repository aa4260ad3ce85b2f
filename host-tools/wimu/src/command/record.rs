//! `wimu record`.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;
use wimu_host::decode::LinkStatistics;
use wimu_host::recorder::{Progress, Recorder};
use wimu_host::{LinkUrl, Result};

use crate::arguments::Record;
use crate::command::{deadline, interrupted, is_over};
use crate::output::Output;

#[derive(Serialize)]
struct Recorded {
    schema: &'static str,
    status: &'static str,
    file: String,
    links: Vec<Link>,
}

#[derive(Serialize)]
struct Link {
    role: String,
    #[serde(flatten)]
    statistics: LinkStatistics,
}

pub fn run(arguments: &Record, output: Output) -> Result<()> {
    let end = deadline(arguments.seconds)?;
    let stop = interrupted()?;
    let links = [Some(&arguments.link), arguments.cable.as_ref()]
        .into_iter()
        .flatten()
        .map(|link| link.parse::<LinkUrl>())
        .collect::<Result<Vec<_>>>()?;
    let recorder = Recorder::connect(&links)?;
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
    if let Some((role, error)) = progress.failures.into_iter().next() {
        output.say(format!(
            "the {role} link failed; what it brought is in the file"
        ));
        return Err(error);
    }
    output.object(&Recorded {
        schema: "wimu.record/1",
        status: "ok",
        file: arguments.output.display().to_string(),
        links: progress
            .links
            .iter()
            .map(|(role, statistics)| Link {
                role: role.to_string(),
                statistics: *statistics,
            })
            .collect(),
    });
    Ok(())
}

fn summary(progress: &Progress) -> String {
    let links: Vec<String> = progress
        .links
        .iter()
        .map(|(role, statistics)| {
            format!(
                "{role} {} samples, {} bytes, {} missing, {} damaged frames",
                statistics.raw.received,
                statistics.bytes,
                statistics.raw.missing,
                statistics.frames_damaged
            )
        })
        .collect();
    links.join("; ")
}
