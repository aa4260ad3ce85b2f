//! `wimu flash`, as far as it goes without a board.

use crate::kit;

use std::path::Path;

use kit::wimu;

/// A UF2 file of one block: vectors at `address` whose stack begins at `stack`.
fn image(folder: &Path, address: u32, stack: u32) -> String {
    let mut block = vec![0; 512];
    let words = [
        (0, 0x0a32_4655),
        (4, 0x9e5d_5157),
        (12, address),
        (16, 256),
        (24, 1),
        (32, stack),
        (508, 0x0ab1_6f30),
    ];
    for (at, word) in words {
        block[at..at + 4].copy_from_slice(&u32::to_le_bytes(word));
    }
    let file = folder.join(format!("{address:x}-{stack:x}.uf2"));
    std::fs::write(&file, block).expect("writable");
    file.display().to_string()
}

#[test]
fn what_cannot_be_written_is_said_before_a_board_is_looked_for() {
    let folder = tempfile::tempdir().expect("a folder");
    let missing = folder.path().join("none.hex").display().to_string();
    let letter = folder.path().join("letter.hex").display().to_string();
    std::fs::write(&letter, "Dear board").expect("writable");
    let pico = image(folder.path(), 0x1000_0100, 0x2004_0000);
    let qemu = image(folder.path(), 0, 0x2040_0000);

    wimu(&["flash"]).fails(2, "usage");
    wimu(&["flash", "microbit-v1"]).fails(2, "usage");
    let failure = wimu(&["flash", "microbit-v2", "--image", &missing]).fails(2, "file_unreadable");
    assert!(
        failure["remedy"]
            .as_str()
            .unwrap()
            .contains("cargo xtask firmware")
    );
    wimu(&["flash", "microbit-v2", "--image", &letter]).fails(2, "unknown_format");
    for (board, other) in [
        ("microbit-v2", &pico),
        ("microbit-v2", &qemu),
        ("pico-adxl345", &qemu),
    ] {
        let failure = wimu(&["flash", board, "--image", other]).fails(2, "wrong_image");
        assert_eq!(failure["where"], other.as_str());
    }
}

#[test]
fn without_a_probe_it_says_how_to_go_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let pico = image(folder.path(), 0x1000_0100, 0x2004_0000);
    let flash = wimu(&["flash", "pico-adxl345", "--image", &pico]);
    let failure = if cfg!(feature = "flash") {
        flash.fails(1, "probe_absent")
    } else {
        flash.fails(2, "feature_missing")
    };
    let remedy = failure["remedy"].as_str().unwrap();
    assert!(
        remedy.contains("RPI-RP2") && remedy.contains(&pico),
        "{remedy}"
    );
    if cfg!(feature = "flash") {
        let list = wimu(&["flash", "--list"]).succeeds();
        assert_eq!(list["probes"], serde_json::json!([]));
        wimu(&["flash", "pico-adxl345", "--image", &pico, "--probe", "pico"]).fails(2, "usage");
    } else {
        let failure = wimu(&["flash", "--list"]).fails(2, "feature_missing");
        let remedy = failure["remedy"].as_str().unwrap();
        assert!(remedy.contains("--features flash"), "{remedy}");
    }
}
