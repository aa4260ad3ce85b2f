//! The button at the board: a mark in the stream, and a person's "next" in a live calibration.

use crate::kit;

use std::fmt::Write as _;
use std::fs;

use kit::{Background, Ran, Simulator, Transcript, in_folder, wimu};

/// Only a line that advises a pose holds this word.
const ADVICE: &str = "next";

/// The lines that advise a pose.
fn advice(ran: &Ran) -> Vec<&str> {
    let lines = ran.stderr.lines().map(str::trim);
    lines.filter(|line| line.contains(ADVICE)).collect()
}

/// Each side up for 1.3 s, which is too short to be taken by itself, and half a second of motion
/// before it: counts at 100 Hz.
fn six_short_holds() -> String {
    let mut csv = "Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)\n".to_owned();
    for side in 0..6 {
        for k in 0..180_i32 {
            let mut counts = if k < 50 {
                [k * 173 % 9000, k * 311 % 7000, k * 97 % 8000]
            } else {
                [(k % 3) * 16, (k % 2) * 16, (k % 5) * 16]
            };
            counts[side / 2] += if side % 2 == 0 { 16_384 } else { -16_384 };
            writeln!(csv, "{},{},{}", counts[0], counts[1], counts[2]).expect("memory");
        }
    }
    csv
}

#[test]
fn a_press_takes_a_side_that_is_held_and_six_of_them_are_a_calibration() {
    let (holds, _folder) = in_folder("holds.csv");
    fs::write(&holds, six_short_holds()).expect("writable");
    // 1.1 s into each hold.
    let presses: Vec<_> =
        (0..6).map(|side| format!("press={:.1}s", 1.6 + 1.8 * f64::from(side))).collect();
    let board = Simulator::start(&["--replay", &holds, "--faults", &presses.join(",")]);
    let ran = wimu(&["calibrate", &board.cable, "--method", "six-position"]);
    let report = ran.succeeds();
    assert_eq!(report["poses"], 6, "{report}");
    // Six poses captured; of six sides six are left, then five, …
    let mut texts = Transcript::default();
    texts.text("calibrate LINK --method six-position", &ran);
    texts.check_live("calibrate_live_six_positions");
}

#[cfg(unix)]
#[test]
fn a_press_while_nothing_new_is_held_skips_what_is_advised() {
    let board = Simulator::start(&[
        "--motion",
        "rest",
        "--exit-when-done",
        "--faults",
        "press=3s,press=4s",
    ]);
    let calibrating = Background::start(&["calibrate", &board.cable]);
    let ran = calibrating.prints(ADVICE, 3).signal("-INT");
    // At first, and after each press: what is skipped is not advised again.
    let [before, first, second] = advice(&ran)[..] else {
        panic!("{ran:?}");
    };
    assert!(first != before && second != before && second != first, "{ran:?}");
}

#[test]
fn a_press_is_a_mark_in_the_recording_and_on_the_screen() {
    // The board waits for the recorder, which records until the board is gone.
    let pace = ["--motion", "rest", "--speed", "10", "--exit-when-done"];
    let board = Simulator::start(&[&pace[..], &["--faults", "press=2.5s,press=1.5s"]].concat());
    let (recording, _folder) = in_folder("marked.mcap");
    board.record_to_the_end(&recording);
    let info = wimu(&["info", &recording]).succeeds();
    let text = info.to_string();
    for (time, mark) in [("1.50 s: ", "mark 1"), ("2.50 s: ", "mark 2")] {
        let (_, event) = text.split_once(time).expect(&text);
        assert!(event.split('"').next().unwrap().ends_with(mark), "{text}");
    }
}

#[test]
fn a_press_at_no_time_is_refused() {
    for time in ["-1s", "soon", "nans", "3"] {
        let option = format!("--faults=press={time}");
        let ran = wimu(&["simulate", &option, "--motion", "rest"]);
        assert_eq!(ran.code, 2, "{time}: {ran:?}");
    }
}
