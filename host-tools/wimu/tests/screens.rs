//! The text views in a pseudo-terminal, as a person sees and drives them.
#![cfg(target_os = "linux")]

use crate::kit;

use std::fs::File;
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
/// The usual size of a terminal, columns and rows.
pub const USUAL: (u16, u16) = (80, 24);
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
    pub fn start(arguments: &[&str], folder: &Path, (columns, rows): (u16, u16)) -> Self {
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
            .env("XDG_CONFIG_HOME", folder)
            .env("TERM", "xterm")
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
fn typed_letters_alone_lead_to_a_pushed_calibration() {
    let board = Simulator::start(&FAST);
    let folder = folder();
    let mut screen = Terminal::start(&["calibrate", &board.cable], folder.path(), USUAL);
    for part in ["next ", "from it: ", "bias ", "scale factor ", "no fit yet: ", "u undo, s skip"] {
        screen.shows(part);
    }
    screen.shows("p pushes it to the board, m captures more poses");
    // A bell for each of twelve poses, or for those between two drawings on a busy machine.
    assert!(screen.bytes().iter().filter(|byte| **byte == 7).count() >= 6);
    screen.press("p\n");
    assert!(screen.ends().success());
    assert_eq!(wimu(&["device", "params", "get", &board.cable]).succeeds()["calibrated"], true);
    assert!(!folder.path().join("wimu-calibration.poses.csv").exists());
    let mut screen = Terminal::start(&["monitor", &board.cable], folder.path(), USUAL);
    for part in ["force ", "(corrected)", "motion ", "temperature ", "samples/s", "Ctrl-C quits"] {
        screen.shows(part);
    }
    screen.press("\x03");
    assert!(screen.ends().success());
}

#[test]
fn a_lost_link_keeps_the_poses() {
    let folder = folder();
    let board = Simulator::start(&FAST);
    // More than are captured until the board is gone, on a busy computer too.
    let arguments = ["calibrate", &board.cable, "-o", "CAL.json", "--count", "60"];
    let mut screen = Terminal::start(&arguments, folder.path(), USUAL);
    screen.until("pose 8", |shown| shown.contains("of 60") && poses(shown) >= 8);
    drop(board);
    assert!(!screen.ends().success());
    screen.shows("which `wimu calibrate` reads");
    assert!(folder.path().join("CAL.poses.csv").exists());
}

#[test]
fn a_removed_pose_is_gone_and_its_hold_is_not_captured_again() {
    let board = Simulator::start(&["--motion", "rest"]);
    let folder = folder();
    let mut screen = Terminal::start(&["calibrate", &board.cable], folder.path(), USUAL);
    screen.shows("pose 1 captured");
    assert!(folder.path().join("wimu-calibration.poses.csv").exists());
    screen.press("u\n");
    screen.shows("the latest pose is removed");
    thread::sleep(Duration::from_secs(3));
    let first = screen.text();
    assert_eq!(poses(&first), 0, "{first}");
    screen.press("s\n");
    screen.shows("not suggested again");
    assert_ne!(first, screen.text());
    screen.press("\x03");
    assert!(screen.ends().success());
    screen.shows("no pose was captured");
}

#[test]
fn a_view_fits_its_terminal_and_ends_with_it() {
    let board = Simulator::start(&["--motion", "rest"]);
    let folder = folder();
    let mut screen = Terminal::start(&["monitor", &board.cable], folder.path(), (20, 5));
    screen.shows("force ");
    assert!(screen.text().lines().all(|line| line.chars().count() < 20), "{}", screen.text());
    let Terminal { child, controller, .. } = &mut screen;
    drop(std::mem::replace(controller, File::open("/dev/null").expect("it")));
    // The reader holds the last handle: a hang-up comes as a signal.
    let hung_up = Command::new("kill").args(["-HUP", &child.id().to_string()]).status();
    assert!(hung_up.is_ok_and(|status| status.success()));
    kit::wait_until("it ends", || child.try_wait().expect("a child").is_some());
}
