//! `wimu device flash`: an image is copied to the board's drive, or written through a debug probe.

mod image;
#[cfg(feature = "flash")]
mod probe;

use std::ops::Range;
use std::path::{Path, PathBuf};

use wimu_host::{Code, Result};

use crate::arguments::{Board, Flash};
use crate::output::{Output, usage};

/// What is known of a board.
struct Facts {
    name: &'static str,
    /// Name of the chip in probe-rs, its memory, and the address of an image's vector table.
    chip: &'static str,
    flash: Range<u32>,
    ram: Range<u32>,
    vectors: u32,
    /// The image that `cargo xtask firmware` writes.
    file: &'static str,
    /// Name of the drive that takes it, and how the board shows it.
    drive: &'static str,
    shown: &'static str,
    /// Family of its UF2 blocks.
    family: Option<u32>,
}

const MICROBIT: Facts = Facts {
    name: "microbit-v2",
    chip: "nRF52833_xxAA",
    flash: 0..0x8_0000,
    ram: 0x2000_0000..0x2002_0000,
    vectors: 0,
    file: "target/firmware/microbit-v2.hex",
    drive: "MICROBIT",
    shown: "connect its USB cable",
    family: None,
};
const PICO: Facts = Facts {
    name: "pico",
    chip: "RP2040",
    flash: 0x1000_0000..0x1020_0000,
    ram: 0x2000_0000..0x2004_2000,
    vectors: 0x1000_0100,
    file: "target/firmware/pico.uf2",
    drive: "RPI-RP2",
    shown: "hold BOOTSEL while you connect its USB cable",
    family: Some(0xe48b_ff56),
};
/// The bootloader's drive takes what it does not need itself.
const XIAO: Facts = Facts {
    name: "xiao-nrf52840",
    chip: "nRF52840_xxAA",
    flash: 0x2_7000..0xF_4000,
    ram: 0x2000_0000..0x2004_0000,
    vectors: 0x2_7000,
    file: "target/firmware/xiao-nrf52840.uf2",
    drive: "XIAO-SENSE",
    shown: "press its reset button twice within half a second",
    family: Some(0xada5_2840),
};

impl Board {
    const ALL: [Self; 3] = [Self::MicrobitV2, Self::Pico, Self::XiaoNrf52840];

    const fn facts(self) -> &'static Facts {
        match self {
            Self::MicrobitV2 => &MICROBIT,
            Self::Pico => &PICO,
            Self::XiaoNrf52840 => &XIAO,
        }
    }
}

/// A firmware image, checked to be for its board.
struct Image {
    board: &'static Facts,
    file: PathBuf,
    bytes: Vec<u8>,
    #[cfg_attr(not(feature = "flash"), allow(dead_code, reason = "a drive takes the file"))]
    segments: Vec<image::Segment>,
}

pub fn run(arguments: &Flash, output: &Output) -> Result<()> {
    let drives = arguments.drive.clone().map_or_else(mounted, |drive| vec![drive]);
    let board = match arguments.board {
        Some(board) => board.facts(),
        None => on_drives(&drives)?,
    };
    let image = read(board, arguments.image.clone())?;
    let named = |drive: &&PathBuf| arguments.drive.is_some() || is_drive_of(drive, board);
    match drives.iter().find(named) {
        Some(drive) if arguments.probe.is_none() => copy(&image, drive, output),
        _ => write(&image, arguments, output),
    }
}

/// The only board whose drive is there.
fn on_drives(drives: &[PathBuf]) -> Result<&'static Facts> {
    let all = Board::ALL.map(Board::facts);
    let shown = |facts: &&&Facts| drives.iter().any(|drive| is_drive_of(drive, facts));
    let found: Vec<_> = all.iter().filter(shown).collect();
    match found[..] {
        [board] => Ok(board),
        [] => Err(usage(
            "no board shows its drive",
            "name the board: wimu device flash --help lists them",
        )),
        _ => Err(usage("several boards show their drives", "name the one to write")),
    }
}

/// Folders at which drives are mounted.
fn mounted() -> Vec<PathBuf> {
    if cfg!(windows) {
        return ('D'..='Z').map(|letter| PathBuf::from(format!("{letter}:\\"))).collect();
    }
    let mut folders = Vec::new();
    // Linux; a space in a name is \040.
    for line in std::fs::read_to_string("/proc/mounts").unwrap_or_default().lines() {
        folders.extend(line.split(' ').nth(1).map(|at| PathBuf::from(at.replace("\\040", " "))));
    }
    let volumes = std::fs::read_dir("/Volumes").into_iter().flatten().flatten();
    folders.extend(volumes.map(|volume| volume.path()));
    folders
}

/// Whether `drive` is that of a board: by its name, or where the system gives it none, by the file of its bootloader.
fn is_drive_of(drive: &Path, board: &Facts) -> bool {
    let info = std::fs::read_to_string(drive.join("INFO_UF2.TXT")).unwrap_or_default();
    let id = info.lines().find_map(|line| line.strip_prefix("Board-ID:"));
    let known = match board.name {
        "pico" => id.is_some_and(|id| id.trim() == "RPI-RP2"),
        "xiao-nrf52840" => id.is_some_and(|id| id.contains("XIAO")),
        _ => drive.join("DETAILS.TXT").is_file() && drive.join("MICROBIT.HTM").is_file(),
    };
    known || drive.file_name().is_some_and(|name| name == board.drive)
}

/// Reads an image and checks that it is for the board.
fn read(board: &'static Facts, file: Option<PathBuf>) -> Result<Image> {
    let file = file.unwrap_or_else(|| board.file.into());
    let location = file.display().to_string();
    let bytes = std::fs::read(&file).map_err(|error| {
        let remedy =
            "build it with `cargo xtask firmware` in the repository, or name one with --image";
        let text = format!("the image cannot be read: {error}");
        Code::FileUnreadable.error(text, remedy).at(&location)
    })?;
    let segments = image::segments(&bytes).ok_or_else(|| {
        let remedy = "give an Intel HEX or UF2 file; `cargo xtask firmware` builds them";
        Code::UnknownFormat.error("this is not a complete firmware image", remedy).at(&location)
    })?;
    if let Some(why) = image::objection(board, &bytes, &segments) {
        let text = format!("this image is not for a {}: {why}", board.name);
        let remedy =
            format!("give the board's own image: `cargo xtask firmware` writes {}", board.file);
        return Err(Code::WrongImage.error(text, remedy).at(&location));
    }
    Ok(Image { board, file, bytes, segments })
}

/// Copies the file; the board writes it and starts it.
fn copy(image: &Image, drive: &Path, output: &Output) -> Result<()> {
    let name = image.file.file_name().unwrap_or_default();
    let failed = |error: std::io::Error| {
        let text = format!("the image cannot be copied: {error}");
        let remedy = format!("{}, and try again", image.board.shown);
        Code::FlashFailed.error(text, remedy).at(drive.display())
    };
    let mut file = std::fs::File::create(drive.join(name)).map_err(failed)?;
    std::io::Write::write_all(&mut file, &image.bytes).map_err(failed)?;
    // The drive may be gone by then: the board has restarted.
    let _ = file.sync_all();
    done(image, &drive.display().to_string(), output);
    Ok(())
}

fn done(image: &Image, to: &str, output: &Output) {
    #[derive(serde::Serialize)]
    struct Written<'a> {
        board: &'a str,
        to: &'a str,
        image: String,
        bytes: usize,
    }
    let (board, bytes, file) = (image.board.name, image.bytes.len(), image.file.display());
    output.print(format!(
        "wrote {file} ({bytes} bytes) to the {board} at {to}; `wimu device ports` shows its port"
    ));
    output.object(&Written { board, to, image: file.to_string(), bytes });
}

#[cfg(feature = "flash")]
use probe::write;

#[cfg(not(feature = "flash"))]
fn write(image: &Image, arguments: &Flash, _: &Output) -> Result<()> {
    // Used by the build with the feature only.
    let Flash { probe: _, erase_all: _, .. } = arguments;
    let Facts { name, drive, shown, .. } = image.board;
    let text = format!(
        "the {name} shows no drive, and this wimu was built without support for debug probes"
    );
    let probe = format!("cargo run --release -p wimu --features flash -- device flash {name}");
    Err(Code::FeatureMissing
        .error(text, format!("let it show its drive {drive} ({shown}), or: {probe}")))
}
