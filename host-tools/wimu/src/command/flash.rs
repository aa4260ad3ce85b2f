//! `wimu device flash`: an image is copied to the board's drive, or written through a debug probe.

mod image;
#[cfg(feature = "flash")]
mod probe;

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use wimu_host::{Code, Problem, Result};

use self::image::Format;
use crate::arguments::{Board, Flash};
use crate::output::{Output, usage};

/// What is known of a board.
struct Facts {
    name: &'static str,
    /// Name of the chip in probe-rs.
    #[cfg_attr(not(feature = "flash"), expect(dead_code, reason = "a drive needs no name"))]
    chip: &'static str,
    /// Format of its images.
    format: Format,
    /// Name of the drive that takes an image, a file on it and a text in that file, and how the board shows it.
    drive: &'static str,
    mark: (&'static str, &'static str),
    shown: &'static str,
}

impl Board {
    fn facts(self) -> Facts {
        match self {
            Self::MicrobitV2 => Facts {
                name: "microbit-v2",
                chip: "nRF52833_xxAA",
                format: Format::Hex,
                drive: "MICROBIT",
                mark: ("DETAILS.TXT", "micro:bit"),
                shown: "connect its USB cable",
            },
            Self::Pico => Facts {
                name: "pico",
                chip: "RP2040",
                format: Format::Uf2 { family: 0xe48b_ff56 },
                drive: "RPI-RP2",
                mark: ("INFO_UF2.TXT", "RPI-RP2"),
                shown: "hold BOOTSEL while you connect its USB cable",
            },
            Self::XiaoNrf52840 => Facts {
                name: "xiao-nrf52840",
                chip: "nRF52840_xxAA",
                format: Format::Uf2 { family: 0xada5_2840 },
                drive: "XIAO-SENSE",
                mark: ("INFO_UF2.TXT", "XIAO"),
                shown: "press its reset button twice within half a second",
            },
        }
    }
}

impl Facts {
    /// The image that `cargo xtask firmware` writes.
    fn file(&self) -> String {
        let extension = match self.format {
            Format::Hex => "hex",
            Format::Uf2 { .. } => "uf2",
        };
        format!("target/firmware/{}.{extension}", self.name)
    }

    /// Whether `drive` is that of the board: by its name, or where the system gives it none, by a file on it.
    fn has_drive(&self, drive: &Path) -> bool {
        let (file, text) = self.mark;
        drive.file_name().is_some_and(|name| name == self.drive)
            || std::fs::read_to_string(drive.join(file)).is_ok_and(|found| found.contains(text))
    }
}

/// A firmware image, checked to be for its board.
struct Image {
    board: Facts,
    file: PathBuf,
    bytes: Vec<u8>,
}

pub fn run(arguments: &Flash, output: &Output) -> Result<()> {
    let drives = arguments.drive.clone().map_or_else(mounted, |drive| vec![drive]);
    let board = arguments.board.map_or_else(|| on_drives(&drives), |board| Ok(board.facts()))?;
    let image = read(board, arguments.image.clone())?;
    let named = |drive: &&PathBuf| arguments.drive.is_some() || image.board.has_drive(drive);
    match drives.iter().find(named) {
        Some(drive) if arguments.probe.is_none() => copy(&image, drive, output),
        _ => write(&image, arguments, output),
    }
}

/// The only board whose drive is there.
fn on_drives(drives: &[PathBuf]) -> Result<Facts> {
    let mut boards: Vec<Facts> =
        Board::value_variants().iter().map(|board| board.facts()).collect();
    boards.retain(|board| drives.iter().any(|drive| board.has_drive(drive)));
    match (boards.pop(), boards.is_empty()) {
        (Some(board), true) => Ok(board),
        (None, _) => Err(without_drive()),
        _ => Err(usage("several boards show their drives", "name the one to write")),
    }
}

/// No board shows its drive. An ESP32-C3 has none; its USB serial port has the vendor number of its maker.
fn without_drive() -> Problem {
    let mut ports = wimu_host::transport::ports().unwrap_or_default().into_iter();
    let Some(port) = ports.find(|port| port.usb.is_some_and(|usb| usb.vendor == 0x303a)) else {
        let remedy = "name the board: wimu device flash --help lists them";
        return usage("no board shows its drive", remedy);
    };
    let path = port.path;
    let text = format!("the ESP32-C3 at {path} has no drive; espflash writes it");
    usage(text, format!("cd firmware/esp32c3 && cargo run --release -- --port {path}"))
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

/// Reads an image and checks that it is for the board.
fn read(board: Facts, file: Option<PathBuf>) -> Result<Image> {
    let file = file.unwrap_or_else(|| board.file().into());
    let location = file.display().to_string();
    let bytes = std::fs::read(&file).map_err(|error| {
        let remedy =
            "build it with `cargo xtask firmware` in the repository, or name one with --image";
        let text = format!("the image cannot be read: {error}");
        Code::FileUnreadable.error(text, remedy).at(&location)
    })?;
    let format = image::format(&bytes).ok_or_else(|| {
        let remedy = "give an Intel HEX or UF2 file; `cargo xtask firmware` builds them";
        Code::UnknownFormat.error("this is not a complete firmware image", remedy).at(&location)
    })?;
    if format != board.format {
        let text = format!("this image is for another board than the {}: {format}", board.name);
        let remedy = format!("give {}, which `cargo xtask firmware` writes", board.file());
        return Err(Code::WrongImage.error(text, remedy).at(&location));
    }
    Ok(Image { board, file, bytes })
}

/// Copies the file; the board writes it and starts it.
fn copy(image: &Image, drive: &Path, output: &Output) -> Result<()> {
    let failed = |error: std::io::Error| {
        let text = format!("the image cannot be copied: {error}");
        let remedy = format!("{}, and try again", image.board.shown);
        Code::FlashFailed.error(text, remedy).at(drive.display().to_string())
    };
    let copy = drive.join(image.file.file_name().unwrap_or_default());
    let mut copy = std::fs::File::create(copy).map_err(failed)?;
    std::io::Write::write_all(&mut copy, &image.bytes).map_err(failed)?;
    // The drive may be gone by then: the board has restarted.
    let _ = copy.sync_all();
    done(image, &drive.display().to_string(), output);
    Ok(())
}

fn done(image: &Image, to: &str, output: &Output) {
    let (board, bytes, file) = (image.board.name, image.bytes.len(), image.file.display());
    output.print(format!(
        "wrote {file} ({bytes} bytes) to the {board} at {to}; `wimu device ports` shows its port"
    ));
    let image = file.to_string();
    output.object(&serde_json::json!({ "board": board, "to": to, "image": image, "bytes": bytes }));
}

#[cfg(feature = "flash")]
use probe::write;

#[cfg(not(feature = "flash"))]
fn write(image: &Image, arguments: &Flash, _: &Output) -> Result<()> {
    // Used with the feature only.
    let Flash { erase_all: _, .. } = arguments;
    let Facts { name, drive, shown, .. } = &image.board;
    let text = format!(
        "the {name} shows no drive, and this wimu was built without support for debug probes"
    );
    let probe = format!("cargo run --release -p wimu --features flash -- device flash {name}");
    let remedy = format!("let it show its drive {drive} ({shown}), or: {probe}");
    Err(Code::FeatureMissing.error(text, remedy))
}
