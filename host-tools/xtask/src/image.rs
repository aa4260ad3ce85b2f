//! Images as boards take them without a probe: Intel HEX for drag and drop onto a micro:bit, UF2
//! for a Pico. Made from the loaded segments of an ELF file.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use ihex::Record;
use object::LittleEndian;
use object::elf::{FileHeader32, PT_LOAD};
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader};
use object::{Object as _, ObjectSymbol as _};

/// Where the files go.
const FOLDER: &str = "target/firmware";

/// Bytes of a line of a HEX file.
const HEX_LINE: usize = 16;
/// Bytes of a block of a UF2 file that carry data.
const UF2_PAGE: u32 = 256;
const UF2_FAMILY_RP2040: u32 = 0xe48b_ff56;

/// How a board takes its image.
#[derive(Clone, Copy)]
pub enum Format {
    Hex,
    Uf2,
}

impl Format {
    /// That of the board in `folder`, if it has one.
    pub fn of(folder: &Path) -> Option<Self> {
        match folder.file_name()?.to_str()? {
            "microbit-v2" | "nrf52840-ble" => Some(Self::Hex),
            "pico-adxl345" => Some(Self::Uf2),
            _ => None,
        }
    }

    fn extension(self) -> &'static str {
        match self {
            Self::Hex => "hex",
            Self::Uf2 => "uf2",
        }
    }
}

/// Writes the image of the board in `folder` that is in the ELF file `elf`; says where.
///
/// # Errors
/// Says which file cannot be read or written.
pub fn write(folder: &Path, elf: &Path, format: Format) -> Result<PathBuf, String> {
    let failed =
        |path: &Path, problem: &dyn std::fmt::Display| format!("{}: {problem}", path.display());
    let bytes = std::fs::read(elf).map_err(|problem| failed(elf, &problem))?;
    let segments = segments(&bytes).map_err(|problem| failed(elf, &problem))?;
    let (start, image) = sealed(&bytes, &segments).map_err(|problem| failed(elf, &problem))?;
    let segments = [(start, &image[..])];
    let content = match format {
        Format::Hex => hex(&segments)?.into_bytes(),
        Format::Uf2 => uf2(&segments),
    };
    let name = folder.file_name().unwrap_or_default();
    let path = Path::new(FOLDER).join(name).with_extension(format.extension());
    std::fs::create_dir_all(FOLDER).map_err(|problem| failed(Path::new(FOLDER), &problem))?;
    std::fs::write(&path, content).map_err(|problem| failed(&path, &problem))?;
    Ok(path)
}

/// A run of bytes at an address of the flash.
type Segment<'a> = (u32, &'a [u8]);

/// The loaded segments of a 32-bit little-endian ELF file, at their addresses in the flash.
fn segments(elf: &[u8]) -> Result<Vec<Segment<'_>>, String> {
    let damaged = |error: object::Error| error.to_string();
    let header = FileHeader32::<LittleEndian>::parse(elf).map_err(damaged)?;
    let endian = header.endian().map_err(damaged)?;
    let mut segments = Vec::new();
    for segment in header.program_headers(endian, elf).map_err(damaged)? {
        if segment.p_type(endian) == PT_LOAD && segment.p_filesz(endian) > 0 {
            let data = segment.data(endian, elf);
            let data = data.map_err(|()| "a segment is cut off")?;
            segments.push((segment.p_paddr(endian), data));
        }
    }
    segments.sort_by_key(|(address, _)| *address);
    Ok(segments)
}

/// The whole image from its lowest address on, and behind it the two words that `firmware/shared/src/image.rs` checks:
/// "WIMU", and the CRC-32C from the reset vector on. Gaps are erased flash.
fn sealed(elf: &[u8], segments: &[Segment<'_>]) -> Result<(u32, Vec<u8>), String> {
    let file = ElfFile32::<LittleEndian>::parse(elf).map_err(|error| error.to_string())?;
    let mut symbols = file.symbols();
    let table = symbols.find(|symbol| symbol.name() == Ok("__vector_table"));
    let table = table.ok_or("it has no vector table")?.address() as u32;
    let start = segments.first().ok_or("it is empty")?.0;
    let mut image = Vec::new();
    for (address, data) in segments {
        image.resize((address - start) as usize, 0xFF);
        image.extend_from_slice(data);
    }
    image.resize(image.len().next_multiple_of(4), 0xFF);
    let checked = table.checked_sub(start).map(|offset| offset as usize + 4);
    let checked = checked.and_then(|from| image.get(from..));
    let crc = crc_32c(checked.ok_or("its vector table is elsewhere")?);
    image.extend_from_slice(b"WIMU");
    image.extend_from_slice(&crc.to_le_bytes());
    Ok((start, image))
}

fn crc_32c(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            crc >> 1 ^ if crc & 1 == 1 { 0x82F6_3B78 } else { 0 }
        })
    })
}

fn hex(segments: &[Segment<'_>]) -> Result<String, String> {
    let mut records = Vec::new();
    let mut upper = None;
    for (start, data) in segments {
        let mut address = *start;
        let mut rest = *data;
        while !rest.is_empty() {
            if upper != Some(address >> 16) {
                upper = Some(address >> 16);
                records.push(Record::ExtendedLinearAddress((address >> 16) as u16));
            }
            // A line does not cross 64 KiB.
            let room = 0x1_0000 - (address as usize & 0xffff);
            let (line, after) = rest.split_at(rest.len().min(HEX_LINE).min(room));
            records.push(Record::Data { offset: address as u16, value: line.to_vec() });
            address += line.len() as u32;
            rest = after;
        }
    }
    records.push(Record::EndOfFile);
    let text = ihex::create_object_file_representation(&records);
    text.map_err(|error| error.to_string())
}

fn uf2(segments: &[Segment<'_>]) -> Vec<u8> {
    let mut pages: BTreeMap<u32, [u8; UF2_PAGE as usize]> = BTreeMap::new();
    for (start, data) in segments {
        for (address, byte) in (*start..).zip(*data) {
            let page = pages.entry(address / UF2_PAGE * UF2_PAGE).or_insert([0; UF2_PAGE as usize]);
            page[(address % UF2_PAGE) as usize] = *byte;
        }
    }
    let mut blocks = Vec::new();
    for (index, (address, page)) in pages.iter().enumerate() {
        let head = [
            0x0a32_4655,
            0x9e5d_5157,
            0x2000, // the last word of the head is a family
            *address,
            UF2_PAGE,
            index as u32,
            pages.len() as u32,
            UF2_FAMILY_RP2040,
        ];
        let start = blocks.len();
        blocks.extend(head.iter().flat_map(|word: &u32| word.to_le_bytes()));
        blocks.extend_from_slice(page);
        blocks.resize(start + 508, 0);
        blocks.extend(0x0ab1_6f30_u32.to_le_bytes());
    }
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_damaged_image_is_refused() {
        for damaged in [&b""[..], b"\x7fELF\x01\x01", &[0; 64]] {
            assert!(segments(damaged).is_err());
        }
    }

    #[test]
    fn the_check_value_of_the_crc_is_right() {
        // Catalogue of parametrised CRC algorithms, CRC-32/ISCSI.
        assert_eq!(crc_32c(b"123456789"), 0xE306_9283);
    }

    #[test]
    fn a_hex_file_is_as_the_format_says() {
        assert_eq!(
            hex(&[(0x1_fffe, &[0x21, 0x46, 0x01, 0x36])]),
            Ok(":020000040001F9\n:02FFFE0021469A\n:020000040002F8\n:020000000136C7\n:00000001FF\n"
                .into())
        );
    }

    #[test]
    fn a_uf2_file_holds_whole_pages_and_says_how_many() {
        let blocks = uf2(&[(0x1000_0000, &[1; 256]), (0x1000_0110, &[2; 3])]);
        assert_eq!(blocks.len(), 2 * 512);
        let word = |at: usize| u32::from_le_bytes(blocks[at..at + 4].try_into().expect("four"));
        for (index, address) in [(0, 0x1000_0000), (1, 0x1000_0100)] {
            let at = index * 512;
            assert_eq!(word(at), 0x0a32_4655);
            assert_eq!(word(at + 12), address);
            assert_eq!((word(at + 20), word(at + 24)), (index as u32, 2));
            assert_eq!(word(at + 28), UF2_FAMILY_RP2040);
            assert_eq!(word(at + 508), 0x0ab1_6f30);
        }
        assert_eq!(blocks[512 + 32 + 15..512 + 32 + 20], [0, 2, 2, 2, 0]);
    }
}
