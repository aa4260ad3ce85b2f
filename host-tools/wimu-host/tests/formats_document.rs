//! docs/reference/formats.md holds what is read today.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use wimu_host::formats::{self, ReadOptions};
use wimu_host::recording::{Quantity, Recording, Track, Unit};

/// What a row of `checks.csv` says, and what is read.
struct Check {
    file: String,
    channel: String,
    samples: u64,
    mean_norm: f64,
    reader: String,
}

fn checks(folder: &Path) -> Vec<Check> {
    let text = std::fs::read_to_string(folder.join("checks.csv")).unwrap();
    let row = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        Check {
            file: fields[0].to_owned(),
            channel: fields[1].to_owned(),
            samples: fields[3].parse().unwrap(),
            mean_norm: fields[12].parse().unwrap(),
            reader: fields[13].to_owned(),
        }
    };
    text.lines().skip(1).map(row).collect()
}

/// Number of rows and mean magnitude of a track.
fn figures(track: &Track) -> (u64, f64) {
    let norms =
        track.valid().map(|(_, row)| row.iter().map(|axis| axis * axis).sum::<f64>().sqrt());
    let (count, sum) = norms.fold((0_u64, 0.0), |(count, sum), norm| (count + 1, sum + norm));
    (count, sum / count.max(1) as f64)
}

/// The track of a quantity; an acceleration without gravity where there is no specific force.
fn of(recording: &Recording, quantity: Quantity) -> Option<&Track> {
    let linear = Quantity::LinearAcceleration;
    let other = (quantity == Quantity::SpecificForce).then_some(linear);
    let found = recording.of(quantity).next();
    found.or_else(|| recording.of(other?).next())
}

/// A row of the table, and whether it agrees with the independent reader.
fn row(folder: &Path, check: &Check) -> (String, bool) {
    let mut options = ReadOptions::default();
    let quantity = match check.channel.as_str() {
        "accelerometer" => Quantity::SpecificForce,
        "gyroscope" => Quantity::AngularRate,
        "gravity" => Quantity::Gravity,
        topic => {
            options.topic = Some(topic.to_owned());
            Quantity::SpecificForce
        }
    };
    let (file, channel) = (&check.file, &check.channel);
    let (format, outcome, agrees) = match formats::load(&folder.join(file), &options) {
        Ok(recording) => match of(&recording, quantity) {
            Some(track) => {
                let (count, mean) = figures(track);
                let agrees = count == check.samples && (mean / check.mean_norm - 1.0).abs() < 1e-6;
                let unit = match track.info.unit {
                    Unit::Counts { .. } => "LSB",
                    _ => quantity.si(),
                };
                let name = track.info.quantity.name();
                let outcome = format!("{name}: {count} rows, {mean:.4} {unit}");
                (recording.format.to_owned(), outcome, agrees)
            }
            None => (recording.format.to_owned(), "no such track".to_owned(), false),
        },
        Err(error) => ("refused".to_owned(), error.text.clone(), false),
    };
    let same = if agrees { "same" } else { "–" };
    let line = format!("| {format} | {file} | {channel} | {outcome} | {same} ({}) |", check.reader);
    (line, agrees)
}

#[test]
fn the_document_of_formats_holds_what_is_read_and_what_other_readers_found() {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder = root.join("../shared/data/formats");
    if !folder.is_dir() {
        println!("skipped: the public recordings, ../shared/data, are absent");
        return;
    }
    let mut table = String::new();
    for check in checks(&folder) {
        let (line, agrees) = row(&folder, &check);
        let is_optional = check.file.ends_with("_db3");
        assert!(agrees || is_optional, "{line}");
        writeln!(table, "{line}").unwrap();
    }
    let path = root.join("docs/reference/formats.md");
    let text = std::fs::read_to_string(&path).unwrap();
    let (head, rest) = text.split_once("<!-- files -->\n").unwrap();
    let (_, tail) = rest.split_once("<!-- end -->").unwrap();
    let made = format!("{head}<!-- files -->\n{HEADER}{table}<!-- end -->{tail}");
    if std::env::var_os("WIMU_WRITE_DOCS").is_some() {
        std::fs::write(&path, &made).unwrap();
    }
    assert_eq!(std::fs::read_to_string(&path).unwrap(), made, "WIMU_WRITE_DOCS=1 writes it");
}

const HEADER: &str = "| format | file | track | rows and mean magnitude | independent reader |\n|---|---|---|---|---|\n";
