//! `wimu device key`: who may write, and with what.
#![cfg(target_os = "linux")]

use crate::kit;

use std::fs;
use std::path::Path;

use kit::{Background, Simulator, Transcript, folder};

#[test]
fn a_key_lets_only_its_owner_write_over_the_wireless_link() {
    use std::os::unix::fs::PermissionsExt;

    let folder = folder();
    let store = folder.path().join("board.store");
    let arguments = ["--store", store.to_str().unwrap(), "--motion", "rest"];
    let [owner, other] = ["owner", "other"].map(|name| folder.path().join(name));
    let run_as = |user: &Path, arguments: &[&str]| Background::start_as(user, arguments).finish();
    let board = Simulator::start(&arguments);
    let set = |user: &Path, link: &str, rate: &str| {
        run_as(user, &["device", "settings", "set", link, "--rate", rate])
    };
    let mut texts = Transcript::default();
    let ran = set(&owner, &board.wireless, "50");
    texts.fails("settings set by radio, no key", &ran, 4, "key_needed");
    // A key never travels over the radio.
    let ran = run_as(&owner, &["device", "key", "set", &board.wireless]);
    texts.fails("key set by radio", &ran, 4, "key_needed");
    let ran = run_as(&owner, &["device", "key", "status", &board.cable]);
    texts.text("key status, none", &ran);
    let status = ran.succeeds();
    assert_eq!((&status["set"], &status["ours"]), (&false.into(), &false.into()));

    let ran = run_as(&owner, &["device", "key", "set", &board.cable]);
    texts.text("key set", &ran);
    let status = ran.succeeds();
    assert_eq!((&status["set"], &status["ours"]), (&true.into(), &true.into()));
    let keys = owner.join("wimu/keys");
    let file = keys.join(format!("{}.key", status["device_id"].as_str().unwrap()));
    assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
    assert_eq!(fs::read_dir(&keys).unwrap().count(), 1);
    let key = fs::read_to_string(&file).unwrap();
    for text in [&ran.stdout, &ran.stderr] {
        assert!(!text.contains(key.trim()), "the key is printed");
    }
    for link in [&board.wireless, &board.cable] {
        let ran = set(&owner, link, "200");
        assert_eq!(ran.succeeds()["rate_hz"], 200);
        texts.text("settings set", &ran);
        let ran = set(&other, link, "50");
        texts.fails("settings set, another's key", &ran, 4, "key_needed");
    }
    for action in ["set", "rotate", "forget"] {
        let ran = run_as(&other, &["device", "key", action, &board.cable]);
        texts.fails(format_args!("key {action}, another's key"), &ran, 4, "key_needed");
    }
    let ran = run_as(&other, &["device", "key", "status", &board.wireless]);
    texts.text("key status, another's key", &ran);
    let status = ran.succeeds();
    assert_eq!((&status["set"], &status["ours"]), (&true.into(), &false.into()));

    // What the board sends is authentic, to its owner.
    let session = folder.path().join("session.mcap");
    let session = session.to_str().unwrap();
    let record = ["record", &board.wireless, "-o", session, "--for", "4"];
    run_as(&owner, &record).succeeds();
    let link = &run_as(&owner, &["info", session]).succeeds()["links"][0]["authentication"];
    assert!(link["verified"].as_u64() >= Some(2), "{link}");
    assert_eq!((&link["forged"], &link["replayed"]), (&0.into(), &0.into()));
    let ran = run_as(&other, &["info", session]);
    assert!(ran.stderr.contains("authentication not checked"), "{ran:?}");
    let ran = run_as(&owner, &["monitor", &board.cable, "--for", "4"]);
    assert!(ran.stderr.contains("authentic: "), "{ran:?}");

    // It outlives a restart, and is exchanged for another.
    drop(board);
    let board = Simulator::start(&arguments);
    assert_eq!(set(&owner, &board.wireless, "100").succeeds()["rate_hz"], 100);
    let ran = run_as(&owner, &["device", "key", "rotate", &board.cable]);
    ran.succeeds();
    texts.text("key rotate", &ran);
    assert_ne!(fs::read_to_string(&file).unwrap(), key);
    assert_eq!(set(&owner, &board.wireless, "50").succeeds()["rate_hz"], 50);
    // The old one is worth nothing.
    fs::create_dir_all(other.join("wimu/keys")).unwrap();
    let copy = other.join("wimu/keys").join(file.file_name().unwrap());
    fs::write(&copy, &key).unwrap();
    fs::set_permissions(&copy, fs::Permissions::from_mode(0o600)).unwrap();
    set(&other, &board.wireless, "100").fails(4, "key_needed");
    // A file that holds no key is named.
    fs::write(&copy, &key[1..]).unwrap();
    let ran = set(&other, &board.wireless, "100");
    let failure = texts.fails("damaged key file", &ran, 2, "file_unreadable");
    assert!(failure["place"]["at"].as_str().unwrap().ends_with(".key"));

    let ran = run_as(&owner, &["device", "key", "forget", &board.cable]);
    texts.text("key forget", &ran);
    assert_eq!(ran.succeeds()["set"], false);
    texts.check_live("key");
    assert!(!file.exists());
    set(&other, &board.cable, "100").fails(2, "file_unreadable");
    fs::remove_file(&copy).unwrap();
    set(&other, &board.cable, "100").succeeds();
}

#[test]
fn a_device_that_cannot_read_its_own_key_reports_it_until_the_key_is_erased() {
    let mut texts = Transcript::default();
    let folder = folder();
    let store = folder.path().join("board.store");
    let arguments = ["--store", store.to_str().unwrap(), "--motion", "rest"];
    let user = folder.path().join("user");
    let key = |action: &str, board: &Simulator| {
        Background::start_as(&user, &["device", "key", action, &board.cable]).finish()
    };
    let board = Simulator::start(&arguments);
    key("set", &board).succeeds();
    drop(board);
    let file = fs::read_dir(user.join("wimu/keys")).unwrap().next().unwrap();
    let digits = fs::read_to_string(file.unwrap().path()).unwrap();
    let key_bytes: Vec<u8> =
        (0..32).map(|at| u8::from_str_radix(&digits[2 * at..2 * at + 2], 16).unwrap()).collect();
    let mut image = fs::read(&store).unwrap();
    // A zero is stored otherwise: some four bytes of the key have none.
    let mut pieces = key_bytes.windows(4).filter(|piece| !piece.contains(&0));
    let offset = pieces.find_map(|piece| image.windows(4).position(|bytes| bytes == piece));
    image[offset.expect("the key in the store")] ^= 1;
    fs::write(&store, image).unwrap();

    let board = Simulator::start(&arguments);
    texts.text("status", &key("status", &board));
    for action in ["set", "rotate", "forget"] {
        texts.fails(action, &key(action, &board), 4, "device_refused");
    }
    texts.check("key_that_its_device_cannot_read");
    drop(board);
    let board = Simulator::start(&[&arguments[..], &["--forget-key"]].concat());
    key("set", &board).succeeds();
}
