//! Text of files and their names is never printed so that a terminal acts on it, or so that it looks like a line of wimu.
#![cfg(unix)]

use crate::kit;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use kit::{folder, record_motion};
use wimu::{Output, run};
use wimu_host::untrusted::is_active;

/// Controls of C0 and C1, bidirectional controls, line separators, and a line that wimu could have written.
const HOSTILE: &str = "\u{1b}]0;x\u{7}\u{1b}[2J\u{9b}2J\u{202e}\u{2066}\u{200f}\u{2028}\r\nFORGED";

/// What commands do with a file, `@` in its place; `OK` and `OUT` stand for a good file and for a name of a new one.
const COMMANDS: &[&str] = &[
    "info @",
    "monitor @",
    "allan @",
    "allan @ --from 0.1 --to 0.5",
    "calibrate @",
    "calibrate @ @",
    "calibrate @ --poses --method six-position",
    "calibrate @ --poses --method multi-position --sensitivity 16384 --verbose",
    "calibrate @ --method reference",
    "calibrate @ --method update --with @",
    "calibrate @ --method magnetometer --with @",
    "calibrate @ --setup geometry=@",
    "calibrate OK --poses --where @=1",
    "calibrate OK --method update --with @",
    "align @ --up z,x --with @",
    "align OK --up z,x --with @",
    "align OK --camera @",
    "align @ --camera OK",
    "convert OK --with @ -o OUT",
    "convert @ --with @ -o OUT",
    "compare @",
    "compare @ OK",
    "compare OK @",
    "convert @ --to c -o OUT",
    "convert @ -o OUT",
    "convert @ --to kalibr -o OUT",
    "navigate @",
    "navigate @ --verbose",
    "navigate @ --with @",
    "navigate OK --with @",
    "navigate OK --setup geometry=@",
    "navigate OK --fixes @",
    "navigate OK --ranges @ --setup anchors=@",
    "navigate OK --profile @",
    "navigate --ranges @ --setup anchors=@",
    "device params push tcp://127.0.0.1:1 @",
    "device params get @",
    "device settings get @",
    "device key status @",
    "record @ -o OUT",
    "device report-bug @ -o OUT",
    "fleet gateway --config @ --for 0.1",
    "fleet status @",
    "fleet push mqtt://127.0.0.1:1/hall @",
    "fleet push @ @",
    "simulate --replay @ --cable 127.0.0.1:0 --wireless 127.0.0.1:0 --for 0.1",
    "dashboard @ --port 0 --for 0.1",
    "device flash @",
];

fn quoted(text: &str) -> String {
    format!("\"{text}\"")
}

/// Files of every kind whose every field is hostile, or all but those without which they are not read.
fn files(folder: &Path) -> Vec<PathBuf> {
    let json = serde_json::to_string(HOSTILE).expect("JSON");
    let toml = format!("\"{}\"", HOSTILE.escape_default());
    let toml = toml.replace("\\u{", "\\U{");
    let toml = unicode(&toml);
    let named = |columns: &str, row: &str| {
        let mut text = format!("Time (s),{columns},{}\n", quoted(HOSTILE));
        for k in 0..200 {
            text += &format!("{},{row},{}\n", f64::from(k) * 0.01, quoted(HOSTILE));
        }
        text
    };
    let axes = "Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)";
    let calibration = |schema: &str| {
        format!(
            "{{\"schema\":{schema},\"device\":{json},\"sensors\":[{{\"index\":0,\"sensor\":{json},\"accelerometer\":{json}}}]}}"
        )
    };
    let every = [
        ("header.csv", format!("{0},{0}\n{0},{0}\n", quoted(HOSTILE))),
        ("columns.csv", named(axes, "0.1,0.2,9.8")),
        ("cells.csv", named(axes, &format!("{0},{0},{0}", quoted(HOSTILE)))),
        (
            "units.csv",
            named(
                &axes.replace("m/s²", HOSTILE).replace("Acc", "\"Acc").replace(')', ")\""),
                "1,2,3",
            ),
        ),
        (
            "imu.csv",
            named(
                &format!("{axes},Gyroscope X (rad/s),Gyroscope Y (rad/s),Gyroscope Z (rad/s)"),
                "0,0,9.8,0,0,0",
            ),
        ),
        ("ranges.csv", format!("Time (s),Anchor,Range (m)\n0,{0},1\n1,{0},{0}\n", quoted(HOSTILE))),
        (
            "anchors.csv",
            format!("Anchor,X (m),Y (m),Z (m)\n{0},0,0,0\n{0},{0},1,1\n", quoted(HOSTILE)),
        ),
        ("fixes.csv", format!("Time (s),E (m),N (m),U (m),{0}\n0,0,0,{0},{0}\n", quoted(HOSTILE))),
        ("text.csv", HOSTILE.to_owned()),
        ("schema.json", calibration(&json)),
        ("fields.json", calibration("\"wimu.calibration/2\"")),
        ("key.json", format!("{{{json}:{json}}}")),
        ("broken.json", format!("{{\"schema\":{HOSTILE}")),
        ("profile.toml", format!("{toml} = {toml}\n")),
        (
            "names.toml",
            format!(
                "fleet = {toml}\nbroker = {toml}\ngateway = {toml}\n[boards]\n{toml} = {toml}\n"
            ),
        ),
        (
            "board.toml",
            format!(
                "fleet = \"f\"\nbroker = \"mqtt://127.0.0.1:1\"\n[boards]\nb = {toml}\n{toml} = 1\n"
            ),
        ),
        ("transforms.yaml", format!("T_cam_imu: {json}\n{json}: {json}\n")),
        (
            "blackbox.bbl",
            format!(
                "H Product:Blackbox flight data recorder by Nicholas Sherlock\nH {HOSTILE}:{HOSTILE}\nH Field I name:{HOSTILE}\n"
            ),
        ),
    ];
    let mut files = Vec::new();
    for (name, text) in every {
        let path = folder.join(format!("{HOSTILE}{name}"));
        fs::write(&path, text).expect("written");
        files.push(path);
    }
    let path = folder.join(format!("{HOSTILE}ros.mcap"));
    fs::write(&path, bag()).expect("written");
    files.push(path);
    let path = folder.join(format!("{HOSTILE}wimu.mcap"));
    record_motion("rest", 1, path.to_str().expect("text"));
    files.push(path);
    files.push(folder.join(format!("{HOSTILE}absent.csv")));
    files
}

/// Escapes of Rust as those of TOML.
fn unicode(text: &str) -> String {
    let mut parts = text.split("\\U{");
    let mut out = parts.next().expect("one").to_owned();
    for part in parts {
        let (digits, rest) = part.split_once('}').expect("an escape");
        out += &format!("\\U{digits:0>8}{rest}");
    }
    out
}

/// A ROS 2 bag with hostile topics and types.
fn bag() -> Vec<u8> {
    let text = |text: &str| [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat();
    let record =
        |code: u8, body: Vec<u8>| [&[code][..], &(body.len() as u64).to_le_bytes(), &body].concat();
    let mut bytes = b"\x89MCAP0\r\n".to_vec();
    bytes.extend(record(1, [text(HOSTILE), text(HOSTILE)].concat()));
    for (id, kind) in [(1_u16, HOSTILE), (2, "sensor_msgs/msg/Imu")] {
        let id = id.to_le_bytes();
        bytes.extend(record(3, [&id[..], &text(kind), &text(HOSTILE), &text(HOSTILE)].concat()));
        let channel = [&id[..], &id, &text(HOSTILE), &text("cdr"), &text("")].concat();
        bytes.extend(record(4, channel));
        bytes.extend(record(5, [&id[..], &[0; 20], HOSTILE.as_bytes()].concat()));
    }
    bytes
}

/// Output kept in memory.
#[derive(Clone, Default)]
struct Memory(Arc<Mutex<Vec<u8>>>);

impl Write for Memory {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().expect("no panic").extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn nothing_that_a_file_holds_acts_on_the_terminal() {
    let folder = folder();
    let ok = folder.path().join("poses.csv");
    let good = "Time (s),Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)\n0,0,0,9.8\n1,0,0,9.8\n";
    fs::write(&ok, good).expect("written");
    let (ok, out) = (ok.display().to_string(), folder.path().join("out").display().to_string());
    let mut acted = Vec::new();
    for file in files(folder.path()) {
        let file = file.to_str().expect("text");
        for command in COMMANDS {
            for json in [&[][..], &["--json"]] {
                let word =
                    |word: &str| word.replace("OK", &ok).replace("OUT", &out).replace('@', file);
                let words = command.split(' ').chain(json.iter().copied()).map(word);
                let printed = Memory::default();
                let mut output = Output::to(printed.clone(), printed.clone());
                run(words, &mut output);
                let printed = printed.0.lock().expect("no panic");
                let text = String::from_utf8_lossy(&printed);
                let active = |c| c != '\n' && is_active(c);
                if text.contains(active) || text.lines().any(|line| line.starts_with("FORGED")) {
                    acted
                        .push(format!("{command} {json:?} {}: {text:?}", &file[file.len() - 12..]));
                }
            }
        }
    }
    assert!(acted.is_empty(), "{} of them:\n{}", acted.len(), acted.join("\n"));
}
