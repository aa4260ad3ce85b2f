//! Recordings of a board with a gyroscope: replay, tables, ROS messages, and commands that show them.

use crate::kit;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use kit::{Simulator, folder, kept_folder, record_calibrated, record_motion_of, wimu};
use serde_json::Value;
use wimu_host::calibration::{Calibration, parameter_id, read_parameters};
use wimu_host::capture::{Boot, Capture};
use wimu_host::mcap_file::{RecordingReader, RecordingWriter};
use wimu_host::replay::verify;
use wimu_link::message::Attitude;
use wimu_link::{LinkRole, MAX_FRAME, batch};
use wimu_model::{AngularRateQ20, CompiledSet, Counts, DeviceTimeUs, ParameterSet};
use wimu_sim::board::SensorPart;

/// A calibrated LSM6DSO that rests, moves and rests, and its calibration; recorded once.
struct Session {
    folder: PathBuf,
    mcap: String,
    set: ParameterSet,
}

impl Session {
    fn get() -> &'static Self {
        static SESSION: OnceLock<Session> = OnceLock::new();
        SESSION.get_or_init(|| {
            let folder = kept_folder("six-axes");
            let at = |name: &str| folder.join(name).display().to_string();
            let (poses, calibration, mcap) = (at("poses.mcap"), at("CAL.json"), at("six.mcap"));
            record_motion_of(SensorPart::Lsm6dso, "twelve-poses", 6, &poses);
            wimu(&["calibrate", &poses, "-o", &calibration]).succeeds();
            record_calibrated(SensorPart::Lsm6dso, &calibration, "rest,carry,rest", 6, &mcap);
            let set = read_parameters(calibration.as_ref()).unwrap();
            Self { folder, mcap, set }
        })
    }
}

/// The longest start on the cable of a recording.
fn boot(file: &str) -> Boot {
    let recording = Capture::load(file.as_ref()).unwrap();
    recording.link(None).unwrap().longest().unwrap().clone()
}

#[test]
fn samples_of_six_axes_are_replayed_bit_for_bit_from_any_epoch() {
    let boot = boot(&Session::get().mcap);
    assert!(boot.epochs().len() >= 10, "{}", boot.epochs().len());
    let all = verify(&boot, 0);
    assert!(all.rates_compared > 1000 && all.attitudes_compared > 100, "{all:?}");
    for epoch in 0..boot.epochs().len() {
        let report = verify(&boot, epoch);
        assert!(report.is_exact(), "{epoch}: {report:?}");
        assert_eq!((report.breaks, report.epochs_unusable), (0, 0));
        assert_eq!(report.rates_compared, report.samples);
    }
}

#[test]
fn where_the_gyroscope_stops_the_replay_pauses_until_the_next_epoch() {
    let folder = folder();
    let mcap = folder.path().join("stops.mcap").display().to_string();
    let board = ["--chip", "lsm6dso", "--motion", "rest", "--faults", "gyroscope-stops=2s@4s"];
    Simulator::start(&[&board[..], &["--speed", "8", "--exit-when-done"]].concat())
        .record_to_the_end(&mcap);
    let report = verify(&boot(&mcap), 0);
    assert!(report.is_exact() && report.breaks == 1, "{report:?}");
}

/// Copies the entries of a recording, without the source of its parameters; returns the time of the last one too, ns.
fn copied(from: &str, to: &Path) -> (RecordingWriter<fs::File>, u64) {
    let mut reader = RecordingReader::open(from.as_ref()).unwrap();
    let mut writer = RecordingWriter::create(to, reader.anchor().unwrap().unwrap()).unwrap();
    let mut last_ns = 0;
    while let Some(received) = reader.next_received().unwrap() {
        writer.append(received.role, received.host_ns, &received.bytes).unwrap();
        last_ns = received.host_ns;
    }
    (writer, last_ns)
}

#[test]
fn samples_without_a_rate_have_empty_fields_in_a_table() {
    let session = Session::get();
    let at = |name: &str| session.folder.join(name);
    let (mcap, table) = (at("without.mcap"), at("without.csv").display().to_string());
    let last = *boot(&session.mcap).raw().last().unwrap();
    let mut frame = [0; MAX_FRAME];
    let time = DeviceTimeUs(last.time.0 + 10_000);
    let length =
        batch::encode(last.sequence + 1, time, &[Counts([0, 0, 16_384]); 16], &mut frame).unwrap();
    let (mut writer, last_ns) = copied(&session.mcap, &mcap);
    writer.append(LinkRole::Cable, last_ns + 10_000_000, &frame[..length]).unwrap();
    writer.finish().unwrap();
    wimu(&["convert", &mcap.display().to_string(), "-o", &table]).succeeds();
    let (header, rows) = table_of(&table);
    let rate = column(&header, "Gyroscope X (LSB)");
    assert_eq!(rows.iter().filter(|row| row[rate].is_empty()).count(), 16);
}

fn table_of(path: &str) -> (Vec<String>, Vec<Vec<String>>) {
    let text = fs::read_to_string(path).unwrap();
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect());
    (lines.next().unwrap(), lines.collect())
}

fn column(header: &[String], name: &str) -> usize {
    let found = header.iter().position(|column| column == name);
    found.unwrap_or_else(|| panic!("{name}: {header:?}"))
}

fn numbers<const N: usize>(
    (header, rows): &(Vec<String>, Vec<Vec<String>>),
    names: [&str; N],
) -> Vec<[f64; N]> {
    let columns = names.map(|name| column(header, name));
    let number = |row: &Vec<String>, at: usize| row[at].parse().unwrap_or(f64::NAN);
    rows.iter().map(|row| columns.map(|at| number(row, at))).collect()
}

#[test]
fn exported_tables_have_rates_and_attitudes_and_serve_as_input() {
    let session = Session::get();
    let boot = boot(&session.mcap);
    let table = |stream: &str| {
        let path = session.folder.join(stream).with_extension("csv");
        let path = path.display().to_string();
        wimu(&["convert", &session.mcap, "--stream", stream, "-o", &path]).succeeds();
        (table_of(&path), path)
    };
    let (raw, raw_path) = table("raw");
    let rates = numbers(&raw, ["Gyroscope X (LSB)", "Gyroscope Y (LSB)", "Gyroscope Z (LSB)"]);
    let sent = boot.raw().iter().map(|sample| sample.rate.unwrap().map(f64::from));
    assert!(rates.iter().copied().eq(sent));
    let scale = numbers(&raw, ["Gyroscope Scale (rad/s/LSB)"]);
    let nominal = session.set.gyroscope.unwrap().rad_s_per_lsb;
    assert!(scale.iter().all(|[scale]| (scale / nominal - 1.0).abs() < 1e-6));

    let (corrected, corrected_path) = table("corrected");
    let rates =
        numbers(&corrected, ["Gyroscope X (rad/s)", "Gyroscope Y (rad/s)", "Gyroscope Z (rad/s)"]);
    let sent = boot.corrected().iter().map(|s| AngularRateQ20(s.rate.unwrap()).to_rad_s());
    assert!(rates.iter().copied().eq(sent));

    let (navigation, _) = table("navigation");
    let quaternions =
        numbers(&navigation, ["Quaternion W", "Quaternion X", "Quaternion Y", "Quaternion Z"]);
    let units = quaternions.iter().filter(|q| !q[0].is_nan());
    assert_eq!(units.clone().count(), boot.attitude.len());
    for q in units {
        let norm = q.iter().map(|part| part * part).sum::<f64>();
        assert!((norm - 1.0).abs() < 1e-6, "{norm}");
    }

    let out = session.folder.join("none.csv").display().to_string();
    let none = wimu(&["convert", &session.mcap, "--sensor", "3", "-o", &out]).fails(2, "no_rows");
    assert!(none["remedy"].as_str().unwrap().contains("[0]"), "{none}");
    for input in [&raw_path, &corrected_path, &session.mcap] {
        let mut arguments = vec!["navigate", input];
        if input == &raw_path {
            arguments.extend(["--sensitivity", "16384"]);
        }
        let report = wimu(&arguments).succeeds();
        assert_eq!(report.get("path").unwrap_or(&report)["method"], "strapdown");
    }
}

/// The numbers of each `sensor_msgs/msg/Imu` on a topic.
fn imu(path: &str, topic: &str) -> Vec<[f64; 37]> {
    let bytes = fs::read(path).unwrap();
    mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| message.unwrap())
        .filter(|message| message.channel.topic == topic)
        .map(|message| {
            let numbers = &message.data[message.data.len() - 37 * 8..];
            let mut fields = [0.0; 37];
            for (field, bytes) in fields.iter_mut().zip(numbers.chunks(8)) {
                *field = f64::from_le_bytes(bytes.try_into().unwrap());
            }
            fields
        })
        .collect()
}

#[test]
fn ros_messages_have_angular_velocity_with_covariance_and_orientation() {
    let session = Session::get();
    let out = session.folder.join("decoded.mcap").display().to_string();
    wimu(&["convert", &session.mcap, "-o", &out]).succeeds();
    let boot = boot(&session.mcap);
    let data = imu(&out, "/cable/imu/data");
    assert_eq!(data.len(), boot.corrected().len());
    let sd = session.set.gyroscope.unwrap().sd.unwrap();
    let sent: BTreeMap<_, _> = boot.attitude.iter().map(|a| (a.sequence, a)).collect();
    // At rest, before scale factors add to it, σ is that of the bias.
    for axis in 0..3 {
        let found = data[0][16 + 4 * axis].sqrt();
        assert!((found - f64::from(sd[axis])).abs() < 1e-6, "{axis}: {found} {sd:?}");
    }
    for (fields, sample) in data.iter().zip(boot.corrected()) {
        assert_eq!(fields[13..16], AngularRateQ20(sample.rate.unwrap()).to_rad_s());
        match sent.get(&sample.sequence).map(|attitude| Attitude::to_quaternion(attitude)) {
            Some([w, x, y, z]) => assert_eq!(fields[..5], [x, y, z, w, 0.0]),
            None => assert_eq!(fields[..5], [0.0, 0.0, 0.0, 1.0, -1.0]),
        }
    }
    let raw = imu(&out, "/cable/imu/data_raw");
    assert_eq!(raw.len(), boot.raw().len());
}

#[test]
fn a_calibration_whose_source_is_not_known_corrects_with_its_integers() {
    let session = Session::get();
    let unknown = session.folder.join("unknown.mcap");
    copied(&session.mcap, &unknown).0.finish().unwrap();
    let unknown = unknown.display().to_string();
    let path = |session: &str| {
        let report = wimu(&["navigate", session, "--zupt", "off"]).succeeds();
        report["starts"][0]["recomputed"].clone()
    };
    assert!(path(&session.mcap)["final_position_m"].is_array());
    assert_eq!(path(&session.mcap), path(&unknown));
    let notes = |session: &str| {
        let problems = wimu(&["align", session, "--up", "z", "--forward"]).problems();
        problems.into_iter().filter(|p| p["code"] == "source_unknown").collect::<Vec<_>>()
    };
    assert_eq!(notes(&session.mcap), Vec::<Value>::new());
    let text = notes(&unknown)[0]["text"].to_string();
    assert!(text.contains("part for the gyroscope is left out"), "{text}");
}

#[test]
fn a_calibration_exported_for_a_device_is_the_set_that_the_device_compiles() {
    let (folder, set) = (folder(), &Session::get().set);
    let [calibration, out] =
        ["CAL.json", "sensor.wimu"].map(|name| folder.path().join(name).display().to_string());
    Calibration::held(set).write(Path::new(&calibration)).unwrap();
    let report = wimu(&["convert", &calibration, "--to", "device", "-o", &out]).succeeds();
    let bytes = fs::read(&out).unwrap();
    assert_eq!(report["bytes"], bytes.len());
    let compiled = CompiledSet::compile(set, parameter_id(set), 0).unwrap();
    assert_eq!(CompiledSet::from_bytes(&bytes).unwrap(), compiled);
}

#[test]
fn info_monitor_and_compare_know_the_gyroscope() {
    let session = Session::get();
    let count = boot(&session.mcap).raw().len();
    let info = wimu(&["info", &session.mcap]).succeeds();
    let link = &info["links"][0];
    assert!(link["sensors"][0]["angular_rates"].as_u64() >= Some(count as u64), "{link}");
    assert!(link["sensors"][0]["gyroscope_range_dps"].as_f64() > Some(100.0), "{link}");
    assert_eq!(link["statistics"]["raw"]["missing"], 0);

    let monitor = wimu(&["monitor", &session.mcap]);
    assert_eq!(monitor.code, 0, "{monitor:?}");
    let lines = monitor.objects();
    let last = &lines[lines.len() - 1];
    for (key, length) in [("angular_rate_rad_s", 3), ("raw_angular_rate_lsb", 3), ("quaternion", 4)]
    {
        assert_eq!(last[key].as_array().map(Vec::len), Some(length), "{key}");
    }

    let compare = wimu(&["compare", &session.mcap]).succeeds();
    let pairs = &compare["pairs"];
    assert!(pairs.as_u64() > Some(1000) && compare["identical"] == *pairs, "{pairs}");
    assert_eq!((&compare["with_rates"], &compare["rates_differ"]), (pairs, &0.into()));
}
