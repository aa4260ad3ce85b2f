//! Poses of a live board with instructions in text.

use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::mpsc;
use std::time::Duration;

use wimu_calib::Face;
use wimu_host::Result;
use wimu_host::calibration::CalibrateOptions;
use wimu_host::guided::{DEFAULT_FILE, LivePoses, News, Plan, poses_file};
use wimu_host::recording::Recording;

use crate::arguments::Calibrate;
use crate::command::{Connection, interrupted};
use crate::output::Output;

/// A message for each line `s` that is entered; none if stdin is no terminal.
fn skips() -> mpsc::Receiver<()> {
    let (sender, receiver) = mpsc::channel();
    if std::io::IsTerminal::is_terminal(&std::io::stdin()) {
        std::thread::spawn(move || {
            for line in std::io::stdin().lines().map_while(std::result::Result::ok) {
                if line.trim() == "s" && sender.send(()).is_err() {
                    return;
                }
            }
        });
    }
    receiver
}

/// Collects a live board's samples with instructions in text, until enough poses were captured, or Ctrl-C. With an
/// output file, the poses are saved beside it.
pub fn collect(
    client: &mut Connection,
    arguments: &Calibrate,
    options: &CalibrateOptions,
    output: &Output,
) -> Result<Recording> {
    let mut live = LivePoses::new(
        Plan::new(options, arguments.count.map(usize::from), client.hello())?,
        client.hello(),
    );
    let file = arguments.output.as_deref().map(poses_file);
    if arguments.resume {
        let poses = poses_file(Path::new(DEFAULT_FILE));
        live.resume(file.as_ref().unwrap_or(&poses))?;
    }
    output.print(match live.plan {
        Plan { six: true, .. } => {
            "hold the board still with each of its six sides up, in any order; the board's button \
             captures a side at once"
                .to_owned()
        }
        Plan { count, .. } => format!(
            "hold the board still in {count} different orientations; the board's button, or s and Enter, \
             skips a suggested one; Ctrl-C stops early"
        ),
    });
    let stop = interrupted()?;
    let skips = skips();
    while !stop.load(Ordering::Relaxed) && !live.is_complete() {
        while skips.try_recv().is_ok() {
            live.skip();
            advise(&live, output);
        }
        let Some(arrival) = client.next_event(Duration::from_millis(100))? else {
            continue;
        };
        let mut captured = false;
        live.take(&arrival, |live, news| {
            if let News::Captured(pose) = news {
                captured = true;
                output.print(match Face::of(&pose) {
                    Some(side) => {
                        format!("pose {} captured: {}", live.poses().len(), live.plan.name(side))
                    }
                    None => format!("pose {} captured", live.poses().len()),
                });
            }
            advise(live, output);
        });
        if let Some(file) = file.as_ref().filter(|_| captured) {
            live.recording(client.name())?.write_table(file)?;
        }
    }
    live.recording(client.name())
}

fn advise(live: &LivePoses, output: &Output) {
    if live.plan.six {
        let left: Vec<_> = live.sides_left().into_iter().map(|side| live.plan.name(side)).collect();
        if !left.is_empty() {
            output.print(format!("remaining: {}", left.join("; ")));
        }
    } else if let Some(next) = live.next() {
        let how = next.instruction_with(live.plan.names);
        output.print(format!("suggested next: {how}"));
    }
}
