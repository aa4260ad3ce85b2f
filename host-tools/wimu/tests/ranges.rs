//! Recordings in which the range changes, and recordings whose file is damaged. Their frames are made
//! here, as a board sends them.

use crate::kit;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use kit::{Transcript, folder, wimu};
use wimu_host::mcap_file::{ClockAnchor, RecordingWriter};
use wimu_link::message::{Epoch, EpochReason};
use wimu_link::{Hello, LinkRole, MAX_FRAME, Telemetry, batch};
use wimu_model::{Counts, DeviceTimeUs, STANDARD_GRAVITY_MPS2};

const ROLES: [LinkRole; 2] = [LinkRole::Cable, LinkRole::Wireless];
/// Samples of a batch, at 100 Hz.
const BATCH: u32 = 16;
/// Samples in all.
const SAMPLES: u32 = 90 * BATCH;

/// The range, ± g: 2, from sample 480 to 960 16, then 2 again.
fn range_g(sequence: u32) -> u8 {
    if (480..960).contains(&sequence) { 16 } else { 2 }
}

fn epoch(number: u8, sequence: u32, reason: EpochReason) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let range_g = range_g(sequence);
    let epoch = <Telemetry>::Epoch(Epoch {
        reason,
        number,
        sequence,
        time_us: time_us(sequence),
        period_ns: 10_000_000,
        range_g,
        sensitivity_lsb_per_g: 32_768.0 / f64::from(range_g),
        full_scale: 32_752,
        parameters: 0,
        temperature_centi_c: None,
        ..Epoch::default()
    });
    let length = epoch.encode(&mut frame).unwrap();
    frame[..length].to_vec()
}

fn time_us(sequence: u32) -> u64 {
    1_000_000 + u64::from(sequence) * 10_000
}

/// A board at rest on a link that holds samples up for so long, while epochs overtake them; those of
/// these samples are lost. With host times, ns.
fn link(role: LinkRole, late_ms: u64, lost: &[u32]) -> Vec<(LinkRole, u64, Vec<u8>)> {
    let mut frame = [0; MAX_FRAME];
    let hello = Hello { boot_count: 1, sensitivity_known: true, ..Hello::new(role) };
    let length = hello.encode(&mut frame).unwrap();
    let at_ns = |sequence| time_us(sequence) * 1000;
    let mut brought = vec![(role, at_ns(0), frame[..length].to_vec())];
    let mut number = 0;
    for first in (0..SAMPLES).step_by(BATCH as usize) {
        let reason = match first {
            0 => Some(EpochReason::Start),
            480 | 960 => Some(EpochReason::Settings),
            _ => (first % 80 == 0).then_some(EpochReason::Periodic),
        };
        if let Some(reason) = reason {
            if !lost.contains(&first) {
                brought.push((role, at_ns(first), epoch(number, first, reason)));
            }
            number += 1;
        }
        let one_g = (32_768 / u16::from(range_g(first))) as i16;
        let samples = [Counts([one_g, 0, 0]); BATCH as usize];
        let time = DeviceTimeUs(time_us(first));
        let length = batch::encode(first, time, &samples, &mut frame).unwrap();
        let arrives_ns = at_ns(first + BATCH) + late_ms * 1_000_000;
        brought.push((role, arrives_ns, frame[..length].to_vec()));
    }
    brought
}

/// A recording of it, in `folder`.
fn file(folder: &Path, links: &[Vec<(LinkRole, u64, Vec<u8>)>]) -> String {
    let path = folder.join("made.mcap");
    let anchor = ClockAnchor { monotonic_ns: 0, utc_ns: 1_795_222_920_000_000_000 };
    let mut writer = RecordingWriter::create(&path, anchor).unwrap();
    let mut brought = links.concat();
    brought.sort_by_key(|(_, host_ns, _)| *host_ns);
    for (role, host_ns, bytes) in brought {
        writer.append(role, host_ns, &bytes).unwrap();
    }
    writer.finish().unwrap();
    path.to_str().unwrap().to_owned()
}

/// The magnitudes of `imu/data_raw` by link, m/s², and the report of the command.
fn decoded(session: &str, folder: &Path) -> (BTreeMap<String, Vec<f64>>, serde_json::Value) {
    let output = folder.join("decoded.mcap").display().to_string();
    let report = wimu(&["convert", session, "-o", &output]).succeeds();
    let bytes = fs::read(output).unwrap();
    let mut found: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        if let Some(link) = message.channel.topic.strip_suffix("/imu/data_raw") {
            // The last twelve numbers are the acceleration and its covariance.
            let end = message.data.len();
            let number = |index: usize| {
                let at = end - 8 * (12 - index);
                f64::from_le_bytes(message.data[at..at + 8].try_into().unwrap())
            };
            let [x, y, z] = [0, 1, 2].map(number);
            let magnitude = (x * x + y * y + z * z).sqrt();
            found.entry(link.to_owned()).or_default().push(magnitude);
        }
    }
    (found, report)
}

fn are_one_g(magnitudes: &[f64]) {
    for magnitude in magnitudes {
        assert!((magnitude - STANDARD_GRAVITY_MPS2).abs() < 1e-9, "{magnitude}");
    }
}

#[test]
fn samples_that_epochs_overtake_keep_their_own_range() {
    let folder = folder();
    let links = [link(ROLES[0], 0, &[]), link(ROLES[1], 700, &[])];
    let session = file(folder.path(), &links);
    let (found, report) = decoded(&session, folder.path());
    for link in ["/cable", "/wireless"] {
        assert_eq!(found[link].len(), SAMPLES as usize);
        are_one_g(&found[link]);
    }
    assert_eq!(report["without_unit"], 0, "{report}");
    let compared = wimu(&["compare", &session]).succeeds();
    assert_eq!(compared["without_unit"], 0, "{compared}");
    for link in compared["links"].as_array().unwrap() {
        let wrong = link["by_arrival"]["rms_mps2"].as_f64().unwrap();
        assert!(wrong < 1e-9, "{link}");
    }
}

#[test]
fn where_the_epoch_of_a_change_is_lost_samples_are_left_out_and_counted() {
    let folder = folder();
    let session = file(folder.path(), &[link(ROLES[1], 300, &[480])]);
    let (found, report) = decoded(&session, folder.path());
    // From after the last epoch of the old range to the first of the new one.
    let unknown = 560 - 400 - 1;
    assert_eq!(report["without_unit"], unknown, "{report}");
    assert_eq!(found["/wireless"].len(), (SAMPLES - unknown) as usize);
    are_one_g(&found["/wireless"]);
}

#[test]
fn an_epoch_lost_on_one_link_is_taken_from_the_other() {
    let folder = folder();
    let links = [link(ROLES[0], 0, &[]), link(ROLES[1], 300, &[480, 960])];
    let session = file(folder.path(), &links);
    let (found, report) = decoded(&session, folder.path());
    assert_eq!(report["without_unit"], 0, "{report}");
    are_one_g(&found["/wireless"]);
    let compared = wimu(&["compare", &session]).succeeds();
    assert_eq!(compared["without_unit"], 0, "{compared}");
}

#[test]
fn pairs_of_an_unknown_range_are_left_out_of_the_values() {
    let folder = folder();
    let links = [link(ROLES[0], 0, &[480]), link(ROLES[1], 300, &[480])];
    let compared = wimu(&["compare", &file(folder.path(), &links)]).succeeds();
    assert_eq!(compared["pairs"], SAMPLES, "{compared}");
    assert_eq!(compared["without_unit"], 159, "{compared}");
}

#[test]
fn a_calibration_by_the_cable_goes_by_each_samples_range() {
    let folder = folder();
    // The wireless link has lost a change, which the cable has.
    let links = [link(ROLES[0], 0, &[]), link(ROLES[1], 300, &[960])];
    let session = file(folder.path(), &links);
    let found = wimu(&["calibrate", &session, "--method", "reference"]).succeeds();
    assert_eq!(found["samples"], SAMPLES, "{found}");
    let at = found["axes"][0]["at_m_s2"].as_f64().unwrap();
    assert!((at - STANDARD_GRAVITY_MPS2).abs() < 1e-9, "{found}");

    // Samples whose range is unknown are left out, which is reported.
    let links = ROLES.map(|role| link(role, 0, &[960]));
    let folder = kit::folder();
    let session = file(folder.path(), &links);
    let ran = wimu(&["calibrate", &session, "--method", "reference"]);
    let found = ran.succeeds();
    let mut texts = Transcript::default();
    texts.text("159 samples of unknown range", &ran);
    texts.check("calibrate_reference");
    assert_eq!(found["samples"], SAMPLES - 159, "{found}");
    let at = found["axes"][0]["at_m_s2"].as_f64().unwrap();
    assert!((at - STANDARD_GRAVITY_MPS2).abs() < 1e-9, "{found}");
}

#[test]
fn samples_before_the_first_epoch_are_decoded() {
    let folder = folder();
    let session = file(folder.path(), &[link(ROLES[1], 0, &[0])]);
    let (found, report) = decoded(&session, folder.path());
    assert_eq!(report["without_unit"], 0, "{report}");
    assert_eq!(found["/wireless"].len(), SAMPLES as usize);
}

#[test]
fn a_table_of_counts_gives_the_unit_of_each_row_and_is_read_for_one_range() {
    let mut texts = Transcript::default();
    let folder = folder();
    let session = file(folder.path(), &[link(ROLES[0], 0, &[960])]);
    let table = folder.path().join("a.csv").display().to_string();
    let ran = wimu(&["convert", &session, "-o", &table]);
    texts.text("export", &ran);
    let report = ran.succeeds();
    assert_eq!((&report["rows"], &report["without_unit"]), (&SAMPLES.into(), &159.into()));
    let text = fs::read_to_string(&table).unwrap();
    let mut lines = text.lines();
    assert!(lines.next().unwrap().ends_with(",Sensitivity (LSB/g)"));
    for line in lines {
        let fields: Vec<&str> = line.split(',').collect();
        let (x, sensitivity) = (fields[1], fields[fields.len() - 1]);
        assert!(sensitivity.is_empty() || x == sensitivity, "{line}");
    }
    texts.fails("allan", &wimu(&["allan", &table]), 2, "csv_mixed_units");
    texts.check("table_of_several_ranges");
    let one = "Sensitivity (LSB/g)=2048";
    let noise = wimu(&["allan", &table, "--where", one, "--sensitivity", "2048"]).object();
    assert_ne!(noise["code"], "csv_mixed_units", "{noise}");
}

#[test]
fn a_damaged_or_cut_file_is_reported() {
    let mut texts = Transcript::default();
    let folder = folder();
    let links = ROLES.map(|role| link(role, 20, &[]));
    let session = file(folder.path(), &links);
    let whole = fs::read(&session).unwrap();
    let mut damaged = whole.clone();
    damaged[whole.len() / 2] ^= 0x10;
    let cut = whole[..whole.len() / 2].to_vec();
    for (case, bytes, chunks) in [("damaged", damaged, 1), ("cut", cut, 0)] {
        fs::write(&session, bytes).unwrap();
        let table = folder.path().join(format!("{chunks}.csv")).display().to_string();
        let copy = folder.path().join(format!("{chunks}.mcap")).display().to_string();
        for arguments in [
            vec!["compare", &session],
            vec!["convert", &session, "-o", &table],
            vec!["convert", &session, "-o", &copy],
            vec!["info", &session],
        ] {
            let ran = wimu(&arguments);
            let object = ran.succeeds();
            assert_eq!(object["damaged_chunks"], chunks, "{ran:?}");
            assert_eq!(object["truncated"], chunks == 0, "{ran:?}");
            texts.text(format_args!("{case}, {}", arguments[0]), &ran);
            // A fault of the file is none of the links.
            for link in object["links"].as_array().into_iter().flatten() {
                let statistics = link.get("statistics");
                let counts = match statistics {
                    Some(statistics) => vec![&statistics["raw"]["missing"]],
                    None => vec![&link["lost"], &link["missing_on_both"], &link["damaged"]],
                };
                assert!(counts.iter().all(|count| **count == 0), "{object}");
            }
        }
    }
    texts.check("damaged_recordings");
}
