//! `wimu monitor` as it is read by a person and by a program.

use crate::kit;

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use kit::{Simulator, in_folder, record_motion, snapshot, wait_until, wimu};
use serde_json::Value;

/// What the command prints into a pipe.
fn piped(arguments: &[&str]) -> String {
    let ran = Command::new(env!("CARGO_BIN_EXE_wimu"))
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .expect("wimu was built");
    assert!(ran.status.success(), "{ran:?}");
    String::from_utf8(ran.stdout).expect("text")
}

/// The device times that begin lines of readings, s.
fn times(text: &str) -> Vec<f64> {
    let time = |line: &str| line.split_whitespace().next()?.parse().ok();
    text.lines().filter_map(time).collect()
}

fn readings(arguments: &[&str]) -> Vec<Value> {
    wimu(arguments).objects()
}

#[test]
fn a_pipe_gets_a_line_a_second_or_as_many_as_are_asked_for() {
    let (file, _folder) = in_folder("rest.mcap");
    record_motion("rest", 1, &file);
    let text = piped(&["monitor", &file]);
    snapshot("monitor_recording", &text, &[]);
    let every = times(&piped(&["monitor", &file, "--rate", "1000"]));
    let span = every.last().expect("readings") - every[0];
    assert!(span > 4.0, "{span}");
    for (flags, rate) in [(&[][..], 1.0), (&["--rate", "1"], 1.0), (&["--rate", "10"], 10.0)] {
        let shown = times(&piped(&[&["monitor", &file][..], flags].concat()));
        assert_eq!(shown[0], every[0], "{rate}");
        let lines = (shown.len() - 1) as f64;
        // Times are printed to 10 ms; a line comes with the first sample that is due.
        assert!((lines - span * rate).abs() <= 1.0 + 0.02 * span * rate, "{lines} in {span} s");
        let apart = shown.windows(2).map(|pair| pair[1] - pair[0]);
        assert!(apart.fold(f64::MAX, f64::min) > 1.0 / rate - 0.02);
    }
    // A program gets every reading unless it asks for fewer.
    let all = readings(&["monitor", &file]);
    assert_eq!(all.len(), every.len());
    let some = readings(&["monitor", &file, "--rate", "2"]);
    assert!((some.len() as f64 - 2.0 * span).abs() <= 2.0, "{} in {span} s", some.len());
    for wrong in ["0", "-1", "nan", "inf"] {
        wimu(&["monitor", &file, &format!("--rate={wrong}")]).fails(2, "usage");
    }
}

#[test]
fn a_board_that_was_asked_a_moment_ago_shows_every_sample_once() {
    let board = Simulator::start(&["--faults", "bluetooth"]);
    wimu(&["info", &board.cable]).succeeds();
    let readings = readings(&["monitor", &board.cable, "--for", "1"]);
    let numbers: Vec<_> = readings.iter().map(|reading| reading["sequence"].as_u64()).collect();
    assert!(numbers.len() > 16);
    assert!(numbers.is_sorted_by(|a, b| a < b), "{numbers:?}");
}

#[test]
fn a_closed_pipe_ends_the_command() {
    let board = Simulator::start(&["--motion", "rest"]);
    for arguments in [&["monitor"][..], &["--json", "monitor"]] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_wimu"))
            .args(arguments)
            .args([&board.cable, "--rate", "10"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("wimu was built");
        let mut stdout = BufReader::new(child.stdout.take().expect("a pipe"));
        stdout.read_line(&mut String::new()).expect("a line");
        drop(stdout);
        wait_until("the command ends", || child.try_wait().expect("a child").is_some());
    }
}
