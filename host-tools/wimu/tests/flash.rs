//! `wimu device flash`, as far as it goes without a board.

use crate::kit;

use std::path::Path;

use kit::{Transcript, wimu};

/// An RP2040's family of UF2 files, and that of the RP2350.
const RP2040: u32 = 0xe48b_ff56;
const RP2350: u32 = 0xe48b_ff59;

/// A UF2 file of one block.
fn image(folder: &Path, family: u32) -> String {
    let mut block = vec![0; 512];
    let words = [(0, 0x0a32_4655), (4, 0x9e5d_5157), (24, 1), (28, family), (508, 0x0ab1_6f30)];
    for (at, word) in words {
        block[at..at + 4].copy_from_slice(&u32::to_le_bytes(word));
    }
    let file = folder.join(format!("{family:x}.uf2"));
    std::fs::write(&file, block).expect("writable");
    file.display().to_string()
}

#[test]
fn an_image_that_cannot_be_written_is_refused_before_a_board_is_searched_for() {
    let mut texts = Transcript::default();
    let folder = tempfile::tempdir().expect("a folder");
    let missing = folder.path().join("none.hex").display().to_string();
    let letter = folder.path().join("letter.hex").display().to_string();
    std::fs::write(&letter, "Dear board").expect("writable");
    let pico = image(folder.path(), RP2040);
    let pico2 = image(folder.path(), RP2350);

    wimu(&["device", "flash", "microbit-v1"]).fails(2, "usage");
    for (image, code) in [(&missing, "file_unreadable"), (&letter, "unknown_format")] {
        let ran = wimu(&["device", "flash", "microbit-v2", "--image", image]);
        texts.fails(code, &ran, 2, code);
    }
    for (board, other) in [("microbit-v2", &pico), ("pico", &pico2)] {
        let ran = wimu(&["device", "flash", board, "--image", other]);
        let failure = texts.fails(board, &ran, 2, "wrong_image");
        assert_eq!(failure["place"]["at"], other.as_str());
    }
    texts.check("flash_refusals");
}

#[test]
fn an_image_is_copied_to_the_drive_of_its_board() {
    let folder = tempfile::tempdir().expect("a folder");
    let drive = tempfile::tempdir().expect("a folder");
    let to = drive.path().display().to_string();
    let image = image(folder.path(), RP2040);
    // A drive that tells no board, and then one that does.
    wimu(&["device", "flash", "--image", &image, "--drive", &to]).fails(2, "usage");
    let info = "UF2 Bootloader v3.0\r\nModel: Raspberry Pi RP2\r\nBoard-ID: RPI-RP2\r\n";
    std::fs::write(drive.path().join("INFO_UF2.TXT"), info).expect("writable");
    let written = wimu(&["device", "flash", "--image", &image, "--drive", &to]).succeeds();
    assert_eq!((&written["board"], &written["bytes"]), (&"pico".into(), &512.into()));
    let name = Path::new(&image).file_name().expect("a name");
    assert_eq!(std::fs::read(drive.path().join(name)).ok(), std::fs::read(&image).ok());
}

#[test]
fn without_a_probe_the_other_procedure_is_described() {
    let mut texts = Transcript::default();
    let folder = tempfile::tempdir().expect("a folder");
    let pico = image(folder.path(), RP2040);
    let flash = wimu(&["device", "flash", "pico", "--image", &pico]);
    let (exit, code) =
        if cfg!(feature = "flash") { (1, "probe_absent") } else { (2, "feature_missing") };
    texts.fails("flash", &flash, exit, code);
    if cfg!(feature = "flash") {
        let ran = wimu(&["device", "flash", "pico", "--image", &pico, "--probe", "pico"]);
        ran.fails(2, "usage");
    } else {
        texts.check("flash_without_feature");
    }
}
