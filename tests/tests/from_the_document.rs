//! Another host, written from docs/reference/protocol.md alone: it reads every example message and must find what
//! stands above it. Nothing of wimu is used here. (Batches are read by `examples/read_batch.py`.)

use std::fs;
use std::path::{Path, PathBuf};

/// The messages as the document has them. A line is a name and what it holds, one after another:
/// fields for a struct; for an enum `|` before each variant. `T?` may be absent, `T*3` is three of them.
const DOCUMENT: &str = "
Telemetry: | Epoch Epoch | Environment u64 i32*3? i16? | Navigation u32 i64*3 i64*3 u32 Phase u8 u16? | Parameters bytes | Settings Settings | Status Status | Event u64 Event | Attitude u32 i32*4 | Tag KeyId u32 u32 u32 u8*8
Epoch: Reason u8 u32 u64 u32 u8 f64 i32 u32 i16? u8 u8 Gyroscope? signature State
Gyroscope: f64 i32
Reason: | Start | Periodic | Gap | Stillness | Temperature | Settings | Parameters | Heading
State: u32 bool u32 Phase u8 i64*3 i32*3 i64*3 i64*3 u64 Segment Window Run? u16? Rotation?
Segment: u32 i64*3 i64*3 i32*3?
Window: Segment u16 i32*3 i32*3 u64
Run: u16 i64*3 i64*3 Segment
Rotation: i64*4 i32*3? u32*3 i32*3 i64*3 i64*3 i64*3
Phase: | Searching | Resting | Moving
Settings: u8 u16 Resolution bool u32 Streams Streams
Resolution: | Low | Normal | High
Streams: bool bool bool bool u8 u8
Status: u64 LinkStatus? LinkStatus? SensorStatus u32? u32? StackStatus?
StackStatus: u32 u32
LinkStatus: u32 u64 u32 u32 u32
SensorStatus: u32 u32 u32 u32
Event: | SensorLost Lost | SensorFound | WrongSensor u8 u8 | StoreUnreadable | ParametersRejected SetError | SettingsAdjusted | Pause u16 | Marked u16 | CalibrationContradicted i32 u32 | GyroscopeLost Lost
Lost: | NoAnswer | Transfer | Timeout
SetError: | Length | Checksum | Format | Integers | Device
Request: u32 u32 signature Command
Command: | GetParameters | SetParameters bytes | FactoryReset | GetSettings | SetSettings Settings | GetStatus | SetLineRate u32 | OpenSession | GetKeyStatus | SetKey key | ForgetKey | GetTime
Reply: u32 u32 signature Answer
Answer: | Accepted Payload | Refused Refusal | Unknown
Payload: | None | Parameters bytes | Settings Settings | Status Status | Session u32 u8*16 | KeyStatus KeyId? | Time u64
KeyId: u8*4
Refusal: | KeyNeeded | Locked | InvalidParameters SetError | WrongRange u8 u8 | UnsupportedSettings Settings | StoreFailed | SensorFailed | Stale | FixedLineRate | UnsupportedLineRate u32 | SignatureNeeded | WrongSignature | SessionEnded | CableOnly | NotSupported
";

/// Names that the examples give their structs, which the wire does not know.
const STRUCTS: [&str; 26] = [
    "Attitude",
    "Config",
    "DeviceKey",
    "Environment",
    "Epoch",
    "EpochGyroscope",
    "Flags",
    "KeyId",
    "LinkStatus",
    "Navigation",
    "Part",
    "PeriodNs",
    "Reply",
    "Request",
    "RotationState",
    "Run",
    "Segment",
    "SensorStatus",
    "Settings",
    "Signature",
    "StackStatus",
    "State",
    "Status",
    "Streams",
    "Tag",
    "Window",
];

const NEWTYPES: [&str; 4] = ["DeviceKey", "Flags", "KeyId", "PeriodNs"];

fn definition(name: &str) -> Option<&'static str> {
    DOCUMENT.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'))
}

/// Section 1.
fn crc_32c(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            crc >> 1 ^ if crc & 1 == 1 { 0x82F6_3B78 } else { 0 }
        })
    })
}

/// First byte and body of a frame with its zero.
fn plain(frame: &[u8]) -> (u8, Vec<u8>) {
    let (end, mut coded) = frame.split_last().expect("a frame");
    assert_eq!(*end, 0);
    let mut plain = Vec::new();
    while let Some((&code, rest)) = coded.split_first() {
        let (run, rest) = rest.split_at(usize::from(code) - 1);
        plain.extend_from_slice(run);
        if code < 255 && !rest.is_empty() {
            plain.push(0);
        }
        coded = rest;
    }
    let crc = plain.split_off(plain.len() - 4);
    assert_eq!(crc_32c(&plain).to_le_bytes()[..], crc);
    (plain[0], plain[1..].to_vec())
}

/// Section 5: reads a body and writes down what is in it.
struct Reader<'a> {
    rest: &'a [u8],
    found: Vec<String>,
}

impl Reader<'_> {
    fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let (bytes, rest) = self.rest.split_first_chunk().expect("the body is longer");
        self.rest = rest;
        *bytes
    }

    fn varint(&mut self) -> u64 {
        let (mut value, mut shift) = (0, 0);
        loop {
            let [byte] = self.bytes();
            value |= u64::from(byte & 127) << shift;
            shift += 7;
            if byte < 128 {
                return value;
            }
        }
    }

    fn note(&mut self, what: impl ToString) {
        self.found.push(what.to_string());
    }

    fn read(&mut self, of: &str) {
        if let Some(of) = of.strip_suffix('?') {
            return match self.bytes() {
                [0] => self.note("None"),
                [1] => {
                    self.note("Some");
                    self.read(of);
                }
                [other] => panic!("{other} is neither there nor not"),
            };
        }
        if let Some((of, count)) = of.split_once('*') {
            return (0..count.parse().expect("a number")).for_each(|_| self.read(of));
        }
        match of {
            "u8" => {
                let [byte] = self.bytes();
                self.note(byte);
            }
            "bool" => {
                let [byte] = self.bytes();
                self.note(byte == 1);
            }
            "u16" | "u32" | "u64" => {
                let value = self.varint();
                self.note(value);
            }
            "i16" | "i32" | "i64" => {
                let folded = self.varint();
                self.note((folded >> 1) as i64 ^ -((folded & 1) as i64));
            }
            "f64" => {
                let value = f64::from_le_bytes(self.bytes());
                self.note(format!("{value:?}"));
            }
            "signature" => {
                let length = self.varint();
                self.note(length);
                // The examples show it filled up.
                for at in 0..8 {
                    if at < length { self.read("u8") } else { self.note(0) }
                }
            }
            "bytes" => (0..self.varint()).for_each(|_| self.read("u8")),
            // The examples do not show it.
            "key" => self.rest = &self.rest[32..],
            name => self.read_named(name),
        }
    }

    fn read_named(&mut self, name: &str) {
        let definition = definition(name).unwrap_or_else(|| panic!("{name} is not defined"));
        let Some(variants) = definition.trim().strip_prefix('|') else {
            return definition.split_whitespace().for_each(|of| self.read(of));
        };
        let number = self.varint() as usize;
        let variant = variants.split('|').nth(number);
        let mut parts =
            variant.unwrap_or_else(|| panic!("{name} has no variant {number}")).split_whitespace();
        self.note(parts.next().expect("a name"));
        parts.for_each(|of| self.read(of));
    }
}

/// The words and numbers of an example's description, without the names of fields and structs.
fn said(text: &str) -> Vec<String> {
    let mut words = Vec::new();
    let mut rest = text;
    while let Some(start) = rest.find(|c: char| c.is_alphanumeric() || c == '-' || c == '"') {
        rest = &rest[start..];
        let inside = |c: char| c.is_alphanumeric() || "_-.+".contains(c);
        let end = match rest.strip_prefix('"') {
            Some(quoted) => quoted.find('"').expect("an end") + 2,
            None => rest.find(|c| !inside(c)).unwrap_or(rest.len()),
        };
        let (word, behind) = rest.split_at(end);
        rest = behind;
        let is_struct =
            STRUCTS.contains(&word) && (behind.starts_with(" {") || NEWTYPES.contains(&word));
        if !behind.starts_with(": ") && !is_struct {
            words.push(word.to_owned());
        }
    }
    words
}

fn folder() -> PathBuf {
    let vectors = Path::new(env!("CARGO_MANIFEST_DIR")).join("vectors");
    let folders = fs::read_dir(vectors).expect("the examples");
    let latest = folders.map(|folder| folder.expect("a folder").path()).max();
    latest.expect("examples of a version")
}

/// What is said of each example in a file, and its frame.
fn examples(name: &str) -> Vec<(String, Vec<u8>)> {
    let path = folder().join(name).with_extension("hex");
    let text = fs::read_to_string(path).expect("the examples");
    let lines: Vec<&str> = text.lines().collect();
    let byte = |pair: &[u8]| {
        let pair = std::str::from_utf8(pair).expect("hex");
        u8::from_str_radix(pair, 16).expect("hex")
    };
    lines
        .chunks_exact(2)
        .map(|pair| {
            let frame = pair[1].as_bytes().chunks_exact(2).map(byte).collect();
            (pair[0].trim_start_matches("# ").to_owned(), frame)
        })
        .collect()
}

#[test]
fn every_telemetry_request_and_reply_reads_as_the_document_says() {
    for (file, kind, name) in
        [("telemetry", 4, "Telemetry"), ("request", 5, "Request"), ("reply", 6, "Reply")]
    {
        let examples = examples(file);
        assert!(examples.len() > 10, "{file}");
        for (text, frame) in examples {
            let (first, body) = plain(&frame);
            assert_eq!(first & 15, kind, "{text}");
            let mut reader = Reader { rest: &body, found: Vec::new() };
            reader.read(name);
            assert!(reader.rest.is_empty(), "{text}");
            assert_eq!(said(&reader.found.join(" ")), said(&text), "{text}");
        }
    }
}

/// The set of the examples, and the bytes of an uncalibrated device, which are none.
#[test]
fn a_parameter_set_reads_as_the_document_says() {
    let bodies = examples("telemetry").into_iter().map(|(_, frame)| plain(&frame).1);
    let sets = bodies.filter_map(|body| {
        let mut reader = Reader { rest: body.strip_prefix(&[3])?, found: Vec::new() };
        let length = reader.varint() as usize;
        assert_eq!(length, reader.rest.len());
        Some(reader.rest.to_vec())
    });
    let sets: Vec<Vec<u8>> = sets.collect();
    let [set, none] = &sets[..] else { panic!("{sets:?}") };
    assert!(none.is_empty());
    let (content, check) = set.split_at(set.len() - 4);
    assert_eq!(crc_32c(content).to_le_bytes(), check);
    // Format 1, a gyroscope and no compass; device, id, ±4 g, no time, 25 °C, 16 bits of fraction.
    assert_eq!(content[..2], [1, 1]);
    assert_eq!(content[2..10], 0x0123_4567_89ab_cdef_u64.to_le_bytes());
    assert_eq!(content[10..14], 0x1234_5678_u32.to_le_bytes());
    assert_eq!(content[14], 4);
    assert_eq!(content[15..19], [0; 4]);
    assert_eq!(content[19..21], 2500_i16.to_le_bytes());
    assert_eq!(content.len(), 21 + 92 + 92 + 36);
    // The force of counts of 1 g on z in the sensor's own axes, at the reference.
    let triad = &content[21..113];
    let word = |at: usize| i32::from_le_bytes(triad[at..at + 4].try_into().expect("four"));
    let shift = triad[0];
    let unit = f64::from(1_u32 << shift) * 32768.0 * 65536.0;
    let scale = f64::from(word(1 + 4 * 8)) / unit * 8192.0;
    assert!((scale - 9.80665 / 1.01).abs() < 1e-3, "{scale}");
    let offset =
        (f64::from(word(37)) - f64::from(1_u32 << (shift - 1))) / f64::from(1_u32 << shift);
    assert!((offset / 65536.0 + 0.125).abs() < 0.01, "{offset}");
}

#[test]
fn a_greeting_and_its_question_read_as_the_document_says() {
    for (text, frame) in examples("hello") {
        let (first, body) = plain(&frame);
        assert_eq!((first & 15, &body[..4]), (1, &b"WIMU"[..]));
        let number = |at: usize, length: usize| {
            let bytes = body[at..at + length].iter().rev();
            bytes.fold(0_u64, |value, &byte| value << 8 | u64::from(byte))
        };
        let name = |at: usize| {
            let length = usize::from(body[at]);
            let name = std::str::from_utf8(&body[at + 1..at + 1 + length]).expect("ASCII");
            format!("{name:?}")
        };
        let one_of = |names: &[&str], at: usize| names[usize::from(body[at])].to_owned();
        let decimal = |at, length| number(at, length).to_string();
        let resets = ["Unknown", "PowerOn", "Pin", "Watchdog", "Software", "BrownOut", "Fault"];
        let mut found = vec![
            "Hello".to_owned(),
            decimal(5, 1),
            one_of(&["", "Cable", "Wireless"], 6),
            one_of(&["Open", "Key", "Locked"], 7),
            decimal(8, 8),
            decimal(16, 4),
            format!("Capabilities({})", number(20, 4)),
            format!("ParameterId({})", number(24, 4)),
            decimal(28, 8),
            decimal(36, 2),
            decimal(38, 2),
            decimal(40, 2),
            one_of(&resets, 42),
        ];
        match &body[usize::from(body[4])..] {
            [] => found.push("None".to_owned()),
            [1, length, place @ ..] if place.len() == usize::from(*length) => {
                let line = decimal(body.len() - place.len(), 4);
                let file = std::str::from_utf8(&place[4..]).expect("ASCII");
                found.push(format!("Some(Fault {{ line: {line}, file: {file:?} }})"));
            }
            other => panic!("the examples have no extension {other:?}"),
        }
        found.extend([
            (body[43] & 1 == 1).to_string(),
            // Earlier examples do not name it.
            if text.contains("safe_mode") {
                (body[43] >> 1 & 1 == 1).to_string()
            } else {
                String::new()
            },
            decimal(44, 2),
            name(48),
            decimal(46, 2),
            name(64),
        ]);
        found = said(&found.join(" "));
        assert_eq!(found, said(&text), "{text}");
    }
    for (_, frame) in examples("who_are_you") {
        let (first, body) = plain(&frame);
        assert_eq!((first & 15, &body[..4], body[4]), (2, &b"WIMU"[..], 6));
        assert_eq!(body.len(), 6);
    }
}

/// The example in Python on the document's batches.
#[test]
fn every_batch_reads_as_the_document_says() {
    for file in ["batch", "inertial"] {
        python_reads(file);
    }
}

fn python_reads(file: &str) {
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/read_batch.py");
    let python = std::process::Command::new("python3")
        .arg(program)
        .arg(folder().join(file).with_extension("hex"))
        .output();
    let Ok(ran) = python else {
        println!("skipped: there is no python3");
        return;
    };
    let said = String::from_utf8_lossy(&ran.stdout).into_owned();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    assert_eq!(said.lines().count(), examples(file).len(), "{said}");
    assert!(said.lines().all(|line| line.starts_with("ok ")), "{said}");
}
