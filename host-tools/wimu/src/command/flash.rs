//! `wimu device flash`.

mod image;
#[cfg(feature = "flash")]
mod probe;

use std::ops::Range;
use std::path::PathBuf;

use wimu_host::{Code, Result};

use crate::arguments::{Board, Flash};
use crate::output::Output;

/// A chip's name and memory map.
struct Chip {
    /// Name in probe-rs.
    name: &'static str,
    flash: Range<u32>,
    ram: Range<u32>,
    /// Address of an image's vector table.
    vectors: u32,
}

impl Board {
    fn name(self) -> &'static str {
        match self {
            Self::MicrobitV2 => "microbit-v2",
            Self::PicoAdxl345 => "pico-adxl345",
            Self::Nrf52840Ble => "nrf52840-ble",
        }
    }

    fn chip(self) -> Chip {
        match self {
            Self::MicrobitV2 => Chip {
                name: "nRF52833_xxAA",
                flash: 0..0x8_0000,
                ram: 0x2000_0000..0x2002_0000,
                vectors: 0,
            },
            Self::PicoAdxl345 => Chip {
                name: "RP2040",
                flash: 0x1000_0000..0x1020_0000,
                ram: 0x2000_0000..0x2004_2000,
                vectors: 0x1000_0100,
            },
            Self::Nrf52840Ble => Chip {
                name: "nRF52840_xxAA",
                flash: 0..0x10_0000,
                ram: 0x2000_0000..0x2004_0000,
                vectors: 0,
            },
        }
    }

    /// The image that `cargo xtask firmware` writes, and the drive that takes it without a probe.
    fn file_and_drive(self) -> (&'static str, &'static str) {
        match self {
            Self::MicrobitV2 => ("target/firmware/microbit-v2.hex", "MICROBIT"),
            Self::PicoAdxl345 => ("target/firmware/pico-adxl345.uf2", "RPI-RP2"),
            Self::Nrf52840Ble => ("target/firmware/nrf52840-ble.hex", "JLINK"),
        }
    }
}

/// A firmware image, checked to be for its board.
struct Image {
    board: Board,
    file: PathBuf,
    segments: Vec<image::Segment>,
}

pub fn run(arguments: &Flash, output: &Output) -> Result<()> {
    match arguments.board {
        Some(board) if !arguments.list => {
            write(&read(board, arguments.image.clone())?, arguments, output)
        }
        _ => list(output),
    }
}

fn read(board: Board, file: Option<PathBuf>) -> Result<Image> {
    let file = file.unwrap_or_else(|| board.file_and_drive().0.into());
    let location = file.display().to_string();
    let bytes =
        std::fs::read(&file).map_err(|error| {
            Code::FileUnreadable.error(format!("the image cannot be read: {error}"),
            "build it with `cargo xtask firmware` in the repository, or name one with --image",
        )
        .at(&location)
        })?;
    let segments = image::segments(&bytes).ok_or_else(|| {
        Code::UnknownFormat.error("this is not a complete firmware image",
            "give an ELF file for ARM, an Intel HEX file or a UF2 file; `cargo xtask firmware` builds them",
        )
        .at(&location)
    })?;
    match image::objection(board, &segments) {
        None => Ok(Image { board, file, segments }),
        Some(why) => Err(Code::WrongImage
            .error(
                format!("this image is not for a {}: {why}", board.name()),
                format!(
                    "give the board's own image: `cargo xtask firmware` writes {}",
                    board.file_and_drive().0
                ),
            )
            .at(&location)),
    }
}

#[cfg(feature = "flash")]
use probe::{list, write};

#[cfg(not(feature = "flash"))]
fn list(_: &Output) -> Result<()> {
    Err(left_out("flash --list", ""))
}

#[cfg(not(feature = "flash"))]
fn write(image: &Image, arguments: &Flash, _: &Output) -> Result<()> {
    // Used by the build with the feature only.
    let Flash { probe: _, erase_all: _, .. } = arguments;
    debug_assert!(!image.segments.is_empty());
    let (_, drive) = image.board.file_and_drive();
    let without = format!("; or copy {} onto the board's drive {drive}", image.file.display());
    Err(left_out(&format!("flash {}", image.board.name()), &without))
}

#[cfg(not(feature = "flash"))]
fn left_out(command: &str, otherwise: &str) -> wimu_host::Problem {
    Code::FeatureMissing.error(
        "this wimu was built without support for debug probes",
        format!("cargo run --release -p wimu --features flash -- {command}{otherwise}"),
    )
}
