//! What a fleet writes and reads: batches, configurations and names.

use std::path::Path;

use wimu_host::Code;
use wimu_host::fleet::Batch;
use wimu_host::fleet::batch::{BatchError, MAX_BATCH};
use wimu_host::fleet::config::GatewayConfig;
use wimu_host::fleet::rollout::{Plan, Target};
use wimu_host::fleet::topics::{Broker, MAX_NAME, Name};
use wimu_model::{ParameterSet, Sensitivity};

#[test]
fn the_golden_batch_is_as_documented() {
    let mut batch = Batch::new(0x0102_0304_0506_0708, 0x0a0b_0c0d);
    batch.push(1_000_000_123, &[0x02, 0x55, 0x00]);
    batch.push(1_000_300_999, &[0x01, 0x00]);
    let bytes = batch.encode(1_001_000_123);
    let golden = "01 0807060504030201 0d0c0b0a 7bca9a3b00000000 e807 00 03 025500 ac02 02 0100";
    let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(hex, golden.replace(' ', ""));
    assert_eq!(Batch::decode(&bytes), Ok(batch));
}

#[test]
fn a_cut_batch_and_any_other_bytes_are_refused_or_read_without_a_panic() {
    let mut batch = Batch::new(1, 2);
    batch.push(5, b"abc\0");
    let bytes = batch.encode(9);
    for end in 0..bytes.len() {
        let cut = Batch::decode(&bytes[..end]);
        assert!(cut.is_err() || cut.is_ok_and(|cut| cut.pieces.is_empty()), "{end}");
    }
    assert_eq!(Batch::decode(&[9; 40]), Err(BatchError::Version(9)));
    assert_eq!(Batch::decode(&vec![1; MAX_BATCH + 1]), Err(BatchError::TooLong(MAX_BATCH + 1)));
    let mut state = 1u32;
    for length in 0..2000 {
        let random = (0..length % 97).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        });
        let _ = Batch::decode(&std::iter::once(1).chain(random).collect::<Vec<_>>());
    }
}

const HEAD: &str = "fleet = \"hall\"\nbroker = \"mqtt://127.0.0.1\"\n";

#[test]
fn every_error_names_its_line() {
    let boards = "[boards]\na = \"tcp://127.0.0.1:7100\"\n";
    for (text, line, part) in [
        ("fleet = \"hall\"\n[boards]\n", 1, "broker"),
        (&format!("{HEAD}color = 1\n{boards}"), 3, "color"),
        (&format!("{HEAD}batch_ms = 5\n{boards}"), 3, "10 to 60000"),
        (&format!("{HEAD}metrics = \"here\"\n{boards}"), 3, "here"),
        (&format!("{HEAD}{boards}\"a/+\" = \"tcp://127.0.0.1:7101\"\n"), 5, "a/+"),
        (&format!("{HEAD}{boards}b = \"tcp://127.0.0.1:7100\"\n"), 5, "another board"),
        (&format!("{HEAD}{boards}A = \"tcp://127.0.0.1:7101\"\n"), 4, "case"),
        (&format!("{HEAD}{boards}b = \"auto\"\n"), 5, "port"),
        (&format!("{HEAD}{boards}b = \"mqtt://h/f/b\"\n"), 5, "itself"),
        (&format!("{HEAD}{boards}a = \"tcp://127.0.0.1:7102\"\n"), 5, "duplicate"),
        ("fleet = \"#\"\nbroker = \"mqtt://h\"\n[boards]\na = \"COM1\"\n", 1, "#"),
        (&format!("{HEAD}[boards]\n"), 1, "no board"),
        ("fleet = \n", 1, ""),
    ] {
        let error = GatewayConfig::parse(text, Path::new("dir/fleet.toml")).unwrap_err();
        assert_eq!(error.code, Code::BadConfig);
        assert!(error.text.contains(part), "{text}: {error}");
        assert_eq!(
            error.place.at.as_deref(),
            Some(&*format!("dir/fleet.toml, line {line}")),
            "{error}"
        );
    }
}

#[test]
fn a_name_is_one_level_of_a_topic_and_a_file_name() {
    for good in ["a", "board-0001", "Hall.2", "7_b"] {
        assert_eq!(good.parse::<Name>().unwrap().as_str(), good);
    }
    let long = "a".repeat(MAX_NAME + 1);
    for bad in ["", "+", "#", "a/b", "a b", "_gateway", "$SYS", "..", "a.", "é", "a\0", &long] {
        assert!(bad.parse::<Name>().is_err(), "{bad:?}");
    }
}

#[test]
fn a_broker_parses_and_prints_back() {
    for (text, printed) in [
        ("mqtt://host", "mqtt://host:1883"),
        ("mqtts://me@host", "mqtts://me@host:8883"),
        ("mqtt://[::1]:7", "mqtt://[::1]:7"),
        ("mqtt://[::1]", "mqtt://[::1]:1883"),
    ] {
        assert_eq!(text.parse::<Broker>().unwrap().to_string(), printed);
    }
    for bad in [
        "http://host",
        "mqtt://",
        "mqtt://host:0",
        "mqtt://host:x",
        "mqtt://me:secret@host",
        "mqtt://host/x",
    ] {
        assert!(bad.parse::<Broker>().is_err(), "{bad}");
    }
}

#[test]
fn the_stages_are_one_board_a_tenth_and_all() {
    let sensitivity = Sensitivity::from_lsb_per_g(16_384.0).unwrap();
    let target = Target {
        board: "a".parse().unwrap(),
        device_id: None,
        set: ParameterSet::uncalibrated(2, sensitivity),
        file: "a.json".into(),
    };
    for (boards, stages) in
        [(0, [0, 0, 0]), (5, [1, 1, 5]), (200, [1, 20, 200]), (1001, [1, 101, 1001])]
    {
        let plan = Plan { targets: vec![target.clone(); boards], ..Plan::default() };
        assert_eq!(plan.stages(), stages);
    }
}
