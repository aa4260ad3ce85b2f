//! `wimu record`: links that end, come back or are cut off, and its files as other programs read them.

use crate::kit;

use std::fs;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;

use kit::{Background, Simulator, folder, python_with_rosbags, record_until, wimu};
use serde_json::Value;

#[cfg(unix)]
#[test]
fn ctrl_c_closes_a_recording_and_a_kill_loses_a_second_at_most() {
    let folder = folder();
    let board = Simulator::start(&["--motion", "rest"]);
    for (name, signal, truncated) in [("whole.mcap", "-INT", false), ("cut.mcap", "-KILL", true)] {
        let path = folder.path().join(name);
        let file = path.to_str().unwrap();
        let record = Background::start(&["record", &board.wireless, "-o", file]);
        let enough = || fs::metadata(&path).is_ok_and(|data| data.len() > 20_000);
        kit::wait_until("the recording grows", enough);
        let ran = record.signal(signal);
        if !truncated {
            assert_eq!(ran.code, 0, "{ran:?}");
        }
        let info = wimu(&["info", file]).succeeds();
        assert_eq!(info["truncated"], truncated, "{name}");
        assert!(info["links"][0]["raw_samples"].as_u64().unwrap() > 100);
    }
    // Cut off anywhere behind its head, it reads up to the cut.
    let whole = fs::read(folder.path().join("whole.mcap")).unwrap();
    let cut = folder.path().join("cut-again.mcap");
    for tenths in [3, 5, 7, 9] {
        fs::write(&cut, &whole[..whole.len() * tenths / 10]).unwrap();
        let info = wimu(&["info", cut.to_str().unwrap()]).succeeds();
        assert_eq!(info["truncated"], true);
        let table = folder.path().join(format!("{tenths}.csv"));
        let exported = wimu(&["convert", cut.to_str().unwrap(), "-o", table.to_str().unwrap()]);
        assert!([0, 2].contains(&exported.code), "{exported:?}");
        if exported.code == 2 {
            exported.fails(2, "no_rows");
        }
    }
}

#[test]
fn a_link_that_ends_while_recording_keeps_what_it_brought() {
    let folder = folder();
    let path = folder.path().join("lost.mcap");
    let file = path.to_str().unwrap();
    let board = Simulator::start(&["--motion", "rest"]);
    let record = Background::start(&["record", &board.wireless, "-o", file, "--reconnect", "1"]);
    let enough = || fs::metadata(&path).is_ok_and(|data| data.len() > 20_000);
    kit::wait_until("the recording grows", enough);
    drop(board);
    let recorded = record.finish().succeeds();
    assert_eq!(recorded["ended"]["code"], "link_refused", "{recorded}");
    let info = wimu(&["info", file]).succeeds();
    assert_eq!(info["truncated"], false);
    assert!(info["links"][0]["raw_samples"].as_u64().unwrap() > 100);
}

/// A relay to a board's link that hangs up once, after `after` bytes, and of which the connection numbered
/// `deaf` carries nothing to the board; its LINK.
fn hangs_up_once(link: &str, after: usize, deaf: Option<usize>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let relay = format!("tcp://{}", listener.local_addr().unwrap());
    let target = link.trim_start_matches("tcp://").to_owned();
    std::thread::spawn(move || {
        for (number, client) in listener.incoming().enumerate() {
            let client = client.unwrap();
            let Ok(board) = TcpStream::connect(&target) else {
                return;
            };
            let (mut up_in, mut up_out) = (client.try_clone().unwrap(), board.try_clone().unwrap());
            let up = std::thread::spawn(move || {
                if deaf == Some(number) {
                    std::io::copy(&mut up_in, &mut std::io::sink())
                } else {
                    std::io::copy(&mut up_in, &mut up_out)
                }
            });
            let (mut from, mut to) = (board.try_clone().unwrap(), client.try_clone().unwrap());
            let (mut buffer, mut carried) = ([0; 512], 0);
            while let Ok(count @ 1..) = from.read(&mut buffer) {
                carried += count;
                if to.write_all(&buffer[..count]).is_err() || (number == 0 && carried > after) {
                    break;
                }
            }
            let _ = client.shutdown(Shutdown::Both);
            let _ = board.shutdown(Shutdown::Both);
            let _ = up.join();
        }
    });
    relay
}

#[test]
fn samples_of_a_board_that_receives_nothing_are_counted_alike_in_file_and_summary() {
    let folder = folder();
    let path = folder.path().join("deaf.mcap");
    let file = path.to_str().unwrap();
    let board = Simulator::start(&["--motion", "hand"]);
    let relay = hangs_up_once(&board.wireless, 4000, Some(1));
    let recorder = Background::start(&["record", &relay, "-o", file]);
    let recorded = record_until(recorder, file, |link| {
        link["statistics"]["interruptions"].as_u64() >= Some(2)
            // More than the first two connections bring: the third is open.
            && link["raw_samples"].as_u64() > Some(700)
    });
    let info = wimu(&["info", file]).succeeds();
    let (report, kept) = (&recorded["links"][0], &info["links"][0]["statistics"]);
    assert!(kept["interruptions"].as_u64() >= Some(2), "{kept}");
    for what in ["bytes", "frames", "raw"] {
        assert_eq!(report[what], kept[what], "{what}");
    }
    // The file leaves out an attempt that brought nothing.
    let count = |of: &Value| of["interruptions"].as_u64();
    assert!(count(report) >= count(kept), "{report} {kept}");
    assert!(kept["raw"]["missing"].as_u64().unwrap() > 0, "{kept}");
}

#[test]
fn a_link_that_is_lost_comes_back_without_the_other_or_the_file_being_lost() {
    let folder = folder();
    let path = folder.path().join("gap.mcap");
    let file = path.to_str().unwrap();
    let board = Simulator::start(&["--motion", "hand"]);
    let relay = hangs_up_once(&board.wireless, 4000, None);
    let arguments = ["record", &relay, &board.cable, "-o", file];
    let recorded = record_until(Background::start(&arguments), file, |link| {
        let (received, lost) = (&link["raw_samples"], link["role"] == "wireless");
        received.as_u64() > Some(600) && link["statistics"]["interruptions"] == u64::from(lost)
    });
    let info = wimu(&["info", file]).succeeds();
    for links in [&recorded["links"], &info["links"]] {
        for link in links.as_array().unwrap() {
            let statistics = link.get("statistics").unwrap_or(link);
            let (missing, damaged) = match link["role"].as_str() {
                Some("wireless") => (10..u64::MAX, 1),
                _ => (0..1, 0),
            };
            let lost = u64::from(link["role"] == "wireless");
            assert_eq!(statistics["interruptions"], lost, "{statistics}");
            let count = |value: &Value| value.as_u64().unwrap();
            assert!(missing.contains(&count(&statistics["raw"]["missing"])), "{statistics}");
            assert!(count(&statistics["frames_damaged"]) <= damaged, "{statistics}");
            // Most of the samples arrived after the interruption.
            assert!(count(&statistics["raw"]["received"]) > 400, "{statistics}");
        }
    }
    for link in recorded["links"].as_array().unwrap() {
        // Simulated time is host time.
        let clock = &link["clock"];
        assert!(clock["exchanges"].as_u64().unwrap() > 10, "{clock}");
        let rate = clock["rate_ppm"].as_f64().unwrap();
        let sd = clock["rate_sd_ppm"].as_f64().unwrap();
        assert!(rate.abs() < 5.0 * sd + 100.0, "{clock}");
    }
}

/// Reads every message with `rosbags`, which knows ROS's message types by itself, and prints a line
/// a topic.
const READ_WITH_ROSBAGS: &str = r#"
import sys, math
from pathlib import Path
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

with AnyReader([Path(sys.argv[1])], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
    topics = {}
    for connection, received, raw in reader.messages():
        message = reader.deserialize(raw, connection.msgtype)
        count, first, last, norm = topics.get(connection.topic, (0, None, 0, 0.0))
        if "/imu/" in connection.topic:
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            assert message.header.frame_id == "imu_link"
            assert -2_000_000 < received - stamp < 2_000_000_000, (received, stamp)
            assert stamp > last, (connection.topic, stamp, last)
            first, last = first or stamp, stamp
        if connection.msgtype == "sensor_msgs/msg/Imu":
            assert message.orientation_covariance[0] == -1
            assert message.angular_velocity_covariance[0] == -1
            assert message.linear_acceleration_covariance[0] == 0
            a = message.linear_acceleration
            norm += math.sqrt(a.x * a.x + a.y * a.y + a.z * a.z)
        if connection.msgtype == "sensor_msgs/msg/MagneticField":
            b = message.magnetic_field
            field = math.sqrt(b.x * b.x + b.y * b.y + b.z * b.z)
            # The simulated magnetometer is read once before its first conversion.
            assert count == 0 or 1e-6 < field < 1e-3, field
        if connection.msgtype == "sensor_msgs/msg/Temperature":
            assert -40 < message.temperature < 85
        topics[connection.topic] = (count + 1, first, last, norm)
    for topic, (count, first, last, norm) in sorted(topics.items()):
        print(topic, count, (last - (first or last)) / 1e9, norm / count)
"#;

#[test]
#[ignore = "installs rosbags: cargo xtask release --only heavy"]
fn rosbags_reads_the_decoded_topics_of_both_links() {
    let folder = folder();
    let path = folder.path().join("decoded.mcap");
    let file = path.to_str().unwrap();
    let board = Simulator::start(&["--motion", "rest"]);
    let (wireless, cable) = (board.wireless.as_str(), board.cable.as_str());
    let arguments = ["record", wireless, cable, "-o", file, "--decoded"];
    let report = record_until(Background::start(&arguments), file, |link| {
        link["raw_samples"].as_u64() > Some(500)
    });
    let decoded = &report["decoded"];
    assert_eq!((&decoded["without_unit"], &decoded["late"]), (&0.into(), &0.into()), "{report}");
    // It is still a recording, and decodes again to the same.
    let info = wimu(&["info", file]).succeeds();
    let raw = info["links"][0]["raw_samples"].as_u64().unwrap();
    let again = folder.path().join("again.mcap");
    let arguments = ["convert", file, "-o", again.to_str().unwrap()];
    let exported = wimu(&arguments).succeeds();
    assert_eq!(exported["messages"]["/cable/imu/data_raw"], raw);
    assert_eq!(decoded["messages"]["/cable/imu/data_raw"], raw);

    let Some(python) = python_with_rosbags() else {
        return;
    };
    let read =
        std::process::Command::new(python).args(["-c", READ_WITH_ROSBAGS, file]).output().unwrap();
    let text = String::from_utf8_lossy(&read.stdout).into_owned();
    assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
    for topic in ["data_raw", "data", "mag", "temperature"] {
        for role in ["cable", "wireless"] {
            let topic = format!("/{role}/imu/{topic} ");
            let line = text.lines().find(|line| line.starts_with(&topic));
            let line = line.unwrap_or_else(|| panic!("{topic}: {text}"));
            let numbers: Vec<f64> =
                line[topic.len()..].split(' ').map(|number| number.parse().unwrap()).collect();
            let [count, seconds, norm] = numbers[..] else {
                panic!("{line}");
            };
            assert!(count >= 4.0 && (3.0..8.0).contains(&seconds), "{line}");
            if topic.contains("data") {
                assert!((norm - 9.8).abs() < 1.0, "{line}");
            }
        }
    }
    assert!(text.contains(&format!("/cable/imu/data_raw {raw} ")), "{text}");
}

/// Lengths of 4 GB in records of an MCAP file, where 2 GB of memory are allowed.
#[cfg(target_os = "linux")]
#[test]
fn lengths_in_a_recording_reserve_no_memory() {
    let folder = folder();
    let huge = [0xff; 4];
    let record =
        |code: u8, body: &[u8]| [&[code][..], &(body.len() as u64).to_le_bytes(), body].concat();
    let header = record(1, &[0; 8]);
    let chunk = |records: &[u8]| {
        let (empty, length) = ([0; 4], (records.len() as u64).to_le_bytes());
        record(6, &[&[0; 16][..], &length, &[0; 4], &empty, &length, records].concat())
    };
    let channel = record(4, &[&[1, 0, 1, 0][..], &huge].concat());
    for (name, records) in [
        ("header", record(1, &huge)),
        ("library", record(1, &[&[0; 4][..], &huge].concat())),
        ("schema", [&header[..], &record(3, &[&[1, 0][..], &huge].concat())].concat()),
        ("channel", [&header[..], &channel].concat()),
        ("channel in a chunk", [&header[..], &chunk(&channel)].concat()),
        ("metadata", [&header[..], &record(12, &huge)].concat()),
        ("values", [&header[..], &record(12, &[&[0; 4][..], &huge, &huge].concat())].concat()),
        ("compression", [&header[..], &record(6, &[&[0; 28][..], &huge].concat())].concat()),
        ("record", [&header[..], &[5][..], &u64::MAX.to_le_bytes()].concat()),
    ] {
        let file = folder.path().join(format!("{name}.mcap"));
        fs::write(&file, [b"\x89MCAP0\r\n", &records[..]].concat()).unwrap();
        for command in ["info", "monitor", "allan"] {
            let limited = ["sh", "-c", "ulimit -v 2000000; exec \"$0\" \"$@\""];
            let arguments = [command, file.to_str().unwrap()];
            let ran =
                Background::start_by(&limited, Path::new("/nonexistent"), &arguments).finish();
            assert!((0..=4).contains(&ran.code), "{name}, {command}: {ran:?}");
        }
    }
}
