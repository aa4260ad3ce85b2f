//! Keys that board and host do not share, as a user meets them. An attacker between both is tested with the library's client.
#![cfg(target_os = "linux")]

use crate::kit;

use std::path::Path;

use kit::{Background, Ran, Simulator, Transcript, folder};

fn run_as(user: &Path, arguments: &[&str]) -> Ran {
    Background::start_as(user, arguments).finish()
}

#[test]
fn reads_report_whether_the_board_has_authenticated_them() {
    let folder = folder();
    let [user, other] = ["user", "other"].map(|name| folder.path().join(name));
    let board = Simulator::start(&["--motion", "rest"]);
    run_as(&user, &["key", "set", &board.cable]).succeeds();
    for read in [["params", "get"], ["settings", "get"], ["key", "status"]] {
        let of = |user: &Path| run_as(user, &[&read[..], &[&board.cable]].concat()).succeeds();
        assert_eq!(of(&user)["authenticated"], true);
        assert!(of(&other)["authenticated"].is_null());
    }
}

#[test]
fn a_key_erased_at_the_board_is_reported_at_the_next_write() {
    let mut texts = Transcript::default();
    let folder = folder();
    let user = folder.path().join("user");
    let store = folder.path().join("board.store");
    let arguments = ["--store", store.to_str().expect("text"), "--motion", "rest"];
    let board = Simulator::start(&arguments);
    run_as(&user, &["key", "set", &board.cable]).succeeds();
    drop(board);
    let board = Simulator::start(&[&arguments[..], &["--forget-key"]].concat());
    for link in [&board.cable, &board.wireless] {
        let ran = run_as(&user, &["settings", "set", link, "--rate", "200"]);
        texts.fails("settings set", &ran, 4, "key_needed");
    }
    texts.check("key_erased_at_the_board");
    run_as(&user, &["key", "set", &board.cable]).succeeds();
    for link in [&board.cable, &board.wireless] {
        let set = run_as(&user, &["settings", "set", link, "--rate", "200"]);
        assert_eq!(set.succeeds()["authenticated"], true);
    }
}

#[test]
fn a_simulator_that_was_started_without_its_store_is_the_first_cause_named() {
    let folder = folder();
    let user = folder.path().join("user");
    run_as(&user, &["key", "set", &Simulator::start(&["--motion", "rest"]).cable]).succeeds();
    let again = Simulator::start(&["--motion", "rest"]);
    let ran = run_as(&user, &["settings", "set", &again.cable, "--rate", "200"]);
    // The causes in their order: `--store`, an erased key, a peer in between.
    let mut texts = Transcript::default();
    texts.fails("settings set", &ran, 4, "key_needed");
    let ran = run_as(&user, &["params", "get", &again.cable]);
    assert_eq!(ran.succeeds()["authenticated"], false);
    texts.text("params get", &ran);
    texts.check("key_of_a_simulator_without_store");
    // The remedy works.
    run_as(&user, &["key", "set", &again.cable]).succeeds();
    run_as(&user, &["settings", "set", &again.cable, "--rate", "200"]).succeeds();
}
