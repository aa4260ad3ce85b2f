//! The frozen fixtures in `tests/vectors/compat`: what users keep and what other programs read. See the README there.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use serde_json::Value;
use sha2::{Digest, Sha256};
use wimu_host::capture::{Boot, Capture};
use wimu_host::fleet::mqtt::{Heard, Mqtt, MqttConfig};
use wimu_host::replay::{Replay, Step, verify};
use wimu_link::batch::Stream;

use crate::kit::fleet::{Gateway, Mosquitto};
use crate::kit::{Background, Simulator, folder, wait_until, wimu};

const RECORDINGS: [&str; 3] = ["two_links.mcap", "gyroscope.mcap", "two_sensors.mcap"];
/// Digits of a hash that are kept: 64 bits.
const HASH_DIGITS: usize = 16;

fn frozen() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/vectors/compat")
}

/// Compares with a frozen file, or writes it if `WIMU_WRITE_COMPAT` is set.
fn check(name: &str, found: &str) {
    let file = frozen().join(name);
    if std::env::var_os("WIMU_WRITE_COMPAT").is_some() {
        return fs::write(file, found).expect("written");
    }
    let expected = fs::read_to_string(file).expect("a frozen file");
    let [old, new] = [&expected, found].map(|text| text.lines().collect::<Vec<_>>());
    for line in 0..old.len().max(new.len()) {
        let [old, new] = [&old, &new].map(|lines| lines.get(line).unwrap_or(&"(nothing)"));
        assert_eq!(old, new, "{name}, line {}: frozen, and found", line + 1);
    }
}

fn hash(bytes: impl AsRef<[u8]>) -> String {
    let digits = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect::<String>();
    digits[..HASH_DIGITS].to_owned()
}

/// Copies a folder of frozen files; only the user may read the copies, as it has to be of keys.
fn copy(from: &Path, to: &Path) {
    let mode = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode));
    fs::create_dir_all(to).expect("a folder");
    mode(to, 0o700).expect("a mode");
    for entry in fs::read_dir(from).expect("a folder").flatten() {
        let copied = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &copied);
            continue;
        }
        fs::copy(entry.path(), &copied).expect("copied");
        mode(&copied, 0o600).expect("a mode");
    }
}

#[test]
fn commands_write_the_frozen_columns_topics_and_keys() {
    let folder = folder();
    copy(&frozen(), folder.path());
    let store = folder.path().join("board/board.store");
    let board =
        Simulator::start(&["--seed", "44", "--motion", "rest", "--store", store.to_str().unwrap()]);
    let commands = fs::read_to_string(frozen().join("commands.txt")).expect("a frozen file");
    let mut found = String::new();
    for line in commands.lines().filter(|line| line.starts_with("$ ")) {
        let words = line.split(' ').skip(2).map(|word| match word {
            "CABLE" => &board.cable,
            "WIRELESS" => &board.wireless,
            word => word,
        });
        let words: Vec<&str> = words.collect();
        let program = ["sh", "-c", "cd \"$0\" && exec \"$@\"", folder.path().to_str().unwrap()];
        Background::start_by(&program, &folder.path().join("board"), &words).finish().succeeds();
        writeln!(found, "{line}").unwrap();
        if let Some(output) = words.iter().position(|word| *word == "-o") {
            let calibrated =
                |word: &&str| word.starts_with("calibrations/") && !word.ends_with("link.json");
            let what = match (words[0], words.iter().any(calibrated)) {
                ("convert", true) => What::Corrected,
                ("convert", false) => What::Exported,
                _ => What::Other,
            };
            describe(what, &folder.path().join(words[output + 1]), &mut found);
        }
    }
    check("commands.txt", &found);
}

/// What a file holds: samples corrected on the host, a recording's own, or something else.
#[derive(Clone, Copy, PartialEq, Eq)]
enum What {
    Corrected,
    Exported,
    Other,
}

/// Describes a file that a command has written.
fn describe(what: What, file: &Path, found: &mut String) {
    let bytes = fs::read(file).expect("an output");
    match file.extension().and_then(|extension| extension.to_str()) {
        Some("csv") => table(what, &String::from_utf8(bytes).expect("text"), found),
        Some("json") => {
            let mut keys = BTreeMap::new();
            structure("", &serde_json::from_slice(&bytes).expect("JSON"), &mut keys);
            for (key, kind) in keys {
                writeln!(found, "  {key}: {kind}").unwrap();
            }
        }
        _ => topics(what, &bytes, found),
    }
}

/// The header of a table, and the values that `convert` writes: without times, which depend on the clock model.
fn table(what: What, text: &str, found: &mut String) {
    let mut rows = text.lines();
    writeln!(found, "  {}", rows.next().expect("a header")).unwrap();
    let values = rows.map(|row| row.split(',').skip(1).collect::<Vec<_>>());
    match what {
        What::Exported => {
            let rows: Vec<String> = values.map(|row| rounded(&row, 9)).collect();
            writeln!(found, "  {} rows, values {}", rows.len(), hash(rows.join("\n"))).unwrap();
        }
        What::Corrected => {
            let filled = |row: &Vec<&str>| row.iter().filter(|value| !value.is_empty()).count();
            let row = values.max_by_key(filled).expect("a row");
            writeln!(found, "  last full row {}", rounded(&row, 5)).unwrap();
        }
        What::Other => {}
    }
}

/// Numbers rounded to `digits` digits after the first; text unchanged.
fn rounded(row: &[&str], digits: usize) -> String {
    let round = |value: &&str| match value.parse::<f64>() {
        Ok(number) => format!("{number:.digits$e}"),
        Err(_) => (*value).to_owned(),
    };
    row.iter().map(round).collect::<Vec<_>>().join(",")
}

/// Adds the keys of a JSON value with their types; an array of numbers is one entry.
fn structure(at: &str, value: &Value, keys: &mut BTreeMap<String, String>) {
    let kind = match value {
        Value::Object(members) => {
            for (key, value) in members {
                structure(&format!("{at}.{key}"), value, keys);
            }
            return;
        }
        Value::Array(items) if items.iter().all(Value::is_number) => {
            format!("{} numbers", items.len())
        }
        Value::Array(items) => {
            for item in items {
                structure(&format!("{at}[{}]", items.len()), item, keys);
            }
            return;
        }
        Value::Null => "null".to_owned(),
        Value::Bool(_) => "flag".to_owned(),
        Value::Number(_) => "number".to_owned(),
        Value::String(text) if at == ".schema" => text.clone(),
        Value::String(_) => "text".to_owned(),
    };
    keys.insert(at.to_owned(), kind);
}

/// The topics of an MCAP file with their types, and its metadata.
fn topics(what: What, bytes: &[u8], found: &mut String) {
    let summary = mcap::Summary::read(bytes).expect("MCAP").expect("a summary");
    let counts = summary.stats.expect("statistics").channel_message_counts;
    let mut lines = BTreeSet::new();
    for (id, channel) in &summary.channels {
        let schema = channel.schema.as_ref().expect("a schema");
        let count = match what {
            What::Exported => format!(", {} messages", counts.get(id).unwrap_or(&0)),
            _ => String::new(),
        };
        lines.insert(format!(
            "  {} {} {} {} {}{count}",
            channel.topic,
            channel.message_encoding,
            schema.name,
            schema.encoding,
            hash(&schema.data)
        ));
    }
    for index in &summary.metadata_indexes {
        let metadata = mcap::read::metadata(bytes, index).expect("metadata");
        let keys: Vec<_> = metadata.metadata.into_keys().collect();
        lines.insert(format!("  metadata {}: {}", metadata.name, keys.join(" ")));
    }
    for line in lines {
        writeln!(found, "{line}").unwrap();
    }
}

#[test]
fn recordings_replay_bit_for_bit() {
    let mut found = String::new();
    for name in RECORDINGS {
        let recording = Capture::load(&frozen().join(name)).expect("a recording");
        for link in recording.links.values() {
            for boot in &link.boots {
                writeln!(found, "{name} {}\n{}", link.role, replayed(boot)).unwrap();
            }
        }
    }
    check("replay.txt", &found);
}

/// Hashes of the samples that a start of the device sent, and of those that are replayed from its raw samples.
fn replayed(boot: &Boot) -> String {
    let (mut computed, mut end) = (String::new(), String::new());
    for step in Replay::new(boot, 0) {
        let Step::Sample(sample) = step else {
            continue;
        };
        let at = sample.navigation;
        let rate = sample.rate.map(|rate| rate.0);
        end = format!(
            "{} {:?} {rate:?} {:?} {:?} {} {:?}",
            sample.raw.sequence,
            sample.force.0,
            at.position.0,
            at.velocity.0,
            at.since_rest_ms,
            at.attitude
        );
        computed += &end;
    }
    let report = verify(boot, 0);
    assert!(report.is_exact(), "{report:?}");
    let mut text = String::new();
    let raw = boot.samples.iter().filter(|((_, stream), _)| *stream == Stream::Raw);
    for ((sensor, _), samples) in raw {
        let sent = samples.iter().map(|s| format!("{} {:?} {:?}\n", s.sequence, s.value, s.rate));
        let sent = hash(sent.collect::<String>());
        writeln!(text, "  sensor {sensor}: {} raw samples {sent}", samples.len()).unwrap();
    }
    write!(
        text,
        "  replayed: {} samples {}, equal to {} corrected samples, {} positions, {} attitudes and {} states of the device\n  last: {end}",
        report.samples,
        hash(&computed),
        report.corrected_compared,
        report.navigation_compared,
        report.attitudes_compared,
        report.states_compared,
    )
    .unwrap();
    text
}

/// What a gateway publishes and hears.
#[test]
#[ignore = "needs Mosquitto: cargo xtask test --only broker"]
fn a_fleet_has_the_frozen_topics_and_keys() {
    let broker = Mosquitto::start();
    let heard = Arc::new(Mutex::new(BTreeMap::new()));
    let ear = heard.clone();
    let config = MqttConfig::new(&broker.url().parse().unwrap(), vec!["wimu/#".to_owned()]);
    let listener = Mqtt::start(config, move |event| {
        if let Heard::Message { topic, payload, .. } = event {
            ear.lock().unwrap().insert(topic.to_owned(), payload.to_vec());
        }
    })
    .unwrap();
    wait_until("the listener", || listener.is_connected());
    let board = Simulator::start(&["--motion", "rest"]);
    let folder = folder();
    let (url, link) = (broker.url(), &board.cable);
    let fleet = format!("fleet = \"hall\"\nbroker = \"{url}\"\n[boards]\nleft = \"{link}\"\n");
    let gateway = Gateway::start(folder.path(), &fleet);
    let remote = format!("mqtt://127.0.0.1:{}/hall/left", broker.port);
    wait_until("the board's answer", || wimu(&["device", "settings", "get", &remote]).code == 0);
    wait_until("all topics", || heard.lock().unwrap().len() == 4);
    gateway.stop();
    let mut found = String::new();
    for (topic, payload) in heard.lock().unwrap().iter() {
        let Ok(state) = serde_json::from_slice::<Value>(payload) else {
            // A batch begins with its version, a frame ends with 0.
            let end = if topic.ends_with("/up") { payload.first() } else { payload.last() };
            writeln!(found, "{topic}: bytes, {}", end.expect("bytes")).unwrap();
            continue;
        };
        let keys: BTreeSet<&String> = state.as_object().expect("an object").keys().collect();
        writeln!(found, "{topic}: {}", state["schema"]).unwrap();
        for key in keys {
            writeln!(found, "  {key}").unwrap();
        }
    }
    check("mqtt.txt", &found);
}
