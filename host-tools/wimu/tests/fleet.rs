//! Many boards through a real broker. Skipped where Mosquitto is missing.

use crate::kit;

use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use kit::fleet::{Boards, Foreign, Gateway, Mosquitto, Tape, client, files, name};
use kit::{Background, Simulator, folder, wait_until, wimu};
use serde_json::json;
use wimu_host::calibration::Calibration;
use wimu_host::fleet::Batch;
use wimu_host::fleet::mqtt::{Heard, Mqtt, MqttConfig};
use wimu_host::fleet::state::GatewayState;
use wimu_host::mcap_file::{Recorded, RecordingReader};
use wimu_link::auth::{DeviceKey, Session};
use wimu_link::message::Settings;
use wimu_link::{Command, LinkRole, Requester};
use wimu_model::{ParameterSet, Sensitivity};

const METRICS: &str =
    "metrics = \"127.0.0.1:0\"\nrecordings = \"recordings\"\nspool = \"spool\"\nbatch_ms = 500\n";

/// All bytes that the files hold, in order.
fn bytes(files: &[std::path::PathBuf]) -> Vec<u8> {
    let mut all = Vec::new();
    for file in files {
        let mut reader = RecordingReader::open(file).expect("a recording");
        while let Some(entry) = reader.next_entry().expect("readable") {
            if let Recorded::Received(received) = entry {
                all.extend(received.bytes);
            }
        }
    }
    all
}

fn contains(all: &[u8], part: &[u8]) -> bool {
    !part.is_empty() && all.windows(part.len()).any(|window| window == part)
}

#[test]
#[ignore = "needs Mosquitto: cargo xtask test --only broker"]
fn a_recording_through_the_broker_is_bit_exact() {
    let broker = Mosquitto::start();
    let tape = Tape::record(60.0);
    let boards = Boards::start(&tape, 20, None);
    let folder = folder();
    let gateway = Gateway::start(folder.path(), &boards.config(&broker.url(), METRICS));
    wait_until("all boards", || gateway.metric("wimu_board_alive") == 20.0);
    let link = format!("mqtt://127.0.0.1:{}/hall/{}", broker.port, name(3));
    let remote = folder.path().join("remote.mcap");
    let record = Background::start(&["record", &link, "-o", remote.to_str().unwrap()]);
    wait_until("samples through the broker", || {
        gateway.metric("wimu_board_samples") > 20.0 * 600.0
            && fs::metadata(&remote).is_ok_and(|file| file.len() > 3000)
    });
    let status =
        wimu(&["fleet", "status", &format!("mqtt://127.0.0.1:{}/hall", broker.port)]).succeeds();
    let states = status["boards"].as_object().unwrap();
    assert!(states.len() == 20 && states.values().all(|state| state["alive"] == true), "{status}");
    assert_eq!(states[&name(3)]["device_id"], "0000f1ee70000003");
    record.signal("-INT").succeeds();
    let sums = gateway.stop();
    assert_eq!(
        (&sums["missing"], &sums["dropped"], &sums["unrecorded_bytes"]),
        (&0.into(), &0.into(), &0.into()),
        "{sums}"
    );
    let recordings = folder.path().join("recordings");
    for index in 0..20 {
        let found = tape.verify(&files(&recordings, &name(index)));
        assert!(
            found.received > 500 && found.missing == 0 && found.frames_damaged == 0,
            "{index}: {found:?}"
        );
    }
    let (own, through) =
        (bytes(&files(&recordings, &name(3))), bytes(std::slice::from_ref(&remote)));
    assert!(
        contains(&own, &through),
        "{} bytes of the gateway, {} through the broker",
        own.len(),
        through.len()
    );
    let found = tape.verify(&[remote]);
    assert!(found.received > 100 && found.missing == 0, "{found:?}");
    let status =
        wimu(&["fleet", "status", &format!("mqtt://127.0.0.1:{}/hall", broker.port)]).succeeds();
    assert!(
        status["boards"].as_object().unwrap().values().all(|state| state["alive"] == false),
        "{status}"
    );
}

#[test]
#[ignore = "needs Mosquitto: cargo xtask release --only heavy"]
fn commands_pass_signed_and_what_a_malicious_client_sends_does_not() {
    let broker = Mosquitto::start();
    let folder = folder();
    let store = folder.path().join("board.store");
    let board = Simulator::start(&["--store", store.to_str().unwrap(), "--motion", "rest"]);
    let owner = folder.path().join("owner");
    let run = |arguments: &[&str]| Background::start_as(&owner, arguments).finish();
    run(&["device", "key", "set", &board.cable]).succeeds();
    let config = format!(
        "fleet = \"hall\"\nbroker = \"{}\"\n{METRICS}[boards]\nb = \"{}\"\n",
        broker.url(),
        board.wireless
    );
    let gateway = Gateway::start(folder.path(), &config);
    wait_until("the board", || gateway.metric("wimu_board_alive") == 1.0);

    // The malicious client hears all commands, as the broker does.
    let overheard = Arc::new(Mutex::new(Vec::new()));
    let ear = overheard.clone();
    let down = "wimu/hall/b/down".to_owned();
    let filters = vec![down.clone()];
    let malicious =
        Mqtt::start(MqttConfig::new(&broker.url().parse().unwrap(), filters), move |heard| {
            if let Heard::Message { payload, .. } = heard {
                ear.lock().unwrap().push(payload.to_vec());
            }
        });
    let malicious = malicious.unwrap();
    wait_until("the malicious client", || malicious.is_connected());

    let link = format!("mqtt://127.0.0.1:{}/hall/b", broker.port);
    let rate = || run(&["device", "settings", "get", &link]).succeeds()["rate_hz"].clone();
    assert_eq!(
        run(&["device", "settings", "set", &link, "--rate", "50"]).succeeds()["rate_hz"],
        50
    );
    let written = overheard.lock().unwrap().clone();
    assert_eq!(
        run(&["device", "settings", "set", &link, "--rate", "200"]).succeeds()["rate_hz"],
        200
    );
    for message in written {
        malicious.publish(down.clone(), message);
    }
    let reset = Command::FactoryReset;
    malicious.publish(down.clone(), Requester::new(1).start(reset, Duration::ZERO).to_vec());
    let mut forged = Requester::new(1);
    let key = DeviceKey::new([1; 32]);
    forged.sign(
        Session {
            key,
            role: LinkRole::Wireless,
            device_id: 0x5157_0001,
            number: 1,
            nonce: [0; 16],
        },
        1,
    );
    malicious.publish(down.clone(), forged.start(reset, Duration::ZERO).to_vec());
    malicious.publish(
        down,
        forged.start(Command::SetSettings(Settings::default()), Duration::ZERO).to_vec(),
    );
    wait_until("the unsigned command is refused", || {
        gateway.metric("wimu_board_commands_refused") >= 1.0
    });
    assert_eq!(rate(), 200);

    // Nobody changes a board or a key through a broker without a key.
    for (arguments, code) in [
        (&["device", "settings", "set", &link, "--rate", "50"][..], "not_through_broker"),
        (&["device", "key", "set", &link], "key_needed"),
    ] {
        wimu(arguments).fails(4, code);
    }
    assert_eq!(rate(), 200);

    // A calibration for the fleet, pushed once and then found.
    let set = ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16_384.0).unwrap());
    let calibrations = folder.path().join("calibrations");
    fs::create_dir(&calibrations).unwrap();
    Calibration::held(&set).write(&calibrations.join("b.json")).unwrap();
    let fleet = format!("mqtt://127.0.0.1:{}/hall", broker.port);
    let push = ["fleet", "push", &fleet, calibrations.to_str().unwrap()];
    wimu(&push).fails(4, "key_needed");
    for written in [1, 0] {
        let done = run(&push).succeeds();
        let figures = ["boards", "done", "written"].map(|figure| done[figure].clone());
        assert_eq!(figures, [1, 1, written].map(|count| json!(count)));
    }
    let second = calibrations.join("0000000051570001.json");
    fs::copy(calibrations.join("b.json"), &second).unwrap();
    run(&push).fails(2, "usage");
    fs::remove_file(second).unwrap();

    // The tags that arrive while the client connects are not of another key.
    let monitored = run(&["monitor", &link, "--for", "4"]);
    assert!(monitored.stderr.contains("authentic: "), "{monitored:?}");
    assert!(!monitored.stderr.contains("another key"), "{monitored:?}");

    // A file that is removed is reported, and a new one begun, which identifies the board.
    let recordings = folder.path().join("recordings");
    fs::remove_dir_all(&recordings).unwrap();
    let removed = Instant::now();
    wait_until("a new recording with the board", || {
        recordings.join("b").exists()
            && files(&recordings, "b").first().is_some_and(|file| {
                let info = wimu(&["info", file.to_str().unwrap()]);
                info.code == 0 && info.succeeds()["links"][0]["device"].is_object()
            })
    });
    let took = removed.elapsed();
    assert!(took < Duration::from_secs(55), "only when asked each minute: {took:?}");
    let file = folder.path().join("fleet.toml");
    wimu(&["fleet", "gateway", "--config", file.to_str().unwrap()]).fails(1, "link_busy");
    drop(board);
    wait_until("the board is away", || gateway.metric("wimu_board_alive") == 0.0);
    run(&push).fails(1, "link_absent");
    gateway.stop();
}

/// A calibration of bias and no device, and the same that names one.
fn calibration(file: &Path, device_id: Option<u64>) {
    let set = ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16_384.0).unwrap());
    Calibration::held(&set).of_device(device_id).write(file).unwrap();
}

#[test]
#[ignore = "needs Mosquitto: cargo xtask release --only heavy"]
fn a_broker_that_exchanges_two_boards_gets_no_calibration_pushed() {
    let broker = Mosquitto::start();
    let folder = folder();
    let owner = folder.path().join("owner");
    let run = |arguments: &[&str]| Background::start_as(&owner, arguments).finish();
    let boards = ["1", "2"].map(|seed| Simulator::start(&["--motion", "rest", "--seed", seed]));
    let links = boards.each_ref().map(|board| {
        run(&["device", "key", "set", &board.cable]).succeeds();
        board.wireless.clone()
    });
    let gateway = |[a, b]: [&str; 2]| {
        let config = format!(
            "fleet = \"hall\"\nbroker = \"{}\"\n{METRICS}[boards]\na = \"{a}\"\nb = \"{b}\"\n",
            broker.url()
        );
        let gateway = Gateway::start(folder.path(), &config);
        wait_until("both boards", || gateway.metric("wimu_board_alive") == 2.0);
        gateway
    };
    let fleet = format!("mqtt://127.0.0.1:{}/hall", broker.port);
    let link = format!("{fleet}/a");
    let calibrations = folder.path().join("calibrations");
    fs::create_dir(&calibrations).unwrap();
    let file = calibrations.join("a.json");
    let push_fleet = ["fleet", "push", &fleet, calibrations.to_str().unwrap()];
    let push_one = ["device", "params", "push", &link, file.to_str().unwrap()];

    let first = gateway([&links[0], &links[1]]);
    // At the first use only the file can tell.
    calibration(&file, Some(0x5157_0002));
    for push in [&push_fleet[..], &push_one] {
        let error = run(push).fails(2, "other_device");
        let message = error["text"].as_str().unwrap();
        assert!(message.contains("0000000051570001") && message.contains("0000000051570002"));
        run(&[push, &["--force"]].concat()).succeeds();
    }
    calibration(&file, Some(0x5157_0001));
    run(&push_one).succeeds();
    run(&push_fleet).succeeds();
    first.stop();

    let exchanged = gateway([&links[1], &links[0]]);
    for device_id in [None, Some(0x5157_0001), Some(0x5157_0002)] {
        calibration(&file, device_id);
        for push in [&push_fleet[..], &push_one] {
            for force in [&[][..], &["--force"]] {
                let error = run(&[push, force].concat()).fails(4, "device_changed");
                let message = error["text"].as_str().unwrap();
                assert!(
                    message.contains("0000000051570001") && message.contains("0000000051570002")
                );
            }
        }
    }
    let read = run(&["device", "params", "get", &link]);
    assert_eq!(read.succeeds()["authenticated"], false);
    assert!(read.stderr.contains("this board was device 0000000051570001"), "{read:?}");
    // An exchange on purpose: the line is removed.
    let known = owner.join("wimu/keys/known_boards");
    fs::remove_file(known).unwrap();
    calibration(&file, Some(0x5157_0002));
    run(&push_one).succeeds();
    exchanged.stop();
}

#[test]
#[ignore = "needs Mosquitto: cargo xtask release --only heavy"]
fn forged_states_and_foreign_files_do_no_harm_and_slow_clients_do_not_block_the_metrics() {
    let broker = Mosquitto::start();
    let folder = folder();
    let spool = folder.path().join("spool/gateway");
    fs::create_dir_all(&spool).unwrap();
    let target = folder.path().join("target");
    for foreign in ["+5.spool", "ffffffffffffffff.spool", "5.spool"] {
        fs::write(spool.join(foreign), "foreign").unwrap();
    }
    let board = Simulator::start(&["--motion", "rest"]);
    let config = format!(
        "fleet = \"hall\"\nbroker = \"{}\"\n{METRICS}[boards]\nb = \"{}\"\n",
        broker.url(),
        board.wireless
    );
    let gateway = Gateway::start(folder.path(), &config);
    wait_until("the board", || gateway.metric("wimu_board_alive") == 1.0);
    let slow: Vec<_> = (0..64).map(|_| gateway.slow_client()).collect();
    let began = Instant::now();
    for _ in 0..25 {
        gateway.metric("wimu_board_alive");
    }
    assert!(began.elapsed() < Duration::from_secs(5), "{:?}", began.elapsed());
    drop(slow);

    let vandal = Mqtt::start(MqttConfig::new(&broker.url().parse().unwrap(), Vec::new()), |_| {});
    let vandal = vandal.unwrap();
    wait_until("the vandal", || vandal.is_connected());
    for name in ["x", "y"] {
        let state = json!({
            "schema": "wimu.fleet-board/1",
            "samples": u64::MAX, "missing": u64::MAX, "unrecorded_bytes": u64::MAX,
            "gateway": "\u{1b}[2J\n\u{202e}\u{9b}", "lost": "\u{1b}[2J\n\u{202e}\u{9b}",
        });
        vandal.retain(format!("wimu/hall/{name}/state"), state.to_string().into_bytes());
    }
    wait_until("the forged states", || vandal.figures().waiting == 0);
    let status = wimu(&["fleet", "status", &format!("mqtt://127.0.0.1:{}/hall", broker.port)]);
    status.succeeds();
    assert!(status.stderr.contains(&format!("{0} of {0} samples", u64::MAX)), "{status:?}");
    assert!(!status.stderr.contains(['\u{1b}', '\u{9b}', '\u{202e}']), "{status:?}");
    gateway.stop();
    assert_eq!(fs::read(spool.join("+5.spool")).unwrap(), b"foreign");

    // The lock is a link to another file.
    fs::write(&target, "mine").unwrap();
    fs::remove_file(spool.join("lock")).unwrap();
    std::os::unix::fs::symlink(&target, spool.join("lock")).unwrap();
    let toml = folder.path().join("fleet.toml");
    wimu(&["fleet", "gateway", "--config", toml.to_str().unwrap(), "--for", "1"])
        .fails(2, "file_exists");
    assert_eq!(fs::read(&target).unwrap(), b"mine");
}

#[test]
#[ignore = "needs Mosquitto: cargo xtask release --only heavy"]
fn a_killed_broker_and_a_killed_gateway_leave_only_counted_gaps() {
    let mut broker = Mosquitto::start();
    let tape = Tape::record(240.0);
    let boards = Boards::start(&tape, 3, None);
    let folder = folder();
    let config = boards.config(&broker.url(), METRICS);
    let gateway = Gateway::start(folder.path(), &config);
    wait_until("all boards", || gateway.metric("wimu_board_alive") == 3.0);
    let link = format!("mqtt://127.0.0.1:{}/hall/{}", broker.port, name(0));
    let remote = folder.path().join("remote.mcap");
    let record = Background::start(&["record", &link, "-o", remote.to_str().unwrap()]);
    let samples = |gateway: &Gateway| gateway.metric("wimu_board_samples");
    wait_until("a recording", || fs::metadata(&remote).is_ok_and(|file| file.len() > 3000));
    broker.kill();
    wait_until("batches wait", || gateway.metric("wimu_gateway_waiting") > 6.0);
    broker.restart();
    wait_until("the broker is back", || {
        gateway.metric("wimu_gateway_broker") == 1.0 && gateway.metric("wimu_gateway_waiting") < 6.0
    });
    assert_eq!(gateway.metric("wimu_gateway_dropped"), 0.0);
    gateway.kill();
    let gateway = Gateway::start(folder.path(), &config);
    let length = fs::metadata(&remote).unwrap().len();
    wait_until("the recording goes on", || {
        samples(&gateway) > 1000.0
            && fs::metadata(&remote).is_ok_and(|file| file.len() > length + 3000)
    });
    record.signal("-INT").succeeds();
    gateway.stop();
    let recordings = folder.path().join("recordings");
    for index in 0..3 {
        let found = tape.verify(&files(&recordings, &name(index)));
        // Of a killed gateway at most the last second of a file is missing, and the time until the next one.
        assert!(found.files == 2 && found.received > 500, "{found:?}");
    }
    let found = tape.verify(&[remote]);
    assert!(found.received > 500, "{found:?}");
}

#[test]
#[ignore = "needs Mosquitto: cargo xtask release --only heavy"]
fn garbage_large_messages_and_other_gateways_do_no_harm() {
    let broker = Mosquitto::start();
    let tape = Tape::record(240.0);
    let boards = Boards::start(&tape, 2, None);
    let folder = folder();
    let address = broker.url().parse().unwrap();
    let vandal = Mqtt::start(MqttConfig::new(&address, Vec::new()), |_| {}).unwrap();
    wait_until("the vandal", || vandal.is_connected());
    for topic in [
        "wimu/hall/board-0000/up",
        "wimu/hall/board-0000/down",
        "wimu/hall/board-0001/state",
        "wimu/hall/_gateway/gateway",
    ] {
        vandal.retain(topic.to_owned(), vec![0xa5; 1 << 20]);
    }
    wait_until("the garbage", || vandal.figures().waiting == 0);
    let gateway = Gateway::start(folder.path(), &boards.config(&broker.url(), METRICS));
    wait_until("all boards", || gateway.metric("wimu_board_alive") == 2.0);
    let link = format!("mqtt://127.0.0.1:{}/hall/{}", broker.port, name(0));
    let mut reader = client(&link).expect("the board through the broker");
    assert_eq!(reader.hello().device_id, 0xf1ee_7000_0000);

    // Batches of another, later and earlier session, with wrong numbers, while the reader listens.
    for session in [0, u64::MAX] {
        let mut forged = Batch::new(session, 7);
        forged.push(5, b"\x05abcd\0");
        vandal.publish("wimu/hall/board-0000/up".to_owned(), forged.encode(9));
    }
    for _ in 0..100 {
        vandal.publish("wimu/hall/board-0000/down".to_owned(), vec![7; 5000]);
    }
    wait_until("the commands are refused", || {
        gateway.metric("wimu_board_commands_refused") + gateway.metric("wimu_gateway_crowded")
            >= 100.0
    });
    let other = folder.path().join("other");
    fs::create_dir(&other).unwrap();
    let second = Gateway::start(
        &other,
        &boards.config(&broker.url(), "gateway = \"other\"\nmetrics = \"127.0.0.1:0\""),
    );
    assert_eq!(second.metric("wimu_board_alive"), 0.0);
    // It has reported the boards as away, which the gateway that serves them corrects at once.
    let fleet = format!("mqtt://127.0.0.1:{}/hall", broker.port);
    let states = || wimu(&["fleet", "status", &fleet]).succeeds()["boards"].clone();
    let began = Instant::now();
    wait_until("the states are corrected", || {
        let states = states();
        let mut states = states.as_object().unwrap().values();
        states.all(|state| state["alive"] == true && state["gateway"] == "gateway")
    });
    assert!(began.elapsed() < Duration::from_secs(25), "no later report");
    // Another gateway of the same name ends: the living one is announced again.
    let announced = Arc::new(Mutex::new(None));
    let hear = {
        let announced = announced.clone();
        move |heard: Heard| {
            if let Heard::Message { payload, .. } = heard {
                *announced.lock().unwrap() = GatewayState::read(payload);
            }
        }
    };
    let topic = "wimu/hall/_gateway/gateway".to_owned();
    let _listener = Mqtt::start(MqttConfig::new(&address, vec![topic]), hear).unwrap();
    let now = || announced.lock().unwrap().clone();
    wait_until("the first gateway", || now().is_some());
    let first = now().unwrap().session;
    let home = folder.path().join("namesake");
    fs::create_dir(&home).unwrap();
    let namesake = Gateway::start(&home, &boards.config(&broker.url(), METRICS));
    wait_until("the namesake", || now().unwrap().session != first);
    namesake.stop();
    wait_until("the first gateway again", || {
        now().is_some_and(|state| state.session == first && state.alive)
    });
    // A state that is removed is published again.
    for topic in ["wimu/hall/_gateway/gateway", "wimu/hall/board-0000/state"] {
        vandal.retain(topic.to_owned(), Vec::new());
    }
    wait_until("the states are published again", || {
        vandal.figures().waiting == 0
            && now().is_some_and(|state| state.session == first)
            && states().as_object().is_some_and(|states| {
                states.len() == 2 && states.values().all(|state| state["alive"] == true)
            })
    });
    // A retained message of any length ends no connection.
    for topic in ["wimu/hall/board-0001/down", "wimu/hall/board-0000/up", "wimu/hall/zz/state"] {
        Foreign::connect(broker.port, "foreign").publish(topic, &vec![0; 5 << 20]);
    }
    assert!(client(&link).is_ok() && states()["board-0001"]["alive"] == true);
    assert_eq!(gateway.metric("wimu_gateway_broker_connections"), 1.0);
    let samples = gateway.metric("wimu_board_samples");
    wait_until("the boards go on", || gateway.metric("wimu_board_samples") > samples + 400.0);
    second.stop();
    assert!(reader.next_event(Duration::from_secs(1)).is_ok());
    drop(reader);
    gateway.stop();
    for index in 0..2 {
        let found = tape.verify(&files(&folder.path().join("recordings"), &name(index)));
        assert!(found.received > 400 && found.missing == 0, "{found:?}");
    }
}

#[test]
#[ignore = "needs Mosquitto: cargo xtask release --only heavy"]
fn a_client_that_takes_the_gateways_id_leaves_no_gap() {
    let broker = Mosquitto::start();
    let tape = Tape::record(120.0);
    let boards = Boards::start(&tape, 2, None);
    let folder = folder();
    let gateway = Gateway::start(folder.path(), &boards.config(&broker.url(), METRICS));
    wait_until("all boards", || gateway.metric("wimu_board_alive") == 2.0);
    let link = format!("mqtt://127.0.0.1:{}/hall/{}", broker.port, name(0));
    let id = broker.clients().first().expect("the gateway").clone();
    let remote = folder.path().join("remote.mcap");
    let record = Background::start(&["record", &link, "-o", remote.to_str().unwrap()]);
    let recorded = |bytes: u64| fs::metadata(&remote).is_ok_and(|file| file.len() > bytes);
    wait_until("a recording", || recorded(3000));
    // It takes the id back whenever it loses it, as a second gateway with this id would.
    let mut thief = Foreign::connect(broker.port, &id);
    while thief.is_ended_within(Duration::from_secs(6)) {
        thief = Foreign::connect(broker.port, &id);
    }
    assert_ne!(broker.clients().last(), Some(&id));
    let length = fs::metadata(&remote).unwrap().len();
    wait_until("the recording goes on", || recorded(length + 3000));
    assert_eq!(gateway.metric("wimu_gateway_dropped"), 0.0);
    record.signal("-INT").succeeds();
    gateway.stop();
    let found = tape.verify(&[remote]);
    assert!(found.received > 500 && found.missing == 0, "{found:?}");
}

#[test]
#[ignore = "needs Mosquitto: cargo xtask release --only heavy"]
fn a_host_clock_that_jumps_loses_no_sample() {
    let library = Path::new("/usr/lib/x86_64-linux-gnu/faketime/libfaketime.so.1");
    assert!(library.exists(), "faketime is missing: cargo xtask setup --release");
    let broker = Mosquitto::start();
    let tape = Tape::record(240.0);
    let boards = Boards::start(&tape, 2, None);
    let folder = folder();
    let clock = folder.path().join("clock");
    let set = |offset: &str| fs::write(&clock, offset).unwrap();
    set("+0");
    let variables = format!(
        "export FAKETIME_TIMESTAMP_FILE={} FAKETIME_NO_CACHE=1 FAKETIME_DONT_FAKE_MONOTONIC=1 LD_PRELOAD={};",
        clock.display(),
        library.display()
    );
    let config = boards.config(&broker.url(), METRICS);
    let start = || Gateway::start_in(folder.path(), &config, &variables);
    let gateway = start();
    wait_until("all boards", || gateway.metric("wimu_board_alive") == 2.0);
    let link = format!("mqtt://127.0.0.1:{}/hall/{}", broker.port, name(0));
    let remote = folder.path().join("remote.mcap");
    let record = Background::start(&["record", &link, "-o", remote.to_str().unwrap()]);
    let goes_on = || {
        let length = fs::metadata(&remote).map_or(0, |file| file.len());
        wait_until("the recording goes on", || {
            fs::metadata(&remote).is_ok_and(|file| file.len() > length + 3000)
        });
    };
    goes_on();
    for jump in ["-3600", "+7200"] {
        set(jump);
        goes_on();
    }
    // The next session has an earlier number and an earlier file.
    set("-3600");
    gateway.stop();
    let gateway = start();
    goes_on();
    record.signal("-INT").succeeds();
    gateway.stop();
    let found = files(&folder.path().join("recordings"), &name(0));
    let begins_ms = |path: &Path| path.file_stem()?.to_str()?.parse::<u64>().ok();
    let times: Vec<u64> = found.iter().filter_map(|path| begins_ms(path)).collect();
    assert!(times.len() == 2 && times[1] - times[0] > 3_000_000, "{times:?}");
    for file in found {
        let found = tape.verify(&[file]);
        assert!(found.received > 200 && found.missing == 0, "{found:?}");
    }
    let found = tape.verify(&[remote]);
    assert!(found.received > 800, "{found:?}");
}

#[test]
fn a_wrong_configuration_or_address_is_named() {
    let folder = folder();
    let file = folder.path().join("fleet.toml");
    fs::write(&file, "fleet = \"hall\"\nbroker = \"mqtt://127.0.0.1:1\"\n[boards]\n\"a/#\" = \"tcp://127.0.0.1:1\"\n").unwrap();
    let failure =
        wimu(&["fleet", "gateway", "--config", file.to_str().unwrap()]).fails(2, "bad_config");
    assert!(failure["place"]["at"].as_str().unwrap().ends_with("line 4"), "{failure}");
    wimu(&["fleet", "gateway", "--config", "/nonexistent.toml"]).fails(2, "file_unreadable");
    wimu(&["monitor", "mqtt://127.0.0.1:1/hall"]).fails(2, "bad_link");
    wimu(&["fleet", "status", "mqtt://127.0.0.1:1/+"]).fails(2, "bad_link");
    wimu(&["fleet", "status", "mqtt://127.0.0.1:1/hall"]).fails(1, "link_refused");
}
