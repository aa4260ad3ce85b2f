//! Long recordings: what writes and what reads them needs no more memory for them than for short ones.

use std::path::Path;

use wimu_host::capture::Capture;
use wimu_host::compare::compare;
use wimu_host::export::{ExportSource, ExportStream, to_csv};
use wimu_host::mcap_file::{ClockAnchor, RecordingReader, RecordingWriter};
use wimu_link::batch::Stream;
use wimu_link::message::{Epoch, EpochReason};
use wimu_link::{Hello, LinkRole, MAX_FRAME, Telemetry, batch};
use wimu_model::{Counts, DeviceTimeUs};
use wimu_testkit::{Lane, Random, figure};

const ROLES: [LinkRole; 2] = [LinkRole::Cable, LinkRole::Wireless];

/// A recording of both links at 100 Hz for so many minutes, in a file: frames as a board sends them,
/// every tenth of the wireless ones lost.
fn write_long_file(path: &Path, minutes: u32) {
    let _ = std::fs::remove_file(path);
    let anchor = ClockAnchor { monotonic_ns: 0, utc_ns: 1_795_222_920_000_000_000 };
    let mut writer = RecordingWriter::create(path, anchor).unwrap();
    let mut frame = [0; MAX_FRAME];
    let mut write = |role, at_ns: u64, frame: &[u8]| writer.append(role, at_ns, frame).unwrap();
    for role in ROLES {
        let hello = Hello { boot_count: 1, ..Hello::new(role) };
        let length = hello.encode(&mut frame).unwrap();
        write(role, 0, &frame[..length]);
    }
    for batch in 0..minutes * 375 {
        let (first, time_us) = (batch * 16, u64::from(batch) * 160_000);
        let samples: [Counts; 16] = std::array::from_fn(|k| {
            let phase = f64::from(first + k as u32) * 0.07;
            Counts([(9000.0 * phase.sin()) as i16, (7000.0 * phase.cos()) as i16, 900])
        });
        for role in ROLES {
            let noise = Random::new(batch.into()).bits();
            let late_ns = match role {
                LinkRole::Cable => 200_000 + noise % 100_000,
                _ => 15_000_000 + noise % 50_000_000,
            };
            let at_ns = (time_us + 150_000) * 1000 + late_ns;
            if batch % 6 == 0 {
                let epoch = <Telemetry>::Epoch(Epoch {
                    reason: EpochReason::Periodic,
                    number: (batch / 6) as u8,
                    sequence: first,
                    time_us,
                    period_ns: 10_000_000,
                    range_g: 2,
                    sensitivity_lsb_per_g: 16384.0,
                    full_scale: 32752,
                    parameters: 0,
                    temperature_centi_c: None,
                    ..Epoch::default()
                });
                let length = epoch.encode(&mut frame).unwrap();
                write(role, at_ns, &frame[..length]);
            }
            if role == LinkRole::Cable || batch % 10 != 3 {
                let length = batch::encode(first, DeviceTimeUs(time_us), &samples, &mut frame);
                write(role, at_ns, &frame[..length.unwrap()]);
            }
        }
    }
    writer.finish().unwrap();
}

/// Most memory that this process has had, MB.
fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM"));
    let kb = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<f64>().ok());
    kb.unwrap_or(0.0) / 1024.0
}

/// What writes a recording and what reads it.
const STEPS: [&str; 4] = ["record", "compare", "info", "export"];
/// Name the step, the file and how many minutes it has, for a process that does nothing else.
const STEP: &str = "WIMU_TEST_STEP";
const FILE: &str = "WIMU_TEST_LONG_FILE";
const MINUTES: &str = "WIMU_TEST_MINUTES";

/// Writes or reads the file; how many samples of the wireless link were there.
fn do_step(step: &str, path: &Path, minutes: u32) -> u64 {
    match step {
        "record" => {
            write_long_file(path, minutes);
            (0..minutes * 375).filter(|batch| batch % 10 != 3).count() as u64 * 16
        }
        "compare" => {
            let found = compare(|| RecordingReader::open(path), "a.mcap").unwrap();
            assert_eq!(found.identical, found.pairs);
            found.pairs
        }
        "info" => {
            let capture = Capture::survey(path, Vec::new()).unwrap();
            capture.links[&LinkRole::Wireless].count(0, Stream::Raw) as u64
        }
        _ => {
            let table = path.with_extension("csv");
            let wireless =
                ExportSource { role: Some(LinkRole::Wireless), ..ExportSource::default() };
            let rows = to_csv(path, &wireless, ExportStream::Raw, &table).unwrap().rows;
            std::fs::remove_file(table).unwrap();
            rows as u64
        }
    }
}

/// Most memory that each step needs for so many minutes, MB, in a process of its own.
fn peaks_mb(test: &str, minutes: u32) -> [f64; STEPS.len()] {
    let file = format!("wimu-long-{}-{minutes}.mcap", std::process::id());
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(file);
    let peaks = STEPS.map(|step| {
        let ran = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--include-ignored", "--exact", "--nocapture", test])
            .env(STEP, step)
            .env(FILE, &path)
            .env(MINUTES, minutes.to_string())
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&ran.stdout);
        let line = text.lines().find_map(|line| line.split_once("PEAK "));
        let (peak, samples) = line.unwrap_or_else(|| panic!("{text}")).1.split_once(' ').unwrap();
        println!(
            "{step}, {minutes} min: {samples} samples of the wireless link, {peak} MB at most"
        );
        // Nine of ten batches arrived.
        let samples: f64 = samples.parse().unwrap();
        assert!((samples / f64::from(minutes * 375 * 16) - 0.9).abs() < 0.01);
        peak.parse::<f64>().unwrap()
    });
    std::fs::remove_file(&path).unwrap();
    peaks
}

/// A long file needs no more than a short one, but for what the clock keeps.
#[cfg(target_os = "linux")]
#[test]
fn memory_does_not_grow_with_the_recording() {
    let minutes = Lane::current().choose([[1, 4], [5, 25], [60, 1440]]);
    if let (Ok(step), Ok(path), Ok(minutes)) =
        (std::env::var(STEP), std::env::var(FILE), std::env::var(MINUTES))
    {
        let samples = do_step(&step, path.as_ref(), minutes.parse().unwrap());
        println!("PEAK {:.1} {samples}", peak_mb());
        return;
    }
    let test = "long_files::memory_does_not_grow_with_the_recording";
    let [short, long] = minutes.map(|minutes| peaks_mb(test, minutes));
    for ((step, short), long) in STEPS.into_iter().zip(short).zip(long) {
        // The index of the chunks, one a second: 21 MB a day.
        let index = match step {
            "record" => 0.02 * f64::from(minutes[1]),
            _ => 0.0,
        };
        let most = short + 4.0 + index;
        figure(
            &format!("`{step}` of {} and {} min at 100 Hz: memory", minutes[0], minutes[1]),
            format!("{short:.1} / {long:.1} MB"),
            "4 MB more at most, and the index",
            long < most,
        );
        assert!(long < most, "{step}: {short} MB, then {long} MB");
    }
}
