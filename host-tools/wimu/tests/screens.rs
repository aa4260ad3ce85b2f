//! Screens in a pseudo-terminal, as a person sees and drives them.
#![cfg(target_os = "linux")]

use crate::kit;

use std::fs::{self, File};
use std::io::{Read, Write};
use std::num::NonZero;
use std::path::Path;
use std::process::{Child, Command, ExitStatus};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use kit::{Simulator, folder, wimu};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcsetwinsize};

const TIME_LIMIT: Duration = Duration::from_secs(120);
/// A terminal of the least size, and one with a UTF-8 locale.
pub const USUAL: (u16, u16) = (80, 24);
pub const UTF8: [(&str, &str); 1] = [("LC_ALL", "C.UTF-8")];
/// A hold every few hundred milliseconds.
const FAST: [&str; 4] = ["--motion", "twelve-poses,slide", "--speed", "8"];

/// What was written to a terminal.
struct Written {
    parser: vt100::Parser,
    bytes: Vec<u8>,
}

/// A `wimu` in a terminal of its own; it is killed when dropped.
pub struct Terminal {
    child: Child,
    controller: File,
    written: Arc<Mutex<Written>>,
}

impl Terminal {
    pub fn start(
        arguments: &[&str],
        folder: &Path,
        (columns, rows): (u16, u16),
        variables: &[(&str, &str)],
    ) -> Self {
        let controller =
            openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).expect("a pseudo-terminal");
        grantpt(&controller).and_then(|()| unlockpt(&controller)).expect("a pseudo-terminal");
        let name = ptsname(&controller, Vec::new()).expect("its name");
        let user =
            File::options().read(true).write(true).open(name.to_str().expect("ASCII")).expect("it");
        tcsetwinsize(&controller, size(columns, rows)).expect("a size");
        let end = || user.try_clone().expect("a handle");
        let child = Command::new("setsid")
            .args(["--ctty", env!("CARGO_BIN_EXE_wimu")])
            .args(arguments)
            .current_dir(folder)
            .env_remove("LANG")
            .env_remove("LC_CTYPE")
            .env("XDG_CONFIG_HOME", folder)
            .env("TERM", "xterm")
            .envs(variables.iter().copied())
            .stdin(end())
            .stdout(end())
            .stderr(end())
            .spawn()
            .expect("setsid of util-linux");
        let controller = File::from(controller);
        let parser = vt100::Parser::new(cells(rows), cells(columns), 0);
        let written = Arc::new(Mutex::new(Written { parser, bytes: Vec::new() }));
        let (mut reader, shared) = (controller.try_clone().expect("a handle"), written.clone());
        thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(count @ 1..) = reader.read(&mut buffer) {
                let mut written = shared.lock().expect("no panic");
                written.parser.process(&buffer[..count]);
                written.bytes.extend(&buffer[..count]);
            }
        });
        Self { child, controller, written }
    }

    fn text(&self) -> String {
        self.written.lock().expect("no panic").parser.screen().contents()
    }

    pub fn bytes(&self) -> Vec<u8> {
        self.written.lock().expect("no panic").bytes.clone()
    }

    /// Waits until the screen shows `text`.
    fn shows(&self, text: &str) -> String {
        self.until(text, |screen| screen.contains(text))
    }

    /// Waits until the screen `holds` what is named.
    fn until(&self, named: &str, holds: impl Fn(&str) -> bool) -> String {
        let until = Instant::now() + TIME_LIMIT;
        loop {
            let screen = self.text();
            if holds(&screen) {
                return screen;
            }
            assert!(Instant::now() < until, "{named:?} is not shown:\n{screen}");
            thread::sleep(Duration::from_millis(20));
        }
    }

    fn press(&mut self, keys: &str) {
        self.controller.write_all(keys.as_bytes()).expect("a terminal");
    }

    fn resize(&self, columns: u16, rows: u16) {
        let mut written = self.written.lock().expect("no panic");
        written.parser.screen_mut().set_size(cells(rows), cells(columns));
        tcsetwinsize(&self.controller, size(columns, rows)).expect("a size");
    }

    /// Waits for the end of the command, which must leave the terminal as it was.
    pub fn ends(&mut self) -> ExitStatus {
        let until = Instant::now() + TIME_LIMIT;
        loop {
            if let Some(status) = self.child.try_wait().expect("a child") {
                thread::sleep(Duration::from_millis(50));
                let written = self.written.lock().expect("no panic");
                let screen = written.parser.screen();
                assert!(!screen.alternate_screen() && !screen.hide_cursor());
                return status;
            }
            assert!(Instant::now() < until, "it does not end:\n{}", self.text());
            thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn cells(count: u16) -> NonZero<u16> {
    NonZero::new(count).expect("a size")
}

fn size(columns: u16, rows: u16) -> Winsize {
    Winsize { ws_col: columns, ws_row: rows, ws_xpixel: 0, ws_ypixel: 0 }
}

/// The number in `pose N of 12`.
fn poses(screen: &str) -> usize {
    let (_, rest) = screen.split_once("pose ").expect(screen);
    rest.split_whitespace().next().and_then(|n| n.parse().ok()).expect(screen)
}

#[test]
fn keys_alone_lead_from_readings_to_a_pushed_calibration() {
    let board = Simulator::start(&FAST);
    let folder = folder();
    let mut screen = Terminal::start(&["monitor", &board.cable], folder.path(), USUAL, &UTF8);
    let shown = screen.shows("none: uncalibrated, press c");
    for part in ["specific force, m/s²", "|f|", "state", "links", "rate Hz", "latency", "q  quit"]
    {
        assert!(shown.contains(part), "{part}:\n{shown}");
    }
    screen.press("c");
    for part in [
        "next: hold it like this",
        "now",
        "poses ●, next N, now +",
        "behind the sphere",
        "no fit yet: ",
        "hold the board still",
        "bias",
        "scale factor",
    ] {
        screen.shows(part);
    }
    screen.shows("standard deviation of the fit");
    screen.shows("calibrated: p pushes it to the board");
    // A bell for each of twelve poses, or for those between two pictures on a busy machine.
    assert!(screen.bytes().iter().filter(|byte| **byte == 7).count() >= 6);
    screen.press("p");
    screen.shows("calibrated and pushed");
    screen.press("q");
    screen.shows("in use");
    screen.shows("(corrected)");
    screen.press("q");
    assert!(screen.ends().success());
    let shown = screen.shows("pushed: the board corrects its samples now");
    drop(shown);
    assert_eq!(wimu(&["params", "get", &board.cable]).succeeds()["calibrated"], true);
}

#[test]
fn a_lost_link_keeps_the_poses_and_resume_continues_them() {
    let folder = folder();
    let store = folder.path().join("store");
    let fast = [&FAST[..], &["--store", store.to_str().expect("text")]].concat();
    let board = Simulator::start(&fast);
    // More than are captured until the board is gone, on a busy computer too.
    let arguments = ["calibrate", &board.cable, "-o", "CAL.json", "--count", "60"];
    let mut screen = Terminal::start(&arguments, folder.path(), USUAL, &UTF8);
    screen.until("pose 8", |shown| shown.contains("of 60") && poses(shown) >= 8);
    drop(board);
    let kept = poses(&screen.shows("LINK LOST"));
    assert!(kept >= 8, "{kept}");
    screen.press("q");
    assert!(screen.ends().success());
    screen.shows("--resume continues there");
    // Another phase of the noise: the same samples again would be no further poses.
    let other = ["--motion", "slide,twelve-poses", "--speed", "8", "--store"];
    let board = Simulator::start(&[&other[..], &[store.to_str().expect("text")]].concat());
    let arguments =
        ["calibrate", &board.cable, "-o", "CAL.json", "--resume", "--count", "20", "--push"];
    let mut screen = Terminal::start(&arguments, folder.path(), USUAL, &UTF8);
    screen.shows("continuing the poses in CAL.poses.csv");
    let resumed = poses(&screen.shows("of 20"));
    assert!(resumed <= kept + 1, "{resumed} after {kept}");
    screen.shows("calibrated and pushed");
    screen.press("q");
    assert!(screen.ends().success());
    let report: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.path().join("CAL.json")).expect("written"))
            .expect("JSON");
    assert!(report.is_object());
    assert!(!folder.path().join("CAL.poses.csv").exists());
}

#[test]
fn a_removed_pose_is_gone_and_its_hold_is_not_captured_again() {
    let board = Simulator::start(&["--motion", "rest"]);
    let folder = folder();
    let mut screen = Terminal::start(&["calibrate", &board.cable], folder.path(), USUAL, &UTF8);
    screen.shows("pose 1 captured");
    assert!(folder.path().join("wimu-calibration.poses.csv").exists());
    screen.press("u");
    screen.shows("the latest pose is removed");
    thread::sleep(Duration::from_secs(3));
    assert_eq!(poses(&screen.text()), 0, "{}", screen.text());
    let first = screen.text();
    screen.press("s");
    screen.shows("not suggested again");
    assert_ne!(first, screen.text());
    screen.press("f");
    screen.shows("no calibration: ");
    // Ctrl-C.
    screen.press("\x03");
    assert!(screen.ends().success());
    screen.shows("no pose was captured");
}

#[test]
fn a_small_terminal_gets_text_and_a_screen_survives_any_size() {
    let board = Simulator::start(&["--motion", "rest"]);
    let folder = folder();
    let tiny = (20, 5);
    let mut lines = Terminal::start(&["monitor", &board.cable], folder.path(), tiny, &UTF8);
    lines.until("two lines of readings", |shown| shown.matches(" s ").count() >= 2);
    lines.press("\x03");
    assert!(lines.ends().success());
    let mut screen = Terminal::start(&["monitor", &board.cable], folder.path(), USUAL, &UTF8);
    screen.shows("at rest");
    screen.resize(tiny.0, tiny.1);
    screen.shows("too small");
    for (columns, rows) in [(80, 24), (200, 60), (81, 25), (1, 1), (80, 24)] {
        screen.resize(columns, rows);
        match columns {
            1 => thread::sleep(Duration::from_millis(200)),
            _ => drop(screen.shows("at rest")),
        }
    }
    screen.press("q");
    assert!(screen.ends().success());
}

#[test]
fn without_utf8_and_colour_the_screen_is_plain_ascii() {
    let board = Simulator::start(&["--motion", "rest"]);
    let folder = folder();
    let plain = [("LC_ALL", "C"), ("NO_COLOR", "1")];
    for (command, variables) in [("monitor", &UTF8[..]), ("monitor", &plain), ("calibrate", &plain)]
    {
        let is_plain = variables.len() == plain.len();
        let mut screen = Terminal::start(&[command, &board.cable], folder.path(), USUAL, variables);
        screen.shows(if command == "monitor" { "at rest" } else { "pose 1 captured" });
        let written = screen.written.lock().expect("no panic");
        let cells = (0..USUAL.1).flat_map(|row| (0..USUAL.0).map(move |column| (row, column)));
        let coloured = cells
            .filter_map(|(row, column)| written.parser.screen().cell(row, column))
            .filter(|cell| cell.fgcolor() != vt100::Color::Default)
            .count();
        assert_eq!(coloured == 0, is_plain, "{command}: {coloured} cells in colour");
        assert_eq!(written.bytes.is_ascii(), is_plain, "{command}");
        drop(written);
        screen.press("q");
        assert!(screen.ends().success());
    }
}

#[test]
fn a_terminal_that_is_closed_ends_the_command() {
    let board = Simulator::start(&["--motion", "rest"]);
    let folder = folder();
    let mut screen = Terminal::start(&["monitor", &board.cable], folder.path(), USUAL, &UTF8);
    screen.shows("at rest");
    let Terminal { child, controller, .. } = &mut screen;
    let null = File::open("/dev/null").expect("it");
    drop(std::mem::replace(controller, null));
    // The reader holds the last handle: a hang-up comes as a signal.
    let hung_up = Command::new("kill").args(["-HUP", &child.id().to_string()]).status();
    assert!(hung_up.is_ok_and(|status| status.success()));
    let until = Instant::now() + TIME_LIMIT;
    while child.try_wait().expect("a child").is_none() {
        assert!(Instant::now() < until, "it does not end");
        thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn monitor_shows_the_position_that_ranges_aid() {
    let board = Simulator::start(&["--sensor", "lsm6dso", "--motion", "rest"]);
    let folder = folder();
    let anchors = "Anchor,Position E (m),Position N (m),Position U (m)\nA,0,0,0\nB,8,0,2\nC,8,6,0\nD,0,6,2.5\n";
    fs::write(folder.path().join("anchors.csv"), anchors).unwrap();
    // Of a unit at E 2 N 3 U 1 m.
    let rows: String = (0..8000)
        .map(|k| {
            let (id, range_m) = [("A", 3.742), ("B", 6.782), ("C", 6.782), ("D", 3.905)][k % 4];
            format!("{:.3},{id},{range_m}\n", k as f64 * 0.025)
        })
        .collect();
    let ranges = format!("Time (s),Anchor,Range (m)\n{rows}");
    fs::write(folder.path().join("ranges.csv"), ranges).unwrap();
    let mut arguments = vec!["monitor", &board.cable, "--anchors", "anchors.csv"];
    arguments.extend(["--ranges", "ranges.csv"]);
    wimu(&[&arguments[..2], &["--ranges", "ranges.csv", "--anchors", "anchors.csv"]].concat())
        .fails(2, "usage");
    arguments.push("--navigate");
    wimu(&arguments).fails(2, "usage");
    let mut screen = Terminal::start(&arguments, folder.path(), USUAL, &UTF8);
    screen.shows("ranges used");
    screen.until("the position", |text| {
        ["E +2.0", "E +1.9"].iter().any(|east| text.contains(east)) && !text.contains("not valid")
    });
    screen.press("q");
    assert!(screen.ends().success());
}
